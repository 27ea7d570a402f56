//! Any bytes as an npz archive, and the same bytes as a single npy file.
#![no_main]

use std::path::Path;

use datasets_spec::Skeleton;
use libfuzzer_sys::fuzz_target;
use pipeline::source::{amass, npy};

fuzz_target!(|bytes: &[u8]| {
    let _archive = amass::read(Path::new("clip.npz"), bytes, &Skeleton::smplx_neutral());
    let _numbers = npy::read_numbers("member", bytes);
    let _text = npy::read_text("member", bytes);
});
