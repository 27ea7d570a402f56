//! The metrics, each a pure function of latents or positions.

pub mod diversity;
pub mod fid;
pub mod foot_score;
pub mod interval;
pub mod matching;
pub mod motion_quality;
pub mod multimodality;
pub mod position_error;
pub mod retrieval;

use std::fmt;

use datasets_spec::Rng;
use rand::RngExt;

use crate::Error;
use crate::linalg::Matrix;

/// A number of the result table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Metric {
    /// Fréchet distance of latents scaled to unit length.
    FidUnit,
    /// Fréchet distance of latents as the encoder gives them.
    FidRaw,
    /// Mean distance of latents paired at random.
    Diversity,
    /// DIMOS contact score.
    FootScore,
    /// Edits retrieved by their originals: share among the first k, in percent.
    SourceRecall(u8),
    /// Edits retrieved by their originals: mean rank.
    SourceAverageRank,
    /// Edits retrieved by their targets: share among the first k, in percent.
    TargetRecall(u8),
    /// Edits retrieved by their targets: mean rank.
    TargetAverageRank,
    /// Edits retrieved by their originals: median rank.
    SourceMedianRank,
    /// Edits retrieved by their targets: median rank.
    TargetMedianRank,
    /// Mean distance of latents of one item, generated from several seeds.
    Multimodality,
    /// Mean distance to the keypoints of the target, in centimetres.
    PositionError,
    /// Mean distance of generated keypoints from the body fitted to them, in centimetres.
    FitError,
    /// Mean difference of generated bones from their lengths in the body, in centimetres.
    BoneDrift,
    /// Share of windows that a coordinator takes for composed of several motions, in percent.
    Composed,
    /// Mean acceleration of the keypoints where one generated window ends and the next begins, in
    /// m/s²; for motions that were not generated, at the same frames.
    SeamAcceleration,
    /// Mean acceleration of the keypoints at all other frames, in m/s².
    InsideAcceleration,
    /// Mean jerk of the keypoints, in m/s³.
    Jerk,
    /// Mean speed of feet that touch the floor, in m/s.
    ContactSlide,
    /// Largest turn of a joint from one frame to the next, in degrees.
    RotationStep,
}

/// Which values of a metric are good.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Better {
    /// Small ones.
    Lower,
    /// Large ones.
    Higher,
    /// Those near the value of the real data.
    NearReal,
}

impl Better {
    /// The arrow the paper's tables use.
    pub fn arrow(self) -> char {
        match self {
            Self::Lower => '↓',
            Self::Higher => '↑',
            Self::NearReal => '→',
        }
    }
}

impl Metric {
    /// All metrics in the order of the paper's Table 1, those it lacks last.
    pub const ALL: [Metric; 24] = [
        Metric::FidUnit,
        Metric::Diversity,
        Metric::FootScore,
        Metric::SourceRecall(1),
        Metric::SourceRecall(2),
        Metric::SourceRecall(3),
        Metric::SourceAverageRank,
        Metric::TargetRecall(1),
        Metric::TargetRecall(2),
        Metric::TargetRecall(3),
        Metric::TargetAverageRank,
        Metric::FidRaw,
        Metric::SourceMedianRank,
        Metric::TargetMedianRank,
        Metric::Multimodality,
        Metric::PositionError,
        Metric::FitError,
        Metric::BoneDrift,
        Metric::Composed,
        Metric::SeamAcceleration,
        Metric::InsideAcceleration,
        Metric::Jerk,
        Metric::ContactSlide,
        Metric::RotationStep,
    ];

    /// The columns of the paper's Table 1.
    pub const PAPER: &'static [Metric] = Self::ALL.split_at(11).0;

    /// The columns the paper does not print.
    pub const FURTHER: &'static [Metric] = Self::ALL.split_at(11).1.split_at(8).0;

    /// How motions move, whatever they show: a table of its own.
    pub const QUALITY: &'static [Metric] = Self::ALL.split_at(19).1;

    /// The name in the table of scores.
    pub fn name(self) -> &'static str {
        match self {
            Self::FidUnit => "FID",
            Self::FidRaw => "FID (raw)",
            Self::Diversity => "Diversity",
            Self::FootScore => "FS",
            Self::SourceRecall(1) => "E2S R@1",
            Self::SourceRecall(2) => "E2S R@2",
            Self::SourceRecall(_) => "E2S R@3",
            Self::SourceAverageRank => "E2S AvgR",
            Self::TargetRecall(1) => "E2T R@1",
            Self::TargetRecall(2) => "E2T R@2",
            Self::TargetRecall(_) => "E2T R@3",
            Self::TargetAverageRank => "E2T AvgR",
            Self::SourceMedianRank => "E2S MedR",
            Self::TargetMedianRank => "E2T MedR",
            Self::Multimodality => "Multimodality",
            Self::PositionError => "Position error (cm)",
            Self::FitError => "Fit error (cm)",
            Self::BoneDrift => "Bone drift (cm)",
            Self::Composed => "Composed (%)",
            Self::SeamAcceleration => "Acceleration at seams (m/s²)",
            Self::InsideAcceleration => "inside (m/s²)",
            Self::Jerk => "Jerk (m/s³)",
            Self::ContactSlide => "Contact slide (m/s)",
            Self::RotationStep => "Largest turn (°/frame)",
        }
    }

    /// The metric of a name in the table of scores.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|metric| metric.name() == name)
    }

    /// Which values are good for a kind of edit.
    ///
    /// # Source
    /// Table 1 (body parts, style) asks E2S to be close to the real row: an edit that keeps the
    /// original too well has not edited it. Table A1 (fine-grained) and Table 2 ask for more.
    pub fn better(self, task: &str) -> Better {
        match self {
            Self::FidUnit
            | Self::FidRaw
            | Self::TargetAverageRank
            | Self::TargetMedianRank
            | Self::PositionError
            | Self::FitError
            | Self::BoneDrift => Better::Lower,
            Self::FootScore | Self::TargetRecall(_) | Self::Multimodality => Better::Higher,
            Self::Diversity
            | Self::Composed
            | Self::SeamAcceleration
            | Self::InsideAcceleration
            | Self::Jerk
            | Self::ContactSlide
            | Self::RotationStep => Better::NearReal,
            Self::SourceRecall(_) if KEEPING.contains(&task) => Better::Higher,
            Self::SourceAverageRank | Self::SourceMedianRank if KEEPING.contains(&task) => {
                Better::Lower
            }
            Self::SourceRecall(_) | Self::SourceAverageRank | Self::SourceMedianRank => {
                Better::NearReal
            }
        }
    }

    /// Digits after the point that tables print: enough to tell systems apart in the paper.
    pub fn decimals(self) -> usize {
        match self {
            Self::FidUnit | Self::FootScore | Self::ContactSlide => 3,
            Self::Jerk | Self::RotationStep => 1,
            Self::FidRaw
            | Self::Diversity
            | Self::SourceRecall(_)
            | Self::SourceAverageRank
            | Self::TargetRecall(_)
            | Self::TargetAverageRank
            | Self::SourceMedianRank
            | Self::TargetMedianRank
            | Self::Multimodality
            | Self::PositionError
            | Self::FitError
            | Self::BoneDrift
            | Self::Composed
            | Self::SeamAcceleration
            | Self::InsideAcceleration => 2,
        }
    }
}

impl fmt::Display for Metric {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Kinds of edit that keep most of their original.
const KEEPING: [&str; 2] = ["fine-grained", "motionfix"];

/// Draws distinct positions below `size` in random order.
///
/// # Panics
/// If more are asked for than there are.
pub fn draw_without_replacement(size: usize, count: usize, rng: &mut Rng) -> Vec<usize> {
    assert!(
        count <= size,
        "cannot draw {count} of {size} without replacement"
    );
    let mut indices: Vec<usize> = (0..size).collect();
    for drawn in 0..count {
        let other = rng.random_range(drawn..size);
        indices.swap(drawn, other);
    }
    indices.truncate(count);
    indices
}

/// Refuses rows that hold a NaN or an infinity, which would spread silently through a metric.
fn check_finite(metric: &'static str, rows: &Matrix) -> Result<(), Error> {
    match rows
        .rows()
        .position(|row| row.iter().any(|value| !value.is_finite()))
    {
        Some(row) => Err(Error::NotFinite { metric, row }),
        None => Ok(()),
    }
}

/// Refuses two sizes that ought to be equal.
fn check_size(
    metric: &'static str,
    what: &'static str,
    found: usize,
    expected: usize,
) -> Result<(), Error> {
    if found == expected {
        Ok(())
    } else {
        Err(Error::Size {
            metric,
            what,
            found,
            expected,
        })
    }
}

/// The Euclidean distance of two latents.
fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter()
        .zip(b)
        .map(|(a, b)| (a - b) * (a - b))
        .sum::<f64>()
        .sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_and_found_again() {
        for metric in Metric::ALL {
            assert_eq!(Metric::from_name(metric.name()), Some(metric));
        }
        assert_eq!(Metric::from_name("FVD"), None);
        assert_eq!(
            [Metric::PAPER, Metric::FURTHER, Metric::QUALITY].concat(),
            Metric::ALL
        );
    }

    #[test]
    fn only_fine_grained_edits_are_asked_to_stay_near_their_originals() {
        let recall = Metric::SourceRecall(1);
        assert_eq!(recall.better("fine-grained"), Better::Higher);
        assert_eq!(recall.better("motionfix"), Better::Higher);
        assert_eq!(recall.better("style"), Better::NearReal);
        assert_eq!(
            Metric::SourceAverageRank.better("fine-grained"),
            Better::Lower
        );
    }
}
