//! The TMED denoiser.

use std::path::Path;

use burn::module::{Initializer, Module, Param};
use burn::nn::{Dropout, DropoutConfig, Embedding, EmbeddingConfig, Linear, LinearConfig};
use burn::tensor::{Device, Tensor};

use super::denoiser::TwoLayers;
use super::motionrefit::TextSource;
use super::pass::Pass;
use super::position::sinusoid;
use super::transformer::{Encoder, Padding};
use super::weights::{Networks, both_files};
use crate::Error;
use crate::checkpoint::Files;
use crate::config::NetworkConfig;

/// A transformer over one sequence: the diffusion step, the tokens of the instruction, the source, a
/// separator and the noisy target. It predicts the clean target.
///
/// # Source
/// Athanasiou et al. 2024 (MotionFix), Sec. 5; the layout is that of the released `tmed_denoiser.py`, except that its
/// unused parameters `feat_comb_coeff` and `first_pose_proj` are left out.
#[derive(Module, Debug)]
pub struct Tmed {
    sep_token: Param<Tensor<2>>,
    pose_proj_in_source: Linear,
    pose_proj_in_target: Linear,
    pose_proj_out: Linear,
    embed_timestep: TwoLayers,
    emb_proj: Option<Linear>,
    encoder: Encoder,
    dropout: Dropout,
}

/// Conditions of a batch of targets. Tokens and frames after a row's length are masked.
#[derive(Clone, Debug)]
pub struct Condition {
    /// Tokens of the instructions, `[B, N, text_width]`.
    pub text: Tensor<3>,
    /// Number of tokens in each instruction, `[B]`.
    pub text_lengths: Vec<usize>,
    /// Normalised source motions, `[B, S, F]`.
    pub source: Tensor<3>,
    /// Number of frames of each source that the network sees, `[B]`; 0 hides a source.
    pub source_lengths: Vec<usize>,
    /// Positions in the position table.
    pub places: Places,
}

/// Layout of positions in the position table: texts start at 1, and sources start after the positions reserved for
/// texts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Places {
    /// Number of positions reserved for a text, whatever its length.
    pub text: usize,
    /// Number of positions reserved for each source, `[B]`. The separator and the target follow.
    pub source: Vec<usize>,
}

impl Places {
    /// Position of each token in a row of `text` tokens, and `source` and `target` frames.
    fn of_row(
        &self,
        row: usize,
        [text, source, target]: [usize; 3],
    ) -> impl Iterator<Item = usize> {
        let (first_frame, separator) = (1 + self.text, 1 + self.text + self.source[row]);
        (0..=text)
            .chain(first_frame..first_frame + source)
            .chain(separator..=separator + target)
    }
}

impl Networks for Tmed {
    const FILE: &'static str = "denoiser.safetensors";
}

impl Tmed {
    /// Builds the network for frames of `num_features` numbers. Text tokens with the network's own width are not
    /// projected, as in the released code.
    pub fn new(
        config: &NetworkConfig,
        text_width: usize,
        num_features: usize,
        device: &Device,
    ) -> Self {
        let width = config.width;
        let linear = |from, to| LinearConfig::new(from, to).init(device);
        Self {
            sep_token: Initializer::Zeros.init([1, width], device),
            pose_proj_in_source: linear(num_features, width),
            pose_proj_in_target: linear(num_features, width),
            pose_proj_out: linear(width, num_features),
            embed_timestep: TwoLayers::new([width; 3], device),
            emb_proj: (text_width != width).then(|| linear(text_width, width)),
            encoder: Encoder::new(config, device),
            dropout: DropoutConfig::new(config.dropout).init(),
        }
    }

    /// Predicts clean targets; frames after a target's length are zero.
    ///
    /// # Shapes
    /// `x` and the result `[B, T, F]`; `lengths` and `timesteps` `[B]`.
    pub fn forward(
        &self,
        x: Tensor<3>,
        lengths: &[usize],
        timesteps: &[usize],
        condition: &Condition,
        pass: &Pass,
    ) -> Tensor<3> {
        let [batch, frames, _] = x.dims();
        let device = x.device();
        let time = self.embed_timestep.embed(timesteps).unsqueeze_dim::<3>(1);
        let [_, _, width] = time.dims();
        let text = match &self.emb_proj {
            Some(projection) => projection.forward(condition.text.clone()),
            None => condition.text.clone(),
        };
        let source = self.embed_source(&condition.source);
        let separator = self.sep_token.val().unsqueeze_dim::<3>(0);
        let separator = separator.expand([batch, 1, width]);
        let target = self.pose_proj_in_target.forward(x);
        let parts = [text.dims()[1], source.dims()[1], frames];
        let tokens = Tensor::cat(vec![time, text, source, separator, target], 1);
        let tokens = tokens + place_table(&condition.places, batch, parts, width, &device);
        let visible: Vec<[usize; 3]> = (0..batch)
            .map(|row| {
                let (text, source) = (&condition.text_lengths, &condition.source_lengths);
                [text[row], source[row], lengths[row]]
            })
            .collect();
        let padding = padding(&visible, parts);
        let tokens = pass.drop_out(&self.dropout, tokens);
        let tokens = self.encoder.forward(tokens, padding.as_ref(), pass);
        let [_, length, _] = tokens.dims();
        let out = self
            .pose_proj_out
            .forward(tokens.narrow(1, length - frames, frames));
        if lengths.iter().all(|&length| length == frames) {
            return out;
        }
        Padding::after(lengths, frames).clear(out)
    }

    /// Tokens of source frames. A frame of zeros gives a token of zeros, without the bias.
    fn embed_source(&self, source: &Tensor<3>) -> Tensor<3> {
        let is_given = source.clone().abs().sum_dim(2).greater_elem(0.0).float();
        self.pose_proj_in_source.forward(source.clone()) * is_given
    }
}

/// The position table of a batch, `[B or 1, L, d]`: one row if all rows have the same positions.
fn place_table(
    places: &Places,
    batch: usize,
    parts: [usize; 3],
    width: usize,
    device: &Device,
) -> Tensor<3> {
    let rows: Vec<Vec<usize>> = (0..batch)
        .map(|row| places.of_row(row, parts).collect())
        .collect();
    let distinct = if rows.iter().all(|row| *row == rows[0]) {
        &rows[..1]
    } else {
        &rows[..]
    };
    let length = distinct[0].len();
    sinusoid(&distinct.concat(), width, device).reshape([distinct.len(), length, width])
}

/// Mask of the padding tokens; none if no row has any.
fn padding(visible: &[[usize; 3]], parts: [usize; 3]) -> Option<Padding> {
    if visible.iter().all(|row| *row == parts) {
        return None;
    }
    let [text, source, target] = parts;
    let length = 2 + text + source + target;
    let mut padded = Vec::with_capacity(visible.len() * length);
    for row in visible {
        padded.push(false);
        padded.extend((0..text).map(|token| token >= row[0]));
        padded.extend((0..source).map(|frame| frame >= row[1]));
        padded.push(false);
        padded.extend((0..target).map(|frame| frame >= row[2]));
    }
    Some(Padding::new(padded, visible.len()))
}

/// TMED: the denoiser, and the word vectors trained with it, if any.
#[derive(Module, Debug)]
pub struct TmedModel {
    /// The denoiser.
    pub denoiser: Tmed,
    /// Word vectors; none if a frozen encoder provides the tokens.
    pub words: Option<Embedding>,
}

/// Word vectors as a separate file of a checkpoint.
impl Networks for Embedding {
    const FILE: &'static str = "words.safetensors";
}

impl Networks for TmedModel {
    const FILE: &'static str = Tmed::FILE;

    fn to_files(&self, run_dir: &Path) -> Result<Files, Error> {
        both_files(&self.denoiser, &self.words, run_dir)
    }

    fn take_files(&mut self, files: &mut Files, run_dir: &Path) -> Result<(), Error> {
        self.denoiser.take_files(files, run_dir)?;
        self.words.take_files(files, run_dir)
    }
}

impl TmedModel {
    /// Builds the networks.
    pub fn new(
        config: &NetworkConfig,
        text: TextSource,
        num_features: usize,
        device: &Device,
    ) -> Self {
        let (text_width, words) = match text {
            TextSource::Learned(num_tokens) => (
                config.width,
                Some(EmbeddingConfig::new(num_tokens, config.width).init(device)),
            ),
            TextSource::Frozen(width) => (width, None),
        };
        Self {
            denoiser: Tmed::new(config, text_width, num_features, device),
            words,
        }
    }
}
