//! Any bytes as the manifest of a dataset.
#![no_main]

use datasets_spec::manifest::Manifest;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(manifest) = serde_json::from_slice::<Manifest>(bytes) {
        let _hash = Manifest::compute_root_hash(&manifest.tables);
        let _balanced = manifest.accounting.balances();
    }
});
