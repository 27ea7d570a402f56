//! Texts that models trained on a dataset take as input.

use std::collections::BTreeSet;

use compose::{ComposeConfig, library};
use datasets_spec::record::{MaskRow, MotionRow, PairRow};
use datasets_spec::table::Row;
use datasets_spec::{Dataset, Split};

use crate::Error;

/// Every text that a model trained on a dataset can receive in training, validation and evaluation: the instructions of
/// composed edits of all splits, all captions, and the empty text, in alphabetical order. A table with the vectors of
/// these texts suffices for all models.
///
/// # Errors
/// The dataset cannot be read, or a setting is out of range.
pub fn texts(dataset: &Dataset, compose: &ComposeConfig) -> Result<Vec<String>, Error> {
    compose.check()?;
    let mut texts = BTreeSet::from([String::new()]);
    for row in dataset.read::<MotionRow>(None)? {
        texts.extend(row.captions.into_iter().map(|caption| caption.text));
    }
    for split in Split::ALL {
        let rows = |table| dataset.manifest().rows(table, Some(split));
        if rows(MaskRow::TABLE) + rows(PairRow::TABLE) > 0 {
            texts.extend(library(dataset, split)?.instructions(compose));
        }
    }
    Ok(texts.into_iter().collect())
}
