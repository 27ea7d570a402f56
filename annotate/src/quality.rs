//! Quality of the answers: agreement, distance from drafts, times.

use std::collections::BTreeMap;

use datasets_spec::{JointSet, quantile};

use crate::Error;
use crate::agreement::{self, Item, MIN_ITEMS, estimate};
use crate::answer::{joints, text_distance};
use crate::body::RELEASE_PARTS;
use crate::store::{Label, Store};
use crate::wire::{Agreement, Answer, Estimate, RevisionState, TaskKind, Verdict};

/// Tasks read at a time.
const BATCH: usize = 2000;

/// Mean edit distance of the texts of an answer from their drafts, or `None` without drafts.
pub(crate) fn draft_distance(store: &Store, answer: &Answer) -> Result<Option<f64>, Error> {
    Ok(mean(&draft_distances(store, answer)?))
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

fn draft_distances(store: &Store, answer: &Answer) -> Result<Vec<f64>, Error> {
    let drafted: Vec<(&str, i64)> = answer
        .texts()
        .into_iter()
        .filter_map(|(text, draft)| Some((text, draft?)))
        .collect();
    if drafted.is_empty() {
        return Ok(Vec::new());
    }
    let known: BTreeMap<i64, String> = store
        .suggestions(drafted.iter().map(|(_, id)| *id).collect())?
        .into_iter()
        .map(|suggestion| (suggestion.id, suggestion.text))
        .collect();
    Ok(drafted
        .iter()
        .filter_map(|(text, id)| Some(text_distance(text, known.get(id)?)))
        .collect())
}

/// Figures of one person.
#[derive(Clone, Debug, Default)]
pub(crate) struct PersonFigures {
    pub(crate) median_secs: Option<f64>,
    pub(crate) draft_unchanged: Option<f64>,
    pub(crate) draft_distance: Option<f64>,
    pub(crate) agreement: Option<Estimate>,
}

/// Figures of all answers.
#[derive(Debug)]
pub(crate) struct Figures {
    pub(crate) agreement: Agreement,
    pub(crate) people: BTreeMap<i64, PersonFigures>,
    /// Time of each submission, and its seconds of work.
    pub(crate) secs_by_time: Vec<(i64, f64)>,
}

#[derive(Default)]
struct Gathered {
    secs: Vec<f64>,
    drafts: Vec<f64>,
    /// Jaccard index with the other answers to a task.
    shared: Vec<f64>,
}

impl Figures {
    /// Reads all submitted answers. Gold tasks are excluded from agreement.
    pub(crate) fn of(store: &Store) -> Result<Self, Error> {
        let mut people: BTreeMap<i64, Gathered> = BTreeMap::new();
        let mut secs_by_time = Vec::new();
        let mut parts: Vec<Vec<Item>> = vec![Vec::new(); RELEASE_PARTS.len()];
        let mut sets: Vec<Vec<JointSet>> = Vec::new();
        let mut verdicts: Vec<Item> = Vec::new();
        let mut decided: Vec<bool> = Vec::new();
        let (mut with_draft, mut without_draft) = (Vec::new(), Vec::new());
        let mut after = 0;
        loop {
            let labels = store.labels(after, BATCH)?;
            let Some(last) = labels.last() else { break };
            after = last.task;
            for task in labels.chunk_by(|a, b| a.task == b.task) {
                for label in task {
                    let revision = &label.revision;
                    let person = people.entry(revision.author).or_default();
                    person.secs.push(revision.secs);
                    secs_by_time.push((revision.at, revision.secs));
                    let drafts = draft_distances(store, &revision.answer)?;
                    person.drafts.extend(&drafts);
                    if label.blind {
                        without_draft.push(revision.secs);
                    } else if !drafts.is_empty() {
                        with_draft.push(revision.secs);
                    }
                    match revision.state {
                        RevisionState::Accepted => decided.push(true),
                        RevisionState::Returned | RevisionState::Superseded => decided.push(false),
                        RevisionState::Draft | RevisionState::Submitted => {}
                    }
                }
                if task.len() > 1 && !task[0].gold {
                    shared(task, &mut parts, &mut sets, &mut verdicts, &mut people);
                }
            }
        }
        let mut all: Vec<Item> = Vec::new();
        let mut figures: Vec<_> = RELEASE_PARTS
            .iter()
            .zip(&parts)
            .map(|(part, items)| {
                all.extend(items.iter().cloned());
                agreement::figures(part.name(), items, 2)
            })
            .collect();
        figures.push(agreement::figures("overall", &all, 2));
        let everything: Vec<f64> = people
            .values()
            .flat_map(|person| person.drafts.iter().copied())
            .collect();
        let times = |mut secs: Vec<f64>| {
            if secs.len() < MIN_ITEMS {
                None
            } else {
                quantile::median(&mut secs)
            }
        };
        let agreement = Agreement {
            parts: figures,
            jaccard: estimate(&sets, agreement::mean_jaccard),
            alpha_masi: estimate(&sets, agreement::masi_alpha),
            verdicts: (!verdicts.is_empty())
                .then(|| agreement::figures("verdict", &verdicts, Verdict::ALL.len())),
            shared_items: sets.len() + verdicts.len(),
            accepted_share: estimate(&decided, |items| {
                mean(
                    &items
                        .iter()
                        .map(|&&taken| f64::from(u8::from(taken)))
                        .collect::<Vec<_>>(),
                )
            }),
            draft_distance: mean(&everything),
            secs_with_and_without_draft: match (times(with_draft), times(without_draft)) {
                (Some(with), Some(without)) => Some([with, without]),
                _ => None,
            },
        };
        let people = people
            .into_iter()
            .map(|(id, mut person)| {
                let unchanged = person
                    .drafts
                    .iter()
                    .filter(|&&distance| distance == 0.0)
                    .count();
                let figures = PersonFigures {
                    median_secs: quantile::median(&mut person.secs),
                    draft_unchanged: (!person.drafts.is_empty())
                        .then(|| unchanged as f64 / person.drafts.len() as f64),
                    draft_distance: mean(&person.drafts),
                    agreement: estimate(&person.shared, |items| {
                        mean(&items.iter().map(|&&value| value).collect::<Vec<_>>())
                    }),
                };
                (id, figures)
            })
            .collect();
        Ok(Self {
            agreement,
            people,
            secs_by_time,
        })
    }
}

/// Adds a task with several answers.
fn shared(
    task: &[Label],
    parts: &mut [Vec<Item>],
    sets: &mut Vec<Vec<JointSet>>,
    verdicts: &mut Vec<Item>,
    people: &mut BTreeMap<i64, Gathered>,
) {
    let answers = || {
        task.iter()
            .map(|label| (label.revision.author, &label.revision.answer))
    };
    if task[0].kind != TaskKind::MaskText {
        let verdict = |answer: &Answer| {
            let verdict = answer.verdict()?;
            Verdict::ALL.iter().position(|&known| known == verdict)
        };
        let item: Item = answers()
            .filter_map(|(author, answer)| Some((author, verdict(answer)?)))
            .collect();
        for (index, (author, label)) in item.iter().enumerate() {
            let others: Vec<f64> = item
                .iter()
                .enumerate()
                .filter(|(other, _)| *other != index)
                .map(|(_, (_, other))| f64::from(u8::from(other == label)))
                .collect();
            if let (Some(value), Some(person)) = (mean(&others), people.get_mut(author)) {
                person.shared.push(value);
            }
        }
        verdicts.push(item);
        return;
    }
    // A part counts as marked if one mask contains all its hard joints: BOTH_ARMS marks each arm.
    let covers = |answer: &Answer, part: usize| match answer {
        Answer::MaskText { masks, .. } => masks.iter().any(|mask| {
            let set = joints(&mask.parts);
            RELEASE_PARTS[part].mask().hard().difference(set).is_empty()
        }),
        Answer::Pair { .. } | Answer::Style { .. } => false,
    };
    for (part, items) in parts.iter_mut().enumerate() {
        items.push(
            answers()
                .map(|(author, answer)| (author, usize::from(covers(answer, part))))
                .collect(),
        );
    }
    let all: Vec<JointSet> = answers().map(|(_, answer)| answer.joints()).collect();
    for (index, (author, _)) in answers().enumerate() {
        let others: Vec<f64> = all
            .iter()
            .enumerate()
            .filter(|(other, _)| *other != index)
            .map(|(_, set)| crate::answer::jaccard(all[index], *set))
            .collect();
        if let (Some(value), Some(person)) = (mean(&others), people.get_mut(&author)) {
            person.shared.push(value);
        }
    }
    sets.push(all);
}
