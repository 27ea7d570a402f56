//! Downloads from a small server on this machine.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs;
use std::io::{self, BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::thread;

use sha1::Sha1;
use sha2::{Digest, Sha256};

use super::checksum::hex;
use super::*;

const REPO: &str = "owner/model";
const COMMIT: &str = "0123456789abcdef0123456789abcdef01234567";

/// A file that the test server offers.
#[derive(Clone)]
struct Served {
    content: Vec<u8>,
    etag: String,
    /// Number of body bytes after which the server closes the connection.
    cut: Option<usize>,
    /// Whether the server supports range requests for the file.
    ranges: bool,
}

impl Served {
    fn large(content: &[u8]) -> Self {
        Self {
            content: content.to_vec(),
            etag: hex(&Sha256::digest(content)),
            cut: None,
            ranges: true,
        }
    }

    fn small(content: &[u8]) -> Self {
        let head = format!("blob {}\0", content.len());
        let hash = Sha1::new().chain_update(head).chain_update(content);
        Self {
            etag: hex(&hash.finalize()),
            ..Self::large(content)
        }
    }
}

/// Requests a server has answered: method, path and range.
type Log = Arc<Mutex<Vec<String>>>;

/// Starts a server that ends with the test process. Like the public server, it redirects requests for large files to
/// another server, and requests for small files to another path of its own.
fn serve(files: BTreeMap<&'static str, Served>) -> (Hub, Log) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = listener.local_addr().expect("bound");
    let log = Log::default();
    let answered = log.clone();
    thread::spawn(move || {
        for stream in listener.incoming() {
            // Ignore clients that hang up.
            let _served = stream.and_then(|stream| answer(stream, &files, &answered));
        }
    });
    (Hub::at(&format!("http://{address}/")), log)
}

fn answer(
    mut stream: TcpStream,
    files: &BTreeMap<&'static str, Served>,
    log: &Log,
) -> io::Result<()> {
    let mut lines = BufReader::new(stream.try_clone()?).lines();
    let first = lines.next().unwrap_or(Ok(String::new()))?;
    let mut range = None;
    for line in lines {
        let line = line?.to_lowercase();
        if line.is_empty() {
            break;
        }
        if let Some(from) = line.strip_prefix("range: bytes=") {
            range = from.trim_end_matches('-').parse::<usize>().ok();
        }
    }
    let mut words = first.split(' ');
    let (method, path) = (words.next().unwrap_or(""), words.next().unwrap_or(""));
    let from = range.map_or(String::new(), |from| from.to_string());
    let entry = format!("{method} {path} {from}");
    log.lock().expect("whole").push(entry.trim_end().to_owned());

    let name = path.rsplit('/').next().unwrap_or_default();
    let Some(served) = files.get(name) else {
        return stream.write_all(
            b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\nConnection: close\r\n\r\n",
        );
    };
    let (etag, len) = (&served.etag, served.content.len());
    let (head, body) = if path.starts_with("/elsewhere/") {
        let from = range.filter(|_| served.ranges);
        let body = &served.content[from.unwrap_or(0)..];
        let (status, last, left) = ("206 Partial Content", len - 1, body.len());
        let status = match from {
            Some(from) => format!("{status}\r\nContent-Range: bytes {from}-{last}/{len}"),
            None => "200 OK".to_owned(),
        };
        let head = format!("{status}\r\nContent-Length: {left}\r\nETag: W/\"{etag}\"");
        (head, body)
    } else {
        // Large files lie on another server, so the redirect names a whole URL.
        let place = match etag.len() {
            64 => format!(
                "X-Linked-Etag: \"{etag}\"\r\nX-Linked-Size: {len}\r\nLocation: http://{}",
                stream.local_addr()?
            ),
            _ => "Location: ".to_owned(),
        };
        let head = format!("302 Found\r\nContent-Length: 0\r\n{place}/elsewhere/{name}");
        (head, &[][..])
    };
    let head = format!("HTTP/1.1 {head}\r\nX-Repo-Commit: {COMMIT}\r\nConnection: close\r\n\r\n");
    stream.write_all(head.as_bytes())?;
    if method == "GET" {
        let cut = served.cut.unwrap_or(body.len()).min(body.len());
        stream.write_all(&body[..cut])?;
    }
    Ok(())
}

fn content(len: usize) -> Vec<u8> {
    (0..len).map(|i| (i * i / 7) as u8).collect()
}

fn cache() -> (tempfile::TempDir, HubCache) {
    let dir = tempfile::tempdir().expect("temporary folder");
    let cache = HubCache::new(dir.path());
    (dir, cache)
}

fn serve_model(served: Served) -> (Hub, Log) {
    serve(BTreeMap::from([("model.safetensors", served)]))
}

fn fetched(cache: &HubCache, hub: &Hub, file: &str) -> PathBuf {
    fetch(cache, hub, file).expect("fetched").expect("there")
}

fn fetch(cache: &HubCache, hub: &Hub, file: &str) -> Result<Option<PathBuf>, Error> {
    cache.fetch(hub, REPO, file, &mut |_, _| {})
}

/// Writes a partial file, as an interrupted run leaves it.
fn put_part(cache: &HubCache, served: &Served, bytes: &[u8]) -> PathBuf {
    let blobs = cache.folder(REPO).join("blobs");
    fs::create_dir_all(&blobs).expect("created");
    let part = blobs.join(format!("{}.incomplete", served.etag));
    fs::write(&part, bytes).expect("written");
    part
}

#[test]
fn files_are_fetched_once_and_found_afterwards() {
    let (_dir, cache) = cache();
    let (weights, config) = (content(1000), b"{}".to_vec());
    let (hub, log) = serve(BTreeMap::from([
        ("model.safetensors", Served::large(&weights)),
        ("tokenizer.json", Served::small(&config)),
    ]));
    assert_eq!(cache.find(REPO, "model.safetensors"), None);
    let mut seen = Vec::new();
    let path = cache
        .fetch(&hub, REPO, "model.safetensors", &mut |done, len| {
            seen.push((done, len))
        })
        .expect("fetched")
        .expect("there");
    assert_eq!(seen.last(), Some(&(1000, Some(1000))));
    assert_eq!(cache.find(REPO, "model.safetensors"), Some(path.clone()));
    assert_eq!(read_checked(&path).expect("whole"), weights);
    let path = fetched(&cache, &hub, "tokenizer.json");
    assert_eq!(read_checked(&path).expect("whole"), config);
    assert_eq!(fetch(&cache, &hub, "missing").expect("asked"), None);

    // Files that exist are not downloaded again.
    log.lock().expect("whole").clear();
    fetch(&cache, &hub, "model.safetensors").expect("there");
    let asked = log.lock().expect("whole").clone();
    assert_eq!(asked, ["HEAD /owner/model/resolve/main/model.safetensors"]);
}

#[test]
fn an_interrupted_download_goes_on_where_it_stopped() {
    let (_dir, cache) = cache();
    let weights = content(1000);
    let served = Served {
        cut: Some(400),
        ..Served::large(&weights)
    };
    let part = put_part(&cache, &served, &weights[..100]);
    let (hub, log) = serve_model(served);
    let path = fetched(&cache, &hub, "model.safetensors");
    assert_eq!(read_checked(&path).expect("whole"), weights);
    assert!(!part.exists());
    let log = log.lock().expect("whole");
    let ranges: Vec<&str> = log
        .iter()
        .filter_map(|entry| entry.strip_prefix("GET /elsewhere/model.safetensors "))
        .collect();
    assert_eq!(ranges, ["100", "500", "900"]);
}

#[test]
fn a_server_that_cannot_continue_starts_over() {
    let (_dir, cache) = cache();
    let weights = content(1000);
    let served = Served {
        ranges: false,
        ..Served::large(&weights)
    };
    put_part(&cache, &served, &[7; 300]);
    let (hub, _) = serve_model(served);
    let path = fetched(&cache, &hub, "model.safetensors");
    assert_eq!(read_checked(&path).expect("whole"), weights);
}

#[test]
fn a_server_that_brings_nothing_more_is_an_error_and_the_part_is_kept() {
    let (_dir, cache) = cache();
    let served = Served {
        cut: Some(0),
        ..Served::large(&content(1000))
    };
    let part = put_part(&cache, &served, &content(1000)[..10]);
    let (hub, _) = serve_model(served);
    let error = fetch(&cache, &hub, "model.safetensors").expect_err("cut off");
    assert!(error.to_string().starts_with("cannot download"), "{error}");
    assert_eq!(fs::read(&part).expect("kept").len(), 10);
    assert_eq!(cache.find(REPO, "model.safetensors"), None);
}

#[test]
fn wrong_content_is_refused_wherever_it_comes_from() {
    let (_dir, cache) = cache();
    let weights = content(1000);
    for served in [Served::large(&weights), Served::small(&weights)] {
        let etag = served.etag.clone();
        let lying = Served {
            content: content(999).into_iter().chain([0]).collect(),
            ..served
        };
        let (hub, _) = serve_model(lying);
        let error = fetch(&cache, &hub, "model.safetensors").expect_err("wrong");
        assert!(matches!(error, Error::Checksum { .. }), "{error}");
        assert!(error.to_string().contains(&etag), "{error}");
        assert_eq!(cache.find(REPO, "model.safetensors"), None);
        let left = fs::read_dir(cache.folder(REPO).join("blobs")).expect("listed");
        assert_eq!(left.count(), 0, "wrong bytes are not continued");
    }

    // Reading detects content that was damaged later.
    let (hub, _) = serve_model(Served::large(&weights));
    let path = fetched(&cache, &hub, "model.safetensors");
    fs::write(&path, &weights[1..]).expect("written through the link");
    assert!(matches!(read_checked(&path), Err(Error::Checksum { .. })));

    let nameless = Served {
        etag: "abc".to_owned(),
        ..Served::large(&weights)
    };
    let (hub, _) = serve_model(nameless);
    let error = fetch(&cache, &hub, "model.safetensors").expect_err("no checksum");
    assert!(error.to_string().starts_with("cannot download"), "{error}");
}

#[test]
fn the_environment_names_the_cache() {
    let cache = |set: &[(&str, &str)]| {
        HubCache::from_variables(|name| {
            let (_, value) = set.iter().find(|(key, _)| *key == name)?;
            Some(OsString::from(value))
        })
    };
    let all = [
        ("HF_HUB_CACHE", "a"),
        ("HF_HOME", "b"),
        ("XDG_CACHE_HOME", "c"),
        ("HOME", "d"),
    ];
    for (from, root) in [
        "a",
        "b/hub",
        "c/huggingface/hub",
        "d/.cache/huggingface/hub",
    ]
    .into_iter()
    .enumerate()
    {
        assert_eq!(cache(&all[from..]), Some(HubCache::new(root)));
    }
    assert_eq!(cache(&[("HF_HOME", "")]), None);
    let folder = HubCache::new("hub").folder("openai/clip");
    assert_eq!(folder, Path::new("hub/models--openai--clip"));
}
