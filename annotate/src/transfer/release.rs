//! `mask_all.json` and `part_annotations.json` of a STANCE release, and the files that an export adds to them:
//! `accepted_by.json` and `pairs.json`.
//!
//! The release documents the meaning of keys and values, but not their shape. An import accepts a name, a list of
//! names, a list of lists, or an object keyed by part, and reports the shape. An export writes one shape: for each id
//! a list of masks (parts joined by `+`), and a list of as many texts.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::BodyPart;
use serde::Deserialize;
use serde_json::{Map, Value, json};

use super::import::{Taken, credit, known_motions};
use super::keys::{key_of_pair, mask_key, task};
use crate::Error;
use crate::answer::{Fields, check_draft};
use crate::store::{Millis, MotionRecord, NewTask, Store};
use crate::wire::{Answer, EditType, MaskAnswer, TaskKind, Verdict};

/// Name of a release in error messages.
pub(crate) const RELEASE: &str = "the annotations of a STANCE release";

/// Imports `mask_all.json` and `part_annotations.json` of a STANCE release, and `accepted_by.json` and `pairs.json` of
/// an export, given as one object keyed by file name. The annotations become accepted answers of tasks that nobody has
/// worked on; unknown fields are kept for export. Annotations of tasks with another answer are left out and reported.
///
/// # Errors
/// The document is not such an object, or the store fails.
pub fn from_release(
    store: &Store,
    document: &Value,
    actor: Option<i64>,
    now: Millis,
) -> Result<Taken, Error> {
    let parsed = parse(document).map_err(|problem| Error::import(RELEASE, problem))?;
    let motions = known_motions(store)?;
    let mut taken = parsed.taken;
    let (mut tasks, mut not_understood) = (Vec::new(), Vec::new());
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
        // What is not understood is no judgement that the clip has no masks.
        if !said.is_judgement {
            not_understood.push(id);
            continue;
        }
        let mut new = task(mask_key(&motion.id), TaskKind::MaskText, motion);
        new.extra = said.extra;
        new.credit = credit("", false, said.accepted_by.as_deref());
        let answer = Answer::MaskText {
            masks: said.masks,
            count_reason: None,
            note: String::new(),
        };
        if let Err(problem) = check_draft(&answer, TaskKind::MaskText) {
            taken.count("entries_refused", 1);
            if taken.messages.len() < 50 {
                taken.messages.push(format!(
                    "the annotations of motion {id:?} are left out: {problem}"
                ));
            }
            continue;
        }
        new.accepted = Some(answer);
        tasks.push(new);
    }
    taken.report("entries_not_understood", not_understood.len(), || {
        format!(
            "{} motions have no mask that is understood, for example {:?}; their annotations are left out",
            not_understood.len(),
            not_understood[0]
        )
    });
    for pair in parsed.pairs {
        let Some((source, target)) = motions.get(&pair.src).zip(motions.get(&pair.tgt)) else {
            taken.count("unknown_ids", 1);
            continue;
        };
        let task = released_pair(&pair, source, target);
        let what = || format!("pair {:?} of a STANCE release", pair.id);
        tasks.push(task.map_err(|problem| Error::import(what(), problem))?);
    }
    taken.take(store.import(actor, tasks, now)?);
    Ok(taken)
}

fn released_pair(
    pair: &SaidPair,
    source: &MotionRecord,
    target: &MotionRecord,
) -> Result<NewTask, String> {
    let (parts, unknown) = parts(&pair.body_part);
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

/// Annotations of one motion.
#[derive(Clone, Debug, Default, PartialEq)]
struct Said {
    masks: Vec<MaskAnswer>,
    /// Whether the entry names masks that are known, or says that the motion has none.
    is_judgement: bool,
    /// Unknown fields, kept for export.
    extra: Option<Value>,
    /// How the annotations were accepted, if the file says so.
    accepted_by: Option<String>,
}

/// A parsed release.
#[derive(Debug, Default)]
struct Release {
    motions: BTreeMap<String, Said>,
    pairs: Vec<SaidPair>,
    /// Counts of the shapes of values, and problems with them.
    taken: Taken,
}

/// A usable pair of `pairs.json`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
struct SaidPair {
    /// Id as in table `pairs` of the dataset.
    id: String,
    kind: String,
    src: String,
    tgt: String,
    body_part: String,
    text: String,
    style: Option<String>,
    edit_type: Option<EditType>,
    accepted_by: Option<String>,
}

fn shape(value: &Value) -> &'static str {
    match value {
        Value::String(_) => "string",
        Value::Array(items) if items.iter().any(Value::is_array) => "list of lists",
        Value::Array(_) => "list",
        Value::Object(_) => "object by part",
        _ => "something else",
    }
}

/// Parses part names joined by `+`; returns known parts and unknown names.
fn parts(text: &str) -> (Vec<String>, Vec<String>) {
    let (mut known, mut unknown) = (Vec::new(), Vec::new());
    for name in text
        .split('+')
        .map(str::trim)
        .filter(|name| !name.is_empty())
    {
        match name
            .to_uppercase()
            .replace([' ', '-'], "_")
            .parse::<BodyPart>()
        {
            Ok(part) if !known.contains(&part.name().to_owned()) => {
                known.push(part.name().to_owned())
            }
            Ok(_) => {}
            Err(_) => unknown.push(name.to_owned()),
        }
    }
    (known, unknown)
}

fn names(value: &Value) -> Vec<String> {
    match value {
        Value::String(text) => vec![text.clone()],
        Value::Array(items) => items
            .iter()
            .map(|item| match item {
                Value::Array(inner) => inner
                    .iter()
                    .filter_map(Value::as_str)
                    .collect::<Vec<_>>()
                    .join("+"),
                item => item.as_str().unwrap_or_default().to_owned(),
            })
            .collect(),
        Value::Object(map) => map.keys().cloned().collect(),
        _ => Vec::new(),
    }
}

fn texts(value: &Value) -> Vec<String> {
    match value {
        Value::String(text) => vec![text.trim().to_owned()],
        Value::Array(items) => items.iter().flat_map(texts).collect(),
        _ => Vec::new(),
    }
}

/// Reads `{"mask_all": {id: masks}, "part_annotations": {id: texts}, "accepted_by": {id: how}, "pairs": [pair]}`.
/// One of the first two suffices.
fn parse(document: &Value) -> Result<Release, String> {
    let object = document.as_object().ok_or("it is no JSON object")?;
    let side = |name: &str| -> Result<Map<String, Value>, String> {
        match object.get(name) {
            None => Ok(Map::new()),
            Some(Value::Object(map)) => Ok(map.clone()),
            Some(other) => Err(format!(
                "{name} is {}, expected an object keyed by motion",
                shape(other)
            )),
        }
    };
    if !object.contains_key("mask_all") && !object.contains_key("part_annotations") {
        return Err("it has neither mask_all nor part_annotations".to_owned());
    }
    let (masks, said) = (side("mask_all")?, side("part_annotations")?);
    let accepted_by = side("accepted_by")?;
    let mut release = Release::default();
    let pairs = object.get("pairs").and_then(Value::as_array);
    let (named, nameless): (Vec<&Value>, Vec<&Value>) = pairs
        .into_iter()
        .flatten()
        .partition(|pair| pair.get("id").is_some());
    for pair in named {
        let pair = SaidPair::deserialize(pair).map_err(|error| format!("pairs: {error}"))?;
        release.pairs.push(pair);
    }
    if !nameless.is_empty() {
        release.taken.messages.push(format!(
            "{} pairs have no id, as in exports of earlier versions, and are left out",
            nameless.len()
        ));
    }
    let only = |a: &Map<String, Value>, b: &Map<String, Value>| {
        a.keys().filter(|key| !b.contains_key(*key)).count()
    };
    for (count, what) in [
        (only(&masks, &said), "ids have masks but no texts"),
        (only(&said, &masks), "ids have texts but no masks"),
    ] {
        if count > 0 {
            release.taken.messages.push(format!("{count} {what}"));
        }
    }
    let ids: BTreeSet<&String> = masks.keys().chain(said.keys()).collect();
    for id in ids {
        let (mask, text) = (masks.get(id), said.get(id));
        for (value, file) in [(mask, "mask_all"), (text, "part_annotations")] {
            if let Some(value) = value {
                let shape = format!("shape: {file} {}", shape(value));
                release.taken.count(&shape, 1);
            }
        }
        let read = motion(mask.unwrap_or(&Value::Null), text.unwrap_or(&Value::Null));
        let (mut said, problems) = read;
        said.accepted_by = accepted_by
            .get(id)
            .and_then(Value::as_str)
            .map(str::to_owned);
        for problem in problems {
            if release.taken.messages.len() < 50 {
                release.taken.messages.push(format!("{id}: {problem}"));
            }
        }
        release.motions.insert(id.clone(), said);
    }
    Ok(release)
}

/// Reads the masks and texts of a motion. Also returns what is wrong with them.
fn motion(masks: &Value, said: &Value) -> (Said, Vec<String>) {
    let (mut unknown, mut problems) = (Map::new(), Vec::new());
    let names = names(masks);
    // Texts without part names belong to the masks by position.
    let in_order: Vec<Vec<String>> = match said {
        Value::Array(items) if items.len() == names.len() => items.iter().map(texts).collect(),
        Value::Array(_) if names.len() == 1 => vec![texts(said)],
        Value::String(_) => vec![texts(said); names.len()],
        Value::Null | Value::Object(_) => Vec::new(),
        _ => {
            unknown.insert("part_annotations".to_owned(), said.clone());
            problems.push(
                "its texts do not match its masks; they are kept as an unknown field if a mask is understood"
                    .to_owned(),
            );
            Vec::new()
        }
    };
    let by_part = said.as_object();
    let mut named: Vec<(&str, Vec<String>)> = Vec::new();
    for (name, value) in by_part.into_iter().flatten() {
        named.push((name.as_str(), texts(value)));
        if !parts(name).1.is_empty() {
            unknown.insert(name.clone(), value.clone());
        }
    }
    for (index, name) in names.iter().enumerate() {
        let is_same = |known: &String| parts(known).0 == parts(name).0;
        if !by_part.is_some_and(|texts| texts.keys().any(is_same)) {
            let texts = in_order.get(index).cloned();
            named.push((name.as_str(), texts.unwrap_or_default()));
        }
    }
    let mut read = Said::default();
    for (name, mut texts) in named {
        let (parts, lost) = parts(name);
        problems.extend(
            lost.iter()
                .map(|name| format!("body part {name:?} is not known")),
        );
        if texts.is_empty() {
            // Masks without texts are kept.
            texts.push(String::new());
        }
        let texts = texts.into_iter().filter(|_| !parts.is_empty());
        let masks = texts.map(|text| MaskAnswer::of_parts(parts.clone(), text));
        read.masks.extend(masks);
    }
    read.extra = (!unknown.is_empty()).then_some(Value::Object(unknown));
    let has_none = matches!(masks, Value::Array(names) if names.is_empty())
        && texts(said).iter().all(String::is_empty);
    read.is_judgement = !read.masks.is_empty() || (has_none && problems.is_empty());
    (read, problems)
}

/// Entries of the two files for a motion.
pub(super) fn entries(masks: &[MaskAnswer], extra: Option<&Value>) -> (Value, Value) {
    let names: Vec<String> = masks.iter().map(|mask| mask.parts.join("+")).collect();
    let texts: Vec<&str> = masks.iter().map(|mask| mask.text.as_str()).collect();
    // Texts that fit no mask are written as they came.
    let kept = extra.and_then(|extra| extra.get("part_annotations"));
    (json!(names), kept.cloned().unwrap_or_else(|| json!(texts)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shape_says_the_same() {
        let one = ["LEFT_ARM: waving"].as_slice();
        let two = ["LEFT_ARM+HEAD: nodding", "LOWER_BODY: walking"].as_slice();
        let joined = json!([["LEFT_ARM", "HEAD"], "LOWER_BODY"]);
        for (masks, texts, expected) in [
            (json!("LEFT_ARM"), json!("waving"), one),
            (json!(["left arm"]), json!(["waving"]), one),
            (json!([["LEFT_ARM"]]), json!([["waving"]]), one),
            (json!({"LEFT_ARM": 1}), json!({"LEFT_ARM": "waving"}), one),
            (Value::Null, json!({"LEFT_ARM": ["waving"]}), one),
            (joined, json!(["nodding", "walking"]), two),
        ] {
            let said = motion(&masks, &texts).0.masks.into_iter();
            let said = said.map(|mask| format!("{}: {}", mask.parts.join("+"), mask.text));
            assert_eq!(Vec::from_iter(said), expected, "{masks} {texts}");
        }
    }

    #[test]
    fn what_is_not_understood_is_reported_and_kept() {
        let document = json!({
            "mask_all": {
                "a": ["LEFT_ARM", "TAIL"], "b": ["HEAD"], "c": ["HEAD", "TORSO"], "e": ["left hand"], "f": null, "g": [],
            },
            "part_annotations": {
                "a": ["waving", "wagging"], "d": {"HEAD": "nodding"}, "c": [1, 2, 3], "e": ["waving"], "f": "waving", "g": "waving",
            },
        });
        let release = parse(&document).expect("an object");
        assert_eq!(release.motions["a"].masks.len(), 1);
        assert!(release.motions["a"].is_judgement && !release.motions["e"].is_judgement);
        assert!(!release.motions["f"].is_judgement && !release.motions["g"].is_judgement);
        let kept = &release.motions["c"];
        assert_eq!(kept.masks.len(), 2);
        for problem in ["TAIL", "1 ids have masks but no texts"] {
            let mut messages = release.taken.messages.iter();
            assert!(messages.any(|message| message.contains(problem)));
        }
        let (_, texts) = entries(&kept.masks, kept.extra.as_ref());
        assert_eq!(texts, json!([1, 2, 3]));
        let older = json!({ "mask_all": {}, "pairs": [{ "kind": "style" }] });
        let release = parse(&older).expect("an object");
        assert!(release.pairs.is_empty() && release.taken.messages[0].contains("have no id"));
        for refused in [json!([]), json!({"other": 1}), json!({"mask_all": 7})] {
            assert!(parse(&refused).is_err());
        }
    }

    #[test]
    fn what_is_written_reads_as_it_was() {
        let document = json!({
            "mask_all": {"a": ["LEFT_ARM", "LEFT_ARM+HEAD"], "b": []},
            "part_annotations": {"a": ["waving", "nodding"], "b": []},
        });
        let mut written = json!({ "mask_all": {}, "part_annotations": {} });
        for (id, said) in parse(&document).expect("an object").motions {
            assert!(said.is_judgement, "{id}");
            let (masks, texts) = entries(&said.masks, said.extra.as_ref());
            written["mask_all"][&id] = masks;
            written["part_annotations"][&id] = texts;
        }
        assert_eq!(written, document);
    }
}
