//! Settings, preferences, motions and suggestions.

use datasets_spec::Fps;

use super::db::{Params, Result, Tx, json, params, unreadable};
use super::entry::{Body, read_stored};
use super::log;
use super::records::{Millis, MotionRecord, NewSuggestion};
use super::settings::{check, is_name};
use super::store::Store;
use crate::error::{Error, require};
use crate::wire::{
    Action, Code, KEY_CODES, KEY_MODIFIERS, Prefs, Problem, Settings, SettingsChange, Style,
    Suggestion,
};

/// Characters that the write test writes: more than any answer has, so that a nearly full disk fails the test.
const TRIED: usize = 64 * 1024;
/// Name under which table `setting` holds the settings.
const SETTINGS: &str = "settings";
/// Motions or tasks written per transaction; bounds how long others wait.
pub(super) const AT_ONCE: usize = 500;

impl Store {
    /// Checks that the store accepts writes, by writing.
    ///
    /// # Errors
    /// The store does not accept writes.
    pub fn check(&self) -> Result<()> {
        self.write(|tx| put(tx, "ready", &"-".repeat(TRIED)))
    }

    /// The settings.
    pub fn settings(&self) -> Result<Settings> {
        self.read(settings)
    }

    /// A user's preferences.
    pub fn prefs(&self, user: i64) -> Result<Prefs> {
        let sql = "SELECT body FROM pref WHERE usr = ?1";
        let stored: Option<serde_json::Value> = self.read(|tx| tx.find(sql, params![user]))?;
        let Some(mut stored) = stored else {
            return Ok(Prefs::default());
        };
        // Drop the keys of actions that no longer exist.
        if let Some(keys) = stored["keys"].as_object_mut() {
            keys.retain(|action, _| Action::parse(action).is_some());
        }
        read_stored("pref", &stored.to_string())
    }

    /// Changes a user's preferences. Refused with `invalid`.
    pub fn put_prefs(&self, user: i64, prefs: Prefs) -> Result<()> {
        check_prefs(&prefs)?;
        let body = json(&prefs)?;
        self.write(move |tx| {
            tx.run(
                "INSERT INTO pref (usr, body) VALUES (?1, ?2) ON CONFLICT (usr) DO UPDATE SET body = excluded.body",
                params![user, &body],
            )
        })
    }

    /// The note with this name: a stored text, such as the dataset version imported last.
    pub fn note(&self, name: &str) -> Result<Option<String>> {
        self.read(|tx| get(tx, &format!("note:{name}")))
    }

    /// Stores a note.
    pub fn put_note(&self, name: &str, text: &str) -> Result<()> {
        let (name, text) = (format!("note:{name}"), text.to_owned());
        self.write(move |tx| put(tx, &name, &text))
    }

    /// Adds motions. A motion whose hash is known gets the id, split, captions, style and action that it has now.
    pub fn put_motions(&self, motions: Vec<MotionRecord>) -> Result<()> {
        for group in motions.chunks(AT_ONCE) {
            let group = group.to_vec();
            self.write(move |tx| {
                let mut motions = group.iter();
                motions.try_for_each(|motion| put_motion(tx, motion))
            })?;
        }
        Ok(())
    }

    /// Motions by their hashes, in this order and without unknown ones.
    pub fn motions(&self, hashes: Vec<String>) -> Result<Vec<MotionRecord>> {
        self.read(|tx| motions(tx, &hashes))
    }

    /// All motions, also those that are no longer in the dataset.
    pub fn all_motions(&self) -> Result<Vec<MotionRecord>> {
        self.read(|tx| motions_where(tx, "current <> 0 ORDER BY id", &[]))
    }

    /// Up to `limit` other motions of the same split, for previews: the next ones in the cyclic order of hashes, which
    /// is pseudo-random but the same on every call. Refused with `not_found`.
    pub fn partners(&self, hash: &str, limit: usize) -> Result<Vec<MotionRecord>> {
        self.read(|tx| {
            let Some(motion) = motions_where(tx, "hash = ?1", params![hash])?.pop() else {
                return Err(Error::not_found("motion"));
            };
            let mut found = Vec::new();
            for comparison in [">", "<"] {
                let condition = format!(
                    "split = ?1 AND current = 1 AND hash {comparison} ?2 ORDER BY hash LIMIT ?3"
                );
                let wanted = (limit - found.len()) as i64;
                let values = params![&motion.split, hash, wanted];
                found.extend(motions_where(tx, &condition, values)?);
            }
            Ok(found)
        })
    }

    /// Suggestions of a task.
    pub fn suggestions_of(&self, task: i64) -> Result<Vec<Suggestion>> {
        self.read(|tx| suggestions_of(tx, task))
    }

    /// Suggestions by their ids.
    pub fn suggestions(&self, ids: Vec<i64>) -> Result<Vec<Suggestion>> {
        self.read(|tx| {
            let mut found = Vec::new();
            for id in ids {
                found.extend(suggestions_where(tx, "id = ?1", params![id])?);
            }
            Ok(found)
        })
    }

    /// Stores a suggestion.
    pub fn put_suggestion(
        &self,
        task: i64,
        suggestion: NewSuggestion,
        now: Millis,
    ) -> Result<Suggestion> {
        self.write(move |tx| put_suggestion(tx, task, &suggestion, now))
    }

    /// Stored suggestion for the same prompt.
    pub fn cached_suggestion(&self, prompt_hash: &str) -> Result<Option<NewSuggestion>> {
        let condition = "prompt_hash = ?1 ORDER BY id LIMIT 1";
        let mut found = self.read(|tx| drafts_where(tx, condition, params![prompt_hash]))?;
        Ok(found.pop())
    }
}

pub(super) fn settings(tx: &mut dyn Tx) -> Result<Settings> {
    match get(tx, SETTINGS)? {
        Some(body) => read_stored("setting", &body),
        None => Ok(Settings::default()),
    }
}

/// The stored settings after the change of a client. Refused with `setting_changed`.
pub(super) fn changed_settings(tx: &mut dyn Tx, change: &SettingsChange) -> Result<Settings> {
    let fields = |settings: &Settings| {
        serde_json::to_value(settings).map_err(|error| unreadable("setting", error))
    };
    let mut stored = fields(&self::settings(tx)?)?;
    let (was, wanted) = (fields(&change.was)?, fields(&change.now)?);
    for (field, value) in wanted.as_object().into_iter().flatten() {
        if was[field] == *value || stored[field] == *value {
            continue;
        }
        if stored[field] != was[field] {
            return Err(setting_changed(field));
        }
        stored[field] = value.clone();
    }
    serde_json::from_value(stored).map_err(|error| unreadable("setting", error))
}

/// An error for a setting that is no longer as the client read it.
pub(super) fn setting_changed(field: &str) -> Error {
    let problem = format!(
        "somebody changed {field} after you read it; note your own change, load the page again and repeat it"
    );
    let mut problem = Problem::new(Code::SettingChanged, problem);
    problem.field = Some(field.to_owned());
    Error::Refused(Box::new(problem))
}

/// The value stored under a name.
pub(super) fn get(tx: &mut dyn Tx, name: &str) -> Result<Option<String>> {
    let sql = "SELECT body FROM setting WHERE name = ?1";
    tx.find(sql, params![name])
}

/// The note that holds, while `import::retarget` is in progress, the id of the last task it checked.
pub(super) const RETARGETING: &str = "note:retargeting";

pub(super) fn put_settings(
    tx: &mut dyn Tx,
    actor: Option<i64>,
    settings: Settings,
    now: Millis,
) -> Result<()> {
    check(&settings)?;
    let before = self::settings(tx)?;
    let people = |settings: &Settings| (settings.answers_per_task, settings.overlap_percent);
    if people(&before) != people(&settings) {
        put(tx, RETARGETING, "0")?;
    }
    put(tx, SETTINGS, &json(&settings)?)?;
    let body = Body::SettingsChanged {
        settings: Box::new(settings),
    };
    log::note(tx, now, actor, None, body)
}

/// Adds styles that the project does not have, in their order. Skips texts that cannot be names.
pub(super) fn add_styles<'a>(
    tx: &mut dyn Tx,
    actor: Option<i64>,
    names: impl IntoIterator<Item = &'a str>,
    now: Millis,
) -> Result<()> {
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
pub(super) fn put(tx: &mut dyn Tx, name: &str, body: &str) -> Result<()> {
    let sql = "INSERT INTO setting (name, body) VALUES (?1, ?2) ON CONFLICT (name) DO UPDATE SET body = excluded.body";
    tx.run(sql, params![name, body])
}

/// Refuses preferences with too many keys for an action, an unknown key, or a speed out of range.
fn check_prefs(prefs: &Prefs) -> Result<()> {
    const MAX_KEYS: usize = 4;
    for (action, keys) in &prefs.keys {
        let problem = format!("{action} has more than {MAX_KEYS} keys");
        require(keys.len() <= MAX_KEYS, "keys", problem)?;
        for key in keys {
            let mut rest = key.as_str();
            for modifier in KEY_MODIFIERS {
                rest = rest.strip_prefix(modifier).unwrap_or(rest);
            }
            let problem = format!(
                "{key:?} is not a key; write Ctrl+ and Shift+ in this order before a KeyboardEvent.code"
            );
            require(KEY_CODES.contains(&rest), "keys", problem)?;
        }
    }
    let allowed = 0.1..=2.0;
    let is_allowed = prefs.speed.is_none_or(|speed| allowed.contains(&speed));
    require(is_allowed, "speed", "0.1 to 2 will do")
}

pub(super) fn put_motion(tx: &mut dyn Tx, motion: &MotionRecord) -> Result<()> {
    tx.run(
        "INSERT INTO motion (hash, id, split, frames, fps, captions, style, action, current)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, 1)
         ON CONFLICT (hash) DO UPDATE SET id = excluded.id, split = excluded.split, captions = excluded.captions,
           style = excluded.style, action = excluded.action, current = 1",
        params![
            motion.hash,
            motion.id,
            motion.split,
            motion.frames,
            motion.fps,
            json(&motion.captions)?,
            motion.style,
            motion.action
        ],
    )
}

/// Motions by hash, in the order of the hashes. Unknown hashes are skipped.
pub(super) fn motions<'a>(
    tx: &mut dyn Tx,
    hashes: impl IntoIterator<Item = &'a String>,
) -> Result<Vec<MotionRecord>> {
    let mut motions = Vec::new();
    for hash in hashes {
        motions.extend(motions_where(tx, "hash = ?1", params![hash])?);
    }
    Ok(motions)
}

/// Motions that match an SQL condition.
fn motions_where(tx: &mut dyn Tx, condition: &str, params: Params) -> Result<Vec<MotionRecord>> {
    let columns = "hash, id, split, frames, fps, captions, style, action";
    let sql = format!("SELECT {columns} FROM motion WHERE {condition}");
    tx.list(&sql, params)
}

/// Number of frames of a motion; 1 for an unknown motion, so that no range can be chosen.
pub(super) fn frames(tx: &mut dyn Tx, hash: &str) -> Result<i64> {
    Ok(length(tx, hash)?.0)
}

/// [`frames`] of a motion, and their rate.
pub(super) fn length(tx: &mut dyn Tx, hash: &str) -> Result<(i64, f64)> {
    let sql = "SELECT frames, fps FROM motion WHERE hash = ?1";
    let length = tx.find(sql, params![hash])?;
    Ok(length.unwrap_or((1, Fps::STORE.get())))
}

/// Suggestions that match an SQL condition.
fn suggestions_where(tx: &mut dyn Tx, condition: &str, params: Params) -> Result<Vec<Suggestion>> {
    let sql = format!("SELECT id, source, parts, text, model FROM suggestion WHERE {condition}");
    tx.list(&sql, params)
}

pub(super) fn suggestions_of(tx: &mut dyn Tx, task: i64) -> Result<Vec<Suggestion>> {
    suggestions_where(tx, "task = ?1 ORDER BY id", params![task])
}

pub(super) fn put_suggestion(
    tx: &mut dyn Tx,
    task: i64,
    new: &NewSuggestion,
    now: Millis,
) -> Result<Suggestion> {
    let id = tx.next_id("suggestion")?;
    tx.run(
        "INSERT INTO suggestion (id, task, source, parts, text, model, prompt_hash, params, tokens, response_hash, at)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11)",
        params![
            id,
            task,
            new.source,
            json(&new.parts)?,
            new.text,
            new.model,
            new.prompt_hash,
            new.params,
            new.tokens,
            new.response_hash,
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

/// Suggestions that match an SQL condition, to be stored for another task.
pub(super) fn drafts_where(
    tx: &mut dyn Tx,
    condition: &str,
    params: Params,
) -> Result<Vec<NewSuggestion>> {
    let columns = "source, parts, text, model, prompt_hash, params, tokens, response_hash";
    let sql = format!("SELECT {columns} FROM suggestion WHERE {condition}");
    tx.list(&sql, params)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_keys_are_keys() {
        let good = "KeyA Digit1 Space F12 F24 Ctrl+Shift+KeyZ Numpad5 Shift+Tab";
        let bad =
            ",Keya,KeyAB,F25,F01,<b>,javascript:x,Shift+Ctrl+KeyZ,Meta+KeyA,Alt+KeyA,NumpadEnter";
        let good = good.split(' ').map(|key| (key, true));
        for (key, is_key) in good.chain(bad.split(',').map(|key| (key, false))) {
            let prefs = Prefs {
                keys: [(crate::wire::Action::Undo, vec![key.to_owned()])].into(),
                ..Prefs::default()
            };
            assert_eq!(check_prefs(&prefs).is_ok(), is_key, "{key}");
        }
    }
}
