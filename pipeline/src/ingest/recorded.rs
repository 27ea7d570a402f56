//! What a dataset already holds of its sources.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use datasets_spec::manifest::{FileEntry, Manifest};
use datasets_spec::record::{MarkerRow, MaskRow, MotionRow, PairRow, QuarantineRow, SkippedRow};
use datasets_spec::table::{Row, ShardReader, read_rows};
use datasets_spec::{Dataset, MotionId, Split};

use super::list::labelled;
use super::options::{LABEL_PROBLEMS_FACT, PAIRS_FACT, SEED_FACT, SETTINGS_FACT, Settings};
use super::sources::{SOURCES_FACT, SourceLabel, lies_in};
use crate::Error;
use crate::clip::LabelProblem;
use crate::clip_table::CLIP_TABLES;

/// The version that a run starts from.
#[derive(Default)]
pub(super) struct Base {
    pub(super) recorded: Recorded,
    /// The settings it was made with, as JSON.
    pub(super) settings: Option<String>,
    /// Hash of its list of pairs.
    pub(super) pairs: Option<String>,
    pub(super) masks: Vec<MaskRow>,
    pub(super) label_pairs: Vec<PairRow>,
    pub(super) label_problems: Vec<LabelProblem>,
}

impl Base {
    /// Reads the version that a run starts from, of the dataset at `root`; none if it has no motions.
    pub(super) fn read(root: &Path, base: Option<&Manifest>) -> Result<Option<Self>, Error> {
        let Some(base) = base else {
            return Ok(None);
        };
        let Some(recorded) = Recorded::read(root, base)? else {
            return Ok(None);
        };
        Ok(Some(Self {
            recorded,
            settings: base.facts.get(SETTINGS_FACT).cloned(),
            pairs: base.facts.get(PAIRS_FACT).cloned(),
            masks: rows(root, base)?,
            label_pairs: rows(root, base)?,
            label_problems: base
                .facts
                .get(LABEL_PROBLEMS_FACT)
                .and_then(|text| serde_json::from_str(text).ok())
                .unwrap_or_default(),
        }))
    }
}

/// The sources, clips and rejected items of the version that a run starts from.
#[derive(Default)]
pub(super) struct Recorded {
    pub(super) sources: Vec<SourceLabel>,
    pub(super) clips: Vec<RecordedClip>,
    pub(super) shards: Vec<RecordedShard>,
    pub(super) quarantine: Vec<QuarantineRow>,
    pub(super) skipped: Vec<SkippedRow>,
}

/// A clip, or a capture that has only markers, which versions before kept.
#[derive(Clone, Debug)]
pub(super) struct RecordedClip {
    pub(super) id: MotionId,
    pub(super) split: Split,
    pub(super) path: String,
    pub(super) hash: String,
    /// Empty for captures without a motion, and in datasets of older formats.
    pub(super) inputs: String,
    /// Hash of the motion; empty for captures without one.
    pub(super) content: String,
    /// Its place in [`Recorded::shards`].
    pub(super) shard: usize,
}

impl RecordedClip {
    pub(super) fn has_motion(&self) -> bool {
        !self.content.is_empty()
    }
}

/// The files of one shard: its motions, and their markers and features.
pub(super) struct RecordedShard {
    pub(super) split: Split,
    pub(super) files: Vec<(&'static str, FileEntry)>,
}

impl Recorded {
    /// Reads what a version of the dataset holds, without its frames; none if it has no table of motions.
    fn read(root: &Path, base: &Manifest) -> Result<Option<Self>, Error> {
        if !base.tables.contains_key(MotionRow::TABLE) {
            return Ok(None);
        }
        let sources = base.facts.get(SOURCES_FACT);
        let mut recorded = Self {
            sources: sources
                .and_then(|text| serde_json::from_str(text).ok())
                .unwrap_or_default(),
            quarantine: rows(root, base)?,
            skipped: rows(root, base)?,
            ..Self::default()
        };
        let mut shards: BTreeMap<&str, RecordedShard> = BTreeMap::new();
        for table in CLIP_TABLES {
            for file in base.tables.get(table).into_iter().flatten() {
                let Some(split) = file.split else { continue };
                let name = file.path.rsplit('/').next().unwrap_or(&file.path);
                let shard = shards.entry(name).or_insert_with(|| RecordedShard {
                    split,
                    files: Vec::new(),
                });
                shard.files.push((table, file.clone()));
            }
        }
        recorded.shards = shards.into_values().collect();
        for (index, shard) in recorded.shards.iter().enumerate() {
            recorded.clips.extend(clips_of(root, shard, index)?);
        }
        recorded.clips.sort_by(|a, b| a.id.cmp(&b.id));
        Ok(Some(recorded))
    }

    /// Hash of every source file by its path.
    pub(super) fn hashes(&self) -> BTreeMap<String, String> {
        let clips = self.clips.iter().map(|clip| (&clip.path, &clip.hash));
        let rejected = self
            .quarantine
            .iter()
            .map(|row| (&row.path, &row.source_hash));
        let skipped = self.skipped.iter().map(|row| (&row.path, &row.source_hash));
        clips
            .chain(rejected)
            .chain(skipped)
            .filter(|(_, hash)| !hash.is_empty())
            .map(|(path, hash)| (path.clone(), hash.clone()))
            .collect()
    }
}

fn rows<R: Row>(root: &Path, base: &Manifest) -> Result<Vec<R>, Error> {
    let mut rows = Vec::new();
    for file in base.tables.get(R::TABLE).into_iter().flatten() {
        rows.extend(read_rows::<R>(&root.join(&file.path))?);
    }
    Ok(rows)
}

/// The clips of a shard, and its captures without a motion.
fn clips_of(root: &Path, shard: &RecordedShard, index: usize) -> Result<Vec<RecordedClip>, Error> {
    let mut clips = Vec::new();
    let mut met = BTreeSet::new();
    for (table, file) in &shard.files {
        let path = root.join(&file.path);
        let reader = ShardReader::open(&path)?;
        let (ids, columns): (Vec<MotionId>, [Vec<String>; 4]) = match *table {
            MotionRow::TABLE => {
                let text = |name| reader.column::<MotionRow, String>(name);
                let ids = reader.column::<MotionRow, MotionId>("id")?;
                // Datasets of older formats lack the column, so that their clips are read again.
                let inputs = text("inputs_hash").unwrap_or_else(|_| vec![String::new(); ids.len()]);
                let columns = [
                    text("source_path")?,
                    text("source_hash")?,
                    inputs,
                    text("content_hash")?,
                ];
                (ids, columns)
            }
            MarkerRow::TABLE => {
                let text = |name| reader.column::<MarkerRow, String>(name);
                let ids = reader.column::<MarkerRow, MotionId>("id")?;
                let none = vec![String::new(); ids.len()];
                let columns = [
                    text("source_path")?,
                    text("source_hash")?,
                    none.clone(),
                    none,
                ];
                (ids, columns)
            }
            _ => continue,
        };
        let [paths, hashes, inputs, contents] = columns;
        let columns = paths.into_iter().zip(hashes).zip(inputs).zip(contents);
        for (id, (((path, hash), inputs), content)) in ids.into_iter().zip(columns) {
            // The markers of a clip with a motion have its id.
            if met.insert(id.clone()) {
                clips.push(RecordedClip {
                    id,
                    split: shard.split,
                    path,
                    hash,
                    inputs,
                    content,
                    shard: index,
                });
            }
        }
    }
    Ok(clips)
}

/// The settings that a dataset's clips were read with, by name; none where they are not recorded.
pub(crate) fn recorded_settings(dataset: &Dataset) -> BTreeMap<String, String> {
    let text = dataset.manifest().facts.get(SETTINGS_FACT);
    text.and_then(|text| serde_json::from_str(text).ok())
        .unwrap_or_default()
}

/// Facts of two merged datasets: those on which they agree, and the sources of both. Also returns what the
/// paths of the second begin with.
pub(crate) fn merged_facts(
    first: &Dataset,
    second: &Dataset,
) -> (BTreeMap<String, String>, String) {
    let (a, b) = (&first.manifest().facts, &second.manifest().facts);
    let mut facts: BTreeMap<String, String> = a
        .iter()
        .filter(|(name, value)| match b.get(*name) {
            _ if *name == SEED_FACT => true,
            Some(other) if *name == SETTINGS_FACT => Settings::read_alike(value, other),
            other => other == Some(value),
        })
        .map(|(name, value)| (name.clone(), value.clone()))
        .collect();
    let sources = |facts: &BTreeMap<String, String>| -> Vec<SourceLabel> {
        let text = facts.get(SOURCES_FACT);
        text.and_then(|text| serde_json::from_str(text).ok())
            .unwrap_or_default()
    };
    let mut all = sources(a);
    let name = second
        .root()
        .file_name()
        .unwrap_or_default()
        .to_string_lossy();
    let numbered = (2..).map(|number| format!("{name}-{number}"));
    let mut candidates = std::iter::once(name.clone().into_owned()).chain(numbered);
    let is_free = |label: &String| !all.iter().any(|source| lies_in(label, &source.label, &[]));
    let label = candidates.find(is_free).expect("numbers do not end");
    all.extend(sources(b).into_iter().map(|source| SourceLabel {
        label: match source.label.as_str() {
            "" => label.clone(),
            own => labelled(&label, own),
        },
        ..source
    }));
    let text = serde_json::to_string(&all).expect("texts serialise");
    facts.insert(SOURCES_FACT.to_owned(), text);
    (facts, label)
}
