//! The interfaces of source formats and of releases.

use std::fmt;
use std::io::Read;
use std::path::Path;

use datasets_spec::manifest::RejectedPairs;
use datasets_spec::rejected::RejectedMasks;
use datasets_spec::store::Reader;
use datasets_spec::{Fps, Split};

use super::files::Files;
use super::options::ReadOptions;
use super::up::Up;
use crate::markers::{self, Capture};
use clip::{MAX_FPS, MIN_FPS, Outcome, ReadClip, Rejected, rejected};

/// Reads the markers of a file; `None` if it has no markers.
pub type ReadCapture = fn(&[u8], &ReadOptions) -> Result<Option<Capture>, Rejected>;

/// The type of [`Format::by_name`].
pub(super) type JudgeByName = fn(&str, &[u8]) -> Option<Result<(), String>>;

/// The type of [`Format::keys`].
pub(super) type NameMotions = fn(&[u8], &ReadOptions) -> Vec<String>;

/// A source format: how its files are recognised and read. Formats register in [`super::FORMATS`].
///
/// A format of single files sets `read`, and `extensions` or `by_content`; a format of releases, whose files belong
/// together, sets `find`. The other fields keep the values of `of_files` or `of_releases`.
#[derive(Clone, Copy)]
pub struct Format {
    pub(super) name: &'static str,
    /// How files are recognised and where rotations come from, for the help text.
    pub about: &'static str,
    /// Bytes per second of motion in a file, for estimates.
    pub bytes_per_second: f64,
    /// Whether each of its files holds one recording.
    pub is_of_files: bool,
    /// The up axis of its files, for formats whose readers assume one that the files do not state.
    pub(super) assumed_up: Option<Up>,
    /// Extensions of its files, in lower case.
    pub(super) extensions: &'static [&'static str],
    /// Judges a file with one of the extensions by its name in lower case and its first bytes: `Ok` if it is a motion,
    /// the reason if it is none, and `None` if it is not of this format.
    pub(super) by_name: JudgeByName,
    /// Whether a file that no format recognises by name has this format, by its first bytes.
    pub(super) by_content: fn(&[u8]) -> bool,
    /// Names the motions in a file, for formats whose files may hold several. No names if the file holds one motion or
    /// cannot be read.
    pub keys: Option<NameMotions>,
    /// Reads one motion of a single file. The key is one of `keys`, or empty.
    pub read: fn(&Path, &str, &[u8], &ReadOptions) -> Outcome,
    /// Reads the markers of a file, for formats of captures, whose keys are subjects.
    pub capture: Option<ReadCapture>,
    /// Refuses a large file from its headers, before all of it is read.
    pub refuse_large: fn(Reader) -> Option<Rejected>,
    /// Reads a file of one motion in pieces, for formats whose files are much larger than their motions. The number is
    /// the file's size in bytes. `None`, without reading anything, if the format reads files whole.
    pub read_in_pieces: fn(&mut dyn Read, usize, &ReadOptions) -> Option<Outcome>,
    /// The releases among the files, each found by its layout.
    pub(super) find: fn(&Files) -> Vec<Box<dyn Release>>,
}

impl Format {
    /// A format of single files, each of which holds one recording. `about` says how files are recognised and where
    /// rotations come from.
    pub(super) const fn of_files(
        name: &'static str,
        about: &'static str,
        bytes_per_second: f64,
    ) -> Self {
        Self {
            name,
            about,
            bytes_per_second,
            is_of_files: true,
            assumed_up: None,
            extensions: &[],
            by_name: |_, _| Some(Ok(())),
            by_content: |_| false,
            keys: None,
            read: |_, _, _, _| {
                let reason = "the format is one of releases, not of files";
                Outcome::Rejected(Rejected::read("E-INTERNAL", reason))
            },
            capture: None,
            refuse_large: |_| None,
            read_in_pieces: |_, _, _| None,
            find: |_| Vec::new(),
        }
    }

    /// A format of releases, as `of_files`. A file of a release may hold thousands of recordings.
    pub(super) const fn of_releases(
        name: &'static str,
        about: &'static str,
        bytes_per_second: f64,
    ) -> Self {
        Self {
            is_of_files: false,
            ..Self::of_files(name, about, bytes_per_second)
        }
    }

    /// The name used in tables and on the command line.
    pub fn as_str(self) -> &'static str {
        self.name
    }

    /// Recognises a file by its name in lower case and its first bytes; `None` if it is not of this format.
    pub(super) fn recognise(self, extension: &str, name: &str, head: &[u8]) -> Option<Recognised> {
        if !self.extensions.contains(&extension) {
            return None;
        }
        Some(match (self.by_name)(name, head)? {
            Ok(()) => Recognised::Motion(self),
            Err(reason) => Recognised::NotMotion { reason },
        })
    }

    /// Names of the motions in a file; empty if it holds one motion or cannot be read.
    pub fn keys(self, bytes: &[u8], options: &ReadOptions) -> Vec<String> {
        self.keys.map_or_else(Vec::new, |keys| keys(bytes, options))
    }

    /// The subject that a key of `keys` names; `None` for formats whose keys are not subjects.
    pub fn subject_of(self, key: &str) -> Option<&str> {
        self.capture.and_then(|_| markers::subject_of(key))
    }
}

impl PartialEq for Format {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

impl Eq for Format {}

impl fmt::Debug for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

/// Kind of a file, recognised by its name and first bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Recognised {
    /// A motion in this format.
    Motion(Format),
    /// Not a motion, or not one this crate reads.
    NotMotion {
        /// Why the file is skipped.
        reason: String,
    },
}

/// One motion in the plan: a whole file, or one of several that a file holds.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Entry {
    /// Relative path of the file it is read from.
    pub file: String,
    /// Key of the motion in its file; empty if the file holds one motion.
    pub key: String,
    /// Id of the motion.
    pub id: String,
    /// The published split; without one, a split is drawn.
    pub split: Option<Split>,
    /// Motions of the same group share a drawn split. Without a group, a motion shares its split only with its source
    /// clip.
    pub group: Option<String>,
    /// Id of the motion it mirrors.
    pub mirrored_of: Option<String>,
}

/// The files of a release.
#[derive(Debug, Default)]
pub struct Contents {
    /// Motions of the release, in an order that only depends on the files.
    pub entries: Vec<Entry>,
    /// Files without a motion of their own, with the reason why each is skipped. Every file of the
    /// release is named here, in `rejected` or by an entry.
    pub passed_over: Vec<(String, String)>,
    /// Files that were found broken before any motion was read.
    pub rejected: Vec<(String, Rejected)>,
    /// Remarks on the splits of the release's motions.
    pub remarks: Vec<String>,
    /// The files that publish splits of such a release, whether it has them or not; empty if its layout has none.
    pub publishes_splits: &'static str,
    /// Masks and pairs that people rejected, by the ids of the entries.
    pub rejected_labels: (RejectedMasks, RejectedPairs),
    /// Files that state splits, or which motions share one, and could not be read. The splits of the release's motions
    /// are unknown as long as there are such files.
    pub unread_splits: Vec<String>,
}

/// Ids that a remark names as examples.
const EXAMPLES: usize = 3;

impl Contents {
    /// Passes over a file without a motion of its own.
    pub(super) fn pass_over(&mut self, file: impl Into<String>, reason: impl Into<String>) {
        self.passed_over.push((file.into(), reason.into()));
    }

    /// Passes over a file of captions. `has_motion` says whether the motion that they describe is among the files.
    pub(super) fn pass_over_captions(&mut self, file: impl Into<String>, has_motion: bool) {
        let reason = match has_motion {
            true => "captions, read with the motion they describe",
            false => "captions without a motion",
        };
        self.pass_over(file, reason);
    }

    /// Rejects a file that was found broken.
    pub(super) fn reject(&mut self, file: impl Into<String>, rejected: Rejected) {
        self.rejected.push((file.into(), rejected));
    }

    /// Rejects a file that states splits.
    pub(super) fn reject_splits(&mut self, file: impl Into<String>, rejected: Rejected) {
        let file = file.into();
        self.unread_splits.push(file.clone());
        self.reject(file, rejected);
    }

    /// Remarks on ids of a published split that have no motion.
    pub(super) fn remark_on_listed(&mut self, release: &str, list: &str, missing: Vec<&str>) {
        if missing.is_empty() {
            return;
        }
        let examples = missing.iter().take(EXAMPLES).copied();
        self.remarks.push(format!(
            "{release}: {} ids of {list} have no motion (such as {})",
            missing.len(),
            examples.collect::<Vec<_>>().join(", ")
        ));
    }
}

/// A release: files that belong together and are read by their own rules.
pub trait Release: Send + Sync {
    /// Files of the release.
    fn contents(&self) -> &Contents;

    /// The files that hold a motion. Labels that people made of it hold as long as these are the same.
    fn motion_files<'a>(&'a self, entry: &'a Entry) -> Vec<&'a str> {
        vec![&entry.file]
    }

    /// Reads one motion. Called from many threads at once.
    ///
    /// # Errors
    /// The motion cannot be used.
    fn read(&self, files: &Files, entry: &Entry, options: &ReadOptions) -> ReadClip;
}

/// Boxes the releases that a format found.
pub(super) fn boxed<R: Release + 'static>(
    found: impl IntoIterator<Item = R>,
) -> Vec<Box<dyn Release>> {
    let found = found.into_iter();
    found
        .map(|release| Box::new(release) as Box<dyn Release>)
        .collect()
}

/// A frame rate in 1/s that a file states; `None` if it is implausible.
pub(super) fn plausible_fps(rate: f64) -> Option<Fps> {
    let fps = Fps::from_file(rate).ok();
    fps.filter(|_| (MIN_FPS..=MAX_FPS).contains(&rate))
}

/// Code of a motion of 0 or 1 frames.
pub(super) const TOO_SHORT: &str = "E-TOO-SHORT";

/// The rejection of a motion of 0 or 1 frames.
pub(super) fn too_short(num_frames: usize) -> Rejected {
    rejected!(TOO_SHORT, "found {num_frames} frames, expected at least 2")
}

/// Refuses a stored pose whose skeleton differs from the requested one.
pub(super) fn check_skeleton(found: &str, options: &ReadOptions) -> Result<(), Rejected> {
    let wanted = options.skeleton.name();
    match found == wanted {
        true => Ok(()),
        false => Err(rejected!(
            "E-DATASET-SKELETON",
            "posed on skeleton {found}, not on {wanted}; ingest with the same --body-model"
        )),
    }
}
