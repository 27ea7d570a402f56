//! Files to publish.

use std::fs::{self, File};
use std::io::{Cursor, Read};
use std::path::{Path, PathBuf};

use super::checksum::{Checksum, sha256};
use super::error::Error;

/// A file to store in a repo.
#[derive(Clone, Debug)]
pub struct HubFile {
    /// Path of the file in the repo, with forward slashes.
    pub path: String,
    /// Content of the file.
    pub content: Content,
}

/// Content of a file.
#[derive(Clone, Debug)]
pub enum Content {
    /// A file on this machine.
    File {
        /// Path of the file on disk.
        path: PathBuf,
        /// SHA-256 of the content, hexadecimal, if it is known.
        sha256: Option<String>,
    },
    /// Text in memory.
    Text(String),
}

impl Content {
    /// Size in bytes.
    pub(super) fn size(&self) -> Result<u64, Error> {
        match self {
            Self::File { path, .. } => {
                let metadata = fs::metadata(path);
                Ok(metadata.map_err(Error::io("read", path))?.len())
            }
            Self::Text(text) => Ok(text.len() as u64),
        }
    }

    pub(super) fn open(&self) -> Result<Box<dyn Read + '_>, Error> {
        let content: Box<dyn Read + '_> = match self {
            Self::File { path, .. } => Box::new(File::open(path).map_err(Error::io("open", path))?),
            Self::Text(text) => Box::new(Cursor::new(text.as_bytes())),
        };
        Ok(content)
    }

    /// The first `len` bytes, or all if there are fewer.
    pub(super) fn start(&self, len: u64) -> Result<Vec<u8>, Error> {
        let mut bytes = Vec::new();
        self.open()?
            .take(len)
            .read_to_end(&mut bytes)
            .map_err(Error::io("read", self.place()))?;
        Ok(bytes)
    }

    /// SHA-256, hexadecimal.
    pub(super) fn sha256(&self) -> Result<String, Error> {
        match self {
            Self::File {
                sha256: Some(known),
                ..
            } => Ok(known.clone()),
            _ => {
                let found = sha256(self.open()?);
                found.map_err(Error::io("read", self.place()))
            }
        }
    }

    pub(super) fn has(&self, checksum: &Checksum, size: u64) -> Result<bool, Error> {
        match checksum {
            Checksum::Sha256(expected) => Ok(self.sha256()? == *expected),
            Checksum::Git(_) => {
                let found = checksum.is_of(self.open()?, size);
                found.map_err(Error::io("read", self.place()))
            }
        }
    }

    /// Path of the file, for errors; a placeholder for text.
    fn place(&self) -> &Path {
        match self {
            Self::File { path, .. } => path,
            Self::Text(_) => Path::new("a text"),
        }
    }
}

/// The files below a folder, sorted by path. Hidden files and folders, files named `LOCK`, and the paths in `without`
/// (relative to the folder) are skipped.
///
/// # Errors
/// A folder cannot be listed.
pub fn files_below(folder: &Path, without: &[&str]) -> Result<Vec<HubFile>, Error> {
    let mut files = Vec::new();
    let mut folders = vec![String::new()];
    while let Some(below) = folders.pop() {
        let place = folder.join(&below);
        let list = || -> std::io::Result<Vec<(String, bool)>> {
            let entries = fs::read_dir(&place)?.map(|entry| {
                let entry = entry?;
                let name = entry.file_name().to_string_lossy().into_owned();
                // A link to a folder counts as a folder.
                Ok((name, fs::metadata(entry.path())?.is_dir()))
            });
            entries.collect()
        };
        for (name, is_dir) in list().map_err(Error::io("list", &place))? {
            let path = match below.as_str() {
                "" => name.clone(),
                below => format!("{below}/{name}"),
            };
            if name.starts_with('.') || name == "LOCK" || without.contains(&path.as_str()) {
                continue;
            }
            match is_dir {
                true => folders.push(path),
                false => files.push(HubFile {
                    content: Content::File {
                        path: place.join(&name),
                        sha256: None,
                    },
                    path,
                }),
            }
        }
    }
    files.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(files)
}
