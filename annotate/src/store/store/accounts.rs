//! Operations on settings, the capture plan and preferences, and on people with their tokens and sessions.

use std::sync::MutexGuard;

use super::Store;
use crate::Error;
use crate::lock::lock;
use crate::store::db::{Tx, params};
use crate::store::records::{IssuedToken, Millis, TokenUse, Who};
use crate::store::{captures, import, people, project};
use crate::wire::{PlannedCapture, Prefs, Role, Settings, TokenInfo, User};

impl Store {
    fn known(&self) -> MutexGuard<'_, people::Known> {
        lock(&self.known)
    }

    /// [`Self::write`] of users or tokens; clears the token cache.
    fn write_people<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut dyn Tx) -> Result<T, Error> + Send + 'static,
    ) -> Result<T, Error> {
        let outcome = self.write(work);
        self.known().clear();
        outcome
    }

    /// The settings.
    ///
    /// # Errors
    /// The store fails.
    pub fn settings(&self) -> Result<Settings, Error> {
        self.read(project::settings)
    }

    /// Changes the settings. A changed number of people is applied to all tasks that still want answers, some at
    /// a time.
    ///
    /// # Errors
    /// `invalid`; or the store fails.
    pub fn put_settings(&self, actor: i64, settings: Settings, now: Millis) -> Result<(), Error> {
        self.write(move |tx| project::put_settings(tx, Some(actor), settings, now))?;
        while !self.write(move |tx| import::retarget(tx, actor, now))? {}
        Ok(())
    }

    /// Replaces the capture plan. Its styles join those of the project.
    ///
    /// # Errors
    /// `invalid`; or the store fails.
    pub fn plan_captures(
        &self,
        actor: i64,
        cells: Vec<PlannedCapture>,
        now: Millis,
    ) -> Result<(), Error> {
        self.write(move |tx| captures::put_plan(tx, actor, cells, now))
    }

    /// A user's preferences.
    ///
    /// # Errors
    /// The store fails.
    pub fn prefs(&self, user: i64) -> Result<Prefs, Error> {
        self.read(move |tx| project::prefs(tx, user))
    }

    /// Changes a user's preferences.
    ///
    /// # Errors
    /// The store fails.
    pub fn put_prefs(&self, user: i64, prefs: Prefs) -> Result<(), Error> {
        self.write(move |tx| project::put_prefs(tx, user, &prefs))
    }

    /// All users.
    ///
    /// # Errors
    /// The store fails.
    pub fn users(&self) -> Result<Vec<User>, Error> {
        self.read(people::users)
    }

    /// Adds many users, each with a token, or none if a line is wrong.
    ///
    /// # Errors
    /// `invalid` names the line; or the store fails.
    pub fn add_users(
        &self,
        actor: Option<i64>,
        lines: &str,
        expires: Millis,
        now: Millis,
    ) -> Result<Vec<IssuedToken>, Error> {
        let new = people::parse_lines(lines)?;
        self.write_people(move |tx| people::add_all(tx, actor, &new, expires, now))
    }

    /// Adds a user.
    ///
    /// # Errors
    /// `invalid` for a bad or taken name; or the store fails.
    pub fn add_user(
        &self,
        actor: Option<i64>,
        name: &str,
        role: Role,
        now: Millis,
    ) -> Result<User, Error> {
        let name = name.to_owned();
        self.write_people(move |tx| people::add(tx, actor, &name, role, now))
    }

    /// Changes a user. The last active admin cannot be demoted or disabled.
    ///
    /// # Errors
    /// `invalid`, `not_found`; or the store fails.
    pub fn change_user(
        &self,
        actor: Option<i64>,
        user: i64,
        role: Option<Role>,
        active: Option<bool>,
        now: Millis,
    ) -> Result<User, Error> {
        self.write_people(move |tx| people::change(tx, actor, user, role, active, now))
    }

    /// Creates a token.
    ///
    /// # Errors
    /// `not_found`; or the store fails.
    pub fn issue(
        &self,
        user: i64,
        purpose: TokenUse,
        expires: Millis,
        now: Millis,
    ) -> Result<IssuedToken, Error> {
        self.write_people(move |tx| people::issue(tx, user, purpose, expires, now))
    }

    /// The user of a token, if it is valid for this purpose. A one-time token becomes invalid.
    ///
    /// # Errors
    /// `unauthenticated`; or the store fails.
    pub fn authenticate(
        &self,
        token: &str,
        purposes: &[TokenUse],
        now: Millis,
    ) -> Result<Who, Error> {
        let hash = people::hash(token);
        let changes = {
            let known = self.known();
            if let Some(who) = known.find(&hash, purposes, now) {
                return Ok(who);
            }
            known.changes()
        };
        let purposes = purposes.to_vec();
        let found = {
            let (hash, purposes) = (hash.clone(), purposes.clone());
            self.read(move |tx| people::find(tx, &hash, &purposes, now))?
        };
        if found.needs_note {
            return self.write(move |tx| people::used(tx, &hash, &purposes, now));
        }
        let who = found.who.clone();
        self.known().put(hash, found, changes, now);
        Ok(who)
    }

    /// [`Self::authenticate`] without a record of the use.
    ///
    /// # Errors
    /// `unauthenticated`; or the store fails.
    pub fn recognise(&self, token: &str, purposes: &[TokenUse], now: Millis) -> Result<Who, Error> {
        let (hash, purposes) = (people::hash(token), purposes.to_vec());
        self.read(move |tx| Ok(people::find(tx, &hash, &purposes, now)?.who))
    }

    /// Begins a session by a token, until a time or the end of the token.
    ///
    /// # Errors
    /// `unauthenticated`; or the store fails.
    pub fn log_in(
        &self,
        token: &str,
        until: Millis,
        now: Millis,
    ) -> Result<(Who, IssuedToken), Error> {
        let hash = people::hash(token);
        self.write_people(move |tx| people::log_in(tx, &hash, until, now))
    }

    /// A user's tokens.
    ///
    /// # Errors
    /// The store fails.
    pub fn tokens(&self, user: i64) -> Result<Vec<TokenInfo>, Error> {
        self.read(move |tx| people::tokens(tx, user))
    }

    /// Revokes a token.
    ///
    /// # Errors
    /// `not_found`; or the store fails.
    pub fn revoke(&self, token: i64) -> Result<(), Error> {
        self.write_people(move |tx| people::revoke(tx, token))
    }

    /// Revokes a session.
    ///
    /// # Errors
    /// The store fails.
    pub fn log_out(&self, token: &str) -> Result<(), Error> {
        let hash = people::hash(token);
        self.write_people(move |tx| {
            tx.execute(
                "UPDATE token SET revoked = 1 WHERE hash = ?1",
                params![&hash],
            )?;
            Ok(())
        })
    }
}
