//! Tables of a plan and the forms that they are written in.

use std::path::PathBuf;

use datasets_spec::record::ScoreRow;
use eval::format;
use eval::judge::Judges;
use eval::table::Table;
use eval::times::{self, WindowTimes};

use super::files::table_name;
use super::plan::{PaperTable, Plan};
use super::work::Work;
use crate::cmd::eval::result_tables;
use crate::global::Global;

#[derive(Default)]
pub(super) struct TableMade {
    pub(super) name: String,
    pub(super) tables: Vec<Table>,
    pub(super) scores: Vec<ScoreRow>,
    /// Scores of each training, if there are several.
    pub(super) trainings: Vec<Vec<ScoreRow>>,
    /// Grids of Table A4, which has no scores.
    pub(super) grids: Vec<format::grid::Grid>,
    /// Reason why the encoder cannot rank systems.
    pub(super) unranked: Option<String>,
}

impl TableMade {
    /// The table in each form, with the extension of its file; text comes first, JSON last.
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
}

/// Makes a table of its systems that have edits. `all` holds the name of each system, with a folder of edits for each
/// of its trainings. Returns `None` if no system of the table has edits.
pub(super) fn tables(
    table: &PaperTable,
    published: bool,
    plan: &Plan,
    work: &Work<'_>,
    all: &[(String, Vec<PathBuf>)],
    global: &Global,
) -> anyhow::Result<Option<TableMade>> {
    let wanted = plan.systems_named(&table.systems);
    let rows = |name: &&str| all.iter().find(|(system, _)| system == name);
    let found: Vec<&(String, Vec<PathBuf>)> = wanted.iter().filter_map(rows).collect();
    if found.is_empty() {
        return Ok(None);
    }
    let published = published || table.published;
    let name = table_name(table.paper);
    let Some(paper) = table.paper.scored() else {
        let mut rows: Vec<(String, WindowTimes)> = found
            .into_iter()
            .map(|(system, edits)| Ok((system.clone(), WindowTimes::read(&edits[0])?)))
            .collect::<anyhow::Result<_>>()?;
        if published {
            rows.extend(times::published());
        }
        return Ok(Some(TableMade {
            name,
            grids: times::tables(&rows),
            ..TableMade::default()
        }));
    };
    let edits: Vec<&[PathBuf]> = found.iter().map(|(_, edits)| edits.as_slice()).collect();
    let protocol = plan.protocol(Some(table.paper), global);
    let scored = work.scored(&edits, None, &protocol)?;
    let (scores, trainings) = (scored.scores, scored.trainings);
    let mut tables = result_tables(&scores, table.paper, paper);
    for laid_out in &mut tables {
        laid_out.sort_systems(&wanted);
        laid_out.notes.extend(note_of_trainings(&found));
        laid_out.notes.extend(note_of_missing(&wanted, &found));
        if published {
            laid_out.append_published(paper);
        }
    }
    Ok(Some(TableMade {
        unranked: scores.unranked(),
        name,
        tables,
        scores: scores.rows,
        trainings,
        ..TableMade::default()
    }))
}

/// The systems of the table that have no edits, because a step of theirs failed.
fn note_of_missing(wanted: &[&str], found: &[&(String, Vec<PathBuf>)]) -> Option<String> {
    let has_row = |name: &&&str| found.iter().any(|(system, _)| system == **name);
    let missing = wanted.iter().filter(|name| !has_row(name)).copied();
    let missing: Vec<&str> = missing.collect();
    (!missing.is_empty()).then(|| {
        format!(
            "The plan failed to make edits of {}, which have no row.",
            missing.join(", ")
        )
    })
}

fn note_of_trainings(systems: &[&(String, Vec<PathBuf>)]) -> Option<String> {
    let most = systems.iter().map(|(_, edits)| edits.len()).max()?;
    let once: Vec<&str> = systems
        .iter()
        .filter(|(_, edits)| edits.len() < most)
        .map(|(name, _)| name.as_str())
        .collect();
    let fewer = match once.is_empty() {
        true => String::new(),
        false => format!(", fewer for {}", once.join(", ")),
    };
    (most > 1).then(|| {
        format!("Means over {most} trainings of each system{fewer}; intervals are over items and trainings.")
    })
}
