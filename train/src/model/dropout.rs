//! Dropout whose mask, on a processor, depends on a key and the index of a number alone.

use std::cell::Cell;

use burn::nn::Dropout;
use burn::tensor::{Device, Tensor, TensorData};

use super::fused::{dropout_factors, is_used};

/// The probability with which numbers are dropped here and now: zero outside training and where the
/// layer is frozen.
pub(crate) fn probability(dropout: &Dropout, device: &Device) -> f64 {
    if dropout.training.is_enabled() && device.is_autodiff() {
        dropout.prob
    } else {
        0.0
    }
}

thread_local! {
    /// Seed of the masks drawn on this thread, and how many were drawn since.
    static DRAWS: Cell<(u64, u64)> = const { Cell::new((0, 0)) };
}

/// Runs `act` so that the masks it draws on this thread follow from `seed` alone, whatever other
/// threads draw.
pub(crate) fn seeded<T>(seed: u64, act: impl FnOnce() -> T) -> T {
    let before = DRAWS.replace((seed, 0));
    let result = act();
    DRAWS.set(before);
    result
}

/// The key of the next mask of this thread.
pub(crate) fn draw_key() -> u64 {
    let (seed, count) = DRAWS.get();
    DRAWS.set((seed, count + 1));
    mixed(seed ^ mixed(count))
}

/// The finalizer of SplitMix64 (Steele et al. 2014).
fn mixed(x: u64) -> u64 {
    let x = x.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    x ^ (x >> 31)
}

/// Drops numbers and scales those that are kept.
///
/// On a processor the mask is made by a generator that works on any part of it by itself, in vector
/// instructions and on all threads, and is the same however many there are. Elsewhere the device
/// draws.
///
/// # Shapes
/// Those of `x`.
pub fn drop_out<const D: usize>(dropout: &Dropout, x: Tensor<D>) -> Tensor<D> {
    let device = x.device();
    let prob = probability(dropout, &device);
    if prob == 0.0 || !is_used(&device) {
        return dropout.forward(x);
    }
    let shape = x.shape();
    let factors = dropout_factors(prob, draw_key(), shape.num_elements());
    x * Tensor::from_data(TensorData::new(factors, shape), &device)
}

#[cfg(test)]
mod tests {
    use burn::nn::DropoutConfig;

    use super::*;

    fn dropped(seed: u64, device: &Device) -> Vec<f32> {
        let dropout = DropoutConfig::new(0.25).init();
        let x = Tensor::<2>::ones([300, 200], device);
        let values = seeded(seed, || drop_out(&dropout, x)).into_data();
        values.try_into_vec_as().expect("floats")
    }

    #[test]
    fn a_seed_gives_one_mask_on_any_number_of_threads() {
        let device = Device::flex().autodiff();
        let pool = |threads| {
            rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .expect("a pool")
        };
        let mask = |threads| pool(threads).install(|| dropout_factors(0.25, 3, 100_000));
        assert_eq!(mask(1), mask(2));
        let kept = dropped(5, &device);
        assert!(
            kept.iter()
                .all(|&value| value == 0.0 || value == 1.0 / 0.75)
        );
        let share = kept.iter().filter(|&&value| value > 0.0).count() as f64 / kept.len() as f64;
        // Five standard deviations.
        assert!((share - 0.75).abs() < 5.0 * (0.75 * 0.25 / kept.len() as f64).sqrt());
        assert_eq!(kept, dropped(5, &device));
        assert_ne!(kept, dropped(6, &device));
        assert!(
            dropped(5, &Device::flex())
                .iter()
                .all(|&value| value == 1.0)
        );
    }
}
