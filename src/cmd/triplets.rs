//! `stance triplets`

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use compose::recording::{self, Kind, Settings, plan_recording};
use compose::{ComposeConfig, Stream, StreamStats, Triplet, TripletStats, triplet_stats};
use datasets_spec::record::TripletRow;
use datasets_spec::table::{Cell, RecordBatch, Row as _, decode_column};
use datasets_spec::{JointSet, Motion, Skeleton};
use eval::draw::strip::{Row, Style, strip};
use eval::metric::foot_score::{feet, foot_score};
use eval::protocol::Floor;
use serde::Serialize;
use serde_json::{Value, json};
use train::config::overlay;
use work::Plan;

use crate::chosen::ChosenArgs;
use crate::cmd::render;
use crate::exit::Exit;
use crate::global::Global;
use crate::{report, settings};

/// Record the composer's training stream, count it, or rebuild one of its triplets.
///
/// A triplet is an original motion, an instruction, and the edited motion that MotionCutMix composes. Training composes
/// triplets on the fly; this command records the same stream.
#[derive(clap::Args, Debug)]
#[command(subcommand_negates_reqs = true, args_conflicts_with_subcommands = true)]
pub(crate) struct Args {
    #[command(subcommand)]
    action: Option<Action>,
    /// Dataset folder with motions and masks
    #[arg(required = true)]
    dataset: Option<PathBuf>,
    /// Folder to record to
    #[arg(long, required_unless_present = "explain")]
    out: Option<PathBuf>,
    /// Number of whole-clip triplets to record
    #[arg(long, default_value_t = 64)]
    count: u64,
    /// Record this many training windows instead
    #[arg(long, value_name = "N", conflicts_with = "count")]
    windows: Option<u64>,
    #[command(flatten)]
    compose: ComposeArgs,
    #[command(flatten)]
    chosen: ChosenArgs,
    /// Rebuild the triplet with this id, and print its components and the settings used: --seed, --compose, --phrases and
    /// --where must be those of the recording
    #[arg(long, value_name = "ID", conflicts_with_all = ["out", "windows", "count"])]
    explain: Option<String>,
}

#[derive(clap::Subcommand, Debug)]
enum Action {
    Stats(StatsArgs),
}

/// Settings of the composer.
#[derive(clap::Args, Debug)]
pub(crate) struct ComposeArgs {
    /// Settings of the composer in TOML, as in section `compose` of the file of `stance build`
    #[arg(long, value_name = "TOML")]
    compose: Option<PathBuf>,
    /// Paraphrases and templates of instructions in TOML
    #[arg(long, value_name = "TOML")]
    phrases: Option<PathBuf>,
}

impl ComposeArgs {
    pub(crate) fn is_given(&self) -> bool {
        self.compose.is_some() || self.phrases.is_some()
    }

    pub(crate) fn config(&self) -> anyhow::Result<ComposeConfig> {
        self.over(&ComposeConfig::default())
    }

    /// The settings of a preset, with some overridden by those of a file.
    pub(crate) fn over(&self, preset: &ComposeConfig) -> anyhow::Result<ComposeConfig> {
        let mut config = match &self.compose {
            Some(path) => {
                let own = settings::read::<Value>(path)?;
                let config = overlay(preset, &own).map_err(anyhow::Error::new);
                let checked = config.and_then(|config| {
                    config.check()?;
                    Ok(config)
                });
                checked.map_err(|error| settings::at(path, error))?
            }
            None => preset.clone(),
        };
        if let Some(path) = &self.phrases {
            config.phrases = settings::read(path)?;
        }
        Ok(config)
    }
}

/// Count the triplets that the settings allow and the effects of blending, and draw a sheet of triplets.
#[derive(clap::Args, Debug)]
struct StatsArgs {
    /// Dataset folder with motions and masks
    dataset: PathBuf,
    /// Number of triplets to compose and count
    #[arg(long, default_value_t = 512)]
    count: u64,
    /// Picture of twelve triplets to draw: .svg or .png
    #[arg(long, value_name = "FILE")]
    sheet: Option<PathBuf>,
    #[command(flatten)]
    compose: ComposeArgs,
    #[command(flatten)]
    chosen: ChosenArgs,
}

#[derive(Serialize)]
struct Counted {
    #[serde(flatten)]
    stream: StreamStats,
    recorded: TripletStats,
    /// Mean foot score before and after the edit.
    foot_score: [f64; 2],
}

fn stats(args: &StatsArgs, global: &Global) -> anyhow::Result<Exit> {
    let config = args.compose.config()?;
    let dataset = args.chosen.open(&args.dataset)?;
    let (stream, _) = compose::train_stream(&dataset, &config, global.seed(), None)?;
    let skeleton = dataset.skeleton()?;
    let triplets = stream.first_triplets(args.count.max(1))?;
    let foot_scores: Vec<[Option<f64>; 2]> = triplets
        .iter()
        .map(|triplet| {
            [&triplet.original, &triplet.edited].map(|motion| {
                let joints = skeleton.points_of_frames::<12>(motion, 0..motion.len());
                foot_score(&feet(&joints), motion.fps(), Floor::At(0.0))
            })
        })
        .collect();
    let mean = |side: usize| {
        let known: Vec<f64> = foot_scores.iter().filter_map(|both| both[side]).collect();
        known.iter().sum::<f64>() / known.len().max(1) as f64
    };
    let counted = Counted {
        stream: stream.stats(),
        recorded: triplet_stats(&triplets, &skeleton),
        foot_score: [mean(0), mean(1)],
    };
    if let Some(path) = &args.sheet {
        let sheet = sheet(&stream, &skeleton)?;
        render::write_picture(path, &sheet, 1.0)?;
        report::note(&format!("sheet in {}", path.display()));
    }
    global.say(&counted, &table(&counted))
}

/// Draws twelve triplets in two columns. Each has four rows: the original, the motion that joints are taken from, the
/// edit with only the hard mask, and the edit with hard and soft mask. Masked joints have a halo.
fn sheet(stream: &Stream, skeleton: &Skeleton) -> anyhow::Result<String> {
    const TRIPLETS: usize = 12;
    const COLUMNS: usize = 2;
    let style = Style {
        width: 900.0,
        num_figures: 7,
    };
    let mut panels = Vec::new();
    for triplet in stream.sample_for_sheet(TRIPLETS)? {
        let hard_only = stream.with_hard_mask(&triplet)?;
        let row = |label: &str, motion: &Motion, halo: JointSet| Row {
            highlighted: halo,
            ..Row::new(label, motion, skeleton)
        };
        let mask = triplet.mask;
        let target = stream.taken(&triplet)?;
        let rows = [
            row("original", &triplet.original, JointSet::EMPTY),
            row("target", &target, mask.hard()),
            row("hard mask", &hard_only, mask.hard()),
            row("soft mask", &triplet.edited, mask.hard().union(mask.soft())),
        ];
        let title = format!(
            "{} · {} · weight {:.2}",
            triplet.kind, triplet.instruction, triplet.alpha
        );
        panels.push((title, strip(&rows, &style)));
    }
    Ok(eval::draw::strip::sheet(&panels, COLUMNS, style.width))
}

fn table(counted: &Counted) -> String {
    let (stream, recorded) = (&counted.stream, &counted.recorded);
    let mut lines = vec![format!(
        "split {}: {} motions to draw partners from, {} windows an epoch, {} instructions",
        stream.split, stream.base, stream.windows, stream.instructions
    )];
    for (kind, count) in &stream.annotated {
        lines.push(format!(
            "  {kind:<14} {count:>7} annotated {:>12} distinct pairs",
            stream.distinct_pairs[kind]
        ));
    }
    if stream.too_short > 0 {
        lines.push(format!(
            "  {} masks and pairs are shorter than a window and not used",
            stream.too_short
        ));
    }
    lines.push(format!("in {} triplets:", recorded.triplets));
    for (name, [before, after]) in [
        ("mean speed m/s", recorded.mean_speed),
        ("max speed m/s", recorded.max_speed),
        ("foot score", counted.foot_score),
    ] {
        lines.push(format!(
            "  {name:<16} {before:>7.3} before {after:>7.3} after the edit"
        ));
    }
    lines.push("  weight of soft joints".to_owned());
    let most = recorded.alphas.iter().copied().max().unwrap_or(1).max(1);
    for (bin, &count) in recorded.alphas.iter().enumerate() {
        let from = bin as f64 / recorded.alphas.len() as f64;
        lines.push(format!(
            "    {from:.1} {count:>6} {}",
            "#".repeat(40 * count / most)
        ));
    }
    lines.push("  masks".to_owned());
    let masks = recorded.masks.iter();
    lines.extend(masks.map(|(mask, count)| format!("    {count:>6} {mask}")));
    const SHOWN: usize = 12;
    lines.push("  instructions".to_owned());
    let instructions = recorded.instructions.iter().take(SHOWN);
    lines.extend(instructions.map(|(text, count)| format!("    {count:>6} {text}")));
    let hidden = recorded.instructions.len().saturating_sub(SHOWN);
    if hidden > 0 {
        lines.push(format!("           and {hidden} others"));
    }
    lines.join("\n")
}

impl Args {
    pub(crate) fn plan(&self, plan: &Path, global: &Global) -> anyhow::Result<Plan> {
        let (Some(root), Some(out)) = (&self.dataset, &self.out) else {
            bail!("a recording is planned from a dataset: DATASET --into DIR");
        };
        let settings = self.recorded(self.compose.config()?, global);
        Ok(plan_recording(root, out, &settings, plan)?)
    }

    fn recorded(&self, config: ComposeConfig, global: &Global) -> Settings {
        let (kind, count) = match self.windows {
            Some(count) => (Kind::Windows, count),
            None => (Kind::Triplets, self.count),
        };
        Settings {
            kind,
            count,
            config,
            seed: global.seed(),
            condition: self.chosen.text(),
        }
    }
}

/// Prints a triplet's row without its motions, the settings it was composed with, and hashes of its motions.
fn explained(triplet: &Triplet, args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let mut facts = labels_of(triplet.to_row())?;
    let file = |path: &Option<PathBuf>| path.as_ref().map(|path| path.display().to_string());
    facts.extend([
        // An id is a place in a stream: other settings have another triplet there.
        ("compose", json!(file(&args.compose.compose))),
        ("phrases", json!(file(&args.compose.phrases))),
        ("where", json!(args.chosen.text())),
        ("original_hash", json!(triplet.original.content_hash())),
        ("edited_hash", json!(triplet.edited.content_hash())),
    ]);
    let lines = facts
        .iter()
        .map(|(key, value)| format!("{key} = {value}\n"));
    let text: String = lines.collect();
    global.say(&BTreeMap::from_iter(facts), &text)
}

/// The columns of a triplet besides its motions.
fn labels_of(row: TripletRow) -> anyhow::Result<Vec<(&'static str, Value)>> {
    fn cell<T: Cell + Serialize>(batch: &RecordBatch, name: &'static str) -> anyhow::Result<Value> {
        let values: Vec<T> = decode_column(TripletRow::TABLE, name, batch)?;
        Ok(json!(values.first()))
    }
    let batch = TripletRow::encode(&[row])?;
    let mut labels = Vec::new();
    for column in TripletRow::columns() {
        let name = column.name;
        let value = match (column.type_name().as_str(), column.nullable) {
            ("utf8", false) => cell::<String>(&batch, name)?,
            ("list<utf8>", false) => cell::<Vec<String>>(&batch, name)?,
            ("i32", false) => cell::<i32>(&batch, name)?,
            ("i32", true) => cell::<Option<i32>>(&batch, name)?,
            ("u64", false) => cell::<u64>(&batch, name)?,
            ("f32", false) => cell::<f32>(&batch, name)?,
            // Frames of a motion.
            _ => continue,
        };
        labels.push((name, value));
    }
    Ok(labels)
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    if let Some(Action::Stats(args)) = &args.action {
        return stats(args, global);
    }
    let root = args.dataset.as_deref().context("DATASET is missing")?;
    let config = args.compose.config()?;
    if let Some(id) = &args.explain {
        let dataset = args.chosen.open(root)?;
        let (stream, _) = compose::train_stream(&dataset, &config, global.seed(), None)?;
        return explained(&stream.explain(id)?, args, global);
    }
    let out = args.out.as_deref().context("--out is missing")?;
    let settings = args.recorded(config, global);
    let table = settings.kind.table();
    let (recorded, too_short) =
        global.stage(|context| recording::record(root, out, &settings, context))?;
    let manifest = recorded.manifest();
    let rows = manifest.rows(table, None);
    global.say(
        &json!({ table: rows, "too_short": too_short, "root_hash": manifest.root_hash }),
        &format!("{rows} {table} in {}", out.display()),
    )
}
