//! The mapped joints of a source, frame by frame.

use glam::{DQuat, DVec3};
use kinematics::skeleton::NUM_BODY_JOINTS;

use super::joint_map::Mapping;
use super::rig::{Bone, Placed, Rest, Rig, with_ancestors};
use clip::Rejected;

/// Global rotations and positions of the mapped joints of a source, in its own unit. Long motions are sampled at evenly
/// spaced frames, from which constants are estimated.
pub(super) struct Track {
    source_of: [Option<usize>; NUM_BODY_JOINTS],
    anchors: [Anchor; NUM_BODY_JOINTS],
    /// Number of source frames per held frame.
    stride: usize,
    /// Product of all rotations of the track ([`Track::turn`]).
    turn: DQuat,
    rotations: Vec<[DQuat; NUM_BODY_JOINTS]>,
    points: Vec<[DVec3; NUM_BODY_JOINTS]>,
    /// The poses that may be a standing person, the most reliable first.
    pub(super) rests: Vec<TrackRest>,
    /// Mean length of both legs from hip over knee to ankle, over the frames.
    pub(super) leg_length: f64,
}

/// The mapped joints in a pose that may be a standing person, in the axes of the pose.
pub(super) struct TrackRest {
    /// Name of the pose.
    pub(super) name: &'static str,
    /// Global rotations, `[22]`; the identity for joints that are not mapped.
    pub(super) rotations: [DQuat; NUM_BODY_JOINTS],
    /// Positions, `[22]`; zero for joints that are not located.
    pub(super) points: [DVec3; NUM_BODY_JOINTS],
}

/// Limit on the frames that a track holds, 1.2 kB each.
const MAX_FRAMES: usize = 4096;

/// Limit on coordinates in the file's unit: larger values are not motion and would overflow.
const MAX_COORDINATE: f64 = 1e9;

/// Ankle and foot of each leg. If the source has no foot joint, the end site of the ankle replaces it.
const FOOT_OF_ANKLE: [(usize, usize); 2] = [(7, 10), (8, 11)];

/// The bone, and the point in its frame, that are a body joint: the bone's origin or its tip.
type Anchor = Option<(usize, DVec3)>;

impl Track {
    /// Follows the mapped joints of a source.
    ///
    /// # Errors
    /// `E-NOT-FINITE` if a joint's position or rotation is not finite or its position is too large,
    /// [`Rig::skeleton_code`] if the legs have no length.
    pub(super) fn follow(
        rig: &impl Rig,
        bones: &[Bone<'_>],
        rests: &[Rest],
        mapping: &Mapping,
    ) -> Result<Self, Rejected> {
        let anchors = anchors(bones, mapping);
        let num_frames = rig.frames().len();
        let stride = num_frames.div_ceil(MAX_FRAMES).max(1);
        let mut rotations = Vec::with_capacity(num_frames.div_ceil(stride));
        let mut points = Vec::with_capacity(num_frames.div_ceil(stride));
        let mut lost = None;
        let mut legs = 0.0;
        let mut visited = 0;
        rig.follow(&needed(bones, &anchors), &mut |frame, placed| {
            let frame_points = points_of(&anchors, placed);
            // The sum is NaN or too large if any coordinate is.
            let reach = frame_points
                .iter()
                .fold(0.0, |sum, point| sum + point.abs().element_sum());
            let frame_rotations = rotations_of(&mapping.source_of, placed);
            let is_lost = reach.is_nan()
                || reach >= MAX_COORDINATE
                || !frame_rotations.iter().all(|q| q.is_finite());
            if is_lost && lost.is_none() {
                lost = Some(frame);
            }
            legs += leg_length(|joint| frame_points[joint]);
            if visited % stride == 0 {
                rotations.push(frame_rotations);
                points.push(frame_points);
            }
            visited += 1;
        });
        if let Some(frame) = lost {
            let reason = format!(
                "found a joint that is not finite or beyond {MAX_COORDINATE:e} units in frame {frame}, expected a body"
            );
            return Err(Rejected::retarget("E-NOT-FINITE", reason));
        }
        let rests = rests
            .iter()
            .map(|rest| TrackRest {
                name: rest.name,
                rotations: rotations_of(&mapping.source_of, &rest.bones),
                points: points_of(&anchors, &rest.bones),
            })
            .collect();
        let track = Self {
            source_of: mapping.source_of,
            anchors,
            stride,
            turn: DQuat::IDENTITY,
            leg_length: legs / num_frames.max(1) as f64,
            rotations,
            points,
            rests,
        };
        // Legs shorter than this, in the file's unit, are no bones.
        const SHORTEST_LEG: f64 = 1e-6;
        if track.points.is_empty() || track.leg_length < SHORTEST_LEG {
            let reason = format!("found legs of length {}, expected bones", track.leg_length);
            return Err(Rejected::retarget(rig.skeleton_code(), reason));
        }
        Ok(track)
    }

    /// Rotates the whole track.
    pub(super) fn turn(&mut self, turn: DQuat) {
        self.turn = turn * self.turn;
        for rotation in self.rotations.as_flattened_mut() {
            *rotation = turn * *rotation;
        }
        for point in self.points.as_flattened_mut() {
            *point = turn * *point;
        }
    }

    /// Calls `visit` with rotations and positions of every frame of the source, in order.
    pub(super) fn every_frame(
        &self,
        rig: &impl Rig,
        bones: &[Bone<'_>],
        visit: &mut dyn FnMut(&[DQuat; NUM_BODY_JOINTS], &[DVec3; NUM_BODY_JOINTS]),
    ) {
        if self.stride == 1 {
            for (rotations, points) in self.rotations.iter().zip(&self.points) {
                visit(rotations, points);
            }
            return;
        }
        rig.follow(&needed(bones, &self.anchors), &mut |_, placed| {
            let rotations = rotations_of(&self.source_of, placed).map(|q| self.turn * q);
            let points = points_of(&self.anchors, placed).map(|point| self.turn * point);
            visit(&rotations, &points);
        });
    }

    /// Number of frames held, at least one.
    pub(super) fn num_frames(&self) -> usize {
        self.points.len()
    }

    /// Whether the source has this body joint.
    pub(super) fn is_mapped(&self, joint: usize) -> bool {
        self.source_of[joint].is_some()
    }

    /// Whether the source has a position for this body joint: the joint itself, or an end site.
    pub(super) fn is_located(&self, joint: usize) -> bool {
        self.anchors[joint].is_some()
    }

    /// Global rotations of a frame, `[22]`; the identity for joints that are not mapped.
    pub(super) fn rotations(&self, frame: usize) -> &[DQuat; NUM_BODY_JOINTS] {
        &self.rotations[frame]
    }

    /// Positions in a frame, `[22]`; zero for joints that are not located.
    pub(super) fn points(&self, frame: usize) -> &[DVec3; NUM_BODY_JOINTS] {
        &self.points[frame]
    }

    /// The first frame as a rest pose.
    pub(super) fn first_frame(&self) -> TrackRest {
        TrackRest {
            name: "first frame",
            rotations: self.rotations[0],
            points: self.points[0],
        }
    }
}

fn anchors(bones: &[Bone<'_>], mapping: &Mapping) -> [Anchor; NUM_BODY_JOINTS] {
    let mut anchors = mapping
        .source_of
        .map(|source| source.map(|source| (source, DVec3::ZERO)));
    for (ankle, foot) in FOOT_OF_ANKLE {
        let tip = mapping.source_of[ankle]
            .and_then(|source| Some((source, bones[source].tip?)))
            .filter(|(_, offset)| *offset != DVec3::ZERO);
        anchors[foot] = anchors[foot].or(tip);
    }
    anchors
}

/// The bones that carry an anchor, with their ancestors.
fn needed(bones: &[Bone<'_>], anchors: &[Anchor; NUM_BODY_JOINTS]) -> Vec<bool> {
    let parents: Vec<Option<usize>> = bones.iter().map(|bone| bone.parent).collect();
    with_ancestors(&parents, anchors.iter().flatten().map(|(bone, _)| *bone))
}

fn rotations_of(
    source_of: &[Option<usize>; NUM_BODY_JOINTS],
    placed: &[Placed],
) -> [DQuat; NUM_BODY_JOINTS] {
    source_of.map(|source| source.map_or(DQuat::IDENTITY, |source| placed[source].rotation))
}

fn points_of(anchors: &[Anchor; NUM_BODY_JOINTS], placed: &[Placed]) -> [DVec3; NUM_BODY_JOINTS] {
    anchors.map(|anchor| {
        anchor.map_or(DVec3::ZERO, |(source, offset)| {
            let Placed { position, rotation } = placed[source];
            if offset == DVec3::ZERO {
                position
            } else {
                position + rotation * offset
            }
        })
    })
}

/// Mean length of both legs from hip over knee to ankle.
pub(super) fn leg_length(point: impl Fn(usize) -> DVec3) -> f64 {
    let leg = |hip: usize, knee: usize, ankle: usize| {
        point(hip).distance(point(knee)) + point(knee).distance(point(ankle))
    };
    0.5 * (leg(1, 4, 7) + leg(2, 5, 8))
}
