//! The legal state transitions of a task, as a table. The store checks every event against it, tests walk it
//! at random, and `docs/data-model.md` prints it.

use crate::wire::{TaskState, names};

names! {
    /// Kinds of log entries.
    pub enum LogKind {
        /// A task was created.
        Imported = "imported",
        /// An imported answer was accepted for a task that nobody had worked on.
        Filled = "filled",
        /// A clip of the task was ingested anew, with other content.
        ClipChanged = "clip_changed",
        /// Somebody said that the answers hold for the new content of the clip.
        ClipKept = "clip_kept",
        /// A lease was taken, to answer or to review.
        Claimed = "claimed",
        /// A lease was renewed.
        Renewed = "renewed",
        /// A lease ended without an answer: given back, expired, or revoked.
        Released = "released",
        /// A draft was saved.
        DraftSaved = "draft_saved",
        /// An answer was submitted.
        Submitted = "submitted",
        /// A user skipped or postponed a task.
        Skipped = "skipped",
        /// Answers were sent back with a comment.
        Returned = "returned",
        /// An answer was accepted.
        Accepted = "accepted",
        /// An answer merged by the reviewer was accepted.
        Merged = "merged",
        /// A task was dropped.
        Dropped = "dropped",
        /// A decision was undone.
        Reopened = "reopened",
        /// The author withdrew a submitted answer.
        Undone = "undone",
        /// A suggestion was used, edited or discarded.
        SuggestionUsed = "suggestion_used",
        /// An answer to a gold task was scored.
        GoldScored = "gold_scored",
        /// A user was added, or their role or access changed.
        RoleChanged = "role_changed",
        /// Settings were changed.
        SettingsChanged = "settings_changed",
        /// Accepted answers were exported.
        Exported = "exported",
        /// A task was reserved for a person.
        Assigned = "assigned",
        /// The number of answers that a task wants was changed.
        Retargeted = "retargeted",
        /// The capture plan was changed.
        CapturesPlanned = "captures_planned",
        /// A picture of the guide was stored or deleted.
        GuidePicture = "guide_picture",
        /// A reviewer judged a paraphrase, which programs up to version 0.1 proposed.
        ParaphraseJudged = "paraphrase_judged",
    }
}

names! {
    /// Purpose of a lease.
    pub enum Purpose {
        /// To answer.
        Annotate = "annotate",
        /// To review.
        Review = "review",
        /// Reservation for an author whose answer was returned.
        Returned = "returned",
        /// Reservation for a person whom a reviewer gave the task to.
        Assigned = "assigned",
    }
}

names! {
    /// Why a lease ended without an answer.
    pub enum ReleaseReason {
        /// The holder released it.
        GivenBack = "given_back",
        /// It expired.
        Expired = "expired",
        /// A reviewer revoked it.
        TakenAway = "taken_away",
    }
}

/// A row of the transition table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Move {
    /// State before.
    pub from: TaskState,
    /// Event.
    pub event: LogKind,
    /// Possible next states; the remaining answers and leases decide which.
    pub to: &'static [TaskState],
}

const fn row(from: TaskState, event: LogKind, to: &'static [TaskState]) -> Move {
    Move { from, event, to }
}

use LogKind as E;
use TaskState::{Accepted, Dropped, InReview, Leased, Open, Returned, Submitted};

/// States of a task that needs more answers.
const WANTING: &[TaskState] = &[Open, Leased, Returned];
/// The same, or all answers are submitted.
const ANY_UNDECIDED: &[TaskState] = &[Open, Leased, Returned, Submitted];

/// All legal transitions. Others are refused with `wrong_state`.
pub const MOVES: &[Move] = &[
    row(Open, E::Filled, &[Accepted]),
    row(Open, E::Claimed, &[Leased]),
    row(Open, E::DraftSaved, &[Open]),
    row(Open, E::Undone, &[Leased]),
    row(Open, E::Dropped, &[Dropped]),
    row(Open, E::SuggestionUsed, &[Open]),
    row(Open, E::Assigned, &[Leased]),
    row(Open, E::Retargeted, &[Open, Submitted]),
    row(Leased, E::Claimed, &[Leased]),
    row(Leased, E::Assigned, &[Leased]),
    row(Leased, E::Retargeted, &[Leased]),
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
    row(Returned, E::Assigned, &[Leased]),
    row(Returned, E::Retargeted, &[Returned]),
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
    row(Open, E::ClipChanged, &[Open]),
    row(Leased, E::ClipChanged, &[Leased]),
    row(Returned, E::ClipChanged, &[Returned]),
    row(Submitted, E::ClipChanged, &[Submitted]),
    row(InReview, E::ClipChanged, &[InReview]),
    row(Accepted, E::ClipChanged, &[Accepted]),
    row(Dropped, E::ClipChanged, &[Dropped]),
    row(Open, E::ClipKept, &[Open]),
    row(Leased, E::ClipKept, &[Leased]),
    row(Returned, E::ClipKept, &[Returned]),
    row(Submitted, E::ClipKept, &[Submitted]),
    row(InReview, E::ClipKept, &[InReview]),
    row(Accepted, E::ClipKept, &[Accepted]),
    row(Dropped, E::ClipKept, &[Dropped]),
];

/// Possible next states of an event; empty if it is not legal.
pub fn targets(from: TaskState, event: LogKind) -> &'static [TaskState] {
    MOVES
        .iter()
        .find(|row| row.from == from && row.event == event)
        .map_or(&[], |row| row.to)
}

/// The table as Markdown, for `docs/data-model.md`.
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
        let document = include_str!("../docs/data-model.md");
        assert!(
            document.contains(&markdown()),
            "put this into docs/data-model.md:\n{}",
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
