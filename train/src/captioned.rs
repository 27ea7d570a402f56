//! Crops of captioned motions, for training text-to-motion models and encoders.

use std::ops::Range;

use burn::tensor::{Device, Tensor};
use datasets_spec::{Fps, Motion, Resample, Seed, Skeleton};
use features::humanml3d::{Features, GROUPS, features_of_joints, joints_of_motion};
use features::{Statistics, smpl_body};
use rand::RngExt;
use rand::seq::SliceRandom;
use rayon::prelude::*;

use crate::Error;
use crate::data::spread_timestep;
use crate::error::motion_error;
use crate::features::{FeatureRecipe, FeatureStats};
use crate::text::table::EmbeddingTable;
use crate::transfer::send;

/// A clip with its captions.
#[derive(Clone, Debug)]
pub struct CaptionedClip {
    /// Id of the clip, for errors.
    pub id: String,
    /// The motion.
    pub motion: Motion,
    /// At least one caption.
    pub captions: Vec<String>,
}

/// Training data of a model of motions and texts.
#[derive(Clone, Copy)]
pub struct CaptionedCorpus<'a> {
    /// Training clips.
    pub train: &'a [CaptionedClip],
    /// Validation clips.
    pub val: &'a [CaptionedClip],
    /// Vectors of all captions and of the empty text, from a frozen encoder.
    pub vectors: Option<&'a EmbeddingTable>,
    /// The skeleton the motions drive.
    pub skeleton: &'a Skeleton,
    /// Hash of the table of motions.
    pub dataset_hash: &'a str,
}

impl CaptionedCorpus<'_> {
    pub(crate) fn captions(&self) -> impl Iterator<Item = &str> {
        let captions = self.train.iter().flat_map(|clip| &clip.captions);
        captions.map(String::as_str)
    }
}

pub(crate) struct CaptionedRows {
    rows: Vec<Features>,
    captions: Vec<String>,
}

/// The features of all clips with at least `min_frames` feature rows, on HumanML3D's body with the bone lengths of
/// `skeleton`.
pub(crate) fn captioned_rows(
    clips: &[CaptionedClip],
    skeleton: &Skeleton,
    min_frames: usize,
    what: &'static str,
) -> Result<Vec<CaptionedRows>, Error> {
    let body = smpl_body(skeleton);
    let rows: Vec<Option<CaptionedRows>> = clips
        .par_iter()
        .map(|clip| {
            if clip.captions.is_empty() {
                return Err(Error::item(&clip.id, "has no caption"));
            }
            let motion = Resample::Exact
                .apply(&clip.motion, Fps::STORE)
                .map_err(motion_error(&clip.id))?;
            // Velocities use the next frame, so there is one row less than frames.
            if motion.len() <= min_frames {
                return Ok(None);
            }
            let rows = features_of_joints(&joints_of_motion(&motion, &body));
            let rows = rows.map_err(|error| {
                Error::item(&clip.id, format!("has no HumanML3D features: {error}"))
            })?;
            Ok(Some(CaptionedRows {
                rows,
                captions: clip.captions.clone(),
            }))
        })
        .collect::<Result<_, Error>>()?;
    let rows: Vec<CaptionedRows> = rows.into_iter().flatten().collect();
    Error::if_empty(&rows, what)?;
    Ok(rows)
}

/// Mean and standard deviation of the features. As in HumanML3D, standard deviations are averaged within each group of
/// features.
pub(crate) fn grouped_stats(clips: &[CaptionedRows]) -> FeatureStats {
    /// Lower bound of a standard deviation, so that features that are constant in the training split are not amplified.
    const LEAST_STD: f32 = 1e-3;
    let mut statistics = Statistics::default();
    for clip in clips {
        statistics.take(&clip.rows);
    }
    FeatureStats {
        recipe: FeatureRecipe::HumanMl3d,
        mean: statistics.mean().to_vec(),
        std: statistics
            .std_by(&GROUPS)
            .iter()
            .map(|std| std.max(LEAST_STD))
            .collect(),
    }
}

/// Normalised crops of clips with one caption each; rows after a crop's length are zero.
#[derive(Clone, Debug)]
pub(crate) struct Crops<'a> {
    /// `[B, T, 263]`
    pub(crate) features: Vec<f32>,
    /// `[B]`
    pub(crate) lengths: Vec<usize>,
    /// `T`
    pub(crate) frames: usize,
    /// `[B]`
    pub(crate) captions: Vec<&'a str>,
}

impl Crops<'_> {
    /// The features on a device, `[B, T, 263]`.
    pub(crate) fn tensor(&self, device: &Device) -> Tensor<3> {
        let rows = self.lengths.len();
        let width = self.features.len() / (rows * self.frames);
        let shape = [rows, self.frames, width];
        send(self.features.clone(), shape, device)
    }

    /// 1 for the frames that are not padding, 0 for the others, `[B, T, 1]`.
    pub(crate) fn valid(&self, device: &Device) -> Tensor<3> {
        let frames = self.frames;
        let valid = self.lengths.iter().flat_map(|&length| {
            (0..frames).map(move |frame| if frame < length { 1.0f32 } else { 0.0 })
        });
        let shape = [self.lengths.len(), frames, 1];
        send(valid.collect(), shape, device)
    }
}

/// Samples crops of clips. The draws for a sample depend only on the seed and the sample's index in the run.
#[derive(Clone, Copy)]
pub(crate) struct CropSampler<'a> {
    pub(crate) clips: &'a [CaptionedRows],
    pub(crate) stats: &'a FeatureStats,
    pub(crate) max_frames: usize,
    /// Whether crops are padded to the longest possible crop instead of the longest of the batch.
    pub(crate) pads_to_max: bool,
    pub(crate) seed: Seed,
}

/// The lengths of random crops are multiples of this number of frames.
const CROP_UNIT: usize = 4;

impl<'a> CropSampler<'a> {
    /// The samples `first..first + count` of the run; the numbering continues across epochs.
    ///
    /// A crop is as long as its clip, at most `max_frames`, rounded down to a multiple of four frames. In a third of
    /// the cases it is four frames shorter.
    ///
    /// # Source
    /// `Text2MotionDatasetV2` of HumanML3D, which MDM and MLD use.
    pub(crate) fn draw(&self, first: u64, count: usize) -> Crops<'a> {
        let num_clips = self.clips.len() as u64;
        let mut epoch_order: Option<(u64, Vec<usize>)> = None;
        let crops: Vec<Crop> = (first..first + count as u64)
            .map(|sample| {
                let (epoch, place) = (sample / num_clips, sample % num_clips);
                let order = match &epoch_order {
                    Some((known, order)) if *known == epoch => order,
                    _ => {
                        let mut order: Vec<usize> = (0..self.clips.len()).collect();
                        order.shuffle(&mut self.seed.rng(&["epoch", &epoch.to_string()]));
                        &epoch_order.insert((epoch, order)).1
                    }
                };
                let clip = order[place as usize];
                let mut rng = self.seed.rng(&["crop", &sample.to_string()]);
                let num_frames = self.clips[clip].rows.len();
                let whole = num_frames.min(self.max_frames) / CROP_UNIT * CROP_UNIT;
                let frames = if rng.random_range(0..3) == 0 && whole > CROP_UNIT {
                    whole - CROP_UNIT
                } else {
                    whole.max(1)
                };
                Crop {
                    clip,
                    caption: rng.random_range(0..self.clips[clip].captions.len()),
                    start: rng.random_range(0..=num_frames - frames),
                    frames,
                }
            })
            .collect();
        self.crops(&crops)
    }

    /// All clips in batches of `size`, each cut to its first `max_frames` frames, with its first caption.
    pub(crate) fn whole(&self, size: usize) -> Vec<Crops<'a>> {
        let frames = self.clips.iter().map(|clip| clip.rows.len());
        let crops = Crop::firsts(frames, self.max_frames);
        crops.chunks(size).map(|crops| self.crops(crops)).collect()
    }

    /// The batches of [`CropSampler::whole`], each with the index of its first clip and a diffusion step for each clip.
    /// The steps are spread evenly over the schedule, so that validations are comparable.
    pub(crate) fn validation(
        &self,
        size: usize,
        num_steps: usize,
    ) -> impl Iterator<Item = (u64, Vec<usize>, Crops<'a>)> {
        let (mut first, total) = (0, self.clips.len());
        self.whole(size).into_iter().map(move |crops| {
            let places = first..first + crops.lengths.len();
            first = places.end;
            let timesteps = places
                .clone()
                .map(|place| spread_timestep(place, total, num_steps));
            (places.start as u64, timesteps.collect(), crops)
        })
    }

    fn crops(&self, crops: &[Crop]) -> Crops<'a> {
        let lengths: Vec<usize> = crops.iter().map(|crop| crop.frames).collect();
        let frames = if self.pads_to_max {
            self.max_frames
        } else {
            lengths.iter().copied().max().unwrap_or(0)
        };
        let width = self.stats.recipe.width();
        let mut features = Vec::with_capacity(crops.len() * frames * width);
        for (row, crop) in crops.iter().enumerate() {
            let rows = &self.clips[crop.clip].rows[crop.range()];
            self.stats
                .push_normalized(rows.as_flattened(), &mut features);
            features.resize((row + 1) * frames * width, 0.0);
        }
        let clips = self.clips;
        Crops {
            features,
            lengths,
            frames,
            captions: crops
                .iter()
                .map(|crop| clips[crop.clip].captions[crop.caption].as_str())
                .collect(),
        }
    }
}

#[derive(Clone, Copy)]
pub(crate) struct Crop {
    pub(crate) clip: usize,
    pub(crate) caption: usize,
    pub(crate) start: usize,
    pub(crate) frames: usize,
}

impl Crop {
    /// A crop of each clip from its first frame, of at most `longest` frames, with the first caption. `frames` gives
    /// the lengths of the clips.
    pub(crate) fn firsts(frames: impl Iterator<Item = usize>, longest: usize) -> Vec<Self> {
        let crop = |(clip, frames): (usize, usize)| Self {
            clip,
            caption: 0,
            start: 0,
            frames: frames.min(longest),
        };
        frames.enumerate().map(crop).collect()
    }

    pub(crate) fn range(&self) -> Range<usize> {
        self.start..self.start + self.frames
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn clips() -> Vec<CaptionedRows> {
        [9, 14, 30]
            .into_iter()
            .enumerate()
            .map(|(clip, frames)| CaptionedRows {
                rows: (0..frames)
                    .map(|frame| [(100 * clip + frame) as f32; 263])
                    .collect(),
                captions: vec![format!("clip {clip}")],
            })
            .collect()
    }

    #[test]
    fn crops_do_not_depend_on_their_batch_and_lie_within_their_clips() {
        let clips = clips();
        let stats = FeatureStats {
            recipe: FeatureRecipe::HumanMl3d,
            mean: vec![0.0; 263],
            std: vec![1.0; 263],
        };
        let sampler = CropSampler {
            clips: &clips,
            stats: &stats,
            max_frames: 20,
            pads_to_max: true,
            seed: Seed(1),
        };
        let all = sampler.draw(0, 12);
        let part = sampler.draw(5, 3);
        let row = 20 * 263;
        assert_eq!(part.features, all.features[5 * row..8 * row]);
        assert_eq!(part.captions, all.captions[5..8]);
        // An epoch has every clip once.
        let mut seen: Vec<&str> = all.captions[..3].to_vec();
        seen.sort_unstable();
        assert_eq!(seen, ["clip 0", "clip 1", "clip 2"]);
        for (index, &length) in all.lengths.iter().enumerate() {
            assert!(length % CROP_UNIT == 0 && (4..=20).contains(&length));
            let rows = &all.features[index * row..][..row];
            let first = rows[0];
            for (frame, values) in rows.chunks_exact(263).enumerate() {
                let expected = if frame < length {
                    first + frame as f32
                } else {
                    0.0
                };
                assert_eq!(values[0], expected);
            }
        }
        let whole = sampler.whole(2);
        assert_eq!(whole[0].lengths, [9, 14]);
        assert_eq!(whole[1].lengths, [20]);
    }
}
