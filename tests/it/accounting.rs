//! Every file is accounted for: lists of clips, rejections and skips, failures as JSON, names, folders
//! that cannot be read, archives, and clips that are read in part.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use clip::check::flag_names;
use datasets_spec::record::{HumanMl3dRow, MotionRow};
use datasets_spec::{Fps, Motion, Pose, Skeleton};
use glam::{DQuat, DVec3};
use serde::Deserialize;

use crate::util::{
    arg, assert_counted, assert_has, corpus, files_with_extension, put, rows_of, stance, typed,
    typed_with,
};

/// The JSON of a failure; the fields that scripts rely on.
#[derive(Debug, Deserialize)]
struct Failure {
    code: String,
    item: Option<String>,
    reason: String,
}

#[derive(Debug, Deserialize)]
struct Done {
    sources: u64,
    ingested: u64,
    quarantined: u64,
    skipped: u64,
    codes: BTreeMap<String, u64>,
    skipped_reasons: BTreeMap<String, u64>,
}

fn ingest(source: &Path, out: &Path, more: &[&str], code: i32) -> Done {
    let ran = typed_with("--json ingest {} --out {}", &[&source, &out], more);
    let ran = ran.expect_code(code);
    assert_counted(&ran.json());
    ran.json()
}

/// A person who walks along x at half a metre per second, swinging arms and legs.
fn walk(frames: usize) -> Vec<Pose> {
    (0..frames)
        .map(|frame| {
            let sin = (0.2 * frame as f64).sin();
            let mut pose = Pose {
                transl: DVec3::new(0.5 * frame as f64 / 30.0, 0.9, 0.0),
                ..Pose::REST
            };
            for (joint, bend) in [(1, 0.3), (2, -0.3), (16, -0.4), (17, 0.4)] {
                pose.rotations[joint] = DQuat::from_rotation_x(bend * sin);
            }
            for (joint, down) in [(16, -1.0), (17, 1.0)] {
                pose.rotations[joint] *= DQuat::from_rotation_z(down);
            }
            for joint in [3, 6, 9, 12, 15] {
                pose.rotations[joint] = DQuat::from_rotation_y(0.02 * sin + 0.01);
            }
            pose
        })
        .collect()
}

/// The poses as a BVH file at 30 fps.
fn bvh(poses: &[Pose]) -> String {
    let fps = Fps::new(30.0).expect("valid");
    let motion = Motion::from_poses(fps, poses).expect("finite");
    formats::write::bvh::encode(&motion, &Skeleton::smplx_neutral())
}

#[test]
fn a_dataset_lists_its_clips_and_the_files_it_left_out() {
    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Clip {
        id: String,
        split: String,
        path: String,
        flags: Vec<String>,
    }
    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Rejection {
        path: String,
        code: String,
        reason: String,
        byte_offset: Option<u64>,
    }
    let dir = tempfile::tempdir().expect("a temporary folder");
    let (source, out) = (dir.path().join("source"), dir.path().join("dataset"));
    put(source.join("walk.bvh"), bvh(&walk(60)));
    put(source.join("broken.bvh"), "HIERARCHY\nROOT");
    put(source.join("notes.md"), "no motion");
    ingest(&source, &out, &[], 3);
    let list = |kind| ["inspect", arg(&out), "--list", kind].map(str::to_owned);
    let json = |kind| {
        let list = list(kind);
        let mut args = vec!["--json"];
        args.extend(list.iter().map(String::as_str));
        stance(&args).expect_code(0)
    };
    let text = |kind| {
        let list = list(kind);
        let args: Vec<&str> = list.iter().map(String::as_str).collect();
        stance(&args).printed()
    };

    let clips: Vec<Clip> = json("clips").json();
    let row = &rows_of::<MotionRow>(&out)[0];
    assert_eq!(clips.len(), 1);
    assert_eq!(
        (clips[0].id.as_str(), clips[0].path.as_str()),
        ("walk", "walk.bvh")
    );
    assert_eq!(clips[0].split, row.split.as_str());
    assert_eq!(clips[0].flags, flag_names(row.quality.flags));
    assert!(clips[0].flags.contains(&"no-caption".to_owned()));
    assert!(text("clips").starts_with("walk "), "{}", text("clips"));

    let rejections: Vec<Rejection> = json("quarantine").json();
    assert_eq!(rejections.len(), 1, "{rejections:?}");
    let rejection = &rejections[0];
    assert_eq!(
        (rejection.path.as_str(), rejection.code.as_str()),
        ("broken.bvh", "E-BVH-SYNTAX")
    );
    assert!(!rejection.reason.is_empty());
    let offset = rejection.byte_offset.expect("a place in the file");
    let line = text("quarantine");
    assert_has(
        &line,
        &[
            "broken.bvh",
            "E-BVH-SYNTAX",
            &format!("byte {offset}"),
            &rejection.reason,
        ],
    );
    let _skipped: Vec<serde_json::Value> = json("skipped").json();
    stance(&["inspect", arg(&out), "--list", "clips", "--clip", "walk"]).expect_code(2);
}

#[test]
fn inspect_of_a_rejected_file_exits_with_3_and_names_the_reason() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let broken = dir.path().join("broken.bvh");
    let rows = bvh(&walk(20)).replace("Frames: 20", "Frames: 21");
    put(&broken, rows);
    let text = stance(&["inspect", arg(&broken)]).expect_code(3).stdout;
    assert!(text.contains("E-BVH-FRAMES found 20 rows"), "{text}");
    let failure: Failure = stance(&["--json", "inspect", arg(&broken)])
        .expect_code(3)
        .json();
    assert_eq!(failure.code, "E-BVH-FRAMES");
    assert_eq!(failure.item.as_deref(), Some(arg(&broken)));
    assert!(failure.reason.contains("found 20 rows"), "{failure:?}");
    // The checks refuse this motion, not the reader.
    let short = dir.path().join("short.bvh");
    put(&short, bvh(&walk(1)));
    let failure: Failure = stance(&["--json", "inspect", arg(&short)])
        .expect_code(3)
        .json();
    assert_eq!(failure.code, "E-TOO-SHORT");
    let good = dir.path().join("good.bvh");
    put(&good, bvh(&walk(20)));
    let good: serde_json::Value = stance(&["--json", "inspect", arg(&good)]).done();
    assert_eq!(good.get("code"), None);
}

#[test]
fn a_failure_is_json_too_where_json_is_asked_for() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let missing = dir.path().join("missing");
    let missing = arg(&missing);
    let broken = dir.path().join("broken.bvh");
    put(&broken, "HIERARCHY");
    let out = dir.path().join("out");
    let picture = dir.path().join("x.png");
    for (args, exit, code, item) in [
        (
            &["ingest", missing, "--out", arg(&out)][..],
            1,
            "E-MISSING",
            Some(missing),
        ),
        (&["inspect", missing], 1, "E-IO", Some(missing)),
        (&["stats", missing], 1, "E-DATASET", Some(missing)),
        (
            &["inspect", arg(dir.path())],
            1,
            "E-DATASET",
            Some(arg(dir.path())),
        ),
        (
            &["render", arg(&broken), "--out", arg(&picture)],
            1,
            "E-BVH-SYNTAX",
            Some(arg(&broken)),
        ),
        (&["ingest", missing], 2, "E-USAGE", None),
        (&["no-such-verb"], 2, "E-USAGE", None),
    ] {
        let ran = stance(&[&["--json"], args].concat()).expect_code(exit);
        let failure: Failure = ran.json();
        assert_eq!(
            (failure.code.as_str(), failure.item.as_deref()),
            (code, item),
            "{args:?}"
        );
        // The recorded reason equals the message on stderr.
        assert!(
            ran.stderr
                .contains(failure.reason.lines().next().expect("a reason"))
        );
        assert!(stance(args).expect_code(exit).stdout.is_empty(), "{args:?}");
    }
    let help = stance(&["--help"]).printed();
    assert_has(&help, &["code", "item", "reason"]);
    let lock = datasets_spec::dataset::Transaction::begin(&out, "the other run").expect("locks");
    put(dir.path().join("walk.bvh"), bvh(&walk(20)));
    let failure: Failure = stance(&["--json", "ingest", arg(dir.path()), "--out", arg(&out)])
        .expect_code(75)
        .json();
    assert_eq!(failure.code, "E-LOCKED");
    drop(lock);
}

#[cfg(unix)]
#[test]
fn names_that_are_not_text_stay_apart_and_never_reach_the_terminal() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;

    let dir = tempfile::tempdir().expect("a temporary folder");
    let (source, out) = (dir.path().join("source"), dir.path().join("dataset"));
    fs::create_dir(&source).expect("a folder");
    let path = |name: &[u8]| source.join(OsStr::from_bytes(name));
    let label =
        r#"{"captions": [{"text": "a person walks", "tokens": "", "from_s": 0, "to_s": 0}]}"#;
    for name in [&b"a\xff"[..], b"a\xfe", br"a\xff", b"red\x1b[31m"] {
        put(path(&[name, b".bvh"].concat()), bvh(&walk(30)));
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
fn a_folder_that_cannot_be_listed_does_not_end_the_run() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let (source, out) = (dir.path().join("source"), dir.path().join("dataset"));
    put(source.join("walk.bvh"), bvh(&walk(30)));
    // These paths are longer than the system allows: not even an administrator can list the innermost folders.
    let script = r#"cd "$0" && for i in $(seq 20); do mkdir $1 && cd $1 || exit 1; done"#;
    let made = std::process::Command::new("bash")
        .args(["-c", script, arg(&source), &"d".repeat(250)])
        .status()
        .expect("bash starts");
    assert!(made.success());
    let done = ingest(&source, &out, &[], 3);
    assert_eq!((done.ingested, done.quarantined), (1, 1), "{done:?}");
    assert_eq!(done.codes["E-IO"], 1);
    let list = stance(&["inspect", arg(&out), "--list", "quarantine"]).expect_code(0);
    list.expect_printed("cannot list the folder");
    let again = stance(&["ingest", arg(&source), "--out", arg(&out)]).expect_code(3);
    again.expect_printed("already complete");
    let doctor = stance(&["doctor", arg(&source)]).printed();
    assert!(doctor.contains("cannot be listed"), "{doctor}");
}

#[cfg(unix)]
#[test]
fn a_folder_of_links_says_so() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let (source, real) = (dir.path().join("source"), dir.path().join("real"));
    fs::create_dir(&source).expect("a folder");
    put(real.join("walk.bvh"), bvh(&walk(30)));
    for name in ["one", "two"] {
        std::os::unix::fs::symlink(&real, source.join(name)).expect("links");
    }
    let out = dir.path().join("dataset");
    stance(&["ingest", arg(&source), "--out", arg(&out)])
        .expect_refused("all 2 entries are skipped: link to a folder")
        .expect_said("name the folder it leads to");
}

#[test]
fn archives_are_named_and_a_dataset_without_motions_is_a_failure() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let (source, out) = (dir.path().join("source"), dir.path().join("dataset"));
    for name in [
        "walks.zip",
        "walks.tar",
        "walks.tar.gz",
        "walk.bvh.gz",
        "walks.7z",
    ] {
        put(source.join(name), "an archive");
    }
    for _ in 0..2 {
        let done = ingest(&source, &out, &[], 1);
        assert_eq!((done.sources, done.skipped), (5, 2));
        assert_eq!(done.codes["E-ARCHIVE-DAMAGED"], 3);
        if !done.skipped_reasons.is_empty() {
            for kind in ["gz", "7z"] {
                let reason = format!("{kind} archive; unpack it");
                assert_eq!(done.skipped_reasons.get(&reason), Some(&1), "{done:?}");
            }
        }
        let failure: Failure = stance(&["--json", "ingest", arg(&source), "--out", arg(&out)])
            .expect_code(1)
            .json();
        assert_eq!(failure.code, "E-NO-MOTION");
        assert_eq!(failure.item.as_deref(), Some(arg(&out)));
    }
    stance(&["ingest", arg(&source), "--out", arg(&out)])
        .expect_refused("the dataset has no motion");
    // With one more motion, the run commits a dataset.
    put(source.join("walk.bvh"), bvh(&walk(30)));
    ingest(&source, &dir.path().join("other"), &[], 3);
}

#[test]
fn a_reference_frame_before_the_motion_is_dropped_with_a_flag() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let (source, out) = (dir.path().join("source"), dir.path().join("dataset"));
    let mut poses = walk(1300);
    // A T-pose three metres away, whose rotations are not exactly zero.
    poses[0].transl.x -= 3.0;
    poses[0].rotations = [DQuat::from_rotation_y(1e-4); 22];
    put(source.join("captured.bvh"), bvh(&poses));
    put(
        source.join("captured.stance.json"),
        r#"{"captions": [{"text": "a person walks", "tokens": "", "from_s": 1, "to_s": 3}]}"#,
    );
    ingest(&source, &out, &[], 0);
    let row = &rows_of::<MotionRow>(&out)[0];
    assert_eq!((row.start_frame, row.end_frame), (1, 1300));
    assert_eq!(row.n_frames, 1 + (1298 * 2) / 3);
    let flags = flag_names(row.quality.flags);
    assert!(flags.contains(&"reference-dropped"), "{flags:?}");
    assert!(!flags.contains(&"teleport"), "{flags:?}");
    assert!(
        row.notes.iter().any(|note| note.contains("source frame 0")),
        "{:?}",
        row.notes
    );
    // The captions start a thirtieth of a second earlier.
    let said = &row.captions[0];
    assert!((said.from_s - 29.0 / 30.0).abs() < 1e-5, "{said:?}");
    assert!((said.to_s - 89.0 / 30.0).abs() < 1e-5, "{said:?}");
    // The rest is what the file without the frame gives.
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
    let dir = tempfile::tempdir().expect("a temporary folder");
    let (source, out) = (dir.path().join("source"), dir.path().join("dataset"));
    let mut poses = walk(300);
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
    assert!(
        row.notes
            .iter()
            .any(|note| note.contains("source frames 90 to 300")),
        "{:?}",
        row.notes
    );
    let said: Vec<(&str, f32, f32)> = row
        .captions
        .iter()
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
    assert!(
        row.notes.iter().any(|note| note.contains("first steps")),
        "{:?}",
        row.notes
    );
}

#[test]
fn a_row_too_many_or_too_few_is_read_where_that_is_asked_for() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let (source, out) = (dir.path().join("source"), dir.path().join("dataset"));
    let text = bvh(&walk(60));
    put(
        source.join("many.bvh"),
        text.replace("Frames: 60", "Frames: 59"),
    );
    put(
        source.join("few.bvh"),
        text.replace("Frames: 60", "Frames: 61"),
    );
    put(source.join("good.bvh"), &text);
    let strict = ingest(&source, &out, &[], 3);
    assert_eq!((strict.ingested, strict.codes["E-BVH-FRAMES"]), (1, 2));
    // A run with other settings is refused.
    typed(
        "ingest {} --out {} --lenient --fps native",
        &[&source, &out],
    )
    .expect_code(1);
    let lenient = dir.path().join("lenient");
    ingest(&source, &lenient, &["--lenient", "--fps", "native"], 0);
    let found: BTreeMap<String, (i32, bool)> = rows_of::<MotionRow>(&lenient)
        .iter()
        .map(|row| {
            let flagged = flag_names(row.quality.flags).contains(&"row-count");
            (row.id.to_string(), (row.n_frames, flagged))
        })
        .collect();
    let expected = [
        ("few", (60, true)),
        ("good", (60, false)),
        ("many", (59, true)),
    ];
    assert_eq!(
        found,
        expected.map(|(id, found)| (id.to_owned(), found)).into()
    );
    // A broken row is refused even with `--lenient`.
    let last = text.trim_end().rfind(' ').expect("several numbers");
    put(source.join("few.bvh"), &text[..last]);
    let broken = dir.path().join("broken");
    ingest(&source, &broken, &["--lenient"], 3);
}

/// The numbers of a little-endian f32 npy file.
fn npy(path: &Path) -> Vec<f32> {
    let bytes = fs::read(path).expect("an array");
    let header = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let (numbers, _) = bytes[10 + header..].as_chunks::<4>();
    numbers
        .iter()
        .map(|number| f32::from_le_bytes(*number))
        .collect()
}

#[test]
fn humanml3d_features_come_out_as_they_went_in() {
    let dir = corpus(4);
    let made = dir.path().join("made");
    ingest(&dir.path().join("corpus"), &made, &[], 0);
    let folder = dir.path().join("HumanML3D");
    let export = |dataset: &Path, folder: &Path| {
        typed("export {} --to humanml3d --out {}", &[&dataset, &folder]).expect_code(0)
    };
    export(&made, &folder);
    let out = dir.path().join("dataset");
    ingest(&folder, &out, &["--features", "humanml3d"], 0);
    let rows: Vec<HumanMl3dRow> = rows_of(&out);
    let frames: BTreeMap<String, i32> = rows_of::<MotionRow>(&out)
        .iter()
        .map(|row| (row.id.to_string(), row.n_frames))
        .collect();
    assert_eq!((rows.len(), frames.len()), (4, 4));
    for row in &rows {
        let published = npy(&folder.join(format!("new_joint_vecs/{}.npy", row.id)));
        assert!(row.features.as_flattened() == published, "{}", row.id);
        assert_eq!(frames[row.id.as_str()], row.n_frames);
    }
    let again = dir.path().join("again");
    export(&out, &again);
    for path in files_with_extension(&folder.join("new_joint_vecs"), "npy") {
        let name = path.file_name().expect("a name");
        assert!(
            npy(&path) == npy(&again.join("new_joint_vecs").join(name)),
            "{name:?}"
        );
    }
}
