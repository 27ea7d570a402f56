//! How sources are ingested.

use std::path::PathBuf;

use datasets_spec::{Fps, Resample, Seed};

use super::split_list::SplitList;
use crate::annotation::pairs::PairList;
use crate::check::Teleports;
use crate::source::{Format, ReadOptions};

/// Fact of a manifest: what a reader should know about its splits.
pub const REMARKS_FACT: &str = "remarks";

/// Fact of a manifest: lines of the list of pairs that gave none, as JSON.
pub(super) const REFUSED_PAIRS_FACT: &str = "refused_pairs";

/// Fact of a manifest: labels that could not be used, as JSON.
pub(super) const LABEL_PROBLEMS_FACT: &str = "label_problems";

/// How files become rows.
#[derive(Clone, Debug)]
pub struct IngestOptions {
    /// Rate to store at; none keeps each clip's own.
    pub fps: Option<Fps>,
    /// How clips are brought to that rate.
    pub resample: Resample,
    /// Accept this format only; files of other formats are skipped.
    pub format: Option<Format>,
    /// Seed of the splits, where a dataset is made; one that is there keeps the seed it was made
    /// with.
    pub seed: Seed,
    /// A list of style pairs, by whose lines a styled clip gets the split of its original.
    pub pairs: Option<PairList>,
    /// Splits of the user's own, which take precedence over published and drawn ones.
    pub splits: Option<SplitList>,
    /// Licence tag for clips whose source declares none.
    pub license: Option<String>,
    /// Keep captions that are made by rule from file names.
    pub made_captions: bool,
    /// How files are read: the skeleton the motions are posed on, and joint maps of the user.
    pub read: ReadOptions,
    /// HumanML3D's `index.csv`, to cut its clips from the AMASS files among the sources.
    pub humanml3d_index: Option<PathBuf>,
    /// Compute the features of the HumanML3D recipe and store them beside the motions.
    pub humanml3d_features: bool,
    /// What becomes of motions with jumps.
    pub teleports: Teleports,
    /// Replace what the folder holds by another plan's motions, as a new version of the dataset.
    pub new_version: bool,
}

impl Default for IngestOptions {
    fn default() -> Self {
        Self {
            fps: Some(Fps::STORE),
            resample: Resample::Exact,
            format: None,
            seed: Seed(0),
            pairs: None,
            splits: None,
            license: None,
            made_captions: true,
            read: ReadOptions::default(),
            humanml3d_index: None,
            humanml3d_features: false,
            teleports: Teleports::default(),
            new_version: false,
        }
    }
}

/// Lowest and highest rates to store at, in 1/s.
const FPS_LIMITS: [f64; 2] = [1.0, 1000.0];

impl IngestOptions {
    /// Checks the rate to store at.
    ///
    /// # Errors
    /// It is implausibly low or high.
    pub fn check_fps(fps: Fps) -> Result<(), crate::Error> {
        let [lowest, highest] = FPS_LIMITS;
        match (lowest..=highest).contains(&fps.get()) {
            true => Ok(()),
            false => Err(crate::Error::StoredRate {
                got: fps.get(),
                lowest,
                highest,
            }),
        }
    }
}

pub(super) fn rate_name(options: &IngestOptions) -> String {
    options
        .fps
        .map_or("native".to_owned(), |fps| fps.get().to_string())
}
