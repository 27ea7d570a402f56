//! Messages about people and the project: login, preferences, settings, the guide, users and tokens.

#![expect(
    missing_docs,
    reason = "a field whose name says what it is needs no words"
)]

use std::collections::BTreeMap;

use serde::{Deserialize, Deserializer};

use super::{Action, EditType, Role, Rule, TaskKind, TextForm};

messages! {
    /// `POST session`.
    #[serde(deny_unknown_fields)]
    pub struct Login {
        pub token: String,
    }

    /// A user.
    pub struct User {
        pub id: i64,
        /// Name, unique.
        pub name: String,
        pub role: Role,
        /// Whether the user may log in.
        pub active: bool,
    }

    /// `GET me`, and the answer to `POST session`.
    pub struct Me {
        pub user: User,
        pub limits: Limits,
        pub project: Project,
        pub prefs: Prefs,
        /// Name of the language model, if there is one.
        pub model: Option<String>,
        /// Why the store accepts no writes now; `null` if it does.
        pub read_only: Option<String>,
        /// Version of the server.
        pub version: String,
        /// Id of the store. Browsers keep their data by store, because another project may be served at the same
        /// address.
        pub store: String,
    }

    /// How long a lease lasts.
    pub struct Limits {
        pub lease_secs: i64,
        /// Seconds between renewals.
        pub heartbeat_secs: i64,
    }

    /// The settings that annotators see.
    pub struct Project {
        pub name: String,
        pub min_masks: usize,
        pub max_masks: usize,
        pub styles: Vec<Style>,
        pub templates: Vec<String>,
        pub style_templates: Vec<String>,
        pub mask_templates: Vec<String>,
        pub time_zone: String,
    }

    /// A style of the project.
    #[derive(Default)]
    #[serde(deny_unknown_fields)]
    pub struct Style {
        /// Name of the style in answers and pairs: 1 to 100 characters.
        pub name: String,
        /// Appearance of the style, for the people who perform and describe it.
        #[serde(default)]
        pub text: String,
        /// How the style is performed, in paragraphs separated by empty lines: what the body does, and what it must not
        /// do. Up to 10,000 characters.
        #[serde(default, skip_serializing_if = "String::is_empty")]
        pub guideline: String,
        /// The colour that marks the style, `#rrggbb`.
        pub colour: Option<String>,
    }

    /// `GET settings`.
    #[serde(deny_unknown_fields)]
    pub struct Settings {
        pub name: String,
        /// Number of people who answer each of the `overlap_percent` of tasks; the others are answered by one person.
        /// A change applies to tasks that still want answers.
        pub answers_per_task: u32,
        /// Percent of tasks that `answers_per_task` people answer.
        pub overlap_percent: u32,
        /// Percent of the tasks given out that are hidden gold tasks, whose answer is known.
        pub gold_percent: u32,
        /// Percent of tasks shown without any draft.
        pub blind_percent: u32,
        /// Percent of submitted tasks that are in the review queue `sample`.
        pub review_percent: u32,
        pub lease_minutes: u32,
        /// Days a returned task waits for its author.
        pub returned_days: u32,
        /// Minimum number of masks of an answer without a stated reason.
        pub min_masks: usize,
        /// Maximum number of masks of an answer without a stated reason.
        pub max_masks: usize,
        /// Styles to choose from, in the order in which they were added. Styles of the dataset are added when its pairs
        /// are imported, and a new style when the first answer with it is accepted.
        #[serde(deserialize_with = "styles_or_names")]
        pub styles: Vec<Style>,
        /// Phrases for completing the instruction of a fine-grained pair.
        pub templates: Vec<String>,
        /// Phrases for starting the description of a mask: they complete "The person is …".
        #[serde(default)]
        pub mask_templates: Vec<String>,
        /// Phrases for completing the instruction of a style pair; `{style}` is the chosen style.
        pub style_templates: Vec<String>,
        /// Pairs wanted of each category and edit type, for the dashboard; 0 for no bound.
        pub quota: u32,
        /// Number of kept pairs of a category at which its other pairs are no longer given out; 0 for no bound.
        pub category_quota: u32,
        /// Pairs wanted of each edit type, in all categories together; 0, or no entry, for no bound. Pairs whose stated
        /// type is furthest behind its quota are given out first. No pair is held back.
        #[serde(default)]
        pub edit_type_quota: BTreeMap<EditType, u32>,
        /// The guide, plain text.
        pub guide: String,
        /// Name of the time zone in which days begin, such as `Europe/Berlin`.
        pub time_zone: String,
        #[serde(default)]
        pub guides: BTreeMap<TaskKind, KindGuide>,
        /// Rules that accept answers without a reviewer, tried in this order.
        #[serde(default)]
        pub rules: Vec<Rule>,
        /// Minutes in which an author may take back an answer that a rule accepted.
        #[serde(default = "take_back_minutes")]
        pub take_back_minutes: u32,
        /// Seed for choosing the tasks that are left to reviewers.
        #[serde(default)]
        pub seed: u32,
        /// Practice tasks that an annotator does before real work of a kind; 0 for none.
        #[serde(default)]
        pub practice_tasks: u32,
        /// Mean score in percent that opens real work.
        #[serde(default = "practice_percent")]
        pub practice_percent: u32,
        /// Whether reviewers may accept their own answers: for a project of one person. Such acceptances are marked in
        /// every export.
        #[serde(default)]
        pub solo: bool,
    }

    /// `PUT settings`: fields that differ between `was` and `now` are changed, if the store still has them as they were.
    #[serde(deny_unknown_fields)]
    pub struct SettingsChange {
        /// The settings as the client read them.
        pub was: Settings,
        /// The settings as the client wants them.
        pub now: Settings,
    }

    /// `GET`/`PUT prefs`. Keys are the `KeyboardEvent.code` values that [`super::KEY_CODES`] lists, with `Ctrl+`,
    /// `Shift+` or both in front.
    #[derive(Default)]
    #[serde(deny_unknown_fields, default)]
    pub struct Prefs {
        /// Keys that differ from the defaults.
        pub keys: BTreeMap<Action, Vec<String>>,
        /// Playback speed, 0.1 to 2.
        pub speed: Option<f64>,
        pub follow_root: Option<bool>,
        /// Whether a pair is shown as ghosts.
        pub ghost: Option<bool>,
        /// Whether the soft ring is on for a new mask.
        pub soft_ring: Option<bool>,
    }

    /// `POST users`.
    #[serde(deny_unknown_fields)]
    pub struct NewUser {
        /// Name, unique: 1 to 64 characters.
        pub name: String,
        pub role: Role,
    }

    /// `POST users/bulk`: many users at once, all or none.
    #[serde(deny_unknown_fields)]
    pub struct NewUsers {
        /// A line for each user: a name, or a name and a role separated by a comma, a semicolon or a tab.
        pub lines: String,
        /// Days until their tokens end, 1 to 365.
        #[serde(default = "token_days")]
        pub days: u32,
    }

    /// Answer to `POST users/bulk`: a new user with a link to log in.
    pub struct NewUserLink {
        pub user: User,
        /// Path to append to the address of the server: it logs the user in until the token ends. Shown only once.
        pub path: String,
        pub expires: i64,
    }

    /// `PATCH users/{id}`.
    #[derive(Default)]
    #[serde(deny_unknown_fields)]
    pub struct UserChange {
        pub role: Option<Role>,
        pub active: Option<bool>,
    }

    /// `POST users/{id}/tokens`.
    #[serde(deny_unknown_fields)]
    pub struct NewToken {
        /// Days until the token ends, 1 to 365.
        pub days: u32,
    }

    /// Answer to `POST users` and `POST users/{id}/tokens`. The token is shown this once.
    pub struct TokenShown {
        pub user: User,
        /// Id of the token, to revoke it.
        pub id: i64,
        pub token: String,
        pub expires: i64,
    }

    /// A token, without its secret.
    pub struct TokenInfo {
        pub id: i64,
        pub user: i64,
        pub created: i64,
        pub expires: i64,
        pub last_used: Option<i64>,
        pub revoked: bool,
    }

    /// `GET guide`.
    pub struct Guide {
        /// Guidelines for all kinds of task, plain text.
        pub text: String,
        pub kinds: BTreeMap<TaskKind, KindGuide>,
        /// Form of the texts of each kind.
        pub forms: BTreeMap<TaskKind, TextForm>,
    }

    /// `PUT guide/{kind}`: the guidelines as the client read them, and as it wants them.
    #[serde(deny_unknown_fields)]
    pub struct GuideChange {
        pub was: KindGuide,
        pub now: KindGuide,
    }

    /// Guidelines of a kind of task.
    #[derive(Default)]
    #[serde(deny_unknown_fields, default)]
    pub struct KindGuide {
        /// Plain text.
        pub text: String,
        pub pictures: Vec<GuidePicture>,
    }

    /// A picture of a right or a wrong answer.
    #[serde(deny_unknown_fields)]
    pub struct GuidePicture {
        /// Name, at `guide/pictures/{name}`.
        pub name: String,
        pub caption: String,
        /// Whether the answer it shows is right.
        pub right: bool,
    }

    /// `GET guide/pictures`: a stored picture.
    pub struct PictureInfo {
        /// Name: up to 60 letters, digits, dashes, dots and underscores.
        pub name: String,
        pub mime: String,
        pub bytes: usize,
    }
}

impl Style {
    /// A style with only a name.
    pub fn named(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            ..Self::default()
        }
    }
}

/// Reads the styles of a project. Version 0.1 stored only their names.
fn styles_or_names<'de, D: Deserializer<'de>>(stored: D) -> Result<Vec<Style>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Stored {
        Name(String),
        Style(Style),
    }
    let stored = Vec::<Stored>::deserialize(stored)?;
    let styles = stored.into_iter().map(|stored| match stored {
        Stored::Name(name) => Style::named(&name),
        Stored::Style(style) => style,
    });
    Ok(styles.collect())
}

impl Settings {
    /// Whether the project has a style of this name.
    pub fn has_style(&self, name: &str) -> bool {
        self.styles.iter().any(|style| style.name == name)
    }
}

fn take_back_minutes() -> u32 {
    60
}

fn practice_percent() -> u32 {
    80
}

fn token_days() -> u32 {
    90
}

impl Default for Settings {
    fn default() -> Self {
        let words = |list: &str| list.split(", ").map(str::to_owned).collect();
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
            // Styles of the paper (Sec. 4.1) and one more style of the release.
            styles: ["proud", "old", "playful", "depressed", "angry", "sexy"]
                .map(Style::named)
                .into(),
            templates: words(
                "higher, lower, faster, slower, with more force, with less force, wider, narrower, \
                 earlier, later, further to the left, further to the right",
            ),
            style_templates: words(
                "in a {style} way, with {style} steps, with a {style} upper body, with {style} arms",
            ),
            mask_templates: words(
                "raising, lowering, swinging, bending, stretching out, holding still",
            ),
            quota: 0,
            category_quota: 0,
            edit_type_quota: BTreeMap::new(),
            guide: include_str!("../guide/all.txt").to_owned(),
            time_zone: "UTC".to_owned(),
            guides: [
                (TaskKind::MaskText, include_str!("../guide/mask_text.txt")),
                (TaskKind::Pair, include_str!("../guide/pair.txt")),
                (TaskKind::Style, include_str!("../guide/style.txt")),
            ]
            .map(|(kind, text)| {
                let guide = KindGuide {
                    text: text.to_owned(),
                    ..KindGuide::default()
                };
                (kind, guide)
            })
            .into(),
            rules: Vec::new(),
            take_back_minutes: take_back_minutes(),
            seed: 0,
            practice_tasks: 0,
            practice_percent: practice_percent(),
            solo: false,
        }
    }
}
