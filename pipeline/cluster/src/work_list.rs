//! The pieces of a plan as the table that Ballista reads.

use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use anyhow::Context;
use datafusion::arrow::array::{ArrayRef, StringArray};
use datafusion::arrow::record_batch::RecordBatch;
use datafusion::parquet::arrow::ArrowWriter;

/// Maximum number of files of a list: the scheduler's plan names every file, and its messages are limited to 16 MiB.
const MAX_FILES: usize = 4096;

/// Writes the columns `plan` and `piece` as Parquet files, each of which becomes one task. Returns the number of files.
///
/// # Errors
/// The folder cannot be written.
pub(crate) fn write(folder: &Path, plan: &Path, pieces: &[String]) -> anyhow::Result<usize> {
    let per_file = pieces.len().div_ceil(MAX_FILES).max(1);
    let mut files = 0;
    for some in pieces.chunks(per_file) {
        let plans: ArrayRef = Arc::new(StringArray::from(vec![
            plan.to_string_lossy().into_owned();
            some.len()
        ]));
        let ids: ArrayRef = Arc::new(StringArray::from(some.to_vec()));
        let batch = RecordBatch::try_from_iter([("plan", plans), ("piece", ids)])?;
        let path = folder.join(format!("{files:05}.parquet"));
        let file =
            File::create(&path).with_context(|| format!("cannot write {}", path.display()))?;
        let mut writer = ArrowWriter::try_new(file, batch.schema(), None)?;
        writer.write(&batch)?;
        writer.close()?;
        files += 1;
    }
    Ok(files)
}
