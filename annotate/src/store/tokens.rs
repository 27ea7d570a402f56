//! Cache of tokens.

use std::collections::HashMap;

use super::records::{Millis, TokenUse, Who};

/// Owner of a token.
#[derive(Clone)]
pub(super) struct Found {
    pub(super) who: Who,
    pub(super) purpose: TokenUse,
    pub(super) expires: Millis,
    pub(super) token: i64,
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
    /// Number of clears. A lookup that began before a clear must not be stored after it.
    pub(super) changes: u64,
}

impl Known {
    /// Clears the cache.
    pub(super) fn clear(&mut self) {
        self.by_hash.clear();
        self.changes += 1;
    }

    pub(super) fn find(&self, hash: &str, purposes: &[TokenUse], now: Millis) -> Option<Who> {
        let (at, found) = self.by_hash.get(hash)?;
        let is_fresh = (0..KNOWN_FOR).contains(&(now - at)) && now < found.expires;
        let fits = purposes.contains(&found.purpose);
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
