//! Jobs of models in pieces, for any number of processes.

pub mod edits;
pub mod variants;

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use burn::tensor::Device;
use datasets_spec::NoProgress;
use remote_store::hub::HubCache;
use serde_json::Value;
use work::{Failed, Plan};

use crate::model::pass::Arithmetic;
use crate::text::source::TextEncoderSource;
use crate::{Error, Session};

/// What the process of a worker adds to a plan.
#[derive(Clone, Debug)]
pub struct Surroundings {
    /// Device that models run on.
    pub device: Device,
    /// The operations that they are computed by.
    pub arithmetic: Arithmetic,
    /// Where text encoders are found that the plan names no folder of.
    pub cache: Option<HubCache>,
}

impl Surroundings {
    fn text_encoder(&self, given: Option<PathBuf>) -> TextEncoderSource {
        TextEncoderSource {
            given,
            cache: self.cache.clone(),
        }
    }

    /// Runs a part of a piece.
    fn with_session<T>(&self, act: impl FnOnce(&Session<'_>) -> T) -> T {
        let begun = Instant::now();
        let clock = move || -> Duration { begun.elapsed() };
        act(&Session {
            device: &self.device,
            more_devices: &[],
            arithmetic: self.arithmetic,
            progress: &NoProgress,
            stop: &AtomicBool::new(false),
            clock: &clock,
        })
    }
}

/// What the command line said of the device when a plan was made.
///
/// # Errors
/// The plan is of another job.
pub fn device_of(plan: &Plan) -> Result<Value, work::Error> {
    Ok(plan.settings::<Value>()?["device"].take())
}

impl From<Error> for Failed {
    fn from(error: Error) -> Self {
        Self::of(error.code(), &error)
    }
}

/// The refusal of a plan whose inputs are others by now.
fn changed(what: &str) -> Failed {
    let problem = format!("{what} changed since they were planned; plan again");
    Failed::new("E-SOURCE-CHANGED", problem)
}

/// The error of a commit, which is one of work in pieces.
fn of_commit(error: Error) -> work::Error {
    match error {
        Error::Work(error) => error,
        Error::Spec(error) => error.into(),
        error => Failed::from(error).into(),
    }
}
