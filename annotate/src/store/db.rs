//! Interface to SQLite and PostgreSQL: values, rows and transactions.
//!
//! Both databases share the SQL statements. Parameters are `?1`, `?2` …; integers are `BIGINT`, booleans are
//! 0 and 1, other columns are `TEXT`, `BYTEA` or double precision.

use std::path::Path;

use crate::Error;

/// The result of work in a transaction.
pub(crate) type Result<T, E = Error> = std::result::Result<T, E>;

/// A value of a parameter or a column.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Value {
    /// NULL.
    Null,
    /// An integer.
    Int(i64),
    /// A floating-point number.
    Real(f64),
    /// Text.
    Text(String),
    /// Bytes.
    Blob(Vec<u8>),
}

impl From<i64> for Value {
    fn from(value: i64) -> Self {
        Self::Int(value)
    }
}

impl From<u32> for Value {
    fn from(value: u32) -> Self {
        Self::Int(value.into())
    }
}

impl From<bool> for Value {
    fn from(value: bool) -> Self {
        Self::Int(value.into())
    }
}

impl From<f64> for Value {
    fn from(value: f64) -> Self {
        Self::Real(value)
    }
}

impl From<&str> for Value {
    fn from(value: &str) -> Self {
        Self::Text(value.to_owned())
    }
}

impl From<String> for Value {
    fn from(value: String) -> Self {
        Self::Text(value)
    }
}

impl From<Vec<u8>> for Value {
    fn from(value: Vec<u8>) -> Self {
        Self::Blob(value)
    }
}

impl From<&String> for Value {
    fn from(value: &String) -> Self {
        Self::Text(value.clone())
    }
}

impl<T: Into<Value>> From<Option<T>> for Value {
    fn from(value: Option<T>) -> Self {
        value.map_or(Self::Null, Into::into)
    }
}

/// The error of a row that cannot be read, or of a value that cannot be stored.
pub(crate) fn unreadable(table: &'static str, problem: impl std::fmt::Display) -> Error {
    Error::Row {
        table,
        problem: problem.to_string(),
    }
}

/// The error of a store that cannot be opened.
pub(crate) fn not_opened(path: impl std::fmt::Display, reason: impl std::fmt::Display) -> Error {
    Error::Open {
        path: path.to_string(),
        reason: reason.to_string(),
    }
}

/// The error of a store that takes no writes.
pub(crate) fn read_only(reason: impl Into<String>) -> Error {
    Error::ReadOnly {
        reason: reason.into(),
    }
}

/// A value as a column of JSON.
pub(crate) fn json<T: serde::Serialize>(value: &T) -> Result<String> {
    serde_json::to_string(value).map_err(|error| unreadable("of a request", error))
}

/// Values for the parameters of a statement.
macro_rules! params {
    ($($value:expr),* $(,)?) => { &[$( $crate::store::db::Value::from($value), )*] };
}
pub(crate) use params;

/// A row of a result.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Row(pub(crate) Vec<Value>);

impl Row {
    fn wrong(&self, column: usize, expected: &str) -> Error {
        unreadable(
            "of an answer",
            format!(
                "column {column} is {:?}, expected {expected}",
                self.0.get(column)
            ),
        )
    }

    pub(crate) fn int(&self, column: usize) -> Result<i64> {
        match self.0.get(column) {
            Some(Value::Int(value)) => Ok(*value),
            _ => Err(self.wrong(column, "a whole number")),
        }
    }

    pub(crate) fn flag(&self, column: usize) -> Result<bool> {
        Ok(self.int(column)? != 0)
    }

    pub(crate) fn count(&self, column: usize) -> Result<u32> {
        u32::try_from(self.int(column)?).map_err(|_| self.wrong(column, "a count"))
    }

    pub(crate) fn real(&self, column: usize) -> Result<f64> {
        match self.0.get(column) {
            Some(Value::Real(value)) => Ok(*value),
            Some(Value::Int(value)) => Ok(*value as f64),
            _ => Err(self.wrong(column, "a number")),
        }
    }

    pub(crate) fn text(&self, column: usize) -> Result<&str> {
        match self.0.get(column) {
            Some(Value::Text(value)) => Ok(value),
            _ => Err(self.wrong(column, "text")),
        }
    }

    pub(crate) fn bytes(&self, column: usize) -> Result<&[u8]> {
        match self.0.get(column) {
            Some(Value::Blob(value)) => Ok(value),
            _ => Err(self.wrong(column, "bytes")),
        }
    }

    pub(crate) fn string(&self, column: usize) -> Result<String> {
        self.text(column).map(str::to_owned)
    }

    /// A column that may be NULL.
    pub(crate) fn opt<T>(
        &self,
        column: usize,
        read: impl FnOnce(&Self, usize) -> Result<T>,
    ) -> Result<Option<T>> {
        match self.0.get(column) {
            Some(Value::Null) => Ok(None),
            _ => read(self, column).map(Some),
        }
    }

    pub(crate) fn opt_int(&self, column: usize) -> Result<Option<i64>> {
        self.opt(column, Self::int)
    }

    pub(crate) fn opt_text(&self, column: usize) -> Result<Option<String>> {
        self.opt(column, Self::string)
    }

    /// A column with one of a list of names.
    pub(crate) fn named<T>(
        &self,
        column: usize,
        parse: impl FnOnce(&str) -> Option<T>,
    ) -> Result<T> {
        parse(self.text(column)?).ok_or_else(|| self.wrong(column, "a name that is known"))
    }

    /// A column of JSON.
    pub(crate) fn json<T: serde::de::DeserializeOwned>(&self, column: usize) -> Result<T> {
        serde_json::from_str(self.text(column)?).map_err(|error| unreadable("of an answer", error))
    }
}

/// An open transaction.
pub(crate) trait Tx {
    /// Runs a statement and returns the number of changed rows.
    fn execute(&mut self, sql: &str, params: &[Value]) -> Result<u64>;
    /// Runs a query.
    fn query(&mut self, sql: &str, params: &[Value]) -> Result<Vec<Row>>;

    /// Runs statements; an error says that the store cannot do the action.
    fn batch(&mut self, sql: &str, action: &'static str) -> Result<()>;
    /// Runs statements that define tables, each database with its own word for what `schema.sql` writes once.
    fn define(&mut self, sql: &str) -> Result<()>;
}

impl dyn Tx + '_ {
    /// Runs a query with at most one row.
    pub(crate) fn one(&mut self, sql: &str, params: &[Value]) -> Result<Option<Row>> {
        Ok(self.query(sql, params)?.into_iter().next())
    }

    /// Runs a query for one integer; 0 without rows.
    pub(crate) fn number(&mut self, sql: &str, params: &[Value]) -> Result<i64> {
        self.one(sql, params)?.map_or(Ok(0), |row| row.int(0))
    }

    /// Runs a statement whose number of changed rows does not matter.
    pub(crate) fn run(&mut self, sql: &str, params: &[Value]) -> Result<()> {
        self.execute(sql, params).map(|_| ())
    }

    /// Runs a query and reads each of its rows.
    pub(crate) fn list<T>(
        &mut self,
        sql: &str,
        params: &[Value],
        read: impl FnMut(&Row) -> Result<T>,
    ) -> Result<Vec<T>> {
        self.query(sql, params)?.iter().map(read).collect()
    }

    /// Runs a query with at most one row and reads it.
    pub(crate) fn find<T>(
        &mut self,
        sql: &str,
        params: &[Value],
        read: impl FnOnce(&Row) -> Result<T>,
    ) -> Result<Option<T>> {
        self.one(sql, params)?.as_ref().map(read).transpose()
    }

    /// Whether a query has rows.
    pub(crate) fn has(&mut self, sql: &str, params: &[Value]) -> Result<bool> {
        Ok(self.one(sql, params)?.is_some())
    }
}

/// Closure run in a transaction.
pub(crate) type Work<'a> = Box<dyn FnOnce(&mut dyn Tx) -> Result<()> + Send + 'a>;

/// A database: write transactions run one after the other, read transactions beside them. A snapshot can only be read.
pub(crate) trait Database: Send + Sync {
    /// Runs read-only work on a consistent snapshot.
    fn read(&self, work: Work<'_>) -> Result<()>;

    /// Runs work in a transaction and returns once it is durable. Failed work is rolled back.
    fn write(&self, _: Work<'static>) -> Result<()> {
        Err(Error::Closed)
    }

    /// The database as it is now, whatever is written later.
    fn snapshot(&self) -> Result<Box<dyn Database>> {
        Err(Error::Closed)
    }

    /// As [`Backend::backup`](super::pool::Backend::backup).
    fn backup(&self, _path: &Path, _with_tokens: bool) -> Result<()> {
        Err(Error::Closed)
    }

    /// The query for its own time, if servers on several machines can share it.
    fn time(&self) -> Option<&'static str> {
        None
    }
}

/// [`Database::write`] with a value as its result.
pub(crate) fn write<T: Send + 'static>(
    db: &dyn Database,
    work: impl FnOnce(&mut dyn Tx) -> Result<T> + Send + 'static,
) -> Result<T> {
    with_value(|work| db.write(work), work)
}

/// [`Database::read`] with a value as its result.
pub(crate) fn read<'a, T: Send + 'a>(
    db: &dyn Database,
    work: impl FnOnce(&mut dyn Tx) -> Result<T> + Send + 'a,
) -> Result<T> {
    with_value(|work| db.read(work), work)
}

fn with_value<'a, T: Send + 'a>(
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
