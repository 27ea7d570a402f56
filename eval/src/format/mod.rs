//! Tables and scores as text for people and for programs.

pub mod csv;
pub mod grid;
pub mod json;
pub mod latex;
pub mod markdown;
pub mod text;

use crate::table::Row;

/// What stands where a value was not measured.
pub(crate) const ABSENT: &str = "–";
/// What follows the name of a row that was not measured, where each row stands for itself.
const PUBLISHED: &str = "(published)";
/// What stands above rows that were not measured, where they can be set apart.
pub(crate) const PUBLISHED_HEADING: &str = "Published, not measured here";

/// Rows of one group stand together, apart from those of the next.
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
