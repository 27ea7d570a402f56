//! Datasets opened for reading.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rayon::prelude::*;

use super::layout::{SKELETON_FACT, check_free, manifest_versions, read_manifest, read_newest};
use crate::manifest::{FileEntry, Manifest};
use crate::record::{ItemRow, MotionRow};
use crate::rejected::{RejectedMasks, Rejections};
use crate::store::{ByPath, Store, is_url};
use crate::table::{self, Row};
use crate::{Digest, Error, MotionId, Skeleton, Split};

/// A dataset opened for reading, in a folder or at a URL.
#[derive(Clone, Debug)]
pub struct Dataset {
    root: PathBuf,
    manifest: Manifest,
    store: Arc<dyn Store>,
    chosen: Option<Arc<Chosen>>,
}

#[derive(Debug)]
struct Chosen {
    condition: String,
    clips: BTreeSet<MotionId>,
}

impl Dataset {
    /// Makes a dataset of a manifest that was read, and tells the store the size and hash of each file.
    pub(super) fn new(root: PathBuf, manifest: Manifest, store: Arc<dyn Store>) -> Self {
        for file in manifest.tables.values().flatten() {
            store.expect(&root.join(&file.path), file.bytes, &file.blake3);
        }
        Self {
            root,
            manifest,
            store,
            chosen: None,
        }
    }

    /// The same dataset restricted to some clips: [`Dataset::read`] returns only rows about these clips, and
    /// [`Dataset::content_hash`] differs. Its files are still those of the whole dataset.
    pub fn of_clips(&self, condition: &str, clips: BTreeSet<MotionId>) -> Self {
        let condition = match &self.chosen {
            Some(before) => format!("({}) AND ({condition})", before.condition),
            None => condition.to_owned(),
        };
        let clips = clips
            .into_iter()
            .filter(|clip| self.has_clip(clip))
            .collect();
        Self {
            chosen: Some(Arc::new(Chosen { condition, clips })),
            ..self.clone()
        }
    }

    /// Whether a clip is among the chosen ones; true for all clips if none were chosen.
    pub fn has_clip(&self, clip: &MotionId) -> bool {
        self.chosen
            .as_ref()
            .is_none_or(|chosen| chosen.clips.contains(clip))
    }

    /// Number of chosen clips; `None` if none were chosen by [`Dataset::of_clips`].
    pub fn num_chosen(&self) -> Option<usize> {
        Some(self.chosen.as_ref()?.clips.len())
    }

    /// The condition by which clips were chosen; `None` if none were.
    pub fn condition(&self) -> Option<&str> {
        Some(&self.chosen.as_ref()?.condition)
    }

    /// Opens the newest committed version and verifies the hash of every file. At a URL this would read the whole
    /// dataset, so only existence and size of every file are verified; the hash of a file is then verified when the
    /// file is read whole.
    ///
    /// # Errors
    /// The folder is not a dataset or has an incompatible format, or a file is missing or altered.
    pub fn open(root: &Path) -> Result<Self, Error> {
        Self::open_unverified(root)?.verified()
    }

    /// Opens an older version, and verifies its files as [`Dataset::open`] does.
    ///
    /// # Errors
    /// There is no version of this number, or as [`Dataset::open`].
    pub fn open_version(root: &Path, version: u64) -> Result<Self, Error> {
        let newest = Self::open_unverified(root)?;
        let store = newest.store;
        let known = manifest_versions(store.as_ref(), root)?;
        if !known.contains(&version) {
            let known: Vec<String> = known.iter().map(u64::to_string).collect();
            return Err(Error::Refused(format!(
                "{} has no version {version}; there are {}",
                root.display(),
                known.join(", ")
            )));
        }
        let manifest = read_manifest(store.as_ref(), root, version)?;
        Self::new(root.to_owned(), manifest, store).verified()
    }

    /// The manifests of all versions that were not pruned, the oldest first.
    ///
    /// # Errors
    /// The folder is not a dataset, or a manifest cannot be read.
    pub fn versions(root: &Path) -> Result<Vec<Manifest>, Error> {
        let newest = Self::open_unverified(root)?;
        let store = newest.store.as_ref();
        let versions = manifest_versions(store, root)?.into_iter();
        versions
            .map(|version| read_manifest(store, root, version))
            .collect()
    }

    fn verified(self) -> Result<Self, Error> {
        let files: Vec<&FileEntry> = self.manifest.tables.values().flatten().collect();
        files.par_iter().try_for_each(|file| {
            let path = self.root.join(&file.path);
            let difference = self.store.difference(&path, file.bytes, &file.blake3);
            match difference.map_err(Error::io("read", &path))? {
                None => Ok(()),
                Some(detail) => Err(Error::Corrupt { path, detail }),
            }
        })?;
        Ok(self)
    }

    /// Opens the dataset in a folder without reading its files. `None` if the folder is no dataset, and becoming one would
    /// replace no file in it.
    ///
    /// # Errors
    /// The dataset has an incompatible format, or the folder is no dataset and holds files that a commit would replace.
    pub fn held_in(root: &Path) -> Result<Option<Self>, Error> {
        let store = ByPath::store();
        match read_newest(store.as_ref(), root)? {
            Some(manifest) => Ok(Some(Self::new(root.to_owned(), manifest, store))),
            None => check_free(store.as_ref(), root).map(|()| None),
        }
    }

    /// Hashes of the motions by the ids of their clips.
    ///
    /// # Errors
    /// A file cannot be read.
    pub fn contents(&self) -> Result<BTreeMap<MotionId, String>, Error> {
        let mut contents = BTreeMap::new();
        for (path, _) in self.files(MotionRow::TABLE, None) {
            let ids = table::read_column::<MotionRow, MotionId>(&path, "id")?;
            let hashes = table::read_column::<MotionRow, String>(&path, "content_hash")?;
            contents.extend(ids.into_iter().zip(hashes));
        }
        Ok(contents)
    }

    /// The rejections of these lists that hold for the motions of the dataset.
    ///
    /// # Errors
    /// As [`Dataset::contents`].
    pub fn rejections(&self, lists: &RejectedMasks) -> Result<Rejections, Error> {
        match lists.is_empty() {
            true => Ok(Rejections::default()),
            false => Ok(Rejections::holding(lists, &self.contents()?)),
        }
    }

    /// Opens the newest committed version without reading its files.
    ///
    /// # Errors
    /// The folder is not a dataset or has an incompatible format.
    pub fn open_unverified(root: &Path) -> Result<Self, Error> {
        let store = ByPath::store();
        let manifest = read_newest(store.as_ref(), root)?;
        let manifest = manifest.ok_or_else(|| Error::NotADataset {
            path: root.to_owned(),
            reason: if is_url(root) || root.is_dir() {
                "it has no meta/manifest-<n>.json; was the run that made it interrupted?".to_owned()
            } else {
                "there is no such folder".to_owned()
            },
        })?;
        Ok(Self::new(root.to_owned(), manifest, store))
    }

    /// The folder or URL.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The store that its files are read from.
    pub fn store(&self) -> &Arc<dyn Store> {
        &self.store
    }

    /// The manifest.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// Hash of the rows of some tables ([`Manifest::content_hash`]), and of the ids of the chosen clips: one condition
    /// chooses other clips once masks or pairs have changed.
    pub fn content_hash(&self, tables: &[&str]) -> String {
        let whole = self.manifest.content_hash(tables);
        let Some(chosen) = &self.chosen else {
            return whole;
        };
        let mut digest = Digest::default();
        digest.part(&whole);
        for clip in &chosen.clips {
            digest.part(clip.as_str());
        }
        digest.hex()
    }

    /// The skeleton its motions are posed on.
    ///
    /// # Errors
    /// The manifest names a skeleton that is not built in, and does not hold its joint positions.
    pub fn skeleton(&self) -> Result<Skeleton, Error> {
        let built_in = Skeleton::smplx_neutral();
        let name = &self.manifest.skeleton;
        let facts = &self.manifest.facts;
        let stored = facts
            .get(SKELETON_FACT)
            .and_then(|text| serde_json::from_str::<Skeleton>(text).ok())
            .filter(|skeleton| skeleton.name() == name);
        match stored {
            Some(skeleton) => Ok(skeleton),
            None if name == built_in.name() => Ok(built_in),
            None => Err(Error::NotADataset {
                path: self.root.clone(),
                reason: format!(
                    "its manifest names skeleton {name:?} without saying where its joints are"
                ),
            }),
        }
    }

    /// Files of a table, or of one split of it, each with its path below [`Dataset::root`].
    pub fn files(&self, table: &str, split: Option<Split>) -> Vec<(PathBuf, &FileEntry)> {
        self.manifest
            .tables
            .get(table)
            .into_iter()
            .flatten()
            .filter(|file| split.is_none() || file.split == split)
            .map(|file| (self.root.join(&file.path), file))
            .collect()
    }

    /// All rows of a table, or those of one split, in the order of the files; if clips were chosen, only rows about
    /// those clips.
    ///
    /// # Errors
    /// A file cannot be read.
    pub fn read<R: Row>(&self, split: Option<Split>) -> Result<Vec<R>, Error> {
        let shards: Vec<Vec<R>> = self
            .files(R::TABLE, split)
            .par_iter()
            .map(|(path, _)| table::read_rows_on(self.store.as_ref(), path))
            .collect::<Result<_, _>>()?;
        let rows = shards.into_iter().flatten();
        Ok(rows
            .filter(|row| row.clips().into_iter().all(|clip| self.has_clip(clip)))
            .collect())
    }

    /// The test questions of the folder, each checked against its id.
    ///
    /// # Errors
    /// There are no items, an item was changed after it was drawn, or a file cannot be read.
    pub fn items(&self) -> Result<Vec<ItemRow>, Error> {
        let rows: Vec<ItemRow> = self.read(None)?;
        if rows.is_empty() {
            return Err(Error::no_items(&self.root));
        }
        for row in &rows {
            row.check().map_err(|source| Error::ItemOf {
                path: self.root.clone(),
                source: Box::new(source),
            })?;
        }
        Ok(rows)
    }
}
