//! Shared parts of the readers' tests.

use std::path::Path;

use datasets_spec::store::{ByPath, Store as _};
use datasets_spec::{Motion, Skeleton, Split};
use proptest::sample::Index;
use testkit::put;
pub(super) use testkit::test_data;

use super::{Entry, Files, Format, ReadOptions, Release};
use clip::{Rejected, SourceClip};

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

/// The planned motion with this id.
pub(super) fn entry_of<'a>(release: &'a dyn Release, id: &str) -> &'a Entry {
    let mut entries = release.contents().entries.iter();
    let entry = entries.find(|entry| entry.id == id);
    entry.unwrap_or_else(|| panic!("no {id}"))
}

/// The clip with this id.
pub(super) fn clip_of(release: &dyn Release, files: &Files, id: &str) -> SourceClip {
    let clip = release.read(files, entry_of(release, id), &ReadOptions::default());
    clip.unwrap_or_else(|rejected| panic!("{id}: {rejected:?}"))
}

/// Id, split and original (of a mirrored motion) of every planned motion.
pub(super) fn planned(release: &dyn Release) -> Vec<(&str, Option<Split>, Option<&str>)> {
    let entries = release.contents().entries.iter();
    entries
        .map(|entry| (entry.id.as_str(), entry.split, entry.mirrored_of.as_deref()))
        .collect()
}

/// The reason why a file of a release is passed over; empty if it is not.
pub(super) fn why_passed_over<'a>(release: &'a dyn Release, file: &str) -> &'a str {
    let mut passed_over = release.contents().passed_over.iter();
    let found = passed_over.find(|(name, _)| name == file);
    found.map_or("", |(_, reason)| reason.as_str())
}

/// Whether a note of a clip contains some words.
pub(crate) fn says(clip: &SourceClip, words: &str) -> bool {
    clip.notes.iter().any(|note| note.contains(words))
}

/// Asserts that a note of a clip contains some words.
#[track_caller]
pub(crate) fn assert_says(clip: &SourceClip, words: &str) {
    assert!(says(clip, words), "{words}: {:?}", clip.notes);
}

/// Asserts that one of a clip's notes is exactly this text.
#[track_caller]
pub(crate) fn assert_notes(clip: &SourceClip, note: &str) {
    let is_there = clip.notes.iter().any(|found| found == note);
    assert!(is_there, "{note}: {:?}", clip.notes);
}

/// Asserts that a text contains some words.
#[track_caller]
pub(crate) fn assert_contains(text: &str, words: &str) {
    assert!(text.contains(words), "{words}: {text}");
}

/// Asserts that a rejection has a code, and that its reason contains some words.
#[track_caller]
pub(crate) fn assert_refused(rejected: &Rejected, code: &str, words: &str) {
    assert_eq!(rejected.code, code, "{}", rejected.reason);
    assert_contains(&rejected.reason, words);
}

/// The one release of a format among the files.
pub(super) fn only_release(format: Format, files: &Files) -> Box<dyn Release> {
    let mut releases = (format.find)(files);
    assert_eq!(releases.len(), 1);
    releases.pop().expect("one")
}

/// Codes of the rejected files of a release.
pub(super) fn codes(release: &dyn Release) -> Vec<&str> {
    let rejected = release.contents().rejected.iter();
    rejected.map(|(_, rejected)| rejected.code).collect()
}

/// Asserts that the keypoints of both motions agree to within `metres`.
#[track_caller]
pub(crate) fn assert_same_places(found: &Motion, expected: &Motion, metres: f64) {
    let skeleton = Skeleton::smplx_neutral();
    let [found, expected] =
        [found, expected].map(|motion| skeleton.motion_keypoints(motion).points);
    assert_eq!(found.len(), expected.len());
    for (a, b) in found.as_flattened().iter().zip(expected.as_flattened()) {
        assert!(a.distance(*b) < metres, "{} m apart", a.distance(*b));
    }
}

/// A text with some words replaced by others.
pub(crate) fn changed(text: &str, changes: &[(&str, &str)]) -> String {
    let text = text.to_owned();
    changes
        .iter()
        .fold(text, |text, &(from, to)| text.replace(from, to))
}

/// The files that a release takes motions from or passes over, sorted.
pub(super) fn files_named(release: &dyn Release) -> Vec<&str> {
    let contents = release.contents();
    let taken = contents.entries.iter().map(|entry| entry.file.as_str());
    let passed_over = contents.passed_over.iter().map(|(file, _)| file.as_str());
    let mut named: Vec<&str> = taken.chain(passed_over).collect();
    named.sort_unstable();
    named
}

/// Bytes with some of them replaced.
pub(crate) fn edited(bytes: &[u8], edits: Vec<(Index, u8)>) -> Vec<u8> {
    let mut edited = bytes.to_vec();
    for (at, byte) in edits {
        let at = at.index(edited.len());
        edited[at] = byte;
    }
    edited
}
