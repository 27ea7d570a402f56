//! PostgreSQL: the same tables and statements, for several servers on one store.
//!
//! Sequence numbers of the log have no gaps, so transactions that write are serialised by one advisory
//! lock, held to the end of the transaction; `SKIP LOCKED` would therefore gain nothing. One thread of
//! each server writes and groups waiting work into one transaction, so that the lock and the commit are
//! paid once for many.

use std::collections::HashMap;
use std::path::Path;

use postgres::types::{FromSql, IsNull, ToSql, Type, to_sql_checked};
use postgres::{Client, Statement};

use super::db::{Content, Database, Result, Row, Tx, Value, Work, not_opened, params, read_only};
use super::group::{Writer, WriterThread, caught};
use super::migrate::{self, Plan};
use super::postgres_address;
use super::readers::{Readers, Snapshot};
use super::records::Millis;
use super::store::Upgrade;
use crate::Error;

/// Key of the advisory lock that serialises writers: the letters of "annotate".
const TURN: i64 = 0x616e_6e6f_7461_7465;
/// Begins a transaction that reads one point in time.
const READ: &str = "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY";
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
    database: postgres_address::Address,
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
        let reason = match source.code().map(postgres::error::SqlState::code) {
            Some("53100") => {
                "the disk of the database is full; free space there and send the request again"
            }
            Some("25006") => "the database is read-only; connect to its primary server",
            _ => return Error::Postgres { action, source },
        };
        read_only(reason)
    }
}

impl Postgres {
    /// Connects, and creates missing tables. Says what upgrade that made.
    pub(crate) fn open(url: &str, schema: &str) -> Result<(Self, Option<Upgrade>)> {
        let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
        if schema.is_empty() || !schema.chars().all(plain) {
            let reason = "the name of a schema may have lower-case letters, digits and underscores";
            return Err(not_opened(schema, reason));
        }
        let address = Address {
            database: postgres_address::Address::parse(url)?,
            schema: schema.to_owned(),
        };
        let mut first = address.connect()?;
        let upgrade = prepare(&mut first, &address)?;
        let readers = Readers::open(|| address.connect())?;
        let writer = PostgresWriter {
            address: address.clone(),
            connection: first,
            is_open: false,
        };
        let writer = WriterThread::start(writer).map_err(|source| {
            let reason = format!("its writer does not start: {source}");
            not_opened(address.place(), reason)
        })?;
        let store = Self {
            address,
            writer,
            readers,
        };
        Ok((store, upgrade))
    }
}

/// Creates the tables of a new store, or upgrades those of an older version after a copy.
fn prepare(connection: &mut Connection, address: &Address) -> Result<Option<Upgrade>> {
    let make = failed("make its tables");
    let schema = address.schema.as_str();
    let begin = format!(
        "BEGIN; SELECT pg_advisory_xact_lock({TURN}); CREATE SCHEMA IF NOT EXISTS {schema}"
    );
    // After an error the connection is dropped, which rolls all of it back.
    connection.client.batch_execute(&begin).map_err(&make)?;
    let mut tx = PostgresTx(connection);
    let sql = "SELECT COUNT(*) FROM information_schema.tables WHERE table_schema = ?1 AND table_name = 'version'";
    let there = tx.number(sql, params![schema])?;
    let found = if there == 0 {
        0
    } else {
        tx.number("SELECT number FROM version", &[])?
    };
    let plan = migrate::plan(&address.place(), found)?;
    let mut upgrade = None;
    if let Plan::Upgrade(from) = plan {
        upgrade = Some(Upgrade {
            from,
            to: migrate::VERSION,
            copy: copy_schema(&mut tx, schema, from)?,
        });
    }
    migrate::apply(&mut tx, plan)?;
    if plan == Plan::Create {
        tx.define(TRIGGERS)?;
        tx.execute("INSERT INTO version (number) VALUES (0)", &[])?;
    }
    tx.execute("UPDATE version SET number = ?1", params![migrate::VERSION])?;
    connection.client.batch_execute("COMMIT").map_err(&make)?;
    // Plans prepared for tables that were dropped are of no use.
    connection.statements.clear();
    Ok(upgrade)
}

/// Copies all tables into a new schema and returns its name.
fn copy_schema(tx: &mut PostgresTx<'_>, schema: &str, version: i64) -> Result<String> {
    let mut copy = format!("{schema}_version_{version}");
    let mut number = 1;
    while tx.number(
        "SELECT COUNT(*) FROM information_schema.schemata WHERE schema_name = ?1",
        params![&copy],
    )? > 0
    {
        number += 1;
        copy = format!("{schema}_version_{version}_{number}");
    }
    tx.define(&format!("CREATE SCHEMA {copy}"))?;
    let tables = tx.query(
        "SELECT table_name::text FROM information_schema.tables WHERE table_schema = ?1 AND table_type = 'BASE TABLE'
         ORDER BY table_name",
        params![schema],
    )?;
    for table in tables {
        let table = table.text(0)?;
        tx.define(&format!(
            "CREATE TABLE {copy}.{table} (LIKE {schema}.{table} INCLUDING ALL);
             INSERT INTO {copy}.{table} SELECT * FROM {schema}.{table}"
        ))?;
    }
    Ok(format!("schema {copy} of the same database"))
}

impl Address {
    /// Address of the store without its password, for messages.
    fn place(&self) -> String {
        format!("{}, schema {}", self.database.place(), self.schema)
    }

    fn connect(&self) -> Result<Connection> {
        let mut client = self.database.connect()?;
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
    fn command(&mut self, sql: &str, action: &'static str) -> Result<()> {
        self.connection
            .client
            .batch_execute(sql)
            .map_err(failed(action))
    }
}

impl Writer for PostgresWriter {
    /// Bounded, because other servers wait for the lock.
    const GROUP: usize = 32;

    fn begin(&mut self) -> Result<()> {
        if self.connection.client.is_closed() {
            self.connection = self.address.connect()?;
        }
        self.is_open = true;
        self.command(
            &format!("BEGIN; SELECT pg_advisory_xact_lock({TURN})"),
            "begin a transaction",
        )
    }

    fn run(&mut self, work: Work<'_>) -> Result<()> {
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

    fn commit(&mut self) -> Result<()> {
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
    fn statement(&mut self, sql: &str) -> Result<Statement> {
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
            Self::Blob(value) => value.to_sql(ty, out),
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
            Type::BYTEA => Value::Blob(raw.to_vec()),
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
    fn execute(&mut self, sql: &str, params: &[Value]) -> Result<u64> {
        let statement = self.statement(sql)?;
        self.0
            .client
            .execute(&statement, &borrowed(params))
            .map_err(failed("write"))
    }

    fn define(&mut self, sql: &str) -> Result<()> {
        // Order keys by bytes, whatever the collation of the database.
        let sql = sql.replace(
            "key TEXT NOT NULL UNIQUE",
            "key TEXT COLLATE \"C\" NOT NULL UNIQUE",
        );
        self.0
            .client
            .batch_execute(&sql)
            .map_err(failed("make its tables"))
    }

    fn query(&mut self, sql: &str, params: &[Value]) -> Result<Vec<Row>> {
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
    fn write(&self, work: Work<'static>) -> Result<()> {
        self.writer.write(work)
    }

    fn read(&self, work: Work<'_>) -> Result<()> {
        self.readers.with(
            |reader| {
                if reader.client.is_closed() {
                    *reader = self.address.connect()?;
                }
                reader.client.batch_execute(READ).map_err(failed("read"))?;
                work(&mut PostgresTx(reader))
            },
            |reader| {
                // A read transaction changes nothing, so a failed rollback loses nothing.
                let _ended = reader.client.batch_execute("ROLLBACK");
            },
        )
    }

    fn backup(&self, _: &Path, _: Content) -> Result<()> {
        let schema = &self.address.schema;
        let reason =
            format!("back up a PostgreSQL store with its own program: pg_dump --schema={schema}");
        Err(not_opened(self.address.place(), reason))
    }

    fn snapshot(&self) -> Result<Box<dyn Database>> {
        let mut reader = self.address.connect()?;
        reader.client.batch_execute(READ).map_err(failed("read"))?;
        // The first read fixes the point in time.
        PostgresTx(&mut reader).number("SELECT COUNT(*) FROM setting", &[])?;
        Ok(Box::new(Snapshot::new(reader, |reader, work| {
            work(&mut PostgresTx(reader))
        })))
    }

    fn is_shared(&self) -> bool {
        true
    }

    fn time(&self) -> Result<Option<Millis>> {
        super::db::read(self, |tx| {
            let millis = "CAST(EXTRACT(EPOCH FROM clock_timestamp()) * 1000 AS BIGINT)";
            tx.number(&format!("SELECT {millis}"), &[]).map(Some)
        })
    }
}
