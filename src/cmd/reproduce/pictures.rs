//! Pictures of a plan: answers of several systems to the same items, below each other, as in Figures 2, 3, 5 and 7 of
//! the paper and A3 to A14 of its appendix.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use datasets_spec::record::EditRow;
use eval::answers::Answered;
use eval::best_edit::gains;
use eval::draw::strip::{Style, sheet, strip};
use eval::rows::ItemFacts;
use serde::Deserialize;

use super::files::{file_name, write_drawing};
use crate::cmd::page::strip_of;
use crate::stages::UnknownWords;

/// Section `[[picture]]` of a plan.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Picture {
    pub(super) name: String,
    /// Systems from top to bottom; if empty, all.
    #[serde(default)]
    pub(super) systems: Vec<String>,
    /// Tasks of the items; if empty, all.
    #[serde(default)]
    tasks: Vec<String>,
    /// Novelties of the items; if empty, all.
    #[serde(default)]
    novelty: Vec<String>,
    /// Number of items.
    #[serde(default = "three")]
    items: usize,
    #[serde(default)]
    order: Order,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Order {
    /// The first item of each set of edited parts, and then the others, in the order of the items.
    #[default]
    Parts,
    /// Items whose edits by the first system reduce the distance to the target most, compared with the source.
    Best,
    /// Items whose edits reduce this distance least.
    Worst,
}

fn three() -> usize {
    3
}

/// Name of each system, with a folder of edits for each of its trainings.
pub(super) type Edits = [(String, Vec<PathBuf>)];

/// Draws a picture of the first take of each system's first training, as SVG and PNG below a folder. Systems without
/// edits are left out.
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
    let (chosen, gains): (Vec<usize>, Vec<Option<f64>>) =
        chosen(picture, first)?.into_iter().unzip();
    for (item, gain) in first.items_at(&chosen)?.iter().zip(gains) {
        let mut made: Vec<EditRow> = Vec::new();
        for (system, answered) in &answered {
            let mut edits = answered.edits.facts().iter();
            let Some(position) = edits.position(|row| row.id == item.id) else {
                continue;
            };
            let rows = answered.edits.rows(&[position])?.into_iter();
            made.extend(rows.map(|row| EditRow {
                system: (*system).clone(),
                ..row
            }));
        }
        let drawn = strip_of(item, &made, &first.skeleton, &UnknownWords::new())?;
        let caption = match gain {
            Some(gain) => format!("{} ({:+.1} cm closer)", drawn.caption, 100.0 * gain),
            None => drawn.caption,
        };
        panels.push((caption, strip(&drawn.rows, &Style::default())));
    }
    anyhow::ensure!(!panels.is_empty(), "there is no item of its tasks");
    let svg = sheet(&panels, 1, Style::default().width);
    write_drawing(out, &file_name(&picture.name), &svg)
}

/// Positions of the items of a picture. For selections by distance, each comes with the distance in metres by which the
/// edit is closer to the target than the source is.
fn chosen(picture: &Picture, answered: &Answered) -> anyhow::Result<Vec<(usize, Option<f64>)>> {
    let items = answered.items.facts();
    let is_one_of =
        |wanted: &[String], found: &str| wanted.is_empty() || wanted.iter().any(|one| one == found);
    let is_wanted = |item: &ItemFacts| {
        let novelty = item.novelty.as_deref().unwrap_or_default();
        is_one_of(&picture.tasks, &item.task) && is_one_of(&picture.novelty, novelty)
    };
    let mut all: Vec<(usize, Option<f64>)> = match picture.order {
        Order::Parts => {
            let mut parts: BTreeSet<&[String]> = BTreeSet::new();
            let (first, others): (Vec<usize>, Vec<usize>) = (0..items.len())
                .filter(|&item| is_wanted(&items[item]))
                .partition(|&item| parts.insert(&items[item].parts));
            let all = first.into_iter().chain(others);
            all.map(|item| (item, None)).collect()
        }
        Order::Best | Order::Worst => {
            let mut all = gains(answered)?;
            all.retain(|&(item, _)| is_wanted(&items[item]));
            all.sort_by(|(_, a), (_, b)| match picture.order {
                Order::Worst => a.total_cmp(b),
                _ => b.total_cmp(a),
            });
            let all = all.into_iter();
            all.map(|(item, gain)| (item, Some(gain))).collect()
        }
    };
    all.truncate(picture.items);
    Ok(all)
}
