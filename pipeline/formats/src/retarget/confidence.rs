//! How far a guessed skeleton map can be trusted.

use glam::DVec3;
use kinematics::skeleton::NUM_BODY_JOINTS;

use super::align::LIMBS;
use super::joint_map::{Mapping, Origin, hangs_from};
use super::rig::Bone;
use super::track::Track;

/// Confidence below which a guessed map is not used. A body of which only legs and head are named reaches 0.62; a fox
/// with a raised head reaches only 0.5.
pub(super) const LEAST: f64 = 0.6;

/// Factor on the confidence of a map that names do not support.
const NAMELESS: f64 = 0.8;

/// Evidence for a guessed map, each from 0 to 1.
pub(super) struct Evidence {
    /// Share of the body joints that were found.
    found: f64,
    /// Share of the limb bones whose child joint descends from its parent joint in the source too.
    descent: f64,
    /// Similarity of left and right limb lengths.
    symmetry: f64,
    /// How upright the trunk is over the legs.
    posture: f64,
    /// Whether joint names support the mapping.
    named: bool,
}

impl Evidence {
    /// Collects the evidence of the skeleton and its motion. `stands` is true if a rest pose is a standing person.
    pub(super) fn gather(
        mapping: &Mapping,
        bones: &[Bone<'_>],
        track: &Track,
        stands: bool,
    ) -> Self {
        let source_of = |joint: usize| mapping.source_of[joint];
        let found = mapping.source_of.iter().flatten().count() as f64 / NUM_BODY_JOINTS as f64;
        // In every body, the head also descends from the neck.
        let hanging = LIMBS.iter().chain(&[(12, 15)]);
        let descent = mean(hanging.filter_map(|&(joint, child)| {
            let (joint, child) = (source_of(joint)?, source_of(child)?);
            Some(f64::from(u8::from(hangs_from(bones, child, joint))))
        }));
        let points = track.points(0);
        let symmetry = mean(LIMBS.as_chunks::<2>().0.iter().filter_map(|sides| {
            let [left, right] = sides.map(|(joint, child)| {
                let located = track.is_located(joint) && track.is_located(child);
                located.then(|| points[joint].distance(points[child]))
            });
            let (left, right) = (left?, right?);
            Some(likeness(left.min(right) / left.max(right)))
        }));
        Self {
            found,
            descent,
            symmetry,
            posture: if stands { 1.0 } else { straightness(track) },
            named: mapping.origin == Origin::Words,
        }
    }

    /// The confidence, from 0 to 1: 0.6 times the share of joints found, plus 0.2 each times descent and symmetry; all
    /// of this times the posture, and times 0.8 without names.
    pub(super) fn confidence(&self) -> f64 {
        let built = 0.6 * self.found + 0.2 * self.descent + 0.2 * self.symmetry;
        let trust = if self.named { 1.0 } else { NAMELESS };
        built * self.posture * trust
    }

    /// The evidence against the map, as text for a message.
    pub(super) fn doubts(&self, mapping: &Mapping) -> String {
        /// Value below which a piece of evidence is mentioned.
        const WEAK: f64 = 0.7;
        let pieces = [
            (self.posture, "its trunk is not upright over its legs"),
            (self.symmetry, "its left and right limbs differ in length"),
            (self.descent, "its limb joints do not hang from one another"),
        ];
        let weak = pieces.into_iter().filter(|(value, _)| *value < WEAK);
        let mut doubts: Vec<String> = weak.map(|(_, doubt)| doubt.to_owned()).collect();
        let absent = mapping.absent();
        if !absent.is_empty() {
            doubts.push(format!("it has no {}", absent.join(", ")));
        }
        doubts.join("; ")
    }
}

/// 1 for length ratios of 0.9 or more, falling linearly to 0 at 0.5.
fn likeness(ratio: f64) -> f64 {
    const ALIKE: f64 = 0.9;
    const UNLIKE: f64 = 0.5;
    if ratio.is_nan() {
        return 0.0;
    }
    ((ratio - UNLIKE) / (ALIKE - UNLIKE)).clamp(0.0, 1.0)
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0usize), |(sum, count), value| {
        (sum + value, count + 1)
    });
    if count == 0 { 0.0 } else { sum / count as f64 }
}

/// Straightness of the line from ankles over hips to the head: a person who stands, walks or lies is
/// straight, a quadruped is bent by a right angle.
fn straightness(track: &Track) -> f64 {
    /// Mean cosine from which a body counts as straight: people also bow and sit.
    const STRAIGHT: f64 = 0.7;
    let top = if track.is_located(15) { 15 } else { 12 };
    let cosines = (0..track.num_frames()).map(|frame| {
        let points = track.points(frame);
        let middle = |left: usize, right: usize| points[left].midpoint(points[right]);
        let hips = middle(1, 2);
        let trunk: DVec3 = (points[top] - hips).normalize_or_zero();
        trunk.dot((hips - middle(7, 8)).normalize_or_zero())
    });
    (mean(cosines) / STRAIGHT).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_alike_up_to_a_tenth_and_unlike_from_a_half() {
        for (ratio, expected) in [(1.0, 1.0), (0.9, 1.0), (0.7, 0.5), (0.5, 0.0), (0.1, 0.0)] {
            assert!((likeness(ratio) - expected).abs() < 1e-12, "{ratio}");
        }
        assert_eq!(likeness(f64::NAN), 0.0, "limbs without length");
    }

    #[test]
    fn confidence_weighs_the_evidence_as_stated() {
        let all = |found: f64, posture: f64, named: bool| Evidence {
            found,
            descent: 1.0,
            symmetry: 1.0,
            posture,
            named,
        };
        assert!((all(1.0, 1.0, true).confidence() - 1.0).abs() < 1e-12);
        assert!((all(1.0, 1.0, false).confidence() - 0.8).abs() < 1e-12);
        // Legs and a head are enough, a body on all fours is not.
        assert!(all(8.0 / 22.0, 1.0, true).confidence() > LEAST);
        assert!(all(1.0, 0.2, true).confidence() < LEAST);
    }
}
