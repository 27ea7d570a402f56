//! Requests to the hub, and to the storage that it names.

use std::ffi::OsString;
use std::fmt;
use std::fs;
use std::io::{self, Read};
use std::path::PathBuf;
use std::time::Duration;

use serde_json::Value;
use ureq::http::{HeaderMap, Response, StatusCode, header};
use ureq::{Agent, Body, Proxy, RequestBuilder, SendBody};

use super::error::Error;

/// The public server. The responses of other servers may hold its address instead of their own.
const ENDPOINT: &str = "https://huggingface.co";
/// The branch used if none is named.
pub(super) const BRANCH: &str = "main";
pub(super) const MAX_REDIRECTS: u32 = 5;
const CONNECT_TIMEOUT: Duration = Duration::from_secs(30);
const READ_TIMEOUT: Duration = Duration::from_secs(60);
/// Timeout of a commit of many files, or of the assembly of a large file.
const COMMIT_TIMEOUT: Duration = Duration::from_secs(600);
/// Maximum bytes of an answer: a page of a listing, or the addresses of a thousand parts.
const MAX_ANSWER_LEN: u64 = 64 << 20;
/// Characters of a server's message that an error repeats.
const MAX_MESSAGE_LEN: usize = 300;
/// Content type of most calls.
pub(super) const JSON: &str = "application/json";

/// A client of a server of repos: the Hugging Face hub, or another server with the same interface.
#[derive(Clone)]
pub struct Hub {
    endpoint: String,
    token: Option<String>,
    agent: Agent,
}

impl fmt::Debug for Hub {
    /// Leaves out the token.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Hub")
            .field("endpoint", &self.endpoint)
            .finish_non_exhaustive()
    }
}

impl Hub {
    /// The server at `endpoint`, reached directly and without a token.
    pub fn at(endpoint: &str) -> Self {
        Self::through(endpoint, None)
    }

    /// The server, and the proxy to it, that the variables `HF_ENDPOINT`, `HTTPS_PROXY` and `ALL_PROXY` name; without
    /// them the public server, reached directly. `variable` returns the value of an environment variable. No token is
    /// set, because a wrong token would be refused even where none is needed.
    ///
    /// # Errors
    /// The address of the proxy is malformed.
    pub fn from_variables(variable: impl Fn(&str) -> Option<OsString>) -> Result<Self, Error> {
        let text = |name: &str| {
            variable(name)
                .map(|value| value.to_string_lossy().into_owned())
                .filter(|value| !value.is_empty())
        };
        let endpoint = text("HF_ENDPOINT").unwrap_or_else(|| ENDPOINT.to_owned());
        let proxy = ["HTTPS_PROXY", "https_proxy", "ALL_PROXY", "all_proxy"]
            .into_iter()
            .find_map(|variable| Some((variable, text(variable)?)))
            .map(|(variable, address)| {
                Proxy::new(&address).map_err(|error| {
                    Error::hub(variable, format!("{variable} names no proxy ({error})"))
                })
            })
            .transpose()?;
        Ok(Self::through(&endpoint, proxy))
    }

    /// The same server with a token. The token is sent only to this server, not to the storage that it names or to
    /// redirect targets.
    #[must_use]
    pub fn with_token(self, token: Option<String>) -> Self {
        Self { token, ..self }
    }

    fn through(endpoint: &str, proxy: Option<Proxy>) -> Self {
        let config = Agent::config_builder()
            .proxy(proxy)
            .http_status_as_error(false)
            .max_redirects(0)
            .max_redirects_will_error(false)
            .timeout_connect(Some(CONNECT_TIMEOUT))
            .timeout_recv_response(Some(READ_TIMEOUT))
            .timeout_per_read(Some(READ_TIMEOUT))
            .user_agent(concat!("stance/", env!("CARGO_PKG_VERSION")))
            .build();
        Self {
            endpoint: endpoint.trim_end_matches('/').to_owned(),
            token: None,
            agent: config.into(),
        }
    }

    /// The address of the server.
    pub fn endpoint(&self) -> &str {
        &self.endpoint
    }

    /// Checks that there is a token.
    ///
    /// # Errors
    /// There is no token.
    pub fn check_token(&self) -> Result<(), Error> {
        if self.has_token() {
            return Ok(());
        }
        let endpoint = &self.endpoint;
        let problem = format!(
            "no token of the hub is known; make one with the right to write at {endpoint}/settings/tokens, and set \
             HF_TOKEN or run `hf auth login`"
        );
        Err(Error::hub(endpoint, problem))
    }

    pub(super) fn has_token(&self) -> bool {
        self.token.is_some()
    }

    /// URL at which a file of a repo is downloaded. `repo` is its path on the server.
    pub(super) fn address(&self, repo: &str, revision: &str, file: &str) -> String {
        let (revision, file) = (quoted(revision, ""), quoted(file, "/"));
        format!("{}/{repo}/resolve/{revision}/{file}", self.endpoint)
    }

    /// The address in a response, rewritten to this server if it names the public one.
    pub(super) fn here(&self, address: &str) -> String {
        match address.strip_prefix(ENDPOINT) {
            Some(rest) => format!("{}{rest}", self.endpoint),
            None => address.to_owned(),
        }
    }

    /// Whether an address is on this server, which may know the token.
    fn is_own(&self, address: &str) -> bool {
        origin_of(address) == origin_of(&self.endpoint)
    }

    fn authorized<B>(&self, request: RequestBuilder<B>, address: &str) -> RequestBuilder<B> {
        match &self.token {
            Some(token) if self.is_own(address) => {
                request.header(header::AUTHORIZATION, format!("Bearer {token}"))
            }
            _ => request,
        }
    }

    /// The response to a HEAD request. Redirects are not followed.
    pub(super) fn head(&self, address: &str) -> Result<Response<Body>, String> {
        let request = self.authorized(self.agent.head(address), address);
        request.call().map_err(|error| error.to_string())
    }

    /// Reads a document or file from a byte offset on. Redirects are followed here, so that the token is sent only to
    /// this server.
    pub(super) fn get(&self, address: &str, from: u64) -> Result<Response<Body>, String> {
        let mut address = address.to_owned();
        for _ in 0..=MAX_REDIRECTS {
            let request = self.authorized(self.agent.get(&address), &address);
            let request = match from {
                0 => request,
                from => request.header(header::RANGE, format!("bytes={from}-")),
            };
            let response = request.call().map_err(|error| error.to_string())?;
            match redirect(&address, &response) {
                Some(place) => address = place,
                None => return Ok(response),
            }
        }
        Err("the server redirects without end".to_owned())
    }

    pub(super) fn ask(&self, address: &str) -> Result<Answer, Error> {
        let response = self
            .get(address, 0)
            .map_err(|problem| failed(address, problem))?;
        self.answer(address, response)
    }

    /// The answer to a POST request with a body of content type `kind`.
    pub(super) fn post(&self, address: &str, kind: &str, body: &[u8]) -> Result<Answer, Error> {
        // Bodies of other types than `+json` ones are answered with plain JSON.
        let accepted = if kind.ends_with("+json") { kind } else { JSON };
        let request = self
            .authorized(self.agent.post(address), address)
            .header(header::CONTENT_TYPE, kind)
            .header(header::ACCEPT, accepted)
            .config()
            .timeout_recv_response(Some(COMMIT_TIMEOUT))
            .timeout_per_read(Some(COMMIT_TIMEOUT))
            .build();
        let response = request.send(body).map_err(|error| failed(address, error))?;
        self.answer(address, response)
    }

    fn answer(&self, address: &str, response: Response<Body>) -> Result<Answer, Error> {
        let (parts, mut body) = response.into_parts();
        let text = body
            .with_config()
            .limit(MAX_ANSWER_LEN)
            .read_to_vec()
            .map_err(|error| failed(address, error))?;
        Ok(Answer {
            address: without_query(address),
            is_authorized: self.has_token() && self.is_own(address),
            status: parts.status,
            headers: parts.headers,
            // Some responses are plain text.
            body: serde_json::from_slice(&text).unwrap_or(Value::Null),
        })
    }

    /// Sends the next `len` bytes to a storage address, without the token, and returns the headers of the response.
    pub(super) fn put(
        &self,
        address: &str,
        content: &mut dyn Read,
        len: u64,
    ) -> Result<HeaderMap, String> {
        let request = self
            .agent
            .put(address)
            .header(header::CONTENT_LENGTH, len.to_string());
        let mut body = Read::take(content, len).chain(Shortened);
        let response = request
            .send(SendBody::from_reader(&mut body))
            .map_err(|error| error.to_string())?;
        match response.status() {
            status if status.is_success() => Ok(response.headers().clone()),
            status => Err(format!("the storage answers {status}")),
        }
    }
}

/// A reader that fails. It follows a file's content, so it is read only if the file became shorter; without it, ureq
/// would wait for the missing bytes forever.
struct Shortened;

impl Read for Shortened {
    fn read(&mut self, _buffer: &mut [u8]) -> io::Result<usize> {
        let problem = "the file became shorter while it was read";
        Err(io::Error::new(io::ErrorKind::UnexpectedEof, problem))
    }
}

pub(super) struct Answer {
    /// Address of the request, without secrets.
    pub(super) address: String,
    is_authorized: bool,
    pub(super) status: StatusCode,
    pub(super) headers: HeaderMap,
    /// The JSON document; null if the body is not JSON.
    pub(super) body: Value,
}

impl Answer {
    /// Turns a refusal into an error.
    pub(super) fn checked(self) -> Result<Self, Error> {
        if self.status.is_success() {
            return Ok(self);
        }
        let said = text_of(&self.headers, "x-error-message")
            .or_else(|| self.body["error"].as_str())
            .map(|said| said.chars().take(MAX_MESSAGE_LEN).collect::<String>());
        let problem = match said {
            Some(said) => format!("{}: {said}", self.status),
            None => self.status.to_string(),
        };
        let address = self.address;
        let remedy = match self.is_authorized {
            true => "the token (HF_TOKEN, or that of `hf auth login`) is wrong or may not do this",
            false => "set HF_TOKEN or run `hf auth login`",
        };
        Err(match self.status {
            StatusCode::UNAUTHORIZED | StatusCode::FORBIDDEN => {
                let problem = format!("the hub refuses {address} ({problem}); {remedy}");
                Error::hub(address, problem)
            }
            StatusCode::NOT_FOUND => Error::not_found(address),
            _ => failed(&address, problem),
        })
    }

    /// The error for a malformed response.
    pub(super) fn malformed(&self, problem: &str) -> Error {
        failed(&self.address, format!("the answer {problem}"))
    }
}

/// The folder of Hugging Face's tools that the environment names: `HF_HOME`, or `huggingface` in `XDG_CACHE_HOME` or in
/// `.cache` of the home folder; `None` if it names no home.
pub(super) fn home_from_variables(variable: impl Fn(&str) -> Option<OsString>) -> Option<PathBuf> {
    let folder = |name: &str| {
        variable(name)
            .filter(|value| !value.is_empty())
            .map(PathBuf::from)
    };
    folder("HF_HOME")
        .or_else(|| Some(folder("XDG_CACHE_HOME")?.join("huggingface")))
        .or_else(|| {
            let home = folder("HOME").or_else(|| folder("USERPROFILE"))?;
            Some(home.join(".cache/huggingface"))
        })
}

/// The token that the environment names: `HF_TOKEN`, or the content of the file of `hf auth login`, which is
/// `HF_TOKEN_PATH` or `token` in the folder of Hugging Face's tools (`HF_HOME`); `None` if there is neither. `variable`
/// returns the value of an environment variable.
pub fn token_from_variables(variable: impl Fn(&str) -> Option<OsString>) -> Option<String> {
    let value = |name: &str| variable(name).filter(|value| !value.is_empty());
    let token = match (value("HF_TOKEN"), value("HF_TOKEN_PATH")) {
        (Some(token), _) => token.to_string_lossy().into_owned(),
        (None, Some(path)) => fs::read_to_string(path).ok()?,
        (None, None) => fs::read_to_string(home_from_variables(&variable)?.join("token")).ok()?,
    };
    Some(token.trim().to_owned()).filter(|token| !token.is_empty())
}

/// Redirect target of a response; `None` if it is not a redirect.
pub(super) fn redirect(address: &str, response: &Response<Body>) -> Option<String> {
    let place = text_of(response.headers(), header::LOCATION.as_str())
        .filter(|_| response.status().is_redirection())?;
    Some(match place.starts_with('/') {
        true => format!("{}{place}", origin_of(address)),
        false => place.to_owned(),
    })
}

pub(super) fn text_of<'a>(headers: &'a HeaderMap, name: &str) -> Option<&'a str> {
    headers.get(name)?.to_str().ok()
}

pub(super) fn is_commit(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_hexdigit())
}

/// Scheme, host and port of an address.
fn origin_of(address: &str) -> &str {
    let host = address.find("://").map_or(0, |at| at + 3);
    let end = address[host..].find(['/', '?', '#']);
    &address[..end.map_or(address.len(), |end| host + end)]
}

/// An address without its query, which may hold a signature.
fn without_query(address: &str) -> String {
    address.split('?').next().unwrap_or(address).to_owned()
}

fn failed(address: &str, problem: impl fmt::Display) -> Error {
    let address = without_query(address);
    let next = "run the same command again to go on where it stopped";
    let problem = format!("{address} failed ({problem}); {next}");
    Error::hub(address, problem)
}

/// Percent-encodes all bytes except letters, digits, `-._~` and the bytes in `kept`.
pub(super) fn quoted(text: &str, kept: &str) -> String {
    let mut quoted = String::with_capacity(text.len());
    for byte in text.bytes() {
        let letter = char::from(byte);
        match byte.is_ascii_alphanumeric() || "-._~".contains(letter) || kept.contains(letter) {
            true => quoted.push(letter),
            false => quoted += &format!("%{byte:02X}"),
        }
    }
    quoted
}
