//! Pieces of work.

use std::path::PathBuf;

use datasets_spec::Digest;
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::Error;

/// Digits of an id.
const ID_DIGITS: usize = 32;

datasets_spec::table! {
    /// A unit of work: the output of one call of a worker.
    pub struct Piece = "pieces" {
        /// Hash of the plan and of what the piece reads, 32 hexadecimal digits
        pub id: String [""],
        /// Number from 0
        pub number: u64 [""],
        /// The shard or the part that it makes, such as motions/train-00000-of-00004
        pub name: String [""],
        /// Items in it: motions, windows, edits
        pub items: u64 [""],
        /// Bytes of the files that no earlier piece reads; 0 where all pieces read the same
        pub bytes: u64 ["B"],
        /// Data that its job needs to make it, as JSON
        pub detail: String [""],
    }
}

impl Piece {
    /// A piece of a plan. `reads` identifies the inputs that the plan's hash does not cover.
    pub fn new<'a>(
        plan_hash: &str,
        number: usize,
        name: String,
        items: u64,
        reads: impl Iterator<Item = &'a str>,
    ) -> Self {
        let number = number as u64;
        let mut digest = Digest::default();
        digest.part(plan_hash);
        digest.part(&number.to_string());
        digest.part(&name);
        reads.for_each(|read| digest.part(read));
        Self {
            id: digest.hex()[..ID_DIGITS].to_owned(),
            number,
            name,
            items,
            bytes: 0,
            detail: "null".to_owned(),
        }
    }

    /// Adds the size of the piece and the data that its job needs to make it.
    ///
    /// # Panics
    /// If the detail cannot be written as JSON, which is a bug in the job.
    #[must_use]
    pub fn with(self, bytes: u64, detail: &impl Serialize) -> Self {
        let detail = serde_json::to_string(detail).expect("details are numbers and texts");
        Self {
            bytes,
            detail,
            ..self
        }
    }

    /// Parses the field `detail`.
    ///
    /// # Errors
    /// The detail is that of another job.
    pub fn detail<T: DeserializeOwned>(&self) -> Result<T, Error> {
        serde_json::from_str(&self.detail).map_err(|error| Error::BadPlan {
            path: PathBuf::from("pieces.parquet"),
            reason: format!("piece {} has an unknown detail: {error}", self.name),
        })
    }
}
