//! Export of answers into files and into the dataset, with a module for each layout.

mod dataset;
mod exporter;
mod release;
mod tables;

use std::collections::BTreeMap;
use std::path::Path;

use datasets_spec::Dataset;
use datasets_spec::dataset::Transaction;
use datasets_spec::table::Row as _;
use serde_json::{Value, json};

pub use exporter::Exported;
use exporter::Exporter;
use exporter::STAMP;

use crate::Error;
use crate::store::Store;
use crate::transfer::tables::AnnotationRow;
use crate::wire::{ExportFormat, ExportRequest};

/// Exports accepted answers from a snapshot of the store. The files are written to `folder`. Layout `dataset` instead
/// writes the tables `masks` and `pairs` of the dataset in one commit, under the dataset's lock. Splits are those of the
/// dataset, for files those of its last import. Pairs whose clips are in two splits are left out and counted.
///
/// The sequence number of the snapshot is in [`Exported::seq`], and in the file `export.json` beside the files or, for
/// layout `dataset`, in the facts of the manifest.
///
/// # Errors
/// A file cannot be written, the dataset is locked, or the store fails.
pub fn export(
    store: &Store,
    dataset: &Path,
    folder: &Path,
    selection: &ExportRequest,
    holder: &str,
) -> Result<Exported, Error> {
    if selection.format == ExportFormat::Dataset {
        // Taking the lock creates the folder, so check first that the path is a dataset.
        Dataset::open_unverified(dataset)?;
        let transaction = Transaction::begin(dataset, holder)?;
        // Take the snapshot under the lock, so that a later version of the dataset has a later snapshot.
        let now = store.snapshot()?;
        let mut exporter = Exporter::new(&now, &selection.splits)?;
        exporter.dataset(transaction)?;
        exporter.note_left_out();
        exporter.note_decisions()?;
        return Ok(exporter.done);
    }
    let now = store.snapshot()?;
    let mut exporter = Exporter::new(&now, &selection.splits)?;
    std::fs::create_dir_all(folder).map_err(datasets_spec::Error::io("create folder", folder))?;
    // Remove the stamp first: files without a stamp are from an unfinished export.
    let path = folder.join(STAMP);
    if let Err(error) = std::fs::remove_file(&path)
        && error.kind() != std::io::ErrorKind::NotFound
    {
        return Err(datasets_spec::Error::io("remove", path)(error).into());
    }
    match selection.format {
        ExportFormat::Parquet => exporter.parquet(folder, selection.events)?,
        ExportFormat::Stance => exporter.stance(folder)?,
        ExportFormat::Csv => exporter.csv(folder)?,
        ExportFormat::Dataset => {}
    }
    exporter.note_left_out();
    exporter.note_decisions()?;
    let stamp = json!({
        "store": exporter.done.store,
        "seq": exporter.done.seq,
        "format": selection.format,
        "splits": selection.splits,
        "counts": exporter.done.counts,
        "blake3": hashes(folder, &exporter.done.files)?,
        "tool": format!("stance {}", env!("CARGO_PKG_VERSION")),
    });
    exporter.write(folder, STAMP, &format!("{stamp:#}\n"))?;
    Ok(exporter.done)
}

/// BLAKE3 hashes of files in a folder, by their names.
fn hashes(folder: &Path, names: &[String]) -> Result<BTreeMap<String, String>, Error> {
    let hash = |name: &String| {
        let path = folder.join(name);
        let bytes = std::fs::read(&path).map_err(datasets_spec::Error::io("read", &path))?;
        Ok((name.clone(), blake3::hash(&bytes).to_hex().to_string()))
    };
    names.iter().map(hash).collect()
}

/// Checks that no file of an export was changed afterwards: the table `annotations` repeats the JSON files, so it would
/// be unknown which of them is right. An earlier export into the same folder may have left such a table behind. Folders
/// without `export.json`, or with one of an earlier version, pass.
///
/// # Errors
/// A file has another content than it was written with, cannot be read, or is a table `annotations` of another export.
pub fn check_files(folder: &Path) -> Result<(), Error> {
    let path = folder.join(STAMP);
    if !path.is_file() {
        return Ok(());
    }
    let bytes = std::fs::read(&path).map_err(datasets_spec::Error::io("read", &path))?;
    let what = format!("the export in {}", folder.display());
    let refused = |problem: String| Error::import(&what, problem);
    let stamp: Value =
        serde_json::from_slice(&bytes).map_err(|error| refused(format!("{STAMP}: {error}")))?;
    let Some(written) = stamp["blake3"].as_object() else {
        return Ok(());
    };
    let annotations = format!("{}.parquet", AnnotationRow::TABLE);
    if !written.contains_key(&annotations) && folder.join(&annotations).is_file() {
        return Err(refused(format!(
            "{annotations} is not of this export: {STAMP} does not list it; export into an empty folder, or import the \
             file alone if it is to count"
        )));
    }
    for (name, written) in written {
        if !folder.join(name).is_file() {
            continue;
        }
        let found = hashes(folder, std::slice::from_ref(name))?;
        if found.get(name).map(String::as_str) != written.as_str() {
            return Err(refused(format!(
                "{name} was changed since the export; restore it, or remove {STAMP} and the files that are not to count: \
                 where annotations.parquet is there, it alone is read"
            )));
        }
    }
    Ok(())
}
