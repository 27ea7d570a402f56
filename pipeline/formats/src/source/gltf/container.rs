//! The container of a glTF file: the chunks of a GLB, and the bytes of each buffer.
//!
//! `gltf::Glb` is not used: its errors carry no byte offset, it subtracts the header from a stated length without
//! checking it, and it refuses a file whose second chunk is of an unknown kind, which the specification says to skip.

use std::borrow::Cow;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use gltf::json;

use crate::source::head::UTF8_BOM;
use clip::{Rejected, rejected};

/// The bytes of a buffer, or the reason why it has none.
pub(super) type Buffer<'a> = Result<Cow<'a, [u8]>, Rejected>;

pub(super) fn part(bytes: &[u8], offset: u64, len: u64) -> Option<&[u8]> {
    let start = usize::try_from(offset).ok()?;
    let end = start.checked_add(usize::try_from(len).ok()?)?;
    bytes.get(start..end)
}

pub(super) fn little_endian(bytes: &[u8]) -> u64 {
    let digits = bytes.iter().rev();
    digits.fold(0, |number, &byte| (number << 8) | u64::from(byte))
}

pub(super) const MAGIC: &[u8] = b"glTF";

/// The JSON of a file and its binary chunk, if it has one.
pub(super) fn chunks(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), Rejected> {
    const HEADER_LEN: usize = 12;
    const CHUNK_HEADER_LEN: usize = 8;
    const VERSION: u64 = 2;
    if !bytes.starts_with(MAGIC) {
        return Ok((bytes.strip_prefix(UTF8_BOM).unwrap_or(bytes), None));
    }
    let broken = |reason: String, at: usize| Rejected::read("E-GLTF-CHUNK", reason).at(at);
    let found = bytes.len();
    let header = bytes.get(MAGIC.len()..HEADER_LEN).ok_or_else(|| {
        let reason = format!("found {found} bytes, expected a header of {HEADER_LEN}");
        broken(reason, found)
    })?;
    let (version, length) = (little_endian(&header[..4]), little_endian(&header[4..]));
    if version != VERSION {
        let reason = format!("found version {version}, expected {VERSION}");
        return Err(broken(reason, 4));
    }
    let body = usize::try_from(length)
        .ok()
        .and_then(|length| bytes.get(HEADER_LEN..length))
        .ok_or_else(|| {
            let reason = format!("the header says {length} bytes, the file has {found}");
            broken(reason, 8)
        })?;
    let mut chunks: Vec<(&[u8], &[u8])> = Vec::new();
    let mut rest = body;
    while !rest.is_empty() {
        let at = HEADER_LEN + body.len() - rest.len();
        let header = rest
            .get(..CHUNK_HEADER_LEN)
            .ok_or_else(|| broken(format!("{} bytes follow the last chunk", rest.len()), at))?;
        let length = little_endian(&header[..4]);
        let chunk = part(rest, CHUNK_HEADER_LEN as u64, length).ok_or_else(|| {
            let left = rest.len() - CHUNK_HEADER_LEN;
            let reason = format!("a chunk of {length} bytes is announced where {left} are left");
            broken(reason, at)
        })?;
        chunks.push((&header[4..], chunk));
        rest = &rest[CHUNK_HEADER_LEN + chunk.len()..];
    }
    match chunks[..] {
        [(b"JSON", text), ref others @ ..] => {
            let binary = others.first().filter(|(kind, _)| *kind == b"BIN\0");
            Ok((text, binary.map(|(_, chunk)| *chunk)))
        }
        _ => Err(broken("the first chunk is not JSON".to_owned(), HEADER_LEN)),
    }
}

pub(super) fn buffer_bytes<'a>(
    index: usize,
    buffer: &json::Buffer,
    binary: Option<&'a [u8]>,
) -> Buffer<'a> {
    let bytes: Cow<'a, [u8]> = match (buffer.uri.as_deref(), binary) {
        (Some(uri), _) => Cow::Owned(decode_uri(index, uri)?),
        (None, Some(binary)) if index == 0 => Cow::Borrowed(binary),
        (None, _) => {
            let reason = format!("buffer {index} has neither bytes nor a URI");
            return Err(Rejected::read("E-GLTF-BUFFER", reason));
        }
    };
    let expected = buffer.byte_length.0;
    if (bytes.len() as u64) < expected {
        return Err(rejected!(
            "E-GLTF-BUFFER",
            "buffer {index} has {} bytes, expected {expected} as the file says",
            bytes.len()
        ));
    }
    Ok(bytes)
}

fn decode_uri(index: usize, uri: &str) -> Result<Vec<u8>, Rejected> {
    /// Number of characters of a URI in a message.
    const SHOWN: usize = 40;
    let Some(data) = uri.strip_prefix("data:") else {
        let shown: String = uri
            .chars()
            .filter(|c| !c.is_control())
            .take(SHOWN)
            .collect();
        return Err(rejected!(
            "E-GLTF-URI",
            "buffer {index} is in another file ({shown}); pack the model into one file, as GLB \
                 or with embedded buffers"
        ));
    };
    let text = data
        .split_once(',')
        .filter(|(kind, _)| kind.ends_with(";base64"))
        .map(|(_, text)| text);
    text.and_then(|text| STANDARD.decode(text).ok())
        .ok_or_else(|| rejected!("E-GLTF-BUFFER", "buffer {index} is no base64 data"))
}
