//! The cache of Hugging Face's tools, and downloads into it.
//!
//! Only [`HubCache::fetch`] downloads. The crate `hf-hub` (0.5) has the same cache layout and resumes
//! downloads too, but does not verify checksums, and brings an HTTP client of its own beside ureq 3.
//! Files are stored in the layout of Hugging Face's own tools: `models--OWNER--NAME/snapshots/COMMIT/FILE` is a link to
//! `blobs/CHECKSUM`, and `refs/main` names the commit.

use std::ffi::OsString;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use datasets_spec::store::replace_file;
use sha1::Sha1;
use sha2::{Digest, Sha256};
use ureq::http::{HeaderMap, Response, StatusCode, header};
use ureq::{Agent, Body, Proxy};

use crate::Error;

/// Where models are published.
const ENDPOINT: &str = "https://huggingface.co";
/// The branch that is followed.
const BRANCH: &str = "main";
/// Maximum number of redirects followed for a file's metadata.
const MAX_REDIRECTS: u32 = 5;
/// Maximum number of connections per download; each must have made progress.
const MAX_ATTEMPTS: u32 = 20;
const CONNECT_TIMEOUT: Duration = Duration::from_secs(30);
/// Read timeout.
const READ_TIMEOUT: Duration = Duration::from_secs(60);
const BUFFER_LEN: usize = 1 << 18;

/// A server of models.
#[derive(Clone, Debug)]
pub struct Hub {
    endpoint: String,
    agent: Agent,
}

impl Hub {
    /// The server at `endpoint`, reached directly.
    pub fn at(endpoint: &str) -> Self {
        Self::through(endpoint, None)
    }

    /// The server, and the proxy to it, that the variables `HF_ENDPOINT`, `HTTPS_PROXY` and
    /// `ALL_PROXY` name; without them the public server, reached directly. The caller passes the
    /// environment in.
    ///
    /// # Errors
    /// A variable does not name a proxy.
    pub fn from_variables(variable: impl Fn(&str) -> Option<OsString>) -> Result<Self, Error> {
        let text = |name: &str| {
            variable(name)
                .map(|value| value.to_string_lossy().into_owned())
                .filter(|value| !value.is_empty())
        };
        let endpoint = text("HF_ENDPOINT").unwrap_or_else(|| ENDPOINT.to_owned());
        let proxy = ["HTTPS_PROXY", "https_proxy", "ALL_PROXY", "all_proxy"]
            .into_iter()
            .find_map(text)
            .map(|address| {
                Proxy::new(&address).map_err(|error| Error::Config {
                    field: "HTTPS_PROXY",
                    problem: error.to_string(),
                })
            })
            .transpose()?;
        Ok(Self::through(&endpoint, proxy))
    }

    fn through(endpoint: &str, proxy: Option<Proxy>) -> Self {
        let config = Agent::config_builder()
            .proxy(proxy)
            .http_status_as_error(false)
            .max_redirects_will_error(false)
            .timeout_connect(Some(CONNECT_TIMEOUT))
            .timeout_recv_response(Some(READ_TIMEOUT))
            .timeout_per_read(Some(READ_TIMEOUT))
            .user_agent(concat!("stance/", env!("CARGO_PKG_VERSION")))
            .build();
        Self {
            endpoint: endpoint.trim_end_matches('/').to_owned(),
            agent: config.into(),
        }
    }

    fn address(&self, repo: &str, revision: &str, file: &str) -> String {
        format!("{}/{repo}/resolve/{revision}/{file}", self.endpoint)
    }

    /// Metadata of a file; `None` if the server has no such file.
    fn describe(&self, repo: &str, file: &str) -> Result<Option<Remote>, String> {
        let mut address = self.address(repo, BRANCH, file);
        for _ in 0..=MAX_REDIRECTS {
            let request = self.agent.head(&address).config().max_redirects(0).build();
            let response = request.call().map_err(|error| error.to_string())?;
            let status = response.status();
            let headers = response.headers();
            // The redirect to a large file carries its metadata; for small or moved files, the
            // target on the same server does.
            let moved = text_of(headers, header::LOCATION.as_str())
                .filter(|place| status.is_redirection() && place.starts_with('/'))
                .filter(|_| !headers.contains_key("x-linked-etag"));
            if let Some(place) = moved {
                address = format!("{}{place}", self.endpoint);
                continue;
            }
            if status == StatusCode::NOT_FOUND {
                return Ok(None);
            }
            if !(status.is_success() || status.is_redirection()) {
                return Err(format!("the server answers {status}"));
            }
            return Remote::parse(status, headers).map(Some);
        }
        Err("the server redirects without end".to_owned())
    }

    /// The file from a byte on.
    fn get(&self, address: &str, from: u64) -> Result<Response<Body>, String> {
        let request = self.agent.get(address);
        let request = match from {
            0 => request,
            from => request.header(header::RANGE, format!("bytes={from}-")),
        };
        request.call().map_err(|error| error.to_string())
    }
}

/// A file on the server.
struct Remote {
    checksum: Checksum,
    commit: String,
    len: Option<u64>,
}

impl Remote {
    fn parse(status: StatusCode, headers: &HeaderMap) -> Result<Self, String> {
        let checksum = text_of(headers, "x-linked-etag")
            .or_else(|| text_of(headers, header::ETAG.as_str()))
            .unwrap_or_default();
        let checksum = checksum.trim_start_matches("W/").trim_matches('"');
        let commit = text_of(headers, "x-repo-commit").unwrap_or_default();
        let len = text_of(headers, "x-linked-size").or_else(|| {
            text_of(headers, header::CONTENT_LENGTH.as_str()).filter(|_| status.is_success())
        });
        if commit.is_empty() || !commit.bytes().all(|byte| byte.is_ascii_hexdigit()) {
            return Err(format!("the server names no commit but {commit:?}"));
        }
        Ok(Self {
            checksum: Checksum::parse(checksum)
                .ok_or_else(|| format!("the server names no checksum but {checksum:?}"))?,
            commit: commit.to_owned(),
            len: len.and_then(|len| len.parse().ok()),
        })
    }
}

fn text_of<'a>(headers: &'a HeaderMap, name: &str) -> Option<&'a str> {
    headers.get(name)?.to_str().ok()
}

/// Expected checksum of a file: SHA-256 for large files, the Git blob hash for small ones.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Checksum {
    Sha256(String),
    Git(String),
}

impl Checksum {
    fn parse(text: &str) -> Option<Self> {
        let is_hex = text
            .bytes()
            .all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f'));
        match text.len() {
            64 if is_hex => Some(Self::Sha256(text.to_owned())),
            40 if is_hex => Some(Self::Git(text.to_owned())),
            _ => None,
        }
    }

    fn as_str(&self) -> &str {
        match self {
            Self::Sha256(text) | Self::Git(text) => text,
        }
    }

    /// Verifies the checksum of content; `path` names it in errors.
    fn check(&self, content: impl Read, len: u64, path: &Path) -> Result<(), Error> {
        let (name, found) = match self {
            Self::Sha256(_) => ("SHA-256", digest(Sha256::new(), content)),
            Self::Git(_) => {
                let hash = Sha1::new().chain_update(format!("blob {len}\0"));
                ("Git name", digest(hash, content))
            }
        };
        let found = found.map_err(datasets_spec::Error::io("read", path))?;
        if found != self.as_str() {
            return Err(Error::Checksum {
                path: path.to_owned(),
                name,
                expected: self.as_str().to_owned(),
                found,
            });
        }
        Ok(())
    }
}

fn digest(mut hash: impl Digest, mut content: impl Read) -> io::Result<String> {
    let mut buffer = vec![0; BUFFER_LEN];
    loop {
        match content.read(&mut buffer)? {
            0 => return Ok(hex(&hash.finalize())),
            count => hash.update(&buffer[..count]),
        }
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Reads a file. If it is a link into the cache, whose blobs are named by their checksums, the checksum is
/// verified.
///
/// # Errors
/// The file cannot be read, or is not what its checksum says.
pub fn read_checked(path: &Path) -> Result<Vec<u8>, Error> {
    let real = fs::canonicalize(path).map_err(datasets_spec::Error::io("find", path))?;
    let checksum = real
        .file_name()
        .and_then(|name| Checksum::parse(name.to_str()?));
    let content = fs::read(&real).map_err(datasets_spec::Error::io("read", path))?;
    if let Some(checksum) = checksum {
        checksum.check(content.as_slice(), content.len() as u64, &real)?;
    }
    Ok(content)
}

/// The folder in which Hugging Face's tools keep models.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HubCache {
    root: PathBuf,
}

impl HubCache {
    /// The cache in a folder, which need not exist.
    pub fn new(root: impl Into<PathBuf>) -> Self {
        Self { root: root.into() }
    }

    /// The cache that the environment names: `HF_HUB_CACHE`, or `hub` in `HF_HOME`, or
    /// `huggingface/hub` in `XDG_CACHE_HOME` or in `.cache` of the home folder. The caller passes
    /// the environment in; none if it names no home.
    pub fn from_variables(variable: impl Fn(&str) -> Option<OsString>) -> Option<Self> {
        let folder = |name: &str| {
            variable(name)
                .filter(|value| !value.is_empty())
                .map(PathBuf::from)
        };
        let root = folder("HF_HUB_CACHE")
            .or_else(|| Some(folder("HF_HOME")?.join("hub")))
            .or_else(|| Some(folder("XDG_CACHE_HOME")?.join("huggingface/hub")))
            .or_else(|| {
                let home = folder("HOME").or_else(|| folder("USERPROFILE"))?;
                Some(home.join(".cache/huggingface/hub"))
            })?;
        Some(Self { root })
    }

    /// The folder of a model.
    pub fn folder(&self, repo: &str) -> PathBuf {
        self.root
            .join(format!("models--{}", repo.replace('/', "--")))
    }

    /// A file of a model as it was last fetched; none if it never was.
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
    /// The server cannot be reached or fails, another process is fetching the same file, the
    /// content does not match the checksum, or the cache cannot be written. What was downloaded
    /// is kept, unless it is wrong.
    pub fn fetch(
        &self,
        hub: &Hub,
        repo: &str,
        file: &str,
        progress: &mut dyn FnMut(u64, Option<u64>),
    ) -> Result<Option<PathBuf>, Error> {
        let folder = self.folder(repo);
        let address = hub.address(repo, BRANCH, file);
        let failed = |problem: String| Error::Download {
            address: address.clone(),
            problem,
        };
        let Some(remote) = hub.describe(repo, file).map_err(failed)? else {
            return Ok(None);
        };
        let snapshot = folder.join("snapshots").join(&remote.commit);
        let (blobs, refs) = (folder.join("blobs"), folder.join("refs"));
        for folder in [&blobs, &refs, &snapshot] {
            fs::create_dir_all(folder).map_err(datasets_spec::Error::io("create", folder))?;
        }
        let blob = blobs.join(remote.checksum.as_str());
        if blob.is_file() {
            let file = File::open(&blob).map_err(datasets_spec::Error::io("open", &blob))?;
            let len = file
                .metadata()
                .map_err(datasets_spec::Error::io("read", &blob))?
                .len();
            remote.checksum.check(file, len, &blob)?;
        } else {
            let part = blobs.join(format!("{}.incomplete", remote.checksum.as_str()));
            let pinned = hub.address(repo, &remote.commit, file);
            download(hub, &pinned, &remote, &part, progress)?;
            fs::rename(&part, &blob)
                .map_err(datasets_spec::Error::io("rename into place", &blob))?;
        }
        let path = snapshot.join(file);
        if !path.is_file() {
            link(&blob, &path).map_err(datasets_spec::Error::io("link", &path))?;
        }
        let current = refs.join(BRANCH);
        replace_file(&current, remote.commit.as_bytes())
            .map_err(datasets_spec::Error::io("write", &current))?;
        Ok(Some(path))
    }
}

/// Fills a file up to the whole content and checks it.
fn download(
    hub: &Hub,
    address: &str,
    remote: &Remote,
    part: &Path,
    progress: &mut dyn FnMut(u64, Option<u64>),
) -> Result<(), Error> {
    let failed = |problem: String| Error::Download {
        address: address.to_owned(),
        problem,
    };
    let mut file = OpenOptions::new()
        .create(true)
        .read(true)
        .write(true)
        .truncate(false)
        .open(part)
        .map_err(datasets_spec::Error::io("create", part))?;
    match file.try_lock() {
        Ok(()) => {}
        Err(TryLockError::WouldBlock) => {
            return Err(failed("another process is downloading it".to_owned()));
        }
        Err(TryLockError::Error(error)) => {
            return Err(datasets_spec::Error::io("lock", part)(error).into());
        }
    }
    let mut done = file
        .seek(SeekFrom::End(0))
        .map_err(datasets_spec::Error::io("read", part))?;
    for attempt in 1.. {
        if remote.len == Some(done) {
            break;
        }
        let before = done;
        let lost = match advance(hub, address, &mut file, &mut done, remote.len, progress) {
            Ok(()) if remote.len.is_none_or(|len| len == done) => break,
            Ok(()) => "the connection ended early".to_owned(),
            Err(Interrupted::Server(problem)) => problem,
            Err(Interrupted::Disk(error)) => {
                return Err(datasets_spec::Error::io("write", part)(error).into());
            }
        };
        // Give up when a connection made no progress.
        if done <= before || attempt == MAX_ATTEMPTS {
            return Err(failed(lost));
        }
    }
    file.sync_all()
        .map_err(datasets_spec::Error::io("sync", part))?;
    file.rewind()
        .map_err(datasets_spec::Error::io("read", part))?;
    let checked = remote.checksum.check(&mut file, done, part);
    if matches!(checked, Err(Error::Checksum { .. })) {
        // Resuming from wrong bytes can never succeed.
        drop(file);
        fs::remove_file(part).map_err(datasets_spec::Error::io("remove", part))?;
    }
    checked
}

enum Interrupted {
    Server(String),
    Disk(io::Error),
}

/// Downloads over one connection; `done` counts the bytes in the file.
fn advance(
    hub: &Hub,
    address: &str,
    file: &mut File,
    done: &mut u64,
    len: Option<u64>,
    progress: &mut dyn FnMut(u64, Option<u64>),
) -> Result<(), Interrupted> {
    let response = hub.get(address, *done).map_err(Interrupted::Server)?;
    let continues = text_of(response.headers(), header::CONTENT_RANGE.as_str())
        .and_then(|range| range.strip_prefix("bytes "))
        .and_then(|range| range.split_once('-'))
        .is_some_and(|(start, _)| start.parse() == Ok(*done));
    match response.status() {
        StatusCode::PARTIAL_CONTENT if continues => {}
        // A server without range requests sends the whole file.
        StatusCode::OK => *done = 0,
        status => {
            return Err(Interrupted::Server(format!("the server answers {status}")));
        }
    }
    file.set_len(*done).map_err(Interrupted::Disk)?;
    file.seek(SeekFrom::Start(*done))
        .map_err(Interrupted::Disk)?;
    let mut body = response.into_body().into_reader();
    let mut buffer = vec![0; BUFFER_LEN];
    loop {
        let count = match body.read(&mut buffer) {
            Ok(0) => return Ok(()),
            Ok(count) => count,
            Err(error) => return Err(Interrupted::Server(error.to_string())),
        };
        file.write_all(&buffer[..count])
            .map_err(Interrupted::Disk)?;
        *done += count as u64;
        if len.is_some_and(|len| *done > len) {
            // Truncate the excess, so that the next run resumes from bytes that may be right.
            *done = 0;
            file.set_len(0).map_err(Interrupted::Disk)?;
            let problem = "the server sends more than it said".to_owned();
            return Err(Interrupted::Server(problem));
        }
        progress(*done, len);
    }
}

/// Creates the entry of a snapshot: a symbolic link, or a hard link where the system does not allow
/// those.
fn link(blob: &Path, path: &Path) -> io::Result<()> {
    // Replace a dangling link, which cleaning the cache can leave behind.
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    #[cfg(unix)]
    {
        let name = blob.file_name().ok_or(io::ErrorKind::InvalidInput)?;
        std::os::unix::fs::symlink(Path::new("../../blobs").join(name), path)
    }
    #[cfg(not(unix))]
    fs::hard_link(blob, path)
}

#[cfg(test)]
pub(crate) mod tests;
