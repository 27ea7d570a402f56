//! The tables of an export, written like all tables of `stance`: Parquet, Zstandard, the schema version in the
//! footer, the same bytes for the same rows.

use datasets_spec::table;

table! {
    /// An accepted mask of a motion, or an accepted judgement of a pair.
    pub struct AnnotationRow = "annotations" {
        /// What tells the task from others
        pub task: String [""],
        /// mask_text, pair or style
        pub kind: String [""],
        /// Motion, or the one before the edit
        pub motion_id: String [""],
        /// Motion after the edit
        pub target_id: Option<String> [""],
        /// train, val or test
        pub split: String [""],
        /// Action category of the source
        pub category: Option<String> [""],
        /// What the pair was made for
        pub hint: Option<String> [""],
        /// Style the source gives
        pub source_style: Option<String> [""],
        /// Place of the mask in its answer, from 0; 0 for pairs
        pub number: u32 [""],
        /// Masks of the answer; 1 for pairs, 0 for an answer without a mask
        pub count: u32 [""],
        /// keep, unnatural, unclear or identical, for pairs
        pub verdict: Option<String> [""],
        /// Named body parts, as the annotator chose them
        pub parts: Vec<String> [""],
        /// Joints taken whole
        pub hard_joints: Vec<String> [""],
        /// Joints interpolated
        pub soft_joints: Vec<String> [""],
        /// First frame that the mask holds for; missing for the whole clip
        pub start: Option<i32> ["frame", newer],
        /// The frame after the last one that the mask holds for; missing for the whole clip
        pub end: Option<i32> ["frame", newer],
        /// Version of the body-part membership
        pub mask_def_version: u32 [""],
        /// The description or instruction
        pub text: String [""],
        /// What a fine-grained edit changes
        pub edit_type: Option<String> [""],
        /// Style of the second motion
        pub style: Option<String> [""],
        /// How much of the body the style shows in
        pub extent: Option<String> [""],
        /// Why there are fewer or more masks than the project asks for
        pub count_reason: Option<String> [""],
        /// Note of the annotator
        pub note: String [""],
        /// Pseudonym of the author; the same person has the same one in all tables of a store
        pub author: String [""],
        /// Whether a reviewer made it of several answers
        pub merged: u32 [""],
        /// Fields of a source's file that have no column here, JSON
        pub extra: Option<String> [""],
        /// How it was accepted: review, own (by its author), rule:NAME, or import where a file says no more
        pub accepted_by: Option<String> ["", newer],
    }
}

table! {
    /// An answer of one person, accepted or not.
    pub struct LabelRow = "labels" {
        /// What tells the task from others
        pub task: String [""],
        /// mask_text, pair or style
        pub kind: String [""],
        /// Motion, or the one before the edit
        pub motion_id: String [""],
        /// Motion after the edit
        pub target_id: Option<String> [""],
        /// train, val or test
        pub split: String [""],
        /// Pseudonym of the author
        pub author: String [""],
        /// submitted, accepted, returned or superseded
        pub state: String [""],
        /// The answer, JSON, as the interface has it
        pub answer: String [""],
        /// Time the author was at it
        pub secs: f64 ["s"],
        /// Edit distance of its texts from their drafts; missing without drafts
        pub draft_distance: Option<f64> [""],
        /// 1 where drafts were withheld
        pub blind: u32 [""],
        /// 1 for an answer to a hidden gold task
        pub gold: u32 [""],
        /// When it was handed in, milliseconds since the epoch
        pub at: u64 ["ms"],
        /// How it was accepted: review, own (by its author), rule:NAME; missing if it was not
        pub accepted_by: Option<String> [""],
    }
}

table! {
    /// A task that was dropped, skipped by somebody, or a pair that was accepted as not usable.
    pub struct RejectRow = "rejects" {
        /// What tells the task from others
        pub task: String [""],
        /// mask_text, pair or style
        pub kind: String [""],
        /// Motion, or the one before the edit
        pub motion_id: String [""],
        /// Motion after the edit
        pub target_id: Option<String> [""],
        /// train, val or test
        pub split: String [""],
        /// unnatural, unclear, identical, dropped, or the reason of a skip
        pub reason: String [""],
        /// More about it
        pub note: String [""],
        /// Pseudonym of who decided
        pub author: String [""],
        /// How a pair was accepted as not usable: review, own (by its author), rule:NAME, or import; missing for others
        pub accepted_by: Option<String> ["", newer],
    }
}

table! {
    /// A figure of agreement.
    pub struct AgreementRow = "agreement" {
        /// Part, overall, verdict, or masks
        pub item: String [""],
        /// gwet_ac1 or jaccard
        pub figure: String [""],
        /// Value; missing below 30 items
        pub value: Option<f64> [""],
        /// Lower end of the 95 % bootstrap interval
        pub low: Option<f64> [""],
        /// Upper end
        pub high: Option<f64> [""],
        /// Items
        pub items: u64 [""],
    }
}

table! {
    /// An entry of the log.
    pub struct EventRow = "events" {
        /// Place in the log
        pub seq: u64 [""],
        /// When, milliseconds since the epoch
        pub at: u64 ["ms"],
        /// Pseudonym of who; missing for the program itself
        pub actor: Option<String> [""],
        /// What
        pub kind: String [""],
        /// Number of the task in this store
        pub task: Option<u64> [""],
        /// The rest, JSON
        pub body: String [""],
    }
}
