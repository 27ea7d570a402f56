//! Settings, the capture plan, users and tokens.

use axum::response::Response;

use crate::clock::DAY;
use crate::error::{Error, require};
use crate::http::app::{Context, json};
use crate::store::TokenUse;
use crate::wire::{CapturePlan, NewToken, NewUser, NewUserLink, NewUsers, TokenShown, UserChange};

/// Number of days for which a new user's token is valid.
const TOKEN_DAYS: u32 = 90;

pub(super) fn put_settings(cx: &Context) -> Result<Response, Error> {
    cx.store().change_settings(cx.user()?, cx.body()?, cx.now)?;
    json(&cx.store().settings()?)
}

pub(super) fn put_captures(cx: &Context) -> Result<Response, Error> {
    let plan: CapturePlan = cx.body()?;
    cx.store().plan_captures(cx.user()?, plan.cells, cx.now)?;
    json(&cx.store().captures()?)
}

/// A response with a new token for a user.
fn issued(cx: &Context, user: i64, days: u32) -> Result<Response, Error> {
    let (purpose, expires) = (TokenUse::Token, end(cx, days)?);
    json(&cx.store().issue(user, purpose, expires, cx.now)?)
}

/// Expiry of a token that is issued now for this many days. Refused with `invalid`.
fn end(cx: &Context, days: u32) -> Result<i64, Error> {
    let problem = "a token is valid for 1 to 365 days";
    require((1..=365).contains(&days), "days", problem)?;
    Ok(cx.now + i64::from(days) * DAY)
}

pub(super) fn add_user(cx: &Context) -> Result<Response, Error> {
    let new: NewUser = cx.body()?;
    let admin = Some(cx.user()?);
    let user = cx.store().add_user(admin, &new.name, new.role, cx.now)?;
    issued(cx, user.id, TOKEN_DAYS)
}

pub(super) fn add_users(cx: &Context) -> Result<Response, Error> {
    let new: NewUsers = cx.body()?;
    let (admin, expires) = (Some(cx.user()?), end(cx, new.days)?);
    let tokens = cx.store().add_users(admin, &new.lines, expires, cx.now)?;
    let link = |token: TokenShown| NewUserLink {
        path: format!("/#token={}", token.token),
        user: token.user,
        expires: token.expires,
    };
    json(&tokens.into_iter().map(link).collect::<Vec<_>>())
}

pub(super) fn change_user(cx: &Context) -> Result<Response, Error> {
    let UserChange { role, active } = cx.body()?;
    let (admin, user) = (Some(cx.user()?), cx.id()?);
    json(&cx.store().change_user(admin, user, role, active, cx.now)?)
}

pub(super) fn add_token(cx: &Context) -> Result<Response, Error> {
    let new: NewToken = cx.body()?;
    issued(cx, cx.id()?, new.days)
}
