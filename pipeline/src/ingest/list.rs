//! Listing of the source files, with their hashes and first bytes.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use clip::Rejected;
use datasets_spec::Progress;
use datasets_spec::dataset::PRIVATE;
use datasets_spec::record::QuarantineRow;
use datasets_spec::store::{ByPath, Store, is_url};
use formats::sidecar::Sidecar;
use formats::source::archive::{self, Archives};
use formats::source::labels::names_in_folder;
use formats::source::text_of_name;
use formats::source::{Entry, read_head};
use rayon::prelude::*;

use super::places::Places;
use super::sources::{Kind, SourceArg, name_of_folder};
use crate::Error;
use crate::names::free;

#[derive(Clone, Debug)]
pub(super) struct Source {
    /// Index of the file's source in [`PlanNotes::given`](super::plan::PlanNotes).
    pub(super) of: usize,
    pub(super) hash: Result<String, String>,
    /// Offset in its archive, if it is a damaged member.
    pub(super) damaged_at: Option<u64>,
    pub(super) head: Vec<u8>,
    /// Size of the file; 0 if it is not known.
    pub(super) bytes: u64,
}

/// BLAKE3 of a source file; empty if the file is not known or cannot be read.
pub(super) fn source_hash<'a>(sources: &'a BTreeMap<String, Source>, relative: &str) -> &'a str {
    let source = sources.get(relative);
    let hash = source.and_then(|source| source.hash.as_deref().ok());
    hash.unwrap_or_default()
}

/// The regular files under some sources, by their relative paths, and other entries with the reason why
/// each is skipped.
#[derive(Default)]
pub(crate) struct Listing {
    pub(crate) files: BTreeMap<String, PathBuf>,
    /// Relative path and reason of other entries.
    pub(crate) special: Vec<(String, String)>,
    /// Folders that cannot be listed, and why.
    pub(crate) unlisted: Vec<(String, String)>,
    /// Archives and members of archives that cannot be used, with the hash of the archive.
    pub(crate) refused: Vec<(String, String, Rejected)>,
    /// Archives whose members are among the files. The members can be read as long as this value is kept.
    pub(crate) archives: Archives,
}

const FOLDER_LINK: &str =
    "link to a folder, not followed; name the folder it leads to as a source of its own";

#[derive(Default)]
pub(crate) struct Listed {
    pub(super) name: Option<String>,
    /// The given path; of several files, the first.
    pub(super) given: PathBuf,
    /// The folder as text, with links resolved where possible.
    pub(super) place: String,
    folder: PathBuf,
    /// Whether everything below the folder is listed; otherwise only the given files are.
    pub(super) is_whole: bool,
    /// Names of the given files, if only those are listed. Archives are listed here, but not their members.
    given_files: BTreeSet<String>,
    /// Places to record for the source, with their kinds.
    pub(super) places: Vec<(String, Kind)>,
    /// Folders that are left out because they are datasets, and whether each is the output dataset.
    left_out: BTreeMap<String, bool>,
    pub(super) listing: Listing,
}

struct Located<'a> {
    arg: &'a SourceArg,
    /// The given folder, or the folder of the given file, with links resolved.
    folder: PathBuf,
    file: Option<PathBuf>,
}

impl<'a> Located<'a> {
    fn find(arg: &'a SourceArg) -> Result<Self, Error> {
        use std::io::ErrorKind::NotFound;

        let missing = || Error::missing_source(&arg.path);
        let (path, is_file) = if is_url(&arg.path) {
            let text = arg.path.to_string_lossy();
            let path = PathBuf::from(text.trim_end_matches('/'));
            let is_file = match ByPath.size(&path) {
                Ok(_) => true,
                Err(error) if error.kind() == NotFound => false,
                Err(error) => return Err(datasets_spec::Error::io("read", &arg.path)(error).into()),
            };
            (path, is_file)
        } else {
            let metadata = fs::metadata(&arg.path).map_err(|error| match error.kind() {
                NotFound => missing(),
                _ => datasets_spec::Error::io("read", &arg.path)(error).into(),
            })?;
            let path = fs::canonicalize(&arg.path).unwrap_or_else(|_| arg.path.clone());
            (path, metadata.is_file())
        };
        let (folder, file) = match is_file {
            true => (path.parent().unwrap_or(&path).to_owned(), Some(path)),
            false => (path, None),
        };
        Ok(Self { arg, folder, file })
    }

    fn is_in(&self, listed: &Listed) -> bool {
        let name = self.arg.name.as_ref();
        let is_named = name.is_none() || listed.name.as_ref() == name;
        is_named
            && listed.folder == self.folder
            && (listed.is_whole || self.file.is_some() && listed.name.as_ref() == name)
    }

    fn list(&self, out: Option<&Path>) -> Result<Listed, Error> {
        let mut listed = Listed {
            name: self.arg.name.clone(),
            given: self.arg.path.clone(),
            place: text_of_name(self.folder.as_os_str()),
            folder: self.folder.clone(),
            is_whole: self.file.is_none(),
            ..Listed::default()
        };
        if listed.is_whole {
            listed.places.push((listed.place.clone(), Kind::Folder));
            match is_url(&self.folder) {
                true => listed.listing.list_url(&self.folder, &self.arg.path)?,
                false => listed.listing.walk(&self.arg.path, String::new()),
            }
            listed.leave_datasets_out(out)?;
        }
        Ok(listed)
    }
}

impl Listed {
    pub(super) fn own_name(&self) -> String {
        name_of_folder(&self.folder)
    }

    pub(super) fn longer_name(&self) -> String {
        let above = self.folder.parent().map(name_of_folder);
        match above.filter(|above| !above.is_empty()) {
            Some(above) => format!("{above}-{}", self.own_name()),
            None => self.own_name(),
        }
    }

    pub(super) fn names_in<'a>(&self, places: &'a Places) -> BTreeSet<&'a str> {
        let files = self
            .given_files
            .iter()
            .map(|file| format!("{}/{file}", self.place));
        let mut of_files = files.map(|file| places.names_at(&file, &[Kind::File]));
        let of_folder = || places.names_at(&self.place, &[Kind::Folder, Kind::Files]);
        match of_files.next().filter(|_| !self.is_whole) {
            Some(first) if !first.is_empty() && of_files.all(|names| names == first) => first,
            _ => of_folder(),
        }
    }

    /// A file other than labels and licences that another source in the same folder, or in one below, lists too.
    pub(super) fn shared_with(&self, other: &Self) -> Option<String> {
        let below = other.folder.strip_prefix(&self.folder).ok()?;
        let below: Vec<String> = below.iter().map(text_of_name).collect();
        let below = below.join("/");
        let is_label = |file: &str| {
            let name = file.rsplit('/').next().unwrap_or(file);
            names_in_folder().any(|label| label.eq_ignore_ascii_case(name))
        };
        let mut files = other.listing.files.keys().filter(|file| !is_label(file));
        let is_here = |file: &String| self.listing.files.contains_key(file);
        files.find_map(|file| Some(labelled(&below, file)).filter(is_here))
    }

    pub(super) fn is_there(arg: &SourceArg) -> bool {
        let holds_files = |folder: &Path| {
            // A folder at a URL counts as present; listing it shows whether it is.
            is_url(folder) || fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_some())
        };
        Located::find(arg)
            .is_ok_and(|located| located.file.is_some() || holds_files(&located.folder))
    }

    /// Keeps only these files, as if no others had been given.
    pub(super) fn keep_files(&mut self, files: &BTreeSet<&str>) {
        self.listing
            .files
            .retain(|file, _| files.contains(file.as_str()));
        self.is_whole = false;
        self.places = vec![(self.place.clone(), Kind::Files)];
    }

    fn add(&mut self, located: &Located<'_>) {
        let Some(file) = &located.file else { return };
        if self.is_whole {
            return;
        }
        let name = text_of_name(file.file_name().unwrap_or_default());
        let place = match located.arg.name {
            Some(_) => (text_of_name(file.as_os_str()), Kind::File),
            None => (self.place.clone(), Kind::Files),
        };
        if !self.places.contains(&place) {
            self.places.push(place);
        }
        let path = match is_url(file) {
            true => file.clone(),
            false => located.arg.path.clone(),
        };
        self.given_files.insert(name.clone());
        self.listing.files.entry(name).or_insert(path);
    }

    /// Leaves datasets out that lie in the folder. A dataset that is itself the source is read.
    fn leave_datasets_out(&mut self, out: Option<&Path>) -> Result<(), Error> {
        let out = out.map(resolved);
        let own = out.and_then(|out| {
            let relative = out.strip_prefix(&self.folder).ok()?;
            let names: Vec<String> = relative.iter().map(text_of_name).collect();
            Some(names.join("/"))
        });
        if own.as_deref() == Some("") {
            return Err(Error::asked(format!(
                "{} is the dataset and its source at the same time; write the dataset to another folder",
                self.given.display()
            )));
        }
        let roots = self
            .listing
            .files
            .keys()
            .filter_map(|file| root_of_dataset(file));
        self.left_out = roots.map(|root| (root.to_owned(), false)).collect();
        self.left_out.extend(own.map(|own| (own, true)));
        let left_out = &self.left_out;
        let is_in = |path: &str| {
            let top = path.split_once('/').map(|(top, _)| top);
            let ends = path.match_indices('/').map(|(end, _)| end);
            let mut folders = ends.chain([path.len()]).map(|end| &path[..end]);
            top == Some(PRIVATE) || folders.any(|folder| left_out.contains_key(folder))
        };
        let listing = &mut self.listing;
        listing.files.retain(|file, _| !is_in(file));
        listing.special.retain(|(path, _)| !is_in(path));
        listing.unlisted.retain(|(folder, _)| !is_in(folder));
        Ok(())
    }

    /// Remarks on folders that were left out. `name` is that of the source.
    pub(super) fn left_out_remarks(&self, name: &str) -> Vec<String> {
        let left_out = self.left_out.iter();
        let remarks = left_out.map(|(folder, is_own)| match is_own {
            true => format!("folder {folder} of source {name} is the dataset that is written and was left out"),
            false => format!(
                "folder {folder} of source {name} is a dataset and was left out; give it as a source to read it"
            ),
        });
        remarks.collect()
    }
}

/// The folder of a dataset, by the path of its manifest; `None` for a dataset that is the source itself.
fn root_of_dataset(file: &str) -> Option<&str> {
    let (meta, name) = file.rsplit_once('/')?;
    let number = name.strip_prefix("manifest-")?.strip_suffix(".json")?;
    number.parse::<u64>().ok()?;
    meta.strip_suffix("/meta")
}

/// A path without links, as far as it exists.
fn resolved(path: &Path) -> PathBuf {
    if is_url(path) {
        return PathBuf::from(path.to_string_lossy().trim_end_matches('/'));
    }
    let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    for above in path.ancestors() {
        if let (Ok(found), Ok(rest)) = (fs::canonicalize(above), path.strip_prefix(above)) {
            return found.join(rest);
        }
    }
    path
}

/// The files of every source, by their paths relative to it. A source that is given twice is listed once. Files of
/// one folder are one source. `out` is the dataset that will be written.
pub(crate) fn list_sources(
    sources: &[SourceArg],
    out: Option<&Path>,
    progress: &dyn Progress,
) -> Result<Vec<Listed>, Error> {
    let located = sources.iter().map(Located::find);
    let mut located: Vec<Located> = located.collect::<Result<_, _>>()?;
    // Folders come before files, and named sources before unnamed ones.
    located.sort_by_key(|located| (located.file.is_some(), located.arg.name.is_none()));
    let mut listed: Vec<Listed> = Vec::new();
    for source in &located {
        let known = listed.iter().position(|listed| source.is_in(listed));
        let place = match known {
            Some(place) => place,
            None => {
                listed.push(source.list(out)?);
                listed.len() - 1
            }
        };
        listed[place].add(source);
    }
    for source in &mut listed {
        source.listing.open_archives(progress)?;
    }
    if listed.iter().all(|source| source.listing.files.is_empty()) {
        let paths = sources.iter().map(|source| source.path.display());
        let paths: Vec<String> = paths.map(|path| path.to_string()).collect();
        let hint = listed.first().map(|source| source.listing.why_empty());
        let hint = hint.unwrap_or_default();
        return Err(Error::no_files(&paths.join(", "), &hint));
    }
    Ok(listed)
}

/// The files of the sources of a run, whose dataset is at `out`.
pub(super) fn list_given<S: Clone + Into<SourceArg>>(
    sources: &[S],
    out: &Path,
    progress: &dyn Progress,
) -> Result<Vec<Listed>, Error> {
    let sources: Vec<SourceArg> = sources.iter().cloned().map(Into::into).collect();
    list_sources(&sources, Some(out), progress)
}

/// All files of the sources by their relative path, prefixed with the label of their source. Members of archives can be
/// read as long as the archives are kept.
pub(crate) fn list_files(
    sources: &[PathBuf],
    progress: &dyn Progress,
) -> Result<(BTreeMap<String, PathBuf>, Archives), Error> {
    let sources: Vec<SourceArg> = sources.iter().cloned().map(SourceArg::from).collect();
    let listed = list_sources(&sources, None, progress)?;
    let labels = numbered_labels(&listed);
    let (mut all, mut archives) = (BTreeMap::new(), Archives::default());
    for (source, label) in listed.into_iter().zip(labels) {
        let files = source.listing.files.into_iter();
        all.extend(files.map(|(name, path)| (labelled(&label, &name), path)));
        archives.add(source.listing.archives);
    }
    Ok((all, archives))
}

/// Lists every source separately, with a label that keeps its files apart from those of the others.
pub(crate) fn list_each<'a>(
    sources: &'a [PathBuf],
    progress: &dyn Progress,
) -> Result<Vec<(&'a Path, String, Listing)>, Error> {
    let list = |source: &PathBuf| list_sources(&[source.clone().into()], None, progress);
    let listed: Vec<Listed> = sources
        .iter()
        .map(list)
        .collect::<Result<Vec<_>, _>>()?
        .into_iter()
        .flatten()
        .collect();
    let labels = numbered_labels(&listed);
    let each = sources.iter().zip(labels).zip(listed);
    Ok(each
        .map(|((source, label), listed)| (source.as_path(), label, listed.listing))
        .collect())
}

/// Labels for sources without a record: empty for a single place, otherwise the name, with a number if several places
/// have the same name.
fn numbered_labels(listed: &[Listed]) -> Vec<String> {
    let places: BTreeSet<&str> = listed.iter().map(|source| source.place.as_str()).collect();
    let mut labels: BTreeMap<&str, String> = BTreeMap::new();
    let mut taken = BTreeSet::new();
    for source in listed.iter().filter(|_| places.len() > 1) {
        labels
            .entry(&source.place)
            .or_insert_with(|| free(&source.own_name(), |label| taken.insert(label.to_owned())));
    }
    let labels = listed
        .iter()
        .map(|source| labels.get(source.place.as_str()));
    labels
        .map(|label| label.cloned().unwrap_or_default())
        .collect()
}

/// The only motion of a file.
pub(super) fn whole(file: &str) -> Entry {
    Entry {
        file: file.to_owned(),
        ..Entry::default()
    }
}

/// A path relative to a source, prefixed with the label of the source.
pub(crate) fn labelled(label: &str, name: &str) -> String {
    match label {
        "" => name.to_owned(),
        label => format!("{label}/{name}"),
    }
}

impl Listing {
    fn list_url(&mut self, folder: &Path, given: &Path) -> Result<(), Error> {
        let files = ByPath.files_below(folder);
        for file in files.map_err(datasets_spec::Error::io("list", given))? {
            let parts = file.strip_prefix(folder).unwrap_or(&file).iter();
            let names: Vec<String> = parts.map(text_of_name).collect();
            self.files.insert(names.join("/"), file);
        }
        match self.files.is_empty() {
            true => Err(Error::missing_source(given)),
            false => Ok(()),
        }
    }

    fn walk(&mut self, source: &Path, prefix: String) {
        let mut folders = vec![(source.to_owned(), prefix)];
        while let Some((folder, relative)) = folders.pop() {
            let listed = fs::read_dir(&folder).and_then(|entries| {
                for entry in entries {
                    let entry = entry?;
                    let name = text_of_name(&entry.file_name());
                    let relative = match relative.as_str() {
                        "" => name,
                        parent => format!("{parent}/{name}"),
                    };
                    let kind = entry.file_type()?;
                    if kind.is_dir() {
                        folders.push((entry.path(), relative));
                    } else {
                        self.take(&entry.path(), relative, kind.is_file());
                    }
                }
                Ok(())
            });
            if let Err(error) = listed {
                let name = match relative.as_str() {
                    "" => ".".to_owned(),
                    relative => relative.to_owned(),
                };
                self.unlisted.push((name, error.to_string()));
            }
        }
    }

    /// Replaces archives by their members.
    fn open_archives(&mut self, progress: &dyn Progress) -> Result<(), Error> {
        let opened = archive::open_all(&mut self.files, progress)?;
        self.files.extend(opened.files);
        self.special.extend(opened.special);
        self.refused.extend(opened.refused);
        self.archives.add(opened.archives);
        Ok(())
    }

    /// Adds an entry that is not a folder.
    fn take(&mut self, path: &Path, relative: String, is_file: bool) {
        // A link to a folder could lead back here, and opening a pipe waits for ever. A dangling link
        // is kept, so that reading it reports what is missing.
        let special = match (is_file, fs::metadata(path)) {
            (true, _) | (_, Err(_)) => None,
            (false, Ok(target)) if target.is_file() => None,
            (false, Ok(target)) if target.is_dir() => Some(FOLDER_LINK),
            (false, Ok(_)) => Some("pipe, socket or device"),
        };
        match special {
            Some(reason) => self.special.push((relative, reason.to_owned())),
            None => {
                self.files.insert(relative, path.to_owned());
            }
        }
    }

    fn why_empty(&self) -> String {
        if let Some((folder, reason)) = self.unlisted.first() {
            return format!("folder {folder} cannot be listed: {reason}");
        }
        if let Some((name, _, rejected)) = self.refused.first() {
            return format!("{name} cannot be read: {}", rejected.reason);
        }
        match self.special.first() {
            Some((_, reason)) => {
                format!("all {} entries are skipped: {reason}", self.special.len())
            }
            None => "is the archive unpacked there?".to_owned(),
        }
    }
}

/// Files at URLs that are hashed at the same time.
const NUM_REQUESTS: usize = 32;

/// Hashes and first bytes of files, which are given with the numbers of their sources.
pub(super) fn hash_files(
    store: &dyn Store,
    files: &BTreeMap<String, (PathBuf, usize)>,
    progress: &dyn Progress,
) -> BTreeMap<String, Source> {
    progress.begin("plan", Some(files.len() as u64));
    let hash = |(relative, (path, of)): (&String, &(PathBuf, usize))| {
        let hash = store.hash(path);
        let source = Source {
            of: *of,
            damaged_at: hash.as_ref().err().and_then(archive::offset_of_damaged),
            hash: hash.map_err(|error| error.to_string()),
            head: read_head(path),
            bytes: store.size(path).unwrap_or(0),
        };
        progress.advance(1);
        (relative.clone(), source)
    };
    let hash = || files.par_iter().map(hash).collect();
    // Reading files at URLs is mostly waiting, so use more threads than cores.
    let waiting = rayon::ThreadPoolBuilder::new().num_threads(NUM_REQUESTS);
    let sources: BTreeMap<String, Source> = match waiting.build() {
        Ok(pool) if files.values().any(|(path, _)| is_url(path)) => pool.install(hash),
        _ => hash(),
    };
    progress.finish(&format!("{} files", sources.len()));
    sources
}

/// The row of a file that was rejected; `key` names one of several motions of it.
pub(crate) fn quarantine_row(
    file: &str,
    key: &str,
    source_name: &str,
    source_hash: String,
    rejected: Rejected,
) -> QuarantineRow {
    QuarantineRow {
        path: path_of(file, key),
        source_name: source_name.to_owned(),
        source_hash,
        inputs_hash: String::new(),
        code: rejected.code.to_owned(),
        reason: rejected.reason,
        byte_offset: rejected.byte_offset,
        stage: rejected.stage.to_owned(),
    }
}

/// Path of a motion: that of its file, and its key if the file holds several.
pub(super) fn path_of(file: &str, key: &str) -> String {
    match key {
        "" => file.to_owned(),
        // Names of motions come from files and may hold anything.
        key => format!("{file}#{}", text_of_name(key.as_ref())),
    }
}

/// The reason for skipping a caption file or a sidecar where it depends on whether a motion lies beside it; `None` if
/// `reason` is right. `motions` are paths without extensions.
pub(crate) fn reason_beside(
    path: &str,
    reason: &str,
    motions: &BTreeSet<&str>,
) -> Option<&'static str> {
    let is_beside = |suffix: &str| path.strip_suffix(suffix).map(|stem| motions.contains(stem));
    if reason.starts_with("sidecar") && is_beside(Sidecar::SUFFIX) == Some(false) {
        return Some("sidecar without a motion");
    }
    let is_caption = reason.starts_with("txt text") && is_beside(".txt") == Some(true);
    is_caption.then_some("captions, read with the motion they describe")
}

pub(crate) fn without_extension(relative: &str) -> &str {
    let name_start = relative.rfind('/').map_or(0, |slash| slash + 1);
    match relative[name_start..].rfind('.') {
        Some(dot) if dot > 0 => &relative[..name_start + dot],
        _ => relative,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_motions_are_listed_without_control_characters() {
        let row = |key| {
            let rejected = Rejected::read("E-PATH", "unusable");
            quarantine_row("a.glb", key, "a", String::new(), rejected).path
        };
        assert_eq!(row(""), "a.glb");
        assert_eq!(row("Walk A"), "a.glb#Walk A");
        assert_eq!(row("Walk\u{1b}[2J\n"), r"a.glb#Walk\x1b[2J\x0a");
    }
}
