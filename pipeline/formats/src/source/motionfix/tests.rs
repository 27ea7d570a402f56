use std::io::Write;
use std::path::Path;

use flate2::Compression;
use flate2::write::ZlibEncoder;

use super::*;
use crate::source::release_tests::{
    assert_says, clip_of, codes, files_under, only_release, says, test_data,
};
use pickle::encode;
use testkit::put;

/// A motion of the release: standing, z up, turned by 45 degrees about the vertical and moving along x.
fn motion(frames: usize, split_rotations: bool) -> Value {
    let upright = glam::DQuat::from_rotation_z(std::f64::consts::FRAC_PI_4)
        * glam::DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2);
    let root = kinematics::rotation::to_axis_angle(upright)
        .as_vec3()
        .to_array();
    let rots = (0..frames).flat_map(|_| {
        let mut frame = [0.0; 66];
        frame[..3].copy_from_slice(&root);
        frame[65] = 0.25;
        frame
    });
    let shape = match split_rotations {
        true => vec![frames, 22, 3],
        false => vec![frames, 66],
    };
    let trans = (0..frames).flat_map(|frame| [0.01 * frame as f32, 0.0, 0.0]);
    let joints = Value::floats(&[frames, 22, 3], vec![1.0; 66 * frames]);
    Value::dict([
        ("rots", Value::floats(&shape, rots)),
        ("trans", Value::floats(&[frames, 3], trans)),
        ("joint_positions", joints),
    ])
}

fn pair(source_frames: usize, text: &str) -> Value {
    Value::dict([
        ("motion_source", motion(source_frames, false)),
        ("motion_target", motion(20, true)),
        ("text", Value::text(text)),
    ])
}

fn put_dump(folder: &Path, file: &str, pairs: &[(&str, Value)], packed: bool) {
    let entries = pairs
        .iter()
        .map(|(id, pair)| (Value::text(id), pair.clone()));
    let bytes = encode(&Value::Dict(entries.collect()));
    put(folder, file, if packed { zlib(&bytes) } else { bytes });
}

fn zlib(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(bytes).expect("in memory");
    encoder.finish().expect("in memory")
}

#[test]
fn dumps_and_lists_become_pairs() {
    for packed in [false, true] {
        let dir = tempfile::tempdir().expect("temporary folder");
        let raise = "raise your left arm";
        let put_dump = |name: &str, pairs: &[(&str, Value)]| {
            put_dump(dir.path(), &format!("data/{name}.pth.tar"), pairs, packed);
        };
        let (up, slower) = (("000136", pair(25, raise)), ("000002", pair(20, "slower")));
        put_dump("motionfix", &[up.clone(), slower.clone()]);
        put_dump("motionfix_test", &[slower, ("000007", pair(20, "jump"))]);
        put_dump("motionfix_val", &[up]);
        let splits = r#"{"train": ["000136"], "test": ["000002"]}"#;
        put(dir.path(), "data/splits.json", splits);
        let labels =
            format!(r#"{{"{raise} ": "Answer: left arm\nneck", "slower": "Answer: wrists"}}"#);
        put(dir.path(), "deps/gpt/edit/gpt-labels_full.json", labels);
        let files = files_under(dir.path());
        let release = only_release(FORMAT, &files);
        let planned: Vec<(String, String, Option<Split>)> = release
            .contents()
            .entries
            .iter()
            .map(|entry| (entry.id.clone(), entry.key.clone(), entry.split))
            .collect();
        let expected = [
            ("000002", Split::Test),
            ("000136", Split::Train),
            ("000007", Split::Test),
        ];
        let expected = expected.into_iter().flat_map(|(pair, split)| {
            ["source", "target"].map(|side| {
                let id = format!("motionfix/{pair}-{side}");
                (id, format!("{pair}/{side}"), Some(split))
            })
        });
        assert_eq!(planned, expected.collect::<Vec<_>>());
        let passed_over = release.contents().passed_over.iter();
        let passed: Vec<&str> = passed_over.map(|(file, _)| file.as_str()).collect();
        let expected = [
            "deps/gpt/edit/gpt-labels_full.json",
            "data/splits.json",
            "data/motionfix_val.pth.tar",
        ];
        assert_eq!(passed, expected);

        // 000007 has the split of its dump.
        let remarks = &release.contents().remarks;
        assert_eq!(remarks.len(), 2, "{remarks:?}");
        assert!(
            remarks[0].contains("1 answers of") && remarks[0].contains("\"slower\""),
            "{remarks:?}"
        );
        let unlisted = clip_of(&*release, &files, "motionfix/000007-target");
        assert_says(&unlisted, "its dump");

        let source = clip_of(&*release, &files, "motionfix/000136-source");
        assert!(!says(&source, "splits.json"), "{:?}", source.notes);
        assert_eq!((source.motion.len(), source.motion.fps().get()), (25, 30.0));
        assert_eq!(source.edits, []);
        let target = clip_of(&*release, &files, "motionfix/000136-target");
        assert_eq!(target.motion.len(), 20);
        let [edit] = &target.edits[..] else {
            panic!("{:?}", target.edits);
        };
        assert_eq!(edit.source_id, "motionfix/000136-source");
        assert_eq!(edit.kind, "fine-grained");
        assert_eq!(edit.instruction, raise);
        assert_eq!(edit.parts, [BodyPart::LeftArm, BodyPart::Head]);
    }
}

#[test]
fn motions_stand_upright_on_the_floor_of_the_store() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let pairs = [("1", pair(10, ""))];
    put_dump(dir.path(), "motionfix.pth.tar", &pairs, false);
    let files = files_under(dir.path());
    let release = only_release(FORMAT, &files);
    let options = ReadOptions::default();
    for side in ["source", "target"] {
        let motion = clip_of(&*release, &files, &format!("motionfix/000001-{side}")).motion;
        assert_eq!(motion.body_pose()[3][62], 0.25, "kept to the bit");
        let keypoints = options.skeleton.keypoints(&motion.pose(0));
        assert!(keypoints[15].y > keypoints[0].y + 0.4, "the head is up");
        assert!(keypoints[10].y.abs() < 0.1, "the feet are on the floor");
        let left = keypoints[16] - keypoints[17];
        let facing = left.cross(glam::DVec3::Y).normalize();
        // With z up, a standing body faces -y. Turned by 45 degrees about the vertical, it faces +x -y, which is +x +z
        // with y up.
        let expected = glam::DVec3::new(1.0, 0.0, 1.0).normalize();
        assert!(facing.dot(expected) > 0.99, "{facing}");
        let moved = motion.transl()[1][0] - motion.transl()[0][0];
        assert!((moved - 0.01).abs() < 1e-6, "x stays x, {moved}");
    }
    // Both motions of a pair are in one group.
    let entries = release.contents().entries.iter();
    let groups: Vec<_> = entries
        .map(|entry| (entry.split, entry.group.as_deref()))
        .collect();
    assert_eq!(groups, [(None, Some("000001")); 2]);
}

#[test]
fn broken_pairs_and_dumps_are_on_record() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let put = |file: &str, content: &[u8]| put(dir.path(), file, content);
    let mut broken = pair(10, "");
    if let Value::Dict(entries) = &mut broken {
        entries.remove(0);
    }
    put_dump(dir.path(), "motionfix.pth.tar", &[("000001", broken)], true);
    put("motionfix_a.pth.tar", b"cos\nsystem\n(S'true'\ntR.");
    let pointer = b"version https://git-lfs.github.com/spec/v1\noid\n";
    put("motionfix_b.pth.tar", pointer);
    put("motionfix_c.pth.tar", b"\x80\x04].");
    put("splits.json", b"[");
    let files = files_under(dir.path());
    let release = only_release(FORMAT, &files);
    let expected = [
        "E-MOTIONFIX-JSON",
        "E-PICKLE-REFUSED",
        "E-LFS-POINTER",
        "E-MOTIONFIX-KEYS",
    ];
    assert_eq!(codes(&*release), expected);
    let entry = &release.contents().entries[0];
    let read = release.read(&files, entry, &ReadOptions::default());
    assert_eq!(read.expect_err("no motion").code, "E-MOTIONFIX-KEYS");
}

#[test]
fn answers_name_parts() {
    for (answer, parts) in [
        (
            "Answer: right arm\nleft arm",
            &[BodyPart::LeftArm, BodyPart::RightArm][..],
        ),
        (
            "Answer: left leg , left arm",
            &[BodyPart::LeftArm, BodyPart::LeftLeg],
        ),
        (
            "Answer: right leg\nleft leg\nButtocks",
            &[BodyPart::LowerBody],
        ),
        ("Answer: right arm.", &[BodyPart::RightArm]),
        ("Answer: no body parts", &[]),
        ("", &[]),
    ] {
        assert_eq!(parse_parts(answer).0, parts, "{answer}");
    }
}

#[test]
fn the_real_label_files_are_passed_over_without_a_dump() {
    let Some(folder) = test_data("motionfix_labels") else {
        return;
    };
    let files = files_under(&folder);
    let release = only_release(FORMAT, &files);
    assert_eq!(release.contents().passed_over.len(), files.len());
    assert!(release.contents().entries.is_empty() && release.contents().rejected.is_empty());
    let labels = files.read("gpt-labels_full_v2.json").expect("there");
    let labels: BTreeMap<String, String> = serde_json::from_slice(&labels).expect("a map");
    let understood = labels
        .values()
        .filter(|answer| !parse_parts(answer).0.is_empty());
    // All but about twenty answers name a part.
    assert!(understood.count() + 30 > labels.len());
}
