//! Datasets in the cache of the Hugging Face hub's tools. Nothing is downloaded.

use std::io;
use std::path::{Path, PathBuf};

use super::cache::HubCache;
use super::client::BRANCH;
use crate::place::Place;

/// The local path of `hf://datasets/OWNER/NAME[@REVISION][/PATH]`.
pub(crate) fn dataset_path(cache: Option<&HubCache>, place: &Place) -> io::Result<PathBuf> {
    let refused = |text: String| io::Error::other(text);
    let parts: Vec<&str> = place.key.as_ref().split('/').collect();
    let [owner, name, path @ ..] = parts.as_slice() else {
        return Err(refused(form()));
    };
    if place.authority != "datasets" {
        return Err(refused(form()));
    }
    let (name, revision) = match name.split_once('@') {
        Some((name, revision)) => (name, revision),
        None => (*name, BRANCH),
    };
    let fetch = || {
        let revision = match revision {
            BRANCH => String::new(),
            other => format!(" --revision {other}"),
        };
        refused(format!(
            "{owner}/{name} is not in the cache of the Hugging Face hub; fetch it: \
             hf download {owner}/{name} --repo-type dataset{revision}"
        ))
    };
    let root = cache.ok_or_else(fetch)?.root();
    let folder = root.join(format!("datasets--{owner}--{name}"));
    let commit = std::fs::read_to_string(folder.join("refs").join(revision));
    let commit = commit.map_or(revision.to_owned(), |commit| commit.trim().to_owned());
    let snapshot = folder.join("snapshots").join(commit);
    if !snapshot.is_dir() {
        return Err(fetch());
    }
    Ok(path.iter().fold(snapshot, |folder, part| folder.join(part)))
}

fn form() -> String {
    "a dataset of the Hugging Face hub is named hf://datasets/OWNER/NAME or \
     hf://datasets/OWNER/NAME@REVISION"
        .to_owned()
}

pub(crate) fn beside(folder: &Path, entry: &Path) -> PathBuf {
    folder.join(entry.file_name().unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cached_dataset_is_found_and_a_missing_one_says_how_to_fetch_it() {
        let dir = tempfile::tempdir().expect("a folder");
        let repo = dir.path().join("datasets--lab--clips");
        std::fs::create_dir_all(repo.join("snapshots/abc/meta")).expect("made");
        std::fs::create_dir_all(repo.join("refs")).expect("made");
        std::fs::write(repo.join("refs/main"), "abc\n").expect("written");
        let cache = HubCache::new(dir.path());
        let path = |url: &str| {
            let place = Place::parse(Path::new(url)).expect("a URL");
            dataset_path(Some(&cache), &place)
        };
        let meta = repo.join("snapshots/abc/meta");
        for revision in ["", "@abc"] {
            let url = format!("hf://datasets/lab/clips{revision}/meta");
            assert_eq!(path(&url).expect("there"), meta);
        }
        for (url, reason) in [
            (
                "hf://datasets/lab/other",
                "hf download lab/other --repo-type dataset",
            ),
            ("hf://datasets/lab/clips@v2", "--revision v2"),
            ("hf://models/lab/clips", "hf://datasets/OWNER/NAME"),
            ("hf://datasets/lab", "hf://datasets/OWNER/NAME"),
        ] {
            let error = path(url).expect_err(url).to_string();
            assert!(error.contains(reason), "{error}");
        }
    }
}
