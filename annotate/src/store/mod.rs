//! The store of tasks, answers and people, on SQLite or PostgreSQL.
//!
//! Every change of a task is an entry of the append-only log (`event`). The tables of `projections.sql` are projections
//! of the log: each entry is applied to them in the transaction that writes it, and [`Store::rebuild`] derives them
//! again.
//!
//! The operations of [`Store`] are in the module of their kind: `claim` (who gets which task), `leases`, `append`
//! (drafts, submissions, skips), `review`, `rules` (acceptance without a reviewer), `browse` (the task browser) with
//! `filter`, `bulk` (actions on many tasks), `home`, `mine`, `work`, `captures` (the capture plan), `import`, `people`,
//! `jobs` and `pictures`; `read` holds queries, `project` the settings, preferences, motions and suggestions, `clips` what
//! becomes of tasks whose clip changes. `apply`
//! writes the projections, `db` is the common interface of both databases, and `pool` holds the connections.

mod append;
mod apply;
mod backup;
mod browse;
mod bulk;
mod captures;
mod claim;
mod clips;
mod columns;
pub(crate) mod db;
mod derived;
mod draw;
mod entry;
mod filter;
mod home;
mod import;
mod jobs;
mod leases;
mod log;
mod migrate;
mod mine;
mod people;
mod pictures;
mod pool;
#[cfg(feature = "postgres")]
mod postgres;
#[cfg(feature = "postgres")]
mod postgres_address;
mod project;
mod projections;
mod read;
mod rebuild;
mod records;
mod review;
mod rows;
mod rules;
mod settings;
mod sqlite;
#[expect(
    clippy::module_inception,
    reason = "the type the module is named after"
)]
mod store;
mod work;

use std::path::Path;
use std::sync::Arc;

use db::Result;

pub use backup::{back_up, backup_is_due};
pub use browse::{DecisionQuery, PageQuery};
pub(crate) use people::sha256;
pub use records::{
    AcceptedAnswer, AuditFilter, BundleEntry, Credit, Imported, IssuedToken, KeyRange, Label,
    Millis, MineQuery, MotionRecord, NewSuggestion, NewTask, Reject, ReviewDetail, ShelfFilter,
    TaskDetail, TaskRecord, TokenUse, Who,
};
pub use store::{Store, Upgrade};

/// Opens the store in a file, or creates it. A store of an older version is upgraded after a copy of it was made
/// ([`Store::upgrade`]).
///
/// # Errors
/// The file cannot be opened, is of a newer version, or lies on a network file system.
pub fn open_sqlite(path: &Path) -> Result<Arc<Store>> {
    let (db, upgrade) = sqlite::open(path)?;
    Ok(Arc::new(Store::new(Box::new(db), upgrade)))
}

/// Opens a store on PostgreSQL, creating its tables in the schema if there are none and `may_create` is set. A store of
/// an older version is copied, then upgraded ([`Store::upgrade`]).
///
/// # Errors
/// The server cannot be reached, or its tables are of a newer version. [`Error::Missing`](crate::Error::Missing) if
/// there is no store and none may be created.
#[cfg(feature = "postgres")]
pub fn open_postgres(url: &str, schema: &str, may_create: bool) -> Result<Arc<Store>> {
    let (db, upgrade) = postgres::open(url, schema, may_create)?;
    Ok(Arc::new(Store::new(Box::new(db), upgrade)))
}
