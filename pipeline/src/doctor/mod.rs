//! Diagnosis of sources before ingesting: present and missing files. A file with one motion is judged by its name and
//! first bytes; a capture of markers is read, because its labels and unit decide whether it gives a motion. Clips of
//! releases are counted as ingestion counts them.

mod advice;
mod amass;
mod captures;
mod crop_list;
mod display;
mod findings;
mod humanml3d;
mod release;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use datasets_spec::license::is_non_commercial;
use datasets_spec::store::{ByPath, Store};
use datasets_spec::{Dataset, Fps, Progress};
use rayon::prelude::*;

use advice::advise;
use amass::amass_subsets;
use crop_list::{ask, index_among};
use formats::source::archive::Archives;
use formats::source::humanml3d::{FORMAT as HUMANML3D, Layout, layouts, parse_index};
use formats::source::labels::FolderLabels;
use formats::source::{
    Files, Format, FoundRelease, ReadOptions, Recognised, find_releases, is_pointer, read_head,
    recognise,
};
use humanml3d::JOINTS_SHARE;
use release::{motionfix_folders, stance_folders};

use crate::Error;
use crate::catalogue::other_than_motions;
use crate::ingest::{list_each, reason_beside, with_label, without_extension};

pub use findings::Diagnosis;
use findings::{Estimate, Findings, HumanMl3dFindings, Kind, LicenseFindings};

/// Examines the sources. `index` is HumanML3D's crop list; without it, the first one among the
/// sources is used. `options` are those that the sources will be read with.
///
/// # Errors
/// A source does not exist, holds no files or cannot be listed, or the index cannot be read.
pub fn examine(
    sources: &[PathBuf],
    index: Option<&Path>,
    options: &ReadOptions,
    progress: &dyn Progress,
) -> Result<Diagnosis, Error> {
    let mut findings = Vec::new();
    let mut unlisted = Vec::new();
    let mut all = BTreeMap::new();
    let mut archives = Archives::default();
    for (source, label, listing) in list_each(sources, progress)? {
        let files = listing.files.iter();
        all.extend(files.map(|(path, place)| (with_label(&label, path), place.clone())));
        unlisted.extend(listing.unlisted.iter().map(|(folder, reason)| {
            format!(
                "folder {folder} of {} cannot be listed: {reason}",
                source.display()
            )
        }));
        unlisted.extend(listing.refused.iter().map(|(name, _, rejected)| {
            let place = rejected
                .byte_offset
                .map_or(String::new(), |byte| format!(" (byte {byte})"));
            format!(
                "{name} of {}: {} {}{place}",
                source.display(),
                rejected.code,
                rejected.reason
            )
        }));
        archives.add(listing.archives.clone());
        let files = Files::new(listing.files.clone()).with_archives(listing.archives);
        let releases = find_releases(&files, index)?;
        let looked = look(&listing.files, &releases);
        findings.push(find(source, &files, &releases, &looked, options));
    }
    let files = Files::new(all).with_archives(archives);
    let asked = index.is_some();
    let index = match index {
        Some(path) => {
            let bytes = fs::read(path).map_err(datasets_spec::Error::io("read", path))?;
            let rows = parse_index(&bytes).map_err(|rejected| formats::Error::Index {
                path: path.to_owned(),
                reason: rejected.reason,
            })?;
            Some((path.to_owned(), rows))
        }
        None => index_among(&files),
    };
    let index = index.map(|(path, rows)| ask(path, &rows, &files));
    let estimate = findings.iter().map(|source| source.estimate).sum();
    let advice = advise(&findings, index.as_ref(), asked);
    let advice = unlisted.into_iter().chain(advice).collect();
    Ok(Diagnosis {
        sources: findings,
        index,
        estimate,
        advice,
    })
}

fn find(
    source: &Path,
    files: &Files,
    releases: &[FoundRelease],
    looked: &[Looked],
    options: &ReadOptions,
) -> Findings {
    let used: BTreeMap<&str, &Looked> = looked
        .iter()
        .map(|file| (file.relative.as_str(), file))
        .collect();
    let of_another = |file: &String| {
        let used = used.get(file.as_str()).and_then(|file| file.used.as_ref());
        used.is_some_and(|used| used.format != HUMANML3D)
    };
    let mut layouts = layouts(files);
    // Captions alone may be those of another release.
    layouts
        .retain(|layout| layout.ids().next().is_some() || !layout.texts.values().any(of_another));
    let (amass, of_amass) = amass_subsets(looked);
    let estimates = [of_amass, estimate_others(looked, &layouts)];
    let labels = FolderLabels::read(files);
    Findings {
        captures: captures::captures(looked, options),
        licenses: licenses(source, &labels),
        label_problems: labels.unread().to_vec(),
        path: source.to_owned(),
        files: looked.len() as u64,
        bytes: looked.iter().map(|file| file.bytes).sum(),
        kinds: kinds(looked),
        lfs_pointers: looked.iter().filter(|file| file.is_pointer).count() as u64,
        humanml3d: layouts.iter().map(HumanMl3dFindings::of).collect(),
        amass,
        stance: stance_folders(looked),
        motionfix: motionfix_folders(looked),
        remarks: remarks(releases, &used),
        dataset: Dataset::open_unverified(source).ok().map(|dataset| {
            match other_than_motions(&dataset) {
                Some(other) => other.to_owned(),
                None => {
                    "a dataset that `stance ingest` has made; `stance stats` counts it".to_owned()
                }
            }
        }),
        estimate: estimates.into_iter().sum(),
    }
}

/// What releases say of their splits, and their files that are found broken before any motion is read.
fn remarks(releases: &[FoundRelease], looked: &BTreeMap<&str, &Looked>) -> Vec<String> {
    let contents = releases.iter().map(|(_, release)| release.contents());
    let remarks = contents.flat_map(|contents| {
        let is_pointer = |file: &str| looked.get(file).is_some_and(|file| file.is_pointer);
        let rejected = contents.rejected.iter();
        let rejected = rejected
            .filter(move |(file, _)| !is_pointer(file))
            .map(|(file, rejected)| format!("{file} would be quarantined: {rejected}"));
        contents.remarks.iter().cloned().chain(rejected)
    });
    remarks.collect()
}

fn licenses(source: &Path, labels: &FolderLabels) -> Vec<LicenseFindings> {
    let found = labels.licenses().map(|(path, license, found)| {
        let folder = path.strip_prefix(source).unwrap_or(Path::new(""));
        LicenseFindings {
            folder: folder.to_string_lossy().into_owned(),
            non_commercial: license.as_deref().is_some_and(is_non_commercial),
            license,
            files: found.files.clone(),
            unknown: found.unknown.clone(),
        }
    });
    found.collect()
}

fn kinds(looked: &[Looked]) -> Vec<Kind> {
    let mut kinds: BTreeMap<(bool, &str), Kind> = BTreeMap::new();
    for file in looked {
        let (is_motion, name) = match file.format() {
            _ if file.is_pointer => (false, "Git LFS pointer"),
            Ok(format) => (true, format.as_str()),
            Err(reason) => (false, reason),
        };
        // Files with motions come first.
        let kind = kinds.entry((!is_motion, name)).or_insert_with(|| Kind {
            name: name.to_owned(),
            is_motion,
            files: 0,
            bytes: 0,
            clips: 0,
            is_least: false,
        });
        kind.is_least |= file.may_hold_several();
        kind.files += 1;
        kind.bytes += file.bytes;
        kind.clips += file.clips();
    }
    kinds.into_values().collect()
}

/// Estimates all files except those of AMASS.
fn estimate_others(looked: &[Looked], layouts: &[Layout]) -> Estimate {
    let joints: BTreeSet<&String> = layouts
        .iter()
        .flat_map(|layout| layout.joints.values())
        .collect();
    let others = looked.iter().filter(|file| !file.is_amass());
    let estimates = others.filter_map(|file| {
        let format = file.format().ok().filter(|_| !file.is_pointer)?;
        let share = match joints.contains(&file.relative) {
            true => JOINTS_SHARE,
            false => 1.0,
        };
        let seconds = seconds_in(format, file.bytes) / share;
        Some(Estimate::of(file.clips(), seconds * Fps::STORE.get()))
    });
    estimates.sum()
}

/// Seconds of motion in files of a format, estimated from their size.
fn seconds_in(format: Format, bytes: u64) -> f64 {
    bytes as f64 / format.bytes_per_second
}

/// How a release uses a file.
#[derive(Clone)]
struct Used {
    /// The format of the release.
    format: Format,
    /// Why the file holds no motion of its own.
    no_motion: Option<String>,
    /// Clips that are read from the file.
    clips: u64,
}

/// How the releases use their files. As in ingestion, motions come before all else that releases say of a file, and
/// among that the first release decides.
fn used_files(releases: &[FoundRelease]) -> BTreeMap<&str, Used> {
    let mut used: BTreeMap<&str, Used> = BTreeMap::new();
    for (format, release) in releases {
        for entry in &release.contents().entries {
            let motion = || Used {
                format: *format,
                no_motion: None,
                clips: 0,
            };
            for file in release.motion_files(entry) {
                used.entry(file).or_insert_with(motion);
            }
            used.entry(&entry.file).or_insert_with(motion).clips += 1;
        }
    }
    for (format, release) in releases {
        let contents = release.contents();
        let passed_over = contents.passed_over.iter();
        let passed_over = passed_over.map(|(file, reason)| (file, reason.clone()));
        let rejected = contents.rejected.iter();
        let rejected =
            rejected.map(|(file, why)| (file, format!("would be quarantined as {}", why.code)));
        for (file, reason) in passed_over.chain(rejected) {
            used.entry(file).or_insert(Used {
                format: *format,
                no_motion: Some(reason),
                clips: 0,
            });
        }
    }
    used
}

/// A listed file, the format that its first bytes show, and how a release uses it.
struct Looked {
    relative: String,
    path: PathBuf,
    bytes: u64,
    is_pointer: bool,
    kind: Recognised,
    used: Option<Used>,
}

impl Looked {
    /// The format that reads motions from it, or why none are read.
    fn format(&self) -> Result<Format, &str> {
        match (&self.used, &self.kind) {
            (Some(used), _) => used.no_motion.as_deref().map_or(Ok(used.format), Err),
            (None, Recognised::Motion(format)) => Ok(*format),
            (None, Recognised::NotMotion { reason }) => Err(reason),
        }
    }

    /// Clips that are read from it. Single files are counted as one clip each: several would show only when the whole
    /// file is read.
    fn clips(&self) -> u64 {
        match &self.used {
            _ if self.is_pointer => 0,
            Some(used) => used.clips,
            None => u64::from(self.format().is_ok()),
        }
    }

    /// Whether it is a single file of a format whose files may hold several clips.
    fn may_hold_several(&self) -> bool {
        let is_read = self.used.is_none() && !self.is_pointer;
        is_read && self.format().is_ok_and(|format| format.keys.is_some())
    }

    fn is_amass(&self) -> bool {
        self.kind == Recognised::Motion(formats::source::amass::FORMAT) && !self.is_pointer
    }
}

fn look(files: &BTreeMap<String, PathBuf>, releases: &[FoundRelease]) -> Vec<Looked> {
    let used = used_files(releases);
    let listed: Vec<(&String, &PathBuf)> = files.iter().collect();
    let mut looked: Vec<Looked> = listed
        .into_par_iter()
        .map(|(relative, path)| {
            let head = read_head(path);
            Looked {
                relative: relative.clone(),
                path: path.clone(),
                bytes: ByPath.size(path).unwrap_or(0),
                is_pointer: is_pointer(&head),
                kind: recognise(Path::new(relative), &head),
                used: used.get(relative.as_str()).cloned(),
            }
        })
        .collect();
    let motions = looked.iter().filter(|file| file.format().is_ok());
    let motions: Vec<String> = motions
        .map(|file| without_extension(&file.relative).to_owned())
        .collect();
    let motions: BTreeSet<&str> = motions.iter().map(String::as_str).collect();
    for file in &mut looked {
        if let (None, Recognised::NotMotion { reason }) = (&file.used, &mut file.kind)
            && let Some(better) = reason_beside(&file.relative, reason, &motions)
        {
            *reason = better.to_owned();
        }
    }
    looked
}
