//! A hub for tests: it answers the requests that publish and pull repos, and has a storage on another port.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::ops::Deref;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};
use sha1::Sha1;
use sha2::{Digest, Sha256};

use crate::util::{Folder, Ran, json_lines};

/// The token with all rights.
pub(crate) const TOKEN: &str = "hf_the_right_one";
/// Number of bytes of a part; larger files are uploaded in parts.
const CHUNK: usize = 20_000;
/// Entries on a page of a listing.
const PAGE: usize = 3;

/// A file of a commit.
#[derive(Clone)]
enum Stored {
    Regular(Vec<u8>),
    /// In the storage, by its SHA-256.
    Large(String),
}

type Files = BTreeMap<String, Stored>;

/// A request that was answered.
pub(crate) struct Call {
    /// Method and path.
    pub(crate) line: String,
    pub(crate) token: Option<String>,
    pub(crate) is_storage: bool,
}

/// Contents of the hub, and its simulated failures.
#[derive(Default)]
pub(crate) struct State {
    /// Addresses of the hub and of its storage.
    addresses: [String; 2],
    /// Commits of each repo, the oldest first.
    repos: BTreeMap<String, Vec<Files>>,
    private: BTreeSet<String>,
    objects: BTreeMap<String, Vec<u8>>,
    parts: BTreeMap<(String, usize), Vec<u8>>,
    pub(crate) calls: Vec<Call>,
    /// Uploads after which the storage closes the connection.
    pub(crate) puts_left: Option<usize>,
    /// Bytes of a download after which the storage closes the connection.
    pub(crate) cut: Option<usize>,
    /// Whether the storage sends wrong bytes.
    pub(crate) is_tampered: bool,
}

impl State {
    /// The content of a file in the newest commit of a repo.
    pub(crate) fn read(&self, repo: &str, path: &str) -> Option<Vec<u8>> {
        match self.repos.get(repo)?.last()?.get(path)? {
            Stored::Regular(bytes) => Some(bytes.clone()),
            Stored::Large(oid) => self.objects.get(oid).cloned(),
        }
    }

    /// The paths of the newest commit of a repo.
    pub(crate) fn paths(&self, repo: &str) -> Vec<String> {
        let newest = self.repos.get(repo).and_then(|commits| commits.last());
        newest.map_or(Vec::new(), |files| files.keys().cloned().collect())
    }

    /// Makes a commit with a changed file, as another user would.
    pub(crate) fn write(&mut self, repo: &str, path: &str, bytes: &[u8]) {
        let commits = self.repos.entry(repo.to_owned()).or_default();
        let mut files = commits.last().cloned().unwrap_or_default();
        files.insert(path.to_owned(), Stored::Regular(bytes.to_vec()));
        commits.push(files);
    }

    /// Clears the record of requests, and returns the paths of those with this method.
    pub(crate) fn take_calls(&mut self, method: &str) -> Vec<String> {
        let calls = std::mem::take(&mut self.calls).into_iter();
        let path = |call: Call| Some(call.line.strip_prefix(method)?.trim().to_owned());
        calls.filter_map(path).collect()
    }
}

/// A hub that runs until the test process ends, and a folder for its test.
pub(crate) struct Hub {
    address: String,
    home: Folder,
    folder: Folder,
    state: Arc<Mutex<State>>,
}

impl Deref for Hub {
    type Target = Folder;

    fn deref(&self) -> &Folder {
        &self.folder
    }
}

impl Hub {
    pub(crate) fn open() -> Self {
        let state = Arc::<Mutex<State>>::default();
        let addresses = [false, true].map(|is_storage| {
            let state = Arc::clone(&state);
            serve(move |request| {
                let mut state = state.lock().expect("no thread panicked");
                state.calls.push(Call {
                    line: format!("{} {}", request.method, request.target),
                    token: request.token.clone(),
                    is_storage,
                });
                if !is_storage {
                    return Some(called(request, &mut state));
                }
                let mut reply = stored(request, &mut state)?;
                reply.cut = state.cut.unwrap_or(usize::MAX);
                Some(reply)
            })
        });
        state.lock().expect("no request yet").addresses = addresses.clone();
        let [address, _] = addresses;
        Self {
            address,
            home: Folder::empty(),
            folder: Folder::empty(),
            state,
        }
    }

    pub(crate) fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().expect("no thread panicked")
    }

    /// Path at which the tools of the hub keep a token.
    pub(crate) fn token_file(&self) -> PathBuf {
        self.home.path("token")
    }

    /// Runs a command line with this hub and a token.
    pub(crate) fn ran(&self, token: Option<&str>, line: &str) -> Ran {
        let mut command = self.command(line);
        for name in ["https_proxy", "all_proxy", "hf_token", "hf_token_path"] {
            command.env_remove(name).env_remove(name.to_uppercase());
        }
        command
            .env("HF_ENDPOINT", &self.address)
            .env("HF_HOME", self.home.path(""));
        if let Some(token) = token {
            command.env("HF_TOKEN", token);
        }
        command.output().expect("stance starts").into()
    }
}

pub(crate) struct Request {
    pub(crate) method: String,
    pub(crate) target: String,
    token: Option<String>,
    /// The requested bytes, as FIRST-LAST or FIRST-.
    pub(crate) range: Option<String>,
    body: Vec<u8>,
}

impl Request {
    pub(crate) fn read(stream: &TcpStream) -> std::io::Result<Self> {
        let mut reader = BufReader::new(stream.try_clone()?);
        let mut first = String::new();
        reader.read_line(&mut first)?;
        let (mut token, mut range, mut length) = (None, None, 0);
        loop {
            let mut line = String::new();
            reader.read_line(&mut line)?;
            let line = line.trim();
            let Some((name, value)) = line.split_once(": ") else {
                break;
            };
            match name.to_lowercase().as_str() {
                "authorization" => token = Some(value.replace("Bearer ", "")),
                "content-length" => length = value.parse().unwrap_or(0),
                "range" => range = Some(value.replace("bytes=", "")),
                _ => {}
            }
        }
        let mut body = vec![0; length];
        reader.read_exact(&mut body)?;
        let mut words = first.split_whitespace().map(str::to_owned);
        Ok(Self {
            method: words.next().unwrap_or_default(),
            target: words.next().unwrap_or_default(),
            token,
            range,
            body,
        })
    }

    /// Offset of the first requested byte.
    fn start(&self) -> usize {
        let range = self.range.as_deref().unwrap_or_default();
        range.trim_end_matches('-').parse().unwrap_or(0)
    }

    fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or(Value::Null)
    }
}

pub(crate) struct Reply {
    status: &'static str,
    /// Further header lines; may be empty.
    pub(crate) header: String,
    body: Vec<u8>,
    /// Bytes of the body after which the connection is closed.
    pub(crate) cut: usize,
}

impl Reply {
    pub(crate) fn new(status: &'static str, body: impl Into<Vec<u8>>) -> Self {
        Self {
            status,
            header: String::new(),
            body: body.into(),
            cut: usize::MAX,
        }
    }

    fn json(document: &Value) -> Self {
        Self::new("200 OK", document.to_string())
    }

    fn refused(status: &'static str, code: &str, problem: &str) -> Self {
        Self {
            header: format!("X-Error-Code: {code}\r\n"),
            ..Self::new(status, json!({ "error": problem }).to_string())
        }
    }

    /// Replies with the bytes from an offset on.
    fn bytes(bytes: &[u8], from: usize) -> Self {
        let mut reply = Self::new("200 OK", &bytes[from..]);
        if from > 0 {
            let (last, all) = (bytes.len() - 1, bytes.len());
            reply.status = "206 Partial Content";
            reply.header = format!("Content-Range: bytes {from}-{last}/{all}\r\n");
        }
        reply
    }
}

/// Answers requests on a port of this machine until the test process ends, and returns the address. Without a reply the
/// connection is closed.
pub(crate) fn serve(reply: impl Fn(&Request) -> Option<Reply> + Send + Sync + 'static) -> String {
    let reply = Arc::new(reply);
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = listener.local_addr().expect("bound");
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            // Clients read several ranges at once.
            let reply = Arc::clone(&reply);
            std::thread::spawn(move || answer(stream, &*reply));
        }
    });
    format!("http://{address}")
}

/// Answers one request.
fn answer(mut stream: TcpStream, reply: impl Fn(&Request) -> Option<Reply>) -> std::io::Result<()> {
    let Some(reply) = reply(&Request::read(&stream)?) else {
        return Ok(());
    };
    let (status, header, length) = (reply.status, reply.header, reply.body.len());
    let head = format!(
        "HTTP/1.1 {status}\r\n{header}Content-Length: {length}\r\nConnection: close\r\n\r\n"
    );
    stream.write_all(head.as_bytes())?;
    stream.write_all(&reply.body[..length.min(reply.cut)])
}

/// Reply of the storage, which holds objects and parts of them by their SHA-256; `None` closes the connection.
fn stored(request: &Request, state: &mut State) -> Option<Reply> {
    let parts: Vec<&str> = request.target.split('/').skip(1).collect();
    match (request.method.as_str(), parts.as_slice()) {
        ("PUT", ["put", oid, part @ ..]) => {
            if let Some(left) = &mut state.puts_left {
                *left = left.checked_sub(1)?;
            }
            let (oid, body) = ((*oid).to_owned(), request.body.clone());
            match part {
                [number] => {
                    let number = number.parse().expect("a number");
                    state.parts.insert((oid, number), body);
                }
                _ => drop(state.objects.insert(oid, body)),
            }
            Some(Reply {
                header: "ETag: \"of-this\"\r\n".to_owned(),
                ..Reply::new("200 OK", "")
            })
        }
        ("GET", ["get", oid]) => {
            let mut bytes = state.objects.get(*oid)?.clone();
            if state.is_tampered {
                bytes[0] ^= 1;
            }
            Some(Reply::bytes(&bytes, request.start()))
        }
        _ => Some(Reply::new("404 Not Found", "")),
    }
}

/// Reply of the hub's API.
fn called(request: &Request, state: &mut State) -> Reply {
    if request.token.as_deref().is_some_and(|token| token != TOKEN) {
        let problem = "Invalid credentials in Authorization header";
        return Reply::refused("401 Unauthorized", "", problem);
    }
    if request.token.is_none() && request.method != "GET" {
        return Reply::refused("401 Unauthorized", "", "a token is needed");
    }
    let path = request.target.split('?').next().unwrap_or_default();
    let parts: Vec<&str> = path.split('/').skip(1).collect();
    match (request.method.as_str(), parts.as_slice()) {
        ("POST", ["api", "repos", "create"]) => create(&request.json(), state),
        (_, ["api", kind, owner, name, what, of]) => {
            let repo = format!("{kind}/{owner}/{name}");
            let is_hidden = request.token.is_none() && state.private.contains(&repo);
            if is_hidden || !state.repos.contains_key(&repo) {
                return Reply::refused("404 Not Found", "RepoNotFound", "no such repo");
            }
            match *what {
                "revision" => revision(&repo, of, state),
                "tree" => tree(request, &repo, state),
                "preupload" => preupload(&request.json()),
                "commit" => commit(&request.body, &repo, state),
                _ => Reply::new("404 Not Found", ""),
            }
        }
        ("POST", [.., "info", "lfs", "objects", "batch"]) => batch(&request.json(), state),
        ("POST", ["verify"]) => {
            let asked = request.json();
            let object = state.objects.get(asked["oid"].as_str().unwrap_or_default());
            match object.is_some_and(|object| asked["size"] == object.len()) {
                true => Reply::new("200 OK", "fine"),
                false => Reply::refused("400 Bad Request", "", "not as it was said"),
            }
        }
        ("POST", ["complete"]) => complete(&request.json(), state),
        ("GET", ["datasets", owner, name, "resolve", _, path @ ..]) => {
            let repo = format!("datasets/{owner}/{name}");
            resolve(request, &repo, &path.join("/"), state)
        }
        ("GET", [owner, name, "resolve", _, path @ ..]) => {
            let repo = format!("models/{owner}/{name}");
            resolve(request, &repo, &path.join("/"), state)
        }
        _ => Reply::new("404 Not Found", ""),
    }
}

fn create(asked: &Value, state: &mut State) -> Reply {
    let word = |field: &str| asked[field].as_str().unwrap_or_default().to_owned();
    let [kind, owner, name] = ["type", "organization", "name"].map(word);
    let repo = format!("{kind}s/{owner}/{name}");
    if state.repos.contains_key(&repo) {
        return Reply::refused("409 Conflict", "", "it exists");
    }
    if word("visibility") == "private" {
        state.private.insert(repo.clone());
    }
    state.write(&repo, ".gitattributes", b"*.parquet filter=lfs\n");
    Reply::json(&json!({ "url": repo }))
}

/// Name of the commit with this index.
fn commit_name(index: usize) -> String {
    format!("{:040x}", index + 1)
}

fn revision(repo: &str, revision: &str, state: &State) -> Reply {
    let commits = &state.repos[repo];
    let newest = commit_name(commits.len() - 1);
    match revision == "main" || revision == newest {
        true => Reply::json(&json!({ "sha": newest, "private": state.private.contains(repo) })),
        false => Reply::refused("404 Not Found", "RevisionNotFound", "no such revision"),
    }
}

fn git_name(bytes: &[u8]) -> String {
    let head = format!("blob {}\0", bytes.len());
    let hash = Sha1::new().chain_update(head).chain_update(bytes);
    hex(&hash.finalize())
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// A page of the files of the newest commit.
fn tree(request: &Request, repo: &str, state: &State) -> Reply {
    let files = state.repos[repo].last().expect("a commit");
    let start = request.target.split("cursor=").nth(1);
    let start: usize = start.map_or(0, |start| start.parse().expect("a number"));
    let page = files.iter().skip(start).take(PAGE);
    let mut entries: Vec<Value> = page
        .map(|(path, stored)| match stored {
            Stored::Regular(bytes) => {
                json!({ "type": "file", "path": path, "size": bytes.len(), "oid": git_name(bytes) })
            }
            Stored::Large(oid) => {
                let size = state.objects[oid].len();
                let lfs = json!({ "oid": oid, "size": size, "pointerSize": 130 });
                let name = git_name(b"a pointer");
                json!({ "type": "file", "path": path, "size": size, "oid": name, "lfs": lfs })
            }
        })
        .collect();
    entries.push(json!({ "type": "directory", "path": "data", "size": 0, "oid": git_name(b"") }));
    let mut reply = Reply::json(&entries.into());
    if files.len() > start + PAGE {
        let path = request.target.split('?').next().unwrap_or_default();
        let (address, next) = (&state.addresses[0], start + PAGE);
        let url = format!("{address}{path}?recursive=true&cursor={next}");
        reply.header = format!("Link: <{url}>; rel=\"next\"\r\n");
    }
    reply
}

fn is_large(path: &str) -> bool {
    path.ends_with(".parquet") || path.ends_with(".safetensors")
}

fn preupload(asked: &Value) -> Reply {
    let files = asked["files"].as_array().expect("files").iter();
    let modes = files.map(|file| {
        let path = file["path"].as_str().expect("a path");
        let sample = STANDARD.decode(file["sample"].as_str().expect("a sample"));
        assert!(sample.expect("base64").len() <= 512);
        let mode = if is_large(path) { "lfs" } else { "regular" };
        json!({ "path": path, "uploadMode": mode, "shouldIgnore": false })
    });
    Reply::json(&json!({ "files": Vec::from_iter(modes) }))
}

fn batch(asked: &Value, state: &State) -> Reply {
    let [hub, storage] = &state.addresses;
    let objects = asked["objects"].as_array().expect("objects").iter();
    let answers = objects.map(|object| {
        let oid = object["oid"].as_str().expect("an oid");
        let size = object["size"].as_u64().expect("a size") as usize;
        let mut answer = object.clone();
        if state.objects.contains_key(oid) {
            return answer;
        }
        let place = format!("{storage}/put/{oid}");
        let upload = match size > CHUNK {
            false => json!({ "href": place }),
            true => {
                let parts = (1..=size.div_ceil(CHUNK)).map(|part| {
                    let place = format!("{place}/{part}");
                    (format!("{part:05}"), Value::from(place))
                });
                let mut header: serde_json::Map<String, Value> = parts.collect();
                header.insert("chunk_size".to_owned(), CHUNK.to_string().into());
                json!({ "href": format!("{hub}/complete"), "header": header })
            }
        };
        answer["actions"] =
            json!({ "upload": upload, "verify": { "href": format!("{hub}/verify") } });
        answer
    });
    Reply::json(&json!({ "objects": Vec::from_iter(answers) }))
}

fn complete(asked: &Value, state: &mut State) -> Reply {
    let oid = asked["oid"].as_str().expect("an oid");
    let mut bytes = Vec::new();
    for part in asked["parts"].as_array().expect("parts") {
        assert_eq!(part["etag"], "\"of-this\"");
        let number = part["partNumber"].as_u64().expect("a number") as usize;
        bytes.extend(&state.parts[&(oid.to_owned(), number)]);
    }
    state.objects.insert(oid.to_owned(), bytes);
    Reply::json(&json!({}))
}

fn commit(lines: &[u8], repo: &str, state: &mut State) -> Reply {
    let text = std::str::from_utf8(lines).expect("text");
    let commits = &state.repos[repo];
    let mut files = commits.last().cloned().unwrap_or_default();
    for line in json_lines(text) {
        let value = &line["value"];
        let path = value["path"].as_str().unwrap_or_default().to_owned();
        match line["key"].as_str().expect("a key") {
            "header" => {
                let parent = value["parentCommit"].as_str();
                if parent.is_some_and(|parent| parent != commit_name(commits.len() - 1)) {
                    return Reply::refused("412 Precondition Failed", "", "another commit");
                }
            }
            "file" => {
                let bytes = STANDARD.decode(value["content"].as_str().expect("content"));
                files.insert(path, Stored::Regular(bytes.expect("base64")));
            }
            "lfsFile" => {
                let oid = value["oid"].as_str().expect("an oid").to_owned();
                let object = state.objects.get(&oid).expect("uploaded before");
                assert_eq!(hex(&Sha256::digest(object)), oid, "{path}");
                files.insert(path, Stored::Large(oid));
            }
            "deletedFile" => drop(files.remove(&path).expect("it is there")),
            key => panic!("{key}"),
        }
    }
    let name = commit_name(commits.len());
    let commits = state.repos.get_mut(repo).expect("it is there");
    commits.push(files);
    Reply::json(&json!({ "commitOid": name, "commitUrl": format!("{repo}/commit/{name}") }))
}

fn resolve(request: &Request, repo: &str, path: &str, state: &State) -> Reply {
    let is_hidden = request.token.is_none() && state.private.contains(repo);
    let files = state.repos.get(repo).filter(|_| !is_hidden);
    match files.and_then(|commits| commits.last()?.get(path)) {
        Some(Stored::Regular(bytes)) => Reply::bytes(bytes, request.start()),
        Some(Stored::Large(oid)) => Reply {
            header: format!("Location: {}/get/{oid}\r\n", state.addresses[1]),
            ..Reply::new("302 Found", "")
        },
        None => Reply::new("404 Not Found", ""),
    }
}
