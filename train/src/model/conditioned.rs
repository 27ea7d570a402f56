//! A network that hears texts, with the text encoder trained with it, where there is one.

use std::path::Path;

use burn::module::Module;
use burn::tensor::{Device, Tensor};

use super::denoiser::TEXT_DIVISOR;
use super::motionrefit::TextSource;
use super::text::{LearnedText, TextBatch, text_vectors};
use super::weights::{load_networks, save_networks};
use crate::Error;
use crate::checkpoint::Files;
use crate::fit::TEXT;

/// A network and its text encoder.
#[derive(Module, Debug)]
pub struct Conditioned<N: Module> {
    /// The network.
    pub network: N,
    /// The learned text encoder; none if the vectors come from a frozen encoder.
    pub text: Option<LearnedText>,
}

impl<N: Module> Conditioned<N> {
    /// Builds a network for the width of its text vectors. A learned encoder makes vectors of `width`
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
    /// `rows` texts give `[B, text_width]`.
    ///
    /// # Panics
    /// If words are given to a model without an encoder of words.
    pub fn text_vectors(&self, texts: &TextBatch, rows: usize, device: &Device) -> Tensor<2> {
        let vectors = text_vectors(self.text.as_ref(), texts, rows, device);
        // The learned encoder is as loud as a denoiser needs it that divides text.
        match &self.text {
            Some(_) => vectors.div_scalar(TEXT_DIVISOR),
            None => vectors,
        }
    }

    /// The networks as files of a checkpoint, that of `N` under the given name.
    ///
    /// # Errors
    /// A network cannot be written.
    pub(crate) fn save(&self, name: &str, run_dir: &Path) -> Result<Files, Error> {
        save_networks((name, &self.network), (TEXT, self.text.as_ref()), run_dir)
    }

    /// The inverse of [`Conditioned::save`].
    ///
    /// # Errors
    /// A file is missing, damaged or of another network.
    pub(crate) fn load(
        &mut self,
        name: &str,
        files: &mut Files,
        run_dir: &Path,
    ) -> Result<(), Error> {
        let text = (TEXT, self.text.as_mut());
        load_networks((name, &mut self.network), text, files, run_dir)
    }
}
