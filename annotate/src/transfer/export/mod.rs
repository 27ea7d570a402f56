//! Export of answers into files and into the dataset, a file for each layout.

mod csv;
mod dataset;
mod exporter;
mod release;
mod tables;

use std::path::Path;

use exporter::Exporter;
pub use exporter::{Exported, Selection};

use crate::Error;
use crate::store::Store;
use crate::wire::ExportFormat;

/// Exports accepted answers. `folder` takes the files; layout `dataset` writes the tables `masks` and
/// `pairs` of the dataset instead.
///
/// # Errors
/// A file cannot be written, a pair crosses splits, the dataset is locked, or the store fails.
pub fn export(
    store: &Store,
    dataset: &Path,
    folder: &Path,
    selection: &Selection,
    holder: &str,
) -> Result<Exported, Error> {
    let mut exporter = Exporter::new(store, &selection.splits);
    match selection.format {
        ExportFormat::Dataset => exporter.dataset(dataset, holder)?,
        ExportFormat::Parquet => exporter.parquet(folder, selection.events)?,
        ExportFormat::Stance => exporter.stance(folder)?,
        ExportFormat::Csv => exporter.csv(folder)?,
    }
    for (basis, count) in store.accepted_by()? {
        let count = usize::try_from(count).unwrap_or(0);
        exporter.done.count(&format!("accepted_by {basis}"), count);
        if basis == "own" {
            exporter.done.messages.push(format!(
                "{count} answers of the store were accepted by their own authors"
            ));
        }
    }
    Ok(exporter.done)
}
