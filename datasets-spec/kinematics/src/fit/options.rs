//! Settings and results of a fit.

use serde::{Deserialize, Serialize};

use crate::motion::Motion;
use crate::pose::Pose;
use crate::skeleton::{NUM_BODY_JOINTS, NUM_KEYPOINTS};

/// Weights and stopping rules of a fit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FitOptions {
    /// Weight of each keypoint, `[28]`; 0 leaves a point out.
    pub weights: [f64; NUM_KEYPOINTS],
    /// Maximum number of steps per frame.
    pub max_iterations: u32,
    /// The fit ends when no point moves further than this in a step, in metres.
    pub tolerance_m: f64,
    /// Weight in m^2/rad^2 of the squared angle between each joint's global rotation and that in the given pose
    /// ([`super::fit_pose`], [`super::fit_motion_from`]) or in the frame before ([`super::fit_motion`]). At 0, the
    /// default, exact keypoints are recovered exactly. About 1e-4 smooths jittering points; in [`super::fit_motion`] it
    /// also keeps the unobservable twists of the first frame.
    pub smoothness: f64,
    /// Temporal prior of [`super::fit_motion_from`] for points that do not lie on the body. The prior is the fitted
    /// pose of the frame before, moved by the change between the given poses. Its weight on the squared angle of each
    /// global rotation is `continuity` times the frame's mean squared error of bone lengths. Set it to the inverse
    /// square of the angle in radians by which the two motions' changes per frame are expected to differ. Points on the
    /// body are fitted exactly with any value.
    pub continuity: f64,
}

impl Default for FitOptions {
    fn default() -> Self {
        Self {
            weights: [1.0; NUM_KEYPOINTS],
            max_iterations: 20,
            tolerance_m: 1e-5,
            smoothness: 0.0,
            continuity: 0.0,
        }
    }
}

impl FitOptions {
    /// Weights only the 22 body joints, for sources without eyes and knuckles.
    pub fn body_joints() -> Self {
        let mut options = Self::default();
        options.weights[NUM_BODY_JOINTS..].fill(0.0);
        options
    }
}

/// A pose fitted to one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FitResult {
    /// The pose.
    pub pose: Pose,
    /// Mean distance between given and fitted points of positive weight, in metres.
    pub error_m: f64,
    /// Steps tried.
    pub iterations: u32,
}

/// A motion fitted to a keypoint sequence.
#[derive(Clone, Debug, PartialEq)]
pub struct FittedMotion {
    /// The motion.
    pub motion: Motion,
    /// Mean distance between given and fitted points of each frame, in metres, `[L]`.
    pub error_m: Vec<f64>,
}
