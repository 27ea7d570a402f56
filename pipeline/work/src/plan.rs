//! Plans on the disk.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use datasets_spec::dataset::{Staging, Transaction};
use datasets_spec::manifest::Manifest;
use datasets_spec::store::{ByPath, Store, is_url, replace_file};
use datasets_spec::table::{Row, read_rows, write_rows};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::piece::Piece;
use super::record::{CommitOptions, Committed};
use crate::Error;
use crate::folder::{NewFolder, is_occupied, publish};

/// Value of `format` in every plan.
const FORMAT: &str = "stance-plan";
/// Version of the files of a plan.
const VERSION: u32 = 2;
/// Program version of a plan. Another version could make other bytes.
const TOOL_VERSION: &str = concat!("stance ", env!("CARGO_PKG_VERSION"));
const HEADER: &str = "plan.json";
const PIECES: &str = "pieces.parquet";
/// File with the result of a commit to a folder of files.
const COMMITTED: &str = "committed.json";
/// Folder of files before it is published.
const RESULT: &str = "result";
/// Digits of a plan's hash in the name of a folder of pieces.
const HOME_DIGITS: usize = 16;

/// `plan.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    format: String,
    version: u32,
    tool_version: String,
    job: String,
    settings: Value,
    destination: PathBuf,
    /// Whether the destination is a dataset; otherwise it is a folder of files.
    is_dataset: bool,
    plan_hash: String,
    /// Version of the dataset that the plan starts from; 0 for none.
    base: u64,
    /// Tables of that version and of earlier ones.
    base_tables: BTreeSet<String>,
    pieces: u64,
    /// BLAKE3 of `pieces.parquet`.
    pieces_hash: String,
}

/// A plan that is not written yet.
#[derive(Clone, Debug)]
pub struct Draft {
    /// The job.
    pub job: &'static str,
    /// Settings of the job.
    pub settings: Value,
    /// Destination of the result.
    pub destination: PathBuf,
    /// Whether the destination is a dataset; otherwise it is a folder of files.
    pub is_dataset: bool,
    /// Hash of everything that determines the result.
    pub plan_hash: String,
    /// Version of the dataset that the plan starts from, by [`Staging::base`].
    pub base: (u64, BTreeSet<String>),
    /// The pieces, by number.
    pub pieces: Vec<Piece>,
}

impl Draft {
    /// Writes the plan as a new or empty folder, whole or not at all. `tables` writes its other files. An existing plan
    /// with the same hash and destination stays.
    ///
    /// # Errors
    /// The folder holds something else, or cannot be written.
    pub fn write(
        self,
        out: &Path,
        tables: impl FnOnce(&Path) -> Result<(), Error>,
    ) -> Result<Plan, Error> {
        let destination = absolute(&self.destination)?;
        if is_occupied(out) {
            let is_same =
                |plan: &Plan| plan.hash() == self.plan_hash && plan.destination() == destination;
            let same = Plan::open(out).ok().filter(is_same);
            return same.ok_or_else(|| Error::Occupied {
                path: out.to_owned(),
            });
        }
        let folder = NewFolder::beside(&absolute(out)?)?;
        tables(folder.path())?;
        let pieces = folder.path().join(PIECES);
        write_table(&pieces, &self.pieces)?;
        let header = Header {
            format: FORMAT.to_owned(),
            version: VERSION,
            tool_version: TOOL_VERSION.to_owned(),
            job: self.job.to_owned(),
            settings: self.settings,
            destination,
            is_dataset: self.is_dataset,
            plan_hash: self.plan_hash,
            base: self.base.0,
            base_tables: self.base.1,
            pieces: self.pieces.len() as u64,
            pieces_hash: hash_file(&pieces)?,
        };
        write_json(&folder.path().join(HEADER), &header)?;
        folder.publish()?;
        Plan::open(out)
    }
}

/// Writes a table of a plan.
pub fn write_table<R: Row>(path: &Path, rows: &[R]) -> Result<(), Error> {
    let file = File::create(path).map_err(Error::io("create", path))?;
    let file = write_rows(file, path, rows, &[])?;
    file.sync_all().map_err(Error::io("sync", path))
}

/// Writes a document of a plan.
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<(), Error> {
    let text =
        serde_json::to_vec_pretty(value).map_err(|error| Error::io("write", path)(error.into()))?;
    fs::write(path, text).map_err(Error::io("write", path))
}

/// Reads a document of a plan.
pub fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T, Error> {
    let text = fs::read(path).map_err(Error::io("read", path))?;
    let parsed = serde_json::from_slice(&text);
    Ok(parsed.map_err(datasets_spec::Error::json(path))?)
}

/// BLAKE3 of a file, hexadecimal.
pub fn hash_file(path: &Path) -> Result<String, Error> {
    ByPath.hash(path).map_err(Error::io("read", path))
}

/// The absolute path, which is valid for every worker; a URL stays as it is.
///
/// # Errors
/// The path is empty, or the current folder is gone.
pub fn absolute(path: &Path) -> Result<PathBuf, Error> {
    if is_url(path) {
        return Ok(path.to_owned());
    }
    std::path::absolute(path).map_err(Error::io("find", path))
}

/// State of the destination of a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// The destination has not changed since the plan was made.
    Open,
    /// The plan was committed.
    Committed,
    /// The destination changed, and has this version now; 0 for a folder of files.
    Changed(u64),
}

/// A plan in a folder.
#[derive(Clone, Debug)]
pub struct Plan {
    path: PathBuf,
    header: Header,
    pieces: Vec<Piece>,
}

impl Plan {
    /// Opens the folder of a plan.
    ///
    /// # Errors
    /// The folder is not a plan, the plan is of another version of the program, or it was altered.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let bad = |reason: String| Error::BadPlan {
            path: path.to_owned(),
            reason,
        };
        let file = path.join(HEADER);
        if !file.is_file() {
            return Err(bad(format!("there is no {HEADER} in it")));
        }
        let text: Value = read_json(&file)?;
        let version = text.get("tool_version").and_then(Value::as_str);
        if let Some(version) = version
            && version != TOOL_VERSION
        {
            let reason = format!("{version} made it and this is {TOOL_VERSION}; plan again");
            return Err(bad(reason));
        }
        let header: Header =
            serde_json::from_value(text).map_err(|error| bad(format!("{HEADER}: {error}")))?;
        if header.format != FORMAT || header.version != VERSION {
            return Err(bad(format!("{HEADER} has an unknown format; plan again")));
        }
        let pieces = path.join(PIECES);
        if hash_file(&pieces)? != header.pieces_hash {
            return Err(bad(format!("{PIECES} was altered; plan again")));
        }
        Ok(Self {
            path: path.to_owned(),
            header,
            pieces: read_rows(&pieces)?,
        })
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Name of the job on the command line.
    pub fn job(&self) -> &str {
        &self.header.job
    }

    /// Hash of everything that determines the result.
    pub fn hash(&self) -> &str {
        &self.header.plan_hash
    }

    /// Destination of the result.
    pub fn destination(&self) -> &Path {
        &self.header.destination
    }

    /// The pieces, by number.
    pub fn pieces(&self) -> &[Piece] {
        &self.pieces
    }

    /// The piece with this id.
    pub fn piece(&self, id: &str) -> Option<&Piece> {
        self.pieces.iter().find(|piece| piece.id == id)
    }

    /// Settings of the job.
    ///
    /// # Errors
    /// The settings are those of another job.
    pub fn settings<T: DeserializeOwned>(&self) -> Result<T, Error> {
        serde_json::from_value(self.header.settings.clone()).map_err(|error| Error::BadPlan {
            path: self.path.clone(),
            reason: format!("{HEADER}: {error}"),
        })
    }

    /// The staging folder of the pieces.
    pub fn staging(&self) -> Staging {
        let base = (self.header.base, self.header.base_tables.clone());
        Staging::new(ByPath::store(), &self.home(), base, self.hash())
    }

    /// The folder for staged pieces: the dataset, or a folder beside the output folder.
    pub fn home(&self) -> PathBuf {
        let destination = &self.header.destination;
        if self.header.is_dataset {
            return destination.clone();
        }
        let name = destination
            .file_name()
            .unwrap_or_default()
            .to_string_lossy();
        let digits = &self.header.plan_hash[..HOME_DIGITS.min(self.header.plan_hash.len())];
        destination.with_file_name(format!(".{name}.{digits}.pieces"))
    }

    /// Path of a folder of files before it is published.
    pub fn result(&self) -> PathBuf {
        self.home().join(RESULT)
    }

    /// Renames the folder at [`Plan::result`] to the destination. `committed` is written to a file before and after, so
    /// that the next commit sees whether a commit that was killed had renamed the folder.
    pub fn publish(&self, committed: &Committed) -> Result<(), Error> {
        write_json(&self.home().join(COMMITTED), committed)?;
        publish(&self.result(), self.destination())?;
        self.settle(committed)
    }

    /// Keeps the result of the commit in the folder of the plan, and removes the pieces.
    pub(crate) fn settle(&self, committed: &Committed) -> Result<(), Error> {
        let kept = self.path.join(COMMITTED);
        let text = serde_json::to_vec_pretty(committed).expect("notes are numbers and texts");
        replace_file(&kept, &text).map_err(Error::io("write", &kept))?;
        let home = self.home();
        match ByPath.remove_dir_all(&home) {
            // A late worker may still write to the folder; its files are removed by the next commit of the plan.
            Err(error) if error.kind() == ErrorKind::DirectoryNotEmpty => Ok(()),
            removed => removed.map_err(Error::io("remove", &home)),
        }
    }

    /// The result of the commit to a folder of files; `None` if there was none. Completes a commit that was killed
    /// after the rename.
    pub(crate) fn published(&self) -> Result<Option<Committed>, Error> {
        let kept = self.path.join(COMMITTED);
        if kept.is_file() {
            return read_json(&kept).map(Some);
        }
        let before = self.home().join(COMMITTED);
        // A result that still exists was not published; the destination then belongs to another run.
        if !before.is_file() || self.result().exists() {
            return Ok(None);
        }
        let committed = read_json(&before)?;
        self.settle(&committed)?;
        Ok(Some(committed))
    }

    /// Whether the destination is a dataset; otherwise it is a folder of files.
    pub(crate) fn is_dataset(&self) -> bool {
        self.header.is_dataset
    }

    /// State of the destination.
    ///
    /// # Errors
    /// The destination exists but cannot be read.
    pub fn state(&self) -> Result<State, Error> {
        if !self.header.is_dataset {
            return Ok(match is_occupied(self.destination()) {
                false => State::Open,
                true if self.published()?.is_some() => State::Committed,
                true => State::Changed(0),
            });
        }
        let store = ByPath::store();
        let root = self.destination();
        let version = Staging::newest_version(store.as_ref(), root)?;
        if version == self.header.base {
            return Ok(State::Open);
        }
        let newest = Staging::newest(store.as_ref(), root)?;
        let mut plans = newest.iter().flat_map(|manifest| manifest.plans.values());
        Ok(match plans.any(|plan| plan == self.hash()) {
            true => State::Committed,
            false => State::Changed(version),
        })
    }

    /// Result of a commit of this plan, from the manifest that it wrote.
    pub fn committed(&self, manifest: &Manifest) -> Committed {
        let tables = manifest.tables.keys();
        Committed {
            destination: self.destination().to_owned(),
            already_committed: false,
            pieces: self.pieces.len() as u64,
            failed: 0,
            tables: tables
                .map(|table| (table.clone(), manifest.rows(table, None)))
                .collect(),
            accounting: (manifest.accounting.sources > 0).then(|| manifest.accounting.clone()),
            root_hash: manifest.root_hash.clone(),
            notes: Value::Null,
        }
    }

    /// Begins the commit of a dataset: locks the destination, then checks that it has not changed since the plan was
    /// made.
    ///
    /// # Errors
    /// Another run holds the destination, or it has another version now.
    pub fn begin(&self, options: &CommitOptions) -> Result<Transaction, Error> {
        let transaction = Transaction::begin(self.destination(), &options.holder)?;
        self.check_open()?;
        Ok(transaction)
    }

    /// Checks that the destination has not changed since the plan was made.
    ///
    /// # Errors
    /// The destination has another version now.
    pub fn check_open(&self) -> Result<(), Error> {
        match self.state()? {
            State::Open => Ok(()),
            State::Committed | State::Changed(_) if !self.header.is_dataset => Err(self.changed(0)),
            State::Committed | State::Changed(_) => {
                let store = ByPath::store();
                let now = Staging::newest_version(store.as_ref(), self.destination())?;
                Err(self.changed(now))
            }
        }
    }

    pub(crate) fn changed(&self, now: u64) -> Error {
        if !self.header.is_dataset {
            return Error::Occupied {
                path: self.header.destination.clone(),
            };
        }
        Error::StalePlan {
            path: self.path.clone(),
            destination: self.header.destination.clone(),
            base: self.header.base,
            now,
        }
    }
}
