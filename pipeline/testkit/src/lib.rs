//! Shared fixtures of the tests of several crates: synthetic motions with their rows, and small files.

mod files;
mod motions;
mod real;
mod releases;

pub use files::{npy, npy_f8, npz};
pub use motions::{SPAN, commit, mask_row, motion_row, pair_row, rows, walk, wandering};
pub use real::test_data;
pub use releases::{adjustment, clip_members, dictionary, put, swinging, write_release};
