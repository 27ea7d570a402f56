//! Jobs of models that are divided into pieces, for any number of processes.

pub mod edits;
pub mod variants;

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use burn::tensor::Device;
use datasets_spec::NoProgress;
use datasets_spec::dataset::Staging;
use datasets_spec::store::ByPath;
use remote_store::hub::HubCache;
use serde::Serialize;
use serde_json::Value;
use work::{Draft, Failed, Piece, Plan};

use crate::model::pass::Arithmetic;
use crate::text::source::TextEncoderSource;
use crate::{Error, Session};

/// Settings of a worker process that are not part of the plan.
#[derive(Clone, Debug)]
pub struct Surroundings {
    /// Device of the models.
    pub device: Device,
    /// Operations and precision of the models.
    pub arithmetic: Arithmetic,
    /// Cache that is searched for text encoders if the plan names no folder.
    pub cache: Option<HubCache>,
}

impl Surroundings {
    fn text_encoder(&self, given: Option<PathBuf>) -> TextEncoderSource {
        TextEncoderSource {
            given,
            cache: self.cache.clone(),
        }
    }

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

/// Device options of the command line that made the plan.
///
/// # Errors
/// The plan is of another job.
pub fn device_of(plan: &Plan) -> Result<Value, work::Error> {
    Ok(plan.settings::<Value>()?["device"].take())
}

/// Writes the plan of a job, which makes a dataset in `destination`.
fn write_plan(
    job: &'static str,
    settings: &impl Serialize,
    destination: &Path,
    pieces: Vec<Piece>,
    plan_hash: String,
    out: &Path,
) -> Result<Plan, Error> {
    let newest = Staging::newest(&ByPath, destination)?;
    let draft = Draft {
        job,
        settings: serde_json::to_value(settings).expect("settings are numbers and texts"),
        destination: destination.to_owned(),
        is_dataset: true,
        pieces,
        plan_hash,
        base: Staging::base(&ByPath, destination, newest.as_ref())?,
    };
    Ok(draft.write(out, |_| Ok(()))?)
}

/// Locks a value that pieces use one at a time.
fn in_turn<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

impl From<Error> for Failed {
    fn from(error: Error) -> Self {
        Self::of(error.code(), &error)
    }
}

fn changed(what: &str) -> Failed {
    let problem = format!("{what} changed since they were planned; plan again");
    Failed::new("E-SOURCE-CHANGED", problem)
}

/// Converts an error of a commit to an error of a job in pieces.
fn of_commit(error: Error) -> work::Error {
    match error {
        Error::Work(error) => error,
        Error::Spec(error) => error.into(),
        error => Failed::from(error).into(),
    }
}
