//! Repos: their names, revisions and files.

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use serde::Serialize;
use serde_json::Value;
use ureq::http::{StatusCode, header};

use super::checksum::{Checksum, Wanted};
use super::client::{Answer, Hub, JSON, is_commit, quoted, text_of};
use super::error::Error;

/// Maximum number of characters of a name.
const MAX_NAME_LEN: usize = 96;

datasets_spec::named! {
    /// Kind of a repo's contents, by its name in the hub's API.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
    #[serde(rename_all = "lowercase")]
    pub enum RepoKind, named by as_str {
        /// Tables of motions.
        Dataset = "dataset",
        /// Weights of a network.
        Model = "model",
    }
}

/// Name of a repo: `OWNER/NAME`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RepoName(String);

impl RepoName {
    fn parts(&self) -> (&str, &str) {
        self.0.split_once('/').unwrap_or(("", self.0.as_str()))
    }
}

impl fmt::Display for RepoName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl FromStr for RepoName {
    type Err = Error;

    /// Parses a name by the rules of the hub, so that a wrong one is refused before any request.
    fn from_str(name: &str) -> Result<Self, Error> {
        let refused = |problem: &str| {
            let problem = format!("{name:?} is no name of a repo: {problem}; expected OWNER/NAME");
            Err(Error::hub(name, problem))
        };
        let Some((owner, own)) = name.split_once('/') else {
            return refused("it has no owner");
        };
        for part in [owner, own] {
            let is_known = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
            if part.is_empty() {
                return refused("a part of it is empty");
            }
            if part.contains('/') {
                return refused("it has more than two parts");
            }
            if !part.chars().all(is_known) {
                return refused("only ASCII letters, digits, '-', '_' and '.' are allowed");
            }
            if part.starts_with(['-', '.']) || part.ends_with(['-', '.']) {
                return refused("no part begins or ends with '-' or '.'");
            }
        }
        if name.contains("--") || name.contains("..") || name.ends_with(".git") {
            return refused("it must not hold '--' or '..', or end with '.git'");
        }
        match name.len() <= MAX_NAME_LEN {
            true => Ok(Self(name.to_owned())),
            false => refused("it has more than 96 characters"),
        }
    }
}

/// A repo.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Repo {
    /// Kind of the repo's contents.
    pub kind: RepoKind,
    /// Name of the repo.
    pub name: RepoName,
}

impl Repo {
    pub(super) fn path(&self) -> String {
        match self.kind {
            RepoKind::Dataset => format!("datasets/{}", self.name),
            RepoKind::Model => self.name.to_string(),
        }
    }

    /// URL of the repo's page.
    pub fn address(&self, hub: &Hub) -> String {
        format!("{}/{}", hub.endpoint(), self.path())
    }

    /// URL of the repo's API.
    pub(super) fn api(&self, hub: &Hub) -> String {
        format!("{}/api/{}s/{}", hub.endpoint(), self.kind, self.name)
    }
}

impl fmt::Display for Repo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.kind, self.name)
    }
}

/// The state of a revision.
pub(super) struct Head {
    /// Id of the commit.
    pub(super) commit: String,
    /// Whether the server says that everybody can read the repo.
    pub(super) is_public: bool,
}

/// The state of a revision (branch, tag or commit); `None` if there is no such repo. Without a token, a missing repo
/// cannot be distinguished from a private one.
pub(super) fn head_of(hub: &Hub, repo: &Repo, revision: &str) -> Result<Option<Head>, Error> {
    let address = format!("{}/revision/{}", repo.api(hub), quoted(revision, ""));
    let answer = hub.ask(&address)?;
    let code = text_of(&answer.headers, "x-error-code");
    let is_missing = match answer.status {
        StatusCode::NOT_FOUND => code != Some("RevisionNotFound"),
        StatusCode::UNAUTHORIZED => !hub.has_token(),
        _ => false,
    };
    if is_missing {
        return Ok(None);
    }
    let answer = answer.checked()?;
    match answer.body["sha"].as_str() {
        Some(commit) if is_commit(commit) => Ok(Some(Head {
            commit: commit.to_owned(),
            is_public: answer.body["private"] == false,
        })),
        _ => Err(answer.malformed("names no commit")),
    }
}

/// Finds whether a name belongs to a dataset or to a model.
///
/// # Errors
/// The name belongs to both or to neither, or the server cannot be reached or fails.
pub fn kind_of(hub: &Hub, name: &RepoName, revision: &str) -> Result<RepoKind, Error> {
    let mut found = Vec::new();
    for kind in RepoKind::ALL {
        let name = name.clone();
        if head_of(hub, &Repo { kind, name }, revision)?.is_some() {
            found.push(kind);
        }
    }
    match found[..] {
        [kind] => Ok(kind),
        [] => Err(Error::not_found(format!("dataset or model {name}"))),
        _ => {
            let next = "say which: --type dataset or --type model";
            let problem = format!("{name} is a dataset and a model; {next}");
            Err(Error::hub(name, problem))
        }
    }
}

/// Creates a repo if it does not exist.
pub(super) fn create(hub: &Hub, repo: &Repo, is_private: bool) -> Result<(), Error> {
    let (owner, name) = repo.name.parts();
    let asked = serde_json::json!({
        "type": repo.kind.as_str(),
        "organization": owner,
        "name": name,
        "visibility": if is_private { "private" } else { "public" },
    });
    let address = format!("{}/api/repos/create", hub.endpoint());
    let answer = hub.post(&address, JSON, asked.to_string().as_bytes())?;
    match answer.status {
        StatusCode::CONFLICT => Ok(()),
        _ => answer.checked().map(|_| ()),
    }
}

pub(super) type Tree = BTreeMap<String, Wanted>;

pub(super) fn tree(hub: &Hub, repo: &Repo, commit: &str) -> Result<Tree, Error> {
    let mut files = Tree::new();
    let mut next = Some(format!("{}/tree/{commit}?recursive=true", repo.api(hub)));
    while let Some(address) = next {
        let page = hub.ask(&address)?.checked()?;
        let entries = page.body.as_array();
        for entry in entries.ok_or_else(|| page.malformed("is no list of files"))? {
            if entry["type"] == "file" {
                let (path, file) = file_of(entry)
                    .ok_or_else(|| page.malformed("has a file without path, size or checksum"))?;
                files.insert(path, file);
            }
        }
        next = next_page(&page).map(|address| hub.here(&address));
    }
    Ok(files)
}

/// Path, size and checksum of a file in a listing. A file in LFS has a SHA-256 of its own; its `oid` is the Git hash of
/// the small file that points to it.
fn file_of(entry: &Value) -> Option<(String, Wanted)> {
    let checksum = entry["lfs"]["oid"].as_str().or(entry["oid"].as_str())?;
    let wanted = Wanted {
        checksum: Checksum::parse(checksum)?,
        len: Some(entry["size"].as_u64()?),
    };
    Some((entry["path"].as_str()?.to_owned(), wanted))
}

/// The address of the next page, from a header such as `<https://...>; rel="next"`.
fn next_page(page: &Answer) -> Option<String> {
    let links = text_of(&page.headers, header::LINK.as_str())?;
    let (before, _) = links.split_once(">; rel=\"next\"")?;
    let (_, address) = before.rsplit_once('<')?;
    Some(address.to_owned())
}
