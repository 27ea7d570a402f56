//! The networks and the body model used for measuring; the caller provides them.

use datasets_spec::{Motion, Skeleton};

use crate::error::EncoderError;

/// A frozen network that maps motions to latents in which distance means difference.
pub trait MotionEncoder {
    /// One latent for each motion, in order, all of one width.
    ///
    /// # Errors
    /// The encoder's own error.
    fn encode(&self, motions: &[&Motion]) -> Result<Vec<Vec<f64>>, EncoderError>;

    /// The hash of the weights in hexadecimal; scores of different hashes are not comparable.
    fn hash(&self) -> String;

    /// How the encoder was trained, in one line for the head of a table.
    fn recipe(&self) -> String;

    /// Why scores with this encoder rank no system, such as [`JudgeReport::weakness`](crate::judge::JudgeReport::weakness);
    /// none if they do.
    fn weakness(&self) -> Option<String>;
}

/// A network that classifies motions as natural or composed of several motions.
pub trait MotionClassifier {
    /// The share of each motion's windows classified as composed, in [0, 1].
    ///
    /// # Errors
    /// The network's own error.
    fn composed(&self, motions: &[&Motion]) -> Result<Vec<f64>, EncoderError>;
}

/// Networks and body model for measuring motions.
#[derive(Clone, Copy)]
pub struct Evaluators<'a> {
    /// Maps motions to latents.
    pub encoder: &'a dyn MotionEncoder,
    /// Tells composed motions from natural ones; none leaves the metric out.
    pub classifier: Option<&'a dyn MotionClassifier>,
    /// The body of the motions.
    pub skeleton: &'a Skeleton,
}
