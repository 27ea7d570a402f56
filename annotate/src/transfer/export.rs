//! Accepted answers into files and into the dataset.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

use datasets_spec::dataset::commit_rows;
use datasets_spec::record::{MaskRow, PairRow};
use datasets_spec::table::{Row, write_rows};
use datasets_spec::{Dataset, JointSet, MASK_DEF_VERSION, MotionId, Split};
use serde::Serialize;
use serde_json::json;

use super::import::PAIR_SOURCE;
use super::release::{self, Said};
use super::tables::{AgreementRow, AnnotationRow, EventRow, LabelRow, RejectRow};
use crate::Error;
use crate::answer::mask_of;
use crate::quality::{Figures, draft_distance};
use crate::store::{AcceptedAnswer, MotionRecord, Store, TaskRecord};
use crate::wire::{Answer, Estimate, ExportFormat, Extent, TaskKind, Verdict};

/// Tasks read at a time.
const BATCH: usize = 2000;

/// What is exported.
#[derive(Clone, Debug)]
pub struct Selection {
    /// Layout.
    pub format: ExportFormat,
    /// Splits; all if empty.
    pub splits: Vec<String>,
    /// Whether the log goes along.
    pub events: bool,
}

/// What an export did.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Exported {
    /// Rows by table, and what was left out.
    pub counts: BTreeMap<String, i64>,
    /// What was left out and why, in words.
    pub messages: Vec<String>,
    /// Names of the files.
    pub files: Vec<String>,
}

impl Exported {
    fn count(&mut self, what: &str, count: usize) {
        *self.counts.entry(what.to_owned()).or_default() += count as i64;
    }
}

/// A person as the tables name them: the same in every export of a store, and not their name.
fn pseudonym(user: i64) -> String {
    if user == 0 {
        "imported".to_owned()
    } else {
        format!("a{user:03}")
    }
}

struct Exporter<'a> {
    store: &'a dyn Store,
    splits: &'a [String],
    motions: BTreeMap<String, MotionRecord>,
    done: Exported,
}

impl Exporter<'_> {
    fn wanted(&self, split: &str) -> bool {
        self.splits.is_empty() || self.splits.iter().any(|wanted| wanted == split)
    }

    /// A motion, which has to be of the split its task says: nothing of a test clip may end up in train.
    fn motion(&mut self, hash: &str, split: &str) -> Result<MotionRecord, Error> {
        if !self.motions.contains_key(hash) {
            for motion in self.store.motions(vec![hash.to_owned()])? {
                self.motions.insert(motion.hash.clone(), motion);
            }
        }
        let motion = self
            .motions
            .get(hash)
            .ok_or_else(|| Error::not_found("motion"))?;
        if motion.split != split {
            return Err(Error::Import {
                what: format!("motion {} into split {split}", motion.id),
                problem: format!(
                    "it is of split {}; correct the pair in the dataset",
                    motion.split
                ),
            });
        }
        Ok(motion.clone())
    }

    fn ids(&mut self, task: &TaskRecord) -> Result<(String, Option<String>), Error> {
        let source = self.motion(&task.source, &task.split)?.id;
        let target = match &task.target {
            Some(hash) => Some(self.motion(hash, &task.split)?.id),
            None => None,
        };
        Ok((source, target))
    }

    /// All accepted answers of the splits, by the key of their task.
    fn accepted(&self) -> Result<Vec<AcceptedAnswer>, Error> {
        let mut all = Vec::new();
        let mut after = 0;
        loop {
            let some = self.store.accepted(after, BATCH)?;
            let Some(last) = some.last() else { break };
            after = last.task.id;
            all.extend(
                some.into_iter()
                    .filter(|answer| self.wanted(&answer.task.split)),
            );
        }
        all.sort_by(|a, b| a.task.key.cmp(&b.task.key));
        Ok(all)
    }
}

/// Exports accepted answers. `folder` takes the files; layout `dataset` writes the tables `masks` and
/// `pairs` of the dataset instead.
///
/// # Errors
/// A file cannot be written, a pair crosses splits, the dataset is locked, or the store fails.
pub fn export(
    store: &dyn Store,
    dataset: &Path,
    folder: &Path,
    selection: &Selection,
    holder: &str,
) -> Result<Exported, Error> {
    let mut exporter = Exporter {
        store,
        splits: &selection.splits,
        motions: BTreeMap::new(),
        done: Exported::default(),
    };
    match selection.format {
        ExportFormat::Dataset => exporter.dataset(dataset, holder)?,
        ExportFormat::Parquet => exporter.parquet(folder, selection.events)?,
        ExportFormat::Stance => exporter.stance(folder)?,
        ExportFormat::Csv => exporter.csv(folder)?,
    }
    Ok(exporter.done)
}

/// Writes a file whole or not at all.
fn write_file(
    folder: &Path,
    name: &str,
    write: impl FnOnce(&mut File, &Path) -> Result<(), Error>,
) -> Result<(), Error> {
    std::fs::create_dir_all(folder).map_err(Error::io("create folder", folder))?;
    let path: PathBuf = folder.join(name);
    let temporary = folder.join(format!(".{name}.tmp"));
    let mut file = File::create(&temporary).map_err(Error::io("create", &temporary))?;
    write(&mut file, &path)?;
    file.sync_all().map_err(Error::io("write", &temporary))?;
    std::fs::rename(&temporary, &path).map_err(Error::io("rename", &path))
}

impl Exporter<'_> {
    fn table<R: Row>(&mut self, folder: &Path, rows: &[R]) -> Result<(), Error> {
        let name = format!("{}.parquet", R::TABLE);
        let facts = [
            ("tool", format!("stance {}", env!("CARGO_PKG_VERSION"))),
            ("mask_def_version", MASK_DEF_VERSION.to_string()),
        ];
        write_file(folder, &name, |file, path| {
            write_rows(file, path, rows, &facts)?;
            Ok(())
        })?;
        self.done.count(R::TABLE, rows.len());
        self.done.files.push(name);
        Ok(())
    }

    fn annotations(&mut self) -> Result<Vec<AnnotationRow>, Error> {
        let mut rows = Vec::new();
        for accepted in self.accepted()? {
            let (motion_id, target_id) = self.ids(&accepted.task)?;
            let task = &accepted.task;
            let empty = AnnotationRow {
                task: task.key.clone(),
                kind: task.kind.to_string(),
                motion_id,
                target_id,
                split: task.split.clone(),
                category: task.category.clone(),
                hint: task.hint.clone(),
                source_style: task.style.clone(),
                number: 0,
                count: 1,
                verdict: None,
                parts: Vec::new(),
                hard_joints: Vec::new(),
                soft_joints: Vec::new(),
                mask_def_version: MASK_DEF_VERSION,
                text: String::new(),
                edit_type: None,
                style: None,
                extent: None,
                count_reason: None,
                note: String::new(),
                author: pseudonym(accepted.author),
                merged: u32::from(accepted.merged),
                extra: task.extra.as_ref().map(ToString::to_string),
            };
            match accepted.answer {
                Answer::MaskText {
                    masks,
                    count_reason,
                    note,
                } => {
                    let base = AnnotationRow {
                        count: masks.len() as u32,
                        count_reason: count_reason.map(|reason| reason.to_string()),
                        note,
                        ..empty
                    };
                    if masks.is_empty() {
                        rows.push(base.clone());
                    }
                    for (number, mask) in masks.into_iter().enumerate() {
                        let joints = mask_of(&mask.parts, mask.soft);
                        rows.push(AnnotationRow {
                            number: number as u32,
                            hard_joints: JointSet::names(joints.hard()),
                            soft_joints: JointSet::names(joints.soft()),
                            parts: mask.parts,
                            text: mask.text,
                            ..base.clone()
                        });
                    }
                }
                Answer::Pair {
                    verdict,
                    parts,
                    edit_type,
                    text,
                    note,
                    ..
                } => rows.push(AnnotationRow {
                    verdict: Some(verdict.to_string()),
                    hard_joints: JointSet::names(mask_of(&parts, true).hard()),
                    soft_joints: JointSet::names(mask_of(&parts, true).soft()),
                    parts,
                    edit_type: edit_type.map(|kind| kind.to_string()),
                    text,
                    note,
                    ..empty
                }),
                Answer::Style {
                    verdict,
                    parts,
                    style,
                    extent,
                    text,
                    note,
                    ..
                } => rows.push(AnnotationRow {
                    verdict: Some(verdict.to_string()),
                    hard_joints: JointSet::names(mask_of(&parts, true).hard()),
                    soft_joints: JointSet::names(mask_of(&parts, true).soft()),
                    parts,
                    style,
                    extent: extent.map(|extent| extent.to_string()),
                    text,
                    note,
                    ..empty
                }),
            }
        }
        Ok(rows)
    }

    fn labels(&mut self) -> Result<Vec<LabelRow>, Error> {
        let mut rows = Vec::new();
        let mut after = 0;
        loop {
            let some = self.store.labels(after, BATCH)?;
            let Some(last) = some.last() else { break };
            after = last.task;
            for label in some {
                if !self.wanted(&label.split) {
                    continue;
                }
                let task = self.store.task_record(label.task)?;
                let (motion_id, target_id) = self.ids(&task)?;
                let answer = &label.revision.answer;
                rows.push(LabelRow {
                    task: task.key,
                    kind: label.kind.to_string(),
                    motion_id,
                    target_id,
                    split: label.split,
                    author: pseudonym(label.revision.author),
                    state: label.revision.state.to_string(),
                    draft_distance: draft_distance(self.store, answer)?,
                    answer: serde_json::to_string(answer).unwrap_or_default(),
                    secs: label.revision.secs,
                    blind: u32::from(label.blind),
                    gold: u32::from(label.gold),
                    at: u64::try_from(label.revision.at).unwrap_or(0),
                });
            }
        }
        rows.sort_by(|a, b| (&a.task, &a.author).cmp(&(&b.task, &b.author)));
        Ok(rows)
    }

    fn rejects(&mut self) -> Result<Vec<RejectRow>, Error> {
        let mut rows = Vec::new();
        for reject in self.store.rejects()? {
            let task = reject.task;
            if !self.wanted(&task.split) || task.gold.is_some() {
                continue;
            }
            let (motion_id, target_id) = self.ids(&task)?;
            rows.push(RejectRow {
                task: task.key,
                kind: task.kind.to_string(),
                motion_id,
                target_id,
                split: task.split,
                reason: reject.reason,
                note: reject.note,
                author: pseudonym(reject.user.unwrap_or(0)),
            });
        }
        for accepted in self.accepted()? {
            let Some(verdict) = accepted
                .answer
                .verdict()
                .filter(|verdict| *verdict != Verdict::Keep)
            else {
                continue;
            };
            let (motion_id, target_id) = self.ids(&accepted.task)?;
            rows.push(RejectRow {
                task: accepted.task.key,
                kind: accepted.task.kind.to_string(),
                motion_id,
                target_id,
                split: accepted.task.split,
                reason: verdict.to_string(),
                note: String::new(),
                author: pseudonym(accepted.author),
            });
        }
        rows.sort_by(|a, b| (&a.task, &a.author, &a.reason).cmp(&(&b.task, &b.author, &b.reason)));
        Ok(rows)
    }

    fn parquet(&mut self, folder: &Path, events: bool) -> Result<(), Error> {
        let annotations = self.annotations()?;
        self.table(folder, &annotations)?;
        let labels = self.labels()?;
        self.table(folder, &labels)?;
        let rejects = self.rejects()?;
        self.table(folder, &rejects)?;
        let agreement = agreement_rows(&Figures::of(self.store)?);
        self.table(folder, &agreement)?;
        if events {
            let mut rows = Vec::new();
            let mut after = 0;
            loop {
                let some = self.store.log(after, BATCH)?;
                let Some(last) = some.last() else { break };
                after = last.seq;
                rows.extend(some.into_iter().map(|entry| EventRow {
                    seq: u64::try_from(entry.seq).unwrap_or(0),
                    at: u64::try_from(entry.at).unwrap_or(0),
                    actor: entry.actor.map(pseudonym),
                    kind: entry.kind,
                    task: entry.task.and_then(|task| u64::try_from(task).ok()),
                    body: entry.body.to_string(),
                }));
            }
            self.table(folder, &rows)?;
        }
        Ok(())
    }

    fn json_file(
        &mut self,
        folder: &Path,
        name: &str,
        value: &serde_json::Value,
    ) -> Result<(), Error> {
        write_file(folder, name, |file, path| {
            let mut text = serde_json::to_vec_pretty(value)
                .map_err(|error| Error::io("write", path)(error.into()))?;
            text.push(b'\n');
            file.write_all(&text).map_err(Error::io("write", path))
        })?;
        self.done.files.push(name.to_owned());
        Ok(())
    }

    fn stance(&mut self, folder: &Path) -> Result<(), Error> {
        let mut said: BTreeMap<String, Said> = BTreeMap::new();
        let mut pairs = Vec::new();
        let mut hard_only = 0;
        for accepted in self.accepted()? {
            let (motion, target) = self.ids(&accepted.task)?;
            let extra = accepted.task.extra.clone();
            match accepted.answer {
                Answer::MaskText { masks, .. } => {
                    hard_only += masks.iter().filter(|mask| !mask.soft).count();
                    said.insert(motion, Said { masks, extra });
                }
                Answer::Pair {
                    verdict: Verdict::Keep,
                    parts,
                    text,
                    ..
                } => pairs.push(json!({
                    "kind": "fine-grained", "src": motion, "tgt": target,
                    "body_part": parts.join("+"), "text": text, "split": accepted.task.split,
                })),
                Answer::Style {
                    verdict: Verdict::Keep,
                    parts,
                    text,
                    style,
                    ..
                } => {
                    let style = style.unwrap_or_default();
                    pairs.push(json!({
                        "kind": "style", "name": format!("{motion}_{style}"), "src": motion, "tgt": target,
                        "style": style, "body_part": parts.join("+"), "text": text, "split": accepted.task.split,
                    }));
                }
                Answer::Pair { .. } | Answer::Style { .. } => self.done.count("rejected_pairs", 1),
            }
        }
        if hard_only > 0 {
            self.done.count("masks_without_ring", hard_only);
            self.done.messages.push(format!(
                "{hard_only} masks have their soft ring switched off, which this layout cannot say"
            ));
        }
        self.done.count("motions", said.len());
        self.done.count("pairs", pairs.len());
        let (masks, texts) = release::write(&said);
        self.json_file(folder, "mask_all.json", &masks)?;
        self.json_file(folder, "part_annotations.json", &texts)?;
        self.json_file(folder, "pairs.json", &json!(pairs))
    }

    fn csv(&mut self, folder: &Path) -> Result<(), Error> {
        let rows = self.labels()?;
        self.done.count("labels", rows.len());
        self.done.files.push("labels.csv".to_owned());
        write_file(folder, "labels.csv", |file, path| {
            let mut text = "task,kind,motion_id,target_id,split,author,state,secs,draft_distance,at,answer\r\n".to_owned();
            for row in rows {
                let cells = [
                    row.task,
                    row.kind,
                    row.motion_id,
                    row.target_id.unwrap_or_default(),
                    row.split,
                    row.author,
                    row.state,
                    row.secs.to_string(),
                    row.draft_distance
                        .map_or(String::new(), |distance| distance.to_string()),
                    row.at.to_string(),
                    row.answer,
                ];
                text += &cells.map(|cell| csv_cell(&cell)).join(",");
                text += "\r\n";
            }
            file.write_all(text.as_bytes())
                .map_err(Error::io("write", path))
        })
    }

    /// Writes the tables `masks` and `pairs` of the dataset: motions with an accepted answer get its
    /// masks, the others keep theirs; accepted pairs take the place of the ones they judged.
    fn dataset(&mut self, root: &Path, holder: &str) -> Result<(), Error> {
        let dataset = Dataset::open(root)?;
        let mut masks: Vec<MaskRow> = Vec::new();
        let mut pairs: Vec<PairRow> = Vec::new();
        let mut answered: BTreeSet<String> = BTreeSet::new();
        let mut judged: BTreeSet<String> = BTreeSet::new();
        for accepted in self.accepted()? {
            let (motion, target) = self.ids(&accepted.task)?;
            let key = accepted.task.key.clone();
            let split: Split = accepted.task.split.parse()?;
            let author = pseudonym(accepted.author);
            if accepted.task.kind == TaskKind::MaskText {
                answered.insert(motion.clone());
                masks.extend(mask_rows(
                    &motion,
                    split,
                    &author,
                    &accepted.answer,
                    &mut self.done,
                )?);
                continue;
            }
            self.done.count("pairs_judged", 1);
            if let Some(id) = key.strip_prefix("pair:") {
                judged.insert(id.to_owned());
            }
            pairs.extend(pair_row(&key, &motion, target, split, &accepted.answer)?);
        }
        let mut imported = masks;
        imported.extend(
            dataset
                .read::<MaskRow>(None)?
                .into_iter()
                .filter(|row| !answered.contains(row.motion_id.as_str())),
        );
        imported.sort_by(|a, b| (&a.motion_id, &a.id).cmp(&(&b.motion_id, &b.id)));
        let old_pairs: Vec<PairRow> = dataset.read(None)?;
        let ids: BTreeSet<String> = pairs.iter().map(|pair| pair.id.clone()).collect();
        pairs.extend(
            old_pairs
                .into_iter()
                .filter(|pair| !judged.contains(&pair.id) && !ids.contains(&pair.id)),
        );
        pairs.sort_by(|a, b| a.id.cmp(&b.id));
        self.done.count("masks", imported.len());
        self.done.count("motions_described", answered.len());
        self.done.count("pairs", pairs.len());
        let skeleton = dataset.skeleton()?;
        let plan = |table: &str, rows: &dyn std::fmt::Debug| {
            blake3::hash(format!("annotate {table} {rows:?}").as_bytes())
                .to_hex()
                .to_string()
        };
        let mask_split = |row: &MaskRow| row.split;
        let pair_split = |row: &PairRow| row.split;
        let (mask_plan, pair_plan) = (plan("masks", &imported), plan("pairs", &pairs));
        commit_rows(
            root,
            &imported,
            Some(mask_split),
            &skeleton,
            &mask_plan,
            holder,
        )?;
        commit_rows(
            root,
            &pairs,
            Some(pair_split),
            &skeleton,
            &pair_plan,
            holder,
        )?;
        Ok(())
    }
}

fn mask_rows(
    motion: &str,
    split: Split,
    author: &str,
    answer: &Answer,
    done: &mut Exported,
) -> Result<Vec<MaskRow>, Error> {
    let Answer::MaskText { masks, .. } = answer else {
        return Ok(Vec::new());
    };
    let mut rows: Vec<MaskRow> = Vec::new();
    for mask in masks {
        let joints = mask_of(&mask.parts, mask.soft);
        if joints.is_empty() || mask.text.trim().is_empty() {
            // A release may name a mask and say nothing of it; the composer needs a text.
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
            mask_def_version: MASK_DEF_VERSION,
            text: mask.text.trim().to_owned(),
            text_origin: "human".to_owned(),
            author: author.to_owned(),
        });
    }
    Ok(rows)
}

fn pair_row(
    key: &str,
    motion: &str,
    target: Option<String>,
    split: Split,
    answer: &Answer,
) -> Result<Option<PairRow>, Error> {
    let (named, text, style, kind) = match answer {
        Answer::Pair {
            verdict: Verdict::Keep,
            parts,
            text,
            ..
        } => (parts.clone(), text, None, "fine-grained"),
        Answer::Style {
            verdict: Verdict::Keep,
            parts,
            text,
            style,
            extent,
            ..
        } => {
            // Parts that were not named follow from the extent.
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
            (named, text, style.clone(), "style")
        }
        _ => return Ok(None),
    };
    let Some(target) = target else {
        return Ok(None);
    };
    Ok(Some(PairRow {
        id: key.strip_prefix("pair:").unwrap_or(key).to_owned(),
        split,
        source: PAIR_SOURCE.to_owned(),
        kind: kind.to_owned(),
        source_id: MotionId::parse(motion)?,
        target_id: MotionId::parse(&target)?,
        style,
        parts: named,
        instruction: text.clone(),
    }))
}

fn agreement_rows(figures: &Figures) -> Vec<AgreementRow> {
    let mut rows = Vec::new();
    let mut put = |item: &str, figure: &str, estimate: Option<Estimate>, items: usize| {
        rows.push(AgreementRow {
            item: item.to_owned(),
            figure: figure.to_owned(),
            value: estimate.map(|found| found.value),
            low: estimate.map(|found| found.low),
            high: estimate.map(|found| found.high),
            items: items as u64,
        });
    };
    let agreement = &figures.agreement;
    for part in agreement.parts.iter().chain(&agreement.verdicts) {
        for (figure, estimate) in [
            ("raw", part.raw),
            ("krippendorff_alpha", part.krippendorff_alpha),
            ("fleiss_kappa", part.fleiss_kappa),
            ("cohen_kappa", part.cohen_kappa),
            ("gwet_ac1", part.gwet_ac1),
        ] {
            put(&part.part, figure, estimate, part.items);
        }
    }
    put(
        "masks",
        "jaccard",
        agreement.jaccard,
        agreement.shared_items,
    );
    put(
        "masks",
        "alpha_masi",
        agreement.alpha_masi,
        agreement.shared_items,
    );
    rows
}

/// A cell that no spreadsheet takes for a formula.
fn csv_cell(text: &str) -> String {
    let formula =
        text.starts_with(['=', '+', '-', '@', '\t', '\r']) && text.parse::<f64>().is_err();
    let guarded = if formula {
        format!("'{text}")
    } else {
        text.to_owned()
    };
    if guarded.contains(['"', ',', '\n', '\r']) {
        format!("\"{}\"", guarded.replace('"', "\"\""))
    } else {
        guarded
    }
}

#[cfg(test)]
mod tests {
    use super::csv_cell;

    #[test]
    fn cells_are_no_formulas() {
        for (text, cell) in [
            ("=1+1", "'=1+1"),
            ("@x", "'@x"),
            ("-0.5", "-0.5"),
            ("-x", "'-x"),
            ("a,b", "\"a,b\""),
            ("=\"a\"", "\"'=\"\"a\"\"\""),
            ("plain", "plain"),
        ] {
            assert_eq!(csv_cell(text), cell);
        }
    }
}
