//! PostgreSQL: the same tables and statements, for several servers on one store.
//!
//! Sequence numbers of the log have no gaps, so transactions that write are serialised by one advisory
//! lock, held to the end of the transaction; `SKIP LOCKED` would therefore gain nothing. One thread of
//! each server writes and groups waiting work into one transaction, so that the lock and the commit are
//! paid once for many.

use std::collections::HashMap;
use std::path::Path;

use postgres::types::{FromSql, IsNull, ToSql, Type, to_sql_checked};
use postgres::{Client, NoTls, Statement};

use super::db::{Database, Row, Tx, Value, Work};
use super::group::{Writer, WriterThread, caught};
use super::readers::Readers;
use crate::Error;

/// Key of the advisory lock that serialises writers: the letters of "annotate".
const TURN: i64 = 0x616e_6e6f_7461_7465;
const SCHEMA: &str = include_str!("schema.sql");
/// Version of the tables.
const VERSION: i64 = 1;
/// Trigger that makes the log append-only.
const TRIGGERS: &str = "
CREATE FUNCTION event_only_grows() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN RAISE EXCEPTION 'the log only grows'; END $$;
CREATE TRIGGER event_no_change BEFORE UPDATE OR DELETE ON event
FOR EACH ROW EXECUTE FUNCTION event_only_grows();
CREATE TABLE version (number BIGINT NOT NULL);";

struct Connection {
    client: Client,
    statements: HashMap<String, Statement>,
}

/// Address of a store.
#[derive(Clone)]
struct Address {
    url: String,
    schema: String,
}

/// A store in a schema of a database.
pub(crate) struct Postgres {
    address: Address,
    writer: WriterThread,
    readers: Readers<Connection>,
}

fn failed(action: &'static str) -> impl Fn(postgres::Error) -> Error {
    move |source| {
        let full = source
            .code()
            .is_some_and(|code| matches!(code.code(), "53100" | "25006"));
        if full {
            return Error::ReadOnly {
                reason: "the database is full or read-only".to_owned(),
            };
        }
        Error::Postgres { action, source }
    }
}

impl Postgres {
    /// Connects, and creates missing tables.
    pub(crate) fn open(url: &str, schema: &str) -> Result<Self, Error> {
        let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
        if schema.is_empty() || !schema.chars().all(plain) {
            return Err(Error::Open {
                path: schema.to_owned(),
                reason: "the name of a schema may have lower-case letters, digits and underscores"
                    .to_owned(),
            });
        }
        let address = Address {
            url: url.to_owned(),
            schema: schema.to_owned(),
        };
        let mut first = address.connect()?;
        let make = failed("make its tables");
        let mut tx = first.client.transaction().map_err(&make)?;
        tx.execute("SELECT pg_advisory_xact_lock($1)", &[&TURN])
            .map_err(&make)?;
        tx.batch_execute(&format!("CREATE SCHEMA IF NOT EXISTS {schema}"))
            .map_err(&make)?;
        let there = tx
            .query_one(
                "SELECT COUNT(*) FROM information_schema.tables WHERE table_schema = $1 AND table_name = 'version'",
                &[&schema],
            )
            .map_err(&make)?
            .get::<_, i64>(0);
        if there == 0 {
            // Order keys by bytes, whatever the collation of the database.
            let schema = SCHEMA.replace(
                "key TEXT NOT NULL UNIQUE",
                "key TEXT COLLATE \"C\" NOT NULL UNIQUE",
            );
            tx.batch_execute(&schema).map_err(&make)?;
            tx.batch_execute(TRIGGERS).map_err(&make)?;
            tx.execute("INSERT INTO version (number) VALUES ($1)", &[&VERSION])
                .map_err(&make)?;
        }
        let version: i64 = tx
            .query_one("SELECT number FROM version", &[])
            .map_err(&make)?
            .get(0);
        if version != VERSION {
            return Err(Error::Open {
                path: address.place(),
                reason: format!(
                    "its tables are of version {version}, this program knows {VERSION}"
                ),
            });
        }
        tx.commit().map_err(&make)?;
        let readers = Readers::open(|| address.connect())?;
        let writer = PostgresWriter {
            address: address.clone(),
            connection: first,
            is_open: false,
        };
        let writer = WriterThread::start(writer).map_err(|source| Error::Open {
            path: address.place(),
            reason: format!("its writer does not start: {source}"),
        })?;
        Ok(Self {
            address,
            writer,
            readers,
        })
    }
}

impl Address {
    /// Address of the store without its password, for messages.
    fn place(&self) -> String {
        let host = self.url.rsplit('@').next().unwrap_or_default();
        format!("{host}, schema {}", self.schema)
    }

    fn connect(&self) -> Result<Connection, Error> {
        let mut client = Client::connect(&self.url, NoTls).map_err(|error| Error::Open {
            path: self.place(),
            reason: error.to_string(),
        })?;
        client
            // Disable sequential scans: plans prepared on empty tables would otherwise keep scanning
            // them after they grow.
            .batch_execute(&format!(
                "SET search_path TO {}; SET synchronous_commit TO on; \
                 SET enable_seqscan TO off; SET enable_material TO off",
                self.schema
            ))
            .map_err(failed("set itself up"))?;
        Ok(Connection {
            client,
            statements: HashMap::new(),
        })
    }
}

/// The connection that writes.
struct PostgresWriter {
    address: Address,
    connection: Connection,
    is_open: bool,
}

impl PostgresWriter {
    fn command(&mut self, sql: &str, action: &'static str) -> Result<(), Error> {
        self.connection
            .client
            .batch_execute(sql)
            .map_err(failed(action))
    }
}

impl Writer for PostgresWriter {
    /// Bounded, because other servers wait for the lock.
    const GROUP: usize = 32;

    fn begin(&mut self) -> Result<(), Error> {
        if self.connection.client.is_closed() {
            self.connection = self.address.connect()?;
        }
        self.is_open = true;
        self.command(
            &format!("BEGIN; SELECT pg_advisory_xact_lock({TURN})"),
            "begin a transaction",
        )
    }

    fn run(&mut self, work: Work) -> Result<(), Error> {
        self.command("SAVEPOINT work", "begin a transaction")?;
        match caught(|| work(&mut PostgresTx(&mut self.connection))) {
            Ok(()) => self.command("RELEASE work", "commit"),
            Err(error) => {
                let undone = self.command("ROLLBACK TO work; RELEASE work", "roll back");
                if undone.is_err() {
                    // The connection is lost, and with it the whole transaction.
                    self.is_open = false;
                }
                undone?;
                Err(error)
            }
        }
    }

    fn is_open(&self) -> bool {
        self.is_open && !self.connection.client.is_closed()
    }

    fn commit(&mut self) -> Result<(), Error> {
        let committed = self.command("COMMIT", "commit");
        self.is_open = committed.is_err();
        committed
    }

    fn roll_back(&mut self) {
        // If this fails, the next group opens a new connection.
        let _rolled_back = self.command("ROLLBACK", "roll back");
        self.is_open = false;
    }

    fn close(self) {}
}

/// A connection in a transaction.
struct PostgresTx<'a>(&'a mut Connection);

impl PostgresTx<'_> {
    fn statement(&mut self, sql: &str) -> Result<Statement, Error> {
        if let Some(statement) = self.0.statements.get(sql) {
            return Ok(statement.clone());
        }
        let statement = self
            .0
            .client
            .prepare(&sql.replace('?', "$"))
            .map_err(failed("prepare a statement"))?;
        self.0.statements.insert(sql.to_owned(), statement.clone());
        Ok(statement)
    }
}

impl ToSql for Value {
    fn to_sql(
        &self,
        ty: &Type,
        out: &mut postgres::types::private::BytesMut,
    ) -> Result<IsNull, Box<dyn std::error::Error + Sync + Send>> {
        match self {
            Self::Null => Ok(IsNull::Yes),
            // Convert integers for float columns and for smaller integer columns.
            Self::Int(value) if *ty == Type::FLOAT8 => (*value as f64).to_sql(ty, out),
            Self::Int(value) if *ty == Type::INT4 => i32::try_from(*value)?.to_sql(ty, out),
            Self::Int(value) => value.to_sql(ty, out),
            Self::Real(value) => value.to_sql(ty, out),
            Self::Text(value) => value.to_sql(ty, out),
        }
    }

    fn accepts(_: &Type) -> bool {
        true
    }

    to_sql_checked!();
}

/// A column of any supported type.
struct Column(Value);

impl<'a> FromSql<'a> for Column {
    fn from_sql(
        ty: &Type,
        raw: &'a [u8],
    ) -> Result<Self, Box<dyn std::error::Error + Sync + Send>> {
        let value = match *ty {
            Type::INT8 => Value::Int(i64::from_sql(ty, raw)?),
            Type::INT4 => Value::Int(i32::from_sql(ty, raw)?.into()),
            Type::FLOAT8 => Value::Real(f64::from_sql(ty, raw)?),
            _ => Value::Text(<&str>::from_sql(&Type::TEXT, raw)?.to_owned()),
        };
        Ok(Self(value))
    }

    fn from_sql_null(_: &Type) -> Result<Self, Box<dyn std::error::Error + Sync + Send>> {
        Ok(Self(Value::Null))
    }

    fn accepts(_: &Type) -> bool {
        true
    }
}

fn borrowed(params: &[Value]) -> Vec<&(dyn ToSql + Sync)> {
    params
        .iter()
        .map(|value| value as &(dyn ToSql + Sync))
        .collect()
}

impl Tx for PostgresTx<'_> {
    fn execute(&mut self, sql: &str, params: &[Value]) -> Result<u64, Error> {
        let statement = self.statement(sql)?;
        self.0
            .client
            .execute(&statement, &borrowed(params))
            .map_err(failed("write"))
    }

    fn query(&mut self, sql: &str, params: &[Value]) -> Result<Vec<Row>, Error> {
        let statement = self.statement(sql)?;
        let rows = self
            .0
            .client
            .query(&statement, &borrowed(params))
            .map_err(failed("read"))?;
        Ok(rows
            .iter()
            .map(|row| {
                Row((0..row.len())
                    .map(|column| row.get::<_, Column>(column).0)
                    .collect())
            })
            .collect())
    }
}

impl Database for Postgres {
    fn write(&self, work: Work) -> Result<(), Error> {
        self.writer.write(work)
    }

    fn read(&self, work: Work) -> Result<(), Error> {
        self.readers.with(
            |reader| {
                if reader.client.is_closed() {
                    *reader = self.address.connect()?;
                }
                let begin = "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY";
                reader.client.batch_execute(begin).map_err(failed("read"))?;
                work(&mut PostgresTx(reader))
            },
            |reader| {
                // A read transaction changes nothing, so a failed rollback loses nothing.
                let _ended = reader.client.batch_execute("ROLLBACK");
            },
        )
    }

    fn backup(&self, _: &Path) -> Result<(), Error> {
        Err(Error::Open {
            path: self.address.place(),
            reason: format!(
                "back up a PostgreSQL store with its own program: pg_dump --schema={}",
                self.address.schema
            ),
        })
    }

    fn check(&self) -> Result<(), Error> {
        self.write(Box::new(super::db::try_writing))
    }
}
