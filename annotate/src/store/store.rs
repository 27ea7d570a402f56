//! The operations of the store, each one transaction. Those on people, figures and jobs are in modules of their own.

mod accounts;
mod figures;
mod jobs;

use std::path::Path;
use std::sync::{Arc, Mutex};

use super::browse::{self, DecisionQuery, PageQuery};
use super::db::{self, Content, Database, Tx, params};
use super::import::Known;
use super::migrate::{self, Upgrade};
use super::records::{
    Claimed, Imported, Millis, MineQuery, MotionRecord, NewSuggestion, NewTask, OwnAnswer, Picture,
    ReviewClaimed, ReviewDetail, TaskDetail, TaskRecord, Who,
};
use super::{append, bulk, claim, import, leases, mine, people, pictures, practice, project, read};
use super::{rebuild, review, rows, rules};
use crate::Error;
use crate::clock::{self, Clock};
use crate::state::{Purpose, ReleaseReason};
use crate::wire::{
    Answer, BulkDone, BulkRequest, Code, DecisionRow, Decisions, EventResult, Lease, NewEvent,
    NewReview, PictureInfo, Practice, ReviewDone, ReviewQueue, Revision, Role, RuleState,
    RuleUndone, RulesApplied, Suggestion, TaskKind, TaskPage, TaskRow, TaskState,
};

/// Tasks imported per transaction; bounds how long others wait.
const IMPORT_GROUP: usize = 500;

/// A store of tasks, answers and users. Every changing operation is one transaction, durable when it returns.
/// The caller passes the time: a store has no clock.
pub struct Store {
    db: Box<dyn Database>,
    upgrade: Option<Upgrade>,
    known: Mutex<people::Known>,
}

impl Store {
    pub(super) fn new(db: Box<dyn Database>, upgrade: Option<Upgrade>) -> Self {
        Self {
            db,
            upgrade,
            known: Mutex::default(),
        }
    }

    /// The upgrade that opening the store made, if its tables were of an older version.
    pub fn upgrade(&self) -> Option<&Upgrade> {
        self.upgrade.as_ref()
    }

    /// The id of the store, drawn when it was created; its copies share it.
    ///
    /// # Errors
    /// The store fails.
    pub fn id(&self) -> Result<String, Error> {
        self.read(migrate::id)
    }

    fn write<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut dyn Tx) -> Result<T, Error> + Send + 'static,
    ) -> Result<T, Error> {
        db::write(self.db.as_ref(), work)
    }

    fn read<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut dyn Tx) -> Result<T, Error> + Send + 'static,
    ) -> Result<T, Error> {
        db::read(self.db.as_ref(), work)
    }

    /// Adds or updates motions.
    ///
    /// # Errors
    /// The store fails.
    pub fn put_motions(&self, motions: Vec<MotionRecord>) -> Result<(), Error> {
        for group in motions.chunks(IMPORT_GROUP) {
            let group = group.to_vec();
            self.write(move |tx| project::put_motions(tx, &group))?;
        }
        Ok(())
    }

    /// Gives clips new content. Tasks on the earlier content get the new one; those with an answer say so until somebody
    /// has decided about them again. Returns the number of tasks.
    ///
    /// # Errors
    /// The store fails.
    pub fn replace_motions(
        &self,
        actor: Option<i64>,
        motions: Vec<MotionRecord>,
        now: Millis,
    ) -> Result<i64, Error> {
        self.write(move |tx| project::replace_motions(tx, actor, &motions, now))
    }

    /// Key, source and target of each task about two motions, without gold tasks.
    ///
    /// # Errors
    /// The store fails.
    pub fn pairs(&self) -> Result<Vec<(String, String, String)>, Error> {
        self.read(read::pairs)
    }

    /// Tasks with an answer about a clip that was ingested anew since, with other content.
    ///
    /// # Errors
    /// The store fails.
    pub fn changed_tasks(&self) -> Result<Vec<TaskRecord>, Error> {
        self.read(read::changed)
    }

    /// Decides about tasks of [`Self::changed_tasks`]: with `keep` their answers hold, else accepted ones go back to
    /// review.
    ///
    /// # Errors
    /// The store fails.
    pub fn settle_changed(
        &self,
        actor: Option<i64>,
        tasks: &[i64],
        keep: bool,
        now: Millis,
    ) -> Result<(), Error> {
        for some in tasks.chunks(IMPORT_GROUP) {
            let some = some.to_vec();
            self.write(move |tx| {
                some.iter()
                    .try_for_each(|task| project::settle_changed(tx, actor, *task, keep, now))
            })?;
        }
        Ok(())
    }

    /// Imports tasks. Tasks with a known key stay as they are, except that an accepted answer fills one that nobody
    /// has worked on.
    ///
    /// # Errors
    /// The store fails.
    pub fn import(
        &self,
        actor: Option<i64>,
        tasks: Vec<NewTask>,
        now: Millis,
    ) -> Result<Imported, Error> {
        let mut done = Imported::default();
        for group in tasks.chunks(IMPORT_GROUP) {
            let group = group.to_vec();
            let some = self.write(move |tx| import::import(tx, actor, &group, now))?;
            done.new += some.new;
            done.known += some.known;
            done.filled += some.filled;
            done.conflicts.extend(some.conflicts);
        }
        Ok(done)
    }

    /// Claims the next task of a kind, or returns the one that the user holds, with the
    /// motions of the next `ahead` tasks.
    ///
    /// # Errors
    /// The store fails.
    pub fn claim(
        &self,
        user: i64,
        kind: TaskKind,
        ahead: usize,
        now: Millis,
    ) -> Result<Claimed, Error> {
        // The writer does both in one transaction: its page cache is warm, a reader's is invalid after
        // every commit.
        self.write(move |tx| {
            Ok(match claim::claim(tx, user, kind, now)? {
                Ok(task) => Claimed::Task {
                    detail: Box::new(read::detail(tx, user, task)?),
                    upcoming: claim::upcoming(tx, user, kind, task, ahead)?,
                },
                Err(empty) => Claimed::Nothing(empty),
            })
        })
    }

    /// Claims a given task.
    ///
    /// # Errors
    /// `task_full`, `not_found`, `wrong_state`; or the store fails.
    pub fn claim_task(&self, user: i64, task: i64, now: Millis) -> Result<TaskDetail, Error> {
        self.write(move |tx| {
            claim::claim_task(tx, user, task, now)?;
            read::detail(tx, user, task)
        })
    }

    /// Renews a lease.
    ///
    /// # Errors
    /// `lease_lost`; or the store fails.
    pub fn renew(&self, user: i64, lease: i64, now: Millis) -> Result<Lease, Error> {
        self.write(move |tx| {
            let settings = project::settings(tx)?;
            let held = rows::lease(tx, lease)?.filter(|held| held.lease.user == user);
            let held = held.ok_or_else(|| {
                Error::refused(
                    Code::LeaseLost,
                    "this lease ended; take the task again if it still wants answers",
                )
            })?;
            // A reservation for an author cannot be renewed.
            if matches!(held.purpose, Purpose::Returned | Purpose::Assigned) {
                return Err(Error::wrong_state(TaskState::Returned, "renewed; claim it"));
            }
            leases::prolong_bundle(tx, &held, &settings, now)
        })
    }

    /// Releases a lease; a reviewer may release those of others.
    ///
    /// # Errors
    /// `not_found`; or the store fails.
    pub fn release(&self, who: &Who, lease: i64, now: Millis) -> Result<(), Error> {
        let who = who.clone();
        self.write(move |tx| {
            let held = rows::lease(tx, lease)?
                .filter(|held| held.lease.user == who.id || who.role >= Role::Reviewer)
                .ok_or_else(|| Error::not_found("lease"))?;
            let reason = if held.lease.user == who.id {
                ReleaseReason::GivenBack
            } else {
                ReleaseReason::TakenAway
            };
            leases::end(tx, &held, Some(who.id), reason, now)
        })
    }

    /// Applies events of a task in order, up to the first that fails.
    ///
    /// # Errors
    /// `not_found`; or the store fails.
    pub fn append(
        &self,
        user: i64,
        task: i64,
        events: Vec<NewEvent>,
        now: Millis,
    ) -> Result<Vec<EventResult>, Error> {
        self.write(move |tx| append::append(tx, user, task, &events, now))
    }

    /// Task details for a user who may see the task.
    ///
    /// # Errors
    /// `not_found`; or the store fails.
    pub fn task(&self, who: &Who, task: i64) -> Result<TaskDetail, Error> {
        let who = who.clone();
        self.read(move |tx| {
            if who.role < Role::Reviewer && !read::concerns(tx, who.id, task)? {
                return Err(Error::not_found("task"));
            }
            read::detail(tx, who.id, task)
        })
    }

    /// A task, without access check.
    ///
    /// # Errors
    /// `not_found`; or the store fails.
    pub fn task_record(&self, task: i64) -> Result<TaskRecord, Error> {
        self.read(move |tx| rows::task(tx, task))
    }

    /// Claims the next task to review.
    ///
    /// # Errors
    /// The store fails.
    pub fn review_next(
        &self,
        user: i64,
        queue: ReviewQueue,
        kind: Option<TaskKind>,
        now: Millis,
    ) -> Result<ReviewClaimed, Error> {
        self.write(move |tx| review::next(tx, user, queue, kind, now))
    }

    /// Claims a task to review, or goes on with it.
    ///
    /// # Errors
    /// `own_work`, `lease_lost`, `wrong_state`, `not_found`; or the store fails.
    pub fn review_task(&self, user: i64, task: i64, now: Millis) -> Result<ReviewDetail, Error> {
        self.write(move |tx| review::open(tx, user, task, now))
    }

    /// Applies a reviewer's decision.
    ///
    /// # Errors
    /// `own_work`, `lease_lost`, `wrong_state`, `invalid`, `not_found`, `key_reused`; or the store fails.
    pub fn review(&self, user: i64, new: NewReview, now: Millis) -> Result<ReviewDone, Error> {
        self.write(move |tx| review::review(tx, user, &new, now))
    }

    /// The rules of acceptance with their counts.
    ///
    /// # Errors
    /// The store fails.
    pub fn rules(&self) -> Result<Vec<RuleState>, Error> {
        self.read(rules::states)
    }

    /// Applies the enabled rules to up to 2,000 tasks that wait for review, with ids above `after`.
    ///
    /// # Errors
    /// The store fails.
    pub fn apply_rules(&self, after: i64, now: Millis) -> Result<RulesApplied, Error> {
        self.write(move |tx| rules::apply(tx, after, now))
    }

    /// Disables a rule and takes back up to 2,000 of its acceptances.
    ///
    /// # Errors
    /// `not_found`; or the store fails.
    pub fn undo_rule(&self, actor: i64, rule: &str, now: Millis) -> Result<RuleUndone, Error> {
        let rule = rule.to_owned();
        self.write(move |tx| rules::undo(tx, actor, &rule, now))
    }

    /// A page of the task browser.
    ///
    /// # Errors
    /// `invalid`; or the store fails.
    pub fn browse(&self, query: PageQuery) -> Result<TaskPage, Error> {
        self.read(move |tx| browse::page(tx, &query))
    }

    /// The row of a task in the browser, and the decisions on it.
    ///
    /// # Errors
    /// `not_found`; or the store fails.
    pub fn task_row(&self, task: i64) -> Result<(TaskRow, Vec<DecisionRow>), Error> {
        self.read(move |tx| {
            let record = rows::task(tx, task)?;
            Ok((
                browse::task_row(tx, record)?,
                browse::decisions_on(tx, task)?,
            ))
        })
    }

    /// All answers to a task that were handed in, with the names of their authors.
    ///
    /// # Errors
    /// The store fails.
    pub fn answers_to(&self, task: i64) -> Result<Vec<(Revision, String)>, Error> {
        self.read(move |tx| review::answers_to(tx, task))
    }

    /// The accepted answer to a task.
    ///
    /// # Errors
    /// The store fails.
    pub fn accepted_answer(&self, task: i64) -> Result<Option<Answer>, Error> {
        self.read(move |tx| {
            let row = tx.one("SELECT answer FROM accepted WHERE task = ?1", params![task])?;
            row.map(|row| row.json(0)).transpose()
        })
    }

    /// Suggestions of a task.
    ///
    /// # Errors
    /// The store fails.
    pub fn suggestions_of(&self, task: i64) -> Result<Vec<Suggestion>, Error> {
        self.read(move |tx| project::suggestions_of(tx, task))
    }

    /// Decisions of reviewers, newest first.
    ///
    /// # Errors
    /// The store fails.
    pub fn decisions(&self, query: DecisionQuery) -> Result<Decisions, Error> {
        self.read(move |tx| browse::decisions(tx, &query))
    }

    /// Counts what a bulk action would change.
    ///
    /// # Errors
    /// `invalid`; or the store fails.
    pub fn preview_bulk(
        &self,
        who: &Who,
        request: BulkRequest,
        now: Millis,
    ) -> Result<BulkDone, Error> {
        let who = who.clone();
        self.read(move |tx| bulk::bulk(tx, &who, &request, false, now))
    }

    /// Acts on up to 2,000 tasks of a filter.
    ///
    /// # Errors
    /// `invalid`; or the store fails.
    pub fn bulk(&self, who: &Who, request: BulkRequest, now: Millis) -> Result<BulkDone, Error> {
        let who = who.clone();
        self.write(move |tx| bulk::bulk(tx, &who, &request, true, now))
    }

    /// A person's answers, newest first, with the cursor of the next page.
    ///
    /// # Errors
    /// `invalid`; or the store fails.
    pub fn answers_of(
        &self,
        user: i64,
        query: MineQuery,
        now: Millis,
    ) -> Result<(Vec<OwnAnswer>, Option<String>), Error> {
        self.read(move |tx| mine::answers(tx, user, &query, now))
    }

    /// Copies an accepted task as a hidden gold task.
    ///
    /// # Errors
    /// `wrong_state`, `not_found`; or the store fails.
    pub fn make_gold(&self, actor: i64, task: i64, now: Millis) -> Result<i64, Error> {
        self.write(move |tx| import::copy_known(tx, actor, task, Known::Gold, now))
    }

    /// Copies an accepted task as a practice task.
    ///
    /// # Errors
    /// `wrong_state`, `not_found`; or the store fails.
    pub fn make_practice(&self, actor: i64, task: i64, now: Millis) -> Result<i64, Error> {
        self.write(move |tx| import::copy_known(tx, actor, task, Known::Practice, now))
    }

    /// A user's practice of each kind.
    ///
    /// # Errors
    /// The store fails.
    pub fn practice(&self, user: i64) -> Result<Vec<Practice>, Error> {
        self.read(move |tx| {
            let settings = project::settings(tx)?;
            TaskKind::ALL
                .iter()
                .map(|&kind| practice::standing(tx, user, kind, &settings))
                .collect()
        })
    }

    /// Tasks that still want answers and have no draft of a language model, with ids above `after`.
    ///
    /// # Errors
    /// The store fails.
    pub fn undrafted(
        &self,
        kind: Option<TaskKind>,
        after: i64,
        limit: usize,
    ) -> Result<Vec<TaskRecord>, Error> {
        self.read(move |tx| read::undrafted(tx, kind, after, limit))
    }

    /// Pictures of the guide, without their content.
    ///
    /// # Errors
    /// The store fails.
    pub fn pictures(&self) -> Result<Vec<PictureInfo>, Error> {
        self.read(pictures::list)
    }

    /// A picture of the guide.
    ///
    /// # Errors
    /// `not_found`; or the store fails.
    pub fn picture(&self, name: &str) -> Result<Picture, Error> {
        let name = name.to_owned();
        self.read(move |tx| pictures::get(tx, &name))
    }

    /// Stores a picture of the guide, in place of one of the same name.
    ///
    /// # Errors
    /// `invalid`; or the store fails.
    pub fn put_picture(
        &self,
        actor: i64,
        name: &str,
        bytes: Vec<u8>,
        now: Millis,
    ) -> Result<PictureInfo, Error> {
        let name = name.to_owned();
        self.write(move |tx| pictures::put(tx, actor, &name, &bytes, now))
    }

    /// Deletes a picture of the guide.
    ///
    /// # Errors
    /// `not_found`; or the store fails.
    pub fn delete_picture(&self, actor: i64, name: &str, now: Millis) -> Result<(), Error> {
        let name = name.to_owned();
        self.write(move |tx| pictures::delete(tx, actor, &name, now))
    }

    /// Motions by their hashes.
    ///
    /// # Errors
    /// The store fails.
    pub fn motions(&self, hashes: Vec<String>) -> Result<Vec<MotionRecord>, Error> {
        self.read(move |tx| project::motions(tx, &hashes))
    }

    /// All motions.
    ///
    /// # Errors
    /// The store fails.
    pub fn all_motions(&self) -> Result<Vec<MotionRecord>, Error> {
        self.read(project::all_motions)
    }

    /// Up to `limit` other motions of the same split, for previews.
    ///
    /// # Errors
    /// The store fails.
    pub fn partners(&self, hash: &str, limit: usize) -> Result<Vec<MotionRecord>, Error> {
        let hash = hash.to_owned();
        self.read(move |tx| project::partners(tx, &hash, limit))
    }

    /// Whether a user holds or answered a task.
    ///
    /// # Errors
    /// The store fails.
    pub fn concerns(&self, user: i64, task: i64) -> Result<bool, Error> {
        self.read(move |tx| read::concerns(tx, user, task))
    }

    /// Suggestions by their ids.
    ///
    /// # Errors
    /// The store fails.
    pub fn suggestions(&self, ids: Vec<i64>) -> Result<Vec<Suggestion>, Error> {
        self.read(move |tx| project::suggestions(tx, &ids))
    }

    /// Stores a suggestion.
    ///
    /// # Errors
    /// The store fails.
    pub fn put_suggestion(
        &self,
        task: i64,
        suggestion: NewSuggestion,
        now: Millis,
    ) -> Result<Suggestion, Error> {
        self.write(move |tx| project::put_suggestion(tx, task, &suggestion, now))
    }

    /// Stored suggestion for the same prompt.
    ///
    /// # Errors
    /// The store fails.
    pub fn cached_suggestion(&self, prompt_hash: &str) -> Result<Option<NewSuggestion>, Error> {
        let hash = prompt_hash.to_owned();
        self.read(move |tx| project::cached_suggestion(tx, &hash))
    }

    /// A stored value, such as the dataset version imported last.
    ///
    /// # Errors
    /// The store fails.
    pub fn note(&self, name: &str) -> Result<Option<String>, Error> {
        let name = format!("note:{name}");
        self.read(move |tx| {
            let row = tx.one("SELECT body FROM setting WHERE name = ?1", params![&name])?;
            row.map(|row| row.string(0)).transpose()
        })
    }

    /// Stores a value.
    ///
    /// # Errors
    /// The store fails.
    pub fn put_note(&self, name: &str, text: &str) -> Result<(), Error> {
        let (name, text) = (format!("note:{name}"), text.to_owned());
        self.write(move |tx| {
            tx.execute(
                "INSERT INTO setting (name, body) VALUES (?1, ?2) ON CONFLICT (name) DO UPDATE SET body = excluded.body",
                params![&name, &text],
            )?;
            Ok(())
        })
    }

    /// Derives the projections from the log again and repairs what differs. Returns the names of the tables that did.
    /// Writers wait for no longer than they do for each other.
    ///
    /// # Errors
    /// The store fails, or an entry of the log cannot be read.
    pub fn rebuild(&self) -> Result<Vec<&'static str>, Error> {
        rebuild::rebuild(self.db.as_ref())
    }

    /// Findings of a check of the whole store: gaps in the log, projections that do not follow from it. Writers do
    /// not wait for it.
    ///
    /// # Errors
    /// The store fails.
    pub fn verify(&self) -> Result<Vec<String>, Error> {
        db::read(self.db.snapshot()?.as_ref(), rebuild::verify)
    }

    /// Changes rows past the log, for tests of what notices it.
    #[cfg(test)]
    pub(super) fn damage(&self, sql: &'static str) -> Result<u64, Error> {
        self.write(move |tx| tx.execute(sql, &[]))
    }

    /// The store as it is now, for reading alone: what is written later does not appear in it.
    ///
    /// # Errors
    /// The store fails.
    pub fn snapshot(&self) -> Result<Self, Error> {
        Ok(Self::new(self.db.snapshot()?, None))
    }

    /// Writes a backup of the store to a new file.
    ///
    /// # Errors
    /// The store fails, or the file exists.
    pub fn backup(&self, path: &Path) -> Result<(), Error> {
        self.db.backup(path, Content::All)
    }

    /// Writes the store without tokens and sessions to a new file, for another machine.
    ///
    /// # Errors
    /// As [`Self::backup`].
    pub fn pack(&self, path: &Path) -> Result<(), Error> {
        self.db.backup(path, Content::WithoutTokens)
    }

    /// Checks that the store can be read and that its writer answers, without writing anything. A full disk shows
    /// only at a write.
    ///
    /// # Errors
    /// It does not answer, or is read-only.
    pub fn ready(&self) -> Result<(), Error> {
        self.read(|tx| tx.number("SELECT COUNT(*) FROM pref WHERE usr = 0", &[]))?;
        // A transaction without changes takes the writer's lock, and commits nothing.
        self.write(|_| Ok(()))
    }

    /// The clock of the database, for a store that several servers share. Their own clocks may differ by more than
    /// a lease lasts.
    ///
    /// # Errors
    /// The store fails.
    pub fn clock(self: &Arc<Self>) -> Result<Option<Clock>, Error> {
        if self.db.time()?.is_none() {
            return Ok(None);
        }
        let store = Arc::clone(self);
        let read = move || store.db.time().and_then(|time| time.ok_or(Error::Closed));
        Ok(Some(clock::shared(read)?))
    }

    /// Checks that the store accepts writes, by writing.
    ///
    /// # Errors
    /// It does not.
    pub fn check(&self) -> Result<(), Error> {
        self.db.check()
    }
}
