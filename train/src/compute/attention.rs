//! Self-attention of short sequences, from the joint projection of queries, keys and values.

use datasets_spec::lanes::{Kernel, vectorised};
use rayon::prelude::*;

use super::rows::{Mask, add_scaled, dot, exp};

/// Sizes of an attention.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Heads<'a> {
    /// Tokens of a sequence.
    pub(crate) length: usize,
    /// Width of a token.
    pub(crate) width: usize,
    /// Heads.
    pub(crate) count: usize,
    /// True where a token is padding, `[B, T]`.
    pub(crate) padding: Option<&'a [bool]>,
}

impl Heads<'_> {
    fn head(&self) -> usize {
        self.width / self.count
    }

    /// Weights of a sequence.
    fn weights(&self) -> usize {
        self.count * self.length * self.length
    }

    fn scale(&self) -> f32 {
        (self.head() as f32).sqrt().recip()
    }

    fn padding_of(&self, sequence: usize) -> Option<&[bool]> {
        self.padding
            .map(|padding| &padding[sequence * self.length..][..self.length])
    }
}

/// Attends: `joint` is `[B, T, 3 d]`, `out` becomes `[B, T, d]`, and `weights` the attention weights
/// before dropout, `[B, heads, T, T]`.
pub(crate) fn forward(
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
            let Heads {
                length,
                width,
                count,
                ..
            } = self.heads;
            let (head, scale) = (self.heads.head(), self.heads.scale());
            let padding = self.heads.padding_of(self.index);
            let first = self.index * self.heads.weights();
            self.out.fill(0.0);
            for at in 0..count {
                let part = |token: usize, part: usize| {
                    &self.joint[token * 3 * width + part * width + at * head..][..head]
                };
                for query in 0..length {
                    let row = (at * length + query) * length;
                    let weights = &mut self.weights[row..row + length];
                    let q = part(query, 0);
                    let mut largest = f32::NEG_INFINITY;
                    for (key, weight) in weights.iter_mut().enumerate() {
                        *weight = scale * dot(q, part(key, 1));
                        if padding.is_some_and(|padding| padding[key]) {
                            *weight = f32::NEG_INFINITY;
                        }
                        largest = largest.max(*weight);
                    }
                    for weight in weights.iter_mut() {
                        // A key that is padding has no weight at all.
                        let is_padding = *weight == f32::NEG_INFINITY;
                        *weight = if is_padding {
                            0.0
                        } else {
                            exp(*weight - largest)
                        };
                    }
                    let scale = weights.iter().sum::<f32>().recip();
                    let out = &mut self.out[query * width + at * head..][..head];
                    for (key, weight) in weights.iter_mut().enumerate() {
                        *weight *= scale;
                        let kept = if self.mask.is_active() {
                            *weight * self.mask.factor((first + row + key) as u32)
                        } else {
                            *weight
                        };
                        add_scaled(out, kept, part(key, 2));
                    }
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
            vectorised(Sequence {
                heads,
                index,
                joint,
                mask,
                weights,
                out,
            });
        });
}

/// The backward pass of [`forward`]: the gradient of `joint` from that of `out`.
pub(crate) fn backward(
    heads: Heads<'_>,
    joint: &[f32],
    mask: Mask,
    weights: &[f32],
    grad: &[f32],
) -> Vec<f32> {
    struct Sequence<'a> {
        heads: Heads<'a>,
        index: usize,
        joint: &'a [f32],
        mask: Mask,
        weights: &'a [f32],
        grad: &'a [f32],
        of_joint: &'a mut [f32],
    }
    impl Kernel for Sequence<'_> {
        type Output = ();

        #[inline(always)]
        fn run(self) {
            let Heads {
                length,
                width,
                count,
                ..
            } = self.heads;
            let (head, scale) = (self.heads.head(), self.heads.scale());
            let first = self.index * self.heads.weights();
            let mut of_weights = vec![0.0f32; length];
            for at in 0..count {
                let place = |token: usize, part: usize| {
                    let start = token * 3 * width + part * width + at * head;
                    start..start + head
                };
                for query in 0..length {
                    let row = (at * length + query) * length;
                    let weights = &self.weights[row..row + length];
                    let grad = &self.grad[query * width + at * head..][..head];
                    let mut along = 0.0;
                    for (key, of_weight) in of_weights.iter_mut().enumerate() {
                        let factor = if self.mask.is_active() {
                            self.mask.factor((first + row + key) as u32)
                        } else {
                            1.0
                        };
                        *of_weight = factor * dot(grad, &self.joint[place(key, 2)]);
                        along += *of_weight * weights[key];
                        let of_value = &mut self.of_joint[place(key, 2)];
                        add_scaled(of_value, factor * weights[key], grad);
                    }
                    for (key, of_weight) in of_weights.iter().enumerate() {
                        let of_score = scale * weights[key] * (of_weight - along);
                        let of_query = &mut self.of_joint[place(query, 0)];
                        add_scaled(of_query, of_score, &self.joint[place(key, 1)]);
                        let of_key = &mut self.of_joint[place(key, 1)];
                        add_scaled(of_key, of_score, &self.joint[place(query, 0)]);
                    }
                }
            }
        }
    }
    let size = heads.length * heads.width;
    let mut of_joint = vec![0.0; joint.len()];
    joint
        .par_chunks(3 * size)
        .zip(weights.par_chunks(heads.weights()))
        .zip(grad.par_chunks(size))
        .zip(of_joint.par_chunks_mut(3 * size))
        .enumerate()
        .for_each(|(index, (((joint, weights), grad), of_joint))| {
            vectorised(Sequence {
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
