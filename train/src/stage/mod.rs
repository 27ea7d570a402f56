//! Stages of training, from a dataset folder to a run folder: open the dataset, assemble the training data, train.

pub mod captioned;
pub(crate) mod coordinator;
pub mod editor;
pub(crate) mod encoder;
pub(crate) mod poses;
pub mod texts;
pub mod variants;

use compose::{ComposeConfig, Stream, library, train_stream};
use datasets_spec::record::MotionRow;
use datasets_spec::table::Row;
use datasets_spec::{Dataset, Seed, Split};
use kinematics::canonical::WINDOW_FRAMES;
use kinematics::normalise::Normalizer;

use crate::Error;
use crate::compose::ComposeRecord;

/// Tables that models depend on if they are trained on motions and captions, without composed edits.
const MOTIONS: [&str; 1] = [MotionRow::TABLE];

/// Composed windows of the training and the validation split, with the same normaliser.
struct Streams {
    compose: ComposeRecord,
    train: Stream,
    val: Stream,
    normalizer: Normalizer,
}

impl Streams {
    /// Opens the streams of a dataset for windows of `window` frames. If the composer's settings set a window other
    /// than [`WINDOW_FRAMES`], that one is used, and the model refuses it if it does not fit. The normaliser is fitted
    /// to the training split if none is given.
    fn open(
        dataset: &Dataset,
        compose: &ComposeConfig,
        window: usize,
        seed: u64,
        normalizer: Option<Normalizer>,
    ) -> Result<Self, Error> {
        let seed = Seed(seed);
        let mut compose = compose.clone();
        if compose.window == WINDOW_FRAMES {
            compose.window = window;
        }
        let (train, normalizer) = train_stream(dataset, &compose, seed, normalizer)?;
        let val = validation_stream(dataset, &compose, seed, &normalizer)?;
        Ok(Self {
            compose: ComposeRecord {
                config: compose,
                seed,
            },
            train,
            val,
            normalizer,
        })
    }
}

/// The composer's settings without those that thin, fix or mirror the training data, so that validation data stay the
/// same.
fn unthinned(compose: &ComposeConfig) -> ComposeConfig {
    ComposeConfig {
        mcm_ratio: 1.0,
        annotated_ratio: 1.0,
        fixed_pairs: false,
        mirrored_ratio: 0.0,
        ..compose.clone()
    }
}

/// Composed windows or clips of the validation split.
pub(crate) fn validation_stream(
    dataset: &Dataset,
    compose: &ComposeConfig,
    seed: Seed,
    normalizer: &Normalizer,
) -> Result<Stream, Error> {
    let library = library(dataset, Split::Val)?;
    let stream = Stream::new(library, unthinned(compose), seed, normalizer);
    stream.map_err(|source| Error::Validation { source })
}
