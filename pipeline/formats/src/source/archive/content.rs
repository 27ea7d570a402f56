//! Contents of an archive, and the errors in it.

use std::collections::BTreeMap;

use super::members::{Member, ReadFrom};
use crate::source::names::text_of_bytes;
use clip::Rejected;

/// Code of an archive or member that is damaged, or whose content contradicts its name.
pub const DAMAGED: &str = "E-ARCHIVE-DAMAGED";
/// Code of a member whose name leads out of the archive, and of an archive with a folder of the same name beside it.
pub(super) const NAME: &str = "E-ARCHIVE-NAME";
/// Code of an archive with too many members, bytes or levels.
pub(super) const LIMIT: &str = "E-ARCHIVE-LIMIT";
/// Code of a member that is encrypted or packed in an unsupported way.
pub(super) const PACKING: &str = "E-ARCHIVE-PACKING";

/// Contents of an archive.
#[derive(Debug, Default)]
pub(super) struct Content {
    /// Files by name.
    pub(super) members: BTreeMap<String, Member>,
    pub(super) special: Vec<(String, String)>,
    /// Members that cannot be used; the name is empty for the archive itself.
    pub(super) refused: Vec<(String, Rejected)>,
    /// Open archive from which the members are read.
    pub(super) read_from: Option<ReadFrom>,
}

impl Content {
    pub(super) fn is_empty(&self) -> bool {
        self.members.is_empty() && self.special.is_empty() && self.refused.is_empty()
    }

    /// The path of a member that is a file, from its raw name. Other members are noted. `at` is the offset in the
    /// archive.
    pub(super) fn file_name(&mut self, raw: &[u8], at: u64) -> Option<String> {
        match named(raw) {
            Named::File(name) => return Some(name),
            Named::Special(name, reason) => self.special.push((name, reason.to_owned())),
            Named::Refused(name) => {
                let reason = "the name of the member leads out of the archive; pack the files by their relative \
                              paths";
                self.refuse(&name, NAME, reason.to_owned(), at);
            }
        }
        None
    }

    pub(super) fn refuse(&mut self, name: &str, code: &'static str, reason: String, at: u64) {
        let rejected = Rejected::read(code, reason).at(at as usize);
        self.refused.push((name.to_owned(), rejected));
    }

    /// Adds a file. If several members have the same name, the last one is used, as when unpacking.
    pub(super) fn add(&mut self, name: String, member: Member) {
        if self.members.insert(name.clone(), member).is_some() {
            let reason = "an earlier member of this name in its archive; the last one is read";
            self.special.push((name, reason.to_owned()));
        }
    }
}

/// Meaning of a member's name.
enum Named {
    File(String),
    /// Name of a member that is skipped, and the reason.
    Special(String, &'static str),
    /// A name that leads out of the archive, as text for a message.
    Refused(String),
}

/// The name of a member as a relative path. Names that lead out of the archive are refused, as by all unpackers.
fn named(raw: &[u8]) -> Named {
    let shown = text_of_bytes(raw);
    let is_drive =
        |part: &[u8]| part.len() == 2 && part[1] == b':' && part[0].is_ascii_alphabetic();
    let mut parts = Vec::new();
    for part in raw.split(|byte| *byte == b'/') {
        match part {
            b"" if parts.is_empty() => return Named::Refused(shown),
            b"" | b"." => {}
            b".." => return Named::Refused(shown),
            drive if parts.is_empty() && is_drive(drive) => return Named::Refused(shown),
            part => parts.push(text_of_bytes(part)),
        }
    }
    if raw.is_empty() || parts.is_empty() {
        return Named::Refused(shown);
    }
    let is_resource =
        parts[0] == "__MACOSX" || parts.last().is_some_and(|name| name.starts_with("._"));
    let name = parts.join("/");
    match is_resource {
        true => Named::Special(name, "resource file of macOS, no motion"),
        false => Named::File(name),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_stay_in_the_archive() {
        let text = |name: &[u8]| match named(name) {
            Named::File(name) => name,
            Named::Special(name, _) => format!("special {name}"),
            Named::Refused(name) => format!("refused {name}"),
        };
        for (name, expected) in [
            (&b"./a//b/walk.bvh"[..], "a/b/walk.bvh"),
            (b"a/../walk.bvh", "refused a/../walk.bvh"),
            (b"/etc/passwd", "refused /etc/passwd"),
            (b"C:/walk.bvh", "refused C:/walk.bvh"),
            (b"", "refused "),
            (b"a\xff\x1b", r"a\xff\x1b"),
            (b"__MACOSX/a/walk.bvh", "special __MACOSX/a/walk.bvh"),
            (b"a/._walk.bvh", "special a/._walk.bvh"),
        ] {
            assert_eq!(text(name), expected);
        }
    }
}
