//! If the network is replaced by the true clean window, the editor reproduces the target. So seams in real edits are
//! due to the network, not to the editor.

use burn::tensor::{Device, Tensor, TensorData};
use compose::ComposeConfig;
use datasets_spec::{Fps, Motion, Pose, Seed, Skeleton};
use glam::{DQuat, DVec3};
use kinematics::canonical::{Anchor, FIXED_FRAMES, canonicalise};
use kinematics::normalise::{FRAME_WIDTH, Normalizer};
use kinematics::rotation::from_axis_angle;
use rand::RngExt;
use rand_distr::StandardNormal;
use train::Error;
use train::compose::ComposeRecord;
use train::config::{Preset, TrainConfig};
use train::edit::Fit;
use train::fit::{EditorRecord, TextRecord};
use train::sample::{
    EditItem, EditSettings, EditWindow, FitMethod, TimedInstruction, WindowRequest, edit_windows,
    reverse,
};
use train::schedule::Schedule;
use train::vocabulary::Vocabulary;

use crate::shared::{edit_settings, quietly};

/// A body that walks along a curve, with its arms and one leg swinging. It is slow enough that splines through frames
/// at 20/3 fps stay within 1 mm of the points' paths, and fast enough that the root moves 6 cm per frame.
#[derive(Clone, Copy)]
struct Walk {
    /// Speed of the root in m/s and in rad/s.
    speed: f64,
    turn: f64,
    /// Minimum and maximum angle of arms and leg in radians.
    arms: [f64; 2],
    leg: [f64; 2],
}

impl Walk {
    fn pose(&self, secs: f64) -> Pose {
        let heading = 0.7 + self.turn * secs;
        let mut pose = Pose {
            transl: DVec3::new(1.0, 0.9, -2.0)
                + self.speed
                    * secs
                    * (DQuat::from_rotation_y(0.7 + 0.5 * self.turn * secs) * DVec3::Z),
            ..Pose::REST
        };
        pose.rotations[0] = DQuat::from_rotation_y(heading) * from_axis_angle(DVec3::X * 0.1);
        let swing = |[low, high]: [f64; 2]| low + (high - low) * (0.5 - 0.5 * (1.0 * secs).cos());
        pose.rotations[16] = from_axis_angle(DVec3::Z * swing(self.arms));
        pose.rotations[18] = from_axis_angle(DVec3::Y * -swing(self.arms));
        pose.rotations[1] = from_axis_angle(DVec3::X * swing(self.leg));
        pose.rotations[4] = from_axis_angle(DVec3::X * (0.3 - 0.5 * swing(self.leg)));
        pose
    }

    fn motion(&self, num_frames: usize) -> Motion {
        let frames = 0..num_frames;
        let poses: Vec<Pose> = frames
            .map(|frame| self.pose(Fps::STORE.secs_at(frame)))
            .collect();
        Motion::from_poses(Fps::STORE, &poses).expect("finite")
    }
}

const SOURCE: Walk = Walk {
    speed: 1.2,
    turn: 0.1,
    arms: [0.1, 0.5],
    leg: [0.0, -0.3],
};

/// The source's path with another movement of the arms.
const ARMS: Walk = Walk {
    arms: [0.6, -0.2],
    ..SOURCE
};

/// Another movement of the legs, and another path from the same start.
const LEGS: Walk = Walk {
    speed: -0.6,
    turn: -0.2,
    leg: [-0.3, 0.1],
    ..SOURCE
};

fn record(window: usize, fps: Fps, anchor: Anchor, generated_starts: f64) -> EditorRecord {
    let mut train = TrainConfig::preset(Preset::Tiny);
    train.window = window;
    train.diffusion.generated_starts = generated_starts;
    EditorRecord {
        train,
        normalizer: Normalizer {
            min: [-2.0, -0.5, -2.0],
            max: [2.0, 2.0, 3.0],
        },
        text: TextRecord::Learned(Vocabulary::build(["go"], 1, 4).expect("valid")),
        compose: ComposeRecord {
            config: ComposeConfig {
                window,
                fps,
                anchor,
                ..ComposeConfig::default()
            },
            seed: Seed(0),
        },
        extrapolation: None,
    }
}

/// A model that returns the target's windows.
struct Oracle<'a> {
    record: &'a EditorRecord,
    target: Walk,
    /// Time of the target's last frame.
    end_secs: f64,
    /// Whether the frames before a window belong to the target too, and must be reproduced exactly.
    is_continued: bool,
    skeleton: &'a Skeleton,
}

impl Oracle<'_> {
    /// The clean window, in the coordinates used in training.
    fn clean(&self, window: &EditWindow) -> Vec<f32> {
        let compose = &self.record.compose.config;
        let mut poses: Vec<Pose> = (window.start..window.start + compose.window)
            .map(|frame| {
                let secs = compose.fps.secs_at(frame);
                // Beyond one frame after the end, the last pose is repeated; these frames are cut off again.
                let past = secs - self.end_secs;
                let step = compose.fps.secs_at(1);
                self.target
                    .pose(if past < step { secs } else { self.end_secs })
            })
            .collect();
        canonicalise(&mut poses, compose.anchor, self.skeleton);
        let normalizer = &self.record.normalizer;
        let frames = poses.iter().map(|pose| self.skeleton.keypoints(pose));
        frames
            .flat_map(|frame| normalizer.normalize(&frame))
            .collect()
    }

    fn generate(&self, requests: &mut [WindowRequest<'_>]) -> Result<Vec<f32>, Error> {
        let device = Device::flex();
        let diffusion = &self.record.train.diffusion;
        let schedule = Schedule::new(diffusion.schedule, diffusion.num_steps)?;
        let frames = self.record.compose.config.window;
        let mut made = Vec::new();
        for request in requests {
            let clean = self.clean(request.window);
            let fixed = request
                .fixed
                .map(|fixed| fixed.into_iter().flatten().collect::<Vec<f32>>());
            if let Some(fixed) = &fixed
                && request.window.start > 0
                && self.is_continued
            {
                let far = fixed.iter().zip(&clean).map(|(a, b)| (a - b).abs());
                let far = far.fold(0.0, f32::max);
                // A model unit is up to 2.5 m, so this is a fraction of a millimetre.
                assert!(far < 2e-4, "window {}: {far}", request.window.start);
            }
            let window = |values: Vec<f32>| -> Tensor<3> {
                let count = values.len() / FRAME_WIDTH;
                Tensor::from_data(TensorData::new(values, [1, count, FRAME_WIDTH]), &device)
            };
            let clean = window(clean);
            let fixed = fixed.map(window);
            let mut normal = || request.rng.sample(StandardNormal);
            let x = reverse(
                &schedule,
                fixed.as_ref(),
                None,
                |_, _| clean.clone(),
                |mean, _| mean,
                |_| window((0..frames * FRAME_WIDTH).map(|_| normal()).collect()),
                |_, _| {},
            );
            let numbers: Vec<f32> = x.into_data().try_into_vec_as().expect("floats");
            made.extend(numbers);
        }
        Ok(made)
    }
}

/// Edits the source with the true windows of a target.
fn edited(
    record: &EditorRecord,
    target: Walk,
    num_frames: usize,
    asked: &[TimedInstruction],
    is_continued: bool,
) -> Motion {
    let skeleton = Skeleton::smplx_neutral();
    let source = SOURCE.motion(num_frames);
    let item = EditItem::timed("walk", &source, asked, Fps::STORE, &skeleton, record);
    let items = [item.expect("cut")];
    let settings = EditSettings {
        seed: Seed(1),
        max_batch: 8,
        ..edit_settings(record)
    };
    let oracle = Oracle {
        record,
        target,
        end_secs: Fps::STORE.secs_at(num_frames - 1),
        is_continued,
        skeleton: &skeleton,
    };
    let edited = quietly(|session| {
        let generate = &mut |requests: &mut [WindowRequest<'_>]| oracle.generate(requests);
        edit_windows(generate, record, &items, &skeleton, &settings, session)
    });
    let fit = Fit {
        method: FitMethod::Exact,
        prior: 0.0,
        poses: None,
        keypoints: 28,
    };
    let frames = &edited.expect("edits")[0];
    let (motion, _) = fit
        .motion(&items[0], frames, record.compose.config.fps, &skeleton)
        .expect("finite");
    assert_eq!(motion.len(), num_frames, "as long as its source");
    motion
}

/// The largest distance in metres between corresponding keypoints of two motions, for each frame.
fn misses(found: &Motion, wanted: Walk) -> Vec<f64> {
    let skeleton = Skeleton::smplx_neutral();
    let [wanted, found] =
        [&wanted.motion(found.len()), found].map(|motion| skeleton.motion_keypoints(motion).points);
    let frames = wanted.iter().zip(&found).map(|(wanted, found)| {
        let pairs = wanted.iter().zip(found);
        pairs.map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
    });
    frames.collect()
}

fn whole(num_frames: usize) -> Vec<TimedInstruction> {
    vec![TimedInstruction {
        frames: 0..num_frames,
        text: "go".to_owned(),
    }]
}

#[test]
fn the_true_windows_give_the_target_back_at_every_frame() {
    for (name, target) in [("root copied", ARMS), ("root generated", LEGS)] {
        for anchor in [Anchor::Pelvis, Anchor::Translation] {
            for stride in [1.0, 2.0, 3.0] {
                let fps = Fps::new(Fps::STORE.get() / stride).expect("valid");
                for (window, overlap) in [(8, 0), (8, 4), (16, 0), (16, 4), (21, 7)] {
                    // Lengths with whole windows, with a last window that adds one frame or most of a window, shorter
                    // than a window, and of a single frame.
                    for num_frames in [31, 59, 60, 61, 118, 12, 1] {
                        let mut record = record(window, fps, anchor, 0.25);
                        record.train.diffusion.overlap = overlap;
                        let asked = whole(num_frames);
                        let misses =
                            misses(&edited(&record, target, num_frames, &asked, true), target);
                        for (frame, miss) in misses.into_iter().enumerate() {
                            assert!(
                                miss < 1e-3,
                                "{name}, {anchor:?}, {fps}, {window} frames a window, {overlap} shared, \
                                 frame {frame} of {num_frames}: {miss} m"
                            );
                        }
                    }
                }
            }
        }
    }
}

/// As published, a motion starts with the first frames of the original: only these two frames differ from the target's.
#[test]
fn a_start_on_the_original_is_wrong_for_its_two_frames_alone() {
    let record = record(16, Fps::MODEL, Anchor::Pelvis, 0.0);
    let misses = misses(&edited(&record, ARMS, 61, &whole(61), true), ARMS);
    // The two frames at 10 fps are four at 20 fps. The spline is affected by the jump after them for up to one more
    // model frame.
    let fixed = 2 * (FIXED_FRAMES + 1);
    assert!(misses[0] > 0.05, "{misses:?}");
    let is_found = misses[fixed..].iter().all(|&miss| miss < 1e-3);
    assert!(is_found, "{misses:?}");
}

/// A range shorter than a window is edited from its first to its last frame. Earlier frames are the original's, and
/// later frames return to the original within 0.7 s.
#[test]
fn a_short_range_is_edited_where_it_is() {
    let record = record(16, Fps::MODEL, Anchor::Pelvis, 0.25);
    let asked = [TimedInstruction {
        frames: 40..52,
        text: "go".to_owned(),
    }];
    let edited = edited(&record, ARMS, 80, &asked, false);
    let (to_source, to_target) = (misses(&edited, SOURCE), misses(&edited, ARMS));
    // Frames with odd numbers lie on a spline through four model frames. The oracle jumps to its target, which affects
    // the spline one model frame earlier.
    for near in [&to_source[..37], &to_target[42..49], &to_source[66..]] {
        assert!(near.iter().all(|&miss| miss < 1e-3), "{near:?}");
    }
    let away = &to_source[40..51];
    assert!(away.iter().all(|&miss| miss > 0.05), "{away:?}");
}
