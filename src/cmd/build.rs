//! `stance build`

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::{Context, bail};
use compose::ComposeConfig;
use datasets_spec::Dataset;
use datasets_spec::record::{MaskRow, MotionRow, PairRow, TripletRow};
use datasets_spec::table::Row;
use pipeline::annotation::masks::MaskConfig;
use pipeline::annotation::pairs::PairConfig;
use pipeline::clips::Clips;
use pipeline::export::{Layout, export};
use pipeline::ingest::SourceArg;
use pipeline::stage::IngestConfig;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer};

use crate::cmd::export::layout_named;
use crate::exit::Exit;
use crate::global::Global;
use crate::report::accounted;
use crate::{local, settings, stages};

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

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct BuildConfig {
    /// Files, folders and URLs to ingest, each as NAME=PATH or a path.
    sources: Vec<SourceArg>,
    out: PathBuf,
    /// Number of triplets to record.
    #[serde(default = "default_triplets")]
    triplets: u64,
    /// Layouts written beside the dataset.
    #[serde(default, deserialize_with = "layouts")]
    export: Vec<Layout>,
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

fn layouts<'de, D: Deserializer<'de>>(names: D) -> Result<Vec<Layout>, D::Error> {
    let names = Vec::<String>::deserialize(names)?;
    let layouts = names.iter().map(|name| {
        layout_named(name).ok_or_else(|| {
            let known = Layout::ALL.map(Layout::as_str).join(", ");
            D::Error::custom(format!("export names {name:?}, which is none of {known}"))
        })
    });
    layouts.collect()
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let config = read(args)?;
    let (root, seed) = (config.out.join("dataset"), global.seed());
    let (ingest, masks, pairs) = (&config.ingest, &config.masks, config.pairs.as_ref());
    let (ingested, alone) =
        stages::dataset(&config.sources, &root, ingest, masks, pairs, seed, global)?;
    let triplets = config.out.join("triplets");
    let (count, compose) = (config.triplets, &config.compose);
    let recorded = stages::triplets([&root, &triplets], count, compose, seed, global)?;
    let dataset = Dataset::open(&root)?;
    let exports = exported(&config, &dataset, global)?;
    let (accounting, manifest) = (&ingested.accounting, dataset.manifest());
    let counts = [MotionRow::TABLE, MaskRow::TABLE, PairRow::TABLE];
    let [motions, masks, pairs] = counts.map(|table| manifest.rows(table, None));
    let recorded = recorded.manifest().rows(TripletRow::TABLE, None);
    let [root, triplets] = [root, triplets].map(|path| path.display().to_string());
    let mut lines = vec![
        accounted(accounting),
        format!("motions   {motions:>8}"),
        format!("masks     {masks:>8}"),
        format!(
            "pairs     {pairs:>8}   {} styled motions have no counterpart in their split",
            alone.len()
        ),
        format!("triplets  {recorded:>8}"),
        format!("dataset   {root}"),
        format!("recorded  {triplets}"),
    ];
    lines.extend(exports.iter().map(|path| format!("export    {path}")));
    lines.push(format!("root hash {}", manifest.root_hash));
    let document = serde_json::json!({
        "dataset": root,
        "triplets": triplets,
        "exports": exports,
        "accounting": accounting,
        "motions": motions,
        "masks": masks,
        "pairs": pairs,
        "alone": alone.len(),
        "recorded": recorded,
        "root_hash": manifest.root_hash,
    });
    global.say(&document, &lines.join("\n"))?;
    let is_whole = ingested.notes.all_lines_were_used();
    Ok(Exit::quarantined_if(
        accounting.quarantined > 0 || !is_whole,
    ))
}

/// File of a build: the root hash of the dataset that each layout was exported from.
const EXPORTS: &str = "exports.json";

/// Exports the dataset in every layout of the configuration, and returns the folders. An export of the same dataset is
/// complete and stays.
fn exported(
    config: &BuildConfig,
    dataset: &Dataset,
    global: &Global,
) -> anyhow::Result<Vec<String>> {
    let (record, root_hash) = (config.out.join(EXPORTS), &dataset.manifest().root_hash);
    let mut hashes: BTreeMap<String, String> = match record.exists() {
        true => serde_json::from_slice(&local::read(&record)?)
            .with_context(|| format!("cannot read {}", record.display()))?,
        false => BTreeMap::new(),
    };
    let mut exports = Vec::new();
    for &layout in &config.export {
        let name = layout.as_str();
        let out = config.out.join(name);
        if !out.exists() {
            // Recorded first, so that no export is without a record. It appears complete or not at all.
            hashes.insert(name.to_owned(), root_hash.clone());
            local::write(&record, &serde_json::to_vec_pretty(&hashes)?)?;
            export(&Clips::all(dataset), layout, &out, &global.bars())
                .with_context(|| format!("stage export {name}"))?;
        }
        if hashes.get(name) != Some(root_hash) {
            let found = match hashes.contains_key(name) {
                true => "is not an export of the dataset as it is now",
                false => "is in no record of exports, and may be of another dataset",
            };
            bail!(
                "{} {found}; move it away, and the same command exports it again",
                out.display()
            );
        }
        exports.push(out.display().to_string());
    }
    Ok(exports)
}

fn read(args: &Args) -> anyhow::Result<BuildConfig> {
    let mut config: BuildConfig = settings::read(&args.config)?;
    let paths = std::iter::once(&mut config.out).chain(&mut config.ingest.pairs);
    settings::place_beside(&args.config, &mut config.sources, paths);
    let checked = config.compose.check();
    checked.map_err(|error| settings::at(&args.config, error.into()))?;
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
