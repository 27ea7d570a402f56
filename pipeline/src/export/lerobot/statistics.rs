//! Minimum, maximum, mean, deviation and quantiles of the state vectors, for each episode and for the dataset.
//!
//! # Source
//! `lerobot.datasets.compute_stats`: quantiles of a data set are the means of its episodes' quantiles,
//! weighted by their frames.

use serde_json::{Map, Value, json};

pub(super) const STATE_WIDTH: usize = 69;
pub(super) const QUANTILES: [(&str, f64); 5] = [
    ("q01", 0.01),
    ("q10", 0.1),
    ("q50", 0.5),
    ("q90", 0.9),
    ("q99", 0.99),
];

/// A number for each column of the state.
pub(super) type Columns = [f64; STATE_WIDTH];

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Statistics {
    pub(super) frames: u64,
    min: Columns,
    max: Columns,
    mean: Columns,
    variance: Columns,
    quantiles: [Columns; QUANTILES.len()],
}

impl Statistics {
    pub(super) fn of(states: &[[f32; STATE_WIDTH]]) -> Self {
        let mut statistics = Self {
            frames: states.len() as u64,
            min: [0.0; STATE_WIDTH],
            max: [0.0; STATE_WIDTH],
            mean: [0.0; STATE_WIDTH],
            variance: [0.0; STATE_WIDTH],
            quantiles: [[0.0; STATE_WIDTH]; QUANTILES.len()],
        };
        let Some(last) = states.len().checked_sub(1) else {
            return statistics;
        };
        let count = states.len() as f64;
        for column in 0..STATE_WIDTH {
            let mut values: Vec<f64> = states.iter().map(|state| state[column].into()).collect();
            values.sort_unstable_by(f64::total_cmp);
            let mean = values.iter().sum::<f64>() / count;
            let scatter: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
            statistics.min[column] = values[0];
            statistics.max[column] = values[last];
            statistics.mean[column] = mean;
            statistics.variance[column] = scatter / count;
            for (quantile, (_, share)) in statistics.quantiles.iter_mut().zip(QUANTILES) {
                // Linear interpolation between neighbours, as in NumPy.
                let place = share * last as f64;
                let below = values[place as usize];
                let above = values[last.min(place as usize + 1)];
                quantile[column] = below + (above - below) * place.fract();
            }
        }
        statistics
    }

    /// Adds an episode to the statistics of earlier ones.
    pub(super) fn add(&mut self, other: &Self) {
        let total = self.frames + other.frames;
        let share = other.frames as f64 / total.max(1) as f64;
        let weigh = |ours: &mut f64, theirs: f64| *ours += (theirs - *ours) * share;
        for column in 0..STATE_WIDTH {
            let apart = other.mean[column] - self.mean[column];
            self.min[column] = self.min[column].min(other.min[column]);
            self.max[column] = self.max[column].max(other.max[column]);
            weigh(&mut self.mean[column], other.mean[column]);
            weigh(&mut self.variance[column], other.variance[column]);
            self.variance[column] += apart * apart * share * (1.0 - share);
            for (ours, theirs) in self.quantiles.iter_mut().zip(&other.quantiles) {
                weigh(&mut ours[column], theirs[column]);
            }
        }
        self.frames = total;
    }

    /// Every statistic but the count, by its name.
    pub(super) fn named(&self) -> Vec<(&'static str, Columns)> {
        let mut named = vec![
            ("min", self.min),
            ("max", self.max),
            ("mean", self.mean),
            ("std", self.variance.map(f64::sqrt)),
        ];
        let quantiles = QUANTILES.iter().zip(self.quantiles);
        named.extend(quantiles.map(|((name, _), columns)| (*name, columns)));
        named
    }

    /// The statistics as the format writes them.
    pub(super) fn json(&self) -> Value {
        let mut of_state = Map::new();
        for (name, columns) in self.named() {
            of_state.insert(name.to_owned(), json!(columns.to_vec()));
        }
        of_state.insert("count".to_owned(), json!([self.frames]));
        json!({ "observation.state": of_state })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn states(values: &[f32]) -> Vec<[f32; STATE_WIDTH]> {
        values.iter().map(|&value| [value; STATE_WIDTH]).collect()
    }

    #[test]
    fn statistics_by_hand() {
        let (first, second) = (states(&[3.0, 1.0, 2.0]), states(&[6.0]));
        let mut statistics = Statistics::of(&first);
        let of = |statistics: &Statistics, name: &str| {
            let named = statistics.named();
            let found = named.iter().find(|(found, _)| *found == name);
            found.expect("a statistic").1[68]
        };
        assert_eq!(of(&statistics, "q50"), 2.0);
        assert!((of(&statistics, "q10") - 1.2).abs() < 1e-12);
        assert!((of(&statistics, "std") - (2.0f64 / 3.0).sqrt()).abs() < 1e-12);
        statistics.add(&Statistics::of(&second));
        assert_eq!((statistics.frames, of(&statistics, "mean")), (4, 3.0));
        assert_eq!((of(&statistics, "min"), of(&statistics, "max")), (1.0, 6.0));
        // Deviations of 1, 2, 3 and 6 from 3.
        assert!((of(&statistics, "std") - 3.5f64.sqrt()).abs() < 1e-12);
        // (3 * 2 + 6) / 4.
        assert!((of(&statistics, "q50") - 3.0).abs() < 1e-12);
    }
}
