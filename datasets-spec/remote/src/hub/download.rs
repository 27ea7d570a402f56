//! Downloads that are resumed and checked.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;

use ureq::http::{HeaderMap, StatusCode, header};

use super::checksum::{Checksum, Wanted};
use super::client::{BRANCH, Hub, MAX_REDIRECTS, is_commit, redirect, text_of};
use super::error::Error;

/// Maximum number of connections per download. A connection without progress ends it earlier.
const MAX_ATTEMPTS: u32 = 20;
const BUFFER_LEN: usize = 1 << 18;

pub(super) struct Remote {
    pub(super) content: Wanted,
    pub(super) commit: String,
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
        if !is_commit(commit) {
            return Err(format!("the server names no commit but {commit:?}"));
        }
        let content = Wanted {
            checksum: Checksum::parse(checksum)
                .ok_or_else(|| format!("the server names no checksum but {checksum:?}"))?,
            len: len.and_then(|len| len.parse().ok()),
        };
        Ok(Self {
            content,
            commit: commit.to_owned(),
        })
    }
}

/// Metadata of a file; `None` if the server has no such file.
pub(super) fn describe(hub: &Hub, repo: &str, file: &str) -> Result<Option<Remote>, String> {
    let mut address = hub.address(repo, BRANCH, file);
    for _ in 0..=MAX_REDIRECTS {
        let response = hub.head(&address)?;
        let status = response.status();
        let headers = response.headers();
        // The redirect to a large file carries its metadata. For small or moved files, the target on the same server
        // carries it.
        let is_described = headers.contains_key("x-linked-etag");
        let is_here =
            text_of(headers, header::LOCATION.as_str()).is_some_and(|place| place.starts_with('/'));
        if is_here
            && !is_described
            && let Some(place) = redirect(&address, &response)
        {
            address = place;
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

/// Downloads the missing rest of a file and checks its checksum.
pub(super) fn download(
    hub: &Hub,
    address: &str,
    wanted: &Wanted,
    part: &Path,
    progress: &mut dyn FnMut(u64, Option<u64>),
) -> Result<(), Error> {
    let failed = |problem: &str| Error::download(address, problem);
    let mut file = OpenOptions::new()
        .create(true)
        .read(true)
        .write(true)
        .truncate(false)
        .open(part)
        .map_err(Error::io("create", part))?;
    match file.try_lock() {
        Ok(()) => {}
        Err(TryLockError::WouldBlock) => {
            return Err(failed("another process is downloading it"));
        }
        Err(TryLockError::Error(error)) => {
            return Err(Error::io("lock", part)(error));
        }
    }
    let mut done = file
        .seek(SeekFrom::End(0))
        .map_err(Error::io("read", part))?;
    // The file is longer than expected, so it is another file.
    if wanted.len.is_some_and(|len| done > len) {
        done = 0;
        file.set_len(0).map_err(Error::io("write", part))?;
    }
    for attempt in 1.. {
        if wanted.len == Some(done) {
            break;
        }
        let before = done;
        let lost = match advance(hub, address, &mut file, &mut done, wanted.len, progress) {
            Ok(()) if wanted.len.is_none_or(|len| len == done) => break,
            Ok(()) => "the connection ended early".to_owned(),
            Err(Interrupted::Server(problem)) => problem,
            Err(Interrupted::Disk(error)) => {
                return Err(Error::io("write", part)(error));
            }
        };
        // Give up when a connection made no progress.
        if done <= before || attempt == MAX_ATTEMPTS {
            return Err(failed(&lost));
        }
    }
    file.sync_all().map_err(Error::io("sync", part))?;
    file.rewind().map_err(Error::io("read", part))?;
    let checked = wanted.checksum.check(&mut file, done, part);
    if matches!(checked, Err(Error::Checksum { .. })) {
        // Resuming from wrong bytes can never succeed.
        drop(file);
        fs::remove_file(part).map_err(Error::io("remove", part))?;
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
            // Discard all bytes: the next run starts from the beginning.
            *done = 0;
            file.set_len(0).map_err(Interrupted::Disk)?;
            let problem = "the server sends more than it said".to_owned();
            return Err(Interrupted::Server(problem));
        }
        progress(*done, len);
    }
}
