//! Descriptions of a clip: sentences about the whole body and phrases about its parts.

use datasets_spec::table::{Caption, PartCaption};
use datasets_spec::{BodyPart, Rng};
use rand::RngExt;

use super::action::{Action, Facts};
use super::gait::Side;

/// Words of each action, in indented lines below its name. A line is a sentence about the whole body, or the name of a
/// part, a colon and what the part does. Such a phrase completes "The person is ... with their <part>." Below the name
/// of an adjustment or a style are instructions for it in words that training does not show.
const WORDS: &str = include_str!("words.txt");

/// Stands in [`WORDS`] for the arm on the side of a take.
const ACTING_ARM: &str = "ACTING_ARM";

/// Captions per clip: HumanML3D has three or four, KIT-ML one to three.
const CAPTIONS: std::ops::RangeInclusive<usize> = 2..=3;

/// Describes a clip: captions of the whole body, and phrases that complete "The person is ...".
pub(super) fn describe(
    action: Action,
    style: &str,
    facts: Facts,
    rng: &mut Rng,
) -> (Vec<Caption>, Vec<PartCaption>) {
    let captions = captions(action, manners(style), facts, rng);
    let acting = match facts.side {
        Side::Left => BodyPart::LeftArm,
        Side::Right => BodyPart::RightArm,
    };
    let parts = words(action.name())
        .filter_map(|line| line.split_once(": "))
        .map(|(part, phrase)| PartCaption {
            part: part.replace(ACTING_ARM, acting.name()),
            text: fill(phrase, "", manners(style)[0], facts),
        })
        .collect();
    (captions, parts)
}

/// Captions of the whole body for an action. `manners` holds at least one phrase for how it is done, each empty or with
/// a leading space.
pub(super) fn captions(
    action: Action,
    manners: &[&'static str],
    facts: Facts,
    rng: &mut Rng,
) -> Vec<Caption> {
    let is_sentence = |line: &&str| !line.contains(": ");
    let mut sentences: Vec<&str> = words(action.name()).filter(is_sentence).collect();
    let mut manners = manners.to_vec();
    let num_captions = rng.random_range(CAPTIONS);
    (0..num_captions)
        .map(|_| {
            let sentence = sentences.swap_remove(rng.random_range(0..sentences.len()));
            let who = SUBJECTS[rng.random_range(0..SUBJECTS.len())];
            // Manners do not repeat within a clip if there are enough.
            let how = if manners.len() > 1 {
                manners.swap_remove(rng.random_range(0..manners.len()))
            } else {
                manners[0]
            };
            Caption {
                text: fill(sentence, who, how, facts),
                ..Caption::default()
            }
        })
        .collect()
}

/// The lines of an action, adjustment or style in [`WORDS`].
pub(super) fn words(name: &str) -> impl Iterator<Item = &'static str> {
    let is_indented = |line: &&str| line.starts_with(' ');
    WORDS
        .lines()
        .skip_while(move |line| is_indented(line) || !line.split(' ').any(|other| other == name))
        .skip(1)
        .take_while(is_indented)
        .map(str::trim)
}

const SUBJECTS: [&str; 4] = ["a person", "someone", "the person", "a figure"];

/// Fills a template: `{who}`, `{how}` (empty or with a leading space), `{side}`, `{other}`, `{times}`, and `{turn}` for
/// a turn of `count - 1` half turns.
fn fill(template: &str, who: &str, how: &str, facts: Facts) -> String {
    let times = match facts.count {
        2 => "twice",
        3 => "three times",
        _ => "a few times",
    };
    let turn = match facts.count {
        2 => "half a turn",
        _ => "a full turn",
    };
    template
        .replace("{who}", who)
        .replace("{how}", how)
        .replace("{side}", facts.side.word())
        .replace("{other}", facts.side.other().word())
        .replace("{times}", times)
        .replace("{turn}", turn)
}

/// Phrases for how the whole body moves in a style.
fn manners(style: &str) -> &'static [&'static str] {
    match style {
        "proud" => &[
            " proudly",
            " with the chest out",
            " with the head held high",
            " full of pride",
        ],
        "old" => &[
            " like an old person",
            " slowly and stiffly like an elderly person",
            " with a bent back, as if very old",
        ],
        "playful" => &[
            " playfully",
            " cheerfully",
            " in high spirits",
            " with a bouncy, playful manner",
        ],
        "depressed" => &[
            " sadly",
            " with a hanging head",
            " in a depressed mood",
            " without any energy, as if depressed",
        ],
        "angry" => &[
            " angrily",
            " in a rage",
            " with angry, forceful movements",
            " as if furious",
        ],
        _ => &[""],
    }
}

#[cfg(test)]
mod tests {
    use datasets_spec::Seed;

    use super::*;
    use crate::style;

    #[test]
    fn every_clip_is_described_in_whole_and_in_parts() {
        let named = [
            "UPPER_BODY",
            "LOWER_BODY",
            "LEFT_ARM",
            "RIGHT_ARM",
            "BOTH_ARMS",
        ];
        for action in Action::ALL {
            for style in &style::ALL {
                for (side, count) in [(Side::Left, 2), (Side::Right, 3)] {
                    let facts = Facts { side, count };
                    let mut rng = Seed(1).rng(&[action.name(), style.name]);
                    let (captions, parts) = describe(action, style.name, facts, &mut rng);
                    assert!(CAPTIONS.contains(&captions.len()));
                    assert!(!parts.is_empty());
                    for caption in &captions {
                        let text = &caption.text;
                        assert!(!text.contains(['{', '}']) && !text.contains("  "), "{text}");
                        assert!(captions.iter().filter(|other| other.text == *text).count() == 1);
                    }
                    for part in &parts {
                        assert!(named.contains(&part.part.as_str()));
                        let word = part.text.split(' ').next().expect("a word");
                        assert!(word.ends_with("ing"), "{word}");
                        assert!(!part.text.contains(['{', '}']));
                    }
                }
            }
        }
    }

    #[test]
    fn the_side_that_acts_is_the_side_that_is_named() {
        let facts = Facts {
            side: Side::Left,
            count: 2,
        };
        let mut rng = Seed(2).rng(&["text"]);
        let (captions, parts) = describe(Action::WaveLeft, "neutral", facts, &mut rng);
        assert!(captions.iter().all(|caption| caption.text.contains("left")));
        let is_wave = |part: &PartCaption| part.part == "LEFT_ARM" && part.text == "waving";
        assert!(parts.iter().any(is_wave));
    }
}
