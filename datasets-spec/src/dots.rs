//! Dot products of vectors wherever they lie, in single precision.
//!
//! In a module of its own: what is compiled together with the matrix product has cost it half of its
//! speed.

use pulp::{Arch, Simd, WithSimd};

/// The dot product of every vector of one list with every vector of another, `[M]` and `[N]` giving
/// `[M, N]`: for lists so short that packing them would take as long as the product.
///
/// # Panics
/// If the vectors differ in length or the result is of another size.
pub fn dots(a: &[&[f32]], b: &[&[f32]], out: &mut [f32]) {
    assert_eq!(out.len(), a.len() * b.len(), "the result has its size");
    if out.is_empty() {
        return;
    }
    let length = a[0].len();
    assert!(
        a.iter().chain(b).all(|vector| vector.len() == length),
        "vectors of one length"
    );
    Arch::new().dispatch(Dots { a, b, out });
}

struct Dots<'a> {
    a: &'a [&'a [f32]],
    b: &'a [&'a [f32]],
    out: &'a mut [f32],
}

impl WithSimd for Dots<'_> {
    type Output = ();

    /// Twelve products at a time share what they read: four vectors of one list, three of the other.
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { a, b, out } = self;
        let columns = b.len();
        for first in (0..a.len()).step_by(4) {
            for start in (0..columns).step_by(3) {
                // At an edge the last vector stands in for those that are missing.
                let rows = [0, 1, 2, 3].map(|next| a[(first + next).min(a.len() - 1)]);
                let others = [0, 1, 2].map(|next| b[(start + next).min(columns - 1)]);
                let sums = twelve(simd, rows, others);
                for (row, sums) in sums.iter().enumerate().take(a.len() - first) {
                    let at = (first + row) * columns + start;
                    let width = 3.min(columns - start);
                    out[at..at + width].copy_from_slice(&sums[..width]);
                }
            }
        }
    }
}

/// Dot products, each as a sum of as many parts as a vector of the machine has.
#[inline(always)]
fn twelve<S: Simd>(simd: S, a: [&[f32]; 4], b: [&[f32]; 3]) -> [[f32; 3]; 4] {
    let mut sums = [[simd.splat_f32s(0.0); 3]; 4];
    let ([(a0, _), (a1, _), (a2, _), (a3, _)], [(b0, _), (b1, _), (b2, _)]) =
        (a.map(S::as_simd_f32s), b.map(S::as_simd_f32s));
    let a_parts = a0.iter().zip(a1).zip(a2).zip(a3);
    let b_parts = b0.iter().zip(b1).zip(b2);
    for ((((a0, a1), a2), a3), ((b0, b1), b2)) in a_parts.zip(b_parts) {
        for (sums, a) in sums.iter_mut().zip([*a0, *a1, *a2, *a3]) {
            for (sum, b) in sums.iter_mut().zip([*b0, *b1, *b2]) {
                *sum = simd.mul_add_e_f32s(a, b, *sum);
            }
        }
    }
    let mut found = [[0.0; 3]; 4];
    for (row, sums) in sums.into_iter().enumerate() {
        for (column, sum) in sums.into_iter().enumerate() {
            let (_, a) = S::as_simd_f32s(a[row]);
            let (_, b) = S::as_simd_f32s(b[column]);
            let rest = a.iter().zip(b);
            found[row][column] = rest.fold(simd.reduce_sum_f32s(sum), |sum, (a, b)| sum + a * b);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values(count: usize, seed: u32) -> Vec<f32> {
        (0..count as u32)
            .map(|index| ((index * 7 + seed) % 13) as f32 - 6.0)
            .collect()
    }

    #[test]
    fn dot_products_of_short_lists_are_exact_at_every_edge() {
        for (m, k, n) in [
            (1, 1, 1),
            (2, 16, 3),
            (5, 33, 7),
            (32, 512, 32),
            (3, 0, 2),
            (0, 4, 2),
            (2, 4, 0),
        ] {
            let (a, b) = (values(m * k, 1), values(n * k, 5));
            let rows = |values: &'_ [f32], count: usize| -> Vec<Vec<f32>> {
                (0..count)
                    .map(|row| values[row * k..][..k].to_vec())
                    .collect()
            };
            let (a, b) = (rows(&a, m), rows(&b, n));
            let [a, b] = [&a, &b].map(|rows| rows.iter().map(Vec::as_slice).collect::<Vec<_>>());
            let mut out = vec![1.0f32; m * n];
            dots(&a, &b, &mut out);
            for (at, found) in out.iter().enumerate() {
                let exact: f32 = a[at / n].iter().zip(b[at % n]).map(|(a, b)| a * b).sum();
                assert_eq!(*found, exact, "{m} {k} {n} at {at}");
            }
        }
    }
}
