//! Broken and hostile files, each with the outcome it must have. Every fixture is made here.

use std::io::{Cursor, Write};
use std::path::{Path, PathBuf};

use corpus::{CorpusOptions, clip};
use datasets_spec::record::{MotionRow, QuarantineRow};
use datasets_spec::{Dataset, NoProgress, Skeleton};
use pipeline::ingest::{IngestOptions, ingest};
use pipeline::write;

/// What must become of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fate {
    /// A motion.
    Ingested,
    /// A row of the quarantine table with this code.
    Quarantined(&'static str),
    /// Passed over as no motion.
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

/// A pickle that would make a file if anything executed it.
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
        ("empty.c3d", Vec::new(), Quarantined("E-C3D-TRUNCATED")),
        ("empty.glb", Vec::new(), Quarantined("E-GLTF-SYNTAX")),
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
        let row = rejected.iter().find(|row| row.path == *name);
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
