//! Users and their tokens.

use annotate::store::{Store, TokenUse, Who};
use annotate::wire::{Role, User};
use anyhow::Context;
use serde::Serialize;

use super::args::UserAction;
use super::shared::now;
use crate::exit::Exit;
use crate::global::Global;
use crate::report;

/// In milliseconds.
const DAY: i64 = 24 * 60 * 60_000;

/// The `--json` document of `user add` and `token`.
#[derive(Serialize)]
struct TokenDocument {
    user: User,
    token: String,
    expires: i64,
}

/// A new user in the `--json` document of `user import`.
#[derive(Serialize)]
struct Link {
    user: User,
    link: String,
    expires: i64,
}

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
    const DAYS: i64 = 90;
    match action {
        UserAction::Add { name, role: text } => {
            let user = store.add_user(None, name, role(text)?, now())?;
            token(store, &user, DAYS, global)
        }
        UserAction::Import { file, url, days } => {
            let lines = std::fs::read_to_string(file)
                .with_context(|| format!("cannot read {}", file.display()))?;
            let expires = now() + i64::from(*days) * DAY;
            let added: Vec<Link> = store
                .add_users(None, &lines, expires, now())
                .with_context(|| format!("in {}", file.display()))?
                .into_iter()
                .map(|issued| Link {
                    link: format!("{}/#token={}", url.trim_end_matches('/'), issued.token),
                    user: issued.user,
                    expires: issued.expires,
                })
                .collect();
            let lines: Vec<String> = added
                .iter()
                .map(|added| format!("{},{},{}", added.user.name, added.user.role, added.link))
                .collect();
            report::note("a link logs its user in until it ends; the links are shown this once");
            global.say(&added, &lines.join("\n"))
        }
        UserAction::List => {
            let users = store.users()?;
            let lines: Vec<String> = users
                .iter()
                .map(|user| {
                    let state = if user.active { "" } else { " (disabled)" };
                    format!("{:<24} {}{state}", user.name, user.role)
                })
                .collect();
            global.say(&users, &lines.join("\n"))
        }
        UserAction::Role { name, role: text } => {
            let user = find(store, name)?;
            changed(
                store.change_user(None, user.id, Some(role(text)?), None, now())?,
                global,
            )
        }
        UserAction::Disable { name } => {
            let user = find(store, name)?;
            changed(
                store.change_user(None, user.id, None, Some(false), now())?,
                global,
            )
        }
        UserAction::Enable { name } => {
            let user = find(store, name)?;
            changed(
                store.change_user(None, user.id, None, Some(true), now())?,
                global,
            )
        }
    }
}

fn changed(user: User, global: &Global) -> anyhow::Result<Exit> {
    let state = if user.active { "" } else { ", disabled" };
    let text = format!("{}: {}{state}", user.name, user.role);
    global.say(&user, &text)
}

/// The admin that the command line acts as.
pub(super) fn operator(store: &Store) -> anyhow::Result<Who> {
    let admin = store
        .users()?
        .into_iter()
        .find(|user| user.active && user.role == Role::Admin)
        .context("there is no active admin to act as; add one with `user add NAME --role admin`")?;
    Ok(Who {
        id: admin.id,
        name: admin.name,
        role: admin.role,
    })
}

/// Makes a token. It is the result, and goes to stdout alone.
pub(super) fn token(
    store: &Store,
    user: &User,
    days: i64,
    global: &Global,
) -> anyhow::Result<Exit> {
    let now = now();
    let issued = store.issue(user.id, TokenUse::Token, now + days * DAY, now)?;
    if global.json {
        report::json(&TokenDocument {
            user: issued.user,
            token: issued.token,
            expires: issued.expires,
        })?;
    } else {
        report::note(&format!(
            "token of {} ({}), good for {days} days, shown this once:",
            user.name, user.role
        ));
        report::text(&issued.token);
    }
    Ok(Exit::Done)
}
