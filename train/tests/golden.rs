//! Parity of the networks and the diffusion with the reference implementations.

mod gaussian;
mod j2s;
mod mdm;
mod mld;
mod tmed;
mod tmr;

use std::cell::Cell;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use burn_store::ModuleSnapshot;
use datasets_spec::{Pose, Seed, Skeleton};
use glam::DVec3;
use kinematics::canonical::FIXED_FRAMES;
use kinematics::normalise::{FRAME_WIDTH, Normalizer};
use kinematics::rotation;
use safetensors::SafeTensors;
use train::compose::ComposeRecord;
use train::config::{
    GuidanceConfig, GuidanceTarget, NetworkConfig, Prediction, Preset, PreviousFrames,
    ScheduleName, TrainConfig,
};
use train::data::{NoisyBatch, TextBatch};
use train::diffusion::guide;
use train::features::smpl135;
use train::model::coordinator::Coordinator;
use train::model::denoiser::{Denoiser, progress_indices};
use train::model::pass::{Arithmetic, Pass};
use train::model::position::sinusoid;
use train::model::weights::{from_safetensors, to_safetensors};
use train::sample::{Condition, Guide, Sampler};
use train::schedule::Schedule;
use train::vocabulary::TokenBatch;

use crate::recorded::Recorded;
use crate::shared::{frozen_text, objective};
use gaussian::{Derived, check_arrays};

pub(crate) struct Golden(pub(crate) Recorded);

impl Golden {
    pub(crate) fn read(name: &str) -> Self {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        Self(Recorded::read(&root, name))
    }

    /// Reads a case that is not stored in the project. If it is not found, returns none, with a message.
    #[expect(clippy::print_stderr, reason = "a skipped test says so")]
    fn find(name: &str) -> Option<Self> {
        if std::env::var_os("STANCE_GOLDEN").is_some() {
            return Some(Self::read(name));
        }
        let data = std::env::var_os("STANCE_TEST_DATA").map(PathBuf::from);
        let path = data.map(|data| data.join(format!("../golden/{name}.safetensors")));
        let found = path.filter(|path| path.is_file());
        if found.is_none() {
            eprintln!("SKIPPED: neither STANCE_GOLDEN nor STANCE_TEST_DATA leads to {name}");
        }
        found.map(|path| Self(Recorded::read_file(path)))
    }

    /// The content of the file, for readers of weights and sizes.
    pub(crate) fn bytes(&self) -> Vec<u8> {
        std::fs::read(&self.0.path).expect("the file was read before")
    }

    /// A safetensors file with the tensors whose names begin with `prefix`, which is removed from the names.
    fn weights(&self, prefix: &str) -> Vec<u8> {
        let recorded = self.bytes();
        let reference = SafeTensors::deserialize(&recorded).expect("a safetensors file");
        let tensors = reference
            .tensors()
            .into_iter()
            .filter_map(|(name, tensor)| Some((name.strip_prefix(prefix)?.to_owned(), tensor)));
        safetensors::serialize(tensors, None).expect("serialises")
    }

    pub(crate) fn metadata(&self) -> HashMap<String, String> {
        let (_, metadata) = SafeTensors::read_metadata(&self.bytes()).expect("a header");
        metadata.metadata().clone().expect("metadata")
    }

    pub(crate) fn size(&self, key: &str) -> usize {
        self.metadata()[key].parse().expect("a number")
    }

    /// The parts of tensor names between `before` and `after`, such as sizes or parameters of a case. At least one such
    /// name must exist.
    fn between(&self, before: &str, after: &str) -> Vec<String> {
        let names = self.0.tensors.keys();
        let found: Vec<String> = names
            .filter_map(|name| name.strip_prefix(before)?.strip_suffix(after))
            .map(str::to_owned)
            .collect();
        let path = self.0.path.display();
        assert!(!found.is_empty(), "{path} has no tensor {before}...{after}");
        found
    }

    /// Values as `f64`, and the shape.
    pub(crate) fn values(&self, name: &str) -> (Vec<f64>, Vec<usize>) {
        let tensor = self.0.get(name);
        (tensor.values.clone(), tensor.shape.clone())
    }

    fn points(&self, name: &str) -> Vec<DVec3> {
        let (values, _) = self.values(name);
        values.chunks_exact(3).map(DVec3::from_slice).collect()
    }

    fn f32s(&self, name: &str) -> Vec<f32> {
        self.values(name).0.iter().map(|&v| v as f32).collect()
    }

    pub(crate) fn indices(&self, name: &str) -> Vec<usize> {
        self.values(name).0.iter().map(|&v| v as usize).collect()
    }

    /// Lengths of the rows of a mask: the number of ones, which come first in each row.
    pub(crate) fn lengths(&self, name: &str) -> Vec<usize> {
        let (mask, shape) = self.values(name);
        mask.chunks_exact(shape[1])
            .map(|row| row.iter().sum::<f64>() as usize)
            .collect()
    }

    pub(crate) fn tensor<const D: usize>(&self, name: &str) -> Tensor<D> {
        let (_, shape) = self.values(name);
        Tensor::from_data(TensorData::new(self.f32s(name), shape), &Device::flex())
    }

    /// The network with the recorded weights whose names begin with `prefix`.
    fn load<M: Module + ModuleSnapshot>(&self, mut network: M, prefix: &str) -> M {
        from_safetensors(&mut network, self.bytes(), prefix, &self.0.path).expect("loads by name");
        network
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
    denoiser_on(&Device::flex())
}

fn denoiser_on(device: &Device) -> Denoiser {
    let golden = Golden::read("motionrefit_denoiser");
    let config = NetworkConfig {
        dropout: 0.0,
        ..golden.network("dim_model", "dim_feedforward")
    };
    let previous = PreviousFrames::Inpainted;
    let network = Denoiser::new(&config, previous, config.width, FRAME_WIDTH, device);
    golden.load(network, "weights.")
}

/// The largest difference of two arrays.
fn max_difference(values: &[f32], expected: &[f32]) -> f32 {
    assert_eq!(values.len(), expected.len());
    let differences = values.iter().zip(expected).map(|(a, b)| (a - b).abs());
    differences.fold(0.0f32, |worst, difference| {
        // `max` would leave out NaN.
        assert!(!difference.is_nan(), "a value is not a number");
        worst.max(difference)
    })
}

pub(crate) fn check<const D: usize>(
    tensor: Tensor<D>,
    golden: &Golden,
    name: &str,
    tolerance: f32,
) {
    assert_eq!(tensor.dims().to_vec(), golden.values(name).1, "{name}");
    let difference = max_difference(&floats(&tensor), &golden.f32s(name));
    assert!(difference <= tolerance, "{name}: {difference}");
}

#[test]
fn golden_denoiser() {
    let golden = Golden::read("motionrefit_denoiser");
    let network = denoiser();
    let text = golden.tensor::<2>("in.text");
    let (timesteps, progress) = (golden.indices("in.t"), golden.f32s("in.prog"));
    let forward = |text: Tensor<2>| {
        let (x, original) = (golden.tensor("in.x"), golden.tensor("in.orig"));
        network.forward(x, &timesteps, text, &progress, original, &Pass::default())
    };
    check(forward(text.clone()), &golden, "out.eps", 2e-5);
    check(forward(text.zeros_like()), &golden, "out.eps_uncond", 2e-5);
    assert_eq!(
        progress_indices(&progress),
        golden.indices("out.prog_index")
    );
    let (_, shape) = golden.values("out.pe");
    let rows: Vec<usize> = (0..shape[0]).collect();
    // The reference computes angles of up to 127 rad in f32.
    let positions = sinusoid(&rows, shape[1], &Device::flex());
    check(positions, &golden, "out.pe", 2e-5);
}

#[test]
fn golden_denoiser_trains_as_it_infers() {
    // The attention with gradients uses separate operations. Without dropout it must agree with the attention without
    // gradients.
    let golden = Golden::read("motionrefit_denoiser");
    let device = Device::flex().autodiff();
    let network = denoiser_on(&device);
    let on_device = |values: Tensor<3>| Tensor::<3>::from_data(values.into_data(), &device);
    let eps = network.forward(
        on_device(golden.tensor("in.x")),
        &golden.indices("in.t"),
        Tensor::from_data(golden.tensor::<2>("in.text").into_data(), &device),
        &golden.f32s("in.prog"),
        on_device(golden.tensor("in.orig")),
        &Pass::default(),
    );
    check(eps.inner(), &golden, "out.eps", 2e-5);
}

#[test]
fn golden_networks_are_saved_under_the_reference_names() {
    check_saved(&denoiser(), "motionrefit_denoiser");
    check_saved(&coordinator(&Device::flex()), "motionrefit_coordinator");
}

/// Checks that a network is saved as the weights of a recorded case.
fn check_saved(network: &impl Module, case: &str) {
    let bytes = to_safetensors(network, Path::new("memory")).expect("saved");
    let saved = SafeTensors::deserialize(&bytes).expect("a safetensors file");
    let recorded = Golden::read(case).weights("weights.");
    let reference = SafeTensors::deserialize(&recorded).expect("a safetensors file");
    let [mut names, mut expected] = [&saved, &reference].map(SafeTensors::names);
    expected.sort_unstable();
    names.sort_unstable();
    assert_eq!(names, expected, "{case}");
    for name in names {
        let original = reference.tensor(name).expect("known");
        let written = saved.tensor(name).expect("written");
        assert_eq!(written.shape(), original.shape(), "{name}");
        assert_eq!(written.data(), original.data(), "{name}");
    }
}

#[test]
fn golden_denoiser_is_imported_as_an_editor_and_exported_again() {
    use train::checkpoint::Slot;
    use train::exchange::{export, import_editor};
    use train::fit::EditorRecord;
    use train::sample::Editor;

    let golden = Golden::read("motionrefit_denoiser");
    let mut config = TrainConfig::preset(Preset::Official);
    config.model = golden.network("dim_model", "dim_feedforward");
    let record = EditorRecord {
        text: frozen_text(config.model.width),
        train: config,
        normalizer: Normalizer {
            min: [-2.5; 3],
            max: [2.5; 3],
        },
        compose: ComposeRecord {
            config: TrainConfig::compose_preset(Preset::Official),
            seed: Seed(0),
        },
        extrapolation: None,
    };
    let bytes = golden.weights("weights.");
    let released = SafeTensors::deserialize(&bytes).expect("a safetensors file");
    let tensors = released.tensors();

    let dir = tempfile::tempdir().expect("a folder");
    let run = dir.path().join("run");
    let device = Device::flex();
    let (skeleton, path) = (Skeleton::smplx_neutral(), Path::new("released.pth"));
    let import = |bytes: Vec<u8>| import_editor(&run, &record, &skeleton, bytes, path, &device);
    for absent in ["embed_prog_ind.time_embed.0.bias", "out.weight"] {
        let fewer = tensors.iter().filter(|(name, _)| name != absent).cloned();
        let fewer = safetensors::serialize(fewer, None).expect("serialises");
        let error = import(fewer).expect_err(absent).to_string();
        assert!(error.ends_with(&format!("{absent} is missing")), "{error}");
    }
    import(bytes.clone()).expect("imported");
    Editor::load(&run, Slot::Best, &device).expect("an editor");

    let out = dir.path().join("out");
    let files = export(&run, Slot::Best, &out).expect("exported");
    let written = std::fs::read(&files[0]).expect("weights");
    let written = SafeTensors::deserialize(&written).expect("a safetensors file");
    for (name, tensor) in &tensors {
        let found = written.tensor(name).expect("exported");
        assert_eq!(found.data(), tensor.data(), "{name}");
    }
    // Row 1, column 1 of the table is the cosine of 1.
    let table = written
        .tensor("positional_encoder.pos_encoding")
        .expect("a table");
    let width = record.train.model.width;
    assert_eq!(table.shape(), [5_000, 1, width]);
    let at = 4 * (width + 1);
    let value = f32::from_le_bytes(table.data()[at..at + 4].try_into().expect("four bytes"));
    assert!((value - 1.0f32.cos()).abs() < 1e-6);
}

/// The recorded case of the schedule, and the schedule of its steps.
fn recorded_schedule() -> (Golden, Schedule) {
    let golden = Golden::read("motionrefit_schedule");
    let steps = golden.values("out.betas").1[0];
    let schedule = Schedule::new(ScheduleName::Official, steps).expect("enough steps");
    (golden, schedule)
}

#[test]
fn golden_schedule_arrays_and_steps() {
    let (golden, schedule) = recorded_schedule();
    let others: [Derived; 2] = [
        ("sqrt_recip_alphas_cumprod", |a| a.recip().sqrt()),
        ("sqrt_recipm1_alphas_cumprod", |a| (a.recip() - 1.0).sqrt()),
    ];
    check_arrays(&golden, "out.", &schedule, &others, 1e-12);
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
    let (golden, schedule) = recorded_schedule();
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
        // The texts are passed below as vectors.
        texts: TextBatch::Words(TokenBatch {
            ids: vec![0; timesteps.len()],
            width: 1,
        }),
        text_kept: vec![1.0; timesteps.len()],
        is_start: vec![false; timesteps.len()],
        timesteps,
    };
    let config = TrainConfig::preset(Preset::Official).diffusion;
    let objective = objective(&schedule, &config);
    let text = golden.tensor("in.loss.text");
    let loss = objective.loss(&denoiser(), &batch, text, &Pass::default());
    let loss: f32 = loss.into_scalar();
    // The loss is a mean of about 3,500 terms, each within the tolerance of the network.
    assert!((loss - golden.f32s("out.loss.value")[0]).abs() < 2e-5);
}

fn coordinator(device: &Device) -> Coordinator {
    let golden = Golden::read("motionrefit_coordinator");
    // The file states the sizes except that of the hidden layer, which the weights show.
    let (_, hidden) = golden.values("weights.transformer.layers.0.linear1.weight");
    let config = NetworkConfig {
        width: golden.size("dim_model"),
        num_layers: golden.size("num_layers"),
        num_heads: golden.size("num_heads"),
        feed_forward: hidden[0],
        dropout: 0.1,
    };
    golden.load(Coordinator::new(&config, FRAME_WIDTH, device), "weights.")
}

#[test]
fn golden_coordinator() {
    let golden = Golden::read("motionrefit_coordinator");
    let network = coordinator(&Device::flex());
    let (x, t) = (golden.tensor::<3>("in.x"), golden.indices("in.t"));
    let probability = network.probability(x.clone(), &t, &Pass::default());
    check(probability, &golden, "out.prob", 2e-6);
    let gradient = floats(&network.gradient(x, &t, &Pass::default()));
    for (found, expected) in gradient.iter().zip(golden.f32s("out.grad")) {
        let slack = 1e-6 + 1e-4 * expected.abs();
        assert!((found - expected).abs() <= slack, "{found} {expected}");
    }

    // The gradient is that of finite differences.
    let x = golden.tensor::<3>("in.x").narrow(0, 0, 1);
    let t = &t[..1];
    let shape = x.dims();
    let values = floats(&x);
    let gradient = floats(&network.gradient(x, t, &Pass::default()));
    let probability = |values: Vec<f32>| -> f64 {
        let x = Tensor::from_data(TensorData::new(values, shape), &Device::flex());
        let p: f32 = network.probability(x, t, &Pass::default()).into_scalar();
        f64::from(p)
    };
    // The directions mix all numbers, so that the difference exceeds f32 rounding.
    for seed in 0..6 {
        let direction: Vec<f32> = (0..values.len())
            .map(|index| ((index * (7 + seed) + seed) as f32 * 0.731).sin())
            .collect();
        let step = 2e-3f32;
        let moved = |step: f32| -> f64 {
            let pairs = values.iter().zip(&direction);
            probability(pairs.map(|(value, way)| value + step * way).collect())
        };
        let numeric = (moved(step) - moved(-step)) / (2.0 * f64::from(step));
        let pairs = gradient.iter().zip(&direction);
        let analytic: f64 = pairs.map(|(gradient, way)| f64::from(gradient * way)).sum();
        // The tolerance covers the third derivative along the direction, and rounding of the probabilities.
        let slack = 1e-2 * analytic.abs() + 1e-4;
        assert!((numeric - analytic).abs() < slack, "{numeric} {analytic}");
    }
}

/// Recorded noises, in the order in which sampling draws them.
struct Draws {
    noise: Vec<f32>,
    shape: [usize; 3],
}

impl Draws {
    /// The noise of a step, or the start without one. Row 0 is the start, row 1 the noisiest step.
    fn of(&self, timestep: Option<usize>, steps: usize) -> Tensor<3> {
        let row = timestep.map_or(0, |t| steps - t);
        let numbers: usize = self.shape.iter().product();
        let values = self.noise[row * numbers..(row + 1) * numbers].to_vec();
        Tensor::from_data(TensorData::new(values, self.shape), &Device::flex())
    }
}

fn floats<const D: usize>(tensor: &Tensor<D>) -> Vec<f32> {
    tensor.to_data().try_into_vec_as().expect("floats")
}

/// Guidance as in the released sampler, in the given number of last steps.
fn released_guide(network: &Coordinator, num_steps: usize, strength: f64) -> Guide<'_> {
    let target = GuidanceTarget::PosteriorMean;
    Guide {
        network,
        config: GuidanceConfig {
            target,
            strength,
            num_steps,
        },
        clock: &|| 0.0,
        secs: Cell::new(0.0),
    }
}

fn check_sampling(case: &str) {
    let golden = Golden::read(case);
    let (_, shape) = golden.values("in.noise");
    let [draws, window, width] = shape[..] else {
        panic!("noise of shape {shape:?}")
    };
    let trace = golden.f32s("out.trace");
    let steps = golden.values("out.trace").1[0];
    assert_eq!(draws, steps + 1);
    let schedule = Schedule::new(ScheduleName::Official, steps).expect("enough steps");
    let draws = Draws {
        noise: golden.f32s("in.noise"),
        shape: [1, window, width],
    };
    let condition = Condition {
        original: golden.tensor("in.orig"),
        fixed: Some(golden.tensor("in.fixed")),
        text: golden.tensor("in.text"),
        progress: golden.f32s("in.prog"),
    };
    let metadata = golden.metadata();
    let number = |key: &str| -> f64 { metadata[key].parse().expect("a number") };
    let coordinator = coordinator(&Device::flex());
    let guided_steps = number("cg_diffusion_steps") as usize;
    let guide = released_guide(&coordinator, guided_steps, number("cg_alpha"));
    let mut worst = 0.0f32;
    let numbers = window * width;
    let network = denoiser();
    Sampler {
        denoiser: &network,
        weights: &network.prepared_weights(Arithmetic::default()),
        schedule: &schedule,
        prediction: Prediction::Noise,
        extrapolation: None,
        clip: true,
        guidance: number("cfg_alpha"),
        coordinator: Some(&guide),
    }
    .sample(
        &condition,
        |timestep| draws.of(timestep, steps),
        |timestep, x| {
            let row = steps - 1 - timestep;
            let expected = &trace[row * numbers..(row + 1) * numbers];
            worst = worst.max(max_difference(&floats(x), expected));
        },
    );
    assert!(worst <= 1e-4, "{worst}");
}

#[test]
fn golden_sampling_with_and_without_guidance() {
    check_sampling("motionrefit_sample_unguided");
    check_sampling("motionrefit_sample_guided");
}

#[test]
fn golden_guided_step() {
    let golden = Golden::read("motionrefit_guided_step");
    let schedule = Schedule::new(ScheduleName::Official, 100).expect("enough steps");
    let network = denoiser();
    let coordinator = coordinator(&Device::flex());
    let x_t = golden.tensor::<3>("in.x_t");
    let text = golden.tensor::<2>("in.text");
    let shape = golden.values("out.mean").1;
    let numbers = shape[1] * shape[2];
    let recorded =
        |name: &str, row: usize| golden.f32s(name)[row * numbers..(row + 1) * numbers].to_vec();
    for (row, t) in golden.indices("in.t").into_iter().enumerate() {
        let pass = Pass::default();
        let predict = |text: Tensor<2>| {
            let progress = golden.f32s("in.prog");
            let original = golden.tensor("in.orig");
            network.forward(x_t.clone(), &[t], text, &progress, original, &pass)
        };
        let eps = guide(predict(text.clone()), predict(text.zeros_like()), 3.0);
        let x0 = schedule.predict_x0(x_t.clone(), &[t], eps).clamp(-1.0, 1.0);
        let mean = schedule.posterior_mean(x0, x_t.clone(), &[t]);
        let close = |found: &Tensor<3>, name: &str| {
            let difference = max_difference(&floats(found), &recorded(name, row));
            assert!(difference <= 5e-6, "{name} at {t}: {difference}");
        };
        close(&mean, "out.mean");
        let gradient = coordinator.gradient(mean.clone(), &[t], &pass);
        close(&gradient, "out.grad");
        let is_guided = t > 0 && t < 5;
        let guided = match is_guided {
            true => mean - gradient.mul_scalar(schedule.posterior_variance[t].sqrt()),
            false => mean,
        };
        close(&guided, "out.mean_guided");
        let sample = schedule.add_noise(guided, t, golden.tensor("in.noise"));
        close(&sample, "out.sample");
    }
}

#[test]
fn golden_autoregressive() {
    use kinematics::KeypointFrame;
    use kinematics::canonical::{GroundTransform, Stitcher};
    use kinematics::normalise::NormalizedFrame;

    let golden = Golden::read("motionrefit_autoregressive");
    let [num_windows, draws, window, width] = golden.values("in.noise").1[..] else {
        panic!("noise of another shape")
    };
    let steps = draws - 1;
    let numbers = window * width;
    let schedule = Schedule::new(ScheduleName::Official, steps).expect("enough steps");
    let axes = |name: &str| -> [f64; 3] { golden.values(name).0.try_into().expect("three axes") };
    let normalizer = Normalizer {
        min: axes("in.min"),
        max: axes("in.max"),
    };
    let triangle: [DVec3; 3] = golden.points("in.rest_triangle").try_into().expect("three");
    let mut stitcher = Stitcher::new(triangle, GroundTransform::IDENTITY);
    let (texts, text_width) = (golden.f32s("in.text"), golden.values("in.text").1[1]);
    let (heard, progress) = (golden.indices("in.text_index"), golden.f32s("in.prog"));
    let (original, noise) = (golden.f32s("in.orig"), golden.f32s("in.noise"));
    let device = Device::flex();
    let network = denoiser();
    let coordinator = coordinator(&device);
    let guide = released_guide(&coordinator, 5, 1.0);
    let expected_fixed = golden.f32s("out.fixed");
    let expected = golden.f32s("out.windows");
    let weights = network.prepared_weights(Arithmetic::default());
    for index in 0..num_windows {
        let original = &original[index * numbers..(index + 1) * numbers];
        let normalize = |frame: &KeypointFrame| normalizer.normalize(frame);
        let fixed: Vec<f32> = match stitcher.next_fixed() {
            Some(frames) => frames.iter().flat_map(normalize).collect(),
            None => original[..FIXED_FRAMES * width].to_vec(),
        };
        let recorded = &expected_fixed[index * fixed.len()..(index + 1) * fixed.len()];
        assert!(max_difference(&fixed, recorded) < 1e-4, "window {index}");
        let text = &texts[heard[index] * text_width..][..text_width];
        let tensor = |values: &[f32], frames: usize| -> Tensor<3> {
            let values = TensorData::new(values.to_vec(), [1, frames, width]);
            Tensor::from_data(values, &device)
        };
        let condition = Condition {
            original: tensor(original, window),
            fixed: Some(tensor(&fixed, FIXED_FRAMES)),
            text: Tensor::from_data(TensorData::new(text.to_vec(), [1, text_width]), &device),
            progress: vec![progress[index]],
        };
        let draws = Draws {
            noise: noise[index * draws * numbers..(index + 1) * draws * numbers].to_vec(),
            shape: [1, window, width],
        };
        let x = Sampler {
            denoiser: &network,
            weights: &weights,
            schedule: &schedule,
            prediction: Prediction::Noise,
            extrapolation: None,
            clip: true,
            guidance: 3.0,
            coordinator: Some(&guide),
        }
        .sample(&condition, |timestep| draws.of(timestep, steps), |_, _| {});
        let x = floats(&x);
        let recorded = &expected[index * numbers..(index + 1) * numbers];
        let difference = max_difference(&x, recorded);
        assert!(difference <= 1e-4, "window {index}: {difference}");
        let frames: Vec<KeypointFrame> = x
            .chunks_exact(width)
            .map(|frame| normalizer.denormalize(&NormalizedFrame::from_model_units(frame)))
            .collect();
        stitcher.push(&frames);
    }
    let merged = stitcher.into_frames();
    let recorded = golden.points("out.merged");
    for (point, recorded) in merged.as_flattened().iter().zip(recorded) {
        assert!(point.distance(recorded) < 1e-3, "{point} {recorded}");
    }
}

fn recorded_poses(golden: &Golden) -> Vec<Pose> {
    let rotations = golden.points("in.rots");
    let frames = golden.points("in.trans").into_iter().enumerate();
    let poses = frames.map(|(frame, transl)| Pose {
        transl,
        rotations: std::array::from_fn(|joint| {
            rotation::from_axis_angle(rotations[22 * frame + joint])
        }),
    });
    poses.collect()
}

#[test]
fn golden_evaluator_features() {
    let golden = Golden::read("motionfix_features");
    let features = smpl135(&recorded_poses(&golden));
    // The reference multiplies a chain of matrices in f32.
    let difference = max_difference(features.as_flattened(), &golden.f32s("out.evaluator135"));
    assert!(difference < 5e-6, "{difference}");
}
