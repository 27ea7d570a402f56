//! Fréchet distance between two sets of latents.

use super::definition::{Better, Draws, Latents, Measure, Metric, Part, SetSample};
use super::definition::{check_count, check_finite, check_size, squared_distance};
use crate::Error;
use crate::linalg::{Matrix, mean_and_covariance, symmetric_eigen, symmetric_eigenvalues};

const METRIC: &str = "FID";

pub(crate) static FID: Metric = Metric {
    name: "FID",
    about: "Fréchet distance of latents of unit length, halves of the set against each other",
    part: Part::Paper,
    better: |_| Better::Lower,
    decimals: 3,
    measure: Measure::Set(
        |sample| of_sample(sample, |latents| &latents.unit),
        Draws::Halves,
    ),
};

pub(crate) static FID_RAW: Metric = Metric {
    name: "FID (raw)",
    about: "FID of raw latents, as the encoder gives them",
    part: Part::Further,
    better: |_| Better::Lower,
    decimals: 2,
    measure: Measure::Set(
        |sample| of_sample(sample, |latents| &latents.raw),
        Draws::Halves,
    ),
};

/// The distance of each set from the real data. Resamples use a faster method, which agrees to 1e-6.
fn of_sample(
    sample: &SetSample<'_>,
    of: fn(&Latents) -> &Matrix,
) -> Result<Option<Vec<f64>>, Error> {
    let [real, compared] = sample.fid_items;
    let Latents { raw, .. } = sample.sets[0];
    let is_enough = sample.protocol.fid_size(raw.num_rows()) >= min_items(raw.num_cols());
    if !is_enough || real.len().min(compared.len()) < MIN_ROWS {
        return Ok(None);
    }
    let real = of(sample.sets[0]).select_rows(real);
    let sets = sample
        .sets
        .iter()
        .map(|latents| of(latents).select_rows(compared));
    let found = match sample.resampled {
        true => distances(&real, sets),
        false => fids(&real, sets),
    };
    found.map(Some)
}

/// Minimum number of items on each side for which the distance is reported. With fewer, the covariance of latents of
/// this width is singular, and the bias of small samples dominates.
pub const fn min_items(latent_width: usize) -> usize {
    latent_width + 1
}

/// Smallest set from which a covariance can be estimated.
pub const MIN_ROWS: usize = 2;

/// A normal distribution fitted to a set of latents.
#[derive(Clone, Debug, PartialEq)]
pub struct Gaussian {
    mean: Vec<f64>,
    covariance: Matrix,
}

impl Gaussian {
    /// The distribution of a mean and a covariance. It must be symmetric and positive semi-definite (unchecked).
    ///
    /// # Errors
    /// The sizes disagree or a number is not finite.
    pub fn new(mean: Vec<f64>, covariance: Matrix) -> Result<Self, Error> {
        let [height, width] = [covariance.num_rows(), covariance.num_cols()];
        check_size(METRIC, "covariance height", height, mean.len())?;
        check_size(METRIC, "covariance width", width, mean.len())?;
        check_finite(METRIC, &covariance)?;
        check_finite(METRIC, &Matrix::from_rows(&[&mean]))?;
        Ok(Self { mean, covariance })
    }

    /// Estimates the mean and the unbiased covariance of latents.
    ///
    /// # Shapes
    /// `latents` is `[N, D]`; `N` may be smaller than `D`.
    ///
    /// # Errors
    /// There are fewer than [`MIN_ROWS`] latents, or one is not finite.
    pub fn of_latents(latents: &Matrix) -> Result<Self, Error> {
        check_count(METRIC, latents.num_rows(), MIN_ROWS)?;
        let (mean, covariance) = mean_and_covariance(latents);
        // NaN and infinity reach the mean of their column, so the latents are searched only if the mean is not finite.
        if mean.iter().any(|value| !value.is_finite()) {
            check_finite(METRIC, latents)?;
        }
        Self::new(mean, covariance)
    }
}

/// One side of a Fréchet distance. The square root of its covariance is computed once and used in many comparisons.
#[derive(Clone, Debug)]
pub struct Reference {
    gaussian: Gaussian,
    /// `R = Λ^{1/2} Vᵀ` of the nonzero eigenvalues, one row for each, of width D; `Rᵀ R` is the covariance.
    root: Matrix,
}

impl Reference {
    /// Decomposes the covariance.
    pub fn new(gaussian: Gaussian) -> Self {
        let eigen = symmetric_eigen(&gaussian.covariance);
        let size = eigen.values.len();
        let largest = eigen.values.last().copied().unwrap_or(0.0);
        // Eigenvalues below this are rounding noise, but their square roots are not small. Dropping them keeps the
        // distance exact with fewer samples than dimensions.
        let noise = size as f64 * f64::EPSILON * largest;
        let range: Vec<usize> = (0..size).filter(|&k| eigen.values[k] > noise).collect();
        let mut root = eigen.vectors.select_rows(&range);
        for (row, &k) in range.iter().enumerate() {
            let length = eigen.values[k].sqrt();
            for entry in root.row_mut(row) {
                *entry *= length;
            }
        }
        Self { gaussian, root }
    }

    /// The squared Fréchet distance to another distribution, never negative.
    ///
    /// # Errors
    /// The distributions differ in dimension.
    ///
    /// # Source
    /// `‖μ_A - μ_B‖² + tr Σ_A + tr Σ_B - 2 tr (R Σ_B Rᵀ)^{1/2}` with `Rᵀ R = Σ_A`. The product under the root has the
    /// eigenvalues of `Σ_A Σ_B` and is symmetric, so no complex root arises. The reference (T2M) takes the root of the
    /// plain product and agrees wherever that root is defined.
    pub fn distance(&self, other: &Gaussian) -> Result<f64, Error> {
        let (root, Gaussian { mean, covariance }) = (&self.root, &self.gaussian);
        check_size(METRIC, "latent width", other.mean.len(), mean.len())?;
        let shift = squared_distance(mean, &other.mean);
        let inner = root.times(&other.covariance).times_transposed(root);
        let overlap = trace_of_root(&inner);
        let spread = covariance.trace() + other.covariance.trace();
        Ok((shift + spread - 2.0 * overlap).max(0.0))
    }
}

/// The Fréchet distance between two sets of latents.
///
/// # Shapes
/// `real` is `[N, D]`, `generated` is `[M, D]`.
///
/// # Errors
/// A set has fewer than two rows, the widths differ, or a number is not finite.
pub fn fid(real: &Matrix, generated: &Matrix) -> Result<f64, Error> {
    Reference::new(Gaussian::of_latents(real)?).distance(&Gaussian::of_latents(generated)?)
}

/// The [`fid`] of several sets from one.
fn fids(real: &Matrix, others: impl Iterator<Item = Matrix>) -> Result<Vec<f64>, Error> {
    let real = Reference::new(Gaussian::of_latents(real)?);
    others
        .map(|other| real.distance(&Gaussian::of_latents(&other)?))
        .collect()
}

/// Distances of several sets from one, equal to [`fid`] up to rounding. If the one set has no more rows than
/// dimensions, they are computed from products of the rows, which is faster.
///
/// # Errors
/// As [`fid`].
///
/// # Source
/// With centred rows `A` and `B`, `tr (Σ_A Σ_B)^{1/2}` is the sum of the singular values of
/// `A Bᵀ / √((N - 1) (M - 1))`.
pub(crate) fn distances(
    real: &Matrix,
    others: impl Iterator<Item = Matrix>,
) -> Result<Vec<f64>, Error> {
    if real.num_rows() > real.num_cols() {
        return fids(real, others);
    }
    let real = Centred::of(real)?;
    others
        .map(|other| {
            let other = Centred::of(&other)?;
            let shift = squared_distance(&real.mean, &other.mean);
            let overlap = trace_of_root(&real.rows.times_transposed(&other.rows).gram());
            Ok((shift + real.spread + other.spread - 2.0 * overlap).max(0.0))
        })
        .collect()
}

/// The trace of the square root of a symmetric matrix; negative eigenvalues are rounding noise.
fn trace_of_root(matrix: &Matrix) -> f64 {
    let values = symmetric_eigenvalues(matrix).into_iter();
    values.map(|value| value.max(0.0).sqrt()).sum()
}

/// Rows `A` minus their mean, scaled so that `Aᵀ A` is the unbiased covariance.
struct Centred {
    mean: Vec<f64>,
    rows: Matrix,
    /// Trace of the covariance.
    spread: f64,
}

impl Centred {
    fn of(latents: &Matrix) -> Result<Self, Error> {
        let count = latents.num_rows();
        check_count(METRIC, count, MIN_ROWS)?;
        let mut mean = vec![0.0; latents.num_cols()];
        for row in latents.rows() {
            for (mean, value) in mean.iter_mut().zip(row) {
                *mean += value / count as f64;
            }
        }
        let scale = 1.0 / ((count - 1) as f64).sqrt();
        let mut rows = latents.clone();
        let mut spread = 0.0;
        for index in 0..count {
            for (value, mean) in rows.row_mut(index).iter_mut().zip(&mean) {
                *value = (*value - mean) * scale;
                spread += *value * *value;
            }
        }
        Ok(Self { mean, rows, spread })
    }
}

#[cfg(test)]
mod tests {
    use datasets_spec::Seed;
    use proptest::prelude::*;
    use rand::RngExt;

    use super::*;
    use crate::golden::Golden;

    fn random(num_rows: usize, num_cols: usize, seed: u64) -> Matrix {
        let mut rng = Seed(seed).rng(&["fid"]);
        let data = (0..num_rows * num_cols)
            .map(|_| rng.random_range(-1.0..1.0))
            .collect();
        Matrix::new(num_rows, num_cols, data)
    }

    /// The covariance `R diag(variances) Rᵀ` with a rotation `R` of the plane by an angle.
    fn turned(variances: [f64; 2], angle: f64) -> Matrix {
        let (s, c) = angle.sin_cos();
        let rotation = Matrix::from_rows(&[[c, -s], [s, c]]);
        rotation
            .times(&Matrix::diagonal(&variances))
            .times(&rotation.transposed())
    }

    #[test]
    fn golden_fid_agrees_with_the_reference_and_the_symmetric_form() {
        let golden = Golden::read("metrics_fid");
        for case in ["generic", "deficient", "unit", "same"] {
            let a = golden.matrix(&format!("in.{case}.a"));
            let b = golden.matrix(&format!("in.{case}.b"));
            let value = fid(&a, &b).expect("valid sets");
            let symmetric = golden.scalar(&format!("out.{case}.fid_sym"));
            golden.check_scalar(case, value, symmetric, 1e-6, 1e-8);
            let reference = golden.scalar(&format!("out.{case}.fid"));
            // If the matrix root is not finite, the reference raises; this is recorded as NaN.
            if !reference.is_nan() {
                golden.check_scalar(case, value, reference, 1e-6, 1e-8);
            }
        }
        let gaussian = Gaussian::of_latents(&golden.matrix("in.generic.a")).expect("valid set");
        let covariance = gaussian.covariance.rows().collect::<Vec<_>>().concat();
        for (found, name) in [(gaussian.mean, "mu_a"), (covariance, "cov_a")] {
            let expected = golden.numbers(&format!("out.generic.{name}"));
            assert_eq!(found.len(), expected.len());
            for (found, expected) in found.iter().zip(expected) {
                golden.check_scalar(name, *found, expected, 1e-12, 1e-12);
            }
        }
    }

    #[test]
    fn gaussians_with_known_distance() {
        let of = |[x, y]: [f64; 2], covariance: Matrix| {
            Gaussian::new(vec![x, y], covariance).expect("valid")
        };
        let check = |a: Gaussian, b: Gaussian, expected: f64| {
            let value = Reference::new(a).distance(&b).expect("same size");
            assert!((value - expected).abs() < 1e-12, "{value} {expected}");
        };
        // With commuting covariances the trace term is the sum of (√a - √b)².
        for angle in [0.0, 0.3, 1.2] {
            let a = of([1.0, -2.0], turned([4.0, 9.0], angle));
            let b = of([4.0, 2.0], turned([1.0, 16.0], angle));
            check(a, b, 25.0 + 1.0 + 1.0);
        }
        // For orthogonal principal axes the cross term is zero, so only the traces remain.
        let [a, b] = [[4.0, 0.0], [0.0, 9.0]].map(|axes| of([0.0; 2], Matrix::diagonal(&axes)));
        check(a, b, 13.0);
    }

    #[test]
    fn a_shifted_or_scaled_copy_has_the_distance_of_its_moments() {
        let latents = random(60, 8, 1);
        let (mean, covariance) = mean_and_covariance(&latents);
        let [mut shifted, mut scaled] = [latents.clone(), latents.clone()];
        for row in 0..latents.num_rows() {
            shifted.row_mut(row)[3] += 2.5;
            for (value, mean) in scaled.row_mut(row).iter_mut().zip(&mean) {
                *value = mean + 3.0 * (*value - mean);
            }
        }
        let by_shift = fid(&latents, &shifted).expect("valid");
        assert!((by_shift - 6.25).abs() < 1e-10, "{by_shift}");
        // The distance is (1 - 3)² times the trace.
        let (by_scale, expected) = (fid(&latents, &scaled), 4.0 * covariance.trace());
        assert!((by_scale.expect("valid") - expected).abs() < 1e-10);
    }

    #[test]
    fn distances_of_few_rows_are_those_of_many_and_none_from_a_set_to_itself() {
        for (num_rows, num_cols) in [(50, 10), (6, 40), (2, 5)] {
            let latents = random(num_rows, num_cols, 2);
            // The tolerance covers rounding of the trace, about the dimension times the precision.
            assert!(fid(&latents, &latents).expect("valid") < 1e-11);
        }
        for (num_rows, num_cols) in [(30, 8), (20, 40), (2, 5)] {
            let real = random(num_rows, num_cols, 4);
            let mut others = [random(num_rows + 3, num_cols, 5), random(2, num_cols, 6)];
            // A set with a duplicate row, as in a resample.
            others[1] = others[0].select_rows(&[0, 1, 1, 2, 0]);
            let found = distances(&real, others.iter().cloned()).expect("valid");
            for (found, other) in found.into_iter().zip(&others) {
                let expected = fid(&real, other).expect("valid");
                // The difference is due to square roots of eigenvalues that are rounding noise.
                assert!((found - expected).abs() < 1e-6, "{found} {expected}");
            }
        }
        let one = random(1, 4, 3);
        assert!(distances(&one, std::iter::once(random(2, 4, 3))).is_err());
    }

    #[test]
    fn impossible_inputs_are_refused() {
        let one = random(1, 4, 3);
        let two = random(2, 4, 3);
        let refusal = |real: &Matrix, generated: &Matrix| {
            fid(real, generated).expect_err("refused").to_string()
        };
        assert_eq!(refusal(&one, &two), "FID needs at least 2 rows, got 1");
        assert_eq!(
            refusal(&two, &random(3, 5, 3)),
            "FID: latent width is 5, expected 4"
        );
        let mut broken = two.clone();
        broken.row_mut(1)[2] = f64::NAN;
        assert_eq!(refusal(&two, &broken), "FID: row 1 is not finite");
        assert!(Gaussian::new(vec![0.0], Matrix::diagonal(&[1.0; 2])).is_err());
    }

    proptest! {
        #[test]
        fn distance_is_symmetric_and_blind_to_order(
            seed in any::<u64>(),
            rows in 3usize..20,
            cols in 1usize..12,
        ) {
            let a = random(rows, cols, seed);
            let b = random(rows + 4, cols, seed ^ 1);
            let forward = fid(&a, &b).expect("valid");
            let backward = fid(&b, &a).expect("valid");
            let reversed: Vec<usize> = (0..rows).rev().collect();
            let reordered = fid(&a.select_rows(&reversed), &b).expect("valid");
            // A rounding error of 1e-16 has the square root 1e-8; it is summed over the dimensions.
            let tolerance = 1e-7 * cols as f64;
            prop_assert!((forward - backward).abs() < tolerance);
            prop_assert!((forward - reordered).abs() < tolerance);
        }
    }
}
