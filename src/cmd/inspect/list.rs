//! Lists of a dataset: its clips, the files that were rejected, and the files without a motion.

use clip::check::flag_names;
use datasets_spec::Dataset;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Deserializer, Serialize};
use tables::Tables;

use crate::exit::Exit;
use crate::global::Global;
use crate::report::columns;

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

#[derive(Deserialize, Serialize)]
struct ListedClip {
    id: String,
    split: String,
    path: String,
    #[serde(deserialize_with = "names_of_flags")]
    flags: Vec<&'static str>,
}

#[derive(Deserialize, Serialize)]
struct ListedRejection {
    path: String,
    code: String,
    reason: String,
    byte_offset: Option<u64>,
}

#[derive(Deserialize, Serialize)]
struct ListedSkip {
    path: String,
    reason: String,
}

impl List {
    pub(super) fn show(self, dataset: &Dataset, global: &Global) -> anyhow::Result<Exit> {
        match self {
            Self::Clips => {
                let columns = "id, split, source_path AS path, quality.flags AS flags";
                let clips: Vec<ListedClip> =
                    rows(dataset, &format!("SELECT {columns} FROM motions"))?;
                print(&clips, global, |clip| {
                    vec![
                        clip.id.clone(),
                        clip.split.clone(),
                        clip.path.clone(),
                        clip.flags.join(","),
                    ]
                })
            }
            Self::Quarantine => {
                let columns = "path, code, reason, byte_offset";
                let rejections: Vec<ListedRejection> =
                    rows(dataset, &format!("SELECT {columns} FROM quarantine"))?;
                print(&rejections, global, |row| {
                    let place = row
                        .byte_offset
                        .map_or(String::new(), |at| format!("byte {at}"));
                    vec![
                        row.path.clone(),
                        row.code.clone(),
                        place,
                        row.reason.clone(),
                    ]
                })
            }
            Self::Skipped => {
                let skips: Vec<ListedSkip> = rows(dataset, "SELECT path, reason FROM skipped")?;
                print(&skips, global, |row| {
                    vec![row.path.clone(), row.reason.clone()]
                })
            }
        }
    }
}

/// The rows of a query, deserialized into a type.
fn rows<T: DeserializeOwned>(dataset: &Dataset, query: &str) -> anyhow::Result<Vec<T>> {
    Ok(Tables::of(dataset)?.ask(query)?.rows()?)
}

/// The names of flags from their bits.
fn names_of_flags<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<&'static str>, D::Error> {
    u32::deserialize(from).map(flag_names)
}

/// Prints rows as columns of text, or as a JSON array.
fn print<T: Serialize>(
    rows: &[T],
    global: &Global,
    cells: impl Fn(&T) -> Vec<String>,
) -> anyhow::Result<Exit> {
    let lines: Vec<Vec<String>> = rows.iter().map(cells).collect();
    global.say(&rows, &columns(&lines, |_| false))
}
