//! Rewrites the rows of clips from all files of a dataset into shards like those of a new dataset.

use std::collections::BTreeMap;
use std::path::PathBuf;

use datasets_spec::dataset::ShardName;
use datasets_spec::manifest::FileEntry;
use datasets_spec::record::{HumanMl3dRow, MarkerRow, MotionRow};
use datasets_spec::table::{Row, ShardReader};
use datasets_spec::{Dataset, MotionId, Progress, Split, Transaction};

use crate::Error;
use crate::clip_table::{CLIP_TABLES, ClipRow, borrowed, clip_ids};
use crate::ingest::SHARD_CLIPS;

/// Index of a file, and of a row in it.
type Place = (usize, usize);

/// A clip, or a capture that has only markers.
pub(super) struct Clip {
    pub(super) id: MotionId,
    pub(super) split: Split,
    /// Where its rows are, by table in the order of [`CLIP_TABLES`].
    places: [Option<Place>; 3],
}

impl Clip {
    pub(super) fn has_motion(&self) -> bool {
        self.places[0].is_some()
    }
}

/// The clips of a dataset in the order of its files, without their frames.
#[derive(Default)]
pub(super) struct ClipIndex {
    pub(super) clips: Vec<Clip>,
    files: [Vec<PathBuf>; 3],
}

impl ClipIndex {
    pub(super) fn read(dataset: &Dataset) -> Result<Self, Error> {
        let mut index = Self::default();
        let mut of_id: BTreeMap<MotionId, usize> = BTreeMap::new();
        for (table, name) in CLIP_TABLES.into_iter().enumerate() {
            for (number, (path, file)) in dataset.files(name, None).into_iter().enumerate() {
                let shard = ShardReader::open(&path)?;
                for (row, id) in clip_ids(name, &shard)?.into_iter().enumerate() {
                    let clip = *of_id.entry(id.clone()).or_insert_with(|| {
                        index.clips.push(Clip {
                            id,
                            split: file.split.unwrap_or(Split::Train),
                            places: [None; 3],
                        });
                        index.clips.len() - 1
                    });
                    index.clips[clip].places[table] = Some((number, row));
                }
                index.files[table].push(path);
            }
        }
        Ok(index)
    }

    pub(super) fn num_shards(&self) -> usize {
        let clips_of = |split| self.clips.iter().filter(move |clip| clip.split == split);
        let shards = Split::ALL.map(|split| clips_of(split).count().div_ceil(SHARD_CLIPS));
        shards.into_iter().sum()
    }

    /// Writes the clips into as few shards as a new dataset has. Memory holds the rows of one shard.
    pub(super) fn write(
        &self,
        transaction: &Transaction,
        progress: &dyn Progress,
    ) -> Result<BTreeMap<String, Vec<FileEntry>>, Error> {
        let mut tables = BTreeMap::new();
        let facts = self.facts()?;
        progress.begin("shards", Some(self.num_shards() as u64));
        for split in Split::ALL {
            let clips: Vec<&Clip> = self
                .clips
                .iter()
                .filter(|clip| clip.split == split)
                .collect();
            let of = clips.len().div_ceil(SHARD_CLIPS);
            for (index, clips) in clips.chunks(SHARD_CLIPS).enumerate() {
                let name = ShardName {
                    table: MotionRow::TABLE,
                    split: Some(split),
                    index,
                    of,
                };
                let mut shard = Shard {
                    transaction,
                    name,
                    tables: &mut tables,
                };
                shard.write::<MotionRow>(&self.files[0], clips, 0, &facts[0])?;
                shard.write::<MarkerRow>(&self.files[1], clips, 1, &facts[1])?;
                shard.write::<HumanMl3dRow>(&self.files[2], clips, 2, &facts[2])?;
                progress.advance(1);
            }
        }
        progress.finish(&format!("{} clips", self.clips.len()));
        Ok(tables)
    }

    /// Footer facts of the first file of each table.
    fn facts(&self) -> Result<[Vec<(String, String)>; 3], Error> {
        let mut facts: [Vec<(String, String)>; 3] = Default::default();
        for (facts, files) in facts.iter_mut().zip(&self.files) {
            if let Some(first) = files.first() {
                *facts = ShardReader::open(first)?.facts();
            }
        }
        Ok(facts)
    }
}

/// A shard being written. Its files in the tables of motions, markers and features share its name.
struct Shard<'a> {
    transaction: &'a Transaction,
    name: ShardName,
    tables: &'a mut BTreeMap<String, Vec<FileEntry>>,
}

impl Shard<'_> {
    fn write<R: ClipRow>(
        &mut self,
        files: &[PathBuf],
        clips: &[&Clip],
        table: usize,
        facts: &[(String, String)],
    ) -> Result<(), Error> {
        let places: Vec<Place> = clips.iter().filter_map(|clip| clip.places[table]).collect();
        if places.is_empty() && R::TABLE != MotionRow::TABLE {
            return Ok(());
        }
        let name = ShardName {
            table: R::TABLE,
            ..self.name.clone()
        };
        let rows: Vec<R> = rows_at(files, &places)?;
        let entry = self
            .transaction
            .write_shard(&name, &rows, &borrowed(facts))?;
        let files = self.tables.entry(R::TABLE.to_owned()).or_default();
        files.push(entry);
        Ok(())
    }
}

/// The rows at some places of several files, in the order of `places`.
fn rows_at<R: Row>(files: &[PathBuf], places: &[Place]) -> Result<Vec<R>, Error> {
    let mut by_file: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (file, row) in places {
        by_file.entry(*file).or_default().push(*row);
    }
    let mut found: BTreeMap<Place, R> = BTreeMap::new();
    for (file, mut wanted) in by_file {
        wanted.sort_unstable();
        let rows: Vec<R> = ShardReader::open(&files[file])?.rows_at(&wanted)?;
        found.extend(wanted.into_iter().map(|row| (file, row)).zip(rows));
    }
    let rows = places.iter().filter_map(|place| found.remove(place));
    Ok(rows.collect())
}
