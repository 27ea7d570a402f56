//! The card of a dataset, for people and for the Hugging Face `datasets` library, which reads its YAML header.

use std::collections::BTreeMap;

use crate::Split;
use crate::manifest::Manifest;

/// Name of the file.
pub(crate) const FILE: &str = "README.md";

/// The library's split name for tables without splits. It reserves `all`.
const WITHOUT_SPLIT: &str = "rows";

/// The card of a dataset. It follows from the manifest alone.
pub(crate) fn text(manifest: &Manifest) -> String {
    let mut text = String::from("---\npretty_name: Motion dataset\ntags:\n- motion\n- smpl-x\n");
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
    text += &sources(manifest);
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
