//! Animation curves: keys, interpolation, and the rate to sample at.

use datasets_spec::Fps;
use glam::{DQuat, DVec3, DVec4};
use gltf::json;
use gltf::json::accessor::Type;
use gltf::json::animation::Interpolation;
use gltf::json::validation::Checked;
use kinematics::rotation::slerp;

use super::document::{Document, accessor_error};
use super::nodes::unit;
use crate::source::format::plausible_fps;
use clip::Rejected;

/// Rate in 1/s at which unevenly spaced keys are sampled; the most common rate of animations.
pub(super) const DEFAULT_FPS: f64 = 30.0;
/// Lowest rate in 1/s of evenly spaced keys that counts as a frame rate: sparser keys, such as two poses a second, are
/// set by an animator.
const MIN_KEY_RATE: f64 = 10.0;
/// Tolerance, in grid steps, for a key to count as on an even grid. Times are stored as `f32`, which after an hour
/// rounds them by up to 0.004 frames at 30 fps.
pub(super) const ON_GRID: f64 = 0.02;

/// Reads key times in seconds, which must ascend.
fn read_times(document: &Document, accessor: usize) -> Result<Vec<f64>, Rejected> {
    let wrong = |reason: String| Rejected::read("E-GLTF-TIME", reason);
    let times: Vec<[f64; 1]> = document
        .elements(accessor, Type::Scalar)
        .map_err(|rejected| match rejected.code {
            "E-NOT-FINITE" => wrong(format!(
                "accessor {accessor} holds a time that is no number"
            )),
            _ => rejected,
        })?;
    let times = times.into_flattened();
    if times.is_empty() {
        let reason = format!("accessor {accessor} holds no times, expected at least one");
        return Err(wrong(reason));
    }
    if let Some(at) = times.windows(2).position(|pair| pair[1] <= pair[0]) {
        return Err(wrong(format!(
            "key {} at {} s is not after the one at {} s",
            at + 1,
            times[at + 1],
            times[at]
        )));
    }
    Ok(times)
}

/// Properties of an animation's key times that determine its frame rate.
pub(super) struct Grid {
    pub(super) start: f64,
    pub(super) end: f64,
    /// Number of keys of the channel with the most keys.
    num_keys: usize,
    /// Rate in 1/s of the channel with the most keys, if they are evenly spaced.
    key_rate: Option<f64>,
}

impl Grid {
    pub(super) fn of(times: &[f64]) -> Self {
        let (start, end) = (times[0], times[times.len() - 1]);
        let step = (end - start) / (times.len().max(2) - 1) as f64;
        let even = times
            .iter()
            .enumerate()
            .all(|(key, time)| ((time - start) / step - key as f64).abs() <= ON_GRID);
        Self {
            start,
            end,
            num_keys: times.len(),
            key_rate: (even && step > 0.0).then(|| 1.0 / step),
        }
    }

    pub(super) fn with(self, times: &[f64]) -> Self {
        let other = Self::of(times);
        let (start, end) = (self.start.min(other.start), self.end.max(other.end));
        let main = if other.num_keys > self.num_keys {
            other
        } else {
            self
        };
        Self { start, end, ..main }
    }

    /// The rate to sample at, and whether it is the rate of the keys.
    pub(super) fn rate(&self) -> (Fps, bool) {
        let of_keys = self.key_rate.filter(|rate| *rate >= MIN_KEY_RATE);
        match of_keys.and_then(plausible_fps) {
            Some(fps) => (fps, true),
            None => (Fps::new(DEFAULT_FPS).expect("30 fps is a rate"), false),
        }
    }

    pub(super) fn num_frames(&self, fps: Fps) -> f64 {
        ((self.end - self.start) * fps.get() + ON_GRID).floor() + 1.0
    }
}

/// A property of a bone over time.
pub(super) struct Curve<const N: usize> {
    pub(super) times: Vec<f64>,
    /// One value per key, or three for splines: in-tangent, value, out-tangent.
    pub(super) values: Vec<[f64; N]>,
    pub(super) interpolation: Interpolation,
}

impl<const N: usize> Curve<N> {
    pub(super) fn read(
        document: &Document,
        sampler: &json::animation::Sampler,
        kind: Type,
    ) -> Result<Self, Rejected> {
        let times = read_times(document, sampler.input.value())?;
        let Checked::Valid(interpolation) = sampler.interpolation else {
            let reason = "found an unknown interpolation, expected LINEAR, STEP or CUBICSPLINE";
            return Err(Rejected::read("E-GLTF-SYNTAX", reason));
        };
        let values: Vec<[f64; N]> = document.elements(sampler.output.value(), kind)?;
        let per_key = match interpolation {
            Interpolation::CubicSpline => 3,
            _ => 1,
        };
        if values.len() != times.len() * per_key {
            return Err(accessor_error(format!(
                "found {} values for {} keys, expected {per_key} a key",
                values.len(),
                times.len()
            )));
        }
        Ok(Self {
            times,
            values,
            interpolation,
        })
    }

    /// The value at a time in seconds, made from numbers by `made`, and between two keys by `lerp`. A key less than
    /// `slack` seconds ahead counts as reached.
    fn at<T>(
        &self,
        (time, slack): (f64, f64),
        made: impl Fn([f64; N]) -> T,
        lerp: impl Fn(T, T, f64) -> T,
    ) -> T {
        let per_key = self.values.len() / self.times.len();
        let value = |key: usize| self.values[key * per_key + per_key / 2];
        let next = self.times.partition_point(|&key| key <= time + slack);
        let Some(last) = next.checked_sub(1) else {
            return made(value(0));
        };
        if next == self.times.len() || self.interpolation == Interpolation::Step {
            return made(value(last));
        }
        let span = self.times[next] - self.times[last];
        let u = ((time - self.times[last]) / span).clamp(0.0, 1.0);
        if self.interpolation == Interpolation::Linear {
            return lerp(made(value(last)), made(value(next)), u);
        }
        let (u2, u3) = (u * u, u * u * u);
        let weights = [
            2.0 * u3 - 3.0 * u2 + 1.0,
            span * (u3 - 2.0 * u2 + u),
            3.0 * u2 - 2.0 * u3,
            span * (u3 - u2),
        ];
        let terms = [
            value(last),
            self.values[last * per_key + 2],
            value(next),
            self.values[next * per_key],
        ];
        made(std::array::from_fn(|i| {
            weights
                .iter()
                .zip(&terms)
                .map(|(w, term)| w * term[i])
                .sum()
        }))
    }
}

impl Curve<3> {
    pub(super) fn vector(&self, time: f64, slack: f64) -> DVec3 {
        self.at((time, slack), DVec3::from_array, DVec3::lerp)
    }
}

impl Curve<4> {
    pub(super) fn rotation(&self, time: f64, slack: f64) -> DQuat {
        let unit = |value| unit(DVec4::from_array(value));
        self.at((time, slack), unit, slerp)
    }
}

/// The animated properties of a bone.
#[derive(Default)]
pub(super) struct Curves {
    pub(super) translation: Option<Curve<3>>,
    pub(super) rotation: Option<Curve<4>>,
    pub(super) scale: Option<Curve<3>>,
}
