//! The members of an open archive as a store.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use datasets_spec::store::{Disk, Locking, NewFile, ReadAt, Reader, Store};
use zip::ZipArchive;

use super::scratch::Scratch;
use super::unpacked::{Packed, Slice, Zipped};
use crate::source::name_of_text;

/// Largest packed member that is unpacked into memory for random access.
const MAX_IN_MEMORY: u64 = 2 << 30;

/// Location of a member's bytes.
#[derive(Clone, Debug)]
pub(super) enum Member {
    /// Uncompressed bytes of the archive.
    Range(Slice),
    /// A member of a zip archive, by index.
    Zipped {
        /// Index of the member.
        number: usize,
        /// Size of the unpacked member in bytes.
        size: u64,
    },
    /// Unpacked in the scratch folder.
    Unpacked {
        /// Path of the unpacked file.
        path: PathBuf,
        /// Size in bytes.
        size: u64,
    },
}

impl Member {
    fn size(&self) -> u64 {
        match self {
            Self::Range(range) => range.size,
            Self::Zipped { size, .. } | Self::Unpacked { size, .. } => *size,
        }
    }
}

/// Open archive from which members are read.
#[derive(Debug)]
pub(super) enum ReadFrom {
    /// A zip archive.
    Zip(Arc<dyn ReadAt>, ZipArchive<Reader>),
    /// The folder of the unpacked members; it is removed when no archive uses it.
    Scratch(#[expect(dead_code, reason = "it is kept, not read")] Arc<Scratch>),
}

/// The members of an archive by path below it, as a read-only store.
#[derive(Debug)]
pub(super) struct Members {
    at: PathBuf,
    members: BTreeMap<PathBuf, Member>,
    from: Option<ReadFrom>,
}

impl Members {
    pub(super) fn new(
        at: &Path,
        members: BTreeMap<String, Member>,
        from: Option<ReadFrom>,
    ) -> Self {
        let members = members.into_iter();
        let members = members.map(|(name, member)| (PathBuf::from(name_of_text(&name)), member));
        Self {
            at: at.to_owned(),
            members: members.collect(),
            from,
        }
    }

    fn member(&self, path: &Path) -> io::Result<&Member> {
        let name = path.strip_prefix(&self.at).ok();
        let member = name.and_then(|name| self.members.get(name));
        member.ok_or_else(|| io::ErrorKind::NotFound.into())
    }

    /// The entry of a zip member: where its bytes are in the archive, their compression, size and checksum.
    fn zipped(&self, number: usize) -> io::Result<Zipped> {
        let Some(ReadFrom::Zip(file, zip)) = &self.from else {
            return Err(io::ErrorKind::NotFound.into());
        };
        let mut zip = zip.clone();
        let entry = zip.by_index_raw(number)?;
        let start = entry.data_start();
        Ok(Zipped {
            packed: Slice {
                file: Arc::clone(file),
                start: start.ok_or(io::ErrorKind::InvalidData)?,
                size: entry.compressed_size(),
            },
            is_stored: entry.compression() == zip::CompressionMethod::Stored,
            size: entry.size(),
            crc: entry.crc32(),
            at: entry.header_start(),
        })
    }
}

fn read_only<T>() -> io::Result<T> {
    Err(io::Error::new(
        io::ErrorKind::ReadOnlyFilesystem,
        "nothing is written into an archive",
    ))
}

impl Store for Members {
    fn create_dir_all(&self, _path: &Path) -> io::Result<()> {
        read_only()
    }

    fn create(&self, _path: &Path) -> io::Result<Box<dyn NewFile>> {
        read_only()
    }

    fn rename(&self, _from: &Path, _to: &Path) -> io::Result<()> {
        read_only()
    }

    fn read(&self, path: &Path) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        self.open(path)?.read_to_end(&mut bytes)?;
        Ok(bytes)
    }

    fn open(&self, path: &Path) -> io::Result<Box<dyn Read>> {
        match self.member(path)? {
            Member::Range(range) => Ok(Box::new(Reader::new(Arc::new(range.clone())))),
            Member::Zipped { number, .. } => Ok(self.zipped(*number)?.open()),
            Member::Unpacked { path, .. } => Disk.open(path),
        }
    }

    fn open_at(&self, path: &Path) -> io::Result<Arc<dyn ReadAt>> {
        match self.member(path)? {
            Member::Range(range) => Ok(Arc::new(range.clone())),
            Member::Zipped { number, size } => {
                let member = self.zipped(*number)?;
                if member.is_stored && member.size == member.packed.size {
                    return Ok(Arc::new(member.packed));
                }
                if *size > MAX_IN_MEMORY {
                    let reason = format!(
                        "it is packed and unpacks to {size} bytes, at most {MAX_IN_MEMORY} are held in memory; \
                         unpack the archive"
                    );
                    return Err(io::Error::new(io::ErrorKind::FileTooLarge, reason));
                }
                Ok(Arc::new(Packed::new(member)))
            }
            Member::Unpacked { path, .. } => Disk.open_at(path),
        }
    }

    fn size(&self, path: &Path) -> io::Result<u64> {
        Ok(self.member(path)?.size())
    }

    fn hash(&self, path: &Path) -> io::Result<String> {
        if let Member::Unpacked { path, .. } = self.member(path)? {
            return Disk.hash(path);
        }
        let mut hasher = blake3::Hasher::new();
        hasher.update_reader(self.open(path)?)?;
        Ok(hasher.finalize().to_hex().to_string())
    }

    fn list(&self, path: &Path) -> io::Result<Vec<(PathBuf, bool)>> {
        let folder = path.strip_prefix(&self.at).map_err(io::Error::other)?;
        let below = self.members.keys().filter_map(|name| {
            let mut parts = name.strip_prefix(folder).ok()?.components();
            let first = parts.next()?;
            Some((path.join(first), parts.next().is_some()))
        });
        let below: BTreeSet<(PathBuf, bool)> = below.collect();
        Ok(below.into_iter().collect())
    }

    fn remove_file(&self, _path: &Path) -> io::Result<()> {
        read_only()
    }

    fn remove_dir_all(&self, _path: &Path) -> io::Result<()> {
        read_only()
    }

    fn lock(&self, _folder: &Path, _holder: &str) -> io::Result<Locking> {
        read_only()
    }
}
