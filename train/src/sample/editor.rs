//! A trained editor, loaded for use.

use std::cell::Cell;
use std::path::Path;

use burn::tensor::{Device, Tensor};
use datasets_spec::Skeleton;
use kinematics::KeypointFrame;
use kinematics::canonical::FIXED_FRAMES;
use kinematics::normalise::NormalizedFrame;
use kinematics::skeleton::{KEYPOINT_PARENTS, NUM_KEYPOINTS};

use super::item::EditItem;
use super::noise::Noise;
use super::sampler::{Condition, Guide, Sampler};
use super::settings::{EditSettings, EditTimes};
use super::windows::{WindowRequest, edit_windows};
use crate::checkpoint::{RunRecord, Slot, open_for_use};
use crate::config::{GuidanceTarget, narrowed};
use crate::coordinator::TrainedCoordinator;
use crate::extrapolation::Extrapolation;
use crate::fit::{EditorRecord, KIND};
use crate::j2s::PoseNet;
use crate::model::motionrefit::MotionRefit;
use crate::model::transformer::PreparedWeights;
use crate::model::weights::Networks;
use crate::schedule::Schedule;
use crate::text::table::EmbeddingTable;
use crate::transfer::{read, send};
use crate::{Error, Session};

/// A trained editor, with its optional pose network and coordinator.
#[derive(Debug)]
pub struct Editor {
    model: MotionRefit,
    schedule: Schedule,
    record: RunRecord<EditorRecord>,
    hash: String,
    device: Device,
    vectors: Option<EmbeddingTable>,
    coordinator: Option<TrainedCoordinator>,
    poses: Option<PoseNet>,
}

impl Editor {
    /// Loads an editor from its run folder.
    ///
    /// # Errors
    /// The folder is not a run of the editor, or its checkpoint is missing or damaged.
    pub fn load(run_dir: &Path, slot: Slot, device: &Device) -> Result<Self, Error> {
        let opened = open_for_use::<EditorRecord>(run_dir, slot, KIND)?;
        let (record, hash, mut files) = (opened.record, opened.hash, opened.files);
        let config = &record.config.train;
        record.config.check()?;
        let mut model = record.config.network(device);
        model.take_files(&mut files, run_dir)?;
        Ok(Self {
            model,
            schedule: Schedule::new(config.diffusion.schedule, config.diffusion.num_steps)?,
            hash,
            device: device.clone(),
            record,
            vectors: None,
            coordinator: None,
            poses: None,
        })
    }

    /// Gives the editor a network that predicts poses from keypoints. Bone twists, which keypoints do not determine,
    /// then come from this network, otherwise from the original.
    #[must_use]
    pub fn with_poses(mut self, net: PoseNet, hash: &str) -> Self {
        self.mix_hash(hash);
        self.poses = Some(net);
        self
    }

    /// Mixes the hash of a pose network or coordinator into the editor's hash, because the network changes the edits.
    fn mix_hash(&mut self, other: &str) {
        let both = [self.hash.as_bytes(), other.as_bytes()].concat();
        self.hash = blake3::hash(&both).to_hex().to_string();
    }

    pub(crate) fn poses(&self) -> Option<&PoseNet> {
        self.poses.as_ref()
    }

    pub(crate) fn device(&self) -> &Device {
        &self.device
    }

    /// Sets the vectors of the instructions, from the editor's frozen encoder.
    ///
    /// # Errors
    /// The vectors are of another encoder.
    pub fn set_vectors(&mut self, vectors: EmbeddingTable) -> Result<(), Error> {
        self.record.config.text.texts(Some(&vectors))?;
        self.vectors = Some(vectors);
        Ok(())
    }

    /// Gives the editor a coordinator, which then guides its last diffusion steps.
    ///
    /// # Errors
    /// The coordinator was trained with another diffusion, window length, set of keypoints, frame rate, anchor or
    /// normaliser.
    pub fn with_coordinator(mut self, coordinator: TrainedCoordinator) -> Result<Self, Error> {
        let theirs = &coordinator.record().config;
        let ours = &self.record.config;
        let diffusion = &ours.train.diffusion;
        let problem = if theirs.train.window != ours.train.window {
            "its windows have another length"
        } else if theirs.train.keypoints != ours.train.keypoints {
            "it sees other keypoints"
        } else if theirs.compose.config.fps != ours.compose.config.fps {
            "it was trained at another rate"
        } else if theirs.compose.config.anchor != ours.compose.config.anchor {
            "its windows stand above the origin by another point of the body"
        } else if theirs.normalizer != ours.normalizer {
            "it was trained in another range of model units"
        } else if (theirs.train.schedule, theirs.train.diffusion_steps)
            != (diffusion.schedule, diffusion.num_steps)
        {
            "it was trained for another diffusion"
        } else {
            self.mix_hash(coordinator.hash());
            self.coordinator = Some(coordinator);
            return Ok(self);
        };
        Err(Error::misfit("the coordinator", problem))
    }

    /// How many of the last diffusion steps its coordinator can guide: all, or for guidance at the mean of the posterior,
    /// those whose noise the coordinator was trained on. `None` without a coordinator.
    pub fn guided_steps(&self) -> Option<usize> {
        let config = &self.record.config.train;
        let trained = &self.coordinator.as_ref()?.record().config.train;
        Some(match config.coordinator.target {
            GuidanceTarget::CleanPrediction => config.diffusion.num_steps,
            GuidanceTarget::PosteriorMean => trained.noise_steps,
        })
    }

    /// Whether the editor has a coordinator.
    pub fn has_coordinator(&self) -> bool {
        self.coordinator.is_some()
    }

    /// The record of the training run: its settings, and values fitted to the training split.
    pub fn record(&self) -> &RunRecord<EditorRecord> {
        &self.record
    }

    /// Hash of the weights, including those of a coordinator and a pose network: BLAKE3, hexadecimal.
    pub fn hash(&self) -> &str {
        &self.hash
    }

    /// Edits motions. Each result holds the keypoints of one item in metres at the model's rate, for all frames of its
    /// windows. `times` is increased by the time of each stage. Keypoints that the editor does not generate are placed
    /// on their parent joints.
    ///
    /// An item's noise depends on the seed and its id, and rows of a batch are independent. So a result does not depend
    /// on the other items. The editor's device is used, not that of the session.
    ///
    /// # Errors
    /// As [`edit_windows`], or a text has no vector.
    ///
    /// # Source
    /// Paper App. B.2; `algorithms` section 8.
    pub fn edit_batch(
        &self,
        items: &[EditItem],
        skeleton: &Skeleton,
        settings: &EditSettings,
        session: &Session<'_>,
        times: &mut EditTimes,
    ) -> Result<Vec<Vec<KeypointFrame>>, Error> {
        times.window = self.record.config.train.window;
        let weights = self.model.denoiser.prepared_weights(session.arithmetic);
        edit_windows(
            &mut |requests| self.generate(requests, &weights, settings, session, times),
            &self.record.config,
            items,
            skeleton,
            settings,
            session,
        )
    }

    /// Generates a window for each request, as [`edit_windows`] asks for.
    fn generate(
        &self,
        requests: &mut [WindowRequest<'_>],
        weights: &PreparedWeights,
        settings: &EditSettings,
        session: &Session<'_>,
        times: &mut EditTimes,
    ) -> Result<Vec<f32>, Error> {
        let config = &self.record.config;
        let begun = session.secs();
        let num_rows = requests.len();
        let (frames, keypoints) = (config.train.window, config.train.keypoints);
        let window = |values: Vec<f32>, frames: usize| -> Tensor<3> {
            send(values, [num_rows, frames, 3 * keypoints], &self.device)
        };
        let original: Vec<f32> = requests
            .iter()
            .flat_map(|request| request.window.original.iter().copied().flatten())
            .collect();
        let fixed: Option<Vec<[NormalizedFrame; FIXED_FRAMES]>> =
            requests.iter().map(|request| request.fixed).collect();
        let texts = config.text.texts(self.vectors.as_ref())?.batch(
            requests
                .iter()
                .map(|request| request.window.instruction.as_deref().unwrap_or_default()),
        )?;
        let condition = Condition {
            original: window(narrowed(original, keypoints), frames),
            fixed: fixed.map(|fixed| {
                let numbers = fixed.into_iter().flatten().flatten().collect();
                window(narrowed(numbers, keypoints), FIXED_FRAMES)
            }),
            text: self.model.text_vectors(&texts, num_rows, &self.device),
            progress: requests
                .iter()
                .map(|request| request.window.progress)
                .collect(),
        };
        let diffusion = &config.train.diffusion;
        let clock = || session.secs();
        let coordinator = self.coordinator.as_ref().map(|coordinator| Guide {
            network: &coordinator.model,
            config: settings.coordinator,
            clock: &clock,
            secs: Cell::new(0.0),
        });
        let sampler = Sampler {
            denoiser: &self.model.denoiser,
            weights,
            schedule: &self.schedule,
            prediction: diffusion.prediction,
            extrapolation: config.extrapolation.as_ref(),
            clip: diffusion.clip,
            guidance: settings.guidance,
            coordinator: coordinator.as_ref(),
        };
        let mut noise = Noise::new(
            requests.iter_mut().map(|request| &mut request.rng),
            [frames, 3 * keypoints],
            1 + self.schedule.len(),
            &self.device,
        )
        .scaled(settings.temperature)
        .shaped(
            config.extrapolation.as_ref().and_then(Extrapolation::shape),
            condition.fixed.is_none(),
        );
        let x = sampler.sample(&condition, |_| noise.step(), |_, _| {});
        let generated = read(x);
        let guided = coordinator.map_or(0.0, |guide| guide.secs.get());
        times.coordinator_secs += guided;
        times.diffusion_secs += session.secs() - begun - guided;
        times.num_windows += num_rows;
        times.num_batches += 1;
        Ok(widened(generated, keypoints))
    }
}

/// Extends generated windows to all keypoints: those that were not generated are placed on their parent joints.
fn widened(generated: Vec<f32>, keypoints: usize) -> Vec<f32> {
    if keypoints == NUM_KEYPOINTS {
        return generated;
    }
    generated
        .chunks_exact(3 * keypoints)
        .flat_map(|frame| {
            (0..NUM_KEYPOINTS).flat_map(move |slot| {
                let known = if slot < keypoints {
                    slot
                } else {
                    keypoint_parent(slot)
                };
                frame[3 * known..3 * known + 3].iter().copied()
            })
        })
        .collect()
}

pub(crate) fn keypoint_parent(slot: usize) -> usize {
    usize::try_from(KEYPOINT_PARENTS[slot]).unwrap_or(0)
}
