//! Settings, the capture plan, users and tokens.

use crate::Error;
use crate::http::app::{Context, Reply, json};
use crate::store::{IssuedToken, TokenUse};
use crate::wire::{
    CapturePlan, NewToken, NewUser, NewUserLink, NewUsers, Settings, TokenShown, UserChange,
};

/// Days a new user's token is valid.
const TOKEN_DAYS: u32 = 90;
const DAY: i64 = 24 * 60 * 60 * 1000;

pub(super) fn settings(cx: &Context) -> Result<Reply, Error> {
    json(&cx.app.store.settings()?)
}

pub(super) fn put_settings(cx: &Context) -> Result<Reply, Error> {
    let settings: Settings = cx.body()?;
    cx.app.store.put_settings(cx.who()?.id, settings, cx.now)?;
    json(&cx.app.store.settings()?)
}

pub(super) fn put_captures(cx: &Context) -> Result<Reply, Error> {
    let plan: CapturePlan = cx.body()?;
    let store = &cx.app.store;
    store.plan_captures(cx.who()?.id, plan.cells, cx.now)?;
    json(&store.captures()?)
}

pub(super) fn users(cx: &Context) -> Result<Reply, Error> {
    json(&cx.app.store.users()?)
}

fn shown(token: IssuedToken) -> TokenShown {
    TokenShown {
        user: token.user,
        id: token.id,
        token: token.token,
        expires: token.expires,
    }
}

pub(super) fn add_user(cx: &Context) -> Result<Reply, Error> {
    let new: NewUser = cx.body()?;
    let user = cx
        .app
        .store
        .add_user(Some(cx.who()?.id), &new.name, new.role, cx.now)?;
    let expires = cx.now + i64::from(TOKEN_DAYS) * DAY;
    json(&shown(cx.app.store.issue(
        user.id,
        TokenUse::Token,
        expires,
        cx.now,
    )?))
}

pub(super) fn add_users(cx: &Context) -> Result<Reply, Error> {
    let new: NewUsers = cx.body()?;
    check_days(new.days)?;
    let expires = cx.now + i64::from(new.days) * DAY;
    let users: Vec<NewUserLink> = cx
        .app
        .store
        .add_users(Some(cx.who()?.id), &new.lines, expires, cx.now)?
        .into_iter()
        .map(|token| NewUserLink {
            user: token.user,
            path: format!("/#token={}", token.token),
            expires: token.expires,
        })
        .collect();
    json(&users)
}

fn check_days(days: u32) -> Result<(), Error> {
    if (1..=365).contains(&days) {
        return Ok(());
    }
    Err(Error::invalid("days", "a token is valid for 1 to 365 days"))
}

pub(super) fn change_user(cx: &Context) -> Result<Reply, Error> {
    let change: UserChange = cx.body()?;
    let user = cx.app.store.change_user(
        Some(cx.who()?.id),
        cx.id()?,
        change.role,
        change.active,
        cx.now,
    )?;
    json(&user)
}

pub(super) fn tokens(cx: &Context) -> Result<Reply, Error> {
    json(&cx.app.store.tokens(cx.id()?)?)
}

pub(super) fn add_token(cx: &Context) -> Result<Reply, Error> {
    let new: NewToken = cx.body()?;
    check_days(new.days)?;
    let expires = cx.now + i64::from(new.days) * DAY;
    json(&shown(cx.app.store.issue(
        cx.id()?,
        TokenUse::Token,
        expires,
        cx.now,
    )?))
}

pub(super) fn revoke(cx: &Context) -> Result<Reply, Error> {
    cx.app.store.revoke(cx.id()?)?;
    Ok(Reply::Empty)
}
