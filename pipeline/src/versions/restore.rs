//! Going back to an older version.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::manifest::{Manifest, plan_hash};
use datasets_spec::record::{MaskRow, MotionRow, PairRow};
use datasets_spec::rejected::MaskPlace;
use datasets_spec::table::{Row, ShardReader};
use datasets_spec::{Dataset, MotionId, Split, Transaction};
use serde::Serialize;

use super::labels::{
    KeptLabel, Labels, check_lost, is_mask_of_people, is_mask_of_source, is_pair_judged,
    is_pair_of_people,
};
use crate::Error;
use crate::ingest::LostLabel;

/// Result of [`restore`].
#[derive(Clone, Debug, Serialize)]
pub struct Restored {
    /// Number of the restored version.
    pub restored: u64,
    /// Number of the new version, or of the newest one if nothing had to change.
    pub version: u64,
    /// Whether the restored version equals the newest one.
    pub is_current: bool,
    /// Clips of the result.
    pub clips: u64,
    /// Rows of each table.
    pub tables: BTreeMap<String, u64>,
    /// Newer labels by people that are kept, because the restored version has their clips with the same motion.
    pub kept: Vec<KeptLabel>,
    /// Newer labels by people that are lost, because the restored version does not have their clips, or has other
    /// motions. The previous version keeps them.
    pub lost: Vec<LostLabel>,
    /// Number of automatic masks of the restored version that are left out, because people have since described their clips
    /// without them.
    pub gave_way: u64,
    /// Ids of pairs and masks of the restored version that people have rejected since; the result does not contain them.
    pub rejected: Vec<String>,
    /// Tables of the previous version that the result does not contain.
    pub left_tables: Vec<String>,
    /// Hash of the result.
    pub root_hash: String,
}

/// Hash of the motion, and split, of every clip.
type Clips = BTreeMap<MotionId, (String, Split)>;

fn clips(dataset: &Dataset) -> Result<Clips, Error> {
    let mut clips = Clips::new();
    for (path, file) in dataset.files(MotionRow::TABLE, None) {
        let shard = ShardReader::open(&path)?;
        let ids = shard.column::<MotionRow, MotionId>("id")?;
        let contents = shard.column::<MotionRow, String>("content_hash")?;
        let split = file.split.unwrap_or(Split::Train);
        let rows = ids.into_iter().zip(contents);
        clips.extend(rows.map(|(id, content)| (id, (content, split))));
    }
    Ok(clips)
}

/// Makes an older version the newest one, under a new number. Newer labels by people stay if that version has their
/// clips with the same motion.
///
/// # Errors
/// There is no such version, one of its files is damaged, labels would be lost and `drop_labels` does not allow it,
/// or the folder cannot be written.
pub fn restore(
    transaction: Transaction,
    version: u64,
    drop_labels: bool,
) -> Result<Restored, Error> {
    let root = &transaction.root().to_owned();
    let now = Dataset::open_unverified(root)?;
    let old = Dataset::open_version(root, version)?;
    let before = Labels::read(&old)?;
    let mut merge = Merge {
        old: clips(&old)?,
        now: clips(&now)?,
        labels: before.clone(),
        kept: Vec::new(),
        lost: Vec::new(),
        gave_way: 0,
    };
    let current = Labels::read(&now)?;
    merge.take(current.clone());
    let Merge {
        mut labels,
        kept,
        lost,
        gave_way,
        ..
    } = merge;
    check_lost(root, &lost, drop_labels)?;
    let rejected = now.manifest().rejected_pairs()?.into_values().flatten();
    let rejected: BTreeSet<[MotionId; 2]> = rejected.collect();
    // What people accepted in the newest version was accepted after any rejection of it.
    let is_rejected = |pair: &PairRow| {
        let clips = |pair: &PairRow| [pair.source_id.clone(), pair.target_id.clone()];
        let held = current.pairs.get(&pair.id);
        let is_accepted =
            held.is_some_and(|held| is_pair_judged(held) && clips(held) == clips(pair));
        !is_accepted && rejected.contains(&clips(pair))
    };
    let rejected = labels.pairs.extract_if(.., |_, pair| is_rejected(pair));
    let mut rejected: Vec<String> = rejected.map(|(id, _)| id).collect();
    let rejections = old.rejections(&now.manifest().rejected_masks()?)?;
    let place = |mask: &MaskRow| (mask.motion_id.clone(), MaskPlace::of(mask));
    let accepted = current.masks.values();
    let accepted = accepted.filter(|mask| is_mask_of_people(mask));
    let accepted: BTreeSet<(MotionId, MaskPlace)> = accepted.map(place).collect();
    let is_rejected = |mask: &MaskRow| rejections.has(mask) && !accepted.contains(&place(mask));
    let masks = labels.masks.extract_if(.., |_, mask| is_rejected(mask));
    rejected.extend(masks.map(|(id, _)| id));
    let left = now.manifest().tables.keys();
    let left = left.filter(|table| !old.manifest().tables.contains_key(*table));
    let left_tables = left
        .filter(|table| *table != MaskRow::TABLE || labels.masks.is_empty())
        .filter(|table| *table != PairRow::TABLE || labels.pairs.is_empty())
        .cloned()
        .collect();
    let facts = transaction.restored_facts(old.manifest())?;
    let is_current = labels == current && is_alike(old.manifest(), &facts, now.manifest());
    let dataset = if is_current {
        transaction.finish()?;
        now
    } else {
        let made_of = (&old.manifest().root_hash, &labels.masks, &labels.pairs);
        let plan = plan_hash("restore", &made_of);
        let tables = labels.write(&before, &transaction, &old.skeleton()?, &plan)?;
        transaction.restore(old.manifest(), tables, &plan)?
    };
    let manifest = dataset.manifest();
    Ok(Restored {
        restored: version,
        version: manifest.version,
        is_current,
        clips: manifest.rows(MotionRow::TABLE, None),
        tables: manifest.row_counts(),
        kept,
        lost,
        gave_way,
        rejected,
        left_tables,
        root_hash: manifest.root_hash.clone(),
    })
}

/// Whether a version, restored with these facts, equals another except for labels.
fn is_alike(a: &Manifest, facts: &BTreeMap<String, String>, b: &Manifest) -> bool {
    let tables = |manifest: &Manifest| {
        let mut tables = manifest.tables.clone();
        tables.retain(|table, _| ![MaskRow::TABLE, PairRow::TABLE].contains(&table.as_str()));
        tables
    };
    (tables(a), facts, &a.skeleton) == (tables(b), &b.facts, &b.skeleton)
}

/// Labels of an older version, to which newer labels by people are added.
struct Merge {
    old: Clips,
    now: Clips,
    labels: Labels,
    kept: Vec<KeptLabel>,
    lost: Vec<LostLabel>,
    gave_way: u64,
}

impl Merge {
    fn take(&mut self, now: Labels) {
        self.leave_what_people_left_out(&now);
        for mask in now.masks.into_values().filter(is_mask_of_people) {
            let (table, id) = (MaskRow::TABLE, mask.id.clone());
            if let Some(split) = self.split_of(table, &id, [&mask.motion_id; 2]) {
                self.insert_mask(MaskRow { split, ..mask });
            }
        }
        for pair in now.pairs.into_values().filter(is_pair_of_people) {
            let (table, id) = (PairRow::TABLE, pair.id.clone());
            if let Some(split) = self.split_of(table, &id, [&pair.source_id, &pair.target_id]) {
                let pair = PairRow { split, ..pair };
                if self.labels.pairs.get(&id) != Some(&pair) {
                    self.keep(table, &id);
                    self.labels.pairs.insert(id, pair);
                }
            }
        }
    }

    /// Removes automatic masks of the older version whose clips people have described since, unless the newest version has
    /// them too. People describe a clip by all its masks.
    fn leave_what_people_left_out(&mut self, now: &Labels) {
        let described = now.masks.values().filter(|mask| is_mask_of_people(mask));
        let described: BTreeSet<&MotionId> = described
            .map(|mask| &mask.motion_id)
            .filter(|clip| {
                self.old.get(*clip).map(|old| &old.0) == self.now.get(*clip).map(|now| &now.0)
            })
            .collect();
        let is_left_out = |id: &String, mask: &MaskRow| {
            let is_automatic = !is_mask_of_people(mask) && !is_mask_of_source(mask);
            is_automatic && described.contains(&mask.motion_id) && !now.masks.contains_key(id)
        };
        let left_out = self
            .labels
            .masks
            .extract_if(.., |id, mask| is_left_out(id, mask));
        // A mask by people of the same parts takes the place of an automatic one; nothing is lost then.
        let of_people = now.masks.values().filter(|mask| is_mask_of_people(mask));
        let parts = of_people.map(|mask| (&mask.motion_id, mask.parts.as_slice()));
        let parts: BTreeSet<(&MotionId, &[String])> = parts.collect();
        let is_gone = |mask: &MaskRow| !parts.contains(&(&mask.motion_id, mask.parts.as_slice()));
        self.gave_way += left_out.filter(|(_, mask)| is_gone(mask)).count() as u64;
    }

    /// Adds a mask. It replaces an automatic mask of the same parts, as when the mask was made.
    fn insert_mask(&mut self, mask: MaskRow) {
        if self.labels.masks.get(&mask.id) == Some(&mask) {
            return;
        }
        self.labels.masks.retain(|_, other| {
            is_mask_of_people(other)
                || other.motion_id != mask.motion_id
                || other.parts != mask.parts
        });
        self.keep(MaskRow::TABLE, &mask.id);
        self.labels.masks.insert(mask.id.clone(), mask);
    }

    fn keep(&mut self, table: &str, id: &str) {
        self.kept.push(KeptLabel {
            table: table.to_owned(),
            id: id.to_owned(),
        });
    }

    /// The split of the clips of a label in the older version. A label whose clips have no common split there is noted
    /// as lost.
    fn split_of(&mut self, table: &str, id: &str, clips: [&MotionId; 2]) -> Option<Split> {
        let mut splits: Vec<Split> = Vec::new();
        for clip in clips {
            let reason = match self.old.get(clip) {
                None => format!("{clip} is not in that version"),
                Some((old, _)) if self.now.get(clip).is_some_and(|(now, _)| now != old) => {
                    format!("{clip} has another motion in that version")
                }
                Some((_, split)) if splits.first().is_some_and(|first| first != split) => {
                    "its clips are in two splits in that version".to_owned()
                }
                Some((_, split)) => {
                    splits.push(*split);
                    continue;
                }
            };
            self.lost.push(LostLabel::new(table, id, clip, reason));
            return None;
        }
        splits.first().copied()
    }
}
