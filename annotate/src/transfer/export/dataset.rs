//! Layout `dataset`: the tables `masks` and `pairs` of the dataset itself.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::dataset::{Commit, Transaction};
use datasets_spec::manifest::{
    ANNOTATE_KNOWN_FACT, ANNOTATE_SEQ_FACT, ANNOTATE_STORE_FACT, REJECTED_MASKS_FACT,
    REJECTED_PAIRS_FACT, RejectedPairs,
};
use datasets_spec::record::{MaskRow, MotionRow, PairRow};
use datasets_spec::rejected::{MaskPlace, RejectedMask, RejectedMasks};
use datasets_spec::table::{Row, read_column};
use datasets_spec::{Dataset, MASK_DEF_VERSION, MotionId, Split};

use super::exporter::{Clips, Exported, Exporter};
use crate::Error;
use crate::answer::{sentence, stored_parts, stored_words};
use crate::groups::grouped;
use crate::mask::check_range;
use crate::store::AcceptedAnswer;
use crate::transfer::keys::{CANDIDATE, PAIR_SOURCE, key_of_pair, mask_key, pair_id};
use crate::wire::{Answer, TaskKind};

/// Fact of the manifest with the splits that this store has exported, separated by spaces; missing or empty for all.
const SPLITS_FACT: &str = "annotate_splits";

/// Masks of accepted answers by the id of their motion, each with the sequence number of the acceptance. It is `None` if
/// the answer has no masks, and an empty list if the table can hold none of them.
type Described = BTreeMap<String, (i64, Option<Vec<MaskRow>>)>;
/// The tasks about a motion, by its id.
type TasksOf = BTreeMap<String, Vec<i64>>;
/// Judgements of pairs by the id of the pair, each with the sequence number of the acceptance.
type Judged = BTreeMap<String, (i64, Judgement)>;

/// What an accepted answer says of a pair.
enum Judgement {
    /// The pair's new row.
    Kept(PairRow),
    /// Source and target of a pair that is not usable.
    Rejected([MotionId; 2]),
}

impl Exporter<'_> {
    /// Writes the tables `masks` and `pairs` of the dataset in one commit. Motions with an accepted answer get its
    /// masks, the others keep theirs; accepted pairs replace the pairs they judge, and rejected ones leave. Labels whose
    /// acceptance was taken back are removed.
    pub(super) fn dataset(&mut self, transaction: Transaction) -> Result<(), Error> {
        let dataset = Dataset::open(transaction.root())?;
        self.clips = Some(clips_of(&dataset)?);
        let (mut described, judged, tasks) = self.decided()?;
        let mut masks: Vec<MaskRow> = dataset.read(None)?;
        self.leave_to_others(&masks, &tasks, &mut described)?;
        self.leave_rejected(&dataset, &mut described)?;
        self.keep_authors(&masks, &mut described);
        masks.retain(|row| !described.contains_key(row.motion_id.as_str()));
        let mut pairs = self.unjudged(&dataset, &judged)?;
        let rejected = self.rejected(&dataset, &judged)?;
        let unmasked = self.unmasked(&dataset, &described)?;
        self.take_back(&dataset, &mut masks, &mut pairs)?;
        let accepted = described.values().map(|(seq, _)| *seq);
        let accepted = accepted.chain(judged.values().map(|(seq, _)| *seq));
        let newest = accepted.max().unwrap_or(0);
        self.done.count("motions_described", described.len());
        masks.extend(
            described
                .into_values()
                .filter_map(|(_, rows)| rows)
                .flatten(),
        );
        masks.sort_by(|a, b| (&a.motion_id, &a.id).cmp(&(&b.motion_id, &b.id)));
        pairs.extend(judged.into_values().filter_map(|(_, judged)| match judged {
            Judgement::Kept(row) => Some(row),
            Judgement::Rejected(_) => None,
        }));
        pairs.sort_by(|a, b| a.id.cmp(&b.id));
        self.done.count("masks", masks.len());
        self.done.count("pairs", pairs.len());
        let plan = blake3::hash(format!("annotate {masks:?} {pairs:?}").as_bytes());
        let plan = plan.to_hex().to_string();
        let manifest = dataset.manifest();
        let is_there = |table: &str| manifest.plans.get(table) == Some(&plan);
        let is_recorded =
            rejected == manifest.rejected_pairs()? && unmasked == manifest.rejected_masks()?;
        // If an answer is newer than the last export, equal rows are committed again, with the number of the answer:
        // `leave_rejected` compares it with later rejections by others.
        let is_own = manifest.facts.get(ANNOTATE_STORE_FACT) == Some(&self.done.store);
        let written = manifest.facts.get(ANNOTATE_SEQ_FACT);
        let written = written.and_then(|seq| seq.parse::<i64>().ok());
        let is_newer = is_own && written.is_some_and(|written| newest > written);
        if is_there(MaskRow::TABLE) && is_there(PairRow::TABLE) && is_recorded && !is_newer {
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
        let mut facts = BTreeMap::from([
            (ANNOTATE_STORE_FACT.to_owned(), self.done.store.clone()),
            (ANNOTATE_SEQ_FACT.to_owned(), self.done.seq.to_string()),
        ]);
        if manifest.facts.contains_key(ANNOTATE_KNOWN_FACT) {
            facts.insert(ANNOTATE_KNOWN_FACT.to_owned(), self.done.seq.to_string());
        }
        if !is_recorded {
            let rejected = serde_json::to_string(&rejected).expect("texts serialise");
            facts.insert(REJECTED_PAIRS_FACT.to_owned(), rejected);
            let unmasked = serde_json::to_string(&unmasked).expect("texts serialise");
            facts.insert(REJECTED_MASKS_FACT.to_owned(), unmasked);
        }
        let splits = self.written_splits(&manifest.facts);
        if !splits.is_empty() || manifest.facts.contains_key(SPLITS_FACT) {
            facts.insert(SPLITS_FACT.to_owned(), splits);
        }
        transaction.commit(Commit {
            tables,
            plan_hash: plan,
            skeleton,
            facts,
            ..Commit::default()
        })?;
        Ok(())
    }

    /// The splits of this export and of those of this store before it, back to the last export of another store; empty
    /// for all splits.
    fn written_splits(&self, facts: &BTreeMap<String, String>) -> String {
        let is_own = facts.get(ANNOTATE_STORE_FACT) == Some(&self.done.store);
        let before = facts.get(SPLITS_FACT).map_or("", String::as_str);
        if self.splits.is_empty() || (is_own && before.is_empty()) {
            return String::new();
        }
        let before = before
            .split(' ')
            .filter(|split| is_own && !split.is_empty());
        let all: BTreeSet<&str> = before
            .chain(self.splits.iter().map(String::as_str))
            .collect();
        Vec::from_iter(all).join(" ")
    }

    /// The rows of all accepted answers. Two tasks may be about one clip that got another id, or, in a store of an
    /// earlier version, about one candidate. The later decision counts.
    fn decided(&mut self) -> Result<(Described, Judged, TasksOf), Error> {
        let (mut described, mut judged) = (Described::new(), Judged::new());
        let mut tasks = TasksOf::new();
        self.each_accepted(|exporter, accepted| {
            // Others may have changed the label since it was imported; nobody here has judged it.
            if accepted.is_of_dataset() {
                exporter.done.count("labels_left_as_they_are", 1);
                return Ok(());
            }
            count_losses(&accepted, &mut exporter.done);
            if accepted.task.kind == TaskKind::MaskText {
                let motion = exporter.ids(&accepted.task)?.0;
                let is_bare = accepted.answer.fields().masks.is_empty();
                let rows = exporter.mask_rows(&motion, &accepted)?;
                let rows = (!is_bare).then_some(rows);
                tasks
                    .entry(motion.clone())
                    .or_default()
                    .push(accepted.task.id);
                put_later(&mut described, motion, (accepted.seq, rows));
                return Ok(());
            }
            exporter.done.count("pairs_judged", 1);
            let id = pair_id(&accepted.task.key).to_owned();
            if let Some(judgement) = exporter.judgement(&id, &accepted)? {
                put_later(&mut judged, id, (accepted.seq, judgement));
            }
            Ok(())
        })?;
        Ok((described, judged, tasks))
    }

    /// Takes the motions from `described` that have masks of people which this project never had, such as those of
    /// `stance masks --accept` or of another project: their masks stay as they are.
    fn leave_to_others(
        &mut self,
        masks: &[MaskRow],
        tasks: &TasksOf,
        described: &mut Described,
    ) -> Result<(), Error> {
        let of_others = masks.iter().filter(|row| {
            let is_described = described.contains_key(row.motion_id.as_str());
            is_described && row.text_origin == "human" && !self.is_own(&row.author)
        });
        let of_motion = grouped(of_others.map(|row| (row.motion_id.as_str(), row)));
        let mut left: Vec<&MaskRow> = Vec::new();
        for (motion, rows) in of_motion {
            let mut answers = Vec::new();
            for task in &tasks[motion] {
                answers.extend(self.store.answers_ever(*task)?);
            }
            let foreign = rows.into_iter().find(|row| !is_said(row, &answers));
            if foreign.is_some() {
                described.remove(motion);
            }
            left.extend(foreign);
        }
        let message = left.first().map_or_else(String::new, |first| {
            format!(
                "{} motions keep the masks that people accepted outside this project, for example {} by {}; the answers \
                 of this project to them were not written: to write them, reject those masks with \
                 `stance masks --accept`, and reopen the tasks and accept their answers again",
                left.len(),
                first.id,
                first.author
            )
        });
        self.done
            .report("motions_left_to_others", left.len(), message);
        Ok(())
    }

    /// Takes the masks from `described` that somebody else rejected after this project had written them: since its last
    /// export it has no newer answer, and at that export every rejection of what it wrote ended.
    fn leave_rejected(
        &mut self,
        dataset: &Dataset,
        described: &mut Described,
    ) -> Result<(), Error> {
        let manifest = dataset.manifest();
        let is_last = manifest.facts.get(ANNOTATE_STORE_FACT) == Some(&self.done.store);
        let known = manifest.facts.get(ANNOTATE_KNOWN_FACT);
        let known = known.or(manifest.facts.get(ANNOTATE_SEQ_FACT));
        let last: Option<i64> = known.and_then(|seq| seq.parse().ok());
        let Some(last) = last.filter(|_| is_last) else {
            return Ok(());
        };
        let mut lists = manifest.rejected_masks()?;
        lists.remove(&self.done.store);
        let rejections = dataset.rejections(&lists)?;
        let mut left = 0;
        let written = described.values_mut().filter(|(seq, _)| *seq <= last);
        for rows in written.filter_map(|(_, rows)| rows.as_mut()) {
            let before = rows.len();
            rows.retain(|row| !rejections.has(row));
            left += before - rows.len();
        }
        let message = format!(
            "{left} masks of this project stay out of the dataset, because others rejected them after its last export: accept \
             new answers here, or accept them with `stance masks --accept`, to bring them back"
        );
        self.done.report("masks_rejected_by_others", left, message);
        Ok(())
    }

    /// Keeps the author of each mask that was imported as it stands in the dataset: an answer names one author for all
    /// its masks.
    fn keep_authors(&self, masks: &[MaskRow], described: &mut Described) {
        let of_people = masks.iter().filter(|row| row.text_origin == "human");
        let before = grouped(of_people.map(|row| (row.motion_id.as_str(), row)));
        for row in described.values_mut().flat_map(|(_, rows)| rows).flatten() {
            let known = before.get(row.motion_id.as_str()).into_iter().flatten();
            let mut same = known.filter(|known| is_same(known, row));
            if !self.is_own(&row.author)
                && let Some(known) = same.next()
            {
                row.author.clone_from(&known.author);
            }
        }
    }

    /// The pairs of a dataset that no decision is about. A pair of other clips under the id of a kept pair makes room for
    /// it; under that of a rejected one it stays.
    fn unjudged(&mut self, dataset: &Dataset, judged: &Judged) -> Result<Vec<PairRow>, Error> {
        let mut pairs: Vec<PairRow> = dataset.read(None)?;
        // After an export of this store, what people accepted was accepted here.
        let is_own = dataset.manifest().facts.get(ANNOTATE_STORE_FACT) == Some(&self.done.store);
        let (mut replaced, mut reworded, mut contradicted) = (0, 0, 0);
        let said = |pair: &PairRow| {
            let (style, kind) = (pair.style.clone(), pair.edit_type.clone());
            (pair.instruction.clone(), pair.parts.clone(), style, kind)
        };
        pairs.retain(|pair| match judged.get(&pair.id) {
            None => true,
            Some((_, Judgement::Kept(row))) => {
                let is_other = clips_of_pair(row) != clips_of_pair(pair);
                replaced += usize::from(is_other);
                let is_of_others = !is_own && pair.accepted_by.is_some();
                reworded += usize::from(!is_other && is_of_others && said(row) != said(pair));
                false
            }
            Some((_, Judgement::Rejected(clips))) => {
                let stays = *clips != clips_of_pair(pair);
                contradicted += usize::from(!stays && !is_own && pair.accepted_by.is_some());
                stays
            }
        });
        let message = format!(
            "{contradicted} pairs left the dataset that another project may have accepted, because this one rejects them: the \
             next export of that project brings them back, so let one of the two decide"
        );
        self.done
            .report("pairs_rejected_over_others", contradicted, message);
        let message = format!(
            "{reworded} pairs that another project may have accepted have the text, parts, style or type of this one now: the \
             next export of that project brings its own back, so let one of the two decide"
        );
        self.done
            .report("pairs_reworded_over_others", reworded, message);
        let message = format!(
            "{replaced} pairs left the dataset for accepted pairs of the same ids and another source clip"
        );
        self.done.report("replaced", replaced, message);
        Ok(pairs)
    }

    /// The rejected pairs of all stores after this export. The list of this store becomes that of its accepted
    /// rejections; in splits that are not exported it stays. A pair that this store accepts leaves all lists.
    fn rejected(&mut self, dataset: &Dataset, judged: &Judged) -> Result<RejectedPairs, Error> {
        let mut all = dataset.manifest().rejected_pairs()?;
        let mut contradicted = 0;
        let own = all.entry(self.done.store.clone()).or_default();
        own.retain(|[source, _]| self.is_unwanted(source));
        for (id, (_, judgement)) in judged {
            // Two takes that people find too different for a candidate can still be a style pair.
            if let Judgement::Rejected(clips) = judgement
                && !id.starts_with(CANDIDATE)
            {
                own.insert(clips.clone());
            }
        }
        for (_, judgement) in judged.values() {
            if let Judgement::Kept(row) = judgement {
                let clips = clips_of_pair(row);
                let mut is_contradicted = false;
                for (store, list) in &mut all {
                    is_contradicted |= list.remove(&clips) && *store != self.done.store;
                }
                contradicted += usize::from(is_contradicted);
            }
        }
        all.retain(|_, list| !list.is_empty());
        let message = format!(
            "{contradicted} pairs are in the dataset that another project rejected, because this one accepts them: the next \
             export of that project takes them out, so let one of the two decide"
        );
        self.done
            .report("pairs_accepted_over_others", contradicted, message);
        Ok(all)
    }

    /// The rejected masks of all stores and reviewers after this export. The list of this store becomes that of the clips
    /// whose accepted answers have no masks; in splits that are not exported it stays.
    fn unmasked(&self, dataset: &Dataset, described: &Described) -> Result<RejectedMasks, Error> {
        let mut all = dataset.manifest().rejected_masks()?;
        let own = all.entry(self.done.store.clone()).or_default();
        own.retain(|rejected| self.is_unwanted(&rejected.clip));
        let bare = described.iter().filter(|(_, (_, rows))| rows.is_none());
        own.extend(bare.filter_map(|(clip, _)| {
            let (_, content) = self.clips.as_ref()?.get(clip)?;
            Some(RejectedMask {
                clip: MotionId::parse(clip).ok()?,
                content: content.clone(),
                mask: None,
            })
        }));
        // Masks that are accepted now end earlier rejections of them, whoever rejected them.
        let rows = described.values().filter_map(|(_, rows)| rows.as_ref());
        let there: BTreeSet<(&MotionId, Option<MaskPlace>)> = rows
            .flatten()
            .flat_map(|row| {
                [
                    (&row.motion_id, None),
                    (&row.motion_id, Some(MaskPlace::of(row))),
                ]
            })
            .collect();
        for list in all.values_mut() {
            list.retain(|one| !there.contains(&(&one.clip, one.mask.clone())));
        }
        all.retain(|_, list| !list.is_empty());
        Ok(all)
    }

    /// Whether a clip of the dataset is in a split that is not exported.
    fn is_unwanted(&self, clip: &MotionId) -> bool {
        let clips = self.clips.as_ref();
        let clip = clips.and_then(|clips| clips.get(clip.as_str()));
        clip.is_some_and(|(split, _)| !self.wanted(split.as_str()))
    }

    /// Removes the labels that this store wrote and whose acceptance was taken back. A label that another store may have
    /// written stays and is counted: the facts tell what the last export wrote, and the author of a mask tells its store.
    fn take_back(
        &mut self,
        dataset: &Dataset,
        masks: &mut Vec<MaskRow>,
        pairs: &mut Vec<PairRow>,
    ) -> Result<(), Error> {
        let facts = &dataset.manifest().facts;
        let is_last = facts.get(ANNOTATE_STORE_FACT) == Some(&self.done.store);
        let seq = facts.get(ANNOTATE_SEQ_FACT).filter(|_| is_last);
        let seq = seq.and_then(|seq| seq.parse().ok());
        let reopened = self.store.reopened(seq.unwrap_or(i64::MAX))?;
        let splits = facts.get(SPLITS_FACT).filter(|splits| !splits.is_empty());
        let is_written = |split: Split| {
            splits.is_none_or(|splits| splits.split(' ').any(|one| one == split.as_str()))
        };
        let before = masks.len() + pairs.len();
        let mut unsure = 0;
        let mut stays = |key: &str, split: Split, is_own: bool| match reopened.get(key) {
            Some(was_accepted) if is_own || (*was_accepted && is_written(split)) => false,
            Some(_) => {
                unsure += 1;
                true
            }
            None => true,
        };
        masks.retain(|row| {
            // Exports say of every label how it was accepted.
            let is_exported = row.text_origin == "human" && row.accepted_by.is_some();
            let key = mask_key(row.motion_id.as_str());
            !is_exported || stays(&key, row.split, self.is_own(&row.author))
        });
        pairs.retain(|pair| {
            let is_exported = pair.source == PAIR_SOURCE;
            !is_exported || stays(&key_of_pair(&pair.id), pair.split, false)
        });
        let taken_back = before - masks.len() - pairs.len();
        let message = format!(
            "{taken_back} masks and pairs left the dataset, because their acceptance was taken back; `stance masks` \
             and `stance pairs` make automatic ones in their place"
        );
        self.done.report("taken_back", taken_back, message);
        let message = format!(
            "{unsure} masks and pairs stay in the dataset although their tasks were reopened and are not accepted: the \
             last export of this project did not write them; accept other answers to replace them"
        );
        self.done.report("taken_back_but_kept", unsure, message);
        Ok(())
    }

    /// The masks of an accepted answer about a motion that the table can hold.
    fn mask_rows(
        &mut self,
        motion: &str,
        accepted: &AcceptedAnswer,
    ) -> Result<Vec<MaskRow>, Error> {
        let frames = self.frames(&accepted.task)?;
        let mut rows: Vec<MaskRow> = Vec::new();
        for mask in accepted.answer.fields().masks {
            let joints = mask.mask();
            let fits = |range| check_range(range, frames, 1).is_ok();
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
                motion_id: MotionId::parse(motion)?,
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
                accepted_by: Some(accepted.accepted_by().to_owned()),
            });
        }
        Ok(rows)
    }

    /// What an accepted answer says of a pair; `None` if its task has one clip only.
    fn judgement(&self, id: &str, accepted: &AcceptedAnswer) -> Result<Option<Judgement>, Error> {
        let (source, target) = self.ids(&accepted.task)?;
        let Some(target) = target else {
            return Ok(None);
        };
        let (source_id, target_id) = (MotionId::parse(&source)?, MotionId::parse(&target)?);
        if accepted.answer.is_reject() {
            return Ok(Some(Judgement::Rejected([source_id, target_id])));
        }
        let said = accepted.answer.fields();
        let kind = match accepted.task.kind {
            TaskKind::Style => "style",
            TaskKind::Pair | TaskKind::MaskText => "fine-grained",
        };
        Ok(Some(Judgement::Kept(PairRow {
            id: id.to_owned(),
            split: accepted.task.split.parse()?,
            source: PAIR_SOURCE.to_owned(),
            kind: kind.to_owned(),
            source_id,
            target_id,
            style: said.style.map(str::to_owned),
            parts: stored_parts(&said),
            instruction: said.text.to_owned(),
            edit_type: said.edit_type.map(|kind| kind.to_string()),
            accepted_by: Some(accepted.accepted_by().to_owned()),
        })))
    }
}

/// Whether one of some answers has a mask with the joints, the range and the text of a row.
fn is_said(row: &MaskRow, answers: &[Answer]) -> bool {
    let range = row.start.zip(row.end).map(|(start, end)| [start, end]);
    let mut masks = answers.iter().flat_map(|answer| answer.fields().masks);
    masks.any(|mask| {
        let joints = mask.mask();
        joints.hard().names() == row.hard_joints
            && joints.soft().names() == row.soft_joints
            && mask.range == range
            && stored_words(&mask.text) == stored_words(&row.text)
    })
}

/// Whether two rows say the same of the same frames.
fn is_same(a: &MaskRow, b: &MaskRow) -> bool {
    a.hard_joints == b.hard_joints
        && a.soft_joints == b.soft_joints
        && (a.start, a.end) == (b.start, b.end)
        && stored_words(&a.text) == stored_words(&b.text)
}

fn clips_of_pair(pair: &PairRow) -> [MotionId; 2] {
    [pair.source_id.clone(), pair.target_id.clone()]
}

/// Puts a decision under an id, unless a later one is there.
fn put_later<T>(decisions: &mut BTreeMap<String, (i64, T)>, id: String, new: (i64, T)) {
    if decisions.get(&id).is_none_or(|(seq, _)| *seq < new.0) {
        decisions.insert(id, new);
    }
}

/// The clips of a dataset.
fn clips_of(dataset: &Dataset) -> Result<Clips, Error> {
    let mut clips = Clips::new();
    for (path, _) in dataset.files(MotionRow::TABLE, None) {
        let ids: Vec<MotionId> = read_column::<MotionRow, _>(&path, "id")?;
        let splits: Vec<Split> = read_column::<MotionRow, _>(&path, "split")?;
        let hashes: Vec<String> = read_column::<MotionRow, _>(&path, "content_hash")?;
        let ids = ids.into_iter().map(|id| id.to_string());
        clips.extend(ids.zip(splits.into_iter().zip(hashes)));
    }
    Ok(clips)
}

/// Counts the parts of an answer that the dataset cannot hold. A rejected pair is a fact of the manifest, unless it is a
/// candidate.
fn count_losses(accepted: &AcceptedAnswer, done: &mut Exported) {
    let said = accepted.answer.fields();
    let is_candidate = pair_id(&accepted.task.key).starts_with(CANDIDATE);
    for (what, is_lost) in [
        ("left_out_notes", !said.note.is_empty()),
        ("left_out_reasons", said.count_reason.is_some()),
        ("left_out_extents", said.extent.is_some()),
        (
            "left_out_rejected_candidates",
            is_candidate && accepted.answer.is_reject(),
        ),
    ] {
        done.lose(what, usize::from(is_lost));
    }
}
