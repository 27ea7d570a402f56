//! Rules of acceptance.

use crate::Error;
use crate::http::app::{Context, Reply, json};
use crate::wire::ApplyRules;

pub(super) fn rules(cx: &Context) -> Result<Reply, Error> {
    json(&cx.app.store.rules()?)
}

pub(super) fn apply(cx: &Context) -> Result<Reply, Error> {
    let request: ApplyRules = cx.body()?;
    json(
        &cx.app
            .store
            .apply_rules(request.after.unwrap_or(0), cx.now)?,
    )
}

pub(super) fn undo(cx: &Context) -> Result<Reply, Error> {
    json(
        &cx.app
            .store
            .undo_rule(cx.who()?.id, cx.param("name"), cx.now)?,
    )
}
