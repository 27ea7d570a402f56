//! Two datasets become one.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use datasets_spec::dataset::{Commit, ShardName, table_facts};
use datasets_spec::license::{self, LICENSES_FACT};
use datasets_spec::manifest::{Accounting, FileEntry, plan_hash};
use datasets_spec::record::{
    HumanMl3dRow, MarkerRow, MaskRow, MotionRow, PairRow, QuarantineRow, SkippedRow,
};
use datasets_spec::table::{Row, ShardReader, read_rows};
use datasets_spec::{Dataset, MotionId, Progress, Split, Transaction};
use serde::Serialize;

use crate::Error;
use crate::clip_table::{CLIP_TABLES, ClipRow};
use crate::ingest::{merged_facts, with_label};

/// What [`merge`] did.
#[derive(Clone, Debug, Serialize)]
pub struct Merged {
    /// Clips of the result.
    pub clips: u64,
    /// Clips of the second dataset that the first has too: same id, same motion.
    pub shared: Vec<String>,
    /// Clips of the second dataset that got another id, because the first has another motion under theirs.
    pub renamed: BTreeMap<String, String>,
    /// Clips of the second dataset that moved into the split of an equal motion of the first, or of the
    /// clip they share a source with.
    pub moved: BTreeMap<String, Split>,
    /// What mixing the licences of the two asks for, if anything.
    pub license_warning: Option<String>,
    /// Masks and pairs of the second dataset that name motions of two splits now.
    pub dropped_labels: Vec<String>,
    /// Hash of the result.
    pub root_hash: String,
}

/// A dataset that takes part, and what becomes of the ids and splits of its clips.
struct Part<'a> {
    dataset: &'a Dataset,
    /// What its paths begin with in the result.
    label: String,
    /// Clips that the other has.
    shared: BTreeSet<MotionId>,
    ids: BTreeMap<MotionId, MotionId>,
    splits: BTreeMap<MotionId, Split>,
}

impl Part<'_> {
    fn id(&self, id: &MotionId) -> MotionId {
        self.ids.get(id).unwrap_or(id).clone()
    }

    fn path(&self, path: &str) -> String {
        with_label(&self.label, path)
    }

    /// The row and its split in the result; none if the other dataset has the clip.
    fn take<R: ClipRow>(&self, mut row: R) -> Option<(Split, R)> {
        if self.shared.contains(row.id()) {
            return None;
        }
        if let Some(path) = row.source_path() {
            *path = self.path(path);
        }
        if let Some(mirrored) = row.mirrored_of()
            && let Ok(id) = MotionId::parse(mirrored)
        {
            *mirrored = self.id(&id).to_string();
        }
        let split = *self.splits.get(row.id()).unwrap_or(&row.split());
        row.place(self.id(row.id()), split);
        Some((split, row))
    }
}

/// Id, split and content of every clip. Captures without a motion have no content.
fn clips(dataset: &Dataset) -> Result<Vec<(MotionId, Split, String)>, Error> {
    let mut clips = Vec::new();
    for (path, file) in dataset.files(MotionRow::TABLE, None) {
        let shard = ShardReader::open(&path)?;
        let ids = shard.column::<MotionRow, MotionId>("id")?;
        let contents = shard.column::<MotionRow, String>("content_hash")?;
        let split = file.split.unwrap_or(Split::Train);
        let rows = ids.into_iter().zip(contents);
        clips.extend(rows.map(|(id, content)| (id, split, content)));
    }
    let known: BTreeSet<MotionId> = clips.iter().map(|(id, ..)| id.clone()).collect();
    for (path, file) in dataset.files(MarkerRow::TABLE, None) {
        let ids = ShardReader::open(&path)?.column::<MarkerRow, MotionId>("id")?;
        let split = file.split.unwrap_or(Split::Train);
        let alone = ids.into_iter().filter(|id| !known.contains(id));
        clips.extend(alone.map(|id| (id, split, String::new())));
    }
    Ok(clips)
}

/// Merges `second` into a copy of `first` and commits the result at `out`, a new folder. All clips of the
/// first keep their ids, splits and labels.
///
/// # Errors
/// The datasets differ in their skeleton, `out` is a dataset already, or reading or writing fails.
pub fn merge(
    first: &Path,
    second: &Path,
    out: &Path,
    holder: &str,
    progress: &dyn Progress,
) -> Result<Merged, Error> {
    let datasets = [Dataset::open(first)?, Dataset::open(second)?];
    let [a, b] = &datasets;
    let skeleton = a.skeleton()?;
    if skeleton.hash() != b.skeleton()?.hash() {
        return Err(Error::OtherSkeleton {
            first: a.manifest().skeleton.clone(),
            second: b.manifest().skeleton.clone(),
        });
    }
    let transaction = Transaction::begin(out, holder)?;
    if transaction.base().is_some() {
        return Err(Error::DatasetExists {
            path: out.to_owned(),
        });
    }
    let (mut facts, label) = merged_facts(a, b);
    let base = Part {
        dataset: a,
        label: String::new(),
        shared: BTreeSet::new(),
        ids: BTreeMap::new(),
        splits: BTreeMap::new(),
    };
    let added = added(&base, b, label)?;
    let plan = plan_hash(
        "merge",
        &(
            &a.manifest().root_hash,
            &b.manifest().root_hash,
            &added.label,
        ),
    );
    let shard_facts = table_facts(&skeleton, &plan);
    let mut tables = BTreeMap::new();
    let parts = [&base, &added];
    progress.begin("merge", Some(CLIP_TABLES.len() as u64));
    let motions = shards::<MotionRow>(&transaction, &parts, &shard_facts)?;
    progress.advance(1);
    let markers = shards::<MarkerRow>(&transaction, &parts, &shard_facts)?;
    progress.advance(1);
    let features = shards::<HumanMl3dRow>(&transaction, &parts, &shard_facts)?;
    progress.advance(1);
    let licenses = license::count(transaction.root(), motions.iter())?;
    let text = serde_json::to_string(&licenses).expect("texts and counts serialise");
    facts.insert(LICENSES_FACT.to_owned(), text);
    tables.insert(MotionRow::TABLE.to_owned(), motions);
    for (table, files) in [(MarkerRow::TABLE, markers), (HumanMl3dRow::TABLE, features)] {
        if !files.is_empty() {
            tables.insert(table.to_owned(), files);
        }
    }
    let mut splits: BTreeMap<MotionId, Split> = BTreeMap::new();
    for part in parts {
        for (id, split, _) in clips(part.dataset)? {
            let split = *part.splits.get(&id).unwrap_or(&split);
            splits.entry(part.id(&id)).or_insert(split);
        }
    }
    let labels = labels(&parts, &splits)?;
    let mut add = |table: &str, files: Vec<_>, rows: usize| {
        if rows > 0 {
            tables.insert(table.to_owned(), files);
        }
    };
    let mask_split: fn(&MaskRow) -> Split = |row| row.split;
    let pair_split: fn(&PairRow) -> Split = |row| row.split;
    add(
        MaskRow::TABLE,
        transaction.write_rows(&labels.masks, Some(mask_split), &skeleton, &plan)?,
        labels.masks.len(),
    );
    add(
        PairRow::TABLE,
        transaction.write_rows(&labels.pairs, Some(pair_split), &skeleton, &plan)?,
        labels.pairs.len(),
    );
    let mut quarantine: Vec<QuarantineRow> = Vec::new();
    let mut skipped: Vec<SkippedRow> = Vec::new();
    for part in parts {
        let rows = part.dataset.read::<QuarantineRow>(None)?.into_iter();
        quarantine.extend(rows.map(|row| QuarantineRow {
            path: part.path(&row.path),
            ..row
        }));
        let rows = part.dataset.read::<SkippedRow>(None)?.into_iter();
        skipped.extend(rows.map(|row| SkippedRow {
            path: part.path(&row.path),
            ..row
        }));
        skipped.extend(part.shared.iter().map(|id| SkippedRow {
            path: part.path(id.as_str()),
            source_hash: String::new(),
            inputs_hash: String::new(),
            reason: "clip of both merged datasets".to_owned(),
        }));
    }
    let mut codes = BTreeMap::new();
    for row in &quarantine {
        *codes.entry(row.code.clone()).or_default() += 1;
    }
    let [num_clips, quarantined, passed_over] =
        [splits.len(), quarantine.len(), skipped.len()].map(|count| count as u64);
    tables.insert(
        QuarantineRow::TABLE.to_owned(),
        transaction.write_shards(None, &quarantine, &shard_facts)?,
    );
    tables.insert(
        SkippedRow::TABLE.to_owned(),
        transaction.write_shards(None, &skipped, &shard_facts)?,
    );
    let dataset = transaction.commit(Commit {
        tables,
        plan_hash: plan,
        skeleton,
        accounting: Some(Accounting {
            sources: num_clips + quarantined + passed_over,
            ingested: num_clips,
            quarantined,
            skipped: passed_over,
            codes,
        }),
        facts,
        ..Commit::default()
    })?;
    progress.finish(&format!("{num_clips} clips"));
    let names = |(from, to): (&MotionId, &MotionId)| (from.to_string(), to.to_string());
    Ok(Merged {
        clips: num_clips,
        shared: added.shared.iter().map(ToString::to_string).collect(),
        renamed: added.ids.iter().map(names).collect(),
        moved: added
            .splits
            .iter()
            .map(|(id, split)| (added.id(id).to_string(), *split))
            .collect(),
        license_warning: license::warning(&licenses),
        dropped_labels: labels.dropped,
        root_hash: dataset.manifest().root_hash.clone(),
    })
}

/// The second dataset: which of its clips the first has, and the ids and splits of the others.
fn added<'a>(base: &Part<'_>, dataset: &'a Dataset, label: String) -> Result<Part<'a>, Error> {
    let known = clips(base.dataset)?;
    let by_id: BTreeMap<&MotionId, &str> = known
        .iter()
        .map(|(id, _, content)| (id, content.as_str()))
        .collect();
    let mut of_content: BTreeMap<&str, Split> = BTreeMap::new();
    for (_, split, content) in known.iter().filter(|(_, _, content)| !content.is_empty()) {
        of_content.entry(content).or_insert(*split);
    }
    let own = clips(dataset)?;
    let mut part = Part {
        dataset,
        label,
        shared: BTreeSet::new(),
        ids: BTreeMap::new(),
        splits: BTreeMap::new(),
    };
    let mut taken: BTreeSet<MotionId> = known
        .iter()
        .chain(&own)
        .map(|(id, ..)| id.clone())
        .collect();
    // All that is made of one source clip moves together.
    let mut moves: BTreeMap<&str, Split> = BTreeMap::new();
    for (id, _, content) in &own {
        match by_id.get(id) {
            Some(known) if known == content => {
                part.shared.insert(id.clone());
            }
            Some(_) => {
                let numbered = (1..).map(|number| match number {
                    1 => with_label(&part.label, id.as_str()),
                    number => with_label(&format!("{}-{number}", part.label), id.as_str()),
                });
                let mut free = numbered.filter_map(|id| MotionId::parse(&id).ok());
                let new = free.find(|id| taken.insert(id.clone()));
                part.ids
                    .insert(id.clone(), new.expect("numbers do not end"));
            }
            None => {}
        }
        if let Some(split) = of_content.get(content.as_str()) {
            moves.entry(id.source_clip()).or_insert(*split);
        }
    }
    for (id, split, _) in &own {
        let wanted = moves.get(id.source_clip()).copied();
        if let Some(wanted) = wanted.filter(|wanted| wanted != split) {
            part.splits.insert(id.clone(), wanted);
        }
    }
    Ok(part)
}

/// The labels of both datasets, and the ids of those whose motions are in two splits now.
struct Labels {
    masks: Vec<MaskRow>,
    pairs: Vec<PairRow>,
    dropped: Vec<String>,
}

fn labels(parts: &[&Part<'_>], splits: &BTreeMap<MotionId, Split>) -> Result<Labels, Error> {
    let mut masks: BTreeMap<String, MaskRow> = BTreeMap::new();
    let mut pairs: BTreeMap<String, PairRow> = BTreeMap::new();
    let mut dropped = Vec::new();
    for part in parts {
        for mut mask in part.dataset.read::<MaskRow>(None)? {
            mask.motion_id = part.id(&mask.motion_id);
            mask.split = *splits.get(&mask.motion_id).unwrap_or(&mask.split);
            insert(&mut masks, mask, &part.label, |mask| &mut mask.id);
        }
        for mut pair in part.dataset.read::<PairRow>(None)? {
            pair.source_id = part.id(&pair.source_id);
            pair.target_id = part.id(&pair.target_id);
            let split = splits.get(&pair.target_id).copied();
            if split != splits.get(&pair.source_id).copied() {
                dropped.push(pair.id);
                continue;
            }
            pair.split = split.unwrap_or(pair.split);
            insert(&mut pairs, pair, &part.label, |pair| &mut pair.id);
        }
    }
    Ok(Labels {
        masks: masks.into_values().collect(),
        pairs: pairs.into_values().collect(),
        dropped,
    })
}

/// Adds a row under its id. Where another row has that id, the row gets one with the label of its dataset.
fn insert<R: PartialEq>(
    rows: &mut BTreeMap<String, R>,
    mut row: R,
    label: &str,
    id: fn(&mut R) -> &mut String,
) {
    let own = id(&mut row).clone();
    let mut numbers = 2..;
    let mut candidate = own.clone();
    while rows.get(&candidate).is_some_and(|other| *other != row) {
        candidate = match id(&mut row) == &own {
            true => format!("{own} ({label})"),
            false => format!(
                "{own} ({label} {})",
                numbers.next().expect("numbers do not end")
            ),
        };
        id(&mut row).clone_from(&candidate);
    }
    rows.insert(candidate, row);
}

/// Writes a table of both datasets, a shard for each of theirs and split.
fn shards<R: ClipRow>(
    transaction: &Transaction,
    parts: &[&Part<'_>],
    facts: &[(&str, String)],
) -> Result<Vec<FileEntry>, Error> {
    let files: Vec<_> = parts
        .iter()
        .flat_map(|part| {
            let files = part.dataset.files(R::TABLE, None).into_iter();
            files.map(move |(path, _)| (part, path))
        })
        .collect();
    let mut entries = Vec::new();
    for (index, (part, path)) in files.iter().enumerate() {
        let mut by_split: BTreeMap<Split, Vec<R>> = BTreeMap::new();
        for row in read_rows::<R>(path)? {
            if let Some((split, row)) = part.take(row) {
                by_split.entry(split).or_default().push(row);
            }
        }
        for (split, rows) in by_split {
            let name = ShardName {
                table: R::TABLE,
                split: Some(split),
                index,
                of: files.len(),
            };
            entries.push(transaction.write_shard(&name, &rows, facts)?);
        }
    }
    Ok(entries)
}
