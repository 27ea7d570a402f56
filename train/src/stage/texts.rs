//! Texts that models trained on a dataset take as input.

use std::collections::BTreeSet;

use compose::{ComposeConfig, Stream, library, train_stream};
use datasets_spec::record::{MaskRow, MotionRow, PairRow};
use datasets_spec::table::Row;
use datasets_spec::{Dataset, Seed, Split};

use super::unthinned;
use crate::Error;

/// Every text that a model trained on a dataset can receive in training, validation and evaluation: the instructions of
/// composed edits of all splits, all captions, and the empty text, in alphabetical order. A table with the vectors of
/// these texts suffices for all models.
///
/// # Errors
/// The dataset cannot be read, or its training split cannot be composed.
pub fn texts(dataset: &Dataset, compose: &ComposeConfig) -> Result<Vec<String>, Error> {
    let rows = |table, split| dataset.manifest().rows(table, Some(split));
    let mut texts = BTreeSet::from([String::new()]);
    for row in dataset.read::<MotionRow>(None)? {
        texts.extend(row.captions.into_iter().map(|caption| caption.text));
    }
    let compose = ComposeConfig {
        mirrored_ratio: compose.mirrored_ratio,
        ..unthinned(compose)
    };
    let seed = Seed(0);
    let annotated = |split| rows(MaskRow::TABLE, split) + rows(PairRow::TABLE, split) > 0;
    if annotated(Split::Train) {
        let (stream, normalizer) = train_stream(dataset, &compose, seed, None)?;
        texts.extend(stream.instructions());
        for split in [Split::Val, Split::Test] {
            if !annotated(split) {
                continue;
            }
            let stream = Stream::new(library(dataset, split)?, compose.clone(), seed, &normalizer);
            match stream {
                Ok(stream) => texts.extend(stream.instructions()),
                // The split has no motion of a window's length, so it has no instructions.
                Err(compose::Error::NoItem { .. }) => {}
                Err(error) => return Err(error.into()),
            }
        }
    }
    Ok(texts.into_iter().collect())
}
