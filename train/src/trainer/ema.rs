//! The exponential moving average (EMA) of the weights.

use std::collections::BTreeMap;

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param, ParamId};
use burn::tensor::Tensor;

#[derive(Clone, Debug)]
pub(super) struct Ema(BTreeMap<ParamId, Tensor<1>>);

impl Ema {
    pub(super) fn of<M: Module>(model: &M) -> Self {
        let mut ema = Self(BTreeMap::new());
        ema.move_to(model, 0.0);
        ema
    }

    pub(super) fn update<M: Module>(&mut self, model: &M, decay: f64, step: u64) {
        self.move_to(model, warmed_up(decay, step));
    }

    /// `decay * self + (1 - decay) * weights`.
    fn move_to<M: Module>(&mut self, model: &M, decay: f64) {
        struct Update<'a> {
            ema: &'a mut BTreeMap<ParamId, Tensor<1>>,
            decay: f64,
        }
        impl ModuleVisitor for Update<'_> {
            fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
                let now = param.val().reshape([-1]);
                let next = match self.ema.remove(&param.id) {
                    Some(before) => {
                        before.mul_scalar(self.decay) + now.mul_scalar(1.0 - self.decay)
                    }
                    None => now,
                };
                self.ema.insert(param.id, next);
            }
        }
        model.visit(&mut Update {
            ema: &mut self.0,
            decay,
        });
    }

    pub(super) fn put_into<M: Module>(&self, model: M) -> M {
        struct Put<'a>(&'a BTreeMap<ParamId, Tensor<1>>);
        impl ModuleMapper for Put<'_> {
            fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
                match self.0.get(&param.id) {
                    Some(average) => {
                        let average = average.clone();
                        param.map(|now| average.reshape(now.dims()))
                    }
                    None => param,
                }
            }
        }
        model.map(&mut Put(&self.0))
    }
}

/// EMA decay in a step. It is smaller at first, so that initial weights do not dominate the average of a short run.
fn warmed_up(decay: f64, step: u64) -> f64 {
    let step = step as f64;
    decay.min((1.0 + step) / (10.0 + step))
}

#[cfg(test)]
mod tests {
    use burn::nn::{Linear, LinearConfig};
    use burn::tensor::Device;
    use datasets_spec::Seed;

    use super::*;
    use crate::model::weights::draw;
    use crate::transfer::read;

    fn numbers(layer: &Linear) -> Vec<f32> {
        read(layer.weight.val())
    }

    #[test]
    fn an_average_over_a_short_run_forgets_the_weights_it_began_with() {
        let left: f64 = (0..40).map(|step| warmed_up(0.998, step)).product();
        assert!(left < 1e-6, "{left}");
        assert!(warmed_up(0.998, 10_000) == 0.998);
    }

    #[test]
    fn the_ema_moves_by_its_decay() {
        let layer = |seed| {
            let layer = LinearConfig::new(3, 2).init(&Device::flex());
            draw(layer, Seed(seed)).expect("a known layer")
        };
        let (first, second) = (layer(1), layer(2));
        let mut ema = Ema::of(&first);
        ema.move_to(&second, 0.75);
        let mixed = numbers(&ema.put_into(layer(3)));
        for ((mixed, first), second) in mixed.iter().zip(numbers(&first)).zip(numbers(&second)) {
            assert!((mixed - (0.75 * first + 0.25 * second)).abs() < 1e-6);
        }
    }
}
