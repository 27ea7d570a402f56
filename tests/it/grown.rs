//! Helpers for tests of growing datasets.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

use datasets_spec::Split;
use datasets_spec::record::{MaskRow, MotionRow};
use serde_json::Value;

use crate::util::{
    Folder, Ran, arg, assert_counted, command, files_with_extension, manifest_of, name_of, put,
    rows_of, stance, stem_of, text_of, typed,
};

/// Runs `ingest --json` with sources as a user types them.
pub(crate) fn ran(sources: &[impl AsRef<OsStr>], out: &Path, more: &[&str]) -> Ran {
    let mut command = command(&["--json", "ingest"]);
    command.args(sources).arg("--out").arg(out).args(more);
    command.output().expect("stance starts").into()
}

/// A source as NAME=PATH.
pub(crate) fn named(name: &str, path: &Path) -> String {
    format!("{name}={}", arg(path))
}

/// Ingests, and checks the counts of the document against each other and against the tables.
pub(crate) fn ingest(sources: &[impl AsRef<OsStr>], out: &Path, more: &[&str], code: i32) -> Value {
    let done: Value = ran(sources, out, more).expect_code(code).json();
    assert_counted(&done);
    let manifest = manifest_of(out);
    for (table, count) in [("quarantine", "quarantined"), ("skipped", "skipped")] {
        assert_eq!(done[count], manifest.rows(table, None), "{table}");
    }
    done
}

/// Messages of an ingestion that fails.
pub(crate) fn refused(sources: &[impl AsRef<OsStr>], out: &Path, more: &[&str]) -> String {
    ran(sources, out, more).refusal()
}

/// The rows of all clips.
pub(crate) fn motions(dataset: &Path) -> Vec<MotionRow> {
    rows_of(dataset)
}

/// Split and content hash of every clip, by id.
pub(crate) fn clips(dataset: &Path) -> BTreeMap<String, (Split, String)> {
    let rows = motions(dataset).into_iter();
    rows.map(|row| (row.id.to_string(), (row.split, row.content_hash)))
        .collect()
}

/// The masks by their ids.
pub(crate) fn masks(dataset: &Path) -> BTreeMap<String, MaskRow> {
    let rows: Vec<MaskRow> = rows_of(dataset);
    rows.into_iter().map(|row| (row.id.clone(), row)).collect()
}

/// Checks that a dataset passes `verify`.
pub(crate) fn verified(dataset: &Path) {
    stance(&["verify", arg(dataset)]).expect_code(0);
}

/// The motion files of a corpus, sorted.
pub(crate) fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = files_with_extension(folder, "bvh");
    found.extend(files_with_extension(folder, "npz"));
    found.sort();
    found
}

/// Moves motion files, and the files of the same stem beside them.
pub(crate) fn move_files(files: &[PathBuf], to: &Path) {
    fs::create_dir_all(to).expect("made");
    for file in files {
        let folder = file.parent().expect("a folder");
        for entry in fs::read_dir(folder).expect("listed") {
            let path = entry.expect("an entry").path();
            let name = name_of(&path);
            if name.starts_with(&format!("{}.", stem_of(file))) {
                fs::rename(&path, to.join(name)).expect("moved");
            }
        }
    }
}

/// A corpus in two folders, every other motion file in the second, and the place of a dataset.
pub(crate) fn halves(clips: usize) -> (Folder, PathBuf, PathBuf, PathBuf) {
    let dir = Folder::of_clips(clips);
    let [first, second, dataset] = ["corpus", "more", "dataset"].map(|name| dir.path(name));
    let files = files(&first);
    let half: Vec<PathBuf> = files.into_iter().skip(1).step_by(2).collect();
    move_files(&half, &second);
    (dir, first, second, dataset)
}

/// The [`halves`] of a corpus, and a dataset of the first.
pub(crate) fn begun_with_half(clips: usize) -> (Folder, PathBuf, PathBuf, PathBuf) {
    let (dir, source, more, dataset) = halves(clips);
    ingest(&[&source], &dataset, &[], 0);
    (dir, source, more, dataset)
}

/// Accepts every automatic mask in the name of a person, and returns the masks.
pub(crate) fn judge(dataset: &Path) -> BTreeMap<String, MaskRow> {
    stance(&["masks", arg(dataset), "--add"]).expect_code(0);
    let file = dataset.with_extension("jsonl");
    stance(&["masks", arg(dataset), "--drafts", arg(&file)]).expect_code(0);
    let lines = text_of(&file);
    put(&file, lines.replace("\"todo\"", "\"accept\""));
    typed("masks {} --accept {} --author ann", &[&dataset, &file]).expect_code(0);
    fs::remove_file(&file).expect("removed");
    let masks = masks(dataset);
    assert!(!masks.is_empty() && masks.values().all(|mask| mask.text_origin == "human"));
    masks
}
