//! Tables of edits: read together, checked, scored, and the scores committed.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use datasets_spec::dataset::commit_rows;
use datasets_spec::manifest::plan_hash;
use datasets_spec::record::{EditRow, ItemRow, ScoreRow};
use datasets_spec::{Dataset, Progress, Skeleton};

use crate::Error;
use crate::compare::{Comparison, compare};
use crate::evaluators::Evaluators;
use crate::judge::{Judge, Judges, unranked};
use crate::metric;
use crate::names::ALL_TASKS;
use crate::protocol::Protocol;
use crate::score::score_and_compare;
use crate::table::Table;

pub use crate::judge::{RankedGalleries, encoder_retrieval};

/// Items and the edits that systems made of them.
#[derive(Clone, Debug)]
pub struct Answered {
    /// The items.
    pub items: Vec<ItemRow>,
    /// Edits of all systems.
    pub edits: Vec<EditRow>,
    /// The skeleton that all motions are on.
    pub skeleton: Skeleton,
}

impl Answered {
    /// Reads tables of edits of the same items. A folder of items alone has no edits.
    ///
    /// # Errors
    /// There is no folder, one cannot be read, or two are of other items or skeletons.
    pub fn read(folders: &[PathBuf]) -> Result<Self, Error> {
        let mut all: Option<(&Path, Self)> = None;
        for path in folders {
            let folder = Dataset::open(path)?;
            let read = Self {
                items: folder.items()?,
                edits: folder.read(None)?,
                skeleton: folder.skeleton()?,
            };
            match &mut all {
                None => all = Some((path, read)),
                Some((first, all)) => all.merge(first, read, path)?,
            }
        }
        match all {
            Some((_, all)) => Ok(all),
            None => Err(Error::NoTables),
        }
    }

    /// Reads tables of edits whose systems are rows of one result table.
    ///
    /// # Errors
    /// As [`Answered::read`], or one name stands for two systems.
    pub fn read_for_table(folders: &[PathBuf]) -> Result<Self, Error> {
        Self::read(folders)?.with_edits(Vec::new())
    }

    /// Adds edits of the same items, whose systems are rows of the same result table.
    ///
    /// # Errors
    /// One name stands for two systems, or a take is there twice.
    pub fn with_edits(mut self, edits: Vec<EditRow>) -> Result<Self, Error> {
        self.edits.extend(edits);
        check_systems(&self.edits)?;
        Ok(self)
    }

    /// Adds the edits of another folder, after checking that they are of the same items.
    fn merge(&mut self, first: &Path, other: Self, path: &Path) -> Result<(), Error> {
        if other.skeleton != self.skeleton {
            return Err(Error::OtherSkeleton {
                first: first.to_owned(),
                first_skeleton: self.skeleton.name().to_owned(),
                other: path.to_owned(),
                other_skeleton: other.skeleton.name().to_owned(),
            });
        }
        let ids = |items: &[ItemRow]| -> BTreeSet<String> {
            items.iter().map(|item| item.id.clone()).collect()
        };
        let (ours, theirs) = (ids(&self.items), ids(&other.items));
        if ours != theirs {
            return Err(Error::OtherItems {
                first: first.to_owned(),
                first_alone: [ours.difference(&theirs).count(), ours.len()],
                other: path.to_owned(),
                other_alone: [theirs.difference(&ours).count(), theirs.len()],
            });
        }
        self.edits.extend(other.edits);
        Ok(())
    }
}

/// Refuses two checkpoints or two settings under one name, which would become one row of a table, and a
/// take that is there twice.
fn check_systems(edits: &[EditRow]) -> Result<(), Error> {
    let mut known: BTreeMap<&str, &EditRow> = BTreeMap::new();
    let mut takes: BTreeSet<(&str, &str, u64)> = BTreeSet::new();
    for row in edits {
        let first = *known.entry(&row.system).or_insert(row);
        let differs = |what, first: String, other: String| Error::TwoSystems {
            system: row.system.clone(),
            what,
            first,
            other,
        };
        if first.checkpoint_hash != row.checkpoint_hash {
            let short = |hash: &str| format!("{hash:.12}");
            let (a, b) = (&first.checkpoint_hash, &row.checkpoint_hash);
            return Err(differs("checkpoints", short(a), short(b)));
        }
        if first.settings_hash != row.settings_hash {
            let (a, b) = (first.settings.clone(), row.settings.clone());
            return Err(differs("settings", a, b));
        }
        if !takes.insert((&row.system, &row.id, row.seed)) {
            return Err(Error::SameTake {
                system: row.system.clone(),
                id: row.id.clone(),
                seed: row.seed,
            });
        }
    }
    Ok(())
}

/// Scores and what is known of the encoders behind them.
#[derive(Clone, Debug)]
pub struct Scores {
    /// A row for each system, task and metric.
    pub rows: Vec<ScoreRow>,
    /// Each encoder by its hash.
    pub judges: Judges,
    /// Paired differences of the metrics that claims are made of; none in scores that are averaged over trainings.
    pub comparisons: Vec<Comparison>,
}

impl Scores {
    /// Scores every system.
    ///
    /// # Errors
    /// As [`score_and_compare`].
    pub fn of(
        answered: &Answered,
        evaluators: Evaluators<'_>,
        protocol: &Protocol,
        progress: &dyn Progress,
    ) -> Result<Self, Error> {
        let encoder = evaluators.encoder;
        let (items, edits) = (&answered.items, &answered.edits);
        let (rows, comparisons) = score_and_compare(items, edits, evaluators, protocol, progress)?;
        Ok(Self {
            rows,
            comparisons,
            judges: BTreeMap::from([(encoder.hash(), Judge::of(encoder))]),
        })
    }

    /// The main table of each task, with a sentence below it for each comparison.
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

    /// Why the scores rank no system on the whole set of items; none if they do.
    pub fn unranked(&self) -> Option<String> {
        let of_all = self.rows.iter().find(|row| row.task == ALL_TASKS);
        let first = of_all.or(self.rows.first())?;
        unranked(first, &self.rows, &self.judges)
    }

    /// Commits the scores as a dataset of their own.
    ///
    /// # Errors
    /// The folder is locked or cannot be written.
    pub fn commit(&self, out: &Path, skeleton: &Skeleton, holder: &str) -> Result<Dataset, Error> {
        let values: Vec<_> = self
            .rows
            .iter()
            .map(|row| (&row.system, &row.task, &row.metric, row.mean.to_bits()))
            .collect();
        let plan = plan_hash("scores", &values);
        Ok(commit_rows(out, &self.rows, None, skeleton, &plan, holder)?)
    }
}

/// Edits of two systems of the same items.
#[derive(Clone, Debug)]
pub struct Paired {
    /// Items and edits; the systems are told apart by their names.
    pub answered: Answered,
    /// Names of the two systems.
    pub names: [String; 2],
}

impl Paired {
    /// Reads two tables of edits of the same items, of one system each.
    ///
    /// # Errors
    /// As [`Answered::read`], or a table holds several systems.
    pub fn read(folders: [&Path; 2]) -> Result<Self, Error> {
        // Checks that both are of the same items.
        let Answered {
            items, skeleton, ..
        } = Answered::read(&folders.map(Path::to_owned))?;
        let mut edits: Vec<EditRow> = Vec::new();
        let mut named = |path: &Path, side: &str| -> Result<String, Error> {
            let found: Vec<EditRow> = Dataset::open(path)?.read(None)?;
            check_systems(&found).map_err(|source| Error::TableOf {
                path: path.to_owned(),
                source: Box::new(source),
            })?;
            let systems: BTreeSet<&str> = found.iter().map(|row| row.system.as_str()).collect();
            let &[system] = Vec::from_iter(systems.iter().copied()).as_slice() else {
                return Err(Error::SeveralSystems {
                    path: path.to_owned(),
                    count: systems.len(),
                    systems: Vec::from_iter(systems).join(", "),
                });
            };
            // Two runs of one method have the same name.
            let name = format!("{system} ({side})");
            edits.extend(found.into_iter().map(|row| EditRow {
                system: name.clone(),
                ..row
            }));
            Ok(name)
        };
        let [a, b] = folders;
        let names = [named(a, "A")?, named(b, "B")?];
        Ok(Self {
            answered: Answered {
                items,
                edits,
                skeleton,
            },
            names,
        })
    }

    /// Compares the two systems item by item.
    ///
    /// # Errors
    /// As [`compare`].
    pub fn compare(
        &self,
        evaluators: Evaluators<'_>,
        protocol: &Protocol,
        progress: &dyn Progress,
    ) -> Result<Vec<Comparison>, Error> {
        let Answered { items, edits, .. } = &self.answered;
        let names = self.names.each_ref().map(String::as_str);
        compare(items, edits, names, evaluators, protocol, progress)
    }
}
