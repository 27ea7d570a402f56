//! The manifest: the files of a dataset and their hashes.

use std::collections::{BTreeMap, BTreeSet};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::rejected::RejectedMasks;
use crate::{Digest, Error, MotionId, Split};

/// Key of the fact that names the label by which splits were drawn, such as `subject`: clips with the same value of the
/// label are in the same split.
pub const SPLIT_BY_FACT: &str = "split_by";

/// Key of the fact that lists, as JSON, source and target of the pairs that people judged unusable, by annotation
/// project. It stays when a dataset grows; see [`Manifest::rejected_pairs`].
pub const REJECTED_PAIRS_FACT: &str = "rejected_pairs";

/// Key of the fact that lists, as JSON, the masks that people rejected, by annotation project or reviewer. It stays when a
/// dataset grows; see [`Manifest::rejected_masks`].
pub const REJECTED_MASKS_FACT: &str = "rejected_masks";

/// Beginning of the keys of facts that say what annotation projects wrote into a dataset. They stay when it grows.
pub const ANNOTATE_FACTS: &str = "annotate_";
/// Fact with the store of the annotation project that exported last.
pub const ANNOTATE_STORE_FACT: &str = "annotate_store";
/// Fact with the point in the log of that store from which the tables were exported.
pub const ANNOTATE_SEQ_FACT: &str = "annotate_seq";
/// Fact with the last point in that log from which a version since restored to an older one was exported: labels of
/// people until then may be in the dataset.
pub const ANNOTATE_KNOWN_FACT: &str = "annotate_seq_known";

/// The type of [`Manifest::rejected_pairs`].
pub type RejectedPairs = BTreeMap<String, BTreeSet<[MotionId; 2]>>;

/// Adds rejections, by project or reviewer, to the lists of the same projects and reviewers.
pub fn add_rejected<T: Ord>(
    all: &mut BTreeMap<String, BTreeSet<T>>,
    more: impl IntoIterator<Item = (String, BTreeSet<T>)>,
) {
    for (project, rejected) in more {
        all.entry(project).or_default().extend(rejected);
    }
}

/// Value of `format` in every manifest.
pub const FORMAT: &str = "stance-dataset";

/// Key of the fact that lists, as JSON, the tables whose rows were written unchanged into other files; see
/// [`Manifest::content_hash`].
pub const LAID_OUT_FACT: &str = "laid_out";

/// BLAKE3 of the files that rows were rewritten into, and of the files that held them before.
#[derive(Debug, Default, Serialize, Deserialize)]
struct LaidOut {
    now: Vec<String>,
    before: Vec<String>,
}

/// One committed version of a dataset. Readers open the highest version; data files are never found by
/// listing folders. The default is no valid manifest: a first commit fills it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// Always [`FORMAT`].
    pub format: String,
    /// Version of the table schemas (`table::SCHEMA_VERSION`).
    pub schema_version: String,
    /// Number of this manifest, from 1.
    pub version: u64,
    /// Program and version that wrote the manifest.
    pub tool_version: String,
    /// Name of the skeleton every motion is posed on.
    pub skeleton: String,
    /// Files of each table.
    pub tables: BTreeMap<String, Vec<FileEntry>>,
    /// Hash of the plan that made each table: a rerun of the same plan has nothing to do.
    pub plans: BTreeMap<String, String>,
    /// Counts of the source files.
    pub accounting: Accounting,
    /// Further facts of the runs, such as seed and rate.
    pub facts: BTreeMap<String, String>,
    /// BLAKE3 over table names, paths and file hashes: equal for equal datasets.
    pub root_hash: String,
}

/// A file of a table.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileEntry {
    /// Path relative to the dataset, with forward slashes.
    pub path: String,
    /// Split of its rows; `None` for tables without splits.
    pub split: Option<Split>,
    /// Number of rows.
    pub rows: u64,
    /// Size in bytes.
    pub bytes: u64,
    /// BLAKE3 of the file, hexadecimal.
    pub blake3: String,
    /// SHA-256 of the file, hexadecimal, for catalogues without BLAKE3; empty in datasets of format 1.0.0.
    #[serde(default)]
    pub sha256: String,
}

impl FileEntry {
    /// The name of the file, without its folders.
    pub fn name(&self) -> &str {
        self.path.rsplit('/').next().unwrap_or(&self.path)
    }
}

/// Counts of the source files: `sources = ingested + quarantined + skipped`, always.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Accounting {
    /// Files found.
    pub sources: u64,
    /// Files that became rows.
    pub ingested: u64,
    /// Files rejected with a code and a reason.
    pub quarantined: u64,
    /// Files that hold no motion, such as captions.
    pub skipped: u64,
    /// Rejections by code.
    pub codes: BTreeMap<String, u64>,
}

impl Accounting {
    /// Makes the counts from the number of ingested files, the number of skipped files, and the codes of the rejected
    /// ones.
    pub fn of(ingested: u64, skipped: u64, rejected: impl IntoIterator<Item = String>) -> Self {
        let mut codes: BTreeMap<String, u64> = BTreeMap::new();
        for code in rejected {
            *codes.entry(code).or_default() += 1;
        }
        let quarantined = codes.values().sum::<u64>();
        Self {
            sources: ingested + quarantined + skipped,
            ingested,
            quarantined,
            skipped,
            codes,
        }
    }

    /// Whether every source is accounted for.
    pub fn balances(&self) -> bool {
        self.sources == self.ingested + self.quarantined + self.skipped
            && self.quarantined == self.codes.values().sum::<u64>()
    }
}

/// Hash of the inputs of a stage, recorded with the table that the stage writes. A stage whose plan is already recorded
/// does nothing.
pub fn plan_hash<T: Serialize>(stage: &str, inputs: &T) -> String {
    let text = serde_json::to_string(&(stage, env!("CARGO_PKG_VERSION"), inputs))
        .expect("settings are plain numbers, texts and lists of them");
    blake3::hash(text.as_bytes()).to_hex().to_string()
}

impl Manifest {
    /// Hash of the plan that made a table; empty if it is not recorded. A stage that depends only on this table need
    /// not run again when another table changes.
    pub fn plan(&self, table: &str) -> &str {
        self.plans.get(table).map_or("", String::as_str)
    }

    /// A fact that is kept as JSON; the default if it is missing.
    ///
    /// # Errors
    /// It is of another form, as one that a later version wrote may be.
    pub fn fact<T: DeserializeOwned + Default>(&self, name: &str) -> Result<T, Error> {
        let Some(text) = self.facts.get(name) else {
            return Ok(T::default());
        };
        serde_json::from_str(text).map_err(|error| {
            Error::Refused(format!(
                "the manifest of version {} states {name} in a form that this program does not know ({error}); use the \
                 version of stance that wrote it, or a later one",
                self.version
            ))
        })
    }

    /// Source and target of the pairs that people judged unusable, by annotation project: no stage makes them again. The
    /// name of the project is empty for a list of version 0.2 or earlier, which does not say whose it is.
    ///
    /// # Errors
    /// As [`Manifest::fact`].
    pub fn rejected_pairs(&self) -> Result<RejectedPairs, Error> {
        self.fact(REJECTED_PAIRS_FACT).or_else(|error| {
            let list: BTreeSet<[MotionId; 2]> =
                self.fact(REJECTED_PAIRS_FACT).map_err(|_| error)?;
            Ok(RejectedPairs::from([(String::new(), list)]))
        })
    }

    /// The masks that people rejected; [`Dataset::rejections`] finds those that hold.
    ///
    /// # Errors
    /// As [`Manifest::fact`].
    ///
    /// [`Dataset::rejections`]: crate::Dataset::rejections
    pub fn rejected_masks(&self) -> Result<RejectedMasks, Error> {
        self.fact(REJECTED_MASKS_FACT)
    }

    /// Computes the root hash of all files.
    pub fn compute_root_hash(tables: &BTreeMap<String, Vec<FileEntry>>) -> String {
        let mut digest = Digest::default();
        for (table, files) in tables {
            let mut files: Vec<&FileEntry> = files.iter().collect();
            files.sort_by(|a, b| a.path.cmp(&b.path));
            for file in files {
                digest.part(table);
                digest.part(&file.path);
                digest.part(&file.blake3);
            }
        }
        digest.hex()
    }

    /// BLAKE3 over the files of some tables, in hexadecimal. It depends only on these tables, and does not change when
    /// their rows are written into fewer files ([`Manifest::laid_out`]).
    pub fn content_hash(&self, tables: &[&str]) -> String {
        let mut digest = Digest::default();
        for (table, files) in &self.tables {
            if !tables.contains(&table.as_str()) {
                continue;
            }
            for hash in self.contents(table, files) {
                digest.part(table);
                digest.part(&hash);
            }
        }
        digest.hex()
    }

    /// BLAKE3 of the files that a table's rows were first written to.
    fn contents(&self, table: &str, files: &[FileEntry]) -> Vec<String> {
        let now = hashes(files);
        let fact = self.facts.get(LAID_OUT_FACT);
        let mut laid_out: BTreeMap<String, LaidOut> = fact
            .and_then(|text| serde_json::from_str(text).ok())
            .unwrap_or_default();
        match laid_out.remove(table) {
            Some(laid_out) if laid_out.now == now => laid_out.before,
            _ => now,
        }
    }

    /// The value of [`LAID_OUT_FACT`] for a version that holds the rows of `tables` in other files than this version.
    pub fn laid_out(&self, tables: &BTreeMap<String, Vec<FileEntry>>) -> String {
        let laid_out: BTreeMap<&String, LaidOut> = self
            .tables
            .iter()
            .map(|(table, files)| {
                let laid_out = LaidOut {
                    now: hashes(tables.get(table).unwrap_or(files)),
                    before: self.contents(table, files),
                };
                (table, laid_out)
            })
            .filter(|(_, laid_out)| laid_out.now != laid_out.before)
            .collect();
        serde_json::to_string(&laid_out).expect("texts serialise")
    }

    /// Number of rows of each table.
    pub fn row_counts(&self) -> BTreeMap<String, u64> {
        let rows = |table: &String| (table.clone(), self.rows(table, None));
        self.tables.keys().map(rows).collect()
    }

    /// Number of rows of a table, or of one split of it.
    pub fn rows(&self, table: &str, split: Option<Split>) -> u64 {
        self.tables
            .get(table)
            .into_iter()
            .flatten()
            .filter(|file| split.is_none() || file.split == split)
            .map(|file| file.rows)
            .sum()
    }
}

/// BLAKE3 of the files that hold rows, in the order of their paths.
fn hashes(files: &[FileEntry]) -> Vec<String> {
    let mut files: Vec<&FileEntry> = files.iter().filter(|file| file.rows > 0).collect();
    files.sort_by(|a, b| a.path.cmp(&b.path));
    files.into_iter().map(|file| file.blake3.clone()).collect()
}
