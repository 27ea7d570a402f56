//! Computes the loss and the gradients of a step, on one or several devices.

use burn::module::Module;
use burn::optim::{GradientsAccumulator, GradientsParams};
use burn::tensor::{Device, Tensor};
use datasets_spec::Seed;

use super::flat::Flat;
use super::task::Task;
use crate::model::pass::{Arithmetic, Pass};

pub(super) struct Devices<M> {
    first: Device,
    /// The other devices, each with a copy of the model.
    others: Vec<(Device, M)>,
}

impl<M: Module> Devices<M> {
    pub(super) fn new(model: &M, first: &Device, others: &[Device]) -> Self {
        let others = others.iter().map(|device| device.clone().autodiff());
        Self {
            first: first.clone().autodiff(),
            others: others
                .map(|device| {
                    let copy = model.clone().fork(&device);
                    (device, copy)
                })
                .collect(),
        }
    }

    /// Copies the current weights of the model to the other devices, each in one transfer.
    fn update(&mut self, model: &M) {
        let weights = Flat::of_weights(model);
        let others = std::mem::take(&mut self.others).into_iter();
        self.others = others
            .map(|(device, copy)| {
                let copy = weights.to_device(&device).put_into(copy);
                (device, copy)
            })
            .collect();
    }
}

pub(super) struct Step<'a, M, B> {
    pub(super) task: &'a Task<'a, M, B>,
    /// Micro-batches of the step, each with its share of the loss.
    pub(super) parts: &'a [(f64, B)],
    /// Seed of the step's dropout masks.
    pub(super) masks: Seed,
    pub(super) arithmetic: Arithmetic,
}

/// The losses of the micro-batches of a device, and the sum of their gradients.
type Share = (Vec<(usize, Tensor<1>)>, GradientsParams);

impl<M: Module, B: Send + Sync> Step<'_, M, B> {
    /// The loss of the step, and its gradients on the first device. Every device adds up the gradients of its share of
    /// the micro-batches. The sums are sent to the first device in one transfer each and added in the order of the
    /// devices, so the result does not depend on which device finishes first.
    pub(super) fn gradients(
        &self,
        model: &M,
        devices: &mut Devices<M>,
    ) -> (Tensor<1>, GradientsParams) {
        if self.parts.len() == 1 {
            return self.of_part(model, 0, &devices.first);
        }
        let (mut losses, gradients) = if devices.others.is_empty() {
            self.of_device(model, 0, &devices.first, 1)
        } else {
            devices.update(model);
            let mut sum = GradientsAccumulator::new();
            let mut all = Vec::new();
            for (losses, gradients) in self.shares(model, devices) {
                all.extend(losses);
                sum.accumulate(model, gradients);
            }
            (all, sum.grads())
        };
        losses.sort_by_key(|(index, _)| *index);
        let plain = devices.first.clone().inner();
        let total = losses
            .into_iter()
            .map(|(_, loss)| loss.to_device(&plain))
            .reduce(|total, loss| total + loss)
            .expect("a step has a micro-batch");
        (total, gradients)
    }

    fn shares(&self, model: &M, devices: &Devices<M>) -> Vec<Share> {
        let num_devices = 1 + devices.others.len();
        std::thread::scope(|scope| {
            let running: Vec<_> = (1..)
                .zip(&devices.others)
                .map(|(place, (device, copy))| {
                    // Each thread gets its own handle; the values are shared.
                    let copy = copy.clone();
                    scope.spawn(move || {
                        // With fewer micro-batches than devices, some devices are idle.
                        (place < self.parts.len()).then(|| {
                            let share = self.of_device(&copy, place, device, num_devices);
                            (share.0, Flat::of_gradients(&copy, &share.1))
                        })
                    })
                })
                .collect();
            let mut shares = vec![self.of_device(model, 0, &devices.first, num_devices)];
            for thread in running {
                let found = thread.join().expect("a device's thread does not panic");
                shares.extend(found.map(|(losses, gradients)| {
                    let gradients = gradients.to_device(&devices.first);
                    (losses, gradients.into_gradients(model))
                }));
            }
            shares
        })
    }

    fn of_device(&self, model: &M, place: usize, device: &Device, num_devices: usize) -> Share {
        let mut losses = Vec::new();
        let mut sum = GradientsAccumulator::new();
        for index in (place..self.parts.len()).step_by(num_devices) {
            let (loss, gradients) = self.of_part(model, index, device);
            losses.push((index, loss));
            sum.accumulate(model, gradients);
        }
        (losses, sum.grads())
    }

    /// A micro-batch's contribution to the loss, and its gradients.
    fn of_part(&self, model: &M, index: usize, device: &Device) -> (Tensor<1>, GradientsParams) {
        let (share, batch) = &self.parts[index];
        // Dropout depends on the step and the micro-batch, so that a continued run repeats it. A GPU draws its own
        // masks, from this seed.
        let seed = self.masks.draw_u64(&[&index.to_string()]);
        device.seed(seed);
        let pass = Pass::seeded(self.arithmetic, seed);
        let loss = (self.task.loss)(model, batch, device, &pass);
        let loss = loss.mul_scalar(*share);
        let value = loss.clone().inner();
        (value, GradientsParams::from_grads(loss.backward(), model))
    }
}
