//! HumanML3D's clips cut from AMASS recordings by the published `index.csv`.
//!
//! The stored motion keeps the recording's own rotations. [`features::humanml3d`] computes joints and features from it.
//! The published ones were made with each subject's own body, so they differ by as much as the bodies do.

mod crop;
mod mirror;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use self::crop::{Crop, cut};
use self::mirror::{mirror, mirrored_body, on_floor};
use super::amass::catalogue::{Recording, Subset};
use super::amass::{self, Parsed};
use super::files::Files;
use super::format::{Contents, Entry, Format, Release};
use super::head::refuse_pointer;
use super::humanml3d::{self, IndexRow, List, Splits};
use super::options::ReadOptions;
use crate::Error;
use clip::{ReadClip, Rejected, rejected};

/// HumanML3D's clips, cut from AMASS by its `index.csv`.
pub const FORMAT: Format = Format::of_releases(
    "humanml3d-amass",
    "AMASS files and --humanml3d-index index.csv; its own rotations, with mirrored copies",
    humanml3d::FORMAT.bytes_per_second,
);

/// Part of the path of rows that were made from HumanAct12's joints, not from AMASS.
const HUMANACT12: &str = "humanact12";

/// HumanML3D's clips among AMASS files.
#[derive(Debug)]
struct Cuts {
    contents: Contents,
    crops: BTreeMap<String, Crop>,
}

/// AMASS files by recording. Of several releases of one recording, SMPL-H comes first: the published
/// frame numbers refer to it.
pub fn recordings(files: &Files) -> BTreeMap<Recording, Vec<String>> {
    let mut found: BTreeMap<Recording, Vec<String>> = BTreeMap::new();
    for file in files.all().filter(|file| file.ends_with(".npz")) {
        // The source may be the subset's own folder: then the relative path lacks its name.
        let path = files.path(file).unwrap_or(Path::new(file));
        if let Some(recording) = Recording::of(path) {
            found.entry(recording).or_default().push(file.to_owned());
        }
    }
    for files in found.values_mut() {
        files.sort_by_key(|file| !file.ends_with("_poses.npz"));
    }
    found
}

/// Whether a row was made from HumanAct12's joints.
pub fn is_humanact12(row: &IndexRow) -> bool {
    row.source_path.contains(HUMANACT12)
}

/// Plans a clip and its mirror image for every row of the index whose recording is among the files. Captions come from
/// `texts` folders among the files, splits from lists among them or beside the index.
///
/// # Errors
/// The index cannot be read or is malformed.
pub fn find(files: &Files, index: &Path) -> Result<Box<dyn Release>, Error> {
    let bytes = fs::read(index).map_err(datasets_spec::Error::io("read", index))?;
    let rows = humanml3d::parse_index(&bytes).map_err(|rejected| Error::Index {
        path: index.to_owned(),
        reason: rejected.reason,
    })?;
    let layouts = humanml3d::layouts(files);
    let texts: BTreeMap<&str, &str> = layouts
        .iter()
        .flat_map(|layout| &layout.texts)
        .map(|(id, file)| (id.as_str(), file.as_str()))
        .collect();
    let (beside, unread_beside) = lists_beside(index);
    let listed = layouts.iter().flat_map(|layout| layout.lists.values());
    let listed = listed.chain(&beside);
    let splits = Splits::of(listed, |id| humanml3d::clip_of(id).to_owned());

    let recordings = recordings(files);
    let index_name = index.file_name().unwrap_or_default().to_string_lossy();
    let unread = layouts.iter().flat_map(|layout| &layout.unread_splits);
    let mut cuts = Cuts {
        contents: Contents {
            publishes_splits: humanml3d::SPLIT_LISTS,
            unread_splits: unread.cloned().chain(unread_beside).collect(),
            ..Contents::default()
        },
        crops: BTreeMap::new(),
    };
    let mut used = BTreeSet::new();
    for row in rows {
        let item = format!("{index_name}#{}", row.id);
        let recording = Recording::of(Path::new(&row.source_path));
        let file = recording
            .as_ref()
            .and_then(|recording| recordings.get(recording)?.first());
        let (Some(recording), Some(file)) = (recording, file) else {
            let reason = if is_humanact12(&row) {
                "row of HumanAct12, which has joints and no body parameters"
            } else {
                "row whose AMASS recording is not among the sources"
            };
            let reason = format!("HumanML3D index {reason}");
            cuts.contents.pass_over(item, reason);
            continue;
        };
        used.insert(file.as_str());
        cuts.plan(row, &recording, file, &texts, &splits);
    }
    for file in recordings.values().flatten() {
        if !used.contains(file.as_str()) {
            let reason = "AMASS file that the HumanML3D index takes nothing from";
            cuts.contents.pass_over(file, reason);
        }
    }
    cuts.pass_over_texts(&texts);
    Ok(Box::new(cuts))
}

/// The split lists in the folder of the index, and in the folder of the published repository below it; and those that
/// cannot be read.
fn lists_beside(index: &Path) -> (Vec<List>, Vec<String>) {
    let folder = index.parent().unwrap_or(Path::new("."));
    let folders = [folder.to_owned(), folder.join("HumanML3D")];
    let (mut lists, mut unread) = (Vec::new(), Vec::new());
    for (name, split) in humanml3d::LISTS {
        let mut places = folders.iter().map(|folder| folder.join(name));
        let Some(path) = places
            .find(|path| path.exists())
            .filter(|_| split.is_some())
        else {
            continue;
        };
        let ids = fs::read(&path).map_err(|error| error.to_string());
        let ids = ids.and_then(|bytes| humanml3d::parse_list(&bytes).map_err(|why| why.reason));
        match ids {
            Ok(ids) => lists.push((split, ids)),
            Err(reason) => unread.push(format!("{} ({reason})", path.display())),
        }
    }
    (lists, unread)
}

impl Cuts {
    fn plan(
        &mut self,
        row: IndexRow,
        recording: &Recording,
        file: &str,
        texts: &BTreeMap<&str, &str>,
        splits: &Splits,
    ) {
        let mirrored = format!("M{}", row.id);
        let (split, note) = splits.get(&row.id);
        let text = |id: &str| texts.get(id).map(|file| (*file).to_owned());
        for (id, mirrored_of) in [
            (row.id.clone(), None),
            (mirrored.clone(), Some(row.id.clone())),
        ] {
            self.contents.entries.push(Entry {
                file: file.to_owned(),
                key: id.clone(),
                id,
                split,
                group: None,
                mirrored_of,
            });
        }
        let crop = Crop {
            subset: recording.subset,
            lead_in_frames: Subset::named(recording.subset)
                .map_or(0, |subset| subset.lead_in_frames),
            texts: [text(&row.id), text(&mirrored)],
            note,
            row,
        };
        self.crops.insert(crop.row.id.clone(), crop);
    }

    fn pass_over_texts(&mut self, texts: &BTreeMap<&str, &str>) {
        for (id, file) in texts {
            let clip = humanml3d::mirrored_of(id).unwrap_or(id);
            if self.crops.contains_key(clip) {
                self.contents.pass_over_captions(*file, true);
            }
        }
    }
}

impl Release for Cuts {
    fn contents(&self) -> &Contents {
        &self.contents
    }

    fn read(&self, files: &Files, entry: &Entry, options: &ReadOptions) -> ReadClip {
        let skeleton = &options.skeleton;
        let is_mirrored = entry.mirrored_of.is_some();
        let id = entry.mirrored_of.as_ref().unwrap_or(&entry.id);
        let crop = self
            .crops
            .get(id)
            .ok_or_else(|| rejected!("E-HML-INDEX", "found no row {id} in the index"))?;
        let bytes = files.read(&entry.file)?;
        refuse_pointer(&bytes)?;
        let parameters = match amass::parse_at(&bytes, None)? {
            Parsed::Parameters(parameters) => *parameters,
            Parsed::NoMotion { reason } => return Err(Rejected::read("E-AMASS-KEYS", reason)),
        };
        let mut clip = cut(&parameters, crop, options)?;
        if is_mirrored {
            clip.motion = on_floor(mirror(&clip.motion), skeleton);
            clip.body = clip.body.as_ref().map(mirrored_body);
        }
        clip.notes.extend(crop.note.iter().cloned());
        let (captions, note) = crop.captions(files, is_mirrored)?;
        clip.captions = captions;
        clip.notes.extend(note);
        Ok(clip)
    }
}
