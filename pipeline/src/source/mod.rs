//! Foreign motion files: what is recognised, and how one file becomes one clip.
//!
//! Everything that a foreign format does in its own way (units, up axis, joint names, frame rate,
//! where labels are kept) ends here: a [`SourceClip`] is SMPL-X parameters with y up and in metres.
//! Nothing in this module panics on hostile bytes; whatever is wrong becomes a [`Rejected`].

pub mod amass;
pub mod bvh;
pub mod floor;
pub mod labels;
pub mod npy;

use std::path::Path;

use datasets_spec::table::{Caption, PartCaption};
use datasets_spec::{Motion, Skeleton};

/// A format this crate turns into motions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Format {
    /// Biovision hierarchy: a skeleton and Euler angles, as text.
    Bvh,
    /// AMASS: SMPL, SMPL-H or SMPL-X parameters in an npz archive.
    Amass,
}

impl Format {
    /// The name used in tables and on the command line.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Bvh => "bvh",
            Self::Amass => "amass",
        }
    }
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

/// Where the rotations of a clip come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RotationSource {
    /// The file holds them for this body.
    Native,
    /// The file holds them for another skeleton.
    Retargeted,
    /// They were recovered from positions.
    Fitted,
}

impl RotationSource {
    /// The name used in tables.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Native => "native",
            Self::Retargeted => "retargeted",
            Self::Fitted => "fitted",
        }
    }
}

/// A clip as read from one file.
#[derive(Clone, Debug, PartialEq)]
pub struct SourceClip {
    /// The motion at the file's own rate: SMPL-X parameters, y up, metres, floor at y = 0.
    pub motion: Motion,
    /// Where its rotations come from.
    pub rotation_source: RotationSource,
    /// Mean distance in metres between the joints of the motion and those of the file, the latter
    /// with their bones brought to this body's lengths; none for native rotations.
    pub fit_error_m: Option<f32>,
    /// Frames in the file.
    pub num_source_frames: usize,
    /// First frame of the file that is in the motion; later ones all are.
    pub first_frame: usize,
    /// What the clip is said to show.
    pub captions: Vec<Caption>,
    /// What single body parts are said to do.
    pub part_captions: Vec<PartCaption>,
    /// Action label.
    pub action: Option<String>,
    /// Style label.
    pub style: Option<String>,
    /// Licence tag.
    pub license: Option<String>,
    /// Decisions a reader may want to check, such as the unit that was assumed.
    pub notes: Vec<String>,
}

/// What became of a file.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// It is a clip.
    Clip(Box<SourceClip>),
    /// It is no motion, though it looked like one.
    Skipped {
        /// Why.
        reason: String,
    },
    /// It is a motion that cannot be used.
    Rejected(Rejected),
}

/// Why a file was put into quarantine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rejected {
    /// Code that scripts may rely on, such as `E-BVH-FRAMES`.
    pub code: &'static str,
    /// What is wrong, with the numbers found and expected.
    pub reason: String,
    /// Where in the file, if there is such a place.
    pub byte_offset: Option<u64>,
    /// What was being done: [`Rejected::READ`], [`Rejected::RETARGET`] or [`Rejected::CHECK`].
    pub stage: &'static str,
}

impl Rejected {
    /// Stage of parsing the file.
    pub const READ: &'static str = "read";
    /// Stage of carrying the motion over to the body.
    pub const RETARGET: &'static str = "retarget";
    /// Stage of judging the finished motion.
    pub const CHECK: &'static str = "check";

    /// Rejects a file for something found while reading it.
    pub fn read(code: &'static str, reason: impl Into<String>) -> Self {
        Self {
            code,
            reason: reason.into(),
            byte_offset: None,
            stage: Self::READ,
        }
    }

    /// Rejects a file for something found while retargeting it.
    pub fn retarget(code: &'static str, reason: impl Into<String>) -> Self {
        Self {
            stage: Self::RETARGET,
            ..Self::read(code, reason)
        }
    }

    /// Rejects a motion for something the checks found.
    pub fn check(code: &'static str, reason: impl Into<String>) -> Self {
        Self {
            stage: Self::CHECK,
            ..Self::read(code, reason)
        }
    }

    /// The same finding at a place in the file.
    #[must_use]
    pub fn at(self, byte_offset: usize) -> Self {
        Self {
            byte_offset: Some(byte_offset as u64),
            ..self
        }
    }
}

/// Slowest frame rate believed, in 1/s. A wrong rate of once a day would make a stored clip of
/// a few frames grow to millions.
pub(crate) const MIN_FPS: f64 = 1.0;
/// Fastest frame rate believed, in 1/s; optical capture ends near 2000.
pub(crate) const MAX_FPS: f64 = 10_000.0;

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
        "npz" if name == "shape.npz" => not_motion("body shape of a subject, no motion".to_owned()),
        "npz" if name.ends_with("_stagei.npz") => {
            not_motion("body shape of a subject (MoSh stage i), no motion".to_owned())
        }
        "npz" => Recognised::Motion(Format::Amass),
        "json" if name.ends_with(crate::sidecar::Sidecar::SUFFIX) => {
            not_motion("sidecar, read with the motion it describes".to_owned())
        }
        "json" | "txt" | "csv" | "md" | "yaml" | "yml" | "toml" | "tsv" => {
            not_motion(format!("{extension} text, no motion"))
        }
        "pkl" | "pickle" | "pth" | "pt" | "tar" => not_motion(format!(
            "{extension} file: pickled objects are code and are never executed; convert it to npz"
        )),
        _ if text.len() >= b"HIERARCHY".len()
            && text[..b"HIERARCHY".len()].eq_ignore_ascii_case(b"HIERARCHY") =>
        {
            Recognised::Motion(Format::Bvh)
        }
        "" => not_motion("no known motion format".to_owned()),
        _ => not_motion(format!("{extension} is no known motion format")),
    }
}

/// Turns the bytes of one file into a clip on the given body.
///
/// `companions` reads a file beside it by its name (`/` separates folders), and answers none where
/// there is no such file.
pub fn read_clip(
    format: Format,
    path: &Path,
    bytes: &[u8],
    companions: &dyn Fn(&str) -> Option<Vec<u8>>,
    skeleton: &Skeleton,
) -> Outcome {
    if bytes.starts_with(LFS_POINTER) {
        return Outcome::Rejected(
            Rejected::read(
                "E-LFS-POINTER",
                format!(
                    "{} bytes of Git LFS pointer stand in for the file; run `git lfs pull`",
                    bytes.len()
                ),
            )
            .at(0),
        );
    }
    let read = match format {
        Format::Bvh => bvh::Bvh::parse(bytes).and_then(|bvh| crate::retarget::clip(&bvh, skeleton)),
        Format::Amass => match amass::read(bytes, skeleton) {
            Ok(amass::Content::Clip(clip)) => Ok(*clip),
            Ok(amass::Content::NoMotion { reason }) => return Outcome::Skipped { reason },
            Err(rejected) => Err(rejected),
        },
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
            ("a/walk.pkl", b"\x80\x04", None),
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
            pointer,
            &|_| None,
            &Skeleton::smplx_neutral(),
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
            text.as_bytes(),
            &|name| {
                (name == "dataset-1_walk_proud_001.txt")
                    .then(|| b"a man walks#a/DET#0.0#0.0".to_vec())
            },
            &skeleton,
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
            &bytes,
            &beside,
            &Skeleton::smplx_neutral(),
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
                    Some(Outcome::Clip(_)) | None => {}
                }
            }
        }
    }
}
