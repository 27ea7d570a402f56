//! Converts motions to the 263 features of HumanML3D, and features back to a motion on the source's body and at its
//! place.

use datasets_spec::record::HUMANML3D_WIDTH;
use datasets_spec::{Fps, JointSet, Motion, Pose, Skeleton};
use features::humanml3d::{
    FeatureError, Features, Joints, UNIFORM_BONES, features_of_joints, recover_joints,
};
use features::smpl_body;
use glam::{DQuat, DVec3};
use kinematics::KeypointFrame;
use kinematics::fit::{FitOptions, fit_motion_from};
use kinematics::skeleton::{NUM_BODY_JOINTS, NUM_KEYPOINTS, parent_of};

use crate::system::Misfit;

/// Joints from which the root and contact features are computed: pelvis and legs.
const LOWER_BODY: JointSet = JointSet::of(&[0, 1, 2, 4, 5, 7, 8, 10, 11]);

/// Right knee and ankle. The recipe scales a body by the length of the two bones that end in these joints.
const LEG: [usize; 2] = [5, 8];

/// Mask of the features computed from the given joints. Each joint has a position, rotation and velocity. The four root
/// features and the foot contacts are computed from pelvis and legs.
///
/// # Source
/// `humanml_utils.py` of MDM. For pelvis and legs, this mask equals its mask of the lower body.
pub fn feature_mask(joints: JointSet) -> [bool; HUMANML3D_WIDTH] {
    const POSITIONS: usize = 4;
    const ROTATIONS: usize = 67;
    const VELOCITIES: usize = 193;
    const CONTACTS: usize = 259;
    let mut mask = [false; HUMANML3D_WIDTH];
    for joint in joints.iter().map(kinematics::Joint::index) {
        // The root has no position or rotation relative to itself.
        if let Some(place) = joint.checked_sub(1) {
            mask[POSITIONS + 3 * place..][..3].fill(true);
            mask[ROTATIONS + 6 * place..][..6].fill(true);
        }
        mask[VELOCITIES + 3 * joint..][..3].fill(true);
    }
    if !joints.intersection(LOWER_BODY).is_empty() {
        mask[..POSITIONS].fill(true);
        mask[CONTACTS..].fill(true);
    }
    mask
}

/// A motion as features, with the data needed to convert features back to its body and place.
#[derive(Clone, Debug)]
pub struct SourceFeatures {
    /// The features, one row for each pose.
    pub features: Vec<Features>,
    poses: Vec<Pose>,
    placement: Placement,
    /// The body of the features: HumanML3D's skeleton with the source's bone lengths.
    body: Skeleton,
}

/// Transform from the uniform skeleton of the features, which starts at the origin facing +z, to a source motion.
#[derive(Clone, Copy, Debug)]
struct Placement {
    turn: DQuat,
    scale: f64,
    shift: DVec3,
}

impl Placement {
    /// The placement of a source motion. `source` and `uniform` are its first frame on its own skeleton and on the
    /// uniform one. Both have the same bone directions, and root paths that differ by a scale.
    fn new(source: &Joints, uniform: &Joints) -> Self {
        let leg: f64 = LEG
            .iter()
            .map(|&joint| source[joint].distance(source[parent_of(joint)]))
            .sum();
        let scale = leg / (UNIFORM_BONES[LEG[0]] + UNIFORM_BONES[LEG[1]]);
        let (mut along, mut across) = (0.0, 0.0);
        for joint in 1..NUM_BODY_JOINTS {
            let bone = |points: &Joints| points[joint] - points[parent_of(joint)];
            let (to, from) = (bone(source), bone(uniform));
            along += to.x * from.x + to.z * from.z;
            across += to.x * from.z - to.z * from.x;
        }
        let turn = DQuat::from_rotation_y(across.atan2(along));
        Self {
            turn,
            scale,
            shift: source[0] - turn * (uniform[0] * scale),
        }
    }
}

impl SourceFeatures {
    /// The features of poses at 20 fps.
    ///
    /// The recipe computes velocities from the next frame, so it loses the last frame. To keep it, the joints are
    /// extrapolated linearly by one frame.
    ///
    /// # Errors
    /// There are fewer than two poses, or a bone has length zero.
    pub fn new(poses: Vec<Pose>, skeleton: &Skeleton) -> Result<Self, FeatureError> {
        let body = smpl_body(skeleton);
        let mut joints: Vec<Joints> = body.points_of_poses(&poses);
        let [.., before, last] = joints[..] else {
            return Err(FeatureError::TooShort {
                frames: poses.len(),
            });
        };
        joints.push(std::array::from_fn(|joint| {
            2.0 * last[joint] - before[joint]
        }));
        let features = features_of_joints(&joints)?;
        let placement = Placement::new(&joints[0], &recover_joints(&features[..1])[0]);
        Ok(Self {
            features,
            poses,
            placement,
            body,
        })
    }

    /// Converts features to a motion at 20 fps that starts where the source does. Also returns the distances between
    /// their points and the fitted body. The motion has the source's bone lengths, and the source's twists of bones,
    /// which joints do not determine.
    ///
    /// # Errors
    /// There are more features than poses of the source, or a number is not finite.
    pub fn motion(&self, features: &[Features]) -> Result<(Motion, Misfit), FeatureError> {
        let joints = recover_joints(features);
        let frames = self.targets(&joints)?;
        let no_motion = |error: kinematics::Error| FeatureError::NoMotion {
            reason: error.to_string(),
        };
        let options = FitOptions::body_joints();
        let fitted = fit_motion_from(&self.body, &frames, &self.poses, Fps::STORE, &options)
            .map_err(no_motion)?;
        let misfit = Misfit {
            fit_error_m: mean(&fitted.error_m),
            bone_drift_m: mean_bone_drift_m(&joints) * self.placement.scale as f32,
        };
        Ok((fitted.motion, misfit))
    }

    /// Places joints of the uniform skeleton on the source's body and at its place.
    fn targets(&self, joints: &[Joints]) -> Result<Vec<KeypointFrame>, FeatureError> {
        let Placement { turn, scale, shift } = self.placement;
        joints
            .iter()
            .enumerate()
            .map(|(frame, points)| {
                // Keypoints other than body joints have no weight in the fit.
                let mut target = [turn * (points[0] * scale) + shift; NUM_KEYPOINTS];
                for joint in 1..NUM_BODY_JOINTS {
                    let direction = (points[joint] - points[parent_of(joint)])
                        .try_normalize()
                        .ok_or(FeatureError::NoDirection { joint, frame })?;
                    target[joint] = target[parent_of(joint)]
                        + turn * direction * self.body.offset(joint).length();
                }
                Ok(target)
            })
            .collect()
    }
}

/// Mean difference in metres between bone lengths and those of the uniform skeleton.
pub(crate) fn mean_bone_drift_m(joints: &[Joints]) -> f32 {
    let drifts: Vec<f64> = joints
        .iter()
        .flat_map(|points| {
            (1..NUM_BODY_JOINTS).map(|joint| {
                (points[joint].distance(points[parent_of(joint)]) - UNIFORM_BONES[joint]).abs()
            })
        })
        .collect();
    mean(&drifts)
}

fn mean(values: &[f64]) -> f32 {
    (values.iter().sum::<f64>() / values.len().max(1) as f64) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A body that walks in a curve while it waves.
    fn poses() -> Vec<Pose> {
        (0..30)
            .map(|frame| {
                let t = f64::from(frame) / 20.0;
                let heading = 2.0 + 0.6 * t;
                let mut pose = Pose {
                    transl: DVec3::new(3.0 + t * heading.sin(), 0.4, -1.0 + t * heading.cos()),
                    ..Pose::REST
                };
                pose.rotations[0] = DQuat::from_rotation_y(heading);
                pose.rotations[1] = DQuat::from_rotation_x(-0.4 * (3.0 * t).sin());
                pose.rotations[16] = DQuat::from_rotation_z(0.5 + (4.0 * t).sin());
                pose.rotations[20] = DQuat::from_rotation_x(0.3);
                pose
            })
            .collect()
    }

    #[test]
    fn own_features_give_the_motion_back_and_one_pose_is_too_short() {
        let (poses, skeleton) = (poses(), Skeleton::smplx_neutral());
        let source = SourceFeatures::new(poses.clone(), &skeleton).expect("long enough");
        assert_eq!(source.features.len(), poses.len());
        let (motion, misfit) = source.motion(&source.features).expect("a motion");
        let wanted: Vec<Joints> = skeleton.points_of_poses(&poses);
        let found: Vec<Joints> = skeleton.points_of_poses(&motion.poses());
        for (wanted, found) in wanted.iter().flatten().zip(found.iter().flatten()) {
            // Rounding errors of velocities in single precision add up over thirty frames.
            assert!(wanted.distance(*found) < 1e-4, "{wanted} {found}");
        }
        assert!(misfit.fit_error_m < 1e-4 && misfit.bone_drift_m < 1e-5);
        let short = SourceFeatures::new(vec![Pose::REST], &skeleton);
        assert!(matches!(short, Err(FeatureError::TooShort { frames: 1 })));
        let twist = motion.pose(3).rotations[20].angle_between(poses[3].rotations[20]);
        assert!(twist < 1e-3, "{twist}");
    }

    #[test]
    fn an_arm_moves_no_root() {
        let mask = feature_mask(JointSet::of(&[16, 18, 20]));
        assert_eq!(mask.iter().filter(|&&is_free| is_free).count(), 3 * 12);
        assert!(!mask[0] && !mask[262] && mask[4 + 3 * 15]);
        assert!(feature_mask(JointSet::ALL).iter().all(|&is_free| is_free));
    }
}
