//! What a dataset holds, counted from the metadata columns alone.

use std::collections::BTreeMap;

use datasets_spec::Dataset;
use datasets_spec::record::{EditRow, ItemRow, MotionRow, ScoreRow, TripletRow, WindowRow};
use datasets_spec::table::{Row, ShardReader};
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
    let [mut splits, mut sources, mut actions, mut styles] = [const { BTreeMap::new() }; 4];
    for (path, _) in dataset.files(MotionRow::TABLE, None) {
        let shard = ShardReader::open(&path)?;
        let frames = shard.column::<MotionRow, i32>("n_frames")?;
        let rates = shard.column::<MotionRow, f32>("fps")?;
        let clips: Vec<(i32, f32)> = frames.into_iter().zip(rates).collect();
        let stated = |name| shard.column::<MotionRow, String>(name);
        let optional = |name| -> Result<Vec<String>, datasets_spec::Error> {
            let labels = shard.column::<MotionRow, Option<String>>(name)?;
            Ok(labels.into_iter().map(Option::unwrap_or_default).collect())
        };
        count(&mut splits, stated("split")?, &clips);
        count(&mut sources, stated("source")?, &clips);
        count(&mut actions, optional("action")?, &clips);
        count(&mut styles, optional("style")?, &clips);
    }
    Ok(Catalogue {
        splits: groups(splits),
        sources: groups(sources),
        actions: groups(actions),
        styles: groups(styles),
    })
}

/// Clips and frames by label and frame rate (as bits, which order like positive rates). Frames are
/// summed as integers, so that minutes do not depend on the order of the clips.
type Counts = BTreeMap<String, BTreeMap<u32, (u64, i64)>>;

fn count(counts: &mut Counts, labels: Vec<String>, clips: &[(i32, f32)]) {
    for (label, &(frames, fps)) in labels.into_iter().zip(clips) {
        let of_rate = counts.entry(label).or_default();
        let sum = of_rate.entry(fps.to_bits()).or_default();
        sum.0 += 1;
        sum.1 += i64::from(frames);
    }
}

fn groups(counts: Counts) -> Vec<Group> {
    let minutes = |(fps, (_, frames)): (&u32, &(u64, i64))| {
        *frames as f64 / (60.0 * f64::from(f32::from_bits(*fps)))
    };
    counts
        .into_iter()
        .map(|(label, rates)| Group {
            label,
            clips: rates.values().map(|(clips, _)| clips).sum(),
            minutes: rates.iter().map(minutes).sum(),
        })
        .collect()
}

/// What a folder without motions holds, and which verbs take it; none if it holds motions.
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
