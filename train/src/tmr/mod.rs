//! The evaluation encoder: training and use.

mod clips;
mod config;
mod encoder;
mod task;

pub use self::config::{LossWeights, TmrConfig};
pub use self::encoder::TmrEncoder;
pub(crate) use self::encoder::{
    ImportedText, MOTION_WEIGHTS, MotionEncoderRecord, TEXT_FOLDER, TEXT_WEIGHTS,
};
pub(crate) use self::task::KIND;
pub use self::task::train_tmr;
