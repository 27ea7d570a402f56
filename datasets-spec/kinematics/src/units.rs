//! Frame rates.

use serde::{Deserialize, Serialize};

use crate::Error;

/// A frame rate in frames per second: positive and finite.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(try_from = "f64")]
pub struct Fps(f64);

impl Fps {
    /// Default rate of stored motions, that of HumanML3D.
    pub const STORE: Fps = Fps(20.0);
    /// Rate of the editing model (paper, App. B.5).
    pub const MODEL: Fps = Fps(10.0);

    /// Relative distance from a whole number below which a rate read from a file is taken to be
    /// that number. BVH writes `Frame Time: 0.0333333` for 30 fps and `.008333` for 120 fps
    /// (relative error 4e-5), while the nearest rate that must not be snapped, 29.97 fps, is 1e-3
    /// away from 30.
    const SNAP: f64 = 2e-4;

    /// Checks a rate in frames per second.
    ///
    /// # Errors
    /// The rate is not positive and finite.
    pub fn new(frames_per_second: f64) -> Result<Self, Error> {
        if frames_per_second.is_finite() && frames_per_second > 0.0 {
            return Ok(Self(frames_per_second));
        }
        Err(Error(format!(
            "frame rate must be positive and finite, got {frames_per_second}"
        )))
    }

    /// Reads a rate that a file states with limited precision: a rate within a part in five
    /// thousand of a whole number becomes that number, so that `0.0333333` s a frame and exactly
    /// 1/30 s a frame resample to the same number of frames.
    ///
    /// # Errors
    /// The rate is not positive and finite.
    pub fn from_file(frames_per_second: f64) -> Result<Self, Error> {
        let fps = Self::new(frames_per_second)?;
        let whole = fps.0.round();
        if whole >= 1.0 && (fps.0 - whole).abs() <= Self::SNAP * whole {
            return Ok(Self(whole));
        }
        Ok(fps)
    }

    /// Frames per second.
    pub fn get(self) -> f64 {
        self.0
    }

    /// Time of a frame in seconds; frame 0 is at 0.
    pub fn secs_at(self, frame_index: usize) -> f64 {
        frame_index as f64 / self.0
    }
}

impl TryFrom<f64> for Fps {
    type Error = Error;

    fn try_from(value: f64) -> Result<Self, Error> {
        Self::new(value)
    }
}

impl std::fmt::Display for Fps {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} fps", self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_written_with_few_digits_snap_and_ntsc_does_not() {
        for (written, expected) in [
            (1.0 / 0.0333333, 30.0),
            (1.0 / 0.008333, 120.0),
            (59.999, 60.0),
            (120.000_045_776, 120.0),
        ] {
            assert_eq!(Fps::from_file(written).expect("valid").get(), expected);
        }
        assert_eq!(Fps::from_file(29.97).expect("valid").get(), 29.97);
        assert_eq!(Fps::from_file(65.0533).expect("valid").get(), 65.0533);
    }

    #[test]
    fn impossible_rates_are_refused() {
        for bad in [0.0, -30.0, f64::NAN, f64::INFINITY] {
            assert!(Fps::new(bad).is_err(), "{bad}");
            assert!(Fps::from_file(bad).is_err(), "{bad}");
        }
    }
}
