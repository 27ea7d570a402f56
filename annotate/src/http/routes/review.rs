//! Reviews.

use axum::response::Response;

use super::tasks::offered;
use crate::answer;
use crate::error::{Error, require};
use crate::http::app::{Context, json};
use crate::quality::draft_distance;
use crate::wire::{
    Candidate, Decision, NewReview, ReviewNext, ReviewRequest, ReviewView, Revision,
};

pub(super) fn review_next(cx: &Context) -> Result<Response, Error> {
    let request: ReviewRequest = cx.body()?;
    let (user, store) = (cx.user()?, cx.store());
    let detail = if let Some(task) = request.task {
        store.review_task(user, task, cx.now)?
    } else {
        match store.review_next(user, request.queue, request.kind, cx.now)? {
            Err(empty) => {
                return json(&ReviewNext {
                    review: None,
                    empty: Some(empty),
                });
            }
            Ok(detail) => detail,
        }
    };
    let revisions = detail.candidates.iter();
    let answers: Vec<_> = revisions
        .map(|(revision, _)| revision.answer.clone())
        .collect();
    let suggestions = store.suggestions_of(detail.task.id)?;
    let suggestions = offered(&cx.app, &detail.task, suggestions)?;
    let clip_changed = detail.task.changed;
    let task = store.view(detail.task, None)?;
    let motion = task.motions.first();
    let frames = motion.map_or(1, |motion| motion.frames as i64);
    json(&ReviewNext {
        review: Some(ReviewView {
            task,
            lease: detail.lease,
            candidates: candidates_of(cx, detail.candidates)?,
            distance: answer::spread(&answers, frames),
            comments: detail.comments,
            suggestions,
            clip_changed,
            former: detail.former,
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
            Ok(Candidate {
                draft_distance: draft_distance(cx.store(), &revision.answer)?,
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

pub(super) fn review(cx: &Context) -> Result<Response, Error> {
    let new: NewReview = cx.body()?;
    let fits = new.decision == Decision::Merge || new.answer.is_none();
    require(fits, "answer", "only a merge contains an answer")?;
    json(&cx.store().review(cx.user()?, new, cx.now)?)
}
