//! Making pieces.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::OnceLock;
use std::time::Instant;

use datasets_spec::dataset::Staging;

use super::job::{Job, Jobs};
use super::piece::Piece;
use super::plan::{Plan, State};
use super::record::{Failed, Outcome, Record, Stored, failed_name, staged};
use crate::Error;

/// Makes pieces of a plan. One worker serves all pieces that a process makes, from any of its threads.
pub struct Worker {
    plan: Plan,
    staging: Staging,
    jobs: Jobs,
    /// The job, opened for the first piece that is missing.
    job: OnceLock<Result<Box<dyn Job>, Failed>>,
}

/// Time that some items took.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Items that were made.
    pub items: u64,
    /// Seconds that they took.
    pub secs: f64,
}

impl Worker {
    /// Opens a plan; `jobs` are those that this program knows.
    ///
    /// # Errors
    /// As [`Plan::open`].
    pub fn open(plan: &Path, jobs: Jobs) -> Result<Self, Error> {
        let plan = Plan::open(plan)?;
        Ok(Self {
            staging: plan.staging(),
            plan,
            jobs,
            job: OnceLock::new(),
        })
    }

    /// The plan.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// Makes the piece with this id, unless it exists. An existing piece takes milliseconds: only the hashes of its
    /// files are checked.
    ///
    /// The record reports failures, including panics.
    pub fn make(&self, id: &str) -> Record {
        let Some(piece) = self.plan.piece(id) else {
            let unknown = Piece {
                id: id.to_owned(),
                name: String::new(),
                number: 0,
                items: 0,
                bytes: 0,
                detail: String::new(),
            };
            let reason = format!(
                "the plan {} has no piece {id}; `stance stage status` lists its pieces",
                self.plan.path().display()
            );
            return Record::failed(&unknown, Failed::new("E-PIECE-UNKNOWN", reason), 0.0);
        };
        let begun = Instant::now();
        let attempt = catch_unwind(AssertUnwindSafe(|| self.made(piece, begun)));
        let failed = match attempt {
            Ok(Ok(record)) => return record,
            Ok(Err(failed)) => failed,
            Err(_) => Failed::new(
                "E-INTERNAL",
                "the program failed on this piece; please report it with the lines above",
            ),
        };
        self.fail(piece, failed, begun.elapsed().as_secs_f64())
    }

    /// Records that a piece failed. A piece that exists is kept.
    pub fn fail(&self, piece: &Piece, failed: Failed, secs: f64) -> Record {
        let record = Record::failed(piece, failed, secs);
        // On a full disk the record cannot be kept either; the piece then counts as missing, not as failed.
        let _kept = self.staging.put(&failed_name(&piece.id), &record);
        record
    }

    fn made(&self, piece: &Piece, begun: Instant) -> Result<Record, Failed> {
        let before = |files| Record {
            outcome: Outcome::DoneBefore,
            ..Record::done(piece, files, 0.0)
        };
        match self.plan.state()? {
            State::Open => {}
            State::Committed => return Ok(before(Vec::new())),
            State::Changed(now) => return Err(self.plan.changed(now).into()),
        }
        if let Some(stored) = staged(&self.staging, &piece.id)? {
            return Ok(before(stored.record.files));
        }
        let job = self.job.get_or_init(|| self.jobs.open(&self.plan));
        let job = job.as_ref().map_err(Failed::clone)?;
        let made = job.make(piece, &self.staging)?;
        let record = Record::done(piece, made.files, begun.elapsed().as_secs_f64());
        let stored = Stored {
            record,
            notes: made.notes,
        };
        self.staging.put(&piece.id, &stored)?;
        Ok(stored.record)
    }

    /// Makes up to `count` items of the largest piece without keeping them, to time them. `None` if the plan has no
    /// piece.
    ///
    /// # Errors
    /// The items cannot be made.
    pub fn sample(&self, count: u64) -> Result<Option<Sample>, Failed> {
        let pieces = self.plan.pieces().iter();
        let Some(piece) = pieces.max_by_key(|piece| piece.items) else {
            return Ok(None);
        };
        let job = self.job.get_or_init(|| self.jobs.open(&self.plan));
        let job = job.as_ref().map_err(Failed::clone)?;
        let begun = Instant::now();
        let items = job.sample(piece, count)?;
        Ok(Some(Sample {
            items,
            secs: begun.elapsed().as_secs_f64(),
        }))
    }
}
