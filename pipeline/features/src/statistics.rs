//! Mean and standard deviation of features, in the format of published feature folders.

use std::ops::Range;

/// Running mean and variance of every feature. The statistics of two sets of frames can be merged.
#[derive(Clone, Debug, PartialEq)]
pub struct Statistics<const WIDTH: usize> {
    frames: u64,
    mean: Vec<f64>,
    /// Sum of squared distances to the mean.
    scatter: Vec<f64>,
}

impl<const WIDTH: usize> Default for Statistics<WIDTH> {
    fn default() -> Self {
        Self {
            frames: 0,
            mean: vec![0.0; WIDTH],
            scatter: vec![0.0; WIDTH],
        }
    }
}

impl<const WIDTH: usize> Statistics<WIDTH> {
    /// Adds the frames of a clip, by Welford's update.
    pub fn take(&mut self, features: &[[f32; WIDTH]]) {
        for frame in features {
            self.frames += 1;
            let columns = self.mean.iter_mut().zip(&mut self.scatter);
            for ((mean, scatter), value) in columns.zip(frame) {
                let before = f64::from(*value) - *mean;
                *mean += before / self.frames as f64;
                *scatter += before * (f64::from(*value) - *mean);
            }
        }
    }

    /// Merges another set of frames.
    pub fn merge(&mut self, other: &Self) {
        let frames = self.frames + other.frames;
        if frames == 0 {
            return;
        }
        let share = other.frames as f64 / frames as f64;
        for column in 0..WIDTH {
            let apart = other.mean[column] - self.mean[column];
            self.mean[column] += apart * share;
            self.scatter[column] +=
                other.scatter[column] + apart * apart * self.frames as f64 * share;
        }
        self.frames = frames;
    }

    /// Number of frames.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// The mean of each feature.
    pub fn mean(&self) -> [f32; WIDTH] {
        std::array::from_fn(|column| self.mean[column] as f32)
    }

    /// The standard deviation of each feature; each feature of a group gets the mean over the group, as in the
    /// published `Std.npy` of HumanML3D.
    pub fn std_by(&self, groups: &[(&str, Range<usize>)]) -> [f32; WIDTH] {
        let deviation = |column: usize| (self.scatter[column] / self.frames.max(1) as f64).sqrt();
        let mut std = std::array::from_fn(|column| deviation(column) as f32);
        for (_, range) in groups {
            let mean = range.clone().map(deviation).sum::<f64>() / range.len() as f64;
            std[range.clone()].fill(mean as f32);
        }
        std
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::humanml3d::{self, Features};
    use crate::representation_272;

    fn frames(count: usize, from: usize) -> Vec<Features> {
        (from..from + count)
            .map(|frame| std::array::from_fn(|column| ((frame * 7 + column) as f32 * 0.37).sin()))
            .collect()
    }

    #[test]
    fn mean_and_deviation_are_those_of_all_frames() {
        let all = frames(50, 0);
        let mut whole = Statistics::default();
        whole.take(&all);
        for column in [0, 5, 262] {
            let mean = all.iter().map(|f| f64::from(f[column])).sum::<f64>() / 50.0;
            assert!((f64::from(whole.mean()[column]) - mean).abs() < 1e-6);
        }
        // The root height is a group of one, so its deviation is its own.
        let mean = f64::from(whole.mean()[3]);
        let squares = all.iter().map(|f| (f64::from(f[3]) - mean).powi(2));
        let variance = squares.sum::<f64>() / 50.0;
        let std = whole.std_by(&humanml3d::GROUPS);
        assert!((f64::from(std[3]) - variance.sqrt()).abs() < 1e-6);
        assert_eq!(std[4], std[66]);
    }

    #[test]
    fn parts_merge_to_the_whole_in_any_cut() {
        let all = frames(60, 3);
        let mut whole = Statistics::default();
        whole.take(&all);
        for cut in [0, 1, 29, 60] {
            let (mut left, mut right) = (Statistics::default(), Statistics::default());
            left.take(&all[..cut]);
            right.take(&all[cut..]);
            left.merge(&right);
            assert_eq!(left.frames(), 60);
            let pairs = [
                (left.mean(), whole.mean()),
                (
                    left.std_by(&humanml3d::GROUPS),
                    whole.std_by(&humanml3d::GROUPS),
                ),
            ];
            for (found, expected) in pairs {
                for (a, b) in found.iter().zip(expected) {
                    assert!((a - b).abs() < 1e-6, "{cut}: {a} and {b}");
                }
            }
        }
    }

    #[test]
    fn the_deviation_is_averaged_inside_the_groups_alone() {
        const WIDTH: usize = representation_272::WIDTH;
        let frames: Vec<[f32; WIDTH]> = (0..40u8)
            .map(|frame| {
                let sign = if frame % 2 == 0 { 1.0 } else { -1.0 };
                // The standard deviation of each column is its index.
                std::array::from_fn(|column| 5.0 + sign * column as f32)
            })
            .collect();
        let mut statistics = Statistics::default();
        statistics.take(&frames);
        let found = statistics.std_by(&representation_272::GROUPS);
        for (name, range) in representation_272::GROUPS {
            let mean = (range.start + range.end - 1) as f32 / 2.0;
            for column in range {
                assert!((found[column] - mean).abs() < 1e-4, "{name}, {column}");
            }
        }
        let own = statistics.std_by(&[]);
        assert!((own[9] - 9.0).abs() < 1e-5 && (own[271] - 271.0).abs() < 1e-4);
        let means = statistics.mean();
        assert!(means.iter().all(|mean| (mean - 5.0).abs() < 1e-4));
    }
}
