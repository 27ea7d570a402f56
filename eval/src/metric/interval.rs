//! Mean and confidence interval over repeated measurements.

use serde::{Deserialize, Serialize};

/// The quantile of the normal distribution that leaves 5 % outside.
const NORMAL_95: f64 = 1.96;

/// A mean and the half width of its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// Mean over the repeats.
    pub mean: f64,
    /// Half width of the interval.
    pub ci95: f64,
}

impl Interval {
    /// Summarises repeats: the half width is `1.96 σ / √n` with the population deviation.
    ///
    /// # Panics
    /// If there are no values.
    ///
    /// # Source
    /// T2M evaluation; the paper says only "95 % confidence interval" over ten evaluations.
    pub fn of(values: &[f64]) -> Self {
        assert!(!values.is_empty(), "an interval of no values");
        let count = values.len() as f64;
        // Equal values have no spread, whatever the rounding of their mean.
        if values.iter().all(|value| *value == values[0]) {
            return Self {
                mean: values[0],
                ci95: 0.0,
            };
        }
        let mean = values.iter().sum::<f64>() / count;
        let variance = values
            .iter()
            .map(|value| (value - mean) * (value - mean))
            .sum::<f64>()
            / count;
        Self {
            mean,
            ci95: NORMAL_95 * variance.sqrt() / count.sqrt(),
        }
    }
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
            golden.check_scalar("half width", interval.ci95, half_widths[metric], 0.0, 1e-9);
        }
    }

    #[test]
    fn a_single_value_has_no_spread_and_two_have_a_known_one() {
        assert_eq!(
            Interval::of(&[0.1; 10]),
            Interval {
                mean: 0.1,
                ci95: 0.0
            }
        );
        let interval = Interval::of(&[1.0, 3.0]);
        assert_eq!(interval.mean, 2.0);
        assert!((interval.ci95 - NORMAL_95 / 2f64.sqrt()).abs() < 1e-15);
    }
}
