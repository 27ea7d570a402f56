//! AMASS archives with the keys of the SMPL-X N release, z up.

use std::collections::BTreeSet;
use std::fs;
use std::io::{self, Cursor};
use std::path::Path;

use datasets_spec::record::MotionRow;
use datasets_spec::table::{Row, read_rows};
use datasets_spec::{Dataset, Motion, Progress, Skeleton};
use glam::DQuat;
use kinematics::rotation::to_axis_angle;
use kinematics::skeleton::NUM_KEYPOINTS;
use rayon::prelude::*;
use zip::ZipWriter;

use crate::Error;
use crate::write::amass::{array, text};

/// Numbers of a row of `poses`: 55 joints of SMPL-X times 3.
const POSES_WIDTH: usize = 165;
const HANDS_WIDTH: usize = 90;
const JAW_WIDTH: usize = 3;
const EYES_WIDTH: usize = 6;
const NUM_BETAS: usize = 16;
/// End of the names of the files of the release.
const NAME_END: &str = "_stageii.npz";

/// Writes a file for each motion, in folders as its id has them, and returns their number.
///
/// # Errors
/// The dataset cannot be read or a file cannot be written.
pub(super) fn write(
    dataset: &Dataset,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<u64, Error> {
    let skeleton = dataset.skeleton()?;
    let shards = dataset.files(MotionRow::TABLE, None);
    let total = shards.iter().map(|(_, file)| file.rows).sum();
    progress.begin("export amass", Some(total));
    let mut taken = BTreeSet::new();
    for (path, _) in shards {
        let rows = read_rows::<MotionRow>(&path)?;
        let named: Vec<(&MotionRow, String)> = rows
            .iter()
            .map(|row| (row, file_name(row.id.as_str(), &mut taken)))
            .collect();
        named.into_par_iter().try_for_each(|(row, name)| {
            let path = folder.join(name);
            if let Some(parent) = path.parent() {
                fs::create_dir_all(parent).map_err(Error::io("create folder", parent))?;
            }
            let bytes = encode(&row.motion()?, &skeleton).map_err(Error::io("encode", &path))?;
            fs::write(&path, bytes).map_err(Error::io("write", &path))?;
            progress.advance(1);
            Ok::<(), Error>(())
        })?;
    }
    progress.finish(&format!("{total} archives"));
    Ok(total)
}

/// A relative path for an id that stays inside the folder, and is not taken even where names that
/// differ in case alone are one.
pub(super) fn file_name(id: &str, taken: &mut BTreeSet<String>) -> String {
    let parts: Vec<String> = id
        .split('/')
        .map(|part| match part {
            "" | "." | ".." => "_".to_owned(),
            part => part.replace(['\\', ':'], "_"),
        })
        .collect();
    let stem = parts.join("/");
    let mut name = format!("{stem}{NAME_END}");
    let mut number = 1;
    while !taken.insert(name.to_lowercase()) {
        number += 1;
        name = format!("{stem}-{number}{NAME_END}");
    }
    name
}

/// Encodes a motion as an archive of the SMPL-X N release: `poses` `[L, 165]` (root, body, jaw,
/// eyes, hands) and the same in parts, `trans` `[L, 3]`, `betas` zero, gender neutral.
///
/// The reader's turn from z up is undone: `R = Q^-1 R'` and `t = Q^-1 (t' + J0) - J0` with `J0` the
/// rest pelvis of the skeleton. Hands, jaw and eyes are at rest.
///
/// # Errors
/// The archive exceeds what a zip without 64-bit extensions can hold (4 GiB).
///
/// # Source
/// The key list of the SMPL-X releases of AMASS.
pub(super) fn encode(motion: &Motion, skeleton: &Skeleton) -> io::Result<Vec<u8>> {
    Ok(archive(motion, skeleton)?.finish()?.into_inner())
}

/// [`encode`], with the 28 keypoints in the same frame: `keypoints` `[L, 28, 3]` in metres, z up.
///
/// # Errors
/// As [`encode`].
pub(super) fn encode_with_keypoints(motion: &Motion, skeleton: &Skeleton) -> io::Result<Vec<u8>> {
    let mut archive = archive(motion, skeleton)?;
    let points = skeleton.motion_keypoints(motion).points;
    // The turn from y up, written out: its numbers are exact.
    let z_up: Vec<f64> = points
        .iter()
        .flatten()
        .flat_map(|point| [point.x, -point.z, point.y])
        .collect();
    let shape = [points.len() as u64, NUM_KEYPOINTS as u64, 3];
    array(&mut archive, "keypoints", &shape, &z_up)?;
    Ok(archive.finish()?.into_inner())
}

fn archive(motion: &Motion, skeleton: &Skeleton) -> io::Result<ZipWriter<Cursor<Vec<u8>>>> {
    let file_from_motion = DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2);
    let rest_pelvis = skeleton.rest(0);
    let num_frames = motion.len();
    let (mut root, mut trans) = (Vec::new(), Vec::new());
    for pose in motion.poses() {
        root.extend(to_axis_angle(file_from_motion * pose.rotations[0]).to_array());
        let shifted = file_from_motion * (pose.transl + rest_pelvis) - rest_pelvis;
        trans.extend(shifted.to_array());
    }
    let body: Vec<f64> = motion
        .body_pose()
        .as_flattened()
        .iter()
        .map(|&value| f64::from(value))
        .collect();
    let mut poses = Vec::with_capacity(num_frames * POSES_WIDTH);
    for (frame, (root, body)) in root
        .chunks_exact(3)
        .zip(body.chunks_exact(body.len() / num_frames))
        .enumerate()
    {
        poses.extend_from_slice(root);
        poses.extend_from_slice(body);
        poses.resize((frame + 1) * POSES_WIDTH, 0.0);
    }

    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    text(&mut archive, "gender", "neutral")?;
    text(&mut archive, "surface_model_type", "smplx")?;
    let fps = motion.fps().get();
    array(&mut archive, "mocap_frame_rate", &[], &[fps])?;
    let seconds = num_frames as f64 / fps;
    array(&mut archive, "mocap_time_length", &[], &[seconds])?;
    let betas = [0.0; NUM_BETAS];
    array(&mut archive, "betas", &[NUM_BETAS as u64], &betas)?;
    array(&mut archive, "num_betas", &[], &[NUM_BETAS as i64])?;
    let mut matrix = |name: &str, values: &[f64]| {
        let width = values.len() / num_frames;
        array(
            &mut archive,
            name,
            &[num_frames as u64, width as u64],
            values,
        )
    };
    matrix("trans", &trans)?;
    matrix("poses", &poses)?;
    matrix("root_orient", &root)?;
    matrix("pose_body", &body)?;
    for (name, width) in [
        ("pose_hand", HANDS_WIDTH),
        ("pose_jaw", JAW_WIDTH),
        ("pose_eye", EYES_WIDTH),
    ] {
        matrix(name, &vec![0.0; num_frames * width])?;
    }
    Ok(archive)
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use datasets_spec::NoProgress;
    use glam::DVec3;
    use kinematics::rotation::{angle_between, from_axis_angle};

    use super::*;
    use crate::ingest::{IngestOptions, ingest};
    use crate::retarget::tests::walk;

    fn ingested(source: &Path, out: &Path) -> Dataset {
        let sources = [PathBuf::from(source)];
        ingest(
            &sources,
            out,
            &IngestOptions::default(),
            "test",
            &NoProgress,
        )
        .expect("plain files")
        .dataset
    }

    fn rotation(axis_angle: [f32; 3]) -> DQuat {
        from_axis_angle(DVec3::from_array(axis_angle.map(f64::from)))
    }

    #[test]
    fn what_is_exported_comes_back() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let at = |name: &str| folder.path().join(name);
        fs::create_dir_all(at("in/a")).expect("made");
        let skeleton = Skeleton::smplx_neutral();
        let motion = Motion::from_poses(datasets_spec::Fps::STORE, &walk(60)).expect("valid");
        let bytes = crate::write::amass::encode(&motion, &skeleton).expect("encoded");
        fs::write(at("in/a/walk_poses.npz"), bytes).expect("written");
        let first = ingested(&at("in"), &at("first"));
        fs::create_dir_all(at("out")).expect("made");
        assert_eq!(write(&first, &at("out"), &NoProgress).expect("written"), 1);
        assert!(at("out/a/walk_poses_stageii.npz").is_file());
        let again = ingested(&at("out"), &at("again"));

        let row = |dataset: &Dataset| dataset.read::<MotionRow>(None).expect("read")[0].clone();
        let (before, after) = (row(&first), row(&again));
        assert_eq!(before.body_pose, after.body_pose, "copied bit by bit");
        assert!(after.notes.iter().any(|note| note.contains("SMPL-X N")));
        for frame in 0..before.transl.len() {
            for axis in 0..3 {
                // The floor is found anew: f32 in the store, in metres.
                let apart = before.transl[frame][axis] - after.transl[frame][axis];
                assert!(apart.abs() < 1e-6, "{apart}");
            }
            let [a, b] = [&before, &after].map(|row| rotation(row.global_orient[frame]));
            assert!(angle_between(a, b) < 1e-6);
        }
    }

    #[test]
    fn no_id_leaves_the_folder_or_meets_another() {
        let mut taken = BTreeSet::new();
        let mut name = |id: &str| file_name(id, &mut taken);
        assert_eq!(name("KIT/3/kick"), "KIT/3/kick_stageii.npz");
        assert_eq!(name("../../etc/x"), "_/_/etc/x_stageii.npz");
        assert_eq!(name("/x"), "_/x_stageii.npz");
        assert_eq!(name("kit/3/KICK"), "kit/3/KICK-2_stageii.npz");
        assert_eq!(name("c:\\x"), "c__x_stageii.npz");
    }
}
