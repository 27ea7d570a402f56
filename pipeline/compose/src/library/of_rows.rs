//! Libraries of rows, for tests.

use std::sync::Arc;

use datasets_spec::record::{MaskRow, MotionRow, PairRow};
use datasets_spec::table::Row;
use datasets_spec::{Fps, Motion, Seed, Skeleton, Split};

use super::frames::FrameFile;
use super::rows::{LabelledClip, LibraryRows, motion_on};
use super::{Library, frames_of_file};
use crate::{ComposeConfig, Error, FrameCache, Stream};

impl Library {
    pub(crate) fn new(
        split: Split,
        rows: &[MotionRow],
        masks: &[MaskRow],
        pairs: &[PairRow],
    ) -> Result<Self, Error> {
        let skeleton = Skeleton::smplx_neutral();
        let motions = rows.iter().map(|row| motion_on(row, &skeleton));
        let motions: Vec<Motion> = motions.collect::<Result<_, _>>()?;
        let cache = FrameCache {
            folder: std::env::temp_dir().join("stance-tests"),
            kept: 1 << 30,
        };
        let hashes: String = motions.iter().map(Motion::content_hash).collect();
        let key = blake3::hash(hashes.as_bytes()).to_hex().to_string();
        let lens: Vec<usize> = motions.iter().map(Motion::len).collect();
        let num_frames = lens.iter().sum::<usize>() as u64;
        let fps = motions.first().map_or(Fps::STORE, Motion::fps);
        let file = FrameFile::open(&cache, &key, num_frames, fps, |writer| {
            writer.extend(&lens, |places| Ok(motions[places].to_vec()))
        })?;
        let mut library = LibraryRows::new(split, &skeleton);
        let frames = frames_of_file(Arc::new(file), lens);
        let stated = LabelledClip::decode(&MotionRow::encode(rows)?)?;
        for ((stated, motion), frames) in stated.iter().zip(&motions).zip(frames) {
            library.add_clip(stated, motion.fps(), frames)?;
        }
        library.end_of_clips()?;
        library.add_masks(masks)?;
        library.add_pairs(pairs)?;
        library.library(cache, key)
    }
}

pub(crate) fn library(split: Split, num_clips: usize) -> Library {
    let (motions, masks) = testkit::rows(split, num_clips);
    library_of(split, &motions, &masks, &[])
}

pub(crate) fn library_of(
    split: Split,
    motions: &[MotionRow],
    masks: &[MaskRow],
    pairs: &[PairRow],
) -> Library {
    Library::new(split, motions, masks, pairs).expect("valid rows")
}

/// A stream whose normaliser is fitted to its own library.
pub(crate) fn stream(
    library: impl Into<Arc<Library>>,
    config: ComposeConfig,
    seed: u64,
) -> Result<Stream, Error> {
    let library = library.into();
    let normalizer = library.fit_normalizer(&config).expect("long enough");
    Stream::new(library, config, Seed(seed), &normalizer)
}
