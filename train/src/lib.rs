//! Models, diffusion, trainer and editor for text-guided motion editing.
//!
//! Batches come in through [`data::WindowSource`] as normalised windows, and edited motions go out
//! of [`sample::Editor`] as keypoints. The crate reads and writes run folders and the files of text
//! encoders only: it never opens a dataset, chooses a device or reads the clock, and nothing but
//! [`text::hub::HubCache::fetch`] uses the network. The caller passes what it needs as a
//! [`Session`].
//!
//! Read [`fit::train_motionrefit`] first, which shows a whole training run, then
//! [`model::denoiser::Denoiser`].

pub mod checkpoint;
pub mod compose;
pub mod config;
pub mod coordinator;
pub mod data;
pub mod diffusion;
pub mod edit;
mod error;
pub mod exchange;
pub mod features;
pub mod fit;
pub mod history;
pub mod j2s;
pub mod kind;
pub mod metrics;
pub mod model;
pub mod optimizer;
pub mod registry;
pub mod sample;
mod session;
pub mod stage;
pub mod system;
pub mod text;
pub mod tmr;
pub mod trainer;
pub mod vocabulary;

pub use error::Error;
pub use session::Session;
