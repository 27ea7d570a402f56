//! Folders that appear whole or not at all, and cleanup after processes that were killed.
//!
//! A folder is written to `.stance.NUMBER.partial/new` beside its destination and renamed from there. The file `LOCK`
//! beside `new` is locked as long as the process lives; the system releases the lock however the process ends. Every
//! run that writes a folder removes the partial folders beside it that are not locked.

use std::ffi::OsStr;
use std::fs::{self, File, TryLockError};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

use datasets_spec::store::temporary_beside;

use crate::Error;

/// Begin and end of the name of a partial folder. The destination's name is not part of it: a name of the maximum
/// length would become too long.
const BEGIN: &str = "stance";
const END: &str = "partial";
/// Contents of a partial folder: the new folder, and the locked file.
const CONTENT: &str = "new";
const LOCK: &str = "LOCK";

/// Whether a file or a non-empty folder exists at `out`.
pub fn is_occupied(out: &Path) -> bool {
    match fs::read_dir(out) {
        Ok(mut entries) => entries.next().is_some(),
        Err(_) => out.exists(),
    }
}

/// Renames a complete folder to `out`. An empty folder of that name is replaced.
pub(crate) fn publish(folder: &Path, out: &Path) -> Result<(), Error> {
    if out.exists() {
        fs::remove_dir(out).map_err(Error::io("replace", out))?;
    }
    fs::rename(folder, out).map_err(Error::io("rename to", out))
}

/// A folder that is being written beside its destination. It is removed unless it is published.
#[derive(Debug)]
pub struct NewFolder {
    place: PathBuf,
    content: PathBuf,
    out: PathBuf,
    abandoned: Vec<PathBuf>,
    /// Lock that is held until the partial folder is gone; `None` if the file system has no locks.
    _lock: Option<File>,
}

impl NewFolder {
    /// Begins a folder, and removes partial folders that killed runs left beside it.
    ///
    /// # Errors
    /// The destination exists and is not empty, or the folder cannot be made.
    pub fn beside(out: &Path) -> Result<Self, Error> {
        if is_occupied(out) {
            return Err(Error::Occupied {
                path: out.to_owned(),
            });
        }
        let parent = match out.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        fs::create_dir_all(parent).map_err(Error::io("create folder", parent))?;
        let abandoned = remove_abandoned(parent);
        loop {
            let place = temporary_beside(&parent.join(BEGIN)).with_extension(END);
            fs::create_dir(&place).map_err(Error::io("create folder", &place))?;
            // Another process may take the folder for an abandoned one until its lock is held.
            let Some(lock) = lock(&place).map_err(Error::io("lock", &place))? else {
                continue;
            };
            let content = place.join(CONTENT);
            let folder = Self {
                place,
                content,
                out: out.to_owned(),
                abandoned,
                _lock: lock.file,
            };
            fs::create_dir(&folder.content).map_err(Error::io("create folder", &folder.content))?;
            return Ok(folder);
        }
    }

    /// Path at which the folder is written.
    pub fn path(&self) -> &Path {
        &self.content
    }

    /// Partial folders of other machines beside this one; those machines may still be writing them.
    pub fn left_by_others(&self) -> Vec<PathBuf> {
        self.abandoned.clone()
    }

    /// Renames the partial folder to its final name. An empty folder with that name is replaced.
    ///
    /// # Errors
    /// The name is taken, or the system refuses.
    pub fn publish(self) -> Result<(), Error> {
        publish(&self.content, &self.out)
    }
}

impl Drop for NewFolder {
    fn drop(&mut self) {
        remove(&self.place);
    }
}

/// The lock of a partial folder; `file` is `None` if the file system has no locks.
struct Held {
    file: Option<File>,
}

/// Locks a partial folder that this process made; `None` if another process removed it or is removing it.
fn lock(place: &Path) -> io::Result<Option<Held>> {
    let path = place.join(LOCK);
    let opened = File::options()
        .read(true)
        .write(true)
        .create(true)
        .truncate(false)
        .open(&path);
    let mut file = match opened {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        opened => opened?,
    };
    let file = match file.try_lock() {
        Ok(()) => {
            file.write_all(machine().as_bytes())?;
            Some(file)
        }
        Err(TryLockError::WouldBlock) => return Ok(None),
        // No other process can lock it either, so none can mistake the folder for an abandoned one.
        Err(TryLockError::Error(_)) => None,
    };
    // A file that was removed after it was opened can be locked too.
    Ok(path.exists().then_some(Held { file }))
}

/// Removes the partial folders in `parent` whose process has ended. Returns those of other machines, whose processes
/// cannot be checked. Folders that cannot be removed are left to the next run.
fn remove_abandoned(parent: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(parent).into_iter().flatten().flatten();
    let mut places: Vec<PathBuf> = entries
        .filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_dir()))
        .filter(|entry| is_partial(&entry.file_name()))
        .map(|entry| entry.path())
        .collect();
    places.sort();
    places.retain(|place| {
        let Ok(mut file) = File::options()
            .read(true)
            .write(true)
            .open(place.join(LOCK))
        else {
            // The process was killed before it made the file, or another process is removing the folder: it is empty. A
            // process that was about to make the file makes another folder instead.
            let _removed = fs::remove_dir(place);
            return false;
        };
        if file.try_lock().is_err() {
            return false;
        }
        let mut said = String::new();
        let _read = file.read_to_string(&mut said);
        // Some shared disks are mounted with locks that only one machine sees.
        if !is_this_machine(&said, &machine()) {
            return true;
        }
        remove(place);
        false
    });
    places
}

fn is_partial(name: &OsStr) -> bool {
    let name = name.to_string_lossy();
    let number = name
        .strip_prefix('.')
        .and_then(|name| name.strip_prefix(BEGIN));
    number.is_some_and(|rest| rest.starts_with('.') && rest.ends_with(&format!(".{END}")))
}

/// Removes a partial folder, the lock file last: without it, the owner of the remains could not be determined. Remains
/// that cannot be removed are left to the next run.
fn remove(place: &Path) {
    let _content = fs::remove_dir_all(place.join(CONTENT));
    if !place.join(CONTENT).exists() {
        let _lock = fs::remove_file(place.join(LOCK));
        let _place = fs::remove_dir(place);
    }
}

/// Identity of this machine and its present boot; empty where the system does not provide one.
fn machine() -> String {
    let said = |name: &str| {
        let text = fs::read_to_string(Path::new("/proc/sys/kernel").join(name));
        text.unwrap_or_default().trim().to_owned()
    };
    format!("{} {}", said("random/boot_id"), said("hostname"))
}

/// Whether a lock file names this machine by its boot id or by its host name: containers of one machine differ in host
/// name, and a restarted machine differs in boot id. An empty file belongs to a process that was killed right after it
/// made the file.
fn is_this_machine(said: &str, own: &str) -> bool {
    let (said, own) = (said.trim_end(), own.trim_end());
    let mut names = said.split(' ').zip(own.split(' '));
    said.is_empty() || said == own || names.any(|(said, own)| !own.is_empty() && said == own)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).expect("listed");
        let names = entries.map(|entry| entry.expect("readable").file_name());
        names
            .map(|name| name.to_string_lossy().into_owned())
            .collect()
    }

    #[test]
    fn a_folder_appears_whole_and_nothing_stays_beside_it() {
        let dir = tempfile::tempdir().expect("a folder");
        let out = dir.path().join("x".repeat(255));
        let dropped = NewFolder::beside(&out).expect("begun");
        fs::write(dropped.path().join("file"), "half").expect("written");
        drop(dropped);
        assert!(names(dir.path()).is_empty());
        fs::create_dir(&out).expect("an empty folder");
        let folder = NewFolder::beside(&out).expect("begun");
        fs::write(folder.path().join("file"), "whole").expect("written");
        folder.publish().expect("appears");
        assert_eq!(
            names(dir.path()),
            [out.file_name().expect("a name").to_string_lossy()]
        );
        assert_eq!(names(&out), ["file"]);
        assert!(matches!(
            NewFolder::beside(&out),
            Err(Error::Occupied { .. })
        ));
    }

    #[test]
    fn what_dead_runs_left_is_removed_and_what_living_ones_write_stays() {
        let dir = tempfile::tempdir().expect("a folder");
        let at = |name: &str| dir.path().join(name);
        let living = NewFolder::beside(&at("a")).expect("begun");
        fs::write(living.path().join("file"), "").expect("written");
        let dead = |name: &str, said: Option<&str>| {
            let place = at(&format!(".stance.{name}.partial"));
            fs::create_dir_all(place.join(CONTENT)).expect("made");
            fs::write(place.join(CONTENT).join("file"), "").expect("written");
            if let Some(said) = said {
                fs::write(place.join(LOCK), said).expect("written");
            }
            place
        };
        let own = dead("1-0", Some(&machine()));
        let silent = dead("2-0", Some(""));
        let other = dead("3-0", Some("another-start another-name"));
        // The process was killed before it took a lock.
        let empty = at(".stance.4-0.partial");
        fs::create_dir(&empty).expect("made");
        // A folder of an earlier version, which has another form of name, and a folder without a lock file.
        let foreign = [at(".a.123.partial"), dead("5-0", None)];
        fs::create_dir_all(foreign[0].join("file")).expect("made");
        let next = NewFolder::beside(&at("b")).expect("begun");
        for gone in [&own, &silent, &empty] {
            assert!(!gone.exists(), "{}", gone.display());
        }
        for stays in foreign.iter().chain([&other, &living.path().to_owned()]) {
            assert!(stays.exists(), "{}", stays.display());
        }
        assert_eq!(next.left_by_others(), [other]);
        living.publish().expect("appears");
        assert!(at("a/file").exists());
    }

    #[test]
    fn of_many_that_begin_at_once_each_has_its_own() {
        let dir = tempfile::tempdir().expect("a folder");
        std::thread::scope(|scope| {
            for number in 0..8 {
                let out = dir.path().join(number.to_string());
                scope.spawn(move || {
                    for _ in 0..20 {
                        drop(NewFolder::beside(&out).expect("begun"));
                    }
                    let folder = NewFolder::beside(&out).expect("begun");
                    fs::write(folder.path().join("file"), "").expect("written");
                    folder.publish().expect("appears");
                });
            }
        });
        let mut found = names(dir.path());
        found.sort();
        assert_eq!(found, ["0", "1", "2", "3", "4", "5", "6", "7"]);
    }

    #[test]
    fn a_machine_is_known_by_its_start_or_its_name() {
        for (said, own, same) in [
            ("b1 node", "b1 node", true),
            ("b1 pod", "b1 other-pod", true),
            ("b1 node", "b2 node", true),
            ("b1 node", "b2 other", false),
            ("", "b1 node", true),
            (" ", " ", true),
        ] {
            assert_eq!(is_this_machine(said, own), same, "{said:?} {own:?}");
        }
    }
}
