//! Opening datasets, and committing them so that they appear whole or not at all.
//!
//! A dataset is a folder: `data/<table>/<split>-<i>-of-<n>.parquet`, `meta/manifest-<n>.json`, and a `README.md` that
//! the Hugging Face `datasets` library reads. A run locks the folder, writes its files aside, syncs them, writes the
//! manifest, and then moves these files to their places and the replaced files of the previous version aside. A reader
//! sees either the previous or the new version, never a mixture.
//!
//! A dataset may also lie at a URL. Object stores have no locks: there a run never overwrites a data file, and it
//! commits by writing the manifest, which fails if another run has written that version.

mod commit;
mod layout;
mod open;
mod shards;
mod staging;
#[cfg(test)]
mod tests;
mod tidy;
mod transaction;

pub use commit::{commit_rows, commit_table, refuse_others};
pub use layout::{PRIVATE, ShardName};
pub use open::Dataset;
pub use shards::{SHARD_ROWS, table_facts};
pub use staging::Staging;
pub use tidy::{Pruned, descriptions, prunable};
pub use transaction::{Commit, Transaction};
