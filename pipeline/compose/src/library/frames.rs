//! Frames of motions in a flat file with random access.
//!
//! A page of Parquet holds a whole clip, compressed, and decoding it takes fifty times as long as composing one of its
//! windows. Each clip is therefore decoded once, and its frames are written contiguously to a file in a cache folder; a
//! window then takes a single read.
//!
//! The file's name is the hash of its inputs, so that processes share it. It is written under another name and renamed
//! when complete. Each frame ends with a checksum, because the file may be kept for months.

use std::fs::{self, File};
use std::io::{BufWriter, ErrorKind, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use datasets_spec::store::{Disk, ReadAt, Store};
use datasets_spec::{Fps, Motion};
use kinematics::motion::{BODY_POSE_WIDTH, StoredFrame};
use rayon::prelude::*;

use crate::{Error, FrameCache};

/// First bytes of a file; the number of frames and the frames follow.
const MAGIC: [u8; 16] = *b"stance frames 1\n";
const HEADER_BYTES: usize = MAGIC.len() + 8;
const NUMBERS: usize = 6 + BODY_POSE_WIDTH;
/// Bytes of a frame: its numbers and their CRC-32, little endian.
const FRAME_BYTES: usize = 4 * NUMBERS + 4;
/// Clips that a thread decodes at a time.
const CLIPS_AT_ONCE: usize = 16;
/// Clips that are in memory at a time while a file is written.
const CLIPS_IN_MEMORY: usize = 256;
/// Frames that are decoded at a time, unless a clip has more.
const FRAMES_AT_ONCE: usize = 32_768;

#[derive(Debug)]
pub(crate) struct FrameFile {
    path: PathBuf,
    file: Arc<dyn ReadAt>,
    fps: Fps,
}

impl FrameFile {
    /// Opens the file of this key. If it is missing or incomplete, `make` writes its `num_frames` frames. Processes
    /// that need the same file at once wait for the one that writes it.
    ///
    /// # Panics
    /// If `make` writes another number of frames.
    pub(super) fn open(
        cache: &FrameCache,
        key: &str,
        num_frames: u64,
        fps: Fps,
        make: impl FnOnce(&mut FrameWriter) -> Result<(), Error>,
    ) -> Result<Self, Error> {
        let path = cache.file(key);
        if let Some(found) = Self::found(&path, num_frames, fps)? {
            FrameCache::touch(&path);
            return Ok(found);
        }
        let failed = |source| unwritten(&path, num_frames, source);
        fs::create_dir_all(&cache.folder).map_err(failed)?;
        let part = path.with_extension("part");
        let file = File::options()
            .create(true)
            .truncate(false)
            .write(true)
            .open(&part)
            .map_err(failed)?;
        file.lock().map_err(failed)?;
        // Another process may have written the file in the meantime.
        if let Some(found) = Self::found(&path, num_frames, fps)? {
            return Ok(found);
        }
        file.set_len(0).map_err(failed)?;
        let mut writer = FrameWriter {
            file: BufWriter::with_capacity(1 << 20, file),
            path: path.clone(),
            num_frames: 0,
            expected: num_frames,
            most_at_once: 0,
        };
        let made = writer
            .write(&MAGIC)
            .and_then(|()| writer.write(&num_frames.to_le_bytes()))
            .and_then(|()| make(&mut writer))
            .and_then(|()| writer.finish(&part));
        if let Err(error) = made {
            // Return the first error, even if the unfinished file cannot be removed.
            let _removed = fs::remove_file(&part);
            return Err(error);
        }
        cache.remove_others(&path);
        Self::found(&path, num_frames, fps)?
            .ok_or_else(|| damaged(&path, "it was removed or changed as soon as it was written"))
    }

    /// The file at a path; `None` if it does not exist or is incomplete.
    fn found(path: &Path, num_frames: u64, fps: Fps) -> Result<Option<Self>, Error> {
        let file = match Disk.open_at(path) {
            Ok(file) => file,
            Err(error)
                if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) =>
            {
                return Ok(None);
            }
            Err(error) => return Err(datasets_spec::Error::io("open", path)(error).into()),
        };
        let failed = || datasets_spec::Error::io("read", path);
        if file.size() != HEADER_BYTES as u64 + num_frames * FRAME_BYTES as u64 {
            return Ok(None);
        }
        let mut header = [0; HEADER_BYTES];
        file.read_exact_at(&mut header, 0).map_err(failed())?;
        let is_ours =
            header[..MAGIC.len()] == MAGIC && header[MAGIC.len()..] == num_frames.to_le_bytes();
        Ok(is_ours.then(|| Self {
            path: path.to_owned(),
            file,
            fps,
        }))
    }

    /// Reads `count` frames, each `stride` after the one before, from frame `first` of the file on.
    pub(super) fn read(
        &self,
        first: u64,
        count: usize,
        stride: usize,
        room: &mut FrameRoom,
    ) -> Result<(), Error> {
        let span = (count.saturating_sub(1) * stride + 1) * FRAME_BYTES;
        room.bytes.resize(span, 0);
        self.file
            .read_exact_at(
                &mut room.bytes,
                HEADER_BYTES as u64 + first * FRAME_BYTES as u64,
            )
            .map_err(datasets_spec::Error::io("read", &self.path))?;
        room.frames.clear();
        let frames = room.bytes.as_chunks::<FRAME_BYTES>().0;
        for frame in frames.iter().step_by(stride) {
            let (words, _) = frame.as_chunks::<4>();
            let sum = crc32fast::hash(&frame[..4 * NUMBERS]);
            if sum != u32::from_le_bytes(words[NUMBERS]) {
                return Err(damaged(
                    &self.path,
                    "its numbers differ from their checksum",
                ));
            }
            let numbers: [f32; NUMBERS] = std::array::from_fn(|at| f32::from_le_bytes(words[at]));
            room.frames.push(numbers);
        }
        Ok(())
    }

    /// Reads `count` frames as a motion, beginning with frame `first` of the file.
    pub(super) fn motion(&self, first: u64, count: usize) -> Result<Motion, Error> {
        let mut room = FrameRoom::default();
        self.read(first, count, 1, &mut room)?;
        let frames = room.frames.iter();
        let transl = frames.clone().map(|frame| [frame[0], frame[1], frame[2]]);
        let orient = frames.clone().map(|frame| [frame[3], frame[4], frame[5]]);
        let body = frames.map(|frame| std::array::from_fn(|at| frame[6 + at]));
        Motion::new(self.fps, transl.collect(), orient.collect(), body.collect())
            .map_err(|_| damaged(&self.path, "its numbers are none of a motion"))
    }
}

/// Frames that were read, and a byte buffer that is reused.
#[derive(Debug, Default)]
pub(crate) struct FrameRoom {
    bytes: Vec<u8>,
    pub(crate) frames: Vec<StoredFrame>,
}

fn damaged(path: &Path, problem: &'static str) -> Error {
    Error::Frames {
        path: path.to_owned(),
        problem,
    }
}

pub(super) struct FrameWriter {
    file: BufWriter<File>,
    path: PathBuf,
    num_frames: u64,
    /// Frames that the whole file has.
    expected: u64,
    /// Largest number of motions in memory at once.
    most_at_once: usize,
}

impl FrameWriter {
    fn write(&mut self, bytes: &[u8]) -> Result<(), Error> {
        let written = self.file.write_all(bytes);
        written.map_err(|source| self.unwritten(source))
    }

    /// Appends the motions of clips, given their lengths in frames; at most [`CLIPS_IN_MEMORY`] are in memory at once.
    pub(super) fn extend(
        &mut self,
        lens: &[usize],
        motions_of: impl Fn(Range<usize>) -> Result<Vec<Motion>, Error> + Sync,
    ) -> Result<(), Error> {
        let mut start = 0;
        while start < lens.len() {
            let mut end = start;
            let mut frames = 0;
            while end < lens.len() && end - start < CLIPS_IN_MEMORY {
                frames += lens[end];
                if frames > FRAMES_AT_ONCE && end > start {
                    break;
                }
                end += 1;
            }
            let encoded: Vec<Vec<Vec<u8>>> = (start..end)
                .into_par_iter()
                .step_by(CLIPS_AT_ONCE)
                .map(|from| {
                    let clips = from..end.min(from + CLIPS_AT_ONCE);
                    let motions = motions_of(clips.clone())?;
                    let found = motions.iter().map(Motion::len);
                    assert!(
                        found.eq(lens[clips].iter().copied()),
                        "clips have the stated length"
                    );
                    Ok(motions.iter().map(encode).collect())
                })
                .collect::<Result<_, Error>>()?;
            for bytes in encoded.into_iter().flatten() {
                self.write(&bytes)?;
                self.num_frames += (bytes.len() / FRAME_BYTES) as u64;
            }
            self.most_at_once = self.most_at_once.max(end - start);
            start = end;
        }
        Ok(())
    }

    /// Largest number of motions that were in memory at once.
    #[cfg(test)]
    pub(super) fn most_at_once(&self) -> usize {
        self.most_at_once
    }

    /// Syncs the file and renames it to its final name.
    fn finish(&mut self, part: &Path) -> Result<(), Error> {
        assert_eq!(self.num_frames, self.expected, "frames of all clips");
        let done = self
            .file
            .flush()
            .and_then(|()| self.file.get_ref().sync_all())
            .and_then(|()| fs::rename(part, &self.path));
        done.map_err(|source| self.unwritten(source))
    }

    fn unwritten(&self, source: std::io::Error) -> Error {
        unwritten(&self.path, self.expected, source)
    }
}

fn unwritten(path: &Path, num_frames: u64, source: std::io::Error) -> Error {
    Error::UnwrittenFrames {
        path: path.to_owned(),
        bytes: num_frames * FRAME_BYTES as u64,
        source,
    }
}

fn encode(motion: &Motion) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(motion.len() * FRAME_BYTES);
    let columns = motion.transl().iter().zip(motion.global_orient());
    for ((transl, orient), body) in columns.zip(motion.body_pose()) {
        let start = bytes.len();
        let numbers = transl.iter().chain(orient).chain(body);
        bytes.extend(numbers.flat_map(|number| number.to_le_bytes()));
        let sum = crc32fast::hash(&bytes[start..]);
        bytes.extend(sum.to_le_bytes());
    }
    bytes
}
