//! Import of tasks into the store, and of answers into tasks that exist.

use std::collections::BTreeSet;

use super::db::{Result, Tx, params};
use super::draw::{draw, percent, wanted};
use super::entry::{Body, LoggedTask};
use super::leases::Turn;
use super::records::{Imported, Millis, NewTask};
use super::store::Store;
use super::{log, project, read, rows, rules};
use crate::Error;
use crate::answer;
use crate::wire::{Answer, GuideChange, Settings, SettingsChange, TaskKind, TaskState};

/// Prefix that turns the key of a task into the key of its gold copy.
pub(super) const GOLD_KEY: &str = "gold:";
/// Number of answers that a gold task wants: so many that everybody can answer it.
const GOLD_WANTED: u32 = 1_000_000;

impl Store {
    /// Changes the settings that a client wants changed, and leaves the others as they are. A changed number of people is
    /// applied, in batches, to all tasks that still want answers. Refused with `invalid`, and with `setting_changed` if
    /// somebody changed one of these settings after the client read them.
    pub fn change_settings(&self, actor: i64, change: SettingsChange, now: Millis) -> Result<()> {
        self.write(move |tx| {
            let settings = project::changed_settings(tx, &change)?;
            project::put_settings(tx, Some(actor), settings, now)
        })?;
        while !self.write(move |tx| retarget(tx, actor, now))? {}
        Ok(())
    }

    /// Changes the guidelines of a kind of task. Refused with `invalid`, and with `setting_changed` if they are no longer
    /// as the client read them.
    pub fn change_guide(
        &self,
        actor: i64,
        kind: TaskKind,
        change: GuideChange,
        now: Millis,
    ) -> Result<()> {
        self.write(move |tx| {
            let mut settings = project::settings(tx)?;
            let stored = settings.guides.get(&kind).cloned().unwrap_or_default();
            if stored != change.was && stored != change.now {
                return Err(project::setting_changed(&format!("guides.{kind}")));
            }
            settings.guides.insert(kind, change.now);
            project::put_settings(tx, Some(actor), settings, now)
        })
    }

    /// Imports tasks. Tasks whose key exists stay unchanged, unless nobody has worked on them: then an accepted answer
    /// fills them, or replaces a label that was imported from the dataset. A task with a known key and other motions is
    /// left out.
    pub fn import(&self, actor: Option<i64>, tasks: Vec<NewTask>, now: Millis) -> Result<Imported> {
        let mut done = Imported::default();
        for group in tasks.chunks(project::AT_ONCE) {
            let group = group.to_vec();
            let some = self.write(move |tx| import(tx, actor, &group, now))?;
            done.new += some.new;
            done.known += some.known;
            done.filled += some.filled;
            done.conflicts.extend(some.conflicts);
            done.earlier.extend(some.earlier);
            done.others.extend(some.others);
        }
        Ok(done)
    }

    /// The keys among these that tasks have already.
    pub fn known_keys(&self, keys: Vec<String>) -> Result<BTreeSet<String>> {
        self.read(|tx| {
            let mut known = BTreeSet::new();
            for key in keys {
                if tx.has("SELECT 1 FROM task WHERE key = ?1", params![key])? {
                    known.insert(key);
                }
            }
            Ok(known)
        })
    }

    /// Copies an accepted task as a hidden gold task, to measure people, and returns the id of the copy. Refused with
    /// `wrong_state`, `not_found`.
    pub fn make_gold(&self, actor: i64, task: i64, now: Millis) -> Result<i64> {
        self.write(move |tx| copy_known(tx, actor, task, false, now))
    }

    /// Copies an accepted task as a practice task, which shows the known answer afterwards, and returns the id of the
    /// copy. Refused with `wrong_state`, `not_found`.
    pub fn make_practice(&self, actor: i64, task: i64, now: Millis) -> Result<i64> {
        self.write(move |tx| copy_known(tx, actor, task, true, now))
    }
}

fn import(tx: &mut dyn Tx, actor: Option<i64>, tasks: &[NewTask], now: Millis) -> Result<Imported> {
    project::add_styles(tx, actor, tasks.iter().flat_map(styles), now)?;
    let settings = project::settings(tx)?;
    let mut done = Imported::default();
    let mut next = tx.next_id("task")?;
    for task in tasks {
        let sql = "SELECT id, source, target FROM task WHERE key = ?1";
        let known: Option<(i64, String, Option<String>)> = tx.find(sql, params![task.key])?;
        match (known, &task.accepted) {
            (None, _) => {
                put_task(tx, actor, next, task, false, &settings, now)?;
                done.new += 1;
                next += 1;
            }
            // A key does not tell the motions: `stance pairs` with another seed gives known ids to other sources.
            (Some((_, source, target)), _)
                if (&source, &target) != (&task.source, &task.target) =>
            {
                done.others.push(task.key.clone());
            }
            (Some(_), None) => done.known += 1,
            (Some((id, ..)), Some(answer)) => fill(tx, actor, id, task, answer, &mut done, now)?,
        }
    }
    Ok(done)
}

/// Styles that a task names: the label of its pair, and the style of its answer.
fn styles(task: &NewTask) -> impl Iterator<Item = &str> {
    let label = match task.kind {
        TaskKind::Style => task.style.as_deref(),
        TaskKind::MaskText | TaskKind::Pair => None,
    };
    let answered = match &task.accepted {
        Some(Answer::Style { style, .. }) => style.as_deref(),
        _ => None,
    };
    label.into_iter().chain(answered)
}

/// Accepts an imported answer to a known task about the same motions, unless the task has another answer, or somebody
/// is working on it or has decided about it. A label of the dataset is replaced by the label that the dataset has now, and
/// by an answer that names its author and becomes equal rows in the dataset.
fn fill(
    tx: &mut dyn Tx,
    actor: Option<i64>,
    id: i64,
    new: &NewTask,
    answer: &Answer,
    done: &mut Imported,
    now: Millis,
) -> Result<()> {
    let credit = new.credit.as_ref();
    let of_dataset = credit.is_some_and(|credit| credit.of_dataset);
    let names_author = credit.is_some_and(|credit| credit.author.is_some());
    let agrees = |ours: &Answer| match of_dataset {
        true => answer::are_stored_alike(ours, answer),
        false => answer::says(ours, answer),
    };
    let mut gives_way = false;
    if let Some(accepted) = read::accepted_answer(tx, id)? {
        let is_label = tx.number(
            "SELECT COUNT(*) FROM accepted WHERE task = ?1 AND basis LIKE 'import.dataset%'",
            params![id],
        )? > 0;
        let is_alike = answer::are_stored_alike(&accepted, answer);
        gives_way = is_label
            && match of_dataset {
                true => !is_alike,
                false => is_alike && names_author,
            };
        if !gives_way && agrees(&accepted) {
            done.known += 1;
            return Ok(());
        }
    }
    let touched = tx.number(
        "SELECT (SELECT COUNT(*) FROM revision WHERE task = ?1) + (SELECT COUNT(*) FROM lease WHERE task = ?1)
           + (SELECT COUNT(*) FROM review WHERE task = ?1)",
        params![id],
    )?;
    let task = rows::task(tx, id)?;
    let is_open = task.state == TaskState::Open || gives_way;
    if touched > 0 || !is_open || task.gold.is_some() {
        let ever = read::answers_ever(tx, id)?;
        let had_it = ever.iter().any(agrees);
        let keys = if had_it {
            &mut done.earlier
        } else {
            &mut done.conflicts
        };
        keys.push(new.key.clone());
        return Ok(());
    }
    let body = Body::Filled {
        answer: answer.clone(),
        credit: new.credit.clone(),
        extra: new.extra.clone(),
    };
    log::note(tx, now, actor, Some(id), body)?;
    done.filled += 1;
    Ok(())
}

fn put_task(
    tx: &mut dyn Tx,
    actor: Option<i64>,
    id: i64,
    task: &NewTask,
    practice: bool,
    settings: &Settings,
    now: Millis,
) -> Result<()> {
    // Ids of bundles are below 2^52, so that JavaScript numbers hold them exactly.
    let bundle = task
        .bundle
        .as_deref()
        .map(|name| (draw(&["bundle", name]) >> 12) as i64);
    let wanted = if task.gold.is_some() {
        GOLD_WANTED
    } else {
        wanted(settings, &task.key, bundle)
    };
    let body = Body::Imported {
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
            edit_type: task.edit_type,
            priority: task.priority,
            shuffle: percent(&["shuffle", &task.key]).into(),
            wanted,
            gold: task.gold.clone(),
            practice,
            extra: task.extra.clone(),
            accepted: task.accepted.clone(),
            credit: task.credit.clone(),
        }),
    };
    log::note(tx, now, actor, Some(id), body)?;
    for suggestion in &task.suggestions {
        project::put_suggestion(tx, id, suggestion, now)?;
    }
    Ok(())
}

/// Maximum number of tasks that one transaction of [`retarget`] checks.
const RETARGETED_AT_ONCE: i64 = 1000;

/// Updates a batch of tasks that still want answers to the number of people in the settings, and returns whether all
/// tasks are up to date. Existing answers and leases are kept, so a task never wants fewer.
pub(super) fn retarget(tx: &mut dyn Tx, actor: i64, now: Millis) -> Result<bool> {
    let Some(after) = project::get(tx, project::RETARGETING)? else {
        return Ok(true);
    };
    let after: i64 = after.parse().unwrap_or(0);
    let turn = Turn::of(tx, actor, now)?;
    let found: Vec<(i64, String, Option<i64>, u32, u32)> = tx.list(
        "SELECT id, key, bundle, wanted, submitted + leases FROM task
         WHERE id > ?1 AND gold IS NULL AND state IN ('open', 'leased', 'returned') ORDER BY id LIMIT ?2",
        params![after, RETARGETED_AT_ONCE],
    )?;
    for (task, key, bundle, before, taken) in &found {
        let wanted = wanted(&turn.settings, key, *bundle).max(*taken);
        if wanted == *before {
            continue;
        }
        let body = Body::Retargeted { wanted };
        log::note(tx, now, Some(actor), Some(*task), body)?;
        rules::on_answer(tx, &turn, *task)?;
    }
    if let Some((last, ..)) = found.last() {
        project::put(tx, project::RETARGETING, &last.to_string())?;
        return Ok(false);
    }
    let sql = "DELETE FROM setting WHERE name = ?1";
    tx.run(sql, params![project::RETARGETING])?;
    Ok(true)
}

/// Copies an accepted task as a gold or a practice task.
fn copy_known(tx: &mut dyn Tx, actor: i64, id: i64, practice: bool, now: Millis) -> Result<i64> {
    let task = rows::task(tx, id)?;
    let (name, prefix) = if practice {
        ("practice", "practice:")
    } else {
        ("gold", GOLD_KEY)
    };
    let refuse = |why: &str| Err(Error::wrong_state(task.state, &format!("made {name}{why}")));
    let Some(known) = read::accepted_answer(tx, id)? else {
        return refuse("; only accepted tasks can");
    };
    let key = format!("{prefix}{}", task.key);
    if tx.has("SELECT 1 FROM task WHERE key = ?1", params![&key])? {
        return refuse(" twice");
    }
    let copy = NewTask {
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
        // The edit type is in the known answer.
        edit_type: None,
        priority: 0,
        gold: Some(known),
        extra: None,
        // Copy the drafts too: without drafts, annotators could recognise a gold task.
        suggestions: project::drafts_where(tx, "task = ?1 ORDER BY id", params![id])?,
        accepted: None,
        credit: None,
    };
    let next = tx.next_id("task")?;
    let settings = project::settings(tx)?;
    put_task(tx, Some(actor), next, &copy, practice, &settings, now)?;
    Ok(next)
}
