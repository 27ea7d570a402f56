//! Plans of ingestion on the disk.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use datasets_spec::Split;
use datasets_spec::record::{QuarantineRow, SkippedRow};
use datasets_spec::store::Store;
use datasets_spec::table::read_rows;
use formats::source::archive::Archives;
use formats::source::labels::FolderLabels;
use formats::source::{Entry, Files, find_releases, format_named, name_of_text, text_of_name};

use super::list::Source;
use super::options::IngestOptions;
use super::plan::{Plan, Planned};
use crate::Error;
use work::{absolute, read_json, write_json, write_table};

const SOURCES: &str = "sources.parquet";
const MOTIONS: &str = "motions.parquet";
const SKIPPED: &str = "skipped.parquet";
const REJECTED: &str = "quarantine.parquet";
const REST: &str = "listing.json";

datasets_spec::table! {
    /// A file of a plan of ingestion.
    pub struct PlannedSource = "sources" {
        /// Path relative to its source, behind the label of the source
        pub path: String [""],
        /// Number of its source
        pub source: u32 [""],
        /// Where it is; bytes that are not UTF-8 are written as \xNN, a backslash is doubled
        pub place: String [""],
        /// Size
        pub bytes: u64 ["B"],
        /// BLAKE3, hexadecimal; empty if it could not be read
        pub hash: String [""],
        /// Why it could not be read
        pub unreadable: Option<String> [""],
        /// The word release if a release claims it; missing for single files
        pub claimed: Option<String> [""],
    }
}

datasets_spec::table! {
    /// A motion of a plan of ingestion.
    pub struct PlannedMotion = "planned motions" {
        /// Id in the dataset
        pub id: String [""],
        /// Split
        pub split: Split [""],
        /// Path of its file, as in the table of sources
        pub file: String [""],
        /// Key of the motion in its file; empty if the file holds one motion
        pub key: String [""],
        /// Id in its release
        pub entry_id: String [""],
        /// Published split
        pub entry_split: Option<String> [""],
        /// Group of the release whose motions share a drawn split
        pub entry_group: Option<String> [""],
        /// Id of the motion it mirrors
        pub mirrored_of: Option<String> [""],
        /// Format
        pub format: String [""],
        /// Number of its release; missing for single files
        pub release: Option<u32> [""],
        /// Prefix of its id
        pub prefix: String [""],
        /// Group of motions that share a drawn split
        pub group: Option<String> [""],
        /// Split that the user states
        pub own_split: Option<String> [""],
        /// Split that its labels state
        pub labelled_split: Option<String> [""],
        /// Subject that its labels state
        pub subject: Option<String> [""],
        /// Action that its labels state
        pub action: Option<String> ["", newer],
        /// BLAKE3 of all its inputs, hexadecimal
        pub inputs: String [""],
        /// Number of the same clip in the previous version
        pub known: Option<u32> [""],
        /// 1 if that clip stays unchanged, so that no piece reads it
        pub is_kept: u32 [""],
    }
}

impl Plan {
    pub(super) fn write(&self, folder: &Path) -> Result<(), Error> {
        let sources = self.sources.iter().map(|(path, source)| {
            let place = absolute(self.files.path(path).unwrap_or(Path::new("")))?;
            Ok(PlannedSource {
                path: path.clone(),
                source: u32::try_from(source.of).unwrap_or(u32::MAX),
                place: text_of_name(place.as_os_str()),
                bytes: source.bytes,
                hash: source.hash.clone().unwrap_or_default(),
                unreadable: source.hash.clone().err(),
                claimed: self.claimed.contains(path).then(|| "release".to_owned()),
            })
        });
        let sources: Vec<PlannedSource> = sources.collect::<Result<_, Error>>()?;
        write_table(&folder.join(SOURCES), &sources)?;
        let motions: Vec<PlannedMotion> = self.items.iter().map(row_of).collect();
        write_table(&folder.join(MOTIONS), &motions)?;
        write_table(&folder.join(SKIPPED), &self.skipped)?;
        write_table(&folder.join(REJECTED), &self.rejected)?;
        Ok(write_json(&folder.join(REST), &self.notes)?)
    }

    /// Reads a written plan. No source is listed or hashed; of the sources, only label files that apply to many motions
    /// are read.
    pub(super) fn read(
        folder: &Path,
        store: Arc<dyn Store>,
        options: &IngestOptions,
    ) -> Result<Self, Error> {
        let rows: Vec<PlannedSource> = read_rows(&folder.join(SOURCES))?;
        let claimed = rows.iter().filter(|row| row.claimed.is_some());
        let claimed = claimed.map(|row| row.path.clone()).collect();
        let mut paths = BTreeMap::new();
        let mut sources = BTreeMap::new();
        for row in rows {
            paths.insert(row.path.clone(), PathBuf::from(name_of_text(&row.place)));
            let source = Source {
                of: row.source as usize,
                hash: row.unreadable.map_or(Ok(row.hash), Err),
                // Files that could not be read were rejected when the plan was made.
                damaged_at: None,
                head: Vec::new(),
                bytes: row.bytes,
            };
            sources.insert(row.path, source);
        }
        let archives = Archives::of(paths.values())?;
        let files = Files::on(store, paths).with_archives(archives);
        let rows: Vec<PlannedMotion> = read_rows(&folder.join(MOTIONS))?;
        let items = rows.into_iter().map(|row| item_of(row, folder));
        let items: Vec<Planned> = items.collect::<Result<_, Error>>()?;
        let releases = match items.iter().any(|item| item.release.is_some()) {
            true => find_releases(&files, options.humanml3d_index.as_deref())?,
            false => Vec::new(),
        };
        let is_known = |item: &Planned| match item.release {
            Some(release) => releases
                .get(release)
                .is_some_and(|(format, _)| *format == item.format),
            None => true,
        };
        if let Some(item) = items.iter().find(|item| !is_known(item)) {
            return Err(work::Error::SourceChanged {
                path: PathBuf::from(&item.entry.file),
            }
            .into());
        }
        let skipped: Vec<SkippedRow> = read_rows(&folder.join(SKIPPED))?;
        let rejected: Vec<QuarantineRow> = read_rows(&folder.join(REJECTED))?;
        Ok(Self {
            folder_labels: FolderLabels::read(&files),
            files,
            sources,
            releases,
            items,
            skipped,
            rejected,
            claimed,
            notes: read_json(&folder.join(REST))?,
        })
    }

    pub(super) fn is_as_planned(&self, path: &str) -> io::Result<bool> {
        let (Some(source), Some(place)) = (self.sources.get(path), self.files.path(path)) else {
            return Ok(false);
        };
        match &source.hash {
            Ok(hash) => self.files.is_equal(place, source.bytes, hash),
            // An item that was unreadable when the plan was made is rejected, even if it is readable now.
            Err(_) => Ok(true),
        }
    }
}

fn row_of(item: &Planned) -> PlannedMotion {
    let number = |number: Option<usize>| number.and_then(|number| u32::try_from(number).ok());
    let name = |split: Option<Split>| split.map(|split| split.as_str().to_owned());
    PlannedMotion {
        id: item.id.clone(),
        split: item.split,
        file: item.entry.file.clone(),
        key: item.entry.key.clone(),
        entry_id: item.entry.id.clone(),
        entry_split: name(item.entry.split),
        entry_group: item.entry.group.clone(),
        mirrored_of: item.entry.mirrored_of.clone(),
        format: item.format.as_str().to_owned(),
        release: number(item.release),
        prefix: item.prefix.clone(),
        group: item.group.clone(),
        own_split: name(item.own_split),
        labelled_split: name(item.labelled_split),
        subject: item.subject.clone(),
        action: item.action.clone(),
        inputs: item.inputs.clone(),
        known: number(item.known),
        is_kept: u32::from(item.is_kept),
    }
}

fn item_of(row: PlannedMotion, folder: &Path) -> Result<Planned, Error> {
    let split = |name: Option<String>| name.map(|name| name.parse::<Split>()).transpose();
    let format = format_named(&row.format).ok_or_else(|| work::Error::BadPlan {
        path: folder.to_owned(),
        reason: format!("{:?} is an unknown format; plan again", row.format),
    })?;
    Ok(Planned {
        entry: Entry {
            file: row.file,
            key: row.key,
            id: row.entry_id,
            split: split(row.entry_split)?,
            group: row.entry_group,
            mirrored_of: row.mirrored_of,
        },
        format,
        release: row.release.map(|release| release as usize),
        prefix: row.prefix,
        group: row.group,
        own_split: split(row.own_split)?,
        labelled_split: split(row.labelled_split)?,
        subject: row.subject,
        action: row.action,
        named: None,
        id: row.id,
        inputs: row.inputs,
        known: row.known.map(|known| known as usize),
        is_kept: row.is_kept != 0,
        split: row.split,
    })
}
