//! Result of a diagnosis: findings by source and kind, and the estimate.

use std::iter::Sum;
use std::path::PathBuf;

use kinematics::motion::BODY_POSE_WIDTH;
use serde::Serialize;

use clip::LabelProblem;

/// Maximum number of examples of a finding.
pub(super) const EXAMPLES: usize = 3;

/// Bytes of a stored frame: translation, root and body rotations in f32.
const FRAME_BYTES: f64 = (4 * (3 + 3 + BODY_POSE_WIDTH)) as f64;
/// Size of a shard relative to its uncompressed motion columns: captured clips measure 0.81 to 1.02;
/// short clips compress less.
const PACKED_SHARE: f64 = 0.92;
/// Frames ingested per core and second. Measured: 34,000 for BVH, the largest by volume, 16,000 for HumanML3D vectors,
/// and 57,000 for AMASS archives.
const FRAMES_PER_CORE_SECOND: f64 = 20_000.0;

/// Findings in all sources, as text and as JSON.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Diagnosis {
    /// Findings of each source, in the order given.
    pub(super) sources: Vec<Findings>,
    /// Coverage of HumanML3D's crop list, if one was given or found.
    pub(super) index: Option<IndexFindings>,
    pub(super) estimate: Estimate,
    /// Advice before ingesting, most important first.
    pub(super) advice: Vec<String>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Findings {
    pub(super) path: PathBuf,
    pub(super) files: u64,
    pub(super) bytes: u64,
    pub(super) kinds: Vec<Kind>,
    pub(super) lfs_pointers: u64,
    pub(super) humanml3d: Vec<HumanMl3dFindings>,
    pub(super) amass: Vec<SubsetFindings>,
    pub(super) stance: Vec<ReleaseFindings>,
    pub(super) motionfix: Vec<ReleaseFindings>,
    /// What releases say of their splits, and their files that would be quarantined.
    pub(super) remarks: Vec<String>,
    /// Captures of markers that give no motion, by code of the rejection.
    pub(super) captures: Vec<CaptureFindings>,
    pub(super) licenses: Vec<LicenseFindings>,
    pub(super) label_problems: Vec<LabelProblem>,
    /// Description of the source if it is a dataset of this program.
    pub(super) dataset: Option<String>,
    pub(super) estimate: Estimate,
}

/// Captures of markers that ingestion would refuse for one reason.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct CaptureFindings {
    pub(super) code: String,
    pub(super) motions: u64,
    /// Number of all captures of the source.
    pub(super) captures: u64,
    /// Some of the files, and why each is refused.
    pub(super) examples: Vec<(String, String)>,
}

/// The licence that a folder states for the motions in it and below.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct LicenseFindings {
    /// Relative to its source; empty for the source itself.
    pub(super) folder: String,
    /// SPDX identifier or another tag of the licence; `None` if no file could be recognised.
    pub(super) license: Option<String>,
    pub(super) non_commercial: bool,
    /// Licence files and readmes that state the licence.
    pub(super) files: Vec<String>,
    /// Licence files that were not recognised.
    pub(super) unknown: Vec<String>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct Kind {
    /// The format, or why such files are skipped.
    pub(super) name: String,
    pub(super) is_motion: bool,
    pub(super) files: u64,
    pub(super) bytes: u64,
    pub(super) clips: u64,
    /// Whether there may be more clips than `clips`: only reading a file shows how many it holds.
    pub(super) is_least: bool,
}

/// A HumanML3D folder. Counts are of ids.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct HumanMl3dFindings {
    /// The folder, relative to its source.
    pub(super) root: String,
    pub(super) joints: u64,
    pub(super) vectors: u64,
    pub(super) texts: u64,
    pub(super) lists: Vec<ListFindings>,
    pub(super) texts_without_motion: u64,
    pub(super) motions_without_text: u64,
    pub(super) motions_without_split: u64,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct ListFindings {
    /// The list, relative to the source.
    pub(super) file: String,
    pub(super) ids: u64,
    /// Ids that have neither joints nor a vector.
    pub(super) without_motion: u64,
    pub(super) without_text: u64,
    pub(super) examples: Vec<String>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct SubsetFindings {
    /// Current name of the subset; empty for files outside any known subset.
    pub(super) name: String,
    /// Number of recordings, without files of body shapes.
    pub(super) files: u64,
    pub(super) bytes: u64,
    /// Variants of the sampled files.
    pub(super) variants: Vec<String>,
    /// Sampled files that are not AMASS.
    pub(super) unreadable: Vec<String>,
}

/// Coverage of HumanML3D's crop list.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct IndexFindings {
    pub(super) path: PathBuf,
    pub(super) rows: u64,
    /// Rows made of HumanAct12's joints, which need no AMASS.
    pub(super) humanact12: u64,
    /// Rows whose recording was found.
    pub(super) found: u64,
    pub(super) subsets: Vec<IndexSubset>,
}

#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub(super) struct IndexSubset {
    /// Folder of the subset in the list, or `unknown`.
    pub(super) name: String,
    pub(super) rows: u64,
    /// Rows whose recording was found.
    pub(super) found: u64,
    /// Some of the recordings that were not found.
    pub(super) examples: Vec<String>,
    /// The archive to fetch, if anything is missing.
    pub(super) archive: Option<String>,
}

/// Coverage of a release made of several parts.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct ReleaseFindings {
    /// The folder, relative to its source.
    pub(super) root: String,
    pub(super) parts: Vec<Part>,
}

/// A folder or file of a release, with the numbers of its files that were found and that were published.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct Part {
    pub(super) name: String,
    pub(super) files: u64,
    pub(super) published: u64,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(super) struct Estimate {
    pub(super) clips: u64,
    /// Frames of the dataset at 20 fps.
    pub(super) frames: u64,
    /// Size of the dataset in bytes: 69 numbers of 4 bytes a frame, packed to 92 %.
    pub(super) bytes: u64,
    /// Time on one core in seconds, at 20,000 frames a second.
    pub(super) core_seconds: f64,
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
}

impl Sum for Estimate {
    fn sum<I: Iterator<Item = Self>>(estimates: I) -> Self {
        estimates.fold(Self::default(), |sum, one| Self {
            clips: sum.clips + one.clips,
            frames: sum.frames + one.frames,
            bytes: sum.bytes + one.bytes,
            core_seconds: sum.core_seconds + one.core_seconds,
        })
    }
}
