//! The files of the front end, embedded in the program.

const HTML: &str = "text/html; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
const STYLE: &str = "text/css; charset=utf-8";
const TEXT: &str = "text/plain; charset=utf-8";

/// A file of the front end.
pub(super) struct Asset {
    name: &'static str,
    pub(super) mime: &'static str,
    pub(super) bytes: &'static [u8],
}

/// Declares an asset from a file of the committed build, so that `cargo build` does not need Node.
macro_rules! asset {
    ($name:literal, $mime:ident) => {
        Asset {
            name: $name,
            mime: $mime,
            bytes: include_bytes!(concat!("../../web/dist/", $name)),
        }
    };
}

static FILES: &[Asset] = &[
    asset!("LICENSE-lit.txt", TEXT),
    asset!("LICENSE-three.txt", TEXT),
    asset!("app.css", STYLE),
    asset!("app.js", SCRIPT),
    asset!("index.html", HTML),
    asset!("vendor-three.js", SCRIPT),
];

impl Asset {
    /// Weak ETag of the content; a compressed response has the same one.
    pub(super) fn etag(&self) -> String {
        format!("W/\"{}\"", &blake3::hash(self.bytes).to_hex()[..16])
    }
}

/// The file at a path of the server: `/assets/NAME`, or the page at `/` and `/app/...`.
pub(super) fn find(path: &str) -> Option<&'static Asset> {
    let name = match path.strip_prefix("/assets/") {
        Some(name) => name,
        None if path == "/" || path == "/app" || path.starts_with("/app/") => "index.html",
        None => return None,
    };
    FILES.iter().find(|asset| asset.name == name)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::FILES;

    #[test]
    fn every_built_file_is_embedded() {
        let dist = concat!(env!("CARGO_MANIFEST_DIR"), "/web/dist");
        let entries = std::fs::read_dir(dist).expect("the built front end");
        let names = entries.map(|entry| entry.expect("an entry").file_name());
        let built: BTreeSet<String> = names
            .map(|name| name.to_string_lossy().into_owned())
            // Only tests use the build manifest.
            .filter(|name| name != "manifest.json")
            .collect();
        let embedded: BTreeSet<String> = FILES.iter().map(|asset| asset.name.to_owned()).collect();
        assert_eq!(embedded, built);
    }
}
