//! How motions are edited, and where the time goes.

use datasets_spec::Seed;
use serde::{Deserialize, Serialize};

use crate::config::GuidanceConfig;

/// How SMPL-X parameters are found for generated keypoints.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FitMethod {
    /// Second-order steps until no point moves, the twists that no point shows being those of the pose
    /// network or of the original.
    #[default]
    Exact,
    /// The published way: a pose network, and from its poses 120 steps of Adam (paper App. B.3).
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

/// How motions are edited.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EditSettings {
    /// Seed of the noise.
    pub seed: Seed,
    /// Guidance weight; 1 follows the text without amplifying it.
    pub guidance: f64,
    /// Factor of the noise; 1 samples what was learned, less stays nearer to its mean.
    pub temperature: f64,
    /// Guidance by the coordinator, if the editor has one.
    pub coordinator: GuidanceConfig,
    /// How SMPL-X parameters are found.
    pub fit: FitMethod,
    /// Weight in m^2/rad^2 by which the exact fit holds rotations to those of the pose network or, without
    /// one, of the original: what short bones gain by it, such as those of head and hands, long ones
    /// hardly feel.
    pub prior: f64,
    /// Windows generated at a time.
    pub max_batch: usize,
}

/// Where the time of editing went.
///
/// # Source
/// The columns of the paper's Table A4.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EditTimes {
    /// Seconds in the denoiser and the reverse steps.
    pub diffusion_secs: f64,
    /// Seconds in the coordinator.
    pub coordinator_secs: f64,
    /// Seconds in finding SMPL-X parameters.
    pub fit_secs: f64,
    /// Windows generated.
    pub num_windows: usize,
    /// Number of batches of the generation.
    pub num_batches: usize,
    /// Frames of a window.
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
