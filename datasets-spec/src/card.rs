//! The card of a dataset, for people and for the Hugging Face `datasets` library, which reads its YAML header.

use std::collections::BTreeMap;

use crate::Split;
use crate::license::{hub_names, is_non_commercial, licenses, warning};
use crate::manifest::{Manifest, SPLIT_BY_FACT};

pub(crate) const FILE: &str = "README.md";

/// Split name for tables without splits. The `datasets` library reserves `all`.
const WITHOUT_SPLIT: &str = "rows";

/// The text of a dataset's card, made from its manifest only.
pub(crate) fn text(manifest: &Manifest) -> String {
    let mut text = String::from("---\npretty_name: Motion dataset\ntags:\n- motion\n- smpl-x\n");
    let licenses = hub_names(&licenses(manifest));
    if !licenses.is_empty() {
        text += "license:\n";
    }
    for name in licenses {
        text += &format!("- {name}\n");
    }
    text += "configs:\n";
    let main = main_table(manifest);
    for (table, files) in &manifest.tables {
        let mut splits: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
        for file in files.iter().filter(|file| file.rows > 0) {
            let split = file.split.map_or(WITHOUT_SPLIT, Split::as_str);
            splits.entry(split).or_default().push(&file.path);
        }
        if splits.is_empty() {
            continue;
        }
        text += &format!("- config_name: {table}\n");
        if table == main {
            text += "  default: true\n";
        }
        text += "  data_files:\n";
        for (split, paths) in splits {
            text += &format!("  - split: {split}\n    path:\n");
            for path in paths {
                text += &format!("    - {path}\n");
            }
        }
    }
    text += "---\n\n# Motion dataset\n\n";
    text += &format!(
        "Written by {}; format `{}` version {}; skeleton `{}`; y up, metres, radians.\n\n",
        manifest.tool_version, manifest.format, manifest.schema_version, manifest.skeleton
    );
    text += &tables(manifest);
    if let Some(by) = manifest.facts.get(SPLIT_BY_FACT) {
        text += &format!("\nSplits that no list states were drawn by {by} as clips were added.");
        let columns = match by.as_str() {
            "subject" => "source_name, subject",
            "action" => "action",
            _ => "",
        };
        // Clips keep their splits, so the labels that they have now may say otherwise.
        if !columns.is_empty() {
            text += &format!(
                " Lists, labels corrected later, and merged datasets may put one {by} into several splits; this lists them:\n\n\
                 ```sh\nstance query DATASET \"SELECT {columns} FROM motions WHERE {by} IS NOT NULL GROUP BY {columns} \
                 HAVING count(DISTINCT split) > 1 ORDER BY {columns}\"\n```"
            );
        }
        text += "\n";
    }
    text += &sources(manifest);
    text += &license_table(manifest);
    text += &loading(manifest, main);
    text += &format!("\nRoot hash: `{}`\n", manifest.root_hash);
    text
}

/// The default table for readers: the motions, otherwise the edits, otherwise the first table with rows.
fn main_table(manifest: &Manifest) -> &str {
    let has_rows = |table: &&str| manifest.rows(table, None) > 0;
    let mut tables = manifest.tables.keys().map(String::as_str);
    ["motions", "edits"]
        .into_iter()
        .find(has_rows)
        .or_else(|| tables.find(has_rows))
        .unwrap_or("motions")
}

fn loading(manifest: &Manifest, main: &str) -> String {
    let files = manifest.tables.get(main).into_iter().flatten();
    let split = files
        .filter(|file| file.rows > 0)
        .map(|file| file.split.map_or(WITHOUT_SPLIT, Split::as_str))
        .find(|split| main != "motions" || *split == Split::Train.as_str())
        .unwrap_or(Split::Train.as_str());
    let example = match main {
        "motions" => "\nmotions[0][\"body_pose\"]  # (frames, 63), axis-angle in radians",
        _ => "",
    };
    format!(
        "\n## Loading\n\n```python\nfrom datasets import load_dataset\n\n\
         {main} = load_dataset(\"PATH\", \"{main}\", split=\"{split}\").with_format(\"numpy\"){example}\n```\n"
    )
}

fn tables(manifest: &Manifest) -> String {
    let mut text =
        String::from("| table | train | val | test | rows |\n|---|---:|---:|---:|---:|\n");
    for table in manifest.tables.keys() {
        let [train, val, test] = Split::ALL.map(|split| manifest.rows(table, Some(split)));
        let rows = manifest.rows(table, None);
        text += &format!("| {table} | {train} | {val} | {test} | {rows} |\n");
    }
    text
}

fn license_table(manifest: &Manifest) -> String {
    let licenses = licenses(manifest);
    if licenses.is_empty() {
        return String::new();
    }
    let mut text =
        String::from("\n## Licences\n\n| licence | clips | commercial use |\n|---|---:|---|\n");
    for (tag, clips) in &licenses {
        let (name, use_of) = match (tag.as_str(), is_non_commercial(tag)) {
            ("", _) => ("not stated", "ask the source"),
            (tag, true) => (tag, "no"),
            (tag, false) => (tag, "see the licence"),
        };
        text += &format!("| {name} | {clips} | {use_of} |\n");
    }
    if let Some(warning) = warning(&licenses) {
        text += &format!("\nNote: {warning}.\n");
    }
    text
}

/// Counts of ingested, quarantined and skipped sources: they explain why copies of a dataset differ in size.
fn sources(manifest: &Manifest) -> String {
    let accounting = &manifest.accounting;
    let mut text = format!(
        "\n## Sources\n\n{} sources = {} ingested + {} quarantined + {} skipped.\n",
        accounting.sources, accounting.ingested, accounting.quarantined, accounting.skipped
    );
    if !accounting.codes.is_empty() {
        text += "\n| code | quarantined |\n|---|---:|\n";
        for (code, count) in &accounting.codes {
            text += &format!("| {code} | {count} |\n");
        }
    }
    text
}
