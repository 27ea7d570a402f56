//! The connections of a store: one that writes, on its own thread; several that read; and snapshots.
//!
//! A commit waits for the disk. Work that arrives meanwhile is queued and shares the next commit. Work that
//! fails is rolled back alone.

use std::path::Path;
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;

use super::db::{Database, Result, Tx, Work, read_only};
use crate::Error;
use crate::lock::lock;

/// Number of read connections of a store.
const READERS: usize = 4;

/// A kind of database, which opens connections.
pub(crate) trait Backend: Send + Sync + 'static {
    /// A connection to the database.
    type Connection: Tx + Send + 'static;
    /// Maximum number of operations in one commit; bounds the latency of the first one.
    const GROUP: usize;
    /// SQL that begins a write transaction.
    const WRITE: &'static str;
    /// SQL that begins a read transaction on a snapshot.
    const READ: &'static str;
    /// SQL for the database's own time in milliseconds, if servers on several machines can share the database.
    const TIME: Option<&'static str> = None;

    /// Opens a connection.
    fn connect(&self, writes: bool) -> Result<Self::Connection>;

    /// Whether the database has closed a connection.
    fn is_closed(_: &Self::Connection) -> bool {
        false
    }

    /// Writes a backup to a new file without blocking others. `with_tokens` includes tokens and sessions; a backup for
    /// another machine has none.
    fn backup(&self, path: &Path, with_tokens: bool) -> Result<()>;

    /// Begins a transaction, on a new connection if the database closed this one.
    fn begin(&self, connection: &mut Self::Connection, writes: bool) -> Result<()> {
        if Self::is_closed(connection) {
            *connection = self.connect(writes)?;
        }
        let sql = if writes { Self::WRITE } else { Self::READ };
        connection.batch(sql, "begin a transaction")
    }
}

struct Job {
    work: Work<'static>,
    done: SyncSender<Result<()>>,
}

/// The connections of a store.
pub(crate) struct Pool<B: Backend> {
    backend: Arc<B>,
    /// `None` while the store closes.
    jobs: Option<Sender<Job>>,
    writer: Option<JoinHandle<()>>,
    /// Idle read connections; each is lent to one thread at a time.
    free: Mutex<Vec<B::Connection>>,
    returned: Condvar,
}

impl<B: Backend> Pool<B> {
    /// Opens the read connections, and starts the thread of the write connection.
    pub(crate) fn open(backend: B, connection: B::Connection) -> Result<Self> {
        let backend = Arc::new(backend);
        let free = (0..READERS).map(|_| backend.connect(false));
        let free = Mutex::new(free.collect::<Result<Vec<_>>>()?);
        let (jobs, queue) = channel();
        let writer = Writer {
            backend: Arc::clone(&backend),
            connection,
        };
        let writer = std::thread::Builder::new()
            .name("annotate-store".to_owned())
            .spawn(move || writer.run(&queue))
            .map_err(datasets_spec::Error::io("start", "the writer of the store"))?;
        Ok(Self {
            backend,
            jobs: Some(jobs),
            writer: Some(writer),
            free,
            returned: Condvar::new(),
        })
    }
}

impl<B: Backend> Drop for Pool<B> {
    fn drop(&mut self) {
        drop(self.jobs.take());
        if let Some(writer) = self.writer.take() {
            // Ignore a writer that panicked.
            let _ended = writer.join();
        }
    }
}

impl<B: Backend> Database for Pool<B> {
    fn write(&self, work: Work<'static>) -> Result<()> {
        let (done, answer) = sync_channel(1);
        let jobs = self.jobs.as_ref().ok_or(Error::Closed)?;
        jobs.send(Job { work, done }).map_err(|_| Error::Closed)?;
        answer.recv().map_err(|_| Error::Closed)?
    }

    fn read(&self, work: Work<'_>) -> Result<()> {
        let mut free = lock(&self.free);
        let mut connection = loop {
            if let Some(connection) = free.pop() {
                break connection;
            }
            free = self
                .returned
                .wait(free)
                .unwrap_or_else(PoisonError::into_inner);
        };
        drop(free);
        let outcome = caught(|| {
            self.backend.begin(&mut connection, false)?;
            work(&mut connection)
        });
        // A read transaction changes nothing, so a failed rollback loses nothing.
        let _ended = connection.batch("ROLLBACK", "roll back");
        lock(&self.free).push(connection);
        self.returned.notify_one();
        outcome
    }

    fn snapshot(&self) -> Result<Box<dyn Database>> {
        let mut connection = self.backend.connect(false)?;
        self.backend.begin(&mut connection, false)?;
        // The first read fixes the snapshot.
        connection.query("SELECT COUNT(*) FROM setting", &[])?;
        Ok(Box::new(Snapshot(Mutex::new(connection))))
    }

    fn backup(&self, path: &Path, with_tokens: bool) -> Result<()> {
        self.backend.backup(path, with_tokens)
    }

    fn time(&self) -> Option<&'static str> {
        B::TIME
    }
}

/// A snapshot of a database: one transaction on a separate connection.
struct Snapshot<C>(Mutex<C>);

impl<C: Tx + Send + 'static> Database for Snapshot<C> {
    fn read(&self, work: Work<'_>) -> Result<()> {
        let mut connection = lock(&self.0);
        caught(|| work(&mut *connection))
    }
}

/// Runs work; a panic becomes an error.
fn caught(work: impl FnOnce() -> Result<()>) -> Result<()> {
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(work)).unwrap_or(Err(Error::Closed))
}

/// The connection that writes.
struct Writer<B: Backend> {
    backend: Arc<B>,
    connection: B::Connection,
}

impl<B: Backend> Writer<B> {
    /// Does queued work in order, with one commit per group, until all senders are gone.
    fn run(mut self, queue: &Receiver<Job>) {
        while let Ok(first) = queue.recv() {
            let mut group = vec![first];
            while group.len() < B::GROUP
                && let Ok(job) = queue.try_recv()
            {
                group.push(job);
            }
            self.answer(group);
        }
    }

    /// Runs a group of operations and replies once it is durable.
    fn answer(&mut self, group: Vec<Job>) {
        let mut answers = Vec::with_capacity(group.len());
        let failure = self.commit(group, &mut answers).err().map(|error| {
            // If this fails too, the database has rolled everything back, or closed the connection.
            let _rolled_back = self.connection.batch("ROLLBACK", "roll back");
            match error {
                Error::ReadOnly { reason } => reason,
                other => format!(
                    "{}; nothing was written, send the request again",
                    other.full()
                ),
            }
        });
        for (done, answer) in answers {
            let answer = match &failure {
                None => answer,
                Some(reason) => Err(read_only(reason)),
            };
            // The caller may have stopped waiting.
            let _told = done.send(answer);
        }
    }

    /// Runs a group of operations in one transaction. An error means that all of them are lost.
    fn commit(
        &mut self,
        group: Vec<Job>,
        answers: &mut Vec<(SyncSender<Result<()>>, Result<()>)>,
    ) -> Result<()> {
        let mut all = self.backend.begin(&mut self.connection, true);
        for Job { work, done } in group {
            let mut answer = Ok(());
            if all.is_ok() {
                match self.work(work) {
                    Ok(own) => answer = own,
                    Err(lost) => all = Err(lost),
                }
            }
            answers.push((done, answer));
        }
        all?;
        self.connection.batch("COMMIT", "commit")
    }

    /// Runs work, and rolls back only this work if it fails. An outer error means that the whole transaction is lost.
    fn work(&mut self, work: Work<'_>) -> Result<Result<()>> {
        let connection = &mut self.connection;
        connection.batch("SAVEPOINT work", "begin a transaction")?;
        let outcome = caught(|| {
            work(connection)?;
            connection.batch("RELEASE work", "commit")
        });
        if outcome.is_err() {
            let undone = connection.batch("ROLLBACK TO work; RELEASE work", "roll back");
            if undone.is_err() {
                // The database rolled everything back, as SQLite does when the disk is full, or the connection is lost.
                return outcome.map(Ok);
            }
        }
        Ok(outcome)
    }
}
