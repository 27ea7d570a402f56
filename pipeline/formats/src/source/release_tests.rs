//! What tests of releases share.

use std::path::Path;

use datasets_spec::store::{ByPath, Store as _};
use testkit::put;

use super::{Entry, Files, ReadOptions, Release};
use clip::SourceClip;

/// Files in a temporary folder.
pub(super) fn files_of(files: &[(&str, &[u8])]) -> (tempfile::TempDir, Files) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (name, bytes) in files {
        put(folder.path(), name, bytes);
    }
    let files = files_under(folder.path());
    (folder, files)
}

/// The files below a folder.
pub(super) fn files_under(folder: &Path) -> Files {
    let paths = ByPath.files_below(folder).expect("listed").into_iter();
    let named = paths.map(|path| {
        let name = path.strip_prefix(folder).expect("below").to_str();
        (name.expect("text").to_owned(), path)
    });
    Files::new(named.collect())
}

/// The planned motion of an id.
pub(super) fn entry_of<'a>(release: &'a dyn Release, id: &str) -> &'a Entry {
    let mut entries = release.contents().entries.iter();
    let entry = entries.find(|entry| entry.id == id);
    entry.unwrap_or_else(|| panic!("no {id}"))
}

/// The clip of an id.
pub(super) fn clip_of(release: &dyn Release, files: &Files, id: &str) -> SourceClip {
    let clip = release.read(files, entry_of(release, id), &ReadOptions::default());
    clip.unwrap_or_else(|rejected| panic!("{id}: {rejected:?}"))
}
