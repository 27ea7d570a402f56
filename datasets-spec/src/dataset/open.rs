//! Datasets opened for reading.

use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::layout::{SKELETON_FACT, newest_manifest};
use crate::manifest::{FileEntry, Manifest};
use crate::record::ItemRow;
use crate::store::{Disk, Store};
use crate::table::{self, Row};
use crate::{Error, Skeleton, Split};

/// A dataset opened for reading; every file has been checked against its hash.
#[derive(Clone, Debug)]
pub struct Dataset {
    pub(super) root: PathBuf,
    pub(super) manifest: Manifest,
}

impl Dataset {
    /// Opens the newest committed version and verifies the hash of every file.
    ///
    /// # Errors
    /// The folder is not a dataset, has a newer format, or a file is missing or altered.
    pub fn open(root: &Path) -> Result<Self, Error> {
        let dataset = Self::open_unverified(root)?;
        let files: Vec<&FileEntry> = dataset.manifest.tables.values().flatten().collect();
        files.par_iter().try_for_each(|file| {
            let path = root.join(&file.path);
            let found = hash_file(&path)?;
            if found == file.blake3 {
                return Ok(());
            }
            Err(Error::Corrupt {
                path,
                detail: format!("BLAKE3 expected {}, found {found}", file.blake3),
            })
        })?;
        Ok(dataset)
    }

    /// Opens the newest committed version without reading its files.
    ///
    /// # Errors
    /// The folder is not a dataset or has a newer format.
    pub fn open_unverified(root: &Path) -> Result<Self, Error> {
        let manifest = newest_manifest(&Disk, root)?.ok_or_else(|| Error::NotADataset {
            path: root.to_owned(),
            reason: if root.is_dir() {
                "it has no meta/manifest-<n>.json; was the run that made it interrupted?".to_owned()
            } else {
                "there is no such folder".to_owned()
            },
        })?;
        Ok(Self {
            root: root.to_owned(),
            manifest,
        })
    }

    /// The folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The manifest.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// Hash of the rows of some tables: [`Manifest::content_hash`].
    pub fn content_hash(&self, tables: &[&str]) -> String {
        self.manifest.content_hash(tables)
    }

    /// The skeleton its motions are posed on.
    ///
    /// # Errors
    /// The manifest names a skeleton that is not built in, without its joint positions.
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

    /// Files of a table, with their paths.
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

    /// All rows of a table, or those of one split, in the order of the files.
    ///
    /// # Errors
    /// A file cannot be read.
    pub fn read<R: Row>(&self, split: Option<Split>) -> Result<Vec<R>, Error> {
        let shards: Vec<Vec<R>> = self
            .files(R::TABLE, split)
            .par_iter()
            .map(|(path, _)| table::read_rows(path))
            .collect::<Result<_, _>>()?;
        Ok(shards.into_iter().flatten().collect())
    }

    /// The test questions of the folder, each checked against its id.
    ///
    /// # Errors
    /// There are none, an item was changed after it was drawn, or a file cannot be read.
    pub fn items(&self) -> Result<Vec<ItemRow>, Error> {
        let rows: Vec<ItemRow> = self.read(None)?;
        if rows.is_empty() {
            return Err(Error::NoItems {
                path: self.root.clone(),
            });
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

/// BLAKE3 of a file, hexadecimal.
///
/// # Errors
/// The file cannot be read.
pub fn hash_file(path: &Path) -> Result<String, Error> {
    Disk.hash(path).map_err(Error::io("read", path))
}
