//! Sources: their names, and which of a dataset's sources a place is.
//!
//! A source is known by its name, or by the place that was recorded under a name. Nothing is compared by likeness:
//! what cannot be known is asked for.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::fmt;
use std::path::{Path, PathBuf};

use datasets_spec::Progress;
use formats::source::{name_of_text, text_of_name};
use serde::{Deserialize, Serialize};

use super::list::{Listed, list_sources, merged};
use super::places::{Kind, Places};
use super::recorded::{Recorded, RecordedClip};
use crate::Error;

pub(crate) use super::list::Listing;

/// Fact of a manifest: the sources, as JSON.
pub(super) const SOURCES_FACT: &str = "sources";

/// A source as it is given: a file, a folder or a URL, with a name or without. As text `NAME=PATH`, or the path
/// alone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SourceArg {
    /// Its name; without one it has that of its folder.
    pub name: Option<String>,
    /// Where it is.
    pub path: PathBuf,
}

impl SourceArg {
    /// Reads `NAME=PATH`, or a path. What stands before the first `=` is a name unless it holds a slash, so a path
    /// with `=` in its first part is written with `./` before it.
    ///
    /// # Errors
    /// The name has characters that names cannot have, or nothing follows it.
    pub fn parse(given: &OsStr) -> Result<Self, String> {
        let bare = || Self::from(PathBuf::from(given));
        let named = given.to_str().and_then(|text| text.split_once('='));
        let Some((name, path)) = named else {
            return Ok(bare());
        };
        if name.is_empty() || name.contains(['/', '\\']) {
            return Ok(bare());
        }
        match check_name(name) {
            Ok(()) if path.is_empty() => Err(format!("a path is expected after {name}=")),
            Ok(()) => Ok(Self {
                name: Some(name.to_owned()),
                path: PathBuf::from(path),
            }),
            Err(_) if Path::new(given).exists() => Ok(bare()),
            Err(reason) => Err(format!(
                "{name:?} cannot be the name of a source: {reason}; a path with = in its first part begins with ./"
            )),
        }
    }

    /// The same source with a relative path taken from a folder.
    #[must_use]
    pub fn below(self, folder: &Path) -> Self {
        let path = match datasets_spec::store::is_url(&self.path) {
            true => self.path,
            false => folder.join(self.path),
        };
        Self { path, ..self }
    }
}

impl From<PathBuf> for SourceArg {
    fn from(path: PathBuf) -> Self {
        Self { name: None, path }
    }
}

impl From<&Path> for SourceArg {
    fn from(path: &Path) -> Self {
        path.to_owned().into()
    }
}

impl fmt::Display for SourceArg {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let path = self.path.display();
        match &self.name {
            Some(name) => write!(f, "{name}={path}"),
            None => write!(f, "{path}"),
        }
    }
}

impl Serialize for SourceArg {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for SourceArg {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        Self::parse(OsStr::new(&text)).map_err(serde::de::Error::custom)
    }
}

/// Whether a character may be part of a name. Names begin ids and paths of tables.
fn is_of_name(c: char) -> bool {
    !c.is_control() && !matches!(c, '/' | '\\' | '#' | '@' | '=')
}

fn check_name(name: &str) -> Result<(), String> {
    match name.chars().find(|c| !is_of_name(*c)) {
        Some(c) => Err(format!("it holds {c:?}")),
        None if matches!(name, "" | "." | "..") => Err("it is no name".to_owned()),
        None => Ok(()),
    }
}

/// A folder's name as the name of a source: other characters become `-`.
pub(super) fn name_of_folder(folder: &Path) -> String {
    let name = text_of_name(folder.file_name().unwrap_or_default());
    let replaced = name.chars().map(|c| if is_of_name(c) { c } else { '-' });
    replaced.collect()
}

/// A source of a dataset.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct SourceLabel {
    /// What the paths of its files begin with; empty for the first source of a dataset.
    pub(super) label: String,
    /// Its name. Datasets of earlier builds have the name of the folder, which several sources may share.
    pub(super) name: String,
}

/// A source of a run.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Given {
    pub(super) label: SourceLabel,
    /// Whether all that is below its folder was listed; else only the files that were given.
    pub(super) is_whole: bool,
    /// The folder or URL where the source was found; it is never published.
    pub(super) places: Vec<(String, Kind)>,
}

/// All files of the sources by their relative path, each behind the label of its source, and those of each source.
pub(crate) fn list_files(sources: &[PathBuf], progress: &dyn Progress) -> Result<Listing, Error> {
    let sources: Vec<SourceArg> = sources.iter().cloned().map(SourceArg::from).collect();
    let listed = list_sources(&sources, None, progress)?;
    let labels = numbered_labels(&listed);
    Ok(merged(
        listed.into_iter().map(|source| source.listing).zip(labels),
    ))
}

/// Lists every source for itself, with a label that keeps its files apart from those of the others.
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

/// Labels where nothing is recorded: none for a single source, else the names, with numbers where several places have
/// one name.
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

/// The first of a name and the name with numbers that is free.
pub(super) fn free(name: &str, mut is_free: impl FnMut(&str) -> bool) -> String {
    let numbered = (2..).map(|number| format!("{name}-{number}"));
    let mut candidates = std::iter::once(name.to_owned()).chain(numbered);
    let found = candidates.find(|candidate| is_free(candidate));
    found.expect("numbers do not end")
}

/// A path without its label; none if it has another.
pub(super) fn below<'a>(label: &str, path: &'a str) -> Option<&'a str> {
    match label {
        "" => Some(path),
        label => path.strip_prefix(label)?.strip_prefix('/'),
    }
}

/// The sources of a dataset with names of their own. Sources of earlier builds with equal names are named by their
/// labels.
pub(super) fn with_names(sources: Vec<SourceLabel>) -> Vec<SourceLabel> {
    let names: BTreeSet<&str> = sources.iter().map(|source| source.name.as_str()).collect();
    let is_valid = |source: &SourceLabel| check_name(&source.name).is_ok();
    if names.len() == sources.len() && sources.iter().all(is_valid) {
        return sources;
    }
    let mut taken = BTreeSet::new();
    let named = sources.into_iter().map(|source| {
        let wanted = match source.label.as_str() {
            "" => source.name.as_str(),
            label => label,
        };
        let wanted: String = wanted
            .chars()
            .map(|c| if is_of_name(c) { c } else { '-' })
            .collect();
        let wanted = if wanted.is_empty() { UNNAMED } else { &wanted };
        let name = free(wanted, |name| taken.insert(name.to_owned()));
        SourceLabel { name, ..source }
    });
    named.collect()
}

/// Source name of clips without a recorded source: earlier builds recorded none for single files.
pub(super) const UNNAMED: &str = "unnamed";

/// The source of a path by its longest label, for rows of earlier builds.
pub(super) fn of_path(sources: &[SourceLabel], path: &str) -> Option<usize> {
    let places = sources.iter().enumerate();
    let found = places.filter(|(_, source)| below(&source.label, path).is_some());
    let longest = found.max_by_key(|(_, source)| source.label.len());
    longest.map(|(index, _)| index)
}

/// What a run knows of the sources of its dataset.
pub(super) struct Known<'a> {
    /// The dataset, as it was given.
    pub(super) out: &'a Path,
    pub(super) recorded: &'a Recorded,
    pub(super) places: &'a Places,
}

/// Sources with their listings, and remarks on how they were recognised.
pub(super) type Identified = (Vec<(Given, Listing)>, Vec<String>);

impl Known<'_> {
    /// Says which source each listing is.
    ///
    /// # Errors
    /// It cannot be known; the error says how to answer.
    pub(super) fn identify(&self, listed: Vec<Listed>) -> Result<Identified, Error> {
        let mut remarks = Vec::new();
        let names = self.names(&listed, &mut remarks)?;
        let is_alone = self.recorded.sources.is_empty() && listed.len() == 1;
        let paths = self.unlabelled_paths(&names, &listed);
        let mut taken: BTreeSet<String> = self.labels().map(str::to_owned).collect();
        let mut found = Vec::new();
        for (name, source) in names.iter().zip(&listed) {
            let label = match self.source(name) {
                Some(known) => known.label.clone(),
                None if is_alone => String::new(),
                None => free(name, |label| {
                    !paths.iter().any(|path| below(label, path).is_some())
                        && taken.insert(label.to_owned())
                }),
            };
            if let ("", Some(other)) = (label.as_str(), self.folder_like_a_label(source)) {
                return Err(asked(format!(
                    "source {name:?} has a folder {other:?}, and paths of the dataset that begin with {other}/ are \
                     those of another source; give the folder another name"
                )));
            }
            found.push(SourceLabel {
                label,
                name: name.clone(),
            });
        }
        let found = found.into_iter().zip(listed).map(|(label, source)| {
            remarks.extend(source.left_out_remarks(&label.name));
            let given = Given {
                label,
                is_whole: source.is_whole,
                places: source.places,
            };
            (given, source.listing)
        });
        let mut found: Vec<(Given, Listing)> = found.collect();
        found.sort_by(|(a, _), (b, _)| a.label.name.cmp(&b.label.name));
        remarks.sort();
        Ok((found, remarks))
    }

    /// The recorded sources with clips that are not among `given`, listed where they were found before.
    ///
    /// # Errors
    /// One of them is not there any more, or in several places.
    pub(super) fn others(
        &self,
        given: &[(Given, Listing)],
        progress: &dyn Progress,
    ) -> Result<Identified, Error> {
        let mut args = Vec::new();
        for (index, source) in self.recorded.sources.iter().enumerate() {
            let is_given = given
                .iter()
                .any(|(given, _)| given.label.name == source.name);
            let has_clips = self.recorded.clips.iter().any(|clip| clip.source == index);
            if !is_given && has_clips {
                args.extend(self.reached(source)?);
            }
        }
        if args.is_empty() {
            return Ok(Identified::default());
        }
        let mut listed = list_sources(&args, Some(self.out), progress)?;
        for source in &mut listed {
            let label = source.name.as_deref().and_then(|name| self.source(name));
            let kinds: Vec<(&str, Kind)> =
                label.map_or(Vec::new(), |label| self.places.of(&label.name).collect());
            if let (Some(label), true) =
                (label, kinds.contains(&(source.place.as_str(), Kind::Files)))
            {
                source.keep_files(&self.paths_of(label));
            }
        }
        let names: Vec<&str> = listed
            .iter()
            .filter_map(|source| source.name.as_deref())
            .collect();
        let remark = format!(
            "the settings changed, so sources that were not named were read again too: {}",
            names.join(", ")
        );
        let (found, mut remarks) = self.identify(listed)?;
        remarks.push(remark);
        Ok((found, remarks))
    }

    /// A recorded source where it can be reached.
    fn reached(&self, source: &SourceLabel) -> Result<Vec<SourceArg>, Error> {
        let name = &source.name;
        let arg = |place: &str| SourceArg {
            name: Some(name.clone()),
            path: PathBuf::from(name_of_text(place)),
        };
        let found: Vec<(SourceArg, Kind)> = self
            .places
            .of(name)
            .map(|(place, kind)| (arg(place), kind))
            .filter(|(arg, _)| Listed::is_there(arg))
            .collect();
        let folders = found.iter().filter(|(_, kind)| *kind != Kind::File).count();
        match found.len() {
            0 => Err(asked(format!(
                "with new settings all sources are read again, and source {name:?} is not where it was or was never \
                 found on this machine; name its place: {name}=PATH"
            ))),
            _ if folders > 1 => Err(asked(format!(
                "with new settings all sources are read again, and source {name:?} is in several places; name the one \
                 to read: {name}=PATH"
            ))),
            _ => Ok(found.into_iter().map(|(arg, _)| arg).collect()),
        }
    }

    /// Recorded paths of a source, without its label.
    fn paths_of(&self, source: &SourceLabel) -> BTreeSet<&str> {
        let name = source.name.as_str();
        let is_of = |clip: &&RecordedClip| self.recorded.sources[clip.source].name == name;
        let clips = self
            .recorded
            .clips
            .iter()
            .filter(is_of)
            .map(|clip| clip.path.as_str());
        let rejected = self
            .recorded
            .quarantine
            .iter()
            .filter(|row| row.source_name == name);
        let skipped = self
            .recorded
            .skipped
            .iter()
            .filter(|row| row.source_name == name);
        let paths = clips
            .chain(rejected.map(|row| row.path.as_str()))
            .chain(skipped.map(|row| row.path.as_str()));
        paths
            .filter_map(|path| below(&source.label, path))
            .collect()
    }

    /// The name of every source.
    ///
    /// # Errors
    /// As [`Known::identify`].
    pub(super) fn names(
        &self,
        listed: &[Listed],
        remarks: &mut Vec<String>,
    ) -> Result<Vec<String>, Error> {
        let names = listed.iter().map(|source| self.name(source, remarks));
        let names: Vec<String> = names.collect::<Result<_, _>>()?;
        refuse_equal_names(&names, listed)?;
        Ok(names)
    }

    fn source(&self, name: &str) -> Option<&SourceLabel> {
        let mut sources = self.recorded.sources.iter();
        sources.find(|source| source.name == name)
    }

    fn labels(&self) -> impl Iterator<Item = &str> {
        let sources = self.recorded.sources.iter();
        sources.map(|source| source.label.as_str())
    }

    /// Paths of the source without a label, as far as there is one.
    fn unlabelled_paths<'a>(&'a self, names: &[String], listed: &'a [Listed]) -> Vec<&'a str> {
        let Some(index) = self.labels().position(str::is_empty) else {
            return Vec::new();
        };
        let name = self.recorded.sources[index].name.as_str();
        let now = names.iter().zip(listed).filter(|(own, _)| *own == name);
        let now = now.flat_map(|(_, source)| source.listing.files.keys());
        let clips = self.recorded.clips.iter();
        let clips = clips.filter(|clip| clip.source == index);
        let rejected = self.recorded.quarantine.iter();
        let rejected = rejected.filter(|row| row.source_name == name);
        let skipped = self.recorded.skipped.iter();
        let skipped = skipped.filter(|row| row.source_name == name);
        now.map(String::as_str)
            .chain(clips.map(|clip| clip.path.as_str()))
            .chain(rejected.map(|row| row.path.as_str()))
            .chain(skipped.map(|row| row.path.as_str()))
            .collect()
    }

    /// A label of another source that is also a folder of this one.
    fn folder_like_a_label(&self, listed: &Listed) -> Option<&str> {
        let mut labels = self.labels().filter(|label| !label.is_empty());
        let files = &listed.listing.files;
        let is_there = |label: &&str| {
            let first = files.range(format!("{label}/")..).next();
            first.is_some_and(|(path, _)| below(label, path).is_some())
        };
        labels.find(is_there)
    }

    /// The name of a source.
    fn name(&self, source: &Listed, remarks: &mut Vec<String>) -> Result<String, Error> {
        if let Some(name) = &source.name {
            return Ok(name.clone());
        }
        let (folder, given) = (source.own_name(), source.given.display());
        let own = folder.as_str();
        let at = source.names_in(self.places);
        let at: BTreeSet<&str> = at
            .into_iter()
            .filter(|name| self.source(name).is_some())
            .collect();
        let named = at.get(own).or(at.first().filter(|_| at.len() == 1));
        if let Some(name) = named {
            if *name != own {
                remarks.push(format!("folder {own} is source {name}, as recorded before"));
            }
            return Ok((*name).to_owned());
        }
        if !at.is_empty() {
            let ways: Vec<String> = at.iter().map(|name| format!("{name}={given}")).collect();
            return Err(asked(format!(
                "{given} was given under several names; say which source it is: {}",
                ways.join(" or ")
            )));
        }
        if check_name(own).is_err() {
            return Err(asked(format!(
                "{given} has no name; give it one: NAME={given}"
            )));
        }
        let other = self.other_name(source);
        if self.places.is_empty() && !self.recorded.sources.is_empty() {
            return Err(asked(format!(
                "{} does not record where its sources lie, so whether {given} is one of them must be said. Its \
                 sources: {}. If it is one of them: {}; if it is new: {other}={given}",
                self.out.display(),
                self.counted(),
                self.answers(own, &given.to_string()),
            )));
        }
        if self.source(own).is_some() {
            return Err(asked(format!(
                "{} has a source {own:?} from another place. If it moved to {given}: {own}={given}; if {given} is a \
                 new source, give it another name, such as {other}={given}",
                self.out.display()
            )));
        }
        Ok(own.to_owned())
    }

    /// A free name for a source that is new, made of the names of its folder and the one above.
    fn other_name(&self, source: &Listed) -> String {
        let is_free = |name: &str| self.source(name).is_none();
        match source.own_name() {
            own if is_free(&own) => own,
            _ => free(&source.longer_name(), is_free),
        }
    }

    /// The sources with their clips, in words.
    fn counted(&self) -> String {
        let sources = self.recorded.sources.iter().enumerate();
        let counted = sources.map(|(index, source)| {
            let clips = self.recorded.clips.iter();
            let clips = clips.filter(|clip| clip.source == index).count();
            format!("{} ({clips} clips)", source.name)
        });
        counted.collect::<Vec<_>>().join(", ")
    }

    /// How to say that a place is a recorded source: the one of its name, or any.
    fn answers(&self, own: &str, given: &str) -> String {
        if self.source(own).is_some() {
            return format!("{own}={given}");
        }
        let sources = self.recorded.sources.iter();
        let ways: Vec<String> = sources
            .map(|source| format!("{}={given}", source.name))
            .collect();
        ways.join(" or ")
    }
}

fn asked(reason: String) -> Error {
    Error::AskedSource { reason }
}

/// Refuses two sources of one name, and one place under two names.
fn refuse_equal_names(names: &[String], listed: &[Listed]) -> Result<(), Error> {
    let mut by_name: BTreeMap<&str, Vec<&Listed>> = BTreeMap::new();
    let mut by_place: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for (name, source) in names.iter().zip(listed) {
        by_name.entry(name).or_default().push(source);
        if source.is_whole {
            by_place
                .entry(source.place.as_str())
                .or_default()
                .push(name);
        }
    }
    if let Some((name, sources)) = by_name.iter().find(|(_, sources)| sources.len() > 1) {
        let given = |source: &&Listed| source.given.display().to_string();
        let given: Vec<String> = sources.iter().map(given).collect();
        let mut taken = BTreeSet::new();
        let ways = sources.iter().zip(&given).map(|(source, given)| {
            let other = free(&source.longer_name(), |other| {
                taken.insert(other.to_owned())
            });
            format!("{other}={given}")
        });
        return Err(asked(format!(
            "several sources are called {name:?}: {}. Give them names of their own, such as {}",
            given.join(", "),
            ways.collect::<Vec<_>>().join(" ")
        )));
    }
    if let Some((place, names)) = by_place.iter().find(|(_, names)| names.len() > 1) {
        return Err(asked(format!(
            "{place} is given under several names: {}; give it once",
            names.join(", ")
        )));
    }
    Ok(())
}
