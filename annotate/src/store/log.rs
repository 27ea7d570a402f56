//! Writing to the log.

use super::apply::apply;
use super::db::{Tx, params};
use super::entry::{Entry, Reply, VERSION, json};
use crate::Error;

/// Writes an entry, applies it, and returns its sequence number. `reply` computes the response from the
/// projections after the entry.
pub(crate) fn write(
    tx: &mut dyn Tx,
    entry: &Entry,
    reply: impl FnOnce(&mut dyn Tx, i64) -> Result<Option<Reply>, Error>,
) -> Result<i64, Error> {
    let seq = 1 + tx.number("SELECT COALESCE(MAX(seq), 0) FROM event", &[])?;
    apply(tx, seq, entry)?;
    let reply = reply(tx, seq)?;
    let (key, base_rev, result) = match reply {
        Some(reply) => (
            Some(reply.idem_key),
            Some(reply.base_rev),
            Some(reply.result),
        ),
        None => (None, None, None),
    };
    tx.execute(
        "INSERT INTO event (seq, at, actor, kind, task, idem_key, epoch, base_rev, body, result, version)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11)",
        params![
            seq,
            entry.at,
            entry.actor,
            entry.body.kind().as_str(),
            entry.task,
            key,
            entry.epoch,
            base_rev,
            json(&entry.body)?,
            result,
            VERSION
        ],
    )?;
    Ok(seq)
}

/// Writes an entry without a reply.
pub(crate) fn note(tx: &mut dyn Tx, entry: &Entry) -> Result<i64, Error> {
    write(tx, entry, |_, _| Ok(None))
}
