//! The training loss of TMED.

use burn::tensor::{Device, Tensor};

use super::clips::ClipBatch;
use super::config::{TargetPlaces, TmedConfig};
use super::features::{GROUPS, NUM_FEATURES};
use crate::model::pass::Pass;
use crate::model::text::{TextBatch, token_tensor};
use crate::model::tmed::{Condition, Places, TmedModel};
use crate::schedule::Schedule;
use crate::transfer::send;

/// The squared error of each feature group over the frames of each motion, averaged over the groups. Groups that are
/// changes since the previous frame are not counted in the first frame.
///
/// # Shapes
/// `predicted` and `target` `[B, T, 207]`; `frames` `[B]`; the results are one number, and `[5]`.
///
/// # Source
/// MotionFix, `base_diffusion.py` (`baselines` A1).
pub fn group_loss(
    predicted: Tensor<3>,
    target: Tensor<3>,
    frames: &[usize],
) -> (Tensor<1>, Tensor<1>) {
    let [batch, length, _] = target.dims();
    let device = target.device();
    // Weights that are zero outside of motions, and turn sums into means.
    let mut weights = vec![0.0f32; batch * length * NUM_FEATURES];
    for group in GROUPS {
        let first = usize::from(group.is_delta);
        let count: usize = frames
            .iter()
            .map(|frames| frames.saturating_sub(first))
            .sum();
        let weight = ((count * group.width).max(1) as f32).recip();
        for (row, &frames) in frames.iter().enumerate() {
            for frame in first..frames {
                let at = (row * length + frame) * NUM_FEATURES + group.start;
                weights[at..at + group.width].fill(weight);
            }
        }
    }
    let weights = send(weights, [batch, length, NUM_FEATURES], &device);
    let errors = (predicted - target).square() * weights;
    let sums: Vec<Tensor<1>> = GROUPS
        .iter()
        .map(|group| errors.clone().narrow(2, group.start, group.width).sum())
        .collect();
    let groups = Tensor::cat(sums, 0);
    (groups.clone().mean(), groups)
}

/// Input tokens of texts for the network.
///
/// # Shapes
/// `[B, N, text_width]`
///
/// # Panics
/// If words are given to a model without learned word vectors.
pub(crate) fn text_tokens(model: &TmedModel, texts: &TextBatch, device: &Device) -> Tensor<3> {
    match texts {
        TextBatch::Words(tokens) => model
            .words
            .as_ref()
            .expect("words are given to a model that learns them")
            .forward(token_tensor(tokens, device)),
        TextBatch::Vectors { values, lengths } => {
            let longest = lengths.iter().copied().max().unwrap_or(0);
            let width = values.len() / (lengths.len() * longest).max(1);
            send(values.clone(), [lengths.len(), longest, width], device)
        }
    }
}

/// Positions in the position table for sources of the given lengths; `padded` is the length of the longest.
pub(crate) fn places(config: &TmedConfig, source_frames: &[usize], padded: usize) -> Places {
    Places {
        text: config.text_places(),
        source: match config.diffusion.places {
            TargetPlaces::Own => source_frames.to_vec(),
            TargetPlaces::Padded => vec![padded; source_frames.len()],
        },
    }
}

/// The training loss of a batch.
///
/// # Shapes
/// The result is one number.
pub fn loss(
    model: &TmedModel,
    batch: &ClipBatch,
    config: &TmedConfig,
    schedule: &Schedule,
    device: &Device,
    pass: &Pass,
) -> Tensor<1> {
    let rows = batch.len();
    let motions = |values: &[f32]| -> Tensor<3> {
        let frames = values.len() / (rows * NUM_FEATURES);
        send(values.to_vec(), [rows, frames, NUM_FEATURES], device)
    };
    let source = motions(&batch.source);
    let shown = batch.source_frames.iter().zip(&batch.source_is_shown);
    let condition = Condition {
        text: text_tokens(model, &batch.texts, device),
        text_lengths: batch.texts.lengths(),
        source_lengths: shown
            .map(|(&frames, &is_shown)| if is_shown { frames } else { 0 })
            .collect(),
        places: places(config, &batch.source_frames, source.dims()[1]),
        source,
    };
    let target = motions(&batch.target);
    let noisy = schedule.q_sample(target.clone(), &batch.timesteps, motions(&batch.noise));
    let predicted = model.denoiser.forward(
        noisy,
        &batch.target_frames,
        &batch.timesteps,
        &condition,
        pass,
    );
    group_loss(predicted, target, &batch.target_frames).0
}
