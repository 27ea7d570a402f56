//! Self-attention of long sequences by whole-matrix products: one job for each head of each sequence.

use kinematics::simd::lanes::{Kernel, LANES, dispatch};
use rayon::prelude::*;

use crate::heads::{Heads, soften};
use crate::product::{Matrix, columns, multiply_alone};
use crate::rows::Mask;

/// Queries, keys or values (`part` 0, 1 or 2) of one head. `place` is the head's index among the heads of all
/// sequences.
fn part<'a>(heads: Heads<'_>, joint: &'a [f32], place: usize, part: usize) -> Matrix<'a> {
    let (length, width, count) = (heads.length, heads.width, heads.count);
    let (sequence, at) = (place / count, place % count);
    let size = 3 * length * width;
    let joint = &joint[sequence * size..][..size];
    columns(
        joint,
        3 * width,
        part * width + at * heads.head(),
        heads.head(),
    )
}

pub(crate) fn forward(
    heads: Heads<'_>,
    joint: &[f32],
    mask: Mask,
    weights: &mut [f32],
    out: &mut [f32],
) {
    let Heads { length, count, .. } = heads;
    let (head, pairs) = (heads.head(), length * length);
    let mut attended = vec![0.0; out.len()];
    weights
        .par_chunks_mut(pairs)
        .zip(attended.par_chunks_mut(length * head))
        .enumerate()
        .for_each(|(place, (weights, attended))| {
            let part = |index| part(heads, joint, place, index);
            multiply_alone(part(0), part(1).transpose(), weights);
            let dropped = dispatch(Soften {
                length,
                scale: heads.scale(),
                padding: heads.padding_of(place / count),
                mask,
                first: place * pairs,
                weights,
            });
            let weights = dropped.as_deref().unwrap_or(weights);
            multiply_alone(columns(weights, length, 0, length), part(2), attended);
        });
    join(heads, &attended, head, out, |at| at * head);
}

pub(crate) fn backward(
    heads: Heads<'_>,
    joint: &[f32],
    mask: Mask,
    weights: &[f32],
    grad: &[f32],
) -> Vec<f32> {
    let (length, width, count) = (heads.length, heads.width, heads.count);
    let (head, pairs, size) = (heads.head(), length * length, length * width);
    // Gradients of queries, keys and values of every head.
    let mut of_parts = [0, 1, 2].map(|_| vec![0.0; grad.len()]);
    let [of_queries, of_keys, of_values] = &mut of_parts;
    weights
        .par_chunks(pairs)
        .zip(of_queries.par_chunks_mut(length * head))
        .zip(of_keys.par_chunks_mut(length * head))
        .zip(of_values.par_chunks_mut(length * head))
        .enumerate()
        .for_each(|(place, (((weights, of_queries), of_keys), of_values))| {
            let part = |index| part(heads, joint, place, index);
            let grad = &grad[place / count * size..][..size];
            let grad = columns(grad, width, place % count * head, head);
            let mut of_scores = vec![0.0; pairs];
            multiply_alone(grad, part(2).transpose(), &mut of_scores);
            let dropped = dispatch(Differentiate {
                length,
                scale: heads.scale(),
                mask,
                first: place * pairs,
                weights,
                of_scores: &mut of_scores,
            });
            let square = |values| columns(values, length, 0, length);
            let dropped = dropped.as_deref().unwrap_or(weights);
            multiply_alone(square(&of_scores), part(1), of_queries);
            multiply_alone(square(&of_scores).transpose(), part(0), of_keys);
            multiply_alone(square(dropped).transpose(), grad, of_values);
        });
    let mut of_joint = vec![0.0; joint.len()];
    for (index, of_part) in of_parts.iter().enumerate() {
        join(heads, of_part, head, &mut of_joint, |at| {
            index * width + at * head
        });
    }
    of_joint
}

/// Copies the rows of every head, `[B, heads, T, head]`, into the rows of all heads, `[B, T, ..]`; each head has its
/// own columns.
fn join(
    heads: Heads<'_>,
    parts: &[f32],
    head: usize,
    out: &mut [f32],
    column: impl Fn(usize) -> usize + Sync,
) {
    let (length, width, count) = (heads.length, heads.width, heads.count);
    let stride = out.len() / (parts.len() / width);
    out.par_chunks_mut(stride)
        .enumerate()
        .for_each(|(row, out)| {
            let (sequence, token) = (row / length, row % length);
            for at in 0..count {
                let from = ((sequence * count + at) * length + token) * head;
                out[column(at)..][..head].copy_from_slice(&parts[from..][..head]);
            }
        });
}

/// Replaces the scores of a head by their softmax. Returns a copy of the weights with dropout applied; none without
/// dropout.
struct Soften<'a> {
    length: usize,
    scale: f32,
    padding: Option<&'a [bool]>,
    mask: Mask,
    /// Index of this head's first weight in the array of all heads.
    first: usize,
    weights: &'a mut [f32],
}

impl Kernel for Soften<'_> {
    type Output = Option<Vec<f32>>;

    #[inline(always)]
    fn run(self) -> Option<Vec<f32>> {
        let length = self.length;
        let mut whole = vec![0.0; length.next_multiple_of(LANES)];
        for weights in self.weights.chunks_exact_mut(length) {
            whole[..length].copy_from_slice(weights);
            soften(&mut whole, length, self.scale, self.padding);
            weights.copy_from_slice(&whole[..length]);
        }
        if !self.mask.is_active() {
            return None;
        }
        let mut dropped = self.weights.to_vec();
        for (index, weight) in dropped.iter_mut().enumerate() {
            *weight *= self.mask.factor((self.first + index) as u32);
        }
        Some(dropped)
    }
}

/// Replaces gradients of a head's weights after dropout by gradients of its scores, in place. Returns the weights after
/// dropout; none without dropout.
struct Differentiate<'a> {
    length: usize,
    scale: f32,
    mask: Mask,
    first: usize,
    weights: &'a [f32],
    of_scores: &'a mut [f32],
}

impl Kernel for Differentiate<'_> {
    type Output = Option<Vec<f32>>;

    #[inline(always)]
    fn run(self) -> Option<Vec<f32>> {
        let dropped = self.mask.is_active().then(|| {
            let mut dropped = self.weights.to_vec();
            let both = dropped.iter_mut().zip(self.of_scores.iter_mut());
            for (index, (weight, of_weight)) in both.enumerate() {
                let factor = self.mask.factor((self.first + index) as u32);
                *weight *= factor;
                *of_weight *= factor;
            }
            dropped
        });
        let rows = self.of_scores.chunks_exact_mut(self.length);
        for (of_scores, weights) in rows.zip(self.weights.chunks_exact(self.length)) {
            let along = dot(of_scores, weights);
            for (of_score, weight) in of_scores.iter_mut().zip(weights) {
                *of_score = self.scale * weight * (*of_score - along);
            }
        }
        dropped
    }
}

/// Dot product, summed lane by lane.
#[inline(always)]
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let (a_blocks, a_rest) = a.as_chunks::<LANES>();
    let (b_blocks, b_rest) = b.as_chunks::<LANES>();
    let mut lanes = [0.0f32; LANES];
    for (a, b) in a_blocks.iter().zip(b_blocks) {
        for ((lane, a), b) in lanes.iter_mut().zip(a).zip(b) {
            *lane += a * b;
        }
    }
    let rest = a_rest.iter().zip(b_rest).map(|(a, b)| a * b);
    lanes.iter().sum::<f32>() + rest.sum::<f32>()
}
