//! Queues, leases, tasks and their events.

use crate::Error;
use crate::answer;
use crate::http::app::{App, Context, Reply, json};
use crate::mask::known_parts;
use crate::model::MAX_REQUESTS_PER_MINUTE;
use crate::store::{AuditFilter, Claimed, MotionRecord, TaskDetail, TaskRecord};
use crate::wire::{
    Bundle, BundleItem, Code, EventBatch, EventResults, MAX_EVENTS, MotionInfo, Next, NextRequest,
    SuggestRequest, Suggestion, Task, TaskKind, TaskView, TextForm,
};

/// Tasks whose motions the browser prefetches.
const AHEAD: usize = 3;

pub(super) fn motion_info(motion: MotionRecord) -> MotionInfo {
    MotionInfo {
        hash: motion.hash,
        id: motion.id,
        frames: usize::try_from(motion.frames).unwrap_or(0),
        fps: motion.fps,
        split: motion.split,
        captions: motion.captions,
        style: motion.style,
    }
}

pub(super) fn task_of(
    app: &App,
    record: TaskRecord,
    bundle: Option<Bundle>,
) -> Result<Task, Error> {
    let hashes = std::iter::once(record.source)
        .chain(record.target)
        .collect();
    let motions = app.store.motions(hashes)?;
    Ok(Task {
        id: record.id,
        kind: record.kind,
        state: record.state,
        motions: motions.into_iter().map(motion_info).collect(),
        category: record.category,
        hint: record.hint,
        style: record.style,
        wanted: record.wanted,
        submitted: record.submitted,
        bundle,
        practice: record.practice,
    })
}

/// A suggestion in the form that texts of a kind of task have.
pub(super) fn shown(mut suggestion: Suggestion, kind: TaskKind) -> Suggestion {
    if kind.text_form() == TextForm::Completion {
        suggestion.text = answer::completion(&suggestion.text).to_owned();
    }
    suggestion
}

/// Suggestions as annotators see them: those of the store, and the active parts of a clip.
pub(super) fn offered(
    app: &App,
    task: &TaskRecord,
    stored: Vec<Suggestion>,
) -> Result<Vec<Suggestion>, Error> {
    let mut suggestions: Vec<Suggestion> = stored
        .into_iter()
        .map(|suggestion| shown(suggestion, task.kind))
        .collect();
    if task.kind == TaskKind::MaskText {
        // Active parts are suggestions too, computed on request.
        let parts = app.motions.active_parts(&task.source)?;
        if !parts.is_empty() {
            suggestions.push(Suggestion {
                id: 0,
                source: crate::wire::SuggestionSource::Heat,
                parts: parts.iter().map(|part| part.name().to_owned()).collect(),
                text: String::new(),
                model: "activity".to_owned(),
            });
        }
    }
    Ok(suggestions)
}

fn view(app: &App, detail: TaskDetail) -> Result<TaskView, Error> {
    let bundle = detail.task.bundle.map(|id| Bundle {
        id,
        tasks: detail
            .bundle
            .into_iter()
            .map(|item| BundleItem {
                task: item.task,
                mine: item.mine,
                verdict: item.verdict,
                leased: item.leased,
            })
            .collect(),
    });
    let blind = detail.blind;
    let suggestions = if blind {
        Vec::new()
    } else {
        offered(app, &detail.task, detail.suggestions)?
    };
    Ok(TaskView {
        task: task_of(app, detail.task, bundle)?,
        lease: detail.lease,
        mine: detail.mine,
        comment: detail.comment,
        suggestions,
        blind,
        clip_changed: detail.clip_changed,
    })
}

pub(super) fn next(cx: &Context) -> Result<Reply, Error> {
    let request: NextRequest = cx.body()?;
    let who = cx.who()?;
    let (task, empty, prefetch) = match cx.app.store.claim(who.id, request.kind, AHEAD, cx.now)? {
        Claimed::Task { detail, upcoming } => (Some(view(&cx.app, *detail)?), None, upcoming),
        Claimed::Nothing(empty) => (None, Some(empty), Vec::new()),
    };
    json(&Next {
        task,
        empty,
        prefetch,
    })
}

pub(super) fn leases(cx: &Context) -> Result<Reply, Error> {
    json(&cx.app.store.leases(cx.now)?)
}

pub(super) fn renew(cx: &Context) -> Result<Reply, Error> {
    json(&cx.app.store.renew(cx.who()?.id, cx.id()?, cx.now)?)
}

pub(super) fn release(cx: &Context) -> Result<Reply, Error> {
    cx.app.store.release(cx.who()?, cx.id()?, cx.now)?;
    Ok(Reply::Empty)
}

pub(super) fn task(cx: &Context) -> Result<Reply, Error> {
    let detail = cx.app.store.task(cx.who()?, cx.id()?)?;
    json(&view(&cx.app, detail)?)
}

pub(super) fn claim(cx: &Context) -> Result<Reply, Error> {
    let (who, id) = (cx.who()?, cx.id()?);
    json(&view(
        &cx.app,
        cx.app.store.claim_task(who.id, id, cx.now)?,
    )?)
}

pub(super) fn events(cx: &Context) -> Result<Reply, Error> {
    let batch: EventBatch = cx.body()?;
    if batch.events.is_empty() || batch.events.len() > MAX_EVENTS {
        return Err(Error::invalid(
            "events",
            format!(
                "a batch has 1 to {MAX_EVENTS} events, this one has {}",
                batch.events.len()
            ),
        ));
    }
    let results = cx
        .app
        .store
        .append(cx.who()?.id, cx.id()?, batch.events, cx.now)?;
    json(&EventResults { results })
}

pub(super) fn suggest(cx: &Context) -> Result<Reply, Error> {
    let request: SuggestRequest = cx.body()?;
    let who = cx.who()?;
    let Some(model) = &cx.app.config.model else {
        return Err(Error::refused(
            Code::NoModel,
            "no language model is configured; write the text yourself",
        ));
    };
    let detail = cx.app.store.task(who, cx.id()?)?;
    if detail.lease.is_none() {
        return Err(Error::refused(
            Code::LeaseLost,
            "you hold no lease on this task",
        ));
    }
    if detail.blind {
        return Err(Error::wrong_state(
            detail.task.state,
            "given a draft: its drafts are withheld",
        ));
    }
    let parts = known_parts(&request.parts);
    if parts.is_empty() || parts.len() != request.parts.len() {
        return Err(Error::invalid(
            "parts",
            "name the parts that the text shall describe",
        ));
    }
    cx.app.limiter.count(
        "suggestions",
        &who.id.to_string(),
        MAX_REQUESTS_PER_MINUTE,
        cx.now,
    )?;
    let hashes = std::iter::once(detail.task.source.clone()).chain(detail.task.target.clone());
    let motions = cx.app.store.motions(hashes.collect())?;
    let captions: Vec<&str> = motions
        .iter()
        .flat_map(|motion| motion.captions.iter().map(String::as_str))
        .collect();
    let suggestion = model.suggest(cx.app.store.as_ref(), &detail.task, &captions, &parts)?;
    let kept = cx
        .app
        .store
        .put_suggestion(detail.task.id, suggestion, cx.now)?;
    json(&shown(kept, detail.task.kind))
}

pub(super) fn make_gold(cx: &Context) -> Result<Reply, Error> {
    let gold = cx.app.store.make_gold(cx.who()?.id, cx.id()?, cx.now)?;
    let record = TaskRecord {
        wanted: 1,
        ..cx.app.store.task_record(gold)?
    };
    json(&task_of(&cx.app, record, None)?)
}

pub(super) fn make_practice(cx: &Context) -> Result<Reply, Error> {
    let store = &cx.app.store;
    let practice = store.make_practice(cx.who()?.id, cx.id()?, cx.now)?;
    json(&task_of(&cx.app, store.task_record(practice)?, None)?)
}

pub(super) fn practice(cx: &Context) -> Result<Reply, Error> {
    json(&cx.app.store.practice(cx.who()?.id)?)
}

pub(super) fn history(cx: &Context) -> Result<Reply, Error> {
    let filter = AuditFilter {
        task: Some(cx.id()?),
        limit: 1000,
        ..AuditFilter::default()
    };
    let mut audit = cx.app.store.audit(filter)?;
    audit.entries.reverse();
    json(&audit.entries)
}
