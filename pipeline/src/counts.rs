//! Counts of the clips of a dataset, and of the masks and pairs of these clips.

use std::collections::BTreeMap;

use datasets_spec::Dataset;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use tables::{Condition, Tables};

use crate::Error;

#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Share {
    pub(crate) clips: u64,
    pub(crate) frames: u64,
    pub(crate) hours: f64,
}

/// Numbers of clips and frames of one label and frame rate. Integers, so their sums do not depend on the order of the
/// clips.
#[derive(Clone, Debug, Deserialize)]
pub(crate) struct Group {
    /// `None` if the source states no label.
    pub(crate) label: Option<String>,
    pub(crate) fps: f64,
    clips: u64,
    frames: u64,
}

impl Group {
    /// Sums groups with equal keys; groups without a key are left out.
    pub(crate) fn sums<K: Ord>(
        groups: &[Self],
        key: impl Fn(&Self) -> Option<K>,
    ) -> BTreeMap<K, Share> {
        let mut shares: BTreeMap<K, Share> = BTreeMap::new();
        for group in groups {
            if let Some(key) = key(group) {
                let share = shares.entry(key).or_default();
                share.clips += group.clips;
                share.frames += group.frames;
                share.hours += group.frames as f64 / (3600.0 * group.fps);
            }
        }
        shares
    }
}

/// Queries over chosen clips.
pub(crate) struct Counts {
    tables: Tables,
    /// SQL condition on the rows of a table; all rows count if it has none.
    chosen: BTreeMap<&'static str, String>,
}

impl Counts {
    /// Counts of all clips, or of those for which a condition is true.
    pub(crate) fn new(dataset: &Dataset, condition: Option<&Condition>) -> Result<Self, Error> {
        let mut chosen = BTreeMap::new();
        if let Some(condition) = condition.map(Condition::sql) {
            let among = format!("IN (SELECT id FROM motions WHERE {condition})");
            chosen.insert("motions", condition.to_owned());
            chosen.insert("masks", format!("motion_id {among}"));
            chosen.insert("pairs", format!("source_id {among} AND target_id {among}"));
        }
        Ok(Self {
            tables: Tables::of(dataset)?,
            chosen,
        })
    }

    pub(crate) fn rows<T: DeserializeOwned>(
        &mut self,
        columns: &str,
        table: &str,
    ) -> Result<Vec<T>, Error> {
        let query = format!("SELECT {columns} FROM {table} WHERE {}", self.holds(table));
        Ok(self.tables.ask(&query)?.rows()?)
    }

    /// Counts the clips of each label and frame rate, sorted by both.
    pub(crate) fn groups(&mut self, label: &str) -> Result<Vec<Group>, Error> {
        let query = format!(
            "SELECT label, fps, count(*) AS clips, sum(frames) AS frames FROM \
             (SELECT {label} AS label, fps, n_frames::bigint AS frames FROM motions WHERE {}) \
             GROUP BY label, fps ORDER BY label, fps",
            self.holds("motions")
        );
        Ok(self.tables.ask(&query)?.rows()?)
    }

    /// Clips by a label; clips without the label are left out.
    pub(crate) fn shares(&mut self, label: &str) -> Result<BTreeMap<String, Share>, Error> {
        Ok(Group::sums(&self.groups(label)?, |group| {
            group.label.clone()
        }))
    }

    /// Numbers of rows of a table by a label; rows without the label are left out.
    pub(crate) fn labelled(
        &mut self,
        label: &str,
        table: &str,
    ) -> Result<BTreeMap<String, u64>, Error> {
        #[derive(Deserialize)]
        struct Counted {
            label: String,
            rows: u64,
        }

        let query = format!(
            "SELECT label, count(*) AS rows FROM (SELECT {label} AS label FROM {table} WHERE {}) \
             WHERE label IS NOT NULL GROUP BY label",
            self.holds(table)
        );
        let counted: Vec<Counted> = self.tables.ask(&query)?.rows()?;
        let counted = counted.into_iter();
        Ok(counted
            .map(|counted| (counted.label, counted.rows))
            .collect())
    }

    fn holds(&self, table: &str) -> &str {
        self.chosen.get(table).map_or("TRUE", String::as_str)
    }
}
