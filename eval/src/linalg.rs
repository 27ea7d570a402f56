//! Linear algebra of the metrics: products, covariances and symmetric eigenproblems.
//!
//! Everything runs in `f64`; faer does the work. Products are divided into blocks of a fixed size,
//! each computed by one thread, so the result does not depend on the number of threads.

use faer::linalg::matmul::matmul;
use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::{Accum, MatMut, MatRef, Par, Side};
use rayon::prelude::*;

/// Rows of a result per parallel task: a covariance of 512 dimensions makes eight tasks.
const ROWS_PER_TASK: usize = 64;

/// A matrix in row-major order.
#[derive(Clone, Debug, PartialEq)]
pub struct Matrix {
    num_rows: usize,
    num_cols: usize,
    data: Vec<f64>,
}

impl Matrix {
    /// A matrix of zeros.
    pub fn zeros(num_rows: usize, num_cols: usize) -> Self {
        Self {
            num_rows,
            num_cols,
            data: vec![0.0; num_rows * num_cols],
        }
    }

    /// A diagonal matrix.
    #[cfg(test)]
    pub(crate) fn diagonal(values: &[f64]) -> Self {
        let mut matrix = Self::zeros(values.len(), values.len());
        for (index, &value) in values.iter().enumerate() {
            matrix.row_mut(index)[index] = value;
        }
        matrix
    }

    /// Wraps row-major data.
    ///
    /// # Panics
    /// If the data does not fill the matrix.
    pub fn new(num_rows: usize, num_cols: usize, data: Vec<f64>) -> Self {
        assert_eq!(
            data.len(),
            num_rows * num_cols,
            "matrix data of another size"
        );
        Self {
            num_rows,
            num_cols,
            data,
        }
    }

    /// Copies rows of equal length.
    ///
    /// # Panics
    /// If the rows differ in length.
    pub fn from_rows<R: AsRef<[f64]>>(rows: &[R]) -> Self {
        let num_cols = rows.first().map_or(0, |row| row.as_ref().len());
        let mut data = Vec::with_capacity(rows.len() * num_cols);
        for row in rows {
            assert_eq!(row.as_ref().len(), num_cols, "rows of different length");
            data.extend_from_slice(row.as_ref());
        }
        Self::new(rows.len(), num_cols, data)
    }

    /// Number of rows.
    pub fn num_rows(&self) -> usize {
        self.num_rows
    }

    /// Number of columns.
    pub fn num_cols(&self) -> usize {
        self.num_cols
    }

    /// A row.
    ///
    /// # Panics
    /// If it does not exist.
    pub fn row(&self, index: usize) -> &[f64] {
        &self.data[index * self.num_cols..(index + 1) * self.num_cols]
    }

    /// A mutable row.
    ///
    /// # Panics
    /// If it does not exist.
    pub fn row_mut(&mut self, index: usize) -> &mut [f64] {
        &mut self.data[index * self.num_cols..(index + 1) * self.num_cols]
    }

    /// The rows, in order.
    pub fn rows(&self) -> impl ExactSizeIterator<Item = &[f64]> {
        (0..self.num_rows).map(|index| self.row(index))
    }

    /// The rows at the given positions, in that order.
    ///
    /// # Panics
    /// If a position does not exist.
    pub fn select_rows(&self, indices: &[usize]) -> Self {
        let mut data = Vec::with_capacity(indices.len() * self.num_cols);
        for &index in indices {
            data.extend_from_slice(self.row(index));
        }
        Self::new(indices.len(), self.num_cols, data)
    }

    /// The transpose.
    pub fn transposed(&self) -> Self {
        Self::copied(self.view().transpose())
    }

    fn view(&self) -> MatRef<'_, f64> {
        MatRef::from_row_major_slice(&self.data, self.num_rows, self.num_cols)
    }

    fn copied(view: MatRef<'_, f64>) -> Self {
        let [num_rows, num_cols] = [view.nrows(), view.ncols()];
        let mut copy = Self::zeros(num_rows, num_cols);
        MatMut::from_row_major_slice_mut(&mut copy.data, num_rows, num_cols).copy_from(view);
        copy
    }

    /// The product with another matrix.
    ///
    /// # Panics
    /// If the inner sizes differ.
    pub fn times(&self, other: &Self) -> Self {
        product(self.view(), other.view())
    }

    /// The product with the transpose of another matrix: entry (i, j) is the dot product of row i
    /// of this one and row j of the other.
    ///
    /// # Panics
    /// If the rows differ in length.
    pub fn times_transposed(&self, other: &Self) -> Self {
        product(self.view(), other.view().transpose())
    }

    /// The symmetric product `A Aᵀ`, at little more than half the cost of the general product.
    pub fn gram(&self) -> Self {
        symmetric_product(self.view())
    }

    /// The sum of the diagonal.
    pub fn trace(&self) -> f64 {
        (0..self.num_rows.min(self.num_cols))
            .map(|index| self.row(index)[index])
            .sum()
    }
}

fn product(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> Matrix {
    assert_eq!(a.ncols(), b.nrows(), "matrices of different inner size");
    in_blocks(a.nrows(), b.ncols(), |first, out| {
        let a = a.subrows(first, out.nrows());
        matmul(out, Accum::Replace, a, b, 1.0, Par::Seq);
    })
}

/// Makes a matrix by writing blocks of its rows in parallel. `write` gets the number of the first row of a block, and the block.
fn in_blocks(
    num_rows: usize,
    num_cols: usize,
    write: impl Fn(usize, MatMut<'_, f64>) + Sync,
) -> Matrix {
    let mut result = Matrix::zeros(num_rows, num_cols);
    let blocks = result.data.par_chunks_mut(ROWS_PER_TASK * num_cols.max(1));
    blocks.enumerate().for_each(|(block, out)| {
        let rows = out.len() / num_cols;
        let out = MatMut::from_row_major_slice_mut(out, rows, num_cols);
        write(block * ROWS_PER_TASK, out);
    });
    result
}

/// `A Aᵀ`, computed from its lower triangle.
fn symmetric_product(a: MatRef<'_, f64>) -> Matrix {
    let size = a.nrows();
    let mut result = in_blocks(size, size, |first, out| {
        let own = a.subrows(first, out.nrows());
        let (left, rest) = out.split_at_col_mut(first);
        let before = a.subrows(0, first).transpose();
        matmul(left, Accum::Replace, own, before, 1.0, Par::Seq);
        let (diagonal, _) = rest.split_at_col_mut(own.nrows());
        triangular::matmul(
            diagonal,
            BlockStructure::TriangularLower,
            Accum::Replace,
            own,
            BlockStructure::Rectangular,
            own.transpose(),
            BlockStructure::Rectangular,
            1.0,
            Par::Seq,
        );
    });
    for row in 1..size {
        for col in 0..row {
            result.data[col * size + row] = result.data[row * size + col];
        }
    }
    result
}

/// The mean row and the unbiased covariance (divisor N - 1) of feature rows.
///
/// # Shapes
/// `features` is `[N, D]`; the results are `[D]` and `[D, D]`.
///
/// # Panics
/// If there are fewer than two rows.
pub fn mean_and_covariance(features: &Matrix) -> (Vec<f64>, Matrix) {
    let num_rows = features.num_rows;
    assert!(num_rows >= 2, "a covariance needs two rows, got {num_rows}");
    let mut mean = vec![0.0; features.num_cols];
    for row in features.rows() {
        for (sum, value) in mean.iter_mut().zip(row) {
            *sum += value;
        }
    }
    for sum in &mut mean {
        *sum /= num_rows as f64;
    }
    let mut centred = features.clone();
    for row in centred.data.chunks_exact_mut(features.num_cols.max(1)) {
        for (value, mean) in row.iter_mut().zip(&mean) {
            *value -= mean;
        }
    }
    let mut covariance = symmetric_product(centred.view().transpose());
    for value in &mut covariance.data {
        *value /= (num_rows - 1) as f64;
    }
    (mean, covariance)
}

/// The eigenvalues of a symmetric matrix in ascending order, with their eigenvectors.
#[derive(Clone, Debug)]
pub struct Eigen {
    /// Eigenvalues, ascending.
    pub values: Vec<f64>,
    /// Orthonormal eigenvectors: row k belongs to value k.
    pub vectors: Matrix,
}

/// Decomposes a symmetric matrix.
///
/// Only the lower triangle is read. Absolute errors of the eigenvalues are of the order of the
/// machine precision times the largest of them.
///
/// # Panics
/// If the matrix is not square or not finite.
pub fn symmetric_eigen(matrix: &Matrix) -> Eigen {
    let (scale, scaled) = scaled(matrix);
    let size = matrix.num_rows;
    if size == 0 {
        return Eigen {
            values: Vec::new(),
            vectors: Matrix::zeros(0, 0),
        };
    }
    let eigen = scaled
        .view()
        .self_adjoint_eigen(Side::Lower)
        .expect("the iteration converges on finite numbers");
    let (values, vectors) = (eigen.S(), eigen.U());
    Eigen {
        values: (0..size).map(|k| scale * values[k]).collect(),
        vectors: Matrix::copied(vectors.transpose()),
    }
}

/// The eigenvalues of a symmetric matrix in ascending order, without the cost of its eigenvectors.
///
/// # Panics
/// If the matrix is not square or not finite.
pub fn symmetric_eigenvalues(matrix: &Matrix) -> Vec<f64> {
    let (scale, scaled) = scaled(matrix);
    if matrix.num_rows == 0 {
        return Vec::new();
    }
    let mut values = scaled
        .view()
        .self_adjoint_eigenvalues(Side::Lower)
        .expect("the iteration converges on finite numbers");
    for value in &mut values {
        *value *= scale;
    }
    values
}

/// The largest magnitude in a matrix, and the matrix divided by it, so that squares of entries neither overflow nor
/// underflow.
fn scaled(matrix: &Matrix) -> (f64, Matrix) {
    assert_eq!(
        matrix.num_rows, matrix.num_cols,
        "only a square matrix has eigenvalues"
    );
    let view = matrix.view();
    assert!(view.is_all_finite(), "the matrix must be finite");
    let scale = view.norm_max();
    let mut scaled = matrix.clone();
    if scale > 0.0 {
        for value in &mut scaled.data {
            *value /= scale;
        }
    }
    (scale, scaled)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use datasets_spec::Seed;
    use proptest::prelude::*;
    use rand::RngExt;

    use super::*;

    fn random(num_rows: usize, num_cols: usize, name: &str) -> Matrix {
        let mut rng = Seed(11).rng(&["linalg", name]);
        let data = (0..num_rows * num_cols)
            .map(|_| rng.random_range(-1.0..1.0))
            .collect();
        Matrix::new(num_rows, num_cols, data)
    }

    fn max_difference(a: &Matrix, b: &Matrix) -> f64 {
        assert_eq!((a.num_rows, a.num_cols), (b.num_rows, b.num_cols));
        a.data
            .iter()
            .zip(&b.data)
            .fold(0.0, |largest, (a, b)| f64::max(largest, (a - b).abs()))
    }

    fn check_decomposition(matrix: &Matrix, eigen: &Eigen) {
        let size = matrix.num_rows();
        // The error of a backward-stable solver is a modest multiple of n times the machine precision. Over 600,000
        // random matrices, the largest factor was 4.7.
        let tolerance = 16.0 * size as f64 * f64::EPSILON;
        let identity = eigen.vectors.gram();
        let expected = Matrix::diagonal(&vec![1.0; size]);
        assert!(max_difference(&identity, &expected) <= tolerance);
        let turned = eigen.vectors.transposed();
        let scaled = turned.times(&Matrix::diagonal(&eigen.values));
        let rebuilt = scaled.times(&eigen.vectors);
        let scale = eigen.values.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
        assert!(max_difference(&rebuilt, matrix) <= tolerance * scale.max(f64::MIN_POSITIVE));
    }

    #[test]
    fn products_agree_with_the_definition_on_awkward_sizes() {
        for (rows, inner, cols) in [(1, 1, 1), (17, 9, 5), (33, 1030, 6), (3, 0, 4), (0, 3, 2)] {
            let a = random(rows, inner, "a");
            let b = random(inner, cols, "b");
            let product = a.times(&b);
            assert_eq!((product.num_rows(), product.num_cols()), (rows, cols));
            for i in 0..rows {
                for j in 0..cols {
                    let exact: f64 = (0..inner).map(|k| a.row(i)[k] * b.row(k)[j]).sum();
                    // The sums have at most 1,030 products, each below 1 in absolute value.
                    assert!((product.row(i)[j] - exact).abs() < 1e-12);
                }
            }
        }
    }

    #[test]
    fn gram_is_the_product_with_the_own_transpose() {
        let a = random(137, 21, "gram");
        let (gram, general) = (a.gram(), a.times_transposed(&a));
        // The sums have 21 products, each below 1 in absolute value.
        assert!(max_difference(&gram, &general) < 1e-14);
        assert_eq!(gram, gram.transposed());
    }

    #[test]
    fn covariance_of_four_corners_is_known() {
        let corners = Matrix::from_rows(&[[0.0, 1.0], [2.0, 1.0], [0.0, 5.0], [2.0, 5.0]]);
        let (mean, covariance) = mean_and_covariance(&corners);
        assert_eq!(mean, [1.0, 3.0]);
        let expected = Matrix::diagonal(&[4.0 / 3.0, 16.0 / 3.0]);
        assert!(max_difference(&covariance, &expected) < 1e-15);
    }

    #[test]
    fn the_second_difference_matrix_has_its_textbook_spectrum() {
        let size = 50;
        let mut matrix = Matrix::diagonal(&vec![2.0; size]);
        for i in 1..size {
            matrix.row_mut(i)[i - 1] = -1.0;
            matrix.row_mut(i - 1)[i] = -1.0;
        }
        let eigen = symmetric_eigen(&matrix);
        for (k, value) in eigen.values.iter().enumerate() {
            let exact = 2.0 - 2.0 * ((k + 1) as f64 * PI / (size + 1) as f64).cos();
            assert!((value - exact).abs() < 1e-13, "{k}: {value} {exact}");
        }
        check_decomposition(&matrix, &eigen);
    }

    #[test]
    fn hard_matrices_are_decomposed() {
        let low_rank = random(3, 40, "rank").transposed().gram();
        let graded = Matrix::diagonal(&(0..30).map(|k| 10f64.powi(-k)).collect::<Vec<_>>());
        let mut ones = Matrix::zeros(20, 20);
        ones.data.fill(1.0);
        // Latents with repeated columns: the duplicates make a large null space.
        let columns = random(60, 300, "columns");
        let repeated: Vec<usize> = (0..128).map(|k| k % 60).collect();
        let (_, duplicates) = mean_and_covariance(&columns.select_rows(&repeated).transposed());
        for matrix in [
            duplicates,
            low_rank,
            graded,
            ones,
            Matrix::zeros(7, 7),
            Matrix::diagonal(&[1.0; 9]),
            Matrix::diagonal(&[-3.0]),
            Matrix::zeros(0, 0),
            Matrix::from_rows(&[[0.0, 1.0], [1.0, 0.0]]),
        ] {
            check_decomposition(&matrix, &symmetric_eigen(&matrix));
        }
    }

    #[test]
    fn scale_does_not_overflow_or_vanish() {
        for scale in [1e-200, 1e200] {
            let matrix = Matrix::from_rows(&[[2.0 * scale, scale], [scale, 2.0 * scale]]);
            let values = symmetric_eigenvalues(&matrix);
            assert!((values[0] / scale - 1.0).abs() < 1e-15);
            assert!((values[1] / scale - 3.0).abs() < 1e-14);
        }
    }

    #[test]
    #[should_panic(expected = "finite")]
    fn a_nan_is_refused_rather_than_iterated_on() {
        symmetric_eigenvalues(&Matrix::from_rows(&[[1.0, f64::NAN], [f64::NAN, 1.0]]));
    }

    proptest! {
        #[test]
        fn any_symmetric_matrix_is_rebuilt_from_its_decomposition(
            size in 1usize..24,
            rank in 1usize..24,
            seed in any::<u64>(),
        ) {
            let low_rank = random(size, rank, &seed.to_string()).gram();
            check_decomposition(&low_rank, &symmetric_eigen(&low_rank));

            let half = random(size, size, &seed.to_string());
            let mut matrix = half.clone();
            for i in 0..size {
                for j in 0..size {
                    matrix.row_mut(i)[j] = half.row(i)[j] + half.row(j)[i];
                }
            }
            let eigen = symmetric_eigen(&matrix);
            check_decomposition(&matrix, &eigen);
            let values = symmetric_eigenvalues(&matrix);
            for (a, b) in values.iter().zip(&eigen.values) {
                prop_assert!((a - b).abs() < 1e-13 * size as f64);
            }
            let trace: f64 = values.iter().sum();
            prop_assert!((trace - matrix.trace()).abs() < 1e-12 * size as f64);
        }
    }
}
