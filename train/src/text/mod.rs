//! Texts to vectors by an encoder that is not trained: CLIP.
//!
//! Training never runs it. [`table::EmbeddingTable`] holds the vectors of all instructions, made
//! once by a [`clip::ClipEncoder`] whose files [`clip::ClipFiles`] finds in a folder or in the
//! cache of Hugging Face's tools, or downloads when it is asked to.

pub mod clip;
pub mod hub;
pub mod source;
pub mod table;
pub mod tokens;
