//! Queues, leases, tasks and their events.

use axum::response::Response;

use crate::answer;
use crate::error::{Error, require};
use crate::http::app::{App, Context, json};
use crate::mask::known_parts;
use crate::model::MAX_REQUESTS_PER_MINUTE;
use crate::store::{AuditFilter, TaskDetail, TaskRecord};
use crate::wire::{
    Bundle, Code, EventBatch, EventResults, MAX_EVENTS, Next, NextRequest, SuggestRequest,
    Suggestion, TaskKind, TaskView, TextForm,
};

/// Number of following tasks whose motions the browser prefetches.
const AHEAD: usize = 3;

/// Converts a suggestion to the text form of a kind of task.
pub(super) fn shown(mut suggestion: Suggestion, kind: TaskKind) -> Suggestion {
    if kind.text_form() == TextForm::Completion {
        suggestion.text = answer::completion(&suggestion.text).to_owned();
    }
    suggestion
}

/// Suggestions as annotators see them: the stored ones, and the active parts of a clip.
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
        tasks: detail.bundle,
    });
    let blind = detail.blind;
    let suggestions = if blind {
        Vec::new()
    } else {
        offered(app, &detail.task, detail.suggestions)?
    };
    Ok(TaskView {
        task: app.store.view(detail.task, bundle)?,
        lease: detail.lease,
        mine: detail.mine,
        comment: detail.comment,
        suggestions,
        blind,
        clip_changed: detail.clip_changed,
    })
}

pub(super) fn next(cx: &Context) -> Result<Response, Error> {
    let request: NextRequest = cx.body()?;
    let claimed = cx.store().claim(cx.user()?, request.kind, AHEAD, cx.now)?;
    let (task, empty, prefetch) = match claimed {
        Ok((detail, upcoming)) => (Some(view(&cx.app, detail)?), None, upcoming),
        Err(empty) => (None, Some(empty), Vec::new()),
    };
    json(&Next {
        task,
        empty,
        prefetch,
    })
}

pub(super) fn task(cx: &Context) -> Result<Response, Error> {
    let detail = cx.store().task(cx.who()?, cx.id()?)?;
    json(&view(&cx.app, detail)?)
}

pub(super) fn claim(cx: &Context) -> Result<Response, Error> {
    let detail = cx.store().claim_task(cx.user()?, cx.id()?, cx.now)?;
    json(&view(&cx.app, detail)?)
}

pub(super) fn events(cx: &Context) -> Result<Response, Error> {
    let EventBatch { events } = cx.body()?;
    let count = events.len();
    let problem = format!("a batch has 1 to {MAX_EVENTS} events, this one has {count}");
    require((1..=MAX_EVENTS).contains(&count), "events", problem)?;
    let results = cx.store().append(cx.user()?, cx.id()?, events, cx.now)?;
    json(&EventResults { results })
}

pub(super) fn suggest(cx: &Context) -> Result<Response, Error> {
    let request: SuggestRequest = cx.body()?;
    let who = cx.who()?;
    let Some(model) = &cx.app.config.model else {
        let problem = "no language model is configured; write the text yourself";
        return Err(Error::refused(Code::NoModel, problem));
    };
    let detail = cx.store().task(who, cx.id()?)?;
    if detail.lease.is_none() {
        let problem = "you hold no lease on this task";
        return Err(Error::refused(Code::LeaseLost, problem));
    }
    if detail.blind {
        let problem = "given a draft: its drafts are withheld";
        return Err(Error::wrong_state(detail.task.state, problem));
    }
    let parts = known_parts(&request.parts);
    let are_known = !parts.is_empty() && parts.len() == request.parts.len();
    let problem = "name the parts that the text shall describe";
    require(are_known, "parts", problem)?;
    let (who, limiter) = (who.id.to_string(), &cx.app.limiter);
    limiter.count("suggestions", &who, MAX_REQUESTS_PER_MINUTE, cx.now)?;
    let suggestion = model.suggest(cx.store(), &detail.task, &parts)?;
    let task = &detail.task;
    let kept = cx.store().put_suggestion(task.id, suggestion, cx.now)?;
    json(&shown(kept, task.kind))
}

pub(super) fn make_gold(cx: &Context) -> Result<Response, Error> {
    let gold = cx.store().make_gold(cx.user()?, cx.id()?, cx.now)?;
    made(cx, gold)
}

pub(super) fn make_practice(cx: &Context) -> Result<Response, Error> {
    let practice = cx.store().make_practice(cx.user()?, cx.id()?, cx.now)?;
    made(cx, practice)
}

/// A copy that was made of a task, to test or train people.
fn made(cx: &Context, id: i64) -> Result<Response, Error> {
    let record = cx.store().task_record(id)?;
    json(&cx.store().view(record, None)?)
}

pub(super) fn history(cx: &Context) -> Result<Response, Error> {
    let mut audit = cx.store().audit(AuditFilter {
        task: Some(cx.id()?),
        limit: 1000,
        ..AuditFilter::default()
    })?;
    audit.entries.reverse();
    json(&audit.entries)
}
