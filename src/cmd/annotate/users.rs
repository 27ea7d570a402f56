//! Users and their tokens.

use std::path::Path;

use annotate::store::{Store, TokenUse, Who};
use annotate::wire::{Role, User};
use anyhow::Context;
use serde_json::json;

use super::args::UserAction;
use super::shared::now;
use crate::exit::Exit;
use crate::global::Global;
use crate::{local, report};

/// A day in milliseconds.
const DAY: i64 = 24 * 60 * 60_000;
/// Days a new user's token is valid.
const TOKEN_DAYS: i64 = 90;

pub(super) fn find(store: &Store, name: &str) -> anyhow::Result<User> {
    let users = store.users()?;
    let names: Vec<&str> = users.iter().map(|user| user.name.as_str()).collect();
    let known = names.join(", ");
    users
        .iter()
        .find(|user| user.name == name)
        .cloned()
        .with_context(|| format!("there is no user {name:?}; known are: {known}"))
}

fn role(text: &str) -> anyhow::Result<Role> {
    Role::parse(text).context("the role is not known")
}

pub(super) fn user(store: &Store, action: &UserAction, global: &Global) -> anyhow::Result<Exit> {
    match action {
        UserAction::Add { name, role: text } => {
            let user = store.add_user(None, name, role(text)?, now(store)?)?;
            token(store, &user, TOKEN_DAYS, global)
        }
        UserAction::Import { file, url, days } => import(store, file, url, *days, global),
        UserAction::List => {
            let users = store.users()?;
            let lines = users.iter().map(|user| {
                let state = if user.active { "" } else { " (disabled)" };
                format!("{:<24} {}{state}", user.name, user.role)
            });
            global.say(&users, &lines.collect::<Vec<_>>().join("\n"))
        }
        UserAction::Role { name, role: text } => {
            change(store, name, Some(role(text)?), None, global)
        }
        UserAction::Disable { name } => change(store, name, None, Some(false), global),
        UserAction::Enable { name } => change(store, name, None, Some(true), global),
    }
}

fn import(
    store: &Store,
    file: &Path,
    url: &str,
    days: u16,
    global: &Global,
) -> anyhow::Result<Exit> {
    let text = local::read_text(file)?;
    let (now, url) = (now(store)?, url.trim_end_matches('/'));
    let added = store
        .add_users(None, &text, now + i64::from(days) * DAY, now)
        .with_context(|| format!("in {}", file.display()))?;
    let (mut documents, mut lines) = (Vec::new(), Vec::new());
    for issued in added {
        let (user, link) = (issued.user, format!("{url}/#token={}", issued.token));
        lines.push(format!("{},{},{link}", user.name, user.role));
        documents.push(json!({ "user": user, "link": link, "expires": issued.expires }));
    }
    report::note("a link logs its user in until it ends; the links are shown this once");
    global.say(&documents, &lines.join("\n"))
}

fn change(
    store: &Store,
    name: &str,
    role: Option<Role>,
    active: Option<bool>,
    global: &Global,
) -> anyhow::Result<Exit> {
    let user = find(store, name)?;
    let user = store.change_user(None, user.id, role, active, now(store)?)?;
    let state = if user.active { "" } else { ", disabled" };
    let text = format!("{}: {}{state}", user.name, user.role);
    global.say(&user, &text)
}

/// The first active admin.
pub(super) fn admin(store: &Store) -> anyhow::Result<Option<User>> {
    let mut users = store.users()?.into_iter();
    Ok(users.find(|user| user.active && user.role == Role::Admin))
}

/// The admin that the command line acts as.
pub(super) fn operator(store: &Store) -> anyhow::Result<Who> {
    let User { id, name, role, .. } = admin(store)?
        .context("there is no active admin to act as; add one with `user add NAME --role admin`")?;
    Ok(Who { id, name, role })
}

/// Makes and prints a token. Without `--json`, stdout gets only the token, so that scripts can use it.
pub(super) fn token(
    store: &Store,
    user: &User,
    days: i64,
    global: &Global,
) -> anyhow::Result<Exit> {
    let now = now(store)?;
    let issued = store.issue(user.id, TokenUse::Token, now + days * DAY, now)?;
    if global.json {
        let (user, token) = (issued.user, issued.token);
        report::json(&json!({ "user": user, "token": token, "expires": issued.expires }))?;
    } else {
        report::note(&format!(
            "token of {} ({}), good for {days} days, shown this once:",
            user.name, user.role
        ));
        report::text(&issued.token);
    }
    Ok(Exit::Done)
}
