//! Times of the paper's denoiser on a device: training steps and guided sampling. `train/benches/gpu.sh` runs it;
//! results are JSON lines on stdout.
//!
//! `cargo bench --features wgpu --bench gpu -- wgpu` names the device; `--peak TFLOPS` gives its peak f32 throughput,
//! `--precision bf16` multiplies in bfloat16, and `--quick` runs every measurement once with a small batch.
#![expect(clippy::print_stdout, reason = "results are printed")]

use std::time::{Duration, Instant};

use burn::module::Module;
use burn::tensor::{Device, Distribution, Tensor};
use kinematics::canonical::{FIXED_FRAMES, WINDOW_FRAMES};
use kinematics::normalise::FRAME_WIDTH;
use serde_json::json;
use train::config::{Prediction, Preset, ScheduleName, TrainConfig};
use train::device::{DeviceName, open};
use train::model::pass::{Arithmetic, has_bf16};
use train::sample::{Condition, Sampler};
use train::schedule::Schedule;
use train::throughput::{network, of_training};

/// Minimum duration of the measured training in seconds.
const LEAST_SECS: u64 = 10;

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let after = |name: &str| {
        let place = words.iter().position(|word| word == name)?;
        words.get(place + 1).cloned()
    };
    let name: DeviceName = words
        .iter()
        .find_map(|word| word.parse().ok())
        .unwrap_or_default();
    let peak: Option<f64> = after("--peak").and_then(|peak| peak.parse().ok());
    let is_quick = words.iter().any(|word| word == "--quick");
    let device = match open(name, 1) {
        Ok(devices) => devices[0].clone(),
        Err(error) => panic!("{error}"),
    };
    let precision = after("--precision").unwrap_or_else(|| "f32".to_owned());
    let bf16 = match precision.as_str() {
        "f32" => false,
        "bf16" => true,
        other => panic!("--precision {other}: f32 and bf16 are known"),
    };
    assert!(
        !bf16 || has_bf16(&device),
        "the device does not compute in bfloat16"
    );
    let arithmetic = Arithmetic {
        bf16,
        ..Arithmetic::default()
    };
    let (batches, samples) = match (is_quick, name) {
        (true, _) => (vec![8], vec![1]),
        // A processor takes a quarter of an hour for 1,024 edits.
        (false, DeviceName::Cpu | DeviceName::Ndarray) => (vec![64, 256], vec![1, 32]),
        (false, _) => (vec![64, 256, 1024], vec![1, 32, 1024]),
    };
    for batch in batches {
        let least = Duration::from_secs(if is_quick { 0 } else { LEAST_SECS });
        let start = Instant::now();
        let clock = || start.elapsed();
        let measured = of_training(Preset::Paper, batch, least, &device, arithmetic, &clock);
        let (steps, secs) = measured.unwrap_or_else(|problem| panic!("the device {problem}"));
        let secs = secs / steps as f64;
        let mut line = json!({
            "what": "training step", "batch": batch, "secs": secs, "samples_per_sec": batch as f64 / secs,
            "device": name.to_string(), "precision": precision,
        });
        if let Some(peak) = peak {
            line["share_of_peak"] = (batch as f64 * flops() / secs / (peak * 1e12)).into();
        }
        println!("{line}");
    }
    for batch in samples {
        let secs = sample(batch, &device, arithmetic);
        println!(
            "{}",
            json!({
                "what": "100 guided steps", "batch": batch, "secs": secs,
                "device": name.to_string(), "precision": precision,
            })
        );
    }
}

/// Floating-point operations of the matrix products of a training step, per window: two for each weight and token in
/// the forward pass, and twice that in the backward pass.
fn flops() -> f64 {
    let config = TrainConfig::preset(Preset::Paper).model;
    let (width, hidden) = (config.width as f64, config.feed_forward as f64);
    let weights = config.num_layers as f64 * (4.0 * width * width + 2.0 * width * hidden);
    3.0 * 2.0 * weights * (1 + WINDOW_FRAMES) as f64
}

fn normal<const D: usize>(shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::random(shape, Distribution::Normal(0.0, 1.0), device)
}

/// Seconds of 100 guided steps.
fn sample(batch: usize, device: &Device, arithmetic: Arithmetic) -> f64 {
    let network = network(Preset::Paper, device).valid();
    let schedule = Schedule::new(ScheduleName::Official, 100).expect("enough steps");
    let condition = Condition {
        original: normal([batch, WINDOW_FRAMES, FRAME_WIDTH], device),
        fixed: Some(normal([batch, FIXED_FRAMES, FRAME_WIDTH], device)),
        text: normal([batch, 512], device),
        progress: vec![0.5; batch],
    };
    let weights = network.prepared_weights(arithmetic);
    let sampler = Sampler {
        denoiser: &network,
        weights: &weights,
        schedule: &schedule,
        prediction: Prediction::Noise,
        extrapolation: None,
        clip: true,
        guidance: 4.0,
        coordinator: None,
    };
    let noise = normal([batch, WINDOW_FRAMES, FRAME_WIDTH], device);
    let mut secs = 0.0;
    // The first run compiles kernels, so only the second is timed.
    for _ in 0..2 {
        let begun = Instant::now();
        let x = sampler.sample(&condition, |_| noise.clone(), |_, _| {});
        let sum: f32 = x.sum().into_scalar();
        assert!(sum.is_finite(), "a window is {sum}");
        secs = begun.elapsed().as_secs_f64();
    }
    secs
}
