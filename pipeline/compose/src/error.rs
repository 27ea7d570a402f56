//! Errors of composing edits and deriving masks.

use std::path::PathBuf;

use datasets_spec::{Code, MotionId, Split};
use work::Failed;

/// An error that names the row, motion or setting it happened to.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A dataset holds no recorded windows of a split.
    #[error(
        "{} holds no recorded windows of split {split}; run: stance triplets DATASET --windows N --out {}",
        path.display(),
        path.display()
    )]
    NoWindows {
        /// The dataset.
        path: PathBuf,
        /// The requested split.
        split: Split,
    },
    /// The windows recorded in this dataset are of several lengths.
    #[error(
        "the windows recorded in {} are of several lengths; record them again: stance triplets DATASET --windows N --out FOLDER",
        .0.display()
    )]
    UnequalWindows(PathBuf),
    /// No clip is in a split.
    #[error(
        "no clip of {} is in split {split}; choose another split, or name clips of it with `stance ingest --splits FILE` into a \
         new folder",
        path.display()
    )]
    NoClips {
        /// The dataset.
        path: PathBuf,
        /// The split.
        split: Split,
    },
    /// Edits cannot be composed without masks or pairs.
    #[error(
        "{} has neither masks nor pairs in split {split}; run `stance masks {}` for semantic edits, \
         `stance pairs {}` for styles",
        path.display(),
        path.display(),
        path.display()
    )]
    NoAnnotations {
        /// The dataset.
        path: PathBuf,
        /// The split.
        split: Split,
    },
    /// A setting for windows is used with whole clips.
    #[error(
        "mirrored_ratio mirrors training windows, not whole clips (recorded triplets, items, TMED); leave it out of their settings"
    )]
    MirroredClip,
    /// A row belongs to another split than the library.
    #[error(
        "{table} row {id:?} is of split {found}, the library of split {expected}; pass the rows of one split only"
    )]
    OtherSplit {
        /// Table of the row.
        table: &'static str,
        /// Id of the row.
        id: String,
        /// Split of the row.
        found: Split,
        /// Split of the library.
        expected: Split,
    },
    /// A motion drives another skeleton than the library's.
    #[error(
        "motion {motion} drives skeleton {found:?}, the library {expected:?}; ingest all motions with one body model"
    )]
    OtherSkeleton {
        /// The motion.
        motion: MotionId,
        /// Skeleton of the motion.
        found: String,
        /// The library's skeleton.
        expected: String,
    },
    /// A motion and the first motion differ in frame rate.
    #[error(
        "motion {motion} is stored at {found} fps, others at {expected} fps; ingest all motions at one rate"
    )]
    OtherRate {
        /// The motion.
        motion: MotionId,
        /// Rate of the motion in frames per second.
        found: f64,
        /// The rate of the first motion.
        expected: f64,
    },
    /// Two rows have the same id.
    #[error("{table} row {id:?} appears twice; remove one")]
    Duplicate {
        /// Table of the rows.
        table: &'static str,
        /// Id of the rows.
        id: String,
    },
    /// A mask or pair belongs to a motion that is not in the library.
    #[error(
        "{table} {row:?} belongs to motion {motion}, which is not in the library; pass all motions of its split"
    )]
    UnknownMotion {
        /// Table of the row.
        table: &'static str,
        /// Id of the row.
        row: String,
        /// The motion of the row.
        motion: MotionId,
    },
    /// The mask of this id has no joint.
    #[error("mask {0:?} names no joint; annotate it again")]
    EmptyMask(String),
    /// A mask or pair has no instruction.
    #[error("{table} {row:?} has no text; annotate it again")]
    EmptyText {
        /// Table of the row.
        table: &'static str,
        /// Id of the row.
        row: String,
    },
    /// A pair has an unknown kind.
    #[error("pair {pair:?} is of kind {found:?}; known are semantic, style and fine-grained")]
    PairKind {
        /// Id of the pair.
        pair: String,
        /// The kind found.
        found: String,
    },
    /// A row is no valid mask or pair, or names something that does not exist.
    #[error("{table} {row:?} is not usable")]
    Row {
        /// What the row is: `mask` or `pair`.
        table: &'static str,
        /// Id of the row.
        row: String,
        /// What is wrong with it.
        source: Box<datasets_spec::Error>,
    },
    /// A template cannot be filled in.
    #[error(
        "phrases.of_parts must hold templates with {{instruction}} and {{part}} in each; correct the phrases"
    )]
    Template,
    /// A motion row does not hold a motion.
    #[error("motion {motion} is not usable")]
    Motion {
        /// The motion.
        motion: MotionId,
        /// What is wrong with it.
        source: datasets_spec::Error,
    },
    /// A motion has another length than its row states.
    #[error("motion {motion} has {found} frames, and its row states {stated}; ingest it again")]
    Length {
        /// The motion.
        motion: MotionId,
        /// Number of frames of the motion.
        found: usize,
        /// The frames that `n_frames` states.
        stated: i32,
    },
    /// A file of the dataset cannot be read.
    #[error(transparent)]
    Spec(#[from] datasets_spec::Error),
    /// A recording cannot continue.
    #[error(transparent)]
    Work(#[from] work::Error),
    /// A condition on clips cannot be parsed, or selects none.
    #[error(transparent)]
    Tables(#[from] tables::Error),
    /// A variable of the environment cannot be read.
    #[error("{0}")]
    Environment(String),
    /// A file of frames changed after it was written.
    #[error("{} is damaged: {problem}; remove it, and it is made again", path.display())]
    Frames {
        /// The file.
        path: PathBuf,
        /// The problem.
        problem: &'static str,
    },
    /// The frames of motions cannot be written to the disk.
    #[error(
        "cannot write {:.1} GB of frames to {}; free as much, or name another folder in STANCE_CACHE",
        *bytes as f64 / 1e9,
        path.display()
    )]
    UnwrittenFrames {
        /// The file.
        path: PathBuf,
        /// Size of the file in bytes.
        bytes: u64,
        /// The cause.
        source: std::io::Error,
    },
    /// A description names a body part that does not exist.
    #[error("motion {motion} describes an unknown body part")]
    Part {
        /// The motion.
        motion: MotionId,
        /// The name found, and the known names.
        source: datasets_spec::Error,
    },
    /// A setting is out of range.
    #[error("setting {key} must be {expected}, got {got}")]
    Config {
        /// Name of the setting.
        key: &'static str,
        /// The allowed values.
        expected: &'static str,
        /// The value found.
        got: f64,
    },
    /// The stored rate is no multiple of the model's.
    #[error(
        "motions at {stored} fps cannot be thinned out to {model} fps; ingest at a whole multiple of it"
    )]
    Stride {
        /// Rate of the motions.
        stored: f64,
        /// Rate of the model.
        model: f64,
    },
    /// No annotated motion is long enough.
    #[error(
        "split {split} has no annotated motion of {frames} frames or more, which a window takes; annotate longer motions"
    )]
    NoItem {
        /// The split.
        split: Split,
        /// Stored frames a window spans.
        frames: usize,
    },
    /// No mask or pair is of the requested tasks.
    #[error("split {split} has no mask or pair for items of task {tasks}")]
    NoTask {
        /// The split.
        split: Split,
        /// The requested tasks, each with the command that brings its masks or pairs into a dataset.
        tasks: String,
    },
    /// The drawn items differ from those of a published set.
    #[error(
        "{count} items were drawn whose ids come to {found}, and those of the set come to {expected}: the dataset is not that \
         of the set, or was made by another version"
    )]
    OtherSet {
        /// Digest of the set.
        expected: String,
        /// Digest of the items drawn.
        found: String,
        /// Number of the items drawn.
        count: usize,
    },
    /// This motion has no partner to blend with.
    #[error(
        "motion {0} has no partner: no other clip drawn from its split is long enough; add motions, raise mcm_ratio or widen base.sources"
    )]
    NoPartner(MotionId),
    /// The motion base is empty, because no motion comes from the sources it is limited to.
    #[error(
        "split {split} has no motion of the sources that base.sources names ({}); it has motions of {}: correct the setting or ingest such motions",
        wanted.join(", "),
        found.join(", ")
    )]
    BaseSources {
        /// The split.
        split: Split,
        /// The requested kinds of source.
        wanted: Vec<String>,
        /// The kinds of source there are.
        found: Vec<String>,
    },
    /// The motion base has one origin, so that no two of its segments can be combined.
    #[error(
        "the coordinator learns from segments of two different clips, and the motion base of split {split} has {} long enough; add motions, raise mcm_ratio or widen base.sources",
        match clip {
            Some(clip) => format!("only {clip} and its copies"),
            None => "no clip".to_owned(),
        }
    )]
    SingleOrigin {
        /// The split.
        split: Split,
        /// The clip that all motions of the base are made of; `None` if the base is empty.
        clip: Option<String>,
    },
    /// Statistics were requested for this split, which is not train.
    #[error("statistics are fitted on split train alone, the library holds split {0}")]
    NotTrain(Split),
    /// There is no motion of the training split to compare with.
    #[error(
        "no motion of split train is present, and activity is measured relative to it; pass all motions of the dataset"
    )]
    NoTrainMotions,
    /// An id names no triplet of the stream.
    #[error("{id:?} is no triplet of this stream, whose ids read {expected}")]
    TripletId {
        /// The id found.
        id: String,
        /// The form expected.
        expected: String,
    },
    /// Two motions to be blended differ in length or rate.
    #[error(
        "cannot blend {source_frames} frames at {source_fps} fps with {target_frames} frames at {target_fps} fps; crop and resample them first"
    )]
    OutOfStep {
        /// Frames of the source.
        source_frames: usize,
        /// Rate of the source.
        source_fps: f64,
        /// Frames of the target.
        target_frames: usize,
        /// Rate of the target.
        target_fps: f64,
    },
}

impl Error {
    /// The code of the error, if it has one, and the item it happened to.
    pub fn code(&self) -> Option<Code> {
        let (code, path) = match self {
            Self::Spec(error) => return error.code(),
            Self::Row { source, .. } => return source.code(),
            Self::Work(error) => return error.code(),
            Self::Frames { path, .. } => ("E-CORRUPT", path),
            Self::UnwrittenFrames { path, .. } => ("E-IO", path),
            _ => return None,
        };
        Some((code, Some(path.display().to_string())))
    }
}

impl From<Error> for Failed {
    fn from(error: Error) -> Self {
        Self::of(error.code(), &error)
    }
}

impl From<Error> for work::Error {
    fn from(error: Error) -> Self {
        match error {
            Error::Work(error) => error,
            Error::Spec(error) => error.into(),
            error => Failed::from(error).into(),
        }
    }
}
