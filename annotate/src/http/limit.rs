//! Rate limits.

use std::collections::HashMap;
use std::sync::Mutex;

use crate::Error;
use crate::lock::lock;
use crate::store::Millis;
use crate::wire::{Code, Problem};

const MINUTE: Millis = 60_000;
/// Maximum number of client addresses tracked.
const MAX_CLIENTS: usize = 10_000;

/// Times of the requests of the last minute, by action and client.
#[derive(Debug, Default)]
pub(crate) struct Limiter {
    seen: Mutex<HashMap<(&'static str, String), Vec<Millis>>>,
}

impl Limiter {
    /// Counts one request of `who`, of which `most` are allowed per minute.
    ///
    /// # Errors
    /// `rate_limited`, with the time to wait.
    pub(crate) fn count(
        &self,
        what: &'static str,
        who: &str,
        most: u32,
        now: Millis,
    ) -> Result<(), Error> {
        let mut seen = lock(&self.seen);
        if seen.len() > MAX_CLIENTS {
            seen.retain(|_, times| times.last().is_some_and(|&last| now - last < MINUTE));
        }
        let times = seen.entry((what, who.to_owned())).or_default();
        // Drop times after `now`: the clock was set back, and they would count for too long.
        times.retain(|&at| (0..MINUTE).contains(&(now - at)));
        if times.len() >= most as usize {
            let wait = times.first().map_or(MINUTE, |&first| first + MINUTE - now);
            let seconds = u64::try_from(wait).unwrap_or(0).div_ceil(1000).max(1);
            let detail = format!("more than {most} {what} per minute; wait {seconds} s");
            let mut problem = Problem::new(Code::RateLimited, detail);
            problem.retry_after_secs = Some(seconds);
            return Err(Error::Refused(Box::new(problem)));
        }
        times.push(now);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_minute_later_there_is_room_again() {
        let limiter = Limiter::default();
        let count = |who: &str, most, now| limiter.count("logins", who, most, now);
        for now in 0..10 {
            count("a", 10, now).expect("room");
        }
        let error = count("a", 10, 30_000).expect_err("too many");
        assert_eq!(error.problem().retry_after_secs, Some(30));
        count("b", 10, 30_000).expect("somebody else");
        count("a", 10, 60_000).expect("room again");
        // A clock that is set back does not lock anybody out.
        count("a", 1, -1_000_000).expect("room");
    }
}
