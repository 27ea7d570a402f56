//! Committing a plan.

use std::collections::BTreeMap;
use std::path::Path;

use datasets_spec::manifest::{Accounting, FileEntry};
use datasets_spec::record::QuarantineRow;
use datasets_spec::table::Row;
use datasets_spec::{Progress, Transaction};
use rayon::prelude::*;
use serde::Serialize;

use super::job::Jobs;
use super::piece::Piece;
use super::plan::{Plan, State};
use super::record::{
    CommitOptions, Committed, Failed, Finished, Made, Record, failed_name, staged,
};
use crate::Error;

/// Progress of the work on a plan.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Status {
    /// Whether the plan was committed.
    pub committed: bool,
    /// Pieces of the plan.
    pub pieces: u64,
    /// Pieces that exist and are complete.
    pub done: u64,
    /// Ids of pieces that were not made yet.
    pub missing: Vec<String>,
    /// Records of pieces that failed.
    pub failed: Vec<Record>,
    /// Seconds of work in the pieces that exist.
    pub secs: f64,
}

/// State of a piece before the commit.
enum Found {
    Done(Made, f64),
    Failed(Record),
    Missing,
}

fn found(plan: &Plan) -> Result<Vec<(&Piece, Found)>, Error> {
    let staging = plan.staging();
    let pieces = plan.pieces().par_iter();
    pieces
        .map(|piece| {
            if let Some(stored) = staged(&staging, &piece.id)? {
                let (files, notes) = (stored.record.files, stored.notes);
                let done = Found::Done(Made { files, notes }, stored.record.secs);
                return Ok((piece, done));
            }
            let failed = staging.get::<Record>(&failed_name(&piece.id));
            Ok((piece, failed.map_or(Found::Missing, Found::Failed)))
        })
        .collect()
}

/// Returns the progress of the work on a plan.
///
/// # Errors
/// The plan or its destination cannot be read, or the destination changed since it was planned.
pub fn status(plan: &Plan) -> Result<Status, Error> {
    let pieces = plan.pieces().len() as u64;
    let mut status = Status {
        pieces,
        ..Status::default()
    };
    match plan.state()? {
        State::Open => {}
        State::Committed => {
            return Ok(Status {
                committed: true,
                done: pieces,
                ..status
            });
        }
        State::Changed(now) => return Err(plan.changed(now)),
    }
    for (piece, found) in found(plan)? {
        match found {
            Found::Done(_, secs) => {
                status.done += 1;
                status.secs += secs;
            }
            Found::Failed(record) => status.failed.push(record),
            Found::Missing => status.missing.push(piece.id.clone()),
        }
    }
    Ok(status)
}

/// Makes the pieces of a plan a part of its destination. A plan that was committed before is not committed again.
///
/// # Errors
/// Pieces are missing or failed, the destination is locked or changed since the plan was made, or writing fails.
/// The destination is then as it was, and the commit can be repeated.
pub fn commit(
    plan: &Path,
    jobs: &Jobs,
    options: &CommitOptions,
    progress: &dyn Progress,
) -> Result<Committed, Error> {
    let plan = &Plan::open(plan)?;
    match plan.state()? {
        State::Open => {}
        State::Committed => return already_committed(plan),
        State::Changed(now) => return Err(plan.changed(now)),
    }
    let (mut pieces, mut failed, mut missing) = (Vec::new(), Vec::new(), 0);
    for (piece, found) in found(plan)? {
        let made = match found {
            Found::Done(made, _) => Ok(made),
            Found::Failed(record) => {
                let why = Failed {
                    code: record.code.clone().unwrap_or_default(),
                    reason: record.reason.clone().unwrap_or_default(),
                };
                failed.push(record);
                Err(why)
            }
            Found::Missing => {
                missing += 1;
                continue;
            }
        };
        pieces.push(Finished {
            piece: piece.clone(),
            made,
        });
    }
    let of = plan.pieces().len();
    if missing > 0 {
        return Err(Error::PiecesMissing {
            path: plan.path().to_owned(),
            missing,
            of,
        });
    }
    if !failed.is_empty() && !options.quarantine_failed {
        const SHOWN: usize = 3;
        let shown = failed.iter().take(SHOWN).map(|record| {
            let (code, reason) = (&record.code, &record.reason);
            let [code, reason] = [code, reason].map(|text| text.as_deref().unwrap_or_default());
            format!("{} {} ({code}: {reason})", record.piece, record.name)
        });
        let mut shown = shown.collect::<Vec<String>>().join("; ");
        if failed.len() > SHOWN {
            shown += &format!("; and {} more", failed.len() - SHOWN);
        }
        return Err(Error::PiecesFailed {
            path: plan.path().to_owned(),
            failed: failed.len(),
            of,
            shown,
        });
    }
    let job = jobs.open(plan)?;
    let committed = match job.commit(plan, pieces, options, progress) {
        // Another process has committed the plan.
        Err(Error::StalePlan { .. } | Error::Occupied { .. })
            if plan.state()? == State::Committed =>
        {
            return already_committed(plan);
        }
        committed => committed?,
    };
    Ok(Committed {
        failed: failed.len() as u64,
        ..committed
    })
}

fn already_committed(plan: &Plan) -> Result<Committed, Error> {
    if !plan.is_dataset()
        && let Some(committed) = plan.published()?
    {
        // A worker or a commit that came late may have made the folder of the pieces again.
        plan.settle(&committed)?;
        return Ok(Committed {
            already_committed: true,
            ..committed
        });
    }
    let dataset = datasets_spec::Dataset::open_unverified(plan.destination())?;
    Ok(Committed {
        already_committed: true,
        ..plan.committed(dataset.manifest())
    })
}

/// Failed pieces as rows of the quarantine table, for jobs whose items are not source files.
#[derive(Clone, Debug, Default)]
pub struct Quarantine {
    rows: Vec<QuarantineRow>,
    pieces: u64,
}

impl Quarantine {
    /// Separates the pieces that failed from the others.
    pub fn of(pieces: Vec<Finished>) -> (Vec<(Piece, Made)>, Self) {
        let mut quarantine = Self {
            rows: Vec::new(),
            pieces: pieces.len() as u64,
        };
        let mut made = Vec::new();
        for finished in pieces {
            match finished.made {
                Ok(result) => made.push((finished.piece, result)),
                Err(Failed { code, reason }) => quarantine.rows.push(QuarantineRow {
                    path: finished.piece.name,
                    source_name: String::new(),
                    source_hash: String::new(),
                    inputs_hash: String::new(),
                    code,
                    reason,
                    byte_offset: None,
                    stage: "piece".to_owned(),
                }),
            }
        }
        (made, quarantine)
    }

    /// Adds the quarantine table to the tables of a commit, and returns the counts. If no piece failed, it adds nothing
    /// and returns `None`.
    ///
    /// # Errors
    /// The table cannot be written.
    pub fn write(
        &self,
        transaction: &Transaction,
        tables: &mut BTreeMap<String, Vec<FileEntry>>,
        facts: &[(&str, String)],
    ) -> Result<Option<Accounting>, Error> {
        if self.rows.is_empty() {
            return Ok(None);
        }
        let files = transaction.write_shards(None, &self.rows, facts)?;
        tables.insert(QuarantineRow::TABLE.to_owned(), files);
        let ingested = self.pieces - self.rows.len() as u64;
        let codes = self.rows.iter().map(|row| row.code.clone());
        Ok(Some(Accounting::of(ingested, 0, codes)))
    }
}
