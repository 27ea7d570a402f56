//! Finds the clips of one recording. They share a split, whatever their ids and however they were read.
//!
//! * Clips whose ids name one source clip: crops, mirrored copies, several motions of a file; also a clip and the clip
//!   that its column `mirrored_of` names.
//! * Clips of one file, by its hash, if files of its format hold one recording each.
//! * In a release, which names its recordings and may hold thousands in one file: clips of one file with one name. Two
//!   names of a release are two recordings even if their files are equal, because its published splits are kept.
//! * Clips with equal or nearly equal motions ([`crate::likeness`]).

use std::collections::BTreeMap;
use std::path::PathBuf;

use datasets_spec::record::MotionRow;
use datasets_spec::table::{Row, ShardReader};
use datasets_spec::{Dataset, MotionId, Split};
use formats::source::format_named;
use rayon::prelude::*;

use crate::Error;
use crate::clip_table::clip_facts;
use crate::likeness::{Sketch, near_pairs};

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Origin {
    pub(crate) id: MotionId,
    pub(crate) split: Split,
    /// Format of the clip's file.
    pub(crate) source: String,
    /// Hash of the clip's file; empty if it is not known.
    pub(crate) source_hash: String,
    pub(crate) mirrored_of: Option<String>,
}

#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Recording {
    /// Source clip of an id, in one dataset.
    Clip(usize, String),
    File(String),
    /// A file of a release, and the name of a clip in the release.
    Member(String, String),
    Motion(String),
}

impl Recording {
    /// The common origin of two clips with this key, in words for a finding.
    pub(crate) fn says(&self) -> &'static str {
        match self {
            Self::Clip(..) => "made of the same source clip",
            Self::File(_) | Self::Member(..) => "whose file has the same content",
            Self::Motion(_) => "the same motion",
        }
    }
}

/// Prefixes of the ids of each source of a dataset.
#[derive(Clone, Debug, Default)]
pub(crate) struct Prefixes(Vec<String>);

impl Prefixes {
    pub(crate) fn of(dataset: &Dataset) -> Result<Self, Error> {
        let sources: Vec<serde_json::Value> = dataset.manifest().fact("sources")?;
        let prefixes = sources
            .iter()
            .filter_map(|source| source.get("label")?.as_str());
        let mut prefixes: Vec<String> = prefixes
            .filter(|label| !label.is_empty())
            .map(|label| format!("{label}/"))
            .collect();
        prefixes.sort_by_key(|prefix| std::cmp::Reverse(prefix.len()));
        Ok(Self(prefixes))
    }

    /// An id without the prefix of its source.
    fn strip<'a>(&self, id: &'a str) -> &'a str {
        let mut found = self.0.iter().filter_map(|prefix| id.strip_prefix(prefix));
        found.next().unwrap_or(id)
    }
}

impl Origin {
    /// The recordings that a clip of a dataset belongs to. `number` identifies the dataset.
    pub(crate) fn recordings(&self, prefixes: &Prefixes, number: usize) -> Vec<Recording> {
        let own = source_clip(self.id.as_str());
        let original = self.mirrored_of.as_deref().map(source_clip);
        let name = original.clone().unwrap_or_else(|| own.clone());
        let mut recordings = vec![Recording::Clip(number, own)];
        recordings.extend(original.map(|original| Recording::Clip(number, original)));
        let hash = self.source_hash.clone();
        if format_named(&self.source).is_some_and(|format| format.is_of_files) && !hash.is_empty() {
            recordings.push(Recording::File(hash));
        } else if !hash.is_empty() {
            recordings.push(Recording::Member(hash, prefixes.strip(&name).to_owned()));
        }
        recordings
    }
}

/// Id of the clip of the source that a clip was made from; the id itself if it is malformed.
pub(crate) fn source_clip(id: &str) -> String {
    MotionId::parse(id).map_or(id.to_owned(), |id| id.source_clip().to_owned())
}

/// Groups the clips that have a recording in common.
pub(crate) fn grouped(recordings: &[Vec<Recording>]) -> Groups {
    let mut groups = Groups::new(recordings.len());
    let mut first: BTreeMap<&Recording, usize> = BTreeMap::new();
    for (clip, recordings) in recordings.iter().enumerate() {
        for recording in recordings {
            let first = *first.entry(recording).or_insert(clip);
            groups.unite(first, clip);
        }
    }
    groups
}

/// Numbers in disjoint groups (union-find).
pub(crate) struct Groups(Vec<usize>);

impl Groups {
    pub(crate) fn new(count: usize) -> Self {
        Self((0..count).collect())
    }

    /// The smallest number of a group.
    pub(crate) fn of(&self, mut number: usize) -> usize {
        while self.0[number] != number {
            number = self.0[number];
        }
        number
    }

    pub(crate) fn unite(&mut self, a: usize, b: usize) {
        let (a, b) = (self.of(a), self.of(b));
        self.0[a.max(b)] = a.min(b);
    }
}

/// A clip of a dataset: its origin, and the hash of its motion, which is empty for captures without one.
pub(crate) struct Clip {
    pub(crate) origin: Origin,
    pub(crate) content: String,
    /// Rate of the motion, in 1/s.
    pub(crate) fps: Option<f32>,
}

pub(crate) fn clips(dataset: &Dataset) -> Result<Vec<Clip>, Error> {
    let clips = clip_facts(dataset)?.into_iter();
    let clips = clips.map(|(split, clip)| Clip {
        fps: (!clip.content_hash.is_empty()).then_some(clip.fps),
        content: clip.content_hash,
        origin: Origin {
            id: clip.id,
            split,
            source: match clip.source.as_str() {
                // Tables of markers have no such column; markers come from C3D files.
                "" => "c3d".to_owned(),
                _ => clip.source,
            },
            source_hash: clip.source_hash,
            mirrored_of: clip.mirrored_of,
        },
    });
    Ok(clips.collect())
}

/// Sketches of the motions of a dataset, in the order of its files.
pub(crate) fn sketches(dataset: &Dataset) -> Result<Vec<(MotionId, Sketch)>, Error> {
    let skeleton = dataset.skeleton()?;
    let files: Vec<PathBuf> = dataset
        .files(MotionRow::TABLE, None)
        .into_iter()
        .map(|(path, _)| path)
        .collect();
    let sketched = files.par_iter().map(|path| {
        let rows: Vec<MotionRow> = ShardReader::open(path)?.rows()?;
        let sketch = |row: MotionRow| Ok((row.id.clone(), Sketch::of(&row.motion()?, &skeleton)));
        rows.into_iter()
            .map(sketch)
            .collect::<Result<Vec<_>, Error>>()
    });
    let sketched: Vec<Vec<(MotionId, Sketch)>> = sketched.collect::<Result<_, _>>()?;
    Ok(sketched.into_iter().flatten().collect())
}

/// Unites the groups of nearly equal motions. `sketches` name the number of their clip.
pub(crate) fn unite_alike(groups: &mut Groups, sketches: Vec<(usize, Sketch)>) {
    let numbers: Vec<usize> = sketches.iter().map(|(number, _)| *number).collect();
    let of_group: Vec<(usize, Sketch)> = sketches
        .into_iter()
        .map(|(number, sketch)| (groups.of(number), sketch))
        .collect();
    for (a, b, _) in near_pairs(&of_group) {
        groups.unite(numbers[a], numbers[b]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn origin(id: &str, source: &str, hash: &str) -> Origin {
        Origin {
            id: MotionId::parse(id).expect("valid"),
            split: Split::Train,
            source: source.to_owned(),
            source_hash: hash.to_owned(),
            mirrored_of: None,
        }
    }

    fn are_one(a: &Origin, b: &Origin) -> bool {
        let prefixes = Prefixes(vec!["b/".to_owned()]);
        let recordings = [a.recordings(&prefixes, 0), b.recordings(&prefixes, 0)];
        let groups = grouped(&recordings);
        groups.of(0) == groups.of(1)
    }

    #[test]
    fn clips_of_one_file_are_one_recording_unless_a_release_names_them() {
        let bvh = |id, hash| origin(id, "bvh", hash);
        assert!(are_one(&bvh("a", "1"), &bvh("b/c", "1")));
        assert!(!are_one(&bvh("a", "1"), &bvh("b/c", "2")));
        assert!(!are_one(&bvh("a", ""), &bvh("b/c", "")));
        assert!(are_one(&bvh("take#1", "1"), &bvh("take#2", "2")));
        let mut mirrored = bvh("other", "2");
        mirrored.mirrored_of = Some("a".to_owned());
        assert!(are_one(&bvh("a", "1"), &mirrored));
        // Thousands of recordings lie in one file of a release, and its splits are published.
        let fix = |id| origin(id, "motionfix", "1");
        assert!(!are_one(&fix("000001"), &fix("000002")));
        assert!(are_one(&fix("000001"), &fix("b/000001")));
        let elsewhere = origin("b/000001", "motionfix", "2");
        assert!(!are_one(&fix("000001"), &elsewhere));
    }
}
