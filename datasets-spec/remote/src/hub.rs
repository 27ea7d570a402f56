//! Datasets in the cache of the Hugging Face hub's tools. Nothing is downloaded.

use std::io;
use std::path::{Path, PathBuf};

use crate::place::Place;

/// The folder in which Hugging Face's tools keep datasets.
#[derive(Clone, Debug, Default)]
pub(crate) struct HubCache {
    root: Option<PathBuf>,
}

/// The branch that is read where the URL names none.
const BRANCH: &str = "main";

impl HubCache {
    pub(crate) fn new(root: Option<PathBuf>) -> Self {
        Self { root }
    }

    /// The folder that the environment names, which `folder` looks up.
    pub(crate) fn folder_of(folder: impl Fn(&str) -> Option<PathBuf>) -> Option<PathBuf> {
        folder("HF_HUB_CACHE")
            .or_else(|| Some(folder("HF_HOME")?.join("hub")))
            .or_else(|| Some(folder("XDG_CACHE_HOME")?.join("huggingface/hub")))
            .or_else(|| {
                let home = folder("HOME").or_else(|| folder("USERPROFILE"))?;
                Some(home.join(".cache/huggingface/hub"))
            })
    }

    /// The local path of `hf://datasets/OWNER/NAME[@REVISION][/PATH]`.
    ///
    /// # Errors
    /// The URL has another form, or the dataset is not in the cache.
    pub(crate) fn path(&self, place: &Place) -> io::Result<PathBuf> {
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
        let root = self.root.as_ref().ok_or_else(fetch)?;
        let folder = root.join(format!("datasets--{owner}--{name}"));
        let commit = std::fs::read_to_string(folder.join("refs").join(revision));
        let commit = commit.map_or(revision.to_owned(), |commit| commit.trim().to_owned());
        let snapshot = folder.join("snapshots").join(commit);
        if !snapshot.is_dir() {
            return Err(fetch());
        }
        Ok(path.iter().fold(snapshot, |folder, part| folder.join(part)))
    }
}

fn form() -> String {
    "a dataset of the Hugging Face hub is named hf://datasets/OWNER/NAME or \
     hf://datasets/OWNER/NAME@REVISION"
        .to_owned()
}

/// The URL of an entry of a folder at a URL.
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
        let cache = HubCache::new(Some(dir.path().to_owned()));
        let path = |url: &str| cache.path(&Place::parse(Path::new(url)).expect("a URL"));
        let meta = repo.join("snapshots/abc/meta");
        assert_eq!(path("hf://datasets/lab/clips/meta").expect("there"), meta);
        assert_eq!(
            path("hf://datasets/lab/clips@abc/meta").expect("there"),
            meta
        );
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
