//! The lines of the text, and the settings and marker names above the rows.

use crate::markers::unique_labels;
use crate::source::format::plausible_fps;
use crate::source::head::UTF8_BOM;
use crate::source::names::shown;
use clip::{Rejected, rejected};

/// First word of every file.
pub(super) const MAGIC: &[u8] = b"PathFileType";
/// The only type of TRC file in use: trajectories.
const TRAJECTORIES: &str = "4";
/// Limit on markers; real captures have a few hundred.
const MAX_MARKERS: usize = 10_000;

/// Fields of the header lines.
pub(super) struct Header {
    /// Frames per second; `None` if the file states no plausible rate.
    pub(super) rate: Option<f64>,
    pub(super) num_frames: usize,
    /// Unit as written, and its byte offset.
    pub(super) unit: String,
    pub(super) unit_at: usize,
    /// Names of the markers, and their byte offset.
    pub(super) names: Vec<String>,
    pub(super) names_at: usize,
}

fn error(at: usize, reason: impl Into<String>) -> Rejected {
    Rejected::read("E-TRC-HEADER", reason).at(at)
}

impl Header {
    /// Unique names of the markers.
    pub(super) fn labels(&self) -> Vec<String> {
        unique_labels(self.names.iter().cloned())
    }

    pub(super) fn parse(lines: &mut Lines<'_>) -> Result<Self, Rejected> {
        let end = lines.bytes.len();
        let mut next = |what: &str| {
            let line = lines.next();
            line.ok_or_else(|| error(end, format!("the file ends before {what}")))
        };
        let kind = next("its first line")?;
        let kinds = kind.cells();
        let (at, first) = kinds.first().copied().unwrap_or((0, b""));
        if !first.eq_ignore_ascii_case(MAGIC) {
            let found = shown(first);
            return Err(error(at, format!("found {found}, expected PathFileType")));
        }
        if let Some((at, found)) = kinds
            .get(1)
            .filter(|(_, kind)| *kind != TRAJECTORIES.as_bytes())
        {
            let found = shown(found);
            let reason = format!("found file type {found}, expected {TRAJECTORIES}, trajectories");
            return Err(error(*at, reason));
        }
        let settings = Settings::of(next("the names of its settings")?, next("its settings")?);
        let num_markers = settings.count("NumMarkers")?;
        if num_markers == 0 || num_markers > MAX_MARKERS {
            let (at, _) = settings.get("NumMarkers")?;
            let reason = format!("found {num_markers} markers, expected 1 to {MAX_MARKERS}");
            return Err(error(at, reason));
        }
        let num_frames = settings.count("NumFrames")?;
        let rate = ["DataRate", "CameraRate"].into_iter().find_map(|name| {
            let (_, value) = settings.get(name).ok()?;
            let rate = fast_float2::parse::<f64, _>(value).ok()?;
            plausible_fps(rate).is_some().then_some(rate)
        });
        let (unit_at, unit) = settings
            .get("Units")
            .unwrap_or((settings.values_at, &b""[..]));
        let line = next("the names of its markers")?;
        let names = marker_names(line, num_markers)?;
        next("the names of its coordinates")
            .and_then(|line| check_coordinates(line, num_markers))?;
        Ok(Self {
            rate,
            num_frames,
            unit: String::from_utf8_lossy(unit).into_owned(),
            unit_at,
            names,
            names_at: line.at,
        })
    }
}

/// Names and values of the second and third line.
struct Settings<'a> {
    cells: Vec<(&'a [u8], usize, &'a [u8])>,
    values_at: usize,
}

impl<'a> Settings<'a> {
    fn of(names: Line<'a>, values: Line<'a>) -> Self {
        let cells = names.cells().into_iter().zip(values.cells());
        Self {
            cells: cells
                .map(|((_, name), (at, value))| (name, at, value))
                .collect(),
            values_at: values.at,
        }
    }

    /// The byte offset and the text of a value.
    fn get(&self, wanted: &str) -> Result<(usize, &'a [u8]), Rejected> {
        let mut cells = self.cells.iter();
        let found = cells.find(|(name, ..)| name.eq_ignore_ascii_case(wanted.as_bytes()));
        found
            .map(|(_, at, value)| (*at, *value))
            .ok_or_else(|| error(self.values_at, format!("the file states no {wanted}")))
    }

    fn count(&self, name: &str) -> Result<usize, Rejected> {
        let (at, value) = self.get(name)?;
        let text = std::str::from_utf8(value).ok();
        text.and_then(|text| text.parse().ok()).ok_or_else(|| {
            let found = shown(value);
            error(
                at,
                format!("found {found} as {name}, expected a whole number"),
            )
        })
    }
}

/// The names after `Frame#` and `Time`. Each marker has three columns, and most programs write its name in the first.
fn marker_names(line: Line<'_>, num_markers: usize) -> Result<Vec<String>, Rejected> {
    let cells = line.cells();
    let stated = cells.iter().skip(2).filter(|(_, name)| !name.is_empty());
    let names: Vec<String> = stated
        .map(|(_, name)| String::from_utf8_lossy(name).into_owned())
        .collect();
    if names.len() == num_markers {
        return Ok(names);
    }
    let count = names.len();
    Err(rejected!(
        "E-TRC-NAMES",
        "found {count} marker names, expected {num_markers} as NumMarkers says"
    )
    .at(line.at))
}

/// Checks the line of `X1`, `Y1`, `Z1` and so on.
fn check_coordinates(line: Line<'_>, num_markers: usize) -> Result<(), Rejected> {
    let cells = line.cells();
    let stated: Vec<(usize, &[u8])> = cells
        .into_iter()
        .filter(|(_, name)| !name.is_empty())
        .collect();
    let is_name = |name: &[u8]| {
        let axis = name.first().map(u8::to_ascii_uppercase);
        axis.is_some_and(|axis| b"XYZ".contains(&axis))
    };
    if let Some((at, name)) = stated.iter().find(|(_, name)| !is_name(name)) {
        let found = shown(name);
        let reason = format!("found {found}, expected coordinates X1, Y1, Z1, ...");
        return Err(error(*at, reason));
    }
    if stated.len() != 3 * num_markers {
        let count = stated.len();
        let reason =
            format!("found {count} coordinates, expected three for each of {num_markers} markers");
        return Err(error(line.at, reason));
    }
    Ok(())
}

/// A line of the text.
#[derive(Clone, Copy)]
pub(super) struct Line<'a> {
    /// Byte offset of the line in the file.
    pub(super) at: usize,
    pub(super) text: &'a [u8],
    /// Whether a line break follows.
    pub(super) is_whole: bool,
}

impl<'a> Line<'a> {
    /// The trimmed cells of the line, with their byte offsets in the file. Tabs separate cells, or blanks in a line
    /// without tabs.
    pub(super) fn cells(&self) -> Vec<(usize, &'a [u8])> {
        let is_tabbed = self.text.contains(&b'\t');
        let mut cells = Vec::new();
        let mut start = 0;
        let ends = self.text.iter().enumerate();
        let ends = ends.filter(|(_, byte)| match is_tabbed {
            true => **byte == b'\t',
            false => byte.is_ascii_whitespace(),
        });
        for end in ends.map(|(end, _)| end).chain([self.text.len()]) {
            let cell = &self.text[start..end];
            let skipped = cell.len() - cell.trim_ascii_start().len();
            let cell_at = self.at + start + skipped;
            start = end + 1;
            if is_tabbed || !cell.is_empty() {
                cells.push((cell_at, cell.trim_ascii()));
            }
        }
        cells
    }
}

/// The lines of a file that are not blank.
pub(super) struct Lines<'a> {
    pub(super) bytes: &'a [u8],
    at: usize,
}

impl<'a> Lines<'a> {
    pub(super) fn of(bytes: &'a [u8]) -> Self {
        let at = bytes.strip_prefix(UTF8_BOM).map_or(0, |_| UTF8_BOM.len());
        Self { bytes, at }
    }
}

impl<'a> Iterator for Lines<'a> {
    type Item = Line<'a>;

    fn next(&mut self) -> Option<Line<'a>> {
        while self.at < self.bytes.len() {
            let rest = &self.bytes[self.at..];
            let end = rest.iter().position(|byte| matches!(byte, b'\n' | b'\r'));
            let line = Line {
                at: self.at,
                text: &rest[..end.unwrap_or(rest.len())],
                is_whole: end.is_some(),
            };
            self.at += line.text.len() + 1;
            if !line.text.trim_ascii().is_empty() {
                return Some(line);
            }
        }
        None
    }
}
