//! Self-attention, computed from the joint projection of queries, keys and values. This module computes short
//! sequences; `long_attention` computes long ones.

use kinematics::simd::lanes::{Kernel, LANES, dispatch};
use rayon::prelude::*;

pub use crate::heads::Heads;
use crate::heads::soften;
use crate::long_attention;
use crate::rows::Mask;

/// Sequences of at least this many tokens are computed with whole-matrix products.
const LONG: usize = 64;

/// Number of rows of a small product that are computed together.
const ROWS: usize = 4;

/// A small matrix, padded to a multiple of [`ROWS`] rows and of [`LANES`] columns. The padding is zero or never read.
struct Small {
    values: Vec<f32>,
    stride: usize,
}

impl Small {
    fn new(rows: usize, columns: usize) -> Self {
        let stride = columns.next_multiple_of(LANES);
        Self {
            values: vec![0.0; rows.next_multiple_of(ROWS) * stride],
            stride,
        }
    }

    #[inline(always)]
    fn row(&self, row: usize) -> &[f32] {
        &self.values[row * self.stride..][..self.stride]
    }

    #[inline(always)]
    fn row_mut(&mut self, row: usize) -> &mut [f32] {
        &mut self.values[row * self.stride..][..self.stride]
    }

    #[inline(always)]
    fn copy<'a>(&mut self, rows: impl Iterator<Item = &'a [f32]>) {
        for (row, from) in rows.enumerate() {
            self.row_mut(row)[..from.len()].copy_from_slice(from);
        }
    }

    #[inline(always)]
    fn copy_transposed<'a>(&mut self, rows: impl Iterator<Item = &'a [f32]>) {
        for (column, from) in rows.enumerate() {
            let lines = self.values.chunks_exact_mut(self.stride);
            for (line, &value) in lines.zip(from) {
                line[column] = value;
            }
        }
    }

    /// `self = a[:, ..depth] b[..depth, :]`.
    #[inline(always)]
    fn multiply(&mut self, a: &Self, b: &Self, depth: usize) {
        let stride = self.stride;
        let blocks = self.values.chunks_exact_mut(ROWS * stride);
        for (out, a) in blocks.zip(a.values.chunks_exact(ROWS * a.stride)) {
            let a: [&[f32]; ROWS] =
                std::array::from_fn(|row| &a[row * (a.len() / ROWS)..][..depth]);
            let mut column = 0;
            // Two blocks of columns at a time hide the latency of the additions.
            while column + 2 * LANES <= stride {
                sum_block::<{ 2 * LANES }>(a, b, column, out, stride);
                column += 2 * LANES;
            }
            if column < stride {
                sum_block::<LANES>(a, b, column, out, stride);
            }
        }
    }
}

/// Computes `COLUMNS` columns, starting at `column`, of the product of four rows with a matrix.
#[inline(always)]
fn sum_block<const COLUMNS: usize>(
    a: [&[f32]; ROWS],
    b: &Small,
    column: usize,
    out: &mut [f32],
    stride: usize,
) {
    let mut sums = [[0.0f32; COLUMNS]; ROWS];
    let [a0, a1, a2, a3] = a;
    let lines = b.values.chunks_exact(b.stride);
    for ((((a0, a1), a2), a3), line) in a0.iter().zip(a1).zip(a2).zip(a3).zip(lines) {
        let line: &[f32; COLUMNS] = line[column..].first_chunk().expect("rows are whole blocks");
        for (sums, factor) in sums.iter_mut().zip([a0, a1, a2, a3]) {
            for (sum, number) in sums.iter_mut().zip(line) {
                *sum += factor * number;
            }
        }
    }
    for (row, sums) in sums.iter().enumerate() {
        out[row * stride + column..][..COLUMNS].copy_from_slice(sums);
    }
}

/// Forward pass of attention: `joint` is `[B, T, 3 d]`, `out` becomes `[B, T, d]`, and `weights` the attention weights
/// before dropout, `[B, heads, T, T]`.
pub fn forward(heads: Heads<'_>, joint: &[f32], mask: Mask, weights: &mut [f32], out: &mut [f32]) {
    if heads.length < LONG {
        forward_short(heads, joint, mask, weights, out);
    } else {
        long_attention::forward(heads, joint, mask, weights, out);
    }
}

fn forward_short(
    heads: Heads<'_>,
    joint: &[f32],
    mask: Mask,
    weights: &mut [f32],
    out: &mut [f32],
) {
    struct Sequence<'a> {
        heads: Heads<'a>,
        index: usize,
        joint: &'a [f32],
        mask: Mask,
        weights: &'a mut [f32],
        out: &'a mut [f32],
    }
    impl Kernel for Sequence<'_> {
        type Output = ();

        #[inline(always)]
        fn run(self) {
            let (length, width, count) = (self.heads.length, self.heads.width, self.heads.count);
            let (head, scale) = (self.heads.head(), self.heads.scale());
            let padding = self.heads.padding_of(self.index);
            let first = self.index * self.heads.weights();
            let (mut queries, mut keys) = (Small::new(length, head), Small::new(head, length));
            let (mut values, mut scores) = (Small::new(length, head), Small::new(length, length));
            let mut attended = Small::new(length, head);
            for at in 0..count {
                let part = |part: usize| {
                    let first = part * width + at * head;
                    let rows = self.joint.chunks_exact(3 * width);
                    rows.map(move |row| &row[first..first + head])
                };
                queries.copy(part(0));
                keys.copy_transposed(part(1));
                values.copy(part(2));
                scores.multiply(&queries, &keys, head);
                for query in 0..length {
                    let scores = scores.row_mut(query);
                    soften(scores, length, scale, padding);
                    let scores = &mut scores[..length];
                    let row = (at * length + query) * length;
                    self.weights[row..row + length].copy_from_slice(scores);
                    if self.mask.is_active() {
                        for (key, score) in scores.iter_mut().enumerate() {
                            *score *= self.mask.factor((first + row + key) as u32);
                        }
                    }
                }
                attended.multiply(&scores, &values, length);
                for (query, row) in self.out.chunks_exact_mut(width).enumerate() {
                    row[at * head..][..head].copy_from_slice(&attended.row(query)[..head]);
                }
            }
        }
    }
    let size = heads.length * heads.width;
    joint
        .par_chunks(3 * size)
        .zip(weights.par_chunks_mut(heads.weights()))
        .zip(out.par_chunks_mut(size))
        .enumerate()
        .for_each(|(index, ((joint, weights), out))| {
            dispatch(Sequence {
                heads,
                index,
                joint,
                mask,
                weights,
                out,
            });
        });
}

/// The backward pass of [`forward`]: computes the gradient of `joint` from the gradient of `out`.
pub fn backward(
    heads: Heads<'_>,
    joint: &[f32],
    mask: Mask,
    weights: &[f32],
    grad: &[f32],
) -> Vec<f32> {
    if heads.length < LONG {
        backward_short(heads, joint, mask, weights, grad)
    } else {
        long_attention::backward(heads, joint, mask, weights, grad)
    }
}

struct SequenceGrad<'a> {
    heads: Heads<'a>,
    index: usize,
    joint: &'a [f32],
    mask: Mask,
    weights: &'a [f32],
    grad: &'a [f32],
    of_joint: &'a mut [f32],
}

impl Kernel for SequenceGrad<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let (length, width, count) = (self.heads.length, self.heads.width, self.heads.count);
        let (head, scale) = (self.heads.head(), self.heads.scale());
        let first = self.index * self.heads.weights();
        let tokens = || Small::new(length, head);
        let pairs = || Small::new(length, length);
        let (mut queries, mut keys, mut grad) = (tokens(), tokens(), tokens());
        let mut values = Small::new(head, length);
        // `of_scores` holds first the gradients of the weights, then those of the scores. `by_key` is its transpose.
        // `dropped` is the transpose of the weights after dropout.
        let (mut of_scores, mut by_key, mut dropped) = (pairs(), pairs(), pairs());
        let mut of_part = tokens();
        for at in 0..count {
            let part = |part: usize| {
                let first = part * width + at * head;
                let rows = self.joint.chunks_exact(3 * width);
                rows.map(move |row| &row[first..first + head])
            };
            queries.copy(part(0));
            keys.copy(part(1));
            values.copy_transposed(part(2));
            let rows = self.grad.chunks_exact(width);
            grad.copy(rows.map(|row| &row[at * head..][..head]));
            of_scores.multiply(&grad, &values, head);
            for query in 0..length {
                let row = (at * length + query) * length;
                let weights = &self.weights[row..row + length];
                let of_scores = &mut of_scores.row_mut(query)[..length];
                let mut along = 0.0;
                if self.mask.is_active() {
                    for (key, of_weight) in of_scores.iter_mut().enumerate() {
                        let factor = self.mask.factor((first + row + key) as u32);
                        *of_weight *= factor;
                        dropped.row_mut(key)[query] = factor * weights[key];
                    }
                } else {
                    for (key, &weight) in weights.iter().enumerate() {
                        dropped.row_mut(key)[query] = weight;
                    }
                }
                for (of_weight, weight) in of_scores.iter().zip(weights) {
                    along += of_weight * weight;
                }
                for (key, of_score) in of_scores.iter_mut().enumerate() {
                    *of_score = scale * weights[key] * (*of_score - along);
                    by_key.row_mut(key)[query] = *of_score;
                }
            }
            let factors = [(&of_scores, &keys), (&by_key, &queries), (&dropped, &grad)];
            for (part, (a, b)) in factors.into_iter().enumerate() {
                of_part.multiply(a, b, length);
                let first = part * width + at * head;
                for (token, row) in self.of_joint.chunks_exact_mut(3 * width).enumerate() {
                    row[first..first + head].copy_from_slice(&of_part.row(token)[..head]);
                }
            }
        }
    }
}

fn backward_short(
    heads: Heads<'_>,
    joint: &[f32],
    mask: Mask,
    weights: &[f32],
    grad: &[f32],
) -> Vec<f32> {
    let size = heads.length * heads.width;
    let mut of_joint = vec![0.0; joint.len()];
    joint
        .par_chunks(3 * size)
        .zip(weights.par_chunks(heads.weights()))
        .zip(grad.par_chunks(size))
        .zip(of_joint.par_chunks_mut(3 * size))
        .enumerate()
        .for_each(|(index, (((joint, weights), grad), of_joint))| {
            dispatch(SequenceGrad {
                heads,
                index,
                joint,
                mask,
                weights,
                grad,
                of_joint,
            });
        });
    of_joint
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check_close(found: &[f32], expected: &[f32]) {
        assert_eq!(found.len(), expected.len());
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 2e-5, "{found} {expected}");
        }
    }

    fn numbers(count: usize, step: f32) -> Vec<f32> {
        (0..count).map(|at| (at as f32 * step).sin()).collect()
    }

    #[test]
    fn gradients_of_peaked_attention_are_not_subnormal() {
        for length in [8, LONG] {
            let heads = Heads {
                length,
                width: 24,
                count: 3,
                padding: None,
            };
            // The scores of a query differ by up to a hundred, so the smallest exponentials are close to subnormal.
            let joint: Vec<f32> = (numbers(length * 3 * 24, 0.37).into_iter())
                .map(|number| 6.0 * number)
                .collect();
            let grad: Vec<f32> = (numbers(length * 24, 0.53).into_iter())
                .map(|number| 1e-6 * number)
                .collect();
            let (mask, mut out) = (Mask::new(0.0, 0), vec![0.0; length * 24]);
            let mut weights = vec![0.0; 3 * length * length];
            forward(heads, &joint, mask, &mut weights, &mut out);
            let of_joint = backward(heads, &joint, mask, &weights, &grad);
            for numbers in [&weights, &out, &of_joint] {
                assert!(
                    numbers.iter().all(|number| !number.is_subnormal()),
                    "{length}"
                );
            }
        }
    }

    #[test]
    fn long_sequences_are_attended_as_short_ones() {
        const SEQUENCES: usize = 3;
        let (length, width, count) = (LONG + 7, 24, 3);
        let joint = numbers(SEQUENCES * length * 3 * width, 0.37);
        let grad = numbers(SEQUENCES * length * width, 0.53);
        // The sequences have 70, 60 and 50 tokens.
        let padding: Vec<bool> = (0..SEQUENCES * length)
            .map(|at| at % length >= 70 - 10 * (at / length))
            .collect();
        let padding = Some(&padding[..]);
        for (padding, prob) in [(None, 0.0), (padding, 0.0), (padding, 0.2)] {
            let heads = Heads {
                length,
                width,
                count,
                padding,
            };
            let mask = Mask::new(prob, 5);
            let run = |forward: fn(Heads<'_>, &[f32], Mask, &mut [f32], &mut [f32])| {
                let mut weights = vec![0.0; SEQUENCES * count * length * length];
                let mut out = vec![0.0; SEQUENCES * length * width];
                forward(heads, &joint, mask, &mut weights, &mut out);
                (weights, out)
            };
            let (weights, out) = run(forward);
            let (weights_short, out_short) = run(forward_short);
            check_close(&weights, &weights_short);
            check_close(&out, &out_short);
            let on_one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build();
            let alone = on_one_thread.expect("a pool").install(|| run(forward));
            assert!(alone == (weights.clone(), out), "threads do not matter");
            check_close(
                &backward(heads, &joint, mask, &weights, &grad),
                &backward_short(heads, &joint, mask, &weights_short, &grad),
            );
        }
    }
}
