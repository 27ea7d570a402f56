//! Run folders: the configuration, the metrics and the checkpoints of a training run.
//!
//! ```text
//! RUN/config.json               what the run was asked to do
//! RUN/metrics.jsonl             one line every few steps
//! RUN/events.out.tfevents.*     the same numbers for TensorBoard
//! RUN/checkpoint/last/          weights, optimiser and place in the run
//! RUN/checkpoint/best/          weights at the lowest validation loss
//! RUN/checkpoint/epoch-50/      weights after 50 epochs, if the settings keep them
//! RUN/checkpoint/*/manifest.json  length and BLAKE3 of every file
//! RUN/meta/LOCK                 locked while a process writes to the run
//! ```
//!
//! A checkpoint is written atomically: to a temporary folder, which is then renamed.

mod events;
mod record;
mod slot;

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use datasets_spec::Digest;
use datasets_spec::dataset::Staging;
use datasets_spec::store::{Disk, Lock, Locking, Store, if_exists};
use kinematics::normalise::Normalizer;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::Error;
use crate::error::json_error;

use self::events::EVENTS;
pub use self::record::{
    Ancestor, CONFIG, FORMAT, Inheritance, RunRecord, SkeletonId, check_skeleton,
    check_skeleton_of, read_any,
};
pub(crate) use self::record::{
    IMPORTED, MDM_KIND, MOTION_KIND, differences, read_kind, read_record, record_of,
};
use self::record::{parse_record, text_of, to_value};
pub use self::slot::Slot;

pub(crate) const METRICS: &str = "metrics.jsonl";
const MANIFEST: &str = "manifest.json";
/// File of the last checkpoint, outside its manifest: the hash of the manifest of the best checkpoint beside it.
const BEST_BESIDE: &str = "best.blake3";
/// Prefix of the files with averaged weights in a checkpoint; the rest of the file's name is that of the file with the
/// plain weights.
pub(crate) const EMA_PREFIX: &str = "ema-";
pub(crate) const STATE: &str = "state.json";

/// Files of a checkpoint by name.
pub type Files = BTreeMap<String, Vec<u8>>;

/// How a run begins: its folder, and the weights it starts from.
#[derive(Clone, Copy, Debug)]
pub struct Start<'a> {
    /// The run folder.
    pub run: &'a Path,
    /// Whether an existing run continues with changed settings. Only settings of its length and speed may change.
    pub extend: bool,
    /// Run folder whose weights a new run starts from. The new run also keeps the parts fitted to that run's training
    /// split, such as the normaliser.
    pub init: Option<&'a Path>,
}

impl<'a, P: AsRef<Path> + ?Sized> From<&'a P> for Start<'a> {
    fn from(run: &'a P) -> Self {
        Self {
            run: run.as_ref(),
            extend: false,
            init: None,
        }
    }
}

impl<'a> Start<'a> {
    /// The run whose fitted parts and texts hold: this run if it has begun, else the one it starts from.
    pub(crate) fn known(&self) -> Option<&'a Path> {
        self.has_begun().then_some(self.run).or(self.init)
    }

    /// Whether this run has begun.
    pub(crate) fn has_begun(&self) -> bool {
        self.run.join(CONFIG).exists()
    }

    /// The record with the run's fitted parts: the run's own record if it has begun, else that of the run it starts
    /// from.
    pub(crate) fn fitted<C: DeserializeOwned>(
        &self,
        kind: &'static str,
    ) -> Result<Option<C>, Error> {
        self.known()
            .map(|dir| Ok(read_record::<C>(dir, kind)?.config))
            .transpose()
    }

    /// The normaliser of the run; none if it is still to be fitted.
    ///
    /// # Errors
    /// A record cannot be read.
    pub fn range(&self) -> Result<Option<Normalizer>, Error> {
        #[derive(Deserialize)]
        struct Record {
            config: Config,
        }
        #[derive(Deserialize)]
        struct Config {
            normalizer: Option<Normalizer>,
        }
        for dir in [Some(self.run), self.init].into_iter().flatten() {
            let path = dir.join(CONFIG);
            let Some(text) = text_of(&path)? else {
                continue;
            };
            let record: Record = serde_json::from_str(&text).map_err(json_error(&path))?;
            return Ok(record.config.normalizer);
        }
        Ok(None)
    }
}

/// Settings that `extend` may change, without the prefix `config.` or `config.train.`. They affect the length and speed
/// of a run, not the network or the data.
const EXTENDABLE: [&str; 11] = [
    "keep_epochs",
    "length.epochs",
    "length.steps",
    "log_every",
    "micro_batch_size",
    "optimizer.decay",
    "optimizer.learning_rate",
    "optimizer.max_gradient_norm",
    "optimizer.warmup_steps",
    "optimizer.weight_decay",
    "val_every",
];

fn may_change(field: &str) -> bool {
    let name = field.strip_prefix("config.").unwrap_or(field);
    EXTENDABLE.contains(&name.strip_prefix("train.").unwrap_or(name))
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Manifest {
    format: u32,
    files: BTreeMap<String, FileEntry>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileEntry {
    bytes: u64,
    blake3: String,
}

/// The folder of a training run. No other process writes to it until the value is dropped.
#[derive(Debug)]
pub struct Run {
    dir: PathBuf,
    /// Folder and files of the weights to start from.
    init: Option<(PathBuf, Files)>,
    /// Record and lineage of a run that is extended or starts from other weights. [`Run::settle`] writes them once the
    /// settings and the weights are known to fit.
    unsettled: Option<(Value, Vec<Ancestor>)>,
    /// `None` if the file system has no locks.
    _lock: Option<Box<dyn Lock>>,
}

/// Checks that a folder to which a run is written is no dataset.
///
/// # Errors
/// The folder holds a dataset (`E-OCCUPIED`), or it cannot be listed.
pub(crate) fn check_free(dir: &Path) -> Result<(), Error> {
    match Staging::newest_version(&Disk, dir)? {
        0 => Ok(()),
        _ => Err(work::Error::Occupied {
            path: dir.to_owned(),
        }
        .into()),
    }
}

/// Locks a run against other processes that would write to it. Readers take no lock.
fn lock(dir: &Path) -> Result<Option<Box<dyn Lock>>, Error> {
    let meta = dir.join("meta");
    fs::create_dir_all(&meta).map_err(Error::io("create", &meta))?;
    match Disk.lock(dir, &format!("process {}", std::process::id())) {
        Ok(Locking::Held(lock)) => Ok(Some(lock)),
        Ok(Locking::Taken { holder }) => Err(datasets_spec::Error::Locked {
            path: dir.to_owned(),
            holder,
        }
        .into()),
        Ok(Locking::NoLocks) => Ok(None),
        // Disks of clusters may be mounted without locks.
        Err(error) if error.kind() == ErrorKind::Unsupported => Ok(None),
        Err(error) => Err(Error::io("lock", dir)(error)),
    }
}

impl Run {
    /// Starts a run, or reopens the folder's run, and locks it. A reopened run must have the same record, except for
    /// the settings that [`Start::extend`] may change.
    ///
    /// # Errors
    /// The folder holds another run or a dataset, another process writes to it (`E-LOCKED`), or it cannot be read or
    /// written. A folder that did not exist is made only if the run begins.
    pub fn open<'a, C: Serialize + DeserializeOwned>(
        start: impl Into<Start<'a>>,
        record: &RunRecord<C>,
    ) -> Result<Self, Error> {
        let start = start.into();
        let (dir, path) = (start.run, start.run.join(CONFIG));
        check_free(dir)?;
        // Both documents are parsed from text, so that numbers compare as they are written.
        let asked = to_value(record).map_err(json_error(&path))?;
        if start.extend && !path.exists() {
            let reason = "there is nothing to extend";
            return Err(Error::not_a_run(dir, &record.kind, reason));
        }
        let past = start.init.map(|from| begin_with(from, record, &asked));
        let (past, init) = past.transpose()?.unzip();
        let lock = lock(dir)?;
        let mut unsettled = None;
        match (text_of(&path)?, past) {
            (Some(recorded), past) => {
                unsettled = changes(start, record, asked, &recorded, past)?;
            }
            (None, Some(past)) => unsettled = Some((asked, past)),
            (None, None) => write_record(&path, &asked, &[])?,
        }
        Ok(Self {
            dir: dir.to_owned(),
            init: start.init.map(Path::to_owned).zip(init),
            unsettled,
            _lock: lock,
        })
    }

    pub(crate) fn settle(&self) -> Result<(), Error> {
        match &self.unsettled {
            Some((record, lineage)) => write_record(&self.dir.join(CONFIG), record, lineage),
            None => Ok(()),
        }
    }

    /// The weights to start from and their run folder; none if the run was opened without [`Start::init`].
    pub(crate) fn init(&self) -> Option<(&Path, Files)> {
        let (dir, files) = self.init.as_ref()?;
        Some((dir, files.clone()))
    }

    pub(crate) fn dir(&self) -> &Path {
        &self.dir
    }

    pub(crate) fn write(&self, slot: Slot, files: &Files) -> Result<(), Error> {
        let parent = self.dir.join("checkpoint");
        let name = slot.name();
        let place = parent.join(&name);
        let new = parent.join(format!(".{name}.new"));
        let old = parent.join(format!(".{name}.old"));
        remove_dir(&new)?;
        fs::create_dir_all(&new).map_err(Error::io("create", &new))?;
        for (name, bytes) in files {
            write_synced(&new.join(name), bytes)?;
        }
        let manifest = Manifest {
            format: FORMAT,
            files: files
                .iter()
                .map(|(name, bytes)| {
                    let entry = FileEntry {
                        bytes: bytes.len() as u64,
                        blake3: blake3::hash(bytes).to_hex().to_string(),
                    };
                    (name.clone(), entry)
                })
                .collect(),
        };
        let path = new.join(MANIFEST);
        let text = serde_json::to_vec_pretty(&manifest).map_err(json_error(&path))?;
        write_synced(&path, &text)?;
        if slot == Slot::Last {
            let best = manifest_hash(&self.dir, Slot::Best)?;
            write_synced(&new.join(BEST_BESIDE), best.as_bytes())?;
        }
        sync_dir(&new)?;
        // A folder cannot be renamed onto a non-empty one. Between the two renames the old checkpoint exists under its
        // other name, where `read` looks for it.
        if place.exists() {
            remove_dir(&old)?;
            fs::rename(&place, &old).map_err(Error::io("rename", &place))?;
        }
        fs::rename(&new, &place).map_err(Error::io("rename", &new))?;
        sync_dir(&parent)?;
        remove_dir(&old)
    }

    pub(crate) fn log(&self, line: &impl Serialize) -> Result<(), Error> {
        let path = self.dir.join(METRICS);
        let not_json = json_error(&path);
        let mut text = serde_json::to_string(line).map_err(not_json)?;
        text.push('\n');
        append(&path, text.as_bytes())?;
        let events = self.dir.join(EVENTS);
        let line = serde_json::to_value(line).map_err(not_json)?;
        let mut records = match events.exists() {
            true => Vec::new(),
            false => events::head(),
        };
        records.extend(events::of_line(&line));
        append(&events, &records)
    }

    /// Drops the lines of the metrics file, and the events, after `step`: a continued run writes them again.
    pub(crate) fn rewind_log(&self, step: u64) -> Result<(), Error> {
        let path = self.dir.join(METRICS);
        let Some(text) = text_of(&path)? else {
            return Ok(());
        };
        let (mut kept, mut records) = (String::new(), events::head());
        for line in text.lines() {
            // A line cut short by a crash does not parse, and is dropped as well.
            let value: Value = serde_json::from_str(line).unwrap_or_default();
            if value["step"].as_u64().is_some_and(|made| made <= step) {
                kept += line;
                kept.push('\n');
                records.extend(events::of_line(&value));
            }
        }
        write_atomically(&path, kept.as_bytes())?;
        write_atomically(&self.dir.join(EVENTS), &records)
    }
}

/// Checks that `asked`, the record of this call, goes on with the run whose `config.json` is the text `recorded`. `past`
/// is the lineage of the weights to start from, if any were asked for. Returns the new record and lineage if settings
/// change.
fn changes<C: Serialize + DeserializeOwned>(
    start: Start<'_>,
    record: &RunRecord<C>,
    asked: Value,
    recorded: &str,
    past: Option<Vec<Ancestor>>,
) -> Result<Option<(Value, Vec<Ancestor>)>, Error> {
    let dir = start.run;
    let path = dir.join(CONFIG);
    let json = json_error(&path);
    let kind: Value = serde_json::from_str(recorded).map_err(json)?;
    if kind["kind"] != asked["kind"] {
        let reason = format!("it is a run of {}", kind["kind"]);
        return Err(Error::not_a_run(dir, &record.kind, reason));
    }
    // A setting that an earlier version did not record gets the value that this version used.
    let recorded: RunRecord<C> = parse_record(recorded).map_err(json)?;
    let mut differences = differences(&to_value(&recorded).map_err(json)?, &asked);
    if recorded.skeleton_hash.is_none() {
        differences.remove("skeleton_hash");
    }
    check_changes(start, differences.keys())?;
    match past {
        Some(past) => check_beginning(dir, &recorded.lineage, &past)?,
        None => check_needs_no_init(dir, &recorded)?,
    }
    if differences.is_empty() {
        return Ok(None);
    }
    check_best(dir)?;
    let files = read(dir, Slot::Last)?.unwrap_or_default();
    let mut lineage = recorded.lineage.clone();
    lineage.push(Ancestor {
        by: Inheritance::Extend,
        weights: weights_hash(&recorded.config, &files),
        step: step_of(&files, "step"),
        changed: differences,
    });
    Ok(Some((asked, lineage)))
}

/// Checks before settings change that the best checkpoint is not newer than the last one, as a run that was killed
/// between the two leaves it: nothing would make it again, and it would pass for one of the new settings.
fn check_best(dir: &Path) -> Result<(), Error> {
    let beside = match place_of(dir, Slot::Last) {
        Some(last) => text_of(&last.join(BEST_BESIDE))?,
        None => Some(String::new()),
    };
    // Earlier versions did not record it.
    match beside {
        Some(known) if known != manifest_hash(dir, Slot::Best)? => Err(Error::Refused(format!(
            "{} was ended between two checkpoints, so its best one is newer than the last, from which --extend goes \
             on; continue it without --extend up to its next validation, which makes both again",
            dir.display()
        ))),
        _ => Ok(()),
    }
}

/// Hash of the manifest of a checkpoint; empty if there is none.
fn manifest_hash(dir: &Path, slot: Slot) -> Result<String, Error> {
    let Some(place) = place_of(dir, slot) else {
        return Ok(String::new());
    };
    let path = place.join(MANIFEST);
    let manifest = fs::read(&path).map_err(Error::io("read", &path))?;
    Ok(blake3::hash(&manifest).to_hex().to_string())
}

fn append(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    let mut options = OpenOptions::new();
    let opened = options.create(true).append(true).open(path);
    let appended = opened.and_then(|mut file| file.write_all(bytes));
    appended.map_err(Error::io("append to", path))
}

/// Reads and checks a checkpoint of a run, also while a training replaces it. `None` if there is none yet.
pub(crate) fn read(run_dir: &Path, slot: Slot) -> Result<Option<Files>, Error> {
    let mut before = None;
    loop {
        let Some(place) = place_of(run_dir, slot) else {
            return Ok(None);
        };
        let path = place.join(MANIFEST);
        let text = fs::read(&path).map_err(Error::io("read", &path));
        let manifest = text.as_ref().ok().cloned();
        let files = text.and_then(|text| listed(&place, &text));
        // A replaced checkpoint has another manifest; a damaged one has the same when it is read again.
        if files.is_ok() || before.as_ref() == Some(&manifest) {
            return files.map(Some);
        }
        before = Some(manifest);
    }
}

/// The folder that holds a checkpoint of a run.
fn place_of(run_dir: &Path, slot: Slot) -> Option<PathBuf> {
    let parent = run_dir.join("checkpoint");
    let place = parent.join(slot.name());
    let old = parent.join(format!(".{}.old", slot.name()));
    [place, old].into_iter().find(|place| place.exists())
}

/// Reads and checks the files that a manifest lists.
fn listed(place: &Path, manifest: &[u8]) -> Result<Files, Error> {
    let manifest: Manifest =
        serde_json::from_slice(manifest).map_err(json_error(&place.join(MANIFEST)))?;
    let mut files = Files::new();
    for (name, entry) in manifest.files {
        let path = place.join(&name);
        let corrupt = |detail: String| Error::corrupt(&path, detail);
        let bytes = if_exists(fs::read(&path)).map_err(Error::io("read", &path))?;
        let bytes = bytes.ok_or_else(|| corrupt("it is missing".to_owned()))?;
        if bytes.len() as u64 != entry.bytes {
            let detail = format!("{} bytes, recorded {}", bytes.len(), entry.bytes);
            return Err(corrupt(detail));
        }
        let hash = blake3::hash(&bytes).to_hex().to_string();
        if hash != entry.blake3 {
            return Err(corrupt(format!("BLAKE3 {hash}, recorded {}", entry.blake3)));
        }
        files.insert(name, bytes);
    }
    Ok(files)
}

/// A checkpoint of a run with the run's record.
pub(crate) struct Opened<C> {
    pub(crate) record: RunRecord<C>,
    pub(crate) files: Files,
    /// Hash of the weights.
    pub(crate) hash: String,
}

impl<C: Serialize> Opened<C> {
    pub(crate) fn new(record: RunRecord<C>, files: Files) -> Self {
        Self {
            hash: weights_hash(&record.config, &files),
            record,
            files,
        }
    }
}

/// Reads a checkpoint of a run of the given kind, for a model that is used, not trained.
pub(crate) fn open_for_use<C: Serialize + DeserializeOwned>(
    run_dir: &Path,
    slot: Slot,
    kind: &str,
) -> Result<Opened<C>, Error> {
    let record = read_record(run_dir, kind)?;
    let files = read(run_dir, slot)?.ok_or_else(|| {
        let (run, slots) = (run_dir.display(), slots_of(run_dir));
        Error::Refused(match slots.is_empty() {
            true => format!("{run} has no checkpoint yet; train it first"),
            false => {
                let (slot, slots) = (slot.name(), slots.join(", "));
                format!("{run} has no checkpoint {slot}; it has {slots}")
            }
        })
    })?;
    Ok(Opened::new(record, averaged(files)))
}

/// The files of a checkpoint, with averaged weights in place of plain ones where it has both: they are what is validated.
/// Only [`Slot::Last`] has both, because a training goes on from the plain ones.
fn averaged(files: Files) -> Files {
    let (averages, mut files): (Files, Files) = files
        .into_iter()
        .partition(|(name, _)| name.starts_with(EMA_PREFIX));
    let averages = averages.into_iter();
    files.extend(averages.map(|(name, bytes)| (name[EMA_PREFIX.len()..].to_owned(), bytes)));
    files
}

/// Names of the checkpoints of a run.
fn slots_of(run_dir: &Path) -> Vec<String> {
    let entries = fs::read_dir(run_dir.join("checkpoint"));
    let names = entries.into_iter().flatten().flatten();
    let names = names.map(|entry| entry.file_name().to_string_lossy().into_owned());
    let mut names: Vec<String> = names.filter(|name| name.parse::<Slot>().is_ok()).collect();
    // Shorter names first, so that epochs stand in the order of their numbers.
    names.sort_by_key(|name| (name.len(), name.clone()));
    names
}

/// Takes a file out of the files of a checkpoint.
pub(crate) fn take(files: &mut Files, name: &str, run_dir: &Path) -> Result<Vec<u8>, Error> {
    files.remove(name).ok_or_else(|| {
        let detail = format!("its manifest does not list {name:?}");
        Error::corrupt(&run_dir.join("checkpoint"), detail)
    })
}

/// Hash of a checkpoint's weights, as editors and tables record it: BLAKE3 of the configuration and the weight files
/// without [`EMA_PREFIX`], hexadecimal.
fn weights_hash<C: Serialize>(config: &C, files: &Files) -> String {
    let mut digest = Digest::default();
    let config = serde_json::to_vec(config).expect("a configuration that was read can be written");
    digest.part(&config);
    let is_weights = |name: &str| name.ends_with(".safetensors") && !name.starts_with(EMA_PREFIX);
    for (_, bytes) in files.iter().filter(|(name, _)| is_weights(name)) {
        digest.part(bytes);
    }
    digest.hex()
}

/// The step that a checkpoint's state records under `field`; 0 if it records none.
fn step_of(files: &Files, field: &str) -> u64 {
    files
        .get(STATE)
        .and_then(|state| serde_json::from_slice::<Value>(state).ok())
        .and_then(|state| state[field].as_u64())
        .unwrap_or(0)
}

fn check_changes<'a>(
    start: Start<'_>,
    mut fields: impl Iterator<Item = &'a String>,
) -> Result<(), Error> {
    let refused = fields.find(|field| !(start.extend && may_change(field)));
    let Some(field) = refused else {
        return Ok(());
    };
    Err(Error::OtherRun {
        path: start.run.to_owned(),
        field: field.clone(),
        remedy: if start.extend {
            "--extend changes length, rates and intervals alone"
        } else if may_change(field) {
            "continue it with `stance train --extend`, or with the settings it began with, or choose another folder"
        } else {
            "continue it with the settings it began with, or choose another folder"
        },
    })
}

/// Checks that a run with the lineage `recorded` began with the last weights of the lineage `past`.
fn check_beginning(dir: &Path, recorded: &[Ancestor], past: &[Ancestor]) -> Result<(), Error> {
    let is_begun_with = |ancestor: &Ancestor| {
        ancestor.by == Inheritance::Init
            && past
                .last()
                .is_some_and(|last| last.weights == ancestor.weights)
    };
    if recorded.iter().any(is_begun_with) {
        return Ok(());
    }
    Err(Error::OtherRun {
        path: dir.to_owned(),
        field: "beginning (--init)".to_owned(),
        remedy: "choose another folder",
    })
}

/// Checks that a run that was started from another run's weights has a checkpoint of its own.
fn check_needs_no_init<C>(dir: &Path, recorded: &RunRecord<C>) -> Result<(), Error> {
    let mut lineage = recorded.lineage.iter();
    if let Some(begun) = lineage.find(|ancestor| ancestor.by == Inheritance::Init)
        && read(dir, Slot::Last)?.is_none()
    {
        let reason = format!(
            "it has no checkpoint yet and begins with weights {:.12}; name their run again \
             with --init",
            begun.weights
        );
        return Err(Error::not_a_run(dir, &recorded.kind, reason));
    }
    Ok(())
}

/// The lineage of a run that starts from the best weights of another run, and those weights.
fn begin_with<C: Serialize + DeserializeOwned>(
    from: &Path,
    record: &RunRecord<C>,
    asked: &Value,
) -> Result<(Vec<Ancestor>, Files), Error> {
    let before: Opened<C> = open_for_use(from, Slot::Best, &record.kind)?;
    let last = read(from, Slot::Last)?.unwrap_or_default();
    let path = from.join(CONFIG);
    let json = json_error(&path);
    let mut lineage = before.record.lineage.clone();
    lineage.push(Ancestor {
        by: Inheritance::Init,
        weights: before.hash,
        step: step_of(&last, "best_step"),
        changed: differences(&to_value(&before.record).map_err(json)?, asked),
    });
    Ok((lineage, before.files))
}

fn write_record(path: &Path, record: &Value, lineage: &[Ancestor]) -> Result<(), Error> {
    let json = json_error(path);
    let mut record = record.clone();
    if !lineage.is_empty() {
        record["lineage"] = serde_json::to_value(lineage).map_err(json)?;
    }
    let text = serde_json::to_string_pretty(&record).map_err(json)?;
    write_atomically(path, text.as_bytes())
}

pub(crate) fn write_atomically(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    let new = path.with_extension("new");
    write_synced(&new, bytes)?;
    fs::rename(&new, path).map_err(Error::io("rename", new))
}

fn write_synced(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    File::create(path)
        .and_then(|mut file| {
            file.write_all(bytes)?;
            file.sync_all()
        })
        .map_err(Error::io("write", path))
}

/// Makes renames within a folder durable.
fn sync_dir(path: &Path) -> Result<(), Error> {
    File::open(path)
        .and_then(|dir| dir.sync_all())
        .map_err(Error::io("sync", path))
}

fn remove_dir(path: &Path) -> Result<(), Error> {
    let removed = if_exists(fs::remove_dir_all(path));
    removed.map(|_| ()).map_err(Error::io("remove", path))
}

#[cfg(test)]
mod tests;
