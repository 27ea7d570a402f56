//! Where datasets and sources are kept: on a disk, or at a URL.
//!
//! Every file appears complete or not at all: on a disk a temporary file is renamed, and an object store receives it in
//! one request. Tests replace the [`Store`] by one whose operations fail.

mod by_path;
mod disk;

use std::fmt::Debug;
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, LazyLock};

use bytes::Bytes;

pub use self::by_path::{ByPath, Mounted, is_url, mount, register};
pub use self::disk::Disk;
use crate::Error;

/// A file being written. It appears when it is published; if it is dropped before, it never does.
pub trait NewFile: Write + Send {
    /// Makes the file appear under its name, whole and durable, in place of any file of that name.
    ///
    /// # Errors
    /// The storage refuses or fails. The file may exist nevertheless, if only the answer was lost.
    fn publish(self: Box<Self>) -> io::Result<()>;

    /// Makes the file appear unless a file with that name exists. If several writers do so at the same time, one
    /// succeeds.
    ///
    /// # Errors
    /// [`io::ErrorKind::AlreadyExists`], or as [`NewFile::publish`].
    fn publish_new(self: Box<Self>) -> io::Result<()>;
}

/// A file that several threads can read, each at its own offset.
pub trait ReadAt: Debug + Send + Sync {
    /// Size in bytes.
    fn size(&self) -> u64;

    /// Fills a buffer from an offset of the file.
    ///
    /// # Errors
    /// The file ends before, or the storage fails.
    fn read_exact_at(&self, buffer: &mut [u8], at: u64) -> io::Result<()>;

    /// The bytes of several ranges, in the order given. A distant storage reads ranges that lie near each other in one
    /// request.
    ///
    /// # Errors
    /// As [`ReadAt::read_exact_at`].
    fn read_ranges(&self, ranges: &[Range<u64>]) -> io::Result<Vec<Bytes>> {
        let read = |range: &Range<u64>| {
            let length = range.end.saturating_sub(range.start);
            // The length comes from the file and may be wrong: check it before reserving memory.
            if range.end > self.size() {
                return Err(io::Error::from(io::ErrorKind::UnexpectedEof));
            }
            let mut buffer = vec![0; usize::try_from(length).map_err(io::Error::other)?];
            self.read_exact_at(&mut buffer, range.start)?;
            Ok(Bytes::from(buffer))
        };
        ranges.iter().map(read).collect()
    }

    /// Whether every read costs a request; readers then read all they need at once.
    fn is_distant(&self) -> bool {
        false
    }
}

/// Reads a file from a position that can be set. A distant file is read in pieces of a megabyte.
#[derive(Clone, Debug)]
pub struct Reader {
    file: Arc<dyn ReadAt>,
    at: u64,
    /// The piece read last, and its offset.
    piece: (u64, Bytes),
}

/// Size in bytes of the pieces in which a distant file is read. Their offsets are multiples of it.
const PIECE: u64 = 1 << 20;

impl Reader {
    /// Starts at the beginning of a file.
    pub fn new(file: Arc<dyn ReadAt>) -> Self {
        Self {
            file,
            at: 0,
            piece: (0, Bytes::new()),
        }
    }
}

impl Read for Reader {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let left = self.file.size().saturating_sub(self.at);
        let length = buffer
            .len()
            .min(usize::try_from(left).unwrap_or(usize::MAX));
        if length == 0 {
            return Ok(0);
        }
        let length = if self.file.is_distant() {
            let (start, piece) = &self.piece;
            if !(*start..start + piece.len() as u64).contains(&self.at) {
                let start = self.at / PIECE * PIECE;
                let range = start..self.file.size().min(start + PIECE);
                let piece = self.file.read_ranges(std::slice::from_ref(&range))?;
                self.piece = (start, piece.into_iter().next().unwrap_or_default());
            }
            let (start, piece) = &self.piece;
            let from = usize::try_from(self.at - start).unwrap_or(usize::MAX);
            let bytes = piece.get(from..).unwrap_or_default();
            let length = length.min(bytes.len());
            buffer[..length].copy_from_slice(&bytes[..length]);
            length
        } else {
            self.file.read_exact_at(&mut buffer[..length], self.at)?;
            length
        };
        self.at += length as u64;
        Ok(length)
    }
}

impl Seek for Reader {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let at = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::End(by) => self.file.size().checked_add_signed(by),
            SeekFrom::Current(by) => self.at.checked_add_signed(by),
        };
        self.at = at.ok_or(io::ErrorKind::InvalidInput)?;
        Ok(self.at)
    }
}

/// A lock of a dataset. Dropping it releases the lock.
pub trait Lock: Debug + Send + Sync {}

/// Result of an attempt to lock a dataset.
#[derive(Debug)]
pub enum Locking {
    /// This run holds the lock until the value is dropped.
    Held(Box<dyn Lock>),
    /// Another run holds the lock.
    Taken {
        /// Description of that run, from the lock.
        holder: String,
    },
    /// The storage has no locks: of two runs that commit a version, the later one fails.
    NoLocks,
}

/// A storage of files.
pub trait Store: Debug + Send + Sync {
    /// Creates a folder and its parents. Object stores have no folders.
    ///
    /// # Errors
    /// The storage refuses or fails. The same holds for every operation below.
    fn create_dir_all(&self, path: &Path) -> io::Result<()>;
    /// Begins a file, which appears when it is published.
    fn create(&self, path: &Path) -> io::Result<Box<dyn NewFile>>;
    /// Renames a file, replacing any file of that name. On an object store this is a copy and a removal.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;
    /// The bytes of a file.
    fn read(&self, path: &Path) -> io::Result<Vec<u8>>;
    /// Opens a file to be read from its beginning.
    fn open(&self, path: &Path) -> io::Result<Box<dyn Read>>;
    /// Opens a file to be read at offsets.
    fn open_at(&self, path: &Path) -> io::Result<Arc<dyn ReadAt>>;
    /// Size of a file in bytes. For a folder, the error is `NotFound`.
    fn size(&self, path: &Path) -> io::Result<u64>;
    /// BLAKE3 of a file, hexadecimal.
    fn hash(&self, path: &Path) -> io::Result<String>;
    /// The entries of a folder, sorted, and whether each is a folder. For a missing folder, the error is `NotFound`; an
    /// object store returns no entries.
    fn list(&self, path: &Path) -> io::Result<Vec<(PathBuf, bool)>>;
    /// Removes a file.
    fn remove_file(&self, path: &Path) -> io::Result<()>;
    /// Removes a folder and all in it; a missing folder is no error.
    fn remove_dir_all(&self, path: &Path) -> io::Result<()>;
    /// Locks a dataset's folder against other runs, and stores `holder` for their messages.
    fn lock(&self, folder: &Path, holder: &str) -> io::Result<Locking>;

    /// How a file of a dataset differs from its manifest; `None` if it does not. A disk hashes the file. An object
    /// store compares the size, as reading it would cost as much as using it; there the hash is compared when the file
    /// is read whole.
    fn difference(&self, path: &Path, _bytes: u64, blake3: &str) -> io::Result<Option<String>> {
        let found = self.hash(path)?;
        Ok((found != blake3).then(|| format!("BLAKE3 expected {blake3}, found {found}")))
    }

    /// Announces the size and hash of a committed file. An object store then need not request its size, and can use
    /// cached bytes with this hash.
    fn expect(&self, _path: &Path, _bytes: u64, _blake3: &str) {}

    /// All files below a folder, sorted.
    fn files_below(&self, folder: &Path) -> io::Result<Vec<PathBuf>> {
        let mut files = Vec::new();
        let mut folders = vec![folder.to_owned()];
        while let Some(folder) = folders.pop() {
            for (path, is_dir) in self.list(&folder)? {
                if is_dir {
                    folders.push(path);
                } else {
                    files.push(path);
                }
            }
        }
        files.sort();
        Ok(files)
    }
}

/// The beginning of a file name. It is short enough that a temporary name made from it fits into the 255 bytes that
/// file systems take.
pub fn begin_of_name(name: &str) -> &str {
    const LENGTH: usize = 180;
    &name[..name.floor_char_boundary(LENGTH)]
}

/// A temporary name beside a path. No other writer uses it, in this process, in another one, or on another machine that
/// shares the folder.
pub fn temporary_beside(path: &Path) -> PathBuf {
    // `RandomState` has other keys in every process.
    static PROCESS: LazyLock<u64> = LazyLock::new(|| RandomState::new().build_hasher().finish());
    static COUNT: AtomicU64 = AtomicU64::new(0);
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let name = begin_of_name(&name);
    let (process, count) = (*PROCESS, COUNT.fetch_add(1, Ordering::Relaxed));
    path.with_file_name(format!(".{name}.{process:016x}-{count}.tmp"))
}

/// Whether a file name is one that [`temporary_beside`] makes.
pub(crate) fn is_temporary(name: &str) -> bool {
    let inner = name
        .strip_prefix('.')
        .and_then(|name| name.strip_suffix(".tmp"));
    let numbers = inner
        .and_then(|inner| inner.rsplit_once('.'))
        .and_then(|(_, numbers)| numbers.split_once('-'));
    numbers.is_some_and(|(process, count)| {
        process.len() == 16
            && process.bytes().all(|byte| byte.is_ascii_hexdigit())
            && !count.is_empty()
            && count.bytes().all(|byte| byte.is_ascii_digit())
    })
}

/// The path of a table's file while the newest version of its dataset does not name it: `data/masks/train.parquet`
/// becomes `meta/aside/masks/train`, which no search for Parquet files finds. `None` if the file belongs to no table.
pub fn aside(path: &Path) -> Option<PathBuf> {
    let name = path.file_name()?.to_str()?.strip_suffix(".parquet")?;
    let table = path.parent()?;
    let data = table.parent()?;
    let beside = data.parent()?.join("meta").join("aside");
    (data.file_name()? == "data").then(|| {
        beside
            .join(table.file_name().unwrap_or_default())
            .join(name)
    })
}

/// Turns the error that a file or folder does not exist into `None`.
///
/// # Errors
/// Any other error of `done`.
pub fn if_exists<T>(done: io::Result<T>) -> io::Result<Option<T>> {
    match done {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        done => done.map(Some),
    }
}

/// Calls `act` with the path of a file, or with the path that a commit of its dataset has moved it to.
///
/// # Errors
/// The error of `act`; the first one if the file does not exist.
pub fn wherever<T>(path: &Path, act: impl Fn(&Path) -> io::Result<T>) -> io::Result<T> {
    let is_missing = |error: &io::Error| error.kind() == io::ErrorKind::NotFound;
    let missing = match act(path) {
        Err(error) if is_missing(&error) => error,
        done => return done,
    };
    let Some(aside) = aside(path) else {
        return Err(missing);
    };
    match act(&aside) {
        // A commit may have moved the file to its final place meanwhile.
        Err(error) if is_missing(&error) => act(path).map_err(|_| missing),
        done => done,
    }
}

/// Writes a file on disk whole or not at all. If two writers do so, the later one wins.
///
/// # Errors
/// The file cannot be created, written or renamed; the temporary file is then removed.
pub fn replace_file(path: &Path, content: &[u8]) -> io::Result<()> {
    let mut file = Disk.create(path)?;
    file.write_all(content)?;
    file.publish()
}

/// Creates a folder and its parents.
pub(crate) fn create_folder(store: &dyn Store, folder: &Path) -> Result<(), Error> {
    let created = store.create_dir_all(folder);
    created.map_err(Error::io("create folder", folder))
}

/// Writes a file whole or not at all.
///
/// # Errors
/// Any step fails.
pub(crate) fn write_bytes(store: &dyn Store, path: &Path, bytes: &[u8]) -> Result<(), Error> {
    let file = unpublished(store, path, bytes)?;
    file.publish().map_err(Error::io("write", path))
}

fn unpublished(store: &dyn Store, path: &Path, bytes: &[u8]) -> Result<Box<dyn NewFile>, Error> {
    let mut file = store.create(path).map_err(Error::io("create", path))?;
    file.write_all(bytes).map_err(Error::io("write", path))?;
    Ok(file)
}

/// Writes a file whole unless a file with that name exists, and returns whether it did.
///
/// # Errors
/// Any step fails.
pub(crate) fn write_new(store: &dyn Store, path: &Path, bytes: &[u8]) -> Result<bool, Error> {
    match unpublished(store, path, bytes)?.publish_new() {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Ok(false),
        Err(error) => Err(Error::io("write", path)(error)),
    }
}
