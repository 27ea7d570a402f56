//! One thread that writes and commits in groups.
//!
//! A commit waits for the disk. Work that arrives meanwhile queues up, and the next commit takes all of
//! it, so many writers share one wait. Work that fails is rolled back alone.

use std::sync::Mutex;
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};
use std::thread::JoinHandle;

use super::db::Work;
use crate::Error;
use crate::lock::lock;

/// A connection that writes.
pub(crate) trait Writer: Send + 'static {
    /// Most pieces of work in one commit; bounds how long the first of them and other servers wait.
    const GROUP: usize;

    /// Begins a transaction.
    fn begin(&mut self) -> Result<(), Error>;
    /// Does work; if it fails, nothing of it stays.
    fn run(&mut self, work: Work) -> Result<(), Error>;
    /// Whether the transaction is still open.
    fn is_open(&self) -> bool;
    /// Makes the transaction durable.
    fn commit(&mut self) -> Result<(), Error>;
    /// Gives the transaction up.
    fn roll_back(&mut self);
    /// Ends, once nobody can send work any more.
    fn close(self);
}

struct Job {
    work: Work,
    done: SyncSender<Result<(), Error>>,
}

/// A thread that does the work it is sent, in the order it is sent.
pub(crate) struct WriterThread {
    /// None once the store is being closed.
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

    /// Does work; returns once it is durable.
    pub(crate) fn write(&self, work: Work) -> Result<(), Error> {
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
            // A writer that panicked has nothing more to say.
            let _ended = handle.join();
        }
    }
}

/// Does work; a panic in it is an error.
pub(crate) fn caught(work: impl FnOnce() -> Result<(), Error>) -> Result<(), Error> {
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(work)).unwrap_or(Err(Error::Closed))
}

/// Takes work from the queue, one commit for each group, until all senders are gone.
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
        // The commit failed; nothing of the group stays.
        writer.roll_back();
    }
    let failure = outcome.err().map(|error| match error {
        Error::ReadOnly { reason } => reason,
        other => format!("{other:#}"),
    });
    for (done, answer) in answers {
        let answer = match &failure {
            None => answer,
            Some(reason) => Err(Error::ReadOnly {
                reason: reason.clone(),
            }),
        };
        // Somebody who went away does not wait for the answer.
        let _told = done.send(answer);
    }
}

type Answers = Vec<(SyncSender<Result<(), Error>>, Result<(), Error>)>;

fn run_group(
    writer: &mut impl Writer,
    group: Vec<Job>,
    answers: &mut Answers,
) -> Result<(), Error> {
    if let Err(error) = writer.begin() {
        answers.extend(group.into_iter().map(|job| (job.done, Ok(()))));
        return Err(error);
    }
    let mut jobs = group.into_iter();
    for job in jobs.by_ref() {
        let outcome = writer.run(job.work);
        answers.push((job.done, outcome));
        if !writer.is_open() {
            // The database gave the whole transaction up: a full disk, most likely.
            answers.extend(jobs.map(|job| (job.done, Ok(()))));
            return Err(Error::ReadOnly {
                reason: "the disk is full or fails, or the database is gone".to_owned(),
            });
        }
    }
    writer.commit()
}
