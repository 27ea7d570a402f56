//! The labels of two merged datasets.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::manifest::{RejectedPairs, add_rejected};
use datasets_spec::record::{MaskRow, PairRow};
use datasets_spec::rejected::{RejectedMask, RejectedMasks, Rejections};
use datasets_spec::table::Row;
use datasets_spec::{MotionId, Split};

use super::part::Part;
use crate::Error;
use crate::annotation::pairs::is_from_labels;
use crate::versions::{
    Labels, is_mask_of_people, is_mask_of_source, is_pair_judged, is_pair_of_people,
};

/// The pairs and masks that people rejected in either dataset, with the ids of the result.
pub(super) fn rejected(parts: &[&Part<'_>; 2]) -> Result<(RejectedPairs, RejectedMasks), Error> {
    let (mut all_pairs, mut all_masks) = (RejectedPairs::new(), RejectedMasks::new());
    for part in parts {
        let manifest = part.dataset.manifest();
        let renamed = |clips: &[MotionId; 2]| clips.each_ref().map(|id| part.id(id));
        let pairs = manifest.rejected_pairs()?.into_iter();
        let pairs = pairs.map(|(project, pairs)| (project, pairs.iter().map(renamed).collect()));
        add_rejected(&mut all_pairs, pairs);
        let renamed = |rejected: RejectedMask| RejectedMask {
            clip: part.id(&rejected.clip),
            ..rejected
        };
        let masks = manifest.rejected_masks()?.into_iter();
        let masks =
            masks.map(|(project, masks)| (project, masks.into_iter().map(renamed).collect()));
        add_rejected(&mut all_masks, masks);
    }
    Ok((all_pairs, all_masks))
}

/// The labels of both datasets, and those that the result does not take.
#[derive(Default)]
pub(super) struct MergedLabels {
    pub(super) rows: Labels,
    /// Ids of pairs whose motions are in two splits now.
    pub(super) parted: Vec<String>,
    pub(super) rejected: BTreeSet<String>,
    pub(super) gave_way: BTreeMap<String, u64>,
    /// New ids of labels of the second dataset, by table and by their old ids, under which the first has another label.
    pub(super) renamed: BTreeMap<&'static str, BTreeMap<String, String>>,
}

impl MergedLabels {
    /// How many were not taken, in words; empty if all were.
    pub(super) fn says(&self) -> String {
        let gave_way = self.gave_way.iter().map(|(table, count)| {
            format!("; {count} automatic {table} gave way to those of the other dataset")
        });
        let mut text: String = gave_way.collect();
        let renamed: usize = self.renamed.values().map(BTreeMap::len).sum();
        if renamed > 0 {
            text += &format!("; {renamed} labels of the second dataset got another id");
        }
        if !self.rejected.is_empty() {
            text += &format!(
                "; {} pairs and masks that people rejected left",
                self.rejected.len()
            );
        }
        text
    }
}

/// The labels of both datasets, without those that people rejected in either and nobody accepted, and without pairs
/// whose motions are in two splits now. Of clips that both have, the second dataset gives automatic labels
/// only where the first has none, and labels that only one of them has from people replace automatic ones of the other.
pub(super) fn labels(
    parts: &[&Part<'_>; 2],
    splits: &BTreeMap<MotionId, Split>,
    rejected_pairs: &RejectedPairs,
    rejected_masks: &RejectedMasks,
) -> Result<MergedLabels, Error> {
    let mut labels = MergedLabels::default();
    let rejected: BTreeSet<&[MotionId; 2]> = rejected_pairs.values().flatten().collect();
    let mut contents: BTreeMap<MotionId, String> = BTreeMap::new();
    for part in parts {
        let of_part = part.dataset.contents()?;
        contents.extend(
            of_part
                .into_iter()
                .map(|(id, content)| (part.id(&id), content)),
        );
    }
    let rejections = Rejections::holding(rejected_masks, &contents);
    let mut masks: [Vec<MaskRow>; 2] = Default::default();
    let mut pairs: [Vec<PairRow>; 2] = Default::default();
    for (number, part) in parts.iter().enumerate() {
        for mut mask in part.dataset.read::<MaskRow>(None)? {
            mask.motion_id = part.id(&mask.motion_id);
            if !is_mask_of_people(&mask) && rejections.has(&mask) {
                labels.rejected.insert(mask.id);
                continue;
            }
            mask.split = *splits.get(&mask.motion_id).unwrap_or(&mask.split);
            masks[number].push(mask);
        }
        for mut pair in part.dataset.read::<PairRow>(None)? {
            pair.source_id = part.id(&pair.source_id);
            pair.target_id = part.id(&pair.target_id);
            if !is_pair_judged(&pair) && rejected.contains(&clips_of(&pair)) {
                labels.rejected.insert(pair.id);
                continue;
            }
            let split = splits.get(&pair.target_id).copied();
            if split != splits.get(&pair.source_id).copied() {
                labels.parted.push(pair.id);
                continue;
            }
            pair.split = split.unwrap_or(pair.split);
            pairs[number].push(pair);
        }
    }
    let described = Labelled::of(&masks, |mask| mask.motion_id.clone(), is_mask_of_people);
    let parts_of = |mask: &MaskRow| (mask.motion_id.clone(), mask.parts.clone());
    let masked = Labelled::of(&masks, parts_of, is_mask_of_people);
    let gives_way = |number: usize, mask: &MaskRow| {
        let is_automatic = !is_mask_of_people(mask) && !is_mask_of_source(mask);
        is_automatic
            && match described.is_of_people(&mask.motion_id) {
                // People describe a clip by all its masks: no automatic mask brings back a part that they left out.
                [true, false] => number == 1,
                [false, true] => number == 0,
                _ => masked.replaces(number, &parts_of(mask)),
            }
    };
    let renamed = labels.renamed.entry(MaskRow::TABLE).or_default();
    let table = &mut labels.rows.masks;
    let masks = take(table, parts, masks, |mask| &mut mask.id, gives_way, renamed);
    let paired = Labelled::of(&pairs, clips_of, is_pair_of_people);
    let gives_way = |number: usize, pair: &PairRow| {
        is_from_labels(pair) && paired.replaces(number, &clips_of(pair))
    };
    let renamed = labels.renamed.entry(PairRow::TABLE).or_default();
    let table = &mut labels.rows.pairs;
    let pairs = take(table, parts, pairs, |pair| &mut pair.id, gives_way, renamed);
    let counts = [(MaskRow::TABLE, masks), (PairRow::TABLE, pairs)].into_iter();
    labels.gave_way = counts
        .filter(|(_, count)| *count > 0)
        .map(|(table, count)| (table.to_owned(), count))
        .collect();
    labels.renamed.retain(|_, renamed| !renamed.is_empty());
    Ok(labels)
}

fn clips_of(pair: &PairRow) -> [MotionId; 2] {
    [pair.source_id.clone(), pair.target_id.clone()]
}

/// What the labels of each of two datasets are about: clips, parts of clips, or source and target.
struct Labelled<K> {
    all: [BTreeSet<K>; 2],
    by_people: [BTreeSet<K>; 2],
}

impl<K: Ord> Labelled<K> {
    fn of<R>(rows: &[Vec<R>; 2], about: fn(&R) -> K, is_of_people: fn(&R) -> bool) -> Self {
        Self {
            all: rows.each_ref().map(|rows| rows.iter().map(about).collect()),
            by_people: rows.each_ref().map(|rows| {
                let rows = rows.iter().filter(|row| is_of_people(row));
                rows.map(about).collect()
            }),
        }
    }

    /// Whether people labelled this in each dataset.
    fn is_of_people(&self, about: &K) -> [bool; 2] {
        self.by_people
            .each_ref()
            .map(|labelled| labelled.contains(about))
    }

    /// Whether the other dataset has a label that replaces an automatic one of dataset `number`: of people, or any of
    /// the first dataset.
    fn replaces(&self, number: usize, about: &K) -> bool {
        self.is_of_people(about)[1 - number] || number == 1 && self.all[0].contains(about)
    }
}

/// Adds the rows that do not give way to a table, and returns the number of the others.
fn take<R: PartialEq>(
    table: &mut BTreeMap<String, R>,
    parts: &[&Part<'_>; 2],
    rows: [Vec<R>; 2],
    id: fn(&mut R) -> &mut String,
    gives_way: impl Fn(usize, &R) -> bool,
    renamed: &mut BTreeMap<String, String>,
) -> u64 {
    let mut left = Vec::new();
    for (number, rows) in rows.into_iter().enumerate() {
        for row in rows {
            match gives_way(number, &row) {
                true => left.push(row),
                false => renamed.extend(insert(table, row, &parts[number].label, id)),
            }
        }
    }
    // Of two equal rows one is taken, and none gave way.
    left.retain_mut(|row| table.get(id(row)) != Some(row));
    left.len() as u64
}

/// Adds a row under its id. If another row has that id, the row gets an id with the label of its dataset, and its old and
/// its new id are returned.
fn insert<R: PartialEq>(
    rows: &mut BTreeMap<String, R>,
    mut row: R,
    label: &str,
    id: fn(&mut R) -> &mut String,
) -> Option<(String, String)> {
    let own = id(&mut row).clone();
    let mut numbers = 2..;
    let mut candidate = own.clone();
    while rows.get(&candidate).is_some_and(|other| *other != row) {
        candidate = match id(&mut row) == &own {
            true => format!("{own} ({label})"),
            false => format!(
                "{own} ({label} {})",
                numbers.next().expect("numbers do not end")
            ),
        };
        id(&mut row).clone_from(&candidate);
    }
    rows.insert(candidate.clone(), row);
    (candidate != own).then_some((own, candidate))
}
