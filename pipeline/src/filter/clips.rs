//! The clips of a dataset, all or those that a filter chooses, read shard by shard.

use std::path::PathBuf;

use datasets_spec::record::MotionRow;
use datasets_spec::table::{Cell, Row, ShardReader, read_rows};
use datasets_spec::{Dataset, Split};

use super::Filter;
use crate::Error;

/// Clips of a dataset.
#[derive(Debug)]
pub struct Clips<'a> {
    dataset: &'a Dataset,
    shards: Vec<Shard>,
}

/// Clips of one file.
#[derive(Debug)]
pub struct Shard {
    path: PathBuf,
    split: Option<Split>,
    num_clips: u64,
    /// Places of the chosen rows; none if all are.
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

    /// The clips that a filter chooses. Only the columns that it names are read.
    ///
    /// # Errors
    /// It chooses none, or a file cannot be read.
    pub fn chosen(dataset: &'a Dataset, filter: &Filter) -> Result<Self, Error> {
        let mut clips = Self::all(dataset);
        for shard in &mut clips.shards {
            let rows = filter.rows(&ShardReader::open(&shard.path)?)?;
            shard.num_clips = rows.len() as u64;
            shard.rows = Some(rows);
        }
        if clips.is_empty() {
            return Err(Error::NoneChosen {
                path: dataset.root().to_owned(),
            });
        }
        Ok(clips)
    }

    /// The dataset.
    pub fn dataset(&self) -> &'a Dataset {
        self.dataset
    }

    /// Number of clips.
    pub fn len(&self) -> u64 {
        self.shards.iter().map(|shard| shard.num_clips).sum()
    }

    /// Whether there is none.
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
    /// The rows of the clips. Where a filter chose them, only their pages are read, and each motion is
    /// checked against its hash.
    ///
    /// # Errors
    /// The file cannot be read, or a motion is damaged.
    pub fn read(&self) -> Result<Vec<MotionRow>, Error> {
        let Some(rows) = &self.rows else {
            return Ok(read_rows(&self.path)?);
        };
        let rows: Vec<MotionRow> = ShardReader::open(&self.path)?.rows_at(rows)?;
        for row in &rows {
            check_content(row, &self.path)?;
        }
        Ok(rows)
    }

    /// A column of the clips; no other is read.
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

/// Checks a motion against its recorded hash.
///
/// # Errors
/// They differ.
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
