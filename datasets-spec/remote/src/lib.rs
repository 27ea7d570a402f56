//! Datasets and sources at URLs.
//!
//! [`Remote`] is a [`Store`](datasets_spec::store::Store) for `s3://`, `gs://` and `az://`, and a read-only one for
//! `http://`, `https://` and `hf://`. A program calls [`register`] once; from then on every path that is a URL is
//! served here. Credentials and endpoints come from the environment, as the format document says. Requests are
//! asynchronous and run on a runtime of this crate; callers block until they are answered. [`hub`] is a blocking client
//! of the Hugging Face hub, with its own connections.

mod cache;
mod client;
mod file;
pub mod hub;
mod place;
mod remote;
mod settings;

pub use self::remote::Remote;
pub use self::settings::Settings;

/// Serves all URLs of this process, with the settings that the environment names.
///
/// # Errors
/// A variable of the environment is malformed.
pub fn register() -> std::io::Result<()> {
    let settings = Settings::from_variables(|name| std::env::var_os(name))?;
    datasets_spec::store::register(std::sync::Arc::new(Remote::new(settings)));
    Ok(())
}
