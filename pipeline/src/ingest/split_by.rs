//! What clips that share a drawn split have in common.

use std::fmt;
use std::str::FromStr;

use datasets_spec::manifest::{Manifest, SPLIT_BY_FACT};
use datasets_spec::record::MotionRow;
use datasets_spec::table::Row;
use serde::{Deserialize, Serialize};

use super::plan::{Plan, Planned};

/// What drawn splits keep together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SplitBy {
    /// All that is cut from a source clip, and styles of one take.
    #[default]
    Clip,
    /// All clips of a subject of a source.
    Subject,
    /// All clips of an action, in any source.
    Action,
}

impl SplitBy {
    const ALL: [Self; 3] = [Self::Clip, Self::Subject, Self::Action];

    /// The name in options and cards.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Clip => "clip",
            Self::Subject => "subject",
            Self::Action => "action",
        }
    }

    /// What a dataset that exists was drawn by; none for a new one.
    pub(super) fn recorded(base: Option<&Manifest>) -> Option<Self> {
        let base = base.filter(|base| base.plans.contains_key(MotionRow::TABLE))?;
        let fact = base.facts.get(SPLIT_BY_FACT);
        Some(fact.map_or(Self::Clip, |name| name.parse().unwrap_or_default()))
    }
}

impl FromStr for SplitBy {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|by| by.as_str() == name);
        found.ok_or_else(|| {
            let known = Self::ALL.map(Self::as_str).join(", ");
            format!("{name:?} is none of {known}")
        })
    }
}

impl fmt::Display for SplitBy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl Plan {
    /// The label of a clip that its split is drawn by; none if it has none, or splits are drawn by clip.
    pub(super) fn split_label(&self, item: &Planned) -> Option<String> {
        match self.split_by {
            SplitBy::Clip => None,
            SplitBy::Subject => {
                let source = self.source_name(&item.entry.file);
                item.subject
                    .as_ref()
                    .map(|subject| format!("subject:{source}/{subject}"))
            }
            SplitBy::Action => item
                .action
                .as_ref()
                .map(|action| format!("action:{action}")),
        }
    }

    /// Says how many clips lack the label that splits are drawn by.
    pub(super) fn note_split_labels(&mut self) {
        if self.split_by == SplitBy::Clip {
            return;
        }
        let lacking = self
            .items
            .iter()
            .filter(|item| self.split_label(item).is_none());
        let count = lacking.count();
        if count > 0 {
            self.remarks.push(format!(
                "{count} of {} clips state no {by}, and their splits were drawn by clip; a label file, a sidecar or a table of \
                 the source states it",
                self.items.len(),
                by = self.split_by
            ));
        }
    }
}
