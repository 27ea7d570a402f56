//! The trainer learns, stops and continues runs, and edits are repeatable.

mod coordinator;
mod edits;
mod encoder;
mod mdm;
mod mld;
mod runs;
mod tmed;

use std::f64::consts::{PI, SQRT_2};
use std::path::Path;
use std::sync::LazyLock;

use burn::module::Module;
use burn::optim::{AdamWConfig, GradientsParams};
use burn::tensor::{Device, Tensor};
use compose::{ComposeConfig, CoordinatorBatch};
use datasets_spec::{Fps, Motion, Pose, Seed, Skeleton};
use glam::{DQuat, DVec3};
use kinematics::KeypointFrame;
use kinematics::canonical::{FIXED_FRAMES, WINDOW_FRAMES};
use kinematics::normalise::{FRAME_WIDTH, Normalizer};
use rand::RngExt;
use rand_distr::StandardNormal;
use train::captioned::{CaptionedClip, CaptionedCorpus};
use train::checkpoint::{Slot, Start};
use train::compose::ComposeRecord;
use train::config::{
    Decay, DiffusionConfig, NetworkConfig, NoiseKind, Prediction, Preset, PreviousFrames,
    RunLength, TextEncoder, TrainConfig,
};
use train::coordinator::{CoordinatorConfig, Segments, TrainedCoordinator, train_coordinator};
use train::data::{NoisyBatch, TextBatch, WindowBatch, WindowSource};
use train::exchange::export;
use train::features::FeatureRecipe;
use train::fit::{Corpus, EditorRecord, TextRecord, TrainReport, train_motionrefit};
use train::model::motionrefit::{MotionRefit, TextSource};
use train::model::pass::Pass;
use train::model::weights::draw;
use train::sample::{EditItem, EditSettings, EditTimes, Editor, TimedInstruction};
use train::schedule::Schedule;
use train::text::table::EmbeddingTable;
use train::tmr::{TmrConfig, TmrEncoder, train_tmr};
use train::vocabulary::Vocabulary;
use train::{Error, Session};

use crate::shared::{METRES, edit_settings, objective, quietly, refused};

/// Composition settings of all runs here.
static COMPOSE: LazyLock<ComposeRecord> = LazyLock::new(|| ComposeRecord {
    config: ComposeConfig::default(),
    seed: Seed(0),
});

/// Number of values in a window of 16 frames.
const WINDOW_NUMBERS: usize = WINDOW_FRAMES * FRAME_WIDTH;

/// Pairs of waves; the instruction tells how far the edited wave is raised.
#[derive(Default)]
struct Waves {
    items: u64,
    /// Number of the first wave, which gives its phase.
    first: u64,
    /// Whether a number in each batch is infinite.
    is_broken: bool,
}

fn waves(items: u64) -> Waves {
    Waves {
        items,
        ..Waves::default()
    }
}

/// Waves with other phases than the training waves.
static HELD_OUT: Waves = Waves {
    items: 64,
    first: 1_000,
    is_broken: false,
};

const HEIGHTS: [(&str, f32); 2] = [("raise it", 0.5), ("lower it", -0.5)];

static INSTRUCTIONS: LazyLock<[String; 2]> =
    LazyLock::new(|| HEIGHTS.map(|(text, _)| text.to_owned()));

impl WindowSource for Waves {
    fn epoch_len(&self) -> u64 {
        self.items
    }

    fn window_len(&self) -> usize {
        WINDOW_NUMBERS
    }

    fn fill(
        &self,
        _epoch: u64,
        first_item: u64,
        num_items: usize,
        batch: &mut WindowBatch,
    ) -> Result<(), Error> {
        *batch = WindowBatch::default();
        for item in (self.first + first_item..).take(num_items) {
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
        if self.is_broken {
            batch.edited[WINDOW_NUMBERS - 1] = f32::INFINITY;
        }
        Ok(())
    }
}

/// Sizes of a network without dropout.
fn network_of(width: usize, num_layers: usize) -> NetworkConfig {
    NetworkConfig {
        width,
        num_layers,
        num_heads: 4,
        feed_forward: 64,
        dropout: 0.0,
    }
}

fn small_config(num_steps: u64) -> TrainConfig {
    let mut config = TrainConfig::preset(Preset::Tiny);
    config.model = network_of(32, 2);
    config.run.batch_size = 8;
    config.run.length = RunLength::of_steps(num_steps);
    config.run.log_every = 5;
    config.run.val_every = 10;
    config.val_windows = 12;
    config.run.optimizer.warmup_steps = 5;
    config.run.optimizer.ema_decay = None;
    config
}

/// The same settings for predicting the plain change. The text determines it, so its loss can fall far, while a
/// residual is largely unpredictable.
fn change_config(num_steps: u64) -> TrainConfig {
    let mut config = small_config(num_steps);
    config.diffusion.prediction = Prediction::Change;
    config.diffusion.noise = NoiseKind::White;
    config.diffusion.bone_weight = 0.0;
    config.diffusion.fixed_noise = 0.0;
    config.diffusion.generated_starts = 0.0;
    config
}

static SKELETON: LazyLock<Skeleton> = LazyLock::new(Skeleton::smplx_neutral);

/// Trains on the given windows and validates on held-out ones.
fn corpus(source: &dyn WindowSource) -> Corpus<'_> {
    Corpus {
        train: source,
        val: &HELD_OUT,
        instructions: &INSTRUCTIONS[..],
        vectors: None,
        normalizer: Normalizer {
            min: [-2.0, 0.0, -2.0],
            max: [2.0, 2.0, 2.0],
        },
        skeleton: &SKELETON,
        dataset_hash: "0",
        compose: &COMPOSE,
    }
}

fn try_to_train<'a>(
    run: impl Into<Start<'a>>,
    config: &TrainConfig,
    source: &dyn WindowSource,
) -> Result<TrainReport, Error> {
    quietly(|session| train_motionrefit(run, config, corpus(source), session))
}

fn train(run: &Path, config: &TrainConfig, source: &dyn WindowSource) -> TrainReport {
    try_to_train(run, config, source).expect("trains")
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

/// The mean smooth-L1 loss of a normal variable with mean zero and standard deviation `sigma`.
fn expected_smooth_l1(sigma: f64) -> f64 {
    let cut = 1.0 / sigma;
    let density = (-0.5 * cut * cut).exp() / (2.0 * PI).sqrt();
    // The error function by the integral of its series, which converges fast for arguments up to 1.
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
    // Computed by hand for unit normal noise and a prediction of zero: 0.4247.
    assert!((expected_smooth_l1(1.0) - 0.4247).abs() < 1e-4);
    let dir = tempfile::tempdir().expect("a folder");
    let mut config = small_config(1);
    config.diffusion.prediction = Prediction::Noise;
    config.diffusion.noise = NoiseKind::White;
    config.diffusion.contact_weight = 0.0;
    config.diffusion.bone_weight = 0.0;
    config.run.optimizer.learning_rate = 0.0;
    config.run.batch_size = 64;
    let report = train(dir.path(), &config, &waves(64));
    // The output layer maps tokens of unit variance by weights of variance 1/3 over the width, so an untrained
    // prediction adds a third to the variance. The tolerance of ten per cent covers the random draw of 84 output rows,
    // applied to similar tokens.
    let expected = expected_smooth_l1((4.0f64 / 3.0).sqrt());
    let first = report.first_loss.expect("a line");
    assert!((first / expected - 1.0).abs() < 0.1, "{first} {expected}");
}

#[test]
fn one_batch_is_overfitted() {
    let device = Device::flex().autodiff();
    let config = TrainConfig::preset(Preset::Tiny);
    let diffusion = DiffusionConfig {
        noise: NoiseKind::White,
        prediction: Prediction::Noise,
        contact_weight: 0.0,
        bone_weight: 0.0,
        ..config.diffusion
    };
    // The network is wider than the 84 numbers of a frame, because all of the noise must pass through it.
    let network = NetworkConfig {
        width: 128,
        num_layers: 1,
        ..config.model
    };
    let (schedule, vocabulary, model) = untrained(&network, &diffusion, 2, &device);
    let mut windows = WindowBatch::default();
    waves(4).fill(0, 0, 4, &mut windows).expect("made");
    let texts = windows.instructions.iter().map(String::as_str);
    let mut rng = Seed(1).rng(&["overfit"]);
    let noise = (0..4 * WINDOW_NUMBERS).map(|index| {
        let is_fixed = index % WINDOW_NUMBERS < FIXED_FRAMES * FRAME_WIDTH;
        match is_fixed {
            true => 0.0,
            false => rng.sample(StandardNormal),
        }
    });
    let batch = NoisyBatch {
        texts: TextBatch::Words(vocabulary.encode_batch(texts)),
        original: windows.original,
        edited: windows.edited,
        noise: noise.collect(),
        timesteps: vec![2, 6, 12, 18],
        progress: windows.progress,
        text_kept: vec![1.0; 4],
        is_start: vec![false; 4],
    };
    let (objective, pass) = (objective(&schedule, &diffusion), Pass::default());
    check_overfits(model, 800, 3e-3, |model| {
        model.loss(&objective, &batch, &device, &pass)
    });
}

/// A schedule, the words of the instructions, and an untrained network.
fn untrained(
    network: &NetworkConfig,
    diffusion: &DiffusionConfig,
    seed: u64,
    device: &Device,
) -> (Schedule, Vocabulary, MotionRefit) {
    let schedule = Schedule::new(diffusion.schedule, diffusion.num_steps).expect("enough steps");
    let vocabulary = Vocabulary::build(HEIGHTS.map(|(text, _)| text), 1, 4).expect("valid");
    let text = TextSource::Learned(vocabulary.num_tokens());
    let model = MotionRefit::new(network, diffusion, text, FRAME_WIDTH, device);
    let model = draw(model, Seed(seed)).expect("known layers");
    (schedule, vocabulary, model)
}

#[test]
fn a_dropped_instruction_leaves_no_trace() {
    let device = Device::flex();
    let config = change_config(1);
    let (schedule, vocabulary, model) = untrained(&config.model, &config.diffusion, 4, &device);
    let loss = |text: &str, text_kept: f32| {
        let batch = NoisyBatch {
            original: vec![0.1; WINDOW_NUMBERS],
            edited: vec![0.2; WINDOW_NUMBERS],
            noise: vec![0.3; WINDOW_NUMBERS],
            timesteps: vec![10],
            progress: vec![0.5],
            texts: TextBatch::Words(vocabulary.encode_batch([text])),
            text_kept: vec![text_kept],
            is_start: vec![false],
        };
        let objective = objective(&schedule, &config.diffusion);
        let nothing = Tensor::zeros([1, config.model.width], &device);
        let pass = Pass::default();
        let of_zeros = objective.loss(&model.denoiser, &batch, nothing, &pass);
        let loss = model.loss(&objective, &batch, &device, &pass);
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
    let mut config = change_config(200);
    config.run.batch_size = 16;
    config.run.val_every = 50;
    config.run.optimizer.learning_rate = 3e-3;
    let report = train(dir.path(), &config, &waves(16));
    assert!(report.is_complete && report.steps == 200);
    let best = report.best_val_loss.expect("validated");
    assert!(best < 0.1 * report.first_loss.expect("a line"), "{best}");
    let losses: Vec<(u64, f64)> = logged_losses(dir.path());
    assert!(losses.iter().all(|&(_, loss)| loss.is_finite()));
    Editor::load(dir.path(), Slot::Best, &Device::flex()).expect("loads");
}

#[test]
fn gates_are_learned_and_loaded_and_never_exported_in_part() {
    let dir = tempfile::tempdir().expect("a folder");
    let mut config = small_config(100);
    config.run.batch_size = 16;
    config.run.optimizer.learning_rate = 3e-3;
    config.diffusion.prediction = Prediction::Gated;
    config.diffusion.tell_frames = false;
    let first = train(dir.path(), &config, &waves(16));
    let (begun, ended) = (first.first_loss, first.best_val_loss);
    let fell = ended.expect("validated") / begun.expect("a line");
    assert!(fell < 0.2, "{fell}");
    Editor::load(dir.path(), Slot::Best, &Device::flex()).expect("loads");
    // Without the covariance of its noise, the editor would sample with other noise than in training.
    let path = dir.path().join("config.json");
    let whole = std::fs::read_to_string(&path).expect("a record");
    let mut record: serde_json::Value = serde_json::from_str(&whole).expect("JSON");
    let extrapolation = record["config"]["extrapolation"].as_object_mut();
    let shape = extrapolation.expect("fitted").remove("shape");
    assert!(shape.is_some(), "fitted");
    std::fs::write(&path, record.to_string()).expect("writes");
    let loaded = Editor::load(dir.path(), Slot::Best, &Device::flex());
    refused(loaded, "extrapolation.shape");
    std::fs::write(&path, whole).expect("writes");
    let [told, alone] = [(); 2].map(|()| tempfile::tempdir().expect("a folder"));
    config.run.length.steps = 1;
    config.diffusion.tell_frames = true;
    train(told.path(), &config, &waves(16));
    let mut plain = change_config(1);
    plain.diffusion.tell_frames = true;
    train(alone.path(), &plain, &waves(16));
    // The released network has neither learned words nor gates nor `tell_frames`. All that a model has beyond it is named
    // at once.
    for (run, why) in [
        (&dir, "it has learned words and gate,"),
        (&alone, "it has learned words and tell_frames,"),
        (&told, "it has learned words and tell_frames and gate,"),
    ] {
        let out = tempfile::tempdir().expect("a folder");
        refused(export(run.path(), Slot::Best, out.path()), why);
        let mut left = std::fs::read_dir(out.path()).expect("a folder");
        assert!(left.next().is_none());
    }
}

/// Stops the sessions of a run after the given numbers of steps, and checks that it ends as an uninterrupted run, with
/// the same losses and the same files in its checkpoints. Returns the folders of the uninterrupted and the interrupted
/// run, and the reports of the sessions.
fn check_continued(
    stops: &[u64],
    files: &[&str],
    train: impl Fn(&Path, &Session<'_>) -> TrainReport,
) -> ([tempfile::TempDir; 2], Vec<TrainReport>) {
    let [whole, parts] = [(); 2].map(|()| tempfile::tempdir().expect("a folder"));
    quietly(|session| train(whole.path(), session));
    let mut reports = Vec::new();
    for steps in stops {
        let steps = steps + steps_done(parts.path());
        let act = |session: &Session<'_>| train(parts.path(), session);
        reports.push(support::stopped_after(steps, &Device::flex(), act));
    }
    assert_eq!(logged_losses(parts.path()), logged_losses(whole.path()));
    check_same(whole.path(), parts.path(), files);
    ([whole, parts], reports)
}

/// Vectors of the two instructions, as from a frozen encoder.
fn two_vectors(values: &[f32]) -> EmbeddingTable {
    EmbeddingTable::of_vectors("frozen", &INSTRUCTIONS[..], values).expect("a row for each text")
}

#[test]
fn a_model_listens_to_a_frozen_encoder_of_another_width() {
    let dir = tempfile::tempdir().expect("a folder");
    let mut config = change_config(120);
    config.text.encoder = TextEncoder::Clip;
    config.run.optimizer.learning_rate = 3e-3;
    config.run.optimizer.decay = Decay::Constant;
    let vectors = two_vectors(&[8.0, 0.0, 1.0, 0.0, -8.0, 1.0]);
    let source = waves(20);
    let run = |vectors: Option<&EmbeddingTable>| {
        let corpus = Corpus {
            vectors,
            ..corpus(&source)
        };
        quietly(|session| train_motionrefit(dir.path(), &config, corpus, session))
    };
    assert!(matches!(run(None), Err(Error::Config { .. })));
    let report = run(Some(&vectors)).expect("trains");
    let (first, best) = (report.first_loss, report.best_val_loss);
    assert!(best.expect("validated") < 0.5 * first.expect("a line"));

    let load = || Editor::load(dir.path(), Slot::Best, &Device::flex()).expect("loads");
    let other = two_vectors(&[1.0; 8]);
    refused(load().set_vectors(other), "does not fit");
    let mut editor = load();
    editor.set_vectors(vectors).expect("its encoder");
    let record = &editor.record().config;
    let edit = |text: &str| {
        let item = whole_item("a", &walk(61, 1.0, 0.0), text, record)?;
        edited(&editor, &[item], &edit_settings(record)).map(|(made, _)| made)
    };
    let [raised, lowered] = HEIGHTS.map(|(text, _)| edit(text).expect("edits"));
    assert_ne!(raised, lowered);
    refused(edit("wave"), r#"lacks 1 texts, such as "wave""#);
}

/// Trains a network on one batch, with a rate that falls to zero, and checks that it learns the batch by heart.
fn check_overfits<M: Module>(mut model: M, steps: u32, rate: f64, loss: impl Fn(&M) -> Tensor<1>) {
    let mut optimizer = AdamWConfig::new().with_epsilon(1e-8).init();
    let mut losses = Vec::new();
    for step in 0..steps {
        let loss = loss(&model);
        losses.push(loss.clone().into_scalar::<f32>());
        let gradients = GradientsParams::from_grads(loss.backward(), &model);
        let rate = rate * (1.0 - f64::from(step) / f64::from(steps));
        model = optimizer.step(rate, model, gradients);
    }
    let (first, last) = (losses[0], losses[losses.len() - 1]);
    assert!(last < 0.01 * first, "{first} fell to {last}");
}

fn steps_done(run: &Path) -> u64 {
    std::fs::read(run.join("checkpoint/last/state.json")).map_or(0, |state| {
        let state: serde_json::Value = serde_json::from_slice(&state).expect("JSON");
        state["step"].as_u64().expect("a step")
    })
}

fn record(run: &Path) -> serde_json::Value {
    let text = std::fs::read(run.join("config.json")).expect("a record");
    serde_json::from_slice(&text).expect("JSON")
}

/// Checks that the checkpoints of two runs have equal files.
fn check_same(a: &Path, b: &Path, names: &[&str]) {
    for name in names {
        let [a, b] = [a, b].map(|run| std::fs::read(run.join("checkpoint").join(name)));
        assert!(a.expect("a file") == b.expect("a file"), "{name} differs");
    }
}

/// Joints and their rotation vectors in radians.
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

fn captioned(index: usize, motion: Motion, caption: &str) -> CaptionedClip {
    CaptionedClip {
        id: index.to_string(),
        motion,
        captions: vec![caption.to_owned()],
    }
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

/// Edits, and the times that they took.
fn edited(
    editor: &Editor,
    items: &[EditItem],
    settings: &EditSettings,
) -> Result<(Vec<Vec<KeypointFrame>>, EditTimes), Error> {
    let mut times = EditTimes::default();
    let made =
        quietly(|session| editor.edit_batch(items, &SKELETON, settings, session, &mut times));
    Ok((made?, times))
}

/// A motion with one instruction for all of its frames.
fn whole_item(
    id: &str,
    motion: &Motion,
    instruction: &str,
    record: &EditorRecord,
) -> Result<EditItem, Error> {
    let asked = [timed(0..motion.len(), instruction)];
    EditItem::timed(id, motion, &asked, motion.fps(), &SKELETON, record)
}

fn timed(frames: std::ops::Range<usize>, text: &str) -> TimedInstruction {
    TimedInstruction {
        frames,
        text: text.to_owned(),
    }
}
