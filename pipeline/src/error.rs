//! Errors of the pipeline.

use std::path::PathBuf;

use datasets_spec::Code;
use work::Failed;

/// An error that ends a run. A faulty source file is not an error but a row of the `quarantine` table.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A dataset does not contain the clip.
    #[error("no clip {id:?} in {}", path.display())]
    NoClip {
        /// The dataset.
        path: PathBuf,
        /// The requested id.
        id: String,
    },
    /// A folder does not contain the item.
    #[error("no item {id:?} in {}", path.display())]
    NoItem {
        /// The folder.
        path: PathBuf,
        /// The requested id.
        id: String,
    },
    /// Several items have ids with this prefix.
    #[error("several items begin with {0:?}; write more of the id")]
    SeveralItems(String),
    /// A query of the tables of a dataset cannot be understood or answered.
    #[error(transparent)]
    Tables(#[from] tables::Error),
    /// A dataset holds nothing that could be a triplet.
    #[error(
        "{} holds neither recorded triplets, nor items with targets, nor pairs with instructions; \
         `stance triplets DATASET --out TRIPLETS` records triplets",
        .0.display()
    )]
    NoTriplets(PathBuf),
    /// A folder holds something other than motions.
    #[error("{} is {other}", path.display())]
    OtherThanMotions {
        /// The folder.
        path: PathBuf,
        /// Kind of the folder, and the verbs that take it.
        other: &'static str,
    },
    /// Automatic masks would replace masks that people have judged.
    #[error(
        "{} holds {count} masks judged by people, which automatic masks would replace; pass --add to \
         keep them and derive those of other clips, or --replace to discard them",
        path.display()
    )]
    JudgedMasks {
        /// The dataset.
        path: PathBuf,
        /// Judged masks.
        count: usize,
    },
    /// The rate to store motions at is implausible.
    #[error(
        "cannot store motions at {got} frames per second; choose {lowest} to {highest}, or native"
    )]
    StoredRate {
        /// The requested rate.
        got: f64,
        /// The lowest accepted rate.
        lowest: f64,
        /// The highest accepted rate.
        highest: f64,
    },
    /// The dataset was made with other settings.
    #[error(
        "{} was made with other settings: {differing}; choose another folder, or pass --new-version to read \
         everything again with the new ones",
        path.display()
    )]
    OtherSettings {
        /// The dataset.
        path: PathBuf,
        /// The settings that differ, with both values.
        differing: String,
    },
    /// The requested source is ambiguous. The text states the candidates and how to choose.
    #[error("{0}")]
    AskedSource(String),
    /// Clips would keep their old settings, and all clips of a dataset must share these settings.
    #[error(
        "{count} clips of {} cannot be read again with the new settings ({differing}): {shown}; nothing was changed. \
         Put their files back, keep the settings, or pass --prune to leave these clips out",
        path.display()
    )]
    Mixture {
        /// The dataset.
        path: PathBuf,
        /// Number of clips.
        count: usize,
        /// The first of the ids.
        shown: String,
        /// The settings, with both values.
        differing: String,
    },
    /// Two datasets are posed on different skeletons.
    #[error(
        "the datasets are posed on different bodies: {first} and {second}; ingest one of them again with the \
         --body-model of the other"
    )]
    OtherSkeleton {
        /// Skeleton of the first.
        first: String,
        /// Skeleton of the second.
        second: String,
    },
    /// The output folder already holds a dataset.
    #[error("{} is a dataset already; choose a folder that does not exist", .0.display())]
    DatasetExists(PathBuf),
    /// Labels would be lost.
    #[error(
        "{count} labels in {} belong to clips that changed or went: {shown}; nothing was changed. Pass \
         --drop-labels to go on without them (the version before keeps them)",
        path.display()
    )]
    LabelsLost {
        /// The dataset.
        path: PathBuf,
        /// Number of labels.
        count: usize,
        /// The first of the ids.
        shown: String,
    },
    /// A list names no clip, or clips that are not in the dataset.
    #[error(
        "{count} ids of {} name no clip of {}: {shown}; nothing was changed. `stance inspect {} --list` shows the ids",
        path.display(),
        dataset.display(),
        dataset.display()
    )]
    UnknownIds {
        /// The list.
        path: PathBuf,
        /// The dataset.
        dataset: PathBuf,
        /// Number of such ids.
        count: usize,
        /// The first of the ids.
        shown: String,
    },
    /// Every clip of a dataset would be removed.
    #[error(
        "every clip of {} would be removed; nothing was changed. Remove the folder if that is meant",
        .0.display()
    )]
    AllRemoved(PathBuf),
    /// Two datasets differ in settings that must be equal within a dataset. The text names them, with both values.
    #[error(
        "the datasets cannot be one: {0}; ingest one of them again with the setting of the other"
    )]
    CannotMerge(String),
    /// A source folder or file does not exist.
    #[error("no such file or folder: {}; check the path", .0.display())]
    MissingSource(PathBuf),
    /// The sources hold no files at all.
    #[error("no files under {paths}; {hint}")]
    NoFiles {
        /// The paths given.
        paths: String,
        /// What the folder holds instead, or what to check.
        hint: String,
    },
    /// A plan for many processes reads an archive that each of them would have to unpack.
    #[error(
        "{}: the members of a packed tar cannot be read by many processes; unpack it and name its folder, or pack it \
         as zip",
        .0.display()
    )]
    PackedTar(PathBuf),
    /// A file of chosen ids chooses no clip.
    #[error("cannot choose clips by {}: {reason}", path.display())]
    IdList {
        /// The file.
        path: PathBuf,
        /// Why not.
        reason: String,
    },
    /// An export of a dataset without motions was requested.
    #[error(
        "{} holds neither motions nor edits; name a dataset, or a folder that `stance edit` wrote",
        .0.display()
    )]
    NoMotions(PathBuf),
    /// An export of edits in this layout was requested, which holds only whole datasets.
    #[error("{0} is a layout of whole datasets; edits are exported as bvh, amass or gltf")]
    LayoutOfEdits(&'static str),
    /// A bundle of answers, or a folder that is to become one, breaks a rule.
    #[error("{}: {problem}", path.display())]
    Bundle {
        /// The bundle.
        path: PathBuf,
        /// What is wrong; names the item if one is at fault.
        problem: String,
    },
    /// Two items have this id.
    #[error("item {0} is in the table twice; draw the items again with `stance items`")]
    ItemTwice(String),
    /// The layout has one frame rate and the clips have several.
    #[error("clip {motion} is at {other} fps and others at {first}; ingest with one --fps")]
    MixedRates {
        /// Rate of the first clip.
        first: f32,
        /// Rate of another motion.
        other: f32,
        /// The motion with that rate.
        motion: datasets_spec::MotionId,
    },
    /// The dataset could not be read or written.
    #[error(transparent)]
    Spec(#[from] datasets_spec::Error),
    /// A motion is invalid.
    #[error(transparent)]
    Motion(#[from] kinematics::Error),
    /// A file or folder cannot be read as its format says.
    #[error(transparent)]
    Formats(#[from] formats::Error),
    /// A job in pieces, or its output folder, cannot continue.
    #[error(transparent)]
    Work(#[from] work::Error),
    /// Composing motions failed.
    #[error(transparent)]
    Compose(#[from] compose::Error),
}

impl Error {
    /// The code of the error, if it has one, and the item it happened to.
    pub fn code(&self) -> Option<Code> {
        let (code, path) = match self {
            Self::Spec(error) => return error.code(),
            Self::Compose(error) => return error.code(),
            Self::Formats(error) => return error.code(),
            Self::Work(error) => return error.code(),
            Self::MissingSource(path) => ("E-MISSING", path),
            Self::Mixture { path, .. } => ("E-MIXTURE", path),
            Self::AskedSource(_) => return Some(("E-SOURCE-NAME", None)),
            Self::IdList { path, .. } => ("E-ID-LIST", path),
            Self::PackedTar(path) => ("E-PACKED-TAR", path),
            Self::NoFiles { paths, .. } => return Some(("E-NO-FILES", Some(paths.clone()))),
            Self::NoClip { id, .. } => return Some(("E-CLIP-UNKNOWN", Some(id.clone()))),
            Self::NoItem { id, .. } => return Some(("E-ITEM-UNKNOWN", Some(id.clone()))),
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
