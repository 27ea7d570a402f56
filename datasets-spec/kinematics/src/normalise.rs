//! The normaliser: scales canonical keypoints to the range a network works in.

use serde::{Deserialize, Serialize};

use crate::pose::KeypointFrame;
use crate::skeleton::NUM_KEYPOINTS;

/// Numbers of a normalised frame: 28 keypoints times 3.
pub const FRAME_WIDTH: usize = 3 * NUM_KEYPOINTS;

/// A frame of canonical keypoints in model units, `[84]`: x, y and z of each keypoint.
///
/// Keypoints in metres have the type [`KeypointFrame`], so they cannot be passed to a network by mistake.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NormalizedFrame([f32; FRAME_WIDTH]);

impl NormalizedFrame {
    /// Takes the output of a network, or a frame of a recorded window.
    ///
    /// # Panics
    /// If there are not 84 numbers.
    pub fn from_model_units(values: &[f32]) -> Self {
        Self(values.try_into().expect("a frame has 84 numbers"))
    }
}

impl IntoIterator for NormalizedFrame {
    type Item = f32;
    type IntoIter = std::array::IntoIter<f32, FRAME_WIDTH>;

    fn into_iter(self) -> Self::IntoIter {
        self.0.into_iter()
    }
}

/// Scales each axis linearly so that `min` becomes -1 and `max` becomes 1, alike for all joints
/// and frames. Metres in, model units out.
///
/// # Source
/// Paper App. B.2.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Normalizer {
    /// Lower end per axis in metres.
    pub min: [f64; 3],
    /// Upper end per axis in metres.
    pub max: [f64; 3],
}

impl Normalizer {
    /// The share of the data inside the range; half of the rest lies on either side, outside [-1, 1].
    pub const KEPT_SHARE: f64 = 0.95;

    /// Fits the range of each axis to the central 95 % of canonical training frames. `None` if there
    /// is no frame. An axis on which nothing moves gets a range of 1 mm instead of a division by
    /// zero.
    pub fn fit<'a>(frames: impl IntoIterator<Item = &'a KeypointFrame>) -> Option<Self> {
        let mut axes: [Vec<f64>; 3] = [Vec::new(), Vec::new(), Vec::new()];
        for point in frames.into_iter().flatten() {
            for (axis, value) in axes.iter_mut().zip(point.to_array()) {
                axis.push(value);
            }
        }
        let mut normalizer = Self {
            min: [0.0; 3],
            max: [0.0; 3],
        };
        for (i, axis) in axes.iter_mut().enumerate() {
            (normalizer.min[i], normalizer.max[i]) = central_range(axis)?;
        }
        Some(normalizer)
    }

    /// Fits one range for all axes to the central 95 % of all coordinates, as the released files appear to be made.
    /// `None` if there is no frame.
    pub fn fit_shared<'a>(frames: impl IntoIterator<Item = &'a KeypointFrame>) -> Option<Self> {
        let points = frames.into_iter().flatten();
        let mut values: Vec<f64> = points.flat_map(|point| point.to_array()).collect();
        let (min, max) = central_range(&mut values)?;
        Some(Self {
            min: [min; 3],
            max: [max; 3],
        })
    }

    /// BLAKE3 of the ranges, in hexadecimal.
    pub fn hash(&self) -> String {
        let mut hasher = blake3::Hasher::new();
        for end in self.min.iter().chain(&self.max) {
            hasher.update(&end.to_le_bytes());
        }
        hasher.finalize().to_hex().to_string()
    }

    /// Metres to model units.
    pub fn normalize(&self, frame: &KeypointFrame) -> NormalizedFrame {
        let mut out = [0.0; FRAME_WIDTH];
        for (slot, point) in out.chunks_exact_mut(3).zip(frame) {
            for (axis, value) in point.to_array().into_iter().enumerate() {
                let range = self.max[axis] - self.min[axis];
                slot[axis] = (-1.0 + 2.0 * (value - self.min[axis]) / range) as f32;
            }
        }
        NormalizedFrame(out)
    }

    /// Model units to metres.
    pub fn denormalize(&self, NormalizedFrame(frame): &NormalizedFrame) -> KeypointFrame {
        std::array::from_fn(|slot| {
            glam::DVec3::from_array(std::array::from_fn(|axis| {
                let value = f64::from(frame[3 * slot + axis]);
                (value + 1.0) / 2.0 * (self.max[axis] - self.min[axis]) + self.min[axis]
            }))
        })
    }
}

/// The range of the central [`Normalizer::KEPT_SHARE`] of the values, at least a millimetre wide.
fn central_range(values: &mut [f64]) -> Option<(f64, f64)> {
    values.sort_by(f64::total_cmp);
    let last = values.len().checked_sub(1)?;
    let cut = ((1.0 - Normalizer::KEPT_SHARE) / 2.0 * last as f64).round() as usize;
    let (min, max) = (values[cut], values[last - cut]);
    Some(if max - min < 1e-3 {
        (min - 5e-4, max + 5e-4)
    } else {
        (min, max)
    })
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    #[test]
    fn the_range_keeps_95_percent() {
        let frames: Vec<KeypointFrame> = (0..=1000)
            .map(|i| [DVec3::new(f64::from(i), 0.0, -f64::from(i)); NUM_KEYPOINTS])
            .collect();
        let range = Normalizer::fit(&frames).expect("frames");
        assert!((range.min[0] - 25.0).abs() <= 1.0 && (range.max[0] - 975.0).abs() <= 1.0);
        assert!(range.max[1] > range.min[1], "a still axis keeps a range");
        assert!(Normalizer::fit(&[]).is_none());
    }

    #[test]
    fn scaling_there_and_back_is_the_identity() {
        let range = Normalizer {
            min: [-1.0, 0.0, -2.0],
            max: [1.0, 2.0, 3.0],
        };
        let frame: KeypointFrame = std::array::from_fn(|i| DVec3::splat(i as f64 * 0.1 - 1.0));
        let back = range.denormalize(&range.normalize(&frame));
        for (a, b) in frame.iter().zip(back) {
            // One rounding to f32 of a value up to 2 in model units, times a half range of 2.5 m.
            assert!((*a - b).abs().max_element() < 1e-6);
        }
    }
}
