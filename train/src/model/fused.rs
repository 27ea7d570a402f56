//! The encoder layer on a processor: one operation with its own backward pass. This is the only file that calls the
//! kernels for a model; the model files are plain burn modules.
//!
//! A layer composed of tensor operations passes over arrays of activations about forty times, half of them only to
//! copy, mask or sum. The fused layer reads and writes every array once. Tests compare it with the composed layer, also
//! on another backend.

use std::sync::{Arc, Mutex, PoisonError};

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::NoCheckpointing;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Flex};
use burn::tensor::{DType, Tensor, TensorData};
use kernels::attention::{self, Heads};
use kernels::on_workers;
use kernels::product::{Matrix, Write, matrix, multiply};
use kernels::rows::{
    Mask, Norm, NormGrads, add_bias, column_sums, factors, gelu_dropout, residual_norm,
    residual_norm_backward, times_derivatives,
};

/// Values of a tensor on the processor's backend.
type Buffer = FloatTensor<Flex>;
/// A tensor on the processor's backend with automatic differentiation.
type Tracked = FloatTensor<Autodiff<Flex>>;

/// The factors of a dropout: 0 with probability `prob`, otherwise `1 / (1 - prob)`.
pub(crate) fn dropout_factors(prob: f64, key: u64, count: usize) -> Vec<f32> {
    factors(Mask::new(prob, key), count)
}

/// The trainable tensors of a layer. The vectors are the biases of the four weights, then gamma and beta of both norms.
pub(crate) struct LayerTensors {
    pub(crate) weights: [Tensor<2>; 4],
    pub(crate) vectors: [Tensor<1>; 8],
}

/// Indices of the weights in [`LayerTensors::weights`].
const IN_PROJ: usize = 0;
const OUT_PROJ: usize = 1;
const LINEAR1: usize = 2;
const LINEAR2: usize = 3;

/// A layer ready to be applied.
#[derive(Debug)]
pub(crate) struct PreparedLayer {
    weights: [Buffer; 4],
    vectors: [Buffer; 8],
    num_heads: usize,
}

impl PreparedLayer {
    /// Prepares a layer whose tensors are on the processor.
    fn new(weights: [Buffer; 4], vectors: [Buffer; 8], num_heads: usize) -> Self {
        Self {
            weights: weights.map(|weight| weight.to_contiguous()),
            vectors: vectors.map(|vector| vector.to_contiguous()),
            num_heads,
        }
    }

    /// Prepares a layer for inference; none if its tensors are on another device.
    pub(crate) fn for_inference(tensors: LayerTensors, num_heads: usize) -> Option<Self> {
        let weights = all(tensors.weights.map(plain))?;
        let vectors = all(tensors.vectors.map(plain))?;
        Some(Self::new(weights, vectors, num_heads))
    }

    fn width(&self) -> usize {
        self.weight(OUT_PROJ).ncols()
    }

    fn weight(&self, index: usize) -> Matrix<'_> {
        let tensor = &self.weights[index];
        matrix(numbers(tensor), tensor.layout().shape()[1])
    }
}

/// Dropout masks of the steps of a layer.
#[derive(Clone, Copy, Debug)]
struct Masks {
    weights: Mask,
    attended: Mask,
    hidden: Mask,
    output: Mask,
}

impl Masks {
    fn new(prob: f64, key: u64) -> Self {
        // The keys of the masks differ in both 32-bit halves. The constant is derived from the golden ratio.
        let mask = |part: u64| {
            let key = key.wrapping_add((part + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
            Mask::new(prob, key)
        };
        Self {
            weights: mask(0),
            attended: mask(1),
            hidden: mask(2),
            output: mask(3),
        }
    }
}

/// Intermediate results that the backward pass needs; `R` is the number of rows of all sequences.
#[derive(Debug, Default)]
struct Saved {
    /// Queries, keys and values, `[R, 3 d]`.
    joint: Vec<f32>,
    /// Attention weights before dropout, `[B, heads, T, T]`.
    weights: Vec<f32>,
    /// `[R, d]`
    attended: Vec<f32>,
    /// Normalised rows of the first norm, `[R, d]`, and their inverse standard deviations.
    first: (Vec<f32>, Vec<f32>),
    /// Input of the feed-forward block, `[R, d]`.
    middle: Vec<f32>,
    /// Derivatives of the dropped-out GELU, `[R, f]`.
    derivatives: Vec<f32>,
    /// Values of the hidden layer, `[R, f]`.
    hidden: Vec<f32>,
    /// Normalised rows of the second norm, `[R, d]`, and their inverse standard deviations.
    second: (Vec<f32>, Vec<f32>),
}

impl PreparedLayer {
    fn heads<'a>(&self, length: usize, padding: Option<&'a [bool]>) -> Heads<'a> {
        Heads {
            length,
            width: self.width(),
            count: self.num_heads,
            padding,
        }
    }

    /// Applies the layer to sequences without dropout; `scratch` is overwritten.
    fn infer(&self, x: &[f32], heads: Heads<'_>, scratch: &mut Saved, out: &mut [f32]) {
        self.forward(x, heads, Masks::new(0.0, 0), false, scratch, out);
    }

    fn product(&self, x: &[f32], weight: usize, out: &mut Vec<f32>) {
        let weight = self.weight(weight);
        let x = matrix(x, weight.nrows());
        resize(out, x.nrows() * weight.ncols());
        multiply(x, weight, out, Write::Replace);
    }

    fn norm(&self, index: usize) -> Norm<'_> {
        Norm {
            gamma: numbers(&self.vectors[4 + 2 * index]),
            beta: numbers(&self.vectors[5 + 2 * index]),
        }
    }

    /// Forward pass. `out` is as large as `x`; `saved` is overwritten.
    fn forward(
        &self,
        x: &[f32],
        heads: Heads<'_>,
        masks: Masks,
        with_derivatives: bool,
        saved: &mut Saved,
        out: &mut [f32],
    ) {
        let bias = |weight: usize| numbers(&self.vectors[weight]);
        let Saved {
            joint,
            weights,
            attended,
            first,
            middle,
            derivatives,
            hidden,
            second,
        } = saved;
        self.product(x, IN_PROJ, joint);
        add_bias(joint, bias(IN_PROJ));
        let rows = x.len() / heads.width;
        resize(weights, rows * heads.count * heads.length);
        resize(attended, x.len());
        attention::forward(heads, joint, masks.weights, weights, attended);

        self.product(attended, OUT_PROJ, &mut first.0);
        resize(middle, x.len());
        first.1 = residual_norm(
            &mut first.0,
            bias(OUT_PROJ),
            x,
            self.norm(0),
            masks.attended,
            middle,
        );

        self.product(middle, LINEAR1, derivatives);
        resize(hidden, derivatives.len());
        gelu_dropout(
            derivatives,
            bias(LINEAR1),
            masks.hidden,
            with_derivatives,
            hidden,
        );
        self.product(hidden, LINEAR2, &mut second.0);
        second.1 = residual_norm(
            &mut second.0,
            bias(LINEAR2),
            middle,
            self.norm(1),
            masks.output,
            out,
        );
    }
}

/// Resizes a buffer whose values will all be overwritten.
fn resize(values: &mut Vec<f32>, count: usize) {
    values.resize(count, 0.0);
}

/// An encoder without padding and dropout, ready to be applied many times.
#[derive(Debug)]
pub(crate) struct PreparedEncoder {
    layers: Vec<PreparedLayer>,
    /// Scratch buffers of a pass, reused by the next one.
    scratch: Mutex<Saved>,
}

impl PreparedEncoder {
    /// Collects layers; none if one could not be prepared.
    pub(crate) fn new(layers: impl IntoIterator<Item = Option<PreparedLayer>>) -> Option<Self> {
        let layers = layers.into_iter().collect::<Option<_>>()?;
        Some(Self {
            layers,
            scratch: Mutex::default(),
        })
    }

    /// Applies all layers; none if `x` is on another device.
    ///
    /// # Shapes
    /// `[B, T, d]` to `[B, T, d]`
    pub(crate) fn forward(&self, x: Tensor<3>) -> Option<Tensor<3>> {
        let [_, length, _] = x.dims();
        let x = plain(x)?.to_contiguous();
        let (mut from, mut to) = (numbers(&x).to_vec(), vec![0.0; numbers(&x).len()]);
        // A concurrent pass finds empty buffers and allocates new ones.
        let lock = || self.scratch.lock().unwrap_or_else(PoisonError::into_inner);
        let mut scratch = std::mem::take(&mut *lock());
        on_workers(|| {
            for layer in &self.layers {
                layer.infer(&from, layer.heads(length, None), &mut scratch, &mut to);
                std::mem::swap(&mut from, &mut to);
            }
        });
        *lock() = scratch;
        Some(Tensor::from_primitive::<Flex>(shaped_like(from, &x)))
    }
}

/// Backward operation of the fused layer in burn's autodiff.
#[derive(Debug)]
struct LayerBackward;

/// Saved tensors for the backward pass.
#[derive(Debug)]
struct LayerState {
    layer: PreparedLayer,
    x: Buffer,
    length: usize,
    padding: Option<Arc<[bool]>>,
    masks: Masks,
    saved: Saved,
}

impl Backward<Flex, 13> for LayerBackward {
    type State = Arc<LayerState>;

    fn backward(
        self,
        ops: Ops<Self::State, 13>,
        grads: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let grad = grads.consume::<Flex>(&ops.node);
        let has_grad = ops.parents.each_ref().map(Option::is_some);
        let found = on_workers(|| ops.state.backward(grad, has_grad));
        for (parent, grad) in ops.parents.into_iter().zip(found) {
            if let (Some(parent), Some(grad)) = (parent, grad) {
                grads.register::<Flex>(parent.id, grad);
            }
        }
    }
}

/// Gradients of a block: of its two weights if requested, of the first weight's bias, and of the norm.
struct BlockGrads {
    weights: [Option<Buffer>; 2],
    bias: Vec<f32>,
    norm: NormGrads,
}

impl LayerState {
    /// Gradients of the input, the weights and the vectors. Those of weights are computed only if requested.
    fn backward(&self, grad: Buffer, has_grad: [bool; 13]) -> [Option<Buffer>; 13] {
        let mut residual = numbers(&grad.to_contiguous()).to_vec();
        // The gradient of a branch. Without dropout it equals the residual's, and the buffer stays empty.
        let is_dropped = self.masks.output.is_active();
        let count = if is_dropped { residual.len() } else { 0 };
        let mut branch = vec![0.0f32; count];
        let [_, has_weights @ .., _, _, _, _, _, _, _, _] = has_grad;
        let of_forward = self.feed_forward_backward(&mut residual, &mut branch, has_weights);
        let (of_attention, of_joint) =
            self.attention_backward(&mut residual, &mut branch, has_weights);
        let of_x = has_grad[0].then(|| {
            let (left, right) = self.back(&of_joint, IN_PROJ);
            multiply(left, right, &mut residual, Write::Add);
            let shape = self.x.layout().shape();
            buffer(residual, [shape[0], shape[1], shape[2]])
        });
        let vector = |values: Vec<f32>| {
            let length = values.len();
            Some(buffer(values, [length]))
        };
        let [of_in_proj, of_out_proj] = of_attention.weights;
        let [of_linear1, of_linear2] = of_forward.weights;
        let (first, second) = (of_attention.norm, of_forward.norm);
        [
            of_x,
            of_in_proj,
            of_out_proj,
            of_linear1,
            of_linear2,
            vector(of_attention.bias),
            vector(first.bias),
            vector(of_forward.bias),
            vector(second.bias),
            vector(first.gamma),
            vector(first.beta),
            vector(second.gamma),
            vector(second.beta),
        ]
    }

    /// The backward pass of the second norm and the feed-forward block: `residual` is the gradient of the layer's
    /// output, and becomes the gradient of the block's input.
    fn feed_forward_backward(
        &self,
        residual: &mut [f32],
        branch: &mut [f32],
        has_weights: [bool; 4],
    ) -> BlockGrads {
        let Self { layer, saved, .. } = self;
        let (norm, of_output) = self.norm_backward(1, residual, branch);
        let of_linear2 = self.of_weight(LINEAR2, &saved.hidden, of_output, has_weights);
        let (left, right) = self.back(of_output, LINEAR2);
        let mut of_hidden = product(left, right);
        let hidden_width = layer.weight(LINEAR1).ncols();
        let bias = times_derivatives(&mut of_hidden, &saved.derivatives, hidden_width);
        let of_linear1 = self.of_weight(LINEAR1, &saved.middle, &of_hidden, has_weights);
        let (left, right) = self.back(&of_hidden, LINEAR1);
        multiply(left, right, residual, Write::Add);
        BlockGrads {
            weights: [of_linear1, of_linear2],
            bias,
            norm,
        }
    }

    /// The backward pass of the first norm and attention: `residual` becomes the gradient of the residual connection
    /// around attention. The second result is the gradient of queries, keys and values.
    fn attention_backward(
        &self,
        residual: &mut [f32],
        branch: &mut [f32],
        has_weights: [bool; 4],
    ) -> (BlockGrads, Vec<f32>) {
        let saved = &self.saved;
        let heads = self.layer.heads(self.length, self.padding.as_deref());
        let (norm, of_output) = self.norm_backward(0, residual, branch);
        let of_out_proj = self.of_weight(OUT_PROJ, &saved.attended, of_output, has_weights);
        let (left, right) = self.back(of_output, OUT_PROJ);
        let of_attended = product(left, right);
        let of_joint = attention::backward(
            heads,
            &saved.joint,
            self.masks.weights,
            &saved.weights,
            &of_attended,
        );
        let of_in_proj = self.of_weight(IN_PROJ, numbers(&self.x), &of_joint, has_weights);
        let grads = BlockGrads {
            weights: [of_in_proj, of_out_proj],
            bias: column_sums(&of_joint, 3 * heads.width),
            norm,
        };
        (grads, of_joint)
    }

    /// The backward pass of a norm. Returns the gradients of its parameters, and that of its branch: without dropout,
    /// the residual's.
    fn norm_backward<'a>(
        &self,
        index: usize,
        residual: &'a mut [f32],
        branch: &'a mut [f32],
    ) -> (NormGrads, &'a [f32]) {
        let (saved, mask) = match index {
            0 => (&self.saved.first, self.masks.attended),
            _ => (&self.saved.second, self.masks.output),
        };
        let (normalised, scales) = saved;
        let gamma = self.layer.norm(index).gamma;
        let norm = residual_norm_backward(residual, normalised, scales, gamma, mask, branch);
        let of_branch: &[f32] = if mask.is_active() { branch } else { residual };
        (norm, of_branch)
    }

    /// The gradient of a weight that multiplied `x`, if it is requested.
    fn of_weight(
        &self,
        weight: usize,
        x: &[f32],
        grad: &[f32],
        has_weights: [bool; 4],
    ) -> Option<Buffer> {
        has_weights[weight].then(|| {
            let [inputs, outputs] = [x, grad].map(|values| values.len() / self.rows());
            let grad = matrix(grad, outputs);
            let values = product(matrix(x, inputs).transpose(), grad);
            buffer(values, [inputs, outputs])
        })
    }

    /// The two factors whose product is the gradient of the values that a weight multiplied. `grad` is the gradient of
    /// the result.
    fn back<'a>(&'a self, grad: &'a [f32], weight: usize) -> (Matrix<'a>, Matrix<'a>) {
        (
            matrix(grad, grad.len() / self.rows()),
            self.layer.weight(weight).transpose(),
        )
    }

    fn rows(&self) -> usize {
        self.saved.middle.len() / self.layer.width()
    }
}

/// Applies a layer whose tensors are all on the processor; none if one is not.
///
/// `draw_key` draws the key of the dropout masks; it is called only if `prob` is above zero.
///
/// # Shapes
/// `x` and the result `[B, T, d]`; `padding` `[B * T]`.
pub(crate) fn encoder_layer(
    x: &Tensor<3>,
    tensors: LayerTensors,
    num_heads: usize,
    padding: Option<Arc<[bool]>>,
    prob: f64,
    draw_key: impl FnOnce() -> u64,
) -> Option<Tensor<3>> {
    let [_, length, _] = x.dims();
    if !x.device().is_autodiff() {
        let layer = PreparedLayer::for_inference(tensors, num_heads)?;
        let x = plain(x.clone())?.to_contiguous();
        let mut out = vec![0.0; numbers(&x).len()];
        on_workers(|| {
            let heads = layer.heads(length, padding.as_deref());
            layer.infer(numbers(&x), heads, &mut Saved::default(), &mut out);
        });
        return Some(Tensor::from_primitive::<Flex>(shaped_like(out, &x)));
    }
    let x = tracked(x.clone())?;
    let weights = all(tensors.weights.map(tracked))?;
    let vectors = all(tensors.vectors.map(tracked))?;
    let key = if prob > 0.0 { draw_key() } else { 0 };
    let masks = Masks::new(prob, key);

    let buffers = weights.each_ref().map(|weight| weight.primitive().clone());
    let norms_and_biases = vectors.each_ref().map(|vector| vector.primitive().clone());
    let input = x.primitive().to_contiguous();
    let mut saved = Saved::default();
    let mut out = vec![0.0; numbers(&input).len()];
    let layer = on_workers(|| {
        let layer = PreparedLayer::new(buffers, norms_and_biases, num_heads);
        let heads = layer.heads(length, padding.as_deref());
        layer.forward(numbers(&input), heads, masks, true, &mut saved, &mut out);
        layer
    });
    let out = shaped_like(out, &input);

    let [w0, w1, w2, w3] = weights.each_ref().map(Tracked::node);
    let [v0, v1, v2, v3, v4, v5, v6, v7] = vectors.each_ref().map(Tracked::node);
    let nodes = [x.node(), w0, w1, w2, w3, v0, v1, v2, v3, v4, v5, v6, v7];
    let out = match LayerBackward
        .prepare::<NoCheckpointing>(nodes)
        .compute_bound()
        .stateful()
    {
        OpsKind::Tracked(prepared) => {
            let state = LayerState {
                layer,
                x: input,
                length,
                padding,
                masks,
                saved,
            };
            prepared.finish(Arc::new(state), out)
        }
        OpsKind::UnTracked(prepared) => prepared.finish(out),
    };
    Some(Tensor::from_primitive::<Autodiff<Flex>>(out))
}

fn product(a: Matrix<'_>, b: Matrix<'_>) -> Vec<f32> {
    let mut out = vec![0.0; a.nrows() * b.ncols()];
    multiply(a, b, &mut out, Write::Replace);
    out
}

fn all<T, const N: usize>(values: [Option<T>; N]) -> Option<[T; N]> {
    let values: Vec<T> = values.into_iter().collect::<Option<_>>()?;
    values.try_into().ok()
}

/// The values of a single-precision tensor on the processor; none if it has another type, is on another device or has
/// automatic differentiation.
fn plain<const D: usize>(tensor: Tensor<D>) -> Option<Buffer> {
    if tensor.dtype() != DType::F32 {
        return None;
    }
    tensor.try_into_primitive::<Flex>().ok()
}

/// A tensor on the processor with its node in the autodiff graph. A tensor without gradients becomes a constant.
fn tracked<const D: usize>(tensor: Tensor<D>) -> Option<Tracked> {
    if tensor.dtype() != DType::F32 {
        return None;
    }
    if tensor.device().is_autodiff() {
        tensor.try_into_primitive::<Autodiff<Flex>>().ok()
    } else {
        plain(tensor).map(Tracked::new)
    }
}

/// The values of a contiguous tensor.
fn numbers(tensor: &Buffer) -> &[f32] {
    tensor
        .as_slice()
        .expect("contiguous tensors of f32 are kept")
}

fn buffer<const D: usize>(values: Vec<f32>, shape: [usize; D]) -> Buffer {
    Buffer::from_data(TensorData::new(values, shape))
}

fn shaped_like(values: Vec<f32>, tensor: &Buffer) -> Buffer {
    Buffer::from_data(TensorData::new(values, tensor.layout().shape().clone()))
}
