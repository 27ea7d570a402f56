//! People: logging in, preferences, settings, users and tokens.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::names::{Action, Role};

/// `POST session`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct Login {
    /// The token as it was printed.
    pub token: String,
}

/// A user.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct User {
    /// Id.
    pub id: i64,
    /// Name, unique.
    pub name: String,
    /// What they may do.
    pub role: Role,
    /// Whether the user may log in.
    pub active: bool,
}

/// `GET me`, and the answer to `POST session`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct Me {
    /// Who is logged in.
    pub user: User,
    /// Bounds of what can be sent.
    pub limits: Limits,
    /// What the project asks for.
    pub project: Project,
    /// Keys and display, as they were saved.
    pub prefs: Prefs,
    /// Name of the language model, if there is one.
    pub model: Option<String>,
    /// Why nothing can be saved at present, if so.
    pub read_only: Option<String>,
    /// Version of the server.
    pub version: String,
    /// Id of the store. What a browser keeps belongs to it: another project may be served at the same address.
    pub store: String,
}

/// Bounds of what can be sent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct Limits {
    /// Characters of a text.
    pub text_chars: usize,
    /// Events of a batch.
    pub events: usize,
    /// Bytes of a body.
    pub body_bytes: usize,
    /// Suggestions asked for in a minute.
    pub suggestions_per_minute: u32,
    /// Seconds a lease lasts.
    pub lease_secs: i64,
    /// Seconds between renewals.
    pub heartbeat_secs: i64,
}

/// The part of the settings that annotators see.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct Project {
    /// Name of the project.
    pub name: String,
    /// Fewest masks of an answer without a reason.
    pub min_masks: usize,
    /// Most masks of an answer without a reason.
    pub max_masks: usize,
    /// Styles to choose from.
    pub styles: Vec<String>,
    /// Phrases to complete the instruction of a fine-grained pair with.
    pub templates: Vec<String>,
    /// Phrases to complete the instruction of a style pair with; `{style}` is the chosen style.
    pub style_templates: Vec<String>,
}

/// `GET`/`PUT settings`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Name of the project.
    pub name: String,
    /// People a task wants, for the share `overlap_percent` of tasks imported from now on.
    pub answers_per_task: u32,
    /// Share of tasks that want more than one person.
    pub overlap_percent: u32,
    /// Share of tasks given out that are hidden gold tasks.
    pub gold_percent: u32,
    /// Share of tasks shown without any draft.
    pub blind_percent: u32,
    /// Share of the review queue `sample` among submitted tasks.
    pub review_percent: u32,
    /// Minutes a lease lasts.
    pub lease_minutes: u32,
    /// Days a returned task waits for its author.
    pub returned_days: u32,
    /// Fewest masks of an answer without a reason.
    pub min_masks: usize,
    /// Most masks of an answer without a reason.
    pub max_masks: usize,
    /// Styles to choose from.
    pub styles: Vec<String>,
    /// Phrases to complete the instruction of a fine-grained pair with.
    pub templates: Vec<String>,
    /// Phrases to complete the instruction of a style pair with; `{style}` is the chosen style.
    pub style_templates: Vec<String>,
    /// Pairs wanted of each category and edit type; 0 for no bound.
    pub quota: u32,
    /// The guide, plain text.
    pub guide: String,
    /// Name of the time zone in which days begin, such as `Europe/Berlin`.
    pub time_zone: String,
}

/// `GET`/`PUT prefs`. Keys are `KeyboardEvent.code` values, with `Ctrl+`, `Shift+` or both before; [`super::KEY_CODES`] lists them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields, default)]
pub struct Prefs {
    /// Keys that differ from the defaults.
    pub keys: BTreeMap<Action, Vec<String>>,
    /// Playback speed, 0.1 to 2.
    pub speed: Option<f64>,
    /// Whether the camera follows the root.
    pub follow_root: Option<bool>,
    /// Whether a pair is shown as ghosts.
    pub ghost: Option<bool>,
    /// Whether the soft ring is on for a new mask.
    pub soft_ring: Option<bool>,
}

/// `POST users`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct NewUser {
    /// Name, unique: 1 to 64 characters.
    pub name: String,
    /// What they may do.
    pub role: Role,
}

/// `PATCH users/{id}`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct UserChange {
    /// New role.
    #[serde(default)]
    pub role: Option<Role>,
    /// Whether the user may log in.
    #[serde(default)]
    pub active: Option<bool>,
}

/// `POST users/{id}/tokens`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct NewToken {
    /// Days until it ends, 1 to 365.
    pub days: u32,
}

/// Answer to `POST users` and `POST users/{id}/tokens`. The token is shown this once.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct TokenShown {
    /// Whose it is.
    pub user: User,
    /// Id of the token, to revoke it.
    pub id: i64,
    /// The token.
    pub token: String,
    /// When it ends.
    pub expires: i64,
}

/// A token, without its secret.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct TokenInfo {
    /// Id.
    pub id: i64,
    /// Whose it is.
    pub user: i64,
    /// When it was made.
    pub created: i64,
    /// When it ends.
    pub expires: i64,
    /// When it was last used.
    pub last_used: Option<i64>,
    /// Whether it was revoked.
    pub revoked: bool,
}

impl Default for Settings {
    fn default() -> Self {
        let words = |list: &[&str]| list.iter().map(|&word| word.to_owned()).collect();
        Self {
            name: "stance".to_owned(),
            answers_per_task: 2,
            overlap_percent: 10,
            gold_percent: 2,
            blind_percent: 10,
            review_percent: 100,
            lease_minutes: 15,
            returned_days: 7,
            min_masks: 2,
            max_masks: 4,
            // Styles of the paper (Sec. 4.1) and the one more of the release.
            styles: words(&["proud", "old", "playful", "depressed", "angry", "sexy"]),
            templates: words(&[
                "higher",
                "lower",
                "faster",
                "slower",
                "with more force",
                "with less force",
                "wider",
                "narrower",
                "earlier",
                "later",
                "further to the left",
                "further to the right",
            ]),
            style_templates: words(&[
                "in a {style} way",
                "with {style} steps",
                "with a {style} upper body",
                "with {style} arms",
            ]),
            quota: 0,
            guide: include_str!("../guide.txt").to_owned(),
            time_zone: "UTC".to_owned(),
        }
    }
}
