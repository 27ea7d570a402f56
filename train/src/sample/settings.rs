//! Settings of an edit, and its times.

use datasets_spec::Seed;
use serde::{Deserialize, Serialize};

use crate::config::GuidanceConfig;

/// Method of fitting SMPL-X parameters to generated keypoints.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FitMethod {
    /// Second-order steps until the points no longer move. Bone twists, which points do not determine, are those of the
    /// pose network or of the original.
    #[default]
    Exact,
    /// The published method: a pose network, followed by 120 steps of Adam (paper App. B.3).
    Paper,
}

impl std::str::FromStr for FitMethod {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        match name {
            "exact" => Ok(Self::Exact),
            "paper" => Ok(Self::Paper),
            _ => Err(format!("{name:?} is no fit; known are exact and paper")),
        }
    }
}

/// Settings of an edit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EditSettings {
    /// Seed of the noise.
    pub seed: Seed,
    /// Guidance weight; 1 follows the text without amplifying it.
    pub guidance: f64,
    /// Factor of the noise: 1 samples the learned distribution, smaller values stay nearer to its mean.
    pub temperature: f64,
    /// Guidance by the coordinator, if the editor has one.
    pub coordinator: GuidanceConfig,
    /// Method of fitting SMPL-X parameters.
    pub fit: FitMethod,
    /// Weight in m^2/rad^2 that draws the rotations of the exact fit towards those of the pose network or, without one,
    /// of the original. It affects short bones, such as those of head and hands, but hardly long ones.
    pub prior: f64,
    /// Maximum number of windows generated at a time.
    pub max_batch: usize,
}

/// Time of editing by stage.
///
/// # Source
/// The columns of the paper's Table A4.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EditTimes {
    /// Seconds in the denoiser and the reverse steps.
    pub diffusion_secs: f64,
    /// Seconds in the coordinator.
    pub coordinator_secs: f64,
    /// Seconds for fitting SMPL-X parameters.
    pub fit_secs: f64,
    /// Number of generated windows.
    pub num_windows: usize,
    /// Number of batches in which the windows were generated.
    pub num_batches: usize,
    /// Number of frames in a window.
    pub window: usize,
}

impl std::ops::AddAssign for EditTimes {
    fn add_assign(&mut self, other: Self) {
        self.diffusion_secs += other.diffusion_secs;
        self.coordinator_secs += other.coordinator_secs;
        self.fit_secs += other.fit_secs;
        self.num_windows += other.num_windows;
        self.num_batches += other.num_batches;
        self.window = other.window;
    }
}
