//! The motions and masks of one split, ready to be composed.

use std::collections::BTreeMap;

use datasets_spec::canonical::{KeypointFrame, canonicalise, window_starts};
use datasets_spec::normalise::Normalizer;
use datasets_spec::record::{MaskRow, MotionRow};
use datasets_spec::{BlendMask, Fps, JointSet, Motion, MotionId, Pose, Skeleton, Split};
use rayon::prelude::*;

use super::{ComposeConfig, Error};

/// Most windows a normalisation range is fitted on. The quantiles of 13 million coordinates per
/// axis are known to about 1e-4 of the distribution; more windows would only take memory.
const MAX_RANGE_WINDOWS: usize = 10_000;

/// A motion of the base.
#[derive(Clone, Debug)]
pub(super) struct Clip {
    pub(super) id: MotionId,
    /// Number shared by all clips of one source: mirrored and cropped copies.
    pub(super) origin: usize,
    pub(super) action: Option<String>,
    pub(super) motion: Motion,
}

/// An accepted (motion, mask, text).
#[derive(Clone, Debug)]
pub(super) struct Annotation {
    pub(super) id: String,
    /// Index of the clip.
    pub(super) clip: usize,
    pub(super) mask: BlendMask,
    pub(super) instruction: String,
}

/// All motions and masks of one split: the motion base and the annotated set of MotionCutMix.
///
/// Clips and annotations are ordered by id, so nothing depends on the order of the rows it was
/// made from.
#[derive(Clone, Debug)]
pub struct Library {
    split: Split,
    fps: Fps,
    skeleton: Skeleton,
    pub(super) clips: Vec<Clip>,
    pub(super) annotations: Vec<Annotation>,
}

impl Library {
    /// Takes the rows of one split. A split without motions gives an empty library.
    ///
    /// # Errors
    /// A row is of another split, skeleton or rate, appears twice, or is not usable; or a mask
    /// belongs to a motion that is not among the rows.
    pub fn new(
        split: Split,
        motions: &[MotionRow],
        masks: &[MaskRow],
        skeleton: &Skeleton,
    ) -> Result<Self, Error> {
        let same_split = |table, id: &str, found| {
            if found == split {
                Ok(())
            } else {
                Err(Error::OtherSplit {
                    table,
                    id: id.to_owned(),
                    found,
                    expected: split,
                })
            }
        };
        let mut clips = BTreeMap::new();
        let mut fps = None;
        for row in motions {
            same_split("motions", row.id.as_str(), row.split)?;
            if row.skeleton != skeleton.name() {
                return Err(Error::OtherSkeleton {
                    motion: row.id.clone(),
                    found: row.skeleton.clone(),
                    expected: skeleton.name().to_owned(),
                });
            }
            let motion = row.motion().map_err(|source| Error::Motion {
                motion: row.id.clone(),
                source,
            })?;
            let expected = *fps.get_or_insert(motion.fps());
            if motion.fps() != expected {
                return Err(Error::OtherRate {
                    motion: row.id.clone(),
                    found: motion.fps().get(),
                    expected: expected.get(),
                });
            }
            let clip = Clip {
                id: row.id.clone(),
                origin: 0,
                action: row.action.clone(),
                motion,
            };
            if clips.insert(row.id.clone(), clip).is_some() {
                return Err(Error::Duplicate {
                    table: "motions",
                    id: row.id.as_str().to_owned(),
                });
            }
        }
        let mut clips: Vec<Clip> = clips.into_values().collect();
        let mut origins = BTreeMap::new();
        for clip in &mut clips {
            let next = origins.len();
            clip.origin = *origins
                .entry(clip.id.source_clip().to_owned())
                .or_insert(next);
        }
        let mut annotations = BTreeMap::new();
        for row in masks {
            same_split("masks", &row.id, row.split)?;
            let annotation = annotation(row, &clips)?;
            if annotations.insert(row.id.clone(), annotation).is_some() {
                return Err(Error::Duplicate {
                    table: "masks",
                    id: row.id.clone(),
                });
            }
        }
        Ok(Self {
            split,
            fps: fps.unwrap_or(Fps::STORE),
            skeleton: skeleton.clone(),
            clips,
            annotations: annotations.into_values().collect(),
        })
    }

    /// The split all motions are of.
    pub fn split(&self) -> Split {
        self.split
    }

    /// The rate all motions are stored at.
    pub fn fps(&self) -> Fps {
        self.fps
    }

    /// The skeleton all motions drive.
    pub fn skeleton(&self) -> &Skeleton {
        &self.skeleton
    }

    /// Number of motions.
    pub fn num_motions(&self) -> usize {
        self.clips.len()
    }

    /// Number of masks.
    pub fn num_masks(&self) -> usize {
        self.annotations.len()
    }

    /// Fits the range of model units to the canonical windows of the library's motions, at most
    /// 10,000 of them, evenly spaced over all.
    ///
    /// # Errors
    /// The library is not of the training split, no motion is as long as a window, or a setting is
    /// out of range.
    ///
    /// # Source
    /// Paper App. B.1.
    pub fn fit_normalizer(&self, config: &ComposeConfig) -> Result<Normalizer, Error> {
        if self.split != Split::Train {
            return Err(Error::NotTrain { split: self.split });
        }
        config.check()?;
        let stride = config.stride(self.fps)?;
        let span = config.span(stride);
        let windows: Vec<(usize, usize)> = self
            .clips
            .iter()
            .enumerate()
            .flat_map(|(clip, Clip { motion, .. })| {
                window_starts(motion.len(), span, config.advance(stride))
                    .into_iter()
                    .map(move |start| (clip, start))
            })
            .collect();
        let num_used = windows.len().min(MAX_RANGE_WINDOWS);
        let frames: Vec<KeypointFrame> = (0..num_used)
            .into_par_iter()
            .flat_map_iter(|used| {
                let (clip, start) = windows[used * windows.len() / num_used];
                let motion = &self.clips[clip].motion;
                let mut window: Vec<Pose> = (start..start + span)
                    .step_by(stride)
                    .map(|frame| motion.pose(frame))
                    .collect();
                canonicalise(&mut window, config.anchor, &self.skeleton);
                window
                    .into_iter()
                    .map(|pose| self.skeleton.keypoints(&pose))
                    .collect::<Vec<_>>()
            })
            .collect();
        Normalizer::fit(&frames).ok_or(Error::NoItem {
            split: self.split,
            frames: span,
        })
    }
}

fn annotation(row: &MaskRow, clips: &[Clip]) -> Result<Annotation, Error> {
    let unusable = |source| Error::Mask {
        mask: row.id.clone(),
        source,
    };
    let clip = clips
        .binary_search_by(|clip| clip.id.cmp(&row.motion_id))
        .map_err(|_| Error::UnknownMotion {
            mask: row.id.clone(),
            motion: row.motion_id.clone(),
        })?;
    let hard = JointSet::try_from(row.hard_joints.clone()).map_err(unusable)?;
    let soft = JointSet::try_from(row.soft_joints.clone()).map_err(unusable)?;
    let mask = BlendMask::new(hard, soft).map_err(unusable)?;
    if mask.is_empty() {
        return Err(Error::EmptyMask {
            mask: row.id.clone(),
        });
    }
    if row.text.trim().is_empty() {
        return Err(Error::EmptyText {
            mask: row.id.clone(),
        });
    }
    Ok(Annotation {
        id: row.id.clone(),
        clip,
        mask,
        instruction: row.text.clone(),
    })
}
