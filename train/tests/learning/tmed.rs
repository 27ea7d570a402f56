//! TMED learns, continues exactly after an interruption, and edits.

use datasets_spec::JointSet;
use train::model::tmed::TmedModel;
use train::system::{EditConfig, EditRequest, EditSystem, whole};
use train::tmed::features::NUM_FEATURES;
use train::tmed::{
    ClipBatch, ClipData, ClipEdit, ClipSource, TmedConfig, TmedCorpus, loss, train_tmed,
};

use super::*;
use crate::shared::opened;

const INSTRUCTIONS: [&str; 2] = ["raise the arm", "lower the arm"];

/// Walks with a raised or lowered arm; the edited walk is two frames longer.
struct Arms;

fn arm(frames: usize, speed: f64, angle: f64) -> Motion {
    let poses: Vec<Pose> = (0..frames)
        .map(|frame| {
            let t = frame as f64 / 10.0;
            let mut pose = Pose {
                transl: DVec3::new(0.0, 0.9, speed * t),
                ..Pose::REST
            };
            pose.rotations[0] = DQuat::from_rotation_y(0.3 * t);
            pose.rotations[16] = DQuat::from_rotation_z(angle + 0.2 * (4.0 * t).sin());
            pose
        })
        .collect();
    Motion::from_poses(Fps::MODEL, &poses).expect("finite")
}

impl ClipSource for Arms {
    fn num_clips(&self) -> u64 {
        10
    }

    fn clip(&self, _epoch: u64, number: u64) -> Result<ClipEdit, train::Error> {
        let (frames, speed) = (12 + number as usize % 3, 0.5 + 0.1 * number as f64);
        let edited = number as usize % 2;
        Ok(ClipEdit {
            instruction: INSTRUCTIONS[edited].to_owned(),
            source: arm(frames, speed, 0.0),
            target: arm(frames + 2, speed, [1.0, -1.0][edited]),
            first_edited: 0,
        })
    }
}

fn config(num_steps: u64) -> TmedConfig {
    let mut config = TmedConfig::preset(Preset::Tiny);
    config.model = network_of(32, 1);
    config.model.dropout = 0.1;
    config.data = ClipData::Pairs;
    config.diffusion.num_steps = 10;
    config.val_clips = 10;
    config.run.batch_size = 8;
    config.run.micro_batch_size = Some(3);
    config.run.length = RunLength::of_steps(num_steps);
    config.run.log_every = 5;
    config.run.val_every = 10;
    config.run.optimizer.warmup_steps = 5;
    config.run.optimizer.ema_decay = Some(0.9);
    config
}

fn train(run: &Path, config: &TmedConfig, session: &Session<'_>) -> TrainReport {
    let corpus = TmedCorpus {
        train: &Arms,
        val: &Arms,
        instructions: &INSTRUCTIONS.map(str::to_owned),
        vectors: None,
        skeleton: &Skeleton::smplx_neutral(),
        dataset_hash: "0",
        compose: None,
    };
    train_tmed(run, config, corpus, session).expect("trains")
}

/// A batch of random clips with different lengths.
fn batch(vocabulary: &Vocabulary, target: impl FnMut(usize) -> f32) -> ClipBatch {
    const ROWS: usize = 8;
    const FRAMES: usize = 9;
    let mut rng = Seed(1).rng(&["batch"]);
    let count = ROWS * FRAMES * NUM_FEATURES;
    let mut normal = || -> Vec<f32> { (0..count).map(|_| rng.sample(StandardNormal)).collect() };
    ClipBatch {
        source: normal(),
        source_frames: (0..ROWS).map(|row| FRAMES - row % 3).collect(),
        source_is_shown: (0..ROWS).map(|row| row != 3).collect(),
        target: (0..count).map(target).collect(),
        target_frames: (0..ROWS).map(|row| FRAMES - row % 2).collect(),
        noise: normal(),
        timesteps: (0..ROWS).map(|row| 40 * row).collect(),
        texts: TextBatch::Words(
            vocabulary.encode_batch((0..ROWS).map(|row| INSTRUCTIONS[row % 2])),
        ),
    }
}

fn vocabulary() -> Vocabulary {
    Vocabulary::build(INSTRUCTIONS, 1, 8).expect("valid")
}

fn network(width: usize, num_tokens: usize) -> TmedModel {
    let mut network = network_of(width, 1);
    network.feed_forward = 2 * width;
    let text = TextSource::Learned(num_tokens);
    let device = Device::flex().autodiff();
    let model = TmedModel::new(&network, text, NUM_FEATURES, &device);
    draw(model, Seed(2)).expect("known layers")
}

fn loss_of(model: &TmedModel, batch: &ClipBatch) -> Tensor<1> {
    let schedule = Schedule::cosine(300).expect("steps");
    let config = TmedConfig::preset(Preset::Paper);
    let device = Device::flex().autodiff();
    loss(model, batch, &config, &schedule, &device, &Pass::default())
}

#[test]
fn the_first_loss_of_tmed_is_that_of_an_untrained_network() {
    let vocabulary = vocabulary();
    let mut rng = Seed(4).rng(&["target"]);
    // Normalised features have a standard deviation of one half.
    let batch = batch(&vocabulary, |_| 0.5 * rng.sample::<f32, _>(StandardNormal));
    let model = network(128, vocabulary.num_tokens());
    let first: f32 = loss_of(&model, &batch).into_scalar();
    // The output layer maps tokens of unit variance by weights of variance 1/3 over the width. The tolerance is wide
    // because a group of three features weighs as much as one of 126, and tokens are similar.
    let expected = 0.25 + 1.0 / 3.0;
    assert!((first / expected - 1.0).abs() < 0.25, "{first} {expected}");
}

#[test]
fn one_batch_is_overfitted_by_tmed() {
    let vocabulary = vocabulary();
    let batch = batch(&vocabulary, |index| {
        let (frame, feature) = (index / NUM_FEATURES, index % NUM_FEATURES);
        0.5 * (0.9 * frame as f32 + feature as f32).sin()
    });
    let model = network(64, vocabulary.num_tokens());
    check_overfits(model, 400, 3e-3, |model| loss_of(model, &batch));
}

#[test]
fn tmed_is_continued_exactly() {
    let config = config(14);
    let files = [
        "last/denoiser.safetensors",
        "last/words.safetensors",
        "last/ema-denoiser.safetensors",
        "best/denoiser.safetensors",
    ];
    check_continued(&[7, 100], &files, |run, session| {
        train(run, &config, session)
    });
}

fn edited(system: &dyn EditSystem, asked: &[(&Motion, &str, Option<usize>)]) -> Vec<Motion> {
    let instructions = asked.iter().map(|(motion, text, _)| [whole(text, motion)]);
    let instructions: Vec<_> = instructions.collect();
    let pairs = asked.iter().zip(&instructions);
    let requests = pairs.map(|(&(motion, text, frames), instructions)| EditRequest {
        id: text,
        motion,
        instructions,
        fps: motion.fps(),
        joints: JointSet::EMPTY,
        frames,
    });
    let requests: Vec<EditRequest<'_>> = requests.collect();
    let made = quietly(|session| system.edit(&requests, Seed(5), session)).expect("edits");
    made.0.into_iter().map(|(motion, _)| motion).collect()
}

#[test]
fn tmed_learns_and_its_edits_have_the_length_asked_for() {
    let dir = tempfile::tempdir().expect("a folder");
    let mut config = config(300);
    config.model.dropout = 0.0;
    config.model.width = 64;
    config.run.val_every = 100;
    config.run.micro_batch_size = None;
    config.run.optimizer.learning_rate = 3e-3;
    quietly(|session| train(dir.path(), &config, session));
    let losses = logged_losses(dir.path());
    let (first, last) = (losses[0].1, losses[losses.len() - 1].1);
    assert!(last < 0.5 * first, "{first} fell to {last}");

    let open = |change: fn(&mut EditConfig)| {
        let mut config = EditConfig::default();
        change(&mut config);
        opened(dir.path(), &config)
    };
    let system = open(|_| {});
    let (short, long) = (arm(12, 0.6, 0.0), arm(14, 0.7, 0.0));
    let alike = arm(12, 0.9, 0.0);
    let [raise, lower] = INSTRUCTIONS;
    let all = [
        (&short, raise, Some(14)),
        (&long, lower, None),
        (&short, "lower it", None),
        // This item shares a batch with the first.
        (&alike, "lower an arm", Some(14)),
    ];
    let motions = edited(&*system, &all);
    let lengths: Vec<usize> = motions.iter().map(Motion::len).collect();
    assert_eq!(lengths, [14, 14, 12, 14]);
    for (made, (source, ..)) in motions.iter().zip(&all) {
        let apart = (made.pose(0).transl - source.pose(0).transl).length();
        assert!(apart < 1e-5, "an edit begins where its source stands");
    }
    // Each result depends only on its own request and the seed.
    for (one, motion) in all.iter().zip(&motions) {
        assert_eq!(edited(&*system, std::slice::from_ref(one))[0], *motion);
    }
    let angle = |motion: &Motion| motion.pose(6).rotations[16].z;
    let (raised, lowered) = (angle(&motions[0]), angle(&motions[1]));
    assert!(raised > lowered + 0.2, "{raised} {lowered}");

    let other = |change: fn(&mut EditConfig)| edited(&*open(change), &all[..1]).remove(0);
    let settings = |system: &dyn EditSystem| system.identity().settings_hash();
    let plain = settings(&*system);
    for change in [
        (|config| config.steps = Some(4)) as fn(&mut EditConfig),
        |config| config.guidance = Some(1.0),
        |config| config.source_guidance = Some(1.0),
        |config| config.from_source = true,
        |config| config.temperature = Some(0.5),
    ] {
        assert_ne!(other(change), motions[0]);
        assert_ne!(settings(&*open(change)), plain);
    }
}
