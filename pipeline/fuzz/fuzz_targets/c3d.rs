//! Any bytes as a C3D capture.
#![no_main]

use libfuzzer_sys::fuzz_target;
use pipeline::source::c3d::C3d;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(Some(capture)) = C3d::parse(bytes) {
        let markers = capture.markers;
        assert_eq!(markers.positions.len(), markers.residuals.len());
        assert!(markers.positions.iter().flatten().all(|number| number.is_finite()));
    }
});
