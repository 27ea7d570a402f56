//! The check and the repair of the projections.
//!
//! Neither a check nor a repair stops writers: the log is read from a snapshot and applied to a scratch database, which
//! is compared with the snapshot. Only tasks whose rows differ are written, a few per transaction.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex};

use rusqlite::Connection;

use super::apply::apply;
use super::db::{Result, Row, ToSql, Tx, Value, params};
use super::derived::{PROJECTIONS, Projection, SCHEMA, follow};
use super::sqlite::scratch;
use super::store::Store;
use crate::lock::lock;

/// Tasks compared at a time.
const COMPARED: i64 = 1000;
/// Tasks repaired per transaction. Such a transaction writes about as much as claims of two bundles.
const REPAIRED: usize = 16;

impl Store {
    /// Derives the projections from the log again and repairs rows that differ, in short transactions. Returns the
    /// names of the tables that differed.
    ///
    /// # Errors
    /// An entry of the log cannot be read.
    pub fn rebuild(&self) -> Result<Vec<&'static str>> {
        let (mut derived, found) = self.snapshot()?.read(compare)?;
        if found.is_empty() {
            return Ok(Vec::new());
        }
        // Entries that were written during the comparison. Applied here, they do not delay the transactions below, for
        // which other writers wait.
        self.read(|tx| derived.catch_up(tx))?;
        let derived = Arc::new(Mutex::new(derived));
        let tasks: BTreeSet<i64> = found.values().flatten().copied().collect();
        for some in Vec::from_iter(tasks).chunks(REPAIRED) {
            let (some, derived) = (some.to_vec(), Arc::clone(&derived));
            self.write(move |tx| {
                let mut derived = lock(&derived);
                derived.catch_up(tx)?;
                some.iter().try_for_each(|task| derived.repair(tx, *task))
            })?;
        }
        Ok(found.into_keys().collect())
    }

    /// Checks the whole store and returns its findings: gaps in the log, and projections that do not follow from it.
    /// Writers do not wait for the check.
    pub fn verify(&self) -> Result<Vec<String>> {
        self.snapshot()?.read(verify)
    }
}

/// Projections derived from the log, up to and including entry `last`.
struct Derived {
    scratch: Connection,
    last: i64,
}

impl Derived {
    fn new() -> Result<Self> {
        let mut scratch = scratch()?;
        scratch.define(SCHEMA)?;
        Ok(Self { scratch, last: 0 })
    }

    /// Applies the log entries that were added since the last call.
    fn catch_up(&mut self, log: &mut dyn Tx) -> Result<()> {
        let scratch = &mut self.scratch;
        follow(log, &mut self.last, |_, seq, entry| {
            apply(scratch, seq, entry)
        })
    }

    /// Replaces the rows of a task by rows derived from the log.
    fn repair(&mut self, tx: &mut dyn Tx, task: i64) -> Result<()> {
        for (table, column, order) in PROJECTIONS {
            let sql = format!("DELETE FROM {table} WHERE {column} = ?1");
            tx.run(&sql, params![task])?;
            let sql = format!("SELECT * FROM {table} WHERE {column} = ?1 ORDER BY {order}");
            for row in Tx::query(&mut self.scratch, &sql, params![task])? {
                let places: Vec<String> = (1..=row.0.len()).map(|at| format!("?{at}")).collect();
                let sql = format!("INSERT INTO {table} VALUES ({})", places.join(", "));
                let values: Vec<_> = row.0.iter().map(|value| value as &dyn ToSql).collect();
                tx.run(&sql, &values)?;
            }
        }
        Ok(())
    }
}

/// Tasks whose rows differ from the rows derived from the log, by table.
type Differing = BTreeMap<&'static str, BTreeSet<i64>>;

/// Rows of a projection for tasks above `after` and up to `up_to`. The task precedes the columns of each row.
fn rows_of(
    tx: &mut dyn Tx,
    (table, task, order): Projection,
    after: i64,
    up_to: i64,
) -> Result<Vec<Row>> {
    let sql = format!(
        "SELECT p.{task}, p.* FROM {table} p WHERE p.{task} > ?1 AND p.{task} <= ?2 ORDER BY {order}"
    );
    tx.query(&sql, params![after, up_to])
}

fn by_task(rows: Vec<Row>) -> Result<BTreeMap<i64, Vec<Vec<Value>>>> {
    let mut tasks: BTreeMap<i64, Vec<Vec<Value>>> = BTreeMap::new();
    for row in rows {
        tasks.entry(row.read()?).or_default().push(row.0);
    }
    Ok(tasks)
}

/// Compares the projections of two databases.
fn differing(store: &mut dyn Tx, derived: &mut dyn Tx) -> Result<Differing> {
    let mut end = 0;
    for (table, task, _) in PROJECTIONS {
        let sql = format!("SELECT COALESCE(MAX({task}), 0) FROM {table}");
        end = end
            .max(store.number(&sql, &[])?)
            .max(derived.number(&sql, &[])?);
    }
    let mut found = Differing::new();
    for after in (0..end).step_by(COMPARED as usize) {
        for projection in PROJECTIONS {
            let up_to = after + COMPARED;
            let is = rows_of(store, projection, after, up_to)?;
            let should = rows_of(derived, projection, after, up_to)?;
            if is == should {
                continue;
            }
            let (is, should) = (by_task(is)?, by_task(should)?);
            let tasks = found.entry(projection.0).or_default();
            tasks.extend(
                is.keys()
                    .chain(should.keys())
                    .filter(|task| is.get(task) != should.get(task)),
            );
        }
    }
    Ok(found)
}

/// Derives the projections from the log and compares them with those of the store.
fn compare(tx: &mut dyn Tx) -> Result<(Derived, Differing)> {
    let mut derived = Derived::new()?;
    derived.catch_up(tx)?;
    let found = differing(tx, &mut derived.scratch)?;
    Ok((derived, found))
}

/// Findings about the log and the projections.
fn verify(tx: &mut dyn Tx) -> Result<Vec<String>> {
    let mut findings = Vec::new();
    let sql = "SELECT COUNT(*), COALESCE(MAX(seq), 0) FROM event";
    let (count, last): (i64, i64) = tx.get(sql, &[])?;
    if count != last {
        findings.push(format!(
            "the log has {count} entries, but its last sequence number is {last}"
        ));
    }
    let sql = "SELECT COUNT(*) FROM task WHERE submitted + leases > wanted";
    let over = tx.number(sql, &[])?;
    if over > 0 {
        findings.push(format!(
            "{over} tasks have more answers and leases than wanted"
        ));
    }
    let (_, found) = compare(tx)?;
    findings.extend(
        found
            .into_keys()
            .map(|table| format!("table {table} does not follow from the log")),
    );
    Ok(findings)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::super::db::{Database, Params, Work};
    use super::super::records::NewTask;
    use super::super::sqlite;
    use super::*;

    /// A database that counts its writes, and the statements of the longest one.
    struct Counting {
        inner: Box<dyn Database>,
        writes: Arc<AtomicUsize>,
        longest: Arc<AtomicUsize>,
    }

    struct CountingTx<'a> {
        inner: &'a mut dyn Tx,
        statements: usize,
    }

    impl Tx for CountingTx<'_> {
        fn execute(&mut self, sql: &str, params: Params) -> Result<u64> {
            self.statements += 1;
            self.inner.execute(sql, params)
        }

        fn query(&mut self, sql: &str, params: Params) -> Result<Vec<Row>> {
            self.statements += 1;
            self.inner.query(sql, params)
        }

        fn batch(&mut self, sql: &str, action: &'static str) -> Result<()> {
            self.inner.batch(sql, action)
        }

        fn define(&mut self, sql: &str) -> Result<()> {
            self.inner.define(sql)
        }
    }

    impl Database for Counting {
        fn write(&self, work: Work<'static>) -> Result<()> {
            let (writes, longest) = (Arc::clone(&self.writes), Arc::clone(&self.longest));
            self.inner.write(Box::new(move |tx| {
                let mut counting = CountingTx {
                    inner: tx,
                    statements: 0,
                };
                let outcome = work(&mut counting);
                writes.fetch_add(1, Ordering::Relaxed);
                longest.fetch_max(counting.statements, Ordering::Relaxed);
                outcome
            }))
        }

        fn read(&self, work: Work<'_>) -> Result<()> {
            self.inner.read(work)
        }

        fn snapshot(&self) -> Result<Box<dyn Database>> {
            self.inner.snapshot()
        }
    }

    fn task(number: usize) -> NewTask {
        serde_json::from_value(serde_json::json!({
            "key": format!("task{number:05}"), "kind": "mask_text", "source": "hash", "split": "train",
            "bundle_index": 0, "priority": 0, "suggestions": [],
        }))
        .expect("a task")
    }

    #[test]
    fn neither_a_check_nor_a_rebuild_stops_writers_for_longer_than_a_claim() {
        const TASKS: usize = 1500;
        let folder = tempfile::tempdir().expect("a folder");
        let (inner, _) = sqlite::open(&folder.path().join("s.sqlite")).expect("a store");
        let (writes, longest) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicUsize::new(0)));
        let database = Counting {
            inner: Box::new(inner),
            writes: Arc::clone(&writes),
            longest: Arc::clone(&longest),
        };
        let store = Store::new(Box::new(database), None);
        store
            .import(None, (0..TASKS).map(task).collect(), 0)
            .expect("tasks");
        // Changes rows without a log entry.
        let damage = |sql: &'static str| {
            let damaged = store.write(move |tx| tx.execute(sql, &[]));
            assert!(damaged.expect("a damaged table") > 0, "{sql}");
            writes.store(0, Ordering::Relaxed);
            longest.store(0, Ordering::Relaxed);
        };
        damage("UPDATE task SET state = 'dropped', claimable = 0");
        assert_eq!(
            store.verify().expect("checks"),
            ["table task does not follow from the log"]
        );
        assert_eq!(writes.load(Ordering::Relaxed), 0, "a check writes nothing");
        assert_eq!(store.rebuild().expect("repairs"), ["task"]);
        assert!(writes.load(Ordering::Relaxed) >= TASKS / REPAIRED);
        let longest_one = longest.load(Ordering::Relaxed);
        assert!(
            longest_one <= REPAIRED * (PROJECTIONS.len() + 2) + 10,
            "{longest_one} statements"
        );
        assert!(store.verify().expect("checks").is_empty());
        damage("DELETE FROM task WHERE id > 1490");
        assert_eq!(store.rebuild().expect("repairs"), ["task"]);
        assert_eq!(writes.load(Ordering::Relaxed), 1);
        damage("UPDATE setting SET body = body");
        assert!(store.rebuild().expect("repairs").is_empty());
        assert_eq!(
            writes.load(Ordering::Relaxed),
            0,
            "nothing had to be repaired"
        );
    }
}
