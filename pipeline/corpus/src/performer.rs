//! Performers: who plays a take, and the traits of each.

use datasets_spec::Seed;
use rand::RngExt;

use super::style::Style;

/// Number of consecutive takes by one performer.
const TAKES_PER_PERFORMER: usize = 2;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Performer(usize);

impl Performer {
    pub(super) fn of_take(take: usize) -> Self {
        Self(take / TAKES_PER_PERFORMER)
    }

    pub(super) fn name(self) -> String {
        format!("performer-{}", self.0 + 1)
    }

    /// Adapts a style to this performer: tempo, size and posture change by amounts drawn once per performer, smaller
    /// than the differences between styles. The first performer plays the style unchanged.
    pub(super) fn plays(self, style: &Style, seed: Seed) -> Style {
        if self.0 == 0 {
            return *style;
        }
        let mut rng = seed.rng(&["corpus", "performer", &self.0.to_string()]);
        // Tempo and size differ clearly from neutral: a performer who moves like the first one would test nothing new.
        let mut factor = |least: f64, most: f64| {
            let factor = rng.random_range(least..most);
            if rng.random_bool(0.5) {
                factor
            } else {
                1.0 / factor
            }
        };
        let (tempo, amplitude, stride) = (factor(1.06, 1.15), factor(1.1, 1.25), factor(1.03, 1.1));
        let mut shift = |most: f64| rng.random_range(-most..most);
        Style {
            tempo: style.tempo * tempo,
            stride: style.stride * stride,
            amplitude: style.amplitude * amplitude,
            arm_swing: style.arm_swing * amplitude,
            lean: style.lean + shift(0.04),
            head_down: style.head_down + shift(0.04),
            arms_out: style.arms_out + shift(0.04),
            elbow_bend: style.elbow_bend + shift(0.1),
            ..*style
        }
    }
}
