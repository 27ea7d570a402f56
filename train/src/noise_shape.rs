//! Noise with the covariance of an edit's residual.

use kinematics::canonical::FIXED_FRAMES;
use kinematics::normalise::FRAME_WIDTH;
use serde::{Deserialize, Serialize};

use crate::bones::{ROOT_NUMBERS, bone_number, parent_number};

/// Lower bound of standard deviations in model units, here and in [`crate::extrapolation`]. It is a few millimetres,
/// the noise of motion capture.
pub(crate) const LEAST_SPREAD: f64 = 2e-3;

/// Lower bound of the standard deviation that a bone is divided by for the network, in model units. Bones of the trunk
/// hardly change; without a bound, their noise would appear as large as a swinging leg.
const LEAST_STANDARD: f64 = 0.01;

/// Share of the mean variance that is added to the diagonal of temporal covariances, so that they can be factored.
const RIDGE: f64 = 1e-4;

/// The covariance of the residual around a window's mean, used to shape white noise, and statistics of bones, used to
/// standardise the network's input.
///
/// In model units a swinging leg is small compared with the path of the root. White noise hides it in nearly all
/// diffusion steps, so a small network learns to ignore the noisy window and predicts the mean over all phases of a
/// gait: a person who glides. Shaped noise hides all parts equally, so a phase is visible from the first sampling steps
/// on.
///
/// The covariance is separable. Each axis of the pelvis has a temporal covariance. All bones share one, which is scaled
/// by the standard deviation of each coordinate.
///
/// # Source
/// PriorGrad (Lee et al., ICLR 2022, Sec. 3): diffusion around the mean of a prior, with noise of the prior's
/// covariance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NoiseShape {
    /// Mean of each bone coordinate over edited windows, in model units, `[84]`.
    mean: Vec<f32>,
    /// Standard deviation of each bone coordinate, bounded from below, `[84]`.
    standard: Vec<f32>,
    /// Covariance for windows with fixed frames.
    after_fixed: Covariance,
    /// Covariance for windows without fixed frames.
    start: Covariance,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Covariance {
    /// First frame that is not fixed.
    first: usize,
    /// Standard deviation of each bone coordinate over all frames that are not fixed, in model units; 1 for the pelvis,
    /// `[84]`.
    spreads: Vec<f32>,
    /// Lower Cholesky factors of the temporal covariances of pelvis x, y and z and of the bones, over `F` frames that
    /// are not fixed; row by row without the zeros, `[4, F (F + 1) / 2]`.
    factors: Vec<Vec<f32>>,
}

impl NoiseShape {
    /// Fits the shape to windows of keypoints, `[N, W, 84]` each: edited windows, and the residuals of their change,
    /// with and without fixed frames.
    pub(crate) fn fit(edited: &[f32], after_fixed: &[f32], start: &[f32], window: usize) -> Self {
        let (mut mean, mut standard) = (Vec::new(), Vec::new());
        let count = (edited.len() / FRAME_WIDTH).max(1) as f64;
        for number in 0..FRAME_WIDTH {
            let (mut sum, mut squares) = (0.0f64, 0.0f64);
            for frame in edited.chunks_exact(FRAME_WIDTH) {
                let value = f64::from(bone_number(frame, number));
                sum += value;
                squares += value * value;
            }
            let of_number = sum / count;
            let variance = (squares / count - of_number * of_number).max(0.0);
            mean.push(of_number as f32);
            standard.push(variance.sqrt().max(LEAST_STANDARD) as f32);
        }
        Self {
            mean,
            standard,
            after_fixed: Covariance::fit(after_fixed, window, FIXED_FRAMES),
            start: Covariance::fit(start, window, 0),
        }
    }

    /// Whether all arrays have the lengths that a window of `window` frames needs.
    pub(crate) fn fits(&self, window: usize) -> bool {
        let has_all = |numbers: &Vec<f32>| numbers.len() == FRAME_WIDTH;
        has_all(&self.mean)
            && has_all(&self.standard)
            && [(&self.after_fixed, FIXED_FRAMES), (&self.start, 0)]
                .iter()
                .all(|(covariance, first)| {
                    let frames = window - first;
                    covariance.first == *first
                        && has_all(&covariance.spreads)
                        && covariance.factors.len() == ROOT_NUMBERS + 1
                        && covariance
                            .factors
                            .iter()
                            .all(|factor| factor.len() == frames * (frames + 1) / 2)
                })
    }

    /// Shapes the white noise of a window in place. The noise of fixed frames is not changed.
    ///
    /// # Shapes
    /// `noise` `[W, 3 K]`, of the first `K` keypoints.
    pub fn apply(&self, noise: &mut [f32], keypoints: usize, is_start: bool) {
        self.covariance(is_start).apply(noise, 3 * keypoints);
    }

    /// Mean and inverse standard deviation of the first `width` bone coordinates of a frame.
    pub(crate) fn standard(&self, width: usize) -> (Vec<f32>, Vec<f32>) {
        let scale = self.standard[..width].iter().map(|spread| spread.recip());
        (self.mean[..width].to_vec(), scale.collect())
    }

    /// Standard deviation of the noise of bones, `[W, width]`; the lower bound for fixed frames.
    pub(crate) fn spreads(&self, width: usize, is_start: bool) -> Vec<f32> {
        let covariance = self.covariance(is_start);
        let mut out = vec![LEAST_SPREAD as f32; covariance.first * width];
        for frame in 0..covariance.num_frames() {
            for number in 0..width {
                let row = covariance.row(number, frame);
                let variance: f32 = row.iter().map(|weight| weight * weight).sum();
                out.push(covariance.spreads[number] * variance.sqrt());
            }
        }
        out
    }

    fn covariance(&self, is_start: bool) -> &Covariance {
        if is_start {
            &self.start
        } else {
            &self.after_fixed
        }
    }
}

impl Covariance {
    fn fit(left: &[f32], window: usize, first: usize) -> Self {
        let frames = window - first;
        // Covariances over pairs of frames, for each bone coordinate.
        let mut moments = vec![vec![0.0f64; frames * frames]; FRAME_WIDTH];
        let mut bone = vec![0.0f64; frames];
        for window in left.chunks_exact(window * FRAME_WIDTH) {
            for (number, cells) in moments.iter_mut().enumerate() {
                let open = window[first * FRAME_WIDTH..].chunks_exact(FRAME_WIDTH);
                for (value, frame) in bone.iter_mut().zip(open) {
                    *value = f64::from(bone_number(frame, number));
                }
                for (row, a) in cells.chunks_exact_mut(frames).zip(&bone) {
                    for (cell, b) in row.iter_mut().zip(&bone) {
                        *cell += a * b;
                    }
                }
            }
        }
        let count = (left.len() / (window * FRAME_WIDTH)).max(1) as f64;
        for cell in moments.iter_mut().flatten() {
            *cell /= count;
        }
        let (root, bones) = moments.split_at(ROOT_NUMBERS);
        let mut spreads = vec![1.0f32; ROOT_NUMBERS];
        let mut shared = vec![0.0f64; frames * frames];
        for cells in bones {
            let diagonal = cells.iter().step_by(frames + 1);
            let spread = (diagonal.sum::<f64>() / frames as f64).sqrt();
            let spread = spread.max(LEAST_SPREAD);
            spreads.push(spread as f32);
            for (sum, cell) in shared.iter_mut().zip(cells) {
                *sum += cell / (spread * spread * bones.len() as f64);
            }
        }
        let factors = root.iter().chain([&shared]);
        Self {
            first,
            spreads,
            factors: factors.map(|cells| cholesky(cells, frames)).collect(),
        }
    }

    fn num_frames(&self) -> usize {
        // Inverts the number of weights, F (F + 1) / 2.
        (2 * self.factors[0].len()).isqrt()
    }

    /// The weights with which the noise of frames up to `frame` enters this frame, for one coordinate.
    fn row(&self, number: usize, frame: usize) -> &[f32] {
        &self.factors[number.min(ROOT_NUMBERS)][frame * (frame + 1) / 2..][..frame + 1]
    }

    fn apply(&self, noise: &mut [f32], width: usize) {
        let noise = &mut noise[self.first * width..];
        for number in 0..width {
            // A frame depends only on earlier frames, so the last one is computed first.
            for frame in (0..noise.len() / width).rev() {
                let before = noise[number..].iter().step_by(width);
                let mixed: f32 = self
                    .row(number, frame)
                    .iter()
                    .zip(before)
                    .map(|(weight, value)| weight * value)
                    .sum();
                noise[frame * width + number] = self.spreads[number] * mixed;
            }
        }
        for frame in noise.chunks_exact_mut(width) {
            // Converts bones to points: parents come before their children.
            for number in ROOT_NUMBERS..width {
                frame[number] += frame[parent_number(number)];
            }
        }
    }
}

/// The lower Cholesky factor of a covariance, `[F, F]`, row by row without the zeros.
fn cholesky(covariance: &[f64], size: usize) -> Vec<f32> {
    let trace: f64 = covariance.iter().step_by(size + 1).sum();
    let ridge = RIDGE * (trace / size as f64).max(LEAST_SPREAD * LEAST_SPREAD);
    let first = |row: usize| row * (row + 1) / 2;
    let mut factor = vec![0.0f64; first(size)];
    for row in 0..size {
        for column in 0..=row {
            let known: f64 = (0..column)
                .map(|k| factor[first(row) + k] * factor[first(column) + k])
                .sum();
            let left = covariance[row * size + column] - known;
            factor[first(row) + column] = if row == column {
                (left + ridge).max(ridge).sqrt()
            } else {
                left / factor[first(column) + column]
            };
        }
    }
    factor.into_iter().map(|value| value as f32).collect()
}

#[cfg(test)]
mod tests {
    use datasets_spec::Seed;
    use kinematics::skeleton::NUM_BODY_JOINTS;
    use rand::RngExt;
    use rand_distr::StandardNormal;

    use super::*;
    use crate::sample::noise::normal;

    const WINDOW: usize = 5;

    /// Windows of keypoints whose bones are random walks over the frames, scaled by `scale(number)`.
    fn walks(count: usize, scale: impl Fn(usize) -> f32) -> Vec<f32> {
        let mut rng = Seed(3).rng(&["walks"]);
        let mut out = Vec::new();
        for _ in 0..count {
            let mut bones = vec![0.0f32; FRAME_WIDTH];
            for _ in 0..WINDOW {
                for (number, bone) in bones.iter_mut().enumerate() {
                    *bone += scale(number) * rng.sample::<f32, _>(StandardNormal);
                }
                let mut points = bones.clone();
                for number in ROOT_NUMBERS..FRAME_WIDTH {
                    points[number] += points[parent_number(number)];
                }
                out.extend(points);
            }
        }
        out
    }

    fn scale(number: usize) -> f32 {
        0.05 * (1 + number % 4) as f32
    }

    #[test]
    fn shaped_noise_has_the_covariance_it_was_fitted_to() {
        let left = walks(4_000, scale);
        let shape = NoiseShape::fit(&left, &left, &left, WINDOW);
        let mut rng = Seed(4).rng(&["noise"]);
        let numbers = [0, 2, 21, 50, 83];
        let mut moments = [[[0.0f64; WINDOW]; WINDOW]; 5];
        const WINDOWS: usize = 4_000;
        for _ in 0..WINDOWS {
            let mut noise = normal(&mut rng, WINDOW * FRAME_WIDTH);
            shape.apply(&mut noise, FRAME_WIDTH / 3, true);
            for (cells, number) in moments.iter_mut().zip(numbers) {
                let bone = |frame: usize| {
                    let points = &noise[frame * FRAME_WIDTH..][..FRAME_WIDTH];
                    f64::from(bone_number(points, number))
                };
                for (a, row) in cells.iter_mut().enumerate() {
                    for (b, cell) in row.iter_mut().enumerate() {
                        *cell += bone(a) * bone(b) / WINDOWS as f64;
                    }
                }
            }
        }
        let spreads = shape.spreads(FRAME_WIDTH, true);
        for (cells, number) in moments.iter().zip(numbers) {
            let step = f64::from(scale(number)).powi(2);
            for (a, row) in cells.iter().enumerate() {
                for (b, cell) in row.iter().enumerate() {
                    // Two frames of a random walk share the steps up to the earlier one. With 4,000 windows, a variance
                    // has an error of 2 %, once in the fit and once in the noise.
                    let expected = step * (1 + a.min(b)) as f64;
                    let open = 0.1 * step * (1 + a.max(b)) as f64;
                    let apart = (cell - expected).abs();
                    assert!(apart < open, "{number} {a} {b}: {cell} {expected}");
                }
                let spread = f64::from(spreads[a * FRAME_WIDTH + number]).powi(2) / row[a];
                assert!((spread - 1.0).abs() < 0.1, "{number} {a}: {spread}");
            }
        }
    }

    #[test]
    fn fixed_frames_keep_white_noise_and_body_joints_do_not_need_the_others() {
        let left = walks(64, scale);
        let shape = NoiseShape::fit(&left, &left, &left, WINDOW);
        let mut rng = Seed(5).rng(&["noise"]);
        let white = normal(&mut rng, WINDOW * FRAME_WIDTH);
        let mut noise = white.clone();
        shape.apply(&mut noise, FRAME_WIDTH / 3, false);
        assert_eq!(noise[..2 * FRAME_WIDTH], white[..2 * FRAME_WIDTH]);
        assert_ne!(noise[2 * FRAME_WIDTH..], white[2 * FRAME_WIDTH..]);

        let width = 3 * NUM_BODY_JOINTS;
        let narrowed = |noise: &[f32]| -> Vec<f32> {
            let frames = noise.chunks_exact(FRAME_WIDTH);
            frames.flat_map(|frame| frame[..width].to_vec()).collect()
        };
        let mut narrow = narrowed(&white);
        shape.apply(&mut narrow, NUM_BODY_JOINTS, false);
        assert_eq!(narrow, narrowed(&noise));
        assert_eq!(shape.spreads(width, false).len(), WINDOW * width);
        // A shape that is written is read again.
        let text = serde_json::to_string(&shape).expect("plain numbers");
        let read: NoiseShape = serde_json::from_str(&text).expect("the same");
        assert!(read == shape);
    }
}
