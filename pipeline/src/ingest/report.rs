//! The report of a run, and the sums over its shards.

use std::collections::{BTreeMap, BTreeSet};

use clip::LabelProblem;
use datasets_spec::license;
use datasets_spec::manifest::{Accounting, FileEntry};
use datasets_spec::record::{MaskRow, MotionRow, PairRow, QuarantineRow, SkippedRow};
use datasets_spec::table::Row;
use datasets_spec::{Dataset, MotionId, Split};
use serde::{Deserialize, Serialize};

use super::alike::{Alike, AlikeClips};
use super::growth::Growth;
use super::kept::Outside;
use super::options::{LABEL_PROBLEMS_FACT, REFUSED_PAIRS_FACT};
use super::plan::Plan;
use super::shard::ShardNotes;
use crate::Error;
use crate::annotation::pairs::{ListedPairs, PairList, RefusedLine};
use crate::versions::taken_out;

/// The report of a run.
#[derive(Clone, Debug, Serialize)]
pub struct IngestReport {
    /// The committed dataset.
    #[serde(skip)]
    pub dataset: Dataset,
    /// Counts of the source items. An item is a file, or one motion of a file that holds several.
    #[serde(flatten)]
    pub accounting: Accounting,
    /// Files the items came from.
    pub files: u64,
    /// What the run has to say of labels, clips and lists.
    #[serde(flatten)]
    pub notes: IngestNotes,
    /// The rejected sources.
    #[serde(skip)]
    pub quarantine: Vec<QuarantineRow>,
    /// Skipped sources by reason.
    #[serde(rename = "skipped_reasons")]
    pub skipped: BTreeMap<String, u64>,
    /// Shards taken over from an interrupted run of the same plan.
    pub resumed_shards: usize,
    /// Whether the dataset was already complete and nothing was done.
    pub already_complete: bool,
}

/// What an ingestion has to say beside its counts of sources.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct IngestNotes {
    /// Pairs that were dropped because one of their motions is not in the dataset.
    pub dropped_pairs: u64,
    /// Lines of the list of pairs that gave no pair.
    pub refused_pairs: Vec<RefusedLine>,
    /// Lines of the list of splits that gave no clip a split.
    pub refused_splits: Vec<RefusedLine>,
    /// Labels that could not be used; their motions are ingested without them.
    pub label_problems: Vec<LabelProblem>,
    /// Clips by licence tag; the tag of clips without one is empty.
    pub licenses: BTreeMap<String, u64>,
    /// Remarks on the splits and licences. Those that concern the dataset, not only this run, are recorded as
    /// [`REMARKS_FACT`](super::options::REMARKS_FACT).
    pub remarks: Vec<String>,
    /// Motions of this run that are nearly equal to others, and equal ones in several splits.
    pub alike: Vec<AlikeClips>,
    /// Counts of the fates of existing clips and labels; `None` for a new dataset.
    pub growth: Option<Growth>,
}

impl IngestNotes {
    /// Whether every line of the lists of pairs and splits was used.
    pub fn all_lines_were_used(&self) -> bool {
        self.refused_pairs.is_empty() && self.refused_splits.is_empty()
    }
}

/// The report on a dataset and its rejected sources. What only a run knows, such as its growth, is left empty.
pub(super) fn report_on(
    dataset: Dataset,
    plan: &Plan,
    quarantine: Vec<QuarantineRow>,
    skipped: &[SkippedRow],
) -> Result<IngestReport, Error> {
    let facts = &dataset.manifest().facts;
    let dropped = facts.get("dropped_pairs");
    let notes = IngestNotes {
        refused_pairs: dataset.manifest().fact(REFUSED_PAIRS_FACT)?,
        remarks: plan.all_remarks(),
        refused_splits: plan.notes.refused_splits.clone(),
        label_problems: dataset.manifest().fact(LABEL_PROBLEMS_FACT)?,
        licenses: license::licenses(dataset.manifest()),
        dropped_pairs: dropped.and_then(|count| count.parse().ok()).unwrap_or(0),
        ..IngestNotes::default()
    };
    Ok(IngestReport {
        notes,
        accounting: dataset.manifest().accounting.clone(),
        files: plan.files.len() as u64,
        quarantine,
        skipped: counted(skipped),
        resumed_shards: 0,
        already_complete: false,
        dataset,
    })
}

/// Sums over the shards of a run.
#[derive(Default)]
pub(super) struct Tally {
    pub(super) tables: BTreeMap<String, Vec<FileEntry>>,
    pub(super) quarantine: Vec<QuarantineRow>,
    pub(super) skipped: Vec<SkippedRow>,
    /// Recorded clips that are not read again, with their splits.
    pub(super) staying: BTreeMap<String, Split>,
    /// Clips of this run that moved into the split of an equal or nearly equal clip.
    pub(super) moves: BTreeMap<String, Split>,
    pub(super) ingested: BTreeSet<String>,
    /// Hashes of the ingested motions by id.
    pub(super) contents: BTreeMap<String, String>,
    pub(super) alike: Alike,
    pub(super) pairs: Vec<PairRow>,
    pub(super) dropped_pairs: u64,
    pub(super) masks: Vec<MaskRow>,
    pub(super) label_problems: BTreeSet<LabelProblem>,
    pub(super) resumed_shards: usize,
}

impl Tally {
    pub(super) fn take(&mut self, entry: FileEntry, notes: ShardNotes) {
        let motions = self.tables.entry(MotionRow::TABLE.to_owned()).or_default();
        motions.push(entry);
        for (table, file) in notes.beside {
            self.tables.entry(table).or_default().push(file);
        }
        self.skipped.extend(notes.skipped);
        self.quarantine.extend(notes.quarantine);
        let ids = notes.ingested.iter().cloned();
        self.contents.extend(ids.zip(notes.contents));
        self.ingested.extend(notes.ingested);
        self.pairs.extend(notes.pairs);
        self.dropped_pairs += notes.dropped_pairs;
        self.masks.extend(notes.masks);
        self.label_problems.extend(notes.label_problems);
    }

    /// Labels that could not be used, of clips and of folders.
    pub(super) fn label_problems(&self, plan: &Plan) -> Vec<LabelProblem> {
        let mut problems = self.label_problems.clone();
        problems.extend(plan.notes.label_problems.iter().cloned());
        problems.into_iter().collect()
    }

    /// Moves the labels of clips that changed their split into the new splits.
    pub(super) fn follow(&mut self, moves: BTreeMap<String, Split>) {
        for mask in &mut self.masks {
            mask.split = *moves.get(mask.motion_id.as_str()).unwrap_or(&mask.split);
        }
        for pair in &mut self.pairs {
            pair.split = *moves.get(pair.target_id.as_str()).unwrap_or(&pair.split);
        }
        self.moves = moves;
    }

    /// Counts of the source items: `num_items` of this run, `num_beside` clips that stay without an item, and the
    /// rejected items of other sources, `outside`, which are added to the lists of `self`.
    pub(super) fn accounting(
        &mut self,
        num_items: u64,
        outside: Outside,
        num_beside: u64,
    ) -> Accounting {
        let num_rejected = outside.quarantine.len() + outside.skipped.len();
        self.quarantine.extend(outside.quarantine);
        self.quarantine.sort_by(|a, b| a.path.cmp(&b.path));
        self.skipped.extend(outside.skipped);
        self.skipped.sort_by(|a, b| a.path.cmp(&b.path));
        let rejected = self.quarantine.iter().map(|row| row.code.clone());
        let ingested = self.staying.len() + self.ingested.len();
        Accounting {
            sources: num_items + num_beside + num_rejected as u64,
            ..Accounting::of(ingested as u64, self.skipped.len() as u64, rejected)
        }
    }

    /// The pairs whose motions are both in the dataset and in one split, and the number of the others.
    pub(super) fn pairs(&self, plan: &Plan) -> (Vec<PairRow>, u64) {
        let splits = self.splits(plan);
        let mut rows: Vec<PairRow> = Vec::new();
        for pair in &self.pairs {
            let ids = [pair.source_id.as_str(), pair.target_id.as_str()];
            let [source, target] = ids.map(|id| splits.get(id));
            if source.is_some() && source == target {
                rows.push(pair.clone());
            }
        }
        let dropped = self.dropped_pairs + (self.pairs.len() - rows.len()) as u64;
        rows.sort_by(|a, b| a.id.cmp(&b.id));
        (rows, dropped)
    }

    /// The pairs of a list whose motions are both in the dataset, beside those of the releases.
    pub(super) fn listed_pairs(
        &self,
        plan: &Plan,
        list: Option<&PairList>,
        known: &[PairRow],
        rejected: &BTreeSet<[MotionId; 2]>,
    ) -> ListedPairs {
        let Some(list) = list else {
            return ListedPairs::default();
        };
        let motions: BTreeMap<MotionId, Split> = self
            .splits(plan)
            .into_iter()
            .filter_map(|(id, split)| Some((MotionId::parse(id).ok()?, split)))
            .collect();
        list.pairs(&motions, known, rejected)
    }

    /// The masks that stay and those that came with clips of this run. A mask whose id exists already stays as it is,
    /// because people may have changed it; the number of those that the source gives otherwise is returned too.
    pub(super) fn masks(&self, mut masks: Vec<MaskRow>) -> (Vec<MaskRow>, u64) {
        let taken = masks.iter().map(|mask| (&mask.id, &mask.motion_id));
        let mut taken: BTreeMap<String, MotionId> = taken
            .map(|(id, motion)| (id.clone(), motion.clone()))
            .collect();
        let staying: BTreeMap<String, MaskRow> = masks
            .iter()
            .map(|mask| (mask.id.clone(), mask.clone()))
            .collect();
        let mut differ = 0;
        let mut numbers: BTreeMap<&MotionId, usize> = BTreeMap::new();
        for mask in &self.masks {
            let next = numbers.entry(&mask.motion_id).or_default();
            let number = *next;
            *next += 1;
            let own = (!mask.id.is_empty()).then(|| mask.id.clone());
            if own.as_ref().and_then(|id| taken.get(id)) == Some(&mask.motion_id) {
                let stays = own.and_then(|id| staying.get(&id));
                let of_source = stays.map(|stays| MaskRow {
                    split: stays.split,
                    ..mask.clone()
                });
                differ += u64::from(stays != of_source.as_ref());
                continue;
            }
            let base = match &own {
                Some(id) => id.clone(),
                None => format!("{}/{}", mask.motion_id, mask.parts.join("+")),
            };
            let numbered = (number..).map(|number| format!("{base}/{number}"));
            let mut ids = own.into_iter().chain(numbered);
            let id = ids.find(|id| !taken.contains_key(id));
            let id = id.expect("numbers do not end");
            taken.insert(id.clone(), mask.motion_id.clone());
            masks.push(MaskRow { id, ..mask.clone() });
        }
        (masks, differ)
    }

    pub(super) fn splits<'a>(&'a self, plan: &'a Plan) -> BTreeMap<&'a str, Split> {
        let staying = self.staying.iter();
        // Of several motions with one id, the first is ingested. Reversed, it comes last and replaces the others.
        let made = plan.items.iter().rev().filter(|item| !item.is_kept);
        let made = made.map(|item| {
            let split = self.moves.get(&item.id).unwrap_or(&item.split);
            (item.id.as_str(), *split)
        });
        staying
            .map(|(id, split)| (id.as_str(), *split))
            .chain(made.filter(|(id, _)| self.ingested.contains(*id)))
            .collect()
    }
}

/// Number of skipped items by reason. The reason of a clip that its owner took out names the clip, so the id is left
/// out.
fn counted(skipped: &[SkippedRow]) -> BTreeMap<String, u64> {
    let mut counts = BTreeMap::new();
    for row in skipped {
        let reason = match taken_out(row) {
            Some(id) => format!("clip that{}", &row.reason[id.len()..]),
            None => row.reason.clone(),
        };
        *counts.entry(reason).or_default() += 1;
    }
    counts
}
