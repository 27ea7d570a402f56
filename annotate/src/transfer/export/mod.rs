//! Export of answers into files and into the dataset.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use datasets_spec::dataset::commit_rows;
use datasets_spec::record::{MaskRow, PairRow};
use datasets_spec::table::{Row, RowWriter};
use datasets_spec::{Dataset, JointSet, MASK_DEF_VERSION, MotionId, Split};
use serde::ser::{SerializeMap, SerializeSeq};
use serde::{Serialize, Serializer};
use serde_json::json;

use super::import::PAIR_SOURCE;
use super::release::{self, Said};
use super::tables::{AgreementRow, AnnotationRow, EventRow, LabelRow, RejectRow};
use crate::Error;
use crate::answer::mask_of;
use crate::quality::{Figures, draft_distance};
use crate::store::{AcceptedAnswer, KeyRange, MotionRecord, Store, TaskRecord};
use crate::wire::{Answer, Estimate, ExportFormat, Extent, TaskKind, Verdict};

/// Tasks read at a time.
const BATCH: usize = 2000;

/// Export settings.
#[derive(Clone, Debug)]
pub struct Selection {
    /// Layout.
    pub format: ExportFormat,
    /// Splits; all if empty.
    pub splits: Vec<String>,
    /// Whether to export the log too.
    pub events: bool,
}

/// Result of an export.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Exported {
    /// Counts of rows by table, and of omitted items.
    pub counts: BTreeMap<String, i64>,
    /// Messages about omitted items.
    pub messages: Vec<String>,
    /// Names of the files.
    pub files: Vec<String>,
}

impl Exported {
    fn count(&mut self, what: &str, count: usize) {
        *self.counts.entry(what.to_owned()).or_default() += count as i64;
    }
}

/// Pseudonym of a person: the same in every export of a store.
fn pseudonym(user: i64) -> String {
    if user == 0 {
        "imported".to_owned()
    } else {
        format!("a{user:03}")
    }
}

/// Receives the next row of a table.
type Put<'a, R> = &'a mut dyn FnMut(R) -> Result<(), Error>;

struct Exporter<'a> {
    store: &'a Store,
    splits: &'a [String],
    /// Motions of the current tasks.
    motions: BTreeMap<String, MotionRecord>,
    done: Exported,
}

impl Exporter<'_> {
    fn wanted(&self, split: &str) -> bool {
        self.splits.is_empty() || self.splits.iter().any(|wanted| wanted == split)
    }

    /// A motion. Its split must equal that of its task, so that no test clip ends up in train.
    fn motion(&self, hash: &str, split: &str) -> Result<&MotionRecord, Error> {
        let motion = self
            .motions
            .get(hash)
            .ok_or_else(|| Error::not_found("motion"))?;
        if motion.split != split {
            return Err(Error::Import {
                what: format!("motion {} into split {split}", motion.id),
                problem: format!(
                    "its split is {}; correct the pair in the dataset",
                    motion.split
                ),
            });
        }
        Ok(motion)
    }

    fn ids(&self, task: &TaskRecord) -> Result<(String, Option<String>), Error> {
        let source = self.motion(&task.source, &task.split)?.id.clone();
        let target = match &task.target {
            Some(hash) => Some(self.motion(hash, &task.split)?.id.clone()),
            None => None,
        };
        Ok((source, target))
    }

    /// Visits the tasks in the order of their keys, a batch at a time, so that memory does not grow with their
    /// number.
    fn each_range<E: From<Error>>(
        &mut self,
        mut each: impl FnMut(&mut Self, &KeyRange) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut after = String::new();
        while let Some(keys) = self.store.next_keys(&after, BATCH)? {
            each(self, &keys)?;
            after = keys.up_to;
        }
        Ok(())
    }

    /// The accepted answers of the splits in a range, by the key of their task.
    fn accepted(&mut self, keys: &KeyRange) -> Result<Vec<AcceptedAnswer>, Error> {
        let mut all = self.store.accepted(keys)?;
        all.retain(|answer| self.wanted(&answer.task.split));
        self.meet(all.iter().map(|answer| &answer.task))?;
        Ok(all)
    }

    /// Loads the motions of a batch of tasks and drops the others.
    fn meet<'t>(&mut self, tasks: impl Iterator<Item = &'t TaskRecord>) -> Result<(), Error> {
        let hashes: BTreeSet<&String> = tasks
            .flat_map(|task| [Some(&task.source), task.target.as_ref()])
            .flatten()
            .collect();
        let found = self.store.motions(hashes.into_iter().cloned().collect())?;
        self.motions = found
            .into_iter()
            .map(|motion| (motion.hash.clone(), motion))
            .collect();
        Ok(())
    }

    /// Visits the accepted answers of the splits, by the key of their task.
    fn each_accepted<E: From<Error>>(
        &mut self,
        mut each: impl FnMut(&mut Self, AcceptedAnswer) -> Result<(), E>,
    ) -> Result<(), E> {
        self.each_range(|exporter, keys| {
            for accepted in exporter.accepted(keys)? {
                each(exporter, accepted)?;
            }
            Ok(())
        })
    }
}

/// Exports accepted answers. `folder` takes the files; layout `dataset` writes the tables `masks` and
/// `pairs` of the dataset instead.
///
/// # Errors
/// A file cannot be written, a pair crosses splits, the dataset is locked, or the store fails.
pub fn export(
    store: &Store,
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

/// Writes JSON value by value.
type JsonWriter<'a> =
    serde_json::Serializer<BufWriter<&'a mut File>, serde_json::ser::PrettyFormatter<'static>>;

/// Error while writing JSON.
enum JsonError {
    Json(serde_json::Error),
    Other(Error),
}

impl From<serde_json::Error> for JsonError {
    fn from(error: serde_json::Error) -> Self {
        Self::Json(error)
    }
}

impl From<Error> for JsonError {
    fn from(error: Error) -> Self {
        Self::Other(error)
    }
}

/// Writes a file of JSON value by value, whole or not at all.
fn write_json(
    folder: &Path,
    name: &str,
    write: impl FnOnce(&mut JsonWriter<'_>) -> Result<(), JsonError>,
) -> Result<(), Error> {
    write_file(folder, name, |file, path| {
        let mut json = serde_json::Serializer::pretty(BufWriter::new(file));
        write(&mut json).map_err(|error| match error {
            JsonError::Json(error) => Error::io("write", path)(error.into()),
            JsonError::Other(error) => error,
        })?;
        let mut file = json.into_inner();
        file.write_all(b"\n")
            .and_then(|()| file.flush())
            .map_err(Error::io("write", path))
    })
}

impl Exporter<'_> {
    /// Writes a table row by row.
    fn table<R: Row>(
        &mut self,
        folder: &Path,
        fill: impl FnOnce(&mut Self, Put<'_, R>) -> Result<(), Error>,
    ) -> Result<(), Error> {
        let name = format!("{}.parquet", R::TABLE);
        let facts = [
            ("tool", format!("stance {}", env!("CARGO_PKG_VERSION"))),
            ("mask_def_version", MASK_DEF_VERSION.to_string()),
        ];
        let mut count = 0;
        write_file(folder, &name, |file, path| {
            let mut writer = RowWriter::new(file, path, &facts)?;
            fill(self, &mut |row| {
                count += 1;
                Ok(writer.push(row)?)
            })?;
            writer.finish()?;
            Ok(())
        })?;
        self.done.count(R::TABLE, count);
        self.done.files.push(name);
        Ok(())
    }

    fn annotations(&mut self, put: Put<'_, AnnotationRow>) -> Result<(), Error> {
        self.each_accepted(|exporter, accepted| exporter.annotation(accepted, put))
    }

    fn annotation(
        &mut self,
        accepted: AcceptedAnswer,
        put: Put<'_, AnnotationRow>,
    ) -> Result<(), Error> {
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
                    put(base.clone())?;
                }
                for (number, mask) in masks.into_iter().enumerate() {
                    let joints = mask_of(&mask.parts, mask.soft);
                    put(AnnotationRow {
                        number: number as u32,
                        hard_joints: JointSet::names(joints.hard()),
                        soft_joints: JointSet::names(joints.soft()),
                        parts: mask.parts,
                        text: mask.text,
                        ..base.clone()
                    })?;
                }
            }
            Answer::Pair {
                verdict,
                parts,
                edit_type,
                text,
                note,
                ..
            } => put(AnnotationRow {
                verdict: Some(verdict.to_string()),
                hard_joints: JointSet::names(mask_of(&parts, true).hard()),
                soft_joints: JointSet::names(mask_of(&parts, true).soft()),
                parts,
                edit_type: edit_type.map(|kind| kind.to_string()),
                text,
                note,
                ..empty
            })?,
            Answer::Style {
                verdict,
                parts,
                style,
                extent,
                text,
                note,
                ..
            } => put(AnnotationRow {
                verdict: Some(verdict.to_string()),
                hard_joints: JointSet::names(mask_of(&parts, true).hard()),
                soft_joints: JointSet::names(mask_of(&parts, true).soft()),
                parts,
                style,
                extent: extent.map(|extent| extent.to_string()),
                text,
                note,
                ..empty
            })?,
        }
        Ok(())
    }

    fn labels(&mut self, put: Put<'_, LabelRow>) -> Result<(), Error> {
        self.each_range(|exporter, keys| {
            let mut rows = Vec::new();
            let labels = exporter.store.labels_of(keys)?;
            exporter.meet(labels.iter().map(|(task, _)| task))?;
            for (task, label) in labels {
                if !exporter.wanted(&task.split) {
                    continue;
                }
                let (motion_id, target_id) = exporter.ids(&task)?;
                let answer = &label.revision.answer;
                rows.push(LabelRow {
                    task: task.key,
                    kind: label.kind.to_string(),
                    motion_id,
                    target_id,
                    split: label.split,
                    author: pseudonym(label.revision.author),
                    state: label.revision.state.to_string(),
                    draft_distance: draft_distance(exporter.store, answer)?,
                    answer: serde_json::to_string(answer).unwrap_or_default(),
                    secs: label.revision.secs,
                    blind: u32::from(label.blind),
                    gold: u32::from(label.gold),
                    at: u64::try_from(label.revision.at).unwrap_or(0),
                });
            }
            rows.sort_by(|a, b| (&a.task, &a.author).cmp(&(&b.task, &b.author)));
            rows.into_iter().try_for_each(&mut *put)
        })
    }

    fn rejects(&mut self, put: Put<'_, RejectRow>) -> Result<(), Error> {
        self.each_range(|exporter, keys| {
            let mut rows = exporter.rejects_of(keys)?;
            rows.sort_by(|a, b| {
                (&a.task, &a.author, &a.reason).cmp(&(&b.task, &b.author, &b.reason))
            });
            rows.into_iter().try_for_each(&mut *put)
        })
    }

    fn rejects_of(&mut self, keys: &KeyRange) -> Result<Vec<RejectRow>, Error> {
        let mut rows = Vec::new();
        let rejects = self.store.rejects(keys)?;
        self.meet(rejects.iter().map(|reject| &reject.task))?;
        for reject in rejects {
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
        for accepted in self.accepted(keys)? {
            let verdict = accepted.answer.verdict();
            let Some(verdict) = verdict.filter(|verdict| *verdict != Verdict::Keep) else {
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
        Ok(rows)
    }

    fn events(&mut self, put: Put<'_, EventRow>) -> Result<(), Error> {
        let mut after = 0;
        loop {
            let some = self.store.log(after, BATCH)?;
            let Some(last) = some.last() else {
                return Ok(());
            };
            after = last.seq;
            for entry in some {
                put(EventRow {
                    seq: u64::try_from(entry.seq).unwrap_or(0),
                    at: u64::try_from(entry.at).unwrap_or(0),
                    actor: entry.actor.map(pseudonym),
                    kind: entry.kind,
                    task: entry.task.and_then(|task| u64::try_from(task).ok()),
                    body: entry.body.to_string(),
                })?;
            }
        }
    }

    fn parquet(&mut self, folder: &Path, events: bool) -> Result<(), Error> {
        self.table(folder, Self::annotations)?;
        self.table(folder, Self::labels)?;
        self.table(folder, Self::rejects)?;
        let agreement = agreement_rows(&Figures::of(self.store)?);
        self.table(folder, |_, put| agreement.into_iter().try_for_each(put))?;
        if events {
            self.table(folder, Self::events)?;
        }
        Ok(())
    }

    /// Writes three files in one pass: masks by motion, their texts, and pairs.
    fn stance(&mut self, folder: &Path) -> Result<(), Error> {
        let names = ["mask_all.json", "part_annotations.json", "pairs.json"];
        let [masks, texts, pairs] = names;
        write_json(folder, masks, |masks| {
            let mut masks = masks.serialize_map(None)?;
            write_json(folder, texts, |texts| {
                let mut texts = texts.serialize_map(None)?;
                write_json(folder, pairs, |pairs| {
                    let mut pairs = pairs.serialize_seq(None)?;
                    self.released(&mut masks, &mut texts, &mut pairs)?;
                    Ok(SerializeSeq::end(pairs)?)
                })?;
                Ok(SerializeMap::end(texts)?)
            })?;
            Ok(SerializeMap::end(masks)?)
        })?;
        self.done.files.extend(names.map(str::to_owned));
        Ok(())
    }

    fn released(
        &mut self,
        masks_file: &mut impl SerializeMap<Error = serde_json::Error>,
        texts_file: &mut impl SerializeMap<Error = serde_json::Error>,
        pairs_file: &mut impl SerializeSeq<Error = serde_json::Error>,
    ) -> Result<(), JsonError> {
        let mut hard_only = 0;
        for what in ["motions", "pairs"] {
            self.done.count(what, 0);
        }
        self.each_accepted::<JsonError>(|exporter, accepted| {
            let (motion, target) = exporter.ids(&accepted.task)?;
            let split = &accepted.task.split;
            let extra = accepted.task.extra.clone();
            let pair = match accepted.answer {
                Answer::MaskText { masks, .. } => {
                    hard_only += masks.iter().filter(|mask| !mask.soft).count();
                    let (masks, texts) = release::entries(&Said { masks, extra });
                    masks_file.serialize_entry(&motion, &masks)?;
                    texts_file.serialize_entry(&motion, &texts)?;
                    exporter.done.count("motions", 1);
                    return Ok(());
                }
                Answer::Pair {
                    verdict: Verdict::Keep,
                    parts,
                    text,
                    ..
                } => json!({
                    "kind": "fine-grained", "src": motion, "tgt": target,
                    "body_part": parts.join("+"), "text": text, "split": split,
                }),
                Answer::Style {
                    verdict: Verdict::Keep,
                    parts,
                    text,
                    style,
                    ..
                } => {
                    let style = style.unwrap_or_default();
                    json!({
                        "kind": "style", "name": format!("{motion}_{style}"), "src": motion, "tgt": target,
                        "style": style, "body_part": parts.join("+"), "text": text, "split": split,
                    })
                }
                Answer::Pair { .. } | Answer::Style { .. } => {
                    exporter.done.count("rejected_pairs", 1);
                    return Ok(());
                }
            };
            pairs_file.serialize_element(&pair)?;
            exporter.done.count("pairs", 1);
            Ok(())
        })?;
        if hard_only > 0 {
            self.done.count("masks_without_ring", hard_only);
            self.done.messages.push(format!(
                "{hard_only} masks have no soft ring, which this layout cannot represent"
            ));
        }
        Ok(())
    }

    fn csv(&mut self, folder: &Path) -> Result<(), Error> {
        let mut count = 0;
        write_file(folder, "labels.csv", |file, path| {
            let mut file = BufWriter::new(file);
            let mut put = |line: String| {
                let written = file.write_all(line.as_bytes());
                written.map_err(Error::io("write", path))
            };
            put("task,kind,motion_id,target_id,split,author,state,secs,draft_distance,at,answer\r\n".to_owned())?;
            self.labels(&mut |row| {
                count += 1;
                let distance = row.draft_distance.map(|distance| distance.to_string());
                let cells = [
                    row.task,
                    row.kind,
                    row.motion_id,
                    row.target_id.unwrap_or_default(),
                    row.split,
                    row.author,
                    row.state,
                    row.secs.to_string(),
                    distance.unwrap_or_default(),
                    row.at.to_string(),
                    row.answer,
                ];
                put(cells.map(|cell| csv_cell(&cell)).join(",") + "\r\n")
            })?;
            file.flush().map_err(Error::io("write", path))
        })?;
        self.done.count("labels", count);
        self.done.files.push("labels.csv".to_owned());
        Ok(())
    }

    /// Writes the tables `masks` and `pairs` of the dataset. Motions with an accepted answer get its masks, the
    /// others keep theirs; accepted pairs replace the pairs they judge.
    fn dataset(&mut self, root: &Path, holder: &str) -> Result<(), Error> {
        let dataset = Dataset::open(root)?;
        let mut masks: Vec<MaskRow> = Vec::new();
        let mut pairs: Vec<PairRow> = Vec::new();
        let mut answered: BTreeSet<String> = BTreeSet::new();
        let mut judged: BTreeSet<String> = BTreeSet::new();
        self.each_accepted::<Error>(|exporter, accepted| {
            let (motion, target) = exporter.ids(&accepted.task)?;
            let key = &accepted.task.key;
            let split: Split = accepted.task.split.parse()?;
            let author = pseudonym(accepted.author);
            let (answer, done) = (&accepted.answer, &mut exporter.done);
            if accepted.task.kind == TaskKind::MaskText {
                answered.insert(motion.clone());
                masks.extend(mask_rows(&motion, split, &author, answer, done)?);
                return Ok(());
            }
            done.count("pairs_judged", 1);
            if let Some(id) = key.strip_prefix("pair:") {
                judged.insert(id.to_owned());
            }
            pairs.extend(pair_row(key, &motion, target, split, answer)?);
            Ok(())
        })?;
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

/// Escapes a CSV cell, so that no spreadsheet interprets it as a formula.
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
