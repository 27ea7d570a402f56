//! Converts keypoints to SMPL-X parameters: a network predicts a pose, and a fit refines it.

use std::path::Path;

use burn::tensor::{Device, Tensor};
use datasets_spec::{Motion, Pose, Seed};
use glam::{DMat3, DQuat, DVec3};
use kinematics::KeypointFrame;
use kinematics::fit::{AdamFit, FitOptions, fit_pose};
use kinematics::rotation::{from_axis_angle, from_six_d_rows, to_axis_angle, to_six_d_rows};
use kinematics::skeleton::{FIT_KEYPOINTS, Joint, NUM_BODY_JOINTS, NUM_KEYPOINTS, Skeleton};
use rand::RngExt;
use rand_distr::StandardNormal;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::checkpoint::{self, Run, RunRecord, Slot, Start, open_for_use, take, write_atomically};
use crate::config::{Decay, OptimizerConfig, Preset, RunLength, RunSettings};
use crate::model::pose_net::{
    NAMES, OFFICIAL_INPUT, OFFICIAL_OUTPUT, OfficialPoseNet, PAPER_INPUT, PAPER_OUTPUT,
    PaperPoseNet,
};
use crate::model::weights::{Networks, from_safetensors_named, to_safetensors};
use crate::trainer::{self, Task, TrainReport};
use crate::transfer::{read, send};
use crate::{Error, Session};

pub(crate) const KIND: &str = "j2s";

const VAL_POSES: usize = 512;

/// One of the two published networks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum J2sPreset {
    /// The paper's network: 84-512-512-66 with layer norm.
    Paper,
    /// The released code's network: 72-64-64-132 with batch norm.
    Official,
}

impl J2sPreset {
    fn input(self) -> usize {
        match self {
            Self::Paper => PAPER_INPUT,
            Self::Official => OFFICIAL_INPUT,
        }
    }

    fn fit(self) -> AdamFit {
        match self {
            Self::Paper => AdamFit::paper(),
            Self::Official => AdamFit::official(),
        }
    }
}

/// Settings of a network's training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct J2sConfig {
    /// The network.
    pub preset: J2sPreset,
    /// Width of its hidden layers.
    pub width: usize,
    /// Standard deviation in metres of the noise on training points. It prepares the network for generated points.
    pub noise_m: f64,
    /// Whether a body is rotated about the vertical until its hips face +z before it is passed to the network. The
    /// network then never gets a root rotation near 180 degrees, where the axis-angle vector jumps.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub faces_forward: bool,
    /// Settings that every training run has.
    #[serde(flatten)]
    pub run: RunSettings,
}

impl J2sConfig {
    /// The settings of a preset. Neither publication describes the training.
    pub fn preset(preset: J2sPreset) -> Self {
        Self {
            preset,
            width: match preset {
                J2sPreset::Paper => 512,
                J2sPreset::Official => 64,
            },
            noise_m: 0.005,
            // The six-number form of a rotation is continuous, so the released network gets bodies without this
            // rotation.
            faces_forward: preset == J2sPreset::Paper,
            run: RunSettings {
                optimizer: OptimizerConfig {
                    decay: Decay::Linear,
                    weight_decay: 0.0,
                    ..OptimizerConfig::of_rate(1e-3)
                },
                batch_size: 512,
                micro_batch_size: None,
                length: RunLength::of_steps(2_000),
                log_every: 100,
                val_every: 200,
                keep_epochs: 0,
                seed: 0,
            },
        }
    }

    /// The settings for a preset of the editor: the released network for `Official`, otherwise the paper's.
    pub fn of(preset: Preset) -> Self {
        Self::preset(match preset {
            Preset::Official => J2sPreset::Official,
            Preset::Paper | Preset::Tiny => J2sPreset::Paper,
        })
    }

    /// Checks that the settings allow training.
    ///
    /// # Errors
    /// A setting is out of range.
    pub fn check(&self) -> Result<(), Error> {
        self.run.check()?;
        self.run.check_whole("its poses are drawn together")
    }

    /// The settings with the intervals that are used: a short run still writes a line of metrics after each twentieth of
    /// its steps, and validates after each tenth.
    fn used(&self) -> Self {
        let mut used = self.clone();
        let num_steps = used.run.length.steps;
        used.run.log_every = used.run.log_every.min(num_steps.div_ceil(20));
        used.run.val_every = used.run.val_every.min(num_steps.div_ceil(10));
        used
    }
}

/// A network that predicts joint rotations from keypoints.
#[derive(Debug)]
pub struct PoseNet {
    network: Network,
    faces_forward: bool,
}

#[derive(Debug)]
enum Network {
    Paper(Box<PaperPoseNet>),
    Official(Box<OfficialPoseNet>),
}

/// Reconstruction errors of one keypoints-to-SMPL-X method on held-out poses.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FitErrors {
    /// The method.
    pub name: &'static str,
    /// Mean distance between given and reconstructed keypoints in millimetres.
    pub error_mm: f64,
    /// Mean angle between given and reconstructed body rotations, in degrees.
    pub error_deg: f64,
    /// Frames per second with all threads.
    pub frames_per_sec: f64,
}

/// Result of training.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct J2sReport {
    /// The settings.
    pub config: J2sConfig,
    /// Hash of the table of motions.
    pub dataset_hash: String,
    /// Number of steps made.
    #[serde(skip)]
    pub steps: u64,
    /// Whether the run reached its last step.
    #[serde(skip)]
    pub is_complete: bool,
    /// Mean loss up to the first line of the metrics file, and of its last line; NaN if there is none.
    pub loss: [f64; 2],
    /// Errors of the network alone and of the fits that follow it.
    #[serde(rename = "ways")]
    pub fits: Vec<FitErrors>,
}

/// Trains a network on poses from motions and measures it on other motions.
///
/// A sample is the pose of a random frame, rotated about the vertical by a random angle, and its noisy keypoints
/// relative to the pelvis. The loss is the mean squared error of the rotations in the network's representation.
///
/// # Errors
/// A list contains no motion, a loss is not finite, or the run folder cannot be written.
pub fn train_j2s<'a>(
    start: impl Into<Start<'a>>,
    config: &J2sConfig,
    motions: [&[Motion]; 2],
    skeleton: &Skeleton,
    dataset_hash: &str,
    session: &Session<'_>,
) -> Result<J2sReport, Error> {
    let [train, val] = motions;
    Error::if_empty(train, "training split of the pose network")?;
    Error::if_empty(val, "validation split of the pose network")?;
    config.check()?;
    let start = start.into();
    // Earlier versions recorded the intervals that were asked for. Their runs keep these, and so go on.
    let own = Start {
        init: None,
        ..start
    };
    let intervals = |config: &J2sConfig| (config.run.log_every, config.run.val_every);
    let known: Option<J2sConfig> = own.fitted(KIND)?;
    let stays = !start.extend && known.is_some_and(|known| intervals(&known) == intervals(config));
    let config = &match stays {
        true => config.clone(),
        false => config.used(),
    };
    let document = RunRecord::new(KIND, dataset_hash, skeleton, config.clone()).trained_in(session);
    let run = Run::open(start, &document)?;
    let run_dir = run.dir();
    let done = match config.preset {
        J2sPreset::Paper => {
            let network = |device: &Device| PaperPoseNet::new(config.width, device);
            fit(
                PaperPoseNet::forward,
                &network,
                config,
                motions,
                skeleton,
                &run,
                session,
            )?
        }
        J2sPreset::Official => {
            let network = |device: &Device| OfficialPoseNet::new(config.width, device);
            fit(
                OfficialPoseNet::forward,
                &network,
                config,
                motions,
                skeleton,
                &run,
                session,
            )?
        }
    };
    // Edits use the best checkpoint; a run that was stopped early may have only the last one.
    let slot = match checkpoint::read(run_dir, Slot::Best)? {
        Some(_) => Slot::Best,
        None => Slot::Last,
    };
    let (net, _) = PoseNet::load(run_dir, slot, session.device)?;
    let report = J2sReport {
        config: config.clone(),
        dataset_hash: dataset_hash.to_owned(),
        steps: done.steps,
        is_complete: done.is_complete,
        loss: [done.first_loss, done.last_loss].map(|loss| loss.unwrap_or(f64::NAN)),
        fits: measure(&net, val, skeleton, config, session),
    };
    let weights = run_dir.join(PaperPoseNet::FILE);
    let bytes = net.to_safetensors(&weights)?;
    write_atomically(&weights, &bytes)?;
    let document = serde_json::to_vec_pretty(&report).expect("plain numbers and names serialise");
    write_atomically(&run_dir.join("report.json"), &document)?;
    Ok(report)
}

/// Trains one of the networks. `forward` computes its output for rows of points.
fn fit<M: Networks>(
    forward: fn(&M, Tensor<2>) -> Tensor<2>,
    network: &(dyn Fn(&Device) -> M + Sync),
    config: &J2sConfig,
    [train, val]: [&[Motion]; 2],
    skeleton: &Skeleton,
    run: &Run,
    session: &Session<'_>,
) -> Result<TrainReport, Error> {
    let seed = Seed(config.run.seed).derive(&["poses"]);
    let val_poses = draw_poses(val, VAL_POSES, seed.derive(&["val"]).rng_of(0));
    let task = Task::<M, (Vec<f32>, Vec<f32>)> {
        kind: KIND,
        samples: "poses",
        run: config.used().run,
        // Batch normalisation needs the whole batch at once; its running statistics would depend on the order of the threads.
        of_thread: (config.preset == J2sPreset::Paper).then_some(128),
        epoch_len: train.iter().map(|motion| motion.len() as u64).sum(),
        network,
        draw: &|step, micro| {
            let run = &config.run;
            let poses = draw_poses(train, run.batch_size, seed.rng_of(step));
            let noise = seed.derive(&["noise"]).rng_of(step);
            let (points, wanted) = samples(&poses, config, skeleton, Some(noise));
            let batches = run.batches(|first, count| {
                let first = (first % run.batch_size as u64) as usize;
                let rows = |numbers: &[f32]| {
                    let width = numbers.len() / run.batch_size;
                    numbers[first * width..(first + count) * width].to_vec()
                };
                Ok((rows(&points), rows(&wanted)))
            });
            batches(step, micro)
        },
        loss: &|net, (points, wanted), device, _| {
            let rows = points.len() / config.preset.input();
            let points = tensor(points.clone(), rows, device);
            let away = forward(net, points) - tensor(wanted.clone(), rows, device);
            away.square().mean()
        },
        validation: vec![(1, samples(&val_poses, config, skeleton, None))],
    };
    trainer::train(&task, run, session)
}

fn tensor(numbers: Vec<f32>, rows: usize, device: &Device) -> Tensor<2> {
    let columns = numbers.len() / rows.max(1);
    send(numbers, [rows, columns], device)
}

/// Poses of random frames, rotated about the vertical by random angles.
fn draw_poses(motions: &[Motion], count: usize, mut rng: datasets_spec::Rng) -> Vec<Pose> {
    (0..count)
        .map(|_| {
            let motion = &motions[rng.random_range(0..motions.len())];
            let mut pose = motion.pose(rng.random_range(0..motion.len()));
            let turn = DQuat::from_rotation_y(rng.random_range(0.0..std::f64::consts::TAU));
            pose.rotations[0] = turn * pose.rotations[0];
            pose
        })
        .collect()
}

fn samples(
    poses: &[Pose],
    config: &J2sConfig,
    skeleton: &Skeleton,
    noise: Option<datasets_spec::Rng>,
) -> (Vec<f32>, Vec<f32>) {
    let mut frames = skeleton.points_of_poses::<NUM_KEYPOINTS>(poses);
    if let Some(mut rng) = noise {
        let mut normal = || config.noise_m * rng.sample::<f64, _>(StandardNormal);
        for point in frames.iter_mut().flatten() {
            *point += DVec3::new(normal(), normal(), normal());
        }
    }
    let headings = config.faces_forward.then(|| face_forward(&mut frames));
    let wanted = poses.iter().enumerate().flat_map(|(index, pose)| {
        let mut rotations = pose.rotations;
        if let Some(headings) = &headings {
            rotations[0] = headings[index].inverse() * rotations[0];
        }
        rotations.into_iter().flat_map(|rotation| -> Vec<f32> {
            match config.preset {
                J2sPreset::Paper => to_axis_angle(rotation).as_vec3().to_array().to_vec(),
                J2sPreset::Official => to_six_d_rows(DMat3::from_quat(rotation))
                    .map(|v| v as f32)
                    .to_vec(),
            }
        })
    });
    (inputs(&frames, config.preset), wanted.collect())
}

/// Rotates each frame about the vertical through its pelvis until the hips face +z. Returns the rotations that undo
/// this.
fn face_forward(frames: &mut [KeypointFrame]) -> Vec<DQuat> {
    let [left, right] = [Joint::LeftHip, Joint::RightHip].map(Joint::index);
    frames
        .iter_mut()
        .map(|frame| {
            let across = frame[left] - frame[right];
            let heading = DQuat::from_rotation_y((-across.z).atan2(across.x));
            let (pelvis, back) = (frame[0], heading.inverse());
            for point in frame {
                *point = pelvis + back * (*point - pelvis);
            }
            heading
        })
        .collect()
}

/// Keypoints relative to the pelvis, as the network's input.
fn inputs(frames: &[KeypointFrame], preset: J2sPreset) -> Vec<f32> {
    let slots: Vec<usize> = match preset {
        J2sPreset::Paper => (0..NUM_KEYPOINTS).collect(),
        J2sPreset::Official => FIT_KEYPOINTS.to_vec(),
    };
    frames
        .iter()
        .flat_map(|frame| {
            slots
                .iter()
                .flat_map(|&slot| (frame[slot] - frame[0]).as_vec3().to_array())
        })
        .collect()
}

impl PoseNet {
    /// Loads a trained network from its run folder. Also returns the hash of its weights: BLAKE3, hexadecimal.
    ///
    /// # Errors
    /// The folder is not a run of a pose network, or its checkpoint is missing or damaged.
    pub fn load(run_dir: &Path, slot: Slot, device: &Device) -> Result<(Self, String), Error> {
        let mut opened = open_for_use::<J2sConfig>(run_dir, slot, KIND)?;
        let bytes = take(&mut opened.files, PaperPoseNet::FILE, run_dir)?;
        let config = &opened.record.config;
        let path = run_dir.join(PaperPoseNet::FILE);
        let net = Self::from_safetensors(config.preset, config.width, bytes, "", &path, device)?;
        let net = Self {
            faces_forward: config.faces_forward,
            ..net
        };
        Ok((net, opened.hash))
    }

    /// Loads a network from safetensors, with the published tensor names, those of the recorded references, or those of
    /// this program. Bodies are not rotated before they are passed to it.
    ///
    /// # Errors
    /// The file is malformed, or a tensor is missing or of another shape.
    pub fn from_safetensors(
        preset: J2sPreset,
        width: usize,
        bytes: Vec<u8>,
        prefix: &str,
        path: &Path,
        device: &Device,
    ) -> Result<Self, Error> {
        let network = match preset {
            J2sPreset::Paper => {
                let mut net = PaperPoseNet::new(width, device);
                from_safetensors_named(&mut net, bytes, prefix, path, &NAMES)?;
                Network::Paper(Box::new(net))
            }
            J2sPreset::Official => {
                let mut net = OfficialPoseNet::new(width, device);
                from_safetensors_named(&mut net, bytes, prefix, path, &NAMES)?;
                Network::Official(Box::new(net))
            }
        };
        Ok(Self {
            network,
            faces_forward: false,
        })
    }

    fn to_safetensors(&self, path: &Path) -> Result<Vec<u8>, Error> {
        match &self.network {
            Network::Paper(net) => to_safetensors(&**net, path),
            Network::Official(net) => to_safetensors(&**net, path),
        }
    }

    fn preset(&self) -> J2sPreset {
        match self.network {
            Network::Paper(_) => J2sPreset::Paper,
            Network::Official(_) => J2sPreset::Official,
        }
    }

    /// Raw output of the network for rows of points.
    ///
    /// # Shapes
    /// `[T, 84]` give `[T, 66]`, or `[T, 72]` give `[T, 132]`.
    pub fn raw(&self, points: Vec<f32>, num_frames: usize, device: &Device) -> Vec<f32> {
        let points = tensor(points, num_frames, device);
        let out = match &self.network {
            Network::Paper(net) => net.forward(points),
            Network::Official(net) => net.forward(points),
        };
        read(out)
    }

    /// Poses for keypoint frames in metres. The network predicts the rotations; the pelvis position is that of the
    /// keypoints.
    pub fn poses(
        &self,
        frames: &[KeypointFrame],
        skeleton: &Skeleton,
        device: &Device,
    ) -> Vec<Pose> {
        let preset = self.preset();
        let mut seen = frames.to_vec();
        let headings = self.faces_forward.then(|| face_forward(&mut seen));
        let numbers = self.raw(inputs(&seen, preset), frames.len(), device);
        let width = match preset {
            J2sPreset::Paper => PAPER_OUTPUT,
            J2sPreset::Official => OFFICIAL_OUTPUT,
        };
        frames
            .iter()
            .zip(numbers.chunks_exact(width))
            .enumerate()
            .map(|(index, (frame, numbers))| {
                let row = numbers.chunks_exact(width / NUM_BODY_JOINTS);
                let mut rotations = [DQuat::IDENTITY; NUM_BODY_JOINTS];
                for (rotation, numbers) in rotations.iter_mut().zip(row) {
                    let at = |i: usize| f64::from(numbers[i]);
                    *rotation = match preset {
                        J2sPreset::Paper => from_axis_angle(DVec3::new(at(0), at(1), at(2))),
                        J2sPreset::Official => {
                            DQuat::from_mat3(&from_six_d_rows(std::array::from_fn(at)))
                        }
                    };
                }
                if let Some(headings) = &headings {
                    rotations[0] = headings[index] * rotations[0];
                }
                Pose {
                    transl: frame[0] - skeleton.rest(0),
                    rotations,
                }
            })
            .collect()
    }

    /// As [`PoseNet::poses`], refined by gradient descent, as published.
    pub(crate) fn refined(
        &self,
        frames: &[KeypointFrame],
        skeleton: &Skeleton,
        device: &Device,
    ) -> Vec<Pose> {
        let start = AdamFit::parameters_of(&self.poses(frames, skeleton, device));
        let fit = self.preset().fit();
        // Frames are fitted independently. Their number only scales the gradient, which Adam cancels up to its epsilon.
        let fitted: Vec<Vec<Pose>> = frames
            .par_chunks(16)
            .zip(start.par_chunks(16))
            .map(|(frames, start)| fit.fit(skeleton, frames, start).poses())
            .collect();
        fitted.into_iter().flatten().collect()
    }
}

fn measure(
    net: &PoseNet,
    motions: &[Motion],
    skeleton: &Skeleton,
    config: &J2sConfig,
    session: &Session<'_>,
) -> Vec<FitErrors> {
    const POSES: usize = 512;
    let seed = Seed(config.run.seed).derive(&["measure"]);
    let poses = draw_poses(motions, POSES, seed.rng_of(0));
    let frames = skeleton.points_of_poses::<NUM_KEYPOINTS>(&poses);
    let options = FitOptions::default();
    let second_order = |first: Option<&[Pose]>| -> Vec<Pose> {
        let fitted = |(index, frame): (usize, &KeypointFrame)| {
            let first = first.map(|first| &first[index]);
            fit_pose(skeleton, frame, first, &options).pose
        };
        frames.par_iter().enumerate().map(fitted).collect()
    };
    let predicted = || net.poses(&frames, skeleton, session.device);
    let errors = |name, solve: &dyn Fn() -> Vec<Pose>| {
        let begun = session.secs();
        let found = solve();
        let secs = session.secs() - begun;
        let placed = skeleton.points_of_poses::<NUM_KEYPOINTS>(&found);
        let pairs = frames.iter().flatten().zip(placed.iter().flatten());
        let error: f64 = pairs.map(|(a, b)| a.distance(*b)).sum();
        let turned = poses.iter().zip(&found).flat_map(|(a, b)| {
            let pairs = a.rotations.into_iter().zip(b.rotations);
            pairs.map(|(a, b)| kinematics::rotation::angle_between(a, b))
        });
        FitErrors {
            name,
            error_mm: 1e3 * error / (POSES * NUM_KEYPOINTS) as f64,
            error_deg: turned.sum::<f64>().to_degrees() / (POSES * NUM_BODY_JOINTS) as f64,
            frames_per_sec: POSES as f64 / secs.max(1e-9),
        }
    };
    let adam = || net.refined(&frames, skeleton, session.device);
    let both = || second_order(Some(&predicted()));
    vec![
        errors("network", &predicted),
        errors("network, Adam", &adam),
        errors("network, second order", &both),
        errors("geometry, second order", &|| second_order(None)),
    ]
}

#[cfg(test)]
mod tests {
    use kinematics::rotation::angle_between;

    use super::*;
    use crate::model::weights::draw;

    /// A lunging body, rotated about the vertical.
    fn turned(degrees: f64) -> Pose {
        let mut pose = Pose {
            transl: DVec3::new(1.0, 0.9, -2.0),
            ..Pose::REST
        };
        pose.rotations[0] =
            DQuat::from_rotation_y(degrees.to_radians()) * DQuat::from_rotation_x(0.2);
        pose.rotations[1] = DQuat::from_rotation_x(-0.6);
        pose
    }

    fn of(faces_forward: bool) -> J2sConfig {
        J2sConfig {
            faces_forward,
            ..J2sConfig::preset(J2sPreset::Paper)
        }
    }

    #[test]
    fn a_body_of_any_heading_is_one_sample() {
        let skeleton = Skeleton::smplx_neutral();
        let sample = |config, degrees| samples(&[turned(degrees)], config, &skeleton, None);
        let (config, as_it_stands) = (of(true), of(false));
        let (seen, wanted) = sample(&config, 0.0);
        for degrees in [-179.0, -90.0, 30.0, 120.0, 180.0] {
            let (also_seen, also_wanted) = sample(&config, degrees);
            let also = also_seen.iter().chain(&also_wanted);
            for (a, b) in seen.iter().chain(&wanted).zip(also) {
                // The tolerance is the rounding of single-precision numbers below 2.
                assert!((a - b).abs() < 1e-6, "{degrees}: {a} {b}");
            }
            let (left_alone, _) = sample(&as_it_stands, degrees);
            let mut pairs = left_alone.iter().zip(&seen);
            assert!(pairs.any(|(a, b)| (a - b).abs() > 0.05));
        }
    }

    #[test]
    fn a_turned_body_gets_its_heading_back() {
        let skeleton = Skeleton::smplx_neutral();
        let device = Device::flex();
        let net = draw(PaperPoseNet::new(16, &device), Seed(2)).expect("known layers");
        let net = PoseNet {
            network: Network::Paper(Box::new(net)),
            faces_forward: true,
        };
        let pose_at = |degrees| {
            let frames = skeleton.points_of_poses::<NUM_KEYPOINTS>(&[turned(degrees)]);
            net.poses(&frames, &skeleton, &device)[0]
        };
        let straight = pose_at(0.0);
        for degrees in [-170.0f64, 45.0, 180.0] {
            let found = pose_at(degrees);
            let turn = DQuat::from_rotation_y(degrees.to_radians());
            let root = angle_between(found.rotations[0], turn * straight.rotations[0]);
            let knee = angle_between(found.rotations[4], straight.rotations[4]);
            // The network computes in single precision.
            assert!(root < 1e-4 && knee < 1e-4, "{degrees}: {root} {knee}");
            assert!(found.transl.distance(turned(degrees).transl) < 1e-9);
        }
    }
}
