//! The trainer learns, stops and continues, and the editor is repeatable.

use std::f64::consts::{PI, SQRT_2};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use burn::optim::{AdamWConfig, GradientsParams};
use burn::tensor::{Device, Tensor};
use datasets_spec::canonical::{FIXED_FRAMES, WINDOW_FRAMES};
use datasets_spec::normalise::{FRAME_WIDTH, Normalizer};
use datasets_spec::{Fps, Motion, NoProgress, Pose, Progress, Seed, Skeleton};
use glam::{DQuat, DVec3};
use rand::RngExt;
use rand_distr::StandardNormal;
use train::checkpoint::Slot;
use train::config::{Decay, DiffusionConfig, NetworkConfig, Preset, TrainConfig};
use train::data::{NoisyBatch, WINDOW_NUMBERS, WindowBatch, WindowSource};
use train::diffusion::{Prediction, Schedule, training_loss};
use train::fit::{Corpus, TrainReport, train_motionrefit};
use train::model::motionrefit::MotionRefit;
use train::model::weights::draw;
use train::sample::{EditItem, EditSettings, Editor};
use train::tmr::{CaptionedMotion, TmrConfig, TmrCorpus, TmrEncoder, train_tmr};
use train::vocabulary::Vocabulary;
use train::{Error, Session};

/// Pairs of waves: the instruction says by how much the edited one is raised.
struct Waves {
    items: u64,
}

const HEIGHTS: [(&str, f32); 2] = [("raise it", 0.5), ("lower it", -0.5)];

impl WindowSource for Waves {
    fn epoch_len(&self) -> u64 {
        self.items
    }

    fn fill(
        &self,
        _epoch: u64,
        first_item: u64,
        num_items: usize,
        batch: &mut WindowBatch,
    ) -> Result<(), Error> {
        *batch = WindowBatch::default();
        for item in first_item..first_item + num_items as u64 {
            let (instruction, height) = HEIGHTS[item as usize % HEIGHTS.len()];
            for index in 0..WINDOW_NUMBERS {
                let (frame, channel) = (index / FRAME_WIDTH, index % FRAME_WIDTH);
                let wave = 0.3 * (0.4 * frame as f32 + channel as f32 + item as f32).sin();
                batch.original.push(wave);
                batch.edited.push(wave + height);
            }
            batch.progress.push(0.5);
            batch.instructions.push(instruction.to_owned());
        }
        Ok(())
    }
}

fn small_config(num_steps: u64) -> TrainConfig {
    let mut config = TrainConfig::preset(Preset::Tiny);
    config.model = NetworkConfig {
        width: 32,
        num_layers: 2,
        num_heads: 4,
        feed_forward: 64,
        dropout: 0.0,
    };
    config.batch_size = 8;
    config.num_steps = num_steps;
    config.log_every = 5;
    config.val_every = 10;
    config.val_windows = 12;
    config.optimizer.warmup_steps = 5;
    config
}

/// Stops a run after so many steps.
struct StopAfter<'a> {
    stop: &'a AtomicBool,
    steps: AtomicU64,
}

impl Progress for StopAfter<'_> {
    fn begin(&self, _stage: &str, _total: Option<u64>) {}
    fn advance(&self, count: u64) {
        let left = self.steps.load(Ordering::Relaxed).saturating_sub(count);
        self.steps.store(left, Ordering::Relaxed);
        self.stop.store(left == 0, Ordering::Relaxed);
    }
    fn message(&self, _text: &str) {}
    fn finish(&self, _summary: &str) {}
}

fn train_until(
    run: &Path,
    config: &TrainConfig,
    source: &dyn WindowSource,
    progress: &dyn Progress,
    stop: &AtomicBool,
) -> Result<TrainReport, Error> {
    let begun = Instant::now();
    train_motionrefit(
        run,
        config,
        Corpus {
            train: source,
            val: source,
            instructions: &HEIGHTS.map(|(text, _)| text.to_owned()),
            normalizer: Normalizer {
                min: [-2.0, 0.0, -2.0],
                max: [2.0, 2.0, 2.0],
            },
            skeleton: "smplx-neutral",
            dataset_hash: "0",
        },
        &Session {
            device: &Device::flex(),
            progress,
            stop,
            clock: &|| begun.elapsed(),
        },
    )
}

fn train(run: &Path, config: &TrainConfig, source: &dyn WindowSource) -> TrainReport {
    let stop = AtomicBool::new(false);
    train_until(run, config, source, &NoProgress, &stop).expect("trains")
}

fn logged_losses(run: &Path) -> Vec<(u64, f64)> {
    std::fs::read_to_string(run.join("metrics.jsonl"))
        .expect("metrics")
        .lines()
        .map(|line| serde_json::from_str::<serde_json::Value>(line).expect("JSON"))
        .map(|line| {
            let loss = line.get("loss").or_else(|| line.get("val_loss"));
            (
                line["step"].as_u64().expect("a step"),
                loss.and_then(serde_json::Value::as_f64).expect("a loss"),
            )
        })
        .collect()
}

/// The mean smooth-L1 distance from zero of a normal number of the given spread.
fn expected_smooth_l1(sigma: f64) -> f64 {
    let cut = 1.0 / sigma;
    let density = (-0.5 * cut * cut).exp() / (2.0 * PI).sqrt();
    // The error function by the integral of its series, which converges fast up to 1.
    let x = cut / SQRT_2;
    let mut term = x;
    let mut erf = x;
    for n in 1..30 {
        term *= -x * x / f64::from(n);
        erf += term / f64::from(2 * n + 1);
    }
    let inside = erf * 2.0 / PI.sqrt();
    0.5 * sigma * sigma * (inside - 2.0 * cut * density) + 2.0 * sigma * density
        - 0.5 * (1.0 - inside)
}

#[test]
fn the_first_loss_is_that_of_an_untrained_network() {
    // For unit normal noise and a prediction of zero, by hand: 0.4247.
    assert!((expected_smooth_l1(1.0) - 0.4247).abs() < 1e-4);
    let dir = tempfile::tempdir().expect("a folder");
    let mut config = small_config(1);
    config.diffusion.prediction = Prediction::Noise;
    config.optimizer.learning_rate = 0.0;
    config.batch_size = 64;
    let report = train(dir.path(), &config, &Waves { items: 64 });
    // The output layer maps tokens of unit variance by weights of variance 1/3 over the width, so
    // an untrained prediction adds a third to the variance. Ten per cent covers one network's
    // draw of 84 output rows over tokens that resemble each other.
    let expected = expected_smooth_l1((4.0f64 / 3.0).sqrt());
    let first = report.first_loss.expect("a line");
    assert!((first / expected - 1.0).abs() < 0.1, "{first} {expected}");
}

#[test]
fn one_batch_is_overfitted() {
    let device = Device::flex().autodiff();
    let config = TrainConfig::preset(Preset::Tiny);
    let schedule =
        Schedule::new(config.diffusion.schedule, config.diffusion.num_steps).expect("enough steps");
    let vocabulary = Vocabulary::build(HEIGHTS.map(|(text, _)| text), 1, 4).expect("valid");
    let mut windows = WindowBatch::default();
    Waves { items: 4 }
        .fill(0, 0, 4, &mut windows)
        .expect("made");
    let mut rng = Seed(1).rng(&["overfit"]);
    let batch = NoisyBatch {
        tokens: vocabulary.encode_batch(windows.instructions.iter().map(String::as_str)),
        original: windows.original,
        edited: windows.edited,
        noise: (0..4 * WINDOW_NUMBERS)
            .map(|index| {
                if index % WINDOW_NUMBERS < FIXED_FRAMES * FRAME_WIDTH {
                    0.0
                } else {
                    rng.sample(StandardNormal)
                }
            })
            .collect(),
        timesteps: vec![5, 15, 30, 45],
        progress: windows.progress,
        text_kept: vec![1.0; 4],
    };
    let diffusion = DiffusionConfig {
        prediction: Prediction::Noise,
        ..config.diffusion
    };
    // Wider than the 84 numbers of a frame, or the noise would not fit through.
    let network = NetworkConfig {
        width: 128,
        num_layers: 1,
        ..config.model
    };
    let mut model = draw(
        MotionRefit::new(&network, vocabulary.num_tokens(), &device),
        Seed(2),
    );
    let mut optimizer = AdamWConfig::new().with_epsilon(1e-8).init();
    let mut losses = Vec::new();
    for step in 0..400 {
        let loss = model.loss(&schedule, &batch, &diffusion);
        losses.push(loss.clone().into_scalar::<f32>());
        let gradients = GradientsParams::from_grads(loss.backward(), &model);
        let rate = 3e-3 * (1.0 - f64::from(step) / 400.0);
        model = optimizer.step(rate, model, gradients);
    }
    let (first, last) = (losses[0], losses[399]);
    assert!(last < 0.05 * first, "{first} fell to {last}");
}

#[test]
fn a_dropped_instruction_leaves_no_trace() {
    let device = Device::flex();
    let config = small_config(1);
    let schedule =
        Schedule::new(config.diffusion.schedule, config.diffusion.num_steps).expect("enough steps");
    let vocabulary = Vocabulary::build(HEIGHTS.map(|(text, _)| text), 1, 4).expect("valid");
    let model = draw(
        MotionRefit::new(&config.model, vocabulary.num_tokens(), &device),
        Seed(4),
    );
    let loss = |text: &str, text_kept: f32| {
        let batch = NoisyBatch {
            original: vec![0.1; WINDOW_NUMBERS],
            edited: vec![0.2; WINDOW_NUMBERS],
            noise: vec![0.3; WINDOW_NUMBERS],
            timesteps: vec![10],
            progress: vec![0.5],
            tokens: vocabulary.encode_batch([text]),
            text_kept: vec![text_kept],
        };
        let of_zeros = training_loss(
            &model.denoiser,
            &schedule,
            &batch,
            Tensor::zeros([1, config.model.width], &device),
            &config.diffusion,
        );
        let loss = model.loss(&schedule, &batch, &config.diffusion);
        (loss.into_scalar::<f32>(), of_zeros.into_scalar::<f32>())
    };
    let (raised, without) = loss("raise it", 1.0);
    let (lowered, _) = loss("lower it", 1.0);
    assert!(raised != lowered && raised != without);
    assert_eq!(loss("raise it", 0.0), (without, without));
    assert_eq!(loss("lower it", 0.0), (without, without));
}

#[test]
fn the_loss_falls_and_the_best_checkpoint_is_kept() {
    let dir = tempfile::tempdir().expect("a folder");
    let mut config = small_config(200);
    config.batch_size = 16;
    config.val_every = 50;
    config.optimizer.learning_rate = 3e-3;
    let report = train(dir.path(), &config, &Waves { items: 16 });
    assert!(report.is_complete && report.steps == 200);
    let best = report.best_val_loss.expect("validated");
    assert!(best < 0.1 * report.first_loss.expect("a line"), "{best}");
    let losses: Vec<(u64, f64)> = logged_losses(dir.path());
    assert!(losses.iter().all(|&(_, loss)| loss.is_finite()));
    Editor::load(dir.path(), Slot::Best, &Device::flex()).expect("loads");
}

#[test]
fn an_interrupted_run_ends_as_an_uninterrupted_one() {
    let source = Waves { items: 20 };
    let config = small_config(25);
    let whole = tempfile::tempdir().expect("a folder");
    train(whole.path(), &config, &source);

    let parts = tempfile::tempdir().expect("a folder");
    // In the middle of a line of the metrics, right after a checkpoint, and after its end.
    for steps in [7, 3, 100] {
        let stop = AtomicBool::new(false);
        let progress = StopAfter {
            stop: &stop,
            // A session first reports the steps of those before it.
            steps: AtomicU64::new(steps + steps_done(parts.path())),
        };
        train_until(parts.path(), &config, &source, &progress, &stop).expect("trains");
    }
    assert_eq!(logged_losses(parts.path()), logged_losses(whole.path()));
    for slot in ["last", "best"] {
        for name in ["denoiser.safetensors", "text.safetensors", "state.json"] {
            let path = Path::new("checkpoint").join(slot).join(name);
            let read = |run: &Path| std::fs::read(run.join(&path)).expect("a file");
            assert!(
                read(whole.path()) == read(parts.path()),
                "{} differs",
                path.display()
            );
        }
    }
}

/// Steps of the last checkpoint of a run.
fn steps_done(run: &Path) -> u64 {
    std::fs::read(run.join("checkpoint/last/state.json")).map_or(0, |state| {
        let state: serde_json::Value = serde_json::from_slice(&state).expect("JSON");
        state["step"].as_u64().expect("a step")
    })
}

#[test]
fn a_folder_of_another_run_is_refused() {
    let dir = tempfile::tempdir().expect("a folder");
    let source = Waves { items: 8 };
    train(dir.path(), &small_config(1), &source);
    let stop = AtomicBool::new(false);
    let mut other = small_config(1);
    other.optimizer.decay = Decay::Constant;
    match train_until(dir.path(), &other, &source, &NoProgress, &stop) {
        Err(Error::OtherRun { field, .. }) => {
            assert_eq!(field, "config.train.optimizer.decay");
        }
        other => panic!("expected a refusal, got {other:?}"),
    }
    let weights = dir.path().join("checkpoint/last/denoiser.safetensors");
    let mut bytes = std::fs::read(&weights).expect("weights");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&weights, bytes).expect("damaged");
    assert!(matches!(
        train_until(dir.path(), &small_config(1), &source, &NoProgress, &stop),
        Err(Error::Corrupt { .. })
    ));
}

/// A body that walks and swings its arms.
fn walk(num_frames: usize, speed: f64, phase: f64) -> Motion {
    let poses: Vec<Pose> = (0..num_frames)
        .map(|frame| {
            let t = frame as f64 / Fps::STORE.get();
            let mut pose = Pose {
                transl: DVec3::new(0.0, 0.9, speed * t),
                ..Pose::REST
            };
            let swing = 0.5 * (6.0 * t + phase).sin();
            for (joint, side) in [(1, 1.0), (2, -1.0), (16, -1.0), (17, 1.0)] {
                pose.rotations[joint] = DQuat::from_rotation_x(side * swing);
            }
            pose
        })
        .collect();
    Motion::from_poses(Fps::STORE, &poses).expect("a motion")
}

#[test]
fn edits_repeat_by_seed_and_do_not_feel_their_neighbours() {
    let dir = tempfile::tempdir().expect("a folder");
    train(dir.path(), &small_config(10), &Waves { items: 20 });
    let editor = Editor::load(dir.path(), Slot::Best, &Device::flex()).expect("loads");
    let skeleton = Skeleton::smplx_neutral();
    let normalizer = editor.record().config.normalizer;
    let item = |id: &str, num_frames: usize, instruction: &str| {
        let motion = walk(num_frames, 1.0, 0.0);
        EditItem::new(id, &motion, instruction, &skeleton, &normalizer).expect("long enough")
    };
    let items = [
        item("a", 61, "raise it"),
        item("b", 31, "lower it"),
        item("c", 93, "raise it"),
    ];
    let settings = EditSettings {
        seed: Seed(5),
        guidance: 2.0,
        max_batch: 2,
    };
    let edit = |items: &[EditItem], settings: &EditSettings| {
        editor
            .edit_batch(items, &skeleton, settings, &NoProgress)
            .expect("edits")
    };
    let together = edit(&items, &settings);
    // 61 frames at 20 fps are 31 at 10, which hold windows at 0 and 14.
    let lengths: Vec<usize> = together.iter().map(Vec::len).collect();
    assert_eq!(lengths, [30, WINDOW_FRAMES, 44]);
    assert_eq!(edit(&items, &settings), together);

    let difference = |a: &[[DVec3; 28]], b: &[[DVec3; 28]]| {
        a.as_flattened()
            .iter()
            .zip(b.as_flattened())
            .map(|(a, b)| (*a - *b).length())
            .fold(0.0, f64::max)
    };
    let alone = edit(&items[2..], &settings);
    // Matrix products may add in another order when the batch is smaller: f32 rounding, carried
    // through 50 steps of three windows, stays below a tenth of a millimetre.
    assert!(difference(&alone[0], &together[2]) < 1e-4);
    let other = edit(
        &items,
        &EditSettings {
            seed: Seed(6),
            ..settings
        },
    );
    assert!(difference(&other[0], &together[0]) > 1e-3);

    // The generated motion starts on the first two frames of the original.
    let source = skeleton.motion_keypoints(&walk(61, 1.0, 0.0));
    assert!(difference(&together[0][..1], &source.points[..1]) < 1e-5);
    assert!(difference(&together[0][1..2], &source.points[2..3]) < 1e-5);
}

#[test]
fn motions_too_short_for_a_window_are_refused_by_name() {
    let skeleton = Skeleton::smplx_neutral();
    let normalizer = Normalizer {
        min: [-1.0; 3],
        max: [1.0; 3],
    };
    let short = walk(30, 1.0, 0.0);
    match EditItem::new("short", &short, "wave", &skeleton, &normalizer) {
        Err(Error::Motion { id, .. }) => assert_eq!(id, "short"),
        other => panic!("expected a refusal, got {other:?}"),
    }
}

/// Joints turned by a rotation vector in radians.
const ARMS_UP: [(usize, DVec3); 2] = [
    (16, DVec3::new(0.0, 0.0, 1.2)),
    (17, DVec3::new(0.0, 0.0, -1.2)),
];
const SITTING: [(usize, DVec3); 4] = [
    (1, DVec3::new(-1.4, 0.0, 0.0)),
    (2, DVec3::new(-1.4, 0.0, 0.0)),
    (4, DVec3::new(1.4, 0.0, 0.0)),
    (5, DVec3::new(1.4, 0.0, 0.0)),
];

#[test]
fn the_encoder_learns_to_tell_motions_apart() {
    let dir = tempfile::tempdir().expect("a folder");
    let kinds: [(&str, &[(usize, DVec3)]); 3] = [
        ("walk", &[]),
        ("raise both arms", &ARMS_UP),
        ("sit down", &SITTING),
    ];
    let motions: Vec<(String, Motion, Vec<String>)> = (0..18)
        .map(|index| {
            let (text, turns) = kinds[index % kinds.len()];
            let mut motion = walk(50 + 2 * index, 0.1 * index as f64, index as f64);
            for frame in 0..motion.len() {
                for (joint, turn) in turns {
                    motion.set_axis_angle(frame, *joint, turn.as_vec3().to_array());
                }
            }
            (index.to_string(), motion, vec![text.to_owned()])
        })
        .collect();
    let clips: Vec<CaptionedMotion<'_>> = motions
        .iter()
        .map(|(id, motion, captions)| CaptionedMotion {
            id,
            motion,
            captions,
        })
        .collect();
    let mut config = TmrConfig::preset(Preset::Tiny);
    config.max_frames = 24;
    config.batch_size = 18;
    config.num_steps = 150;
    config.val_every = 150;
    let stop = AtomicBool::new(false);
    let report = train_tmr(
        dir.path(),
        &config,
        TmrCorpus {
            train: &clips,
            val: &clips,
            skeleton: "smplx-neutral",
            dataset_hash: "0",
        },
        &Session {
            device: &Device::flex(),
            progress: &NoProgress,
            stop: &stop,
            clock: &|| Duration::ZERO,
        },
    )
    .expect("trains");
    let (first, last) = (
        report.first_loss.expect("a line"),
        report.last_loss.expect("a line"),
    );
    assert!(last < 0.7 * first, "{first} fell to {last}");

    let encoder = TmrEncoder::load(dir.path(), Slot::Last, &Device::flex()).expect("loads");
    let refs: Vec<&Motion> = motions.iter().map(|(_, motion, _)| motion).collect();
    let codes = encoder.encode(&refs).expect("encodes");
    let texts = encoder.encode_texts(&kinds.map(|(text, _)| text));
    let cosine = |a: &[f32], b: &[f32]| {
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>();
        dot(a, b) / (dot(a, a) * dot(b, b)).sqrt()
    };
    let right = codes
        .iter()
        .enumerate()
        .filter(|(index, code)| {
            let best = (0..kinds.len())
                .max_by(|&a, &b| cosine(code, &texts[a]).total_cmp(&cosine(code, &texts[b])));
            best == Some(index % kinds.len())
        })
        .count();
    // Guessing gets 6 of 18.
    assert!(right >= 15, "{right} of 18 motions found their text");
    // Padding to a longer neighbour must not matter: f32 rounding of another batch shape.
    let alone = encoder.encode(&refs[..1]).expect("encodes");
    for (a, b) in alone[0].iter().zip(&codes[0]) {
        assert!((a - b).abs() < 1e-4, "{a} {b}");
    }
    assert_eq!(encoder.hash().len(), 64);
}
