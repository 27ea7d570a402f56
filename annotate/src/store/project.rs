//! Settings, preferences, motions, suggestions and jobs.

use std::collections::BTreeMap;

use super::db::{Row, Tx, params};
use super::entry::{Body, Entry, read_stored};
use super::records::{Millis, MotionRecord, NewSuggestion};
use super::settings::{check, is_name};
use super::{log, rows};
use crate::Error;
use crate::wire::{
    Action, Job, KEY_CODES, KEY_MODIFIERS, Prefs, Settings, Style, Suggestion, SuggestionSource,
    TaskState,
};

/// Key of the settings.
const SETTINGS: &str = "settings";
/// Maximum number of listed jobs.
const JOBS: i64 = 100;

fn json<T: serde::Serialize>(table: &'static str, value: &T) -> Result<String, Error> {
    serde_json::to_string(value).map_err(|error| Error::Row {
        table,
        problem: error.to_string(),
    })
}

pub(super) fn settings(tx: &mut dyn Tx) -> Result<Settings, Error> {
    match tx.one(
        "SELECT body FROM setting WHERE name = ?1",
        params![SETTINGS],
    )? {
        Some(row) => read_stored("setting", row.text(0)?),
        None => Ok(Settings::default()),
    }
}

/// Note that holds the last task whose number of people was brought up to date, while that goes on.
pub(super) const RETARGETING: &str = "note:retargeting";

pub(super) fn put_settings(
    tx: &mut dyn Tx,
    actor: Option<i64>,
    settings: Settings,
    now: Millis,
) -> Result<(), Error> {
    check(&settings)?;
    let before = self::settings(tx)?;
    let people = |settings: &Settings| (settings.answers_per_task, settings.overlap_percent);
    if people(&before) != people(&settings) {
        put(tx, RETARGETING, "0")?;
    }
    put(tx, SETTINGS, &json("setting", &settings)?)?;
    let entry = Entry {
        at: now,
        actor,
        task: None,
        epoch: None,
        body: Body::SettingsChanged {
            settings: Box::new(settings),
        },
    };
    log::note(tx, &entry)?;
    Ok(())
}

/// Adds styles that the project does not have, in their order. What cannot be a name is no style.
pub(super) fn add_styles<'a>(
    tx: &mut dyn Tx,
    actor: Option<i64>,
    names: impl IntoIterator<Item = &'a str>,
    now: Millis,
) -> Result<(), Error> {
    let mut settings = self::settings(tx)?;
    let known = settings.styles.len();
    for name in names {
        if is_name(name) && !settings.has_style(name) {
            settings.styles.push(Style::named(name));
        }
    }
    match settings.styles.len() == known {
        true => Ok(()),
        false => put_settings(tx, actor, settings, now),
    }
}

/// Stores a value under a name.
pub(super) fn put(tx: &mut dyn Tx, name: &str, body: &str) -> Result<(), Error> {
    tx.execute(
        "INSERT INTO setting (name, body) VALUES (?1, ?2) ON CONFLICT (name) DO UPDATE SET body = excluded.body",
        params![name, body],
    )?;
    Ok(())
}

pub(super) fn prefs(tx: &mut dyn Tx, user: i64) -> Result<Prefs, Error> {
    match tx.one("SELECT body FROM pref WHERE usr = ?1", params![user])? {
        Some(row) => {
            // Actions that are gone keep no keys.
            let mut stored: serde_json::Value = row.json(0)?;
            if let Some(keys) = stored["keys"].as_object_mut() {
                keys.retain(|action, _| Action::parse(action).is_some());
            }
            read_stored("pref", &stored.to_string())
        }
        None => Ok(Prefs::default()),
    }
}

pub(super) fn put_prefs(tx: &mut dyn Tx, user: i64, prefs: &Prefs) -> Result<(), Error> {
    check_prefs(prefs)?;
    tx.execute(
        "INSERT INTO pref (usr, body) VALUES (?1, ?2) ON CONFLICT (usr) DO UPDATE SET body = excluded.body",
        params![user, json("pref", prefs)?],
    )?;
    Ok(())
}

/// Checks preferences: keys must be `KeyboardEvent.code` values with modifiers.
fn check_prefs(prefs: &Prefs) -> Result<(), Error> {
    const MAX_KEYS: usize = 4;
    for (action, keys) in &prefs.keys {
        if keys.len() > MAX_KEYS {
            return Err(Error::invalid(
                "keys",
                format!("{action} has more than {MAX_KEYS} keys"),
            ));
        }
        for key in keys {
            let mut rest = key.as_str();
            for modifier in KEY_MODIFIERS {
                rest = rest.strip_prefix(modifier).unwrap_or(rest);
            }
            if !KEY_CODES.contains(&rest) {
                return Err(Error::invalid(
                    "keys",
                    format!(
                        "{key:?} is not a key; write Ctrl+ and Shift+ in this order before a KeyboardEvent.code"
                    ),
                ));
            }
        }
    }
    if let Some(speed) = prefs.speed
        && !(0.1..=2.0).contains(&speed)
    {
        return Err(Error::invalid("speed", "0.1 to 2 will do"));
    }
    Ok(())
}

pub(super) fn put_motions(tx: &mut dyn Tx, motions: &[MotionRecord]) -> Result<(), Error> {
    for motion in motions {
        put_motion(tx, motion, "NOTHING")?;
    }
    Ok(())
}

fn put_motion(tx: &mut dyn Tx, motion: &MotionRecord, on_conflict: &str) -> Result<(), Error> {
    let sql = format!(
        "INSERT INTO motion (hash, id, split, frames, fps, captions, style, action, current)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, 1)
         ON CONFLICT (hash) DO {on_conflict}"
    );
    tx.execute(
        &sql,
        params![
            &motion.hash,
            &motion.id,
            &motion.split,
            motion.frames,
            motion.fps,
            json("motion", &motion.captions)?,
            motion.style.clone(),
            motion.action.clone()
        ],
    )?;
    Ok(())
}

/// Gives clips new content. Tasks on the earlier content get the new one; those with an answer say so
/// ([`TaskRecord::changed`]). Returns the number of tasks.
///
/// [`TaskRecord::changed`]: super::records::TaskRecord::changed
pub(super) fn replace_motions(
    tx: &mut dyn Tx,
    actor: Option<i64>,
    motions: &[MotionRecord],
    now: Millis,
) -> Result<i64, Error> {
    let mut replaced: BTreeMap<String, String> = BTreeMap::new();
    for motion in motions {
        let before = tx.one(
            "SELECT hash FROM motion WHERE id = ?1 AND current = 1",
            params![&motion.id],
        )?;
        if let Some(row) = before
            && row.text(0)? != motion.hash
        {
            replaced.insert(row.string(0)?, motion.hash.clone());
        }
    }
    // Two clips may have changed places, so all earlier contents go before the first new one comes.
    for hash in replaced.keys() {
        tx.execute(
            "UPDATE motion SET current = 0 WHERE hash = ?1",
            params![hash],
        )?;
    }
    for motion in motions {
        let update =
            "UPDATE SET id = excluded.id, split = excluded.split, captions = excluded.captions,
           style = excluded.style, action = excluded.action, current = 1";
        put_motion(tx, motion, update)?;
    }
    let mut count = 0;
    for row in tx.query("SELECT id, source, target FROM task ORDER BY id", &[])? {
        let (source, target) = (row.string(1)?, row.opt_text(2)?);
        let now_of = |hash: &String| replaced.get(hash).unwrap_or(hash).clone();
        let new = (now_of(&source), target.as_ref().map(now_of));
        if new == (source, target) {
            continue;
        }
        let entry = Entry {
            at: now,
            actor,
            task: Some(row.int(0)?),
            epoch: None,
            body: Body::ClipChanged {
                source: new.0,
                target: new.1,
            },
        };
        log::note(tx, &entry)?;
        count += 1;
    }
    Ok(count)
}

/// Decides about a task whose clip was ingested anew: its answers hold, or it goes back to review.
pub(super) fn settle_changed(
    tx: &mut dyn Tx,
    actor: Option<i64>,
    task: i64,
    keep: bool,
    now: Millis,
) -> Result<(), Error> {
    let state = rows::task(tx, task)?.state;
    let body = match (keep, state) {
        (true, _) => Body::ClipKept,
        (false, TaskState::Accepted) => Body::Reopened {
            comment: "the clip was ingested anew, with other content, after this was accepted"
                .to_owned(),
            rule: None,
            request: String::new(),
        },
        // Somebody decides about it in any case, and is told.
        (false, _) => return Ok(()),
    };
    let entry = Entry {
        at: now,
        actor,
        task: Some(task),
        epoch: None,
        body,
    };
    log::note(tx, &entry).map(|_| ())
}

const MOTION_COLUMNS: &str = "hash, id, split, frames, fps, captions, style, action";

fn read_motion(row: &Row) -> Result<MotionRecord, Error> {
    Ok(MotionRecord {
        hash: row.string(0)?,
        id: row.string(1)?,
        split: row.string(2)?,
        frames: row.int(3)?,
        fps: row.real(4)?,
        captions: row.json(5)?,
        style: row.opt_text(6)?,
        action: row.opt_text(7)?,
    })
}

/// Motions in the order of the hashes, without unknown ones.
pub(super) fn motions(tx: &mut dyn Tx, hashes: &[String]) -> Result<Vec<MotionRecord>, Error> {
    let sql = format!("SELECT {MOTION_COLUMNS} FROM motion WHERE hash = ?1");
    let mut motions = Vec::new();
    for hash in hashes {
        if let Some(row) = tx.one(&sql, params![hash])? {
            motions.push(read_motion(&row)?);
        }
    }
    Ok(motions)
}

/// Frames of a motion; 1 for one that the store does not know, of which no range of frames can be chosen.
pub(super) fn frames(tx: &mut dyn Tx, hash: &str) -> Result<i64, Error> {
    let row = tx.one("SELECT frames FROM motion WHERE hash = ?1", params![hash])?;
    row.map_or(Ok(1), |row| row.int(0))
}

pub(super) fn all_motions(tx: &mut dyn Tx) -> Result<Vec<MotionRecord>, Error> {
    let sql = format!("SELECT {MOTION_COLUMNS} FROM motion WHERE current = 1 ORDER BY id");
    tx.query(&sql, &[])?.iter().map(read_motion).collect()
}

/// The next motions of the split in cyclic order of hashes. Partners are thus pseudo-random, and the same on
/// every call.
pub(super) fn partners(
    tx: &mut dyn Tx,
    hash: &str,
    limit: usize,
) -> Result<Vec<MotionRecord>, Error> {
    let Some(row) = tx.one("SELECT split FROM motion WHERE hash = ?1", params![hash])? else {
        return Err(Error::not_found("motion"));
    };
    let split = row.string(0)?;
    let mut found = Vec::new();
    for comparison in [">", "<"] {
        let sql = format!(
            "SELECT {MOTION_COLUMNS} FROM motion
             WHERE split = ?1 AND current = 1 AND hash {comparison} ?2 ORDER BY hash LIMIT ?3"
        );
        let wanted = limit - found.len();
        for row in tx.query(&sql, params![&split, hash, wanted as i64])? {
            found.push(read_motion(&row)?);
        }
    }
    Ok(found)
}

const SUGGESTION_COLUMNS: &str = "id, source, parts, text, model";

fn read_suggestion(row: &Row) -> Result<Suggestion, Error> {
    Ok(Suggestion {
        id: row.int(0)?,
        source: source(row.text(1)?)?,
        parts: row.json(2)?,
        text: row.string(3)?,
        model: row.string(4)?,
    })
}

fn source(text: &str) -> Result<SuggestionSource, Error> {
    SuggestionSource::parse(text).ok_or_else(|| Error::Row {
        table: "suggestion",
        problem: format!("source {text:?} is not known"),
    })
}

pub(super) fn put_suggestion(
    tx: &mut dyn Tx,
    task: i64,
    new: &NewSuggestion,
    now: Millis,
) -> Result<Suggestion, Error> {
    let id = 1 + tx.number("SELECT COALESCE(MAX(id), 0) FROM suggestion", &[])?;
    tx.execute(
        "INSERT INTO suggestion (id, task, source, parts, text, model, prompt_hash, params, tokens, response_hash, at)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11)",
        params![
            id,
            task,
            new.source.as_str(),
            json("suggestion", &new.parts)?,
            &new.text,
            &new.model,
            &new.prompt_hash,
            &new.params,
            new.tokens,
            &new.response_hash,
            now
        ],
    )?;
    Ok(Suggestion {
        id,
        source: new.source,
        parts: new.parts.clone(),
        text: new.text.clone(),
        model: new.model.clone(),
    })
}

pub(super) fn suggestions_of(tx: &mut dyn Tx, task: i64) -> Result<Vec<Suggestion>, Error> {
    let sql = format!("SELECT {SUGGESTION_COLUMNS} FROM suggestion WHERE task = ?1 ORDER BY id");
    tx.query(&sql, params![task])?
        .iter()
        .map(read_suggestion)
        .collect()
}

pub(super) fn suggestions(tx: &mut dyn Tx, ids: &[i64]) -> Result<Vec<Suggestion>, Error> {
    let sql = format!("SELECT {SUGGESTION_COLUMNS} FROM suggestion WHERE id = ?1");
    let mut found = Vec::new();
    for id in ids {
        if let Some(row) = tx.one(&sql, params![*id])? {
            found.push(read_suggestion(&row)?);
        }
    }
    Ok(found)
}

const NEW_SUGGESTION_COLUMNS: &str =
    "source, parts, text, model, prompt_hash, params, tokens, response_hash";

fn read_new_suggestion(row: &Row) -> Result<NewSuggestion, Error> {
    Ok(NewSuggestion {
        source: source(row.text(0)?)?,
        parts: row.json(1)?,
        text: row.string(2)?,
        model: row.string(3)?,
        prompt_hash: row.string(4)?,
        params: row.string(5)?,
        tokens: row.opt_int(6)?,
        response_hash: row.string(7)?,
    })
}

pub(super) fn cached_suggestion(
    tx: &mut dyn Tx,
    prompt_hash: &str,
) -> Result<Option<NewSuggestion>, Error> {
    let sql = format!(
        "SELECT {NEW_SUGGESTION_COLUMNS} FROM suggestion WHERE prompt_hash = ?1 ORDER BY id LIMIT 1"
    );
    let row = tx.one(&sql, params![prompt_hash])?;
    row.as_ref().map(read_new_suggestion).transpose()
}

/// Suggestions of a task, to be stored for another one.
pub(super) fn drafts_of(tx: &mut dyn Tx, task: i64) -> Result<Vec<NewSuggestion>, Error> {
    let sql =
        format!("SELECT {NEW_SUGGESTION_COLUMNS} FROM suggestion WHERE task = ?1 ORDER BY id");
    tx.query(&sql, params![task])?
        .iter()
        .map(read_new_suggestion)
        .collect()
}

pub(super) fn put_job(tx: &mut dyn Tx, mut job: Job, now: Millis) -> Result<Job, Error> {
    job.heartbeat = now;
    if job.id == 0 {
        job.id = 1 + tx.number("SELECT COALESCE(MAX(id), 0) FROM job", &[])?;
    }
    tx.execute(
        "INSERT INTO job (id, body) VALUES (?1, ?2) ON CONFLICT (id) DO UPDATE SET body = excluded.body",
        params![job.id, json("job", &job)?],
    )?;
    Ok(job)
}

/// Stores a part of a file of a job.
pub(super) fn put_file_part(
    tx: &mut dyn Tx,
    job: i64,
    name: &str,
    part: i64,
    bytes: Vec<u8>,
) -> Result<(), Error> {
    tx.execute(
        "INSERT INTO job_file (job, name, part, bytes) VALUES (?1, ?2, ?3, ?4)",
        params![job, name, part, bytes],
    )?;
    Ok(())
}

/// A part of a file of a job, counted from 0.
pub(super) fn file_part(
    tx: &mut dyn Tx,
    job: i64,
    name: &str,
    part: i64,
) -> Result<Option<Vec<u8>>, Error> {
    let row = tx.one(
        "SELECT bytes FROM job_file WHERE job = ?1 AND name = ?2 AND part = ?3",
        params![job, name, part],
    )?;
    row.map(|row| Ok(row.bytes(0)?.to_vec())).transpose()
}

/// Removes the files of all jobs but the last `kept` that have some.
pub(super) fn forget_files(tx: &mut dyn Tx, kept: i64) -> Result<(), Error> {
    tx.execute(
        "DELETE FROM job_file WHERE job NOT IN (
           SELECT k.job FROM (SELECT DISTINCT job FROM job_file ORDER BY job DESC LIMIT ?1) k)",
        params![kept],
    )?;
    Ok(())
}

/// Records that a job runs.
pub(super) fn beat(tx: &mut dyn Tx, id: i64, now: Millis) -> Result<(), Error> {
    let row = tx.one("SELECT body FROM job WHERE id = ?1", params![id])?;
    let job: Option<Job> = row.map(|row| row.json(0)).transpose()?;
    match job {
        Some(job) if job.state == "running" => put_job(tx, job, now).map(|_| ()),
        _ => Ok(()),
    }
}

pub(super) fn jobs(tx: &mut dyn Tx) -> Result<Vec<Job>, Error> {
    tx.query(
        "SELECT body FROM job ORDER BY id DESC LIMIT ?1",
        params![JOBS],
    )?
    .iter()
    .map(|row| read_stored("job", row.text(0)?))
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_keys_are_keys() {
        for good in [
            "KeyA",
            "Digit1",
            "Space",
            "F12",
            "F24",
            "Ctrl+Shift+KeyZ",
            "Numpad5",
            "Shift+Tab",
        ] {
            let prefs = Prefs {
                keys: [(crate::wire::Action::Undo, vec![good.to_owned()])].into(),
                ..Prefs::default()
            };
            assert!(check_prefs(&prefs).is_ok(), "{good}");
        }
        for bad in [
            "",
            "Keya",
            "KeyAB",
            "F25",
            "F01",
            "<b>",
            "javascript:x",
            "Shift+Ctrl+KeyZ",
            "Meta+KeyA",
            "Alt+KeyA",
            "NumpadEnter",
        ] {
            let prefs = Prefs {
                keys: [(crate::wire::Action::Undo, vec![bad.to_owned()])].into(),
                ..Prefs::default()
            };
            assert!(check_prefs(&prefs).is_err(), "{bad}");
        }
    }
}
