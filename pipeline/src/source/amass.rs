//! The AMASS reader: SMPL, SMPL-H and SMPL-X parameters in an npz archive, z up.

use std::io::{Cursor, Read};

use datasets_spec::rotation::{from_axis_angle, to_axis_angle};
use datasets_spec::{Fps, Motion, Pose, Skeleton};
use glam::{DQuat, DVec3};
use zip::ZipArchive;
use zip::result::ZipError;

use super::npy::{self, Array};
use super::{MAX_FPS, MIN_FPS, Rejected, RotationSource, SourceClip, floor};

/// Largest member read, in bytes, and highest ratio to its compressed size: real recordings stay
/// far below both (an hour of SMPL-X at 120 fps is 570 MB), archives built to exhaust memory do
/// not.
const MAX_MEMBER_LEN: u64 = 2 << 30;
const MAX_RATIO: u64 = 200;
/// Size below which the ratio does not matter: a clip whose hands are all zero compresses well.
const SMALL_MEMBER_LEN: u64 = 1 << 20;
/// Most members of an archive; the richest AMASS files have about thirty.
const MAX_MEMBERS: usize = 10_000;

/// Both spellings of the frame rate: that of the SMPL-H and that of the SMPL-X releases.
const FPS_KEYS: [&str; 2] = ["mocap_framerate", "mocap_frame_rate"];
/// Numbers that root and body joints take in every layout.
const BODY_WIDTH: usize = 66;
/// Widths of `poses` and the body model each belongs to: 24, 52 and 55 joints, and the 22 joints
/// that all three have in common.
const LAYOUTS: [(usize, &str); 4] = [
    (66, "body only"),
    (72, "SMPL"),
    (156, "SMPL-H"),
    (165, "SMPL-X"),
];

/// What an archive holds.
pub enum Content {
    /// A clip.
    Clip(Box<SourceClip>),
    /// Something that belongs to AMASS and is no motion.
    NoMotion {
        /// What it is.
        reason: String,
    },
}

/// Carries AMASS's z-up coordinates to y up: `(x, y, z)` becomes `(x, z, -y)`, a quarter turn about
/// x. A body facing -y in the file faces +z in the store.
///
/// HumanML3D maps to `(-x, z, y)` instead: the same up to a half turn about the vertical.
fn y_up_from_z_up() -> DQuat {
    DQuat::from_rotation_x(-std::f64::consts::FRAC_PI_2)
}

/// Reads an archive as a motion of the given body.
///
/// The 22 body rotations are taken as they are: the joints of SMPL, SMPL-H and SMPL-X agree in
/// order and rest orientation. Body shape is ignored, so the store's one body performs the motion.
///
/// # Errors
/// `E-NPZ-TRUNCATED`, `E-NPZ-CRC`, `E-NPZ-LIMIT`, those of [`npy`], `E-AMASS-KEYS`,
/// `E-AMASS-SHAPE`, `E-AMASS-FPS`, `E-TOO-SHORT` or `E-NOT-FINITE`.
///
/// # Source
/// For a rotation `Q` of the world, `R' = Q R` and `t' = Q (t + J0) - J0` with `J0` the rest
/// position of the pelvis, about which SMPL turns the body.
pub fn read(bytes: &[u8], skeleton: &Skeleton) -> Result<Content, Rejected> {
    let mut archive = Archive::open(bytes)?;
    let has = |archive: &Archive, key: &str| archive.keys.iter().any(|found| found == key);
    let split_poses = has(&archive, "root_orient") && has(&archive, "pose_body");
    if !has(&archive, "trans") || !(has(&archive, "poses") || split_poses) {
        return no_poses(&archive);
    }

    let mut notes = Vec::new();
    let (root, body) = if has(&archive, "poses") {
        let poses = archive.matrix("poses")?;
        let layout = LAYOUTS.iter().find(|(width, _)| *width == poses.shape[1]);
        let Some((width, model)) = layout else {
            return Err(Rejected::read(
                "E-AMASS-SHAPE",
                format!(
                    "found poses of {} columns, expected 72 (SMPL), 156 (SMPL-H) or 165 (SMPL-X)",
                    poses.shape[1]
                ),
            ));
        };
        notes.push(format!("{model} parameters ({width} pose columns)"));
        (columns(&poses, 0, 3), columns(&poses, 3, BODY_WIDTH))
    } else {
        notes.push("SMPL-X parameters (root_orient and pose_body)".to_owned());
        let (root, body) = (archive.matrix("root_orient")?, archive.matrix("pose_body")?);
        expect_columns("root_orient", &root, 3)?;
        expect_columns("pose_body", &body, BODY_WIDTH - 3)?;
        (root.values, body.values)
    };
    let trans = archive.matrix("trans")?;
    expect_columns("trans", &trans, 3)?;
    let num_frames = trans.shape[0];
    for (key, found) in [
        ("root orientations", root.len() / 3),
        ("body poses", body.len() / 63),
    ] {
        if found != num_frames {
            return Err(Rejected::read(
                "E-AMASS-SHAPE",
                format!("found {found} {key}, expected {num_frames} as trans has"),
            ));
        }
    }
    if num_frames == 0 {
        return Err(Rejected::read(
            "E-TOO-SHORT",
            "found 0 frames, expected at least 2",
        ));
    }
    let fps = archive.fps()?;
    check_finite(&[
        ("trans", &trans.values, 3),
        ("root", &root, 3),
        ("body", &body, 63),
    ])?;

    if has(&archive, "gender") {
        notes.push(
            match archive
                .member("gender")
                .and_then(|bytes| npy::read_text("gender", &bytes))
            {
                // Python 2 wrote the text of a bytes object.
                Ok(gender) => format!(
                    "gender {}, body shape ignored",
                    gender.trim_start_matches("b'").trim_end_matches('\'')
                ),
                Err(rejected) => format!("gender unknown ({})", rejected.reason),
            },
        );
    }
    notes.push(format!(
        "rotations drive the body {} as they are",
        skeleton.name()
    ));

    let motion = y_up_motion(fps, &trans.values, &root, &body, skeleton)?;
    Ok(Content::Clip(Box::new(SourceClip {
        num_source_frames: num_frames,
        first_frame: 0,
        motion,
        rotation_source: RotationSource::Native,
        fit_error_m: None,
        captions: Vec::new(),
        part_captions: Vec::new(),
        action: None,
        style: None,
        license: None,
        notes,
    })))
}

fn no_poses(archive: &Archive) -> Result<Content, Rejected> {
    let keys = archive.keys.join(", ");
    if archive.keys.iter().any(|key| key == "betas")
        && !archive.keys.iter().any(|key| key == "trans")
    {
        return Ok(Content::NoMotion {
            reason: format!("body shape of a subject, no motion (keys: {keys})"),
        });
    }
    Err(Rejected::read(
        "E-AMASS-KEYS",
        format!("found keys {keys}; expected trans and either poses or root_orient and pose_body"),
    ))
}

fn y_up_motion(
    fps: Fps,
    trans: &[f64],
    root: &[f64],
    body: &[f64],
    skeleton: &Skeleton,
) -> Result<Motion, Rejected> {
    let turn = y_up_from_z_up();
    let rest_pelvis = skeleton.rest(0);
    let mut poses: Vec<Pose> = trans
        .chunks_exact(3)
        .zip(root.chunks_exact(3))
        .zip(body.chunks_exact(BODY_WIDTH - 3))
        .map(|((trans, root), body)| {
            let mut rotations = [DQuat::IDENTITY; 22];
            rotations[0] = turn * from_axis_angle(DVec3::from_slice(root));
            for (rotation, axis_angle) in rotations[1..].iter_mut().zip(body.chunks_exact(3)) {
                *rotation = from_axis_angle(DVec3::from_slice(axis_angle));
            }
            Pose {
                transl: turn * (DVec3::from_slice(trans) + rest_pelvis) - rest_pelvis,
                rotations,
            }
        })
        .collect();
    floor::put_on_floor(&mut poses, fps, skeleton);
    // Body rotations are copied, not recomputed: what needs no change keeps its bits.
    Motion::new(
        fps,
        poses
            .iter()
            .map(|pose| pose.transl.as_vec3().to_array())
            .collect(),
        poses
            .iter()
            .map(|pose| to_axis_angle(pose.rotations[0]).as_vec3().to_array())
            .collect(),
        body.chunks_exact(BODY_WIDTH - 3)
            .map(|frame| std::array::from_fn(|column| frame[column] as f32))
            .collect(),
    )
    .map_err(|error| Rejected::read("E-NOT-FINITE", error.to_string()))
}

fn columns(array: &Array, from: usize, to: usize) -> Vec<f64> {
    array
        .values
        .chunks_exact(array.shape[1])
        .flat_map(|row| &row[from..to])
        .copied()
        .collect()
}

fn expect_columns(key: &str, array: &Array, expected: usize) -> Result<(), Rejected> {
    if array.shape[1] == expected {
        return Ok(());
    }
    Err(Rejected::read(
        "E-AMASS-SHAPE",
        format!(
            "found {key} of {} columns, expected {expected}",
            array.shape[1]
        ),
    ))
}

fn check_finite(arrays: &[(&str, &[f64], usize)]) -> Result<(), Rejected> {
    for (name, values, width) in arrays {
        if let Some(at) = values.iter().position(|value| !(*value as f32).is_finite()) {
            return Err(Rejected::read(
                "E-NOT-FINITE",
                format!(
                    "found {} in frame {} of {name}, expected finite numbers",
                    values[at],
                    at / width
                ),
            ));
        }
    }
    Ok(())
}

/// An npz archive in memory.
struct Archive<'a> {
    zip: ZipArchive<Cursor<&'a [u8]>>,
    /// Names of the arrays, sorted.
    keys: Vec<String>,
}

impl<'a> Archive<'a> {
    fn open(bytes: &'a [u8]) -> Result<Self, Rejected> {
        let zip = ZipArchive::new(Cursor::new(bytes)).map_err(|error| {
            Rejected::read(
                "E-NPZ-TRUNCATED",
                format!(
                    "found no complete zip archive in {} bytes ({error})",
                    bytes.len()
                ),
            )
            .at(bytes.len())
        })?;
        if zip.len() > MAX_MEMBERS {
            return Err(Rejected::read(
                "E-NPZ-LIMIT",
                format!(
                    "found {} members, expected at most {MAX_MEMBERS}",
                    zip.len()
                ),
            ));
        }
        let mut keys: Vec<String> = zip
            .file_names_raw()
            .filter_map(|name| name.strip_suffix(b".npy"))
            .map(|name| String::from_utf8_lossy(name).into_owned())
            .collect();
        keys.sort();
        Ok(Self { zip, keys })
    }

    /// The bytes of an array's npy file, checked against its CRC.
    fn member(&mut self, key: &str) -> Result<Vec<u8>, Rejected> {
        let name = format!("{key}.npy");
        let mut file = self
            .zip
            .by_name(&name)
            .map_err(|error| member_error(&name, &error))?;
        let (len, compressed_len) = (file.size(), file.compressed_size());
        let start = file.data_start().unwrap_or_else(|| file.header_start());
        if len > MAX_MEMBER_LEN
            || (len > SMALL_MEMBER_LEN && len / MAX_RATIO > compressed_len.max(1))
        {
            return Err(Rejected::read(
                "E-NPZ-LIMIT",
                format!(
                    "{name} unpacks from {compressed_len} to {len} bytes, expected at most \
                     {MAX_MEMBER_LEN} and {MAX_RATIO} times its packed size"
                ),
            )
            .at(start as usize));
        }
        // The stated length is not believed: nothing is reserved by it, and reading stops there.
        let mut bytes = Vec::new();
        file.by_ref()
            .take(len)
            .read_to_end(&mut bytes)
            .and_then(|_| file.read(&mut [0]).map(drop))
            .map_err(|error| member_error(&name, &ZipError::Io(error)).at(start as usize))?;
        Ok(bytes)
    }

    fn numbers(&mut self, key: &str) -> Result<Array, Rejected> {
        let bytes = self.member(key)?;
        npy::read_numbers(key, &bytes)
    }

    /// An array of two dimensions.
    fn matrix(&mut self, key: &str) -> Result<Array, Rejected> {
        let array = self.numbers(key)?;
        if array.shape.len() != 2 || array.shape[1] == 0 {
            return Err(Rejected::read(
                "E-AMASS-SHAPE",
                format!(
                    "found {key} of shape {:?}, expected frames by columns",
                    array.shape
                ),
            ));
        }
        Ok(array)
    }

    fn fps(&mut self) -> Result<Fps, Rejected> {
        let key = FPS_KEYS
            .into_iter()
            .find(|key| self.keys.iter().any(|found| found == key))
            .ok_or_else(|| {
                Rejected::read(
                    "E-AMASS-FPS",
                    format!(
                        "found keys {}, expected {}",
                        self.keys.join(", "),
                        FPS_KEYS.join(" or ")
                    ),
                )
            })?;
        let rate = self.numbers(key)?;
        let value = rate.values.first().copied().unwrap_or(f64::NAN);
        Some(value)
            .filter(|value| rate.values.len() == 1 && (MIN_FPS..=MAX_FPS).contains(value))
            .and_then(|value| Fps::from_file(value).ok())
            .ok_or_else(|| {
                Rejected::read(
                    "E-AMASS-FPS",
                    format!(
                        "found {key} {value} ({} values), expected one of {MIN_FPS} to {MAX_FPS}",
                        rate.values.len()
                    ),
                )
            })
    }
}

fn member_error(name: &str, error: &ZipError) -> Rejected {
    let code = match error {
        ZipError::Io(io) if io.kind() == std::io::ErrorKind::InvalidData => "E-NPZ-CRC",
        _ => "E-NPZ-TRUNCATED",
    };
    Rejected::read(code, format!("{name} cannot be unpacked ({error})"))
}

#[cfg(test)]
pub(crate) mod tests {
    use std::io::Write;

    use proptest::prelude::*;
    use zip::ZipWriter;
    use zip::write::SimpleFileOptions;

    use super::*;
    use crate::source::npy::tests::{npy, npy_f8};

    /// An npz archive of these members.
    pub(crate) fn npz(members: &[(&str, Vec<u8>)]) -> Vec<u8> {
        let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
        for (key, bytes) in members {
            writer
                .start_file(format!("{key}.npy"), SimpleFileOptions::default())
                .expect("in memory");
            writer.write_all(bytes).expect("in memory");
        }
        writer.finish().expect("in memory").into_inner()
    }

    /// Members of a clip of `frames` frames and `width` pose columns in which everything differs.
    pub(crate) fn clip_members(frames: usize, width: usize) -> Vec<(&'static str, Vec<u8>)> {
        let values = |count: usize, scale: f64| -> Vec<f64> {
            (0..count)
                .map(|i| scale * ((i * 37 % 101) as f64 / 101.0 - 0.5))
                .collect()
        };
        vec![
            (
                "poses",
                npy_f8(&[frames, width], &values(frames * width, 1.0)),
            ),
            ("trans", npy_f8(&[frames, 3], &values(frames * 3, 0.1))),
            ("mocap_framerate", npy_f8(&[], &[120.000_045_776])),
            (
                "gender",
                npy(
                    "{'descr': '|S4', 'fortran_order': False, 'shape': (), }",
                    b"male",
                ),
            ),
        ]
    }

    fn read_members(members: &[(&str, Vec<u8>)]) -> Result<Content, Rejected> {
        read(&npz(members), &Skeleton::smplx_neutral())
    }

    fn clip(members: &[(&str, Vec<u8>)]) -> SourceClip {
        match read_members(members).expect("reads") {
            Content::Clip(clip) => *clip,
            Content::NoMotion { reason } => panic!("skipped: {reason}"),
        }
    }

    fn code(members: &[(&str, Vec<u8>)]) -> &'static str {
        match read_members(members) {
            Err(rejected) => rejected.code,
            Ok(_) => "accepted",
        }
    }

    #[test]
    fn a_body_facing_minus_y_in_z_up_faces_plus_z_in_the_store() {
        let skeleton = Skeleton::smplx_neutral();
        // A standing body of AMASS: a quarter turn about x, so that it faces -y.
        let mut poses = vec![0.0; 2 * 72];
        for frame in 0..2 {
            poses[72 * frame] = std::f64::consts::FRAC_PI_2;
        }
        let trans = [1.0, 2.0, 3.0, 1.5, 2.0, 3.0];
        let clip = clip(&[
            ("poses", npy_f8(&[2, 72], &poses)),
            ("trans", npy_f8(&[2, 3], &trans)),
            ("mocap_frame_rate", npy_f8(&[], &[60.0])),
        ]);
        assert_eq!(clip.motion.fps().get(), 60.0);
        let pose = clip.motion.pose(0);
        assert!(
            pose.rotations[0].angle_between(DQuat::IDENTITY) < 1e-6,
            "faces +z"
        );
        let pelvis = skeleton.keypoints(&pose)[0];
        let in_file = DVec3::new(1.0, 2.0, 3.0) + skeleton.rest(0);
        // Only the height is free: it is set by the floor.
        assert!((pelvis.x - in_file.x).abs() < 1e-6 && (pelvis.z + in_file.y).abs() < 1e-6);
        let moved = skeleton.keypoints(&clip.motion.pose(1))[0] - pelvis;
        assert!((moved - DVec3::X * 0.5).length() < 1e-6);
    }

    #[test]
    fn all_layouts_carry_the_same_body_rotations() {
        let split = {
            let mut members = clip_members(4, 165);
            let poses = npy::read_numbers("poses", &members[0].1).expect("valid");
            members[0] = ("root_orient", npy_f8(&[4, 3], &columns(&poses, 0, 3)));
            members.push(("pose_body", npy_f8(&[4, 63], &columns(&poses, 3, 66))));
            members
        };
        for members in [
            clip_members(4, 72),
            clip_members(4, 156),
            clip_members(4, 165),
            split,
        ] {
            let motion = clip(&members).motion;
            assert_eq!((motion.len(), motion.fps().get()), (4, 120.0));
            let poses = match npy::read_numbers("poses", &members[0].1).expect("valid") {
                Array { shape, values } if shape[1] > 3 => values[3..66].to_vec(),
                _ => npy::read_numbers("pose_body", &members[4].1)
                    .expect("valid")
                    .values[..63]
                    .to_vec(),
            };
            for (stored, in_file) in motion.body_pose()[0].iter().zip(poses) {
                assert_eq!(*stored, in_file as f32, "copied, not recomputed");
            }
        }
    }

    #[test]
    fn what_is_wrong_is_rejected_by_code() {
        let without = |key: &str| -> Vec<(&'static str, Vec<u8>)> {
            clip_members(3, 156)
                .into_iter()
                .filter(|(found, _)| *found != key)
                .collect()
        };
        let with = |key: &'static str, bytes: Vec<u8>| {
            let mut members = without(key);
            members.push((key, bytes));
            members
        };
        assert_eq!(code(&clip_members(3, 156)), "accepted");
        assert_eq!(code(&without("trans")), "E-AMASS-KEYS");
        assert_eq!(code(&without("mocap_framerate")), "E-AMASS-FPS");
        assert_eq!(
            code(&with("mocap_framerate", npy_f8(&[], &[0.0]))),
            "E-AMASS-FPS"
        );
        assert_eq!(
            code(&with("mocap_framerate", npy_f8(&[0], &[]))),
            "E-AMASS-FPS"
        );
        assert_eq!(
            code(&with("trans", npy_f8(&[2, 3], &[0.0; 6]))),
            "E-AMASS-SHAPE"
        );
        assert_eq!(
            code(&with("trans", npy_f8(&[9], &[0.0; 9]))),
            "E-AMASS-SHAPE"
        );
        assert_eq!(code(&clip_members(3, 100)), "E-AMASS-SHAPE");
        assert_eq!(code(&clip_members(0, 156)), "E-TOO-SHORT");
        let objects = "{'descr': '|O', 'fortran_order': False, 'shape': (3, 3), }";
        assert_eq!(
            code(&with("trans", npy(objects, b"cos\nsystem\n."))),
            "E-PICKLE-REFUSED"
        );
        let lie = "{'descr': '<f8', 'fortran_order': False, 'shape': (1099511627776, 156), }";
        assert_eq!(code(&with("poses", npy(lie, &[0; 16]))), "E-NPY-SHAPE");
        let mut trans = vec![0.0; 9];
        trans[7] = f64::NAN;
        let rejected = read_members(&with("trans", npy_f8(&[3, 3], &trans)))
            .err()
            .expect("not a number");
        assert_eq!(rejected.code, "E-NOT-FINITE");
        assert!(rejected.reason.contains("frame 2"), "{}", rejected.reason);
        // A gender that is pickled costs the gender, not the clip.
        let pickled = npy(
            "{'descr': '|O', 'fortran_order': False, 'shape': (), }",
            b".",
        );
        assert!(
            clip(&with("gender", pickled))
                .notes
                .iter()
                .any(|note| note.contains("pickled"))
        );
    }

    #[test]
    fn shapes_without_motion_are_passed_over() {
        let shape = read_members(&[("betas", npy_f8(&[16], &[0.0; 16]))]).expect("known");
        assert!(matches!(shape, Content::NoMotion { .. }));
    }

    #[test]
    fn damaged_archives_are_rejected_by_code() {
        let skeleton = Skeleton::smplx_neutral();
        let bytes = npz(&clip_members(30, 156));
        for len in [0, 3, 100, bytes.len() / 2, bytes.len() - 1] {
            let rejected = read(&bytes[..len], &skeleton).err().expect("cut off");
            assert_eq!(rejected.code, "E-NPZ-TRUNCATED", "{len} bytes");
        }
        let stored = {
            let options =
                SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
            let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
            for (key, member) in clip_members(3, 72) {
                writer
                    .start_file(format!("{key}.npy"), options)
                    .expect("in memory");
                writer.write_all(&member).expect("in memory");
            }
            writer.finish().expect("in memory").into_inner()
        };
        let mut flipped = stored.clone();
        flipped[400] ^= 1;
        let rejected = read(&flipped, &skeleton).err().expect("one bit is wrong");
        assert_eq!(rejected.code, "E-NPZ-CRC");
    }

    #[test]
    fn a_bomb_is_not_unpacked() {
        let members = [
            ("poses", npy_f8(&[40_000, 156], &vec![0.0; 40_000 * 156])),
            ("trans", npy_f8(&[40_000, 3], &vec![0.0; 120_000])),
            ("mocap_framerate", npy_f8(&[], &[120.0])),
        ];
        assert_eq!(code(&members), "E-NPZ-LIMIT");
    }

    proptest! {
        #[test]
        fn no_bytes_make_it_panic(
            bytes in prop::collection::vec(any::<u8>(), 0..300),
            edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
            cut in any::<prop::sample::Index>(),
        ) {
            let skeleton = Skeleton::smplx_neutral();
            let valid = npz(&clip_members(2, 72));
            let mut mutated = valid.clone();
            for (at, byte) in edits {
                let at = at.index(mutated.len());
                mutated[at] = byte;
            }
            for candidate in [&bytes[..], &mutated, &valid[..cut.index(valid.len())]] {
                if let Ok(Content::Clip(clip)) = read(candidate, &skeleton) {
                    prop_assert!(clip.motion.len() == clip.num_source_frames);
                }
            }
        }
    }
}
