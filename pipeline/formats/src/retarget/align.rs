//! The constant rotation between a joint's frame in the source and in the body.
//!
//! Each mapped joint has one rotation `A` with `body = source * A`, both global. If the source's rest pose
//! is a standing person, `A` follows from geometry ([`by_rest_pose`]). Other sources choose joint frames
//! freely, often with every bone along x, and their zero pose is arbitrary; then `A` is estimated from the
//! motion ([`by_motion`]).

use std::f64::consts::FRAC_PI_2;

use datasets_spec::Skeleton;
use datasets_spec::quantile::quantile;
use glam::{DMat3, DMat4, DQuat, DVec3, DVec4};
use kinematics::rotation::{arc, slerp};
use kinematics::skeleton::{NUM_BODY_JOINTS, parent_of};

use super::track::{Track, TrackRest};

/// The constant rotation of each body joint; the identity where the source has no such joint.
pub(super) type Alignment = [DQuat; NUM_BODY_JOINTS];

/// Bones whose direction the body must reproduce exactly, as (joint, its child), parents first.
const LIMBS: [(usize, usize); 8] = [
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

/// Aligns the frames of a source by a pose that shows a standing person with arms out or down; none
/// if it does not. The pose may be in any unit and orientation.
///
/// Both bodies then have the same pose: torsos upright with the same heading, limb bones in the same
/// directions, soles level. The positions of spine, neck, collar and head joints differ between
/// skeletons, so these joints use the torso's orientation instead of bone directions.
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
    // These are the body's rotations in the pose; divide by the source's.
    for (rotation, source) in alignment.iter_mut().zip(&rest.rotations) {
        *rotation = source.inverse() * *rotation;
    }
    Some(alignment)
}

fn heading(direction: DVec3) -> f64 {
    direction.x.atan2(direction.z)
}

/// The orientation of the torso in a zero pose that shows a standing person; none if it does not.
fn standing_torso(zero: &[DVec3; NUM_BODY_JOINTS], track: &Track) -> Option<DQuat> {
    /// Cosines of the largest angles allowed: legs splay by 20 degrees in the CMU skeleton, arms
    /// of A-poses hang by 45 and those of some rigs hang straight down, but never point up.
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
    let size = direction.abs();
    if size.x >= size.y && size.x >= size.z {
        DVec3::X * direction.x.signum()
    } else if size.y >= size.z {
        DVec3::Y * direction.y.signum()
    } else {
        DVec3::Z * direction.z.signum()
    }
}

/// Estimates the frames of a source from its motion, which must be y up.
///
/// Positions determine the body's rotations in each frame up to twists: the pelvis from the line of the
/// hips and the lowest spine bone, the chest from the line of the collars and the spine, upper limbs from
/// the plane in which elbow or knee is bent, feet from the frames in which they stand flat. `A` is the mean
/// over the frames of `source^-1 * body`, corrected so that limb bones have exact directions. The twist of
/// each frame comes from the source's rotations; only its constant part is estimated.
pub(super) fn by_motion(track: &Track, skeleton: &Skeleton) -> Alignment {
    let mut alignment = [DQuat::IDENTITY; NUM_BODY_JOINTS];
    let stride = track.num_frames().div_ceil(MAX_SAMPLES);
    let frames = (0..track.num_frames()).step_by(stride);
    let rotation = |frame: usize, joint: usize| track.rotations(frame)[joint];
    let point = |frame: usize, joint: usize| track.points(frame)[joint];
    let hips_middle = |frame: usize| point(frame, 1).midpoint(point(frame, 2));
    let is_mapped = |joint: usize| track.is_mapped(joint);
    let mean_in = |joint: usize, vector: &dyn Fn(usize) -> DVec3| -> DVec3 {
        frames
            .clone()
            .map(|frame| rotation(frame, joint).inverse() * vector(frame).normalize_or_zero())
            .sum::<DVec3>()
            .normalize_or_zero()
    };
    let mean_of = |joint: usize, body: &dyn Fn(usize) -> (DQuat, f64)| -> (DQuat, f64) {
        mean_rotation(frames.clone().map(|frame| {
            let (body, weight) = body(frame);
            (rotation(frame, joint).inverse() * body, weight)
        }))
    };

    // Joints closer than this fraction of the leg's length coincide and give no direction.
    let apart = 0.02 * track.leg_length();
    let is_apart = |a: &dyn Fn(usize) -> DVec3, b: &dyn Fn(usize) -> DVec3| {
        frames
            .clone()
            .map(|frame| a(frame).distance(b(frame)))
            .sum::<f64>()
            > apart * frames.len() as f64
    };

    let hips_line = |frame: usize| point(frame, 1) - point(frame, 2);
    let above_hips = [3, 6, 9, 12, 15].into_iter().find(|&joint| {
        track.is_located(joint) && is_apart(&|frame| point(frame, joint), &hips_middle)
    });
    if let Some(above) = above_hips {
        alignment[0] = axes(
            mean_in(0, &hips_line),
            mean_in(0, &|frame| point(frame, above) - hips_middle(frame)),
        );
    }
    let pelvis_alignment = alignment[0];
    let pelvis = |frame: usize| rotation(frame, 0) * pelvis_alignment;

    let chest_joint = SPINE
        .into_iter()
        .rev()
        .find(|&joint| is_mapped(joint))
        .unwrap_or(0);
    let pair = |left: usize, right: usize| {
        let located = track.is_located(left) && track.is_located(right);
        located && is_apart(&|frame| point(frame, left), &|frame| point(frame, right))
    };
    let (left, right) = [(13, 14), (16, 17)]
        .into_iter()
        .find(|&(left, right)| pair(left, right))
        .unwrap_or((1, 2));
    let top = if track.is_located(12) { 12 } else { 15 };
    let base = SPINE
        .into_iter()
        .find(|&joint| is_mapped(joint) && joint != chest_joint);
    if chest_joint != 0 {
        alignment[chest_joint] = axes(
            mean_in(chest_joint, &|frame| {
                point(frame, left) - point(frame, right)
            }),
            mean_in(chest_joint, &|frame| {
                let base = base.map_or_else(|| hips_middle(frame), |base| point(frame, base));
                point(frame, top) - base
            }),
        );
    }
    let chest_alignment = alignment[chest_joint];
    let chest = |frame: usize| rotation(frame, chest_joint) * chest_alignment;

    for joint in SPINE {
        if joint != chest_joint && is_mapped(joint) {
            let height = |joint: usize| skeleton.rest(joint).y - skeleton.rest(0).y;
            let share = height(joint) / height(chest_joint);
            let body = |frame: usize| (slerp(pelvis(frame), chest(frame), share), 1.0);
            alignment[joint] = mean_of(joint, &body).0;
        }
    }
    // The body's head joint is off its midline, which must not tilt a straight neck.
    let neck_bone = skeleton.offset(15).with_x(0.0);
    let neck = |frame: usize| {
        let chest = chest(frame);
        let bone = point(frame, 15) - point(frame, 12);
        (arc(chest * neck_bone, bone) * chest, 1.0)
    };
    if is_mapped(12) {
        alignment[12] = if track.is_located(15) {
            mean_of(12, &neck).0
        } else {
            mean_of(12, &|frame| (chest(frame), 1.0)).0
        };
    }
    // On average the head is aligned with the chest, and the shoulders are level.
    for joint in [13, 14, 15] {
        if is_mapped(joint) {
            alignment[joint] = mean_of(joint, &|frame| (chest(frame), 1.0)).0;
        }
    }

    // Knees bend about +x of the body; elbows, palms down, about -y (left) and +y (right).
    let limbs = [
        ([1, 4, 7], DVec3::X),
        ([2, 5, 8], DVec3::X),
        (ARMS[0], DVec3::NEG_Y),
        (ARMS[1], DVec3::Y),
    ];
    for ([upper, middle, end], hinge) in limbs {
        if !is_mapped(upper) {
            continue;
        }
        let is_leg = upper < 3;
        let trunk = |frame: usize| if is_leg { pelvis(frame) } else { chest(frame) };
        if !track.is_located(middle) {
            alignment[upper] = mean_of(upper, &|frame| (trunk(frame), 1.0)).0;
            continue;
        }
        let upper_bone = skeleton.offset(middle);
        let swung = |frame: usize| {
            let bone = point(frame, middle) - point(frame, upper);
            (arc(trunk(frame) * upper_bone, bone) * trunk(frame), 1.0)
        };
        let hinged = |frame: usize| {
            let bone = (point(frame, middle) - point(frame, upper)).normalize_or_zero();
            let next = (point(frame, end) - point(frame, middle)).normalize_or_zero();
            bent(bone, next).map_or((DQuat::IDENTITY, 0.0), |(axis, weight)| {
                (axes(bone, axis) * axes(upper_bone, hinge).inverse(), weight)
            })
        };
        /// Sum of squared sines of the bend from which the bending plane is reliable: three frames at a right
        /// angle, or some thirty at 20 degrees.
        const MIN_BENDING: f64 = 3.0;
        let mut estimate = (DQuat::IDENTITY, 0.0);
        if track.is_located(end) {
            estimate = mean_of(upper, &hinged);
        }
        if estimate.1 < MIN_BENDING {
            estimate = mean_of(upper, &swung);
        }
        let exact = mean_in(upper, &|frame| point(frame, middle) - point(frame, upper));
        alignment[upper] = arc(estimate.0 * upper_bone, exact) * estimate.0;

        let upper_alignment = alignment[upper];
        let above = |frame: usize| rotation(frame, upper) * upper_alignment;
        if is_mapped(middle) {
            alignment[middle] = if track.is_located(end) {
                let bone = skeleton.offset(end);
                let below = |frame: usize| {
                    let measured = point(frame, end) - point(frame, middle);
                    (arc(above(frame) * bone, measured) * above(frame), 1.0)
                };
                let estimate = mean_of(middle, &below).0;
                let exact = mean_in(middle, &|frame| point(frame, end) - point(frame, middle));
                arc(estimate * bone, exact) * estimate
            } else {
                mean_of(middle, &|frame| (above(frame), 1.0)).0
            };
        }
        if is_mapped(end) {
            // Wrists are on average in line with the forearm; ankles with the shin, unless the soles
            // determine them.
            let middle_alignment = alignment[middle];
            let body = |frame: usize| (rotation(frame, middle) * middle_alignment, 1.0);
            alignment[end] = mean_of(end, &body).0;
        }
    }
    for [_, _, ankle, foot] in LEGS {
        if let Some(level) = by_sole(track, ankle, foot, skeleton) {
            alignment[ankle] = level;
        }
        if is_mapped(foot) {
            let ankle_alignment = alignment[ankle];
            let body = |frame: usize| (rotation(frame, ankle) * ankle_alignment, 1.0);
            alignment[foot] = mean_of(foot, &body).0;
        }
    }
    alignment
}

/// The bending axis of a joint and its weight; none if the joint is nearly straight or folded.
fn bent(bone: DVec3, next: DVec3) -> Option<(DVec3, f64)> {
    /// Sine of 20 degrees: for smaller bends the axis is noise, and real knees and elbows overextend.
    const MIN_SINE: f64 = 0.342;
    let axis = bone.cross(next);
    let sine = axis.length();
    (sine > MIN_SINE).then(|| (axis / sine, sine * sine))
}

/// Aligns an ankle by the frames in which the foot stands flat: where both ankle and foot are
/// within 3 cm of the lowest they get, the vertical is the sole's normal. None if there is no foot
/// or what was found is no sole.
fn by_sole(track: &Track, ankle: usize, foot: usize, skeleton: &Skeleton) -> Option<DQuat> {
    /// Share of the leg's length (3 cm for a leg of 0.8 m) and of the frames.
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
    let band = FLAT_BAND * track.leg_length();
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

/// The rotation that takes x to the first direction and y as near as possible to the second.
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

/// The chordal mean of weighted rotations, and the sum of the weights; the identity for none.
///
/// It is the eigenvector of the largest eigenvalue of the weighted sum of `q q^T`, for which a
/// quaternion and its negative count the same. Squaring the matrix ten times raises the ratio of
/// its eigenvalues to the power 1024.
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

/// The rotation that takes an up axis to y.
pub(super) fn y_up_from_axis(up: DVec3) -> DQuat {
    if up.z != 0.0 {
        DQuat::from_rotation_x(-FRAC_PI_2 * up.z.signum())
    } else if up.x != 0.0 {
        DQuat::from_rotation_z(FRAC_PI_2 * up.x.signum())
    } else if up.y < 0.0 {
        DQuat::from_rotation_x(2.0 * FRAC_PI_2)
    } else {
        DQuat::IDENTITY
    }
}

/// The rotation of a source to y up, and the name of its up axis.
///
/// The up axis is the mean direction from hips to head. That is unreliable for a person who lies or bends,
/// so an axis other than y needs a clear majority.
pub(super) fn y_up_from_source(mean_up: DVec3) -> (DQuat, &'static str) {
    /// Share of the mean direction that must lie along another axis than y.
    const CLEAR: f64 = 0.7;
    let size = mean_up.abs();
    let axis = if size.z > CLEAR && size.z > 2.0 * size.y {
        DVec3::Z * mean_up.z.signum()
    } else if size.x > CLEAR && size.x > 2.0 * size.y {
        DVec3::X * mean_up.x.signum()
    } else if mean_up.y < -CLEAR {
        DVec3::NEG_Y
    } else {
        DVec3::Y
    };
    (y_up_from_axis(axis), axis_name(axis))
}

/// Name of an axis.
pub(super) fn axis_name(axis: DVec3) -> &'static str {
    match (axis.x, axis.y, axis.z) {
        (x, _, _) if x > 0.0 => "x",
        (x, _, _) if x < 0.0 => "-x",
        (_, _, z) if z > 0.0 => "z",
        (_, _, z) if z < 0.0 => "-z",
        (_, y, _) if y < 0.0 => "-y",
        _ => "y",
    }
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
            let (rotation, _) = y_up_from_source(up);
            prop_assert!((rotation * up - DVec3::Y).length() < 1e-12);
        }
    }

    #[test]
    fn a_bow_does_not_turn_the_world_over() {
        let bowing = DVec3::new(0.0, 0.5, 0.86);
        assert_eq!(y_up_from_source(bowing).1, "y");
    }

    #[test]
    fn no_rotations_have_no_mean() {
        assert_eq!(mean_rotation(std::iter::empty()), (DQuat::IDENTITY, 0.0));
    }
}
