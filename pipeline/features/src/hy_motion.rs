//! The 201 features per frame of HY-Motion 1.0, from any motion and back.
//!
//! 22 joints, y up, metres, 30 fps:
//!
//! | columns | content |
//! |---|---|
//! | 0..3 | translation, the parameter of SMPL: the pelvis without its rest position |
//! | 3..9 | rotation of the root |
//! | 9..135 | local rotations of joints 1 to 21 |
//! | 135..201 | 22 joints by forward kinematics without the translation, so that the pelvis keeps its rest position |
//!
//! A rotation is the first two columns of its matrix, read row by row: `m00 m01 m10 m11 m20 m21`. This differs from
//! HumanML3D (column by column) and from the 272 features (rows).
//!
//! The released code does not say how a clip is placed. Here its first frame faces +z with a translation of x = z = 0,
//! and heights are unchanged, so the floor is at y = 0.
//!
//! # Source
//! Tencent-Hunyuan/HY-Motion-1.0: `hymotion/pipeline/motion_diffusion.py` (`_decode_o6dp`),
//! `hymotion/utils/geometry.py`, and its issue 33 on the joints.

use datasets_spec::{Motion, Pose, Skeleton};
use glam::{DMat3, DQuat, DVec3};
use kinematics::rotation::from_six_d_columns;
use kinematics::skeleton::NUM_BODY_JOINTS;

use super::released_fps;
use super::representation_272::faced_poses;

/// Name and version of the recipe. Any change of its numbers is a new version.
pub const RECIPE: &str = "hy-motion@1";
/// Number of features of a frame.
pub const WIDTH: usize = 201;
/// The features of a frame.
pub type Features = [f32; WIDTH];

/// First column of the rotations.
const ROTATIONS: usize = 3;

/// The features of a motion on a body, at 30 fps. The motion's place and heading do not matter.
///
/// # Shapes
/// `[L, 201]` for a motion of `L` frames at 30 fps; motions of other rates are interpolated.
///
/// # Errors
/// The motion cannot be resampled to 30 fps.
pub fn features_of_motion(
    motion: &Motion,
    skeleton: &Skeleton,
) -> Result<Vec<Features>, kinematics::Error> {
    let mut poses = faced_poses(motion)?;
    let origin = poses
        .first()
        .map_or(DVec3::ZERO, |first| first.transl.with_y(0.0));
    for pose in &mut poses {
        pose.transl -= origin;
    }
    let joints = skeleton.points_of_poses::<NUM_BODY_JOINTS>(&poses);
    let frames = poses.iter().zip(&joints);
    Ok(frames
        .map(|(pose, joints)| {
            let rotations = pose.rotations.iter().flat_map(|&rotation| {
                let columns = DMat3::from_quat(rotation);
                let (first, second) = (columns.x_axis, columns.y_axis);
                [first.x, second.x, first.y, second.y, first.z, second.z]
            });
            let joints = joints
                .iter()
                .flat_map(|joint| (*joint - pose.transl).to_array());
            let mut frame = [0.0; WIDTH];
            let values = pose.transl.to_array().into_iter();
            for (slot, value) in frame.iter_mut().zip(values.chain(rotations).chain(joints)) {
                *slot = value as f32;
            }
            frame
        })
        .collect())
}

/// The motion from the translation and rotations of the features, at 30 fps.
///
/// # Errors
/// There is no frame, or a number is not finite.
pub fn motion_of_features(features: &[Features]) -> Result<Motion, kinematics::Error> {
    let poses: Vec<Pose> = features
        .iter()
        .map(|frame| {
            let number = |at: usize| f64::from(frame[at]);
            Pose {
                transl: DVec3::new(number(0), number(1), number(2)),
                rotations: std::array::from_fn(|joint| {
                    // Reorder from rows to columns.
                    let columns = [0, 2, 4, 1, 3, 5].map(|k| number(ROTATIONS + 6 * joint + k));
                    DQuat::from_mat3(&from_six_d_columns(columns)).normalize()
                }),
            }
        })
        .collect();
    Motion::from_poses(released_fps(), &poses)
}

#[cfg(test)]
mod tests {
    use kinematics::rotation::angle_between;
    use testkit::walk;

    use super::*;
    use crate::representation_272::face_front;

    /// First column of the joints.
    const JOINTS: usize = ROTATIONS + 6 * NUM_BODY_JOINTS;

    /// World positions of the joints: the features' joints moved by the translation.
    ///
    /// # Shapes
    /// `[L, 22]` in metres.
    fn joints_of_features(features: &[Features]) -> Vec<[DVec3; NUM_BODY_JOINTS]> {
        let vector = |frame: &Features, at: usize| {
            DVec3::new(frame[at].into(), frame[at + 1].into(), frame[at + 2].into())
        };
        features
            .iter()
            .map(|frame| {
                std::array::from_fn(|joint| vector(frame, JOINTS + 3 * joint) + vector(frame, 0))
            })
            .collect()
    }

    #[test]
    fn the_motion_comes_back_and_its_joints_are_those_of_the_features() {
        let skeleton = Skeleton::smplx_neutral();
        let mut poses = walk(80);
        let turn = DQuat::from_rotation_y(-1.9);
        for pose in &mut poses {
            pose.rotations[0] = turn * pose.rotations[0];
            pose.transl = turn * pose.transl + DVec3::new(2.0, 0.0, -7.0);
        }
        let motion = Motion::from_poses(released_fps(), &poses).expect("valid");
        let features = features_of_motion(&motion, &skeleton).expect("at its rate");
        assert_eq!(features.len(), 80);
        let found = motion_of_features(&features).expect("finite");
        face_front(&mut poses);
        let origin = poses[0].transl.with_y(0.0);
        for (found, mut expected) in found.poses().into_iter().zip(poses) {
            expected.transl -= origin;
            // Translations of metres in f32.
            assert!(found.transl.distance(expected.transl) < 2e-6);
            for joint in 0..NUM_BODY_JOINTS {
                let apart = angle_between(found.rotations[joint], expected.rotations[joint]);
                assert!(apart < 1e-6, "{apart}");
            }
        }
        let posed = skeleton.points_of_frames::<NUM_BODY_JOINTS>(&found, 0..80);
        let stated = joints_of_features(&features);
        for (a, b) in posed.as_flattened().iter().zip(stated.as_flattened()) {
            assert!(a.distance(*b) < 5e-6, "{a} and {b}");
        }
    }

    #[test]
    fn the_columns_are_where_the_released_code_reads_them() {
        let skeleton = Skeleton::smplx_neutral();
        let mut pose = Pose::REST;
        pose.transl = DVec3::new(5.0, 1.25, 3.0);
        // The rotation matrix by rows: 1 0 0, 0 0 -1, 0 1 0.
        pose.rotations[4] = DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2);
        let motion = Motion::from_poses(released_fps(), &[pose]).expect("valid");
        let features = features_of_motion(&motion, &skeleton).expect("at its rate");
        let near = |at: usize, expected: &[f32]| {
            for (column, expected) in expected.iter().enumerate() {
                let found = features[0][at + column];
                assert!((found - expected).abs() < 1e-6, "{}: {found}", at + column);
            }
        };
        near(0, &[0.0, 1.25, 0.0]);
        near(3, &[1.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
        near(3 + 6 * 4, &[1.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
        near(135, &skeleton.rest(0).as_vec3().to_array());
        near(135 + 3 * 15, &skeleton.rest(15).as_vec3().to_array());
        assert!(motion_of_features(&[]).is_err());
        assert!(motion_of_features(&[[f32::NAN; WIDTH]]).is_err());
    }
}
