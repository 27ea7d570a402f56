//! Where the sources of a dataset were found: a private file inside the dataset's folder.
//!
//! Paths of a machine are never published, so they are kept out of the manifest, the card and every export.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{ErrorKind, Write};
use std::path::Path;

use datasets_spec::dataset::PRIVATE;
use datasets_spec::store::Store;
use serde::{Deserialize, Serialize};

use super::sources::{Given, Kind};
use crate::Error;

const FILE: &str = "sources.json";
/// Keeps the folder out of version control.
const IGNORE: (&str, &[u8]) = (".gitignore", b"*\n");

/// The resolved places of every source, by its name.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub(crate) struct Places(BTreeMap<String, BTreeMap<String, Kind>>);

impl Places {
    /// Reads the places that a dataset records. A file that cannot be understood records none.
    pub(crate) fn read(store: &dyn Store, root: &Path) -> Result<Self, Error> {
        let path = root.join(PRIVATE).join(FILE);
        match store.read(&path) {
            Ok(bytes) => Ok(serde_json::from_slice(&bytes).unwrap_or_default()),
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(Self::default()),
            Err(error) => Err(datasets_spec::Error::io("read", path)(error).into()),
        }
    }

    /// Writes the places, unless they are recorded already.
    pub(crate) fn write(&self, store: &dyn Store, root: &Path) -> Result<(), Error> {
        let folder = root.join(PRIVATE);
        let text = serde_json::to_vec_pretty(self).expect("texts serialise");
        if self.0.is_empty()
            || store
                .read(&folder.join(FILE))
                .is_ok_and(|found| found == text)
        {
            return Ok(());
        }
        store
            .create_dir_all(&folder)
            .map_err(datasets_spec::Error::io("create folder", &folder))?;
        for (name, bytes) in [IGNORE, (FILE, &text)] {
            let path = folder.join(name);
            let write = || {
                let mut file = store.create(&path)?;
                file.write_all(bytes)?;
                file.publish()
            };
            write().map_err(datasets_spec::Error::io("write", &path))?;
        }
        Ok(())
    }

    pub(super) fn record(&mut self, given: &[Given]) {
        for source in given {
            let known = self.0.entry(source.label.name.clone()).or_default();
            for (place, kind) in &source.places {
                let recorded = known.entry(place.clone()).or_insert(*kind);
                *recorded = (*recorded).max(*kind);
            }
        }
    }

    /// Adds the places of another dataset; `renamed` maps the names of its sources to those here.
    pub(crate) fn extend(&mut self, other: Self, renamed: &BTreeMap<String, String>) {
        for (name, places) in other.0 {
            let name = renamed.get(&name).cloned().unwrap_or(name);
            self.0.entry(name).or_default().extend(places);
        }
    }

    pub(super) fn retain(&mut self, names: &BTreeSet<&str>) {
        self.0.retain(|name, _| names.contains(name.as_str()));
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.values().all(BTreeMap::is_empty)
    }

    /// The places of a source, sorted.
    pub(super) fn of(&self, name: &str) -> impl Iterator<Item = (&str, Kind)> {
        let places = self.0.get(name).into_iter().flatten();
        places.map(|(place, kind)| (place.as_str(), *kind))
    }

    /// Names of the sources that were found at this place in one of the given ways.
    pub(super) fn names_at(&self, place: &str, kinds: &[Kind]) -> BTreeSet<&str> {
        let is_there = |places: &BTreeMap<String, Kind>| {
            places.get(place).is_some_and(|kind| kinds.contains(kind))
        };
        let found = self.0.iter().filter(|(_, places)| is_there(places));
        found.map(|(name, _)| name.as_str()).collect()
    }
}
