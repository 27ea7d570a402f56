//! A network with text input, and the text encoder trained with it, if there is one.

use std::path::Path;

use burn::module::Module;
use burn::tensor::{Device, Tensor};

use super::denoiser::TEXT_DIVISOR;
use super::motionrefit::TextSource;
use super::text::{LearnedText, TextBatch, text_vectors};
use super::weights::{Networks, both_files};
use crate::Error;
use crate::checkpoint::Files;

/// A network with its text encoder.
#[derive(Module, Debug)]
pub struct Conditioned<N: Module> {
    /// The network.
    pub network: N,
    /// The learned text encoder; none if the vectors come from a frozen encoder.
    pub text: Option<LearnedText>,
}

impl<N: Networks> Networks for Conditioned<N> {
    const FILE: &'static str = N::FILE;

    fn to_files(&self, run_dir: &Path) -> Result<Files, Error> {
        both_files(&self.network, &self.text, run_dir)
    }

    fn take_files(&mut self, files: &mut Files, run_dir: &Path) -> Result<(), Error> {
        self.network.take_files(files, run_dir)?;
        self.text.take_files(files, run_dir)
    }
}

impl<N: Module> Conditioned<N> {
    /// Builds the text encoder, and a network for the width of its vectors. Those of a learned encoder have `width`
    /// numbers.
    pub fn new(
        text: TextSource,
        width: usize,
        device: &Device,
        network: impl FnOnce(usize) -> N,
    ) -> Self {
        let (text_width, text) = text.encoder(width, device);
        Self {
            network: network(text_width),
            text,
        }
    }

    /// The vectors of a batch of texts.
    ///
    /// # Shapes
    /// `[rows, text_width]`
    ///
    /// # Panics
    /// If words are given to a model without a learned encoder.
    pub fn text_vectors(&self, texts: &TextBatch, rows: usize, device: &Device) -> Tensor<2> {
        let vectors = text_vectors(self.text.as_ref(), texts, rows, device);
        // The learned encoder scales its output for a denoiser that divides it again; these networks do not.
        match &self.text {
            Some(_) => vectors.div_scalar(TEXT_DIVISOR),
            None => vectors,
        }
    }
}
