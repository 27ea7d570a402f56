//! Multi-threaded matrix products in single precision, by the crate faer.

use faer::linalg::matmul::matmul;
use faer::{MatMut, MatRef, Par};

/// How a product is written to the output: it replaces the output, or is added to it.
pub use faer::Accum as Write;

/// A view of a matrix: row-major numbers, or some of their columns, or the transpose of either.
pub type Matrix<'a> = MatRef<'a, f32>;

/// Views row-major numbers with `columns` in a row.
///
/// # Panics
/// If the number of values is not a multiple of `columns`.
pub fn matrix(values: &[f32], columns: usize) -> Matrix<'_> {
    assert!(columns > 0 && values.len().is_multiple_of(columns));
    MatRef::from_row_major_slice(values, values.len() / columns, columns)
}

/// Computes `a b` and writes it to `out`, or adds it, row-major. Each row of the result depends neither on the number
/// of threads nor on the other rows of `a`.
///
/// # Shapes
/// `[M, K]` and `[K, N]` give `[M, N]`.
///
/// # Panics
/// If the sizes disagree.
pub fn multiply(a: Matrix<'_>, b: Matrix<'_>, out: &mut [f32], write: Write) {
    let out = MatMut::from_row_major_slice_mut(out, a.nrows(), b.ncols());
    matmul(out, write, a, b, 1.0, Par::rayon(0));
}

/// Views `count` columns, starting at `first`, of row-major numbers with `stride` in a row.
pub(crate) fn columns(values: &[f32], stride: usize, first: usize, count: usize) -> Matrix<'_> {
    let rows = values.len() / stride;
    MatRef::from_row_major_slice_with_stride(&values[first..], rows, count, stride)
}

/// Computes `a b` on this thread only and writes it to `out`, row-major.
///
/// # Panics
/// If the sizes disagree.
pub(crate) fn multiply_alone(a: Matrix<'_>, b: Matrix<'_>, out: &mut [f32]) {
    let out = MatMut::from_row_major_slice_mut(out, a.nrows(), b.ncols());
    matmul(out, Write::Replace, a, b, 1.0, Par::Seq);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values(count: usize, seed: u32) -> Vec<f32> {
        (0..count as u32)
            .map(|index| ((index * 7 + seed) % 13) as f32 - 6.0)
            .collect()
    }

    /// Checks products of small whole numbers, whose sums are exact.
    fn check(m: usize, k: usize, n: usize) {
        let (a, b) = (values(m * k, 1), values(k * n, 5));
        let mut expected = vec![0.0f32; m * n];
        for row in 0..m {
            for column in 0..n {
                expected[row * n + column] =
                    (0..k).map(|at| a[row * k + at] * b[at * n + column]).sum();
            }
        }
        let flipped = |values: &[f32], columns: usize| -> Vec<f32> {
            let rows = values.len() / columns;
            (0..values.len())
                .map(|at| values[(at % rows) * columns + at / rows])
                .collect()
        };
        let (a_flipped, b_flipped) = (flipped(&a, k), flipped(&b, n));
        for a in [matrix(&a, k), matrix(&a_flipped, m).transpose()] {
            for b in [matrix(&b, n), matrix(&b_flipped, k).transpose()] {
                let mut out = vec![1.0f32; m * n];
                multiply(a, b, &mut out, Write::Replace);
                assert_eq!(out, expected, "{m} {k} {n}");
                multiply(a, b, &mut out, Write::Add);
                let doubled: Vec<f32> = expected.iter().map(|value| 2.0 * value).collect();
                assert_eq!(out, doubled, "{m} {k} {n}");
            }
        }
    }

    #[test]
    fn products_are_exact_at_every_edge() {
        check(1, 1, 1);
        check(7, 300, 17);
        check(34, 84, 40);
        check(200, 513, 33);
        check(13, 5, 84);
    }

    #[test]
    fn results_do_not_depend_on_the_number_of_threads() {
        let a: Vec<f32> = (0..130 * 700).map(|at| (at as f32).sin()).collect();
        let b: Vec<f32> = (0..700 * 300).map(|at| (at as f32).cos()).collect();
        let (a, b) = (matrix(&a, 700), matrix(&b, 300));
        let products = [1, 2, 5].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            let mut out = vec![0.0; 130 * 300];
            let act = || multiply(a, b, &mut out, Write::Replace);
            pool.expect("threads").install(act);
            out
        });
        assert!(products.iter().all(|product| *product == products[0]));
    }

    #[test]
    fn a_row_does_not_depend_on_its_neighbours() {
        let a: Vec<f32> = (0..40 * 300).map(|at| (at as f32).sin()).collect();
        let b: Vec<f32> = (0..300 * 48).map(|at| (at as f32).cos()).collect();
        let b = matrix(&b, 48);
        let mut whole = vec![0.0; 40 * 48];
        multiply(matrix(&a, 300), b, &mut whole, Write::Replace);
        let mut single = vec![0.0; 48];
        let row = matrix(&a[17 * 300..18 * 300], 300);
        multiply(row, b, &mut single, Write::Replace);
        assert_eq!(single, whole[17 * 48..18 * 48]);
    }
}
