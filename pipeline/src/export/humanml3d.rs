//! HumanML3D folders: features, joints, captions, split lists and statistics.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use datasets_spec::record::{HUMANML3D_WIDTH, HumanMl3dRow, MotionRow};
use datasets_spec::table::{Caption, Row, ShardReader};
use datasets_spec::{Dataset, Fps, Skeleton, Split};
use features::humanml3d::{Features, GROUPS, RECIPE, recover_joints};
use features::{Statistics, smpl_body};
use formats::source::humanml3d::is_id;
use kinematics::skeleton::NUM_BODY_JOINTS;

use super::by_clip::{ByClip, Note, labels, sorted_lines};
use super::document::{Lines, file, read_features};
use crate::Error;
use crate::clips::Clips;
use crate::reference::features_of;
use pickle::npy;

/// A HumanML3D folder.
///
/// Features that the dataset holds are written as they are. Others are computed: a clip of `L` frames has `L - 1`
/// frames of features and joints, as published. Clips whose id is not of HumanML3D get a running number of six digits;
/// `ids.csv` lists these numbers, why a clip was left out, and its licence. Captions made from file names are left out,
/// because the layout cannot store their origin. Captions without tokens get their words as tokens with the tag
/// `OTHER`, because loaders of this layout need tokens.
///
/// Joints are those of a SMPL body, as in the published set: with SMPL's bone directions at rest, and the
/// bone lengths of the dataset's body until the recipe sets its own.
pub(super) struct HumanMl3dFolder {
    skeleton: Skeleton,
    stored: Stored,
    names: BTreeMap<String, String>,
}

const VECTORS: &str = "new_joint_vecs";

impl HumanMl3dFolder {
    pub(super) fn new(clips: &Clips) -> Result<Self, Error> {
        Ok(Self {
            skeleton: smpl_body(&clips.dataset().skeleton()?),
            stored: Stored::of(clips.dataset())?,
            names: names(clips)?,
        })
    }

    fn name(&self, id: &str) -> &str {
        self.names.get(id).map_or("", String::as_str)
    }
}

impl ByClip for HumanMl3dFolder {
    fn write_clip(&self, row: MotionRow, folder: &Path) -> Result<Note, Error> {
        let (id, name) = (row.id.as_str(), self.name(row.id.as_str()));
        let features = match self.stored.get(id)? {
            Some(features) => features,
            None => match features_of(&row, &self.skeleton) {
                Ok(features) => features,
                Err(reason) => return Ok(Some(reason)),
            },
        };
        let joints: Vec<f32> = recover_joints(&features)
            .iter()
            .flatten()
            .flat_map(|joint| joint.as_vec3().to_array())
            .collect();
        let (vectors, width) = (features.as_flattened(), HUMANML3D_WIDTH);
        let vector = npy::encode(&[features.len(), width], vectors);
        file(folder, &format!("{VECTORS}/{name}.npy"), &vector)?;
        let shape = [features.len(), NUM_BODY_JOINTS, 3];
        let joints = npy::encode(&shape, &joints);
        file(folder, &format!("new_joints/{name}.npy"), &joints)?;
        let lines: String = row.stated_captions().map(caption_line).collect();
        if !lines.is_empty() {
            file(folder, &format!("texts/{name}.txt"), lines.as_bytes())?;
        }
        Ok(None)
    }

    fn finish(&self, clips: &Clips, notes: &[Note], folder: &Path) -> Result<u64, Error> {
        for name in [VECTORS, "new_joints", "texts"] {
            let path = folder.join(name);
            fs::create_dir_all(&path).map_err(datasets_spec::Error::io("create folder", &path))?;
        }
        let mut notes = notes.iter();
        let mut by_split: BTreeMap<Split, Vec<&str>> = BTreeMap::new();
        let mut statistics = Statistics::<HUMANML3D_WIDTH>::default();
        let mut lines = Lines::new(["name", "id", "left_out", "license"]);
        let mut written = 0;
        for (id, split, license) in labels(clips)? {
            let name = self.name(&id);
            let left_out = notes.next().cloned().flatten();
            let reason = left_out.as_deref().unwrap_or_default();
            lines.take([name, &id, reason, &license]);
            if left_out.is_some() {
                continue;
            }
            let path = folder.join(format!("{VECTORS}/{name}.npy"));
            statistics.take(&read_features::<HUMANML3D_WIDTH>(&path)?);
            by_split.entry(split).or_default().push(name);
            written += 1;
        }
        file(folder, "ids.csv", &lines.into_bytes())?;
        for (list, splits) in [
            ("train.txt", &[Split::Train][..]),
            ("val.txt", &[Split::Val]),
            ("test.txt", &[Split::Test]),
            ("train_val.txt", &[Split::Train, Split::Val]),
            ("all.txt", &Split::ALL),
        ] {
            let listed = splits.iter().filter_map(|split| by_split.get(split));
            let lines = sorted_lines(listed.flatten().copied().collect());
            file(folder, list, lines.as_bytes())?;
        }
        let width = [HUMANML3D_WIDTH];
        file(folder, "Mean.npy", &npy::encode(&width, &statistics.mean()))?;
        let std = npy::encode(&width, &statistics.std_by(&GROUPS));
        file(folder, "Std.npy", &std)?;
        Ok(written)
    }
}

/// The features that the dataset holds beside its motions.
#[derive(Default)]
struct Stored {
    shards: Vec<ShardReader>,
    /// Shard and row, by the id of the motion.
    places: BTreeMap<String, (usize, usize)>,
}

impl Stored {
    fn of(dataset: &Dataset) -> Result<Self, Error> {
        let mut stored = Self::default();
        for (number, (path, _)) in dataset.files(HumanMl3dRow::TABLE, None).iter().enumerate() {
            let shard = ShardReader::open(path)?;
            let ids = shard.column::<HumanMl3dRow, String>("id")?;
            let recipes = shard.column::<HumanMl3dRow, String>("recipe")?;
            let rates = shard.column::<HumanMl3dRow, f32>("fps")?;
            for (row, ((id, recipe), fps)) in ids.into_iter().zip(recipes).zip(rates).enumerate() {
                if recipe == RECIPE && f64::from(fps) == Fps::STORE.get() {
                    stored.places.insert(id, (number, row));
                }
            }
            stored.shards.push(shard);
        }
        Ok(stored)
    }

    fn get(&self, id: &str) -> Result<Option<Vec<Features>>, Error> {
        let Some(&(shard, row)) = self.places.get(id) else {
            return Ok(None);
        };
        let rows: Vec<HumanMl3dRow> = self.shards[shard].rows_at(&[row])?;
        Ok(rows.into_iter().next().map(|row| row.features))
    }
}

/// Maps the id of each motion to its name.
pub(super) fn names(clips: &Clips) -> Result<BTreeMap<String, String>, Error> {
    let ids = ids(clips)?;
    let published = ids.iter().filter(|(id, _)| is_id(id));
    let mut taken: BTreeSet<String> = published.map(|(id, _)| id.clone()).collect();
    let mut names: BTreeMap<String, String> =
        taken.iter().map(|id| (id.clone(), id.clone())).collect();
    let mut next = 0u64;
    let mut number = |taken: &mut BTreeSet<String>| {
        loop {
            let name = format!("{next:06}");
            next += 1;
            // The name of the mirror image must be free as well.
            if !taken.contains(&format!("M{name}")) && taken.insert(name.clone()) {
                return name;
            }
        }
    };
    let others = ids.iter().filter(|(id, _)| !is_id(id));
    let (copies, originals): (Vec<_>, Vec<_>) =
        others.partition(|(_, original)| original.is_some());
    for (id, _) in originals {
        names.insert(id.clone(), number(&mut taken));
    }
    for (id, original) in copies {
        let mirrored = original
            .as_ref()
            .and_then(|original| names.get(original))
            .map(|name| format!("M{name}"))
            .filter(|name| taken.insert(name.clone()));
        let name = mirrored.unwrap_or_else(|| number(&mut taken));
        names.insert(id.clone(), name);
    }
    Ok(names)
}

/// The id of every motion, and the id of the motion that it mirrors. No other column is read.
pub(super) fn ids(clips: &Clips) -> Result<Vec<(String, Option<String>)>, Error> {
    let mut ids = Vec::new();
    for shard in clips.shards(None) {
        let id = shard.column::<String>("id")?;
        let original = shard.column::<Option<String>>("mirrored_of")?;
        ids.extend(id.into_iter().zip(original));
    }
    Ok(ids)
}

/// Separates the fields of a caption. A blank replaces it in the text and the tokens, because published loaders split a
/// line at each of these signs and pass over a clip whose times they cannot read.
pub(super) const HASH_SIGN: char = '#';

/// A caption as `text#tokens#from#to`.
pub(super) fn caption_line(caption: &Caption) -> String {
    // A line break would end the caption, and a hash sign would end the text or the tokens.
    let in_field = |text: &str| text.replace(['\r', '\n', HASH_SIGN], " ");
    let text = in_field(&caption.text);
    let tokens = match caption.tokens.as_str() {
        "" => words(&text),
        tokens => in_field(tokens),
    };
    format!("{text}#{tokens}#{:?}#{:?}\n", caption.from_s, caption.to_s)
}

/// The words of a text in lower case, with the tag for an unknown part of speech.
fn words(text: &str) -> String {
    let words: Vec<String> = text
        .split(|c: char| !c.is_alphabetic())
        .filter(|word| !word.is_empty())
        .map(|word| format!("{}/OTHER", word.to_lowercase()))
        .collect();
    words.join(" ")
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use features::humanml3d::{
        UNIFORM_BONES, features_of_joints, joints_of_motion, process_joints,
    };
    use glam::DVec3;
    use testkit::walk;

    use super::*;
    use crate::export::tests::ingested;
    use crate::export::{Layout, export};
    use datasets_spec::{Dataset, Motion, NoProgress};
    use pickle::npy::read_numbers;

    fn points(path: &Path) -> Vec<DVec3> {
        let bytes = fs::read(path).expect("written");
        let array = read_numbers("joints", &bytes).expect("an array");
        let values = array.values.chunks_exact(3);
        values.map(DVec3::from_slice).collect()
    }

    fn read(path: PathBuf) -> String {
        fs::read_to_string(path).expect("written")
    }

    #[test]
    fn what_is_exported_comes_back() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let at = |name: &str| folder.path().join(name);
        fs::create_dir_all(at("in/KIT")).expect("made");
        let skeleton = Skeleton::smplx_neutral();
        let motion = Motion::from_poses(Fps::STORE, &walk(60)).expect("valid");
        let bytes = formats::write::amass::encode(&motion, &skeleton).expect("encoded");
        fs::write(at("in/KIT/walk_poses.npz"), bytes).expect("written");
        let captions = "a man walks#a/DET man/NOUN walk/VERB#0.0#0.0\n\
                        he walks, fast##0.5#1.5\nhe takes step #2##1.0#1.5\n";
        fs::write(at("in/KIT/walk_poses.txt"), captions).expect("written");
        let first = ingested(&at("in"), &at("first"));
        let clips = Clips::all(&first);
        let done = export(&clips, Layout::HumanMl3d, &at("out"), &NoProgress).expect("written");
        assert_eq!(done.clips, 1);
        // A hash sign in a text would be read as the end of the text.
        assert_eq!(done.left_out["caption_hash_signs"], 1);

        let rows = |dataset: &Dataset| dataset.read::<MotionRow>(None).expect("read");
        let before = rows(&first)[0].clone();
        let body = smpl_body(&skeleton);
        let joints = joints_of_motion(&before.motion().expect("valid"), &body);
        let processed = process_joints(&joints, &UNIFORM_BONES).expect("long enough");
        let stored = points(&at("out/new_joints/000000.npy"));
        assert_eq!(stored.len(), 59 * NUM_BODY_JOINTS, "one frame less");
        for (stored, processed) in stored.iter().zip(processed.as_flattened()) {
            // Tolerance: positions are in f32, and the root is a sum of 60 velocities.
            assert!((*stored - *processed).length() < 1e-5);
        }
        let ids = "name,id,left_out,license\n000000,KIT/walk_poses,,\n";
        assert_eq!(read(at("out/ids.csv")), ids);
        let texts = "a man walks#a/DET man/NOUN walk/VERB#0.0#0.0\n\
                     he walks, fast#he/OTHER walks/OTHER fast/OTHER#0.5#1.5\n\
                     he takes step  2#he/OTHER takes/OTHER step/OTHER#1.0#1.5\n";
        assert_eq!(read(at("out/texts/000000.txt")), texts);
        assert_eq!(read(at("out/all.txt")), "000000\n");

        let again = ingested(&at("out"), &at("again"));
        let rows = rows(&again);
        assert_eq!(rows.len(), 1, "joints and vector are one clip");
        let after = &rows[0];
        assert_eq!((after.id.as_str(), after.split), ("000000", before.split));
        assert_eq!(after.captions[0], before.captions[0]);
        let joints = joints_of_motion(&after.motion().expect("valid"), &body);
        let back = process_joints(&joints, &UNIFORM_BONES).expect("long enough");
        let back = back.as_flattened();
        let apart = back.iter().zip(processed.as_flattened());
        let apart = apart.map(|(a, b)| a.distance(*b)).sum::<f64>() / back.len() as f64;
        // A fit is not exact: the pelvis and the chest turn three bones each with one rotation.
        assert!(apart < 0.02, "{apart}");
    }

    #[test]
    fn published_ids_are_kept_and_others_fill_the_gaps() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let at = |name: &str| folder.path().join(name);
        fs::create_dir_all(at("in/new_joint_vecs")).expect("made");
        let skeleton = Skeleton::smplx_neutral();
        let motion = Motion::from_poses(Fps::STORE, &walk(30)).expect("valid");
        let features =
            features_of_joints(&joints_of_motion(&motion, &skeleton)).expect("long enough");
        let vector = npy::encode(&[29, 263], features.as_flattened());
        for id in ["000000", "M000000", "M000001", "walk"] {
            fs::write(at("in/new_joint_vecs").join(format!("{id}.npy")), &vector).expect("written");
        }
        let dataset = ingested(&at("in"), &at("first"));
        let names = names(&Clips::all(&dataset)).expect("read");
        assert_eq!(names["M000001"], "M000001");
        // 000000 is taken, and so is M000001, the mirror image of 000001.
        assert_eq!(names["walk"], "000002");
        let clips = Clips::all(&dataset);
        let done = export(&clips, Layout::HumanMl3d, &at("out"), &NoProgress).expect("written");
        assert_eq!(done.clips, 4);
        let array = |name: &str| {
            let bytes = fs::read(at("out").join(name)).expect("written");
            read_numbers(name, &bytes).expect("an array")
        };
        assert_eq!(array("Mean.npy").shape, [263]);
        let std = array("Std.npy").values;
        // All features of a group have one deviation.
        assert!(std[4..67].iter().all(|&value| value == std[4]));
    }
}
