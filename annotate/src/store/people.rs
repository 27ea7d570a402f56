//! Users, tokens and sessions. Tokens are stored as hashes.

use std::collections::HashMap;

use sha2::{Digest, Sha256};

use super::db::{Row, Tx, params};
use super::entry::{Body, Entry};
use super::records::{IssuedToken, Millis, TokenUse, Who};
use super::{leases, log};
use crate::Error;
use crate::wire::{Code, Role, TokenInfo, User};

/// Random bytes of a token.
const TOKEN_BYTES: usize = 32;
/// Minimum interval between updates of a token's last use.
const NOTE_EVERY: Millis = 60_000;

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// SHA-256 of a token, hexadecimal.
pub(super) fn hash(token: &str) -> String {
    hex(&Sha256::digest(token.trim().as_bytes()))
}

/// Random bytes, hexadecimal.
pub(super) fn random<const BYTES: usize>() -> Result<String, Error> {
    let mut bytes = [0; BYTES];
    getrandom::fill(&mut bytes)
        .map_err(|error| std::io::Error::other(error.to_string()))
        .map_err(datasets_spec::Error::io(
            "read random bytes from",
            "the operating system",
        ))?;
    Ok(hex(&bytes))
}

fn new_token() -> Result<String, Error> {
    Ok(format!("ann_{}", random::<TOKEN_BYTES>()?))
}

fn read_user(row: &Row) -> Result<User, Error> {
    Ok(User {
        id: row.int(0)?,
        name: row.string(1)?,
        role: role(row.text(2)?)?,
        active: row.flag(3)?,
    })
}

fn role(text: &str) -> Result<Role, Error> {
    Role::parse(text).ok_or_else(|| Error::Row {
        table: "usr",
        problem: format!("role {text:?} is not known"),
    })
}

pub(super) fn users(tx: &mut dyn Tx) -> Result<Vec<User>, Error> {
    tx.query("SELECT id, name, role, active FROM usr ORDER BY id", &[])?
        .iter()
        .map(read_user)
        .collect()
}

fn user(tx: &mut dyn Tx, id: i64) -> Result<User, Error> {
    let row = tx.one(
        "SELECT id, name, role, active FROM usr WHERE id = ?1",
        params![id],
    )?;
    read_user(&row.ok_or_else(|| Error::not_found("user"))?)
}

fn logged(tx: &mut dyn Tx, actor: Option<i64>, user: &User, now: Millis) -> Result<(), Error> {
    let entry = Entry {
        at: now,
        actor,
        task: None,
        epoch: None,
        body: Body::RoleChanged {
            user: user.id,
            name: user.name.clone(),
            role: user.role,
            active: user.active,
        },
    };
    log::note(tx, &entry)?;
    Ok(())
}

pub(super) fn add(
    tx: &mut dyn Tx,
    actor: Option<i64>,
    name: &str,
    role: Role,
    now: Millis,
) -> Result<User, Error> {
    let name = name.trim();
    let bad = |c: char| c.is_control();
    if name.is_empty() || name.chars().count() > 64 || name.chars().any(bad) {
        return Err(Error::invalid(
            "name",
            "a name must have 1 to 64 characters and no control characters",
        ));
    }
    if tx
        .one("SELECT 1 FROM usr WHERE name = ?1", params![name])?
        .is_some()
    {
        return Err(Error::invalid(
            "name",
            format!("there is a user {name:?} already; choose another name"),
        ));
    }
    let id = 1 + tx.number("SELECT COALESCE(MAX(id), 0) FROM usr", &[])?;
    tx.execute(
        "INSERT INTO usr (id, name, role, active, created) VALUES (?1, ?2, ?3, 1, ?4)",
        params![id, name, role.as_str(), now],
    )?;
    let user = User {
        id,
        name: name.to_owned(),
        role,
        active: true,
    };
    logged(tx, actor, &user, now)?;
    Ok(user)
}

pub(super) fn change(
    tx: &mut dyn Tx,
    actor: Option<i64>,
    id: i64,
    role: Option<Role>,
    active: Option<bool>,
    now: Millis,
) -> Result<User, Error> {
    let before = user(tx, id)?;
    let after = User {
        role: role.unwrap_or(before.role),
        active: active.unwrap_or(before.active),
        ..before.clone()
    };
    let is_admin = |user: &User| user.active && user.role == Role::Admin;
    if is_admin(&before) && !is_admin(&after) {
        let others = tx.number(
            "SELECT COUNT(*) FROM usr WHERE role = 'admin' AND active = 1 AND id <> ?1",
            params![id],
        )?;
        if others == 0 {
            return Err(Error::invalid(
                "role",
                "this is the last admin; add another one first",
            ));
        }
    }
    tx.execute(
        "UPDATE usr SET role = ?2, active = ?3 WHERE id = ?1",
        params![id, after.role.as_str(), after.active],
    )?;
    if !after.active {
        tx.execute("UPDATE token SET revoked = 1 WHERE usr = ?1", params![id])?;
        leases::end_all(tx, id, actor, now)?;
    }
    logged(tx, actor, &after, now)?;
    Ok(after)
}

pub(super) fn issue(
    tx: &mut dyn Tx,
    id: i64,
    purpose: TokenUse,
    expires: Millis,
    now: Millis,
) -> Result<IssuedToken, Error> {
    let user = user(tx, id)?;
    if !user.active {
        return Err(Error::invalid(
            "user",
            "this user is not active; activate them first",
        ));
    }
    let token = new_token()?;
    let id = 1 + tx.number("SELECT COALESCE(MAX(id), 0) FROM token", &[])?;
    tx.execute(
        "INSERT INTO token (id, usr, hash, purpose, created, expires, last_used, revoked)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, NULL, 0)",
        params![id, user.id, hash(&token), purpose.as_str(), now, expires],
    )?;
    Ok(IssuedToken {
        user,
        id,
        token,
        expires,
    })
}

/// Users that one request can add.
const MAX_LINES: usize = 1000;

/// Reads users from lines of a name, or of a name and a role parted by a comma, a semicolon or a tab. Empty lines
/// and a heading `name,role` are passed over.
pub(super) fn parse_lines(text: &str) -> Result<Vec<(usize, String, Role)>, Error> {
    let mut users = Vec::new();
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
    if users.is_empty() || users.len() > MAX_LINES {
        return Err(Error::invalid(
            "lines",
            format!("write 1 to {MAX_LINES} lines, each a name or NAME,ROLE"),
        ));
    }
    Ok(users)
}

/// Adds users with a token each.
pub(super) fn add_all(
    tx: &mut dyn Tx,
    actor: Option<i64>,
    users: &[(usize, String, Role)],
    expires: Millis,
    now: Millis,
) -> Result<Vec<IssuedToken>, Error> {
    users
        .iter()
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
}

/// Owner of a token.
#[derive(Clone)]
pub(super) struct Found {
    pub(super) who: Who,
    purpose: String,
    expires: Millis,
    token: i64,
    once: bool,
    /// Whether to update its last use.
    pub(super) needs_note: bool,
}

/// Lifetime of a cached token. A token revoked through another server stays valid here for at most this long.
const KNOWN_FOR: Millis = 1000;
/// Maximum number of cached tokens.
const MOST_KNOWN: usize = 4096;

/// Cache of recently used tokens. Every change of users or tokens clears it.
#[derive(Default)]
pub(super) struct Known {
    by_hash: HashMap<String, (Millis, Found)>,
    changes: u64,
}

impl Known {
    /// Clears the cache.
    pub(super) fn clear(&mut self) {
        self.by_hash.clear();
        self.changes += 1;
    }

    /// Number of clears. A lookup that began before a clear must not be stored after it.
    pub(super) fn changes(&self) -> u64 {
        self.changes
    }

    pub(super) fn find(&self, hash: &str, purposes: &[TokenUse], now: Millis) -> Option<Who> {
        let (at, found) = self.by_hash.get(hash)?;
        let is_fresh = (0..KNOWN_FOR).contains(&(now - at)) && now < found.expires;
        let fits = purposes.iter().any(|use_| use_.as_str() == found.purpose);
        (is_fresh && fits).then(|| found.who.clone())
    }

    pub(super) fn put(&mut self, hash: String, found: Found, changes: u64, now: Millis) {
        if found.needs_note || changes != self.changes {
            return;
        }
        if self.by_hash.len() >= MOST_KNOWN {
            self.by_hash.clear();
        }
        self.by_hash.insert(hash, (now, found));
    }
}

pub(super) fn find(
    tx: &mut dyn Tx,
    hash: &str,
    purposes: &[TokenUse],
    now: Millis,
) -> Result<Found, Error> {
    let refused = || {
        Error::refused(
            Code::Unauthenticated,
            "this token is unknown, revoked or expired; ask an admin for a new one",
        )
    };
    let row = tx
        .one(
            "SELECT k.id, k.purpose, k.expires, k.last_used, u.id, u.name, u.role
             FROM token k JOIN usr u ON u.id = k.usr
             WHERE k.hash = ?1 AND k.revoked = 0 AND u.active = 1",
            params![hash],
        )?
        .ok_or_else(refused)?;
    let purpose = row.text(1)?;
    let once = purpose == TokenUse::Once.as_str();
    let fits = purposes.iter().any(|allowed| allowed.as_str() == purpose);
    if !fits || row.int(2)? <= now {
        return Err(refused());
    }
    let last_used = row.opt_int(3)?;
    Ok(Found {
        who: Who {
            id: row.int(4)?,
            name: row.string(5)?,
            role: role(row.text(6)?)?,
        },
        purpose: purpose.to_owned(),
        expires: row.int(2)?,
        token: row.int(0)?,
        once,
        needs_note: once || last_used.is_none_or(|at| now - at > NOTE_EVERY),
    })
}

/// [`find`], and records the use. A one-time token becomes invalid.
pub(super) fn used(
    tx: &mut dyn Tx,
    hash: &str,
    purposes: &[TokenUse],
    now: Millis,
) -> Result<Who, Error> {
    let found = find(tx, hash, purposes, now)?;
    tx.execute(
        "UPDATE token SET last_used = ?2, revoked = ?3 WHERE id = ?1",
        params![found.token, now, found.once],
    )?;
    Ok(found.who)
}

/// Begins a session that ends with the token it was begun by. A one-time token only opens the door: its session
/// lasts as long as any.
pub(super) fn log_in(
    tx: &mut dyn Tx,
    hash: &str,
    until: Millis,
    now: Millis,
) -> Result<(Who, IssuedToken), Error> {
    let purposes = [TokenUse::Token, TokenUse::Once];
    let found = find(tx, hash, &purposes, now)?;
    let until = if found.once {
        until
    } else {
        until.min(found.expires)
    };
    let who = used(tx, hash, &purposes, now)?;
    let session = issue(tx, who.id, TokenUse::Session, until, now)?;
    Ok((who, session))
}

pub(super) fn tokens(tx: &mut dyn Tx, user: i64) -> Result<Vec<TokenInfo>, Error> {
    tx.query(
        "SELECT id, usr, created, expires, last_used, revoked FROM token
         WHERE usr = ?1 AND purpose <> 'session' ORDER BY id",
        params![user],
    )?
    .iter()
    .map(|row| {
        Ok(TokenInfo {
            id: row.int(0)?,
            user: row.int(1)?,
            created: row.int(2)?,
            expires: row.int(3)?,
            last_used: row.opt_int(4)?,
            revoked: row.flag(5)?,
        })
    })
    .collect()
}

/// Revokes a token and all sessions of its owner: a thief of the token may have opened some.
pub(super) fn revoke(tx: &mut dyn Tx, id: i64) -> Result<(), Error> {
    let row = tx.one("SELECT usr FROM token WHERE id = ?1", params![id])?;
    let user = row.ok_or_else(|| Error::not_found("token"))?.int(0)?;
    tx.execute("UPDATE token SET revoked = 1 WHERE id = ?1", params![id])?;
    tx.execute(
        "UPDATE token SET revoked = 1 WHERE usr = ?1 AND purpose = 'session'",
        params![user],
    )?;
    Ok(())
}
