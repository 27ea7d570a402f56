//! The evaluation encoder: training and use.

mod clips;
mod config;
mod encoder;
mod task;

pub use self::config::{LossWeights, TmrConfig};
pub use self::encoder::{ImportedText, MotionEncoderRecord, TmrEncoder};
pub(crate) use self::encoder::{MOTION_WEIGHTS, TEXT_FOLDER, TEXT_WEIGHTS};
pub(crate) use self::task::KIND;
pub use self::task::{TmrRecord, train_tmr};
