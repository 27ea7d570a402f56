//! Paths that cannot be URLs.

use std::path::{Path, PathBuf};

use clap::builder::{PathBufValueParser, TypedValueParser};
use datasets_spec::store::is_url;

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
