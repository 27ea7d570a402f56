//! `stance dataset versions`, `restore` and `compact`

use std::path::PathBuf;

use pipeline::ingest::LostLabel;
use pipeline::versions::{self, Compacted, Restored, Version};

use crate::exit::Exit;
use crate::global::Global;
use crate::report::listing;

/// List the versions of a dataset that were not pruned, with what each changed.
#[derive(clap::Args, Debug)]
pub(super) struct Versions {
    /// Dataset folder
    dataset: PathBuf,
}

/// Go back to an older version of a dataset.
///
/// The result is a new version with the clips, skeleton and settings of the old one; no version is removed. Masks and
/// pairs that people made since then are kept and listed if the old version has their clips with the same motion. If it
/// does not, nothing is changed unless --drop-labels is given; the current version keeps such labels.
#[derive(clap::Args, Debug)]
pub(super) struct Restore {
    /// Dataset folder
    dataset: PathBuf,
    /// Number of the version; `stance dataset versions` lists them
    #[arg(long, value_name = "VERSION")]
    to: u64,
    /// Continue even if labels are lost because the old version lacks their clips, or has them with another motion
    #[arg(long)]
    drop_labels: bool,
}

/// Rewrite a dataset into as few files as a new dataset has.
///
/// Every extension of a dataset adds files. Rows, their order, labels and records of later stages stay the same, so
/// nothing has to be composed or trained again. The previous version keeps its files until `stance dataset prune`.
#[derive(clap::Args, Debug)]
pub(super) struct Compact {
    /// Dataset folder
    dataset: PathBuf,
}

impl Versions {
    pub(super) fn run(&self, global: &Global) -> anyhow::Result<Exit> {
        let versions = versions::list(&self.dataset)?;
        global.say(&versions, &versions.iter().map(line).collect::<String>())
    }
}

/// Number and size of the files of a version.
fn size(files: u64, bytes: u64) -> String {
    format!("{files} files, {:.1} MB", bytes as f64 / 1e6)
}

fn line(version: &Version) -> String {
    let mark = if version.current { "*" } else { " " };
    let (number, clips) = (version.version, version.clips);
    let size = size(version.files, version.bytes);
    let (tool, root_hash) = (&version.tool_version, &version.root_hash);
    let mut text =
        format!("{mark} {number:<4} {clips} clips, {size}, {tool}, root hash {root_hash}\n");
    let changes: Vec<String> = version
        .changed
        .iter()
        .map(|(table, [then, now])| match then == now {
            true => format!("{table} {now}"),
            false => format!("{table} {then} to {now}"),
        })
        .collect();
    if !changes.is_empty() {
        text += &format!("       rows: {}\n", changes.join(", "));
    }
    text
}

impl Restore {
    pub(super) fn run(&self, global: &Global) -> anyhow::Result<Exit> {
        let transaction = versions::begin(&self.dataset, &global.holder())?;
        let done = versions::restore(transaction, self.to, self.drop_labels)?;
        global.say(&done, &restored(&done))
    }
}

fn restored(done: &Restored) -> String {
    let rejected = match done.rejected.len() {
        0 => String::new(),
        count => {
            let said = format!("{count} pairs and masks that people rejected since are left out\n");
            said + &listing(&done.rejected)
        }
    };
    if done.is_current {
        let (version, restored) = (done.version, done.restored);
        return format!(
            "version {version} holds what version {restored} holds; nothing to do\n{rejected}"
        );
    }
    let mut text = format!(
        "version {} has the content of version {}: {} clips\n",
        done.version, done.restored, done.clips
    );
    if !done.kept.is_empty() {
        text += &format!("{} labels that people made since stay\n", done.kept.len());
        let ids: Vec<String> = done
            .kept
            .iter()
            .map(|kept| format!("{} of {}", kept.id, kept.table))
            .collect();
        text += &listing(&ids);
    }
    if done.gave_way > 0 {
        text += &format!(
            "{} automatic masks left: people have described their clips since, without them\n",
            done.gave_way
        );
    }
    text += &lost_labels(&done.lost);
    text += &rejected;
    if !done.left_tables.is_empty() {
        text += &format!(
            "tables of the version before that this one has not: {}\n",
            done.left_tables.join(", ")
        );
    }
    text + &format!("root hash {}\n", done.root_hash)
}

impl Compact {
    pub(super) fn run(&self, global: &Global) -> anyhow::Result<Exit> {
        let transaction = versions::begin(&self.dataset, &global.holder())?;
        let done = versions::compact(transaction, &global.bars())?;
        global.say(&done, &compacted(&done))
    }
}

fn compacted(done: &Compacted) -> String {
    let [before, after] =
        [&done.before, &done.after].map(|version| size(version.files, version.bytes));
    if done.already_compact {
        return format!("{before}; fewer are not possible\n");
    }
    let mut text = format!("version {}: {after}; before {before}\n", done.version);
    for (table, now) in &done.after.tables {
        let then = done.before.tables.get(table).copied().unwrap_or(0);
        if then != *now {
            text += &format!("  {table} {then} to {now}\n");
        }
    }
    text + &format!("root hash {}\n", done.root_hash)
}

/// Text that lists lost labels with the reason for each.
pub(super) fn lost_labels(lost: &[LostLabel]) -> String {
    if lost.is_empty() {
        return String::new();
    }
    let lines: Vec<String> = lost
        .iter()
        .map(|label| format!("{} of {}: {}", label.id, label.table, label.reason))
        .collect();
    let said = "labels that people made are left behind; the version before keeps them";
    format!("{} {said}\n", lost.len()) + &listing(&lines)
}
