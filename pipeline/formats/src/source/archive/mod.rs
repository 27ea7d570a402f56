//! Archives among the sources: zip, tar, and tar packed by gzip, bzip2 or xz.
//!
//! An archive acts as a folder of its name. Members of zip and tar archives are read in place. A packed tar can only be
//! read from its beginning, so its members are unpacked into a scratch folder first. In both cases the members have
//! paths below the archive's, which [`datasets_spec::store::ByPath`] serves while the archive is open.

mod content;
mod ending;
mod kind;
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

use self::content::{Content, LIMIT, NAME, unreadable};
use self::kind::Kind;
use self::limits::Budget;
use self::members::Members;
use self::scratch::Scratch;
use self::unpacked::DamagedMember;
use super::{is_pointer, name_of_text, read_head, text_of_name};
use crate::Error;
use clip::Rejected;

pub use self::content::DAMAGED;
pub use self::kind::is_in_archive;
pub(crate) use self::kind::stem;

/// Archives inside an archive are opened; archives inside those are not.
const MAX_DEPTH: usize = 1;

/// Offset in its archive of a damaged member; `None` for other errors.
pub fn offset_of_damaged(error: &io::Error) -> Option<u64> {
    let member: &DamagedMember = error.get_ref()?.downcast_ref()?;
    Some(member.at)
}

/// The outermost archive among a folder and its ancestors; `None` if there is no archive.
fn archive_of(folder: &Path) -> Option<&Path> {
    let mut above: Vec<&Path> = folder.ancestors().collect();
    above.reverse();
    above.into_iter().find(|folder| {
        let name = folder.file_name().map(|name| name.to_string_lossy());
        name.is_some_and(|name| Kind::of_name(&name).is_some()) && ByPath.size(folder).is_ok()
    })
}

/// Members of the opened archives.
#[derive(Debug, Default)]
pub struct Opened {
    /// Members by their relative paths, which begin with that of the archive.
    pub files: BTreeMap<String, PathBuf>,
    /// Members that are not files, and why each is skipped.
    pub special: Vec<(String, String)>,
    /// Archives and members that cannot be used, with the hash of the archive.
    pub refused: Vec<(String, String, Rejected)>,
    /// Open archives; members can be read as long as these are kept.
    pub archives: Archives,
}

/// Archives that are open.
#[derive(Clone, Debug, Default)]
pub struct Archives {
    open: Vec<Arc<Mounted>>,
    /// Paths of the unpacked archives.
    unpacked: Vec<PathBuf>,
}

impl Archives {
    /// Adds the archives of `other`.
    pub fn add(&mut self, other: Self) {
        self.open.extend(other.open);
        self.unpacked.extend(other.unpacked);
    }

    /// The first of the unpacked archives; other processes cannot read its members.
    pub fn unpacked(&self) -> Option<&Path> {
        self.unpacked.first().map(PathBuf::as_path)
    }

    /// Opens the archives that contain some of the paths.
    ///
    /// # Errors
    /// There is no disk space to unpack an archive.
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

/// Folder for unpacking archives, and the progress sink.
struct Unpacking<'a> {
    scratch: Arc<Scratch>,
    progress: &'a dyn Progress,
}

impl<'a> Unpacking<'a> {
    fn new(progress: &'a dyn Progress) -> Self {
        Self {
            scratch: Arc::default(),
            progress,
        }
    }

    /// Number and total megabytes of the archives that must be unpacked before their members can be read; `None` if
    /// there are no such archives.
    fn packed(archives: &[(String, PathBuf)]) -> Option<(usize, u64)> {
        let packed = archives.iter().filter(|(relative, _)| {
            Kind::of_name(relative).is_some_and(|kind| !kind.is_random_access())
        });
        let sizes: Vec<u64> = packed
            .map(|(_, path)| ByPath.size(path).unwrap_or(0))
            .collect();
        (!sizes.is_empty()).then(|| (sizes.len(), unpacked::shown(sizes.iter().sum())))
    }
}

/// Opens the archives among some files and removes them from the files. Git LFS pointers stay.
///
/// # Errors
/// There is no disk space to unpack an archive.
pub fn open_all(
    files: &mut BTreeMap<String, PathBuf>,
    progress: &dyn Progress,
) -> Result<Opened, Error> {
    let archives = archives_in(files);
    let mut all = Opened::default();
    if archives.is_empty() {
        return Ok(all);
    }
    let unpacking = Unpacking::new(progress);
    let packed = Unpacking::packed(&archives);
    if let Some((count, megabytes)) = packed {
        progress.begin("unpack", Some(megabytes));
        progress.message(&format!("MB of {count} archives"));
    }
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
    if let Some((count, megabytes)) = packed {
        progress.finish(&format!("{count} archives of {megabytes} MB"));
    }
    for ((relative, _), opened) in archives.iter().zip(opened) {
        if let Some(opened) = opened {
            files.remove(relative);
            all.add(opened);
        }
    }
    Ok(all)
}

/// The archives among some files, by their names.
fn archives_in(files: &BTreeMap<String, PathBuf>) -> Vec<(String, PathBuf)> {
    let archives = files.iter();
    let archives = archives.filter(|(relative, _)| Kind::of_name(relative).is_some());
    archives
        .map(|(relative, path)| (relative.clone(), path.clone()))
        .collect()
}

fn refuse(relative: &str, path: &Path, rejected: Rejected) -> Opened {
    let hash = ByPath.hash(path).unwrap_or_default();
    Opened {
        refused: vec![(relative.to_owned(), hash, rejected)],
        ..Opened::default()
    }
}

/// Opens an archive. `None` for other files and Git LFS pointers.
fn open(
    relative: &str,
    path: &Path,
    depth: usize,
    unpacking: &Unpacking<'_>,
) -> Result<Option<Opened>, Error> {
    let Some(kind) = Kind::of_name(relative) else {
        return Ok(None);
    };
    if is_pointer(&read_head(path)) {
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
    for (name, reason) in std::mem::take(&mut content.special) {
        opened.special.push((of_archive(&name), reason));
    }
    if !content.refused.is_empty() {
        let hash = ByPath.hash(path).unwrap_or_default();
        for (name, rejected) in std::mem::take(&mut content.refused) {
            let refused = (of_archive(&name), hash.clone(), rejected);
            opened.refused.push(refused);
        }
    }
    for name in content.members.keys() {
        let place = path.join(name_of_text(name));
        opened.files.insert(of_archive(name), place);
    }
    let members = Members::new(path, content.members, content.read_from);
    let mounted = mount(path, Arc::new(members));
    opened.archives.open.push(Arc::new(mounted));
    if !kind.is_random_access() {
        opened.archives.unpacked.push(path.to_owned());
    }
    for (name, place) in archives_in(&opened.files) {
        if let Some(found) = open(&name, &place, depth + 1, unpacking)? {
            opened.files.remove(&name);
            opened.add(found);
        }
    }
    Ok(Some(opened))
}

/// Lists an archive, and unpacks it if its kind requires that.
fn content(
    kind: Kind,
    path: &Path,
    unpacking: &Unpacking<'_>,
) -> Result<Result<Content, Rejected>, Error> {
    let size = match ByPath.size(path) {
        Ok(size) => size,
        Err(error) => return Ok(Err(unreadable(&error))),
    };
    let budget = Budget::new(size);
    match kind {
        Kind::Zip => Ok(zipped::content(path, budget)),
        Kind::Tar => Ok(tarball::content(path, budget)),
        packed => tarball::unpack(path, packed, budget, &unpacking.scratch, unpacking.progress),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_count_members_bytes_and_the_ratio() {
        let of_size = |size: u64| Budget {
            max_members: 3,
            max_bytes: 1000,
            ratio: 10,
            small: 100,
            ..Budget::new(size)
        };
        let mut budget = of_size(5);
        assert!(budget.take(100).is_ok() && budget.take(0).is_ok());
        let reason = budget.take(1).expect_err("too many bytes for its size");
        assert!(reason.contains("10 times"), "{reason}");
        let mut budget = of_size(500);
        assert!(budget.take(1000).is_ok());
        assert!(budget.take(1).is_err());
        let mut budget = of_size(500);
        assert!((0..3).all(|_| budget.take(1).is_ok()));
        let reason = budget.take(1).expect_err("too many members");
        assert!(reason.contains("3 members"), "{reason}");
    }
}
