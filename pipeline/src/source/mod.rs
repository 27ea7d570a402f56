//! Foreign motion files: what is recognised, and how one file becomes one clip.
//!
//! Everything that a foreign format does in its own way (units, up axis, joint names, frame rate,
//! where labels are kept) ends here: a [`SourceClip`] is SMPL-X parameters with y up and in metres.
//! Nothing in this module panics on hostile bytes; whatever is wrong becomes a [`Rejected`].

pub mod amass;
pub mod amass_catalogue;
pub mod body_model;
pub mod bvh;
pub mod c3d;
pub mod gltf;
pub mod humanml3d;
pub mod humanml3d_amass;
pub mod labels;
pub mod motionfix;
pub(crate) mod smpl;
pub mod stance;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use self::body_model::Subjects;
use crate::clip::{Outcome, Rejected};
use crate::retarget::UserMap;
use datasets_spec::store::{Disk, Store};
use datasets_spec::{Fps, Skeleton, Split};

/// A format this crate turns into motions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Format {
    /// Biovision hierarchy: a skeleton and Euler angles, as text.
    Bvh,
    /// AMASS: SMPL, SMPL-H or SMPL-X parameters in an npz archive.
    Amass,
    /// C3D: marker positions of an optical capture.
    C3d,
    /// glTF or GLB: animations of a skinned skeleton.
    Gltf,
    /// A HumanML3D folder: joints, 263-d vectors, captions and split lists.
    HumanMl3d,
    /// HumanML3D's clips, cut from AMASS by its `index.csv`.
    HumanMl3dAmass,
    /// A folder of the STANCE release.
    Stance,
    /// A folder of the MotionFix release.
    MotionFix,
}

impl Format {
    /// Every format, in the order of their names' appearance in the documents.
    pub const ALL: [Format; 8] = [
        Self::Bvh,
        Self::Amass,
        Self::C3d,
        Self::Gltf,
        Self::HumanMl3d,
        Self::HumanMl3dAmass,
        Self::Stance,
        Self::MotionFix,
    ];

    /// The name used in tables and on the command line.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Bvh => "bvh",
            Self::Amass => "amass",
            Self::C3d => "c3d",
            Self::Gltf => "gltf",
            Self::HumanMl3d => "humanml3d",
            Self::HumanMl3dAmass => "humanml3d-amass",
            Self::Stance => "stance",
            Self::MotionFix => "motionfix",
        }
    }

    /// Whether one file of this format may hold several motions.
    pub fn may_hold_several(self) -> bool {
        self == Self::Gltf
    }
}

/// Names of the motions in a file that stands alone; empty if it holds one, or cannot be read.
pub fn keys_in(format: Format, bytes: &[u8]) -> Vec<String> {
    match format {
        Format::Gltf => gltf::keys(bytes),
        _ => Vec::new(),
    }
}

/// The releases among the files, each found by its layout. `humanml3d_index` is the `index.csv` by
/// which HumanML3D's clips are to be cut from AMASS files.
///
/// # Errors
/// The index cannot be read.
pub fn find_releases(
    files: &Files,
    humanml3d_index: Option<&Path>,
) -> Result<Vec<Box<dyn Release>>, crate::Error> {
    let mut releases: Vec<Box<dyn Release>> = Vec::new();
    // It comes first: it reads captions that would else count as those of no motion.
    if let Some(index) = humanml3d_index {
        releases.push(humanml3d_amass::find(files, index)?);
    }
    releases.extend(humanml3d::find(files));
    releases.extend(stance::find(files));
    releases.extend(motionfix::find(files));
    Ok(releases)
}

/// What a file is, judged by its name and first bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Recognised {
    /// A motion in this format.
    Motion(Format),
    /// Not a motion, or not one this crate reads.
    NotMotion {
        /// Why the file is passed over.
        reason: String,
    },
}

/// The files under the ingested sources, by their relative paths with forward slashes.
#[derive(Clone, Debug)]
pub struct Files {
    store: Arc<dyn Store>,
    paths: BTreeMap<String, PathBuf>,
}

impl Files {
    /// Takes the path of every file by its relative path.
    pub fn new(paths: BTreeMap<String, PathBuf>) -> Self {
        Self::on(Disk::store(), paths)
    }

    /// [`Files::new`], reading through the given store.
    pub fn on(store: Arc<dyn Store>, paths: BTreeMap<String, PathBuf>) -> Self {
        Self { store, paths }
    }

    /// BLAKE3 of a file, hexadecimal, or why it cannot be read.
    pub(crate) fn hash(&self, path: &Path) -> Result<String, String> {
        self.store.hash(path).map_err(|error| error.to_string())
    }

    /// Number of files.
    pub fn len(&self) -> usize {
        self.paths.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.paths.is_empty()
    }

    /// Whether there is such a file.
    pub fn contains(&self, relative: &str) -> bool {
        self.paths.contains_key(relative)
    }

    /// Where a file is.
    pub fn path(&self, relative: &str) -> Option<&Path> {
        self.paths.get(relative).map(PathBuf::as_path)
    }

    /// The bytes of a file.
    ///
    /// # Errors
    /// `E-IO` if there is no such file or it cannot be read.
    pub fn read(&self, relative: &str) -> Result<Vec<u8>, Rejected> {
        let path = self.paths.get(relative).ok_or_else(|| {
            Rejected::read("E-IO", format!("there is no file {relative} in the source"))
        })?;
        self.store
            .read(path)
            .map_err(|error| Rejected::read("E-IO", format!("cannot read {relative}: {error}")))
    }

    /// The bytes of a file that lies beside a source; none if there is no such file.
    pub(crate) fn read_beside(&self, path: &Path) -> Result<Option<Vec<u8>>, Rejected> {
        use std::io::ErrorKind::{InvalidFilename, IsADirectory, NotADirectory, NotFound};

        match self.store.read(path) {
            Ok(bytes) => Ok(Some(bytes)),
            Err(error) => match error.kind() {
                NotFound | NotADirectory | IsADirectory | InvalidFilename => Ok(None),
                _ => Err(Rejected::read(
                    "E-IO",
                    format!("cannot read {}: {error}", path.display()),
                )),
            },
        }
    }

    /// Relative paths of all files, sorted.
    pub fn all(&self) -> impl Iterator<Item = &str> {
        self.paths.keys().map(String::as_str)
    }

    /// Relative paths of the files under a folder (`""` for all, otherwise ending in `/`), sorted.
    pub fn under<'a>(&'a self, folder: &'a str) -> impl Iterator<Item = &'a str> {
        self.paths
            .range(folder.to_owned()..)
            .map(|(relative, _)| relative.as_str())
            .take_while(move |relative| relative.starts_with(folder))
    }
}

/// How files are turned into clips.
#[derive(Clone, Debug)]
pub struct ReadOptions {
    /// Skeleton the motions are posed on.
    pub skeleton: Skeleton,
    /// Joint names of the user, which win over those that are known.
    pub user_map: Option<UserMap>,
    /// The rate at which clips are wanted, interpolated at exact times. Readers that can skip the
    /// frames between do so; the others give the file's own rate.
    pub rate: Option<Fps>,
    /// Body models by gender, to compute features of AMASS on each subject's own body.
    pub subjects: Option<Arc<Subjects>>,
}

impl Default for ReadOptions {
    fn default() -> Self {
        Self {
            skeleton: Skeleton::smplx_neutral(),
            user_map: None,
            rate: None,
            subjects: None,
        }
    }
}

/// One motion in the plan: a whole file, or one of several that a file holds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Relative path of the file it is read from.
    pub file: String,
    /// Which of the file's motions; empty if it holds one.
    pub key: String,
    /// Id the motion is to have.
    pub id: String,
    /// The published split; none draws one.
    pub split: Option<Split>,
    /// Id of the motion it mirrors.
    pub mirrored_of: Option<String>,
}

/// A release: files that belong together and are read by rules of their own.
pub trait Release: Send + Sync {
    /// Its format.
    fn format(&self) -> Format;

    /// Its motions, in an order that depends on the files alone.
    fn entries(&self) -> &[Entry];

    /// Its files that hold no motion of their own: why each is passed over. Every file of the
    /// release is named either here, in [`Release::rejected`] or by an entry.
    fn passed_over(&self) -> &[(String, String)];

    /// Its files that were found broken before any motion was read.
    fn rejected(&self) -> &[(String, Rejected)];

    /// What a reader of the dataset should know about the splits of its motions.
    fn remarks(&self) -> &[String] {
        &[]
    }

    /// Reads one motion. Called from many threads at once.
    fn read(&self, files: &Files, entry: &Entry, options: &ReadOptions) -> Outcome;
}

/// First words of a Git LFS pointer: what lies in a checkout in place of a large file that was
/// not downloaded.
const LFS_POINTER: &[u8] = b"version https://git-lfs.github.com/spec/";
const UTF8_BOM: &[u8] = b"\xEF\xBB\xBF";

/// Says what a file is from its name and first bytes (a few hundred are plenty).
pub fn recognise(path: &Path, head: &[u8]) -> Recognised {
    let not_motion = |reason: String| Recognised::NotMotion { reason };
    let name = path
        .file_name()
        .map(|name| name.to_string_lossy().to_lowercase())
        .unwrap_or_default();
    let text = head
        .strip_prefix(UTF8_BOM)
        .unwrap_or(head)
        .trim_ascii_start();
    let extension = path
        .extension()
        .map(|extension| extension.to_string_lossy().to_lowercase())
        .unwrap_or_default();
    match extension.as_str() {
        "bvh" => Recognised::Motion(Format::Bvh),
        "c3d" => Recognised::Motion(Format::C3d),
        "glb" | "gltf" => Recognised::Motion(Format::Gltf),
        "npz" if name == "shape.npz" => not_motion("body shape of a subject, no motion".to_owned()),
        "npz" if name.ends_with("_stagei.npz") => {
            not_motion("body shape of a subject (MoSh stage i), no motion".to_owned())
        }
        "npz" => Recognised::Motion(Format::Amass),
        "npy" => humanml3d::recognise_array(head),
        "json" if name.ends_with(crate::sidecar::Sidecar::SUFFIX) => {
            not_motion("sidecar, read with the motion it describes".to_owned())
        }
        "json" | "txt" | "csv" | "md" | "yaml" | "yml" | "toml" | "tsv" => {
            not_motion(format!("{extension} text, no motion"))
        }
        "pkl" | "pickle" => Recognised::Motion(Format::Stance),
        "pth" | "pt" | "tar" => not_motion(format!("{extension} archive of no known release")),
        _ if text.len() >= b"HIERARCHY".len()
            && text[..b"HIERARCHY".len()].eq_ignore_ascii_case(b"HIERARCHY") =>
        {
            Recognised::Motion(Format::Bvh)
        }
        _ if head.starts_with(b"glTF") => Recognised::Motion(Format::Gltf),
        "" => not_motion("no known motion format".to_owned()),
        _ => not_motion(format!("{extension} is no known motion format")),
    }
}

/// Whether these are the first bytes of what stands in for a file that was not downloaded.
pub(crate) fn is_pointer(head: &[u8]) -> bool {
    head.starts_with(LFS_POINTER)
}

/// Refuses what stands in for a file that was not downloaded.
///
/// # Errors
/// `E-LFS-POINTER`.
pub(crate) fn refuse_pointer(bytes: &[u8]) -> Result<(), Rejected> {
    if !is_pointer(bytes) {
        return Ok(());
    }
    Err(Rejected::read(
        "E-LFS-POINTER",
        format!(
            "{} bytes of Git LFS pointer stand in for the file; run `git lfs pull`",
            bytes.len()
        ),
    )
    .at(0))
}

/// Turns the bytes of one file into a clip on the given body.
///
/// `companions` reads a file beside it by its name (`/` separates folders), and answers none where
/// there is no such file.
pub fn read_clip(
    format: Format,
    path: &Path,
    key: &str,
    bytes: &[u8],
    companions: &dyn Fn(&str) -> Option<Vec<u8>>,
    options: &ReadOptions,
) -> Outcome {
    let skeleton = &options.skeleton;
    if let Err(rejected) = refuse_pointer(bytes) {
        return Outcome::Rejected(rejected);
    }
    let read = match format {
        Format::Bvh => bvh::Bvh::parse(bytes).and_then(|bvh| {
            crate::retarget::clip(&bvh, &options.skeleton, options.user_map.as_ref())
        }),
        Format::Amass => match amass::read(path, bytes, options) {
            Ok(amass::Content::Clip(clip)) => Ok(*clip),
            Ok(amass::Content::NoMotion { reason }) => return Outcome::Skipped { reason },
            Err(rejected) => Err(rejected),
        },
        Format::Gltf => match gltf::read(bytes, key, options) {
            Ok(gltf::Content::Clip(clip)) => Ok(*clip),
            Ok(gltf::Content::NoMotion { reason }) => return Outcome::Skipped { reason },
            Err(rejected) => Err(rejected),
        },
        Format::C3d => match c3d::read(bytes, options) {
            Outcome::Clip(clip) => Ok(*clip),
            other => return other,
        },
        Format::HumanMl3d => humanml3d::read_array(bytes, skeleton),
        Format::Stance => stance::read_pickle_motion(bytes, skeleton),
        Format::HumanMl3dAmass | Format::MotionFix => {
            unreachable!("a release reads its own files")
        }
    };
    match read.and_then(|clip| labels::attach(clip, path, companions)) {
        Ok(clip) => Outcome::Clip(Box::new(clip)),
        Err(rejected) => Outcome::Rejected(rejected),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::check;
    use crate::retarget::tests::{Dialect, walk};

    fn motion_format(path: &str, head: &[u8]) -> Option<Format> {
        match recognise(Path::new(path), head) {
            Recognised::Motion(format) => Some(format),
            Recognised::NotMotion { reason } => {
                assert!(!reason.is_empty());
                None
            }
        }
    }

    #[test]
    fn files_are_recognised_by_name_and_by_content() {
        for (path, head, format) in [
            ("a/walk.bvh", &b""[..], Some(Format::Bvh)),
            ("a/WALK.BVH", b"HIERARCHY", Some(Format::Bvh)),
            (
                "a/noextension",
                b"\xEF\xBB\xBF hierarchy\nROOT",
                Some(Format::Bvh),
            ),
            ("KIT/3/kick_poses.npz", b"PK\x03\x04", Some(Format::Amass)),
            ("KIT/3/shape.npz", b"PK\x03\x04", None),
            ("KIT/3/neutral_stagei.npz", b"PK\x03\x04", None),
            ("a/walk.stance.json", b"{}", None),
            ("a/walk.txt", b"", None),
            ("a/LICENSE", b"MIT", None),
            ("a/walk.pkl", b"\x80\x04", Some(Format::Stance)),
            ("a/walk.pkl", LFS_POINTER, Some(Format::Stance)),
            ("a/walk.pkl", b"cos\nsystem", Some(Format::Stance)),
            ("a/capture.C3D", b"\x02\x50", Some(Format::C3d)),
            ("a/robot.glb", b"glTF", Some(Format::Gltf)),
            ("a/noextension", b"glTF\x02", Some(Format::Gltf)),
            ("a/weights.pth", b"\x80\x04", None),
            ("", b"", None),
        ] {
            assert_eq!(motion_format(path, head), format, "{path}");
        }
    }

    #[test]
    fn a_file_that_was_never_fetched_says_so() {
        let pointer = b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 7\n";
        let outcome = read_clip(
            Format::Bvh,
            Path::new("walk.bvh"),
            "",
            pointer,
            &|_| None,
            &ReadOptions::default(),
        );
        assert!(matches!(
            outcome,
            Outcome::Rejected(Rejected {
                code: "E-LFS-POINTER",
                ..
            })
        ));
    }

    #[test]
    fn a_whole_file_becomes_a_labelled_clip_on_the_floor() {
        let skeleton = Skeleton::smplx_neutral();
        let text = Dialect::default().write(&walk(60), &skeleton);
        let outcome = read_clip(
            Format::Bvh,
            Path::new("set/dataset-1_walk_proud_001.bvh"),
            "",
            text.as_bytes(),
            &|name| {
                (name == "dataset-1_walk_proud_001.txt")
                    .then(|| b"a man walks#a/DET#0.0#0.0".to_vec())
            },
            &ReadOptions::default(),
        );
        let Outcome::Clip(clip) = outcome else {
            panic!("{outcome:?}");
        };
        assert_eq!(clip.style.as_deref(), Some("proud"));
        let captions: Vec<&str> = clip
            .captions
            .iter()
            .map(|caption| caption.text.as_str())
            .collect();
        assert_eq!(captions, ["a person walks in a proud style", "a man walks"]);
        check(&clip.motion, &skeleton).expect("a plain walk");
        let lowest = skeleton
            .motion_keypoints(&clip.motion)
            .points
            .iter()
            .flat_map(|points| [points[10].y, points[11].y])
            .fold(f64::INFINITY, f64::min);
        assert!((-0.05..0.01).contains(&lowest), "{lowest}");
    }

    /// The real files, if the environment says where they are.
    fn test_data(folder: &str) -> Option<std::path::PathBuf> {
        let root = std::env::var_os("STANCE_TEST_DATA").map(std::path::PathBuf::from);
        let found = root
            .map(|root| root.join(folder))
            .filter(|path| path.is_dir());
        if found.is_none() {
            skipped(folder);
        }
        found
    }

    #[expect(
        clippy::print_stderr,
        reason = "a test that checks nothing must say so"
    )]
    fn skipped(folder: &str) {
        eprintln!("SKIPPED: STANCE_TEST_DATA names no folder that has {folder}");
    }

    fn files_in(folder: &Path) -> Vec<std::path::PathBuf> {
        let mut files: Vec<_> = std::fs::read_dir(folder)
            .expect("the folder was found")
            .map(|entry| entry.expect("readable").path())
            .collect();
        files.sort();
        files
    }

    fn outcome_of(path: &Path) -> Option<Outcome> {
        let bytes = std::fs::read(path).ok()?;
        let format = motion_format(&path.to_string_lossy(), &bytes[..bytes.len().min(256)])?;
        let beside = |name: &str| std::fs::read(path.with_file_name(name)).ok();
        Some(read_clip(
            format,
            path,
            "",
            &bytes,
            &beside,
            &ReadOptions::default(),
        ))
    }

    #[test]
    fn real_bandai_namco_clips_face_and_act_as_labelled() {
        let skeleton = Skeleton::smplx_neutral();
        for folder in ["bvh/bandai_namco_1", "bvh/bandai_namco_2"] {
            let Some(folder) = test_data(folder) else {
                continue;
            };
            let mut num_clips = 0;
            for path in files_in(&folder) {
                let Some(outcome) = outcome_of(&path) else {
                    continue;
                };
                let Outcome::Clip(clip) = outcome else {
                    panic!("{}: {outcome:?}", path.display());
                };
                num_clips += 1;
                let name = path.display();
                check(&clip.motion, &skeleton).unwrap_or_else(|r| panic!("{name}: {r:?}"));
                assert!(clip.fit_error_m.expect("retargeted") < 0.06, "{name}");
                let points = skeleton.motion_keypoints(&clip.motion).points;
                let highest = |joint: usize| {
                    points
                        .iter()
                        .map(|frame| frame[joint].y)
                        .fold(f64::NEG_INFINITY, f64::max)
                };
                // Some styles raise their hands no higher than the chest.
                match clip.action.as_deref() {
                    Some("raise-up-left-hand") => {
                        assert!(
                            highest(20) > highest(9) && highest(21) < highest(20) - 0.3,
                            "{name}"
                        );
                    }
                    Some("raise-up-both-hands") => {
                        assert!(
                            highest(20) > highest(9) && highest(21) > highest(9),
                            "{name}"
                        );
                    }
                    Some("walk" | "run" | "dash") => {
                        // Summed over the frames, the body moves to where its hips face.
                        let ahead: f64 = points
                            .windows(2)
                            .map(|pair| {
                                let left = pair[0][1] - pair[0][2];
                                left.cross(glam::DVec3::Y).dot(pair[1][0] - pair[0][0])
                            })
                            .sum();
                        assert!(ahead > 0.0, "{name}");
                    }
                    _ => {}
                }
                for frame in &points {
                    for [hip, knee, ankle] in [[1, 4, 7], [2, 5, 8]] {
                        // A knee that is bent by more than 30 degrees is ahead of the leg's line.
                        let thigh = (frame[knee] - frame[hip]).normalize();
                        let shin = (frame[ankle] - frame[knee]).normalize();
                        let hinge = thigh.cross(shin);
                        if hinge.length() > 0.5 {
                            assert!(hinge.dot(frame[1] - frame[2]) > 0.0, "{name}");
                        }
                    }
                }
            }
            assert!(num_clips > 0);
        }
    }

    #[test]
    fn real_files_of_other_kinds_are_all_accounted_for() {
        for (folder, codes) in [
            ("bvh/other", &["E-BVH-SKELETON"][..]),
            ("bvh/xia", &[]),
            ("amass_layout", &[]),
            ("other_npz/kimodo_02_multi_text_prompt", &["E-AMASS-KEYS"]),
        ] {
            let Some(folder) = test_data(folder) else {
                continue;
            };
            for path in files_in(&folder) {
                match outcome_of(&path) {
                    Some(Outcome::Rejected(rejected)) => {
                        assert!(
                            codes.contains(&rejected.code),
                            "{}: {rejected:?}",
                            path.display()
                        );
                    }
                    Some(Outcome::Skipped { reason }) => panic!("{}: {reason}", path.display()),
                    Some(Outcome::Clip(_) | Outcome::Markers { .. }) | None => {}
                }
            }
        }
    }
}
