//! Tables and scores as text for people and for programs.

pub mod csv;
pub mod grid;
pub mod json;
pub mod latex;
pub mod markdown;
pub mod text;

use crate::table::Row;

/// Placeholder of a value that was not measured.
pub const ABSENT: &str = "–";
/// Suffix of the name of a published row, in formats that have no heading for published rows.
const PUBLISHED: &str = "(published)";
/// Heading of the published rows.
pub(crate) const PUBLISHED_HEADING: &str = "Published, not measured here";

/// Groups of rows, which formats separate visually.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RowGroup {
    Baseline,
    System,
    Published,
}

impl RowGroup {
    pub(crate) fn of(row: &Row) -> Self {
        match (row.published, row.baseline) {
            (true, _) => Self::Published,
            (false, true) => Self::Baseline,
            (false, false) => Self::System,
        }
    }
}

/// The name of a row, marked if its values were not measured.
pub(crate) fn row_name(row: &Row) -> String {
    if row.published {
        format!("{} {PUBLISHED}", row.system)
    } else {
        row.system.clone()
    }
}
