//! Any bytes as a file of HumanML3D captions and as a sidecar.
#![no_main]

use libfuzzer_sys::fuzz_target;
use pipeline::sidecar::Sidecar;
use pipeline::source::labels::parse_captions;

fuzz_target!(|bytes: &[u8]| {
    let text = String::from_utf8_lossy(bytes);
    let (captions, num_other) = parse_captions(&text);
    assert!(captions.len() + num_other <= text.lines().count());
    let _sidecar = serde_json::from_slice::<Sidecar>(bytes);
});
