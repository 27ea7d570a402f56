//! Labels of sources.
//!
//! With one source, the paths of its files are those under its folder. With several, a label keeps
//! them apart. A dataset keeps the label of every source, so that ids do not change when sources are
//! added, moved or given in another order: a source is recognised by the files that it holds.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::list::{Listed, Listing, list_sources, merged};
use crate::Error;
use crate::source::text_of_name;

/// Fact of a manifest: the sources, as JSON.
pub(super) const SOURCES_FACT: &str = "sources";

/// A source of a dataset.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct SourceLabel {
    /// What the paths of its files begin with; empty for the first source of a dataset.
    pub(super) label: String,
    /// Name of its folder.
    pub(super) name: String,
}

/// All files under the sources by their relative path, each behind the label of its source.
pub(crate) fn list_files(sources: &[PathBuf]) -> Result<Listing, Error> {
    let listed = list_sources(sources)?;
    let labels = labels(&listed);
    Ok(merged(listed, &labels))
}

/// Labels for sources of a new dataset: none for a single one, else the shortest end of their paths that
/// tells them apart, so that the order of the sources does not matter. Files need none unless their
/// names are equal.
pub(super) fn labels(sources: &[Listed]) -> Vec<String> {
    let suffixes: Vec<Vec<String>> = sources
        .iter()
        .map(|source| suffixes(&source.path))
        .collect();
    sources
        .iter()
        .enumerate()
        .map(|(index, source)| {
            let others = || {
                suffixes
                    .iter()
                    .enumerate()
                    .filter(|(other, _)| *other != index)
            };
            let own = suffixes[index].iter();
            let unique = own.enumerate().find(|(length, suffix)| {
                others().all(|(_, other)| other.get(*length) != Some(suffix))
            });
            let label =
                unique.map_or_else(|| format!("source-{index}"), |(_, suffix)| suffix.clone());
            if sources.len() == 1 {
                String::new()
            } else if source.is_file {
                let folder = label.rsplit_once('/').map_or("", |(folder, _)| folder);
                folder.to_owned()
            } else {
                label
            }
        })
        .collect()
}

/// The last components of a path: one, two, and so on.
fn suffixes(path: &Path) -> Vec<String> {
    let names: Vec<String> = path
        .components()
        .filter_map(|part| match part {
            Component::Normal(name) => Some(text_of_name(name)),
            _ => None,
        })
        .collect();
    (1..=names.len())
        .map(|length| names[names.len() - length..].join("/"))
        .collect()
}

/// Name of the folder of a source.
pub(super) fn name(source: &Listed) -> String {
    text_of_name(source.path.file_name().unwrap_or_default())
}

/// Labels for sources of a dataset that exists. `hashes` are those of the files by their place on the
/// disk, `recorded` those of the dataset by their paths there.
///
/// A source that shares most files with a recorded one is that source, then one of the same name with a
/// file of the same path. Others are new and get a label of their own.
pub(super) fn known_labels(
    sources: &[Listed],
    known: &[SourceLabel],
    hash_of: &dyn Fn(&Path) -> Option<String>,
    recorded: &BTreeMap<String, String>,
) -> Vec<String> {
    let fresh = labels(sources);
    let mut contents: Vec<BTreeMap<&str, &str>> = vec![BTreeMap::new(); known.len()];
    for (path, hash) in recorded {
        // The longest label that fits, because the first source has none.
        let place = (0..known.len())
            .filter_map(|index| Some((index, below(&known[index].label, path)?)))
            .min_by_key(|(_, name)| name.len());
        if let Some((index, name)) = place {
            contents[index].insert(name, hash);
        }
    }
    let mut likeness = Vec::new();
    for (source, listed) in sources.iter().enumerate() {
        let hashes: BTreeSet<String> = listed
            .listing
            .files
            .values()
            .filter_map(|path| hash_of(path))
            .collect();
        for (index, contents) in contents.iter().enumerate() {
            let equal = contents
                .values()
                .filter(|hash| hashes.contains(**hash))
                .count();
            let names = &listed.listing.files;
            let same_path = contents.keys().any(|path| names.contains_key(*path));
            let same_name = !listed.is_file && same_path && known[index].name == name(listed);
            if equal > 0
                || same_name
                || (listed.is_file && same_path && known[index].label.is_empty())
            {
                likeness.push((std::cmp::Reverse(equal), source, index));
            }
        }
    }
    likeness.sort();
    let mut found: Vec<Option<String>> = vec![None; sources.len()];
    let mut taken = BTreeSet::new();
    for (_, source, index) in likeness {
        // Several files can be of one source; a folder is one source.
        let is_file = sources[source].is_file;
        if found[source].is_none() && (is_file || taken.insert(index)) {
            found[source] = Some(known[index].label.clone());
        }
    }
    let mut labels: BTreeSet<String> = known.iter().map(|source| source.label.clone()).collect();
    let mut given = Vec::new();
    for (source, found) in found.into_iter().enumerate() {
        let label = found.unwrap_or_else(|| {
            if sources[source].is_file {
                return fresh[source].clone();
            }
            let wanted = match fresh[source].as_str() {
                "" => name(&sources[source]),
                label => label.to_owned(),
            };
            let is_free = |label: &String| {
                let holds_files = recorded.keys().any(|path| below(label, path).is_some());
                !labels.contains(label) && !holds_files
            };
            let numbered = (2..).map(|number| format!("{wanted}-{number}"));
            let mut candidates = std::iter::once(wanted.clone()).chain(numbered);
            candidates.find(is_free).expect("numbers do not end")
        });
        labels.insert(label.clone());
        given.push(label);
    }
    given
}

/// A path without its label; none if it has another.
pub(super) fn below<'a>(label: &str, path: &'a str) -> Option<&'a str> {
    match label {
        "" => Some(path),
        label => path.strip_prefix(label)?.strip_prefix('/'),
    }
}

/// Whether a path lies in a source with this label, of which no other label is a longer fit.
pub(super) fn lies_in(label: &str, path: &str, labels: &[SourceLabel]) -> bool {
    below(label, path).is_some()
        && !labels
            .iter()
            .any(|other| other.label.len() > label.len() && below(&other.label, path).is_some())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ingest::list::labelled;

    fn folder(path: &str, files: &[&str]) -> Listed {
        let files = files.iter().map(|name| {
            let place = PathBuf::from(path).join(name);
            ((*name).to_owned(), place)
        });
        Listed {
            path: PathBuf::from(path),
            is_file: false,
            listing: Listing {
                files: files.collect(),
                ..Listing::default()
            },
        }
    }

    #[test]
    fn the_order_of_sources_does_not_change_their_labels() {
        let (one, two) = (folder("/x/one/data", &[]), folder("/x/two/data", &[]));
        assert_eq!(labels(&[one, two]), ["one/data", "two/data"]);
        let (one, two) = (folder("/x/one/data", &[]), folder("/x/two/data", &[]));
        assert_eq!(labels(&[two, one]), ["two/data", "one/data"]);
        assert_eq!(labels(&[folder("/x/data", &[])]), [""]);
        assert_eq!(
            labels(&[folder("/x/data", &[]), folder("/x/more", &[])]),
            ["data", "more"]
        );
    }

    #[test]
    fn a_source_is_recognised_by_its_files() {
        let known = [
            SourceLabel {
                label: String::new(),
                name: "data".to_owned(),
            },
            SourceLabel {
                label: "other/data".to_owned(),
                name: "data".to_owned(),
            },
        ];
        let recorded = [("a", "/x/a"), ("b", "/x/b"), ("other/data/c", "/y/c")]
            .map(|(path, hash)| (path.to_owned(), hash.to_owned()));
        let recorded = BTreeMap::from(recorded);
        // The test's hash of a file is where it was first.
        let moved = |path: &Path| Some(path.to_string_lossy().replace("/moved", ""));
        let sources = [
            folder("/y", &["c", "new"]),
            folder("/x/moved", &["b"]),
            folder("/z/data", &["q"]),
        ];
        assert_eq!(
            known_labels(&sources, &known, &moved, &recorded),
            ["other/data", "", "data"].map(str::to_owned)
        );
        assert_eq!(labelled("", "a"), "a");
        assert!(lies_in("", "a", &known) && !lies_in("", "other/data/c", &known));
    }
}
