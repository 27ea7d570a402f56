//! The motions and masks of one split, ready to be composed.

use std::collections::BTreeMap;
use std::sync::Arc;

use datasets_spec::record::{MaskRow, MotionRow, PairRow};
use datasets_spec::{BlendMask, BodyPart, Fps, JointSet, Motion, MotionId, Pose, Skeleton, Split};
use kinematics::KeypointFrame;
use kinematics::canonical::{canonicalise, window_starts};
use kinematics::normalise::Normalizer;
use rayon::prelude::*;

use super::config::{Alignment, EditKind, RangeRule};
use super::{ComposeConfig, Error, ItemTask, align, style_instruction};

/// Most windows a normalisation range is fitted on. The quantiles of 13 million coordinates per
/// axis are known to about 1e-4 of the distribution; more windows would only take memory.
const MAX_RANGE_WINDOWS: usize = 10_000;

/// A motion of the base.
#[derive(Clone, Debug)]
pub(super) struct Clip {
    pub(super) id: MotionId,
    /// Number shared by all clips of one source: mirrored and cropped copies.
    pub(super) origin: usize,
    /// Kind of source it came from.
    pub(super) source: String,
    pub(super) action: Option<String>,
    pub(super) style: Option<String>,
    pub(super) motion: Motion,
    /// Whether it may be drawn as a partner: motions made from others here may not.
    pub(super) in_base: bool,
}

/// An accepted (motion, mask, text).
#[derive(Clone, Debug)]
pub(super) struct Annotation {
    pub(super) id: String,
    /// Index of the clip.
    pub(super) clip: usize,
    pub(super) mask: BlendMask,
    /// Names of the parts the mask is made of.
    pub(super) parts: Vec<String>,
    pub(super) instruction: String,
}

/// A motion, another one of the same body doing the same otherwise, and what tells them apart.
#[derive(Clone, Debug)]
pub(super) struct Pair {
    pub(super) id: String,
    pub(super) kind: EditKind,
    /// Index of the clip before the edit, as it is in the dataset.
    pub(super) captured: usize,
    /// Index of the clip before the edit, in step with the one after it.
    pub(super) source: usize,
    /// Index of the clip after the edit.
    pub(super) target: usize,
    /// Halves of the body that may be edited.
    pub(super) halves: Vec<BodyPart>,
    /// Names of the parts it is said to change.
    pub(super) parts: Vec<String>,
    /// Whether it is a pair of MotionFix, which is evaluated as it is.
    pub(super) is_motionfix: bool,
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
    pub(super) pairs: Vec<Pair>,
    alignment: Alignment,
}

impl Library {
    /// Takes the rows of one split. A split without motions gives an empty library.
    ///
    /// # Errors
    /// A row is of another split, skeleton or rate, appears twice, or is not usable; or a mask
    /// or pair belongs to a motion that is not among the rows.
    pub fn new(
        split: Split,
        motions: &[MotionRow],
        masks: &[MaskRow],
        pairs: &[PairRow],
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
                source: row.source.clone(),
                action: row.action.clone(),
                style: row.style.clone(),
                motion,
                in_base: true,
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
        let mut known_pairs = BTreeMap::new();
        for row in pairs {
            same_split("pairs", &row.id, row.split)?;
            let pair = pair(row, &clips)?;
            if known_pairs.insert(row.id.clone(), pair).is_some() {
                return Err(Error::Duplicate {
                    table: "pairs",
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
            pairs: known_pairs.into_values().collect(),
            alignment: Alignment::None,
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

    /// Number of pairs.
    pub fn num_pairs(&self) -> usize {
        self.pairs.len()
    }

    /// The library with the motions of its pairs in step.
    pub(super) fn aligned(self: Arc<Self>, alignment: Alignment) -> Arc<Self> {
        if alignment == self.alignment {
            return self;
        }
        let mut library = Self::clone(&self);
        library.clips.retain(|clip| clip.in_base);
        for pair in &mut library.pairs {
            pair.source = pair.captured;
        }
        if alignment == Alignment::TimeWarp {
            let warped: Vec<Clip> = library
                .pairs
                .par_iter()
                .map(|pair| {
                    let (source, target) =
                        (&library.clips[pair.captured], &library.clips[pair.target]);
                    Clip {
                        motion: align::warped(&source.motion, &target.motion, &library.skeleton),
                        in_base: false,
                        ..source.clone()
                    }
                })
                .collect();
            for (pair, clip) in library.pairs.iter_mut().zip(warped) {
                pair.source = library.clips.len();
                library.clips.push(clip);
            }
        }
        library.alignment = alignment;
        Arc::new(library)
    }

    /// Fits the range of model units to the canonical windows of the library's motions, at most
    /// 10,000 of them, evenly spaced over all.
    ///
    /// # Errors
    /// The library is not of the training split, no motion is as long as a window, or a setting is
    /// out of range.
    ///
    /// # Source
    /// Paper App. B.2.
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
            .filter(|(_, clip)| clip.in_base)
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
        let fitted = match config.range {
            RangeRule::PerAxis => Normalizer::fit(&frames),
            RangeRule::Scalar => Normalizer::fit_shared(&frames),
        };
        fitted.ok_or(Error::NoItem {
            split: self.split,
            frames: span,
        })
    }
}

fn pair(row: &PairRow, clips: &[Clip]) -> Result<Pair, Error> {
    let find = |id: &MotionId| {
        clips
            .binary_search_by(|clip| clip.id.cmp(id))
            .map_err(|_| Error::UnknownMotion {
                table: "pair",
                row: row.id.clone(),
                motion: id.clone(),
            })
    };
    let (source, target) = (find(&row.source_id)?, find(&row.target_id)?);
    let (kind, instruction, parts) = meaning_of_pair(row)?;
    Ok(Pair {
        id: row.id.clone(),
        kind,
        captured: source,
        source,
        target,
        halves: halves_of(&parts),
        parts: row.parts.clone(),
        is_motionfix: row.source == ItemTask::MotionFix.as_str(),
        instruction,
    })
}

/// Checks what a row says of its pair, apart from the motions it names.
///
/// # Errors
/// The kind is unknown, there are no words, or a part does not exist.
pub(crate) fn check_pair(row: &PairRow) -> Result<(), Error> {
    meaning_of_pair(row).map(|_| ())
}

/// Checks what a row says of its mask, apart from the motion it names.
///
/// # Errors
/// A joint is unknown or twice in the mask, the mask is empty, or there are no words.
pub(crate) fn check_mask(row: &MaskRow) -> Result<(), Error> {
    blend_of_mask(row).map(|_| ())
}

/// The kind of a pair, its instruction and the parts it is said to change.
fn meaning_of_pair(row: &PairRow) -> Result<(EditKind, String, Vec<BodyPart>), Error> {
    let kind = EditKind::parse(&row.kind).ok_or_else(|| Error::PairKind {
        pair: row.id.clone(),
        found: row.kind.clone(),
    })?;
    let instruction = match (row.instruction.trim(), &row.style) {
        ("", Some(style)) => style_instruction(style),
        ("", None) => {
            return Err(Error::EmptyText {
                table: "pair",
                row: row.id.clone(),
            });
        }
        (text, _) => text.to_owned(),
    };
    let parts = row
        .parts
        .iter()
        .map(|name| name.parse())
        .collect::<Result<_, _>>()
        .map_err(|source| Error::Pair {
            pair: row.id.clone(),
            source,
        })?;
    Ok((kind, instruction, parts))
}

/// The halves of the body that a pair may be edited in: those its parts belong to, both if it names
/// none.
fn halves_of(parts: &[BodyPart]) -> Vec<BodyPart> {
    let both = [BodyPart::LowerBody, BodyPart::UpperBody];
    let named = parts
        .iter()
        .fold(JointSet::EMPTY, |all, part| all.union(part.mask().hard()));
    let touched: Vec<BodyPart> = both
        .into_iter()
        .filter(|half| !half.mask().hard().intersection(named).is_empty())
        .collect();
    if touched.is_empty() {
        both.to_vec()
    } else {
        touched
    }
}

fn annotation(row: &MaskRow, clips: &[Clip]) -> Result<Annotation, Error> {
    let clip = clips
        .binary_search_by(|clip| clip.id.cmp(&row.motion_id))
        .map_err(|_| Error::UnknownMotion {
            table: "mask",
            row: row.id.clone(),
            motion: row.motion_id.clone(),
        })?;
    Ok(Annotation {
        id: row.id.clone(),
        clip,
        mask: blend_of_mask(row)?,
        parts: row.parts.clone(),
        instruction: row.text.clone(),
    })
}

/// The mask of a row that also has words.
fn blend_of_mask(row: &MaskRow) -> Result<BlendMask, Error> {
    let unusable = |source| Error::Mask {
        mask: row.id.clone(),
        source,
    };
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
            table: "mask",
            row: row.id.clone(),
        });
    }
    Ok(mask)
}
