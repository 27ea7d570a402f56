//! The Hugging Face hub: its local cache, downloads, and pushing and pulling of repos.
//!
//! The requests are our own, on ureq. The crate `hf-hub` 1.0 brings an asynchronous client and some dozens of crates
//! with it, and 0.5 cannot upload and verifies no checksum. The requests and their order follow the Python client
//! (`huggingface_hub` 2.4, over LFS).
//!
//! Read [`Hub`] first, then [`Push`] and [`pull()`]. [`HubCache`] is the folder of Hugging Face's own tools.

mod cache;
mod checksum;
mod client;
mod content;
mod datasets;
mod download;
mod error;
mod lfs;
mod pull;
mod push;
mod repo;

pub use self::cache::HubCache;
pub use self::checksum::read_checked;
pub use self::client::{Hub, token_from_variables};
pub use self::content::{Content, HubFile, files_below};
pub(crate) use self::datasets::{beside, dataset_path};
pub use self::error::Error;
pub use self::pull::{Pulled, Staged, manifest_version, pull};
pub use self::push::{Push, PushOptions, Pushed};
pub use self::repo::{Repo, RepoKind, RepoName, kind_of};

#[cfg(test)]
mod tests;
