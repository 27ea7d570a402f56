//! Label files beside a motion file.

use datasets_spec::Split;
use datasets_spec::record::{CAPTION_BY_RULE, CAPTION_BY_SOURCE};
use datasets_spec::table::{Caption, PartCaption};
use serde::de::value::MapAccessDeserializer;
use serde::{Deserialize, Deserializer, Serialize};

use crate::source::Up;

/// The content of `<stem>.stance.json`, which may lie beside any motion file and adds labels that its format cannot
/// hold. All fields are optional; unknown fields are an error, so that misspelt ones are found.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Sidecar {
    /// Id of the clip, in place of one that is made from its path. Only the file beside a lone motion states it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub id: Option<String>,
    /// Id of the clip that it mirrors. Only the file beside a lone motion states it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mirrored_of: Option<String>,
    /// Where its rotations come from, as in column `rotation_source`. Only the file beside a lone motion states it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotation_source: Option<String>,
    /// How well its rotations fit what was captured, as in column `fit_error_m`. Only the file beside a lone motion states
    /// it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fit_error_m: Option<f32>,
    /// Up axis of the motion file, as `--up` names it. Only the file beside a motion states it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub up: Option<Up>,
    /// Captions of the clip.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub captions: Vec<LabelCaption>,
    /// Captions of single body parts.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub parts: Vec<PartCaption>,
    /// Name of the performer.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub subject: Option<String>,
    /// Action label.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub action: Option<String>,
    /// Style label.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub style: Option<String>,
    /// Split, in place of a published or drawn one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub split: Option<Split>,
    /// Licence tag.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub license: Option<String>,
}

/// The content of a label file.
#[derive(Default)]
pub(crate) struct Content {
    /// Labels of all clips of the folder.
    pub(crate) all: Sidecar,
    /// Labels of single clips: line number if known, name or pattern, and the labels.
    pub(crate) clips: Vec<(Option<u64>, String, Sidecar)>,
    /// Parts of the file that cannot be used.
    pub(crate) problems: Vec<String>,
}

impl Sidecar {
    /// The ending that replaces the motion file's extension.
    pub const SUFFIX: &'static str = ".stance.json";
}

/// A caption of a label file: a plain text, or an object with the field `text` and any of the others.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LabelCaption {
    /// The caption; its times are 0 if it describes the whole clip.
    #[serde(flatten)]
    pub caption: Caption,
    /// Author of the caption: `source`, or `rule` if it was made from a file name.
    #[serde(skip_serializing_if = "is_by_source")]
    pub origin: String,
}

fn is_by_source(origin: &str) -> bool {
    origin == CAPTION_BY_SOURCE
}

impl LabelCaption {
    /// Whether a rule made the caption.
    pub fn is_made(&self) -> bool {
        self.origin == CAPTION_BY_RULE
    }
}

impl From<Caption> for LabelCaption {
    fn from(caption: Caption) -> Self {
        Self {
            caption,
            origin: CAPTION_BY_SOURCE.to_owned(),
        }
    }
}

impl From<String> for LabelCaption {
    fn from(text: String) -> Self {
        Self::from(caption(text))
    }
}

/// A caption of the whole clip.
pub(crate) fn caption(text: impl Into<String>) -> Caption {
    Caption {
        text: text.into(),
        ..Caption::default()
    }
}

/// The fields of a caption in a label file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Fields {
    text: String,
    #[serde(default)]
    tokens: String,
    #[serde(default)]
    from_s: f32,
    #[serde(default)]
    to_s: f32,
    origin: Option<String>,
}

impl<'de> Deserialize<'de> for LabelCaption {
    /// Accepts a text or a table. An untagged enum would not say which field is wrong.
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visitor;

        impl<'de> serde::de::Visitor<'de> for Visitor {
            type Value = LabelCaption;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("a text, or a table with the field text")
            }

            fn visit_str<E: serde::de::Error>(self, text: &str) -> Result<Self::Value, E> {
                Ok(text.to_owned().into())
            }

            fn visit_map<A: serde::de::MapAccess<'de>>(
                self,
                map: A,
            ) -> Result<Self::Value, A::Error> {
                let fields = Fields::deserialize(MapAccessDeserializer::new(map))?;
                let said = LabelCaption::from(Caption {
                    text: fields.text,
                    tokens: fields.tokens,
                    from_s: fields.from_s,
                    to_s: fields.to_s,
                });
                Ok(LabelCaption {
                    origin: fields.origin.unwrap_or(said.origin),
                    ..said
                })
            }
        }

        deserializer.deserialize_any(Visitor)
    }
}
