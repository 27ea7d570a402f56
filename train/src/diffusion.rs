//! Predictions, guidance and loss of MotionReFit's denoiser.

use burn::tensor::activation::sigmoid;
use burn::tensor::{Device, Tensor};
use datasets_spec::Fps;
use kinematics::canonical::FIXED_FRAMES;
use kinematics::normalise::Normalizer;
use kinematics::skeleton::Joint;

use crate::bones::{bones, mapped};
use crate::config::{DiffusionConfig, FixedFrames, Loss, NoiseKind, Prediction};
use crate::data::NoisyBatch;
use crate::extrapolation::{Basis, Extrapolation};
use crate::model::denoiser::Denoiser;
use crate::model::pass::Pass;
use crate::schedule::Schedule;
use crate::transfer::send;

/// Number of gates per keypoint. They weight the original's bone, the extrapolated change, the network's own bone and,
/// with shaped noise, an estimate from the noisy window.
pub(crate) fn num_gates(noise: NoiseKind) -> usize {
    match noise {
        NoiseKind::White => 3,
        NoiseKind::Shaped => 4,
    }
}

impl Schedule {
    /// Clean window implied by a prediction, before clipping.
    ///
    /// # Shapes
    /// All `[B, W, D]`; `timesteps` `[B]`.
    pub fn clean_of(
        &self,
        prediction: Prediction,
        predicted: Tensor<3>,
        x_t: &Tensor<3>,
        basis: &Basis,
        timesteps: &[usize],
    ) -> Tensor<3> {
        let original = &basis.original;
        match prediction {
            Prediction::Noise => self.predict_x0(x_t.clone(), timesteps, predicted),
            Prediction::Clean => predicted,
            Prediction::Change => predicted + original.clone(),
            Prediction::Gated => {
                let (guess, spread) = basis.guess(x_t);
                // The guess is mapped to bones like the points. The spread is the same for all numbers of a frame, so
                // it needs no mapping.
                let [batch, window, numbers] = original.dims();
                let keypoints = numbers / 3;
                let made = predicted.clone().narrow(2, 0, numbers);
                let made = match &basis.shaped {
                    Some(shaped) => made * shaped.spreads.clone(),
                    None => made * spread,
                };
                let gate = |number: usize| {
                    let logits =
                        predicted
                            .clone()
                            .narrow(2, numbers + number * keypoints, keypoints);
                    sigmoid(logits)
                        .reshape([batch, window, keypoints, 1])
                        .expand([batch, window, keypoints, 3])
                        .reshape([batch, window, numbers])
                };
                let [to_bones, to_points] = bones(keypoints, &original.device());
                let kept = mapped(original.clone(), to_bones.clone()) * gate(0);
                let carried = mapped(guess.clone(), to_bones.clone()) * gate(1);
                let mut mixed = kept + carried + made * gate(2);
                if basis.shaped.is_some() {
                    // If the noise has the data's covariance, the best linear estimate of the clean remainder is the
                    // noisy remainder times the factor of the signal.
                    let (signal, _) = self.mixture(timesteps);
                    let rest = x_t.clone() - original.clone() - guess;
                    mixed = mixed + signal.times(mapped(rest, to_bones)) * gate(3);
                }
                mapped(mixed, to_points)
            }
        }
    }
}

/// Classifier-free guidance: extrapolates from the prediction without text through the prediction with text. Weight 1
/// gives the prediction with text.
///
/// # Shapes
/// All tensors have the same shape.
///
/// # Source
/// Released code; the paper's `(1 + w) eps - w eps'` is this with `weight = 1 + w`.
pub fn guide<const D: usize>(
    with_text: Tensor<D>,
    without_text: Tensor<D>,
    weight: f64,
) -> Tensor<D> {
    without_text.clone() + (with_text - without_text).mul_scalar(weight)
}

/// Replaces the first frames of windows by the fixed frames.
///
/// # Shapes
/// `x` and the result `[B, W, D]`; `fixed` `[B, F, D]`.
pub fn put_fixed(x: Tensor<3>, fixed: Tensor<3>) -> Tensor<3> {
    let [_, window, _] = x.dims();
    let [_, num_fixed, _] = fixed.dims();
    Tensor::cat(vec![fixed, x.narrow(1, num_fixed, window - num_fixed)], 1)
}

impl Loss {
    /// The mean loss over all numbers.
    ///
    /// # Shapes
    /// Both `[B, W, D]`; the result is one number.
    pub fn mean(self, predicted: Tensor<3>, target: Tensor<3>) -> Tensor<1> {
        self.of_each(predicted - target).mean()
    }

    fn of_each(self, difference: Tensor<3>) -> Tensor<3> {
        match self {
            // With c = min(|d|, 1), c (|d| - c / 2) equals d^2 / 2 for |d| < 1, and |d| - 1/2 otherwise.
            Self::SmoothL1 => {
                let size = difference.abs();
                let clipped = size.clone().clamp_max(1.0);
                clipped.clone() * (size - clipped.mul_scalar(0.5))
            }
            Self::Mse => difference.square(),
        }
    }
}

/// Ankles and feet, whose speed enters the contact loss.
const FEET: [Joint; 4] = [
    Joint::LeftAnkle,
    Joint::RightAnkle,
    Joint::LeftFoot,
    Joint::RightFoot,
];

/// Speed in m/s below which a foot is at rest; also the unit of the contact loss.
const REST_SPEED: f64 = 0.1;

/// Unit of the loss on bones in metres: about half the distance that a hand moves in a gesture.
const BONE_UNIT: f64 = 0.1;

/// Windows of a batch on a device, `[B, W, D]`.
struct Windows {
    x0: Tensor<3>,
    noise: Tensor<3>,
    /// 1 for windows that are the first of their motion, `[B, 1, 1]`; none if the batch has no such window.
    starts: Option<Tensor<3>>,
    original: Tensor<3>,
}

impl Windows {
    fn of(batch: &NoisyBatch, frame_width: usize, device: &Device) -> Self {
        let shape = [batch.len(), batch.window(frame_width), frame_width];
        let windows = |values: &[f32]| -> Tensor<3> { send(values.to_vec(), shape, device) };
        Self {
            x0: windows(&batch.edited),
            noise: windows(&batch.noise),
            starts: batch.is_start.contains(&true).then(|| {
                let starts = batch.is_start.iter();
                let starts = starts.map(|is_start| f32::from(u8::from(*is_start)));
                let starts: Vec<f32> = starts.collect();
                send(starts, [batch.len(), 1, 1], device)
            }),
            original: windows(&batch.original),
        }
    }
}

/// The training objective of the denoiser.
#[derive(Clone, Copy, Debug)]
pub struct Objective<'a> {
    /// Noise schedule.
    pub schedule: &'a Schedule,
    /// Linear guess for predictions that are relative to it; none for other predictions.
    pub extrapolation: Option<&'a Extrapolation>,
    /// Prediction, losses and their weights.
    pub config: &'a DiffusionConfig,
    /// Normaliser with which the windows were scaled.
    pub normalizer: &'a Normalizer,
    /// Frame rate of the windows.
    pub fps: Fps,
}

impl Objective<'_> {
    /// The training loss of a batch: the error of the prediction on the frames that are not fixed, plus the weighted
    /// losses on frame differences, bones and sliding feet.
    ///
    /// # Shapes
    /// `text` `[B, d]`; the result is one number.
    ///
    /// # Source
    /// Paper Eq. 2; released `train_losses` for [`Prediction::Noise`], [`FixedFrames::Scaled`] and
    /// [`Loss::SmoothL1`].
    pub fn loss(
        &self,
        denoiser: &Denoiser,
        batch: &NoisyBatch,
        text: Tensor<2>,
        pass: &Pass,
    ) -> Tensor<1> {
        let Self {
            schedule, config, ..
        } = *self;
        let windows = Windows::of(batch, denoiser.frame_width(), &text.device());
        let Windows { x0, original, .. } = &windows;
        let basis = Basis::new(original.clone(), &batch.is_start, self.extrapolation);
        let x_t = self.shown(&windows, &batch.timesteps, &basis);
        let predicted = denoiser.forward(
            basis.seen(x_t.clone()),
            &batch.timesteps,
            text,
            &batch.progress,
            basis.seen(original.clone()),
            pass,
        );
        let needs_clean = config.prediction == Prediction::Gated
            || config.contact_weight > 0.0
            || config.bone_weight > 0.0;
        let clean = needs_clean.then(|| {
            let predicted = predicted.clone();
            schedule.clean_of(config.prediction, predicted, &x_t, &basis, &batch.timesteps)
        });
        let spread = || basis.guess(&x_t).1;
        let (predicted, target) = self.compared(predicted, clean.as_ref(), &windows, spread);
        let mut loss = self.of_frames(&predicted, &target, windows.starts.as_ref());
        if config.motion_weight > 0.0 {
            let motion = config
                .loss
                .mean(steps(free(&predicted)), steps(free(&target)));
            loss = loss + motion.mul_scalar(config.motion_weight);
        }
        if config.bone_weight > 0.0 {
            let clean = clean.as_ref().expect("bones need it");
            let bones = self.bones(free(clean), free(x0));
            loss = loss + bones.mul_scalar(config.bone_weight);
        }
        if config.contact_weight > 0.0 {
            let clean = clean.expect("contacts need it");
            // The editor restores the fixed frames, so a foot that rests in them must stay there.
            let clean = put_fixed(clean, x0.clone().narrow(1, 0, FIXED_FRAMES));
            let contact = self.sliding(clean, x0.clone(), &batch.timesteps);
            loss = loss + contact.mul_scalar(config.contact_weight);
        }
        loss
    }

    /// Prediction and target as the loss compares them. For gated predictions these are the predicted and the true
    /// change of the original, divided by the residual's `spread`.
    fn compared(
        &self,
        predicted: Tensor<3>,
        clean: Option<&Tensor<3>>,
        windows: &Windows,
        spread: impl FnOnce() -> Tensor<3>,
    ) -> (Tensor<3>, Tensor<3>) {
        let Windows {
            x0,
            noise,
            original,
            ..
        } = windows;
        let change = || x0.clone() - original.clone();
        match self.config.prediction {
            Prediction::Noise => (predicted, noise.clone()),
            Prediction::Clean => (predicted, x0.clone()),
            Prediction::Change => (predicted, change()),
            Prediction::Gated => {
                let clean = clean.cloned().expect("gates need it");
                let spread = spread();
                let found = (clean - original.clone()) / spread.clone();
                (found, change() / spread)
            }
        }
    }

    /// The error on the frames that are not fixed; in first windows, no frame is fixed.
    fn of_frames(
        &self,
        predicted: &Tensor<3>,
        target: &Tensor<3>,
        starts: Option<&Tensor<3>>,
    ) -> Tensor<1> {
        let [_, window, _] = target.dims();
        let begun = starts.map(|starts| {
            let first = |x: &Tensor<3>| x.clone().narrow(1, 0, FIXED_FRAMES) * starts.clone();
            self.config.loss.mean(first(predicted), first(target))
        });
        let loss = self.config.loss.mean(free(predicted), free(target));
        match begun {
            // Weight the two parts by their number of frames, so that every value counts the same.
            Some(begun) => {
                let weight = FIXED_FRAMES as f64 / (window - FIXED_FRAMES) as f64;
                loss + begun.mul_scalar(weight)
            }
            None => loss,
        }
    }

    /// Input of the network: noisy frames, with the fixed frames as the settings specify. A motion's first window has
    /// no fixed frames.
    fn shown(&self, windows: &Windows, timesteps: &[usize], basis: &Basis) -> Tensor<3> {
        let Windows {
            x0, noise, starts, ..
        } = windows;
        let noisy = |x: Tensor<3>| self.schedule.q_sample(x, timesteps, noise.clone());
        if self.config.fixed_frames == FixedFrames::Scaled {
            return noisy(x0.clone());
        }
        let first = |x: &Tensor<3>| x.clone().narrow(1, 0, FIXED_FRAMES);
        let mut clean = first(x0);
        if self.config.fixed_noise > 0.0 {
            clean = clean + first(noise).mul_scalar(self.config.fixed_noise);
        }
        let x_t = match basis.centre(&put_fixed(x0.clone(), clean.clone())) {
            Some(centre) => noisy(x0.clone() - centre.clone()) + centre,
            None => noisy(x0.clone()),
        };
        let shown = match starts {
            None => clean,
            Some(starts) => clean.clone() + (first(&x_t) - clean) * starts.clone(),
        };
        put_fixed(x_t, shown)
    }

    /// The loss on the pelvis and the bones in units of [`BONE_UNIT`].
    ///
    /// # Shapes
    /// Both `[B, W, D]`, clean windows; the result is one number.
    fn bones(&self, clean: Tensor<3>, wanted: Tensor<3>) -> Tensor<1> {
        let [_, _, width] = clean.dims();
        let Normalizer { min, max } = self.normalizer;
        let unit = |at: usize| (max[at % 3] - min[at % 3]) / 2.0 / BONE_UNIT;
        let units: Vec<f32> = (0..width).map(|at| unit(at) as f32).collect();
        let device = clean.device();
        let units = send(units, [1, 1, width], &device);
        let [to_bones, _] = bones(width / 3, &device);
        let differences = mapped((clean - wanted) * units, to_bones);
        let nothing = differences.zeros_like();
        self.config.loss.mean(differences, nothing)
    }

    /// The contact loss: the speed in `clean`, in units of [`REST_SPEED`], of ankles and feet that are slower than
    /// [`REST_SPEED`] in `wanted`. The mean is over all feet and all steps that end in a generated frame. Moving feet
    /// count as zero, so a window's weight grows with its contacts. Noisy windows weigh less.
    ///
    /// # Shapes
    /// Both `[B, W, D]`, clean windows; the result is one number.
    fn sliding(&self, clean: Tensor<3>, wanted: Tensor<3>, timesteps: &[usize]) -> Tensor<1> {
        let [batch, window, _] = clean.dims();
        let Normalizer { min, max } = self.normalizer;
        // Displacement of one model unit per frame, in units of REST_SPEED.
        let units: Vec<f32> = (0..3)
            .map(|axis| ((max[axis] - min[axis]) / 2.0 * self.fps.get() / REST_SPEED) as f32)
            .collect();
        let units = send(units, [1, 1, 1, 3], &clean.device());
        let speeds = |x: Tensor<3>| {
            let feet = FEET.map(|joint| x.clone().narrow(2, 3 * joint.index(), 3));
            let steps = steps(Tensor::cat(feet.to_vec(), 2));
            // Steps between two fixed frames are not generated, so they are left out.
            let count = window - FIXED_FRAMES;
            let steps = steps.narrow(1, FIXED_FRAMES - 1, count);
            steps.reshape([batch, count, FEET.len(), 3]) * units.clone()
        };
        let at_rest = speeds(wanted).square().sum_dim(3).lower_elem(1.0).float();
        let sliding = speeds(clean) * at_rest;
        let [batch, count, feet, _] = sliding.dims();
        let sliding = sliding.reshape([batch, count, 3 * feet]);
        let (signal, _) = self.schedule.mixture(timesteps);
        signal
            .times(signal.times(self.config.loss.of_each(sliding)))
            .mean()
    }
}

/// The frames of windows that are not fixed.
///
/// # Shapes
/// `[B, W, D]` give `[B, W - 2, D]`.
fn free(x: &Tensor<3>) -> Tensor<3> {
    let [_, window, _] = x.dims();
    x.clone().narrow(1, FIXED_FRAMES, window - FIXED_FRAMES)
}

/// Differences from frame to frame.
///
/// # Shapes
/// `[B, W, D]` give `[B, W - 1, D]`.
fn steps(x: Tensor<3>) -> Tensor<3> {
    let [_, frames, _] = x.dims();
    x.clone().narrow(1, 1, frames - 1) - x.narrow(1, 0, frames - 1)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use kinematics::normalise::FRAME_WIDTH;
    use kinematics::skeleton::{NUM_KEYPOINTS, parent_of};

    use super::*;
    use crate::config::ScheduleName;
    use crate::sample::noise::normal;
    use crate::transfer::read;

    fn tensor(values: &[f32]) -> Tensor<3> {
        send(values.to_vec(), [1, 1, values.len()], &Device::flex())
    }

    #[test]
    fn smooth_l1_is_quadratic_below_one_and_linear_above() {
        for (difference, expected) in [(0.5, 0.125), (-1.0, 0.5), (3.0, 2.5), (-2.0, 1.5)] {
            let loss = Loss::SmoothL1.mean(tensor(&[difference]), tensor(&[0.0]));
            assert_eq!(loss.into_scalar::<f32>(), expected);
        }
        let loss = Loss::Mse.mean(tensor(&[3.0, 1.0]), tensor(&[0.0, 0.0]));
        assert_eq!(loss.into_scalar::<f32>(), 5.0);
    }

    #[test]
    fn guidance_of_one_is_the_prediction_with_text_and_of_zero_without() {
        let (with, without) = (tensor(&[2.0, -1.0]), tensor(&[0.5, 1.0]));
        assert_eq!(read(guide(with.clone(), without.clone(), 1.0)), [2.0, -1.0]);
        assert_eq!(read(guide(with.clone(), without.clone(), 0.0)), [0.5, 1.0]);
        assert_eq!(read(guide(with, without, 3.0)), [5.0, -5.0]);
    }

    const NUM_GATES: usize = 3;

    #[test]
    fn gates_choose_between_the_original_the_guess_and_the_network() {
        const WINDOW: usize = 3;
        let device = Device::flex();
        let mut rng = datasets_spec::Seed(5).rng(&["gates"]);
        let mut normal = |rows: usize| normal(&mut rng, rows * FRAME_WIDTH);
        let frames = |values: &[f32]| -> Tensor<3> {
            let shape = [1, values.len() / FRAME_WIDTH, FRAME_WIDTH];
            send(values.to_vec(), shape, &device)
        };
        let original = normal(WINDOW);
        let shown = normal(WINDOW);
        let made = normal(WINDOW);
        let guess = Extrapolation {
            gains: vec![[1.0, 0.0], [0.0, 1.0], [-0.5, 1.5]],
            spreads: vec![0.5, 0.5, 0.25],
            start_spreads: vec![1.0; WINDOW],
            shape: None,
        };
        let basis = Basis::new(frames(&original), &[false], Some(&guess));
        let schedule = Schedule::new(ScheduleName::Rescaled, 50).expect("enough steps");
        // Clean prediction of the last frame. `wrist` and `others` tell which gates are open for the left wrist and for
        // all other bones.
        let clean = |wrist: [bool; NUM_GATES], others: [bool; NUM_GATES]| {
            let logits = (0..NUM_GATES).flat_map(|gate| {
                (0..NUM_KEYPOINTS).map(move |slot| {
                    let is_wrist = slot == Joint::LeftWrist.index();
                    let open = if is_wrist { wrist } else { others }[gate];
                    if open { 60.0f32 } else { -60.0 }
                })
            });
            let logits: Vec<f32> = logits.collect();
            let logits = [logits.as_slice(); WINDOW].concat();
            let shape = [1, WINDOW, NUM_GATES * NUM_KEYPOINTS];
            let logits = send(logits, shape, &device);
            let predicted = Tensor::cat(vec![frames(&made), logits], 2);
            let clean =
                schedule.clean_of(Prediction::Gated, predicted, &frames(&shown), &basis, &[0]);
            let values = read(clean);
            values[(WINDOW - 1) * FRAME_WIDTH..].to_vec()
        };
        let [kept, carried, own] = [0, 1, 2].map(|gate| {
            let mut open = [false; NUM_GATES];
            open[gate] = true;
            open
        });
        let of = |values: &[f32], frame: usize, at: usize| values[frame * FRAME_WIDTH + at];
        let change = |frame, at| of(&shown, frame, at) - of(&original, frame, at);
        let near = |found: f32, expected: f32| {
            // The tolerance is the rounding error of sums of a dozen numbers of size one.
            assert!((found - expected).abs() < 1e-5, "{found} {expected}");
        };
        let copied = clean(kept, kept);
        let guessed = clean(carried, carried);
        let replaced = clean(own, kept);
        for at in 0..FRAME_WIDTH {
            near(copied[at], of(&original, 2, at));
            near(guessed[at], 1.5 * change(1, at) - 0.5 * change(0, at));
            // The network's bone moves the wrist relative to the elbow. The fingers follow the wrist, and no other
            // keypoint moves.
            let (slot, axis) = (at / 3, at % 3);
            let [wrist, elbow] =
                [Joint::LeftWrist, Joint::LeftElbow].map(|joint| 3 * joint.index() + axis);
            let placed = of(&original, 2, elbow) + 0.25 * of(&made, 2, wrist);
            let expected = match slot {
                slot if 3 * slot + axis == wrist => placed,
                slot if slot > 0 && parent_of(slot) == Joint::LeftWrist.index() => {
                    placed + of(&original, 2, at) - of(&original, 2, wrist)
                }
                _ => of(&original, 2, at),
            };
            near(replaced[at], expected);
        }
    }

    #[test]
    fn noise_of_the_data_s_covariance_shows_its_share_of_the_rest() {
        const WINDOW: usize = 4;
        let device = Device::flex();
        let mut rng = datasets_spec::Seed(8).rng(&["shown"]);
        let mut normal = |rows: usize| normal(&mut rng, rows * WINDOW * FRAME_WIDTH);
        let (originals, edited) = (normal(16), normal(16));
        let guess = Extrapolation::fit(&originals, &edited, WINDOW, 0.0, NoiseKind::Shaped);
        let windows = |values: &[f32]| -> Tensor<3> {
            let shape = [1, WINDOW, FRAME_WIDTH];
            send(values[..WINDOW * FRAME_WIDTH].to_vec(), shape, &device)
        };
        let (original, x_t) = (windows(&originals), windows(&edited));
        let basis = Basis::new(original, &[false], Some(&guess));
        let centre = basis.centre(&x_t).expect("noise is shaped");
        let schedule = Schedule::new(ScheduleName::Cosine, 20).expect("enough steps");
        // All gates are open, and the network's bones are zero.
        let logits = Tensor::<3>::full([1, WINDOW, 4 * NUM_KEYPOINTS], 60.0, &device);
        let predicted = Tensor::cat(vec![x_t.zeros_like(), logits], 2);
        for t in [0, 9, 19] {
            let clean = schedule.clean_of(Prediction::Gated, predicted.clone(), &x_t, &basis, &[t]);
            let signal = schedule.alphas_cumprod[t].sqrt();
            let expected = centre.clone() + (x_t.clone() - centre.clone()).mul_scalar(signal);
            for (a, b) in read(clean).iter().zip(read(expected)) {
                // The tolerance is the rounding error of sums of a dozen numbers of size one.
                assert!((a - b).abs() < 1e-4, "{a} {b}");
            }
        }
    }

    /// A schedule, and diffusion settings with squared-error losses.
    fn squares() -> (Schedule, DiffusionConfig) {
        let config = DiffusionConfig {
            loss: Loss::Mse,
            ..crate::config::TrainConfig::preset(crate::config::Preset::Tiny).diffusion
        };
        let schedule = Schedule::new(ScheduleName::Rescaled, 50).expect("enough steps");
        (schedule, config)
    }

    /// The objective for windows at 10 frames per second, in which a model unit is 2 m vertically and 1 m horizontally.
    fn objective<'a>(schedule: &'a Schedule, config: &'a DiffusionConfig) -> Objective<'a> {
        Objective {
            schedule,
            extrapolation: None,
            config,
            normalizer: &Normalizer {
                min: [-1.0, -2.0, -1.0],
                max: [1.0, 2.0, 1.0],
            },
            fps: Fps::new(10.0).expect("positive"),
        }
    }

    #[test]
    fn feet_that_should_rest_cost_their_speed() {
        const WINDOW: usize = 8;
        let (schedule, config) = squares();
        let objective = objective(&schedule, &config);
        let window = |numbers: &dyn Fn(usize) -> [f32; 2]| {
            let mut values = vec![0.0f32; WINDOW * FRAME_WIDTH];
            for (frame, row) in values.chunks_exact_mut(FRAME_WIDTH).enumerate() {
                let [ankle, foot] = numbers(frame);
                row[3 * Joint::LeftAnkle.index() + 1] = ankle;
                row[3 * Joint::RightFoot.index() + 2] = foot;
            }
            send(values, [1, WINDOW, FRAME_WIDTH], &Device::flex())
        };
        // In the target, the ankle rests and the foot moves at 0.5 m/s. In the prediction, both stand still, except for
        // one jump of the ankle by 6 cm.
        let wanted = window(&|frame| [0.3, 0.05 * frame as f32]);
        let jump = window(&|frame| [if frame < 5 { 0.3 } else { 0.33 }, 0.0]);
        let loss_at = |clean: &Tensor<3>, t: usize| -> f32 {
            objective
                .sliding(clean.clone(), wanted.clone(), &[t])
                .into_scalar()
        };
        // The jump has 0.6 m/s, six times the rest speed; the mean is over six steps, four feet and three axes. Noisy
        // windows are weighted by their share of signal.
        for t in [0, 20, 49] {
            let expected = schedule.alphas_cumprod[t] as f32 * 36.0 / (6.0 * 4.0 * 3.0);
            let found = loss_at(&jump, t);
            assert!((found - expected).abs() < 1e-4, "{found} {expected}");
        }
        let loss = |clean: &Tensor<3>| loss_at(clean, 0);
        // A moving foot is not penalised.
        assert!(loss(&wanted) == 0.0 && loss(&window(&|_| [0.3, 0.0])) == 0.0);
    }

    #[test]
    fn a_body_that_is_shifted_costs_its_pelvis_and_a_bone_that_is_turned_costs_itself() {
        let (schedule, config) = squares();
        let objective = objective(&schedule, &config);
        let rest = tensor(&[0.0; FRAME_WIDTH]);
        let loss = |moved: &dyn Fn(usize) -> bool| -> f32 {
            // 20 cm upwards is two units.
            let values: Vec<f32> = (0..FRAME_WIDTH)
                .map(|at| {
                    if at % 3 == 1 && moved(at / 3) {
                        0.1
                    } else {
                        0.0
                    }
                })
                .collect();
            objective.bones(tensor(&values), rest.clone()).into_scalar()
        };
        let one = 4.0 / FRAME_WIDTH as f32;
        let body = loss(&|_| true);
        assert!((body - one).abs() < 1e-6, "{body} {one}");
        // Rotating the forearm moves the hand too.
        let arm = loss(&|slot| slot >= NUM_KEYPOINTS - 2 || slot == Joint::RightWrist.index());
        assert!((arm - one).abs() < 1e-6, "{arm} {one}");
    }

    proptest! {
        #[test]
        fn every_true_prediction_gives_the_clean_window_back(
            x0 in prop::collection::vec(-1.0f32..1.0, 4),
            original in prop::collection::vec(-1.0f32..1.0, 4),
            noise in prop::collection::vec(-3.0f32..3.0, 4),
            t in 0usize..50,
        ) {
            let schedule = Schedule::new(ScheduleName::Rescaled, 50).expect("enough steps");
            let x_t = schedule.q_sample(tensor(&x0), &[t], tensor(&noise));
            let change = tensor(&x0) - tensor(&original);
            for (prediction, predicted) in [
                (Prediction::Noise, tensor(&noise)),
                (Prediction::Clean, tensor(&x0)),
                (Prediction::Change, change),
            ] {
                let basis = Basis::new(tensor(&original), &[false], None);
                let back = schedule.clean_of(prediction, predicted, &x_t, &basis, &[t]);
                // A rounding error of x_t, whose size is at most 4, is divided by the remaining signal.
                let slack = 4.0 * 1e-6 / schedule.alphas_cumprod[t].sqrt();
                for (a, b) in x0.iter().zip(read(back)) {
                    prop_assert!(f64::from((a - b).abs()) < slack, "{prediction:?} {a} {b}");
                }
            }
        }
    }
}
