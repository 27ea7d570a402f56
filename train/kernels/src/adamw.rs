//! AdamW in one pass over memory.
//!
//! A step composed of tensor operations reads or writes fifteen arrays of the model's size, which fit into no cache.
//! That takes a tenth of a training step.

use kinematics::simd::lanes::{Kernel, dispatch};
use rayon::prelude::*;

/// Decay rates of the running means of gradients and of squared gradients (PyTorch's defaults).
pub const BETAS: [f32; 2] = [0.9, 0.999];
/// Added to the square root of the second mean (PyTorch's default).
pub const EPSILON: f32 = 1e-8;

/// Number of values that one task updates.
const PART: usize = 1 << 14;

/// Factors of one step.
#[derive(Clone, Copy, Debug)]
pub struct Factors {
    /// Bias corrections of the two running means.
    corrections: [f32; 2],
    /// Share of each weight that weight decay keeps.
    kept: f32,
    rate: f32,
}

impl Factors {
    /// The factors of step `time`, counted from 1.
    pub fn new(rate: f64, weight_decay: f32, time: i32) -> Self {
        Self {
            corrections: BETAS.map(|beta| 1.0 - beta.powi(time)),
            kept: (1.0 - rate * f64::from(weight_decay)) as f32,
            rate: rate as f32,
        }
    }
}

/// Updates the weights, and the running means of their gradients and squared gradients.
///
/// # Source
/// Loshchilov and Hutter 2019, algorithm 2.
pub fn step(
    values: &mut [f32],
    gradients: &[f32],
    first: &mut [f32],
    second: &mut [f32],
    factors: Factors,
) {
    values
        .par_chunks_mut(PART)
        .zip(gradients.par_chunks(PART))
        .zip(first.par_chunks_mut(PART))
        .zip(second.par_chunks_mut(PART))
        .for_each(|(((values, gradients), first), second)| {
            dispatch(Step {
                values,
                gradients,
                first,
                second,
                factors,
            });
        });
}

struct Step<'a> {
    values: &'a mut [f32],
    gradients: &'a [f32],
    first: &'a mut [f32],
    second: &'a mut [f32],
    factors: Factors,
}

impl Kernel for Step<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Factors {
            corrections,
            kept,
            rate,
        } = self.factors;
        let moments = self.first.iter_mut().zip(self.second);
        let numbers = self.values.iter_mut().zip(self.gradients);
        for ((value, gradient), (first, second)) in numbers.zip(moments) {
            *first = *first * BETAS[0] + gradient * (1.0 - BETAS[0]);
            *second = *second * BETAS[1] + gradient * gradient * (1.0 - BETAS[1]);
            let step = (*first / corrections[0]) / ((*second / corrections[1]).sqrt() + EPSILON);
            *value = *value * kept - step * rate;
        }
    }
}
