//! Batches of captioned motions for the evaluation encoder.

use std::ops::Range;

use datasets_spec::Seed;
use rand::RngExt;
use rand::seq::SliceRandom;
use rayon::prelude::*;

use super::config::TmrConfig;
use crate::Error;
use crate::captioned::{CaptionedClip, Crop};
use crate::features::{FeatureRecipe, FeatureStats, Prepared};
use crate::sample::noise::normal;
use crate::vocabulary::{TokenBatch, Vocabulary};

pub(super) struct Clip {
    pub(super) motion: Prepared,
    captions: Vec<Vec<i32>>,
}

pub(super) struct ClipBatch {
    pub(super) features: Vec<f32>,
    pub(super) lengths: Vec<usize>,
    pub(super) steps: usize,
    pub(super) tokens: TokenBatch,
    /// Whether the captions of two different rows are equal, `[B * B]`.
    pub(super) same_text: Vec<bool>,
    /// Standard normal noise for the text and the motion latents, `[2, B, d]`.
    pub(super) noise: Vec<f32>,
}

pub(super) fn clips(
    motions: &[CaptionedClip],
    what: &'static str,
    vocabulary: &Vocabulary,
    config: &TmrConfig,
) -> Result<Vec<Clip>, Error> {
    Error::if_empty(motions, what)?;
    motions
        .par_iter()
        .map(|clip| {
            if clip.captions.is_empty() {
                return Err(Error::item(&clip.id, "has no caption"));
            }
            let (recipe, stride) = (config.features, config.frame_stride);
            let captions = clip.captions.iter();
            Ok(Clip {
                motion: Prepared::new(&clip.motion, recipe, stride, &clip.id)?,
                captions: captions.map(|caption| vocabulary.encode(caption)).collect(),
            })
        })
        .collect()
}

pub(super) fn fit_features(recipe: FeatureRecipe, clips: &[Clip]) -> Result<FeatureStats, Error> {
    let rows: Vec<_> = clips
        .par_iter()
        .map(|clip| clip.motion.features(0..clip.motion.len()))
        .collect();
    let width = recipe.width();
    FeatureStats::fit(
        recipe,
        rows.iter().flat_map(|rows| rows.chunks_exact(width)),
    )
}

/// Samples batches of clips; a batch depends only on the seed and the step.
#[derive(Clone, Copy)]
pub(super) struct ClipSampler<'a> {
    pub(super) clips: &'a [Clip],
    pub(super) features: &'a FeatureStats,
    pub(super) config: &'a TmrConfig,
    pub(super) seed: Seed,
}

impl ClipSampler<'_> {
    /// The batch of a step: the next clips in the epoch's order, with one caption and one crop each. All crops of a
    /// step have the same drawn maximum length, which keeps padding small.
    pub(super) fn draw(&self, step: u64) -> ClipBatch {
        let batch_size = self.config.run.batch_size.min(self.clips.len());
        let num_batches = (self.clips.len() / batch_size) as u64;
        let (epoch, batch) = (step / num_batches, step % num_batches);
        let mut order: Vec<usize> = (0..self.clips.len()).collect();
        order.shuffle(&mut self.seed.rng(&["epoch", &epoch.to_string()]));
        let first = batch as usize * batch_size;

        let mut rng = self.seed.rng(&["step", &step.to_string()]);
        let longest = rng.random_range(self.config.min_frames..=self.config.max_frames);
        let crops: Vec<Crop> = order[first..first + batch_size]
            .iter()
            .map(|&clip| {
                let num_frames = self.clips[clip].motion.len();
                let frames = longest.min(num_frames);
                Crop {
                    clip,
                    caption: rng.random_range(0..self.clips[clip].captions.len()),
                    start: rng.random_range(0..=num_frames - frames),
                    frames,
                }
            })
            .collect();
        let noise = normal(&mut rng, 2 * crops.len() * self.config.model.width);
        self.batch(&crops, noise)
    }

    /// The validation batches: all clips from their first frame, with their first caption and without noise on the
    /// latents.
    pub(super) fn whole(&self) -> Vec<ClipBatch> {
        let frames = self.clips.iter().map(|clip| clip.motion.len());
        let crops = Crop::firsts(frames, self.config.max_frames);
        crops
            .chunks(self.config.run.batch_size)
            .map(|crops| {
                let noise = vec![0.0; 2 * crops.len() * self.config.model.width];
                self.batch(crops, noise)
            })
            .collect()
    }

    fn batch(&self, crops: &[Crop], noise: Vec<f32>) -> ClipBatch {
        let texts: Vec<&[i32]> = crops
            .iter()
            .map(|crop| self.clips[crop.clip].captions[crop.caption].as_slice())
            .collect();
        let same_text = (0..texts.len())
            .flat_map(|i| {
                let texts = &texts;
                (0..texts.len()).map(move |j| i != j && texts[i] == texts[j])
            })
            .collect();
        let segments: Vec<(&Prepared, Range<usize>)> = crops
            .iter()
            .map(|crop| (&self.clips[crop.clip].motion, crop.range()))
            .collect();
        let (features, lengths, steps) = feature_rows(&segments, self.features);
        ClipBatch {
            features,
            lengths,
            steps,
            tokens: TokenBatch::of(&texts),
            same_text,
            noise,
        }
    }
}

/// Normalised features of segments, padded with zeros to the longest: values `[B, T, F]`, lengths and
/// `T`.
pub(super) fn feature_rows(
    segments: &[(&Prepared, Range<usize>)],
    stats: &FeatureStats,
) -> (Vec<f32>, Vec<usize>, usize) {
    let lengths: Vec<usize> = segments.iter().map(|(_, range)| range.len()).collect();
    let steps = lengths.iter().copied().max().unwrap_or(0);
    let width = stats.recipe.width();
    let mut values = Vec::with_capacity(segments.len() * steps * width);
    for (row, (clip, range)) in segments.iter().enumerate() {
        stats.push_normalized(&clip.features(range.clone()), &mut values);
        values.resize((row + 1) * steps * width, 0.0);
    }
    (values, lengths, steps)
}
