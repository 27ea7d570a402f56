use std::fs;

use datasets_spec::{BodyPart, Skeleton, Split};
use proptest::prelude::*;

use super::*;
use crate::source::options::ReadOptions;
use crate::source::release_tests::{
    assert_says, clip_of, codes, entry_of, files_under, only_release, planned, test_data,
};
use clip::check::{FLAG_FPS_DOUBTFUL, check};
use pickle::{Value, encode};

use testkit::{adjustment, dictionary, put, swinging as motion, write_release};

#[test]
fn a_release_becomes_motions_masks_and_pairs() {
    let dir = tempfile::tempdir().expect("temporary folder");
    write_release(dir.path());
    let files = files_under(dir.path());
    let release = only_release(FORMAT, &files);
    let adjustment = "adjustment/paired_data_seed0_15_batch0_id3";
    let (source, target) = (format!("{adjustment}#src"), format!("{adjustment}#tgt"));
    assert_eq!(
        planned(&*release),
        [
            // The style list also decides the split of the clip and its mirrored copy.
            ("000009", Some(Split::Test), None),
            ("000010", Some(Split::Val), None),
            ("000012", Some(Split::Train), None),
            ("M000009", Some(Split::Test), Some("000009")),
            ("000009#proud", Some(Split::Test), None),
            (&source, Some(Split::Val), None),
            (&target, Some(Split::Val), None),
        ]
    );
    let contents = release.contents();
    assert_eq!(contents.passed_over.len(), 6, "{:?}", contents.passed_over);
    assert_eq!(contents.rejected, []);

    let base = clip_of(&*release, &files, "000009");
    assert_eq!(base.motion, motion(1, 30), "bit for bit");
    let masks = base.masks.iter();
    let said: Vec<_> = masks
        .map(|mask| (mask.parts[0], mask.text.as_str()))
        .collect();
    let expected = [
        (BodyPart::LeftArm, "waving"),
        (BodyPart::LowerBody, "kneeling"),
    ];
    assert_eq!(said, expected);
    assert_eq!(base.part_captions[0].part, "LEFT_ARM");
    let mirrored = clip_of(&*release, &files, "M000009");
    assert_eq!(mirrored.masks[0].text, "stretching");
    assert_says(&mirrored, "014625");

    let styled = clip_of(&*release, &files, "000009#proud");
    assert_eq!(styled.style.as_deref(), Some("proud"));
    let edit = &styled.edits[0];
    assert_eq!((edit.source_id.as_str(), edit.kind), ("000009", "style"));
    assert_eq!(edit.instruction, "", "the release has no words");
    let adjusted = &clip_of(&*release, &files, &target).edits[0];
    assert_eq!(adjusted.source_id, source);
    assert_eq!(adjusted.parts, [BodyPart::LeftArm]);
    assert_eq!(adjusted.instruction, "raise it higher");
    assert_eq!(clip_of(&*release, &files, &source).edits, []);
}

#[test]
fn the_earlier_layout_is_read_too_and_broken_parts_are_on_record() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let put = |file: &str, content: &[u8]| put(dir.path(), file, content);
    let base = encode(&dictionary(&motion(1, 5)));
    put("data/base_motion/humanml3d_pkl_all/000001.pkl", &base);
    let pointer = b"version https://git-lfs.github.com/spec/v1\n";
    put("data/base_motion/humanml3d_pkl_all/000002.pkl", pointer);
    let styled = "data/style_transfer/humanml3d_stylized";
    put(&format!("{styled}/000001_old.pkl"), &base);
    put(&format!("{styled}/readme.pkl"), &base);
    let wordless = Value::dict([
        ("src", dictionary(&motion(2, 5))),
        ("tgt", dictionary(&motion(3, 5))),
    ]);
    for name in ["a", "b"] {
        let file = format!("data/adjustment/paired_pickle/{name}.pkl");
        put(&file, &encode(&wordless));
    }
    let beside = r#"{"a": {"body_part": "left arm", "text": "lower"}}"#;
    let words = "data/adjustment/adjustment_annotations_part.json";
    put(words, beside.as_bytes());
    // Several files are one; a file of another form, and one that says something else of a motion, are rejected.
    let other = "data/adjustment/adjustment_annotations_zoo.json";
    put(other, br#"{"b.pkl": {"body_part": "head", "text": "nod"}}"#);
    put("data/adjustment/adjustment_annotations_zz.json", b"[]");
    put(
        "data/adjustment/adjustment_annotations_zzz.json",
        br#"{"b": {"text": "shake"}}"#,
    );
    put("data/adjustment/transfer.py", b"");
    put("data/regen/mask_all.json", b"{broken");
    // The bundle for the official demo is not a release.
    put("demo/style_transfer/text.txt", b"a\n");
    let files = files_under(dir.path());
    let release = only_release(FORMAT, &files);
    // Without lists there are no splits.
    let expected = [
        "000001",
        "000002",
        "000001#old",
        "adjustment/a#src",
        "adjustment/a#tgt",
        "adjustment/b#src",
        "adjustment/b#tgt",
    ];
    assert_eq!(planned(&*release), expected.map(|id| (id, None, None)));
    let [broken, name] = ["E-STANCE-JSON", "E-STANCE-NAME"];
    assert_eq!(codes(&*release), [broken, broken, broken, name]);
    for (id, text, part) in [
        ("adjustment/a#tgt", "lower", BodyPart::LeftArm),
        ("adjustment/b#tgt", "nod", BodyPart::Head),
    ] {
        let edit = &clip_of(&*release, &files, id).edits[0];
        assert_eq!(
            (edit.instruction.as_str(), &edit.parts[..]),
            (text, &[part][..])
        );
    }
    let pointer = entry_of(&*release, "000002");
    let pointer = release.read(&files, pointer, &ReadOptions::default());
    assert_eq!(pointer.expect_err("no motion").code, "E-LFS-POINTER");
}

#[test]
fn a_pickle_that_stands_alone_is_a_motion_if_it_has_the_keys() {
    let skeleton = Skeleton::smplx_neutral();
    let walk = motion(1, 12);
    let read = |value: &Value| read_pickle_motion(&encode(value), &skeleton);
    // Other programs write the same keys at other rates.
    let silent = read(&dictionary(&walk)).expect("a motion");
    assert_eq!(
        (silent.motion, silent.flags),
        (walk.clone(), FLAG_FPS_DOUBTFUL)
    );
    let at = |fps: Value| {
        let Value::Dict(mut entries) = dictionary(&walk) else {
            panic!("a dictionary");
        };
        entries.push((Value::text("fps"), fps));
        read(&Value::Dict(entries))
    };
    let stated = at(Value::Int(30)).expect("a motion");
    assert_eq!((stated.motion.fps().get(), stated.flags), (30.0, 0));
    assert_eq!(at(Value::Float(-1.0)).expect_err("a rate").code, "E-FPS");
    let array = |shape: &[usize]| {
        let count = shape.iter().product();
        Value::floats(shape, vec![0.0; count])
    };
    let with = |body: &[usize], root: &[usize], transl: &[usize]| {
        Value::dict([
            ("body_pose", array(body)),
            ("global_orient", array(root)),
            ("transl", array(transl)),
        ])
    };
    assert!(read(&with(&[4, 21, 3], &[4, 1, 3], &[4, 3])).is_ok());
    let pair = adjustment(&walk, &walk, "HEAD", "");
    for (value, code) in [
        (with(&[4, 63], &[4, 3], &[5, 3]), "E-SMPL-SHAPE"),
        (with(&[4, 69], &[4, 3], &[4, 3]), "E-SMPL-SHAPE"),
        (with(&[252], &[4, 3], &[4, 3]), "E-SMPL-SHAPE"),
        (with(&[0, 63], &[0, 3], &[0, 3]), "E-TOO-SHORT"),
        (Value::List(Vec::new()), "E-STANCE-KEYS"),
        (pair, "E-STANCE-KEYS"),
    ] {
        assert_eq!(read(&value).expect_err(code).code, code);
    }
    let code = read_pickle_motion(b"cos\nsystem\n(S'true'\ntR.", &skeleton);
    assert_eq!(code.expect_err("code").code, "E-PICKLE-REFUSED");
}

#[test]
fn a_dance_of_aist_is_scaled_to_metres_and_put_on_the_floor() {
    let skeleton = Skeleton::smplx_neutral();
    let frames = 6;
    let trans = (0..frames).flat_map(|frame| [0.36 * frame as f32, 180.0, 0.0]);
    let poses = Value::floats(&[frames, 72], vec![0.0; 72 * frames]);
    let value = Value::dict([
        ("smpl_poses", poses),
        ("smpl_trans", Value::floats(&[frames, 3], trans)),
        ("smpl_scaling", Value::floats(&[1], [90.0])),
    ]);
    let clip = read_pickle_motion(&encode(&value), &skeleton).expect("a dance");
    assert_eq!(clip.motion.fps().get(), 60.0);
    let step = clip.motion.transl()[1][0] - clip.motion.transl()[0][0];
    // 0.36 over a scale of 90.
    assert!((step - 0.004).abs() < 1e-6, "{step}");
    let keypoints = skeleton.keypoints(&clip.motion.pose(0));
    let foot = keypoints[10].y.min(keypoints[11].y);
    assert!(foot.abs() < 1e-6, "stands on the floor, {foot}");
}

#[test]
fn the_real_dance_is_read() {
    let Some(path) = test_data("pkl/gBR_sBM_cAll_d04_mBR0_ch01.pkl") else {
        return;
    };
    let bytes = fs::read(&path).expect("a dance");
    let skeleton = Skeleton::smplx_neutral();
    let clip = read_pickle_motion(&bytes, &skeleton).expect("a dance");
    assert_eq!(clip.motion.len(), 720);
    check(&clip.motion, &skeleton).expect("a dance of a human");
    // Upright: the head is above the pelvis in the first frame.
    let keypoints = skeleton.keypoints(&clip.motion.pose(0));
    let [pelvis, head] = [0, 15].map(|joint| keypoints[joint].y);
    assert!(head > pelvis + 0.4, "{head}");
    assert!((0.5..1.3).contains(&pelvis), "{pelvis}");
}

proptest! {
    #[test]
    fn no_lists_make_planning_panic(text in r#"[\[\]{}",:0-9a-zM_ ]{0,60}"#, line in any::<String>()) {
        let dir = tempfile::tempdir().expect("temporary folder");
        put(dir.path(), "base_motion/000001.pkl", "");
        for file in ["regen/mask_all.json", "regen/part_annotations.json", "origin.json"] {
            put(dir.path(), file, &text);
        }
        put(dir.path(), "split/style_transfer/test.json", &text);
        put(dir.path(), "split/base_motion/val.txt", &line);
        let files = files_under(dir.path());
        let release = only_release(FORMAT, &files);
        prop_assert_eq!(release.contents().entries.len(), 1);
        let read = release.read(&files, &release.contents().entries[0], &ReadOptions::default());
        prop_assert!(read.is_err(), "{:?}", read);
    }
}
