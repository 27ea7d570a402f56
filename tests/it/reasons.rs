//! Errors of unusable inputs state the place and the remedy before long work starts.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use datasets_spec::record::{MaskRow, MotionRow, QuarantineRow, SkippedRow};
use serde_json::Value;

use crate::util::{
    arg, assert_counted, assert_has, corpus, files_with_extension, put, rows_of, stance, text_of,
    typed, typed_with,
};

fn ingest(source: &Path, out: &Path, more: &[&str], code: i32) -> Value {
    let ran = typed_with("--json ingest {} --out {}", &[&source, &out], more);
    let done = ran.expect_code(code).json();
    assert_counted(&done);
    done
}

fn ids(dataset: &Path) -> BTreeSet<String> {
    let rows: Vec<MotionRow> = rows_of(dataset);
    rows.into_iter().map(|row| row.id.to_string()).collect()
}

/// A folder with motions of these names and no other files.
fn motions(dir: &Path, names: &[&str]) -> PathBuf {
    let files = files_with_extension(&dir.join("corpus"), "npz");
    let source = dir.join("source");
    fs::create_dir_all(&source).expect("made");
    for (name, file) in names.iter().zip(files.iter().cycle()) {
        let path = source.join(format!("{name}.npz"));
        fs::create_dir_all(path.parent().expect("a folder")).expect("made");
        fs::copy(file, path).expect("copied");
    }
    source
}

#[test]
fn a_quote_that_is_not_closed_is_named_by_its_line() {
    let dir = corpus(8);
    let source = motions(dir.path(), &["walk", "run", "jump", "sit"]);
    put(
        source.join("captions.csv"),
        "clip,text\nwalk,a person walks\nrun,\"a person runs\njump,a person jumps\nsit,a person sits\n",
    );
    let out = dir.path().join("dataset");
    let done = ingest(&source, &out, &[], 0);
    let problems = done["label_problems"].to_string();
    assert_has(
        &problems,
        &[
            "line 3: a quote in it is not closed",
            "the 2 lines behind it",
        ],
    );
    let rows: Vec<MotionRow> = rows_of(&out);
    for row in rows {
        let texts: Vec<&str> = row
            .captions
            .iter()
            .map(|caption| caption.text.as_str())
            .collect();
        assert!(
            texts.iter().all(|text| !text.contains("jump")),
            "{} {texts:?}",
            row.id
        );
    }
    // Lists of splits and pairs are read by the same rules.
    let list = dir.path().join("splits.csv");
    put(&list, "clip,split\nwalk,test\n\"run,val\njump,val\n");
    let out = dir.path().join("split");
    let done = ingest(&source, &out, &["--splits", arg(&list)], 3);
    let refused = done["refused_splits"].to_string();
    assert_has(&refused, &["\"line\":3", "not closed"]);
}

#[test]
fn ids_choose_the_clips_that_are_read() {
    let dir = corpus(12);
    let source = motions(dir.path(), &["walk_1", "walk_2", "run_1", "run_2", "sit"]);
    let list = dir.path().join("ids.txt");
    put(
        &list,
        "# chosen by hand\nwalk_*   # both\nsit\n\ngone\nnobody_*\n",
    );
    let out = dir.path().join("dataset");
    let done = ingest(&source, &out, &["--ids", arg(&list)], 0);
    assert_eq!(
        done["skipped_reasons"]["clip that --ids does not choose"], 2,
        "{done}"
    );
    let remarks = done["remarks"].to_string();
    for (line, name) in [(5, "gone"), (6, "nobody_*")] {
        assert!(
            remarks.contains(&format!("line {line} of --ids")) && remarks.contains(name),
            "{remarks}"
        );
    }
    let chosen = ["walk_1", "walk_2", "sit"].map(str::to_owned);
    assert_eq!(ids(&out), chosen.clone().into());
    let skipped: Vec<SkippedRow> = rows_of(&out);
    let skipped: BTreeSet<&str> = skipped.iter().map(|row| row.path.as_str()).collect();
    assert_eq!(skipped, BTreeSet::from(["run_1.npz", "run_2.npz"]));
    // The dataset records its choice of clips.
    let again = ingest(&source, &out, &["--ids", arg(&list)], 0);
    assert_eq!(again["already_complete"], true, "{again}");
    stance(&["ingest", arg(&source), "--out", arg(&out)])
        .expect_refused("ids was a file and is not given now");
    // With another choice, existing clips that are not chosen stay.
    put(&list, "run_1\n");
    let done = ingest(&source, &out, &["--ids", arg(&list), "--new-version"], 0);
    assert_eq!(done["growth"]["new"], 1, "{done}");
    assert!(
        done["remarks"]
            .to_string()
            .contains("3 clips of the dataset are not among those of --ids"),
        "{done}"
    );
    let all: BTreeSet<String> = chosen.into_iter().chain(["run_1".to_owned()]).collect();
    assert_eq!(ids(&out), all);
    stance(&["verify", arg(&out)]).expect_code(0);
    put(&list, "# nothing\n");
    typed("ingest {} --out {} --ids {}", &[&source, &out, &list])
        .expect_refused("it names no clip");
}

#[test]
fn another_list_of_splits_is_told_by_the_ids_that_it_moves() {
    let dir = corpus(8);
    let source = motions(dir.path(), &["walk", "run", "jump"]);
    let (out, list) = (dir.path().join("dataset"), dir.path().join("splits.csv"));
    put(&list, "walk,train\nrun,train\njump,train\n");
    ingest(&source, &out, &["--splits", arg(&list)], 0);
    put(&list, "walk,train\nrun,test\njump,train\n");
    let ran = typed("ingest {} --out {} --splits {}", &[&source, &out, &list]).expect_code(1);
    ran.expect_said("splits moves run (train, now test)");
    assert!(!ran.stderr.contains("walk"), "{}", ran.stderr);
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
        let common = [
            &[20, 0, 0, 0, 0, 0, 0, 0, 0, 0],
            &sizes[..],
            &name_length,
            &[0, 0],
        ]
        .concat();
        let local = [b"PK\x03\x04", &common[..], name.as_bytes(), head].concat();
        file.write_all(&local).expect("written");
        let rest = (length - head.len() as u64) as i64;
        file.seek(SeekFrom::Current(rest)).expect("placed");
        directory.extend([b"PK\x01\x02\x14\0", &common[..]].concat());
        directory.extend([0; 10]);
        directory.extend(u32::try_from(start).expect("below 4 GiB").to_le_bytes());
        directory.extend(name.as_bytes());
    }
    let start = u32::try_from(file.stream_position().expect("a place")).expect("below 4 GiB");
    let count = (members.len() as u16).to_le_bytes();
    let size = (directory.len() as u32).to_le_bytes();
    let end = [
        b"PK\x05\x06",
        &[0; 4][..],
        &count,
        &count,
        &size,
        &start.to_le_bytes(),
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
    let dir = corpus(2);
    let source = motions(dir.path(), &["good"]);
    let frames = 4_320_000u64;
    let (poses, trans) = (
        npy_header(&format!("({frames}, 156)")),
        npy_header(&format!("({frames}, 3)")),
    );
    let (poses_len, trans_len) = (
        poses.len() as u64 + frames * 156 * 4,
        trans.len() as u64 + frames * 3 * 4,
    );
    let rate = [npy_header("()"), 120.0f32.to_le_bytes().to_vec()].concat();
    let rate_len = rate.len() as u64;
    let path = source.join("day_poses.npz");
    put_sparse(
        &path,
        &[
            ("mocap_framerate.npy", rate, rate_len),
            ("trans.npy", trans, trans_len),
            ("poses.npy", poses, poses_len),
        ],
    );
    let out = dir.path().join("dataset");
    ingest(&source, &out, &[], 3);
    let quarantine: Vec<QuarantineRow> = rows_of(&out);
    let [row] = &quarantine[..] else {
        panic!("{quarantine:?}");
    };
    assert_eq!(
        (row.path.as_str(), row.code.as_str()),
        ("day_poses.npz", "E-NPZ-LIMIT")
    );
    assert_has(
        &row.reason,
        &[
            "4320000 frames at 120 fps are 10.0 hours",
            "cut the recording",
        ],
    );
    assert_eq!(ids(&out), ["good".to_owned()].into());
}

#[test]
fn a_name_of_254_bytes_is_shortened_and_said() {
    let dir = corpus(4);
    let long = "l".repeat(250);
    let (other, accented) = (format!("{}2", "l".repeat(249)), "é".repeat(125));
    let source = motions(dir.path(), &[&long, &other, &accented, "short"]);
    let out = dir.path().join("dataset");
    ingest(&source, &out, &[], 0);
    for layout in [
        "amass",
        "bvh",
        "gltf",
        "motionmillion",
        "humanml3d",
        "webdataset",
        "stance",
        "lerobot",
    ] {
        let to = dir.path().join(layout);
        let done: Value = typed("--json export {} --to {} --out {}", &[&out, &layout, &to]).done();
        assert_eq!(done["clips"], 4, "{layout}");
        let is_said = done["remarks"].to_string().contains("3 names are too long");
        let has_names = ["amass", "bvh", "gltf", "motionmillion"].contains(&layout);
        assert_eq!(is_said, has_names, "{layout} {done}");
    }
    let files = files_with_extension(&dir.path().join("bvh"), "bvh");
    assert_eq!(files.len(), 4);
    // The masks are imported again under the short names.
    let again = dir.path().join("again");
    ingest(&dir.path().join("bvh"), &again, &[], 0);
    assert_eq!(ids(&again).len(), 4);
}

#[test]
fn a_humanml3d_export_without_captions_says_so_before_it_writes() {
    let dir = corpus(4);
    let source = motions(dir.path(), &["one", "two"]);
    let out = dir.path().join("dataset");
    ingest(&source, &out, &["--no-made-captions"], 0);
    let export = |dataset: &Path, to: &str| {
        let to = dir.path().join(to);
        typed("--json export {} --to humanml3d --out {}", &[&dataset, &to]).expect_code(0)
    };
    let ran = export(&out, "plain");
    let done: Value = ran.json();
    assert!(
        done["remarks"]
            .to_string()
            .contains("none of the 2 clips has a caption"),
        "{done}"
    );
    ran.expect_said("captions.csv");
    let described = dir.path().join("described");
    ingest(&dir.path().join("corpus"), &described, &[], 0);
    let done: Value = export(&described, "texts").json();
    assert!(
        !done["remarks"].to_string().contains("has a caption"),
        "{done}"
    );
}

#[test]
fn edited_texts_without_a_verdict_are_kept() {
    let dir = corpus(30);
    let (out, file) = (dir.path().join("dataset"), dir.path().join("masks.jsonl"));
    ingest(&dir.path().join("corpus"), &out, &[], 0);
    stance(&["masks", arg(&out)]).expect_code(0);
    stance(&["masks", arg(&out), "--drafts", arg(&file)]).expect_code(0);
    let mut lines: Vec<Value> = text_of(&file)
        .lines()
        .map(|line| serde_json::from_str(line).expect("a line"))
        .collect();
    lines[0]["text"] = "The person is thinking about it.".into();
    lines[1]["verdict"] = "accept".into();
    let edited = lines[0]["mask"].as_str().expect("an id").to_owned();
    let text: String = lines.iter().map(|line| format!("{line}\n")).collect();
    put(&file, text);
    let ran = typed("masks {} --accept {} --author ann", &[&out, &file]).expect_code(0);
    ran.expect_said("1 edited lines have no verdict yet");
    let masks: Vec<MaskRow> = rows_of(&out);
    let masks: BTreeMap<&str, &MaskRow> = masks.iter().map(|row| (row.id.as_str(), row)).collect();
    let row = masks[edited.as_str()];
    assert_eq!(row.text, "The person is thinking about it.");
    assert_eq!(
        (row.text_origin.as_str(), row.author.as_str()),
        ("draft", "ann")
    );
    // The task is still open, and no run of the stage discards it.
    stance(&["masks", arg(&out), "--drafts", arg(&file)]).expect_code(0);
    let lines = text_of(&file);
    let line = lines
        .lines()
        .find(|line| line.contains("thinking about it"))
        .expect("the draft");
    assert!(line.contains("\"todo\""), "{line}");
}

#[test]
fn listed_ids_without_a_motion_are_a_remark() {
    let dir = corpus(8);
    let (dataset, release) = (dir.path().join("dataset"), dir.path().join("release"));
    ingest(&dir.path().join("corpus"), &dataset, &[], 0);
    typed("export {} --to humanml3d --out {}", &[&dataset, &release]).expect_code(0);
    let list = release.join("test.txt");
    let listed = text_of(&list);
    put(&list, listed + "014000\n014001\n");
    let said = "2 ids of test.txt have no motion (such as 014000, 014001)";
    let out = dir.path().join("again");
    let done = ingest(&release, &out, &[], 0);
    assert!(done["remarks"].to_string().contains(said), "{done}");
    let (dataset, release) = (
        dir.path().join("dataset"),
        dir.path().join("stance-release"),
    );
    typed("export {} --to stance --out {}", &[&dataset, &release]).expect_code(0);
    let list = release.join("split/base_motion/test.txt");
    let listed = fs::read_to_string(&list).unwrap_or_default();
    fs::create_dir_all(list.parent().expect("a folder")).expect("made");
    put(&list, listed + "014000\n");
    let done = ingest(&release, &dir.path().join("stance-again"), &[], 0);
    assert!(
        done["remarks"]
            .to_string()
            .contains("1 ids of split/base_motion have no motion"),
        "{done}"
    );
}
