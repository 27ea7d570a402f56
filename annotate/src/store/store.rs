//! The store as a whole. Its operations on tasks, people and files are in other modules, by topic.

use std::path::Path;
use std::sync::Arc;

use super::db::{Database, Result, Tx, with_value};
use super::records::Millis;
use crate::clock::{self, Clock};

/// An upgrade of a store's tables, made when the store was opened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Upgrade {
    /// Version of the tables before the upgrade.
    pub from: i64,
    /// Version of the tables after the upgrade.
    pub to: i64,
    /// Where the copy made before the upgrade is.
    pub copy: String,
}

/// A store of tasks, answers and users. Every changing operation is one transaction, durable when it returns.
/// The caller passes the time: a store has no clock.
///
/// # Errors
/// Every operation fails if the database does; each operation names the codes with which it refuses requests.
pub struct Store {
    pub(super) db: Box<dyn Database>,
    upgrade: Option<Upgrade>,
}

impl Store {
    pub(super) fn new(db: Box<dyn Database>, upgrade: Option<Upgrade>) -> Self {
        Self { db, upgrade }
    }

    /// The upgrade that opening the store made, if its tables were of an older version.
    pub fn upgrade(&self) -> Option<&Upgrade> {
        self.upgrade.as_ref()
    }

    pub(super) fn write<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut dyn Tx) -> Result<T> + Send + 'static,
    ) -> Result<T> {
        with_value(|work| self.db.write(work), work)
    }

    pub(super) fn read<T: Send>(
        &self,
        work: impl FnOnce(&mut dyn Tx) -> Result<T> + Send,
    ) -> Result<T> {
        with_value(|work| self.db.read(work), work)
    }

    /// Whether servers on several machines can use the store. If so, it also keeps the files of their exports.
    pub(crate) fn is_shared(&self) -> bool {
        self.db.time().is_some()
    }

    /// A read-only snapshot of the store: later writes do not appear in it.
    pub fn snapshot(&self) -> Result<Self> {
        Ok(Self::new(self.db.snapshot()?, None))
    }

    /// Writes a backup of the store to a new file.
    ///
    /// # Errors
    /// The file exists.
    pub fn backup(&self, path: &Path) -> Result<()> {
        self.db.backup(path, true)
    }

    /// Writes the store without tokens and sessions to a new file, for another machine.
    ///
    /// # Errors
    /// As [`Self::backup`].
    pub fn pack(&self, path: &Path) -> Result<()> {
        self.db.backup(path, false)
    }

    /// Checks that the store can be read and that its writer answers, without writing anything. Only a write detects a
    /// full disk.
    ///
    /// # Errors
    /// The store does not answer, or is read-only.
    pub fn ready(&self) -> Result<()> {
        self.read(|tx| tx.number("SELECT COUNT(*) FROM pref WHERE usr = 0", &[]))?;
        // A transaction without changes takes the writer's lock, and commits nothing.
        self.write(|_| Ok(()))
    }

    /// The time of the database, for a store that several machines share. Their own clocks may differ by more than the
    /// duration of a lease.
    pub fn now(&self) -> Result<Option<Millis>> {
        let sql = self.db.time();
        sql.map(|sql| self.read(|tx| tx.number(sql, &[])))
            .transpose()
    }

    /// A clock that shows [`Self::now`], for a store that several machines share.
    pub fn clock(self: &Arc<Self>) -> Result<Option<Clock>> {
        if self.db.time().is_none() {
            return Ok(None);
        }
        let store = Arc::clone(self);
        let read = move || Ok(store.now()?.unwrap_or(0));
        Ok(Some(clock::shared(read)?))
    }
}
