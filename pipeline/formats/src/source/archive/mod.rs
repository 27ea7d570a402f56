//! Archives among the sources: zip, tar, and tar packed by gzip, bzip2 or xz.
//!
//! An archive acts as a folder of its name. Members of zip and tar archives are read where they lie. A packed tar has
//! to be read from its beginning, so its members are unpacked into a scratch folder first. In both cases the members
//! have paths below the archive's, which [`datasets_spec::store::ByPath`] serves while the archive is open.

mod limits;
mod members;
mod scratch;
mod tarball;
mod unpacked;
mod zipped;

use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use datasets_spec::store::{ByPath, Mounted, Store, mount};
use datasets_spec::{NoProgress, Progress};
use rayon::prelude::*;

use self::limits::{Budget, Limits};
use self::members::{Member, Members};
use self::scratch::Scratch;
use self::unpacked::DamagedMember;
use super::{is_pointer, name_of_text, text_of_name};
use crate::Error;
use clip::Rejected;

/// How an archive is packed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// Members packed one by one, with a directory at the end.
    Zip,
    /// Members one after the other, as they are.
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

/// Dumps of PyTorch and joblib that are no tars whatever their name says.
const NO_TARS: [&str; 3] = [".pth.tar", ".pt.tar", ".ckpt.tar"];

/// Archives in an archive are opened; archives in those are not.
const MAX_DEPTH: usize = 1;

impl Kind {
    /// The kind that a name states; none if it is of no archive.
    fn of_name(name: &str) -> Option<Self> {
        split_ending(name).map(|(_, kind)| kind)
    }

    /// Whether members can be read without what lies before them.
    fn is_random_access(self) -> bool {
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

/// The name of an archive without its ending: `texts` of `texts.zip`. None for other names.
pub(crate) fn stem(name: &str) -> Option<&str> {
    let (length, _) = split_ending(name)?;
    Some(&name[..length])
}

/// Whether a relative path is that of a member of an archive.
pub fn is_in_archive(relative: &str) -> bool {
    let folders = relative.rsplit_once('/').map_or("", |(folders, _)| folders);
    folders
        .split('/')
        .any(|folder| Kind::of_name(folder).is_some())
}

/// Where in its archive a member begins that is damaged; none for other errors.
pub fn offset_of_damaged(error: &io::Error) -> Option<u64> {
    let member: &DamagedMember = error.get_ref()?.downcast_ref()?;
    Some(member.at)
}

/// The outermost archive among a folder and those above it; none if there is no archive.
fn archive_of(folder: &Path) -> Option<&Path> {
    let mut above: Vec<&Path> = folder.ancestors().collect();
    above.reverse();
    above.into_iter().find(|folder| {
        let name = folder.file_name().map(|name| name.to_string_lossy());
        name.is_some_and(|name| Kind::of_name(&name).is_some()) && ByPath.size(folder).is_ok()
    })
}

/// What archives hold.
#[derive(Debug, Default)]
pub struct Opened {
    /// Members by their relative paths, which begin with that of the archive.
    pub files: BTreeMap<String, PathBuf>,
    /// Members that are no files, and why each is skipped.
    pub special: Vec<(String, String)>,
    /// Archives and members that cannot be used, with the hash of the archive.
    pub refused: Vec<(String, String, Rejected)>,
    /// While these are kept the members can be read.
    pub archives: Archives,
}

/// Archives that are open.
#[derive(Clone, Debug, Default)]
pub struct Archives {
    open: Vec<Arc<Mounted>>,
    /// Those that had to be unpacked.
    unpacked: Vec<PathBuf>,
}

impl Archives {
    /// Takes others over.
    pub fn add(&mut self, other: Self) {
        self.open.extend(other.open);
        self.unpacked.extend(other.unpacked);
    }

    /// One that had to be unpacked, so that other processes cannot read its members.
    pub fn unpacked(&self) -> Option<&Path> {
        self.unpacked.first().map(PathBuf::as_path)
    }

    /// Opens the archives that some paths lead into.
    ///
    /// # Errors
    /// There is no room to unpack an archive.
    pub fn of<'a>(paths: impl Iterator<Item = &'a PathBuf>) -> Result<Self, Error> {
        let folders: BTreeSet<&Path> = paths.filter_map(|path| path.parent()).collect();
        let found = folders.into_iter().filter_map(archive_of);
        let found: BTreeSet<&Path> = found.collect();
        let unpacking = Unpacking::new(&NoProgress);
        let mut all = Self::default();
        for path in found {
            let name = text_of_name(path.file_name().unwrap_or_default());
            if let Some(opened) = open(&name, path, 0, &unpacking)? {
                all.add(opened.archives);
            }
        }
        Ok(all)
    }
}

impl Opened {
    fn add(&mut self, other: Self) {
        self.files.extend(other.files);
        self.special.extend(other.special);
        self.refused.extend(other.refused);
        self.archives.add(other.archives);
    }
}

/// Where archives are unpacked, and who is told of it.
struct Unpacking<'a> {
    scratch: Arc<Scratch>,
    progress: &'a dyn Progress,
}

impl<'a> Unpacking<'a> {
    fn new(progress: &'a dyn Progress) -> Self {
        Self {
            scratch: Arc::new(Scratch::new()),
            progress,
        }
    }

    /// The archives that must be unpacked before their members can be read, and their bytes.
    fn packed(archives: &[(String, PathBuf)]) -> (usize, u64) {
        let packed = archives.iter().filter(|(relative, _)| {
            Kind::of_name(relative).is_some_and(|kind| !kind.is_random_access())
        });
        let sizes = packed.map(|(_, path)| ByPath.size(path).unwrap_or(0));
        sizes.fold((0, 0), |(count, bytes), size| (count + 1, bytes + size))
    }

    /// Tells how much will be unpacked. Where nothing is, nothing is told.
    fn begin(&self, archives: &[(String, PathBuf)]) {
        let (count, bytes) = Self::packed(archives);
        if count > 0 {
            self.progress.begin("unpack", Some(unpacked::shown(bytes)));
            self.progress.message(&format!("MB of {count} archives"));
        }
    }

    fn finish(&self, archives: &[(String, PathBuf)]) {
        let (count, bytes) = Self::packed(archives);
        if count > 0 {
            let megabytes = unpacked::shown(bytes);
            let told = format!("{count} archives of {megabytes} MB");
            self.progress.finish(&told);
        }
    }
}

/// Opens the archives among some files and takes their names out of these. Files that are named like an archive and
/// are of a format that is read as it is stay.
///
/// # Errors
/// There is no room to unpack an archive.
pub fn open_all(
    files: &mut BTreeMap<String, PathBuf>,
    progress: &dyn Progress,
) -> Result<Opened, Error> {
    let names = files.iter();
    let archives: Vec<(String, PathBuf)> = names
        .filter(|(relative, _)| Kind::of_name(relative).is_some())
        .map(|(relative, path)| (relative.clone(), path.clone()))
        .collect();
    let mut all = Opened::default();
    if archives.is_empty() {
        return Ok(all);
    }
    let unpacking = Unpacking::new(progress);
    unpacking.begin(&archives);
    let is_folder = |relative: &str| {
        let below = format!("{relative}/");
        let mut next = files.range(below.clone()..);
        next.next()
            .is_some_and(|(file, _)| file.starts_with(&below))
    };
    let opened: Vec<Option<Opened>> = archives
        .par_iter()
        .map(|(relative, path)| {
            if is_folder(relative) {
                let reason = "there is a folder of its name beside it; rename one of them";
                return Ok(Some(refuse(relative, path, Rejected::read(NAME, reason))));
            }
            open(relative, path, 0, &unpacking)
        })
        .collect::<Result<_, Error>>()?;
    unpacking.finish(&archives);
    for ((relative, _), opened) in archives.iter().zip(opened) {
        if let Some(opened) = opened {
            files.remove(relative);
            all.add(opened);
        }
    }
    Ok(all)
}

/// An archive or a member that is damaged, or is something else than its name says.
pub const DAMAGED: &str = "E-ARCHIVE-DAMAGED";
/// A member whose name leads out of the archive, or is that of another one.
const NAME: &str = "E-ARCHIVE-NAME";
/// More members, bytes or levels than are read.
const LIMIT: &str = "E-ARCHIVE-LIMIT";
/// A member that is packed in a way that is not read, or encrypted.
const PACKING: &str = "E-ARCHIVE-PACKING";

fn refuse(relative: &str, path: &Path, rejected: Rejected) -> Opened {
    let hash = ByPath.hash(path).unwrap_or_default();
    Opened {
        refused: vec![(relative.to_owned(), hash, rejected)],
        ..Opened::default()
    }
}

/// Opens an archive. None if the file is of a format that is read as it is.
fn open(
    relative: &str,
    path: &Path,
    depth: usize,
    unpacking: &Unpacking<'_>,
) -> Result<Option<Opened>, Error> {
    let Some(kind) = Kind::of_name(relative) else {
        return Ok(None);
    };
    if is_pointer(&crate::source::read_head(path)) {
        return Ok(None);
    }
    if kind == Kind::Tar && super::webdataset::is_shard(path) {
        return Ok(None);
    }
    if depth > MAX_DEPTH {
        let reason = "an archive in an archive in an archive is not read; unpack the outer one";
        let rejected = Rejected::read(LIMIT, reason);
        return Ok(Some(refuse(relative, path, rejected)));
    }
    let mut content = match content(kind, path, unpacking)? {
        Ok(content) => content,
        Err(rejected) => return Ok(Some(refuse(relative, path, rejected))),
    };
    let mut opened = Opened::default();
    let of_archive = |name: &str| match name {
        "" => relative.to_owned(),
        name => format!("{relative}/{name}"),
    };
    if content.is_empty() {
        let reason = "archive without files".to_owned();
        opened.special.push((relative.to_owned(), reason));
    }
    let special = std::mem::take(&mut content.special).into_iter();
    opened
        .special
        .extend(special.map(|(name, reason)| (of_archive(&name), reason)));
    if !content.refused.is_empty() {
        let hash = ByPath.hash(path).unwrap_or_default();
        let refused = std::mem::take(&mut content.refused).into_iter();
        opened
            .refused
            .extend(refused.map(|(name, rejected)| (of_archive(&name), hash.clone(), rejected)));
    }
    for name in content.members.keys() {
        let place = path.join(name_of_text(name));
        opened.files.insert(of_archive(name), place);
    }
    let members = content.members(path);
    let mounted = mount(path, Arc::new(members));
    opened.archives.open.push(Arc::new(mounted));
    if !kind.is_random_access() {
        opened.archives.unpacked.push(path.to_owned());
    }
    let names = opened.files.iter();
    let inner: Vec<(String, PathBuf)> = names
        .filter(|(name, _)| Kind::of_name(name).is_some())
        .map(|(name, place)| (name.clone(), place.clone()))
        .collect();
    for (name, place) in inner {
        if let Some(found) = open(&name, &place, depth + 1, unpacking)? {
            opened.files.remove(&name);
            opened.add(found);
        }
    }
    Ok(Some(opened))
}

/// What is in an archive.
#[derive(Debug, Default)]
struct Content {
    /// Files by name.
    members: BTreeMap<String, Member>,
    special: Vec<(String, String)>,
    /// Members that cannot be used; the name is empty for the archive itself.
    refused: Vec<(String, Rejected)>,
    /// What the members are read from.
    read_from: Option<members::ReadFrom>,
}

impl Content {
    fn is_empty(&self) -> bool {
        self.members.is_empty() && self.special.is_empty() && self.refused.is_empty()
    }

    fn members(self, at: &Path) -> Members {
        Members::new(at, self.members, self.read_from)
    }

    /// Refuses a member.
    fn refuse(&mut self, name: &str, code: &'static str, reason: String, at: u64) {
        let rejected = Rejected {
            byte_offset: Some(at),
            ..Rejected::read(code, reason)
        };
        self.refused.push((name.to_owned(), rejected));
    }

    /// Adds a file. Of several members of one name the last is the file, as when it is unpacked.
    fn add(&mut self, name: String, member: Member) {
        if self.members.insert(name.clone(), member).is_some() {
            let reason = "an earlier member of this name in its archive; the last one is read";
            self.special.push((name, reason.to_owned()));
        }
    }
}

/// Lists an archive, and unpacks it where its kind asks for that.
fn content(
    kind: Kind,
    path: &Path,
    unpacking: &Unpacking<'_>,
) -> Result<Result<Content, Rejected>, Error> {
    let size = match ByPath.size(path) {
        Ok(size) => size,
        Err(error) => {
            let reason = format!("cannot read the archive: {error}");
            return Ok(Err(Rejected::read("E-IO", reason)));
        }
    };
    let budget = Budget::new(Limits::default(), size);
    match kind {
        Kind::Zip => Ok(zipped::content(path, budget)),
        Kind::Tar => Ok(tarball::content(path, budget)),
        packed => tarball::unpack(path, packed, budget, unpacking),
    }
}

/// What a member's name means.
enum Named {
    File(String),
    /// It is passed over, and why.
    Special(String, &'static str),
    /// It cannot be the name of a member.
    Refused(String),
}

/// The name of a member as a relative path. Names that lead out of the archive are refused: no system unpacks them.
fn named(raw: &[u8]) -> Named {
    let bytes = |part: &[u8]| super::names::text_of_bytes(part);
    let shown = bytes(raw);
    let is_drive =
        |part: &[u8]| part.len() == 2 && part[1] == b':' && part[0].is_ascii_alphabetic();
    let mut parts = Vec::new();
    for part in raw.split(|byte| *byte == b'/') {
        match part {
            b"" if parts.is_empty() => return Named::Refused(shown),
            b"" | b"." => {}
            b".." => return Named::Refused(shown),
            drive if parts.is_empty() && is_drive(drive) => return Named::Refused(shown),
            part => parts.push(bytes(part)),
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

const CLIMBS: &str =
    "the name of the member leads out of the archive; pack the files by their relative paths";

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

    #[test]
    fn limits_count_members_bytes_and_the_ratio() {
        let limits = Limits {
            members: 3,
            bytes: 1000,
            ratio: 10,
            small: 100,
        };
        let mut budget = Budget::new(limits, 5);
        assert!(budget.take(100).is_ok() && budget.take(0).is_ok());
        assert!(
            budget
                .take(1)
                .is_err_and(|reason| reason.contains("10 times"))
        );
        let mut budget = Budget::new(limits, 500);
        assert!(budget.take(1000).is_ok());
        assert!(budget.take(1).is_err());
        let mut budget = Budget::new(limits, 500);
        assert!((0..3).all(|_| budget.take(1).is_ok()));
        assert!(
            budget
                .take(1)
                .is_err_and(|reason| reason.contains("3 members"))
        );
    }
}
