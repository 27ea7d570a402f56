//! Matches places with the recorded sources of a dataset.
//!
//! A source is known by its name, or by the place that was recorded under a name. There is no matching by similarity:
//! the user has to name an ambiguous source.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use datasets_spec::Progress;
use formats::source::name_of_text;

use super::list::{Listed, Listing, list_sources};
use super::places::Places;
use super::recorded::Recorded;
use super::sources::{Given, Kind, SourceArg, SourceLabel, below, check_name};
use crate::Error;
use crate::names::free;

/// Matches the places of a run with the sources that its dataset records.
pub(super) struct Known<'a> {
    pub(super) out: &'a Path,
    pub(super) recorded: &'a Recorded,
    pub(super) places: &'a Places,
}

/// Sources with their listings, and remarks on how they were recognised.
pub(super) type Identified = (Vec<(Given, Listing)>, Vec<String>);

impl Known<'_> {
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
                return Err(Error::asked(format!(
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
                let paths = self.paths_of(&label.name);
                let own = paths.filter_map(|path| below(&label.label, path));
                source.keep_files(&own.collect());
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

    /// The places of a recorded source that can be read now.
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
            0 => Err(Error::asked(format!(
                "with new settings all sources are read again, and source {name:?} is not where it was or was never \
                 found on this machine; name its place: {name}=PATH"
            ))),
            _ if folders > 1 => Err(Error::asked(format!(
                "with new settings all sources are read again, and source {name:?} is in several places; name the one \
                 to read: {name}=PATH"
            ))),
            _ => Ok(found.into_iter().map(|(arg, _)| arg).collect()),
        }
    }

    fn paths_of(&self, name: &str) -> impl Iterator<Item = &str> {
        let clips = self.recorded.clips.iter();
        let clips = clips.filter(move |clip| self.recorded.sources[clip.source].name == name);
        let rejected = self.recorded.quarantine.iter();
        let rejected = rejected.filter(move |row| row.source_name == name);
        let skipped = self.recorded.skipped.iter();
        let skipped = skipped.filter(move |row| row.source_name == name);
        (clips.map(|clip| clip.path.as_str()))
            .chain(rejected.map(|row| row.path.as_str()))
            .chain(skipped.map(|row| row.path.as_str()))
    }

    pub(super) fn names(
        &self,
        listed: &[Listed],
        remarks: &mut Vec<String>,
    ) -> Result<Vec<String>, Error> {
        let names = listed.iter().map(|source| self.name(source, remarks));
        let names: Vec<String> = names.collect::<Result<_, _>>()?;
        refuse_equal_names(&names, listed)?;
        self.refuse_shared_files(&names, listed)?;
        Ok(names)
    }

    /// Refuses two sources that list the same file, unless the dataset has both already.
    fn refuse_shared_files(&self, names: &[String], listed: &[Listed]) -> Result<(), Error> {
        let named = || names.iter().zip(listed);
        for (name, source) in named() {
            for (other, within) in named().filter(|(other, _)| *other != name) {
                let is_new = self.source(name).is_none() || self.source(other).is_none();
                if is_new && let Some(file) = source.shared_with(within) {
                    return Err(Error::asked(format!(
                        "sources {name:?} ({}) and {other:?} ({}) both hold {file}, whose motions would be ingested \
                         twice; give one of them",
                        source.given.display(),
                        within.given.display()
                    )));
                }
            }
        }
        Ok(())
    }

    fn source(&self, name: &str) -> Option<&SourceLabel> {
        let mut sources = self.recorded.sources.iter();
        sources.find(|source| source.name == name)
    }

    fn labels(&self) -> impl Iterator<Item = &str> {
        let sources = self.recorded.sources.iter();
        sources.map(|source| source.label.as_str())
    }

    /// Paths of the source without a label, if there is one.
    fn unlabelled_paths<'a>(&'a self, names: &[String], listed: &'a [Listed]) -> Vec<&'a str> {
        let Some(index) = self.labels().position(str::is_empty) else {
            return Vec::new();
        };
        let name = self.recorded.sources[index].name.as_str();
        let now = names.iter().zip(listed).filter(|(own, _)| *own == name);
        let now = now.flat_map(|(_, source)| source.listing.files.keys());
        now.map(String::as_str).chain(self.paths_of(name)).collect()
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
            return Err(Error::asked(format!(
                "{given} was given under several names; say which source it is: {}",
                ways.join(" or ")
            )));
        }
        if check_name(own).is_err() {
            return Err(Error::asked(format!(
                "{given} has no name; give it one: NAME={given}"
            )));
        }
        let other = self.other_name(source);
        if self.places.is_empty() && !self.recorded.sources.is_empty() {
            return Err(Error::asked(format!(
                "{} does not record where its sources lie, so whether {given} is one of them must be said. Its \
                 sources: {}. If it is one of them: {}; if it is new: {other}={given}",
                self.out.display(),
                self.counted(),
                self.answers(own, &given.to_string()),
            )));
        }
        if self.source(own).is_some() {
            return Err(Error::asked(format!(
                "{} has a source {own:?} from another place. If it moved to {given}: {own}={given}; if {given} is a \
                 new source, give it another name, such as {other}={given}",
                self.out.display()
            )));
        }
        Ok(own.to_owned())
    }

    /// A free name for a new source, made from the names of its folder and the folder above.
    fn other_name(&self, source: &Listed) -> String {
        let is_free = |name: &str| self.source(name).is_none();
        match source.own_name() {
            own if is_free(&own) => own,
            _ => free(&source.longer_name(), is_free),
        }
    }

    fn counted(&self) -> String {
        let sources = self.recorded.sources.iter().enumerate();
        let counted = sources.map(|(index, source)| {
            let clips = self.recorded.clips.iter();
            let clips = clips.filter(|clip| clip.source == index).count();
            format!("{} ({clips} clips)", source.name)
        });
        counted.collect::<Vec<_>>().join(", ")
    }

    /// Arguments `NAME=PATH` that say which recorded source a place is: the one of the same name, or any.
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
        return Err(Error::asked(format!(
            "several sources are called {name:?}: {}. Give them names of their own, such as {}",
            given.join(", "),
            ways.collect::<Vec<_>>().join(" ")
        )));
    }
    if let Some((place, names)) = by_place.iter().find(|(_, names)| names.len() > 1) {
        return Err(Error::asked(format!(
            "{place} is given under several names: {}; give it once",
            names.join(", ")
        )));
    }
    Ok(())
}
