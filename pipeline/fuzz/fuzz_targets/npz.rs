//! Any bytes as an npz archive, and the same bytes as a single npy file.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use pickle::npy;
use pipeline::source::{ReadOptions, amass};

fuzz_target!(|bytes: &[u8]| {
    let _archive = amass::read(Path::new("clip.npz"), bytes, &ReadOptions::default());
    let _numbers = npy::read_numbers("member", bytes);
    let _text = npy::read_text("member", bytes);
});
