//! Writers of source formats, the inverse of the readers: generated and exported motions are ingested like
//! any other file.

pub mod amass;
pub mod bvh;
mod folder;
pub mod gltf;
pub mod motionfix;

use std::fs::File;
use std::io::{self, Write};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use datasets_spec::store::begin_of_name;

use crate::Error;

pub use self::folder::NewFolder;

/// Writes a file whole or not at all: to a temporary name of its own beside it, synced, then renamed. Of two
/// writers the later one wins.
///
/// # Errors
/// The file cannot be created, written or renamed; the temporary file is then removed.
pub fn replace_file(path: &Path, content: &[u8]) -> io::Result<()> {
    static WRITTEN: AtomicU64 = AtomicU64::new(0);
    let name = path.file_name().ok_or(io::ErrorKind::InvalidInput)?;
    let (name, process) = (name.to_string_lossy(), std::process::id());
    let number = WRITTEN.fetch_add(1, Ordering::Relaxed);
    let name = begin_of_name(&name);
    let staged = path.with_file_name(format!(".{name}.{process}.{number}.tmp"));
    let write = || {
        let mut file = File::create(&staged)?;
        file.write_all(content)?;
        file.sync_all()?;
        std::fs::rename(&staged, path)
    };
    write().inspect_err(|_| {
        // The temporary file may not exist; the first error is returned.
        let _removed = std::fs::remove_file(&staged);
    })
}

/// Whether something is where an export would be written.
pub(crate) fn is_occupied(out: &Path) -> bool {
    match std::fs::read_dir(out) {
        Ok(mut entries) => entries.next().is_some(),
        Err(_) => out.exists(),
    }
}

/// Renames a complete folder to `out`. An empty folder of that name is replaced.
pub(crate) fn publish(folder: &Path, out: &Path) -> Result<(), Error> {
    if out.exists() {
        std::fs::remove_dir(out).map_err(Error::io("replace", out))?;
    }
    std::fs::rename(folder, out).map_err(Error::io("rename to", out))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_replaced_and_nothing_is_left_beside_it() {
        let dir = tempfile::tempdir().expect("temporary folder");
        let path = dir.path().join("walk.bvh");
        replace_file(&path, b"old and longer").expect("written");
        replace_file(&path, b"new").expect("replaced");
        assert_eq!(std::fs::read(&path).expect("there"), b"new");
        assert_eq!(std::fs::read_dir(dir.path()).expect("listed").count(), 1);
        assert!(replace_file(&dir.path().join("missing/walk.bvh"), b"x").is_err());
    }

    #[test]
    fn two_writers_leave_one_of_their_files_whole() {
        let dir = tempfile::tempdir().expect("temporary folder");
        let path = dir.path().join("walk.bvh");
        let contents = [vec![b'a'; 100_000], vec![b'b'; 50_000]];
        std::thread::scope(|scope| {
            for content in &contents {
                scope.spawn(|| {
                    for _ in 0..50 {
                        replace_file(&path, content).expect("written");
                    }
                });
            }
        });
        assert!(contents.contains(&std::fs::read(&path).expect("there")));
        assert_eq!(std::fs::read_dir(dir.path()).expect("listed").count(), 1);
    }
}
