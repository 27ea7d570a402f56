//! Layout `parquet`: one table each of annotations, labels, rejects, agreement and events.

use std::path::Path;

use datasets_spec::table::{Row, RowWriter};
use datasets_spec::{JointSet, MASK_DEF_VERSION};
use serde_json::Value;

use super::exporter::{BATCH, Exporter, write_file};
use crate::Error;
use crate::mask::mask_of;
use crate::quality::{Figures, draft_distance};
use crate::store::{AcceptedAnswer, KeyRange};
use crate::transfer::tables::{AgreementRow, AnnotationRow, EventRow, LabelRow, RejectRow};
use crate::wire::{Answer, Estimate, Verdict};

/// Receives the next row of a table.
type Put<'a, R> = &'a mut dyn FnMut(R) -> Result<(), Error>;

impl Exporter<'_> {
    pub(super) fn parquet(&mut self, folder: &Path, events: bool) -> Result<(), Error> {
        self.annotation_table(folder)?;
        self.table(folder, Self::labels)?;
        self.table(folder, Self::rejects)?;
        let agreement = agreement_rows(&Figures::of(self.store)?);
        self.table(folder, |_, put| agreement.into_iter().try_for_each(put))?;
        if events {
            self.table(folder, Self::events)?;
        }
        Ok(())
    }

    /// Writes the table of accepted answers.
    pub(super) fn annotation_table(&mut self, folder: &Path) -> Result<(), Error> {
        self.table(folder, Self::annotations)
    }

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
        let author = self.author(&accepted);
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
            start: None,
            end: None,
            mask_def_version: MASK_DEF_VERSION,
            text: String::new(),
            edit_type: None,
            style: None,
            extent: None,
            count_reason: None,
            note: String::new(),
            author,
            merged: u32::from(accepted.merged),
            extra: task.extra.as_ref().map(ToString::to_string),
            accepted_by: Some(accepted.accepted_by),
        };
        put_answer(accepted.answer, empty, put)
    }

    pub(super) fn labels(&mut self, put: Put<'_, LabelRow>) -> Result<(), Error> {
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
                    split: task.split,
                    author: exporter.pseudonym(label.revision.author),
                    state: label.revision.state.to_string(),
                    draft_distance: draft_distance(exporter.store, answer)?,
                    answer: serde_json::to_string(answer).unwrap_or_default(),
                    secs: label.revision.secs,
                    blind: u32::from(label.blind),
                    gold: u32::from(label.gold),
                    at: u64::try_from(label.revision.at).unwrap_or(0),
                    accepted_by: label.accepted_by,
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
                author: self.pseudonym(reject.user.unwrap_or(0)),
                accepted_by: None,
            });
        }
        for accepted in self.accepted(keys)? {
            let verdict = accepted.answer.verdict();
            let Some(verdict) = verdict.filter(|verdict| *verdict != Verdict::Keep) else {
                continue;
            };
            let (motion_id, target_id) = self.ids(&accepted.task)?;
            let author = self.author(&accepted);
            rows.push(RejectRow {
                task: accepted.task.key,
                kind: accepted.task.kind.to_string(),
                motion_id,
                target_id,
                split: accepted.task.split,
                reason: verdict.to_string(),
                note: String::new(),
                author,
                accepted_by: Some(accepted.accepted_by),
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
                    actor: entry.actor.map(|user| self.pseudonym(user)),
                    kind: entry.kind,
                    task: entry.task.and_then(|task| u64::try_from(task).ok()),
                    body: self.without_people(entry.body).to_string(),
                })?;
            }
        }
    }
}

/// Writes an answer as one row, or as a row for each of its masks, from the row of its task.
fn put_answer(
    answer: Answer,
    empty: AnnotationRow,
    put: Put<'_, AnnotationRow>,
) -> Result<(), Error> {
    match answer {
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
                let joints = mask.mask();
                put(AnnotationRow {
                    number: number as u32,
                    hard_joints: JointSet::names(joints.hard()),
                    soft_joints: JointSet::names(joints.soft()),
                    start: mask.range.map(|[start, _]| start),
                    end: mask.range.map(|[_, end]| end),
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
            hard_joints: JointSet::names(mask_of(&parts, true, &[]).hard()),
            soft_joints: JointSet::names(mask_of(&parts, true, &[]).soft()),
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
            hard_joints: JointSet::names(mask_of(&parts, true, &[]).hard()),
            soft_joints: JointSet::names(mask_of(&parts, true, &[]).soft()),
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

impl Exporter<'_> {
    /// The body of a log entry with pseudonyms instead of the ids and names of people.
    fn without_people(&self, body: Value) -> Value {
        let Value::Object(fields) = body else {
            return body;
        };
        let names_somebody = fields.contains_key("user");
        let hidden = |value: &Value| match value.as_i64() {
            Some(user) => Value::String(self.pseudonym(user)),
            None => Value::Null,
        };
        let fields = fields.into_iter().map(|(name, value)| {
            let value = match (name.as_str(), value) {
                ("user" | "author", value) => hidden(&value),
                ("authors", Value::Array(users)) => users.iter().map(hidden).collect(),
                // The name of `user`, whose pseudonym is beside it.
                ("name", _) if names_somebody => Value::Null,
                (_, value) => value,
            };
            (name, value)
        });
        Value::Object(fields.collect())
    }
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
