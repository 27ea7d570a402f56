//! Gradient clipping by norm.

use burn::module::{Module, ModuleVisitor, Param};
use burn::optim::GradientsParams;
use burn::tensor::Tensor;

/// Scales the gradients down to `max_norm` if their total norm is larger, like PyTorch's `clip_grad_norm_`, and returns
/// the norm before clipping. To avoid reading the norm from the device, smaller gradients are multiplied by one.
pub(super) fn clip_grad_norm<M: Module>(
    gradients: &mut GradientsParams,
    model: &M,
    max_norm: f64,
) -> Tensor<1> {
    struct Squares<'a>(&'a GradientsParams, Vec<Tensor<1>>);
    impl ModuleVisitor for Squares<'_> {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            if let Some(gradient) = self.0.get::<D>(param.id) {
                self.1.push(gradient.square().sum());
            }
        }
    }
    struct Scale<'a> {
        gradients: &'a mut GradientsParams,
        by: Tensor<1>,
    }
    impl ModuleVisitor for Scale<'_> {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            if let Some(gradient) = self.gradients.remove::<D>(param.id) {
                let scaled = gradient * self.by.clone().reshape([1; D]);
                self.gradients.register(param.id, scaled);
            }
        }
    }
    let mut squares = Squares(gradients, Vec::new());
    model.visit(&mut squares);
    let norm = Tensor::cat(squares.1, 0).sum().sqrt();
    let by = norm.clone().recip().mul_scalar(max_norm).clamp_max(1.0);
    model.visit(&mut Scale { gradients, by });
    norm
}

#[cfg(test)]
mod tests {
    use burn::nn::LinearConfig;
    use burn::tensor::Device;
    use datasets_spec::Seed;

    use super::*;
    use crate::model::weights::draw;

    #[test]
    fn large_gradients_are_clipped_together_and_small_ones_are_left() {
        let device = Device::flex().autodiff();
        let model = draw(LinearConfig::new(3, 2).init(&device), Seed(1)).expect("a known layer");
        let gradients = || {
            let x = Tensor::<2>::from_data([[3.0, 0.0, 4.0]], &device);
            GradientsParams::from_grads(model.forward(x).sum().backward(), &model)
        };
        // The weight gradients are two columns of (3, 0, 4), the bias gradients two ones.
        let expected = (2.0 * 25.0 + 2.0f64).sqrt();
        let mut clipped = gradients();
        let clip = |gradients: &mut GradientsParams, max_norm| -> f64 {
            let norm = clip_grad_norm(gradients, &model, max_norm);
            f64::from(norm.into_scalar::<f32>())
        };
        assert!((clip(&mut clipped, 1.0) - expected).abs() < 1e-5);
        assert!((clip(&mut clipped, 100.0) - 1.0).abs() < 1e-5);
        let mut left = gradients();
        clip(&mut left, 100.0);
        assert!((clip(&mut left, 100.0) - expected).abs() < 1e-5);
        // Gradients of zero have norm 0 and stay zero, rather than becoming NaN.
        let mut none = gradients();
        let zero = model.weight.val().inner().zeros_like();
        none.register(model.weight.id, zero.clone());
        let bias = model.bias.as_ref().expect("it has a bias");
        none.register(bias.id, bias.val().inner().zeros_like());
        assert_eq!(clip(&mut none, 1.0), 0.0);
        let left = none.get::<2>(model.weight.id).expect("a gradient");
        assert_eq!(left.into_data(), zero.into_data());
    }
}
