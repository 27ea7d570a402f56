use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use datasets_spec::Motion;
use proptest::prelude::*;

use datasets_spec::{Skeleton, Split};
use features::humanml3d::{features_of_joints, joints_of_motion, recover_joints};
use glam::DVec3;
use testkit::walk;
use testkit::{npy, npy_f8};

use super::*;
use crate::source::release_tests::{
    assert_contains, assert_refused, clip_of, edited, files_named, files_of, only_release, planned,
    test_data, why_passed_over,
};
use crate::source::{Files, ReadOptions, Recognised, recognise};
use clip::RotationSource;
use clip::check::FLAG_POOR_FIT;
use pickle::npy;

fn walking() -> Vec<[DVec3; 22]> {
    let motion = Motion::from_poses(FPS, &walk(30)).expect("valid");
    joints_of_motion(&motion, &Skeleton::smplx_neutral())
}

fn vector() -> Vec<u8> {
    let features = features_of_joints(&walking()).expect("long enough");
    let values: Vec<f64> = features.iter().flatten().map(|&v| f64::from(v)).collect();
    npy_f8(&[features.len(), 263], &values)
}

fn joint_file(joints: &[[DVec3; 22]]) -> Vec<u8> {
    let values: Vec<f64> = joints
        .iter()
        .flatten()
        .flat_map(|joint| joint.to_array())
        .collect();
    npy_f8(&[joints.len(), 22, 3], &values)
}

#[test]
fn a_folder_is_found_wherever_it_lies_and_every_file_is_accounted_for() {
    let vector = vector();
    let recovered = {
        let array = npy::read_numbers("x", &vector).expect("valid");
        recover_joints(&features(&array).expect("valid"))
    };
    let joints = joint_file(&recovered);
    let (_folder, files) = files_of(&[
        ("deep/hml/new_joint_vecs/000001.npy", &vector),
        ("deep/hml/new_joint_vecs/M000001.npy", &vector),
        ("deep/hml/new_joints/000001.npy", &joints),
        ("deep/hml/new_joints/000002.npy", &joint_file(&walking())),
        (
            "deep/hml/texts/000001.txt",
            b"a man walks#a/DET#0.0#0.0\n12#34#5#broken\n",
        ),
        ("deep/hml/texts/000009.txt", b"nobody#a/DET#0.0#0.0\n"),
        ("deep/hml/train.txt", b"\xEF\xBB\xBF000001\r\nM000001\r\n\r\n"),
        ("deep/test.txt", b"000002\n000001\n"),
        ("deep/hml/Mean.npy", &npy_f8(&[263], &[0.0; 263])),
        (
            "deep/index.csv",
            b"source_path,start_frame,end_frame,new_name\n./pose_data/KIT/3/a_poses.npy,7,36,000001.npy\n",
        ),
    ]);
    let release = only_release(FORMAT, &files);
    let test = Some(Split::Test);
    let expected = [
        ("000001", test, None),
        ("000002", test, None),
        ("M000001", test, Some("000001")),
    ];
    assert_eq!(planned(&*release), expected);
    assert_eq!(files_named(&*release), files.all().collect::<Vec<_>>());
    let why = why_passed_over(&*release, "deep/hml/texts/000009.txt");
    assert_eq!(why, "captions without a motion");

    let clip = clip_of(release.as_ref(), &files, "000001");
    assert_eq!(clip.motion.len(), 29);
    assert_eq!(clip.rotation_source, RotationSource::Retargeted);
    assert_eq!(clip.source_frames, 7..36);
    assert_eq!(clip.captions[0].tokens, "a/DET");
    assert_eq!(clip.flags, 0);
    let notes = clip.notes.join("\n");
    for part in ["train, test", "KIT/3/a_poses", "1 lines", "within"] {
        assert!(notes.contains(part), "{part}: {notes}");
    }
    let fitted = clip_of(release.as_ref(), &files, "000002");
    assert_eq!(fitted.rotation_source, RotationSource::Fitted);
    assert!(fitted.fit_error_m.expect("measured") < 0.05);
}

#[test]
fn joints_that_contradict_their_vector_are_flagged() {
    let vector = vector();
    let (_folder, files) = files_of(&[
        ("h/new_joint_vecs/000001.npy", &vector),
        ("h/new_joints/000001.npy", &joint_file(&walking()[..29])),
    ]);
    let release = only_release(FORMAT, &files);
    let clip = clip_of(&*release, &files, "000001");
    assert_eq!(clip.flags, FLAG_POOR_FIT, "other bone lengths");
}

#[test]
fn what_is_wrong_is_rejected_by_code() {
    let skeleton = Skeleton::smplx_neutral();
    let code = |bytes: &[u8]| match read_array(bytes, &skeleton) {
        Err(rejected) => (rejected.code, rejected.reason),
        Ok(_) => ("accepted", String::new()),
    };
    assert_eq!(code(&vector()).0, "accepted");
    assert_eq!(code(&npy_f8(&[1, 263], &[0.0; 263])).0, "E-TOO-SHORT");
    assert_eq!(code(&npy_f8(&[0, 263], &[])).0, "E-TOO-SHORT");
    assert_eq!(code(&npy_f8(&[22, 3], &[0.0; 66])).0, "E-TOO-SHORT");
    assert_eq!(code(&npy_f8(&[2, 22, 3], &[0.0; 132])).0, "E-HML-FIT");
    let kit = code(&npy_f8(&[2, 251], &[0.0; 502]));
    assert_eq!(kit.0, "E-HML-SHAPE");
    assert!(kit.1.contains("KIT-ML"));
    let mut broken = vec![0.0; 2 * 263];
    broken[263] = f64::NAN;
    let broken = code(&npy_f8(&[2, 263], &broken));
    assert_eq!(broken.0, "E-HML-FINITE");
    assert_contains(&broken.1, "frame 1");
    let objects = "{'descr': '|O', 'fortran_order': False, 'shape': (2, 263), }";
    assert_eq!(code(&npy(objects, b".")).0, "E-PICKLE-REFUSED");
    let pointer = b"version https://git-lfs.github.com/spec/v1\n";
    assert_eq!(code(pointer).0, "E-LFS-POINTER");
}

#[test]
fn clips_published_without_frames_are_known() {
    let (_folder, files) = files_of(&[("new_joint_vecs/M009707.npy", &npy_f8(&[0, 263], &[]))]);
    let release = only_release(FORMAT, &files);
    let entry = &release.contents().entries[0];
    let read = release.read(&files, entry, &ReadOptions::default());
    let rejected = read.expect_err("no motion");
    assert_refused(&rejected, "E-TOO-SHORT", "published so");
}

#[test]
fn a_lone_array_is_told_by_its_shape() {
    let is_motion = |shape: &[usize]| {
        let bytes = npy_f8(shape, &vec![0.0; shape.iter().product()]);
        recognise(Path::new("a.npy"), &bytes[..128]) == Recognised::Motion(FORMAT)
    };
    assert!(is_motion(&[9, 263]) && is_motion(&[9, 22, 3]) && is_motion(&[9, 251]));
    assert!(!is_motion(&[263]) && !is_motion(&[9, 66]) && !is_motion(&[9, 60, 3]));
    // A body with more joints is refused, not passed over.
    let hands = npy_f8(&[9, 52, 3], &vec![0.0; 9 * 52 * 3]);
    assert!(is_motion(&[9, 52, 3]));
    let skeleton = ReadOptions::default().skeleton;
    let rejected = read_lone(&hands, &skeleton).expect_err("52 joints");
    assert_refused(&rejected, "E-HML-SHAPE", "[9, 52, 3]");
    assert_eq!(recognise_array(b"junk"), Ok(()));
}

#[test]
fn an_index_is_read_by_its_header() {
    let rows = parse_index(
        b"\xEF\xBB\xBFnew_name,source_path,start_frame,end_frame\r\n\
          000001.npy,./pose_data/humanact12/humanact12/P1.npy,0,-1\r\n",
    )
    .expect("columns in another order");
    assert_eq!((rows[0].id.as_str(), rows[0].end), ("000001", None));
    for bad in [
        &b"a,b\n1,2\n"[..],
        b"source_path,start_frame,end_frame,new_name\nx,one,2,3.npy\n",
        b"source_path,start_frame,end_frame,new_name\nx,1,2\n",
    ] {
        assert_eq!(parse_index(bad).expect_err("broken").code, "E-HML-INDEX");
    }
}

proptest! {
    #[test]
    fn no_bytes_make_it_panic(
        bytes in prop::collection::vec(any::<u8>(), 0..200),
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
        values in prop::collection::vec(-1e6..1e6f64, 2 * 263),
    ) {
        let skeleton = Skeleton::smplx_neutral();
        let valid = npy_f8(&[2, 263], &values);
        let mutated = edited(&valid, edits);
        for candidate in [&bytes, &mutated, &valid] {
            let _ = recognise_array(candidate);
            let _ = parse_index(candidate);
            if let Ok(clip) = read_array(candidate, &skeleton) {
                prop_assert!(clip.motion.len() >= 2);
            }
        }
    }
}

#[test]
fn the_published_clip_and_its_neighbours_are_read() {
    let pickled = test_data("motionfix_labels/statistics_motionfix.npy");
    let (Some(folder), Some(pickled)) = (test_data("humanml3d"), pickled) else {
        return;
    };
    let paths = [
        "new_joint_vecs/012314.npy",
        "new_joints/012314.npy",
        "index.csv",
        "train.txt",
        "val.txt",
        "test.txt",
    ]
    .map(|name| (name.to_owned(), folder.join(name)));
    let files = Files::new(BTreeMap::from(paths));
    let release = only_release(FORMAT, &files);
    let clip = clip_of(&*release, &files, "012314");
    assert_eq!((clip.motion.len(), clip.flags), (170, 0));
    assert!(clip.fit_error_m.expect("measured") < 0.03);
    assert!(release.contents().entries[0].split.is_some());
    let skeleton = Skeleton::smplx_neutral();
    clip::check::check(&clip.motion, &skeleton).expect("a plain motion");

    let style = folder.join("100style_feats/Aeroplane_FW_00_feat.npy");
    let [style, pickled] = [style, pickled].map(|path| fs::read(path).expect("readable"));
    assert_eq!(recognise_array(&style), Ok(()));
    let style = read_array(&style, &skeleton).expect("features");
    assert_eq!(style.motion.len(), 352);
    assert_eq!(recognise_array(&pickled), Ok(()));
    let rejected = read_array(&pickled, &skeleton).expect_err("pickled");
    assert_eq!(rejected.code, "E-PICKLE-REFUSED");
}
