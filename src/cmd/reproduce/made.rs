//! Tables of a plan and the forms that they are written in.

use datasets_spec::record::ScoreRow;
use eval::format;
use eval::judge::Judges;
use eval::table::Table;
use serde_json::Value;

use super::in_json;

/// A table of the paper.
pub(super) struct TableMade {
    pub(super) name: String,
    pub(super) tables: Vec<Table>,
    pub(super) scores: Vec<ScoreRow>,
    /// Scores of each training, where there are several.
    pub(super) trainings: Vec<Vec<ScoreRow>>,
    /// Table A4 in place of scores.
    pub(super) grids: Vec<format::grid::Grid>,
    /// Why it ranks no system.
    pub(super) unranked: Option<String>,
}

impl TableMade {
    /// The table in each form, with the extension of its file; text comes first.
    pub(super) fn forms(&self, judges: &Judges) -> anyhow::Result<[(&'static str, String); 5]> {
        let joined = |of: fn(&format::grid::Grid) -> String| {
            let grids: Vec<String> = self.grids.iter().map(of).collect();
            grids.join("\n")
        };
        Ok(match self.grids.is_empty() {
            true => [
                ("txt", format::text::render(&self.tables)),
                ("md", format::markdown::render(&self.tables)),
                ("tex", format::latex::render(&self.tables)),
                ("csv", format::csv::render(&self.scores, judges)),
                ("json", format::json::render(&self.scores, judges)?),
            ],
            false => [
                ("txt", joined(format::grid::Grid::text)),
                ("md", joined(format::grid::Grid::markdown)),
                ("tex", joined(format::grid::Grid::latex)),
                ("csv", joined(format::grid::Grid::csv)),
                ("json", serde_json::to_string_pretty(&self.grids)?),
            ],
        })
    }

    pub(super) fn document(&self, judges: &Judges) -> anyhow::Result<Value> {
        Ok(match self.grids.is_empty() {
            true => in_json(&self.scores, judges)?.into(),
            false => serde_json::to_value(&self.grids)?,
        })
    }
}
