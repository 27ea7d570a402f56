//! Run folders: the configuration, the metrics and the checkpoints of a training run.
//!
//! ```text
//! RUN/config.json               what the run was asked to do
//! RUN/metrics.jsonl             one line every few steps
//! RUN/checkpoint/last/          weights, optimiser and place in the run
//! RUN/checkpoint/best/          weights at the lowest validation loss
//! RUN/checkpoint/epoch-50/      weights after so many epochs, where the settings keep them
//! RUN/checkpoint/*/manifest.json  length and BLAKE3 of every file
//! ```
//!
//! A checkpoint appears whole or not at all: it is written beside its place and renamed into it.

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::Error;

/// Version of the run folder.
pub const FORMAT: u32 = 1;

/// Version of burn, whose module tree decides the names of weights.
const BURN_VERSION: &str = "0.22.1";

const CONFIG: &str = "config.json";
pub(crate) const METRICS: &str = "metrics.jsonl";
const MANIFEST: &str = "manifest.json";

/// A checkpoint of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Slot {
    /// The newest.
    Last,
    /// The one with the lowest validation loss.
    Best,
    /// The one kept after so many epochs.
    Epoch(u64),
}

impl Slot {
    /// Name of the folder.
    pub fn name(self) -> String {
        match self {
            Self::Last => "last".to_owned(),
            Self::Best => "best".to_owned(),
            Self::Epoch(epoch) => format!("epoch-{epoch}"),
        }
    }
}

impl std::str::FromStr for Slot {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        match name {
            "last" => Ok(Self::Last),
            "best" => Ok(Self::Best),
            _ => name
                .strip_prefix("epoch-")
                .and_then(|epoch| epoch.parse().ok())
                .map(Self::Epoch)
                .ok_or_else(|| {
                    format!("{name:?} is no checkpoint; known are best, last and epoch-N")
                }),
        }
    }
}

/// Files of a checkpoint by name.
pub(crate) type Files = BTreeMap<String, Vec<u8>>;

/// The document `config.json`: everything a run depends on. `C` is the configuration of the kind of
/// run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunRecord<C> {
    /// Version of the run folder.
    pub format: u32,
    /// What was trained.
    pub kind: String,
    /// Programs that made the run, by name.
    pub versions: BTreeMap<String, String>,
    /// Root hash of the dataset.
    pub dataset_hash: String,
    /// Name of the skeleton the motions drive.
    pub skeleton: String,
    /// The resolved configuration and what was fitted to the training split.
    pub config: C,
}

impl<C> RunRecord<C> {
    pub(crate) fn new(kind: &str, dataset_hash: &str, skeleton: &str, config: C) -> Self {
        Self {
            format: FORMAT,
            kind: kind.to_owned(),
            versions: [
                ("stance", env!("CARGO_PKG_VERSION")),
                ("burn", BURN_VERSION),
            ]
            .map(|(name, version)| (name.to_owned(), version.to_owned()))
            .into(),
            dataset_hash: dataset_hash.to_owned(),
            skeleton: skeleton.to_owned(),
            config,
        }
    }
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

/// A folder being trained into.
#[derive(Clone, Debug)]
pub(crate) struct Run {
    dir: PathBuf,
}

impl Run {
    /// Starts a run, or opens it again if the folder holds one of the same record.
    pub(crate) fn open<C: Serialize>(dir: &Path, record: &RunRecord<C>) -> Result<Self, Error> {
        let path = dir.join(CONFIG);
        let json = |source| Error::Json {
            path: path.clone(),
            source,
        };
        let text = serde_json::to_string_pretty(record).map_err(json)?;
        fs::create_dir_all(dir).map_err(Error::io("create", dir))?;
        match fs::read_to_string(&path) {
            Ok(recorded) => {
                // Both sides go through text, so that numbers are compared as they are written.
                let recorded: Value = serde_json::from_str(&recorded).map_err(json)?;
                let asked: Value = serde_json::from_str(&text).map_err(json)?;
                if let Some(field) = first_difference(&recorded, &asked, "") {
                    return Err(Error::OtherRun {
                        path: dir.to_owned(),
                        field,
                    });
                }
            }
            Err(problem) if problem.kind() == std::io::ErrorKind::NotFound => {
                write_atomically(&path, text.as_bytes())?;
            }
            Err(problem) => return Err(Error::io("read", path)(problem)),
        }
        Ok(Self {
            dir: dir.to_owned(),
        })
    }

    /// The folder.
    pub(crate) fn dir(&self) -> &Path {
        &self.dir
    }

    /// Replaces a checkpoint.
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
        let text = serde_json::to_vec_pretty(&manifest).map_err(|source| Error::Json {
            path: path.clone(),
            source,
        })?;
        write_synced(&path, &text)?;
        sync_dir(&new)?;
        // A folder cannot be renamed onto a full one. Between the two renames the old checkpoint
        // is still there under its other name, where `read` looks for it.
        if place.exists() {
            remove_dir(&old)?;
            fs::rename(&place, &old).map_err(Error::io("rename", &place))?;
        }
        fs::rename(&new, &place).map_err(Error::io("rename", &new))?;
        sync_dir(&parent)?;
        remove_dir(&old)
    }

    /// Appends a line to the metrics file.
    pub(crate) fn log(&self, line: &impl Serialize) -> Result<(), Error> {
        let path = self.dir.join(METRICS);
        let mut text = serde_json::to_string(line).map_err(|source| Error::Json {
            path: path.clone(),
            source,
        })?;
        text.push('\n');
        OpenOptions::new()
            .create(true)
            .append(true)
            .open(&path)
            .and_then(|mut file| file.write_all(text.as_bytes()))
            .map_err(Error::io("append to", path))
    }

    /// Drops the lines of the metrics file that lie after `step`: a run that is continued writes
    /// them again.
    pub(crate) fn rewind_log(&self, step: u64) -> Result<(), Error> {
        #[derive(Deserialize)]
        struct Step {
            step: u64,
        }
        let path = self.dir.join(METRICS);
        let text = match fs::read_to_string(&path) {
            Ok(text) => text,
            Err(problem) if problem.kind() == std::io::ErrorKind::NotFound => return Ok(()),
            Err(problem) => return Err(Error::io("read", path)(problem)),
        };
        let kept: String = text
            .lines()
            .filter(|line| {
                // A line cut short by a crash does not parse and is dropped too.
                serde_json::from_str::<Step>(line).is_ok_and(|line| line.step <= step)
            })
            .flat_map(|line| [line, "\n"])
            .collect();
        write_atomically(&path, kept.as_bytes())
    }
}

/// Reads and checks a checkpoint of a run. `None` if there is none yet.
pub(crate) fn read(run_dir: &Path, slot: Slot) -> Result<Option<Files>, Error> {
    let parent = run_dir.join("checkpoint");
    let place = parent.join(slot.name());
    let old = parent.join(format!(".{}.old", slot.name()));
    let place = if place.exists() {
        place
    } else if old.exists() {
        old
    } else {
        return Ok(None);
    };
    let path = place.join(MANIFEST);
    let text = fs::read(&path).map_err(Error::io("read", &path))?;
    let manifest: Manifest =
        serde_json::from_slice(&text).map_err(|source| Error::Json { path, source })?;
    let mut files = Files::new();
    for (name, entry) in manifest.files {
        let path = place.join(&name);
        let corrupt = |detail: String| Error::Corrupt {
            path: path.clone(),
            detail,
        };
        let bytes = match fs::read(&path) {
            Ok(bytes) => bytes,
            Err(problem) if problem.kind() == std::io::ErrorKind::NotFound => {
                return Err(corrupt("it is missing".to_owned()));
            }
            Err(problem) => return Err(Error::io("read", path)(problem)),
        };
        if bytes.len() as u64 != entry.bytes {
            return Err(corrupt(format!(
                "{} bytes, recorded {}",
                bytes.len(),
                entry.bytes
            )));
        }
        let hash = blake3::hash(&bytes).to_hex().to_string();
        if hash != entry.blake3 {
            return Err(corrupt(format!("BLAKE3 {hash}, recorded {}", entry.blake3)));
        }
        files.insert(name, bytes);
    }
    Ok(Some(files))
}

/// What was trained in a run folder.
pub(crate) fn read_kind(run_dir: &Path) -> Result<String, Error> {
    #[derive(Deserialize)]
    struct Kind {
        kind: String,
    }
    let path = run_dir.join(CONFIG);
    let text = fs::read_to_string(&path).map_err(Error::io("read", &path))?;
    let found: Kind = serde_json::from_str(&text).map_err(|source| Error::Json { path, source })?;
    Ok(found.kind)
}

/// Reads the document of a finished or running run.
pub(crate) fn read_record<C: DeserializeOwned>(
    run_dir: &Path,
    kind: &'static str,
) -> Result<RunRecord<C>, Error> {
    #[derive(Deserialize)]
    struct Header {
        format: u32,
        kind: String,
    }
    let path = run_dir.join(CONFIG);
    let not_a_run = |reason: String| Error::NotARun {
        path: run_dir.to_owned(),
        kind,
        reason,
    };
    let text = match fs::read_to_string(&path) {
        Ok(text) => text,
        Err(problem) if problem.kind() == std::io::ErrorKind::NotFound => {
            return Err(not_a_run(format!("it holds no {CONFIG}")));
        }
        Err(problem) => return Err(Error::io("read", path)(problem)),
    };
    let json = |source| Error::Json {
        path: path.clone(),
        source,
    };
    let header: Header = serde_json::from_str(&text).map_err(json)?;
    if header.kind != kind {
        return Err(not_a_run(format!("it is a run of {:?}", header.kind)));
    }
    if header.format != FORMAT {
        return Err(not_a_run(format!(
            "it has format {}, this program reads {FORMAT}",
            header.format
        )));
    }
    serde_json::from_str(&text).map_err(json)
}

/// The checkpoint a finished run is used from: the best one, or the last one if none was validated.
pub(crate) fn read_for_use(run_dir: &Path, slot: Slot, kind: &'static str) -> Result<Files, Error> {
    read(run_dir, slot)?.ok_or_else(|| Error::NotARun {
        path: run_dir.to_owned(),
        kind,
        reason: format!("it holds no checkpoint {:?}", slot.name()),
    })
}

/// Takes a file out of a checkpoint.
pub(crate) fn take(files: &mut Files, name: &str, run_dir: &Path) -> Result<Vec<u8>, Error> {
    files.remove(name).ok_or_else(|| Error::Corrupt {
        path: run_dir.join("checkpoint"),
        detail: format!("its manifest does not list {name:?}"),
    })
}

/// What identifies trained weights: the BLAKE3 of configuration and weight files, hexadecimal.
pub(crate) fn weights_hash<C: Serialize>(config: &C, files: &[&[u8]]) -> String {
    let mut hasher = blake3::Hasher::new();
    let config = serde_json::to_vec(config).expect("a configuration that was read can be written");
    for part in std::iter::once(config.as_slice()).chain(files.iter().copied()) {
        hasher.update(&(part.len() as u64).to_le_bytes());
        hasher.update(part);
    }
    hasher.finalize().to_hex().to_string()
}

/// The first field, in order of names, in which two documents differ. Versions of programs may
/// differ.
fn first_difference(recorded: &Value, asked: &Value, path: &str) -> Option<String> {
    let (Value::Object(recorded), Value::Object(asked)) = (recorded, asked) else {
        return (recorded != asked).then(|| path.to_owned());
    };
    let names: std::collections::BTreeSet<&String> = recorded.keys().chain(asked.keys()).collect();
    names.into_iter().find_map(|name| {
        let path = if path.is_empty() {
            name.clone()
        } else {
            format!("{path}.{name}")
        };
        if path == "versions" {
            return None;
        }
        match (recorded.get(name), asked.get(name)) {
            (Some(recorded), Some(asked)) => first_difference(recorded, asked, &path),
            _ => Some(path),
        }
    })
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
    match fs::remove_dir_all(path) {
        Err(problem) if problem.kind() != std::io::ErrorKind::NotFound => {
            Err(Error::io("remove", path)(problem))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Settings {
        width: usize,
        rate: f64,
    }

    fn record(width: usize) -> RunRecord<Settings> {
        // A number whose shortest decimal form needs 17 digits.
        let rate = 0.1 + 0.2;
        RunRecord::new("test", "hash", "smplx", Settings { width, rate })
    }

    fn files(value: u8) -> Files {
        [("a.bin".to_owned(), vec![value; 9])].into()
    }

    #[test]
    fn a_run_is_opened_again_by_the_same_settings_alone() {
        let dir = tempfile::tempdir().expect("a folder");
        Run::open(dir.path(), &record(4)).expect("started");
        Run::open(dir.path(), &record(4)).expect("opened again");
        match Run::open(dir.path(), &record(8)) {
            Err(Error::OtherRun { field, .. }) => assert_eq!(field, "config.width"),
            other => panic!("expected a refusal, got {other:?}"),
        }
        let read: RunRecord<Settings> = read_record(dir.path(), "test").expect("read");
        assert_eq!(read.config.width, 4);
        assert!(matches!(
            read_record::<Settings>(dir.path(), "tmr"),
            Err(Error::NotARun { .. })
        ));
    }

    #[test]
    fn a_checkpoint_is_replaced_whole_and_survives_a_crash_between_renames() {
        let dir = tempfile::tempdir().expect("a folder");
        let run = Run::open(dir.path(), &record(4)).expect("started");
        assert!(read(dir.path(), Slot::Last).expect("read").is_none());
        run.write(Slot::Last, &files(1)).expect("written");
        run.write(Slot::Last, &files(2)).expect("written");
        assert_eq!(read(dir.path(), Slot::Last).expect("read"), Some(files(2)));
        assert!(read(dir.path(), Slot::Best).expect("read").is_none());

        let checkpoints = dir.path().join("checkpoint");
        fs::rename(checkpoints.join("last"), checkpoints.join(".last.old")).expect("renamed");
        assert_eq!(read(dir.path(), Slot::Last).expect("read"), Some(files(2)));
    }

    #[test]
    fn a_damaged_checkpoint_is_refused_with_the_reason() {
        let dir = tempfile::tempdir().expect("a folder");
        let run = Run::open(dir.path(), &record(4)).expect("started");
        let path = dir.path().join("checkpoint/last/a.bin");
        for (bytes, reason) in [
            (Some(vec![1; 8]), "8 bytes"),
            (Some(vec![7; 9]), "BLAKE3"),
            (None, "missing"),
        ] {
            run.write(Slot::Last, &files(1)).expect("written");
            match bytes {
                Some(bytes) => fs::write(&path, bytes).expect("damaged"),
                None => fs::remove_file(&path).expect("removed"),
            }
            match read(dir.path(), Slot::Last) {
                Err(Error::Corrupt { detail, .. }) => assert!(detail.contains(reason), "{detail}"),
                other => panic!("expected a refusal, got {other:?}"),
            }
        }
    }

    #[test]
    fn the_log_is_rewound_to_the_checkpoint() {
        let dir = tempfile::tempdir().expect("a folder");
        let run = Run::open(dir.path(), &record(4)).expect("started");
        run.rewind_log(3).expect("nothing to rewind");
        for step in [2, 4, 6] {
            run.log(&serde_json::json!({ "step": step }))
                .expect("logged");
        }
        run.rewind_log(4).expect("rewound");
        let text = fs::read_to_string(dir.path().join(METRICS)).expect("read");
        assert_eq!(text, "{\"step\":2}\n{\"step\":4}\n");
    }
}
