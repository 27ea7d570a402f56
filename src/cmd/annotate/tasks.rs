//! Decisions about many tasks at once.

use annotate::store::Store;
use annotate::wire::{
    BulkAction, BulkDone, BulkRequest, RulesApplied, TaskFilter, TaskKind, TaskState, Verdict,
};
use anyhow::Context;
use serde_json::json;

use super::args::{BulkArgs, RulesAction};
use super::shared::now;
use super::users::{find, operator};
use crate::exit::Exit;
use crate::global::Global;
use crate::report;

/// Lists answered tasks whose clip was ingested again with other content; `keep` or `reopen` decides about them.
pub(super) fn changed_clips(
    store: &Store,
    keep: bool,
    reopen: bool,
    global: &Global,
) -> anyhow::Result<Exit> {
    let tasks = store.changed_tasks()?;
    if keep || reopen {
        let ids: Vec<i64> = tasks.iter().map(|task| task.id).collect();
        store.settle_changed(None, &ids, keep, now(store)?)?;
    }
    let rows = tasks
        .iter()
        .map(|task| json!({ "task": task.id, "key": task.key, "state": task.state }));
    let lines = tasks
        .iter()
        .map(|task| format!("{:>8} {:<10} {}", task.id, task.state.as_str(), task.key));
    let text = lines.collect::<Vec<_>>().join("\n");
    global.say(&rows.collect::<Vec<_>>(), &text)
}

pub(super) fn run_bulk(store: &Store, args: &BulkArgs, global: &Global) -> anyhow::Result<Exit> {
    let id = |name: &Option<String>| {
        let user = name.as_ref().map(|name| find(store, name)).transpose();
        user.map(|user| user.map(|user| user.id))
    };
    let mut request = BulkRequest {
        filter: TaskFilter {
            kind: args.kind.as_deref().and_then(TaskKind::parse),
            state: args.state.as_deref().and_then(TaskState::parse),
            q: args.search.clone(),
            person: id(&args.person)?,
            part: args.part.clone(),
            verdict: args.verdict.as_deref().and_then(Verdict::parse),
            category: args.category.clone(),
            max_distance: args.max_distance,
            rule: args.rule.clone(),
            ..TaskFilter::default()
        },
        action: BulkAction::parse(&args.action).context("the action is not known")?,
        comment: args.comment.clone(),
        person: id(&args.to)?,
        after: None,
    };
    let who = operator(store)?;
    let done = if args.yes {
        let mut all = BulkDone::default();
        loop {
            let some = store.bulk(&who, request.clone(), now(store)?)?;
            all.looked_at += some.looked_at;
            all.done += some.done;
            for (reason, count) in some.left_alone {
                *all.left_alone.entry(reason).or_default() += count;
            }
            request.after = some.next;
            if request.after.is_none() {
                break all;
            }
        }
    } else {
        store.preview_bulk(&who, request, now(store)?)?
    };
    let verb = if args.yes { "done" } else { "would be done" };
    let mut lines = vec![format!(
        "{}: {} of {} tasks {verb}",
        args.action, done.done, done.looked_at
    )];
    lines.extend(
        done.left_alone
            .iter()
            .map(|(reason, count)| format!("  left alone: {reason:<20} {count:>8}")),
    );
    if !args.yes {
        report::note("nothing was changed; add --yes to act");
    }
    global.say(&done, &lines.join("\n"))
}

pub(super) fn rules(
    store: &Store,
    action: Option<&RulesAction>,
    global: &Global,
) -> anyhow::Result<Exit> {
    match action {
        None | Some(RulesAction::List) => {
            let states = store.rules()?;
            let mut lines = vec![format!(
                "{:<24} {:<9} {:>9} {:>13} {:>15}",
                "rule", "enabled", "accepted", "would accept", "left to review"
            )];
            lines.extend(states.iter().map(|state| {
                format!(
                    "{:<24} {:<9} {:>9} {:>13} {:>15}",
                    state.rule.name,
                    if state.rule.enabled { "yes" } else { "no" },
                    state.accepted,
                    state.would_accept,
                    state.left_to_review
                )
            }));
            global.say(&states, &lines.join("\n"))
        }
        Some(RulesAction::Apply) => {
            let mut all = RulesApplied::default();
            let mut after = Some(0);
            while let Some(from) = after {
                let some = store.apply_rules(from, now(store)?)?;
                all.looked_at += some.looked_at;
                for (name, count) in some.accepted {
                    *all.accepted.entry(name).or_default() += count;
                }
                after = some.next;
            }
            let mut lines = vec![format!("{} tasks waited for review", all.looked_at)];
            lines.extend(
                all.accepted
                    .iter()
                    .map(|(name, count)| format!("  accepted by {name:<24} {count:>8}")),
            );
            global.say(&all, &lines.join("\n"))
        }
        Some(RulesAction::Undo { name }) => {
            let admin = operator(store)?.id;
            let mut all = store.undo_rule(admin, name, now(store)?)?;
            while all.left > 0 {
                let more = store.undo_rule(admin, name, now(store)?)?;
                all.reopened += more.reopened;
                all.left = more.left;
            }
            let text = format!(
                "rule {name} is disabled; {} of its acceptances were taken back and wait for review",
                all.reopened
            );
            global.say(&all, &text)
        }
    }
}
