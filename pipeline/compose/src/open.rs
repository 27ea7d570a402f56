//! Libraries and streams of datasets.

use std::sync::Arc;

use datasets_spec::record::{MaskRow, MotionRow, PairRow};
use datasets_spec::table::Row as _;
use datasets_spec::{Dataset, Seed, Split};
use kinematics::normalise::Normalizer;

use crate::{ComposeConfig, Error, FrameCache, Library, Stream};

/// Tables that composed edits depend on.
pub const COMPOSED: [&str; 3] = [MotionRow::TABLE, MaskRow::TABLE, PairRow::TABLE];

/// The motions, masks and pairs of one split. The environment names the folder of their frames ([`FrameCache`]).
///
/// # Errors
/// The split has no clips, or neither masks nor pairs, or a table cannot be read.
pub fn library(dataset: &Dataset, split: Split) -> Result<Arc<Library>, Error> {
    let rows = |table| dataset.manifest().rows(table, Some(split));
    let path = dataset.root().display();
    if rows(MotionRow::TABLE) == 0 {
        return Err(Error::Refused(format!(
            "no clip of {path} is in split {split}; choose another split, or name clips of it with `stance ingest \
             --splits FILE` into a new folder"
        )));
    }
    if rows(MaskRow::TABLE) == 0 && rows(PairRow::TABLE) == 0 {
        return Err(Error::Refused(format!(
            "{path} has neither masks nor pairs in split {split}; run `stance masks {path}` for semantic edits, \
             `stance pairs {path}` for styles"
        )));
    }
    let cache = FrameCache::from_environment(|name| std::env::var_os(name));
    let cache = cache.map_err(Error::Refused)?;
    let library = Library::read(dataset, split, &cache)?;
    Ok(Arc::new(library))
}

/// The composer's stream over the training split, with the given normaliser or else one fitted to the split.
///
/// # Errors
/// The split cannot be composed.
pub fn train_stream(
    dataset: &Dataset,
    config: &ComposeConfig,
    seed: Seed,
    normalizer: Option<Normalizer>,
) -> Result<(Stream, Normalizer), Error> {
    let library = library(dataset, Split::Train)?;
    let normalizer = match normalizer {
        Some(normalizer) => normalizer,
        None => library.fit_normalizer(config)?,
    };
    let stream = Stream::new(library, config.clone(), seed, &normalizer)?;
    Ok((stream, normalizer))
}
