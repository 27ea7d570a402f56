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

/// What some settings change of a preset: those that only repeat it are left out, so that equal settings are equal
/// however they were written.
pub(crate) fn changes(preset: &Value, own: Value) -> Value {
    let Value::Object(own) = own else {
        return own;
    };
    let kept = own.into_iter().filter_map(|(key, value)| {
        let Some(known) = preset.get(&key) else {
            return Some((key, value));
        };
        match changes(known, value) {
            value if is_equal(known, &value) => None,
            Value::Object(fields) if fields.is_empty() => None,
            value => Some((key, value)),
        }
    });
    Value::Object(kept.collect())
}

/// Whether two values are equal, numbers by their size: a file may say 1 for 1.0.
fn is_equal(one: &Value, other: &Value) -> bool {
    match (one.as_f64(), other.as_f64()) {
        (Some(one), Some(other)) => one == other,
        _ => one == other,
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn settings_that_repeat_the_preset_change_nothing() {
        let preset = json!({ "window": 16, "model": { "width": 128, "dropout": 0.0 }, "loss": "mse", "limit": null });
        let own = json!({ "window": 16.0, "model": { "dropout": 0, "width": 128 }, "loss": "mse", "limit": null });
        assert_eq!(changes(&preset, own), json!({}));
        let own = json!({ "window": 8, "model": { "width": 128, "dropout": 0.1 }, "limit": 2 });
        let expected = json!({ "window": 8, "model": { "dropout": 0.1 }, "limit": 2 });
        assert_eq!(changes(&preset, own), expected);
        // A preset leaves out what it does not use; saying so is kept.
        assert_eq!(
            changes(&preset, json!({ "overlap": 0 })),
            json!({ "overlap": 0 })
        );
        assert_eq!(changes(&preset, Value::Null), Value::Null);
    }
}
