//! Answers: validation, the joints they select, and the distance between two answers.

use datasets_spec::{BodyPart, JointSet};

use crate::Error;
use crate::mask::{
    Cells, check_choices, check_names, check_ranges, jaccard, jaccard_in_time, joints,
};
use crate::wire::{
    Answer, Code, CountReason, EditType, Extent, MAX_MASKS, MAX_NAME_CHARS, MAX_TEXT_CHARS,
    MaskAnswer, Problem, Settings, Style, TaskKind, Verdict,
};

/// Checks a draft: fields may be missing, but each present field must be valid. The range of a mask may be too short: it is
/// so while its ends are moved.
///
/// # Errors
/// The answer has another kind than the task, names an unknown part or joint, or is too long.
pub fn check_draft(answer: &Answer, kind: TaskKind) -> Result<(), Error> {
    if answer.kind() != kind {
        return Err(Error::invalid(
            "answer.kind",
            format!(
                "the task is of kind {kind}, the answer of kind {}",
                answer.kind()
            ),
        ));
    }
    match answer {
        Answer::MaskText { masks, note, .. } => {
            if masks.len() > MAX_MASKS {
                return Err(Error::invalid(
                    "answer.masks",
                    format!("{} masks are too many; {MAX_MASKS} fit", masks.len()),
                ));
            }
            for mask in masks {
                check_parts(&mask.parts)?;
                check_names(&mask.joints)
                    .map_err(|problem| Error::invalid("answer.masks.joints", problem))?;
                check_text("answer.masks.text", &mask.text)?;
            }
            check_text("answer.note", note)
        }
        Answer::Pair {
            parts, text, note, ..
        } => {
            check_parts(parts)?;
            check_text("answer.text", text)?;
            check_text("answer.note", note)
        }
        Answer::Style {
            parts,
            text,
            note,
            style,
            ..
        } => {
            check_parts(parts)?;
            check_text("answer.text", text)?;
            check_text("answer.style", style.as_deref().unwrap_or_default())?;
            check_text("answer.note", note)
        }
    }
}

/// Whether an answer says what an imported one says. Fields that the imported answer leaves empty do not count, because
/// most layouts cannot represent all of them.
pub(crate) fn says(ours: &Answer, imported: &Answer) -> bool {
    match (ours, imported) {
        (
            Answer::MaskText {
                masks,
                count_reason,
                note,
            },
            Answer::MaskText {
                masks: their_masks,
                count_reason: their_reason,
                note: their_note,
            },
        ) => {
            masks.len() == their_masks.len()
                && masks
                    .iter()
                    .zip(their_masks)
                    .all(|(mask, theirs)| says_mask(mask, theirs))
                && is_given(count_reason.as_ref(), their_reason.as_ref())
                && is_noted(note, their_note)
        }
        (
            Answer::Pair {
                verdict,
                parts,
                edit_type,
                text,
                note,
                ..
            },
            Answer::Pair {
                verdict: their_verdict,
                parts: their_parts,
                edit_type: their_type,
                text: their_text,
                note: their_note,
                ..
            },
        ) => {
            verdict == their_verdict
                && parts == their_parts
                && is_given(edit_type.as_ref(), their_type.as_ref())
                && same_text(text, their_text)
                && is_noted(note, their_note)
        }
        (
            Answer::Style {
                verdict,
                parts,
                style,
                extent,
                text,
                note,
                ..
            },
            Answer::Style {
                verdict: their_verdict,
                parts: their_parts,
                style: their_style,
                extent: their_extent,
                text: their_text,
                note: their_note,
                ..
            },
        ) => {
            verdict == their_verdict
                && parts == their_parts
                && is_given(style.as_ref(), their_style.as_ref())
                && is_given(extent.as_ref(), their_extent.as_ref())
                && same_text(text, their_text)
                && is_noted(note, their_note)
        }
        _ => false,
    }
}

fn says_mask(ours: &MaskAnswer, imported: &MaskAnswer) -> bool {
    let is_of_parts = imported.soft && imported.joints.is_empty();
    ours.parts == imported.parts
        && same_text(&ours.text, &imported.text)
        && (is_of_parts || ours.mask() == imported.mask())
        && is_given(ours.range.as_ref(), imported.range.as_ref())
}

fn is_given<T: PartialEq>(ours: Option<&T>, imported: Option<&T>) -> bool {
    imported.is_none() || ours == imported
}

fn is_noted(ours: &str, imported: &str) -> bool {
    imported.is_empty() || ours == imported
}

fn same_text(ours: &str, imported: &str) -> bool {
    ours.trim() == imported.trim()
}

/// Checks a submitted answer about a clip with `frames` frames.
///
/// # Errors
/// As [`check_draft`]; or:
/// * a field is missing;
/// * a mask has no hard joint, or a choice for a joint repeats what the parts give it;
/// * the range of a mask leaves the clip, or is too short;
/// * the number of masks is not one that the project wants, and no reason is given.
pub fn check_submission(
    answer: &Answer,
    kind: TaskKind,
    settings: &Settings,
    frames: i64,
) -> Result<(), Error> {
    check_draft(answer, kind)?;
    match answer {
        Answer::MaskText {
            masks,
            count_reason,
            ..
        } => {
            check_masks(masks, frames)?;
            check_ranges(answer, frames)?;
            check_mask_count(masks.len(), *count_reason, settings)
        }
        Answer::Pair {
            verdict: Verdict::Keep,
            parts,
            edit_type,
            text,
            ..
        } => check_usable_pair(parts, *edit_type, text),
        Answer::Style {
            verdict: Verdict::Keep,
            style,
            extent,
            ..
        } => check_usable_style(style.as_ref(), *extent, settings),
        Answer::Pair { .. } | Answer::Style { .. } => Ok(()),
    }
}

/// Each mask has a part, a hard joint and a text, and no two are the same.
fn check_masks(masks: &[MaskAnswer], frames: i64) -> Result<(), Error> {
    for (index, mask) in masks.iter().enumerate() {
        if mask.parts.is_empty() {
            return Err(Error::invalid(
                &format!("answer.masks.{index}.parts"),
                format!(
                    "mask {} has no part; choose one or delete the mask",
                    index + 1
                ),
            ));
        }
        check_choices(&mask.parts, mask.soft, &mask.joints).map_err(|problem| {
            let field = format!("answer.masks.{index}.joints");
            Error::invalid(&field, format!("mask {}: {problem}", index + 1))
        })?;
        text_needed(&format!("answer.masks.{index}.text"), &mask.text)?;
        let same = masks[..index].iter().position(|other| {
            other.is_like(mask, frames) && normal(&other.text) == normal(&mask.text)
        });
        if let Some(other) = same {
            return Err(Error::invalid(
                &format!("answer.masks.{index}"),
                format!(
                    "masks {} and {} say the same; delete one",
                    other + 1,
                    index + 1
                ),
            ));
        }
    }
    Ok(())
}

/// There are as many masks as the project asks for, or a reason why not.
fn check_mask_count(
    count: usize,
    reason: Option<CountReason>,
    settings: &Settings,
) -> Result<(), Error> {
    let is_asked_for = count > 0 && (settings.min_masks..=settings.max_masks).contains(&count);
    if is_asked_for || reason.is_some() {
        return Ok(());
    }
    Err(Error::Refused(Box::new(Problem::new(
        Code::MaskCount,
        format!(
            "{count} masks where {} to {} are asked for; add or delete some, or choose a reason",
            settings.min_masks, settings.max_masks
        ),
    ))))
}

fn check_usable_pair(
    parts: &[String],
    edit_type: Option<EditType>,
    text: &str,
) -> Result<(), Error> {
    text_needed("answer.text", text)?;
    if parts.is_empty() {
        return Err(Error::invalid(
            "answer.parts",
            "choose the parts the edit changes",
        ));
    }
    if edit_type.is_none() {
        return Err(Error::invalid(
            "answer.edit_type",
            "choose what the edit changes",
        ));
    }
    Ok(())
}

fn check_usable_style(
    style: Option<&String>,
    extent: Option<Extent>,
    settings: &Settings,
) -> Result<(), Error> {
    check_style_name(style.map_or("", String::as_str), settings)?;
    if extent.is_none() {
        return Err(Error::invalid(
            "answer.extent",
            "choose how much of the body the style shows in",
        ));
    }
    Ok(())
}

/// Checks the name of a style: one of the project's, or a new one that cannot be taken for one of these.
///
/// # Errors
/// The name is empty or too long, has spaces around it, or differs from a style of the project in capital letters
/// alone.
pub fn check_style_name(style: &str, settings: &Settings) -> Result<(), Error> {
    text_needed("answer.style", style)?;
    if style.trim() != style || style.chars().count() > MAX_NAME_CHARS {
        return Err(Error::invalid(
            "answer.style",
            format!(
                "name the style in up to {MAX_NAME_CHARS} characters, without spaces around it"
            ),
        ));
    }
    let alike = |known: &&Style| known.name.to_lowercase() == style.to_lowercase();
    if !settings.has_style(style)
        && let Some(known) = settings.styles.iter().find(alike)
    {
        return Err(Error::invalid(
            "answer.style",
            format!(
                "{style:?} differs from the style {:?} in capital letters alone; choose that one",
                known.name
            ),
        ));
    }
    Ok(())
}

fn text_needed(field: &str, text: &str) -> Result<(), Error> {
    if text.trim().is_empty() {
        return Err(Error::invalid(
            field,
            "a text is missing: say what the parts do",
        ));
    }
    Ok(())
}

fn check_parts(parts: &[String]) -> Result<(), Error> {
    if parts.len() > BodyPart::ALL.len() {
        return Err(Error::invalid("parts", "a part is named more than once"));
    }
    for (index, part) in parts.iter().enumerate() {
        if let Err(error) = part.parse::<BodyPart>() {
            return Err(Error::invalid("parts", error.to_string()));
        }
        if parts[..index].contains(part) {
            return Err(Error::invalid("parts", format!("{part} is named twice")));
        }
    }
    Ok(())
}

fn check_text(field: &str, text: &str) -> Result<(), Error> {
    let chars = text.chars().count();
    if chars > MAX_TEXT_CHARS {
        return Err(Error::invalid(
            field,
            format!("{chars} characters are too many; {MAX_TEXT_CHARS} fit"),
        ));
    }
    let control = |c: char| c.is_control() && c != '\n' && c != '\t';
    if text.chars().any(control) {
        return Err(Error::invalid(
            field,
            "the text holds a control character; remove it",
        ));
    }
    Ok(())
}

fn normal(text: &str) -> String {
    let words: Vec<String> = text.split_whitespace().map(str::to_lowercase).collect();
    words.join(" ")
}

/// What a description starts with as a whole sentence.
const SUBJECT: &str = "the person is ";

/// A description as the continuation of "The person is …": without these words, and without the full stop after them.
pub fn completion(text: &str) -> &str {
    let bare = text.trim();
    match bare.get(..SUBJECT.len()) {
        Some(start) if start.eq_ignore_ascii_case(SUBJECT) => {
            bare[SUBJECT.len()..].trim().trim_end_matches('.')
        }
        _ => bare,
    }
}

/// A description as a whole sentence, as the tables of a dataset hold it: "waving" becomes "The person is waving.".
/// Texts that do not read on from "The person is" stay as they are.
pub fn sentence(text: &str) -> String {
    let bare = text.trim();
    let is_gerund = |word: &str| {
        let letters = word.trim_end_matches(|c: char| !c.is_alphabetic());
        letters.len() > 4 && letters.ends_with("ing")
    };
    // "slowly waving" reads on too.
    if !bare.split_whitespace().take(2).any(is_gerund) {
        return bare.to_owned();
    }
    format!("The person is {}.", bare.trim_end_matches('.'))
}

impl Answer {
    /// The kind of task it answers.
    pub fn kind(&self) -> TaskKind {
        match self {
            Self::MaskText { .. } => TaskKind::MaskText,
            Self::Pair { .. } => TaskKind::Pair,
            Self::Style { .. } => TaskKind::Style,
        }
    }

    /// The verdict on a pair.
    pub fn verdict(&self) -> Option<Verdict> {
        match self {
            Self::MaskText { .. } => None,
            Self::Pair { verdict, .. } | Self::Style { verdict, .. } => Some(*verdict),
        }
    }

    /// Whether it judges a pair unusable.
    pub fn is_reject(&self) -> bool {
        self.verdict()
            .is_some_and(|verdict| verdict != Verdict::Keep)
    }

    /// The type of edit of a pair.
    pub fn edit_type(&self) -> Option<EditType> {
        match self {
            Self::Pair { edit_type, .. } => *edit_type,
            Self::MaskText { .. } | Self::Style { .. } => None,
        }
    }

    /// The style of a pair that is kept, if the project does not have it yet.
    pub fn new_style(&self, settings: &Settings) -> Option<&str> {
        match self {
            Self::Style {
                verdict: Verdict::Keep,
                style: Some(style),
                ..
            } if !settings.has_style(style) => Some(style),
            _ => None,
        }
    }

    /// Union of the hard joints of all masks.
    pub fn joints(&self) -> JointSet {
        match self {
            Self::MaskText { masks, .. } => masks
                .iter()
                .fold(JointSet::EMPTY, |set, mask| set.union(mask.mask().hard())),
            Self::Pair { parts, .. } | Self::Style { parts, .. } => joints(parts),
        }
    }

    /// Names of all its parts.
    pub fn part_names(&self) -> std::collections::BTreeSet<&str> {
        match self {
            Self::MaskText { masks, .. } => masks
                .iter()
                .flat_map(|mask| mask.parts.iter().map(String::as_str))
                .collect(),
            Self::Pair { parts, .. } | Self::Style { parts, .. } => {
                parts.iter().map(String::as_str).collect()
            }
        }
    }

    /// What its masks take of a clip with `frames` frames.
    pub(crate) fn cells(&self, frames: i64) -> Vec<Cells> {
        match self {
            Self::MaskText { masks, .. } => masks.iter().map(|mask| mask.cells(frames)).collect(),
            Self::Pair { .. } | Self::Style { .. } => Vec::new(),
        }
    }

    /// Whether a mask of it holds for a range of frames.
    pub fn has_range(&self) -> bool {
        matches!(self, Self::MaskText { masks, .. } if masks.iter().any(|mask| mask.range.is_some()))
    }

    /// The note.
    pub fn note(&self) -> &str {
        match self {
            Self::MaskText { note, .. } | Self::Pair { note, .. } | Self::Style { note, .. } => {
                note
            }
        }
    }

    /// The texts, each with the suggestion it started from.
    pub fn texts(&self) -> Vec<(&str, Option<i64>)> {
        match self {
            Self::MaskText { masks, .. } => masks
                .iter()
                .map(|mask| (mask.text.as_str(), mask.suggestion))
                .collect(),
            Self::Pair {
                text, suggestion, ..
            }
            | Self::Style {
                text, suggestion, ..
            } => {
                vec![(text.as_str(), *suggestion)]
            }
        }
    }
}

/// Distance of two answers about a clip with `frames` frames, 0 to 1.
///
/// A mask is the set of its hard joints in each of its frames. Each mask of either answer has a Jaccard distance to the
/// nearest mask of the other one; the result is their mean, by answer and then over both. Pairs: 1 for different verdicts,
/// else by parts and label.
pub fn distance(a: &Answer, b: &Answer, frames: i64) -> f64 {
    match (a, b) {
        (Answer::MaskText { .. }, Answer::MaskText { .. }) => {
            let (a, b) = (a.cells(frames), b.cells(frames));
            let one_way = |from: &[Cells], to: &[Cells]| -> f64 {
                if from.is_empty() {
                    return f64::from(u8::from(!to.is_empty()));
                }
                let nearest = |mask: &Cells| {
                    to.iter()
                        .map(|other| 1.0 - jaccard_in_time(&[*mask], &[*other]))
                        .fold(1.0, f64::min)
                };
                from.iter().map(nearest).sum::<f64>() / from.len() as f64
            };
            f64::midpoint(one_way(&a, &b), one_way(&b, &a))
        }
        _ if a.verdict() != b.verdict() || a.kind() != b.kind() => 1.0,
        _ if a.verdict() != Some(Verdict::Keep) => 0.0,
        _ => {
            let label = |answer: &Answer| match answer {
                Answer::Pair { edit_type, .. } => edit_type.map(|kind| kind.to_string()),
                Answer::Style { style, .. } => style.clone(),
                Answer::MaskText { .. } => None,
            };
            let labels = f64::from(u8::from(label(a) != label(b)));
            f64::midpoint(1.0 - jaccard(a.joints(), b.joints()), labels)
        }
    }
}

/// Largest distance between two of the answers about a clip with `frames` frames, or `None` for fewer than two.
pub fn spread(answers: &[Answer], frames: i64) -> Option<f64> {
    let mut most = None;
    for (index, a) in answers.iter().enumerate() {
        for b in &answers[index + 1..] {
            let apart = distance(a, b, frames);
            most = Some(most.map_or(apart, |most: f64| most.max(apart)));
        }
    }
    most
}

/// Edit distance of two texts by characters (Levenshtein), divided by the length of the longer one.
pub fn text_distance(a: &str, b: &str) -> f64 {
    let a: Vec<char> = a.trim().chars().collect();
    let b: Vec<char> = b.trim().chars().collect();
    if a.is_empty() && b.is_empty() {
        return 0.0;
    }
    let mut before: Vec<usize> = (0..=b.len()).collect();
    for (row, x) in a.iter().enumerate() {
        let mut now = vec![row + 1];
        for (column, y) in b.iter().enumerate() {
            let kept = before[column] + usize::from(x != y);
            now.push(kept.min(before[column + 1] + 1).min(now[column] + 1));
        }
        before = now;
    }
    before[b.len()] as f64 / a.len().max(b.len()) as f64
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::wire::{JointChoice, JointWeight};

    /// Frames of the clip.
    const FRAMES: i64 = 40;

    pub(crate) fn masks(list: &[(&[&str], &str)]) -> Answer {
        Answer::MaskText {
            masks: list
                .iter()
                .map(|(parts, text)| MaskAnswer {
                    parts: parts.iter().map(|&part| part.to_owned()).collect(),
                    soft: true,
                    joints: Vec::new(),
                    range: None,
                    text: (*text).to_owned(),
                    suggestion: None,
                })
                .collect(),
            count_reason: None,
            note: String::new(),
        }
    }

    pub(crate) fn pair(verdict: Verdict) -> Answer {
        let keep = verdict == Verdict::Keep;
        Answer::Pair {
            verdict,
            parts: if keep {
                vec!["LEFT_ARM".to_owned()]
            } else {
                Vec::new()
            },
            edit_type: keep.then_some(EditType::Speed),
            text: if keep {
                "faster".to_owned()
            } else {
                String::new()
            },
            suggestion: None,
            note: String::new(),
        }
    }

    fn code(answer: &Answer) -> Option<Code> {
        match check_submission(answer, answer.kind(), &Settings::default(), FRAMES) {
            Ok(()) => None,
            Err(error) => Some(error.problem().code),
        }
    }

    #[test]
    fn two_to_four_masks_are_asked_for_and_a_reason_excuses() {
        let arm: (&[&str], &str) = (&["LEFT_ARM"], "waving");
        let leg: (&[&str], &str) = (&["LOWER_BODY"], "walking");
        assert_eq!(code(&masks(&[arm, leg])), None);
        assert_eq!(code(&masks(&[arm])), Some(Code::MaskCount));
        assert_eq!(code(&masks(&[])), Some(Code::MaskCount));
        let Answer::MaskText { masks: list, .. } = masks(&[arm]) else {
            unreachable!("masks makes masks")
        };
        let excused = Answer::MaskText {
            masks: list,
            count_reason: Some(CountReason::SingleAction),
            note: String::new(),
        };
        assert_eq!(code(&excused), None);
        assert_eq!(code(&masks(&[arm, arm])), Some(Code::Invalid));
        assert_eq!(code(&masks(&[arm, (&[], "walking")])), Some(Code::Invalid));
        assert_eq!(
            code(&masks(&[arm, (&["LOWER_BODY"], " ")])),
            Some(Code::Invalid)
        );
        assert_eq!(
            code(&masks(&[arm, (&["TAIL"], "wagging")])),
            Some(Code::Invalid)
        );
        assert_eq!(
            code(&masks(&[arm, (&["HEAD", "HEAD"], "x")])),
            Some(Code::Invalid)
        );
        let long = "x".repeat(MAX_TEXT_CHARS + 1);
        assert_eq!(
            code(&masks(&[arm, (&["HEAD"], &long)])),
            Some(Code::Invalid)
        );
        assert_eq!(
            code(&masks(&[arm, (&["HEAD"], "a\u{0}b")])),
            Some(Code::Invalid)
        );
    }

    /// An answer of two masks of the left arm with the same text, changed.
    fn two_arms(change: impl FnOnce(&mut [MaskAnswer])) -> Answer {
        let arm: (&[&str], &str) = (&["LEFT_ARM"], "waving");
        let mut answer = masks(&[arm, arm]);
        if let Answer::MaskText { masks, .. } = &mut answer {
            change(masks);
        }
        answer
    }

    #[test]
    fn masks_of_other_frames_or_joints_are_no_doubles() {
        let collar = JointChoice {
            joint: "left_collar".to_owned(),
            weight: JointWeight::Hard,
        };
        let later = two_arms(|masks| masks[1].range = Some([9, 40]));
        assert_eq!(code(&later), None);
        assert_eq!(
            code(&two_arms(|masks| masks[1].joints = vec![collar.clone()])),
            None
        );
        let (both, whole) = ([0, 31], [0, 40]);
        for doubled in [
            two_arms(|masks| masks.iter_mut().for_each(|mask| mask.range = Some(both))),
            two_arms(|masks| masks[1].range = Some(whole)),
            two_arms(|masks| {
                masks
                    .iter_mut()
                    .for_each(|mask| mask.joints = vec![collar.clone()])
            }),
        ] {
            assert_eq!(code(&doubled), Some(Code::Invalid));
        }
        // The later mask takes 31 of the 40 frames that the nearest one takes; the other three have an equal.
        let apart = distance(&later, &two_arms(|_| ()), FRAMES);
        assert!((apart - 9.0 / 160.0).abs() < 1e-12, "{apart}");
    }

    #[test]
    fn an_imported_answer_says_the_same_where_its_layout_has_no_place() {
        let ours = two_arms(|masks| {
            masks[0].range = Some([0, 20]);
            masks[1].soft = false;
        });
        assert!(says(&ours, &two_arms(|_| ())));
        assert!(!says(&two_arms(|_| ()), &ours));
        assert!(!says(
            &ours,
            &two_arms(|masks| masks[0].range = Some([0, 21]))
        ));
        // A ring that is off, and one whose joint is chosen away, are the same.
        let chosen = two_arms(|masks| {
            masks[1].joints = vec![JointChoice {
                joint: "left_collar".to_owned(),
                weight: JointWeight::None,
            }];
        });
        assert!(says(&ours, &chosen) && says(&chosen, &two_arms(|masks| masks[1].soft = false)));
    }

    #[test]
    fn a_pair_that_is_kept_needs_all_and_a_rejected_one_nothing() {
        assert_eq!(code(&pair(Verdict::Keep)), None);
        for verdict in [Verdict::Unnatural, Verdict::Unclear, Verdict::Identical] {
            assert_eq!(code(&pair(verdict)), None);
        }
        let Answer::Pair {
            verdict,
            parts,
            text,
            ..
        } = pair(Verdict::Keep)
        else {
            unreachable!("pair makes a pair")
        };
        let lacking = Answer::Pair {
            verdict,
            parts,
            edit_type: None,
            text,
            suggestion: None,
            note: String::new(),
        };
        assert_eq!(code(&lacking), Some(Code::Invalid));
        let style = |name: &str, extent| Answer::Style {
            verdict: Verdict::Keep,
            parts: Vec::new(),
            style: Some(name.to_owned()),
            extent,
            text: String::new(),
            suggestion: None,
            note: String::new(),
        };
        assert_eq!(code(&style("proud", Some(Extent::Whole))), None);
        assert_eq!(code(&style("proud", None)), Some(Code::Invalid));
        // A new name is a proposal; one that is nearly a known one, or none, is not.
        let new = style("limping", Some(Extent::Whole));
        assert_eq!(code(&new), None);
        assert_eq!(new.new_style(&Settings::default()), Some("limping"));
        let known = style("proud", Some(Extent::Whole));
        assert_eq!(known.new_style(&Settings::default()), None);
        for name in ["Proud", " proud", "", &"x".repeat(101)] {
            assert_eq!(
                code(&style(name, Some(Extent::Whole))),
                Some(Code::Invalid),
                "{name:?}"
            );
        }
        assert!(check_draft(&pair(Verdict::Keep), TaskKind::Style).is_err());
    }

    #[test]
    fn left_and_right_arm_equal_both_arms() {
        let (one, two) = (
            masks(&[(&["LEFT_ARM", "RIGHT_ARM"], "a")]),
            masks(&[(&["BOTH_ARMS"], "b")]),
        );
        assert!(distance(&one, &two, FRAMES).abs() < 1e-12);
    }

    #[test]
    fn distances_by_hand() {
        let arm = masks(&[(&["LEFT_ARM"], "a")]);
        let legs = masks(&[(&["BOTH_LEGS"], "a")]);
        assert!((distance(&arm, &legs, FRAMES) - 1.0).abs() < 1e-12);
        // One of two masks has a counterpart; the one mask of the other side has one.
        let both = masks(&[(&["LEFT_ARM"], "a"), (&["BOTH_LEGS"], "b")]);
        assert!((distance(&arm, &both, FRAMES) - 0.25).abs() < 1e-12);
        // Half of the joints of both arms.
        let arms = masks(&[(&["BOTH_ARMS"], "a")]);
        assert!((distance(&arm, &arms, FRAMES) - 0.5).abs() < 1e-12);
        assert!((distance(&masks(&[]), &arm, FRAMES) - 1.0).abs() < 1e-12);
        assert!(
            (distance(&pair(Verdict::Keep), &pair(Verdict::Unclear), FRAMES) - 1.0).abs() < 1e-12
        );
        assert!(distance(&pair(Verdict::Unclear), &pair(Verdict::Unclear), FRAMES).abs() < 1e-12);
        assert_eq!(spread(std::slice::from_ref(&arm), FRAMES), None);
        assert_eq!(spread(&[arm.clone(), arm, legs], FRAMES), Some(1.0));
    }

    #[test]
    fn text_distance_by_hand() {
        for (a, b, expected) in [
            ("", "", 0.0),
            ("abc", "abc", 0.0),
            ("kitten", "sitting", 3.0 / 7.0),
            ("", "abcd", 1.0),
            ("größer", "größte", 2.0 / 6.0),
        ] {
            assert!((text_distance(a, b) - expected).abs() < 1e-12, "{a} {b}");
        }
    }

    #[test]
    fn a_description_completes_a_sentence_and_becomes_one_in_the_dataset() {
        for (text, short, whole) in [
            (
                "waving with the left arm",
                "waving with the left arm",
                "The person is waving with the left arm.",
            ),
            (" The person is waving. ", "waving", "The person is waving."),
            (
                "slowly waving.",
                "slowly waving.",
                "The person is slowly waving.",
            ),
            (
                "raise the left arm",
                "raise the left arm",
                "raise the left arm",
            ),
            ("", "", ""),
        ] {
            assert_eq!(completion(text), short);
            assert_eq!(sentence(text), whole);
            assert_eq!(sentence(&sentence(text)), whole, "once is enough");
        }
    }
}
