//! The file system.

use std::fs::{self, File, TryLockError};
use std::io::{self, Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::{Lock, Locking, NewFile, ReadAt, Store, if_exists, temporary_beside};

/// The file system.
#[derive(Clone, Copy, Debug, Default)]
pub struct Disk;

impl Disk {
    /// The file system as a trait object.
    pub fn store() -> Arc<dyn Store> {
        Arc::new(Self)
    }
}

/// Path in a dataset of the file that a run locks. Its text names that run.
const LOCK: &str = "meta/LOCK";

impl Store for Disk {
    fn create_dir_all(&self, path: &Path) -> io::Result<()> {
        fs::create_dir_all(path)
    }

    fn create(&self, path: &Path) -> io::Result<Box<dyn NewFile>> {
        let staged = temporary_beside(path);
        Ok(Box::new(Staged {
            file: Some(File::create(&staged)?),
            staged,
            path: path.to_owned(),
        }))
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        fs::rename(from, to)?;
        sync_folder_of(to)
    }

    fn read(&self, path: &Path) -> io::Result<Vec<u8>> {
        fs::read(path)
    }

    fn open(&self, path: &Path) -> io::Result<Box<dyn Read>> {
        Ok(Box::new(File::open(path)?))
    }

    fn open_at(&self, path: &Path) -> io::Result<Arc<dyn ReadAt>> {
        let file = File::open(path)?;
        let size = file.metadata()?.len();
        Ok(Arc::new(Positioned { file, size }))
    }

    fn size(&self, path: &Path) -> io::Result<u64> {
        let metadata = fs::metadata(path)?;
        if metadata.is_dir() {
            return Err(io::ErrorKind::NotFound.into());
        }
        Ok(metadata.len())
    }

    fn hash(&self, path: &Path) -> io::Result<String> {
        let mut hasher = blake3::Hasher::new();
        hasher.update_mmap(path)?;
        Ok(hasher.finalize().to_hex().to_string())
    }

    fn list(&self, path: &Path) -> io::Result<Vec<(PathBuf, bool)>> {
        let mut entries = Vec::new();
        for entry in fs::read_dir(path)? {
            let path = entry?.path();
            let is_dir = path.is_dir();
            entries.push((path, is_dir));
        }
        entries.sort();
        Ok(entries)
    }

    fn remove_file(&self, path: &Path) -> io::Result<()> {
        fs::remove_file(path)
    }

    fn remove_dir_all(&self, path: &Path) -> io::Result<()> {
        if_exists(fs::remove_dir_all(path)).map(|_| ())
    }

    fn lock(&self, folder: &Path, holder: &str) -> io::Result<Locking> {
        let path = folder.join(LOCK);
        let file = File::options()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(&path)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let holder = fs::read_to_string(&path).unwrap_or_default();
                let holder = holder.trim().to_owned();
                return Ok(Locking::Taken { holder });
            }
            Err(TryLockError::Error(error)) => return Err(error),
        }
        let mut lock = FileLock(file);
        lock.0.set_len(0)?;
        lock.0.rewind()?;
        writeln!(lock.0, "{holder}")?;
        Ok(Locking::Held(Box::new(lock)))
    }
}

#[derive(Debug)]
struct FileLock(File);

impl Lock for FileLock {}

impl Drop for FileLock {
    /// Unlocks explicitly: a child process that another thread is starting inherits the handle, and with it the lock,
    /// until it executes its program.
    fn drop(&mut self) {
        // On failure, closing the file unlocks it.
        let _closed = self.0.unlock();
    }
}

/// A temporary file beside the one that it becomes.
#[derive(Debug)]
struct Staged {
    /// `None` once the file is renamed.
    file: Option<File>,
    staged: PathBuf,
    path: PathBuf,
}

impl Staged {
    fn synced(&self) -> io::Result<()> {
        match &self.file {
            Some(file) => file.sync_all(),
            None => Ok(()),
        }
    }
}

impl Write for Staged {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match &mut self.file {
            Some(file) => file.write(bytes),
            None => Err(io::ErrorKind::BrokenPipe.into()),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl NewFile for Staged {
    fn publish(mut self: Box<Self>) -> io::Result<()> {
        self.synced()?;
        fs::rename(&self.staged, &self.path)?;
        self.file = None;
        sync_folder_of(&self.path)
    }

    fn publish_new(mut self: Box<Self>) -> io::Result<()> {
        use io::ErrorKind::{AlreadyExists, PermissionDenied, Unsupported};

        self.synced()?;
        match fs::hard_link(&self.staged, &self.path) {
            // The temporary name is removed when this is dropped.
            Ok(()) => sync_folder_of(&self.path),
            // Some file systems have no hard links. On these, only the lock keeps other runs out.
            Err(error) if matches!(error.kind(), Unsupported | PermissionDenied) => {
                if self.path.exists() {
                    return Err(AlreadyExists.into());
                }
                fs::rename(&self.staged, &self.path)?;
                self.file = None;
                sync_folder_of(&self.path)
            }
            Err(error) => Err(error),
        }
    }
}

impl Drop for Staged {
    fn drop(&mut self) {
        if self.file.take().is_some() {
            // The failure itself is reported already; the next run removes leftovers.
            let _removed = fs::remove_file(&self.staged);
        }
    }
}

/// Syncs the folder of a file, which makes the file's new name durable.
fn sync_folder_of(path: &Path) -> io::Result<()> {
    // On other systems a folder cannot be opened as a file, and a rename is durable by itself.
    if cfg!(unix) {
        let folder = path.parent().filter(|path| !path.as_os_str().is_empty());
        File::open(folder.unwrap_or(Path::new(".")))?.sync_all()?;
    }
    Ok(())
}

/// A file that is read at offsets. Cloned handles share one position, so two threads that seek and then read
/// would get each other's bytes.
#[derive(Debug)]
struct Positioned {
    file: File,
    size: u64,
}

impl Positioned {
    fn read_at(&self, buffer: &mut [u8], at: u64) -> io::Result<usize> {
        #[cfg(unix)]
        return std::os::unix::fs::FileExt::read_at(&self.file, buffer, at);
        #[cfg(windows)]
        return std::os::windows::fs::FileExt::seek_read(&self.file, buffer, at);
    }
}

impl ReadAt for Positioned {
    fn size(&self) -> u64 {
        self.size
    }

    fn read_exact_at(&self, buffer: &mut [u8], at: u64) -> io::Result<()> {
        let mut done = 0;
        while done < buffer.len() {
            match self.read_at(&mut buffer[done..], at + done as u64)? {
                0 => return Err(io::ErrorKind::UnexpectedEof.into()),
                read => done += read,
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write(path: &Path, text: &[u8]) -> Box<dyn NewFile> {
        let mut file = Disk.create(path).expect("begins");
        file.write_all(text).expect("writes");
        file
    }

    #[test]
    fn a_file_appears_whole_and_only_when_it_is_published() {
        let dir = tempfile::tempdir().expect("a folder");
        let path = dir.path().join("file");
        drop(write(&path, b"dropped"));
        assert_eq!(Disk.list(dir.path()).expect("listed"), []);
        write(&path, b"first").publish().expect("appears");
        write(&path, b"second").publish().expect("replaces");
        assert_eq!(Disk.read(&path).expect("there"), b"second");
        let error = write(&path, b"third").publish_new().expect_err("is there");
        assert_eq!(error.kind(), io::ErrorKind::AlreadyExists);
        assert_eq!(Disk.read(&path).expect("there"), b"second");
        let other = dir.path().join("other");
        write(&other, b"new").publish_new().expect("appears");
        assert_eq!(Disk.list(dir.path()).expect("listed").len(), 2);
    }

    #[test]
    fn of_several_writers_of_a_new_file_one_succeeds() {
        let dir = tempfile::tempdir().expect("a folder");
        let path = dir.path().join("file");
        let write = |number: u8| write(&path, &[number]).publish_new().is_ok();
        let won: Vec<bool> = std::thread::scope(|scope| {
            let writers: Vec<_> = (0..8).map(|n| scope.spawn(move || write(n))).collect();
            let done = writers.into_iter().map(|writer| writer.join());
            done.map(|won| won.expect("no panic")).collect()
        });
        assert_eq!(won.iter().filter(|won| **won).count(), 1);
        let winner = won.iter().position(|won| *won).expect("one") as u8;
        assert_eq!(Disk.read(&path).expect("there"), [winner]);
        assert_eq!(Disk.list(dir.path()).expect("listed").len(), 1);
    }

    #[test]
    fn a_file_is_replaced_whole_and_nothing_is_left_beside_it() {
        let dir = tempfile::tempdir().expect("temporary folder");
        let path = dir.path().join("walk.bvh");
        let contents = [vec![b'a'; 100_000], vec![b'b'; 50_000]];
        std::thread::scope(|scope| {
            for content in &contents {
                scope.spawn(|| {
                    for _ in 0..50 {
                        crate::store::replace_file(&path, content).expect("written");
                    }
                });
            }
        });
        assert!(contents.contains(&std::fs::read(&path).expect("there")));
        assert_eq!(std::fs::read_dir(dir.path()).expect("listed").count(), 1);
        crate::store::replace_file(&path, b"new").expect("replaced");
        assert_eq!(std::fs::read(&path).expect("there"), b"new");
        assert_eq!(std::fs::read_dir(dir.path()).expect("listed").count(), 1);
        assert!(crate::store::replace_file(&dir.path().join("missing/walk.bvh"), b"x").is_err());
    }
}
