//! Containers of the Python world, read as data and never executed: pickles, dumps of joblib ([`joblib`]), files of
//! `torch.save` ([`torch`]), arrays of NumPy ([`npy`]) and archives of them ([`npz`]). Pickles, npy and npz are also
//! written.
//!
//! A pickle is a program for a stack machine that can run arbitrary code in Python. The machine here knows only
//! values (numbers, text, bytes, lists, tuples, sets, dictionaries) and a closed list of names that this
//! crate implements: NumPy's arrays, scalars and types, ordered dictionaries, tensors of PyTorch and the
//! array wrappers of joblib. Any other name is refused with its byte offset; nothing is imported or called.
//!
//! Lengths and shapes are checked against the available bytes before memory is allocated; depth, number of
//! objects and sharing are bounded.
//!
//! ```
//! use pickle::Value;
//!
//! let value = Value::Dict(vec![(Value::text("fps"), Value::Float(20.0))]);
//! let bytes = pickle::encode(&value);
//! assert_eq!(pickle::read(&bytes)?, value);
//!
//! let error = pickle::read(b"cos\nsystem\n.").expect_err("code is refused");
//! assert_eq!(error.code, "E-PICKLE-REFUSED");
//! # Ok::<(), pickle::Error>(())
//! ```

mod array;
mod encode;
mod error;
mod input;
pub mod joblib;
mod machine;
pub mod npy;
pub mod npz;
mod object;
pub mod torch;
mod value;

use std::io::Read;

use self::machine::Machine;

pub use array::{Array, Dtype};
pub use encode::{DictWriter, encode};
pub use error::Error;
pub use value::{Options, Value};

#[cfg(test)]
mod fixture;
#[cfg(test)]
mod tests;

/// Reads a pickle.
///
/// # Errors
/// `E-PICKLE-REFUSED` for anything that would run code, `E-PICKLE-TRUNCATED` if the bytes end too early,
/// `E-PICKLE-LIMIT` if a limit is exceeded, `E-PICKLE-DTYPE` and `E-PICKLE-SHAPE` for arrays, `E-PICKLE-FORMAT` if the
/// bytes are no pickle.
pub fn read(bytes: &[u8]) -> Result<Value, Error> {
    read_from(bytes, &Options::default())
}

/// Reads a pickle from a stream.
///
/// # Errors
/// As [`read`]; `E-PICKLE-UNPACK` if a compressed stream is damaged, `E-IO` if reading fails.
pub fn read_from<'a>(reader: impl Read + 'a, options: &Options<'a>) -> Result<Value, Error> {
    Machine::new(reader, *options).read()
}
