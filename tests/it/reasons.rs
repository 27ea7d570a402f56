//! Errors of unusable inputs state the place and the remedy before long work starts.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::{Seek, SeekFrom, Write};
use std::path::Path;

use datasets_spec::record::{MaskRow, MotionRow};
use serde_json::{Value, json};

use crate::archives::{Files, files_below, packed};
use crate::util::{
    Folder, assert_has, assert_quarantined, assert_tells, files_with_extension, json_lines,
    motions_of, put, root_hash_of, skipped_of, text_of,
};

fn ids(dir: &Folder, dataset: &str) -> BTreeSet<String> {
    motions_of(&dir.path(dataset)).into_keys().collect()
}

#[test]
fn the_manual_has_every_code() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let manual = text_of(root.join("pipeline/docs/codes.md"));
    let known = manual.split('`').filter(|word| word.starts_with("E-"));
    let known: BTreeSet<&str> = known.collect();
    // `E-NPY-*` stands for all codes that begin so.
    let is_known = |code: &str| {
        let mut starts = known.iter().filter_map(|word| word.strip_suffix('*'));
        known.contains(code) || starts.any(|start| code.starts_with(start))
    };
    let mut codes = BTreeSet::new();
    for folder in [
        "src",
        "datasets-spec",
        "pipeline",
        "train",
        "eval",
        "annotate/src",
    ] {
        for file in files_with_extension(&root.join(folder), "rs") {
            let text = text_of(&file);
            let program = text.split("#[cfg(test)]").next().unwrap_or_default();
            if file.components().any(|part| part.as_os_str() == "src")
                && !file.ends_with("tests.rs")
            {
                let quoted = program.split('"').filter(|word| word.starts_with("E-"));
                codes.extend(quoted.map(str::to_owned));
            }
        }
    }
    let is_of_code = |c: char| c.is_ascii_uppercase() || c.is_ascii_digit() || c == '-';
    codes.retain(|word| !word.ends_with('-') && word.chars().all(is_of_code));
    assert!(codes.len() > 60, "{codes:?}");
    codes.retain(|code| !is_known(code));
    assert_eq!(codes, BTreeSet::new(), "not in pipeline/docs/codes.md");
}

/// A folder with motions of these names in `source`, made of the motions of a small corpus.
fn motions(names: &[&str]) -> Folder {
    let dir = Folder::of_clips(12);
    let files = files_with_extension(&dir.path("corpus"), "npz");
    for (name, file) in names.iter().zip(files.iter().cycle()) {
        let bytes = fs::read(file).expect("read");
        dir.put(&format!("source/{name}.npz"), bytes);
    }
    dir
}

#[test]
fn a_quote_that_is_not_closed_is_named_by_its_line_and_a_changed_list_by_its_ids() {
    let dir = motions(&["walk", "run", "jump", "sit"]);
    let list = "clip,text\nwalk,a person walks\nrun,\"a person runs\njump,a person jumps\nsit,a person sits\n";
    dir.put("source/captions.csv", list);
    let done = dir.ingest("@source --out @dataset", 0);
    assert_has(
        &done["label_problems"].to_string(),
        &[
            "line 3: a quote in it is not closed",
            "the 2 lines behind it",
        ],
    );
    for row in dir.rows::<MotionRow>("dataset") {
        let mut texts = row.captions.iter().map(|caption| &caption.text);
        assert!(texts.all(|text| !text.contains("jump")), "{}", row.id);
    }
    // Lists of splits and pairs are read by the same rules.
    let list = "clip,split\nwalk,test\n\"run,val\njump,val\n";
    dir.put("splits.csv", list);
    let done = dir.ingest("@source --out @split --splits @splits.csv", 3);
    let refused = done["refused_splits"].to_string();
    assert_has(&refused, &["\"line\":3", "not closed"]);
    // A changed list is reported with the ids that it moves.
    let moved = "@source --out @moved --splits @splits.csv";
    let list = "walk,train\nrun,train\njump,train\nsit,train\n";
    dir.put("splits.csv", list);
    dir.ingest(moved, 0);
    dir.put("splits.csv", list.replace("run,train", "run,test"));
    let ran = dir.typed(&format!("ingest {moved}")).expect_code(1);
    ran.expect_said("splits moves run (train, now test)");
    assert!(!ran.stderr.contains("walk"), "{}", ran.stderr);
}

#[test]
fn ids_choose_the_clips_that_are_read() {
    let dir = motions(&["walk_1", "walk_2", "run_1", "run_2", "sit"]);
    let chosen = "# chosen by hand\nwalk_*   # both\nsit\n\ngone\nnobody_*\n";
    dir.put("ids.txt", chosen);
    let line = "@source --out @dataset --ids @ids.txt";
    let done = dir.ingest(line, 0);
    let reasons = json!({"clip that --ids does not choose": 2});
    assert_eq!(done["skipped_reasons"], reasons);
    let remarks = done["remarks"].to_string();
    assert_has(&remarks, &["line 5 of --ids", "gone"]);
    assert_has(&remarks, &["line 6 of --ids", "nobody_*"]);
    let mut chosen = BTreeSet::from(["walk_1", "walk_2", "sit"].map(str::to_owned));
    assert_eq!(ids(&dir, "dataset"), chosen);
    let skipped: Vec<String> = skipped_of(&dir.path("dataset")).into_keys().collect();
    assert_eq!(skipped, ["run_1.npz", "run_2.npz"]);
    // The dataset records its choice of clips.
    let again = dir.ingest(line, 0);
    assert_eq!(again["already_complete"], true, "{again}");
    let said = "ids was a file and is not given now";
    dir.refused("ingest @source --out @dataset", said);
    // With another choice, existing clips that are not chosen stay.
    dir.put("ids.txt", "run_1\n");
    let done = dir.ingest(&format!("{line} --new-version"), 0);
    assert_eq!(done["growth"]["new"], 1, "{done}");
    let said = "3 clips of the dataset are not among those of --ids";
    assert_tells(&done["remarks"], said);
    chosen.insert("run_1".to_owned());
    assert_eq!(ids(&dir, "dataset"), chosen);
    dir.run("verify @dataset");
    dir.put("ids.txt", "# nothing\n");
    dir.refused(&format!("ingest {line}"), "it names no clip");
}

/// Writes a zip whose members have the stated lengths; the bytes after their beginnings take no space on the disk.
fn put_sparse(path: &Path, members: &[(&str, Vec<u8>, u64)]) {
    let mut file = File::create(path).expect("made");
    let mut directory = Vec::new();
    for (name, head, length) in members {
        let start = file.stream_position().expect("a place");
        let length32 = u32::try_from(*length).expect("below 4 GiB").to_le_bytes();
        // The checksum of a partly written member is not checked.
        let crc = crc32fast::hash(head).to_le_bytes();
        let sizes = [crc, length32, length32].concat();
        let name_length = (name.len() as u16).to_le_bytes();
        let common = [&[20, 0, 0, 0, 0, 0, 0, 0, 0, 0], &sizes[..], &name_length];
        let common = [&common.concat()[..], &[0, 0]].concat();
        let local = [b"PK\x03\x04", &common[..], name.as_bytes(), head].concat();
        file.write_all(&local).expect("written");
        let rest = (length - head.len() as u64) as i64;
        file.seek(SeekFrom::Current(rest)).expect("placed");
        directory.extend([b"PK\x01\x02\x14\0", &common[..]].concat());
        directory.extend([0; 10]);
        directory.extend(u32::try_from(start).expect("below 4 GiB").to_le_bytes());
        directory.extend(name.as_bytes());
    }
    let start = file.stream_position().expect("a place") as u32;
    let start = start.to_le_bytes();
    let count = (members.len() as u16).to_le_bytes();
    let size = (directory.len() as u32).to_le_bytes();
    let end = [
        &b"PK\x05\x06\0\0\0\0"[..],
        &count,
        &count,
        &size,
        &start,
        &[0; 2],
    ]
    .concat();
    file.write_all(&[directory, end].concat()).expect("written");
}

/// The header of an npy file of single precision.
fn npy_header(shape: &str) -> Vec<u8> {
    let mut text = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}");
    while (10 + text.len() + 1) % 64 != 0 {
        text.push(' ');
    }
    text.push('\n');
    let length = (text.len() as u16).to_le_bytes();
    [b"\x93NUMPY\x01\0", &length[..], text.as_bytes()].concat()
}

#[test]
fn ten_hours_are_refused_by_the_header() {
    let dir = motions(&["good"]);
    let frames = 4_320_000u64;
    // Arrays of single precision; the file holds only their headers.
    let array = |name: &'static str, width: u64| {
        let header = npy_header(&format!("({frames}, {width})"));
        let length = header.len() as u64 + frames * width * 4;
        (name, header, length)
    };
    let rate = [npy_header("()"), 120.0f32.to_le_bytes().to_vec()].concat();
    let length = rate.len() as u64;
    let rate = ("mocap_framerate.npy", rate, length);
    let members = [rate, array("trans.npy", 3), array("poses.npy", 156)];
    put_sparse(&dir.path("source/day_poses.npz"), &members);
    dir.ingest("@source --out @dataset", 3);
    let expected = [("day_poses.npz", "E-NPZ-LIMIT")];
    let found = assert_quarantined(&dir.path("dataset"), &expected);
    let hours = "4320000 frames at 120 fps are 10.0 hours";
    assert_has(
        &found["day_poses.npz"].reason,
        &[hours, "cut the recording"],
    );
    assert_eq!(ids(&dir, "dataset"), ["good".to_owned()].into());
}

#[test]
fn a_name_of_254_bytes_is_shortened_and_said() {
    let long = "l".repeat(250);
    let (other, accented) = (format!("{}2", "l".repeat(249)), "é".repeat(125));
    let dir = motions(&[&long, &other, &accented, "short"]);
    dir.ingest("@source --out @dataset", 0);
    for layout in "amass bvh gltf motionmillion humanml3d webdataset stance lerobot".split(' ') {
        let done: Value = dir.json(&format!("export @dataset --to {layout} --out @{layout}"));
        assert_eq!(done["clips"], 4, "{layout}");
        let is_said = done["remarks"].to_string().contains("3 names are too long");
        let has_names = ["amass", "bvh", "gltf", "motionmillion"].contains(&layout);
        assert_eq!(is_said, has_names, "{layout} {done}");
    }
    let files = files_with_extension(&dir.path("bvh"), "bvh");
    assert_eq!(files.len(), 4);
    // The clips are ingested again under the short names.
    dir.ingest("@bvh --out @again", 0);
    assert_eq!(ids(&dir, "again").len(), 4);
}

#[test]
fn a_humanml3d_export_without_captions_says_so_before_it_writes() {
    let dir = motions(&["one", "two"]);
    dir.ingest("@source --out @dataset --no-made-captions", 0);
    let ran = dir.run("--json export @dataset --to humanml3d --out @release");
    let done: Value = ran.json();
    assert_tells(&done["remarks"], "none of the 2 clips has a caption");
    ran.expect_said("captions.csv");
}

#[test]
fn edited_texts_without_a_verdict_are_kept() {
    let dir = Folder::of_masks(30);
    dir.run("masks @dataset --drafts @masks.jsonl");
    let mut lines = json_lines(&dir.text("masks.jsonl"));
    lines[0]["text"] = "The person is thinking about it.".into();
    lines[1]["verdict"] = "accept".into();
    let edited = lines[0]["mask"].as_str().expect("an id").to_owned();
    let text: String = lines.iter().map(|line| format!("{line}\n")).collect();
    dir.put("masks.jsonl", text);
    let ran = dir.run("masks @dataset --accept @masks.jsonl --author ann");
    ran.expect_said("1 edited lines have no verdict yet");
    let masks: Vec<MaskRow> = dir.rows("dataset");
    let row = masks.iter().find(|row| row.id == edited).expect("the mask");
    assert_eq!(row.text, "The person is thinking about it.");
    assert_eq!(row.text_origin, "draft");
    assert_eq!(row.author, "ann");
    // Writing the drafts again does not overwrite the lines of a review.
    let reviewed = dir.text("masks.jsonl");
    let again = "masks @dataset --drafts @masks.jsonl";
    dir.refused(again, "exists already");
    assert_eq!(dir.text("masks.jsonl"), reviewed);
    // The mask still waits for a verdict, and other drafts keep its text.
    dir.run("masks @dataset --drafts @again.jsonl");
    let lines = dir.text("again.jsonl");
    let mut lines = lines.lines();
    let line = lines.find(|line| line.contains("thinking about it"));
    assert_has(line.expect("the draft"), &["\"todo\""]);
}

#[test]
fn a_reviewer_is_named_only_where_lines_are_accepted() {
    let dir = Folder::of_dataset(6);
    let before = root_hash_of(&dir.path("dataset"));
    for more in [
        "",
        "--replace",
        "--add",
        "--where 'n_frames > 2'",
        "--drafts @masks.jsonl",
    ] {
        let ran = dir.typed(&format!("masks @dataset --author zed {more}"));
        ran.expect_code(2).expect_said("--author");
    }
    let inside = "masks @dataset --drafts @dataset/masks.jsonl";
    dir.refused(inside, "name a file outside of it");
    for made in ["masks.jsonl", "dataset/masks.jsonl"] {
        assert!(!dir.path(made).exists(), "{made}");
    }
    assert_eq!(root_hash_of(&dir.path("dataset")), before);
}

#[test]
fn new_clips_lack_no_labels_because_of_damage_elsewhere() {
    let dir = Folder::of_clips(12);
    let [bvh, amass] = ["bvh", "amass"].map(|part| files_below(&dir.path("corpus").join(part)));
    let remarks = |name: &str| {
        let done = dir.ingest(&format!("@{name} --out @out/{name}"), 3);
        assert!(done["ingested"].as_u64() >= Some(6), "{done}");
        done["remarks"].to_string()
    };
    let folder = |name: &str, files: &[(&str, &Files)]| {
        for (archive, files) in files {
            dir.put(&format!("{name}/{archive}"), packed(archive, files));
        }
    };

    // A motion with an unusable name says nothing of the others.
    let mut evil = bvh.clone();
    evil.insert("../evil.bvh".to_owned(), b"HIERARCHY".to_vec());
    folder("named", &[("evil.tar", &evil), ("good.zip", &amass)]);
    assert_eq!(remarks("named"), "[]");

    // A cut archive may have held labels of its own motions.
    folder("cut", &[("cut.tar", &bvh), ("good.tar", &amass)]);
    let cut = dir.path("cut/cut.tar");
    let whole = fs::read(&cut).expect("read");
    put(&cut, &whole[..whole.len() / 2]);
    let said = remarks("cut");
    let rows = motions_of(&dir.path("out/cut"));
    let is_cut = |row: &&MotionRow| row.source_path.starts_with("cut.tar/");
    let num_cut = rows.values().filter(is_cut).count();
    let expected = format!("up to {num_cut} new clips may lack labels");
    assert_has(&said, &[&expected, "now: cut.tar\""]);

    // An archive of captions alone may describe the motions beside it.
    let caption = b"a man walks#a/DET#0.0#0.0\n".to_vec();
    let captions = Files::from([("000000.txt".to_owned(), caption)]);
    folder("beside", &[("good.zip", &amass), ("texts.tar", &captions)]);
    let texts = dir.path("beside/texts.tar");
    let whole = fs::read(&texts).expect("read");
    put(&texts, &whole[..600]);
    assert_has(&remarks("beside"), &["up to 6 new", "now: texts.tar\""]);
}

#[test]
fn listed_ids_without_a_motion_are_a_remark() {
    let dir = Folder::of_dataset(8);
    for (layout, list, more, said) in [
        (
            "humanml3d",
            "test.txt",
            "014000\n014001\n",
            "2 ids of test.txt have no motion (such as 014000, 014001)",
        ),
        (
            "stance",
            "split/base_motion/test.txt",
            "014000\n",
            "1 ids of split/base_motion have no motion",
        ),
    ] {
        let export = format!("export @dataset --to {layout} --out @{layout}");
        let made: Value = dir.json(&export);
        let remarks = made["remarks"].to_string();
        assert!(!remarks.contains("has a caption"), "{remarks}");
        let list = dir.path(layout).join(list);
        let listed = fs::read_to_string(&list).unwrap_or_default();
        put(&list, listed + more);
        let done = dir.ingest(&format!("@{layout} --out @{layout}-again"), 0);
        assert_tells(&done["remarks"], said);
    }
}
