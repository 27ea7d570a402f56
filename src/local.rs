//! Paths that cannot be URLs, and files at them.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::builder::{PathBufValueParser, TypedValueParser};
use datasets_spec::store::is_url;
use datasets_spec::store::replace_file;

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

pub(crate) fn read_text(path: &Path) -> anyhow::Result<String> {
    fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))
}

/// Writes a file, which appears completely or not at all.
pub(crate) fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    replace_file(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}
