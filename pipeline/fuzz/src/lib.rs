//! Bodies of the fuzz targets.
//!
//! A test of the workspace runs these functions on a few inputs; fuzzing them needs `cargo fuzz`. From `pipeline/`:
//!
//! ```text
//! cargo fuzz run --features libfuzzer --sanitizer none bvh
//! ```

use std::path::Path;

use datasets_spec::Skeleton;
use datasets_spec::manifest::Manifest;
use formats::retarget;
use formats::sidecar::Sidecar;
use formats::source::bvh::BvhFile;
use formats::source::labels::parse_captions;
use formats::source::seed::Timelines;
use formats::source::{
    ReadOptions, amass, c3d, fbx, gltf, motionx, representation_272, stance, trc,
};
use pickle::{joblib, npy};

/// Parses and retargets a BVH file.
pub fn bvh(bytes: &[u8]) {
    if let Ok(bvh) = BvhFile::parse(bytes) {
        let _clip = retarget::clip(&bvh, &ReadOptions::default());
    }
}

/// Parses a C3D file.
pub fn c3d(bytes: &[u8]) {
    if let Ok(Some(capture)) = c3d::capture(bytes, &ReadOptions::default()) {
        let markers = capture.markers;
        assert_eq!(markers.positions.len(), markers.residuals.len());
        let mut numbers = markers.positions.iter().flatten();
        assert!(numbers.all(|number| number.is_finite()));
    }
}

/// Parses the bytes as captions of HumanML3D, as temporal labels of BONES-SEED, and as a sidecar.
pub fn captions(bytes: &[u8]) {
    let _labels = Timelines::parse(bytes, &|_| true);
    let text = String::from_utf8_lossy(bytes);
    let (captions, others) = parse_captions(&text);
    assert!(captions.len() + others.len() <= text.lines().count());
    let _sidecar = serde_json::from_slice::<Sidecar>(bytes);
}

/// Reads every take of an FBX file.
pub fn fbx(bytes: &[u8]) {
    let options = ReadOptions::default();
    let mut keys = fbx::keys(bytes);
    keys.push(String::new());
    for key in keys {
        let _content = fbx::read(bytes, &key, &options);
    }
}

/// Reads every animation of a GLB or glTF file.
pub fn glb(bytes: &[u8]) {
    let options = ReadOptions::default();
    for key in gltf::keys(bytes) {
        let _content = gltf::read(bytes, &key, &options);
    }
}

/// Parses a manifest.
pub fn manifest(bytes: &[u8]) {
    if let Ok(manifest) = serde_json::from_slice::<Manifest>(bytes) {
        let _hash = Manifest::compute_root_hash(&manifest.tables);
        let _balanced = manifest.accounting.balances();
    }
}

/// Reads the bytes as an AMASS archive, as a single array, as a motion of Motion-X, and as 272 features.
pub fn npz(bytes: &[u8]) {
    let _clip = motionx::read_array(bytes, &Skeleton::smplx_neutral());
    let _archive = amass::read(Path::new("clip.npz"), bytes, &ReadOptions::default());
    let _numbers = npy::read_numbers("member", bytes);
    let _text = npy::read_text("member", bytes);
    let _features = representation_272::read_array(bytes, &Skeleton::smplx_neutral());
}

/// Reads the bytes as a pickle, as a dump of joblib and as a motion of the STANCE release.
pub fn pickle(bytes: &[u8]) {
    let _value = ::pickle::read(bytes);
    let _dump = joblib::read(bytes);
    let _motion = stance::read_pickle_motion(bytes, &Skeleton::smplx_neutral());
}

/// Parses a TRC file.
pub fn trc(bytes: &[u8]) {
    for lenient in [false, true] {
        let options = ReadOptions {
            lenient,
            ..ReadOptions::default()
        };
        if let Ok(capture) = trc::capture(bytes, &options) {
            let markers = capture.markers;
            assert_eq!(markers.positions.len(), markers.residuals.len());
            let mut numbers = markers.positions.iter().flatten();
            assert!(numbers.all(|number| number.is_finite()));
        }
    }
}

#[cfg(test)]
mod tests {
    use formats::source::{FORMATS, Format};

    use super::*;

    /// Reads every motion of a file in a format.
    fn read(format: Format, bytes: &[u8]) {
        let options = ReadOptions::default();
        let mut keys = format.keys(bytes, &options);
        keys.push(String::new());
        for key in keys {
            let _outcome = (format.read)(Path::new("file"), &key, bytes, &options);
        }
    }

    #[test]
    fn no_target_and_no_format_panics_on_the_beginnings_of_files() {
        let targets = [bvh, c3d, captions, fbx, glb, manifest, npz, pickle, trc];
        let seeds: [&[u8]; 11] = [
            b"",
            b"HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\nCHANNELS 3 Xrotation",
            b"\x02\x50\x01\x00",
            b"PathFileType\t4\nDataRate\tNumFrames\tNumMarkers\n1\t1\t1\nFrame#\tTime\tA",
            b"a#a/DET#0.0#0.0\n{}",
            b"Kaydara FBX Binary  \0\x1a\0\xe8\x1c\0\0\xff\0\0\0\x01\0\0\0",
            b"; FBX 7.4.0 project file\nObjects:  {\n\tModel: 1, \"Model::Hips\", \"LimbNode\" {",
            b"glTF\x02\x00\x00\x00\x0c\x00\x00\x00",
            b"{\"format\": \"stance-dataset\"}",
            b"\x93NUMPY\x01\x00\x10\x00{'descr': '<f8'",
            b"\x80\x04\x95\xff\xff\xff\xff\xff\xff\xff\xff.",
        ];
        for seed in seeds {
            for target in targets {
                target(seed);
            }
            for format in FORMATS {
                read(*format, seed);
            }
        }
    }
}
