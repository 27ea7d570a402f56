//! Log entries: their kinds, and how they are stored.

use serde::de::{DeserializeOwned, Error as _};
use serde::{Deserialize, Deserializer, Serialize};

use super::db::{Result, Row, unreadable};
use super::records::{Credit, Millis};
use crate::state::{LogKind, Purpose, ReleaseReason};
use crate::wire::{
    Answer, EditType, PlannedCapture, Role, Settings, SkipReason, SuggestionUse, TaskKind,
};

/// Version of the entries' bodies.
pub(super) const VERSION: i64 = 1;
/// A task in the log.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct LoggedTask {
    pub(crate) key: String,
    pub(crate) kind: TaskKind,
    pub(crate) source: String,
    pub(crate) target: Option<String>,
    pub(crate) split: String,
    pub(crate) bundle: Option<i64>,
    pub(crate) bundle_index: i64,
    pub(crate) category: Option<String>,
    pub(crate) hint: Option<String>,
    pub(crate) style: Option<String>,
    /// Edit type that the source states.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) edit_type: Option<EditType>,
    pub(crate) priority: i64,
    pub(crate) shuffle: i64,
    pub(crate) wanted: u32,
    pub(crate) gold: Option<Answer>,
    /// Whether the known answer is shown to users who answered the task.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub(crate) practice: bool,
    pub(crate) extra: Option<serde_json::Value>,
    pub(crate) accepted: Option<Answer>,
    #[serde(default)]
    pub(crate) credit: Option<Credit>,
}

/// Reads a value that another version of this program may have stored: missing fields get their default values, unknown
/// fields are ignored.
pub(super) fn stored<'de, T, D>(from: D) -> Result<T, D::Error>
where
    T: Default + Serialize + DeserializeOwned,
    D: Deserializer<'de>,
{
    let mut found = serde_json::Map::deserialize(from)?;
    let mut full = serde_json::to_value(T::default()).map_err(D::Error::custom)?;
    for (name, value) in full.as_object_mut().into_iter().flatten() {
        if let Some(kept) = found.remove(name) {
            *value = kept;
        }
    }
    serde_json::from_value(full).map_err(D::Error::custom)
}

/// [`stored`] for a JSON column.
pub(super) fn read_stored<T>(table: &'static str, text: &str) -> Result<T>
where
    T: Default + Serialize + DeserializeOwned,
{
    stored(&mut serde_json::Deserializer::from_str(text)).map_err(|error| unreadable(table, error))
}

/// A place in a bundle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Place {
    pub(crate) bundle: i64,
    pub(crate) index: i64,
}

/// Body of an entry. `request` is the hash of the request; it tells a repeated request from another one with the same
/// key.
///
/// Fields that hold ids of people are called `user`, `author`, `authors` or `people`: an export of the log replaces them
/// by pseudonyms. Below the top level it looks into `settings` and their `rules` alone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub(crate) enum Body {
    Imported {
        task: Box<LoggedTask>,
    },
    Filled {
        answer: Answer,
        credit: Option<Credit>,
        extra: Option<serde_json::Value>,
    },
    /// The clips were ingested with other content; the hashes are the new ones.
    ClipChanged {
        source: String,
        target: Option<String>,
    },
    ClipKept,
    Claimed {
        purpose: Purpose,
        expires: Millis,
        blind: bool,
        /// Position in a bundle at which a gold task replaces a task.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        place: Option<Place>,
    },
    Renewed {
        lease: i64,
        expires: Millis,
    },
    Released {
        lease: i64,
        user: i64,
        purpose: Purpose,
        reason: ReleaseReason,
        /// Time until which the task stays reserved for the user, who still owes a new version of a returned answer.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        reserved: Option<Millis>,
    },
    DraftSaved {
        answer: Answer,
        rev: i64,
        secs: f64,
        /// Why the answer did not become a revision; `None` if it did.
        kept_aside: Option<String>,
        request: String,
    },
    Submitted {
        answer: Answer,
        rev: i64,
        secs: f64,
        distance: Option<f64>,
        request: String,
    },
    Skipped {
        postponed: bool,
        reason: Option<SkipReason>,
        note: String,
        #[serde(default)]
        secs: f64,
        request: String,
    },
    Returned {
        authors: Vec<i64>,
        comment: String,
        until: Millis,
        #[serde(default)]
        secs: f64,
        request: String,
    },
    Accepted {
        author: i64,
        comment: String,
        #[serde(default)]
        secs: f64,
        request: String,
        /// Name of the rule that accepted the answer; `None` if the actor did.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        rule: Option<String>,
        /// Whether the actor accepted their own answer.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        own: bool,
    },
    Merged {
        answer: Answer,
        comment: String,
        #[serde(default)]
        secs: f64,
        request: String,
        /// Whether the actor answered the task too.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        own: bool,
    },
    Dropped {
        comment: String,
        #[serde(default)]
        secs: f64,
        request: String,
    },
    Reopened {
        comment: String,
        request: String,
        /// The rule whose acceptance is taken back.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        rule: Option<String>,
    },
    Undone {
        rev: i64,
        expires: Millis,
        request: String,
    },
    SuggestionUsed {
        suggestion: i64,
        used: SuggestionUse,
        request: String,
    },
    GoldScored {
        score: f64,
    },
    RoleChanged {
        user: i64,
        name: String,
        role: Role,
        active: bool,
    },
    SettingsChanged {
        #[serde(deserialize_with = "stored")]
        settings: Box<Settings>,
    },
    Exported {
        export: serde_json::Value,
    },
    Assigned {
        user: i64,
        until: Millis,
    },
    Retargeted {
        wanted: u32,
    },
    /// Written by programs up to version 0.1, and kept because people made these decisions.
    ParaphraseJudged {
        paraphrase: i64,
        instruction: String,
        proposed: String,
        text: String,
        /// `None`: the reviewer took the judgement back.
        accepted: Option<bool>,
    },
    CapturesPlanned {
        cells: Vec<PlannedCapture>,
    },
    /// A picture of the guide was stored; without a hash, it was deleted.
    GuidePicture {
        name: String,
        hash: Option<String>,
    },
}

impl Body {
    /// The kind with the name of this variant.
    pub(crate) fn kind(&self) -> LogKind {
        macro_rules! kind_of {
            ($body:expr, $($name:ident)+) => {
                match $body { $(Self::$name { .. } => LogKind::$name,)+ }
            };
        }
        kind_of!(
            self,
            Imported Filled ClipChanged ClipKept Claimed Renewed Released DraftSaved Submitted
            Skipped Returned Accepted Merged Dropped Reopened Undone SuggestionUsed GoldScored
            RoleChanged SettingsChanged Exported Assigned Retargeted CapturesPlanned GuidePicture
            ParaphraseJudged
        )
    }

    /// Seconds of work that an answer, skip or review reports, and the hash of its request. In older logs, skips and
    /// reviews report 0 seconds.
    pub(crate) fn work(&self) -> (f64, Option<&str>) {
        match self {
            Self::DraftSaved { secs, request, .. }
            | Self::Submitted { secs, request, .. }
            | Self::Skipped { secs, request, .. }
            | Self::Returned { secs, request, .. }
            | Self::Accepted { secs, request, .. }
            | Self::Merged { secs, request, .. }
            | Self::Dropped { secs, request, .. } => (*secs, Some(request.as_str())),
            Self::Reopened { request, .. }
            | Self::Undone { request, .. }
            | Self::SuggestionUsed { request, .. } => (0.0, Some(request.as_str())),
            _ => (0.0, None),
        }
    }
}

/// An entry of the log.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Entry {
    pub(crate) at: Millis,
    pub(crate) actor: Option<i64>,
    pub(crate) task: Option<i64>,
    pub(crate) epoch: Option<i64>,
    pub(crate) body: Body,
}

impl Entry {
    pub(crate) fn new(
        at: Millis,
        actor: Option<i64>,
        task: Option<i64>,
        epoch: Option<i64>,
        body: Body,
    ) -> Self {
        Self {
            at,
            actor,
            task,
            epoch,
            body,
        }
    }
}

/// The columns that [`read_entry`] reads, in order.
pub(crate) const ENTRY_COLUMNS: &str = "seq, at, actor, task, epoch, body, version";

/// Reads an entry of [`ENTRY_COLUMNS`] with its sequence number.
pub(crate) fn read_entry(row: &Row) -> Result<(i64, Entry)> {
    let (seq, at, actor, task, epoch, body, version): (i64, _, _, _, _, String, i64) =
        row.read()?;
    if version != VERSION {
        let problem = format!("entry {seq} is of version {version}, this program knows {VERSION}");
        return Err(unreadable("event", problem));
    }
    let body = serde_json::from_str(&body)
        .map_err(|error| unreadable("event", format!("entry {seq}: {error}")))?;
    Ok((seq, Entry::new(at, actor, task, epoch, body)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::{MaskAnswer, Style};

    /// Reads a value of an older store, and checks that it is written with the same bytes.
    fn same<T: DeserializeOwned + Serialize>(stored: &str) -> T {
        let read: T = serde_json::from_str(stored).expect("a stored value");
        assert_eq!(super::super::db::json(&read).expect("JSON"), stored);
        read
    }

    #[test]
    fn what_an_older_store_lacks_is_not_written_either() {
        // The edit type that a source states is missing.
        same::<Body>(
            r#"{"event":"imported","task":{"key":"pair:1","kind":"pair","source":"a","target":"b","split":"train","bundle":7,"bundle_index":0,"category":null,"hint":"higher","style":null,"priority":0,"shuffle":3,"wanted":1,"gold":null,"extra":null,"accepted":null,"credit":null}}"#,
        );
        let mask: MaskAnswer =
            same(r#"{"parts":["LEFT_ARM"],"soft":true,"text":"waving","suggestion":null}"#);
        assert!(mask.range.is_none() && mask.joints.is_empty());
        let style: Style = same(r##"{"name":"old","text":"Short steps.","colour":"#8f6b00"}"##);
        assert_eq!(style.guideline, "");
    }
}
