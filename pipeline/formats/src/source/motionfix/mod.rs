//! The MotionFix release: pairs of motions and their edit instructions, in joblib dumps with split and
//! label files beside them.
//!
//! # Source
//! Repository athn-nik/motionfix: `motionfix.pth.tar` is a dictionary from ids to `motion_source`,
//! `motion_target` (`rots`, `trans`, `joint_positions`) and `text`; SMPL-H, z up, 30 fps.

use std::collections::BTreeMap;

use datasets_spec::{BodyPart, Split};
use features::released_fps;
use kinematics::skeleton::NUM_BODY_JOINTS;
use serde_json::{Map, Value as Json};

use super::files::Files;
use super::format::{Contents, Entry, Format, Release};
use super::head::{LFS_POINTER, refuse_pointer};
use super::names::file_name;
use super::options::ReadOptions;
use super::smpl::{Parameters, column, rotations_note};
use super::up::Up;
use clip::{EditOf, ReadClip, Rejected, RotationSource, SourceClip, rejected};
use pickle::joblib;
use pickle::{Options, Value};

/// Number of digits of an id.
const ID_DIGITS: usize = 6;

/// The file that states the split of each pair.
pub const SPLITS: &str = "splits.json";
/// Name prefixes of the release's label and statistics files, beside `splits.json`.
const LABELS: [&str; 8] = [
    "amt_motionfix",
    "gpt-labels_full",
    "gpt3-labels",
    "labels_val_spatial",
    "paraphrases_dict",
    "statistics_motionfix",
    "text-annot_val_spatial",
    "texts_pairs_val",
];
/// The label file that is read: body parts by instruction.
const PART_LABELS: &str = "gpt-labels_full";

const SOURCE: &str = "source";
const TARGET: &str = "target";

/// A pair of the dump.
///
/// A frame takes 276 bytes, so the whole release (13,460 motions of about five seconds) takes about 570 MB of memory;
/// decoding a dump takes little more than its contents.
#[derive(Clone, Debug, PartialEq)]
struct Pair {
    source: Result<Parameters, Rejected>,
    target: Result<Parameters, Rejected>,
    text: String,
    /// How the split was found, if no list names the pair.
    note: Option<String>,
}

/// The release in one folder, with its dumps decoded. Keys and split lists apply to this folder: another folder may
/// have the same keys for other pairs.
#[derive(Default)]
struct MotionFixRelease {
    contents: Contents,
    /// Pairs by key. A pair that differs from an earlier dump's pair of the same key has a key prefixed with its dump's
    /// name.
    pairs: BTreeMap<String, Pair>,
    /// Body parts by instruction.
    parts: BTreeMap<String, Vec<BodyPart>>,
    /// Number of pairs without a listed split, by how it was found.
    unlisted: BTreeMap<Unlisted, u64>,
}

/// How a pair that no list names gets its split.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Unlisted {
    /// By the name of its dump.
    FileName(Split),
    /// Drawn by its id, because there is no list.
    Draw,
    /// Training, because there is a list that does not name the pair.
    Train,
}

impl Unlisted {
    /// The note that says how the split was chosen.
    fn note(self) -> String {
        match self {
            Self::FileName(split) => {
                format!("no splits.json names it: {split} by the name of its dump alone")
            }
            Self::Draw => "no splits.json: the split was drawn, not published".to_owned(),
            Self::Train => "splits.json does not name it: taken for train".to_owned(),
        }
    }
}

/// The releases among the files: one in each folder with dumps.
pub fn find(files: &Files) -> Vec<Box<dyn Release>> {
    let dumps: Vec<&str> = files.all().filter(|file| is_dump(file)).collect();
    let labels: Vec<&str> = files.all().filter(|file| is_label(file, &dumps)).collect();
    let mut folders: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for dump in dumps {
        folders.entry(folder_of(dump)).or_default().push(dump);
    }
    if folders.is_empty() {
        let reason = "MotionFix label file without motions, motionfix.pth.tar is missing";
        let mut release = MotionFixRelease::default();
        for file in labels {
            release.contents.pass_over(file, reason);
        }
        return match release.contents.passed_over.is_empty() {
            true => Vec::new(),
            false => vec![Box::new(release)],
        };
    }
    let (own, common): (Vec<&str>, Vec<&str>) = labels
        .into_iter()
        .partition(|file| folders.contains_key(folder_of(file)));
    let mut releases: Vec<Box<dyn Release>> = Vec::with_capacity(folders.len());
    // Parts are keyed by the text of an instruction, so a label file outside the dumps' folders applies to all of them.
    let mut shared = MotionFixRelease::default();
    for file in common {
        shared.take_label(files, file, &mut Lists::new());
    }
    for (folder, dumps) in folders {
        let mut release = MotionFixRelease {
            // Files outside the dumps' folders are listed once, in the first release.
            contents: std::mem::take(&mut shared.contents),
            parts: shared.parts.clone(),
            ..MotionFixRelease::default()
        };
        let mut lists = Lists::new();
        for file in own.iter().filter(|file| folder_of(file) == folder) {
            release.take_label(files, file, &mut lists);
        }
        for file in dumps {
            release.take_dump(files, file, &lists);
        }
        release.remark(&lists);
        releases.push(Box::new(release));
    }
    releases
}

/// Splits by key.
type Lists = BTreeMap<String, Split>;

fn folder_of(file: &str) -> &str {
    file.strip_suffix(file_name(file)).unwrap_or_default()
}

/// Whether a file is a dump of the release, by its name.
pub fn is_dump(file: &str) -> bool {
    let name = file_name(file).to_lowercase();
    name.starts_with("motionfix") && name.ends_with(".pth.tar")
}

fn is_label(file: &str, dumps: &[&str]) -> bool {
    let name = file_name(file);
    if name == SPLITS {
        return dumps.iter().any(|dump| folder_of(dump) == folder_of(file));
    }
    (name.ends_with(".json") || name.ends_with(".npy"))
        && LABELS.iter().any(|label| name.starts_with(label))
}

/// The split that the name of a dump states, as in `motionfix_val.pth.tar`.
fn split_of_dump(file: &str) -> Option<Split> {
    let name = file_name(file).to_lowercase();
    let stem = name.strip_suffix(".pth.tar")?;
    stem.rsplit_once('_')?.1.parse().ok()
}

fn padded(id: &str) -> String {
    format!("{id:0>ID_DIGITS$}")
}

impl MotionFixRelease {
    /// Reads the label files that describe motions, and skips the others.
    fn take_label(&mut self, files: &Files, file: &str, splits: &mut Lists) {
        let name = file_name(file);
        let has_parts = name.starts_with(PART_LABELS);
        if name != SPLITS && !has_parts {
            let reason = "MotionFix label file that belongs to no motion";
            return self.contents.pass_over(file, reason);
        }
        let read = files.read(file).and_then(|bytes| {
            refuse_pointer(&bytes)?;
            let content: Map<String, Json> = serde_json::from_slice(&bytes)
                .map_err(|error| rejected!("E-MOTIONFIX-JSON", "found no JSON object ({error})"))?;
            let splits = content.iter().filter(|_| !has_parts);
            let mut lists = splits
                .filter(|(key, _)| key.parse::<Split>().is_ok())
                .peekable();
            match has_parts || lists.peek().is_some() && lists.all(|(_, list)| list.is_array()) {
                true => Ok(content),
                false => Err(rejected!(
                    "E-MOTIONFIX-JSON",
                    "found no lists of keys under train, val and test"
                )),
            }
        });
        let content = match read {
            Ok(content) => content,
            Err(rejected) if has_parts => return self.contents.reject(file, rejected),
            Err(rejected) => return self.contents.reject_splits(file, rejected),
        };
        let mut unknown: Vec<&str> = Vec::new();
        for (key, value) in &content {
            if has_parts {
                let (parts, known) = value.as_str().map_or((Vec::new(), false), parse_parts);
                // Instructions are trimmed in dumps; some keys of the published file end in a blank.
                let key = key.trim();
                unknown.extend((!known).then_some(key));
                self.parts.insert(key.to_owned(), parts);
            } else if let Ok(split) = key.parse::<Split>() {
                let ids = value.as_array().into_iter().flatten();
                let ids = ids.filter_map(|id| match id {
                    Json::String(id) => Some(padded(id)),
                    Json::Number(id) => Some(padded(&id.to_string())),
                    _ => None,
                });
                splits.extend(ids.map(|id| (id, split)));
            }
        }
        if let Some(first) = unknown.first() {
            self.contents.remarks.push(format!(
                "MotionFix: {} answers of {file} name a part that is not known, or none, such as that to {first:?}",
                unknown.len()
            ));
        }
        let reason = "MotionFix label file, read with the motions";
        self.contents.pass_over(file, reason);
    }

    /// Decodes a dump and plans the motions that no earlier dump of the folder had. A pair whose key already belongs to
    /// a different pair gets a new key.
    fn take_dump(&mut self, files: &Files, file: &str, splits: &Lists) {
        let entries = match decode(files, file) {
            Ok(entries) => entries,
            Err(rejected) => return self.contents.reject(file, rejected),
        };
        let found = entries.len();
        // Ids of the added pairs in the split list, by key in `pairs`.
        let mut added: BTreeMap<String, String> = BTreeMap::new();
        let (mut differing, mut odd) = (0u64, 0u64);
        for (key, value) in entries {
            let id = match &key {
                Value::Str(id) => padded(id),
                Value::Int(id) => padded(&id.to_string()),
                _ => {
                    odd += 1;
                    continue;
                }
            };
            let pair = Pair::of(&value);
            let key = match self.pairs.get(&id) {
                None => id.clone(),
                Some(known) if known.is_equal(&pair) => continue,
                Some(_) => {
                    differing += 1;
                    let stem = file_name(file).split('.').next().unwrap_or_default();
                    let own = format!("{stem}/{id}");
                    let numbered = (2..).map(|number| format!("{stem}-{number}/{id}"));
                    let mut keys = std::iter::once(own).chain(numbered);
                    keys.find(|key| !self.pairs.contains_key(key))
                        .expect("numbers do not end")
                }
            };
            self.pairs.insert(key.clone(), pair);
            added.insert(key, id);
        }
        if differing > 0 {
            self.contents.remarks.push(format!(
                "MotionFix: {differing} pairs of {file} have the keys of other pairs in its folder; their ids begin \
                 with the name of their dump, and {SPLITS} does not speak of them"
            ));
        }
        if odd > 0 {
            self.contents.remarks.push(format!(
                "MotionFix: {odd} pairs of {file} are left out: their keys are neither texts nor whole numbers"
            ));
        }
        if added.is_empty() {
            let reason = match found {
                0 => "MotionFix dump without motions",
                _ => "MotionFix dump whose pairs are all in another one of its folder",
            };
            self.contents.pass_over(file, reason);
        }
        for (key, id) in added {
            // Both motions of a pair share a split, even if no list states it.
            let listed = splits.get(&id).copied().filter(|_| key == id);
            let (split, unlisted) = match (listed, split_of_dump(file)) {
                (Some(split), _) => (Some(split), None),
                (None, Some(split)) => (Some(split), Some(Unlisted::FileName(split))),
                (None, None) if splits.is_empty() => (None, Some(Unlisted::Draw)),
                (None, None) => (Some(Split::Train), Some(Unlisted::Train)),
            };
            if let (Some(unlisted), Some(pair)) = (unlisted, self.pairs.get_mut(&key)) {
                *self.unlisted.entry(unlisted).or_default() += 1;
                pair.note = Some(unlisted.note());
            }
            self.contents
                .entries
                .extend([SOURCE, TARGET].into_iter().map(|side| Entry {
                    file: file.to_owned(),
                    key: format!("{key}/{side}"),
                    id: motion_id(&key, side),
                    split,
                    group: Some(key.clone()),
                    mirrored_of: None,
                }));
        }
    }

    /// Adds remarks on the splits of pairs that no list names, and on listed keys without a pair.
    fn remark(&mut self, lists: &Lists) {
        let missing = lists.keys().filter(|key| !self.pairs.contains_key(*key));
        let missing = missing.map(String::as_str).collect();
        self.contents.remark_on_listed("MotionFix", SPLITS, missing);
        for (unlisted, count) in &self.unlisted {
            self.contents.remarks.push(match unlisted {
                Unlisted::FileName(split) => format!(
                    "MotionFix: {count} pairs are in no splits.json and have the split of their dump's \
                     name, {split}, which repackagings are known to get wrong: test pairs may be in train"
                ),
                Unlisted::Draw => format!(
                    "MotionFix: {count} pairs have no splits.json and were given drawn splits, which \
                     are not the published ones"
                ),
                Unlisted::Train => {
                    format!("MotionFix: {count} pairs are not in splits.json and were put into train")
                }
            });
        }
    }
}

fn motion_id(id: &str, side: &str) -> String {
    format!("motionfix/{id}-{side}")
}

impl Release for MotionFixRelease {
    fn contents(&self) -> &Contents {
        &self.contents
    }

    fn read(&self, _files: &Files, entry: &Entry, options: &ReadOptions) -> ReadClip {
        let planned = entry.key.rsplit_once('/');
        let (id, side, pair) = planned
            .and_then(|(id, side)| Some((id, side, self.pairs.get(id)?)))
            .ok_or_else(|| rejected!("E-IO", "{} is not in the release", entry.key))?;
        let parameters = match side {
            SOURCE => &pair.source,
            _ => &pair.target,
        };
        let parameters = parameters.as_ref().map_err(Rejected::clone)?;
        let motion = parameters.turned(Up::Z.turn(), released_fps(), &options.skeleton)?;
        let mut clip = SourceClip::new(motion, RotationSource::Native);
        clip.notes = vec![
            "SMPL-H parameters (66 pose columns), z up, placed at the origin".to_owned(),
            rotations_note(&options.skeleton),
        ];
        clip.notes.extend(pair.note.clone());
        if side == TARGET {
            clip.edits.push(EditOf {
                source_id: motion_id(id, SOURCE),
                kind: "fine-grained",
                style: None,
                parts: self.parts.get(&pair.text).cloned().unwrap_or_default(),
                instruction: pair.text.clone(),
                made: None,
            });
        }
        Ok(clip)
    }
}

/// The entries of a dump. It is decoded as a stream: joint positions, which follow from the rotations, are
/// dropped on the way.
fn decode(files: &Files, file: &str) -> Result<Vec<(Value, Value)>, Rejected> {
    let opened = files.open_at(file)?;
    let len = files.size(file)?;
    if len < 4 * LFS_POINTER.len() as u64 {
        refuse_pointer(&files.read(file)?)?;
    }
    let options = Options {
        drop_keys: &["joint_positions"],
        single_precision: true,
    };
    let dump = joblib::read_from(opened, len, &options)?;
    match dump {
        Value::Dict(entries) => Ok(entries),
        other => Err(rejected!(
            "E-MOTIONFIX-KEYS",
            "found {}, expected a dictionary from ids to pairs",
            other.describe()
        )),
    }
}

impl Pair {
    /// Whether both pairs have the same motions and the same text.
    fn is_equal(&self, other: &Self) -> bool {
        (&self.source, &self.target, &self.text) == (&other.source, &other.target, &other.text)
    }

    fn of(value: &Value) -> Self {
        let side = |key: &str| {
            let motion = value.get(key).ok_or_else(|| {
                rejected!(
                    "E-MOTIONFIX-KEYS",
                    "found {}, expected one with motion_source, motion_target and text",
                    value.describe()
                )
            })?;
            let rotations = column(motion, "rots")?;
            Parameters::of_poses(rotations.into_iter(), column(motion, "trans")?)
        };
        let text = value.get("text");
        let first = text.and_then(Value::as_sequence).and_then(<[Value]>::first);
        let text = text
            .and_then(Value::as_str)
            .or(first.and_then(Value::as_str));
        Self {
            source: side("motion_source"),
            target: side("motion_target"),
            text: text.unwrap_or_default().trim().to_owned(),
            note: None,
        }
    }
}

/// The parts that an answer such as `Answer: right arm\nleft arm` names. `buttocks` maps to the lower
/// body, which owns the root; `neck` maps to the head. Also whether all names are known.
fn parse_parts(answer: &str) -> (Vec<BodyPart>, bool) {
    let mut all_known = true;
    let answer = answer.trim().trim_start_matches("Answer:").to_lowercase();
    let mut parts: Vec<BodyPart> = answer
        .split(['\n', ','])
        .filter_map(|name| {
            Some(match name.trim().trim_end_matches('.') {
                "left arm" | "left hand" => BodyPart::LeftArm,
                "right arm" | "right hand" => BodyPart::RightArm,
                "left leg" => BodyPart::LeftLeg,
                "right leg" => BodyPart::RightLeg,
                "torso" => BodyPart::Torso,
                "neck" | "necks" | "head" => BodyPart::Head,
                "buttocks" => BodyPart::LowerBody,
                "" => return None,
                _ => {
                    all_known = false;
                    return None;
                }
            })
        })
        .collect();
    parts.sort();
    parts.dedup();
    if parts.contains(&BodyPart::LowerBody) {
        parts.retain(|part| !matches!(part, BodyPart::LeftLeg | BodyPart::RightLeg));
    }
    (parts, all_known)
}

/// A folder of the MotionFix release.
// Bytes per second: source and target in f4 at 30 fps: translation, rotations and joint positions.
pub const FORMAT: Format = Format {
    find,
    ..Format::of_releases(
        "motionfix",
        "motionfix*.pth.tar (joblib, packed or not); splits.json beside it gives the splits; its own rotations, with \
         pairs",
        (2 * 4 * 3 * (1 + 2 * NUM_BODY_JOINTS) * 30) as f64,
    )
};

#[cfg(test)]
mod tests;
