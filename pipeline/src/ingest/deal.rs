//! Distribution of the motions of a plan over shards.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::dataset::ShardName;
use datasets_spec::record::MotionRow;
use datasets_spec::table::Row;
use datasets_spec::{MotionId, Split};

use super::plan::{Plan, Planned};

/// Source items per shard: few enough that every thread can hold a shard in memory.
pub(crate) const SHARD_SOURCES: usize = 256;

pub(super) struct Item<'a> {
    pub(super) planned: &'a Planned,
    pub(super) source_name: &'a str,
    pub(super) id: Result<MotionId, String>,
}

/// The place of a motion in [`Plan::items`], and its id or why it has none.
type Placed = (usize, Result<MotionId, String>);

/// A shard, and the places of its motions in [`Plan::items`] with their ids.
pub(super) struct Dealt {
    pub(super) name: ShardName,
    pub(super) items: Vec<Placed>,
}

impl Plan {
    /// Distributes the motions that are read over shards, by split. `before` is the number of shards of each split that
    /// precede them.
    pub(super) fn deal(&self, before: &BTreeMap<Split, usize>) -> Vec<Dealt> {
        let mut by_split: BTreeMap<Split, Vec<Placed>> = BTreeMap::new();
        let mut seen = BTreeSet::new();
        for (place, planned) in self.items.iter().enumerate() {
            let id = MotionId::parse(&planned.id)
                .map_err(|error| error.to_string())
                .and_then(|id| match seen.insert(&planned.id) {
                    true => Ok(id),
                    false => Err(format!("another motion has the id {id} already")),
                });
            if !planned.is_kept {
                by_split.entry(planned.split).or_default().push((place, id));
            }
        }
        let mut shards = Vec::new();
        for (split, mut items) in by_split {
            let first = before.get(&split).copied().unwrap_or(0);
            let of = first + items.len().div_ceil(SHARD_SOURCES);
            for index in first..of {
                let rest = items.split_off(items.len().min(SHARD_SOURCES));
                let name = ShardName {
                    table: MotionRow::TABLE,
                    split: Some(split),
                    index,
                    of,
                };
                let items = std::mem::replace(&mut items, rest);
                shards.push(Dealt { name, items });
            }
        }
        shards
    }

    pub(super) fn items_of(&self, shard: &Dealt) -> Vec<Item<'_>> {
        let items = shard.items.iter();
        items
            .map(|(place, id)| self.item(*place, id.clone()))
            .collect()
    }

    pub(super) fn items_with_ids(&self, ids: &BTreeSet<&str>) -> Vec<Item<'_>> {
        let items = self.items.iter().enumerate();
        let items = items.filter(|(_, item)| !item.is_kept && ids.contains(item.id.as_str()));
        items
            .filter_map(|(place, item)| Some(self.item(place, Ok(MotionId::parse(&item.id).ok()?))))
            .collect()
    }

    fn item(&self, place: usize, id: Result<MotionId, String>) -> Item<'_> {
        let planned = &self.items[place];
        Item {
            planned,
            source_name: self.source_name(&planned.entry.file),
            id,
        }
    }
}
