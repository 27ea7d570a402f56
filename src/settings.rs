//! Files of settings: TOML in, values out.

use std::path::Path;

use anyhow::Context;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

/// Reads a TOML file.
pub(crate) fn read<T: DeserializeOwned>(path: &Path) -> anyhow::Result<T> {
    let text =
        std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    toml::from_str(&text).with_context(|| format!("in {}", path.display()))
}

/// A preset with a section of a file in place of some of its settings.
pub(crate) fn over<T: Serialize + DeserializeOwned>(
    preset: &T,
    section: &str,
    own: &Map<String, Value>,
) -> anyhow::Result<T> {
    train::config::overlay(preset, &Value::Object(own.clone()))
        .with_context(|| format!("section [{section}]"))
}
