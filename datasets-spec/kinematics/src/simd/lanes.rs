//! Elementary functions without branches or tables, so that the compiler turns a loop over them into
//! vector instructions, and dispatch to the widest vector instructions of the machine.
//!
//! [`crate::rotation`] uses the same functions for single rotations, and no multiply-add is fused:
//! one rotation and a block of rotations give the same bits, on every machine.
//!
//! The polynomials are Chebyshev fits made with 50 digits. Their relative error is below 3e-17, less
//! than half of a unit in the last place.

use pulp::Arch;

/// Numbers in a block: two vectors of `f64` with AVX-512, four with AVX2, eight with NEON.
pub const LANES: usize = 16;

/// Loops for [`dispatch`]. [`Kernel::run`] and everything it calls must be `#[inline(always)]`: a
/// function that is not inlined is compiled for the baseline instruction set.
pub trait Kernel {
    /// Result of the loops.
    type Output;

    /// Runs the loops.
    fn run(self) -> Self::Output;
}

/// Runs a kernel with the widest vector instructions of the machine. The result does not depend on
/// which those are.
pub fn dispatch<K: Kernel>(kernel: K) -> K::Output {
    struct Dispatched<K>(K);

    impl<K: Kernel> pulp::WithSimd for Dispatched<K> {
        type Output = K::Output;

        #[inline(always)]
        fn with_simd<S: pulp::Simd>(self, _: S) -> K::Output {
            self.0.run()
        }
    }

    Arch::new().dispatch(Dispatched(kernel))
}

/// Largest angle in radians that [`sin_cos`] reduces without loss.
pub const MAX_ANGLE: f64 = 1e6;

/// Below this angle in radians, sin(angle) equals the angle in double precision.
const SMALL_ANGLE: f64 = 1e-9;

/// Sine and cosine of an angle in radians, correct to 2 units in the last place of 1 for angles up
/// to [`MAX_ANGLE`].
#[inline(always)]
pub fn sin_cos(angle: f64) -> (f64, f64) {
    /// Adding and subtracting this constant rounds to an integer, which is then in the lowest bits of the sum.
    const SHIFT: f64 = 6_755_399_441_055_744.0;
    /// Pi / 2 in parts, the first two so short that their products with a count of quarter turns
    /// are exact.
    const HALF_PI: [f64; 3] = [
        1.570_796_326_734_125_6,
        6.077_100_506_303_966e-11,
        2.022_266_248_795_950_6e-21,
    ];
    const SIN: [f64; 6] = [
        -0.166_666_666_666_666_66,
        0.008_333_333_333_330_936,
        -0.000_198_412_698_367_405_32,
        2.755_731_609_319_840_4e-6,
        -2.505_112_989_645_018_5e-8,
        1.591_798_897_973_943_2e-10,
    ];
    const COS: [f64; 6] = [
        0.041_666_666_666_666_664,
        -0.001_388_888_888_888_738_9,
        2.480_158_729_875_44e-5,
        -2.755_731_726_587_808e-7,
        2.087_614_504_941_318e-9,
        -1.138_254_464_534_925e-11,
    ];
    const SIGN: u64 = 1 << 63;

    let shifted = angle * std::f64::consts::FRAC_2_PI + SHIFT;
    let quarters = shifted.to_bits();
    let turns = shifted - SHIFT;
    let x = ((angle - turns * HALF_PI[0]) - turns * HALF_PI[1]) - turns * HALF_PI[2];
    let square = x * x;
    let sine = x + x * square * series(&SIN, square);
    let cosine = 1.0 - 0.5 * square + square * square * series(&COS, square);
    let odd = quarters & 1 != 0;
    let (s, c) = if odd { (cosine, sine) } else { (sine, cosine) };
    // The sine changes sign after half a turn, the cosine after a quarter.
    let sine_sign = (quarters << 62) & SIGN;
    let cosine_sign = ((quarters + 1) << 62) & SIGN;
    (
        f64::from_bits(s.to_bits() ^ sine_sign),
        f64::from_bits(c.to_bits() ^ cosine_sign),
    )
}

/// The angle in [0, pi / 2] whose sine and cosine are in the given ratio; neither may be negative. 0 if both are 0.
#[inline(always)]
pub fn angle_of(sine: f64, cosine: f64) -> f64 {
    /// Tangent and cotangent of an eighth of pi.
    const LOW: f64 = std::f64::consts::SQRT_2 - 1.0;
    const HIGH: f64 = std::f64::consts::SQRT_2 + 1.0;
    const ATAN: [f64; 11] = [
        -0.333_333_333_333_333_3,
        0.199_999_999_999_954_8,
        -0.142_857_142_846_578_94,
        0.111_111_110_145_610_13,
        -0.090_909_045_498_846_11,
        0.076_921_825_351_166_48,
        -0.066_645_022_156_714_47,
        0.058_580_687_568_615_106,
        -0.050_850_304_928_109_41,
        0.039_219_552_532_551_29,
        -0.019_162_068_915_902_577,
    ];
    // Reduce to a tangent within pi / 8 of 0, pi / 4 or pi / 2.
    let steep = sine > HIGH * cosine;
    let flat = sine <= LOW * cosine;
    let (over, under, base) = if flat {
        (sine, cosine, 0.0)
    } else if steep {
        (-cosine, sine, std::f64::consts::FRAC_PI_2)
    } else {
        (sine - cosine, sine + cosine, std::f64::consts::FRAC_PI_4)
    };
    let under = if under == 0.0 { 1.0 } else { under };
    let x = over / under;
    let square = x * x;
    base + (x + x * square * series(&ATAN, square))
}

/// A polynomial, its constant coefficient first.
#[inline(always)]
fn series<const N: usize>(coefficients: &[f64; N], x: f64) -> f64 {
    let mut sum = coefficients[N - 1];
    let mut at = N - 1;
    while at > 0 {
        at -= 1;
        sum = sum * x + coefficients[at];
    }
    sum
}

/// The quaternion `[x, y, z, w]` of the rotation by `|v|` radians about `v`, for lengths up to twice
/// [`MAX_ANGLE`].
#[inline(always)]
pub fn quaternion(v: [f64; 3]) -> [f64; 4] {
    let half = 0.5 * (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    let (sine, cosine) = sin_cos(half);
    // Half of sin(x) / x; below the small angle it is 1/2 to the last digit.
    let small = half < SMALL_ANGLE;
    let divisor = if small { 1.0 } else { half };
    let scale = if small { 0.5 } else { 0.5 * sine / divisor };
    [v[0] * scale, v[1] * scale, v[2] * scale, cosine]
}

/// The rotation vector of a unit quaternion, its length in [0, pi].
#[inline(always)]
pub fn rotation_vector(q: [f64; 4]) -> [f64; 3] {
    let sign = if q[3] < 0.0 { -1.0 } else { 1.0 };
    let [x, y, z, w] = q.map(|part| part * sign);
    let sine = (x * x + y * y + z * z).sqrt();
    let angle = angle_of(sine, w);
    let small = sine < SMALL_ANGLE;
    let divisor = if small { 1.0 } else { sine };
    let scale = if small {
        2.0
    } else {
        (angle + angle) / divisor
    };
    [x * scale, y * scale, z * scale]
}

/// Spherical interpolation along the shorter arc, as a unit quaternion.
///
/// The angle is taken from the chords, so nearly equal rotations keep all digits.
#[inline(always)]
pub fn slerp(from: [f64; 4], to: [f64; 4], alpha: f64) -> [f64; 4] {
    let dot = from[0] * to[0] + from[1] * to[1] + from[2] * to[2] + from[3] * to[3];
    let sign = if dot < 0.0 { -1.0 } else { 1.0 };
    let (mut chord, mut sum) = (0.0, 0.0);
    for part in 0..4 {
        let to = to[part] * sign;
        let (less, more) = (to - from[part], to + from[part]);
        chord += less * less;
        sum += more * more;
    }
    let half = angle_of(chord.sqrt(), sum.sqrt());
    let angle = half + half;
    let near = angle < SMALL_ANGLE;
    let beta = 1.0 - alpha;
    // The common factor of both weights cancels in the normalisation.
    let first = sin_cos(beta * angle).0;
    let second = sin_cos(alpha * angle).0;
    let first = if near { beta } else { first };
    let second = (if near { alpha } else { second }) * sign;
    let mixed = [0, 1, 2, 3].map(|part| from[part] * first + to[part] * second);
    let length =
        (mixed[0] * mixed[0] + mixed[1] * mixed[1] + mixed[2] * mixed[2] + mixed[3] * mixed[3])
            .sqrt();
    mixed.map(|part| part / length)
}

/// The product of two quaternions: the rotation `b`, then `a`.
#[inline(always)]
pub fn product(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
    let [ax, ay, az, aw] = a;
    let [bx, by, bz, bw] = b;
    [
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    ]
}

/// A vector rotated by a unit quaternion.
#[inline(always)]
pub fn rotated(q: [f64; 4], v: [f64; 3]) -> [f64; 3] {
    let [x, y, z, w] = q;
    // v + 2 w (u x v) + 2 u x (u x v), with u the vector part.
    let cross = [
        y * v[2] - z * v[1],
        z * v[0] - x * v[2],
        x * v[1] - y * v[0],
    ];
    let t = cross.map(|part| part + part);
    [
        v[0] + w * t[0] + (y * t[2] - z * t[1]),
        v[1] + w * t[1] + (z * t[0] - x * t[2]),
        v[2] + w * t[2] + (x * t[1] - y * t[0]),
    ]
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    struct Tripled<'a> {
        v: &'a [[f64; 3]],
        alpha: f64,
    }

    impl Kernel for Tripled<'_> {
        type Output = [[f64; LANES]; 3];

        #[inline(always)]
        fn run(self) -> Self::Output {
            let mut planes = [[0.0; LANES]; 3];
            for (lane, v) in self.v.iter().enumerate() {
                let q = quaternion(*v);
                let out = rotation_vector(slerp(q, product(q, q), self.alpha));
                for axis in 0..3 {
                    planes[axis][lane] = out[axis];
                }
            }
            planes
        }
    }

    proptest! {
        #[test]
        fn sines_and_cosines_are_those_of_the_library(x in -1e3f64..1e3, far in -1e6f64..1e6) {
            for x in [x, far, x * 1e-6] {
                let (sine, cosine) = sin_cos(x);
                prop_assert!((sine - x.sin()).abs() <= 2.0 * f64::EPSILON, "{x}: {sine}");
                prop_assert!((cosine - x.cos()).abs() <= 2.0 * f64::EPSILON, "{x}: {cosine}");
            }
        }

        #[test]
        fn angles_are_those_of_the_library(sine in 0.0f64..1.0, cosine in 0.0f64..1.0) {
            let (found, expected) = (angle_of(sine, cosine), sine.atan2(cosine));
            prop_assert!((found - expected).abs() <= 4.0 * f64::EPSILON, "{found} {expected}");
        }

        #[test]
        fn a_block_has_the_bits_of_single_numbers(
            v in prop::collection::vec(prop::array::uniform3(-4.0f64..4.0), LANES),
            alpha in 0.0..1.0f64,
        ) {
            let single: Vec<[f64; 3]> = v
                .iter()
                .map(|&v| {
                    let q = quaternion(v);
                    rotation_vector(slerp(q, product(q, q), alpha))
                })
                .collect();
            let planes = dispatch(Tripled { v: &v, alpha });
            for (lane, single) in single.iter().enumerate() {
                prop_assert_eq!(*single, [0, 1, 2].map(|axis| planes[axis][lane]));
            }
        }
    }

    #[test]
    fn the_ends_of_the_range_are_exact() {
        assert_eq!(sin_cos(0.0), (0.0, 1.0));
        assert_eq!(angle_of(0.0, 0.0), 0.0);
        assert_eq!(angle_of(0.0, 1.0), 0.0);
        assert_eq!(angle_of(1.0, 0.0), std::f64::consts::FRAC_PI_2);
        let none = [0.0, 0.0, 0.0, 1.0];
        assert_eq!(quaternion([0.0; 3]), none);
        assert_eq!(rotation_vector(none), [0.0; 3]);
        assert_eq!(slerp(none, none, 0.3), none);
    }
}
