//! Masks, descriptions and pair judgements by people: a server, its store, and its front end.
//!
//! [`http::Server`] serves the pages and the API of `API.md`. Its [`store::Store`] keeps an append-only log
//! and tables derived from it. [`transfer`] imports tasks from a dataset and exports
//! accepted answers to it. Computations on motion come from `kinematics` and `compose`
//! ([`motions`]); the browser only draws.
//!
//! Masks can also be reviewed without a browser: [`drafts`] writes them as JSON lines, [`accept`] reads
//! the judged lines back.
//!
//! This crate reads no environment and no clock: the caller passes addresses, keys and times. Only tokens come from the
//! operating system's random generator.
//!
//! Read [`store::Store`] and [`wire`] first.
//!
//! ```
//! use annotate::store::{NewTask, open_sqlite};
//! use annotate::wire::{NewEvent, Role, TaskKind};
//! use serde_json::{from_value, json};
//!
//! let folder = tempfile::tempdir()?;
//! let store = open_sqlite(&folder.path().join("store.sqlite"))?;
//! let now = 0;
//! let ann = store.add_user(None, "ann", Role::Annotator, now)?;
//! // Tasks come from a dataset (`transfer::from_dataset`), or are made by hand.
//! let task: NewTask = from_value(json!({
//!     "key": "clip-1", "kind": "mask_text", "source": "HASH", "split": "train",
//!     "bundle_index": 0, "priority": 0, "suggestions": [],
//! }))?;
//! store.import(None, vec![task], now)?;
//! let Ok((detail, _)) = store.claim(ann.id, TaskKind::MaskText, 0, now)? else {
//!     panic!("there is a task");
//! };
//! let lease = detail.lease.expect("a claim gives a lease");
//! let mask = |part: &str| json!({"parts": [part], "text": "The arm waves."});
//! let submit: NewEvent = from_value(json!({
//!     "idem_key": "submit-0001", "kind": "submit", "lease_epoch": lease.epoch,
//!     "answer": {"kind": "mask_text", "masks": [mask("LEFT_ARM"), mask("RIGHT_ARM")]},
//! }))?;
//! let results = store.append(ann.id, lease.task, vec![submit], now)?;
//! assert_eq!(results[0].status, 200);
//! assert_eq!(store.labels_to(vec![lease.task])?.len(), 1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod activity;
mod agreement;
mod answer;
mod body;
mod clock;
pub mod drafting;
mod error;
mod groups;
pub mod http;
mod jobs;
mod lines;
mod lock;
mod mask;
pub mod model;
pub mod motions;
mod quality;
pub mod state;
pub mod store;
pub mod transfer;
pub mod wire;

pub use error::Error;
pub use lines::{Finding, Taken, accept, drafts};
