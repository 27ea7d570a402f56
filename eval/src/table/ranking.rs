//! The best scores of a table, and the scores that are no better than those of the identity editor.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::record::ScoreRow;

use crate::judge::{Judges, TableOf, table_of, unranked};
use crate::metric::{self, Better, Column};
use crate::names::{GIVEN, IDENTITY, REAL_DATA};
use crate::protocol::Protocol;

/// How a score compares with the other scores of its table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub(crate) struct Standing {
    /// Whether its table ranks systems.
    pub(crate) ranks_systems: bool,
    /// Whether the score is worse than that of the identity editor.
    pub(crate) behind_identity: bool,
    /// Whether no system is better, and the identity editor is worse.
    pub(crate) best: bool,
}

/// Compares each score with those of the same task, items, protocol and encoder. In a table without ranking, no score
/// is marked as best or as behind the identity editor.
pub(crate) fn standings(scores: &[ScoreRow], judges: &Judges) -> Vec<Standing> {
    let mut groups: BTreeMap<TableOf<'_>, Vec<usize>> = BTreeMap::new();
    for (place, row) in scores.iter().enumerate() {
        groups.entry(table_of(row)).or_default().push(place);
    }
    let mut standings = vec![Standing::default(); scores.len()];
    for places in groups.into_values() {
        let rows: Vec<&ScoreRow> = places.iter().map(|&place| &scores[place]).collect();
        if unranked(rows[0], rows.iter().copied(), judges).is_some() {
            continue;
        }
        for (place, found) in places.into_iter().zip(of_table(&rows)) {
            standings[place] = found;
        }
    }
    standings
}

/// Compares the scores of one table, which must be able to rank systems.
///
/// The best systems of a metric are those with the best printed value, provided that it is better than the identity
/// editor's. A system that does not edit ([`idle`]) is never best. A metric without any interval over test sets, because
/// too few targets have values of it or the values are constant, ranks nothing.
pub(super) fn of_table(scores: &[&ScoreRow]) -> Vec<Standing> {
    let idle = idle(scores);
    let mut of_metrics: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (place, row) in scores.iter().enumerate() {
        of_metrics.entry(&row.metric).or_default().push(place);
    }
    let ranked = Standing {
        ranks_systems: true,
        ..Standing::default()
    };
    let mut standings = vec![ranked; scores.len()];
    for (name, places) in of_metrics {
        let Some(metric) = metric::from_name(name) else {
            continue;
        };
        if Protocol::is_drawn_from_targets(&scores[places[0]].protocol)
            && places.iter().all(|&place| scores[place].ci95.is_none())
        {
            continue;
        }
        let column = Column::of(metric, &scores[places[0]].task);
        let given = |name: &str| {
            let place = places.iter().find(|&&place| scores[place].system == name);
            place.map(|&place| scores[place].mean)
        };
        let real = given(REAL_DATA);
        let badness = |mean: f64| badness(column, mean, real);
        let limit = given(IDENTITY).and_then(badness);
        let systems: Vec<(usize, f64)> = places
            .iter()
            .filter(|&&place| !GIVEN.contains(&scores[place].system.as_str()))
            .filter_map(|&place| Some((place, badness(scores[place].mean)?)))
            .collect();
        let best = systems
            .iter()
            .filter(|(place, _)| !idle.contains(scores[*place].system.as_str()))
            .map(|(_, found)| *found)
            .min_by(f64::total_cmp)
            .filter(|best| limit.is_none_or(|limit| *best < limit));
        for (place, found) in systems {
            let is_idle = idle.contains(scores[place].system.as_str());
            standings[place].best = !is_idle && best == Some(found);
            standings[place].behind_identity = limit.is_some_and(|limit| found > limit);
        }
    }
    standings
}

/// Systems that do not edit: their printed values equal the identity editor's in every metric that both have. They may
/// have values in metrics that the identity editor lacks, such as the fit error.
pub(super) fn idle<'a>(scores: &[&'a ScoreRow]) -> BTreeSet<&'a str> {
    let printed = |row: &ScoreRow| {
        let metric = metric::from_name(&row.metric)?;
        Some(printed(row.mean, metric.decimals))
    };
    let of_identity: BTreeMap<&str, f64> = scores
        .iter()
        .filter(|row| row.system == IDENTITY)
        .filter_map(|row| Some((row.metric.as_str(), printed(row)?)))
        .collect();
    let mut idle: BTreeMap<&str, bool> = BTreeMap::new();
    for row in scores {
        let shared = of_identity.get(row.metric.as_str()).zip(printed(row));
        if let (Some((identity, own)), false) = (shared, GIVEN.contains(&row.system.as_str())) {
            *idle.entry(&row.system).or_insert(true) &= *identity == own;
        }
    }
    let idle = idle.into_iter().filter(|(_, is_idle)| *is_idle);
    idle.map(|(system, _)| system).collect()
}

/// A value as printed, in units of its last digit.
fn printed(mean: f64, decimals: usize) -> f64 {
    let unit = 10f64.powi(decimals as i32);
    (mean * unit).round()
}

/// A number that is larger for worse values, from the value as printed. `None` if values near real data are good, but
/// there is no real data.
fn badness(column: Column, mean: f64, real: Option<f64>) -> Option<f64> {
    let printed = |mean: f64| printed(mean, column.metric.decimals);
    match column.better {
        Better::Lower => Some(printed(mean)),
        Better::Higher => Some(-printed(mean)),
        Better::NearReal => real.map(|real| (printed(mean) - printed(real)).abs()),
    }
}

/// The first value of each key, in order.
pub(super) fn distinct<T, K: PartialEq>(
    values: impl Iterator<Item = T>,
    key: impl Fn(&T) -> K,
) -> Vec<T> {
    let mut known = Vec::new();
    let is_new = |value: &T| {
        let key = key(value);
        let is_new = !known.contains(&key);
        if is_new {
            known.push(key);
        }
        is_new
    };
    values.filter(is_new).collect()
}
