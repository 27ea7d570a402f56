//! The built-in corpus: procedural motions, written in source formats and ingested like any capture.
//!
//! A clip is an action in a style. The action plans the path of the body and the footsteps; the style modifies
//! posture, tempo and size; the solver makes pelvis, trunk and arms follow the planted legs. All draws
//! derive from the seed and the clip's index, so a clip does not depend on other clips or on the number of
//! threads.
//!
//! On demand, neutral clips are performed again with a small change, such as "Lean forward more."; a list of pairs
//! beside the clips names the neutral clip of each. Other pairs test known weaknesses of editors ([`Limit`]).
//!
//! Read [`CorpusOptions`] and [`clip`] first.
//!
//! ```
//! use corpus::{CorpusOptions, clip};
//!
//! let options = CorpusOptions { clips: 3, ..CorpusOptions::default() };
//! let third = clip(2, &options);
//! assert_eq!(third.motion.fps().get(), corpus::CORPUS_FPS);
//! assert!(!third.sidecar.captions.is_empty());
//! ```

mod action;
mod adjust;
mod body;
mod curve;
mod gait;
mod gesture;
mod held_out;
mod limb;
mod limits;
mod performer;
mod play;
mod standing;
mod style;
mod text;
mod travel;

use std::collections::BTreeSet;
use std::io;
use std::path::{Path, PathBuf};

use compose::EditKind;
use datasets_spec::store::replace_file;
use datasets_spec::{BodyPart, Fps, Motion, Progress, Seed, Skeleton, Split};
use formats::sidecar::Sidecar;
use formats::write;
use rayon::prelude::*;

use action::{Action, Asked, Facts};
use adjust::Adjustment;
use performer::Performer;

pub use limits::{Limit, SEEN_PAIR_LIST, write_limits};

/// Frame rate of the clips in frames per second: a common rate of captures, and a multiple of the store's 20 and the
/// model's 10.
pub const CORPUS_FPS: f64 = 60.0;
/// Number of clips of one take: every action in every style.
pub const CLIPS_PER_TAKE: usize = Action::ALL.len() * style::ALL.len();
/// Number of clips that [`write_held_out_corpus`] is meant for.
pub const HELD_OUT_CLIPS: usize = held_out::TAKES * CLIPS_PER_TAKE;
const DEFAULT_TAKES: usize = 2;
/// The licence of the clips, which are generated.
const LICENSE: &str = "CC0-1.0";
/// Name of the list of pairs of neutral and adjusted clips, in the folder of the corpus. `stance ingest --pairs` reads
/// it.
pub const PAIR_LIST: &str = "pairs.csv";
/// Folder of the AMASS archives, where a release has the name of a subset.
const AMASS_SUBSET: &str = "Stance";
const AMASS_FOLDER: &str = "amass";
const BVH_FOLDER: &str = "bvh";

/// A corpus that could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file or folder could not be written.
    #[error("cannot write the corpus file {path}; check that the folder is writable and has space")]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// The folder holds a motion or a list of another corpus, which would be ingested with this one.
    #[error("{} is no file of this corpus and would be ingested with it; name a new folder", .0.display())]
    Foreign(PathBuf),
}

/// Size and seed of a corpus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CorpusOptions {
    /// Number of clips without the adjusted ones. [`CLIPS_PER_TAKE`] clips contain every action in every style once.
    pub clips: usize,
    /// Adjusted clips of each neutral one; fewer if fewer adjustments suit its action. At least four suit every action.
    pub adjusted: usize,
    /// Seed of all clips.
    pub seed: Seed,
}

impl Default for CorpusOptions {
    fn default() -> Self {
        Self {
            clips: DEFAULT_TAKES * CLIPS_PER_TAKE,
            adjusted: 0,
            seed: Seed(0),
        }
    }
}

/// A generated motion and its metadata.
#[derive(Clone, Debug, PartialEq)]
pub struct CorpusClip {
    /// Name of the clip: action, style and take, such as `walk_proud_001`. Clips of the same action
    /// and take in different styles are a style pair.
    pub name: String,
    /// The motion on the neutral SMPL-X skeleton, y up, at [`CORPUS_FPS`]; the toe joints of a
    /// standing body are on the floor at y = 0.
    pub motion: Motion,
    /// Captions, part descriptions and labels.
    pub sidecar: Sidecar,
}

/// A neutral clip performed again with a small change: the same take with the same draws, and as many frames.
#[derive(Clone, Debug, PartialEq)]
pub struct AdjustedClip {
    /// The adjusted clip. Its name is that of the neutral clip with `_adjusted-` and the adjustment, such as
    /// `walk_neutral_001_adjusted-lean`. Its sidecar states no style.
    pub clip: CorpusClip,
    /// The instruction that leads from the neutral clip to this one.
    pub instruction: &'static str,
    /// The part of the body that moves differently.
    pub part: BodyPart,
}

/// Counts of the written corpus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct CorpusSummary {
    /// Clips without the adjusted ones.
    pub clips: usize,
    /// Adjusted clips, each of which is in a pair with a neutral one.
    pub adjusted: usize,
    /// Clips that are written as AMASS archives, adjusted ones included.
    pub amass: usize,
    /// Clips that are written as BVH, adjusted ones included.
    pub bvh: usize,
    /// Frames of all clips.
    pub frames: usize,
    /// Bytes of all files.
    pub bytes: u64,
}

impl std::ops::Add for CorpusSummary {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            clips: self.clips + other.clips,
            adjusted: self.adjusted + other.adjusted,
            amass: self.amass + other.amass,
            bvh: self.bvh + other.bvh,
            frames: self.frames + other.frames,
            bytes: self.bytes + other.bytes,
        }
    }
}

/// Generates a clip. It depends on the seed and its index alone, not on the number of clips.
pub fn clip(index: usize, options: &CorpusOptions) -> CorpusClip {
    let (action, style, take) = cast(index);
    let (motion, facts) = perform_take(action, style, take, options.seed);
    let take_name = take.to_string();
    let of_text = ["corpus", "text", action.name(), style.name, &take_name];
    let mut words = options.seed.rng(&of_text);
    let (captions, parts) = text::describe(action, style.name, facts, &mut words);
    CorpusClip {
        name: clip_name(action, style, take),
        motion,
        sidecar: Sidecar {
            captions: captions.into_iter().map(Into::into).collect(),
            parts,
            style: Some(style.name.to_owned()),
            ..stated(action, take)
        },
    }
}

/// Generates the adjusted performances of the clip of an index; empty if the clip is not neutral. They depend on the
/// seed and the index alone; a smaller [`CorpusOptions::adjusted`] gives the first of those of a larger one.
pub fn adjusted_clips(index: usize, options: &CorpusOptions) -> Vec<AdjustedClip> {
    let (action, style, take) = cast(index);
    let take_name = take.to_string();
    adjustments(index, options)
        .into_iter()
        .map(|adjustment| {
            // The style's name, and therefore every random draw, equals that of the neutral performance.
            let (motion, facts) = perform_take(action, &adjustment.of(style), take, options.seed);
            let mut words = options.seed.rng(&[
                "corpus",
                "adjusted text",
                action.name(),
                adjustment.name,
                &take_name,
            ]);
            let captions = text::captions(action, &[adjustment.manner], facts, &mut words);
            AdjustedClip {
                clip: CorpusClip {
                    name: adjusted_name(index, &adjustment),
                    motion,
                    sidecar: Sidecar {
                        captions: captions.into_iter().map(Into::into).collect(),
                        ..stated(action, take)
                    },
                },
                instruction: adjustment.instruction,
                part: adjustment.part,
            }
        })
        .collect()
}

/// The adjustments of the clip of an index; none if it is not neutral.
fn adjustments(index: usize, options: &CorpusOptions) -> Vec<Adjustment> {
    let (action, style, take) = cast(index);
    if style.name != style::NEUTRAL.name {
        return Vec::new();
    }
    let take = take.to_string();
    let of_take = ["corpus", "adjustment", action.name(), &take];
    Adjustment::draw(action, options.adjusted, &mut options.seed.rng(&of_take))
}

/// Labels that the sidecars of all performances of a take share.
fn stated(action: Action, take: usize) -> Sidecar {
    Sidecar {
        subject: Some(Performer::of_take(take).name()),
        action: Some(action.name().to_owned()),
        license: Some(LICENSE.to_owned()),
        ..Sidecar::default()
    }
}

fn perform_take(action: Action, style: &style::Style, take: usize, seed: Seed) -> (Motion, Facts) {
    let style = &Performer::of_take(take).plays(style, seed);
    perform(action, style, Asked::default(), &take.to_string(), seed)
}

fn perform(
    action: Action,
    style: &style::Style,
    asked: Asked,
    take: &str,
    seed: Seed,
) -> (Motion, Facts) {
    let skeleton = Skeleton::smplx_neutral();
    // The draws of a take must not depend on the style: style pairs differ in style alone.
    let mut take_rng = seed.rng(&["corpus", "take", action.name(), take]);
    let mut scatter = seed.rng(&["corpus", "scatter", action.name(), style.name, take]);
    let (script, facts) = play::script(action, style, asked, &mut take_rng, &mut scatter);
    let fps = Fps::new(CORPUS_FPS).expect("the corpus rate is positive");
    let poses = body::perform(&script, style, &skeleton, fps, &mut scatter);
    let motion = Motion::from_poses(fps, &poses).expect("every pose of a performance is finite");
    (motion, facts)
}

fn clip_name(action: Action, style: &style::Style, take: usize) -> String {
    format!("{}_{}_{:03}", action.name(), style.name, take + 1)
}

/// Name of an adjusted performance of the clip of an index.
fn adjusted_name(index: usize, adjustment: &Adjustment) -> String {
    let (action, style, take) = cast(index);
    let neutral = clip_name(action, style, take);
    format!("{neutral}_adjusted-{}", adjustment.name)
}

/// Action, style and take of an index: all styles of an action follow one another, so that even a
/// small corpus has style pairs.
fn cast(index: usize) -> (Action, &'static style::Style, usize) {
    let styles = style::ALL.len();
    let action = Action::ALL[(index / styles) % Action::ALL.len()];
    (action, &style::ALL[index % styles], index / CLIPS_PER_TAKE)
}

/// Whether the clip of an index is an AMASS archive, and not BVH. All styles of an action and take have one format, so
/// that style pairs differ only in style. Half of the actions of a take have each format, and the next take swaps them.
fn is_amass(index: usize) -> bool {
    let (action, take) = (index / style::ALL.len(), index / CLIPS_PER_TAKE);
    (action + take).is_multiple_of(2)
}

/// Path of a clip of this name relative to the folder of the corpus.
fn clip_path(index: usize, name: &str) -> PathBuf {
    let (_, style, _) = cast(index);
    match is_amass(index) {
        true => Path::new(AMASS_FOLDER)
            .join(AMASS_SUBSET)
            .join(style.name)
            .join(format!("{name}_poses.npz")),
        false => Path::new(BVH_FOLDER).join(format!("{name}.bvh")),
    }
}

/// Paths of the motions of a corpus and of their list, relative to its folder.
fn own_paths(options: &CorpusOptions) -> BTreeSet<PathBuf> {
    let mut paths = BTreeSet::new();
    for index in 0..options.clips {
        let (action, style, take) = cast(index);
        paths.insert(clip_path(index, &clip_name(action, style, take)));
        for adjustment in adjustments(index, options) {
            paths.insert(clip_path(index, &adjusted_name(index, &adjustment)));
            paths.insert(PathBuf::from(PAIR_LIST));
        }
    }
    paths
}

/// Refuses a folder with motions or a list that are not of this corpus, and would mix with it.
fn check_folder(out: &Path, options: &CorpusOptions) -> Result<(), Error> {
    let mut found = Vec::new();
    for name in [AMASS_FOLDER, BVH_FOLDER, PAIR_LIST] {
        files_below(&out.join(name), &mut found).map_err(|source| Error::Write {
            path: out.to_owned(),
            source,
        })?;
    }
    found.sort_unstable();
    let own = own_paths(options);
    let is_foreign = |path: &PathBuf| {
        let is_read = [".npz", ".bvh", PAIR_LIST];
        let is_read = is_read.map(|end| path.to_string_lossy().ends_with(end));
        let is_own = path.strip_prefix(out).is_ok_and(|path| own.contains(path));
        is_read.contains(&true) && !is_own
    };
    match found.into_iter().find(is_foreign) {
        Some(path) => Err(Error::Foreign(path)),
        None => Ok(()),
    }
}

/// Adds a file, or the files of a folder and of the folders in it; nothing if there is none.
fn files_below(path: &Path, found: &mut Vec<PathBuf>) -> io::Result<()> {
    if path.is_file() {
        found.push(path.to_owned());
        return Ok(());
    }
    let entries = match std::fs::read_dir(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        entries => entries?,
    };
    for entry in entries {
        files_below(&entry?.path(), found)?;
    }
    Ok(())
}

/// The id that ingestion gives a clip: its path without extension, with `/` between folders.
fn clip_id(path: &Path) -> String {
    let path = path.with_extension("");
    let names: Vec<_> = path.iter().map(|name| name.to_string_lossy()).collect();
    names.join("/")
}

/// Writes a corpus below `out`: half of the actions of a take as AMASS archives under `amass/`, half as BVH under
/// `bvh/`, and beside each motion its sidecar `<stem>.stance.json`. Adjusted clips lie beside the neutral ones, and
/// [`PAIR_LIST`] pairs them. Files of the same names are replaced, each atomically. The bytes depend on the options
/// alone.
///
/// # Errors
/// A folder or file cannot be written, or the folder holds motions or a list of another corpus.
pub fn write_corpus(
    out: &Path,
    options: &CorpusOptions,
    progress: &dyn Progress,
) -> Result<CorpusSummary, Error> {
    write_with(out, options, |_| None, progress)
}

/// Like [`write_corpus`], with sidecars that state splits: some actions, one performer, one style of every action and
/// one take of every action are held out of training.
///
/// # Errors
/// As [`write_corpus`].
pub fn write_held_out_corpus(
    out: &Path,
    options: &CorpusOptions,
    progress: &dyn Progress,
) -> Result<CorpusSummary, Error> {
    let split = |index| Some(held_out_split(index));
    write_with(out, options, split, progress)
}

fn held_out_split(index: usize) -> Split {
    let (action, style, take) = cast(index);
    held_out::split(action, style, take)
}

fn write_with(
    out: &Path,
    options: &CorpusOptions,
    split: impl Fn(usize) -> Option<Split> + Sync,
    progress: &dyn Progress,
) -> Result<CorpusSummary, Error> {
    check_folder(out, options)?;
    progress.begin("corpus", Some(options.clips as u64));
    let written: Vec<(CorpusSummary, String)> = (0..options.clips)
        .into_par_iter()
        .map(|index| {
            let written = write_clips(out, index, options, split(index));
            progress.advance(1);
            written
        })
        .collect::<Result<_, _>>()?;
    let mut summary = CorpusSummary::default();
    let mut lines = String::new();
    for (clips, pairs) in written {
        summary = summary + clips;
        lines += &pairs;
    }
    if summary.adjusted > 0 {
        summary.bytes += write_list(out.join(PAIR_LIST), &lines)?;
    }
    progress.finish(&format!(
        "{} clips, {} adjusted, {} frames",
        summary.clips, summary.adjusted, summary.frames
    ));
    Ok(summary)
}

fn write_list(path: PathBuf, lines: &str) -> Result<u64, Error> {
    let list = format!("styled,original,style,text,kind,parts\n{lines}");
    replace_file(&path, list.as_bytes()).map_err(|source| Error::Write { path, source })?;
    Ok(list.len() as u64)
}

/// Writes the clip of an index and its adjusted performances. Also returns their lines of the list of pairs.
fn write_clips(
    out: &Path,
    index: usize,
    options: &CorpusOptions,
    split: Option<Split>,
) -> Result<(CorpusSummary, String), Error> {
    let mut neutral = clip(index, options);
    neutral.sidecar.split = split;
    let write = |clip: &CorpusClip| write_clip(out, &clip_path(index, &clip.name), clip);
    let mut summary = CorpusSummary {
        clips: 1,
        ..write(&neutral)?
    };
    let mut lines = String::new();
    for mut adjusted in adjusted_clips(index, options) {
        adjusted.clip.sidecar.split = split;
        let one = CorpusSummary {
            adjusted: 1,
            ..write(&adjusted.clip)?
        };
        summary = summary + one;
        // No field has a comma or a quotation mark.
        lines += &format!(
            "{},{},,{},{},{}\n",
            clip_id(&clip_path(index, &adjusted.clip.name)),
            clip_id(&clip_path(index, &neutral.name)),
            adjusted.instruction,
            EditKind::FineGrained.as_str(),
            adjusted.part.name(),
        );
    }
    Ok((summary, lines))
}

/// Writes a clip to a path below `out`, in the format of its extension.
fn write_clip(out: &Path, path: &Path, clip: &CorpusClip) -> Result<CorpusSummary, Error> {
    let is_amass = path.extension().is_some_and(|name| name == "npz");
    let path = out.join(path);
    let failed = |source| Error::Write {
        path: path.clone(),
        source,
    };
    let skeleton = Skeleton::smplx_neutral();
    let motion = match is_amass {
        true => write::amass::encode(&clip.motion, &skeleton).map_err(failed)?,
        false => write::bvh::encode(&clip.motion, &skeleton).into_bytes(),
    };
    let mut sidecar = serde_json::to_vec_pretty(&clip.sidecar)
        .map_err(|source| failed(io::Error::from(source)))?;
    sidecar.push(b'\n');
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let sidecar_path = path.with_file_name(format!("{stem}{}", Sidecar::SUFFIX));
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(failed)?;
    }
    // The sidecar is written first, so that every motion has its description.
    replace_file(&sidecar_path, &sidecar).map_err(failed)?;
    replace_file(&path, &motion).map_err(failed)?;
    Ok(CorpusSummary {
        amass: usize::from(is_amass),
        bvh: usize::from(!is_amass),
        frames: clip.motion.len(),
        bytes: (motion.len() + sidecar.len()) as u64,
        ..CorpusSummary::default()
    })
}

#[cfg(test)]
mod tests;
