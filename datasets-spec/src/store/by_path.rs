//! The store that a path or URL belongs to.

use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use super::{Disk, Locking, NewFile, ReadAt, Store};

static REMOTE: OnceLock<Arc<dyn Store>> = OnceLock::new();

/// Makes a store serve all URLs of this process. A program calls it once, before it opens anything; later
/// calls change nothing.
pub fn register(remote: Arc<dyn Store>) {
    // The first one stays.
    let _registered = REMOTE.set(remote);
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

/// The store of each path: that of URLs if it is one, else the disk.
#[derive(Clone, Copy, Debug, Default)]
pub struct ByPath;

impl ByPath {
    /// The store behind the trait.
    pub fn store() -> Arc<dyn Store> {
        Arc::new(Self)
    }
}

fn of(path: &Path) -> io::Result<&'static dyn Store> {
    if !is_url(path) {
        return Ok(&Disk);
    }
    let remote = REMOTE.get().map(AsRef::as_ref);
    remote.ok_or_else(|| io::Error::new(io::ErrorKind::Unsupported, "this program reads no URLs"))
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
        of(path)?.read(path)
    }

    fn open(&self, path: &Path) -> io::Result<Box<dyn Read>> {
        of(path)?.open(path)
    }

    fn open_at(&self, path: &Path) -> io::Result<Arc<dyn ReadAt>> {
        of(path)?.open_at(path)
    }

    fn size(&self, path: &Path) -> io::Result<u64> {
        of(path)?.size(path)
    }

    fn hash(&self, path: &Path) -> io::Result<String> {
        of(path)?.hash(path)
    }

    fn list(&self, path: &Path) -> io::Result<Vec<(PathBuf, bool)>> {
        of(path)?.list(path)
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
        of(path)?.difference(path, bytes, blake3)
    }

    fn expect(&self, path: &Path, bytes: u64, blake3: &str) {
        if let Ok(store) = of(path) {
            store.expect(path, bytes, blake3);
        }
    }

    fn files_below(&self, folder: &Path) -> io::Result<Vec<PathBuf>> {
        of(folder)?.files_below(folder)
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
        assert_eq!(
            file.to_str().map(|text| text.replace('\\', "/")).as_deref(),
            Some("s3://bucket/clips/data/motions/train.parquet")
        );
        assert_eq!(file.with_file_name("x").parent(), file.parent());
        let error = ByPath.read(&file).expect_err("nothing is registered");
        assert_eq!(error.kind(), io::ErrorKind::Unsupported);
    }
}
