//! Pictures of a plan: answers of several systems to one item, below each other, as in Figures 2, 3, 5 and 7 of the paper
//! and A3 to A14 of its appendix.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use datasets_spec::record::{EditRow, ItemRow};
use eval::answers::Answered;
use eval::draw::strip::{Style, sheet, strip};
use serde::Deserialize;

use super::files::{file_name, write_drawing};
use crate::cmd::page::strip_of;

/// Section `[[picture]]` of a plan.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Picture {
    pub(super) name: String,
    /// The systems, from above to below; without any, all.
    #[serde(default)]
    pub(super) systems: Vec<String>,
    /// Tasks of the items; without any, all.
    #[serde(default)]
    tasks: Vec<String>,
    /// Number of items, the first ones whose edits are of different parts.
    #[serde(default = "three")]
    items: usize,
}

fn three() -> usize {
    3
}

/// Edits of the systems: the first take of the first training of each.
pub(super) type Edits = [(String, Vec<PathBuf>)];

/// Draws a picture as SVG and PNG below a folder. Systems whose edits failed are left out.
pub(super) fn draw(
    picture: &Picture,
    systems: &[&str],
    edits: &Edits,
    out: &Path,
) -> anyhow::Result<PathBuf> {
    let of_system = |name: &&str| edits.iter().find(|(system, _)| system == name);
    let answered: Vec<(&String, Answered)> = systems
        .iter()
        .filter_map(of_system)
        .map(|(system, folders)| Ok((system, Answered::read(&folders[..1])?)))
        .collect::<anyhow::Result<_>>()?;
    let Some((_, first)) = answered.first() else {
        anyhow::bail!("none of its systems has edits");
    };
    let mut panels = Vec::new();
    for item in chosen(picture, &first.items) {
        let made: Vec<EditRow> = answered
            .iter()
            .filter_map(|(system, answered)| {
                let row = answered.edits.iter().find(|row| row.id == item.id)?;
                Some(EditRow {
                    system: (*system).clone(),
                    ..row.clone()
                })
            })
            .collect();
        let made: Vec<&EditRow> = made.iter().collect();
        let drawn = strip_of(item, &made, &first.skeleton, &BTreeSet::new())?;
        panels.push((drawn.caption, strip(&drawn.rows, &Style::default())));
    }
    anyhow::ensure!(!panels.is_empty(), "there is no item of its tasks");
    let svg = sheet(&panels, 1, Style::default().width);
    let path = out
        .join("figures")
        .join(format!("{}.svg", file_name(&picture.name)));
    write_drawing(&path, &svg)?;
    Ok(path)
}

/// The first items of the tasks whose edited parts differ, and then the first others.
fn chosen<'a>(picture: &Picture, items: &'a [ItemRow]) -> Vec<&'a ItemRow> {
    let is_wanted =
        |item: &&ItemRow| picture.tasks.is_empty() || picture.tasks.contains(&item.task);
    let mut parts: BTreeSet<&[String]> = BTreeSet::new();
    let (first, others): (Vec<&ItemRow>, Vec<&ItemRow>) = items
        .iter()
        .filter(is_wanted)
        .partition(|item| parts.insert(&item.parts));
    let mut all = first;
    all.extend(others);
    all.truncate(picture.items);
    all
}
