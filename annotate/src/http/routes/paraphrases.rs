//! Paraphrases of accepted instructions.

use crate::Error;
use crate::http::app::{Context, Reply, json};
use crate::wire::{JudgeParaphrase, ParaphraseState};

pub(super) fn paraphrases(cx: &Context) -> Result<Reply, Error> {
    cx.only(&["state", "after", "limit"])?;
    let state = cx
        .one_of("state", ParaphraseState::parse)?
        .unwrap_or(ParaphraseState::Proposed);
    let after = cx.number("after")?.unwrap_or(0);
    json(&cx.app.store.paraphrases(state, after, cx.limit(100)?)?)
}

pub(super) fn judge(cx: &Context) -> Result<Reply, Error> {
    let judgement: JudgeParaphrase = cx.body()?;
    let (who, id) = (cx.who()?.id, cx.id()?);
    json(&cx.app.store.judge_paraphrase(who, id, judgement, cx.now)?)
}
