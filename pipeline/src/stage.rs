//! Stages from folder to folder: open the result of the stage before, do the work, commit the result.
//!
//! A stage does nothing if the same plan has already made its result.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::{Path, PathBuf};

use compose::{
    COMPOSED, ItemConfig, ItemCount, Novelty, Shown, digest_of_ids, draw_items, library,
};
use datasets_spec::dataset::{Commit, Transaction, commit_table, refuse_others, table_facts};
use datasets_spec::manifest::{REJECTED_MASKS_FACT, plan_hash};
use datasets_spec::record::{
    EditRow, ItemRow, MaskRow, MotionRow, PairRow, QuarantineRow, ScoreRow,
};
use datasets_spec::rejected::RejectedMasks;
use datasets_spec::table::{Row, ShardReader, read_column};
use datasets_spec::{Dataset, Fps, MotionId, Resample, Seed, Skeleton, Split};
use serde::{Deserialize, Serialize};
use tables::{Condition, chosen};
pub use work::Context;

use crate::Error;
use crate::annotation::masks::{self, Activity, LeftOut, MaskConfig};
use crate::annotation::pairs::{
    self, LabelledClip, PairConfig, PairList, RefusedLine, is_from_labels, new_pairs, style_pairs,
};
use crate::catalogue::other_than_motions;
use crate::facts::json;
use crate::ingest::{IngestOptions, SplitBy};

/// Number of clips whose frames are in memory while masks are made.
const CLIPS_AT_ONCE: usize = 256;

/// Section `[ingest]` of a plan: options of the ingestion.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct IngestConfig {
    /// Frame rate of the store.
    pub fps: Fps,
    /// Rule of resampling.
    pub resample: Resample,
    /// Licence recorded with motions whose source states none.
    pub license: Option<String>,
    /// Keep captions that are made by rule from file names.
    pub made_captions: bool,
    /// A list of pairs ([`PairList`]) to add; both clips of a pair get one split.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pairs: Option<PathBuf>,
    /// Grouping whose clips share one drawn split.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub split_by: Option<SplitBy>,
}

impl Default for IngestConfig {
    fn default() -> Self {
        Self {
            fps: Fps::STORE,
            resample: Resample::Exact,
            license: None,
            made_captions: true,
            pairs: None,
            split_by: None,
        }
    }
}

impl IngestConfig {
    /// The options of [`crate::ingest::ingest`]; `seed` draws the split of new clips.
    ///
    /// # Errors
    /// The list of pairs cannot be read.
    pub fn options(&self, seed: Seed) -> Result<IngestOptions, Error> {
        Ok(IngestOptions {
            fps: Some(self.fps),
            resample: self.resample,
            license: self.license.clone(),
            made_captions: self.made_captions,
            pairs: self.pairs.as_deref().map(PairList::read).transpose()?,
            seed,
            split_by: self.split_by,
            ..IngestOptions::default()
        })
    }
}

/// Opens a dataset for a stage that works on motions.
///
/// # Errors
/// The folder is not a dataset, or holds no motions.
pub fn open_motions(root: &Path) -> Result<Dataset, Error> {
    with_motions(Dataset::open(root)?)
}

/// [`open_motions`] for metadata: no file is checked against its hash, as that would read every motion.
///
/// # Errors
/// The folder is not a dataset, or holds no motions.
pub fn open_metadata(root: &Path) -> Result<Dataset, Error> {
    with_motions(Dataset::open_unverified(root)?)
}

fn with_motions(dataset: Dataset) -> Result<Dataset, Error> {
    match other_than_motions(&dataset) {
        None => Ok(dataset),
        Some(other) => {
            let path = dataset.root().display();
            Err(Error::refused(format!("{path} is {other}")))
        }
    }
}

/// Handling of human-judged masks when automatic ones are requested.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Judged {
    /// Keep the judged masks: the stage does nothing if there are any.
    Keep,
    /// Fail if there are judged masks.
    Refuse,
    /// Discard the judged masks, and forget which people rejected.
    Replace,
    /// Keep all masks, and make automatic ones for clips without masks, except those that people rejected.
    Add,
}

/// What [`Judged::Replace`] discarded; nothing otherwise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Discarded {
    /// Masks judged by people.
    pub masks: usize,
    /// Rejections by people.
    pub rejections: usize,
}

/// Derives the automatic masks of a dataset and commits them beside its motions. Clips whose source came with masks get
/// no automatic ones, and what people rejected is not made again, except by [`Judged::Replace`]. With a condition, the
/// masks of other clips stay as they are. Also returns the labels that were discarded, and the clips for
/// which a mask was left out; `None` if no masks were derived.
///
/// # Errors
/// The dataset cannot be read or written, or people have judged its masks ([`Judged::Refuse`]).
pub fn masks(
    root: &Path,
    config: &MaskConfig,
    judged: Judged,
    condition: Option<&Condition>,
    context: &Context<'_>,
) -> Result<(Dataset, Discarded, Option<LeftOut>), Error> {
    let mut discarded = Discarded::default();
    let dataset = open_motions(root)?;
    let motions_plan = dataset.manifest().plan(MotionRow::TABLE);
    let plan = match condition {
        None => plan_hash(masks::AUTHOR, &(motions_plan, config)),
        Some(condition) => plan_hash(masks::AUTHOR, &(motions_plan, config, condition.text())),
    };
    let is_same_plan = dataset.manifest().plan(MaskRow::TABLE) == plan;
    let chosen = match chosen(&dataset, condition) {
        // Once the stage has run, no clip fulfils a condition such as `NOT has_mask`.
        Err(tables::Error::NoneChosen { .. }) if is_same_plan => {
            return Ok((dataset, discarded, None));
        }
        chosen => chosen?,
    };
    let present: Vec<MaskRow> = dataset.read(None)?;
    let is_of_people = |mask: &&MaskRow| {
        chosen.has_clip(&mask.motion_id) && ["human", "draft"].contains(&mask.text_origin.as_str())
    };
    let by_people = present.iter().filter(is_of_people).count();
    match judged {
        Judged::Keep if by_people > 0 => return Ok((dataset, discarded, None)),
        Judged::Refuse if by_people > 0 => {
            return Err(Error::refused(format!(
                "{} holds {by_people} masks judged by people, which automatic masks would replace; pass --add to keep \
                 them and derive those of other clips, or --replace to discard them",
                root.display()
            )));
        }
        Judged::Keep | Judged::Refuse | Judged::Replace | Judged::Add => {}
    }
    let mut lists = dataset.manifest().rejected_masks()?;
    if judged == Judged::Replace {
        discarded.masks = by_people;
        discarded.rejections = forget(&mut lists, &chosen);
    }
    // The plan does not tell which masks were kept, nor which clips a condition chose.
    if is_same_plan && condition.is_none() && judged != Judged::Replace {
        return Ok((dataset, discarded, None));
    }
    let num_clips = dataset.manifest().rows(MotionRow::TABLE, None);
    context.progress.begin("masks", Some(num_clips));
    // The clips are dropped here: their labels take as much memory as the masks.
    let (automatic, found) = {
        let (motions, activities) = measured(&dataset, &dataset.skeleton()?, config, context)?;
        masks::masks_from(&motions, &activities, config)?
    };
    // Texts of parts are imported too, into masks that this stage derives.
    let is_of_source =
        |mask: &MaskRow| mask.text_origin == masks::IMPORTED && !masks::is_derived(mask);
    let stays = |mask: &&MaskRow| {
        judged == Judged::Add || is_of_source(mask) || !chosen.has_clip(&mask.motion_id)
    };
    let mut rows: Vec<MaskRow> = present.iter().filter(stays).cloned().collect();
    let rejections = dataset.rejections(&lists)?;
    let masked: BTreeSet<MotionId> = rows.iter().map(|mask| mask.motion_id.clone()).collect();
    let is_free = |id: &MotionId| chosen.has_clip(id) && !masked.contains(id);
    let left_out = Some(found.of(is_free));
    let is_new = |mask: &MaskRow| is_free(&mask.motion_id) && !rejections.has(mask);
    rows.extend(automatic.into_iter().filter(is_new));
    let done = format!("{} masks on {num_clips} clips", rows.len());
    context.progress.finish(&done);
    let mut facts = BTreeMap::new();
    if lists != dataset.manifest().rejected_masks()? {
        facts.insert(REJECTED_MASKS_FACT.to_owned(), json(&lists));
    }
    let is_same = are_same_rows([&rows, &present], |row| row.id.as_str());
    if is_same_plan && is_same && facts.is_empty() {
        return Ok((dataset, discarded, left_out));
    }
    let dataset = commit_changed(&dataset, &rows, |row| row.split, &plan, facts, context)?;
    Ok((dataset, discarded, left_out))
}

/// Removes the rejections of chosen clips, and returns their number.
fn forget(lists: &mut RejectedMasks, chosen: &Dataset) -> usize {
    let count = |lists: &RejectedMasks| lists.values().map(BTreeSet::len).sum::<usize>();
    let before = count(lists);
    for list in lists.values_mut() {
        list.retain(|rejected| !chosen.has_clip(&rejected.clip));
    }
    lists.retain(|_, list| !list.is_empty());
    before - count(lists)
}

/// Commits the rows of a table that were made of a dataset, and facts. A table that the same plan made is written again.
fn commit_changed<R: Row>(
    dataset: &Dataset,
    rows: &[R],
    split_of: fn(&R) -> Split,
    plan: &str,
    facts: BTreeMap<String, String>,
    context: &Context<'_>,
) -> Result<Dataset, Error> {
    let skeleton = dataset.skeleton()?;
    let transaction = Transaction::begin_after(dataset, context.holder)?;
    let files = transaction.write_rows(rows, Some(split_of), &skeleton, plan)?;
    let dataset = transaction.commit(Commit {
        tables: BTreeMap::from([(R::TABLE.to_owned(), files)]),
        plan_hash: plan.to_owned(),
        skeleton,
        facts,
        ..Commit::default()
    })?;
    Ok(dataset)
}

/// The clips of a dataset without their frames, and how much the parts of the body move in each.
fn measured(
    dataset: &Dataset,
    skeleton: &Skeleton,
    config: &MaskConfig,
    context: &Context<'_>,
) -> Result<(Vec<MotionRow>, Vec<Activity>), Error> {
    let (mut motions, mut activities) = (Vec::new(), Vec::new());
    for (path, _) in dataset.files(MotionRow::TABLE, None) {
        let shard = ShardReader::open_whole(&path)?;
        for first in (0..shard.num_rows()).step_by(CLIPS_AT_ONCE) {
            let places: Vec<usize> = (first..first + CLIPS_AT_ONCE).collect();
            let mut clips: Vec<MotionRow> = shard.rows_at(&places)?;
            activities.extend(masks::activities(&clips, skeleton, config)?);
            for clip in &mut clips {
                clip.forget_frames();
            }
            context.progress.advance(clips.len() as u64);
            motions.extend(clips);
        }
    }
    Ok((motions, activities))
}

/// Makes style pairs from the labels of a dataset and commits them beside those of its sources and of people: two clips
/// that have a pair there get no second one, nor do those whose pair people judged unusable. Earlier pairs of labels make
/// room, unless nothing takes their place. Also returns the styled motions without a counterpart. With a condition, only clips that fulfil it are paired, and pairs of other clips stay
/// as they are.
///
/// # Errors
/// The dataset cannot be read or written.
pub fn pairs(
    root: &Path,
    config: &PairConfig,
    seed: Seed,
    condition: Option<&Condition>,
    context: &Context<'_>,
) -> Result<(Dataset, Vec<MotionId>), Error> {
    let dataset = open_motions(root)?;
    let motions_plan = dataset.manifest().plan(MotionRow::TABLE);
    let plan = match condition {
        None => plan_hash(pairs::SOURCE, &(motions_plan, config, seed)),
        Some(condition) => {
            let inputs = (motions_plan, config, seed, condition.text());
            plan_hash(pairs::SOURCE, &inputs)
        }
    };
    let is_same_plan = dataset.manifest().plan(PairRow::TABLE) == plan;
    let chosen = match chosen(&dataset, condition) {
        // Once the stage has run, no clip fulfils a condition such as `NOT has_pair`.
        Err(tables::Error::NoneChosen { .. }) if is_same_plan => return Ok((dataset, Vec::new())),
        chosen => chosen?,
    };
    let mut made = style_pairs(&LabelledClip::read(&chosen)?, config, seed);
    let before: Vec<PairRow> = dataset.read(None)?;
    let is_chosen = |row: &PairRow| row.clips().into_iter().all(|clip| chosen.has_clip(clip));
    let mut rows = before.clone();
    // A release that was ingested brings pairs of labels whose clips now lie in folders that do not belong together.
    let alone: BTreeSet<MotionId> = made.alone.iter().cloned().collect();
    rows.retain(|row| !is_from_labels(row) || !is_chosen(row) || alone.contains(&row.target_id));
    let paired: BTreeSet<&MotionId> = rows.iter().map(|row| &row.target_id).collect();
    made.alone.retain(|id| !paired.contains(id));
    let rejected = dataset.manifest().rejected_pairs()?.into_values().flatten();
    let new = new_pairs(made.rows, &rows, rejected.collect());
    rows.extend(new);
    // A condition may choose other clips than before, so the plan alone does not tell whether there is work.
    if is_same_plan && are_same_rows([&rows, &before], |row| row.id.as_str()) {
        return Ok((dataset, made.alone));
    }
    context.progress.begin("pairs", None);
    let across = match made.across {
        0 => String::new(),
        count => format!("; labels name two people in {count} of them"),
    };
    context
        .progress
        .finish(&format!("{} pairs{across}", rows.len()));
    if rows.is_empty() && !dataset.manifest().tables.contains_key(PairRow::TABLE) {
        return Ok((dataset, made.alone));
    }
    let facts = BTreeMap::new();
    let dataset = commit_changed(&dataset, &rows, |row| row.split, &plan, facts, context)?;
    Ok((dataset, made.alone))
}

/// Whether two lists hold the same rows of a table, in any order.
fn are_same_rows<R: PartialEq>(rows: [&[R]; 2], id: fn(&R) -> &str) -> bool {
    let [a, b] = rows.map(|rows| {
        let mut rows: Vec<&R> = rows.iter().collect();
        rows.sort_by(|a, b| id(a).cmp(id(b)));
        rows
    });
    a == b
}

/// Adds the pairs of a list to those of a dataset. They replace earlier pairs of a list with the
/// same motions. Also returns the lines that gave no pair.
///
/// # Errors
/// The list or the dataset cannot be read, or the dataset cannot be written.
pub fn listed_pairs(
    root: &Path,
    file: &Path,
    context: &Context<'_>,
) -> Result<(Dataset, Vec<RefusedLine>), Error> {
    let list = PairList::read(file)?;
    let dataset = open_motions(root)?;
    let clips = LabelledClip::read(&dataset)?.into_iter();
    let motions: BTreeMap<MotionId, Split> = clips.map(|clip| (clip.id, clip.split)).collect();
    let mut before: Vec<PairRow> = dataset.read(None)?;
    before.sort_by(|a, b| a.id.cmp(&b.id));
    let rejected = dataset.manifest().rejected_pairs()?.into_values().flatten();
    let made = list.pairs(&motions, &before, &rejected.collect());
    let rows = before.iter().cloned().chain(made.rows);
    let rows: BTreeMap<String, PairRow> = rows.map(|row| (row.id.clone(), row)).collect();
    let rows: Vec<PairRow> = rows.into_values().collect();
    if rows == before {
        return Ok((dataset, made.refused));
    }
    let inputs = (dataset.manifest().plan(PairRow::TABLE), &list.hash());
    let plan = plan_hash(pairs::LISTED, &inputs);
    let facts = BTreeMap::new();
    let dataset = commit_changed(&dataset, &rows, |row| row.split, &plan, facts, context)?;
    Ok((dataset, made.refused))
}

/// Whether the training split can teach a coordinator: composing takes motions of two source clips.
///
/// # Errors
/// The dataset cannot be read.
pub fn can_coordinate(root: &Path) -> Result<bool, Error> {
    let dataset = Dataset::open(root)?;
    let mut origins = BTreeSet::new();
    for (path, _) in dataset.files(MotionRow::TABLE, Some(Split::Train)) {
        let ids = read_column::<MotionRow, MotionId>(&path, "id")?;
        let mirrored = read_column::<MotionRow, Option<String>>(&path, "mirrored_of")?;
        for (id, mirrored_of) in ids.iter().zip(mirrored) {
            let original = mirrored_of.map(|id| MotionId::parse(&id)).transpose()?;
            origins.insert(original.as_ref().unwrap_or(id).source_clip().to_owned());
        }
    }
    Ok(origins.len() > 1)
}

/// Result of [`items`].
pub struct ItemsFolder {
    /// The folder of items.
    pub dataset: Dataset,
    /// Number of items drawn, if it is less than requested.
    pub fewer: Option<usize>,
    /// How many items of each requested novelty were drawn; empty for items that were there.
    pub of_novelty: BTreeMap<Novelty, usize>,
    /// Number of masks and pairs that are shorter than a window, and are no question; not known for items that were there.
    pub too_short: Option<usize>,
}

/// Whether the items of a folder have the expected digest. Of a folder that holds only a part of the drawn items this is
/// not known, and the answer is no.
fn has_digest(items: &Dataset, config: &ItemConfig) -> Result<bool, Error> {
    let Some(expected) = &config.digest else {
        return Ok(true);
    };
    let mut ids: Vec<String> = Vec::new();
    for (path, _) in items.files(ItemRow::TABLE, None) {
        ids.extend(read_column::<ItemRow, String>(&path, "id")?);
    }
    let is_equal = *expected == digest_of_ids(ids.iter().map(String::as_str));
    Ok(config.part.is_none() && is_equal)
}

/// Draws test questions from a split and commits them as a dataset of their own.
///
/// # Errors
/// The split cannot be composed or gives no item, the folder holds edits, or it cannot be written.
pub fn items(
    dataset: &Dataset,
    out: &Path,
    split: Split,
    config: &ItemConfig,
    seed: Seed,
    context: &Context<'_>,
) -> Result<ItemsFolder, Error> {
    let content = dataset.content_hash(&COMPOSED);
    let asked = ItemConfig {
        digest: None,
        ..config.clone()
    };
    let plan = plan_hash("items", &(content, split, asked, seed));
    let own = [
        ItemRow::TABLE,
        EditRow::TABLE,
        ScoreRow::TABLE,
        QuarantineRow::TABLE,
    ];
    refuse_others(out, &own, "items")?;
    if let Ok(held) = Dataset::open_unverified(out) {
        match held.manifest().plan(ItemRow::TABLE) == plan {
            true => {
                let dataset = Dataset::open(out)?;
                // Others are drawn again, to say how they differ.
                if has_digest(&dataset, config)? {
                    return Ok(ItemsFolder {
                        dataset,
                        fewer: None,
                        of_novelty: BTreeMap::new(),
                        too_short: None,
                    });
                }
            }
            false => work::refuse_items(&held)?,
        }
    }
    let progress = context.progress;
    progress.begin("draw", None);
    let (library, shown) = (library(dataset, split)?, Shown::read(dataset)?);
    let drawn = draw_items(&library, config, &shown, seed)?;
    progress.finish(&format!("{} items", drawn.len()));
    let fewer = match config.count {
        ItemCount::Exactly(count) if drawn.num_drawn < count => Some(drawn.num_drawn),
        _ => None,
    };
    let skeleton = dataset.skeleton()?;
    let facts = table_facts(&skeleton, &plan);
    progress.begin("write", Some(drawn.len() as u64));
    let dataset = commit_table::<ItemRow, Error>(out, &skeleton, &plan, context.holder, |files| {
        let made = |range: Range<usize>| -> Result<Vec<ItemRow>, Error> {
            let rows = drawn.rows(range)?;
            progress.advance(rows.len() as u64);
            Ok(rows)
        };
        let files = Split::ALL.map(|other| match other == split {
            true => files.write_made(Some(other), drawn.len(), made, &facts),
            false => Ok(files.write_shards::<ItemRow>(Some(other), &[], &facts)?),
        });
        let files: Result<Vec<_>, Error> = files.into_iter().collect();
        Ok(files?.concat())
    })?;
    progress.finish(&format!("{} items", drawn.len()));
    Ok(ItemsFolder {
        dataset,
        fewer,
        too_short: Some(drawn.num_short),
        of_novelty: drawn.of_novelty,
    })
}
