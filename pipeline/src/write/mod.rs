//! Writers of source formats, the inverse of the readers: generated and exported motions are ingested like
//! any other file.

pub mod amass;
pub mod bvh;
pub mod gltf;

use std::io;
use std::path::Path;

/// Writes a file whole or not at all: to a temporary name beside it, then renamed.
///
/// # Errors
/// The file cannot be created, written or renamed; the temporary file is then removed.
pub fn replace_file(path: &Path, content: &[u8]) -> io::Result<()> {
    let name = path.file_name().ok_or(io::ErrorKind::InvalidInput)?;
    let staged = path.with_file_name(format!(".{}.tmp", name.to_string_lossy()));
    std::fs::write(&staged, content)
        .and_then(|()| std::fs::rename(&staged, path))
        .inspect_err(|_| {
            // The temporary file may not exist; the first error is returned.
            let _removed = std::fs::remove_file(&staged);
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_replaced_and_nothing_is_left_beside_it() {
        let dir = tempfile::tempdir().expect("temporary folder");
        let path = dir.path().join("walk.bvh");
        replace_file(&path, b"old and longer").expect("written");
        replace_file(&path, b"new").expect("replaced");
        assert_eq!(std::fs::read(&path).expect("there"), b"new");
        assert_eq!(std::fs::read_dir(dir.path()).expect("listed").count(), 1);
        assert!(replace_file(&dir.path().join("missing/walk.bvh"), b"x").is_err());
    }
}
