//! Formats of other programs through the command: files made here from their documented layouts are ingested,
//! verified and inspected.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;
use std::path::Path;
use std::sync::Arc;

use arrow_array::{ArrayRef, BooleanArray, RecordBatch, StringArray};
use datasets_spec::record::{MotionRow, QuarantineRow, SkippedRow};
use datasets_spec::{Dataset, Pose, Skeleton};
use glam::{DQuat, DVec3, EulerRot};
use parquet::arrow::ArrowWriter;
use serde::Deserialize;

use crate::util::{arg, assert_counted, assert_has, stance, typed_with};

/// The fields of `ingest --json` that the tests use.
#[derive(Debug, Deserialize)]
pub(crate) struct Ingested {
    pub(crate) ingested: u64,
    pub(crate) quarantined: u64,
    pub(crate) skipped: u64,
    pub(crate) codes: BTreeMap<String, u64>,
    label_problems: Vec<serde_json::Value>,
}

pub(crate) fn put(folder: &Path, name: &str, bytes: impl AsRef<[u8]>) {
    let path = folder.join(name);
    fs::create_dir_all(path.parent().expect("a folder")).expect("writes");
    fs::write(path, bytes).expect("writes");
}

/// Ingests a folder, verifies the dataset, and opens it.
pub(crate) fn ingested(
    source: &Path,
    more: &[&str],
    code: i32,
) -> (Ingested, Dataset, std::path::PathBuf) {
    let out = source.with_extension("dataset");
    let ran = typed_with("--json ingest {} --out {}", &[&source, &out], more);
    let ran = ran.expect_code(code);
    assert_counted(&ran.json());
    let done: Ingested = ran.json();
    assert_eq!(done.quarantined, done.codes.values().sum::<u64>());
    stance(&["verify", arg(&out)]).expect_code(0);
    let dataset = Dataset::open(&out).expect("a dataset");
    (done, dataset, out)
}

/// A list that puts all clips into one split, for sources that show one motion several times.
pub(crate) fn all_in_train(folder: &Path) -> std::path::PathBuf {
    put(folder, "splits.csv", "clip,split\n*,train\n");
    folder.join("splits.csv")
}

/// Output of `inspect` for a clip.
pub(crate) fn inspected(dataset: &Path, id: &str) -> serde_json::Value {
    let ran = stance(&["--json", "inspect", arg(dataset), "--clip", id]);
    ran.done()
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

/// A BVH file of a rig whose zero pose is the rest pose of the body, in centimetres. Joints named in
/// `six_channels` have positions too.
fn bvh(rig: &Rig, six_channels: &[&str], poses: &[Pose], frame_time: &str, ends: bool) -> String {
    bvh_in(100.0, rig, six_channels, poses, frame_time, ends)
}

/// As `bvh`, in another unit, with this many units per metre.
fn bvh_in(
    per_metre: f64,
    rig: &Rig,
    six_channels: &[&str],
    poses: &[Pose],
    frame_time: &str,
    ends: bool,
) -> String {
    let skeleton = Skeleton::smplx_neutral();
    let index_of = |name: &str| rig.iter().position(|(joint, ..)| joint == name);
    let place = |index: usize| rig[index].2.map(|joint| skeleton.rest(joint));
    // The nearest place at or above a joint.
    let nearest = |mut index: usize| loop {
        match (place(index), index_of(&rig[index].1)) {
            (Some(place), _) => return place,
            (None, Some(parent)) => index = parent,
            (None, None) => return DVec3::ZERO,
        }
    };
    let mut order = Vec::new();
    let mut text = "HIERARCHY\n".to_owned();
    let mut open: Vec<String> = Vec::new();
    for (index, (name, parent, _)) in rig.iter().enumerate() {
        while open.last().is_some_and(|last| last != parent) {
            open.pop();
            text.push_str("}\n");
        }
        let above = index_of(parent).map(nearest);
        let offset = above.map_or(DVec3::ZERO, |above| (nearest(index) - above) * per_metre);
        let keyword = if parent.is_empty() { "ROOT" } else { "JOINT" };
        let channels = match six_channels.contains(&name.as_str()) {
            true => "6 Xposition Yposition Zposition",
            false => "3",
        };
        let _ = writeln!(
            text,
            "{keyword} {name}\n{{\nOFFSET {:.6} {:.6} {:.6}\nCHANNELS {channels} Zrotation Yrotation Xrotation",
            offset.x, offset.y, offset.z
        );
        let is_leaf = !rig.iter().any(|(_, above, _)| above == name);
        if is_leaf && ends {
            text.push_str("End Site\n{\nOFFSET 0 0 0\n}\n");
        }
        open.push(name.clone());
        order.push(index);
    }
    text.push_str(&"}\n".repeat(open.len()));
    let _ = writeln!(
        text,
        "MOTION\nFrames: {}\nFrame Time: {frame_time}",
        poses.len()
    );
    for pose in poses {
        for &index in &order {
            let (name, _, joint) = &rig[index];
            if six_channels.contains(&name.as_str()) {
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
    let mut rig: Rig = vec![(String::from("Root"), String::new(), None)];
    let mut chain = |above: &str, side: &str, names: &[(&str, Option<usize>)]| {
        let mut above = above.to_owned();
        for (name, joint) in names {
            let name = format!("{side}{name}");
            rig.push((name.clone(), above, *joint));
            above = name;
        }
    };
    chain(
        "Root",
        "",
        &[
            ("Hips", Some(0)),
            ("Spine1", Some(3)),
            ("Spine2", Some(6)),
            ("Chest", Some(9)),
        ],
    );
    chain(
        "Chest",
        "",
        &[
            ("Neck1", Some(12)),
            ("Neck2", None),
            ("Head", Some(15)),
            ("HeadEnd", None),
        ],
    );
    for face in ["Jaw", "LeftEye", "RightEye"] {
        chain("Head", "", &[(face, None)]);
    }
    for (side, right) in [("Left", 0), ("Right", 1)] {
        let arm = [("Shoulder", 13), ("Arm", 16), ("ForeArm", 18), ("Hand", 20)];
        chain(
            "Chest",
            side,
            &arm.map(|(name, joint)| (name, Some(joint + right))),
        );
        for finger in ["Thumb", "Index", "Middle", "Ring", "Pinky"] {
            let bones = if finger == "Thumb" { 3 } else { 4 };
            let ends = (1..=bones)
                .map(|bone| bone.to_string())
                .chain(["End".to_owned()]);
            let names: Vec<String> = ends.map(|end| format!("Hand{finger}{end}")).collect();
            let names: Vec<(&str, Option<usize>)> =
                names.iter().map(|name| (name.as_str(), None)).collect();
            chain(&format!("{side}Hand"), side, &names);
        }
    }
    for (side, right) in [("Left", 0), ("Right", 1)] {
        let leg = [("Leg", 1), ("Shin", 4), ("Foot", 7), ("ToeBase", 10)];
        let leg = leg.map(|(name, joint)| (name, Some(joint + right)));
        let [hip, knee, ankle, foot] = leg;
        chain("Hips", side, &[hip, knee, ankle, foot, ("ToeEnd", None)]);
    }
    rig
}

/// A walk of BONES-SEED, of `num_frames` frames.
pub(crate) fn seed_walk(num_frames: usize) -> String {
    bvh(
        &soma(),
        &["Root", "Hips"],
        &walk(num_frames, 120.0),
        "0.008333",
        false,
    )
}

/// Checks the joints of a stored motion against the poses from which it was made; the motion keeps every `stride`th
/// pose.
pub(crate) fn assert_shows(row: &MotionRow, poses: &[Pose], stride: usize) {
    let skeleton = Skeleton::smplx_neutral();
    let points = skeleton
        .motion_keypoints(&row.motion().expect("valid"))
        .points;
    assert_eq!(points.len(), poses.len().div_ceil(stride), "{}", row.id);
    let lift = points[0][0].y - skeleton.keypoints(&poses[0])[0].y;
    for (found, pose) in points.iter().zip(poses.iter().step_by(stride)) {
        let expected = skeleton.keypoints(pose);
        for joint in 0..22 {
            let apart = found[joint].distance(expected[joint] + DVec3::Y * lift);
            assert!(
                apart < 2e-3,
                "{}: joint {joint} is off by {apart} m",
                row.id
            );
        }
    }
}

/// Metadata of BONES-SEED: two motions, the second of which is mirrored.
fn seed_metadata() -> Vec<u8> {
    let text = |cells: [&str; 2]| Arc::new(StringArray::from(cells.to_vec())) as ArrayRef;
    let columns: Vec<(&str, ArrayRef)> = vec![
        ("filename", text(["walk_001__A425", "walk_001__A425_M"])),
        (
            "content_natural_desc_1",
            text(["A person walks.", "Somebody walks."]),
        ),
        ("content_type_of_movement", text(["walking"; 2])),
        ("content_uniform_style", text(["neutral"; 2])),
        ("actor_uid", text(["A425"; 2])),
        ("is_mirror", Arc::new(BooleanArray::from(vec![false, true]))),
    ];
    let batch = RecordBatch::try_from_iter(columns).expect("columns of one length");
    let mut writer = ArrowWriter::try_new(Vec::new(), batch.schema(), None).expect("a writer");
    writer.write(&batch).expect("writes");
    writer.into_inner().expect("writes")
}

#[test]
fn bones_seed_is_ingested_with_captions_spans_and_splits() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let source = dir.path().join("seed");
    let poses = walk(241, 120.0);
    let rig = soma();
    assert_eq!(rig.len(), 78);
    let text = bvh(&rig, &["Root", "Hips"], &poses, "0.008333", false);
    let name = |name: &str| format!("soma_uniform/bvh/230711/{name}.bvh");
    put(&source, &name("walk_001__A425"), &text);
    put(&source, &name("walk_001__A425_M"), &text);
    put(&source, &name("cut_001__A425"), &text[..text.len() * 2 / 3]);
    put(
        &source,
        &name("wrong_001__A425"),
        text.replace("JOINT LeftHandThumb1\n", "JOINT LeftShin\n"),
    );
    put(
        &source,
        "metadata/seed_metadata_v004.parquet",
        seed_metadata(),
    );
    let labels = r#"{"filename": "walk_001__A425", "overview_description": "A walk.", "events": [
        {"start_time": 0.0, "end_time": 1.5, "description": "A person walks forward."},
        {"start_time": 1.5, "end_time": 2.0, "description": "A person stops."}]}"#;
    let labels = labels.replace('\n', " ") + "\nno JSON\n";
    let labels_file = "metadata/seed_metadata_v002_temporal_labels.jsonl";
    put(&source, labels_file, labels);
    put(
        &source,
        "g1/csv/230711/walk_001__A425.csv",
        "Frame,root_translateX,root_translateY\n",
    );
    let (done, dataset, out) = ingested(&source, &[], 3);
    assert_eq!(
        (done.ingested, done.quarantined, done.skipped),
        (2, 3, 2),
        "{done:?}"
    );
    assert!(done.label_problems.is_empty());

    let mut rows: Vec<MotionRow> = dataset.read(None).expect("rows");
    rows.sort_by(|a, b| a.id.as_str().cmp(b.id.as_str()));
    let [walk, mirrored] = &rows[..] else {
        panic!("two motions");
    };
    assert_shows(walk, &poses, 6);
    assert_eq!(walk.split, mirrored.split);
    assert_eq!(walk.action.as_deref(), Some("walking"));
    assert_eq!(walk.subject.as_deref(), Some("A425"));
    let captions: Vec<(&str, f32, f32)> = walk
        .captions
        .iter()
        .map(|caption| (caption.text.as_str(), caption.from_s, caption.to_s))
        .collect();
    assert_eq!(
        captions,
        [
            ("A person walks.", 0.0, 0.0),
            ("A walk.", 0.0, 0.0),
            ("A person walks forward.", 0.0, 1.5),
            ("A person stops.", 1.5, 2.0),
        ]
    );
    let shown = inspected(&out, "soma_uniform/bvh/230711/walk_001__A425").to_string();
    assert_has(&shown, &["A person stops.", "skeleton map soma"]);

    let quarantine: Vec<QuarantineRow> = dataset.read(None).expect("rows");
    let found: Vec<(&str, &str, bool)> = quarantine
        .iter()
        .map(|row| {
            (
                row.path.as_str(),
                row.code.as_str(),
                row.byte_offset.is_some(),
            )
        })
        .collect();
    assert_eq!(
        found,
        [
            (labels_file, "E-SEED-LABELS", true),
            (name("cut_001__A425").as_str(), "E-BVH-FRAMES", true),
            (name("wrong_001__A425").as_str(), "E-BVH-SKELETON", false),
        ]
    );
    let skipped: Vec<SkippedRow> = dataset.read(None).expect("rows");
    let robot = skipped.iter().find(|row| row.path.starts_with("g1/"));
    assert!(
        robot.is_some_and(|row| row.reason.contains("Unitree G1 robot")),
        "{skipped:?}"
    );

    // Labels that change are read again; the motions stay.
    put(
        &source,
        labels_file,
        "{\"filename\": \"walk_001__A425\", \"overview_description\": \"A stroll.\"}\n",
    );
    let (again, dataset, _) = ingested(&source, &[], 3);
    assert_eq!((again.ingested, again.quarantined), (2, 2), "{again:?}");
    let rows: Vec<MotionRow> = dataset.read(None).expect("rows");
    let texts = rows
        .iter()
        .flat_map(|row| &row.captions)
        .map(|caption| caption.text.as_str());
    assert!(texts.into_iter().any(|text| text == "A stroll."));
}

#[test]
fn snapmogen_and_xsens_files_are_ingested() {
    let joints = |names: &[(&str, &str, Option<usize>)]| -> Rig {
        let joint = |(name, parent, joint): &(&str, &str, Option<usize>)| {
            ((*name).to_owned(), (*parent).to_owned(), *joint)
        };
        names.iter().map(joint).collect()
    };
    let sides = |stem: &str, parents: [&str; 2], left: usize| {
        let name = |side: &str| format!("{side}_{stem}_bind_JNT");
        let parent = |side: &str, parent: &str| match parent.starts_with("C_") {
            true => format!("{parent}_bind_JNT"),
            false => format!("{side}_{parent}_bind_JNT"),
        };
        [("L", 0), ("R", 1)]
            .map(|(side, right)| (name(side), parent(side, parents[right]), Some(left + right)))
    };
    let mut snapmogen = joints(&[
        ("ROOT", "", Some(0)),
        ("C_spine0001_bind_JNT", "ROOT", Some(3)),
        ("C_spine0002_bind_JNT", "C_spine0001_bind_JNT", Some(6)),
        ("C_spine0003_bind_JNT", "C_spine0002_bind_JNT", Some(9)),
        ("C_neck0001_bind_JNT", "C_spine0003_bind_JNT", Some(12)),
        ("C_head_bind_JNT", "C_neck0001_bind_JNT", Some(15)),
    ]);
    let arms = [
        ("clavicle", "C_spine0003", 13),
        ("armUpper0001", "clavicle", 16),
        ("armLower0001", "armUpper0001", 18),
        ("hand0001", "armLower0001", 20),
    ];
    let legs = [
        ("legUpper0001", "C_pelvis0001", 1),
        ("legLower0001", "legUpper0001", 4),
        ("foot0001", "legLower0001", 7),
        ("foot0002", "foot0001", 10),
    ];
    let limb = |names: [(&str, &str, usize); 4], side: usize| {
        names.map(|(name, parent, left)| sides(name, [parent; 2], left)[side].clone())
    };
    for side in [0, 1] {
        snapmogen.extend(limb(arms, side));
    }
    snapmogen.extend(joints(&[("C_pelvis0001_bind_JNT", "ROOT", None)]));
    for side in [0, 1] {
        snapmogen.extend(limb(legs, side));
    }
    let mut xsens = joints(&[
        ("Hips", "", Some(0)),
        ("Chest", "Hips", Some(3)),
        ("Chest2", "Chest", None),
        ("Chest3", "Chest2", Some(6)),
        ("Chest4", "Chest3", Some(9)),
        ("Neck", "Chest4", Some(12)),
        ("Head", "Neck", Some(15)),
    ]);
    let arms = [
        ("Collar", "Chest4", 13),
        ("Shoulder", "", 16),
        ("Elbow", "", 18),
        ("Wrist", "", 20),
    ];
    let legs = [
        ("Hip", "Hips", 1),
        ("Knee", "", 4),
        ("Ankle", "", 7),
        ("Toe", "", 10),
    ];
    for limb in [arms, legs] {
        for (side, right) in [("Right", 1), ("Left", 0)] {
            for (name, parent, left) in limb {
                let above = xsens.last().map(|(name, ..)| name.clone());
                let parent = match parent {
                    "" => above.unwrap_or_default(),
                    parent => parent.to_owned(),
                };
                xsens.push((format!("{side}{name}"), parent, Some(left + right)));
            }
        }
    }
    let dir = tempfile::tempdir().expect("a temporary folder");
    let source = dir.path().join("captures");
    let poses = walk(80, 60.0);
    put(
        &source,
        "snapmogen.bvh",
        bvh(&snapmogen, &["ROOT"], &poses, "0.016666667", true),
    );
    put(
        &source,
        "xsens.bvh",
        bvh(&xsens, &["Hips"], &poses, "0.016666667", true),
    );
    let (done, dataset, out) = ingested(&source, &[], 0);
    assert_eq!(done.ingested, 2, "{done:?}");
    for row in dataset.read::<MotionRow>(None).expect("rows") {
        assert_shows(&row, &poses, 3);
        let shown = inspected(&out, row.id.as_str()).to_string();
        assert_has(&shown, &[&format!("skeleton map {}", row.id)]);
    }
}

/// An array of 322 columns of these poses, y up.
fn motion_x(poses: &[Pose]) -> Vec<u8> {
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
    let dir = tempfile::tempdir().expect("a temporary folder");
    let source = dir.path().join("motionx");
    let poses = walk(61, 30.0);
    let good = motion_x(&poses);
    let mut nan = good.clone();
    let at = nan.len() - 4 * 322 + 8;
    nan[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    let motions = "motion_data/smplx_322/idea400/subset_0000";
    put(&source, &format!("{motions}/Walk_clip1.npy"), &good);
    put(
        &source,
        &format!("{motions}/cut.npy"),
        &good[..good.len() - 7],
    );
    put(&source, &format!("{motions}/nan.npy"), &nan);
    let narrow = pickle::npy::encode(&[2, 320], &[0.0_f32; 640]);
    put(&source, &format!("{motions}/narrow.npy"), narrow);
    put(
        &source,
        "texts/semantic_labels/idea400/subset_0000/Walk_clip1.txt",
        "a person walks\n",
    );
    put(&source, "test.txt", "idea400/subset_0000/Walk_clip1\n");
    let (done, dataset, out) = ingested(&source, &["--fps", "30"], 3);
    assert_eq!(
        (done.ingested, done.quarantined, done.skipped),
        (1, 3, 2),
        "{done:?}"
    );
    let rows: Vec<MotionRow> = dataset.read(None).expect("rows");
    assert_shows(&rows[0], &poses, 1);
    assert_eq!(rows[0].split.as_str(), "test");
    let shown = inspected(&out, "idea400/subset_0000/Walk_clip1").to_string();
    assert!(shown.contains("a person walks"), "{shown}");
    let quarantine: Vec<QuarantineRow> = dataset.read(None).expect("rows");
    let found: BTreeMap<&str, Option<u64>> = quarantine
        .iter()
        .map(|row| (row.code.as_str(), row.byte_offset))
        .collect();
    assert_eq!(found["E-NOT-FINITE"], Some(at as u64));
    assert!(found["E-NPY-SHAPE"].is_some() && found.contains_key("E-MOTIONX-SHAPE"));
    // A lone array is the same motion.
    let file = source.join(format!("{motions}/Walk_clip1.npy"));
    let ran = stance(&["inspect", arg(&file)]).expect_code(0);
    ran.expect_printed("motion-x");
}

#[test]
fn bvh_is_one_motion_in_any_unit_and_a_wrong_unit_is_refused() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let source = dir.path().join("units");
    let poses = walk(40, 60.0);
    for (name, per_metre) in [("cm", 100.0), ("m", 1.0), ("in", 39.370_079)] {
        let text = bvh_in(
            per_metre,
            &soma(),
            &["Root", "Hips"],
            &poses,
            "0.016666667",
            false,
        );
        put(&source, &format!("{name}.bvh"), text);
    }
    let splits = all_in_train(dir.path());
    let more = ["--splits", arg(&splits), "--fps", "native"];
    let (_, dataset, out) = ingested(&source, &more, 0);
    let rows: Vec<MotionRow> = dataset.read(None).expect("rows");
    assert_eq!(rows.len(), 3);
    for row in &rows {
        assert_shows(row, &poses, 1);
    }
    // A short person in centimetres is plausible too, and a note says so.
    for (id, words) in [
        ("cm", "unit centimetres (a leg measures"),
        ("m", "unit metres (a leg measures"),
        ("in", "unit inches (a leg measures"),
        ("in", "centimetres would make it 0.3"),
    ] {
        let said = inspected(&out, id).to_string();
        assert!(said.contains(words), "{id}: {words}: {said}");
    }
    fs::remove_dir_all(&out).expect("removed");
    let (done, dataset, out) = ingested(&source, &[&more[..], &["--unit", "cm"]].concat(), 3);
    assert_eq!((done.ingested, done.quarantined), (2, 1), "{done:?}");
    assert!(
        inspected(&out, "cm")
            .to_string()
            .contains("unit cm, as --unit says")
    );
    let quarantine: Vec<QuarantineRow> = dataset.read(None).expect("rows");
    assert_eq!(
        (quarantine[0].path.as_str(), quarantine[0].code.as_str()),
        ("m.bvh", "E-UNIT")
    );
    assert_has(&quarantine[0].reason, &["likely m (1."]);
}

#[test]
fn motions_of_robots_are_skipped_as_what_they_are() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let source = dir.path().join("robots");
    let row = format!("0.1,0.0,0.8,0.0,0.0,0.6,0.8{}", ",0.5".repeat(29));
    put(&source, "lafan1/walk.csv", format!("{row}\n{row}\n"));
    let array = |width: usize| {
        let array = pickle::Array::from_f32(&[2, width], vec![0.5; 2 * width]);
        pickle::Value::Array(array.into())
    };
    let entries = [
        ("root_pos", array(3)),
        ("root_rot", array(4)),
        ("dof_pos", array(29)),
    ];
    let entries = entries.map(|(key, value)| (pickle::Value::text(key), value));
    let gmr = pickle::encode(&pickle::Value::Dict(entries.to_vec()));
    put(&source, "gmr/walk.pkl", &gmr);
    put(
        &source,
        "walk.bvh",
        bvh(
            &soma(),
            &["Root", "Hips"],
            &walk(40, 60.0),
            "0.016666667",
            false,
        ),
    );
    let (done, dataset, _) = ingested(&source, &[], 0);
    assert_eq!(
        (done.ingested, done.quarantined, done.skipped),
        (1, 0, 2),
        "{done:?}"
    );
    let skipped: Vec<SkippedRow> = dataset.read(None).expect("rows");
    for (path, words) in [
        ("lafan1/walk.csv", "Unitree G1 robot, 36 columns"),
        ("gmr/walk.pkl", "as GMR writes it"),
    ] {
        let row = skipped.iter().find(|row| row.path == path).expect(path);
        assert!(row.reason.contains(words), "{}", row.reason);
        assert_has(&row.reason, &["ingest the human motion"]);
    }
}
