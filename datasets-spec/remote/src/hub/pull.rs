//! Pulling a repo into a folder that appears complete or not at all.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Component, Path, PathBuf};

use datasets_spec::Progress;
use datasets_spec::manifest::Manifest;
use serde::Serialize;

use super::checksum::Wanted;
use super::client::Hub;
use super::download::download;
use super::error::Error;
use super::repo::{Repo, RepoKind, Tree, head_of, tree};

/// Result of a pull.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Pulled {
    /// Id of the pulled commit.
    pub commit: String,
    /// Number of files.
    pub files: usize,
    /// Total size of the files in bytes.
    pub bytes: u64,
    /// Files of the repo that the newest version of the dataset does not name.
    pub passed_over: Vec<String>,
}

/// A downloaded repo beside its output folder, complete and with every file checked.
#[derive(Debug)]
pub struct Staged {
    folder: PathBuf,
    out: PathBuf,
    pulled: Pulled,
}

impl Staged {
    /// Path of the folder before it is published.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Renames the folder to the output folder.
    ///
    /// # Errors
    /// The folder cannot be renamed.
    pub fn publish(self) -> Result<Pulled, Error> {
        fs::rename(&self.folder, &self.out).map_err(Error::io("rename into place", &self.out))?;
        Ok(self.pulled)
    }

    /// Removes what was downloaded.
    ///
    /// # Errors
    /// The folder cannot be removed.
    pub fn discard(self) -> Result<(), Error> {
        let removed = fs::remove_dir_all(&self.folder);
        removed.map_err(Error::io("remove", &self.folder))
    }
}

/// The version in the path of a manifest; `None` if the path is not that of a manifest.
pub fn manifest_version(path: &str) -> Option<u64> {
    let number = path.strip_prefix("meta/manifest-")?;
    number.strip_suffix(".json")?.parse().ok()
}

/// Downloads the files of a repo into a folder beside `out`; of a dataset, only those of its newest version. Each is
/// checked against its checksum, and an interrupted download is resumed.
///
/// # Errors
/// `out` exists already, the repo has no such revision or holds no dataset or run of this program, the server refuses
/// or fails, or a file does not match its checksum. Downloaded files are kept, unless they are wrong.
pub fn pull(
    hub: &Hub,
    repo: &Repo,
    revision: &str,
    out: &Path,
    progress: &dyn Progress,
) -> Result<Staged, Error> {
    let exists = || {
        let problem = format!("{} is there already; choose another folder", out.display());
        Error::hub(out.display(), problem)
    };
    let name = out.file_name().ok_or_else(exists)?.to_string_lossy();
    if fs::symlink_metadata(out).is_ok() {
        return Err(exists());
    }
    let head = head_of(hub, repo, revision)?.ok_or_else(|| Error::not_found(repo))?;
    let commit = head.commit;
    let mut files = tree(hub, repo, &commit)?;
    // The folder name contains the commit, so that files of two commits are never mixed.
    let folder = out.with_file_name(format!(".{name}.{commit:.12}.part"));
    let source = Source {
        hub,
        repo,
        commit: &commit,
        folder: &folder,
    };
    let passed_over = match repo.kind {
        RepoKind::Dataset => source.keep_newest(&mut files, progress)?,
        RepoKind::Model if files.contains_key("config.json") => Vec::new(),
        RepoKind::Model => return Err(source.foreign("run", "config.json")),
    };
    files.keys().try_for_each(|path| source.check(path))?;
    // Skip settings of the repo itself, such as .gitattributes.
    files.retain(|path, _| !path.split('/').any(|part| part.starts_with('.')));
    progress.begin("pull", Some(files.len() as u64));
    for (path, file) in &files {
        source.fetch(path, file, progress)?;
        progress.advance(1);
    }
    let pulled = Pulled {
        files: files.len(),
        bytes: files.values().filter_map(|file| file.len).sum(),
        passed_over,
        commit,
    };
    progress.finish(&format!(
        "{} files, {:.1} MB",
        pulled.files,
        pulled.bytes as f64 / 1e6
    ));
    Ok(Staged {
        folder,
        out: out.to_owned(),
        pulled,
    })
}

/// A commit, and the folder that it is downloaded to.
struct Source<'a> {
    hub: &'a Hub,
    repo: &'a Repo,
    commit: &'a str,
    folder: &'a Path,
}

impl Source<'_> {
    fn foreign(&self, kind: &str, missing: &str) -> Error {
        let repo = self.repo;
        let problem = format!("{repo} holds no {kind} of this program: it has no {missing}");
        Error::hub(repo, problem)
    }

    /// Keeps the files of the newest version of a dataset, and the files beside its tables. Returns the other files.
    fn keep_newest(&self, files: &mut Tree, progress: &dyn Progress) -> Result<Vec<String>, Error> {
        let newest = files
            .iter()
            .filter_map(|(path, file)| Some((manifest_version(path)?, path, file)))
            .max_by_key(|(version, ..)| *version);
        let Some((_, newest, file)) = newest else {
            return Err(self.foreign("dataset", "meta/manifest-<n>.json"));
        };
        let place = self.fetch(newest, file, progress)?;
        let text = fs::read(&place).map_err(Error::io("read", &place))?;
        let manifest: Manifest =
            serde_json::from_slice(&text).map_err(datasets_spec::Error::json(place))?;
        let entries = manifest.tables.into_values().flatten();
        let mut named: BTreeSet<String> = entries.map(|entry| entry.path).collect();
        named.insert(newest.clone());
        let is_kept = |path: &String| {
            let is_table = path.starts_with("data/") || path.starts_with("meta/");
            !is_table || named.contains(path)
        };
        let others = files
            .keys()
            .filter(|path| !is_kept(path))
            .cloned()
            .collect();
        files.retain(|path, _| is_kept(path));
        Ok(others)
    }

    /// Refuses a path that leads out of the folder.
    fn check(&self, path: &str) -> Result<(), Error> {
        let mut parts = Path::new(path).components();
        let is_below = parts.all(|part| matches!(part, Component::Normal(_)));
        if path.is_empty() || path.contains('\\') || !is_below {
            let problem = format!(
                "{} has a file {path:?}, which cannot be written here",
                self.repo
            );
            return Err(Error::hub(path, problem));
        }
        Ok(())
    }

    /// Downloads a file if the folder lacks it, and returns its path on this machine.
    fn fetch(&self, path: &str, file: &Wanted, progress: &dyn Progress) -> Result<PathBuf, Error> {
        self.check(path)?;
        let place = self.folder.join(path);
        let parent = place.parent().unwrap_or(self.folder);
        fs::create_dir_all(parent).map_err(Error::io("create", parent))?;
        let address = self.hub.address(&self.repo.path(), self.commit, path);
        download(self.hub, &address, file, &place, &mut |done, _| {
            progress.message(&format!("{path} {:.1} MB", done as f64 / 1e6));
        })?;
        Ok(place)
    }
}
