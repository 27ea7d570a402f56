//! Words for sides and turns in texts: left and right, clockwise and counterclockwise.

/// The sides and turns that a text names.
///
/// It works on captions and on their `lemma/POS` tokens. Every "left" counts, even where it is a form of "leave", as in
/// the published mirrored captions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sides {
    /// Left.
    pub left: bool,
    /// Right.
    pub right: bool,
    /// Clockwise.
    pub clockwise: bool,
    /// Counterclockwise.
    pub counterclockwise: bool,
}

impl Sides {
    /// What any of the texts names.
    pub fn of<'a>(texts: impl IntoIterator<Item = &'a str>) -> Self {
        let mut sides = Self::default();
        for (_, word) in texts.into_iter().flat_map(pieces) {
            match word {
                Some((Side::Left, _)) => sides.left = true,
                Some((Side::Right, _)) => sides.right = true,
                Some((Side::Clockwise, _)) => sides.clockwise = true,
                Some((Side::Counterclockwise, _)) => sides.counterclockwise = true,
                None => {}
            }
        }
        sides
    }
}

/// The text for the mirror image of what it describes: sides and turns are exchanged, as in the mirrored captions of
/// HumanML3D.
pub fn mirrored(text: &str) -> String {
    let image = |(piece, word): (&str, Option<(Side, &str)>)| match word {
        Some((side, end)) => in_case_of(piece, &format!("{}{end}", side.opposite().word())),
        None => piece.to_owned(),
    };
    pieces(text).map(image).collect()
}

#[derive(Clone, Copy)]
enum Side {
    Left,
    Right,
    Clockwise,
    Counterclockwise,
}

impl Side {
    fn word(self) -> &'static str {
        match self {
            Self::Left => "left",
            Self::Right => "right",
            Self::Clockwise => "clockwise",
            Self::Counterclockwise => "counterclockwise",
        }
    }

    fn opposite(self) -> Self {
        match self {
            Self::Left => Self::Right,
            Self::Right => Self::Left,
            Self::Clockwise => Self::Counterclockwise,
            Self::Counterclockwise => Self::Clockwise,
        }
    }
}

/// The words of a text and the characters between them. A word for a side has that side and its ending.
fn pieces(text: &str) -> impl Iterator<Item = (&str, Option<(Side, &'static str)>)> {
    let mut rest = text;
    std::iter::from_fn(move || {
        let first = rest.chars().next()?;
        let is_other = |c: char| !c.is_alphabetic();
        let letters = rest.find(is_other).unwrap_or(rest.len());
        let (len, word) = match two_words_len(rest, letters) {
            _ if letters == 0 => (first.len_utf8(), None),
            Some(len) => (len, Some((Side::Counterclockwise, ""))),
            None => (letters, side_of(&rest[..letters])),
        };
        let (piece, after) = rest.split_at(len);
        rest = after;
        Some((piece, word))
    })
}

/// Bytes of "counter clockwise" or "anti-clockwise", written as two words, at the start of a text whose first word has
/// `letters` bytes.
fn two_words_len(text: &str, letters: usize) -> Option<usize> {
    const TURN: &str = "clockwise";
    let (word, after) = text.split_at(letters);
    if !["counter", "anti"].contains(&word.to_lowercase().as_str()) {
        return None;
    }
    let turn = after.strip_prefix(['-', ' '])?.get(..TURN.len())?;
    let is_turn = turn.eq_ignore_ascii_case(TURN);
    is_turn.then_some(letters + 1 + TURN.len())
}

fn side_of(word: &str) -> Option<(Side, &'static str)> {
    const ENDS: [&str; 7] = ["", "s", "y", "ward", "wards", "hand", "handed"];
    let word = word.to_lowercase();
    for side in [Side::Left, Side::Right] {
        if let Some(end) = word.strip_prefix(side.word()) {
            let end = ENDS.into_iter().find(|known| *known == end)?;
            return Some((side, end));
        }
    }
    match word.as_str() {
        "clockwise" => Some((Side::Clockwise, "")),
        "counterclockwise" | "anticlockwise" => Some((Side::Counterclockwise, "")),
        _ => None,
    }
}

/// Capitalises `word` if `model` is capitalised.
fn in_case_of(model: &str, word: &str) -> String {
    let mut chars = word.chars();
    match (model.chars().next(), chars.next()) {
        (Some(capital), Some(first)) if capital.is_uppercase() => {
            first.to_uppercase().chain(chars).collect()
        }
        _ => word.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn sides_and_turns_change_places() {
        for (text, image) in [
            ("Left arm, then right-hand.", "Right arm, then left-hand."),
            ("Right, then LEFT!", "Left, then Right!"),
            ("is lefthanded", "is righthanded"),
            ("leftward and rightwards", "rightward and leftwards"),
            ("left/ADJ right/ADV walk", "right/ADJ left/ADV walk"),
            ("l\u{e9}ft \u{2192} left", "l\u{e9}ft \u{2192} right"),
            ("turns clockwise", "turns counterclockwise"),
            ("turns counter-clockwise", "turns clockwise"),
            ("Counter clockwise; anticlockwise", "Clockwise; clockwise"),
            ("Anti-clockwise", "Clockwise"),
            ("counter the clock", "counter the clock"),
            ("an upright, bright man", "an upright, bright man"),
        ] {
            assert_eq!(mirrored(text), image, "{text}");
        }
    }

    #[test]
    fn a_text_names_sides_and_turns() {
        let (yes, no) = (true, false);
        for (texts, expected) in [
            (&["waves with the Left hand"][..], [yes, no, no, no]),
            (&["LEFT_ARM"], [yes, no, no, no]),
            (&["steps right", "then left"], [yes, yes, no, no]),
            (&["turns clockwise"], [no, no, yes, no]),
            (&["turns anti-clockwise"], [no, no, no, yes]),
            (&["stands upright"], [no; 4]),
        ] {
            let found = Sides::of(texts.iter().copied());
            let turns = [found.clockwise, found.counterclockwise];
            assert_eq!(
                [[found.left, found.right], turns].concat(),
                expected,
                "{texts:?}"
            );
        }
    }

    proptest! {
        #[test]
        fn the_image_of_an_image_is_the_text(
            text in "[a-z ,.]{0,20}(left|right| clockwise|x)[ .]{0,3}",
        ) {
            prop_assume!(!text.contains("counter") && !text.contains("anti"));
            prop_assert_eq!(mirrored(&mirrored(&text)), text);
        }

        #[test]
        fn any_text_has_an_image(text in any::<String>()) {
            let _ = mirrored(&text);
        }
    }
}
