//! Reviews: claiming a task to review, and decisions.

use super::append::working;
use super::db::{Result, Tx, params};
use super::entry::{Body, Entry};
use super::leases::{HERE, Turn};
use super::log::Request;
use super::records::{Millis, ReviewDetail, TaskRecord};
use super::store::Store;
use super::{apply, leases, project, read, rows};
use crate::answer;
use crate::error::{Error, require};
use crate::state::{LogKind, Purpose};
use crate::wire::{
    Code, Decision, NewReview, ReviewDone, ReviewEmpty, ReviewQueue, Revision, RevisionState,
    TaskKind, TaskState,
};

impl Store {
    /// Claims the next task to review, or returns the reason why there is none.
    pub fn review_next(
        &self,
        user: i64,
        queue: ReviewQueue,
        kind: Option<TaskKind>,
        now: Millis,
    ) -> Result<Result<ReviewDetail, ReviewEmpty>> {
        let kind = kind.map_or("", TaskKind::as_str);
        self.write(move |tx| match next(tx, user, queue, kind, now)? {
            Some(task) => detail(tx, user, task).map(Ok),
            None => empty(tx, user, kind).map(Err),
        })
    }

    /// Claims a task to review, or resumes its review. Refused with `own_work`, `lease_lost`, `wrong_state`,
    /// `not_found`.
    pub fn review_task(&self, user: i64, task: i64, now: Millis) -> Result<ReviewDetail> {
        self.write(move |tx| {
            open(tx, user, task, now)?;
            detail(tx, user, task)
        })
    }

    /// Applies a reviewer's decision.
    /// Refused with `own_work`, `lease_lost`, `wrong_state`, `invalid`, `not_found`, `key_reused`.
    pub fn review(&self, user: i64, new: NewReview, now: Millis) -> Result<ReviewDone> {
        self.write(move |tx| {
            let request = Request::new(user, &new.idem_key, &new)?;
            if let Some(done) = request.replay(tx)? {
                return Ok(done);
            }
            let turn = Turn::of(tx, user, now)?;
            let task = rows::task(tx, new.task)?;
            let own = check_own(tx, &turn, task.id)?;
            let deciding = Deciding {
                turn,
                review: &new,
                request,
                task,
                own,
            };
            deciding.check_state()?;
            let needs_comment = matches!(
                new.decision,
                Decision::Return | Decision::Drop | Decision::Reopen
            );
            let comment = comment(&new.comment, needs_comment, "author")?;
            deciding.check_lease(tx)?;
            let body = deciding.body(tx, comment)?;
            deciding.take_style(tx, &body)?;
            deciding.log(tx, body)
        })
    }

    /// All submitted answers to a task, with the names of their authors. Returned answers come last.
    pub fn answers_to(&self, task: i64) -> Result<Vec<(Revision, String)>> {
        self.read(move |tx| answers_to(tx, task))
    }
}

/// The task that a reviewer holds, or the next one of a queue, of one kind or of any.
fn next(
    tx: &mut dyn Tx,
    user: i64,
    queue: ReviewQueue,
    kind: &str,
    now: Millis,
) -> Result<Option<i64>> {
    let turn = Turn::begin(tx, user, now)?;
    let settings = &turn.settings;
    let from = "lease l JOIN task t ON t.id = l.task
         WHERE l.usr = ?1 AND l.purpose = 'review' AND (?2 = '' OR t.kind = ?2) ORDER BY l.id LIMIT 1";
    if let Some(held) = rows::leases(tx, from, params![user, kind])?.pop() {
        return turn.resume(tx, &held).map(Some);
    }
    // Only queue `sample` is limited to a share of the tasks; 100 admits all.
    let (order, share, back) = match queue {
        ReviewQueue::Disagreement => ("COALESCE(t.distance, -1) DESC, t.id", 100, 0_i64),
        ReviewQueue::Sample => ("t.shuffle, t.id", i64::from(settings.review_percent), 0),
        ReviewQueue::Returned => ("t.id", 100, 1),
    };
    let sql = format!(
        "SELECT t.id FROM task t WHERE t.state = 'submitted' AND t.gold IS NULL AND (?2 = '' OR t.kind = ?2)
           AND (t.shuffle + ?5) % 100 < ?3 AND t.came_back >= ?4
           AND (?6 = 1 OR NOT EXISTS (SELECT 1 FROM revision r WHERE r.task = t.id AND r.author = ?1 AND r.state <> 'draft'))
           AND {HERE} ORDER BY {order} LIMIT 1"
    );
    let values = params![user, kind, share, back, settings.seed, settings.solo];
    let task = tx.find(&sql, values)?;
    if let Some(task) = task {
        turn.take(tx, task, Purpose::Review, None)?;
    }
    Ok(task)
}

/// Why there is nothing to review: counts of the tasks of one kind, or of all.
fn empty(tx: &mut dyn Tx, user: i64, kind: &str) -> Result<ReviewEmpty> {
    tx.get(
        "SELECT COUNT(CASE WHEN t.state = 'submitted' THEN 1 END),
           COUNT(CASE WHEN t.state = 'submitted' AND EXISTS (
             SELECT 1 FROM revision r WHERE r.task = t.id AND r.author = ?2 AND r.state <> 'draft') THEN 1 END),
           COUNT(CASE WHEN t.state = 'in_review' THEN 1 END)
         FROM task t WHERE t.state IN ('submitted', 'in_review') AND t.gold IS NULL AND (?1 = '' OR t.kind = ?1)",
        params![kind, user],
    )
}

/// Claims a task to review, or resumes its review.
fn open(tx: &mut dyn Tx, user: i64, id: i64, now: Millis) -> Result<()> {
    let turn = Turn::begin(tx, user, now)?;
    let task = rows::task(tx, id)?;
    if let Some(held) = rows::lease_of(tx, id, user)?
        && held.purpose == Purpose::Review
    {
        return turn.prolong(tx, &held).map(|_| ());
    }
    if task.state == TaskState::InReview {
        let problem = "another reviewer looks at this task; the record of the task says who, and can release it";
        return Err(Error::refused(Code::LeaseLost, problem));
    }
    if task.state != TaskState::Submitted || task.gold.is_some() {
        return Err(Error::wrong_state(task.state, "reviewed"));
    }
    check_own(tx, &turn, id)?;
    turn.take(tx, id, Purpose::Review, None)
}

/// Whether the reviewer answered the task. Refused with `own_work` unless the project lets people review their own
/// answers.
fn check_own(tx: &mut dyn Tx, turn: &Turn, task: i64) -> Result<bool> {
    let mine = rows::revision(tx, task, turn.user)?;
    let own = mine.is_some_and(|mine| mine.state != RevisionState::Draft);
    if own && !turn.settings.solo {
        let problem = "you answered this task yourself; somebody else has to review it";
        return Err(Error::refused(Code::OwnWork, problem));
    }
    Ok(own)
}

/// A task as its reviewer sees it.
fn detail(tx: &mut dyn Tx, user: i64, id: i64) -> Result<ReviewDetail> {
    let task = rows::task(tx, id)?;
    let lease = rows::lease_of(tx, id, user)?.ok_or(Error::Closed)?.lease;
    let mut candidates = answers_to(tx, id)?;
    let undecided = [RevisionState::Submitted, RevisionState::Returned];
    candidates.retain(|(own, _)| undecided.contains(&own.state));
    let sql = "SELECT comment FROM review WHERE task = ?1 AND comment <> '' ORDER BY seq";
    Ok(ReviewDetail {
        task,
        lease,
        candidates,
        comments: tx.list(sql, params![id])?,
        former: read::former_answer(tx, id)?,
    })
}

fn answers_to(tx: &mut dyn Tx, task: i64) -> Result<Vec<(Revision, String)>> {
    let sql = format!(
        "SELECT {}, COALESCE(u.name, '') FROM revision r LEFT JOIN usr u ON u.id = r.author
         WHERE r.task = ?1 AND r.state <> 'draft'
         ORDER BY CASE WHEN r.state = 'returned' THEN 1 ELSE 0 END, r.author",
        rows::REVISION
    );
    tx.list(&sql, params![task])
}

/// A decision on a task, with the data for its log entry.
struct Deciding<'a> {
    turn: Turn,
    review: &'a NewReview,
    request: Request,
    task: TaskRecord,
    /// Whether the reviewer answered the task too.
    own: bool,
}

impl Deciding<'_> {
    fn check_state(&self) -> Result<()> {
        if self.task.gold.is_some() {
            let problem = "reviewed: its answer is known";
            return Err(Error::wrong_state(self.task.state, problem));
        }
        let kind = log_kind(self.review.decision);
        apply::check_move(self.task.state, kind, "decided so")
    }

    /// Checks that nobody else reviews the task, and that the reviewer holds it if the decision is about answers or was
    /// made under a lease.
    fn check_lease(&self, tx: &mut dyn Tx) -> Result<()> {
        let from = "lease l WHERE l.task = ?1 AND l.purpose = 'review'";
        let held = rows::leases(tx, from, params![self.task.id])?.pop();
        let ours = held.as_ref().is_some_and(|held| {
            held.lease.user == self.turn.user && held.lease.epoch == self.review.lease_epoch
        });
        let needs_lease = matches!(
            self.review.decision,
            Decision::Accept | Decision::Merge | Decision::Return
        ) || self.review.decision == Decision::Drop
            && self.review.lease_epoch != 0;
        let somebody_else = held.is_some_and(|held| held.lease.user != self.turn.user);
        if (needs_lease && !ours) || somebody_else {
            let problem = "your lease on this review ended, because it expired or the clip was ingested anew; claim the task again from the queue";
            return Err(Error::refused(Code::LeaseLost, problem));
        }
        Ok(())
    }

    /// Authors of the answers that the decision is about.
    fn authors(&self, tx: &mut dyn Tx) -> Result<Vec<i64>> {
        let sql =
            "SELECT author FROM revision WHERE task = ?1 AND state = 'submitted' ORDER BY author";
        let authors: Vec<i64> = tx.list(sql, params![self.task.id])?;
        match self.review.author {
            None => Ok(authors),
            Some(author) if authors.contains(&author) => Ok(vec![author]),
            Some(author) => Err(Error::invalid(
                "author",
                format!("user {author} has no answer waiting for review"),
            )),
        }
    }

    /// The body of the log entry.
    fn body(&self, tx: &mut dyn Tx, comment: String) -> Result<Body> {
        let authors = self.authors(tx)?;
        let request = self.request.hash.clone();
        let secs = working(self.review.secs);
        Ok(match self.review.decision {
            Decision::Accept => match authors.as_slice() {
                [author] => Body::Accepted {
                    author: *author,
                    comment,
                    secs,
                    request,
                    rule: None,
                    own: self.own && *author == self.turn.user,
                },
                _ => {
                    let problem = format!("{} answers wait; choose one", authors.len());
                    return Err(Error::invalid("author", problem));
                }
            },
            Decision::Merge => {
                let answer = self.review.answer.clone();
                let answer = answer
                    .ok_or_else(|| Error::invalid("answer", "the merged answer is missing"))?;
                let length = project::length(tx, &self.task.source)?;
                answer::check_submission(&answer, self.task.kind, &self.turn.settings, length)?;
                Body::Merged {
                    answer,
                    comment,
                    secs,
                    request,
                    own: self.own,
                }
            }
            Decision::Return => Body::Returned {
                authors,
                comment,
                until: self.turn.until_returned(),
                secs,
                request,
            },
            Decision::Drop => Body::Dropped {
                comment,
                secs,
                request,
            },
            Decision::Reopen => Body::Reopened {
                comment,
                request,
                rule: None,
            },
        })
    }

    /// Adds the new style of an accepted answer to the project.
    fn take_style(&self, tx: &mut dyn Tx, body: &Body) -> Result<()> {
        let answer = match body {
            Body::Accepted { author, .. } => {
                rows::revision(tx, self.task.id, *author)?.map(|own| own.answer)
            }
            Body::Merged { answer, .. } => Some(answer.clone()),
            _ => None,
        };
        let Some(style) = answer
            .as_ref()
            .and_then(|answer| answer.new_style(&self.turn.settings))
        else {
            return Ok(());
        };
        // Another spelling may have been accepted since the answer was handed in.
        answer::check_style_name(style, &self.turn.settings)?;
        project::add_styles(tx, Some(self.turn.user), [style], self.turn.now)
    }

    /// Writes the entry and returns the reply, which is stored for repetitions of the same key.
    fn log(&self, tx: &mut dyn Tx, body: Body) -> Result<ReviewDone> {
        let id = self.task.id;
        let (actor, epoch) = (Some(self.turn.user), Some(self.review.lease_epoch));
        let entry = Entry::new(self.turn.now, actor, Some(id), epoch, body);
        let done = self.request.log(tx, &entry, 0, |tx, seq| {
            let state = rows::task(tx, id)?.state;
            Ok(ReviewDone { seq, state })
        })?;
        // Reservations exist only once the decision is applied and stored.
        leases::free_of_the_disabled(tx, &self.turn, id)?;
        let state = rows::task(tx, id)?.state;
        Ok(ReviewDone { state, ..done })
    }
}

/// The log entry of a decision.
fn log_kind(decision: Decision) -> LogKind {
    match decision {
        Decision::Accept => LogKind::Accepted,
        Decision::Merge => LogKind::Merged,
        Decision::Return => LogKind::Returned,
        Decision::Drop => LogKind::Dropped,
        Decision::Reopen => LogKind::Reopened,
    }
}

/// The trimmed comment of a decision. It must be a valid text, and not empty if it is needed; the error says that
/// `readers` need it.
pub(super) fn comment(text: &str, is_needed: bool, readers: &str) -> Result<String> {
    let comment = text.trim().to_owned();
    answer::check_text("comment", &comment)?;
    let problem = format!("write a comment; the {readers} and the log need it");
    require(!is_needed || !comment.is_empty(), "comment", problem)?;
    Ok(comment)
}
