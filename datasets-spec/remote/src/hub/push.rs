//! Publishing: one commit of the files that differ.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use datasets_spec::Progress;
use serde::Serialize;
use serde_json::{Value, json};

use super::checksum::Wanted;
use super::client::{Hub, JSON, quoted};
use super::content::{Content, HubFile};
use super::error::Error;
use super::lfs::{self, Object};
use super::repo::{Repo, Tree, create, head_of, tree};

/// Files per request that asks how files are stored; the server's maximum.
const BATCH: usize = 256;
/// First bytes of a file, from which the server decides between text and binary data.
const SAMPLE_LEN: u64 = 512;
/// The hub's file of LFS patterns, which belongs to the repo.
const ATTRIBUTES: &str = ".gitattributes";

/// Options of a push.
#[derive(Clone, Copy, Debug)]
pub struct PushOptions<'a> {
    /// Target branch.
    pub revision: &'a str,
    /// First line of the commit's message.
    pub message: &'a str,
    /// Whether a new repo is private.
    pub is_private: bool,
    /// Files and folders to delete from the repo. A file of this push cannot be deleted.
    pub delete: &'a [String],
}

/// Result of a push, or of its dry run.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Pushed {
    /// Id of the commit; `None` if nothing differs, or in a dry run.
    pub commit: Option<String>,
    /// Files that are new or changed.
    pub changed: Vec<String>,
    /// Number of files that are already in the repo.
    pub unchanged: usize,
    /// Files that were deleted.
    pub deleted: Vec<String>,
    /// Files of the repo that this push neither writes nor deletes.
    pub only_in_repo: Vec<String>,
    /// Number of large files that were uploaded. The others were stored before, here or by an interrupted upload.
    pub sent: usize,
    /// Total size of these files in bytes.
    pub sent_bytes: u64,
}

/// A planned commit: the files that a repo lacks or has with other content.
#[derive(Debug)]
pub struct Push<'a> {
    hub: &'a Hub,
    repo: &'a Repo,
    options: PushOptions<'a>,
    /// The parent commit; `None` if the repo does not exist yet.
    parent: Option<String>,
    /// The files of that commit.
    there: Tree,
    changed: Vec<&'a HubFile>,
    preview: Pushed,
}

impl<'a> Push<'a> {
    /// Compares files with those of a repo. Nothing is written.
    ///
    /// # Errors
    /// A file to delete is not in the repo or is in this push, a repo that shall be private is public, the server refuses
    /// or fails, or a file cannot be read.
    pub fn plan(
        hub: &'a Hub,
        repo: &'a Repo,
        files: &'a [HubFile],
        options: PushOptions<'a>,
    ) -> Result<Self, Error> {
        let head = head_of(hub, repo, options.revision)?;
        if options.is_private && head.as_ref().is_some_and(|head| head.is_public) {
            let problem = "the repo is there already, and public; make it private on the hub, or leave --private out";
            return Err(Error::hub(&repo.name, problem));
        }
        let parent = head.map(|head| head.commit);
        let there = match &parent {
            Some(commit) => tree(hub, repo, commit)?,
            None => Tree::new(),
        };
        let changed = changed(files, &there)?;
        let deleted = deleted(files, &there, options.delete)?;
        let published = paths(files);
        let left = there.keys().filter(|path| {
            *path != ATTRIBUTES && !published.contains(path.as_str()) && !deleted.contains(path)
        });
        let preview = Pushed {
            changed: changed.iter().map(|file| file.path.clone()).collect(),
            unchanged: files.len() - changed.len(),
            only_in_repo: left.cloned().collect(),
            deleted,
            ..Pushed::default()
        };
        Ok(Self {
            hub,
            repo,
            options,
            parent,
            there,
            changed,
            preview,
        })
    }

    /// Paths of the files that the repo has.
    pub fn files_there(&self) -> impl Iterator<Item = &str> {
        self.there.keys().map(String::as_str)
    }

    /// Whether a file of the repo is equal to a local one.
    ///
    /// # Errors
    /// The local file cannot be read.
    pub fn is_equal(&self, path: &str, local: &Path) -> Result<bool, Error> {
        let content = Content::File {
            path: local.to_owned(),
            sha256: None,
        };
        is_same(&content, self.there.get(path))
    }

    /// The changes that the commit will make.
    pub fn preview(&self) -> &Pushed {
        &self.preview
    }

    /// Uploads the files that the storage lacks, and makes one commit of all changes. Without changes nothing is done.
    /// A missing repo is created.
    ///
    /// # Errors
    /// There is no token, the server refuses or fails, another commit was made meanwhile, or a file cannot be read.
    /// Uploaded files are not lost: the same push continues from there.
    pub fn send(self, progress: &dyn Progress) -> Result<Pushed, Error> {
        let (hub, repo, options) = (self.hub, self.repo, self.options);
        hub.check_token()?;
        let mut done = self.preview;
        if self.changed.is_empty() && done.deleted.is_empty() {
            return Ok(done);
        }
        if self.parent.is_none() {
            create(hub, repo, options.is_private)?;
        }
        progress.begin("push", Some(self.changed.len() as u64));
        let (regular, large) = by_mode(hub, repo, options.revision, &self.changed)?;
        (done.sent, done.sent_bytes) =
            lfs::send(hub, repo, options.revision, &distinct(&large), progress)?;
        let parent = self.parent.as_deref();
        let lines = commit_lines(&options, parent, &regular, &large, &done.deleted)?;
        done.commit = Some(commit(hub, repo, options.revision, &lines)?);
        progress.finish(&format!(
            "{} files, {:.1} MB of them uploaded",
            done.changed.len(),
            done.sent_bytes as f64 / 1e6
        ));
        Ok(done)
    }
}

fn paths(files: &[HubFile]) -> BTreeSet<&str> {
    files.iter().map(|file| file.path.as_str()).collect()
}

/// Whether a file has the content of one in a repo, if that is there.
fn is_same(content: &Content, there: Option<&Wanted>) -> Result<bool, Error> {
    let size = content.size()?;
    match there.filter(|there| there.len == Some(size)) {
        Some(there) => content.has(&there.checksum, size),
        None => Ok(false),
    }
}

/// The files that are new or changed in comparison with a repo.
fn changed<'a>(files: &'a [HubFile], there: &Tree) -> Result<Vec<&'a HubFile>, Error> {
    let mut changed = Vec::new();
    for file in files {
        if !is_same(&file.content, there.get(&file.path))? {
            changed.push(file);
        }
    }
    Ok(changed)
}

/// The files of a repo that are named to be deleted, each by its own path or by that of a folder.
fn deleted(files: &[HubFile], there: &Tree, named: &[String]) -> Result<Vec<String>, Error> {
    let published = paths(files);
    let mut deleted = BTreeSet::new();
    for name in named {
        let refused = |problem: &str| Error::hub(name, format!("cannot delete {name}: {problem}"));
        let folder = format!("{}/", name.trim_end_matches('/'));
        let found: Vec<&String> = there
            .keys()
            .filter(|path| *path == name || path.starts_with(&folder))
            .collect();
        if found.is_empty() {
            return Err(refused("the repo has no such file"));
        }
        let before = deleted.len();
        let left = found
            .into_iter()
            .filter(|path| !published.contains(path.as_str()));
        deleted.extend(left.cloned());
        if deleted.len() == before {
            return Err(refused("it is published"));
        }
    }
    Ok(deleted.into_iter().collect())
}

/// Files that are part of the commit itself, and files stored in LFS.
type Modes<'a> = (Vec<&'a HubFile>, Vec<Object<'a>>);

/// Asks the server which files are stored in the commit itself.
fn by_mode<'a>(
    hub: &Hub,
    repo: &Repo,
    revision: &str,
    files: &[&'a HubFile],
) -> Result<Modes<'a>, Error> {
    let address = format!("{}/preupload/{}", repo.api(hub), quoted(revision, ""));
    let (mut regular, mut large) = (Vec::new(), Vec::new());
    for batch in files.chunks(BATCH) {
        let mut asked = Vec::new();
        for file in batch {
            asked.push(json!({
                "path": file.path,
                "size": file.content.size()?,
                "sample": STANDARD.encode(file.content.start(SAMPLE_LEN)?),
            }));
        }
        let asked = json!({ "files": asked }).to_string();
        let answer = hub.post(&address, JSON, asked.as_bytes())?.checked()?;
        let found = answer.body["files"].as_array();
        let found = found.ok_or_else(|| answer.malformed("names no files"))?;
        let found: BTreeMap<&str, &Value> = found
            .iter()
            .filter_map(|mode| Some((mode["path"].as_str()?, mode)))
            .collect();
        for &file in batch {
            let mode = found.get(file.path.as_str());
            let mode = mode.ok_or_else(|| answer.malformed("lacks a file"))?;
            if mode["shouldIgnore"] == true {
                let problem = "the .gitignore of the repo excludes it";
                return Err(Error::upload(&file.path, problem));
            }
            let size = file.content.size()?;
            // The storage keeps no empty objects.
            if mode["uploadMode"] == "lfs" && size > 0 {
                let oid = file.content.sha256()?;
                large.push(Object { file, oid, size });
            } else {
                regular.push(file);
            }
        }
    }
    Ok((regular, large))
}

/// One object of each content, sorted by path.
fn distinct<'a>(objects: &[Object<'a>]) -> Vec<Object<'a>> {
    let by_oid: BTreeMap<&str, &Object<'a>> = objects
        .iter()
        .rev()
        .map(|object| (object.oid.as_str(), object))
        .collect();
    let mut distinct: Vec<Object<'a>> = by_oid.into_values().cloned().collect();
    distinct.sort_by(|a, b| a.file.path.cmp(&b.file.path));
    distinct
}

/// The commit in the server's format: one JSON document per line. The commit names its parent, so it fails if another
/// commit was made meanwhile.
fn commit_lines(
    options: &PushOptions<'_>,
    parent: Option<&str>,
    regular: &[&HubFile],
    large: &[Object<'_>],
    deleted: &[String],
) -> Result<Vec<u8>, Error> {
    let mut header = json!({ "summary": options.message, "description": "" });
    if let Some(parent) = parent {
        header["parentCommit"] = parent.into();
    }
    let mut lines = Vec::new();
    let mut add = |key: &str, value: Value| {
        lines.extend(
            json!({ "key": key, "value": value })
                .to_string()
                .into_bytes(),
        );
        lines.push(b'\n');
    };
    add("header", header);
    for file in regular {
        let content = STANDARD.encode(file.content.start(u64::MAX)?);
        add(
            "file",
            json!({ "path": file.path, "encoding": "base64", "content": content }),
        );
    }
    for object in large {
        add(
            "lfsFile",
            json!({
                "path": object.file.path,
                "algo": "sha256",
                "oid": object.oid,
                "size": object.size,
            }),
        );
    }
    for path in deleted {
        add("deletedFile", json!({ "path": path }));
    }
    Ok(lines)
}

fn commit(hub: &Hub, repo: &Repo, revision: &str, lines: &[u8]) -> Result<String, Error> {
    let address = format!("{}/commit/{}", repo.api(hub), quoted(revision, ""));
    let answer = hub
        .post(&address, "application/x-ndjson", lines)?
        .checked()?;
    match answer.body["commitOid"].as_str() {
        Some(commit) => Ok(commit.to_owned()),
        None => Err(answer.malformed("names no commit")),
    }
}
