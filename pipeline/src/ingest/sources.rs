//! Sources as given on the command line, and as recorded in a dataset.

use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::fmt;
use std::path::{Path, PathBuf};

use formats::source::text_of_name;
use serde::{Deserialize, Serialize};

use crate::names::free;

/// Fact of a manifest: the sources, as JSON.
pub(super) const SOURCES_FACT: &str = "sources";

/// A source as it is given: a file, a folder or a URL, with or without a name. Its text is `NAME=PATH`, or only the
/// path.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SourceArg {
    /// Name of the source; `None` means the name of its folder.
    pub name: Option<String>,
    /// Path or URL of the source.
    pub path: PathBuf,
}

impl SourceArg {
    /// Reads `NAME=PATH`, or a path. The text before the first `=` is a name unless it holds a slash, so a path with
    /// `=` in its first part is written with `./` before it.
    ///
    /// # Errors
    /// The name has characters that names cannot have, or nothing follows it.
    pub fn parse(given: &OsStr) -> Result<Self, String> {
        let bare = || Self::from(PathBuf::from(given));
        let named = given.to_str().and_then(|text| text.split_once('='));
        let Some((name, path)) = named else {
            return Ok(bare());
        };
        if name.is_empty() || name.contains(['/', '\\']) {
            return Ok(bare());
        }
        match check_name(name) {
            Ok(()) if path.is_empty() => Err(format!("a path is expected after {name}=")),
            Ok(()) => Ok(Self {
                name: Some(name.to_owned()),
                path: PathBuf::from(path),
            }),
            Err(_) if Path::new(given).exists() => Ok(bare()),
            Err(reason) => Err(format!(
                "{name:?} cannot be the name of a source: {reason}; a path with = in its first part begins with ./"
            )),
        }
    }

    /// Resolves a relative path against a folder. URLs stay unchanged.
    #[must_use]
    pub fn below(self, folder: &Path) -> Self {
        let path = match datasets_spec::store::is_url(&self.path) {
            true => self.path,
            false => folder.join(self.path),
        };
        Self { path, ..self }
    }
}

impl From<PathBuf> for SourceArg {
    fn from(path: PathBuf) -> Self {
        Self { name: None, path }
    }
}

impl From<&Path> for SourceArg {
    fn from(path: &Path) -> Self {
        path.to_owned().into()
    }
}

impl fmt::Display for SourceArg {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let path = self.path.display();
        match &self.name {
            Some(name) => write!(f, "{name}={path}"),
            None => write!(f, "{path}"),
        }
    }
}

impl Serialize for SourceArg {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for SourceArg {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        Self::parse(OsStr::new(&text)).map_err(serde::de::Error::custom)
    }
}

/// Whether a character may be part of a name. Ids and paths in tables begin with names.
fn is_of_name(c: char) -> bool {
    !c.is_control() && !matches!(c, '/' | '\\' | '#' | '@' | '=')
}

pub(super) fn check_name(name: &str) -> Result<(), String> {
    match name.chars().find(|c| !is_of_name(*c)) {
        Some(c) => Err(format!("it holds {c:?}")),
        None if matches!(name, "" | "." | "..") => Err("it is no name".to_owned()),
        None => Ok(()),
    }
}

/// A folder's name as the name of a source: characters that names cannot have become `-`.
pub(super) fn name_of_folder(folder: &Path) -> String {
    as_name(&text_of_name(folder.file_name().unwrap_or_default()))
}

fn as_name(text: &str) -> String {
    let replaced = text.chars().map(|c| if is_of_name(c) { c } else { '-' });
    replaced.collect()
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct SourceLabel {
    /// Prefix of the paths of its files; empty if the dataset began with this source alone.
    pub(super) label: String,
    /// Name of the source. Datasets of earlier builds use the name of the folder, which several sources may share.
    pub(super) name: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Kind {
    /// A single file that was given a name.
    File,
    Files,
    Folder,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Given {
    pub(super) label: SourceLabel,
    /// Whether everything below its folder was listed; otherwise only the given files were.
    pub(super) is_whole: bool,
    /// Where the source was found: folders, files or URLs. They are never published.
    pub(super) places: Vec<(String, Kind)>,
}

/// A path without the given label; `None` if the path has another label.
pub(super) fn below<'a>(label: &str, path: &'a str) -> Option<&'a str> {
    match label {
        "" => Some(path),
        label => path.strip_prefix(label)?.strip_prefix('/'),
    }
}

/// The sources of a dataset with valid and different names. Earlier builds could give sources equal names; then all are
/// named by their labels.
pub(super) fn with_names(sources: Vec<SourceLabel>) -> Vec<SourceLabel> {
    let names: BTreeSet<&str> = sources.iter().map(|source| source.name.as_str()).collect();
    let is_valid = |source: &SourceLabel| check_name(&source.name).is_ok();
    if names.len() == sources.len() && sources.iter().all(is_valid) {
        return sources;
    }
    let mut taken = BTreeSet::new();
    let named = sources.into_iter().map(|source| {
        let wanted = as_name(match source.label.as_str() {
            "" => source.name.as_str(),
            label => label,
        });
        let wanted = if wanted.is_empty() { UNNAMED } else { &wanted };
        let name = free(wanted, |name| taken.insert(name.to_owned()));
        SourceLabel { name, ..source }
    });
    named.collect()
}

/// Source name of clips without a recorded source: earlier builds recorded none for single files.
pub(super) const UNNAMED: &str = "unnamed";

/// The source of a path by its longest label, for rows of earlier builds.
pub(super) fn of_path(sources: &[SourceLabel], path: &str) -> Option<usize> {
    let places = sources.iter().enumerate();
    let found = places.filter(|(_, source)| below(&source.label, path).is_some());
    let longest = found.max_by_key(|(_, source)| source.label.len());
    longest.map(|(index, _)| index)
}
