//! The `MOTION` section: frame time and rows of values.

use datasets_spec::Fps;

use super::cursor::{Cursor, number, parse_number, shown};
use crate::source::format::too_short;
use clip::{MAX_FPS, MIN_FPS, Rejected, rejected};

pub(super) fn parse_frame_time(cursor: &mut Cursor) -> Result<Fps, Rejected> {
    cursor.keyword("FRAME TIME:")?;
    let (at, word) = cursor.word();
    parse_number(word)
        .filter(|secs| (1.0 / MAX_FPS..=1.0 / MIN_FPS).contains(secs))
        .and_then(|secs| Fps::from_file(1.0 / secs).ok())
        .ok_or_else(|| {
            rejected!(
                "E-BVH-FRAME-TIME",
                "found a frame time of {} s, expected {} to {} s",
                shown(word),
                1.0 / MAX_FPS,
                1.0 / MIN_FPS
            )
            .at(at)
        })
}

/// The rows of the motion, parsed piece by piece. One line is one frame; wrapped rows are accepted if the number of
/// values matches the header.
pub(super) struct Rows {
    num_frames: usize,
    num_channels: usize,
    values: Vec<f64>,
    num_rows: usize,
    /// The first row of wrong length: its number, its number of values and its byte offset.
    odd_row: Option<(usize, usize, usize)>,
    first_extra_row: Option<usize>,
}

impl Rows {
    /// Rows that a header announces. `length` is the text's length in bytes.
    pub(super) fn new(num_frames: usize, num_channels: usize, length: usize) -> Self {
        // Every value takes a digit and a separator, so the file's length limits the allocation that a
        // wrong header can cause.
        let expected = num_frames.saturating_mul(num_channels);
        Self {
            num_frames,
            num_channels,
            values: Vec::with_capacity(expected.min(length / 2 + 1)),
            num_rows: 0,
            odd_row: None,
            first_extra_row: None,
        }
    }

    /// Reads the next lines. Only at the end of the file may the last line lack its line end. `offset` is the byte
    /// offset of `bytes` in the file.
    pub(super) fn take(&mut self, bytes: &[u8], offset: usize) -> Result<(), Rejected> {
        let mut at = 0;
        while at < bytes.len() {
            let row_start = self.values.len();
            let row_at = at;
            loop {
                while at < bytes.len() && bytes[at].is_ascii_whitespace() && !is_line_end(bytes[at])
                {
                    at += 1;
                }
                if at == bytes.len() || is_line_end(bytes[at]) {
                    at += 1;
                    break;
                }
                let start = at;
                while at < bytes.len() && !bytes[at].is_ascii_whitespace() {
                    at += 1;
                }
                let token = &bytes[start..at];
                let value = parse_number(token).ok_or_else(|| number(offset + start, token))?;
                self.values.push(value);
            }
            let in_row = self.values.len() - row_start;
            if in_row == 0 {
                continue;
            }
            if in_row != self.num_channels && self.odd_row.is_none() {
                self.odd_row = Some((self.num_rows + 1, in_row, offset + row_at));
            }
            if self.num_rows == self.num_frames && self.first_extra_row.is_none() {
                self.first_extra_row = Some(offset + row_at);
            }
            self.num_rows += 1;
        }
        Ok(())
    }

    /// All values. If `lenient`, any number of complete rows is accepted, provided the header states at least one.
    pub(super) fn finish(self, lenient: bool, file_end: usize) -> Result<Vec<f64>, Rejected> {
        let (num_frames, num_channels) = (self.num_frames, self.num_channels);
        let Self { values, .. } = self;
        let expected = num_frames.saturating_mul(num_channels);
        // Frames may be wrapped over several rows. But if there are as many rows as frames, and some have another length,
        // one lacks a value and another has one too many.
        let is_shifted = self.odd_row.is_some() && self.num_rows == num_frames;
        let accepted =
            (values.len() == expected && !is_shifted) || (lenient && self.odd_row.is_none());
        if accepted && num_frames > 0 && !values.is_empty() {
            return Ok(values);
        }
        if values.is_empty() && num_frames == 0 {
            return Err(too_short(0).at(file_end));
        }
        let counts = format!(
            "found {} rows of motion, expected {num_frames} as `Frames:` says",
            self.num_rows
        );
        let hint = match self.odd_row {
            None if !lenient => "; `stance ingest --lenient` reads the rows that both agree on",
            _ => "",
        };
        let (reason, at) = match (self.odd_row, self.first_extra_row) {
            (Some((row, found, at)), _) => (
                format!("{counts}; row {row} holds {found} values, expected {num_channels}"),
                at,
            ),
            (None, Some(at)) => (counts + hint, at),
            (None, None) => (counts + hint, file_end),
        };
        Err(Rejected::read("E-BVH-FRAMES", reason).at(at))
    }
}

pub(super) fn is_line_end(byte: u8) -> bool {
    byte == b'\n' || byte == b'\r'
}
