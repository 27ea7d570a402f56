//! Fitting the body to keypoints: lossy inverse kinematics from 28 positions to 22 rotations.
//!
//! The position of a point relative to its parent depends only on the *global* rotation of the
//! parent, so the unknowns are global rotations. The normal matrix then couples a joint only to its
//! ancestors: elimination from the leaves to the root causes no fill-in, and a step takes a few
//! microseconds, without a dense 69 x 69 factorisation.
//!
//! If a joint has one keypoint child, its twist about the bone to that child is unobservable. So is the rotation of the
//! ends of the feet, which have no child. The start pose sets these angles (see [`fit_pose`]); the damped steps never
//! move them.

mod adam;
mod body;
mod options;
mod start;
mod step;
#[cfg(test)]
pub(crate) mod tests;
mod tree;

use body::Fitter;

use crate::motion::Motion;
use crate::pose::{KeypointFrame, Pose};
use crate::skeleton::Skeleton;
use crate::{Error, Fps};

pub use adam::{AdamFit, AdamFitted, Parameters};
pub use options::{FitOptions, FitResult, FittedMotion};

/// First damping in m^2/rad^2. The shortest lever of the body, the eyes about the head, has a
/// curvature of about 2e-3 m^2/rad^2, so this damping hardly slows the first step.
const FIRST_DAMPING: f64 = 1e-5;
/// Minimum damping, which keeps unobservable twists in place.
const LEAST_DAMPING: f64 = 1e-9;
/// Damping at which the fit ends: steps are too small to help.
const MOST_DAMPING: f64 = 1e6;
/// Factor by which the damping falls after a good step and grows after a bad one.
const DAMPING_FACTOR: f64 = 10.0;

/// Length of a step below which the next one uses the second derivative: a tenth of the shorter
/// bones. Farther from the minimum the Hessian may be indefinite and the step may increase the error.
const NEAR_M: f64 = 0.01;

/// Fits a pose to the keypoints of one frame, in metres.
///
/// The fit starts from geometry: joints with several children are aligned to them, the bones of the
/// others point at their targets. With `init`, unobservable twists are those of `init`. Without it,
/// spine and neck share the rotation between pelvis, chest and head, thighs and upper arms are twisted
/// so that knees and elbows bend as hinges, shins follow the feet, and forearms take half of the
/// rotation of the hand.
///
/// # Panics
/// If a target coordinate or a weight is not finite, or a weight is negative.
///
/// # Source
/// The paper's App. B.3 fits axis-angle parameters by 120 steps of Adam; Levenberg-Marquardt
/// (More 1978) minimises the same squared distances in a few steps.
pub fn fit_pose(
    skeleton: &Skeleton,
    target: &KeypointFrame,
    init: Option<&Pose>,
    options: &FitOptions,
) -> FitResult {
    Fitter::new(skeleton, options).fit(target, init, init, options.smoothness)
}

/// Fits a motion to a keypoint sequence, frame by frame. The result is deterministic; callers fit many
/// clips in parallel.
///
/// # Errors
/// There is no frame, or a coordinate is not finite.
///
/// # Panics
/// If a weight is not finite or negative.
pub fn fit_motion(
    skeleton: &Skeleton,
    frames: &[KeypointFrame],
    fps: Fps,
    options: &FitOptions,
) -> Result<FittedMotion, Error> {
    fit_frames(skeleton, frames, |_| None, fps, options)
}

/// As [`fit_motion`], but each frame takes its unobservable twists from a given pose, such as that of
/// the motion before an edit, and smoothness pulls it towards that pose instead of the frame before.
///
/// # Shapes
/// `frames` and `twists` `[L]`.
///
/// # Errors
/// As [`fit_motion`].
///
/// # Panics
/// As [`fit_motion`], or if there are fewer poses than frames.
pub fn fit_motion_from(
    skeleton: &Skeleton,
    frames: &[KeypointFrame],
    twists: &[Pose],
    fps: Fps,
    options: &FitOptions,
) -> Result<FittedMotion, Error> {
    assert!(twists.len() >= frames.len(), "a pose for every frame");
    fit_frames(skeleton, frames, |frame| twists.get(frame), fps, options)
}

fn fit_frames<'a>(
    skeleton: &Skeleton,
    frames: &[KeypointFrame],
    twists: impl Fn(usize) -> Option<&'a Pose>,
    fps: Fps,
    options: &FitOptions,
) -> Result<FittedMotion, Error> {
    if let Some(frame) = frames
        .iter()
        .position(|points| points.iter().any(|point| !point.is_finite()))
    {
        return Err(Error(format!("keypoints of frame {frame} is not finite")));
    }
    let fitter = Fitter::new(skeleton, options);
    let mut poses: Vec<Pose> = Vec::with_capacity(frames.len());
    let mut error_m = Vec::with_capacity(frames.len());
    for (frame, target) in frames.iter().enumerate() {
        // Without `continuity`, no frame starts from the one before: twists that are carried over would drift with the
        // swing of the limbs.
        let own = twists(frame);
        let held = options.continuity * fitter.squared_drift(target);
        let carried = own
            .filter(|_| held > 0.0)
            .zip(poses.last())
            .zip(frame.checked_sub(1).and_then(&twists))
            .map(|((own, before), own_before)| {
                fitter.carried(own, before, own_before, held / (held + options.smoothness))
            });
        let result = match &carried {
            Some(carried) => fitter.fit(
                target,
                Some(carried),
                Some(carried),
                held + options.smoothness,
            ),
            None => fitter.fit(target, own, own.or(poses.last()), options.smoothness),
        };
        poses.push(result.pose);
        error_m.push(result.error_m);
    }
    Ok(FittedMotion {
        motion: Motion::from_poses(fps, &poses)?,
        error_m,
    })
}

impl Fitter<'_> {
    /// Fits a frame, starting at `init`. Rotations are pulled towards `prior` with weight `held` in m^2/rad^2.
    fn fit(
        &self,
        target: &KeypointFrame,
        init: Option<&Pose>,
        prior: Option<&Pose>,
        held: f64,
    ) -> FitResult {
        assert!(
            target.iter().all(|point| point.is_finite()),
            "keypoints must be finite"
        );
        let mut body = match init {
            Some(pose) => self.start_from(target, pose, held),
            None => self.start(target),
        };
        let prior = prior.filter(|_| held > 0.0).map(|pose| self.body_of(pose));
        let mut now = self.evaluate(&body, target, prior.as_ref(), held);
        let mut damping = FIRST_DAMPING;
        let mut curved = false;
        let mut iterations = 0;
        while iterations < self.options.max_iterations && damping < MOST_DAMPING {
            iterations += 1;
            let next_body = body.stepped(&self.step(&now, damping, curved, held));
            let next = self.evaluate(&next_body, target, prior.as_ref(), held);
            let moved_m = now
                .points
                .iter()
                .zip(&next.points)
                .fold(0.0f64, |most, (a, b)| most.max(a.distance(*b)));
            if next.cost <= now.cost {
                (body, now) = (next_body, next);
                damping = (damping / DAMPING_FACTOR).max(LEAST_DAMPING);
                curved = moved_m < NEAR_M;
            } else {
                damping *= DAMPING_FACTOR;
                curved = false;
            }
            // So short a step ends the fit even if it raised the cost, which is then rounding noise.
            if moved_m <= self.options.tolerance_m {
                break;
            }
        }
        FitResult {
            error_m: self.mean_distance(&now.points, target),
            pose: self.pose_of(&body, init),
            iterations,
        }
    }
}
