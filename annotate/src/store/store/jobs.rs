//! Operations on jobs and their files.

use std::io::Read;

use super::Store;
use crate::Error;
use crate::store::entry::{Body, Entry};
use crate::store::records::Millis;
use crate::store::{log, project};
use crate::wire::Job;

/// Bytes of a file written per transaction.
const FILE_PART: u64 = 1 << 20;

impl Store {
    /// Stores a job; id 0 creates a new one.
    ///
    /// # Errors
    /// The store fails.
    pub fn put_job(&self, job: Job, now: Millis) -> Result<Job, Error> {
        self.write(move |tx| project::put_job(tx, job, now))
    }

    /// Whether servers on several machines can use the store. If so, it also keeps the files of their exports.
    pub(crate) fn is_shared(&self) -> bool {
        self.db.is_shared()
    }

    /// Stores a file of a job, and removes those of all jobs but the last `kept`.
    pub(crate) fn put_file(
        &self,
        job: i64,
        name: &str,
        mut content: impl Read,
        kept: i64,
    ) -> Result<(), Error> {
        for number in 0.. {
            let mut bytes = Vec::new();
            content
                .by_ref()
                .take(FILE_PART)
                .read_to_end(&mut bytes)
                .map_err(datasets_spec::Error::io("read", name))?;
            let is_last = (bytes.len() as u64) < FILE_PART;
            let name = name.to_owned();
            self.write(move |tx| project::put_file_part(tx, job, &name, number, bytes))?;
            if is_last {
                break;
            }
        }
        self.write(move |tx| project::forget_files(tx, kept))
    }

    /// A file of a job, if the store keeps it.
    pub(crate) fn file(&self, job: i64, name: &str) -> Result<Option<Vec<u8>>, Error> {
        let mut content = None;
        for number in 0.. {
            let name = name.to_owned();
            match self.read(move |tx| project::file_part(tx, job, &name, number))? {
                Some(part) => content.get_or_insert_with(Vec::new).extend(part),
                None => break,
            }
        }
        Ok(content)
    }

    /// Records that a job runs.
    ///
    /// # Errors
    /// The store fails.
    pub fn beat(&self, job: i64, now: Millis) -> Result<(), Error> {
        self.write(move |tx| project::beat(tx, job, now))
    }

    /// Marks running jobs as failed if their server last reported them before `since`.
    ///
    /// # Errors
    /// The store fails.
    pub fn abandon(&self, since: Millis, now: Millis) -> Result<(), Error> {
        let is_lost = move |job: &Job| job.state == "running" && job.heartbeat < since;
        if !self.jobs()?.iter().any(is_lost) {
            return Ok(());
        }
        self.write(move |tx| {
            // Read again: the job may have reported meanwhile.
            for mut job in project::jobs(tx)?.into_iter().filter(is_lost) {
                "failed".clone_into(&mut job.state);
                job.finished = Some(now);
                job.messages
                    .push("the server that ran this job stopped; start the job again".to_owned());
                project::put_job(tx, job, now)?;
            }
            Ok(())
        })
    }

    /// Jobs, newest first.
    ///
    /// # Errors
    /// The store fails.
    pub fn jobs(&self) -> Result<Vec<Job>, Error> {
        self.read(project::jobs)
    }

    /// Logs an export.
    ///
    /// # Errors
    /// The store fails.
    pub fn log_export(
        &self,
        actor: Option<i64>,
        body: serde_json::Value,
        now: Millis,
    ) -> Result<(), Error> {
        self.write(move |tx| {
            let entry = Entry {
                at: now,
                actor,
                task: None,
                epoch: None,
                body: Body::Exported { export: body },
            };
            log::note(tx, &entry).map(|_| ())
        })
    }
}
