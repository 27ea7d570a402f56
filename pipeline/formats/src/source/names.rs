//! File names as text.

use std::collections::BTreeSet;
use std::ffi::{OsStr, OsString};

/// A file name as text without control characters, different for different names: bytes that are not
/// UTF-8 and control characters become `\xNN`, a backslash is doubled.
pub fn text_of_name(name: &OsStr) -> String {
    text_of_bytes(name.as_encoded_bytes())
}

/// [`text_of_name`] of a name in an archive.
pub(super) fn text_of_bytes(name: &[u8]) -> String {
    let mut text = String::with_capacity(name.len());
    for chunk in name.utf8_chunks() {
        for c in chunk.valid().chars() {
            match c {
                '\\' => text += r"\\",
                c if c.is_control() => escape(c.encode_utf8(&mut [0; 4]).as_bytes(), &mut text),
                c => text.push(c),
            }
        }
        escape(chunk.invalid(), &mut text);
    }
    text
}

/// The name of a file, without its folders.
pub(super) fn file_name(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or(path)
}

/// Whether a text is a whole number: one digit or more.
pub(super) fn is_number(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit())
}

/// Splits a path at its first folder with one of these names: the part before it, the name, and the part after it.
pub(super) fn around_folder<'a, 'b>(
    path: &'a str,
    folders: &[&'b str],
) -> Option<(&'a str, &'b str, &'a str)> {
    let mut start = 0;
    for component in path.split('/') {
        let end = start + component.len();
        if let Some(folder) = folders.iter().find(|folder| **folder == component) {
            return Some((&path[..start], *folder, path.get(end + 1..)?));
        }
        start = end + 1;
    }
    None
}

/// The text of a token for a message: at most its first 40 bytes, without control characters.
pub(super) fn shown(token: &[u8]) -> String {
    const LONGEST: usize = 40;
    let text = String::from_utf8_lossy(&token[..token.len().min(LONGEST)]);
    let text: String = text.chars().filter(|c| !c.is_control()).collect();
    format!("\"{text}\"")
}

/// Turns the names of a file's motions into unique keys without control characters. `unnamed` makes the key of a motion
/// without a name.
pub fn unique_keys(
    names: impl Iterator<Item = impl AsRef<str>>,
    unnamed: impl Fn(usize) -> String,
) -> Vec<String> {
    /// Number of characters of a name that are kept, because keys become parts of ids.
    const LONGEST: usize = 64;
    let mut taken = BTreeSet::new();
    let keys = names.enumerate().map(|(index, name)| {
        let name = name.as_ref().chars().filter(|c| !c.is_control());
        let name: String = name.take(LONGEST).collect();
        let mut key = match name.trim() {
            "" => unnamed(index),
            name => name.to_owned(),
        };
        while !taken.insert(key.clone()) {
            key = format!("{key}.{index}");
        }
        key
    });
    keys.collect()
}

fn escape(bytes: &[u8], text: &mut String) {
    for byte in bytes {
        *text += &format!(r"\x{byte:02x}");
    }
}

/// The file name of a text made by [`text_of_name`]. Other escapes are kept unchanged.
pub fn name_of_text(text: &str) -> OsString {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.as_bytes();
    while let Some((&first, after)) = rest.split_first() {
        let (byte, length) = match after {
            [b'\\', ..] if first == b'\\' => (b'\\', 2),
            [b'x', high, low, ..] if first == b'\\' => match (digit(*high), digit(*low)) {
                (Some(high), Some(low)) => (16 * high + low, 4),
                _ => (first, 1),
            },
            _ => (first, 1),
        };
        bytes.push(byte);
        rest = &rest[length..];
    }
    from_bytes(bytes)
}

/// Escapes a path for use in an id, in which `#`, `@` and a final `~m` mark derived clips.
pub fn escaped(path: &str) -> String {
    let path = path
        .replace('%', "%25")
        .replace('#', "%23")
        .replace('@', "%40");
    match path.strip_suffix("~m") {
        Some(rest) => format!("{rest}%7Em"),
        None => path,
    }
}

fn digit(byte: u8) -> Option<u8> {
    let digit = char::from(byte).to_digit(16)?;
    u8::try_from(digit).ok()
}

#[cfg(unix)]
fn from_bytes(bytes: Vec<u8>) -> OsString {
    std::os::unix::ffi::OsStringExt::from_vec(bytes)
}

#[cfg(not(unix))]
fn from_bytes(bytes: Vec<u8>) -> OsString {
    String::from_utf8_lossy(&bytes).into_owned().into()
}

#[cfg(all(test, unix))]
mod tests {
    use std::os::unix::ffi::OsStringExt;

    use proptest::prelude::*;

    use super::*;

    #[test]
    fn plain_names_stay_and_others_are_spelt_out() {
        for (name, text) in [
            (&b"walk 01.bvh"[..], "walk 01.bvh"),
            ("Übung.bvh".as_bytes(), "Übung.bvh"),
            (b"a\xff.bvh", r"a\xff.bvh"),
            (b"a\xfe.bvh", r"a\xfe.bvh"),
            (br"a\xff.bvh", r"a\\xff.bvh"),
            (b"a\x1b[31m.bvh", r"a\x1b[31m.bvh"),
            ("a\u{9b}31m\n".as_bytes(), r"a\xc2\x9b31m\x0a"),
        ] {
            let name = OsString::from_vec(name.to_vec());
            assert_eq!(text_of_name(&name), text);
            assert_eq!(name_of_text(text), name);
        }
    }

    proptest! {
        #[test]
        fn every_name_comes_back(bytes in prop::collection::vec(any::<u8>(), 0..24)) {
            let name = OsString::from_vec(bytes);
            let text = text_of_name(&name);
            prop_assert!(!text.chars().any(char::is_control));
            prop_assert_eq!(name_of_text(&text), name);
        }
    }
}
