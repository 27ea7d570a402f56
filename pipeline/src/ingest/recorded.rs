//! Recorded sources and clips of an existing dataset.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use clip::LabelProblem;
use datasets_spec::manifest::{ANNOTATE_FACTS, FileEntry, Manifest};
use datasets_spec::record::{HumanMl3dRow, MaskRow, MotionRow, PairRow, QuarantineRow, SkippedRow};
use datasets_spec::store::Store;
use datasets_spec::table::{Row, ShardReader, read_rows};
use datasets_spec::{Dataset, MotionId, Split};

use super::list::labelled;
use super::options::{LABEL_PROBLEMS_FACT, PAIRS_FACT, SEED_FACT, SETTINGS_FACT, Settings};
use super::places::Places;
use super::sources::{SOURCES_FACT, SourceLabel, UNNAMED, below, of_path, with_names};
use crate::Error;
use crate::clip_table::{CLIP_TABLES, ClipFacts};
use crate::facts::json;
use crate::names::free;

/// Why a clip of the second of two merged datasets is skipped: the first has it. The path of its row ends in its id.
pub(super) const IN_BOTH: &str = "clip of both merged datasets";

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
    /// Reads the version that a run starts from, of the dataset at `root`; `None` if it has no motions.
    pub(super) fn read(root: &Path, base: Option<&Manifest>) -> Result<Option<Self>, Error> {
        let Some(base) = base.filter(|base| base.tables.contains_key(MotionRow::TABLE)) else {
            return Ok(None);
        };
        Ok(Some(Self {
            recorded: Recorded::read(root, base)?,
            settings: base.facts.get(SETTINGS_FACT).cloned(),
            pairs: base.facts.get(PAIRS_FACT).cloned(),
            masks: rows(root, base)?,
            label_pairs: rows(root, base)?,
            label_problems: base.fact(LABEL_PROBLEMS_FACT)?,
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

/// A clip, or a capture that has only markers, which earlier versions kept.
#[derive(Clone, Debug)]
pub(super) struct RecordedClip {
    pub(super) id: MotionId,
    pub(super) split: Split,
    /// Index of the clip's source in [`Recorded::sources`].
    pub(super) source: usize,
    pub(super) path: String,
    pub(super) hash: String,
    /// Hash of all files that the clip was read from; empty for captures without a motion, and in datasets of older
    /// formats.
    pub(super) inputs: String,
    /// Hash of the motion; empty for captures without one.
    pub(super) content: String,
    pub(super) num_frames: i32,
    /// Columns `centre_x` to `centre_z`; `None` in files of older formats.
    pub(super) centre: Option<[f32; 3]>,
    /// Index of the clip's shard in [`Recorded::shards`].
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
    /// Reads what a version of the dataset holds, without its frames.
    fn read(root: &Path, base: &Manifest) -> Result<Self, Error> {
        let mut recorded = Self {
            sources: with_names(base.fact(SOURCES_FACT)?),
            quarantine: rows(root, base)?,
            skipped: rows(root, base)?,
            ..Self::default()
        };
        let mut shards: BTreeMap<&str, RecordedShard> = BTreeMap::new();
        for table in CLIP_TABLES {
            for file in base.tables.get(table).into_iter().flatten() {
                let Some(split) = file.split else { continue };
                let shard = shards.entry(file.name()).or_insert_with(|| RecordedShard {
                    split,
                    files: Vec::new(),
                });
                shard.files.push((table, file.clone()));
            }
        }
        recorded.shards = shards.into_values().collect();
        let mut sources = Sources(recorded.sources);
        for (index, shard) in recorded.shards.iter().enumerate() {
            let clips = clips_of(root, shard, index, &mut sources)?;
            recorded.clips.extend(clips);
        }
        recorded.clips.sort_by(|a, b| a.id.cmp(&b.id));
        for row in &mut recorded.quarantine {
            row.source_name = sources.name_of(&row.source_name, &row.path);
        }
        for row in &mut recorded.skipped {
            row.source_name = sources.name_of(&row.source_name, &row.path);
        }
        recorded.sources = sources.0;
        Ok(recorded)
    }

    /// Paths of the files of all clips.
    pub(super) fn paths(&self) -> BTreeSet<&str> {
        self.clips.iter().map(|clip| clip.path.as_str()).collect()
    }
}

/// Looks up the source of a row, by its recorded name or, in older datasets, by the prefix of its path.
struct Sources(Vec<SourceLabel>);

impl Sources {
    /// The source of a row with this name and path. Rows of older formats have no name; their path determines the
    /// source.
    fn index_of(&mut self, name: &str, path: &str) -> usize {
        let named = self.0.iter().position(|source| source.name == name);
        if let Some(index) = named.or_else(|| of_path(&self.0, path)) {
            return index;
        }
        let is_free = |name: &str| self.0.iter().all(|source| source.name != name);
        self.0.push(SourceLabel {
            label: String::new(),
            name: free(UNNAMED, is_free),
        });
        self.0.len() - 1
    }

    fn name_of(&mut self, name: &str, path: &str) -> String {
        let index = self.index_of(name, path);
        self.0[index].name.clone()
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
fn clips_of(
    root: &Path,
    shard: &RecordedShard,
    index: usize,
    sources: &mut Sources,
) -> Result<Vec<RecordedClip>, Error> {
    let mut clips = Vec::new();
    let mut met = BTreeSet::new();
    for (table, file) in &shard.files {
        if *table == HumanMl3dRow::TABLE {
            continue;
        }
        let rows: Vec<ClipFacts> = ShardReader::open(&root.join(&file.path))?.rows()?;
        for row in rows {
            // The markers of a clip have its id, so they are no further clip.
            if met.insert(row.id.clone()) {
                clips.push(RecordedClip {
                    split: shard.split,
                    source: sources.index_of(&row.source_name, &row.source_path),
                    centre: row.centre(),
                    id: row.id,
                    path: row.source_path,
                    hash: row.source_hash,
                    inputs: row.inputs_hash,
                    content: row.content_hash,
                    num_frames: row.n_frames,
                    shard: index,
                });
            }
        }
    }
    Ok(clips)
}

/// The settings that a dataset's clips were read with, by name; empty if they are not recorded.
pub(crate) fn recorded_settings(dataset: &Dataset) -> Result<BTreeMap<String, String>, Error> {
    Ok(dataset.manifest().fact(SETTINGS_FACT)?)
}

/// Sources of two datasets after a merge.
pub(crate) struct MergedSources {
    /// Facts of the result: those on which the two agree, and the sources of both.
    pub(crate) facts: BTreeMap<String, String>,
    /// Prefix of the second dataset's paths in the result.
    pub(crate) label: String,
    names: [SourceNames; 2],
}

/// Names of the sources of a dataset in the result of a merge.
struct SourceNames {
    sources: Vec<SourceLabel>,
    renamed: BTreeMap<String, String>,
}

impl MergedSources {
    /// Joins the sources of two datasets. Those of the second keep their names unless the first has them.
    pub(crate) fn of(first: &Dataset, second: &Dataset) -> Result<Self, Error> {
        let (a, b) = (&first.manifest().facts, &second.manifest().facts);
        let facts = a.iter().filter(|(name, value)| match b.get(*name) {
            _ if *name == SEED_FACT => true,
            // The clips of the first dataset keep their ids, so the annotation project of that dataset goes on.
            None if name.starts_with(ANNOTATE_FACTS) => true,
            Some(other) if *name == SETTINGS_FACT => Settings::read_alike(value, other),
            other => other == Some(value),
        });
        let mut facts: BTreeMap<String, String> = facts
            .map(|(name, value)| (name.clone(), value.clone()))
            .collect();
        let sources = |of: &Dataset| Ok::<_, Error>(with_names(of.manifest().fact(SOURCES_FACT)?));
        let (own, mut others) = (sources(first)?, sources(second)?);
        if others.is_empty() {
            others.push(SourceLabel {
                label: String::new(),
                name: UNNAMED.to_owned(),
            });
        }
        let folder = second.root().file_name().unwrap_or_default();
        let folder = folder.to_string_lossy().into_owned();
        let is_free = |label: &str| {
            !own.iter()
                .any(|source| below(label, &source.label).is_some())
        };
        let label = free(&folder, is_free);
        let mut all = own.clone();
        let mut renamed = BTreeMap::new();
        for source in &others {
            let is_free = |name: &str| all.iter().all(|other| other.name != name);
            let name = match is_free(&source.name) {
                true => source.name.clone(),
                false => free(&format!("{label}-{}", source.name), is_free),
            };
            renamed.insert(source.name.clone(), name.clone());
            let label = match source.label.as_str() {
                "" => label.clone(),
                own => labelled(&label, own),
            };
            all.push(SourceLabel { label, name });
        }
        facts.insert(SOURCES_FACT.to_owned(), json(&all));
        let names = [(own, BTreeMap::new()), (others, renamed)];
        let names = names.map(|(sources, renamed)| SourceNames { sources, renamed });
        Ok(Self {
            facts,
            label,
            names,
        })
    }

    /// Name that the source of a row has in the result. `part` is 0 for the first dataset and 1 for the second; `name`
    /// and `path` are the row's values in that dataset.
    pub(crate) fn name(&self, part: usize, name: &str, path: &str) -> String {
        let SourceNames { sources, renamed } = &self.names[part];
        let name = match name {
            "" => of_path(sources, path).map_or("", |index| sources[index].name.as_str()),
            name => name,
        };
        renamed.get(name).map_or(name, String::as_str).to_owned()
    }

    /// The row of a clip of the second dataset that the first has too: its source, when it is ingested into the result,
    /// does not add the clip again.
    pub(crate) fn shared_row(&self, clip: ClipFacts) -> SkippedRow {
        let path = labelled(&self.label, &clip.source_path);
        SkippedRow {
            path: format!("{path}#{}", clip.id),
            source_name: self.name(1, &clip.source_name, &clip.source_path),
            source_hash: clip.source_hash,
            inputs_hash: clip.inputs_hash,
            reason: IN_BOTH.to_owned(),
        }
    }

    /// Where the sources of both were found.
    pub(crate) fn places(&self, store: &dyn Store, roots: [&Path; 2]) -> Result<Places, Error> {
        let mut places = Places::read(store, roots[0])?;
        places.extend(Places::read(store, roots[1])?, &self.names[1].renamed);
        Ok(places)
    }
}
