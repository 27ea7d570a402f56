//! The C3D reader: marker positions of an optical capture, in the number formats of Intel, DEC and MIPS processors.
//!
//! A C3D file consists of blocks of 512 bytes: a header, a section of parameters and the frames. They often contradict
//! each other: the parameters take precedence over the header, and the length of the file over both.
//!
//! # Source
//! The C3D user guide of c3d.org; formats of the VAX as DEC documents them.

mod parameters;

use datasets_spec::Fps;
use glam::DVec3;

use self::parameters::{BLOCK, Parameters, Processor};
use super::format::{Format, plausible_fps};
use super::options::ReadOptions;
use crate::markers::{
    self, Capture, CaptureUnit, MAX_DISTANCE_M, MarkerSet, Positions, UNIT_CODE, model_outputs,
    some_of,
};
use clip::{Outcome, Rejected, rejected};

/// Second byte of every C3D file.
const MAGIC: u8 = 0x50;
/// Limit on points per frame; real captures have a few hundred.
const MAX_POINTS: usize = 10_000;

fn header_error(at: usize, reason: impl Into<String>) -> Rejected {
    Rejected::read("E-C3D-HEADER", reason).at(at)
}

/// The markers of a file; `None` if it has no markers. A unit in the options replaces the one that the file states.
///
/// # Errors
/// `E-C3D-TRUNCATED`, `E-C3D-HEADER`, `E-C3D-PARAM`, `E-C3D-ENDIAN`, `E-C3D-ZERO` or `E-UNIT`, with the byte offset if
/// there is one.
pub fn capture(bytes: &[u8], options: &ReadOptions) -> Result<Option<Capture>, Rejected> {
    let (processor, parameters) = parameters(bytes)?;
    let header = Header::read(bytes, processor);
    let Some(layout) = Layout::find(bytes, &header, &parameters)? else {
        return Ok(None);
    };
    layout.read(bytes, processor, &parameters, options)
}

/// The processor of a file and its parameters.
fn parameters(bytes: &[u8]) -> Result<(Processor, Parameters<'_>), Rejected> {
    if bytes.len() < BLOCK {
        return Err(rejected!(
            "E-C3D-TRUNCATED",
            "found {} bytes, expected a header of {BLOCK}",
            bytes.len()
        )
        .at(bytes.len()));
    }
    if bytes[1] != MAGIC {
        let reason = format!("found 0x{:02x}, expected 0x{MAGIC:02x}", bytes[1]);
        return Err(header_error(1, reason));
    }
    let start = usize::from(bytes[0]).saturating_sub(1) * BLOCK;
    let section = bytes.get(start..start + 4).filter(|_| start > 0);
    let Some(&[_, _, _, code]) = section else {
        let block = bytes[0];
        let reason = format!("the parameters are said to be in block {block}, which is none");
        return Err(header_error(0, reason));
    };
    let processor = Processor::of(code).ok_or_else(|| {
        let reason = format!("found processor {code}, expected 84 (Intel), 85 (DEC) or 86 (MIPS)");
        header_error(start + 3, reason)
    })?;
    let parameters = Parameters::parse(bytes, start, processor)?;
    Ok((processor, parameters))
}

/// Contents of the header block.
struct Header {
    points: usize,
    analog_per_frame: usize,
    frames: usize,
    scale: f64,
    data_block: usize,
    rate: f64,
}

impl Header {
    fn read(bytes: &[u8], processor: Processor) -> Self {
        // Words are counted from one; a real number takes two, of which the first is odd.
        let word = |number: usize| processor.u16(bytes.as_chunks().0[number - 1]);
        let real = |number: usize| processor.f32(bytes.as_chunks().0[(number - 1) / 2]);
        let (first, last) = (usize::from(word(4)), usize::from(word(5)));
        Self {
            points: word(2).into(),
            analog_per_frame: word(3).into(),
            frames: (last + 1).saturating_sub(first),
            scale: real(7).into(),
            data_block: word(9).into(),
            rate: real(11).into(),
        }
    }
}

/// Layout of the frames.
struct Layout {
    start: usize,
    points: usize,
    /// Size of a number in bytes: whole numbers take 2, real numbers 4.
    value_size: usize,
    /// Size of a frame in bytes: its points, and the analogue values that follow them.
    frame_size: usize,
    frames: usize,
    scale: f64,
    fps: Fps,
    notes: Vec<String>,
}

impl Layout {
    fn find(
        bytes: &[u8],
        header: &Header,
        parameters: &Parameters<'_>,
    ) -> Result<Option<Self>, Rejected> {
        let mut notes = Vec::new();
        let stated = |name: &str| parameters.number("POINT", name);
        let points = match stated("USED") {
            Some(used) if used >= 0.0 => used as usize,
            _ => header.points,
        };
        if points == 0 {
            return Ok(None);
        }
        if points > MAX_POINTS {
            let reason = format!("found {points} points, expected at most {MAX_POINTS}");
            return Err(header_error(2, reason));
        }
        let scale = stated("SCALE")
            .filter(|scale| *scale != 0.0)
            .unwrap_or(header.scale);
        if !scale.is_finite() || scale == 0.0 {
            let reason = format!("found a scale of {scale}, expected another");
            return Err(header_error(12, reason));
        }
        let fps = stated("RATE").and_then(plausible_fps);
        let fps = fps.or_else(|| plausible_fps(header.rate)).ok_or_else(|| {
            let found = header.rate;
            let reason = format!("found {found} frames a second, expected a rate");
            header_error(20, reason)
        })?;
        let start = data_start(bytes, header, parameters, &mut notes)?;
        let value_size = if scale < 0.0 { 4 } else { 2 };
        let frame_size = (4 * points + header.analog_per_frame) * value_size;
        let room = (bytes.len() - start) / frame_size;
        let frames = frame_count(header, parameters, room, &mut notes)?;
        Ok(Some(Self {
            start,
            points,
            value_size,
            frame_size,
            frames,
            scale,
            fps,
            notes,
        }))
    }

    fn read(
        mut self,
        bytes: &[u8],
        processor: Processor,
        parameters: &Parameters<'_>,
        options: &ReadOptions,
    ) -> Result<Option<Capture>, Rejected> {
        let by_user = options.unit;
        let own = options.markers.as_ref();
        let (labels, kept, note) = labels_of_markers(parameters, self.points, own);
        if labels.is_empty() {
            return Ok(None);
        }
        self.notes.extend(note);
        let raw = self.raw_positions(bytes, processor);
        let stated = parameters.text("POINT", "UNITS").unwrap_or_default();
        let seen = raw.iter().filter(|point| point.residual >= 0.0);
        let seen = seen.map(|point| point.at);
        let (unit, note) = CaptureUnit::find(by_user, stated.trim(), seen);
        self.notes.extend(note);
        let metres = unit.unit.metres();
        let frames = raw.chunks_exact(self.points);
        let frames = frames.map(|frame| kept.iter().map(move |point| frame[*point]));
        let mut positions = Positions::default();
        let mut at_origin = 0;
        for point in frames.clone().flatten() {
            let is_seen = point.is_seen();
            at_origin += usize::from(point.residual >= 0.0 && !is_seen);
            positions.add(is_seen.then(|| (point.at * metres, point.residual * metres)));
        }
        let (seen, far) = (positions.seen, positions.far);
        if positions.are_implausible() {
            let frames =
                frames.map(|frame| frame.filter(|point| point.is_seen()).map(|point| point.at));
            let other = || {
                if by_user.is_some() {
                    return rejected!(
                        UNIT_CODE,
                        "found {far} of {seen} positions farther than {MAX_DISTANCE_M} m in unit {}, as --unit says; the file says \
                         {stated:?}: leave --unit out, or name another",
                        unit.unit
                    )
                    .at(self.start);
                }
                rejected!(
                    "E-C3D-ENDIAN",
                    "found {far} of {seen} positions farther than {MAX_DISTANCE_M} m; the file says \
                     {processor:?}, and its numbers are another processor's"
                )
                .at(self.start)
            };
            return Err(unit.doubt(frames).unwrap_or_else(other));
        }
        let places = &positions.places;
        if !places.is_empty() && places.iter().all(|place| *place == [0.0; 3]) {
            return Err(rejected!(
                "E-C3D-ZERO",
                "all coordinates are zero in {} positions, {seen} of them seen; expected a capture",
                places.len()
            )
            .at(self.start));
        }
        let (markers, note) = positions.markers(self.fps, labels);
        self.notes.extend(note);
        if at_origin > 0 {
            let note = format!("{at_origin} positions at the origin count as not seen");
            self.notes.push(note);
        }
        Ok(Some(Capture {
            markers,
            unit,
            notes: self.notes,
            flags: 0,
        }))
    }

    /// Every point of every frame in the file's unit.
    fn raw_positions(&self, bytes: &[u8], processor: Processor) -> Vec<Point> {
        let size = self.value_size;
        let data = &bytes[self.start..self.start + self.frames * self.frame_size];
        let mut points = Vec::with_capacity(self.frames * self.points);
        for frame in data.chunks_exact(self.frame_size) {
            for point in frame[..4 * self.points * size].chunks_exact(4 * size) {
                points.push(Point::read(point, processor, self.scale));
            }
        }
        points
    }
}

/// A point in the file's unit; the residual is negative if it was not seen.
#[derive(Clone, Copy)]
struct Point {
    at: DVec3,
    residual: f64,
}

impl Point {
    /// Reads a point: three coordinates and its residual. They are real numbers if the scale is negative, otherwise
    /// integers in units of the scale.
    fn read(bytes: &[u8], processor: Processor, scale: f64) -> Self {
        let is_real = scale < 0.0;
        let value = |index: usize| match is_real {
            true => f64::from(processor.f32(bytes.as_chunks().0[index])),
            false => f64::from(processor.i16(bytes.as_chunks().0[index])),
        };
        let at = DVec3::new(value(0), value(1), value(2));
        let at = if is_real { at } else { at * scale };
        // The fourth number is an integer: cameras in its high byte, the residual in its low byte.
        let packed = value(3);
        let residual = if packed < 0.0 || !packed.is_finite() || !at.is_finite() {
            -1.0
        } else {
            f64::from(packed.min(f64::from(u16::MAX)) as u16 & 0xFF) * scale.abs()
        };
        Self { at, residual }
    }

    /// Whether the point was seen. Some programs write unseen points at the origin with a valid residual.
    fn is_seen(self) -> bool {
        self.residual >= 0.0 && self.at != DVec3::ZERO
    }
}

/// Byte offset of the frames. `POINT:DATA_START` states it. If that names no block where frames can be, the header does.
fn data_start(
    bytes: &[u8],
    header: &Header,
    parameters: &Parameters<'_>,
    notes: &mut Vec<String>,
) -> Result<usize, Rejected> {
    let by_header = Some(header.data_block).filter(|block| *block > 0);
    let by_parameter = parameters.count("POINT", "DATA_START");
    let of_parameters = usize::from(bytes[0]);
    let num_blocks = bytes.len().div_ceil(BLOCK);
    let claims = [
        by_parameter.filter(|block| *block != of_parameters),
        by_header,
    ];
    let in_file = |block: &usize| (2..=num_blocks).contains(block);
    let block = claims.into_iter().flatten().find(in_file).ok_or_else(|| {
        let claimed = by_header.or(by_parameter).unwrap_or(0);
        rejected!(
            "E-C3D-TRUNCATED",
            "the frames are said to be in block {claimed}, the file has {num_blocks}"
        )
        .at(bytes.len())
    })?;
    if let Some(other) = by_header.filter(|other| *other != block && in_file(other)) {
        notes.push(format!(
            "the frames begin in block {block}, as POINT:DATA_START says; the header says {other}"
        ));
    }
    Ok((block - 1) * BLOCK)
}

/// Number of frames: the first that fits into the file, from the parameters (for long captures in two words or as a
/// real number), then from the header.
fn frame_count(
    header: &Header,
    parameters: &Parameters<'_>,
    room: usize,
    notes: &mut Vec<String>,
) -> Result<usize, Rejected> {
    let field = |name: &str| parameters.long("TRIAL", name);
    let trial = match (field("ACTUAL_START_FIELD"), field("ACTUAL_END_FIELD")) {
        (Some(first), Some(last)) if last >= first => Some(last - first + 1),
        _ => None,
    };
    let whole = |name: &str| parameters.count("POINT", name);
    let claims = [
        ("TRIAL:ACTUAL fields", trial),
        ("POINT:LONG_FRAMES", whole("LONG_FRAMES")),
        ("POINT:FRAMES", whole("FRAMES")),
        ("header", Some(header.frames).filter(|frames| *frames > 0)),
    ];
    let first = claims.iter().find_map(|(_, claim)| *claim);
    let fits = claims
        .iter()
        .find_map(|(name, claim)| Some((*name, claim.filter(|frames| *frames <= room)?)));
    match (first, fits) {
        (Some(first), Some((name, frames))) => {
            if first != frames {
                notes.push(format!(
                    "{frames} frames by {name}; {first} claimed elsewhere"
                ));
            }
            Ok(frames)
        }
        (Some(first), None) => Err(rejected!(
            "E-C3D-TRUNCATED",
            "found room for {room} frames, expected {first}"
        )),
        _ => Err(header_error(6, "found no number of frames")),
    }
}

/// A unique name for each point.
fn labels(parameters: &Parameters<'_>, points: usize) -> Vec<String> {
    let further = (2..).map(|number| format!("LABELS{number}"));
    let names = std::iter::once("LABELS".to_owned()).chain(further);
    let stated = names.map_while(|name| parameters.texts("POINT", &name));
    let stated: Vec<String> = stated.flatten().collect();
    let label = |point: usize| {
        let label = stated.get(point).map(|label| label.trim());
        match label.unwrap_or_default() {
            "" => format!("point{}", point + 1),
            label => label.to_owned(),
        }
    };
    markers::unique_labels((0..points).map(label))
}

/// Names of the points that are markers, which points these are, and a note on the others.
fn labels_of_markers(
    parameters: &Parameters<'_>,
    points: usize,
    own: Option<&MarkerSet>,
) -> (Vec<String>, Vec<usize>, Option<String>) {
    let labels = labels(parameters, points);
    let outputs = model_outputs(&labels, &parameters.model_outputs(), own);
    let kept: Vec<usize> = (0..points)
        .filter(|point| !outputs.contains(&labels[*point]))
        .collect();
    let note = (!outputs.is_empty()).then(|| {
        let outputs = some_of(outputs.iter().map(|label| label.as_str()));
        format!("left out as outputs of a model, not markers: {outputs}")
    });
    let markers = kept.iter().map(|point| labels[*point].clone()).collect();
    (markers, kept, note)
}

/// Names of the markers of a file; `None` if it cannot be read or has no points.
fn marker_labels(bytes: &[u8], own: Option<&MarkerSet>) -> Option<Vec<String>> {
    let (processor, parameters) = parameters(bytes).ok()?;
    let header = Header::read(bytes, processor);
    let layout = Layout::find(bytes, &header, &parameters).ok()??;
    Some(labels_of_markers(&parameters, layout.points, own).0)
}

/// C3D: marker positions of an optical capture.
// Bytes per second: measured on 24 captures.
pub const FORMAT: Format = Format {
    extensions: &["c3d"],
    keys: Some(|bytes, options| {
        let own = options.markers.as_ref();
        let labels = marker_labels(bytes, own).unwrap_or_default();
        markers::keys(&labels, own)
    }),
    capture: Some(capture),
    read: |_, key, bytes, options| match capture(bytes, options) {
        Ok(Some(capture)) => capture.clip(key, options).into(),
        Ok(None) => Outcome::Skipped {
            reason: "C3D without marker data".to_owned(),
        },
        Err(rejected) => Outcome::Rejected(rejected),
    },
    ..Format::of_files(
        "c3d",
        ".c3d of Intel, DEC and MIPS, whole and real numbers; one motion for each person in it; fitted to the \
         markers, which are kept",
        60_000.0,
    )
};

#[cfg(test)]
mod tests;
