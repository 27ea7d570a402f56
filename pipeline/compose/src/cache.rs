//! The folder that caches the frames of motions from which edits are composed.

use std::ffi::OsString;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use datasets_spec::cache;

/// Default limit on the bytes of all files of frames: 3,000 hours at 20 fps.
const DEFAULT_KEPT: u64 = 64_000_000_000;
/// Environment variable that sets [`FrameCache::kept`].
const SIZE: &str = "STANCE_CACHE_SIZE";

/// Folder of files with the frames from which edits are composed. Results do not depend on it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameCache {
    /// The folder. It should be on a disk of this machine.
    pub folder: PathBuf,
    /// Limit on the bytes of all files in the folder; adding a file removes the least recently used ones.
    pub kept: u64,
}

impl Default for FrameCache {
    fn default() -> Self {
        Self {
            folder: std::env::temp_dir().join("stance").join("frames"),
            kept: DEFAULT_KEPT,
        }
    }
}

impl FrameCache {
    /// Settings from the environment; `get` reads a variable. Files lie in the folder `frames` of the
    /// [cache](datasets_spec::cache::folder), else of the folder of temporary files. `STANCE_CACHE_SIZE` is the limit in
    /// bytes, such as `8GB`.
    ///
    /// # Errors
    /// `STANCE_CACHE_SIZE` is not a size.
    pub fn from_environment(get: impl Fn(&str) -> Option<OsString>) -> Result<Self, String> {
        let otherwise = Self::default();
        let kept = match get(SIZE).filter(|value| !value.is_empty()) {
            None => otherwise.kept,
            Some(found) => cache::parse_bytes(&found.to_string_lossy()).ok_or_else(|| {
                format!("{SIZE}: {found:?} is no size; write a number and a unit, such as 2GB")
            })?,
        };
        Ok(Self {
            folder: cache::folder(get).map_or(otherwise.folder, |cache| cache.join("frames")),
            kept,
        })
    }

    pub(super) fn file(&self, key: &str) -> PathBuf {
        self.folder.join(format!("{key}.frames"))
    }

    /// Updates the time of last use of a file, so that unused files are removed first.
    pub(super) fn touch(path: &Path) {
        // A read-only file can still be read.
        if let Ok(file) = File::options().append(true).open(path) {
            let _touched = file.set_modified(SystemTime::now());
        }
    }

    /// Removes the least recently used files, except `added`, until the rest fits the size limit.
    pub(super) fn remove_others(&self, added: &Path) {
        let Ok(entries) = fs::read_dir(&self.folder) else {
            return;
        };
        let mut files: Vec<(SystemTime, u64, PathBuf)> = entries
            .flatten()
            .filter_map(|entry| {
                let (path, known) = (entry.path(), entry.metadata().ok()?);
                let extension = path.extension()?;
                let is_ours = extension == "frames" || extension == "part";
                is_ours.then(|| Some((known.modified().ok()?, known.len(), path)))?
            })
            .collect();
        files.sort_unstable();
        let mut total: u64 = files.iter().map(|(_, len, _)| len).sum();
        for (_, len, path) in files {
            if total <= self.kept {
                break;
            }
            if path == added || is_being_written(&path) {
                continue;
            }
            // If an open file cannot be removed, it stays until another file is added.
            if fs::remove_file(&path).is_ok() {
                total -= len;
            }
        }
    }
}

/// Whether another process holds the lock of an unfinished file.
fn is_being_written(path: &Path) -> bool {
    path.extension()
        .is_some_and(|extension| extension == "part")
        && File::open(path).is_ok_and(|file| file.try_lock().is_err())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_environment_names_folder_and_size() {
        let of = |known: &[(&str, &str)]| {
            FrameCache::from_environment(|name| {
                let found = known.iter().find(|(known, _)| *known == name);
                found.map(|(_, value)| OsString::from(value))
            })
        };
        let none = of(&[("STANCE_CACHE_SIZE", "")]).expect("valid");
        assert_eq!(none, FrameCache::default());
        let all = [("HOME", "/home/ada"), ("STANCE_CACHE_SIZE", "5GB")];
        let found = of(&all).expect("valid");
        assert_eq!(found.kept, 5_000_000_000);
        assert_eq!(found.folder, Path::new("/home/ada/.cache/stance/frames"));
        let found = of(&[all.as_slice(), &[("STANCE_CACHE", "/scratch")]].concat());
        assert_eq!(found.expect("valid").folder, Path::new("/scratch/frames"));
        let wrong = of(&[("STANCE_CACHE_SIZE", "much")]).expect_err("no size");
        assert!(wrong.starts_with("STANCE_CACHE_SIZE"), "{wrong}");
    }

    #[test]
    fn the_files_that_were_not_used_for_longest_are_removed() {
        let folder = tempfile::tempdir().expect("a folder");
        let cache = FrameCache {
            folder: folder.path().to_owned(),
            kept: 250,
        };
        let at = |secs| SystemTime::UNIX_EPOCH + std::time::Duration::from_secs(secs);
        for (name, secs) in [
            ("a.frames", 1),
            ("b.frames", 2),
            ("c.frames", 3),
            ("added.frames", 0),
            ("killed.part", 2),
        ] {
            let path = folder.path().join(name);
            fs::write(&path, [0; 100]).expect("written");
            let file = File::options().append(true).open(&path).expect("opens");
            file.set_modified(at(secs)).expect("set");
        }
        FrameCache::touch(&cache.file("a"));
        fs::write(folder.path().join("other.txt"), [0; 100]).expect("written");
        cache.remove_others(&cache.file("added"));
        let listed = fs::read_dir(folder.path()).expect("listed");
        let names = listed.map(|entry| entry.expect("an entry").file_name());
        let mut left: Vec<OsString> = names.collect();
        left.sort();
        assert_eq!(left, ["a.frames", "added.frames", "other.txt"]);
    }
}
