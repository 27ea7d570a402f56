//! The front end, embedded.

include!(concat!(env!("OUT_DIR"), "/files.rs"));

/// Shown where the front end was not built.
const NO_FRONT_END: &[u8] =
    b"<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>stance annotate</title>\
<p>The server runs; its front end was not built into it. See annotate/web/README.md.</p></html>";

/// A file of the front end.
pub(super) struct Asset {
    pub(super) bytes: &'static [u8],
    pub(super) mime: &'static str,
    /// Hash of the content, quoted.
    pub(super) etag: String,
}

/// The file under a path of the server: `/assets/NAME`, or the page for its own addresses.
pub(super) fn find(path: &str) -> Option<Asset> {
    let name = match path.strip_prefix("/assets/") {
        Some(name) => name,
        None if path == "/" || path == "/app" || path.starts_with("/app/") => "index.html",
        None => return None,
    };
    let found = FILES.iter().find(|(known, _)| *known == name);
    let bytes = match found {
        Some((_, bytes)) => *bytes,
        None if name == "index.html" => NO_FRONT_END,
        None => return None,
    };
    Some(Asset {
        bytes,
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
