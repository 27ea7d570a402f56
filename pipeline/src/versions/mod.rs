//! Versions of a dataset: listing them, going back to one, and making versions with fewer files or fewer clips.
//!
//! Every change of a dataset is a new version, and the one before stays until it is pruned. Labels that people made are
//! only lost if the caller allows it: otherwise the change is refused, and the labels that it would drop are listed.

mod choose;
mod compact;
mod labels;
mod remove;
mod restore;
mod rows;
mod select;

use std::collections::BTreeMap;
use std::path::Path;

use datasets_spec::manifest::Manifest;
use datasets_spec::record::MotionRow;
use datasets_spec::table::Row;
use datasets_spec::{Dataset, Transaction};
use serde::Serialize;

use crate::Error;

pub use self::choose::{Choice, taken_out};
pub use self::compact::{Compacted, Layout, compact};
pub use self::labels::KeptLabel;
pub(crate) use self::labels::{
    Labels, check_lost, is_mask_of_people, is_mask_of_source, is_pair_judged, is_pair_of_people,
    is_pair_of_source,
};
pub use self::remove::{Removed, removable, remove};
pub use self::restore::{Restored, restore};
pub(crate) use self::select::composed;
pub use self::select::{SELECTED_FACT, Selected, select};

/// A version of a dataset.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Version {
    /// Number of the version.
    pub version: u64,
    /// Whether readers of the dataset get this version.
    pub current: bool,
    /// Number of clips.
    pub clips: u64,
    /// Rows of each table.
    pub tables: BTreeMap<String, u64>,
    /// Files of all tables.
    pub files: u64,
    /// Total size of the files in bytes.
    pub bytes: u64,
    /// Tables whose files differ from those of the previous version, with their numbers of rows before and now; for the
    /// oldest version, all tables.
    pub changed: BTreeMap<String, [u64; 2]>,
    /// Program and version that wrote it.
    pub tool_version: String,
    /// Root hash of the version.
    pub root_hash: String,
}

/// Begins a change of a dataset. `holder` is reported to other runs meanwhile.
///
/// # Errors
/// The folder is no dataset, or is locked.
pub fn begin(root: &Path, holder: &str) -> Result<Transaction, Error> {
    // Open the dataset first: locking would create a missing folder.
    Dataset::open_unverified(root)?;
    Ok(Transaction::begin(root, holder)?)
}

/// The versions of a dataset that were not pruned, the oldest first.
///
/// # Errors
/// The folder is no dataset, or a manifest cannot be read.
pub fn list(root: &Path) -> Result<Vec<Version>, Error> {
    let manifests = Dataset::versions(root)?;
    let before = std::iter::once(None).chain(manifests.iter().map(Some));
    let newest = manifests.last().map_or(0, |newest| newest.version);
    let versions = manifests.iter().zip(before);
    Ok(versions
        .map(|(manifest, before)| Version::of(manifest, before, newest))
        .collect())
}

impl Version {
    fn of(manifest: &Manifest, before: Option<&Manifest>, newest: u64) -> Self {
        let files = manifest.tables.values().flatten();
        let names = |manifest: &Manifest| manifest.tables.keys().cloned().collect::<Vec<_>>();
        let mut tables = names(manifest);
        tables.extend(before.map(names).unwrap_or_default());
        let was = |table: &str| before.and_then(|before| before.tables.get(table));
        let changed = tables
            .into_iter()
            .filter(|table| was(table) != manifest.tables.get(table))
            .map(|table| {
                let then = before.map_or(0, |before| before.rows(&table, None));
                let now = manifest.rows(&table, None);
                (table, [then, now])
            });
        Self {
            version: manifest.version,
            current: manifest.version == newest,
            clips: manifest.rows(MotionRow::TABLE, None),
            tables: manifest.row_counts(),
            files: files.clone().count() as u64,
            bytes: files.map(|file| file.bytes).sum(),
            changed: changed.collect(),
            tool_version: manifest.tool_version.clone(),
            root_hash: manifest.root_hash.clone(),
        }
    }
}
