//! A local cache of blocks of remote files. Its key is the hash of the file's content and the number of the block.

use std::fs::{self, File, FileTimes};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::SystemTime;

use bytes::Bytes;

/// Bytes of a block; the last one of a file may be shorter.
pub(crate) const BLOCK: u64 = 1 << 20;

/// Blocks of files, below a folder. When the size limit is reached, the least recently used ones are removed. Processes
/// may share the folder.
#[derive(Debug)]
pub(crate) struct Cache {
    folder: PathBuf,
    max_bytes: u64,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    /// Bytes written since the folder was last measured; `None` if it was never measured.
    since: Option<u64>,
    measured: u64,
}

/// Length of the hash that is stored before the bytes of a block.
const HASH_LEN: usize = blake3::OUT_LEN;

impl Cache {
    pub(crate) fn new(folder: &Path, max_bytes: u64) -> Self {
        Self {
            folder: folder.join("blocks"),
            max_bytes,
            state: Mutex::default(),
        }
    }

    fn path(&self, hash: &str, block: u64) -> PathBuf {
        let prefix = hash.get(..2).unwrap_or("00");
        self.folder.join(prefix).join(format!("{hash}.{block}"))
    }

    /// Returns a block if it is cached and undamaged.
    pub(crate) fn get(&self, hash: &str, block: u64, length: u64) -> Option<Bytes> {
        let path = self.path(hash, block);
        let stored = Bytes::from(fs::read(&path).ok()?);
        let (stated, bytes) = stored.split_at_checked(HASH_LEN)?;
        if bytes.len() as u64 != length || blake3::hash(bytes).as_bytes() != stated {
            // A removed block is fetched again.
            let _removed = fs::remove_file(&path);
            return None;
        }
        let now = FileTimes::new().set_modified(SystemTime::now());
        // If the time cannot be set, the block is only removed earlier.
        let _set = File::options()
            .write(true)
            .open(&path)
            .and_then(|file| file.set_times(now));
        Some(stored.slice(HASH_LEN..))
    }

    /// Stores a block. A failure is ignored, because the caller already has the bytes.
    pub(crate) fn put(&self, hash: &str, block: u64, bytes: &[u8]) {
        if self.write(hash, block, bytes).is_ok() {
            self.shrink((HASH_LEN + bytes.len()) as u64);
        }
    }

    fn write(&self, hash: &str, block: u64, bytes: &[u8]) -> io::Result<()> {
        let path = self.path(hash, block);
        let folder = path.parent().unwrap_or(&self.folder);
        fs::create_dir_all(folder)?;
        let mut file = tempfile::NamedTempFile::new_in(folder)?;
        file.write_all(blake3::hash(bytes).as_bytes())?;
        file.write_all(bytes)?;
        file.persist(path)?;
        Ok(())
    }

    pub(crate) fn forget(&self, hash: &str, length: u64) {
        for block in 0..length.div_ceil(BLOCK) {
            // The block may already be absent.
            let _removed = fs::remove_file(self.path(hash, block));
        }
    }

    /// Counts new bytes, and removes the least recently used blocks if there are too many. The folder is measured now
    /// and then, because other processes write to it too.
    fn shrink(&self, written: u64) {
        let Ok(mut state) = self.state.lock() else {
            return;
        };
        let since = state.since.unwrap_or(self.max_bytes) + written;
        state.since = Some(since);
        if since < self.max_bytes / 16 && state.measured + since <= self.max_bytes {
            return;
        }
        let mut blocks = blocks_below(&self.folder);
        blocks.sort();
        let mut total: u64 = blocks.iter().map(|(_, _, bytes)| bytes).sum();
        // Free more than needed, so that not every new block measures the folder.
        let allowed = self.max_bytes - self.max_bytes / 8;
        if total > self.max_bytes {
            for (_, path, bytes) in blocks {
                if total <= allowed {
                    break;
                }
                if fs::remove_file(&path).is_ok() {
                    total -= bytes;
                }
            }
        }
        *state = State {
            since: Some(0),
            measured: total,
        };
    }
}

/// Time of last use, path and size of each block.
fn blocks_below(folder: &Path) -> Vec<(SystemTime, PathBuf, u64)> {
    let entries = |folder: &Path| fs::read_dir(folder).into_iter().flatten().flatten();
    let mut blocks = Vec::new();
    for folder in entries(folder) {
        for file in entries(&folder.path()) {
            let metadata = file.metadata().and_then(|m| Ok((m.modified()?, m.len())));
            if let Ok((used, bytes)) = metadata {
                blocks.push((used, file.path(), bytes));
            }
        }
    }
    blocks
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    /// Sets when a block was last used.
    fn set_used(cache: &Cache, hash: &str, block: u64, seconds: u64) {
        let time = SystemTime::UNIX_EPOCH + Duration::from_secs(seconds);
        let file = File::options().write(true).open(cache.path(hash, block));
        let times = FileTimes::new().set_modified(time);
        file.expect("there").set_times(times).expect("set");
    }

    #[test]
    fn a_block_is_returned_as_it_was_kept_or_not_at_all() {
        let dir = tempfile::tempdir().expect("a folder");
        let cache = Cache::new(dir.path(), 1 << 30);
        cache.put("abcd", 3, b"some bytes");
        let other = Cache::new(dir.path(), 1 << 30);
        let kept = other.get("abcd", 3, 10).expect("kept");
        assert_eq!(kept[..], b"some bytes"[..]);
        assert_eq!(other.get("abcd", 4, 10), None);
        assert_eq!(other.get("abcd", 3, 11), None, "of another length");
        cache.put("abcd", 3, b"some bytes");
        let path = cache.path("abcd", 3);
        let mut bytes = fs::read(&path).expect("there");
        bytes[HASH_LEN + 2] ^= 1;
        fs::write(&path, bytes).expect("written");
        assert_eq!(cache.get("abcd", 3, 10), None, "damaged");
        assert!(!path.exists());
    }

    #[test]
    fn blocks_that_were_not_used_for_longest_go_first() {
        let dir = tempfile::tempdir().expect("a folder");
        let size = (HASH_LEN + 100) as u64;
        let cache = Cache::new(dir.path(), 8 * size);
        for block in 0..8 {
            cache.put("ab", block, &[0; 100]);
            set_used(&cache, "ab", block, 1000 + block);
        }
        assert_eq!(blocks_below(&cache.folder).len(), 8);
        // The oldest two are used again.
        for block in [0, 1] {
            assert!(cache.get("ab", block, 100).is_some());
        }
        cache.put("ab", 8, &[0; 100]);
        let left: Vec<u64> = (0..9)
            .filter(|block| cache.path("ab", *block).exists())
            .collect();
        assert_eq!(left, [0, 1, 4, 5, 6, 7, 8]);
    }
}
