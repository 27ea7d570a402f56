//! `stance query`

use std::path::PathBuf;

use anyhow::bail;
use datasets_spec::Dataset;
use eval::format::csv::line;
use pipeline::ingest::SourceArg;
use serde_json::{Map, Value};
use tables::{Answer, Tables};

use crate::cmd::ingest::parse_source;
use crate::exit::Exit;
use crate::global::Global;
use crate::{local, report};

/// Ask the tables of datasets in SQL.
///
/// The tables of a dataset have their own names: motions, masks, pairs, markers, humanml3d, triplets, windows,
/// quarantine, skipped; those of a folder of items or edits: items, edits, scores. With several named datasets, they
/// are NAME.TABLE. Only the columns that a query names are read, also from URLs. A query can read nothing but these
/// tables, and change nothing.
///
/// Motions have further columns: seconds, max_speed, foot_skate, flags.NAME for the findings of the quality checks,
/// texts and part_texts (those of captions), n_captions, has_mask and has_pair.
///
///   stance query DATASET "SELECT split, count(*), sum(seconds)/3600 AS hours FROM motions GROUP BY split"
///   stance query DATASET "SELECT id FROM motions WHERE flags.poor_fit AND NOT has_mask"
///   stance query a=OLD b=NEW "SELECT id FROM a.motions WHERE id NOT IN (SELECT id FROM b.motions)"
#[derive(clap::Args, Debug)]
#[command(verbatim_doc_comment)]
pub(crate) struct Args {
    /// Dataset folders or URLs; several need names, NAME=PATH
    #[arg(required = true, value_name = "[NAME=]DATASET", value_parser = parse_source())]
    datasets: Vec<SourceArg>,
    /// The query: one SELECT
    #[arg(value_name = "SQL")]
    query: String,
    /// Print comma-separated values; lists and structs are JSON
    #[arg(long, conflicts_with = "out")]
    pub(crate) csv: bool,
    /// Write the rows to this Parquet file, which must not exist
    #[arg(long, value_name = "FILE.parquet", value_parser = local::path())]
    out: Option<PathBuf>,
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    if let Some(out) = &args.out {
        local::check_new(out)?;
    }
    let mut tables = match args.datasets.as_slice() {
        [one] => Tables::of(&Dataset::open_unverified(&one.path)?)?,
        several => {
            let mut datasets: Vec<(String, Dataset)> = Vec::new();
            for source in several {
                let Some(name) = &source.name else {
                    bail!("each of several datasets needs a name, as in a={source}");
                };
                if datasets.iter().any(|(known, _)| known == name) {
                    bail!(
                        "two datasets are named {name}; their tables are NAME.TABLE, so give them two names"
                    );
                }
                datasets.push((name.clone(), Dataset::open_unverified(&source.path)?));
            }
            Tables::of_several(&datasets)?
        }
    };
    let answer = tables.ask(&args.query)?;
    match &args.out {
        Some(out) => {
            local::write(out, &answer.parquet()?)?;
            let rows = answer.len();
            let document = serde_json::json!({ "rows": rows, "out": out });
            global.say(&document, &format!("{rows} rows in {}", out.display()))?;
        }
        None if args.csv => report::text(&csv(&answer)),
        None if global.json => report::json(&answer.rows::<Map<String, Value>>()?)?,
        None => report::text(&table(&answer)),
    }
    Ok(Exit::Done)
}

/// A value as the text of a table cell.
fn cell(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}

fn csv(answer: &Answer) -> String {
    let mut text = line(&answer.columns());
    for row in 0..answer.len() {
        text += &line(&answer.row(row).iter().map(cell).collect::<Vec<_>>());
    }
    text
}

/// Maximum length of a printed cell in characters. Longer cells are cut and end with …; `--json` and `--csv` print them
/// whole.
const LONGEST_CELL: usize = 80;

fn table(answer: &Answer) -> String {
    let shown = |value: &Value| {
        let text = cell(value).replace('\n', " ");
        match text.char_indices().nth(LONGEST_CELL) {
            Some((end, _)) => format!("{}…", &text[..end]),
            None => text,
        }
    };
    let rows = (0..answer.len()).map(|row| answer.row(row).iter().map(shown).collect());
    let rows: Vec<Vec<String>> = std::iter::once(answer.columns()).chain(rows).collect();
    report::columns(&rows, |column| answer.is_number(column))
}
