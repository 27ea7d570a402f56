//! Requests to object stores, from blocking code.

use std::io;
use std::ops::Range;
use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bytes::Bytes;
use futures_util::TryStreamExt;
use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey};
use object_store::azure::{AzureConfigKey, MicrosoftAzureBuilder};
use object_store::gcp::{GoogleCloudStorageBuilder, GoogleConfigKey};
use object_store::http::HttpBuilder;
use object_store::path::Path as Key;
use object_store::{
    Attribute, Attributes, ClientConfigKey, ClientOptions, Error, GetOptions, ObjectMeta,
    ObjectStore, ObjectStoreExt, PutMode, PutOptions, PutPayload, RetryConfig,
};
use tokio::runtime::{Builder, Handle};

use crate::place::{Place, Scheme};

/// Threads of the runtime. They only wait and copy.
const NUM_THREADS: usize = 2;
/// Time after which a request counts as lost: long enough for a whole shard on a slow line.
const TIMEOUT: &str = "900 seconds";
/// Timeout for opening a connection.
const CONNECT_TIMEOUT: &str = "10 seconds";
/// Maximum number of requests of one read at the same time.
const NUM_PARALLEL: usize = 4;
/// Maximum number of bytes in one request.
pub(crate) const MAX_REQUEST: u64 = 32 << 20;
/// Attempts at requests that `object_store` itself does not repeat, such as creating a file that must not exist yet.
const ATTEMPTS: usize = 4;
/// Metadata key of an object. Its value identifies the write that created the object.
const WRITER: &str = "stancewriter";

/// Runs a future on the runtime of this crate. Unlike `block_on` it may be called from within another runtime.
fn wait<T: Send + 'static>(
    future: impl Future<Output = io::Result<T>> + Send + 'static,
) -> io::Result<T> {
    let runtime = runtime()?;
    let (send, receive) = sync_channel(1);
    runtime.spawn(async move {
        // The receiver waits below.
        let _sent = send.send(future.await);
    });
    let ended = || io::Error::other("a request ended without an answer");
    receive.recv().map_err(|_| ended())?
}

/// The runtime of this process. A forked process, such as a worker of a Python loader, does not have the threads of its
/// parent, so it starts its own runtime.
fn runtime() -> io::Result<Handle> {
    static RUNTIME: Mutex<Option<(u32, Handle)>> = Mutex::new(None);

    let mut held = RUNTIME.lock().unwrap_or_else(PoisonError::into_inner);
    let here = std::process::id();
    if let Some((process, handle)) = &*held
        && *process == here
    {
        return Ok(handle.clone());
    }
    let runtime = Builder::new_multi_thread()
        .worker_threads(NUM_THREADS)
        .thread_name("remote-store")
        .enable_all()
        .build()?;
    let handle = runtime.handle().clone();
    // The runtime lasts as long as the process. After a fork the parent's runtime is leaked too: its threads do not
    // exist in this process and cannot be joined.
    std::mem::forget(runtime);
    std::mem::forget(held.replace((here, handle.clone())));
    Ok(handle)
}

/// A client of one bucket, container or host.
#[derive(Clone, Debug)]
pub(crate) struct Client {
    store: Arc<dyn ObjectStore>,
    /// Maximum number of attempts to read a body.
    attempts: usize,
}

/// An object's content and size, and its version tag if the storage has one.
#[derive(Clone, Debug)]
pub(crate) struct Got {
    pub(crate) bytes: Bytes,
    pub(crate) size: u64,
    pub(crate) tag: Option<String>,
}

/// Version tag of an object: its strong ETag, if it has one.
pub(crate) fn tag_of(meta: ObjectMeta) -> Option<String> {
    meta.e_tag.filter(|tag| !tag.starts_with("W/"))
}

impl Client {
    /// A client that repeats the reading of a body that ends too early.
    pub(crate) fn new(store: Arc<dyn ObjectStore>, retries: usize) -> Self {
        let attempts = retries.saturating_add(1);
        Self { store, attempts }
    }

    pub(crate) fn of(place: &Place, retries: usize) -> io::Result<Self> {
        let retry = RetryConfig {
            max_retries: retries,
            ..RetryConfig::default()
        };
        let name = place.authority.as_str();
        let unset = |name: &str| std::env::var_os(name).is_none();
        let times = [
            (ClientConfigKey::Timeout, TIMEOUT),
            (ClientConfigKey::ConnectTimeout, CONNECT_TIMEOUT),
        ];
        let store: Result<Arc<dyn ObjectStore>, Error> = match place.scheme {
            Scheme::S3 => {
                let mut builder = AmazonS3Builder::from_env();
                for (key, value) in times {
                    if unset(&format!("AWS_{}", key.as_ref().to_ascii_uppercase())) {
                        builder = builder.with_config(AmazonS3ConfigKey::Client(key), value);
                    }
                }
                // An unencrypted endpoint is allowed if the user names it.
                let endpoints = ["AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL", "AWS_ENDPOINT"];
                let mut endpoints = endpoints.iter().filter_map(|name| std::env::var(name).ok());
                if endpoints.any(|endpoint| endpoint.starts_with("http://")) {
                    builder = builder.with_allow_http(true);
                }
                let built = builder.with_bucket_name(name).with_retry(retry).build();
                built.map(|store| Arc::new(store) as _)
            }
            Scheme::Gcs => {
                let mut builder = GoogleCloudStorageBuilder::from_env();
                for (key, value) in times {
                    builder = builder.with_config(GoogleConfigKey::Client(key), value);
                }
                let built = builder.with_bucket_name(name).with_retry(retry).build();
                built.map(|store| Arc::new(store) as _)
            }
            Scheme::Azure => {
                let mut builder = MicrosoftAzureBuilder::from_env();
                for (key, value) in times {
                    builder = builder.with_config(AzureConfigKey::Client(key), value);
                }
                let built = builder.with_container_name(name).with_retry(retry).build();
                built.map(|store| Arc::new(store) as _)
            }
            Scheme::Http => {
                let mut options = ClientOptions::new().with_allow_http(true);
                for (key, value) in times {
                    options = options.with_config(key, value);
                }
                let builder = HttpBuilder::new().with_url(&place.root);
                let builder = builder.with_client_options(options).with_retry(retry);
                builder.build().map(|store| Arc::new(store) as _)
            }
            Scheme::Hub => {
                return Err(io::Error::other("the hub's cache is no object store"));
            }
        };
        store
            .map(|store| Self::new(store, retries))
            .map_err(io_error)
    }

    /// Sends a request to the store, and repeats it if it may succeed later.
    fn request<T, F>(
        &self,
        attempts: usize,
        key: &Key,
        send: impl Fn(Arc<dyn ObjectStore>, Key) -> F + Send + Sync + 'static,
    ) -> io::Result<T>
    where
        T: Send + 'static,
        F: Future<Output = io::Result<T>> + Send + 'static,
    {
        let (store, key) = (Arc::clone(&self.store), key.clone());
        wait(async move { repeated(attempts, || send(Arc::clone(&store), key.clone())).await })
    }

    /// Reads an object that is no larger than one request; of a larger object, only its size.
    pub(crate) fn get(&self, key: &Key) -> io::Result<Got> {
        self.request(self.attempts, key, |store, key| async move {
            let result = store.get_opts(&key, GetOptions::default()).await;
            let result = result.map_err(io_error)?;
            let (size, tag) = (result.meta.size, tag_of(result.meta.clone()));
            let bytes = if size > MAX_REQUEST {
                Bytes::new()
            } else {
                whole(result.bytes().await, size)?
            };
            Ok(Got { bytes, size, tag })
        })
    }

    /// Size and version of an object.
    pub(crate) fn head(&self, key: &Key) -> io::Result<(u64, Option<String>)> {
        let meta: ObjectMeta = self.request(ATTEMPTS, key, |store, key| async move {
            store.head(&key).await.map_err(io_error)
        })?;
        Ok((meta.size, tag_of(meta)))
    }

    /// Ranges of an object, a few at the same time. If `tag` is stated, another version is an error.
    pub(crate) fn ranges(
        &self,
        key: &Key,
        tag: Option<&str>,
        ranges: &[Range<u64>],
    ) -> io::Result<Vec<Bytes>> {
        let (store, key, ranges) = (Arc::clone(&self.store), key.clone(), ranges.to_vec());
        let (tag, attempts) = (tag.map(str::to_owned), self.attempts);
        wait(async move {
            let mut bytes = Vec::new();
            for ranges in ranges.chunks(NUM_PARALLEL) {
                let start = |range: &Range<u64>| {
                    let (store, key, tag) = (Arc::clone(&store), key.clone(), tag.clone());
                    tokio::spawn(one_range(store, key, tag, range.clone(), attempts))
                };
                let started: Vec<_> = ranges.iter().map(start).collect();
                for task in started {
                    bytes.push(task.await.map_err(io::Error::other)??);
                }
            }
            Ok(bytes)
        })
    }

    /// Writes an object, and replaces any object of that name.
    pub(crate) fn put(&self, key: &Key, bytes: Bytes) -> io::Result<()> {
        self.request(ATTEMPTS, key, move |store, key| {
            let payload = PutPayload::from_bytes(bytes.clone());
            async move { store.put(&key, payload).await.map(|_| ()).map_err(io_error) }
        })
    }

    /// Writes an object. An error of kind `AlreadyExists` if there is one of its name.
    pub(crate) fn put_new(&self, key: &Key, bytes: Bytes) -> io::Result<()> {
        let (store, key) = (Arc::clone(&self.store), key.clone());
        let mut random = [0; 16];
        getrandom::fill(&mut random).map_err(io::Error::other)?;
        let writer: String = random.iter().map(|byte| format!("{byte:02x}")).collect();
        wait(async move {
            let attribute = Attribute::Metadata(WRITER.into());
            let mut wait = Duration::from_millis(100);
            let mut last = io::Error::from(io::ErrorKind::TimedOut);
            for _ in 0..ATTEMPTS {
                let attributes = [(attribute.clone(), writer.clone())];
                let options = PutOptions {
                    mode: PutMode::Create,
                    attributes: Attributes::from_iter(attributes),
                    ..PutOptions::default()
                };
                let payload = PutPayload::from_bytes(bytes.clone());
                match store.put_opts(&key, payload, options).await {
                    Ok(_) => return Ok(()),
                    Err(error) => last = io_error(error),
                }
                // The object may be ours: the answer may have been lost, or the request repeated.
                let head = GetOptions::new().with_head(true);
                match store.get_opts(&key, head).await {
                    Ok(found) => {
                        let by = found.attributes.get(&attribute);
                        return match by.is_some_and(|by| by.as_ref() == writer) {
                            true => Ok(()),
                            false => Err(io::ErrorKind::AlreadyExists.into()),
                        };
                    }
                    Err(Error::NotFound { .. }) => {}
                    Err(_) => return Err(last),
                }
                if last.kind() == io::ErrorKind::PermissionDenied {
                    return Err(last);
                }
                tokio::time::sleep(wait).await;
                wait *= 4;
            }
            Err(last)
        })
    }

    /// Copies an object and removes the original.
    pub(crate) fn rename(&self, from: &Key, to: &Key) -> io::Result<()> {
        let (store, from, to) = (Arc::clone(&self.store), from.clone(), to.clone());
        wait(async move {
            store.copy(&from, &to).await.map_err(io_error)?;
            store.delete(&from).await.map_err(io_error)
        })
    }

    /// Removes objects; a missing one is not an error.
    pub(crate) fn delete(&self, keys: Vec<Key>) -> io::Result<()> {
        keys.iter().try_for_each(|key| {
            self.request(ATTEMPTS, key, |store, key| async move {
                match store.delete(&key).await {
                    Ok(()) | Err(Error::NotFound { .. }) => Ok(()),
                    Err(error) => Err(io_error(error)),
                }
            })
        })
    }

    pub(crate) fn list_all(&self, key: &Key) -> io::Result<Vec<ObjectMeta>> {
        self.request(ATTEMPTS, key, |store, key| async move {
            let prefix = (!key.as_ref().is_empty()).then_some(&key);
            store.list(prefix).try_collect().await.map_err(io_error)
        })
    }

    /// The objects and folders right below a key.
    pub(crate) fn list(&self, key: &Key) -> io::Result<(Vec<Key>, Vec<Key>)> {
        self.request(ATTEMPTS, key, |store, key| async move {
            let prefix = (!key.as_ref().is_empty()).then_some(&key);
            let listed = store.list_with_delimiter(prefix).await;
            let listed = listed.map_err(io_error)?;
            let objects = listed.objects.into_iter().map(|meta| meta.location);
            Ok((objects.collect(), listed.common_prefixes))
        })
    }
}

async fn one_range(
    store: Arc<dyn ObjectStore>,
    key: Key,
    tag: Option<String>,
    range: Range<u64>,
    attempts: usize,
) -> io::Result<Bytes> {
    repeated(attempts, || async {
        let options = GetOptions::new()
            .with_range(Some(range.clone()))
            .with_if_match(tag.clone());
        let result = store.get_opts(&key, options).await.map_err(io_error)?;
        whole(result.bytes().await, range.end - range.start)
    })
    .await
}

/// Refuses a body that did not arrive or has another length than stated.
fn whole(body: Result<Bytes, Error>, expected: u64) -> io::Result<Bytes> {
    let text = match body {
        Ok(bytes) if bytes.len() as u64 == expected => return Ok(bytes),
        Ok(bytes) => format!("got {} bytes, expected {expected}", bytes.len()),
        Err(error) => io_error(error).to_string(),
    };
    Err(io::Error::new(io::ErrorKind::UnexpectedEof, text))
}

/// Repeats a failed request that may succeed later: up to `attempts` times if a body ended too early, otherwise at most
/// [`ATTEMPTS`] times, because `object_store` itself already repeats requests that are refused for a time.
async fn repeated<T, F: Future<Output = io::Result<T>>>(
    attempts: usize,
    read: impl Fn() -> F,
) -> io::Result<T> {
    use io::ErrorKind::{AlreadyExists, NotFound, PermissionDenied, UnexpectedEof, Unsupported};

    let mut attempt = 1;
    loop {
        let error = match read().await {
            Err(error) => error,
            done => return done,
        };
        let attempts = match error.kind() {
            AlreadyExists | NotFound | PermissionDenied | Unsupported => 1,
            UnexpectedEof => attempts,
            _ => attempts.min(ATTEMPTS),
        };
        if attempt >= attempts {
            return Err(error);
        }
        attempt += 1;
    }
}

/// An error of a request, in one line.
pub(crate) fn io_error(error: Error) -> io::Error {
    use io::ErrorKind;

    let kind = match &error {
        Error::NotFound { .. } => ErrorKind::NotFound,
        Error::AlreadyExists { .. } => ErrorKind::AlreadyExists,
        Error::PermissionDenied { .. } | Error::Unauthenticated { .. } => {
            ErrorKind::PermissionDenied
        }
        Error::NotSupported { .. } | Error::NotImplemented { .. } => ErrorKind::Unsupported,
        Error::Precondition { .. } => {
            return io::Error::other("it was changed while it was read");
        }
        _ => ErrorKind::Other,
    };
    let text = match kind {
        ErrorKind::NotFound => "there is no such object".to_owned(),
        _ => {
            let text = with_cause(&error);
            shortened(&sentence(&text).unwrap_or(text))
        }
    };
    io::Error::new(kind, text)
}

/// The error message in an XML response of an object store, as a sentence; `None` if the text holds no such document.
///
/// # Source
/// Amazon S3 API reference, "REST error responses": `Error` holds `Code` and `Message`, and `BucketName` where it is
/// about a bucket. Azure and Google's XML interface do the same.
fn sentence(text: &str) -> Option<String> {
    let element = |name: &str| {
        let (open, close) = (format!("<{name}>"), format!("</{name}>"));
        let start = text.find(&open)? + open.len();
        let length = text[start..].find(&close)?;
        Some(text[start..start + length].trim())
    };
    let code = element("Code")?;
    let message = element("Message").unwrap_or_default();
    let message = message
        .lines()
        .next()
        .unwrap_or_default()
        .trim_end_matches('.');
    Some(match code {
        "NoSuchBucket" | "ContainerNotFound" => {
            let name = element("BucketName").map_or(String::new(), |name| format!(" {name}"));
            format!(
                "there is no bucket{name}; check its name, its region and the endpoint ({code})"
            )
        }
        code => match message {
            "" => format!("the storage answered {code}"),
            message => format!("the storage answered {code}: {message}"),
        },
    })
}

/// The text of an error, and that of its innermost cause: reqwest's own text is only "error sending request".
fn with_cause(error: &dyn std::error::Error) -> String {
    let text = error.to_string();
    let innermost = std::iter::successors(error.source(), |error| error.source()).last();
    match innermost.map(ToString::to_string) {
        Some(cause) if !text.contains(&cause) => format!("{text}: {cause}"),
        _ => text,
    }
}

/// The beginning of a text, in one line.
fn shortened(text: &str) -> String {
    const LENGTH: usize = 400;
    let line: Vec<&str> = text.split_whitespace().collect();
    let line = line.join(" ");
    match line.char_indices().nth(LENGTH) {
        Some((end, _)) => format!("{} ...", &line[..end]),
        None => line,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_storage_says_in_xml_becomes_a_sentence() {
        let answer = |code: &str, more: &str| {
            format!(
                "Error performing GET http://host/b in 3ms - Server returned non-2xx status code: 404 Not Found: <?xml \
                 version=\"1.0\"?>\n<Error><Code>{code}</Code><Message>It is not there.</Message>{more}</Error>"
            )
        };
        let missing = answer("NoSuchBucket", "<BucketName>clips</BucketName>");
        let said = sentence(&missing).expect("a sentence");
        assert!(said.starts_with("there is no bucket clips;"), "{said}");
        let said = sentence(&answer("SlowDown", "")).expect("a sentence");
        assert_eq!(said, "the storage answered SlowDown: It is not there");
        assert_eq!(sentence("connection refused"), None);
    }
}
