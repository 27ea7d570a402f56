//! Masks, descriptions and pair judgements by people: a server, its store, and its front end.
//!
//! [`http::Server`] serves the pages and the interface of `API.md` over a [`store::Store`], which keeps a
//! log that only grows and tables that follow from it. [`transfer`] brings tasks in from a dataset and
//! accepted answers out of it. All mathematics of motion comes from `datasets-spec` and
//! `pipeline::compose` ([`motions`]); the browser only draws.
//!
//! Beside the server there are lines for those who prefer an editor: [`drafts`] writes masks as JSON
//! lines, [`accept`] takes the judged lines back.
//!
//! This crate reads no environment and no clock: addresses, keys and times are given to it. Tokens are
//! the one thing drawn from the operating system's generator, as they have to be.
//!
//! Read [`store::Store`] and [`wire`] first.

pub mod agreement;
pub mod answer;
mod error;
pub mod http;
mod jobs;
mod lines;
pub mod model;
pub mod motions;
mod quality;
pub mod state;
pub mod store;
pub mod transfer;
pub mod wire;

pub use error::Error;
pub use jobs::log_export;
pub use lines::{Finding, Judgement, Verdict, accept, drafts, to_json_lines};
