//! `mask_all.json` and `part_annotations.json` of a STANCE release, and the files that an export adds to them:
//! `accepted_by.json` and `pairs.json`.
//!
//! The release documents the meaning of keys and values, but not their shape. Readers accept a name, a list of
//! names, a list of lists, or an object keyed by part, and report which. The writer uses one shape: for each id
//! a list of masks (parts joined by `+`), and a list of as many texts.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::BodyPart;
use serde::Deserialize;
use serde_json::{Map, Value, json};

use crate::wire::{EditType, MaskAnswer};

/// Annotations of one motion.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Said {
    pub(super) masks: Vec<MaskAnswer>,
    /// Unknown fields, kept for export.
    pub(super) extra: Option<Value>,
    /// How the annotations were accepted, if the file says so.
    pub(super) accepted_by: Option<String>,
}

/// A parsed release.
#[derive(Debug, Default)]
pub(super) struct Release {
    pub(super) motions: BTreeMap<String, Said>,
    pub(super) pairs: Vec<SaidPair>,
    pub(super) shapes: BTreeMap<String, i64>,
    pub(super) messages: Vec<String>,
}

/// A usable pair of `pairs.json`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub(super) struct SaidPair {
    /// As in table `pairs` of the dataset.
    pub(super) id: String,
    pub(super) kind: String,
    pub(super) src: String,
    pub(super) tgt: String,
    pub(super) body_part: String,
    pub(super) text: String,
    pub(super) style: Option<String>,
    pub(super) edit_type: Option<EditType>,
    pub(super) accepted_by: Option<String>,
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
pub(super) fn parts(text: &str) -> (Vec<String>, Vec<String>) {
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
pub(super) fn parse(document: &Value) -> Result<Release, String> {
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
        release.messages.push(format!(
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
            release.messages.push(format!("{count} {what}"));
        }
    }
    let ids: BTreeSet<&String> = masks.keys().chain(said.keys()).collect();
    for id in ids {
        let (mask, text) = (masks.get(id), said.get(id));
        for (value, file) in [(mask, "mask_all"), (text, "part_annotations")] {
            if let Some(value) = value {
                *release
                    .shapes
                    .entry(format!("{file} {}", shape(value)))
                    .or_default() += 1;
            }
        }
        let read = motion(mask.unwrap_or(&Value::Null), text.unwrap_or(&Value::Null));
        let (mut said, problems) = read;
        said.accepted_by = accepted_by
            .get(id)
            .and_then(Value::as_str)
            .map(str::to_owned);
        for problem in problems {
            if release.messages.len() < 50 {
                release.messages.push(format!("{id}: {problem}"));
            }
        }
        release.motions.insert(id.clone(), said);
    }
    Ok(release)
}

/// Reads the masks and texts of a motion, and returns what is wrong with them too.
fn motion(masks: &Value, said: &Value) -> (Said, Vec<String>) {
    let mut reader = MotionReader::default();
    match said {
        Value::Object(map) => reader.read_texts_by_part(masks, map),
        said => reader.read_texts_in_order(masks, said),
    }
    if reader.unknown.contains_key("part_annotations") {
        reader
            .problems
            .push("its texts do not match its masks and are kept as an unknown field".to_owned());
    }
    let said = Said {
        masks: reader.masks,
        extra: (!reader.unknown.is_empty()).then_some(Value::Object(reader.unknown)),
        accepted_by: None,
    };
    (said, reader.problems)
}

/// What has been read of a motion.
#[derive(Default)]
struct MotionReader {
    masks: Vec<MaskAnswer>,
    unknown: Map<String, Value>,
    problems: Vec<String>,
}

impl MotionReader {
    fn read_texts_by_part(&mut self, masks: &Value, said: &Map<String, Value>) {
        for (name, value) in said {
            for text in texts_or_empty(texts(value)) {
                if !self.put(name, text).is_empty() {
                    self.unknown.insert(name.clone(), value.clone());
                }
            }
        }
        // Masks without texts are kept.
        for name in names(masks) {
            if !said.keys().any(|known| parts(known).0 == parts(&name).0) {
                self.put(&name, String::new());
            }
        }
    }

    /// Reads texts that say nothing of parts: each belongs to the mask at its place.
    fn read_texts_in_order(&mut self, masks: &Value, said: &Value) {
        let names = names(masks);
        let list: Vec<Vec<String>> = match said {
            Value::Array(items) if items.len() == names.len() => items.iter().map(texts).collect(),
            Value::Array(_) if names.len() == 1 => vec![texts(said)],
            Value::String(_) => vec![texts(said); names.len()],
            Value::Null => Vec::new(),
            _ => {
                self.unknown
                    .insert("part_annotations".to_owned(), said.clone());
                // Marks fields that were kept aside.
                self.unknown.insert("kept_aside".to_owned(), json!(true));
                Vec::new()
            }
        };
        for (index, name) in names.iter().enumerate() {
            for text in texts_or_empty(list.get(index).cloned().unwrap_or_default()) {
                self.put(name, text);
            }
        }
    }

    /// Adds a mask, and returns the names in `name` that are no parts.
    fn put(&mut self, name: &str, text: String) -> Vec<String> {
        let (parts, lost) = parts(name);
        self.problems.extend(
            lost.iter()
                .map(|name| format!("body part {name:?} is not known")),
        );
        if !parts.is_empty() {
            self.masks.push(MaskAnswer {
                parts,
                soft: true,
                joints: Vec::new(),
                range: None,
                text,
                suggestion: None,
            });
        }
        lost
    }
}

/// The texts, or an empty one: masks without texts are kept.
fn texts_or_empty(texts: Vec<String>) -> Vec<String> {
    if texts.is_empty() {
        vec![String::new()]
    } else {
        texts
    }
}

/// Entries of the two files for a motion.
pub(super) fn entries(masks: &[MaskAnswer], extra: Option<&Value>) -> (Value, Value) {
    let names: Vec<String> = masks.iter().map(|mask| mask.parts.join("+")).collect();
    let texts: Vec<&str> = masks.iter().map(|mask| mask.text.as_str()).collect();
    // Write unknown fields unchanged.
    let kept = extra.and_then(|extra| extra.get("part_annotations"));
    (json!(names), kept.cloned().unwrap_or_else(|| json!(texts)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(masks: Value, texts: Value) -> Vec<(String, String)> {
        motion(&masks, &texts)
            .0
            .masks
            .into_iter()
            .map(|mask| (mask.parts.join("+"), mask.text))
            .collect()
    }

    fn expected(list: &[(&str, &str)]) -> Vec<(String, String)> {
        list.iter()
            .map(|(part, text)| ((*part).to_owned(), (*text).to_owned()))
            .collect()
    }

    #[test]
    fn every_shape_says_the_same() {
        let one = expected(&[("LEFT_ARM", "waving")]);
        for (masks, texts) in [
            (json!("LEFT_ARM"), json!("waving")),
            (json!(["left arm"]), json!(["waving"])),
            (json!([["LEFT_ARM"]]), json!([["waving"]])),
            (json!({"LEFT_ARM": 1}), json!({"LEFT_ARM": "waving"})),
            (Value::Null, json!({"LEFT_ARM": ["waving"]})),
        ] {
            assert_eq!(read(masks.clone(), texts.clone()), one, "{masks} {texts}");
        }
        assert_eq!(
            read(
                json!([["LEFT_ARM", "HEAD"], "LOWER_BODY"]),
                json!(["nodding", "walking"])
            ),
            expected(&[("LEFT_ARM+HEAD", "nodding"), ("LOWER_BODY", "walking")])
        );
    }

    #[test]
    fn what_is_not_understood_is_reported_and_kept() {
        let document = json!({
            "mask_all": {"a": ["LEFT_ARM", "TAIL"], "b": ["HEAD"], "c": ["HEAD", "TORSO"]},
            "part_annotations": {"a": ["waving", "wagging"], "d": {"HEAD": "nodding"}, "c": [1, 2, 3]},
        });
        let release = parse(&document).expect("an object");
        assert_eq!(release.motions["a"].masks.len(), 1);
        assert_eq!(release.motions["c"].masks.len(), 2);
        assert_eq!(
            release.motions["c"]
                .extra
                .as_ref()
                .and_then(|extra| extra.get("part_annotations")),
            Some(&json!([1, 2, 3]))
        );
        assert!(
            release
                .messages
                .iter()
                .any(|message| message.contains("TAIL"))
        );
        assert!(
            release
                .messages
                .iter()
                .any(|message| message.contains("1 ids have masks but no texts"))
        );
        let kept = &release.motions["c"];
        assert_eq!(
            entries(&kept.masks, kept.extra.as_ref()).1,
            json!([1, 2, 3])
        );
        let older = json!({ "mask_all": {}, "pairs": [{ "kind": "style" }] });
        let release = parse(&older).expect("an object");
        assert!(release.pairs.is_empty() && release.messages[0].contains("have no id"));
        assert!(parse(&json!([])).is_err());
        assert!(parse(&json!({"other": 1})).is_err());
        assert!(parse(&json!({"mask_all": 7})).is_err());
    }

    #[test]
    fn what_is_written_reads_as_it_was() {
        let document = json!({
            "mask_all": {"a": ["LEFT_ARM", "LEFT_ARM+HEAD"], "b": []},
            "part_annotations": {"a": ["waving", "nodding"], "b": []},
        });
        let once = parse(&document).expect("an object").motions;
        let (masks, texts): (Map<_, _>, Map<_, _>) = once
            .iter()
            .map(|(id, said)| {
                let (masks, texts) = entries(&said.masks, said.extra.as_ref());
                ((id.clone(), masks), (id.clone(), texts))
            })
            .unzip();
        let (masks, texts) = (Value::Object(masks), Value::Object(texts));
        assert_eq!(
            (&masks, &texts),
            (&document["mask_all"], &document["part_annotations"])
        );
        let again = parse(&json!({"mask_all": masks, "part_annotations": texts}))
            .expect("an object")
            .motions;
        assert_eq!(once, again);
    }
}
