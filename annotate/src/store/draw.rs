//! Pseudo-random draws that depend only on a key.

use crate::wire::Settings;

/// The pseudo-random number of a key, the same on every call and in a store opened again.
pub(super) fn draw(parts: &[&str]) -> u64 {
    datasets_spec::Seed(0).draw_u64(parts)
}

/// [`draw`] as a number from 0 to 99.
pub(super) fn percent(parts: &[&str]) -> u32 {
    (draw(parts) % 100) as u32
}

/// Number of people who must answer a task. The tasks of a bundle go to the same people.
pub(super) fn wanted(settings: &Settings, key: &str, bundle: Option<i64>) -> u32 {
    let group = bundle.map_or_else(|| key.to_owned(), |bundle| bundle.to_string());
    if percent(&["overlap", &group]) < settings.overlap_percent {
        settings.answers_per_task
    } else {
        1
    }
}

/// Whether a user answers a task without suggestions.
pub(super) fn is_blind(settings: &Settings, key: &str, user: i64) -> bool {
    percent(&["blind", key, &user.to_string()]) < settings.blind_percent
}
