//! Turns captions into descriptions of the person's action, for instructions in the phrasing of the release.
//!
//! Captions are written by people in many ways. Those of the form "A person walks forward" or "someone is waving"
//! become "The person is walking forward". The grammar is a short list of forms; a caption of any other form keeps its
//! own wording, because a guess would lose its subject or spoil its verb.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::LazyLock;

use datasets_spec::BodyPart;
use datasets_spec::table::Caption;

use super::instruction::instruction;

/// Words of captions for the person who moves.
const SUBJECTS: &str = "person man woman boy girl guy lady human figure character someone somebody individual \
     subject he she they";
/// Words that may precede the subject.
const DETERMINERS: &str = "a an the this one";
/// Words that may introduce another clause, whose verb would also have to be converted.
const CONJUNCTIONS: &str =
    "and then while but before after until till as when which who that so because or where if";
/// Verbs of another clause that are not in `verbs.txt`.
const OTHER_FINITE: &str = "is are was were has had seems appears";

/// Words in -s that are not verbs after a conjunction.
const NO_VERBS_IN_S: &str = "his its hers theirs this always arms hands legs feet across towards";

/// Words after which an ambiguous word such as "steps" is a plural and not a verb.
const BEFORE_PLURALS: &str = "two three four five six seven eight nine ten few some several many more multiple both half \
     couple small big large little huge tiny wide in of with doing making performing taking \
     practicing";
/// Words that are adverbs or adjectives: "four slow steps", but "walks slow, steps back". The preceding word decides.
const ADJECTIVES_OR_ADVERBS: &str =
    "forward backward sideways straight fast slow quick long short high low heavy deep";

fn is_one_of(word: &str, words: &str) -> bool {
    words.split(' ').any(|one| one == word)
}

/// Gerunds of the verbs in `verbs.txt`, by third person, by gerund and by bare form.
#[derive(Default)]
struct Verbs {
    finite: BTreeMap<String, String>,
    gerunds: BTreeMap<String, String>,
    bare: BTreeMap<String, String>,
    /// Third persons that are not also plural nouns.
    only_finite: BTreeSet<String>,
}

static VERBS: LazyLock<Verbs> = LazyLock::new(|| {
    let mut verbs = Verbs::default();
    let lines = include_str!("verbs.txt").lines();
    let words = lines
        .filter(|line| !line.starts_with('#'))
        .flat_map(str::split_whitespace);
    for word in words {
        let mut forms = word.split(':');
        let marked = forms.next().unwrap_or(word);
        let bare = marked.trim_end_matches('*').to_owned();
        let finite = forms
            .next()
            .map_or_else(|| third_person(&bare), str::to_owned);
        let gerund = forms.next().map_or_else(|| gerund(&bare), str::to_owned);
        if bare == marked {
            verbs.only_finite.insert(finite.clone());
        }
        verbs.finite.insert(finite, gerund.clone());
        verbs.gerunds.insert(gerund.clone(), gerund.clone());
        verbs.bare.insert(bare, gerund);
    }
    // "A person being pushed".
    verbs.gerunds.insert("being".to_owned(), "being".to_owned());
    verbs
});

/// Description of a clip for an instruction.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Described {
    /// The continuation of "The person is ...", such as "walking forward".
    Doing(String),
    /// A caption or label, unchanged.
    AsSaid(String),
}

impl Described {
    /// The words, without subject or part.
    pub fn text(&self) -> &str {
        let (Self::Doing(text) | Self::AsSaid(text)) = self;
        text
    }

    /// The instruction for one body part.
    pub fn instruction(&self, part: BodyPart) -> String {
        match self {
            Self::Doing(action) => instruction(action, part),
            Self::AsSaid(text) => {
                let mut letters = text.chars();
                let first = letters.next().into_iter().flat_map(char::to_uppercase);
                let text: String = first.chain(letters).collect();
                format!("{text} with their {}.", part.phrase())
            }
        }
    }
}

/// Description of a clip by its first caption of the whole clip, else by its first caption, else by its action label,
/// and the caption; `None` without any of these.
pub fn described<'a>(
    captions: &[&'a Caption],
    action: Option<&str>,
) -> Option<(Described, Option<&'a Caption>)> {
    let of_whole = |caption: &&&Caption| caption.from_s == 0.0 && caption.to_s == 0.0;
    let caption = captions.iter().find(of_whole).or(captions.first());
    let of_caption = caption.and_then(|caption| Some((of_text(&caption.text)?, Some(*caption))));
    of_caption.or_else(|| {
        Some((
            of_text(&action?.replace(['_', '-'], " ").to_lowercase())?,
            None,
        ))
    })
}

fn of_text(text: &str) -> Option<Described> {
    let text = text.trim().trim_end_matches(['.', '!', ',', ';', ' ']);
    if !text.contains(char::is_alphanumeric) {
        return None;
    }
    let doing = doing(text).map(Described::Doing);
    Some(doing.unwrap_or_else(|| Described::AsSaid(text.to_owned())))
}

/// The words after the subject, with the verb as a gerund; `None` if the text has no known form.
fn doing(text: &str) -> Option<String> {
    if text.contains(['.', ';', ':', '?', '!', '(', '"']) {
        return None;
    }
    let said: Vec<&str> = text.split_whitespace().collect();
    let words: Vec<String> = said.iter().map(|word| word.to_lowercase()).collect();
    let is = |place: usize, list| words.get(place).is_some_and(|word| is_one_of(word, list));
    let determined = usize::from(is(0, DETERMINERS));
    let has_subject = is(determined, SUBJECTS);
    if determined == 1 && !has_subject {
        return None;
    }
    let start = determined + usize::from(has_subject);
    if has_subject && is(start, "is") {
        let rest = &words[start + 1..];
        let fits = !VERBS.bare.contains_key(rest.first()?) && !has_other_clause(rest);
        return fits.then(|| said[start + 1..].join(" "));
    }
    let adverbs = words[start..]
        .iter()
        .take_while(|word| is_adverb(word))
        .count();
    let place = start + adverbs;
    let verb = words.get(place)?;
    let verb = match has_subject {
        true => VERBS.finite.get(verb).or_else(|| VERBS.gerunds.get(verb)),
        false => VERBS.gerunds.get(verb).or_else(|| VERBS.bare.get(verb)),
    }?;
    // "Looks like ..." is not an action, and "kneeling person" is a subject.
    let is_likeness = verb == "looking" && is(place + 1, "like as");
    if is_likeness || is(place + 1, SUBJECTS) || has_other_clause(&words[place + 1..]) {
        return None;
    }
    let (before, rest) = (&said[start..place], &said[place + 1..]);
    Some([before, &[verb.as_str()], rest].concat().join(" "))
}

/// Whether a word is an adverb of manner, such as "slowly".
fn is_adverb(word: &str) -> bool {
    word.len() > 3 && word.ends_with("ly") && !VERBS.bare.contains_key(word)
}

/// Whether a second verb follows whose form does not fit after "is".
fn has_other_clause(rest: &[String]) -> bool {
    let mut opens = false;
    for (place, said) in rest.iter().enumerate() {
        let ends = said.ends_with(',');
        let word = said.trim_end_matches(',').to_owned();
        let is_finite = is_one_of(&word, OTHER_FINITE)
            || VERBS.only_finite.contains(&word)
            || (place > 0 && VERBS.finite.contains_key(&word) && !is_plural(&rest[..place]))
            || (place > 0 && is_verb_with_particle(&rest[place - 1..]));
        let ends_in_s = word.ends_with('s') && !word.ends_with("ss") && !word.ends_with("wards");
        let may_be_verb =
            VERBS.bare.contains_key(&word) || (ends_in_s && !is_one_of(&word, NO_VERBS_IN_S));
        if is_finite || (opens && may_be_verb) {
            return true;
        }
        let goes_on = opens
            && (is_adverb(&word) || is_one_of(&word, "thereby also") || is_one_of(&word, SUBJECTS));
        opens = ends || goes_on || is_one_of(&word, CONJUNCTIONS);
    }
    false
}

/// Whether the second word is a bare verb with a particle, as in "front turn around", and not a noun or an infinitive,
/// as in "a turn around" and "to turn around".
fn is_verb_with_particle(words: &[String]) -> bool {
    let [before, verb, particle, ..] = words else {
        return false;
    };
    is_one_of(particle, "around up down back away")
        && VERBS.bare.contains_key(verb)
        && !is_one_of(verb, "back circle")
        && !is_one_of(before, DETERMINERS)
        && !is_one_of(before, "to his her its their")
}

/// Whether a plural is expected after the words `before`.
fn is_plural(before: &[String]) -> bool {
    let mut before = before.iter().rev().map(String::as_str);
    let Some(word) = before.find(|word| !is_one_of(word, ADJECTIVES_OR_ADVERBS)) else {
        return false;
    };
    is_one_of(word, BEFORE_PLURALS) || word.bytes().all(|byte| byte.is_ascii_digit())
}

/// The third person of a regular verb.
fn third_person(bare: &str) -> String {
    let ends = |ends: &[&str]| ends.iter().any(|end| bare.ends_with(end));
    let before_y = bare.strip_suffix('y');
    match before_y.filter(|stem| !stem.ends_with(['a', 'e', 'i', 'o', 'u'])) {
        Some(stem) => format!("{stem}ies"),
        None if ends(&["s", "x", "z", "ch", "sh"]) => format!("{bare}es"),
        None => format!("{bare}s"),
    }
}

/// The gerund of a regular verb.
fn gerund(bare: &str) -> String {
    // The u of "squat" belongs to its q.
    let letters: Vec<char> = bare.replace("qu", "qq").chars().collect();
    let vowel = |c: char| "aeiou".contains(c);
    let keeps_e = ["ee", "oe", "ye"].iter().any(|end| bare.ends_with(end));
    if let Some(stem) = bare.strip_suffix('e').filter(|_| !keeps_e) {
        return format!("{stem}ing");
    }
    // One syllable of consonant, vowel, consonant doubles its last letter: "run", "clap".
    // "Sidestep" is stressed like "step".
    if let [.., before, middle, last] = letters[..]
        && !vowel(before)
        && vowel(middle)
        && !vowel(last)
        && !"wxy".contains(last)
        && (letters.iter().filter(|&&c| vowel(c)).count() == 1 || bare == "sidestep")
    {
        return format!("{bare}{last}ing");
    }
    format!("{bare}ing")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn caption(text: &str) -> Caption {
        Caption {
            text: text.to_owned(),
            ..Caption::default()
        }
    }

    #[test]
    fn forms_follow_the_spelling_rules() {
        for (bare, finite, gerund) in [
            ("walk", "walks", "walking"),
            ("wave", "waves", "waving"),
            ("run", "runs", "running"),
            ("squat", "squats", "squatting"),
            ("sidestep", "sidesteps", "sidestepping"),
            ("bend", "bends", "bending"),
            ("reach", "reaches", "reaching"),
            ("carry", "carries", "carrying"),
            ("play", "plays", "playing"),
            ("lie", "lies", "lying"),
            ("go", "goes", "going"),
            ("kneel", "kneels", "kneeling"),
            ("bow", "bows", "bowing"),
            ("box", "boxes", "boxing"),
            ("tiptoe", "tiptoes", "tiptoeing"),
            ("mimic", "mimics", "mimicking"),
            ("fly", "flies", "flying"),
        ] {
            for (forms, form) in [(&VERBS.finite, finite), (&VERBS.bare, bare)] {
                assert_eq!(forms.get(form).map(String::as_str), Some(gerund));
            }
        }
    }

    #[test]
    fn captions_of_a_known_form_say_what_the_person_is_doing() {
        for (text, expected) in [
            ("A person walks forward.", "walking forward"),
            ("a man reaches up, slowly", "reaching up, slowly"),
            ("the person is waving both hands", "waving both hands"),
            ("someone is pushed from behind", "pushed from behind"),
            ("he carries a box", "carrying a box"),
            ("jumping in place", "jumping in place"),
            (
                "a person quickly runs backwards",
                "quickly running backwards",
            ),
            (
                "A human slowly walking in a circle",
                "slowly walking in a circle",
            ),
            (
                "A person walks while swinging their arms",
                "walking while swinging their arms",
            ),
            ("jump", "jumping"),
            ("A person takes 3 fast steps", "taking 3 fast steps"),
            (
                "a person performs a turn around",
                "performing a turn around",
            ),
            (
                "a person does four slow forward steps in circles",
                "doing four slow forward steps in circles",
            ),
        ] {
            let expected = Described::Doing(expected.to_owned());
            assert_eq!(of_text(text), Some(expected), "{text}");
        }
    }

    #[test]
    fn other_captions_keep_their_words() {
        for text in [
            "with raised fists",
            "from standing",
            "byebye",
            "A person walks forward and turns around",
            "A person is walking, then stops",
            "Someone who is drunk walks home",
            "A standing person waves",
            "kneeling person stands up",
            "A person walks forward takes a turn",
            "A person holds something in its left hand touches it",
            "A person dances and in the end looks at his feet",
            "A person walks forward anf turns slightly to the right",
            "A person walks forward slow turns right",
            "A person goes to the left and thereby paints a circle",
            "walking to the front turn around and walking back",
            "A person puts his hands down and inspects the ground",
            "A person seems to be tired",
            "A person looks like a robot",
            "a person walsk",
            "human is push from behind",
            "A person walks. He turns",
            "A dance",
        ] {
            let expected = Described::AsSaid(text.to_owned());
            assert_eq!(of_text(text), Some(expected), "{text}");
        }
        let said = Described::AsSaid("someone who is drunk walks home".to_owned());
        let text = "Someone who is drunk walks home with their left arm.";
        assert_eq!(said.instruction(BodyPart::LeftArm), text);
    }

    #[test]
    fn the_caption_of_the_whole_clip_comes_first_and_the_label_last() {
        let doing = |text: &str, caption| Some((Described::Doing(text.to_owned()), caption));
        let part = Caption {
            to_s: 2.0,
            ..caption("a person sits")
        };
        let (part, whole) = (&part, &caption("a person stands"));
        let blank = &caption(" ");
        assert_eq!(
            described(&[part, whole], None),
            doing("standing", Some(whole))
        );
        assert_eq!(
            described(&[part], Some("kick")),
            doing("sitting", Some(part))
        );
        assert_eq!(described(&[], Some("kick")), doing("kicking", None));
        let label = Some("raise-up_hand");
        assert_eq!(described(&[], label), doing("raising up hand", None));
        assert_eq!(described(&[blank], None), None);
        assert_eq!(described(&[], None), None);
    }
}
