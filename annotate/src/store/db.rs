//! Interface to SQLite and PostgreSQL: values, rows and transactions.
//!
//! Both databases share the SQL statements. Parameters are `?1`, `?2` …; integers are `BIGINT`, booleans are
//! 0 and 1, other columns are `TEXT`, `BYTEA` or double precision.

use super::records::Millis;
use crate::Error;

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
        Error::Row {
            table: "of an answer",
            problem: format!(
                "column {column} is {:?}, expected {expected}",
                self.0.get(column)
            ),
        }
    }

    pub(crate) fn int(&self, column: usize) -> Result<i64, Error> {
        match self.0.get(column) {
            Some(Value::Int(value)) => Ok(*value),
            _ => Err(self.wrong(column, "a whole number")),
        }
    }

    pub(crate) fn flag(&self, column: usize) -> Result<bool, Error> {
        Ok(self.int(column)? != 0)
    }

    pub(crate) fn count(&self, column: usize) -> Result<u32, Error> {
        u32::try_from(self.int(column)?).map_err(|_| self.wrong(column, "a count"))
    }

    pub(crate) fn real(&self, column: usize) -> Result<f64, Error> {
        match self.0.get(column) {
            Some(Value::Real(value)) => Ok(*value),
            Some(Value::Int(value)) => Ok(*value as f64),
            _ => Err(self.wrong(column, "a number")),
        }
    }

    pub(crate) fn text(&self, column: usize) -> Result<&str, Error> {
        match self.0.get(column) {
            Some(Value::Text(value)) => Ok(value),
            _ => Err(self.wrong(column, "text")),
        }
    }

    pub(crate) fn bytes(&self, column: usize) -> Result<&[u8], Error> {
        match self.0.get(column) {
            Some(Value::Blob(value)) => Ok(value),
            _ => Err(self.wrong(column, "bytes")),
        }
    }

    pub(crate) fn string(&self, column: usize) -> Result<String, Error> {
        self.text(column).map(str::to_owned)
    }

    fn is_null(&self, column: usize) -> bool {
        matches!(self.0.get(column), Some(Value::Null))
    }

    pub(crate) fn opt_int(&self, column: usize) -> Result<Option<i64>, Error> {
        if self.is_null(column) {
            Ok(None)
        } else {
            self.int(column).map(Some)
        }
    }

    pub(crate) fn opt_real(&self, column: usize) -> Result<Option<f64>, Error> {
        if self.is_null(column) {
            Ok(None)
        } else {
            self.real(column).map(Some)
        }
    }

    pub(crate) fn opt_text(&self, column: usize) -> Result<Option<String>, Error> {
        if self.is_null(column) {
            Ok(None)
        } else {
            self.string(column).map(Some)
        }
    }

    /// A column of JSON.
    pub(crate) fn json<T: serde::de::DeserializeOwned>(&self, column: usize) -> Result<T, Error> {
        serde_json::from_str(self.text(column)?).map_err(|error| Error::Row {
            table: "of an answer",
            problem: error.to_string(),
        })
    }
}

/// An open transaction.
pub(crate) trait Tx {
    /// Runs a statement and returns the number of changed rows.
    fn execute(&mut self, sql: &str, params: &[Value]) -> Result<u64, Error>;
    /// Runs a query.
    fn query(&mut self, sql: &str, params: &[Value]) -> Result<Vec<Row>, Error>;

    /// Runs statements that define tables, each database with its own word for what `schema.sql` writes once.
    fn define(&mut self, sql: &str) -> Result<(), Error>;

    /// Runs a query with at most one row.
    fn one(&mut self, sql: &str, params: &[Value]) -> Result<Option<Row>, Error> {
        Ok(self.query(sql, params)?.into_iter().next())
    }

    /// Runs a query for one integer; 0 without rows.
    fn number(&mut self, sql: &str, params: &[Value]) -> Result<i64, Error> {
        self.one(sql, params)?.map_or(Ok(0), |row| row.int(0))
    }
}

/// Closure run in a transaction.
pub(crate) type Work = Box<dyn FnOnce(&mut dyn Tx) -> Result<(), Error> + Send>;

/// A database: write transactions run one after the other, read transactions beside them.
/// What a copy of a store holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Content {
    /// Everything.
    All,
    /// All but tokens and sessions, which open the store on this machine alone.
    WithoutTokens,
}

pub(crate) trait Database: Send + Sync {
    /// Runs work in a transaction and returns once it is durable. Failed work is rolled back.
    fn write(&self, work: Work) -> Result<(), Error>;
    /// Runs read-only work on a consistent snapshot.
    fn read(&self, work: Work) -> Result<(), Error>;
    /// The database as it is now, whatever is written later.
    fn snapshot(&self) -> Result<Box<dyn Database>, Error>;
    /// Writes a backup to a new file without blocking others.
    fn backup(&self, path: &std::path::Path, content: Content) -> Result<(), Error>;
    /// Checks that the store accepts writes, by writing.
    fn check(&self) -> Result<(), Error>;
    /// Whether servers on several machines can share it.
    fn is_shared(&self) -> bool {
        false
    }
    /// The time of the database's own clock, if it is shared.
    fn time(&self) -> Result<Option<Millis>, Error> {
        Ok(None)
    }
}

/// [`Database::write`] with a value as its result.
pub(crate) fn write<T: Send + 'static>(
    db: &dyn Database,
    work: impl FnOnce(&mut dyn Tx) -> Result<T, Error> + Send + 'static,
) -> Result<T, Error> {
    with_value(|work| db.write(work), work)
}

/// [`Database::read`] with a value as its result.
pub(crate) fn read<T: Send + 'static>(
    db: &dyn Database,
    work: impl FnOnce(&mut dyn Tx) -> Result<T, Error> + Send + 'static,
) -> Result<T, Error> {
    with_value(|work| db.read(work), work)
}

fn with_value<T: Send + 'static>(
    run: impl FnOnce(Work) -> Result<(), Error>,
    work: impl FnOnce(&mut dyn Tx) -> Result<T, Error> + Send + 'static,
) -> Result<T, Error> {
    let (sender, receiver) = std::sync::mpsc::channel();
    run(Box::new(move |tx| {
        // The receiver lives until the transaction is durable, so sending cannot fail.
        let _sent = sender.send(work(tx)?);
        Ok(())
    }))?;
    receiver.try_recv().map_err(|_| Error::Closed)
}

/// Bytes of the write test: larger than any answer, so that a nearly full disk fails the test.
const TRIED: usize = 64 * 1024;

/// Write test of [`Database`].
pub(crate) fn try_writing(tx: &mut dyn Tx) -> Result<(), Error> {
    let body = Value::Text("-".repeat(TRIED));
    tx.execute(
        "INSERT INTO setting (name, body) VALUES ('ready', ?1) ON CONFLICT (name) DO UPDATE SET body = excluded.body",
        &[body],
    )?;
    Ok(())
}
