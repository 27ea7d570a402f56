//! Lists of a dataset: its clips, the files that were rejected, and the files without a motion.

use clip::check::flag_names;
use datasets_spec::Dataset;
use serde_json::{Map, Value};
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

impl List {
    pub(super) fn show(self, dataset: &Dataset, global: &Global) -> anyhow::Result<Exit> {
        let query = match self {
            Self::Clips => {
                "SELECT id, split, source_path AS path, quality.flags AS flags FROM motions"
            }
            Self::Quarantine => "SELECT path, code, byte_offset, reason FROM quarantine",
            Self::Skipped => "SELECT path, reason FROM skipped",
        };
        let answer = Tables::of(dataset)?.ask(query)?;
        let mut rows: Vec<Map<String, Value>> = answer.rows()?;
        for bits in rows.iter_mut().filter_map(|row| row.get_mut("flags")) {
            let set = bits.as_u64().and_then(|bits| u32::try_from(bits).ok());
            *bits = flag_names(set.unwrap_or_default()).into();
        }
        let names = answer.columns();
        let lines = rows
            .iter()
            .map(|row| names.iter().map(|name| cell(&row[name])).collect());
        global.say(&rows, &columns(&lines.collect::<Vec<_>>(), |_| false))
    }
}

/// A text, the names of flags, or a byte offset.
fn cell(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Array(flags) => {
            let flags: Vec<&str> = flags.iter().filter_map(Value::as_str).collect();
            flags.join(",")
        }
        Value::Number(at) => format!("byte {at}"),
        _ => String::new(),
    }
}
