//! The networks and the body model used for measuring; the caller provides them.

use datasets_spec::{Motion, Skeleton};

use crate::error::EncoderError;

/// A frozen network that maps motions to latents. The distance of latents measures how much motions differ.
pub trait MotionEncoder {
    /// Encodes motions: one latent for each motion, in order, all of one width.
    ///
    /// # Errors
    /// The encoder's own error.
    fn encode(&self, motions: &[&Motion]) -> Result<Vec<Vec<f64>>, EncoderError>;

    /// The hash of the weights in hexadecimal. Scores with different hashes are not comparable.
    fn hash(&self) -> String;

    /// How the encoder was trained, in one line for the head of a table.
    fn recipe(&self) -> String;

    /// Why scores with this encoder cannot rank systems, such as
    /// [`JudgeReport::weakness`](crate::judge::JudgeReport::weakness); `None` if they can.
    fn weakness(&self) -> Option<String>;
}

/// A network that classifies motions as natural or composed of several motions.
pub trait MotionClassifier {
    /// The share of each motion's windows classified as composed, in [0, 1]; `None` for a motion shorter than a window.
    ///
    /// # Errors
    /// The network's own error.
    fn composed(&self, motions: &[&Motion]) -> Result<Vec<Option<f64>>, EncoderError>;

    /// The hash of the weights in hexadecimal, which the protocol of a score names.
    fn hash(&self) -> String;
}

/// Networks and body model for measuring motions.
#[derive(Clone, Copy)]
pub struct Evaluators<'a> {
    /// Encoder of motions.
    pub encoder: &'a dyn MotionEncoder,
    /// Classifier of composed and natural motions; without it the metric "Composed" is left out.
    pub classifier: Option<&'a dyn MotionClassifier>,
    /// The skeleton of the motions.
    pub skeleton: &'a Skeleton,
}
