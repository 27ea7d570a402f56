//! The legal state transitions of a task, as a table. The store checks every event against it, tests walk it
//! at random, and `docs/data-model.md` prints it.

use crate::wire::{TaskState, names};

names! {
    /// Kinds of log entries.
    pub enum LogKind {
        /// A task was created.
        Imported = "imported",
        /// An imported answer was accepted for a task that nobody had worked on. It may replace a label of the dataset.
        Filled = "filled",
        /// A clip of the task was ingested again with other content.
        ClipChanged = "clip_changed",
        /// A reviewer confirmed the answers for the new content of the clip.
        ClipKept = "clip_kept",
        /// A lease was taken, to answer or to review.
        Claimed = "claimed",
        Renewed = "renewed",
        /// A lease ended without an answer: given back, expired, or revoked.
        Released = "released",
        DraftSaved = "draft_saved",
        Submitted = "submitted",
        /// A user skipped or postponed a task.
        Skipped = "skipped",
        /// Answers were sent back with a comment.
        Returned = "returned",
        Accepted = "accepted",
        /// An answer merged by the reviewer was accepted.
        Merged = "merged",
        Dropped = "dropped",
        /// A decision was undone.
        Reopened = "reopened",
        /// The author withdrew a submitted answer.
        Undone = "undone",
        /// A suggestion was used, edited or discarded.
        SuggestionUsed = "suggestion_used",
        GoldScored = "gold_scored",
        /// A user was added, or their role or access changed.
        RoleChanged = "role_changed",
        SettingsChanged = "settings_changed",
        Exported = "exported",
        /// A task was reserved for a person.
        Assigned = "assigned",
        /// The number of answers that a task wants was changed.
        Retargeted = "retargeted",
        CapturesPlanned = "captures_planned",
        /// A picture of the guide was stored or deleted.
        GuidePicture = "guide_picture",
        /// A reviewer judged a paraphrase. Only versions up to 0.1 of this program proposed paraphrases.
        ParaphraseJudged = "paraphrase_judged",
    }

    /// Purpose of a lease.
    pub enum Purpose {
        /// A lease to answer the task.
        Annotate = "annotate",
        /// A lease to review the task.
        Review = "review",
        /// Reservation for an author whose answer was returned.
        Returned = "returned",
        /// Reservation for the person to whom a reviewer assigned the task.
        Assigned = "assigned",
    }

    /// Why a lease ended without an answer.
    pub enum ReleaseReason {
        /// The holder released the lease.
        GivenBack = "given_back",
        /// The lease expired.
        Expired = "expired",
        /// A reviewer revoked the lease.
        TakenAway = "taken_away",
        /// The clip of the task was ingested again with other content, which its holder has not seen.
        ClipChanged = "clip_changed",
        /// The clip of the task is no longer in the dataset.
        ClipGone = "clip_gone",
    }
}

use LogKind as E;
use TaskState::{Accepted, Dropped, InReview, Leased, Open, Returned, Submitted};

/// States of a task that needs more answers.
const WANTING: &[TaskState] = &[Open, Leased, Returned];
/// The states above, and the state in which all answers are submitted.
const ANY_UNDECIDED: &[TaskState] = &[Open, Leased, Returned, Submitted];
/// States in which a reviewer may decide.
const WITH_REVIEWERS: &[TaskState] = &[Submitted, InReview];
/// The state does not change.
const SAME: &[TaskState] = &[];

/// All legal transitions: the event, the states before it, and the possible states after it. Which of the possible
/// states follows depends on the remaining answers and leases. Other transitions are refused with `wrong_state`.
pub const MOVES: &[(LogKind, &[TaskState], &[TaskState])] = &[
    (E::Filled, &[Open, Accepted], &[Accepted]),
    (E::Claimed, WANTING, &[Leased]),
    (E::Claimed, &[Submitted], &[InReview]),
    (E::Assigned, WANTING, &[Leased]),
    (E::Retargeted, &[Open], &[Open, Submitted]),
    (E::Retargeted, &[Leased, Returned], SAME),
    (E::Renewed, &[Leased, InReview], SAME),
    (E::Released, &[Leased, Returned], WANTING),
    (E::Released, &[InReview], &[Submitted]),
    (E::Submitted, &[Leased], ANY_UNDECIDED),
    (E::Skipped, &[Leased], WANTING),
    (E::GoldScored, &[Open, Leased], SAME),
    (E::Undone, ANY_UNDECIDED, &[Leased]),
    (E::Accepted, WITH_REVIEWERS, &[Accepted]),
    (E::Merged, WITH_REVIEWERS, &[Accepted]),
    (E::Returned, WITH_REVIEWERS, &[Returned]),
    (
        E::Dropped,
        &[Open, Leased, Returned, Submitted, InReview],
        &[Dropped],
    ),
    (E::Reopened, &[Accepted, Dropped], ANY_UNDECIDED),
    (E::DraftSaved, TaskState::ALL, SAME),
    (E::SuggestionUsed, TaskState::ALL, SAME),
    (E::ClipChanged, TaskState::ALL, SAME),
    (E::ClipKept, TaskState::ALL, SAME),
];

/// Possible states after an event in state `from`; empty if the event is not legal there.
pub fn targets(from: TaskState, event: LogKind) -> &'static [TaskState] {
    let found = MOVES.iter().find_map(|&(known, before, to)| {
        let state = before.iter().find(|state| **state == from)?;
        (known == event).then_some((state, to))
    });
    match found {
        None => &[],
        Some((state, [])) => std::slice::from_ref(state),
        Some((_, to)) => to,
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    /// The table as Markdown, for `docs/data-model.md`.
    fn markdown() -> String {
        let names = |states: &[TaskState]| match states {
            [] => "the same".to_owned(),
            _ if states == TaskState::ALL => "any".to_owned(),
            _ => Vec::from_iter(states.iter().map(|state| state.as_str())).join(", "),
        };
        let mut text = "| event | from | to |\n|---|---|---|\n".to_owned();
        for (event, before, to) in MOVES {
            text += &format!("| {event} | {} | {} |\n", names(before), names(to));
        }
        text
    }

    #[test]
    fn every_move_is_listed_once_and_every_state_is_reached_and_left() {
        let keys: Vec<(LogKind, TaskState)> = MOVES
            .iter()
            .flat_map(|&(event, before, _)| before.iter().map(move |&state| (event, state)))
            .collect();
        assert_eq!(BTreeSet::from_iter(&keys).len(), keys.len());
        let mut reached = BTreeSet::from([Open]);
        loop {
            let before = reached.len();
            for &(event, state) in &keys {
                if reached.contains(&state) {
                    reached.extend(targets(state, event));
                }
            }
            if reached.len() == before {
                break;
            }
        }
        assert_eq!(reached.len(), TaskState::ALL.len());
        for &state in TaskState::ALL {
            let mut of_state = keys.iter().filter(|key| key.1 == state);
            assert!(of_state.any(|&(event, _)| targets(state, event) != [state]));
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
