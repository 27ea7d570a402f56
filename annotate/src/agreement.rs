//! Agreement of several answers to one item: means, and Gwet's AC1 of labels, with bootstrap intervals.
//!
//! The bootstrap resamples whole items, so an interval estimates the variation over items, not over
//! people. A figure needs at least [`MIN_ITEMS`] items.
//!
//! # Source
//! Gwet 2008 (AC1).

use datasets_spec::Seed;
use datasets_spec::quantile::quantile;
use rand::RngExt;

use crate::wire::{Estimate, PartAgreement};

/// Minimum number of items of a figure.
pub(crate) const MIN_ITEMS: usize = 30;
/// Bootstrap resamples of an interval.
const RESAMPLES: usize = 400;

/// The labels, numbered from 0, that two or more people gave to one item.
pub(crate) type Item = Vec<usize>;

/// A figure with its 95 % bootstrap interval, or `None` below [`MIN_ITEMS`] items.
fn estimate<T>(items: &[T], figure: impl Fn(&[&T]) -> f64) -> Option<Estimate> {
    if items.len() < MIN_ITEMS {
        return None;
    }
    let all: Vec<&T> = items.iter().collect();
    let value = figure(&all);
    let mut rng = Seed(0).rng(&["agreement"]);
    let mut values: Vec<f64> = (0..RESAMPLES)
        .map(|_| {
            let drawn: Vec<&T> = (0..items.len())
                .map(|_| &items[rng.random_range(0..items.len())])
                .collect();
            figure(&drawn)
        })
        .collect();
    let mut at = |share: f64| quantile(&mut values, share).unwrap_or(value);
    Some(Estimate {
        value,
        low: at(0.025),
        high: at(0.975),
        items: items.len(),
    })
}

/// Mean of the values; `None` if there are none.
pub(crate) fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Mean of some values with its interval.
pub(crate) fn mean_estimate(values: &[f64]) -> Option<Estimate> {
    estimate(values, |drawn| {
        drawn.iter().copied().sum::<f64>() / drawn.len() as f64
    })
}

/// Gwet's AC1 of labels `0..labels`: the agreement beyond chance, 1 for full agreement. It stays high where nearly all
/// labels are equal.
fn ac1(items: &[&Item], labels: usize) -> f64 {
    let n = items.len() as f64;
    let mut agreed = 0.0;
    let mut shares = vec![0.0; labels];
    let mut counts = vec![0.0; labels];
    for item in items {
        counts.fill(0.0);
        for label in *item {
            counts[*label] += 1.0;
        }
        let size = item.len() as f64;
        for (share, count) in shares.iter_mut().zip(&counts) {
            *share += count / size / n;
            agreed += count * (count - 1.0) / (size * (size - 1.0)) / n;
        }
    }
    let spread: f64 = shares.iter().map(|share| share * (1.0 - share)).sum();
    let chance = spread / (labels as f64 - 1.0);
    (agreed - chance) / (1.0 - chance)
}

/// Items whose labels are of different tasks: the first label is of the task itself, the second of the next task, and so on.
fn mixed(tasks: &[Vec<Item>]) -> Vec<Item> {
    let of_other = |task: usize, decision: usize, person: usize| {
        let other = &tasks[(task + person) % tasks.len()][decision];
        other[person % other.len()]
    };
    let tasks = tasks.iter().enumerate();
    let items = tasks.flat_map(|(task, decisions)| {
        let decisions = decisions.iter().enumerate();
        decisions.map(move |(decision, item)| {
            let people = 0..item.len();
            people
                .map(|person| of_other(task, decision, person))
                .collect()
        })
    });
    items.collect()
}

/// Agreement on decisions with labels `0..labels`. A task has one decision or several by the same people, so the bootstrap
/// draws tasks.
pub(crate) fn part_agreement(part: &str, tasks: &[Vec<Item>], labels: usize) -> PartAgreement {
    PartAgreement {
        chance: (tasks.len() >= MIN_ITEMS).then(|| {
            let mixed: Vec<Item> = mixed(tasks);
            ac1(&mixed.iter().collect::<Vec<_>>(), labels)
        }),
        part: part.to_owned(),
        items: tasks.len(),
        gwet_ac1: estimate(tasks, |tasks| {
            ac1(&tasks.iter().copied().flatten().collect::<Vec<_>>(), labels)
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(counts: &[(usize, usize, usize)]) -> Vec<Item> {
        let counts = counts.iter();
        counts
            .flat_map(|&(count, a, b)| vec![vec![a, b]; count])
            .collect()
    }

    #[test]
    fn ac1_by_hand() {
        // The mean share of yes is 0.55, chance 2 * 0.55 * 0.45 = 0.495.
        let yes_and_no = rows(&[(20, 1, 1), (5, 1, 0), (10, 0, 1), (15, 0, 0)]);
        for (items, labels, expected) in [
            (yes_and_no, 2, (0.7 - 0.495) / (1.0 - 0.495)),
            // Nearly all answers are equal: Gwet 2008, Table 1.
            (rows(&[(118, 1, 1), (5, 1, 0), (2, 0, 1)]), 2, 0.9408),
            (rows(&[(9, 3, 3)]), 4, 1.0),
            (vec![vec![0, 0, 0], vec![1, 1, 1]], 2, 1.0),
        ] {
            let found: f64 = ac1(&Vec::from_iter(&items), labels);
            assert!((found - expected).abs() < 5e-4, "{found} of {expected}");
        }
    }

    #[test]
    fn random_answers_do_not_agree() {
        let mut rng = Seed(5).rng(&["test"]);
        let random: Vec<Item> = (0..4000)
            .map(|_| (0..3).map(|_| rng.random_range(0..2)).collect())
            .collect();
        // The tolerance is three standard errors of 12,000 pairs.
        let found = ac1(&random.iter().collect::<Vec<_>>(), 2);
        assert!(found.abs() < 0.03, "{found}");
    }

    #[test]
    fn answers_that_do_not_look_agree_as_answers_to_other_tasks_do() {
        let mut rng = Seed(6).rng(&["test"]);
        // Each answer covers the part with probability 0.1, whatever the task shows, and AC1 is high nevertheless.
        let blind: Vec<Vec<Item>> = (0..4000)
            .map(|_| vec![(0..2).map(|_| usize::from(rng.random_bool(0.1))).collect()])
            .collect();
        let found = part_agreement("x", &blind, 2);
        let (value, chance) = (
            found.gwet_ac1.expect("items").value,
            found.chance.expect("items"),
        );
        assert!(value > 0.7, "{value}");
        // The tolerance is three standard errors of the share of equal pairs.
        assert!((value - chance).abs() < 0.04, "{value} {chance}");
        // People who answer by the task agree fully, and answers to different tasks do not.
        let seen: Vec<Vec<Item>> = (0..40).map(|task| vec![vec![task % 2; 3]]).collect();
        let found = part_agreement("x", &seen, 2);
        let value = found.gwet_ac1.expect("items").value;
        // The bound is that of a sum of rounded shares.
        assert!((value - 1.0).abs() < 1e-12, "{value}");
        assert!(found.chance.expect("items") < 0.0);
        assert_eq!(part_agreement("x", &seen[..29], 2).chance, None);
    }

    #[test]
    fn intervals_hold_their_value_and_need_thirty_items() {
        assert_eq!(mean_estimate(&[1.0; 29]), None);
        let values: Vec<f64> = (0..200)
            .map(|item| f64::from(u8::from(item % 10 > 0)))
            .collect();
        let found = mean_estimate(&values).expect("enough items");
        assert!((found.value - 0.9).abs() < 1e-12);
        // The binomial half width at 0.9 and 200 items is 0.042.
        assert!((0.83..0.9).contains(&found.low) && (0.9..0.97).contains(&found.high));
        let of_tasks = |count: usize, decisions: usize| {
            let tasks = vec![rows(&[(decisions, 0, 0)]); count];
            part_agreement("x", &tasks, 2).gwet_ac1
        };
        assert_eq!(of_tasks(29, 1), None);
        // Thirty decisions about six tasks count as six.
        assert_eq!(of_tasks(6, 5), None);
        assert_eq!(of_tasks(30, 5).map(|found| found.items), Some(30));
    }
}
