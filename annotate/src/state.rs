//! The legal moves of a task, as data. The store checks every event against this table, the tests
//! walk it at random, and the document of the crate prints it.

use crate::wire::{TaskState, names};

names! {
    /// What the log can say.
    pub enum LogKind {
        /// A task came into being.
        Imported = "imported",
        /// Somebody took a lease, to answer or to review.
        Claimed = "claimed",
        /// A lease was prolonged.
        Renewed = "renewed",
        /// A lease ended without an answer: given back, expired, or taken away.
        Released = "released",
        /// An unfinished answer was kept.
        DraftSaved = "draft_saved",
        /// An answer was handed in.
        Submitted = "submitted",
        /// A task was skipped or postponed by somebody.
        Skipped = "skipped",
        /// Answers were sent back with a comment.
        Returned = "returned",
        /// An answer was taken.
        Accepted = "accepted",
        /// An answer made by the reviewer was taken.
        Merged = "merged",
        /// A task was taken out.
        Dropped = "dropped",
        /// A decision was undone.
        Reopened = "reopened",
        /// An answer handed in was taken back by its author.
        Undone = "undone",
        /// Something became of a suggestion.
        SuggestionUsed = "suggestion_used",
        /// An answer to a gold task was compared with the known one.
        GoldScored = "gold_scored",
        /// A user was added, or a role or access changed.
        RoleChanged = "role_changed",
        /// Settings were changed.
        SettingsChanged = "settings_changed",
        /// Accepted answers were exported.
        Exported = "exported",
    }
}

names! {
    /// What a lease is for.
    pub enum Purpose {
        /// To answer.
        Annotate = "annotate",
        /// To review.
        Review = "review",
        /// A place kept for an author whose answer came back.
        Returned = "returned",
    }
}

names! {
    /// Why a lease ended without an answer.
    pub enum ReleaseReason {
        /// Its holder gave it back.
        GivenBack = "given_back",
        /// It ran out.
        Expired = "expired",
        /// A reviewer took it.
        TakenAway = "taken_away",
    }
}

/// A row of the table of moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Move {
    /// State before.
    pub from: TaskState,
    /// What happens.
    pub event: LogKind,
    /// States it may lead to; which of them depends on the answers and leases that are left.
    pub to: &'static [TaskState],
}

const fn row(from: TaskState, event: LogKind, to: &'static [TaskState]) -> Move {
    Move { from, event, to }
}

use LogKind as E;
use TaskState::{Accepted, Dropped, InReview, Leased, Open, Returned, Submitted};

/// States of a task that still wants answers.
const WANTING: &[TaskState] = &[Open, Leased, Returned];
/// The same, or all answers are there.
const ANY_UNDECIDED: &[TaskState] = &[Open, Leased, Returned, Submitted];

/// Every legal move. What is not here is refused with `wrong_state`.
pub const MOVES: &[Move] = &[
    row(Open, E::Claimed, &[Leased]),
    row(Open, E::DraftSaved, &[Open]),
    row(Open, E::Undone, &[Leased]),
    row(Open, E::Dropped, &[Dropped]),
    row(Open, E::SuggestionUsed, &[Open]),
    row(Leased, E::Claimed, &[Leased]),
    row(Leased, E::Renewed, &[Leased]),
    row(Leased, E::Released, WANTING),
    row(Leased, E::DraftSaved, &[Leased]),
    row(Leased, E::Submitted, ANY_UNDECIDED),
    row(Leased, E::Skipped, WANTING),
    row(Leased, E::Undone, &[Leased]),
    row(Leased, E::Dropped, &[Dropped]),
    row(Leased, E::SuggestionUsed, &[Leased]),
    row(Leased, E::GoldScored, &[Leased]),
    row(Open, E::GoldScored, &[Open]),
    row(Returned, E::Claimed, &[Leased]),
    row(Returned, E::Released, WANTING),
    row(Returned, E::DraftSaved, &[Returned]),
    row(Returned, E::Undone, &[Leased]),
    row(Returned, E::Dropped, &[Dropped]),
    row(Returned, E::SuggestionUsed, &[Returned]),
    row(Submitted, E::Claimed, &[InReview]),
    row(Submitted, E::DraftSaved, &[Submitted]),
    row(Submitted, E::Undone, &[Leased]),
    row(Submitted, E::Accepted, &[Accepted]),
    row(Submitted, E::Merged, &[Accepted]),
    row(Submitted, E::Returned, &[Returned]),
    row(Submitted, E::Dropped, &[Dropped]),
    row(Submitted, E::SuggestionUsed, &[Submitted]),
    row(InReview, E::Renewed, &[InReview]),
    row(InReview, E::Released, &[Submitted]),
    row(InReview, E::DraftSaved, &[InReview]),
    row(InReview, E::Accepted, &[Accepted]),
    row(InReview, E::Merged, &[Accepted]),
    row(InReview, E::Returned, &[Returned]),
    row(InReview, E::Dropped, &[Dropped]),
    row(InReview, E::SuggestionUsed, &[InReview]),
    row(Accepted, E::DraftSaved, &[Accepted]),
    row(Accepted, E::Reopened, ANY_UNDECIDED),
    row(Accepted, E::SuggestionUsed, &[Accepted]),
    row(Dropped, E::DraftSaved, &[Dropped]),
    row(Dropped, E::Reopened, ANY_UNDECIDED),
    row(Dropped, E::SuggestionUsed, &[Dropped]),
];

/// The states an event may lead to; none if it is not legal.
pub fn targets(from: TaskState, event: LogKind) -> &'static [TaskState] {
    MOVES
        .iter()
        .find(|row| row.from == from && row.event == event)
        .map_or(&[], |row| row.to)
}

/// The table as Markdown, for the document of the crate.
pub fn markdown() -> String {
    let mut text = "| from | event | to |\n|---|---|---|\n".to_owned();
    for row in MOVES {
        let to: Vec<&str> = row.to.iter().map(|state| state.as_str()).collect();
        text += &format!("| {} | {} | {} |\n", row.from, row.event, to.join(", "));
    }
    text
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn every_move_is_listed_once_and_every_state_is_reached_and_left() {
        let keys: BTreeSet<_> = MOVES.iter().map(|row| (row.from, row.event)).collect();
        assert_eq!(keys.len(), MOVES.len());
        let mut reached = BTreeSet::from([Open]);
        loop {
            let before = reached.len();
            for row in MOVES {
                if reached.contains(&row.from) {
                    reached.extend(row.to);
                }
            }
            if reached.len() == before {
                break;
            }
        }
        assert_eq!(reached.len(), TaskState::ALL.len());
        for &state in TaskState::ALL {
            assert!(
                MOVES
                    .iter()
                    .any(|row| row.from == state && row.to != [state])
            );
        }
    }

    #[test]
    fn the_document_prints_the_table() {
        let document = include_str!("../README.md");
        assert!(
            document.contains(&markdown()),
            "put this into README.md:\n{}",
            markdown()
        );
    }

    #[test]
    fn a_decided_task_takes_no_answers() {
        for state in [Accepted, Dropped] {
            for event in [
                E::Claimed,
                E::Submitted,
                E::Accepted,
                E::Returned,
                E::Undone,
            ] {
                assert!(targets(state, event).is_empty(), "{state} {event}");
            }
        }
    }
}
