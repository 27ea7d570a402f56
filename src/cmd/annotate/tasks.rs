//! Decisions about many tasks at once.

use annotate::store::Store;
use annotate::wire::{BulkAction, BulkDone, BulkRequest, TaskFilter, TaskKind, TaskState, Verdict};
use anyhow::Context;
use serde_json::json;

use super::args::BulkArgs;
use super::shared::now;
use super::users::{find, operator};
use crate::exit::Exit;
use crate::global::Global;
use crate::report;

/// Lists tasks whose clip was ingested anew after somebody answered, or decides about them.
pub(super) fn changed_clips(
    store: &Store,
    keep: bool,
    reopen: bool,
    global: &Global,
) -> anyhow::Result<Exit> {
    let tasks = store.changed_tasks()?;
    if keep || reopen {
        let ids: Vec<i64> = tasks.iter().map(|task| task.id).collect();
        store.settle_changed(None, &ids, keep, now())?;
    }
    let rows = tasks
        .iter()
        .map(|task| json!({ "task": task.id, "key": task.key, "state": task.state }));
    let lines = tasks
        .iter()
        .map(|task| format!("{:>8} {:<10} {}", task.id, task.state.as_str(), task.key));
    global.say(
        &rows.collect::<Vec<_>>(),
        &lines.collect::<Vec<_>>().join("\n"),
    )
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
            let some = store.bulk(&who, request.clone(), now())?;
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
        store.preview_bulk(&who, request, now())?
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
