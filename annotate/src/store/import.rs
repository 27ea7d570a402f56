//! Import of tasks into the store.

use super::db::{Tx, params};
use super::draw::{draw, percent};
use super::entry::{Body, Entry, LoggedTask};
use super::project;
use super::records::{Imported, Millis, NewTask};
use super::{log, rows};
use crate::Error;
use crate::wire::Settings;

/// What the key of a gold task has before that of the task it was copied from.
pub(super) const GOLD_KEY: &str = "gold:";
/// Answers wanted for a gold task: one of everybody.
const GOLD_WANTED: u32 = 1_000_000;

/// Imports tasks; tasks with a known key stay unchanged.
pub(super) fn import(
    tx: &mut dyn Tx,
    actor: Option<i64>,
    tasks: &[NewTask],
    now: Millis,
) -> Result<Imported, Error> {
    let settings = project::settings(tx)?;
    let mut done = Imported::default();
    let mut next = 1 + tx.number("SELECT COALESCE(MAX(id), 0) FROM task", &[])?;
    for task in tasks {
        if tx
            .one("SELECT 1 FROM task WHERE key = ?1", params![&task.key])?
            .is_some()
        {
            done.known += 1;
            continue;
        }
        put_task(tx, actor, next, task, &settings, now)?;
        done.new += 1;
        next += 1;
    }
    Ok(done)
}

fn put_task(
    tx: &mut dyn Tx,
    actor: Option<i64>,
    id: i64,
    task: &NewTask,
    settings: &Settings,
    now: Millis,
) -> Result<(), Error> {
    // All tasks of a bundle go to the same people.
    let group = task.bundle.as_deref().unwrap_or(&task.key);
    let wanted = if task.gold.is_some() {
        GOLD_WANTED
    } else if percent(&["overlap", group]) < settings.overlap_percent {
        settings.answers_per_task
    } else {
        1
    };
    // Ids of bundles are below 2^53, which JavaScript numbers hold exactly.
    let bundle = task
        .bundle
        .as_deref()
        .map(|name| (draw(&["bundle", name]) >> 12) as i64);
    let entry = Entry {
        at: now,
        actor,
        task: Some(id),
        epoch: None,
        body: Body::Imported {
            task: Box::new(LoggedTask {
                key: task.key.clone(),
                kind: task.kind,
                source: task.source.clone(),
                target: task.target.clone(),
                split: task.split.clone(),
                bundle,
                bundle_index: task.bundle_index,
                category: task.category.clone(),
                hint: task.hint.clone(),
                style: task.style.clone(),
                priority: task.priority,
                shuffle: percent(&["shuffle", &task.key]).into(),
                wanted,
                gold: task.gold.clone(),
                extra: task.extra.clone(),
                accepted: task.accepted.clone(),
            }),
        },
    };
    log::note(tx, &entry)?;
    for suggestion in &task.suggestions {
        project::put_suggestion(tx, id, suggestion, now)?;
    }
    Ok(())
}

/// Copies an accepted task as a hidden gold task.
pub(super) fn make_gold(tx: &mut dyn Tx, actor: i64, id: i64, now: Millis) -> Result<i64, Error> {
    let task = rows::task(tx, id)?;
    let row = tx.one("SELECT answer FROM accepted WHERE task = ?1", params![id])?;
    let Some(row) = row else {
        return Err(Error::wrong_state(
            task.state,
            "made gold; only accepted tasks can",
        ));
    };
    let key = format!("{GOLD_KEY}{}", task.key);
    if tx
        .one("SELECT 1 FROM task WHERE key = ?1", params![&key])?
        .is_some()
    {
        return Err(Error::wrong_state(task.state, "made gold twice"));
    }
    let gold = NewTask {
        key,
        kind: task.kind,
        source: task.source,
        target: task.target,
        split: task.split,
        bundle: None,
        bundle_index: 0,
        category: task.category,
        hint: task.hint,
        style: task.style,
        priority: 0,
        gold: Some(row.json(0)?),
        extra: None,
        // Without drafts it would be told from other tasks.
        suggestions: project::drafts_of(tx, id)?,
        accepted: None,
    };
    let next = 1 + tx.number("SELECT COALESCE(MAX(id), 0) FROM task", &[])?;
    let settings = project::settings(tx)?;
    put_task(tx, Some(actor), next, &gold, &settings, now)?;
    Ok(next)
}
