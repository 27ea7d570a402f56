//! The TRC reader: marker positions of OpenSim, Theia, Cortex and others, as text.
//!
//! Five lines come first: the kind of file, names and values of its settings, the names of the markers, and
//! the names of the coordinates. Each row after them is a frame: its number, its time and three coordinates
//! of every marker. A marker that was not seen has blank cells, `NaN` or, as some programs write, zeros.
//!
//! # Source
//! OpenSim's documentation of its `.trc` files.

mod header;
mod rows;
#[cfg(test)]
mod tests;

use self::header::{Header, Lines, MAGIC};
use self::rows::Rows;
use super::format::{Format, too_short};
use super::head::UTF8_BOM;
use super::options::ReadOptions;
use crate::markers::{self, Capture, CaptureUnit, MAX_DISTANCE_M, Positions, UNIT_CODE};
use clip::check::{FLAG_FPS_DOUBTFUL, FLAG_ROW_COUNT};
use clip::{Rejected, rejected};

/// The markers of a file. A unit in the options replaces the one that the file states. If the options are lenient, the
/// number of rows may differ from the header's; rows beyond the stated number are dropped.
///
/// # Errors
/// `E-TRC-HEADER`, `E-TRC-NAMES`, `E-TRC-ROW`, `E-TRC-NUMBER`, `E-TRC-TIME` or `E-TRC-FRAMES`, each with a byte offset;
/// `E-UNIT`, `E-TRC-EMPTY` or `E-TOO-SHORT`.
pub fn capture(bytes: &[u8], options: &ReadOptions) -> Result<Capture, Rejected> {
    let mut lines = Lines::of(bytes);
    let header = Header::parse(&mut lines)?;
    let mut rows = Rows::parse(&mut lines, &header)?;
    let mut notes = Vec::new();
    let mut flags = 0;
    if rows.len() == 0 {
        return Err(too_short(0).at(bytes.len()));
    }
    if let Some(note) = cut_to_stated(&mut rows, header.num_frames, options.lenient, bytes.len())? {
        flags |= FLAG_ROW_COUNT;
        notes.push(note);
    }
    let (fps, note) = rows.rate(header.rate)?;
    if let Some(note) = note {
        flags |= FLAG_FPS_DOUBTFUL;
        notes.push(note);
    }
    let seen = rows.positions.iter().flatten().copied();
    let (unit, note) = CaptureUnit::find(options.unit, &header.unit, seen);
    notes.extend(note);
    let positions = in_metres(&rows, &header, unit)?;
    let (markers, note) = positions.markers(fps, header.labels());
    notes.extend(note);
    if rows.num_zeros > 0 {
        notes.push(format!(
            "{} positions of three zeros count as not seen",
            rows.num_zeros
        ));
    }
    Ok(Capture {
        markers,
        unit,
        notes,
        flags,
    })
}

/// Drops the rows beyond the number that the header states, and returns a note on them. A different number of rows is
/// an error unless `lenient`.
fn cut_to_stated(
    rows: &mut Rows,
    stated: usize,
    lenient: bool,
    end: usize,
) -> Result<Option<String>, Rejected> {
    let found = rows.len();
    if found == stated {
        return Ok(None);
    }
    if !lenient || stated == 0 {
        return Err(rejected!(
            "E-TRC-FRAMES",
            "found {found} rows, expected {stated} as NumFrames says; `stance ingest \
                 --lenient` reads the rows that both agree on"
        )
        .at(rows.place_of(stated).unwrap_or(end)));
    }
    rows.truncate(stated);
    Ok(Some(format!(
        "the header says {stated} frames and {found} rows follow; {} were read",
        rows.len()
    )))
}

fn in_metres(rows: &Rows, header: &Header, unit: CaptureUnit) -> Result<Positions, Rejected> {
    let metres = unit.unit.metres();
    let mut positions = Positions::default();
    for point in &rows.positions {
        positions.add(point.map(|point| (point * metres, 0.0)));
    }
    let (seen, far) = (positions.seen, positions.far);
    if positions.are_implausible() {
        let frames = rows.positions.chunks(header.names.len().max(1));
        let frames = frames.map(|frame| frame.iter().flatten().copied());
        let found = || {
            let reason = format!("found {far} of {seen} positions farther than {MAX_DISTANCE_M} m");
            rejected!(UNIT_CODE, "{reason} in {}, {}", unit.unit, unit.said)
        };
        return Err(unit.doubt(frames).unwrap_or_else(found).at(header.unit_at));
    }
    if far == seen {
        return Err(rejected!(
            "E-TRC-EMPTY",
            "no marker is seen in {} frames of {} markers, expected a capture",
            rows.len(),
            header.names.len()
        )
        .at(header.names_at));
    }
    Ok(positions)
}

/// TRC: marker positions as text.
// Bytes per second: 40 markers of three coordinates of ten characters at 100 fps.
pub const FORMAT: Format = Format {
    extensions: &["trc"],
    by_content: |head| {
        let text = head.strip_prefix(UTF8_BOM).unwrap_or(head);
        text.trim_ascii_start().starts_with(MAGIC)
    },
    keys: Some(|bytes, options| {
        let header = Header::parse(&mut Lines::of(bytes));
        let labels = header.map(|header| header.labels()).unwrap_or_default();
        markers::keys(&labels, options.markers.as_ref())
    }),
    capture: Some(|bytes, options| capture(bytes, options).map(Some)),
    read: |_, key, bytes, options| {
        let clip = capture(bytes, options).and_then(|capture| capture.clip(key, options));
        clip.into()
    },
    ..Format::of_files(
        "trc",
        ".trc, or text that begins with PathFileType: markers of OpenSim, Theia, Cortex; one motion for each person \
         in it; fitted to the markers, which are kept",
        120_000.0,
    )
};
