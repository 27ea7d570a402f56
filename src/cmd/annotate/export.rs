//! Export of accepted answers.

use std::path::Path;

use annotate::store::Store;
use annotate::transfer::{self, Selection};

use super::args::Args;
use super::shared::{lines_of, now};
use crate::exit::Exit;
use crate::global::Global;

pub(super) fn export(
    args: &Args,
    store: &Store,
    selection: &Selection,
    to: Option<&Path>,
    global: &Global,
) -> anyhow::Result<Exit> {
    let folder = to.map_or_else(|| args.folder().join("exports"), Path::to_owned);
    let done = transfer::export(store, &args.dataset, &folder, selection, &global.holder())?;
    annotate::log_export(store, None, selection.format, &done, now())?;
    let mut lines = lines_of(&done.counts, &done.messages);
    if !done.files.is_empty() {
        lines.push(format!("{} in {}", done.files.join(", "), folder.display()));
    }
    global.say(&done, &lines.join("\n"))
}
