//! Import of labels from a STANCE release.

use std::collections::BTreeMap;

use serde_json::Value;

use super::import::{Taken, credit, key_of_pair, mask_key, task};
use super::release::{self, SaidPair};
use crate::Error;
use crate::answer::{Fields, check_draft};
use crate::store::{Millis, MotionRecord, NewTask, Store};
use crate::wire::{Answer, TaskKind, Verdict};

/// Imports `mask_all.json` and `part_annotations.json` of a STANCE release, and `accepted_by.json` and `pairs.json` of an
/// export, given as one object with the names of the files. The annotations become accepted answers of tasks that nobody
/// has worked on; unknown fields are kept for export. Those of tasks with another answer are left out and reported.
///
/// # Errors
/// It is not such an object, or the store fails.
pub fn from_release(
    store: &Store,
    motions: &BTreeMap<String, MotionRecord>,
    document: &Value,
    actor: Option<i64>,
    now: Millis,
) -> Result<Taken, Error> {
    let parsed = release::parse(document).map_err(|problem| Error::Import {
        what: "the annotations of a STANCE release".to_owned(),
        problem,
    })?;
    let mut taken = Taken::default();
    for (shape, count) in parsed.shapes {
        taken.count(&format!("shape: {shape}"), count);
    }
    taken.messages = parsed.messages;
    let mut tasks = Vec::new();
    for (id, said) in parsed.motions {
        let Some(motion) = motions.get(&id) else {
            taken.count("unknown_ids", 1);
            if taken.messages.len() < 50 {
                taken.messages.push(format!(
                    "motion {id:?} is not in this dataset; its annotations are left out"
                ));
            }
            continue;
        };
        let mut new = task(mask_key(&motion.id), TaskKind::MaskText, motion);
        new.extra = said.extra;
        new.credit = credit("", false, said.accepted_by.as_deref());
        new.accepted = Some(Answer::MaskText {
            masks: said.masks,
            count_reason: None,
            note: String::new(),
        });
        tasks.push(new);
    }
    for pair in parsed.pairs {
        let Some((source, target)) = motions.get(&pair.src).zip(motions.get(&pair.tgt)) else {
            taken.count("unknown_ids", 1);
            continue;
        };
        tasks.push(
            released_pair(&pair, source, target).map_err(|problem| Error::Import {
                what: format!("pair {:?} of a STANCE release", pair.id),
                problem,
            })?,
        );
    }
    taken.take(store.import(actor, tasks, now)?);
    Ok(taken)
}

fn released_pair(
    pair: &SaidPair,
    source: &MotionRecord,
    target: &MotionRecord,
) -> Result<NewTask, String> {
    let (parts, unknown) = release::parts(&pair.body_part);
    if let Some(name) = unknown.first() {
        return Err(format!("body part {name:?} is not known"));
    }
    let kind = match pair.kind.as_str() {
        "fine-grained" => TaskKind::Pair,
        "style" => TaskKind::Style,
        other => return Err(format!("kind {other:?} is not known")),
    };
    let said = Fields {
        verdict: Some(Verdict::Keep),
        parts: &parts,
        edit_type: pair.edit_type,
        // The file has an empty text where none was chosen.
        style: pair.style.as_deref().filter(|style| !style.is_empty()),
        text: &pair.text,
        ..Fields::default()
    };
    let answer = said.answer(kind);
    check_draft(&answer, kind).map_err(|error| error.to_string())?;
    let mut new = task(key_of_pair(&pair.id), kind, source);
    new.target = Some(target.hash.clone());
    new.accepted = Some(answer);
    new.credit = credit("", false, pair.accepted_by.as_deref());
    Ok(new)
}
