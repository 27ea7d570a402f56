//! Plans on the disk.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::path::{Path, PathBuf};

use datasets_spec::dataset::Staging;
use datasets_spec::manifest::Manifest;
use datasets_spec::store::{ByPath, Store, is_url, temporary_beside};
use datasets_spec::table::{Row, read_rows, write_rows};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::Error;

/// Value of `format` in every plan.
const FORMAT: &str = "stance-plan";
/// Version of the files of a plan.
const VERSION: u32 = 1;
/// Program that makes and reads a plan. Another version could make other bytes.
const TOOL_VERSION: &str = concat!("stance ", env!("CARGO_PKG_VERSION"));
const HEADER: &str = "plan.json";
const PIECES: &str = "pieces.parquet";
/// Digits of an id.
const ID_DIGITS: usize = 32;

datasets_spec::table! {
    /// A piece of work: what one call of a worker makes.
    pub struct Piece = "pieces" {
        /// Hash of the plan and of what the piece reads, 32 hexadecimal digits
        pub id: String [""],
        /// Number from 0
        pub number: u64 [""],
        /// What it makes, such as motions/train-00000-of-00004
        pub name: String [""],
        /// Items in it: motions, windows, edits
        pub items: u64 [""],
        /// Bytes that it reads; 0 where all pieces read the same
        pub bytes: u64 ["B"],
        /// What its job needs to make it, as JSON
        pub detail: String [""],
    }
}

impl Piece {
    /// A piece of a plan. `reads` identifies what it reads beyond what the plan's hash covers.
    pub fn new<'a>(
        plan_hash: &str,
        number: usize,
        name: String,
        items: u64,
        reads: impl Iterator<Item = &'a str>,
    ) -> Self {
        let mut hasher = blake3::Hasher::new();
        let number = number as u64;
        let mut take = |part: &str| {
            hasher.update(&(part.len() as u64).to_le_bytes());
            hasher.update(part.as_bytes());
        };
        take(plan_hash);
        take(&number.to_string());
        take(&name);
        reads.for_each(take);
        Self {
            id: hasher.finalize().to_hex()[..ID_DIGITS].to_owned(),
            number,
            name,
            items,
            bytes: 0,
            detail: "null".to_owned(),
        }
    }

    /// The piece with what its job needs to make it.
    ///
    /// # Panics
    /// If the detail cannot be written as JSON, which is a bug in the job.
    #[must_use]
    pub fn with(self, bytes: u64, detail: &impl Serialize) -> Self {
        let detail = serde_json::to_string(detail).expect("details are numbers and texts");
        Self {
            bytes,
            detail,
            ..self
        }
    }

    /// What its job needs to make it.
    ///
    /// # Errors
    /// The detail is of another job.
    pub fn detail<T: DeserializeOwned>(&self) -> Result<T, Error> {
        serde_json::from_str(&self.detail).map_err(|error| Error::BadPlan {
            path: PathBuf::from(PIECES),
            reason: format!("piece {} has an unknown detail: {error}", self.name),
        })
    }
}

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
    /// Whether the destination is a dataset; else a folder of files.
    is_dataset: bool,
    plan_hash: String,
    /// Version of the dataset that the plan starts from; 0 for none.
    base: u64,
    /// Tables of that version.
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
    /// Its settings.
    pub settings: Value,
    /// Where the result goes.
    pub destination: PathBuf,
    /// Whether that is a dataset; else it is a folder of files.
    pub is_dataset: bool,
    /// Hash of everything that decides about the result.
    pub plan_hash: String,
    /// Number and tables of the version of the dataset that it starts from; 0 for none.
    pub base: (u64, BTreeSet<String>),
    /// The pieces, by number.
    pub pieces: Vec<Piece>,
}

/// Number and tables of the version that a plan starts from.
pub fn base_of(manifest: Option<&Manifest>) -> (u64, BTreeSet<String>) {
    let tables = manifest.into_iter().flat_map(|base| base.tables.keys());
    let version = manifest.map_or(0, |base| base.version);
    (version, tables.cloned().collect())
}

impl Draft {
    /// Writes the plan as a new folder, whole or not at all. `tables` writes what else belongs to it. A plan that
    /// is there already with the same hash stays.
    ///
    /// # Errors
    /// The folder holds something else, or cannot be written.
    pub fn write(
        self,
        out: &Path,
        tables: impl FnOnce(&Path) -> Result<(), Error>,
    ) -> Result<Plan, Error> {
        let destination = absolute(&self.destination)?;
        if out.exists() {
            match Plan::open(out) {
                Ok(plan)
                    if plan.header.plan_hash == self.plan_hash
                        && plan.header.destination == destination =>
                {
                    return Ok(plan);
                }
                _ => {
                    return Err(Error::Occupied {
                        path: out.to_owned(),
                    });
                }
            }
        }
        let folder = temporary_beside(&absolute(out)?);
        fs::create_dir_all(&folder).map_err(Error::io("create folder", &folder))?;
        let write = || {
            tables(&folder)?;
            let pieces = folder.join(PIECES);
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
            write_json(&folder.join(HEADER), &header)?;
            fs::rename(&folder, out).map_err(Error::io("rename to", out))
        };
        write().inspect_err(|_: &Error| {
            // What matters is reported already.
            let _removed = fs::remove_dir_all(&folder);
        })?;
        Plan::open(out)
    }
}

/// Writes a table of a plan.
pub(crate) fn write_table<R: Row>(path: &Path, rows: &[R]) -> Result<(), Error> {
    let file = File::create(path).map_err(Error::io("create", path))?;
    let file = write_rows(file, path, rows, &[])?;
    file.sync_all().map_err(Error::io("sync", path))
}

/// Writes a document of a plan.
pub(crate) fn write_json(path: &Path, value: &impl Serialize) -> Result<(), Error> {
    let text =
        serde_json::to_vec_pretty(value).map_err(|error| Error::io("write", path)(error.into()))?;
    fs::write(path, text).map_err(Error::io("write", path))
}

/// Reads a document of a plan.
pub(crate) fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T, Error> {
    let text = fs::read(path).map_err(Error::io("read", path))?;
    serde_json::from_slice(&text).map_err(|source| {
        Error::Spec(datasets_spec::Error::Json {
            path: path.to_owned(),
            source,
        })
    })
}

/// BLAKE3 of a file, hexadecimal.
pub(crate) fn hash_file(path: &Path) -> Result<String, Error> {
    ByPath.hash(path).map_err(Error::io("read", path))
}

/// A path that means the same for every worker.
///
/// # Errors
/// The path is empty, or the current folder is gone.
pub fn absolute(path: &Path) -> Result<PathBuf, Error> {
    if is_url(path) {
        return Ok(path.to_owned());
    }
    std::path::absolute(path).map_err(Error::io("find", path))
}

/// Where the destination of a plan stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// It is as it was when the plan was made.
    Open,
    /// The plan was committed.
    Committed,
    /// It has another version now, of this number.
    Changed(u64),
}

/// A plan that was made.
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
    /// It is none, it is of another version of the program, or it was altered.
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

    /// The job, as the command line names it.
    pub fn job(&self) -> &str {
        &self.header.job
    }

    /// Hash of everything that decides about the result.
    pub fn hash(&self) -> &str {
        &self.header.plan_hash
    }

    /// Where the result goes.
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

    /// The settings of the job.
    ///
    /// # Errors
    /// They are those of another job.
    pub fn settings<T: DeserializeOwned>(&self) -> Result<T, Error> {
        serde_json::from_value(self.header.settings.clone()).map_err(|error| Error::BadPlan {
            path: self.path.clone(),
            reason: format!("{HEADER}: {error}"),
        })
    }

    /// Where the pieces are staged.
    pub fn staging(&self) -> Staging {
        let base = (self.header.base, self.header.base_tables.clone());
        Staging::of_plan(ByPath::store(), self.home(), base, self.hash())
    }

    /// The folder that pieces are staged in: the dataset, or one beside the folder of files.
    pub(crate) fn home(&self) -> &Path {
        &self.header.destination
    }

    /// Where the destination stands.
    ///
    /// # Errors
    /// The destination is there and cannot be read.
    pub fn state(&self) -> Result<State, Error> {
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

    /// Checks that the destination is as it was when the plan was made.
    ///
    /// # Errors
    /// It has another version now.
    pub fn check_open(&self) -> Result<(), Error> {
        match self.state()? {
            State::Open => Ok(()),
            State::Committed | State::Changed(_) => {
                let store = ByPath::store();
                let now = Staging::newest_version(store.as_ref(), self.destination())?;
                Err(self.changed(now))
            }
        }
    }

    pub(crate) fn changed(&self, now: u64) -> Error {
        Error::StalePlan {
            path: self.path.clone(),
            destination: self.header.destination.clone(),
            base: self.header.base,
            now,
        }
    }
}
