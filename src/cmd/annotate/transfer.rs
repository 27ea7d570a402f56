//! Import of tasks from the dataset and of annotations from files, and export of accepted answers.

use std::path::Path;

use annotate::store::Store;
use annotate::transfer::{self, CHOSEN, Taken};
use annotate::wire::ExportRequest;
use anyhow::Context;
use datasets_spec::{Dataset, Progress as _};
use formats::source::stance::exported_labels;

use super::args::Args;
use super::shared::{lines_of, now};
use crate::exit::Exit;
use crate::global::Global;
use crate::local;

/// Name of the store's note with the root hash of the dataset that was imported last.
pub(super) const IMPORTED: &str = "imported dataset";
/// File of an export that can be imported.
const ANNOTATIONS: &str = "annotations.parquet";

pub(super) fn import(
    args: &Args,
    store: &Store,
    file: Option<&Path>,
    global: &Global,
) -> anyhow::Result<Exit> {
    let taken = match file {
        None => import_dataset(args, store, global)?,
        Some(file) => {
            // Annotations refer to tasks, so the tasks come first.
            let messages = import_dataset(args, store, global)?.messages;
            let mut taken = match file.is_dir() {
                true => import_folder(args, store, file)?,
                false if file.extension().is_some_and(|found| found == "parquet") => {
                    transfer::from_annotations(store, file, None, now(store)?)?
                }
                false if file.extension().is_some_and(|found| found == "json") => {
                    transfer::from_release(store, &read_json(file)?, None, now(store)?)?
                }
                false => {
                    std::fs::metadata(file)
                        .with_context(|| format!("cannot read {}", file.display()))?;
                    return Err(no_answers(file));
                }
            };
            taken.messages.splice(..0, messages);
            taken
        }
    };
    let lines = lines_of(&taken.counts, &taken.messages);
    global.say(&taken, &lines.join("\n"))
}

pub(super) fn import_dataset(args: &Args, store: &Store, global: &Global) -> anyhow::Result<Taken> {
    if let Some(condition) = &args.condition {
        store.put_note(CHOSEN, condition.text())?;
    }
    let bars = global.bars();
    bars.begin("import", None);
    let taken = transfer::from_dataset(store, &args.dataset, None, now(store)?, &mut |done, _| {
        bars.advance_to(u64::try_from(done).unwrap_or(0));
    })?;
    let count = |what: &str| taken.counts.get(what).copied().unwrap_or(0);
    bars.finish(&format!(
        "clips of the dataset: {} new tasks, {} known",
        count("new_tasks"),
        count("known_tasks")
    ));
    let dataset = Dataset::open_unverified(&args.dataset)?;
    store.put_note(IMPORTED, &dataset.manifest().root_hash)?;
    Ok(taken)
}

/// Imports the labels of a folder, which is an export of answers, an exported dataset, or a STANCE release.
fn import_folder(args: &Args, store: &Store, folder: &Path) -> anyhow::Result<Taken> {
    transfer::check_files(folder)?;
    let annotations = folder.join(ANNOTATIONS);
    if annotations.is_file() {
        let taken = transfer::from_annotations(store, &annotations, None, now(store)?)?;
        return Ok(taken);
    }
    if let Some(labels) = exported_labels(folder)? {
        let dataset = &args.dataset;
        return Ok(transfer::from_labels(
            store,
            dataset,
            &labels,
            None,
            now(store)?,
        )?);
    }
    let mut both = serde_json::Map::new();
    for name in ["mask_all", "part_annotations", "accepted_by", "pairs"] {
        let path = [folder.to_owned(), folder.join("regen")]
            .into_iter()
            .map(|folder| folder.join(format!("{name}.json")))
            .find(|path| path.is_file());
        if let Some(path) = path {
            both.insert(name.to_owned(), read_json(&path)?);
        }
    }
    if both.is_empty() {
        return Err(no_answers(folder));
    }
    Ok(transfer::from_release(
        store,
        &both.into(),
        None,
        now(store)?,
    )?)
}

fn no_answers(path: &Path) -> anyhow::Error {
    anyhow::anyhow!(
        "{} holds no answers that can be imported: give an export in format parquet or stance (csv and labels are for reading), a \
         folder of `stance export --to stance`, or a STANCE release",
        path.display()
    )
}

fn read_json(path: &Path) -> anyhow::Result<serde_json::Value> {
    local::read_json(path, "is not JSON")
}

pub(super) fn export(
    args: &Args,
    store: &Store,
    selection: &ExportRequest,
    to: Option<&Path>,
    global: &Global,
) -> anyhow::Result<Exit> {
    let folder = to.map_or_else(|| args.folder().join("exports"), Path::to_owned);
    let done = transfer::export(store, &args.dataset, &folder, selection, &global.holder())?;
    store.log_export(None, done.entry(selection.format), now(store)?)?;
    let mut lines = lines_of(&done.counts, &done.messages);
    if !done.files.is_empty() {
        lines.push(format!("{} in {}", done.files.join(", "), folder.display()));
    }
    global.say(&done, &lines.join("\n"))
}
