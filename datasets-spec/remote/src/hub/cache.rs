//! The cache of Hugging Face's tools, and downloads of models into it.
//!
//! Files are stored in the layout of Hugging Face's own tools: `models--OWNER--NAME/snapshots/COMMIT/FILE` is a link to
//! `blobs/CHECKSUM`, and `refs/main` names the commit. Only [`HubCache::fetch`] downloads.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use datasets_spec::store::{if_exists, replace_file};

use super::client::{BRANCH, Hub, home_from_variables};
use super::download::{describe, download};
use super::error::Error;

/// The folder in which Hugging Face's tools keep models and datasets.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HubCache {
    root: PathBuf,
}

impl HubCache {
    /// The cache in a folder, which need not exist.
    pub fn new(root: impl Into<PathBuf>) -> Self {
        Self { root: root.into() }
    }

    /// The cache that the environment names: `HF_HUB_CACHE`, or `hub` in `HF_HOME`, or `huggingface/hub` in
    /// `XDG_CACHE_HOME` or in `.cache` of the home folder; `None` if it names no home. `variable` returns the value of
    /// an environment variable.
    pub fn from_variables(variable: impl Fn(&str) -> Option<OsString>) -> Option<Self> {
        let own = variable("HF_HUB_CACHE").filter(|value| !value.is_empty());
        let root = match own {
            Some(folder) => PathBuf::from(folder),
            None => home_from_variables(variable)?.join("hub"),
        };
        Some(Self { root })
    }

    pub(crate) fn root(&self) -> &Path {
        &self.root
    }

    /// The folder of a model.
    pub fn folder(&self, repo: &str) -> PathBuf {
        self.root
            .join(format!("models--{}", repo.replace('/', "--")))
    }

    /// Path of a file of a model as it was last fetched; `None` if it never was.
    pub fn find(&self, repo: &str, file: &str) -> Option<PathBuf> {
        let folder = self.folder(repo);
        let commit = fs::read_to_string(folder.join("refs").join(BRANCH)).ok()?;
        let path = folder.join("snapshots").join(commit.trim()).join(file);
        path.is_file().then_some(path)
    }

    /// Downloads a file of a model into the cache, unless it is there, and verifies its checksum. An
    /// interrupted download is resumed. `progress` receives the bytes so far and the total, if known.
    /// `None` if the server has no such file.
    ///
    /// # Errors
    /// The server cannot be reached or fails, another process is fetching the same file, the content does not match the
    /// checksum, or the cache cannot be written. Downloaded bytes are kept, unless they are wrong.
    pub fn fetch(
        &self,
        hub: &Hub,
        repo: &str,
        file: &str,
        progress: &mut dyn FnMut(u64, Option<u64>),
    ) -> Result<Option<PathBuf>, Error> {
        let folder = self.folder(repo);
        let address = hub.address(repo, BRANCH, file);
        let failed = |problem: String| Error::download(&address, &problem);
        let Some(remote) = describe(hub, repo, file).map_err(failed)? else {
            return Ok(None);
        };
        let snapshot = folder.join("snapshots").join(&remote.commit);
        let (blobs, refs) = (folder.join("blobs"), folder.join("refs"));
        for folder in [&blobs, &refs, &snapshot] {
            fs::create_dir_all(folder).map_err(Error::io("create", folder))?;
        }
        let blob = blobs.join(remote.content.checksum.as_str());
        if blob.is_file() {
            let file = File::open(&blob).map_err(Error::io("open", &blob))?;
            let len = file.metadata().map_err(Error::io("read", &blob))?.len();
            remote.content.checksum.check(file, len, &blob)?;
        } else {
            let part = blobs.join(format!("{}.incomplete", remote.content.checksum.as_str()));
            let pinned = hub.address(repo, &remote.commit, file);
            download(hub, &pinned, &remote.content, &part, progress)?;
            fs::rename(&part, &blob).map_err(Error::io("rename into place", &blob))?;
        }
        let path = snapshot.join(file);
        if !path.is_file() {
            link(&blob, &path).map_err(Error::io("link", &path))?;
        }
        let current = refs.join(BRANCH);
        replace_file(&current, remote.commit.as_bytes()).map_err(Error::io("write", &current))?;
        Ok(Some(path))
    }
}

/// Creates the entry of a snapshot: a symbolic link on Unix, a hard link elsewhere.
fn link(blob: &Path, path: &Path) -> io::Result<()> {
    // Replace a dangling link, which cleaning the cache can leave behind.
    if_exists(fs::remove_file(path))?;
    #[cfg(unix)]
    {
        let name = blob.file_name().ok_or(io::ErrorKind::InvalidInput)?;
        std::os::unix::fs::symlink(Path::new("../../blobs").join(name), path)
    }
    #[cfg(not(unix))]
    fs::hard_link(blob, path)
}
