//! Checks of numbers.

use kinematics::normalise::FRAME_WIDTH;

use crate::Error;

pub(crate) fn positive(field: &'static str, value: u64) -> Result<(), Error> {
    match value {
        0 => Err(Error::config(field, "it must be at least 1")),
        _ => Ok(()),
    }
}

pub(crate) fn above_zero(field: &'static str, value: f64) -> Result<(), Error> {
    refused_unless(value.is_finite() && value > 0.0, field, || {
        format!("it is {value}, and must be positive")
    })
}

pub(crate) fn not_negative(field: &'static str, value: f64) -> Result<(), Error> {
    refused_unless(value.is_finite() && value >= 0.0, field, || {
        format!("it is {value}, and must be finite and not negative")
    })
}

pub(crate) fn finite(field: &'static str, value: f64) -> Result<(), Error> {
    refused_unless(value.is_finite(), field, || format!("it is {value}"))
}

pub(crate) fn share(field: &'static str, value: f64) -> Result<(), Error> {
    refused_unless((0.0..1.0).contains(&value), field, || {
        format!("it is {value}, and must lie in [0, 1)")
    })
}

/// Checks the shortest and the longest motion that is trained on, in frames.
pub(crate) fn check_lengths(min_frames: usize, max_frames: usize) -> Result<(), Error> {
    positive("min_frames", min_frames as u64)?;
    refused_unless(min_frames <= max_frames, "max_frames", || {
        format!("it is {max_frames}, less than min_frames {min_frames}")
    })
}

/// Checks that windows of `found` numbers have the frames that a model is trained on.
pub(crate) fn check_windows(frames: usize, found: usize) -> Result<(), Error> {
    refused_unless(found == frames * FRAME_WIDTH, "window", || {
        let found = found / FRAME_WIDTH;
        format!("it is {frames} frames, and the windows to train on have {found}")
    })
}

fn refused_unless(
    holds: bool,
    field: &'static str,
    problem: impl FnOnce() -> String,
) -> Result<(), Error> {
    match holds {
        true => Ok(()),
        false => Err(Error::config(field, problem())),
    }
}
