use std::path::Path;

use datasets_spec::{Skeleton, Split};
use glam::{DQuat, DVec3};
use kinematics::rotation::{angle_between, from_axis_angle};
use proptest::prelude::*;
use testkit::{npy, npy_f8};

use super::*;
use crate::source::release_tests::{
    assert_refused, assert_says, clip_of, edited, files_of, only_release, planned, why_passed_over,
};
use crate::source::{ReadOptions, Recognised, recognise};
use clip::Rejected;

/// Rows whose numbers identify their columns, except in the pose.
fn rows(num_frames: usize) -> Vec<f64> {
    let mut values = Vec::new();
    for frame in 0..num_frames {
        let mut row: Vec<f64> = (0..322).map(|column| 100.0 + f64::from(column)).collect();
        row[..66].fill(0.0);
        // The left elbow is bent forward by a right angle; the root faces +x.
        row[1] = std::f64::consts::FRAC_PI_2;
        row[3 * 18 + 1] = -std::f64::consts::FRAC_PI_2;
        row[309..312].copy_from_slice(&[0.01 * frame as f64, 1.0, -2.0]);
        values.extend(row);
    }
    values
}

fn file(num_frames: usize) -> Vec<u8> {
    npy_f8(&[num_frames, 322], &rows(num_frames))
}

fn read(bytes: &[u8]) -> Result<clip::SourceClip, Rejected> {
    read_array(bytes, &Skeleton::smplx_neutral())
}

#[test]
fn the_columns_are_the_root_the_body_and_the_translation() {
    let skeleton = Skeleton::smplx_neutral();
    let clip = read(&file(4)).expect("valid");
    assert_eq!((clip.motion.len(), clip.motion.fps().get()), (4, 30.0));
    let pose = clip.motion.pose(2);
    let root = DQuat::from_rotation_y(std::f64::consts::FRAC_PI_2);
    assert!(angle_between(pose.rotations[0], root) < 1e-6);
    let elbow = from_axis_angle(DVec3::NEG_Y * std::f64::consts::FRAC_PI_2);
    assert!(angle_between(pose.rotations[18], elbow) < 1e-6);
    for joint in (1..22).filter(|joint| *joint != 18) {
        let off = angle_between(pose.rotations[joint], DQuat::IDENTITY);
        assert!(off < 1e-6, "{joint}");
    }
    assert!((pose.transl.x - 0.02).abs() < 1e-6 && (pose.transl.z + 2.0).abs() < 1e-6);
    let points = skeleton.keypoints(&pose);
    // Facing +x, the left arm lies along -z and its forearm, bent to the front, along +x.
    let bone = |from: usize, to: usize| (skeleton.rest(to) - skeleton.rest(from)).normalize();
    let along = |from: usize, to: usize| (points[to] - points[from]).normalize();
    assert!(along(16, 18).distance(root * bone(16, 18)) < 1e-6);
    assert!(along(18, 20).distance(root * elbow * bone(18, 20)) < 1e-6);
    assert!(along(16, 18).dot(DVec3::NEG_Z) > 0.9);
    assert!(along(18, 20).dot(DVec3::X) > 0.9);
    let lowest = points[..22]
        .iter()
        .fold(f64::INFINITY, |low, point| low.min(point.y));
    assert!(lowest.abs() < 0.05, "on the floor: {lowest}");
}

#[test]
fn arrays_are_recognised_by_their_shape() {
    let format = |path: &str, bytes: &[u8]| match recognise(Path::new(path), bytes) {
        Recognised::Motion(format) => Some(format.as_str()),
        Recognised::NotMotion { .. } => None,
    };
    assert_eq!(format("a/000001.npy", &file(2)[..256]), Some("motion-x"));
    let other = |width: usize| npy_f8(&[2, width], &vec![0.0; 2 * width]);
    assert_eq!(format("a/000001.npy", &other(263)), Some("humanml3d"));
    assert_eq!(format("a/000001.npy", &other(321)), None);
    assert_eq!(format("a/000001.bin", &file(2)), None);
}

#[test]
fn what_is_wrong_is_rejected_with_its_place() {
    let good = file(3);
    let start = good.len() - 8 * 3 * 322;
    let mut nan = good.clone();
    let at = start + 8 * (322 + 5);
    nan[at..at + 8].copy_from_slice(&f64::NAN.to_le_bytes());
    let rejected = read(&nan).expect_err("not finite");
    assert_refused(&rejected, "E-NOT-FINITE", "frame 1, column 5");
    assert_eq!(rejected.byte_offset, Some(at as u64));
    // Faces are not used, whatever they contain.
    let mut face = good.clone();
    let at = start + 8 * 200;
    face[at..at + 8].copy_from_slice(&f64::NAN.to_le_bytes());
    assert!(read(&face).is_ok());
    let objects = "{'descr': '|O', 'fortran_order': False, 'shape': (2, 322), }\n";
    let pointer = b"version https://git-lfs.github.com/spec/v1\n".to_vec();
    for (bytes, code) in [
        (good[..good.len() - 5].to_vec(), "E-NPY-SHAPE"),
        (good[..40].to_vec(), "E-NPY-HEADER"),
        (npy_f8(&[2, 321], &[0.0; 642]), "E-MOTIONX-SHAPE"),
        (npy_f8(&[2, 2, 322], &[0.0; 1288]), "E-MOTIONX-SHAPE"),
        (file(1), "E-TOO-SHORT"),
        (npy_f8(&[0, 322], &[]), "E-TOO-SHORT"),
        (npy(objects, b"\x80\x04N."), "E-PICKLE-REFUSED"),
        (pointer, "E-LFS-POINTER"),
    ] {
        assert_eq!(read(&bytes).expect_err(code).code, code);
    }
}

#[test]
fn a_body_on_its_head_is_noted() {
    let mut values = rows(2);
    for row in values.chunks_exact_mut(322) {
        row[..3].copy_from_slice(&[std::f64::consts::PI, 0.0, 0.0]);
    }
    let clip = read(&npy_f8(&[2, 322], &values)).expect("valid");
    assert_says(&clip, "upside down");
}

#[test]
fn a_release_has_captions_splits_and_mirrored_copies() {
    let motion = file(3);
    let (_dir, files) = files_of(&[
        (
            "x/motion_data/smplx_322/idea400/subset_0000/Wave_clip1.npy",
            &motion,
        ),
        ("x/motion_data/smplx_322/humanml/000003.npy", &motion),
        ("x/motion_data/smplx_322/humanml/M000003.npy", &motion),
        ("x/motion_data/smplx_322/kungfu/broken.npy", &motion[..200]),
        ("x/face_motion_data/smplx_322/humanml/000003.npy", &motion),
        (
            "x/texts/semantic_labels/idea400/subset_0000/Wave_clip1.txt",
            b"a person waves\n",
        ),
        (
            "x/texts/semantic_labels/humanml/000003.txt",
            b"a man kicks#a/DET man/NOUN kick/VERB#0.5#1.0\n",
        ),
        (
            "x/texts/semantic_labels/dance/gone.txt",
            b"a person dances\n",
        ),
        (
            "x/train.txt",
            b"idea400/subset_0000/Wave_clip1\nhumanml/M000003\n",
        ),
        ("x/test.txt", b"humanml/000003\n"),
    ]);
    let release = only_release(FORMAT, &files);
    let contents = release.contents();
    assert_eq!(
        planned(&*release),
        [
            ("humanml/000003", Some(Split::Test), None),
            ("humanml/M000003", Some(Split::Test), Some("humanml/000003")),
            ("idea400/subset_0000/Wave_clip1", Some(Split::Train), None),
            ("kungfu/broken", None, None),
        ]
    );
    let options = ReadOptions::default();
    let read = |index: usize| release.read(&files, &contents.entries[index], &options);
    let kick = read(0).expect("a clip");
    assert_eq!(kick.captions[0].text, "a man kicks");
    assert_eq!((kick.captions[0].from_s, kick.captions[0].to_s), (0.5, 1.0));
    assert_says(&kick, "several splits (train, test)");
    assert!(read(1).expect("a clip").captions.is_empty());
    assert_eq!(read(2).expect("a clip").captions[0].text, "a person waves");
    assert_eq!(read(3).expect_err("cut off").code, "E-NPY-SHAPE");
    let why = |file: &str| why_passed_over(&*release, file);
    let face = why("x/face_motion_data/smplx_322/humanml/000003.npy");
    assert_eq!(face, "facial expressions of Motion-X, no body");
    let gone = why("x/texts/semantic_labels/dance/gone.txt");
    assert_eq!(gone, "captions without a motion");
    assert_eq!(contents.passed_over.len(), 1 + 3 + 2);
}

#[test]
fn the_folders_of_motion_x_plus_plus_are_read_too() {
    let motion = file(2);
    let (_dir, files) = files_of(&[
        ("motion/motion_generation/smplx322/animation/a.npy", &motion),
        ("text/semantic_label/animation/a.txt", b"a figure jumps\n"),
    ]);
    let clip = clip_of(&*only_release(FORMAT, &files), &files, "animation/a");
    assert_eq!(clip.captions[0].text, "a figure jumps");
}

proptest! {
    #[test]
    fn no_bytes_make_it_panic(
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        cut in any::<prop::sample::Index>(),
    ) {
        let mut bytes = edited(&file(2), edits);
        bytes.truncate(cut.index(bytes.len() + 1));
        let _clip = read(&bytes);
    }
}
