//! A split of a dataset as a library, read shard by shard.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use datasets_spec::record::{MaskRow, MotionRow, PairRow};
use datasets_spec::table::{ClipReader, Row, ShardReader, read_rows};
use datasets_spec::{Dataset, Fps, Motion, MotionId, Skeleton, Split};
use rayon::prelude::*;

use super::frames::FrameFile;
use super::rows::{LibraryRows, StatedClip};
use super::{Frames, Library, frames_of_file};
use crate::compose::window::Frame;
use crate::compose::{Error, Paging};

/// Bytes of a frame in memory: as it is stored, and prepared for windows.
pub(super) const BYTES_PER_FRAME: u64 = 4 * 69 + size_of::<Frame>() as u64;

datasets_spec::table! {
    /// What a library holds of a clip beside its frames.
    pub struct LabelledClip = "motions" {
        /// Id of the clip
        pub id: MotionId [""],
        /// Its split
        pub split: Split [""],
        /// Kind of source
        pub source: String [""],
        /// Skeleton the parameters drive
        pub skeleton: String [""],
        /// Stored frame rate
        pub fps: f32 ["1/s"],
        /// Stored frames
        pub n_frames: i32 ["frame"],
        /// Action label
        pub action: Option<String> [""],
        /// Style label
        pub style: Option<String> [""],
    }
}

/// The chosen clips of a file, with their places in it.
type ChosenClips = Vec<(usize, LabelledClip)>;

impl Library {
    /// Reads a split of a dataset. Motions that take more memory than they may are not held: their frames are
    /// copied to a file of the cache folder once, and read from there.
    ///
    /// # Errors
    /// As [`Library::new`], or a file cannot be read or written.
    pub fn read(dataset: &Dataset, split: Split, paging: &Paging) -> Result<Self, Error> {
        let skeleton = dataset.skeleton()?;
        let shards: Vec<(PathBuf, String, ChosenClips)> = dataset
            .files(MotionRow::TABLE, Some(split))
            .into_par_iter()
            .map(|(path, entry)| {
                let clips = ShardReader::open(&path)?.rows::<LabelledClip>()?;
                let clips = clips.into_iter().enumerate();
                let clips: ChosenClips = clips
                    .filter(|(_, clip)| dataset.has_clip(&clip.id))
                    .collect();
                for (_, clip) in &clips {
                    check(clip, &skeleton)?;
                }
                Ok((path, entry.blake3.clone(), clips))
            })
            .collect::<Result<_, Error>>()?;
        let num_frames: u64 = shards
            .iter()
            .flat_map(|(.., clips)| clips)
            .map(|(_, clip)| len_of(clip) as u64)
            .sum();
        let mut rows = LibraryRows::new(split, &skeleton);
        let mut paged = None;
        if num_frames * BYTES_PER_FRAME <= paging.memory {
            let motions: Vec<Vec<Motion>> = shards
                .par_iter()
                .map(|(path, _, clips)| {
                    let reader = ShardMotions::open(path, clips.len())?;
                    let all = clips.par_iter();
                    all.map(|(row, clip)| reader.motion(*row, clip)).collect()
                })
                .collect::<Result<_, Error>>()?;
            for ((.., clips), motions) in shards.iter().zip(motions) {
                for ((_, clip), motion) in clips.iter().zip(motions) {
                    add(&mut rows, clip, Frames::Memory(Arc::new(motion)))?;
                }
            }
        } else {
            // The hashes of the shards are those of the motions and their order; a condition says which of them.
            let mut hasher = blake3::Hasher::new();
            hasher.update(dataset.condition().unwrap_or_default().as_bytes());
            for (_, hash, _) in &shards {
                hasher.update(hash.as_bytes());
            }
            let key = hasher.finalize().to_hex().to_string();
            let fps = match shards.iter().flat_map(|(.., clips)| clips).next() {
                Some((_, clip)) => rate_of(clip)?,
                None => Fps::STORE,
            };
            let file = FrameFile::open(paging, &key, num_frames, fps, |writer| {
                for (path, _, clips) in &shards {
                    let reader = ShardMotions::open(path, clips.len())?;
                    let lens: Vec<usize> = clips.iter().map(|(_, clip)| len_of(clip)).collect();
                    writer.extend(&lens, |place| {
                        let (row, clip) = &clips[place];
                        reader.motion(*row, clip)
                    })?;
                }
                Ok(())
            })?;
            let all = || {
                shards
                    .iter()
                    .flat_map(|(.., clips)| clips)
                    .map(|(_, clip)| clip)
            };
            let frames = frames_of_file(Arc::new(file), all().map(len_of));
            for (clip, frames) in all().zip(frames) {
                add(&mut rows, clip, frames)?;
            }
            paged = Some((paging.clone(), key));
        }
        drop(shards);
        rows.end_of_clips()?;
        for (path, _) in dataset.files(MaskRow::TABLE, Some(split)) {
            let mut masks: Vec<MaskRow> = read_rows(&path)?;
            masks.retain(|mask| dataset.has_clip(&mask.motion_id));
            rows.add_masks(&masks)?;
        }
        for (path, _) in dataset.files(PairRow::TABLE, Some(split)) {
            let mut pairs: Vec<PairRow> = read_rows(&path)?;
            pairs.retain(|pair| pair.clips().into_iter().all(|clip| dataset.has_clip(clip)));
            rows.add_pairs(&pairs)?;
        }
        Ok(Self {
            paged,
            ..rows.library()?
        })
    }
}

fn add(rows: &mut LibraryRows<'_>, clip: &LabelledClip, frames: Frames) -> Result<(), Error> {
    let stated = StatedClip {
        id: &clip.id,
        split: clip.split,
        source: &clip.source,
        action: clip.action.as_deref(),
        style: clip.style.as_deref(),
    };
    rows.add_clip(&stated, rate_of(clip)?, frames)
}

fn len_of(clip: &LabelledClip) -> usize {
    usize::try_from(clip.n_frames).unwrap_or(0)
}

fn rate_of(clip: &LabelledClip) -> Result<Fps, Error> {
    Fps::new(f64::from(clip.fps)).map_err(|source| Error::Motion {
        motion: clip.id.clone(),
        source: source.into(),
    })
}

fn check(clip: &LabelledClip, skeleton: &Skeleton) -> Result<(), Error> {
    if clip.skeleton == skeleton.name() {
        return Ok(());
    }
    Err(Error::OtherSkeleton {
        motion: clip.id.clone(),
        found: clip.skeleton.clone(),
        expected: skeleton.name().to_owned(),
    })
}

/// The motions of a shard.
enum ShardMotions {
    /// Read one at a time.
    Pages(ClipReader),
    /// Of a file that another program wrote, whose pages hold several clips or parts of them.
    Rows(Vec<MotionRow>),
}

impl ShardMotions {
    fn open(path: &Path, num_clips: usize) -> Result<Self, Error> {
        match ClipReader::open(path) {
            Ok(reader) if num_clips == 0 || reader.motion(0).is_ok() => Ok(Self::Pages(reader)),
            // The general reader tells what is wrong, if anything is.
            _ => Ok(Self::Rows(read_rows(path)?)),
        }
    }

    fn motion(&self, row: usize, clip: &LabelledClip) -> Result<Motion, Error> {
        let motion = match self {
            Self::Pages(reader) => reader.motion(row),
            Self::Rows(rows) => rows[row].motion(),
        };
        let motion = motion.map_err(|source| Error::Motion {
            motion: clip.id.clone(),
            source,
        })?;
        if motion.len() != len_of(clip) {
            return Err(Error::Length {
                motion: clip.id.clone(),
                found: motion.len(),
                stated: clip.n_frames,
            });
        }
        Ok(motion)
    }
}
