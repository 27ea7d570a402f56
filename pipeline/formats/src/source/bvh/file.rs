//! A parsed BVH file.

use std::io::Read;

use datasets_spec::Fps;

use super::cursor::{Cursor, syntax};
use super::hierarchy::{BvhJoint, parse_hierarchy};
use super::motion::{Rows, is_line_end, parse_frame_time};
use super::soma;
use crate::source::head::UTF8_BOM;
use clip::{Rejected, rejected};

/// A parsed BVH file in its own unit, axes and joint names.
#[derive(Clone, Debug, PartialEq)]
pub struct BvhFile {
    /// The joints, parents first.
    pub joints: Vec<BvhJoint>,
    pub(super) num_channels: usize,
    pub(super) fps: Fps,
    pub(super) num_frames: usize,
    pub(super) values: Vec<f64>,
    /// Rows in the file; `num_frames` of them are used.
    pub(super) num_rows: usize,
    /// Number of frames that the header states.
    pub(super) stated_frames: usize,
}

impl BvhFile {
    /// The columns of a frame, `[C]`.
    ///
    /// # Panics
    /// If the frame does not exist.
    pub fn frame(&self, frame_index: usize) -> &[f64] {
        &self.values[frame_index * self.num_channels..][..self.num_channels]
    }

    /// Parses a file.
    ///
    /// # Errors
    /// `E-BVH-SYNTAX`, `E-BVH-FRAME-TIME`, `E-BVH-NUMBER`, `E-BVH-FRAMES` or `E-TOO-SHORT`, each
    /// with the byte offset of what is wrong.
    pub fn parse(bytes: &[u8]) -> Result<Self, Rejected> {
        Self::read(&mut &bytes[..], bytes.len(), false)
    }

    /// Reads a file of about `length` bytes in pieces, so that its whole text is never in memory. If `lenient`, the
    /// number of complete rows may differ from the header's; rows beyond the stated number are dropped.
    ///
    /// # Errors
    /// As [`BvhFile::parse`]; `E-IO` if the file cannot be read.
    pub fn read(file: &mut dyn Read, length: usize, lenient: bool) -> Result<Self, Rejected> {
        let mut pieces = Pieces::new(file);
        let mut bvh = pieces.header()?;
        let mut rows = Rows::new(bvh.stated_frames, bvh.num_channels, length);
        while let Some((offset, lines)) = pieces.lines()? {
            rows.take(lines, offset)?;
        }
        bvh.values = rows.finish(lenient, pieces.offset)?;
        bvh.num_rows = bvh.values.len() / bvh.num_channels;
        bvh.num_frames = bvh.num_rows.min(bvh.stated_frames);
        bvh.values.truncate(bvh.num_frames * bvh.num_channels);
        Ok(bvh)
    }

    /// Parses everything before the rows, and returns a file without rows and the offset of the rows.
    fn parse_header(bytes: &[u8]) -> Result<(Self, usize), Rejected> {
        let mut cursor = Cursor {
            bytes,
            at: bytes.strip_prefix(UTF8_BOM).map_or(0, |_| UTF8_BOM.len()),
        };
        let (joints, rest_rotation) = parse_hierarchy(&mut cursor)?;
        if let Some(at) = rest_rotation.filter(|_| !soma::is_soma(&joints)) {
            return Err(syntax(
                at,
                "found six numbers after OFFSET, expected three; only rigs of SOMA are known to state a \
                 rest rotation there, which their channels repeat",
            ));
        }
        let num_channels = joints.iter().map(|joint| joint.channels.len()).sum();
        if num_channels == 0 {
            let reason = "the hierarchy has no channels, expected at least one";
            return Err(syntax(cursor.at, reason));
        }
        cursor.keyword("MOTION")?;
        cursor.keyword("FRAMES:")?;
        let stated_frames = cursor.count("a number of frames")?;
        let fps = parse_frame_time(&mut cursor)?;
        let bvh = Self {
            joints,
            num_channels,
            fps,
            num_frames: 0,
            values: Vec::new(),
            num_rows: 0,
            stated_frames,
        };
        Ok((bvh, cursor.at))
    }
}

/// The text of a file, read in pieces.
struct Pieces<'a> {
    file: &'a mut dyn Read,
    text: Vec<u8>,
    /// Number of bytes of `text` that were returned.
    used: usize,
    /// Number of bytes after `used` that contain no line end.
    searched: usize,
    /// Offset of `text` in the file; the end of the file, once there are no more lines.
    offset: usize,
    ended: bool,
}

impl<'a> Pieces<'a> {
    /// Bytes read at a time.
    const PIECE: usize = 1 << 20;
    /// Limit on the bytes before the rows: 4096 joints take less than a quarter.
    const MAX_HEADER: usize = 4 << 20;

    fn new(file: &'a mut dyn Read) -> Self {
        Self {
            file,
            text: Vec::new(),
            used: 0,
            searched: 0,
            offset: 0,
            ended: false,
        }
    }

    /// Drops the text that was returned.
    fn forget_used(&mut self) {
        self.text.drain(..self.used);
        self.offset += std::mem::take(&mut self.used);
    }

    /// Reads one more piece.
    fn read(&mut self) -> Result<(), Rejected> {
        self.forget_used();
        let before = self.text.len();
        self.file
            .take(Self::PIECE as u64)
            .read_to_end(&mut self.text)
            .map_err(|error| rejected!("E-IO", "cannot read the file: {error}"))?;
        self.ended = self.text.len() - before < Self::PIECE;
        Ok(())
    }

    /// The file without its rows.
    fn header(&mut self) -> Result<BvhFile, Rejected> {
        loop {
            self.read()?;
            let last = self.ended || self.text.len() >= Self::MAX_HEADER;
            match BvhFile::parse_header(&self.text) {
                // The frame time may continue in the next piece.
                Ok((bvh, at)) if last || at < self.text.len() => {
                    self.used = at;
                    return Ok(bvh);
                }
                Err(rejected) if last => return Err(rejected),
                _ => {}
            }
        }
    }

    /// The next whole lines with their byte offset; at the end of the file the remaining text, and then `None`.
    fn lines(&mut self) -> Result<Option<(usize, &[u8])>, Rejected> {
        loop {
            self.forget_used();
            let last = self.text[self.searched..]
                .iter()
                .rposition(|byte| is_line_end(*byte));
            let end = match last {
                Some(last) => self.searched + last + 1,
                None if self.ended => self.text.len(),
                None => 0,
            };
            self.searched = self.text.len() - end;
            if end > 0 {
                self.used = end;
                return Ok(Some((self.offset, &self.text[..end])));
            }
            if self.ended {
                return Ok(None);
            }
            self.read()?;
        }
    }
}
