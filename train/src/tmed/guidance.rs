//! Guidance of TMED by the instruction and by the source.

use burn::tensor::Tensor;

use crate::model::pass::Pass;
use crate::model::tmed::{Condition, Tmed};

/// A pass through the network with some of the conditions, and its weight in the estimate of the clean motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Branch {
    /// Factor of the branch's prediction.
    pub weight: f64,
    /// Whether the branch is given the instruction.
    pub has_text: bool,
    /// Whether the branch is given the source.
    pub has_source: bool,
}

/// The branches of the estimate `u + s_m (m - u) + s_t (f - m)`: `u` has no condition, `m` the source, and `f` source
/// and instruction. Branches that cancel are left out: with equal weights `m`, and with both weights 1 all but `f`.
///
/// # Source
/// MotionFix, `forward_with_guidance` ("3way"); Brooks et al. 2023, Eq. 3.
pub fn branches(text: f64, source: f64) -> Vec<Branch> {
    let branch = |weight, has_text, has_source| Branch {
        weight,
        has_text,
        has_source,
    };
    let mut all = vec![
        branch(1.0 - source, false, false),
        branch(source - text, false, true),
        branch(text, true, true),
    ];
    all.retain(|branch| branch.weight != 0.0);
    all
}

/// Estimates the clean motions of `x` at a diffusion step.
///
/// # Shapes
/// `x` and the result `[B, T, F]`; `lengths` `[B]`. The condition has `B` rows of the first branch, then `B` rows of
/// the second, and so on.
pub fn guided(
    denoiser: &Tmed,
    branches: &[Branch],
    condition: &Condition,
    x: &Tensor<3>,
    lengths: &[usize],
    timestep: usize,
    pass: &Pass,
) -> Tensor<3> {
    let [batch, frames, num_features] = x.dims();
    let count = branches.len();
    let predicted = denoiser.forward(
        x.clone().repeat_dim(0, count),
        &lengths.repeat(count),
        &vec![timestep; count * batch],
        condition,
        pass,
    );
    let mut sum = Tensor::zeros([batch, frames, num_features], &x.device());
    for (index, branch) in branches.iter().enumerate() {
        let rows = predicted.clone().narrow(0, index * batch, batch);
        sum = sum + rows.mul_scalar(branch.weight);
    }
    sum
}
