//! Common interface to SQLite and PostgreSQL: values, rows and transactions.
//!
//! Both databases share the SQL statements. Parameters are `?1`, `?2` …; integers are `BIGINT`, booleans are
//! 0 and 1, other columns are `TEXT`, `BYTEA` or double precision.

use std::path::Path;

pub(crate) use rusqlite::types::Value;
pub(crate) use rusqlite::{ToSql, params};
use serde::Deserialize;
use serde::de::DeserializeOwned;

use super::columns::Columns;
use crate::Error;

/// The result of work in a transaction.
pub(crate) type Result<T, E = Error> = std::result::Result<T, E>;

/// An error for a row that cannot be read, or a value that cannot be stored.
pub(crate) fn unreadable(table: &'static str, problem: impl std::fmt::Display) -> Error {
    Error::Row {
        table,
        problem: problem.to_string(),
    }
}

/// An error for a store that cannot be opened.
pub(crate) fn not_opened(path: impl std::fmt::Display, reason: impl std::fmt::Display) -> Error {
    Error::Open {
        path: path.to_string(),
        reason: reason.to_string(),
    }
}

/// An error for a store that takes no writes.
pub(crate) fn read_only(reason: impl Into<String>) -> Error {
    Error::ReadOnly {
        reason: reason.into(),
    }
}

/// Serializes a value for a JSON column.
pub(crate) fn json<T: serde::Serialize>(value: &T) -> Result<String> {
    serde_json::to_string(value).map_err(|error| unreadable("of a request", error))
}

/// A row of a result.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Row(pub(crate) Vec<Value>);

impl Row {
    /// Deserializes the row as described in [`super::columns`]. Extra columns are ignored.
    pub(crate) fn read<'a, T: Deserialize<'a>>(&'a self) -> Result<T> {
        let mut columns = Columns(self.0.iter());
        T::deserialize(&mut columns).map_err(|error| {
            let column = self.0.len() - columns.0.len();
            unreadable("of an answer", format!("column {column}: {error}"))
        })
    }
}

/// Values for the parameters of a statement.
pub(crate) type Params<'a> = &'a [&'a dyn ToSql];

/// An open transaction.
pub(crate) trait Tx {
    /// Runs a statement and returns the number of changed rows.
    fn execute(&mut self, sql: &str, params: Params) -> Result<u64>;
    /// Runs a query.
    fn query(&mut self, sql: &str, params: Params) -> Result<Vec<Row>>;

    /// Runs statements. `action` names what they do, for errors.
    fn batch(&mut self, sql: &str, action: &'static str) -> Result<()>;
    /// Runs statements that define tables; each database replaces the placeholders in `schema.sql` by its own keywords.
    fn define(&mut self, sql: &str) -> Result<()>;
}

impl dyn Tx + '_ {
    /// Runs a statement whose number of changed rows does not matter.
    pub(crate) fn run(&mut self, sql: &str, params: Params) -> Result<()> {
        self.execute(sql, params).map(|_| ())
    }

    /// Runs a query and reads its rows.
    pub(crate) fn list<T: DeserializeOwned>(
        &mut self,
        sql: &str,
        params: Params,
    ) -> Result<Vec<T>> {
        let rows = self.query(sql, params)?;
        rows.iter().map(|row| row.read()).collect()
    }

    /// Runs a query and reads its first row.
    pub(crate) fn find<T: DeserializeOwned>(
        &mut self,
        sql: &str,
        params: Params,
    ) -> Result<Option<T>> {
        let rows = self.query(sql, params)?;
        rows.first().map(|row| row.read()).transpose()
    }

    /// [`Self::find`] for a query that always has a row.
    pub(crate) fn get<T: DeserializeOwned>(&mut self, sql: &str, params: Params) -> Result<T> {
        self.find(sql, params)?.ok_or(Error::Closed)
    }

    /// Runs a query for one integer; 0 without rows.
    pub(crate) fn number(&mut self, sql: &str, params: Params) -> Result<i64> {
        Ok(self.find(sql, params)?.unwrap_or(0))
    }

    /// Whether a query has rows.
    pub(crate) fn has(&mut self, sql: &str, params: Params) -> Result<bool> {
        Ok(!self.query(sql, params)?.is_empty())
    }

    /// The next id of a table.
    pub(crate) fn next_id(&mut self, table: &str) -> Result<i64> {
        let sql = format!("SELECT COALESCE(MAX(id), 0) + 1 FROM {table}");
        self.get(&sql, &[])
    }
}

/// Closure run in a transaction.
pub(crate) type Work<'a> = Box<dyn FnOnce(&mut dyn Tx) -> Result<()> + Send + 'a>;

/// A database: write transactions run one after the other, read transactions in parallel. A snapshot can only be read.
pub(crate) trait Database: Send + Sync {
    /// Runs read-only work on a consistent snapshot.
    fn read(&self, work: Work<'_>) -> Result<()>;

    /// Runs work in a transaction and returns once it is durable. Failed work is rolled back.
    fn write(&self, _: Work<'static>) -> Result<()> {
        Err(Error::Closed)
    }

    /// A snapshot of the database; later writes do not appear in it.
    fn snapshot(&self) -> Result<Box<dyn Database>> {
        Err(Error::Closed)
    }

    /// See [`Backend::backup`](super::pool::Backend::backup).
    fn backup(&self, _path: &Path, _with_tokens: bool) -> Result<()> {
        Err(Error::Closed)
    }

    /// SQL for the database's own time, if servers on several machines can share the database.
    fn time(&self) -> Option<&'static str> {
        None
    }
}

/// Passes work to [`Database::read`] or [`Database::write`], which `run` calls, and returns the value of the work.
pub(crate) fn with_value<'a, T: Send + 'a>(
    run: impl FnOnce(Work<'a>) -> Result<()>,
    work: impl FnOnce(&mut dyn Tx) -> Result<T> + Send + 'a,
) -> Result<T> {
    let (sender, receiver) = std::sync::mpsc::channel();
    run(Box::new(move |tx| {
        // The receiver lives until the transaction is durable, so sending cannot fail.
        let _sent = sender.send(work(tx)?);
        Ok(())
    }))?;
    receiver.try_recv().map_err(|_| Error::Closed)
}
