//! Bucket and key of a URL.

use std::io;
use std::path::{Path, PathBuf};

use object_store::path::Path as Key;

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Place {
    pub(crate) scheme: Scheme,
    /// Scheme and bucket, such as `s3://clips`.
    pub(crate) root: String,
    /// Bucket, container, or host and port.
    pub(crate) authority: String,
    pub(crate) key: Key,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scheme {
    S3,
    Gcs,
    Azure,
    Http,
    Hub,
}

impl Place {
    pub(crate) fn parse(path: &Path) -> io::Result<Self> {
        let malformed = |reason: String| {
            let text = format!("{} is no URL that can be used: {reason}", path.display());
            io::Error::new(io::ErrorKind::InvalidInput, text)
        };
        let text = path
            .to_str()
            .ok_or_else(|| malformed("it is no UTF-8".to_owned()))?;
        // On Windows, joined paths contain backslashes.
        let text = if cfg!(windows) {
            text.replace('\\', "/")
        } else {
            text.to_owned()
        };
        let (name, rest) = text.split_once("://").unwrap_or(("", &text));
        let scheme = match name {
            "s3" => Scheme::S3,
            "gs" => Scheme::Gcs,
            "az" => Scheme::Azure,
            "http" | "https" => Scheme::Http,
            "hf" => Scheme::Hub,
            _ => {
                let known = "s3, gs, az, http, https and hf are known";
                return Err(malformed(format!("of the schemes {known}, not {name:?}")));
            }
        };
        let (authority, key) = rest.split_once('/').unwrap_or((rest, ""));
        if authority.is_empty() {
            return Err(malformed("it names no bucket or host".to_owned()));
        }
        let key = match scheme {
            Scheme::Http if key.contains(['?', '#']) => {
                return Err(malformed("a query or fragment is not supported".to_owned()));
            }
            Scheme::Http => Key::from_url_path(key),
            _ => Key::parse(key),
        };
        Ok(Self {
            scheme,
            root: format!("{name}://{authority}"),
            authority: authority.to_owned(),
            key: key.map_err(|error| malformed(error.to_string()))?,
        })
    }

    /// The URL of a key of this bucket.
    pub(crate) fn url(&self, key: &Key) -> PathBuf {
        match key.as_ref() {
            "" => PathBuf::from(&self.root),
            key => PathBuf::from(format!("{}/{key}", self.root)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(url: &str) -> Place {
        Place::parse(Path::new(url)).expect(url)
    }

    #[test]
    fn urls_name_buckets_and_keys() {
        let url = "s3://clips/set/data/train-0.parquet";
        let clips = place(url);
        assert_eq!(clips.scheme, Scheme::S3);
        assert_eq!(clips.root.as_str(), "s3://clips");
        assert_eq!(clips.key.as_ref(), "set/data/train-0.parquet");
        assert_eq!(clips.url(&clips.key), Path::new(url));
        assert_eq!(place("gs://b").key.as_ref(), "");
        assert_eq!(place("az://b/a/").key.as_ref(), "a");
        // Object keys are used as written; paths of HTTP URLs are decoded.
        assert_eq!(place("s3://b/a%20b c#1").key.as_ref(), "a%20b c#1");
        let http = place("http://127.0.0.1:80/a%20b");
        assert_eq!(http.authority.as_str(), "127.0.0.1:80");
        assert_eq!(http.key.as_ref(), "a b");
    }

    #[test]
    fn unusable_urls_are_refused_with_the_reason() {
        for (url, reason) in [
            ("ftp://host/a", "s3, gs, az"),
            ("s3:///a", "no bucket"),
            ("s3://b/a//b", "empty"),
            ("s3://b/../a", ".."),
            ("https://host/a?signature=1", "query"),
        ] {
            let error = Place::parse(Path::new(url)).expect_err(url).to_string();
            assert!(error.contains(url) && error.contains(reason), "{error}");
        }
    }
}
