//! The client of the Hugging Face hub, by which CLIP is found and fetched.

pub use remote_store::hub::{Hub, HubCache, read_checked};
