//! Formats of other programs through the command: files made here from their documented layouts are ingested,
//! verified and inspected.

use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_array::{ArrayRef, BooleanArray, RecordBatch, StringArray};
use datasets_spec::flags::FLAG_UP_DOUBTFUL;
use datasets_spec::record::{MotionRow, QuarantineRow};
use datasets_spec::{Pose, Skeleton};
use glam::{DQuat, DVec3, EulerRot};
use parquet::arrow::ArrowWriter;
use serde_json::Value;

use crate::util::{
    self, Folder, arg, assert_has, assert_quarantined, assert_tells, len_of, motions_of, rows_of,
    skipped_of, stance,
};

/// Ingests a folder as the dataset `SOURCE-dataset`, compares the numbers of ingested, quarantined and skipped items
/// with those given, verifies the dataset, and returns the document and the dataset.
pub(crate) fn ingested(dir: &Folder, source: &str, more: &str, counts: &[u64]) -> (Value, PathBuf) {
    let is_whole = counts.get(1).is_none_or(|quarantined| *quarantined == 0);
    let line = format!("@{source} --out @{source}-dataset {more}");
    let done = dir.ingest(&line, if is_whole { 0 } else { 3 });
    let codes = done["codes"].as_object().expect("a map").values();
    let by_code = codes.filter_map(Value::as_u64).sum::<u64>();
    assert_eq!(done["quarantined"], by_code, "{done}");
    for (name, count) in ["ingested", "quarantined", "skipped"].iter().zip(counts) {
        assert_eq!(done[name], *count, "{name}: {done}");
    }
    dir.run(&format!("verify @{source}-dataset"));
    (done, dir.path(&format!("{source}-dataset")))
}

/// Writes a list that puts all clips into one split, for sources that show one motion several times. Returns the option
/// that names it.
pub(crate) fn all_in_train(dir: &Folder) -> &'static str {
    dir.put("splits.csv", "clip,split\n*,train\n");
    "--splits @splits.csv"
}

/// Output of `inspect` for a clip.
pub(crate) fn inspected(dataset: &Path, id: &str) -> Value {
    stance(&["--json", "inspect", arg(dataset), "--clip", id]).done()
}

/// A body that swings arms and legs, bends knees and elbows, and moves ahead.
pub(crate) fn walk(num_frames: usize, fps: f64) -> Vec<Pose> {
    let pose = |frame: usize| {
        let secs = frame as f64 / fps;
        let (sin, cos) = (5.0 * secs).sin_cos();
        let mut pose = Pose {
            transl: DVec3::new(0.02 * cos, 1.2, 0.6 * secs),
            ..Pose::REST
        };
        for (joint, [x, y, z]) in [
            (0, [0.05 * cos, 0.1 * sin, 0.0]),
            (9, [0.0, -0.1 * sin, 0.0]),
            (1, [-0.4 * sin, 0.0, 0.0]),
            (2, [0.4 * sin, 0.0, 0.0]),
            (4, [0.5 + 0.3 * cos, 0.0, 0.0]),
            (5, [0.5 - 0.3 * cos, 0.0, 0.0]),
            (16, [0.0, -0.3 * sin, -1.1]),
            (17, [0.0, -0.3 * sin, 1.1]),
            (18, [0.0, -0.6, 0.0]),
            (19, [0.0, 0.6, 0.0]),
        ] {
            pose.rotations[joint] = DQuat::from_euler(EulerRot::ZYX, z, y, x);
        }
        pose
    };
    (0..num_frames).map(pose).collect()
}

/// Joints of a file as (name, parent, joint of the body); the last is none for a joint that does not move in its
/// parent.
type Rig = Vec<(String, String, Option<usize>)>;

/// Adds a chain of joints, each the child of the one before it. A word is NAME, or NAME=JOINT for a joint that moves:
/// `pattern` completes the name, and JOINT plus `right` is the number of the body's joint.
fn chain(rig: &mut Rig, above: &str, pattern: &str, right: usize, words: &str) {
    let mut above = above.to_owned();
    for word in words.split(' ') {
        let (name, joint) = word.split_once('=').unwrap_or((word, ""));
        let name = pattern.replace('*', name);
        let joint = joint.parse::<usize>().ok().map(|joint| joint + right);
        rig.push((name.clone(), above, joint));
        above = name;
    }
}

/// A BVH file of a rig whose zero pose is the rest pose of the body, with this many units per metre. The root and the
/// hips have position channels too.
fn bvh(per_metre: f64, rig: &Rig, poses: &[Pose], frame_time: &str) -> String {
    let skeleton = Skeleton::smplx_neutral();
    let has_position = |name: &str| ["ROOT", "Root", "Hips"].contains(&name);
    // The chains of SOMA, whose first joint is `Root`, end in joints instead of end sites.
    let has_ends = rig[0].0 != "Root";
    let index_of = |name: &str| rig.iter().position(|(joint, ..)| joint == name);
    let place = |index: usize| rig[index].2.map(|joint| skeleton.rest(joint));
    // Rest position of a joint, or of the nearest joint above it that has one.
    let nearest = |mut index: usize| loop {
        match (place(index), index_of(&rig[index].1)) {
            (Some(place), _) => return place,
            (None, Some(parent)) => index = parent,
            (None, None) => return DVec3::ZERO,
        }
    };
    let mut text = "HIERARCHY\n".to_owned();
    let mut open: Vec<&str> = Vec::new();
    for (index, (name, parent, _)) in rig.iter().enumerate() {
        while open.last().is_some_and(|last| last != parent) {
            open.pop();
            text.push_str("}\n");
        }
        let above = index_of(parent).map(nearest);
        let offset = above.map_or(DVec3::ZERO, |above| (nearest(index) - above) * per_metre);
        let keyword = if parent.is_empty() { "ROOT" } else { "JOINT" };
        let channels = match has_position(name) {
            true => "6 Xposition Yposition Zposition",
            false => "3",
        };
        let _ = writeln!(
            text,
            "{keyword} {name}\n{{\nOFFSET {:.6} {:.6} {:.6}\nCHANNELS {channels} Zrotation Yrotation Xrotation",
            offset.x, offset.y, offset.z
        );
        let is_leaf = !rig.iter().any(|(_, above, _)| above == name);
        if is_leaf && has_ends {
            text.push_str("End Site\n{\nOFFSET 0 0 0\n}\n");
        }
        open.push(name);
    }
    text.push_str(&"}\n".repeat(open.len()));
    let count = poses.len();
    let _ = writeln!(text, "MOTION\nFrames: {count}\nFrame Time: {frame_time}");
    for pose in poses {
        for (name, _, joint) in rig {
            if has_position(name) {
                let at = match joint {
                    Some(0) => (pose.transl + skeleton.rest(0)) * per_metre,
                    _ => DVec3::ZERO,
                };
                let _ = write!(text, "{:.6} {:.6} {:.6} ", at.x, at.y, at.z);
            }
            let rotation = joint.map_or(DQuat::IDENTITY, |joint| pose.rotations[joint]);
            let (z, y, x) = rotation.to_euler(EulerRot::ZYX);
            for angle in [z, y, x] {
                let _ = write!(text, "{:.6} ", angle.to_degrees());
            }
        }
        text.push('\n');
    }
    text
}

/// The 77 joints of SOMA and the root above them.
fn soma() -> Rig {
    let mut rig = Rig::new();
    chain(
        &mut rig,
        "",
        "*",
        0,
        "Root Hips=0 Spine1=3 Spine2=6 Chest=9",
    );
    chain(&mut rig, "Chest", "*", 0, "Neck1=12 Neck2 Head=15 HeadEnd");
    for face in ["Jaw", "LeftEye", "RightEye"] {
        chain(&mut rig, "Head", "*", 0, face);
    }
    let sides = [("Left*", 0), ("Right*", 1)];
    for (side, right) in sides {
        let arm = "Shoulder=13 Arm=16 ForeArm=18 Hand=20";
        chain(&mut rig, "Chest", side, right, arm);
        let hand = side.replace('*', "Hand");
        for finger in ["Thumb*", "Index*", "Middle*", "Ring*", "Pinky*"] {
            let bones = if finger == "Thumb*" {
                "1 2 3 End"
            } else {
                "1 2 3 4 End"
            };
            chain(&mut rig, &hand, &format!("{hand}{finger}"), 0, bones);
        }
    }
    for (side, right) in sides {
        let leg = "Leg=1 Shin=4 Foot=7 ToeBase=10 ToeEnd";
        chain(&mut rig, "Hips", side, right, leg);
    }
    rig
}

/// A walk of BONES-SEED, of `num_frames` frames.
pub(crate) fn seed_walk(num_frames: usize) -> String {
    bvh(100.0, &soma(), &walk(num_frames, 120.0), "0.008333")
}

/// Checks the joints of a stored motion against the poses from which it was made; the motion keeps every `stride`th
/// pose.
pub(crate) fn assert_shows(row: &MotionRow, poses: &[Pose], stride: usize) {
    let skeleton = Skeleton::smplx_neutral();
    let motion = row.motion().expect("valid");
    let points = skeleton.motion_keypoints(&motion).points;
    assert_eq!(points.len(), poses.len().div_ceil(stride), "{}", row.id);
    let lift = points[0][0].y - skeleton.keypoints(&poses[0])[0].y;
    for (found, pose) in points.iter().zip(poses.iter().step_by(stride)) {
        let expected = skeleton.keypoints(pose);
        for joint in 0..22 {
            let apart = found[joint].distance(expected[joint] + DVec3::Y * lift);
            assert!(apart < 2e-3, "{}: joint {joint} off by {apart} m", row.id);
        }
    }
}

/// Metadata of BONES-SEED: two motions, the second of which is mirrored.
fn seed_metadata() -> Vec<u8> {
    let text = |cells: [&str; 2]| Arc::new(StringArray::from(cells.to_vec())) as ArrayRef;
    let captions = ["A person walks.", "Somebody walks."];
    let is_mirror = BooleanArray::from(vec![false, true]);
    let columns = [
        ("filename", text(["walk_001__A425", "walk_001__A425_M"])),
        ("content_natural_desc_1", text(captions)),
        ("content_type_of_movement", text(["walking"; 2])),
        ("content_uniform_style", text(["neutral"; 2])),
        ("actor_uid", text(["A425"; 2])),
        ("is_mirror", Arc::new(is_mirror) as ArrayRef),
    ];
    let batch = RecordBatch::try_from_iter(columns).expect("columns of one length");
    let mut writer = ArrowWriter::try_new(Vec::new(), batch.schema(), None).expect("a writer");
    writer.write(&batch).expect("writes");
    writer.into_inner().expect("writes")
}

#[test]
fn bones_seed_is_ingested_with_captions_spans_and_splits() {
    let dir = Folder::empty();
    let poses = walk(241, 120.0);
    assert_eq!(soma().len(), 78);
    let text = seed_walk(241);
    let name = |name: &str| format!("soma_uniform/bvh/230711/{name}.bvh");
    let (cut, wrong) = (name("cut_001__A425"), name("wrong_001__A425"));
    let renamed = text.replace("JOINT LeftHandThumb1\n", "JOINT LeftShin\n");
    for whole in ["walk_001__A425", "walk_001__A425_M"] {
        dir.put(&format!("source/{}", name(whole)), &text);
    }
    dir.put(&format!("source/{cut}"), &text[..text.len() * 2 / 3]);
    dir.put(&format!("source/{wrong}"), renamed);
    let table = "metadata/seed_metadata_v004.parquet";
    dir.put(&format!("source/{table}"), seed_metadata());
    let labels = r#"{"filename": "walk_001__A425", "overview_description": "A walk.", "events": [
        {"start_time": 0.0, "end_time": 1.5, "description": "A person walks forward."},
        {"start_time": 1.5, "end_time": 2.0, "description": "A person stops."}]}"#;
    let labels = labels.replace('\n', " ") + "\nno JSON\n";
    let labels_file = "metadata/seed_metadata_v002_temporal_labels.jsonl";
    dir.put(&format!("source/{labels_file}"), labels);
    let robot = "g1/csv/230711/walk_001__A425.csv";
    let head = "Frame,root_translateX,root_translateY\n";
    dir.put(&format!("source/{robot}"), head);
    let (done, out) = ingested(&dir, "source", "", &[2, 3, 2]);
    assert_eq!(len_of(&done["label_problems"]), 0, "{done}");
    let id = "soma_uniform/bvh/230711/walk_001__A425";
    let rows = motions_of(&out);
    let (walk, mirrored) = (&rows[id], &rows[&format!("{id}_M")]);
    assert_shows(walk, &poses, 6);
    assert_eq!(walk.split, mirrored.split);
    assert_eq!(walk.action.as_deref(), Some("walking"));
    assert_eq!(walk.subject.as_deref(), Some("A425"));
    let captions = walk.captions.iter();
    let captions = captions.map(|said| (said.text.as_str(), said.from_s, said.to_s));
    let expected = [
        ("A person walks.", 0.0, 0.0),
        ("A walk.", 0.0, 0.0),
        ("A person walks forward.", 0.0, 1.5),
        ("A person stops.", 1.5, 2.0),
    ];
    assert_eq!(captions.collect::<Vec<_>>(), expected);
    let shown = inspected(&out, id).to_string();
    assert_has(&shown, &["A person stops.", "skeleton map soma"]);
    let expected = [
        (labels_file, "E-SEED-LABELS"),
        (cut.as_str(), "E-BVH-FRAMES"),
        (wrong.as_str(), "E-BVH-SKELETON"),
    ];
    for (path, row) in assert_quarantined(&out, &expected) {
        assert_eq!(row.byte_offset.is_some(), path != wrong, "{path}");
    }
    assert_has(&skipped_of(&out)[robot], &["Unitree G1 robot"]);

    // Labels that change are read again; the motions stay.
    let labels = "{\"filename\": \"walk_001__A425\", \"overview_description\": \"A stroll.\"}\n";
    dir.put(&format!("source/{labels_file}"), labels);
    let (_, out) = ingested(&dir, "source", "", &[2, 2]);
    let mut captions = motions_of(&out).into_values().flat_map(|row| row.captions);
    assert!(captions.any(|said| said.text == "A stroll."));
}

#[test]
fn snapmogen_and_xsens_files_are_ingested() {
    let (mut snapmogen, mut xsens) = (Rig::new(), Rig::new());
    let [middle, left, right] = ["C_*_bind_JNT", "L_*_bind_JNT", "R_*_bind_JNT"];
    chain(&mut snapmogen, "", "*", 0, "ROOT=0");
    let spine = "spine0001=3 spine0002=6 spine0003=9 neck0001=12 head=15";
    chain(&mut snapmogen, "ROOT", middle, 0, spine);
    for (side, right) in [(left, 0), (right, 1)] {
        let arm = "clavicle=13 armUpper0001=16 armLower0001=18 hand0001=20";
        chain(&mut snapmogen, "C_spine0003_bind_JNT", side, right, arm);
    }
    chain(&mut snapmogen, "ROOT", middle, 0, "pelvis0001");
    for (side, right) in [(left, 0), (right, 1)] {
        let leg = "legUpper0001=1 legLower0001=4 foot0001=7 foot0002=10";
        chain(&mut snapmogen, "C_pelvis0001_bind_JNT", side, right, leg);
    }
    let spine = "Hips=0 Chest=3 Chest2 Chest3=6 Chest4=9 Neck=12 Head=15";
    chain(&mut xsens, "", "*", 0, spine);
    let arm = ("Chest4", "Collar=13 Shoulder=16 Elbow=18 Wrist=20");
    for (above, limb) in [arm, ("Hips", "Hip=1 Knee=4 Ankle=7 Toe=10")] {
        for (side, right) in [("Right*", 1), ("Left*", 0)] {
            chain(&mut xsens, above, side, right, limb);
        }
    }
    let dir = Folder::empty();
    let poses = walk(80, 60.0);
    for (name, rig) in [("snapmogen.bvh", snapmogen), ("xsens.bvh", xsens)] {
        let text = bvh(100.0, &rig, &poses, "0.016666667");
        dir.put(&format!("source/{name}"), text);
    }
    let (_, out) = ingested(&dir, "source", "", &[2]);
    for (id, row) in motions_of(&out) {
        assert_shows(&row, &poses, 3);
        assert_tells(&inspected(&out, &id), &format!("skeleton map {id}"));
    }
}

/// These poses as an array of Motion-X: 322 columns, y up.
pub(crate) fn motion_x(poses: &[Pose]) -> Vec<u8> {
    let mut values = Vec::new();
    for pose in poses {
        let mut row = vec![0.25_f32; 322];
        for (joint, rotation) in pose.rotations.iter().enumerate() {
            let vector = rotation.to_scaled_axis().as_vec3().to_array();
            row[3 * joint..3 * joint + 3].copy_from_slice(&vector);
        }
        row[309..312].copy_from_slice(&pose.transl.as_vec3().to_array());
        values.extend(row);
    }
    pickle::npy::encode(&[poses.len(), 322], &values)
}

#[test]
fn motion_x_is_ingested_with_captions_and_splits() {
    let dir = Folder::empty();
    let poses = walk(61, 30.0);
    let good = motion_x(&poses);
    let mut nan = good.clone();
    let at = nan.len() - 4 * 322 + 8;
    nan[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    let motions = "source/motion_data/smplx_322/idea400/subset_0000";
    dir.put(&format!("{motions}/Walk_clip1.npy"), &good);
    dir.put(&format!("{motions}/nan.npy"), &nan);
    let id = "idea400/subset_0000/Walk_clip1";
    let texts = format!("texts/semantic_labels/{id}.txt");
    dir.put(&format!("source/{texts}"), "a person walks\n");
    dir.put("source/test.txt", format!("{id}\n"));
    let (_, out) = ingested(&dir, "source", "--fps 30", &[1, 1, 2]);
    let rows: Vec<MotionRow> = rows_of(&out);
    assert_shows(&rows[0], &poses, 1);
    assert_eq!(rows[0].split.as_str(), "test");
    assert_tells(&inspected(&out, id), "a person walks");
    let row = &rows_of::<QuarantineRow>(&out)[0];
    assert_eq!(row.code, "E-NOT-FINITE");
    assert_eq!(row.byte_offset, Some(at as u64));
    // A single array is recognised too.
    let ran = dir.run(&format!("inspect @{motions}/Walk_clip1.npy"));
    ran.expect_printed("motion-x");
}

#[test]
fn bvh_is_one_motion_in_any_unit_and_a_wrong_unit_is_refused() {
    let dir = Folder::empty();
    let poses = walk(40, 60.0);
    for (name, per_metre) in [("cm.bvh", 100.0), ("m.bvh", 1.0), ("in.bvh", 39.370_079)] {
        let text = bvh(per_metre, &soma(), &poses, "0.016666667");
        dir.put(&format!("source/{name}"), text);
    }
    let more = format!("{} --fps native", all_in_train(&dir));
    let (_, out) = ingested(&dir, "source", &more, &[3]);
    for row in rows_of::<MotionRow>(&out) {
        assert_shows(&row, &poses, 1);
    }
    // A file in inches could be one of a very short person in centimetres, and a note says so.
    for (id, words) in [
        ("cm", "unit centimetres (a leg measures"),
        ("m", "unit metres (a leg measures"),
        ("in", "unit inches (a leg measures"),
        ("in", "centimetres would make it 0.3"),
    ] {
        assert_tells(&inspected(&out, id), words);
    }
    fs::remove_dir_all(&out).expect("removed");
    let more = format!("{more} --unit cm");
    let (_, out) = ingested(&dir, "source", &more, &[2, 1]);
    assert_tells(&inspected(&out, "cm"), "unit cm, as --unit says");
    let found = assert_quarantined(&out, &[("m.bvh", "E-UNIT")]);
    assert_has(&found["m.bvh"].reason, &["likely m (1."]);
}

#[test]
fn motions_of_robots_are_skipped_as_what_they_are() {
    let dir = Folder::empty();
    let row = format!("0.1,0.0,0.8,0.0,0.0,0.6,0.8{}", ",0.5".repeat(29));
    dir.put("source/lafan1/walk.csv", format!("{row}\n{row}\n"));
    let entries = [("root_pos", 3), ("root_rot", 4), ("dof_pos", 29)].map(|(key, width)| {
        let array = pickle::Value::floats(&[2, width], vec![0.5; 2 * width]);
        (pickle::Value::text(key), array)
    });
    let gmr = pickle::encode(&pickle::Value::Dict(entries.to_vec()));
    dir.put("source/gmr/walk.pkl", &gmr);
    dir.put("source/walk.bvh", seed_walk(80));
    let (_, out) = ingested(&dir, "source", "", &[1, 0, 2]);
    let skipped = skipped_of(&out);
    for (path, words) in [
        ("lafan1/walk.csv", "Unitree G1 robot, 36 columns"),
        ("gmr/walk.pkl", "as GMR writes it"),
    ] {
        assert_has(&skipped[path], &[words, "ingest the human motion"]);
    }
}

#[test]
fn the_up_axis_can_be_named_and_is_doubted_where_nobody_stands() {
    let dir = Folder::empty();
    let turned = |degrees: f64| {
        let turn = DQuat::from_rotation_x(degrees.to_radians());
        let mut poses = walk(120, 60.0);
        for pose in &mut poses {
            pose.rotations[0] = turn * pose.rotations[0];
            pose.transl = turn * pose.transl;
        }
        bvh(100.0, &soma(), &poses, "0.016667")
    };
    dir.put("source/lying.bvh", turned(90.0));
    dir.put("source/bowing.bvh", turned(50.0));
    dir.put("source/standing.bvh", turned(0.0));
    // Height of the head above the pelvis on average, and the flags.
    let read = |name: &str, more: &str| {
        dir.run(&format!("ingest @source --out @{name} {more}"));
        let rows = motions_of(&dir.path(name));
        let skeleton = Skeleton::smplx_neutral();
        ["lying", "bowing", "standing"].map(|clip| {
            let row = &rows[clip];
            let motion = row.motion().expect("valid");
            let points = skeleton.motion_keypoints(&motion).points;
            let rise = points.iter().map(|joints| joints[15].y - joints[0].y);
            let rise = rise.sum::<f64>();
            let is_doubtful = row.quality.flags & FLAG_UP_DOUBTFUL != 0;
            (rise / points.len() as f64, is_doubtful)
        })
    };
    // Of a person who lies, the posture says that another axis is up, and the zero pose that y is.
    let [lying, bowing, standing] = read("guessed", "");
    assert!(lying.0 > 0.4 && standing.0 > 0.4, "{lying:?} {standing:?}");
    assert_eq!([lying.1, bowing.1, standing.1], [true, true, false]);
    let [lying, bowing, standing] = read("named", "--up y");
    let one_stands = lying.0.abs() < 0.1 && standing.0 > 0.4;
    assert!(one_stands, "{lying:?} {standing:?}");
    assert_eq!([lying.1, bowing.1, standing.1], [false; 3]);
    // An export of a motion says so beside it.
    dir.run("export @named --to bvh --out @exported");
    let sidecar = dir.text("exported/lying.stance.json");
    assert_has(&sidecar, &["\"up\": \"y\""]);
    dir.put("source/lying.stance.json", "{\"up\": \"y\"}");
    let [lying, ..] = read("told", "");
    assert!(lying.0.abs() < 0.1 && !lying.1, "{lying:?}");
    let ran = dir.typed("ingest @source --out @never --up up");
    ran.expect_code(2)
        .expect_said("expected x, y, z, -x, -y or -z");
}

#[test]
fn a_skeleton_without_known_names_gives_the_same_motion() {
    let Some(data) = util::real_data("a_skeleton_without_known_names_gives_the_same_motion") else {
        return;
    };
    let dir = Folder::empty();
    // Rigs with an extra bone above each hip, at the place of the pelvis.
    let names = ["cmu_12_01_walk", "pfnn_hierarchy", "npybvh_example"];
    for name in names {
        let text = util::text_of(data.join(format!("bvh/other/{name}.bvh")));
        dir.put(&format!("source/named/{name}.bvh"), &text);
        let mut number = 0;
        let renamed = text.lines().map(|line| {
            let Some((indent, kind)) = ["ROOT", "JOINT"].iter().find_map(|kind| {
                let (indent, _) = line.split_once(&format!("{kind} "))?;
                indent.trim().is_empty().then_some((indent, kind))
            }) else {
                return line.to_owned();
            };
            number += 1;
            format!("{indent}{kind} j{number}")
        });
        let renamed: Vec<String> = renamed.collect();
        dir.put(&format!("source/unnamed/{name}.bvh"), renamed.join("\n"));
    }
    dir.run("ingest @source --out @dataset");
    let rows = motions_of(&dir.path("dataset"));
    for name in names {
        let of = |folder: &str| rows[&format!("{folder}/{name}")].motion().expect("valid");
        let away = crate::export::apart(&of("named"), &of("unnamed"));
        // Without names, collars and spine may be other bones of the same chain, which moves joints by centimetres.
        assert!(away < 0.1, "{name}: {away}");
    }
}
