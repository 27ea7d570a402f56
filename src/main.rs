//! stance.
fn main() {}
