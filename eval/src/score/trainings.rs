//! Averages the scores of systems that were trained several times.

use std::collections::BTreeMap;

use datasets_spec::record::ScoreRow;

use crate::metric::interval::{Interval, MIN_TARGETS};
use crate::protocol::Protocol;

/// Averages scores over trainings. Each element holds the rows of one training, all of the same items. The result has
/// one row for each task, system and metric, in the order in which they first appear. A system may be missing from some
/// trainings. Values over fewer than [`MIN_TARGETS`] targets have no interval. Rows that are equal in all trainings,
/// such as those of the identity editor, are kept unchanged.
///
/// # Panics
/// If a system has more than [`MOST_TRAININGS`](crate::metric::interval::MOST_TRAININGS) trainings.
pub fn over_trainings(trainings: &[Vec<ScoreRow>]) -> Vec<ScoreRow> {
    let mut order: Vec<&ScoreRow> = Vec::new();
    let mut values: BTreeMap<[&str; 3], Vec<Interval>> = BTreeMap::new();
    for row in trainings.iter().flatten() {
        let of_row = values
            .entry([&row.task, &row.system, &row.metric])
            .or_insert_with(|| {
                order.push(row);
                Vec::new()
            });
        of_row.push(Interval {
            mean: row.mean,
            ci95: row.ci95,
        });
    }
    order
        .into_iter()
        .map(|row| {
            let of_trainings = &values[&[&*row.task, &*row.system, &*row.metric]];
            let Interval { mean, ci95 } = Interval::over_trainings(of_trainings);
            // Without the variance over items, the interval would be too narrow. If few targets have a value of a metric,
            // no training gives it an interval.
            let has_variance = !Protocol::is_drawn_from_targets(&row.protocol)
                || of_trainings.iter().any(|value| value.ci95.is_some());
            let is_known = row.targets == 0 || (row.targets >= MIN_TARGETS && has_variance);
            ScoreRow {
                mean,
                ci95: ci95.filter(|_| is_known),
                ..row.clone()
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::names::IDENTITY;

    fn row(system: &str, mean: f64, ci95: Option<f64>) -> ScoreRow {
        ScoreRow {
            system: system.to_owned(),
            task: "style".to_owned(),
            metric: "FS".to_owned(),
            mean,
            ci95,
            ..crate::table::tests::sample_scores("style")[0].clone()
        }
    }

    #[test]
    fn the_mean_of_trainings_has_the_variance_of_items_and_that_between_trainings() {
        let identity = row(IDENTITY, 0.9, Some(0.3));
        let trainings = [1.0, 2.0, 3.0].map(|mean| {
            vec![
                identity.clone(),
                row("ours", mean, Some(mean)),
                row("constant", 4.0, None),
            ]
        });
        let all = over_trainings(&trainings);
        assert_eq!(all.len(), 3);
        // The mean of the squared half widths (1, 4, 9), plus t² / 3 times the sample variance between trainings (1).
        let wide = (14.0f64 / 3.0 + 4.303 * 4.303 / 3.0).sqrt();
        for (row, mean, ci95, tolerance) in [(&all[0], 0.9, 0.3, 1e-12), (&all[1], 2.0, wide, 1e-9)]
        {
            assert!((row.mean - mean).abs() < 1e-12);
            assert!((row.ci95.expect("varies") - ci95).abs() < tolerance);
        }
        assert_eq!((all[2].mean, all[2].ci95), (4.0, None));
        // A metric that few targets have: its trainings differ, and none has an interval.
        let of_targets = |mean: f64| ScoreRow {
            protocol: "95 % intervals from 1000 draws of the targets".to_owned(),
            targets: 40,
            ..row("ours", mean, None)
        };
        let few = [1.0, 2.0, 3.0].map(|mean| vec![of_targets(mean)]);
        let all = over_trainings(&few);
        assert_eq!((all[0].mean, all[0].ci95), (2.0, None));
    }

    #[test]
    fn one_training_stays_as_it_is_and_a_system_may_have_fewer_than_others() {
        let first = vec![row("ours", 0.1, Some(0.7)), row("once", 0.3, Some(0.2))];
        assert_eq!(over_trainings(std::slice::from_ref(&first)), first);
        let all = over_trainings(&[first.clone(), vec![row("ours", 0.1, Some(0.7))]]);
        assert!((all[0].ci95.expect("items") - 0.7).abs() < 1e-12);
        assert_eq!(all[1], first[1]);
    }
}
