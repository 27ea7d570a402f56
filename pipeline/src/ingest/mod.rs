//! From folders of motion files to a committed `motions` dataset.
//!
//! The run is planned before any work: every file is listed and hashed, its split drawn and its
//! shard fixed, so the result depends neither on the order in which threads finish nor on how often
//! the run was interrupted. A bad file becomes a row of the `quarantine` table and the rest goes on.

use std::cell::Cell;
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use datasets_spec::dataset::{Commit, ShardName};
use datasets_spec::manifest::{Accounting, FileEntry};
use datasets_spec::record::{HumanMl3dRow, MarkerRow, MaskRow, MotionRow, PairRow, QuarantineRow};
use datasets_spec::store::Store;
use datasets_spec::table::{Row, SCHEMA_VERSION};
use datasets_spec::{
    BlendMask, BodyPart, Dataset, Fps, MASK_DEF_VERSION, Motion, MotionId, Progress, Resample,
    Seed, Skeleton, Split, Transaction,
};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::check::{FLAG_CAPTION_OUTSIDE, FLAG_NO_CAPTION, FLAG_POOR_FIT, Teleports, check_with};
use crate::clip::{EditOf, Markers, Outcome, Rejected, SourceClip, SourceMask};
use crate::feature::{humanml3d, smpl_body};
use crate::pairs::{ListedPairs, PairList, RefusedLine, names_of, originals, style_group};
use crate::source::{
    Entry, Files, Format, ReadOptions, Recognised, Release, find_releases, keys_in, labels,
    read_clip, recognise, refuse_pointer,
};

/// Version of the rules by which files become rows. It is part of every plan, so a dataset made by
/// older rules is never continued by newer ones.
const INGEST_VERSION: u32 = 3;
/// Source items of a shard: few enough that a shard's motions fit in memory many times over.
const SHARD_SOURCES: usize = 256;
/// Largest file read at once, in bytes; releases that keep many motions in a file have rules of
/// their own.
const MAX_FILE_LEN: u64 = 4 << 30;
/// Mean distance in metres between source and stored joints that is worth a flag: retargeted
/// captures of people measure 0.01 to 0.04.
const FIT_ERROR_LIMIT_M: f32 = 0.05;
/// Bytes looked at to recognise a file.
const HEAD_BYTES: usize = 512;

/// Fact of a manifest: the seed its splits were drawn with.
const SEED_FACT: &str = "seed";
/// Fact of a manifest: what a reader should know about its splits.
pub const REMARKS_FACT: &str = "remarks";
/// Fact of a manifest: lines of the list of pairs that gave none, as JSON.
const REFUSED_PAIRS_FACT: &str = "refused_pairs";

/// How files become rows.
#[derive(Clone, Debug)]
pub struct IngestOptions {
    /// Rate to store at; none keeps each clip's own.
    pub fps: Option<Fps>,
    /// How clips are brought to that rate.
    pub resample: Resample,
    /// Accept this format only; files of other formats are skipped.
    pub format: Option<Format>,
    /// Seed of the splits, where a dataset is made; one that is there keeps the seed it was made
    /// with.
    pub seed: Seed,
    /// A list of style pairs, by whose lines a styled clip gets the split of its original.
    pub pairs: Option<PairList>,
    /// Licence tag for clips whose source declares none.
    pub license: Option<String>,
    /// How files are read: the skeleton the motions are posed on, and joint maps of the user.
    pub read: ReadOptions,
    /// HumanML3D's `index.csv`, to cut its clips from the AMASS files among the sources.
    pub humanml3d_index: Option<PathBuf>,
    /// Compute the features of the HumanML3D recipe and store them beside the motions.
    pub humanml3d_features: bool,
    /// What becomes of motions with jumps.
    pub teleports: Teleports,
    /// Replace what the folder holds by another plan's motions, as a new version of the dataset.
    pub new_version: bool,
}

impl Default for IngestOptions {
    fn default() -> Self {
        Self {
            fps: Some(Fps::STORE),
            resample: Resample::Exact,
            format: None,
            seed: Seed(0),
            pairs: None,
            license: None,
            read: ReadOptions::default(),
            humanml3d_index: None,
            humanml3d_features: false,
            teleports: Teleports::default(),
            new_version: false,
        }
    }
}

/// What a run did.
#[derive(Clone, Debug)]
pub struct IngestReport {
    /// The committed dataset.
    pub dataset: Dataset,
    /// What became of the source items: a file, or one of the motions of a file that holds several.
    pub accounting: Accounting,
    /// Files the items came from.
    pub files: u64,
    /// Pairs that were dropped because one of their motions is not in the dataset.
    pub dropped_pairs: u64,
    /// Lines of the list of pairs that no pair was made of.
    pub refused_pairs: Vec<RefusedLine>,
    /// What is worth knowing about the splits; what concerns the dataset rather than this run is
    /// recorded as [`REMARKS_FACT`].
    pub remarks: Vec<String>,
    /// The rejected sources.
    pub quarantine: Vec<QuarantineRow>,
    /// Skipped sources by reason.
    pub skipped: BTreeMap<String, u64>,
    /// Shards taken over from an interrupted run of the same plan.
    pub resumed_shards: usize,
    /// Whether the dataset was already complete and nothing was done.
    pub already_complete: bool,
}

/// A source file in the plan.
#[derive(Clone, Debug)]
struct Source {
    path: PathBuf,
    hash: Result<String, String>,
    head: Vec<u8>,
}

/// What a shard needs at the commit beside its file.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct ShardNotes {
    quarantine: Vec<StagedRejection>,
    skipped: BTreeMap<String, u64>,
    /// Files of other tables that were written with the shard.
    beside: Vec<(String, FileEntry)>,
    /// Items whose only row is one of `markers`.
    markers_only: u64,
    ingested: Vec<String>,
    pairs: Vec<StagedPair>,
    masks: Vec<StagedMask>,
}

/// A pair, waiting for its other motion.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct StagedPair {
    source: String,
    kind: String,
    source_id: String,
    target_id: String,
    style: Option<String>,
    parts: Vec<String>,
    instruction: String,
}

/// A mask that came with a motion.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct StagedMask {
    source: String,
    motion_id: String,
    parts: Vec<String>,
    text: String,
}

/// A quarantine row in the form it is staged in.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct StagedRejection {
    path: String,
    source_hash: String,
    code: String,
    reason: String,
    byte_offset: Option<u64>,
    stage: String,
}

impl From<StagedRejection> for QuarantineRow {
    fn from(r: StagedRejection) -> Self {
        Self {
            path: r.path,
            source_hash: r.source_hash,
            code: r.code,
            reason: r.reason,
            byte_offset: r.byte_offset,
            stage: r.stage,
        }
    }
}

/// Reads every motion under `sources` and commits them as a dataset at `out`.
///
/// Run again after an interruption it continues; run again after success it changes nothing.
/// `holder` is what another run is told while this one holds the lock.
///
/// # Errors
/// A source does not exist, there is no file at all, the dataset is locked or was made by another
/// plan, or writing fails. What is wrong with single files is reported, not returned.
pub fn ingest(
    sources: &[PathBuf],
    out: &Path,
    options: &IngestOptions,
    holder: &str,
    progress: &dyn Progress,
) -> Result<IngestReport, Error> {
    // A run with nothing to read leaves no folder behind.
    list_files(sources)?;
    let transaction = Transaction::begin(out, holder)?;
    ingest_in(transaction, sources, options, progress)
}

/// [`ingest`] within a transaction that has begun.
///
/// # Errors
/// As [`ingest`].
pub fn ingest_in(
    transaction: Transaction,
    sources: &[PathBuf],
    options: &IngestOptions,
    progress: &dyn Progress,
) -> Result<IngestReport, Error> {
    let (seed, kept_seed) = split_seed(&transaction, options.seed);
    let options = &IngestOptions {
        seed,
        read: ReadOptions {
            // The published stride rule counts the file's own frames.
            rate: options.fps.filter(|_| options.resample == Resample::Exact),
            ..options.read.clone()
        },
        ..options.clone()
    };
    let plan = Plan::make(transaction.store(), sources, options, progress)?;
    let plan_hash = plan.hash(options);
    let recorded = transaction
        .base()
        .and_then(|base| base.plans.get(MotionRow::TABLE).cloned());
    match recorded {
        Some(recorded) if recorded == plan_hash && !plan.may_read_more_now(&transaction) => {
            let out = transaction.root().to_owned();
            transaction.finish()?;
            return already_complete(&out, &plan, kept_seed);
        }
        Some(recorded) if recorded != plan_hash && !options.new_version => {
            return Err(Error::Spec(datasets_spec::Error::OtherPlan {
                path: transaction.root().to_owned(),
                recorded,
                now: plan_hash,
            }));
        }
        _ => {}
    }

    let shards = plan.shards(options);
    let mut tally = Tally {
        skipped: plan.skipped.clone(),
        quarantine: plan.rejected.clone(),
        ..Tally::default()
    };
    let total: usize = shards.iter().map(|(_, items)| items.len()).sum();
    progress.begin("ingest", Some(total as u64));
    let facts = shard_facts(options, &plan_hash);
    for (name, items) in &shards {
        let staged = transaction.staged::<ShardNotes>(&plan_hash, name)?;
        let (entry, notes) = match staged {
            Some(done) if transaction.holds(done.1.beside.iter().map(|(_, file)| file))? => {
                tally.resumed_shards += 1;
                progress.advance(items.len() as u64);
                done
            }
            _ => {
                let done = plan.make_shard(&transaction, name, items, options, &facts, progress)?;
                transaction.stage(&plan_hash, name, &done.0, &done.1)?;
                done
            }
        };
        tally.take(entry, notes);
    }
    tally.quarantine.sort_by(|a, b| a.path.cmp(&b.path));

    let accounting = tally.accounting(plan.num_items());
    progress.finish(&format!(
        "{} sources: {} ingested, {} quarantined, {} skipped",
        accounting.sources, accounting.ingested, accounting.quarantined, accounting.skipped
    ));
    let (mut pairs, dropped_pairs) = tally.pairs(&shards);
    let listed = tally.listed_pairs(&shards, options.pairs.as_ref(), &pairs);
    pairs.extend(listed.rows);
    pairs.sort_by(|a, b| a.id.cmp(&b.id));
    let masks = tally.masks(&shards);
    let quarantine = write_table(&transaction, None, &tally.quarantine, &facts)?;
    let mut tables = tally.tables;
    tables.insert(QuarantineRow::TABLE.to_owned(), quarantine);
    if !pairs.is_empty() {
        let files = write_table(
            &transaction,
            Some(|row: &PairRow| row.split),
            &pairs,
            &facts,
        )?;
        tables.insert(PairRow::TABLE.to_owned(), files);
    }
    if !masks.is_empty() {
        let files = write_table(
            &transaction,
            Some(|row: &MaskRow| row.split),
            &masks,
            &facts,
        )?;
        tables.insert(MaskRow::TABLE.to_owned(), files);
    }
    let mut recorded = BTreeMap::from([
        (SEED_FACT.to_owned(), options.seed.0.to_string()),
        ("fps".to_owned(), rate_name(options)),
        ("files".to_owned(), plan.files.len().to_string()),
        ("dropped_pairs".to_owned(), dropped_pairs.to_string()),
        ("skipped".to_owned(), describe(&tally.skipped)),
    ]);
    if !plan.remarks.is_empty() {
        recorded.insert(REMARKS_FACT.to_owned(), plan.remarks.join("; "));
    }
    if !listed.refused.is_empty() {
        let lines = serde_json::to_string(&listed.refused).expect("numbers and texts serialise");
        recorded.insert(REFUSED_PAIRS_FACT.to_owned(), lines);
    }
    let dataset = transaction.commit(Commit {
        tables,
        plan_hash,
        skeleton: options.read.skeleton.clone(),
        accounting: Some(accounting.clone()),
        facts: recorded,
        fresh: true,
    })?;
    Ok(IngestReport {
        dataset,
        accounting,
        files: plan.files.len() as u64,
        dropped_pairs,
        refused_pairs: listed.refused,
        remarks: plan.remarks.into_iter().chain(kept_seed).collect(),
        quarantine: tally.quarantine,
        skipped: tally.skipped,
        resumed_shards: tally.resumed_shards,
        already_complete: false,
    })
}

fn already_complete(
    out: &Path,
    plan: &Plan,
    kept_seed: Option<String>,
) -> Result<IngestReport, Error> {
    let dataset = Dataset::open(out)?;
    let facts = &dataset.manifest().facts;
    let dropped = facts.get("dropped_pairs");
    let refused = facts.get(REFUSED_PAIRS_FACT);
    Ok(IngestReport {
        refused_pairs: refused
            .and_then(|lines| serde_json::from_str(lines).ok())
            .unwrap_or_default(),
        remarks: plan.remarks.iter().cloned().chain(kept_seed).collect(),
        accounting: dataset.manifest().accounting.clone(),
        files: plan.files.len() as u64,
        dropped_pairs: dropped.and_then(|count| count.parse().ok()).unwrap_or(0),
        quarantine: dataset.read(None)?,
        skipped: BTreeMap::new(),
        resumed_shards: 0,
        already_complete: true,
        dataset,
    })
}

/// The seed of the splits, and a remark if it is not the one asked for: a dataset that is there
/// keeps its own, so that no clip moves.
fn split_seed(transaction: &Transaction, asked: Seed) -> (Seed, Option<String>) {
    let recorded = transaction
        .base()
        .filter(|base| base.plans.contains_key(MotionRow::TABLE))
        .and_then(|base| base.facts.get(SEED_FACT)?.parse().ok().map(Seed));
    match recorded {
        Some(seed) if seed != asked => {
            let remark = format!(
                "the splits were drawn with seed {} when the dataset was made and stay as they are; \
                 ingest into a new folder to draw them with seed {}",
                seed.0, asked.0
            );
            (seed, Some(remark))
        }
        Some(seed) => (seed, None),
        None => (asked, None),
    }
}

fn rate_name(options: &IngestOptions) -> String {
    options
        .fps
        .map_or("native".to_owned(), |fps| fps.get().to_string())
}

fn shard_facts(options: &IngestOptions, plan_hash: &str) -> [(&'static str, String); 6] {
    [
        ("skeleton", options.read.skeleton.name().to_owned()),
        ("fps", rate_name(options)),
        ("plan_hash", plan_hash.to_owned()),
        ("units", "metres, radians, seconds".to_owned()),
        ("up_axis", "y".to_owned()),
        ("forward_axis", "z".to_owned()),
    ]
}

/// Writes a table that is small enough to be held whole, a shard for each split that has rows.
fn write_table<R: Row>(
    transaction: &Transaction,
    split_of: Option<fn(&R) -> Split>,
    rows: &[R],
    facts: &[(&str, String)],
) -> Result<Vec<FileEntry>, Error> {
    let groups: Vec<(Option<Split>, Vec<R>)> = match split_of {
        None => vec![(None, rows.to_vec())],
        Some(split_of) => Split::ALL
            .into_iter()
            .map(|split| {
                let rows = rows.iter().filter(|row| split_of(row) == split);
                (Some(split), rows.cloned().collect::<Vec<R>>())
            })
            .filter(|(_, rows)| !rows.is_empty())
            .collect(),
    };
    let mut files = Vec::new();
    for (split, rows) in groups {
        let name = ShardName {
            table: R::TABLE,
            split,
            index: 0,
            of: 1,
        };
        files.push(transaction.write_shard(&name, &rows, facts)?);
    }
    Ok(files)
}

/// What the shards of a run add up to.
#[derive(Default)]
struct Tally {
    tables: BTreeMap<String, Vec<FileEntry>>,
    quarantine: Vec<QuarantineRow>,
    skipped: BTreeMap<String, u64>,
    ingested: BTreeSet<String>,
    markers_only: u64,
    pairs: Vec<StagedPair>,
    masks: Vec<StagedMask>,
    resumed_shards: usize,
}

impl Tally {
    fn take(&mut self, entry: FileEntry, notes: ShardNotes) {
        let motions = self.tables.entry(MotionRow::TABLE.to_owned()).or_default();
        motions.push(entry);
        for (table, file) in notes.beside {
            self.tables.entry(table).or_default().push(file);
        }
        for (reason, count) in notes.skipped {
            *self.skipped.entry(reason).or_default() += count;
        }
        let rejected = notes.quarantine.into_iter().map(QuarantineRow::from);
        self.quarantine.extend(rejected);
        self.ingested.extend(notes.ingested);
        self.markers_only += notes.markers_only;
        self.pairs.extend(notes.pairs);
        self.masks.extend(notes.masks);
    }

    fn accounting(&self, num_items: u64) -> Accounting {
        let mut codes = BTreeMap::new();
        for row in &self.quarantine {
            *codes.entry(row.code.clone()).or_default() += 1;
        }
        Accounting {
            sources: num_items,
            ingested: self.ingested.len() as u64 + self.markers_only,
            quarantined: self.quarantine.len() as u64,
            skipped: self.skipped.values().sum(),
            codes,
        }
    }

    /// The pairs whose motions are both in the dataset and of one split, and how many are not.
    fn pairs(&self, shards: &Shards) -> (Vec<PairRow>, u64) {
        let splits = splits_of(shards);
        let mut dropped = 0;
        let mut rows = Vec::new();
        for pair in &self.pairs {
            let ids = [&pair.source_id, &pair.target_id];
            let both = ids.iter().all(|id| self.ingested.contains(*id));
            let split = splits.get(pair.target_id.as_str());
            let one_split = split.is_some() && splits.get(pair.source_id.as_str()) == split;
            let parsed = ids.map(|id| MotionId::parse(id));
            let ([Ok(source_id), Ok(target_id)], Some(split), true) =
                (parsed, split, both && one_split)
            else {
                dropped += 1;
                continue;
            };
            rows.push(PairRow {
                id: format!("{}+{}", pair.source_id, pair.target_id),
                split: *split,
                source: pair.source.clone(),
                kind: pair.kind.clone(),
                source_id,
                target_id,
                style: pair.style.clone(),
                parts: pair.parts.clone(),
                instruction: pair.instruction.clone(),
            });
        }
        rows.sort_by(|a, b| a.id.cmp(&b.id));
        (rows, dropped)
    }

    /// The pairs of a list whose motions are both in the dataset, beside those of the releases.
    fn listed_pairs(
        &self,
        shards: &Shards,
        list: Option<&PairList>,
        known: &[PairRow],
    ) -> ListedPairs {
        let Some(list) = list else {
            return ListedPairs::default();
        };
        let motions: BTreeMap<MotionId, Split> = splits_of(shards)
            .into_iter()
            .filter(|(id, _)| self.ingested.contains(*id))
            .filter_map(|(id, split)| Some((MotionId::parse(id).ok()?, split)))
            .collect();
        list.pairs(&motions, known)
    }

    fn masks(&self, shards: &Shards) -> Vec<MaskRow> {
        let splits = splits_of(shards);
        let mut rows: Vec<MaskRow> = Vec::new();
        for (number, mask) in self.masks.iter().enumerate() {
            let parts: Vec<BodyPart> = mask
                .parts
                .iter()
                .filter_map(|part| part.parse().ok())
                .collect();
            let (Ok(motion_id), Some(split)) = (
                MotionId::parse(&mask.motion_id),
                splits.get(mask.motion_id.as_str()),
            ) else {
                continue;
            };
            let blend = BlendMask::of_parts(&parts);
            rows.push(MaskRow {
                id: format!("{}/{}/{number}", mask.motion_id, mask.parts.join("+")),
                motion_id,
                split: *split,
                parts: mask.parts.clone(),
                hard_joints: blend.hard().names(),
                soft_joints: blend.soft().names(),
                mask_def_version: MASK_DEF_VERSION,
                text: mask.text.clone(),
                text_origin: "imported".to_owned(),
                author: mask.source.clone(),
            });
        }
        rows
    }
}

fn splits_of<'a>(shards: &'a Shards<'a>) -> BTreeMap<&'a str, Split> {
    shards
        .iter()
        .flat_map(|(_, items)| items)
        .filter_map(|item| Some((item.id.as_ref().ok()?.as_str(), item.split)))
        .collect()
}

fn describe(skipped: &BTreeMap<String, u64>) -> String {
    let parts: Vec<String> = skipped
        .iter()
        .map(|(reason, count)| format!("{count} {reason}"))
        .collect();
    parts.join("; ")
}

/// Everything a run will do, known before any motion is read.
struct Plan {
    files: Files,
    sources: BTreeMap<String, Source>,
    releases: Vec<Box<dyn Release>>,
    items: Vec<Planned>,
    /// Files without a motion, by reason.
    skipped: BTreeMap<String, u64>,
    /// Files that were found broken while planning.
    rejected: Vec<QuarantineRow>,
    /// What a reader of the dataset should know about its splits.
    remarks: Vec<String>,
}

/// A motion to be read.
struct Planned {
    entry: Entry,
    format: Format,
    /// Which release reads it; none for files that stand alone.
    release: Option<usize>,
    /// What stands before the ids of the release, so that they are not those of another.
    prefix: String,
    /// What decides the split together with other clips; none for a clip that decides alone.
    group: Option<String>,
}

impl Planned {
    fn full_id(&self) -> String {
        format!("{}{}", self.prefix, self.entry.id)
    }

    /// Id of the source clip in the dataset, without crop or mirror suffix.
    fn clip(&self) -> String {
        let id = self.full_id();
        MotionId::parse(&id).map_or(id, |id| id.source_clip().to_owned())
    }

    /// What decides the split where no list is published.
    fn split_key(&self) -> String {
        // Two releases of one clip fall into one split, whatever stands before their ids.
        let clip = || {
            let own_id = MotionId::parse(&self.entry.id);
            own_id.map_or(self.entry.id.clone(), |id| id.source_clip().to_owned())
        };
        self.group.clone().unwrap_or_else(clip)
    }
}

/// A motion on its way into a shard.
struct Item<'a> {
    entry: &'a Entry,
    prefix: &'a str,
    format: Format,
    release: Option<usize>,
    split: Split,
    id: Result<MotionId, String>,
}

type Shards<'a> = Vec<(ShardName, Vec<Item<'a>>)>;

impl Plan {
    fn make(
        store: Arc<dyn Store>,
        paths: &[PathBuf],
        options: &IngestOptions,
        progress: &dyn Progress,
    ) -> Result<Self, Error> {
        let listing = list_files(paths)?;
        let mut skipped: BTreeMap<String, u64> = BTreeMap::new();
        for reason in listing.special {
            *skipped.entry(reason).or_default() += 1;
        }
        let files = Files::on(store, listing.files);
        let sources = hash_sources(&files, progress);
        let mut plan = Self {
            releases: find_releases(&files, options.humanml3d_index.as_deref())?,
            files,
            sources,
            items: Vec::new(),
            skipped,
            rejected: Vec::new(),
            remarks: Vec::new(),
        };
        let claimed = plan.take_releases(options);
        plan.take_single_files(&claimed, options);
        plan.group_styles();
        if let Some(list) = &options.pairs {
            plan.follow_originals(list);
        }
        Ok(plan)
    }

    /// Plans the motions of the releases, and returns the files that are theirs.
    fn take_releases(&mut self, options: &IngestOptions) -> BTreeSet<String> {
        let mut claimed = BTreeSet::new();
        let mut taken = BTreeSet::new();
        for (index, release) in self.releases.iter().enumerate() {
            let format = release.format();
            let prefix = prefix_of(release.as_ref(), &taken);
            let ids = release.entries().iter();
            taken.extend(ids.map(|entry| format!("{prefix}{}", entry.id)));
            claimed.extend(release.entries().iter().map(|entry| entry.file.clone()));
            if options.format.is_some_and(|only| only != format) {
                let files: BTreeSet<&str> =
                    release.entries().iter().map(|e| e.file.as_str()).collect();
                let reason = format!("{} file, not asked for", format.as_str());
                *self.skipped.entry(reason).or_default() += files.len() as u64;
            } else {
                let entries = release.entries().iter().cloned();
                self.items.extend(entries.map(|entry| Planned {
                    entry,
                    format,
                    release: Some(index),
                    prefix: prefix.clone(),
                    group: None,
                }));
                self.remarks.extend(release.remarks().iter().cloned());
            }
            for (file, reason) in release.passed_over() {
                if !claimed.insert(file.clone()) {
                    continue;
                }
                match unreadable(&self.sources, file) {
                    Some(row) => self.rejected.push(row),
                    None => *self.skipped.entry(reason.clone()).or_default() += 1,
                }
            }
            for (file, rejected) in release.rejected() {
                if claimed.insert(file.clone()) {
                    let hash = source_hash(&self.sources, file);
                    let row = staged_rejection(file, "", hash, rejected.clone());
                    self.rejected.push(row.into());
                }
            }
        }
        claimed
    }

    /// Plans every file that no release claims.
    fn take_single_files(&mut self, claimed: &BTreeSet<String>, options: &IngestOptions) {
        for (relative, source) in &self.sources {
            if claimed.contains(relative) {
                continue;
            }
            // What a file is that cannot be read is not known, whatever it is called.
            if let Some(row) = unreadable(&self.sources, relative) {
                self.rejected.push(row);
                continue;
            }
            if let Err(rejected) = refuse_pointer(&source.head) {
                let hash = source.hash.clone().unwrap_or_default();
                let row = staged_rejection(relative, "", hash, rejected);
                self.rejected.push(row.into());
                continue;
            }
            let format = match recognise(Path::new(relative), &source.head) {
                Recognised::Motion(format) => format,
                Recognised::NotMotion { reason } => {
                    *self.skipped.entry(reason).or_default() += 1;
                    continue;
                }
            };
            if options.format.is_some_and(|only| only != format) {
                let reason = format!("{} file, not asked for", format.as_str());
                *self.skipped.entry(reason).or_default() += 1;
                continue;
            }
            for key in keys_of(format, &source.path) {
                self.items.push(Planned {
                    entry: Entry {
                        file: relative.clone(),
                        id: String::new(),
                        key,
                        split: None,
                        mirrored_of: None,
                    },
                    format,
                    release: None,
                    prefix: String::new(),
                    group: None,
                });
            }
        }
        // Files that differ in their extension alone keep it in their id.
        let mut seen = BTreeSet::new();
        let mut twice = BTreeSet::new();
        let single = |item: &&Planned| item.release.is_none();
        for item in self.items.iter().filter(single) {
            if seen.insert(item.entry.file.clone()) {
                let stem = without_extension(&item.entry.file).to_owned();
                if !seen.insert(stem.clone()) {
                    twice.insert(stem);
                }
            }
        }
        for item in self.items.iter_mut().filter(|item| item.release.is_none()) {
            let entry = &mut item.entry;
            let stem = without_extension(&entry.file);
            let name = if twice.contains(stem) {
                &entry.file
            } else {
                stem
            };
            entry.id = match entry.key.as_str() {
                "" => name.to_owned(),
                key => format!("{name}#{key}"),
            };
        }
    }

    /// Gives single files with labels of action and style the group of their original. A file whose
    /// labels cannot be read is rejected: without them it might land in another split.
    fn group_styles(&mut self) {
        let Self { files, items, .. } = self;
        let unreadable: Vec<Option<Rejected>> = items
            .par_iter_mut()
            .map(|item| {
                if item.release.is_some() {
                    return None;
                }
                let file = &item.entry.file;
                let folder = files.path(file).and_then(Path::parent);
                let folder = folder.unwrap_or(Path::new("."));
                let failed = Cell::new(None);
                let companions = |name: &str| match files.read_beside(&folder.join(name)) {
                    Ok(bytes) => bytes,
                    Err(rejected) => {
                        failed.set(Some(rejected));
                        None
                    }
                };
                let found = labels::action_and_style(Path::new(file), &companions);
                item.group = found.map(|(action, style)| style_group(file, &action, &style));
                failed.into_inner()
            })
            .collect();
        let mut unreadable = unreadable.into_iter();
        let (sources, rejected) = (&self.sources, &mut self.rejected);
        self.items.retain(|item| match unreadable.next().flatten() {
            None => true,
            Some(reason) => {
                let Entry { file, key, .. } = &item.entry;
                let row = staged_rejection(file, key, source_hash(sources, file), reason);
                rejected.push(row.into());
                false
            }
        });
    }

    /// Gives the styled clips of a list, with their copies and crops, the splits of their originals.
    /// A published split stays as it is.
    fn follow_originals(&mut self, list: &PairList) {
        let clips: BTreeMap<String, String> = self
            .items
            .iter()
            .map(|item| (item.full_id(), item.clip()))
            .collect();
        let clip_of = |name| names_of(name).find_map(|name| clips.get(name).map(String::as_str));
        let pairs = list.clips().filter_map(|(styled, original)| {
            let (styled, original) = (clip_of(styled)?, clip_of(original)?);
            (styled != original).then_some((styled, original))
        });
        let originals = originals(pairs);
        let wanted: BTreeSet<&str> = originals.values().copied().collect();
        let mut deciding: BTreeMap<&str, (Option<Split>, String)> = BTreeMap::new();
        for item in &self.items {
            if let Some(&clip) = wanted.get(item.clip().as_str()) {
                let key = || (None, item.split_key());
                let (split, _) = deciding.entry(clip).or_insert_with(key);
                *split = split.or(item.entry.split);
            }
        }
        for item in &mut self.items {
            let original = originals.get(item.clip().as_str());
            if let Some((split, key)) = original.and_then(|original| deciding.get(original)) {
                item.entry.split = item.entry.split.or(*split);
                item.group = Some(key.clone());
            }
        }
    }

    /// Source items: motions, and files without one.
    fn num_items(&self) -> u64 {
        let skipped: u64 = self.skipped.values().sum();
        self.items.len() as u64 + self.rejected.len() as u64 + skipped
    }

    fn hash(&self, options: &IngestOptions) -> String {
        let mut hasher = blake3::Hasher::new();
        let settings = format!(
            "{INGEST_VERSION} {SCHEMA_VERSION} {:?} {:?} {:?} {} {:?} {:?} {:?} {}",
            options.fps.map(Fps::get),
            options.resample,
            options.format,
            options.seed.0,
            options.license,
            options.read,
            options.teleports,
            if options.humanml3d_features {
                humanml3d::RECIPE
            } else {
                ""
            },
        );
        let mut take = |part: &str| {
            hasher.update(&(part.len() as u64).to_le_bytes());
            hasher.update(part.as_bytes());
        };
        take(&settings);
        for (relative, source) in &self.sources {
            take(relative);
            take(source.hash.as_deref().unwrap_or(""));
        }
        // Which motions there are can depend on more than the files, such as an index elsewhere.
        for item in &self.items {
            take(item.format.as_str());
            take(&item.entry.file);
            take(&item.entry.key);
            take(&item.prefix);
            take(&item.entry.id);
            take(item.entry.split.map_or("", Split::as_str));
            // Datasets without styles keep the plans they had before there were groups.
            if let Some(group) = &item.group {
                take(group);
            }
        }
        if let Some(list) = &options.pairs {
            take(list.hash());
        }
        hasher.finalize().to_hex().to_string()
    }

    /// Whether the finished run of this plan failed to read a file that can be read now, so that
    /// it is worth doing again.
    fn may_read_more_now(&self, transaction: &Transaction) -> bool {
        let Some(base) = transaction.base() else {
            return false;
        };
        let failed = base.accounting.codes.get("E-IO").copied().unwrap_or(0);
        let unreadable = self.sources.values().filter(|source| source.hash.is_err());
        failed > unreadable.count() as u64
    }

    /// Deals the motions into shards by split.
    fn shards(&self, options: &IngestOptions) -> Shards<'_> {
        let mut by_split: BTreeMap<Split, Vec<Item>> = BTreeMap::new();
        let mut seen = BTreeSet::new();
        for planned in &self.items {
            let entry = &planned.entry;
            let full_id = planned.full_id();
            let id = MotionId::parse(&full_id)
                .map_err(|error| error.to_string())
                .and_then(|id| match seen.insert(full_id) {
                    true => Ok(id),
                    false => Err(format!("another motion has the id {id} already")),
                });
            let split = entry
                .split
                .unwrap_or_else(|| Split::assign(&planned.split_key(), options.seed));
            by_split.entry(split).or_default().push(Item {
                entry,
                prefix: &planned.prefix,
                format: planned.format,
                release: planned.release,
                split,
                id,
            });
        }
        let mut shards = Vec::new();
        for (split, mut items) in by_split {
            let of = items.len().div_ceil(SHARD_SOURCES);
            for index in 0..of {
                let rest = items.split_off(items.len().min(SHARD_SOURCES));
                let name = ShardName {
                    table: MotionRow::TABLE,
                    split: Some(split),
                    index,
                    of,
                };
                shards.push((name, std::mem::replace(&mut items, rest)));
            }
        }
        shards
    }

    fn make_shard(
        &self,
        transaction: &Transaction,
        name: &ShardName,
        items: &[Item],
        options: &IngestOptions,
        facts: &[(&str, String)],
        progress: &dyn Progress,
    ) -> Result<(FileEntry, ShardNotes), Error> {
        let done: Vec<Done> = items
            .par_iter()
            .map(|item| {
                let done = self.ingest_item(item, options);
                progress.advance(1);
                done
            })
            .collect();
        let mut rows = Vec::with_capacity(done.len());
        let mut marker_rows = Vec::new();
        let mut feature_rows = Vec::new();
        let mut notes = ShardNotes::default();
        for (item, done) in items.iter().zip(done) {
            match done {
                Done::Clip(clip) => {
                    let ClipRows {
                        motion,
                        features,
                        markers,
                        edit_of,
                        masks,
                    } = *clip;
                    let source = item.format.as_str();
                    notes.ingested.push(motion.id.as_str().to_owned());
                    notes
                        .pairs
                        .extend(edit_of.map(|edit| staged_pair(edit, item, source, &motion.id)));
                    let masks = masks.into_iter();
                    notes
                        .masks
                        .extend(masks.map(|mask| staged_mask(mask, source, &motion.id)));
                    marker_rows.extend(markers);
                    feature_rows.extend(features);
                    rows.push(motion);
                }
                Done::Markers(row) => {
                    notes.markers_only += 1;
                    marker_rows.push(*row);
                }
                Done::Skipped(reason) => *notes.skipped.entry(reason).or_default() += 1,
                Done::Rejected(rejection) => notes.quarantine.push(rejection),
            }
        }
        notes
            .beside
            .extend(write_beside(transaction, name, &marker_rows, facts)?);
        notes
            .beside
            .extend(write_beside(transaction, name, &feature_rows, facts)?);
        let entry = transaction.write_shard(name, &rows, facts)?;
        Ok((entry, notes))
    }

    fn ingest_item(&self, item: &Item, options: &IngestOptions) -> Done {
        // The readers are written not to panic; a bug in one of them must still not take ten hours
        // of other clips with it.
        let attempt = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            self.read_checked(item, options)
        }));
        let rejected = match attempt {
            Ok(Ok(done)) => return done,
            Ok(Err(rejected)) => rejected,
            Err(_) => Rejected::read(
                "E-INTERNAL",
                "the reader failed on this file; please report it",
            ),
        };
        let entry = item.entry;
        let hash = source_hash(&self.sources, &entry.file);
        Done::Rejected(staged_rejection(&entry.file, &entry.key, hash, rejected))
    }

    fn read_checked(&self, item: &Item, options: &IngestOptions) -> Result<Done, Rejected> {
        let id = item
            .id
            .clone()
            .map_err(|reason| Rejected::read("E-PATH", reason))?;
        let entry = item.entry;
        let source_hash = match self.sources.get(&entry.file) {
            Some(source) => source
                .hash
                .clone()
                .map_err(|reason| Rejected::read("E-IO", reason))?,
            None => String::new(),
        };
        let outcome = match item.release {
            Some(release) => self.releases[release].read(&self.files, entry, &options.read),
            None => self.read_file(item, options),
        };
        let clip = match outcome {
            Outcome::Clip(clip) => *clip,
            Outcome::Markers { markers, .. } => {
                let row = marker_row(*markers, id, item, source_hash);
                return Ok(Done::Markers(Box::new(row)));
            }
            Outcome::Skipped { reason } => return Ok(Done::Skipped(reason)),
            Outcome::Rejected(rejected) => return Err(rejected),
        };
        clip_rows(clip, id, item, source_hash, options).map(|rows| Done::Clip(Box::new(rows)))
    }

    fn read_file(&self, item: &Item, options: &IngestOptions) -> Outcome {
        let entry = item.entry;
        let bytes = match self.read_bounded(&entry.file) {
            Ok(bytes) => bytes,
            Err(rejected) => return Outcome::Rejected(rejected),
        };
        let folder = self
            .files
            .path(&entry.file)
            .and_then(Path::parent)
            .unwrap_or(Path::new("."));
        // A companion that is there and cannot be read must not pass for one that is not there.
        let failure = RefCell::new(None);
        let companions = |name: &str| match self.files.read_beside(&folder.join(name)) {
            Ok(bytes) => bytes,
            Err(rejected) => {
                failure.replace(Some(rejected));
                None
            }
        };
        let outcome = read_clip(
            item.format,
            Path::new(&entry.file),
            &entry.key,
            &bytes,
            &companions,
            &options.read,
        );
        failure.into_inner().map_or(outcome, Outcome::Rejected)
    }

    fn read_bounded(&self, relative: &str) -> Result<Vec<u8>, Rejected> {
        let length = self
            .files
            .path(relative)
            .and_then(|path| fs::metadata(path).ok())
            .map_or(0, |metadata| metadata.len());
        if length > MAX_FILE_LEN {
            return Err(Rejected::read(
                "E-TOO-LARGE",
                format!("found {length} bytes, expected at most {MAX_FILE_LEN} in one motion file"),
            ));
        }
        self.files.read(relative)
    }
}

/// Writes rows of another table as the shard beside one of motions, if there are any.
fn write_beside<R: Row>(
    transaction: &Transaction,
    name: &ShardName,
    rows: &[R],
    facts: &[(&str, String)],
) -> Result<Option<(String, FileEntry)>, Error> {
    if rows.is_empty() {
        return Ok(None);
    }
    let name = ShardName {
        table: R::TABLE,
        ..name.clone()
    };
    let file = transaction.write_shard(&name, rows, facts)?;
    Ok(Some((R::TABLE.to_owned(), file)))
}

/// The motions of a file that stands alone; the empty key where it holds one, or where it cannot
/// be told, which the reader then reports.
fn keys_of(format: Format, path: &Path) -> Vec<String> {
    let whole = || vec![String::new()];
    if !format.may_hold_several() {
        return whole();
    }
    let bytes = fs::read(path).unwrap_or_default();
    let keys = std::panic::catch_unwind(|| keys_in(format, &bytes)).unwrap_or_default();
    if keys.is_empty() { whole() } else { keys }
}

/// The regular files under the sources, and why other things there are passed over.
pub(crate) struct Listing {
    /// The files by their relative paths.
    pub(crate) files: BTreeMap<String, PathBuf>,
    /// Why each other thing is passed over.
    pub(crate) special: Vec<String>,
}

/// All files under the sources by the relative path that will name them. With several sources the
/// name of each one's folder comes first, and a number where two have one name, so that equal paths
/// stay apart.
pub(crate) fn list_files(sources: &[PathBuf]) -> Result<Listing, Error> {
    let mut listing = Listing {
        files: BTreeMap::new(),
        special: Vec::new(),
    };
    let mut names = BTreeSet::new();
    for (number, source) in sources.iter().enumerate() {
        let metadata = fs::metadata(source).map_err(|_| Error::MissingSource {
            path: source.clone(),
        })?;
        let mut name = source.file_name().map_or_else(
            || format!("source{number}"),
            |name| name.to_string_lossy().into_owned(),
        );
        if !names.insert(name.clone()) {
            name = format!("{number}-{name}");
        }
        if metadata.is_file() {
            listing.files.insert(name, source.clone());
            continue;
        }
        let prefix = if sources.len() > 1 {
            name
        } else {
            String::new()
        };
        listing.walk(source, prefix)?;
    }
    if listing.files.is_empty() {
        let paths: Vec<String> = sources
            .iter()
            .map(|path| path.display().to_string())
            .collect();
        return Err(Error::NoFiles {
            paths: paths.join(", "),
        });
    }
    Ok(listing)
}

impl Listing {
    fn walk(&mut self, source: &Path, prefix: String) -> Result<(), Error> {
        let mut folders = vec![(source.to_owned(), prefix)];
        while let Some((folder, relative)) = folders.pop() {
            for entry in fs::read_dir(&folder).map_err(Error::io("list", &folder))? {
                let entry = entry.map_err(Error::io("list", &folder))?;
                let name = entry.file_name().to_string_lossy().into_owned();
                let relative = match relative.as_str() {
                    "" => name,
                    parent => format!("{parent}/{name}"),
                };
                let kind = entry.file_type().map_err(Error::io("list", &folder))?;
                if kind.is_dir() {
                    folders.push((entry.path(), relative));
                    continue;
                }
                // A link to a folder could lead back here, and opening a pipe waits for ever. A
                // dangling link is kept, so that reading it reports what is missing.
                let special = match (kind.is_file(), fs::metadata(entry.path())) {
                    (true, _) | (_, Err(_)) => None,
                    (false, Ok(target)) if target.is_file() => None,
                    (false, Ok(target)) if target.is_dir() => Some("link to a folder"),
                    (false, Ok(_)) => Some("pipe, socket or device"),
                };
                match special {
                    Some(reason) => self.special.push(reason.to_owned()),
                    None => {
                        self.files.insert(relative, entry.path());
                    }
                }
            }
        }
        Ok(())
    }
}

fn hash_sources(files: &Files, progress: &dyn Progress) -> BTreeMap<String, Source> {
    progress.begin("plan", Some(files.len() as u64));
    let listed: Vec<(&str, &Path)> = files
        .all()
        .filter_map(|relative| Some((relative, files.path(relative)?)))
        .collect();
    let sources: BTreeMap<String, Source> = listed
        .into_par_iter()
        .map(|(relative, path)| {
            let source = Source {
                hash: files.hash(path),
                head: read_head(path),
                path: path.to_owned(),
            };
            progress.advance(1);
            (relative.to_owned(), source)
        })
        .collect();
    progress.finish(&format!("{} files", sources.len()));
    sources
}

/// The first bytes of a file; none if it cannot be read, which the hash reports.
pub(crate) fn read_head(path: &Path) -> Vec<u8> {
    use std::io::Read;

    let mut head = Vec::new();
    let read =
        fs::File::open(path).and_then(|file| file.take(HEAD_BYTES as u64).read_to_end(&mut head));
    match read {
        Ok(_) => head,
        Err(_) => Vec::new(),
    }
}

fn source_hash(sources: &BTreeMap<String, Source>, relative: &str) -> String {
    let hash = sources.get(relative).map(|source| source.hash.clone());
    hash.and_then(Result::ok).unwrap_or_default()
}

/// The quarantine row of a file that could not be read while planning.
fn unreadable(sources: &BTreeMap<String, Source>, relative: &str) -> Option<QuarantineRow> {
    let reason = sources.get(relative)?.hash.clone().err()?;
    let rejected = Rejected::read("E-IO", format!("cannot read the file: {reason}"));
    Some(staged_rejection(relative, "", String::new(), rejected).into())
}

fn without_extension(relative: &str) -> &str {
    let name_start = relative.rfind('/').map_or(0, |slash| slash + 1);
    match relative[name_start..].rfind('.') {
        Some(dot) if dot > 0 => &relative[..name_start + dot],
        _ => relative,
    }
}

/// What became of one item.
enum Done {
    Clip(Box<ClipRows>),
    Markers(Box<MarkerRow>),
    Skipped(String),
    Rejected(StagedRejection),
}

/// The rows of a clip, and what has to wait for the rows of others.
struct ClipRows {
    motion: MotionRow,
    features: Option<HumanMl3dRow>,
    markers: Option<MarkerRow>,
    edit_of: Option<EditOf>,
    masks: Vec<SourceMask>,
}

fn staged_rejection(
    file: &str,
    key: &str,
    source_hash: String,
    rejected: Rejected,
) -> StagedRejection {
    StagedRejection {
        path: match key {
            "" => file.to_owned(),
            key => format!("{file}#{key}"),
        },
        source_hash,
        code: rejected.code.to_owned(),
        reason: rejected.reason,
        byte_offset: rejected.byte_offset,
        stage: rejected.stage.to_owned(),
    }
}

fn part_names(parts: &[BodyPart]) -> Vec<String> {
    parts.iter().map(|part| part.name().to_owned()).collect()
}

/// What to put before the ids of a release so that none of them is taken: nothing, its format, or
/// its format and a number.
fn prefix_of(release: &dyn Release, taken: &BTreeSet<String>) -> String {
    let name = release.format().as_str();
    let mut prefix = String::new();
    let mut number = 1;
    let is_taken = |prefix: &str| {
        let mut ids = release.entries().iter();
        ids.any(|entry| taken.contains(&format!("{prefix}{}", entry.id)))
    };
    while is_taken(&prefix) {
        prefix = match number {
            1 => format!("{name}/"),
            _ => format!("{name}-{number}/"),
        };
        number += 1;
    }
    prefix
}

fn staged_pair(edit: EditOf, item: &Item, source: &str, target: &MotionId) -> StagedPair {
    StagedPair {
        source: source.to_owned(),
        kind: edit.kind.to_owned(),
        source_id: format!("{}{}", item.prefix, edit.source_id),
        target_id: target.as_str().to_owned(),
        style: edit.style,
        parts: part_names(&edit.parts),
        instruction: edit.instruction,
    }
}

fn staged_mask(mask: SourceMask, source: &str, motion: &MotionId) -> StagedMask {
    StagedMask {
        source: source.to_owned(),
        motion_id: motion.as_str().to_owned(),
        parts: part_names(&mask.parts),
        text: mask.text,
    }
}

fn frames(count: usize) -> i32 {
    i32::try_from(count).unwrap_or(i32::MAX)
}

fn marker_row(markers: Markers, id: MotionId, item: &Item, source_hash: String) -> MarkerRow {
    MarkerRow {
        id,
        split: item.split,
        source_path: item.entry.file.clone(),
        source_hash,
        fps: markers.fps.get() as f32,
        n_frames: frames(markers.positions.len() / markers.labels.len().max(1)),
        labels: markers.labels,
        positions: markers.positions,
        residuals: markers.residuals.into_iter().map(|r| [r]).collect(),
        marker_set: markers.set.map(str::to_owned),
        fit_residuals: markers.fit_residuals.into_iter().map(|r| [r]).collect(),
    }
}

/// Brings a clip to the stored rate, judges it, and makes its rows.
fn clip_rows(
    clip: SourceClip,
    id: MotionId,
    item: &Item,
    source_hash: String,
    options: &IngestOptions,
) -> Result<ClipRows, Rejected> {
    let fps_source = clip.source_fps;
    let target = options.fps.unwrap_or(clip.motion.fps());
    let motion = options
        .resample
        .apply(&clip.motion, target)
        .map_err(|error| Rejected::check("E-RESAMPLE", error.to_string()))?;
    let (motion, mut quality, kept) =
        check_with(motion, &options.read.skeleton, options.teleports)?;
    let mut notes = clip.notes.clone();
    if let Some(kept) = kept {
        notes.push(format!(
            "stored frames {} to {} were kept, the longest stretch without a jump",
            kept.start, kept.end
        ));
    }
    quality.flags |= clip.flags | said_flags(&clip);
    let entry = item.entry;
    let features = match options.humanml3d_features {
        true => {
            // The joints of HumanML3D are those of SMPL, which lie elsewhere than SMPL-X's.
            let body = clip.body.clone();
            let body = body.unwrap_or_else(|| smpl_body(&options.read.skeleton));
            Some(feature_row(&motion, &id, item.split, &body)?)
        }
        false => None,
    };
    let markers = clip
        .markers
        .map(|markers| marker_row(markers, id.clone(), item, source_hash.clone()));
    let motion = MotionRow {
        id,
        split: item.split,
        source: item.format.as_str().to_owned(),
        source_path: entry.file.clone(),
        source_hash,
        license: clip.license.or_else(|| options.license.clone()),
        mirrored_of: entry
            .mirrored_of
            .as_ref()
            .map(|id| format!("{}{id}", item.prefix)),
        skeleton: options.read.skeleton.name().to_owned(),
        fps: motion.fps().get() as f32,
        fps_source: fps_source.get() as f32,
        start_frame: frames(clip.source_frames.start),
        end_frame: frames(clip.source_frames.end),
        n_frames: frames(motion.len()),
        transl: motion.transl().to_vec(),
        global_orient: motion.global_orient().to_vec(),
        body_pose: motion.body_pose().to_vec(),
        rotation_source: clip.rotation_source.as_str().to_owned(),
        fit_error_m: clip.fit_error_m,
        captions: clip.captions,
        part_captions: clip.part_captions,
        action: clip.action,
        style: clip.style,
        notes,
        content_hash: motion.content_hash(),
        quality,
    };
    Ok(ClipRows {
        motion,
        features,
        markers,
        edit_of: clip.edit_of,
        masks: clip.masks,
    })
}

/// The features of a motion by the HumanML3D recipe.
fn feature_row(
    motion: &Motion,
    id: &MotionId,
    split: Split,
    body: &Skeleton,
) -> Result<HumanMl3dRow, Rejected> {
    let joints = humanml3d::joints_of_motion(motion, body);
    let features = humanml3d::features_of_joints(&joints)
        .map_err(|error| Rejected::check("E-FEATURES", error.to_string()))?;
    Ok(HumanMl3dRow {
        id: id.clone(),
        split,
        recipe: humanml3d::RECIPE.to_owned(),
        fps: motion.fps().get() as f32,
        n_frames: frames(features.len()),
        features,
    })
}

/// Flags for what is said about a clip, and for how well it was fitted.
fn said_flags(clip: &SourceClip) -> u32 {
    let duration = clip.motion.duration_secs() as f32;
    // Times are written with one decimal at most, and a clip of n frames ends a frame early.
    const TOLERANCE_SECS: f32 = 0.15;
    let outside = clip
        .captions
        .iter()
        .any(|caption| caption.from_s > duration || caption.to_s > duration + TOLERANCE_SECS);
    let silent = clip.captions.is_empty() && clip.part_captions.is_empty();
    let poor = clip
        .fit_error_m
        .is_some_and(|error| error > FIT_ERROR_LIMIT_M);
    [
        (outside, FLAG_CAPTION_OUTSIDE),
        (silent, FLAG_NO_CAPTION),
        (poor, FLAG_POOR_FIT),
    ]
    .into_iter()
    .filter(|(found, _)| *found)
    .fold(0, |flags, (_, flag)| flags | flag)
}
