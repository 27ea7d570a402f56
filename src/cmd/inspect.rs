//! `stance inspect`

use std::collections::BTreeMap;
use std::path::PathBuf;

use datasets_spec::Dataset;
use datasets_spec::manifest::Accounting;
use pipeline::catalogue::{Catalogue, Group, catalogue};
use serde::Serialize;

use crate::cli::Global;
use crate::exit::Exit;
use crate::report;

/// Say what a dataset holds, after checking every file against its hash.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Dataset folder
    dataset: PathBuf,
}

/// The `--json` document.
#[derive(Serialize)]
struct Document<'a> {
    root_hash: &'a str,
    schema_version: &'a str,
    version: u64,
    skeleton: &'a str,
    tables: BTreeMap<&'a str, u64>,
    accounting: &'a Accounting,
    facts: &'a BTreeMap<String, String>,
    catalogue: Catalogue,
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let dataset = Dataset::open(&args.dataset)?;
    let manifest = dataset.manifest();
    let document = Document {
        root_hash: &manifest.root_hash,
        schema_version: &manifest.schema_version,
        version: manifest.version,
        skeleton: &manifest.skeleton,
        tables: manifest
            .tables
            .keys()
            .map(|table| (table.as_str(), manifest.rows(table, None)))
            .collect(),
        accounting: &manifest.accounting,
        facts: &manifest.facts,
        catalogue: catalogue(&dataset)?,
    };
    if global.json {
        report::json(&document)?;
    } else {
        report::text(&text(&document));
    }
    Ok(Exit::Done)
}

fn text(document: &Document) -> String {
    let mut text = format!(
        "format {} manifest {} skeleton {}\nroot hash {} (every file verified)\n\n",
        document.schema_version, document.version, document.skeleton, document.root_hash
    );
    for (table, rows) in &document.tables {
        text += &format!("{table:<12} {rows:>8} rows\n");
    }
    let groups = [
        ("split", &document.catalogue.splits),
        ("source", &document.catalogue.sources),
        ("action", &document.catalogue.actions),
        ("style", &document.catalogue.styles),
    ];
    for (title, groups) in groups {
        if groups.is_empty() {
            continue;
        }
        text += &format!("\n{title:<24} {:>7} {:>9}\n", "clips", "minutes");
        for Group {
            label,
            clips,
            minutes,
        } in groups
        {
            let label = if label.is_empty() { "(none)" } else { label };
            text += &format!("{label:<24} {clips:>7} {minutes:>9.2}\n");
        }
    }
    text
}
