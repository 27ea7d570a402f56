//! `stance items`

use std::collections::BTreeSet;
use std::path::PathBuf;

use anyhow::Context;
use datasets_spec::Split;
use datasets_spec::record::ItemRow;
use pipeline::compose::{ItemConfig, ItemCount, ItemTask};

use crate::chain;
use crate::cli::Global;
use crate::cmd::triplets::ComposeArgs;
use crate::exit::Exit;
use crate::report;

/// Draw the test questions that systems answer: a motion, an instruction, and the motion it should
/// become.
///
/// They are drawn once, with a seed and composer settings of their own. `stance edit RUN --items
/// ITEMS` answers them, and `stance eval` scores the answers. An item's id is a hash of its content.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Dataset folder with motions, and masks or pairs
    dataset: PathBuf,
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
    #[arg(long)]
    out: PathBuf,
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let config = ItemConfig {
        count: args.count,
        tasks: args.task.clone(),
        compose: args.compose.config()?,
    };
    let seed = global.seed();
    let drawn = chain::items(&args.dataset, &args.out, args.split, &config, seed, global)
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
            args.out.display()
        ));
    }
    Ok(Exit::Done)
}
