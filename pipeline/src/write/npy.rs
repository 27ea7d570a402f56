//! Arrays in NumPy's npy format.

use std::io::{self, Write};

use npyz::WriterBuilder;

/// Writes an array of numbers, the last index running fastest.
///
/// # Errors
/// Writing fails, or the shape does not fit the numbers.
pub(crate) fn write<T: npyz::AutoSerialize>(
    out: impl Write,
    shape: &[u64],
    values: &[T],
) -> io::Result<()> {
    let mut writer = npyz::WriteOptions::new()
        .default_dtype()
        .shape(shape)
        .writer(out)
        .begin_nd()?;
    writer.extend(values)?;
    writer.finish()
}

/// [`write()`] to memory.
///
/// # Errors
/// As [`write()`].
pub(crate) fn encode<T: npyz::AutoSerialize>(shape: &[u64], values: &[T]) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    write(&mut bytes, shape, values)?;
    Ok(bytes)
}
