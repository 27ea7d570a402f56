//! The STANCE release: base motions, body-part annotations, style transfers and fine-grained
//! adjustments, in its present layout and under the path names of its earlier revision.
//!
//! A folder is a release if it holds a pickle under `base_motion`, `style_transfer` or `adjustment`, at any depth.
//! Motions are not moved: they are y up already, and the two motions of an adjustment share world coordinates.

mod annotation;
mod labels;
mod motion;
mod name;
pub mod origin;
mod split;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::Split;
use datasets_spec::record::{CAPTION_BY_RULE, MaskRow, PairRow};
use kinematics::motion::BODY_POSE_WIDTH;
use pickle::{Value, joblib};
use serde_json::Value as Json;

use self::annotation::{Annotations, parse_parts};
use self::labels::Labels;
use self::motion::release_clip;
use self::name::{listed_name, motion_id, original_of};
use self::origin::{CODE_OF_ORIGIN, Origin, Origins, Parsed};
use self::split::Lists;
use super::files::Files;
use super::format::{Contents, Entry, Format, Release, boxed, check_skeleton};
use super::head::refuse_pointer;
use super::names::{around_folder, file_name};
use super::options::ReadOptions;
use super::up::Up;
use clip::{EditOf, ReadClip, Rejected, SourceClip, rejected};

pub use motion::read_pickle_motion;
pub use name::{FIRST_FREE_NUMBER, file_stem};
pub use origin::exported_labels;

/// The releases among the files.
pub fn find(files: &Files) -> Vec<Box<dyn Release>> {
    let roots = roots(files).into_iter();
    boxed(roots.map(|root| StanceRelease::plan(files, root)))
}

/// A folder of the STANCE release.
// Bytes per second: the parameters in f4 at 20 fps.
pub const FORMAT: Format = Format {
    extensions: &["pkl", "pickle"],
    assumed_up: Some(Up::Y),
    read: |_, _, bytes, options| motion::read_pickle(bytes, &options.skeleton),
    find,
    ..Format::of_releases(
        "stance",
        "a folder of the STANCE release, in its present or older paths; a lone pickle; its own rotations, with masks \
         and pairs",
        (4 * (3 + 3 + BODY_POSE_WIDTH) * 20) as f64,
    )
};

/// Folder of captured motions.
pub const BASE_MOTION: &str = "base_motion";
/// Folder of motions in a style.
pub const STYLE_TRANSFER: &str = "style_transfer";
/// Folder of fine-grained pairs.
pub const ADJUSTMENT: &str = "adjustment";
/// Folder of masks and their texts.
pub const REGEN: &str = "regen";
/// Folder of lists of splits.
pub const SPLIT: &str = "split";
const FOLDERS: [&str; 5] = [BASE_MOTION, STYLE_TRANSFER, ADJUSTMENT, REGEN, SPLIT];

/// Keys of the two motions of an adjustment.
const SOURCE_KEY: &str = "src";
const TARGET_KEY: &str = "tgt";

/// Largest pickle read, in bytes: an hour at 20 fps takes 20 MB.
const MAX_PICKLE_LEN: u64 = 256 << 20;

/// Values of JSON files by the names of motions.
type ByName = BTreeMap<String, Json>;

/// Folders (empty, or ending in `/`) that hold a release.
fn roots(files: &Files) -> BTreeSet<String> {
    files
        .all()
        .filter(|path| path.ends_with(".pkl"))
        .filter_map(|path| {
            let (root, folder, _) = place(path)?;
            [BASE_MOTION, STYLE_TRANSFER, ADJUSTMENT]
                .contains(&folder)
                .then(|| root.to_owned())
        })
        .collect()
}

/// Splits a path into the release's folder, its folder of [`FOLDERS`], and the rest.
fn place(path: &str) -> Option<(&str, &'static str, &str)> {
    around_folder(path, &FOLDERS)
}

/// Role of a motion in the release, with the id of the motion that it is an edit of.
#[derive(Clone, Debug)]
enum Role {
    /// A base motion.
    Base,
    /// A base motion in a style.
    Styled {
        source_id: String,
        style: String,
    },
    /// The source motion of an adjustment.
    Source,
    Target {
        source_id: String,
    },
}

impl Role {
    /// The motion in the pickle.
    fn motion<'a>(&self, pickle: &'a Value) -> Result<&'a Value, Rejected> {
        match self {
            Self::Base | Self::Styled { .. } => Ok(pickle),
            Self::Source => of_pair(pickle, SOURCE_KEY),
            Self::Target { .. } => of_pair(pickle, TARGET_KEY),
        }
    }
}

/// Data of a motion beside its entry.
#[derive(Clone, Debug)]
struct Detail {
    role: Role,
    origin: Option<Origin>,
    /// Further pairs with this motion as the target: file and source id.
    edited_in: Vec<(String, String)>,
}

/// The motions of a release, before they are read.
#[derive(Default)]
struct StanceRelease {
    contents: Contents,
    /// Details of motions by file and key.
    details: BTreeMap<(String, String), Detail>,
    annotations: Annotations,
    /// Body part and text of adjustments by file stem, for pickles that lack them.
    adjustments: ByName,
    /// Labels from the export's own files; they replace those of the release's files and lists.
    labels: Option<Labels>,
}

impl StanceRelease {
    fn plan(files: &Files, root: String) -> Self {
        let mut planner = Planner {
            files,
            root: &root,
            release: Self {
                contents: Contents {
                    publishes_splits: "lists in the folder split",
                    ..Contents::default()
                },
                ..Self::default()
            },
            base_lists: Lists::default(),
            style_lists: Lists::default(),
            adjustment_lists: Lists::default(),
            origins: Origins::new(),
            taken: BTreeMap::new(),
        };
        planner.read_origin();
        planner.read_lists();
        planner.plan_motions();
        planner.note_missing();
        planner.remark();
        planner.release
    }

    /// Adds a motion's labels from the files and lists of a release.
    fn describe(
        &self,
        files: &Files,
        (entry, detail): (&Entry, &Detail),
        pickle: &Value,
        clip: &mut SourceClip,
    ) -> Result<(), Rejected> {
        match &detail.role {
            Role::Base => {
                let named = motion_id(listed_name(&entry.file));
                self.annotations.attach(&named, clip);
            }
            Role::Styled { source_id, style } => {
                clip.style = Some(style.clone());
                clip.edits.push(EditOf {
                    source_id: source_id.clone(),
                    kind: "style",
                    style: Some(style.clone()),
                    parts: Vec::new(),
                    instruction: text_of(pickle, "text"),
                    made: None,
                });
            }
            Role::Source => {}
            Role::Target { source_id } => {
                let edit = self.edit_of(pickle, &entry.file, source_id, &mut clip.notes);
                clip.edits.push(edit);
            }
        }
        for (file, source_id) in &detail.edited_in {
            let pair = read_pickle(files, file)?;
            let edit = self.edit_of(&pair, file, source_id, &mut clip.notes);
            clip.edits.push(edit);
        }
        Ok(())
    }

    /// The edit that an adjustment describes.
    fn edit_of(
        &self,
        pair: &Value,
        file: &str,
        source_id: &str,
        notes: &mut Vec<String>,
    ) -> EditOf {
        let beside = self
            .adjustments
            .get(listed_name(file))
            .unwrap_or(&Json::Null);
        let said = |key: &str| match text_of(pair, key) {
            text if text.is_empty() => beside[key].as_str().unwrap_or_default().to_owned(),
            text => text,
        };
        let (parts, unknown) = parse_parts(&said("body_part"));
        notes.extend(unknown);
        EditOf {
            source_id: source_id.to_owned(),
            kind: "fine-grained",
            style: None,
            parts,
            instruction: said("text"),
            made: None,
        }
    }
}

impl Release for StanceRelease {
    fn contents(&self) -> &Contents {
        &self.contents
    }

    fn read(&self, files: &Files, entry: &Entry, options: &ReadOptions) -> ReadClip {
        let detail = self
            .details
            .get(&(entry.file.clone(), entry.key.clone()))
            .ok_or_else(|| rejected!("E-IO", "{} is not in the release", entry.file))?;
        let pickle = read_pickle(files, &entry.file)?;
        let mut clip = release_clip(detail.role.motion(&pickle)?)?;
        match (&self.labels, &detail.origin) {
            (Some(labels), Some(origin)) => {
                labels.check(entry, origin, &clip)?;
                check_skeleton(&labels.record.skeleton, options)?;
                labels.attach(origin, &mut clip);
            }
            _ => self.describe(files, (entry, detail), &pickle, &mut clip)?,
        }
        let stem = listed_name(&entry.file);
        if motion_id(stem) != stem {
            clip.notes.push(format!("file {stem} of the release"));
        }
        if let Some(origin) = &detail.origin {
            for (index, caption) in origin.captions.iter().enumerate() {
                let by = origin.caption_origins.get(index).map(String::as_str);
                match by {
                    Some(CAPTION_BY_RULE) => clip.made_captions.push(caption.clone()),
                    _ => clip.captions.push(caption.clone()),
                }
            }
            clip.subject.clone_from(&origin.subject);
            clip.action.clone_from(&origin.action);
            clip.style.clone_from(&origin.style);
            clip.license.clone_from(&origin.license);
        }
        Ok(clip)
    }
}

fn read_pickle(files: &Files, file: &str) -> Result<Value, Rejected> {
    let len = files.size(file)?;
    if len > MAX_PICKLE_LEN {
        return Err(rejected!(
            "E-TOO-LARGE",
            "found {len} bytes, expected at most {MAX_PICKLE_LEN} in a pickle"
        ));
    }
    let bytes = files.read(file)?;
    refuse_pointer(&bytes)?;
    Ok(joblib::read(&bytes)?)
}

fn of_pair<'a>(value: &'a Value, key: &str) -> Result<&'a Value, Rejected> {
    value.get(key).ok_or_else(|| {
        rejected!(
            "E-STANCE-KEYS",
            "found {}, expected one with src, tgt, body_part and text",
            value.describe()
        )
    })
}

/// The text of a key, or several texts joined by `+`; empty if there is none.
fn text_of(value: &Value, key: &str) -> String {
    match value.get(key) {
        Some(Value::Str(text)) => text.trim().to_owned(),
        Some(Value::List(items) | Value::Tuple(items)) => {
            let texts: Vec<&str> = items.iter().filter_map(Value::as_str).collect();
            texts.join("+")
        }
        _ => String::new(),
    }
}

/// Plans the motions in the files of a release.
struct Planner<'a> {
    files: &'a Files,
    root: &'a str,
    release: StanceRelease,
    base_lists: Lists,
    style_lists: Lists,
    adjustment_lists: Lists,
    origins: Origins,
    /// First file and key of each motion of an export, which may contain a motion twice.
    taken: BTreeMap<String, (String, String)>,
}

impl Planner<'_> {
    /// Reads the files that an export adds to the layout.
    fn read_origin(&mut self) {
        let at = |name: &str| format!("{}{name}", self.root);
        let [file, masks, pairs] = [origin::FILE_NAME, origin::MASKS, origin::PAIRS].map(at);
        if !self.files.contains(&file) {
            return;
        }
        let mut labels = [&masks, &pairs].into_iter();
        let lost = labels.find(|file| !self.files.contains(file)).cloned();
        let parsed = self.take(&file, |bytes| {
            let parsed = origin::parse(bytes)?;
            match (&parsed, lost) {
                (Parsed::Record(_), Some(lost)) => {
                    Err(format!("{lost} is missing, with the labels of the motions"))
                }
                _ => Ok(parsed),
            }
        });
        let record = match parsed {
            None => return,
            Some(Parsed::Motions(motions)) => {
                self.origins = motions;
                return;
            }
            Some(Parsed::Record(record)) => record,
        };
        let ids: BTreeSet<&str> = record.motions.values().map(|origin| &*origin.id).collect();
        let masks = self.take(&masks, |bytes| {
            labels::rows_of(bytes, &ids, |row: &MaskRow| vec![&row.motion_id])
        });
        let pairs = self.take(&pairs, |bytes| {
            labels::rows_of(bytes, &ids, |row: &PairRow| {
                vec![&row.source_id, &row.target_id]
            })
        });
        self.origins.clone_from(&record.motions);
        let labels = Labels::new(record, masks.unwrap_or_default(), pairs.unwrap_or_default());
        self.release.labels = Some(labels);
    }

    /// Whether a list in the layout of the release is as the export wrote it. A changed list is rejected: the export's
    /// own files hold its content.
    fn is_as_written(&mut self, file: &str) -> bool {
        let name = file.strip_prefix(self.root).unwrap_or(file);
        let labels = self.release.labels.as_ref();
        let Some(written) = labels.and_then(|labels| labels.record.lists.get(name)) else {
            return true;
        };
        let found = self.files.read(file);
        let found = found.map(|bytes| blake3::hash(&bytes).to_hex().to_string());
        if found.is_ok_and(|found| found == *written) {
            return true;
        }
        let reason = format!(
            "was changed since the export, of which {} holds the masks; change them there, or remove {} to read the \
             folder as a release",
            origin::MASKS,
            origin::FILE_NAME
        );
        let rejected = Rejected::read(CODE_OF_ORIGIN, reason);
        self.release.contents.reject(file, rejected);
        false
    }

    /// Notes motions of an export without a file.
    fn note_missing(&mut self) {
        let labels = self.release.labels.as_ref();
        let remark = labels.and_then(|labels| labels.missing(|id| self.taken.contains_key(id)));
        self.release.contents.remarks.extend(remark);
    }

    /// Reads the lists and annotations.
    fn read_lists(&mut self) {
        let (mut masks, mut texts) = (ByName::new(), ByName::new());
        let files: Vec<&str> = self.files.under(self.root).collect();
        for file in files {
            if !self.is_as_written(file) {
                continue;
            }
            let Some((root, folder, rest)) = place(file) else {
                continue;
            };
            if root != self.root {
                continue;
            }
            match (folder, file_name(rest)) {
                (REGEN, "mask_all.json") => self.add(file, &mut masks),
                (REGEN, "part_annotations.json") => self.add(file, &mut texts),
                (ADJUSTMENT, name)
                    if name.starts_with("adjustment_annotations") && name.ends_with(".json") =>
                {
                    let mut adjustments = std::mem::take(&mut self.release.adjustments);
                    self.add(file, &mut adjustments);
                    self.release.adjustments = adjustments;
                }
                (SPLIT, _) => self.read_list(file, rest),
                _ => {}
            }
        }
        self.release.annotations = Annotations::new(&masks, &texts);
    }

    fn read_list(&mut self, file: &str, rest: &str) {
        let mut components = rest.rsplit('/');
        let name = components.next().unwrap_or_default();
        let section = components.next().unwrap_or(BASE_MOTION);
        let (stem, extension) = name.rsplit_once('.').unwrap_or((name, ""));
        let Some(split) = Lists::split_of(stem) else {
            return;
        };
        let parse: fn(Split, &[u8]) -> Result<Lists, String> = match extension {
            "txt" => |split, bytes| {
                let text = str::from_utf8(bytes).map_err(|error| error.to_string())?;
                Ok(Lists::of_lines(split, text))
            },
            "json" => |split, bytes| {
                let value: Json =
                    serde_json::from_slice(bytes).map_err(|error| error.to_string())?;
                match value.is_array() || value.is_object() {
                    true => Ok(Lists::of_json(split, &value)),
                    false => Err("found no list of names".to_owned()),
                }
            },
            _ => return,
        };
        let Some(lists) = self.take(file, |bytes| parse(split, bytes)) else {
            self.release.contents.unread_splits.push(file.to_owned());
            return;
        };
        let all = match section {
            STYLE_TRANSFER => &mut self.style_lists,
            ADJUSTMENT => &mut self.adjustment_lists,
            _ => &mut self.base_lists,
        };
        all.join(lists);
    }

    /// Adds the content of a JSON file of the release, an object with a value for each motion, by the names that lists
    /// give these. A file of another form is rejected, and so is one that says something else of a motion than a file
    /// before it.
    fn add(&mut self, file: &str, known: &mut ByName) {
        let before = known.clone();
        let all = self.take(file, |bytes| {
            let parsed: Json = serde_json::from_slice(bytes).map_err(|error| error.to_string())?;
            let Json::Object(values) = parsed else {
                return Err("found no object with a value for each motion".to_owned());
            };
            let mut all = before;
            for (key, value) in values {
                let name = listed_name(&key).to_owned();
                match all.insert(name, value) {
                    Some(other) if other != all[listed_name(&key)] => {
                        return Err(format!(
                            "another key, or a file before it, says something else of {key:?}"
                        ));
                    }
                    _ => {}
                }
            }
            Ok(all)
        });
        known.extend(all.into_iter().flatten());
    }

    /// Parses a file of the release; `None` if it is damaged, which is recorded.
    fn take<T>(&mut self, file: &str, parse: impl FnOnce(&[u8]) -> Result<T, String>) -> Option<T> {
        let read = self.files.read(file).and_then(|bytes| {
            refuse_pointer(&bytes)?;
            let code = match file.ends_with(origin::FILE_NAME) || file.ends_with(".jsonl") {
                true => CODE_OF_ORIGIN,
                false => "E-STANCE-JSON",
            };
            let broken = |error| rejected!(code, "{file} is no such list ({error})");
            parse(&bytes).map_err(broken)
        });
        match read {
            Ok(value) => {
                let reason = "list of the STANCE release, read with its motions";
                self.release.contents.pass_over(file, reason);
                Some(value)
            }
            Err(rejected) => {
                self.release.contents.reject(file, rejected);
                None
            }
        }
    }

    fn plan_motions(&mut self) {
        let clips = Lists::of_clips(&self.base_lists, &self.style_lists);
        for section in [BASE_MOTION, STYLE_TRANSFER, ADJUSTMENT] {
            let prefix = format!("{}{section}/", self.root);
            let files: Vec<&str> = self
                .files
                .under(&prefix)
                .filter(|file| file.ends_with(".pkl"))
                .collect();
            for file in files {
                match section {
                    BASE_MOTION => self.plan_base(file, &clips),
                    STYLE_TRANSFER => self.plan_styled(file, &clips),
                    _ => self.plan_adjustment(file),
                }
            }
        }
    }

    /// Remarks on listed names without a motion. Lists of pairs may hold other things than names of files.
    fn remark(&mut self) {
        let stems_in = |section: &str| -> BTreeSet<&str> {
            let prefix = format!("{}{section}/", self.root);
            let files = self.files.all().filter(|file| file.starts_with(&prefix));
            files.map(listed_name).collect()
        };
        let base: BTreeSet<String> = stems_in(BASE_MOTION).into_iter().map(motion_id).collect();
        let sections = [
            (BASE_MOTION, &self.base_lists),
            (STYLE_TRANSFER, &self.style_lists),
            (ADJUSTMENT, &self.adjustment_lists),
        ];
        let StanceRelease {
            contents,
            annotations,
            ..
        } = &mut self.release;
        if !base.is_empty() {
            let named = annotations.ids();
            let missing = named.filter(|id| !base.contains(*id)).collect();
            contents.remark_on_listed("STANCE", &format!("{}{REGEN}", self.root), missing);
        }
        // Motions wait for lists that cannot be read.
        let is_all_read = contents.unread_splits.is_empty();
        for (section, lists) in sections {
            let stems = stems_in(section);
            // A release may be incomplete: skip sections without motions.
            if stems.is_empty() {
                continue;
            }
            let missing = lists.missing(|name| match section {
                BASE_MOTION => base.contains(&motion_id(name)),
                _ => stems.contains(name) || !name.contains('_'),
            });
            let list = format!("{}{SPLIT}/{section}", self.root);
            contents.remark_on_listed("STANCE", &list, missing);
            let absent = lists.absent().filter(|_| is_all_read);
            contents.remarks.extend(absent.map(|split| {
                format!(
                    "STANCE: {list} has no list of {split}; motions that no list names were put into train, and those \
                     of {split} may be among them"
                )
            }));
        }
    }

    fn plan_base(&mut self, file: &str, clips: &Lists) {
        let id = motion_id(listed_name(file));
        let entry = Entry {
            file: file.to_owned(),
            split: clips.of_clip(&id),
            mirrored_of: original_of(&id).map(str::to_owned),
            id,
            ..Entry::default()
        };
        self.plan(entry, Role::Base, BASE_MOTION);
    }

    fn plan_styled(&mut self, file: &str, clips: &Lists) {
        let Some((base, style)) = listed_name(file).split_once('_') else {
            let reason = "the file name has no style, expected one such as 000009_proud.pkl";
            let rejected = Rejected::read("E-STANCE-NAME", reason);
            return self.release.contents.reject(file, rejected);
        };
        let source_id = self
            .origins
            .get(&format!("{BASE_MOTION}/{base}"))
            .map_or_else(|| motion_id(base), |origin| origin.id.clone());
        let entry = Entry {
            file: file.to_owned(),
            // A crop, a copy and a styled version share their clip's split.
            id: format!("{source_id}#{style}"),
            split: clips.of_clip(&source_id),
            ..Entry::default()
        };
        let role = Role::Styled {
            source_id,
            style: style.to_owned(),
        };
        self.plan(entry, role, STYLE_TRANSFER);
    }

    fn plan_adjustment(&mut self, file: &str) {
        let stem = listed_name(file);
        let split = self.adjustment_lists.of(stem);
        let id_of = |key: &str| {
            let id = format!("{ADJUSTMENT}/{stem}#{key}");
            let origin = self.origins.get(&id);
            origin.map_or(id, |origin| origin.id.clone())
        };
        let entry_of = |key: &str| Entry {
            file: file.to_owned(),
            key: key.to_owned(),
            id: id_of(key),
            split,
            ..Entry::default()
        };
        let (source, target) = (entry_of(SOURCE_KEY), entry_of(TARGET_KEY));
        let role = Role::Target {
            source_id: source.id.clone(),
        };
        let both = [
            self.plan(source, Role::Source, ADJUSTMENT),
            self.plan(target, role, ADJUSTMENT),
        ];
        if both == [false; 2] {
            let reason = "its motions are in other files of the release";
            self.release.contents.pass_over(file, reason);
        }
    }

    /// Adds a motion, by its recorded origin if it has one. Returns whether it is new: an export writes a
    /// motion again for each of its pairs.
    fn plan(&mut self, mut entry: Entry, mut role: Role, section: &str) -> bool {
        let suffix = match entry.key.as_str() {
            "" => String::new(),
            key => format!("#{key}"),
        };
        let name = format!("{section}/{}{suffix}", listed_name(&entry.file));
        let origin = self.origins.get(&name).cloned();
        if let Some(origin) = &origin {
            entry.id.clone_from(&origin.id);
            entry.split = Some(origin.split);
            entry.mirrored_of.clone_from(&origin.mirrored_of);
            if let (Role::Styled { style, .. }, Some(own)) = (&mut role, &origin.style) {
                style.clone_from(own);
            }
        }
        let place = (entry.file.clone(), entry.key.clone());
        if origin.is_some() {
            if let Some(first) = self.taken.get(&entry.id) {
                if let (Role::Target { source_id }, Some(detail)) =
                    (role, self.release.details.get_mut(first))
                {
                    detail.edited_in.push((entry.file, source_id));
                }
                return false;
            }
            self.taken.insert(entry.id.clone(), place.clone());
        }
        let detail = Detail {
            role,
            origin,
            edited_in: Vec::new(),
        };
        self.release.details.insert(place, detail);
        self.release.contents.entries.push(entry);
        true
    }
}
