//! The C3D reader: marker positions of an optical capture, from any of the three kinds of processor
//! that ever wrote the format.
//!
//! A C3D file consists of blocks of 512 bytes: a header, a section of parameters and the frames. They
//! often contradict each other: the parameters take precedence over the header, and the length of the
//! file over both.
//!
//! # Source
//! The C3D user guide of c3d.org; formats of the VAX as DEC documents them.

mod parameters;

use std::path::Path;

use datasets_spec::Fps;
use glam::DVec3;

use self::parameters::Parameters;
use super::format::{Format, Recognised, SourceFormat};
use super::options::ReadOptions;
use crate::clip::{MAX_FPS, MIN_FPS, Markers, Outcome, Rejected};
use crate::markers::{self, is_model_output};

/// Bytes of a block.
const BLOCK: usize = 512;
/// Second byte of every C3D file.
const MAGIC: u8 = 0x50;
/// Maximum distance in metres of a marker from the origin: a plausibility test for the number format.
const MAX_DISTANCE_M: f64 = 100.0;
/// Fraction of implausible positions above which the processor flag is taken to be wrong.
const MAX_IMPLAUSIBLE: f64 = 0.1;
/// Limit on points per frame; real captures have a few hundred.
const MAX_POINTS: usize = 10_000;

/// Number format of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Processor {
    /// Little-endian IEEE numbers.
    Intel,
    /// Little-endian whole numbers and VAX floating point.
    Dec,
    /// Big-endian IEEE numbers.
    Mips,
}

impl Processor {
    fn of(code: u8) -> Option<Self> {
        match code {
            84 => Some(Self::Intel),
            85 => Some(Self::Dec),
            86 => Some(Self::Mips),
            _ => None,
        }
    }

    fn u16(self, bytes: [u8; 2]) -> u16 {
        match self {
            Self::Intel | Self::Dec => u16::from_le_bytes(bytes),
            Self::Mips => u16::from_be_bytes(bytes),
        }
    }

    fn i16(self, bytes: [u8; 2]) -> i16 {
        self.u16(bytes) as i16
    }

    fn f32(self, bytes: [u8; 4]) -> f32 {
        match self {
            Self::Intel => f32::from_le_bytes(bytes),
            Self::Mips => f32::from_be_bytes(bytes),
            Self::Dec => {
                // Two little-endian words, the high one first, and an exponent that is two larger.
                let [b0, b1, b2, b3] = bytes;
                f32::from_be_bytes([b1, b0, b3, b2]) / 4.0
            }
        }
    }
}

/// A parsed capture.
#[derive(Clone, Debug)]
pub struct C3dFile {
    /// Number format of the file.
    pub processor: Processor,
    /// Whether the points are stored as scaled integers.
    pub integer: bool,
    /// The markers in metres, in the file's own axes.
    pub markers: Markers,
    /// Points that are not markers but angles, forces and the like, by name.
    pub model_outputs: Vec<String>,
    /// Decisions a reader may want to check.
    pub notes: Vec<String>,
}

fn header_error(at: usize, reason: impl Into<String>) -> Rejected {
    Rejected::read("E-C3D-HEADER", reason).at(at)
}

impl C3dFile {
    /// Parses a file. None if it holds no points.
    ///
    /// # Errors
    /// `E-C3D-TRUNCATED`, `E-C3D-HEADER`, `E-C3D-PARAM` or `E-C3D-ENDIAN`, with the byte offset
    /// where there is one.
    pub fn parse(bytes: &[u8]) -> Result<Option<Self>, Rejected> {
        if bytes.len() < BLOCK {
            return Err(Rejected::read(
                "E-C3D-TRUNCATED",
                format!("found {} bytes, expected a header of {BLOCK}", bytes.len()),
            )
            .at(bytes.len()));
        }
        if bytes[1] != MAGIC {
            return Err(header_error(
                1,
                format!("found 0x{:02x}, expected 0x{MAGIC:02x}", bytes[1]),
            ));
        }
        let start = usize::from(bytes[0]).saturating_sub(1) * BLOCK;
        let section = bytes.get(start..start + 4).filter(|_| start > 0);
        let Some(&[_, _, _, code]) = section else {
            return Err(header_error(
                0,
                format!(
                    "the parameters are said to be in block {}, which is none",
                    bytes[0]
                ),
            ));
        };
        let processor = Processor::of(code).ok_or_else(|| {
            header_error(
                start + 3,
                format!("found processor {code}, expected 84 (Intel), 85 (DEC) or 86 (MIPS)"),
            )
        })?;
        let parameters = Parameters::parse(bytes, start, processor)?;
        let header = Header::read(bytes, processor);
        Layout::find(bytes, &header, &parameters)?
            .map(|layout| layout.read(bytes, processor, &parameters))
            .transpose()
    }
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
        let word = |number: usize| {
            let at = 2 * (number - 1);
            processor.u16([bytes[at], bytes[at + 1]])
        };
        let real = |number: usize| {
            let at = 2 * (number - 1);
            processor.f32([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
        };
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
    /// Analogue values of a frame, after the points.
    analog: usize,
    frames: usize,
    scale: f64,
    fps: Fps,
    notes: Vec<String>,
}

impl Layout {
    fn find(
        bytes: &[u8],
        header: &Header,
        parameters: &Parameters,
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
            return Err(header_error(
                2,
                format!("found {points} points, expected at most {MAX_POINTS}"),
            ));
        }
        let scale = stated("SCALE")
            .filter(|scale| *scale != 0.0)
            .unwrap_or(header.scale);
        if !scale.is_finite() || scale == 0.0 {
            return Err(header_error(
                12,
                format!("found a scale of {scale}, expected another"),
            ));
        }
        let rate = [stated("RATE").unwrap_or(0.0), header.rate]
            .into_iter()
            .find(|rate| (MIN_FPS..=MAX_FPS).contains(rate))
            .ok_or_else(|| {
                header_error(
                    20,
                    format!("found {} frames a second, expected a rate", header.rate),
                )
            })?;
        let fps = Fps::from_file(rate)
            .map_err(|error| header_error(20, format!("no frame rate: {error}")))?;
        let data_block = match header.data_block {
            0 => stated("DATA_START").map_or(0, |block| block.max(0.0) as usize),
            block => block,
        };
        let start = data_block.saturating_sub(1) * BLOCK;
        if start < BLOCK || start >= bytes.len() {
            return Err(Rejected::read(
                "E-C3D-TRUNCATED",
                format!(
                    "the frames are said to be in block {data_block}, the file has {}",
                    bytes.len().div_ceil(BLOCK)
                ),
            )
            .at(bytes.len()));
        }
        let value_size = if scale < 0.0 { 4 } else { 2 };
        let analog = header.analog_per_frame;
        let frame_size = (4 * points + analog) * value_size;
        let room = (bytes.len() - start) / frame_size;
        let frames = frame_count(header, parameters, room, &mut notes)?;
        Ok(Some(Self {
            start,
            points,
            analog,
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
        parameters: &Parameters,
    ) -> Result<C3dFile, Rejected> {
        let labels = labels(parameters, self.points);
        let outputs = parameters.model_outputs();
        let kept: Vec<usize> = (0..self.points)
            .filter(|point| !outputs.contains(&labels[*point]) && !is_model_output(&labels[*point]))
            .collect();
        let units = parameters.text("POINT", "UNITS").unwrap_or_default();
        let raw = self.raw_positions(bytes, processor);
        let metres = metres_of(units.trim(), &raw, &mut self.notes);

        let mut positions = Vec::with_capacity(self.frames * kept.len());
        let mut residuals = Vec::with_capacity(self.frames * kept.len());
        let (mut seen, mut implausible) = (0usize, 0usize);
        for frame in raw.chunks_exact(self.points) {
            for &point in &kept {
                let Point { at, residual } = frame[point];
                let place = at * metres;
                let plausible = place.is_finite() && place.length() < MAX_DISTANCE_M;
                if residual >= 0.0 {
                    seen += 1;
                    implausible += usize::from(!plausible);
                }
                if residual >= 0.0 && plausible {
                    positions.push(place.as_vec3().to_array());
                    residuals.push((residual * metres) as f32);
                } else {
                    positions.push([0.0; 3]);
                    residuals.push(-1.0);
                }
            }
        }
        if implausible as f64 > MAX_IMPLAUSIBLE * seen as f64 {
            return Err(Rejected::read(
                "E-C3D-ENDIAN",
                format!(
                    "found {implausible} of {seen} positions farther than {MAX_DISTANCE_M} m; the \
                     file says {processor:?}, and its numbers are another processor's"
                ),
            )
            .at(self.start));
        }
        if !positions.is_empty() && positions.iter().all(|position| *position == [0.0; 3]) {
            return Err(Rejected::read(
                "E-C3D-ZERO",
                format!(
                    "all coordinates are zero in {} positions, {seen} of them seen; expected a capture",
                    positions.len()
                ),
            )
            .at(self.start));
        }
        if implausible > 0 {
            self.notes.push(format!(
                "{implausible} positions farther than {MAX_DISTANCE_M} m count as not seen"
            ));
        }
        let labels: Vec<String> = kept.iter().map(|point| labels[*point].clone()).collect();
        Ok(C3dFile {
            processor,
            integer: self.scale > 0.0,
            markers: Markers {
                fps: self.fps,
                labels,
                positions,
                residuals,
                set: None,
                fit_residuals: Vec::new(),
            },
            model_outputs: outputs,
            notes: self.notes,
        })
    }

    /// Every point of every frame in the file's unit.
    fn raw_positions(&self, bytes: &[u8], processor: Processor) -> Vec<Point> {
        let size = if self.scale < 0.0 { 4 } else { 2 };
        let frame_size = (4 * self.points + self.analog) * size;
        let data = &bytes[self.start..self.start + self.frames * frame_size];
        let mut points = Vec::with_capacity(self.frames * self.points);
        for frame in data.chunks_exact(frame_size) {
            for point in frame[..4 * self.points * size].chunks_exact(4 * size) {
                points.push(if size == 4 {
                    real_point(point, processor, self.scale)
                } else {
                    whole_point(point, processor, self.scale)
                });
            }
        }
        points
    }
}

/// A point in the file's unit; the residual is negative where it was not seen.
#[derive(Clone, Copy)]
struct Point {
    at: DVec3,
    residual: f64,
}

fn real_point(bytes: &[u8], processor: Processor, scale: f64) -> Point {
    let value = |index: usize| {
        let at = 4 * index;
        f64::from(processor.f32([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]))
    };
    let at = DVec3::new(value(0), value(1), value(2));
    // The fourth number is an integer: cameras in its high byte, the residual in its low byte.
    let packed = value(3);
    let residual = if packed < 0.0 || !packed.is_finite() || !at.is_finite() {
        -1.0
    } else {
        f64::from(packed.min(f64::from(u16::MAX)) as u16 & 0xFF) * scale.abs()
    };
    Point { at, residual }
}

fn whole_point(bytes: &[u8], processor: Processor, scale: f64) -> Point {
    let value = |index: usize| processor.i16([bytes[2 * index], bytes[2 * index + 1]]);
    let at = DVec3::new(value(0).into(), value(1).into(), value(2).into()) * scale;
    let packed = value(3);
    let residual = if packed < 0 {
        -1.0
    } else {
        f64::from(packed & 0xFF) * scale
    };
    Point { at, residual }
}

/// Number of frames by the parameters (for long captures in two words or as a real number), else by the
/// header, limited by the length of the file.
fn frame_count(
    header: &Header,
    parameters: &Parameters,
    room: usize,
    notes: &mut Vec<String>,
) -> Result<usize, Rejected> {
    let field = |name: &str| parameters.long("TRIAL", name);
    let trial = match (field("ACTUAL_START_FIELD"), field("ACTUAL_END_FIELD")) {
        (Some(first), Some(last)) if last >= first => Some(last - first + 1),
        _ => None,
    };
    let whole = |name: &str| {
        let number = parameters.number("POINT", name)?;
        // Sixteen bits are read with their sign, which a count does not have.
        let number = if number < 0.0 {
            number + 65_536.0
        } else {
            number
        };
        (number >= 1.0).then_some(number as usize)
    };
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
        (Some(first), None) => Err(Rejected::read(
            "E-C3D-TRUNCATED",
            format!("found room for {room} frames, expected {first}"),
        )),
        _ => Err(header_error(6, "found no number of frames")),
    }
}

/// A name for each point, unique.
fn labels(parameters: &Parameters, points: usize) -> Vec<String> {
    let mut stated = Vec::new();
    for number in 1.. {
        let name = match number {
            1 => "LABELS".to_owned(),
            more => format!("LABELS{more}"),
        };
        match parameters.texts("POINT", &name) {
            Some(more) => stated.extend(more),
            None => break,
        }
    }
    let label = |point: usize| {
        let label = stated.get(point).map(|label| label.trim());
        match label.unwrap_or_default() {
            "" => format!("point{}", point + 1),
            label => label.to_owned(),
        }
    };
    markers::unique_labels((0..points).map(label))
}

/// The file's unit in metres.
fn metres_of(units: &str, points: &[Point], notes: &mut Vec<String>) -> f64 {
    let largest = || {
        let seen = points.iter().filter(|point| point.residual >= 0.0);
        seen.fold(0.0, |largest: f64, point| {
            largest.max(point.at.abs().max_element())
        })
    };
    let (metres, note) = markers::metres_of_unit(units, largest);
    notes.extend(note);
    metres
}

/// Reads a capture: a clip where the markers are of a known set, otherwise the markers alone.
pub fn read(bytes: &[u8], options: &ReadOptions) -> Outcome {
    let capture = match C3dFile::parse(bytes) {
        Ok(Some(capture)) => capture,
        Ok(None) => {
            return Outcome::Skipped {
                reason: "C3D without marker data".to_owned(),
            };
        }
        Err(rejected) => return Outcome::Rejected(rejected),
    };
    if capture.markers.labels.is_empty() {
        return Outcome::Skipped {
            reason: "C3D without marker data".to_owned(),
        };
    }
    markers::outcome(capture.markers, capture.notes, 0, options)
}

/// C3D: marker positions of an optical capture.
pub const FORMAT: Format = Format::new(&C3d);

#[derive(Debug)]
struct C3d;

impl SourceFormat for C3d {
    fn name(&self) -> &'static str {
        "c3d"
    }

    fn bytes_per_second(&self) -> f64 {
        // Measured on 24 captures.
        60_000.0
    }

    fn by_name(&self, extension: &str, _name: &str, _head: &[u8]) -> Option<Recognised> {
        (extension == "c3d").then_some(Recognised::Motion(FORMAT))
    }

    fn read(&self, _path: &Path, _key: &str, bytes: &[u8], options: &ReadOptions) -> Outcome {
        read(bytes, options)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A small file of one group, one labelled point and three frames.
    fn file(processor: u8, integer: bool) -> Vec<u8> {
        let big = processor == 86;
        let word = |number: u16| {
            if big {
                number.to_be_bytes()
            } else {
                number.to_le_bytes()
            }
        };
        let real = |number: f32| match processor {
            86 => number.to_be_bytes(),
            85 => {
                let [a, b, c, d] = (number * 4.0).to_be_bytes();
                if number == 0.0 { [0; 4] } else { [b, a, d, c] }
            }
            _ => number.to_le_bytes(),
        };
        let scale: f32 = if integer { 0.5 } else { -0.5 };
        let mut bytes = vec![0u8; 2 * BLOCK];
        bytes[..2].copy_from_slice(&[2, MAGIC]);
        for (number, value) in [(2, 1u16), (3, 2), (4, 1), (5, 3), (9, 3)] {
            bytes[2 * (number - 1)..2 * number].copy_from_slice(&word(value));
        }
        bytes[12..16].copy_from_slice(&real(scale));
        bytes[20..24].copy_from_slice(&real(100.0));
        let mut parameters = vec![1, MAGIC, 1, processor];
        let mut put = |id: i8, name: &str, content: &[u8]| {
            parameters.push(name.len() as u8);
            parameters.push(id as u8);
            parameters.extend(name.as_bytes());
            parameters.extend(word(u16::try_from(2 + content.len()).expect("short")));
            parameters.extend(content);
        };
        put(-1, "POINT", &[0]);
        put(1, "LABELS", b"\xff\x02\x04\x01LKNE\x00");
        put(1, "UNITS", b"\xff\x01\x02mm\x00");
        parameters.extend([0, 0]);
        bytes[BLOCK..BLOCK + parameters.len()].copy_from_slice(&parameters);
        for frame in 0..3u16 {
            let at = [100.0, -20.0, 10.0 * f32::from(frame)];
            for coordinate in at {
                if integer {
                    bytes.extend(word((coordinate / scale) as i16 as u16));
                } else {
                    bytes.extend(real(coordinate));
                }
            }
            // Cameras 1 and 2 and a residual of 4; the last frame was not seen.
            let packed: i16 = if frame == 2 { -1 } else { 0x0304 };
            if integer {
                bytes.extend(word(packed as u16));
                bytes.extend([0; 4]);
            } else {
                bytes.extend(real(packed.into()));
                bytes.extend([0; 8]);
            }
        }
        bytes
    }

    #[test]
    fn three_processors_and_two_storages_say_the_same() {
        for processor in [84, 85, 86] {
            for integer in [true, false] {
                let capture = C3dFile::parse(&file(processor, integer))
                    .expect("a good file")
                    .expect("with a point");
                let markers = &capture.markers;
                assert_eq!(capture.integer, integer);
                assert_eq!(markers.labels, ["LKNE"]);
                assert_eq!(markers.fps.get(), 100.0);
                assert_eq!(markers.positions[1], [0.1, -0.02, 0.01], "{processor}");
                assert_eq!(
                    markers.residuals,
                    [0.002, 0.002, -1.0],
                    "{processor} {integer}"
                );
            }
        }
    }

    #[test]
    fn numbers_of_another_processor_are_found_out() {
        let mut wrong = file(86, false);
        wrong[BLOCK + 3] = 84;
        let code = C3dFile::parse(&wrong).expect_err("nonsense").code;
        assert!(
            ["E-C3D-ENDIAN", "E-C3D-HEADER", "E-C3D-PARAM"].contains(&code),
            "{code}"
        );
        // Only the frames are another processor's.
        let mut frames = file(84, false);
        for value in frames[2 * BLOCK..].chunks_exact_mut(4) {
            value.copy_from_slice(&1e30f32.to_le_bytes());
        }
        assert_eq!(
            C3dFile::parse(&frames).expect_err("nonsense").code,
            "E-C3D-ENDIAN"
        );
    }

    /// A file as some programs on MIPS machines wrote it: the link of LABELS to the next parameter
    /// leads out of the section, into the frames or beyond the file.
    #[test]
    fn a_link_out_of_the_section_does_not_end_the_file() {
        let labels = b"\x06\x01LABELS";
        for processor in [84, 85, 86] {
            for link in [BLOCK as u16 + 16, 0x7000, 0xfff0] {
                let mut bytes = file(processor, false);
                let found = bytes.windows(labels.len()).position(|name| name == labels);
                let at = found.expect("labels") + labels.len();
                let link = match processor {
                    86 => link.to_be_bytes(),
                    _ => link.to_le_bytes(),
                };
                bytes[at..at + 2].copy_from_slice(&link);
                let capture = C3dFile::parse(&bytes).expect("good").expect("with a point");
                let reference = C3dFile::parse(&file(processor, false))
                    .expect("good")
                    .expect("with a point");
                assert_eq!(capture.markers, reference.markers, "{processor}");
            }
        }
    }

    #[test]
    fn a_capture_of_zeros_is_refused() {
        let mut bytes = file(84, false);
        for frame in bytes[2 * BLOCK..].chunks_exact_mut(24) {
            frame[..12].fill(0);
        }
        let rejected = C3dFile::parse(&bytes).expect_err("all zero");
        assert_eq!(
            (rejected.code, rejected.byte_offset),
            ("E-C3D-ZERO", Some(1024))
        );
    }

    /// The header counts frames in sixteen bits; longer captures say how many in two words of TRIAL.
    #[test]
    fn captures_of_more_than_65535_frames_are_read_whole() {
        const FRAMES: u32 = 70_000;
        let mut bytes = file(84, true);
        let mut parameters = Vec::new();
        let mut put = |id: i8, name: &str, content: &[u8]| {
            parameters.push(name.len() as u8);
            parameters.push(id as u8);
            parameters.extend(name.as_bytes());
            parameters.extend(
                u16::try_from(2 + content.len())
                    .expect("short")
                    .to_le_bytes(),
            );
            parameters.extend(content);
        };
        let words = |number: u32| [&[2, 1, 2][..], &number.to_le_bytes(), &[0]].concat();
        put(-1, "TRIAL", &[0]);
        put(1, "ACTUAL_START_FIELD", &words(1));
        put(1, "ACTUAL_END_FIELD", &words(FRAMES));
        parameters.extend([0, 0]);
        bytes[BLOCK + 4..BLOCK + 4 + parameters.len()].copy_from_slice(&parameters);
        let frame = bytes[2 * BLOCK..2 * BLOCK + 12].to_vec();
        bytes.truncate(2 * BLOCK);
        bytes.extend(frame.repeat(FRAMES as usize));
        let capture = C3dFile::parse(&bytes).expect("good").expect("with a point");
        assert_eq!(capture.markers.positions.len(), FRAMES as usize);
        // With room for fewer frames than the words claim, the header's three are believed.
        bytes.truncate(2 * BLOCK + 12 * 1000);
        let capture = C3dFile::parse(&bytes).expect("good").expect("with a point");
        assert_eq!(capture.markers.positions.len(), 3);
        assert!(!capture.notes.is_empty());
    }

    #[test]
    fn what_is_missing_is_named() {
        let good = file(84, true);
        let code = |bytes: &[u8]| C3dFile::parse(bytes).expect_err("broken").code;
        assert_eq!(code(b""), "E-C3D-TRUNCATED");
        assert_eq!(code(&good[..good.len() - 30]), "E-C3D-TRUNCATED");
        let mut no_magic = good.clone();
        no_magic[1] = 0;
        assert_eq!(code(&no_magic), "E-C3D-HEADER");
        let mut no_section = good.clone();
        no_section[0] = 99;
        assert_eq!(code(&no_section), "E-C3D-HEADER");
        let mut empty = good;
        empty[2..4].copy_from_slice(&[0, 0]);
        assert!(C3dFile::parse(&empty).expect("fine").is_none());
    }

    proptest! {
        #[test]
        fn damaged_files_never_panic(at in 0usize..1100, value in any::<u8>(), integer in any::<bool>()) {
            let mut bytes = file(84, integer);
            let at = at % bytes.len();
            bytes[at] = value;
            let _parsed = C3dFile::parse(&bytes);
        }
    }

    /// The sample files of c3d.org hold one capture in six encodings.
    #[test]
    fn real_encodings_agree() {
        let Some(root) = std::env::var_os("STANCE_TEST_DATA").map(std::path::PathBuf::from) else {
            skipped();
            return;
        };
        let folder = root.join("c3d/c3d.org_sample01");
        let read = |name: &str| {
            let bytes = std::fs::read(folder.join(name)).expect("a sample file");
            C3dFile::parse(&bytes)
                .expect("good")
                .expect("with points")
                .markers
        };
        let reference = read("Eb015pi.c3d");
        assert_eq!(
            (reference.fps.get(), reference.positions.len()),
            (50.0, 450 * 26)
        );
        for other in [
            "Eb015pr.c3d",
            "Eb015si.c3d",
            "Eb015sr.c3d",
            "Eb015vi.c3d",
            "Eb015vr.c3d",
        ] {
            let other = read(other);
            assert_eq!(other.labels, reference.labels);
            for (a, b) in reference.positions.iter().zip(&other.positions) {
                // A step of the integer encoding is 0.0833 mm.
                let apart = (0..3).map(|k| (a[k] - b[k]).abs()).fold(0.0, f32::max);
                assert!(apart < 1e-4, "{a:?} and {b:?}");
            }
        }
    }

    #[expect(
        clippy::print_stderr,
        reason = "a test that checks nothing must say so"
    )]
    fn skipped() {
        eprintln!("SKIPPED: STANCE_TEST_DATA names no folder with the sample files of c3d.org");
    }
}
