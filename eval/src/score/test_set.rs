//! The test set: items, and the takes of every system, checked and in the same order.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::Fps;
use kinematics::canonical::FIXED_FRAMES;

use crate::Error;
use crate::answered::{Answered, same_take};
use crate::metric::motion_quality::Windows;
use crate::names::{ALL_TASKS, GIVEN, NOVELTIES, RECAPTURED};
use crate::protocol::Protocol;
use crate::rows::{EditFacts, ItemFacts};
use crate::table::Items;

/// Hexadecimal digits of the digest of the sorted item ids.
const DIGEST_DIGITS: usize = 12;
/// Maximum number of ids that an error message lists.
const MAX_IDS_SHOWN: usize = 5;

/// The items and the edits of all systems, in the order of the item ids.
pub(crate) struct TestSet<'a> {
    pub(super) answered: &'a Answered,
    /// Position in `answered.items` of each item.
    pub(super) items: Vec<usize>,
    /// Takes of each system; a take lists the position of its edit for every item.
    pub(crate) systems: BTreeMap<&'a str, Vec<Vec<usize>>>,
}

impl<'a> TestSet<'a> {
    /// Sorts and checks the rows, and keeps the items that the protocol scores.
    pub(crate) fn new(answered: &'a Answered, protocol: &Protocol) -> Result<Self, Error> {
        let mut by_id: BTreeMap<&str, usize> = BTreeMap::new();
        for (position, item) in answered.items.facts().iter().enumerate() {
            if item.target_frames == 0 {
                return Err(Error::Invalid(format!(
                    "item {:?} has no target to compare with; score items drawn by `stance items`",
                    item.id
                )));
            }
            by_id.insert(&item.id, position);
        }
        if by_id.is_empty() {
            let problem = "the table holds no items; draw them with `stance items`";
            return Err(Error::Invalid(problem.to_owned()));
        }
        let ids: Vec<&str> = by_id.keys().copied().collect();
        let mut by_system: BTreeMap<&str, OfSystem<'_>> = BTreeMap::new();
        for (position, row) in answered.edits.facts().iter().enumerate() {
            if GIVEN.contains(&row.system.as_str()) {
                return Err(Error::Invalid(format!(
                    "a system cannot be named {:?}, which is a row of every table; rename it",
                    row.system
                )));
            }
            by_system
                .entry(&row.system)
                .or_default()
                .entry(&row.id)
                .or_default()
                .push((row.seed, position));
        }
        let kept = protocol.scored_items(ids.len())?;
        let systems = by_system
            .into_iter()
            .map(|(system, rows)| {
                let takes = takes(system, rows, &ids)?
                    .into_iter()
                    .map(|rows| kept.iter().map(|&item| rows[item]).collect())
                    .collect();
                Ok((system, takes))
            })
            .collect::<Result<_, Error>>()?;
        let items: Vec<usize> = by_id.into_values().collect();
        Ok(Self {
            answered,
            systems,
            items: kept.iter().map(|&item| items[item]).collect(),
        })
    }

    /// Columns of an item besides its motions.
    pub(super) fn item(&self, index: usize) -> &'a ItemFacts {
        &self.answered.items.facts()[self.items[index]]
    }

    /// Windows of the systems that record their windows; `None` if they differ.
    pub(super) fn windows(&self) -> Option<Windows> {
        let edits = self.answered.edits.facts();
        let first = |takes: &Vec<Vec<usize>>| windows_of(&edits[*takes.first()?.first()?]);
        let mut all = self.systems.values().filter_map(first);
        let windows = all.next()?;
        all.all(|other| other == windows).then_some(windows)
    }

    /// Ids of the motions that the items' targets were made of.
    pub(crate) fn targets(&self, indices: &[usize]) -> impl Iterator<Item = &'a str> {
        indices
            .iter()
            .map(|&item| self.item(item).target_id.as_str())
    }

    /// Numbers of distinct targets, sources and instructions of items, and the digest of their ids.
    pub(crate) fn counts(&self, indices: &[usize]) -> Items {
        let distinct = |of: fn(&'a ItemFacts) -> &'a str| {
            let names: BTreeSet<&str> = indices.iter().map(|&item| of(self.item(item))).collect();
            names.len() as u32
        };
        let mut hasher = blake3::Hasher::new();
        for &item in indices {
            hasher.update(self.item(item).id.as_bytes());
            hasher.update(b"\n");
        }
        let mut digest = hasher.finalize().to_hex().to_string();
        digest.truncate(DIGEST_DIGITS);
        Items {
            count: indices.len() as u32,
            targets: distinct(|item| item.target_id.as_str()),
            sources: distinct(|item| item.source_id.as_str()),
            instructions: distinct(|item| &item.instruction),
            novelty: self.novelty(indices),
            digest,
        }
    }

    /// Number of motions that will be encoded.
    pub(super) fn num_motions(&self) -> usize {
        let num_takes: usize = self.systems.values().map(Vec::len).sum();
        (2 + num_takes) * self.items.len() + self.recaptured().len()
    }

    /// Positions of the items whose target was captured more than once.
    pub(super) fn recaptured(&self) -> Vec<usize> {
        (0..self.items.len())
            .filter(|&index| self.item(index).other_frames > 0)
            .collect()
    }

    /// Number of items of each novelty, in words; empty if no item states its novelty.
    fn novelty(&self, indices: &[usize]) -> String {
        let found: Vec<&str> = indices
            .iter()
            .filter_map(|&item| self.item(item).novelty.as_deref())
            .collect();
        if found.is_empty() {
            return String::new();
        }
        let counts = NOVELTIES.iter().map(|value| {
            let count = found.iter().filter(|found| *found == value).count();
            (count, *value)
        });
        let unknown = (indices.len() - found.len(), "not known");
        let counts = counts.chain([unknown]).filter(|(count, _)| *count > 0);
        let counts: Vec<String> = counts
            .map(|(count, value)| format!("{count} {value}"))
            .collect();
        counts.join(", ")
    }

    /// Positions of the items of each novelty; empty unless there are several novelties.
    fn novelties(&self) -> Vec<(&'a str, Vec<usize>)> {
        let of_value = NOVELTIES.iter().map(|value| {
            let is_of = |index: &usize| self.item(*index).novelty.as_deref() == Some(*value);
            let items = (0..self.items.len()).filter(is_of);
            (*value, items.collect::<Vec<_>>())
        });
        let found: Vec<_> = of_value.filter(|(_, items)| !items.is_empty()).collect();
        match found.len() {
            0 | 1 => Vec::new(),
            _ => found,
        }
    }

    /// Positions of the items of all tasks together, of each task, of each novelty, and of the recaptured items.
    pub(crate) fn tasks(&self) -> Vec<(&'a str, Vec<usize>)> {
        let mut kinds: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
        for index in 0..self.items.len() {
            kinds.entry(&self.item(index).task).or_default().push(index);
        }
        let all = (kinds.len() > 1).then(|| (ALL_TASKS, (0..self.items.len()).collect()));
        let recaptured =
            Some((RECAPTURED, self.recaptured())).filter(|(_, items)| !items.is_empty());
        let novelties = self.novelties().into_iter();
        let single = all.into_iter().chain(kinds).chain(novelties);
        single.chain(recaptured).collect()
    }
}

/// The windows recorded in the edit's settings.
pub(super) fn windows_of(row: &EditFacts) -> Option<Windows> {
    let settings: serde_json::Value = serde_json::from_str(&row.settings).ok()?;
    let count = |name: &str| usize::try_from(settings.get(name)?.as_u64()?).ok();
    let frames = count("window")?;
    let fps = match settings.get("fps").and_then(serde_json::Value::as_f64) {
        Some(fps) => Fps::new(fps).ok()?,
        None => Fps::MODEL,
    };
    let advance = match count("advance") {
        Some(advance) => advance,
        None => frames.checked_sub(FIXED_FRAMES)?,
    };
    Some(Windows {
        frames,
        advance,
        fps,
    })
}

/// Seeds and positions of the edits of each item.
type OfSystem<'a> = BTreeMap<&'a str, Vec<(u64, usize)>>;

/// Checks the edits of a system. Returns its takes, sorted by seed, each as the positions of its edits by item id.
fn takes<'a>(system: &str, rows: OfSystem<'a>, ids: &[&'a str]) -> Result<Vec<Vec<usize>>, Error> {
    let missing = ids.iter().copied().filter(|id| !rows.contains_key(id));
    let missing: Vec<&str> = missing.collect();
    if !missing.is_empty() {
        return Err(Error::Invalid(format!(
            "system {system:?} lacks {} of {} items: {}; edit them or leave the system out",
            missing.len(),
            ids.len(),
            listed(&missing)
        )));
    }
    let is_unknown = |id: &&str| ids.binary_search(id).is_err();
    let unknown: Vec<&str> = rows.keys().copied().filter(is_unknown).collect();
    if !unknown.is_empty() {
        return Err(Error::Invalid(format!(
            "system {system:?} has {} items without a target: {}; score them with the table they belong to",
            unknown.len(),
            listed(&unknown)
        )));
    }
    let num_takes = rows.values().next().map_or(0, Vec::len);
    let mut takes = vec![Vec::with_capacity(ids.len()); num_takes];
    for (id, mut rows) in rows {
        if rows.len() != num_takes {
            return Err(Error::Invalid(format!(
                "system {system:?} has {} motions of item {id:?} but {num_takes} of the others; give every item the \
                 same number of takes",
                rows.len()
            )));
        }
        rows.sort_unstable();
        if let Some(twice) = rows.windows(2).find(|pair| pair[0].0 == pair[1].0) {
            return Err(same_take(system, id, twice[0].0));
        }
        for (take, (_, position)) in takes.iter_mut().zip(rows) {
            take.push(position);
        }
    }
    Ok(takes)
}

fn listed(ids: &[&str]) -> String {
    let mut text = ids[..ids.len().min(MAX_IDS_SHOWN)].join(", ");
    if ids.len() > MAX_IDS_SHOWN {
        text.push_str(", …");
    }
    text
}
