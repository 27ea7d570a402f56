//! Skeleton, rotations, windows and normaliser against the released code, SMPL-X and scipy.

use datasets_spec::{Pose, Skeleton};
use glam::{DMat3, DQuat, DVec3, Quat};
use kinematics::KeypointFrame;
use kinematics::canonical::{self, Anchor, GroundTransform, Stitcher};
use kinematics::normalise::{FRAME_WIDTH, NormalizedFrame, Normalizer};
use kinematics::rotation;
use kinematics::skeleton::{FIT_KEYPOINTS, KEYPOINT_JOINTS, NUM_BODY_JOINTS, NUM_JOINTS};

use super::{Golden, quaternion, row_major};

#[test]
fn golden_smplx_fk() {
    let golden = Golden::load("smplx_fk");
    let parents = golden.get("in.parents").integers();
    assert_eq!(parents, kinematics::skeleton::PARENTS.map(i64::from));
    let poses = golden.get("in.pose").points();
    let transl = golden.get("in.transl").points();
    let skeleton = golden.skeleton();

    let mut keypoints = Vec::new();
    let mut fit_joints = Vec::new();
    for (pose, &transl) in poses.chunks_exact(NUM_JOINTS).zip(&transl) {
        let rotations: Vec<DQuat> = pose.iter().map(|&v| rotation::from_axis_angle(v)).collect();
        let body = Pose {
            transl,
            rotations: std::array::from_fn(|joint| rotations[joint]),
        };
        let points = skeleton.keypoints(&body);
        keypoints.extend(points);
        fit_joints.extend(FIT_KEYPOINTS.map(|slot| points[slot]));
    }
    let flat =
        |points: &[DVec3]| -> Vec<f64> { points.iter().flat_map(|p| p.to_array()).collect() };
    // The reference adds 1e-8 to every component before it computes the angle, also in the recorded f64 run, so the
    // tolerance cannot be smaller.
    let recorded = golden.get("out.joints_f64").points();
    for (frame, points) in recorded
        .chunks_exact(NUM_JOINTS)
        .zip(keypoints.chunks_exact(28))
    {
        for (&joint, point) in KEYPOINT_JOINTS.iter().zip(points) {
            assert!((frame[joint] - *point).abs().max_element() < 2e-7);
        }
    }
    golden.check("out.keypoints28", &flat(&keypoints), 2e-6);
    golden.check("out.joints24", &flat(&fit_joints), 2e-6);
    let (points, fitted) = (golden.get("in.sel28"), golden.get("in.to24"));
    assert_eq!(points.integers(), KEYPOINT_JOINTS.map(|j| j as i64));
    assert_eq!(fitted.integers(), FIT_KEYPOINTS.map(|j| j as i64));

    let recorded = golden.get("in.rest_joints").points().into_iter();
    for (joint, recorded) in recorded.enumerate() {
        // Both are the f32 table printed in decimal.
        let distance = (Skeleton::smplx_neutral().rest(joint) - recorded).length();
        assert!(distance < 1e-7, "joint {joint}");
    }
}

#[test]
fn golden_rotation_conversions() {
    let golden = Golden::load("rotation_conversions");
    let vectors = golden.get("in.axis_angle").points();
    let quaternions = vectors.iter().map(|&v| rotation::from_axis_angle(v));
    let quaternions: Vec<DQuat> = quaternions.collect();
    let rotations: Vec<DMat3> = quaternions.iter().map(|&q| DMat3::from_quat(q)).collect();
    let matrices: Vec<f64> = rotations.iter().flat_map(|&m| row_major(m)).collect();
    golden.check("out.matrix", &matrices, 2e-6);
    golden.check("out.matrix_scipy", &matrices, 1e-12);
    let six_d = rotations.iter().flat_map(|&m| rotation::to_six_d_rows(m));
    let six_d: Vec<f64> = six_d.collect();
    golden.check("out.sixd_from_aa", &six_d, 2e-6);
    for (recorded, q) in golden.get("out.quat").rows(4).zip(&quaternions) {
        assert!(rotation::angle_between(quaternion(recorded).normalize(), *q) < 4e-6);
    }
    let recorded = golden.get("out.aa_back").points();
    for (recorded, q) in recorded.into_iter().zip(&quaternions) {
        let back = rotation::to_axis_angle(*q);
        assert!(rotation::angle_between(rotation::from_axis_angle(back), *q) < 1e-12);
        // Compared as rotations: the vector is not unique near pi.
        assert!(rotation::angle_between(rotation::from_axis_angle(recorded), *q) < 4e-6);
    }

    let decoded: Vec<DMat3> = golden
        .get("in.sixd")
        .rows(6)
        .map(|d| rotation::from_six_d_rows(d.try_into().expect("six numbers")))
        .collect();
    let flat: Vec<f64> = decoded.iter().flat_map(|&m| row_major(m)).collect();
    golden.check("out.matrix_from_sixd", &flat, 2e-6);
    let recorded = golden.get("out.aa_from_sixd").points();
    for (recorded, m) in recorded.into_iter().zip(&decoded) {
        let q = DQuat::from_mat3(m);
        assert!(rotation::angle_between(rotation::from_axis_angle(recorded), q) < 4e-6);
    }
    for (recorded, m) in golden.get("out.euler_zxy").rows(3).zip(&decoded) {
        let yaw = rotation::yaw(*m);
        let difference = (yaw - recorded[2]).sin().abs();
        assert!(difference < 2e-6, "yaw {yaw} recorded {}", recorded[2]);
    }
}

#[test]
fn golden_slerp() {
    let golden = Golden::load("slerp");
    let from: Vec<DQuat> = golden.get("in.q0").rows(4).map(quaternion).collect();
    let to: Vec<DQuat> = golden.get("in.q1").rows(4).map(quaternion).collect();
    let alpha = &golden.get("in.alpha").values;
    let kind = golden.get("in.kind").integers();
    let recorded: Vec<&[f64]> = golden.get("out.matrix").rows(9).collect();
    let official: Vec<&[f64]> = golden.get("out.official_quat").rows(4).collect();
    for i in 0..from.len() {
        let got = row_major(DMat3::from_quat(rotation::slerp(from[i], to[i], alpha[i])));
        // Pairs of kind 4 are 1e-8 to 0.1 rad from a half turn, where the shorter arc flips.
        let tolerance = if kind[i] == 4 { 1e-9 } else { 1e-12 };
        for (a, b) in got.iter().zip(recorded[i]) {
            assert!(
                (a - b).abs() <= tolerance,
                "pair {i} of kind {}: {a} recorded {b}",
                kind[i]
            );
        }
        if official[i].iter().any(|v| v.is_nan()) {
            continue;
        }
        let narrow = |q: DQuat| Quat::from_xyzw(q.x as f32, q.y as f32, q.z as f32, q.w as f32);
        let got = rotation::slerp_official(narrow(from[i]), narrow(to[i]), alpha[i] as f32);
        let recorded = quaternion(official[i]);
        let got = got.as_dquat();
        let distance = (got - recorded).length().min((got + recorded).length());
        assert!(
            distance < 2e-5,
            "official pair {i} of kind {}: {got} recorded {recorded}",
            kind[i]
        );
    }
}

#[test]
fn golden_motionrefit_windows() {
    let golden = Golden::load("motionrefit_windows");
    let skeleton = golden.skeleton();
    let transl = golden.get("in.transl").points();
    let orient = golden.get("in.global_orient").points();
    let body = golden.get("in.body_pose").points();
    let starts = golden.get("in.starts").integers();
    let window = golden.get("out.windows").shape[1];
    let pose = |frame: usize| {
        let joint = |j: usize| match j {
            0 => orient[frame],
            _ => body[frame * (NUM_BODY_JOINTS - 1) + j - 1],
        };
        Pose {
            transl: transl[frame],
            rotations: std::array::from_fn(|j| rotation::from_axis_angle(joint(j))),
        }
    };
    let (mut windows, mut translations, mut yaws) = (Vec::new(), Vec::new(), Vec::new());
    let mut orientations = golden.get("out.canon_orient").points().into_iter();
    for &start in &starts {
        let mut segment: Vec<Pose> = (0..window).map(|i| pose(start as usize + 2 * i)).collect();
        let placement = canonical::canonicalise(&mut segment, Anchor::Translation, &skeleton)
            .expect("a window has frames");
        yaws.push(placement.yaw_rad);
        for pose in &segment {
            windows.extend(skeleton.keypoints(pose).iter().flat_map(|p| p.to_array()));
            translations.extend(pose.transl.to_array());
            let recorded = rotation::from_axis_angle(orientations.next().expect("recorded"));
            assert!(rotation::angle_between(recorded, pose.rotations[0]) < 5e-6);
        }
    }
    golden.check("out.windows", &windows, 5e-6);
    golden.check("out.canon_transl", &translations, 5e-6);
    golden.check("out.yaw", &yaws, 1e-12);
}

#[test]
fn golden_motionrefit_kabsch() {
    let golden = Golden::load("motionrefit_kabsch");
    let rest: [DVec3; 3] = golden.points("in.rest_triangle");
    let points = golden.get("in.points").points();
    let rotations: Vec<&[f64]> = golden.get("out.R").rows(9).collect();
    let shifts = golden.get("out.t").points();
    let yaws = &golden.get("out.yaw").values;
    let transforms: Vec<&[f64]> = golden.get("out.transform").rows(16).collect();
    let count = points.len() / 3;
    for (i, triangle) in points.chunks_exact(3).enumerate() {
        // The last two rows are a mirrored and an almost degenerate triangle.
        let tolerance = if i + 2 >= count { 1e-3 } else { 1e-6 };
        let triangle: [DVec3; 3] = triangle.try_into().expect("a triangle");
        let (rotation, shift) = canonical::kabsch(&rest, &triangle);
        for (a, b) in row_major(rotation).iter().zip(rotations[i]) {
            assert!((a - b).abs() <= tolerance, "rotation {i}: {a} recorded {b}");
        }
        assert!((shift - shifts[i]).length() <= tolerance, "shift {i}");
        let placement = canonical::ground_transform_of(&triangle, &rest);
        let turned = (placement.yaw_rad - yaws[i]).sin();
        assert!(turned.abs() <= tolerance, "yaw {i}");
        let matrix = transforms[i];
        assert!((placement.x - matrix[3]).abs() <= tolerance);
        assert!((placement.z - matrix[11]).abs() <= tolerance);
        assert!((placement.yaw_rad.cos() - matrix[0]).abs() <= tolerance);
    }
}

#[test]
fn golden_motionrefit_merge() {
    let golden = Golden::load("motionrefit_merge");
    let axis = |key: &str| -> [f64; 3] {
        let values = golden.get(key).values.clone();
        values.try_into().expect("three axes")
    };
    let normalizer = Normalizer {
        min: axis("in.min"),
        max: axis("in.max"),
    };
    let triangle: [DVec3; 3] = golden.points("in.rest_triangle");
    let window = golden.get("in.sampled").shape[1];
    let windows = |key: &str| -> Vec<Vec<KeypointFrame>> {
        let frame =
            |frame: &[f32]| normalizer.denormalize(&NormalizedFrame::from_model_units(frame));
        let windows = golden.get(key).rows(window * FRAME_WIDTH);
        windows
            .map(|window| {
                let values: Vec<f32> = window.iter().map(|&v| v as f32).collect();
                values.chunks_exact(FRAME_WIDTH).map(frame).collect()
            })
            .collect()
    };
    let flat = |frames: &[KeypointFrame]| -> Vec<f64> {
        frames.iter().flatten().flat_map(|p| p.to_array()).collect()
    };

    let originals = windows("in.orig");
    let sampled = windows("in.sampled");
    golden.check("out.windows_denorm", &flat(&sampled.concat()), 1e-5);
    let mut stitcher = Stitcher::new(triangle, GroundTransform::IDENTITY);
    let mut fixed = Vec::new();
    for window in &sampled {
        // The first window starts with the first two frames of the original.
        let begun = [originals[0][0], originals[0][1]];
        let frames = stitcher.next_fixed().unwrap_or(begun);
        for frame in &frames {
            fixed.extend(normalizer.normalize(frame).into_iter().map(f64::from));
        }
        stitcher.push(window);
    }
    golden.check("out.fixed", &fixed, 2e-5);
    golden.check("out.merged", &flat(stitcher.frames()), 2e-5);

    let mut stitcher = Stitcher::new(triangle, GroundTransform::IDENTITY);
    for window in &originals {
        stitcher.push(window);
    }
    golden.check("out.merged_orig", &flat(stitcher.frames()), 2e-5);
}
