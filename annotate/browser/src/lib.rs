//! Fixtures of the browser tests: a server, a Chromium, and functions for keyboard actions.
//!
//! The tests run the built `stance` command (`STANCE_BIN`) and Debian's Chromium with its driver. Each test has its
//! own data folder, server port and browser profile, so they run in any order and in parallel.

mod browser;
mod requests;
mod server;
mod waits;

pub use browser::{Browser, Graphics, keys};
pub use server::{Dataset, Server, report_page};
