//! Settings from the environment.

use std::ffi::OsString;
use std::io;
use std::path::PathBuf;

use datasets_spec::cache;

use crate::hub::HubCache;

/// Settings for serving URLs.
#[derive(Clone, Debug, Default)]
pub struct Settings {
    /// Folder and maximum size in bytes of the local cache; `None` for no cache.
    pub cache: Option<(PathBuf, u64)>,
    /// How often a request that fails temporarily is repeated.
    pub retries: usize,
    /// Cache of Hugging Face's tools, if there is one.
    pub hub: Option<HubCache>,
}

/// Default size of the cache in bytes.
const CACHE_SIZE: u64 = 10_000_000_000;
/// Default number of repetitions. Their waits double from a tenth of a second, and sum up to about 25 seconds.
const RETRIES: usize = 8;

impl Settings {
    /// The settings that variables of the environment name: `STANCE_CACHE`, `STANCE_REMOTE_CACHE_SIZE`,
    /// `STANCE_REMOTE_RETRIES`, and those of Hugging Face's tools.
    ///
    /// # Errors
    /// A variable is malformed.
    pub fn from_variables(variable: impl Fn(&str) -> Option<OsString>) -> io::Result<Self> {
        let text = |name: &str| variable(name).map(|value| value.to_string_lossy().into_owned());
        let malformed = |name: &str, expected: &str, found: &str| {
            let text = format!("{name} must be {expected}, found {found:?}");
            io::Error::new(io::ErrorKind::InvalidInput, text)
        };
        let size = match text("STANCE_REMOTE_CACHE_SIZE") {
            None => CACHE_SIZE,
            Some(found) => cache::parse_bytes(&found).ok_or_else(|| {
                malformed(
                    "STANCE_REMOTE_CACHE_SIZE",
                    "a size such as 500MB or 20GB, or 0",
                    &found,
                )
            })?,
        };
        let retries = match text("STANCE_REMOTE_RETRIES") {
            None => RETRIES,
            Some(found) => found
                .parse()
                .map_err(|_| malformed("STANCE_REMOTE_RETRIES", "a count", &found))?,
        };
        Ok(Self {
            cache: (size > 0)
                .then(|| cache::folder(&variable))
                .flatten()
                .map(|folder| (folder, size)),
            retries,
            hub: HubCache::from_variables(&variable),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(variables: &[(&str, &str)]) -> io::Result<Settings> {
        Settings::from_variables(|name| {
            let found = variables.iter().find(|(known, _)| *known == name);
            found.map(|(_, value)| OsString::from(value))
        })
    }

    #[test]
    fn the_environment_names_the_cache_and_its_size() {
        let plain = settings(&[("HOME", "/home/a")]).expect("settings");
        let folder = "/home/a/.cache/stance".into();
        assert_eq!(plain.cache, Some((folder, CACHE_SIZE)));
        let own = [
            ("STANCE_CACHE", "/c"),
            ("STANCE_REMOTE_CACHE_SIZE", "500 MB"),
            ("HOME", "/home/a"),
        ];
        let own = settings(&own).expect("settings");
        assert_eq!(own.cache, Some(("/c".into(), 500_000_000)));
        let off =
            settings(&[("HOME", "/home/a"), ("STANCE_REMOTE_CACHE_SIZE", "0")]).expect("settings");
        assert_eq!(off.cache, None);
        for (name, value) in [
            ("STANCE_REMOTE_CACHE_SIZE", "much"),
            ("STANCE_REMOTE_RETRIES", "-1"),
        ] {
            let error = settings(&[(name, value)]).expect_err("malformed");
            assert!(error.to_string().contains(name), "{error}");
        }
    }
}
