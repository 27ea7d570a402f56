//! Import of tasks and annotations, and export of answers.

mod export;
mod import;
mod release;
mod tables;

pub use export::{Exported, Selection, export};
pub use import::{Taken, from_annotations, from_dataset, from_release};
pub use tables::{AgreementRow, AnnotationRow, EventRow, LabelRow, RejectRow};
