//! Instructions in the phrasing of the release, made from the captions and labels of a clip.

use std::collections::BTreeMap;

use datasets_spec::BodyPart;
use datasets_spec::table::Caption;
use serde::{Deserialize, Serialize};

use super::Error;

/// Words of captions for the person who moves.
const SUBJECTS: [&str; 14] = [
    "person",
    "man",
    "woman",
    "human",
    "figure",
    "character",
    "someone",
    "somebody",
    "individual",
    "he",
    "she",
    "they",
    "it",
    "body",
];
/// Words that may stand before the subject.
const DETERMINERS: [&str; 6] = ["a", "an", "the", "this", "one", "his"];
/// Auxiliaries that may stand between the subject and the verb.
const AUXILIARIES: [&str; 7] = ["is", "are", "was", "has", "been", "being", "were"];

/// An edit instruction in the phrasing of the release: "The person is waving with their left arm."
pub fn instruction(action: &str, part: BodyPart) -> String {
    format!("The person is {action} with their {}.", part.phrase())
}

/// The edit instruction of a style pair in the phrasing of the release, before the part is named:
/// "Replace a person with an angry look".
pub fn style_instruction(style: &str) -> String {
    let style = style.replace(['_', '-'], " ").to_lowercase();
    let article = if style.starts_with(['a', 'e', 'i', 'o', 'u']) {
        "an"
    } else {
        "a"
    };
    format!("Replace a person with {article} {style} look")
}

/// An instruction for the mirror image of an edit: left and right are exchanged, clockwise and counterclockwise too,
/// as in the mirrored captions of HumanML3D.
pub(super) fn mirrored(instruction: &str) -> String {
    const OPPOSITES: [[&str; 2]; 3] = [
        ["left", "right"],
        ["clockwise", "counterclockwise"],
        ["leftwards", "rightwards"],
    ];
    let opposite = |word: &str| {
        let lower = word.to_lowercase();
        let found = OPPOSITES.iter().find_map(|[a, b]| match lower.as_str() {
            lower if lower == *a => Some(*b),
            lower if lower == *b => Some(*a),
            _ => None,
        })?;
        let is_capital = word.starts_with(char::is_uppercase);
        Some(match (is_capital, found.split_at(1)) {
            (true, (first, rest)) => first.to_uppercase() + rest,
            (false, _) => found.to_owned(),
        })
    };
    instruction
        .split_inclusive(|c: char| !c.is_alphabetic())
        .map(|piece| {
            let word = piece.trim_end_matches(|c: char| !c.is_alphabetic());
            match opposite(word) {
                Some(other) => other + &piece[word.len()..],
                None => piece.to_owned(),
            }
        })
        .collect()
}

/// How instructions are worded. The default is the phrasing of the release without variation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Phrases {
    /// Templates that add the edited part to the instruction of a pair; one is drawn for each item.
    /// `{instruction}` stands for the instruction without its full stop, `{part}` for the part.
    pub of_parts: Vec<String>,
    /// Paraphrases by the instruction of the dataset. One of them or the instruction itself is drawn for each
    /// item.
    pub paraphrases: BTreeMap<String, Vec<String>>,
}

impl Default for Phrases {
    fn default() -> Self {
        Self {
            of_parts: vec!["{instruction} using their {part}.".to_owned()],
            paraphrases: BTreeMap::new(),
        }
    }
}

impl Phrases {
    /// Checks the templates.
    ///
    /// # Errors
    /// There is none, or one leaves out the instruction or the part.
    pub(super) fn check(&self) -> Result<(), Error> {
        let whole =
            |template: &String| template.contains("{instruction}") && template.contains("{part}");
        if self.of_parts.is_empty() || !self.of_parts.iter().all(whole) {
            return Err(Error::Template);
        }
        Ok(())
    }

    /// All wordings of an instruction, starting with the dataset's; with the part, if one is given.
    pub(super) fn wordings(&self, instruction: &str, part: Option<BodyPart>) -> Vec<String> {
        let others = self.paraphrases.get(instruction).into_iter().flatten();
        let texts = std::iter::once(instruction).chain(others.map(String::as_str));
        let Some(part) = part else {
            return texts.map(str::to_owned).collect();
        };
        let part = part.phrase();
        texts
            .flat_map(|text| {
                let bare = text.trim().trim_end_matches('.');
                self.of_parts.iter().map({
                    let part = &part;
                    move |template| {
                        template
                            .replace("{instruction}", bare)
                            .replace("{part}", part)
                    }
                })
            })
            .collect()
    }
}

/// The action of a clip as the continuation of "The person is ...", such as "walking forward". It comes from
/// the first caption of the whole clip, else from the first caption, else from the action label; none if
/// the clip has neither.
///
/// The grammar is a heuristic for English captions in the style of HumanML3D. It uses the caption's
/// tokens where there are some.
pub fn action_phrase(captions: &[Caption], action: Option<&str>) -> Option<String> {
    let caption = captions
        .iter()
        .find(|caption| caption.from_s == 0.0 && caption.to_s == 0.0)
        .or(captions.first());
    caption
        .and_then(|caption| from_tokens(caption).or_else(|| from_text(&caption.text)))
        .or_else(|| action.and_then(from_text))
}

/// The first verb's lemma, then the words after it, from tokens such as `walk/VERB`.
fn from_tokens(caption: &Caption) -> Option<String> {
    let tokens: Vec<(&str, &str)> = caption
        .tokens
        .split_whitespace()
        .filter_map(|token| token.rsplit_once('/'))
        .collect();
    let words = words(&caption.text);
    let verb = tokens.iter().position(|(_, tag)| *tag == "VERB")?;
    // Tokens leave out punctuation, so they usually have the same number of words as the text; if
    // not, only the text is used.
    if tokens.len() != words.len() {
        return None;
    }
    Some(joined(gerund(tokens[verb].0), &words[verb + 1..]))
}

/// The words after the subject, the first of them as a gerund.
fn from_text(text: &str) -> Option<String> {
    let words = words(text);
    let mut rest = words.as_slice();
    let determined = match rest {
        [first, tail @ ..] if DETERMINERS.contains(&first.as_str()) => tail,
        whole => whole,
    };
    let subject = matches!(determined, [first, _, ..] if SUBJECTS.contains(&first.as_str()));
    if subject {
        rest = &determined[1..];
        while let [first, tail @ ..] = rest
            && AUXILIARIES.contains(&first.as_str())
        {
            rest = tail;
        }
    }
    let (verb, rest) = rest.split_first()?;
    // After a subject the verb is in the third person; a label is the bare verb.
    let verb = if subject { bare(verb) } else { verb.clone() };
    Some(joined(gerund(&verb), rest))
}

/// Lower-case words without punctuation at their ends; labels such as `raise-up_hands` are split.
fn words(text: &str) -> Vec<String> {
    text.split(|c: char| c.is_whitespace() || c == '_' || c == '-')
        .map(|word| {
            word.trim_matches(|c: char| !c.is_alphanumeric())
                .to_lowercase()
        })
        .filter(|word| !word.is_empty())
        .collect()
}

fn joined(verb: String, rest: &[String]) -> String {
    std::iter::once(verb)
        .chain(rest.iter().cloned())
        .collect::<Vec<_>>()
        .join(" ")
}

/// The bare form of a verb in the third person: "walks" and "reaches" lose their ending.
fn bare(verb: &str) -> String {
    if let Some(stem) = verb.strip_suffix("ies") {
        return format!("{stem}y");
    }
    for ending in ["ches", "shes", "sses", "xes", "zzes"] {
        if verb.ends_with(ending) {
            return verb[..verb.len() - 2].to_owned();
        }
    }
    if verb == "does" || verb == "goes" {
        return verb[..verb.len() - 2].to_owned();
    }
    match verb.strip_suffix('s') {
        Some(stem) if !stem.is_empty() && !stem.ends_with('s') => stem.to_owned(),
        _ => verb.to_owned(),
    }
}

/// The gerund of a bare verb; a gerund stays as it is.
fn gerund(verb: &str) -> String {
    let vowel = |c: char| "aeiou".contains(c);
    let letters: Vec<char> = verb.chars().collect();
    if verb.ends_with("ing")
        && letters[..letters.len() - 3]
            .iter()
            .any(|&c| vowel(c) || c == 'y')
    {
        return verb.to_owned();
    }
    if let Some(stem) = verb.strip_suffix("ie") {
        return format!("{stem}ying");
    }
    if let Some(stem) = verb.strip_suffix('e')
        && !verb.ends_with("ee")
        && !verb.ends_with("oe")
        && !verb.ends_with("ye")
        && stem.chars().any(vowel)
    {
        return format!("{stem}ing");
    }
    // One syllable of consonant, vowel, consonant doubles its last letter: "run", "clap".
    if let [.., before, middle, last] = letters[..]
        && !vowel(before)
        && vowel(middle)
        && !vowel(last)
        && !"wxy".contains(last)
        && letters.iter().filter(|&&c| vowel(c)).count() == 1
    {
        return format!("{verb}{last}ing");
    }
    format!("{verb}ing")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn caption(text: &str, tokens: &str) -> Caption {
        Caption {
            text: text.to_owned(),
            tokens: tokens.to_owned(),
            from_s: 0.0,
            to_s: 0.0,
        }
    }

    #[test]
    fn the_phrasing_is_that_of_the_release() {
        assert_eq!(
            instruction("waving", BodyPart::LeftArm),
            "The person is waving with their left arm."
        );
        assert_eq!(
            instruction("clapping", BodyPart::BothArms),
            "The person is clapping with their both arms."
        );
    }

    #[test]
    fn the_mirror_image_of_an_instruction_exchanges_left_and_right() {
        for (text, image) in [
            (
                "The person is raising up left hand with their left arm.",
                "The person is raising up right hand with their right arm.",
            ),
            ("Right, then LEFT!", "Left, then Right!"),
            (
                "Turn clockwise, bright-eyed.",
                "Turn counterclockwise, bright-eyed.",
            ),
            (
                "Replace a person with an old look",
                "Replace a person with an old look",
            ),
        ] {
            assert_eq!(mirrored(text), image);
        }
        let text = "Walk to the left, then right, counterclockwise.";
        assert_eq!(mirrored(&mirrored(text)), text);
    }

    #[test]
    fn gerunds_follow_the_spelling_rules() {
        for (verb, expected) in [
            ("walk", "walking"),
            ("wave", "waving"),
            ("run", "running"),
            ("clap", "clapping"),
            ("sit", "sitting"),
            ("throw", "throwing"),
            ("lie", "lying"),
            ("jump", "jumping"),
            ("open", "opening"),
            ("kneel", "kneeling"),
            ("see", "seeing"),
            ("swing", "swinging"),
            ("swinging", "swinging"),
            ("bow", "bowing"),
        ] {
            assert_eq!(gerund(verb), expected);
        }
    }

    #[test]
    fn captions_and_labels_become_what_the_person_is_doing() {
        for (text, tokens, expected) in [
            ("A person walks forward.", "", "walking forward"),
            ("a man reaches up, slowly", "", "reaching up slowly"),
            ("the person is waving both hands", "", "waving both hands"),
            ("he carries a box", "", "carrying a box"),
            ("raise-up-hand", "", "raising up hand"),
            ("jumping in place", "", "jumping in place"),
            (
                "a person quickly runs backwards",
                "a/DET person/NOUN quickly/ADV run/VERB backwards/ADV",
                "running backwards",
            ),
        ] {
            let phrase = action_phrase(&[caption(text, tokens)], None);
            assert_eq!(phrase.as_deref(), Some(expected), "{text}");
        }
    }

    #[test]
    fn the_caption_of_the_whole_clip_comes_first_and_the_label_last() {
        let part = Caption {
            to_s: 2.0,
            ..caption("a person sits", "")
        };
        let whole = caption("a person stands", "");
        let captions = [part.clone(), whole];
        assert_eq!(action_phrase(&captions, None).as_deref(), Some("standing"));
        assert_eq!(
            action_phrase(&[part], Some("kick")).as_deref(),
            Some("sitting")
        );
        assert_eq!(action_phrase(&[], Some("kick")).as_deref(), Some("kicking"));
        assert_eq!(action_phrase(&[caption(" ", "")], None), None);
        assert_eq!(action_phrase(&[], None), None);
    }
}
