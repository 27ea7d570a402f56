//! The document `config.json` of a run: written, read and compared.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use datasets_spec::Skeleton;
use datasets_spec::store::if_exists;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::config::rename_former;
use crate::error::json_error;
use crate::{Error, Session};

/// Version of the run folder's format.
pub const FORMAT: u32 = 1;

/// Version of burn, whose module tree decides the names of weights.
const BURN_VERSION: &str = "0.22.1";

/// Name of the record's file. A folder that contains it is a run.
pub const CONFIG: &str = "config.json";

/// Kind of a run folder with a motion encoder trained elsewhere, whose features do not depend on the skeleton.
pub(crate) const MOTION_KIND: &str = "tmr-motion";

/// Kind of the runs of MDM, whose features do not depend on the skeleton either.
pub(crate) const MDM_KIND: &str = "mdm";

/// [`RunRecord::dataset_hash`] of weights that were trained elsewhere, on unknown motions.
pub(crate) const IMPORTED: &str = "imported";

/// The document `config.json`: everything that a run depends on. `C` is the configuration type of the model's kind.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunRecord<C> {
    /// Version of the run folder's format.
    pub format: u32,
    /// Kind of model.
    pub kind: String,
    /// Versions of the programs that made the run, by name.
    pub versions: BTreeMap<String, String>,
    /// Hash of the tables that the model was trained on.
    pub dataset_hash: String,
    /// Name of the skeleton of the motions.
    pub skeleton: String,
    /// BLAKE3 of that skeleton's rest positions; none in runs of earlier versions, which recorded only the name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub skeleton_hash: Option<String>,
    /// Precision of the factors of matrix products in training, if it is not single precision: `bf16`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub precision: Option<String>,
    /// BLAKE3 of the file that the weights were imported from; none in runs that were trained, or imported by version 0.2
    /// or earlier.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub imported: Option<String>,
    /// Lineage of the weights, oldest first; empty for a run that was neither extended nor started from other weights.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lineage: Vec<Ancestor>,
    /// The resolved configuration, and parts fitted to the training split.
    pub config: C,
}

/// A step in the lineage of a checkpoint: weights that the run continued from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ancestor {
    /// How the run took over the weights.
    pub by: Inheritance,
    /// Hash of the weights: BLAKE3, hexadecimal.
    pub weights: String,
    /// Training step of the weights in their own run; 0 if that run records none, as imported runs do.
    pub step: u64,
    /// Settings that changed: name, value before and value after.
    pub changed: BTreeMap<String, [Value; 2]>,
}

/// How a run takes over earlier weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Inheritance {
    /// The same run continues with changed settings.
    Extend,
    /// A new run starts from the weights.
    Init,
}

/// The skeleton of a model, as its record names it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SkeletonId {
    /// Name of the skeleton.
    pub name: String,
    /// BLAKE3 of its rest positions; none in records of early versions.
    pub hash: Option<String>,
}

impl From<&Skeleton> for SkeletonId {
    fn from(skeleton: &Skeleton) -> Self {
        Self {
            name: skeleton.name().to_owned(),
            hash: Some(skeleton.hash()),
        }
    }
}

impl<C> RunRecord<C> {
    /// The record of a new run.
    pub fn new(kind: &str, dataset_hash: &str, skeleton: impl Into<SkeletonId>, config: C) -> Self {
        let SkeletonId { name, hash } = skeleton.into();
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
            skeleton: name,
            skeleton_hash: hash,
            precision: None,
            imported: None,
            lineage: Vec::new(),
            config,
        }
    }

    /// The skeleton of the motions.
    pub(crate) fn skeleton_id(&self) -> SkeletonId {
        SkeletonId {
            name: self.skeleton.clone(),
            hash: self.skeleton_hash.clone(),
        }
    }

    /// The record of a run that is trained in a session.
    pub(crate) fn trained_in(self, session: &Session<'_>) -> Self {
        let precision = session.arithmetic.bf16.then(|| "bf16".to_owned());
        Self { precision, ..self }
    }
}

/// Checks that the model of a run folder was trained on the given skeleton; `what` names the model in errors.
///
/// # Errors
/// The model was trained on another skeleton, or the folder is not a run.
pub fn check_skeleton(
    run_dir: &Path,
    what: &'static str,
    skeleton: &Skeleton,
) -> Result<(), Error> {
    check_skeleton_of(&config_of(run_dir)?, run_dir, what, skeleton)
}

/// The text of a run's `config.json`.
fn config_of(run_dir: &Path) -> Result<String, Error> {
    let path = run_dir.join(CONFIG);
    fs::read_to_string(&path).map_err(Error::io("read", &path))
}

/// The fields of `config.json` that are read without the model's configuration.
#[derive(Deserialize)]
struct Header {
    #[serde(default)]
    format: u32,
    kind: String,
    #[serde(default)]
    dataset_hash: String,
    #[serde(default)]
    skeleton: String,
    skeleton_hash: Option<String>,
}

impl Header {
    fn of(text: &str, run_dir: &Path) -> Result<Self, Error> {
        serde_json::from_str(text).map_err(json_error(&run_dir.join(CONFIG)))
    }

    /// Whether the model was trained elsewhere on features of one body, into which motions of any body are brought.
    fn takes_any_body(&self) -> bool {
        self.kind == MOTION_KIND || (self.kind == MDM_KIND && self.dataset_hash == IMPORTED)
    }
}

/// Checks the skeleton like [`check_skeleton`], but from the text of a run's `config.json`. Errors name the run by
/// `run_dir`.
///
/// # Errors
/// As [`check_skeleton`].
pub fn check_skeleton_of(
    text: &str,
    run_dir: &Path,
    what: &'static str,
    skeleton: &Skeleton,
) -> Result<(), Error> {
    let trained = Header::of(text, run_dir)?;
    if trained.takes_any_body() {
        return Ok(());
    }
    let hash = skeleton.hash();
    let fits = match &trained.skeleton_hash {
        Some(recorded) => *recorded == hash,
        None => trained.skeleton == skeleton.name(),
    };
    if fits {
        return Ok(());
    }
    let of = trained.skeleton_hash.as_deref();
    Err(Error::Refused(format!(
        "{what} in {} was trained on skeleton {} ({:.12}), and the motions are on {} ({hash:.12}); train one \
         on a dataset of theirs, or bring the motions to its skeleton with --body-model",
        run_dir.display(),
        trained.skeleton,
        of.unwrap_or("no hash"),
        skeleton.name(),
    )))
}

pub(crate) fn read_kind(run_dir: &Path) -> Result<String, Error> {
    Ok(Header::of(&config_of(run_dir)?, run_dir)?.kind)
}

/// Reads the record of a run of any kind, without interpreting its configuration.
///
/// # Errors
/// The folder is not a run, or has another format.
pub fn read_any(run_dir: &Path) -> Result<RunRecord<Value>, Error> {
    let text = config_of(run_dir)?;
    let record: RunRecord<Value> = serde_json::from_str(&text).map_err(|error| {
        let reason = format!("its {CONFIG} is of another program ({error})");
        Error::not_a_run(run_dir, "stance", reason)
    })?;
    check_format(record.format, run_dir, "stance")?;
    Ok(record)
}

fn check_format(format: u32, run_dir: &Path, kind: &str) -> Result<(), Error> {
    if format == FORMAT {
        return Ok(());
    }
    let reason = format!("it has format {format}, this program reads {FORMAT}");
    Err(Error::not_a_run(run_dir, kind, reason))
}

pub(crate) fn read_record<C: DeserializeOwned>(
    run_dir: &Path,
    kind: &str,
) -> Result<RunRecord<C>, Error> {
    let path = run_dir.join(CONFIG);
    let text = text_of(&path)?
        .ok_or_else(|| Error::not_a_run(run_dir, kind, format!("it holds no {CONFIG}")))?;
    record_of(&text, run_dir, kind)
}

/// The text of a file; none if the file does not exist.
pub(super) fn text_of(path: &Path) -> Result<Option<String>, Error> {
    if_exists(fs::read_to_string(path)).map_err(Error::io("read", path))
}

/// Parses the text of a run's `config.json`. Errors name the run by `run_dir`.
pub(crate) fn record_of<C: DeserializeOwned>(
    text: &str,
    run_dir: &Path,
    kind: &str,
) -> Result<RunRecord<C>, Error> {
    let header = Header::of(text, run_dir)?;
    if header.kind != kind {
        let reason = format!("it is a run of {:?}", header.kind);
        return Err(Error::not_a_run(run_dir, kind, reason));
    }
    check_format(header.format, run_dir, kind)?;
    parse_record(text).map_err(json_error(&run_dir.join(CONFIG)))
}

pub(super) fn parse_record<C: DeserializeOwned>(
    text: &str,
) -> Result<RunRecord<C>, serde_json::Error> {
    let mut record: Value = serde_json::from_str(text)?;
    rename_former(&mut record["config"]);
    if let Some(settings) = record["config"].get_mut("train") {
        rename_former(settings);
    }
    serde_json::from_value(record)
}

pub(super) fn to_value<T: Serialize>(document: &T) -> Result<Value, serde_json::Error> {
    serde_json::from_str(&serde_json::to_string(document)?)
}

/// The fields in which two documents differ, with both values. Program versions, imported file and lineage are not
/// compared.
pub(crate) fn differences(recorded: &Value, asked: &Value) -> BTreeMap<String, [Value; 2]> {
    fn walk(recorded: &Value, asked: &Value, path: &str, found: &mut BTreeMap<String, [Value; 2]>) {
        let (Value::Object(before), Value::Object(after)) = (recorded, asked) else {
            if recorded != asked {
                found.insert(path.to_owned(), [recorded.clone(), asked.clone()]);
            }
            return;
        };
        let names: std::collections::BTreeSet<&String> =
            before.keys().chain(after.keys()).collect();
        for name in names {
            let path = if path.is_empty() {
                name.clone()
            } else {
                format!("{path}.{name}")
            };
            if ["versions", "imported", "lineage"].contains(&path.as_str()) {
                continue;
            }
            let side = |document: &serde_json::Map<String, Value>| {
                document.get(name).cloned().unwrap_or(Value::Null)
            };
            walk(&side(before), &side(after), &path, found);
        }
    }
    let mut found = BTreeMap::new();
    walk(recorded, asked, "", &mut found);
    found
}
