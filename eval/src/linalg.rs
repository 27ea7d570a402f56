//! Dense real matrices as far as the metrics need them: products, covariances and the symmetric
//! eigenproblem.
//!
//! Everything runs in `f64`. Each entry of a result is summed in an order that depends on the
//! sizes alone, so the same inputs give the same bits on any number of threads.

use rayon::prelude::*;

/// Partial sums of a dot product. Two SSE registers wide, which lets the compiler vectorise without
/// leave to reorder sums.
const LANES: usize = 4;
/// Columns whose dot products with one row are computed together.
const TILE: usize = 4;
/// Length of the piece of a row that is multiplied before moving on: a tile of such pieces stays in
/// the first-level cache.
const PANEL: usize = 512;
/// Rows given to a thread at once.
const ROWS_PER_TASK: usize = 16;
/// Entries of a matrix scaled to 1 that may be taken for zero. They are far below the rounding error
/// of any other entry, while their squares, unlike those of what elimination leaves of a rank
/// deficient matrix, are still far from underflow.
const NEGLIGIBLE: f64 = f64::EPSILON * f64::EPSILON;
/// QL sweeps after which an eigenvalue is declared lost. Wilkinson's shift needs two on average and
/// the classical limit is 30.
const MAX_SWEEPS: usize = 60;

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

    /// The identity.
    pub fn identity(size: usize) -> Self {
        Self::diagonal(&vec![1.0; size])
    }

    /// A diagonal matrix.
    pub fn diagonal(values: &[f64]) -> Self {
        let mut matrix = Self::zeros(values.len(), values.len());
        for (index, &value) in values.iter().enumerate() {
            matrix.row_mut(index)[index] = value;
        }
        matrix
    }

    /// Takes row-major data.
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

    /// A row, to be changed.
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
        let mut result = Self::zeros(self.num_cols, self.num_rows);
        for (row_index, row) in self.rows().enumerate() {
            for (col_index, &value) in row.iter().enumerate() {
                result.data[col_index * self.num_rows + row_index] = value;
            }
        }
        result
    }

    /// The product with another matrix.
    ///
    /// # Panics
    /// If the inner sizes differ.
    pub fn times(&self, other: &Self) -> Self {
        self.times_transposed(&other.transposed())
    }

    /// The product with the transpose of another matrix: entry (i, j) is the dot product of row i
    /// of this one and row j of the other.
    ///
    /// # Panics
    /// If the rows differ in length.
    pub fn times_transposed(&self, other: &Self) -> Self {
        row_products(self, other, false)
    }

    /// The symmetric product with the own transpose, at half the cost of the general one.
    pub fn gram(&self) -> Self {
        let mut result = row_products(self, self, true);
        for row in 1..result.num_rows {
            for col in 0..row {
                result.data[row * result.num_cols + col] = result.data[col * result.num_cols + row];
            }
        }
        result
    }

    /// The sum of the diagonal.
    pub fn trace(&self) -> f64 {
        (0..self.num_rows.min(self.num_cols))
            .map(|index| self.row(index)[index])
            .sum()
    }

    /// The largest absolute entry; NaN if there is one.
    pub fn max_abs(&self) -> f64 {
        self.data.iter().fold(0.0, |largest: f64, value| {
            if value.is_nan() || largest.is_nan() {
                f64::NAN
            } else {
                largest.max(value.abs())
            }
        })
    }
}

/// The dot product of two vectors.
///
/// # Panics
/// If they differ in length.
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    dots(a, [b])[0]
}

/// The dot products of one vector with several. Each is bit for bit what [`dot`] returns, so equal
/// vectors give equal products wherever they stand.
///
/// # Panics
/// If the vectors differ in length.
#[inline]
pub(crate) fn dots<const C: usize>(a: &[f64], others: [&[f64]; C]) -> [f64; C] {
    let (a_blocks, a_tail) = a.as_chunks::<LANES>();
    let others = others.map(|other| {
        assert_eq!(other.len(), a.len(), "vectors of different length");
        other.as_chunks::<LANES>()
    });
    // The same length, told to the compiler once so that the loop needs no bounds checks.
    let blocks = others.map(|(blocks, _)| &blocks[..a_blocks.len()]);
    let mut sums = [[0.0; LANES]; C];
    for (at, a_block) in a_blocks.iter().enumerate() {
        for (sum, blocks) in sums.iter_mut().zip(&blocks) {
            for lane in 0..LANES {
                sum[lane] += a_block[lane] * blocks[at][lane];
            }
        }
    }
    std::array::from_fn(|column| {
        let tail: f64 = a_tail
            .iter()
            .zip(others[column].1)
            .map(|(a, b)| a * b)
            .sum();
        let [s0, s1, s2, s3] = sums[column];
        (s0 + s2) + (s1 + s3) + tail
    })
}

/// All dot products of rows of `a` with rows of `b`; with `upper_only`, only those of tiles that
/// touch or lie right of the diagonal.
fn row_products(a: &Matrix, b: &Matrix, upper_only: bool) -> Matrix {
    assert_eq!(a.num_cols, b.num_cols, "rows of different length");
    let mut result = Matrix::zeros(a.num_rows, b.num_rows);
    if result.data.is_empty() {
        return result;
    }
    result
        .data
        .par_chunks_mut(ROWS_PER_TASK * b.num_rows)
        .enumerate()
        .for_each(|(task, block)| {
            let first_row = task * ROWS_PER_TASK;
            let first_col = if upper_only { first_row } else { 0 };
            for panel in (0..a.num_cols).step_by(PANEL) {
                let panel = panel..(panel + PANEL).min(a.num_cols);
                for tile in (first_col..b.num_rows).step_by(TILE) {
                    let width = TILE.min(b.num_rows - tile);
                    // A tile at the edge repeats its last row; the surplus products are dropped.
                    let columns: [&[f64]; TILE] =
                        std::array::from_fn(|j| &b.row(tile + j.min(width - 1))[panel.clone()]);
                    for (row, out) in block.chunks_exact_mut(b.num_rows).enumerate() {
                        let products = dots(&a.row(first_row + row)[panel.clone()], columns);
                        for (out, product) in out[tile..tile + width].iter_mut().zip(products) {
                            *out += product;
                        }
                    }
                }
            }
        });
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
    let mut centred = features.transposed();
    for (dimension, &mean) in mean.iter().enumerate() {
        for value in centred.row_mut(dimension) {
            *value -= mean;
        }
    }
    let mut covariance = centred.gram();
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

/// Decomposes a symmetric matrix by Householder tridiagonalisation and implicit QL.
///
/// Only symmetry up to rounding is assumed. Absolute errors of the eigenvalues are of the order of
/// the machine precision times the largest of them.
///
/// # Panics
/// If the matrix is not square or not finite.
pub fn symmetric_eigen(matrix: &Matrix) -> Eigen {
    let (scale, mut tridiagonal) = tridiagonalise(matrix);
    let mut vectors = tridiagonal.basis().transposed();
    diagonalise(&mut tridiagonal, Some(&mut vectors));
    let mut order: Vec<usize> = (0..matrix.num_rows).collect();
    order.sort_by(|&a, &b| tridiagonal.diagonal[a].total_cmp(&tridiagonal.diagonal[b]));
    Eigen {
        values: order
            .iter()
            .map(|&index| scale * tridiagonal.diagonal[index])
            .collect(),
        vectors: vectors.select_rows(&order),
    }
}

/// The eigenvalues of a symmetric matrix in ascending order, without the cost of its eigenvectors.
///
/// # Panics
/// If the matrix is not square or not finite.
pub fn symmetric_eigenvalues(matrix: &Matrix) -> Vec<f64> {
    let (scale, mut tridiagonal) = tridiagonalise(matrix);
    diagonalise(&mut tridiagonal, None);
    let mut values = tridiagonal.diagonal;
    for value in &mut values {
        *value *= scale;
    }
    values.sort_by(f64::total_cmp);
    values
}

/// `A = Q T Qᵀ` with `T` tridiagonal and `Q` the product of the reflections
/// `I - 2 v vᵀ / (vᵀ v)`, the first of them leftmost.
struct Tridiagonal {
    diagonal: Vec<f64>,
    /// Entry i couples i and i + 1; the last is zero.
    coupling: Vec<f64>,
    /// Reflection k acts on the coordinates from k + 1 on; `None` where nothing had to be done.
    reflections: Vec<Option<Reflection>>,
}

struct Reflection {
    vector: Vec<f64>,
    factor: f64,
}

/// Reduces a matrix, scaled so that its largest entry is 1, to tridiagonal form.
fn tridiagonalise(matrix: &Matrix) -> (f64, Tridiagonal) {
    let size = matrix.num_rows;
    assert_eq!(
        size, matrix.num_cols,
        "an eigenproblem needs a square matrix"
    );
    let scale = matrix.max_abs();
    assert!(scale.is_finite(), "an eigenproblem needs finite entries");
    let mut result = Tridiagonal {
        diagonal: vec![0.0; size],
        coupling: vec![0.0; size],
        reflections: Vec::with_capacity(size.saturating_sub(2)),
    };
    if scale == 0.0 {
        return (0.0, result);
    }
    let mut work = matrix.clone();
    for value in &mut work.data {
        *value /= scale;
    }
    for k in 0..size.saturating_sub(2) {
        let column = work.row(k)[k + 1..].to_vec();
        result.diagonal[k] = work.row(k)[k];
        let norm = dot(&column, &column).sqrt();
        if dot(&column[1..], &column[1..]) <= NEGLIGIBLE * NEGLIGIBLE {
            result.coupling[k] = column[0];
            result.reflections.push(None);
            continue;
        }
        // The sign that adds to the first entry avoids cancellation.
        let image = -norm.copysign(column[0]);
        let mut vector = column;
        vector[0] -= image;
        let factor = 2.0 / dot(&vector, &vector);
        result.coupling[k] = image;
        reflect_both_sides(&mut work, k + 1, &vector, factor);
        result.reflections.push(Some(Reflection { vector, factor }));
    }
    for k in size.saturating_sub(2)..size {
        result.diagonal[k] = work.row(k)[k];
        if k + 1 < size {
            result.coupling[k] = work.row(k)[k + 1];
        }
    }
    (scale, result)
}

/// Applies `I - factor v vᵀ` from both sides to the block of `work` that begins at `first`, as the
/// rank-two update `A - v wᵀ - w vᵀ`.
fn reflect_both_sides(work: &mut Matrix, first: usize, vector: &[f64], factor: f64) {
    let mut image: Vec<f64> = (first..work.num_rows)
        .map(|row| factor * dot(&work.row(row)[first..], vector))
        .collect();
    let along = 0.5 * factor * dot(&image, vector);
    for (image, v) in image.iter_mut().zip(vector) {
        *image -= along * v;
    }
    for (offset, (&v_row, &w_row)) in vector.iter().zip(&image).enumerate() {
        let row = &mut work.row_mut(first + offset)[first..];
        for ((entry, v), w) in row.iter_mut().zip(vector).zip(&image) {
            *entry -= v_row * w + w_row * v;
        }
    }
}

impl Tridiagonal {
    /// The orthogonal matrix `Q`.
    fn basis(&self) -> Matrix {
        let size = self.diagonal.len();
        let mut basis = Matrix::identity(size);
        // From the last reflection to the first, the part of the identity already touched grows
        // with the reflection, and each acts on that part alone.
        for (k, reflection) in self.reflections.iter().enumerate().rev() {
            let Some(Reflection { vector, factor }) = reflection else {
                continue;
            };
            let first = k + 1;
            let mut projection = vec![0.0; size - first];
            for (offset, &v) in vector.iter().enumerate() {
                let row = &basis.row(first + offset)[first..];
                for (sum, entry) in projection.iter_mut().zip(row) {
                    *sum += v * entry;
                }
            }
            for (offset, &v) in vector.iter().enumerate() {
                let row = &mut basis.row_mut(first + offset)[first..];
                for (entry, p) in row.iter_mut().zip(&projection) {
                    *entry -= factor * v * p;
                }
            }
        }
        basis
    }
}

/// Diagonalises `T` in place by QL sweeps with implicit shifts; each plane rotation is applied to
/// the rows of `vectors`, which therefore end as eigenvectors.
fn diagonalise(tridiagonal: &mut Tridiagonal, mut vectors: Option<&mut Matrix>) {
    let diagonal = &mut tridiagonal.diagonal;
    let coupling = &mut tridiagonal.coupling;
    let size = diagonal.len();
    // A coupling this small is below the rounding error that each sweep leaves everywhere. Measuring
    // it by its neighbours alone would never end in the null space of a matrix of lower rank.
    let norm = diagonal
        .iter()
        .zip(coupling.iter())
        .map(|(d, e)| d.abs() + e.abs())
        .fold(0.0, f64::max);
    for first in 0..size {
        let mut sweeps = 0;
        loop {
            let last = (first..size - 1)
                .find(|&i| coupling[i].abs() <= f64::EPSILON * norm)
                .unwrap_or(size - 1);
            if last == first {
                break;
            }
            sweeps += 1;
            assert!(
                sweeps <= MAX_SWEEPS,
                "QL lost eigenvalue {first} of {size} after {MAX_SWEEPS} sweeps"
            );
            sweep(diagonal, coupling, first, last, vectors.as_deref_mut());
        }
    }
}

/// One QL sweep over the unreduced block from `first` to `last`, chasing the bulge upwards.
fn sweep(
    diagonal: &mut [f64],
    coupling: &mut [f64],
    first: usize,
    last: usize,
    mut vectors: Option<&mut Matrix>,
) {
    // Wilkinson's shift: the eigenvalue of the leading 2 x 2 block nearest to its first entry.
    let half_gap = (diagonal[first + 1] - diagonal[first]) / (2.0 * coupling[first]);
    let root = half_gap.hypot(1.0);
    let mut bulge =
        diagonal[last] - diagonal[first] + coupling[first] / (half_gap + root.copysign(half_gap));
    let (mut sine, mut cosine, mut shift) = (1.0, 1.0, 0.0);
    for i in (first..last).rev() {
        let below = sine * coupling[i];
        let beside = cosine * coupling[i];
        let radius = below.hypot(bulge);
        coupling[i + 1] = radius;
        if radius == 0.0 {
            // The block has split by underflow: undo the shift and start over on its parts.
            diagonal[i + 1] -= shift;
            coupling[last] = 0.0;
            return;
        }
        sine = below / radius;
        cosine = bulge / radius;
        let shifted = diagonal[i + 1] - shift;
        let mixed = (diagonal[i] - shifted) * sine + 2.0 * cosine * beside;
        shift = sine * mixed;
        diagonal[i + 1] = shifted + shift;
        bulge = cosine * mixed - beside;
        if let Some(vectors) = vectors.as_deref_mut() {
            rotate_rows(vectors, i, cosine, sine);
        }
    }
    diagonal[first] -= shift;
    coupling[first] = bulge;
    coupling[last] = 0.0;
}

/// Turns rows `upper` and `upper + 1` into each other by a plane rotation.
fn rotate_rows(matrix: &mut Matrix, upper: usize, cosine: f64, sine: f64) {
    let width = matrix.num_cols;
    let pair = &mut matrix.data[upper * width..(upper + 2) * width];
    let (upper, lower) = pair.split_at_mut(width);
    for (u, l) in upper.iter_mut().zip(lower) {
        let (old_u, old_l) = (*u, *l);
        *u = cosine * old_u - sine * old_l;
        *l = sine * old_u + cosine * old_l;
    }
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
        // A backward-stable solver is off by a modest multiple of n times the precision.
        let tolerance = 4.0 * size as f64 * f64::EPSILON;
        let identity = eigen.vectors.gram();
        assert!(max_difference(&identity, &Matrix::identity(size)) <= tolerance);
        let rebuilt = eigen
            .vectors
            .transposed()
            .times(&Matrix::diagonal(&eigen.values))
            .times(&eigen.vectors);
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
                    // Sums of at most 1,030 products below 1 in absolute value.
                    assert!((product.row(i)[j] - exact).abs() < 1e-12);
                }
            }
        }
    }

    #[test]
    fn gram_is_the_product_with_the_own_transpose() {
        let a = random(37, 21, "gram");
        assert_eq!(a.gram(), a.times_transposed(&a));
    }

    #[test]
    fn grouped_dot_products_are_bit_equal_to_single_ones() {
        let a = random(5, 31, "dots");
        let grouped = dots(a.row(0), [a.row(1), a.row(2), a.row(3), a.row(4)]);
        for (index, product) in grouped.into_iter().enumerate() {
            assert_eq!(product, dot(a.row(0), a.row(index + 1)));
        }
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
        // Latents whose columns repeat each other: a large null space of exact duplicates.
        let columns = random(60, 300, "columns");
        let repeated: Vec<usize> = (0..128).map(|k| k % 60).collect();
        let (_, duplicates) = mean_and_covariance(&columns.select_rows(&repeated).transposed());
        for matrix in [
            duplicates,
            low_rank,
            graded,
            ones,
            Matrix::zeros(7, 7),
            Matrix::identity(9),
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
