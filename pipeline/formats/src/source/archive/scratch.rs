//! A folder for unpacked archives.

use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

use crate::Error;

/// Prefix of the names of scratch folders.
const PREFIX: &str = "stance-unpacked-";
/// The file in a scratch folder that its process keeps locked.
const LOCK: &str = "LOCK";

/// A folder of this process in the system's temporary folder. It is created on first use and removed on drop. Creating
/// one removes the folders of killed processes.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    made: Mutex<Option<(PathBuf, File)>>,
    count: AtomicU64,
}

impl Scratch {
    /// An unused path in the folder.
    ///
    /// # Errors
    /// The folder cannot be made.
    pub(super) fn file(&self) -> Result<PathBuf, Error> {
        let mut made = self.made.lock().unwrap_or_else(PoisonError::into_inner);
        if made.is_none() {
            let parent = std::env::temp_dir();
            remove_abandoned(&parent);
            let folder = make(&parent).map_err(|error| no_room(&parent, &error))?;
            *made = Some(folder);
        }
        let (folder, _) = made.as_ref().expect("made above");
        let number = self.count.fetch_add(1, Ordering::Relaxed);
        Ok(folder.join(number.to_string()))
    }
}

/// The error of a scratch folder that cannot be written.
pub(super) fn no_room(path: &Path, error: &io::Error) -> Error {
    Error::Scratch {
        path: path.to_owned(),
        reason: error.to_string(),
    }
}

/// Creates a folder with a locked file in it.
fn make(parent: &Path) -> io::Result<(PathBuf, File)> {
    loop {
        let folder = tempfile::Builder::new().prefix(PREFIX).tempdir_in(parent)?;
        let path = folder.path().join(LOCK);
        let Ok(file) = File::create(&path) else {
            // Another process mistook the folder for an abandoned one.
            continue;
        };
        if file.try_lock().is_ok() && path.exists() {
            return Ok((folder.keep(), file));
        }
    }
}

/// Removes folders of processes that ended. The lock of such a folder is free.
fn remove_abandoned(parent: &Path) {
    for entry in fs::read_dir(parent).into_iter().flatten().flatten() {
        let is_ours = entry.file_name().to_string_lossy().starts_with(PREFIX);
        if !is_ours || !entry.file_type().is_ok_and(|kind| kind.is_dir()) {
            continue;
        }
        let folder = entry.path();
        let is_held = match File::options().write(true).open(folder.join(LOCK)) {
            Ok(file) => matches!(file.try_lock(), Err(TryLockError::WouldBlock)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                // The folder is not locked yet, or its process was killed before that: remove it only if it is empty.
                let _removed = fs::remove_dir(&folder);
                true
            }
            // The folder belongs to another user.
            Err(_) => true,
        };
        if !is_held {
            // A folder that cannot be removed now is removed by the next run.
            let _removed = fs::remove_dir_all(&folder);
        }
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let made = self.made.get_mut().unwrap_or_else(PoisonError::into_inner);
        if let Some((folder, lock)) = made.take() {
            // The next run removes what is left.
            let _removed = fs::remove_dir_all(&folder);
            drop(lock);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_without_its_process_is_removed_and_one_in_use_stays() {
        let parent = tempfile::tempdir().expect("a folder");
        let (used, lock) = make(parent.path()).expect("made");
        let (killed, of_killed) = make(parent.path()).expect("made");
        drop(of_killed);
        fs::write(killed.join("0"), "unpacked").expect("written");
        let other = parent.path().join("other");
        fs::create_dir(&other).expect("made");
        remove_abandoned(parent.path());
        assert!(used.exists() && !killed.exists() && other.exists());
        drop(lock);
    }
}
