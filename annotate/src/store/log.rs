//! Writes log entries, and answers repeated requests with the logged reply.

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::apply::apply;
use super::db::{Result, Tx, json, params, unreadable};
use super::entry::{Body, Entry, VERSION};
use super::records::Millis;
use super::settings::is_word;
use crate::error::{Error, require};
use crate::wire::Code;

/// [`write`] for an entry that belongs to no lease.
pub(crate) fn note(
    tx: &mut dyn Tx,
    at: Millis,
    actor: Option<i64>,
    task: Option<i64>,
    body: Body,
) -> Result<()> {
    write(tx, &Entry::new(at, actor, task, None, body))
}

/// Appends an entry to the log and applies it.
pub(crate) fn write(tx: &mut dyn Tx, entry: &Entry) -> Result<()> {
    let seq = apply_next(tx, entry)?;
    put(tx, seq, entry, None, None)
}

fn apply_next(tx: &mut dyn Tx, entry: &Entry) -> Result<i64> {
    let seq = 1 + tx.number("SELECT COALESCE(MAX(seq), 0) FROM event", &[])?;
    apply(tx, seq, entry)?;
    Ok(seq)
}

/// Stores an entry. The entry of a request is stored with its key, its base revision and its reply.
fn put(
    tx: &mut dyn Tx,
    seq: i64,
    entry: &Entry,
    request: Option<(&str, i64)>,
    reply: Option<String>,
) -> Result<()> {
    let (key, base_rev) = request.unzip();
    tx.run(
        "INSERT INTO event (seq, at, actor, kind, task, idem_key, epoch, base_rev, body, result, version)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11)",
        params![
            seq,
            entry.at,
            entry.actor,
            entry.body.kind(),
            entry.task,
            key,
            entry.epoch,
            base_rev,
            json(&entry.body)?,
            reply,
            VERSION
        ],
    )
}

/// A request with a key, by which a repetition of the request is recognised.
pub(super) struct Request {
    /// The client's key prefixed with the user id, so that keys of different people never collide.
    key: String,
    /// Distinguishes a repeated request from another request with the same key.
    pub(super) hash: String,
}

impl Request {
    pub(super) fn new<T: Serialize>(user: i64, key: &str, content: &T) -> Result<Self> {
        let problem = "a key must have 8 to 64 letters, digits and dashes";
        require(is_word(key, 8..=64), "idem_key", problem)?;
        Ok(Self {
            key: format!("{user}:{key}"),
            hash: blake3::hash(json(content)?.as_bytes()).to_hex()[..32].to_owned(),
        })
    }

    /// The stored reply to this request, if it is repeated.
    pub(super) fn replay<T: DeserializeOwned>(&self, tx: &mut dyn Tx) -> Result<Option<T>> {
        let sql = "SELECT result, body FROM event WHERE idem_key = ?1";
        let found: Option<(Option<String>, serde_json::Value)> = tx.find(sql, params![self.key])?;
        let Some((result, body)) = found else {
            return Ok(None);
        };
        if body["request"] != self.hash.as_str() {
            let problem = "this key was used for another request; use a new one";
            return Err(Error::refused(Code::KeyReused, problem));
        }
        let result = result.map(|result| serde_json::from_str(&result));
        let result = result.transpose();
        result.map_err(|error| unreadable("event", error))
    }

    /// Writes the entry of the request and returns the reply, which is computed from the projections after the entry
    /// and stored for repetitions.
    pub(super) fn log<T: Serialize>(
        &self,
        tx: &mut dyn Tx,
        entry: &Entry,
        base_rev: i64,
        reply: impl FnOnce(&mut dyn Tx, i64) -> Result<T>,
    ) -> Result<T> {
        let seq = apply_next(tx, entry)?;
        let reply = reply(tx, seq)?;
        let request = (self.key.as_str(), base_rev);
        put(tx, seq, entry, Some(request), Some(json(&reply)?))?;
        Ok(reply)
    }
}
