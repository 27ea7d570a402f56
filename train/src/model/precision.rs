//! The precision of the products of a network's layers.
//!
//! With bf16 the operands of a linear layer are rounded to bfloat16, and its result is single precision
//! again. Weights, their gradients, the optimiser, norms, softmax, sums and losses stay in single precision.

use std::sync::atomic::{AtomicBool, Ordering};

use burn::nn::Linear;
use burn::tensor::module::linear;
use burn::tensor::{DType, Device, FloatDType, Tensor};

static BF16: AtomicBool = AtomicBool::new(false);

/// Switches products in bfloat16 of this process on or off; they are off when it starts.
pub fn set_bf16(is_enabled: bool) {
    BF16.store(is_enabled, Ordering::Relaxed);
}

/// Whether products are computed in bfloat16.
pub(crate) fn is_bf16() -> bool {
    BF16.load(Ordering::Relaxed)
}

/// Whether a device computes in bfloat16.
pub fn has_bf16(device: &Device) -> bool {
    device.supports_dtype(DType::BF16)
}

/// A linear layer.
pub(crate) fn forward<const D: usize>(layer: &Linear, x: Tensor<D>) -> Tensor<D> {
    product(
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
    x: Tensor<D>,
    weight: Tensor<2>,
    bias: Option<Tensor<1>>,
) -> Tensor<D> {
    if !is_bf16() {
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
