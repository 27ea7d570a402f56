//! Export of accepted answers.

use std::path::Path;

use annotate::store::Store;
use annotate::transfer;
use annotate::wire::ExportRequest;

use super::args::Args;
use super::shared::now;
use crate::exit::Exit;
use crate::global::Global;

pub(super) fn export(
    args: &Args,
    store: &Store,
    selection: &ExportRequest,
    to: Option<&Path>,
    global: &Global,
) -> anyhow::Result<Exit> {
    let folder = to.map_or_else(|| args.folder().join("exports"), Path::to_owned);
    let done = transfer::export(store, &args.dataset, &folder, selection, &global.holder())?;
    annotate::log_export(store, None, selection.format, &done, now())?;
    let mut lines: Vec<String> = done
        .counts
        .iter()
        .map(|(what, count)| format!("  {what:<24} {count:>8}"))
        .collect();
    lines.extend(done.messages.iter().cloned());
    if !done.files.is_empty() {
        lines.push(format!("{} in {}", done.files.join(", "), folder.display()));
    }
    global.say(&done, &lines.join("\n"))
}
