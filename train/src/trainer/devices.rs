//! Computes the loss and the gradients of a step, on several threads of the processor or on one or several devices.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;

use burn::module::{Module, ModuleMapper, Param};
use burn::optim::{GradientsAccumulator, GradientsParams};
use burn::tensor::{Device, Tensor};
use datasets_spec::Seed;
use rayon::{ThreadPool, ThreadPoolBuilder};

use super::flat::Flat;
use super::task::Task;
use crate::Session;
use crate::model::pass::{Arithmetic, Pass};

/// Number of samples in a micro-batch: that of the settings, or less on a processor. It does not depend on the number
/// of threads, nor do the results.
pub(super) fn micro_batch<M, B>(task: &Task<'_, M, B>, session: &Session<'_>) -> usize {
    let of_settings = task.run.micro_batch();
    match task.of_thread {
        // Several threads would draw from the one generator of burn's own dropout.
        Some(of_thread)
            if session.arithmetic.uses_kernels(session.device)
                && session.more_devices.is_empty() =>
        {
            of_settings.min(of_thread)
        }
        _ => of_settings,
    }
}

pub(super) struct Devices<M> {
    first: Device,
    /// The other devices, each with a copy of the model.
    others: Vec<(Device, M)>,
    /// Limit of the number of micro-batches that the processor computes at the same time.
    at_once: usize,
    /// A pool of threads for each of them; empty before the first step.
    pools: Vec<ThreadPool>,
}

impl<M: Module> Devices<M> {
    /// `at_once` is the number of micro-batches whose tensors fit into memory.
    pub(super) fn new(model: &M, session: &Session<'_>, at_once: usize) -> Self {
        let others = session.more_devices.iter();
        let others = others.map(|device| device.clone().autodiff());
        Self {
            first: session.device.clone().autodiff(),
            others: others
                .map(|device| {
                    let copy = model.clone().fork(&device);
                    (device, copy)
                })
                .collect(),
            at_once: at_once.min(rayon::current_num_threads()),
            pools: Vec::new(),
        }
    }

    /// Makes the pools in the first step, which has `num_parts` micro-batches.
    fn start_threads(&mut self, num_parts: usize) {
        let at_once = self.at_once.min(num_parts);
        if at_once > 1 && self.pools.is_empty() {
            let threads = rayon::current_num_threads() / at_once;
            let pool = |_| ThreadPoolBuilder::new().num_threads(threads).build();
            let pools = (0..at_once).map(pool).collect::<Result<_, _>>();
            self.pools = pools.expect("the system starts a few threads");
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

/// A copy of a model with the same values and its own graph for automatic differentiation. [`Module::fork`] would add a
/// node for each parameter to the graph of the model, and burn never frees the nodes of parameters that no loss uses.
fn twin<M: Module>(model: &M) -> M {
    struct Twin;
    impl ModuleMapper for Twin {
        fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
            param.map(|values| {
                let is_trained = values.is_require_grad();
                Tensor::from_inner(values.inner()).set_require_grad(is_trained)
            })
        }
    }
    model.clone().map(&mut Twin)
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
        devices.start_threads(self.parts.len());
        let (mut losses, gradients) = if !devices.pools.is_empty() {
            self.on_threads(model, devices)
        } else if devices.others.is_empty() {
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

    /// Computes micro-batches side by side on the processor. Gradients are added in the order of the micro-batches, so
    /// the sum does not depend on which thread finishes first.
    fn on_threads(&self, model: &M, devices: &Devices<M>) -> Share {
        let device = &devices.first;
        let next = AtomicUsize::new(0);
        let (sender, made) = mpsc::channel();
        std::thread::scope(|scope| {
            for pool in &devices.pools {
                let (copy, sender, next) = (twin(model), sender.clone(), &next);
                let work = move || {
                    loop {
                        let index = next.fetch_add(1, Ordering::Relaxed);
                        if index >= self.parts.len() {
                            break;
                        }
                        let part = self.of_part(&copy, index, device);
                        sender
                            .send((index, part))
                            .expect("the receiver waits for all");
                    }
                };
                scope.spawn(move || pool.install(work));
            }
            drop(sender);
            let (mut losses, mut sum) = (Vec::new(), GradientsAccumulator::new());
            let mut early = BTreeMap::new();
            for (index, part) in made {
                early.insert(index, part);
                while let Some((loss, gradients)) = early.remove(&losses.len()) {
                    losses.push((losses.len(), loss));
                    sum.accumulate(model, gradients);
                }
            }
            (losses, sum.grads())
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
