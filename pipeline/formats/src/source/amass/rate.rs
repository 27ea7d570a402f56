//! The frame rate of a recording: the stated one, or the known one where that is wrong.

use std::path::Path;

use datasets_spec::Fps;

use super::catalogue;
use clip::Rejected;
use clip::check::FLAG_FPS_DOUBTFUL;

/// Relative difference up to which a stated frame rate agrees with the known one: the stored
/// 120.000046 and 59.94 count as 120 and 60.
const FPS_TOLERANCE: f64 = 0.01;

/// The frame rate that is used, and why.
pub(super) struct Rate {
    pub(super) fps: Fps,
    pub(super) note: Option<String>,
    pub(super) flags: u32,
}

impl Rate {
    pub(super) fn of(path: &Path, stated: f64) -> Result<Self, Rejected> {
        let known =
            catalogue::true_fps(path).filter(|known| (stated / known - 1.0).abs() > FPS_TOLERANCE);
        let fps = Fps::from_file(known.unwrap_or(stated))
            .map_err(|error| Rejected::read("E-AMASS-FPS", error.to_string()))?;
        Ok(Self {
            fps,
            note: known.map(|known| {
                format!(
                    "the file states {stated} fps; {known} fps were taken, as is known of this \
                     recording"
                )
            }),
            flags: known.map_or(0, |_| FLAG_FPS_DOUBTFUL),
        })
    }
}
