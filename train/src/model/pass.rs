//! How a pass through a network is computed: operations, precision and dropout.

use std::cell::Cell;

use burn::nn::{Dropout, Linear};
use burn::tensor::module::linear;
use burn::tensor::{DType, Device, FloatDType, Tensor, TensorData};

use super::fused::dropout_factors;

/// Operations and precision of networks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Arithmetic {
    /// Whether this program's kernels are used on the processor. Without them, every model is composed of burn's own
    /// operations; results are equal up to rounding.
    pub kernels: bool,
    /// Whether transformers multiply in bfloat16: the operands of a linear layer are rounded, and its result is
    /// converted back to single precision. Weights, gradients, optimiser, norms, softmax, sums and losses stay in
    /// single precision.
    pub bf16: bool,
}

impl Default for Arithmetic {
    /// Single precision, with kernels.
    fn default() -> Self {
        Self {
            kernels: true,
            bf16: false,
        }
    }
}

impl Arithmetic {
    /// Whether kernels are used on a device. They run only on the processor.
    pub(crate) fn uses_kernels(self, device: &Device) -> bool {
        // The kernels compute in single precision.
        self.kernels && !self.bf16 && device.clone().inner() == Device::flex()
    }
}

/// Whether a device computes in bfloat16.
pub fn has_bf16(device: &Device) -> bool {
    device.supports_dtype(DType::BF16)
}

/// Arithmetic and dropout masks of a pass through networks. Several networks of a training step may share it.
#[derive(Debug, Default)]
pub struct Pass {
    arithmetic: Arithmetic,
    /// Seed of the dropout masks, and the number of masks drawn so far.
    seed: u64,
    num_drawn: Cell<u64>,
}

impl Pass {
    /// A pass whose dropout masks are drawn from seed 0.
    pub fn new(arithmetic: Arithmetic) -> Self {
        Self::seeded(arithmetic, 0)
    }

    /// A pass whose dropout masks are drawn from `seed`, independent of other passes.
    pub fn seeded(arithmetic: Arithmetic, seed: u64) -> Self {
        Self {
            arithmetic,
            seed,
            num_drawn: Cell::new(0),
        }
    }

    pub(crate) fn arithmetic(&self) -> Arithmetic {
        self.arithmetic
    }

    /// Whether kernels are used on a device.
    pub(crate) fn uses_kernels(&self, device: &Device) -> bool {
        self.arithmetic.uses_kernels(device)
    }

    /// The key of the next dropout mask.
    pub(crate) fn draw_key(&self) -> u64 {
        let count = self.num_drawn.get();
        self.num_drawn.set(count + 1);
        mixed(self.seed ^ mixed(count))
    }

    /// Applies dropout: sets numbers to zero and scales the others.
    ///
    /// On a processor, each mask value is computed from a key and its index alone. So the mask is vectorised, computed
    /// on all threads, and does not depend on their number. Other devices draw their own masks.
    ///
    /// # Shapes
    /// Those of `x`.
    pub fn drop_out<const D: usize>(&self, dropout: &Dropout, x: Tensor<D>) -> Tensor<D> {
        let device = x.device();
        let prob = probability(dropout, &device);
        if prob == 0.0 || !self.uses_kernels(&device) {
            return dropout.forward(x);
        }
        let shape = x.shape();
        let factors = dropout_factors(prob, self.draw_key(), shape.num_elements());
        x * Tensor::from_data(TensorData::new(factors, shape), &device)
    }

    /// Applies a linear layer.
    pub(crate) fn linear<const D: usize>(&self, layer: &Linear, x: Tensor<D>) -> Tensor<D> {
        self.product(
            x,
            layer.weight.val(),
            layer.bias.as_ref().map(|bias| bias.val()),
        )
    }

    /// `x * weight + bias`.
    ///
    /// # Shapes
    /// `x` `[.., from]`, `weight` `[from, to]`, `bias` `[to]`.
    pub(crate) fn product<const D: usize>(
        &self,
        x: Tensor<D>,
        weight: Tensor<2>,
        bias: Option<Tensor<1>>,
    ) -> Tensor<D> {
        if !self.arithmetic.bf16 {
            return linear(x, weight, bias);
        }
        let rounded = linear(
            x.cast(FloatDType::BF16),
            weight.cast(FloatDType::BF16),
            None,
        )
        .cast(FloatDType::F32);
        match bias {
            Some(bias) => rounded + bias.unsqueeze(),
            None => rounded,
        }
    }
}

/// The dropout probability in effect: zero outside training and if the layer is frozen.
pub(crate) fn probability(dropout: &Dropout, device: &Device) -> f64 {
    if dropout.training.is_enabled() && device.is_autodiff() {
        dropout.prob
    } else {
        0.0
    }
}

/// The finalizer of SplitMix64 (Steele et al. 2014).
fn mixed(x: u64) -> u64 {
    let x = x.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    x ^ (x >> 31)
}

#[cfg(test)]
mod tests {
    use burn::nn::{DropoutConfig, LinearConfig};
    use datasets_spec::Seed;

    use super::*;
    use crate::model::weights::draw;
    use crate::transfer::read;

    fn dropped(seed: u64, device: &Device) -> Vec<f32> {
        let dropout = DropoutConfig::new(0.25).init();
        let x = Tensor::<2>::ones([300, 200], device);
        read(Pass::seeded(Arithmetic::default(), seed).drop_out(&dropout, x))
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
        // The tolerance is five standard deviations.
        assert!((share - 0.75).abs() < 5.0 * (0.75 * 0.25 / kept.len() as f64).sqrt());
        assert_eq!(kept, dropped(5, &device));
        assert_ne!(kept, dropped(6, &device));
        assert!(
            dropped(5, &Device::flex())
                .iter()
                .all(|&value| value == 1.0)
        );
    }

    /// A product, and two tensors with dropout.
    fn computed(bf16: bool) -> [Vec<f32>; 3] {
        let device = Device::flex().autodiff();
        let layer = draw(LinearConfig::new(40, 30).init(&device), Seed(1)).expect("a known layer");
        let arithmetic = Arithmetic {
            bf16,
            ..Arithmetic::default()
        };
        let pass = Pass::seeded(arithmetic, 3);
        let numbers = (0..7 * 40).map(|index| (index as f32 * 0.37).sin());
        let numbers = TensorData::new(numbers.collect::<Vec<f32>>(), [7, 40]);
        let x = || Tensor::<2>::from_data(numbers.clone(), &device);
        let dropped = || match bf16 {
            false => read(pass.drop_out(&DropoutConfig::new(0.25).init(), x())),
            // In bfloat16 the kernels are off, and burn draws the mask without the seed.
            true => Vec::new(),
        };
        [read(pass.linear(&layer, x())), dropped(), dropped()]
    }

    #[test]
    fn passes_side_by_side_have_each_their_own_precision_and_masks() {
        let alone = [false, true].map(computed);
        let [single, half] = [&alone[0][0], &alone[1][0]];
        assert_ne!(single, half, "nothing was rounded");
        for (single, half) in single.iter().zip(half) {
            // The tolerance is the error of a sum of forty products of factors below one, each rounded to eight bits.
            assert!((single - half).abs() < 0.1, "{single} {half}");
        }
        assert_ne!(alone[0][1], alone[0][2], "the masks of a pass differ");
        let together = std::thread::scope(|scope| {
            [false, true]
                .map(|bf16| scope.spawn(move || [(); 20].map(|()| computed(bf16))))
                .map(|thread| thread.join().expect("it does not panic"))
        });
        for (alone, together) in alone.iter().zip(&together) {
            assert!(together.iter().all(|together| together == alone));
        }
    }
}
