//! Users, tokens and sessions. Tokens are stored as hashes.

use serde::Deserialize;
use sha2::{Digest, Sha256};

use super::db::{Result, Tx, params};
use super::entry::Body;
use super::records::{IssuedToken, Millis, TokenUse, Who};
use super::settings::has_up_to;
use super::store::Store;
use super::{leases, log, rows};
use crate::error::{Error, require};
use crate::state::ReleaseReason;
use crate::wire::{Code, Role, TokenInfo, User};

/// Random bytes of a token.
const TOKEN_BYTES: usize = 32;
/// Minimum interval between updates of a token's last use.
const NOTE_EVERY: Millis = 60_000;

impl Store {
    /// All users.
    pub fn users(&self) -> Result<Vec<User>> {
        self.read(|tx| tx.list("SELECT id, name, role, active FROM usr ORDER BY id", &[]))
    }

    /// Adds many users, each with a token, or none if a line is wrong. Refused with `invalid`, which names the line.
    pub fn add_users(
        &self,
        actor: Option<i64>,
        lines: &str,
        expires: Millis,
        now: Millis,
    ) -> Result<Vec<IssuedToken>> {
        let new = parse_lines(lines)?;
        self.write(move |tx| {
            new.iter()
                .map(|(number, name, role)| {
                    let user = add(tx, actor, name, *role, now).map_err(|error| match error {
                        Error::Refused(problem) => Error::invalid(
                            &format!("lines.{number}"),
                            format!("line {number}: {}; no user was added", problem.detail),
                        ),
                        other => other,
                    })?;
                    issue(tx, user.id, TokenUse::Token, expires, now)
                })
                .collect()
        })
    }

    /// Adds a user. Refused with `invalid` for a bad or taken name.
    pub fn add_user(
        &self,
        actor: Option<i64>,
        name: &str,
        role: Role,
        now: Millis,
    ) -> Result<User> {
        let name = name.to_owned();
        self.write(move |tx| add(tx, actor, &name, role, now))
    }

    /// Changes a user. Disabling a user revokes their tokens and ends their leases. The last active admin cannot be
    /// demoted or disabled. Refused with `invalid`, `not_found`.
    pub fn change_user(
        &self,
        actor: Option<i64>,
        user: i64,
        role: Option<Role>,
        active: Option<bool>,
        now: Millis,
    ) -> Result<User> {
        self.write(move |tx| {
            let before = self::user(tx, user)?;
            let after = User {
                role: role.unwrap_or(before.role),
                active: active.unwrap_or(before.active),
                ..before.clone()
            };
            let is_admin = |user: &User| user.active && user.role == Role::Admin;
            if is_admin(&before) && !is_admin(&after) {
                let others = "SELECT 1 FROM usr WHERE role = 'admin' AND active = 1 AND id <> ?1";
                let problem = "this is the last admin; add another one first";
                require(tx.has(others, params![user])?, "role", problem)?;
            }
            let sql = "UPDATE usr SET role = ?2, active = ?3 WHERE id = ?1";
            tx.run(sql, params![user, after.role, after.active])?;
            if !after.active {
                tx.run("UPDATE token SET revoked = 1 WHERE usr = ?1", params![user])?;
                // End the user's leases, so that others can take the tasks.
                let from = "lease l WHERE l.usr = ?1 ORDER BY l.id";
                for held in rows::leases(tx, from, params![user])? {
                    leases::end(tx, &held, actor, ReleaseReason::TakenAway, now)?;
                }
            }
            logged(tx, actor, &after, now)?;
            Ok(after)
        })
    }

    /// Creates a token. Refused with `not_found`.
    pub fn issue(
        &self,
        user: i64,
        purpose: TokenUse,
        expires: Millis,
        now: Millis,
    ) -> Result<IssuedToken> {
        self.write(move |tx| issue(tx, user, purpose, expires, now))
    }

    /// The user of a token, if it is valid for this purpose. A one-time token becomes invalid.
    /// Refused with `unauthenticated`.
    pub fn authenticate(&self, token: &str, purpose: TokenUse, now: Millis) -> Result<Who> {
        let hash = hash(token);
        let found = self.read(|tx| find(tx, &hash, &[purpose], now))?;
        let is_old = |at: Millis| now - at > NOTE_EVERY;
        if purpose == TokenUse::Once || found.last_used.is_none_or(is_old) {
            return match self.write(move |tx| used(tx, &hash, &[purpose], now)) {
                // People can read while the disk is full; only the time of the last use is not noted.
                Err(Error::ReadOnly { .. }) if purpose != TokenUse::Once => Ok(found.who),
                who => who,
            };
        }
        Ok(found.who)
    }

    /// [`Self::authenticate`] without a record of the use. Refused with `unauthenticated`.
    pub fn recognise(&self, token: &str, purpose: TokenUse, now: Millis) -> Result<Who> {
        let hash = hash(token);
        Ok(self.read(|tx| find(tx, &hash, &[purpose], now))?.who)
    }

    /// Begins a session with a token. It ends at `until`, or with the token if that is earlier; the end of a one-time
    /// token does not matter. Refused with `unauthenticated`.
    pub fn log_in(&self, token: &str, until: Millis, now: Millis) -> Result<(Who, IssuedToken)> {
        let hash = hash(token);
        self.write(move |tx| {
            let purposes = [TokenUse::Token, TokenUse::Once];
            let found = find(tx, &hash, &purposes, now)?;
            let until = if found.purpose == TokenUse::Once {
                until
            } else {
                until.min(found.expires)
            };
            let who = used(tx, &hash, &purposes, now)?;
            let session = issue(tx, who.id, TokenUse::Session, until, now)?;
            Ok((who, session))
        })
    }

    /// A user's tokens, without sessions.
    pub fn tokens(&self, user: i64) -> Result<Vec<TokenInfo>> {
        let sql = "SELECT id, usr, created, expires, last_used, revoked FROM token
             WHERE usr = ?1 AND purpose <> 'session' ORDER BY id";
        self.read(|tx| tx.list(sql, params![user]))
    }

    /// Revokes a token and all sessions of its owner: a thief of the token may have opened some.
    /// Refused with `not_found`.
    pub fn revoke(&self, token: i64) -> Result<()> {
        self.write(move |tx| {
            let sql = "SELECT usr FROM token WHERE id = ?1";
            let user: Option<i64> = tx.find(sql, params![token])?;
            let user = user.ok_or_else(|| Error::not_found("token"))?;
            let sql =
                "UPDATE token SET revoked = 1 WHERE id = ?1 OR (usr = ?2 AND purpose = 'session')";
            tx.run(sql, params![token, user])
        })
    }

    /// Revokes a session.
    pub fn log_out(&self, token: &str) -> Result<()> {
        let hash = hash(token);
        self.write(move |tx| {
            let sql = "UPDATE token SET revoked = 1 WHERE hash = ?1";
            tx.run(sql, params![&hash])
        })
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// SHA-256, hexadecimal.
pub(crate) fn sha256(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

/// The hash by which a token is stored.
fn hash(token: &str) -> String {
    sha256(token.trim().as_bytes())
}

/// Random bytes, hexadecimal.
pub(super) fn random<const BYTES: usize>() -> Result<String> {
    let mut bytes = [0; BYTES];
    let source = "the operating system";
    getrandom::fill(&mut bytes)
        .map_err(|error| std::io::Error::other(error.to_string()))
        .map_err(datasets_spec::Error::io("read random bytes from", source))?;
    Ok(hex(&bytes))
}

fn user(tx: &mut dyn Tx, id: i64) -> Result<User> {
    let sql = "SELECT id, name, role, active FROM usr WHERE id = ?1";
    let user = tx.find(sql, params![id])?;
    user.ok_or_else(|| Error::not_found("user"))
}

fn logged(tx: &mut dyn Tx, actor: Option<i64>, user: &User, now: Millis) -> Result<()> {
    let body = Body::RoleChanged {
        user: user.id,
        name: user.name.clone(),
        role: user.role,
        active: user.active,
    };
    log::note(tx, now, actor, None, body)
}

fn add(tx: &mut dyn Tx, actor: Option<i64>, name: &str, role: Role, now: Millis) -> Result<User> {
    let name = name.trim();
    let is_name = !name.is_empty() && has_up_to(name, 64) && !name.contains(char::is_control);
    let problem = "a name must have 1 to 64 characters and no control characters";
    require(is_name, "name", problem)?;
    let is_taken = tx.has("SELECT 1 FROM usr WHERE name = ?1", params![name])?;
    let problem = format!("there is a user {name:?} already; choose another name");
    require(!is_taken, "name", problem)?;
    let id = tx.next_id("usr")?;
    let sql = "INSERT INTO usr (id, name, role, active, created) VALUES (?1, ?2, ?3, 1, ?4)";
    tx.run(sql, params![id, name, role, now])?;
    let user = User {
        id,
        name: name.to_owned(),
        role,
        active: true,
    };
    logged(tx, actor, &user, now)?;
    Ok(user)
}

fn issue(
    tx: &mut dyn Tx,
    id: i64,
    purpose: TokenUse,
    expires: Millis,
    now: Millis,
) -> Result<IssuedToken> {
    let user = user(tx, id)?;
    let problem = "this user is not active; activate them first";
    require(user.active, "user", problem)?;
    let token = format!("ann_{}", random::<TOKEN_BYTES>()?);
    let id = tx.next_id("token")?;
    tx.run(
        "INSERT INTO token (id, usr, hash, purpose, created, expires, last_used, revoked)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, NULL, 0)",
        params![id, user.id, hash(&token), purpose, now, expires],
    )?;
    Ok(IssuedToken {
        user,
        id,
        token,
        expires,
    })
}

/// Maximum number of users that one request can add.
const MAX_LINES: usize = 1000;

/// Parses a list of users: each line is a name, or a name and a role separated by a comma, a semicolon or a tab.
/// Returns each with the number of its line. Empty lines are skipped, and so are a first line with the name `name`, a
/// heading, and the byte order mark that spreadsheets write.
fn parse_lines(text: &str) -> Result<Vec<(usize, String, Role)>> {
    let mut users = Vec::new();
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    for (index, line) in text.lines().enumerate() {
        let number = index + 1;
        let unquoted = |text: &str| text.trim().trim_matches('"').trim().to_owned();
        let (name, second) = match line.rsplit_once([',', ';', '\t']) {
            Some((name, role)) => (unquoted(name), unquoted(role)),
            None => (unquoted(line), String::new()),
        };
        if name.is_empty() && second.is_empty() || number == 1 && name == "name" {
            continue;
        }
        let role = match second.as_str() {
            "" => Role::Annotator,
            text => Role::parse(text).ok_or_else(|| {
                Error::invalid(
                    &format!("lines.{number}"),
                    format!("line {number}: {text:?} is no role; use annotator, reviewer or admin"),
                )
            })?,
        };
        users.push((number, name, role));
    }
    let fits = (1..=MAX_LINES).contains(&users.len());
    let problem = format!("write 1 to {MAX_LINES} lines, each a name or NAME,ROLE");
    require(fits, "lines", problem)?;
    Ok(users)
}

/// A valid token and its owner.
#[derive(Deserialize)]
struct Found {
    token: i64,
    purpose: TokenUse,
    expires: Millis,
    last_used: Option<Millis>,
    who: Who,
}

fn find(tx: &mut dyn Tx, hash: &str, purposes: &[TokenUse], now: Millis) -> Result<Found> {
    let found: Option<Found> = tx.find(
        "SELECT k.id, k.purpose, k.expires, k.last_used, u.id, u.name, u.role
         FROM token k JOIN usr u ON u.id = k.usr
         WHERE k.hash = ?1 AND k.revoked = 0 AND u.active = 1",
        params![hash],
    )?;
    let fits = |found: &Found| purposes.contains(&found.purpose) && found.expires > now;
    let problem = "this token is unknown, revoked or expired; ask an admin for a new one";
    let found = found.filter(fits);
    found.ok_or_else(|| Error::refused(Code::Unauthenticated, problem))
}

/// Like [`find`], but also records the use. A one-time token becomes invalid.
fn used(tx: &mut dyn Tx, hash: &str, purposes: &[TokenUse], now: Millis) -> Result<Who> {
    let found = find(tx, hash, purposes, now)?;
    let sql = "UPDATE token SET last_used = ?2, revoked = ?3 WHERE id = ?1";
    let is_over = found.purpose == TokenUse::Once;
    tx.run(sql, params![found.token, now, is_over])?;
    Ok(found.who)
}
