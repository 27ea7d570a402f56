//! Training and sampling of the denoiser, and training of TMED and MDM, at the sizes of their papers.
//!
//! `cargo bench --bench denoiser`; `RAYON_NUM_THREADS` chooses the threads. Compare the times with those of the matrix
//! products in the same run.

use std::hint::black_box;

use burn::module::Module;
use burn::optim::GradientsParams;
use burn::tensor::{Device, Distribution, Tensor};
use datasets_spec::{Fps, Seed};
use divan::Bencher;
use divan::counter::ItemsCount;
use kinematics::canonical::{FIXED_FRAMES, WINDOW_FRAMES};
use kinematics::normalise::{FRAME_WIDTH, Normalizer};
use train::config::{NetworkConfig, Prediction, Preset, ScheduleName, TrainConfig};
use train::data::TextBatch;
use train::diffusion::Objective;
use train::features::FeatureRecipe;
use train::mdm::{MdmConfig, masked_l2};
use train::model::denoiser::Denoiser;
use train::model::mdm::Mdm;
use train::model::motionrefit::TextSource;
use train::model::pass::{Arithmetic, Pass};
use train::model::tmed::TmedModel;
use train::model::weights::draw;
use train::optimizer::adamw;
use train::sample::{Condition, Sampler};
use train::schedule::Schedule;
use train::throughput::noisy_batch;
use train::tmed::features::NUM_FEATURES;
use train::tmed::{ClipBatch, TmedConfig, loss};

/// Number of windows in a training step.
const BATCH: usize = 64;

/// Computes with the backend's own operations only.
const WITHOUT_KERNELS: Arithmetic = Arithmetic {
    kernels: false,
    bf16: false,
};

fn main() {
    divan::main();
}

/// The paper's denoiser.
fn denoiser(dropout: f64, device: &Device) -> Denoiser {
    let config = TrainConfig::preset(Preset::Paper);
    let network = NetworkConfig {
        dropout,
        ..config.model
    };
    let previous = config.diffusion.previous;
    draw(
        Denoiser::new(&network, previous, network.width, FRAME_WIDTH, device),
        Seed(1),
    )
    .expect("known layers")
}

fn normal<const D: usize>(shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::random(shape, Distribution::Normal(0.0, 1.0), device)
}

/// Forward, loss, backward and AdamW of 64 windows.
#[divan::bench(args = [0.0, 0.1], sample_count = 5, sample_size = 1)]
fn training_step(bencher: Bencher, dropout: f64) {
    step(bencher, dropout, Arithmetic::default());
}

/// The same step with the backend's own operations; its matrix products are from the crate `gemm`.
#[divan::bench(sample_count = 5, sample_size = 1)]
fn training_step_without_kernels(bencher: Bencher) {
    step(bencher, 0.0, WITHOUT_KERNELS);
}

fn step(bencher: Bencher, dropout: f64, arithmetic: Arithmetic) {
    let device = Device::flex().autodiff();
    let batch = noisy_batch(BATCH);
    let diffusion = TrainConfig::preset(Preset::Paper).diffusion;
    let schedule = Schedule::new(ScheduleName::Official, 100).expect("enough steps");
    let text = normal([BATCH, 512], &device);
    let mut model = Some(denoiser(dropout, &device));
    let objective = Objective {
        schedule: &schedule,
        extrapolation: None,
        config: &diffusion,
        normalizer: &Normalizer {
            min: [-1.0; 3],
            max: [1.0; 3],
        },
        fps: Fps::STORE,
    };
    let mut optimizer = adamw(0.01, arithmetic);
    let pass = Pass::new(arithmetic);
    bencher.counter(ItemsCount::new(BATCH)).bench_local(|| {
        let network = model.take().expect("put back after every step");
        let loss = objective.loss(&network, &batch, text.clone(), &pass);
        let value: f32 = loss.clone().into_scalar();
        let gradients = GradientsParams::from_grads(loss.backward(), &network);
        model = Some(optimizer.step(1e-4, network, gradients));
        value
    });
}

/// One forward pass over the two rows of a guided step.
#[divan::bench(sample_count = 20)]
fn forward(bencher: Bencher) {
    let device = Device::flex();
    let network = denoiser(0.1, &device.clone().autodiff()).valid();
    let window = || normal([2, WINDOW_FRAMES, FRAME_WIDTH], &device);
    let (x, original) = (window(), window());
    let text = normal([2, 512], &device);
    bencher.bench_local(|| {
        black_box(network.forward(
            x.clone(),
            &[5, 5],
            text.clone(),
            &[0.1, 0.1],
            original.clone(),
            &Pass::default(),
        ))
    });
}

/// 100 guided steps.
#[divan::bench(args = [1, 32], sample_count = 3, sample_size = 1)]
fn sample(bencher: Bencher, batch: usize) {
    generate(bencher, batch, Arithmetic::default());
}

/// The same with the backend's own operations.
#[divan::bench(args = [1, 32], sample_count = 3, sample_size = 1)]
fn sample_without_kernels(bencher: Bencher, batch: usize) {
    generate(bencher, batch, WITHOUT_KERNELS);
}

fn generate(bencher: Bencher, batch: usize, arithmetic: Arithmetic) {
    let device = Device::flex();
    let network = denoiser(0.1, &device.clone().autodiff()).valid();
    let schedule = Schedule::new(ScheduleName::Official, 100).expect("enough steps");
    let condition = Condition {
        original: normal([batch, WINDOW_FRAMES, FRAME_WIDTH], &device),
        fixed: Some(normal([batch, FIXED_FRAMES, FRAME_WIDTH], &device)),
        text: normal([batch, 512], &device),
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
    bencher.counter(ItemsCount::new(batch)).bench_local(|| {
        sampler
            .sample(
                &condition,
                |_| normal([batch, WINDOW_FRAMES, FRAME_WIDTH], &device),
                |_, _| {},
            )
            .into_data()
    });
}

/// Clips in a training step of TMED, frames of a source or target, and tokens of a text.
const CLIPS: usize = 8;
const CLIP_FRAMES: usize = 120;
const TOKENS: usize = 16;

/// Width of a text vector of CLIP ViT-B/32.
const CLIP_WIDTH: usize = 512;

/// Forward, loss, backward and AdamW of eight clips of four seconds.
#[divan::bench(args = [0.0, 0.1], sample_count = 5, sample_size = 1)]
fn tmed_training_step(bencher: Bencher, dropout: f64) {
    let device = Device::flex().autodiff();
    let config = TmedConfig::preset(Preset::Paper);
    let network = NetworkConfig {
        dropout,
        ..config.model
    };
    let text = TextSource::Frozen(768);
    let model = TmedModel::new(&network, text, NUM_FEATURES, &device);
    let mut model = Some(draw(model, Seed(1)).expect("known layers"));
    let numbers = |count: usize| -> Vec<f32> {
        let values = normal([1, count], &Device::flex()).into_data();
        values.try_into_vec_as().expect("floats")
    };
    let motions = || numbers(CLIPS * CLIP_FRAMES * NUM_FEATURES);
    let batch = ClipBatch {
        source: motions(),
        source_frames: vec![CLIP_FRAMES; CLIPS],
        source_is_shown: vec![true; CLIPS],
        target: motions(),
        target_frames: vec![CLIP_FRAMES; CLIPS],
        noise: motions(),
        timesteps: (0..CLIPS).collect(),
        texts: TextBatch::Vectors {
            values: numbers(CLIPS * TOKENS * 768),
            lengths: vec![TOKENS; CLIPS],
        },
    };
    let schedule = Schedule::cosine(config.diffusion.num_steps).expect("steps");
    let mut optimizer = adamw(0.01, Arithmetic::default());
    let pass = Pass::default();
    bencher.counter(ItemsCount::new(CLIPS)).bench_local(|| {
        let network = model.take().expect("put back after every step");
        let loss = loss(&network, &batch, &config, &schedule, &device, &pass);
        let value: f32 = loss.clone().into_scalar();
        let gradients = GradientsParams::from_grads(loss.backward(), &network);
        model = Some(optimizer.step(1e-4, network, gradients));
        value
    });
}

/// A training step of MDM with clips of 196 frames, its longest, as HumanML3D features.
#[divan::bench(args = [0.0, 0.1], sample_count = 5, sample_size = 1)]
fn mdm_training_step(bencher: Bencher, dropout: f64) {
    let device = Device::flex().autodiff();
    let config = MdmConfig::preset(Preset::Paper);
    let network = NetworkConfig {
        dropout,
        ..config.model
    };
    let (frames, width) = (config.max_frames, FeatureRecipe::HumanMl3d.width());
    let model = Mdm::new(&network, width, CLIP_WIDTH, &device);
    let mut model = Some(draw(model, Seed(1)).expect("known layers"));
    let plain = Device::flex();
    let [x0, noise] = [(); 2].map(|()| normal::<3>([CLIPS, frames, width], &plain));
    let text = normal::<2>([CLIPS, CLIP_WIDTH], &plain);
    let (timesteps, lengths): (Vec<usize>, _) = ((0..CLIPS).collect(), [frames; CLIPS]);
    let schedule = Schedule::cosine(config.diffusion_steps).expect("steps");
    let mut optimizer = adamw(0.0, Arithmetic::default());
    let pass = Pass::default();
    bencher.counter(ItemsCount::new(CLIPS)).bench_local(|| {
        let network = model.take().expect("put back after every step");
        let text = Tensor::<2>::from_data(text.to_data(), &device);
        let [x0, noise] = [&x0, &noise].map(|x| Tensor::<3>::from_data(x.to_data(), &device));
        let x_t = schedule.q_sample(x0.clone(), &timesteps, noise);
        let predicted = network.forward(x_t, &timesteps, text, None, &pass);
        let loss = masked_l2(predicted, x0, &lengths).mean();
        let value: f32 = loss.clone().into_scalar();
        let gradients = GradientsParams::from_grads(loss.backward(), &network);
        model = Some(optimizer.step(1e-4, network, gradients));
        value
    });
}

/// Shapes of the products of a training step (rows of 64 windows) and of a guided step of sampling (two
/// windows), as rows, depth, columns.
const PRODUCTS: [[usize; 3]; 4] = [
    [BATCH * (1 + WINDOW_FRAMES), 512, 2048],
    [BATCH * (1 + WINDOW_FRAMES), 2048, 512],
    [2 * (1 + WINDOW_FRAMES), 512, 2048],
    [2 * (1 + WINDOW_FRAMES), 2048, 512],
];

/// The baseline: the backend's matrix product, in floating-point operations per second.
#[divan::bench(args = PRODUCTS, sample_count = 20)]
fn matrix_product(bencher: Bencher, [m, k, n]: [usize; 3]) {
    let device = Device::flex();
    let (a, b) = (normal([m, k], &device), normal([k, n], &device));
    bencher
        .counter(ItemsCount::new(2 * m * k * n))
        .bench_local(|| black_box(a.clone().matmul(b.clone())));
}
