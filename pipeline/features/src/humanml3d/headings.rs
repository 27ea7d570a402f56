//! Heading of the root in every frame.

use kinematics::simd::lanes::{self, Kernel, LANES};

/// Cosines and sines of the headings of a block and of the frame after it.
pub(super) type Angles<'a> = (&'a [f64; LANES + 1], &'a [f64; LANES + 1]);

/// Standard deviation in frames of the Gaussian that smooths the forward vector, and its radius: four
/// standard deviations, as in SciPy.
const SMOOTHING_FRAMES: f64 = 20.0;
const SMOOTHING_REACH: usize = 80;
/// Frames smoothed at a time: their sums stay in registers.
const SMOOTHED_AT_ONCE: usize = 8;

/// The rotation about the vertical from the root's heading to +z: sine and cosine of the angle and of its half. There
/// is one for every frame of a clip, padded to whole blocks, and one more.
pub(super) struct Headings {
    cosine: Vec<f64>,
    sine: Vec<f64>,
    half_cosine: Vec<f64>,
    half_sine: Vec<f64>,
}

impl Headings {
    /// Smooths the forward vectors of at least one frame. As published, the first frame counts as facing +z, whatever
    /// its forward vector says.
    pub(super) fn of(forwards: &[[f64; 2]]) -> Self {
        let count = forwards.len().next_multiple_of(LANES) + 1;
        let mut headings = Self {
            cosine: smoothed(forwards, 1, count),
            sine: smoothed(forwards, 0, count),
            half_cosine: vec![1.0; count],
            half_sine: vec![0.0; count],
        };
        let halves = headings.half_cosine.iter_mut().zip(&mut headings.half_sine);
        let wholes = headings.cosine.iter_mut().zip(&mut headings.sine);
        for ((cosine, sine), (half_cosine, half_sine)) in wholes.zip(halves) {
            let (ahead, aside) = (*cosine, -*sine);
            let length = (ahead * ahead + aside * aside).sqrt();
            // A forward vector without length counts as +z.
            let inverse = if length > 0.0 { 1.0 / length } else { 0.0 };
            *cosine = if length > 0.0 { ahead * inverse } else { 1.0 };
            *sine = aside * inverse;
            // The half-angle is within a quarter turn. Compute the larger component first, to avoid
            // cancellation in the other.
            let larger = (0.5 + 0.5 * cosine.abs()).sqrt();
            let smaller = 0.5 * sine.abs() / larger;
            let sign = if *sine < 0.0 { -1.0 } else { 1.0 };
            let in_front = *cosine >= 0.0;
            *half_cosine = if in_front { larger } else { smaller };
            *half_sine = if in_front { smaller } else { larger } * sign;
        }
        headings.cosine[0] = 1.0;
        headings.sine[0] = 0.0;
        headings.half_cosine[0] = 1.0;
        headings.half_sine[0] = 0.0;
        headings
    }

    /// Cosines and sines of a block and of the frame after it.
    pub(super) fn block(&self, index: usize) -> Angles<'_> {
        (run(&self.cosine, index), run(&self.sine, index))
    }

    /// The half-angle from each frame of a block to the next, computed from the sine alone. This gives the published
    /// sign for a step across the back, where the half-angle jumps.
    pub(super) fn write_yaw_velocity(&self, index: usize, column: &mut [f32; LANES]) {
        let (cosine, sine) = (run(&self.half_cosine, index), run(&self.half_sine, index));
        for (lane, value) in column.iter_mut().enumerate() {
            let turned = sine[lane + 1] * cosine[lane] - cosine[lane + 1] * sine[lane];
            *value = turned.asin() as f32;
        }
    }
}

fn run(values: &[f64], index: usize) -> &[f64; LANES + 1] {
    values[index * LANES..]
        .first_chunk()
        .expect("headings reach one frame past the last block")
}

/// Smooths one coordinate of the frames by the Gaussian. The end frames are repeated, and `count` values returned.
fn smoothed(values: &[[f64; 2]], coordinate: usize, count: usize) -> Vec<f64> {
    let last = values.len() - 1;
    let chunks = count.div_ceil(SMOOTHED_AT_ONCE);
    let padded: Vec<f64> = (0..chunks * SMOOTHED_AT_ONCE + 2 * SMOOTHING_REACH)
        .map(|index| values[index.saturating_sub(SMOOTHING_REACH).min(last)][coordinate])
        .collect();
    let mut smoothed = vec![[0.0; SMOOTHED_AT_ONCE]; chunks];
    lanes::dispatch(Smooth {
        padded: &padded,
        weights: &weights(),
        smoothed: &mut smoothed,
    });
    let mut smoothed = smoothed.into_flattened();
    smoothed.truncate(count);
    smoothed
}

struct Smooth<'a> {
    padded: &'a [f64],
    weights: &'a [f64; SMOOTHING_REACH + 1],
    smoothed: &'a mut [[f64; SMOOTHED_AT_ONCE]],
}

impl Kernel for Smooth<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        for (chunk, sums) in self.smoothed.iter_mut().enumerate() {
            let window = &self.padded[chunk * SMOOTHED_AT_ONCE..];
            let window = &window[..SMOOTHED_AT_ONCE + 2 * SMOOTHING_REACH];
            for (sum, value) in sums.iter_mut().zip(&window[SMOOTHING_REACH..]) {
                *sum = self.weights[0] * value;
            }
            for (step, weight) in self.weights.iter().enumerate().skip(1) {
                let before = &window[SMOOTHING_REACH - step..][..SMOOTHED_AT_ONCE];
                let after = &window[SMOOTHING_REACH + step..][..SMOOTHED_AT_ONCE];
                for lane in 0..SMOOTHED_AT_ONCE {
                    sums[lane] += weight * (before[lane] + after[lane]);
                }
            }
        }
    }
}

/// Weights of the Gaussian from its centre outwards.
fn weights() -> [f64; SMOOTHING_REACH + 1] {
    let gaussian: [f64; SMOOTHING_REACH + 1] =
        std::array::from_fn(|step| (-0.5 * (step as f64 / SMOOTHING_FRAMES).powi(2)).exp());
    let [centre, side @ ..] = &gaussian;
    let sum = centre + 2.0 * side.iter().sum::<f64>();
    gaussian.map(|weight| weight / sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_steady_heading_is_kept_and_the_first_is_none() {
        for angle in [0.0, 0.3, -1.9, 3.0, std::f64::consts::PI] {
            let forwards = vec![[f64::sin(angle), f64::cos(angle)]; 40];
            let headings = Headings::of(&forwards);
            assert_eq!((headings.cosine[0], headings.half_sine[0]), (1.0, 0.0));
            for frame in 1..40 {
                // The heading rotates the forward direction back to +z.
                assert!((headings.cosine[frame] - angle.cos()).abs() < 1e-12);
                assert!((headings.sine[frame] + angle.sin()).abs() < 1e-12);
                assert!((headings.half_cosine[frame] - (0.5 * angle).cos()).abs() < 1e-12);
                // A half turn is the same in either direction.
                let expected = -(0.5 * angle).sin();
                let apart = (headings.half_sine[frame] - expected).abs();
                assert!(apart < 1e-12 || angle == std::f64::consts::PI && apart > 2.0 - 1e-12);
            }
        }
    }

    #[test]
    fn smoothing_is_the_weighted_mean_of_what_is_near() {
        let values: Vec<[f64; 2]> = (0..300).map(|i| [0.0, (0.1 * i as f64).sin()]).collect();
        let found = smoothed(&values, 1, 300);
        let weights = weights();
        for frame in [0, 1, 79, 150, 299] {
            let expected: f64 = (-80i64..=80)
                .map(|step| {
                    let at = (frame + step).clamp(0, 299) as usize;
                    weights[step.unsigned_abs() as usize] * values[at][1]
                })
                .sum();
            // Sums of 161 numbers below one.
            assert!((found[frame as usize] - expected).abs() < 1e-13);
        }
    }

    #[test]
    fn a_forward_vector_without_length_is_no_heading() {
        let headings = Headings::of(&[[0.0, 0.0]; 5]);
        assert!(headings.cosine.iter().all(|&cosine| cosine == 1.0));
        assert!(headings.sine.iter().all(|&sine| sine == 0.0));
    }
}
