//! AdamW; on the processor it makes one pass over memory ([`kernels::adamw`]).

use burn::backend::Flex;
use burn::backend::tensor::FloatTensor;
use burn::optim::{
    AdamW, AdamWConfig, AdamWState, AdaptiveMomentumState, LearningRate, ModuleOptimizer, Optimizer,
};
use burn::tensor::{DType, Device, Tensor};
use kernels::adamw::{self, BETAS, EPSILON, Factors};
use kernels::on_workers;

use crate::model::pass::Arithmetic;

/// AdamW with PyTorch's defaults and the given weight decay.
pub fn adamw(weight_decay: f64, arithmetic: Arithmetic) -> ModuleOptimizer {
    OnePass::new(weight_decay as f32, arithmetic).into()
}

/// AdamW that updates tensors on the processor in one pass. Its state is bit-identical to that of the composed
/// optimiser.
#[derive(Clone)]
struct OnePass {
    composed: AdamW,
    weight_decay: f32,
    arithmetic: Arithmetic,
}

impl OnePass {
    fn new(weight_decay: f32, arithmetic: Arithmetic) -> Self {
        let config = AdamWConfig::new()
            .with_beta_1(BETAS[0])
            .with_beta_2(BETAS[1])
            .with_epsilon(EPSILON)
            .with_weight_decay(weight_decay);
        Self {
            composed: config.build(),
            weight_decay,
            arithmetic,
        }
    }
}

impl Optimizer for OnePass {
    type State<const D: usize> = AdamWState<D>;

    fn step<const D: usize>(
        &self,
        rate: LearningRate,
        tensor: Tensor<D>,
        grad: Tensor<D>,
        state: Option<Self::State<D>>,
    ) -> (Tensor<D>, Option<Self::State<D>>) {
        // The first step creates the state.
        let Some(AdamWState { momentum }) = state else {
            return self.composed.step(rate, tensor, grad, None);
        };
        let is_plain = |tensor: &Tensor<D>| {
            self.arithmetic.uses_kernels(&tensor.device())
                && tensor.dtype() == DType::F32
                && !tensor.device().is_autodiff()
        };
        let tensors = [&tensor, &grad, &momentum.moment_1, &momentum.moment_2];
        if !tensors.into_iter().all(is_plain) {
            let state = Some(AdamWState { momentum });
            return self.composed.step(rate, tensor, grad, state);
        }
        let time = momentum.time + 1;
        let factors = Factors::new(rate, self.weight_decay, time as i32);
        let [mut values, grad, mut first, mut second] =
            [tensor, grad, momentum.moment_1, momentum.moment_2].map(numbers);
        let gradients = grad.storage::<f32>();
        let of_second = second.storage_mut::<f32>();
        let (of_values, of_first) = (values.storage_mut::<f32>(), first.storage_mut::<f32>());
        on_workers(|| adamw::step(of_values, gradients, of_first, of_second, factors));
        let [tensor, moment_1, moment_2] =
            [values, first, second].map(Tensor::from_primitive::<Flex>);
        let momentum = AdaptiveMomentumState {
            time,
            moment_1,
            moment_2,
            max_moment_2: None,
        };
        (tensor, Some(AdamWState { momentum }))
    }

    fn to_device<const D: usize>(state: Self::State<D>, device: &Device) -> Self::State<D> {
        AdamW::to_device(state, device)
    }
}

/// The buffer of a tensor on the processor, contiguous and without extra elements.
fn numbers<const D: usize>(tensor: Tensor<D>) -> FloatTensor<Flex> {
    let count = tensor.shape().num_elements();
    let tensor = tensor
        .try_into_primitive::<Flex>()
        .expect("the tensor lies on the processor");
    if tensor.is_contiguous() && tensor.storage::<f32>().len() == count {
        tensor
    } else {
        FloatTensor::<Flex>::from_data(tensor.to_contiguous().into_data())
    }
}

#[cfg(test)]
mod tests {
    use burn::module::{Module, Param};
    use burn::nn::{Linear, LinearConfig};
    use burn::optim::GradientsParams;
    use burn::tensor::Distribution;

    use super::*;
    use crate::transfer::read;

    /// The weights after some steps with random gradients, some of them very small or very large.
    fn trained(mut optimizer: ModuleOptimizer) -> Vec<Vec<f32>> {
        let device = Device::flex().autodiff();
        device.seed(3);
        let mut layer = LinearConfig::new(300, 70).init(&device);
        device.seed(4);
        let mut found = Vec::new();
        for step in 0..6 {
            let scale = [1.0, 1e-6, 1e4, 0.0, 1.0, 1e-12][step];
            let x = Tensor::<2>::random([9, 300], Distribution::Normal(0.0, scale), &device);
            let grads = layer.forward(x).sum().backward();
            let grads = GradientsParams::from_grads(grads, &layer);
            layer = optimizer.step(0.01, layer, grads);
            let Linear { weight, bias } = layer.clone().valid();
            found.push(read(weight.val()));
            found.push(read(bias.as_ref().map(Param::val).expect("it has a bias")));
        }
        found
    }

    #[test]
    fn one_pass_steps_as_the_composed_optimizer_does() {
        let ours = OnePass::new(0.05, Arithmetic::default());
        let composed = ModuleOptimizer::from(ours.composed.clone());
        assert_eq!(trained(ours.into()), trained(composed));
    }

    /// Compares a step with its definition, in double precision.
    ///
    /// # Source
    /// Loshchilov and Hutter 2019, algorithm 2.
    #[test]
    fn a_step_is_the_published_one() {
        let device = Device::flex();
        let tensor = |values: [f32; 2]| Tensor::<1>::from_floats(values, &device);
        let momentum = AdaptiveMomentumState {
            time: 4,
            moment_1: tensor([0.3, -0.2]),
            moment_2: tensor([0.5, 0.1]),
            max_moment_2: None,
        };
        let optimizer = OnePass::new(0.01, Arithmetic::default());
        let state = Some(AdamWState { momentum });
        let (found, state) = optimizer.step(1e-2, tensor([1.0, -2.0]), tensor([0.7, 0.4]), state);
        let found = read(found);
        assert_eq!(state.expect("kept").momentum.time, 5);
        let numbers = [(1.0, 0.7, 0.3, 0.5), (-2.0, 0.4, -0.2, 0.1)];
        for ((value, gradient, first, second), found) in numbers.into_iter().zip(found) {
            let value: f64 = value;
            let first: f64 = 0.9 * first + 0.1 * gradient;
            let second: f64 = 0.999 * second + 0.001 * gradient * gradient;
            let [first, second] = [
                first / (1.0 - 0.9f64.powi(5)),
                second / (1.0 - 0.999f64.powi(5)),
            ];
            let step = first / (second.sqrt() + 1e-8) + 0.01 * value;
            let expected = value - 1e-2 * step;
            assert!(
                (f64::from(found) - expected).abs() < 1e-6,
                "{found} {expected}"
            );
        }
    }
}
