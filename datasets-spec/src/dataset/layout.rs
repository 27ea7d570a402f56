//! Names of a dataset's folders, and its manifests.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use crate::manifest::{FORMAT, Manifest};
use crate::record::all_tables;
use crate::store::{Store, if_exists, is_url};
use crate::table::check_version;
use crate::{Error, Split, card, croissant};

pub(super) const META: &str = "meta";
pub(super) const DATA: &str = "data";
pub(super) const STAGED: &str = "staged";
/// Begin of the names of the files of a table without splits.
const UNSPLIT: &str = "all";
/// Folder of files that the newest version does not name.
pub(super) const ASIDE: &str = "meta/aside";
/// Folder for data of this copy of a dataset only, such as the paths of its sources. No manifest names its files.
pub const PRIVATE: &str = ".stance";
/// Key of the fact that holds a skeleton that is not built in.
pub(super) const SKELETON_FACT: &str = "skeleton_rest";

pub(super) fn manifest_path(root: &Path, version: u64) -> PathBuf {
    root.join(META).join(format!("manifest-{version}.json"))
}

pub(super) fn read_newest(store: &dyn Store, root: &Path) -> Result<Option<Manifest>, Error> {
    let Some(version) = manifest_versions(store, root)?.pop() else {
        return Ok(None);
    };
    read_manifest(store, root, version).map(Some)
}

pub(super) fn manifest_versions(store: &dyn Store, root: &Path) -> Result<Vec<u64>, Error> {
    let meta = root.join(META);
    let entries = if_exists(store.list(&meta)).map_err(Error::io("list", meta))?;
    let mut versions = Vec::new();
    for (path, _) in entries.unwrap_or_default() {
        let version: Option<u64> = path.file_name().and_then(|name| {
            name.to_str()?
                .strip_prefix("manifest-")?
                .strip_suffix(".json")?
                .parse()
                .ok()
        });
        versions.extend(version);
    }
    versions.sort_unstable();
    Ok(versions)
}

/// Checks that a folder is a dataset, or that a first commit to it replaces no file of the user's.
///
/// # Errors
/// The folder is no dataset and holds such a file, or it cannot be listed.
pub(super) fn check_free(store: &dyn Store, root: &Path) -> Result<(), Error> {
    let is_dataset = || manifest_versions(store, root).map(|versions| !versions.is_empty());
    if is_dataset()? {
        return Ok(());
    }
    match occupant(store, root)? {
        // Another run may have committed a first version meanwhile.
        Some(file) if !is_dataset()? => Err(Error::Occupied {
            path: root.to_owned(),
            problem: format!(
                "is no dataset and holds {file}, which a dataset there would replace or mix with its own; name a new \
                 folder, or move that file away"
            ),
        }),
        _ => Ok(()),
    }
}

/// Settings of a training run, beside which a dataset would stand: the run could not go on.
const CONFIG_OF_RUN: &str = "config.json";

/// A file that the first commit to a folder would replace or stand beside, or a Parquet file under its `data`, where an interrupted
/// first run leaves none. At a URL, such a run leaves some, and no run replaces or removes others.
fn occupant(store: &dyn Store, root: &Path) -> Result<Option<String>, Error> {
    for name in [card::FILE, croissant::FILE, CONFIG_OF_RUN] {
        let path = root.join(name);
        let size = if_exists(store.size(&path)).map_err(Error::io("read", path))?;
        if size.is_some() {
            return Ok(Some(name.to_owned()));
        }
    }
    if is_url(root) {
        return Ok(None);
    }
    let data = root.join(DATA);
    let files = if_exists(store.files_below(&data)).map_err(Error::io("list", data))?;
    let files = files.unwrap_or_default();
    let is_table = |file: &&PathBuf| file.extension().is_some_and(|end| end == "parquet");
    Ok(files.iter().find(is_table).map(|file| {
        let relative = file.strip_prefix(root).unwrap_or(file);
        relative.display().to_string()
    }))
}

/// Whether a path relative to a dataset is one that this program gives to a file of a table:
/// `data/<table>/<split>-<i>-of-<n>.parquet`, where a version and a number may follow `<n>`.
pub(super) fn is_shard(relative: &str) -> bool {
    let parts: Vec<&str> = relative.split('/').collect();
    let [DATA, table, name] = parts[..] else {
        return false;
    };
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    let mut stem = name.strip_suffix(".parquet").unwrap_or("").split('.');
    let shard: Vec<&str> = stem.next().unwrap_or("").split('-').collect();
    let [split, index, "of", of] = shard[..] else {
        return false;
    };
    (split == UNSPLIT || split.parse::<Split>().is_ok())
        && is_number(index)
        && is_number(of)
        && stem.all(|part| is_number(part.strip_prefix('v').unwrap_or(part)))
        && all_tables().iter().any(|(known, _)| *known == table)
}

/// Returns the names of all tables in a version and in those older versions that were not pruned.
pub(super) fn tables_until(
    store: &dyn Store,
    root: &Path,
    newest: Option<&Manifest>,
) -> Result<BTreeSet<String>, Error> {
    let Some(newest) = newest else {
        return Ok(BTreeSet::new());
    };
    let mut tables: BTreeSet<String> = newest.tables.keys().cloned().collect();
    for version in manifest_versions(store, root)? {
        if version < newest.version {
            tables.extend(read_manifest(store, root, version)?.tables.into_keys());
        }
    }
    Ok(tables)
}

pub(super) fn read_manifest(
    store: &dyn Store,
    root: &Path,
    version: u64,
) -> Result<Manifest, Error> {
    let path = manifest_path(root, version);
    let text = store.read(&path).map_err(Error::io("read", &path))?;
    let manifest: Manifest = serde_json::from_slice(&text).map_err(Error::json(&path))?;
    if manifest.format != FORMAT {
        return Err(Error::NotADataset {
            path,
            reason: format!("its manifest says format {:?}", manifest.format),
        });
    }
    check_version(&path, &manifest.schema_version)?;
    let expected = Manifest::compute_root_hash(&manifest.tables);
    if expected != manifest.root_hash {
        return Err(Error::Corrupt {
            path,
            detail: format!("root hash {} does not cover its files", manifest.root_hash),
        });
    }
    Ok(manifest)
}

/// Position of a shard among those of its table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ShardName {
    /// Table.
    pub table: &'static str,
    /// Split; `None` for tables without splits.
    pub split: Option<Split>,
    /// Number of the shard, from 0.
    pub index: usize,
    /// Number of shards of this table and split.
    pub of: usize,
}

impl std::fmt::Display for ShardName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let split = self.split.map_or(UNSPLIT, Split::as_str);
        write!(f, "{split}-{:05}-of-{:05}", self.index, self.of)
    }
}

/// Folder of the staged shards of a plan that starts from version `base`.
pub(super) fn staged_folder(root: &Path, base: u64, plan_hash: &str) -> PathBuf {
    let name = format!("{base}-{plan_hash}");
    root.join(META).join(STAGED).join(name)
}
