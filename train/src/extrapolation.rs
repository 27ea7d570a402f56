//! Linear extrapolation of an edit from a window's fixed frames, and the residual of this guess.

use burn::tensor::{Device, Tensor};
use kinematics::canonical::FIXED_FRAMES;
use kinematics::normalise::FRAME_WIDTH;
use serde::{Deserialize, Serialize};

use crate::bones::{bones, mapped};
use crate::config::NoiseKind;
use crate::noise_shape::{LEAST_SPREAD, NoiseShape};
use crate::transfer::send;

/// The best linear prediction of a window's change (edited minus original) from the change of its fixed frames. One
/// matrix, fitted to training windows, is used for all coordinates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Extrapolation {
    /// Regression weights of each frame's change on the change of the fixed frames, `[W, 2]`; the identity for the
    /// fixed frames themselves.
    pub(crate) gains: Vec<[f32; FIXED_FRAMES]>,
    /// Standard deviation of the residual in each frame, in model units, `[W]`.
    pub(crate) spreads: Vec<f32>,
    /// Standard deviation of the change in windows without fixed frames, in model units, `[W]`.
    pub(crate) start_spreads: Vec<f32>,
    /// Covariance of the residual; present exactly if the noise is shaped.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) shape: Option<NoiseShape>,
}

impl Extrapolation {
    /// Fits the linear guess to pairs of original and edited windows, `[N, W, 84]` each; if `noise` is shaped, also the
    /// covariance of the noise. `fixed_noise` is the standard deviation, in model units, of the noise on the fixed
    /// frames that the network is shown.
    ///
    /// # Panics
    /// If a window has only fixed frames.
    pub fn fit(
        original: &[f32],
        edited: &[f32],
        window: usize,
        fixed_noise: f64,
        noise: NoiseKind,
    ) -> Self {
        assert!(window > FIXED_FRAMES, "a window has frames to generate");
        let changes: Vec<f32> = edited.iter().zip(original).map(|(a, b)| a - b).collect();
        let mut moments = vec![vec![0.0f64; window]; window];
        let mut count = 0u64;
        for changes in changes.chunks_exact(window * FRAME_WIDTH) {
            count += FRAME_WIDTH as u64;
            for channel in 0..FRAME_WIDTH {
                let of_channel = changes[channel..].iter().step_by(FRAME_WIDTH);
                let changes: Vec<f64> = of_channel.map(|&change| f64::from(change)).collect();
                for (row, a) in moments.iter_mut().zip(&changes) {
                    for (cell, b) in row.iter_mut().zip(&changes) {
                        *cell += a * b;
                    }
                }
            }
        }
        for cell in moments.iter_mut().flatten() {
            *cell /= count.max(1) as f64;
        }
        // Normal equations of two fixed frames. The ridge keeps them solvable if nothing moves.
        let ridge = LEAST_SPREAD * LEAST_SPREAD + fixed_noise * fixed_noise;
        let (a, b, d) = (moments[0][0] + ridge, moments[0][1], moments[1][1] + ridge);
        let determinant = a * d - b * b;
        let mut gains = Vec::with_capacity(window);
        let mut spreads = Vec::with_capacity(window);
        for (frame, row) in moments.iter().enumerate() {
            if frame < FIXED_FRAMES {
                let mut own = [0.0; FIXED_FRAMES];
                own[frame] = 1.0;
                gains.push(own);
                spreads.push(LEAST_SPREAD as f32);
                continue;
            }
            let (p, q) = (row[0], row[1]);
            let (g, h) = ((p * d - q * b) / determinant, (q * a - p * b) / determinant);
            let left = row[frame] - 2.0 * (g * p + h * q) + g * g * a + 2.0 * g * h * b + h * h * d;
            gains.push([g as f32, h as f32]);
            spreads.push(left.max(0.0).sqrt().max(LEAST_SPREAD) as f32);
        }
        let start_spreads = (0..window)
            .map(|frame| moments[frame][frame].sqrt().max(LEAST_SPREAD) as f32)
            .collect();
        let shape = (noise == NoiseKind::Shaped).then(|| {
            let mut left = changes.clone();
            for (left, changes) in left
                .chunks_exact_mut(window * FRAME_WIDTH)
                .zip(changes.chunks_exact(window * FRAME_WIDTH))
            {
                for (at, left) in left.iter_mut().enumerate() {
                    let (frame, number) = (at / FRAME_WIDTH, at % FRAME_WIDTH);
                    let [first, second] = gains[frame];
                    *left -= first * changes[number] + second * changes[FRAME_WIDTH + number];
                }
            }
            NoiseShape::fit(edited, &left, &changes, window)
        });
        Self {
            gains,
            spreads,
            start_spreads,
            shape,
        }
    }

    /// Number of frames in a window.
    pub fn window(&self) -> usize {
        self.gains.len()
    }

    /// The covariance of the noise, if it is not white.
    pub fn shape(&self) -> Option<&NoiseShape> {
        self.shape.as_ref()
    }

    /// The gains and spreads of each window on a device. Windows without fixed frames have gains of zero.
    ///
    /// # Shapes
    /// `is_start` `[B]`; the results `[B, W, 2]` and `[B, W, 1]`.
    fn tables(&self, is_start: &[bool], device: &Device) -> (Tensor<3>, Tensor<3>) {
        let (rows, window) = (is_start.len(), self.window());
        let gains: Vec<f32> = is_start
            .iter()
            .flat_map(|is_start| {
                let used = if *is_start { 0.0 } else { 1.0 };
                self.gains
                    .as_flattened()
                    .iter()
                    .map(move |gain| used * gain)
            })
            .collect();
        let spreads: Vec<f32> = is_start
            .iter()
            .flat_map(|is_start| {
                if *is_start {
                    &self.start_spreads
                } else {
                    &self.spreads
                }
            })
            .copied()
            .collect();
        (
            send(gains, [rows, window, FIXED_FRAMES], device),
            send(spreads, [rows, window, 1], device),
        )
    }
}

/// What a prediction is relative to, besides the noisy window.
#[derive(Clone, Debug)]
pub struct Basis {
    /// Normalised original windows, `[B, W, D]`.
    pub(crate) original: Tensor<3>,
    /// Gains and spreads of the linear guess, for predictions that are relative to one.
    tables: Option<(Tensor<3>, Tensor<3>)>,
    /// Standardisation for shaped noise; none for white noise.
    pub(crate) shaped: Option<ShapedBasis>,
}

/// For shaped noise: mean and scale of bones, and standard deviation of the noise.
#[derive(Clone, Debug)]
pub(crate) struct ShapedBasis {
    /// Mean of each bone coordinate of edited windows, `[1, 1, D]`.
    mean: Tensor<3>,
    /// Inverse of the coordinate's standard deviation, `[1, 1, D]`.
    scale: Tensor<3>,
    /// Standard deviation of the noise, `[B, W, D]`.
    pub(crate) spreads: Tensor<3>,
}

impl Basis {
    /// Builds the basis from normalised original windows, `[B, W, D]`. `is_start` marks windows without fixed frames,
    /// `[B]`. `extrapolation` is required for predictions relative to a linear guess.
    pub fn new(
        original: Tensor<3>,
        is_start: &[bool],
        extrapolation: Option<&Extrapolation>,
    ) -> Self {
        let device = original.device();
        let [_, window, width] = original.dims();
        let shape = extrapolation.and_then(Extrapolation::shape);
        Self {
            tables: extrapolation.map(|guess| guess.tables(is_start, &device)),
            shaped: shape.map(|shape| {
                let row = |values: Vec<f32>| send(values, [1, 1, width], &device);
                let (mean, scale) = shape.standard(width);
                let spreads = [false, true].map(|is_start| shape.spreads(width, is_start));
                let of_rows: Vec<f32> = is_start
                    .iter()
                    .flat_map(|&is_start| spreads[usize::from(is_start)].iter().copied())
                    .collect();
                ShapedBasis {
                    mean: row(mean),
                    scale: row(scale),
                    spreads: send(of_rows, [is_start.len(), window, width], &device),
                }
            }),
            original,
        }
    }

    /// Windows as the network sees them. With shaped noise these are bones, standardised so that a leg's movement is as
    /// visible as the path of the root; otherwise the windows are unchanged.
    ///
    /// # Shapes
    /// `[B, W, D]`; `B` may differ from the batch of the originals.
    pub fn seen(&self, windows: Tensor<3>) -> Tensor<3> {
        let Some(ShapedBasis { mean, scale, .. }) = &self.shaped else {
            return windows;
        };
        let [_, _, width] = windows.dims();
        let [to_bones, _] = bones(width / 3, &windows.device());
        (mapped(windows, to_bones) - mean.clone()) * scale.clone()
    }

    /// Mean of the shaped noise: the original plus the guessed change, for windows whose fixed frames are clean. `None`
    /// for white noise, whose mean is zero.
    pub fn centre(&self, windows: &Tensor<3>) -> Option<Tensor<3>> {
        self.shaped
            .as_ref()
            .map(|_| self.original.clone() + self.guess(windows).0)
    }

    /// The guessed change and the standard deviation of its residual, for windows whose fixed frames are clean.
    pub(crate) fn guess(&self, windows: &Tensor<3>) -> (Tensor<3>, Tensor<3>) {
        let fixed = |x: &Tensor<3>| x.clone().narrow(1, 0, FIXED_FRAMES);
        let change = fixed(windows) - fixed(&self.original);
        let (gains, spreads) = self
            .tables
            .clone()
            .expect("a residual comes with what it is relative to");
        // Two products and a sum; a matrix product of this size is mostly overhead.
        let part =
            |frame: usize| gains.clone().narrow(2, frame, 1) * change.clone().narrow(1, frame, 1);
        (part(0) + part(1), spreads)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transfer::read;

    #[test]
    fn a_change_that_goes_on_as_it_began_leaves_no_residual() {
        const WINDOW: usize = 6;
        let mut rng = datasets_spec::Seed(3).rng(&["lines"]);
        let mut normal = || rand::RngExt::sample::<f32, _>(&mut rng, rand_distr::StandardNormal);
        let numbers = 64 * WINDOW * FRAME_WIDTH;
        let original: Vec<f32> = (0..numbers).map(|_| normal()).collect();
        // The change of each number is linear over the frames.
        let lines: Vec<[f32; 2]> = (0..64 * FRAME_WIDTH)
            .map(|_| [normal(), normal()])
            .collect();
        let edited: Vec<f32> = original
            .iter()
            .enumerate()
            .map(|(at, value)| {
                let (row, channel) = (at / (WINDOW * FRAME_WIDTH), at % FRAME_WIDTH);
                let frame = at / FRAME_WIDTH % WINDOW;
                let [height, slope] = lines[row * FRAME_WIDTH + channel];
                value + height + slope * frame as f32
            })
            .collect();
        let fitted = Extrapolation::fit(&original, &edited, WINDOW, 0.0, NoiseKind::White);
        for (frame, [first, second]) in fitted.gains.iter().enumerate() {
            // For a line through frames 0 and 1, the weights in frame f are 1 - f and f. The ridge changes them by a
            // few millionths.
            assert!(
                (first - (1.0 - frame as f32)).abs() < 1e-3,
                "{frame}: {first}"
            );
            assert!((second - frame as f32).abs() < 1e-3, "{frame}: {second}");
        }
        for (spread, [first, second]) in fitted.spreads.iter().zip(&fitted.gains) {
            // The residual is due to the ridge alone, scaled by the gains.
            let seen = f64::from(first.hypot(*second)).max(1.0) * LEAST_SPREAD;
            assert!(f64::from(*spread) < 1.01 * seen, "{spread} {seen}");
        }
        // Without fixed frames nothing is predicted, so the spread is that of the change itself.
        assert!((fitted.start_spreads[0] - 1.0).abs() < 0.05);

        let windows = |values: &[f32]| {
            let count = values.len() / (WINDOW * FRAME_WIDTH);
            send(
                values.to_vec(),
                [count, WINDOW, FRAME_WIDTH],
                &Device::flex(),
            )
        };
        let x0 = windows(&edited);
        let basis = Basis::new(windows(&original), &[false; 64], Some(&fitted));
        let (guess, _) = basis.guess(&x0);
        let back = windows(&original) + guess;
        for (a, b) in edited.iter().zip(read(back)) {
            // The tolerance covers slopes of up to 4 over 5 frames, times a few millionths from the ridge.
            assert!((a - b).abs() < 0.02, "{a} {b}");
        }
    }
}
