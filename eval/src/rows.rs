//! Rows of tables with motions: the other columns are in memory, and motions are read from the files on demand.

use std::collections::BTreeMap;
use std::fmt::Debug;

use datasets_spec::record::{EditRow, ItemRow};
use datasets_spec::table::{Row, ShardReader};
use datasets_spec::{Dataset, Error, Motion, MotionId, Split};
use rayon::prelude::*;

datasets_spec::table! {
    /// Columns of an item besides its motions.
    pub struct ItemFacts = "items" {
        /// Id
        pub id: String [""],
        /// Task
        pub task: String [""],
        /// Split of its motions
        pub split: Split [""],
        /// Instruction of the edit
        pub instruction: String [""],
        /// Motion that the source was made of
        pub source_id: MotionId [""],
        /// Motion that the target's changes were taken from
        pub target_id: MotionId [""],
        /// Body parts that are edited
        pub parts: Vec<String> [""],
        /// Novelty of the item: how much of it the training split shows
        pub novelty: Option<String> ["", newer],
        /// Frame rate of all motions of the item
        pub fps: f32 ["1/s"],
        /// Frames of the source
        pub source_frames: i32 ["frame"],
        /// Frames of the target; 0 without a target
        pub target_frames: i32 ["frame"],
        /// Frames of the target made of another capture; 0 without one
        pub other_frames: i32 ["frame"],
    }
}

datasets_spec::table! {
    /// Columns of an edit besides its motion.
    pub struct EditFacts = "edits" {
        /// Id of the item
        pub id: String [""],
        /// Name of the system
        pub system: String [""],
        /// Hash of the checkpoint
        pub checkpoint_hash: String [""],
        /// Hash of the settings
        pub settings_hash: String ["", newer],
        /// The settings, a JSON object
        pub settings: String ["", newer],
        /// Seed of the sampler
        pub seed: u64 [""],
        /// Frame rate
        pub fps: f32 ["1/s"],
        /// Number of frames
        pub n_frames: i32 ["frame"],
        /// Mean distance between generated keypoints and the fitted body
        pub fit_error_m: Option<f32> ["m"],
        /// Mean difference between the lengths of generated bones and of the body's bones
        pub bone_drift_m: Option<f32> ["m"],
    }
}

/// Copies the named columns of a row.
macro_rules! copied {
    ($facts:ident of $row:ident: $($column:ident),*) => {
        impl From<&$row> for $facts {
            fn from(row: &$row) -> Self {
                Self { $($column: Clone::clone(&row.$column)),* }
            }
        }
    };
}
copied!(ItemFacts of ItemRow: id, task, split, instruction, source_id, target_id, parts, novelty,
    fps, source_frames, target_frames, other_frames);
copied!(EditFacts of EditRow: id, system, checkpoint_hash, settings_hash, settings, seed,
    fps, n_frames, fit_error_m, bone_drift_m);

impl ItemFacts {
    /// Makes the edit row of the item with this motion, as [`EditRow::answering`] does.
    pub fn answer(&self, motion: &Motion) -> EditRow {
        let item = ItemRow {
            id: self.id.clone(),
            task: self.task.clone(),
            instruction: self.instruction.clone(),
            source_id: self.source_id.clone(),
            ..ItemRow::blank(&self.target_id, self.split)
        };
        EditRow::answering(&item, motion)
    }
}

/// A table with motions.
pub trait MotionTable: Row + Debug {
    /// The columns besides the motions.
    type Facts: Row + Debug + for<'a> From<&'a Self>;
}

impl MotionTable for ItemRow {
    type Facts = ItemFacts;
}

impl MotionTable for EditRow {
    type Facts = EditFacts;
}

/// Rows with motions: rows of one or more files, and given rows whose motions are in memory.
#[derive(Debug)]
pub struct Rows<R: MotionTable> {
    facts: Vec<R::Facts>,
    places: Vec<Place>,
    files: Vec<ShardReader>,
    given: Vec<R>,
}

/// Location of a row with its motions.
#[derive(Clone, Copy, Debug)]
enum Place {
    File { file: usize, row: usize },
    Given(usize),
}

impl<R: MotionTable> Default for Rows<R> {
    fn default() -> Self {
        Self {
            facts: Vec::new(),
            places: Vec::new(),
            files: Vec::new(),
            given: Vec::new(),
        }
    }
}

impl<R: MotionTable> FromIterator<R> for Rows<R> {
    fn from_iter<I: IntoIterator<Item = R>>(rows: I) -> Self {
        let mut all = Self::default();
        all.extend(rows);
        all
    }
}

impl<R: MotionTable> Extend<R> for Rows<R> {
    fn extend<I: IntoIterator<Item = R>>(&mut self, rows: I) {
        for row in rows {
            self.facts.push(R::Facts::from(&row));
            self.places.push(Place::Given(self.given.len()));
            self.given.push(row);
        }
    }
}

impl<R: MotionTable> Rows<R> {
    /// Reads all columns of a dataset's rows except the motions.
    ///
    /// # Errors
    /// A file cannot be read.
    pub fn read(dataset: &Dataset) -> Result<Self, Error> {
        let read = dataset
            .files(R::TABLE, None)
            .par_iter()
            .map(|(path, _)| {
                let file = ShardReader::open(path)?;
                let facts: Vec<R::Facts> = file.rows()?;
                Ok((file, facts))
            })
            .collect::<Result<Vec<_>, Error>>()?;
        let mut all = Self::default();
        for (file, facts) in read {
            let number = all.files.len();
            let rows = 0..facts.len();
            all.places
                .extend(rows.map(|row| Place::File { file: number, row }));
            all.facts.extend(facts);
            all.files.push(file);
        }
        Ok(all)
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.facts.len()
    }

    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.facts.is_empty()
    }

    /// Columns of each row besides its motions.
    pub fn facts(&self) -> &[R::Facts] {
        &self.facts
    }

    /// Mutable access to the columns. The rows that [`Rows::rows`] returns do not change with them.
    pub(crate) fn facts_mut(&mut self) -> &mut [R::Facts] {
        &mut self.facts
    }

    /// Keeps the rows for which `keep` returns true.
    pub fn retain(&mut self, mut keep: impl FnMut(&R::Facts) -> bool) {
        let facts = std::mem::take(&mut self.facts).into_iter();
        let rows = facts.zip(std::mem::take(&mut self.places));
        (self.facts, self.places) = rows.filter(|(facts, _)| keep(facts)).unzip();
    }

    /// Appends the rows of another set.
    pub(crate) fn append(&mut self, other: Self) {
        let (files, given) = (self.files.len(), self.given.len());
        let moved = |place| match place {
            Place::File { file, row } => Place::File {
                file: files + file,
                row,
            },
            Place::Given(row) => Place::Given(given + row),
        };
        self.facts.extend(other.facts);
        self.places.extend(other.places.into_iter().map(moved));
        self.files.extend(other.files);
        self.given.extend(other.given);
    }

    /// Reads the rows at distinct positions, with their motions, in the order of the positions.
    ///
    /// # Errors
    /// A file cannot be read.
    ///
    /// # Panics
    /// If a position does not exist, or appears twice.
    pub fn rows(&self, positions: &[usize]) -> Result<Vec<R>, Error> {
        let share = positions.len().div_ceil(rayon::current_num_threads());
        let shares = positions
            .par_chunks(share.max(1))
            .map(|positions| self.share(positions))
            .collect::<Result<Vec<Vec<R>>, Error>>()?;
        Ok(shares.into_iter().flatten().collect())
    }

    /// Reads the rows of one thread.
    fn share(&self, positions: &[usize]) -> Result<Vec<R>, Error> {
        let mut found: Vec<Option<R>> = vec![None; positions.len()];
        let mut wanted: BTreeMap<usize, Vec<(usize, usize)>> = BTreeMap::new();
        for (at, &position) in positions.iter().enumerate() {
            match self.places[position] {
                Place::File { file, row } => wanted.entry(file).or_default().push((row, at)),
                Place::Given(row) => found[at] = Some(self.given[row].clone()),
            }
        }
        for (file, mut wanted) in wanted {
            wanted.sort_unstable();
            let rows: Vec<usize> = wanted.iter().map(|(row, _)| *row).collect();
            let read: Vec<R> = self.files[file].rows_at(&rows)?;
            for ((_, at), row) in wanted.into_iter().zip(read) {
                found[at] = Some(row);
            }
        }
        let found: Option<Vec<R>> = found.into_iter().collect();
        Ok(found.expect("the places are those of the footer, and none stands twice"))
    }
}
