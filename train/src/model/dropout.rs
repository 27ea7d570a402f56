//! Dropout whose masks follow from a seed alone.

use std::cell::Cell;

use burn::module::{Flag, Module, Param};
use burn::tensor::{Device, Distribution, Tensor, TensorData};
use rayon::prelude::*;

/// Numbers of a mask that are drawn together on one thread.
const CHUNK: usize = 1 << 14;

thread_local! {
    /// Seed of the masks drawn on this thread, and how many were drawn since.
    static DRAWS: Cell<(u64, u64)> = const { Cell::new((0, 0)) };
}

/// Runs `act` so that the masks it draws on this thread follow from `seed` alone.
pub(crate) fn seeded<T>(seed: u64, act: impl FnOnce() -> T) -> T {
    let before = DRAWS.replace((seed, 0));
    let result = act();
    DRAWS.set(before);
    result
}

/// Drops activations while training, and scales those that are kept so that their mean stays.
///
/// burn's own layer draws from a generator that all threads share, and draws slowly. On the
/// processor this one makes a mask with a few operations a number, the same whatever the number of
/// threads; on a card the mask is drawn there.
///
/// # Source
/// Srivastava et al. 2014; used as `nn.Dropout` of PyTorch is.
#[derive(Module, Debug)]
pub struct Dropout {
    prob: f64,
    training: Param<Flag>,
}

impl Dropout {
    /// Builds the layer for a probability in [0, 1).
    pub fn new(prob: f64) -> Self {
        Self {
            prob,
            training: Param::from_bool(true),
        }
    }

    /// Applies the layer; outside training it returns what it is given.
    ///
    /// # Shapes
    /// Any; the result has the same.
    pub fn forward<const D: usize>(&self, input: Tensor<D>) -> Tensor<D> {
        let device = input.device();
        if self.prob == 0.0 || !self.training.is_enabled() || !device.is_autodiff() {
            return input;
        }
        let kept = 1.0 - self.prob;
        if device != Device::flex().autodiff() {
            let mask = input.random_like(Distribution::Bernoulli(kept));
            return input * mask.mul_scalar(1.0 / kept);
        }
        let (seed, count) = DRAWS.get();
        DRAWS.set((seed, count + 1));
        let key = mixed(seed ^ mixed(count));
        let shape = input.dims();
        let values = mask(key, self.prob, shape.iter().product());
        input * Tensor::from_data(TensorData::new(values, shape), &device)
    }
}

/// A mask: 0 with probability `prob`, else what makes the mean 1. The probability is met to within
/// 2^-17.
fn mask(key: u64, prob: f64, length: usize) -> Vec<f32> {
    let threshold = (prob * 65_536.0).round() as u16;
    let scale = (1.0 / (1.0 - prob)) as f32;
    let mut values = vec![0.0f32; length];
    values
        .par_chunks_mut(CHUNK)
        .enumerate()
        .for_each(|(chunk, values)| {
            let first = (chunk * CHUNK / 4) as u64;
            for (place, four) in values.chunks_mut(4).enumerate() {
                let bits = mixed(key.wrapping_add((first + place as u64).wrapping_mul(STEP)));
                for (lane, value) in four.iter_mut().enumerate() {
                    let drawn = (bits >> (16 * lane)) as u16;
                    *value = if drawn < threshold { 0.0 } else { scale };
                }
            }
        });
    values
}

/// Odd step between inputs of [`mixed`] (SplitMix64).
const STEP: u64 = 0x9E37_79B9_7F4A_7C15;

/// The finalizer of SplitMix64 (Steele et al. 2014).
fn mixed(mut x: u64) -> u64 {
    x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    x ^ (x >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_share_dropped_and_the_mean_are_right() {
        let values = mask(7, 0.1, 1_000_003);
        let count = values.len() as f64;
        let dropped = values.iter().filter(|&&value| value == 0.0).count() as f64 / count;
        // Four standard deviations of the share.
        assert!((dropped - 0.1).abs() < 4.0 * (0.09 / count).sqrt());
        let mean = values.iter().map(|&value| f64::from(value)).sum::<f64>() / count;
        assert!((mean - 1.0).abs() < 5e-3);
        // Neighbours do not know of each other.
        let both = values
            .windows(2)
            .filter(|pair| pair[0] == 0.0 && pair[1] == 0.0)
            .count() as f64;
        assert!((both / count - 0.01).abs() < 6.0 * (0.01 / count).sqrt());
    }

    #[test]
    fn masks_follow_from_seed_and_order_alone() {
        let device = Device::flex().autodiff();
        let layer = Dropout::new(0.5);
        let draw = |seed: u64| -> [Vec<f32>; 2] {
            seeded(seed, || {
                [0, 1].map(|_| {
                    let x = Tensor::<2>::ones([40, 50], &device);
                    let data = layer.forward(x).into_data();
                    data.try_into_vec_as().expect("floats")
                })
            })
        };
        let first = draw(1);
        assert_eq!(first, draw(1));
        assert_ne!(first, draw(2));
        assert_ne!(first[0], first[1]);
        let pool = |threads| {
            rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .expect("a pool")
                .install(|| mask(3, 0.3, 100_000))
        };
        assert_eq!(pool(1), pool(3));
    }

    #[test]
    fn nothing_is_dropped_outside_training() {
        let ones = |device: &Device| Tensor::<1>::ones([64], device);
        let values =
            |x: Tensor<1>| -> Vec<f32> { x.into_data().try_into_vec_as().expect("floats") };
        let (plain, training) = (Device::flex(), Device::flex().autodiff());
        let layer = Dropout::new(0.5);
        assert_eq!(values(layer.forward(ones(&plain))), vec![1.0; 64]);
        assert_ne!(values(layer.forward(ones(&training))), vec![1.0; 64]);
        assert_eq!(
            values(layer.valid().forward(ones(&training))),
            vec![1.0; 64]
        );
    }
}
