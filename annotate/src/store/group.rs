//! Group commit: one thread writes, and commits several transactions together.
//!
//! A commit waits for the disk. Work that arrives meanwhile is queued and shares the next commit. Work that
//! fails is rolled back alone.

use std::sync::Mutex;
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};
use std::thread::JoinHandle;

use super::db::{Result, Work, read_only};
use crate::Error;
use crate::lock::lock;

/// A connection that writes.
pub(crate) trait Writer: Send + 'static {
    /// Maximum number of pieces of work in one commit; bounds the latency of the first one.
    const GROUP: usize;

    /// Begins a transaction.
    fn begin(&mut self) -> Result<()>;
    /// Does work; rolls it back if it fails.
    fn run(&mut self, work: Work<'_>) -> Result<()>;
    /// Whether the transaction is still open.
    fn is_open(&self) -> bool;
    /// Makes the transaction durable.
    fn commit(&mut self) -> Result<()>;
    /// Rolls the transaction back.
    fn roll_back(&mut self);
    /// Runs once all senders are gone.
    fn close(self);
}

struct Job {
    work: Work<'static>,
    done: SyncSender<Result<()>>,
}

/// A thread that runs queued work in order.
pub(crate) struct WriterThread {
    /// `None` while the store closes.
    jobs: Mutex<Option<Sender<Job>>>,
    handle: Mutex<Option<JoinHandle<()>>>,
}

impl WriterThread {
    /// Starts it.
    pub(crate) fn start(writer: impl Writer) -> std::io::Result<Self> {
        let (jobs, queue) = channel();
        let handle = std::thread::Builder::new()
            .name("annotate-store".to_owned())
            .spawn(move || write_all(writer, &queue))?;
        Ok(Self {
            jobs: Mutex::new(Some(jobs)),
            handle: Mutex::new(Some(handle)),
        })
    }

    /// Queues work and returns once it is durable.
    pub(crate) fn write(&self, work: Work<'static>) -> Result<()> {
        let (done, answer) = sync_channel(1);
        let jobs = lock(&self.jobs).clone().ok_or(Error::Closed)?;
        jobs.send(Job { work, done }).map_err(|_| Error::Closed)?;
        drop(jobs);
        answer.recv().map_err(|_| Error::Closed)?
    }
}

impl Drop for WriterThread {
    fn drop(&mut self) {
        lock(&self.jobs).take();
        if let Some(handle) = lock(&self.handle).take() {
            // Ignore a writer that panicked.
            let _ended = handle.join();
        }
    }
}

/// Does work; a panic becomes an error.
pub(crate) fn caught(work: impl FnOnce() -> Result<()>) -> Result<()> {
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(work)).unwrap_or(Err(Error::Closed))
}

/// Runs queued work with one commit per group, until all senders are gone.
fn write_all<W: Writer>(mut writer: W, queue: &Receiver<Job>) {
    while let Ok(first) = queue.recv() {
        let mut group = vec![first];
        while group.len() < W::GROUP
            && let Ok(job) = queue.try_recv()
        {
            group.push(job);
        }
        write_group(&mut writer, group);
    }
    writer.close();
}

fn write_group(writer: &mut impl Writer, group: Vec<Job>) {
    let mut answers = Vec::with_capacity(group.len());
    let outcome = run_group(writer, group, &mut answers);
    if outcome.is_err() && writer.is_open() {
        // The commit failed: the whole group is rolled back.
        writer.roll_back();
    }
    let failure = outcome.err().map(|error| match error {
        Error::ReadOnly { reason } => reason,
        other => format!(
            "{}; nothing was written, send the request again",
            other.full()
        ),
    });
    for (done, answer) in answers {
        let answer = match &failure {
            None => answer,
            Some(reason) => Err(read_only(reason)),
        };
        // The sender may have gone away.
        let _told = done.send(answer);
    }
}

type Answers = Vec<(SyncSender<Result<()>>, Result<()>)>;

fn run_group(writer: &mut impl Writer, group: Vec<Job>, answers: &mut Answers) -> Result<()> {
    if let Err(error) = writer.begin() {
        answers.extend(group.into_iter().map(|job| (job.done, Ok(()))));
        return Err(error);
    }
    let mut jobs = group.into_iter();
    for job in jobs.by_ref() {
        let outcome = writer.run(job.work);
        if !writer.is_open() {
            // The database rolled the whole transaction back.
            let reason = match outcome {
                Ok(()) => Error::Closed,
                Err(error) => error,
            };
            answers.push((job.done, Ok(())));
            answers.extend(jobs.map(|job| (job.done, Ok(()))));
            return Err(reason);
        }
        answers.push((job.done, outcome));
    }
    writer.commit()
}
