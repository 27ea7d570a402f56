//! The tables of an export, written like all tables of `stance`: Parquet, Zstandard, the schema version in the
//! footer, the same bytes for the same rows.

use datasets_spec::table;

table! {
    /// An accepted mask of a motion, or an accepted judgement of a pair.
    pub struct AnnotationRow = "annotations" {
        /// Unique key of the task
        pub task: String [""],
        /// mask_text, pair or style
        pub kind: String [""],
        /// Motion; for a pair, the motion before the edit
        pub motion_id: String [""],
        /// Motion after the edit
        pub target_id: Option<String> [""],
        /// train, val or test
        pub split: String [""],
        /// Action category of the source
        pub category: Option<String> [""],
        /// Edit that the pair was made for
        pub hint: Option<String> [""],
        /// Style label of the source
        pub source_style: Option<String> [""],
        /// Index of the mask in its answer, from 0; 0 for pairs
        pub number: u32 [""],
        /// Number of masks of the answer; 1 for pairs, 0 for an answer without a mask
        pub count: u32 [""],
        /// keep, unnatural, unclear or identical, for pairs
        pub verdict: Option<String> [""],
        /// Named body parts, as the annotator chose them
        pub parts: Vec<String> [""],
        /// Joints taken whole
        pub hard_joints: Vec<String> [""],
        /// Joints interpolated
        pub soft_joints: Vec<String> [""],
        /// First frame of the mask; missing for the whole clip
        pub start: Option<i32> ["frame", newer],
        /// The frame after the last one of the mask; missing for the whole clip
        pub end: Option<i32> ["frame", newer],
        /// Version of the body-part membership
        pub mask_def_version: u32 [""],
        /// The description or instruction
        pub text: String [""],
        /// What a fine-grained edit changes
        pub edit_type: Option<String> [""],
        /// Style of the second motion
        pub style: Option<String> [""],
        /// Extent of the style: how much of the body shows it
        pub extent: Option<String> [""],
        /// Reason for fewer or more masks than the project wants
        pub count_reason: Option<String> [""],
        /// Note of the annotator
        pub note: String [""],
        /// Pseudonym of the author; the same person has the same one in all tables of a store
        pub author: String [""],
        /// Whether a reviewer merged it from several answers
        pub merged: u32 [""],
        /// Fields of the source's file without a column here, JSON
        pub extra: Option<String> [""],
        /// How it was accepted: review, own (by its author), rule:NAME, or import if the imported file does not say
        pub accepted_by: Option<String> ["", newer],
        /// Content hash of the motion
        pub motion_hash: Option<String> ["", newer],
        /// Content hash of the motion after the edit
        pub target_hash: Option<String> ["", newer],
    }
}

table! {
    /// An answer of one person, accepted or not.
    pub struct LabelRow = "labels" {
        /// Unique key of the task
        pub task: String [""],
        /// mask_text, pair or style
        pub kind: String [""],
        /// Motion; for a pair, the motion before the edit
        pub motion_id: String [""],
        /// Motion after the edit
        pub target_id: Option<String> [""],
        /// train, val or test
        pub split: String [""],
        /// Pseudonym of the author
        pub author: String [""],
        /// submitted, accepted, returned or superseded
        pub state: String [""],
        /// The answer, JSON, as in the API
        pub answer: String [""],
        /// Working time of the author
        pub secs: f64 ["s"],
        /// Edit distance of its texts from their drafts; missing without drafts
        pub draft_distance: Option<f64> [""],
        /// 1 where drafts were withheld
        pub blind: u32 [""],
        /// 1 for an answer to a hidden gold task
        pub gold: u32 [""],
        /// Time of submission, milliseconds since the epoch
        pub at: u64 ["ms"],
        /// How it was accepted: review, own (by its author), rule:NAME; missing if it was not
        pub accepted_by: Option<String> [""],
    }
}

table! {
    /// A dropped or skipped task, or a pair that was accepted as not usable.
    pub struct RejectRow = "rejects" {
        /// Unique key of the task
        pub task: String [""],
        /// mask_text, pair or style
        pub kind: String [""],
        /// Motion; for a pair, the motion before the edit
        pub motion_id: String [""],
        /// Motion after the edit
        pub target_id: Option<String> [""],
        /// train, val or test
        pub split: String [""],
        /// unnatural, unclear, identical, dropped, or the reason of a skip
        pub reason: String [""],
        /// Note on the reason
        pub note: String [""],
        /// Pseudonym of the person who decided
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
        /// Upper end of the interval
        pub high: Option<f64> [""],
        /// Number of items
        pub items: u64 [""],
        /// The same figure, computed of answers to different tasks
        pub chance: Option<f64> ["", newer],
    }
}

table! {
    /// An entry of the log.
    pub struct EventRow = "events" {
        /// Sequence number in the log
        pub seq: u64 [""],
        /// Time, milliseconds since the epoch
        pub at: u64 ["ms"],
        /// Pseudonym of the actor; missing for the program itself
        pub actor: Option<String> [""],
        /// Kind of the entry
        pub kind: String [""],
        /// Number of the task in this store
        pub task: Option<u64> [""],
        /// Body of the entry, JSON
        pub body: String [""],
    }
}
