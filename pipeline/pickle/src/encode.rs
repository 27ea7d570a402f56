//! Python pickles of plain values and NumPy arrays.

use std::io::{self, Write};

use crate::array::{Array, Dtype};
use crate::value::Value;

/// The oldest protocol with lengths of 64 bits; Python 3.4 and later read it.
const PROTOCOL: u8 = 4;

/// Encodes a value as a pickle that Python reads back with `pickle.load`. Arrays need NumPy, of any version.
pub fn encode(value: &Value) -> Vec<u8> {
    let mut out = vec![0x80, PROTOCOL];
    put(&mut out, value);
    out.push(b'.');
    out
}

/// Writes the pickle of a dictionary entry by entry, for dictionaries that do not fit into memory.
#[derive(Debug)]
pub struct DictWriter<W> {
    out: W,
    entry: Vec<u8>,
}

impl<W: Write> DictWriter<W> {
    /// Begins the dictionary.
    ///
    /// # Errors
    /// Writing fails.
    pub fn new(mut out: W) -> io::Result<Self> {
        out.write_all(&[0x80, PROTOCOL, b'}'])?;
        let entry = Vec::new();
        Ok(Self { out, entry })
    }

    /// Adds an entry. A key that is added again replaces the earlier entry when Python reads the pickle.
    ///
    /// # Errors
    /// Writing fails.
    pub fn entry(&mut self, key: &Value, value: &Value) -> io::Result<()> {
        self.entry.clear();
        put(&mut self.entry, key);
        put(&mut self.entry, value);
        self.entry.push(b's');
        self.out.write_all(&self.entry)
    }

    /// Ends the dictionary and returns the stream.
    ///
    /// # Errors
    /// Writing fails.
    pub fn finish(mut self) -> io::Result<W> {
        self.out.write_all(b".")?;
        self.out.flush()?;
        Ok(self.out)
    }
}

fn put(out: &mut Vec<u8>, value: &Value) {
    match value {
        Value::None => out.push(b'N'),
        Value::Bool(true) => out.push(0x88),
        Value::Bool(false) => out.push(0x89),
        Value::Int(number) => put_int(out, *number),
        Value::Float(number) => {
            out.push(b'G');
            out.extend(number.to_be_bytes());
        }
        Value::Str(text) => put_text(out, text),
        Value::Bytes(bytes) => put_bytes(out, bytes),
        Value::List(items) => {
            out.extend(b"](");
            items.iter().for_each(|item| put(out, item));
            out.push(b'e');
        }
        Value::Tuple(items) => put_tuple(out, |out| items.iter().for_each(|item| put(out, item))),
        Value::Set(items) => {
            out.extend([0x8f, b'(']);
            items.iter().for_each(|item| put(out, item));
            out.push(0x90);
        }
        Value::Dict(entries) => {
            out.extend(b"}(");
            for (key, value) in entries {
                put(out, key);
                put(out, value);
            }
            out.push(b'u');
        }
        Value::Array(array) => put_array(out, array),
    }
}

fn put_int(out: &mut Vec<u8>, number: i128) {
    if let Ok(small) = u8::try_from(number) {
        out.extend([b'K', small]);
    } else if let Ok(word) = i32::try_from(number) {
        out.push(b'J');
        out.extend(word.to_le_bytes());
    } else {
        let bytes = number.to_le_bytes();
        out.extend([0x8a, bytes.len() as u8]);
        out.extend(bytes);
    }
}

fn put_text(out: &mut Vec<u8>, text: &str) {
    put_sized(out, [0x8c, 0x8d], text.as_bytes());
}

fn put_bytes(out: &mut Vec<u8>, bytes: &[u8]) {
    put_sized(out, [b'C', 0x8e], bytes);
}

/// Writes an opcode, the length and the bytes. Lengths below 256 take the opcode `short`, others `long`.
fn put_sized(out: &mut Vec<u8>, [short, long]: [u8; 2], bytes: &[u8]) {
    match u8::try_from(bytes.len()) {
        Ok(len) => out.extend([short, len]),
        Err(_) => {
            out.push(long);
            out.extend((bytes.len() as u64).to_le_bytes());
        }
    }
    out.extend(bytes);
}

fn put_tuple(out: &mut Vec<u8>, items: impl FnOnce(&mut Vec<u8>)) {
    out.push(b'(');
    items(out);
    out.push(b't');
}

fn put_global(out: &mut Vec<u8>, module: &str, name: &str) {
    put_text(out, module);
    put_text(out, name);
    out.push(0x93);
}

/// Writes an array as NumPy does: a call that makes an empty array, then its state (version, shape, type, order,
/// bytes). The module name is that of NumPy 1, which NumPy 2 still accepts.
fn put_array(out: &mut Vec<u8>, array: &Array) {
    put_global(out, "numpy.core.multiarray", "_reconstruct");
    put_tuple(out, |out| {
        put_global(out, "numpy", "ndarray");
        put_tuple(out, |out| put_int(out, 0));
        put_bytes(out, b"b");
    });
    out.push(b'R');
    put_tuple(out, |out| {
        put_int(out, 1);
        put_tuple(out, |out| {
            let extents = array.shape().iter();
            extents.for_each(|&extent| put_int(out, extent as i128));
        });
        put_dtype(out, array.dtype());
        put(out, &Value::Bool(false));
        put_bytes(out, array.data());
    });
    out.push(b'b');
}

/// Writes a type and its state: version, byte order, no inner type, no fields, length and alignment (-1 if the type
/// implies them), no flags.
fn put_dtype(out: &mut Vec<u8>, dtype: Dtype) {
    put_global(out, "numpy", "dtype");
    put_tuple(out, |out| {
        put_text(out, &dtype.to_string());
        put(out, &Value::Bool(false));
        put(out, &Value::Bool(true));
    });
    out.push(b'R');
    let (order, len, alignment) = match dtype {
        Dtype::Bytes(len) => ("|", len as i128, 1),
        Dtype::Text(_) => ("<", dtype.item_len() as i128, 4),
        _ if dtype.item_len() == 1 => ("|", -1, -1),
        _ => ("<", -1, -1),
    };
    put_tuple(out, |out| {
        put_int(out, 3);
        put_text(out, order);
        out.extend(b"NNN");
        put_int(out, len);
        put_int(out, alignment);
        put_int(out, 0);
    });
    out.push(b'b');
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::read;

    #[test]
    fn a_dictionary_written_by_entries_is_read_back() {
        let array = Array::from_f32(&[2, 1], [0.5, -2.0]);
        let entries = [
            (Value::text("first"), Value::Array(Arc::new(array))),
            (Value::Int(2), Value::dict([("text", Value::text("raise"))])),
        ];
        for count in 0..=entries.len() {
            let mut writer = DictWriter::new(Vec::new()).expect("in memory");
            for (key, value) in &entries[..count] {
                writer.entry(key, value).expect("in memory");
            }
            let bytes = writer.finish().expect("in memory");
            let expected = Value::Dict(entries[..count].to_vec());
            assert_eq!(read(&bytes), Ok(expected.clone()));
            let of_joblib = crate::joblib::read(&bytes);
            assert_eq!(of_joblib, Ok(expected), "as joblib reads it");
        }
    }

    #[test]
    fn long_texts_arrays_and_sets_are_read_back() {
        let array = Array::from_f32(&[2, 3], [0.0, -1.5, f32::MIN_POSITIVE, 3.0, 4.0, 5e30]);
        let (key, bytes) = ("é".repeat(300), Value::Bytes(Arc::from([7; 300])));
        let value = Value::dict([
            (key.as_str(), bytes),
            ("array", Value::Array(Arc::new(array))),
            ("set", Value::Set(vec![Value::Int(1)])),
        ]);
        assert_eq!(read(&encode(&value)), Ok(value));
    }
}
