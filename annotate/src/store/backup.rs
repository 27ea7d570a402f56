//! Dated copies of a store in a folder.

use std::path::{Path, PathBuf};

use super::db::Result;
use super::records::Millis;
use super::store::Store;

const PREFIX: &str = "store-";
const SUFFIX: &str = ".sqlite";
/// Characters of the time in a name, such as `20261123T054500Z`.
const TIME_CHARS: usize = 16;

/// Copies the store to a file in a folder, named after the time, and removes all but the newest `keep` copies. Returns
/// the path of the copy, which is synced to the disk.
///
/// # Errors
/// The store fails, is on PostgreSQL, or the folder cannot be written.
pub fn back_up(store: &Store, folder: &Path, keep: usize, now: Millis) -> Result<PathBuf> {
    std::fs::create_dir_all(folder).map_err(datasets_spec::Error::io("create folder", folder))?;
    let path = folder.join(name(now));
    store.backup(&path)?;
    let mut copies = copies(folder)?;
    copies.sort();
    for old in &copies[..copies.len().saturating_sub(keep.max(1))] {
        let old = folder.join(old);
        std::fs::remove_file(&old).map_err(datasets_spec::Error::io("remove", &old))?;
    }
    Ok(path)
}

/// Whether the newest copy in a folder is older than `every` milliseconds, or there is none.
///
/// # Errors
/// The folder cannot be read.
pub fn backup_is_due(folder: &Path, every: Millis, now: Millis) -> Result<bool> {
    let newest = copies(folder)?.into_iter().max();
    Ok(newest.is_none_or(|newest| newest <= name(now - every)))
}

/// Names of the copies in a folder.
fn copies(folder: &Path) -> Result<Vec<String>> {
    let entries = match std::fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(datasets_spec::Error::io("read folder", folder)(error).into()),
    };
    let mut names = Vec::new();
    for entry in entries {
        let entry = entry.map_err(datasets_spec::Error::io("read folder", folder))?;
        let name = entry.file_name().to_string_lossy().into_owned();
        let time = name
            .strip_prefix(PREFIX)
            .and_then(|rest| rest.strip_suffix(SUFFIX));
        if time.is_some_and(|time| time.len() == TIME_CHARS && time.ends_with('Z')) {
            names.push(name);
        }
    }
    Ok(names)
}

/// The name of a copy; names sort by time.
fn name(now: Millis) -> String {
    let time = jiff::Timestamp::from_millisecond(now).unwrap_or_default();
    format!("{PREFIX}{}{SUFFIX}", time.strftime("%Y%m%dT%H%M%SZ"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn copies_are_named_by_their_time() {
        for (secs, expected) in [(0, "19700101T000000Z"), (1_709_251_199, "20240229T235959Z")] {
            assert_eq!(name(secs * 1000 + 999), format!("store-{expected}.sqlite"));
        }
    }

    #[test]
    fn a_schedule_keeps_the_last_copies_and_leaves_other_files_alone() {
        const HOUR: Millis = 3_600_000;
        let dir = tempfile::tempdir().expect("a folder");
        let store = super::super::open_sqlite(&dir.path().join("s.sqlite")).expect("a store");
        let folder = dir.path().join("backups");
        let due = |now| backup_is_due(&folder, 6 * HOUR, now).expect("reads");
        assert!(due(0));
        let mut kept = Vec::new();
        for time in [0, 6, 12, 18] {
            assert!(due(time * HOUR), "{time}");
            kept.push(back_up(store.as_ref(), &folder, 2, time * HOUR).expect("copies"));
            assert!(!due(time * HOUR + 5 * HOUR), "{time}");
            if time == 0 {
                std::fs::write(folder.join("store-mine.sqlite"), "").expect("writes");
            }
        }
        let there: Vec<bool> = kept.iter().map(|path| path.exists()).collect();
        assert_eq!(there, [false, false, true, true]);
        assert!(folder.join("store-mine.sqlite").exists());
        assert_eq!(std::fs::read_dir(&folder).expect("reads").count(), 3);
        let id = store.id().expect("an id");
        let copy = super::super::open_sqlite(&kept[3]).expect("a copy is a store");
        assert_eq!(copy.id().expect("an id"), id);
    }
}
