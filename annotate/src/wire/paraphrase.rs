//! Paraphrases of accepted instructions.

use serde::{Deserialize, Serialize};

use super::names::ParaphraseState;

/// `GET paraphrases?state=&after=&limit=`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct Paraphrases {
    /// Paraphrases of the state, oldest first.
    pub items: Vec<Paraphrase>,
    /// Value of `after` for the next page.
    pub next: Option<i64>,
    /// Paraphrases that nobody has judged.
    pub waiting: i64,
}

/// A paraphrase.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct Paraphrase {
    /// Id.
    pub id: i64,
    /// The accepted instruction.
    pub instruction: String,
    /// Another wording of it.
    pub text: String,
    /// Name of the model that proposed it.
    pub model: String,
    /// State.
    pub state: ParaphraseState,
    /// Id of the person who judged it.
    pub judge: Option<i64>,
    /// When it was proposed or judged.
    pub at: i64,
}

/// `POST paraphrases/{id}`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct JudgeParaphrase {
    /// Whether the composer may use it. `null` takes my judgement back, so that it waits for one again.
    #[serde(deserialize_with = "Option::deserialize")]
    pub accept: Option<bool>,
    /// The wording as the reviewer corrected it; with a judgement that is taken back, the proposed one.
    #[serde(default)]
    pub text: Option<String>,
    /// The state that the reviewer saw: 409 `wrong_state` if somebody changed it meanwhile.
    #[serde(default)]
    pub was: Option<ParaphraseState>,
}
