//! Values that pickles hold.

use std::sync::Arc;

use crate::array::Array;

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

    /// A dictionary with text keys.
    pub fn dict<const N: usize>(entries: [(&str, Value); N]) -> Self {
        let entries = entries.map(|(key, value)| (Self::text(key), value));
        Self::Dict(entries.into())
    }

    /// An array of single-precision numbers.
    ///
    /// # Panics
    /// If the number of values does not match the shape.
    pub fn floats(shape: &[usize], numbers: impl IntoIterator<Item = f32>) -> Self {
        Self::Array(Arc::new(Array::from_f32(shape, numbers)))
    }

    /// The value of a text key in a dictionary; the last one if the key occurs several times.
    pub fn get(&self, key: &str) -> Option<&Value> {
        self.as_dict()?
            .iter()
            .rev()
            .find(|(found, _)| found.as_str() == Some(key))
            .map(|(_, value)| value)
    }

    /// The entries of a dictionary; `None` for other values.
    pub fn as_dict(&self) -> Option<&[(Value, Value)]> {
        match self {
            Self::Dict(entries) => Some(entries),
            _ => None,
        }
    }

    /// The items of a list or tuple; `None` for other values.
    pub fn as_sequence(&self) -> Option<&[Value]> {
        match self {
            Self::List(items) | Self::Tuple(items) => Some(items),
            _ => None,
        }
    }

    /// The text of a [`Value::Str`]; `None` for other values.
    pub fn as_str(&self) -> Option<&str> {
        match self {
            Self::Str(text) => Some(text),
            _ => None,
        }
    }

    /// An integer or floating-point number as `f64`; `None` for other values.
    pub fn as_float(&self) -> Option<f64> {
        match self {
            Self::Int(number) => Some(*number as f64),
            Self::Float(number) => Some(*number),
            _ => None,
        }
    }

    /// The array of a [`Value::Array`]; `None` for other values.
    pub fn as_array(&self) -> Option<&Array> {
        match self {
            Self::Array(array) => Some(array),
            _ => None,
        }
    }

    /// Description of the value for messages: a dictionary by its keys, an array by type and shape.
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

/// Options for reading large pickles.
#[derive(Clone, Copy, Debug, Default)]
pub struct Options<'a> {
    /// Dictionary keys whose values are dropped as soon as they are read; [`Value::None`] replaces them.
    pub drop_keys: &'a [&'a str],
    /// Whether arrays of double precision are converted to single precision.
    pub single_precision: bool,
}
