//! The content of single files: the motions in it, and the files beside it.

use std::cell::Cell;
use std::panic::AssertUnwindSafe;
use std::path::Path;

use clip::{Rejected, rejected};
use formats::source::{Files, Format, ReadOptions, name_of_text};

/// Reads files beside a motion. An unreadable one must not be treated as a missing one, so it is noted in `failed`.
pub(super) fn companions<'a>(
    files: &'a Files,
    motion: &str,
    failed: &'a Cell<Option<Rejected>>,
) -> impl Fn(&str) -> Option<Vec<u8>> + use<'a> {
    let folder = files.path(motion).and_then(Path::parent);
    let folder = folder.unwrap_or(Path::new("."));
    move |name| {
        let read = files.read_beside(&folder.join(name_of_text(name)));
        read.unwrap_or_else(|rejected| {
            failed.set(Some(rejected));
            None
        })
    }
}

/// Keys of the motions of a single file. The key is empty if the file holds one motion or is damaged; the
/// reader then reports the error.
pub(super) fn keys_of(
    format: Format,
    files: &Files,
    relative: &str,
    options: &ReadOptions,
) -> Result<Vec<String>, Rejected> {
    let whole = || vec![String::new()];
    if format.keys.is_none() {
        return Ok(whole());
    }
    bounded_length(files, relative)?;
    let bytes = files.read(relative)?;
    let keys = std::panic::catch_unwind(AssertUnwindSafe(|| format.keys(&bytes, options)));
    let keys = keys.unwrap_or_default();
    Ok(if keys.is_empty() { whole() } else { keys })
}

/// Limit on files that are read whole, in bytes. Releases with many motions in a file have their own
/// limits.
const MAX_FILE_LEN: u64 = 4 << 30;

/// Length of a file that is read whole, in bytes.
pub(super) fn bounded_length(files: &Files, relative: &str) -> Result<usize, Rejected> {
    let length = files.size(relative)?;
    if length > MAX_FILE_LEN {
        return Err(rejected!(
            "E-TOO-LARGE",
            "found {length} bytes, expected at most {MAX_FILE_LEN} in one motion file"
        ));
    }
    Ok(usize::try_from(length).unwrap_or(usize::MAX))
}

#[cfg(test)]
mod tests {
    use formats::source::gltf;

    use super::*;

    #[test]
    fn files_are_not_listed_beyond_the_limit_or_if_they_cannot_be_read() {
        let dir = tempfile::tempdir().expect("a temporary folder");
        let place = |name: &str| (name.to_owned(), dir.path().join(name));
        let large = std::fs::File::create(dir.path().join("large.glb")).expect("made");
        // The file is sparse: it uses no disk space.
        large.set_len(MAX_FILE_LEN + 1).expect("enlarged");
        let files = Files::new(["large.glb", "gone.glb"].map(place).into());
        let code = |name| {
            let keys = keys_of(gltf::FORMAT, &files, name, &ReadOptions::default());
            keys.expect_err("no keys").code
        };
        assert_eq!(code("large.glb"), "E-TOO-LARGE");
        assert_eq!(code("gone.glb"), "E-IO");
    }
}
