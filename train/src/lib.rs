//! Models, diffusion, trainer and editor for text-guided motion editing.
//!
//! A model is trained from a dataset folder into a run folder by the `train` of its [`kind::ModelKind`]
//! ([`registry::model`]), the editor also by [`stage::editor::train_editor`]. A trained editor answers test items as an
//! [`system::EditSystem`]. [`registry::MODELS`] lists the models. Only [`device::open`] chooses a
//! device, and only [`remote_store::hub::HubCache::fetch`] uses the network. The crate does not read the clock or the
//! environment; the caller passes them in a [`Session`].
//!
//! Start reading at [`fit::train_motionrefit`], which shows a whole training run, and continue with
//! [`model::denoiser::Denoiser`].
//!
//! ```no_run
//! use std::path::Path;
//! use std::sync::atomic::AtomicBool;
//! use std::time::Instant;
//!
//! use burn::tensor::Device;
//! use datasets_spec::{Dataset, NoProgress, Seed};
//! use train::config::{Preset, TrainConfig};
//! use train::registry::open_system;
//! use train::stage::editor::train_editor;
//! use train::system::{EditConfig, SystemSource, answer_items};
//! use train::text::source::TextEncoderSource;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let (device, begun) = (Device::flex(), Instant::now());
//! let session = train::Session {
//!     device: &device,
//!     more_devices: &[],
//!     arithmetic: train::model::pass::Arithmetic::default(),
//!     progress: &NoProgress,
//!     stop: &AtomicBool::new(false),
//!     clock: &|| begun.elapsed(),
//! };
//! // `stance train motionrefit DATASET --out RUN`
//! let (dataset, run) = (Dataset::open(Path::new("DATASET"))?, Path::new("RUN"));
//! let config = TrainConfig::preset(Preset::Tiny);
//! let text_encoder = TextEncoderSource::default();
//! let compose = TrainConfig::compose_preset(Preset::Tiny);
//! let report = train_editor(&dataset, run, &config, &compose, None, &text_encoder, &session)?;
//! assert!(report.is_complete);
//! // `stance edit RUN --items ITEMS --out EDITS`
//! let items = Dataset::open(Path::new("ITEMS"))?;
//! let source = SystemSource::best(run, text_encoder.clone());
//! let edit = EditConfig::default();
//! let mut system = open_system(&source, &edit, &items.skeleton()?, &device)?;
//! let out = Path::new("EDITS");
//! answer_items(&mut *system, &items, out, edit.takes, Seed(0), "me", &session)?;
//! # Ok(())
//! # }
//! ```

mod bones;
pub mod candidates;
pub mod captioned;
pub mod card;
pub mod checkpoint;
pub mod compose;
pub mod config;
pub mod coordinator;
pub mod data;
pub mod ddim;
pub mod device;
pub mod diffusion;
pub mod edit;
mod error;
pub mod exchange;
pub mod extrapolation;
pub mod features;
pub mod fit;
pub mod gaussian;
pub mod history;
pub mod humanml3d;
pub mod j2s;
pub mod kind;
pub mod mdm;
pub mod mdm_bp;
pub mod metrics;
pub mod mld;
pub mod model;
pub mod noise_shape;
pub mod optimizer;
pub mod registry;
pub mod sample;
pub mod schedule;
mod session;
pub mod stage;
pub mod system;
pub mod text;
pub mod throughput;
pub mod tmed;
pub mod tmr;
pub mod trainer;
pub mod transfer;
pub mod vocabulary;
pub mod work;

pub use error::Error;
pub use session::Session;
