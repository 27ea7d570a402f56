//! `stance triplets`

use std::path::PathBuf;

use anyhow::Context;
use datasets_spec::Dataset;
use datasets_spec::record::TripletRow;
use datasets_spec::table::Row;
use pipeline::compose::ComposeConfig;
use serde::Serialize;

use crate::chain;
use crate::cli::Global;
use crate::exit::Exit;
use crate::report;

/// Record the composer's training stream, or rebuild one of its triplets.
///
/// A triplet is an original motion, an instruction, and the edited motion MotionCutMix makes of
/// them. Training composes them on the fly; what is recorded here is the same stream.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Dataset folder with motions and masks
    dataset: PathBuf,
    /// Folder to record to
    #[arg(long, required_unless_present = "explain")]
    out: Option<PathBuf>,
    /// Triplets to record
    #[arg(long, default_value_t = 64)]
    count: u64,
    /// Rebuild the triplet with this id and say what it is made of
    #[arg(long, value_name = "ID", conflicts_with = "out")]
    explain: Option<String>,
}

/// The `--json` document of `--explain`.
#[derive(Serialize)]
struct Explained {
    id: String,
    instruction: String,
    source: String,
    source_start: usize,
    target: String,
    target_start: usize,
    hard_joints: Vec<String>,
    soft_joints: Vec<String>,
    alpha: f64,
    frames: usize,
    recipe_hash: String,
    original_hash: String,
    edited_hash: String,
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let config = ComposeConfig::default();
    if let Some(id) = &args.explain {
        let dataset = Dataset::open(&args.dataset)?;
        let (stream, _) = chain::train_stream(&dataset, &config, global.seed())?;
        let triplet = stream.explain(id)?;
        let explained = Explained {
            instruction: triplet.instruction,
            source: triplet.source_id.to_string(),
            source_start: triplet.source_start,
            target: triplet.target_id.to_string(),
            target_start: triplet.target_start,
            hard_joints: triplet.mask.hard().names(),
            soft_joints: triplet.mask.soft().names(),
            alpha: triplet.alpha,
            frames: triplet.original.len(),
            recipe_hash: triplet.recipe_hash,
            original_hash: triplet.original.content_hash(),
            edited_hash: triplet.edited.content_hash(),
            id: triplet.id,
        };
        if global.json {
            report::json(&explained)?;
        } else {
            report::text(&toml::to_string(&explained)?);
        }
        return Ok(Exit::Done);
    }
    let out = args.out.as_deref().context("--out is missing")?;
    let bars = global.bars();
    let recorded = chain::triplets(&args.dataset, out, args.count, &config, global, &bars)?;
    let manifest = recorded.manifest();
    let rows = manifest.rows(TripletRow::TABLE, None);
    if global.json {
        report::json(&serde_json::json!({ "triplets": rows, "root_hash": manifest.root_hash }))?;
    } else {
        report::text(&format!("{rows} triplets in {}", out.display()));
    }
    Ok(Exit::Done)
}
