//! Start poses from geometry: aligned triangles, bones that point at their targets, hinges.

use glam::{DMat3, DQuat, DVec2, DVec3};

use super::body::{Body, Fitter};
use super::tree::TREE;
use crate::canonical::kabsch_near;
use crate::pose::{KeypointFrame, Pose};
use crate::rotation::{arc, from_axis_angle, slerp};
use crate::skeleton::{NUM_BODY_JOINTS, parent_of};

/// Sine of the bend at which a hinge sets half of a limb's twist. Smaller bends are mostly noise: 1 cm at the end of a
/// 25 cm forearm changes the sine by 0.04.
const HINGE_SINE: f64 = 0.2;

/// Joints of the limbs whose twist about their own bone follows from the direction in which the next bone bends, each
/// with the axis of the hinge at the bone's far end, in the rest pose; a positive rotation about it flexes.
///
/// The feet set the twist of the shins, the knees that of the thighs, the elbows that of the upper arms. At rest the
/// body stands with its legs along -y, its toes towards +z and its left arm along +x.
const HINGES: [(usize, DVec3); 6] = [
    (1, DVec3::X),
    (2, DVec3::X),
    (4, DVec3::NEG_X),
    (5, DVec3::NEG_X),
    (16, DVec3::NEG_Y),
    (17, DVec3::Y),
];

/// Joints whose rotation follows from a triangle of points: pelvis and chest from their three
/// children, head and wrists from themselves and two children.
const TRIANGLES: [(usize, [usize; 3]); 5] = [
    (0, [1, 2, 3]),
    (9, [12, 13, 14]),
    (15, [15, 22, 23]),
    (20, [20, 24, 25]),
    (21, [21, 26, 27]),
];

impl Fitter<'_> {
    /// An initial body from geometry only. Its points equal the targets if these lie on the skeleton.
    pub(super) fn start(&self, target: &KeypointFrame) -> Body {
        let mut global = [DQuat::IDENTITY; NUM_BODY_JOINTS];
        global[0] = self.aligned(target, 0).unwrap_or(DQuat::IDENTITY);
        global[9] = self.aligned(target, 9).unwrap_or(global[0]);
        global[3] = self.swung(slerp(global[0], global[9], 1.0 / 3.0), 3, target);
        global[6] = self.swung(slerp(global[0], global[9], 2.0 / 3.0), 6, target);
        let head = self.aligned(target, 15);
        global[12] = match head {
            Some(head) => self.swung(slerp(global[9], head, 0.5), 12, target),
            None => self.swung(global[9], 12, target),
        };
        global[15] = head.unwrap_or(global[12]);
        for (hip, knee, ankle) in [(1, 4, 7), (2, 5, 8)] {
            global[hip] = self.hinged(self.swung(global[0], hip, target), hip, target);
            global[knee] = self.hinged(self.swung(global[hip], knee, target), knee, target);
            global[ankle] = self.swung(global[knee], ankle, target);
        }
        for (collar, shoulder, elbow, wrist) in [(13, 16, 18, 20), (14, 17, 19, 21)] {
            global[collar] = self.swung(global[9], collar, target);
            global[shoulder] = self.hinged(
                self.swung(global[collar], shoulder, target),
                shoulder,
                target,
            );
            let untwisted = self.swung(global[shoulder], elbow, target);
            let hand = self.aligned(target, wrist);
            global[elbow] = match hand {
                Some(hand) => self.swung(slerp(untwisted, hand, 0.5), elbow, target),
                None => untwisted,
            };
            global[wrist] = hand.unwrap_or(global[elbow]);
        }
        Body {
            pelvis: target[0],
            global,
        }
    }

    /// An initial body with the twists of `init` and its bones turned towards the targets.
    pub(super) fn start_from(&self, target: &KeypointFrame, init: &Pose, held: f64) -> Body {
        let mut global = init.rotations;
        for joint in 0..NUM_BODY_JOINTS {
            if joint > 0 {
                global[joint] = global[parent_of(joint)] * init.rotations[joint];
            }
            global[joint] = self
                .aligned_near(target, joint, global[joint], held)
                .unwrap_or_else(|| self.swung(global[joint], joint, target));
        }
        Body {
            pelvis: target[0],
            global,
        }
    }

    /// The rotation of a joint by its triangle of points; `None` if it has none, or if one of the points has no weight.
    fn aligned(&self, target: &KeypointFrame, joint: usize) -> Option<DQuat> {
        self.aligned_near(target, joint, DQuat::IDENTITY, 0.0)
    }

    /// As [`Fitter::aligned`], regularised towards a rotation with a weight in m^2/rad^2.
    fn aligned_near(
        &self,
        target: &KeypointFrame,
        joint: usize,
        near: DQuat,
        held: f64,
    ) -> Option<DQuat> {
        let (_, slots) = TRIANGLES
            .into_iter()
            .find(|(carrier, _)| *carrier == joint)?;
        if slots.iter().any(|&slot| self.options.weights[slot] == 0.0) {
            return None;
        }
        let rest = slots.map(|slot| {
            if slot == joint {
                DVec3::ZERO
            } else {
                self.offsets[slot]
            }
        });
        let onto = slots.map(|slot| target[slot]);
        let (rotation, _) = kabsch_near(&rest, &onto, DMat3::from_quat(near), held);
        Some(DQuat::from_mat3(&rotation).normalize())
    }

    /// `base` with the smallest rotation that points the bone to the joint's only child at the target;
    /// `base` unchanged if that child has no weight.
    fn swung(&self, base: DQuat, joint: usize, target: &KeypointFrame) -> DQuat {
        let Some(&[child]) = TREE.children(joint).first_chunk::<1>() else {
            return base;
        };
        if self.options.weights[child] == 0.0 || self.options.weights[joint] == 0.0 {
            return base;
        }
        (arc(base * self.offsets[child], target[child] - target[joint]) * base).normalize()
    }

    /// `base` twisted about the bone below `joint` so that the next bone reaches its target by a rotation
    /// about the hinge alone. The twist is reduced for straight limbs and for large twists.
    fn hinged(&self, base: DQuat, joint: usize, target: &KeypointFrame) -> DQuat {
        let Some((_, hinge)) = HINGES.into_iter().find(|(limb, _)| *limb == joint) else {
            return base;
        };
        let middle = TREE.children[joint][0];
        let far = TREE.children[middle][0];
        if [joint, middle, far]
            .iter()
            .any(|&slot| self.options.weights[slot] == 0.0)
        {
            return base;
        }
        let next = base.inverse() * (target[far] - target[middle]);
        let (Some(bone), Some(rest), Some(next)) = (
            self.offsets[middle].try_normalize(),
            self.offsets[far].try_normalize(),
            next.try_normalize(),
        ) else {
            return base;
        };
        // A rotation about the hinge keeps the next bone's component along the hinge. Seen along this bone, the next
        // one must therefore be at the angle `wanted` from the hinge, towards flexion.
        let Some(across) = (hinge - bone * bone.dot(hinge)).try_normalize() else {
            return base;
        };
        let flexion = across.cross(bone);
        let seen = DVec2::new(next.dot(across), next.dot(flexion));
        let along = hinge.dot(rest) - hinge.dot(bone) * next.dot(bone);
        let reach = seen.length() * hinge.dot(across);
        if along.abs() >= reach {
            return base;
        }
        let wanted = (along / reach).acos();
        let twist = wanted - seen.to_angle();
        let bend = seen.length() * wanted.sin();
        let clear = bend * bend / (bend * bend + HINGE_SINE * HINGE_SINE);
        let plausible = 0.5 * (1.0 + twist.cos());
        let twist = twist.sin().atan2(twist.cos()) * clear * plausible;
        base * from_axis_angle(bone * twist)
    }
}
