//! Paths that cannot be URLs, and files at them.

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::builder::{PathBufValueParser, TypedValueParser};
use datasets_spec::store::is_url;
use datasets_spec::store::replace_file;

/// Parses a path and refuses a URL: datasets and sources can be remote, runs, exports and stores cannot.
pub(crate) fn path() -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new().try_map(|path| check(&path).map(|()| path))
}

/// Refuses a URL.
pub(crate) fn check(path: &Path) -> Result<(), String> {
    match is_url(path) {
        true => Err(format!(
            "{} must be on this machine; only datasets and sources can be at URLs",
            path.display()
        )),
        false => Ok(()),
    }
}

/// Writes a file, which appears whole or not at all.
pub(crate) fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    replace_file(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}
