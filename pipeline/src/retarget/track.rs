//! The joints of a source that matter to the body, frame by frame.

use datasets_spec::skeleton::NUM_BODY_JOINTS;
use glam::{DQuat, DVec3};

use super::joint_map::Mapping;
use crate::source::Rejected;
use crate::source::bvh::{Bvh, Channel};

/// Global rotations and positions of the mapped joints of a source, in its own unit.
pub(super) struct Track {
    source_of: [Option<usize>; NUM_BODY_JOINTS],
    located: [bool; NUM_BODY_JOINTS],
    rotations: Vec<[DQuat; NUM_BODY_JOINTS]>,
    points: Vec<[DVec3; NUM_BODY_JOINTS]>,
    zero_points: [DVec3; NUM_BODY_JOINTS],
    leg_length: f64,
}

/// Largest coordinate followed, in the file's unit: anything beyond is not a motion and would
/// overflow on the way.
const MAX_COORDINATE: f64 = 1e9;

/// Joints of each foot, and the ankle whose end site stands in where a skeleton has no foot joint.
const FOOT_OF_ANKLE: [(usize, usize); 2] = [(7, 10), (8, 11)];

impl Track {
    /// Follows the mapped joints of a file from a frame on.
    ///
    /// # Errors
    /// `E-NOT-FINITE` if a joint leaves the numbers, `E-BVH-SKELETON` if the legs have no length.
    pub(super) fn follow(
        bvh: &Bvh,
        mapping: &Mapping,
        first_frame: usize,
    ) -> Result<Self, Rejected> {
        let joints = bvh.joints();
        let num_frames = bvh.num_frames() - first_frame;
        // Each body joint is a point of a source joint: its origin, or its end site.
        let mut anchors = mapping
            .source_of
            .map(|source| source.map(|source| (source, DVec3::ZERO)));
        for (ankle, foot) in FOOT_OF_ANKLE {
            let end_site = mapping.source_of[ankle]
                .and_then(|source| Some((source, joints[source].end_site?)))
                .filter(|(_, offset)| *offset != DVec3::ZERO);
            anchors[foot] = anchors[foot].or(end_site);
        }
        let mut track = Self {
            source_of: mapping.source_of,
            located: anchors.map(|anchor| anchor.is_some()),
            rotations: Vec::with_capacity(num_frames),
            points: Vec::with_capacity(num_frames),
            zero_points: [DVec3::ZERO; NUM_BODY_JOINTS],
            leg_length: 0.0,
        };

        let mut global = vec![(DVec3::ZERO, DQuat::IDENTITY); joints.len()];
        let mut local_sums = vec![DVec3::ZERO; joints.len()];
        for frame_index in first_frame..bvh.num_frames() {
            let frame = bvh.frame(frame_index);
            for (index, joint) in joints.iter().enumerate() {
                let (position, rotation) = joint.local(frame);
                local_sums[index] += position;
                global[index] = match joint.parent {
                    Some(parent) => {
                        let (parent_position, parent_rotation) = global[parent];
                        (
                            parent_position + parent_rotation * position,
                            (parent_rotation * rotation).normalize(),
                        )
                    }
                    None => (position, rotation),
                };
            }
            let rotations = mapping
                .source_of
                .map(|source| source.map_or(DQuat::IDENTITY, |source| global[source].1));
            let points = anchors.map(|anchor| {
                anchor.map_or(DVec3::ZERO, |(source, offset)| {
                    global[source].0 + global[source].1 * offset
                })
            });
            let usable = |point: &DVec3| point.abs().max_element() < MAX_COORDINATE;
            if !points.iter().all(|p| p.is_finite() && usable(p))
                || !rotations.iter().all(|q| q.is_finite())
            {
                return Err(Rejected::retarget(
                    "E-NOT-FINITE",
                    format!(
                        "found a joint beyond {MAX_COORDINATE:e} units in frame {frame_index}, \
                         expected a body"
                    ),
                ));
            }
            track.rotations.push(rotations);
            track.points.push(points);
        }

        // In the zero pose every rotation is zero; where the file moves a joint against its parent,
        // the mean of what it does stands for the offset.
        let mut zero = vec![DVec3::ZERO; joints.len()];
        for (index, joint) in joints.iter().enumerate() {
            if let Some(parent) = joint.parent {
                let moves = joint
                    .channels
                    .iter()
                    .any(|channel| matches!(channel, Channel::Position(_)));
                zero[index] = zero[parent]
                    + if moves {
                        local_sums[index] / num_frames as f64
                    } else {
                        joint.offset
                    };
            }
        }
        track.zero_points = anchors
            .map(|anchor| anchor.map_or(DVec3::ZERO, |(source, offset)| zero[source] + offset));

        track.leg_length = track
            .points
            .iter()
            .map(|points| leg_length(|joint| points[joint]))
            .sum::<f64>()
            / num_frames as f64;
        if track.leg_length < 1e-6 {
            return Err(Rejected::retarget(
                "E-BVH-SKELETON",
                format!("found legs of length {}, expected bones", track.leg_length),
            ));
        }
        Ok(track)
    }

    /// Turns the whole track.
    pub(super) fn turn(&mut self, turn: DQuat) {
        for rotations in &mut self.rotations {
            for rotation in rotations {
                *rotation = turn * *rotation;
            }
        }
        for points in &mut self.points {
            for point in points {
                *point = turn * *point;
            }
        }
    }

    /// Number of frames, at least one.
    pub(super) fn num_frames(&self) -> usize {
        self.points.len()
    }

    /// Whether the source has this body joint.
    pub(super) fn is_mapped(&self, joint: usize) -> bool {
        self.source_of[joint].is_some()
    }

    /// Whether the source tells where this body joint is: it has the joint, or an end site there.
    pub(super) fn is_located(&self, joint: usize) -> bool {
        self.located[joint]
    }

    /// Global rotations of a frame, `[22]`; the identity for joints that are not mapped.
    pub(super) fn rotations(&self, frame: usize) -> &[DQuat; NUM_BODY_JOINTS] {
        &self.rotations[frame]
    }

    /// Positions in a frame, `[22]`; zero for joints that are not located.
    pub(super) fn points(&self, frame: usize) -> &[DVec3; NUM_BODY_JOINTS] {
        &self.points[frame]
    }

    /// Positions in the zero pose relative to the root, in the source's axes, `[22]`.
    pub(super) fn zero_points(&self) -> &[DVec3; NUM_BODY_JOINTS] {
        &self.zero_points
    }

    /// Mean length of both legs from hip over knee to ankle, over the frames.
    pub(super) fn leg_length(&self) -> f64 {
        self.leg_length
    }
}

/// Mean length of both legs from hip over knee to ankle.
pub(super) fn leg_length(point: impl Fn(usize) -> DVec3) -> f64 {
    let leg = |hip: usize, knee: usize, ankle: usize| {
        point(hip).distance(point(knee)) + point(knee).distance(point(ankle))
    };
    0.5 * (leg(1, 4, 7) + leg(2, 5, 8))
}
