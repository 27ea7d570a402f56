//! A defect, and the check that found it.

use serde::Serialize;

/// Subject of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Check {
    /// Files exist with the recorded size and hash.
    Files,
    /// Every table has its columns, and rows decode.
    Schema,
    /// Motions match their hashes and counts.
    Contents,
    /// Rows that name a motion or an item name an existing one and agree with it.
    References,
    /// Edits are unique by system, item and seed; a system has one checkpoint and one set of settings.
    Systems,
    /// No recording is in two splits.
    Splits,
    /// The number of sources is the sum of ingested, quarantined and skipped ones.
    Accounting,
}

impl Check {
    /// Every check, in the order they are made.
    pub const ALL: [Check; 7] = [
        Self::Files,
        Self::Schema,
        Self::Contents,
        Self::References,
        Self::Systems,
        Self::Splits,
        Self::Accounting,
    ];

    /// Name of the check.
    pub fn name(self) -> String {
        format!("{self:?}").to_lowercase()
    }
}

/// A defect.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct Finding {
    /// The check that found it.
    pub check: Check,
    /// The file, motion or row.
    pub item: String,
    /// What is wrong, with the numbers found and expected.
    pub problem: String,
}

impl Finding {
    pub(super) fn new(check: Check, item: impl Into<String>, problem: impl Into<String>) -> Self {
        Self {
            check,
            item: item.into(),
            problem: problem.into(),
        }
    }
}
