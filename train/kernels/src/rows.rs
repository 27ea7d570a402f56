//! Operations on rows of numbers: dropout, GELU and layer norm, with their gradients.

use kinematics::simd::lanes::{Kernel, LANES, dispatch};
use rayon::prelude::*;

/// Number of rows per task. It is fixed, so that sums over rows do not depend on the number of threads.
const TASK_ROWS: usize = 16;

/// Constant that LayerNorm adds to the variance (PyTorch's default).
const EPSILON: f32 = 1e-5;

/// A dropout mask. Whether it drops a number depends only on the key and the number's index, so the mask need not be
/// stored for the backward pass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mask {
    /// Smallest 24-bit hash of a kept number.
    threshold: i32,
    /// Factor of the numbers that dropout keeps.
    scale: f32,
    key: [u32; 2],
}

impl Mask {
    /// A mask that drops a number with probability `prob`.
    pub fn new(prob: f64, key: u64) -> Self {
        Self {
            threshold: (prob * f64::from(1u32 << 24)).round() as i32,
            scale: (1.0 / (1.0 - prob)) as f32,
            key: [key as u32, (key >> 32) as u32],
        }
    }

    /// Whether anything is dropped.
    pub fn is_active(self) -> bool {
        self.threshold > 0
    }

    /// The factor of the number at `index`: 0 or the scale.
    ///
    /// # Source
    /// The hash rounds are those of Chris Wellons' `lowbias32`; the key is mixed in before and between them.
    #[inline(always)]
    pub fn factor(self, index: u32) -> f32 {
        let mut hash = index ^ self.key[0];
        hash = (hash ^ (hash >> 16)).wrapping_mul(0x7feb_352d);
        hash = (hash ^ self.key[1] ^ (hash >> 15)).wrapping_mul(0x846c_a68b);
        hash ^= hash >> 16;
        if (hash >> 8) as i32 >= self.threshold {
            self.scale
        } else {
            0.0
        }
    }
}

/// The factors of the first `count` numbers.
pub fn factors(mask: Mask, count: usize) -> Vec<f32> {
    struct Part<'a> {
        mask: Mask,
        first: usize,
        out: &'a mut [f32],
    }
    impl Kernel for Part<'_> {
        type Output = ();

        #[inline(always)]
        fn run(self) {
            for (index, out) in self.out.iter_mut().enumerate() {
                *out = self.mask.factor((self.first + index) as u32);
            }
        }
    }
    const PART: usize = 1 << 14;
    let mut factors = vec![0.0; count];
    let parts = factors.par_chunks_mut(PART).enumerate();
    parts.for_each(|(part, out)| {
        let first = part * PART;
        dispatch(Part { mask, first, out });
    });
    factors
}

/// e^x in a form that vectorises, with a relative error below 2e-7.
#[inline(always)]
pub(crate) fn exp(x: f32) -> f32 {
    /// Adding and subtracting this constant rounds to an integer. The last bits of the sum hold that integer.
    const SHIFT: f32 = 12_582_912.0;
    const LN_2: [f32; 2] = [0.693_359_4, -2.121_944_4e-4];
    // Below -87 the result is not a normal number; 88 is the largest exponent.
    let x = x.clamp(-87.0, 88.0);
    let shifted = x * std::f32::consts::LOG2_E + SHIFT;
    let power = shifted - SHIFT;
    let rest = (x - power * LN_2[0]) - power * LN_2[1];
    // The polynomial of Cephes' expf.
    let mut series = 1.987_569_1e-4;
    for coefficient in [1.398_2e-3, 8.333_452e-3, 4.166_579_6e-2, 0.166_666_65, 0.5] {
        series = series * rest + coefficient;
    }
    let series = series * rest * rest + rest + 1.0;
    series * f32::from_bits((shifted.to_bits() << 23).wrapping_add(127 << 23))
}

/// The exact GELU of a number and its derivative. The error of both is below 1e-6.
///
/// # Source
/// Abramowitz and Stegun 1964, formula 7.1.26, whose exponential is also the density in the derivative.
#[inline(always)]
fn gelu(x: f32) -> (f32, f32) {
    const DENSITY: f32 = 0.398_942_3;
    let bell = exp(-0.5 * x * x);
    let t = 1.0 / (1.0 + 0.327_591_1 * std::f32::consts::FRAC_1_SQRT_2 * x.abs());
    let mut series = 1.061_405_4;
    for coefficient in [-1.453_152, 1.421_413_7, -0.284_496_74, 0.254_829_6] {
        series = series * t + coefficient;
    }
    let tail = 0.5 * series * t * bell;
    let below = if x < 0.0 { tail } else { 1.0 - tail };
    (x * below, below + x * DENSITY * bell)
}

#[inline(always)]
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut sums = [0.0f32; LANES];
    let (a, a_rest) = a.as_chunks::<LANES>();
    let (b, b_rest) = b.as_chunks::<LANES>();
    for (a, b) in a.iter().zip(b) {
        for lane in 0..LANES {
            sums[lane] += a[lane] * b[lane];
        }
    }
    for (lane, (a, b)) in a_rest.iter().zip(b_rest).enumerate() {
        sums[lane] += a * b;
    }
    halved(sums, |a, b| a + b)
}

/// Joins lanes pairwise: each lane of the first half with one of the second, until one is left.
#[inline(always)]
pub(crate) fn halved(mut lanes: [f32; LANES], join: impl Fn(f32, f32) -> f32) -> f32 {
    let mut half = LANES / 2;
    while half > 0 {
        for lane in 0..half {
            lanes[lane] = join(lanes[lane], lanes[lane + half]);
        }
        half /= 2;
    }
    lanes[0]
}

#[inline(always)]
fn add_scaled(to: &mut [f32], factor: f32, row: &[f32]) {
    for (to, value) in to.iter_mut().zip(row) {
        *to += factor * value;
    }
}

/// Adds a bias to rows.
pub fn add_bias(rows: &mut [f32], bias: &[f32]) {
    rows.par_chunks_mut(TASK_ROWS * bias.len())
        .for_each(|rows| {
            for row in rows.chunks_exact_mut(bias.len()) {
                for (value, bias) in row.iter_mut().zip(bias) {
                    *value += bias;
                }
            }
        });
}

/// The sum of each column.
pub fn column_sums(rows: &[f32], width: usize) -> Vec<f32> {
    let parts: Vec<Vec<f32>> = rows
        .par_chunks(TASK_ROWS * width)
        .map(|rows| {
            let mut sums = vec![0.0; width];
            for row in rows.chunks_exact(width) {
                add_scaled(&mut sums, 1.0, row);
            }
            sums
        })
        .collect();
    total(parts, width)
}

/// Adds up partial sums in order.
fn total(parts: Vec<Vec<f32>>, width: usize) -> Vec<f32> {
    let mut parts = parts.into_iter();
    let mut sums = parts.next().unwrap_or_else(|| vec![0.0; width]);
    for part in parts {
        add_scaled(&mut sums, 1.0, &part);
    }
    sums
}

/// `out = dropout(gelu(hidden + bias))`. With `derivatives`, `hidden` is replaced by the derivative of this function,
/// which is all that the backward pass needs.
pub fn gelu_dropout(
    hidden: &mut [f32],
    bias: &[f32],
    mask: Mask,
    derivatives: bool,
    out: &mut [f32],
) {
    struct Rows<'a> {
        hidden: &'a mut [f32],
        out: &'a mut [f32],
        bias: &'a [f32],
        mask: Mask,
        derivatives: bool,
        first: usize,
    }
    impl Kernel for Rows<'_> {
        type Output = ();

        #[inline(always)]
        fn run(self) {
            let width = self.bias.len();
            let rows = self.hidden.chunks_exact_mut(width);
            let outs = self.out.chunks_exact_mut(width);
            for (row, (hidden, out)) in rows.zip(outs).enumerate() {
                let first = (self.first + row * width) as u32;
                let columns = hidden.iter_mut().zip(out).zip(self.bias);
                if self.mask.is_active() {
                    for (column, ((hidden, out), bias)) in columns.enumerate() {
                        let factor = self.mask.factor(first.wrapping_add(column as u32));
                        let (value, derivative) = gelu(*hidden + bias);
                        *out = value * factor;
                        *hidden = derivative * factor;
                    }
                } else if self.derivatives {
                    for ((hidden, out), bias) in columns {
                        (*out, *hidden) = gelu(*hidden + bias);
                    }
                } else {
                    for ((hidden, out), bias) in columns {
                        *out = gelu(*hidden + bias).0;
                    }
                }
            }
        }
    }
    let task = TASK_ROWS * bias.len();
    hidden
        .par_chunks_mut(task)
        .zip(out.par_chunks_mut(task))
        .enumerate()
        .for_each(|(index, (hidden, out))| {
            dispatch(Rows {
                hidden,
                out,
                bias,
                mask,
                derivatives,
                first: index * task,
            });
        });
}

/// Multiplies a gradient by recorded derivatives; returns the sums of its columns.
pub fn times_derivatives(grad: &mut [f32], derivatives: &[f32], width: usize) -> Vec<f32> {
    let task = TASK_ROWS * width;
    let parts: Vec<Vec<f32>> = grad
        .par_chunks_mut(task)
        .zip(derivatives.par_chunks(task))
        .map(|(grad, derivatives)| {
            let mut sums = vec![0.0; width];
            let rows = grad.chunks_exact_mut(width);
            for (grad, derivatives) in rows.zip(derivatives.chunks_exact(width)) {
                for ((grad, derivative), sum) in grad.iter_mut().zip(derivatives).zip(&mut sums) {
                    *grad *= derivative;
                    *sum += *grad;
                }
            }
            sums
        })
        .collect();
    total(parts, width)
}

/// Parameters of a layer norm.
#[derive(Clone, Copy, Debug)]
pub struct Norm<'a> {
    /// Factors of the normalised values.
    pub gamma: &'a [f32],
    /// Added after the scaling by gamma.
    pub beta: &'a [f32],
}

/// `out = norm(residual + dropout(branch + bias))`. `branch` is replaced by the normalised rows before gamma and beta;
/// the inverse standard deviations of the rows are returned. The backward pass needs both.
pub fn residual_norm(
    branch: &mut [f32],
    bias: &[f32],
    residual: &[f32],
    norm: Norm<'_>,
    mask: Mask,
    out: &mut [f32],
) -> Vec<f32> {
    struct Rows<'a> {
        branch: &'a mut [f32],
        residual: &'a [f32],
        out: &'a mut [f32],
        scales: &'a mut [f32],
        bias: &'a [f32],
        norm: Norm<'a>,
        mask: Mask,
        first: usize,
    }
    impl Kernel for Rows<'_> {
        type Output = ();

        #[inline(always)]
        fn run(self) {
            let width = self.bias.len();
            let rows = self.branch.chunks_exact_mut(width);
            let outs = self.out.chunks_exact_mut(width);
            let residuals = self.residual.chunks_exact(width);
            let rows = rows.zip(residuals).zip(outs).zip(self.scales);
            for (row, (((x, residual), out), scale)) in rows.enumerate() {
                let first = (self.first + row * width) as u32;
                if self.mask.is_active() {
                    let columns = x.iter_mut().zip(residual).zip(self.bias).enumerate();
                    for (column, ((x, residual), bias)) in columns {
                        let factor = self.mask.factor(first.wrapping_add(column as u32));
                        *x = residual + (*x + bias) * factor;
                    }
                } else {
                    for ((x, residual), bias) in x.iter_mut().zip(residual).zip(self.bias) {
                        *x = residual + (*x + bias);
                    }
                }
                let mean = sum(x) / width as f32;
                for x in x.iter_mut() {
                    *x -= mean;
                }
                *scale = 1.0 / (dot(x, x) / width as f32 + EPSILON).sqrt();
                let columns = x.iter_mut().zip(out).zip(self.norm.gamma);
                for (((x, out), gamma), beta) in columns.zip(self.norm.beta) {
                    *x *= *scale;
                    *out = *x * gamma + beta;
                }
            }
        }
    }
    let width = bias.len();
    let mut scales = vec![0.0; branch.len() / width];
    let task = TASK_ROWS * width;
    branch
        .par_chunks_mut(task)
        .zip(residual.par_chunks(task))
        .zip(out.par_chunks_mut(task))
        .zip(scales.par_chunks_mut(TASK_ROWS))
        .enumerate()
        .for_each(|(index, (((branch, residual), out), scales))| {
            dispatch(Rows {
                branch,
                residual,
                out,
                scales,
                bias,
                norm,
                mask,
                first: index * task,
            });
        });
    scales
}

#[inline(always)]
fn sum(row: &[f32]) -> f32 {
    let mut sums = [0.0f32; LANES];
    let (chunks, rest) = row.as_chunks::<LANES>();
    for chunk in chunks {
        for lane in 0..LANES {
            sums[lane] += chunk[lane];
        }
    }
    sums.iter().sum::<f32>() + rest.iter().sum::<f32>()
}

/// Gradients of the parameters of [`residual_norm`].
#[derive(Clone, Debug)]
pub struct NormGrads {
    /// Gradient of gamma.
    pub gamma: Vec<f32>,
    /// Gradient of beta.
    pub beta: Vec<f32>,
    /// Gradient of the branch's bias.
    pub bias: Vec<f32>,
}

struct NormGradRows<'a> {
    grad: &'a mut [f32],
    normalised: &'a [f32],
    scales: &'a [f32],
    gamma: &'a [f32],
    mask: Mask,
    branch: &'a mut [f32],
    first: usize,
}

impl Kernel for NormGradRows<'_> {
    type Output = [Vec<f32>; 3];

    #[inline(always)]
    fn run(self) -> Self::Output {
        let width = self.gamma.len();
        let mut sums = [vec![0.0; width], vec![0.0; width], vec![0.0; width]];
        let [of_gamma, of_beta, of_bias] = &mut sums;
        let rows = self.grad.chunks_exact_mut(width);
        let rows = rows
            .zip(self.normalised.chunks_exact(width))
            .zip(self.scales);
        for (row, ((grad, x), scale)) in rows.enumerate() {
            let columns = grad.iter_mut().zip(x).zip(self.gamma);
            for (((grad, x), gamma), (of_gamma, of_beta)) in
                columns.zip(of_gamma.iter_mut().zip(of_beta.iter_mut()))
            {
                *of_gamma += *grad * x;
                *of_beta += *grad;
                *grad *= gamma;
            }
            let mean = sum(grad) / width as f32;
            let along = dot(grad, x) / width as f32;
            for (grad, x) in grad.iter_mut().zip(x) {
                *grad = (*grad - mean - x * along) * scale;
            }
            if self.mask.is_active() {
                let first = (self.first + row * width) as u32;
                let branch = &mut self.branch[row * width..][..width];
                let columns = branch.iter_mut().zip(&*grad).zip(&mut *of_bias);
                for (column, ((branch, grad), of_bias)) in columns.enumerate() {
                    *branch = grad * self.mask.factor(first.wrapping_add(column as u32));
                    *of_bias += *branch;
                }
            } else {
                add_scaled(of_bias, 1.0, grad);
            }
        }
        sums
    }
}

/// The backward pass of [`residual_norm`]: `grad`, the gradient of `out`, becomes the gradient of the residual, and
/// `branch` that of the branch. Without dropout the two are equal, and `branch` is not written.
pub fn residual_norm_backward(
    grad: &mut [f32],
    normalised: &[f32],
    scales: &[f32],
    gamma: &[f32],
    mask: Mask,
    branch: &mut [f32],
) -> NormGrads {
    let width = gamma.len();
    let task = TASK_ROWS * width;
    let branches: Vec<&mut [f32]> = if mask.is_active() {
        branch.chunks_mut(task).collect()
    } else {
        grad.chunks(task).map(|_| Default::default()).collect()
    };
    let parts: Vec<[Vec<f32>; 3]> = grad
        .par_chunks_mut(task)
        .zip(normalised.par_chunks(task))
        .zip(scales.par_chunks(TASK_ROWS))
        .zip(branches)
        .enumerate()
        .map(|(index, (((grad, normalised), scales), branch))| {
            dispatch(NormGradRows {
                grad,
                normalised,
                scales,
                gamma,
                mask,
                branch,
                first: index * task,
            })
        })
        .collect();
    let mut columns: [Vec<Vec<f32>>; 3] = Default::default();
    for part in parts {
        for (columns, part) in columns.iter_mut().zip(part) {
            columns.push(part);
        }
    }
    let [gamma, beta, bias] = columns.map(|parts| total(parts, width));
    NormGrads { gamma, beta, bias }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponentials_are_those_of_the_library() {
        for step in -8_700..=8_700 {
            let x = step as f32 * 0.01;
            assert!((exp(x) / x.exp() - 1.0).abs() < 4e-7, "{x}");
        }
    }

    #[test]
    fn gelu_and_its_derivative_match_a_sum_of_the_bell_curve() {
        // Integrates the normal density with the trapezoidal rule, in double precision.
        let bell = |x: f64| (-0.5 * x * x).exp() / (2.0 * std::f64::consts::PI).sqrt();
        let step = 1e-4;
        let (mut below, mut x) = (0.0f64, -9.0f64);
        for index in 0..180_000 {
            below += 0.5 * step * (bell(x) + bell(x + step));
            x = -9.0 + f64::from(index + 1) * step;
            if index % 97 == 0 {
                let (value, derivative) = gelu(x as f32);
                let wrong = f64::from(derivative) - below - x * bell(x);
                assert!((f64::from(value) - x * below).abs() < 1e-6, "{x}");
                assert!(wrong.abs() < 1e-6, "{x}");
            }
        }
    }

    #[test]
    fn masks_follow_from_the_key_and_keep_the_share() {
        let draw = |key: u64| -> Vec<f32> {
            let mask = Mask::new(0.1, key);
            (0..100_000).map(|index| mask.factor(index)).collect()
        };
        let first = draw(7);
        assert_eq!(first, draw(7));
        let kept = |mask: &[f32]| mask.iter().filter(|&&factor| factor > 0.0).count();
        for key in [7, 8, 1 << 32, 7 << 32 | 9] {
            let mask = draw(key);
            let is_factor = |f: &f32| *f == 0.0 || (f - 1.0 / 0.9).abs() < 1e-6;
            assert!(mask.iter().all(is_factor));
            // The tolerance is five standard deviations of the number of kept values.
            assert!((kept(&mask) as f64 - 90_000.0).abs() < 5.0 * 95.0, "{key}");
            if key != 7 {
                // Independent masks agree at a share of 0.9^2 + 0.1^2 of the positions.
                let equal = mask.iter().zip(&first).filter(|(a, b)| a == b).count() as f64;
                assert!((equal - 82_000.0).abs() < 5.0 * 122.0, "{key} {equal}");
            }
        }
        // Neighbours are dropped together as often as independent values would be.
        let pairs = first.windows(2).filter(|pair| pair[0] + pair[1] == 0.0);
        let pairs = pairs.count() as f64;
        assert!((pairs - 1_000.0).abs() < 5.0 * 35.0, "{pairs}");
    }
}
