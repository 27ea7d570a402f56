//! A byte stream with a position. It allocates for the bytes that are there, not for stated lengths.

use std::io::{BufRead, BufReader, ErrorKind, Read};

use crate::error::{Error, error};

/// The bytes of a pickle.
pub(crate) struct Input<'a> {
    reader: BufReader<Box<dyn Read + 'a>>,
    position: usize,
}

impl<'a> Input<'a> {
    pub(crate) fn new(reader: impl Read + 'a) -> Self {
        Self {
            reader: BufReader::new(Box::new(reader)),
            position: 0,
        }
    }

    /// Number of bytes read so far; of the unpacked stream if the file is packed.
    pub(crate) fn position(&self) -> usize {
        self.position
    }

    pub(crate) fn byte(&mut self) -> Result<u8, Error> {
        self.array::<1>().map(|[byte]| byte)
    }

    pub(crate) fn array<const N: usize>(&mut self) -> Result<[u8; N], Error> {
        let mut bytes = [0; N];
        self.reader
            .read_exact(&mut bytes)
            .map_err(|error| self.failed(&error, N as u64))?;
        self.position = self.position.saturating_add(N);
        Ok(bytes)
    }

    /// The next `len` bytes. Memory grows with the bytes read, not with `len`.
    pub(crate) fn bytes(&mut self, len: u64) -> Result<Vec<u8>, Error> {
        let mut bytes = Vec::new();
        let read = self.reader.by_ref().take(len).read_to_end(&mut bytes);
        read.map_err(|error| self.failed(&error, len))?;
        if (bytes.len() as u64) < len {
            return Err(self.truncated(len));
        }
        self.position = self.position.saturating_add(bytes.len());
        Ok(bytes)
    }

    /// The next line without its line feed.
    pub(crate) fn line(&mut self) -> Result<Vec<u8>, Error> {
        let mut line = Vec::new();
        let read = self.reader.read_until(b'\n', &mut line);
        read.map_err(|error| self.failed(&error, 1))?;
        if line.pop() != Some(b'\n') {
            return Err(self.truncated(1));
        }
        self.position = self.position.saturating_add(line.len() + 1);
        Ok(line)
    }

    fn truncated(&self, needed: u64) -> Error {
        error!(
            "E-PICKLE-TRUNCATED",
            "the pickle ends within an element, expected {needed} more bytes"
        )
        .at(self.position)
    }

    fn failed(&self, error: &std::io::Error, needed: u64) -> Error {
        let code = match error.kind() {
            ErrorKind::UnexpectedEof => return self.truncated(needed),
            ErrorKind::FileTooLarge => "E-PICKLE-LIMIT",
            ErrorKind::InvalidData
            | ErrorKind::InvalidInput
            | ErrorKind::OutOfMemory
            | ErrorKind::Other => "E-PICKLE-UNPACK",
            _ => "E-IO",
        };
        error!(code, "the pickle cannot be read on ({error})").at(self.position)
    }
}
