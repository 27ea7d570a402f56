//! Clocks, and the days and weeks of a project in its time zone.

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use jiff::tz::TimeZone;
use jiff::{Timestamp, ToSpan};

use crate::Error;
use crate::lock::lock;
use crate::store::Millis;

/// Returns the current time in milliseconds since the epoch. It may read the database, so it is called where threads may
/// block, never in a future.
pub type Clock = Arc<dyn Fn() -> Millis + Send + Sync>;

/// Milliseconds of 24 hours.
pub(crate) const DAY: Millis = 24 * 60 * 60 * 1000;

/// Whether this is the name of a time zone, such as `Europe/Berlin`.
pub(crate) fn is_zone(name: &str) -> bool {
    TimeZone::get(name).is_ok()
}

/// Start of the current day in a time zone, or in UTC if the zone is no longer known.
pub(crate) fn midnight(zone: &str, now: Millis) -> Millis {
    let begun = TimeZone::get(zone).and_then(|zone| {
        Timestamp::from_millisecond(now)?
            .to_zoned(zone)
            .start_of_day()
    });
    begun.map_or(now - now.rem_euclid(DAY), |begun| {
        begun.timestamp().as_millisecond()
    })
}

/// Starts of the last `count` weeks in a time zone, oldest first, and the end of the current week. Weeks start on
/// Mondays. A zone that is no longer known counts as UTC.
pub(crate) fn weeks(zone: &str, now: Millis, count: i64) -> Vec<Millis> {
    let zone = TimeZone::get(zone).unwrap_or(TimeZone::UTC);
    let today = Timestamp::from_millisecond(now)
        .unwrap_or_default()
        .to_zoned(zone.clone())
        .date();
    let monday = today.saturating_sub(i64::from(today.weekday().to_monday_zero_offset()).days());
    (1 - count..=1)
        .map(|week| {
            let begun = monday.saturating_add(week.weeks()).to_zoned(zone.clone());
            begun.map_or(now, |begun| begun.timestamp().as_millisecond())
        })
        .collect()
}

/// How often the time of a shared store is read. Between reads, the monotonic clock of this machine is used; it drifts
/// by less than a millisecond and cannot be set.
const READ_EVERY: Duration = Duration::from_secs(10);

/// The clock of a store that several servers share, read with `read`. While reading fails, the clock counts on from the
/// last reading.
///
/// # Errors
/// The first reading fails.
pub(crate) fn shared(
    read: impl Fn() -> Result<Millis, Error> + Send + Sync + 'static,
) -> Result<Clock, Error> {
    let last = Mutex::new((Instant::now(), read()?));
    Ok(Arc::new(move || {
        let mut last = lock(&last);
        if last.0.elapsed() >= READ_EVERY
            && let Ok(time) = read()
        {
            *last = (Instant::now(), time);
        }
        last.1 + i64::try_from(last.0.elapsed().as_millis()).unwrap_or(0)
    }))
}

#[cfg(test)]
mod tests {
    use super::{DAY, is_zone, midnight, shared, weeks};
    use crate::Error;

    const HOUR: i64 = 60 * 60 * 1000;
    /// 2026-03-29 00:00 UTC.
    const SUMMER_TIME_DAY: i64 = 1_774_742_400_000;

    #[test]
    fn days_and_weeks_begin_at_the_midnight_of_the_place() {
        const NOON: i64 = SUMMER_TIME_DAY + 12 * HOUR;
        for (zone, now, begin) in [
            ("UTC", NOON, 0),
            ("Europe/Berlin", NOON, -HOUR),
            ("Asia/Tokyo", NOON, -9 * HOUR),
            // In Tokyo the next day has begun.
            ("Asia/Tokyo", SUMMER_TIME_DAY + 16 * HOUR, 15 * HOUR),
            // Summer time began on the day before, which had 23 hours.
            ("Europe/Berlin", NOON + DAY, 22 * HOUR),
            ("Mars/Olympus", SUMMER_TIME_DAY + 1, 0),
        ] {
            assert_eq!(midnight(zone, now), SUMMER_TIME_DAY + begin, "{zone}");
        }
        let monday = SUMMER_TIME_DAY - 6 * DAY;
        let next = monday + 7 * DAY;
        assert_eq!(weeks("UTC", NOON, 2), [monday - 7 * DAY, monday, next]);
        // Summer time begins on the Sunday of this week, which has an hour less.
        let of_berlin = [monday - HOUR, next - 2 * HOUR];
        assert_eq!(weeks("Europe/Berlin", NOON, 1), of_berlin);
        // In Tokyo the next week has begun.
        let sunday_evening = SUMMER_TIME_DAY + 20 * HOUR;
        assert_eq!(weeks("Asia/Tokyo", sunday_evening, 1)[0], next - 9 * HOUR);
        assert!(is_zone("UTC") && is_zone("America/New_York"));
        assert!(!is_zone("") && !is_zone("Mars/Olympus"));
    }

    #[test]
    fn a_shared_clock_counts_on_from_what_it_read() {
        let clock = shared(|| Ok(5000)).expect("a reading");
        let first = clock();
        assert!((5000..65_000).contains(&first), "{first}");
        assert!(clock() >= first);
        assert!(shared(|| Err(Error::Closed)).is_err());
    }
}
