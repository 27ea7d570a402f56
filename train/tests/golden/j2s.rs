//! The joints-to-SMPL-X network compared with its released code, and its training.

use burn::tensor::Device;
use datasets_spec::{Fps, Motion, Pose, Skeleton};
use glam::{DMat3, DVec3};
use kinematics::fit::AdamFit;
use kinematics::rotation;
use kinematics::skeleton::{FIT_KEYPOINTS, NUM_JOINTS, NUM_KEYPOINTS};
use train::config::RunLength;
use train::j2s::{J2sConfig, J2sPreset, PoseNet, train_j2s};

use super::{Golden, max_difference};
use crate::shared::quietly;

fn pose_net(golden: &Golden, preset: J2sPreset) -> PoseNet {
    let (prefix, width) = match preset {
        J2sPreset::Official => ("weights.bn.", 64),
        J2sPreset::Paper => ("weights.ln.", 48),
    };
    let (bytes, path, device) = (golden.bytes(), &golden.0.path, Device::flex());
    let net = PoseNet::from_safetensors(preset, width, bytes, prefix, path, &device);
    net.expect("loads by name")
}

#[test]
fn golden_j2s_mlp() {
    let golden = Golden::read("j2s_mlp");
    for (preset, input, output) in [
        (J2sPreset::Official, "in.bn.x", "out.bn.y"),
        (J2sPreset::Paper, "in.ln.x", "out.ln.y"),
    ] {
        let net = pose_net(&golden, preset);
        let found = net.raw(golden.f32s(input), 16, &Device::flex());
        let difference = max_difference(&found, &golden.f32s(output));
        assert!(difference < 2e-5, "{preset:?}: {difference}");
    }
}

#[test]
fn golden_j2s_pipeline() {
    let golden = Golden::read("j2s_pipeline");
    let net = pose_net(&Golden::read("j2s_mlp"), J2sPreset::Official);
    let rest: [DVec3; NUM_JOINTS] = golden.points("in.rest_joints").try_into().expect("55");
    let skeleton = Skeleton::new("recorded", rest);
    let upsampled = golden.points("out.upsampled");
    let frames: Vec<[DVec3; NUM_KEYPOINTS]> = upsampled
        .chunks_exact(24)
        .map(|row| {
            let mut frame = [DVec3::ZERO; NUM_KEYPOINTS];
            for (&slot, &point) in FIT_KEYPOINTS.iter().zip(row) {
                frame[slot] = point;
            }
            frame
        })
        .collect();
    let first = net.poses(&frames, &skeleton, &Device::flex());
    let (matrices, _) = golden.values("out.init_matrices");
    for (pose, expected) in first.iter().zip(matrices.chunks_exact(22 * 9)) {
        for (rotation, expected) in pose.rotations.iter().zip(expected.chunks_exact(9)) {
            let found = DMat3::from_quat(*rotation).transpose().to_cols_array();
            for (found, expected) in found.iter().zip(expected) {
                assert!((found - expected).abs() < 1e-4, "{found} {expected}");
            }
        }
    }
    let fitted = AdamFit::official().fit(&skeleton, &frames, &AdamFit::parameters_of(&first));
    let (found, recorded) = (fitted.mse, golden.values("out.final_world_mse").0[0]);
    assert!(found <= 1.5 * recorded, "{found} {recorded}");
}

#[test]
fn a_pose_network_learns_and_is_loaded_again() {
    let poses: Vec<Pose> = (0..64)
        .map(|frame| {
            let mut pose = Pose::REST;
            for (joint, turn) in pose.rotations.iter_mut().enumerate().skip(1) {
                let swing = 0.4 * (0.3 * f64::from(frame) + joint as f64).sin();
                *turn = rotation::from_axis_angle(DVec3::X * swing);
            }
            pose
        })
        .collect();
    let motion = [Motion::from_poses(Fps::STORE, &poses).expect("finite")];
    let dir = tempfile::tempdir().expect("a folder");
    for preset in [J2sPreset::Paper, J2sPreset::Official] {
        let mut config = J2sConfig::preset(preset);
        config.width = 64;
        config.run.batch_size = 64;
        config.run.length = RunLength::of_steps(60);
        let run = dir.path().join(format!("{preset:?}"));
        let skeleton = Skeleton::smplx_neutral();
        let motions = [&motion[..], &motion];
        let report =
            quietly(|session| train_j2s(&run, &config, motions, &skeleton, "hash", session));
        let report = report.expect("trained");
        assert!(report.loss[1] < 0.8 * report.loss[0], "{:?}", report.loss);
        let by_name = |name: &str| {
            let way = report.fits.iter().find(|fit| fit.name == name);
            way.expect("measured").error_mm
        };
        assert!(by_name("network, Adam") < by_name("network"));
        assert!(by_name("network, second order") < by_name("network, Adam"));
        let path = run.join("model.safetensors");
        let bytes = std::fs::read(&path).expect("written");
        let device = Device::flex();
        PoseNet::from_safetensors(preset, 64, bytes, "", &path, &device).expect("its own file");
    }
}
