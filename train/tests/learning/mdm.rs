//! MDM learns, continues, and edits body parts.

use burn::tensor::TensorData;
use datasets_spec::JointSet;
use features::humanml3d::{Features, GROUPS, features_of_joints, joints_of_motion};
use features::{Statistics, smpl_body};
use kinematics::skeleton::NUM_BODY_JOINTS;
use train::mdm::{MdmConfig, masked_l2, train_mdm};
use train::model::conditioned::Conditioned;
use train::model::mdm::Mdm;
use train::schedule::Schedule;
use train::system::{EditConfig, EditRequest, whole};

use super::*;
use crate::shared::opened;

/// Walks with several speeds; every second one has raised arms.
fn clips(count: usize) -> Vec<CaptionedClip> {
    (0..count)
        .map(|index| {
            let mut motion = walk(41, 0.3 + 0.2 * index as f64, index as f64);
            let is_raised = index % 2 == 1;
            if is_raised {
                for frame in 0..motion.len() {
                    for (joint, turn) in ARMS_UP {
                        motion.set_axis_angle(frame, joint, turn.as_vec3().to_array());
                    }
                }
            }
            let caption = if is_raised {
                "walk with raised arms"
            } else {
                "walk"
            };
            captioned(index, motion, caption)
        })
        .collect()
}

fn config(num_steps: u64) -> MdmConfig {
    let mut config = MdmConfig::preset(Preset::Tiny);
    config.model = network_of(64, 1);
    config.diffusion_steps = 10;
    config.max_frames = 40;
    config.run.batch_size = 4;
    config.run.length = RunLength::of_steps(num_steps);
    config.run.log_every = 2;
    config.run.val_every = 4;
    config
}

/// Trains and validates on the same clips.
pub(super) fn trained_by(
    train: impl FnOnce(CaptionedCorpus<'_>) -> Result<TrainReport, Error>,
) -> TrainReport {
    let clips = clips(6);
    let corpus = CaptionedCorpus {
        train: &clips,
        val: &clips,
        vectors: None,
        skeleton: &SKELETON,
        dataset_hash: "0",
    };
    train(corpus).expect("trains")
}

fn trained(run: &Path, config: &MdmConfig, session: &Session<'_>) -> TrainReport {
    trained_by(|corpus| train_mdm(run, config, corpus, session))
}

/// The numbers of all frames of the clips, as a network receives them.
pub(super) fn normalised() -> Vec<f32> {
    let body = smpl_body(&SKELETON);
    let features = |clip: &CaptionedClip| -> Vec<Features> {
        features_of_joints(&joints_of_motion(&clip.motion, &body)).expect("long enough")
    };
    let all: Vec<Vec<Features>> = clips(6).iter().map(features).collect();
    let mut statistics = Statistics::default();
    for clip in &all {
        statistics.take(clip);
    }
    let (mean, std) = (statistics.mean(), statistics.std_by(&GROUPS));
    let frames = all.iter().flatten();
    frames
        .flat_map(|frame| {
            (0..frame.len()).map(|column| (frame[column] - mean[column]) / std[column].max(1e-3))
        })
        .collect()
}

#[test]
fn the_first_loss_of_mdm_is_that_of_an_untrained_network() {
    let dir = tempfile::tempdir().expect("a folder");
    let mut config = config(1);
    config.run.optimizer.learning_rate = 0.0;
    let report = quietly(|session| trained(dir.path(), &config, session));

    let numbers = normalised();
    let squares = numbers.iter().map(|value| f64::from(value * value));
    // The output layer maps tokens of unit variance by weights of variance 1/3 over the width, and the prediction is
    // independent of the motion. All clips have the same length.
    let expected = squares.sum::<f64>() / numbers.len() as f64 + 1.0 / 3.0;
    let found = report.best_val_loss.expect("validated");
    assert!((found / expected - 1.0).abs() < 0.1, "{found} {expected}");
}

#[test]
fn one_batch_of_mdm_is_overfitted() {
    const FRAMES: usize = 8;
    let device = Device::flex().autodiff();
    let mut rng = Seed(3).rng(&["overfit"]);
    let network = NetworkConfig {
        width: 128,
        ..config(1).model
    };
    let vocabulary = Vocabulary::build(["walk jump"], 1, 4).expect("valid");
    let text = TextSource::Learned(vocabulary.num_tokens());
    let untrained = Conditioned::new(text, network.width, &device, |text_width| {
        Mdm::new(&network, 12, text_width, &device)
    });
    let model = draw(untrained, Seed(2)).expect("known layers");
    let texts = TextBatch::Words(vocabulary.encode_batch(["walk", "jump"]));
    let schedule = Schedule::cosine(10).expect("steps");
    let (timesteps, lengths) = ([3, 8], [FRAMES, FRAMES - 3]);
    let mut normal = || {
        let values: Vec<f32> = (0..2 * FRAMES * 12)
            .map(|_| rng.sample(StandardNormal))
            .collect();
        Tensor::<3>::from_data(TensorData::new(values, [2, FRAMES, 12]), &device)
    };
    let (x0, noise) = (normal(), normal());
    let x_t = schedule.q_sample(x0.clone(), &timesteps, noise);
    let pass = Pass::default();
    check_overfits(model, 300, 3e-3, |model| {
        let text = model.text_vectors(&texts, 2, &device);
        let x = model
            .network
            .forward(x_t.clone(), &timesteps, text, Some(&lengths), &pass);
        masked_l2(x, x0.clone(), &lengths).mean()
    });
}

#[test]
fn an_interrupted_run_of_mdm_ends_as_an_uninterrupted_one() {
    let mut config = config(9);
    config.model.dropout = 0.1;
    let files = ["last/mdm.safetensors", "last/text.safetensors"];
    let (_, reports) = check_continued(&[5, 100], &files, |run, session| {
        trained(run, &config, session)
    });
    assert!(!reports[0].is_complete && reports[0].steps == 5);
    assert!(reports[1].is_complete);
}

#[test]
fn mdm_bp_changes_only_the_joints_it_is_told_to() {
    let dir = tempfile::tempdir().expect("a folder");
    quietly(|session| trained(dir.path(), &config(4), session));
    let edited = |release: usize, joints: JointSet, fps: Fps, ids: &[&str]| -> Vec<Motion> {
        let config = EditConfig {
            release: Some(release),
            ..EditConfig::default()
        };
        let system = opened(dir.path(), &config);
        // Settings other than the usual ones are part of the name.
        let name = &system.identity().name;
        let named = format!("MDM-BP (release {release})");
        assert!(*name == "MDM-BP" || *name == named, "{name}");
        let motions: Vec<Motion> = ids.iter().map(|id| walk(23 + id.len(), 1.0, 0.3)).collect();
        let whole = motions.iter().map(|motion| [whole("raise", motion)]);
        let instructions: Vec<_> = whole.collect();
        let requests = (0..ids.len()).map(|index| EditRequest {
            id: ids[index],
            motion: &motions[index],
            instructions: &instructions[index],
            fps,
            joints,
            frames: None,
        });
        let requests: Vec<EditRequest<'_>> = requests.collect();
        let made = quietly(|session| system.edit(&requests, Seed(1), session));
        let (made, _) = made.expect("edits");
        made.into_iter().map(|(motion, _)| motion).collect()
    };
    let moved = |motion: &Motion, joint: usize| -> f64 {
        let source = joints_of_motion(&walk(motion.len(), 1.0, 0.3), &SKELETON);
        let found = joints_of_motion(motion, &SKELETON);
        let pairs = source.iter().zip(&found);
        let away = pairs.map(|(a, b)| a[joint].distance(b[joint]));
        away.fold(0.0, f64::max)
    };
    let arm = JointSet::of(&[16, 18, 20]);
    let together = edited(0, arm, Fps::STORE, &["a", "bb"]);
    assert_eq!([together[0].len(), together[1].len()], [24, 25]);
    for joint in (0..NUM_BODY_JOINTS).filter(|&joint| !arm.contains(joint)) {
        // Features have single precision, and rounding errors of velocities add up.
        assert!(moved(&together[0], joint) < 1e-3, "joint {joint}");
    }
    assert!(moved(&together[0], 20) > 0.05);
    let alone = edited(0, arm, Fps::STORE, &["a"]);
    for joint in 0..NUM_BODY_JOINTS {
        let both = [&alone[0], &together[0]].map(|motion| joints_of_motion(motion, &SKELETON));
        assert!(both[0][20][joint].distance(both[1][20][joint]) < 1e-4);
    }
    // If no body part is kept in the last steps, the legs move too. Other frame rates are kept.
    let free = edited(3, arm, Fps::STORE, &["a"]);
    assert!(moved(&free[0], 7) > 0.01);
    let faster = edited(0, JointSet::EMPTY, Fps::new(30.0).expect("a rate"), &["a"]);
    assert_eq!((faster[0].len(), faster[0].fps().get()), (35, 30.0));
}
