//! Checks of numeric settings.

use kinematics::normalise::FRAME_WIDTH;

use crate::Error;

/// Returns an error about a setting unless the condition holds.
pub(crate) fn ensure(
    holds: bool,
    field: &'static str,
    problem: impl Into<String>,
) -> Result<(), Error> {
    match holds {
        true => Ok(()),
        false => Err(Error::config(field, problem)),
    }
}

pub(crate) fn positive(field: &'static str, value: u64) -> Result<(), Error> {
    ensure(value > 0, field, "it must be at least 1")
}

pub(crate) fn above_zero(field: &'static str, value: f64) -> Result<(), Error> {
    let problem = format!("it is {value}, and must be positive");
    ensure(value.is_finite() && value > 0.0, field, problem)
}

pub(crate) fn not_negative(field: &'static str, value: f64) -> Result<(), Error> {
    let problem = format!("it is {value}, and must be finite and not negative");
    ensure(value.is_finite() && value >= 0.0, field, problem)
}

pub(crate) fn finite(field: &'static str, value: f64) -> Result<(), Error> {
    ensure(value.is_finite(), field, format!("it is {value}"))
}

pub(crate) fn share(field: &'static str, value: f64) -> Result<(), Error> {
    let problem = format!("it is {value}, and must lie in [0, 1)");
    ensure((0.0..1.0).contains(&value), field, problem)
}

/// Checks the minimum and maximum length of training motions, in frames.
pub(crate) fn check_lengths(min_frames: usize, max_frames: usize) -> Result<(), Error> {
    positive("min_frames", min_frames as u64)?;
    let problem = format!("it is {max_frames}, less than min_frames {min_frames}");
    ensure(min_frames <= max_frames, "max_frames", problem)
}

/// Checks that a window of `found` numbers has `frames` frames.
pub(crate) fn check_windows(frames: usize, found: usize) -> Result<(), Error> {
    let windows = found / FRAME_WIDTH;
    let problem = format!("it is {frames} frames, and the windows to train on have {windows}");
    ensure(found == frames * FRAME_WIDTH, "window", problem)
}
