use std::io::Cursor;

use kinematics::rotation::angle_between;
use proptest::prelude::*;

use pickle::npy;
use testkit::{npy, npy_f8, npz};

use super::*;
use crate::source::release_tests::{assert_refused, assert_says, edited};
use datasets_spec::Skeleton;
use glam::{DQuat, DVec3};

pub(crate) use testkit::clip_members;

fn read_members(members: &[(&str, Vec<u8>)]) -> Result<Outcome, Rejected> {
    let options = ReadOptions::default();
    read(Path::new("clip_poses.npz"), &npz(members), &options)
}

fn clip_at(path: &str, members: &[(&str, Vec<u8>)], rate: Option<Fps>) -> SourceClip {
    let options = ReadOptions {
        rate,
        ..ReadOptions::default()
    };
    match read(Path::new(path), &npz(members), &options) {
        Ok(Outcome::Clip(clip)) => *clip,
        outcome => panic!("{path}: {outcome:?}"),
    }
}

fn clip(members: &[(&str, Vec<u8>)]) -> SourceClip {
    clip_at("clip_poses.npz", members, None)
}

fn code(members: &[(&str, Vec<u8>)]) -> &'static str {
    match read_members(members) {
        Err(rejected) => rejected.code,
        Ok(_) => "accepted",
    }
}

#[test]
fn a_body_facing_minus_y_in_z_up_faces_plus_z_in_the_store() {
    let skeleton = Skeleton::smplx_neutral();
    // A standing body of AMASS: a quarter turn about x, so that it faces -y.
    let mut poses = vec![0.0; 2 * 72];
    for frame in 0..2 {
        poses[72 * frame] = std::f64::consts::FRAC_PI_2;
    }
    let trans = [1.0, 2.0, 3.0, 1.5, 2.0, 3.0];
    let clip = clip(&[
        ("poses", npy_f8(&[2, 72], &poses)),
        ("trans", npy_f8(&[2, 3], &trans)),
        ("mocap_frame_rate", npy_f8(&[], &[60.0])),
    ]);
    assert_eq!(clip.motion.fps().get(), 60.0);
    let pose = clip.motion.pose(0);
    // It faces +z.
    assert!(pose.rotations[0].angle_between(DQuat::IDENTITY) < 1e-6);
    let pelvis = skeleton.keypoints(&pose)[0];
    let in_file = DVec3::new(1.0, 2.0, 3.0) + skeleton.rest(0);
    // Only the height is free: it is set by the floor.
    assert!((pelvis.x - in_file.x).abs() < 1e-6 && (pelvis.z + in_file.y).abs() < 1e-6);
    let moved = skeleton.keypoints(&clip.motion.pose(1))[0] - pelvis;
    assert!((moved - DVec3::X * 0.5).length() < 1e-6);
}

#[test]
fn all_layouts_carry_the_same_body_rotations() {
    let split = {
        let mut members = clip_members(4, 165);
        let poses = npy::read_numbers("poses", &members[0].1).expect("valid");
        let columns = |poses: &npy::Array, range: std::ops::Range<usize>| -> Vec<f64> {
            let rows = poses.values.chunks_exact(poses.shape[1]);
            rows.flat_map(|row| row[range.clone()].to_vec()).collect()
        };
        members[0] = ("root_orient", npy_f8(&[4, 3], &columns(&poses, 0..3)));
        members.push(("pose_body", npy_f8(&[4, 63], &columns(&poses, 3..66))));
        members
    };
    for members in [
        clip_members(4, 72),
        clip_members(4, 156),
        clip_members(4, 165),
        split,
    ] {
        let motion = clip(&members).motion;
        assert_eq!((motion.len(), motion.fps().get()), (4, 120.0));
        let poses = match npy::read_numbers("poses", &members[0].1).expect("valid") {
            npy::Array { shape, values } if shape[1] > 3 => values[3..66].to_vec(),
            _ => npy::read_numbers("pose_body", &members[4].1)
                .expect("valid")
                .values[..63]
                .to_vec(),
        };
        for (stored, in_file) in motion.body_pose()[0].iter().zip(poses) {
            assert_eq!(*stored, in_file as f32, "copied, not recomputed");
        }
    }
}

#[test]
fn a_clip_read_at_a_rate_is_the_whole_clip_resampled() {
    // At 120 fps, frames at 20 and 30 fps are frames of the file; frames at 25 fps lie between two.
    for (fps, between) in [(20.0, false), (30.0, false), (25.0, true)] {
        let members = clip_members(100, 156);
        let fps = Fps::new(fps).expect("a rate");
        let [whole, at_rate] = [None, Some(fps)].map(|rate| clip_at("x.npz", &members, rate));
        assert_eq!(at_rate.source_fps, whole.motion.fps());
        assert_eq!(at_rate.source_frames, 0..100);
        let resampled = resample::Resample::Exact
            .apply(&whole.motion, fps)
            .expect("resampled");
        assert_eq!(at_rate.motion.len(), resampled.len());
        // The floor is estimated from different frames, so the heights differ by a constant.
        let rise = at_rate.motion.transl()[0][1] - resampled.transl()[0][1];
        for frame in 0..resampled.len() {
            let (found, expected) = (at_rate.motion.pose(frame), resampled.pose(frame));
            let apart = found.transl - expected.transl - DVec3::Y * f64::from(rise);
            assert!(apart.length() < 1e-6, "{apart}");
            for joint in 0..22 {
                let (found, expected) = (found.rotations[joint], expected.rotations[joint]);
                // One side was stored in f32 once, the other twice.
                assert!(angle_between(found, expected) < 1e-6);
            }
            if !between {
                let copied = at_rate.motion.body_pose()[frame];
                let stride = (120.0 / fps.get()) as usize;
                assert_eq!(copied, whole.motion.body_pose()[stride * frame], "bits");
            }
        }
    }
}

#[test]
fn what_is_wrong_is_rejected_by_code() {
    let without = |key: &str| -> Vec<(&'static str, Vec<u8>)> {
        clip_members(3, 156)
            .into_iter()
            .filter(|(found, _)| *found != key)
            .collect()
    };
    let with = |key: &'static str, bytes: Vec<u8>| {
        let mut members = without(key);
        members.push((key, bytes));
        members
    };
    let objects = "{'descr': '|O', 'fortran_order': False, 'shape': (3, 3), }";
    let lie = "{'descr': '<f8', 'fortran_order': False, 'shape': (1099511627776, 156), }";
    let short = npy_f8(&[2, 3], &[0.0; 6]);
    let call = npy(objects, b"cos\nsystem\n.");
    for (members, expected) in [
        (clip_members(3, 156), "accepted"),
        (without("trans"), "E-AMASS-KEYS"),
        (without("mocap_framerate"), "E-AMASS-FPS"),
        (with("mocap_framerate", npy_f8(&[], &[0.0])), "E-AMASS-FPS"),
        (with("mocap_framerate", npy_f8(&[0], &[])), "E-AMASS-FPS"),
        (with("trans", short), "E-AMASS-SHAPE"),
        (with("trans", npy_f8(&[9], &[0.0; 9])), "E-AMASS-SHAPE"),
        (clip_members(3, 100), "E-AMASS-SHAPE"),
        (clip_members(0, 156), "E-TOO-SHORT"),
        (with("trans", call), "E-PICKLE-REFUSED"),
        (with("poses", npy(lie, &[0; 16])), "E-NPY-SHAPE"),
    ] {
        let names: Vec<&str> = members.iter().map(|(name, _)| *name).collect();
        assert_eq!(code(&members), expected, "{names:?}");
    }
    let mut trans = vec![0.0; 9];
    trans[7] = f64::NAN;
    let rejected = read_members(&with("trans", npy_f8(&[3, 3], &trans))).expect_err("not a number");
    assert_refused(&rejected, "E-NOT-FINITE", "frame 2");
    // An unreadable pickled gender is dropped; the clip is kept.
    let pickled = npy(
        "{'descr': '|O', 'fortran_order': False, 'shape': (), }",
        b".",
    );
    assert_says(&clip(&with("gender", pickled)), "pickled");
}

#[test]
fn arrays_that_contradict_each_other_are_refused_with_both_numbers() {
    let poses = npy::read_numbers("poses", &clip_members(3, 156)[0].1).expect("valid");
    let mut body: Vec<f64> = poses
        .values
        .chunks_exact(156)
        .flat_map(|row| row[3..66].to_vec())
        .collect();
    let read = |body: &[f64], fps: f64| {
        let mut members = clip_members(3, 156);
        members.push(("pose_body", npy_f8(&[body.len() / 63, 63], body)));
        members.push(("mocap_frame_rate", npy_f8(&[], &[fps])));
        read_members(&members)
    };
    assert!(read(&body, 120.000_045_776).is_ok(), "the same twice");
    let rejected = read(&body, 60.0).expect_err("two rates");
    assert_refused(&rejected, "E-AMASS-FPS", "mocap_frame_rate 60");
    body[63] += 0.5;
    let rejected = read(&body, 120.000_045_776).expect_err("two poses");
    assert_refused(&rejected, "E-AMASS-KEYS", "in frame 1 of pose_body");
    let rejected = read(&body[..126], 120.000_045_776).expect_err("two lengths");
    assert_refused(&rejected, "E-AMASS-KEYS", "2 frames in pose_body");
}

#[test]
fn shapes_without_motion_are_passed_over() {
    let numbers = || npy_f8(&[16], &[0.0; 16]);
    for keys in [&["betas"][..], &["betas", "gender", "markers_latent"]] {
        let members: Vec<(&str, Vec<u8>)> = keys.iter().map(|key| (*key, numbers())).collect();
        let shape = read_members(&members).expect("known");
        assert!(matches!(shape, Outcome::Skipped { .. }), "{keys:?}");
    }
    let other = [("posed_joints", numbers()), ("foot_contacts", numbers())];
    assert_eq!(code(&other), "E-AMASS-KEYS");
}

#[test]
fn known_wrong_rates_are_corrected_noted_and_flagged() {
    let read_clip = |path: &str| clip_at(path, &clip_members(5, 156), None);
    let corrected = read_clip("BMLhandball/S01/x_poses.npz");
    assert_eq!(corrected.motion.fps().get(), 240.0);
    assert_eq!(corrected.flags, FLAG_FPS_DOUBTFUL);
    assert_says(&corrected, "120.000045776");
    assert_says(&corrected, "240");

    let plain = read_clip("BioMotionLab_NTroje/rub001/x_poses.npz");
    assert_eq!((plain.motion.fps().get(), plain.flags), (120.0, 0));
    assert_says(&plain, "BMLrub");
}

#[test]
fn every_spelling_of_gender_is_read() {
    let scalar = |descr: &str, bytes: &[u8]| {
        npy(
            &format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': (), }}"),
            bytes,
        )
    };
    let unicode: Vec<u8> = "male"
        .chars()
        .flat_map(|c| (c as u32).to_le_bytes())
        .collect();
    let in_array = npy(
        "{'descr': '|S6', 'fortran_order': False, 'shape': (1,), }",
        b"female",
    );
    for (bytes, gender) in [
        (scalar("<U4", &unicode), "gender male"),
        (scalar("|S7", b"neutral"), "gender neutral"),
        (scalar("|S7", b"b'male'"), "gender male"),
        (in_array, "gender female"),
    ] {
        let mut members = clip_members(3, 165);
        members.retain(|(key, _)| *key != "gender");
        members.push(("gender", bytes));
        let notes = clip(&members).notes.join("; ");
        assert!(notes.contains(gender), "{notes}");
    }
}

#[test]
fn the_variant_is_told_from_the_headers() {
    for (width, variant) in [
        (66, Variant::BodyOnly),
        (72, Variant::Smpl),
        (156, Variant::SmplH),
        (165, Variant::SmplXGendered),
    ] {
        let bytes = npz(&clip_members(7, width));
        let (found, frames, fps) = peek(Cursor::new(&bytes))
            .expect("a whole archive")
            .expect("a motion");
        assert_eq!((found, frames), (variant, 7));
        assert!((fps - 120.0).abs() < 1e-3);
    }
    let shape = npz(&[("betas", npy_f8(&[16], &[0.0; 16]))]);
    assert_eq!(peek(Cursor::new(&shape)), Ok(None));
}

#[test]
fn damaged_archives_are_rejected_by_code() {
    let bytes = npz(&clip_members(30, 156));
    let code = |bytes: &[u8]| {
        let read = read(Path::new("x"), bytes, &ReadOptions::default());
        read.expect_err("damaged").code
    };
    for len in [0, 3, 100, bytes.len() / 2, bytes.len() - 1] {
        assert_eq!(code(&bytes[..len]), "E-NPZ-TRUNCATED", "{len} bytes");
    }
}

proptest! {
    #[test]
    fn no_bytes_make_it_panic(
        bytes in prop::collection::vec(any::<u8>(), 0..300),
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cut in any::<prop::sample::Index>(),
    ) {
        let valid = npz(&clip_members(2, 72));
        let mutated = edited(&valid, edits);
        for candidate in [&bytes[..], &mutated, &valid[..cut.index(valid.len())]] {
            let _ = peek(Cursor::new(candidate));
            if let Ok(Outcome::Clip(clip)) = read(Path::new("x"), candidate, &ReadOptions::default()) {
                prop_assert!(clip.motion.len() == clip.source_frames.len());
            }
        }
    }
}
