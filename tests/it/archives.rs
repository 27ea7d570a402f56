//! Archives among the sources are read as folders of their names, within limits, and quarantined with a reason if they
//! are damaged.

mod hostile;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::{Cursor, Write};
use std::ops::Deref;
use std::path::{Path, PathBuf};

use datasets_spec::MotionId;
use datasets_spec::record::{MotionRow, QuarantineRow};
use serde_json::Value;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use crate::grown::{judge, masks};
use crate::published::POINTER;
use crate::util::{
    Folder, Ran, arg, assert_counted, assert_has, assert_quarantined, assert_tells, everything,
    files_with_extension, json_of, len_of, name_of, put, skipped_of, unpack,
};

/// Files by their names.
pub(crate) type Files = BTreeMap<String, Vec<u8>>;

/// The files below a folder.
pub(crate) fn files_below(folder: &Path) -> Files {
    let found = everything(folder).into_iter();
    let files = found.filter(|(path, _)| path.is_file());
    let name_of = |path: PathBuf| arg(path.strip_prefix(folder).expect("below it")).to_owned();
    files.map(|(path, bytes)| (name_of(path), bytes)).collect()
}

/// A zip of members with their names, in this order.
pub(crate) fn zipped<'a>(files: impl IntoIterator<Item = (&'a String, &'a Vec<u8>)>) -> Vec<u8> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for (number, (name, bytes)) in files.into_iter().enumerate() {
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
    let lengths = [number(unpadded), number(bytes.len() as u64)].concat();
    let records = [vec![0], number(1), lengths].concat();
    let index = sealed(padded(records));
    let size = ((index.len() / 4 - 1) as u32).to_le_bytes();
    let backward = [size.to_vec(), FLAGS.to_vec()].concat();
    let footer = [crc(&backward).to_vec(), backward, b"YZ".to_vec()].concat();
    [header, block, index, footer].concat()
}

/// Packs files into an archive of the kind that the ending of its name states.
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

/// A folder with a small built-in corpus, and with its own folder for temporary files.
struct Place(Folder);

impl Deref for Place {
    type Target = Folder;

    fn deref(&self) -> &Folder {
        &self.0
    }
}

impl Place {
    fn of_clips(clips: usize) -> Self {
        let folder = Folder::of_clips(clips);
        fs::create_dir(folder.path("tmp")).expect("made");
        Self(folder)
    }

    /// A place with a dataset of the corpus, and the dataset as a WebDataset in the folder `shards`.
    fn of_shards() -> Self {
        let place = Self::of_clips(12);
        place.ingest("corpus", "dataset", 0);
        place.run("export @dataset --to webdataset --out @shards");
        place
    }

    /// Runs a command line with the folder for temporary files.
    fn ran(&self, line: &str) -> Ran {
        let mut command = self.command(line);
        let output = command.env("TMPDIR", self.path("tmp")).output();
        output.expect("starts").into()
    }

    /// Runs a command line that exits with this code, and checks that no unpacked file remains.
    fn clean(&self, line: &str, code: i32) -> Ran {
        let ran = self.ran(line);
        let left: Vec<_> = fs::read_dir(self.path("tmp")).expect("listed").collect();
        assert!(left.is_empty(), "{left:?}");
        ran.expect_code(code)
    }

    fn ingest(&self, source: &str, out: &str, code: i32) -> Value {
        let line = format!("--json ingest @{source} --out @{out}");
        let done = self.clean(&line, code).json();
        assert_counted(&done);
        done
    }

    fn motions(&self, dataset: &str) -> Vec<MotionRow> {
        self.rows(dataset)
    }

    /// Content hash of every clip, by its id without the prefix.
    fn clips(&self, dataset: &str, prefix: &str) -> BTreeMap<String, String> {
        let clips = self.motions(dataset).into_iter().map(|row| {
            let id = row.id.as_str().strip_prefix(prefix);
            let id = id.unwrap_or_else(|| panic!("{}", row.id));
            (id.to_owned(), row.content_hash)
        });
        clips.collect()
    }

    /// A walk of the corpus.
    fn walk(&self) -> Vec<u8> {
        let files = files_with_extension(&self.path("corpus"), "npz");
        fs::read(&files[0]).expect("read")
    }

    /// The walk under these names.
    fn walks(&self, names: &[&str]) -> Files {
        let files = names.iter().map(|name| ((*name).to_owned(), self.walk()));
        files.collect()
    }
}

#[test]
fn every_kind_of_archive_is_a_folder_of_its_name() {
    let place = Place::of_clips(6);
    let files = files_below(&place.path("corpus"));
    let plain = place.ingest("corpus", "plain", 0);
    let expected = place.clips("plain", "");
    for ending in "zip tar tar.gz tgz tar.bz2 tbz2 tar.xz txz".split(' ') {
        let name = format!("all.{ending}");
        let (source, out) = (format!("in-{name}"), format!("out-{name}"));
        let (archive, prefix) = (format!("{source}/{name}"), format!("{name}/"));
        place.put(&archive, packed(&name, &files));
        let before = files_below(&place.path(&source));
        let done = place.ingest(&source, &out, 0);
        for count in ["sources", "ingested", "skipped", "quarantined"] {
            assert_eq!(done[count], plain[count], "{name} {count}");
        }
        assert_eq!(place.clips(&out, &prefix), expected, "{name}");
        for row in place.motions(&out) {
            assert!(row.source_path.starts_with(&prefix), "{}", row.source_path);
            // Labels in the archive are read.
            assert!(!row.captions.is_empty(), "{}", row.id);
        }
        // A second run changes nothing, and neither run changes the user's folder.
        let again = place.ingest(&source, &out, 0);
        assert_eq!(again["already_complete"], true, "{name} {again}");
        assert_eq!(again["root_hash"], done["root_hash"], "{name}");
        assert_eq!(files_below(&place.path(&source)), before, "{name}");
        // An archive is a source too.
        let alone = format!("alone-{name}");
        place.ingest(&archive, &alone, 0);
        assert_eq!(place.clips(&alone, &prefix), expected, "{name}");
        let doctor = place.clean(&format!("doctor @{archive}"), 0);
        doctor.expect_printed("amass");
    }
}

#[test]
fn releases_are_found_in_archives_by_their_layout() {
    let place = Place::of_clips(8);
    place.ingest("corpus", "dataset", 0);
    for layout in ["humanml3d", "stance", "webdataset", "humanml3d-272"] {
        place.run(&format!("export @dataset --to {layout} --out @{layout}"));
        let files = files_below(&place.path(layout)).into_iter();
        let below = files.map(|(name, bytes)| (format!("Release/{name}"), bytes));
        let below: Files = below.collect();
        let plain = format!("{layout}-plain");
        place.ingest(layout, &plain, 0);
        let expected = place.clips(&plain, "");
        assert!(!expected.is_empty(), "{layout}");
        for name in ["release.zip", "release.tar.bz2"] {
            let source = format!("{layout}-{name}");
            let again = format!("{source}-dataset");
            place.put(&format!("{source}/{name}"), packed(name, &below));
            place.ingest(&source, &again, 0);
            assert_eq!(place.clips(&again, ""), expected, "{layout} {name}");
        }
    }
    // The repository of HumanML3D has its captions as an archive beside the motions.
    let files = files_below(&place.path("humanml3d"));
    let is_text = |(name, _): &(String, Vec<u8>)| name.starts_with("texts/");
    let (texts, others): (Files, Files) = files.into_iter().partition(is_text);
    for (name, bytes) in others {
        place.put(&format!("repository/{name}"), bytes);
    }
    place.put("repository/texts.zip", zipped(&texts));
    place.ingest("repository", "repository-dataset", 0);
    let captions = |dataset: &str| -> BTreeMap<String, usize> {
        let rows = place.motions(dataset).into_iter();
        rows.map(|row| (row.id.to_string(), row.captions.len()))
            .collect()
    };
    let plain = captions("humanml3d-plain");
    assert!(plain.values().any(|count| *count > 0), "{plain:?}");
    assert_eq!(captions("repository-dataset"), plain);
    // While the archive is damaged, the clips keep their captions.
    let whole = zipped(&texts);
    place.put("repository/texts.zip", &whole[..whole.len() / 2]);
    for is_first in [true, false] {
        let done = place.ingest("repository", "repository-dataset", 3);
        assert_eq!(done["already_complete"], !is_first, "{done}");
        for said in ["stay as they were", "texts.zip"] {
            assert_tells(&done["remarks"], said);
        }
        assert_eq!(captions("repository-dataset"), plain);
    }
    place.put("repository/texts.zip", &whole);
    place.ingest("repository", "repository-dataset", 0);
    assert_eq!(captions("repository-dataset"), plain);
    // A dataset in an archive is read as a dataset.
    let dataset = files_below(&place.path("dataset"));
    place.put("packed/dataset.zip", zipped(&dataset));
    place.ingest("packed", "of-dataset", 0);
    assert_eq!(place.clips("of-dataset", ""), place.clips("dataset", ""));
}

#[test]
fn clips_of_a_cut_shard_are_named_and_stay() {
    let place = Place::of_shards();
    let out = place.path("shards");
    place.ingest("shards", "again", 0);
    let before = place.clips("again", "");
    assert_eq!(before, place.clips("dataset", ""));
    let rows = place.motions("again");
    assert!(rows.iter().all(|row| row.source == "webdataset"));

    // The shard ends before its last member, the metadata of a clip.
    let shard = files_with_extension(&out, "tar").remove(0);
    let whole = fs::read(&shard).expect("read");
    let mut archive = tar::Archive::new(&whole[..]);
    let entries = archive.entries().expect("a tar");
    let last = entries.last().expect("a last one").expect("a member");
    let end = last.raw_header_position();
    let key = String::from_utf8_lossy(&last.path_bytes()).replace(".json", "");
    fs::write(&shard, &whole[..end as usize]).expect("written");
    let name = arg(shard.strip_prefix(&out).expect("below it")).to_owned();
    place.clean("ingest @shards --prune --out @again", 3);
    assert_eq!(place.clips("again", ""), before);
    place.ingest("shards", "new", 3);
    assert_eq!(place.clips("new", "").len(), before.len() - 1);
    for dataset in ["again", "new"] {
        let clip = format!("{name}/{key}.body_pose.npy");
        let expected = [
            (&*name, "E-ARCHIVE-DAMAGED"),
            (&*clip, "E-WEBDATASET-MEMBER"),
        ];
        let quarantine = assert_quarantined(&place.path(dataset), &expected);
        assert_eq!(quarantine[&name].byte_offset, Some(end));
        assert_has(&quarantine[&clip].reason, &["json is missing"]);
    }
}

#[test]
fn masks_follow_the_arrays_of_a_clip_and_not_its_labels() {
    let place = Place::of_shards();
    let (clips, made) = (place.path("clips"), place.path("made"));
    for shard in files_with_extension(&place.path("shards"), "tar") {
        unpack(&shard, &clips);
    }
    place.ingest("clips", "made", 0);
    let before = judge(&made);

    let (_, masked) = before.first_key_value().expect("a mask");
    let mut rows = place.motions("made").into_iter();
    let masked = rows.find(|row| row.id == masked.motion_id);
    let facts = clips.join(masked.expect("its clip").source_path);
    let mut document: Value = json_of(&facts);
    document["license"] = "CC-BY-4.0".into();
    put(&facts, document.to_string());
    let done = place.ingest("clips", "made", 0);
    assert_eq!(len_of(&done["growth"]["read_again"]), 1, "{done}");
    assert_eq!(masks(&made), before);

    let array = facts.with_extension("body_pose.npy");
    let mut bytes = fs::read(&array).expect("read");
    // The lowest bits of the last number.
    let place_of_bits = bytes.len() - 4;
    bytes[place_of_bits] ^= 1;
    put(&array, bytes);
    place.refused("ingest @clips --out @made", "--drop-labels");
    assert_eq!(masks(&made), before);
}

#[test]
fn labels_beside_a_release_are_noticed_when_they_change() {
    let place = Place::of_clips(12);
    place.ingest("corpus", "dataset", 0);
    for layout in ["humanml3d", "stance", "webdataset", "humanml3d-272"] {
        place.run(&format!("export @dataset --to {layout} --out @{layout}"));
        let grown = format!("{layout}-grown");
        place.ingest(layout, &grown, 0);
        let said = "it does so once more";
        let id = place.motions(&grown)[0].id.clone();
        let captions = format!("{layout}/captions.csv");
        place.put(&captions, format!("clip,text\n{id},{said}\n"));
        place.ingest(layout, &grown, 0);
        let texts = |dataset: &str| -> BTreeMap<MotionId, Vec<String>> {
            let rows = place.motions(dataset).into_iter();
            rows.map(|row| {
                let texts = row.captions.into_iter().map(|caption| caption.text);
                (row.id, texts.collect())
            })
            .collect()
        };
        let has_it = |texts: &&Vec<String>| texts.iter().any(|text| text == said);
        assert_eq!(texts(&grown).values().filter(has_it).count(), 1, "{layout}");
        let fresh = format!("{layout}-fresh");
        place.ingest(layout, &fresh, 0);
        assert_eq!(texts(&grown), texts(&fresh), "{layout}");
    }
}

#[test]
fn dumps_that_are_named_like_archives_are_skipped() {
    let place = Place::of_clips(4);
    place.put("weights/weights.pth.tar", b"\x80\x04.");
    place.put("weights/walk.npz", place.walk());
    place.ingest("weights", "weights-dataset", 0);
    let skipped = skipped_of(&place.path("weights-dataset"));
    assert!(skipped.contains_key("weights.pth.tar"), "{skipped:?}");
}

#[test]
fn a_tar_without_an_end_mark_is_reported_and_its_members_are_read() {
    let place = Place::of_clips(4);
    let whole = tarred(&place.walks(&["a_poses.npz", "b_poses.npz"]));
    // The mark is two blocks of zeros. One of them tells that no member is missing.
    let [cut, lone] = [1024, 512].map(|left_out| &whole[..whole.len() - left_out]);
    place.put("in/whole.tar", &whole);
    place.put("in/lone.tar", lone);
    place.put("in/cut.tar", cut);
    place.put("in/cut.tar.gz", gzipped(cut));
    // An archive without members is not cut.
    place.put("in/empty.tar", b"");
    let done = place.ingest("in", "out", 3);
    assert_eq!(place.clips("out", "").len(), 4 * 2, "{done}");
    let expected = ["cut.tar", "cut.tar.gz"].map(|name| (name, "E-ARCHIVE-DAMAGED"));
    let quarantine = assert_quarantined(&place.path("out"), &expected);
    for row in quarantine.values() {
        assert_has(&row.reason, &["end-of-archive mark", "it may be cut"]);
    }
    assert_eq!(quarantine["cut.tar"].byte_offset, Some(cut.len() as u64));
    assert!(quarantine["cut.tar.gz"].byte_offset > Some(0));
}

#[test]
fn clips_of_a_damaged_archive_stay_and_what_a_killed_run_unpacked_is_removed() {
    let place = Place::of_clips(2);
    let files = place.walks(&["walk_poses.npz"]);
    let whole = zipped(&files);
    place.put("in/walks.zip", &whole);
    place.put("in/other_poses.npz", place.walk());
    place.ingest("in", "out", 0);
    let before = place.clips("out", "");
    place.put("in/walks.zip", &whole[..whole.len() - 30]);
    place.ingest("in", "out", 3);
    assert_eq!(place.clips("out", ""), before);
    // Neither labels nor clips behind the place of the damage are lost, even if clips may be pruned.
    let mut labelled = place.walks(&["a_poses.npz", "b_poses.npz"]);
    labelled.insert("stance.toml".to_owned(), b"style = \"old\"\n".to_vec());
    for name in ["walks.tar", "walks.tar.gz"] {
        let (source, out) = (format!("in-{name}"), format!("out-{name}"));
        let (archive, whole) = (format!("{source}/{name}"), packed(name, &labelled));
        place.put(&archive, &whole);
        place.ingest(&source, &out, 0);
        let styles = || -> BTreeMap<String, Option<String>> {
            let rows = place.motions(&out).into_iter();
            rows.map(|row| (row.id.to_string(), row.style)).collect()
        };
        let before = styles();
        assert_eq!(before.len(), 2);
        assert!(before.values().all(|style| style.as_deref() == Some("old")));
        place.put(&archive, &whole[..whole.len() * 2 / 3]);
        place.clean(&format!("ingest @{source} --prune --out @{out}"), 3);
        assert_eq!(styles(), before, "{name}");
    }
    // `ingest` checks that nothing is left in the folder for temporary files.
    place.put("packed/walks.tar.gz", packed("walks.tar.gz", &files));
    place.put("tmp/stance-unpacked-dead/LOCK", "");
    place.put("tmp/stance-unpacked-dead/0", "unpacked");
    place.ingest("packed", "unpacked", 0);
    // Without disk space the error names the folder for unpacking.
    fs::remove_dir(place.path("tmp")).expect("removed");
    let ran = place.ran("ingest @packed --out @other");
    ran.expect_refused("set TMPDIR");
}

#[test]
fn many_processes_read_archives_as_one_does() {
    let place = Place::of_clips(12);
    let files = files_below(&place.path("corpus"));
    let (mut even, mut odd) = (Files::new(), Files::new());
    for (number, (name, bytes)) in files.into_iter().enumerate() {
        let half = if number % 2 == 0 { &mut even } else { &mut odd };
        half.insert(name, bytes);
    }
    place.put("in/even.zip", zipped(&even));
    place.put("in/odd.tar", tarred(&odd));
    let one = place.ingest("in", "one", 0);
    let planned = |into: &str, code: i32| {
        let line = format!("stage plan ingest @in --into @{into} --out @{into}-plan");
        place.clean(&line, code)
    };
    planned("many", 0);
    place.clean("stage work @many-plan", 0);
    let done: Value = place.clean("--json stage commit @many-plan", 0).json();
    assert_eq!(done["root_hash"], one["root_hash"]);
    // A plan for many processes would make each process unpack this archive, so it is refused.
    let walks = packed("walks.tar.gz", &place.walks(&["walk_poses.npz"]));
    place.put("in/walks.tar.gz", walks);
    let ran = planned("more", 1);
    ran.expect_said("walks.tar.gz");
    ran.expect_said("pack it as zip");
}

#[test]
fn unpacking_shows_how_far_it_is() {
    let place = Place::of_clips(2);
    // Noise, so that the archive is larger than a megabyte even when compressed.
    let mut state = 1u32;
    let mut draw = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    };
    let noise: Vec<u8> = (0..1_500_000).map(|_| draw()).collect();
    let mut files = place.walks(&["walk_poses.npz"]);
    files.insert("noise.bin".to_owned(), noise);
    for name in ["all.tar.bz2", "all.zip"] {
        place.put(&format!("{name}-in/{name}"), packed(name, &files));
        let ran = place.clean(&format!("ingest @{name}-in --out @{name}-out"), 0);
        let said = ran.stderr.contains("1 archives of 1 MB");
        // Members of a zip are read in place.
        assert_eq!(said, name == "all.tar.bz2", "{}", ran.stderr);
    }
}

#[test]
fn the_frame_rate_and_the_skeleton_of_a_webdataset_are_not_guessed() {
    let place = Place::of_shards();
    let unpacked = place.path("unpacked");
    for shard in files_with_extension(&place.path("shards"), "tar") {
        unpack(&shard, &unpacked);
    }
    let files = files_with_extension(&unpacked, "json");
    let names = [("fps", &files[0]), ("skeleton", &files[1])].map(|(key, changed)| {
        let mut facts: Value = json_of(changed);
        let members = facts.as_object_mut().expect("an object");
        members.remove(key).expect("it is stated");
        put(changed, facts.to_string());
        name_of(changed)
    });
    place.ingest("unpacked", "again", 3);
    let code = "E-WEBDATASET-MEMBER";
    let refused = names.each_ref().map(|name| (name.as_str(), code));
    let quarantine = assert_quarantined(&place.path("again"), &refused);
    let [fps, skeleton] = names.each_ref().map(|name| &quarantine[name].reason);
    assert_has(fps, &["no frame rate", "`fps`"]);
    assert_has(skeleton, &["no skeleton", "`skeleton`"]);
    let clips = place.clips("dataset", "").len();
    assert_eq!(place.clips("again", "").len(), clips - 2);
}

#[test]
fn a_dataset_whose_manifest_cannot_be_read_is_quarantined_and_loses_no_clip() {
    let place = Place::of_clips(12);
    place.ingest("corpus", "made", 0);
    place.ingest("made", "dataset", 0);
    let clips = place.clips("dataset", "");
    let manifest = place.path("made/meta/manifest-1.json");
    let whole = fs::read(&manifest).expect("read");
    for (bytes, code) in [
        (&whole[..whole.len() / 2], "E-DATASET-FILE"),
        (POINTER.as_bytes(), "E-LFS-POINTER"),
    ] {
        put(&manifest, bytes);
        place.ingest("made", "dataset", 3);
        assert_eq!(place.clips("dataset", ""), clips);
        let rows: Vec<QuarantineRow> = place.rows("dataset");
        let refused: BTreeSet<&str> = rows.iter().map(|row| row.code.as_str()).collect();
        assert_eq!(refused, BTreeSet::from([code]));
        let of_manifest = rows.iter().filter(|row| row.path == "meta/manifest-1.json");
        assert_eq!(of_manifest.count(), 1);
        // Neither says anything of the clips.
        let pruned = place.typed("ingest @made --out @dataset --prune");
        pruned.expect_code(3);
        assert_eq!(place.clips("dataset", ""), clips);
    }
    put(&manifest, &whole);
    place.ingest("made", "dataset", 0);
    assert_eq!(place.clips("dataset", ""), clips);
}
