//! Idempotency: a repeated request gets the reply stored in the log.

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::db::{Tx, params};
use super::entry;
use crate::Error;
use crate::wire::Code;

/// Hash of a request; tells a repetition from another request with the same key.
pub(super) fn hash_of<T: Serialize>(value: &T) -> Result<String, Error> {
    let text = serde_json::to_string(value).map_err(|error| Error::Row {
        table: "event",
        problem: error.to_string(),
    })?;
    Ok(blake3::hash(text.as_bytes()).to_hex()[..32].to_owned())
}

/// A key as the log stores it, with the user id, so that keys of different people never collide.
pub(super) fn full_key(user: i64, key: &str) -> Result<String, Error> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || c == '-';
    if (8..=64).contains(&key.len()) && key.chars().all(allowed) {
        Ok(format!("{user}:{key}"))
    } else {
        Err(Error::invalid(
            "idem_key",
            "a key must have 8 to 64 letters, digits and dashes",
        ))
    }
}

/// The reply that was given to this key before.
pub(super) fn replay(tx: &mut dyn Tx, key: &str, request: &str) -> Result<Option<String>, Error> {
    let sql = format!(
        "SELECT {}, result FROM event WHERE idem_key = ?1",
        entry::ENTRY_COLUMNS
    );
    let Some(row) = tx.one(&sql, params![key])? else {
        return Ok(None);
    };
    let (_, entry) = entry::read_entry(&row)?;
    if entry.body.request() != Some(request) {
        return Err(Error::refused(
            Code::KeyReused,
            "this key was used for another request; use a new one",
        ));
    }
    row.opt_text(7)
}

/// A reply read back from the log.
pub(super) fn parsed<T: DeserializeOwned>(text: &str) -> Result<T, Error> {
    serde_json::from_str(text).map_err(|error| Error::Row {
        table: "event",
        problem: error.to_string(),
    })
}
