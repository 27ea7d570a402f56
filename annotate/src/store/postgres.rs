//! PostgreSQL: the same tables and statements, for several servers on one store.
//!
//! Sequence numbers of the log have no gaps, so transactions that write are serialised by one advisory lock, held to
//! the end of the transaction; `SKIP LOCKED` would therefore gain nothing. One thread of each server writes and groups
//! waiting work into one transaction, so that many operations share one lock and one commit.

use std::collections::HashMap;
use std::path::Path;

use postgres::types::private::BytesMut;
use postgres::types::{FromSql, IsNull, ToSql, Type, to_sql_checked};
use postgres::{Client, Statement};
use rusqlite::types::{ToSqlOutput, ValueRef};

use super::db::{Params, Result, Row, Tx, Value, not_opened, params, read_only, unreadable};
use super::migrate;
use super::pool::{Backend, Pool};
use super::postgres_address::Address;
use super::store::Upgrade;
use crate::Error;

/// A trigger that makes the log append-only, and the table that holds the version of the tables.
const TRIGGERS: &str = "
CREATE FUNCTION event_only_grows() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN RAISE EXCEPTION 'the log only grows'; END $$;
CREATE TRIGGER event_no_change BEFORE UPDATE OR DELETE ON event
FOR EACH ROW EXECUTE FUNCTION event_only_grows();
CREATE TABLE version (number BIGINT NOT NULL);
INSERT INTO version (number) VALUES (0);";

/// A connection with its prepared statements.
pub(crate) struct Connection {
    client: Client,
    statements: HashMap<String, Statement>,
}

/// A store in a schema of a database.
pub(crate) struct Postgres {
    address: Address,
    schema: String,
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

/// Connects to a store; `may_create` says whether to create one if there is none. Also returns the upgrade, if one was
/// made.
pub(crate) fn open(
    url: &str,
    schema: &str,
    may_create: bool,
) -> Result<(Pool<Postgres>, Option<Upgrade>)> {
    let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    if schema.is_empty() || !schema.chars().all(plain) {
        let reason = "the name of a schema may have lower-case letters, digits and underscores";
        return Err(not_opened(schema, reason));
    }
    let postgres = Postgres {
        address: Address::parse(url)?,
        schema: schema.to_owned(),
    };
    let mut writer = postgres.connect(true)?;
    if !may_create && version(&mut writer, schema)?.is_none() {
        return Err(Error::Missing {
            place: format!("on PostgreSQL at {}", postgres.place()),
        });
    }
    let upgrade = postgres.prepare(&mut writer)?;
    Ok((Pool::open(postgres, writer)?, upgrade))
}

impl Postgres {
    /// Address of the store without its password, for messages.
    fn place(&self) -> String {
        format!("{}, schema {}", self.address.place(), self.schema)
    }

    /// Creates the tables of a new store, or upgrades those of an older version after a copy.
    fn prepare(&self, connection: &mut Connection) -> Result<Option<Upgrade>> {
        let schema = self.schema.as_str();
        // An error drops the connection, which rolls back the whole transaction.
        self.begin(connection, true)?;
        let make = format!("CREATE SCHEMA IF NOT EXISTS {schema}");
        connection.batch(&make, migrate::MAKE)?;
        let tx: &mut dyn Tx = connection;
        let found = version(tx, schema)?.unwrap_or(0);
        let upgrade = migrate::prepare(tx, &self.place(), found, TRIGGERS, |tx| {
            copy_schema(tx, schema, found)
        })?;
        tx.run("UPDATE version SET number = ?1", params![migrate::VERSION])?;
        tx.batch("COMMIT", migrate::MAKE)?;
        // Discard the plans prepared for the dropped tables.
        connection.statements.clear();
        Ok(upgrade)
    }
}

/// The version of the tables of a store; `None` if there is no store in the schema.
fn version(tx: &mut dyn Tx, schema: &str) -> Result<Option<i64>> {
    let sql = "SELECT 1 FROM information_schema.tables WHERE table_schema = ?1 AND table_name = 'version'";
    match tx.has(sql, params![schema])? {
        true => Ok(Some(tx.number("SELECT number FROM version", &[])?)),
        false => Ok(None),
    }
}

/// Copies all tables into a new schema and returns where that is, for messages.
fn copy_schema(tx: &mut dyn Tx, schema: &str, version: i64) -> Result<String> {
    let mut copy = format!("{schema}_version_{version}");
    let mut number = 1;
    let taken = "SELECT 1 FROM information_schema.schemata WHERE schema_name = ?1";
    while tx.has(taken, params![&copy])? {
        number += 1;
        copy = format!("{schema}_version_{version}_{number}");
    }
    tx.define(&format!("CREATE SCHEMA {copy}"))?;
    let tables: Vec<String> = tx.list(
        "SELECT table_name::text FROM information_schema.tables WHERE table_schema = ?1 AND table_type = 'BASE TABLE'
         ORDER BY table_name",
        params![schema],
    )?;
    for table in tables {
        tx.define(&format!(
            "CREATE TABLE {copy}.{table} (LIKE {schema}.{table} INCLUDING ALL);
             INSERT INTO {copy}.{table} SELECT * FROM {schema}.{table}"
        ))?;
    }
    Ok(format!("schema {copy} of the same database"))
}

impl Backend for Postgres {
    type Connection = Connection;
    /// Bounded, because other servers wait for the lock.
    const GROUP: usize = 32;
    /// The key of the advisory lock that serialises writers is the ASCII code of "annotate" as one number.
    const WRITE: &'static str = "BEGIN; SELECT pg_advisory_xact_lock(7020670294090151013)";
    const READ: &'static str = "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY";
    const TIME: Option<&'static str> =
        Some("SELECT CAST(EXTRACT(EPOCH FROM clock_timestamp()) * 1000 AS BIGINT)");

    fn connect(&self, _writes: bool) -> Result<Connection> {
        let mut connection = Connection {
            client: self.address.connect()?,
            statements: HashMap::new(),
        };
        // Disable sequential scans: plans prepared on empty tables would otherwise keep scanning them after they grow.
        let settings = format!(
            "SET search_path TO {}; SET synchronous_commit TO on; \
             SET enable_seqscan TO off; SET enable_material TO off",
            self.schema
        );
        connection.batch(&settings, "set itself up")?;
        Ok(connection)
    }

    fn is_closed(connection: &Connection) -> bool {
        connection.client.is_closed()
    }

    fn backup(&self, _: &Path, _: bool) -> Result<()> {
        let schema = &self.schema;
        let reason =
            format!("back up a PostgreSQL store with its own program: pg_dump --schema={schema}");
        Err(not_opened(self.place(), reason))
    }
}

impl Connection {
    fn statement(&mut self, sql: &str) -> Result<Statement> {
        if let Some(statement) = self.statements.get(sql) {
            return Ok(statement.clone());
        }
        let prepared = self.client.prepare(&sql.replace('?', "$"));
        let statement = prepared.map_err(failed("prepare a statement"))?;
        self.statements.insert(sql.to_owned(), statement.clone());
        Ok(statement)
    }
}

/// Why a value cannot be sent or read.
type Failure = Box<dyn std::error::Error + Sync + Send>;

/// A parameter of any supported type.
#[derive(Debug)]
struct Parameter<'a>(ToSqlOutput<'a>);

fn parameters(params: Params<'_>) -> Result<Vec<Parameter<'_>>> {
    let params = params.iter().map(|param| param.to_sql().map(Parameter));
    let params = params.collect::<Result<_, _>>();
    params.map_err(|error| unreadable("of a request", error))
}

impl ToSql for Parameter<'_> {
    fn to_sql(&self, ty: &Type, out: &mut BytesMut) -> Result<IsNull, Failure> {
        let value = match &self.0 {
            ToSqlOutput::Borrowed(value) => *value,
            ToSqlOutput::Owned(value) => value.into(),
            other => return Err(format!("{other:?} cannot be stored").into()),
        };
        match value {
            ValueRef::Null => Ok(IsNull::Yes),
            // Convert integers for float columns and for smaller integer columns.
            ValueRef::Integer(value) if *ty == Type::FLOAT8 => (value as f64).to_sql(ty, out),
            ValueRef::Integer(value) if *ty == Type::INT4 => i32::try_from(value)?.to_sql(ty, out),
            ValueRef::Integer(value) => value.to_sql(ty, out),
            ValueRef::Real(value) => value.to_sql(ty, out),
            ValueRef::Text(value) | ValueRef::Blob(value) => value.to_sql(ty, out),
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
    fn from_sql(ty: &Type, raw: &'a [u8]) -> Result<Self, Failure> {
        let value = match *ty {
            Type::INT8 => Value::Integer(i64::from_sql(ty, raw)?),
            Type::INT4 => Value::Integer(i32::from_sql(ty, raw)?.into()),
            Type::FLOAT8 => Value::Real(f64::from_sql(ty, raw)?),
            Type::BYTEA => Value::Blob(raw.to_vec()),
            _ => Value::Text(<&str>::from_sql(&Type::TEXT, raw)?.to_owned()),
        };
        Ok(Self(value))
    }

    fn from_sql_null(_: &Type) -> Result<Self, Failure> {
        Ok(Self(Value::Null))
    }

    fn accepts(_: &Type) -> bool {
        true
    }
}

fn borrowed<'a>(params: &'a [Parameter<'_>]) -> Vec<&'a (dyn ToSql + Sync)> {
    let params = params.iter();
    params.map(|param| param as &(dyn ToSql + Sync)).collect()
}

impl Tx for Connection {
    fn execute(&mut self, sql: &str, params: Params) -> Result<u64> {
        let statement = self.statement(sql)?;
        let changed = self
            .client
            .execute(&statement, &borrowed(&parameters(params)?));
        changed.map_err(failed("write"))
    }

    fn batch(&mut self, sql: &str, action: &'static str) -> Result<()> {
        self.client.batch_execute(sql).map_err(failed(action))
    }

    fn define(&mut self, sql: &str) -> Result<()> {
        // Order keys by bytes, whatever the collation of the database.
        let sql = sql.replace(
            "key TEXT NOT NULL UNIQUE",
            "key TEXT COLLATE \"C\" NOT NULL UNIQUE",
        );
        self.batch(&sql, migrate::MAKE)
    }

    fn query(&mut self, sql: &str, params: Params) -> Result<Vec<Row>> {
        let statement = self.statement(sql)?;
        let rows = self
            .client
            .query(&statement, &borrowed(&parameters(params)?));
        let rows = rows.map_err(failed("read"))?;
        let values = |row: &postgres::Row| {
            (0..row.len())
                .map(|at| row.get::<_, Column>(at).0)
                .collect()
        };
        Ok(rows.iter().map(|row| Row(values(row))).collect())
    }
}
