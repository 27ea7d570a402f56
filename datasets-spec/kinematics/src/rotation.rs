//! Conversions between the forms of a rotation, and spherical interpolation.
//!
//! Rotations are stored as `f32` axis-angle, but computed in `f64`, so that a chain of joints adds no error of its own.
//! Matrices act on column vectors.

use glam::{DMat3, DQuat, DVec3, Quat};

use crate::simd::lanes;

/// Longest rotation vector that is not reduced modulo 2 pi.
pub(crate) const MAX_TURN: f64 = 2.0 * lanes::MAX_ANGLE;
/// Half-angle sine below which the released code replaces spherical interpolation by a plain
/// average (`algorithms`: official slerp).
const OFFICIAL_SLERP_EPS: f32 = 1e-3;

/// The rotation by `|v|` radians about `v`.
pub fn from_axis_angle(v: DVec3) -> DQuat {
    let length = v.length();
    // Reduce very large angles modulo 2 pi to keep precision.
    let v = if length > MAX_TURN {
        v * (length % std::f64::consts::TAU / length)
    } else {
        v
    };
    DQuat::from_array(lanes::quaternion(v.to_array()))
}

/// The rotation vector of a unit quaternion, its length in [0, pi].
pub fn to_axis_angle(q: DQuat) -> DVec3 {
    DVec3::from_array(lanes::rotation_vector(q.to_array()))
}

/// The first two rows of a rotation matrix: the 6D form of PyTorch3D, MotionFix and MotionRefit.
pub fn to_six_d_rows(m: DMat3) -> [f64; 6] {
    let (a, b) = (m.row(0), m.row(1));
    [a.x, a.y, a.z, b.x, b.y, b.z]
}

/// The rotation matrix whose first two rows are the two given vectors after Gram-Schmidt: the inverse of
/// [`to_six_d_rows`]. A first vector of length zero becomes x; a second one that is zero or parallel to the first
/// becomes any vector orthogonal to it.
pub fn from_six_d_rows(d: [f64; 6]) -> DMat3 {
    let a = DVec3::new(d[0], d[1], d[2])
        .try_normalize()
        .unwrap_or(DVec3::X);
    let b = DVec3::new(d[3], d[4], d[5]);
    let b = (b - a * a.dot(b))
        .try_normalize()
        .unwrap_or_else(|| a.any_orthonormal_vector());
    DMat3::from_cols(a, b, a.cross(b)).transpose()
}

/// As [`from_six_d_rows`], for the first two columns: the 6D form of HumanML3D.
pub fn from_six_d_columns(d: [f64; 6]) -> DMat3 {
    from_six_d_rows(d).transpose()
}

/// The heading of a rotation in radians: its angle about +y in the order yaw, tilt, roll (the third angle of scipy's
/// extrinsic "zxy"), which is the direction of the rotated +z axis, seen from above.
pub fn yaw(m: DMat3) -> f64 {
    m.z_axis.x.atan2(m.z_axis.z)
}

/// Spherical interpolation along the shorter arc: `from` at `alpha` 0, `to` at 1.
///
/// The angle is taken from the chord lengths, so the result keeps full precision for nearly equal
/// rotations, where the usual arc cosine loses half of the digits.
pub fn slerp(from: DQuat, to: DQuat, alpha: f64) -> DQuat {
    DQuat::from_array(lanes::slerp(from.to_array(), to.to_array(), alpha))
}

/// Spherical interpolation as the released MotionReFit code computes it, in `f32`. If the sine of the half angle is
/// below 1e-3, it returns the plain average for any `alpha`; if the cosine is 1 or more, it returns `from`. Only the
/// `official` preset uses it.
pub fn slerp_official(from: Quat, to: Quat, alpha: f32) -> Quat {
    let mut cosine = from.dot(to);
    let to = if cosine < 0.0 { -to } else { to };
    cosine = cosine.abs();
    if cosine >= 1.0 {
        return from;
    }
    let angle = cosine.acos();
    let sine = (1.0 - cosine * cosine).sqrt();
    if sine.abs() < OFFICIAL_SLERP_EPS {
        return from * 0.5 + to * 0.5;
    }
    from * (((1.0 - alpha) * angle).sin() / sine) + to * ((alpha * angle).sin() / sine)
}

/// The angle of the rotation that carries `a` to `b`, in radians, in [0, pi].
pub fn angle_between(a: DQuat, b: DQuat) -> f64 {
    let b = if a.dot(b) < 0.0 { -b } else { b };
    4.0 * (b - a).length().atan2((b + a).length())
}

/// The smallest rotation that carries the direction of `from` to that of `to`; the identity if
/// either has no direction.
pub fn arc(from: DVec3, to: DVec3) -> DQuat {
    match (from.try_normalize(), to.try_normalize()) {
        (Some(from), Some(to)) => DQuat::from_rotation_arc(from, to),
        _ => DQuat::IDENTITY,
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use proptest::prelude::*;

    use super::*;
    use crate::fit::tests::vector;

    #[test]
    fn a_quarter_turn_about_y_carries_z_to_x() {
        let q = from_axis_angle(DVec3::Y * FRAC_PI_2);
        assert!((q * DVec3::Z - DVec3::X).length() < 1e-15);
        assert!((yaw(DMat3::from_quat(q)) - FRAC_PI_2).abs() < 1e-15);
    }

    #[test]
    fn tiny_rotations_survive() {
        for size in [1e-3, 1e-5, 1e-9, 1e-15, 0.0] {
            let v = DVec3::new(0.6, -0.8, 0.0) * size;
            assert!((to_axis_angle(from_axis_angle(v)) - v).length() <= 1e-15 * size.max(1e-3));
        }
    }

    proptest! {
        #[test]
        fn axis_angle_round_trips_as_a_rotation(v in vector(4.0)) {
            let q = from_axis_angle(v);
            let back = from_axis_angle(to_axis_angle(q));
            prop_assert!(angle_between(q, back) < 1e-12);
            prop_assert!(to_axis_angle(q).length() <= PI + 1e-12);
        }

        #[test]
        fn six_d_round_trips(v in vector(4.0)) {
            let m = DMat3::from_quat(from_axis_angle(v));
            prop_assert!(from_six_d_rows(to_six_d_rows(m)).abs_diff_eq(m, 1e-12));
            prop_assert!(from_six_d_columns(to_six_d_rows(m.transpose())).abs_diff_eq(m, 1e-12));
        }

        #[test]
        fn slerp_moves_at_constant_speed(a in vector(4.0), b in vector(4.0), alpha in 0.0..1.0f64) {
            let (a, b) = (from_axis_angle(a), from_axis_angle(b));
            let whole = angle_between(a, b);
            let part = angle_between(a, slerp(a, b, alpha));
            prop_assert!((part - alpha * whole).abs() < 1e-9);
        }

        #[test]
        fn an_arc_carries_one_direction_to_the_other(a in vector(4.0), b in vector(4.0)) {
            prop_assume!(a.length() > 1e-3 && b.length() > 1e-3);
            prop_assert!((arc(a, b) * a.normalize() - b.normalize()).length() < 1e-9);
        }
    }
}
