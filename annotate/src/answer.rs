//! Answers: validation, the joints they select, and the distance between two answers.

use std::collections::BTreeSet;

use datasets_spec::{BodyPart, JointSet};

use crate::error::{Error, require};
use crate::mask::{
    Cells, check_choices, check_names, check_ranges, jaccard, jaccard_in_time, joints,
    shortest_range,
};
use crate::wire::{
    Answer, Code, CountReason, EditType, Extent, MAX_MASKS, MAX_NAME_CHARS, MAX_TEXT_CHARS,
    MaskAnswer, Settings, Style, TaskKind, Verdict,
};

/// The fields of an answer of any kind. Fields that its kind does not have are empty.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Fields<'a> {
    pub(crate) masks: &'a [MaskAnswer],
    pub(crate) count_reason: Option<CountReason>,
    pub(crate) verdict: Option<Verdict>,
    pub(crate) parts: &'a [String],
    pub(crate) edit_type: Option<EditType>,
    pub(crate) style: Option<&'a str>,
    pub(crate) extent: Option<Extent>,
    pub(crate) text: &'a str,
    pub(crate) suggestion: Option<i64>,
    pub(crate) note: &'a str,
}

impl Fields<'_> {
    /// Builds an answer of `kind` from these fields. A missing verdict counts as [`Verdict::Keep`].
    pub(crate) fn answer(self, kind: TaskKind) -> Answer {
        let (parts, text) = (self.parts.to_vec(), self.text.to_owned());
        let (verdict, note) = (self.verdict.unwrap_or(Verdict::Keep), self.note.to_owned());
        match kind {
            TaskKind::MaskText => Answer::MaskText {
                masks: self.masks.to_vec(),
                count_reason: self.count_reason,
                note,
            },
            TaskKind::Pair => Answer::Pair {
                verdict,
                parts,
                edit_type: self.edit_type,
                text,
                suggestion: self.suggestion,
                note,
            },
            TaskKind::Style => Answer::Style {
                verdict,
                parts,
                style: self.style.map(str::to_owned),
                extent: self.extent,
                text,
                suggestion: self.suggestion,
                note,
            },
        }
    }
}

/// Checks a draft: fields may be missing, but each present field must be valid. The range of a mask may be too short:
/// this happens while its ends are dragged.
pub(crate) fn check_draft(answer: &Answer, kind: TaskKind) -> Result<(), Error> {
    let (said, own) = (answer.fields(), answer.kind());
    let problem = format!("the task is of kind {kind}, the answer of kind {own}");
    require(own == kind, "answer.kind", problem)?;
    let count = said.masks.len();
    let problem = format!("{count} masks are too many; {MAX_MASKS} fit");
    require(count <= MAX_MASKS, "answer.masks", problem)?;
    for mask in said.masks {
        check_parts(&mask.parts)?;
        check_names(&mask.joints)
            .map_err(|problem| Error::invalid("answer.masks.joints", problem))?;
        check_text("answer.masks.text", &mask.text)?;
    }
    check_parts(said.parts)?;
    check_text("answer.text", said.text)?;
    check_text("answer.style", said.style.unwrap_or_default())?;
    check_text("answer.note", said.note)
}

/// Whether an answer agrees with an imported one. Optional fields that the imported answer leaves empty do not count,
/// because most layouts cannot represent all of them. Neither does the order of masks: tables sort them by their ids.
pub(crate) fn says(ours: &Answer, imported: &Answer) -> bool {
    let kinds = (ours.kind(), imported.kind());
    let (ours, imported) = (ours.fields(), imported.fields());
    kinds.0 == kinds.1
        && say_masks(&ours.masks.iter().collect::<Vec<_>>(), imported.masks)
        && (ours.verdict, ours.parts) == (imported.verdict, imported.parts)
        && is_given(ours.count_reason, imported.count_reason)
        && is_given(ours.edit_type, imported.edit_type)
        && is_given(ours.style, imported.style)
        && is_given(ours.extent, imported.extent)
        && ours.text.trim() == imported.text.trim()
        && (imported.note.is_empty() || ours.note == imported.note)
}

/// Whether two answers become equal rows in a dataset. Its tables hold texts as whole sentences and parts in place of an
/// extent; they have neither notes, nor reasons, nor masks without a text.
pub(crate) fn are_stored_alike(a: &Answer, b: &Answer) -> bool {
    let masks = |answer: &Answer| {
        let masks = answer.fields().masks.iter();
        let with_text = masks.filter(|mask| !mask.text.trim().is_empty());
        let mut stored: Vec<_> = with_text
            .map(|mask| {
                let joints = mask.mask();
                let (hard, soft) = (joints.hard().names(), joints.soft().names());
                (hard, soft, mask.range, stored_words(&mask.text))
            })
            .collect();
        stored.sort();
        stored
    };
    let (one, other) = (a.fields(), b.fields());
    a.kind() == b.kind()
        && masks(a) == masks(b)
        && one.verdict == other.verdict
        && (a.is_reject()
            || (
                stored_parts(&one),
                one.style,
                one.edit_type,
                one.text.trim(),
            ) == (
                stored_parts(&other),
                other.style,
                other.edit_type,
                other.text.trim(),
            ))
}

/// The body parts of a pair in the tables of a dataset: those that the answer names, else those of its extent.
pub(crate) fn stored_parts(said: &Fields<'_>) -> Vec<String> {
    match said.extent {
        Some(Extent::Lower) if said.parts.is_empty() => vec!["LOWER_BODY".to_owned()],
        Some(Extent::Upper) if said.parts.is_empty() => vec!["UPPER_BODY".to_owned()],
        _ => said.parts.to_vec(),
    }
}

/// The words of a description, by which those of a table are compared with those that people wrote.
pub(crate) fn stored_words(text: &str) -> String {
    completion(&sentence(text)).to_owned()
}

/// Whether answers to one task are equal, texts included and notes aside.
pub(crate) fn share_words(answers: &[Answer]) -> bool {
    let plain = |answer: &Answer| {
        let fields = answer.fields();
        Fields { note: "", ..fields }.answer(answer.kind())
    };
    let plain: Vec<Answer> = answers.iter().map(plain).collect();
    let is_same = |pair: &[Answer]| says(&pair[0], &pair[1]) && says(&pair[1], &pair[0]);
    plain.windows(2).all(is_same)
}

/// Whether each of our masks can be matched with an imported mask that it agrees with, and none is left over.
fn say_masks(ours: &[&MaskAnswer], imported: &[MaskAnswer]) -> bool {
    let Some((first, others)) = imported.split_first() else {
        return ours.is_empty();
    };
    let mut places = (0..ours.len()).filter(|&place| says_mask(ours[place], first));
    ours.len() == imported.len()
        && places.any(|place| {
            let mut left = ours.to_vec();
            left.remove(place);
            say_masks(&left, others)
        })
}

fn says_mask(ours: &MaskAnswer, imported: &MaskAnswer) -> bool {
    let is_of_parts = imported.soft && imported.joints.is_empty();
    ours.parts == imported.parts
        && ours.text.trim() == imported.text.trim()
        && (is_of_parts || ours.mask() == imported.mask())
        && is_given(ours.range, imported.range)
}

fn is_given<T: PartialEq>(ours: Option<T>, imported: Option<T>) -> bool {
    imported.is_none() || ours == imported
}

/// Checks a submitted answer about a clip with a number of frames and a rate: a valid draft without missing fields.
pub(crate) fn check_submission(
    answer: &Answer,
    kind: TaskKind,
    settings: &Settings,
    (frames, fps): (i64, f64),
) -> Result<(), Error> {
    check_draft(answer, kind)?;
    let said = answer.fields();
    match kind {
        TaskKind::MaskText => {
            check_masks(said.masks, frames)?;
            check_ranges(said.masks, frames, shortest_range(fps))?;
            check_mask_count(said.masks.len(), said.count_reason, settings)
        }
        _ if answer.is_reject() => Ok(()),
        TaskKind::Pair => {
            text_needed("answer.text", said.text)?;
            let no_part = "choose the parts the edit changes";
            require(!said.parts.is_empty(), "answer.parts", no_part)?;
            let no_type = "choose what the edit changes";
            require(said.edit_type.is_some(), "answer.edit_type", no_type)
        }
        TaskKind::Style => {
            check_style_name(said.style.unwrap_or_default(), settings)?;
            let problem = "choose how much of the body the style shows in";
            require(said.extent.is_some(), "answer.extent", problem)
        }
    }
}

/// Checks that each mask has a part, a hard joint and a text, and that no two are the same.
fn check_masks(masks: &[MaskAnswer], frames: i64) -> Result<(), Error> {
    for (index, mask) in masks.iter().enumerate() {
        let (number, field) = (index + 1, format!("answer.masks.{index}"));
        let problem = format!("mask {number} has no part; choose one or delete the mask");
        require(!mask.parts.is_empty(), &format!("{field}.parts"), problem)?;
        check_choices(&mask.parts, mask.soft, &mask.joints).map_err(|problem| {
            let problem = format!("mask {number}: {problem}");
            Error::invalid(&format!("{field}.joints"), problem)
        })?;
        text_needed(&format!("{field}.text"), &mask.text)?;
        let same = masks[..index].iter().position(|other| {
            other.is_like(mask, frames) && normal(&other.text) == normal(&mask.text)
        });
        if let Some(other) = same {
            let other = other + 1;
            let problem = format!("masks {other} and {number} say the same; delete one");
            return Err(Error::invalid(&field, problem));
        }
    }
    Ok(())
}

/// Checks that there are as many masks as the project asks for, or that a reason is given.
fn check_mask_count(
    count: usize,
    reason: Option<CountReason>,
    settings: &Settings,
) -> Result<(), Error> {
    let is_asked_for = count > 0 && (settings.min_masks..=settings.max_masks).contains(&count);
    if is_asked_for || reason.is_some() {
        return Ok(());
    }
    let problem = format!(
        "{count} masks where {} to {} are asked for; add or delete some, or choose a reason",
        settings.min_masks, settings.max_masks
    );
    Err(Error::refused(Code::MaskCount, problem))
}

/// Checks the name of a style: one of the project's, or a new one that differs from those in more than capital letters.
pub(crate) fn check_style_name(style: &str, settings: &Settings) -> Result<(), Error> {
    text_needed("answer.style", style)?;
    let is_name = style.trim() == style && style.chars().count() <= MAX_NAME_CHARS;
    let problem =
        format!("name the style in up to {MAX_NAME_CHARS} characters, without spaces around it");
    require(is_name, "answer.style", problem)?;
    let alike = |known: &&Style| known.name.to_lowercase() == style.to_lowercase();
    if !settings.has_style(style)
        && let Some(known) = settings.styles.iter().find(alike)
    {
        let problem = format!(
            "{style:?} differs from the style {:?} in capital letters alone; choose that one",
            known.name
        );
        return Err(Error::invalid("answer.style", problem));
    }
    Ok(())
}

fn text_needed(field: &str, text: &str) -> Result<(), Error> {
    let problem = "a text is missing: say what the parts do";
    require(!text.trim().is_empty(), field, problem)
}

fn check_parts(parts: &[String]) -> Result<(), Error> {
    for (index, part) in parts.iter().enumerate() {
        let known = part.parse::<BodyPart>();
        known.map_err(|error| Error::invalid("parts", error.to_string()))?;
        let problem = format!("{part} is named twice");
        require(!parts[..index].contains(part), "parts", problem)?;
    }
    Ok(())
}

/// Refuses a text that is too long or holds a control character: PostgreSQL cannot store NUL.
pub(crate) fn check_text(field: &str, text: &str) -> Result<(), Error> {
    let chars = text.chars().count();
    let problem = format!("{chars} characters are too many; {MAX_TEXT_CHARS} fit");
    require(chars <= MAX_TEXT_CHARS, field, problem)?;
    let has_control = text.contains(|c: char| c.is_control() && c != '\n' && c != '\t');
    let problem = "the text holds a control character; remove it";
    require(!has_control, field, problem)
}

fn normal(text: &str) -> String {
    let words: Vec<String> = text.split_whitespace().map(str::to_lowercase).collect();
    words.join(" ")
}

/// Beginning of a description that is a whole sentence.
const SUBJECT: &str = "the person is ";

/// A description as the continuation of "The person is …": these words and the full stop of their sentence are removed.
pub(crate) fn completion(text: &str) -> &str {
    let bare = text.trim();
    match bare.get(..SUBJECT.len()) {
        Some(start) if start.eq_ignore_ascii_case(SUBJECT) => {
            bare[SUBJECT.len()..].trim().trim_end_matches('.')
        }
        _ => bare,
    }
}

/// Words in -ing, of more than four letters, that are no gerunds.
const NO_GERUNDS: [&str; 11] = [
    "bring", "cling", "during", "fling", "sling", "spring", "sting", "string", "swing", "thing",
    "wring",
];

/// A description as a whole sentence, as the tables of a dataset hold it: "waving" becomes "The person is waving.".
/// A text without a gerund among its first two words is only trimmed.
pub(crate) fn sentence(text: &str) -> String {
    let bare = text.trim();
    let is_gerund = |word: &str| {
        let letters = word.trim_end_matches(|c: char| !c.is_alphabetic());
        let is_other = NO_GERUNDS
            .iter()
            .any(|other| other.eq_ignore_ascii_case(letters));
        letters.len() > 4 && letters.ends_with("ing") && !is_other
    };
    // "slowly waving" continues the sentence too.
    if !bare.split_whitespace().take(2).any(is_gerund) {
        return bare.to_owned();
    }
    format!("The person is {}.", bare.trim_end_matches('.'))
}

impl Answer {
    /// Kind of the tasks that such an answer is given to.
    pub fn kind(&self) -> TaskKind {
        match self {
            Self::MaskText { .. } => TaskKind::MaskText,
            Self::Pair { .. } => TaskKind::Pair,
            Self::Style { .. } => TaskKind::Style,
        }
    }

    pub(crate) fn fields(&self) -> Fields<'_> {
        match self {
            Self::MaskText {
                masks,
                count_reason,
                note,
            } => Fields {
                masks,
                count_reason: *count_reason,
                note,
                ..Fields::default()
            },
            Self::Pair {
                verdict,
                parts,
                edit_type,
                text,
                suggestion,
                note,
            } => Fields {
                verdict: Some(*verdict),
                parts,
                edit_type: *edit_type,
                text,
                suggestion: *suggestion,
                note,
                ..Fields::default()
            },
            Self::Style {
                verdict,
                parts,
                style,
                extent,
                text,
                suggestion,
                note,
            } => Fields {
                verdict: Some(*verdict),
                parts,
                style: style.as_deref(),
                extent: *extent,
                text,
                suggestion: *suggestion,
                note,
                ..Fields::default()
            },
        }
    }

    /// The verdict on a pair; `None` for masks.
    pub fn verdict(&self) -> Option<Verdict> {
        self.fields().verdict
    }

    /// Whether the answer rejects a pair.
    pub(crate) fn is_reject(&self) -> bool {
        self.verdict()
            .is_some_and(|verdict| verdict != Verdict::Keep)
    }

    /// The style of a pair that is kept, if the project does not have it yet.
    pub(crate) fn new_style(&self, settings: &Settings) -> Option<&str> {
        let style = self.fields().style.filter(|_| !self.is_reject());
        style.filter(|style| !settings.has_style(style))
    }

    /// Hard joints of all parts and masks of the answer.
    pub(crate) fn joints(&self) -> JointSet {
        let said = self.fields();
        let masks = said.masks.iter();
        masks.fold(joints(said.parts), |set, mask| {
            set.union(mask.mask().hard())
        })
    }

    /// Names of all parts of the answer.
    pub(crate) fn part_names(&self) -> BTreeSet<&str> {
        let said = self.fields();
        let of_masks = said.masks.iter().flat_map(|mask| &mask.parts);
        of_masks.chain(said.parts).map(String::as_str).collect()
    }

    /// Hard joints and frames of each mask in a clip with `frames` frames.
    pub(crate) fn cells(&self, frames: i64) -> Vec<Cells> {
        let masks = self.fields().masks.iter();
        masks.map(|mask| mask.cells(frames)).collect()
    }

    /// The texts, each with the suggestion it started from.
    pub(crate) fn texts(&self) -> Vec<(&str, Option<i64>)> {
        let said = self.fields();
        match self.kind() {
            TaskKind::MaskText => said
                .masks
                .iter()
                .map(|mask| (mask.text.as_str(), mask.suggestion))
                .collect(),
            TaskKind::Pair | TaskKind::Style => vec![(said.text, said.suggestion)],
        }
    }
}

/// Distance of two answers about a clip with `frames` frames, 0 to 1.
///
/// Masks are compared as sets of (hard joint, frame). The Jaccard distance of each mask to the nearest mask of the
/// other answer is averaged over the masks of an answer, and then over both answers. Answers to pairs have distance 1
/// if their verdicts differ, and 0 if both reject with the same verdict. If both keep the pair, it is the mean of two
/// numbers: the Jaccard distance of their joints, and 0 for the same edit type and style or else 1.
pub(crate) fn distance(a: &Answer, b: &Answer, frames: i64) -> f64 {
    if a.verdict() != b.verdict() || a.kind() != b.kind() {
        return 1.0;
    }
    match a.verdict() {
        None => {
            let (a, b) = (a.cells(frames), b.cells(frames));
            f64::midpoint(to_nearest(&a, &b), to_nearest(&b, &a))
        }
        Some(Verdict::Keep) => {
            let (own, other) = (a.fields(), b.fields());
            let differ = (own.edit_type, own.style) != (other.edit_type, other.style);
            let parts = 1.0 - jaccard(a.joints(), b.joints());
            f64::midpoint(parts, f64::from(u8::from(differ)))
        }
        Some(_) => 0.0,
    }
}

/// Mean distance of each mask to the nearest of the others; 0 if both lists are empty, 1 if only one is.
fn to_nearest(masks: &[Cells], others: &[Cells]) -> f64 {
    if masks.is_empty() {
        return f64::from(u8::from(!others.is_empty()));
    }
    let nearest = |mask: &Cells| {
        others
            .iter()
            .map(|other| 1.0 - jaccard_in_time(&[*mask], &[*other]))
            .fold(1.0, f64::min)
    };
    masks.iter().map(nearest).sum::<f64>() / masks.len() as f64
}

/// Largest distance between two of the answers about a clip with `frames` frames, or `None` for fewer than two.
pub(crate) fn spread(answers: &[Answer], frames: i64) -> Option<f64> {
    let pairs = answers.iter().enumerate().flat_map(|(index, a)| {
        let later = answers[index + 1..].iter();
        later.map(move |b| (a, b))
    });
    let distances = pairs.map(|(a, b)| distance(a, b, frames));
    distances.reduce(f64::max)
}

/// Edit distance of two texts by characters (Levenshtein), divided by the length of the longer one.
pub(crate) fn text_distance(a: &str, b: &str) -> f64 {
    let (a, b) = (a.trim(), b.trim());
    let longer = a.chars().count().max(b.chars().count());
    // Two empty texts are equal.
    strsim::levenshtein(a, b) as f64 / longer.max(1) as f64
}

#[cfg(test)]
mod tests;
