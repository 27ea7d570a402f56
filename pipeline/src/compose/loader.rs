//! Recorded training windows, read in recorded or shuffled order.

use datasets_spec::record::WindowRow;
use datasets_spec::table::{FramePages, Row, read_column};
use datasets_spec::{Dataset, Seed, Split};
use rayon::prelude::*;

use super::WindowBatch;
use super::draw::Shuffle;
use crate::Error;

/// Pages that are shuffled together: a batch of 1,024 windows.
const MIXED_PAGES: usize = 16;

/// Order in which recorded windows are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReadOrder {
    /// As they were recorded.
    Sequential,
    /// Pages shuffled over all files for each epoch, and windows shuffled within every 16 pages. The recorded
    /// stream is shuffled itself, so windows of a page are unrelated.
    Shuffled(Seed),
}

/// The windows of a dataset of table `windows`. Item `i` of an epoch does not depend on earlier reads. Only
/// instructions and the requested windows are in memory.
#[derive(Debug)]
pub struct WindowLoader {
    files: Vec<FramePages>,
    pages: Vec<PageRef>,
    /// Windows before each page, in recorded order.
    first_rows: Vec<u64>,
    num_windows: u64,
    progress: Vec<f32>,
    /// Distinct instructions, and the index of each window's instruction.
    instructions: Vec<String>,
    instruction_of: Vec<u32>,
    window: usize,
    order: ReadOrder,
}

#[derive(Clone, Copy, Debug)]
struct PageRef {
    file: usize,
    page: usize,
    num_rows: usize,
}

/// Rows of a page, and their destinations.
type Room<'a> = Vec<(usize, &'a mut [f32])>;

/// Destinations of a page's windows.
struct Placed {
    page: usize,
    /// Row of the page and place in the batch.
    rows: Vec<(usize, usize)>,
}

impl WindowLoader {
    /// Opens the windows of a split.
    ///
    /// # Errors
    /// The dataset cannot be read or has no windows in the split.
    pub fn open(dataset: &Dataset, split: Split, order: ReadOrder) -> Result<Self, Error> {
        let mut files = Vec::new();
        let mut pages = Vec::new();
        let mut first_rows = Vec::new();
        let mut num_windows = 0;
        let mut known = std::collections::BTreeMap::new();
        let mut loader = Self {
            files: Vec::new(),
            pages: Vec::new(),
            first_rows: Vec::new(),
            num_windows: 0,
            progress: Vec::new(),
            instructions: Vec::new(),
            instruction_of: Vec::new(),
            window: 0,
            order,
        };
        for (path, _) in dataset.files(WindowRow::TABLE, Some(split)) {
            let file = FramePages::open(&path, &["original", "edited"])?;
            for (page, num_rows) in file.rows_of_pages().enumerate() {
                pages.push(PageRef {
                    file: files.len(),
                    page,
                    num_rows,
                });
                first_rows.push(num_windows);
                num_windows += num_rows as u64;
            }
            files.push(file);
            loader.window = files.last().map_or(Ok(0), |file| file.row_len(0))?;
            for text in read_column::<WindowRow, String>(&path, "instruction")? {
                let next = known.len() as u32;
                loader
                    .instruction_of
                    .push(*known.entry(text).or_insert(next));
            }
            let progress = read_column::<WindowRow, f32>(&path, "progress")?;
            loader.progress.extend(progress);
        }
        let mut instructions = vec![String::new(); known.len()];
        for (text, index) in known {
            instructions[index as usize] = text;
        }
        if num_windows == 0 || num_windows != loader.progress.len() as u64 {
            return Err(Error::NoWindows {
                path: dataset.root().to_owned(),
                split,
            });
        }
        Ok(Self {
            files,
            pages,
            first_rows,
            num_windows,
            instructions,
            ..loader
        })
    }

    /// Windows of an epoch.
    pub fn epoch_len(&self) -> u64 {
        self.num_windows
    }

    /// Numbers of a window.
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
    /// A page cannot be read.
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
        let end = first_item.saturating_add(num_items as u64);
        assert!(
            end <= self.num_windows,
            "items {first_item}..{end} of an epoch of {}",
            self.num_windows
        );
        batch.resize(num_items, self.window);
        let placed = self.places(epoch, first_item, num_items);
        for page in &placed {
            let first = self.first_rows[page.page] as usize;
            for &(row, place) in &page.rows {
                batch.progress[place] = self.progress[first + row];
                let text = &self.instructions[self.instruction_of[first + row] as usize];
                batch.instructions[place].clear();
                batch.instructions[place].push_str(text);
            }
        }
        for (column, numbers) in [&mut batch.original, &mut batch.edited]
            .into_iter()
            .enumerate()
        {
            self.read_column(&placed, column, numbers)?;
        }
        Ok(())
    }

    /// Reads a column of pages into windows.
    fn read_column(
        &self,
        placed: &[Placed],
        column: usize,
        numbers: &mut [f32],
    ) -> Result<(), Error> {
        // Every window of the batch is written by one page: hand each page its own.
        let mut windows: Vec<Option<&mut [f32]>> =
            numbers.chunks_exact_mut(self.window).map(Some).collect();
        let jobs: Vec<(&Placed, Room<'_>)> = placed
            .iter()
            .map(|page| {
                let mine = page.rows.iter().map(|&(row, place)| {
                    let window = windows[place].take();
                    (row, window.expect("every place is filled once"))
                });
                (page, mine.collect::<Room<'_>>())
            })
            .collect();
        jobs.into_par_iter().try_for_each(|(page, mut mine)| {
            let place = self.pages[page.page];
            mine.sort_unstable_by_key(|(row, _)| *row);
            let mut mine = mine.into_iter().peekable();
            let mut rows: Vec<Option<&mut [f32]>> = (0..place.num_rows)
                .map(|row| {
                    let wanted = mine.next_if(|(wanted, _)| *wanted == row);
                    wanted.map(|(_, window)| window)
                })
                .collect();
            let file = &self.files[place.file];
            Ok(file.read(place.page, column, &mut rows)?)
        })
    }

    /// The pages of the items of an epoch, and the destinations of their windows.
    fn places(&self, epoch: u64, first_item: u64, num_items: usize) -> Vec<Placed> {
        let wanted = first_item..first_item + num_items as u64;
        let mut placed = Vec::new();
        let mut start = 0;
        for (group, pages) in self.groups(epoch).enumerate() {
            let count: usize = pages.iter().map(|&page| self.pages[page].num_rows).sum();
            let end = start + count as u64;
            if end > wanted.start && start < wanted.end {
                let mix = match self.order {
                    ReadOrder::Sequential => None,
                    ReadOrder::Shuffled(seed) => {
                        let name = ["window order", &epoch.to_string(), &group.to_string()];
                        Some(Shuffle::new(count as u64, seed.draw_u64(&name)))
                    }
                };
                let mut in_group = 0;
                for &page in &pages {
                    let rows: Vec<(usize, usize)> = (0..self.pages[page].num_rows)
                        .filter_map(|row| {
                            let own = in_group + row as u64;
                            let item = start + mix.as_ref().map_or(own, |mix| mix.at(own));
                            wanted
                                .contains(&item)
                                .then(|| (row, (item - wanted.start) as usize))
                        })
                        .collect();
                    in_group += self.pages[page].num_rows as u64;
                    if !rows.is_empty() {
                        placed.push(Placed { page, rows });
                    }
                }
            }
            start = end;
            if start >= wanted.end {
                break;
            }
        }
        placed
    }

    /// The pages of an epoch in groups that are shuffled together.
    fn groups(&self, epoch: u64) -> impl Iterator<Item = Vec<usize>> + '_ {
        let count = self.pages.len();
        let order = match self.order {
            ReadOrder::Sequential => None,
            ReadOrder::Shuffled(seed) => {
                let key = seed.draw_u64(&["page order", &epoch.to_string()]);
                Some(Shuffle::new(count as u64, key))
            }
        };
        (0..count.div_ceil(MIXED_PAGES)).map(move |group| {
            let first = group * MIXED_PAGES;
            (first..count.min(first + MIXED_PAGES))
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
    use std::sync::Arc;

    use datasets_spec::dataset::commit_rows;
    use datasets_spec::{Skeleton, Split};

    use super::*;
    use crate::compose::{ComposeConfig, Stream, fixture};

    /// A recorded stream, and what was recorded.
    fn recorded(count: usize) -> (tempfile::TempDir, Dataset, WindowBatch) {
        let library = fixture::library(Split::Train, 30);
        let config = ComposeConfig::default();
        let normalizer = library.fit_normalizer(&config).expect("long enough");
        let stream = Stream::new(Arc::new(library), config, Seed(2), &normalizer);
        let stream = stream.expect("a stream");
        let mut whole = WindowBatch::default();
        let mut rows = Vec::new();
        stream
            .for_each_recorded(0..count as u64, |row, batch, at| {
                let window = stream.window_len();
                whole
                    .original
                    .extend(&batch.original[at * window..][..window]);
                whole.edited.extend(&batch.edited[at * window..][..window]);
                whole.progress.push(row.progress);
                whole.instructions.push(row.instruction.clone());
                rows.push(row);
            })
            .expect("in memory");
        let dir = tempfile::tempdir().expect("a folder");
        let split_of: fn(&WindowRow) -> Split = |row| row.split;
        let skeleton = Skeleton::smplx_neutral();
        let dataset = commit_rows(dir.path(), &rows, Some(split_of), &skeleton, "plan", "test");
        (dir, dataset.expect("committed"), whole)
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

    /// The windows as byte strings, sorted: what there is, whatever the order.
    fn contents(batch: &WindowBatch) -> Vec<(Vec<u32>, String)> {
        let window = batch.edited.len() / batch.progress.len();
        let mut all: Vec<(Vec<u32>, String)> = batch
            .original
            .chunks(window)
            .zip(batch.edited.chunks(window))
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
        // Over two pages of 64 windows, the last of them cut off, and a single one.
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
        assert!(matches!(
            missing,
            Err(Error::NoWindows {
                split: Split::Val,
                ..
            })
        ));
    }
}
