//! Two-bone inverse kinematics with a hinge, for arms and legs.

use datasets_spec::{Joint, Skeleton};
use glam::{DMat3, DQuat, DVec3};
use kinematics::rotation::arc;

/// A limb of two bones whose middle joint is a hinge, so that a knee or an elbow only bends as on a body.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limb {
    /// First bone at rest, from the root joint to the hinge.
    upper: DVec3,
    /// Second bone at rest, from the hinge to the end.
    lower: DVec3,
    /// Axis about which a positive angle bends the hinge, in the frame of the first bone.
    hinge: DVec3,
    /// Hinge angle at which the limb is longest.
    straight: f64,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct LimbPose {
    /// Global rotation of the first bone.
    pub(super) upper: DQuat,
    /// Rotation of the second bone relative to the first, about the hinge axis.
    pub(super) hinge: DQuat,
}

impl Limb {
    /// The leg that ends at the given ankle: the knee bends backwards, about the lateral axis.
    pub(super) fn leg(skeleton: &Skeleton, hip: Joint, knee: Joint, ankle: Joint) -> Self {
        debug_assert_eq!(knee.parent(), Some(hip));
        Self::new(skeleton, knee, ankle, DVec3::X)
    }

    /// The arm that ends at the given wrist: in the T-pose the elbow bends forwards, about the
    /// vertical axis.
    pub(super) fn arm(skeleton: &Skeleton, elbow: Joint, wrist: Joint) -> Self {
        let side = skeleton.offset(elbow.index()).x.signum();
        Self::new(skeleton, elbow, wrist, DVec3::NEG_Y * side)
    }

    fn new(skeleton: &Skeleton, middle: Joint, end: Joint, hinge: DVec3) -> Self {
        let (upper, lower) = (
            skeleton.offset(middle.index()),
            skeleton.offset(end.index()),
        );
        let mut limb = Self {
            upper,
            lower,
            hinge,
            straight: 0.0,
        };
        let (_, cosine, sine) = limb.extent();
        limb.straight = sine.atan2(cosine);
        limb
    }

    /// Coefficients `(c, a, b)` of the half squared distance from the root to the end,
    /// `c + a cos(angle) + b sin(angle)`.
    fn extent(&self) -> (f64, f64, f64) {
        let along = self.upper.dot(self.hinge) * self.lower.dot(self.hinge);
        (
            0.5 * (self.upper.length_squared() + self.lower.length_squared()) + along,
            self.upper.dot(self.lower) - along,
            self.upper.dot(self.hinge.cross(self.lower)),
        )
    }

    /// Distance from the root to the end when the hinge is bent by `bend` radians from straight.
    pub(super) fn reach(&self, bend: f64) -> f64 {
        let (constant, cosine, sine) = self.extent();
        (2.0 * (constant + cosine.hypot(sine) * bend.cos())).sqrt()
    }

    /// Bend of the hinge from straight, in [0, pi], for a given distance of the end from the root. Distances out
    /// of reach give the nearest bend.
    pub(super) fn bend_at(&self, distance: f64) -> f64 {
        let (constant, cosine, sine) = self.extent();
        let cos_bend = (0.5 * distance * distance - constant) / cosine.hypot(sine);
        cos_bend.clamp(-1.0, 1.0).acos()
    }

    /// Places the limb: its end lies in the direction `to_end` from its root, at the distance that `bend` gives, and
    /// the hinge bulges towards `pole`.
    ///
    /// If the pole lies along the limb, the hinge may bulge in any direction.
    pub(super) fn place(&self, to_end: DVec3, bend: f64, pole: DVec3) -> LimbPose {
        let hinge = DQuat::from_axis_angle(self.hinge, self.straight + bend);
        let rest = frame(self.upper + hinge * self.lower, self.hinge);
        let placed = frame(to_end, pole.cross(to_end));
        LimbPose {
            upper: DQuat::from_mat3(&(placed * rest.transpose())),
            hinge,
        }
    }

    /// The signed bend of a hinge rotation from straight in radians: negative if it bends the
    /// wrong way.
    #[cfg(test)]
    pub(super) fn bend_of(&self, hinge: DQuat) -> f64 {
        let axis_angle = kinematics::rotation::to_axis_angle(hinge);
        axis_angle.dot(self.hinge) - self.straight
    }
}

/// The right-handed orthonormal frame whose first axis is `along` and whose second is the part of `across` orthogonal
/// to it.
fn frame(along: DVec3, across: DVec3) -> DMat3 {
    let first = along.try_normalize().unwrap_or(DVec3::NEG_Y);
    let second = (across - first * first.dot(across))
        .try_normalize()
        .unwrap_or_else(|| first.any_orthonormal_vector());
    DMat3::from_cols(first, second, first.cross(second))
}

/// Interpolates two directions along the shorter great circle.
pub(super) fn slerp_direction(from: DVec3, to: DVec3, alpha: f64) -> DVec3 {
    DQuat::IDENTITY.slerp(arc(from, to), alpha) * from
}

#[cfg(test)]
pub(super) mod tests {
    use proptest::prelude::*;

    use super::*;

    /// The legs and the arms, the left one of each first.
    pub(crate) fn limbs() -> [Limb; 4] {
        let skeleton = Skeleton::smplx_neutral();
        [
            Limb::leg(&skeleton, Joint::LeftHip, Joint::LeftKnee, Joint::LeftAnkle),
            Limb::leg(
                &skeleton,
                Joint::RightHip,
                Joint::RightKnee,
                Joint::RightAnkle,
            ),
            Limb::arm(&skeleton, Joint::LeftElbow, Joint::LeftWrist),
            Limb::arm(&skeleton, Joint::RightElbow, Joint::RightWrist),
        ]
    }

    #[test]
    fn a_knee_bulges_forward_and_an_elbow_backward() {
        let [leg, _, arm, _] = limbs();
        let leg = (leg, leg.place(DVec3::NEG_Y, 1.0, DVec3::Z));
        assert!((leg.1.upper * leg.0.upper).z > 0.1);
        let arm = (arm, arm.place(DVec3::NEG_Y, 1.0, DVec3::NEG_Z));
        assert!((arm.1.upper * arm.0.upper).z < -0.1);
        // The palm, which faces down in the T-pose, faces the thigh of a hanging arm.
        assert!((arm.1.upper * DVec3::NEG_Y).x < -0.9);
    }

    proptest! {
        #[test]
        fn a_placed_limb_ends_where_asked(
            target in prop::array::uniform3(-1.0..1.0f64),
            pole in prop::array::uniform3(-1.0..1.0f64),
            bend in 0.05..2.5f64,
        ) {
            let (target, pole) = (DVec3::from_array(target), DVec3::from_array(pole));
            prop_assume!(target.cross(pole).length() > 1e-3);
            for limb in limbs() {
                let pose = limb.place(target, bend, pole);
                let knee = pose.upper * limb.upper;
                let end = knee + pose.upper * (pose.hinge * limb.lower);
                prop_assert!((end - target.normalize() * limb.reach(bend)).length() < 1e-9);
                prop_assert!((limb.bend_at(end.length()) - bend).abs() < 1e-6);
                prop_assert!((limb.bend_of(pose.hinge) - bend).abs() < 1e-9);
            }
        }

        #[test]
        fn directions_interpolate_on_the_sphere(
            from in prop::array::uniform3(-1.0..1.0f64),
            to in prop::array::uniform3(-1.0..1.0f64),
            alpha in 0.0..1.0f64,
        ) {
            let (from, to) = (DVec3::from_array(from), DVec3::from_array(to));
            prop_assume!(from.length() > 1e-2 && to.length() > 1e-2);
            let (from, to) = (from.normalize(), to.normalize());
            let between = slerp_direction(from, to, alpha);
            prop_assert!((between.length() - 1.0).abs() < 1e-9);
            prop_assert!((between.angle_between(from) - alpha * to.angle_between(from)).abs() < 1e-6);
        }
    }
}
