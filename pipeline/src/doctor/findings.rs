//! Result of a diagnosis: findings by source and kind, and the estimate.

use std::path::PathBuf;

use kinematics::motion::BODY_POSE_WIDTH;
use serde::Serialize;

use clip::LabelProblem;

/// Number of examples named of what is missing.
pub(super) const EXAMPLES: usize = 3;

/// Bytes of a stored frame: translation, root and body rotations in f32.
const FRAME_BYTES: f64 = (4 * (3 + 3 + BODY_POSE_WIDTH)) as f64;
/// Size of a shard relative to its uncompressed motion columns: captured clips measure 0.81 to 1.02;
/// short clips compress less.
const PACKED_SHARE: f64 = 0.92;
/// Frames stored per core and second, from reading to writing: BVH, the largest by volume, measures
/// 34,000, HumanML3D vectors 16,000 and AMASS archives 57,000.
const FRAMES_PER_CORE_SECOND: f64 = 20_000.0;

/// Findings in all sources.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Diagnosis {
    /// Findings by source, in the order given.
    pub sources: Vec<Findings>,
    /// Coverage of HumanML3D's crop list, if one was given or found.
    pub index: Option<IndexFindings>,
    /// All sources together.
    pub estimate: Estimate,
    /// Advice before ingesting, most important first.
    pub advice: Vec<String>,
}

/// Findings in one source.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Findings {
    /// The source.
    pub path: PathBuf,
    /// Number of files of any kind.
    pub files: u64,
    /// Total size of the files in bytes.
    pub bytes: u64,
    /// Files by motion format, or by the reason why they are skipped.
    pub kinds: Vec<Kind>,
    /// Git LFS pointers in place of files.
    pub lfs_pointers: u64,
    /// HumanML3D folders.
    pub humanml3d: Vec<HumanMl3dFindings>,
    /// Subsets of AMASS.
    pub amass: Vec<SubsetFindings>,
    /// Folders of the STANCE release.
    pub stance: Vec<ReleaseFindings>,
    /// Folders of the MotionFix release.
    pub motionfix: Vec<ReleaseFindings>,
    /// Captures of markers that give no motion, by code of the rejection.
    pub captures: Vec<CaptureFindings>,
    /// Licences that its folders state.
    pub licenses: Vec<LicenseFindings>,
    /// Files of labels, and lines of them, that cannot be used.
    pub label_problems: Vec<LabelProblem>,
    /// Description of the source if it is a dataset of this program.
    pub dataset: Option<String>,
    /// Estimate of the ingest.
    pub estimate: Estimate,
}

/// Captures of markers that ingestion would refuse for one reason.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct CaptureFindings {
    /// Code of the rejection.
    pub code: String,
    /// Motions that are refused.
    pub motions: u64,
    /// Number of all captures of the source.
    pub captures: u64,
    /// Some of the files, and why each is refused.
    pub examples: Vec<(String, String)>,
}

/// The licence that a folder states for the motions in it and below.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct LicenseFindings {
    /// The folder, relative to its source; empty for the source itself.
    pub folder: String,
    /// SPDX identifier or another tag of the licence; none if no file could be recognised.
    pub license: Option<String>,
    /// Whether the licence forbids commercial use.
    pub non_commercial: bool,
    /// Licence files and readmes that state the licence.
    pub files: Vec<String>,
    /// Licence files that were not recognised.
    pub unknown: Vec<String>,
}

/// Files of one kind.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Kind {
    /// The format, or why such files are skipped.
    pub name: String,
    /// Whether they are read as motions.
    pub is_motion: bool,
    /// Number of files.
    pub files: u64,
    /// Total size of the files in bytes.
    pub bytes: u64,
}

/// Findings in a HumanML3D folder.
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
    /// Lists of ids in the folder.
    pub lists: Vec<ListFindings>,
    /// Ids with captions and no motion.
    pub texts_without_motion: u64,
    /// Ids with a motion and no captions.
    pub motions_without_text: u64,
    /// Ids with a motion that no split list names.
    pub motions_without_split: u64,
}

/// Coverage of a list of ids.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ListFindings {
    /// The list, relative to the source.
    pub file: String,
    /// Ids in the list.
    pub ids: u64,
    /// Ids in the list without joints and vector.
    pub without_motion: u64,
    /// Ids in the list without captions.
    pub without_text: u64,
    /// Some of the ids without a motion.
    pub examples: Vec<String>,
}

/// A subset of AMASS among the files.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct SubsetFindings {
    /// Present name of the subset; empty for files outside any known subset.
    pub name: String,
    /// Number of recordings, without files of body shapes.
    pub files: u64,
    /// Total size of the files in bytes.
    pub bytes: u64,
    /// Variants of the sampled files.
    pub variants: Vec<String>,
    /// Sampled files that are not AMASS.
    pub unreadable: Vec<String>,
}

/// Coverage of HumanML3D's crop list.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct IndexFindings {
    /// The list.
    pub path: PathBuf,
    /// Number of rows.
    pub rows: u64,
    /// Rows made of HumanAct12's joints, which need no AMASS.
    pub humanact12: u64,
    /// Rows whose recording was found.
    pub found: u64,
    /// Rows by subset.
    pub subsets: Vec<IndexSubset>,
}

/// Coverage of a subset in the crop list.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct IndexSubset {
    /// The subset's folder in the list.
    pub name: String,
    /// Number of rows.
    pub rows: u64,
    /// Rows whose recording was found.
    pub found: u64,
    /// Some of the recordings that were not found.
    pub examples: Vec<String>,
    /// The archive to fetch, if anything is missing.
    pub archive: Option<String>,
}

/// Coverage of a release made of several parts.
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
    /// Number of its files that were found.
    pub files: u64,
    /// Number of its files that were published.
    pub published: u64,
}

/// Estimate of an ingest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Estimate {
    /// Number of motions.
    pub clips: u64,
    /// Frames of the dataset at 20 fps.
    pub frames: u64,
    /// Size of the dataset in bytes: 69 numbers of 4 bytes a frame, packed to 92 %.
    pub bytes: u64,
    /// Time on one core in seconds, at 20,000 frames a second.
    pub core_seconds: f64,
}

impl Estimate {
    pub(super) fn of(clips: u64, frames: f64) -> Self {
        Self {
            clips,
            frames: frames.round() as u64,
            bytes: (frames * FRAME_BYTES * PACKED_SHARE).round() as u64,
            core_seconds: frames / FRAMES_PER_CORE_SECOND,
        }
    }

    pub(super) fn add(&mut self, other: Self) {
        self.clips += other.clips;
        self.frames += other.frames;
        self.bytes += other.bytes;
        self.core_seconds += other.core_seconds;
    }
}
