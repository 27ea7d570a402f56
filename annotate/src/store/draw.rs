//! Pseudo-random draws that depend only on a key.

/// The pseudo-random number of a key, the same on every call and in a store opened again.
pub(super) fn draw(parts: &[&str]) -> u64 {
    datasets_spec::Seed(0).draw_u64(parts)
}

/// [`draw`] as a number from 0 to 99.
pub(super) fn percent(parts: &[&str]) -> u32 {
    (draw(parts) % 100) as u32
}
