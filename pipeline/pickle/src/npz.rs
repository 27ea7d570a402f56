//! Archives in NumPy's npz format, read and written.
//!
//! Only requested arrays are unpacked, and none beyond its stated length or the limit.

use std::borrow::Cow;
use std::io::{self, Cursor, Read, Seek, Write};

use zip::read::ZipFile;
use zip::result::ZipError;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, System, ZipArchive, ZipWriter};

use crate::error::{Error, error};
use crate::npy::{self, Array, Header, Number};

/// Limits on a member: its size in bytes, and its ratio to the compressed size. Real recordings stay far below both (an
/// hour of SMPL-X at 120 fps is 570 MB); archives built to exhaust memory do not.
pub(crate) const MAX_MEMBER_LEN: u64 = 2 << 30;
const MAX_RATIO: u64 = 200;
/// Size in bytes up to which the ratio is not checked: a clip whose hands are all zero compresses well.
const SMALL_MEMBER_LEN: u64 = 1 << 20;
/// Maximum number of members; the largest AMASS files have about thirty.
const MAX_MEMBERS: usize = 10_000;
/// Number of bytes of a member that contain the array's header, whose length [`npy`] limits.
const HEADER_LEN: u64 = 10_016;

/// An npz archive.
pub struct Archive<R> {
    zip: ZipArchive<R>,
    /// Names of the arrays, sorted.
    keys: Vec<String>,
}

impl<'a> Archive<Cursor<&'a [u8]>> {
    /// Opens an archive in memory.
    ///
    /// # Errors
    /// As [`Archive::open`].
    pub fn in_memory(bytes: &'a [u8]) -> Result<Self, Error> {
        Self::open(Cursor::new(bytes))
    }

    /// Like [`Archive::member`], but borrows from `bytes`, the bytes of the archive, if the member is stored
    /// uncompressed, as in AMASS.
    ///
    /// # Errors
    /// As [`Archive::member`].
    pub fn borrowed(&mut self, bytes: &'a [u8], key: &str) -> Result<Cow<'a, [u8]>, Error> {
        let (name, file) = self.find(key)?;
        let stored = file.compression() == CompressionMethod::Stored
            && !file.encrypted()
            && file.size() == file.compressed_size()
            && file.size() <= MAX_MEMBER_LEN;
        let start = file
            .data_start()
            .and_then(|start| usize::try_from(start).ok());
        let len = usize::try_from(file.size()).ok();
        let member = start
            .zip(len)
            .filter(|_| stored)
            .and_then(|(start, len)| bytes.get(start..)?.get(..len));
        let (expected, start) = (file.crc32(), start.unwrap_or(0));
        drop(file);
        let Some(member) = member else {
            return self.member(key).map(Cow::Owned);
        };
        let found = crc32fast::hash(member);
        if found != expected {
            return Err(error!(
                "E-NPZ-TRUNCATED",
                "{name} has the checksum {found:08x}, expected {expected:08x}; it is damaged"
            )
            .at(start));
        }
        Ok(Cow::Borrowed(member))
    }
}

impl<R: Read + Seek> Archive<R> {
    /// Reads the list of members.
    ///
    /// # Errors
    /// `E-NPZ-TRUNCATED`, `E-NPZ-LIMIT`, or `E-ARCHIVE-PATH` if a name leads out of the archive or
    /// differs from another in case alone.
    pub fn open(mut reader: R) -> Result<Self, Error> {
        let len = reader.seek(std::io::SeekFrom::End(0)).unwrap_or(0);
        let zip = ZipArchive::new(reader).map_err(|error| {
            error!(
                "E-NPZ-TRUNCATED",
                "found no complete zip archive in {len} bytes ({error})"
            )
            .at(usize::try_from(len).unwrap_or(usize::MAX))
        })?;
        if zip.len() > MAX_MEMBERS {
            return Err(error!(
                "E-NPZ-LIMIT",
                "found {} members, expected at most {MAX_MEMBERS}",
                zip.len()
            ));
        }
        check_names(zip.file_names_raw())?;
        let mut keys: Vec<String> = zip
            .file_names_raw()
            .filter_map(|name| name.strip_suffix(b".npy"))
            .map(|name| String::from_utf8_lossy(name).into_owned())
            .collect();
        keys.sort();
        Ok(Self { zip, keys })
    }

    /// Names of the arrays, sorted.
    pub fn keys(&self) -> &[String] {
        &self.keys
    }

    /// Whether there is an array of this name.
    pub fn has(&self, key: &str) -> bool {
        self.keys.iter().any(|found| found == key)
    }

    /// The name of an array's member, and the member.
    fn find(&mut self, key: &str) -> Result<(String, ZipFile<'_, R>), Error> {
        let name = format!("{key}.npy");
        match self.zip.by_name(&name) {
            Ok(file) => Ok((name, file)),
            Err(error) => Err(member_error(&name, &error)),
        }
    }

    /// The npy file of an array, checked against its CRC.
    ///
    /// # Errors
    /// `E-NPZ-TRUNCATED` if the member is missing or damaged, `E-NPZ-LIMIT` if it is too large.
    pub fn member(&mut self, key: &str) -> Result<Vec<u8>, Error> {
        self.member_within(key, MAX_MEMBER_LEN)
    }

    /// Like [`Archive::member`], with `max_len` as the largest size in bytes.
    ///
    /// # Errors
    /// As [`Archive::member`].
    pub fn member_within(&mut self, key: &str, max_len: u64) -> Result<Vec<u8>, Error> {
        let (name, mut file) = self.find(key)?;
        let (len, compressed_len) = (file.size(), file.compressed_size());
        let start = file.data_start().unwrap_or_else(|| file.header_start());
        check_len("E-NPZ-LIMIT", &name, len, compressed_len, max_len)
            .map_err(|error| error.at(start as usize))?;
        // The stated length is not trusted: no memory is reserved for it, and reading stops there.
        let mut bytes = Vec::new();
        file.by_ref()
            .take(len)
            .read_to_end(&mut bytes)
            .and_then(|_| file.read(&mut [0]).map(drop))
            .map_err(|error| member_error(&name, &ZipError::Io(error)).at(start as usize))?;
        Ok(bytes)
    }

    /// Checks that an array is small enough to be read, without unpacking it.
    ///
    /// # Errors
    /// As [`Archive::member`].
    pub fn check_size(&mut self, key: &str) -> Result<(), Error> {
        let (name, file) = self.find(key)?;
        let (len, compressed_len) = (file.size(), file.compressed_size());
        check_len("E-NPZ-LIMIT", &name, len, compressed_len, MAX_MEMBER_LEN)
    }

    /// Reads an array of numbers.
    ///
    /// # Errors
    /// As [`Archive::member`], or those of [`npy::read_numbers`].
    pub fn numbers(&mut self, key: &str) -> Result<Array, Error> {
        let bytes = self.member(key)?;
        npy::read_numbers(key, &bytes)
    }

    /// The shape that an array's header states; only the header is unpacked.
    ///
    /// # Errors
    /// `E-NPZ-TRUNCATED`, and those of [`Header::peek_shape`].
    pub fn shape(&mut self, key: &str) -> Result<Vec<usize>, Error> {
        let (name, file) = self.find(key)?;
        let mut head = Vec::new();
        file.take(HEADER_LEN)
            .read_to_end(&mut head)
            .map_err(|error| member_error(&name, &ZipError::Io(error)))?;
        Header::peek_shape(key, &head)
    }
}

/// Refuses a member whose unpacked size exceeds `max_len` or is too large for its compressed size.
pub(crate) fn check_len(
    code: &'static str,
    name: &str,
    len: u64,
    compressed_len: u64,
    max_len: u64,
) -> Result<(), Error> {
    if len <= max_len && (len <= SMALL_MEMBER_LEN || len / MAX_RATIO <= compressed_len.max(1)) {
        return Ok(());
    }
    Err(error!(
        code,
        "{name} unpacks from {compressed_len} to {len} bytes, expected at most {max_len} and {MAX_RATIO} times its \
             packed size"
    ))
}

fn member_error(name: &str, error: &ZipError) -> Error {
    error!("E-NPZ-TRUNCATED", "{name} cannot be unpacked ({error})")
}
/// Refuses names that would lead out of a folder, and names that differ in case alone. Archives are never unpacked to
/// files, so such names do no harm here, but they show a hostile or broken writer.
fn check_names<'a>(names: impl Iterator<Item = &'a [u8]>) -> Result<(), Error> {
    let mut seen = std::collections::BTreeSet::new();
    for name in names {
        let name = String::from_utf8_lossy(name);
        let leads_out = name.starts_with('/')
            || name.contains('\\')
            || name.split('/').any(|part| part == "..")
            || name.as_bytes().get(1) == Some(&b':');
        let problem = if leads_out {
            "leads out of the archive"
        } else if !seen.insert(name.to_lowercase()) {
            "differs from another in case alone"
        } else {
            continue;
        };
        return Err(error!(
            "E-ARCHIVE-PATH",
            "found a member {name:?}, which {problem}"
        ));
    }
    Ok(())
}

/// Writes an archive in memory.
///
/// Members are stored, not compressed: compressors choose code paths by processor, and equal arrays must give equal
/// bytes everywhere. Their time stamps are the earliest a zip can hold.
pub struct Writer {
    zip: ZipWriter<Cursor<Vec<u8>>>,
}

impl Default for Writer {
    fn default() -> Self {
        Self {
            zip: ZipWriter::new(Cursor::new(Vec::new())),
        }
    }
}

impl Writer {
    /// Adds an array of numbers in row-major order.
    ///
    /// # Errors
    /// The array exceeds 4 GiB, or the name is taken.
    ///
    /// # Panics
    /// If the shape does not fit the numbers.
    pub fn numbers<T: Number>(
        &mut self,
        name: &str,
        shape: &[usize],
        values: &[T],
    ) -> io::Result<()> {
        self.member(name, &npy::encode(shape, values))
    }

    /// Adds text as an array without dimensions.
    ///
    /// # Errors
    /// As [`Writer::numbers`].
    pub fn text(&mut self, name: &str, text: &str) -> io::Result<()> {
        self.member(name, &npy::encode_text(text))
    }

    fn member(&mut self, name: &str, npy: &[u8]) -> io::Result<()> {
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Stored)
            .last_modified_time(DateTime::default())
            .system(System::Unix);
        self.zip.start_file(format!("{name}.npy"), options)?;
        self.zip.write_all(npy)
    }

    /// The bytes of the archive.
    ///
    /// # Errors
    /// The list of members cannot be written.
    pub fn finish(self) -> io::Result<Vec<u8>> {
        Ok(self.zip.finish()?.into_inner())
    }
}
