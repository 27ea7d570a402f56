//! Items and their edits by several systems, read together and checked. The motions stay in the files.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use datasets_spec::record::{EditRow, ItemRow};
use datasets_spec::{Dataset, Skeleton};
use rayon::prelude::*;

use crate::Error;
use crate::rows::{EditFacts, ItemFacts, Rows};

/// Number of items whose motions, and everything computed from them, are in memory together. It is a multiple of the
/// encoders' batch sizes, so that each batch is full.
pub(crate) const ITEMS_AT_ONCE: usize = 128;

/// Items and their edits by several systems. Motions are read in chunks when they are needed.
#[derive(Debug)]
pub struct Answered {
    /// The items.
    pub items: Rows<ItemRow>,
    /// Edits of all systems.
    pub edits: Rows<EditRow>,
    /// The skeleton that all motions are on.
    pub skeleton: Skeleton,
}

impl Answered {
    /// Wraps items and edits that are in memory.
    pub fn of_rows(items: Vec<ItemRow>, edits: Vec<EditRow>, skeleton: Skeleton) -> Self {
        Self {
            items: items.into_iter().collect(),
            edits: edits.into_iter().collect(),
            skeleton,
        }
    }

    /// Reads tables of edits of the same items. A folder may hold only items, without edits. The motions stay in the
    /// files; those of the items are read from the first folder.
    ///
    /// # Errors
    /// No folder is given, one cannot be read, or two folders hold different items or skeletons, or state other
    /// novelties of an item.
    pub fn read(folders: &[PathBuf]) -> Result<Self, Error> {
        let Some((first, others)) = folders.split_first() else {
            return Err(Error::Invalid("no table of edits was given".to_owned()));
        };
        let mut all = Self::read_one(first)?;
        for path in others {
            all.merge(first, Self::read_one(path)?, path)?;
        }
        Ok(all)
    }

    fn read_one(path: &Path) -> Result<Self, Error> {
        let folder = Dataset::open(path)?;
        let items: Rows<ItemRow> = Rows::read(&folder)?;
        if items.is_empty() {
            return Err(datasets_spec::Error::no_items(path).into());
        }
        Ok(Self {
            items,
            edits: Rows::read(&folder)?,
            skeleton: folder.skeleton()?,
        })
    }

    /// Reads tables of edits whose systems become rows of one result table.
    ///
    /// # Errors
    /// As [`Answered::read`], or two systems have the same name.
    pub fn read_for_table(folders: &[PathBuf]) -> Result<Self, Error> {
        Self::read(folders)?.with_edits(Vec::new())
    }

    /// Adds edits of the same items, whose systems become rows of the same result table.
    ///
    /// # Errors
    /// Two systems have the same name, or a take appears twice.
    pub fn with_edits(mut self, edits: Vec<EditRow>) -> Result<Self, Error> {
        self.edits.extend(edits);
        check_systems(self.edits.facts())?;
        Ok(self)
    }

    /// Reads the items at distinct positions with their motions, each checked against its id.
    ///
    /// # Errors
    /// A file cannot be read, or an item was changed after it was drawn.
    ///
    /// # Panics
    /// If a position does not exist.
    pub fn items_at(&self, positions: &[usize]) -> Result<Vec<ItemRow>, Error> {
        let rows = self.items.rows(positions)?;
        let check = |row: &ItemRow| {
            let checked = row.check();
            checked.map_err(|source| Error::Item(row.id.clone(), Box::new(source)))
        };
        // Check all rows before looking for an error, so that the first row's error is reported.
        let checked: Vec<Result<(), Error>> = rows.par_iter().map(check).collect();
        checked.into_iter().collect::<Result<(), Error>>()?;
        Ok(rows)
    }

    /// Reads two tables of edits of the same items, of one system each. Also returns the names of the two systems,
    /// which tell them apart even if both are of one method.
    ///
    /// # Errors
    /// As [`Answered::read`], or a table holds several systems.
    pub fn read_pair([a, b]: [&Path; 2]) -> Result<(Self, [String; 2]), Error> {
        let (mut answered, first) = Self::of_one_system(a, "A")?;
        let (other, second) = Self::of_one_system(b, "B")?;
        answered.merge(a, other, b)?;
        Ok((answered, [first, second]))
    }

    /// Reads a table of edits of one system, and appends `side` to the system's name, because two runs of one method
    /// have the same name.
    fn of_one_system(path: &Path, side: &str) -> Result<(Self, String), Error> {
        let mut read = Self::read_one(path)?;
        let edits = read.edits.facts();
        check_systems(edits).map_err(|source| of_table(path, source))?;
        let systems: BTreeSet<&str> = edits.iter().map(|row| row.system.as_str()).collect();
        let &[system] = Vec::from_iter(systems.iter().copied()).as_slice() else {
            return Err(Error::Invalid(format!(
                "{} holds {} systems ({}), and a comparison needs one",
                path.display(),
                systems.len(),
                Vec::from_iter(systems).join(", ")
            )));
        };
        let name = format!("{system} ({side})");
        for row in read.edits.facts_mut() {
            row.system.clone_from(&name);
        }
        Ok((read, name))
    }

    /// Adds the edits of another folder, after checking that they are edits of the same items.
    fn merge(&mut self, first: &Path, other: Self, path: &Path) -> Result<(), Error> {
        let (first, second) = (first.display(), path.display());
        if other.skeleton != self.skeleton {
            return Err(Error::Invalid(format!(
                "{first} is posed on skeleton {}, {second} on {}; tables of edits are compared on one \
                 body",
                self.skeleton.name(),
                other.skeleton.name()
            )));
        }
        let ids = |items: &Rows<ItemRow>| -> BTreeSet<String> {
            items.facts().iter().map(|item| item.id.clone()).collect()
        };
        let (ours, theirs) = (ids(&self.items), ids(&other.items));
        if ours != theirs {
            return Err(Error::Invalid(format!(
                "{first} and {second} answer different items: {} of {} are in {first} alone, {} of {} in {second} \
                 alone; edit the same items: stance edit RUN --items ITEMS",
                ours.difference(&theirs).count(),
                ours.len(),
                theirs.difference(&ours).count(),
                theirs.len()
            )));
        }
        // The id of an item does not cover its novelty, and rows of one table are parted by one novelty.
        let novelty = |item: &ItemFacts| (item.id.clone(), item.novelty.clone());
        let stated: BTreeMap<_, _> = other.items.facts().iter().map(novelty).collect();
        let differing = self.items.facts().iter().find_map(|item| {
            let other = &stated[&item.id];
            (*other != item.novelty).then_some((item, other))
        });
        if let Some((item, other)) = differing {
            let [own, other] =
                [&item.novelty, other].map(|novelty| novelty.as_deref().unwrap_or("not known"));
            return Err(Error::Invalid(format!(
                "by {first}, the novelty of item {:?} is {own}, and by {second} {other}: their items were drawn from other \
                 datasets or by other versions of this program; draw the items once, and edit or import into new folders \
                 with these --items",
                item.id
            )));
        }
        // An item whose content differs is another item, even under the same id.
        let positions: Vec<usize> = (0..other.items.len()).collect();
        for positions in positions.chunks(ITEMS_AT_ONCE) {
            other
                .items_at(positions)
                .map_err(|source| of_table(path, source))?;
        }
        self.edits.append(other.edits);
        Ok(())
    }
}

/// The error for a system that has the same take of an item twice.
pub(crate) fn same_take(system: &str, id: &str, seed: u64) -> Error {
    Error::Invalid(format!(
        "system {system:?} has two motions of item {id:?} sampled with seed {seed}; give each take once, or edit again \
         with another --seed"
    ))
}

/// Adds the table's path to an error.
fn of_table(path: &Path, source: Error) -> Error {
    Error::TableOf(path.to_owned(), Box::new(source))
}

/// Refuses duplicate takes, and a system name that stands for several checkpoints or settings, because these would
/// share a row of a table.
fn check_systems(edits: &[EditFacts]) -> Result<(), Error> {
    let mut known: BTreeMap<&str, &EditFacts> = BTreeMap::new();
    let mut takes: BTreeSet<(&str, &str, u64)> = BTreeSet::new();
    for row in edits {
        let first = *known.entry(&row.system).or_insert(row);
        let system = row.system.as_str();
        let differs = |what: &str, first: &str, other: &str| {
            Error::Invalid(format!(
                "system {system:?} stands for two {what}: {first} and {other}; edit again with --name to tell \
                 them apart"
            ))
        };
        if first.checkpoint_hash != row.checkpoint_hash {
            let [a, b] = [first, row].map(|edit| format!("{:.12}", edit.checkpoint_hash));
            return Err(differs("checkpoints", &a, &b));
        }
        if first.settings_hash != row.settings_hash {
            return Err(differs("settings", &first.settings, &row.settings));
        }
        if !takes.insert((system, &row.id, row.seed)) {
            return Err(same_take(system, &row.id, row.seed));
        }
    }
    Ok(())
}
