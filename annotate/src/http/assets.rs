//! The front end, embedded.

use std::sync::OnceLock;

use flate2::Compression;

use super::compress::gzip;

/// Names and contents of the committed build, so that `cargo build` needs no Node.
static FILES: &[(&str, &[u8])] = &[
    (
        "LICENSE-lit.txt",
        include_bytes!("../../web/dist/LICENSE-lit.txt"),
    ),
    (
        "LICENSE-three.txt",
        include_bytes!("../../web/dist/LICENSE-three.txt"),
    ),
    ("app.css", include_bytes!("../../web/dist/app.css")),
    ("app.js", include_bytes!("../../web/dist/app.js")),
    ("index.html", include_bytes!("../../web/dist/index.html")),
    (
        "vendor-three.js",
        include_bytes!("../../web/dist/vendor-three.js"),
    ),
];

/// The files compressed, in the order of [`FILES`]. They are compressed at the first request and not in the
/// repository, where every change of the front end would add 200 kB that no tool compares.
static PACKED: [OnceLock<Option<Vec<u8>>>; FILES.len()] = [const { OnceLock::new() }; FILES.len()];

/// A file of the front end.
pub(super) struct Asset {
    pub(super) bytes: &'static [u8],
    pub(super) is_packed: bool,
    pub(super) mime: &'static str,
    /// Hash of the content and its coding, quoted.
    pub(super) etag: String,
}

/// The file at a path of the server: `/assets/NAME`, or the page at `/` and `/app/...`. It is compressed if that
/// is asked for and makes it smaller.
pub(super) fn find(path: &str, packed: bool) -> Option<Asset> {
    let name = match path.strip_prefix("/assets/") {
        Some(name) => name,
        None if path == "/" || path == "/app" || path.starts_with("/app/") => "index.html",
        None => return None,
    };
    let index = FILES.iter().position(|(known, _)| *known == name)?;
    let plain = FILES[index].1;
    let packed = packed
        .then(|| PACKED[index].get_or_init(|| gzip(plain, Compression::best())))
        .and_then(Option::as_deref);
    let bytes = packed.unwrap_or(plain);
    Some(Asset {
        bytes,
        is_packed: packed.is_some(),
        mime: mime(name),
        etag: format!("\"{}\"", &blake3::hash(bytes).to_hex()[..16]),
    })
}

fn mime(name: &str) -> &'static str {
    match name.rsplit_once('.').map_or("", |(_, extension)| extension) {
        "html" => "text/html; charset=utf-8",
        "js" => "text/javascript; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        "json" | "map" => "application/json",
        "txt" => "text/plain; charset=utf-8",
        "svg" => "image/svg+xml",
        "png" => "image/png",
        "ico" => "image/x-icon",
        _ => "application/octet-stream",
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::FILES;

    #[test]
    fn every_built_file_is_embedded() {
        let dist = concat!(env!("CARGO_MANIFEST_DIR"), "/web/dist");
        let built: BTreeSet<String> = std::fs::read_dir(dist)
            .expect("the built front end")
            .map(|entry| {
                entry
                    .expect("an entry")
                    .file_name()
                    .to_string_lossy()
                    .into_owned()
            })
            // The build manifest is used by tests only.
            .filter(|name| name != "manifest.json")
            .collect();
        let embedded: BTreeSet<String> = FILES.iter().map(|(name, _)| (*name).to_owned()).collect();
        assert_eq!(embedded, built);
    }
}
