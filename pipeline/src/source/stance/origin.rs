//! The file `origin.json` of an export: metadata that the release's layout cannot hold.

use std::collections::BTreeMap;

use datasets_spec::Split;
use datasets_spec::table::Caption;
use serde::{Deserialize, Serialize};

/// Name of the file at the root of an export.
pub(crate) const FILE_NAME: &str = "origin.json";

/// The origins of an export, by the file's path without extension (`base_motion/029232`), with
/// `#src` and `#tgt` for the motions of an adjustment.
pub(crate) type Origins = BTreeMap<String, Origin>;

/// Where an exported motion comes from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Origin {
    /// Id in the dataset.
    pub(crate) id: String,
    /// Split in the dataset.
    pub(crate) split: Split,
    /// Id of the motion it mirrors.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) mirrored_of: Option<String>,
    /// What it shows.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(crate) captions: Vec<Caption>,
    /// Who wrote each of the captions.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(crate) caption_origins: Vec<String>,
    /// Who performs it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) subject: Option<String>,
    /// Action label.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) action: Option<String>,
    /// Style label.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) style: Option<String>,
    /// Licence tag.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) license: Option<String>,
}
