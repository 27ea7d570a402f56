//! Any bytes as a glTF document or a GLB file: its animations, and every one of them.
#![no_main]

use libfuzzer_sys::fuzz_target;
use pipeline::source::{ReadOptions, gltf};

fuzz_target!(|bytes: &[u8]| {
    let options = ReadOptions::default();
    for key in gltf::keys(bytes) {
        let _content = gltf::read(bytes, &key, &options);
    }
});
