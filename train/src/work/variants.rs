//! Candidates of fine-grained pairs, made by a job in pieces.

use std::path::{Path, PathBuf};
use std::sync::Mutex;

use datasets_spec::dataset::{ShardName, Staging, table_facts};
use datasets_spec::record::{MotionRow, PairRow};
use datasets_spec::table::{Row, read_rows};
use datasets_spec::{Progress, Seed};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use work::{
    self, CommitOptions, Committed, Failed, Finished, Job, Made, Piece, Plan, Quarantine, absolute,
};

use super::{Surroundings, changed, in_turn, of_commit, write_plan};
use crate::Error;
use crate::candidates::{Candidates, VariantCounts};
use crate::stage::variants::{Instructions, MakeVariants, Making, made_before};

/// Name of the job.
pub const JOB: &str = "variants";

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Stored {
    dataset: PathBuf,
    generator: PathBuf,
    instructions: Instructions,
    config: MakeVariants,
    text_encoder: Option<PathBuf>,
    seed: Seed,
    /// Device options of the command line.
    device: Value,
}

impl Stored {
    fn open(&self, surroundings: &Surroundings) -> Result<Making, Error> {
        let folders = [self.dataset.as_path(), self.generator.as_path()];
        let (asked, config) = (&self.instructions, &self.config);
        let encoder = surroundings.text_encoder(self.text_encoder.clone());
        Making::open(
            folders,
            asked,
            config,
            &encoder,
            self.seed,
            &surroundings.device,
        )
    }
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Detail {
    batch: usize,
}

struct Variants {
    making: Mutex<Making>,
    surroundings: Surroundings,
}

/// Plans the variants of a generator. `device` is stored for the workers, and `out` is the folder of the plan.
///
/// # Errors
/// As [`make_variants`](crate::stage::variants::make_variants), or the plan's folder is already in use.
pub fn plan_variants(
    [root, run, destination]: [&Path; 3],
    instructions: &Instructions,
    (config, seed): (&MakeVariants, Seed),
    text_encoder: Option<&Path>,
    device: Value,
    surroundings: &Surroundings,
    out: &Path,
) -> Result<Plan, Error> {
    let stored = Stored {
        dataset: absolute(root)?,
        generator: absolute(run)?,
        instructions: instructions.clone(),
        config: *config,
        text_encoder: text_encoder.map(absolute).transpose()?,
        seed,
        device,
    };
    let making = stored.open(surroundings)?;
    made_before(destination, &making.plan_hash)?;
    let pieces = (0..making.num_batches()).map(|batch| {
        let name = format!("variants/batch-{batch}-of-{}", making.num_batches());
        let items = making.batch_len(batch) as u64;
        let none = std::iter::empty();
        Piece::new(&making.plan_hash, batch, name, items, none).with(0, &Detail { batch })
    });
    let (pieces, plan_hash) = (pieces.collect(), making.plan_hash.clone());
    write_plan(JOB, &stored, destination, pieces, plan_hash, out)
}

/// Opens the job of a plan.
///
/// # Errors
/// The generator or the dataset cannot be read, or have changed since the plan was made.
pub fn open_job(plan: &Plan, surroundings: Surroundings) -> Result<Box<dyn Job>, Failed> {
    let stored: Stored = plan.settings()?;
    let mut making = stored.open(&surroundings)?;
    if making.plan_hash != plan.hash() {
        let (dataset, generator) = (stored.dataset.display(), stored.generator.display());
        let what = format!("the dataset {dataset} or the generator {generator}");
        return Err(changed(&what));
    }
    let encoder = surroundings.text_encoder(stored.text_encoder.clone());
    surroundings.with_session(|session| making.prepare(&encoder, session))?;
    Ok(Box::new(Variants {
        making: Mutex::new(making),
        surroundings,
    }))
}

impl Job for Variants {
    fn make(&self, piece: &Piece, staging: &Staging) -> Result<Made, Failed> {
        let Detail { batch } = piece.detail()?;
        let making = in_turn(&self.making);
        let made = self
            .surroundings
            .with_session(|session| making.batch(batch, usize::MAX, session))?;
        let facts = table_facts(&making.skeleton, &making.plan_hash);
        let name = |table| ShardName {
            table,
            split: None,
            index: batch,
            of: making.num_batches(),
        };
        let motions = staging.write_shard(&name(MotionRow::TABLE), &made.motions, &facts)?;
        let pairs = staging.write_shard(&name(PairRow::TABLE), &made.pairs, &facts)?;
        Ok(Made::new(vec![motions, pairs], &made.counts))
    }

    fn sample(&self, piece: &Piece, count: u64) -> Result<u64, Failed> {
        let Detail { batch } = piece.detail()?;
        let making = in_turn(&self.making);
        let count = usize::try_from(count).unwrap_or(usize::MAX);
        let made = self
            .surroundings
            .with_session(|session| making.batch(batch, count, session))?;
        Ok(made.counts.bases as u64)
    }

    fn commit(
        &self,
        plan: &Plan,
        pieces: Vec<Finished>,
        options: &CommitOptions,
        _progress: &dyn Progress,
    ) -> Result<Committed, work::Error> {
        let transaction = plan.begin(options)?;
        let staging = plan.staging();
        let (made, quarantine) = Quarantine::of(pieces);
        let mut all = Candidates::default();
        for (piece, Made { files, notes }) in made {
            let [motions, pairs] = &files[..] else {
                return Err(work::Error::BadPlan {
                    path: plan.path().to_owned(),
                    reason: format!("piece {} has not two files", piece.name),
                });
            };
            all.motions
                .extend(read_rows::<MotionRow>(&staging.path(motions))?);
            all.pairs
                .extend(read_rows::<PairRow>(&staging.path(pairs))?);
            all.counts += work::notes::<VariantCounts>(plan, &piece, notes)?;
        }
        let making = in_turn(&self.making);
        let dataset = making
            .commit(transaction, &all, &quarantine)
            .map_err(of_commit)?;
        Ok(Committed {
            notes: json!({ "counts": all.counts }),
            ..plan.committed(dataset.manifest())
        })
    }
}
