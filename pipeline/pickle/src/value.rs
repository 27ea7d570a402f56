//! Python pickles, read as data and never executed.
//!
//! A pickle is a program for a small stack machine, and most of what it can ask for is code. Here
//! the machine knows values (numbers, text, bytes, lists, tuples, sets, dictionaries) and a closed
//! list of names whose meaning is written out in this module: NumPy's arrays, scalars and types,
//! ordered dictionaries, tensors of PyTorch and the array wrappers of joblib. Any other name is
//! refused where it stands, with the name and its place; nothing is ever imported or called.
//!
//! Lengths and shapes are held against the bytes that are there before anything is allocated by
//! them; depth, number of objects and sharing are bounded.

mod array;
mod input;
mod machine;
mod object;
mod torch;

use std::io::Read;
use std::sync::Arc;

pub use array::{Array, Dtype};
use machine::Machine;

use super::Rejected;

/// A value of a pickle.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// `None`.
    None,
    /// `True` or `False`.
    Bool(bool),
    /// A whole number.
    Int(i128),
    /// A floating-point number.
    Float(f64),
    /// Text; a `str` of Python 2 is read as Latin-1.
    Str(Arc<str>),
    /// Bytes, or a byte array.
    Bytes(Arc<[u8]>),
    /// A list, or the items of an array of objects in row-major order.
    List(Vec<Value>),
    /// A tuple.
    Tuple(Vec<Value>),
    /// A set.
    Set(Vec<Value>),
    /// A dictionary in its written order.
    Dict(Vec<(Value, Value)>),
    /// An array or a tensor.
    Array(Arc<Array>),
}

impl Value {
    /// Text as a value.
    pub fn text(text: &str) -> Self {
        Self::Str(text.into())
    }

    /// The value a dictionary has under a text key; the last one if the key was written twice.
    pub fn get(&self, key: &str) -> Option<&Value> {
        self.as_dict()?
            .iter()
            .rev()
            .find(|(found, _)| found.as_str() == Some(key))
            .map(|(_, value)| value)
    }

    /// The entries of a dictionary.
    pub fn as_dict(&self) -> Option<&[(Value, Value)]> {
        match self {
            Self::Dict(entries) => Some(entries),
            _ => None,
        }
    }

    /// The items of a list or tuple.
    pub fn as_sequence(&self) -> Option<&[Value]> {
        match self {
            Self::List(items) | Self::Tuple(items) => Some(items),
            _ => None,
        }
    }

    /// The text of a string, or of an array of one string.
    pub fn as_str(&self) -> Option<&str> {
        match self {
            Self::Str(text) => Some(text),
            _ => None,
        }
    }

    /// A whole number.
    pub fn as_int(&self) -> Option<i128> {
        match self {
            Self::Int(number) => Some(*number),
            _ => None,
        }
    }

    /// A number of either kind.
    pub fn as_float(&self) -> Option<f64> {
        match self {
            Self::Int(number) => Some(*number as f64),
            Self::Float(number) => Some(*number),
            _ => None,
        }
    }

    /// An array.
    pub fn as_array(&self) -> Option<&Array> {
        match self {
            Self::Array(array) => Some(array),
            _ => None,
        }
    }

    /// What a message says the value is: a dictionary by its keys, an array by type and shape.
    pub fn describe(&self) -> String {
        /// Keys named in a message.
        const NAMED_KEYS: usize = 12;
        match self {
            Self::None => "None".to_owned(),
            Self::Bool(_) => "a truth value".to_owned(),
            Self::Int(_) | Self::Float(_) => "a number".to_owned(),
            Self::Str(_) => "text".to_owned(),
            Self::Bytes(bytes) => format!("{} bytes", bytes.len()),
            Self::List(items) => format!("a list of {}", items.len()),
            Self::Tuple(items) => format!("a tuple of {}", items.len()),
            Self::Set(items) => format!("a set of {}", items.len()),
            Self::Array(array) => format!("an array {} {:?}", array.dtype(), array.shape()),
            Self::Dict(entries) => {
                let mut keys: Vec<String> = entries
                    .iter()
                    .take(NAMED_KEYS)
                    .map(|(key, _)| match key {
                        Self::Str(text) => text.to_string(),
                        Self::Int(number) => number.to_string(),
                        other => other.describe(),
                    })
                    .collect();
                keys.sort();
                if entries.len() > NAMED_KEYS {
                    keys.push(format!("and {} more", entries.len() - NAMED_KEYS));
                }
                format!("a dictionary with the keys {}", keys.join(", "))
            }
        }
    }
}

/// What is kept of a large pickle.
#[derive(Clone, Copy, Debug, Default)]
pub struct Options<'a> {
    /// Keys whose values are read and dropped at once: they become [`Value::None`].
    pub drop_keys: &'a [&'a str],
    /// Keep arrays of double precision in single precision.
    pub single_precision: bool,
}

/// The first bytes of a pickle of any protocol: a protocol mark, or a container of protocols 0
/// and 1.
pub fn has_magic(head: &[u8]) -> bool {
    match head {
        [0x80, version, ..] => *version <= machine::MAX_PROTOCOL,
        [b'(', b'd' | b'l' | b't', ..] | [b'}' | b']', b'q' | b'.', ..] => true,
        _ => false,
    }
}

/// Reads a pickle.
///
/// # Errors
/// `E-PICKLE-REFUSED` for anything that would be code, `E-PICKLE-TRUNCATED` if the bytes end too
/// early, `E-PICKLE-LIMIT` where a bound is exceeded, `E-PICKLE-DTYPE` and `E-PICKLE-SHAPE` for
/// arrays, `E-PICKLE-FORMAT` for anything that is no pickle.
pub fn read(bytes: &[u8]) -> Result<Value, Rejected> {
    read_from(bytes, &Options::default())
}

/// Reads a pickle from a stream.
///
/// # Errors
/// As [`read`]; `E-PICKLE-UNPACK` if the stream is packed and damaged, `E-IO` if it fails.
pub fn read_from<'a>(reader: impl Read + 'a, options: &Options<'a>) -> Result<Value, Rejected> {
    Machine::new(reader, *options).read()
}

/// Reads a pickle in which joblib's array wrappers are followed by the arrays' bytes.
///
/// # Errors
/// As [`read_from`].
pub(super) fn read_with_wrapped_arrays<'a>(
    reader: impl Read + 'a,
    options: &Options<'a>,
) -> Result<Value, Rejected> {
    Machine::new(reader, *options).with_wrapped_arrays().read()
}

pub use torch::read as read_torch;

#[cfg(test)]
pub(crate) mod fixture;
#[cfg(test)]
mod tests;
