//! The capture plan and its progress. The plan is stored with the settings; progress is computed from the style tasks
//! at each call, so the two cannot diverge.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::MotionId;

use super::db::{Result, Tx, json, params};
use super::entry::Body;
use super::records::Millis;
use super::store::Store;
use super::{log, project};
use crate::answer::{check_style_name, check_text};
use crate::error::{Error, require};
use crate::wire::{Answer, CaptureCell, Captures, PlannedCapture, Settings, TaskState, Verdict};

/// Name under which table `setting` holds the plan.
const PLAN: &str = "captures";
/// Maximum number of cells. The style set of the paper has fewer than a thousand takes.
const MAX_CELLS: usize = 10_000;
/// Maximum number of takes of a cell.
const MAX_TAKES: u32 = 1_000;

/// A source motion and a style.
type Place = (String, String);

/// Numbers of usable and of rejected takes of a cell.
#[derive(Default)]
struct Takes {
    arrived: u32,
    rejected: u32,
}

impl Store {
    /// Replaces the capture plan. Its styles are added to those of the project. Refused with `invalid`.
    pub fn plan_captures(&self, actor: i64, cells: Vec<PlannedCapture>, now: Millis) -> Result<()> {
        self.write(move |tx| {
            check(&cells, &project::settings(tx)?)?;
            let mut named = BTreeSet::new();
            let styles = cells.iter().map(|cell| cell.style.as_str());
            let styles: Vec<&str> = styles.filter(|style| named.insert(*style)).collect();
            project::add_styles(tx, Some(actor), styles, now)?;
            project::put(tx, PLAN, &json(&cells)?)?;
            log::note(tx, now, Some(actor), None, Body::CapturesPlanned { cells })
        })
    }

    /// The capture plan with its progress; empty without a plan.
    pub fn captures(&self) -> Result<Captures> {
        self.read(captures)
    }
}

fn check(cells: &[PlannedCapture], settings: &Settings) -> Result<()> {
    let problem = format!("{} cells are too many; plan up to {MAX_CELLS}", cells.len());
    require(cells.len() <= MAX_CELLS, "cells", problem)?;
    let (mut places, mut styles) = (BTreeSet::new(), BTreeSet::new());
    for (index, cell) in cells.iter().enumerate() {
        let PlannedCapture {
            motion,
            style,
            takes,
        } = cell;
        let refuse = |field: &str, problem: String| {
            let place = format!("cells.{index}.{field}");
            let problem = format!("{motion:?} in style {style:?}: {problem}");
            Err(Error::invalid(&place, problem))
        };
        if let Err(error) = MotionId::parse(motion) {
            return refuse("motion", error.to_string());
        }
        if style.is_empty() {
            return refuse("style", "the style is missing".to_owned());
        }
        let check_style =
            || check_text("style", style).and_then(|()| check_style_name(style, settings));
        if styles.insert(style)
            && let Err(error) = check_style()
        {
            return refuse("style", error.problem().detail);
        }
        if !(1..=MAX_TAKES).contains(takes) {
            return refuse("takes", format!("plan 1 to {MAX_TAKES} takes, not {takes}"));
        }
        if !places.insert((motion, style)) {
            let problem = "it is planned twice; write the sum of the takes once";
            return refuse("motion", problem.to_owned());
        }
    }
    Ok(())
}

fn captures(tx: &mut dyn Tx) -> Result<Captures> {
    let sql = "SELECT body FROM setting WHERE name = ?1";
    let plan: Option<Vec<PlannedCapture>> = tx.find(sql, params![PLAN])?;
    let plan = plan.unwrap_or_default();
    if plan.is_empty() {
        return Ok(Captures::default());
    }
    let known: Vec<String> = tx.list("SELECT id FROM motion WHERE current = 1", &[])?;
    let known = BTreeSet::from_iter(known);
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
fn takes(tx: &mut dyn Tx) -> Result<(BTreeMap<Place, Takes>, u32)> {
    let sql = "SELECT m.id, t.style, t.state, t.changed, a.answer FROM task t JOIN motion m ON m.hash = t.source
         LEFT JOIN accepted a ON a.task = t.id WHERE t.kind = 'style' AND t.gold IS NULL";
    let (mut all, mut without_style) = (BTreeMap::<Place, Takes>::new(), 0);
    for (motion, label, state, changed, answer) in tx.list(sql, &[])? {
        let (style, rejected) = judged(label, state, changed, answer);
        match (style, rejected) {
            (Some(style), true) => all.entry((motion, style)).or_default().rejected += 1,
            (Some(style), false) => all.entry((motion, style)).or_default().arrived += 1,
            (None, true) => {}
            (None, false) => without_style += 1,
        }
    }
    Ok((all, without_style))
}

/// The style of a pair, and whether the pair was rejected. As in an export, the style is that of an accepted answer
/// that keeps the pair; before acceptance, it is the dataset's label. A rejection does not apply to a clip that was
/// ingested again.
fn judged(
    label: Option<String>,
    state: TaskState,
    changed: bool,
    answer: Option<Answer>,
) -> (Option<String>, bool) {
    match answer {
        Some(Answer::Style {
            verdict: Verdict::Keep,
            style,
            ..
        }) => (style.or(label), false),
        Some(_) => (label, !changed),
        None => (label, state == TaskState::Dropped && !changed),
    }
}
