//! A defect, and the check that found it.

use serde::Serialize;

datasets_spec::named! {
    /// Subject of a finding. The order is that in which the checks are made.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
    #[serde(rename_all = "lowercase")]
    pub enum Check, named by name {
        /// Files exist with the recorded size and hash.
        Files = "files",
        /// Every table has its columns, and rows decode.
        Schema = "schema",
        /// Motions match their hashes and counts.
        Contents = "contents",
        /// Rows that name a motion or an item name an existing one and agree with it.
        References = "references",
        /// Edits are unique by system, item and seed; a system has one checkpoint and one set of settings.
        Systems = "systems",
        /// No recording is in two splits.
        Splits = "splits",
        /// The number of sources is the sum of ingested, quarantined and skipped ones.
        Accounting = "accounting",
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
