//! Facts of a manifest that are kept as JSON.

use serde::Serialize;

/// A value as a fact.
pub(crate) fn json(value: &impl Serialize) -> String {
    serde_json::to_string(value).expect("texts and counts serialise")
}
