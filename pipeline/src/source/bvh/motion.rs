//! The `MOTION` section: frame time and rows of values.

use datasets_spec::Fps;

use super::cursor::{Cursor, number, parse_number, shown};
use crate::clip::{MAX_FPS, MIN_FPS, Rejected};

pub(super) fn parse_frame_time(cursor: &mut Cursor) -> Result<Fps, Rejected> {
    cursor.keyword("FRAME TIME:")?;
    let (at, word) = cursor.word();
    parse_number(word)
        .filter(|secs| (1.0 / MAX_FPS..=1.0 / MIN_FPS).contains(secs))
        .and_then(|secs| Fps::from_file(1.0 / secs).ok())
        .ok_or_else(|| {
            Rejected::read(
                "E-BVH-FRAME-TIME",
                format!(
                    "found a frame time of {} s, expected {} to {} s",
                    shown(word),
                    1.0 / MAX_FPS,
                    1.0 / MIN_FPS
                ),
            )
            .at(at)
        })
}

/// Reads all values. One line is one frame; wrapped rows are accepted if the number of values is
/// what the header says.
pub(super) fn parse_rows(
    cursor: &mut Cursor,
    num_frames: usize,
    num_channels: usize,
) -> Result<Vec<f64>, Rejected> {
    let bytes = cursor.bytes;
    let mut at = cursor.at;
    // Every value takes a digit and a separator, so the file's length limits the allocation that a
    // wrong header can cause.
    let expected = num_frames.saturating_mul(num_channels);
    let mut values = Vec::with_capacity(expected.min((bytes.len() - at) / 2 + 1));
    let mut num_rows = 0usize;
    let mut odd_row = None;
    let mut first_extra_row = None;
    while at < bytes.len() {
        let row_start = values.len();
        let row_at = at;
        loop {
            while at < bytes.len() && bytes[at].is_ascii_whitespace() && !is_line_end(bytes[at]) {
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
            values.push(parse_number(token).ok_or_else(|| number(start, token))?);
        }
        let in_row = values.len() - row_start;
        if in_row == 0 {
            continue;
        }
        if in_row != num_channels && odd_row.is_none() {
            odd_row = Some((num_rows + 1, in_row, row_at));
        }
        if num_rows == num_frames && first_extra_row.is_none() {
            first_extra_row = Some(row_at);
        }
        num_rows += 1;
    }
    cursor.at = bytes.len();
    if values.len() == expected && num_frames > 0 {
        return Ok(values);
    }
    if values.is_empty() && num_frames == 0 {
        return Err(
            Rejected::read("E-TOO-SHORT", "found 0 frames, expected at least 2").at(bytes.len()),
        );
    }
    let counts =
        format!("found {num_rows} rows of motion, expected {num_frames} as `Frames:` says");
    let (reason, at) = match (odd_row, first_extra_row) {
        (Some((row, found, at)), _) => (
            format!("{counts}; row {row} holds {found} values, expected {num_channels}"),
            at,
        ),
        (None, Some(at)) => (counts, at),
        (None, None) => (counts, bytes.len()),
    };
    Err(Rejected::read("E-BVH-FRAMES", reason).at(at))
}

fn is_line_end(byte: u8) -> bool {
    byte == b'\n' || byte == b'\r'
}
