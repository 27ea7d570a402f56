//! `stance dataset`

mod choose;
mod versions;

use std::num::NonZeroUsize;
use std::path::PathBuf;

use anyhow::Context;
use clap::Subcommand;
use datasets_spec::Transaction;
use datasets_spec::dataset::prunable;
use pipeline::merge::{Differing, Merged, merge};
use serde_json::json;

use crate::exit::Exit;
use crate::global::Global;

/// Versions of a dataset, and datasets made of others.
///
/// Every change of a dataset creates a new version, and the previous one stays until it is pruned.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    Versions(versions::Versions),
    Restore(versions::Restore),
    Compact(versions::Compact),
    Prune(Prune),
    Merge(Merge),
    Select(choose::Select),
    Remove(choose::Remove),
}

/// Merge two datasets into a new one.
///
/// Clips of the first keep their ids, splits, masks and pairs. A clip that both have is taken once. A clip of the
/// second whose id belongs to another motion of the first gets the name of its dataset as a prefix. Clips of one
/// recording share a split: a clip of the second gets the split of the clips of the first that were read from the same
/// file, are its mirrored copies, or have nearly the same motion. Datasets of different skeletons, rates, resampling or
/// features cannot be merged.
#[derive(clap::Args, Debug)]
struct Merge {
    /// Dataset folder whose clips keep their ids and splits
    first: PathBuf,
    /// Dataset folder to add
    second: PathBuf,
    /// Folder of the new dataset
    #[arg(long)]
    out: PathBuf,
    /// Take captions, labels and licences of clips that both have from the first, and lose those of the second
    ///
    /// Without it, datasets that describe a common clip differently are not merged.
    #[arg(long)]
    take_first: bool,
}

/// Remove old versions of a dataset, and the files that no other version uses.
///
/// Every change of a dataset leaves the previous version in place. Nothing else removes versions.
#[derive(clap::Args, Debug)]
struct Prune {
    /// Dataset folder
    dataset: PathBuf,
    /// Number of newest versions to keep
    #[arg(long)]
    keep: NonZeroUsize,
    /// Only print what would be removed
    #[arg(long)]
    dry_run: bool,
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    match &args.what {
        What::Versions(args) => args.run(global),
        What::Restore(args) => args.run(global),
        What::Compact(args) => args.run(global),
        What::Prune(args) => pruned(args, global),
        What::Merge(args) => merged(args, global),
        What::Select(args) => args.run(global),
        What::Remove(args) => args.run(global),
    }
}

fn merged(args: &Merge, global: &Global) -> anyhow::Result<Exit> {
    let (holder, bars) = (global.holder(), global.bars());
    let differing = match args.take_first {
        true => Differing::TakeFirst,
        false => Differing::Refuse,
    };
    let [first, second] = [&args.first, &args.second];
    let done = merge(first, second, &args.out, differing, &holder, &bars)
        .with_context(|| format!("cannot merge {} and {}", first.display(), second.display()))?;
    global.say(&done, &summary(&done))
}

fn summary(done: &Merged) -> String {
    let (clips, shared) = (done.clips, done.shared.len());
    let (renamed, moved) = (done.renamed.len(), done.moved.len());
    let mut text = format!(
        "{clips} clips; of the second dataset {shared} are in both, {renamed} have a new id, {moved} a new split\n"
    );
    for (from, to) in &done.renamed {
        text += &format!("  {from} is {to}\n");
    }
    for (table, renamed) in &done.renamed_labels {
        for (from, to) in renamed {
            text += &format!("  {from} of {table} is {to}\n");
        }
    }
    for (id, split) in &done.moved {
        text += &format!("  {id} is in {split}\n");
    }
    for (column, clips) in &done.differing {
        text += &format!(
            "  {column} of {} clips of the second dataset were left out\n",
            clips.len()
        );
    }
    for id in &done.dropped_labels {
        text += &format!("  pair {id} was dropped: its motions are in two splits now\n");
    }
    if !done.left_tables.is_empty() {
        text += &format!(
            "  tables that stages made of all clips were left out: {}\n",
            done.left_tables.join(", ")
        );
    }
    if let Some(warning) = &done.license_warning {
        text += &format!("note: {warning}\n");
    }
    text + &format!("root hash {}\n", done.root_hash)
}

fn pruned(args: &Prune, global: &Global) -> anyhow::Result<Exit> {
    // Check that the folder is a dataset: locking would create a missing folder.
    let dataset = datasets_spec::Dataset::open_unverified(&args.dataset)?;
    let keep = args.keep.get();
    let done = match args.dry_run {
        true => prunable(dataset.store().as_ref(), dataset.root(), keep)?,
        false => Transaction::begin(&args.dataset, &global.holder())?.prune(keep)?,
    };
    let removed = match args.dry_run {
        true => "to remove; nothing was changed",
        false => "removed",
    };
    let (versions, files) = (done.versions.len(), done.files);
    let megabytes = done.bytes as f64 / 1e6;
    let numbers: Vec<String> = done.versions.iter().map(ToString::to_string).collect();
    let named = match versions {
        0 => String::new(),
        _ => format!(" ({})", numbers.join(", ")),
    };
    let text =
        format!("{versions} versions{named} and {files} files, {megabytes:.1} MB, {removed}\n");
    global.say_joined(json!({ "dry_run": args.dry_run }), &done, &text)
}
