//! Context of a run.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use burn::tensor::Device;
use datasets_spec::Progress;

use crate::Error;
use crate::model::pass::Arithmetic;

/// Context of a run: device and operations, progress sink, stop flag, clock.
#[derive(Clone, Copy)]
pub struct Session<'a> {
    /// Device tensors live on, without automatic differentiation.
    pub device: &'a Device,
    /// Further devices of the same kind, which share the parts of a training step.
    pub more_devices: &'a [Device],
    /// The operations that networks are computed by.
    pub arithmetic: Arithmetic,
    /// Receives the progress.
    pub progress: &'a dyn Progress,
    /// Ends the run after the current step and a checkpoint, once set.
    pub stop: &'a AtomicBool,
    /// Time passed since any fixed moment. It is used for reported speeds alone.
    pub clock: &'a (dyn Fn() -> Duration + Sync),
}

impl Session<'_> {
    pub(crate) fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Ends `what` where the run is to end.
    pub(crate) fn go_on(&self, what: &'static str) -> Result<(), Error> {
        match self.is_stopped() {
            true => Err(Error::Stopped { what }),
            false => Ok(()),
        }
    }

    pub(crate) fn secs(&self) -> f64 {
        (self.clock)().as_secs_f64()
    }
}
