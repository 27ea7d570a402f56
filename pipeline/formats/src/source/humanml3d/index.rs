//! The crop list, `index.csv`: the recording and frames of each clip.

use clip::Rejected;

/// A row of `index.csv`: the recording and frames of a clip.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IndexRow {
    /// Path as published, such as `./pose_data/KIT/3/kick_high_left02_poses.npy`.
    pub source_path: String,
    /// First frame at 20 fps, counted after the subset's lead-in.
    pub(crate) start: usize,
    /// One past the last frame; `None` for the whole recording.
    pub(crate) end: Option<usize>,
    /// Id of the clip.
    pub id: String,
}

/// Parses the crop list.
///
/// # Errors
/// `E-HML-INDEX`, with the line if a row is wrong.
pub fn parse_index(bytes: &[u8]) -> Result<Vec<IndexRow>, Rejected> {
    const COLUMNS: [&str; 4] = ["source_path", "start_frame", "end_frame", "new_name"];
    let bad = |reason: String| Rejected::read("E-HML-INDEX", reason);
    let mut reader = csv::ReaderBuilder::new().flexible(true).from_reader(bytes);
    let header = reader
        .headers()
        .map_err(|error| bad(error.to_string()))?
        .clone();
    let mut places = [0; COLUMNS.len()];
    for (place, column) in places.iter_mut().zip(COLUMNS) {
        *place = header
            .iter()
            .position(|found| found.trim_start_matches('\u{feff}').trim() == column)
            .ok_or_else(|| {
                bad(format!(
                    "found columns {}, expected {}",
                    header.iter().collect::<Vec<_>>().join(", "),
                    COLUMNS.join(", ")
                ))
            })?;
    }
    let mut rows = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|error| bad(error.to_string()))?;
        let line = record.position().map_or(0, csv::Position::line);
        let field = |column: usize| record.get(places[column]).unwrap_or_default().trim();
        let frame = |column: usize| -> Result<Option<usize>, Rejected> {
            match field(column) {
                "-1" => Ok(None),
                text => text.parse().map(Some).map_err(|_| {
                    bad(format!(
                        "found {text:?} as {} in line {line}, expected a frame number",
                        COLUMNS[column]
                    ))
                }),
            }
        };
        let id = field(3);
        let id = id.strip_suffix(".npy").unwrap_or(id).to_owned();
        if id.is_empty() {
            return Err(bad(format!("found no new_name in line {line}")));
        }
        rows.push(IndexRow {
            source_path: field(0).to_owned(),
            start: frame(1)?.unwrap_or(0),
            end: frame(2)?,
            id,
        });
    }
    Ok(rows)
}
