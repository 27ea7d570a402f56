//! Contents of an archive, and the errors in it.

use std::collections::BTreeMap;
use std::io;

use super::members::{Member, ReadFrom};
use crate::source::names::text_of_bytes;
use clip::{Rejected, rejected};

/// Code of an archive or member that is damaged, or whose content contradicts its name.
pub const DAMAGED: &str = "E-ARCHIVE-DAMAGED";
/// Code of a member whose name leads out of the archive, and of an archive with a folder of the same name beside it.
pub(super) const NAME: &str = "E-ARCHIVE-NAME";
/// Code of an archive with too many members, bytes or levels.
pub(super) const LIMIT: &str = "E-ARCHIVE-LIMIT";
/// Code of a member that is encrypted or packed in an unsupported way.
pub(super) const PACKING: &str = "E-ARCHIVE-PACKING";

/// Rejects an archive that cannot be read.
pub(super) fn unreadable(error: &io::Error) -> Rejected {
    rejected!("E-IO", "cannot read the archive: {error}")
}

/// Rejects an archive with too many members or bytes. `at` is the offset at which it exceeds the limit.
pub(super) fn too_large(reason: String, at: u64) -> Rejected {
    Rejected::read(LIMIT, reason).at(at as usize)
}

/// Contents of an archive.
#[derive(Debug, Default)]
pub(super) struct Content {
    /// Files by name.
    pub(super) members: BTreeMap<String, Member>,
    /// Members that are not files, and why each is skipped; the name is empty for the archive itself.
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
        let Some(parts) = parts_of(raw) else {
            let reason = "the name of the member leads out of the archive; pack the files by their relative paths";
            self.refuse(&text_of_bytes(raw), NAME, reason, at);
            return None;
        };
        let name = parts.join("/");
        if parts[0] == "__MACOSX" || parts.last().is_some_and(|name| name.starts_with("._")) {
            self.skip(name, "resource file of macOS, no motion");
            return None;
        }
        Some(name)
    }

    /// Notes a member that is not a file; the name is empty for the archive itself.
    pub(super) fn skip(&mut self, name: String, reason: &str) {
        self.special.push((name, reason.to_owned()));
    }

    /// Notes a member that cannot be used; the name is empty for the archive itself.
    pub(super) fn refuse(
        &mut self,
        name: &str,
        code: &'static str,
        reason: impl Into<String>,
        at: u64,
    ) {
        let rejected = Rejected::read(code, reason).at(at as usize);
        self.refused.push((name.to_owned(), rejected));
    }

    /// Adds a file. If several members have the same name, the last one is used, as when unpacking.
    pub(super) fn add(&mut self, name: String, member: Member) {
        if self.members.insert(name.clone(), member).is_some() {
            let reason = "an earlier member of this name in its archive; the last one is read";
            self.skip(name, reason);
        }
    }
}

/// The parts of a member's name as a relative path. `None` for names that lead out of the archive, which all unpackers
/// refuse.
fn parts_of(raw: &[u8]) -> Option<Vec<String>> {
    let is_drive =
        |part: &[u8]| part.len() == 2 && part[1] == b':' && part[0].is_ascii_alphabetic();
    let mut parts = Vec::new();
    for part in raw.split(|byte| *byte == b'/') {
        match part {
            b"" if parts.is_empty() => return None,
            b"" | b"." => {}
            b".." => return None,
            drive if parts.is_empty() && is_drive(drive) => return None,
            part => parts.push(text_of_bytes(part)),
        }
    }
    (!parts.is_empty()).then_some(parts)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_stay_in_the_archive() {
        let text = |name: &[u8]| {
            let mut content = Content::default();
            let file = content.file_name(name, 0);
            match (file, &content.special[..], &content.refused[..]) {
                (Some(name), [], []) => name,
                (None, [(name, _)], []) => format!("special {name}"),
                (None, [], [(name, _)]) => format!("refused {name}"),
                other => panic!("{other:?}"),
            }
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
