//! Layout `dataset`: the tables `masks` and `pairs` of the dataset itself.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::dataset::{Commit, Transaction};
use datasets_spec::record::{MaskRow, PairRow};
use datasets_spec::table::Row;
use datasets_spec::{Dataset, JointSet, MASK_DEF_VERSION, MotionId, Split};

use super::exporter::{Exported, Exporter};
use crate::Error;
use crate::answer::sentence;
use crate::mask::check_range;
use crate::transfer::import::{PAIR_SOURCE, pair_id};
use crate::wire::{Answer, Extent, TaskKind, Verdict};

/// Facts of the manifest that say which point in time of which store the tables hold.
const STORE_FACT: &str = "annotate_store";
const SEQ_FACT: &str = "annotate_seq";

/// Judgements of pairs, by the id of the pair: when each was accepted, and the row of a pair that is kept.
type Judged = BTreeMap<String, (i64, Option<PairRow>)>;

impl Exporter<'_> {
    /// Writes the tables `masks` and `pairs` of the dataset in one commit. Motions with an accepted answer get its
    /// masks, the others keep theirs; accepted pairs replace the pairs they judge.
    pub(super) fn dataset(&mut self, transaction: Transaction) -> Result<(), Error> {
        let dataset = Dataset::open(transaction.root())?;
        let mut masks: Vec<MaskRow> = Vec::new();
        let mut judged = Judged::new();
        let mut answered: BTreeSet<String> = BTreeSet::new();
        self.each_accepted::<Error>(|exporter, accepted| {
            let (motion, target) = exporter.ids(&accepted.task)?;
            let split: Split = accepted.task.split.parse()?;
            let author = exporter.author(&accepted);
            let frames = exporter.frames(&accepted.task)?;
            let (answer, done) = (&accepted.answer, &mut exporter.done);
            count_losses(answer, done);
            let accepted_by = Some(accepted.accepted_by.clone());
            if accepted.task.kind == TaskKind::MaskText {
                answered.insert(motion.clone());
                for row in mask_rows(&motion, split, &author, answer, frames, done)? {
                    masks.push(MaskRow {
                        accepted_by: accepted_by.clone(),
                        ..row
                    });
                }
                return Ok(());
            }
            done.count("pairs_judged", 1);
            let id = pair_id(&accepted.task.key).to_owned();
            // A store of an earlier version may have two tasks for one candidate: the later decision counts.
            if judged.get(&id).is_none_or(|(seq, _)| *seq < accepted.seq) {
                let row = pair_row(&id, &motion, target, split, answer)?;
                let row = row.map(|row| PairRow { accepted_by, ..row });
                judged.insert(id, (accepted.seq, row));
            }
            Ok(())
        })?;
        masks.extend(
            dataset
                .read::<MaskRow>(None)?
                .into_iter()
                .filter(|row| !answered.contains(row.motion_id.as_str())),
        );
        masks.sort_by(|a, b| (&a.motion_id, &a.id).cmp(&(&b.motion_id, &b.id)));
        let mut pairs: Vec<PairRow> = dataset.read(None)?;
        pairs.retain(|pair| !judged.contains_key(&pair.id));
        pairs.extend(judged.into_values().filter_map(|(_, row)| row));
        pairs.sort_by(|a, b| a.id.cmp(&b.id));
        self.done.count("masks", masks.len());
        self.done.count("motions_described", answered.len());
        self.done.count("pairs", pairs.len());
        let plan = blake3::hash(format!("annotate {masks:?} {pairs:?}").as_bytes());
        let plan = plan.to_hex().to_string();
        let manifest = dataset.manifest();
        let is_there = |table: &str| manifest.plans.get(table) == Some(&plan);
        if is_there(MaskRow::TABLE) && is_there(PairRow::TABLE) {
            return Ok(());
        }
        let skeleton = dataset.skeleton()?;
        let mask_split: fn(&MaskRow) -> Split = |row| row.split;
        let pair_split: fn(&PairRow) -> Split = |row| row.split;
        let tables = BTreeMap::from([
            (
                MaskRow::TABLE.to_owned(),
                transaction.write_rows(&masks, Some(mask_split), &skeleton, &plan)?,
            ),
            (
                PairRow::TABLE.to_owned(),
                transaction.write_rows(&pairs, Some(pair_split), &skeleton, &plan)?,
            ),
        ]);
        let facts = BTreeMap::from([
            (STORE_FACT.to_owned(), self.done.store.clone()),
            (SEQ_FACT.to_owned(), self.done.seq.to_string()),
        ]);
        transaction.commit(Commit {
            tables,
            plan_hash: plan,
            skeleton,
            facts,
            ..Commit::default()
        })?;
        Ok(())
    }
}

/// Counts what the tables have no place for.
fn count_losses(answer: &Answer, done: &mut Exported) {
    let has_reason = matches!(
        answer,
        Answer::MaskText {
            count_reason: Some(_),
            ..
        }
    );
    let has_extent = matches!(
        answer,
        Answer::Style {
            extent: Some(_),
            ..
        }
    );
    for (what, is_lost) in [
        ("left_out_notes", !answer.note().is_empty()),
        ("left_out_reasons", has_reason),
        ("left_out_extents", has_extent),
        ("left_out_rejected_pairs", answer.is_reject()),
    ] {
        done.lose(what, usize::from(is_lost));
    }
}

fn mask_rows(
    motion: &str,
    split: Split,
    author: &str,
    answer: &Answer,
    frames: i64,
    done: &mut Exported,
) -> Result<Vec<MaskRow>, Error> {
    let Answer::MaskText { masks, .. } = answer else {
        return Ok(Vec::new());
    };
    let mut rows: Vec<MaskRow> = Vec::new();
    for mask in masks {
        let joints = mask.mask();
        if mask
            .range
            .is_some_and(|range| check_range(range, frames).is_err())
        {
            // The clip was ingested again after the answer, and is shorter than it was.
            done.count("masks_past_the_clip", 1);
            continue;
        }
        if joints.is_empty() || mask.text.trim().is_empty() {
            // A release may have a mask without a text, but the composer needs one.
            done.count("masks_without_text", 1);
            continue;
        }
        let base = format!("{motion}#{}", mask.parts.join("+"));
        let same = rows
            .iter()
            .filter(|row| row.id == base || row.id.starts_with(&format!("{base}#")))
            .count();
        rows.push(MaskRow {
            id: if same == 0 {
                base
            } else {
                format!("{base}#{}", same + 1)
            },
            motion_id: MotionId::parse(motion)?,
            split,
            parts: mask.parts.clone(),
            hard_joints: JointSet::names(joints.hard()),
            soft_joints: JointSet::names(joints.soft()),
            start: mask.range.map(|[start, _]| start),
            end: mask.range.map(|[_, end]| end),
            mask_def_version: MASK_DEF_VERSION,
            text: sentence(&mask.text),
            text_origin: "human".to_owned(),
            author: author.to_owned(),
            accepted_by: None,
        });
    }
    Ok(rows)
}

fn pair_row(
    id: &str,
    motion: &str,
    target: Option<String>,
    split: Split,
    answer: &Answer,
) -> Result<Option<PairRow>, Error> {
    let (named, text, style, edit_type, kind) = match answer {
        Answer::Pair {
            verdict: Verdict::Keep,
            parts,
            edit_type,
            text,
            ..
        } => (parts.clone(), text, None, *edit_type, "fine-grained"),
        Answer::Style {
            verdict: Verdict::Keep,
            parts,
            text,
            style,
            extent,
            ..
        } => {
            // Derive missing parts from the extent.
            let by_extent = match extent {
                Some(Extent::Lower) => &["LOWER_BODY"][..],
                Some(Extent::Upper) => &["UPPER_BODY"],
                Some(Extent::Whole) | None => &[],
            };
            let named = if parts.is_empty() {
                by_extent.iter().map(|&part| part.to_owned()).collect()
            } else {
                parts.clone()
            };
            (named, text, style.clone(), None, "style")
        }
        _ => return Ok(None),
    };
    let Some(target) = target else {
        return Ok(None);
    };
    Ok(Some(PairRow {
        id: id.to_owned(),
        split,
        source: PAIR_SOURCE.to_owned(),
        kind: kind.to_owned(),
        source_id: MotionId::parse(motion)?,
        target_id: MotionId::parse(&target)?,
        style,
        parts: named,
        instruction: text.clone(),
        edit_type: edit_type.map(|kind| kind.to_string()),
        accepted_by: None,
    }))
}
