//! The motions, masks and pairs of one split, and every rule on them: which rows belong together, which clips are
//! partners, and which clips may be blended.

#[cfg(test)]
mod cached_tests;
mod frames;
mod normaliser;
#[cfg(test)]
mod of_rows;
mod pairing;
mod read;
mod rows;

use std::collections::BTreeSet;
use std::ops::Range;
use std::sync::Arc;

use datasets_spec::{BlendMask, BodyPart, Fps, Motion, MotionId, Skeleton, Split};

use super::config::{Alignment, COMPOSE_VERSION, EditKind};
use super::{Error, FrameCache, align};
use frames::FrameFile;
pub(super) use frames::FrameRoom;

#[cfg(test)]
pub(crate) use of_rows::{library, library_of, stream};
pub(super) use pairing::{Pairing, Subject};
pub use rows::{check_mask, check_pair, motion_on};

#[derive(Clone, Debug)]
pub(super) struct Clip {
    pub(super) id: MotionId,
    /// Number shared by all clips that are made from one source clip, such as mirrored and cropped copies.
    pub(super) origin: usize,
    /// Kind of the clip's source.
    pub(super) source: Arc<str>,
    pub(super) action: Option<Arc<str>>,
    pub(super) style: Option<Arc<str>>,
    frames: FileFrames,
    /// Whether the clip may be drawn as a partner. Time-warped copies may not.
    pub(super) in_base: bool,
}

#[derive(Clone, Debug)]
struct FileFrames {
    file: Arc<FrameFile>,
    /// First frame of the clip in that file.
    first: u64,
    len: usize,
}

impl Clip {
    pub(super) fn len(&self) -> usize {
        self.frames.len
    }

    pub(super) fn motion(&self) -> Result<Motion, Error> {
        self.crop(0..self.len())
    }

    /// The frames of a range.
    ///
    /// # Panics
    /// If the range is empty or leaves the clip.
    pub(super) fn crop(&self, frames: Range<usize>) -> Result<Motion, Error> {
        let FileFrames { file, first, len } = &self.frames;
        assert!(
            !frames.is_empty() && frames.end <= *len,
            "a range inside the clip"
        );
        file.motion(first + frames.start as u64, frames.len())
    }

    /// Reads `count` frames, each `stride` after the one before, from frame `start` on.
    ///
    /// # Panics
    /// If the frames leave the clip.
    pub(super) fn thinned(
        &self,
        start: usize,
        count: usize,
        stride: usize,
        room: &mut FrameRoom,
    ) -> Result<(), Error> {
        let FileFrames { file, first, len } = &self.frames;
        assert!(
            count > 0 && start + (count - 1) * stride < *len,
            "the window leaves the motion"
        );
        file.read(first + start as u64, count, stride, room)
    }
}

/// An annotation of a motion, or a pair: two motions of one body that differ in one respect. For an annotation,
/// `captured`, `source` and `target` are the same clip.
#[derive(Clone, Debug)]
pub(super) struct Edit {
    pub(super) id: String,
    pub(super) kind: EditKind,
    /// Index of the clip before the edit, as stored in the dataset.
    captured: usize,
    /// Index of the clip before the edit, aligned in time with the one after it.
    source: usize,
    /// Index of the clip after the edit.
    pub(super) target: usize,
    /// Frames of `target` that the instruction describes.
    pub(super) frames: Range<usize>,
    /// Mask of an annotation; empty for a pair.
    mask: BlendMask,
    /// Halves of the body that a pair may be edited in; empty for an annotation, which has a mask.
    pub(super) halves: Vec<BodyPart>,
    /// Names of the parts that the mask is made of, or that the pair changes.
    pub(super) parts: Arc<[String]>,
    /// Whether it is a pair from MotionFix. Such pairs are evaluated without a donor.
    is_motionfix: bool,
    pub(super) instruction: Arc<str>,
}

/// All motions and masks of one split: the motion base and the annotated set of MotionCutMix.
///
/// Clips and annotations are ordered by id, so nothing depends on the order of the rows it was
/// made from. Ids, lengths and labels are in memory; frames are read from a file when they are needed ([`FrameCache`]).
#[derive(Clone, Debug)]
pub struct Library {
    split: Split,
    fps: Fps,
    skeleton: Skeleton,
    /// Captured clips, by id, and then time-warped copies.
    clips: Vec<Clip>,
    num_captured: usize,
    annotations: Vec<Edit>,
    pairs: Vec<Edit>,
    alignment: Alignment,
    cache: FrameCache,
    /// Cache key of the file with the captured clips.
    key: String,
}

impl Library {
    /// Split of all motions of the library.
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

    /// Number of motions, time-warped copies included.
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
    /// # Errors
    /// The motions cannot be read.
    ///
    /// # Panics
    /// If the index is not below [`Library::num_pairs`].
    pub fn pair(&self, index: usize) -> Result<(&str, [Motion; 2]), Error> {
        let pair = &self.pairs[index];
        let [source, target] = [pair.captured, pair.target].map(|clip| self.clips[clip].motion());
        Ok((&pair.instruction, [source?, target?]))
    }

    /// The instruction of a pair.
    ///
    /// # Panics
    /// If the index is not below [`Library::num_pairs`].
    pub fn instruction_of_pair(&self, index: usize) -> &str {
        &self.pairs[index].instruction
    }

    pub(super) fn clip(&self, clip: usize) -> &Clip {
        &self.clips[clip]
    }

    /// The clip of this id as stored in the dataset, not time-warped.
    ///
    /// # Panics
    /// If no motion has this id.
    pub(super) fn captured(&self, id: &MotionId) -> &Clip {
        let captured = &self.clips[..self.num_captured];
        let found = captured.binary_search_by(|clip| clip.id.cmp(id));
        &captured[found.expect("a motion of this library")]
    }

    /// Other captures of the same action in the same style; empty if the action is not known. Targets of fine-grained
    /// pairs neither have nor are other takes: they vary the action in a way that no label states.
    pub(super) fn other_takes(&self, target: &Clip) -> impl Iterator<Item = &Clip> {
        let varied: BTreeSet<&MotionId> = self
            .pairs
            .iter()
            .filter(|pair| pair.kind == EditKind::FineGrained)
            .map(|pair| &self.clips[pair.target].id)
            .collect();
        let is_plain = move |clip: &Clip| !varied.contains(&clip.id);
        let target = is_plain(target).then_some(target);
        self.clips[..self.num_captured].iter().filter(move |clip| {
            target.is_some_and(|target| {
                clip.action.is_some()
                    && clip.action == target.action
                    && clip.style == target.style
                    && clip.origin != target.origin
                    && is_plain(clip)
            })
        })
    }

    /// The library with the motions of its pairs aligned in time.
    pub(super) fn aligned(self: Arc<Self>, alignment: Alignment) -> Result<Arc<Self>, Error> {
        if alignment == self.alignment {
            return Ok(self);
        }
        let mut library = Self::clone(&self);
        library.clips.truncate(library.num_captured);
        for pair in &mut library.pairs {
            pair.source = pair.captured;
        }
        if alignment == Alignment::TimeWarp {
            let warped = library.warped()?;
            for (pair, clip) in library.pairs.iter_mut().zip(warped) {
                pair.source = library.clips.len();
                library.clips.push(clip);
            }
        }
        library.alignment = alignment;
        Ok(Arc::new(library))
    }

    /// The source of each pair, aligned with its target.
    fn warped(&self) -> Result<Vec<Clip>, Error> {
        let warped = |pair: &Edit| -> Result<Motion, Error> {
            let [source, target] =
                [pair.captured, pair.target].map(|clip| self.clips[clip].motion());
            Ok(align::warped(&source?, &target?, &self.skeleton))
        };
        let lens: Vec<usize> = (self.pairs.iter())
            .map(|pair| self.clips[pair.target].len())
            .collect();
        let mut hasher = blake3::Hasher::new();
        let rules = (COMPOSE_VERSION, env!("CARGO_PKG_VERSION"));
        hasher.update(format!("time warp by {rules:?} of {} ", self.key).as_bytes());
        hasher.update(self.skeleton.name().as_bytes());
        for pair in &self.pairs {
            hasher.update(&(pair.captured as u64).to_le_bytes());
            hasher.update(&(pair.target as u64).to_le_bytes());
        }
        let key = hasher.finalize().to_hex().to_string();
        let num_frames = lens.iter().sum::<usize>() as u64;
        let file = FrameFile::open(&self.cache, &key, num_frames, self.fps, |writer| {
            writer.extend(&lens, |pairs| {
                self.pairs[pairs].iter().map(warped).collect()
            })
        })?;
        let frames = frames_of_file(Arc::new(file), lens);
        let clips = self.pairs.iter().zip(frames).map(|(pair, frames)| Clip {
            frames,
            in_base: false,
            ..self.clips[pair.captured].clone()
        });
        Ok(clips.collect())
    }
}

/// Frames of clips stored one after another in a file.
fn frames_of_file(
    file: Arc<FrameFile>,
    lens: impl IntoIterator<Item = usize>,
) -> impl Iterator<Item = FileFrames> {
    let mut next = 0;
    lens.into_iter().map(move |len| {
        let first = next;
        next += len as u64;
        FileFrames {
            file: Arc::clone(&file),
            first,
            len,
        }
    })
}
