//! The context that callers pass to a run.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use burn::tensor::Device;
use datasets_spec::Progress;

use crate::Error;
use crate::model::pass::Arithmetic;

/// Context of a run: devices and arithmetic, progress sink, stop flag, clock.
#[derive(Clone, Copy)]
pub struct Session<'a> {
    /// Device of the tensors, without automatic differentiation.
    pub device: &'a Device,
    /// Further devices of the same kind; the micro-batches of a training step are divided among all devices.
    pub more_devices: &'a [Device],
    /// Operations and precision of networks.
    pub arithmetic: Arithmetic,
    /// Receives progress reports.
    pub progress: &'a dyn Progress,
    /// Once set, the run writes a checkpoint and ends after the current step.
    pub stop: &'a AtomicBool,
    /// Returns the time since a fixed moment. It is used only for reported times and speeds.
    pub clock: &'a (dyn Fn() -> Duration + Sync),
}

impl Session<'_> {
    pub(crate) fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Returns an error that names `what` if the run is to end.
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
