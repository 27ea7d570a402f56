//! Batches of whole clips, before and after an edit, for TMED's network.

use std::sync::Arc;

use compose::{Library, Stream};
use datasets_spec::{Fps, Motion, Seed, Skeleton};
use rand::RngExt;
use rand::seq::SliceRandom;
use rayon::prelude::*;

use super::config::TmedConfig;
use super::features::{FeatureFrame, FeatureStatistics, NUM_FEATURES, features_of_motion};
use crate::Error;
use crate::data::{TextBatch, Texts, Timesteps};
use crate::error::motion_error;
use crate::features::Moments;
use crate::sample::noise::normal;

/// Maximum number of clips of a split from which statistics are computed; more clips hardly change them.
const STATISTICS_CLIPS: u64 = 4_096;

/// A motion, an instruction, and the edited motion, which may have another length.
#[derive(Clone, Debug, PartialEq)]
pub struct ClipEdit {
    /// The instruction.
    pub instruction: String,
    /// The motion before the edit.
    pub source: Motion,
    /// The motion after the edit.
    pub target: Motion,
    /// The first frame that the edit changes.
    pub first_edited: usize,
}

impl ClipEdit {
    /// Removes frames before the edit, but leaves at least the last `seconds` of the clip.
    fn begin_at_edit(&mut self, seconds: f64) -> Result<(), Error> {
        let shown = (seconds * self.source.fps().get()).floor() as usize;
        let start = self
            .first_edited
            .min(self.source.len().saturating_sub(shown));
        if start > 0 {
            let from = |motion: &Motion| motion.crop(start..motion.len());
            let [source, target] = [&self.source, &self.target]
                .map(|motion| from(motion).map_err(motion_error(&self.instruction)));
            (self.source, self.target) = (source?, target?);
            self.first_edited -= start;
        }
        Ok(())
    }
}

/// Training clips. Repeated reads of a clip give equal results.
pub trait ClipSource: Sync {
    /// Number of clips in an epoch.
    fn num_clips(&self) -> u64;

    /// Reads a clip of an epoch.
    ///
    /// # Errors
    /// Its motions cannot be read.
    fn clip(&self, epoch: u64, number: u64) -> Result<ClipEdit, Error>;
}

impl ClipSource for Stream {
    fn num_clips(&self) -> u64 {
        Stream::num_clips(self)
    }

    fn clip(&self, epoch: u64, number: u64) -> Result<ClipEdit, Error> {
        let triplet = Stream::clip(self, epoch, number)?;
        Ok(ClipEdit {
            instruction: triplet.instruction,
            source: triplet.original,
            target: triplet.edited,
            first_edited: triplet.edited_frames.start,
        })
    }
}

/// The captured pairs of a split.
#[derive(Clone, Debug)]
pub struct CapturedPairs(pub Arc<Library>);

impl ClipSource for CapturedPairs {
    fn num_clips(&self) -> u64 {
        self.0.num_pairs() as u64
    }

    fn clip(&self, _epoch: u64, number: u64) -> Result<ClipEdit, Error> {
        let (instruction, [source, target]) = self.0.pair(number as usize)?;
        Ok(ClipEdit {
            instruction: instruction.to_owned(),
            source,
            target,
            first_edited: 0,
        })
    }
}

/// Mean and standard deviation of the features of the motions before and after the edit.
pub(crate) fn statistics(
    sources: &[&dyn ClipSource],
    fps: Fps,
    max_frames: usize,
    skeleton: &Skeleton,
) -> Result<FeatureStatistics, Error> {
    let mut sum = Moments::none(NUM_FEATURES);
    for source in sources {
        let count = source.num_clips();
        let taken = count.min(STATISTICS_CLIPS);
        let moments = (0..taken)
            .into_par_iter()
            .map(|place| {
                let clip = source.clip(0, place * count / taken)?;
                let of = |motion: &Motion| -> Result<Moments, Error> {
                    let features = features_of_motion(motion, fps, max_frames, skeleton);
                    let features = features.map_err(motion_error(&clip.instruction))?;
                    let rows = features.iter().map(|row| row.as_slice());
                    Ok(Moments::of(NUM_FEATURES, rows))
                };
                Ok(of(&clip.source)?.merge(&of(&clip.target)?))
            })
            .collect::<Result<Vec<_>, Error>>()?;
        sum = moments.iter().fold(sum, Moments::merge);
    }
    if sum.is_empty() {
        return Err(Error::empty("training split of TMED"));
    }
    Ok(FeatureStatistics::of(&sum))
}

/// `B` clips, with all random draws of a training step.
#[derive(Clone, Debug, PartialEq)]
pub struct ClipBatch {
    /// Normalised source motions, `[B, S, 207]`, padded with copies of the last frame.
    pub source: Vec<f32>,
    /// Number of frames in each source, `[B]`.
    pub source_frames: Vec<usize>,
    /// Whether the network sees each source, `[B]`.
    pub source_is_shown: Vec<bool>,
    /// Normalised target motions, `[B, T, 207]`, padded with copies of the last frame.
    pub target: Vec<f32>,
    /// Number of frames in each target, `[B]`.
    pub target_frames: Vec<usize>,
    /// Standard normal noise, `[B, T, 207]`.
    pub noise: Vec<f32>,
    /// Diffusion step of each clip, `[B]`.
    pub timesteps: Vec<usize>,
    /// Instructions; a hidden instruction is the empty text.
    pub texts: TextBatch,
}

impl ClipBatch {
    /// Number of clips.
    #[expect(clippy::len_without_is_empty, reason = "a batch is never empty")]
    pub fn len(&self) -> usize {
        self.timesteps.len()
    }
}

/// Draws batches of clips. The draws for a clip depend only on the seed and the clip's index in the run.
#[derive(Clone, Copy)]
pub(crate) struct ClipSampler<'a> {
    pub(crate) source: &'a dyn ClipSource,
    pub(crate) config: &'a TmedConfig,
    pub(crate) statistics: &'a FeatureStatistics,
    pub(crate) skeleton: &'a Skeleton,
    pub(crate) texts: Texts<'a>,
    pub(crate) seed: Seed,
    pub(crate) timesteps: Timesteps,
    /// Whether instructions and sources are dropped at random.
    pub(crate) hides: bool,
}

struct Drawn {
    instruction: String,
    source: Vec<FeatureFrame>,
    source_is_shown: bool,
    target: Vec<FeatureFrame>,
    noise: Vec<f32>,
    timestep: usize,
}

impl ClipSampler<'_> {
    /// The clips `first..first + count` of the run; the numbering continues across epochs.
    pub(crate) fn draw(&self, first: u64, count: usize) -> Result<ClipBatch, Error> {
        let num_clips = self.source.num_clips();
        if num_clips == 0 {
            return Err(Error::empty("source of training clips"));
        }
        let places = first..first + count as u64;
        let epochs = places.start / num_clips..=(places.end - 1) / num_clips;
        let orders: Vec<Vec<u64>> = epochs.clone().map(|epoch| self.order(epoch)).collect();
        let drawn = places
            .into_par_iter()
            .map(|place| {
                let epoch = place / num_clips;
                let order = &orders[(epoch - epochs.start()) as usize];
                self.draw_one(place, epoch, order[(place % num_clips) as usize])
            })
            .collect::<Result<Vec<Drawn>, Error>>()?;
        let texts = drawn.iter().map(|clip| clip.instruction.as_str());
        let (source, source_frames) = padded(drawn.iter().map(|clip| clip.source.as_slice()));
        let (target, target_frames) = padded(drawn.iter().map(|clip| clip.target.as_slice()));
        let frames = target.len() / (count * NUM_FEATURES);
        let mut noise = vec![0.0; target.len()];
        for (row, clip) in noise.chunks_exact_mut(frames * NUM_FEATURES).zip(&drawn) {
            row[..clip.noise.len()].copy_from_slice(&clip.noise);
        }
        Ok(ClipBatch {
            texts: self.texts.batch(texts)?,
            source,
            source_frames,
            source_is_shown: drawn.iter().map(|clip| clip.source_is_shown).collect(),
            target,
            target_frames,
            noise,
            timesteps: drawn.iter().map(|clip| clip.timestep).collect(),
        })
    }

    /// The clips of an epoch in shuffled order.
    fn order(&self, epoch: u64) -> Vec<u64> {
        let mut order: Vec<u64> = (0..self.source.num_clips()).collect();
        order.shuffle(&mut self.seed.rng(&["epoch order", &epoch.to_string()]));
        order
    }

    fn draw_one(&self, place: u64, epoch: u64, number: u64) -> Result<Drawn, Error> {
        let (config, skeleton) = (self.config, self.skeleton);
        let diffusion = &config.diffusion;
        let mut clip = self.source.clip(epoch, number)?;
        // The network sees the first frames of a clip; an edit later on would be an instruction that changes nothing.
        let seconds = config.max_frames as f64 / config.fps.get();
        clip.begin_at_edit(seconds)?;
        let features = |motion: &Motion| -> Result<Vec<FeatureFrame>, Error> {
            let features = features_of_motion(motion, config.fps, config.max_frames, skeleton);
            let mut features = features.map_err(motion_error(&clip.instruction))?;
            self.statistics.normalize(&mut features);
            Ok(features)
        };
        let (source, target) = (features(&clip.source)?, features(&clip.target)?);
        let mut rng = self.seed.rng(&["clip", &place.to_string()]);
        let timestep = self.timesteps.of(place, diffusion.num_steps, &mut rng);
        let mut hides = |share: f64| self.hides && rng.random_bool(share);
        let hides_source = hides(diffusion.source_dropout);
        let hides_text = hides(diffusion.text_dropout);
        let hides_both = hides(diffusion.both_dropout);
        let noise = normal(&mut rng, target.len() * NUM_FEATURES);
        Ok(Drawn {
            instruction: if hides_text || hides_both {
                String::new()
            } else {
                clip.instruction
            },
            source,
            source_is_shown: !(hides_source || hides_both),
            target,
            noise,
            timestep,
        })
    }
}

/// Motions of different lengths as one array `[B, T, 207]`, padded with copies of the last frames, and their lengths.
fn padded<'a>(motions: impl Iterator<Item = &'a [FeatureFrame]> + Clone) -> (Vec<f32>, Vec<usize>) {
    let lengths: Vec<usize> = motions.clone().map(<[FeatureFrame]>::len).collect();
    let longest = lengths.iter().copied().max().unwrap_or(0);
    let values = motions
        .flat_map(|motion| (0..longest).map(move |frame| motion[frame.min(motion.len() - 1)]))
        .flatten()
        .collect();
    (values, lengths)
}

#[cfg(test)]
mod tests {
    use datasets_spec::Pose;
    use glam::DVec3;

    use super::*;
    use crate::config::Preset;
    use crate::vocabulary::Vocabulary;

    /// Clips of at least 4 frames, whose source and target differ in length.
    struct Lines(u64);

    fn line(frames: u64, speed: f64) -> Motion {
        let poses: Vec<Pose> = (0..frames)
            .map(|frame| Pose {
                transl: DVec3::new(speed * frame as f64, 0.9, 0.0),
                ..Pose::REST
            })
            .collect();
        Motion::from_poses(Fps::MODEL, &poses).expect("finite")
    }

    impl ClipSource for Lines {
        fn num_clips(&self) -> u64 {
            self.0
        }

        fn clip(&self, epoch: u64, number: u64) -> Result<ClipEdit, Error> {
            Ok(ClipEdit {
                instruction: format!("walk {number}"),
                source: line(4 + number, 0.1),
                target: line(6 + number, 0.2 + 0.1 * epoch as f64),
                first_edited: 0,
            })
        }
    }

    #[test]
    fn a_late_edit_is_among_the_frames_that_the_network_sees() {
        let cropped = |first_edited: usize| {
            let mut clip = ClipEdit {
                instruction: "walk".to_owned(),
                source: line(100, 0.1),
                target: line(100, 0.2),
                first_edited,
            };
            clip.begin_at_edit(6.0).expect("frames");
            [clip.source.len(), clip.target.len(), clip.first_edited]
        };
        // Six seconds are 60 frames.
        assert_eq!(cropped(0), [100, 100, 0]);
        assert_eq!(cropped(30), [70, 70, 0]);
        assert_eq!(cropped(80), [60, 60, 40]);
    }

    fn check(act: impl Fn(ClipSampler<'_>)) {
        let source = Lines(5);
        let mut config = TmedConfig::preset(Preset::Tiny);
        config.diffusion.both_dropout = 0.5;
        let skeleton = Skeleton::smplx_neutral();
        let statistics =
            statistics(&[&source], config.fps, config.max_frames, &skeleton).expect("clips");
        let vocabulary = Vocabulary::build(["walk 0 1 2 3 4"], 1, 4).expect("valid");
        act(ClipSampler {
            source: &source,
            config: &config,
            statistics: &statistics,
            skeleton: &skeleton,
            texts: Texts::Words(&vocabulary),
            seed: Seed(3),
            timesteps: Timesteps::Random,
            hides: true,
        });
    }

    #[test]
    fn an_epoch_has_every_clip_once_and_a_batch_is_its_parts() {
        check(|sampler| {
            let mut lengths = sampler.draw(0, 5).expect("drawn").source_frames;
            lengths.sort_unstable();
            assert_eq!(lengths, [4, 5, 6, 7, 8]);
            let whole = sampler.draw(3, 4).expect("drawn");
            for row in 0..4 {
                let one = sampler.draw(3 + row as u64, 1).expect("drawn");
                assert_eq!(one.timesteps[0], whole.timesteps[row]);
                assert_eq!(one.source_is_shown[0], whole.source_is_shown[row]);
                let frames = one.target_frames[0];
                assert_eq!(frames, whole.target_frames[row]);
                let stride = whole.target.len() / 4;
                let own = |values: &[f32]| values[row * stride..][..frames * NUM_FEATURES].to_vec();
                assert_eq!(one.target, own(&whole.target));
                assert_eq!(one.noise, own(&whole.noise));
                // The last frame is repeated as padding.
                let row = &whole.target[row * stride..][..stride];
                let row: Vec<&[f32]> = row.chunks_exact(NUM_FEATURES).collect();
                assert!(row[frames..].iter().all(|frame| *frame == row[frames - 1]));
            }
        });
    }

    #[test]
    fn source_and_text_are_hidden_as_often_as_the_settings_say() {
        check(|sampler| {
            let batch = sampler.draw(0, 2_000).expect("drawn");
            let hidden = batch.source_is_shown.iter().filter(|shown| !**shown);
            let lengths = batch.texts.lengths();
            let silent = lengths.iter().filter(|&&length| length == 0);
            // The expected share is 1 - 0.95 * 0.5; the tolerance is five standard deviations.
            for found in [hidden.count(), silent.count()] {
                let share = found as f64 / batch.len() as f64;
                assert!((share - 0.525).abs() < 0.056, "{share}");
            }
            let shown = ClipSampler {
                hides: false,
                ..sampler
            };
            let batch = shown.draw(0, 50).expect("drawn");
            assert!(batch.source_is_shown.iter().all(|shown| *shown));
            assert!(batch.texts.lengths().iter().all(|&count| count == 2));
        });
    }
}
