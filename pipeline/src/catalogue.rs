//! Contents of a dataset, counted from the metadata columns only.

use datasets_spec::Dataset;
use datasets_spec::record::{EditRow, ItemRow, MotionRow, ScoreRow, TripletRow, WindowRow};
use datasets_spec::table::Row;
use serde::Serialize;

use crate::Error;
use crate::counts::{Counts, Share};

/// Clips that share a label.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Group {
    /// The label; empty if the source gave none.
    pub label: String,
    /// Number of clips.
    pub clips: u64,
    /// Total length of the clips in minutes.
    pub minutes: f64,
}

/// Clips of a dataset, counted by several labels.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Catalogue {
    /// By split.
    pub splits: Vec<Group>,
    /// By kind of source.
    pub sources: Vec<Group>,
    /// By action.
    pub actions: Vec<Group>,
    /// By style.
    pub styles: Vec<Group>,
}

/// Counts the motions of a dataset. Only metadata columns are read.
///
/// # Errors
/// A file cannot be read or lacks a column.
pub fn catalogue(dataset: &Dataset) -> Result<Catalogue, Error> {
    let mut counts = Counts::new(dataset, None)?;
    let mut by = |label: &str| -> Result<Vec<Group>, Error> {
        let shares = counts.shares(&format!("COALESCE({label}, '')"))?;
        let group = |(label, share): (String, Share)| Group {
            label,
            clips: share.clips,
            minutes: 60.0 * share.hours,
        };
        Ok(shares.into_iter().map(group).collect())
    };
    Ok(Catalogue {
        splits: by("split")?,
        sources: by("source")?,
        actions: by("action")?,
        styles: by("style")?,
    })
}

/// Describes a folder without motions and names the commands that take it; `None` if it holds motions.
pub fn other_than_motions(dataset: &Dataset) -> Option<&'static str> {
    let has = |table: &str| dataset.manifest().rows(table, None) > 0;
    if has(MotionRow::TABLE) {
        return None;
    }
    // Edits come first, because a folder of edits also holds their items.
    let kinds = [
        (
            EditRow::TABLE,
            "a folder of edits, the answers of systems to items; `stance eval` scores it and \
             `stance report` shows it",
        ),
        (
            ItemRow::TABLE,
            "a folder of items, the test questions; `stance edit RUN --items` answers it and \
             `stance eval --items` scores the real data on it",
        ),
        (
            TripletRow::TABLE,
            "a folder of recorded triplets; `stance inspect` tells what it holds",
        ),
        (
            WindowRow::TABLE,
            "a folder of recorded windows; `stance train motionrefit DATASET --windows` takes it",
        ),
        (
            ScoreRow::TABLE,
            "a folder of scores; `stance inspect` tells what it holds",
        ),
    ];
    let found = kinds.into_iter().find(|(table, _)| has(table));
    Some(found.map_or("a dataset without motions", |(_, what)| what))
}
