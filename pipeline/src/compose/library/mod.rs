//! The motions, masks and pairs of one split, and every rule on them: which rows fit together, which
//! clips partners are drawn from, and who may be blended with whom.

mod normaliser;
mod pairing;
mod rows;

use std::sync::Arc;

use datasets_spec::{BlendMask, BodyPart, Fps, Motion, MotionId, Skeleton, Split};
use rayon::prelude::*;

use super::align;
use super::config::{Alignment, EditKind};

pub(super) use pairing::{Pairing, Subject};
pub(crate) use rows::{check_mask, check_pair, motion_on};

/// A motion of the base.
#[derive(Clone, Debug)]
pub(super) struct Clip {
    pub(super) id: MotionId,
    /// Number shared by all clips of one source clip: mirrored and cropped copies.
    pub(super) origin: usize,
    /// Kind of source it came from.
    pub(super) source: String,
    pub(super) action: Option<String>,
    pub(super) style: Option<String>,
    pub(super) motion: Motion,
    /// Whether it may be drawn as a partner. Time-warped copies may not.
    pub(super) in_base: bool,
}

/// An accepted (motion, mask, text).
#[derive(Clone, Debug)]
struct Annotation {
    id: String,
    /// Index of the clip.
    clip: usize,
    mask: BlendMask,
    /// Names of the parts the mask is made of.
    parts: Vec<String>,
    instruction: String,
}

/// Two motions of one body that differ in one respect, and the instruction for the difference.
#[derive(Clone, Debug)]
struct Pair {
    id: String,
    kind: EditKind,
    /// Index of the clip before the edit, as stored in the dataset.
    captured: usize,
    /// Index of the clip before the edit, aligned in time with the one after it.
    source: usize,
    /// Index of the clip after the edit.
    target: usize,
    /// Halves of the body that may be edited.
    halves: Vec<BodyPart>,
    /// Names of the parts that the pair says it changes.
    parts: Vec<String>,
    /// Whether it is a pair of MotionFix, which is evaluated without a donor.
    is_motionfix: bool,
    instruction: String,
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
    clips: Vec<Clip>,
    annotations: Vec<Annotation>,
    pairs: Vec<Pair>,
    alignment: Alignment,
}

impl Library {
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

    /// Number of pairs.
    pub fn num_pairs(&self) -> usize {
        self.pairs.len()
    }

    /// A pair as it was captured: the instruction of the dataset and the motions before and after the
    /// edit, which may differ in length.
    ///
    /// # Panics
    /// If the index is not below [`Library::num_pairs`].
    pub fn pair(&self, index: usize) -> (&str, [&Motion; 2]) {
        let pair = &self.pairs[index];
        let motions = [pair.captured, pair.target].map(|clip| &self.clips[clip].motion);
        (&pair.instruction, motions)
    }

    /// A clip by its index.
    pub(super) fn clip(&self, clip: usize) -> &Clip {
        &self.clips[clip]
    }

    /// The clip of this id as stored in the dataset, not time-warped.
    ///
    /// # Panics
    /// If no motion has this id.
    pub(super) fn captured(&self, id: &MotionId) -> &Clip {
        let mut clips = self.clips.iter();
        clips
            .find(|clip| clip.in_base && clip.id == *id)
            .expect("a motion of this library")
    }

    /// Other captures of the same action in the same style; none where the action is not known.
    pub(super) fn other_takes(&self, target: &Clip) -> impl Iterator<Item = &Clip> {
        self.clips.iter().filter(|clip| {
            clip.in_base
                && clip.action.is_some()
                && clip.action == target.action
                && clip.style == target.style
                && clip.origin != target.origin
        })
    }

    /// The library with the motions of its pairs aligned in time.
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
}
