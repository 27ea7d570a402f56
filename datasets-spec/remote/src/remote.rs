//! The store of URLs.

use std::collections::BTreeMap;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bytes::Bytes;
use datasets_spec::store::{Disk, Locking, NewFile, ReadAt, Reader, Store, aside};
use object_store::ObjectStore;

use crate::cache::Cache;
use crate::client::{Client, Got, MAX_REQUEST, tag_of};
use crate::file::RemoteFile;
use crate::hub::{HubCache, beside, dataset_path};
use crate::place::{Place, Scheme};
use crate::settings::Settings;

/// Serves URLs. Clients of buckets are made when they are first needed.
#[derive(Debug, Default)]
pub struct Remote {
    retries: usize,
    cache: Option<Arc<Cache>>,
    hub: Option<HubCache>,
    clients: Mutex<BTreeMap<String, Client>>,
    /// Sizes, hashes and versions of files that do not change while this process reads them.
    known: Mutex<BTreeMap<PathBuf, Known>>,
}

#[derive(Clone, Debug)]
struct Known {
    size: u64,
    /// BLAKE3; `None` for a file that was only listed.
    hash: Option<String>,
    /// Version tag in the listing, if it states one.
    tag: Option<String>,
}

impl Remote {
    /// Serves URLs with these settings.
    pub fn new(settings: Settings) -> Self {
        let cache = settings.cache.as_ref();
        Self {
            retries: settings.retries,
            cache: cache.map(|(folder, bytes)| Arc::new(Cache::new(folder, *bytes))),
            hub: settings.hub,
            ..Self::default()
        }
    }

    /// Serves a bucket, such as `s3://clips`, by the given client.
    #[must_use]
    pub fn with_bucket(self, root: &str, store: Arc<dyn ObjectStore>) -> Self {
        lock(&self.clients).insert(root.to_owned(), Client::new(store, self.retries));
        self
    }

    fn client(&self, place: &Place) -> io::Result<Client> {
        let mut clients = lock(&self.clients);
        if let Some(client) = clients.get(&place.root) {
            return Ok(client.clone());
        }
        let client = Client::of(place, self.retries)?;
        clients.insert(place.root.clone(), client.clone());
        Ok(client)
    }

    fn known(&self, path: &Path) -> Option<Known> {
        lock(&self.known).get(path).cloned()
    }

    /// Resolves a URL: `hf://` to a local path in the hub's cache, others to a place in a bucket and its client.
    fn find(&self, path: &Path) -> io::Result<Found> {
        let place = Place::parse(path)?;
        if place.scheme == Scheme::Hub {
            return dataset_path(self.hub.as_ref(), &place).map(Found::Local);
        }
        let client = self.client(&place)?;
        Ok(Found::Remote(place, client))
    }

    fn find_to_write(&self, path: &Path) -> io::Result<(Place, Client)> {
        match self.find(path)? {
            Found::Remote(place, client) if place.scheme != Scheme::Http => Ok((place, client)),
            _ => Err(io::Error::new(
                io::ErrorKind::PermissionDenied,
                "http://, https:// and hf:// are only read; write to s3://, gs:// or az://",
            )),
        }
    }

    /// Opens a file for reading by ranges. The storage is asked for its size only if that is not known.
    fn file(&self, path: &Path, place: &Place, client: Client) -> io::Result<RemoteFile> {
        let known = self.known(path);
        let (size, tag) = match &known {
            Some(known) => (known.size, known.tag.clone()),
            None => client.head(&place.key)?,
        };
        Ok(RemoteFile {
            aside: aside(path).and_then(|aside| Some(Place::parse(&aside).ok()?.key)),
            hash: known.and_then(|known| known.hash),
            cache: self.cache.clone(),
            ..RemoteFile::new(client, place.key.clone(), size, tag)
        })
    }

    /// All bytes of an object, bypassing the cache.
    fn fetch(&self, path: &Path, place: &Place, client: &Client) -> io::Result<Bytes> {
        let Got { bytes, size, tag } = client.get(&place.key)?;
        if let Some(known) = self.known(path).filter(|known| known.size != size) {
            let text = format!("it has {size} bytes, expected {}", known.size);
            return Err(io::Error::new(io::ErrorKind::InvalidData, text));
        }
        if size <= MAX_REQUEST {
            return Ok(bytes);
        }
        RemoteFile::new(client.clone(), place.key.clone(), size, tag).read_whole()
    }

    fn keep(&self, hash: &str, bytes: &Bytes) {
        use crate::cache::BLOCK;

        if let Some(cache) = &self.cache {
            for (block, bytes) in bytes.chunks(BLOCK as usize).enumerate() {
                cache.put(hash, block as u64, bytes);
            }
        }
    }
}

enum Found {
    Local(PathBuf),
    Remote(Place, Client),
}

/// Locks a map. A poisoned lock is ignored, because no update leaves a map incomplete.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// An object being written. Its bytes are held in memory: a shard is a few hundred megabytes at most.
struct Upload {
    place: Place,
    client: Client,
    bytes: Vec<u8>,
}

impl Write for Upload {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.bytes.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl NewFile for Upload {
    fn publish(self: Box<Self>) -> io::Result<()> {
        self.client.put(&self.place.key, self.bytes.into())
    }

    fn publish_new(self: Box<Self>) -> io::Result<()> {
        self.client.put_new(&self.place.key, self.bytes.into())
    }
}

impl Store for Remote {
    fn create_dir_all(&self, path: &Path) -> io::Result<()> {
        self.find_to_write(path).map(|_| ())
    }

    fn create(&self, path: &Path) -> io::Result<Box<dyn NewFile>> {
        let (place, client) = self.find_to_write(path)?;
        // A rewritten file has another hash and version.
        lock(&self.known).remove(path);
        Ok(Box::new(Upload {
            place,
            client,
            bytes: Vec::new(),
        }))
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        let (from, client) = self.find_to_write(from)?;
        let (to_place, _) = self.find_to_write(to)?;
        if from.root != to_place.root {
            return Err(io::ErrorKind::CrossesDevices.into());
        }
        lock(&self.known).remove(to);
        client.rename(&from.key, &to_place.key)
    }

    fn read(&self, path: &Path) -> io::Result<Vec<u8>> {
        let (place, client) = match self.find(path)? {
            Found::Local(path) => return Disk.read(&path),
            Found::Remote(place, client) => (place, client),
        };
        let Some(hash) = self.known(path).and_then(|known| known.hash) else {
            return Ok(self.fetch(path, &place, &client)?.into());
        };
        let is_whole = |bytes: &[u8]| blake3::hash(bytes).to_hex().as_str() == hash;
        let file = self.file(path, &place, client.clone())?;
        let bytes = file.read_whole()?;
        if is_whole(&bytes) {
            return Ok(bytes.into());
        }
        // The cached bytes may be wrong: read them from the storage once more.
        if let Some(cache) = &self.cache {
            cache.forget(&hash, file.size);
        }
        let bytes = self.fetch(path, &place, &client)?;
        if !is_whole(&bytes) {
            let found = blake3::hash(&bytes).to_hex();
            let text = format!("BLAKE3 expected {hash}, found {found}");
            return Err(io::Error::new(io::ErrorKind::InvalidData, text));
        }
        self.keep(&hash, &bytes);
        Ok(bytes.into())
    }

    fn open(&self, path: &Path) -> io::Result<Box<dyn Read>> {
        Ok(Box::new(Reader::new(self.open_at(path)?)))
    }

    fn open_at(&self, path: &Path) -> io::Result<Arc<dyn ReadAt>> {
        match self.find(path)? {
            Found::Local(path) => Disk.open_at(&path),
            Found::Remote(place, client) => Ok(Arc::new(self.file(path, &place, client)?)),
        }
    }

    fn size(&self, path: &Path) -> io::Result<u64> {
        match (self.known(path), self.find(path)?) {
            (_, Found::Local(path)) => Disk.size(&path),
            (Some(known), _) => Ok(known.size),
            (None, Found::Remote(place, client)) => Ok(client.head(&place.key)?.0),
        }
    }

    /// Reads and hashes the file from the storage, bypassing the cache. Later reads come from the cache if the file
    /// fits into it.
    fn hash(&self, path: &Path) -> io::Result<String> {
        let (place, client) = match self.find(path)? {
            Found::Local(path) => return Disk.hash(&path),
            Found::Remote(place, client) => (place, client),
        };
        let bytes = self.fetch(path, &place, &client)?;
        let hash = blake3::hash(&bytes).to_hex().to_string();
        let mut known = lock(&self.known);
        let of_dataset = known.get(path).is_some_and(|known| known.hash.is_some());
        if !of_dataset {
            let size = bytes.len() as u64;
            let of_source = Known {
                size,
                hash: Some(hash.clone()),
                tag: known.get(path).and_then(|known| known.tag.clone()),
            };
            known.insert(path.to_owned(), of_source);
            drop(known);
            self.keep(&hash, &bytes);
        }
        Ok(hash)
    }

    fn list(&self, path: &Path) -> io::Result<Vec<(PathBuf, bool)>> {
        let (place, client) = match self.find(path)? {
            Found::Local(local) => {
                let entries = Disk.list(&local)?.into_iter();
                return Ok(entries
                    .map(|(entry, is_dir)| (beside(path, &entry), is_dir))
                    .collect());
            }
            Found::Remote(place, client) => (place, client),
        };
        if place.scheme == Scheme::Http
            && let Some(manifest) = self.manifest_over_http(path)
        {
            return Ok(vec![(manifest, false)]);
        }
        let (objects, folders) = client.list(&place.key)?;
        let objects = objects.iter().map(|key| (place.url(key), false));
        let folders = folders.iter().map(|key| (place.url(key), true));
        let mut entries: Vec<(PathBuf, bool)> = objects.chain(folders).collect();
        entries.sort();
        Ok(entries)
    }

    fn remove_file(&self, path: &Path) -> io::Result<()> {
        let (place, client) = self.find_to_write(path)?;
        lock(&self.known).remove(path);
        client.delete(vec![place.key])
    }

    fn remove_dir_all(&self, path: &Path) -> io::Result<()> {
        let (place, client) = self.find_to_write(path)?;
        let listed = client.list_all(&place.key)?;
        client.delete(listed.into_iter().map(|meta| meta.location).collect())
    }

    fn lock(&self, folder: &Path, _holder: &str) -> io::Result<Locking> {
        self.find_to_write(folder).map(|_| Locking::NoLocks)
    }

    fn difference(&self, path: &Path, bytes: u64, blake3: &str) -> io::Result<Option<String>> {
        let (place, client) = match self.find(path)? {
            Found::Local(path) => return Disk.difference(&path, bytes, blake3),
            Found::Remote(place, client) => (place, client),
        };
        let (found, _) = client.head(&place.key)?;
        Ok((found != bytes).then(|| format!("expected {bytes} bytes, found {found}")))
    }

    fn expect(&self, path: &Path, bytes: u64, blake3: &str) {
        let known = Known {
            size: bytes,
            hash: Some(blake3.to_owned()),
            tag: None,
        };
        lock(&self.known).insert(path.to_owned(), known);
    }

    fn files_below(&self, folder: &Path) -> io::Result<Vec<PathBuf>> {
        let (place, client) = match self.find(folder)? {
            Found::Local(local) => {
                let files = Disk.files_below(&local)?;
                let below = |file: &PathBuf| file.strip_prefix(&local).map(|end| folder.join(end));
                return Ok(files.iter().filter_map(|file| below(file).ok()).collect());
            }
            Found::Remote(place, client) => (place, client),
        };
        let mut files = Vec::new();
        let mut known = lock(&self.known);
        for meta in client.list_all(&place.key)? {
            let path = place.url(&meta.location);
            // Skip folder markers, which some tools create.
            if meta.size == 0 && meta.location.as_ref().is_empty() {
                continue;
            }
            known.entry(path.clone()).or_insert(Known {
                size: meta.size,
                hash: None,
                tag: tag_of(meta),
            });
            files.push(path);
        }
        files.sort();
        Ok(files)
    }
}

impl Remote {
    /// The newest manifest in a folder `meta` of a plain web server, which cannot list files: the `croissant.json` of
    /// the dataset states the version.
    fn manifest_over_http(&self, folder: &Path) -> Option<PathBuf> {
        if folder.file_name()? != "meta" {
            return None;
        }
        let description = self.read(&folder.parent()?.join("croissant.json")).ok()?;
        let description: serde_json::Value = serde_json::from_slice(&description).ok()?;
        let version = description.get("version")?.as_str()?.split('.').next()?;
        let version: u64 = version.parse().ok()?;
        Some(folder.join(format!("manifest-{version}.json")))
    }
}
