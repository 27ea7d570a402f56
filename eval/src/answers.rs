//! Tables of edits: reading, checking, scoring, and committing the scores.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use datasets_spec::dataset::{commit_rows, refuse_others};
use datasets_spec::manifest::plan_hash;
use datasets_spec::record::{EditRow, ItemRow, QuarantineRow, ScoreRow};
use datasets_spec::table::{Row, read_column};
use datasets_spec::{Dataset, Progress, Skeleton};

use crate::Error;
use crate::compare::Comparison;
use crate::evaluators::Evaluators;
use crate::judge::{Judge, Judges, unranked};
use crate::metric;
use crate::names::{ALL_TASKS, GIVEN};
use crate::protocol::Protocol;
use crate::score::score;
use crate::table::Table;

pub use crate::answered::Answered;

/// Scores, and facts about the encoders used to measure them.
#[derive(Clone, Debug)]
pub struct Scores {
    /// One row per system, task and metric.
    pub rows: Vec<ScoreRow>,
    /// Encoders by their hashes.
    pub judges: Judges,
    /// Paired differences in the metrics that support claims; empty in scores averaged over trainings.
    pub comparisons: Vec<Comparison>,
}

impl Scores {
    /// Scores every system.
    ///
    /// # Errors
    /// As [`score`].
    pub fn of(
        answered: &Answered,
        evaluators: Evaluators<'_>,
        protocol: &Protocol,
        progress: &dyn Progress,
    ) -> Result<Self, Error> {
        let encoder = evaluators.encoder;
        let (rows, comparisons) = score(answered, evaluators, protocol, progress)?;
        Ok(Self {
            rows,
            comparisons,
            judges: BTreeMap::from([(encoder.hash(), Judge::of(encoder))]),
        })
    }

    /// The main table of each task. A table that can rank systems has the claims of its comparisons as notes.
    pub fn main_tables(&self) -> Vec<Table> {
        let mut tables = Table::from_scores(&self.rows, &self.judges, &metric::main_columns());
        for table in &mut tables {
            let is_of = |found: &&Comparison| {
                (&found.task, &found.protocol, &found.items_digest)
                    == (&table.task, &table.protocol, &table.items.digest)
            };
            let of_table = self.comparisons.iter().filter(is_of);
            if table.unranked.is_none() {
                let claims: Vec<String> = of_table.filter_map(Comparison::claim).collect();
                table.notes.extend(claims);
            }
        }
        tables
    }

    /// Reason why these scores cannot rank systems on the whole set of items; `None` if they can.
    pub fn unranked(&self) -> Option<String> {
        let of_all = self.rows.iter().find(|row| row.task == ALL_TASKS);
        let first = of_all.or(self.rows.first())?;
        unranked(first, &self.rows, &self.judges)
    }

    /// Refuses a folder that holds other tables than scores, or than the items and edits that they are about.
    ///
    /// # Errors
    /// It does, or it cannot be read.
    pub fn check_room(out: &Path) -> Result<(), Error> {
        let own = [
            ScoreRow::TABLE,
            ItemRow::TABLE,
            EditRow::TABLE,
            QuarantineRow::TABLE,
        ];
        Ok(refuse_others(out, &own, "scores")?)
    }

    /// The systems whose scores a folder holds, and the version of the folder; `None` if it holds none.
    ///
    /// # Errors
    /// The folder is no dataset and holds files that one would replace, or it cannot be read.
    pub fn held_in(out: &Path) -> Result<Option<(BTreeSet<String>, u64)>, Error> {
        let Some(held) = Dataset::held_in(out)? else {
            return Ok(None);
        };
        let mut systems = BTreeSet::new();
        for (path, _) in held.files(ScoreRow::TABLE, None) {
            systems.extend(read_column::<ScoreRow, String>(&path, "system")?);
        }
        systems.retain(|system| !GIVEN.contains(&system.as_str()));
        Ok((!systems.is_empty()).then(|| (systems, held.manifest().version)))
    }

    /// Commits the scores as a separate dataset.
    ///
    /// # Errors
    /// The folder is locked or cannot be written.
    pub fn commit(&self, out: &Path, skeleton: &Skeleton, holder: &str) -> Result<Dataset, Error> {
        Self::check_room(out)?;
        // Debug writes every digit of a number, and NaN too.
        let rows = format!("{:?}", self.rows);
        let plan = plan_hash("scores", &rows);
        Ok(commit_rows(out, &self.rows, None, skeleton, &plan, holder)?)
    }
}
