//! Layout `dataset`: the tables `masks` and `pairs` of the dataset itself.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::dataset::{Commit, Transaction};
use datasets_spec::record::{MaskRow, MotionRow, PairRow};
use datasets_spec::table::{Row, read_column};
use datasets_spec::{Dataset, MASK_DEF_VERSION, MotionId, Split};

use super::exporter::{Clips, Exported, Exporter};
use crate::Error;
use crate::answer::sentence;
use crate::mask::check_range;
use crate::store::AcceptedAnswer;
use crate::transfer::import::{PAIR_SOURCE, pair_id};
use crate::wire::{Answer, Extent, TaskKind};

/// Facts of the manifest that name the store and the point in its log that the tables were exported from.
const STORE_FACT: &str = "annotate_store";
const SEQ_FACT: &str = "annotate_seq";

/// Judgements of pairs by the id of the pair: the sequence number of the acceptance, and the pair's new row, or `None`
/// if it is rejected.
type Judged = BTreeMap<String, (i64, Option<PairRow>)>;

impl Exporter<'_> {
    /// Writes the tables `masks` and `pairs` of the dataset in one commit. Motions with an accepted answer get its
    /// masks, the others keep theirs; accepted pairs replace the pairs they judge.
    pub(super) fn dataset(&mut self, transaction: Transaction) -> Result<(), Error> {
        let dataset = Dataset::open(transaction.root())?;
        self.clips = Some(clips_of(&dataset)?);
        let mut masks: Vec<MaskRow> = Vec::new();
        let mut judged = Judged::new();
        let mut answered: BTreeSet<String> = BTreeSet::new();
        self.each_accepted(|exporter, accepted| {
            count_losses(&accepted.answer, &mut exporter.done);
            if accepted.task.kind == TaskKind::MaskText {
                masks.extend(exporter.mask_rows(&accepted)?);
                answered.insert(exporter.ids(&accepted.task)?.0);
                return Ok(());
            }
            exporter.done.count("pairs_judged", 1);
            let id = pair_id(&accepted.task.key).to_owned();
            // A store of an earlier version may have two tasks for one candidate. The later decision counts.
            if judged.get(&id).is_none_or(|(seq, _)| *seq < accepted.seq) {
                let row = exporter.pair_row(&id, &accepted)?;
                judged.insert(id, (accepted.seq, row));
            }
            Ok(())
        })?;
        let others = dataset.read::<MaskRow>(None)?.into_iter();
        masks.extend(others.filter(|row| !answered.contains(row.motion_id.as_str())));
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
        let masks = transaction.write_rows(&masks, Some(mask_split), &skeleton, &plan)?;
        let pairs = transaction.write_rows(&pairs, Some(pair_split), &skeleton, &plan)?;
        let tables = BTreeMap::from([
            (MaskRow::TABLE.to_owned(), masks),
            (PairRow::TABLE.to_owned(), pairs),
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

    /// The masks of an accepted answer that the table can hold.
    fn mask_rows(&mut self, accepted: &AcceptedAnswer) -> Result<Vec<MaskRow>, Error> {
        let motion = self.ids(&accepted.task)?.0;
        let frames = self.frames(&accepted.task)?;
        let mut rows: Vec<MaskRow> = Vec::new();
        for mask in accepted.answer.fields().masks {
            let joints = mask.mask();
            let fits = |range| check_range(range, frames).is_ok();
            if !mask.range.is_none_or(fits) {
                // The clip was ingested again after the answer, and is shorter now.
                self.done.count("masks_past_the_clip", 1);
                continue;
            }
            if joints.is_empty() || mask.text.trim().is_empty() {
                // A release may have a mask without a text, but the composer needs one.
                self.done.count("masks_without_text", 1);
                continue;
            }
            let base = format!("{motion}#{}", mask.parts.join("+"));
            let is_same =
                |row: &&MaskRow| row.id == base || row.id.starts_with(&format!("{base}#"));
            let id = match rows.iter().filter(is_same).count() {
                0 => base,
                same => format!("{base}#{}", same + 1),
            };
            rows.push(MaskRow {
                id,
                motion_id: MotionId::parse(&motion)?,
                split: accepted.task.split.parse()?,
                parts: mask.parts.clone(),
                hard_joints: joints.hard().names(),
                soft_joints: joints.soft().names(),
                start: mask.range.map(|[start, _]| start),
                end: mask.range.map(|[_, end]| end),
                mask_def_version: MASK_DEF_VERSION,
                text: sentence(&mask.text),
                text_origin: "human".to_owned(),
                author: self.author(accepted),
                accepted_by: Some(accepted.accepted_by.clone()),
            });
        }
        Ok(rows)
    }

    /// The row of a judged pair; `None` if the pair is rejected.
    fn pair_row(&self, id: &str, accepted: &AcceptedAnswer) -> Result<Option<PairRow>, Error> {
        let (source, target) = self.ids(&accepted.task)?;
        let said = accepted.answer.fields();
        let Some(target) = target.filter(|_| !accepted.answer.is_reject()) else {
            return Ok(None);
        };
        // If no parts are named, they follow from the extent.
        let parts = match said.extent {
            Some(Extent::Lower) if said.parts.is_empty() => vec!["LOWER_BODY".to_owned()],
            Some(Extent::Upper) if said.parts.is_empty() => vec!["UPPER_BODY".to_owned()],
            _ => said.parts.to_vec(),
        };
        let kind = match accepted.task.kind {
            TaskKind::Style => "style",
            TaskKind::Pair | TaskKind::MaskText => "fine-grained",
        };
        Ok(Some(PairRow {
            id: id.to_owned(),
            split: accepted.task.split.parse()?,
            source: PAIR_SOURCE.to_owned(),
            kind: kind.to_owned(),
            source_id: MotionId::parse(&source)?,
            target_id: MotionId::parse(&target)?,
            style: said.style.map(str::to_owned),
            parts,
            instruction: said.text.to_owned(),
            edit_type: said.edit_type.map(|kind| kind.to_string()),
            accepted_by: Some(accepted.accepted_by.clone()),
        }))
    }
}

/// The clips of a dataset.
fn clips_of(dataset: &Dataset) -> Result<Clips, Error> {
    let mut clips = Clips::new();
    for (path, _) in dataset.files(MotionRow::TABLE, None) {
        let ids: Vec<MotionId> = read_column::<MotionRow, _>(&path, "id")?;
        let splits: Vec<Split> = read_column::<MotionRow, _>(&path, "split")?;
        let frames: Vec<i32> = read_column::<MotionRow, _>(&path, "n_frames")?;
        let ids = ids.into_iter().map(|id| id.to_string());
        let frames = frames.into_iter().map(i64::from);
        clips.extend(ids.zip(splits.into_iter().zip(frames)));
    }
    Ok(clips)
}

/// Counts the parts of an answer that the tables cannot hold.
fn count_losses(answer: &Answer, done: &mut Exported) {
    let said = answer.fields();
    for (what, is_lost) in [
        ("left_out_notes", !said.note.is_empty()),
        ("left_out_reasons", said.count_reason.is_some()),
        ("left_out_extents", said.extent.is_some()),
        ("left_out_rejected_pairs", answer.is_reject()),
    ] {
        done.lose(what, usize::from(is_lost));
    }
}
