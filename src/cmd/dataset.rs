//! `stance dataset`

mod choose;
mod versions;

use std::num::NonZeroUsize;
use std::path::PathBuf;

use anyhow::Context;
use clap::Subcommand;
use datasets_spec::Transaction;
use pipeline::merge::{Merged, merge};
use serde_json::json;

use crate::exit::Exit;
use crate::global::Global;
use crate::report::Joined;

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
}

/// Remove old versions of a dataset, and the files that no other version uses.
///
/// Every change of a dataset leaves the previous version in place. Nothing else removes versions.
#[derive(clap::Args, Debug)]
struct Prune {
    /// Dataset folder
    dataset: PathBuf,
    /// Number of newest versions to keep
    #[arg(long, default_value = "1")]
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
    let done = merge(
        &args.first,
        &args.second,
        &args.out,
        &global.holder(),
        &global.bars(),
    )
    .with_context(|| {
        format!(
            "cannot merge {} and {}",
            args.first.display(),
            args.second.display()
        )
    })?;
    global.say(&done, &summary(&done))
}

fn summary(done: &Merged) -> String {
    let mut text = format!(
        "{} clips; of the second dataset {} are in both, {} have a new id, {} a new split\n",
        done.clips,
        done.shared.len(),
        done.renamed.len(),
        done.moved.len()
    );
    for (from, to) in &done.renamed {
        text += &format!("  {from} is {to}\n");
    }
    for (id, split) in &done.moved {
        text += &format!("  {id} is in {split}\n");
    }
    for id in &done.dropped_labels {
        text += &format!("  pair {id} was dropped: its motions are in two splits now\n");
    }
    if let Some(warning) = &done.license_warning {
        text += &format!("note: {warning}\n");
    }
    text + &format!("root hash {}\n", done.root_hash)
}

fn pruned(args: &Prune, global: &Global) -> anyhow::Result<Exit> {
    // Check that the folder is a dataset: locking would create a missing folder.
    datasets_spec::Dataset::open_unverified(&args.dataset)?;
    let transaction = Transaction::begin(&args.dataset, &global.holder())?;
    let done = transaction.prune(args.keep.get(), args.dry_run)?;
    let removed = if args.dry_run { "to remove" } else { "removed" };
    let text = format!(
        "{} versions and {} files {removed}, {:.1} MB\n",
        done.versions.len(),
        done.files,
        done.bytes as f64 / 1e6
    );
    let document = Joined {
        own: json!({ "dry_run": args.dry_run }),
        all_of: &done,
    };
    global.say(&document, &text)
}
