//! `stance items`

use std::collections::BTreeSet;
use std::path::PathBuf;

use anyhow::Context;
use datasets_spec::record::ItemRow;
use datasets_spec::{Dataset, Split};
use pipeline::compose::{ItemConfig, ItemCount, ItemTask};
use pipeline::export::export_items;

use crate::cmd::triplets::ComposeArgs;
use crate::exit::Exit;
use crate::global::Global;
use crate::{report, stages};

/// Draw the test questions that systems answer: a motion, an instruction, and the motion it should
/// become.
///
/// They are drawn once, with a seed and composer settings of their own. `stance edit RUN --items
/// ITEMS` answers them, and `stance eval` scores the answers. An item's id is a hash of its content.
///
/// `stance items export` writes drawn items for systems outside this program.
#[derive(clap::Args, Debug)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub(crate) struct Args {
    #[command(subcommand)]
    action: Option<Action>,
    /// Dataset folder with motions, and masks or pairs
    #[arg(required = true)]
    dataset: Option<PathBuf>,
    /// Split to draw from
    #[arg(long, default_value = "test")]
    split: Split,
    /// How many, or `all`: one of every mask and pair
    #[arg(long, value_name = "N|all", default_value_t = ItemConfig::default().count)]
    count: ItemCount,
    /// Tasks to draw, of semantic, style, fine-grained and motionfix [default: all there is data for]
    #[arg(long, value_name = "TASK", value_delimiter = ',')]
    task: Vec<ItemTask>,
    #[command(flatten)]
    compose: ComposeArgs,
    /// Folder to write
    #[arg(long, required = true)]
    out: Option<PathBuf>,
}

#[derive(clap::Subcommand, Debug)]
enum Action {
    Export(ExportArgs),
}

/// Write items for systems outside this program: an npz for each source, and items.json with the
/// questions.
///
/// An npz has the arrays of AMASS's SMPL-X releases (z up) and `keypoints` [T, 28, 3] in the same frame.
/// Equal items give equal bytes. `stance edits import` takes the answers.
#[derive(clap::Args, Debug)]
struct ExportArgs {
    /// Folder of items
    items: PathBuf,
    /// Format of the motions
    #[arg(long, value_enum, default_value_t)]
    format: FormatArg,
    /// Also write the targets, to a folder of their own
    #[arg(long)]
    targets: bool,
    /// New folder to write
    #[arg(long, value_parser = crate::local::path())]
    out: PathBuf,
}

#[derive(Clone, Copy, Debug, Default, clap::ValueEnum)]
enum FormatArg {
    /// Archives of NumPy arrays
    #[default]
    Npz,
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    if let Some(Action::Export(args)) = &args.action {
        return export(args, global);
    }
    let (Some(dataset), Some(out)) = (&args.dataset, &args.out) else {
        anyhow::bail!("name the dataset and where to write: stance items DATASET --out ITEMS");
    };
    let config = ItemConfig {
        count: args.count,
        tasks: args.task.clone(),
        compose: args.compose.config()?,
    };
    let seed = global.seed();
    let drawn = stages::items(dataset, out, args.split, &config, seed, global)
        .context("cannot draw items")?;
    let rows: Vec<ItemRow> = drawn.read(None)?;
    let distinct = |of: fn(&ItemRow) -> &str| rows.iter().map(of).collect::<BTreeSet<_>>().len();
    let targets = distinct(|row| row.target_id.as_str());
    let sources = distinct(|row| row.source_id.as_str());
    let instructions = distinct(|row| &row.instruction);
    if global.json {
        report::json(&serde_json::json!({
            "items": rows.len(),
            "targets": targets,
            "sources": sources,
            "instructions": instructions,
            "root_hash": drawn.manifest().root_hash,
        }))?;
    } else {
        report::text(&format!(
            "{} items ({targets} targets, {sources} sources, {instructions} instructions) in {}",
            rows.len(),
            out.display()
        ));
    }
    Ok(Exit::Done)
}

fn export(args: &ExportArgs, global: &Global) -> anyhow::Result<Exit> {
    let FormatArg::Npz = args.format;
    let folder = Dataset::open(&args.items)?;
    let items = folder.items()?;
    let skeleton = folder.skeleton()?;
    let bars = global.bars();
    let motions = export_items(&items, &skeleton, &args.out, args.targets, &bars)?;
    if global.json {
        report::json(&serde_json::json!({
            "out": args.out,
            "items": items.len(),
            "motions": motions,
        }))?;
    } else {
        report::text(&format!(
            "{} items ({motions} motions) in {}",
            items.len(),
            args.out.display()
        ));
    }
    Ok(Exit::Done)
}
