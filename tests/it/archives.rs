//! Archives among the sources: read as folders of their names, limited, and quarantined with a reason where they are
//! damaged.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::{Cursor, Write};
use std::path::{Path, PathBuf};

use datasets_spec::Dataset;
use datasets_spec::record::{MotionRow, QuarantineRow, SkippedRow};
use serde_json::Value;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use crate::util::{
    Ran, arg, assert_counted, assert_has, command, corpus, files_with_extension, stance, typed,
};

/// Files by their names.
pub(crate) type Files = BTreeMap<String, Vec<u8>>;

/// The files below a folder.
pub(crate) fn files_below(folder: &Path) -> Files {
    let mut files = Files::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(current) = folders.pop() {
        for entry in fs::read_dir(&current).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let name = path.strip_prefix(folder).expect("below it");
            let name = name.to_str().expect("text").to_owned();
            files.insert(name, fs::read(&path).expect("read"));
        }
    }
    files
}

fn zipped(files: &Files) -> Vec<u8> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for (number, (name, bytes)) in files.iter().enumerate() {
        let method = match number % 2 {
            0 => CompressionMethod::Deflated,
            _ => CompressionMethod::Stored,
        };
        let options = SimpleFileOptions::default().compression_method(method);
        zip.start_file(name.as_str(), options).expect("in memory");
        zip.write_all(bytes).expect("in memory");
    }
    zip.finish().expect("in memory").into_inner()
}

/// A tar with unchecked names, including names that lead out of the archive.
fn tarred(files: &Files) -> Vec<u8> {
    let mut tar = tar::Builder::new(Vec::new());
    for (name, bytes) in files {
        let mut header = tar::Header::new_gnu();
        header.set_size(bytes.len() as u64);
        header.set_mode(0o644);
        match name.contains("..") || name.starts_with('/') {
            true => {
                header.as_mut_bytes()[..name.len()].copy_from_slice(name.as_bytes());
                header.set_cksum();
                tar.append(&header, &bytes[..]).expect("in memory");
            }
            false => tar
                .append_data(&mut header, name, &bytes[..])
                .expect("in memory"),
        }
    }
    tar.into_inner().expect("in memory")
}

fn gzipped(bytes: &[u8]) -> Vec<u8> {
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    gzip.write_all(bytes).expect("in memory");
    gzip.finish().expect("in memory")
}

fn bzipped(bytes: &[u8]) -> Vec<u8> {
    let mut bzip = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::fast());
    bzip.write_all(bytes).expect("in memory");
    bzip.finish().expect("in memory")
}

/// An xz stream of one block whose bytes are stored as they are.
///
/// # Source
/// The .xz file format 1.2.1, sections 2 to 4; LZMA2 chunks of control byte 1 hold plain bytes.
fn xzipped(bytes: &[u8]) -> Vec<u8> {
    const FLAGS: [u8; 2] = [0, 1];
    const LZMA2: u8 = 0x21;
    let crc = |bytes: &[u8]| crc32fast::hash(bytes).to_le_bytes();
    let number = |mut value: u64| {
        let mut coded = Vec::new();
        while value >= 0x80 {
            coded.push((value & 0x7f) as u8 | 0x80);
            value >>= 7;
        }
        coded.push(value as u8);
        coded
    };
    let padded = |mut bytes: Vec<u8>| {
        bytes.resize(bytes.len().next_multiple_of(4), 0);
        bytes
    };
    let sealed = |bytes: Vec<u8>| {
        let crc = crc(&bytes);
        [bytes, crc.to_vec()].concat()
    };
    let header = [b"\xfd7zXZ\0".to_vec(), FLAGS.to_vec(), crc(&FLAGS).to_vec()].concat();
    // Header size in units of four bytes, minus one; no flags; one filter with a dictionary of 64 KiB.
    let block_header = sealed(vec![2, 0, LZMA2, 1, 8, 0, 0, 0]);
    let mut packed = Vec::new();
    for chunk in bytes.chunks(1 << 16) {
        packed.push(1);
        packed.extend(((chunk.len() - 1) as u16).to_be_bytes());
        packed.extend(chunk);
    }
    packed.push(0);
    let unpadded = (block_header.len() + packed.len() + 4) as u64;
    let block = [block_header, padded(packed), crc(bytes).to_vec()].concat();
    let records = [
        vec![0],
        number(1),
        number(unpadded),
        number(bytes.len() as u64),
    ]
    .concat();
    let index = sealed(padded(records));
    let size = ((index.len() / 4 - 1) as u32).to_le_bytes();
    let backward = [size.to_vec(), FLAGS.to_vec()].concat();
    let footer = [crc(&backward).to_vec(), backward, b"YZ".to_vec()].concat();
    [header, block, index, footer].concat()
}

/// Packs files by the ending of a name.
pub(crate) fn packed(name: &str, files: &Files) -> Vec<u8> {
    let ending = name.split_once('.').expect("an ending").1;
    match ending {
        "zip" => zipped(files),
        "tar" => tarred(files),
        "tar.gz" | "tgz" => gzipped(&tarred(files)),
        "tar.bz2" | "tbz2" => bzipped(&tarred(files)),
        "tar.xz" | "txz" => xzipped(&tarred(files)),
        other => panic!("{other}"),
    }
}

/// A test folder with its own folder for temporary files.
struct Place {
    dir: tempfile::TempDir,
}

impl Place {
    fn new(dir: tempfile::TempDir) -> Self {
        fs::create_dir(dir.path().join("tmp")).expect("made");
        Self { dir }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn put(&self, name: &str, bytes: impl AsRef<[u8]>) {
        let path = self.path(name);
        fs::create_dir_all(path.parent().expect("a folder")).expect("made");
        fs::write(path, bytes).expect("written");
    }

    /// Runs the command, and checks that no unpacked file remains.
    fn run(&self, args: &[&str], code: i32) -> Ran {
        let ran: Ran = command(args)
            .env("TMPDIR", self.path("tmp"))
            .output()
            .expect("starts")
            .into();
        let left: Vec<_> = fs::read_dir(self.path("tmp")).expect("listed").collect();
        assert!(left.is_empty(), "{left:?}");
        ran.expect_code(code)
    }

    fn ingest(&self, source: &str, out: &str, code: i32) -> Value {
        let (source, out) = (self.path(source), self.path(out));
        let done: Value = self
            .run(
                &["--json", "ingest", arg(&source), "--out", arg(&out)],
                code,
            )
            .json();
        assert_counted(&done);
        done
    }

    fn rows<R: datasets_spec::table::Row>(&self, dataset: &str) -> Vec<R> {
        let dataset = Dataset::open(&self.path(dataset)).expect("a dataset");
        dataset.read(None).expect("rows")
    }

    /// Content of every clip, by its id without a prefix.
    fn clips(&self, dataset: &str, prefix: &str) -> BTreeMap<String, String> {
        let rows: Vec<MotionRow> = self.rows(dataset);
        let clips = rows.into_iter().map(|row| {
            let id = row.id.to_string();
            let id = id.strip_prefix(prefix).unwrap_or_else(|| panic!("{id}"));
            (id.to_owned(), row.content_hash)
        });
        clips.collect()
    }

    fn quarantine(&self, dataset: &str) -> BTreeMap<String, QuarantineRow> {
        let rows: Vec<QuarantineRow> = self.rows(dataset);
        rows.into_iter()
            .map(|row| (row.path.clone(), row))
            .collect()
    }
}

const KINDS: [&str; 8] = [
    "all.zip",
    "all.tar",
    "all.tar.gz",
    "all.tgz",
    "all.tar.bz2",
    "all.tbz2",
    "all.tar.xz",
    "all.txz",
];

#[test]
fn every_kind_of_archive_is_a_folder_of_its_name() {
    let place = Place::new(corpus(6));
    let files = files_below(&place.path("corpus"));
    let plain = place.ingest("corpus", "plain", 0);
    let expected = place.clips("plain", "");
    for name in KINDS {
        let (source, out) = (format!("in-{name}"), format!("out-{name}"));
        place.put(&format!("{source}/{name}"), packed(name, &files));
        let before = files_below(&place.path(&source));
        let done = place.ingest(&source, &out, 0);
        for count in ["sources", "ingested", "skipped", "quarantined"] {
            assert_eq!(done[count], plain[count], "{name} {count}");
        }
        assert_eq!(place.clips(&out, &format!("{name}/")), expected, "{name}");
        let rows: Vec<MotionRow> = place.rows(&out);
        for row in rows {
            assert!(
                row.source_path.starts_with(&format!("{name}/")),
                "{}",
                row.source_path
            );
            assert!(
                !row.captions.is_empty(),
                "labels in the archive are read: {}",
                row.id
            );
        }
        // A second run changes nothing, and the user's folder is unchanged too.
        let again = place.ingest(&source, &out, 0);
        assert_eq!(again["already_complete"], true, "{name} {again}");
        assert_eq!(again["root_hash"], done["root_hash"], "{name}");
        assert_eq!(files_below(&place.path(&source)), before, "{name}");
        // An archive is a source too.
        let alone = format!("alone-{name}");
        place.ingest(&format!("{source}/{name}"), &alone, 0);
        assert_eq!(place.clips(&alone, &format!("{name}/")), expected, "{name}");
        let archive = place.path(&format!("{source}/{name}"));
        let doctor = place.run(&["doctor", arg(&archive)], 0);
        doctor.expect_printed("amass");
    }
}

#[test]
fn releases_are_found_in_archives_by_their_layout() {
    let place = Place::new(corpus(8));
    place.ingest("corpus", "dataset", 0);
    for layout in ["humanml3d", "stance", "webdataset", "humanml3d-272"] {
        let (dataset, out) = (place.path("dataset"), place.path(layout));
        stance(&["export", arg(&dataset), "--to", layout, "--out", arg(&out)]).expect_code(0);
        let files = files_below(&out);
        let below: Files = files
            .iter()
            .map(|(name, bytes)| (format!("Release/{name}"), bytes.clone()))
            .collect();
        place.ingest(layout, &format!("{layout}-plain"), 0);
        let expected = place.clips(&format!("{layout}-plain"), "");
        assert!(!expected.is_empty(), "{layout}");
        for name in ["release.zip", "release.tar.bz2"] {
            let (source, again) = (
                format!("{layout}-{name}"),
                format!("{layout}-{name}-dataset"),
            );
            place.put(&format!("{source}/{name}"), packed(name, &below));
            place.ingest(&source, &again, 0);
            assert_eq!(place.clips(&again, ""), expected, "{layout} {name}");
        }
    }
    // The repository of HumanML3D has its captions as an archive beside the motions.
    let files = files_below(&place.path("humanml3d"));
    let (texts, others): (Files, Files) = files
        .into_iter()
        .partition(|(name, _)| name.starts_with("texts/"));
    for (name, bytes) in others {
        place.put(&format!("repository/{name}"), bytes);
    }
    place.put("repository/texts.zip", zipped(&texts));
    place.ingest("repository", "repository-dataset", 0);
    let captions = |dataset: &str| -> BTreeMap<String, usize> {
        let rows: Vec<MotionRow> = place.rows(dataset);
        rows.into_iter()
            .map(|row| (row.id.to_string(), row.captions.len()))
            .collect()
    };
    let (plain, archived) = (captions("humanml3d-plain"), captions("repository-dataset"));
    assert!(plain.values().any(|count| *count > 0), "{plain:?}");
    assert_eq!(archived, plain);
    // A dataset in an archive is read as a dataset.
    let dataset = files_below(&place.path("dataset"));
    place.put("packed/dataset.zip", zipped(&dataset));
    place.ingest("packed", "of-dataset", 0);
    assert_eq!(place.clips("of-dataset", ""), place.clips("dataset", ""));
}

#[test]
fn shards_and_dumps_that_are_named_like_archives_are_read_as_what_they_are() {
    let place = Place::new(corpus(4));
    place.ingest("corpus", "dataset", 0);
    let (dataset, out) = (place.path("dataset"), place.path("shards"));
    typed("export {} --to webdataset --out {}", &[&dataset, &out]).expect_code(0);
    place.ingest("shards", "again", 0);
    let rows: Vec<MotionRow> = place.rows("again");
    assert!(rows.iter().all(|row| row.source == "webdataset"));
    // Neither a known release nor a tar: the file is skipped, as before.
    place.put("weights/weights.pth.tar", b"\x80\x04.");
    place.put(
        "weights/walk.npz",
        files_with_extension(&place.path("corpus"), "npz")
            .iter()
            .map(|path| fs::read(path).expect("read"))
            .next()
            .expect("one"),
    );
    place.ingest("weights", "weights-dataset", 0);
    let skipped: Vec<SkippedRow> = place.rows("weights-dataset");
    assert!(
        skipped.iter().any(|row| row.path == "weights.pth.tar"),
        "{skipped:?}"
    );
}

/// One walk of the corpus as a file of an archive.
fn walk(place: &Place) -> Vec<u8> {
    let files = files_with_extension(&place.path("corpus"), "npz");
    fs::read(&files[0]).expect("read")
}

/// Byte offset of the header of member `b_poses.npz` in a zip: 30 bytes before its name. Members are zips themselves,
/// so the signature of a header is ambiguous.
fn header_of_b(zip: &[u8]) -> usize {
    let name = b"b_poses.npz";
    let mut places = zip.windows(name.len());
    places.position(|bytes| bytes == name).expect("a member") - 30
}

/// Puts archives into the folder `in` that are damaged, encrypted, too large or too deep, or lead out of it.
fn put_hostile(place: &Place) {
    let walk = walk(place);
    let named = |names: &[&str]| -> Files {
        let files = names.iter().map(|name| ((*name).to_owned(), walk.clone()));
        files.collect()
    };
    let good = named(&["good_poses.npz"]);
    place.put("in/good.zip", zipped(&good));
    // Names that lead out of the archive.
    place.put(
        "in/climbs.tar",
        tarred(&named(&[
            "../up_poses.npz",
            "/abs_poses.npz",
            "in_poses.npz",
        ])),
    );
    place.put(
        "in/climbs.zip",
        zipped(&named(&["a/../../up_poses.npz", "in_poses.npz"])),
    );
    // Symbolic and hard links in a tar.
    let mut links = tar::Builder::new(Vec::new());
    for (kind, name) in [
        (tar::EntryType::Symlink, "link_poses.npz"),
        (tar::EntryType::Char, "device"),
    ] {
        let mut header = tar::Header::new_gnu();
        header.set_entry_type(kind);
        header.set_size(0);
        links
            .append_link(&mut header, name, "/etc/passwd")
            .expect("in memory");
    }
    place.put("in/links.tar", links.into_inner().expect("in memory"));
    // Cut short and altered.
    let whole = zipped(&named(&["a_poses.npz", "b_poses.npz"]));
    place.put("in/cut.zip", &whole[..whole.len() / 2]);
    let mut altered = whole.clone();
    altered[300] ^= 0x55;
    place.put("in/altered.zip", altered);
    let mut altered = whole.clone();
    altered[header_of_b(&whole) + 100] ^= 0x55;
    place.put("in/second.zip", altered);
    let tar = tarred(&named(&["a_poses.npz", "b_poses.npz"]));
    place.put("in/cut.tar", &tar[..tar.len() * 2 / 3]);
    let gz = gzipped(&tar);
    place.put("in/cut.tar.gz", &gz[..gz.len() * 2 / 3]);
    let bz2 = bzipped(&tar);
    place.put("in/cut.tar.bz2", &bz2[..bz2.len() - 20]);
    place.put("in/no.tar.xz", "not an archive");
    place.put("in/empty.zip", "");
    // Encrypted: the flag in both headers.
    let mut encrypted = zipped(&good);
    for (magic, at) in [(&b"PK\x03\x04"[..], 6), (b"PK\x01\x02", 8)] {
        let start = encrypted
            .windows(4)
            .position(|bytes| bytes == magic)
            .expect("a header");
        encrypted[start + at] |= 1;
    }
    place.put("in/secret.zip", encrypted);
    // Bombs: small archives whose content exceeds the limits.
    let zeros: Files = [("zeros.bin".to_owned(), vec![0; 80 << 20])].into();
    let bomb = zipped(&zeros);
    assert!(bomb.len() < 1 << 20);
    place.put("in/bomb.zip", bomb);
    place.put("in/bomb.tar.bz2", bzipped(&tarred(&zeros)));
    // An archive in an archive is read, one more level is not.
    let inner: Files = [("inner.zip".to_owned(), zipped(&good))].into();
    place.put("in/outer.tar.gz", packed("outer.tar.gz", &inner));
    let outer: Files = [("outer.zip".to_owned(), zipped(&inner))].into();
    place.put("in/outmost.zip", zipped(&outer));
}

#[test]
fn hostile_archives_are_quarantined_and_the_rest_goes_on() {
    let place = Place::new(corpus(2));
    put_hostile(&place);
    let done = place.ingest("in", "out", 3);
    let ids: BTreeSet<String> = place.clips("out", "").into_keys().collect();
    let expected = [
        "altered.zip/b",
        "climbs.tar/in",
        "climbs.zip/in",
        "cut.tar.bz2/a",
        "cut.tar.gz/a",
        "cut.tar/a",
        "good.zip/good",
        "outer.tar.gz/inner.zip/good",
        "second.zip/a",
    ];
    let expected: BTreeSet<String> = expected.iter().map(|id| format!("{id}_poses")).collect();
    assert_eq!(ids, expected, "{done}");
    let quarantine = place.quarantine("out");
    let codes: BTreeMap<&str, &str> = quarantine
        .iter()
        .map(|(path, row)| (path.as_str(), row.code.as_str()))
        .collect();
    let expected = BTreeMap::from([
        ("climbs.tar/../up_poses.npz", "E-ARCHIVE-NAME"),
        ("climbs.tar//abs_poses.npz", "E-ARCHIVE-NAME"),
        ("climbs.zip/a/../../up_poses.npz", "E-ARCHIVE-NAME"),
        ("cut.zip", "E-ARCHIVE-DAMAGED"),
        ("altered.zip/a_poses.npz", "E-ARCHIVE-DAMAGED"),
        ("second.zip/b_poses.npz", "E-ARCHIVE-DAMAGED"),
        ("cut.tar/b_poses.npz", "E-ARCHIVE-DAMAGED"),
        ("cut.tar.gz", "E-ARCHIVE-DAMAGED"),
        ("cut.tar.bz2", "E-ARCHIVE-DAMAGED"),
        ("no.tar.xz", "E-ARCHIVE-DAMAGED"),
        ("empty.zip", "E-ARCHIVE-DAMAGED"),
        ("secret.zip/good_poses.npz", "E-ARCHIVE-PACKING"),
        ("bomb.zip", "E-ARCHIVE-LIMIT"),
        ("bomb.tar.bz2", "E-ARCHIVE-LIMIT"),
        ("outmost.zip/outer.zip/inner.zip", "E-ARCHIVE-LIMIT"),
    ]);
    assert_eq!(codes, expected);
    for (path, row) in &quarantine {
        let is_placeless = path.contains("inner.zip");
        assert!(
            row.byte_offset.is_some() || is_placeless,
            "{path}: {}",
            row.reason
        );
        // The content of a damaged member is unknown.
        let is_damaged_member = path.starts_with("altered.zip") || path.starts_with("second.zip");
        let is_hashed = !row.source_hash.is_empty();
        assert!(is_hashed || is_damaged_member || is_placeless, "{path}");
    }
    let second = fs::read(place.path("in/second.zip")).expect("read");
    assert_eq!(
        quarantine["second.zip/b_poses.npz"].byte_offset,
        Some(header_of_b(&second) as u64)
    );
    let skipped: Vec<SkippedRow> = place.rows("out");
    let skipped: BTreeSet<&str> = skipped.iter().map(|row| row.path.as_str()).collect();
    assert_eq!(
        skipped,
        BTreeSet::from(["links.tar/device", "links.tar/link_poses.npz"])
    );
    let again = place.ingest("in", "out", 3);
    assert_eq!(again["already_complete"], true, "{again}");
    // `doctor` reports them before any work.
    let doctor = place.run(&["doctor", arg(&place.path("in"))], 0);
    assert_has(
        &doctor.stdout,
        &["cut.zip", "bomb.tar.bz2", "secret.zip/good_poses.npz"],
    );
}

#[test]
fn clips_of_an_archive_that_is_damaged_later_stay() {
    let place = Place::new(corpus(2));
    let files: Files = [("walk_poses.npz".to_owned(), walk(&place))].into();
    let whole = zipped(&files);
    place.put("in/walks.zip", &whole);
    place.put("in/other_poses.npz", walk(&place));
    place.ingest("in", "out", 0);
    let before = place.clips("out", "");
    place.put("in/walks.zip", &whole[..whole.len() - 30]);
    place.ingest("in", "out", 3);
    assert_eq!(place.clips("out", ""), before);
}

#[test]
fn what_a_killed_run_unpacked_is_removed_by_the_next_one() {
    let place = Place::new(corpus(2));
    let files: Files = [("walk_poses.npz".to_owned(), walk(&place))].into();
    place.put("in/walks.tar.gz", packed("walks.tar.gz", &files));
    place.put("tmp/stance-unpacked-dead/LOCK", "");
    place.put("tmp/stance-unpacked-dead/0", "unpacked");
    // `ingest` checks that nothing is left.
    place.ingest("in", "out", 0);
    // Without disk space the error names the folder for unpacking.
    fs::remove_dir(place.path("tmp")).expect("removed");
    let (source, out) = (place.path("in"), place.path("other"));
    let ran: Ran = command(&["ingest", arg(&source), "--out", arg(&out)])
        .env("TMPDIR", place.path("tmp"))
        .output()
        .expect("starts")
        .into();
    ran.expect_refused("set TMPDIR");
}

#[test]
fn many_processes_read_archives_as_one_does() {
    let place = Place::new(corpus(12));
    let files = files_below(&place.path("corpus"));
    let (even, odd): (Vec<_>, Vec<_>) =
        files.into_iter().enumerate().partition(|(n, _)| n % 2 == 0);
    let files = |half: Vec<(usize, (String, Vec<u8>))>| -> Files {
        half.into_iter().map(|(_, file)| file).collect()
    };
    place.put("in/even.zip", zipped(&files(even)));
    place.put("in/odd.tar", tarred(&files(odd)));
    let one = place.ingest("in", "one", 0);
    let (source, into, plan) = (place.path("in"), place.path("many"), place.path("plan"));
    let planned = [
        "stage",
        "plan",
        "ingest",
        arg(&source),
        "--into",
        arg(&into),
        "--out",
        arg(&plan),
    ];
    place.run(&planned, 0);
    place.run(&["stage", "work", arg(&plan)], 0);
    let done: Value = place
        .run(&["--json", "stage", "commit", arg(&plan)], 0)
        .json();
    assert_eq!(done["root_hash"], one["root_hash"]);
    // A plan for many processes would make each process unpack this archive, so it is refused.
    place.put(
        "in/walks.tar.gz",
        packed(
            "walks.tar.gz",
            &[("walk_poses.npz".to_owned(), walk(&place))].into(),
        ),
    );
    let (into, plan) = (place.path("more"), place.path("another"));
    let planned = [
        "stage",
        "plan",
        "ingest",
        arg(&source),
        "--into",
        arg(&into),
        "--out",
        arg(&plan),
    ];
    let ran = place.run(&planned, 1);
    ran.expect_said("walks.tar.gz");
    ran.expect_said("pack it as zip");
}

#[test]
fn unpacking_shows_how_far_it_is() {
    let place = Place::new(corpus(2));
    // The archive is larger than a megabyte even when compressed.
    let mut state = 1u32;
    let mut draw = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    };
    let noise: Vec<u8> = (0..1_500_000).map(|_| draw()).collect();
    let mut files = Files::from([("walk_poses.npz".to_owned(), walk(&place))]);
    files.insert("noise.bin".to_owned(), noise);
    for name in ["all.tar.bz2", "all.zip"] {
        let source = format!("{name}-in");
        place.put(&format!("{source}/{name}"), packed(name, &files));
        let (source, out) = (place.path(&source), place.path(&format!("{name}-out")));
        let ran = place.run(&["ingest", arg(&source), "--out", arg(&out)], 0);
        let said = ran.stderr.contains("1 archives of 1 MB");
        // Members of a zip are read in place.
        assert_eq!(said, name == "all.tar.bz2", "{}", ran.stderr);
    }
}
