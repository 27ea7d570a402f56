//! Operations that read for home pages, figures, exports and the log.

use super::Store;
use crate::Error;
use crate::store::records::{
    AcceptedAnswer, AuditFilter, KeyRange, Label, Millis, PersonCounts, Reject, ShelfFilter,
    TaskRecord, WeekCounts,
};
use crate::store::{captures, home, read, work};
use crate::wire::{
    Audit, AuditEntry, Captures, DayWork, HeldLease, Home, Outlook, TaskKind, TaskState,
};

impl Store {
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

    /// Contents of a user's home page.
    ///
    /// # Errors
    /// The store fails.
    pub fn home(&self, user: i64, now: Millis) -> Result<Home, Error> {
        self.read(move |tx| home::home(tx, user, now))
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

    /// The capture plan with what has arrived of it; empty without a plan.
    ///
    /// # Errors
    /// The store fails.
    pub fn captures(&self) -> Result<Captures, Error> {
        self.read(captures::captures)
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
}
