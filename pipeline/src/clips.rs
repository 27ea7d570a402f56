//! The clips of a dataset, all or those that a condition chooses, read shard by shard.

use std::ops::Range;
use std::path::PathBuf;

use datasets_spec::record::MotionRow;
use datasets_spec::table::{Cell, Row, ShardReader, read_rows};
use datasets_spec::{Dataset, Split};
use serde::{Deserialize, Serialize};

use tables::Condition;

use crate::Error;

/// Clips of a dataset.
#[derive(Debug)]
pub struct Clips<'a> {
    dataset: &'a Dataset,
    shards: Vec<Shard>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Part {
    pub(crate) shard: usize,
    /// Indices among the chosen clips of the shard.
    pub(crate) clips: Range<usize>,
}

/// Clips of one file.
#[derive(Clone, Debug)]
pub struct Shard {
    path: PathBuf,
    split: Option<Split>,
    num_clips: u64,
    /// Indices of the chosen rows; `None` if all are chosen.
    rows: Option<Vec<usize>>,
}

impl<'a> Clips<'a> {
    /// Every clip of a dataset.
    pub fn all(dataset: &'a Dataset) -> Self {
        let files = dataset.files(MotionRow::TABLE, None).into_iter();
        let shard = |(path, file): (PathBuf, &datasets_spec::manifest::FileEntry)| Shard {
            path,
            split: file.split,
            num_clips: file.rows,
            rows: None,
        };
        Self {
            dataset,
            shards: files.map(shard).collect(),
        }
    }

    /// The clips for which a condition is true. Only the columns that it names are read.
    ///
    /// # Errors
    /// The condition chooses no clip, or a file cannot be read.
    pub fn chosen(dataset: &'a Dataset, condition: &Condition) -> Result<Self, Error> {
        let mut clips = Self::all(dataset);
        for (shard, rows) in clips.shards.iter_mut().zip(condition.rows(dataset)?) {
            shard.num_clips = rows.len() as u64;
            shard.rows = Some(rows);
        }
        if clips.is_empty() {
            let path = dataset.root().to_owned();
            return Err(tables::Error::NoneChosen { path }.into());
        }
        Ok(clips)
    }

    /// The clips of shards from [`Clips::into_shards`].
    pub(crate) fn of(dataset: &'a Dataset, shards: &[Shard]) -> Self {
        let shards = shards.to_vec();
        Self { dataset, shards }
    }

    pub(crate) fn into_shards(self) -> Vec<Shard> {
        self.shards
    }

    /// Keeps at most the first `count` clips.
    pub(crate) fn first(mut self, count: usize) -> Self {
        let mut left = count;
        for shard in &mut self.shards {
            let len = usize::try_from(shard.num_clips).unwrap_or(usize::MAX);
            let taken = len.min(left);
            left -= taken;
            if taken < len {
                let mut rows = shard.rows.take().unwrap_or_else(|| (0..taken).collect());
                rows.truncate(taken);
                shard.num_clips = taken as u64;
                shard.rows = Some(rows);
            }
        }
        self.shards.retain(|shard| shard.num_clips > 0);
        self
    }

    /// Parts of at most `most` clips; a part lies in one file.
    pub(crate) fn parts(&self, most: usize) -> Vec<Part> {
        let mut parts = Vec::new();
        for (shard, clips) in self.shards.iter().enumerate() {
            let len = usize::try_from(clips.num_clips).unwrap_or(usize::MAX);
            let starts = (0..len).step_by(most);
            parts.extend(starts.map(|start| Part {
                shard,
                clips: start..len.min(start + most),
            }));
        }
        parts
    }

    /// The rows of a part; see [`Shard::read`].
    pub(crate) fn read(&self, part: &Part) -> Result<Vec<MotionRow>, Error> {
        let Some(shard) = self.shards.get(part.shard) else {
            return Ok(Vec::new());
        };
        shard.read_at(&match &shard.rows {
            None => part.clips.clone().collect::<Vec<_>>(),
            Some(rows) => rows.get(part.clips.clone()).unwrap_or_default().to_vec(),
        })
    }

    /// The dataset.
    pub fn dataset(&self) -> &'a Dataset {
        self.dataset
    }

    /// Number of clips.
    pub fn len(&self) -> u64 {
        self.shards.iter().map(|shard| shard.num_clips).sum()
    }

    /// Whether there are no clips.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The files, all or those of a split.
    pub fn shards(&self, split: Option<Split>) -> impl Iterator<Item = &Shard> {
        self.shards
            .iter()
            .filter(move |shard| split.is_none() || shard.split == split)
    }
}

impl Shard {
    pub(crate) fn path(&self) -> &std::path::Path {
        &self.path
    }

    /// The rows of the clips. If a condition chose the clips, only their pages are read, and each motion is checked
    /// against its hash.
    ///
    /// # Errors
    /// The file cannot be read, or a motion is damaged.
    pub fn read(&self) -> Result<Vec<MotionRow>, Error> {
        match &self.rows {
            None => Ok(read_rows(&self.path)?),
            Some(rows) => self.read_at(rows),
        }
    }

    fn read_at(&self, places: &[usize]) -> Result<Vec<MotionRow>, Error> {
        let rows: Vec<MotionRow> = ShardReader::open(&self.path)?.rows_at(places)?;
        if self.rows.is_some() {
            for row in &rows {
                check_content(row, &self.path)?;
            }
        }
        Ok(rows)
    }

    /// A column of the clips; no other column is read.
    ///
    /// # Errors
    /// The file cannot be read or lacks the column.
    pub fn column<T: Cell>(&self, name: &'static str) -> Result<Vec<T>, Error> {
        let values = ShardReader::open(&self.path)?.column::<MotionRow, T>(name)?;
        let Some(rows) = &self.rows else {
            return Ok(values);
        };
        let mut wanted = rows.iter().copied().peekable();
        let values = values.into_iter().enumerate();
        Ok(values
            .filter(|(row, _)| wanted.next_if_eq(row).is_some())
            .map(|(_, value)| value)
            .collect())
    }
}

pub(crate) fn check_content(row: &MotionRow, path: &std::path::Path) -> Result<(), Error> {
    let found = row.motion()?.content_hash();
    if found == row.content_hash {
        return Ok(());
    }
    Err(Error::Spec(datasets_spec::Error::Corrupt {
        path: path.to_owned(),
        detail: format!(
            "clip {}: BLAKE3 expected {}, found {found}",
            row.id, row.content_hash
        ),
    }))
}
