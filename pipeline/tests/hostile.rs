//! Broken and hostile files, each with the outcome it must have. Every fixture is made here.

use std::path::{Path, PathBuf};

use corpus::{CorpusOptions, clip};
use datasets_spec::record::{MotionRow, QuarantineRow};
use datasets_spec::{Dataset, NoProgress, Skeleton};
use formats::write;
use pipeline::ingest::{IngestOptions, IngestReport, ingest};
use serde_json::{Value, json};
use testkit::{npy_f8, npz};

/// Name and content of a file, and its outcome: [`INGESTED`], [`SKIPPED`], or the code of its row in the quarantine
/// table.
type Case = (&'static str, Vec<u8>, &'static str);

/// The file becomes a motion.
const INGESTED: &str = "ingested";
/// The file is skipped as not a motion.
const SKIPPED: &str = "skipped";

fn good_npz() -> Vec<u8> {
    let motion = clip(0, &CorpusOptions::default()).motion;
    write::amass::encode(&motion, &Skeleton::smplx_neutral()).expect("encodes")
}

fn good_bvh() -> String {
    let motion = clip(1, &CorpusOptions::default()).motion;
    write::bvh::encode(&motion, &Skeleton::smplx_neutral())
}

/// An npy file with any header and any content.
fn npy(descr: &str, shape: &str, content: &[u8]) -> Vec<u8> {
    let header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n");
    testkit::npy(&header, content)
}

/// An AMASS archive of `frames` frames at 60 fps whose translation is made by `trans`.
fn amass(frames: usize, trans: impl Fn(usize) -> [f64; 3]) -> Vec<u8> {
    let poses = (0..frames * 156).map(|index| 0.1 * ((index / 156) as f64 * 0.02).sin());
    let poses: Vec<f64> = poses.collect();
    let trans: Vec<f64> = (0..frames).flat_map(trans).collect();
    npz(&[
        ("poses", npy_f8(&[frames, 156], &poses)),
        ("trans", npy_f8(&[frames, 3], &trans)),
        ("mocap_framerate", npy_f8(&[], &[60.0])),
        ("gender", npy("|S6", "()", b"female")),
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

fn npz_cases(canary: &Path) -> Vec<Case> {
    let good = good_npz();
    let mut bad_crc = good.clone();
    // Inside the first member's content, behind its local header.
    bad_crc[400] ^= 0xFF;
    let mut places = good.windows(4);
    let central = places.position(|window| window == b"PK\x01\x02");
    let central = central.expect("a central directory");
    let half = good[..good.len() / 2].to_vec();
    let standing = |frame: usize| [0.0, 0.0, 0.9 + 0.001 * frame as f64];
    let infinite = |frame: usize| [if frame == 7 { f64::INFINITY } else { 0.0 }, 0.0, 0.9];
    let jumping = |frame: usize| [if frame > 30 { 9.0 } else { 0.0 }, 0.0, 0.9];
    let both = |array: Vec<u8>| npz(&[("poses", array.clone()), ("trans", array)]);
    let pickled = npy("|O", "(1,)", &canary_pickle(canary));
    let lying = npy("<f8", "(1099511627776, 156)", &[0; 100]);
    let bomb = npy("<f8", "(2000000, 3)", &vec![0; 48_000_000]);
    let named = |name: &str| npz(&[(name, npy_f8(&[2, 3], &[0.0; 6]))]);
    let case = ["poses", "Poses", "trans"].map(|name| (name, b"1".to_vec()));
    let betas = npz(&[("betas", npy_f8(&[16], &[0.0; 16]))]);
    vec![
        ("good.npz", good.clone(), INGESTED),
        ("good_amass.npz", amass(60, standing), INGESTED),
        ("truncated.npz", half, "E-NPZ-TRUNCATED"),
        ("cut.npz", good[..central].to_vec(), "E-NPZ-TRUNCATED"),
        ("bad_crc.npz", bad_crc, "E-NPZ-TRUNCATED"),
        ("empty.npz", Vec::new(), "E-NPZ-TRUNCATED"),
        ("object.npz", both(pickled), "E-PICKLE-REFUSED"),
        ("lying_shape.npz", both(lying), "E-NPY-SHAPE"),
        ("bomb.npz", both(bomb), "E-NPZ-LIMIT"),
        ("up.npz", named("../../poses"), "E-ARCHIVE-PATH"),
        ("absolute.npz", named("/etc/poses"), "E-ARCHIVE-PATH"),
        ("drive.npz", named("C:\\poses"), "E-ARCHIVE-PATH"),
        ("case.npz", npz(&case), "E-ARCHIVE-PATH"),
        ("one_frame.npz", amass(1, standing), "E-TOO-SHORT"),
        ("no_frame.npz", amass(0, standing), "E-TOO-SHORT"),
        ("infinite.npz", amass(60, infinite), "E-NOT-FINITE"),
        ("teleport.npz", amass(60, jumping), "E-TELEPORT"),
        ("shape.npz", betas.clone(), SKIPPED),
        ("betas_only.npz", betas, SKIPPED),
        ("neutral_stagei.npz", npz(&[("betas", Vec::new())]), SKIPPED),
    ]
}

fn bvh_cases() -> Vec<Case> {
    let good = good_bvh();
    let line = |start: &str| {
        let mut lines = good.lines();
        let found = lines.find(|line| line.starts_with(start));
        found.expect("in the fixture")
    };
    let (frames, time) = (line("Frames:"), line("Frame Time:"));
    let with = |from: &str, to: &str| edited(&good, from, to);
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
    let head = good.as_bytes()[..good.find("MOTION").expect("a motion")].to_vec();
    let rows_start = good.find(time).expect("a frame time") + time.len();
    let commas = good[..rows_start].to_owned() + &good[rows_start..].replace('.', ",");
    let deep = format!("HIERARCHY\n{}", "ROOT a\n{\n".repeat(100_000));
    vec![
        ("good.bvh", good.clone().into_bytes(), INGESTED),
        ("crlf.bvh", crlf.into_bytes(), INGESTED),
        ("bom.bvh", with_bom, INGESTED),
        ("tabs.bvh", good.replace("  ", "\t").into_bytes(), INGESTED),
        ("no_end_sites.bvh", without_end_sites.into_bytes(), INGESTED),
        ("commas.bvh", commas.into_bytes(), "E-BVH-NUMBER"),
        ("few.bvh", with(frames, "Frames: 100000"), "E-BVH-FRAMES"),
        ("many.bvh", with(frames, "Frames: 3"), "E-BVH-FRAMES"),
        ("time.bvh", with(time, "Frame Time: 0"), "E-BVH-FRAME-TIME"),
        ("no_motion.bvh", head, "E-BVH-SYNTAX"),
        ("empty.bvh", Vec::new(), "E-BVH-SYNTAX"),
        ("deep.bvh", deep.into_bytes(), "E-BVH-SYNTAX"),
    ]
}

/// Bytes of a block of a C3D file.
const C3D_BLOCK: usize = 512;

/// A whole C3D file of an Intel machine: one marker, three frames in floating point. One marker gives no body.
fn whole_c3d() -> Vec<u8> {
    let mut bytes = vec![0; 2 * C3D_BLOCK];
    bytes[..2].copy_from_slice(&[2, 0x50]);
    // Words of the header: number of points, first and last frame, first block of the data.
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

fn c3d_cases() -> Vec<Case> {
    let whole = whole_c3d();
    let cut = |len: usize| whole[..len].to_vec();
    let poked = |at: usize, bytes: &[u8]| poked(&whole, at, bytes);
    let number = |at: usize, number: u16| poked(at, &number.to_le_bytes());
    let data = 2 * C3D_BLOCK;
    // Sizes of the array of labels.
    let mut places = whole.windows(6);
    let labels = places.position(|window| window == b"\x04\x01LKNE");
    let labels = labels.expect("the labels");
    let foreign = [0x60u8, 0x00, 0x48, 0x7e].repeat(12);
    vec![
        ("whole.c3d", whole.clone(), "E-MARKERS"),
        ("empty.c3d", Vec::new(), "E-C3D-TRUNCATED"),
        ("half_a_header.c3d", cut(C3D_BLOCK / 2), "E-C3D-TRUNCATED"),
        ("last_cut.c3d", cut(whole.len() - 5), "E-C3D-TRUNCATED"),
        ("no_magic.c3d", poked(1, &[0]), "E-C3D-HEADER"),
        ("far_parameters.c3d", poked(0, &[99]), "E-C3D-HEADER"),
        ("processor.c3d", poked(C3D_BLOCK + 3, &[7]), "E-C3D-HEADER"),
        ("parameter.c3d", poked(labels, &[0xff; 2]), "E-C3D-PARAM"),
        ("points.c3d", number(2, 60_000), "E-C3D-HEADER"),
        ("frames.c3d", number(8, 60_000), "E-C3D-TRUNCATED"),
        ("frames_backwards.c3d", number(6, 9), "E-C3D-HEADER"),
        ("far_data.c3d", number(16, 9000), "E-C3D-TRUNCATED"),
        ("no_rate.c3d", poked(20, &[0; 4]), "E-C3D-HEADER"),
        ("other_machine.c3d", poked(data, &foreign), "E-C3D-ENDIAN"),
    ]
}

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

fn gltf_cases() -> Vec<Case> {
    let good = good_glb();
    let poked = |at: usize, bytes: &[u8]| poked(&good, at, bytes);
    let with = |pointer: &str, value: &Value| {
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
        let found = document.pointer(pointer).and_then(Value::as_u64);
        found.expect("an index")
    };
    let input = "/animations/0/samplers/0/input";
    let key_times = format!("/accessors/{}", read(input));
    let view = read(&format!("{key_times}/bufferView"));
    let (count, offset) = (
        format!("{key_times}/count"),
        format!("/bufferViews/{view}/byteOffset"),
    );
    let (length, children) = ("/buffers/0/byteLength", "/nodes/1/children");
    let (huge, large) = (json!(1u64 << 40), json!(100_000));
    let (ring, unknown) = (json!([0]), json!([100_000]));
    let with_uri = |uri: &str| {
        let set = |document: &mut Value| document["buffers"][0]["uri"] = json!(uri);
        rewritten(&good, set, |_| ())
    };
    let remote = with_uri("https://example.org/motion.bin");
    let spoil = |binary: &mut [u8]| {
        for value in binary.chunks_exact_mut(4) {
            value.copy_from_slice(&f32::NAN.to_le_bytes());
        }
    };
    vec![
        ("good.glb", good.clone(), INGESTED),
        ("rewritten.glb", rewritten(&good, |_| (), |_| ()), INGESTED),
        ("empty.glb", Vec::new(), "E-GLTF-SYNTAX"),
        ("header_alone.glb", good[..12].to_vec(), "E-GLTF-CHUNK"),
        ("half.glb", good[..good.len() / 2].to_vec(), "E-GLTF-CHUNK"),
        ("another_version.glb", poked(4, &[1]), "E-GLTF-CHUNK"),
        ("long_chunk.glb", poked(12, &[0xff; 4]), "E-GLTF-CHUNK"),
        ("no_json.glb", poked(GLB_JSON, b"]"), "E-GLTF-SYNTAX"),
        ("numbers.glb", with(&count, &huge), "E-GLTF-ACCESSOR"),
        ("view.glb", with(&offset, &huge), "E-GLTF-ACCESSOR"),
        ("buffer_too_long.glb", with(length, &huge), "E-GLTF-BUFFER"),
        ("accessor.glb", with(input, &large), "E-GLTF-ACCESSOR"),
        ("ring_of_nodes.glb", with(children, &ring), "E-GLTF-NODES"),
        ("node.glb", with(children, &unknown), "E-GLTF-NODES"),
        ("remote_buffer.glb", remote, "E-GLTF-URI"),
        ("buffer.glb", with_uri("../../secret.bin"), "E-GLTF-URI"),
        ("nan.glb", rewritten(&good, |_| (), spoil), "E-NOT-FINITE"),
    ]
}

fn other_cases(canary: &Path) -> Vec<Case> {
    let pointer = b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 7\n";
    vec![
        ("payload.pkl", canary_pickle(canary), "E-PICKLE-REFUSED"),
        ("payload.pickle", canary_pickle(canary), "E-PICKLE-REFUSED"),
        ("pointer.bvh", pointer.to_vec(), "E-LFS-POINTER"),
        ("pointer.npz", pointer.to_vec(), "E-LFS-POINTER"),
        ("notes.txt", b"no motion".to_vec(), SKIPPED),
        ("picture.png", b"\x89PNG\r\n\x1a\n".to_vec(), SKIPPED),
        ("table.parquet", b"PAR1 but not really".to_vec(), SKIPPED),
    ]
}

fn ingested(source: &Path, out: &Path) -> IngestReport {
    let options = IngestOptions::default();
    let report = ingest(&[source.to_owned()], out, &options, "the test", &NoProgress);
    report.expect("bad files do not end a run")
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
    let report = ingested(&source, &out);
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
            Some(row) => row.code.as_str(),
            None if motions.iter().any(|row| row.source_path == *name) => INGESTED,
            None => SKIPPED,
        };
        if found != *expected {
            let reason = row.map_or("", |row| row.reason.as_str());
            wrong.push(format!("{name}: {found}, not {expected}: {reason}"));
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

/// Circular and dangling links, and pipes, do not stop or trap a run.
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
    let mut mkfifo = std::process::Command::new("mkfifo");
    let made = mkfifo.arg(source.join("pipe.bvh")).status();
    assert!(made.expect("mkfifo runs").success());
    let report = ingested(&source, &dir.path().join("dataset"));
    let done = &report.accounting;
    let counts = (done.ingested, done.quarantined, done.skipped);
    assert_eq!(counts, (2, 1, 2), "{done:?} {:?}", report.skipped);
    assert_eq!(report.quarantine[0].path, "dangling.bvh");
    assert_eq!(report.quarantine[0].code, "E-IO");
}
