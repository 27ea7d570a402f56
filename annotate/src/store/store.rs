//! The operations of the store, each one transaction.

use std::io::Read;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard};

use super::browse::{self, DecisionQuery, PageQuery};
use super::db::{self, Database, Tx, params};
use super::entry::{Body, Entry};
use super::import::Known;
use super::migrate::{self, Upgrade};
use super::records::{
    AcceptedAnswer, AuditFilter, Claimed, Imported, IssuedToken, KeyRange, Label, Millis,
    MineQuery, MotionRecord, NewSuggestion, NewTask, OwnAnswer, PersonCounts, Picture, Reject,
    ReviewClaimed, ReviewDetail, ShelfFilter, TaskDetail, TaskRecord, TokenUse, WeekCounts, Who,
};
use super::{append, claim, import, mine, people, pictures, practice, project, read, review, work};
use super::{log, rebuild, rows, rules};
use crate::Error;
use crate::clock::{Clock, SharedClock};
use crate::lock::lock;
use crate::state::{Purpose, ReleaseReason};
use crate::wire::{
    Answer, Audit, AuditEntry, BulkDone, BulkRequest, Code, DayWork, DecisionRow, Decisions,
    EventResult, HeldLease, Home, Job, Lease, NewEvent, NewReview, Outlook, PictureInfo, Practice,
    Prefs, ReviewDone, ReviewQueue, Revision, Role, RuleState, RuleUndone, RulesApplied, Settings,
    Suggestion, TaskKind, TaskPage, TaskRow, TaskState, TokenInfo, User,
};

/// Bytes of a file written per transaction.
const FILE_PART: u64 = 1 << 20;
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

    fn known(&self) -> MutexGuard<'_, people::Known> {
        lock(&self.known)
    }

    /// [`Self::write`] of users or tokens; clears the token cache.
    fn write_people<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut dyn Tx) -> Result<T, Error> + Send + 'static,
    ) -> Result<T, Error> {
        let outcome = self.write(work);
        self.known().clear();
        outcome
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
            claim::prolong_bundle(tx, &held, &settings, now)
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
            claim::end(tx, &held, Some(who.id), reason, now)
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
        self.read(move |tx| browse::bulk(tx, &who, &request, false, now))
    }

    /// Acts on up to 2,000 tasks of a filter.
    ///
    /// # Errors
    /// `invalid`; or the store fails.
    pub fn bulk(&self, who: &Who, request: BulkRequest, now: Millis) -> Result<BulkDone, Error> {
        let who = who.clone();
        self.write(move |tx| browse::bulk(tx, &who, &request, true, now))
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

    /// Adds many users, each with a token, or none if a line is wrong.
    ///
    /// # Errors
    /// `invalid` names the line; or the store fails.
    pub fn add_users(
        &self,
        actor: Option<i64>,
        lines: &str,
        expires: Millis,
        now: Millis,
    ) -> Result<Vec<IssuedToken>, Error> {
        let new = people::parse_lines(lines)?;
        self.write_people(move |tx| people::add_all(tx, actor, &new, expires, now))
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

    /// Work by person, day and kind between two times. Days begin in the project's time zone.
    ///
    /// # Errors
    /// The store fails.
    pub fn work(&self, from: Millis, to: Millis) -> Result<Vec<DayWork>, Error> {
        self.read(move |tx| work::days(tx, from, to))
    }

    /// What is left to do, and how fast it goes.
    ///
    /// # Errors
    /// The store fails.
    pub fn outlook(&self, now: Millis) -> Result<Vec<Outlook>, Error> {
        self.read(move |tx| work::outlook(tx, now))
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

    /// Contents of a user's home page.
    ///
    /// # Errors
    /// The store fails.
    pub fn home(&self, user: i64, now: Millis) -> Result<Home, Error> {
        self.read(move |tx| read::home(tx, user, now))
    }

    /// Accepted answers.
    ///
    /// # Errors
    /// The store fails.
    pub fn shelf(&self, user: i64, filter: ShelfFilter) -> Result<Vec<AcceptedAnswer>, Error> {
        self.read(move |tx| read::shelf(tx, user, &filter))
    }

    /// Tasks by kind and state.
    ///
    /// # Errors
    /// The store fails.
    pub fn funnel(&self) -> Result<Vec<(TaskKind, TaskState, i64)>, Error> {
        self.read(read::funnel)
    }

    /// Counts per week; `bounds` holds the starts of the weeks and the end of the last one.
    ///
    /// # Errors
    /// The store fails.
    pub fn weeks(&self, bounds: Vec<Millis>) -> Result<Vec<WeekCounts>, Error> {
        self.read(move |tx| read::weeks(tx, &bounds))
    }

    /// Totals of every person.
    ///
    /// # Errors
    /// The store fails.
    pub fn people(&self) -> Result<Vec<PersonCounts>, Error> {
        self.read(read::people)
    }

    /// Submitted answers of the `limit` tasks after a task id, by task.
    ///
    /// # Errors
    /// The store fails.
    pub fn labels(&self, after: i64, limit: usize) -> Result<Vec<Label>, Error> {
        self.read(move |tx| read::labels(tx, after, limit))
    }

    /// Tasks whose answers changed after a place in the log, and the last place of the log.
    ///
    /// # Errors
    /// The store fails.
    pub fn answered_since(&self, after: i64) -> Result<(Vec<i64>, i64), Error> {
        self.read(move |tx| read::answered_since(tx, after))
    }

    /// Submitted answers to these tasks, by task.
    ///
    /// # Errors
    /// The store fails.
    pub fn labels_to(&self, tasks: Vec<i64>) -> Result<Vec<Label>, Error> {
        self.read(move |tx| read::labels_to(tx, &tasks))
    }

    /// The range of the next keys after a key, or `None` after the last.
    ///
    /// # Errors
    /// The store fails.
    pub fn next_keys(&self, after: &str, count: usize) -> Result<Option<KeyRange>, Error> {
        let after = after.to_owned();
        self.read(move |tx| read::next_keys(tx, after, count))
    }

    /// Submitted answers to a range of tasks, sorted by task key and author.
    ///
    /// # Errors
    /// The store fails.
    pub fn labels_of(&self, keys: &KeyRange) -> Result<Vec<(TaskRecord, Label)>, Error> {
        let keys = keys.clone();
        self.read(move |tx| read::labels_of(tx, &keys))
    }

    /// Accepted answers to a range of tasks, sorted by task key.
    ///
    /// # Errors
    /// The store fails.
    pub fn accepted(&self, keys: &KeyRange) -> Result<Vec<AcceptedAnswer>, Error> {
        let keys = keys.clone();
        self.read(move |tx| read::accepted(tx, &keys))
    }

    /// Number of accepted answers by how they were accepted: `review`, `own`, `rule:NAME` or `import`.
    ///
    /// # Errors
    /// The store fails.
    pub fn accepted_by(&self) -> Result<Vec<(String, i64)>, Error> {
        self.read(read::accepted_by)
    }

    /// Dropped and skipped tasks of a range.
    ///
    /// # Errors
    /// The store fails.
    pub fn rejects(&self, keys: &KeyRange) -> Result<Vec<Reject>, Error> {
        let keys = keys.clone();
        self.read(move |tx| read::rejects(tx, &keys))
    }

    /// Pairs kept by category and edit type.
    ///
    /// # Errors
    /// The store fails.
    pub fn kept(&self) -> Result<Vec<(Option<String>, String, i64)>, Error> {
        self.read(read::kept)
    }

    /// All leases.
    ///
    /// # Errors
    /// The store fails.
    pub fn leases(&self, now: Millis) -> Result<Vec<HeldLease>, Error> {
        self.read(move |tx| read::leases(tx, now))
    }

    /// Entries of the log, newest first.
    ///
    /// # Errors
    /// The store fails.
    pub fn audit(&self, filter: AuditFilter) -> Result<Audit, Error> {
        self.read(move |tx| read::audit(tx, &filter))
    }

    /// Entries of the log after a sequence number, oldest first.
    ///
    /// # Errors
    /// The store fails.
    pub fn log(&self, after: i64, limit: usize) -> Result<Vec<AuditEntry>, Error> {
        self.read(move |tx| read::log(tx, after, limit))
    }

    /// Last sequence number of the log.
    ///
    /// # Errors
    /// The store fails.
    pub fn last_seq(&self) -> Result<i64, Error> {
        self.read(|tx| tx.number("SELECT COALESCE(MAX(seq), 0) FROM event", &[]))
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

    /// The settings.
    ///
    /// # Errors
    /// The store fails.
    pub fn settings(&self) -> Result<Settings, Error> {
        self.read(project::settings)
    }

    /// Changes the settings. A changed number of people is applied to all tasks that still want answers, some at
    /// a time.
    ///
    /// # Errors
    /// `invalid`; or the store fails.
    pub fn put_settings(&self, actor: i64, settings: Settings, now: Millis) -> Result<(), Error> {
        self.write(move |tx| project::put_settings(tx, actor, settings, now))?;
        while !self.write(move |tx| project::retarget(tx, actor, now))? {}
        Ok(())
    }

    /// A user's preferences.
    ///
    /// # Errors
    /// The store fails.
    pub fn prefs(&self, user: i64) -> Result<Prefs, Error> {
        self.read(move |tx| project::prefs(tx, user))
    }

    /// Changes a user's preferences.
    ///
    /// # Errors
    /// The store fails.
    pub fn put_prefs(&self, user: i64, prefs: Prefs) -> Result<(), Error> {
        self.write(move |tx| project::put_prefs(tx, user, &prefs))
    }

    /// All users.
    ///
    /// # Errors
    /// The store fails.
    pub fn users(&self) -> Result<Vec<User>, Error> {
        self.read(people::users)
    }

    /// Adds a user.
    ///
    /// # Errors
    /// `invalid` for a bad or taken name; or the store fails.
    pub fn add_user(
        &self,
        actor: Option<i64>,
        name: &str,
        role: Role,
        now: Millis,
    ) -> Result<User, Error> {
        let name = name.to_owned();
        self.write_people(move |tx| people::add(tx, actor, &name, role, now))
    }

    /// Changes a user. The last active admin cannot be demoted or disabled.
    ///
    /// # Errors
    /// `invalid`, `not_found`; or the store fails.
    pub fn change_user(
        &self,
        actor: Option<i64>,
        user: i64,
        role: Option<Role>,
        active: Option<bool>,
        now: Millis,
    ) -> Result<User, Error> {
        self.write_people(move |tx| people::change(tx, actor, user, role, active, now))
    }

    /// Creates a token.
    ///
    /// # Errors
    /// `not_found`; or the store fails.
    pub fn issue(
        &self,
        user: i64,
        purpose: TokenUse,
        expires: Millis,
        now: Millis,
    ) -> Result<IssuedToken, Error> {
        self.write_people(move |tx| people::issue(tx, user, purpose, expires, now))
    }

    /// The user of a token, if it is valid for this purpose. A one-time token becomes invalid.
    ///
    /// # Errors
    /// `unauthenticated`; or the store fails.
    pub fn authenticate(
        &self,
        token: &str,
        purposes: &[TokenUse],
        now: Millis,
    ) -> Result<Who, Error> {
        let hash = people::hash(token);
        let changes = {
            let known = self.known();
            if let Some(who) = known.find(&hash, purposes, now) {
                return Ok(who);
            }
            known.changes()
        };
        let purposes = purposes.to_vec();
        let found = {
            let (hash, purposes) = (hash.clone(), purposes.clone());
            self.read(move |tx| people::find(tx, &hash, &purposes, now))?
        };
        if found.needs_note {
            return self.write(move |tx| people::used(tx, &hash, &purposes, now));
        }
        let who = found.who.clone();
        self.known().put(hash, found, changes, now);
        Ok(who)
    }

    /// [`Self::authenticate`] without a record of the use.
    ///
    /// # Errors
    /// `unauthenticated`; or the store fails.
    pub fn recognise(&self, token: &str, purposes: &[TokenUse], now: Millis) -> Result<Who, Error> {
        let (hash, purposes) = (people::hash(token), purposes.to_vec());
        self.read(move |tx| Ok(people::find(tx, &hash, &purposes, now)?.who))
    }

    /// Begins a session by a token, until a time or the end of the token.
    ///
    /// # Errors
    /// `unauthenticated`; or the store fails.
    pub fn log_in(
        &self,
        token: &str,
        until: Millis,
        now: Millis,
    ) -> Result<(Who, IssuedToken), Error> {
        let hash = people::hash(token);
        self.write_people(move |tx| people::log_in(tx, &hash, until, now))
    }

    /// A user's tokens.
    ///
    /// # Errors
    /// The store fails.
    pub fn tokens(&self, user: i64) -> Result<Vec<TokenInfo>, Error> {
        self.read(move |tx| people::tokens(tx, user))
    }

    /// Revokes a token.
    ///
    /// # Errors
    /// `not_found`; or the store fails.
    pub fn revoke(&self, token: i64) -> Result<(), Error> {
        self.write_people(move |tx| people::revoke(tx, token))
    }

    /// Revokes a session.
    ///
    /// # Errors
    /// The store fails.
    pub fn log_out(&self, token: &str) -> Result<(), Error> {
        let hash = people::hash(token);
        self.write_people(move |tx| {
            tx.execute(
                "UPDATE token SET revoked = 1 WHERE hash = ?1",
                params![&hash],
            )?;
            Ok(())
        })
    }

    /// Stores a job; id 0 creates a new one.
    ///
    /// # Errors
    /// The store fails.
    pub fn put_job(&self, job: Job, now: Millis) -> Result<Job, Error> {
        self.write(move |tx| project::put_job(tx, job, now))
    }

    /// Whether servers on several machines can use the store. If so, it also keeps the files of their exports.
    pub(crate) fn is_shared(&self) -> bool {
        self.db.is_shared()
    }

    /// Stores a file of a job, and removes those of all jobs but the last `kept`.
    pub(crate) fn put_file(
        &self,
        job: i64,
        name: &str,
        mut content: impl Read,
        kept: i64,
    ) -> Result<(), Error> {
        for number in 0.. {
            let mut bytes = Vec::new();
            content
                .by_ref()
                .take(FILE_PART)
                .read_to_end(&mut bytes)
                .map_err(datasets_spec::Error::io("read", name))?;
            let is_last = (bytes.len() as u64) < FILE_PART;
            let name = name.to_owned();
            self.write(move |tx| project::put_file_part(tx, job, &name, number, bytes))?;
            if is_last {
                break;
            }
        }
        self.write(move |tx| project::forget_files(tx, kept))
    }

    /// A file of a job, if the store keeps it.
    pub(crate) fn file(&self, job: i64, name: &str) -> Result<Option<Vec<u8>>, Error> {
        let mut content = None;
        for number in 0.. {
            let name = name.to_owned();
            match self.read(move |tx| project::file_part(tx, job, &name, number))? {
                Some(part) => content.get_or_insert_with(Vec::new).extend(part),
                None => break,
            }
        }
        Ok(content)
    }

    /// Records that a job runs.
    ///
    /// # Errors
    /// The store fails.
    pub fn beat(&self, job: i64, now: Millis) -> Result<(), Error> {
        self.write(move |tx| project::beat(tx, job, now))
    }

    /// Marks running jobs as failed if their server last reported them before `since`.
    ///
    /// # Errors
    /// The store fails.
    pub fn abandon(&self, since: Millis, now: Millis) -> Result<(), Error> {
        let is_lost = move |job: &Job| job.state == "running" && job.heartbeat < since;
        if !self.jobs()?.iter().any(is_lost) {
            return Ok(());
        }
        self.write(move |tx| {
            // Read again: the job may have reported meanwhile.
            for mut job in project::jobs(tx)?.into_iter().filter(is_lost) {
                "failed".clone_into(&mut job.state);
                job.finished = Some(now);
                job.messages
                    .push("the server that ran this job stopped; start the job again".to_owned());
                project::put_job(tx, job, now)?;
            }
            Ok(())
        })
    }

    /// Jobs, newest first.
    ///
    /// # Errors
    /// The store fails.
    pub fn jobs(&self) -> Result<Vec<Job>, Error> {
        self.read(project::jobs)
    }

    /// Logs an export.
    ///
    /// # Errors
    /// The store fails.
    pub fn log_export(
        &self,
        actor: Option<i64>,
        body: serde_json::Value,
        now: Millis,
    ) -> Result<(), Error> {
        self.write(move |tx| {
            let entry = Entry {
                at: now,
                actor,
                task: None,
                epoch: None,
                body: Body::Exported { export: body },
            };
            log::note(tx, &entry).map(|_| ())
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
        self.db.backup(path)
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
        let shared =
            SharedClock::new(move || store.db.time().and_then(|time| time.ok_or(Error::Closed)))?;
        Ok(Some(Arc::new(move || shared.now())))
    }

    /// Checks that the store accepts writes, by writing.
    ///
    /// # Errors
    /// It does not.
    pub fn check(&self) -> Result<(), Error> {
        self.db.check()
    }
}
