//! The store that a path or URL belongs to.

use std::collections::BTreeMap;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock, PoisonError, RwLock};

use super::{Disk, Locking, NewFile, ReadAt, Store, wherever};

static REMOTE: OnceLock<Arc<dyn Store>> = OnceLock::new();

/// Mounted stores with their paths. If several match a path, the last one is used.
type Mounts = BTreeMap<PathBuf, Vec<(u64, Arc<dyn Store>)>>;

static MOUNTS: RwLock<Mounts> = RwLock::new(BTreeMap::new());

/// Makes a store serve all URLs of this process. A program calls it once, before it opens anything; later
/// calls change nothing.
pub fn register(remote: Arc<dyn Store>) {
    let _registered = REMOTE.set(remote);
}

/// A mounted store. Dropping it unmounts the store.
#[derive(Debug)]
pub struct Mounted {
    at: PathBuf,
    number: u64,
}

/// Makes a store serve all paths below `at`, such as the members of an archive. The path `at` itself stays with its own
/// store.
pub fn mount(at: &Path, store: Arc<dyn Store>) -> Mounted {
    static NUMBER: AtomicU64 = AtomicU64::new(0);
    let number = NUMBER.fetch_add(1, Ordering::Relaxed);
    let mut mounts = MOUNTS.write().unwrap_or_else(PoisonError::into_inner);
    mounts
        .entry(at.to_owned())
        .or_default()
        .push((number, store));
    Mounted {
        at: at.to_owned(),
        number,
    }
}

impl Drop for Mounted {
    fn drop(&mut self) {
        let mut mounts = MOUNTS.write().unwrap_or_else(PoisonError::into_inner);
        if let Some(stores) = mounts.get_mut(&self.at) {
            stores.retain(|(number, _)| *number != self.number);
            if stores.is_empty() {
                mounts.remove(&self.at);
            }
        }
    }
}

/// The store that is mounted at a folder or above it, the nearest one.
fn mounted_at(folder: &Path) -> Option<Arc<dyn Store>> {
    let mounts = MOUNTS.read().unwrap_or_else(PoisonError::into_inner);
    if mounts.is_empty() {
        return None;
    }
    let mut above = folder.ancestors();
    let stores = above.find_map(|folder| mounts.get(folder))?;
    stores.last().map(|(_, store)| Arc::clone(store))
}

/// Whether a path is a URL, such as `s3://bucket/dataset`.
pub fn is_url(path: &Path) -> bool {
    let text = path.as_os_str().to_str().unwrap_or("");
    text.split_once("://").is_some_and(|(scheme, _)| {
        scheme.starts_with(|first: char| first.is_ascii_alphabetic())
            && scheme
                .chars()
                .all(|letter| letter.is_ascii_alphanumeric() || "+-.".contains(letter))
    })
}

/// Chooses the store of each path: a store mounted above it, the remote store for a URL, otherwise the disk. It reads
/// files of a dataset wherever a commit has moved them, so that readers of an older version are not interrupted.
#[derive(Clone, Copy, Debug, Default)]
pub struct ByPath;

impl ByPath {
    /// The store as a trait object.
    pub fn store() -> Arc<dyn Store> {
        Arc::new(Self)
    }
}

/// The store of a file, or of a folder whose entries are not accessed.
fn of(path: &Path) -> io::Result<Arc<dyn Store>> {
    found(path, path.parent().and_then(mounted_at))
}

fn in_folder(folder: &Path) -> io::Result<Arc<dyn Store>> {
    found(folder, mounted_at(folder))
}

fn found(path: &Path, mounted: Option<Arc<dyn Store>>) -> io::Result<Arc<dyn Store>> {
    let none = || io::Error::new(io::ErrorKind::Unsupported, "this program reads no URLs");
    match mounted {
        Some(store) => Ok(store),
        None if is_url(path) => REMOTE.get().cloned().ok_or_else(none),
        None => Ok(Disk::store()),
    }
}

impl Store for ByPath {
    fn create_dir_all(&self, path: &Path) -> io::Result<()> {
        of(path)?.create_dir_all(path)
    }

    fn create(&self, path: &Path) -> io::Result<Box<dyn NewFile>> {
        of(path)?.create(path)
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        of(from)?.rename(from, to)
    }

    fn read(&self, path: &Path) -> io::Result<Vec<u8>> {
        wherever(path, |path| of(path)?.read(path))
    }

    fn open(&self, path: &Path) -> io::Result<Box<dyn Read>> {
        wherever(path, |path| of(path)?.open(path))
    }

    fn open_at(&self, path: &Path) -> io::Result<Arc<dyn ReadAt>> {
        wherever(path, |path| of(path)?.open_at(path))
    }

    fn size(&self, path: &Path) -> io::Result<u64> {
        wherever(path, |path| of(path)?.size(path))
    }

    fn hash(&self, path: &Path) -> io::Result<String> {
        wherever(path, |path| of(path)?.hash(path))
    }

    fn list(&self, path: &Path) -> io::Result<Vec<(PathBuf, bool)>> {
        in_folder(path)?.list(path)
    }

    fn remove_file(&self, path: &Path) -> io::Result<()> {
        of(path)?.remove_file(path)
    }

    fn remove_dir_all(&self, path: &Path) -> io::Result<()> {
        of(path)?.remove_dir_all(path)
    }

    fn lock(&self, folder: &Path, holder: &str) -> io::Result<Locking> {
        of(folder)?.lock(folder, holder)
    }

    fn difference(&self, path: &Path, bytes: u64, blake3: &str) -> io::Result<Option<String>> {
        wherever(path, |path| of(path)?.difference(path, bytes, blake3))
    }

    fn expect(&self, path: &Path, bytes: u64, blake3: &str) {
        if let Ok(store) = of(path) {
            store.expect(path, bytes, blake3);
        }
    }

    fn files_below(&self, folder: &Path) -> io::Result<Vec<PathBuf>> {
        in_folder(folder)?.files_below(folder)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn urls_are_told_from_paths() {
        for url in ["s3://bucket/a", "hf://datasets/a/b", "http://host"] {
            assert!(is_url(Path::new(url)), "{url}");
        }
        for path in [
            "", "a/b", "/a/b", "C:\\a", "a:/b", "1://a", "a b://c", "://a",
        ] {
            assert!(!is_url(Path::new(path)), "{path}");
        }
    }

    #[test]
    fn a_path_below_a_url_is_the_url_of_the_object() {
        let root = PathBuf::from("s3://bucket/clips");
        let file = root.join("data/motions/train.parquet");
        let text = file.to_str().expect("text").replace('\\', "/");
        assert_eq!(text, "s3://bucket/clips/data/motions/train.parquet");
        assert_eq!(file.with_file_name("x").parent(), file.parent());
        let error = ByPath.read(&file).expect_err("nothing is registered");
        assert_eq!(error.kind(), io::ErrorKind::Unsupported);
    }
}
