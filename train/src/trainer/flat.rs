//! Values of all parameters of a model in one tensor, which is sent between devices in one transfer.

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param, ParamId};
use burn::optim::GradientsParams;
use burn::tensor::{Device, Tensor};

/// Values of parameters in one tensor without automatic differentiation, in the order in which a model visits its
/// parameters.
pub(super) struct Flat {
    ids: Vec<ParamId>,
    values: Tensor<1>,
}

impl Flat {
    fn of(parameters: Vec<(ParamId, Tensor<1>)>) -> Self {
        let (ids, values): (_, Vec<_>) = parameters.into_iter().unzip();
        Self {
            ids,
            values: Tensor::cat(values, 0),
        }
    }

    pub(super) fn of_weights<M: Module>(model: &M) -> Self {
        struct Collect(Vec<(ParamId, Tensor<1>)>);
        impl ModuleVisitor for Collect {
            fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
                let weights = param.val().inner().reshape([-1]);
                self.0.push((param.id, weights));
            }
        }
        let mut found = Collect(Vec::new());
        model.visit(&mut found);
        Self::of(found.0)
    }

    /// Collects the gradients of a model; some parameters may have none.
    pub(super) fn of_gradients<M: Module>(model: &M, gradients: &GradientsParams) -> Self {
        struct Collect<'a>(&'a GradientsParams, Vec<(ParamId, Tensor<1>)>);
        impl ModuleVisitor for Collect<'_> {
            fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
                if let Some(gradient) = self.0.get::<D>(param.id) {
                    self.1.push((param.id, gradient.reshape([-1])));
                }
            }
        }
        let mut found = Collect(gradients, Vec::new());
        model.visit(&mut found);
        Self::of(found.1)
    }

    pub(super) fn to_device(&self, device: &Device) -> Self {
        Self {
            ids: self.ids.clone(),
            values: self.values.clone().to_device(&device.clone().inner()),
        }
    }

    /// The inverse of [`Flat::of_gradients`].
    pub(super) fn into_gradients<M: Module>(self, model: &M) -> GradientsParams {
        struct Put {
            from: Flat,
            next: usize,
            place: usize,
            gradients: GradientsParams,
        }
        impl ModuleVisitor for Put {
            fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
                if self.from.ids.get(self.place) == Some(&param.id) {
                    let shape = param.shape();
                    let count = shape.num_elements();
                    let values = self.from.values.clone().narrow(0, self.next, count);
                    self.gradients
                        .register::<D>(param.id, values.reshape(shape));
                    self.next += count;
                    self.place += 1;
                }
            }
        }
        let mut put = Put {
            from: self,
            next: 0,
            place: 0,
            gradients: GradientsParams::new(),
        };
        model.visit(&mut put);
        put.gradients
    }

    /// Returns the model with these weights.
    pub(super) fn put_into<M: Module>(&self, copy: M) -> M {
        struct Put<'a> {
            from: &'a Flat,
            next: usize,
        }
        impl ModuleMapper for Put<'_> {
            fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
                param.map(|now| {
                    let count = now.shape().num_elements();
                    let values = self.from.values.clone().narrow(0, self.next, count);
                    self.next += count;
                    Tensor::from_inner(values.reshape(now.dims()))
                        .set_require_grad(now.is_require_grad())
                })
            }
        }
        copy.map(&mut Put {
            from: self,
            next: 0,
        })
    }
}

#[cfg(test)]
mod tests {
    use burn::nn::{Linear, LinearConfig};
    use datasets_spec::Seed;

    use super::*;
    use crate::model::weights::draw;

    #[test]
    fn weights_and_gradients_cross_in_one_tensor_and_come_back() {
        let device = Device::flex().autodiff();
        let layer = |seed| -> Linear {
            let layer = LinearConfig::new(3, 2).init(&device);
            draw(layer, Seed(seed)).expect("a known layer")
        };
        let (model, other) = (layer(1), layer(2));
        let copy = Flat::of_weights(&other).put_into(model.clone().fork(&device));
        assert_eq!(
            copy.weight.val().into_data(),
            other.weight.val().into_data()
        );
        let x = Tensor::<2>::from_data([[3.0, 0.0, 4.0]], &device);
        let gradients = GradientsParams::from_grads(copy.forward(x).sum().backward(), &copy);
        let flat = Flat::of_gradients(&copy, &gradients).to_device(&device);
        let back = flat.into_gradients(&model);
        let weight = back.get::<2>(model.weight.id).expect("a gradient");
        let expected = gradients.get::<2>(model.weight.id).expect("a gradient");
        assert_eq!(weight.into_data(), expected.into_data());
        assert_eq!(back.len(), 2);
    }
}
