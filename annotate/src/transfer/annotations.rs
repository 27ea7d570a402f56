//! Import of the table `annotations` of an export.

use std::collections::BTreeMap;
use std::path::Path;

use datasets_spec::table::read_rows;
use datasets_spec::{BodyPart, MASK_DEF_VERSION};

use super::import::{Taken, credit, entered_mask, known_motions, other_content};
use super::keys::{CANDIDATE, PAIR, task};
use super::tables::AnnotationRow;
use crate::Error;
use crate::answer::Fields;
use crate::groups::grouped;
use crate::store::{Millis, MotionRecord, NewTask, Store};
use crate::wire::{Answer, CountReason, EditType, Extent, MaskAnswer, TaskKind, Verdict};

/// Imports the table `annotations` of an export: every answer fills its task if nobody has worked on it, or becomes a
/// new, accepted task. Answers to tasks with another answer, and answers about motions that the store does not know,
/// are left out and reported.
///
/// # Errors
/// The file cannot be read, the store knows none of its motions, a motion has another content, or an answer is invalid;
/// then nothing is imported.
pub fn from_annotations(
    store: &Store,
    path: &Path,
    actor: Option<i64>,
    now: Millis,
) -> Result<Taken, Error> {
    let motions = known_motions(store)?;
    let rows = read_rows::<AnnotationRow>(path)?.into_iter();
    let mut groups = grouped(rows.map(|row| (row.task.clone(), row)));
    let mut taken = Taken::default();
    let (mut tasks, mut past, mut by_id) = (Vec::new(), Vec::new(), 0);
    let is_known = |row: &AnnotationRow| {
        let mut named = std::iter::once(&row.motion_id).chain(&row.target_id);
        named.all(|id| motions.contains_key(id))
    };
    let num_answers = groups.len();
    groups.retain(|_, rows| is_known(&rows[0]));
    let unknown = num_answers - groups.len();
    if unknown > 0 && groups.is_empty() {
        let problem = format!(
            "this project has the motions of none of its {num_answers} answers; import their dataset first"
        );
        return Err(Error::import(path.display().to_string(), problem));
    }
    taken.report("unknown_ids", unknown, || {
        format!(
            "{unknown} of {num_answers} answers are about motions that are not in this dataset, and are left out"
        )
    });
    for mut group in groups.into_values() {
        group.sort_by_key(|row| row.number);
        let what = || format!("task {:?} of {}", group[0].task, path.display());
        let task = check_whole(&group).and_then(|()| annotation_task(&group, &motions));
        let task = task.map_err(|problem| Error::import(what(), problem))?;
        let masks = task
            .accepted
            .as_ref()
            .map_or(&[][..], |answer| answer.fields().masks);
        let frames = motions[&group[0].motion_id].frames;
        // What people accepted holds, also if it is shorter than a window.
        match crate::mask::check_ranges(masks, frames, 1) {
            Ok(()) => {
                tasks.push(task);
                by_id += usize::from(group[0].motion_hash.is_none());
            }
            Err(problem) => past.push(format!("{}: {problem}", task.key)),
        }
    }
    taken.take(store.import(actor, tasks, now)?);
    taken.report("answers_past_the_clip", past.len(), || {
        format!(
            "{} answers have masks that do not fit their clips, which may have been ingested again since, and are left out, \
             for example {}",
            past.len(),
            past[0]
        )
    });
    taken.report("found_by_id_alone", by_id, || {
        format!(
            "the motions of {by_id} answers were found by their ids alone: the file is of an earlier version, without \
             content hashes; make sure that it is of this dataset"
        )
    });
    Ok(taken)
}

fn annotation_task(
    rows: &[AnnotationRow],
    motions: &BTreeMap<String, MotionRecord>,
) -> Result<NewTask, String> {
    let first = &rows[0];
    let find = |id: &str, exported: Option<&String>| {
        let motion = &motions[id];
        match exported.filter(|hash| **hash != motion.hash) {
            Some(exported) => Err(format!(
                "motion {id:?}: {}",
                other_content(&motion.hash, exported)
            )),
            None => Ok(motion),
        }
    };
    let kind = TaskKind::parse(&first.kind)
        .ok_or_else(|| format!("kind {:?} is not known", first.kind))?;
    let source = find(&first.motion_id, first.motion_hash.as_ref())?;
    let mut new = task(current_key(&first.task).to_owned(), kind, source);
    let target = first.target_id.as_deref();
    let target = target.map(|id| find(id, first.target_hash.as_ref()));
    let target = target.transpose()?;
    new.target = target.map(|motion| motion.hash.clone());
    new.category.clone_from(&first.category);
    new.hint.clone_from(&first.hint);
    new.style.clone_from(&first.source_style);
    let extra = first.extra.as_deref().map(serde_json::from_str);
    new.extra = extra.transpose().map_err(|error| error.to_string())?;
    rows.iter().try_for_each(check_masks)?;
    let answer = answer(rows, kind)?;
    crate::answer::check_draft(&answer, kind).map_err(|error| error.to_string())?;
    new.accepted = Some(answer);
    let accepted_by = first.accepted_by.as_deref();
    new.credit = credit(&first.author, first.merged != 0, accepted_by);
    Ok(new)
}

/// Refuses the rows of an answer, sorted by number, some of which the table lacks.
fn check_whole(rows: &[AnnotationRow]) -> Result<(), String> {
    let count = rows[0].count;
    let expected = 0..count.max(1);
    match rows.iter().all(|row| row.count == count)
        && rows.iter().map(|row| row.number).eq(expected)
    {
        true => Ok(()),
        false => Err(format!(
            "the table does not have the {count} rows of its answer, numbered from 0; import the table as it was exported"
        )),
    }
}

/// Refuses masks of another version of the mask definition, and parts that this program does not know.
fn check_masks(row: &AnnotationRow) -> Result<(), String> {
    if row.mask_def_version != MASK_DEF_VERSION {
        return Err(format!(
            "its masks have definition version {}, this program has version {MASK_DEF_VERSION}",
            row.mask_def_version
        ));
    }
    for part in &row.parts {
        part.parse::<BodyPart>()
            .map_err(|error| error.to_string())?;
    }
    Ok(())
}

/// Builds an answer from the rows of a task.
fn answer(rows: &[AnnotationRow], kind: TaskKind) -> Result<Answer, String> {
    fn known<T>(text: Option<&String>, parse: fn(&str) -> Option<T>) -> Result<Option<T>, String> {
        text.map(|text| parse(text).ok_or_else(|| format!("{text:?} is not known")))
            .transpose()
    }
    let first = &rows[0];
    let verdict = known(first.verdict.as_ref(), Verdict::parse)?;
    let masks = match kind {
        TaskKind::MaskText => {
            let rows = rows.iter().filter(|row| row.count > 0);
            let masks = rows.map(|row| {
                let joints = (&row.hard_joints[..], &row.soft_joints[..]);
                entered_mask(&row.parts, joints, (row.start, row.end), &row.text)
            });
            let masks = masks.collect::<Result<Vec<MaskAnswer>, _>>();
            masks.map_err(|error| error.to_string())?
        }
        TaskKind::Pair | TaskKind::Style if verdict.is_none() => {
            return Err("its pair has no verdict".to_owned());
        }
        TaskKind::Pair | TaskKind::Style => Vec::new(),
    };
    let said = Fields {
        masks: &masks,
        count_reason: known(first.count_reason.as_ref(), CountReason::parse)?,
        verdict,
        parts: &first.parts,
        edit_type: known(first.edit_type.as_ref(), EditType::parse)?,
        style: first.style.as_deref(),
        extent: known(first.extent.as_ref(), Extent::parse)?,
        text: &first.text,
        suggestion: None,
        note: &first.note,
    };
    Ok(said.answer(kind))
}

/// The current key of a task of an export. Earlier versions gave a candidate that was imported from the dataset a
/// second key, with the prefix [`PAIR`].
fn current_key(key: &str) -> &str {
    key.strip_prefix(PAIR)
        .filter(|id| id.starts_with(CANDIDATE))
        .unwrap_or(key)
}
