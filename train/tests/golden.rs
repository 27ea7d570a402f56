//! Parity of the networks and the diffusion with the reference implementations.

#[path = "../../tests/data/golden.rs"]
mod recorded;

use std::collections::HashMap;
use std::path::Path;

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use burn_store::ModuleSnapshot;
use datasets_spec::canonical::FIXED_FRAMES;
use datasets_spec::{Pose, rotation};
use glam::DVec3;
use safetensors::SafeTensors;
use train::config::{NetworkConfig, Preset, TrainConfig};
use train::data::NoisyBatch;
use train::diffusion::{Prediction, Schedule, ScheduleName, guide, training_loss};
use train::features::smpl135;
use train::j2s::{J2sPreset, PoseNet, official_upsampling};
use train::model::denoiser::{Denoiser, progress_indices};
use train::model::position::sinusoid;
use train::model::tmr::{
    Distribution, SequenceDecoder, SequenceEncoder, cosine_similarity, info_nce,
};
use train::model::weights::{from_safetensors, to_safetensors};
use train::sample::{Condition, Sampler};
use train::vocabulary::TokenBatch;

use recorded::Recorded;

/// A recorded case.
struct Golden(Recorded);

impl Golden {
    fn read(name: &str) -> Self {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        Self(Recorded::read(&root, name))
    }

    /// The file itself, for readers of weights and sizes.
    fn bytes(&self) -> Vec<u8> {
        std::fs::read(&self.0.path).expect("the file was read before")
    }

    fn metadata(&self) -> HashMap<String, String> {
        let (_, metadata) = SafeTensors::read_metadata(&self.bytes()).expect("a header");
        metadata.metadata().clone().expect("metadata")
    }

    fn size(&self, key: &str) -> usize {
        self.metadata()[key].parse().expect("a number")
    }

    /// Values as `f64`, with the shape.
    fn values(&self, name: &str) -> (Vec<f64>, Vec<usize>) {
        let tensor = self.0.get(name);
        (tensor.values.clone(), tensor.shape.clone())
    }

    fn f32s(&self, name: &str) -> Vec<f32> {
        self.values(name).0.iter().map(|&v| v as f32).collect()
    }

    fn indices(&self, name: &str) -> Vec<usize> {
        self.values(name).0.iter().map(|&v| v as usize).collect()
    }

    fn tensor<const D: usize>(&self, name: &str) -> Tensor<D> {
        let (_, shape) = self.values(name);
        Tensor::from_data(TensorData::new(self.f32s(name), shape), &Device::flex())
    }

    fn load<M: Module + ModuleSnapshot>(&self, network: &mut M, prefix: &str) {
        from_safetensors(network, self.bytes(), prefix, &self.0.path).expect("loads by name");
    }

    fn network(&self, width: &str, feed_forward: &str) -> NetworkConfig {
        NetworkConfig {
            width: self.size(width),
            num_layers: self.size("num_layers"),
            num_heads: self.size("num_heads"),
            feed_forward: self.size(feed_forward),
            dropout: 0.1,
        }
    }
}

fn denoiser() -> Denoiser {
    let golden = Golden::read("motionrefit_denoiser");
    let config = golden.network("dim_model", "dim_feedforward");
    let mut network = Denoiser::new(&config, &Device::flex());
    golden.load(&mut network, "weights.");
    network
}

fn max_difference(values: &[f32], expected: &[f32]) -> f32 {
    assert_eq!(values.len(), expected.len());
    values
        .iter()
        .zip(expected)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f32::max)
}

fn check<const D: usize>(tensor: Tensor<D>, golden: &Golden, name: &str, tolerance: f32) {
    assert_eq!(tensor.dims().to_vec(), golden.values(name).1, "{name}");
    let values: Vec<f32> = tensor.into_data().try_into_vec_as().expect("floats");
    let difference = max_difference(&values, &golden.f32s(name));
    assert!(difference <= tolerance, "{name}: {difference}");
}

#[test]
fn golden_denoiser() {
    let golden = Golden::read("motionrefit_denoiser");
    let network = denoiser();
    let text = golden.tensor::<2>("in.text");
    let forward = |text: Tensor<2>| {
        network.forward(
            golden.tensor("in.x"),
            &golden.indices("in.t"),
            text,
            &golden.f32s("in.prog"),
            golden.tensor("in.orig"),
        )
    };
    check(forward(text.clone()), &golden, "out.eps", 2e-5);
    check(forward(text.zeros_like()), &golden, "out.eps_uncond", 2e-5);
    assert_eq!(
        progress_indices(&golden.f32s("in.prog")),
        golden.indices("out.prog_index")
    );
    let (_, shape) = golden.values("out.pe");
    let rows: Vec<usize> = (0..shape[0]).collect();
    // The reference computes angles up to 127 rad in f32.
    check(
        sinusoid(&rows, shape[1], &Device::flex()),
        &golden,
        "out.pe",
        2e-5,
    );
}

#[test]
fn golden_denoiser_trains_as_it_infers() {
    // The attention used for gradients is written out; without dropout it must agree.
    let golden = Golden::read("motionrefit_denoiser");
    let config = NetworkConfig {
        dropout: 0.0,
        ..golden.network("dim_model", "dim_feedforward")
    };
    let device = Device::flex().autodiff();
    let mut network = Denoiser::new(&config, &device);
    golden.load(&mut network, "weights.");
    let on_device = |values: Tensor<3>| Tensor::<3>::from_data(values.into_data(), &device);
    let eps = network.forward(
        on_device(golden.tensor("in.x")),
        &golden.indices("in.t"),
        Tensor::from_data(golden.tensor::<2>("in.text").into_data(), &device),
        &golden.f32s("in.prog"),
        on_device(golden.tensor("in.orig")),
    );
    check(eps.inner(), &golden, "out.eps", 2e-5);
}

#[test]
fn golden_denoiser_is_saved_under_the_reference_names() {
    let golden = Golden::read("motionrefit_denoiser");
    let bytes = to_safetensors(&denoiser(), Path::new("memory")).expect("saved");
    let saved = SafeTensors::deserialize(&bytes).expect("a safetensors file");
    let recorded = golden.bytes();
    let reference = SafeTensors::deserialize(&recorded).expect("a safetensors file");
    let mut expected: Vec<&str> = reference
        .names()
        .into_iter()
        .filter_map(|name| name.strip_prefix("weights."))
        .collect();
    let mut names: Vec<&str> = saved.names().into_iter().collect();
    expected.sort_unstable();
    names.sort_unstable();
    assert_eq!(names, expected);
    for name in names {
        let original = reference.tensor(&format!("weights.{name}")).expect("known");
        let written = saved.tensor(name).expect("written");
        assert_eq!(written.shape(), original.shape(), "{name}");
        assert_eq!(written.data(), original.data(), "{name}");
    }
}

#[test]
fn golden_schedule_arrays() {
    let golden = Golden::read("motionrefit_schedule");
    let steps = golden.values("out.betas").1[0];
    let schedule = Schedule::new(ScheduleName::Official, steps).expect("enough steps");
    let derived = |f: &dyn Fn(f64) -> f64| -> Vec<f64> {
        schedule.alphas_cumprod.iter().map(|&a| f(a)).collect()
    };
    for (name, values) in [
        ("betas", schedule.betas.clone()),
        ("alphas_cumprod", schedule.alphas_cumprod.clone()),
        ("alphas_cumprod_prev", schedule.alphas_cumprod_prev.clone()),
        ("posterior_variance", schedule.posterior_variance.clone()),
        (
            "posterior_mean_coef1",
            schedule.posterior_mean_coef1.clone(),
        ),
        (
            "posterior_mean_coef2",
            schedule.posterior_mean_coef2.clone(),
        ),
        ("sqrt_alphas_cumprod", derived(&f64::sqrt)),
        ("sqrt_recip_alphas_cumprod", derived(&|a| a.recip().sqrt())),
        (
            "sqrt_recipm1_alphas_cumprod",
            derived(&|a| (a.recip() - 1.0).sqrt()),
        ),
    ] {
        let (expected, _) = golden.values(&format!("out.{name}"));
        assert_eq!(values.len(), expected.len(), "{name}");
        for (value, expected) in values.iter().zip(&expected) {
            assert!(
                (value - expected).abs() <= 1e-12 * expected.abs(),
                "{name}: {value} {expected}"
            );
        }
    }
}

#[test]
fn golden_schedule_steps() {
    let golden = Golden::read("motionrefit_schedule");
    let steps = golden.values("out.betas").1[0];
    let schedule = Schedule::new(ScheduleName::Official, steps).expect("enough steps");
    let t = golden.indices("in.step.t");
    let x_t = golden.tensor::<3>("in.step.x_t");
    let eps = guide(
        golden.tensor("in.step.eps_cond"),
        golden.tensor("in.step.eps_uncond"),
        3.0,
    );
    check(eps.clone(), &golden, "out.step.eps_cfg", 2e-6);
    let x0 = schedule.predict_x0(x_t.clone(), &t, eps);
    check(x0.clone(), &golden, "out.step.x0_unclipped", 2e-6);
    let x0 = x0.clamp(-1.0, 1.0);
    check(x0.clone(), &golden, "out.step.x0_hat", 2e-6);
    let mean = schedule.posterior_mean(x0, x_t, &t);
    check(mean, &golden, "out.step.mean", 2e-6);
    let noisy = schedule.q_sample(
        golden.tensor("in.step.x0"),
        &t,
        golden.tensor("in.step.noise"),
    );
    check(noisy, &golden, "out.step.q_sample", 2e-6);
}

#[test]
fn golden_training_loss() {
    let golden = Golden::read("motionrefit_schedule");
    let steps = golden.values("out.betas").1[0];
    let schedule = Schedule::new(ScheduleName::Official, steps).expect("enough steps");
    let mut noise = golden.f32s("in.loss.noise");
    for (noise, fixed) in noise.iter_mut().zip(golden.f32s("in.loss.mask")) {
        *noise *= 1.0 - fixed;
    }
    let timesteps = golden.indices("in.loss.t");
    let batch = NoisyBatch {
        original: golden.f32s("in.loss.orig"),
        edited: golden.f32s("in.loss.x_start"),
        noise,
        progress: golden.f32s("in.loss.prog"),
        tokens: TokenBatch {
            ids: vec![0; timesteps.len()],
            width: 1,
        },
        text_kept: vec![1.0; timesteps.len()],
        timesteps,
    };
    let loss: f32 = training_loss(
        &denoiser(),
        &schedule,
        &batch,
        golden.tensor("in.loss.text"),
        &TrainConfig::preset(Preset::Official).diffusion,
    )
    .into_scalar();
    // Mean of some 3,500 terms, each within the tolerance of the network.
    assert!((loss - golden.f32s("out.loss.value")[0]).abs() < 2e-5);
}

#[test]
fn golden_unguided_sampling() {
    let golden = Golden::read("motionrefit_sample_unguided");
    let (noise, shape) = golden.values("in.noise");
    let [draws, window, width] = shape[..] else {
        panic!("noise of shape {shape:?}")
    };
    let (trace, trace_shape) = golden.values("out.trace");
    let steps = trace_shape[0];
    assert_eq!(draws, steps + 1);
    let schedule = Schedule::new(ScheduleName::Official, steps).expect("enough steps");
    let numbers = window * width;
    let draw = |row: usize| -> Tensor<3> {
        let values: Vec<f32> = noise[row * numbers..(row + 1) * numbers]
            .iter()
            .map(|&v| v as f32)
            .collect();
        Tensor::from_data(TensorData::new(values, [1, window, width]), &Device::flex())
    };
    let condition = Condition {
        original: golden.tensor("in.orig"),
        fixed: golden.tensor("in.fixed"),
        text: golden.tensor("in.text"),
        progress: golden.f32s("in.prog"),
    };
    assert_eq!(condition.fixed.dims()[1], FIXED_FRAMES);
    let guidance: f64 = golden.metadata()["cfg_alpha"].parse().expect("a number");
    let mut worst = 0.0f32;
    Sampler {
        denoiser: &denoiser(),
        schedule: &schedule,
        prediction: Prediction::Noise,
        clip: true,
        guidance,
    }
    .sample(
        &condition,
        |timestep| draw(timestep.map_or(0, |t| steps - t)),
        |timestep, x| {
            let row = steps - 1 - timestep;
            let expected: Vec<f32> = trace[row * numbers..(row + 1) * numbers]
                .iter()
                .map(|&v| v as f32)
                .collect();
            let values: Vec<f32> = x.to_data().try_into_vec_as().expect("floats");
            worst = worst.max(max_difference(&values, &expected));
        },
    );
    assert!(worst <= 1e-4, "{worst}");
}

#[test]
fn golden_tmr_encoder_decoder() {
    let golden = Golden::read("tmr_encoder_decoder");
    let config = golden.network("latent_dim", "ff_size");
    let device = Device::flex();
    let motion_features = golden.size("nfeats_motion");

    let mut encoder = SequenceEncoder::new(motion_features, &config, &device);
    golden.load(&mut encoder, "weights.motion_encoder.");
    let lengths = golden.indices("in.motion_lengths");
    let motion = encoder.forward(golden.tensor("in.motion"), &lengths);
    check(motion.mu.clone(), &golden, "out.motion_mu", 3e-5);
    check(motion.logvar, &golden, "out.motion_logvar", 3e-5);

    let mut encoder = SequenceEncoder::new(golden.size("nfeats_text"), &config, &device);
    golden.load(&mut encoder, "weights.text_encoder.");
    let text = encoder.forward(golden.tensor("in.text"), &golden.indices("in.text_lengths"));
    check(text.mu.clone(), &golden, "out.text_mu", 3e-5);
    check(text.logvar, &golden, "out.text_logvar", 3e-5);

    let mut decoder = SequenceDecoder::new(motion_features, &config, &device);
    golden.load(&mut decoder, "weights.motion_decoder.");
    let steps = golden.values("in.motion").1[1];
    let decoded = decoder.forward(motion.mu.clone(), &lengths, steps);
    check(decoded, &golden, "out.decoded", 3e-5);
    check(
        cosine_similarity(text.mu, motion.mu),
        &golden,
        "out.sim",
        3e-5,
    );
}

#[test]
fn golden_tmr_losses() {
    let golden = Golden::read("tmr_losses");
    let (embeddings, shape) = golden.values("in.sent_emb");
    // Official threshold 0.8 on scores in [0, 1], as a cosine.
    let row = |i: usize| &embeddings[i * shape[1]..(i + 1) * shape[1]];
    let filtered: Vec<bool> = (0..shape[0])
        .flat_map(|i| (0..shape[0]).map(move |j| (i, j)))
        .map(|(i, j)| {
            let cosine: f64 = row(i).iter().zip(row(j)).map(|(a, b)| a * b).sum();
            i != j && cosine > 2.0 * 0.8 - 1.0
        })
        .collect();
    let unfiltered = vec![false; filtered.len()];
    assert!(filtered.iter().any(|&f| f), "the case filters nothing");
    for (name, temperature, ignored) in [
        ("out.infonce_t0.1_nofilter", 0.1, &unfiltered),
        ("out.infonce_t0.1_filter", 0.1, &filtered),
        ("out.infonce_t0.7_filter", 0.7, &filtered),
    ] {
        let loss = info_nce(
            golden.tensor("in.x"),
            golden.tensor("in.y"),
            temperature,
            ignored,
        );
        let difference = (loss.into_scalar::<f32>() - golden.f32s(name)[0]).abs();
        assert!(difference < 1e-5, "{name}: {difference}");
    }
    let q = Distribution {
        mu: golden.tensor("in.mu_q"),
        logvar: golden.tensor("in.logvar_q"),
    };
    let p = Distribution {
        mu: golden.tensor("in.mu_p"),
        logvar: golden.tensor("in.logvar_p"),
    };
    let kl: f32 = q.kl(&p).into_scalar();
    let standard: f32 = q.kl(&q.standard()).into_scalar();
    assert!((kl - golden.f32s("out.kl")[0]).abs() < 1e-5, "{kl}");
    assert!(
        (standard - golden.f32s("out.kl_std")[0]).abs() < 1e-5,
        "{standard}"
    );
}

#[test]
fn golden_evaluator_features() {
    let golden = Golden::read("motionfix_features");
    let (rotations, shape) = golden.values("in.rots");
    let (translations, _) = golden.values("in.trans");
    let poses: Vec<Pose> = (0..shape[0])
        .map(|frame| Pose {
            transl: DVec3::from_slice(&translations[3 * frame..]),
            rotations: std::array::from_fn(|joint| {
                let at = frame * shape[1] + 3 * joint;
                rotation::from_axis_angle(DVec3::from_slice(&rotations[at..]))
            }),
        })
        .collect();
    let features = smpl135(&poses);
    // The reference chains matrices in f32.
    let difference = max_difference(features.as_flattened(), &golden.f32s("out.evaluator135"));
    assert!(difference < 5e-6, "{difference}");
}

fn pose_net(golden: &Golden, preset: J2sPreset) -> PoseNet {
    let (prefix, width) = match preset {
        J2sPreset::Official => ("weights.bn.", 64),
        J2sPreset::Paper => ("weights.ln.", 48),
    };
    let device = Device::flex();
    PoseNet::from_safetensors(
        preset,
        width,
        golden.bytes(),
        prefix,
        &golden.0.path,
        &device,
    )
    .expect("loads by name")
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
        let expected = golden.f32s(output);
        assert_eq!(found.len(), expected.len());
        for (found, expected) in found.iter().zip(&expected) {
            assert!(
                (found - expected).abs() < 2e-5,
                "{preset:?}: {found}, recorded {expected}"
            );
        }
    }
}

#[test]
fn golden_j2s_pipeline() {
    use datasets_spec::Skeleton;
    use datasets_spec::fit::AdamFit;
    use datasets_spec::skeleton::{FIT_KEYPOINTS, NUM_JOINTS, NUM_KEYPOINTS};
    use glam::DMat3;

    let golden = Golden::read("j2s_pipeline");
    let net = pose_net(&Golden::read("j2s_mlp"), J2sPreset::Official);
    let rest: [DVec3; NUM_JOINTS] = {
        let (values, _) = golden.values("in.rest_joints");
        let points: Vec<DVec3> = values.chunks_exact(3).map(DVec3::from_slice).collect();
        points.try_into().expect("55 joints")
    };
    let skeleton = Skeleton::new("recorded", rest);
    let (values, _) = golden.values("in.joints");
    let rows: Vec<Vec<f64>> = values.chunks_exact(72).map(<[f64]>::to_vec).collect();
    let upsampled = official_upsampling(&rows);
    let (expected, _) = golden.values("out.upsampled");
    for (found, expected) in upsampled.iter().flatten().zip(&expected) {
        assert!((found - expected).abs() < 1e-5);
    }
    let frames: Vec<[DVec3; NUM_KEYPOINTS]> = upsampled
        .iter()
        .map(|row| {
            let mut frame = [DVec3::ZERO; NUM_KEYPOINTS];
            for (&slot, point) in FIT_KEYPOINTS.iter().zip(row.chunks_exact(3)) {
                frame[slot] = DVec3::from_slice(point);
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
                assert!(
                    (found - expected).abs() < 1e-4,
                    "{found}, recorded {expected}"
                );
            }
        }
    }
    let fitted = AdamFit::official().fit(&skeleton, &frames, &AdamFit::parameters_of(&first));
    let (recorded, _) = golden.values("out.final_world_mse");
    assert!(
        fitted.mse <= 1.5 * recorded[0],
        "{} {}",
        fitted.mse,
        recorded[0]
    );
}

#[test]
fn a_pose_network_learns_and_is_loaded_again() {
    use datasets_spec::{Fps, Motion, NoProgress, Skeleton};
    use train::Session;
    use train::j2s::{J2sConfig, train_j2s};

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
        let config = J2sConfig {
            num_steps: 60,
            batch_size: 64,
            width: 64,
            ..J2sConfig::preset(preset)
        };
        let session = Session {
            device: &Device::flex(),
            progress: &NoProgress,
            stop: &std::sync::atomic::AtomicBool::new(false),
            clock: &|| std::time::Duration::ZERO,
        };
        let run = dir.path().join(format!("{preset:?}"));
        let skeleton = Skeleton::smplx_neutral();
        let report = train_j2s(
            &run,
            &config,
            [&motion, &motion],
            &skeleton,
            "hash",
            &session,
        );
        let report = report.expect("trained");
        assert!(report.loss[1] < 0.8 * report.loss[0], "{:?}", report.loss);
        let by_name = |name: &str| {
            let way = report.ways.iter().find(|way| way.name == name);
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
