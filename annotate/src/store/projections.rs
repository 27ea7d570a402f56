//! Writes the projections that several kinds of entries share, and derives the state of a task from them.

use super::db::{Result, Tx, json, params};
use super::entry::Entry;
use super::records::{Credit, Millis};
use crate::Error;
use crate::state::Purpose;
use crate::wire::{Answer, EditType, Lease, TaskKind, TaskState, Verdict};

/// Whether an answer keeps a fine-grained pair, which counts toward the quota of its category.
pub(super) fn is_kept_pair(answer: &Answer) -> bool {
    answer.kind() == TaskKind::Pair && answer.verdict() == Some(Verdict::Keep)
}

/// The edit type of an answer that keeps a fine-grained pair, if it states one.
pub(super) fn kept_type(answer: &Answer) -> Option<EditType> {
    answer.fields().edit_type.filter(|_| is_kept_pair(answer))
}

/// The acceptance of an answer.
pub(super) struct Acceptance<'a> {
    pub(super) author: i64,
    pub(super) reviewer: i64,
    pub(super) answer: &'a Answer,
    pub(super) merged: bool,
    /// Author of an imported answer in its source, if it is imported.
    pub(super) credit: Option<&'a str>,
    /// Whether the answer keeps a pair.
    pub(super) keeps: bool,
    /// How the answer was accepted: `review`, `own`, `rule:NAME` or `import`, or `import:` followed by how it was
    /// accepted elsewhere; for a label of the dataset with `import.dataset` in place of `import`.
    pub(super) basis: String,
}

impl<'a> Acceptance<'a> {
    /// The acceptance of an answer with `author` as both its author and its reviewer.
    pub(super) fn by(author: i64, answer: &'a Answer, basis: String) -> Self {
        Self {
            author,
            reviewer: author,
            answer,
            merged: false,
            credit: None,
            keeps: is_kept_pair(answer),
            basis,
        }
    }

    /// The acceptance of an imported answer.
    pub(super) fn imported(answer: &'a Answer, credit: Option<&'a Credit>, entry: &Entry) -> Self {
        let elsewhere = credit.and_then(|credit| credit.accepted_by.as_deref());
        let import = match credit.is_some_and(|credit| credit.of_dataset) {
            true => "import.dataset",
            false => "import",
        };
        let basis = elsewhere.map_or(import.to_owned(), |basis| format!("{import}:{basis}"));
        Self {
            merged: credit.is_some_and(|credit| credit.merged),
            credit: credit.and_then(|credit| credit.author.as_deref()),
            ..Self::by(entry.actor.unwrap_or(0), answer, basis)
        }
    }

    /// Stores the answer as the accepted one of a task.
    pub(super) fn put(&self, tx: &mut dyn Tx, seq: i64, task: i64, at: Millis) -> Result<()> {
        tx.run(
            "INSERT INTO accepted (task, author, reviewer, answer, merged, credit, keeps, edit_type, at, seq, basis,
               words, parts)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13)",
            params![
                task,
                self.author,
                self.reviewer,
                json(self.answer)?,
                self.merged,
                self.credit,
                self.keeps,
                kept_type(self.answer),
                at,
                seq,
                self.basis,
                words(self.answer),
                part_list(self.answer)
            ],
        )
    }
}

pub(super) fn put_lease(
    tx: &mut dyn Tx,
    lease: &Lease,
    purpose: Purpose,
    blind: bool,
) -> Result<()> {
    let sql = "DELETE FROM lease WHERE task = ?1 AND usr = ?2";
    tx.run(sql, params![lease.task, lease.user])?;
    tx.run(
        "INSERT INTO lease (id, task, usr, epoch, expires, purpose, blind) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)",
        params![
            lease.id,
            lease.task,
            lease.user,
            lease.epoch,
            lease.expires,
            purpose,
            blind
        ],
    )?;
    let sql = "UPDATE task SET epoch = ?2 WHERE id = ?1";
    tx.run(sql, params![lease.task, lease.epoch])
}

pub(super) fn end_leases(tx: &mut dyn Tx, task: i64) -> Result<()> {
    tx.run("DELETE FROM lease WHERE task = ?1", params![task])
}

/// Lower-case texts of an answer, for searches.
pub(super) fn words(answer: &Answer) -> String {
    let texts: Vec<String> = answer
        .texts()
        .into_iter()
        .map(|(text, _)| text)
        .chain([answer.fields().note])
        .filter(|text| !text.is_empty())
        .map(str::to_lowercase)
        .collect();
    texts.join("\n")
}

/// Names of the parts of an answer, each between bars: `|LEFT_ARM|LOWER_BODY|`.
pub(super) fn part_list(answer: &Answer) -> String {
    barred(answer.part_names().into_iter().map(str::to_owned))
}

/// Names in one text, each between bars, so that a search finds whole names; empty without names.
pub(super) fn barred(names: impl Iterator<Item = String>) -> String {
    let names: Vec<String> = names.collect();
    if names.is_empty() {
        return String::new();
    }
    format!("|{}|", names.join("|"))
}

/// The SQL condition that decision `v` concerned the answer of a user, who is named by a column or a parameter.
pub(super) fn concerns(user: &str) -> String {
    format!("v.authors LIKE '%|' || CAST({user} AS TEXT) || '|%'")
}

pub(super) fn set_state(tx: &mut dyn Tx, task: i64, state: TaskState) -> Result<()> {
    tx.run(
        "UPDATE task SET state = ?2, claimable = 0,
           leases = (SELECT COUNT(*) FROM lease WHERE task = ?1 AND purpose <> 'review') WHERE id = ?1",
        params![task, state],
    )?;
    count(tx, task)
}

/// Derives whether a pair counts toward the quota of its category. It counts if an accepted answer keeps it, or if it
/// is undecided and a submitted answer keeps it or somebody is working on it. Work in progress counts, so that its
/// quota is reserved. A kept pair has the edit type of the answer that keeps it.
fn count(tx: &mut dyn Tx, task: i64) -> Result<()> {
    tx.run(
        "UPDATE task SET counted = CASE
             WHEN gold IS NOT NULL OR state = 'dropped' THEN 0
             WHEN state = 'accepted' THEN COALESCE((SELECT a.keeps FROM accepted a WHERE a.task = ?1), 0)
             WHEN EXISTS (SELECT 1 FROM revision r WHERE r.task = ?1 AND r.state = 'submitted' AND r.verdict = 'keep')
               OR EXISTS (SELECT 1 FROM lease l WHERE l.task = ?1 AND l.purpose <> 'review') THEN 1
             ELSE 0 END,
           kept_type = CASE
             WHEN gold IS NOT NULL OR state = 'dropped' THEN NULL
             WHEN state = 'accepted' THEN (SELECT a.edit_type FROM accepted a WHERE a.task = ?1)
             ELSE (SELECT r.edit_type FROM revision r WHERE r.task = ?1 AND r.state = 'submitted' AND r.verdict = 'keep'
                   ORDER BY r.author LIMIT 1) END
         WHERE id = ?1 AND kind = 'pair'",
        params![task],
    )
}

/// Counts the answers and leases of an undecided task and derives its state.
pub(super) fn refresh(tx: &mut dyn Tx, task: i64) -> Result<()> {
    let counts = tx.find(
        "SELECT wanted, CASE WHEN gold IS NULL THEN 0 ELSE 1 END,
           (SELECT COUNT(*) FROM revision WHERE task = ?1 AND state IN ('submitted', 'accepted', 'superseded')),
           (SELECT COUNT(*) FROM lease WHERE task = ?1 AND purpose IN ('annotate', 'assigned')),
           (SELECT COUNT(*) FROM lease WHERE task = ?1 AND purpose = 'returned')
         FROM task WHERE id = ?1",
        params![task],
    )?;
    let (wanted, gold, submitted, active, kept): (i64, bool, i64, i64, i64) =
        counts.ok_or_else(|| Error::not_found("task"))?;
    let state = if submitted >= wanted {
        TaskState::Submitted
    } else if active > 0 {
        TaskState::Leased
    } else if kept > 0 {
        TaskState::Returned
    } else {
        TaskState::Open
    };
    let claimable = !gold && submitted + active + kept < wanted;
    let sql =
        "UPDATE task SET state = ?2, submitted = ?3, leases = ?4, claimable = ?5 WHERE id = ?1";
    let values = params![task, state, submitted, active + kept, claimable];
    tx.run(sql, values)?;
    count(tx, task)
}
