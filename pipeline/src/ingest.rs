//! From folders of motion files to a committed `motions` dataset.
//!
//! The run is planned before any work: every file is listed and hashed, its split drawn and its
//! shard fixed, so the result depends neither on the order in which threads finish nor on how often
//! the run was interrupted. A bad file becomes a row of the `quarantine` table and the rest goes on.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use datasets_spec::dataset::{Commit, ShardName, hash_file};
use datasets_spec::manifest::{Accounting, FileEntry};
use datasets_spec::record::{MotionRow, QuarantineRow};
use datasets_spec::table::{Row, SCHEMA_VERSION};
use datasets_spec::{
    Dataset, Fps, MotionId, Progress, Resample, Seed, Skeleton, Split, Transaction,
};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::check::check;
use crate::source::{Format, Outcome, Recognised, Rejected, read_clip, recognise};

/// Version of the rules by which files become rows. It is part of every plan, so a dataset made by
/// older rules is never continued by newer ones.
const INGEST_VERSION: u32 = 1;
/// Source files of a shard: few enough that a shard's motions fit in memory many times over.
const SHARD_SOURCES: usize = 256;
/// Bytes looked at to recognise a file.
const HEAD_BYTES: usize = 512;

/// How files become rows.
#[derive(Clone, Debug)]
pub struct IngestOptions {
    /// Rate to store at; none keeps each clip's own.
    pub fps: Option<Fps>,
    /// How clips are brought to that rate.
    pub resample: Resample,
    /// Accept this format only; files of other formats are skipped.
    pub format: Option<Format>,
    /// Seed of the split.
    pub seed: Seed,
    /// Licence tag for clips whose source declares none.
    pub license: Option<String>,
    /// Skeleton the motions are posed on.
    pub skeleton: Skeleton,
}

impl Default for IngestOptions {
    fn default() -> Self {
        Self {
            fps: Some(Fps::STORE),
            resample: Resample::Exact,
            format: None,
            seed: Seed(0),
            license: None,
            skeleton: Skeleton::smplx_neutral(),
        }
    }
}

/// What a run did.
#[derive(Clone, Debug)]
pub struct IngestReport {
    /// The committed dataset.
    pub dataset: Dataset,
    /// What became of the sources.
    pub accounting: Accounting,
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
    /// Path relative to the ingested root, with forward slashes.
    relative: String,
    hash: Result<String, String>,
    recognised: Recognised,
}

/// What a shard needs at the commit beside its file.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct ShardNotes {
    quarantine: Vec<StagedRejection>,
    skipped: BTreeMap<String, u64>,
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

/// Reads every motion file under `sources` and commits them as a dataset at `out`.
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
    let files = list_files(sources)?;
    let plan_sources = inspect_files(files, progress);
    let plan_hash = plan_hash(&plan_sources, options);

    let transaction = Transaction::begin(out, holder)?;
    if let Some(recorded) = transaction
        .base()
        .and_then(|base| base.plans.get(MotionRow::TABLE))
    {
        if *recorded != plan_hash {
            return Err(Error::Spec(datasets_spec::Error::OtherPlan {
                path: out.to_owned(),
                recorded: recorded.clone(),
                now: plan_hash,
            }));
        }
        drop(transaction);
        return already_complete(out);
    }

    let (shards, mut skipped) = shards(&plan_sources, options);
    let total: usize = shards.iter().map(|(_, items)| items.len()).sum();
    progress.begin("ingest", Some(total as u64));
    let mut entries = Vec::new();
    let mut quarantine: Vec<QuarantineRow> = Vec::new();
    let mut resumed_shards = 0;
    let facts = [
        ("skeleton", options.skeleton.name().to_owned()),
        (
            "fps",
            options
                .fps
                .map_or("native".to_owned(), |fps| fps.get().to_string()),
        ),
        ("plan_hash", plan_hash.clone()),
        ("units", "metres, radians, seconds".to_owned()),
        ("up_axis", "y".to_owned()),
        ("forward_axis", "z".to_owned()),
    ];
    for (name, items) in &shards {
        let (entry, notes) = match transaction.staged::<ShardNotes>(&plan_hash, name)? {
            Some(done) => {
                resumed_shards += 1;
                progress.advance(items.len() as u64);
                done
            }
            None => {
                let done = make_shard(&transaction, name, items, options, &facts, progress)?;
                transaction.stage(&plan_hash, name, &done.0, &done.1)?;
                done
            }
        };
        entries.push(entry);
        for (reason, count) in notes.skipped {
            *skipped.entry(reason).or_default() += count;
        }
        quarantine.extend(notes.quarantine.into_iter().map(QuarantineRow::from));
    }
    quarantine.sort_by(|a, b| a.path.cmp(&b.path));

    let mut codes = BTreeMap::new();
    for row in &quarantine {
        *codes.entry(row.code.clone()).or_default() += 1;
    }
    let accounting = Accounting {
        sources: plan_sources.len() as u64,
        ingested: entries.iter().map(|entry| entry.rows).sum(),
        quarantined: quarantine.len() as u64,
        skipped: skipped.values().sum(),
        codes,
    };
    progress.finish(&format!(
        "{} sources: {} ingested, {} quarantined, {} skipped",
        accounting.sources, accounting.ingested, accounting.quarantined, accounting.skipped
    ));
    let quarantine_name = ShardName {
        table: QuarantineRow::TABLE,
        split: None,
        index: 0,
        of: 1,
    };
    let rejected = transaction.write_shard(&quarantine_name, &quarantine, &facts)?;
    let dataset = transaction.commit(Commit {
        tables: BTreeMap::from([
            (MotionRow::TABLE.to_owned(), entries),
            (QuarantineRow::TABLE.to_owned(), vec![rejected]),
        ]),
        plan_hash,
        skeleton: options.skeleton.name().to_owned(),
        accounting: Some(accounting.clone()),
        facts: BTreeMap::from([
            ("seed".to_owned(), options.seed.0.to_string()),
            ("fps".to_owned(), facts[1].1.clone()),
            ("skipped".to_owned(), describe(&skipped)),
        ]),
    })?;
    Ok(IngestReport {
        dataset,
        accounting,
        quarantine,
        skipped,
        resumed_shards,
        already_complete: false,
    })
}

fn already_complete(out: &Path) -> Result<IngestReport, Error> {
    let dataset = Dataset::open(out)?;
    Ok(IngestReport {
        accounting: dataset.manifest().accounting.clone(),
        quarantine: dataset.read(None)?,
        skipped: BTreeMap::new(),
        resumed_shards: 0,
        already_complete: true,
        dataset,
    })
}

fn describe(skipped: &BTreeMap<String, u64>) -> String {
    let parts: Vec<String> = skipped
        .iter()
        .map(|(reason, count)| format!("{count} {reason}"))
        .collect();
    parts.join("; ")
}

/// All files under the sources, sorted by the relative path that will name them. With several
/// sources the name of each one's folder comes first, so that equal paths stay apart.
fn list_files(sources: &[PathBuf]) -> Result<Vec<(PathBuf, String)>, Error> {
    let mut files = Vec::new();
    for (number, source) in sources.iter().enumerate() {
        let metadata = fs::metadata(source).map_err(|_| Error::MissingSource {
            path: source.clone(),
        })?;
        let name = source.file_name().map_or_else(
            || format!("source{number}"),
            |name| name.to_string_lossy().into_owned(),
        );
        if metadata.is_file() {
            files.push((source.clone(), name));
            continue;
        }
        let prefix = if sources.len() > 1 {
            name
        } else {
            String::new()
        };
        let mut folders = vec![(source.clone(), prefix)];
        while let Some((folder, relative)) = folders.pop() {
            for entry in fs::read_dir(&folder).map_err(Error::io("list", &folder))? {
                let entry = entry.map_err(Error::io("list", &folder))?;
                let name = entry.file_name().to_string_lossy().into_owned();
                let relative = match relative.as_str() {
                    "" => name,
                    parent => format!("{parent}/{name}"),
                };
                // A link to a folder could lead back here; links to files are plain sources.
                let kind = entry.file_type().map_err(Error::io("list", &folder))?;
                if kind.is_dir() {
                    folders.push((entry.path(), relative));
                } else if entry.path().is_file() || kind.is_symlink() {
                    files.push((entry.path(), relative));
                }
            }
        }
    }
    if files.is_empty() {
        let paths: Vec<String> = sources
            .iter()
            .map(|path| path.display().to_string())
            .collect();
        return Err(Error::NoFiles {
            paths: paths.join(", "),
        });
    }
    files.sort_by(|a, b| a.1.cmp(&b.1));
    Ok(files)
}

fn inspect_files(files: Vec<(PathBuf, String)>, progress: &dyn Progress) -> Vec<Source> {
    progress.begin("plan", Some(files.len() as u64));
    let sources: Vec<Source> = files
        .into_par_iter()
        .map(|(path, relative)| {
            let head = read_head(&path);
            let source = Source {
                hash: hash_file(&path).map_err(|error| with_causes(&error)),
                recognised: recognise(Path::new(&relative), &head),
                path,
                relative,
            };
            progress.advance(1);
            source
        })
        .collect();
    progress.finish(&format!("{} files", sources.len()));
    sources
}

/// The first bytes of a file; none if it cannot be read, which the hash reports.
fn read_head(path: &Path) -> Vec<u8> {
    use std::io::Read;

    let mut head = Vec::new();
    let read =
        fs::File::open(path).and_then(|file| file.take(HEAD_BYTES as u64).read_to_end(&mut head));
    match read {
        Ok(_) => head,
        Err(_) => Vec::new(),
    }
}

fn with_causes(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(inner) = cause {
        text += &format!(": {inner}");
        cause = inner.source();
    }
    text
}

fn plan_hash(sources: &[Source], options: &IngestOptions) -> String {
    let mut hasher = blake3::Hasher::new();
    let settings = format!(
        "{INGEST_VERSION} {SCHEMA_VERSION} {:?} {:?} {:?} {} {:?} {:?}",
        options.fps.map(Fps::get),
        options.resample,
        options.format,
        options.seed.0,
        options.license,
        options.skeleton,
    );
    hasher.update(settings.as_bytes());
    for source in sources {
        for part in [
            source.relative.as_str(),
            source.hash.as_deref().unwrap_or(""),
        ] {
            hasher.update(&(part.len() as u64).to_le_bytes());
            hasher.update(part.as_bytes());
        }
    }
    hasher.finalize().to_hex().to_string()
}

/// A motion file on its way into a shard.
struct Item<'a> {
    source: &'a Source,
    format: Format,
    id: Result<MotionId, String>,
}

type Shards<'a> = Vec<(ShardName, Vec<Item<'a>>)>;

/// Deals the motion files into shards by split; counts the files that hold no motion.
fn shards<'a>(
    sources: &'a [Source],
    options: &IngestOptions,
) -> (Shards<'a>, BTreeMap<String, u64>) {
    let mut skipped: BTreeMap<String, u64> = BTreeMap::new();
    let mut motions: Vec<(&Source, Format)> = Vec::new();
    for source in sources {
        let reason = match &source.recognised {
            Recognised::Motion(format) if options.format.is_none_or(|only| only == *format) => {
                motions.push((source, *format));
                continue;
            }
            Recognised::Motion(format) => format!("{} file, not asked for", format.as_str()),
            Recognised::NotMotion { reason } => reason.clone(),
        };
        *skipped.entry(reason).or_default() += 1;
    }
    // Files that differ in their extension alone keep it in their id.
    let mut seen = BTreeSet::new();
    let mut twice = BTreeSet::new();
    for (source, _) in &motions {
        let stem = without_extension(&source.relative);
        if !seen.insert(stem) {
            twice.insert(stem);
        }
    }
    let mut by_split: BTreeMap<Split, Vec<Item>> = BTreeMap::new();
    for (source, format) in motions {
        let stem = without_extension(&source.relative);
        let name = if twice.contains(stem) {
            &source.relative
        } else {
            stem
        };
        let id = MotionId::parse(name).map_err(|error| error.to_string());
        let clip = id.as_ref().map_or(name, MotionId::source_clip);
        let split = Split::assign(clip, options.seed);
        by_split
            .entry(split)
            .or_default()
            .push(Item { source, format, id });
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
    (shards, skipped)
}

fn without_extension(relative: &str) -> &str {
    let name_start = relative.rfind('/').map_or(0, |slash| slash + 1);
    match relative[name_start..].rfind('.') {
        Some(dot) if dot > 0 => &relative[..name_start + dot],
        _ => relative,
    }
}

/// What became of one file.
enum Done {
    Row(Box<MotionRow>),
    Skipped(String),
    Rejected(StagedRejection),
}

fn make_shard(
    transaction: &Transaction,
    name: &ShardName,
    items: &[Item],
    options: &IngestOptions,
    facts: &[(&str, String)],
    progress: &dyn Progress,
) -> Result<(FileEntry, ShardNotes), Error> {
    let split = name.split.unwrap_or(Split::Train);
    let done: Vec<Done> = items
        .par_iter()
        .map(|item| {
            let done = ingest_file(item, split, options);
            progress.advance(1);
            done
        })
        .collect();
    let mut rows = Vec::with_capacity(done.len());
    let mut notes = ShardNotes::default();
    for item in done {
        match item {
            Done::Row(row) => rows.push(*row),
            Done::Skipped(reason) => *notes.skipped.entry(reason).or_default() += 1,
            Done::Rejected(rejection) => notes.quarantine.push(rejection),
        }
    }
    let entry = transaction.write_shard(name, &rows, facts)?;
    Ok((entry, notes))
}

fn ingest_file(item: &Item, split: Split, options: &IngestOptions) -> Done {
    // The readers are written not to panic; a bug in one of them must still not take ten hours of
    // other clips with it.
    let attempt = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
        read_checked(item, split, options)
    }));
    let rejected = match attempt {
        Ok(Ok(done)) => return done,
        Ok(Err(rejected)) => rejected,
        Err(_) => Rejected {
            code: "E-INTERNAL",
            reason: "the reader failed on this file; please report it".to_owned(),
            byte_offset: None,
            stage: "read",
        },
    };
    Done::Rejected(StagedRejection {
        path: item.source.relative.clone(),
        source_hash: item.source.hash.clone().unwrap_or_default(),
        code: rejected.code.to_owned(),
        reason: rejected.reason,
        byte_offset: rejected.byte_offset,
        stage: rejected.stage.to_owned(),
    })
}

fn read_checked(item: &Item, split: Split, options: &IngestOptions) -> Result<Done, Rejected> {
    let reject = |code, stage| {
        move |reason: String| Rejected {
            code,
            reason,
            byte_offset: None,
            stage,
        }
    };
    let source = item.source;
    let id = item.id.clone().map_err(reject("E-PATH", "read"))?;
    let source_hash = source.hash.clone().map_err(reject("E-IO", "read"))?;
    let bytes =
        fs::read(&source.path).map_err(|error| reject("E-IO", "read")(error.to_string()))?;
    let folder = source.path.parent().unwrap_or(Path::new("."));
    let companions = |name: &str| fs::read(folder.join(name)).ok();
    let clip = match read_clip(
        item.format,
        Path::new(&source.relative),
        &bytes,
        &companions,
        &options.skeleton,
    ) {
        Outcome::Clip(clip) => clip,
        Outcome::Skipped { reason } => return Ok(Done::Skipped(reason)),
        Outcome::Rejected(rejected) => return Err(rejected),
    };
    let fps_source = clip.motion.fps();
    let target = options.fps.unwrap_or(fps_source);
    let motion = options
        .resample
        .apply(&clip.motion, target)
        .map_err(|error| reject("E-RESAMPLE", "check")(error.to_string()))?;
    let quality = check(&motion, &options.skeleton)?;
    let frames = |count: usize| i32::try_from(count).unwrap_or(i32::MAX);
    Ok(Done::Row(Box::new(MotionRow {
        id,
        split,
        source: item.format.as_str().to_owned(),
        source_path: source.relative.clone(),
        source_hash,
        license: clip.license.or_else(|| options.license.clone()),
        mirrored_of: None,
        skeleton: options.skeleton.name().to_owned(),
        fps: motion.fps().get() as f32,
        fps_source: fps_source.get() as f32,
        start_frame: frames(clip.first_frame),
        end_frame: frames(clip.num_source_frames),
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
        content_hash: motion.content_hash(),
        quality,
    })))
}
