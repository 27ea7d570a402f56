//! Tasks of the evaluation.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::EditKind;

/// Task of a test question.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ItemTask {
    /// A body part does something else.
    Semantic,
    /// A body part moves in another style.
    Style,
    /// A body part moves a little differently.
    FineGrained,
    /// A pair of MotionFix: no donor, no blending, source and target of any length.
    #[serde(rename = "motionfix")]
    MotionFix,
}

impl ItemTask {
    /// All tasks, in the order of the paper's tables.
    pub const ALL: [Self; 4] = [
        Self::Semantic,
        Self::Style,
        Self::FineGrained,
        Self::MotionFix,
    ];

    /// The name in tables.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Semantic => EditKind::Semantic.as_str(),
            Self::Style => EditKind::Style.as_str(),
            Self::FineGrained => EditKind::FineGrained.as_str(),
            Self::MotionFix => "motionfix",
        }
    }
}

impl FromStr for ItemTask {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        Self::ALL
            .into_iter()
            .find(|task| task.as_str() == name)
            .ok_or_else(|| {
                let known = Self::ALL.map(Self::as_str).join(", ");
                format!("{name:?} is no task; known are {known}")
            })
    }
}

impl fmt::Display for ItemTask {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}
