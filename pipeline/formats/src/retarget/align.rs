//! The constant rotation between a joint's frame in the source and in the body.
//!
//! Each mapped joint has one rotation `A` with `body = source * A`, both global. If the source's rest pose is a
//! standing person, `A` follows from geometry ([`by_rest_pose`]). Other sources choose joint frames freely, often with
//! every bone along x, and their zero pose is arbitrary; then `A` is estimated from the motion ([`by_motion`]).

use std::iter::StepBy;
use std::ops::Range;

use datasets_spec::Skeleton;
use datasets_spec::quantile::quantile;
use glam::{DMat3, DMat4, DQuat, DVec3, DVec4};
use kinematics::rotation::{arc, slerp};
use kinematics::skeleton::{NUM_BODY_JOINTS, parent_of};

use super::track::{Track, TrackRest};
use crate::source::Up;

/// The constant rotation of each body joint; the identity if the source has no such joint.
pub(super) type Alignment = [DQuat; NUM_BODY_JOINTS];

/// Bones whose direction the body must reproduce exactly, as (joint, its child), parents first. The left one of a pair
/// comes before the right one.
pub(super) const LIMBS: [(usize, usize); 8] = [
    (1, 4),
    (2, 5),
    (4, 7),
    (5, 8),
    (16, 18),
    (17, 19),
    (18, 20),
    (19, 21),
];
/// Hip, knee, ankle and foot of each leg.
const LEGS: [[usize; 4]; 2] = [[1, 4, 7, 10], [2, 5, 8, 11]];
/// Shoulder, elbow and wrist of each arm.
const ARMS: [[usize; 3]; 2] = [[16, 18, 20], [17, 19, 21]];
/// Limit on the frames that constant rotations are estimated from. Longer motions are sampled evenly.
const MAX_SAMPLES: usize = 256;
/// The joints between pelvis and neck, lowest first.
pub(super) const SPINE: [usize; 3] = [3, 6, 9];

/// Aligns the joint frames of a source by its rest pose, which must show a standing person with arms out or down;
/// `None` if it does not. The pose may be in any unit, with any axis up.
///
/// In this pose both bodies then have upright torsos with the same heading, limb bones in the same directions and level
/// soles. The positions of spine, neck, collar and head joints differ between skeletons, so these joints use the
/// torso's orientation instead of bone directions.
pub(super) fn by_rest_pose(
    rest: &TrackRest,
    track: &Track,
    skeleton: &Skeleton,
) -> Option<Alignment> {
    let zero = &rest.points;
    let torso = standing_torso(zero, track)?;
    let mut alignment = [torso; NUM_BODY_JOINTS];
    for (joint, child) in LIMBS {
        if !track.is_located(joint) {
            continue;
        }
        // Hips and shoulders start from the torso, knees and elbows from the bone above, so that a
        // limb that rests at an angle rotates as a whole.
        let from = if matches!(joint, 4 | 5 | 18 | 19) {
            alignment[parent_of(joint)]
        } else {
            torso
        };
        alignment[joint] = if track.is_located(child) {
            arc(from * skeleton.offset(child), zero[child] - zero[joint]) * from
        } else {
            from
        };
    }
    for arm in ARMS {
        alignment[arm[2]] = alignment[arm[1]];
    }
    for [hip, _, ankle, foot] in LEGS {
        // The foot of an inclined leg inclines with it, so the sole is levelled relative to the
        // line from hip to ankle. Only the heading of the foot's direction is used: the height of
        // the ankle above the toes depends on the skeleton, not on the pose.
        let leg = skeleton.rest(ankle) - skeleton.rest(hip);
        let level = arc(torso * leg, zero[ankle] - zero[hip]) * torso;
        alignment[ankle] = if track.is_located(foot) {
            let source = level.inverse() * (zero[foot] - zero[ankle]);
            level * DQuat::from_rotation_y(heading(source) - heading(skeleton.offset(foot)))
        } else {
            level
        };
        alignment[foot] = alignment[ankle];
    }
    // `alignment` holds the body's rotations in the pose; divide by the source's.
    for (rotation, source) in alignment.iter_mut().zip(&rest.rotations) {
        *rotation = source.inverse() * *rotation;
    }
    Some(alignment)
}

fn heading(direction: DVec3) -> f64 {
    direction.x.atan2(direction.z)
}

/// The axis along which the person stands in a zero pose; `None` if no zero pose shows a standing person.
pub(super) fn up_of_rests(track: &Track) -> Option<Up> {
    let stands = |rest: &&TrackRest| standing_torso(&rest.points, track).is_some();
    let zero = &track.rests.iter().find(stands)?.points;
    let top = if track.is_located(15) { 15 } else { 12 };
    Some(Up::nearest(zero[top] - zero[1].midpoint(zero[2])))
}

/// The orientation of the torso in a zero pose that shows a standing person; `None` if it does not.
fn standing_torso(zero: &[DVec3; NUM_BODY_JOINTS], track: &Track) -> Option<DQuat> {
    /// Limits on cosines: legs splay by 20 degrees in the CMU skeleton, arms of A-poses hang by 45, and arms of some
    /// rigs hang straight down, but never point up.
    const UPRIGHT: f64 = 0.9;
    const LEG_DOWN: f64 = 0.8;
    const ARM_NOT_UP: f64 = 0.5;
    const ARM_NOT_FORWARD: f64 = 0.75;
    const ARM_STRAIGHT: f64 = 0.5;

    let direction = |from: usize, to: usize| (zero[to] - zero[from]).try_normalize();
    let hips_middle = zero[1].midpoint(zero[2]);
    let top = if track.is_located(15) { 15 } else { 12 };
    let spine = (zero[top] - hips_middle).try_normalize()?;
    // Zero poses are authored along the axes; deviations come from joint positions.
    let up = nearest_axis(spine);
    let hips = direction(2, 1)?;
    let left = nearest_axis(hips);
    if up.dot(spine) < UPRIGHT || left.dot(hips) < UPRIGHT || up.dot(left) != 0.0 {
        return None;
    }
    let forward = left.cross(up);
    for [hip, knee, ankle, foot] in LEGS {
        let thigh_down = direction(hip, knee)?.dot(-up) > LEG_DOWN;
        let leg_down = direction(hip, ankle)?.dot(-up) > LEG_DOWN;
        let toes_ahead =
            !track.is_located(foot) || direction(ankle, foot).is_none_or(|d| d.dot(forward) > 0.0);
        if !thigh_down || !leg_down || !toes_ahead {
            return None;
        }
    }
    for [shoulder, elbow, wrist] in ARMS {
        if !(track.is_located(shoulder) && track.is_located(elbow)) {
            continue;
        }
        let upper = direction(shoulder, elbow)?;
        let straight = !track.is_located(wrist)
            || direction(elbow, wrist).is_none_or(|fore| fore.dot(upper) > ARM_STRAIGHT);
        if upper.dot(up) > ARM_NOT_UP || upper.dot(forward).abs() > ARM_NOT_FORWARD || !straight {
            return None;
        }
    }
    Some(DQuat::from_mat3(&DMat3::from_cols(left, up, forward)))
}

fn nearest_axis(direction: DVec3) -> DVec3 {
    let axis = direction.abs().max_position();
    DVec3::AXES[axis] * direction[axis].signum()
}

/// Estimates the alignment of joint frames from the source's motion, which must be y up.
///
/// Positions determine the body's rotations in each frame up to twists: the pelvis from the line of the
/// hips and the lowest spine bone, the chest from the line of the collars and the spine, upper limbs from
/// the plane in which elbow or knee is bent, feet from the frames in which they stand flat. `A` is the mean
/// over the frames of `source^-1 * body`, corrected so that limb bones have exact directions. The twist of
/// each frame comes from the source's rotations; only its constant part is estimated.
pub(super) fn by_motion(track: &Track, skeleton: &Skeleton) -> Alignment {
    let mut estimate = Estimate::new(track, skeleton);
    estimate.align_pelvis();
    estimate.align_chest();
    estimate.align_spine();
    estimate.align_neck_and_head();
    // Knees bend about +x of the body; elbows, palms down, about -y (left) and +y (right).
    let limbs = [
        ([1, 4, 7], DVec3::X),
        ([2, 5, 8], DVec3::X),
        (ARMS[0], DVec3::NEG_Y),
        (ARMS[1], DVec3::Y),
    ];
    for (limb, hinge) in limbs {
        estimate.align_limb(limb, hinge);
    }
    for [_, _, ankle, foot] in LEGS {
        estimate.align_foot(ankle, foot);
    }
    estimate.alignment
}

/// Alignment estimated from a source's motion, from the pelvis outwards.
struct Estimate<'a> {
    track: &'a Track,
    skeleton: &'a Skeleton,
    /// The sampled frames.
    frames: StepBy<Range<usize>>,
    /// The highest joint of the spine that the source has; the pelvis if it has none.
    chest: usize,
    alignment: Alignment,
}

impl<'a> Estimate<'a> {
    fn new(track: &'a Track, skeleton: &'a Skeleton) -> Self {
        let stride = track.num_frames().div_ceil(MAX_SAMPLES);
        let mut spine = SPINE.into_iter().rev();
        Self {
            track,
            skeleton,
            frames: (0..track.num_frames()).step_by(stride),
            chest: spine.find(|&joint| track.is_mapped(joint)).unwrap_or(0),
            alignment: [DQuat::IDENTITY; NUM_BODY_JOINTS],
        }
    }

    fn rotation(&self, frame: usize, joint: usize) -> DQuat {
        self.track.rotations(frame)[joint]
    }

    fn point(&self, frame: usize, joint: usize) -> DVec3 {
        self.track.points(frame)[joint]
    }

    fn hips_middle(&self, frame: usize) -> DVec3 {
        self.point(frame, 1).midpoint(self.point(frame, 2))
    }

    /// The vector from one joint to another.
    fn bone(&self, frame: usize, from: usize, to: usize) -> DVec3 {
        self.point(frame, to) - self.point(frame, from)
    }

    /// The body's global rotation of an aligned joint.
    fn body(&self, frame: usize, joint: usize) -> DQuat {
        self.rotation(frame, joint) * self.alignment[joint]
    }

    /// The body's rotation of the joint `above`, turned by the smallest angle that makes `bone` point like the source's
    /// bone, with weight 1.
    fn swung(
        &self,
        frame: usize,
        above: usize,
        bone: DVec3,
        [from, to]: [usize; 2],
    ) -> (DQuat, f64) {
        let body = self.body(frame, above);
        (arc(body * bone, self.bone(frame, from, to)) * body, 1.0)
    }

    /// The mean direction of a vector in the frame of a joint.
    fn mean_in(&self, joint: usize, vector: impl Fn(usize) -> DVec3) -> DVec3 {
        let frames = self.frames.clone();
        frames
            .map(|frame| self.rotation(frame, joint).inverse() * vector(frame).normalize_or_zero())
            .sum::<DVec3>()
            .normalize_or_zero()
    }

    /// The mean alignment of a joint, and the sum of the weights. `body` returns the body's rotation and its weight in
    /// a frame.
    fn mean_of(&self, joint: usize, body: impl Fn(usize) -> (DQuat, f64)) -> (DQuat, f64) {
        mean_rotation(self.frames.clone().map(|frame| {
            let (body, weight) = body(frame);
            (self.rotation(frame, joint).inverse() * body, weight)
        }))
    }

    /// The alignment that gives a joint on average the body's rotation of another joint.
    fn in_line_with(&self, other: usize, joint: usize) -> DQuat {
        self.mean_of(joint, |frame| (self.body(frame, other), 1.0))
            .0
    }

    /// An estimate of a joint's alignment, corrected so that the bone to its child has its exact direction.
    fn exact(&self, estimate: DQuat, joint: usize, child: usize) -> DQuat {
        let exact = self.mean_in(joint, |frame| self.bone(frame, joint, child));
        arc(estimate * self.skeleton.offset(child), exact) * estimate
    }

    /// Whether two points are on average far enough apart to define a direction.
    fn is_apart(&self, a: impl Fn(usize) -> DVec3, b: impl Fn(usize) -> DVec3) -> bool {
        // Joints closer than this fraction of the leg's length count as coincident and define no direction.
        let apart = 0.02 * self.track.leg_length;
        let distances = self.frames.clone().map(|frame| a(frame).distance(b(frame)));
        distances.sum::<f64>() > apart * self.frames.len() as f64
    }

    fn align_pelvis(&mut self) {
        let above_hips = [3, 6, 9, 12, 15].into_iter().find(|&joint| {
            let point = |frame| self.point(frame, joint);
            self.track.is_located(joint) && self.is_apart(point, |frame| self.hips_middle(frame))
        });
        if let Some(above) = above_hips {
            self.alignment[0] = axes(
                self.mean_in(0, |frame| self.bone(frame, 2, 1)),
                self.mean_in(0, |frame| {
                    self.point(frame, above) - self.hips_middle(frame)
                }),
            );
        }
    }

    fn align_chest(&mut self) {
        let (track, chest) = (self.track, self.chest);
        if chest == 0 {
            return;
        }
        let is_pair = |left: usize, right: usize| {
            let located = track.is_located(left) && track.is_located(right);
            let left = |frame| self.point(frame, left);
            located && self.is_apart(left, |frame| self.point(frame, right))
        };
        let (left, right) = [(13, 14), (16, 17)]
            .into_iter()
            .find(|&(left, right)| is_pair(left, right))
            .unwrap_or((1, 2));
        let top = if track.is_located(12) { 12 } else { 15 };
        let base = SPINE
            .into_iter()
            .find(|&joint| track.is_mapped(joint) && joint != chest);
        self.alignment[chest] = axes(
            self.mean_in(chest, |frame| self.bone(frame, right, left)),
            self.mean_in(chest, |frame| {
                let base =
                    base.map_or_else(|| self.hips_middle(frame), |base| self.point(frame, base));
                self.point(frame, top) - base
            }),
        );
    }

    /// Aligns the joints between pelvis and chest by interpolating between the two by height.
    fn align_spine(&mut self) {
        let (skeleton, chest) = (self.skeleton, self.chest);
        for joint in SPINE {
            if joint != chest && self.track.is_mapped(joint) {
                let height = |joint: usize| skeleton.rest(joint).y - skeleton.rest(0).y;
                let share = height(joint) / height(chest);
                let body = |frame| slerp(self.body(frame, 0), self.body(frame, chest), share);
                self.alignment[joint] = self.mean_of(joint, |frame| (body(frame), 1.0)).0;
            }
        }
    }

    fn align_neck_and_head(&mut self) {
        // The body's head joint is off its midline, which must not tilt a straight neck.
        let neck_bone = self.skeleton.offset(15).with_x(0.0);
        if self.track.is_mapped(12) {
            self.alignment[12] = if self.track.is_located(15) {
                let neck = |frame| self.swung(frame, self.chest, neck_bone, [12, 15]);
                self.mean_of(12, neck).0
            } else {
                self.in_line_with(self.chest, 12)
            };
        }
        // Assume that on average the head is aligned with the chest, and the shoulders are level.
        for joint in [13, 14, 15] {
            if self.track.is_mapped(joint) {
                self.alignment[joint] = self.in_line_with(self.chest, joint);
            }
        }
    }

    /// Aligns an arm or a leg, whose middle joint bends about the axis `hinge` of the body.
    fn align_limb(&mut self, [upper, middle, end]: [usize; 3], hinge: DVec3) {
        let track = self.track;
        if !track.is_mapped(upper) {
            return;
        }
        let trunk = if upper < 3 { 0 } else { self.chest };
        if !track.is_located(middle) {
            self.alignment[upper] = self.in_line_with(trunk, upper);
            return;
        }
        let estimate = self.upper_limb(trunk, [upper, middle, end], hinge);
        self.alignment[upper] = self.exact(estimate, upper, middle);
        if track.is_mapped(middle) {
            self.alignment[middle] = if track.is_located(end) {
                let bone = self.skeleton.offset(end);
                let below = |frame| self.swung(frame, upper, bone, [middle, end]);
                self.exact(self.mean_of(middle, below).0, middle, end)
            } else {
                self.in_line_with(upper, middle)
            };
        }
        if track.is_mapped(end) {
            // Wrists are on average in line with the forearm; ankles with the shin, unless the soles determine them.
            self.alignment[end] = self.in_line_with(middle, end);
        }
    }

    /// Estimates the alignment of a limb's upper joint from the plane in which the limb bends, or from the trunk if the
    /// limb hardly bends.
    fn upper_limb(&self, trunk: usize, [upper, middle, end]: [usize; 3], hinge: DVec3) -> DQuat {
        /// Sum of squared sines of the bend from which the bending plane is reliable: three frames at a right angle, or
        /// 26 at 20 degrees.
        const MIN_BENDING: f64 = 3.0;
        let upper_bone = self.skeleton.offset(middle);
        let hinged = |frame| {
            let bone = self.bone(frame, upper, middle).normalize_or_zero();
            let next = self.bone(frame, middle, end).normalize_or_zero();
            bent(bone, next).map_or((DQuat::IDENTITY, 0.0), |(axis, weight)| {
                (axes(bone, axis) * axes(upper_bone, hinge).inverse(), weight)
            })
        };
        let mut estimate = (DQuat::IDENTITY, 0.0);
        if self.track.is_located(end) {
            estimate = self.mean_of(upper, hinged);
        }
        if estimate.1 < MIN_BENDING {
            let swung = |frame| self.swung(frame, trunk, upper_bone, [upper, middle]);
            estimate = self.mean_of(upper, swung);
        }
        estimate.0
    }

    fn align_foot(&mut self, ankle: usize, foot: usize) {
        if let Some(level) = by_sole(self.track, ankle, foot, self.skeleton) {
            self.alignment[ankle] = level;
        }
        if self.track.is_mapped(foot) {
            self.alignment[foot] = self.in_line_with(ankle, foot);
        }
    }
}

/// The bending axis of a joint and its weight; `None` if the joint is nearly straight or folded.
fn bent(bone: DVec3, next: DVec3) -> Option<(DVec3, f64)> {
    /// Sine of 20 degrees: for smaller bends the axis is noise, and real knees and elbows overextend.
    const MIN_SINE: f64 = 0.342;
    let axis = bone.cross(next);
    let sine = axis.length();
    (sine > MIN_SINE).then(|| (axis / sine, sine * sine))
}

/// Aligns an ankle by the frames in which the foot stands flat: there, ankle and foot are close to their lowest heights,
/// and the sole's normal is vertical. `None` if there is no foot or no plausible sole.
fn by_sole(track: &Track, ankle: usize, foot: usize, skeleton: &Skeleton) -> Option<DQuat> {
    /// Height band of a flat foot above its lowest heights, as a fraction of the leg's length (3 cm for a leg of 0.8
    /// m), and the quantile of the heights that counts as lowest.
    const FLAT_BAND: f64 = 0.0375;
    const LOWEST_SHARE: f64 = 0.05;
    /// Largest cosine between the sole's normal and the direction from ankle to foot.
    const MAX_SLOPE: f64 = 0.75;
    if !track.is_mapped(ankle) || !track.is_located(foot) {
        return None;
    }
    let heights = |joint: usize| -> Vec<f64> {
        (0..track.num_frames())
            .map(|frame| track.points(frame)[joint].y)
            .collect()
    };
    let (ankle_heights, foot_heights) = (heights(ankle), heights(foot));
    let band = FLAT_BAND * track.leg_length;
    let ankle_low = quantile(&mut ankle_heights.clone(), LOWEST_SHARE)? + band;
    let foot_low = quantile(&mut foot_heights.clone(), LOWEST_SHARE)? + band;
    let mut normal = DVec3::ZERO;
    let mut direction = DVec3::ZERO;
    for frame in 0..track.num_frames() {
        let ankle_from_world = track.rotations(frame)[ankle].inverse();
        let bone = track.points(frame)[foot] - track.points(frame)[ankle];
        direction += ankle_from_world * bone.normalize_or_zero();
        if ankle_heights[frame] <= ankle_low && foot_heights[frame] <= foot_low {
            normal += ankle_from_world * DVec3::Y;
        }
    }
    let (normal, direction) = (normal.try_normalize()?, direction.try_normalize()?);
    if normal.dot(direction).abs() > MAX_SLOPE {
        return None;
    }
    let body = skeleton.offset(foot);
    let right_of = |up: DVec3, ahead: DVec3| axes(up, ahead - up * up.dot(ahead));
    Some(right_of(normal, direction) * right_of(DVec3::Y, body).inverse())
}

/// The rotation that takes x to the first direction, and y as near as possible to the second.
fn axes(first: DVec3, second: DVec3) -> DQuat {
    let Some(x) = first.try_normalize() else {
        return DQuat::IDENTITY;
    };
    let z = x
        .cross(second)
        .try_normalize()
        .unwrap_or_else(|| x.any_orthonormal_vector());
    DQuat::from_mat3(&DMat3::from_cols(x, z.cross(x), z))
}

/// The chordal mean of weighted rotations, and the sum of the weights; the identity if there are no rotations.
///
/// It is the eigenvector of the largest eigenvalue of the weighted sum of `q q^T`, for which a quaternion and its
/// negative count the same. Squaring the matrix ten times raises the ratio of its eigenvalues to the power 1024.
fn mean_rotation(rotations: impl Iterator<Item = (DQuat, f64)>) -> (DQuat, f64) {
    const SQUARINGS: usize = 10;
    let mut sum = DMat4::ZERO;
    let mut total = 0.0;
    for (q, weight) in rotations {
        let q = DVec4::from(q);
        sum += DMat4::from_cols(q * q.x, q * q.y, q * q.z, q * q.w) * weight;
        total += weight;
    }
    if !(total > 0.0 && total.is_finite()) {
        return (DQuat::IDENTITY, 0.0);
    }
    for _ in 0..SQUARINGS {
        let size = sum.x_axis[0] + sum.y_axis[1] + sum.z_axis[2] + sum.w_axis[3];
        let scaled = sum * (1.0 / size);
        sum = scaled * scaled;
    }
    let columns = [sum.x_axis, sum.y_axis, sum.z_axis, sum.w_axis];
    let largest = columns.into_iter().fold(DVec4::ZERO, |best, column| {
        if column.length_squared() > best.length_squared() {
            column
        } else {
            best
        }
    });
    let mean = largest
        .try_normalize()
        .map_or(DQuat::IDENTITY, DQuat::from_vec4);
    (mean, total)
}

/// The up axis of a source, and whether the person stands along it most of the time.
///
/// The up axis is the mean direction from hips to head. That is unreliable for a person who lies or bends,
/// so an axis other than y needs a clear majority.
pub(crate) fn up_of_source(mean_up: DVec3) -> (Up, bool) {
    /// Fraction of the mean direction that must lie along an axis other than y.
    const CLEAR: f64 = 0.7;
    let size = mean_up.abs();
    if size.z.max(size.x) > CLEAR.max(2.0 * size.y) || mean_up.y < -CLEAR {
        return (Up::nearest(mean_up), true);
    }
    (Up::Y, mean_up.y > CLEAR)
}

#[cfg(test)]
mod tests {
    use kinematics::rotation::{angle_between, from_axis_angle};
    use proptest::prelude::*;

    use super::*;

    fn vector() -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(-3.0..3.0).prop_map(DVec3::from_array)
    }

    proptest! {
        #[test]
        fn the_mean_of_rotations_about_one_axis_is_their_middle(
            centre in vector(),
            axis in vector(),
            half in 0.0..1.2f64,
            weight in 0.1..5.0f64,
        ) {
            prop_assume!(axis.length() > 0.1);
            let centre = from_axis_angle(centre);
            let turn = from_axis_angle(axis.normalize() * half);
            // The sign of a quaternion must not matter.
            let pair = [(centre * turn, weight), (-(centre * turn.inverse()), weight)];
            let (mean, total) = mean_rotation(pair.into_iter());
            prop_assert!(angle_between(mean, centre) < 1e-6);
            prop_assert!((total - 2.0 * weight).abs() < 1e-12);
        }

        #[test]
        fn any_of_six_ups_becomes_y(axis in 0usize..3, sign in prop::bool::ANY) {
            let up = DVec3::AXES[axis] * if sign { 1.0 } else { -1.0 };
            let (axis, is_clear) = up_of_source(up);
            prop_assert!(is_clear);
            prop_assert!((axis.turn() * up - DVec3::Y).length() < 1e-12);
            prop_assert_eq!(axis.to_string().parse(), Ok(axis));
        }
    }

    #[test]
    fn a_bow_does_not_turn_the_world_over() {
        let bowing = DVec3::new(0.0, 0.5, 0.86);
        assert_eq!(up_of_source(bowing), (Up::Y, false));
    }

    #[test]
    fn no_rotations_have_no_mean() {
        assert_eq!(mean_rotation(std::iter::empty()), (DQuat::IDENTITY, 0.0));
    }
}
