//! The frozen encoder that ships with the program. `eval/judge/builtin/README.md` says how it was trained.

use std::path::Path;

use anyhow::Context;
use datasets_spec::Skeleton;
use eval::judge::JudgeReport;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use train::checkpoint::check_skeleton_of;
use train::tmr::TmrEncoder;

use crate::device::device;

/// Name of the built-in encoder, used instead of a run folder.
pub(crate) const BUILTIN: &str = "builtin";

const CONFIG: &str = include_str!("../eval/judge/builtin/config.json");
const WEIGHTS: &[u8] = include_bytes!("../eval/judge/builtin/tmr.safetensors");
const REPORT: &str = include_str!("../eval/judge/builtin/report.json");

/// Value of the key `encoder` of a run's configuration: the encoder that evaluates.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(
    untagged,
    expecting = "encoder is \"builtin\", or a section [encoder] with settings of one to train"
)]
pub(crate) enum EncoderConfig {
    /// The encoder that ships with the program.
    Named(Builtin),
    /// An encoder to train, with values that override the preset's.
    Trained(Map<String, Value>),
}

/// The name of the encoder that ships with the program.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Builtin {
    /// The built-in encoder, as with `--encoder builtin`.
    Builtin,
}

impl Default for EncoderConfig {
    fn default() -> Self {
        Self::Trained(Map::new())
    }
}

impl EncoderConfig {
    /// The encoder that ships with the program.
    pub(crate) const BUILTIN: Self = Self::Named(Builtin::Builtin);

    pub(crate) fn is_builtin(&self) -> bool {
        matches!(self, Self::Named(_))
    }

    pub(crate) fn settings(&self) -> Map<String, Value> {
        match self {
            Self::Named(_) => Map::new(),
            Self::Trained(settings) => settings.clone(),
        }
    }
}

/// Whether a path names the built-in encoder. A folder of that name in the working folder is `./builtin`.
pub(crate) fn is_builtin(run: &Path) -> bool {
    run == Path::new(BUILTIN)
}

pub(crate) fn load() -> anyhow::Result<TmrEncoder> {
    let name = Path::new(BUILTIN);
    Ok(TmrEncoder::from_bytes(CONFIG, WEIGHTS, name, &device())?)
}

/// Fails if the skeleton of the motions differs from the built-in encoder's.
pub(crate) fn check_skeleton(skeleton: &Skeleton) -> anyhow::Result<()> {
    let name = Path::new(BUILTIN);
    Ok(check_skeleton_of(CONFIG, name, "the encoder", skeleton)?)
}

pub(crate) fn report() -> anyhow::Result<JudgeReport> {
    serde_json::from_str(REPORT).context("the report of the built-in encoder")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Hash of the shipped weights. Scores with another hash are not comparable.
    const HASH: &str = "ff01422b20e7082a2e01c4f4f263b5f887fe4ae076d10ea26492674c435de3ab";

    #[test]
    fn the_shipped_encoder_is_the_one_of_its_report_and_ranks() {
        let encoder = load().expect("shipped");
        assert_eq!(encoder.hash(), HASH);
        let report = report().expect("shipped");
        assert_eq!(report.encoder_hash, HASH);
        assert_eq!(report.weakness(), None);
        assert_eq!(report.gallery, 32);
        for side in [report.text_to_motion, report.motion_to_text] {
            assert!(side.r3.lower > 90.0, "{side:?}");
        }
        let card = include_str!("../eval/judge/builtin/README.md");
        for hash in [HASH, &report.dataset_hash, encoder.dataset_hash()] {
            assert!(card.contains(hash), "the card lacks {hash}");
        }
    }
}
