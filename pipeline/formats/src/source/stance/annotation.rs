//! `mask_all.json` and `part_annotations.json`, in all known and likely layouts.

use std::collections::BTreeMap;

use datasets_spec::BodyPart;
use datasets_spec::table::PartCaption;
use serde_json::Value;

use super::name::{listed_name, motion_id};
use clip::{SourceClip, SourceMask};

/// Body-part annotations of the release.
#[derive(Clone, Debug, Default)]
pub(super) struct Annotations {
    by_id: BTreeMap<String, Annotation>,
}

/// Annotation of one motion.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Annotation {
    pub(super) masks: Vec<SourceMask>,
    /// Notes on parts of the annotation that could not be parsed.
    pub notes: Vec<String>,
}

impl Annotations {
    /// Joins the two files; either may be missing.
    pub(super) fn new(masks: &BTreeMap<String, Value>, texts: &BTreeMap<String, Value>) -> Self {
        let mut pairs: BTreeMap<String, [&Value; 2]> = BTreeMap::new();
        for (side, file) in [masks, texts].into_iter().enumerate() {
            for (key, value) in file {
                let pair = pairs
                    .entry(motion_id(listed_name(key)))
                    .or_insert([&Value::Null; 2]);
                pair[side] = value;
            }
        }
        let by_id = pairs
            .into_iter()
            .map(|(id, [masks, texts])| (id, Annotation::new(masks, texts)))
            .collect();
        Self { by_id }
    }

    /// Ids of the annotated motions.
    pub(super) fn ids(&self) -> impl Iterator<Item = &str> {
        self.by_id.keys().map(String::as_str)
    }

    /// Adds the annotation of a motion to its clip.
    pub(super) fn attach(&self, id: &str, clip: &mut SourceClip) {
        let Some(annotation) = self.by_id.get(id) else {
            return;
        };
        clip.notes.extend(annotation.notes.iter().cloned());
        clip.masks.extend(annotation.masks.iter().cloned());
        let said = annotation.masks.iter().filter(|mask| !mask.text.is_empty());
        clip.part_captions.extend(said.flat_map(|mask| {
            mask.parts.iter().map(|part| PartCaption {
                part: part.name().to_owned(),
                text: mask.text.clone(),
            })
        }));
    }
}

impl Annotation {
    fn new(masks: &Value, texts: &Value) -> Self {
        let mut annotation = Self::default();
        let masks = annotation.masks_of(masks);
        let mut said = vec![false; masks.len()];
        for (parts, text) in annotation.texts_of(texts, &masks) {
            // One part may be listed once for each of its texts.
            for (mask, said) in masks.iter().zip(&mut said) {
                *said |= *mask == parts;
            }
            let made = None;
            annotation.masks.push(SourceMask { parts, text, made });
        }
        let silent = masks.into_iter().zip(said).filter(|(_, said)| !said);
        annotation.masks.extend(silent.map(|(parts, _)| SourceMask {
            parts,
            text: String::new(),
            made: None,
        }));
        annotation
    }

    /// Parses masks: a name, a list of names, or a map from names to anything.
    fn masks_of(&mut self, value: &Value) -> Vec<Vec<BodyPart>> {
        let masks = match value {
            Value::String(name) => vec![self.parts(name)],
            Value::Array(items) => items
                .iter()
                .map(|item| match item {
                    Value::Array(names) => names
                        .iter()
                        .filter_map(Value::as_str)
                        .flat_map(|name| self.parts(name))
                        .collect(),
                    item => self.parts(item.as_str().unwrap_or_default()),
                })
                .collect(),
            Value::Object(map) => map.keys().map(|name| self.parts(name)).collect(),
            Value::Null => Vec::new(),
            other => {
                self.notes
                    .push(format!("masks of another form left out: {other}"));
                Vec::new()
            }
        };
        masks.into_iter().filter(|mask| !mask.is_empty()).collect()
    }

    /// Assigns texts to masks: one text for all masks, a list of texts in their order, or a map from names to texts.
    fn texts_of(&mut self, value: &Value, masks: &[Vec<BodyPart>]) -> Vec<(Vec<BodyPart>, String)> {
        let for_each = |mask: &Vec<BodyPart>, texts: &Value| -> Vec<(Vec<BodyPart>, String)> {
            all_texts(texts)
                .into_iter()
                .map(|text| (mask.clone(), text))
                .collect()
        };
        match value {
            Value::String(_) => masks
                .iter()
                .flat_map(|mask| for_each(mask, value))
                .collect(),
            Value::Array(items) if items.len() == masks.len() && !masks.is_empty() => masks
                .iter()
                .zip(items)
                .flat_map(|(mask, texts)| for_each(mask, texts))
                .collect(),
            Value::Array(_) if masks.len() == 1 => for_each(&masks[0], value),
            Value::Array(items) => {
                self.notes.push(format!(
                    "{} part texts of the release left out, they do not match its {} masks",
                    items.len(),
                    masks.len()
                ));
                Vec::new()
            }
            Value::Object(map) => map
                .iter()
                .map(|(name, texts)| (self.parts(name), texts))
                .filter(|(parts, _)| !parts.is_empty())
                .flat_map(|(parts, texts)| for_each(&parts, texts))
                .collect(),
            Value::Null => Vec::new(),
            other => {
                self.notes
                    .push(format!("part texts of another form left out: {other}"));
                Vec::new()
            }
        }
    }

    fn parts(&mut self, names: &str) -> Vec<BodyPart> {
        let (parts, unknown) = parse_parts(names);
        self.notes.extend(unknown);
        parts
    }
}

fn all_texts(value: &Value) -> Vec<String> {
    match value {
        Value::String(text) => vec![text.trim().to_owned()],
        Value::Array(items) => items.iter().flat_map(all_texts).collect(),
        Value::Object(map) => map.values().flat_map(all_texts).collect(),
        _ => Vec::new(),
    }
}

/// The parts in a name, which may join several with `+`, in any case and with spaces or underscores; and a note for
/// each unknown name.
pub(super) fn parse_parts(names: &str) -> (Vec<BodyPart>, Vec<String>) {
    let mut parts = Vec::new();
    let mut unknown = Vec::new();
    for name in names.split('+').map(str::trim).filter(|n| !n.is_empty()) {
        match name.to_uppercase().replace([' ', '-'], "_").parse() {
            Ok(part) => parts.push(part),
            Err(_) => unknown.push(format!("unknown body part {name:?} left out")),
        }
    }
    (parts, unknown)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn annotated(masks: Value, texts: Value) -> Vec<(String, String)> {
        Annotation::new(&masks, &texts)
            .masks
            .iter()
            .map(|mask| {
                let names: Vec<&str> = mask.parts.iter().map(|part| part.name()).collect();
                (names.join("+"), mask.text.clone())
            })
            .collect()
    }

    fn pairs(expected: &[(&str, &str)]) -> Vec<(String, String)> {
        expected
            .iter()
            .map(|(part, text)| ((*part).to_owned(), (*text).to_owned()))
            .collect()
    }

    #[test]
    fn every_shape_of_masks_and_texts_says_the_same() {
        let one = pairs(&[("LEFT_ARM", "waving")]);
        for (masks, texts) in [
            (json!("LEFT_ARM"), json!("waving")),
            (json!(["LEFT_ARM"]), json!(["waving"])),
            (json!({"LEFT_ARM": 1}), json!({"LEFT_ARM": "waving"})),
            (json!(["left arm"]), json!({"LEFT_ARM": ["waving"]})),
            (Value::Null, json!({"LEFT_ARM": "waving"})),
        ] {
            let found = annotated(masks.clone(), texts.clone());
            assert_eq!(found, one, "{masks} {texts}");
        }
        let two = pairs(&[("LEFT_ARM", "waving"), ("LOWER_BODY", "kneeling")]);
        for texts in [
            json!(["waving", "kneeling"]),
            json!([["waving"], ["kneeling"]]),
            json!({"LEFT_ARM": "waving", "LOWER_BODY": "kneeling"}),
        ] {
            assert_eq!(annotated(json!(["LEFT_ARM", "LOWER_BODY"]), texts), two);
        }
        let found = annotated(json!("LEFT_ARM"), json!(["waving", "greeting"]));
        let expected = [("LEFT_ARM", "waving"), ("LEFT_ARM", "greeting")];
        assert_eq!(found, pairs(&expected));
        let twice = json!(["LEFT_ARM", "LOWER_BODY", "LEFT_ARM"]);
        let found = annotated(twice, json!(["waving", "kneeling", "greeting"]));
        let expected = [
            ("LEFT_ARM", "waving"),
            ("LOWER_BODY", "kneeling"),
            ("LEFT_ARM", "greeting"),
        ];
        assert_eq!(found, pairs(&expected));
        let masks = json!([["LEFT_ARM", "HEAD"], "RIGHT_ARM"]);
        let found = annotated(masks, json!(["nodding", ""]));
        let expected = [("LEFT_ARM+HEAD", "nodding"), ("RIGHT_ARM", "")];
        assert_eq!(found, pairs(&expected));
    }

    #[test]
    fn masks_without_texts_stay_and_what_is_not_understood_is_noted() {
        let silent = annotated(json!(["LEFT_ARM", "RIGHT_ARM"]), Value::Null);
        assert_eq!(silent, pairs(&[("LEFT_ARM", ""), ("RIGHT_ARM", "")]));
        let odd = Annotation::new(&json!(["TAIL", "HEAD", "TORSO"]), &json!(["wagging"]));
        assert_eq!(odd.masks.len(), 2);
        assert_eq!(odd.notes.len(), 2, "{:?}", odd.notes);
        let none = Annotation::new(&json!(7), &json!(true));
        assert_eq!((none.masks.len(), none.notes.len()), (0, 2), "{none:?}");
    }

    #[test]
    fn keys_are_found_with_or_without_zeros_and_mirrored_ones_by_both_names() {
        let masks = [
            ("9", "HEAD"),
            ("M000009", "LEFT_ARM"),
            ("014626.pkl", "TORSO"),
        ];
        let masks = masks
            .map(|(key, part)| (key.to_owned(), json!(part)))
            .into();
        let annotations = Annotations::new(&masks, &BTreeMap::new());
        let ids: Vec<&str> = annotations.ids().collect();
        assert_eq!(ids, ["000009", "M000009", "M000010"]);
    }
}
