//! Paths that cannot be URLs, and files at them.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::builder::{PathBufValueParser, TypedValueParser};
use datasets_spec::dataset::Staging;
use datasets_spec::flags::{
    FLAG_FPS_DOUBTFUL, FLAG_SIDES_DOUBTFUL, FLAG_SKELETON_GUESSED, FLAG_UP_DOUBTFUL, flag_names,
};
use datasets_spec::store::{Disk, is_url, replace_file};
use datasets_spec::{Motion, Skeleton};
use pipeline::open::{clip_of_file, file_and_key};
use serde::de::DeserializeOwned;

use crate::report;

/// Parses a path and refuses a URL: datasets and sources can be remote, runs, exports and stores cannot.
pub(crate) fn path() -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new().try_map(|path| check(&path).map(|()| path))
}

pub(crate) fn check(path: &Path) -> Result<(), String> {
    match is_url(path) {
        true => Err(format!(
            "{} must be on this machine; only datasets and sources can be at URLs",
            path.display()
        )),
        false => Ok(()),
    }
}

pub(crate) fn read(path: &Path) -> anyhow::Result<Vec<u8>> {
    fs::read(path).with_context(|| format!("cannot read {}", path.display()))
}

/// Reads a JSON file. If it does not hold a `T`, the error is the path followed by `problem`.
pub(crate) fn read_json<T: DeserializeOwned>(path: &Path, problem: &str) -> anyhow::Result<T> {
    let parsed = serde_json::from_slice(&read(path)?);
    parsed.with_context(|| format!("{} {problem}", path.display()))
}

pub(crate) fn read_text(path: &Path) -> anyhow::Result<String> {
    fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))
}

/// Checks that a file which a user names for a result would replace nothing, and would not lie in a dataset, whose
/// folders hold nothing but what its manifests name.
///
/// # Errors
/// `E-OCCUPIED`.
pub(crate) fn check_new(path: &Path) -> anyhow::Result<()> {
    if path.exists() {
        let reason = "exists already; name another file, or move it away";
        return Err(occupied(path, reason));
    }
    // Links may lead into a dataset; folders that do not exist yet lead nowhere.
    let absolute = std::path::absolute(path)?;
    let mut above = absolute.ancestors().skip(1);
    let folder = above.find_map(|folder| fs::canonicalize(folder).ok());
    let mut around = folder.iter().flat_map(|folder| folder.ancestors());
    let is_dataset = |folder: &&Path| {
        let newest = Staging::newest_version(&Disk, folder);
        newest.is_ok_and(|version| version > 0)
    };
    match around.find(is_dataset).map(Path::display) {
        Some(dataset) => Err(occupied(
            path,
            &format!("would lie in the dataset {dataset}; name a file outside of it"),
        )),
        None => Ok(()),
    }
}

/// The error for a file that cannot take a result. `reason` continues its path.
fn occupied(path: &Path, reason: &str) -> anyhow::Error {
    let path = path.display().to_string();
    let reason = format!("{path} {reason}");
    let code = Some(("E-OCCUPIED", Some(path)));
    pipeline::Error::Refused { code, reason }.into()
}

/// Checks that a file for a result is not one that the command reads.
///
/// # Errors
/// `E-OCCUPIED`.
pub(crate) fn check_not_read(out: &Path, read: &[&Path]) -> anyhow::Result<()> {
    let Ok(place) = fs::canonicalize(out) else {
        return Ok(());
    };
    let is_read =
        |file: &&Path| fs::canonicalize(file_and_key(file).0).is_ok_and(|file| file == place);
    if read.iter().any(is_read) {
        let reason = "is what the command reads; name another file for the result";
        return Err(occupied(out, reason));
    }
    Ok(())
}

/// The motion of a file, with a note if its frame rate, its up axis or its sides are doubtful.
pub(crate) fn motion_of_file(path: &Path, skeleton: &Skeleton) -> anyhow::Result<Motion> {
    let clip = clip_of_file(path, skeleton)?;
    let named = FLAG_FPS_DOUBTFUL | FLAG_UP_DOUBTFUL | FLAG_SIDES_DOUBTFUL | FLAG_SKELETON_GUESSED;
    let doubts = flag_names(clip.flags & named);
    if !doubts.is_empty() {
        let (path, doubts, notes) = (path.display(), doubts.join(", "), clip.notes.join("; "));
        report::note(&format!("{path} is {doubts}: {notes}"));
    }
    Ok(clip.motion)
}

/// Writes a file, which appears completely or not at all.
pub(crate) fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    replace_file(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}

/// Names of folders, in the order of their paths: the last part of each path, or the whole path where two have the same
/// last part.
pub(crate) fn names_of(paths: &[PathBuf]) -> Vec<String> {
    let names: Vec<String> = paths.iter().map(|path| name_of(path)).collect();
    let is_shared = |name: &String| names.iter().filter(|other| *other == name).count() > 1;
    let name = |(name, path): (&String, &PathBuf)| match is_shared(name) {
        true => path.display().to_string(),
        false => name.clone(),
    };
    names.iter().zip(paths).map(name).collect()
}

/// The last part of a path. Paths such as `.` have none, and get that of the folder that they lead to.
fn name_of(path: &Path) -> String {
    let found = match path.file_name() {
        Some(name) => Some(name.to_owned()),
        None => fs::canonicalize(path)
            .ok()
            .and_then(|path| path.file_name().map(ToOwned::to_owned)),
    };
    found.map_or_else(
        || path.display().to_string(),
        |name| name.to_string_lossy().into_owned(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_are_named_apart() {
        let named = |paths: &[&str]| {
            let paths: Vec<PathBuf> = paths.iter().map(PathBuf::from).collect();
            names_of(&paths)
        };
        assert_eq!(named(&["aa/run", "bb/other"]), ["run", "other"]);
        assert_eq!(
            named(&["aa/run", "bb/run", "bb/other"]),
            ["aa/run", "bb/run", "other"]
        );
        let here = std::env::current_dir().expect("a folder");
        assert_eq!(named(&["."]), [name_of(&here)]);
        assert_eq!(named(&["/"]), ["/"]);
    }
}
