//! Rules of acceptance: answers that need no reviewer.
//!
//! A rule applies to tasks that have all their answers (`submitted`). It skips tasks that a reviewer returned or
//! reopened: a person decides about those.

use std::collections::BTreeMap;

use super::db::{Result, Tx, params};
use super::entry::Body;
use super::leases::Turn;
use super::records::{Millis, TaskRecord};
use super::store::Store;
use super::{log, project, rows};
use crate::Error;
use crate::answer;
use crate::wire::{
    Answer, Revision, Rule, RuleKind, RuleState, RuleUndone, RulesApplied, Settings,
};

/// Maximum number of tasks that one request checks.
const AT_ONCE: i64 = 2000;
/// 100 percent: the `shuffle` of a task is a number below it.
const WHOLE: i64 = 100;

/// SQL condition: no reviewer has returned or reopened task `t`.
const UNTOUCHED: &str = "NOT EXISTS (SELECT 1 FROM review v WHERE v.task = t.id
  AND v.decision IN ('returned', 'reopened') AND v.rule IS NULL)";

impl Store {
    /// The rules of the settings, and removed rules with valid acceptances, each with its counts.
    pub fn rules(&self) -> Result<Vec<RuleState>> {
        self.read(states)
    }

    /// Applies the enabled rules to up to 2,000 tasks that wait for review, with ids above `after`.
    pub fn apply_rules(&self, after: i64, now: Millis) -> Result<RulesApplied> {
        self.write(move |tx| {
            // Rules act as user 0, which does not exist.
            let turn = Turn::of(tx, 0, now)?;
            let tasks = waiting(tx, after, i64::MAX, AT_ONCE)?;
            let (looked_at, last) = (tasks.len() as i64, tasks.last().map(|task| task.id));
            let mut done = RulesApplied {
                looked_at,
                next: last.filter(|_| looked_at == AT_ONCE),
                ..RulesApplied::default()
            };
            for task in tasks {
                if let Some(rule) = decide(tx, &turn, &task)? {
                    *done.accepted.entry(rule).or_default() += 1;
                }
            }
            Ok(done)
        })
    }

    /// Disables a rule and takes back up to 2,000 of its acceptances. Refused with `not_found`.
    pub fn undo_rule(&self, actor: i64, rule: &str, now: Millis) -> Result<RuleUndone> {
        let name = rule.to_owned();
        self.write(move |tx| {
            let mut settings = project::settings(tx)?;
            let rule = settings.rules.iter_mut().find(|rule| rule.name == name);
            let known = rule.is_some();
            if let Some(rule) = rule
                && rule.enabled
            {
                rule.enabled = false;
                project::put_settings(tx, Some(actor), settings, now)?;
            }
            let basis = format!("rule:{name}");
            let sql = "SELECT task FROM accepted WHERE basis = ?1 ORDER BY task LIMIT ?2";
            let tasks: Vec<i64> = tx.list(sql, params![&basis, AT_ONCE])?;
            if tasks.is_empty() && !known {
                return Err(Error::not_found("rule"));
            }
            for &task in &tasks {
                reopen(tx, actor, task, &name, "", now)?;
            }
            let sql = "SELECT COUNT(*) FROM accepted WHERE basis = ?1";
            Ok(RuleUndone {
                reopened: tasks.len() as i64,
                left: tx.number(sql, params![&basis])?,
            })
        })
    }
}

/// Result of applying a rule to a task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fit {
    /// The rule does not match.
    No,
    /// The rule matches, but the task was drawn for review.
    Review,
    /// The rule matches: accept the answer of this author.
    Accept(i64),
}

/// Whether a task is among the `percent` of tasks left to reviewers. The result depends only on the seed and the task,
/// and a larger share contains every smaller one.
fn is_sampled(seed: u32, task: &TaskRecord, percent: u32) -> bool {
    (task.shuffle + i64::from(seed)) % WHOLE < i64::from(percent)
}

/// What a rule does with a task that has these answers, in the order of submission, about a clip with `frames` frames.
/// An answer with a style that the project does not have is left to reviewers.
fn fit(
    rule: &Rule,
    settings: &Settings,
    task: &TaskRecord,
    answers: &[Revision],
    frames: i64,
) -> Fit {
    let (Some(first), false) = (answers.first(), task.gold.is_some()) else {
        return Fit::No;
    };
    if !rule.kinds.is_empty() && !rule.kinds.contains(&task.kind)
        || answers.len() < rule.min_answers as usize
    {
        return Fit::No;
    }
    let author = match rule.accepts {
        RuleKind::Rejects => {
            let rejects = |own: &Revision| own.answer.is_reject();
            answers.iter().all(rejects).then_some(first.author)
        }
        RuleKind::Trusted => {
            let answered = |person: &&i64| answers.iter().any(|own| own.author == **person);
            rule.people.iter().find(answered).copied()
        }
        RuleKind::Sampled => Some(first.author),
    };
    let Some(author) = author else {
        return Fit::No;
    };
    let all: Vec<_> = answers.iter().map(|own| own.answer.clone()).collect();
    if answer::spread(&all, frames).is_some_and(|distance| distance > rule.max_distance) {
        return Fit::No;
    }
    // The distance does not compare texts, which may contradict each other.
    let wants_equal = rule.accepts == RuleKind::Sampled && rule.max_distance == 0.0;
    if wants_equal && !answer::share_words(&all) {
        return Fit::No;
    }
    let new_style = |answer: &Answer| answer.new_style(settings).is_some();
    if is_sampled(settings.seed, task, rule.review_percent) || all.iter().any(new_style) {
        Fit::Review
    } else {
        Fit::Accept(author)
    }
}

/// Answers of a task that wait for review, in the order of submission.
pub(super) fn waiting_answers(tx: &mut dyn Tx, task: i64) -> Result<Vec<Revision>> {
    let condition = "r.task = ?1 AND r.state = 'submitted' ORDER BY r.at, r.author";
    rows::revisions(tx, condition, params![task])
}

/// Accepts a task if a rule matches, and returns the name of the rule.
fn decide(tx: &mut dyn Tx, turn: &Turn, task: &TaskRecord) -> Result<Option<String>> {
    let settings = &turn.settings;
    let answers = waiting_answers(tx, task.id)?;
    let frames = project::frames(tx, &task.source)?;
    for rule in settings.rules.iter().filter(|rule| rule.enabled) {
        match fit(rule, settings, task, &answers, frames) {
            Fit::No => {}
            // Only the first matching rule decides, so that a later rule does not accept what the first one left to
            // reviewers.
            Fit::Review => return Ok(None),
            Fit::Accept(author) => {
                let body = Body::Accepted {
                    author,
                    comment: String::new(),
                    secs: 0.0,
                    request: String::new(),
                    rule: Some(rule.name.clone()),
                    own: false,
                };
                log::note(tx, turn.now, None, Some(task.id), body)?;
                return Ok(Some(rule.name.clone()));
            }
        }
    }
    Ok(None)
}

/// Applies the rules to a task that has just got an answer.
pub(super) fn on_answer(tx: &mut dyn Tx, turn: &Turn, task: i64) -> Result<()> {
    if !turn.settings.rules.iter().any(|rule| rule.enabled) {
        return Ok(());
    }
    if let Some(task) = waiting(tx, task - 1, task, 1)?.pop() {
        decide(tx, turn, &task)?;
    }
    Ok(())
}

/// Waiting tasks that rules may decide, with ids above `after` up to `up_to`. Answers to a clip that was ingested anew since
/// are about another motion: a reviewer decides about them.
fn waiting(tx: &mut dyn Tx, after: i64, up_to: i64, limit: i64) -> Result<Vec<TaskRecord>> {
    let condition = format!(
        "t.state = 'submitted' AND t.gold IS NULL AND t.changed = 0 AND t.id > ?1 AND t.id <= ?2 AND {UNTOUCHED} ORDER BY t.id LIMIT ?3"
    );
    rows::tasks(tx, &condition, params![after, up_to, limit])
}

fn states(tx: &mut dyn Tx) -> Result<Vec<RuleState>> {
    let settings = project::settings(tx)?;
    let sql =
        "SELECT substr(basis, 6), COUNT(*) FROM accepted WHERE basis LIKE 'rule:%' GROUP BY basis";
    let accepted: Vec<(String, i64)> = tx.list(sql, &[])?;
    let mut accepted = BTreeMap::from_iter(accepted);
    let state = |rule: Rule, known: bool, accepted: i64| RuleState {
        rule,
        known,
        accepted,
        would_accept: 0,
        left_to_review: 0,
    };
    let mut states = Vec::new();
    for rule in &settings.rules {
        let count = accepted.remove(&rule.name).unwrap_or(0);
        states.push(state(rule.clone(), true, count));
    }
    let mut after = 0;
    loop {
        let tasks = waiting(tx, after, i64::MAX, AT_ONCE)?;
        let Some(last) = tasks.last() else { break };
        after = last.id;
        for task in &tasks {
            let answers = waiting_answers(tx, task.id)?;
            let frames = project::frames(tx, &task.source)?;
            for state in &mut states {
                match fit(&state.rule, &settings, task, &answers, frames) {
                    Fit::No => {}
                    Fit::Review => state.left_to_review += 1,
                    Fit::Accept(_) => state.would_accept += 1,
                }
            }
        }
    }
    states.extend(accepted.into_iter().map(|(name, accepted)| {
        let rule = Rule {
            name,
            enabled: false,
            accepts: RuleKind::Sampled,
            kinds: Vec::new(),
            people: Vec::new(),
            min_answers: 1,
            max_distance: 0.0,
            review_percent: 0,
        };
        state(rule, false, accepted)
    }));
    Ok(states)
}

/// Takes back an acceptance of a rule.
pub(super) fn reopen(
    tx: &mut dyn Tx,
    actor: i64,
    task: i64,
    rule: &str,
    comment: &str,
    now: Millis,
) -> Result<()> {
    let body = Body::Reopened {
        comment: comment.to_owned(),
        request: String::new(),
        rule: Some(rule.to_owned()),
    };
    log::note(tx, now, Some(actor), Some(task), body)
}

/// The rule that accepted a task, and when.
pub(super) fn accepted_by_rule(tx: &mut dyn Tx, task: i64) -> Result<Option<(String, Millis)>> {
    let sql = "SELECT basis, at FROM accepted WHERE task = ?1";
    let found: Option<(String, Millis)> = tx.find(sql, params![task])?;
    Ok(found.and_then(|(basis, at)| Some((basis.strip_prefix("rule:")?.to_owned(), at))))
}
