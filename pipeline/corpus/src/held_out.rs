//! Splits that test how a model generalises beyond its training clips.
//!
//! | held out of training | asks for |
//! |---|---|
//! | all clips of [`TEST_ACTIONS`] | an edit of an action that training has not shown |
//! | one style of every action; the third performer | actions, styles and movements that training has shown, but not together, or not at this size and tempo |
//! | one of the four takes of every action by the first two performers | another take of what training has shown |
//!
//! Style pairs need a neutral and a styled clip of one take in one split; the third performer's take has both.

use datasets_spec::Split;

use super::action::Action;
use super::style;

/// Takes that the splits are made for: two each of two performers, and one of a third.
pub(super) const TAKES: usize = 5;
/// Takes of the performers whom training shows.
const SHOWN_TAKES: usize = 4;
/// Actions that are only in the test split: those that bend the body to the floor, and those that leave the floor with
/// both feet.
const TEST_ACTIONS: [Action; 4] = [Action::Bow, Action::PickUp, Action::Jump, Action::Hop];
/// Actions that are only in the validation split.
const VAL_ACTIONS: [Action; 2] = [Action::Turn, Action::SideStep];

pub(super) fn is_shown(action: Action) -> bool {
    !TEST_ACTIONS.contains(&action) && !VAL_ACTIONS.contains(&action)
}

/// The split of a clip, and of its adjusted performances.
pub(super) fn split(action: Action, style: &style::Style, take: usize) -> Split {
    if TEST_ACTIONS.contains(&action) {
        return Split::Test;
    }
    if VAL_ACTIONS.contains(&action) {
        return Split::Val;
    }
    let action = action as usize;
    // Neutral clips are the sources of style edits, so no neutral clip is held out for its style.
    let is_held_style = style::ALL[1..]
        .iter()
        .position(|other| other.name == style.name)
        .is_some_and(|style| (action + style).is_multiple_of(style::ALL.len() - 1));
    if take >= SHOWN_TAKES || is_held_style {
        return Split::Test;
    }
    match take == action % SHOWN_TAKES {
        true if (action / SHOWN_TAKES).is_multiple_of(2) => Split::Test,
        true => Split::Val,
        false => Split::Train,
    }
}
