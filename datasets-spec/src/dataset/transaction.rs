//! Runs that change a dataset: lock, commit and clean-up.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::Serialize;

use super::layout::{
    DATA, META, SKELETON_FACT, check_free, manifest_path, read_newest, staged_folder, tables_until,
};
use super::open::Dataset;
use crate::manifest::{
    ANNOTATE_FACTS, ANNOTATE_KNOWN_FACT, ANNOTATE_SEQ_FACT, ANNOTATE_STORE_FACT, Accounting,
    FORMAT, FileEntry, Manifest, REJECTED_MASKS_FACT, REJECTED_PAIRS_FACT, add_rejected,
};
use crate::store::{ByPath, Lock, Locking, Store, create_folder, write_bytes, write_new};
use crate::table::SCHEMA_VERSION;
use crate::{Error, Skeleton};

const TOOL: &str = concat!("stance ", env!("CARGO_PKG_VERSION"));

/// A run that writes to a dataset. It holds the folder's lock until it is committed or dropped; at a URL there is no
/// lock, and if two runs commit the same version, the later one fails.
#[derive(Debug)]
pub struct Transaction {
    pub(super) root: PathBuf,
    pub(super) store: Arc<dyn Store>,
    pub(super) base: Option<Manifest>,
    /// Tables of all versions: new shards of these tables get other file names.
    pub(super) taken: BTreeSet<String>,
    /// `None` if the storage has no locks.
    lock: Option<Box<dyn Lock>>,
}

/// Tables and facts that a commit adds to the dataset.
#[derive(Clone, Debug, Default)]
pub struct Commit {
    /// Files of the tables that this run made; they replace the earlier files of these tables.
    pub tables: BTreeMap<String, Vec<FileEntry>>,
    /// Hash of the plan that made the tables.
    pub plan_hash: String,
    /// Plan hashes of tables that were made by another plan than `plan_hash`.
    pub plans: BTreeMap<String, String>,
    /// The skeleton motions are posed on.
    pub skeleton: Skeleton,
    /// Counts of the sources, for a run that read any.
    pub accounting: Option<Accounting>,
    /// Facts to add.
    pub facts: BTreeMap<String, String>,
    /// Whether to drop the facts of the previous version except those of people's labels, and its tables except those in
    /// `carried`. Set if the motions that they derive from are replaced.
    pub fresh: bool,
    /// Tables of the previous version that a fresh commit keeps unchanged, with their plans.
    pub carried: BTreeSet<String>,
}

impl Transaction {
    /// Locks a folder, creating it if needed, and removes half-written files of a killed run. `holder` is reported to
    /// other runs while this one holds the lock. Staged files stay, because their writers hold no lock.
    ///
    /// # Errors
    /// The folder is no dataset and holds files that a dataset would replace, another run holds the lock, or the folder
    /// cannot be written.
    pub fn begin(root: &Path, holder: &str) -> Result<Self, Error> {
        Self::begin_on(ByPath::store(), root, holder)
    }

    /// [`Transaction::begin`], writing through the given store.
    ///
    /// # Errors
    /// As [`Transaction::begin`].
    pub fn begin_on(store: Arc<dyn Store>, root: &Path, holder: &str) -> Result<Self, Error> {
        create_folder(store.as_ref(), root)?;
        check_free(store.as_ref(), root)?;
        create_folder(store.as_ref(), &root.join(META))?;
        create_folder(store.as_ref(), &root.join(DATA))?;
        let path = root.to_owned();
        let lock = match store.lock(root, holder).map_err(Error::io("lock", root))? {
            Locking::Held(lock) => Some(lock),
            Locking::Taken { holder } => return Err(Error::Locked { path, holder }),
            Locking::NoLocks => None,
        };
        let base = read_newest(store.as_ref(), root)?;
        let transaction = Self {
            taken: tables_until(store.as_ref(), root, base.as_ref())?,
            base,
            root: path,
            store,
            lock,
        };
        // Where other runs may write, do not remove their files. Object stores have no temporary files.
        if transaction.is_alone() {
            transaction.remove_half_written()?;
            if let Some(base) = &transaction.base {
                transaction.arrange(base)?;
            }
        }
        Ok(transaction)
    }

    /// Begins a change that was computed from a dataset which was read before. It is refused if the dataset has changed
    /// since.
    ///
    /// # Errors
    /// As [`Transaction::begin`], or another run has committed a version since.
    pub fn begin_after(read: &Dataset, holder: &str) -> Result<Self, Error> {
        let transaction = Self::begin(read.root(), holder)?;
        match &transaction.base {
            Some(base) if base.version == read.manifest().version => Ok(transaction),
            newer => Err(Error::Overtaken {
                path: transaction.root.clone(),
                version: newer.as_ref().map_or(0, |base| base.version),
            }),
        }
    }

    /// Whether the lock keeps other runs from writing to the dataset.
    pub fn is_alone(&self) -> bool {
        self.lock.is_some()
    }

    /// The version this run starts from.
    pub fn base(&self) -> Option<&Manifest> {
        self.base.as_ref()
    }

    pub(super) fn version(&self) -> u64 {
        self.base.as_ref().map_or(1, |base| base.version + 1)
    }

    /// The store that the run writes to.
    pub fn store(&self) -> Arc<dyn Store> {
        Arc::clone(&self.store)
    }

    /// The dataset's folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Makes the run's tables part of the dataset and releases the lock.
    ///
    /// # Errors
    /// The manifest cannot be written, or another run has committed this version; the dataset is then as it was. If a
    /// file cannot be moved or removed afterwards, the version exists, and [`Transaction::finish`] completes it.
    ///
    /// # Panics
    /// If the accounting does not balance, which is a bug in the run.
    pub fn commit(self, commit: Commit) -> Result<Dataset, Error> {
        let mut manifest = self.base.clone().unwrap_or_else(|| Manifest {
            format: FORMAT.to_owned(),
            schema_version: SCHEMA_VERSION.to_owned(),
            ..Manifest::default()
        });
        let stays = |table: &String| match commit.fresh {
            true => commit.carried.contains(table),
            false => !commit.tables.contains_key(table),
        };
        if manifest.skeleton != commit.skeleton.name() && manifest.tables.keys().any(stays) {
            return Err(Error::Refused(format!(
                "{} holds motions of skeleton {}, and the new ones are of {}; name another folder",
                self.root().display(),
                manifest.skeleton,
                commit.skeleton.name()
            )));
        }
        if commit.fresh {
            let carried = &commit.carried;
            manifest.tables.retain(|table, _| carried.contains(table));
            manifest.plans.retain(|table, _| carried.contains(table));
            let is_of_people = |name: &str| {
                [REJECTED_MASKS_FACT, REJECTED_PAIRS_FACT].contains(&name)
                    || name.starts_with(ANNOTATE_FACTS)
            };
            manifest.facts.retain(|name, _| is_of_people(name));
        }
        manifest.schema_version = newer_version(&manifest.schema_version).to_owned();
        manifest.skeleton = commit.skeleton.name().to_owned();
        if commit.skeleton != Skeleton::smplx_neutral() {
            let rest = serde_json::to_string(&commit.skeleton).expect("numbers serialise");
            manifest.facts.insert(SKELETON_FACT.to_owned(), rest);
        }
        manifest.version = self.version();
        manifest.tool_version = TOOL.to_owned();
        let made = commit.tables.keys().cloned();
        let made = made.map(|table| (table, commit.plan_hash.clone()));
        manifest.plans.extend(made.chain(commit.plans));
        manifest.tables.extend(commit.tables);
        manifest.facts.extend(commit.facts);
        if let Some(accounting) = commit.accounting {
            assert!(
                accounting.balances(),
                "sources must equal ingested + quarantined + skipped: {accounting:?}"
            );
            manifest.accounting = accounting;
        }
        manifest.root_hash = Manifest::compute_root_hash(&manifest.tables);

        self.publish(manifest, &commit.plan_hash)
    }

    /// Facts of an older version once it is restored. What people rejected since stays rejected. If the version knows no
    /// annotation project, the one that exported since stays known; if it knows the same one, its last export does.
    ///
    /// # Errors
    /// As [`Manifest::fact`].
    pub fn restored_facts(&self, of: &Manifest) -> Result<BTreeMap<String, String>, Error> {
        let (mut pairs, mut masks) = (of.rejected_pairs()?, of.rejected_masks()?);
        if let Some(base) = &self.base {
            add_rejected(&mut pairs, base.rejected_pairs()?);
            add_rejected(&mut masks, base.rejected_masks()?);
        }
        let mut facts = of.facts.clone();
        // A version from before the first export of a project does not know the project; without it, the next export would
        // not see what others rejected since.
        let is_of_project = |name: &String| name.starts_with(ANNOTATE_FACTS);
        if !facts.keys().any(is_of_project) {
            let known = self.base.iter().flat_map(|base| &base.facts);
            let known = known.filter(|(name, _)| is_of_project(name));
            facts.extend(known.map(|(name, value)| (name.clone(), value.clone())));
        } else if let Some(base) = &self.base {
            let store = |facts: &BTreeMap<String, String>| facts.get(ANNOTATE_STORE_FACT).cloned();
            let known = base.facts.get(ANNOTATE_KNOWN_FACT);
            let known = known.or(base.facts.get(ANNOTATE_SEQ_FACT));
            if let Some(known) = known.filter(|_| store(&base.facts) == store(&facts)) {
                facts.insert(ANNOTATE_KNOWN_FACT.to_owned(), known.clone());
            }
        }
        if pairs != of.rejected_pairs()? {
            let pairs = serde_json::to_string(&pairs).expect("texts serialise");
            facts.insert(REJECTED_PAIRS_FACT.to_owned(), pairs);
        }
        if masks != of.rejected_masks()? {
            let masks = serde_json::to_string(&masks).expect("texts serialise");
            facts.insert(REJECTED_MASKS_FACT.to_owned(), masks);
        }
        Ok(facts)
    }

    /// Makes an older version the newest one, under a new number, with its [`Transaction::restored_facts`]. `tables`
    /// replace those of that version; a table without files is dropped.
    ///
    /// # Errors
    /// As [`Transaction::commit`].
    pub fn restore(
        self,
        of: &Manifest,
        tables: BTreeMap<String, Vec<FileEntry>>,
        plan_hash: &str,
    ) -> Result<Dataset, Error> {
        let mut manifest = of.clone();
        manifest.version = self.version();
        manifest.tool_version = TOOL.to_owned();
        manifest.facts = self.restored_facts(of)?;
        if !tables.is_empty() {
            manifest.schema_version = newer_version(&manifest.schema_version).to_owned();
        }
        for (table, files) in tables {
            manifest.plans.insert(table.clone(), plan_hash.to_owned());
            manifest.tables.insert(table, files);
        }
        manifest.tables.retain(|_, files| !files.is_empty());
        let tables = &manifest.tables;
        manifest.plans.retain(|table, _| tables.contains_key(table));
        manifest.root_hash = Manifest::compute_root_hash(tables);
        self.publish(manifest, plan_hash)
    }

    /// Writes the manifest, which creates the version, and moves all files to their places.
    fn publish(self, manifest: Manifest, plan_hash: &str) -> Result<Dataset, Error> {
        let path = manifest_path(&self.root, manifest.version);
        if !write_new(self.store.as_ref(), &path, &json(&path, &manifest)?)? {
            // Files staged for this version are not used for any other. If they cannot be removed now, pruning removes
            // them.
            let staged = staged_folder(&self.root, manifest.version - 1, plan_hash);
            let _removed = self.store.remove_dir_all(&staged);
            return Err(Error::Overtaken {
                path: self.root,
                version: manifest.version,
            });
        }
        self.settle(&manifest)?;
        Ok(Dataset::new(self.root, manifest, self.store))
    }
}

/// The newer of a schema version and this program's.
fn newer_version(version: &str) -> &str {
    let numbers = |text: &str| -> Vec<u64> {
        let parts = text.split('.');
        parts.map(|part| part.parse().unwrap_or(0)).collect()
    };
    match numbers(version) > numbers(SCHEMA_VERSION) {
        true => version,
        false => SCHEMA_VERSION,
    }
}

fn json<T: Serialize>(path: &Path, value: &T) -> Result<Vec<u8>, Error> {
    let mut text = serde_json::to_vec_pretty(value).map_err(Error::json(path))?;
    text.push(b'\n');
    Ok(text)
}

pub(super) fn write_json<T: Serialize>(
    store: &dyn Store,
    path: &Path,
    value: &T,
) -> Result<(), Error> {
    write_bytes(store, path, &json(path, value)?)
}
