//! AMASS archives in the SMPL-H layout (`*_poses.npz`).

use std::io::{self, Cursor, Seek, Write};

use datasets_spec::{Motion, Skeleton};
use glam::{DQuat, DVec3};
use kinematics::rotation::to_axis_angle;
use npyz::WriterBuilder;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, System, ZipWriter};

/// Numbers of a row of `poses`: 52 joints of SMPL-H times 3.
pub const POSES_WIDTH: usize = 156;
/// Numbers of `betas`.
const NUM_BETAS: usize = 16;
/// Numbers of a row of `dmpls`, the soft-tissue coefficients.
const NUM_DMPLS: usize = 8;

/// Encodes a motion as an AMASS archive: `poses` `[L, 156]` (root, 21 body joints, flat hands),
/// `trans` `[L, 3]`, `betas` and `dmpls` zero, `gender` "neutral", `mocap_framerate`.
///
/// AMASS is z up. The reader's rule `p' = (x, z, -y)`, a rotation Q by -90 degrees about x with
/// `R' = Q R` and `t' = Q (t + J0) - J0`, is inverted here; J0 is the rest pelvis of the skeleton.
/// The 22 body rotations are written as they are, for the skeleton the motion belongs to.
///
/// Members are stored, not compressed: compressors choose code paths by processor, and equal
/// motions shall give equal bytes everywhere. Their time stamps are the earliest a zip can hold.
///
/// # Errors
/// The archive exceeds what a zip without 64-bit extensions can hold (4 GiB).
///
/// # Source
/// The key list of the SMPL+H G release of AMASS.
pub fn encode(motion: &Motion, skeleton: &Skeleton) -> io::Result<Vec<u8>> {
    let file_from_motion = DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2);
    let rest_pelvis = skeleton.rest(0);
    let num_frames = motion.len();
    let mut poses = Vec::with_capacity(num_frames * POSES_WIDTH);
    let mut trans = Vec::with_capacity(num_frames * 3);
    for (frame, pose) in motion.poses().into_iter().enumerate() {
        let root = to_axis_angle(file_from_motion * pose.rotations[0]);
        poses.extend(root.to_array());
        poses.extend(motion.body_pose()[frame].map(f64::from));
        poses.resize((frame + 1) * POSES_WIDTH, 0.0);
        let t: DVec3 = file_from_motion * (pose.transl + rest_pelvis) - rest_pelvis;
        trans.extend(t.to_array());
    }

    let frames = num_frames as u64;
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    array(&mut archive, "poses", &[frames, POSES_WIDTH as u64], &poses)?;
    array(&mut archive, "trans", &[frames, 3], &trans)?;
    array(
        &mut archive,
        "betas",
        &[NUM_BETAS as u64],
        &[0.0; NUM_BETAS],
    )?;
    let dmpls = vec![0.0; num_frames * NUM_DMPLS];
    array(&mut archive, "dmpls", &[frames, NUM_DMPLS as u64], &dmpls)?;
    array(&mut archive, "mocap_framerate", &[], &[motion.fps().get()])?;
    text(&mut archive, "gender", "neutral")?;
    Ok(archive.finish()?.into_inner())
}

fn start(archive: &mut ZipWriter<impl Write + Seek>, name: &str) -> io::Result<()> {
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Stored)
        .last_modified_time(DateTime::default())
        .system(System::Unix);
    Ok(archive.start_file(npyz::npz::file_name_from_array_name(name), options)?)
}

/// Adds an array of numbers.
pub(crate) fn array<T: npyz::AutoSerialize>(
    archive: &mut ZipWriter<impl Write + Seek>,
    name: &str,
    shape: &[u64],
    values: &[T],
) -> io::Result<()> {
    start(archive, name)?;
    super::npy::write(archive, shape, values)
}

/// A string is a 0-d array of UTF-32 text, as numpy writes one.
pub(crate) fn text(
    archive: &mut ZipWriter<impl Write + Seek>,
    name: &str,
    value: &str,
) -> io::Result<()> {
    start(archive, name)?;
    let dtype = format!("<U{}", value.chars().count())
        .parse()
        .map_err(io::Error::other)?;
    let mut writer = npyz::WriteOptions::<str>::new()
        .dtype(npyz::DType::new_scalar(dtype))
        .shape(&[])
        .writer(archive)
        .begin_nd()?;
    writer.push(value)?;
    writer.finish()
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use datasets_spec::{Fps, Pose};
    use npyz::NpyFile;

    use super::*;

    fn member(bytes: &[u8], name: &str) -> (Vec<u64>, Vec<f64>) {
        let mut archive = zip::ZipArchive::new(Cursor::new(bytes)).expect("a zip");
        let mut content = Vec::new();
        archive
            .by_name(&format!("{name}.npy"))
            .expect("the member")
            .read_to_end(&mut content)
            .expect("readable");
        let array = NpyFile::new(&content[..]).expect("an npy");
        let shape = array.shape().to_vec();
        (shape, array.into_vec().expect("numbers"))
    }

    fn motion() -> Motion {
        let mut pose = Pose::REST;
        pose.transl = DVec3::new(0.4, 1.3, -0.2);
        pose.rotations[0] = DQuat::from_rotation_y(0.7) * DQuat::from_rotation_x(0.2);
        pose.rotations[21] = DQuat::from_rotation_z(0.5);
        Motion::from_poses(Fps::STORE, &[Pose::REST, pose]).expect("valid")
    }

    #[test]
    fn the_archive_has_the_layout_of_amass() {
        let bytes = encode(&motion(), &Skeleton::smplx_neutral()).expect("encoded");
        for (name, shape) in [
            ("poses", vec![2, 156]),
            ("trans", vec![2, 3]),
            ("betas", vec![16]),
            ("dmpls", vec![2, 8]),
            ("mocap_framerate", vec![]),
        ] {
            assert_eq!(member(&bytes, name).0, shape, "{name}");
        }
        assert_eq!(member(&bytes, "mocap_framerate").1, [20.0]);
        let (_, poses) = member(&bytes, "poses");
        assert!(
            (poses[156 + 65] - 0.5).abs() < 1e-7,
            "the right wrist turns about z"
        );
        assert!(
            poses[156 + 66..].iter().all(|&v| v == 0.0),
            "hands are flat"
        );
    }

    #[test]
    fn the_readers_rule_recovers_the_motion() {
        let (motion, skeleton) = (motion(), Skeleton::smplx_neutral());
        let bytes = encode(&motion, &skeleton).expect("encoded");
        let (_, poses) = member(&bytes, "poses");
        let (_, trans) = member(&bytes, "trans");
        let upright = DQuat::from_rotation_x(-std::f64::consts::FRAC_PI_2);
        for (frame, pose) in motion.poses().into_iter().enumerate() {
            let root = DVec3::from_slice(&poses[156 * frame..]);
            let root = upright * kinematics::rotation::from_axis_angle(root);
            assert!(kinematics::rotation::angle_between(root, pose.rotations[0]) < 1e-9);
            let t = DVec3::from_slice(&trans[3 * frame..]);
            let t = upright * (t + skeleton.rest(0)) - skeleton.rest(0);
            assert!((t - pose.transl).length() < 1e-12);
        }
    }

    #[test]
    fn a_standing_body_is_z_up_in_the_file() {
        let skeleton = Skeleton::smplx_neutral();
        let motion = Motion::from_poses(Fps::STORE, &[Pose::REST]).expect("valid");
        let bytes = encode(&motion, &skeleton).expect("encoded");
        let (_, poses) = member(&bytes, "poses");
        let root = kinematics::rotation::from_axis_angle(DVec3::from_slice(&poses));
        assert!(
            (root * DVec3::Y - DVec3::Z).length() < 1e-9,
            "the head is up"
        );
        assert!(
            (root * DVec3::Z - DVec3::NEG_Y).length() < 1e-9,
            "the body faces -y"
        );
    }
}
