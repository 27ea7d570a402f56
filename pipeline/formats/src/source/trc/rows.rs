//! The rows: times and positions.

use datasets_spec::Fps;
use glam::DVec3;

use super::header::{Header, Line, Lines};
use crate::source::format::plausible_fps;
use crate::source::names::shown;
use clip::{Rejected, rejected};

/// Columns before the coordinates: number and time of the frame.
const BEFORE: usize = 2;
/// Relative difference up to which the rate agrees with the times, and seconds to which times are rounded.
const RATE_TOLERANCE: f64 = 0.01;
const ROUNDING_S: f64 = 1e-3;

/// The frames of a file.
#[derive(Default)]
pub(super) struct Rows {
    num_markers: usize,
    places: Vec<usize>,
    times: Vec<Option<f64>>,
    /// Positions in the file's unit, frame by frame; `None` for a marker that was not seen.
    pub(super) positions: Vec<Option<DVec3>>,
    /// Positions of three zeros, which count as not seen.
    pub(super) num_zeros: usize,
}

impl Rows {
    pub(super) fn parse(lines: &mut Lines<'_>, header: &Header) -> Result<Self, Rejected> {
        let mut rows = Self {
            num_markers: header.names.len(),
            ..Self::default()
        };
        for line in lines {
            rows.take(line)?;
        }
        Ok(rows)
    }

    fn take(&mut self, line: Line<'_>) -> Result<(), Rejected> {
        let mut cells = line.cells();
        let expected = BEFORE + 3 * self.num_markers;
        let found = cells.len();
        // Some programs end every row with a tab, others leave out the blank cells at its end.
        while cells.len() != expected && cells.last().is_some_and(|(_, cell)| cell.is_empty()) {
            cells.pop();
        }
        let lacks_markers = cells.len() >= BEFORE && (cells.len() - BEFORE).is_multiple_of(3);
        let may_lack = line.is_whole && line.text.contains(&b'\t');
        if cells.len() > expected || (cells.len() < expected && !(lacks_markers && may_lack)) {
            let row = self.len() + 1;
            return Err(rejected!(
                "E-TRC-ROW",
                "row {row} holds {found} cells, expected {expected}: number, time and three \
                     coordinates of {} markers",
                self.num_markers
            )
            .at(line.at));
        }
        let mut numbers = Vec::with_capacity(expected);
        for (at, cell) in &cells {
            numbers.push(number(*at, cell)?);
        }
        numbers.resize(expected, None);
        if let Some(time) = numbers[1] {
            let before = self.times.iter().rev().flatten().next();
            if before.is_some_and(|before| time <= *before) {
                let row = self.len() + 1;
                let before = before.copied().unwrap_or_default();
                return Err(rejected!(
                    "E-TRC-TIME",
                    "row {row} is at {time} s, which is not after {before} s"
                )
                .at(cells[1].0));
            }
        }
        self.places.push(line.at);
        self.times.push(numbers[1]);
        for (marker, point) in numbers[BEFORE..].chunks_exact(3).enumerate() {
            let position = match *point {
                [Some(x), Some(y), Some(z)] => Some(DVec3::new(x, y, z)),
                [None, None, None] => None,
                _ => {
                    let row = self.len();
                    let at = cells.get(BEFORE + 3 * marker);
                    return Err(rejected!(
                        "E-TRC-ROW",
                        "row {row} holds some and not all coordinates of marker {}",
                        marker + 1
                    )
                    .at(at.map_or(line.at, |(at, _)| *at)));
                }
            };
            // A marker at the very origin is a gap that the program filled with zeros.
            let is_zero = position == Some(DVec3::ZERO);
            self.num_zeros += usize::from(is_zero);
            self.positions.push(position.filter(|_| !is_zero));
        }
        Ok(())
    }

    /// Number of frames.
    pub(super) fn len(&self) -> usize {
        self.places.len()
    }

    /// Byte offset of a row.
    pub(super) fn place_of(&self, row: usize) -> Option<usize> {
        self.places.get(row).copied()
    }

    /// Drops the rows after the first `len`.
    pub(super) fn truncate(&mut self, len: usize) {
        self.places.truncate(len);
        self.times.truncate(len);
        self.positions.truncate(len * self.num_markers);
    }

    /// The stated rate, else that of the times; and a note if the rate is doubtful.
    pub(super) fn rate(&self, stated: Option<f64>) -> Result<(Fps, Option<String>), Rejected> {
        let span = self.span();
        let rate = stated.or(span.map(|(steps, secs)| steps / secs));
        let fps = rate.and_then(plausible_fps).ok_or_else(|| {
            let reason =
                "found neither a DataRate nor times that give a rate, expected one of them";
            Rejected::read("E-TRC-HEADER", reason)
        })?;
        let note = match (stated, span) {
            (Some(stated), Some((steps, secs))) => {
                let expected = steps / stated;
                let is_off = (secs - expected).abs() > RATE_TOLERANCE * expected + ROUNDING_S;
                is_off.then(|| {
                    let times = steps / secs;
                    format!(
                        "DataRate is {stated} fps, the times are {times:.3} fps; DataRate was taken"
                    )
                })
            }
            (None, _) => Some("the rate is that of the times; the file states none".to_owned()),
            _ => None,
        };
        Ok((fps, note))
    }

    /// Number of steps from the first frame to the last, and the seconds between them; `None` if a time is missing.
    fn span(&self) -> Option<(f64, f64)> {
        let steps = self.len().checked_sub(1).filter(|steps| *steps > 0)?;
        let (first, last) = ((*self.times.first()?)?, (*self.times.last()?)?);
        Some((steps as f64, last - first))
    }
}

/// The number in a cell; `None` if the cell is blank or `NaN`.
fn number(at: usize, cell: &[u8]) -> Result<Option<f64>, Rejected> {
    if cell.is_empty() || cell.eq_ignore_ascii_case(b"nan") {
        return Ok(None);
    }
    let parsed = fast_float2::parse::<f64, _>(cell).ok();
    let finite = parsed.filter(|number| number.is_finite());
    finite.map(Some).ok_or_else(|| {
        rejected!(
            "E-TRC-NUMBER",
            "found {}, expected a finite number or a blank cell",
            shown(cell)
        )
        .at(at)
    })
}
