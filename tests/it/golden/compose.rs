//! Blending and fitting against scipy and the released code.

use compose::blend_pose;
use datasets_spec::{BlendMask, Fps, Joint, JointSet, Pose};
use glam::{DMat3, DVec3};
use kinematics::fit::{AdamFit, FitOptions, Parameters, fit_motion};
use kinematics::rotation::from_axis_angle;
use kinematics::skeleton::{KEYPOINT_JOINTS, NUM_BODY_JOINTS, NUM_KEYPOINTS};

use super::{Golden, row_major};

fn poses(golden: &Golden, pose: &str, transl: &str) -> Vec<Pose> {
    golden
        .get(pose)
        .rows(3 * NUM_BODY_JOINTS)
        .zip(golden.get(transl).points())
        .map(|(frame, transl)| Pose {
            transl,
            rotations: std::array::from_fn(|joint| {
                from_axis_angle(DVec3::from_slice(&frame[3 * joint..]))
            }),
        })
        .collect()
}

/// Known keypoints of a recorded fit, and the keypoints of its frames.
fn recorded_keypoints(golden: &Golden, case: &str) -> (Vec<usize>, Vec<[DVec3; NUM_KEYPOINTS]>) {
    let shift = golden.get("in.pelvis_shift").points()[0];
    let slot_of = |joint: i64| {
        let is_it = |&known: &usize| known as i64 == joint;
        let slot = KEYPOINT_JOINTS.iter().position(is_it);
        slot.expect("a keypoint")
    };
    let indices = golden.get(&format!("in.{case}.indices")).integers();
    let slots: Vec<usize> = indices.into_iter().map(slot_of).collect();
    let joints = golden.get(&format!("in.{case}.joints")).points();
    let frames = joints
        .chunks_exact(slots.len())
        .map(|points| {
            let mut frame = [DVec3::ZERO; NUM_KEYPOINTS];
            for (&slot, &point) in slots.iter().zip(points) {
                frame[slot] = point + shift;
            }
            frame
        })
        .collect();
    (slots, frames)
}

#[test]
fn golden_blend() {
    let golden = Golden::load("blend");
    let source = poses(&golden, "in.src_pose", "in.src_transl");
    let target = poses(&golden, "in.tgt_pose", "in.tgt_transl");
    let codes = golden.get("in.mask").integers();
    let mut matrices = Vec::new();
    let mut transl = Vec::new();
    for (codes, alpha) in codes
        .chunks_exact(NUM_BODY_JOINTS)
        .zip(golden.get("in.alpha").rows(NUM_BODY_JOINTS))
    {
        // 0 keeps the source, 1 blends, 2 takes the target.
        let joints = |code: i64| -> JointSet {
            let has_code = |joint: &Joint| codes[joint.index()] == code;
            Joint::ALL.into_iter().filter(has_code).collect()
        };
        let mask = BlendMask::new(joints(2), joints(1)).expect("one code per joint");
        let alpha: &[f64; NUM_BODY_JOINTS] = alpha.try_into().expect("one alpha per joint");
        for (source, target) in source.iter().zip(&target) {
            let blended = blend_pose(source, target, mask, alpha);
            transl.extend(blended.transl.to_array());
            for rotation in blended.rotations {
                matrices.extend(row_major(DMat3::from_quat(rotation)));
            }
        }
    }
    golden.check("out.matrices", &matrices, 1e-10);
    golden.check("out.transl", &transl, 0.0);
}

#[test]
fn golden_fit_by_adam_goes_the_recorded_way_and_least_squares_are_no_worse() {
    let golden = Golden::load("j2s_adam_fit");
    let skeleton = golden.skeleton();
    let start: Vec<Parameters> = golden
        .get("in.init_pose")
        .rows(3 * NUM_BODY_JOINTS)
        .map(|pose| std::array::from_fn(|at| if at < 3 { 0.0 } else { pose[at - 3] }))
        .collect();
    for (case, fit) in [
        ("official24", AdamFit::official()),
        ("paper28", AdamFit::paper()),
    ] {
        let (slots, frames) = recorded_keypoints(&golden, case);
        assert!(slots.iter().all(|&slot| fit.counts[slot]));
        let fitted = fit.fit(&skeleton, &frames, &start);
        let recorded = golden.get(&format!("out.{case}.loss_history"));
        for (step, (found, recorded)) in fitted.history.iter().zip(&recorded.values).enumerate() {
            // The recorded run is in f32; its own rerun in f64 differs by 4e-6.
            assert!(
                (found / recorded - 1.0).abs() < 1e-3,
                "{case} step {step}: {found}, recorded {recorded}"
            );
        }
        let recorded = golden.get(&format!("out.{case}.final_mse")).values[0];
        let mse = fitted.mse;
        assert!(mse <= 1.2 * recorded, "{case}: {mse} {recorded}");

        let mut options = FitOptions::default();
        options.weights.fill(0.0);
        for &slot in &slots {
            options.weights[slot] = 1.0;
        }
        let fitted = fit_motion(&skeleton, &frames, Fps::STORE, &options).expect("finite");
        let mut squares = Vec::new();
        for (pose, frame) in fitted.motion.poses().into_iter().zip(&frames) {
            let points = skeleton.keypoints(&pose);
            for &slot in &slots {
                squares.extend((points[slot] - frame[slot]).to_array().map(|d| d * d));
            }
        }
        let mse = squares.iter().sum::<f64>() / squares.len() as f64;
        // The reference stops after 120 steps of Adam; a least-squares solver has to do better.
        assert!(mse <= recorded, "{case}: {mse} m^2, not {recorded} m^2");
    }
}
