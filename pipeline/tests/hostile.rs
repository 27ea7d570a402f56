//! Broken and hostile files, each with the outcome it must have. Every fixture is made here.

use std::io::{Cursor, Write};
use std::path::{Path, PathBuf};

use corpus::{CorpusOptions, clip};
use datasets_spec::record::{MotionRow, QuarantineRow};
use datasets_spec::{Dataset, NoProgress, Skeleton};
use formats::write;
use pipeline::ingest::{IngestOptions, ingest};
use serde_json::{Value, json};

/// Required outcome of reading a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fate {
    /// A motion.
    Ingested,
    /// The quarantine table has a row with this code.
    Quarantined(&'static str),
    /// The file is skipped as not a motion.
    Skipped,
}

use Fate::{Ingested, Quarantined, Skipped};

/// A good AMASS archive.
fn good_npz() -> Vec<u8> {
    let motion = clip(0, &CorpusOptions::default()).motion;
    write::amass::encode(&motion, &Skeleton::smplx_neutral()).expect("encodes")
}

/// A good BVH file.
fn good_bvh() -> String {
    let motion = clip(1, &CorpusOptions::default()).motion;
    write::bvh::encode(&motion, &Skeleton::smplx_neutral())
}

/// An archive of the given members.
fn archive(members: &[(&str, &[u8])]) -> Vec<u8> {
    let mut out = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in members {
        out.start_file(*name, zip::write::SimpleFileOptions::default())
            .expect("starts");
        out.write_all(bytes).expect("writes");
    }
    out.finish().expect("finishes").into_inner()
}

/// An npy file with any header and any content.
fn npy(descr: &str, shape: &str, content: &[u8]) -> Vec<u8> {
    let header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend(u16::try_from(header.len()).expect("short").to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(content);
    bytes
}

fn f64s(values: impl IntoIterator<Item = f64>) -> Vec<u8> {
    values.into_iter().flat_map(f64::to_le_bytes).collect()
}

/// An AMASS archive of `frames` frames at 60 fps whose translation is made by `trans`.
fn amass(frames: usize, trans: impl Fn(usize) -> [f64; 3]) -> Vec<u8> {
    let poses = f64s((0..frames * 156).map(|index| 0.1 * ((index / 156) as f64 * 0.02).sin()));
    let trans = f64s((0..frames).flat_map(trans));
    archive(&[
        (
            "poses.npy",
            &npy("<f8", &format!("({frames}, 156)"), &poses),
        ),
        ("trans.npy", &npy("<f8", &format!("({frames}, 3)"), &trans)),
        ("mocap_framerate.npy", &npy("<f8", "()", &f64s([60.0]))),
        ("gender.npy", &npy("|S6", "()", b"female")),
    ])
}

/// A pickle that would create a file if it were executed.
fn canary_pickle(canary: &Path) -> Vec<u8> {
    format!("cos\nsystem\n(S'touch {}'\ntR.", canary.display()).into_bytes()
}

fn edited(text: &str, from: &str, to: &str) -> Vec<u8> {
    assert!(text.contains(from), "the fixture has {from:?}");
    text.replacen(from, to, 1).into_bytes()
}

fn npz_cases(canary: &Path) -> Vec<(&'static str, Vec<u8>, Fate)> {
    let good = good_npz();
    let mut bad_crc = good.clone();
    // Inside the first member's content, behind its local header.
    bad_crc[400] ^= 0xFF;
    let central = good
        .windows(4)
        .position(|window| window == b"PK\x01\x02")
        .expect("a central directory");
    let standing = |frame: usize| [0.0, 0.0, 0.9 + 0.001 * frame as f64];
    let pickled = npy("|O", "(1,)", &canary_pickle(canary));
    let lying = npy("<f8", "(1099511627776, 156)", &[0; 100]);
    let bomb = npy("<f8", "(2000000, 3)", &vec![0; 48_000_000]);
    vec![
        ("good.npz", good.clone(), Ingested),
        ("good_amass.npz", amass(60, standing), Ingested),
        (
            "truncated.npz",
            good[..good.len() / 2].to_vec(),
            Quarantined("E-NPZ-TRUNCATED"),
        ),
        (
            "no_directory.npz",
            good[..central].to_vec(),
            Quarantined("E-NPZ-TRUNCATED"),
        ),
        ("bad_crc.npz", bad_crc, Quarantined("E-NPZ-TRUNCATED")),
        ("empty.npz", Vec::new(), Quarantined("E-NPZ-TRUNCATED")),
        (
            "object.npz",
            archive(&[("poses.npy", &pickled), ("trans.npy", &pickled)]),
            Quarantined("E-PICKLE-REFUSED"),
        ),
        (
            "lying_shape.npz",
            archive(&[("poses.npy", &lying), ("trans.npy", &lying)]),
            Quarantined("E-NPY-SHAPE"),
        ),
        (
            "bomb.npz",
            archive(&[("poses.npy", &bomb), ("trans.npy", &bomb)]),
            Quarantined("E-NPZ-LIMIT"),
        ),
        (
            "traversal.npz",
            archive(&[("../../poses.npy", &npy("<f8", "(2, 3)", &[0; 48]))]),
            Quarantined("E-ARCHIVE-PATH"),
        ),
        (
            "absolute.npz",
            archive(&[("/etc/poses.npy", &npy("<f8", "(2, 3)", &[0; 48]))]),
            Quarantined("E-ARCHIVE-PATH"),
        ),
        (
            "drive.npz",
            archive(&[("C:\\poses.npy", &npy("<f8", "(2, 3)", &[0; 48]))]),
            Quarantined("E-ARCHIVE-PATH"),
        ),
        (
            "case.npz",
            archive(&[
                ("poses.npy", b"1"),
                ("Poses.npy", b"2"),
                ("trans.npy", b"3"),
            ]),
            Quarantined("E-ARCHIVE-PATH"),
        ),
        (
            "one_frame.npz",
            amass(1, standing),
            Quarantined("E-TOO-SHORT"),
        ),
        (
            "no_frame.npz",
            amass(0, standing),
            Quarantined("E-TOO-SHORT"),
        ),
        (
            "infinite.npz",
            amass(60, |frame| {
                [if frame == 7 { f64::INFINITY } else { 0.0 }, 0.0, 0.9]
            }),
            Quarantined("E-NOT-FINITE"),
        ),
        (
            "teleport.npz",
            amass(60, |frame| [if frame > 30 { 9.0 } else { 0.0 }, 0.0, 0.9]),
            Quarantined("E-TELEPORT"),
        ),
        (
            "shape.npz",
            archive(&[("betas.npy", &npy("<f8", "(16,)", &[0; 128]))]),
            Skipped,
        ),
        (
            "betas_only.npz",
            archive(&[("betas.npy", &npy("<f8", "(16,)", &[0; 128]))]),
            Skipped,
        ),
        (
            "neutral_stagei.npz",
            archive(&[("betas.npy", b"")]),
            Skipped,
        ),
    ]
}

fn bvh_cases() -> Vec<(&'static str, Vec<u8>, Fate)> {
    let good = good_bvh();
    let frames_line = good
        .lines()
        .find(|line| line.starts_with("Frames:"))
        .expect("a frame count")
        .to_owned();
    let time_line = good
        .lines()
        .find(|line| line.starts_with("Frame Time:"))
        .expect("a frame time")
        .to_owned();
    let crlf = good.replace('\n', "\r\n");
    let with_bom = [b"\xEF\xBB\xBF", good.as_bytes()].concat();
    let without_end_sites = {
        let mut kept = String::new();
        let mut skipping = 0;
        for line in good.lines() {
            if line.trim() == "End Site" {
                skipping = 4;
            }
            if skipping > 0 {
                skipping -= 1;
            } else {
                kept += line;
                kept.push('\n');
            }
        }
        kept
    };
    let motion_start = good.find("MOTION").expect("a motion");
    let rows_start = good.find(&time_line).expect("a frame time") + time_line.len();
    let commas = format!(
        "{}{}",
        &good[..rows_start],
        good[rows_start..].replace('.', ",")
    );
    vec![
        ("good.bvh", good.clone().into_bytes(), Ingested),
        ("crlf.bvh", crlf.into_bytes(), Ingested),
        ("bom.bvh", with_bom, Ingested),
        ("tabs.bvh", good.replace("  ", "\t").into_bytes(), Ingested),
        ("no_end_sites.bvh", without_end_sites.into_bytes(), Ingested),
        (
            "commas.bvh",
            commas.into_bytes(),
            Quarantined("E-BVH-NUMBER"),
        ),
        (
            "too_few_rows.bvh",
            edited(&good, &frames_line, "Frames: 100000"),
            Quarantined("E-BVH-FRAMES"),
        ),
        (
            "too_many_rows.bvh",
            edited(&good, &frames_line, "Frames: 3"),
            Quarantined("E-BVH-FRAMES"),
        ),
        (
            "zero_time.bvh",
            edited(&good, &time_line, "Frame Time: 0"),
            Quarantined("E-BVH-FRAME-TIME"),
        ),
        (
            "no_motion.bvh",
            good.as_bytes()[..motion_start].to_vec(),
            Quarantined("E-BVH-SYNTAX"),
        ),
        ("empty.bvh", Vec::new(), Quarantined("E-BVH-SYNTAX")),
        (
            "deep.bvh",
            format!("HIERARCHY\n{}", "ROOT a\n{\n".repeat(100_000)).into_bytes(),
            Quarantined("E-BVH-SYNTAX"),
        ),
    ]
}

/// Bytes of a block of a C3D file.
const C3D_BLOCK: usize = 512;

/// A whole C3D file of an Intel machine: one marker, three frames in floating point. One marker is
/// no body.
fn whole_c3d() -> Vec<u8> {
    let mut bytes = vec![0; 2 * C3D_BLOCK];
    bytes[..2].copy_from_slice(&[2, 0x50]);
    // Points, first and last frame, block of the data.
    for (number, value) in [(2, 1u16), (4, 1), (5, 3), (9, 3)] {
        bytes[2 * (number - 1)..2 * number].copy_from_slice(&value.to_le_bytes());
    }
    // A negative scale marks floating point; the rate is 100 frames per second.
    bytes[12..16].copy_from_slice(&(-0.5f32).to_le_bytes());
    bytes[20..24].copy_from_slice(&100f32.to_le_bytes());
    let mut parameters = vec![1, 0x50, 1, 84];
    for (id, name, content) in [
        (-1i8, "POINT", &[0][..]),
        (1, "LABELS", b"\xff\x02\x04\x01LKNE\x00"),
        (1, "UNITS", b"\xff\x01\x02mm\x00"),
    ] {
        parameters.extend([name.len() as u8, id as u8]);
        parameters.extend(name.as_bytes());
        parameters.extend((2 + content.len() as u16).to_le_bytes());
        parameters.extend(content);
    }
    parameters.extend([0, 0]);
    bytes[C3D_BLOCK..C3D_BLOCK + parameters.len()].copy_from_slice(&parameters);
    for frame in 0..3u8 {
        for value in [100.0, -20.0, 10.0 * f32::from(frame), 0.0] {
            bytes.extend(value.to_le_bytes());
        }
    }
    bytes
}

/// A copy of a file with other bytes at an offset.
fn poked(good: &[u8], at: usize, bytes: &[u8]) -> Vec<u8> {
    let mut broken = good.to_vec();
    broken[at..at + bytes.len()].copy_from_slice(bytes);
    broken
}

fn c3d_cases() -> Vec<(&'static str, Vec<u8>, Fate)> {
    let whole = whole_c3d();
    let poked = |at: usize, bytes: &[u8]| poked(&whole, at, bytes);
    let data = 2 * C3D_BLOCK;
    // Sizes of the array of labels.
    let labels = whole
        .windows(6)
        .position(|window| window == b"\x04\x01LKNE")
        .expect("the labels");
    vec![
        ("whole.c3d", whole.clone(), Quarantined("E-MARKERS")),
        ("empty.c3d", Vec::new(), Quarantined("E-C3D-TRUNCATED")),
        (
            "half_a_header.c3d",
            whole[..C3D_BLOCK / 2].to_vec(),
            Quarantined("E-C3D-TRUNCATED"),
        ),
        (
            "last_frame_cut.c3d",
            whole[..whole.len() - 5].to_vec(),
            Quarantined("E-C3D-TRUNCATED"),
        ),
        ("no_magic.c3d", poked(1, &[0]), Quarantined("E-C3D-HEADER")),
        (
            "parameters_beyond_the_end.c3d",
            poked(0, &[99]),
            Quarantined("E-C3D-HEADER"),
        ),
        (
            "unknown_processor.c3d",
            poked(C3D_BLOCK + 3, &[7]),
            Quarantined("E-C3D-HEADER"),
        ),
        (
            "parameter_too_large.c3d",
            poked(labels, &[0xff, 0xff]),
            Quarantined("E-C3D-PARAM"),
        ),
        (
            "too_many_points.c3d",
            poked(2, &60_000u16.to_le_bytes()),
            Quarantined("E-C3D-HEADER"),
        ),
        (
            "too_many_frames.c3d",
            poked(8, &60_000u16.to_le_bytes()),
            Quarantined("E-C3D-TRUNCATED"),
        ),
        (
            "frames_backwards.c3d",
            poked(6, &9u16.to_le_bytes()),
            Quarantined("E-C3D-HEADER"),
        ),
        (
            "data_beyond_the_end.c3d",
            poked(16, &9000u16.to_le_bytes()),
            Quarantined("E-C3D-TRUNCATED"),
        ),
        (
            "no_rate.c3d",
            poked(20, &0f32.to_le_bytes()),
            Quarantined("E-C3D-HEADER"),
        ),
        (
            "numbers_of_another_machine.c3d",
            poked(data, &[0x60, 0x00, 0x48, 0x7e].repeat(12)),
            Quarantined("E-C3D-ENDIAN"),
        ),
    ]
}

/// A good binary glTF file.
fn good_glb() -> Vec<u8> {
    let motion = clip(2, &CorpusOptions::default()).motion;
    write::gltf::encode(&motion, &Skeleton::smplx_neutral()).expect("encodes")
}

/// Offset of the JSON in a binary glTF file: after the file header and the chunk header.
const GLB_JSON: usize = 20;

/// A copy of a binary glTF file with changes to its JSON and its binary chunk.
fn rewritten(good: &[u8], json: impl Fn(&mut Value), binary: impl Fn(&mut [u8])) -> Vec<u8> {
    let length = u32::from_le_bytes(good[12..16].try_into().expect("four bytes")) as usize;
    let (document, chunk) = good[GLB_JSON..].split_at(length);
    let mut document: Value = serde_json::from_slice(document).expect("JSON");
    json(&mut document);
    let mut document = document.to_string().into_bytes();
    document.resize(document.len().next_multiple_of(4), b' ');
    let mut chunk = chunk.to_vec();
    binary(&mut chunk[8..]);
    let mut bytes = good[..8].to_vec();
    bytes.extend(((GLB_JSON + document.len() + chunk.len()) as u32).to_le_bytes());
    bytes.extend((document.len() as u32).to_le_bytes());
    bytes.extend(&good[16..GLB_JSON]);
    bytes.extend(document);
    bytes.extend(chunk);
    bytes
}

fn gltf_cases() -> Vec<(&'static str, Vec<u8>, Fate)> {
    let good = good_glb();
    let poked = |at: usize, bytes: &[u8]| poked(&good, at, bytes);
    let with = |pointer: &str, value: Value| {
        let set = |document: &mut Value| {
            let found = document.pointer_mut(pointer);
            *found.unwrap_or_else(|| panic!("the fixture has {pointer}")) = value.clone();
        };
        rewritten(&good, set, |_| ())
    };
    // The accessor of the key times, and its view.
    let read = |pointer: &str| {
        let length = u32::from_le_bytes(good[12..16].try_into().expect("four bytes")) as usize;
        let document: Value = serde_json::from_slice(&good[GLB_JSON..][..length]).expect("JSON");
        document
            .pointer(pointer)
            .and_then(Value::as_u64)
            .expect("an index")
    };
    let key_times = format!("/accessors/{}", read("/animations/0/samplers/0/input"));
    let key_view = format!("/bufferViews/{}", read(&format!("{key_times}/bufferView")));
    let with_uri = |uri: &str| {
        rewritten(
            &good,
            |document| document["buffers"][0]["uri"] = json!(uri),
            |_| (),
        )
    };
    let nan = rewritten(
        &good,
        |_| (),
        |binary| {
            for value in binary.chunks_exact_mut(4) {
                value.copy_from_slice(&f32::NAN.to_le_bytes());
            }
        },
    );
    vec![
        ("good.glb", good.clone(), Ingested),
        ("rewritten.glb", rewritten(&good, |_| (), |_| ()), Ingested),
        ("empty.glb", Vec::new(), Quarantined("E-GLTF-SYNTAX")),
        (
            "header_alone.glb",
            good[..12].to_vec(),
            Quarantined("E-GLTF-CHUNK"),
        ),
        (
            "half.glb",
            good[..good.len() / 2].to_vec(),
            Quarantined("E-GLTF-CHUNK"),
        ),
        (
            "another_version.glb",
            poked(4, &[1]),
            Quarantined("E-GLTF-CHUNK"),
        ),
        (
            "chunk_too_long.glb",
            poked(12, &u32::MAX.to_le_bytes()),
            Quarantined("E-GLTF-CHUNK"),
        ),
        (
            "no_json.glb",
            poked(GLB_JSON, b"]"),
            Quarantined("E-GLTF-SYNTAX"),
        ),
        (
            "too_many_numbers.glb",
            with(&format!("{key_times}/count"), json!(1u64 << 40)),
            Quarantined("E-GLTF-ACCESSOR"),
        ),
        (
            "view_beyond_the_end.glb",
            with(&format!("{key_view}/byteOffset"), json!(1u64 << 40)),
            Quarantined("E-GLTF-ACCESSOR"),
        ),
        (
            "buffer_too_long.glb",
            with("/buffers/0/byteLength", json!(1u64 << 40)),
            Quarantined("E-GLTF-BUFFER"),
        ),
        (
            "unknown_accessor.glb",
            with("/animations/0/samplers/0/input", json!(100_000)),
            Quarantined("E-GLTF-ACCESSOR"),
        ),
        (
            "ring_of_nodes.glb",
            with("/nodes/1/children", json!([0])),
            Quarantined("E-GLTF-NODES"),
        ),
        (
            "unknown_node.glb",
            with("/nodes/1/children", json!([100_000])),
            Quarantined("E-GLTF-NODES"),
        ),
        (
            "remote_buffer.glb",
            with_uri("https://example.org/motion.bin"),
            Quarantined("E-GLTF-URI"),
        ),
        (
            "buffer_of_another_folder.glb",
            with_uri("../../secret.bin"),
            Quarantined("E-GLTF-URI"),
        ),
        ("nan.glb", nan, Quarantined("E-NOT-FINITE")),
    ]
}

fn other_cases(canary: &Path) -> Vec<(&'static str, Vec<u8>, Fate)> {
    let pointer = b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 7\n";
    vec![
        (
            "payload.pkl",
            canary_pickle(canary),
            Quarantined("E-PICKLE-REFUSED"),
        ),
        (
            "payload.pickle",
            canary_pickle(canary),
            Quarantined("E-PICKLE-REFUSED"),
        ),
        (
            "pointer.bvh",
            pointer.to_vec(),
            Quarantined("E-LFS-POINTER"),
        ),
        (
            "pointer.npz",
            pointer.to_vec(),
            Quarantined("E-LFS-POINTER"),
        ),
        ("notes.txt", b"no motion".to_vec(), Skipped),
        ("picture.png", b"\x89PNG\r\n\x1a\n".to_vec(), Skipped),
        ("table.parquet", b"PAR1 but not really".to_vec(), Skipped),
    ]
}

#[test]
fn every_hostile_file_has_the_outcome_it_must_have() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let canary = dir.path().join("canary");
    let source = dir.path().join("source");
    std::fs::create_dir(&source).expect("made");
    let mut cases = npz_cases(&canary);
    cases.extend(bvh_cases());
    cases.extend(c3d_cases());
    cases.extend(gltf_cases());
    cases.extend(other_cases(&canary));
    for (name, bytes, _) in &cases {
        std::fs::write(source.join(name), bytes).expect("written");
    }
    let before = snapshot(&source);

    let out = dir.path().join("dataset");
    let report = ingest(
        std::slice::from_ref(&source),
        &out,
        &IngestOptions::default(),
        "the test",
        &NoProgress,
    )
    .expect("bad files do not end a run");
    assert!(report.accounting.balances());
    assert_eq!(report.accounting.sources, cases.len() as u64);
    assert!(!canary.exists(), "nothing in a file was executed");
    assert_eq!(snapshot(&source), before, "sources are never touched");

    let dataset = Dataset::open(&out).expect("whole");
    let motions: Vec<MotionRow> = dataset.read(None).expect("reads");
    let rejected: Vec<QuarantineRow> = dataset.read(None).expect("reads");
    let mut wrong = Vec::new();
    for (name, _, expected) in &cases {
        // The path of one clip of a file ends with its key.
        let of_file = |path: &str| path.split('#').next() == Some(*name);
        let row = rejected.iter().find(|row| of_file(&row.path));
        let found = match row {
            Some(row) => format!("Quarantined({:?})", row.code),
            None if motions.iter().any(|row| row.source_path == *name) => "Ingested".to_owned(),
            None => "Skipped".to_owned(),
        };
        if found != format!("{expected:?}") {
            let reason = row.map(|row| row.reason.clone()).unwrap_or_default();
            wrong.push(format!(
                "{name}: expected {expected:?}, found {found} {reason}"
            ));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(rejected.iter().all(|row| !row.reason.is_empty()));
}

/// Names and contents of a folder.
fn snapshot(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut files: Vec<(PathBuf, Vec<u8>)> = std::fs::read_dir(folder)
        .expect("listed")
        .map(|entry| {
            let path = entry.expect("listed").path();
            let bytes = std::fs::read(&path).expect("readable");
            (path, bytes)
        })
        .collect();
    files.sort();
    files
}

/// Links out of the tree, links in a circle and pipes do not stop or trap a run.
#[cfg(unix)]
#[test]
fn links_and_pipes_are_accounted_for() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let source = dir.path().join("source");
    std::fs::create_dir(&source).expect("made");
    std::fs::write(source.join("good.bvh"), good_bvh()).expect("written");
    let link = |to: &Path, name: &str| {
        std::os::unix::fs::symlink(to, source.join(name)).expect("linked");
    };
    link(&source, "circle");
    link(Path::new("good.bvh"), "again.bvh");
    link(Path::new("missing.bvh"), "dangling.bvh");
    let made = std::process::Command::new("mkfifo")
        .arg(source.join("pipe.bvh"))
        .status()
        .expect("mkfifo runs");
    assert!(made.success());
    let report = ingest(
        &[source],
        &dir.path().join("dataset"),
        &IngestOptions::default(),
        "the test",
        &NoProgress,
    )
    .expect("runs");
    let accounting = &report.accounting;
    assert_eq!(
        (
            accounting.ingested,
            accounting.quarantined,
            accounting.skipped
        ),
        (2, 1, 2),
        "{accounting:?} {:?}",
        report.skipped
    );
    assert_eq!(report.quarantine[0].path, "dangling.bvh");
    assert_eq!(report.quarantine[0].code, "E-IO");
}
