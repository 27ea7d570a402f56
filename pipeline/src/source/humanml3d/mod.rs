//! HumanML3D folders: 263-d vectors, joints, captions, split lists and the crop list, whole or in
//! part.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;

use datasets_spec::record::HUMANML3D_WIDTH;
use datasets_spec::table::Caption;
use datasets_spec::{Fps, Skeleton, Split};
use glam::DVec3;
use kinematics::skeleton::NUM_BODY_JOINTS;

use super::files::Files;
use super::format::{Entry, Format, Recognised, Release, SourceFormat};
use super::labels;
use super::options::ReadOptions;
use crate::check::FLAG_POOR_FIT;
use crate::clip::{Outcome, Rejected, RotationSource, SourceClip};
use crate::feature::humanml3d::recover_joints;
use crate::feature::{motion_of_features, motion_of_joints};
use pickle::npy::{self, Array, Header};

/// Rate of the published clips.
pub(crate) const FPS: Fps = Fps::STORE;
/// Folders of a release, and the ends of the names in them.
const JOINTS_FOLDER: &str = "new_joints";
const VECTORS_FOLDER: &str = "new_joint_vecs";
const TEXTS_FOLDER: &str = "texts";
/// Lists of ids. Those that name no split are read for their ids alone.
pub(crate) const LISTS: [(&str, Option<Split>); 5] = [
    ("train.txt", Some(Split::Train)),
    ("val.txt", Some(Split::Val)),
    ("test.txt", Some(Split::Test)),
    ("all.txt", None),
    ("train_val.txt", None),
];
/// Files beside the lists that hold numbers about the features.
const STATISTICS: [&str; 2] = ["Mean.npy", "Std.npy"];
/// The list of crops.
const INDEX: &str = "index.csv";
/// Widths of KIT-ML, which has the same layout: features, and joints.
const KIT_WIDTH: usize = 251;
const KIT_JOINTS: usize = 21;
/// Clips of the published set whose crop leaves at most one frame.
const KNOWN_EMPTY: [&str; 2] = ["009707", "011059"];
/// Distance in metres between published joints and those recovered from the vector of the same clip
/// that is more than rounding, which measures 2e-7.
const RECOVERY_TOLERANCE_M: f64 = 1e-3;

/// A row of `index.csv`: where a clip was cut from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct IndexRow {
    /// Path as published, such as `./pose_data/KIT/3/kick_high_left02_poses.npy`.
    pub(crate) source_path: String,
    /// First frame at 20 fps, counted after the subset's lead-in.
    pub(crate) start: usize,
    /// One past the last frame; none for the whole recording.
    pub(crate) end: Option<usize>,
    /// Id of the clip.
    pub(crate) id: String,
}

/// Parses the crop list.
///
/// # Errors
/// `E-HML-INDEX` names the line.
pub(crate) fn parse_index(bytes: &[u8]) -> Result<Vec<IndexRow>, Rejected> {
    const COLUMNS: [&str; 4] = ["source_path", "start_frame", "end_frame", "new_name"];
    let bad = |reason: String| Rejected::read("E-HML-INDEX", reason);
    let mut reader = csv::ReaderBuilder::new().flexible(true).from_reader(bytes);
    let header = reader
        .headers()
        .map_err(|error| bad(error.to_string()))?
        .clone();
    let mut places = [0; COLUMNS.len()];
    for (place, column) in places.iter_mut().zip(COLUMNS) {
        *place = header
            .iter()
            .position(|found| found.trim_start_matches('\u{feff}').trim() == column)
            .ok_or_else(|| {
                bad(format!(
                    "found columns {}, expected {}",
                    header.iter().collect::<Vec<_>>().join(", "),
                    COLUMNS.join(", ")
                ))
            })?;
    }
    let mut rows = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|error| bad(error.to_string()))?;
        let line = record.position().map_or(0, csv::Position::line);
        let field = |column: usize| record.get(places[column]).unwrap_or_default().trim();
        let frame = |column: usize| -> Result<Option<usize>, Rejected> {
            match field(column) {
                "-1" => Ok(None),
                text => text.parse().map(Some).map_err(|_| {
                    bad(format!(
                        "found {text:?} as {} in line {line}, expected a frame number",
                        COLUMNS[column]
                    ))
                }),
            }
        };
        let id = field(3);
        let id = id.strip_suffix(".npy").unwrap_or(id).to_owned();
        if id.is_empty() {
            return Err(bad(format!("found no new_name in line {line}")));
        }
        rows.push(IndexRow {
            source_path: field(0).to_owned(),
            start: frame(1)?.unwrap_or(0),
            end: frame(2)?,
            id,
        });
    }
    Ok(rows)
}

/// The original's id of a mirrored copy, `012314` of `M012314`.
pub(crate) fn mirrored_of(id: &str) -> Option<&str> {
    let original = id.strip_prefix('M')?;
    is_original(original).then_some(original)
}

/// Whether this is an id of HumanML3D: six digits, or `M` and six digits.
pub(crate) fn is_id(id: &str) -> bool {
    is_original(id) || mirrored_of(id).is_some()
}

fn is_original(id: &str) -> bool {
    const DIGITS: usize = 6;
    id.len() == DIGITS && id.bytes().all(|byte| byte.is_ascii_digit())
}

/// A clip and its mirror image under one name.
fn clip_of(id: &str) -> &str {
    mirrored_of(id).unwrap_or(id)
}

/// The files of one HumanML3D folder, by what they are.
#[derive(Debug, Default)]
pub(crate) struct Layout {
    /// Path of the folder with a slash at its end; empty for the source itself.
    pub(crate) root: String,
    /// File of each id's joints.
    pub(crate) joints: BTreeMap<String, String>,
    /// File of each id's vector.
    pub(crate) vectors: BTreeMap<String, String>,
    /// File of each id's captions.
    pub(crate) texts: BTreeMap<String, String>,
    /// Ids of each list that is there, by its file, with the split it stands for.
    pub(crate) lists: BTreeMap<String, (Option<Split>, Vec<String>)>,
    /// Other files that belong to the folder: why each is passed over.
    others: Vec<(String, String)>,
    /// The crop list.
    pub(crate) index: Option<(String, Vec<IndexRow>)>,
    /// Files that could not be read.
    rejected: Vec<(String, Rejected)>,
}

/// Finds HumanML3D folders by their layout.
pub(crate) fn layouts(files: &Files) -> Vec<Layout> {
    let mut found: BTreeMap<&str, Layout> = BTreeMap::new();
    for file in files.all() {
        let Some((folder, name)) = file.rsplit_once('/') else {
            continue;
        };
        let parent = folder.rsplit_once('/').map_or(folder, |(_, parent)| parent);
        let root = &folder[..folder.len() - parent.len()];
        let Some((id, extension)) = name.rsplit_once('.') else {
            continue;
        };
        let pick: fn(&mut Layout) -> &mut BTreeMap<String, String> = match (parent, extension) {
            (JOINTS_FOLDER, "npy") => |layout| &mut layout.joints,
            (VECTORS_FOLDER, "npy") => |layout| &mut layout.vectors,
            (TEXTS_FOLDER, "txt") if is_id(id) => |layout| &mut layout.texts,
            _ => continue,
        };
        let layout = found.entry(root).or_default();
        pick(layout).insert(id.to_owned(), file.to_owned());
    }
    found
        .into_iter()
        .map(|(root, mut layout)| {
            layout.root = root.to_owned();
            layout.find_companions(files);
            layout
        })
        .collect()
}

impl Layout {
    /// Finds lists, statistics and the crop list in the folder or the nearest one above that has
    /// them.
    fn find_companions(&mut self, files: &Files) {
        let root = self.root.clone();
        let nearest = |name: &str| {
            above(&root)
                .map(|folder| format!("{folder}{name}"))
                .find(|file| files.contains(file))
        };
        for (name, split) in LISTS {
            let Some(file) = nearest(name) else { continue };
            match files.read(&file) {
                Ok(bytes) => {
                    self.lists.insert(file, (split, parse_list(&bytes)));
                }
                Err(rejected) => self.rejected.push((file, rejected)),
            }
        }
        for name in STATISTICS {
            if let Some(file) = nearest(name) {
                let reason = "statistics of HumanML3D features, no motion".to_owned();
                self.others.push((file, reason));
            }
        }
        if let Some(file) = nearest(INDEX) {
            match files.read(&file).and_then(|bytes| parse_index(&bytes)) {
                Ok(rows) => self.index = Some((file, rows)),
                Err(rejected) => self.rejected.push((file, rejected)),
            }
        }
    }

    /// Whether any motion is there, be it as joints or as a vector.
    pub(crate) fn has_motion(&self, id: &str) -> bool {
        self.vectors.contains_key(id) || self.joints.contains_key(id)
    }

    /// Ids of motions, each once, sorted.
    pub(crate) fn ids(&self) -> impl Iterator<Item = &String> {
        let joints_only = self
            .joints
            .keys()
            .filter(|id| !self.vectors.contains_key(*id));
        let mut ids: Vec<&String> = self.vectors.keys().chain(joints_only).collect();
        ids.sort();
        ids.into_iter()
    }
}

/// A folder and those it lies in, from the inside out, each with a slash at its end.
fn above(root: &str) -> impl Iterator<Item = &str> {
    let ends: Vec<usize> = root.match_indices('/').map(|(at, _)| at + 1).collect();
    ends.into_iter()
        .rev()
        .chain([0])
        .map(move |end| &root[..end])
}

/// The ids of a list, one on each line.
pub(crate) fn parse_list(bytes: &[u8]) -> Vec<String> {
    String::from_utf8_lossy(bytes)
        .trim_start_matches('\u{feff}')
        .lines()
        .map(str::trim)
        .filter(|line| !line.is_empty())
        .map(|line| line.strip_suffix(".npy").unwrap_or(line).to_owned())
        .collect()
}

/// The splits that lists give to clips.
#[derive(Debug, Default)]
pub(crate) struct Splits {
    of_clip: BTreeMap<String, Vec<Split>>,
}

impl Splits {
    /// Gathers the lists. A clip and its mirror image count as one, so that no copy can cross from
    /// one split to another.
    pub(crate) fn of<'a>(lists: impl Iterator<Item = &'a (Option<Split>, Vec<String>)>) -> Self {
        let mut of_clip: BTreeMap<String, Vec<Split>> = BTreeMap::new();
        for (split, ids) in lists {
            for (split, id) in split
                .iter()
                .flat_map(|split| ids.iter().map(move |id| (split, id)))
            {
                let splits = of_clip.entry(clip_of(id).to_owned()).or_default();
                if !splits.contains(split) {
                    splits.push(*split);
                    splits.sort();
                }
            }
        }
        Self { of_clip }
    }

    /// The split of a clip, and a note where lists disagree. The one that is furthest from training
    /// is taken then, so that nothing is trained on that a published result was measured on.
    pub(crate) fn get(&self, id: &str) -> (Option<Split>, Option<String>) {
        let Some(splits) = self.of_clip.get(clip_of(id)) else {
            return (None, None);
        };
        let taken = splits.last().copied();
        let note = (splits.len() > 1).then(|| {
            let names: Vec<&str> = splits.iter().map(|split| split.as_str()).collect();
            format!(
                "listed in several splits ({}); {} was taken",
                names.join(", "),
                taken.map_or("", Split::as_str)
            )
        });
        (taken, note)
    }
}

/// What is known of a clip before it is read.
#[derive(Debug, Default)]
struct Clip {
    vector: Option<String>,
    joints: Option<String>,
    text: Option<String>,
    crop: Option<IndexRow>,
    notes: Vec<String>,
}

/// A HumanML3D folder, whole or in part.
#[derive(Debug)]
struct Folder {
    entries: Vec<Entry>,
    passed_over: Vec<(String, String)>,
    rejected: Vec<(String, Rejected)>,
    clips: BTreeMap<String, Clip>,
}

/// The HumanML3D folders among the files, each found by its layout.
pub fn find(files: &Files) -> Vec<Box<dyn Release>> {
    let folders = layouts(files).into_iter().map(Folder::new);
    folders
        .map(|folder| Box::new(folder) as Box<dyn Release>)
        .collect()
}

impl Folder {
    fn new(layout: Layout) -> Self {
        let splits = Splits::of(layout.lists.values());
        let mut folder = Self {
            entries: Vec::new(),
            passed_over: Vec::new(),
            rejected: Vec::new(),
            clips: BTreeMap::new(),
        };
        let crops: BTreeMap<&str, &IndexRow> = layout
            .index
            .iter()
            .flat_map(|(_, rows)| rows)
            .map(|row| (row.id.as_str(), row))
            .collect();
        for id in layout.ids() {
            let (split, note) = splits.get(id);
            let clip = Clip {
                vector: layout.vectors.get(id).cloned(),
                joints: layout.joints.get(id).cloned(),
                text: layout.texts.get(id).cloned(),
                crop: crops.get(clip_of(id)).map(|row| (*row).clone()),
                notes: note.into_iter().collect(),
            };
            if let (Some(_), Some(joints)) = (&clip.vector, &clip.joints) {
                let reason = "joints of a clip that is read from its HumanML3D vector".to_owned();
                folder.passed_over.push((joints.clone(), reason));
            }
            let Some(file) = clip.vector.clone().or(clip.joints.clone()) else {
                continue;
            };
            folder.entries.push(Entry {
                file,
                key: String::new(),
                id: id.clone(),
                split,
                mirrored_of: mirrored_of(id).map(str::to_owned),
            });
            folder.clips.insert(id.clone(), clip);
        }
        folder.pass_over(layout);
        folder
    }

    /// Accounts for the files that hold no motion.
    fn pass_over(&mut self, layout: Layout) {
        for (id, file) in layout.texts {
            let reason = if self.clips.contains_key(&id) {
                "captions, read with the motion they describe"
            } else {
                "captions without a motion"
            };
            self.passed_over.push((file, reason.to_owned()));
        }
        for file in layout.lists.into_keys() {
            let reason = "HumanML3D list of ids, no motion".to_owned();
            self.passed_over.push((file, reason));
        }
        if let Some((file, _)) = layout.index {
            let reason = "HumanML3D crop list, no motion".to_owned();
            self.passed_over.push((file, reason));
        }
        self.passed_over.extend(layout.others);
        self.rejected.extend(layout.rejected);
    }

    fn read_clip(
        &self,
        files: &Files,
        entry: &Entry,
        skeleton: &Skeleton,
    ) -> Result<SourceClip, Rejected> {
        let unknown = Clip::default();
        let clip = self.clips.get(&entry.id).unwrap_or(&unknown);
        let bytes = files.read(&entry.file)?;
        let mut read = read_array(&bytes, skeleton).map_err(|rejected| {
            let known = rejected.code == TOO_SHORT && KNOWN_EMPTY.contains(&clip_of(&entry.id));
            if known {
                Rejected {
                    reason: format!(
                        "{}; {} is published so: its crop leaves no motion",
                        rejected.reason, entry.id
                    ),
                    ..rejected
                }
            } else {
                rejected
            }
        })?;
        read.notes.extend(clip.notes.iter().cloned());
        if let (Some(_), Some(joints)) = (&clip.vector, &clip.joints) {
            compare(files, &bytes, joints, &mut read);
        }
        if let Some(crop) = &clip.crop {
            read.source_frames = frames_of(crop, read.motion.len());
            read.notes.push(format!(
                "cut from {} (frames at 20 fps after the lead-in of its subset)",
                crop.source_path
            ));
        }
        if let Some(text) = &clip.text {
            let (captions, note) = read_captions(files, text)?;
            read.captions = captions;
            read.notes.extend(note);
        }
        Ok(read)
    }
}

impl Release for Folder {
    fn format(&self) -> Format {
        FORMAT
    }

    fn entries(&self) -> &[Entry] {
        &self.entries
    }

    fn passed_over(&self) -> &[(String, String)] {
        &self.passed_over
    }

    fn rejected(&self) -> &[(String, Rejected)] {
        &self.rejected
    }

    fn read(&self, files: &Files, entry: &Entry, options: &ReadOptions) -> Outcome {
        match self.read_clip(files, entry, &options.skeleton) {
            Ok(clip) => Outcome::Clip(Box::new(clip)),
            Err(rejected) => Outcome::Rejected(rejected),
        }
    }
}

/// The captions of a file, and a note on its lines that are none.
///
/// # Errors
/// `E-IO` if the file cannot be read, `E-LFS-POINTER` if it was never fetched.
pub(crate) fn read_captions(
    files: &Files,
    file: &str,
) -> Result<(Vec<Caption>, Option<String>), Rejected> {
    let bytes = files.read(file)?;
    super::files::refuse_pointer(&bytes)?;
    let (captions, num_other) = labels::parse_captions(&String::from_utf8_lossy(&bytes));
    let note = (num_other > 0)
        .then(|| format!("{num_other} lines of {file} are no captions and were passed over"));
    Ok((captions, note))
}

/// Frames a clip was cut from, as its row tells.
fn frames_of(crop: &IndexRow, num_frames: usize) -> Range<usize> {
    let end = crop.end.unwrap_or(crop.start.saturating_add(num_frames));
    crop.start..end.max(crop.start)
}

/// Holds the joints that come with a vector against those it holds itself.
fn compare(files: &Files, vector: &[u8], joints_file: &str, clip: &mut SourceClip) {
    let stored = files
        .read(joints_file)
        .and_then(|bytes| joints(&npy::read_numbers("joints", &bytes)?));
    let own = npy::read_numbers("features", vector)
        .map_err(Rejected::from)
        .and_then(|array| features(&array));
    let (stored, own) = match (stored, own) {
        (Ok(stored), Ok(own)) => (stored, recover_joints(&own)),
        (Err(rejected), _) | (_, Err(rejected)) => {
            let reason = rejected.reason;
            clip.notes
                .push(format!("{joints_file} was not compared: {reason}"));
            return;
        }
    };
    if stored.len() != own.len() {
        clip.flags |= FLAG_POOR_FIT;
        clip.notes.push(format!(
            "{joints_file} has {} frames, the vector {}",
            stored.len(),
            own.len()
        ));
        return;
    }
    let apart = stored
        .as_flattened()
        .iter()
        .zip(own.as_flattened())
        .map(|(a, b)| a.distance(*b))
        .fold(0.0, f64::max);
    if apart > RECOVERY_TOLERANCE_M {
        clip.flags |= FLAG_POOR_FIT;
    }
    clip.notes.push(format!(
        "joints recovered from the vector lie within {apart:.1e} m of {joints_file}"
    ));
}

/// Says what a lone npy array is, by its shape.
pub(crate) fn recognise_array(head: &[u8]) -> Recognised {
    let not_motion = |reason: String| Recognised::NotMotion { reason };
    let Ok(shape) = Header::peek_shape("array", head) else {
        // Reading it tells what is wrong, be it damaged, pickled or not fetched.
        return Recognised::Motion(FORMAT);
    };
    match shape[..] {
        [_, HUMANML3D_WIDTH | KIT_WIDTH] | [_, NUM_BODY_JOINTS | KIT_JOINTS, 3] => {
            Recognised::Motion(FORMAT)
        }
        [_, 66] => not_motion(
            "npy array of 66 columns, which may be positions or rotations of 22 joints; save \
             positions as [frames, 22, 3]"
                .to_owned(),
        ),
        _ => not_motion(format!(
            "npy array of {} dimensions, no motion",
            shape.len()
        )),
    }
}

const TOO_SHORT: &str = "E-TOO-SHORT";

/// Reads a 263-d vector or joint positions as a motion of the given body.
///
/// # Shapes
/// `[T, 263]`, or `[T, 22, 3]` in metres, y up.
///
/// # Errors
/// Those of [`npy`], `E-HML-SHAPE`, `E-HML-FINITE`, `E-HML-FIT` or `E-TOO-SHORT`.
pub(crate) fn read_array(bytes: &[u8], skeleton: &Skeleton) -> Result<SourceClip, Rejected> {
    super::files::refuse_pointer(bytes)?;
    let array = npy::read_numbers("array", bytes)?;
    let unfit = |error: &dyn std::fmt::Display| {
        Rejected::retarget("E-HML-FIT", format!("no body has these joints: {error}"))
    };
    let (motion, fit_error_m, source, note) = if array.shape.last() == Some(&HUMANML3D_WIDTH) {
        let features = features(&array)?;
        let (motion, error) =
            motion_of_features(&features, FPS, skeleton).map_err(|error| unfit(&error))?;
        let note = "rotations from the HumanML3D vector, 20 fps";
        (motion, error, RotationSource::Retargeted, note)
    } else {
        let joints = joints(&array)?;
        let (motion, error) =
            motion_of_joints(&joints, FPS, skeleton).map_err(|error| unfit(&error))?;
        let note = "rotations fitted to HumanML3D joints, 20 fps";
        (motion, error, RotationSource::Fitted, note)
    };
    let mut clip = SourceClip::new(motion, source);
    clip.fit_error_m = Some(fit_error_m);
    clip.notes.push(note.to_owned());
    Ok(clip)
}

pub(crate) fn features(array: &Array) -> Result<Vec<[f32; HUMANML3D_WIDTH]>, Rejected> {
    let [num_frames, HUMANML3D_WIDTH] = array.shape[..] else {
        return Err(bad_shape(array));
    };
    check_frames(array, num_frames)?;
    let (rows, _) = array.values.as_chunks::<HUMANML3D_WIDTH>();
    Ok(rows
        .iter()
        .map(|row| row.map(|value| value as f32))
        .collect())
}

pub(crate) fn joints(array: &Array) -> Result<Vec<[DVec3; NUM_BODY_JOINTS]>, Rejected> {
    let num_frames = match array.shape[..] {
        [num_frames, NUM_BODY_JOINTS, 3] => num_frames,
        // The published code drops the axis of a single frame.
        [NUM_BODY_JOINTS, 3] => 1,
        _ => return Err(bad_shape(array)),
    };
    check_frames(array, num_frames)?;
    let (points, _) = array.values.as_chunks::<3>();
    let (frames, _) = points.as_chunks::<NUM_BODY_JOINTS>();
    Ok(frames
        .iter()
        .map(|frame| frame.map(DVec3::from_array))
        .collect())
}

fn bad_shape(array: &Array) -> Rejected {
    let kit = matches!(array.shape[..], [_, KIT_WIDTH] | [_, KIT_JOINTS, 3]);
    let hint = if kit {
        "; this is the shape of KIT-ML, whose body has 21 joints and is not read"
    } else {
        ""
    };
    Rejected::read(
        "E-HML-SHAPE",
        format!(
            "found an array of shape {:?}, expected [frames, {HUMANML3D_WIDTH}] or [frames, \
             {NUM_BODY_JOINTS}, 3]{hint}",
            array.shape
        ),
    )
}

fn check_frames(array: &Array, num_frames: usize) -> Result<(), Rejected> {
    if num_frames < 2 {
        return Err(Rejected::read(
            TOO_SHORT,
            format!("found {num_frames} frames, expected at least 2"),
        ));
    }
    let broken = |value: &f64| !(*value as f32).is_finite();
    match array.values.iter().position(broken) {
        Some(at) => Err(Rejected::read(
            "E-HML-FINITE",
            format!(
                "found {} in frame {}, expected finite numbers",
                array.values[at],
                at / (array.values.len() / num_frames)
            ),
        )),
        None => Ok(()),
    }
}

/// A HumanML3D folder: joints, 263-d vectors, captions and split lists.
pub const FORMAT: Format = Format::new(&HumanMl3d);

#[derive(Debug)]
struct HumanMl3d;

impl SourceFormat for HumanMl3d {
    fn name(&self) -> &'static str {
        "humanml3d"
    }

    fn bytes_per_second(&self) -> f64 {
        (size_of::<[f32; HUMANML3D_WIDTH]>() as f64) * FPS.get()
    }

    fn by_name(&self, extension: &str, _name: &str, head: &[u8]) -> Option<Recognised> {
        (extension == "npy").then(|| recognise_array(head))
    }

    fn read(&self, _path: &Path, _key: &str, bytes: &[u8], options: &ReadOptions) -> Outcome {
        match read_array(bytes, &options.skeleton) {
            Ok(clip) => Outcome::Clip(Box::new(clip)),
            Err(rejected) => Outcome::Rejected(rejected),
        }
    }

    fn find(
        &self,
        files: &Files,
        _index: Option<&Path>,
    ) -> Result<Vec<Box<dyn Release>>, crate::Error> {
        Ok(find(files))
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::PathBuf;

    use datasets_spec::Motion;
    use proptest::prelude::*;

    use super::*;
    use crate::feature::humanml3d::{features_of_joints, joints_of_motion};
    use crate::fixture::{npy, npy_f8};
    use crate::retarget::tests::walk;

    /// Files in a temporary folder.
    struct Source {
        folder: tempfile::TempDir,
        paths: BTreeMap<String, PathBuf>,
    }

    impl Source {
        fn new(files: &[(&str, &[u8])]) -> Self {
            let mut source = Self {
                folder: tempfile::tempdir().expect("temporary folder"),
                paths: BTreeMap::new(),
            };
            for (name, bytes) in files {
                let path = source.folder.path().join(name);
                fs::create_dir_all(path.parent().expect("a folder")).expect("made");
                fs::write(&path, bytes).expect("written");
                source.paths.insert((*name).to_owned(), path);
            }
            source
        }

        fn files(&self) -> Files {
            Files::new(self.paths.clone())
        }
    }

    fn walking() -> Vec<[DVec3; 22]> {
        let motion = Motion::from_poses(FPS, &walk(30)).expect("valid");
        joints_of_motion(&motion, &Skeleton::smplx_neutral())
    }

    fn vector() -> Vec<u8> {
        let features = features_of_joints(&walking()).expect("long enough");
        let values: Vec<f64> = features.iter().flatten().map(|&v| f64::from(v)).collect();
        npy_f8(&[features.len(), 263], &values)
    }

    fn joint_file(joints: &[[DVec3; 22]]) -> Vec<u8> {
        let values: Vec<f64> = joints
            .iter()
            .flatten()
            .flat_map(|joint| joint.to_array())
            .collect();
        npy_f8(&[joints.len(), 22, 3], &values)
    }

    fn clip_of_entry(release: &dyn Release, files: &Files, id: &str) -> SourceClip {
        let entry = release
            .entries()
            .iter()
            .find(|entry| entry.id == id)
            .expect("planned");
        match release.read(files, entry, &ReadOptions::default()) {
            Outcome::Clip(clip) => *clip,
            outcome => panic!("{id}: {outcome:?}"),
        }
    }

    #[test]
    fn a_folder_is_found_wherever_it_lies_and_every_file_is_accounted_for() {
        let vector = vector();
        let recovered = {
            let array = npy::read_numbers("x", &vector).expect("valid");
            recover_joints(&features(&array).expect("valid"))
        };
        let joints = joint_file(&recovered);
        let source = Source::new(&[
            ("deep/hml/new_joint_vecs/000001.npy", &vector),
            ("deep/hml/new_joint_vecs/M000001.npy", &vector),
            ("deep/hml/new_joints/000001.npy", &joints),
            ("deep/hml/new_joints/000002.npy", &joint_file(&walking())),
            (
                "deep/hml/texts/000001.txt",
                b"a man walks#a/DET#0.0#0.0\nbroken\n",
            ),
            ("deep/hml/texts/000009.txt", b"nobody#a/DET#0.0#0.0\n"),
            ("deep/hml/train.txt", b"\xEF\xBB\xBF000001\r\nM000001\r\n\r\n"),
            ("deep/test.txt", b"000002\n000001\n"),
            ("deep/hml/Mean.npy", &npy_f8(&[263], &[0.0; 263])),
            (
                "deep/index.csv",
                b"source_path,start_frame,end_frame,new_name\n./pose_data/KIT/3/a_poses.npy,7,36,000001.npy\n",
            ),
        ]);
        let files = source.files();
        let releases = find(&files);
        let [release] = &releases[..] else {
            panic!("one folder, found {}", releases.len());
        };
        let planned: Vec<(&str, Option<Split>, Option<&str>)> = release
            .entries()
            .iter()
            .map(|entry| (entry.id.as_str(), entry.split, entry.mirrored_of.as_deref()))
            .collect();
        assert_eq!(
            planned,
            [
                ("000001", Some(Split::Test), None),
                ("000002", Some(Split::Test), None),
                ("M000001", Some(Split::Test), Some("000001")),
            ]
        );
        let mut named: Vec<&str> = release
            .entries()
            .iter()
            .map(|entry| entry.file.as_str())
            .chain(release.passed_over().iter().map(|(file, _)| file.as_str()))
            .collect();
        named.sort_unstable();
        assert_eq!(named, files.all().collect::<Vec<_>>());
        let reason = |file: &str| {
            let found = release.passed_over().iter().find(|(name, _)| name == file);
            found.expect("passed over").1.as_str()
        };
        assert_eq!(
            reason("deep/hml/texts/000009.txt"),
            "captions without a motion"
        );

        let clip = clip_of_entry(release.as_ref(), &files, "000001");
        assert_eq!(clip.motion.len(), 29);
        assert_eq!(clip.rotation_source, RotationSource::Retargeted);
        assert_eq!(clip.source_frames, 7..36);
        assert_eq!(clip.captions[0].tokens, "a/DET");
        assert_eq!(clip.flags, 0);
        let notes = clip.notes.join("\n");
        for part in ["train, test", "KIT/3/a_poses", "1 lines", "within"] {
            assert!(notes.contains(part), "{part}: {notes}");
        }
        let fitted = clip_of_entry(release.as_ref(), &files, "000002");
        assert_eq!(fitted.rotation_source, RotationSource::Fitted);
        assert!(fitted.fit_error_m.expect("measured") < 0.05);
    }

    #[test]
    fn joints_that_contradict_their_vector_are_flagged() {
        let vector = vector();
        let source = Source::new(&[
            ("h/new_joint_vecs/000001.npy", &vector),
            ("h/new_joints/000001.npy", &joint_file(&walking()[..29])),
        ]);
        let files = source.files();
        let releases = find(&files);
        let clip = clip_of_entry(releases[0].as_ref(), &files, "000001");
        assert_eq!(clip.flags, FLAG_POOR_FIT, "other bone lengths");
    }

    #[test]
    fn what_is_wrong_is_rejected_by_code() {
        let skeleton = Skeleton::smplx_neutral();
        let code = |bytes: &[u8]| match read_array(bytes, &skeleton) {
            Err(rejected) => (rejected.code, rejected.reason),
            Ok(_) => ("accepted", String::new()),
        };
        assert_eq!(code(&vector()).0, "accepted");
        assert_eq!(code(&npy_f8(&[1, 263], &[0.0; 263])).0, "E-TOO-SHORT");
        assert_eq!(code(&npy_f8(&[0, 263], &[])).0, "E-TOO-SHORT");
        assert_eq!(code(&npy_f8(&[22, 3], &[0.0; 66])).0, "E-TOO-SHORT");
        assert_eq!(code(&npy_f8(&[2, 22, 3], &[0.0; 132])).0, "E-HML-FIT");
        let kit = code(&npy_f8(&[2, 251], &[0.0; 502]));
        assert_eq!(kit.0, "E-HML-SHAPE");
        assert!(kit.1.contains("KIT-ML"));
        let mut broken = vec![0.0; 2 * 263];
        broken[263] = f64::NAN;
        let broken = code(&npy_f8(&[2, 263], &broken));
        assert_eq!(broken.0, "E-HML-FINITE");
        assert!(broken.1.contains("frame 1"), "{}", broken.1);
        let objects = "{'descr': '|O', 'fortran_order': False, 'shape': (2, 263), }";
        assert_eq!(code(&npy(objects, b".")).0, "E-PICKLE-REFUSED");
        let pointer = b"version https://git-lfs.github.com/spec/v1\n";
        assert_eq!(code(pointer).0, "E-LFS-POINTER");
    }

    #[test]
    fn clips_published_without_frames_are_known() {
        let source = Source::new(&[("new_joint_vecs/M009707.npy", &npy_f8(&[0, 263], &[]))]);
        let files = source.files();
        let releases = find(&files);
        let entry = &releases[0].entries()[0];
        let Outcome::Rejected(rejected) = releases[0].read(&files, entry, &ReadOptions::default())
        else {
            panic!("no motion");
        };
        assert_eq!(rejected.code, "E-TOO-SHORT");
        assert!(
            rejected.reason.contains("published so"),
            "{}",
            rejected.reason
        );
    }

    #[test]
    fn a_lone_array_is_told_by_its_shape() {
        let is_motion = |shape: &[usize]| {
            let bytes = npy_f8(shape, &vec![0.0; shape.iter().product()]);
            matches!(recognise_array(&bytes[..128]), Recognised::Motion(_))
        };
        assert!(is_motion(&[9, 263]) && is_motion(&[9, 22, 3]) && is_motion(&[9, 251]));
        assert!(!is_motion(&[263]) && !is_motion(&[9, 66]) && !is_motion(&[9, 52, 3]));
        assert!(matches!(recognise_array(b"junk"), Recognised::Motion(_)));
    }

    #[test]
    fn an_index_is_read_by_its_header() {
        let rows = parse_index(
            b"\xEF\xBB\xBFnew_name,source_path,start_frame,end_frame\r\n\
              000001.npy,./pose_data/humanact12/humanact12/P1.npy,0,-1\r\n",
        )
        .expect("columns in another order");
        assert_eq!((rows[0].id.as_str(), rows[0].end), ("000001", None));
        for bad in [
            &b"a,b\n1,2\n"[..],
            b"source_path,start_frame,end_frame,new_name\nx,one,2,3.npy\n",
            b"source_path,start_frame,end_frame,new_name\nx,1,2\n",
        ] {
            assert_eq!(parse_index(bad).expect_err("broken").code, "E-HML-INDEX");
        }
    }

    proptest! {
        #[test]
        fn no_bytes_make_it_panic(
            bytes in prop::collection::vec(any::<u8>(), 0..200),
            edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
            values in prop::collection::vec(-1e6..1e6f64, 2 * 263),
        ) {
            let skeleton = Skeleton::smplx_neutral();
            let valid = npy_f8(&[2, 263], &values);
            let mut mutated = valid.clone();
            for (at, byte) in edits {
                let at = at.index(mutated.len());
                mutated[at] = byte;
            }
            for candidate in [&bytes, &mutated, &valid] {
                let _ = recognise_array(candidate);
                let _ = parse_index(candidate);
                if let Ok(clip) = read_array(candidate, &skeleton) {
                    prop_assert!(clip.motion.len() >= 2);
                }
            }
        }
    }

    #[test]
    fn the_published_clip_and_its_neighbours_are_read() {
        let Some(root) = std::env::var_os("STANCE_TEST_DATA").map(PathBuf::from) else {
            skipped();
            return;
        };
        let folder = root.join("humanml3d");
        let paths = [
            "new_joint_vecs/012314.npy",
            "new_joints/012314.npy",
            "index.csv",
            "train.txt",
            "val.txt",
            "test.txt",
        ]
        .map(|name| (name.to_owned(), folder.join(name)));
        let files = Files::new(BTreeMap::from(paths));
        let releases = find(&files);
        let clip = clip_of_entry(releases[0].as_ref(), &files, "012314");
        assert_eq!((clip.motion.len(), clip.flags), (170, 0));
        assert!(clip.fit_error_m.expect("measured") < 0.03);
        assert!(releases[0].entries()[0].split.is_some());
        let skeleton = Skeleton::smplx_neutral();
        crate::check::check(&clip.motion, &skeleton).expect("a plain motion");

        let lone = |name: &str| fs::read(root.join(name)).expect("a file of the folder");
        let style = lone("humanml3d/100style_feats/Aeroplane_FW_00_feat.npy");
        assert_eq!(recognise_array(&style), Recognised::Motion(FORMAT));
        assert_eq!(
            read_array(&style, &skeleton)
                .expect("features")
                .motion
                .len(),
            352
        );
        let pickled = lone("motionfix_labels/statistics_motionfix.npy");
        assert_eq!(recognise_array(&pickled), Recognised::Motion(FORMAT));
        let rejected = read_array(&pickled, &skeleton).expect_err("pickled");
        assert_eq!(rejected.code, "E-PICKLE-REFUSED");
    }

    #[expect(
        clippy::print_stderr,
        reason = "a test that checks nothing must say so"
    )]
    fn skipped() {
        eprintln!("SKIPPED: STANCE_TEST_DATA names no folder");
    }
}
