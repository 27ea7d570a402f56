//! Tables and scores as text for people and for programs.

pub mod csv;
pub mod grid;
pub mod json;
pub mod latex;
pub mod markdown;
pub mod text;

use crate::table::{Row, RowGroup};

/// Placeholder of a value that was not measured.
pub const ABSENT: &str = "–";
/// Suffix of the name of a published row, in formats that have no heading for published rows.
const PUBLISHED: &str = "(published)";
/// Heading of the published rows.
pub(crate) const PUBLISHED_HEADING: &str = "Published, not measured here";

/// The text with a space for each control character, such as a line break.
fn on_one_line(text: &str) -> String {
    text.replace(char::is_control, " ")
}

/// The name of a row, marked if its values were not measured.
fn row_name(row: &Row) -> String {
    match row.group {
        RowGroup::Published => format!("{} {PUBLISHED}", row.system),
        RowGroup::Baseline | RowGroup::System => row.system.clone(),
    }
}
