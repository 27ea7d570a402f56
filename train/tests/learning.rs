//! The trainer learns, stops and continues runs, and edits are repeatable.

mod mdm;
mod mld;
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
    // The released network has neither gates nor `tell_frames`. All that a model has beyond it is named at once.
    for (run, why) in [
        (&dir, "it has gate,"),
        (&alone, "it has tell_frames,"),
        (&told, "it has tell_frames and gate,"),
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

#[test]
fn an_interrupted_run_ends_as_an_uninterrupted_one() {
    let files = [
        "last/denoiser.safetensors",
        "best/denoiser.safetensors",
        "last/text.safetensors",
        "best/text.safetensors",
        "last/state.json",
    ];
    // The first run stops between two lines of the metrics, right after a checkpoint, and after its end.
    for (config, stops, files) in [
        (small_config(25), &[7, 3, 100][..], &files[..]),
        (rich_config(25), &[13, 100], &files[..2]),
    ] {
        let ([whole, _], reports) = check_continued(stops, files, |run, session| {
            let report = train_motionrefit(run, &config, corpus(&waves(20)), session);
            report.expect("trains")
        });
        assert!(!reports[0].is_complete);
        if config.run.optimizer.ema_decay.is_some() {
            // The editor uses the averaged weights.
            let weights = |name: &str| std::fs::read(whole.path().join("checkpoint").join(name));
            let [last, best] = [files[0], files[1]].map(|name| weights(name).expect("weights"));
            assert!(last != best);
        }
    }
}

#[test]
fn a_run_killed_between_two_checkpoints_of_a_step_writes_both_again() {
    // The last step is validated for the first time, and ends an epoch that is kept.
    let mut config = small_config(3);
    config.run.keep_epochs = 1;
    let files = ["best", "epoch-1", "last"].map(|slot| format!("{slot}/denoiser.safetensors"));
    let files = files.each_ref().map(String::as_str);
    let source = waves(20);
    let whole = tempfile::tempdir().expect("a folder");
    train(whole.path(), &config, &source);
    for slot in ["best", "epoch-1", "last"] {
        let killed = tempfile::tempdir().expect("a folder");
        // A file where a checkpoint is written ends the run there.
        let checkpoints = killed.path().join("checkpoint");
        let obstacle = checkpoints.join(format!(".{slot}.new"));
        std::fs::create_dir(&checkpoints).expect("a folder");
        std::fs::write(&obstacle, "").expect("writes");
        refused(try_to_train(killed.path(), &config, &source), "cannot");
        std::fs::remove_file(&obstacle).expect("removed");
        train(killed.path(), &config, &source);
        assert_eq!(logged_losses(killed.path()), logged_losses(whole.path()));
        check_same(whole.path(), killed.path(), &files);
    }
}

/// A run that uses everything a checkpoint stores: micro-batches, clipped gradients, averaged weights, dropout.
fn rich_config(num_steps: u64) -> TrainConfig {
    let mut config = small_config(num_steps);
    config.model.dropout = 0.1;
    config.run.micro_batch_size = Some(3);
    config.run.optimizer.max_gradient_norm = Some(0.5);
    config.run.optimizer.ema_decay = Some(0.9);
    config.diffusion.previous = PreviousFrames::Encoded;
    config.diffusion.prediction = Prediction::Gated;
    config.diffusion.tell_frames = true;
    config
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let losses = [1, 2, 5].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        let dir = tempfile::tempdir().expect("a folder");
        let mut config = rich_config(10);
        // A step has three micro-batches, of 16, 16 and 8 windows.
        (config.run.batch_size, config.run.micro_batch_size) = (40, None);
        let act = || train(dir.path(), &config, &waves(20));
        pool.expect("a pool").install(act);
        logged_losses(dir.path())
    });
    assert_eq!(losses[0], losses[1]);
    assert_eq!(losses[0], losses[2]);
}

#[test]
fn a_batch_in_parts_and_on_several_devices_is_the_whole_batch() {
    let source = waves(20);
    let losses = |micro_batch_size: usize, more_devices: &[Device]| {
        let mut config = small_config(10);
        config.run.micro_batch_size = Some(micro_batch_size);
        let dir = tempfile::tempdir().expect("a folder");
        let trained = quietly(|session| {
            let session = Session {
                more_devices,
                ..*session
            };
            train_motionrefit(dir.path(), &config, corpus(&source), &session)
        });
        trained.expect("trains");
        logged_losses(dir.path())
    };
    let whole = losses(8, &[]);
    let parts = losses(3, &[]);
    let spread = losses(3, &[Device::flex(), Device::flex()]);
    // Each device computes the same micro-batches in the same order.
    assert_eq!(parts, spread);
    for ((step, whole), (_, parts)) in whole.iter().zip(&parts) {
        // The tolerance covers sums in another order, over ten steps of the optimiser.
        let is_near = (whole - parts).abs() < 1e-4 * whole;
        assert!(is_near, "{step}: {whole} {parts}");
    }
}

#[test]
fn epochs_are_counted_and_their_checkpoints_kept() {
    let dir = tempfile::tempdir().expect("a folder");
    let mut config = small_config(1);
    // 20 items in steps of 8 make an epoch of three steps.
    config.run.length = RunLength {
        epochs: Some(5),
        steps: 100,
    };
    config.run.keep_epochs = 2;
    let report = train(dir.path(), &config, &waves(20));
    assert_eq!(report.steps, 15);
    for (epoch, is_kept) in [(1, false), (2, true), (3, false), (4, true), (5, false)] {
        let loaded = Editor::load(dir.path(), Slot::Epoch(epoch), &Device::flex());
        assert_eq!(loaded.is_ok(), is_kept, "{epoch}");
    }
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

fn steps_done(run: &Path) -> u64 {
    std::fs::read(run.join("checkpoint/last/state.json")).map_or(0, |state| {
        let state: serde_json::Value = serde_json::from_slice(&state).expect("JSON");
        state["step"].as_u64().expect("a step")
    })
}

#[test]
fn a_run_with_damaged_weights_is_refused() {
    let dir = tempfile::tempdir().expect("a folder");
    let source = waves(8);
    train(dir.path(), &small_config(1), &source);
    let weights = dir.path().join("checkpoint/last/denoiser.safetensors");
    let mut bytes = std::fs::read(&weights).expect("weights");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&weights, bytes).expect("damaged");
    let damaged = try_to_train(dir.path(), &small_config(1), &source);
    refused(damaged, "is corrupt");
}

fn record(run: &Path) -> serde_json::Value {
    let text = std::fs::read(run.join("config.json")).expect("a record");
    serde_json::from_slice(&text).expect("JSON")
}

#[test]
fn a_run_is_extended_and_says_so() {
    let dir = tempfile::tempdir().expect("a folder");
    let run = dir.path();
    let source = waves(8);
    train(run, &small_config(4), &source);
    let mut longer = small_config(9);
    longer.run.optimizer.learning_rate *= 0.5;
    let unasked = try_to_train(run, &longer, &source);
    assert!(
        matches!(&unasked, Err(Error::OtherRun { field, .. }) if field.starts_with("config.train."))
    );
    refused(unasked, "--extend");
    let extend = Start {
        extend: true,
        ..Start::from(run)
    };
    let done = try_to_train(extend, &longer, &source).expect("extended");
    assert_eq!((done.steps, done.is_complete), (9, true));
    let lineage = record(run)["lineage"].clone();
    let ancestor = &lineage[0];
    assert_eq!(ancestor["by"], "extend");
    assert_eq!(ancestor["step"], 4);
    let steps = &ancestor["changed"]["config.train.length.steps"];
    assert_eq!(*steps, serde_json::json!([4, 9]));
    // Repeating the command does nothing, with and without `--extend`.
    for start in [extend, Start::from(run)] {
        let again = try_to_train(start, &longer, &source).expect("there");
        assert_eq!(again.steps, 9);
    }
    assert_eq!(record(run)["lineage"], lineage);
    // Neither another network nor a length that the run has already passed is accepted.
    let mut wider = longer.clone();
    wider.model.width *= 2;
    assert!(matches!(
        try_to_train(extend, &wider, &source),
        Err(Error::OtherRun { field, .. }) if field == "config.train.model.width"
    ));
    assert!(matches!(
        try_to_train(extend, &small_config(5), &source),
        Err(Error::Config { field, .. }) if field == "length"
    ));
    assert_eq!(record(run)["config"]["train"]["length"]["steps"], 9);
    let other = tempfile::tempdir().expect("a folder");
    let nothing = Start {
        run: other.path(),
        ..extend
    };
    let begun = try_to_train(nothing, &longer, &source);
    refused(begun, "is not a motionrefit run");
}

#[test]
fn a_run_begins_with_the_weights_of_another() {
    let [first, second, third, fourth] = [(); 4].map(|()| tempfile::tempdir().expect("a folder"));
    train(first.path(), &small_config(10), &waves(8));
    // A learning rate of zero does not change the weights.
    let mut still = small_config(1);
    still.run.optimizer.learning_rate = 0.0;
    let start = Start {
        init: Some(first.path()),
        ..Start::from(second.path())
    };
    let other = waves(12);
    try_to_train(start, &still, &other).expect("trains");
    check_same(first.path(), second.path(), &["best/denoiser.safetensors"]);
    let editor = Editor::load(first.path(), Slot::Best, &Device::flex()).expect("loads");
    let lineage = &record(second.path())["lineage"];
    assert_eq!(lineage[0]["by"], "init");
    assert_eq!(lineage[0]["weights"], editor.hash());
    // The run continues without the other run being given again.
    train(second.path(), &still, &other);
    train(third.path(), &small_config(2), &waves(8));
    let swapped = Start {
        init: Some(third.path()),
        ..start
    };
    let swapped = try_to_train(swapped, &still, &other);
    assert!(matches!(swapped, Err(Error::OtherRun { .. })));
    // A network of another shape cannot start from these weights.
    let mut wider = still.clone();
    wider.model.width *= 2;
    let misfit = Start {
        run: fourth.path(),
        ..start
    };
    let misfit = try_to_train(misfit, &wider, &other);
    assert!(matches!(misfit, Err(Error::Weights { .. })));
}

#[test]
fn a_loss_that_is_no_number_ends_the_run_and_is_never_best() {
    let dir = tempfile::tempdir().expect("a folder");
    let source = waves(8);
    let broken = Waves {
        is_broken: true,
        ..waves(8)
    };
    let corpus = Corpus {
        val: &broken,
        ..corpus(&source)
    };
    let config = small_config(4);
    let ended = quietly(|session| train_motionrefit(dir.path(), &config, corpus, session));
    assert!(matches!(
        ended,
        Err(Error::Diverged {
            step: 4,
            kept: 0,
            ..
        })
    ));
    refused(ended, "validation loss");
    assert!(!dir.path().join("checkpoint/best").exists());
    let other = tempfile::tempdir().expect("a folder");
    assert!(matches!(
        try_to_train(other.path(), &config, &broken),
        Err(Error::Diverged {
            what: "training",
            step: 0,
            ..
        })
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
    let mut config = small_config(10);
    // As published, an edit starts on the first frames of the original, and noise is white. Ten steps are too few to
    // learn the shape of the noise.
    config.diffusion.generated_starts = 0.0;
    config.diffusion.noise = NoiseKind::White;
    train(dir.path(), &config, &waves(20));
    let editor = Editor::load(dir.path(), Slot::Best, &Device::flex()).expect("loads");
    let record = &editor.record().config;
    let item = |id: &str, num_frames: usize, instruction: &str| {
        let motion = walk(num_frames, 1.0, 0.0);
        whole_item(id, &motion, instruction, record).expect("long enough")
    };
    let [raise, lower] = ["raise it", "lower it"];
    let items = [
        item("a", 61, raise),
        item("b", 31, lower),
        item("c", 93, raise),
    ];
    let settings = EditSettings {
        guidance: 2.0,
        ..edit_settings(record)
    };
    let edit = |items: &[EditItem], settings: &EditSettings| {
        edited(&editor, items, settings).expect("edits").0
    };
    let together = edit(&items, &settings);
    // 61 frames at 20 fps are 31 frames at 10 fps: windows start at 0 and 10, and one at 15 ends with the motion.
    let lengths: Vec<usize> = together.iter().map(Vec::len).collect();
    assert_eq!(lengths, [31, WINDOW_FRAMES, 47]);
    assert_eq!(edit(&items, &settings), together);

    let difference = |a: &[KeypointFrame], b: &[KeypointFrame]| {
        let pairs = a.as_flattened().iter().zip(b.as_flattened());
        pairs.map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
    };
    let alone = edit(&items[2..], &settings);
    // Matrix products of a smaller batch may be summed in another order. The f32 rounding, over 20 steps of five
    // windows, stays below a tenth of a millimetre.
    assert!(difference(&alone[0], &together[2]) < 1e-4);
    let other = EditSettings {
        seed: Seed(6),
        ..settings
    };
    assert!(difference(&edit(&items, &other)[0], &together[0]) > 1e-3);

    // The generated motion starts on the first two frames of the original.
    let source = SKELETON.motion_keypoints(&walk(61, 1.0, 0.0));
    assert!(difference(&together[0][..1], &source.points[..1]) < 1e-5);
    assert!(difference(&together[0][1..2], &source.points[2..3]) < 1e-5);
}

/// The record of an editor of the tiny preset that was never trained.
fn untrained_record() -> EditorRecord {
    EditorRecord {
        train: TrainConfig::preset(Preset::Tiny),
        normalizer: METRES,
        text: TextRecord::Learned(Vocabulary::build(["wave"], 1, 4).expect("valid")),
        compose: COMPOSE.clone(),
        extrapolation: None,
    }
}

/// Checks that the checkpoints of two runs have equal files.
fn check_same(a: &Path, b: &Path, names: &[&str]) {
    for name in names {
        let [a, b] = [a, b].map(|run| std::fs::read(run.join("checkpoint").join(name)));
        assert!(a.expect("a file") == b.expect("a file"), "{name} differs");
    }
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

#[test]
fn windows_hear_the_instruction_their_frames_belong_to() {
    let mut record = untrained_record();
    record.train.diffusion.overlap = 0;
    // 145 frames at 20 fps are 73 frames at 10 fps: windows start at 0, 14, 28, 42 and 56, and one at 57 adds the last
    // frame.
    let motion = walk(145, 1.0, 0.0);
    let cut = |record: &EditorRecord, asked: &[TimedInstruction]| {
        let item = EditItem::timed("walk", &motion, asked, Fps::STORE, &SKELETON, record);
        item.map(|item| item.windows)
    };
    let texts = |asked: &[TimedInstruction]| -> String {
        let windows = cut(&record, asked).expect("cut").into_iter();
        let texts = windows.map(|window| window.instruction);
        let texts = texts.map(|text| text.map_or("-".to_owned(), |text| text.to_string()));
        texts.collect::<Vec<_>>().join(" ")
    };
    // Starts of the windows, and numbers of their frames that are used.
    let places = |record: &EditorRecord, asked: TimedInstruction| -> (Vec<usize>, Vec<usize>) {
        let windows = cut(record, &[asked]).expect("cut").into_iter();
        windows.map(|window| (window.start, window.used)).unzip()
    };
    let both = [timed(0..60, "raise"), timed(60..88, "lower")];
    assert_eq!(texts(&both), "raise raise lower - - -");
    // A range shorter than a window gets a window that starts two frames earlier and is used up to the range's end.
    assert_eq!(texts(&[timed(40..60, "raise")]), "- - raise - - - -");
    let (starts, used) = places(&record, timed(40..60, "raise"));
    assert_eq!(starts, [0, 14, 18, 28, 42, 56, 57]);
    assert_eq!(used, [16, 6, 12, 16, 16, 16, 16]);
    let windows = cut(&record, &[timed(0..145, "raise")]).expect("cut");
    let expected = [0.0, 28.0, 56.0, 84.0, 112.0, 114.0].map(|frame| frame / 145.0);
    for (found, expected) in windows.iter().zip(expected) {
        assert!((found.progress - expected).abs() < 1e-6);
    }
    // Windows share four frames with the previous one, except those without an instruction.
    let mut overlapping = untrained_record();
    overlapping.train.diffusion.overlap = 4;
    let (starts, used) = places(&overlapping, timed(0..60, "raise"));
    assert_eq!(starts, [0, 10, 20, 28, 42, 56, 57]);
    assert_eq!(used, [16, 16, 10, 16, 16, 16, 16]);
    let hidden = [timed(0..60, "raise"), timed(0..50, "lower")];
    refused(cut(&record, &hidden), "no frame of its own");
    refused(cut(&record, &[timed(0..200, "raise")]), "145 frames");
    refused(cut(&record, &[timed(20..20, "raise")]), "does not fit");
}

#[test]
fn windows_without_an_instruction_stay_as_they_were() {
    let dir = tempfile::tempdir().expect("a folder");
    train(dir.path(), &small_config(10), &waves(20));
    let editor = Editor::load(dir.path(), Slot::Best, &Device::flex()).expect("loads");
    let record = &editor.record().config;
    let motion = walk(145, 1.0, 0.0);
    let asked = [timed(60..88, "raise it")];
    let item = EditItem::timed("a", &motion, &asked, Fps::STORE, &SKELETON, record).expect("cut");
    let (edited, times) = edited(&editor, &[item], &edit_settings(record)).expect("edits");
    assert_eq!(times.num_windows, 1);
    let original = SKELETON.motion_keypoints(&motion);
    let away: Vec<f64> = edited[0]
        .iter()
        .enumerate()
        .map(|(frame, points)| {
            let pairs = points.iter().zip(&original.points[2 * frame]);
            pairs.map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
        })
        .collect();
    // The third window is edited: it adds frames 30 to 43. Earlier frames differ only by f32 rounding.
    assert!(away[..30].iter().all(|&away| away < 1e-5), "{away:?}");
    assert!(away[30..44].iter().any(|&away| away > 0.05), "{away:?}");
    // Some frames after the edit, the body has its original shape again, wherever the edit ended.
    let arm = |points: &KeypointFrame| points[20].distance(points[21]);
    for (frame, points) in edited[0].iter().enumerate().skip(50) {
        let (found, was) = (arm(points), arm(&original.points[2 * frame]));
        assert!((found - was).abs() < 1e-5, "{frame}: {found} {was}");
    }
}

/// Natural windows, whose two halves swing together, and composed windows, whose halves come from two natural ones.
struct Swings {
    first: u64,
}

impl Swings {
    fn window(item: u64) -> Vec<f32> {
        let is_composed = item % 2 == 1;
        let phase = |part: u64| (item * 7 + part * 3) as f32 * 0.9;
        (0..WINDOW_NUMBERS)
            .map(|index| {
                let (frame, channel) = (index / FRAME_WIDTH, index % FRAME_WIDTH);
                let part = u64::from(is_composed && channel >= FRAME_WIDTH / 2);
                0.5 * (0.5 * frame as f32 + phase(part)).sin()
            })
            .collect()
    }
}

impl WindowSource<CoordinatorBatch> for Swings {
    fn epoch_len(&self) -> u64 {
        512
    }

    fn window_len(&self) -> usize {
        WINDOW_NUMBERS
    }

    fn fill(
        &self,
        _epoch: u64,
        first: u64,
        num_items: usize,
        batch: &mut CoordinatorBatch,
    ) -> Result<(), train::Error> {
        let first = self.first + first;
        let items = first..first + num_items as u64;
        batch.windows = items.clone().flat_map(Self::window).collect();
        batch.composed = items.map(|item| (item % 2) as f32).collect();
        Ok(())
    }
}

#[test]
fn the_coordinator_learns_what_was_composed() {
    let dir = tempfile::tempdir().expect("a folder");
    let mut config = CoordinatorConfig::preset(Preset::Tiny);
    config.model = small_config(1).model;
    config.run.optimizer.learning_rate = 3e-3;
    config.run.batch_size = 32;
    config.run.micro_batch_size = Some(20);
    config.run.length = RunLength::of_steps(150);
    (config.run.val_every, config.val_windows) = (50, 64);
    let report = quietly(|session| {
        let segments = Segments {
            train: &Swings { first: 0 },
            val: &Swings { first: 2_000 },
            normalizer: METRES,
            skeleton: &SKELETON,
            dataset_hash: "0",
            compose: &COMPOSE,
        };
        train_coordinator(dir.path(), &config, segments, session)
    })
    .expect("trains");
    // An untrained coordinator is at chance: the loss is ln 2.
    assert!((report.first_loss.expect("a line") - 0.69).abs() < 0.2);
    assert!(report.best_val_loss.expect("validated") < 0.2);
    let judge = TrainedCoordinator::load(dir.path(), Slot::Best, &Device::flex()).expect("loads");
    let windows: Vec<f32> = (1000..1064).flat_map(Swings::window).collect();
    let wrong = judge
        .probabilities(&windows)
        .iter()
        .enumerate()
        .filter(|&(item, &p)| (p > 0.5) != (item % 2 == 1))
        .count();
    assert!(wrong < 8, "{wrong} of 64");

    // The coordinator does not guide an editor with another normaliser.
    let editor_dir = tempfile::tempdir().expect("a folder");
    train(editor_dir.path(), &small_config(10), &waves(20));
    let editor = Editor::load(editor_dir.path(), Slot::Best, &Device::flex()).expect("loads");
    refused(editor.with_coordinator(judge), "does not fit");
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

#[test]
fn the_encoder_learns_to_tell_motions_apart() {
    let kinds: [(&str, &[(usize, DVec3)]); 3] = [
        ("walk", &[]),
        ("raise both arms", &ARMS_UP),
        ("sit down", &SITTING),
    ];
    // Held-out walks have other lengths, speeds and phases.
    let motions = |offset: f64| -> Vec<CaptionedClip> {
        (0..18)
            .map(|index| {
                let (text, turns) = kinds[index % kinds.len()];
                let place = index as f64 + offset;
                let mut motion = walk(50 + (2.0 * place) as usize, 0.1 * place, place);
                for frame in 0..motion.len() {
                    for (joint, turn) in turns {
                        motion.set_axis_angle(frame, *joint, turn.as_vec3().to_array());
                    }
                }
                captioned(index, motion, text)
            })
            .collect()
    };
    let [train, held_out] = [motions(0.0), motions(0.5)];
    for recipe in [FeatureRecipe::Smpl135, FeatureRecipe::HumanMl3d] {
        check_encoder(&train, &held_out, &kinds.map(|(text, _)| text), recipe);
    }
}

fn captioned(index: usize, motion: Motion, caption: &str) -> CaptionedClip {
    CaptionedClip {
        id: index.to_string(),
        motion,
        captions: vec![caption.to_owned()],
    }
}

/// Trains an encoder on 18 motions with three texts in turn, and checks that it retrieves the texts of 18 other
/// motions.
fn check_encoder(
    train: &[CaptionedClip],
    held_out: &[CaptionedClip],
    kinds: &[&str; 3],
    recipe: FeatureRecipe,
) {
    let dir = tempfile::tempdir().expect("a folder");
    let mut config = TmrConfig::preset(Preset::Tiny);
    config.features = recipe;
    config.max_frames = 24;
    config.run.batch_size = 18;
    config.run.length = RunLength::of_steps(150);
    config.run.val_every = 150;
    let corpus = CaptionedCorpus {
        train,
        val: held_out,
        vectors: None,
        skeleton: &SKELETON,
        dataset_hash: "0",
    };
    let report = quietly(|session| train_tmr(dir.path(), &config, corpus, session));
    let report = report.expect("trains");
    let [first, last] = [report.first_loss, report.last_loss].map(|loss| loss.expect("a line"));
    assert!(last < 0.7 * first, "{recipe:?}: {first} fell to {last}");

    let encoder = TmrEncoder::load(dir.path(), Slot::Last, &Device::flex()).expect("loads");
    let refs: Vec<&Motion> = held_out.iter().map(|clip| &clip.motion).collect();
    let codes = encoder.encode(&refs).expect("encodes");
    let texts = encoder.encode_texts(kinds).expect("trained here");
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
    // Guessing retrieves 6 of 18.
    assert!(right >= 15, "{recipe:?}: {right} of 18");
    // Padding to a longer motion of the batch must not matter, up to f32 rounding.
    let alone = encoder.encode(&refs[..1]).expect("encodes");
    for (a, b) in alone[0].iter().zip(&codes[0]) {
        assert!((a - b).abs() < 1e-4, "{a} {b}");
    }
    assert_eq!(encoder.hash().len(), 64);
}
