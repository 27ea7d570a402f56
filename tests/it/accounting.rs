//! Every file is accounted for: lists of clips, rejections and skips, failures as JSON, names, folders
//! that cannot be read, archives, and clips that are read in part.

use std::fs;

use clip::check::flag_names;
use datasets_spec::dataset::Transaction;
use datasets_spec::record::{HumanMl3dRow, MotionRow};
use datasets_spec::{Fps, Motion, Pose, Skeleton};
use glam::DQuat;
use serde_json::{Value, json};

use crate::archives::{Files, files_below, packed};
use crate::formats::walk;
use crate::util::{
    Folder, Ran, arg, assert_has, assert_quarantined, assert_tells, motions_of, put, stance,
    word_of,
};

/// Runs a command line with `--json` that ends with this code, and returns its failure.
fn failed(dir: &Folder, line: &str, code: i32) -> Value {
    let ran = dir.typed(&format!("--json {line}"));
    ran.expect_code(code).json()
}

/// The first motion of a dataset.
fn first(dir: &Folder, dataset: &str) -> MotionRow {
    dir.rows(dataset).remove(0)
}

/// The poses as a BVH file at 30 fps.
fn bvh(poses: &[Pose]) -> String {
    let fps = Fps::new(30.0).expect("valid");
    let motion = Motion::from_poses(fps, poses).expect("finite");
    formats::write::bvh::encode(&motion, &Skeleton::smplx_neutral())
}

#[test]
fn a_dataset_lists_its_clips_and_the_files_it_left_out() {
    let dir = Folder::empty();
    dir.put("source/walk.bvh", bvh(&walk(60, 30.0)));
    dir.put("source/broken.bvh", "HIERARCHY\nROOT");
    dir.put("source/notes.md", "no motion");
    dir.ingest("@source --out @dataset", 3);
    let list = |kind: &str| dir.json::<Value>(&format!("inspect @dataset --list {kind}"));
    let text = |kind: &str| dir.run(&format!("inspect @dataset --list {kind}")).stdout;
    let row = first(&dir, "dataset");
    let flags = flag_names(row.quality.flags);
    assert!(flags.contains(&"no-caption"), "{flags:?}");
    let clip =
        json!({"id": "walk", "split": row.split.as_str(), "path": "walk.bvh", "flags": flags});
    assert_eq!(list("clips"), json!([clip]));
    assert!(text("clips").starts_with("walk "), "{}", text("clips"));

    let expected = [("broken.bvh", "E-BVH-SYNTAX")];
    let row = &assert_quarantined(&dir.path("dataset"), &expected)["broken.bvh"];
    let (reason, offset) = (&row.reason, row.byte_offset.expect("a place in the file"));
    assert!(!reason.is_empty());
    let rejection = json!({
        "path": "broken.bvh", "code": "E-BVH-SYNTAX", "reason": reason, "byte_offset": offset,
    });
    assert_eq!(list("quarantine"), json!([rejection]));
    let place = format!("byte {offset}");
    let words = ["broken.bvh", "E-BVH-SYNTAX", &place, reason];
    assert_has(&text("quarantine"), &words);
    assert!(list("skipped").is_array());
    let both = "inspect @dataset --list clips --clip walk";
    dir.typed(both).expect_code(2);
}

#[test]
fn inspect_of_a_rejected_file_exits_with_3_and_names_the_reason() {
    let dir = Folder::empty();
    dir.put("good.bvh", bvh(&walk(20, 30.0)));
    let longer = dir.text("good.bvh").replace("Frames: 20", "Frames: 21");
    dir.put("broken.bvh", longer);
    let ran = dir.typed("inspect @broken.bvh").expect_code(3);
    ran.expect_printed("E-BVH-FRAMES found 20 rows");
    let failure = failed(&dir, "inspect @broken.bvh", 3);
    assert_eq!(failure["code"], "E-BVH-FRAMES");
    let broken = dir.path("broken.bvh");
    assert_eq!(failure["item"], arg(&broken));
    assert_tells(&failure["reason"], "found 20 rows");
    // The checks refuse this motion, not the reader.
    dir.put("short.bvh", bvh(&walk(1, 30.0)));
    let failure = failed(&dir, "inspect @short.bvh", 3);
    assert_eq!(failure["code"], "E-TOO-SHORT");
    let said: Value = dir.json("inspect @good.bvh");
    assert_eq!(said.get("code"), None);

    // An archive is refused with the ways to look into it, of which one is to name a member.
    let good = dir.text("good.bvh").into_bytes();
    let files = Files::from([("a/good.bvh".to_owned(), good)]);
    for name in ["some.zip", "some.tar", "some.tar.gz"] {
        dir.put(name, packed(name, &files));
        let inspect = format!("inspect @{name}");
        assert_eq!(failed(&dir, &inspect, 1)["code"], "E-NO-MOTION");
        let ran = dir.typed(&inspect).expect_code(1);
        let path = dir.path(name);
        ran.expect_said(&format!("stance doctor {}", path.display()));
        ran.expect_said(&format!("stance inspect {}/MEMBER", path.display()));
        let member: Value = dir.json(&format!("{inspect}/a/good.bvh"));
        assert_eq!(member, said);
    }
    for more in ["--list clips", "--clip walk"] {
        let failure = failed(&dir, &format!("inspect @good.bvh {more}"), 1);
        assert_eq!(failure["code"], "E-DATASET");
        assert_tells(&failure["reason"], "need the folder of a dataset");
    }
}

#[test]
fn a_failure_is_json_too_where_json_is_asked_for() {
    let dir = Folder::empty();
    fs::create_dir(dir.path("empty")).expect("a folder");
    dir.put("folder/broken.bvh", "HIERARCHY");
    let nowhere = "ingest @missing --out @dataset";
    let nothing = "ingest @empty --out @dataset";
    let unread = "render @folder/broken.bvh --out @x.png";
    for (line, exit, code, item) in [
        (nowhere, 1, "E-MISSING", Some("missing")),
        (nothing, 1, "E-NO-FILES", Some("empty")),
        ("inspect @missing", 1, "E-IO", Some("missing")),
        ("stats @missing", 1, "E-DATASET", Some("missing")),
        ("inspect @folder", 1, "E-DATASET", Some("folder")),
        (unread, 1, "E-BVH-SYNTAX", Some("folder/broken.bvh")),
        ("ingest @missing", 2, "E-USAGE", None),
        ("no-such-verb", 2, "E-USAGE", None),
    ] {
        let ran = dir.typed(&format!("--json {line}")).expect_code(exit);
        let failure: Value = ran.json();
        assert_eq!(failure["code"], code, "{line}");
        let item = item.map(|name| dir.path(name));
        assert_eq!(failure["item"].as_str(), item.as_deref().map(arg), "{line}");
        // The recorded reason equals the message on stderr.
        let mut reason = word_of(&failure["reason"]).lines();
        ran.expect_said(reason.next().expect("a reason"));
        let plain = dir.typed(line).expect_code(exit);
        assert!(plain.stdout.is_empty(), "{line}");
    }
    dir.refused(nowhere, "no such file or folder");
    dir.refused(nothing, "no files under");
    let out = dir.path("dataset");
    assert!(!out.exists(), "a refused run leaves nothing");
    let help = dir.run("--help").stdout;
    assert_has(&help, &["code", "item", "reason"]);
    // A dataset that another run holds is left alone.
    let lock = Transaction::begin(&out, "the other run").expect("locks");
    dir.put("source/walk.bvh", bvh(&walk(20, 30.0)));
    let ran = dir.typed("--json ingest @source --out @dataset");
    let ran = ran.expect_code(75);
    assert_eq!(ran.json::<Value>()["code"], "E-LOCKED");
    ran.expect_said("the other run");
    drop(lock);
    dir.ingest("@source --out @dataset", 0);
}

#[cfg(unix)]
#[test]
fn names_that_are_not_text_stay_apart_and_never_reach_the_terminal() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;

    let dir = Folder::empty();
    let path = |name: &[u8]| dir.path("source").join(OsStr::from_bytes(name));
    let label =
        r#"{"captions": [{"text": "a person walks", "tokens": "", "from_s": 0, "to_s": 0}]}"#;
    for name in [&b"a\xff"[..], b"a\xfe", br"a\xff", b"red\x1b[31m"] {
        put(path(&[name, b".bvh"].concat()), bvh(&walk(30, 30.0)));
        put(path(&[name, b".stance.json"].concat()), label);
    }
    put(path(b"\x1b]0;title\x07.bvh"), "HIERARCHY");
    put(path(b"\xc2\x9b31m.md"), "no motion");
    let ran = dir.typed("ingest @source --out @dataset").expect_code(3);
    let listed = dir.run("inspect @dataset --list quarantine");
    let broken = path(b"\x1b]0;title\x07.bvh");
    let one = stance(&["inspect", arg(&broken)]).expect_code(3);
    let none = stance(&["inspect", arg(&path(b"\x1b[31mnone"))]).expect_code(1);
    for text in [&ran, &listed, &one, &none].map(|ran| format!("{}{}", ran.stdout, ran.stderr)) {
        let obeyed = |c: char| c.is_control() && c != '\n' && c != '\t';
        assert!(!text.contains(obeyed), "{text:?}");
    }
    listed.expect_printed(r"\x1b]0;title\x07.bvh");
    let rows: Vec<MotionRow> = dir.rows("dataset");
    let mut ids: Vec<&str> = rows.iter().map(|row| row.id.as_str()).collect();
    ids.sort_unstable();
    assert_eq!(ids, [r"a\\xff", r"a\xfe", r"a\xff", r"red\x1b[31m"]);
    // Labels beside each file are found under the file's true name.
    assert!(rows.iter().all(|row| row.captions.len() == 1), "{rows:?}");
    let out = dir.path("").join(OsStr::from_bytes(b"out\xff"));
    for more in ["", "--json"] {
        let mut command = dir.command(&format!("ingest @source --dry-run {more} --out"));
        let ran = Ran::from(command.arg(&out).output().expect("stance starts"));
        ran.expect_code(0);
    }
}

#[cfg(unix)]
#[test]
fn a_folder_that_cannot_be_listed_does_not_end_the_run_and_one_of_links_says_so() {
    let dir = Folder::empty();
    dir.put("source/walk.bvh", bvh(&walk(30, 30.0)));
    // These paths are longer than the system allows: not even an administrator can list the innermost folders.
    let script = r#"cd "$0" && for i in $(seq 20); do mkdir $1 && cd $1 || exit 1; done"#;
    let made = std::process::Command::new("bash")
        .args(["-c", script, arg(&dir.path("source")), &"d".repeat(250)])
        .status()
        .expect("bash starts");
    assert!(made.success());
    let done = dir.ingest("@source --out @dataset", 3);
    assert_eq!(done["ingested"], 1, "{done}");
    assert_eq!(done["codes"], json!({"E-IO": 1}));
    let list = dir.run("inspect @dataset --list quarantine");
    list.expect_printed("cannot list the folder");
    let again = dir.typed("ingest @source --out @dataset").expect_code(3);
    again.expect_printed("already complete");
    let doctor = dir.run("doctor @source");
    doctor.expect_printed("cannot be listed");
    // A folder of links alone says so.
    let links = dir.path("links");
    fs::create_dir(&links).expect("a folder");
    for name in ["one", "two"] {
        std::os::unix::fs::symlink(dir.path("source"), links.join(name)).expect("links");
    }
    let skipped = "all 2 entries are skipped: link to a folder";
    let refused = dir.refused("ingest @links --out @other", skipped);
    refused.expect_said("name the folder it leads to");
}

#[test]
fn archives_are_named_and_a_dataset_without_motions_is_a_failure() {
    let dir = Folder::empty();
    for name in ["s.zip", "s.tar", "s.tar.gz", ".bvh.gz", "s.7z"] {
        dir.put(&format!("source/walk{name}"), "an archive");
    }
    for _ in 0..2 {
        let done = dir.ingest("@source --out @dataset", 1);
        assert_eq!((&done["sources"], &done["skipped"]), (&json!(5), &json!(2)));
        assert_eq!(done["codes"]["E-ARCHIVE-DAMAGED"], 3);
        let reasons = done["skipped_reasons"].as_object().expect("a map");
        if !reasons.is_empty() {
            for kind in ["gz", "7z"] {
                assert_eq!(reasons[&format!("{kind} archive; unpack it")], 1, "{done}");
            }
        }
        let failure = failed(&dir, "ingest @source --out @dataset", 1);
        assert_eq!(failure["code"], "E-NO-MOTION");
        assert_eq!(failure["item"], arg(&dir.path("dataset")));
        assert_tells(&failure["reason"], "the dataset has no motion");
    }
    // With one motion among the files, the run succeeds apart from the quarantine.
    dir.put("source/walk.bvh", bvh(&walk(30, 30.0)));
    dir.ingest("@source --out @other", 3);
}

#[test]
fn a_reference_frame_before_the_motion_is_dropped_with_a_flag() {
    let dir = Folder::empty();
    let mut poses = walk(1300, 30.0);
    // A T-pose three metres away, whose rotations are not exactly zero.
    poses[0].transl.x -= 3.0;
    poses[0].rotations = [DQuat::from_rotation_y(1e-4); 22];
    dir.put("source/captured.bvh", bvh(&poses));
    let label =
        r#"{"captions": [{"text": "a person walks", "tokens": "", "from_s": 1, "to_s": 3}]}"#;
    dir.put("source/captured.stance.json", label);
    dir.ingest("@source --out @dataset", 0);
    let row = first(&dir, "dataset");
    assert_eq!((row.start_frame, row.end_frame), (1, 1300));
    assert_eq!(row.n_frames, 1 + (1298 * 2) / 3);
    let flags = flag_names(row.quality.flags);
    assert!(flags.contains(&"reference-dropped"), "{flags:?}");
    assert!(!flags.contains(&"teleport"), "{flags:?}");
    assert_has(&row.notes.join("\n"), &["source frame 0"]);
    // The captions start a thirtieth of a second earlier.
    let said = &row.captions[0];
    assert!((said.from_s - 29.0 / 30.0).abs() < 1e-5, "{said:?}");
    assert!((said.to_s - 89.0 / 30.0).abs() < 1e-5, "{said:?}");
    // The clip has as many frames as one of a file without that frame.
    dir.put("source/captured.bvh", bvh(&poses[1..]));
    dir.ingest("@source --out @plain", 0);
    assert_eq!(first(&dir, "plain").n_frames, row.n_frames);
    // With `--teleports keep`, the frame stays.
    dir.put("source/captured.bvh", bvh(&poses));
    dir.ingest("@source --out @kept --teleports keep", 0);
    assert_eq!(first(&dir, "kept").start_frame, 0);
}

#[test]
fn a_trimmed_clip_says_where_it_starts_and_its_captions_move_along() {
    let dir = Folder::empty();
    let mut poses = walk(300, 30.0);
    for pose in &mut poses[90..] {
        pose.transl.x += 4.0;
    }
    dir.put("source/jumps.bvh", bvh(&poses));
    dir.put(
        "source/jumps.stance.json",
        r#"{"captions": [
            {"text": "a person walks", "tokens": "", "from_s": 0, "to_s": 0},
            {"text": "first steps", "tokens": "", "from_s": 0.5, "to_s": 2},
            {"text": "through the jump", "tokens": "", "from_s": 2, "to_s": 5},
            {"text": "last steps", "tokens": "", "from_s": 8, "to_s": 10}
        ]}"#,
    );
    dir.ingest("@source --out @dataset --teleports trim", 0);
    let row = first(&dir, "dataset");
    // At 20 fps, stored frame 60 is source frame 90, and the frame before it lies between 88 and 89.
    assert_eq!((row.start_frame, row.end_frame), (90, 300));
    assert_eq!(row.n_frames, 140);
    let notes = row.notes.join("\n");
    assert_has(&notes, &["source frames 90 to 300", "first steps"]);
    let captions = row.captions.iter();
    let said = captions.map(|said| (said.text.as_str(), said.from_s, said.to_s));
    let expected = [
        ("a person walks", 0.0, 0.0),
        ("through the jump", 0.0, 2.0),
        ("last steps", 5.0, 7.0),
    ];
    assert_eq!(said.collect::<Vec<_>>(), expected);
}

#[test]
fn a_row_too_many_or_too_few_is_read_where_that_is_asked_for() {
    let dir = Folder::empty();
    let text = bvh(&walk(60, 30.0));
    for (name, frames) in [("many", 59), ("few", 61), ("good", 60)] {
        let text = text.replace("Frames: 60", &format!("Frames: {frames}"));
        dir.put(&format!("source/{name}.bvh"), text);
    }
    let strict = dir.ingest("@source --out @dataset", 3);
    assert_eq!(strict["ingested"], 1);
    assert_eq!(strict["codes"], json!({"E-BVH-FRAMES": 2}));
    // A run with other settings is refused.
    let lenient = "@source --lenient --fps native --out";
    dir.typed(&format!("ingest {lenient} @dataset"))
        .expect_code(1);
    dir.ingest(&format!("{lenient} @lenient"), 0);
    let rows = motions_of(&dir.path("lenient"));
    assert_eq!(rows.len(), 3);
    for (id, frames, is_flagged) in [("few", 60, true), ("good", 60, false), ("many", 59, true)] {
        assert_eq!(rows[id].n_frames, frames, "{id}");
        let flags = flag_names(rows[id].quality.flags);
        assert_eq!(flags.contains(&"row-count"), is_flagged, "{id}: {flags:?}");
    }
    // A broken row is refused even with `--lenient`.
    let last = text.trim_end().rfind(' ').expect("several numbers");
    dir.put("source/few.bvh", &text[..last]);
    dir.ingest("@source --out @broken --lenient", 3);
}

#[test]
fn humanml3d_features_come_out_as_they_went_in() {
    let dir = Folder::of_dataset(4);
    let export = |dataset: &str, to: &str| {
        dir.run(&format!("export @{dataset} --to humanml3d --out @{to}"));
        files_below(&dir.path(to).join("new_joint_vecs"))
    };
    let published = export("dataset", "HumanML3D");
    dir.ingest("@HumanML3D --out @read --features humanml3d", 0);
    let rows: Vec<HumanMl3dRow> = dir.rows("read");
    let frames = motions_of(&dir.path("read"));
    assert_eq!((rows.len(), frames.len()), (4, 4));
    for row in &rows {
        let name = format!("{}.npy", row.id);
        let numbers = pickle::npy::read_numbers(&name, &published[&name]);
        let own = row.features.as_flattened().iter();
        let own = own.map(|number| f64::from(*number));
        assert!(own.eq(numbers.expect("an array").values), "{name}");
        assert_eq!(frames[row.id.as_str()].n_frames, row.n_frames);
    }
    assert!(export("read", "again") == published);
}
