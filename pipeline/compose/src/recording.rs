//! Recorded triplets and windows: the composer's training stream as a dataset, made shard by shard, by one process or
//! by many.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

use datasets_spec::dataset::{
    Commit, SHARD_ROWS, ShardName, Staging, Transaction, refuse_others, table_facts,
};
use datasets_spec::manifest::{FileEntry, plan_hash};
use datasets_spec::record::{NormalizerRow, QuarantineRow, TripletRow, WindowRow};
use datasets_spec::store::ByPath;
use datasets_spec::table::Row;
use datasets_spec::{Dataset, NoProgress, Progress, Seed, Skeleton, Split};
use kinematics::normalise::Normalizer;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use tables::chosen;
use work::{
    CommitOptions, Committed, Context, Draft, Failed, Finished, Job, Made, Piece, Quarantine,
    absolute,
};

use crate::{COMPOSED, ComposeConfig, Error, Stream, train_stream};

/// Name of the job.
pub const JOB: &str = "triplets";

/// Key of the fact with the [`Settings`] that the windows of a folder were recorded with, as JSON.
const SETTINGS_FACT: &str = "recorded_windows";

/// Kind of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// Triplets of whole clips.
    Triplets,
    /// Training windows, with their normaliser.
    Windows,
}

impl Kind {
    /// The table of the rows.
    pub fn table(self) -> &'static str {
        match self {
            Self::Triplets => TripletRow::TABLE,
            Self::Windows => WindowRow::TABLE,
        }
    }
}

/// Settings that a recording depends on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Kind of the recording.
    pub kind: Kind,
    /// Number of triplets or windows.
    pub count: u64,
    /// How edits are composed.
    pub config: ComposeConfig,
    /// Seed of the stream.
    pub seed: Seed,
    /// SQL condition on the composed clips.
    #[serde(default, rename = "where", skip_serializing_if = "Option::is_none")]
    pub condition: Option<String>,
}

/// The settings that the windows of a folder were recorded with; none if it was recorded by version 0.2 or earlier.
///
/// # Errors
/// The settings are of another version.
pub fn settings_of(windows: &Dataset) -> Result<Option<Settings>, serde_json::Error> {
    let fact = windows.manifest().facts.get(SETTINGS_FACT);
    fact.map(|text| serde_json::from_str(text)).transpose()
}

/// Whether the windows of a folder were recorded from the motions, masks and pairs that a dataset has now.
///
/// # Errors
/// The condition on the recorded clips cannot be evaluated, or the dataset cannot be read.
pub fn is_recorded_from(
    windows: &Dataset,
    settings: &Settings,
    dataset: &Dataset,
) -> Result<bool, Error> {
    let condition = settings.condition.as_deref().map(str::parse).transpose()?;
    let chosen = chosen(dataset, condition.as_ref())?;
    let plan = settings.plan_hash(&chosen.content_hash(&COMPOSED));
    Ok(windows.manifest().plan(settings.kind.table()) == plan)
}

impl Settings {
    fn plan_hash(&self, content_hash: &str) -> String {
        let inputs = (content_hash, &self.config, &self.seed, &self.count);
        plan_hash(self.kind.table(), &inputs)
    }
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Stored {
    dataset: PathBuf,
    content_hash: String,
    settings: Settings,
    /// The normaliser, fitted once when the plan is made.
    normalizer: Normalizer,
}

#[derive(Serialize, Deserialize)]
struct Detail {
    shard: u64,
}

struct Recording {
    settings: Settings,
    content_hash: String,
    stream: Stream,
    normalizer: Normalizer,
    skeleton: Skeleton,
    plan_hash: String,
}

/// Records the training stream of the dataset at `root` as a separate dataset. An existing recording of the same plan
/// is kept. A folder of windows states the settings ([`settings_of`]). Also returns the number of masks and pairs that
/// are shorter than a window, and are not used.
///
/// # Errors
/// The training split cannot be composed, or the folder cannot be written.
pub fn record(
    root: &Path,
    out: &Path,
    settings: &Settings,
    context: &Context<'_>,
) -> Result<(Dataset, usize), Error> {
    let recording = Recording::open(root, settings, None)?;
    let num_short = recording.stream.num_short();
    recording.refuse_others(out)?;
    let transaction = Transaction::begin(out, context.holder)?;
    if recording.is_in(&transaction) {
        drop(transaction);
        return Ok((Dataset::open(out)?, num_short));
    }
    let staging = transaction.staging(&recording.plan_hash);
    context
        .progress
        .begin(settings.kind.table(), Some(settings.count));
    let mut files = Vec::new();
    for piece in recording.pieces() {
        let shard = match work::staged(&staging, &piece.id)? {
            Some(stored) => stored.record.files,
            None => {
                let file = recording.make_shard(piece.number, &staging, context.progress)?;
                let made = Made::new(vec![file.clone()], &());
                work::keep(&staging, &piece, made)?;
                vec![file]
            }
        };
        files.extend(shard);
    }
    let dataset = recording.commit(transaction, &staging, files, Quarantine::default())?;
    let short = match num_short {
        0 => String::new(),
        count => format!("; {count} masks and pairs are shorter than a window and not used"),
    };
    context.progress.finish(&format!(
        "{} {} recorded{short}",
        settings.count,
        settings.kind.table()
    ));
    Ok((dataset, num_short))
}

/// Plans a recording for any number of processes. `out` is the folder of the plan.
///
/// # Errors
/// The training split cannot be composed, or the folder of the plan is occupied.
pub fn plan_recording(
    root: &Path,
    destination: &Path,
    settings: &Settings,
    out: &Path,
) -> Result<work::Plan, Error> {
    let recording = Recording::open(root, settings, None)?;
    recording.refuse_others(destination)?;
    let newest = Staging::newest(&ByPath, destination)?;
    let stored = Stored {
        dataset: absolute(root)?,
        content_hash: recording.content_hash.clone(),
        settings: settings.clone(),
        normalizer: recording.normalizer,
    };
    let draft = Draft {
        job: JOB,
        settings: serde_json::to_value(&stored).expect("settings are numbers and texts"),
        destination: destination.to_owned(),
        is_dataset: true,
        pieces: recording.pieces(),
        plan_hash: recording.plan_hash.clone(),
        base: Staging::base(&ByPath, destination, newest.as_ref())?,
    };
    Ok(draft.write(out, |_| Ok(()))?)
}

/// Opens the job of a plan.
pub fn open_job(plan: &work::Plan) -> Result<Box<dyn Job>, Failed> {
    let stored: Stored = plan.settings()?;
    let recording = Recording::open(&stored.dataset, &stored.settings, Some(stored.normalizer))?;
    if recording.content_hash != stored.content_hash || recording.plan_hash != plan.hash() {
        let path = stored.dataset;
        return Err(work::Error::SourceChanged { path }.into());
    }
    Ok(Box::new(recording))
}

impl Recording {
    /// Opens the stream. The normaliser is fitted to the training split unless it is given.
    fn open(
        root: &Path,
        settings: &Settings,
        normalizer: Option<Normalizer>,
    ) -> Result<Self, Error> {
        let Settings {
            config,
            seed,
            condition,
            ..
        } = settings;
        let condition = condition.as_deref().map(str::parse).transpose()?;
        let dataset = chosen(&Dataset::open(root)?, condition.as_ref())?;
        let content_hash = dataset.content_hash(&COMPOSED);
        let plan_hash = settings.plan_hash(&content_hash);
        let (stream, normalizer) = train_stream(&dataset, config, *seed, normalizer)?;
        Ok(Self {
            skeleton: dataset.skeleton()?,
            settings: settings.clone(),
            content_hash,
            stream,
            normalizer,
            plan_hash,
        })
    }

    /// Plan hash and row of the normaliser.
    fn normalizer(&self) -> (String, NormalizerRow) {
        let settings = self.settings.config.range_settings();
        let row = NormalizerRow::new(&self.normalizer, &settings, &self.plan_hash);
        let plan = plan_hash(NormalizerRow::TABLE, &(&self.plan_hash, &row.id));
        (plan, row)
    }

    /// The facts that the manifest states.
    fn facts(&self) -> BTreeMap<String, String> {
        let settings = serde_json::to_string(&self.settings);
        let settings = settings.expect("settings are numbers and texts");
        match self.settings.kind {
            Kind::Triplets => BTreeMap::new(),
            Kind::Windows => [(SETTINGS_FACT.to_owned(), settings)].into(),
        }
    }

    fn is_in(&self, transaction: &Transaction) -> bool {
        let Some(base) = transaction.base() else {
            return false;
        };
        let has_normalizer = match self.settings.kind {
            Kind::Triplets => true,
            Kind::Windows => base.plan(NormalizerRow::TABLE) == self.normalizer().0,
        };
        let states = |(name, value): (&String, &String)| base.facts.get(name) == Some(value);
        base.plan(self.settings.kind.table()) == self.plan_hash
            && has_normalizer
            && self.facts().iter().all(states)
    }

    fn num_shards(&self) -> u64 {
        self.settings.count.div_ceil(SHARD_ROWS).max(1)
    }

    fn rows_of(&self, shard: u64) -> Range<u64> {
        let end = self.settings.count.min((shard + 1) * SHARD_ROWS);
        shard * SHARD_ROWS..end
    }

    fn name(&self, shard: u64) -> ShardName {
        ShardName {
            table: self.settings.kind.table(),
            split: Some(Split::Train),
            index: shard as usize,
            of: self.num_shards() as usize,
        }
    }

    fn pieces(&self) -> Vec<Piece> {
        let piece = |shard: u64| {
            let (name, rows) = (self.name(shard), self.rows_of(shard));
            let name = format!("{}/{name}", name.table);
            let items = rows.end - rows.start;
            let none = std::iter::empty();
            let piece = Piece::new(&self.plan_hash, shard as usize, name, items, none);
            piece.with(0, &Detail { shard })
        };
        (0..self.num_shards()).map(piece).collect()
    }

    fn make_shard(
        &self,
        shard: u64,
        staging: &Staging,
        progress: &dyn Progress,
    ) -> Result<FileEntry, Error> {
        let facts = table_facts(&self.skeleton, &self.plan_hash);
        let (name, rows) = (self.name(shard), self.rows_of(shard));
        Ok(match self.settings.kind {
            Kind::Triplets => {
                staging.write_shard(&name, &self.triplets(rows, progress)?, &facts)?
            }
            Kind::Windows => staging.write_shard(&name, &self.windows(rows, progress)?, &facts)?,
        })
    }

    fn triplets(
        &self,
        numbers: Range<u64>,
        progress: &dyn Progress,
    ) -> Result<Vec<TripletRow>, Error> {
        let len = self.stream.epoch_len();
        let rows = numbers.into_par_iter().map(|number| {
            let row = self.stream.triplet(number / len, number % len)?.to_row();
            progress.advance(1);
            Ok(row)
        });
        rows.collect()
    }

    fn windows(
        &self,
        numbers: Range<u64>,
        progress: &dyn Progress,
    ) -> Result<Vec<WindowRow>, Error> {
        let mut rows = Vec::new();
        self.stream.for_each_recorded(numbers, |row, _, _| {
            rows.push(row);
            progress.advance(1);
        })?;
        Ok(rows)
    }

    /// Refuses a folder that holds other tables than those of recordings.
    fn refuse_others(&self, out: &Path) -> Result<(), Error> {
        let own = [
            TripletRow::TABLE,
            WindowRow::TABLE,
            NormalizerRow::TABLE,
            QuarantineRow::TABLE,
        ];
        Ok(refuse_others(out, &own, self.settings.kind.table())?)
    }

    fn commit(
        &self,
        transaction: Transaction,
        staging: &Staging,
        mut files: Vec<FileEntry>,
        quarantine: Quarantine,
    ) -> Result<Dataset, Error> {
        let facts = table_facts(&self.skeleton, &self.plan_hash);
        transaction.adopt(staging, files.iter_mut())?;
        let mut tables = BTreeMap::new();
        let mut plans = BTreeMap::new();
        match self.settings.kind {
            Kind::Triplets => {
                // Tables that are read by split need a file for each split.
                for split in [Split::Val, Split::Test] {
                    let none: [TripletRow; 0] = [];
                    files.extend(transaction.write_shards(Some(split), &none, &facts)?);
                }
            }
            Kind::Windows => {
                let (plan, row) = self.normalizer();
                let facts = table_facts(&self.skeleton, &plan);
                let normalizer = transaction.write_shards(None, &[row], &facts)?;
                tables.insert(NormalizerRow::TABLE.to_owned(), normalizer);
                plans.insert(NormalizerRow::TABLE.to_owned(), plan);
            }
        }
        tables.insert(self.settings.kind.table().to_owned(), files);
        let accounting = quarantine.write(&transaction, &mut tables, &facts)?;
        Ok(transaction.commit(Commit {
            tables,
            plan_hash: self.plan_hash.clone(),
            plans,
            skeleton: self.skeleton.clone(),
            accounting,
            facts: self.facts(),
            ..Commit::default()
        })?)
    }
}

impl Job for Recording {
    fn make(&self, piece: &Piece, staging: &Staging) -> Result<Made, Failed> {
        let Detail { shard } = piece.detail()?;
        let file = self.make_shard(shard, staging, &NoProgress)?;
        Ok(Made::new(vec![file], &()))
    }

    fn sample(&self, piece: &Piece, count: u64) -> Result<u64, Failed> {
        let Detail { shard } = piece.detail()?;
        let rows = self.rows_of(shard);
        let rows = rows.start..rows.end.min(rows.start + count);
        let made = match self.settings.kind {
            Kind::Triplets => self.triplets(rows, &NoProgress)?.len(),
            Kind::Windows => self.windows(rows, &NoProgress)?.len(),
        };
        Ok(made as u64)
    }

    fn commit(
        &self,
        plan: &work::Plan,
        pieces: Vec<Finished>,
        options: &CommitOptions,
        _progress: &dyn Progress,
    ) -> Result<Committed, work::Error> {
        let transaction = plan.begin(options)?;
        let (made, quarantine) = Quarantine::of(pieces);
        let files = made.into_iter().flat_map(|(_, made)| made.files).collect();
        let dataset = self.commit(transaction, &plan.staging(), files, quarantine)?;
        Ok(plan.committed(dataset.manifest()))
    }
}
