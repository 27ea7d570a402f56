//! The tables of an export, written like all tables of `stance`: Parquet, Zstandard, the schema version in the
//! footer, the same bytes for the same rows.

use datasets_spec::table::{Cell, Column, Row};

/// Declares a row struct and derives its table from it.
macro_rules! sheet {
    (
        $(#[doc = $struct_doc:literal])*
        pub struct $name:ident = $table:literal {
            $( #[doc = $doc:literal] pub $field:ident : $ty:ty [$unit:literal], )*
        }
    ) => {
        $(#[doc = $struct_doc])*
        #[derive(Clone, Debug, PartialEq)]
        pub struct $name {
            $( #[doc = $doc] pub $field: $ty, )*
        }

        impl Row for $name {
            const TABLE: &'static str = $table;

            fn columns() -> Vec<Column> {
                vec![$( Column {
                    name: stringify!($field),
                    unit: $unit,
                    doc: str::trim_ascii($doc),
                    data_type: <$ty as Cell>::data_type(),
                    nullable: <$ty as Cell>::NULLABLE,
                }, )*]
            }

            fn encode(rows: &[Self]) -> Result<arrow_array::RecordBatch, datasets_spec::Error> {
                let columns = vec![$(
                    <$ty as Cell>::encode(&mut rows.iter().map(|row| &row.$field))
                        .map_err(|problem| datasets_spec::Error::Column {
                            table: $table,
                            column: stringify!($field).to_owned(),
                            problem,
                        })?,
                )*];
                arrow_array::RecordBatch::try_new(Self::schema(), columns)
                    .map_err(|source| datasets_spec::Error::Arrow { table: $table, source })
            }

            fn decode(batch: &arrow_array::RecordBatch) -> Result<Vec<Self>, datasets_spec::Error> {
                $( let mut $field = cells::<$ty>($table, batch, stringify!($field))?.into_iter(); )*
                let mut rows = Vec::with_capacity(batch.num_rows());
                while let ($( Some($field), )*) = ($( $field.next(), )*) {
                    rows.push(Self { $( $field, )* });
                }
                Ok(rows)
            }
        }
    };
}

/// One column of a batch.
fn cells<T: Cell>(
    table: &'static str,
    batch: &arrow_array::RecordBatch,
    name: &str,
) -> Result<Vec<T>, datasets_spec::Error> {
    let wrong = |problem: String| datasets_spec::Error::Column {
        table,
        column: name.to_owned(),
        problem,
    };
    let array = batch
        .column_by_name(name)
        .ok_or_else(|| wrong("is missing".to_owned()))?;
    if *array.data_type() != T::data_type() {
        return Err(wrong(format!(
            "has type {}, expected {}",
            array.data_type(),
            T::data_type()
        )));
    }
    if !T::NULLABLE && array.null_count() > 0 {
        return Err(wrong(format!("has {} missing values", array.null_count())));
    }
    T::decode(array.as_ref()).map_err(|(row, problem)| wrong(format!("row {row}: {problem}")))
}

sheet! {
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
    }
}

sheet! {
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

sheet! {
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
    }
}

sheet! {
    /// A figure of agreement.
    pub struct AgreementRow = "agreement" {
        /// Part, overall, verdict, or masks
        pub item: String [""],
        /// raw, krippendorff_alpha, fleiss_kappa, cohen_kappa, gwet_ac1, jaccard or alpha_masi
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

sheet! {
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
