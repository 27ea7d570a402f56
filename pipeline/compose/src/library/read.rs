//! A split of a dataset as a library, read shard by shard.

use std::path::PathBuf;
use std::sync::Arc;

use datasets_spec::record::{FramesRow, MaskRow, MotionRow, PairRow};
use datasets_spec::table::{Row, ShardReader, read_rows};
use datasets_spec::{Dataset, Fps, Motion, Split};
use rayon::prelude::*;

use super::frames::FrameFile;
use super::rows::{LabelledClip, LibraryRows, check_skeleton, no_motion};
use super::{Library, frames_of_file};
use crate::{Error, FrameCache};

type ChosenClips = Vec<(usize, LabelledClip)>;

impl Library {
    /// Reads a split of a dataset; one without motions gives an empty library. Frames are copied to a file of the cache
    /// once, and read from there.
    ///
    /// # Errors
    /// A row is of another split, skeleton or rate, appears twice, or is not usable; a mask or pair belongs to a motion
    /// that is not among the rows; or a file cannot be read or written.
    pub fn read(dataset: &Dataset, split: Split, cache: &FrameCache) -> Result<Self, Error> {
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
                    check_skeleton(&clip.id, &clip.skeleton, &skeleton)?;
                }
                Ok((path, entry.blake3.clone(), clips))
            })
            .collect::<Result<_, Error>>()?;
        let all = || {
            let clips = shards.iter().flat_map(|(.., clips)| clips);
            clips.map(|(_, clip)| clip)
        };
        // The shards' hashes identify the motions and their order. A condition selects some of them; the same condition may
        // select others once the masks or pairs of the dataset change.
        let mut hasher = blake3::Hasher::new();
        for (_, hash, clips) in &shards {
            hasher.update(hash.as_bytes());
            hasher.update(&clips.len().to_le_bytes());
            for (place, _) in clips {
                hasher.update(&place.to_le_bytes());
            }
        }
        let key = hasher.finalize().to_hex().to_string();
        let fps = match all().next() {
            Some(clip) => rate_of(clip)?,
            None => Fps::STORE,
        };
        let num_frames = all().map(|clip| len_of(clip) as u64).sum();
        let file = FrameFile::open(cache, &key, num_frames, fps, |writer| {
            for (path, _, clips) in &shards {
                // All rows are read, and the cache keeps them, so a file at a URL is verified first.
                let shard = ShardReader::open_whole(path)?;
                let lens: Vec<usize> = clips.iter().map(|(_, clip)| len_of(clip)).collect();
                writer.extend(&lens, |places| motions_of(&shard, &clips[places]))?;
            }
            Ok(())
        })?;
        let mut rows = LibraryRows::new(split, &skeleton);
        let frames = frames_of_file(Arc::new(file), all().map(len_of));
        for (clip, frames) in all().zip(frames) {
            rows.add_clip(clip, rate_of(clip)?, frames)?;
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
        rows.library(cache.clone(), key)
    }
}

fn len_of(clip: &LabelledClip) -> usize {
    usize::try_from(clip.n_frames).unwrap_or(0)
}

fn rate_of(clip: &LabelledClip) -> Result<Fps, Error> {
    Fps::new(f64::from(clip.fps)).map_err(|source| no_motion(&clip.id, source.into()))
}

fn motions_of(shard: &ShardReader, clips: &[(usize, LabelledClip)]) -> Result<Vec<Motion>, Error> {
    let rows: Vec<usize> = clips.iter().map(|(row, _)| *row).collect();
    let read: Vec<FramesRow> = shard.rows_at(&rows)?;
    let of = |(read, (_, clip)): (FramesRow, &(usize, LabelledClip))| {
        let motion = read
            .motion()
            .map_err(|source| no_motion(&clip.id, source))?;
        if motion.len() != len_of(clip) {
            return Err(Error::Refused(format!(
                "motion {} has {} frames, and its row states {}; ingest it again",
                clip.id,
                motion.len(),
                clip.n_frames
            )));
        }
        Ok(motion)
    };
    std::iter::zip(read, clips).map(of).collect()
}
