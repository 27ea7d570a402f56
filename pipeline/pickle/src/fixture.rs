//! Dumps of Python 3.11 with NumPy 2.4 and joblib 1.6, in `fixture.tsv` with their names, in base64.
//!
//! All hold `rots` (0 to 5 as f4 `[2, 3]`), `text`, `F` (the same in big-endian f8, column-major),
//! `s` (f8 2.5) and `n` (i2 -3). The dumps also hold `o`, an array of the objects "x" and None; the
//! plain pickles hold there two bytes, and `od`, `set`, `big` (2^70) and `u` (text "ab" and "c").

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

/// Number of dumps of joblib, and of plain pickles after them.
pub(crate) const NUM_DUMPS: usize = 7;
pub(crate) const NUM_PICKLES: usize = 3;

/// Name and bytes of a fixture.
fn fixture(index: usize) -> (&'static str, Vec<u8>) {
    let mut lines = include_str!("fixture.tsv").lines();
    let line = lines.nth(index).expect("a line");
    let (name, base64) = line.split_once('\t').expect("two columns");
    (name, STANDARD.decode(base64).expect("valid base64"))
}

/// A joblib dump: uncompressed first, then one of each compressor.
pub(crate) fn dump(index: usize) -> (&'static str, Vec<u8>) {
    fixture(index)
}

/// A plain pickle of protocol 0, 2 or 5.
pub(crate) fn pickle(index: usize) -> (&'static str, Vec<u8>) {
    fixture(NUM_DUMPS + index)
}
