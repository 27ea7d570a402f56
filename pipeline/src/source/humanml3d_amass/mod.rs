//! HumanML3D's clips cut from AMASS recordings by the published `index.csv`.
//!
//! The stored motion keeps the recording's own rotations. The published joints and features follow
//! from it by [`crate::feature::humanml3d`]; the published ones were made of each subject's own
//! body, so they differ by as much as the bodies do.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use datasets_spec::table::Caption;
use datasets_spec::{Fps, Joint, Motion, Skeleton, Split};
use glam::{DMat3, DQuat, DVec3};
use kinematics::skeleton::{NUM_BODY_JOINTS, NUM_JOINTS};

use super::amass::catalogue::{Recording, Subset};
use super::amass::{self, Parameters, Parsed};
use super::files::Files;
use super::format::{Entry, Format, Release, SourceFormat};
use super::humanml3d::{self, IndexRow, Splits};
use super::options::ReadOptions;
use crate::Error;
use crate::check::FLAG_FPS_DOUBTFUL;
use crate::clip::{Outcome, Rejected, RotationSource, SourceClip};
use crate::floor;

/// Part of the path of the rows that were not made of AMASS but of HumanAct12's joints.
const HUMANACT12: &str = "humanact12";
/// Longest sequence of frames a crop may lack at its end: one frame is lost where a rate is rounded.
const END_TOLERANCE: usize = 1;

/// A crop of a recording that is among the files.
#[derive(Clone, Debug)]
struct Crop {
    row: IndexRow,
    subset: &'static str,
    lead_in_frames: usize,
    /// Captions of the clip, and of its mirror image.
    texts: [Option<String>; 2],
    note: Option<String>,
}

/// HumanML3D's clips among AMASS files.
#[derive(Debug)]
struct Cuts {
    entries: Vec<Entry>,
    passed_over: Vec<(String, String)>,
    rejected: Vec<(String, Rejected)>,
    crops: BTreeMap<String, Crop>,
}

/// AMASS files by the recording they hold. Where several releases of one are there, that of SMPL-H,
/// which the published frame numbers belong to, comes first.
pub(crate) fn recordings(files: &Files) -> BTreeMap<Recording, Vec<String>> {
    let mut found: BTreeMap<Recording, Vec<String>> = BTreeMap::new();
    for file in files.all().filter(|file| file.ends_with(".npz")) {
        // The folder given may be the subset itself, whose name the relative path lacks.
        let path = files.path(file).unwrap_or(Path::new(file));
        if let Some(recording) = Recording::of(path) {
            found.entry(recording).or_default().push(file.to_owned());
        }
    }
    for files in found.values_mut() {
        files.sort_by_key(|file| !file.ends_with("_poses.npz"));
    }
    found
}

/// Whether a row was made of HumanAct12's joints.
pub(crate) fn is_humanact12(row: &IndexRow) -> bool {
    row.source_path.contains(HUMANACT12)
}

/// Plans HumanML3D's clips, and their mirror images, of every row of the index whose recording is
/// among the files. Captions are taken from `texts` folders among the files, splits from lists
/// among them or beside the index.
///
/// # Errors
/// The index cannot be read or is none.
pub fn find(files: &Files, index: &Path) -> Result<Box<dyn Release>, Error> {
    let bytes = fs::read(index).map_err(Error::io("read", index))?;
    let rows = humanml3d::parse_index(&bytes).map_err(|rejected| Error::Index {
        path: index.to_owned(),
        reason: rejected.reason,
    })?;
    let layouts = humanml3d::layouts(files);
    let texts: BTreeMap<&str, &str> = layouts
        .iter()
        .flat_map(|layout| &layout.texts)
        .map(|(id, file)| (id.as_str(), file.as_str()))
        .collect();
    let beside = lists_beside(index);
    let listed = layouts.iter().flat_map(|layout| layout.lists.values());
    let splits = Splits::of(listed.chain(&beside));

    let recordings = recordings(files);
    let index_name = index.file_name().unwrap_or_default().to_string_lossy();
    let mut cuts = Cuts {
        entries: Vec::new(),
        passed_over: Vec::new(),
        rejected: Vec::new(),
        crops: BTreeMap::new(),
    };
    let mut used = BTreeSet::new();
    for row in rows {
        let item = format!("{index_name}#{}", row.id);
        let recording = Recording::of(Path::new(&row.source_path));
        let file = recording
            .as_ref()
            .and_then(|recording| recordings.get(recording)?.first());
        let (Some(recording), Some(file)) = (recording, file) else {
            let reason = if is_humanact12(&row) {
                "row of HumanAct12, which has joints and no body parameters"
            } else {
                "row whose AMASS recording is not among the sources"
            };
            cuts.passed_over
                .push((item, format!("HumanML3D index {reason}")));
            continue;
        };
        used.insert(file.as_str());
        cuts.plan(row, &recording, file, &texts, &splits);
    }
    for file in recordings.values().flatten() {
        if !used.contains(file.as_str()) {
            let reason = "AMASS file that the HumanML3D index takes nothing from".to_owned();
            cuts.passed_over.push((file.clone(), reason));
        }
    }
    cuts.pass_over_texts(&texts);
    Ok(Box::new(cuts))
}

/// The split lists in the folder of the index, and in the folder of the published repository
/// below it.
fn lists_beside(index: &Path) -> Vec<(Option<Split>, Vec<String>)> {
    let folder = index.parent().unwrap_or(Path::new("."));
    let read = |name: &str| {
        [folder.to_owned(), folder.join("HumanML3D")]
            .iter()
            .find_map(|folder| fs::read(folder.join(name)).ok())
    };
    humanml3d::LISTS
        .into_iter()
        .filter_map(|(name, split)| Some((split, humanml3d::parse_list(&read(name)?))))
        .collect()
}

impl Cuts {
    fn plan(
        &mut self,
        row: IndexRow,
        recording: &Recording,
        file: &str,
        texts: &BTreeMap<&str, &str>,
        splits: &Splits,
    ) {
        let mirrored = format!("M{}", row.id);
        let (split, note) = splits.get(&row.id);
        let text = |id: &str| texts.get(id).map(|file| (*file).to_owned());
        for (id, mirrored_of) in [
            (row.id.clone(), None),
            (mirrored.clone(), Some(row.id.clone())),
        ] {
            self.entries.push(Entry {
                file: file.to_owned(),
                key: id.clone(),
                id,
                split,
                mirrored_of,
            });
        }
        let crop = Crop {
            subset: recording.subset,
            lead_in_frames: Subset::named(recording.subset)
                .map_or(0, |subset| subset.lead_in_frames),
            texts: [text(&row.id), text(&mirrored)],
            note,
            row,
        };
        self.crops.insert(crop.row.id.clone(), crop);
    }

    fn pass_over_texts(&mut self, texts: &BTreeMap<&str, &str>) {
        for (id, file) in texts {
            let clip = humanml3d::mirrored_of(id).unwrap_or(id);
            if self.crops.contains_key(clip) {
                let reason = "captions, read with the motion they describe".to_owned();
                self.passed_over.push(((*file).to_owned(), reason));
            }
        }
    }

    fn read_clip(
        &self,
        files: &Files,
        entry: &Entry,
        options: &ReadOptions,
    ) -> Result<SourceClip, Rejected> {
        let skeleton = &options.skeleton;
        let is_mirrored = entry.mirrored_of.is_some();
        let id = entry.mirrored_of.as_ref().unwrap_or(&entry.id);
        let crop = self.crops.get(id).ok_or_else(|| {
            Rejected::read("E-HML-INDEX", format!("found no row {id} in the index"))
        })?;
        let bytes = files.read(&entry.file)?;
        super::files::refuse_pointer(&bytes)?;
        let parameters = match amass::parse(&bytes)? {
            Parsed::Parameters(parameters) => *parameters,
            Parsed::NoMotion { reason } => return Err(Rejected::read("E-AMASS-KEYS", reason)),
        };
        let mut clip = cut(&parameters, crop, options)?;
        if is_mirrored {
            clip.motion = on_floor(mirror(&clip.motion), skeleton);
            clip.body = clip.body.as_ref().map(mirrored_body);
        }
        clip.notes.extend(crop.note.iter().cloned());
        let (captions, note) = crop.captions(files, is_mirrored)?;
        clip.captions = captions;
        clip.notes.extend(note);
        Ok(clip)
    }
}

impl Release for Cuts {
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
        match self.read_clip(files, entry, options) {
            Ok(clip) => Outcome::Clip(Box::new(clip)),
            Err(rejected) => Outcome::Rejected(rejected),
        }
    }
}

impl Crop {
    /// The captions of the clip or of its mirror image, which are those of the clip with the sides
    /// swapped where it has no file of its own.
    fn captions(
        &self,
        files: &Files,
        is_mirrored: bool,
    ) -> Result<(Vec<Caption>, Option<String>), Rejected> {
        let [own, mirrored] = &self.texts;
        match (is_mirrored, own, mirrored) {
            (false, Some(file), _) | (true, _, Some(file)) => humanml3d::read_captions(files, file),
            (true, Some(file), None) => {
                let (captions, note) = humanml3d::read_captions(files, file)?;
                let swapped = captions.into_iter().map(|caption| Caption {
                    text: swap_sides(&caption.text),
                    tokens: swap_sides(&caption.tokens),
                    ..caption
                });
                Ok((swapped.collect(), note))
            }
            (_, None, _) => Ok((Vec::new(), None)),
        }
    }
}

/// The rotation `(x, y, z)` to `(-x, z, y)` that HumanML3D turns AMASS by: z up to y up, and half a
/// turn about the vertical.
fn humanml3d_turn() -> DQuat {
    let axes = DMat3::from_cols(DVec3::NEG_X, DVec3::Z, DVec3::Y);
    DQuat::from_mat3(&axes)
}

/// Frames of a recording that a clip is made of.
///
/// Every `floor(fps / 20)`-th frame counts, none is interpolated; the lead-in and then the crop are
/// counted in these. A crop that ends behind the recording ends with it.
///
/// # Source
/// EricGuo5513/HumanML3D, `raw_pose_processing`.
fn frames_of(
    num_frames: usize,
    stride: usize,
    lead_in_frames: usize,
    row: &IndexRow,
) -> Vec<usize> {
    let strided = (0..num_frames).step_by(stride).skip(lead_in_frames);
    let len = row
        .end
        .map_or(usize::MAX, |end| end.saturating_sub(row.start));
    strided.skip(row.start).take(len).collect()
}

/// Cuts a clip out of a recording.
fn cut(
    parameters: &Parameters<'_>,
    crop: &Crop,
    options: &ReadOptions,
) -> Result<SourceClip, Rejected> {
    let skeleton = &options.skeleton;
    let fps = humanml3d::FPS;
    let stated = parameters.stated_fps;
    // Rounding the rate first would move every frame of a recording at 119.99 fps.
    let stride = (stated / fps.get()).floor() as usize;
    if stride == 0 {
        return Err(Rejected::read(
            "E-AMASS-FPS",
            format!("found {stated} fps, expected at least {fps} to cut HumanML3D's clips from"),
        ));
    }
    let row = &crop.row;
    let frames = frames_of(parameters.num_frames(), stride, crop.lead_in_frames, row);
    let wanted = row.end.map(|end| end.saturating_sub(row.start));
    if frames.len() < 2 {
        return Err(Rejected::read(
            "E-TOO-SHORT",
            format!(
                "found {} frames of the crop {}..{} in {} frames at {stated} fps, expected at \
                 least 2",
                frames.len(),
                row.start,
                row.end.map_or("end".to_owned(), |end| end.to_string()),
                parameters.num_frames()
            ),
        ));
    }
    let motion = parameters.motion(&frames, humanml3d_turn(), fps, skeleton)?;
    let mut clip = SourceClip::new(motion, RotationSource::Native);
    let last = frames.last().copied().unwrap_or(0);
    clip.source_frames = frames.first().copied().unwrap_or(0)..last + 1;
    clip.body = parameters.body(options);
    clip.notes = parameters.notes(skeleton, clip.body.is_some());
    clip.notes.push(format!(
        "cut from {} of subset {}: every {stride}. frame of {stated} fps, frames {}..{} after a \
         lead-in of {}",
        row.source_path,
        crop.subset,
        row.start,
        row.start + frames.len(),
        crop.lead_in_frames
    ));
    if clip.body.is_none() {
        clip.notes.push(format!(
            "the published joints and features are those of the subject's body; what is made of \
             this clip is that of {}",
            skeleton.name()
        ));
    }
    let missing = wanted.map_or(0, |wanted| wanted.saturating_sub(frames.len()));
    if missing > END_TOLERANCE {
        clip.flags |= FLAG_FPS_DOUBTFUL;
        clip.notes.push(format!(
            "the crop wants {missing} frames more than the recording has at its stated rate"
        ));
    }
    if parameters.variant.is_smplx() {
        clip.notes.push(
            "cut from SMPL-X parameters; the crop counts frames of the SMPL-H G release, whose \
             rate differs in some recordings"
                .to_owned(),
        );
    }
    if true_rate_differs(stated, fps, stride) {
        clip.notes.push(format!(
            "its true rate is {} fps, stored as {} as published",
            stated / stride as f64,
            fps.get()
        ));
    }
    Ok(clip)
}

/// Whether taking every `stride`-th frame misses the nominal rate by more than rounding.
fn true_rate_differs(stated: f64, fps: Fps, stride: usize) -> bool {
    const TOLERANCE: f64 = 1e-3;
    (stated / stride as f64 / fps.get() - 1.0).abs() > TOLERANCE
}

/// The mirror image of a motion in the plane between the body's sides: each joint takes the
/// rotation `(rx, -ry, -rz)` of its counterpart, and x changes its sign.
///
/// The rest skeleton is not symmetric, so joints differ from mirrored joints by up to 3.5 cm.
pub(crate) fn mirror(motion: &Motion) -> Motion {
    let mut mirrored = motion.clone();
    for frame in 0..motion.len() {
        let [x, y, z] = motion.transl()[frame];
        mirrored.set_transl(frame, [-x, y, z]);
        for joint in Joint::ALL {
            let [rx, ry, rz] = motion.axis_angle(frame, joint.mirrored().index());
            mirrored.set_axis_angle(frame, joint.index(), [rx, -ry, -rz]);
        }
    }
    debug_assert_eq!(Joint::ALL.len(), NUM_BODY_JOINTS);
    mirrored
}

/// The mirror image of a body at rest: what [`mirror`] is to motions.
fn mirrored_body(body: &Skeleton) -> Skeleton {
    let mut joints: [DVec3; NUM_JOINTS] = std::array::from_fn(|joint| body.rest(joint));
    for joint in Joint::ALL {
        let [x, y, z] = body.rest(joint.mirrored().index()).to_array();
        joints[joint.index()] = DVec3::new(-x, y, z);
    }
    Skeleton::new(body.name(), joints)
}

fn on_floor(mut motion: Motion, skeleton: &Skeleton) -> Motion {
    let mut poses: Vec<_> = motion.poses();
    let rise = floor::put_on_floor(&mut poses, motion.fps(), skeleton);
    for frame in 0..motion.len() {
        let [x, y, z] = motion.transl()[frame];
        motion.set_transl(frame, [x, (f64::from(y) + rise) as f32, z]);
    }
    motion
}

/// Text in which left and right have changed places, and so have clockwise and counterclockwise.
///
/// Works on captions and on their `lemma/POS` tokens alike. Every "left" is swapped, a form of
/// "leave" too, as in the published captions.
pub(crate) fn swap_sides(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(first) = rest.chars().next() {
        let letters = rest
            .find(|c: char| !c.is_alphabetic())
            .unwrap_or(rest.len());
        if letters == 0 {
            out.push(first);
            rest = &rest[first.len_utf8()..];
            continue;
        }
        let (word, after) = rest.split_at(letters);
        if let Some(after) = counter_clockwise(word, after) {
            out += &in_case_of(word, "clockwise");
            rest = after;
            continue;
        }
        match other_side(&word.to_lowercase()) {
            Some(swapped) => out += &in_case_of(word, &swapped),
            None => out += word,
        }
        rest = after;
    }
    out
}

/// What follows a "counter clockwise" or "anti-clockwise" that is written in two words.
fn counter_clockwise<'a>(word: &str, after: &'a str) -> Option<&'a str> {
    const TURN: &str = "clockwise";
    if !["counter", "anti"].contains(&word.to_lowercase().as_str()) {
        return None;
    }
    let next = after.strip_prefix(['-', ' '])?;
    let (turn, rest) = next.split_at_checked(TURN.len())?;
    turn.eq_ignore_ascii_case(TURN).then_some(rest)
}

/// The lower-case word that means the other side, or the other way round.
fn other_side(word: &str) -> Option<String> {
    const ENDS: [&str; 7] = ["", "s", "y", "ward", "wards", "hand", "handed"];
    for (side, other) in [("left", "right"), ("right", "left")] {
        if let Some(end) = word.strip_prefix(side)
            && ENDS.contains(&end)
        {
            return Some(format!("{other}{end}"));
        }
    }
    match word {
        "clockwise" => Some("counterclockwise".to_owned()),
        "counterclockwise" | "anticlockwise" => Some("clockwise".to_owned()),
        _ => None,
    }
}

/// A word with the capital of another.
fn in_case_of(model: &str, word: &str) -> String {
    let mut chars = word.chars();
    match (model.chars().next(), chars.next()) {
        (Some(capital), Some(first)) if capital.is_uppercase() => {
            first.to_uppercase().chain(chars).collect()
        }
        _ => word.to_owned(),
    }
}

/// HumanML3D's clips, cut from AMASS by its `index.csv`.
pub const FORMAT: Format = Format::new(&HumanMl3dAmass);

#[derive(Debug)]
struct HumanMl3dAmass;

impl SourceFormat for HumanMl3dAmass {
    fn name(&self) -> &'static str {
        "humanml3d-amass"
    }

    fn bytes_per_second(&self) -> f64 {
        super::humanml3d::FORMAT.bytes_per_second()
    }

    fn find(
        &self,
        files: &Files,
        index: Option<&Path>,
    ) -> Result<Vec<Box<dyn Release>>, crate::Error> {
        index.map(|index| find(files, index)).into_iter().collect()
    }
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;
    use std::sync::Arc;

    use proptest::prelude::*;

    use super::*;
    use crate::feature::smpl_body;
    use crate::fixture::npy_f8;
    use crate::fixture::npz;
    use crate::source::amass::tests::clip_members;
    use crate::source::body_model::tests::subjects;

    fn row(start: usize, end: Option<usize>) -> IndexRow {
        IndexRow {
            source_path: String::new(),
            start,
            end,
            id: String::new(),
        }
    }

    #[test]
    fn frames_are_taken_as_published() {
        // 120 fps: every 6th frame, 10 of lead-in, then the crop.
        let frames = frames_of(600, 6, 10, &row(2, Some(5)));
        assert_eq!(frames, [72, 78, 84]);
        assert_eq!(frames_of(60, 6, 0, &row(8, Some(99))), [48, 54], "cut off");
        assert_eq!(frames_of(13, 6, 0, &row(0, None)), [0, 6, 12]);
        assert!(frames_of(600, 6, 0, &row(9, Some(3))).is_empty());
        assert!(frames_of(600, 6, 0, &row(usize::MAX, None)).is_empty());
    }

    /// A folder of AMASS files and an index.
    struct Tree {
        folder: tempfile::TempDir,
    }

    impl Tree {
        fn new(files: &[(&str, Vec<u8>)]) -> Self {
            let folder = tempfile::tempdir().expect("temporary folder");
            for (name, bytes) in files {
                let path = folder.path().join(name);
                fs::create_dir_all(path.parent().expect("a folder")).expect("made");
                fs::write(path, bytes).expect("written");
            }
            Self { folder }
        }

        fn files(&self) -> Files {
            let listing = crate::ingest::list_files(&[PathBuf::from(self.folder.path())]);
            Files::new(listing.expect("listed").files)
        }

        fn release(&self) -> Box<dyn Release> {
            let index = self.folder.path().join("index.csv");
            find(&self.files(), &index).expect("a valid index")
        }
    }

    fn index(rows: &[&str]) -> (&'static str, Vec<u8>) {
        let header = "source_path,start_frame,end_frame,new_name";
        let text: String = [&[header], rows]
            .concat()
            .iter()
            .flat_map(|line| [line, "\n"])
            .collect();
        ("index.csv", text.into_bytes())
    }

    fn read(tree: &Tree, release: &dyn Release, id: &str) -> Outcome {
        let entry = release
            .entries()
            .iter()
            .find(|entry| entry.id == id)
            .expect("planned");
        release.read(&tree.files(), entry, &ReadOptions::default())
    }

    fn clip(tree: &Tree, release: &dyn Release, id: &str) -> SourceClip {
        match read(tree, release, id) {
            Outcome::Clip(clip) => *clip,
            outcome => panic!("{id}: {outcome:?}"),
        }
    }

    #[test]
    fn rows_become_clips_and_their_mirror_images_under_any_release_of_the_files() {
        let tree = Tree::new(&[
            ("KIT/3/kick_left_poses.npz", npz(&clip_members(240, 156))),
            ("KIT/3/unused_poses.npz", npz(&clip_members(20, 156))),
            ("PosePrior/1/a_b_stageii.npz", npz(&clip_members(600, 165))),
            (
                "h/texts/000000.txt",
                b"a man kicks with his left leg#left/ADJ leg/NOUN#0.0#0.0\n".to_vec(),
            ),
            ("h/test.txt", b"000000\nM000000\n".to_vec()),
            index(&[
                "./pose_data/KIT/3/kick_left_poses.npy,5,25,000000.npy",
                "./pose_data/MPI_Limits/1/a b_poses.npy,0,90,000001.npy",
                "./pose_data/humanact12/humanact12/P1.npy,0,-1,000002.npy",
                "./pose_data/CMU/1/gone_poses.npy,0,9,000003.npy",
            ]),
        ]);
        let release = tree.release();
        let planned: Vec<(&str, Option<Split>, Option<&str>)> = release
            .entries()
            .iter()
            .map(|entry| (entry.id.as_str(), entry.split, entry.mirrored_of.as_deref()))
            .collect();
        assert_eq!(
            planned,
            [
                ("000000", Some(Split::Test), None),
                ("M000000", Some(Split::Test), Some("000000")),
                ("000001", None, None),
                ("M000001", None, Some("000001")),
            ]
        );
        let why = |item: &str| {
            let found = release.passed_over().iter().find(|(name, _)| name == item);
            found.map_or("", |(_, reason)| reason.as_str())
        };
        assert!(why("index.csv#000002").contains("HumanAct12"));
        assert!(why("index.csv#000003").contains("not among the sources"));
        assert!(why("KIT/3/unused_poses.npz").contains("takes nothing"));

        let kick = clip(&tree, release.as_ref(), "000000");
        assert_eq!((kick.motion.len(), kick.motion.fps()), (20, Fps::STORE));
        assert_eq!(kick.source_frames, 30..145);
        assert_eq!(kick.rotation_source, RotationSource::Native);
        assert_eq!(kick.flags, 0);
        let mirrored = clip(&tree, release.as_ref(), "M000000");
        assert_eq!(mirrored.captions[0].text, "a man kicks with his right leg");
        assert_eq!(mirrored.captions[0].tokens, "right/ADJ leg/NOUN");
        assert_eq!(
            mirror(&mirrored.motion).body_pose(),
            kick.motion.body_pose()
        );

        // 100 frames at 20 fps, 20 of them lead-in: 10 less than the crop wants.
        let short = clip(&tree, release.as_ref(), "000001");
        assert_eq!(short.motion.len(), 80);
        assert_eq!(short.flags, FLAG_FPS_DOUBTFUL);
        let notes = short.notes.join("\n");
        assert!(
            notes.contains("SMPL-X") && notes.contains("10 frames more"),
            "{notes}"
        );
    }

    #[test]
    fn features_are_those_of_the_own_body_where_models_are_given() {
        let mut members = clip_members(240, 165);
        members.push(("betas", npy_f8(&[2], &[2.0, 0.0])));
        let tree = Tree::new(&[
            ("KIT/3/kick_left_poses.npz", npz(&members)),
            ("KIT/3/other_poses.npz", npz(&clip_members(240, 156))),
            index(&[
                "./pose_data/KIT/3/kick_left_poses.npy,0,20,000000.npy",
                "./pose_data/KIT/3/other_poses.npy,0,20,000001.npy",
            ]),
        ]);
        let (_folder, subjects) = subjects();
        let options = ReadOptions {
            subjects: Some(Arc::new(subjects)),
            ..ReadOptions::default()
        };
        let release = tree.release();
        let read = |id: &str| {
            let mut entries = release.entries().iter();
            let entry = entries.find(|entry| entry.id == id).expect("in the index");
            match release.read(&tree.files(), entry, &options) {
                Outcome::Clip(clip) => *clip,
                _ => panic!("the clip is good"),
            }
        };
        // The first beta of the male model lifts the head by 5 cm a unit.
        let neutral = smpl_body(&Skeleton::smplx_neutral());
        let tall = smpl_body(&{
            let mut joints = std::array::from_fn(|joint| Skeleton::smplx_neutral().rest(joint));
            joints[15].y += 0.1;
            Skeleton::new("tall", joints)
        });
        let bodies = [read("000000"), read("M000000")].map(|clip| clip.body.expect("SMPL-X"));
        assert!((bodies[0].offset(15).length() - tall.offset(15).length()).abs() < 1e-9);
        assert!((bodies[0].offset(4) - neutral.offset(4)).length() < 1e-9);
        let [x, y, z] = bodies[0].offset(16).to_array();
        assert!((bodies[1].offset(17) - DVec3::new(-x, y, z)).length() < 1e-9);
        let other = read("000001");
        assert!(
            other.body.is_none(),
            "the models are of SMPL-X, the clip is SMPL-H"
        );
        assert!(other.notes.join("\n").contains("body shape ignored"));
    }

    #[test]
    fn the_world_is_turned_as_published() {
        // A body that stands in AMASS faces -y, and faces -z after (x, y, z) to (-x, z, y).
        let mut poses = vec![0.0; 40 * 156];
        let mut trans = vec![0.0; 40 * 3];
        for frame in 0..40 {
            poses[156 * frame] = std::f64::consts::FRAC_PI_2;
            trans[3 * frame] = 0.01 * frame as f64;
            trans[3 * frame + 1] = 0.02 * frame as f64;
        }
        let members = [
            ("poses", npy_f8(&[40, 156], &poses)),
            ("trans", npy_f8(&[40, 3], &trans)),
            ("mocap_framerate", npy_f8(&[], &[59.99])),
        ];
        let tree = Tree::new(&[
            ("KIT/3/stand_poses.npz", npz(&members)),
            index(&["./pose_data/KIT/3/stand_poses.npy,0,20,000000.npy"]),
        ]);
        let stand = clip(&tree, tree.release().as_ref(), "000000");
        assert_eq!(stand.motion.len(), 20, "59.99 fps is taken every 2nd frame");
        assert!(stand.notes.iter().any(|note| note.contains("29.995")));
        let skeleton = Skeleton::smplx_neutral();
        let [first, second] = [0, 1].map(|frame| stand.motion.pose(frame));
        assert!((first.rotations[0] * DVec3::Y - DVec3::Y).length() < 1e-6);
        assert!((first.rotations[0] * DVec3::Z - DVec3::NEG_Z).length() < 1e-6);
        let moved = skeleton.keypoints(&second)[0] - skeleton.keypoints(&first)[0];
        assert!(
            (moved - DVec3::new(-0.02, 0.0, 0.04)).length() < 1e-6,
            "{moved}"
        );
    }

    #[test]
    fn rates_and_crops_that_leave_nothing_are_rejected_by_code() {
        let mut slow = clip_members(50, 156);
        slow.retain(|(key, _)| *key != "mocap_framerate");
        slow.push(("mocap_framerate", npy_f8(&[], &[19.0])));
        let tree = Tree::new(&[
            ("KIT/3/slow_poses.npz", npz(&slow)),
            ("KIT/3/short_poses.npz", npz(&clip_members(50, 156))),
            (
                "KIT/3/shape_poses.npz",
                npz(&[("betas", npy_f8(&[1], &[0.0]))]),
            ),
            index(&[
                "./pose_data/KIT/3/slow_poses.npy,0,9,000000.npy",
                "./pose_data/KIT/3/short_poses.npy,8,20,000001.npy",
                "./pose_data/KIT/3/shape_poses.npy,0,20,000002.npy",
            ]),
        ]);
        let release = tree.release();
        for (id, code) in [
            ("000000", "E-AMASS-FPS"),
            ("M000001", "E-TOO-SHORT"),
            ("000002", "E-AMASS-KEYS"),
        ] {
            match read(&tree, release.as_ref(), id) {
                Outcome::Rejected(rejected) => assert_eq!(rejected.code, code),
                outcome => panic!("{id}: {outcome:?}"),
            }
        }
        let no_index = Tree::new(&[("index.csv", b"a,b\n".to_vec())]);
        let found = find(&no_index.files(), &no_index.folder.path().join("index.csv"));
        assert!(matches!(found.err(), Some(Error::Index { .. })));
    }

    #[test]
    fn sides_and_turns_change_places() {
        for (text, swapped) in [
            ("Left arm, then right-hand.", "Right arm, then left-hand."),
            ("turns clockwise", "turns counterclockwise"),
            ("counter-clockwise circle", "clockwise circle"),
            ("Counter clockwise; anticlockwise", "Clockwise; clockwise"),
            (
                "left/ADJ right/ADV walk/VERB",
                "right/ADJ left/ADV walk/VERB",
            ),
            (
                "an upright man in bright light",
                "an upright man in bright light",
            ),
            ("leftward and rightwards", "rightward and leftwards"),
            ("counter the clock", "counter the clock"),
            ("l\u{e9}ft \u{2192} left", "l\u{e9}ft \u{2192} right"),
        ] {
            assert_eq!(swap_sides(text), swapped, "{text}");
        }
    }

    proptest! {
        #[test]
        fn swapping_twice_gives_the_text_back(text in "[a-z ,.]{0,20}(left|right| clockwise|x)[ .]{0,3}") {
            prop_assume!(!text.contains("counter") && !text.contains("anti"));
            prop_assert_eq!(swap_sides(&swap_sides(&text)), text);
        }

        #[test]
        fn any_text_is_swapped_without_panic(text in any::<String>()) {
            let _ = swap_sides(&text);
        }

        #[test]
        fn a_mirrored_motion_on_a_mirrored_body_has_mirrored_joints(
            angles in prop::collection::vec(prop::array::uniform3(-1.5f64..1.5), 22),
            lift in prop::array::uniform3(-0.1f64..0.1),
        ) {
            let skeleton = Skeleton::smplx_neutral();
            // A body like no other: one joint is moved.
            let body = Skeleton::new("subject", std::array::from_fn(|joint| {
                skeleton.rest(joint) + if joint == 16 { DVec3::from_array(lift) } else { DVec3::ZERO }
            }));
            let mut pose = datasets_spec::Pose::REST;
            for (rotation, angles) in pose.rotations.iter_mut().zip(angles) {
                *rotation = kinematics::rotation::from_axis_angle(DVec3::from_array(angles));
            }
            let motion = Motion::from_poses(Fps::STORE, &[pose]).expect("valid");
            let joints = body.keypoints(&motion.pose(0));
            let mirrored = mirrored_body(&body).keypoints(&mirror(&motion).pose(0));
            // The pelvis moves with the mirrored body; everything else is as in the mirror.
            let reflect = |v: DVec3| DVec3::new(-v.x, v.y, v.z);
            for joint in Joint::ALL {
                let here = mirrored[joint.index()] - mirrored[0];
                let there = joints[joint.mirrored().index()] - joints[0];
                prop_assert!((here - reflect(there)).length() < 1e-5, "{joint:?}");
            }
        }

        #[test]
        fn mirroring_twice_gives_the_motion_back(seed in any::<u32>()) {
            let poses = (0..3u32).map(|frame| {
                let mut pose = datasets_spec::Pose::REST;
                for (joint, rotation) in pose.rotations.iter_mut().enumerate() {
                    let angle = f64::from(seed.wrapping_mul(joint as u32 + 7 * frame + 1) % 628) / 200.0;
                    *rotation = DQuat::from_rotation_z(angle) * DQuat::from_rotation_x(angle / 2.0);
                }
                pose.transl.x = f64::from(frame);
                pose
            });
            let motion = Motion::from_poses(Fps::STORE, &poses.collect::<Vec<_>>()).expect("valid");
            let mirrored = mirror(&motion);
            let again = mirror(&mirrored);
            prop_assert_eq!(again.body_pose(), motion.body_pose());
            // Rotations of the left are those of the right, seen in a mirror.
            let reflect = |v: DVec3| DVec3::new(-v.x, v.y, v.z);
            for joint in Joint::ALL {
                let here = mirrored.pose(1).rotations[joint.index()];
                let there = motion.pose(1).rotations[joint.mirrored().index()];
                for axis in DVec3::AXES {
                    let apart = here * axis - reflect(there * reflect(axis));
                    // Axis-angle is stored in f32.
                    prop_assert!(apart.length() < 1e-5);
                }
            }
        }
    }
}
