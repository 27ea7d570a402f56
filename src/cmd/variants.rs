//! `stance variants`

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use datasets_spec::Split;
use datasets_spec::record::PairRow;
use datasets_spec::table::Row;
use serde_json::json;
use train::candidates::VariantConfig;
use train::mld::LatentNoise;
use train::stage::variants::{
    Instructions, MakeVariants, VariantReport, make_variants, pair_variants,
};
use train::work::variants::plan_variants;
use work::Plan;

use crate::chosen::ChosenArgs;
use crate::device::DeviceArgs;
use crate::exit::Exit;
use crate::global::Global;
use crate::session::{refuse_unused_encoder, surroundings, text_encoder, with_session};

/// Make candidates of fine-grained pairs: variants of one motion, paired one to one.
///
/// A generator (`stance train mld`) samples a latent vector for every instruction and decodes variants of it with a
/// little noise. Pairs that are identical, too different or broken are left out and counted. `stance annotate` shows
/// the candidates of an instruction as one bundle. Without --generator, motions of the dataset whose ids share a
/// folder, such as base/variant, are the variants. --where chooses the clips that give the captions or the variants.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Dataset folder: its captions are instructions; without --generator, its motions are the variants
    dataset: PathBuf,
    #[command(flatten)]
    chosen: ChosenArgs,
    /// Run folder of the generator
    #[arg(long, value_name = "RUN", requires = "instructions")]
    generator: Option<PathBuf>,
    /// Instructions to sample: `captions` for those of the dataset, or a file with one text per line
    #[arg(long, value_name = "FILE|captions", requires = "generator")]
    instructions: Option<PathBuf>,
    /// Maximum number of instructions, drawn with --seed [default: all]
    #[arg(long, value_name = "N", requires = "generator")]
    count: Option<usize>,
    /// Variants per instruction
    #[arg(long, value_name = "N", default_value_t = MakeVariants::default().variants, requires = "generator")]
    variants: usize,
    /// Standard deviation of the noise between variants, in standard deviations of the latent vectors of motions
    /// [default: 0.1 units of the latent space]
    #[arg(long, value_name = "SHARE", requires = "generator")]
    relative_noise: Option<f64>,
    /// Root mean square distance in metres between joints below which variants are identical
    #[arg(long, value_name = "M", default_value_t = VariantConfig::default().min_distance_m)]
    min_distance: f64,
    /// Root mean square distance in metres above which variants are different motions
    #[arg(long, value_name = "M", default_value_t = VariantConfig::default().max_distance_m)]
    max_distance: f64,
    /// Maximum mean speed of planted feet in m/s
    #[arg(long, value_name = "SPEED", default_value_t = VariantConfig::default().max_foot_skate)]
    max_skate: f32,
    /// Maximum mean deviation of bone lengths in metres
    #[arg(long, value_name = "M", default_value_t = VariantConfig::default().max_bone_drift_m)]
    max_drift: f32,
    /// Folder of CLIP or BERT, or a table of vectors (`stance model table`), for a generator with a frozen text encoder
    /// [default: CLIP in the hub's cache]
    #[arg(long, value_name = "PATH", requires = "generator")]
    text_encoder: Option<PathBuf>,
    /// Dataset folder to write
    #[arg(long)]
    out: PathBuf,
    #[command(flatten)]
    device: DeviceArgs,
}

impl Args {
    fn filter(&self) -> VariantConfig {
        VariantConfig {
            min_distance_m: self.min_distance,
            max_distance_m: self.max_distance,
            max_foot_skate: self.max_skate,
            max_bone_drift_m: self.max_drift,
        }
    }

    fn config(&self) -> MakeVariants {
        MakeVariants {
            count: self.count,
            variants: self.variants,
            noise: (self.relative_noise)
                .map_or(MakeVariants::default().noise, LatentNoise::Relative),
            filter: self.filter(),
        }
    }

    pub(crate) fn plan(&self, plan: &Path, global: &Global) -> anyhow::Result<Plan> {
        self.device.choose()?;
        let (Some(generator), Some(instructions)) = (&self.generator, &self.instructions) else {
            bail!(
                "variants of a generator are planned: --generator RUN --instructions FILE|captions"
            );
        };
        refuse_unused_encoder(generator, self.text_encoder.as_deref())?;
        Ok(plan_variants(
            [&self.dataset, generator, &self.out].map(PathBuf::as_path),
            &read_instructions(instructions, self.chosen.text())?,
            (&self.config(), global.seed()),
            self.text_encoder.as_deref(),
            self.device.to_json(),
            &surroundings(),
            plan,
        )?)
    }
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    args.device.choose()?;
    let holder = global.holder();
    let made = match (&args.generator, &args.instructions) {
        (Some(generator), Some(instructions)) => {
            let asked = read_instructions(instructions, args.chosen.text())?;
            let (config, seed) = (args.config(), global.seed());
            let folders = [&args.dataset, generator, &args.out].map(PathBuf::as_path);
            refuse_unused_encoder(generator, args.text_encoder.as_deref())?;
            let encoder = text_encoder(args.text_encoder.as_deref());
            with_session(&global.bars(), |session| {
                make_variants(folders, &asked, &config, &encoder, seed, &holder, session)
            })?
        }
        _ => {
            let dataset = args.chosen.open(&args.dataset)?;
            pair_variants(&dataset, &args.out, &args.filter(), &holder)?
        }
    };
    print(&made, global)
}

fn read_instructions(file: &Path, condition: Option<String>) -> anyhow::Result<Instructions> {
    if file == Path::new("captions") {
        return Ok(Instructions::Captions(condition));
    }
    if condition.is_some() {
        bail!(
            "--where chooses clips of the dataset, and the instructions of {} are of no clip; leave it out, or sample \
             --instructions captions",
            file.display()
        );
    }
    let text = std::fs::read_to_string(file)
        .with_context(|| format!("cannot read the instructions in {}", file.display()))?;
    let lines = text.lines().map(str::trim).filter(|line| !line.is_empty());
    let texts: Vec<String> = lines.map(str::to_owned).collect();
    if texts.is_empty() {
        bail!(
            "{} holds no instruction: write one on each line",
            file.display()
        );
    }
    Ok(Instructions::Texts(texts))
}

fn print(made: &VariantReport, global: &Global) -> anyhow::Result<Exit> {
    let manifest = made.dataset.manifest();
    let pairs = manifest.rows(PairRow::TABLE, None);
    let mut lines = vec![format!("{pairs} candidate pairs")];
    if let Some(std) = made.latent_std {
        lines.push(format!(
            "standard deviation of the latent vectors: {std:.3}"
        ));
    }
    match made.counts {
        None => lines.push("they were there already".to_owned()),
        Some(counts) => {
            lines.push(format!(
                "{} variants of {} motions, {} unpaired",
                counts.variants, counts.bases, counts.unpaired
            ));
            let left_out = [
                ("broken", counts.broken),
                ("of different lengths", counts.lengths),
                ("identical", counts.identical),
                ("too different", counts.different),
                ("sliding feet", counts.sliding),
                ("bones of other lengths", counts.drifting),
                ("off the floor", counts.floating),
            ];
            let left_out = left_out.iter().filter(|(_, count)| *count > 0);
            lines.extend(left_out.map(|(reason, count)| format!("  {reason:<24} {count:>6}")));
        }
    }
    let splits = Split::ALL.map(|split| (split, manifest.rows(PairRow::TABLE, Some(split))));
    let own = json!({ "pairs": pairs, "splits": splits, "root_hash": manifest.root_hash });
    global.say_joined(own, made, &lines.join("\n"))
}
