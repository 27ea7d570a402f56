//! Reading a pickle.

use std::io::Read;

use crate::error::Error;
use crate::machine::Machine;
use crate::value::{Options, Value};

/// Reads a pickle.
///
/// # Errors
/// `E-PICKLE-REFUSED` for anything that would be code, `E-PICKLE-TRUNCATED` if the bytes end too
/// early, `E-PICKLE-LIMIT` where a bound is exceeded, `E-PICKLE-DTYPE` and `E-PICKLE-SHAPE` for
/// arrays, `E-PICKLE-FORMAT` for anything that is no pickle.
pub fn read(bytes: &[u8]) -> Result<Value, Error> {
    read_from(bytes, &Options::default())
}

/// Reads a pickle from a stream.
///
/// # Errors
/// As [`read`]; `E-PICKLE-UNPACK` if the stream is packed and damaged, `E-IO` if it fails.
pub fn read_from<'a>(reader: impl Read + 'a, options: &Options<'a>) -> Result<Value, Error> {
    Machine::new(reader, *options).read()
}
