//! Fits the normaliser to a library's motions.

use datasets_spec::{Pose, Split};
use kinematics::KeypointFrame;
use kinematics::canonical::{canonicalise, window_starts};
use kinematics::normalise::Normalizer;
use rayon::prelude::*;

use super::Library;
use crate::config::RangeRule;
use crate::{ComposeConfig, Error};

/// Limit on the windows a normaliser is fitted on. The quantiles of 4.5 million coordinates per axis
/// are accurate to about 1e-4 of the distribution; more windows would only take memory.
const MAX_RANGE_WINDOWS: usize = 10_000;

impl Library {
    /// Fits the normaliser to the canonical windows of the library's motions: at most 10,000, evenly
    /// spaced over all.
    ///
    /// # Errors
    /// The library is not of the training split, no motion is as long as a window, a setting is
    /// out of range, or the motions cannot be read.
    ///
    /// # Source
    /// Paper App. B.2.
    pub fn fit_normalizer(&self, config: &ComposeConfig) -> Result<Normalizer, Error> {
        if self.split != Split::Train {
            return Err(Error::Refused(format!(
                "statistics are fitted on split train alone, the library holds split {}",
                self.split
            )));
        }
        config.check()?;
        let stride = config.stride(self.fps)?;
        let span = config.span(stride);
        let advance = config.advance(stride).max(1);
        let captured = &self.clips[..self.num_captured];
        // Index of the first window of each clip.
        let mut num_windows = 0;
        let first_windows: Vec<usize> = captured
            .iter()
            .map(|clip| {
                let first = num_windows;
                num_windows += window_starts(clip.len(), span, advance).len();
                first
            })
            .collect();
        let num_used = num_windows.min(MAX_RANGE_WINDOWS);
        let frames: Vec<Vec<KeypointFrame>> = (0..num_used)
            .into_par_iter()
            .map(|used| {
                let window = used * num_windows / num_used;
                let clip = first_windows.partition_point(|&first| first <= window) - 1;
                let start = (window - first_windows[clip]) * advance;
                let motion = captured[clip].crop(start..start + span)?;
                let mut window: Vec<Pose> = (0..span)
                    .step_by(stride)
                    .map(|frame| motion.pose(frame))
                    .collect();
                canonicalise(&mut window, config.anchor, &self.skeleton);
                let keypoints = window.iter().map(|pose| self.skeleton.keypoints(pose));
                Ok(keypoints.collect())
            })
            .collect::<Result<_, Error>>()?;
        let frames = frames.concat();
        let fitted = match config.range {
            RangeRule::PerAxis => Normalizer::fit(&frames),
            RangeRule::Scalar => Normalizer::fit_shared(&frames),
        };
        fitted.ok_or(Error::NoItem {
            split: self.split,
            frames: span,
        })
    }
}
