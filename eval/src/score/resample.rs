//! Bootstrap over the targets of a test set.

use std::collections::BTreeMap;

use rand::RngExt;
use rayon::prelude::*;

use crate::protocol::{Protocol, RESAMPLES};

/// Draws of the targets with replacement, the same for all systems and metrics. Items that share a target are drawn
/// together, because they are not independent.
pub(crate) struct Resamples {
    /// Items of each target.
    groups: Vec<Vec<usize>>,
    /// How often each target is drawn, for each resample.
    counts: Vec<Vec<u32>>,
}

impl Resamples {
    /// Draws targets. `targets` names the target of each item; items with equal names share a target.
    pub(crate) fn new<'a>(targets: impl Iterator<Item = &'a str>, protocol: &Protocol) -> Self {
        let mut groups: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
        for (item, target) in targets.enumerate() {
            groups.entry(target).or_default().push(item);
        }
        let groups: Vec<Vec<usize>> = groups.into_values().collect();
        let counts = (0..RESAMPLES)
            .into_par_iter()
            .map(|resample| {
                let mut rng = protocol.rng("bootstrap", resample);
                let mut counts = vec![0; groups.len()];
                for _ in 0..groups.len() {
                    counts[rng.random_range(0..groups.len())] += 1;
                }
                counts
            })
            .collect();
        Self { groups, counts }
    }

    /// Number of distinct targets of the items that have a value.
    pub(crate) fn num_targets(&self, values: &[f64]) -> usize {
        let has_value = |group: &&Vec<usize>| group.iter().any(|&item| values[item].is_finite());
        self.groups.iter().filter(has_value).count()
    }

    /// How often each item is drawn, for each of the first `count` resamples.
    pub(crate) fn weights(&self, count: usize) -> impl ExactSizeIterator<Item = Vec<u32>> {
        let num_items = self.groups.iter().map(Vec::len).sum();
        self.counts[..count.min(self.counts.len())]
            .iter()
            .map(move |counts| {
                let mut weights = vec![0; num_items];
                for (group, &count) in self.groups.iter().zip(counts) {
                    for &item in group {
                        weights[item] = count;
                    }
                }
                weights
            })
    }

    /// The mean over the items of each resample. Items without a value (NaN) and resamples of only such are left out.
    pub(crate) fn means(&self, values: &[f64]) -> Vec<f64> {
        let sums: Vec<(f64, f64)> = self
            .groups
            .iter()
            .map(|group| {
                let known = group.iter().map(|&item| values[item]);
                let known = known.filter(|value| value.is_finite());
                known.fold((0.0, 0.0), |(sum, n), value| (sum + value, n + 1.0))
            })
            .collect();
        let means = self.counts.iter().map(|counts| {
            let (sum, n) = counts.iter().zip(&sums).fold(
                (0.0, 0.0),
                |(sum, n), (&count, (of_group, size))| {
                    let count = f64::from(count);
                    (sum + count * of_group, n + count * size)
                },
            );
            sum / n
        });
        means.filter(|mean| mean.is_finite()).collect()
    }

    /// Like [`Resamples::means`], but with the median.
    pub(crate) fn medians(&self, values: &[f64]) -> Vec<f64> {
        // Sort once: resamples differ only in the weights.
        let known = (0..values.len()).filter(|&item| values[item].is_finite());
        let mut order: Vec<usize> = known.collect();
        order.sort_unstable_by(|&a, &b| values[a].total_cmp(&values[b]));
        let median = |weights: Vec<u32>| -> Option<f64> {
            let weight = |item: usize| weights[item] as usize;
            let count: usize = order.iter().map(|&item| weight(item)).sum();
            let at = |place: usize| {
                let mut drawn = 0;
                let holds = |item: &&usize| {
                    drawn += weight(**item);
                    place < drawn
                };
                order.iter().find(holds).map(|&item| values[item])
            };
            let upper = at(count / 2)?;
            let lower = at((count - 1) / 2)?;
            Some(f64::midpoint(lower, upper))
        };
        self.weights(RESAMPLES).filter_map(median).collect()
    }
}

/// Positions of a resample, each repeated as often as it was drawn.
pub(crate) fn drawn(positions: &[usize], weights: &[u32]) -> Vec<usize> {
    let copies = |&item: &usize| std::iter::repeat_n(item, weights[item] as usize);
    positions.iter().flat_map(copies).collect()
}

#[cfg(test)]
mod tests {
    use datasets_spec::quantile;

    use super::*;
    use crate::metric::interval::Interval;
    use crate::protocol::SET_RESAMPLES;

    fn spread(targets: &[&str], values: &[f64]) -> f64 {
        let resamples = Resamples::new(targets.iter().copied(), &Protocol::default());
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let interval = Interval::of_resamples(mean, &resamples.means(values), &[], 0.0);
        interval.ci95.unwrap_or(0.0)
    }

    #[test]
    fn items_of_one_target_count_once() {
        let values = [1.0, 1.0, 1.0, 1.0, 5.0, 5.0, 5.0, 5.0, 3.0, 3.0, 3.0, 3.0];
        let alone = ["a", "b", "c", "d", "e", "f", "g", "h", "i", "j", "k", "l"];
        let shared = ["a", "a", "a", "a", "b", "b", "b", "b", "c", "c", "c", "c"];
        // The expected half width of a mean of n values, here twelve and three, is 1.96 * sqrt(8/3) / sqrt(n).
        let (of_twelve, of_three) = (spread(&alone, &values), spread(&shared, &values));
        // The standard deviation of 1,000 resamples has an error of about 2 %; the bound is four times that.
        assert!((of_twelve / 0.924 - 1.0).abs() < 0.1, "{of_twelve}");
        assert!((of_three / 1.848 - 1.0).abs() < 0.1, "{of_three}");
        assert_eq!(spread(&["a"; 12], &values), 0.0);
    }

    #[test]
    fn items_without_a_value_are_passed_over() {
        let resamples = Resamples::new(["a", "b", "c"].into_iter(), &Protocol::default());
        let means = resamples.means(&[2.0, f64::NAN, 2.0]);
        assert!(means.len() > RESAMPLES / 2 && means.iter().all(|mean| *mean == 2.0));
        let medians = resamples.medians(&[1.0, f64::NAN, 1.0]);
        assert!(medians.len() > RESAMPLES / 2 && medians.iter().all(|median| *median == 1.0));
    }

    #[test]
    fn medians_are_those_of_the_drawn_values() {
        let targets = ["a", "b", "c", "a", "d", "e"];
        let values = [3.0, 1.0, f64::NAN, 2.5, 8.0, 1.0];
        let resamples = Resamples::new(targets.into_iter(), &Protocol::default());
        let by_sorting = |weights: Vec<u32>| {
            let known = drawn(&[0, 1, 3, 4, 5], &weights);
            let mut values: Vec<f64> = known.into_iter().map(|item| values[item]).collect();
            quantile::median(&mut values)
        };
        let expected: Vec<f64> = resamples
            .weights(RESAMPLES)
            .filter_map(by_sorting)
            .collect();
        assert_eq!(resamples.medians(&values), expected);
    }

    #[test]
    fn a_resample_holds_each_item_as_often_as_its_target() {
        let resamples = Resamples::new(["a", "b", "a"].into_iter(), &Protocol::default());
        let mut weights = resamples.weights(SET_RESAMPLES);
        assert_eq!(weights.len(), SET_RESAMPLES);
        assert!(weights.all(|weights| weights[0] == weights[2] && weights[0] + weights[1] == 2));
        assert_eq!(drawn(&[2, 0], &[1, 5, 2]), [2, 2, 0]);
    }
}
