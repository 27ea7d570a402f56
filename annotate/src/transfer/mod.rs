//! Import of tasks and annotations, and export of answers.

mod annotations;
mod clips;
mod export;
mod import;
mod keys;
mod release;
mod tables;

pub use self::tables::{AgreementRow, AnnotationRow, EventRow, LabelRow, RejectRow};
pub use annotations::from_annotations;
pub use export::{Exported, check_files, export};
pub use import::{CHOSEN, Taken, from_dataset, from_labels};
pub(crate) use release::RELEASE;
pub use release::from_release;
