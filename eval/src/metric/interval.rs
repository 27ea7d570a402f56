//! Mean and confidence interval over repeated measurements.

use serde::{Deserialize, Serialize};

/// Quantile of the normal distribution for a two-sided 95 % interval.
const NORMAL_95: f64 = 1.96;

/// Quantiles of Student's t for a two-sided 95 % interval, for 1 to 9 degrees of freedom.
const STUDENT_95: [f64; 9] = [
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262,
];

/// Maximum number of trainings of a system that [`Interval::over_trainings`] summarises.
pub const MOST_TRAININGS: usize = STUDENT_95.len() + 1;

/// Minimum number of targets for a bootstrap interval.
///
/// The half width is 1.96 times the population deviation. For a mean of n normal values, such an interval covers the
/// true mean with the probability that the absolute value of Student's t with n - 1 degrees of freedom is below `1.96
/// √((n - 1) / n)`: 90.4 % for 10 targets, and less than 90 % for fewer.
pub const MIN_TARGETS: u32 = 10;

/// A mean and the half width of its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// Mean over the repeats.
    pub mean: f64,
    /// Half width of the interval; `None` if there is no variation.
    pub ci95: Option<f64>,
}

impl Interval {
    /// Summarises repeats: the half width is `1.96 σ / √n` with the population deviation. If all repeats are equal,
    /// there is no interval.
    ///
    /// # Panics
    /// If there are no values.
    ///
    /// # Source
    /// T2M evaluation; the paper says only "95 % confidence interval" over ten evaluations.
    pub fn of(values: &[f64]) -> Self {
        assert!(!values.is_empty(), "an interval of no values");
        let (mean, variance) = moments(values);
        Self {
            mean,
            ci95: variance.map(|variance| NORMAL_95 * (variance / values.len() as f64).sqrt()),
        }
    }

    /// The mean over several trainings of a system, scored on the same items. The squared half width is the sum of two
    /// terms: the mean of the squared half widths over test sets, and `t² s² / n`. Here `s²` is the sample variance
    /// between the n trainings, and t the quantile of Student's distribution.
    ///
    /// # Panics
    /// If there are no values, or more than [`MOST_TRAININGS`].
    pub fn over_trainings(values: &[Self]) -> Self {
        if let [only] = values {
            return *only;
        }
        let count = values.len() as f64;
        let means: Vec<f64> = values.iter().map(|value| value.mean).collect();
        let (mean, between) = moments(&means);
        let of_items = values.iter().filter_map(|value| value.ci95);
        let of_items = of_items.map(|half| half * half).sum::<f64>() / count;
        // The population variance divided by n - 1 equals the sample variance divided by n.
        let of_trainings = between.map_or(0.0, |variance| {
            let quantile = STUDENT_95[values.len() - 2];
            quantile * quantile * variance / (count - 1.0)
        });
        let half = (of_items + of_trainings).sqrt();
        Self {
            mean,
            ci95: (half > 0.0).then_some(half),
        }
    }

    /// A value with its bootstrap interval: the half width is 1.96 standard deviations of the resampled values. The
    /// mean of the resampled values is not used, because drawing with replacement shifts it.
    ///
    /// If resamples and repeats draw at random, `repeats` holds the values whose mean is `mean`, and `share` is the
    /// variance that the draws add to a resample, as a share of the variance between repeats. The mean of n repeats varies
    /// by 1/n of that; the difference is subtracted.
    ///
    /// # Source
    /// Efron and Tibshirani 1993, Sec. 13.3, the standard normal interval.
    pub(crate) fn of_resamples(mean: f64, resampled: &[f64], repeats: &[f64], share: f64) -> Self {
        let (Some(spread), scatter) = (variance(resampled), variance(repeats).unwrap_or(0.0))
        else {
            return Self { mean, ci95: None };
        };
        let count = repeats.len().max(1) as f64;
        let kept = scatter / count;
        let variance = (spread - (share * scatter - kept)).max(kept);
        Self {
            mean,
            ci95: (variance > 0.0).then(|| NORMAL_95 * variance.sqrt()),
        }
    }
}

/// The mean; `None` without values.
pub(crate) fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    (count > 0.0).then(|| sum / count)
}

/// The mean of the finite values; `None` without any.
pub(crate) fn mean_of_known(values: &[f64]) -> Option<f64> {
    mean(values.iter().copied().filter(|value| value.is_finite()))
}

/// The population variance; `None` if there are no values or all are equal.
fn variance(values: &[f64]) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    moments(values).1
}

fn moments(values: &[f64]) -> (f64, Option<f64>) {
    if values.iter().all(|value| *value == values[0]) {
        return (values[0], None);
    }
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares = values.iter().map(|value| (value - mean) * (value - mean));
    (mean, Some(squares.sum::<f64>() / count))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::golden::Golden;

    #[test]
    fn golden_interval_agrees_with_the_reference() {
        let golden = Golden::read("metrics_t2m");
        let repeats = golden.matrix("in.ci.values").transposed();
        let means = golden.numbers("out.ci.mean");
        let half_widths = golden.numbers("out.ci.half_width");
        assert_eq!(repeats.num_rows(), means.len());
        for (metric, values) in repeats.rows().enumerate() {
            let interval = Interval::of(values);
            golden.check_scalar("mean", interval.mean, means[metric], 0.0, 1e-9);
            let half_width = interval.ci95.unwrap_or(0.0);
            golden.check_scalar("half width", half_width, half_widths[metric], 0.0, 1e-9);
        }
    }

    #[test]
    fn two_values_have_a_known_spread_and_equal_ones_none() {
        for values in [&[0.1; 10][..], &[0.1]] {
            let interval = Interval::of(values);
            assert_eq!((interval.mean, interval.ci95), (0.1, None));
        }
        let interval = Interval::of(&[1.0, 3.0]);
        assert_eq!(interval.mean, 2.0);
        let ci95 = interval.ci95.expect("varies");
        assert!((ci95 - NORMAL_95 / 2f64.sqrt()).abs() < 1e-15);
    }

    #[test]
    fn resamples_spread_around_the_value_and_not_around_their_mean() {
        let interval = Interval::of_resamples(10.0, &[1.0, 3.0], &[], 1.0);
        assert_eq!((interval.mean, interval.ci95), (10.0, Some(NORMAL_95)));
        for (resamples, repeats) in [(&[2.0; 5][..], &[1.0, 3.0][..]), (&[], &[])] {
            let interval = Interval::of_resamples(1.0, resamples, repeats, 1.0);
            assert_eq!(interval.ci95, None);
        }
        // The resamples have variance 1. Three quarters of the repeats' variance of 1/4 are subtracted from it. The
        // interval is at least as wide as the variation over repeats.
        let less = (1.0 - 0.25 * 0.75f64).sqrt();
        // If resamples draw nothing at random, the variance of the mean of four repeats is added.
        let more = (1.0 + 0.25 * 0.25f64).sqrt();
        for (size, share, expected) in [(1.0, 1.0, less), (0.01, 1.0, 0.25), (1.0, 0.0, more)] {
            let repeats = [0.5, -0.5, 0.5, -0.5];
            let ci95 = Interval::of_resamples(0.0, &[size, -size], &repeats, share).ci95;
            assert!((ci95.expect("varies") - NORMAL_95 * expected).abs() < 1e-15);
        }
    }
}
