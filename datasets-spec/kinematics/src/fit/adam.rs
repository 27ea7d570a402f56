//! The published fit of rotations to keypoints: gradient descent by Adam on axis-angle.

use glam::{DMat3, DQuat, DVec3};

use crate::pose::{KeypointFrame, Pose};
use crate::rotation::{from_axis_angle, to_axis_angle};
use crate::skeleton::{KEYPOINT_JOINTS, NUM_BODY_JOINTS, NUM_KEYPOINTS, Skeleton, parent_of};

/// Parameters of a frame: translation and 22 rotation vectors.
const PARAMETERS: usize = 3 + 3 * NUM_BODY_JOINTS;

/// Decay rates and epsilon of Adam: PyTorch's defaults.
const BETAS: [f64; 2] = [0.9, 0.999];
const EPS: f64 = 1e-8;

/// Translation in metres and rotation vectors in radians of a frame, `[69]`.
pub type Parameters = [f64; PARAMETERS];

/// A fit by Adam. It minimises the mean squared error over all coordinates of the counted keypoints of all frames; the
/// gradient is in closed form.
///
/// # Source
/// Paper App. B.3 and the released `optimize_smpl`.
#[derive(Clone, Debug, PartialEq)]
pub struct AdamFit {
    /// Step size.
    pub learning_rate: f64,
    /// Number of steps.
    pub iterations: u32,
    /// Whether each keypoint counts, `[28]`.
    pub counts: [bool; NUM_KEYPOINTS],
}

/// Result of a fit.
#[derive(Clone, Debug, PartialEq)]
pub struct AdamFitted {
    /// The parameters of each frame, `[T, 69]`.
    pub parameters: Vec<Parameters>,
    /// Mean squared error in m² before each step.
    pub history: Vec<f64>,
    /// Mean squared error in m² after the last step.
    pub mse: f64,
}

impl AdamFitted {
    /// The poses of the frames.
    pub fn poses(&self) -> Vec<Pose> {
        self.parameters.iter().map(pose_of).collect()
    }
}

impl AdamFit {
    /// The fit of the paper: 120 steps of 0.01 on all 28 keypoints.
    pub fn paper() -> Self {
        Self {
            learning_rate: 0.01,
            iterations: 120,
            counts: [true; NUM_KEYPOINTS],
        }
    }

    /// The fit of the released code: 120 steps of 0.05 on 24 joints.
    pub fn official() -> Self {
        let mut counts = [false; NUM_KEYPOINTS];
        for slot in crate::skeleton::FIT_KEYPOINTS {
            counts[slot] = true;
        }
        Self {
            learning_rate: 0.05,
            iterations: 120,
            counts,
        }
    }

    /// The parameters of poses, `[T, 69]`.
    pub fn parameters_of(poses: &[Pose]) -> Vec<Parameters> {
        poses
            .iter()
            .map(|pose| {
                let mut parameters = [0.0; PARAMETERS];
                parameters[..3].copy_from_slice(&pose.transl.to_array());
                for (slot, &rotation) in parameters[3..].chunks_exact_mut(3).zip(&pose.rotations) {
                    slot.copy_from_slice(&to_axis_angle(rotation).to_array());
                }
                parameters
            })
            .collect()
    }

    /// Fits frames of keypoints in metres.
    ///
    /// # Panics
    /// If there are not as many starts as frames.
    pub fn fit(
        &self,
        skeleton: &Skeleton,
        frames: &[KeypointFrame],
        start: &[Parameters],
    ) -> AdamFitted {
        assert_eq!(frames.len(), start.len());
        let body = Body::of(skeleton);
        let counted = self.counts.iter().filter(|counts| **counts).count();
        let scale = 1.0 / (3 * counted * frames.len()).max(1) as f64;
        let mut history = vec![0.0; self.iterations as usize];
        let mut mse = 0.0;
        let parameters = frames
            .iter()
            .zip(start)
            .map(|(target, start)| {
                let mut parameters = *start;
                let (mut mean, mut variance) = ([0.0; PARAMETERS], [0.0; PARAMETERS]);
                for (step, total) in history.iter_mut().enumerate() {
                    let mut gradient = [0.0; PARAMETERS];
                    let squares = body.gradient(&parameters, target, &self.counts, &mut gradient);
                    *total += squares * scale;
                    let step = i32::try_from(step + 1).unwrap_or(i32::MAX);
                    let mean_bias = 1.0 - BETAS[0].powi(step);
                    let root_bias = (1.0 - BETAS[1].powi(step)).sqrt();
                    for at in 0..PARAMETERS {
                        let gradient = gradient[at] * scale;
                        mean[at] += (1.0 - BETAS[0]) * (gradient - mean[at]);
                        variance[at] =
                            BETAS[1] * variance[at] + (1.0 - BETAS[1]) * gradient * gradient;
                        let size = variance[at].sqrt() / root_bias + EPS;
                        parameters[at] -= self.learning_rate / mean_bias * mean[at] / size;
                    }
                }
                let mut gradient = [0.0; PARAMETERS];
                mse += body.gradient(&parameters, target, &self.counts, &mut gradient) * scale;
                parameters
            })
            .collect();
        AdamFitted {
            parameters,
            history,
            mse,
        }
    }
}

fn pose_of(parameters: &Parameters) -> Pose {
    Pose {
        transl: DVec3::from_slice(parameters),
        rotations: std::array::from_fn(|joint| from_axis_angle(vector(parameters, joint))),
    }
}

fn vector(parameters: &Parameters, joint: usize) -> DVec3 {
    DVec3::from_slice(&parameters[3 + 3 * joint..])
}

struct Body {
    pelvis: DVec3,
    offsets: [DVec3; NUM_KEYPOINTS],
}

impl Body {
    fn of(skeleton: &Skeleton) -> Self {
        Self {
            pelvis: skeleton.rest(0),
            offsets: KEYPOINT_JOINTS.map(|joint| skeleton.offset(joint)),
        }
    }

    /// The sum of squared distances to the target in m², and its gradient.
    ///
    /// A small rotation `w` of a joint moves a point at offset `r` by `w x r`. So the gradient with respect to `w` is
    /// the sum of `r x f` over all points below the joint, where `f` is the gradient with respect to the point. A
    /// change `dv` of a rotation vector `v` is the rotation `J(v) dv` in the axes of the parent, with `J` the left
    /// Jacobian.
    fn gradient(
        &self,
        parameters: &Parameters,
        target: &KeypointFrame,
        counts: &[bool; NUM_KEYPOINTS],
        gradient: &mut Parameters,
    ) -> f64 {
        let mut global = [DMat3::IDENTITY; NUM_BODY_JOINTS];
        let mut points = [DVec3::ZERO; NUM_KEYPOINTS];
        points[0] = self.pelvis + DVec3::from_slice(parameters);
        global[0] = DMat3::from_quat(from_axis_angle(vector(parameters, 0)));
        for slot in 1..NUM_KEYPOINTS {
            let parent = parent_of(slot);
            points[slot] = points[parent] + global[parent] * self.offsets[slot];
            if slot < NUM_BODY_JOINTS {
                let local: DQuat = from_axis_angle(vector(parameters, slot));
                global[slot] = global[parent] * DMat3::from_quat(local);
            }
        }
        let mut squares = 0.0;
        let mut forces = [DVec3::ZERO; NUM_KEYPOINTS];
        let mut moments = [DVec3::ZERO; NUM_KEYPOINTS];
        for slot in 0..NUM_KEYPOINTS {
            if counts[slot] {
                let away = points[slot] - target[slot];
                squares += away.length_squared();
                forces[slot] = 2.0 * away;
                moments[slot] = points[slot].cross(forces[slot]);
            }
        }
        for slot in (1..NUM_KEYPOINTS).rev() {
            let parent = parent_of(slot);
            forces[parent] += forces[slot];
            moments[parent] += moments[slot];
        }
        gradient[..3].copy_from_slice(&forces[0].to_array());
        for joint in 0..NUM_BODY_JOINTS {
            let turn = moments[joint] - points[joint].cross(forces[joint]);
            let in_parent = match joint {
                0 => turn,
                _ => global[parent_of(joint)].transpose() * turn,
            };
            let slope = transposed_left_jacobian(vector(parameters, joint), in_parent);
            gradient[3 + 3 * joint..][..3].copy_from_slice(&slope.to_array());
        }
        squares
    }
}

/// The transpose of the left Jacobian of the rotation by `v`, times `x`.
fn transposed_left_jacobian(v: DVec3, x: DVec3) -> DVec3 {
    let square = v.length_squared();
    // Use the series where the quotients would lose digits.
    let (a, b) = if square < 1e-6 {
        (0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0)
    } else {
        let angle = square.sqrt();
        let (sine, cosine) = angle.sin_cos();
        ((1.0 - cosine) / square, (angle - sine) / (square * angle))
    };
    let cross = v.cross(x);
    x - a * cross + b * v.cross(cross)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn parameters() -> impl Strategy<Value = Parameters> {
        prop::collection::vec(-1.5f64..1.5, PARAMETERS)
            .prop_map(|values| std::array::from_fn(|at| values[at]))
    }

    proptest! {
        #[test]
        fn the_gradient_is_that_of_finite_differences(
            at in parameters(), there in parameters(), small in any::<bool>(),
        ) {
            let skeleton = Skeleton::smplx_neutral();
            let body = Body::of(&skeleton);
            let at = if small { at.map(|v| v * 1e-5) } else { at };
            let target = skeleton.keypoints(&pose_of(&there));
            let counts = AdamFit::official().counts;
            let mut gradient = [0.0; PARAMETERS];
            body.gradient(&at, &target, &counts, &mut gradient);
            let cost = |parameters: &Parameters| {
                body.gradient(parameters, &target, &counts, &mut [0.0; PARAMETERS])
            };
            const STEP: f64 = 1e-5;
            for index in 0..PARAMETERS {
                let (mut more, mut less) = (at, at);
                more[index] += STEP;
                less[index] -= STEP;
                let slope = (cost(&more) - cost(&less)) / (2.0 * STEP);
                // The finite difference errs by about the third derivative times the squared step. The cost is about
                // 50 m².
                prop_assert!((gradient[index] - slope).abs() < 1e-6, "{index}");
            }
        }
    }

    #[test]
    fn a_fit_comes_nearer() {
        let skeleton = Skeleton::smplx_neutral();
        let mut pose = Pose::REST;
        for (joint, rotation) in pose.rotations.iter_mut().enumerate() {
            *rotation = from_axis_angle(DVec3::new(0.2, -0.1, 0.02 * joint as f64));
        }
        let target = skeleton.keypoints(&pose);
        let start = AdamFit::parameters_of(&[Pose::REST]);
        for fit in [AdamFit::paper(), AdamFit::official()] {
            let fitted = fit.fit(&skeleton, &[target], &start);
            assert_eq!(fitted.history.len(), 120);
            assert!(fitted.mse < 1e-4 && fitted.mse < 0.01 * fitted.history[0]);
            let points = skeleton.keypoints(&fitted.poses()[0]);
            let worst = points.iter().zip(&target).map(|(a, b)| a.distance(*b));
            assert!(worst.fold(0.0, f64::max) < 0.05);
        }
    }
}
