//! `stance build`

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use compose::ComposeConfig;
use compose::recording::{self, Kind, Settings};
use datasets_spec::record::{MaskRow, MotionRow, PairRow, TripletRow};
use datasets_spec::table::Row;
use pipeline::annotation::masks::MaskConfig;
use pipeline::annotation::pairs::PairConfig;
use pipeline::clips::Clips;
use pipeline::export::{Layout, export};
use pipeline::ingest::SourceArg;
use pipeline::stage::{self, IngestConfig, Judged};
use serde::{Deserialize, Serialize};

use crate::exit::Exit;
use crate::global::Global;
use crate::{settings, stages};

/// Build a dataset from one file of settings: motions, masks, pairs, splits, triplets.
///
/// The configuration is a TOML file; every key but `sources` and `out` may be left out. Relative paths are relative to
/// the file. Run again after an interruption, it continues.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Configuration file
    #[arg(long)]
    config: PathBuf,
    /// Files, folders and URLs to ingest, instead of those of the configuration
    #[arg(long, num_args = 1.., value_name = "[NAME=]SOURCE", value_parser = super::ingest::parse_source())]
    sources: Vec<SourceArg>,
    /// Folder for everything, instead of that of the configuration
    #[arg(long, value_parser = crate::local::path())]
    out: Option<PathBuf>,
}

/// The configuration file.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct BuildConfig {
    /// Files, folders and URLs to ingest, each as NAME=PATH or a path.
    sources: Vec<SourceArg>,
    out: PathBuf,
    /// Number of triplets to record.
    #[serde(default = "default_triplets")]
    triplets: u64,
    /// Layouts written beside the dataset.
    #[serde(default)]
    export: Vec<String>,
    #[serde(default)]
    ingest: IngestConfig,
    #[serde(default)]
    masks: MaskConfig,
    /// Style pairs from labels; none without this section.
    pairs: Option<PairConfig>,
    #[serde(default)]
    compose: ComposeConfig,
}

fn default_triplets() -> u64 {
    256
}

/// The `--json` document.
#[derive(Serialize)]
struct Document {
    dataset: PathBuf,
    triplets: PathBuf,
    exports: Vec<PathBuf>,
    accounting: datasets_spec::manifest::Accounting,
    motions: u64,
    masks: u64,
    pairs: u64,
    alone: usize,
    recorded: u64,
    root_hash: String,
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let config = read(args)?;
    let bars = global.bars();
    let root = config.out.join("dataset");
    let ingested = stages::ingested(
        &config.sources,
        &root,
        &config.ingest,
        global.seed(),
        global,
        &bars,
    )
    .context("stage ingest")?;
    global
        .stage(|context| stage::masks(&root, &config.masks, Judged::Keep, None, context))
        .context("stage masks")?;
    let seed = global.seed();
    let alone = match &config.pairs {
        Some(pairs) => {
            global
                .stage(|context| stage::pairs(&root, pairs, seed, None, context))
                .context("stage pairs")?
                .1
        }
        None => Vec::new(),
    };
    let triplets = config.out.join("triplets");
    let settings = Settings {
        kind: Kind::Triplets,
        count: config.triplets,
        config: config.compose.clone(),
        seed,
        condition: None,
    };
    let recorded = global
        .stage(|context| recording::record(&root, &triplets, &settings, context))
        .context("stage triplets")?;
    let dataset = datasets_spec::Dataset::open(&root)?;
    let mut exports = Vec::new();
    for name in &config.export {
        let layout = Layout::ALL
            .into_iter()
            .find(|layout| layout.as_str() == name)
            .with_context(|| {
                let known = Layout::ALL.map(Layout::as_str).join(", ");
                format!("[export] names {name:?}, which is none of {known}")
            })?;
        let out = config.out.join(name);
        // An export appears complete or not at all and depends only on the dataset, so an existing one is current.
        if !out.exists() {
            export(&Clips::all(&dataset), layout, &out, &bars)
                .with_context(|| format!("stage export {name}"))?;
        }
        exports.push(out);
    }
    let manifest = dataset.manifest();
    let document = Document {
        dataset: root,
        triplets,
        exports,
        accounting: ingested.accounting.clone(),
        motions: manifest.rows(MotionRow::TABLE, None),
        masks: manifest.rows(MaskRow::TABLE, None),
        pairs: manifest.rows(PairRow::TABLE, None),
        alone: alone.len(),
        recorded: recorded.manifest().rows(TripletRow::TABLE, None),
        root_hash: manifest.root_hash.clone(),
    };
    global.say(&document, &summary(&document))?;
    Ok(if ingested.accounting.quarantined > 0 {
        Exit::Quarantined
    } else {
        Exit::Done
    })
}

fn read(args: &Args) -> anyhow::Result<BuildConfig> {
    let mut config: BuildConfig = settings::read(&args.config)?;
    let base = args.config.parent().unwrap_or(Path::new("."));
    let sources = config.sources.into_iter();
    config.sources = sources.map(|source| source.below(base)).collect();
    for path in [&mut config.out]
        .into_iter()
        .chain(&mut config.ingest.pairs)
    {
        *path = base.join(&*path);
    }
    if !args.sources.is_empty() {
        config.sources.clone_from(&args.sources);
    }
    if let Some(out) = &args.out {
        config.out.clone_from(out);
    }
    if config.sources.is_empty() {
        bail!("{} names no sources", args.config.display());
    }
    Ok(config)
}

fn summary(document: &Document) -> String {
    let accounting = &document.accounting;
    let mut lines = vec![
        format!(
            "{} sources = {} ingested + {} quarantined + {} skipped",
            accounting.sources, accounting.ingested, accounting.quarantined, accounting.skipped
        ),
        format!("motions   {:>8}", document.motions),
        format!("masks     {:>8}", document.masks),
        format!(
            "pairs     {:>8}   {} styled motions have no counterpart in their split",
            document.pairs, document.alone
        ),
        format!("triplets  {:>8}", document.recorded),
        format!("dataset   {}", document.dataset.display()),
        format!("recorded  {}", document.triplets.display()),
    ];
    let exports = document.exports.iter();
    lines.extend(exports.map(|path| format!("export    {}", path.display())));
    lines.push(format!("root hash {}", document.root_hash));
    lines.join("\n")
}
