//! Export of answers into files and into the dataset, a file for each layout.

mod csv;
mod dataset;
mod exporter;
mod release;
mod tables;

use std::path::Path;

use datasets_spec::Dataset;
use datasets_spec::dataset::Transaction;
use serde_json::json;

use exporter::Exporter;
pub use exporter::{Exported, Selection};
use exporter::{STAMP, write_file};

use crate::Error;
use crate::store::Store;
use crate::wire::ExportFormat;

/// Exports accepted answers as they are at one point in time, whatever is written meanwhile. `folder` takes the files;
/// layout `dataset` writes the tables `masks` and `pairs` of the dataset instead, together, while it holds the
/// dataset's lock.
///
/// The place in the log is in [`Exported::seq`], in the file `export.json` beside the files, and in the facts of the
/// dataset's manifest.
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
    if selection.format == ExportFormat::Dataset {
        // Taking the lock creates the folder. A mistyped path must not.
        Dataset::open_unverified(dataset)?;
        let transaction = Transaction::begin(dataset, holder)?;
        // Taken under the lock, so that a later version of the dataset holds a later point in time.
        let now = store.snapshot()?;
        let mut exporter = Exporter::new(&now, &selection.splits)?;
        exporter.dataset(transaction)?;
        exporter.note_decisions()?;
        return Ok(exporter.done);
    }
    let now = store.snapshot()?;
    let mut exporter = Exporter::new(&now, &selection.splits)?;
    // Files without a stamp are those of an export that did not end.
    match std::fs::remove_file(folder.join(STAMP)) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            return Err(Error::io("remove", folder.join(STAMP))(error));
        }
        _ => {}
    }
    match selection.format {
        ExportFormat::Parquet => exporter.parquet(folder, selection.events)?,
        ExportFormat::Stance => exporter.stance(folder)?,
        ExportFormat::Csv => exporter.csv(folder)?,
        ExportFormat::Dataset => {}
    }
    exporter.note_decisions()?;
    let stamp = json!({
        "store": exporter.done.store,
        "seq": exporter.done.seq,
        "format": selection.format,
        "splits": selection.splits,
        "counts": exporter.done.counts,
        "tool": format!("stance {}", env!("CARGO_PKG_VERSION")),
    });
    write_file(folder, STAMP, |file, path| {
        use std::io::Write;
        writeln!(file, "{stamp:#}").map_err(Error::io("write", path))
    })?;
    exporter.done.files.push(STAMP.to_owned());
    Ok(exporter.done)
}
