//! The capture plan, and what has arrived of it. The plan is stored beside the settings; what has arrived is read from
//! the style tasks at each call, so nothing has to be kept in step.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::MotionId;

use super::db::{Row, Tx, params};
use super::entry::{Body, Entry, json};
use super::records::Millis;
use super::{log, project, rows};
use crate::Error;
use crate::answer::check_style_name;
use crate::wire::{Answer, CaptureCell, Captures, PlannedCapture, Settings, TaskState, Verdict};

/// Name of the plan in table `setting`.
const PLAN: &str = "captures";
/// Maximum number of cells. The style set of the paper has fewer than a thousand takes.
const MAX_CELLS: usize = 10_000;
/// Maximum number of takes of a cell.
const MAX_TAKES: u32 = 1_000;

/// A source motion and a style.
type Place = (String, String);

/// Takes of a cell that stand, and those that were rejected.
#[derive(Default)]
struct Takes {
    arrived: u32,
    rejected: u32,
}

fn plan(tx: &mut dyn Tx) -> Result<Vec<PlannedCapture>, Error> {
    let row = tx.one("SELECT body FROM setting WHERE name = ?1", params![PLAN])?;
    row.map_or(Ok(Vec::new()), |row| row.json(0))
}

/// Replaces the plan. Its styles join those of the project.
pub(super) fn put_plan(
    tx: &mut dyn Tx,
    actor: i64,
    cells: Vec<PlannedCapture>,
    now: Millis,
) -> Result<(), Error> {
    check(&cells, &project::settings(tx)?)?;
    let mut named = BTreeSet::new();
    let styles = cells.iter().map(|cell| cell.style.as_str());
    let styles: Vec<&str> = styles.filter(|style| named.insert(*style)).collect();
    project::add_styles(tx, Some(actor), styles, now)?;
    project::put(tx, PLAN, &json(&cells)?)?;
    let entry = Entry {
        at: now,
        actor: Some(actor),
        task: None,
        epoch: None,
        body: Body::CapturesPlanned { cells },
    };
    log::note(tx, &entry).map(|_| ())
}

fn check(cells: &[PlannedCapture], settings: &Settings) -> Result<(), Error> {
    if cells.len() > MAX_CELLS {
        return Err(Error::invalid(
            "cells",
            format!("{} cells are too many; plan up to {MAX_CELLS}", cells.len()),
        ));
    }
    let (mut places, mut styles) = (BTreeSet::new(), BTreeSet::new());
    for (index, cell) in cells.iter().enumerate() {
        let PlannedCapture {
            motion,
            style,
            takes,
        } = cell;
        let refuse = |field: &str, problem: String| {
            let place = format!("cells.{index}.{field}");
            Err(Error::invalid(
                &place,
                format!("{motion:?} in style {style:?}: {problem}"),
            ))
        };
        if let Err(error) = MotionId::parse(motion) {
            return refuse("motion", error.to_string());
        }
        if style.is_empty() {
            return refuse("style", "the style is missing".to_owned());
        }
        if styles.insert(style)
            && let Err(error) = check_style_name(style, settings)
        {
            return refuse("style", error.problem().detail);
        }
        if !(1..=MAX_TAKES).contains(takes) {
            return refuse("takes", format!("plan 1 to {MAX_TAKES} takes, not {takes}"));
        }
        if !places.insert((motion, style)) {
            return refuse(
                "motion",
                "it is planned twice; write the sum of the takes once".to_owned(),
            );
        }
    }
    Ok(())
}

/// The plan with what has arrived; empty without a plan.
pub(super) fn captures(tx: &mut dyn Tx) -> Result<Captures, Error> {
    let plan = plan(tx)?;
    if plan.is_empty() {
        return Ok(Captures::default());
    }
    let known: BTreeSet<String> = tx
        .query("SELECT id FROM motion WHERE current = 1", &[])?
        .iter()
        .map(|row| row.string(0))
        .collect::<Result<_, _>>()?;
    let (mut takes, without_style) = takes(tx)?;
    let cells = plan
        .into_iter()
        .map(|cell| {
            let place = (cell.motion, cell.style);
            let Takes { arrived, rejected } = takes.remove(&place).unwrap_or_default();
            let (motion, style) = place;
            CaptureCell {
                takes: cell.takes,
                arrived,
                rejected,
                missing: cell.takes.saturating_sub(arrived),
                known: known.contains(&motion),
                motion,
                style,
            }
        })
        .collect();
    let unplanned: u32 = takes.values().map(|left| left.arrived).sum();
    Ok(Captures {
        cells,
        unplanned: unplanned + without_style,
    })
}

/// The style pairs of the project by source motion and style, and the number of those without a style.
fn takes(tx: &mut dyn Tx) -> Result<(BTreeMap<Place, Takes>, u32), Error> {
    let sql = "SELECT m.id, t.style, t.state, t.changed, a.answer FROM task t JOIN motion m ON m.hash = t.source
         LEFT JOIN accepted a ON a.task = t.id WHERE t.kind = 'style' AND t.gold IS NULL";
    let (mut all, mut without_style) = (BTreeMap::<Place, Takes>::new(), 0);
    for row in tx.query(sql, &[])? {
        let (style, rejected) = judged(&row)?;
        match (style, rejected) {
            (Some(style), true) => all.entry((row.string(0)?, style)).or_default().rejected += 1,
            (Some(style), false) => all.entry((row.string(0)?, style)).or_default().arrived += 1,
            (None, true) => {}
            (None, false) => without_style += 1,
        }
    }
    Ok((all, without_style))
}

/// The style of a pair, and whether the pair was rejected. An accepted answer that keeps the pair says its style, as in
/// an export; before that the label of the dataset does. A rejection does not hold for a clip that was ingested anew.
fn judged(row: &Row) -> Result<(Option<String>, bool), Error> {
    let label = row.opt_text(1)?;
    let (state, changed) = (rows::state(row.text(2)?)?, row.flag(3)?);
    let answer: Option<Answer> = match row.opt_text(4)? {
        Some(_) => Some(row.json(4)?),
        None => None,
    };
    Ok(match answer {
        Some(Answer::Style {
            verdict: Verdict::Keep,
            style,
            ..
        }) => (style.or(label), false),
        Some(_) => (label, !changed),
        None => (label, state == TaskState::Dropped && !changed),
    })
}
