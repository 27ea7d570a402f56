//! Checksums of files on the hub.

use std::fs;
use std::io::{self, Read};
use std::path::Path;

use sha1::Sha1;
use sha2::{Digest, Sha256};

use super::error::Error;

const BUFFER_LEN: usize = 1 << 18;

/// Expected checksum and size of a file on the server.
#[derive(Clone, Debug)]
pub(super) struct Wanted {
    pub(super) checksum: Checksum,
    /// Bytes, if they are known.
    pub(super) len: Option<u64>,
}

/// Expected checksum of a file: SHA-256 for large files, the Git blob hash for small ones.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Checksum {
    Sha256(String),
    Git(String),
}

impl Checksum {
    pub(super) fn parse(text: &str) -> Option<Self> {
        let is_hex = text
            .bytes()
            .all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f'));
        match text.len() {
            64 if is_hex => Some(Self::Sha256(text.to_owned())),
            40 if is_hex => Some(Self::Git(text.to_owned())),
            _ => None,
        }
    }

    pub(super) fn as_str(&self) -> &str {
        match self {
            Self::Sha256(text) | Self::Git(text) => text,
        }
    }

    /// The checksum of content, of the same kind as this one.
    fn of(&self, content: impl Read, len: u64) -> io::Result<String> {
        match self {
            Self::Sha256(_) => sha256(content),
            Self::Git(_) => {
                let hash = Sha1::new().chain_update(format!("blob {len}\0"));
                digest(hash, content)
            }
        }
    }

    pub(super) fn is_of(&self, content: impl Read, len: u64) -> io::Result<bool> {
        Ok(self.of(content, len)? == self.as_str())
    }

    /// Verifies the checksum of content; `path` names it in errors.
    pub(super) fn check(&self, content: impl Read, len: u64, path: &Path) -> Result<(), Error> {
        let found = self.of(content, len).map_err(Error::io("read", path))?;
        if found != self.as_str() {
            return Err(Error::Checksum {
                path: path.to_owned(),
                name: match self {
                    Self::Sha256(_) => "SHA-256",
                    Self::Git(_) => "Git name",
                },
                expected: self.as_str().to_owned(),
                found,
            });
        }
        Ok(())
    }
}

/// SHA-256 of content, hexadecimal.
pub(super) fn sha256(content: impl Read) -> io::Result<String> {
    digest(Sha256::new(), content)
}

fn digest(mut hash: impl Digest, mut content: impl Read) -> io::Result<String> {
    let mut buffer = vec![0; BUFFER_LEN];
    loop {
        match content.read(&mut buffer)? {
            0 => return Ok(hex(&hash.finalize())),
            count => hash.update(&buffer[..count]),
        }
    }
}

pub(super) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Reads a file. If it is a link to a blob of the cache, which is named by its checksum, the checksum is verified.
///
/// # Errors
/// The file cannot be read, or does not match its checksum.
pub fn read_checked(path: &Path) -> Result<Vec<u8>, Error> {
    let real = fs::canonicalize(path).map_err(Error::io("find", path))?;
    let checksum = real
        .file_name()
        .and_then(|name| Checksum::parse(name.to_str()?));
    let content = fs::read(&real).map_err(Error::io("read", path))?;
    if let Some(checksum) = checksum {
        checksum.check(content.as_slice(), content.len() as u64, &real)?;
    }
    Ok(content)
}
