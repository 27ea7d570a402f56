//! Context of a stage: progress sink, lock holder, and the commit of tables.

use std::path::Path;

use datasets_spec::dataset::commit_rows;
use datasets_spec::table::Row;
use datasets_spec::{Dataset, Progress, Skeleton, Split};

use crate::Error;

/// Context of a stage: where it reports and who locks the folder it writes.
#[derive(Clone, Copy)]
pub struct Context<'a> {
    /// Receives the progress.
    pub progress: &'a dyn Progress,
    /// Names this run to another one that finds the folder locked.
    pub holder: &'a str,
}

impl Context<'_> {
    /// Commits a table. Does nothing if the folder holds a table that was made by the same plan.
    ///
    /// # Errors
    /// The folder is locked or cannot be written.
    pub fn commit<R: Row>(
        &self,
        root: &Path,
        rows: &[R],
        split_of: Option<fn(&R) -> Split>,
        skeleton: &Skeleton,
        plan_hash: &str,
    ) -> Result<Dataset, Error> {
        Ok(commit_rows(
            root,
            rows,
            split_of,
            skeleton,
            plan_hash,
            self.holder,
        )?)
    }
}
