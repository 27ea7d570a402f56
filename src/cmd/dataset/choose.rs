//! `stance dataset select` and `remove`

use std::path::PathBuf;

use datasets_spec::Dataset;
use pipeline::versions::{Choice, Removed, Selected, begin, removable, remove, select};
use tables::Condition;

use super::versions::lost_labels;
use crate::exit::Exit;
use crate::global::Global;
use crate::report::listing;

/// Write the clips that meet a condition to a new dataset.
///
/// They keep their ids and splits, and their masks, pairs, markers and features are copied too. Pairs with only one
/// selected clip are listed and left out. The new dataset records the other clips as skipped, so that a later ingest
/// does not add them. The original dataset does not change.
#[derive(clap::Args, Debug)]
pub(super) struct Select {
    /// Dataset folder
    dataset: PathBuf,
    /// Condition on the clips, such as "split = 'train' and not flags.poor_fit"
    #[arg(long = "where", value_name = "CONDITION")]
    condition: Condition,
    /// Folder of the new dataset
    #[arg(long)]
    out: PathBuf,
}

/// Make a version of a dataset without some clips.
///
/// The previous version keeps them until `stance dataset prune`, and `stance dataset restore` brings them back. A later
/// ingest leaves them out while their files are unchanged. Nothing is changed if masks or pairs that people made would
/// be lost, unless --drop-labels is given.
#[derive(clap::Args, Debug)]
pub(super) struct Remove {
    /// Dataset folder
    dataset: PathBuf,
    /// Remove the clips that meet a condition, such as "flags.poor_fit"
    #[arg(
        long = "where",
        value_name = "CONDITION",
        required_unless_present = "ids"
    )]
    condition: Option<Condition>,
    /// Remove the clips whose ids a file lists, one per line
    #[arg(long, value_name = "FILE", conflicts_with = "condition")]
    ids: Option<PathBuf>,
    /// Continue even if labels made by people are lost
    #[arg(long)]
    drop_labels: bool,
    /// Only print what would be removed
    #[arg(long)]
    dry_run: bool,
}

impl Select {
    pub(super) fn run(&self, global: &Global) -> anyhow::Result<Exit> {
        Dataset::open_unverified(&self.dataset)?;
        let (holder, bars) = (global.holder(), global.bars());
        let done = select(&self.dataset, &self.condition, &self.out, &holder, &bars)?;
        global.say(&done, &selected(&done))
    }
}

fn selected(done: &Selected) -> String {
    let mut text = format!("{} clips selected, {} left\n", done.clips, done.left);
    if done.left_captures > 0 {
        text += &format!(
            "  {} of those left are captures without a motion, for which no condition holds\n",
            done.left_captures
        );
    }
    for (count, what) in [(done.left_masks, "masks"), (done.left_pairs, "pairs")] {
        if count > 0 {
            text += &format!("{count} {what} belong to clips that are left\n");
        }
    }
    if !done.parted_pairs.is_empty() {
        let count = done.parted_pairs.len();
        text += &format!("{count} pairs have one clip that is selected and one that is not\n");
        text += &listing(&done.parted_pairs);
    }
    text += &left_tables(&done.left_tables);
    text + &format!("root hash {}\n", done.root_hash)
}

fn left_tables(tables: &[String]) -> String {
    match tables.is_empty() {
        true => String::new(),
        false => format!(
            "tables made of all clips are left; make them again: {}\n",
            tables.join(", ")
        ),
    }
}

impl Remove {
    pub(super) fn run(&self, global: &Global) -> anyhow::Result<Exit> {
        Dataset::open_unverified(&self.dataset)?;
        let choice = match (&self.condition, &self.ids) {
            (Some(condition), _) => Choice::Where(condition.clone()),
            (None, Some(file)) => Choice::ids(file)?,
            (None, None) => unreachable!("one of the two is required"),
        };
        let done = match self.dry_run {
            true => removable(&self.dataset, &choice)?,
            false => {
                let transaction = begin(&self.dataset, &global.holder())?;
                remove(transaction, &choice, self.drop_labels)?
            }
        };
        global.say(&done, &removed(&done))
    }
}

fn removed(done: &Removed) -> String {
    let verb = if done.dry_run { "to remove" } else { "removed" };
    let mut text = format!("{} clips {verb}, {} stay\n", done.removed.len(), done.clips);
    text += &listing(&done.removed);
    text += &lost_labels(&done.lost);
    for (table, count) in &done.dropped {
        text += &format!("{count} {table} of them that no person made go as well\n");
    }
    text += &left_tables(&done.left_tables);
    if done.dry_run {
        return text + "nothing was changed\n";
    }
    text + &format!("root hash {}\n", done.root_hash)
}
