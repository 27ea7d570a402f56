//! Lists of a dataset: its clips, the files that were rejected, and the files without a motion.

use datasets_spec::record::{MotionRow, QuarantineRow, SkippedRow};
use datasets_spec::table::{Quality, ShardReader};
use datasets_spec::{Dataset, table::Row};
use pipeline::check::flag_names;
use serde::Serialize;

use crate::exit::Exit;
use crate::global::Global;
use crate::report;

/// The rows to list.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub(crate) enum List {
    /// Id, split, source file and flags of every clip
    Clips,
    /// Path, code, reason and byte offset of every file that was rejected
    Quarantine,
    /// Path and reason of every file without a motion
    Skipped,
}

#[derive(Serialize)]
struct ListedClip {
    id: String,
    split: String,
    path: String,
    flags: Vec<&'static str>,
}

#[derive(Serialize)]
struct ListedRejection {
    path: String,
    code: String,
    reason: String,
    byte_offset: Option<u64>,
}

#[derive(Serialize)]
struct ListedSkip {
    path: String,
    reason: String,
}

impl List {
    pub(super) fn show(self, dataset: &Dataset, global: &Global) -> anyhow::Result<Exit> {
        match self {
            Self::Clips => print(&clips(dataset)?, global, |clip| {
                vec![
                    clip.id.clone(),
                    clip.split.clone(),
                    clip.path.clone(),
                    clip.flags.join(","),
                ]
            }),
            Self::Quarantine => print(&rejections(dataset)?, global, |row| {
                let place = row
                    .byte_offset
                    .map_or(String::new(), |at| format!("byte {at}"));
                vec![
                    row.path.clone(),
                    row.code.clone(),
                    place,
                    row.reason.clone(),
                ]
            }),
            Self::Skipped => print(&skips(dataset)?, global, |row| {
                vec![row.path.clone(), row.reason.clone()]
            }),
        }
    }
}

/// Reads metadata columns only.
fn clips(dataset: &Dataset) -> anyhow::Result<Vec<ListedClip>> {
    let mut clips = Vec::new();
    for (path, _) in dataset.files(MotionRow::TABLE, None) {
        let shard = ShardReader::open(&path)?;
        let text = |column| shard.column::<MotionRow, String>(column);
        let (ids, splits, paths) = (text("id")?, text("split")?, text("source_path")?);
        let quality = shard.column::<MotionRow, Quality>("quality")?;
        let facts = splits.into_iter().zip(paths).zip(quality);
        clips.extend(
            ids.into_iter()
                .zip(facts)
                .map(|(id, ((split, path), quality))| ListedClip {
                    id,
                    split,
                    path,
                    flags: flag_names(quality.flags),
                }),
        );
    }
    Ok(clips)
}

fn rejections(dataset: &Dataset) -> anyhow::Result<Vec<ListedRejection>> {
    let rows: Vec<QuarantineRow> = dataset.read(None)?;
    let rows = rows.into_iter();
    Ok(rows
        .map(|row| ListedRejection {
            path: row.path,
            code: row.code,
            reason: row.reason,
            byte_offset: row.byte_offset,
        })
        .collect())
}

fn skips(dataset: &Dataset) -> anyhow::Result<Vec<ListedSkip>> {
    let rows: Vec<SkippedRow> = dataset.read(None)?;
    let rows = rows.into_iter();
    Ok(rows
        .map(|row| ListedSkip {
            path: row.path,
            reason: row.reason,
        })
        .collect())
}

/// Prints rows as columns of text, or as a JSON array.
fn print<T: Serialize>(
    rows: &[T],
    global: &Global,
    cells: impl Fn(&T) -> Vec<String>,
) -> anyhow::Result<Exit> {
    if global.json {
        report::json(&rows)?;
        return Ok(Exit::Done);
    }
    let rows: Vec<Vec<String>> = rows.iter().map(cells).collect();
    let num_columns = rows.first().map_or(0, Vec::len);
    let widths: Vec<usize> = (0..num_columns)
        .map(|column| rows.iter().map(|row| row[column].chars().count()).max())
        .map(Option::unwrap_or_default)
        .collect();
    let mut text = String::new();
    for row in &rows {
        let mut line = String::new();
        for (cell, width) in row.iter().zip(&widths) {
            line += &format!("{cell:<width$}  ");
        }
        text += line.trim_end();
        text.push('\n');
    }
    report::text(&text);
    Ok(Exit::Done)
}
