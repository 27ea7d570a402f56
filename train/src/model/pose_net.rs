//! Networks that predict rotations from keypoints; a fit starts from their output.

use burn::module::{Module, ModuleDisplay};
use burn::nn::{BatchNorm, BatchNormConfig, LayerNorm, LayerNormConfig, Linear, LinearConfig};
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor};
use kinematics::skeleton::{FIT_KEYPOINTS, NUM_BODY_JOINTS, NUM_KEYPOINTS};

use super::weights::Networks;

/// Input width of the paper's network: 28 keypoints.
pub(crate) const PAPER_INPUT: usize = 3 * NUM_KEYPOINTS;
/// Output width of the paper's network: 22 rotation vectors.
pub(crate) const PAPER_OUTPUT: usize = 3 * NUM_BODY_JOINTS;
/// Input width of the released network: 24 joints.
pub(crate) const OFFICIAL_INPUT: usize = 3 * FIT_KEYPOINTS.len();
/// Output width of the released network: the first two rows of 22 rotation matrices.
pub(crate) const OFFICIAL_OUTPUT: usize = 6 * NUM_BODY_JOINTS;

/// Renaming rules from a plain `nn.Sequential` to our names: (pattern, our name). The recorded network of the paper has
/// these names, and the released one has them with a prefix.
pub(crate) const NAMES: [(&str, &str); 5] = [
    (r"^(layers\.)?0\.", "first."),
    (r"^(layers\.)?1\.", "first_norm."),
    (r"^(layers\.)?3\.", "second."),
    (r"^(layers\.)?4\.", "second_norm."),
    (r"^(layers\.)?6\.", "last."),
];

/// Three linear layers, the first two followed by a norm and ReLU.
#[derive(Module, Debug)]
pub(crate) struct PoseLayers<N: Module> {
    first: Linear,
    first_norm: N,
    second: Linear,
    second_norm: N,
    last: Linear,
}

impl<N: Module + ModuleDisplay> Networks for PoseLayers<N> {
    const FILE: &'static str = "model.safetensors";
}

impl<N: Module> PoseLayers<N> {
    fn of([input, width, output]: [usize; 3], norm: impl Fn() -> N, device: &Device) -> Self {
        let linear = |from, to| LinearConfig::new(from, to).init(device);
        Self {
            first: linear(input, width),
            first_norm: norm(),
            second: linear(width, width),
            second_norm: norm(),
            last: linear(width, output),
        }
    }

    fn apply(&self, x: Tensor<2>, norm: impl Fn(&N, Tensor<2>) -> Tensor<2>) -> Tensor<2> {
        let hidden = relu(norm(&self.first_norm, self.first.forward(x)));
        let hidden = relu(norm(&self.second_norm, self.second.forward(hidden)));
        self.last.forward(hidden)
    }
}

/// Three layers with layer norm: 28 keypoints to 22 rotation vectors.
///
/// # Source
/// Paper App. B.3: 84, 512, 512 and 66 numbers, ReLU and LayerNorm. The order of norm and ReLU is not
/// published; here the norm comes first.
pub(crate) type PaperPoseNet = PoseLayers<LayerNorm>;

impl PaperPoseNet {
    /// Builds the network; the published width is 512.
    pub(crate) fn new(width: usize, device: &Device) -> Self {
        let norm = || LayerNormConfig::new(width).init(device);
        Self::of([PAPER_INPUT, width, PAPER_OUTPUT], norm, device)
    }

    /// Predicts the rotation vectors of frames.
    ///
    /// # Shapes
    /// `[B, 84]` give `[B, 66]`.
    pub(crate) fn forward(&self, points: Tensor<2>) -> Tensor<2> {
        self.apply(points, |norm, x| norm.forward(x))
    }
}

/// Three layers with batch norm: 24 joints to the first two rows of 22 rotation matrices.
///
/// # Source
/// The released `joints_to_smpl`: 72, 64, 64 and 132 numbers.
pub(crate) type OfficialPoseNet = PoseLayers<BatchNorm>;

impl OfficialPoseNet {
    /// Builds the network; the released width is 64.
    pub(crate) fn new(width: usize, device: &Device) -> Self {
        let norm = || BatchNormConfig::new(width).init(device);
        Self::of([OFFICIAL_INPUT, width, OFFICIAL_OUTPUT], norm, device)
    }

    /// Predicts the rows of rotation matrices of frames.
    ///
    /// # Shapes
    /// `[B, 72]` give `[B, 132]`.
    pub(crate) fn forward(&self, joints: Tensor<2>) -> Tensor<2> {
        self.apply(joints, |norm, x| norm.forward(x))
    }
}
