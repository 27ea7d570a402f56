//! Inter-annotator agreement: raw agreement, Krippendorff's alpha, Gwet's AC1 and alpha with the MASI distance of joint sets, with
//! bootstrap intervals.
//!
//! The bootstrap resamples whole items, so an interval estimates the variation over items, not over
//! people. A figure needs at least [`MIN_ITEMS`] items.
//!
//! # Source
//! Krippendorff 2011 (alpha), Gwet 2008 (AC1), Passonneau 2006 (MASI).

use std::collections::BTreeMap;

use datasets_spec::quantile::quantile;
use datasets_spec::{JointSet, Seed};
use rand::RngExt;

use crate::mask::jaccard;
use crate::wire::{Estimate, PartAgreement};

/// Minimum number of items of a figure.
pub const MIN_ITEMS: usize = 30;
/// Bootstrap resamples of an interval.
const RESAMPLES: usize = 400;

/// Answers to one item, each as (user id, label).
pub type Item = Vec<(i64, usize)>;

/// Items with two answers or more.
fn shared<T>(items: &[Vec<T>]) -> Vec<&Vec<T>> {
    items.iter().filter(|item| item.len() > 1).collect()
}

/// A figure with its 95 % bootstrap interval, or `None` below [`MIN_ITEMS`] items.
pub fn estimate<T: Sync>(
    items: &[T],
    figure: impl Fn(&[&T]) -> Option<f64> + Sync,
) -> Option<Estimate> {
    if items.len() < MIN_ITEMS {
        return None;
    }
    let all: Vec<&T> = items.iter().collect();
    let value = figure(&all)?;
    let mut rng = Seed(0).rng(&["agreement"]);
    let mut values: Vec<f64> = (0..RESAMPLES)
        .filter_map(|_| {
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

/// Share of pairs of answers to the same item that are equal, averaged over items.
pub fn raw(items: &[&Item]) -> Option<f64> {
    let shares: Vec<f64> = items
        .iter()
        .filter(|item| item.len() > 1)
        .map(|item| {
            let mut equal = 0;
            let mut pairs = 0;
            for (index, a) in item.iter().enumerate() {
                for b in &item[index + 1..] {
                    pairs += 1;
                    equal += usize::from(a.1 == b.1);
                }
            }
            equal as f64 / f64::from(pairs)
        })
        .collect();
    mean(&shares)
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Krippendorff's alpha of values with a distance. Items may have any number of answers.
pub fn alpha<T>(items: &[&Vec<T>], distance: impl Fn(&T, &T) -> f64) -> Option<f64> {
    let items: Vec<&&Vec<T>> = items.iter().filter(|item| item.len() > 1).collect();
    let values: Vec<&T> = items.iter().flat_map(|item| item.iter()).collect();
    let n = values.len() as f64;
    let mut observed = 0.0;
    for item in &items {
        let mut apart = 0.0;
        for (index, a) in item.iter().enumerate() {
            for b in &item[index + 1..] {
                apart += 2.0 * distance(a, b);
            }
        }
        observed += apart / (item.len() - 1) as f64;
    }
    observed /= n;
    let mut expected = 0.0;
    for (index, a) in values.iter().enumerate() {
        for b in &values[index + 1..] {
            expected += 2.0 * distance(a, b);
        }
    }
    expected /= n * (n - 1.0);
    ratio(observed, expected)
}

/// `1 - observed / expected`; 1 where both are zero.
fn ratio(observed: f64, expected: f64) -> Option<f64> {
    if expected > 0.0 {
        Some(1.0 - observed / expected)
    } else {
        (observed == 0.0).then_some(1.0)
    }
}

/// Krippendorff's alpha of nominal labels: [`alpha`] with distance 0 or 1, computed from counts in linear time.
pub fn nominal_alpha(items: &[&Item]) -> Option<f64> {
    let mut totals: BTreeMap<usize, f64> = BTreeMap::new();
    let mut n = 0.0;
    let mut observed = 0.0;
    for item in items.iter().filter(|item| item.len() > 1) {
        let size = item.len() as f64;
        let mut counts: BTreeMap<usize, f64> = BTreeMap::new();
        for (_, label) in *item {
            *counts.entry(*label).or_default() += 1.0;
            *totals.entry(*label).or_default() += 1.0;
        }
        n += size;
        let equal: f64 = counts.values().map(|count| count * (count - 1.0)).sum();
        observed += (size * (size - 1.0) - equal) / (size - 1.0);
    }
    if n < 2.0 {
        return None;
    }
    let equal: f64 = totals.values().map(|count| count * (count - 1.0)).sum();
    let expected = (n * (n - 1.0) - equal) / (n - 1.0);
    ratio(observed / n, expected / n)
}

fn chance_corrected(agreed: f64, chance: f64) -> Option<f64> {
    // All labels are equal, so it is undefined; count full agreement as 1.
    if 1.0 - chance < 1e-12 {
        return (1.0 - agreed < 1e-12).then_some(1.0);
    }
    Some((agreed - chance) / (1.0 - chance))
}

/// Gwet's AC1 over `labels` labels. Unlike alpha it stays high where nearly all labels are equal.
pub fn ac1(items: &[&Item], labels: usize) -> Option<f64> {
    let agreed = raw(items)?;
    let mut shares = vec![0.0; labels.max(2)];
    let counted: Vec<&&Item> = items.iter().filter(|item| item.len() > 1).collect();
    for item in &counted {
        for (_, label) in item.iter() {
            if let Some(share) = shares.get_mut(*label) {
                *share += 1.0 / item.len() as f64;
            }
        }
    }
    let n = counted.len() as f64;
    let q = shares.len() as f64;
    let chance: f64 = shares
        .iter()
        .map(|share| share / n * (1.0 - share / n))
        .sum::<f64>()
        / (q - 1.0);
    chance_corrected(agreed, chance)
}

/// All agreement figures of one decision.
pub fn figures(part: &str, items: &[Item], labels: usize) -> PartAgreement {
    let shared: Vec<Item> = shared(items).into_iter().cloned().collect();
    PartAgreement {
        part: part.to_owned(),
        items: shared.len(),
        raw: estimate(&shared, raw),
        krippendorff_alpha: estimate(&shared, nominal_alpha),
        gwet_ac1: estimate(&shared, |items| ac1(items, labels)),
    }
}

/// MASI distance: `1 - J * M`, with the Jaccard index `J` and the monotonicity weight `M` (1 for equal sets,
/// 2/3 for a subset, 1/3 for overlap, 0 for disjoint sets).
pub fn masi(a: JointSet, b: JointSet) -> f64 {
    let common = a.intersection(b);
    let monotonicity = if a == b {
        1.0
    } else if common == a || common == b {
        2.0 / 3.0
    } else if !common.is_empty() {
        1.0 / 3.0
    } else {
        0.0
    };
    1.0 - jaccard(a, b) * monotonicity
}

/// Krippendorff's alpha with the MASI distance. Equal sets are counted, so each distinct pair is compared once.
pub fn masi_alpha(items: &[&Vec<JointSet>]) -> Option<f64> {
    let items: Vec<&&Vec<JointSet>> = items.iter().filter(|item| item.len() > 1).collect();
    let mut totals: BTreeMap<Vec<usize>, (JointSet, f64)> = BTreeMap::new();
    let mut n = 0.0;
    let mut observed = 0.0;
    for item in &items {
        for (index, a) in item.iter().enumerate() {
            let key = a.iter().map(datasets_spec::Joint::index).collect();
            totals.entry(key).or_insert((*a, 0.0)).1 += 1.0;
            n += 1.0;
            for b in &item[index + 1..] {
                observed += 2.0 * masi(*a, *b) / (item.len() - 1) as f64;
            }
        }
    }
    if n < 2.0 {
        return None;
    }
    let sets: Vec<&(JointSet, f64)> = totals.values().collect();
    let mut expected = 0.0;
    for (index, (a, count)) in sets.iter().enumerate() {
        for (b, other) in &sets[index + 1..] {
            expected += 2.0 * count * other * masi(*a, *b);
        }
    }
    ratio(observed / n, expected / (n * (n - 1.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn items(rows: &[&[(i64, usize)]]) -> Vec<Item> {
        rows.iter().map(|row| row.to_vec()).collect()
    }

    fn all(items: &[Item]) -> Vec<&Item> {
        items.iter().collect()
    }

    fn near(found: Option<f64>, expected: f64) {
        let found = found.expect("a figure");
        assert!(
            (found - expected).abs() < 5e-4,
            "{found}, expected {expected}"
        );
    }

    /// Krippendorff's example of 2011: four observers, twelve units, missing data; nominal alpha 0.743.
    #[test]
    fn krippendorffs_example() {
        let table = [
            [
                Some(1),
                Some(2),
                Some(3),
                Some(3),
                Some(2),
                Some(1),
                Some(4),
                Some(1),
                Some(2),
                None,
                None,
                None,
            ],
            [
                Some(1),
                Some(2),
                Some(3),
                Some(3),
                Some(2),
                Some(2),
                Some(4),
                Some(1),
                Some(2),
                Some(5),
                None,
                Some(3),
            ],
            [
                None,
                Some(3),
                Some(3),
                Some(3),
                Some(2),
                Some(3),
                Some(4),
                Some(2),
                Some(2),
                Some(5),
                Some(1),
                None,
            ],
            [
                Some(1),
                Some(2),
                Some(3),
                Some(3),
                Some(2),
                Some(4),
                Some(4),
                Some(1),
                Some(2),
                Some(5),
                Some(1),
                None,
            ],
        ];
        let units: Vec<Item> = (0..12)
            .map(|unit| {
                (0..4)
                    .filter_map(|observer| {
                        table[observer][unit].map(|label| (observer as i64, label))
                    })
                    .collect()
            })
            .collect();
        near(nominal_alpha(&all(&units)), 0.743);
        near(
            alpha(&all(&units), |a, b| f64::from(u8::from(a.1 != b.1))),
            0.743,
        );
    }

    /// Two raters, fifty items: 20 yes-yes, 5 yes-no, 10 no-yes, 15 no-no.
    #[test]
    fn ac1_by_hand() {
        let mut rows: Vec<Item> = Vec::new();
        for (count, a, b) in [(20, 1, 1), (5, 1, 0), (10, 0, 1), (15, 0, 0)] {
            rows.extend(vec![vec![(1, a), (2, b)]; count]);
        }
        near(raw(&all(&rows)), 0.7);
        // By hand: the mean share of yes is 0.55, chance 2 * 0.55 * 0.45 = 0.495.
        near(ac1(&all(&rows), 2), (0.7 - 0.495) / (1.0 - 0.495));
    }

    /// 118 yes-yes, 5 yes-no, 2 no-yes, 0 no-no: alpha falls below zero although people agree, AC1 does
    /// not (Gwet 2008, Table 1 has 0.944 agreement, AC1 0.941).
    #[test]
    fn one_dominant_label_breaks_alpha_and_not_ac1() {
        let mut rows: Vec<Item> = Vec::new();
        for (count, a, b) in [(118, 1, 1), (5, 1, 0), (2, 0, 1)] {
            rows.extend(vec![vec![(1, a), (2, b)]; count]);
        }
        near(raw(&all(&rows)), 0.944);
        near(ac1(&all(&rows), 2), 0.9408);
        assert!(nominal_alpha(&all(&rows)).expect("a figure") < 0.0);
    }

    #[test]
    fn perfect_and_random_answers() {
        let perfect: Vec<Item> = (0..60)
            .map(|item| vec![(1, item % 2), (2, item % 2), (3, item % 2)])
            .collect();
        for figure in [raw, nominal_alpha] {
            near(figure(&all(&perfect)), 1.0);
        }
        near(ac1(&all(&perfect), 2), 1.0);
        let mut rng = Seed(5).rng(&["test"]);
        let random: Vec<Item> = (0..4000)
            .map(|_| {
                (0..3)
                    .map(|rater| (rater, usize::from(rng.random::<bool>())))
                    .collect()
            })
            .collect();
        // Three standard errors of 12,000 pairs.
        let found = nominal_alpha(&all(&random)).expect("a figure");
        assert!(found.abs() < 0.03, "{found}");
        let same = items(&[&[(1, 0), (2, 0)], &[(1, 0), (2, 0)]]);
        near(nominal_alpha(&all(&same)), 1.0);
    }

    #[test]
    fn items_with_one_answer_say_nothing() {
        let lonely = items(&[&[(1, 0)], &[(2, 1)]]);
        for figure in [raw, nominal_alpha] {
            assert_eq!(figure(&all(&lonely)), None);
        }
        assert_eq!(figures("x", &lonely, 2).items, 0);
    }

    #[test]
    fn masi_by_hand() {
        let set = |indices: &[usize]| JointSet::of(indices);
        for (a, b, expected) in [
            (set(&[1, 2]), set(&[1, 2]), 0.0),
            (set(&[1, 2]), set(&[1, 2, 3]), 1.0 - 2.0 / 3.0 * 2.0 / 3.0),
            (set(&[1, 2]), set(&[2, 3]), 1.0 - 1.0 / 3.0 / 3.0),
            (set(&[1]), set(&[2]), 1.0),
        ] {
            assert!((masi(a, b) - expected).abs() < 1e-12);
        }
        let items = [vec![set(&[1]), set(&[1])], vec![set(&[2]), set(&[2])]];
        let all: Vec<&Vec<JointSet>> = items.iter().collect();
        near(masi_alpha(&all), 1.0);
        let mixed = [
            vec![set(&[1]), set(&[1, 2])],
            vec![set(&[2]), set(&[2])],
            vec![set(&[3]), set(&[1])],
        ];
        let all: Vec<&Vec<JointSet>> = mixed.iter().collect();
        near(
            masi_alpha(&all),
            alpha(&all, |a, b| masi(*a, *b)).expect("a figure"),
        );
    }

    #[test]
    fn intervals_hold_their_value_and_need_thirty_items() {
        let rows: Vec<Item> = (0..29)
            .map(|item| vec![(1, item % 2), (2, item % 2)])
            .collect();
        assert_eq!(figures("x", &rows, 2).raw, None);
        let rows: Vec<Item> = (0..200)
            .map(|item| {
                vec![
                    (1, item % 2),
                    (
                        2,
                        if item % 10 == 0 {
                            1 - item % 2
                        } else {
                            item % 2
                        },
                    ),
                ]
            })
            .collect();
        let found = figures("x", &rows, 2).raw.expect("enough items");
        assert!((found.value - 0.9).abs() < 1e-12);
        assert!(found.low < 0.9 && found.high > 0.9 && found.high - found.low < 0.15);
        // The binomial half width at 0.9 and 200 items is 0.042.
        assert!(found.low > 0.83 && found.high < 0.97);
    }
}
