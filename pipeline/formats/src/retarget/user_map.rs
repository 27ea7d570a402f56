//! Joint maps as JSON: the built-in ones of known dialects, and those that users write for other skeletons.

use std::collections::BTreeMap;

use datasets_spec::Joint;
use serde::{Deserialize, Serialize};

use crate::source::Up;

/// A joint map, as JSON (the known dialects are such files in `maps/`):
///
/// ```json
/// {"name": "my rig", "joints": {"pelvis": "root", "left_hip": "thigh.L"},
///  "unit": 0.01, "up": "z", "rest": "first-frame"}
/// ```
///
/// `joints` gives the source name of each SMPL-X body joint. `unit` is the length of the file's unit in metres, `up`
/// the axis that is up in the file (x, y, z or one of them with a minus), `rest` the pose in which the source stands
/// upright: `zero-pose` or `first-frame`. All three are optional; by default they are estimated from the motion.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UserMap {
    name: String,
    joints: BTreeMap<Joint, String>,
    /// Length of the file's unit in metres.
    pub(super) unit: Option<f64>,
    /// The axis that is up.
    pub(super) up: Option<Up>,
    /// The source's rest pose.
    pub(super) rest: Option<RestPose>,
}

/// The pose in which a source stands upright.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum RestPose {
    /// All rotations zero, or the bind pose.
    ZeroPose,
    /// The first frame of the motion.
    FirstFrame,
}

/// Error of parsing a joint map.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum UserMapError {
    /// The text is not JSON, or has unknown fields.
    #[error("a joint map is JSON with name, joints and, if needed, unit, up and rest")]
    Syntax(#[from] serde_json::Error),
    /// The map names an unknown body joint, gives a source joint to two body joints, or its unit is not a positive
    /// number. The text says which.
    #[error("joint map {0}")]
    Content(String),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    name: String,
    joints: BTreeMap<String, String>,
    unit: Option<f64>,
    up: Option<Up>,
    rest: Option<RestPose>,
}

impl UserMap {
    /// BLAKE3 hash of the map, in hexadecimal.
    pub fn hash(&self) -> String {
        let Self {
            name,
            joints,
            unit,
            up,
            rest,
        } = self;
        let joints = joints.iter().map(|(joint, name)| (joint.name(), name));
        let joints: BTreeMap<&str, &String> = joints.collect();
        let text = serde_json::to_string(&(name, joints, unit, up, rest));
        let text = text.expect("names and numbers serialise");
        blake3::hash(text.as_bytes()).to_hex().to_string()
    }

    /// Parses the JSON text of a map.
    ///
    /// # Errors
    /// The text is not JSON of this form, a joint is unknown, a source joint is named twice, or the unit is not
    /// positive.
    pub fn parse(text: &str) -> Result<Self, UserMapError> {
        let file: File = serde_json::from_str(text)?;
        let mut joints: BTreeMap<Joint, String> = BTreeMap::new();
        let refused = UserMapError::Content;
        for (joint, source_name) in file.joints {
            let joint = joint.parse().map_err(|_| {
                let known = "which is no SMPL-X body joint such as left_knee";
                refused(format!("names {joint}, {known}"))
            })?;
            if joints.values().any(|taken| *taken == source_name) {
                return Err(refused(format!(
                    "gives {source_name} to two joints; name a source joint once"
                )));
            }
            joints.insert(joint, source_name);
        }
        if let Some(unit) = file.unit.filter(|unit| !(unit.is_finite() && *unit > 0.0)) {
            return Err(refused(format!(
                "has a unit of {unit} m; expected a positive number of metres"
            )));
        }
        Ok(Self {
            name: file.name,
            joints,
            unit: file.unit,
            up: file.up,
            rest: file.rest,
        })
    }

    /// Name of the map.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Source name of a body joint, if the map has it.
    pub(super) fn source_name(&self, joint: Joint) -> Option<&str> {
        self.joints.get(&joint).map(String::as_str)
    }

    /// Source names of the mapped body joints, in SMPL-X order.
    pub(super) fn source_names(&self) -> impl Iterator<Item = &str> {
        self.joints.values().map(String::as_str)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_is_read_with_all_its_fields() {
        let map = r#"{"name": "rig", "joints": {"pelvis": "root", "left_hip": "thigh.L"},
                      "unit": 0.01, "up": "-z", "rest": "first-frame"}"#;
        let map = UserMap::parse(map).expect("valid");
        assert_eq!(map.name(), "rig");
        assert_eq!(map.source_name(Joint::LeftHip), Some("thigh.L"));
        assert_eq!(map.source_name(Joint::RightHip), None);
        assert_eq!(map.unit, Some(0.01));
        assert_eq!(map.up, Some(Up::MinusZ));
        assert_eq!(map.rest, Some(RestPose::FirstFrame));
        let plain = UserMap::parse(r#"{"name": "", "joints": {}}"#).expect("valid");
        assert_eq!((plain.unit, plain.up, plain.rest), (None, None, None));
    }

    #[test]
    fn what_is_no_map_says_what_is_wrong() {
        let error = UserMap::parse("[]").expect_err("a list").to_string();
        assert!(error.contains("joint map is JSON"), "{error}");
        for (text, words) in [
            (r#"{}, "scale": 2"#, "joint map is JSON"),
            (r#"{}, "up": "w""#, "joint map is JSON"),
            (r#"{"tail": "t"}"#, "names tail"),
            (r#"{"head": "t", "neck": "t"}"#, "gives t to two joints"),
            (r#"{}, "unit": -1"#, "unit of -1 m"),
        ] {
            let map = format!(r#"{{"name": "a", "joints": {text}}}"#);
            let error = UserMap::parse(&map).expect_err(text);
            assert!(error.to_string().contains(words), "{text}: {error}");
        }
    }
}
