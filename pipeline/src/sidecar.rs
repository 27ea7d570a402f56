//! Descriptions that lie beside a motion file.

use datasets_spec::table::{Caption, PartCaption};
use serde::{Deserialize, Serialize};

/// The content of `<stem>.stance.json`, which may lie beside any motion file and adds what its format
/// cannot hold. All fields are optional; unknown fields are an error, so that misspelt ones are found.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Sidecar {
    /// What the clip shows.
    pub captions: Vec<Caption>,
    /// What single body parts do.
    pub parts: Vec<PartCaption>,
    /// Action label.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub action: Option<String>,
    /// Style label.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub style: Option<String>,
    /// Licence tag.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub license: Option<String>,
}

impl Sidecar {
    /// The ending that replaces the motion file's extension.
    pub const SUFFIX: &'static str = ".stance.json";
}
