//! Curves over time: keyframes, slow noise, and filters over sampled signals.

use std::f64::consts::TAU;

use datasets_spec::Rng;
use rand::RngExt;

/// Keyframes of `N` numbers, joined by a monotone cubic. It passes through every key, never overshoots between two of
/// them, and is exactly constant between equal ones, so that a planted foot stays planted. Before the first and after
/// the last key it holds their value.
///
/// # Source
/// Fritsch and Butland, "A method for constructing local monotone piecewise cubic interpolants",
/// SIAM J. Sci. Stat. Comput. 5(2), 1984.
#[derive(Clone, Debug)]
pub(super) struct Track<const N: usize> {
    times: Vec<f64>,
    values: Vec<[f64; N]>,
    slopes: Vec<[f64; N]>,
}

impl<const N: usize> Track<N> {
    /// A track through the keys, which may come in any order; constantly zero without keys.
    ///
    /// # Panics
    /// If two keys share a time.
    pub(super) fn new(mut keys: Vec<(f64, [f64; N])>) -> Self {
        if keys.is_empty() {
            keys.push((0.0, [0.0; N]));
        }
        keys.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (times, values): (Vec<f64>, Vec<[f64; N]>) = keys.into_iter().unzip();
        assert!(
            times.windows(2).all(|pair| pair[0] < pair[1]),
            "two keys share a time: {times:?}"
        );
        let slopes = (0..times.len())
            .map(|key| std::array::from_fn(|axis| slope(&times, &values, key, axis)))
            .collect();
        Self {
            times,
            values,
            slopes,
        }
    }

    /// The value at a time in seconds.
    pub(super) fn at(&self, secs: f64) -> [f64; N] {
        let after = self.times.partition_point(|&time| time <= secs);
        if after == 0 {
            return self.values[0];
        }
        if after == self.times.len() {
            return self.values[after - 1];
        }
        let before = after - 1;
        let span = self.times[after] - self.times[before];
        let u = (secs - self.times[before]) / span;
        // The cubic Hermite basis.
        let (u2, u3) = (u * u, u * u * u);
        let from = 2.0 * u3 - 3.0 * u2 + 1.0;
        let to = 3.0 * u2 - 2.0 * u3;
        let from_slope = (u3 - 2.0 * u2 + u) * span;
        let to_slope = (u3 - u2) * span;
        std::array::from_fn(|axis| {
            from * self.values[before][axis]
                + to * self.values[after][axis]
                + from_slope * self.slopes[before][axis]
                + to_slope * self.slopes[after][axis]
        })
    }
}

/// The slope of one component at a key: zero at the ends and at local extrema, the weighted
/// harmonic mean of the neighbouring secants elsewhere.
fn slope<const N: usize>(times: &[f64], values: &[[f64; N]], key: usize, axis: usize) -> f64 {
    if key == 0 || key + 1 == times.len() {
        return 0.0;
    }
    let (before, after) = (times[key] - times[key - 1], times[key + 1] - times[key]);
    let left = (values[key][axis] - values[key - 1][axis]) / before;
    let right = (values[key + 1][axis] - values[key][axis]) / after;
    if left * right <= 0.0 {
        return 0.0;
    }
    let (left_weight, right_weight) = (2.0 * after + before, after + 2.0 * before);
    (left_weight + right_weight) / (left_weight / left + right_weight / right)
}

/// Slow, smooth, aperiodic-looking noise: the small motions of a body that stands still.
#[derive(Clone, Debug)]
pub(super) struct Wobble {
    waves: [(f64, f64, f64); 3],
}

impl Wobble {
    /// Noise whose standard deviation is about `amplitude` and whose frequencies lie around `hz`.
    pub(super) fn new(rng: &mut Rng, amplitude: f64, hz: f64) -> Self {
        // Three waves of incommensurate frequency do not repeat within a clip. Each has the
        // variance amplitude^2 / 3.
        let size = amplitude * (2.0f64 / 3.0).sqrt();
        Self {
            waves: [0.55, 1.0, 1.62].map(|ratio| {
                (
                    TAU * hz * ratio * rng.random_range(0.85..1.15),
                    rng.random_range(0.0..TAU),
                    size * rng.random_range(0.7..1.3),
                )
            }),
        }
    }

    /// The value at a time in seconds.
    pub(super) fn at(&self, secs: f64) -> f64 {
        self.waves
            .iter()
            .map(|(rate, phase, size)| size * (rate * secs + phase).sin())
            .sum()
    }
}

/// The ease from 0 at `u` 0 to 1 at `u` 1 with zero speed and acceleration at both ends, the
/// profile of an unhurried reach.
///
/// # Source
/// Flash and Hogan, "The coordination of arm movements", J. Neurosci. 5(7), 1985: minimum jerk.
pub(super) fn ease(u: f64) -> f64 {
    let u = u.clamp(0.0, 1.0);
    u * u * u * (u * (6.0 * u - 15.0) + 10.0)
}

/// Smooths a signal with a Gaussian of the given standard deviation; the ends are held.
pub(super) fn smooth(signal: &mut [f64], sigma_frames: f64) {
    if sigma_frames <= 0.0 {
        return;
    }
    // Beyond three standard deviations lie 0.3 % of the weight.
    let radius = (3.0 * sigma_frames).ceil() as usize;
    let kernel: Vec<f64> = (0..=radius)
        .map(|lag| (-0.5 * (lag as f64 / sigma_frames).powi(2)).exp())
        .collect();
    convolve(signal, &kernel);
}

/// Replaces a signal by a smooth one that never exceeds it: the minimum within `radius` frames, averaged over as many
/// frames.
pub(super) fn smooth_lower_bound(signal: &mut [f64], radius: usize) {
    let lowest: Vec<f64> = (0..signal.len())
        .map(|at| {
            let window = at.saturating_sub(radius)..(at + radius + 1).min(signal.len());
            signal[window].iter().copied().fold(f64::INFINITY, f64::min)
        })
        .collect();
    signal.copy_from_slice(&lowest);
    // A raised cosine over the same frames: every minimum that is averaged includes this frame.
    let kernel: Vec<f64> = (0..=radius)
        .map(|lag| 0.5 + 0.5 * (std::f64::consts::PI * lag as f64 / (radius + 1) as f64).cos())
        .collect();
    convolve(signal, &kernel);
}

/// Convolves with a symmetric kernel given by its right half, holding the ends of the signal.
fn convolve(signal: &mut [f64], kernel: &[f64]) {
    let total: f64 = kernel[0] + 2.0 * kernel[1..].iter().sum::<f64>();
    let source = signal.to_vec();
    let last = source.len().saturating_sub(1);
    for (at, value) in signal.iter_mut().enumerate() {
        let mut sum = kernel[0] * source[at];
        for (lag, weight) in kernel.iter().enumerate().skip(1) {
            sum += weight * (source[at.saturating_sub(lag)] + source[(at + lag).min(last)]);
        }
        *value = sum / total;
    }
}

#[cfg(test)]
mod tests {
    use datasets_spec::Seed;
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_track_holds_between_equal_keys_and_outside() {
        let track = Track::new(vec![(2.0, [1.0]), (1.0, [1.0]), (3.0, [4.0])]);
        for secs in [-5.0, 1.0, 1.3, 1.99, 2.0] {
            assert_eq!(track.at(secs), [1.0]);
        }
        assert_eq!(track.at(9.0), [4.0]);
    }

    #[test]
    fn easing_starts_and_ends_at_rest() {
        assert_eq!([-1.0, 0.0, 1.0, 2.0].map(ease), [0.0, 0.0, 1.0, 1.0]);
        assert!((ease(0.5) - 0.5).abs() < 1e-15);
        // The first derivative is 30 u^2 (1 - u)^2, so a thousandth from the end it is 3e-5.
        assert!((ease(1e-3) / 1e-3) < 3e-5);
    }

    #[test]
    fn wobbles_have_the_size_asked_for() {
        let mut rng = Seed(3).rng(&["wobble"]);
        let wobble = Wobble::new(&mut rng, 0.1, 1.0);
        let squares: f64 = (0..60_000)
            .map(|i| wobble.at(i as f64 / 60.0).powi(2))
            .sum();
        // Each wave's size is drawn within 30 % of its mean.
        let rms = (squares / 60_000.0).sqrt();
        assert!((0.07..0.13).contains(&rms), "{rms}");
    }

    proptest! {
        #[test]
        fn a_track_never_overshoots(values in prop::collection::vec(-5.0..5.0f64, 2..8), u in 0.0..1.0f64) {
            let keys: Vec<_> = values.iter().enumerate().map(|(i, &v)| (i as f64, [v])).collect();
            let track = Track::new(keys);
            for (i, pair) in values.windows(2).enumerate() {
                let [value] = track.at(i as f64 + u);
                let (low, high) = (pair[0].min(pair[1]), pair[0].max(pair[1]));
                prop_assert!(value >= low - 1e-12 && value <= high + 1e-12);
            }
        }

        #[test]
        fn the_lower_bound_is_one(values in prop::collection::vec(-5.0..5.0f64, 1..60)) {
            let mut bound = values.clone();
            smooth_lower_bound(&mut bound, 5);
            for (bound, value) in bound.iter().zip(&values) {
                prop_assert!(*bound <= value + 1e-12);
            }
        }

        #[test]
        fn smoothing_keeps_a_constant(value in -5.0..5.0f64, sigma in 0.0..9.0f64) {
            let mut signal = vec![value; 30];
            smooth(&mut signal, sigma);
            prop_assert!(signal.iter().all(|s| (s - value).abs() < 1e-12));
        }
    }
}
