//! Recorded training windows, read in recorded or shuffled order.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use datasets_spec::record::WindowRow;
use datasets_spec::table::{Row, ShardReader};
use datasets_spec::{Dataset, Seed, Split};
use kinematics::normalise::FRAME_WIDTH;
use rayon::prelude::*;

use super::WindowBatch;
use super::draw::Shuffle;
use crate::Error;

/// Blocks that are shuffled together: a batch of 1,024 windows.
const MIXED_BLOCKS: usize = 16;
/// Number of groups of blocks kept in memory: the windows of a batch may come from two groups.
const HELD_GROUPS: usize = 2;

datasets_spec::table! {
    /// The numbers of a recorded window.
    pub struct WindowFrames = "windows" {
        /// Window of the original, frame by frame, in model units
        pub original: Vec<[f32; FRAME_WIDTH]> [""],
        /// Window of the edited motion, frame by frame, in model units
        pub edited: Vec<[f32; FRAME_WIDTH]> [""],
    }
}

datasets_spec::table! {
    /// Columns of a recorded window besides its numbers.
    pub struct WindowWords = "windows" {
        /// Where the window starts in the motion its instruction speaks of, as a share of its length
        pub progress: f32 [""],
        /// What turns the original into the edited window
        pub instruction: String [""],
    }
}

/// Order in which recorded windows are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReadOrder {
    /// In the recorded order.
    Sequential,
    /// Blocks shuffled over all files for each epoch, and windows shuffled within every 16 blocks. The recorded
    /// stream is shuffled itself, so windows of a block are unrelated.
    Shuffled(Seed),
}

impl ReadOrder {
    /// A random order of `count` parts, seeded by `name`; `None` for the recorded order.
    fn of(self, count: usize, name: &[&str]) -> Option<Shuffle> {
        match self {
            Self::Sequential => None,
            Self::Shuffled(seed) => Some(Shuffle::new(count as u64, seed.draw_u64(name))),
        }
    }
}

/// The windows of a dataset of table `windows`. Item `i` of an epoch does not depend on earlier reads. Only
/// instructions and the windows of two groups of blocks are in memory.
#[derive(Debug)]
pub struct WindowLoader {
    root: PathBuf,
    files: Vec<ShardReader>,
    blocks: Vec<Block>,
    progress: Vec<f32>,
    /// Distinct instructions, and the index of each window's instruction.
    instructions: Vec<String>,
    instruction_of: Vec<u32>,
    window: usize,
    order: ReadOrder,
    held: Mutex<Vec<Arc<Group>>>,
}

/// Consecutive windows in a file.
#[derive(Clone, Copy, Debug)]
struct Block {
    file: usize,
    /// Index of the block's first window in the file and among all windows.
    first: [usize; 2],
    num_rows: usize,
}

/// The windows of blocks that are shuffled together.
#[derive(Debug)]
struct Group {
    epoch: u64,
    index: usize,
    blocks: Vec<Vec<WindowFrames>>,
}

impl WindowLoader {
    /// Opens the windows of a split.
    ///
    /// # Errors
    /// The dataset cannot be read, or has no windows in the split or windows of several lengths.
    pub fn open(dataset: &Dataset, split: Split, order: ReadOrder) -> Result<Self, Error> {
        let mut loader = Self {
            root: dataset.root().to_owned(),
            files: Vec::new(),
            blocks: Vec::new(),
            progress: Vec::new(),
            instructions: Vec::new(),
            instruction_of: Vec::new(),
            window: 0,
            order,
            held: Mutex::default(),
        };
        let mut known = std::collections::BTreeMap::new();
        for (path, _) in dataset.files(WindowRow::TABLE, Some(split)) {
            let file = ShardReader::open(&path)?;
            let num_rows = file.num_rows();
            let block = |first: usize| Block {
                file: loader.files.len(),
                first: [first, loader.progress.len() + first],
                num_rows: WindowRow::PAGE_ROWS.min(num_rows - first),
            };
            let firsts = (0..num_rows).step_by(WindowRow::PAGE_ROWS);
            loader.blocks.extend(firsts.map(block));
            for words in file.rows::<WindowWords>()? {
                let next = known.len() as u32;
                let instruction = *known.entry(words.instruction).or_insert(next);
                loader.instruction_of.push(instruction);
                loader.progress.push(words.progress);
            }
            loader.files.push(file);
        }
        let Some(first) = loader.blocks.first() else {
            let path = loader.root.display();
            return Err(Error::Refused(format!(
                "{path} holds no recorded windows of split {split}; run: stance triplets DATASET --windows N --out \
                 {path}"
            )));
        };
        let first: Vec<WindowFrames> = loader.files[first.file].rows_at(&[0])?;
        loader.window = first.iter().map(|row| row.edited.len()).sum::<usize>() * FRAME_WIDTH;
        loader.instructions.resize(known.len(), String::new());
        for (text, index) in known {
            loader.instructions[index as usize] = text;
        }
        Ok(loader)
    }

    /// Windows of an epoch.
    pub fn epoch_len(&self) -> u64 {
        self.progress.len() as u64
    }

    /// Number of values per window.
    pub fn window_len(&self) -> usize {
        self.window
    }

    /// Every instruction, each once.
    pub fn instructions(&self) -> &[String] {
        &self.instructions
    }

    /// Reads the items `first_item..first_item + num_items` of an epoch.
    ///
    /// # Errors
    /// A file cannot be read, or a window is of another length than the first.
    ///
    /// # Panics
    /// If the items are not all in the epoch.
    pub fn fill(
        &self,
        epoch: u64,
        first_item: u64,
        num_items: usize,
        batch: &mut WindowBatch,
    ) -> Result<(), Error> {
        let wanted = first_item..first_item.saturating_add(num_items as u64);
        assert!(
            wanted.end <= self.epoch_len(),
            "items {wanted:?} of an epoch of {}",
            self.epoch_len()
        );
        batch.resize(num_items, self.window);
        let mut start = 0;
        for (index, blocks) in self.groups(epoch).enumerate() {
            let count: usize = blocks
                .iter()
                .map(|&block| self.blocks[block].num_rows)
                .sum();
            let end = start + count as u64;
            if end > wanted.start && start < wanted.end {
                let group = self.group(epoch, index, &blocks)?;
                let name = ["window order", &epoch.to_string(), &index.to_string()];
                let mix = self.order.of(count, &name);
                let of_blocks = std::iter::zip(&blocks, &group.blocks);
                let windows = of_blocks.flat_map(|(&block, rows)| {
                    let first = self.blocks[block].first[1];
                    rows.iter()
                        .enumerate()
                        .map(move |(row, window)| (first + row, window))
                });
                for (own, (row, window)) in (0u64..).zip(windows) {
                    let item = start + mix.as_ref().map_or(own, |mix| mix.at(own));
                    if wanted.contains(&item) {
                        self.put(row, window, batch, (item - wanted.start) as usize);
                    }
                }
            }
            start = end;
            if start >= wanted.end {
                break;
            }
        }
        Ok(())
    }

    fn put(&self, row: usize, window: &WindowFrames, batch: &mut WindowBatch, place: usize) {
        batch.progress[place] = self.progress[row];
        let text = &self.instructions[self.instruction_of[row] as usize];
        batch.instructions[place].clone_from(text);
        let numbers = place * self.window..(place + 1) * self.window;
        batch.original[numbers.clone()].copy_from_slice(window.original.as_flattened());
        batch.edited[numbers].copy_from_slice(window.edited.as_flattened());
    }

    /// The windows of a group of blocks, from memory or from the files.
    fn group(&self, epoch: u64, index: usize, blocks: &[usize]) -> Result<Arc<Group>, Error> {
        let held = || self.held.lock().unwrap_or_else(PoisonError::into_inner);
        let is_it = |group: &&Arc<Group>| (group.epoch, group.index) == (epoch, index);
        if let Some(group) = held().iter().find(is_it) {
            return Ok(Arc::clone(group));
        }
        // Read without the lock: reader threads may wait for it.
        let read = |&block: &usize| {
            let block = self.blocks[block];
            let rows: Vec<usize> = (block.first[0]..block.first[0] + block.num_rows).collect();
            let read: Vec<WindowFrames> = self.files[block.file].rows_at(&rows)?;
            let fits = |frames: &Vec<_>| frames.len() * FRAME_WIDTH == self.window;
            if read
                .iter()
                .all(|row| fits(&row.original) && fits(&row.edited))
            {
                return Ok(read);
            }
            Err(Error::Refused(format!(
                "the windows recorded in {} are of several lengths; record them again: stance triplets DATASET \
                 --windows N --out FOLDER",
                self.root.display()
            )))
        };
        let group = Arc::new(Group {
            epoch,
            index,
            blocks: blocks.par_iter().map(read).collect::<Result<_, Error>>()?,
        });
        let mut held = held();
        held.insert(0, Arc::clone(&group));
        held.truncate(HELD_GROUPS);
        Ok(group)
    }

    /// The blocks of an epoch in groups that are shuffled together.
    fn groups(&self, epoch: u64) -> impl Iterator<Item = Vec<usize>> + '_ {
        let count = self.blocks.len();
        let order = self.order.of(count, &["page order", &epoch.to_string()]);
        (0..count.div_ceil(MIXED_BLOCKS)).map(move |group| {
            let first = group * MIXED_BLOCKS;
            (first..count.min(first + MIXED_BLOCKS))
                .map(|place| match &order {
                    Some(order) => order.at(place as u64) as usize,
                    None => place,
                })
                .collect()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ComposeConfig, fixture};

    /// A recorded dataset, and the windows that were recorded.
    fn recorded(count: usize) -> (tempfile::TempDir, Dataset, WindowBatch) {
        let library = fixture::library(Split::Train, 30);
        let config = ComposeConfig::default();
        let stream = fixture::stream(library, config, 2).expect("a stream");
        let mut whole = WindowBatch::default();
        let mut rows = Vec::new();
        let recorded = stream.for_each_recorded(0..count as u64, |row, batch, at| {
            let range = at * stream.window_len()..(at + 1) * stream.window_len();
            whole.original.extend(&batch.original[range.clone()]);
            whole.edited.extend(&batch.edited[range]);
            whole.progress.push(row.progress);
            whole.instructions.push(row.instruction.clone());
            rows.push(row);
        });
        recorded.expect("in memory");
        let dir = tempfile::tempdir().expect("a folder");
        let dataset = fixture::commit(dir.path(), &rows, |row| row.split, "plan");
        (dir, dataset, whole)
    }

    fn epoch(loader: &WindowLoader, epoch: u64, batch_len: usize) -> WindowBatch {
        let mut whole = WindowBatch::default();
        let mut batch = WindowBatch::default();
        let mut first = 0;
        while first < loader.epoch_len() {
            let count = batch_len.min((loader.epoch_len() - first) as usize);
            loader.fill(epoch, first, count, &mut batch).expect("read");
            whole.original.append(&mut batch.original);
            whole.edited.append(&mut batch.edited);
            whole.progress.append(&mut batch.progress);
            whole.instructions.append(&mut batch.instructions);
            first += count as u64;
        }
        whole
    }

    /// The windows as sorted byte strings, to compare contents independent of order.
    fn contents(batch: &WindowBatch) -> Vec<(Vec<u32>, String)> {
        let window = batch.edited.len() / batch.progress.len();
        let sides = batch
            .original
            .chunks(window)
            .zip(batch.edited.chunks(window));
        let mut all: Vec<(Vec<u32>, String)> = sides
            .zip(&batch.instructions)
            .map(|((original, edited), text)| {
                let bits = original.iter().chain(edited).map(|value| value.to_bits());
                (bits.collect(), text.clone())
            })
            .collect();
        all.sort_unstable();
        all
    }

    #[test]
    fn what_is_recorded_is_read_bit_for_bit_in_any_order() {
        // 150 windows fill two pages of 64 and part of a third; 1 window fills part of one.
        for count in [150, 1] {
            let (_dir, dataset, whole) = recorded(count);
            let open = |order| WindowLoader::open(&dataset, Split::Train, order).expect("windows");
            let sequential = open(ReadOrder::Sequential);
            assert_eq!(sequential.epoch_len(), count as u64);
            for batch_len in [7, 64, 150] {
                assert_eq!(epoch(&sequential, 0, batch_len), whole, "{batch_len}");
            }
            let shuffled = open(ReadOrder::Shuffled(Seed(3)));
            let first = epoch(&shuffled, 0, 64);
            assert_eq!(epoch(&shuffled, 0, 33), first, "whatever the batch");
            assert_eq!(contents(&first), contents(&whole), "every window once");
            if count > 1 {
                assert_ne!(first, whole);
                assert_ne!(epoch(&shuffled, 1, 64), first, "epochs differ");
            }
        }
    }

    #[test]
    fn a_split_without_windows_is_named() {
        let (_dir, dataset, _) = recorded(3);
        let missing = WindowLoader::open(&dataset, Split::Val, ReadOrder::Sequential);
        let error = missing.expect_err("no windows").to_string();
        let named = "holds no recorded windows of split val;";
        assert!(error.contains(named), "{error}");
    }
}
