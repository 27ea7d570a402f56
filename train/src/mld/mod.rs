//! MLD: an autoencoder of motions, a text-conditioned diffusion of its latent vectors, and variants decoded from
//! neighbouring latent vectors.

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

/// Kind of a run of the latent diffusion. Its folder also holds the run of its autoencoder.
pub(crate) const KIND: &str = "mld";

pub(crate) const CLIP: ClipModel = ClipModel::VitL14;
