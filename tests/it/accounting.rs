//! Every file is accounted for: lists of clips, rejections and skips, failures as JSON, names, folders
//! that cannot be read, archives, and clips that are read in part.

use std::fs;
use std::path::PathBuf;

use clip::check::flag_names;
use datasets_spec::dataset::Transaction;
use datasets_spec::record::{HumanMl3dRow, MotionRow};
use datasets_spec::{Fps, Motion, Pose, Skeleton};
use glam::DQuat;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::archives::{Files, files_below, packed};
use crate::formats::walk;
use crate::util::{
    arg, assert_has, assert_quarantined, corpus, ingest, motions_of, put, rows_of, stance, typed,
    typed_with,
};

/// The JSON of a failure, with the fields that scripts rely on.
#[derive(Debug, Deserialize)]
struct Failure {
    code: String,
    item: Option<String>,
    reason: String,
}

/// A temporary folder, a source in it, and the place of a dataset.
fn place() -> (tempfile::TempDir, PathBuf, PathBuf) {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let [source, out] = ["source", "dataset"].map(|name| dir.path().join(name));
    (dir, source, out)
}

/// Runs a command with `--json` that ends with this code, and returns its failure.
fn failed(args: &[&str], code: i32) -> Failure {
    stance(&[&["--json"], args].concat())
        .expect_code(code)
        .json()
}

/// The poses as a BVH file at 30 fps.
fn bvh(poses: &[Pose]) -> String {
    let fps = Fps::new(30.0).expect("valid");
    let motion = Motion::from_poses(fps, poses).expect("finite");
    formats::write::bvh::encode(&motion, &Skeleton::smplx_neutral())
}

#[test]
fn a_dataset_lists_its_clips_and_the_files_it_left_out() {
    let (_dir, source, out) = place();
    put(source.join("walk.bvh"), bvh(&walk(60, 30.0)));
    put(source.join("broken.bvh"), "HIERARCHY\nROOT");
    put(source.join("notes.md"), "no motion");
    ingest(&source, &out, &[], 3);
    let list = |kind: &str| typed("--json inspect {} --list {}", &[&out, &kind]).done::<Value>();
    let text = |kind: &str| typed("inspect {} --list {}", &[&out, &kind]).printed();
    let row = &rows_of::<MotionRow>(&out)[0];
    let flags = flag_names(row.quality.flags);
    assert!(flags.contains(&"no-caption"), "{flags:?}");
    let clip =
        json!({"id": "walk", "split": row.split.as_str(), "path": "walk.bvh", "flags": flags});
    assert_eq!(list("clips"), json!([clip]));
    assert!(text("clips").starts_with("walk "), "{}", text("clips"));

    let row = &assert_quarantined(&out, &[("broken.bvh", "E-BVH-SYNTAX")])["broken.bvh"];
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
    stance(&["inspect", arg(&out), "--list", "clips", "--clip", "walk"]).expect_code(2);
}

#[test]
fn inspect_of_a_rejected_file_exits_with_3_and_names_the_reason() {
    let (_dir, source, _) = place();
    let [broken, short, good] =
        ["broken.bvh", "short.bvh", "good.bvh"].map(|name| source.join(name));
    put(&good, bvh(&walk(20, 30.0)));
    put(
        &broken,
        bvh(&walk(20, 30.0)).replace("Frames: 20", "Frames: 21"),
    );
    let ran = stance(&["inspect", arg(&broken)]).expect_code(3);
    ran.expect_printed("E-BVH-FRAMES found 20 rows");
    let failure = failed(&["inspect", arg(&broken)], 3);
    assert_eq!(failure.code, "E-BVH-FRAMES");
    assert_eq!(failure.item.as_deref(), Some(arg(&broken)));
    assert_has(&failure.reason, &["found 20 rows"]);
    // The checks refuse this motion, not the reader.
    put(&short, bvh(&walk(1, 30.0)));
    assert_eq!(failed(&["inspect", arg(&short)], 3).code, "E-TOO-SHORT");
    let said: Value = stance(&["--json", "inspect", arg(&good)]).done();
    assert_eq!(said.get("code"), None);

    // An archive is refused with the ways to look into it, of which one is to name a member.
    let files = Files::from([("a/good.bvh".to_owned(), fs::read(&good).expect("read"))]);
    for name in ["some.zip", "some.tar", "some.tar.gz"] {
        let path = source.join(name);
        put(&path, packed(name, &files));
        assert_eq!(failed(&["inspect", arg(&path)], 1).code, "E-NO-MOTION");
        let ran = stance(&["inspect", arg(&path)]).expect_code(1);
        ran.expect_said(&format!("stance doctor {}", path.display()));
        ran.expect_said(&format!("stance inspect {}/MEMBER", path.display()));
        let member: Value = stance(&["--json", "inspect", arg(&path.join("a/good.bvh"))]).done();
        assert_eq!(member, said);
    }
    for more in [["--list", "clips"], ["--clip", "walk"]] {
        let failure = failed(&[&["inspect", arg(&good)][..], &more].concat(), 1);
        assert_eq!(failure.code, "E-DATASET");
        assert_has(&failure.reason, &["need the folder of a dataset"]);
    }
}

#[test]
fn a_failure_is_json_too_where_json_is_asked_for() {
    let (dir, source, out) = place();
    let names = ["missing", "empty", "broken.bvh", "x.png"];
    let paths = names.map(|name| dir.path().join(name));
    let [missing, empty, broken, picture] = paths.each_ref().map(|path| arg(path));
    fs::create_dir(empty).expect("a folder");
    put(broken, "HIERARCHY");
    let (folder, to) = (arg(dir.path()), arg(&out));
    let nowhere: &[&str] = &["ingest", missing, "--out", to];
    let nothing: &[&str] = &["ingest", empty, "--out", to];
    let unread: &[&str] = &["render", broken, "--out", picture];
    for (args, exit, code, item) in [
        (nowhere, 1, "E-MISSING", Some(missing)),
        (nothing, 1, "E-NO-FILES", Some(empty)),
        (&["inspect", missing], 1, "E-IO", Some(missing)),
        (&["stats", missing], 1, "E-DATASET", Some(missing)),
        (&["inspect", folder], 1, "E-DATASET", Some(folder)),
        (unread, 1, "E-BVH-SYNTAX", Some(broken)),
        (&["ingest", missing], 2, "E-USAGE", None),
        (&["no-such-verb"], 2, "E-USAGE", None),
    ] {
        let ran = stance(&[&["--json"], args].concat()).expect_code(exit);
        let failure: Failure = ran.json();
        assert_eq!(failure.code, code, "{args:?}");
        assert_eq!(failure.item.as_deref(), item, "{args:?}");
        // The recorded reason equals the message on stderr.
        ran.expect_said(failure.reason.lines().next().expect("a reason"));
        assert!(stance(args).expect_code(exit).stdout.is_empty(), "{args:?}");
    }
    stance(nowhere).expect_refused("no such file or folder");
    stance(nothing).expect_refused("no files under");
    assert!(!out.exists(), "a refused run leaves nothing");
    let help = stance(&["--help"]).printed();
    assert_has(&help, &["code", "item", "reason"]);
    // A dataset that another run holds is left alone.
    let lock = Transaction::begin(&out, "the other run").expect("locks");
    put(source.join("walk.bvh"), bvh(&walk(20, 30.0)));
    let ran = typed("--json ingest {} --out {}", &[&source, &out]).expect_code(75);
    assert_eq!(ran.json::<Failure>().code, "E-LOCKED");
    ran.expect_said("the other run");
    drop(lock);
    ingest(&source, &out, &[], 0);
}

#[cfg(unix)]
#[test]
fn names_that_are_not_text_stay_apart_and_never_reach_the_terminal() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;

    let (dir, source, out) = place();
    let path = |name: &[u8]| source.join(OsStr::from_bytes(name));
    let label =
        r#"{"captions": [{"text": "a person walks", "tokens": "", "from_s": 0, "to_s": 0}]}"#;
    for name in [&b"a\xff"[..], b"a\xfe", br"a\xff", b"red\x1b[31m"] {
        put(path(&[name, b".bvh"].concat()), bvh(&walk(30, 30.0)));
        put(path(&[name, b".stance.json"].concat()), label);
    }
    put(path(b"\x1b]0;title\x07.bvh"), "HIERARCHY");
    put(path(b"\xc2\x9b31m.md"), "no motion");
    let ran = stance(&["ingest", arg(&source), "--out", arg(&out)]).expect_code(3);
    let listed = stance(&["inspect", arg(&out), "--list", "quarantine"]).expect_code(0);
    let broken = path(b"\x1b]0;title\x07.bvh");
    let one = stance(&["inspect", arg(&broken)]).expect_code(3);
    let none = stance(&["inspect", arg(&path(b"\x1b[31mnone"))]).expect_code(1);
    for text in [&ran, &listed, &one, &none].map(|ran| format!("{}{}", ran.stdout, ran.stderr)) {
        let obeyed = |c: char| c.is_control() && c != '\n' && c != '\t';
        assert!(!text.contains(obeyed), "{text:?}");
    }
    listed.expect_printed(r"\x1b]0;title\x07.bvh");
    let rows = rows_of::<MotionRow>(&out);
    let mut ids: Vec<&str> = rows.iter().map(|row| row.id.as_str()).collect();
    ids.sort_unstable();
    assert_eq!(ids, [r"a\\xff", r"a\xfe", r"a\xff", r"red\x1b[31m"]);
    // Labels beside each file are found under the file's true name.
    assert!(rows.iter().all(|row| row.captions.len() == 1), "{rows:?}");
    let out = dir.path().join(OsStr::from_bytes(b"out\xff"));
    for more in [Vec::new(), vec!["--json"]] {
        typed_with("ingest {} --out {} --dry-run", &[&source, &out], &more).expect_code(0);
    }
}

#[cfg(unix)]
#[test]
fn a_folder_that_cannot_be_listed_does_not_end_the_run_and_one_of_links_says_so() {
    let (dir, source, out) = place();
    put(source.join("walk.bvh"), bvh(&walk(30, 30.0)));
    // These paths are longer than the system allows: not even an administrator can list the innermost folders.
    let script = r#"cd "$0" && for i in $(seq 20); do mkdir $1 && cd $1 || exit 1; done"#;
    let made = std::process::Command::new("bash")
        .args(["-c", script, arg(&source), &"d".repeat(250)])
        .status()
        .expect("bash starts");
    assert!(made.success());
    let done = ingest(&source, &out, &[], 3);
    assert_eq!(done["ingested"], 1, "{done}");
    assert_eq!(done["codes"], json!({"E-IO": 1}));
    let list = stance(&["inspect", arg(&out), "--list", "quarantine"]).expect_code(0);
    list.expect_printed("cannot list the folder");
    let again = stance(&["ingest", arg(&source), "--out", arg(&out)]).expect_code(3);
    again.expect_printed("already complete");
    let doctor = stance(&["doctor", arg(&source)]).expect_code(0);
    doctor.expect_printed("cannot be listed");
    // A folder of links alone says so.
    let links = dir.path().join("links");
    fs::create_dir(&links).expect("a folder");
    for name in ["one", "two"] {
        std::os::unix::fs::symlink(&source, links.join(name)).expect("links");
    }
    let other = dir.path().join("other");
    stance(&["ingest", arg(&links), "--out", arg(&other)])
        .expect_refused("all 2 entries are skipped: link to a folder")
        .expect_said("name the folder it leads to");
}

#[test]
fn archives_are_named_and_a_dataset_without_motions_is_a_failure() {
    let (dir, source, out) = place();
    for name in ["s.zip", "s.tar", "s.tar.gz", ".bvh.gz", "s.7z"] {
        put(source.join(format!("walk{name}")), "an archive");
    }
    for _ in 0..2 {
        let done = ingest(&source, &out, &[], 1);
        assert_eq!((&done["sources"], &done["skipped"]), (&json!(5), &json!(2)));
        assert_eq!(done["codes"]["E-ARCHIVE-DAMAGED"], 3);
        let reasons = done["skipped_reasons"].as_object().expect("a map");
        if !reasons.is_empty() {
            for kind in ["gz", "7z"] {
                assert_eq!(reasons[&format!("{kind} archive; unpack it")], 1, "{done}");
            }
        }
        let failure = failed(&["ingest", arg(&source), "--out", arg(&out)], 1);
        assert_eq!(failure.code, "E-NO-MOTION");
        assert_eq!(failure.item.as_deref(), Some(arg(&out)));
        assert_has(&failure.reason, &["the dataset has no motion"]);
    }
    // With one motion among the files, the run succeeds apart from the quarantine.
    put(source.join("walk.bvh"), bvh(&walk(30, 30.0)));
    ingest(&source, &dir.path().join("other"), &[], 3);
}

#[test]
fn a_reference_frame_before_the_motion_is_dropped_with_a_flag() {
    let (dir, source, out) = place();
    let mut poses = walk(1300, 30.0);
    // A T-pose three metres away, whose rotations are not exactly zero.
    poses[0].transl.x -= 3.0;
    poses[0].rotations = [DQuat::from_rotation_y(1e-4); 22];
    put(source.join("captured.bvh"), bvh(&poses));
    let label =
        r#"{"captions": [{"text": "a person walks", "tokens": "", "from_s": 1, "to_s": 3}]}"#;
    put(source.join("captured.stance.json"), label);
    ingest(&source, &out, &[], 0);
    let row = &rows_of::<MotionRow>(&out)[0];
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
    put(source.join("captured.bvh"), bvh(&poses[1..]));
    let plain = dir.path().join("plain");
    ingest(&source, &plain, &[], 0);
    assert_eq!(rows_of::<MotionRow>(&plain)[0].n_frames, row.n_frames);
    // With `--teleports keep`, the frame stays.
    put(source.join("captured.bvh"), bvh(&poses));
    let kept = dir.path().join("kept");
    ingest(&source, &kept, &["--teleports", "keep"], 0);
    assert_eq!(rows_of::<MotionRow>(&kept)[0].start_frame, 0);
}

#[test]
fn a_trimmed_clip_says_where_it_starts_and_its_captions_move_along() {
    let (_dir, source, out) = place();
    let mut poses = walk(300, 30.0);
    for pose in &mut poses[90..] {
        pose.transl.x += 4.0;
    }
    put(source.join("jumps.bvh"), bvh(&poses));
    put(
        source.join("jumps.stance.json"),
        r#"{"captions": [
            {"text": "a person walks", "tokens": "", "from_s": 0, "to_s": 0},
            {"text": "first steps", "tokens": "", "from_s": 0.5, "to_s": 2},
            {"text": "through the jump", "tokens": "", "from_s": 2, "to_s": 5},
            {"text": "last steps", "tokens": "", "from_s": 8, "to_s": 10}
        ]}"#,
    );
    ingest(&source, &out, &["--teleports", "trim"], 0);
    let row = &rows_of::<MotionRow>(&out)[0];
    // At 20 fps, stored frame 60 is source frame 90, and the frame before it lies between 88 and 89.
    assert_eq!((row.start_frame, row.end_frame), (90, 300));
    assert_eq!(row.n_frames, 140);
    let notes = row.notes.join("\n");
    assert_has(&notes, &["source frames 90 to 300", "first steps"]);
    let captions = row.captions.iter();
    let said: Vec<(&str, f32, f32)> = captions
        .map(|said| (said.text.as_str(), said.from_s, said.to_s))
        .collect();
    assert_eq!(
        said,
        [
            ("a person walks", 0.0, 0.0),
            ("through the jump", 0.0, 2.0),
            ("last steps", 5.0, 7.0)
        ]
    );
}

#[test]
fn a_row_too_many_or_too_few_is_read_where_that_is_asked_for() {
    let (dir, source, out) = place();
    let text = bvh(&walk(60, 30.0));
    for (name, frames) in [("many", 59), ("few", 61), ("good", 60)] {
        let text = text.replace("Frames: 60", &format!("Frames: {frames}"));
        put(source.join(name).with_extension("bvh"), text);
    }
    let strict = ingest(&source, &out, &[], 3);
    assert_eq!(strict["ingested"], 1);
    assert_eq!(strict["codes"], json!({"E-BVH-FRAMES": 2}));
    // A run with other settings is refused.
    let settings = ["--lenient", "--fps", "native"];
    typed_with("ingest {} --out {}", &[&source, &out], &settings).expect_code(1);
    let lenient = dir.path().join("lenient");
    ingest(&source, &lenient, &settings, 0);
    let rows = motions_of(&lenient);
    assert_eq!(rows.len(), 3);
    for (id, frames, is_flagged) in [("few", 60, true), ("good", 60, false), ("many", 59, true)] {
        assert_eq!(rows[id].n_frames, frames, "{id}");
        let flags = flag_names(rows[id].quality.flags);
        assert_eq!(flags.contains(&"row-count"), is_flagged, "{id}: {flags:?}");
    }
    // A broken row is refused even with `--lenient`.
    let last = text.trim_end().rfind(' ').expect("several numbers");
    put(source.join("few.bvh"), &text[..last]);
    let broken = dir.path().join("broken");
    ingest(&source, &broken, &["--lenient"], 3);
}

/// The numbers of a little-endian f32 npy file.
fn npy(bytes: &[u8]) -> Vec<f32> {
    let header = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let (numbers, _) = bytes[10 + header..].as_chunks::<4>();
    let numbers = numbers.iter().map(|number| f32::from_le_bytes(*number));
    numbers.collect()
}

#[test]
fn humanml3d_features_come_out_as_they_went_in() {
    let dir = corpus(4);
    let at = |name: &str| dir.path().join(name);
    ingest(&at("corpus"), &at("made"), &[], 0);
    let export = |dataset: &str, to: &str| {
        let (dataset, to) = (at(dataset), at(to));
        typed("export {} --to humanml3d --out {}", &[&dataset, &to]).expect_code(0);
        files_below(&to.join("new_joint_vecs"))
    };
    let published = export("made", "HumanML3D");
    let out = at("dataset");
    ingest(&at("HumanML3D"), &out, &["--features", "humanml3d"], 0);
    let rows: Vec<HumanMl3dRow> = rows_of(&out);
    let frames = motions_of(&out);
    assert_eq!((rows.len(), frames.len()), (4, 4));
    for row in &rows {
        let numbers = npy(&published[&format!("{}.npy", row.id)]);
        assert!(row.features.as_flattened() == numbers, "{}", row.id);
        assert_eq!(frames[row.id.as_str()].n_frames, row.n_frames);
    }
    assert!(export("dataset", "again") == published);
}
