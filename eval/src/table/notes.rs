//! Sentences below a table: systems no better than the identity editor, and values left out because of too few items.

use datasets_spec::record::ScoreRow;

use super::ranking::{Standing, distinct, idle};
use crate::metric::diversity::DIVERSITY;
use crate::metric::interval::MIN_TARGETS;
use crate::metric::{Column, Metric, fid};
use crate::protocol::Protocol;

/// Names the systems that do not edit, and those worse than the identity editor in some columns.
pub(super) fn of_ranking(
    scores: &[&ScoreRow],
    standings: &[Standing],
    columns: &[Column],
) -> Vec<String> {
    let mut notes = Vec::new();
    let idle: Vec<&str> = idle(scores).into_iter().collect();
    if !idle.is_empty() {
        notes.push(format!(
            "Never marked as best, as all values are those of the identity editor: {}.",
            idle.join(", ")
        ));
    }
    // Systems that are worse in the same columns share a clause.
    let mut clauses: Vec<(Vec<&str>, Vec<&str>)> = Vec::new();
    let systems = scores.iter().map(|row| row.system.as_str());
    for system in distinct(systems, |&system| system) {
        let is_behind = |column: &&Column| {
            let mut rows = scores.iter().zip(standings);
            rows.any(|(row, standing)| {
                standing.behind_identity && row.system == system && row.metric == column.metric.name
            })
        };
        let behind: Vec<&str> = columns
            .iter()
            .filter(is_behind)
            .map(|column| column.metric.name)
            .collect();
        match clauses.iter_mut().find(|(known, _)| *known == behind) {
            _ if behind.is_empty() => {}
            Some((_, systems)) => systems.push(system),
            None => clauses.push((behind, vec![system])),
        }
    }
    let clauses: Vec<String> = clauses
        .into_iter()
        .map(|(behind, systems)| {
            let systems = systems.join(", ");
            if behind.len() == columns.len() {
                format!("{systems} in every column")
            } else {
                format!("{systems} in {}", behind.join(", "))
            }
        })
        .collect();
    if !clauses.is_empty() {
        notes.push(format!(
            "Behind the identity editor, which returns the original unchanged: {}.",
            clauses.join("; ")
        ));
    }
    notes
}

/// Names the metrics left out of a table because of too few items, and missing intervals. `row` is any score of the
/// table; scores of earlier versions, without counts, give no note.
pub(crate) fn of_shortages(row: &ScoreRow, metrics: &[&Metric]) -> Vec<String> {
    let of_metric = |metric: &&Metric| {
        if [&fid::FID, &fid::FID_RAW].contains(metric) {
            let (items, width) = (row.fid_items as usize, row.latent_width as usize);
            (width > 0).then(|| shortage_of_fid(metric.name, items, width))?
        } else if **metric == DIVERSITY {
            let needed = Protocol::diversity_pairs_of(&row.protocol)?;
            ((row.n as usize) < needed).then(|| {
                format!(
                    "{metric} is not measured: it draws {needed} pairs and needs as many items, and there {}.",
                    are(row.n as usize)
                )
            })
        } else {
            None
        }
    };
    let mut notes: Vec<String> = metrics.iter().filter_map(of_metric).collect();
    if Protocol::is_drawn_from_targets(&row.protocol) && row.targets > 0 {
        notes.extend(shortage_of_targets(row.targets));
    }
    notes
}

/// A note that there are too few items for a Fréchet distance; `None` if there are enough.
pub(crate) fn shortage_of_fid(name: &str, items: usize, latent_width: usize) -> Option<String> {
    let needed = fid::min_items(latent_width);
    (items < needed).then(|| {
        format!(
            "{name} is not measured: latents of {latent_width} numbers need {needed} items a side, and there {}.",
            are(items)
        )
    })
}

/// A note that there are too few targets for intervals; `None` if there are enough.
pub(crate) fn shortage_of_targets(targets: u32) -> Option<String> {
    (targets < MIN_TARGETS).then(|| {
        format!(
            "There are no intervals: they need {MIN_TARGETS} targets, and there {}.",
            are(targets as usize)
        )
    })
}

fn are(items: usize) -> String {
    match items {
        1 => "is 1".to_owned(),
        _ => format!("are {items}"),
    }
}
