//! WebDataset exports of this program: tar shards, or the files unpacked from them.
//!
//! A clip is `KEY.transl.npy`, `KEY.global_orient.npy`, `KEY.body_pose.npy` and `KEY.json`. The last holds id, split,
//! rate and labels. A shard is an archive, which acts as a folder; the shards of a folder are one release.

use std::collections::BTreeMap;

use datasets_spec::table::PartCaption;
use datasets_spec::{Fps, Motion, Split};
use pickle::npy::read_numbers;
use serde::Deserialize;

use super::archive;
use super::format::{Contents, Entry, Format, Release, boxed, check_skeleton};
use super::humanml3d::in_single_precision;
use super::{Files, ReadOptions};
use crate::sidecar::LabelCaption;
use clip::{ReadClip, Rejected, RotationSource, SourceClip, rejected};

/// Endings of a clip's arrays.
const ARRAYS: [&str; 3] = ["transl.npy", "global_orient.npy", "body_pose.npy"];
const FACTS: &str = "json";
/// Longest member that is read, in bytes: an hour of poses at 120 fps.
const MAX_MEMBER_LEN: u64 = 1 << 28;
const CODE: &str = "E-WEBDATASET-MEMBER";

/// A folder of shards, or of unpacked files.
// Bytes per second: the 69 parameters of a frame in f32 at 20 fps.
pub const FORMAT: Format = Format {
    find: |files| boxed(Shards::find(files)),
    ..Format::of_releases(
        "webdataset",
        "tar shards of `stance export --to webdataset`, or the files unpacked from them; rotations as stored",
        (4 * 69 * 20) as f64,
    )
};

/// Metadata of a clip in `KEY.json`.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Facts {
    id: String,
    split: Option<Split>,
    fps: Option<f64>,
    skeleton: Option<String>,
    captions: Vec<LabelCaption>,
    parts: Vec<PartCaption>,
    subject: Option<String>,
    action: Option<String>,
    style: Option<String>,
    license: Option<String>,
    mirrored_of: Option<String>,
    rotation_source: Option<String>,
    fit_error_m: Option<f32>,
}

/// Files of a clip by their endings.
type Members = BTreeMap<&'static str, String>;

/// The clips of a folder's shards, before they are read.
#[derive(Debug, Default)]
struct Shards {
    contents: Contents,
    /// Clips by the file of their entry.
    clips: BTreeMap<String, Members>,
}

impl Shards {
    /// Finds the folders with shards or unpacked files.
    fn find(files: &Files) -> Vec<Self> {
        // By release; then by folder and key, because a key is unique only within a shard.
        let mut found: BTreeMap<&str, BTreeMap<(&str, &str), Members>> = BTreeMap::new();
        for file in files.all() {
            let (folder, name) = file.rsplit_once('/').unwrap_or(("", file));
            if let Some((key, ending)) = member(name) {
                let clips = found.entry(release_of(folder)).or_default();
                let members = clips.entry((folder, key)).or_default();
                members.insert(ending, file.to_owned());
            }
        }
        found
            .into_values()
            .map(|clips| Self::plan(files, clips))
            .filter(|shards| !shards.clips.is_empty())
            .collect()
    }

    fn plan(files: &Files, clips: BTreeMap<(&str, &str), Members>) -> Self {
        let mut shards = Self::default();
        // Any npy or json file may have such an ending; a clip has the three arrays.
        let is_whole = |members: &Members| ARRAYS.iter().all(|ending| members.contains_key(ending));
        if !clips.values().any(is_whole) {
            return shards;
        }
        for ((_, key), members) in clips {
            let mut own = members.values();
            // The file whose name is the key, if it is there: files that begin with its name belong to it.
            let Some(file) = members.get(FACTS).or_else(|| own.next()).cloned() else {
                continue;
            };
            // A file of metadata alone may be anything.
            if members.len() == 1 && members.contains_key(FACTS) {
                continue;
            }
            for other in members.values().filter(|other| **other != file) {
                let reason = "member of a clip of a WebDataset, read with it";
                shards.contents.pass_over(other, reason);
            }
            // Invalid metadata is reported when the clip is read.
            let facts = facts(files, &members).unwrap_or_default();
            shards.contents.entries.push(Entry {
                file: file.clone(),
                id: match facts.id {
                    id if id.is_empty() => key.to_owned(),
                    id => id,
                },
                split: facts.split,
                mirrored_of: facts.mirrored_of,
                ..Entry::default()
            });
            shards.clips.insert(file, members);
        }
        shards
    }
}

impl Release for Shards {
    fn contents(&self) -> &Contents {
        &self.contents
    }

    fn motion_files<'a>(&'a self, entry: &'a Entry) -> Vec<&'a str> {
        let members = self.clips.get(&entry.file).into_iter().flatten();
        let arrays = members.filter(|(ending, _)| **ending != FACTS);
        arrays.map(|(_, file)| file.as_str()).collect()
    }

    fn read(&self, files: &Files, entry: &Entry, options: &ReadOptions) -> ReadClip {
        let refused = |reason: String| Rejected::read(CODE, reason);
        let members = self.clips.get(&entry.file);
        let members = members.ok_or_else(|| refused("there is no such clip".to_owned()))?;
        let facts = facts(files, members)?;
        let skeleton = facts.skeleton.as_ref().ok_or_else(|| {
            refused(format!(
                "its {FACTS} names no skeleton; add the key `skeleton`, such as {:?}",
                options.skeleton.name()
            ))
        })?;
        check_skeleton(skeleton, options)?;
        let [transl, global_orient, body_pose] = ARRAYS;
        let transl = rows(files, members, transl)?;
        let global_orient = rows(files, members, global_orient)?;
        let body_pose = rows(files, members, body_pose)?;
        let fps = facts.fps.ok_or_else(|| {
            refused(format!(
                "its {FACTS} states no frame rate; add the key `fps`, in frames per second"
            ))
        })?;
        let motion = Fps::new(fps)
            .and_then(|fps| Motion::new(fps, transl, global_orient, body_pose))
            .map_err(|error| refused(error.to_string()))?;
        let said = facts.captions.into_iter();
        let (made, stated): (Vec<_>, Vec<_>) = said.partition(LabelCaption::is_made);
        let texts = |said: Vec<LabelCaption>| said.into_iter().map(|said| said.caption).collect();
        let rotations = facts.rotation_source.as_deref();
        let rotations = rotations.and_then(RotationSource::of_name);
        Ok(SourceClip {
            captions: texts(stated),
            made_captions: texts(made),
            part_captions: facts.parts,
            subject: facts.subject,
            action: facts.action,
            style: facts.style,
            license: facts.license,
            fit_error_m: facts.fit_error_m,
            ..SourceClip::new(motion, rotations.unwrap_or_default())
        })
    }
}

/// Reads a member that holds an array `[L, D]`.
fn rows<const D: usize>(
    files: &Files,
    members: &Members,
    ending: &str,
) -> Result<Vec<[f32; D]>, Rejected> {
    let array = read_numbers(ending, &bytes(files, members, ending)?)?;
    match array.shape[..] {
        [_, width] if width == D => Ok(in_single_precision(&array)),
        _ => Err(rejected!(
            CODE,
            "{ending} has shape {:?}, expected [L, {D}]",
            array.shape
        )),
    }
}

/// Key and ending of a clip's member; `None` for other names.
fn member(name: &str) -> Option<(&str, &'static str)> {
    let (key, ending) = name.split_once('.')?;
    let mut endings = ARRAYS.into_iter().chain([FACTS]);
    let ending = endings.find(|known| *known == ending)?;
    (!key.is_empty()).then_some((key, ending))
}

/// The folder of a release: a shard belongs to the folder that holds it.
fn release_of(folder: &str) -> &str {
    let (above, name) = folder.rsplit_once('/').unwrap_or(("", folder));
    archive::stem(name).map_or(folder, |_| above)
}

fn bytes(files: &Files, members: &Members, ending: &str) -> Result<Vec<u8>, Rejected> {
    let Some(file) = members.get(ending) else {
        return Err(rejected!(
            CODE,
            "its {ending} is missing; export the clip again, or put all members of its key beside each other"
        ));
    };
    let length = files.size(file)?;
    if length > MAX_MEMBER_LEN {
        return Err(rejected!(
            "E-TOO-LARGE",
            "found {length} bytes in {ending}, expected at most {MAX_MEMBER_LEN} in a member"
        ));
    }
    files.read(file)
}

fn facts(files: &Files, members: &Members) -> Result<Facts, Rejected> {
    serde_json::from_slice(&bytes(files, members, FACTS)?)
        .map_err(|error| rejected!(CODE, "its {FACTS}: {error}"))
}
