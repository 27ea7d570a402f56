//! The networks from keypoints to rotations, whose output a fit starts from.

use burn::module::Module;
use burn::nn::{BatchNorm, BatchNormConfig, LayerNorm, LayerNormConfig, Linear, LinearConfig};
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor};
use kinematics::skeleton::{FIT_KEYPOINTS, NUM_BODY_JOINTS, NUM_KEYPOINTS};

/// Numbers of a frame the network of the paper sees: 28 keypoints.
pub const PAPER_INPUT: usize = 3 * NUM_KEYPOINTS;
/// Numbers it gives: 22 rotation vectors.
pub const PAPER_OUTPUT: usize = 3 * NUM_BODY_JOINTS;
/// Numbers of a frame the released network sees: 24 joints.
pub const OFFICIAL_INPUT: usize = 3 * FIT_KEYPOINTS.len();
/// Numbers it gives: the first two rows of 22 rotation matrices.
pub const OFFICIAL_OUTPUT: usize = 6 * NUM_BODY_JOINTS;

/// Where the names of the released network differ from ours: (pattern, ours).
pub const OFFICIAL_NAMES: [(&str, &str); 5] = [
    (r"^layers\.0\.", "first."),
    (r"^layers\.1\.", "first_norm."),
    (r"^layers\.3\.", "second."),
    (r"^layers\.4\.", "second_norm."),
    (r"^layers\.6\.", "last."),
];
/// The same of a plain sequence of layers, as the recorded network of the paper is named.
pub const PAPER_NAMES: [(&str, &str); 5] = [
    (r"^0\.", "first."),
    (r"^1\.", "first_norm."),
    (r"^3\.", "second."),
    (r"^4\.", "second_norm."),
    (r"^6\.", "last."),
];

/// Three layers with layer norm: 28 keypoints to 22 rotation vectors.
///
/// # Source
/// Paper App. B.3: 84, 512, 512 and 66 numbers, ReLU and LayerNorm. The order of norm and ReLU is not
/// published; here the norm comes first.
#[derive(Module, Debug)]
pub struct PaperPoseNet {
    first: Linear,
    first_norm: LayerNorm,
    second: Linear,
    second_norm: LayerNorm,
    last: Linear,
}

impl PaperPoseNet {
    /// Builds the network; the published width is 512.
    pub fn new(width: usize, device: &Device) -> Self {
        Self {
            first: LinearConfig::new(PAPER_INPUT, width).init(device),
            first_norm: LayerNormConfig::new(width).init(device),
            second: LinearConfig::new(width, width).init(device),
            second_norm: LayerNormConfig::new(width).init(device),
            last: LinearConfig::new(width, PAPER_OUTPUT).init(device),
        }
    }

    /// Rotation vectors of frames.
    ///
    /// # Shapes
    /// `[B, 84]` give `[B, 66]`.
    pub fn forward(&self, points: Tensor<2>) -> Tensor<2> {
        let hidden = relu(self.first_norm.forward(self.first.forward(points)));
        let hidden = relu(self.second_norm.forward(self.second.forward(hidden)));
        self.last.forward(hidden)
    }
}

/// Three layers with batch norm: 24 joints to the first two rows of 22 rotation matrices.
///
/// # Source
/// The released `joints_to_smpl`: 72, 64, 64 and 132 numbers.
#[derive(Module, Debug)]
pub struct OfficialPoseNet {
    first: Linear,
    first_norm: BatchNorm,
    second: Linear,
    second_norm: BatchNorm,
    last: Linear,
}

impl OfficialPoseNet {
    /// Builds the network; the released width is 64.
    pub fn new(width: usize, device: &Device) -> Self {
        Self {
            first: LinearConfig::new(OFFICIAL_INPUT, width).init(device),
            first_norm: BatchNormConfig::new(width).init(device),
            second: LinearConfig::new(width, width).init(device),
            second_norm: BatchNormConfig::new(width).init(device),
            last: LinearConfig::new(width, OFFICIAL_OUTPUT).init(device),
        }
    }

    /// Rows of rotation matrices of frames.
    ///
    /// # Shapes
    /// `[B, 72]` give `[B, 132]`.
    pub fn forward(&self, joints: Tensor<2>) -> Tensor<2> {
        let hidden = relu(self.first_norm.forward(self.first.forward(joints)));
        let hidden = relu(self.second_norm.forward(self.second.forward(hidden)));
        self.last.forward(hidden)
    }
}
