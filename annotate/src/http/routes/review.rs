//! Reviews.

use super::tasks::{offered, task_of};
use crate::Error;
use crate::answer;
use crate::http::app::{Context, Reply, json};
use crate::store::ReviewClaimed;
use crate::wire::{
    Candidate, Decision, NewReview, ReviewNext, ReviewRequest, ReviewView, Revision,
};

pub(super) fn review_next(cx: &Context) -> Result<Reply, Error> {
    let request: ReviewRequest = cx.body()?;
    let who = cx.who()?;
    let store = &cx.app.store;
    let detail = if let Some(task) = request.task {
        store.review_task(who.id, task, cx.now)?
    } else {
        match store.review_next(who.id, request.queue, request.kind, cx.now)? {
            ReviewClaimed::Nothing(empty) => {
                return json(&ReviewNext {
                    review: None,
                    empty: Some(empty),
                });
            }
            ReviewClaimed::Task(detail) => *detail,
        }
    };
    let id = detail.task.id;
    let clip_changed = detail.task.changed;
    let answers: Vec<_> = detail
        .candidates
        .iter()
        .map(|(revision, _)| revision.answer.clone())
        .collect();
    let candidates = candidates_of(cx, detail.candidates)?;
    let suggestions = offered(&cx.app, &detail.task, cx.app.store.suggestions_of(id)?)?;
    let task = task_of(&cx.app, detail.task, None)?;
    let frames = task
        .motions
        .first()
        .map_or(1, |motion| motion.frames as i64);
    json(&ReviewNext {
        review: Some(ReviewView {
            task,
            lease: detail.lease,
            candidates,
            distance: answer::spread(&answers, frames),
            comments: detail.comments,
            suggestions,
            clip_changed,
        }),
        empty: None,
    })
}

/// Answers as a reviewer sees them.
pub(super) fn candidates_of(
    cx: &Context,
    answers: Vec<(Revision, String)>,
) -> Result<Vec<Candidate>, Error> {
    answers
        .into_iter()
        .map(|(revision, author_name)| {
            let store = cx.app.store.as_ref();
            Ok(Candidate {
                draft_distance: crate::quality::draft_distance(store, &revision.answer)?,
                joints: revision
                    .answer
                    .joints()
                    .iter()
                    .map(datasets_spec::Joint::index)
                    .collect(),
                author_name,
                revision,
            })
        })
        .collect()
}

pub(super) fn review(cx: &Context) -> Result<Reply, Error> {
    let new: NewReview = cx.body()?;
    if new.decision != Decision::Merge && new.answer.is_some() {
        return Err(Error::invalid("answer", "only a merge contains an answer"));
    }
    json(&cx.app.store.review(cx.who()?.id, new, cx.now)?)
}
