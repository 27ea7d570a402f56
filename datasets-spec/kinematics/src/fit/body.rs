//! The body in the unknowns of the fit: the position of the pelvis and global rotations.

use glam::{DQuat, DVec3};

use super::options::FitOptions;
use super::tree::TREE;
use crate::pose::{KeypointFrame, Pose};
use crate::rotation::{from_axis_angle, slerp};
use crate::skeleton::{KEYPOINT_JOINTS, NUM_BODY_JOINTS, NUM_KEYPOINTS, Skeleton, parent_of};

#[derive(Clone)]
pub(super) struct Body {
    pub(super) pelvis: DVec3,
    pub(super) global: [DQuat; NUM_BODY_JOINTS],
}

/// A step of the fit: a shift of the pelvis and a rotation vector for each joint, in world axes.
pub(super) struct Step {
    pub(super) shift: DVec3,
    pub(super) turns: [DVec3; NUM_BODY_JOINTS],
}

pub(super) struct Fitter<'a> {
    pub(super) options: &'a FitOptions,
    pub(super) pelvis_rest: DVec3,
    /// Rest position of each keypoint relative to its parent.
    pub(super) offsets: [DVec3; NUM_KEYPOINTS],
    /// Weights summed over the subtree of each point.
    pub(super) subtree_weights: [f64; NUM_KEYPOINTS],
    /// Number of points of positive weight.
    pub(super) num_points: usize,
}

impl<'a> Fitter<'a> {
    pub(super) fn new(skeleton: &Skeleton, options: &'a FitOptions) -> Self {
        let weights = &options.weights;
        assert!(
            weights.iter().all(|w| w.is_finite() && *w >= 0.0),
            "keypoint weights must be finite and not negative: {weights:?}"
        );
        let mut subtree_weights = *weights;
        for slot in (1..NUM_KEYPOINTS).rev() {
            subtree_weights[parent_of(slot)] += subtree_weights[slot];
        }
        Self {
            options,
            pelvis_rest: skeleton.rest(0),
            offsets: KEYPOINT_JOINTS.map(|joint| skeleton.offset(joint)),
            subtree_weights,
            num_points: weights.iter().filter(|w| **w > 0.0).count(),
        }
    }

    /// The mean squared error of the bone lengths in m^2, over points of positive weight.
    pub(super) fn squared_drift(&self, target: &KeypointFrame) -> f64 {
        let (mut sum, mut count) = (0.0, 0usize);
        for slot in 1..NUM_KEYPOINTS {
            let parent = parent_of(slot);
            if self.options.weights[slot] > 0.0 && self.options.weights[parent] > 0.0 {
                let length = target[slot].distance(target[parent]);
                sum += (length - self.offsets[slot].length()).powi(2);
                count += 1;
            }
        }
        sum / count.max(1) as f64
    }

    /// Interpolates by `alpha` from `own` to `before` moved by the change from `own_before` to `own`.
    pub(super) fn carried(&self, own: &Pose, before: &Pose, own_before: &Pose, alpha: f64) -> Pose {
        let [own, before, own_before] = [own, before, own_before].map(|pose| self.body_of(pose));
        let mut body = own.clone();
        for joint in 0..NUM_BODY_JOINTS {
            // The change is in the joint's local axes, so that the result does not depend on the heading of the body.
            let turn = own_before.global[joint].inverse() * own.global[joint];
            let carried = (before.global[joint] * turn).normalize();
            body.global[joint] = slerp(own.global[joint], carried, alpha);
        }
        let mut pose = self.pose_of(&body, None);
        for joint in 1..NUM_BODY_JOINTS {
            pose.rotations[joint] =
                (body.global[parent_of(joint)].inverse() * body.global[joint]).normalize();
        }
        pose
    }

    pub(super) fn mean_distance(&self, points: &KeypointFrame, target: &KeypointFrame) -> f64 {
        let total: f64 = points
            .iter()
            .zip(target)
            .zip(&self.options.weights)
            .filter(|(_, weight)| **weight > 0.0)
            .map(|((a, b), _)| a.distance(*b))
            .sum();
        total / self.num_points.max(1) as f64
    }

    pub(super) fn body_of(&self, pose: &Pose) -> Body {
        let mut global = pose.rotations;
        for joint in 1..NUM_BODY_JOINTS {
            global[joint] = global[parent_of(joint)] * pose.rotations[joint];
        }
        Body {
            pelvis: pose.transl + self.pelvis_rest,
            global,
        }
    }

    pub(super) fn pose_of(&self, body: &Body, init: Option<&Pose>) -> Pose {
        let rotations = std::array::from_fn(|joint| match joint {
            0 => body.global[0],
            // The ends of the feet have no child, so their rotation is unobservable.
            _ if TREE.num_children[joint] == 0 => {
                init.map_or(DQuat::IDENTITY, |pose| pose.rotations[joint])
            }
            _ => (body.global[parent_of(joint)].inverse() * body.global[joint]).normalize(),
        });
        Pose {
            transl: body.pelvis - self.pelvis_rest,
            rotations,
        }
    }
}

impl Body {
    pub(super) fn stepped(&self, step: &Step) -> Self {
        let mut global = self.global;
        for (rotation, &turn) in global.iter_mut().zip(&step.turns) {
            *rotation = (from_axis_angle(turn) * *rotation).normalize();
        }
        Self {
            pelvis: self.pelvis + step.shift,
            global,
        }
    }
}
