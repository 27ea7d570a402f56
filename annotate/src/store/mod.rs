//! The store: what is asked of it, and its two databases.
//!
//! Everything that happens to a task is an entry of the log (`event`), which only grows. The tables
//! beside it are projections: each entry is applied to them in the transaction that writes it, and
//! [`Store::rebuild`] makes them again from the log alone.

pub(crate) mod db;
mod engine;
mod group;
mod log;
mod people;
#[cfg(feature = "postgres")]
mod postgres;
mod project;
mod read;
mod sqlite;

use std::path::Path;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::Error;
use crate::state::LogKind;
use crate::wire::{
    Answer, Audit, AuditEntry, Decision, Empty, EventResult, HeldLease, Home, Job, Lease, NewEvent,
    NewReview, Prefs, ReviewDone, ReviewEmpty, ReviewQueue, Revision, Role, Settings, Suggestion,
    SuggestionSource, TaskKind, TaskState, TokenInfo, User, Verdict,
};

pub use engine::SqlStore;

/// Milliseconds since the epoch.
pub type Millis = i64;

/// Somebody who is logged in.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Who {
    /// Id.
    pub id: i64,
    /// Name.
    pub name: String,
    /// What they may do.
    pub role: Role,
}

/// A motion the tasks speak of; its frames stay in the dataset.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotionRecord {
    /// Content hash.
    pub hash: String,
    /// Id in the dataset.
    pub id: String,
    /// train, val or test.
    pub split: String,
    /// Frames.
    pub frames: i64,
    /// Frames a second.
    pub fps: f64,
    /// Captions of the source.
    pub captions: Vec<String>,
    /// Style label of the source.
    pub style: Option<String>,
    /// Action label of the source.
    pub action: Option<String>,
}

/// A task to be imported.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NewTask {
    /// What tells it from others: importing the same key again changes nothing.
    pub key: String,
    /// What is asked.
    pub kind: TaskKind,
    /// Hash of the motion, or of the one before the edit.
    pub source: String,
    /// Hash of the motion after the edit.
    pub target: Option<String>,
    /// train, val or test.
    pub split: String,
    /// Name of the bundle it belongs to.
    pub bundle: Option<String>,
    /// Place in the bundle.
    pub bundle_index: i64,
    /// Action category.
    pub category: Option<String>,
    /// What a pair was made for.
    pub hint: Option<String>,
    /// Style the source gives.
    pub style: Option<String>,
    /// Tasks of higher priority are given first.
    pub priority: i64,
    /// The known answer, of a gold task.
    pub gold: Option<Answer>,
    /// Fields of a source's file that have no place here, kept to be written back.
    pub extra: Option<serde_json::Value>,
    /// Suggestions that come with it.
    pub suggestions: Vec<NewSuggestion>,
    /// An answer that the source holds as decided: the task is accepted from the start.
    pub accepted: Option<Answer>,
}

/// A suggestion to be stored.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NewSuggestion {
    /// Where it came from.
    pub source: SuggestionSource,
    /// Parts it speaks of.
    pub parts: Vec<String>,
    /// Text.
    pub text: String,
    /// What made it.
    pub model: String,
    /// SHA-256 of the prompt, hexadecimal; empty without one.
    pub prompt_hash: String,
    /// Parameters of the request, JSON.
    pub params: String,
    /// Tokens the model counted, if it says.
    pub tokens: Option<i64>,
    /// SHA-256 of the response, hexadecimal; empty without one.
    pub response_hash: String,
}

/// A task as it is stored.
#[derive(Clone, Debug, PartialEq)]
pub struct TaskRecord {
    /// Id.
    pub id: i64,
    /// What tells it from others.
    pub key: String,
    /// What is asked.
    pub kind: TaskKind,
    /// Hash of the first motion.
    pub source: String,
    /// Hash of the second motion.
    pub target: Option<String>,
    /// train, val or test.
    pub split: String,
    /// Bundle.
    pub bundle: Option<i64>,
    /// Place in the bundle.
    pub bundle_index: i64,
    /// Action category.
    pub category: Option<String>,
    /// What a pair was made for.
    pub hint: Option<String>,
    /// Style the source gives.
    pub style: Option<String>,
    /// Answers wanted.
    pub wanted: u32,
    /// The known answer, of a gold task.
    pub gold: Option<Answer>,
    /// Fields kept for their source.
    pub extra: Option<serde_json::Value>,
    /// Where it stands.
    pub state: TaskState,
    /// Answers handed in.
    pub submitted: u32,
    /// A number from 0 to 99 drawn by its key.
    pub shuffle: i64,
    /// How far its answers are apart.
    pub distance: Option<f64>,
}

/// A task of a bundle, as somebody sees it.
#[derive(Clone, Debug, PartialEq)]
pub struct BundleEntry {
    /// Task.
    pub task: i64,
    /// State of their answer.
    pub mine: Option<crate::wire::RevisionState>,
    /// Their verdict.
    pub verdict: Option<Verdict>,
    /// Whether they hold a lease on it.
    pub leased: bool,
}

/// A task with everything somebody may see of it.
#[derive(Clone, Debug, PartialEq)]
pub struct TaskDetail {
    /// The task.
    pub task: TaskRecord,
    /// Its bundle.
    pub bundle: Vec<BundleEntry>,
    /// Their lease.
    pub lease: Option<Lease>,
    /// Their answer.
    pub mine: Option<Revision>,
    /// The comment it came back with.
    pub comment: Option<String>,
    /// Suggestions; none where they are withheld.
    pub suggestions: Vec<Suggestion>,
    /// Whether they are withheld.
    pub blind: bool,
}

/// What a claim gives.
#[derive(Clone, Debug, PartialEq)]
pub enum Claimed {
    /// A task; the lease on it is held.
    Task {
        /// The task as its holder may see it.
        detail: Box<TaskDetail>,
        /// Hashes of the motions of the tasks that would follow.
        upcoming: Vec<String>,
    },
    /// Nothing, and why.
    Nothing(Empty),
}

/// What a reviewer is given.
#[derive(Clone, Debug, PartialEq)]
pub enum ReviewClaimed {
    /// A task to be judged.
    Task(Box<ReviewDetail>),
    /// Nothing, and why.
    Nothing(ReviewEmpty),
}

/// A task to be judged.
#[derive(Clone, Debug, PartialEq)]
pub struct ReviewDetail {
    /// The task.
    pub task: TaskRecord,
    /// The reviewer's lease.
    pub lease: Lease,
    /// Answers handed in, with the names of their authors.
    pub candidates: Vec<(Revision, String)>,
    /// Comments of earlier rounds.
    pub comments: Vec<String>,
}

/// Tasks whose keys are above one and not above another, by their bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KeyRange {
    /// The key before the first.
    pub after: String,
    /// The last key.
    pub up_to: String,
}

/// An answer with its task, for figures and exports.
#[derive(Clone, Debug, PartialEq)]
pub struct Label {
    /// Task.
    pub task: i64,
    /// Its kind.
    pub kind: TaskKind,
    /// Whether it is a gold task.
    pub gold: bool,
    /// Its category.
    pub category: Option<String>,
    /// Hash of its first motion.
    pub source: String,
    /// Hash of its second motion.
    pub target: Option<String>,
    /// Split.
    pub split: String,
    /// The answer.
    pub revision: Revision,
    /// Whether suggestions were withheld.
    pub blind: bool,
}

/// An accepted answer with its task.
#[derive(Clone, Debug, PartialEq)]
pub struct AcceptedAnswer {
    /// The task.
    pub task: TaskRecord,
    /// Its author: an annotator, or the reviewer who merged.
    pub author: i64,
    /// Whether a reviewer made it of several.
    pub merged: bool,
    /// The answer.
    pub answer: Answer,
    /// When it was accepted.
    pub at: Millis,
    /// Place in the log.
    pub seq: i64,
}

/// A task that was dropped, or skipped by somebody.
#[derive(Clone, Debug, PartialEq)]
pub struct Reject {
    /// The task.
    pub task: TaskRecord,
    /// Who decided.
    pub user: Option<i64>,
    /// Why.
    pub reason: String,
    /// More about it.
    pub note: String,
}

/// Which accepted answers to show.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ShelfFilter {
    /// Of one kind.
    pub kind: Option<TaskKind>,
    /// With a part.
    pub part: Option<String>,
    /// With these words.
    pub text: Option<String>,
    /// Before this place in the log.
    pub before: Option<i64>,
    /// At most so many.
    pub limit: usize,
}

/// Which entries of the log to show.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AuditFilter {
    /// By somebody.
    pub actor: Option<i64>,
    /// Of a kind.
    pub kind: Option<LogKind>,
    /// About a task.
    pub task: Option<i64>,
    /// Before this place in the log.
    pub before: Option<i64>,
    /// At most so many.
    pub limit: usize,
}

/// What somebody did, summed up.
#[derive(Clone, Debug, PartialEq)]
pub struct PersonCounts {
    /// Who.
    pub user: User,
    /// Answers handed in.
    pub done: i64,
    /// Answers accepted.
    pub accepted: i64,
    /// Answers sent back, ever.
    pub returned: i64,
    /// Scores on gold tasks.
    pub gold: Vec<f64>,
    /// Last entry of the log by them.
    pub last_seen: Option<Millis>,
}

/// Counts of a week.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WeekCounts {
    /// Answers handed in.
    pub submitted: i64,
    /// Accepted or merged.
    pub accepted: i64,
    /// Sent back.
    pub returned: i64,
}

/// A new token, shown once.
#[derive(Clone, Debug, PartialEq)]
pub struct IssuedToken {
    /// Whose it is.
    pub user: User,
    /// Id.
    pub id: i64,
    /// The token.
    pub token: String,
    /// When it ends.
    pub expires: Millis,
}

/// What importing tasks did.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Imported {
    /// Tasks that are new.
    pub new: i64,
    /// Tasks that were there already.
    pub known: i64,
}

/// What a token is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TokenUse {
    /// Given to a person or a program, and used to log in or as a bearer.
    Token,
    /// Good for one login.
    Once,
    /// The cookie of a browser.
    Session,
}

impl TokenUse {
    /// Its name in the store.
    pub(crate) fn as_str(self) -> &'static str {
        match self {
            Self::Token => "token",
            Self::Once => "once",
            Self::Session => "session",
        }
    }
}

/// A store of tasks, answers and people. Every operation that changes something is one transaction,
/// durable when it returns. Times are given, so that a store has no clock of its own.
pub trait Store: Send + Sync {
    /// Takes motions; those that are known keep their place.
    ///
    /// # Errors
    /// The store fails.
    fn put_motions(&self, motions: Vec<MotionRecord>) -> Result<(), Error>;
    /// Takes tasks; those whose key is known stay as they are.
    ///
    /// # Errors
    /// The store fails.
    fn import(
        &self,
        actor: Option<i64>,
        tasks: Vec<NewTask>,
        now: Millis,
    ) -> Result<Imported, Error>;
    /// Claims the next task of a kind, or gives the one that is held, and looks `ahead` tasks ahead.
    ///
    /// # Errors
    /// The store fails.
    fn claim(&self, user: i64, kind: TaskKind, ahead: usize, now: Millis)
    -> Result<Claimed, Error>;
    /// Claims a certain task.
    ///
    /// # Errors
    /// `task_full`, `not_found`, `wrong_state`; or the store fails.
    fn claim_task(&self, user: i64, task: i64, now: Millis) -> Result<TaskDetail, Error>;
    /// Prolongs a lease.
    ///
    /// # Errors
    /// `lease_lost`; or the store fails.
    fn renew(&self, user: i64, lease: i64, now: Millis) -> Result<Lease, Error>;
    /// Gives a lease back; a reviewer may take one away.
    ///
    /// # Errors
    /// `not_found`; or the store fails.
    fn release(&self, who: &Who, lease: i64, now: Millis) -> Result<(), Error>;
    /// Takes events of a task, in order, up to the first that fails.
    ///
    /// # Errors
    /// `not_found`; or the store fails.
    fn append(
        &self,
        user: i64,
        task: i64,
        events: Vec<NewEvent>,
        now: Millis,
    ) -> Result<Vec<EventResult>, Error>;
    /// A task as somebody may see it.
    ///
    /// # Errors
    /// `not_found`; or the store fails.
    fn task(&self, who: &Who, task: i64) -> Result<TaskDetail, Error>;
    /// A task, for the server itself.
    ///
    /// # Errors
    /// `not_found`; or the store fails.
    fn task_record(&self, task: i64) -> Result<TaskRecord, Error>;
    /// Claims the next task to be reviewed.
    ///
    /// # Errors
    /// The store fails.
    fn review_next(
        &self,
        user: i64,
        queue: ReviewQueue,
        kind: Option<TaskKind>,
        now: Millis,
    ) -> Result<ReviewClaimed, Error>;
    /// Takes a decision.
    ///
    /// # Errors
    /// `own_work`, `lease_lost`, `wrong_state`, `invalid`, `not_found`, `key_reused`; or the store fails.
    fn review(&self, user: i64, review: NewReview, now: Millis) -> Result<ReviewDone, Error>;
    /// Makes a hidden gold task of an accepted one.
    ///
    /// # Errors
    /// `wrong_state`, `not_found`; or the store fails.
    fn make_gold(&self, actor: i64, task: i64, now: Millis) -> Result<i64, Error>;

    /// Motions by their hashes.
    ///
    /// # Errors
    /// The store fails.
    fn motions(&self, hashes: Vec<String>) -> Result<Vec<MotionRecord>, Error>;
    /// All motions.
    ///
    /// # Errors
    /// The store fails.
    fn all_motions(&self) -> Result<Vec<MotionRecord>, Error>;
    /// Motions of a split, without one, for previews: up to `limit` of them.
    ///
    /// # Errors
    /// The store fails.
    fn partners(&self, hash: &str, limit: usize) -> Result<Vec<MotionRecord>, Error>;
    /// What somebody finds when they come in.
    ///
    /// # Errors
    /// The store fails.
    fn home(&self, user: i64, now: Millis) -> Result<Home, Error>;
    /// Accepted answers.
    ///
    /// # Errors
    /// The store fails.
    fn shelf(&self, user: i64, filter: ShelfFilter) -> Result<Vec<AcceptedAnswer>, Error>;
    /// Tasks by kind and state.
    ///
    /// # Errors
    /// The store fails.
    fn funnel(&self) -> Result<Vec<(TaskKind, TaskState, i64)>, Error>;
    /// Counts of some weeks, given by their starts and the end of the last one.
    ///
    /// # Errors
    /// The store fails.
    fn weeks(&self, bounds: Vec<Millis>) -> Result<Vec<WeekCounts>, Error>;
    /// What everybody did.
    ///
    /// # Errors
    /// The store fails.
    fn people(&self) -> Result<Vec<PersonCounts>, Error>;
    /// Answers handed in, by task, after a task, so many tasks at a time.
    ///
    /// # Errors
    /// The store fails.
    fn labels(&self, after: i64, limit: usize) -> Result<Vec<Label>, Error>;
    /// The keys of the tasks that follow a key, so many of them; none after the last.
    ///
    /// # Errors
    /// The store fails.
    fn next_keys(&self, after: &str, count: usize) -> Result<Option<KeyRange>, Error>;
    /// Answers handed in to some tasks, with the task, by its key and by author.
    ///
    /// # Errors
    /// The store fails.
    fn labels_of(&self, keys: &KeyRange) -> Result<Vec<(TaskRecord, Label)>, Error>;
    /// Accepted answers to some tasks, by the key of their task.
    ///
    /// # Errors
    /// The store fails.
    fn accepted(&self, keys: &KeyRange) -> Result<Vec<AcceptedAnswer>, Error>;
    /// Those of some tasks that were dropped or skipped: with who, why and when.
    ///
    /// # Errors
    /// The store fails.
    fn rejects(&self, keys: &KeyRange) -> Result<Vec<Reject>, Error>;
    /// Pairs kept by category and edit type.
    ///
    /// # Errors
    /// The store fails.
    fn kept(&self) -> Result<Vec<(Option<String>, String, i64)>, Error>;
    /// Leases that are held.
    ///
    /// # Errors
    /// The store fails.
    fn leases(&self, now: Millis) -> Result<Vec<HeldLease>, Error>;
    /// Entries of the log, newest first.
    ///
    /// # Errors
    /// The store fails.
    fn audit(&self, filter: AuditFilter) -> Result<Audit, Error>;
    /// Entries of the log after a place, oldest first.
    ///
    /// # Errors
    /// The store fails.
    fn log(&self, after: i64, limit: usize) -> Result<Vec<AuditEntry>, Error>;
    /// The last place of the log.
    ///
    /// # Errors
    /// The store fails.
    fn last_seq(&self) -> Result<i64, Error>;
    /// Whether a task concerns somebody: they hold it or answered it.
    ///
    /// # Errors
    /// The store fails.
    fn concerns(&self, user: i64, task: i64) -> Result<bool, Error>;

    /// Suggestions by their ids.
    ///
    /// # Errors
    /// The store fails.
    fn suggestions(&self, ids: Vec<i64>) -> Result<Vec<Suggestion>, Error>;
    /// Keeps a suggestion.
    ///
    /// # Errors
    /// The store fails.
    fn put_suggestion(
        &self,
        task: i64,
        suggestion: NewSuggestion,
        now: Millis,
    ) -> Result<Suggestion, Error>;
    /// A suggestion made of the same prompt before.
    ///
    /// # Errors
    /// The store fails.
    fn cached_suggestion(&self, prompt_hash: &str) -> Result<Option<NewSuggestion>, Error>;

    /// Something the program remembers about the store, such as what was imported last.
    ///
    /// # Errors
    /// The store fails.
    fn note(&self, name: &str) -> Result<Option<String>, Error>;
    /// Remembers something.
    ///
    /// # Errors
    /// The store fails.
    fn put_note(&self, name: &str, text: &str) -> Result<(), Error>;
    /// The settings.
    ///
    /// # Errors
    /// The store fails.
    fn settings(&self) -> Result<Settings, Error>;
    /// Changes the settings.
    ///
    /// # Errors
    /// `invalid`; or the store fails.
    fn put_settings(&self, actor: i64, settings: Settings, now: Millis) -> Result<(), Error>;
    /// Somebody's preferences.
    ///
    /// # Errors
    /// The store fails.
    fn prefs(&self, user: i64) -> Result<Prefs, Error>;
    /// Changes somebody's preferences.
    ///
    /// # Errors
    /// The store fails.
    fn put_prefs(&self, user: i64, prefs: Prefs) -> Result<(), Error>;
    /// All users.
    ///
    /// # Errors
    /// The store fails.
    fn users(&self) -> Result<Vec<User>, Error>;
    /// Adds a user.
    ///
    /// # Errors
    /// `invalid` for a bad or taken name; or the store fails.
    fn add_user(
        &self,
        actor: Option<i64>,
        name: &str,
        role: Role,
        now: Millis,
    ) -> Result<User, Error>;
    /// Changes a user. The last active admin stays one.
    ///
    /// # Errors
    /// `invalid`, `not_found`; or the store fails.
    fn change_user(
        &self,
        actor: Option<i64>,
        user: i64,
        role: Option<Role>,
        active: Option<bool>,
        now: Millis,
    ) -> Result<User, Error>;
    /// Makes a token.
    ///
    /// # Errors
    /// `not_found`; or the store fails.
    fn issue(
        &self,
        user: i64,
        purpose: TokenUse,
        expires: Millis,
        now: Millis,
    ) -> Result<IssuedToken, Error>;
    /// Whose token this is, if it is good for this use. One that is good once is used up.
    ///
    /// # Errors
    /// `unauthenticated`; or the store fails.
    fn authenticate(&self, token: &str, purposes: &[TokenUse], now: Millis) -> Result<Who, Error>;
    /// Somebody's tokens.
    ///
    /// # Errors
    /// The store fails.
    fn tokens(&self, user: i64) -> Result<Vec<TokenInfo>, Error>;
    /// Makes a token useless.
    ///
    /// # Errors
    /// `not_found`; or the store fails.
    fn revoke(&self, token: i64) -> Result<(), Error>;
    /// Makes a session useless.
    ///
    /// # Errors
    /// The store fails.
    fn log_out(&self, token: &str) -> Result<(), Error>;

    /// Keeps what is known of a job; an id of 0 makes a new one.
    ///
    /// # Errors
    /// The store fails.
    fn put_job(&self, job: Job) -> Result<Job, Error>;
    /// Jobs, newest first.
    ///
    /// # Errors
    /// The store fails.
    fn jobs(&self) -> Result<Vec<Job>, Error>;
    /// Logs an export.
    ///
    /// # Errors
    /// The store fails.
    fn log_export(
        &self,
        actor: Option<i64>,
        body: serde_json::Value,
        now: Millis,
    ) -> Result<(), Error>;

    /// Makes the projections again from the log; gives the names of the tables that differed.
    ///
    /// # Errors
    /// The store fails, or an entry of the log cannot be read.
    fn rebuild(&self) -> Result<Vec<&'static str>, Error>;
    /// Findings of a check of the whole store: places missing in the log, projections that do not follow from it.
    ///
    /// # Errors
    /// The store fails.
    fn verify(&self) -> Result<Vec<String>, Error>;
    /// Writes a copy of the store to a new file.
    ///
    /// # Errors
    /// The store fails, or the file exists.
    fn backup(&self, path: &Path) -> Result<(), Error>;
    /// Whether a write would be taken now.
    ///
    /// # Errors
    /// It would not.
    fn check(&self) -> Result<(), Error>;
}

/// Opens the store of a file, creating it if needed.
///
/// # Errors
/// The file cannot be opened, is of another version, or lies on a network file system.
pub fn open_sqlite(path: &Path) -> Result<Arc<dyn Store>, Error> {
    Ok(Arc::new(SqlStore::new(Box::new(sqlite::Sqlite::open(
        path,
    )?))))
}

/// Opens a store on PostgreSQL, creating its tables in the schema if needed.
///
/// # Errors
/// The server cannot be reached, or its tables are of another version.
#[cfg(feature = "postgres")]
pub fn open_postgres(url: &str, schema: &str) -> Result<Arc<dyn Store>, Error> {
    Ok(Arc::new(SqlStore::new(Box::new(postgres::Postgres::open(
        url, schema,
    )?))))
}

/// The decision as the log says it.
pub(crate) fn log_kind(decision: Decision) -> LogKind {
    match decision {
        Decision::Accept => LogKind::Accepted,
        Decision::Merge => LogKind::Merged,
        Decision::Return => LogKind::Returned,
        Decision::Drop => LogKind::Dropped,
        Decision::Reopen => LogKind::Reopened,
    }
}

impl Default for Settings {
    fn default() -> Self {
        let words = |list: &[&str]| list.iter().map(|&word| word.to_owned()).collect();
        Self {
            name: "stance".to_owned(),
            answers_per_task: 2,
            overlap_percent: 10,
            gold_percent: 2,
            blind_percent: 10,
            review_percent: 100,
            lease_minutes: 15,
            returned_days: 7,
            min_masks: 2,
            max_masks: 4,
            // Styles of the paper (Sec. 4.1) and the one more of the release.
            styles: words(&["proud", "old", "playful", "depressed", "angry", "sexy"]),
            templates: words(&[
                "higher",
                "lower",
                "faster",
                "slower",
                "with more force",
                "with less force",
                "wider",
                "narrower",
                "earlier",
                "later",
                "further to the left",
                "further to the right",
            ]),
            quota: 0,
            guide: include_str!("../guide.txt").to_owned(),
        }
    }
}
