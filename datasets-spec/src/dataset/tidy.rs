//! Places of the files of each version, and pruning.
//!
//! The files of the newest version lie under `data/`, and no others of the program do, so that a search for Parquet
//! files finds its rows once. Files of older versions, and files that a run has written but not committed, lie aside
//! (see [`aside`]). Readers find a file in either place, so a run may be killed between its commit and the moves that
//! follow; the next run completes them.

use std::collections::{BTreeMap, BTreeSet};
use std::io::ErrorKind;
use std::path::Path;

use serde::Serialize;

use super::layout::{
    ASIDE, DATA, META, PRIVATE, STAGED, is_shard, manifest_path, manifest_versions, read_manifest,
};
use super::transaction::Transaction;
use crate::manifest::Manifest;
use crate::store::{Store, aside, create_folder, if_exists, is_temporary, write_bytes};
use crate::{Error, card, croissant};

/// Names and texts of the files in a dataset's root that describe it. They are made from its manifest only.
pub fn descriptions(manifest: &Manifest) -> [(&'static str, String); 2] {
    [
        (card::FILE, card::text(manifest)),
        (croissant::FILE, croissant::text(manifest)),
    ]
}

/// Result of [`Transaction::prune`], or what it would remove.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Pruned {
    /// Versions that were removed.
    pub versions: Vec<u64>,
    /// Number of data files that no version names any more.
    pub files: u64,
    /// Total size of these files in bytes.
    pub bytes: u64,
}

/// The files that some versions name, with their sizes.
fn files_of(
    store: &dyn Store,
    root: &Path,
    versions: &[u64],
) -> Result<BTreeMap<String, u64>, Error> {
    let mut files = BTreeMap::new();
    for version in versions {
        let manifest = read_manifest(store, root, *version)?;
        let entries = manifest.tables.into_values().flatten();
        files.extend(entries.map(|file| (file.path, file.bytes)));
    }
    Ok(files)
}

/// What [`Transaction::prune`] would remove.
///
/// # Errors
/// A manifest cannot be read.
pub fn prunable(store: &dyn Store, root: &Path, keep: usize) -> Result<Pruned, Error> {
    let files_of = |versions: &[u64]| files_of(store, root, versions);
    let mut versions = manifest_versions(store, root)?;
    let kept = versions.split_off(versions.len().saturating_sub(keep.max(1)));
    let (mut old, named) = (files_of(&versions)?, files_of(&kept)?);
    old.retain(|path, _| !named.contains_key(path));
    Ok(Pruned {
        versions,
        files: old.len() as u64,
        bytes: old.values().sum(),
    })
}

impl Transaction {
    /// Completes a run that was killed right after its commit: moves data files to their places, writes the files that
    /// derive from the manifest, and removes those that no manifest names.
    ///
    /// # Errors
    /// A file cannot be written or removed; the dataset itself is whole.
    pub fn finish(self) -> Result<(), Error> {
        match self.base() {
            Some(manifest) => self.settle(manifest),
            None => Ok(()),
        }
    }

    /// Removes all versions but the newest `keep` (at least one), and data files that only these versions name. At a URL
    /// no other run may write meanwhile: its uncommitted files would be removed.
    ///
    /// # Errors
    /// A manifest cannot be read, or a file cannot be removed.
    pub fn prune(self, keep: usize) -> Result<Pruned, Error> {
        let pruned = prunable(self.store.as_ref(), &self.root, keep)?;
        // A version without a manifest does not exist, so remove manifests first.
        for version in &pruned.versions {
            self.remove(&manifest_path(&self.root, *version))?;
        }
        self.remove_staged(None)?;
        self.remove_unnamed()?;
        Ok(pruned)
    }

    /// Moves the files of a committed version to their places, writes the files that derive from its manifest, and
    /// removes files that no version names.
    pub(super) fn settle(&self, manifest: &Manifest) -> Result<(), Error> {
        self.arrange(manifest)?;
        for (name, text) in descriptions(manifest) {
            let path = self.root.join(name);
            // An unreadable file is rewritten like one that differs.
            if self.store.read(&path).ok().as_deref() == Some(text.as_bytes()) {
                continue;
            }
            write_bytes(self.store.as_ref(), &path, text.as_bytes())?;
        }
        if self.is_alone() {
            self.remove_staged(None)?;
            self.remove_unnamed()
        } else {
            // Files that no manifest names may belong to a run that has not committed yet.
            self.remove_staged(Some(manifest))
        }
    }

    /// Moves files that only older versions name aside, and those of the newest version to their places.
    pub(super) fn arrange(&self, newest: &Manifest) -> Result<(), Error> {
        let files = newest.tables.values().flatten();
        let named: BTreeSet<&str> = files.map(|file| file.path.as_str()).collect();
        let placed = self.files_below(DATA)?;
        let mut others = placed
            .into_iter()
            .filter(|relative| relative.ends_with(".parquet") && !named.contains(relative.as_str()))
            .peekable();
        if others.peek().is_some() {
            let mut versions = manifest_versions(self.store.as_ref(), &self.root)?;
            versions.retain(|version| *version < newest.version);
            let older = files_of(self.store.as_ref(), &self.root, &versions)?;
            for relative in others.filter(|relative| older.contains_key(relative)) {
                let place = self.root.join(&relative);
                if let Some(aside) = aside(&place) {
                    self.move_file(&place, &aside)?;
                }
            }
        }
        let waiting: BTreeSet<String> = self.files_below(ASIDE)?.into_iter().collect();
        for relative in named
            .into_iter()
            .filter(|path| waiting.contains(&beside(path)))
        {
            self.move_file(&self.root.join(beside(relative)), &self.root.join(relative))?;
        }
        Ok(())
    }

    fn move_file(&self, from: &Path, to: &Path) -> Result<(), Error> {
        if let Some(folder) = to.parent() {
            create_folder(self.store.as_ref(), folder)?;
        }
        match self.store.rename(from, to) {
            // On storage without locks, another run may have moved the file already.
            Err(error) if error.kind() == ErrorKind::NotFound && !self.is_alone() => Ok(()),
            moved => moved.map_err(Error::io("move into place", to)),
        }
    }

    /// Removes the staged files of plans that start from an earlier version or, if `of` is given, of the plans that
    /// made its tables.
    fn remove_staged(&self, of: Option<&Manifest>) -> Result<(), Error> {
        let newest = manifest_versions(self.store.as_ref(), &self.root)?.pop();
        let staged = self.root.join(META).join(STAGED);
        let folders = if_exists(self.store.list(&staged)).map_err(Error::io("list", &staged))?;
        for (folder, _) in folders.unwrap_or_default() {
            let name = folder.file_name().unwrap_or_default().to_string_lossy();
            let (base, plan) = name.split_once('-').unwrap_or_default();
            let is_over = match of {
                Some(of) => of.plans.values().any(|made_by| made_by == plan),
                None => base.parse().ok().is_none_or(|base| Some(base) < newest),
            };
            if !is_over {
                continue;
            }
            match self.store.remove_dir_all(&folder) {
                // A late worker may still write to the folder; its files are removed by the next commit.
                Err(error) if error.kind() == ErrorKind::DirectoryNotEmpty => {}
                removed => removed.map_err(Error::io("remove", &folder))?,
            }
        }
        Ok(())
    }

    /// Removes files of tables that no manifest names. Other files under `data/` are the user's.
    fn remove_unnamed(&self) -> Result<(), Error> {
        let versions = manifest_versions(self.store.as_ref(), &self.root)?;
        let named = files_of(self.store.as_ref(), &self.root, &versions)?;
        let aside: BTreeSet<String> = named.keys().map(|path| beside(path)).collect();
        for relative in self.files_below(DATA)? {
            if is_shard(&relative) && !named.contains_key(&relative) {
                self.remove(&self.root.join(relative))?;
            }
        }
        for relative in self.files_below(ASIDE)? {
            if !aside.contains(&relative) {
                self.remove(&self.root.join(relative))?;
            }
        }
        Ok(())
    }

    /// Removes half-written files of a killed run. Staged files stay, because their writers hold no lock. In the
    /// dataset's root, only half-written cards and Croissant files are removed: others may be the user's.
    pub(super) fn remove_half_written(&self) -> Result<(), Error> {
        let ours = |name: &str| {
            let mut files = [card::FILE, croissant::FILE].into_iter();
            files.any(|file| name.starts_with(&format!(".{file}.")))
        };
        let folders = [DATA, META, PRIVATE].map(|folder| self.files_below(folder));
        for relative in folders.into_iter().collect::<Result<Vec<_>, _>>()?.concat() {
            if is_temporary(relative.rsplit('/').next().unwrap_or(&relative)) {
                self.remove(&self.root.join(relative))?;
            }
        }
        let root = self.store.list(&self.root);
        for (path, _) in root.map_err(Error::io("list", &self.root))? {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            if is_temporary(&name) && ours(&name) {
                self.remove(&path)?;
            }
        }
        Ok(())
    }

    fn remove(&self, path: &Path) -> Result<(), Error> {
        self.store
            .remove_file(path)
            .map_err(Error::io("remove", path))
    }

    /// Paths of the files below a folder of the dataset, relative to the dataset, without those that are staged.
    fn files_below(&self, folder: &str) -> Result<Vec<String>, Error> {
        let mut files = Vec::new();
        let mut folders = vec![folder.to_owned()];
        while let Some(folder) = folders.pop() {
            let path = self.root.join(&folder);
            let entries = if_exists(self.store.list(&path)).map_err(Error::io("list", &path))?;
            for (path, is_dir) in entries.unwrap_or_default() {
                let name = path.file_name().unwrap_or_default().to_string_lossy();
                let relative = format!("{folder}/{name}");
                if !is_dir {
                    files.push(relative);
                } else if relative != format!("{META}/{STAGED}") {
                    folders.push(relative);
                }
            }
        }
        Ok(files)
    }
}

/// Path of a file while it is kept aside. Both paths are relative to the dataset.
fn beside(relative: &str) -> String {
    let below = relative.strip_prefix(DATA).unwrap_or(relative);
    format!("{ASIDE}{}", below.strip_suffix(".parquet").unwrap_or(below))
}
