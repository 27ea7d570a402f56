//! Foreign motion files: how they are recognised, and how one file becomes one clip.
//!
//! Everything specific to a foreign format (units, up axis, joint names, frame rate, location of the labels) ends here:
//! a [`SourceClip`](clip::SourceClip) holds SMPL-X parameters with y up and in metres. Nothing in this module panics on
//! hostile bytes; every error becomes a [`Rejected`](clip::Rejected).

mod assumed_up;
mod files;
mod format;
mod head;
mod names;
mod options;

pub mod amass;
pub mod archive;
pub mod body_model;
pub mod bvh;
pub mod c3d;
pub mod dataset;
pub mod fbx;
pub mod gltf;
pub mod humanml3d;
pub mod humanml3d_amass;
pub mod labels;
pub mod motionfix;
pub mod motionx;
#[cfg(test)]
pub(crate) mod release_tests;
pub mod representation_272;
mod robot;
pub mod seed;
pub mod smpl;
pub mod stance;
mod stored_labels;
pub mod trc;
pub(crate) mod unit;
mod up;
pub mod webdataset;

use std::path::Path;

pub use self::files::Files;
pub use self::format::{Contents, Entry, Format, ReadCapture, Recognised, Release};
pub use self::head::{HEAD_BYTES, is_pointer, read_head, refuse_pointer};
use self::labels::ClipLabels;
pub use self::names::{escaped, name_of_text, text_of_name, unique_keys};
pub use self::options::ReadOptions;
pub use self::unit::{Unit, UnitError};
pub use self::up::{Up, UpError};
use clip::Outcome;

/// Every source format, in the order in which releases are looked for. To add one, write a folder
/// with a [`Format`] and add its line here.
pub const FORMATS: &[Format] = &[
    bvh::FORMAT,
    amass::FORMAT,
    c3d::FORMAT,
    trc::FORMAT,
    gltf::FORMAT,
    fbx::FORMAT,
    // These two stand before `humanml3d`, which would report their captions as captions without a motion.
    humanml3d_amass::FORMAT,
    representation_272::FORMAT,
    // Before `humanml3d`, which accepts only its own arrays.
    motionx::FORMAT,
    humanml3d::FORMAT,
    stance::FORMAT,
    motionfix::FORMAT,
    seed::FORMAT,
    dataset::FORMAT,
    webdataset::FORMAT,
];

/// The format with this name.
pub fn format_named(name: &str) -> Option<Format> {
    let mut formats = FORMATS.iter().copied();
    formats.find(|format| format.as_str() == name)
}

/// A release among the files, and its format.
pub type FoundRelease = (Format, Box<dyn Release>);

/// The releases among the files with their formats, each found by its layout. `humanml3d_index` is the
/// `index.csv` by which HumanML3D's clips are cut from AMASS files.
///
/// # Errors
/// The index cannot be read.
pub fn find_releases(
    files: &Files,
    humanml3d_index: Option<&Path>,
) -> Result<Vec<FoundRelease>, crate::Error> {
    let mut releases = Vec::new();
    for &format in FORMATS {
        let mut found = (format.find)(files);
        if let Some(index) = humanml3d_index.filter(|_| format == humanml3d_amass::FORMAT) {
            found.push(humanml3d_amass::find(files, index)?);
        }
        releases.extend(found.into_iter().map(|release| (format, release)));
    }
    Ok(releases)
}

/// Recognises a file by its name and first bytes (a few hundred suffice).
pub fn recognise(path: &Path, head: &[u8]) -> Recognised {
    let not_motion = |reason: String| Recognised::NotMotion { reason };
    let lower = |text: &std::ffi::OsStr| text.to_string_lossy().to_lowercase();
    let name = path.file_name().map(lower).unwrap_or_default();
    let extension = path.extension().map(lower).unwrap_or_default();
    for format in FORMATS {
        if let Some(recognised) = format.recognise(&extension, &name, head) {
            return recognised;
        }
    }
    if labels::is_label_file(&name) {
        return not_motion("labels, read with the motions they describe".to_owned());
    }
    let robot = (extension == "csv")
        .then(|| robot::csv_rows(head))
        .flatten();
    if let Some(reason) = robot {
        return not_motion(reason);
    }
    match extension.as_str() {
        "json" if name.ends_with(crate::sidecar::Sidecar::SUFFIX) => {
            return not_motion("sidecar, read with the motion it describes".to_owned());
        }
        "json" | "txt" | "csv" | "md" | "yaml" | "yml" | "toml" | "tsv" => {
            return not_motion(format!("{extension} text, no motion"));
        }
        "pth" | "pt" => {
            return not_motion(format!("{extension} archive of no known release"));
        }
        "tar" if name.ends_with(".pth.tar") => {
            return not_motion("pth archive of no known release".to_owned());
        }
        _ => {}
    }
    if let Some(kind) = archive_kind(&name, &extension, head) {
        return not_motion(format!("{kind} archive; unpack it"));
    }
    let mut formats = FORMATS.iter().copied();
    match formats.find(|format| (format.by_content)(head)) {
        Some(format) => Recognised::Motion(format),
        None if extension.is_empty() => not_motion("no known motion format".to_owned()),
        None => not_motion(format!("{extension} is no known motion format")),
    }
}

/// Kind of an archive, by its name or its first bytes.
fn archive_kind(name: &str, extension: &str, head: &[u8]) -> Option<&'static str> {
    /// Offset of the magic of a tar header.
    const TAR_MAGIC_AT: usize = 257;
    if name.ends_with(".tar.gz") || extension == "tgz" {
        return Some("tar.gz");
    }
    let named = ["zip", "tar", "gz", "7z", "rar", "bz2", "xz", "zst"]
        .into_iter()
        .find(|kind| *kind == extension);
    let magics: [(usize, &[u8], &str); 6] = [
        (0, b"PK\x03\x04", "zip"),
        (0, b"\x1f\x8b", "gz"),
        (0, b"7z\xbc\xaf\x27\x1c", "7z"),
        (0, b"Rar!\x1a\x07", "rar"),
        (0, b"\xfd7zXZ\0", "xz"),
        (TAR_MAGIC_AT, b"ustar", "tar"),
    ];
    let found = magics
        .iter()
        .find(|(at, magic, _)| head.get(*at..).is_some_and(|rest| rest.starts_with(magic)));
    named.or(found.map(|(.., kind)| *kind))
}

/// Turns the bytes of one file into a clip on the given body.
///
/// `companions` reads a file beside it by name (`/` separates folders); `None` if there is no such file. `around` holds
/// the labels from the folders around it.
pub fn read_clip(
    format: Format,
    path: &Path,
    key: &str,
    bytes: &[u8],
    companions: &dyn Fn(&str) -> Option<Vec<u8>>,
    around: &ClipLabels,
    options: &ReadOptions,
) -> Outcome {
    if let Err(rejected) = refuse_pointer(bytes) {
        return Outcome::Rejected(rejected);
    }
    let of_file = labels::options_of(path, companions, options);
    let options = of_file.as_ref();
    let mut outcome = (format.read)(path, key, bytes, options);
    if let (Outcome::Clip(clip), Some(assumed)) = (&mut outcome, format.assumed_up)
        && let Err(rejected) = assumed_up::settle(clip, assumed, options)
    {
        return Outcome::Rejected(rejected);
    }
    label(outcome, path, companions, around)
}

/// Adds the labels beside a file to the clip that was read from it. `companions` and `around` are as in [`read_clip`].
pub fn label(
    outcome: Outcome,
    path: &Path,
    companions: &dyn Fn(&str) -> Option<Vec<u8>>,
    around: &ClipLabels,
) -> Outcome {
    match outcome {
        Outcome::Clip(clip) => {
            Outcome::Clip(Box::new(labels::attach(*clip, path, companions, around)))
        }
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use datasets_spec::Skeleton;

    use super::head::LFS_POINTER;
    use super::release_tests::test_data;
    use super::*;
    use clip::check::check;
    use testkit::walk;

    use super::bvh::dialects::RigText;

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
            ("a/walk.bvh", &b""[..], Some(bvh::FORMAT)),
            ("a/WALK.BVH", b"HIERARCHY", Some(bvh::FORMAT)),
            ("a/walk", b"\xEF\xBB\xBF hierarchy\nR", Some(bvh::FORMAT)),
            ("KIT/3/kick_poses.npz", b"PK\x03\x04", Some(amass::FORMAT)),
            ("KIT/3/shape.npz", b"PK\x03\x04", None),
            ("KIT/3/neutral_stagei.npz", b"PK\x03\x04", None),
            ("a/walk.stance.json", b"{}", None),
            ("a/walk.txt", b"", None),
            ("a/LICENSE", b"MIT", None),
            ("a/walk.pkl", b"\x80\x04", Some(stance::FORMAT)),
            ("a/walk.pkl", LFS_POINTER, Some(stance::FORMAT)),
            ("a/walk.pkl", b"cos\nsystem", Some(stance::FORMAT)),
            ("a/capture.C3D", b"\x02\x50", Some(c3d::FORMAT)),
            ("a/capture.TRC", b"", Some(trc::FORMAT)),
            ("a/noextension", b"PathFileType\t4\t", Some(trc::FORMAT)),
            ("a/robot.glb", b"glTF", Some(gltf::FORMAT)),
            ("a/noextension", b"glTF\x02", Some(gltf::FORMAT)),
            ("a/WALK.FBX", b"", Some(fbx::FORMAT)),
            ("a/walk", b"Kaydara FBX Binary  \0\x1a\0", Some(fbx::FORMAT)),
            ("a/walk.dat", b"; FBX 7.4.0 project", Some(fbx::FORMAT)),
            ("a/weights.pth", b"\x80\x04", None),
            ("a/walks.zip", b"PK\x03\x04", None),
            ("a/walks.tar", b"", None),
            ("", b"", None),
        ] {
            assert_eq!(motion_format(path, head), format, "{path}");
        }
    }

    #[test]
    fn archives_are_named_by_their_kind() {
        let mut tar = [0; 512];
        tar[257..262].copy_from_slice(b"ustar");
        for (path, head, kind) in [
            ("a/walks.zip", &b""[..], "zip"),
            ("a/WALKS.TAR.GZ", b"", "tar.gz"),
            ("a/walks.tgz", b"", "tar.gz"),
            ("a/walk.bvh.gz", b"", "gz"),
            ("a/walks.tar", b"", "tar"),
            ("a/walks.7z", b"", "7z"),
            ("a/walks", b"PK\x03\x04rest", "zip"),
            ("a/walks", &tar, "tar"),
        ] {
            let Recognised::NotMotion { reason } = recognise(Path::new(path), head) else {
                panic!("{path} is no motion");
            };
            assert_eq!(reason, format!("{kind} archive; unpack it"), "{path}");
        }
    }

    fn read_file(
        format: Format,
        path: &Path,
        bytes: &[u8],
        beside: &dyn Fn(&str) -> Option<Vec<u8>>,
    ) -> Outcome {
        let (around, options) = (ClipLabels::default(), ReadOptions::default());
        read_clip(format, path, "", bytes, beside, &around, &options)
    }

    #[test]
    fn a_whole_file_becomes_a_labelled_clip_on_the_floor() {
        let skeleton = Skeleton::smplx_neutral();
        let text = RigText::smplx().write(&walk(60));
        let path = Path::new("set/dataset-1_walk_proud_001.bvh");
        let beside = |name: &str| {
            let is_caption = name == "dataset-1_walk_proud_001.txt";
            is_caption.then(|| b"a man walks#a/DET#0.0#0.0".to_vec())
        };
        let outcome = read_file(bvh::FORMAT, path, text.as_bytes(), &beside);
        let Outcome::Clip(clip) = outcome else {
            panic!("{outcome:?}");
        };
        assert_eq!(clip.style.as_deref(), Some("proud"));
        assert_eq!(clip.captions[0].text, "a man walks");
        assert_eq!(clip.captions.len(), 1);
        let made = &clip.made_captions;
        assert_eq!(made[0].text, "a person walks in a proud style");
        assert_eq!(made.len(), 1);
        check(&clip.motion, &skeleton).expect("a plain walk");
        let lowest = skeleton
            .motion_keypoints(&clip.motion)
            .points
            .iter()
            .flat_map(|points| [points[10].y, points[11].y])
            .fold(f64::INFINITY, f64::min);
        assert!((-0.05..0.01).contains(&lowest), "{lowest}");
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
        Some(read_file(format, path, &bytes, &beside))
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
                    let heights = points.iter().map(|frame| frame[joint].y);
                    heights.fold(f64::NEG_INFINITY, f64::max)
                };
                let [left, right, chest] = [20, 21, 9].map(highest);
                // Some styles raise their hands no higher than the chest.
                match clip.action.as_deref() {
                    Some("raise-up-left-hand") => {
                        assert!(left > chest && right < left - 0.3, "{name}");
                    }
                    Some("raise-up-both-hands") => {
                        assert!(left > chest && right > chest, "{name}");
                    }
                    Some("walk" | "run" | "dash") => {
                        // In total, the body moves in the direction that its hips face.
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
                        // A knee that is bent by 30 to 150 degrees is ahead of the line from hip to ankle.
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
                let outcome = outcome_of(&path);
                let path = path.display();
                match outcome {
                    Some(Outcome::Rejected(rejected)) => {
                        assert!(codes.contains(&rejected.code), "{path}: {rejected:?}");
                    }
                    Some(Outcome::Skipped { reason }) => panic!("{path}: {reason}"),
                    Some(Outcome::Clip(_)) | None => {}
                }
            }
        }
    }
}
