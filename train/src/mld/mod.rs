//! MLD: an autoencoder of motions, a diffusion of its latent vectors by captions, and variants of motions
//! that are decoded near each other.

mod autoencoder;
mod config;
mod diffusion;
mod generator;
mod joints;

pub use self::config::{AutoencoderConfig, MldConfig};
pub use self::diffusion::train_mld;
pub use self::generator::{Base, Generator, LatentNoise};
pub use self::joints::recovered_joints;

use crate::text::clip::ClipModel;

/// Kind of a run of the latent diffusion, whose folder holds the run of its autoencoder too.
pub(crate) const KIND: &str = "mld";

pub(crate) const CLIP: ClipModel = ClipModel::VitL14;
