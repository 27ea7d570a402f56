//! Dumps of joblib: pickles in which the bytes of an array follow its wrapper. The whole file may be compressed.

use std::io::{self, Read};

use bzip2::read::BzDecoder;
use flate2::read::{MultiGzDecoder, ZlibDecoder};
use lz4_flex::frame::FrameDecoder;
use lzma_rust2::{LzmaReader, XzReader};

use crate::error::{Error, error};
use crate::machine::Machine;
use crate::value::{Options, Value};

/// Limits on the unpacked size of a dump: in bytes, and relative to its packed size. The largest known dump,
/// MotionFix's, unpacks to about 2 GB, less than 10 times its packed size.
const MAX_UNPACKED_LEN: u64 = 4 << 30;
const MAX_RATIO: u64 = 200;
/// Unpacked size in bytes up to which the ratio is not checked.
const SMALL_LEN: u64 = 64 << 20;
/// Maximum memory in KiB for the dictionary of an LZMA stream; the strongest preset of xz needs 64 MiB.
const LZMA_MEMORY_KIB: u32 = 128 << 10;
/// Number of bytes needed to recognise the compression.
const MAGIC_LEN: usize = 6;

/// Unpacks a dump. Its first bytes, `head`, tell the compression.
///
/// # Source
/// The prefixes in joblib's `compressor.py`.
fn unpacked<'a>(head: Vec<u8>, rest: impl Read + 'a) -> Result<Box<dyn Read + 'a>, Error> {
    let packed = io::Cursor::new(head.clone()).chain(rest);
    Ok(match head[..] {
        [0x78, ..] => Box::new(ZlibDecoder::new(packed)),
        [0x1f, 0x8b, ..] => Box::new(MultiGzDecoder::new(packed)),
        [b'B', b'Z', b'h', ..] => Box::new(BzDecoder::new(packed)),
        [0xfd, b'7', b'z', b'X', b'Z', 0] => {
            Box::new(XzReader::new_mem_limit(packed, true, LZMA_MEMORY_KIB))
        }
        [0x5d, 0x00, ..] => {
            let reader = LzmaReader::new_mem_limit(packed, LZMA_MEMORY_KIB, None);
            Box::new(reader.map_err(|error| {
                let reason = format!("found a damaged Lzma stream ({error})");
                Error::new("E-PICKLE-UNPACK", reason).at(0)
            })?)
        }
        [0x04, 0x22, 0x4d, 0x18, ..] => Box::new(FrameDecoder::new(packed)),
        [b'Z', b'F', ..] => {
            return Err(Error::new(
                "E-JOBLIB-OLD",
                "found a dump of joblib before 0.10, expected one of a newer version; load it \
                 there and dump it again",
            )
            .at(0));
        }
        _ => Box::new(packed),
    })
}

/// Reads a dump, compressed or not. Plain pickles are read too.
///
/// # Errors
/// `E-JOBLIB-OLD` for the layout before joblib 0.10, and those of [`crate::read_from`]; byte
/// offsets count in the unpacked stream.
pub fn read(bytes: &[u8]) -> Result<Value, Error> {
    read_from(bytes, bytes.len() as u64, &Options::default())
}

/// Reads a dump of `packed_len` bytes from a stream.
///
/// # Errors
/// As [`read`].
pub fn read_from<'a>(
    mut packed: impl Read + 'a,
    packed_len: u64,
    options: &Options<'a>,
) -> Result<Value, Error> {
    let mut head = Vec::new();
    packed
        .by_ref()
        .take(MAGIC_LEN as u64)
        .read_to_end(&mut head)
        .map_err(|error| error!("E-IO", "cannot read the dump ({error})"))?;
    let limit = packed_len
        .saturating_mul(MAX_RATIO)
        .clamp(SMALL_LEN, MAX_UNPACKED_LEN);
    let capped = Capped {
        inner: unpacked(head, packed)?,
        limit,
        left: limit,
    };
    let mut machine = Machine::new(capped, *options);
    machine.wrapped_arrays = true;
    machine.read()
}

/// A reader that fails after `limit` bytes.
struct Capped<R> {
    inner: R,
    limit: u64,
    left: u64,
}

impl<R: Read> Read for Capped<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.inner.read(buffer)?;
        self.left = self.left.checked_sub(read as u64).ok_or_else(|| {
            let reason = format!("it unpacks to more than {} bytes", self.limit);
            io::Error::new(io::ErrorKind::FileTooLarge, reason)
        })?;
        Ok(read)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use flate2::Compression;
    use flate2::write::ZlibEncoder;
    use proptest::prelude::*;

    use super::*;
    use crate::fixture::{NUM_DUMPS, dump};

    fn zlib(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
        encoder.write_all(bytes).expect("in memory");
        encoder.finish().expect("in memory")
    }

    #[test]
    fn dumps_of_every_packing_hold_the_same() {
        for (name, bytes) in (0..NUM_DUMPS).map(dump) {
            let value = read(&bytes).unwrap_or_else(|r| panic!("{name}: {r:?}"));
            for key in ["rots", "F"] {
                let array = value.get(key).and_then(Value::as_array).expect(name);
                assert_eq!(array.shape(), [2, 3], "{name}");
                let count = (0..6).map(f64::from).collect();
                assert_eq!(array.to_f64(), Some(count), "{name} {key}");
            }
            let objects = vec![Value::text("x"), Value::None];
            assert_eq!(value.get("o"), Some(&Value::List(objects)), "{name}");
            assert_eq!(value.get("s"), Some(&Value::Float(2.5)), "{name}");
            assert_eq!(value.get("text"), Some(&Value::text("raise")), "{name}");
        }
    }

    #[test]
    fn a_bomb_is_not_unpacked() {
        let len = SMALL_LEN + 1;
        let mut bomb = vec![0x80, 4, 0x8e];
        bomb.extend(len.to_le_bytes());
        bomb.resize(bomb.len() + len as usize, 0);
        bomb.push(b'.');
        let rejected = read(&zlib(&bomb)).expect_err("a thousand times its size");
        assert_eq!(rejected.code, "E-PICKLE-LIMIT", "{}", rejected.reason);
    }

    #[test]
    fn damaged_and_old_dumps_are_rejected_by_code() {
        let code = |bytes: &[u8]| read(bytes).expect_err("rejected").code;
        for (name, bytes) in (0..NUM_DUMPS).map(dump) {
            let code = code(&bytes[..bytes.len() / 2]);
            let known = ["E-PICKLE-TRUNCATED", "E-PICKLE-UNPACK"];
            assert!(known.contains(&code), "{name}: {code}");
        }
        assert_eq!(code(b"ZF0x1234"), "E-JOBLIB-OLD");
        assert_eq!(code(b"x\x9cnonsense"), "E-PICKLE-UNPACK");
        let rejected = read(b"cjoblib.numpy_pickle\nZNDArrayWrapper\n.").expect_err("old");
        assert_eq!(rejected.code, "E-PICKLE-REFUSED");
        let reason = rejected.reason;
        assert!(reason.contains("beside the dump"), "{reason}");
        // Outside a dump, no bytes follow a wrapper.
        let (_, plain) = dump(0);
        let rejected = crate::read(&plain).expect_err("a wrapper");
        assert_eq!(rejected.code, "E-PICKLE-FORMAT");
    }

    proptest! {
        #[test]
        fn no_bytes_make_it_panic(
            which in 0..NUM_DUMPS,
            edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        ) {
            let (_, mut bytes) = dump(which);
            for (at, byte) in edits {
                let at = at.index(bytes.len());
                bytes[at] = byte;
            }
            if let Err(rejected) = read(&bytes) {
                prop_assert!(rejected.code.starts_with("E-"));
            }
        }
    }
}
