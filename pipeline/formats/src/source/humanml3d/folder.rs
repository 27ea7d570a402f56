//! The clips of a folder: motion, captions, split and crop of each.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use datasets_spec::table::Caption;
use features::humanml3d::recover_joints;
use pickle::npy;

use super::array::{features, joints, read_array};
use super::id::{clip_of, mirrored_of};
use super::index::IndexRow;
use super::layout::{Layout, SPLIT_LISTS, layouts};
use super::splits::Splits;
use crate::source::files::Files;
use crate::source::format::{Contents, Entry, Release, TOO_SHORT, boxed};
use crate::source::head::refuse_pointer;
use crate::source::labels;
use crate::source::options::ReadOptions;
use clip::check::FLAG_POOR_FIT;
use clip::{ReadClip, Rejected, SourceClip};

/// Clips of the published set whose crop leaves at most one frame.
const KNOWN_EMPTY: [&str; 2] = ["009707", "011059"];
/// Largest distance in metres between published joints and those recovered from the vector of the
/// same clip. Rounding measures 2e-7.
const RECOVERY_TOLERANCE_M: f64 = 1e-3;

/// A HumanML3D folder, whole or in part.
#[derive(Debug)]
struct Folder {
    contents: Contents,
    layout: Layout,
    /// Notes on the splits of clips, by id.
    notes: BTreeMap<String, String>,
}

/// The HumanML3D folders among the files, each found by its layout.
pub fn find(files: &Files) -> Vec<Box<dyn Release>> {
    boxed(layouts(files).into_iter().map(Folder::new))
}

impl Folder {
    fn new(layout: Layout) -> Self {
        let splits = Splits::of(layout.lists.values(), |id| clip_of(id).to_owned());
        let mut contents = Contents {
            publishes_splits: SPLIT_LISTS,
            ..Contents::default()
        };
        let mut notes = BTreeMap::new();
        for id in layout.ids() {
            let (split, note) = splits.get(id);
            notes.extend(note.map(|note| (id.clone(), note)));
            let (vector, joints) = (layout.vectors.get(id), layout.joints.get(id));
            if let (Some(_), Some(joints)) = (vector, joints) {
                let reason = "joints of a clip that is read from its HumanML3D vector";
                contents.pass_over(joints, reason);
            }
            contents.entries.extend(vector.or(joints).map(|file| Entry {
                file: file.clone(),
                id: id.clone(),
                split,
                mirrored_of: mirrored_of(id).map(str::to_owned),
                ..Entry::default()
            }));
        }
        let mut folder = Self {
            contents,
            layout,
            notes,
        };
        folder.remark();
        folder.pass_over();
        folder
    }

    /// Remarks on listed ids without a motion, unless there are no motions at all: then the captions may belong to
    /// clips cut from AMASS.
    fn remark(&mut self) {
        if self.contents.entries.is_empty() {
            return;
        }
        for (file, (split, ids)) in &self.layout.lists {
            let ids = ids
                .iter()
                .filter(|id| split.is_some() && !self.layout.has_motion(id));
            let missing: BTreeSet<&str> = ids.map(String::as_str).collect();
            let missing = missing.into_iter().collect();
            self.contents.remark_on_listed("HumanML3D", file, missing);
        }
    }

    /// Lists the files that hold no motion.
    fn pass_over(&mut self) {
        for (id, file) in &self.layout.texts {
            let has_motion = self.layout.has_motion(id);
            self.contents.pass_over_captions(file, has_motion);
        }
        for file in self.layout.lists.keys() {
            let reason = "HumanML3D list of ids, no motion";
            self.contents.pass_over(file, reason);
        }
        if let Some((file, _)) = &self.layout.index {
            let reason = "HumanML3D crop list, no motion";
            self.contents.pass_over(file, reason);
        }
        let layout = &mut self.layout;
        self.contents.passed_over.append(&mut layout.others);
        self.contents.rejected.append(&mut layout.rejected);
        self.contents
            .unread_splits
            .clone_from(&layout.unread_splits);
    }
}

impl Release for Folder {
    fn contents(&self) -> &Contents {
        &self.contents
    }

    fn read(&self, files: &Files, entry: &Entry, options: &ReadOptions) -> ReadClip {
        let (id, layout) = (&entry.id, &self.layout);
        let bytes = files.read(&entry.file)?;
        let mut read = read_array(&bytes, &options.skeleton).map_err(|rejected| {
            let known = rejected.code == TOO_SHORT && KNOWN_EMPTY.contains(&clip_of(id));
            match known {
                true => Rejected {
                    reason: format!(
                        "{}; {id} is published so: its crop leaves no motion",
                        rejected.reason
                    ),
                    ..rejected
                },
                false => rejected,
            }
        })?;
        read.notes.extend(self.notes.get(id).cloned());
        if let (true, Some(joints)) = (layout.vectors.contains_key(id), layout.joints.get(id)) {
            compare(files, &bytes, joints, &mut read);
        }
        let crops = layout.index.as_ref().map(|(_, crops)| crops);
        if let Some(crop) = crops.and_then(|crops| crops.get(clip_of(id))) {
            read.source_frames = frames_of(crop, read.motion.len());
            read.notes.push(format!(
                "cut from {} (frames at 20 fps after the lead-in of its subset)",
                crop.source_path
            ));
        }
        add_captions(&mut read, files, layout.texts.get(id))?;
        Ok(read)
    }
}

/// The captions of a file, and a note on lines that are not captions.
///
/// # Errors
/// `E-IO` if the file cannot be read, `E-LFS-POINTER` if it is a Git LFS pointer.
pub fn read_captions(
    files: &Files,
    file: &str,
) -> Result<(Vec<Caption>, Option<String>), Rejected> {
    let bytes = files.read(file)?;
    refuse_pointer(&bytes)?;
    let (captions, others) = labels::parse_captions(&String::from_utf8_lossy(&bytes));
    let num_other = others.len();
    let note = (num_other > 0)
        .then(|| format!("{num_other} lines of {file} are no captions and were passed over"));
    Ok((captions, note))
}

/// Adds the captions of a file, if there is one, to a clip.
pub(crate) fn add_captions(
    clip: &mut SourceClip,
    files: &Files,
    file: Option<&String>,
) -> Result<(), Rejected> {
    if let Some(file) = file {
        let (captions, note) = read_captions(files, file)?;
        clip.captions = captions;
        clip.notes.extend(note);
    }
    Ok(())
}

/// Source frames of a clip, from its row of the crop list.
fn frames_of(crop: &IndexRow, num_frames: usize) -> Range<usize> {
    let end = crop.end.unwrap_or(crop.start.saturating_add(num_frames));
    crop.start..end.max(crop.start)
}

/// Compares the joint file of a clip with the joints recovered from its vector.
fn compare(files: &Files, vector: &[u8], joints_file: &str, clip: &mut SourceClip) {
    let stored = files
        .read(joints_file)
        .and_then(|bytes| joints(&npy::read_numbers("joints", &bytes)?));
    let own = npy::read_numbers("features", vector)
        .map_err(Rejected::from)
        .and_then(|array| features(&array));
    let (stored, own) = match (stored, own) {
        (Ok(stored), Ok(own)) => (stored, recover_joints(&own)),
        (Err(rejected), _) | (_, Err(rejected)) => {
            let reason = rejected.reason;
            clip.notes
                .push(format!("{joints_file} was not compared: {reason}"));
            return;
        }
    };
    if stored.len() != own.len() {
        clip.flags |= FLAG_POOR_FIT;
        clip.notes.push(format!(
            "{joints_file} has {} frames, the vector {}",
            stored.len(),
            own.len()
        ));
        return;
    }
    let apart = stored
        .as_flattened()
        .iter()
        .zip(own.as_flattened())
        .map(|(a, b)| a.distance(*b))
        .fold(0.0, f64::max);
    if apart > RECOVERY_TOLERANCE_M {
        clip.flags |= FLAG_POOR_FIT;
    }
    clip.notes.push(format!(
        "joints recovered from the vector lie within {apart:.1e} m of {joints_file}"
    ));
}
