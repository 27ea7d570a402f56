//! WebDataset exports of this program: tar shards, or the files unpacked from them.
//!
//! A clip is `KEY.transl.npy`, `KEY.global_orient.npy`, `KEY.body_pose.npy` and `KEY.json`. The last holds id, split,
//! rate and labels. The shards of a folder are one release.

use std::collections::BTreeMap;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use datasets_spec::store::{ByPath, Reader, Store};
use datasets_spec::table::PartCaption;
use datasets_spec::{Fps, Motion};
use pickle::npy::read_numbers;
use serde::Deserialize;

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
    split: Option<String>,
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

/// Location of a member: start and length of a range of a tar file, or a whole file.
#[derive(Clone, Debug)]
struct Place {
    file: String,
    range: Option<(u64, u64)>,
}

/// Members of a clip by their endings.
type Members = BTreeMap<&'static str, Place>;

/// The clips of a folder's shards, before they are read.
#[derive(Debug, Default)]
struct Shards {
    contents: Contents,
    /// Clips by file and key of the entry.
    clips: BTreeMap<(String, String), Members>,
}

impl Shards {
    /// Finds the folders with shards or unpacked files.
    fn find(files: &Files) -> Vec<Self> {
        // By folder; then by archive (empty for unpacked files) and key, because a key is unique only within a shard.
        let mut found: BTreeMap<&str, BTreeMap<(String, String), Members>> = BTreeMap::new();
        for file in files.all() {
            let (folder, name) = file.rsplit_once('/').unwrap_or(("", file));
            let members = match name.ends_with(".tar") {
                true => members_of(files, file),
                false => member(name)
                    .into_iter()
                    .map(|(key, ending)| {
                        let place = Place {
                            file: file.to_owned(),
                            range: None,
                        };
                        ((String::new(), key.to_owned()), ending, place)
                    })
                    .collect(),
            };
            for (key, ending, place) in members {
                let clips = found.entry(folder).or_default();
                clips.entry(key).or_default().insert(ending, place);
            }
        }
        found
            .into_values()
            .map(|clips| Self::plan(files, clips))
            .filter(|shards| !shards.clips.is_empty())
            .collect()
    }

    fn plan(files: &Files, clips: BTreeMap<(String, String), Members>) -> Self {
        let mut shards = Self::default();
        for ((_, key), members) in clips {
            // Any npy or json file may have such an ending; a clip has the three arrays.
            if !ARRAYS.iter().all(|ending| members.contains_key(ending)) {
                continue;
            }
            // Invalid metadata is reported when the clip is read.
            let facts = facts(files, &members).unwrap_or_default();
            let file = members[ARRAYS[0]].file.clone();
            for place in members.values().filter(|place| place.range.is_none()) {
                if place.file != file {
                    let reason = "member of a clip of a WebDataset, read with it";
                    shards.contents.pass_over(&place.file, reason);
                }
            }
            shards.contents.entries.push(Entry {
                file: file.clone(),
                key: key.clone(),
                id: match facts.id {
                    id if id.is_empty() => key.clone(),
                    id => id,
                },
                split: facts.split.and_then(|split| split.parse().ok()),
                mirrored_of: facts.mirrored_of,
                ..Entry::default()
            });
            shards.clips.insert((file, key), members);
        }
        shards
    }
}

impl Release for Shards {
    fn contents(&self) -> &Contents {
        &self.contents
    }

    fn read(&self, files: &Files, entry: &Entry, options: &ReadOptions) -> ReadClip {
        let refused = |reason: String| Rejected::read(CODE, reason);
        let members = self
            .clips
            .get(&(entry.file.clone(), entry.key.clone()))
            .ok_or_else(|| refused("there is no such clip".to_owned()))?;
        let facts = facts(files, members)?;
        if let Some(found) = &facts.skeleton {
            check_skeleton(found, options)?;
        }
        let [transl, global_orient, body_pose] = ARRAYS;
        let transl = rows(files, &members[transl], transl)?;
        let global_orient = rows(files, &members[global_orient], global_orient)?;
        let body_pose = rows(files, &members[body_pose], body_pose)?;
        let motion = Fps::new(facts.fps.unwrap_or(Fps::STORE.get()))
            .and_then(|fps| Motion::new(fps, transl, global_orient, body_pose))
            .map_err(|error| refused(error.to_string()))?;
        let said = facts.captions.into_iter();
        let (made, stated): (Vec<_>, Vec<_>) = said.partition(LabelCaption::is_made);
        let texts = |said: Vec<LabelCaption>| said.into_iter().map(|said| said.caption).collect();
        let rotations = facts.rotation_source.as_deref().unwrap_or_default();
        Ok(SourceClip {
            captions: texts(stated),
            made_captions: texts(made),
            part_captions: facts.parts,
            subject: facts.subject,
            action: facts.action,
            style: facts.style,
            license: facts.license,
            fit_error_m: facts.fit_error_m,
            ..SourceClip::new(motion, RotationSource::of_name(rotations))
        })
    }
}

/// Reads a member that holds an array `[L, D]`.
fn rows<const D: usize>(
    files: &Files,
    place: &Place,
    ending: &str,
) -> Result<Vec<[f32; D]>, Rejected> {
    let array = read_numbers(ending, &bytes(files, place)?)?;
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

/// Whether a tar file is a shard, by its first member.
pub(super) fn is_shard(path: &Path) -> bool {
    let Ok(opened) = ByPath.open_at(path) else {
        return false;
    };
    let mut archive = tar::Archive::new(Reader::new(opened));
    let first = archive
        .entries_with_seek()
        .ok()
        .and_then(|mut entries| entries.next());
    first.is_some_and(|entry| {
        entry.is_ok_and(|entry| member(&String::from_utf8_lossy(&entry.path_bytes())).is_some())
    })
}

/// The members of a clip in an archive, up to the first error or other member.
fn members_of(files: &Files, file: &str) -> Vec<((String, String), &'static str, Place)> {
    let mut members = Vec::new();
    let Ok(opened) = files.open_at(file) else {
        return members;
    };
    let mut archive = tar::Archive::new(opened);
    let Ok(entries) = archive.entries_with_seek() else {
        return members;
    };
    for entry in entries {
        let Ok(entry) = entry else { break };
        let name = String::from_utf8_lossy(&entry.path_bytes()).into_owned();
        // An archive with other members is not read to its end.
        let Some((key, ending)) = member(&name) else {
            break;
        };
        let place = Place {
            file: file.to_owned(),
            range: Some((entry.raw_file_position(), entry.size())),
        };
        members.push(((file.to_owned(), key.to_owned()), ending, place));
    }
    members
}

fn bytes(files: &Files, place: &Place) -> Result<Vec<u8>, Rejected> {
    let Some((start, length)) = place.range else {
        return files.read(&place.file);
    };
    let failed = |error: std::io::Error| rejected!("E-IO", "cannot read {}: {error}", place.file);
    if length > MAX_MEMBER_LEN {
        return Err(rejected!(
            "E-TOO-LARGE",
            "found {length} bytes, expected at most {MAX_MEMBER_LEN} in a member"
        )
        .at(start as usize));
    }
    let mut file = files.open_at(&place.file)?;
    file.seek(SeekFrom::Start(start)).map_err(failed)?;
    let mut bytes = Vec::new();
    file.take(length).read_to_end(&mut bytes).map_err(failed)?;
    Ok(bytes)
}

fn facts(files: &Files, members: &Members) -> Result<Facts, Rejected> {
    let Some(place) = members.get(FACTS) else {
        return Ok(Facts::default());
    };
    serde_json::from_slice(&bytes(files, place)?)
        .map_err(|error| rejected!(CODE, "{}: {error}", place.file))
}
