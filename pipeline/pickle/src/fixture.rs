//! Test files that Python 3.11 wrote with NumPy 2.4 and joblib 1.6. A line of `fixture.tsv` is a name and a file in
//! base64.
//!
//! All hold `rots` (0 to 5 as f4 `[2, 3]`), `text`, `F` (the same numbers in big-endian f8, column-major), `s` (f8 2.5)
//! and `n` (i2 -3). In joblib dumps, `o` is an array of the objects "x" and None; in plain pickles it is two bytes.
//! Plain pickles also hold `od`, `set`, `big` (2^70) and `u` (text "ab" and "c").

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

/// Number of joblib dumps, which come first, and of plain pickles, which follow.
pub(crate) const NUM_DUMPS: usize = 7;
pub(crate) const NUM_PICKLES: usize = 3;

/// Name and bytes of a fixture.
fn fixture(index: usize) -> (&'static str, Vec<u8>) {
    let mut lines = include_str!("fixture.tsv").lines();
    let line = lines.nth(index).expect("a line");
    let (name, base64) = line.split_once('\t').expect("two columns");
    (name, STANDARD.decode(base64).expect("valid base64"))
}

/// A joblib dump. That of index 0 is not compressed; each other one is compressed by another method.
pub(crate) fn dump(index: usize) -> (&'static str, Vec<u8>) {
    fixture(index)
}

/// A plain pickle: protocol 0, 2 or 5 for index 0, 1 or 2.
pub(crate) fn pickle(index: usize) -> (&'static str, Vec<u8>) {
    fixture(NUM_DUMPS + index)
}
