//! Questions about what a dataset holds, answered by polars from the metadata columns alone.

use std::fs::File;

use datasets_spec::Dataset;
use datasets_spec::record::{EditRow, ItemRow, MotionRow, ScoreRow, TripletRow, WindowRow};
use datasets_spec::table::Row;
use polars::prelude::*;
use serde::Serialize;

use crate::Error;

/// Clips that share a label.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Group {
    /// The label; empty where the source gave none.
    pub label: String,
    /// Number of clips.
    pub clips: u64,
    /// Their length in minutes.
    pub minutes: f64,
}

/// What a dataset's motions are, by several labels.
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
    let wrap = |source| Error::Query {
        table: MotionRow::TABLE,
        dataset: dataset.root().to_owned(),
        source,
    };
    let mut frames: Option<DataFrame> = None;
    for (path, entry) in dataset.files(MotionRow::TABLE, None) {
        if entry.rows == 0 {
            continue;
        }
        let file = File::open(&path).map_err(Error::io("open", &path))?;
        let columns = ["split", "source", "action", "style", "n_frames", "fps"];
        let frame = ParquetReader::new(file)
            .with_columns(Some(columns.map(str::to_owned).to_vec()))
            .finish()
            .map_err(wrap)?;
        match &mut frames {
            None => frames = Some(frame),
            Some(frames) => {
                frames.vstack_mut(&frame).map_err(wrap)?;
            }
        }
    }
    let Some(frames) = frames else {
        return Ok(Catalogue {
            splits: Vec::new(),
            sources: Vec::new(),
            actions: Vec::new(),
            styles: Vec::new(),
        });
    };
    let by = |label: &str| group(&frames, label).map_err(wrap);
    Ok(Catalogue {
        splits: by("split")?,
        sources: by("source")?,
        actions: by("action")?,
        styles: by("style")?,
    })
}

fn group(frames: &DataFrame, label: &str) -> PolarsResult<Vec<Group>> {
    let n_frames = frames.column("n_frames")?.cast(&DataType::Float64)?;
    let fps = frames.column("fps")?.cast(&DataType::Float64)?;
    let seconds = (n_frames.as_materialized_series() / fps.as_materialized_series())?;
    let labels = frames
        .column(label)?
        .as_materialized_series()
        .fill_null_with_empty()?;
    let table = DataFrame::new_infer_height(vec![
        labels.with_name("label".into()).into(),
        seconds.with_name("seconds".into()).into(),
    ])?;
    let groups = table
        .group_by(["label"])?
        .apply(|group| {
            let seconds = group.column("seconds")?.f64()?.sum().unwrap_or(0.0);
            DataFrame::new_infer_height(vec![
                group.column("label")?.head(Some(1)),
                Column::new("clips".into(), [group.height() as u64]),
                Column::new("minutes".into(), [seconds / 60.0]),
            ])
        })?
        .sort(["label"], SortMultipleOptions::default())?;
    let (labels, clips, minutes) = (
        groups.column("label")?.str()?.clone(),
        groups.column("clips")?.u64()?.clone(),
        groups.column("minutes")?.f64()?.clone(),
    );
    Ok((0..groups.height())
        .map(|row| Group {
            label: labels.get(row).unwrap_or_default().to_owned(),
            clips: clips.get(row).unwrap_or_default(),
            minutes: minutes.get(row).unwrap_or_default(),
        })
        .collect())
}

/// Missing labels as empty ones.
trait FillEmpty {
    fn fill_null_with_empty(&self) -> PolarsResult<Series>;
}

impl FillEmpty for Series {
    fn fill_null_with_empty(&self) -> PolarsResult<Series> {
        let filled: StringChunked = self
            .str()?
            .iter()
            .map(|label| Some(label.unwrap_or("")))
            .collect();
        Ok(filled.into_series())
    }
}
/// What a folder holds in place of motions, and which verbs take it; none if it holds motions.
pub fn other_than_motions(dataset: &Dataset) -> Option<&'static str> {
    let has = |table: &str| dataset.manifest().rows(table, None) > 0;
    if has(MotionRow::TABLE) {
        return None;
    }
    // A folder of edits holds a copy of its items.
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
