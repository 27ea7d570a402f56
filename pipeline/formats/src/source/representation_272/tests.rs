use std::path::Path;

use datasets_spec::{Motion, Split};
use features::released_fps;
use features::representation_272::features_of_motion;
use proptest::prelude::*;
use testkit::walk;
use testkit::{npy, npy_f8};

use super::*;
use crate::source::Recognised;
use crate::source::release_tests::{assert_says, clip_of, edited, files_named, files_of, planned};

fn vector() -> Vec<u8> {
    let motion = Motion::from_poses(released_fps(), &walk(40)).expect("valid");
    let features = features_of_motion(&motion, &Skeleton::smplx_neutral()).expect("at its rate");
    let values = features
        .as_flattened()
        .iter()
        .map(|&value| f64::from(value));
    npy_f8(&[features.len(), WIDTH], &values.collect::<Vec<_>>())
}

#[test]
fn folders_of_both_layouts_are_found_and_every_file_is_accounted_for() {
    let vector = vector();
    let statistics = npy_f8(&[WIDTH], &[0.0; WIDTH]);
    let (_folder, files) = files_of(&[
        ("hml/motion_data/000001.npy", &vector),
        ("hml/motion_data/M000001.npy", &vector),
        (
            "hml/texts/000001.txt",
            b"a man walks#a/DET#0.0#0.0\nhe turns#he/PRON#0.5#1.0\n",
        ),
        ("hml/texts/000007.txt", b"nobody#a/DET#0.0#0.0\n"),
        ("hml/split/train.txt", b"000001\nM000001\n"),
        ("hml/split/test.txt", b"M000001\n"),
        ("hml/mean_std/Mean.npy", &statistics),
        ("hml/mean_std/Std.npy", &statistics),
        ("mm/motion_data/vector_272/set/part_1/a b.npy", &vector),
        (
            "mm/texts/set/part_1/a b.txt",
            b"A person walks.\nSomeone moves, forward.\n",
        ),
        ("mm/split/version1/t2m_60_300/val.txt", b"set/part_1/a b\n"),
        ("mm/split/version1/t2m_60_300/all.txt", b"set/part_1/a b\n"),
        ("mm/mean_std/vector_272/mean.npy", &statistics),
        ("other/motion_data/1.npy", &npy_f8(&[2, 10], &[0.0; 20])),
    ]);
    let releases = find(&files);
    let [hml, mm] = &releases[..] else {
        panic!("two folders, found {}", releases.len());
    };
    // A clip and its mirror image share a split, and test wins.
    let test = Some(Split::Test);
    let expected = [("000001", test, None), ("M000001", test, Some("000001"))];
    assert_eq!(planned(hml.as_ref()), expected);
    let expected = [("set/part_1/a b", Some(Split::Val), None)];
    assert_eq!(planned(mm.as_ref()), expected);
    let others = vec!["other/motion_data/1.npy"];
    let mut named = [files_named(hml.as_ref()), files_named(mm.as_ref()), others].concat();
    named.sort_unstable();
    assert_eq!(named, files.all().collect::<Vec<_>>());

    let clip = clip_of(hml.as_ref(), &files, "000001");
    assert_eq!((clip.motion.len(), clip.motion.fps().get()), (40, 30.0));
    assert_eq!(clip.rotation_source, RotationSource::Native);
    assert!(clip.fit_error_m.expect("measured") < 1e-5);
    assert_eq!(clip.captions[1].tokens, "he/PRON");
    assert_says(&clip, "train, test");
    let clip = clip_of(mm.as_ref(), &files, "set/part_1/a b");
    let texts = clip.captions.iter().map(|said| said.text.as_str());
    let texts: Vec<&str> = texts.collect();
    assert_eq!(texts, ["A person walks.", "Someone moves, forward."]);
}

#[test]
fn a_lone_array_is_told_by_its_width() {
    let head = |shape: &[usize]| npy_f8(shape, &vec![0.0; shape.iter().product()]);
    let recognised = |shape: &[usize]| FORMAT.recognise("npy", "a.npy", &head(shape)[..128]);
    assert_eq!(recognised(&[3, 272]), Some(Recognised::Motion(FORMAT)));
    assert_eq!(recognised(&[272]), None);
    assert_eq!(recognised(&[3, 263]), None);
    assert_eq!(FORMAT.recognise("txt", "a.txt", &head(&[3, 272])), None);
    let found = crate::source::recognise(Path::new("a/walk.npy"), &head(&[3, 272])[..128]);
    assert_eq!(found, Recognised::Motion(FORMAT));
}

#[test]
fn what_is_wrong_is_rejected_by_code() {
    let skeleton = Skeleton::smplx_neutral();
    let code = |bytes: &[u8]| match read_array(bytes, &skeleton) {
        Err(rejected) => (rejected.code, rejected.reason),
        Ok(_) => ("accepted", String::new()),
    };
    assert_eq!(code(&vector()).0, "accepted");
    assert_eq!(code(&npy_f8(&[1, 272], &[0.0; 272])).0, "E-TOO-SHORT");
    assert_eq!(code(&npy_f8(&[0, 272], &[])).0, "E-TOO-SHORT");
    assert_eq!(code(&npy_f8(&[2, 271], &[0.0; 542])).0, "E-272-SHAPE");
    assert_eq!(code(&npy_f8(&[272], &[0.0; 272])).0, "E-272-SHAPE");
    assert_eq!(code(&npy_f8(&[2, 272], &[0.0; 544])).0, "E-272-FIT");
    for broken in [f64::NAN, f64::INFINITY, 1e300] {
        let mut values = vec![0.0; 2 * 272];
        values[300] = broken;
        let (code, reason) = code(&npy_f8(&[2, 272], &values));
        assert_eq!(code, "E-272-FINITE");
        assert!(reason.contains("column 28 of frame 1"), "{reason}");
    }
    let vector = vector();
    assert!(code(&vector[..vector.len() - 9]).0.starts_with("E-NPY"));
    let objects = "{'descr': '|O', 'fortran_order': False, 'shape': (2, 272), }";
    assert_eq!(code(&npy(objects, b".")).0, "E-PICKLE-REFUSED");
    let pointer = b"version https://git-lfs.github.com/spec/v1\n";
    assert_eq!(code(pointer).0, "E-LFS-POINTER");
}

proptest! {
    #[test]
    fn no_bytes_make_it_panic(
        bytes in prop::collection::vec(any::<u8>(), 0..200),
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
        values in prop::collection::vec(-1e6..1e6f64, 2 * WIDTH),
    ) {
        let skeleton = Skeleton::smplx_neutral();
        let valid = npy_f8(&[2, WIDTH], &values);
        let mutated = edited(&valid, edits);
        for candidate in [&bytes, &mutated, &valid] {
            let _ = has_width(candidate);
            if let Ok(clip) = read_array(candidate, &skeleton) {
                prop_assert!(clip.motion.len() >= 2);
            }
        }
    }
}
