//! Settings of the composer.

use std::str::FromStr;

use datasets_spec::Fps;
use kinematics::canonical::{Anchor, FIXED_FRAMES, WINDOW_ADVANCE, WINDOW_FRAMES};
use rand::RngExt;
use serde::{Deserialize, Serialize};

use super::{Error, Phrases};

/// Version of the composition rules. It changes whenever the same settings, seed and library would
/// give other motions, and is part of every recipe hash.
pub const COMPOSE_VERSION: u32 = 3;

/// How edits are composed. The default is the published method.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ComposeConfig {
    /// Share of the motion base that partners are drawn from. A smaller share selects a subset of a larger one.
    ///
    /// Source: the MotionCutMix ratio of the paper's ablation.
    pub mcm_ratio: f64,
    /// Share of the masks that are used. A smaller share selects a subset of a larger one.
    ///
    /// Source: the annotated data size of the paper's ablation.
    pub annotated_ratio: f64,
    /// Whether each mask and pair is composed once, with one fixed partner instead of a new one for each item. Partners
    /// are then composed by the rule of SINC: whole parts without soft joints, from the middle of the longer motion.
    ///
    /// Source: the rows "w/o MCM" of Tables 1 and A1.
    pub fixed_pairs: bool,
    /// Motions from which partners are drawn.
    #[serde(skip_serializing_if = "BaseFilter::is_all")]
    pub base: BaseFilter,
    /// Kinds of edits that are composed, if there is data for them.
    pub kinds: Vec<EditKind>,
    /// Probability that a pair is used as it was captured, without a donor under both of its motions. If not set, pairs
    /// of MotionFix never have a donor and all others always have one.
    ///
    /// Source: the paper trains on MotionFix without MotionCutMix (Sec. 6.1); the release's README trains on blended
    /// motions alone for style and fine-grained pairs.
    // Named `plain_pairs` in records of earlier versions.
    #[serde(alias = "plain_pairs", skip_serializing_if = "Option::is_none")]
    pub undonored_ratio: Option<f64>,
    /// Probability that a training window is mirrored, with left and right exchanged in its instruction. Whole clips
    /// (recorded triplets, items, TMED) cannot be mirrored: a probability above 0 is then an error.
    #[serde(skip_serializing_if = "is_zero")]
    pub mirrored_ratio: f64,
    /// Time alignment of the two motions of a pair.
    pub alignment: Alignment,
    /// How soft joints are interpolated.
    pub slerp: SlerpRule,
    /// How the normaliser is fitted.
    pub range: RangeRule,
    /// How instructions are worded.
    pub phrases: Phrases,
    /// Frames of a window at the model's rate, the two fixed ones included.
    pub window: usize,
    /// Rate of the model in frames per second. The stored rate must be a whole multiple of it.
    pub fps: Fps,
    /// Weight of the target on soft joints.
    pub alpha: AlphaDistribution,
    /// Point of a window's first frame that is placed above the origin.
    pub anchor: Anchor,
}

impl Default for ComposeConfig {
    fn default() -> Self {
        Self {
            mcm_ratio: 1.0,
            annotated_ratio: 1.0,
            fixed_pairs: false,
            base: BaseFilter::default(),
            kinds: EditKind::ALL.to_vec(),
            undonored_ratio: None,
            mirrored_ratio: 0.0,
            alignment: Alignment::None,
            slerp: SlerpRule::Exact,
            range: RangeRule::PerAxis,
            phrases: Phrases::default(),
            window: WINDOW_FRAMES,
            fps: Fps::MODEL,
            alpha: AlphaDistribution::Uniform {
                low: 0.0,
                high: 1.0,
            },
            anchor: Anchor::Pelvis,
        }
    }
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// Motions of a split that form the motion base; all by default. The default is left out of the recipe, so
/// that its hash equals that of older versions.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BaseFilter {
    /// Kinds of source, such as `humanml3d` (column `source` of motions); all if empty.
    pub sources: Vec<String>,
}

impl BaseFilter {
    /// Whether every motion may be drawn as a partner.
    pub fn is_all(&self) -> bool {
        self.sources.is_empty()
    }

    /// Whether motions of this kind of source may be drawn as partners.
    pub(super) fn takes(&self, source: &str) -> bool {
        self.is_all() || self.sources.iter().any(|name| name == source)
    }
}

datasets_spec::named! {
    /// Kind of an edit. The order is that of the paper's tables.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum EditKind, named by as_str {
        /// A body part does something else. The release calls it `regen`.
        Semantic = "semantic",
        /// A body part moves in another style. The release calls it `style_transfer`.
        Style = "style",
        /// A body part moves a little differently. The release calls it `adjustment`.
        FineGrained = "fine-grained",
    }
}

datasets_spec::named! {
    /// Task of a test question. The order is that of the paper's tables.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum ItemTask, named by as_str {
        /// A body part does something else.
        Semantic = "semantic",
        /// A body part moves in another style.
        Style = "style",
        /// A body part moves a little differently.
        FineGrained = "fine-grained",
        /// A pair of MotionFix: no donor, no blending, source and target of any length.
        #[serde(rename = "motionfix")]
        MotionFix = "motionfix",
    }
}

impl ItemTask {
    /// The command that brings masks or pairs of the task into a dataset.
    pub(crate) fn made_by(self) -> &'static str {
        match self {
            Self::Semantic => "`stance masks DATASET` makes masks",
            Self::Style => "`stance pairs DATASET` makes pairs from labels",
            Self::FineGrained => "`stance pairs DATASET --csv LIST` adds pairs of a list",
            Self::MotionFix => "`stance ingest` reads pairs from a dump of MotionFix",
        }
    }
}

impl FromStr for ItemTask {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        Self::of_name(name).ok_or_else(|| {
            let known = Self::ALL.map(Self::as_str).join(", ");
            format!("{name:?} is no task; known are {known}")
        })
    }
}

datasets_spec::named! {
    /// Time alignment of two separately captured motions of a pair.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum Alignment, named by as_str {
        /// None: the longer motion is cropped to the length of the shorter.
        #[default]
        None = "none",
        /// The original is time-warped, so that its poses come at the times of similar poses of the edited motion.
        TimeWarp = "time-warp",
    }
}

/// How two rotations are interpolated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SlerpRule {
    /// Spherical interpolation.
    #[default]
    Exact,
    /// The released code's interpolation, which averages nearly equal and nearly opposite rotations with equal weights.
    Official,
}

/// How the normaliser is fitted to the central 95 % of the training windows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RangeRule {
    /// Each axis has its own range (`paper`).
    #[default]
    PerAxis,
    /// All axes share one range, as in the released normalisation files.
    Scalar,
}

/// Distribution of the weight of soft joints, drawn once per composed motion (paper Sec. 4.2: "randomly
/// varied"; the distribution is not published).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum AlphaDistribution {
    /// Uniform over a range.
    Uniform {
        /// Lower end.
        low: f64,
        /// Upper end.
        high: f64,
    },
}

impl AlphaDistribution {
    /// Draws a weight. It is rounded to the `f32` it is recorded as, so that a recorded triplet can
    /// be composed again to the last bit.
    pub(super) fn draw(self, rng: &mut datasets_spec::Rng) -> f64 {
        let Self::Uniform { low, high } = self;
        f64::from((low + (high - low) * rng.random::<f64>()) as f32)
    }
}

impl ComposeConfig {
    /// Probability that a pair has no donor.
    pub(super) fn undonored_ratio_of(&self, is_motionfix: bool) -> f64 {
        let by_kind = if is_motionfix { 1.0 } else { 0.0 };
        self.undonored_ratio.unwrap_or(by_kind)
    }

    /// Checks the settings.
    ///
    /// # Errors
    /// A setting is out of range.
    pub fn check(&self) -> Result<(), Error> {
        // A value, whether it fits, and what is expected.
        let share = |got: f64| (got, got > 0.0 && got <= 1.0, "above 0 and at most 1");
        let probability = |got: f64| (got, (0.0..=1.0).contains(&got), "from 0 to 1");
        let within = |got: f64, low: f64| {
            let expected = "between 0 and 1, low not above high";
            (got, (low..=1.0).contains(&got), expected)
        };
        let kinds = "at least one of semantic, style, fine-grained";
        let is_long = self.window > FIXED_FRAMES;
        let window = (
            self.window as f64,
            is_long,
            "more than the two fixed frames",
        );
        let undonored = self.undonored_ratio.unwrap_or(0.0);
        let AlphaDistribution::Uniform { low, high } = self.alpha;
        for (key, (got, fits, expected)) in [
            ("mcm_ratio", share(self.mcm_ratio)),
            ("annotated_ratio", share(self.annotated_ratio)),
            ("undonored_ratio", probability(undonored)),
            ("mirrored_ratio", probability(self.mirrored_ratio)),
            ("kinds", (0.0, !self.kinds.is_empty(), kinds)),
            ("window", window),
            ("alpha.low", within(low, 0.0)),
            ("alpha.high", within(high, low)),
        ] {
            if !fits {
                return Err(Error::Config { key, expected, got });
            }
        }
        self.phrases.check()
    }

    /// Stored frames per frame of the model.
    ///
    /// # Errors
    /// The stored rate is no whole multiple of the model's.
    pub fn stride(&self, stored: Fps) -> Result<usize, Error> {
        let ratio = stored.get() / self.fps.get();
        // Rates are integers or exact quotients of them; the tolerance is for rounding.
        if ratio >= 1.0 - 1e-9 && (ratio - ratio.round()).abs() < 1e-9 * ratio {
            Ok(ratio.round() as usize)
        } else {
            Err(Error::Refused(format!(
                "motions at {stored} cannot be thinned out to {}; ingest at a whole multiple of it",
                self.fps
            )))
        }
    }

    pub(super) fn span(&self, stride: usize) -> usize {
        (self.window - 1) * stride + 1
    }

    /// Stored frames from one window of a motion to the next.
    pub(super) fn advance(&self, stride: usize) -> usize {
        // A window repeats the two fixed frames of the one before, so 14 of 16 are new.
        const { assert!(WINDOW_FRAMES - FIXED_FRAMES == WINDOW_ADVANCE) };
        (self.window - FIXED_FRAMES) * stride
    }

    /// The settings that the normaliser depends on, in words.
    pub fn range_settings(&self) -> String {
        format!(
            "{} frames at {} fps, anchor {:?}, range {:?}",
            self.window,
            self.fps.get(),
            self.anchor,
            self.range
        )
        .to_lowercase()
    }

    /// BLAKE3 of the settings and [`COMPOSE_VERSION`], in hexadecimal. With the library and the seed, it
    /// determines every composed motion.
    pub fn recipe_hash(&self) -> String {
        let settings = serde_json::to_vec(self).expect("plain numbers and names serialise");
        let mut hasher = blake3::Hasher::new();
        hasher.update(&COMPOSE_VERSION.to_le_bytes());
        hasher.update(&settings);
        hasher.finalize().to_hex().to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_out_of_range_are_named() {
        let check = |change: fn(&mut ComposeConfig)| {
            let mut config = ComposeConfig::default();
            change(&mut config);
            match config.check() {
                Err(Error::Config { key, .. }) => key,
                other => panic!("expected a refused setting, got {other:?}"),
            }
        };
        assert!(ComposeConfig::default().check().is_ok());
        assert_eq!(check(|c| c.mcm_ratio = 0.0), "mcm_ratio");
        assert_eq!(check(|c| c.annotated_ratio = f64::NAN), "annotated_ratio");
        assert_eq!(check(|c| c.window = 2), "window");
        assert_eq!(check(|c| c.undonored_ratio = Some(1.5)), "undonored_ratio");
        assert_eq!(check(|c| c.mirrored_ratio = -0.1), "mirrored_ratio");
        assert_eq!(check(|c| c.kinds.clear()), "kinds");
        let backwards = |c: &mut ComposeConfig| {
            c.alpha = AlphaDistribution::Uniform {
                low: 0.8,
                high: 0.2,
            };
        };
        assert_eq!(check(backwards), "alpha.high");
    }

    #[test]
    fn a_window_spans_31_stored_frames_and_advances_28() {
        let config = ComposeConfig::default();
        let stride = config.stride(Fps::STORE).expect("a multiple");
        assert_eq!(stride, 2);
        assert_eq!((config.span(stride), config.advance(stride)), (31, 28));
        let odd = Fps::new(25.0).expect("valid");
        let error = config.stride(odd).expect_err("no multiple").to_string();
        assert!(error.contains("cannot be thinned out"), "{error}");
    }

    #[test]
    fn settings_read_back_and_refuse_what_they_do_not_know() {
        let text = serde_json::to_string(&ComposeConfig::default()).expect("serialises");
        let back: ComposeConfig = serde_json::from_str(&text).expect("its own text");
        assert_eq!(back, ComposeConfig::default());
        assert!(serde_json::from_str::<ComposeConfig>("{\"mcm\": 1}").is_err());
        let older = text.replacen('{', "{\"plain_pairs\":0.5,", 1);
        let back: ComposeConfig = serde_json::from_str(&older).expect("an earlier record");
        assert_eq!(back.undonored_ratio, Some(0.5));
    }

    #[test]
    fn every_setting_changes_the_recipe() {
        let changes: [fn(&mut ComposeConfig); 16] = [
            |c| c.mcm_ratio = 0.5,
            |c| c.annotated_ratio = 0.5,
            |c| c.fixed_pairs = true,
            |c| c.base.sources = vec!["humanml3d".to_owned()],
            |c| c.kinds = vec![EditKind::Style],
            |c| c.undonored_ratio = Some(0.5),
            |c| c.mirrored_ratio = 0.5,
            |c| c.alignment = Alignment::TimeWarp,
            |c| c.slerp = SlerpRule::Official,
            |c| c.range = RangeRule::Scalar,
            |c| c.phrases.of_parts.push("{part}: {instruction}".to_owned()),
            |c| {
                let said = ("a".to_owned(), vec!["b".to_owned()]);
                c.phrases.paraphrases.extend([said]);
            },
            |c| c.window = 20,
            |c| c.fps = Fps::STORE,
            |c| {
                c.alpha = AlphaDistribution::Uniform {
                    low: 0.5,
                    high: 1.0,
                }
            },
            |c| c.anchor = Anchor::Translation,
        ];
        let default = ComposeConfig::default();
        // Each case changes one setting. The pattern names all settings, so a new one must be added here.
        let ComposeConfig {
            mcm_ratio: _,
            annotated_ratio: _,
            fixed_pairs: _,
            base: BaseFilter { sources: _ },
            kinds: _,
            undonored_ratio: _,
            mirrored_ratio: _,
            alignment: _,
            slerp: _,
            range: _,
            phrases:
                Phrases {
                    of_parts: _,
                    paraphrases: _,
                },
            window: _,
            fps: _,
            alpha: _,
            anchor: _,
        } = &default;
        let mut hashes = vec![default.recipe_hash()];
        for change in changes {
            let mut changed = default.clone();
            change(&mut changed);
            hashes.push(changed.recipe_hash());
        }
        hashes.sort_unstable();
        hashes.dedup();
        assert_eq!(hashes.len(), 1 + changes.len(), "two recipes share a hash");
    }
}
