//! The card of a dataset, for people and for the Hugging Face `datasets` library, which reads its YAML header.

use std::collections::{BTreeMap, BTreeSet};

use crate::Split;
use crate::license::{is_non_commercial, licenses, warning};
use crate::manifest::{Manifest, SPLIT_BY_FACT};

/// Name of the file.
pub(crate) const FILE: &str = "README.md";

/// The library's split name for tables without splits. It reserves `all`.
const WITHOUT_SPLIT: &str = "rows";

/// Families of SPDX identifiers that the hub knows.
const KNOWN_TO_HUB: [&str; 5] = ["CC-BY", "CC0-1.0", "MIT", "Apache-2.0", "BSD-"];

/// The card of a dataset. It follows from the manifest alone.
pub(crate) fn text(manifest: &Manifest) -> String {
    let mut text = String::from("---\npretty_name: Motion dataset\ntags:\n- motion\n- smpl-x\n");
    text += &license_header(manifest);
    text += "configs:\n";
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
        if table == "motions" {
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
        text += &format!(
            "\nSplits that no list states were drawn by {by}: all of one {by} is in one split.\n"
        );
    }
    text += &sources(manifest);
    text += &license_table(manifest);
    text += "\n## Loading\n\n```python\nfrom datasets import load_dataset\n\n\
             motions = load_dataset(\"PATH\", \"motions\", split=\"train\").with_format(\"numpy\")\n\
             motions[0][\"body_pose\"]  # (frames, 63), axis-angle in radians\n```\n";
    text += &format!("\nRoot hash: `{}`\n", manifest.root_hash);
    text
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

/// Licences by the names of the Hugging Face hub, which are SPDX identifiers in lower case.
fn license_header(manifest: &Manifest) -> String {
    let names: BTreeSet<String> = licenses(manifest)
        .keys()
        .flat_map(|tag| tag.split(" AND "))
        .map(|tag| match tag {
            "" => "unknown".to_owned(),
            tag if KNOWN_TO_HUB.iter().any(|family| tag.starts_with(family)) => tag.to_lowercase(),
            _ => "other".to_owned(),
        })
        .collect();
    match names.len() {
        0 => String::new(),
        _ => {
            let lines = names.iter().map(|name| format!("- {name}\n"));
            format!("license:\n{}", lines.collect::<String>())
        }
    }
}

/// Clips by licence, and what follows from a mixture of them.
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

/// Counts of the sources, which explain why numbers differ between copies.
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
