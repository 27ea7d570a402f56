//! What is among the sources and what is missing, told before any work is done: names are listed
//! and first bytes read, nothing else.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::fs::{self, File};
use std::path::{Path, PathBuf};

use datasets_spec::record::HUMANML3D_WIDTH;
use datasets_spec::{Dataset, Fps};
use kinematics::motion::BODY_POSE_WIDTH;
use kinematics::skeleton::NUM_BODY_JOINTS;
use rayon::prelude::*;
use serde::Serialize;

use crate::Error;
use crate::catalogue::other_than_motions;
use crate::ingest::{list_files, read_head};
use crate::source::amass::catalogue::{Recording, Subset};
use crate::source::amass::{self, Variant};
use crate::source::humanml3d::{self, IndexRow, Layout};
use crate::source::{
    Files, Format, Recognised, humanml3d_amass, is_pointer, motionfix, recognise, stance,
};

/// AMASS files of a subset that are looked into. A subset comes from one archive, so a few tell of
/// all; they also tell how long its recordings are for their size.
const SAMPLED_FILES: usize = 3;
/// Items named as examples of what is missing.
const EXAMPLES: usize = 3;
/// Name of the variant HumanML3D was cut from.
const NEEDED_VARIANT: &str = "SMPL-H G";

/// Bytes of a stored frame: translation, root and body rotations in f32.
const FRAME_BYTES: f64 = (4 * (3 + 3 + BODY_POSE_WIDTH)) as f64;
/// Size of a shard over that of its motion columns: captured clips measure 0.81 to 1.02, the shorter
/// the more.
const PACKED_SHARE: f64 = 0.92;
/// Stored frames a core makes in a second, reading, checking and writing included: BVH, the largest
/// by volume, measures 34,000, HumanML3D vectors 16,000 and AMASS archives 57,000.
const FRAMES_PER_CORE_SECOND: f64 = 20_000.0;

/// What is among the sources.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Diagnosis {
    /// Findings by source, in the order given.
    pub sources: Vec<Findings>,
    /// What HumanML3D's crop list asks for, if one was given or found.
    pub index: Option<IndexFindings>,
    /// All sources together.
    pub estimate: Estimate,
    /// What to do before ingesting, most important first.
    pub advice: Vec<String>,
}

/// What is in one source.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Findings {
    /// The source.
    pub path: PathBuf,
    /// Files, whatever they are.
    pub files: u64,
    /// Their size in bytes.
    pub bytes: u64,
    /// Files of each motion format, and of each kind that is none.
    pub kinds: Vec<Kind>,
    /// Git LFS pointers that stand in for files.
    pub lfs_pointers: u64,
    /// HumanML3D folders.
    pub humanml3d: Vec<HumanMl3dFindings>,
    /// Subsets of AMASS.
    pub amass: Vec<SubsetFindings>,
    /// Folders of the STANCE release.
    pub stance: Vec<ReleaseFindings>,
    /// Folders of the MotionFix release.
    pub motionfix: Vec<ReleaseFindings>,
    /// What the source is, if it is a dataset of this program.
    pub dataset: Option<String>,
    /// What an ingest will come to.
    pub estimate: Estimate,
}

/// Files of one kind.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Kind {
    /// The format, or why such files are passed over.
    pub name: String,
    /// Whether they are read as motions.
    pub is_motion: bool,
    /// Their number.
    pub files: u64,
    /// Their size in bytes.
    pub bytes: u64,
}

/// What is in a HumanML3D folder.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct HumanMl3dFindings {
    /// The folder, relative to its source.
    pub root: String,
    /// Ids with joints.
    pub joints: u64,
    /// Ids with a 263-d vector.
    pub vectors: u64,
    /// Ids with captions.
    pub texts: u64,
    /// Its lists of ids.
    pub lists: Vec<ListFindings>,
    /// Ids with captions and no motion.
    pub texts_without_motion: u64,
    /// Ids with a motion and no captions.
    pub motions_without_text: u64,
    /// Ids with a motion that no split list names.
    pub motions_without_split: u64,
}

/// How much of a list is there.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ListFindings {
    /// The list, relative to the source.
    pub file: String,
    /// Ids it names.
    pub ids: u64,
    /// Of these, ids without joints and vector.
    pub without_motion: u64,
    /// Of these, ids without captions.
    pub without_text: u64,
    /// Some of the ids without a motion.
    pub examples: Vec<String>,
}

/// A subset of AMASS among the files.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct SubsetFindings {
    /// Today's name; empty for files outside any known subset.
    pub name: String,
    /// Recordings, body shapes left out.
    pub files: u64,
    /// Their size in bytes.
    pub bytes: u64,
    /// Variants of the files that were looked into.
    pub variants: Vec<String>,
    /// Some files that were looked into and are none of AMASS.
    pub unreadable: Vec<String>,
}

/// What HumanML3D's crop list asks for.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct IndexFindings {
    /// The list.
    pub path: PathBuf,
    /// Rows.
    pub rows: u64,
    /// Rows made of HumanAct12's joints, which need no AMASS.
    pub humanact12: u64,
    /// Rows whose recording is there.
    pub found: u64,
    /// Rows by subset.
    pub subsets: Vec<IndexSubset>,
}

/// What the crop list asks of a subset.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct IndexSubset {
    /// The subset's folder in the list.
    pub name: String,
    /// Rows.
    pub rows: u64,
    /// Rows whose recording is there.
    pub found: u64,
    /// Some of the recordings that are not.
    pub examples: Vec<String>,
    /// The archive to fetch, if anything is missing.
    pub archive: Option<String>,
}

/// What is there of a release made of several parts.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ReleaseFindings {
    /// The folder, relative to its source.
    pub root: String,
    /// The parts.
    pub parts: Vec<Part>,
}

/// A part of a release.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Part {
    /// Folder or file.
    pub name: String,
    /// Files of it that are there.
    pub files: u64,
    /// Files that were published.
    pub published: u64,
}

/// What an ingest will come to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Estimate {
    /// Motions.
    pub clips: u64,
    /// Frames of the dataset at 20 fps.
    pub frames: u64,
    /// Size of the dataset in bytes: 69 numbers of 4 bytes a frame, packed to 92 %.
    pub bytes: u64,
    /// Time on one core in seconds, at 20,000 frames a second.
    pub core_seconds: f64,
}

impl Estimate {
    fn of(clips: u64, frames: f64) -> Self {
        Self {
            clips,
            frames: frames.round() as u64,
            bytes: (frames * FRAME_BYTES * PACKED_SHARE).round() as u64,
            core_seconds: frames / FRAMES_PER_CORE_SECOND,
        }
    }

    fn add(&mut self, other: Self) {
        self.clips += other.clips;
        self.frames += other.frames;
        self.bytes += other.bytes;
        self.core_seconds += other.core_seconds;
    }
}

/// Seconds of motion in files of a format, judged by their size alone.
fn seconds_in(format: Format, bytes: u64) -> f64 {
    bytes as f64 / format.bytes_per_second()
}

/// A file that was listed and looked at.
struct Looked {
    relative: String,
    path: PathBuf,
    bytes: u64,
    is_pointer: bool,
    kind: Recognised,
}

/// Looks at the sources. `index` is HumanML3D's crop list; without it, one among the sources is
/// taken.
///
/// # Errors
/// A source does not exist, holds no files or cannot be listed, or the index cannot be read.
pub fn examine(sources: &[PathBuf], index: Option<&Path>) -> Result<Diagnosis, Error> {
    let mut findings = Vec::new();
    for source in sources {
        let listing = list_files(std::slice::from_ref(source))?;
        let looked = look(&listing.files);
        let files = Files::new(listing.files);
        findings.push(find(source, &files, &looked));
    }
    let files = Files::new(list_files(sources)?.files);
    let asked = index.is_some();
    let index = match index {
        Some(path) => {
            let bytes = fs::read(path).map_err(Error::io("read", path))?;
            let rows = humanml3d::parse_index(&bytes).map_err(|rejected| Error::Index {
                path: path.to_owned(),
                reason: rejected.reason,
            })?;
            Some((path.to_owned(), rows))
        }
        None => index_among(&files),
    };
    let index = index.map(|(path, rows)| ask(path, &rows, &files));
    let mut estimate = Estimate::default();
    for source in &findings {
        estimate.add(source.estimate);
    }
    let advice = advise(&findings, index.as_ref(), asked);
    Ok(Diagnosis {
        sources: findings,
        index,
        estimate,
        advice,
    })
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
                bytes: fs::metadata(path).map_or(0, |metadata| metadata.len()),
                is_pointer: is_pointer(&head),
                kind: recognise(Path::new(relative), &head),
            }
        })
        .collect()
}

fn find(source: &Path, files: &Files, looked: &[Looked]) -> Findings {
    let layouts = humanml3d::layouts(files);
    let claimed: BTreeSet<&str> = layouts.iter().flat_map(files_of).collect();
    let rest: Vec<&Looked> = looked
        .iter()
        .filter(|file| !claimed.contains(file.relative.as_str()))
        .collect();
    let stance = stance_folders(&rest);
    let motionfix = motionfix_folders(&rest);
    let (amass, amass_estimate) = amass_subsets(&rest);
    let mut estimate = amass_estimate;
    estimate.add(estimate_layouts(&layouts, looked));
    estimate.add(estimate_others(&rest));
    Findings {
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
        estimate,
    }
}

/// The files of a HumanML3D folder.
fn files_of(layout: &Layout) -> impl Iterator<Item = &str> {
    let motions = layout.joints.values().chain(layout.vectors.values());
    motions.chain(layout.texts.values()).map(String::as_str)
}

fn kinds(looked: &[Looked], claimed: &BTreeSet<&str>) -> Vec<Kind> {
    let mut kinds: BTreeMap<(bool, String), (u64, u64)> = BTreeMap::new();
    for file in looked {
        let key = if file.is_pointer {
            (false, "Git LFS pointer".to_owned())
        } else if claimed.contains(file.relative.as_str()) {
            (true, humanml3d::FORMAT.as_str().to_owned())
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

impl HumanMl3dFindings {
    fn of(layout: &Layout) -> Self {
        let count = |ids: &mut dyn Iterator<Item = &String>| ids.count() as u64;
        let in_a_split: BTreeSet<&String> = layout
            .lists
            .values()
            .filter(|(split, _)| split.is_some())
            .flat_map(|(_, ids)| ids)
            .collect();
        let lists = layout.lists.iter().map(|(file, (_, ids))| {
            let missing = || ids.iter().filter(|id| !layout.has_motion(id));
            ListFindings {
                file: file.clone(),
                ids: ids.len() as u64,
                without_motion: count(&mut missing()),
                without_text: count(&mut ids.iter().filter(|id| !layout.texts.contains_key(*id))),
                examples: missing().take(EXAMPLES).cloned().collect(),
            }
        });
        let texts = layout.texts.keys();
        Self {
            root: layout.root.clone(),
            joints: layout.joints.len() as u64,
            vectors: layout.vectors.len() as u64,
            texts: layout.texts.len() as u64,
            lists: lists.collect(),
            texts_without_motion: count(&mut texts.filter(|id| !layout.has_motion(id))),
            motions_without_text: count(
                &mut layout.ids().filter(|id| !layout.texts.contains_key(*id)),
            ),
            motions_without_split: count(&mut layout.ids().filter(|id| !in_a_split.contains(id))),
        }
    }
}

fn estimate_layouts(layouts: &[Layout], looked: &[Looked]) -> Estimate {
    let sizes: BTreeMap<&str, u64> = looked
        .iter()
        .map(|file| (file.relative.as_str(), file.bytes))
        .collect();
    let mut estimate = Estimate::default();
    for layout in layouts {
        for id in layout.ids() {
            // Joints take a fourth of what a vector takes.
            let joints_share = (3 * NUM_BODY_JOINTS) as f64 / HUMANML3D_WIDTH as f64;
            let (file, share) = match layout.vectors.get(id) {
                Some(file) => (Some(file), 1.0),
                None => (layout.joints.get(id), joints_share),
            };
            let bytes = file.and_then(|file| sizes.get(file.as_str())).copied();
            let seconds = seconds_in(humanml3d::FORMAT, bytes.unwrap_or(0)) / share;
            estimate.add(Estimate::of(1, seconds * Fps::STORE.get()));
        }
    }
    estimate
}

/// Files that stand alone, AMASS excepted, and releases kept in pickles.
fn estimate_others(rest: &[&Looked]) -> Estimate {
    let mut estimate = Estimate::default();
    for file in rest.iter().filter(|file| !file.is_pointer) {
        let format = match file.kind {
            _ if is_stance(&file.relative) => stance::FORMAT,
            _ if motionfix::is_dump(&file.relative) => motionfix::FORMAT,
            Recognised::Motion(format) if format != amass::FORMAT => format,
            _ => continue,
        };
        let frames = seconds_in(format, file.bytes) * Fps::STORE.get();
        estimate.add(Estimate::of(1, frames));
    }
    estimate
}

/// The subsets of AMASS among the files, and what they come to.
fn amass_subsets(rest: &[&Looked]) -> (Vec<SubsetFindings>, Estimate) {
    let mut by_subset: BTreeMap<&str, Vec<&Looked>> = BTreeMap::new();
    for file in rest {
        if file.kind == Recognised::Motion(amass::FORMAT) && !file.is_pointer {
            let subset = Recording::of(&file.path).map_or("", |recording| recording.subset);
            by_subset.entry(subset).or_default().push(file);
        }
    }
    let mut estimate = Estimate::default();
    let mut subsets = Vec::new();
    for (name, files) in by_subset {
        let (findings, seconds) = sample(name, &files);
        let frames = seconds * Fps::STORE.get();
        estimate.add(Estimate::of(findings.files, frames));
        subsets.push(findings);
    }
    (subsets, estimate)
}

/// Looks into a few files of a subset, and returns the seconds of motion it has by their measure.
fn sample(name: &str, files: &[&Looked]) -> (SubsetFindings, f64) {
    let bytes: u64 = files.iter().map(|file| file.bytes).sum();
    let mut findings = SubsetFindings {
        name: name.to_owned(),
        files: files.len() as u64,
        bytes,
        variants: Vec::new(),
        unreadable: Vec::new(),
    };
    let (mut sampled_bytes, mut sampled_seconds) = (0, 0.0);
    let mut variants: BTreeSet<Variant> = BTreeSet::new();
    // Evenly spread: the first few may all be of one subject.
    let step = files.len().div_ceil(SAMPLED_FILES).max(1);
    for file in files.iter().step_by(step) {
        let peeked = File::open(&file.path)
            .map_err(|error| error.to_string())
            .and_then(|open| amass::peek(open).map_err(|rejected| rejected.code.to_owned()));
        match peeked {
            Ok(Some((variant, frames, fps))) => {
                variants.insert(variant);
                sampled_bytes += file.bytes;
                sampled_seconds += frames as f64 / fps;
            }
            Ok(None) => findings
                .unreadable
                .push(format!("{}: no AMASS keys", file.relative)),
            Err(reason) => findings
                .unreadable
                .push(format!("{}: {reason}", file.relative)),
        }
    }
    findings.variants = variants.iter().map(|v| v.as_str().to_owned()).collect();
    let seconds = if sampled_bytes > 0 {
        sampled_seconds / sampled_bytes as f64 * bytes as f64
    } else if findings.unreadable.is_empty() {
        seconds_in(amass::FORMAT, bytes)
    } else {
        0.0
    };
    (findings, seconds)
}

/// Parts of the STANCE release: their names, now and in its earlier form, and the number of files
/// published.
const STANCE_PARTS: [(&str, u64); 8] = [
    ("base_motion", 24_746),
    ("style_transfer", 749),
    ("adjustment", 4_411),
    ("regen/mask_all.json", 1),
    ("regen/part_annotations.json", 1),
    ("split/base_motion", 2),
    ("split/style_transfer", 2),
    ("split/adjustment", 2),
];
/// Files of the MotionFix release.
const MOTIONFIX_PARTS: [(&str, u64); 4] = [
    ("motionfix.pth.tar", 1),
    ("motionfix_val.pth.tar", 1),
    ("motionfix_test.pth.tar", 1),
    ("splits.json", 1),
];

/// Whether a file is a motion of the STANCE release, by where it lies.
fn is_stance(relative: &str) -> bool {
    let motion_folders = &STANCE_PARTS[..3];
    relative.ends_with(".pkl")
        && motion_folders
            .iter()
            .any(|(folder, _)| root_before(relative, folder).is_some())
}

/// The path before a part, if the file is the part or lies in it.
fn root_before<'a>(relative: &'a str, part: &str) -> Option<&'a str> {
    let starts = relative.match_indices(part).map(|(at, _)| at);
    starts
        .filter(|&at| at == 0 || relative[..at].ends_with('/'))
        .find(|at| {
            let rest = &relative[at + part.len()..];
            rest.is_empty() || rest.starts_with('/')
        })
        .map(|at| &relative[..at])
}

fn stance_folders(rest: &[&Looked]) -> Vec<ReleaseFindings> {
    let mut roots: BTreeSet<&str> = BTreeSet::new();
    for file in rest {
        let is_list = file.relative.ends_with("mask_all.json");
        let (motions, lists) = (&STANCE_PARTS[..3], &STANCE_PARTS[3..4]);
        let parts = match (is_stance(&file.relative), is_list) {
            (true, _) => motions,
            (false, true) => lists,
            (false, false) => continue,
        };
        roots.extend(
            parts
                .iter()
                .filter_map(|(part, _)| root_before(&file.relative, part)),
        );
    }
    releases(&roots, rest, &STANCE_PARTS)
}

fn motionfix_folders(rest: &[&Looked]) -> Vec<ReleaseFindings> {
    let roots: BTreeSet<&str> = rest
        .iter()
        .filter(|file| motionfix::is_dump(&file.relative))
        .map(|file| {
            let slash = file.relative.rfind('/');
            &file.relative[..slash.map_or(0, |slash| slash + 1)]
        })
        .collect();
    releases(&roots, rest, &MOTIONFIX_PARTS)
}

fn releases(
    roots: &BTreeSet<&str>,
    rest: &[&Looked],
    parts: &[(&str, u64)],
) -> Vec<ReleaseFindings> {
    roots
        .iter()
        .map(|root| {
            let inside: Vec<&str> = rest
                .iter()
                .filter(|file| !file.is_pointer)
                .filter_map(|file| file.relative.strip_prefix(root))
                .collect();
            let parts = parts.iter().map(|&(name, published)| Part {
                name: name.to_owned(),
                files: inside
                    .iter()
                    .filter(|path| root_before(path, name) == Some(""))
                    .count() as u64,
                published,
            });
            ReleaseFindings {
                root: (*root).to_owned(),
                parts: parts.collect(),
            }
        })
        .collect()
}

/// The crop list among the files; the first, should there be several.
fn index_among(files: &Files) -> Option<(PathBuf, Vec<IndexRow>)> {
    files
        .all()
        .filter(|file| file.rsplit('/').next() == Some("index.csv"))
        .find_map(|file| {
            let rows = humanml3d::parse_index(&files.read(file).ok()?).ok()?;
            Some((files.path(file)?.to_owned(), rows))
        })
}

/// Which rows of the crop list the files can serve.
fn ask(path: PathBuf, rows: &[IndexRow], files: &Files) -> IndexFindings {
    let recordings = humanml3d_amass::recordings(files);
    let mut subsets: BTreeMap<String, IndexSubset> = BTreeMap::new();
    let mut humanact12 = 0;
    for row in rows {
        if humanml3d_amass::is_humanact12(row) {
            humanact12 += 1;
            continue;
        }
        let source = Path::new(&row.source_path);
        let known = crate::source::amass::catalogue::subset_of(source);
        let name = known.as_ref().map_or("unknown", |(_, name)| name);
        let subset = subsets
            .entry(name.to_owned())
            .or_insert_with(|| IndexSubset {
                name: name.to_owned(),
                rows: 0,
                found: 0,
                examples: Vec::new(),
                archive: None,
            });
        subset.rows += 1;
        let recording = Recording::of(source);
        if recording.is_some_and(|recording| recordings.contains_key(&recording)) {
            subset.found += 1;
            continue;
        }
        subset.archive = known.map(|(subset, _)| subset.archive.to_owned());
        if subset.examples.len() < EXAMPLES {
            subset.examples.push(row.source_path.clone());
        }
    }
    IndexFindings {
        path,
        rows: rows.len() as u64,
        humanact12,
        found: subsets.values().map(|subset| subset.found).sum(),
        subsets: subsets.into_values().collect(),
    }
}

/// What to do. A crop list that merely lies among the sources, with none of its recordings, is worth
/// one line; one that was asked for is gone through subset by subset.
fn advise(findings: &[Findings], index: Option<&IndexFindings>, asked: bool) -> Vec<String> {
    let mut advice = Vec::new();
    for source in findings {
        let path = source.path.display();
        if let Some(dataset) = &source.dataset {
            advice.push(format!("{path} is {dataset}"));
        }
        for release in &source.motionfix {
            let has_list = release
                .parts
                .iter()
                .any(|part| part.name == motionfix::SPLITS && part.files > 0);
            if !has_list {
                advice.push(format!(
                    "{path}/{}: the MotionFix dump comes without {}, so the name of the dump decides the \
                     splits; repackagings have put test pairs into training: fetch {} of the release and \
                     put it beside the dump",
                    release.root,
                    motionfix::SPLITS,
                    motionfix::SPLITS
                ));
            }
        }
        if source.lfs_pointers > 0 {
            advice.push(format!(
                "{} files of {path} are Git LFS pointers: run `git lfs pull` there",
                source.lfs_pointers
            ));
        }
        for folder in &source.humanml3d {
            advise_humanml3d(&path.to_string(), folder, &mut advice);
        }
        for release in source.stance.iter().chain(&source.motionfix) {
            let missing: Vec<&str> = release
                .parts
                .iter()
                .filter(|part| part.files == 0 && part.name != motionfix::SPLITS)
                .map(|part| part.name.as_str())
                .collect();
            if !missing.is_empty() {
                advice.push(format!(
                    "{path}/{} lacks {} of its release",
                    release.root,
                    missing.join(", ")
                ));
            }
        }
    }
    match index {
        Some(index) if asked || index.found > 0 => advise_index(findings, index, &mut advice),
        Some(index) => {
            let archives: Vec<&str> = index
                .subsets
                .iter()
                .filter_map(|subset| subset.archive.as_deref())
                .collect();
            advice.push(format!(
                "to cut the clips of {} from AMASS, fetch its {NEEDED_VARIANT} archives: {}",
                index.path.display(),
                archives.join(", ")
            ));
        }
        None => {}
    }
    advice
}

fn advise_humanml3d(path: &str, folder: &HumanMl3dFindings, advice: &mut Vec<String>) {
    let at = format!("{path}/{}", folder.root);
    if folder.joints + folder.vectors == 0 {
        advice.push(format!(
            "{at} has captions and no motions: the motions are not published; make them from AMASS \
             with `stance ingest --humanml3d-index index.csv`"
        ));
    }
    if folder.texts == 0 {
        advice.push(format!(
            "{at} has no captions: unpack texts.zip of the HumanML3D repository beside new_joints"
        ));
    }
    let incomplete = folder.lists.iter().max_by_key(|list| list.without_motion);
    if let Some(list) = incomplete.filter(|list| list.without_motion > 0) {
        advice.push(format!(
            "{} of {} ids of {} have no motion (such as {})",
            list.without_motion,
            list.ids,
            list.file,
            list.examples.join(", ")
        ));
    }
}

fn advise_index(findings: &[Findings], index: &IndexFindings, advice: &mut Vec<String>) {
    for subset in &index.subsets {
        let missing = subset.rows - subset.found;
        let Some(archive) = subset.archive.as_ref().filter(|_| missing > 0) else {
            continue;
        };
        advice.push(format!(
            "{missing} of {} clips of {} are missing: fetch {archive} ({NEEDED_VARIANT}) from \
             amass.is.tue.mpg.de",
            subset.rows, subset.name
        ));
    }
    for subset in findings.iter().flat_map(|source| &source.amass) {
        let needed = Subset::named(&subset.name).is_some_and(Subset::is_in_humanml3d);
        let other = subset
            .variants
            .iter()
            .any(|variant| variant != NEEDED_VARIANT);
        if needed && other {
            advice.push(format!(
                "{} is {}; HumanML3D was cut from {NEEDED_VARIANT}, whose frame numbers may differ",
                subset.name,
                subset.variants.join(" and ")
            ));
        }
    }
}

const KB: f64 = 1e3;

/// A size with three digits.
fn size(bytes: u64) -> String {
    let mut value = bytes as f64;
    for unit in ["B", "kB", "MB", "GB"] {
        if value < KB {
            return match unit {
                "B" => format!("{bytes} B"),
                _ => format!("{value:.1} {unit}"),
            };
        }
        value /= KB;
    }
    format!("{value:.1} TB")
}

fn duration(seconds: f64) -> String {
    const MINUTE: f64 = 60.0;
    const HOUR: f64 = 3600.0;
    if seconds < MINUTE {
        format!("{:.0} s", seconds.ceil())
    } else if seconds < HOUR {
        format!("{:.0} min", (seconds / MINUTE).ceil())
    } else {
        format!("{:.1} h", seconds / HOUR)
    }
}

/// Writes rows of text as columns, the first to the left and the others to the right.
fn columns(f: &mut fmt::Formatter<'_>, rows: &[Vec<String>]) -> fmt::Result {
    let num_columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let widths: Vec<usize> = (0..num_columns)
        .map(|column| {
            let cells = rows.iter().filter_map(|row| row.get(column));
            cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
        })
        .collect();
    for row in rows {
        let mut line = String::from("  ");
        for (column, (cell, width)) in row.iter().zip(&widths).enumerate() {
            line += &match column {
                0 => format!("{cell:<width$}"),
                _ => format!("  {cell:>width$}"),
            };
        }
        writeln!(f, "{}", line.trim_end())?;
    }
    Ok(())
}

impl fmt::Display for Diagnosis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for source in &self.sources {
            write!(f, "{source}")?;
        }
        if let Some(index) = &self.index {
            write!(f, "{index}")?;
        }
        writeln!(f, "estimate")?;
        columns(
            f,
            &[
                vec!["clips".to_owned(), self.estimate.clips.to_string()],
                vec!["dataset".to_owned(), size(self.estimate.bytes)],
                vec![
                    "time on one core".to_owned(),
                    duration(self.estimate.core_seconds),
                ],
            ],
        )?;
        if self.advice.is_empty() {
            return writeln!(f, "nothing is missing");
        }
        writeln!(f, "to do")?;
        for advice in &self.advice {
            writeln!(f, "  - {advice}")?;
        }
        Ok(())
    }
}

impl fmt::Display for Findings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{}: {} files, {}",
            self.path.display(),
            self.files,
            size(self.bytes)
        )?;
        let kinds: Vec<Vec<String>> = self
            .kinds
            .iter()
            .map(|kind| {
                let name = match kind.is_motion {
                    true => kind.name.clone(),
                    false => format!("not read: {}", kind.name),
                };
                vec![name, kind.files.to_string(), size(kind.bytes)]
            })
            .collect();
        columns(f, &kinds)?;
        for folder in &self.humanml3d {
            write!(f, "{folder}")?;
        }
        if !self.amass.is_empty() {
            writeln!(f, " AMASS")?;
            let rows: Vec<Vec<String>> = self.amass.iter().map(SubsetFindings::cells).collect();
            columns(f, &rows)?;
        }
        for (name, releases) in [("STANCE", &self.stance), ("MotionFix", &self.motionfix)] {
            for release in releases {
                writeln!(f, " {name} release at {}", place(&release.root))?;
                let rows: Vec<Vec<String>> = release.parts.iter().map(Part::cells).collect();
                columns(f, &rows)?;
            }
        }
        Ok(())
    }
}

fn place(root: &str) -> &str {
    match root {
        "" => "the top",
        root => root,
    }
}

impl SubsetFindings {
    fn cells(&self) -> Vec<String> {
        let name = match self.name.as_str() {
            "" => "outside known subsets",
            name => name,
        };
        let variants = match self.variants.as_slice() {
            [] => "not AMASS".to_owned(),
            variants => variants.join(", "),
        };
        vec![
            name.to_owned(),
            self.files.to_string(),
            size(self.bytes),
            variants,
        ]
    }
}

impl Part {
    fn cells(&self) -> Vec<String> {
        vec![
            self.name.clone(),
            self.files.to_string(),
            format!("of {}", self.published),
        ]
    }
}

impl fmt::Display for HumanMl3dFindings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, " HumanML3D at {}", place(&self.root))?;
        let mut rows: Vec<Vec<String>> = [
            ("joints", self.joints),
            ("vectors", self.vectors),
            ("captions", self.texts),
            ("captions without motion", self.texts_without_motion),
            ("motions without captions", self.motions_without_text),
            ("motions in no split", self.motions_without_split),
        ]
        .into_iter()
        .map(|(name, count)| vec![name.to_owned(), count.to_string()])
        .collect();
        for list in &self.lists {
            rows.push(vec![
                list.file.clone(),
                format!("{} ids", list.ids),
                format!("{} without motion", list.without_motion),
                format!("{} without captions", list.without_text),
            ]);
        }
        columns(f, &rows)
    }
}

impl fmt::Display for IndexFindings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{}: {} clips, {} of them from HumanAct12; {} can be cut",
            self.path.display(),
            self.rows,
            self.humanact12,
            self.found
        )?;
        let rows: Vec<Vec<String>> = self
            .subsets
            .iter()
            .map(|subset| {
                let fetch = subset.archive.as_ref();
                vec![
                    subset.name.clone(),
                    format!("{} of {}", subset.found, subset.rows),
                    fetch.map_or("complete".to_owned(), |archive| format!("fetch {archive}")),
                ]
            })
            .collect();
        columns(f, &rows)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::npy_f8;
    use crate::fixture::npz;
    use crate::source::amass::tests::clip_members;

    fn write(folder: &Path, name: &str, bytes: &[u8]) {
        let path = folder.join(name);
        fs::create_dir_all(path.parent().expect("a folder")).expect("made");
        fs::write(path, bytes).expect("written");
    }

    #[test]
    fn a_humanml3d_folder_tells_what_it_lacks_both_ways() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let root = folder.path();
        let vector = npy_f8(&[3, 263], &[0.0; 3 * 263]);
        write(root, "h/new_joint_vecs/000001.npy", &vector);
        write(root, "h/texts/000001.txt", b"a man walks#a/DET#0.0#0.0\n");
        write(root, "h/texts/000002.txt", b"a man runs#a/DET#0.0#0.0\n");
        write(root, "h/train.txt", b"000001\n000002\n000003\n");
        write(
            root,
            "h/new_joints/000004.npy",
            &npy_f8(&[3, 22, 3], &[0.0; 198]),
        );
        let diagnosis = examine(&[root.to_owned()], None).expect("listed");
        let found = &diagnosis.sources[0].humanml3d[0];
        assert_eq!((found.vectors, found.joints, found.texts), (1, 1, 2));
        assert_eq!(found.texts_without_motion, 1, "000002");
        assert_eq!(found.motions_without_text, 1, "000004");
        assert_eq!(found.motions_without_split, 1, "000004");
        let list = &found.lists[0];
        assert_eq!(
            (list.ids, list.without_motion, list.without_text),
            (3, 2, 1)
        );
        assert_eq!(list.examples, ["000002", "000003"]);
        assert_eq!(diagnosis.estimate.clips, 2);
        assert!(diagnosis.to_string().contains("2 of 3 ids of h/train.txt"));
    }

    #[test]
    fn the_index_names_the_archive_of_every_missing_subset() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let root = folder.path();
        write(
            root,
            "amass/KIT/3/kick_stageii.npz",
            &npz(&clip_members(40, 165)),
        );
        let index = root.join("list.csv");
        write(
            root,
            "list.csv",
            b"source_path,start_frame,end_frame,new_name\n\
              ./pose_data/KIT/3/kick_poses.npy,0,5,000000.npy\n\
              ./pose_data/MPI_Limits/1/a_poses.npy,0,5,000001.npy\n\
              ./pose_data/humanact12/humanact12/P1.npy,0,-1,000002.npy\n",
        );
        let diagnosis = examine(&[root.to_owned()], Some(&index)).expect("listed");
        let found = diagnosis.index.as_ref().expect("given");
        assert_eq!((found.rows, found.humanact12, found.found), (3, 1, 1));
        let text = diagnosis.to_string();
        assert!(
            text.contains("fetch PosePrior.tar.bz2 (SMPL-H G)"),
            "{text}"
        );
        assert!(text.contains("KIT is SMPL-X G"), "{text}");
        // 40 frames at 120 fps are 6.67 at 20 fps.
        assert_eq!(diagnosis.estimate.frames, 7);
    }

    #[test]
    fn releases_tell_which_parts_are_there_and_pointers_are_counted() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let root = folder.path();
        write(root, "dataset/base_motion/000000.pkl", &[0; 276]);
        write(root, "dataset/regen/mask_all.json", b"{}");
        write(root, "mf/motionfix_val.pth.tar", b"\x80\x03");
        write(
            root,
            "dataset/style_transfer/000009_proud.pkl",
            b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n",
        );
        let diagnosis = examine(&[root.to_owned()], None).expect("listed");
        let source = &diagnosis.sources[0];
        assert_eq!(source.lfs_pointers, 1);
        let counts = |release: &ReleaseFindings| -> Vec<u64> {
            release.parts.iter().map(|part| part.files).collect()
        };
        assert_eq!(source.stance.len(), 1);
        assert_eq!(source.stance[0].root, "dataset/");
        assert_eq!(counts(&source.stance[0]), [1, 0, 0, 1, 0, 0, 0, 0]);
        assert_eq!(counts(&source.motionfix[0]), [0, 1, 0, 0]);
        let text = diagnosis.to_string();
        assert!(text.contains("git lfs pull"), "{text}");
        let json = serde_json::to_value(&diagnosis).expect("plain data");
        assert_eq!(json["sources"][0]["lfs_pointers"], 1);
    }

    #[test]
    fn the_real_files_are_all_counted_once() {
        let Some(root) = std::env::var_os("STANCE_TEST_DATA").map(PathBuf::from) else {
            skipped();
            return;
        };
        let diagnosis = examine(&[root], None).expect("listed");
        let source = &diagnosis.sources[0];
        let files: u64 = source.kinds.iter().map(|kind| kind.files).sum();
        assert_eq!(files, source.files);
        let lists: BTreeMap<&str, u64> = source.humanml3d[0]
            .lists
            .iter()
            .map(|list| (list.file.as_str(), list.without_motion))
            .collect();
        assert_eq!(
            lists["humanml3d/all.txt"], 29_227,
            "one clip of all is there"
        );
        let index = diagnosis.index.as_ref().expect("found");
        assert_eq!(
            (index.rows, index.humanact12, index.found),
            (14_616, 1_191, 0)
        );
        assert_eq!(index.subsets.len(), 17, "subsets with clips");
        assert!(index.subsets.iter().all(|subset| subset.archive.is_some()));
    }

    #[expect(
        clippy::print_stderr,
        reason = "a test that checks nothing must say so"
    )]
    fn skipped() {
        eprintln!("SKIPPED: STANCE_TEST_DATA names no folder");
    }
}
