//! Facts of a manifest that are kept as JSON.

use std::collections::BTreeMap;

use serde::Serialize;
use serde::de::DeserializeOwned;

/// Reads a fact; the default if it is missing or cannot be understood.
pub(crate) fn fact<T: DeserializeOwned + Default>(
    facts: &BTreeMap<String, String>,
    name: &str,
) -> T {
    let text = facts.get(name);
    text.and_then(|text| serde_json::from_str(text).ok())
        .unwrap_or_default()
}

/// A value as a fact.
pub(crate) fn json(value: &impl Serialize) -> String {
    serde_json::to_string(value).expect("texts and counts serialise")
}
