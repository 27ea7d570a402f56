//! The configuration of a run, the settings it resolves to, and the paths of its results.

use std::path::{Path, PathBuf};

use compose::{ComposeConfig, ItemConfig};
use eval::protocol::Protocol;
use pipeline::annotation::masks::MaskConfig;
use pipeline::annotation::pairs::PairConfig;
use pipeline::ingest::SourceArg;
use pipeline::stage::IngestConfig;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use train::config::{Preset, TrainConfig};
use train::coordinator::CoordinatorConfig;
use train::j2s::J2sConfig;
use train::system::EditConfig;
use train::tmr::TmrConfig;

use crate::global::Global;
use crate::judge::{BUILTIN, EncoderConfig};
use crate::seeds::Seeds;
use crate::settings;

/// The configuration file.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RunConfig {
    /// Files, folders and URLs to ingest, each as NAME=PATH or a path.
    pub(super) sources: Vec<SourceArg>,
    /// Folder for everything the run makes.
    pub(super) out: PathBuf,
    /// Named settings of the models.
    #[serde(default = "default_preset")]
    pub(super) preset: Preset,
    /// Folder of CLIP or BERT, or a table of vectors, for settings with a frozen text encoder; without it CLIP is
    /// searched in the hub's cache.
    #[serde(alias = "clip")]
    pub(super) text_encoder: Option<PathBuf>,
    /// Triplets recorded for inspection; training composes its own.
    #[serde(default = "default_triplets")]
    pub(super) triplets: u64,
    #[serde(default)]
    pub(crate) ingest: IngestConfig,
    #[serde(default)]
    pub(super) masks: MaskConfig,
    /// Optional stages.
    #[serde(default)]
    pub(crate) stages: Stages,
    /// Style pairs from labels.
    #[serde(default)]
    pub(super) pairs: PairConfig,
    /// Composer settings that override the preset's.
    #[serde(default)]
    pub(super) compose: Map<String, Value>,
    /// Editor settings that override the preset's.
    #[serde(default)]
    pub(super) train: Map<String, Value>,
    /// Coordinator settings that override the preset's.
    #[serde(default)]
    pub(super) coordinator: Map<String, Value>,
    /// Pose network settings that override the preset's.
    #[serde(default)]
    pub(super) poses: Map<String, Value>,
    /// `"builtin"` for the encoder that ships with the program, or settings of an encoder to train.
    #[serde(default)]
    pub(crate) encoder: EncoderConfig,
    /// Seeds of split, items, training and sampling.
    #[serde(default)]
    pub(super) seeds: Seeds,
    /// Test questions.
    #[serde(default)]
    pub(crate) items: ItemConfig,
    #[serde(default)]
    pub(crate) edit: EditConfig,
    #[serde(default)]
    pub(super) eval: Protocol,
}

/// Optional stages besides dataset, encoder and editor; each is skipped if the data do not allow it.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Stages {
    /// Style pairs, if motions have style labels.
    pub(super) pairs: bool,
    /// A coordinator, and a table row for the system that it guides; needs motions of two sources.
    pub(super) coordinator: bool,
    /// A pose network, which every system uses for its edits.
    pub(super) poses: bool,
    /// An editor trained on pairs that were composed once, and its row of the table.
    pub(crate) composed_once: bool,
    /// Whether to train an editor only on captured pairs, if there are any, and add its row to the table.
    pub(crate) captured_alone: bool,
}

impl Default for Stages {
    fn default() -> Self {
        Self {
            pairs: true,
            coordinator: true,
            poses: true,
            composed_once: false,
            captured_alone: false,
        }
    }
}

fn default_preset() -> Preset {
    Preset::Tiny
}

fn default_triplets() -> u64 {
    64
}

impl RunConfig {
    /// The default settings for these sources.
    pub(crate) fn new(sources: Vec<SourceArg>, out: PathBuf) -> Self {
        let required = serde_json::json!({ "sources": [], "out": "" });
        let config = serde_json::from_value(required).expect("all else has a default");
        Self {
            sources,
            out,
            ..config
        }
    }
}

/// A configuration with everything resolved.
pub(crate) struct Plan {
    pub(super) config: RunConfig,
    pub(crate) compose: ComposeConfig,
    pub(crate) train: TrainConfig,
    pub(crate) coordinator: CoordinatorConfig,
    pub(crate) poses: J2sConfig,
    pub(crate) encoder: TmrConfig,
    /// Whether the built-in encoder evaluates, and none is trained.
    pub(super) with_builtin: bool,
    pub(crate) title: String,
    pub(crate) commands: Vec<String>,
}

impl Plan {
    /// Resolves the presets and the seed.
    pub(crate) fn new(config: RunConfig, global: &Global) -> anyhow::Result<Self> {
        let preset = config.preset;
        let own = &config.train;
        let mut train = settings::over(&TrainConfig::preset(preset), "train", own)?;
        let own_encoder = &config.encoder.settings();
        let with_builtin = config.encoder.is_builtin();
        let mut encoder = settings::over(&TmrConfig::preset(preset), "encoder", own_encoder)?;
        let own = &config.coordinator;
        let mut coordinator =
            settings::over(&CoordinatorConfig::preset(preset), "coordinator", own)?;
        let mut poses = settings::over(&J2sConfig::of(preset), "poses", &config.poses)?;
        let seeds = config.seeds;
        for (seed, own) in [
            (&mut train.run.seed, &config.train),
            (&mut coordinator.run.seed, &config.coordinator),
            (&mut poses.run.seed, &config.poses),
            (&mut encoder.run.seed, own_encoder),
        ] {
            *seed = seeds.of_model(*seed, own, global).0;
        }
        let compose = &TrainConfig::compose_preset(preset);
        let compose = settings::over(compose, "compose", &config.compose)?;
        Ok(Self {
            config,
            compose,
            train,
            coordinator,
            poses,
            encoder,
            with_builtin,
            title: "stance run".to_owned(),
            commands: Vec::new(),
        })
    }
}

/// Paths of the results of a run.
pub(super) struct Places {
    pub(super) dataset: PathBuf,
    pub(super) triplets: PathBuf,
    pub(super) editor: PathBuf,
    pub(super) composed_once: PathBuf,
    pub(super) captured_alone: PathBuf,
    pub(super) coordinator: PathBuf,
    pub(super) poses: PathBuf,
    pub(super) encoder: PathBuf,
    pub(super) items: PathBuf,
    pub(super) edits: PathBuf,
    pub(super) scores: PathBuf,
    pub(super) report: PathBuf,
}

impl Places {
    pub(super) fn under(out: &Path, with_builtin: bool) -> Self {
        Self {
            dataset: out.join("dataset"),
            triplets: out.join("triplets"),
            editor: out.join("runs/motionrefit"),
            composed_once: out.join("runs/composed-once"),
            captured_alone: out.join("runs/captured-alone"),
            coordinator: out.join("runs/coordinator"),
            poses: out.join("runs/j2s"),
            encoder: match with_builtin {
                true => BUILTIN.into(),
                false => out.join("runs/tmr"),
            },
            items: out.join("items"),
            edits: out.join("edits"),
            scores: out.join("scores"),
            report: out.join("report.html"),
        }
    }
}
