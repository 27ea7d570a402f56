//! Report on a dataset that grew.

use std::collections::BTreeMap;

use datasets_spec::MotionId;
use serde::{Deserialize, Serialize};

/// Counts of the fates of the clips and labels that a dataset had.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Growth {
    /// Clips that the dataset did not have.
    pub new: u64,
    /// Clips that stay unchanged without their files being read.
    pub kept: u64,
    /// Clips that were read again although their motions did not change: labels, settings or other clips of the file
    /// did.
    pub read_again: Vec<String>,
    /// Clips whose motions changed.
    pub changed: Vec<String>,
    /// Clips whose files lie elsewhere now.
    pub moved: Vec<String>,
    /// Clips whose files are missing; the clips stay in the dataset.
    pub missing: Vec<String>,
    /// Clips whose files exist and no longer give them (damaged, without the key, or not asked for). They stay unchanged.
    pub kept_unusable: Vec<String>,
    /// Clips whose files could not be read this time. They stay unchanged, also in a run that prunes.
    pub kept_unread: Vec<String>,
    /// Clips that were removed, because pruning was requested.
    pub pruned: Vec<String>,
    /// Masks and pairs that stay.
    pub labels: BTreeMap<String, u64>,
    /// Labels that are lost, with the reason: masks and pairs, and columns of clips that their files no longer give. The
    /// previous version keeps them.
    pub lost: Vec<LostLabel>,
    /// Number of masks of sources that are left out, because people have replaced or removed them since.
    pub gave_way: u64,
    /// Number of labels of people, by table, that their source gives otherwise now. The dataset keeps its own.
    #[serde(default)]
    pub differ: BTreeMap<String, u64>,
    /// Number of automatic masks and pairs of clips that changed or were removed, by table. Their stages make those of changed
    /// clips again.
    pub removed: BTreeMap<String, u64>,
    /// Tables that were composed of changed or removed clips; their commands make them again.
    pub dropped_tables: Vec<String>,
}

impl LostLabel {
    pub(crate) fn new(table: &str, id: &str, clip: &MotionId, reason: String) -> Self {
        Self {
            table: table.to_owned(),
            id: id.to_owned(),
            clip: clip.to_string(),
            reason,
        }
    }
}

/// A mask or pair whose clip changed or was removed, or a column of a clip that is empty now.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LostLabel {
    /// The table, masks or pairs, or the column of the clip.
    pub table: String,
    /// Id of the row, or of the clip.
    pub id: String,
    /// Id of the clip.
    pub clip: String,
    /// What happened to the clip.
    pub reason: String,
}
