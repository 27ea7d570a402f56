//! Quality of the answers: agreement, distance from drafts, times.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, TryLockError};

use datasets_spec::{JointSet, quantile};
use rayon::prelude::*;

use crate::Error;
use crate::agreement::{Item, MIN_ITEMS, mean, mean_estimate, part_agreement};
use crate::answer::{completion, text_distance};
use crate::body::{NUM_RELEASE_PARTS, RELEASE_PARTS};
use crate::groups::grouped;
use crate::lock::lock;
use crate::mask::{Cells, jaccard_in_time, stretched};
use crate::store::{Label, Millis, Store};
use crate::wire::{Agreement, Answer, Estimate, PartAgreement, RevisionState, Verdict};

/// Tasks read at a time.
const BATCH: usize = 2000;

/// Mean edit distance of an answer's texts from their drafts, or `None` without drafts.
pub(crate) fn draft_distance(store: &Store, answer: &Answer) -> Result<Option<f64>, Error> {
    let drafts = drafts_of(store, [answer])?;
    Ok(mean(&draft_distances(answer, &drafts)))
}

/// Edit distances of the texts of an answer from their drafts. "The person is" is left out of both, because drafts of
/// masks are shown without it.
fn draft_distances(answer: &Answer, drafts: &BTreeMap<i64, String>) -> Vec<f64> {
    let texts = answer.texts().into_iter();
    texts
        .filter_map(|(text, draft)| Some((completion(text), completion(drafts.get(&draft?)?))))
        .map(|(text, draft)| text_distance(text, draft))
        .collect()
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
    /// Time of the last answer to each task with several answers, and their agreement, 0 to 1.
    pub(crate) agreed_by_time: Vec<(i64, f64)>,
}

/// Data of an answer that the figures are computed from.
struct Said {
    author: i64,
    secs: f64,
    at: i64,
    blind: bool,
    gold: bool,
    state: RevisionState,
    /// Whether a reviewer ever returned it.
    returned: bool,
    /// Edit distances of the answer's texts from their drafts.
    drafts: Vec<f64>,
    /// Index of the verdict in [`Verdict::ALL`]; none for masks.
    verdict: Option<usize>,
    /// For each part of the release, whether one mask contains all its hard joints. BOTH_ARMS thus covers each arm.
    covers: [bool; NUM_RELEASE_PARTS],
    /// Joints and frames of the answer's masks.
    cells: Vec<Cells>,
    /// Number of frames of the clip.
    frames: i64,
}

impl Said {
    /// Agreement with another answer, 0 to 1. Masks of two clips are compared as if the clips were equally long.
    fn likeness(&self, other: &Self) -> f64 {
        match self.verdict {
            Some(_) => f64::from(u8::from(self.verdict == other.verdict)),
            None => jaccard_in_time(
                &stretched(&self.cells, other.frames),
                &stretched(&other.cells, self.frames),
            ),
        }
    }
}

/// A task with several answers.
struct Shared<'a> {
    said: &'a [Said],
    /// Mean agreement of each answer with the others.
    alike: Vec<f64>,
}

impl<'a> Shared<'a> {
    fn of(said: &'a [Said]) -> Self {
        let alike = said.iter().enumerate().filter_map(|(index, own)| {
            let others = said[..index].iter().chain(&said[index + 1..]);
            let alike: Vec<f64> = others.map(|other| own.likeness(other)).collect();
            mean(&alike)
        });
        Self {
            said,
            alike: alike.collect(),
        }
    }
}

/// Data of all answers for the figures. It stays in memory and is updated with the tasks that changed, so that each
/// answer is read once.
#[derive(Default)]
pub(crate) struct Gathered {
    /// Sequence number of the last log entry that is included.
    seq: i64,
    /// The answers to each task.
    tasks: BTreeMap<i64, Vec<Said>>,
}

impl Figures {
    /// Figures of all submitted answers. Gold tasks are excluded from agreement.
    pub(crate) fn of(store: &Store) -> Result<Self, Error> {
        let mut gathered = Gathered::default();
        gathered.update(store)?;
        Ok(gathered.figures())
    }
}

impl Gathered {
    /// Reads the answers to tasks that changed, and returns whether there were any.
    pub(crate) fn update(&mut self, store: &Store) -> Result<bool, Error> {
        let (changed, seq) = store.answered_since(self.seq)?;
        for tasks in changed.chunks(BATCH) {
            let labels = store.labels_to(tasks.to_vec())?;
            let drafts = drafts_of(store, labels.iter().map(|label| &label.revision.answer))?;
            for task in tasks {
                self.tasks.remove(task);
            }
            for label in &labels {
                let answers = self.tasks.entry(label.task).or_default();
                answers.push(said(label, &drafts));
            }
        }
        self.seq = seq;
        Ok(!changed.is_empty())
    }

    pub(crate) fn figures(&self) -> Figures {
        let all: Vec<&Said> = self.tasks.values().flatten().collect();
        let several = self.tasks.values().filter(|said| said.len() > 1);
        let shared: Vec<Shared<'_>> = several
            .filter(|said| !said[0].gold)
            .map(|said| Shared::of(said))
            .collect();
        let last = |task: &Shared<'_>| task.said.iter().map(|said| said.at).max();
        Figures {
            agreement: agreement(&all, &shared),
            people: people(&all, &shared),
            secs_by_time: all.iter().map(|said| (said.at, said.secs)).collect(),
            agreed_by_time: shared
                .iter()
                .filter_map(|task| last(task).zip(mean(&task.alike)))
                .collect(),
        }
    }
}

fn agreement(all: &[&Said], shared: &[Shared<'_>]) -> Agreement {
    let (masks, pairs): (Vec<&Shared<'_>>, Vec<&Shared<'_>>) = shared
        .iter()
        .partition(|task| task.said[0].verdict.is_none());
    let jaccards: Vec<f64> = masks.iter().filter_map(|task| mean(&task.alike)).collect();
    // The likeness of an answer to each task with an answer to the next task.
    let following = masks.iter().skip(1).chain(masks.first());
    let unalike = masks.iter().zip(following);
    let unalike: Vec<f64> = unalike
        .map(|(task, next)| task.said[0].likeness(&next.said[1]))
        .collect();
    let verdicts: Vec<Vec<Item>> = pairs
        .iter()
        .map(|task| vec![task.said.iter().filter_map(|said| said.verdict).collect()])
        .collect();
    let decided: Vec<f64> = all
        .iter()
        .filter_map(|said| match said.state {
            RevisionState::Accepted => Some(f64::from(u8::from(!said.returned))),
            RevisionState::Returned | RevisionState::Superseded => Some(0.0),
            RevisionState::Draft | RevisionState::Submitted => None,
        })
        .collect();
    let drafts: Vec<f64> = all.iter().flat_map(|said| said.drafts.clone()).collect();
    // A median needs at least [`MIN_ITEMS`] answers.
    let median_secs = |counts: fn(&Said) -> bool| {
        let counted = all.iter().filter(|said| counts(said));
        let mut secs: Vec<f64> = counted.map(|said| said.secs).collect();
        quantile::median(&mut secs).filter(|_| secs.len() >= MIN_ITEMS)
    };
    let with_draft = median_secs(|said| !said.blind && !said.drafts.is_empty());
    let without_draft = median_secs(|said| said.blind);
    Agreement {
        parts: agreement_by_part(&masks),
        jaccard: mean_estimate(&jaccards),
        jaccard_chance: mean(&unalike).filter(|_| unalike.len() >= MIN_ITEMS),
        verdicts: (!verdicts.is_empty())
            .then(|| part_agreement("verdict", &verdicts, Verdict::ALL.len())),
        shared_items: shared.len(),
        accepted_share: mean_estimate(&decided),
        draft_distance: mean(&drafts),
        secs_with_and_without_draft: with_draft
            .zip(without_draft)
            .map(|(with, without)| [with, without]),
    }
}

/// Agreement on whether a mask covers each part of the release, and `overall` on the decisions about all parts.
fn agreement_by_part(tasks: &[&Shared<'_>]) -> Vec<PartAgreement> {
    let covers = |parts: std::ops::Range<usize>| -> Vec<Vec<Item>> {
        let decisions = |task: &&Shared<'_>| -> Vec<Item> {
            let of_part = |part: usize| -> Item {
                let covers = task.said.iter().map(|said| usize::from(said.covers[part]));
                covers.collect()
            };
            parts.clone().map(of_part).collect()
        };
        tasks.iter().map(decisions).collect()
    };
    let names = RELEASE_PARTS.iter().map(|part| part.name()).enumerate();
    let mut decisions: Vec<_> = names.map(|(part, name)| (name, part..part + 1)).collect();
    decisions.push(("overall", 0..NUM_RELEASE_PARTS));
    decisions
        .into_par_iter()
        .map(|(name, parts)| part_agreement(name, &covers(parts), 2))
        .collect()
}

fn people(all: &[&Said], shared: &[Shared<'_>]) -> BTreeMap<i64, PersonFigures> {
    let own = grouped(all.iter().map(|said| (said.author, *said)));
    let alike = grouped(shared.iter().flat_map(|task| {
        let authors = task.said.iter().map(|said| said.author);
        authors.zip(task.alike.iter().copied())
    }));
    let figures = |(author, said): (i64, Vec<&Said>)| {
        let mut secs: Vec<f64> = said.iter().map(|said| said.secs).collect();
        let drafts: Vec<f64> = said.iter().flat_map(|said| said.drafts.clone()).collect();
        let unchanged = drafts
            .iter()
            .map(|distance| f64::from(u8::from(*distance == 0.0)));
        let figures = PersonFigures {
            median_secs: quantile::median(&mut secs),
            draft_unchanged: mean(&unchanged.collect::<Vec<_>>()),
            draft_distance: mean(&drafts),
            agreement: mean_estimate(alike.get(&author).map_or(&[][..], Vec::as_slice)),
        };
        (author, figures)
    };
    own.into_iter().map(figures).collect()
}

/// Texts of the suggestions that answers started from.
fn drafts_of<'a>(
    store: &Store,
    answers: impl IntoIterator<Item = &'a Answer>,
) -> Result<BTreeMap<i64, String>, Error> {
    let texts = answers.into_iter().flat_map(Answer::texts);
    let ids: BTreeSet<i64> = texts.filter_map(|(_, draft)| draft).collect();
    if ids.is_empty() {
        return Ok(BTreeMap::new());
    }
    Ok(store
        .suggestions(ids.into_iter().collect())?
        .into_iter()
        .map(|suggestion| (suggestion.id, suggestion.text))
        .collect())
}

fn said(label: &Label, drafts: &BTreeMap<i64, String>) -> Said {
    let revision = &label.revision;
    let said = revision.answer.fields();
    let masks = said.masks.iter();
    let sets: Vec<JointSet> = masks.map(|mask| mask.mask().hard()).collect();
    Said {
        author: revision.author,
        secs: revision.secs,
        at: revision.at,
        blind: label.blind,
        gold: label.gold,
        state: revision.state,
        returned: label.returned,
        drafts: draft_distances(&revision.answer, drafts),
        verdict: said.verdict.map(|verdict| verdict as usize),
        covers: RELEASE_PARTS.map(|part| {
            let hard = part.mask().hard();
            sets.iter().any(|set| hard.difference(*set).is_empty())
        }),
        cells: revision.answer.cells(label.frames),
        frames: label.frames,
    }
}

/// Cached figures. Each answer is read once; figures are computed again if answers have changed and the last figures
/// are older than [`FIGURES_AGE`].
#[derive(Default)]
pub(crate) struct KeptFigures {
    gathered: Mutex<Gathered>,
    last: Mutex<Option<(Millis, Arc<Figures>)>>,
}

/// Age in milliseconds up to which figures are not computed again, even if answers have changed.
const FIGURES_AGE: Millis = 60_000;

impl KeptFigures {
    /// The figures at `now`. While another request computes them, the last ones are returned.
    pub(crate) fn get(&self, store: &Store, now: Millis) -> Result<Arc<Figures>, Error> {
        let last = lock(&self.last).clone();
        if let Some((at, figures)) = &last
            && (0..FIGURES_AGE).contains(&(now - at))
        {
            return Ok(Arc::clone(figures));
        }
        let mut gathered = match (self.gathered.try_lock(), &last) {
            (Ok(gathered), _) => gathered,
            (Err(TryLockError::WouldBlock), Some((_, figures))) => return Ok(Arc::clone(figures)),
            _ => lock(&self.gathered),
        };
        let changed = gathered.update(store)?;
        // Another thread may have computed the figures while this one waited for the lock.
        let last = lock(&self.last).clone();
        let figures = match last {
            Some((_, figures)) if !changed => figures,
            _ => Arc::new(gathered.figures()),
        };
        *lock(&self.last) = Some((now, Arc::clone(&figures)));
        Ok(figures)
    }
}
