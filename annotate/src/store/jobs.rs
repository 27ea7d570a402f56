//! Jobs and their files.

use std::io::Read;

use super::db::{Result, Tx, Value, json, params};
use super::entry::{Body, read_stored};
use super::log;
use super::records::Millis;
use super::store::Store;
use crate::wire::Job;

/// Maximum number of listed jobs.
const JOBS: i64 = 100;
/// Bytes of a file written per transaction.
const FILE_PART: u64 = 1 << 20;
/// Milliseconds without a report after which a running job counts as lost.
const SILENT: Millis = 60_000;

impl Store {
    /// Stores a job, with `now` as the time of its last report; id 0 creates a new one.
    pub fn put_job(&self, job: Job, now: Millis) -> Result<Job> {
        self.write(move |tx| put_job(tx, job, now))
    }

    /// Stores a file of a job, and removes the files of all but the last `kept` jobs with files.
    pub(crate) fn put_file(
        &self,
        job: i64,
        name: &str,
        mut content: impl Read,
        kept: i64,
    ) -> Result<()> {
        for number in 0_i64.. {
            let mut bytes = Vec::new();
            content
                .by_ref()
                .take(FILE_PART)
                .read_to_end(&mut bytes)
                .map_err(datasets_spec::Error::io("read", name))?;
            let is_last = (bytes.len() as u64) < FILE_PART;
            let name = name.to_owned();
            self.write(move |tx| {
                let sql = "INSERT INTO job_file (job, name, part, bytes) VALUES (?1, ?2, ?3, ?4)";
                tx.run(sql, params![job, name, number, bytes])
            })?;
            if is_last {
                break;
            }
        }
        self.write(move |tx| {
            tx.run(
                "DELETE FROM job_file WHERE job NOT IN (
                   SELECT k.job FROM (SELECT DISTINCT job FROM job_file ORDER BY job DESC LIMIT ?1) k)",
                params![kept],
            )
        })
    }

    /// A file of a job, if the store keeps it.
    pub(crate) fn file(&self, job: i64, name: &str) -> Result<Option<Vec<u8>>> {
        let sql = "SELECT bytes FROM job_file WHERE job = ?1 AND name = ?2 AND part = ?3";
        let mut content = None;
        for number in 0_i64.. {
            let part = self
                .read(|tx| tx.query(sql, params![job, name, number]))?
                .pop();
            let Some(Value::Blob(part)) = part.and_then(|mut part| part.0.pop()) else {
                break;
            };
            content.get_or_insert_with(Vec::new).extend(part);
        }
        Ok(content)
    }

    /// Records that a running job still runs.
    pub fn beat(&self, job: i64, now: Millis) -> Result<()> {
        let sql = "SELECT body FROM job WHERE id = ?1";
        self.write(move |tx| match read_jobs(tx, sql, job)?.pop() {
            Some(job) if job.state == "running" => put_job(tx, job, now).map(|_| ()),
            _ => Ok(()),
        })
    }

    /// Marks the jobs of stopped servers as failed: running jobs without a report for a minute.
    pub fn abandon(&self, now: Millis) -> Result<()> {
        let is_lost = move |job: &Job| job.state == "running" && job.heartbeat < now - SILENT;
        if !self.jobs()?.iter().any(is_lost) {
            return Ok(());
        }
        self.write(move |tx| {
            // Read again: the job may have reported meanwhile.
            for mut job in jobs(tx)?.into_iter().filter(is_lost) {
                "failed".clone_into(&mut job.state);
                job.finished = Some(now);
                job.messages
                    .push("the server that ran this job stopped; start the job again".to_owned());
                put_job(tx, job, now)?;
            }
            Ok(())
        })
    }

    /// The last 100 jobs, newest first.
    pub fn jobs(&self) -> Result<Vec<Job>> {
        self.read(jobs)
    }

    /// Logs an export.
    pub fn log_export(
        &self,
        actor: Option<i64>,
        export: serde_json::Value,
        now: Millis,
    ) -> Result<()> {
        self.write(move |tx| log::note(tx, now, actor, None, Body::Exported { export }))
    }
}

fn put_job(tx: &mut dyn Tx, mut job: Job, now: Millis) -> Result<Job> {
    job.heartbeat = now;
    if job.id == 0 {
        job.id = tx.next_id("job")?;
    }
    let sql = "INSERT INTO job (id, body) VALUES (?1, ?2) ON CONFLICT (id) DO UPDATE SET body = excluded.body";
    tx.run(sql, params![job.id, json(&job)?])?;
    Ok(job)
}

fn jobs(tx: &mut dyn Tx) -> Result<Vec<Job>> {
    read_jobs(tx, "SELECT body FROM job ORDER BY id DESC LIMIT ?1", JOBS)
}

fn read_jobs(tx: &mut dyn Tx, sql: &str, value: i64) -> Result<Vec<Job>> {
    let stored: Vec<String> = tx.list(sql, params![value])?;
    let stored = stored.iter();
    stored.map(|body| read_stored("job", body)).collect()
}
