//! Packing of archives, recognised by file name.

/// Packing of an archive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Members packed one by one, with a directory at the end.
    Zip,
    /// Uncompressed members one after the other.
    Tar,
    /// A tar in a gzip stream.
    Gzip,
    /// A tar in a bzip2 stream.
    Bzip2,
    /// A tar in an xz stream.
    Xz,
}

/// Endings of names, in lower case.
const ENDINGS: [(&str, Kind); 9] = [
    (".zip", Kind::Zip),
    (".tar", Kind::Tar),
    (".tar.gz", Kind::Gzip),
    (".tgz", Kind::Gzip),
    (".tar.bz2", Kind::Bzip2),
    (".tbz2", Kind::Bzip2),
    (".tbz", Kind::Bzip2),
    (".tar.xz", Kind::Xz),
    (".txz", Kind::Xz),
];

/// Extensions of PyTorch and joblib dumps that are not tars despite their name.
const NO_TARS: [&str; 3] = [".pth.tar", ".pt.tar", ".ckpt.tar"];

impl Kind {
    /// The kind that a file name states; `None` if the name is not that of an archive.
    pub(super) fn of_name(name: &str) -> Option<Self> {
        split_ending(name).map(|(_, kind)| kind)
    }

    /// Whether members can be read without reading the bytes before them.
    pub(super) fn is_random_access(self) -> bool {
        matches!(self, Self::Zip | Self::Tar)
    }
}

fn split_ending(name: &str) -> Option<(usize, Kind)> {
    let lower = name.to_lowercase();
    if lower.len() != name.len() || NO_TARS.iter().any(|ending| lower.ends_with(ending)) {
        return None;
    }
    let found = ENDINGS.iter().find(|(ending, _)| lower.ends_with(ending));
    let (ending, kind) = found?;
    let length = name.len() - ending.len();
    (length > 0 && !name[..length].ends_with('/')).then_some((length, *kind))
}

/// The name of an archive without its ending: `texts` for `texts.zip`. `None` for other names.
pub(crate) fn stem(name: &str) -> Option<&str> {
    let (length, _) = split_ending(name)?;
    Some(&name[..length])
}

/// Whether a relative path leads to a member of an archive.
pub fn is_in_archive(relative: &str) -> bool {
    let folders = relative.rsplit_once('/').map_or("", |(folders, _)| folders);
    folders
        .split('/')
        .any(|folder| Kind::of_name(folder).is_some())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn archives_are_told_by_their_names() {
        for (name, kind) in [
            ("a/ACCAD.tar.bz2", Some(Kind::Bzip2)),
            ("HumanML3D.ZIP", Some(Kind::Zip)),
            ("walks.tgz", Some(Kind::Gzip)),
            ("walks.txz", Some(Kind::Xz)),
            ("shard-000000.tar", Some(Kind::Tar)),
            ("motionfix_val.pth.tar", None),
            ("walk.bvh.gz", None),
            ("walk.npz", None),
            ("a/.zip", None),
        ] {
            assert_eq!(Kind::of_name(name), kind, "{name}");
        }
        assert_eq!(stem("texts.zip"), Some("texts"));
        assert_eq!(stem("texts"), None);
    }
}
