//! Diagnosis of sources before ingesting: present and missing files. Only names and first bytes of motion files are
//! read, except captures of markers: their labels and unit decide whether they give motions.

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
use formats::source::humanml3d::{FORMAT as HUMANML3D, layouts, parse_index};
use formats::source::labels::FolderLabels;
use formats::source::{
    Files, Format, ReadOptions, Recognised, is_pointer, motionfix, read_head, recognise, stance,
};
use humanml3d::{estimate_layouts, files_of};
use release::{is_stance, motionfix_folders, stance_folders};

use crate::Error;
use crate::catalogue::other_than_motions;
use crate::ingest::{list_each, with_label};

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
        let looked = look(&listing.files);
        let files = Files::new(listing.files).with_archives(listing.archives);
        findings.push(find(source, &files, &looked, options));
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

fn find(source: &Path, files: &Files, looked: &[Looked], options: &ReadOptions) -> Findings {
    let layouts = layouts(files);
    let claimed: BTreeSet<&str> = layouts.iter().flat_map(files_of).collect();
    let rest: Vec<&Looked> = looked
        .iter()
        .filter(|file| !claimed.contains(file.relative.as_str()))
        .collect();
    let stance = stance_folders(&rest);
    let motionfix = motionfix_folders(&rest);
    let (amass, of_amass) = amass_subsets(&rest);
    let of_layouts = estimate_layouts(&layouts, looked);
    let estimates = [of_amass, of_layouts, estimate_others(&rest)];
    let labels = FolderLabels::read(files);
    Findings {
        captures: captures::captures(&rest, options),
        licenses: licenses(source, &labels),
        label_problems: labels.unread().to_vec(),
        path: source.to_owned(),
        files: looked.len() as u64,
        bytes: looked.iter().map(|file| file.bytes).sum(),
        kinds: kinds(looked, &claimed),
        lfs_pointers: looked.iter().filter(|file| file.is_pointer).count() as u64,
        humanml3d: layouts.iter().map(HumanMl3dFindings::of).collect(),
        amass,
        stance,
        motionfix,
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

fn kinds(looked: &[Looked], claimed: &BTreeSet<&str>) -> Vec<Kind> {
    let mut kinds: BTreeMap<(bool, String), (u64, u64)> = BTreeMap::new();
    for file in looked {
        let key = if file.is_pointer {
            (false, "Git LFS pointer".to_owned())
        } else if claimed.contains(file.relative.as_str()) {
            (true, HUMANML3D.as_str().to_owned())
        } else {
            match &file.kind {
                Recognised::Motion(format) => (true, format.as_str().to_owned()),
                Recognised::NotMotion { reason } => (false, reason.clone()),
            }
        };
        let (files, bytes) = kinds.entry(key).or_default();
        *files += 1;
        *bytes += file.bytes;
    }
    let mut kinds: Vec<Kind> = kinds
        .into_iter()
        .map(|((is_motion, name), (files, bytes))| Kind {
            name,
            is_motion,
            files,
            bytes,
        })
        .collect();
    kinds.sort_by(|a, b| (b.is_motion, &a.name).cmp(&(a.is_motion, &b.name)));
    kinds
}

/// Estimates all files except AMASS and HumanML3D.
fn estimate_others(rest: &[&Looked]) -> Estimate {
    let files = rest.iter().filter(|file| !file.is_pointer);
    let estimates = files.filter_map(|file| {
        let format = match file.kind {
            _ if is_stance(&file.relative) => stance::FORMAT,
            _ if motionfix::is_dump(&file.relative) => motionfix::FORMAT,
            Recognised::Motion(format) if format != formats::source::amass::FORMAT => format,
            _ => return None,
        };
        let frames = seconds_in(format, file.bytes) * Fps::STORE.get();
        Some(Estimate::of(1, frames))
    });
    estimates.sum()
}

/// Seconds of motion in files of a format, estimated from their size.
fn seconds_in(format: Format, bytes: u64) -> f64 {
    bytes as f64 / format.bytes_per_second
}

/// A listed file, and the format that its first bytes show.
struct Looked {
    relative: String,
    path: PathBuf,
    bytes: u64,
    is_pointer: bool,
    kind: Recognised,
}

fn look(files: &BTreeMap<String, PathBuf>) -> Vec<Looked> {
    let listed: Vec<(&String, &PathBuf)> = files.iter().collect();
    listed
        .into_par_iter()
        .map(|(relative, path)| {
            let head = read_head(path);
            Looked {
                relative: relative.clone(),
                path: path.clone(),
                bytes: ByPath.size(path).unwrap_or(0),
                is_pointer: is_pointer(&head),
                kind: recognise(Path::new(relative), &head),
            }
        })
        .collect()
}
