//! Layout `parquet`: the tables `annotations`, `labels`, `rejects`, `agreement` and `events`. Layout `csv`: the labels.

use std::path::Path;

use datasets_spec::MASK_DEF_VERSION;
use datasets_spec::store::{Disk, Store as _};
use datasets_spec::table::{Row, RowWriter};
use serde_json::Value;

use super::exporter::{BATCH, Exporter};
use crate::Error;
use crate::mask::mask_of;
use crate::quality::{Figures, draft_distance};
use crate::store::{AcceptedAnswer, KeyRange, Reject, TaskRecord};
use crate::transfer::tables::{AgreementRow, AnnotationRow, EventRow, LabelRow, RejectRow};
use crate::wire::{Agreement, Estimate, PartAgreement, TaskKind};

/// The first line of layout `csv`.
const HEAD: &str = "task,kind,motion_id,target_id,split,author,state,secs,draft_distance,at,accepted_by,answer\r\n";

/// Receives the next row of a table.
type Put<'a, R> = &'a mut dyn FnMut(R) -> Result<(), Error>;

impl Exporter<'_> {
    pub(super) fn parquet(&mut self, folder: &Path, events: bool) -> Result<(), Error> {
        self.table(folder, Self::annotations)?;
        self.table(folder, Self::labels)?;
        self.table(folder, Self::rejects)?;
        let agreement = agreement_rows(&Figures::of(self.store)?.agreement);
        self.table(folder, |_, put| agreement.into_iter().try_for_each(put))?;
        if events {
            self.table(folder, Self::events)?;
        }
        Ok(())
    }

    /// Writes a table row by row.
    pub(super) fn table<R: Row>(
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
        let path = folder.join(&name);
        let file = Disk.create(&path);
        let file = file.map_err(datasets_spec::Error::io("create", &path))?;
        let mut writer = RowWriter::new(file, &path, &facts)?;
        fill(self, &mut |row| {
            count += 1;
            Ok(writer.push(row)?)
        })?;
        let published = writer.finish()?.publish();
        published.map_err(datasets_spec::Error::io("write", path))?;
        self.done.count(R::TABLE, count);
        self.done.files.push(name);
        Ok(())
    }

    pub(super) fn annotations(&mut self, put: Put<'_, AnnotationRow>) -> Result<(), Error> {
        self.each_accepted(|exporter, accepted| exporter.annotation(accepted, put))
    }

    /// Writes an answer as one row, or as a row for each of its masks.
    fn annotation(
        &mut self,
        accepted: AcceptedAnswer,
        put: Put<'_, AnnotationRow>,
    ) -> Result<(), Error> {
        let (motion_id, target_id) = self.ids(&accepted.task)?;
        let author = self.author(&accepted);
        let (task, said) = (&accepted.task, accepted.answer.fields());
        let joints = mask_of(said.parts, true, &[]);
        let row = AnnotationRow {
            task: task.key.clone(),
            kind: task.kind.to_string(),
            motion_id,
            target_id,
            split: task.split.clone(),
            category: task.category.clone(),
            hint: task.hint.clone(),
            source_style: task.style.clone(),
            number: 0,
            count: match task.kind {
                TaskKind::MaskText => said.masks.len() as u32,
                TaskKind::Pair | TaskKind::Style => 1,
            },
            verdict: said.verdict.map(|verdict| verdict.to_string()),
            parts: said.parts.to_vec(),
            hard_joints: joints.hard().names(),
            soft_joints: joints.soft().names(),
            start: None,
            end: None,
            mask_def_version: MASK_DEF_VERSION,
            text: said.text.to_owned(),
            edit_type: said.edit_type.map(|kind| kind.to_string()),
            style: said.style.map(str::to_owned),
            extent: said.extent.map(|extent| extent.to_string()),
            count_reason: said.count_reason.map(|reason| reason.to_string()),
            note: said.note.to_owned(),
            author,
            merged: u32::from(accepted.merged),
            extra: task.extra.as_ref().map(ToString::to_string),
            accepted_by: Some(accepted.accepted_by().to_owned()),
            motion_hash: Some(task.source.clone()),
            target_hash: task.target.clone(),
        };
        if said.masks.is_empty() {
            return put(row);
        }
        for (number, mask) in said.masks.iter().enumerate() {
            let joints = mask.mask();
            put(AnnotationRow {
                number: number as u32,
                parts: mask.parts.clone(),
                hard_joints: joints.hard().names(),
                soft_joints: joints.soft().names(),
                start: mask.range.map(|[start, _]| start),
                end: mask.range.map(|[_, end]| end),
                text: mask.text.clone(),
                ..row.clone()
            })?;
        }
        Ok(())
    }

    fn labels(&mut self, put: Put<'_, LabelRow>) -> Result<(), Error> {
        self.each_range(|exporter, keys| {
            let mut rows = Vec::new();
            let mut labels = exporter.store.labels_of(keys)?;
            exporter.meet(labels.iter_mut().map(|(task, _)| task))?;
            for (task, label) in labels {
                if !exporter.fits(&task) {
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

    /// Layout `csv`: all labels for spreadsheets.
    pub(super) fn csv(&mut self, folder: &Path) -> Result<(), Error> {
        let mut count = 0;
        let mut text = HEAD.to_owned();
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
                row.accepted_by.unwrap_or_default(),
                row.answer,
            ];
            let cells = cells.map(|cell| csv_cell(&cell));
            text += &format!("{}\r\n", cells.join(","));
            Ok(())
        })?;
        self.write(folder, "labels.csv", &text)?;
        self.done.count("labels", count);
        let mut others = 0;
        self.each_accepted(|_, accepted| {
            others += usize::from(accepted.merged || accepted.author == 0);
            Ok(())
        })?;
        let message = format!(
            "{others} accepted answers were merged by a reviewer or imported: they are no label of a person, and \
             layout parquet alone has them"
        );
        self.done.report("merged_or_imported", others, message);
        Ok(())
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
        let mut rejects = self.store.rejects(keys)?;
        self.meet(rejects.iter_mut().map(|reject| &mut reject.task))?;
        for Reject {
            task,
            user,
            reason,
            note,
        } in rejects
        {
            if task.gold.is_none() && self.fits(&task) {
                let author = self.pseudonym(user.unwrap_or(0));
                let row = self.reject(&task, reason, author)?;
                rows.push(RejectRow { note, ..row });
            }
        }
        for accepted in self.accepted(keys)? {
            let verdict = accepted.answer.verdict();
            if let Some(verdict) = verdict.filter(|_| accepted.answer.is_reject()) {
                let author = self.author(&accepted);
                let row = self.reject(&accepted.task, verdict.to_string(), author)?;
                let accepted_by = Some(accepted.accepted_by().to_owned());
                rows.push(RejectRow { accepted_by, ..row });
            }
        }
        Ok(rows)
    }

    fn reject(
        &self,
        task: &TaskRecord,
        reason: String,
        author: String,
    ) -> Result<RejectRow, Error> {
        let (motion_id, target_id) = self.ids(task)?;
        Ok(RejectRow {
            task: task.key.clone(),
            kind: task.kind.to_string(),
            motion_id,
            target_id,
            split: task.split.clone(),
            reason,
            note: String::new(),
            author,
            accepted_by: None,
        })
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

    /// The body of a log entry, or a part of it, with pseudonyms instead of the ids and names of people.
    fn without_people(&self, body: Value) -> Value {
        let fields = match body {
            Value::Object(fields) => fields,
            Value::Array(all) => {
                return all
                    .into_iter()
                    .map(|one| self.without_people(one))
                    .collect();
            }
            other => return other,
        };
        let names_somebody = fields.contains_key("user");
        let hidden = |value: &Value| match value.as_i64() {
            Some(user) => Value::String(self.pseudonym(user)),
            None => Value::Null,
        };
        let fields = fields.into_iter().map(|(name, value)| {
            let value = match (name.as_str(), value) {
                ("user" | "author", value) => hidden(&value),
                ("authors" | "people", Value::Array(users)) => users.iter().map(hidden).collect(),
                // The rules of the project name people that it trusts.
                ("settings" | "rules", value) => self.without_people(value),
                // The name of `user`, whose pseudonym is beside it.
                ("name", _) if names_somebody => Value::Null,
                (_, value) => value,
            };
            (name, value)
        });
        Value::Object(fields.collect())
    }
}

fn agreement_rows(agreement: &Agreement) -> Vec<AgreementRow> {
    let row = |item: &str, figure: &str, (found, chance): (Option<Estimate>, _), items: usize| {
        AgreementRow {
            item: item.to_owned(),
            figure: figure.to_owned(),
            value: found.map(|found| found.value),
            low: found.map(|found| found.low),
            high: found.map(|found| found.high),
            items: items as u64,
            chance,
        }
    };
    let parts = agreement.parts.iter().chain(&agreement.verdicts);
    let ac1 = |part: &PartAgreement| (part.gwet_ac1, part.chance);
    let jaccard = (agreement.jaccard, agreement.jaccard_chance);
    // Every task of masks with several answers is one item of each part.
    let num_masks = agreement.parts.first().map_or(0, |part| part.items);
    parts
        .map(|part| row(&part.part, "gwet_ac1", ac1(part), part.items))
        .chain([row("masks", "jaccard", jaccard, num_masks)])
        .collect()
}

/// Escapes a CSV cell, so that no spreadsheet interprets it as a formula.
fn csv_cell(text: &str) -> String {
    let formula =
        text.starts_with(['=', '+', '-', '@', '\t', '\r']) && text.parse::<f64>().is_err();
    let guard = if formula { "'" } else { "" };
    match text.contains(['"', ',', '\n', '\r']) {
        true => format!("\"{guard}{}\"", text.replace('"', "\"\"")),
        false => format!("{guard}{text}"),
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
