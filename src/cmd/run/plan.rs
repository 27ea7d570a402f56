//! The configuration of a run, the settings it resolves to, and the paths of its results.

use std::path::PathBuf;

use anyhow::bail;
use compose::{ComposeConfig, ItemConfig};
use eval::protocol::Protocol;
use pipeline::annotation::masks::MaskConfig;
use pipeline::annotation::pairs::PairConfig;
use pipeline::ingest::SourceArg;
use pipeline::stage::IngestConfig;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use train::config::{Preset, TrainConfig};
use train::coordinator::CoordinatorConfig;
use train::j2s::J2sConfig;
use train::registry;
use train::system::EditConfig;
use train::tmr::TmrConfig;

use crate::cmd::edit::system_name;
use crate::global::Global;
use crate::judge::{BUILTIN, EncoderConfig};
use crate::seeds::Seeds;
use crate::settings;

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RunConfig {
    /// Files, folders and URLs to ingest, each as NAME=PATH or a path.
    pub(super) sources: Vec<SourceArg>,
    /// Folder for everything the run makes.
    pub(super) out: PathBuf,
    /// Named settings of the models.
    #[serde(default)]
    pub(super) preset: Preset,
    /// Folder of CLIP or BERT, or a table of vectors, for settings with a frozen text encoder; without it, CLIP is
    /// taken from the hub's cache.
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
    compose: Map<String, Value>,
    /// Editor settings that override the preset's.
    #[serde(default)]
    pub(crate) train: Map<String, Value>,
    /// Coordinator settings that override the preset's.
    #[serde(default)]
    pub(crate) coordinator: Map<String, Value>,
    /// Pose network settings that override the preset's.
    #[serde(default)]
    pub(crate) poses: Map<String, Value>,
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

/// Stages that can be switched off. Pairs, coordinator and the editor of captured pairs are also skipped if the data do
/// not allow them.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Stages {
    /// Style pairs, if motions have style labels.
    pub(super) pairs: bool,
    /// A coordinator, and a table row for the system that it guides; needs motions of two sources.
    pub(super) coordinator: bool,
    /// A pose network, which every system uses for its edits.
    pub(super) poses: bool,
    /// An editor trained with `fixed_pairs` (each mask and pair is composed once), and its row of the table.
    pub(crate) composed_once: bool,
    /// An editor trained only on captured pairs, and its row of the table; needs such pairs.
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

pub(crate) struct Plan {
    pub(super) config: RunConfig,
    pub(super) compose: ComposeConfig,
    pub(super) train: Model,
    pub(super) coordinator: Model,
    pub(super) poses: Model,
    pub(super) encoder: Model,
    pub(crate) title: String,
    pub(crate) commands: Vec<String>,
}

pub(super) struct Model {
    /// Settings that override the preset's: a JSON object.
    pub(super) own: Value,
    /// All settings, including those of the preset and the seed.
    pub(super) all: Value,
    pub(super) seed: u64,
}

impl Plan {
    /// Resolves the presets and the seeds.
    pub(crate) fn new(config: RunConfig, global: &Global) -> anyhow::Result<Self> {
        let (preset, seeds) = (config.preset, config.seeds);
        let own = &config.train;
        let train = Model::over(&TrainConfig::preset(preset), "train", own, seeds, global)?;
        let own = &config.encoder.settings();
        let encoder = Model::over(&TmrConfig::preset(preset), "encoder", own, seeds, global)?;
        let editor = settings::over(&TrainConfig::preset(preset), "train", &config.train)?;
        let of_preset = CoordinatorConfig::preset(preset);
        let own = &guiding(&editor, &of_preset, &config.coordinator)?;
        let coordinator = Model::over(&of_preset, "coordinator", own, seeds, global)?;
        let own = &config.poses;
        let poses = Model::over(&J2sConfig::of(preset), "poses", own, seeds, global)?;
        let compose = &TrainConfig::compose_preset(preset);
        let compose = settings::over(compose, "compose", &config.compose)?;
        // Found now, and not after hours of reading motions.
        editor.check()?;
        compose.check()?;
        config.items.compose.check()?;
        config.edit.check()?;
        if let Some(editor) = registry::model("motionrefit") {
            editor.check_edit_inputs(config.edit.given())?;
        }
        if let Some(name) = &config.edit.name {
            system_name(name).map_err(|problem| anyhow::anyhow!("edit.name: {problem}"))?;
        }
        Ok(Self {
            config,
            compose,
            train,
            coordinator,
            poses,
            encoder,
            title: "stance run".to_owned(),
            commands: Vec::new(),
        })
    }

    pub(super) fn at(&self, name: &str) -> PathBuf {
        self.config.out.join(name)
    }

    /// Run folder of the encoder that evaluates, or the name of the built-in one.
    pub(super) fn encoder_run(&self) -> PathBuf {
        match self.config.encoder.is_builtin() {
            true => BUILTIN.into(),
            false => self.at("runs/tmr"),
        }
    }
}

/// The settings of a coordinator that guides this editor. Its window, keypoints and diffusion must be the editor's; those
/// that differ from the preset are added to its own settings.
fn guiding(
    editor: &TrainConfig,
    of_preset: &CoordinatorConfig,
    own: &Map<String, Value>,
) -> anyhow::Result<Map<String, Value>> {
    let of_editor = json!({
        "window": editor.window,
        "keypoints": editor.keypoints,
        "schedule": editor.diffusion.schedule,
        "diffusion_steps": editor.diffusion.num_steps,
    });
    let of_preset = json!({
        "window": of_preset.window,
        "keypoints": of_preset.keypoints,
        "schedule": of_preset.schedule,
        "diffusion_steps": of_preset.diffusion_steps,
    });
    let mut all = own.clone();
    for key in ["window", "keypoints", "schedule", "diffusion_steps"] {
        let of_editor = &of_editor[key];
        match own.get(key) {
            Some(given) if given != of_editor => bail!(
                "coordinator.{key} is {given}, and the editor that it guides has {of_editor}; leave it out"
            ),
            None if *of_editor != of_preset[key] => {
                all.insert(key.to_owned(), of_editor.clone());
            }
            _ => {}
        }
    }
    Ok(all)
}

impl Model {
    fn over<T: Serialize + DeserializeOwned>(
        preset: &T,
        section: &str,
        own: &Map<String, Value>,
        seeds: Seeds,
        global: &Global,
    ) -> anyhow::Result<Self> {
        let mut all = serde_json::to_value(settings::over(preset, section, own)?)?;
        let resolved = all["seed"].as_u64().unwrap_or_default();
        let seed = seeds.of_model(resolved, own, global).0;
        all["seed"] = seed.into();
        let own = Value::Object(own.clone());
        Ok(Self { own, all, seed })
    }
}

/// Results of the trainings.
pub(super) struct Trained {
    /// Report on the editor.
    pub(super) editor: Value,
    /// Report on the encoder; none if the built-in one evaluates.
    pub(super) encoder: Option<Value>,
    /// Whether there is a coordinator.
    pub(super) is_guided: bool,
    /// Whether there is an editor trained only on captured pairs.
    pub(super) is_captured_alone: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_coordinator_sees_the_windows_and_the_noise_of_its_editor() {
        let preset = Preset::Tiny;
        let of_preset = CoordinatorConfig::preset(preset);
        let mut editor = TrainConfig::preset(preset);
        let of = |editor: &TrainConfig, own: Value| {
            let own = own.as_object().cloned().unwrap_or_default();
            guiding(editor, &of_preset, &own)
                .map(Value::Object)
                .map_err(|error| error.to_string())
        };
        assert_eq!(of(&editor, json!({})), Ok(json!({})));
        editor.window = 20;
        editor.diffusion.num_steps = 50;
        let added = json!({ "window": 20, "diffusion_steps": 50 });
        assert_eq!(of(&editor, json!({})), Ok(added.clone()));
        assert_eq!(of(&editor, added.clone()), Ok(added));
        let refused = of(&editor, json!({ "window": 16 })).expect_err("another window");
        assert!(refused.contains("coordinator.window is 16"), "{refused}");
    }
}
