//! Sizes of an attention layer, and the softmax of attention scores.

use kinematics::simd::lanes::LANES;

use crate::rows::{exp, halved};

/// Sizes of an attention layer.
#[derive(Clone, Copy, Debug)]
pub struct Heads<'a> {
    /// Number of tokens in a sequence.
    pub length: usize,
    /// Width of a token.
    pub width: usize,
    /// Number of heads.
    pub count: usize,
    /// True where a token is padding, `[B, T]`.
    pub padding: Option<&'a [bool]>,
}

impl Heads<'_> {
    pub(crate) fn head(&self) -> usize {
        self.width / self.count
    }

    pub(crate) fn weights(&self) -> usize {
        self.count * self.length * self.length
    }

    pub(crate) fn scale(&self) -> f32 {
        (self.head() as f32).sqrt().recip()
    }

    pub(crate) fn padding_of(&self, sequence: usize) -> Option<&[bool]> {
        self.padding
            .map(|padding| &padding[sequence * self.length..][..self.length])
    }
}

/// Reduces `values` with `join`: lane by lane over the blocks, then the lanes pairwise. The number of values is a
/// multiple of [`LANES`].
#[inline(always)]
fn by_halves(values: &[f32], start: f32, join: impl Fn(f32, f32) -> f32) -> f32 {
    let mut lanes = [start; LANES];
    for block in values.as_chunks::<LANES>().0 {
        for (lane, &value) in lanes.iter_mut().zip(block) {
            *lane = join(*lane, value);
        }
    }
    halved(lanes, join)
}

/// Softmax weights below this share of the largest become zero: even hundreds of them are below the rounding error of
/// the sum. Multiplied by a gradient, they could be subnormal, which makes a matrix product ten times slower.
const LEAST_SHARE: f32 = 1e-10;

/// Replaces the attention scores of one query by their softmax. The first `length` numbers are scores; the rest only
/// fill the last block. Padding tokens get weight zero, and so do weights below [`LEAST_SHARE`].
#[inline(always)]
pub(crate) fn soften(scores: &mut [f32], length: usize, scale: f32, padding: Option<&[bool]>) {
    // Columns beyond the keys count as padding, so that all blocks are whole.
    scores[length..].fill(f32::NEG_INFINITY);
    for (key, score) in scores[..length].iter_mut().enumerate() {
        *score *= scale;
        if padding.is_some_and(|padding| padding[key]) {
            *score = f32::NEG_INFINITY;
        }
    }
    let largest = by_halves(scores, f32::NEG_INFINITY, f32::max);
    for score in scores.iter_mut() {
        let share = exp(*score - largest);
        *score = if share < LEAST_SHARE { 0.0 } else { share };
    }
    let scale = by_halves(scores, 0.0, |a, b| a + b).recip();
    for score in scores.iter_mut() {
        *score *= scale;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_that_no_sum_shows_are_zero() {
        let mut scores = [0.0; LANES];
        scores[..4].copy_from_slice(&[100.0, 98.0, 76.0, 40.0]);
        soften(&mut scores, 4, 1.0, None);
        let total = 1.0 + (-2.0f32).exp();
        assert!(
            (scores[0] - 1.0 / total).abs() < 1e-6
                && (scores[1] - (-2.0f32).exp() / total).abs() < 1e-6
        );
        assert_eq!(scores[2..], [0.0; LANES - 2]);
    }
}
