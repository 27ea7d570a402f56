//! The normaliser that a library's motions fit.

use datasets_spec::{Pose, Split};
use kinematics::KeypointFrame;
use kinematics::canonical::{canonicalise, window_starts};
use kinematics::normalise::Normalizer;
use rayon::prelude::*;

use super::{Clip, Library};
use crate::compose::config::RangeRule;
use crate::compose::{ComposeConfig, Error};

/// Limit on the windows a normaliser is fitted on. The quantiles of 13 million coordinates per axis
/// are accurate to about 1e-4 of the distribution; more windows would only take memory.
const MAX_RANGE_WINDOWS: usize = 10_000;

impl Library {
    /// Fits the normaliser to the canonical windows of the library's motions: at most 10,000, evenly
    /// spaced over all.
    ///
    /// # Errors
    /// The library is not of the training split, no motion is as long as a window, or a setting is
    /// out of range.
    ///
    /// # Source
    /// Paper App. B.2.
    pub fn fit_normalizer(&self, config: &ComposeConfig) -> Result<Normalizer, Error> {
        if self.split != Split::Train {
            return Err(Error::NotTrain { split: self.split });
        }
        config.check()?;
        let stride = config.stride(self.fps)?;
        let span = config.span(stride);
        let windows: Vec<(usize, usize)> = self
            .clips
            .iter()
            .enumerate()
            .filter(|(_, clip)| clip.in_base)
            .flat_map(|(clip, Clip { motion, .. })| {
                window_starts(motion.len(), span, config.advance(stride))
                    .into_iter()
                    .map(move |start| (clip, start))
            })
            .collect();
        let num_used = windows.len().min(MAX_RANGE_WINDOWS);
        let frames: Vec<KeypointFrame> = (0..num_used)
            .into_par_iter()
            .flat_map_iter(|used| {
                let (clip, start) = windows[used * windows.len() / num_used];
                let motion = &self.clips[clip].motion;
                let mut window: Vec<Pose> = (start..start + span)
                    .step_by(stride)
                    .map(|frame| motion.pose(frame))
                    .collect();
                canonicalise(&mut window, config.anchor, &self.skeleton);
                window
                    .into_iter()
                    .map(|pose| self.skeleton.keypoints(&pose))
                    .collect::<Vec<_>>()
            })
            .collect();
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
