//! Merges two datasets.

mod labels;
mod part;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use datasets_spec::dataset::{Commit, ShardName, table_facts};
use datasets_spec::license::{self, LICENSES_FACT};
use datasets_spec::manifest::{
    Accounting, FileEntry, REJECTED_MASKS_FACT, REJECTED_PAIRS_FACT, plan_hash,
};
use datasets_spec::record::{HumanMl3dRow, MarkerRow, MotionRow, QuarantineRow, SkippedRow};
use datasets_spec::table::{Caption, PartCaption, Row, ShardReader, read_rows};
use datasets_spec::{Dataset, MotionId, Progress, Skeleton, Split, Transaction};
use serde::Serialize;

use self::labels::{labels, rejected};
use self::part::Part;
use crate::Error;
use crate::clip_table::{CLIP_TABLES, ClipRow};
use crate::facts::json;
use crate::ingest::{MergedSources, recorded_settings, with_label};
use crate::recordings::{Clip, Origin, Prefixes, Recording, clips, grouped, sketches, unite_alike};
use crate::versions::{Labels, composed};

/// Result of [`merge`].
#[derive(Clone, Debug, Serialize)]
pub struct Merged {
    /// Clips of the result.
    pub clips: u64,
    /// Clips of the second dataset that the first has too: same id, same motion.
    pub shared: Vec<String>,
    /// Of these clips, those whose description in the second dataset was lost, by the field in which the datasets differ.
    pub differing: BTreeMap<&'static str, Vec<String>>,
    /// New ids of clips of the second dataset, by their old ids, under which the first has another motion.
    pub renamed: BTreeMap<String, String>,
    /// Clips of the second dataset whose split changed, because the first dataset has clips of the same recording: of
    /// the same file or clip, or with nearly the same motion.
    pub moved: BTreeMap<String, Split>,
    /// Warning about mixed licences, if there is one.
    pub license_warning: Option<String>,
    /// Ids of pairs that were dropped, because their motions are in two splits now.
    pub dropped_labels: Vec<String>,
    /// Numbers of automatic masks and pairs of clips of both datasets that gave way to labels of the other dataset, by
    /// table.
    pub gave_way: BTreeMap<String, u64>,
    /// New ids of masks and pairs of the second dataset, by table and by their old ids, under which the first has
    /// another label. Only tables with such labels are there.
    pub renamed_labels: BTreeMap<&'static str, BTreeMap<String, String>>,
    /// Tables of either dataset that the result does not contain: what stages made of all clips.
    pub left_tables: Vec<String>,
    /// Ids of pairs and masks that were dropped, because people rejected them in one of the datasets and nobody accepted
    /// them.
    pub rejected: Vec<String>,
    /// Hash of the result.
    pub root_hash: String,
}

/// What a merge does with clips that both datasets have and describe differently.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Differing {
    /// The merge is refused.
    Refuse,
    /// The description of the first dataset is taken, and that of the second is lost.
    TakeFirst,
}

/// Merges `second` into a copy of `first` and commits the result at `out`, a new folder. All clips of the
/// first keep their ids and splits, and their labels except automatic ones that give way to those of people. What people
/// rejected in either stays rejected.
///
/// # Errors
/// The datasets differ in their skeleton, rate, resampling or features, or with [`Differing::Refuse`] in what they say of
/// a clip of both, `out` is a dataset already, or reading or
/// writing fails.
pub fn merge(
    first: &Path,
    second: &Path,
    out: &Path,
    differing: Differing,
    holder: &str,
    progress: &dyn Progress,
) -> Result<Merged, Error> {
    let datasets = [Dataset::open(first)?, Dataset::open(second)?];
    let [a, b] = &datasets;
    datasets.iter().try_for_each(check_motions)?;
    let skeleton = common_skeleton(a, b)?;
    let clips = [clips(a)?, clips(b)?];
    check_settings(&datasets, &clips)?;
    let transaction = Transaction::begin(out, holder)?;
    if transaction.base().is_some() {
        return Err(Error::dataset_exists(out));
    }
    let sources = MergedSources::of(a, b)?;
    let mut facts = sources.facts.clone();
    let base = Part::new(a, 0, &sources, "");
    let added = added(&datasets, &clips, &sources)?;
    let differing_clips = differing_clips(&datasets, &added.shared)?;
    if differing == Differing::Refuse && !differing_clips.is_empty() {
        return Err(refused_for(&differing_clips));
    }
    let hashes = [a, b].map(|dataset| &dataset.manifest().root_hash);
    let plan = plan_hash("merge", &(hashes[0], hashes[1], &added.label));
    let shard_facts = table_facts(&skeleton, &plan);
    let parts = [&base, &added];
    let mut tables = clip_tables(&transaction, &parts, &shard_facts, progress)?;
    let motions = tables.get(MotionRow::TABLE).into_iter().flatten();
    let licenses = license::count(transaction.root(), motions)?;
    facts.insert(LICENSES_FACT.to_owned(), json(&licenses));
    let splits = splits(&parts, &clips);
    let (pairs, masks) = rejected(&parts)?;
    let labels = labels(&parts, &splits, &pairs, &masks)?;
    if !pairs.is_empty() {
        facts.insert(REJECTED_PAIRS_FACT.to_owned(), json(&pairs));
    }
    if !masks.is_empty() {
        facts.insert(REJECTED_MASKS_FACT.to_owned(), json(&masks));
    }
    let rows = &labels.rows;
    tables.extend(rows.write(&Labels::default(), &transaction, &skeleton, &plan)?);
    let num_clips = splits.len() as u64;
    let accounting = passed_over(parts, num_clips, &transaction, &shard_facts, &mut tables)?;
    let store = transaction.store();
    let places = sources.places(store.as_ref(), [first, second])?;
    places.write(store.as_ref(), transaction.root())?;
    let dataset = transaction.commit(Commit {
        tables,
        plan_hash: plan,
        skeleton,
        accounting: Some(accounting),
        facts,
        ..Commit::default()
    })?;
    progress.finish(&format!("{num_clips} clips{}", labels.says()));
    let moved = added.splits.iter();
    let moved = moved.map(|(id, split)| (added.id(id).to_string(), *split));
    let names = |(from, to): (&MotionId, &MotionId)| (from.to_string(), to.to_string());
    Ok(Merged {
        clips: num_clips,
        shared: added.shared.iter().map(ToString::to_string).collect(),
        differing: differing_clips,
        renamed: added.ids.iter().map(names).collect(),
        moved: moved.collect(),
        license_warning: license::warning(&licenses),
        dropped_labels: labels.parted,
        gave_way: labels.gave_way,
        renamed_labels: labels.renamed,
        left_tables: BTreeSet::from_iter([composed(a), composed(b)].concat())
            .into_iter()
            .collect(),
        rejected: labels.rejected.into_iter().collect(),
        root_hash: dataset.manifest().root_hash.clone(),
    })
}

/// Refuses a dataset without motions, such as a folder of items.
fn check_motions(dataset: &Dataset) -> Result<(), Error> {
    let tables = &dataset.manifest().tables;
    let mut of_clips = [MotionRow::TABLE, MarkerRow::TABLE].into_iter();
    if of_clips.any(|table| tables.contains_key(table)) {
        return Ok(());
    }
    let tables: Vec<&str> = tables.keys().map(String::as_str).collect();
    Err(Error::refused(format!(
        "{} holds no motions, only {}; merge joins datasets of motions",
        dataset.root().display(),
        tables.join(", ")
    )))
}

/// Writes the tables of what the datasets quarantined and skipped, and counts all.
fn passed_over(
    parts: [&Part<'_>; 2],
    num_clips: u64,
    transaction: &Transaction,
    facts: &[(&str, String)],
    tables: &mut BTreeMap<String, Vec<FileEntry>>,
) -> Result<Accounting, Error> {
    let (mut quarantine, mut skipped) = (Vec::new(), Vec::new());
    for part in parts {
        part.passed_over(&mut quarantine, &mut skipped)?;
    }
    let files = transaction.write_shards(None, &quarantine, facts)?;
    tables.insert(QuarantineRow::TABLE.to_owned(), files);
    let files = transaction.write_shards(None, &skipped, facts)?;
    tables.insert(SkippedRow::TABLE.to_owned(), files);
    let codes = quarantine.into_iter().map(|row| row.code);
    Ok(Accounting::of(num_clips, skipped.len() as u64, codes))
}

fn common_skeleton(first: &Dataset, second: &Dataset) -> Result<Skeleton, Error> {
    let skeleton = first.skeleton()?;
    if skeleton.hash() != second.skeleton()?.hash() {
        return Err(Error::refused(format!(
            "the datasets are posed on different bodies: {} and {}; ingest one of them again with the --body-model of \
             the other",
            first.manifest().skeleton,
            second.manifest().skeleton
        )));
    }
    Ok(skeleton)
}

/// Refuses datasets that differ in a setting that must be the same for all clips of a dataset.
fn check_settings(datasets: &[Dataset; 2], clips: &[Vec<Clip>; 2]) -> Result<(), Error> {
    let recorded = [
        recorded_settings(&datasets[0])?,
        recorded_settings(&datasets[1])?,
    ];
    let of = |name: &str| {
        recorded
            .each_ref()
            .map(|settings| settings.get(name).cloned())
    };
    let rates = clips.iter().flatten().filter_map(|clip| clip.fps);
    let rates: BTreeSet<u32> = rates.map(f32::to_bits).collect();
    let [first, second] = of("fps");
    // If all rates are the clips' own, they may differ; a requested rate holds for all clips.
    let is_own = |rate: &Option<String>| rate.as_deref().is_none_or(|rate| rate == "native");
    let mut names = vec!["features"];
    if rates.len() > 1 && !(is_own(&first) && is_own(&second)) {
        names.push("fps");
    }
    if !(is_own(&first) && is_own(&second)) {
        names.push("resample");
    }
    let mut differing = Vec::new();
    for name in names {
        let [Some(first), Some(second)] = of(name) else {
            continue;
        };
        if first != second {
            let [a, b] = datasets.each_ref().map(|dataset| dataset.root().display());
            differing.push(format!("{name} is {first} in {a} and {second} in {b}"));
        }
    }
    match differing.is_empty() {
        true => Ok(()),
        false => Err(Error::refused(format!(
            "the datasets cannot be one: {}; ingest one of them again with the setting of the other",
            differing.join("; ")
        ))),
    }
}

/// The second dataset: which of its clips the first has, and the ids and splits of the others.
fn added<'a>(
    [first, second]: &'a [Dataset; 2],
    [known, own]: &[Vec<Clip>; 2],
    sources: &'a MergedSources,
) -> Result<Part<'a>, Error> {
    let by_id: BTreeMap<&MotionId, &Clip> =
        known.iter().map(|clip| (&clip.origin.id, clip)).collect();
    // Captures without a motion have no content; their files, where these are known, tell them apart.
    let is_same = |known: &Clip, content: &str, origin: &Origin| match content {
        "" => {
            let file = &origin.source_hash;
            known.content.is_empty() && !file.is_empty() && known.origin.source_hash == *file
        }
        content => known.content == content,
    };
    let mut part = Part::new(second, 1, sources, &sources.label);
    part.splits = moved([first, second], [known, own])?;
    let all = known.iter().chain(own);
    let mut taken: BTreeSet<MotionId> = all.map(|clip| clip.origin.id.clone()).collect();
    for Clip {
        origin, content, ..
    } in own
    {
        let id = &origin.id;
        match by_id.get(id) {
            Some(known) if is_same(known, content, origin) => {
                part.shared.insert(id.clone());
            }
            Some(_) => {
                let numbered = (2..).map(|number| format!("{}-{number}", sources.label));
                for label in std::iter::once(sources.label.clone()).chain(numbered) {
                    let new = with_label(&label, id.as_str());
                    let new = MotionId::parse(&new).map_err(|error| {
                        Error::refused(format!(
                            "{id} is another motion in the first dataset, and here it cannot be {new:?}: {error}; give the \
                             second dataset's folder a shorter name"
                        ))
                    })?;
                    if taken.insert(new.clone()) {
                        part.ids.insert(id.clone(), new);
                        break;
                    }
                }
            }
            None => {}
        }
    }
    for id in &part.shared {
        part.splits.remove(id);
    }
    Ok(part)
}

/// The clips of both datasets that these describe differently, by the column in which they differ.
fn differing_clips(
    datasets: &[Dataset; 2],
    shared: &BTreeSet<MotionId>,
) -> Result<BTreeMap<&'static str, Vec<String>>, Error> {
    let [first, second] = [
        described(&datasets[0], shared)?,
        described(&datasets[1], shared)?,
    ];
    let mut differing: BTreeMap<&'static str, Vec<String>> = BTreeMap::new();
    for (id, first) in first {
        let columns = DESCRIBING.iter().zip(first).zip(&second[&id]);
        for ((column, first), second) in columns {
            if first != *second {
                differing.entry(column).or_default().push(id.to_string());
            }
        }
    }
    Ok(differing)
}

/// Columns that describe a motion and do not follow from its content.
const DESCRIBING: [&str; 6] = [
    "captions",
    "part_captions",
    "subject",
    "action",
    "style",
    "license",
];

/// The values of [`DESCRIBING`] of some clips, as texts.
fn described(
    dataset: &Dataset,
    clips: &BTreeSet<MotionId>,
) -> Result<BTreeMap<MotionId, [String; 6]>, Error> {
    let mut described = BTreeMap::new();
    for (path, _) in dataset.files(MotionRow::TABLE, None) {
        let shard = ShardReader::open(&path)?;
        let ids: Vec<MotionId> = shard.column::<MotionRow, _>("id")?;
        let captions: Vec<Vec<Caption>> = shard.column::<MotionRow, _>("captions")?;
        let parts: Vec<Vec<PartCaption>> = shard.column::<MotionRow, _>("part_captions")?;
        let texts = ["subject", "action", "style", "license"]
            .map(|name| shard.column::<MotionRow, Option<String>>(name));
        let [subject, action, style, license] = texts;
        let texts = [subject?, action?, style?, license?];
        for (row, id) in ids.into_iter().enumerate() {
            if clips.contains(&id) {
                let [subject, action, style, license] =
                    texts.each_ref().map(|text| format!("{:?}", text[row]));
                let captions = format!("{:?}", captions[row]);
                let parts = format!("{:?}", parts[row]);
                described.insert(id, [captions, parts, subject, action, style, license]);
            }
        }
    }
    Ok(described)
}

fn refused_for(differing: &BTreeMap<&'static str, Vec<String>>) -> Error {
    let columns = differing
        .iter()
        .map(|(column, clips)| format!("{column} of {} (such as {})", clips.len(), clips[0]));
    Error::refused(format!(
        "the datasets describe common clips differently: {}; put the dataset whose descriptions you want first, and pass \
         --take-first: those of the other are lost",
        columns.collect::<Vec<_>>().join(", ")
    ))
}

/// Clips of the second dataset whose split changes, because the first has clips of the same recording.
fn moved(
    datasets: [&Dataset; 2],
    clips: [&Vec<Clip>; 2],
) -> Result<BTreeMap<MotionId, Split>, Error> {
    let mut recordings = Vec::new();
    let mut sketched = Vec::new();
    for (number, (dataset, clips)) in datasets.into_iter().zip(clips).enumerate() {
        let prefixes = Prefixes::of(dataset)?;
        let ids = clips.iter().enumerate();
        let places: BTreeMap<&MotionId, usize> = ids
            .map(|(place, clip)| (&clip.origin.id, recordings.len() + place))
            .collect();
        for (id, sketch) in sketches(dataset)? {
            sketched.extend(places.get(&id).map(|place| (*place, sketch)));
        }
        recordings.extend(clips.iter().map(|clip| {
            let mut recordings = clip.origin.recordings(&prefixes, number);
            if !clip.content.is_empty() {
                recordings.push(Recording::Motion(clip.content.clone()));
            }
            recordings
        }));
    }
    let mut groups = grouped(&recordings);
    unite_alike(&mut groups, sketched);
    let [known, own] = clips;
    let mut wanted: BTreeMap<usize, Vec<Split>> = BTreeMap::new();
    for (place, clip) in known.iter().enumerate() {
        wanted
            .entry(groups.of(place))
            .or_default()
            .push(clip.origin.split);
    }
    let mut moved = BTreeMap::new();
    for (place, clip) in own.iter().enumerate() {
        // Published splits of the first dataset may separate clips of a recording; then each of these splits is
        // allowed.
        let splits = wanted.get(&groups.of(known.len() + place));
        let splits = splits.filter(|splits| !splits.contains(&clip.origin.split));
        if let Some(split) = splits.and_then(|splits| splits.first()) {
            moved.insert(clip.origin.id.clone(), *split);
        }
    }
    Ok(moved)
}

fn clip_tables(
    transaction: &Transaction,
    parts: &[&Part<'_>],
    facts: &[(&str, String)],
    progress: &dyn Progress,
) -> Result<BTreeMap<String, Vec<FileEntry>>, Error> {
    progress.begin("merge", Some(CLIP_TABLES.len() as u64));
    let mut tables = BTreeMap::new();
    for table in CLIP_TABLES {
        let files = match table {
            MotionRow::TABLE => shards::<MotionRow>(transaction, parts, facts)?,
            MarkerRow::TABLE => shards::<MarkerRow>(transaction, parts, facts)?,
            _ => shards::<HumanMl3dRow>(transaction, parts, facts)?,
        };
        if table == MotionRow::TABLE || !files.is_empty() {
            tables.insert(table.to_owned(), files);
        }
        progress.advance(1);
    }
    Ok(tables)
}

fn splits(parts: &[&Part<'_>], clips: &[Vec<Clip>]) -> BTreeMap<MotionId, Split> {
    let mut splits: BTreeMap<MotionId, Split> = BTreeMap::new();
    for (part, clips) in parts.iter().zip(clips) {
        for Origin { id, split, .. } in clips.iter().map(|clip| &clip.origin) {
            let split = *part.splits.get(id).unwrap_or(split);
            splits.entry(part.id(id)).or_insert(split);
        }
    }
    splits
}

/// Writes a table of both datasets, with one shard for each of their shards and splits. Shards of markers and features
/// have the numbers of those of their motions.
fn shards<R: ClipRow>(
    transaction: &Transaction,
    parts: &[&Part<'_>],
    facts: &[(&str, String)],
) -> Result<Vec<FileEntry>, Error> {
    let mut names: Vec<(usize, &str)> = Vec::new();
    for (part, Part { dataset, .. }) in parts.iter().enumerate() {
        let files = CLIP_TABLES.map(|table| dataset.files(table, None));
        let files = files.iter().flatten();
        names.extend(files.map(|(_, file)| (part, file.name())));
    }
    names.sort();
    names.dedup();
    let mut entries = Vec::new();
    for (number, part) in parts.iter().enumerate() {
        for (path, file) in part.dataset.files(R::TABLE, None) {
            let place = (number, file.name());
            let index = names.iter().position(|name| *name == place).unwrap_or(0);
            let mut by_split: BTreeMap<Split, Vec<R>> = BTreeMap::new();
            for row in read_rows::<R>(&path)? {
                if let Some((split, row)) = part.take(row) {
                    by_split.entry(split).or_default().push(row);
                }
            }
            for (split, rows) in by_split {
                let name = ShardName {
                    table: R::TABLE,
                    split: Some(split),
                    index,
                    of: names.len(),
                };
                entries.push(transaction.write_shard(&name, &rows, facts)?);
            }
        }
    }
    Ok(entries)
}
