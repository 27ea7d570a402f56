//! Names of noise schedules.

use serde::{Deserialize, Serialize};

/// A named noise schedule.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ScheduleName {
    /// The released schedule: the first and last variance are those of 1,000 steps, whatever the number of steps. With
    /// 100 steps the noisiest training sample keeps 60 % of its signal, although sampling starts from pure noise
    /// (`algorithms` section 5).
    Official,
    /// Variances scaled by 1000 / steps, so that the last step is almost pure noise.
    Rescaled,
    /// The squared cosine schedule (Nichol and Dhariwal 2021), which spreads its steps evenly over the noise levels.
    /// With 50 steps of a linear schedule, half are nearly pure noise.
    Cosine,
}
