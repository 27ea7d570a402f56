//! Quality of the answers: agreement, distance from drafts, times.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, TryLockError};

use datasets_spec::{JointSet, quantile};
use rayon::prelude::*;

use crate::Error;
use crate::agreement::{Item, MIN_ITEMS, mean, mean_estimate, part_agreement};
use crate::answer::{completion, text_distance};
use crate::body::{NUM_RELEASE_PARTS, RELEASE_PARTS};
use crate::lock::lock;
use crate::mask::{Cells, jaccard_in_time};
use crate::store::{Label, Millis, Store};
use crate::wire::{Agreement, Answer, Estimate, PartAgreement, RevisionState, TaskKind, Verdict};

/// Tasks read at a time.
const BATCH: usize = 2000;

/// Mean edit distance of the texts of an answer from their drafts, or `None` without drafts.
pub(crate) fn draft_distance(store: &Store, answer: &Answer) -> Result<Option<f64>, Error> {
    let drafts = drafts_of(store, [answer])?;
    Ok(mean(&draft_distances(answer, &drafts)))
}

/// Edit distances of the texts of an answer from their drafts. Drafts of masks are shown without "The person is".
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
    /// Time of the last answer to each task with several, and how far they agree, 0 to 1.
    pub(crate) agreed_by_time: Vec<(i64, f64)>,
}

/// What the figures need of an answer.
struct Said {
    author: i64,
    secs: f64,
    at: i64,
    blind: bool,
    state: RevisionState,
    /// Edit distances of its texts from their drafts.
    drafts: Vec<f64>,
    /// Place of its verdict in [`Verdict::ALL`].
    verdict: Option<usize>,
    /// Whether a mask contains all hard joints of each part of the release: BOTH_ARMS marks each arm.
    covers: [bool; NUM_RELEASE_PARTS],
    /// Joints and frames that its masks take.
    cells: Vec<Cells>,
}

impl Said {
    /// How far it agrees with another answer to the task, 0 to 1.
    fn likeness(&self, other: &Self) -> f64 {
        match self.verdict {
            Some(_) => f64::from(u8::from(self.verdict == other.verdict)),
            None => jaccard_in_time(&self.cells, &other.cells),
        }
    }
}

/// The answers to a task.
struct OfTask {
    kind: TaskKind,
    gold: bool,
    said: Vec<Said>,
}

/// What the figures need of all answers. It is kept in memory and brought up to date with the tasks that changed since,
/// so that answers are read once.
#[derive(Default)]
pub(crate) struct Gathered {
    /// Sequence number of the log up to which it is up to date.
    seq: i64,
    tasks: BTreeMap<i64, OfTask>,
}

#[derive(Default)]
struct OfPerson {
    secs: Vec<f64>,
    drafts: Vec<f64>,
    /// How far each answer to a shared task agrees with the others.
    shared: Vec<f64>,
}

/// What the figures are computed from.
#[derive(Default)]
struct Counted {
    people: BTreeMap<i64, OfPerson>,
    secs_by_time: Vec<(i64, f64)>,
    agreed_by_time: Vec<(i64, f64)>,
    /// Whether each answer to a shared task covers a part, by the place of the part in [`RELEASE_PARTS`].
    parts: [Vec<Item>; NUM_RELEASE_PARTS],
    /// Mean Jaccard index of the answers to each shared task, over pairs of a joint and a frame.
    jaccards: Vec<f64>,
    verdicts: Vec<Item>,
    /// 1 for each answer that a reviewer accepted unchanged, 0 for each other one that was decided.
    decided: Vec<f64>,
    /// Seconds of work on answers that began from a draft.
    with_draft: Vec<f64>,
    /// Seconds of work on answers whose drafts were withheld.
    without_draft: Vec<f64>,
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
            let frames = frames_of(store, &labels)?;
            for task in tasks {
                self.tasks.remove(task);
            }
            for task in labels.chunk_by(|a, b| a.task == b.task) {
                let said = task.iter().map(|label| said(label, &drafts, &frames));
                let of_task = OfTask {
                    kind: task[0].kind,
                    gold: task[0].gold,
                    said: said.collect(),
                };
                self.tasks.insert(task[0].task, of_task);
            }
        }
        self.seq = seq;
        Ok(!changed.is_empty())
    }

    /// The figures.
    pub(crate) fn figures(&self) -> Figures {
        let mut counted = Counted::default();
        for task in self.tasks.values() {
            counted.add(task);
        }
        Figures {
            agreement: counted.agreement(),
            people: counted
                .people
                .into_iter()
                .map(|(id, person)| (id, person.figures()))
                .collect(),
            secs_by_time: counted.secs_by_time,
            agreed_by_time: counted.agreed_by_time,
        }
    }
}

impl Counted {
    fn add(&mut self, task: &OfTask) {
        for said in &task.said {
            let person = self.people.entry(said.author).or_default();
            person.secs.push(said.secs);
            self.secs_by_time.push((said.at, said.secs));
            person.drafts.extend(&said.drafts);
            if said.blind {
                self.without_draft.push(said.secs);
            } else if !said.drafts.is_empty() {
                self.with_draft.push(said.secs);
            }
            match said.state {
                RevisionState::Accepted => self.decided.push(1.0),
                RevisionState::Returned | RevisionState::Superseded => self.decided.push(0.0),
                RevisionState::Draft | RevisionState::Submitted => {}
            }
        }
        if task.said.len() > 1 && !task.gold {
            self.add_shared(task);
        }
    }

    /// Adds a task with several answers. Each answer has a mean likeness to the others; the agreement on the task is
    /// the mean of these.
    fn add_shared(&mut self, task: &OfTask) {
        let mut each = Vec::new();
        for (index, said) in task.said.iter().enumerate() {
            let others = task.said[..index].iter().chain(&task.said[index + 1..]);
            let alike: Vec<f64> = others.map(|other| said.likeness(other)).collect();
            each.extend(mean(&alike));
            let person = self.people.entry(said.author).or_default();
            person.shared.extend(mean(&alike));
        }
        let last = task.said.iter().map(|said| said.at).max();
        self.agreed_by_time.extend(last.zip(mean(&each)));
        if task.kind == TaskKind::MaskText {
            self.jaccards.extend(mean(&each));
            for (part, items) in self.parts.iter_mut().enumerate() {
                let covers = task.said.iter().map(|said| usize::from(said.covers[part]));
                items.push(covers.collect());
            }
        } else {
            let verdicts = task.said.iter().filter_map(|said| said.verdict);
            self.verdicts.push(verdicts.collect());
        }
    }

    fn agreement(&mut self) -> Agreement {
        let drafts: Vec<f64> = self
            .people
            .values()
            .flat_map(|person| person.drafts.iter().copied())
            .collect();
        let secs = median_secs(&mut self.with_draft).zip(median_secs(&mut self.without_draft));
        Agreement {
            parts: self.agreement_by_part(),
            jaccard: mean_estimate(&self.jaccards),
            verdicts: (!self.verdicts.is_empty())
                .then(|| part_agreement("verdict", &self.verdicts, Verdict::ALL.len())),
            shared_items: self.jaccards.len() + self.verdicts.len(),
            accepted_share: mean_estimate(&self.decided),
            draft_distance: mean(&drafts),
            secs_with_and_without_draft: secs.map(|(with, without)| [with, without]),
        }
    }

    /// Agreement on each part of the release, and on all their decisions together.
    fn agreement_by_part(&self) -> Vec<PartAgreement> {
        let all: Vec<Item> = self.parts.concat();
        let mut decisions: Vec<(&str, &Vec<Item>)> = RELEASE_PARTS
            .iter()
            .map(|part| part.name())
            .zip(&self.parts)
            .collect();
        decisions.push(("overall", &all));
        decisions
            .into_par_iter()
            .map(|(name, items)| part_agreement(name, items, 2))
            .collect()
    }
}

/// Median of some seconds of work, unless they are too few to say anything.
fn median_secs(secs: &mut [f64]) -> Option<f64> {
    quantile::median(secs).filter(|_| secs.len() >= MIN_ITEMS)
}

impl OfPerson {
    fn figures(mut self) -> PersonFigures {
        let is_unchanged = |distance: &f64| f64::from(u8::from(*distance == 0.0));
        let unchanged: Vec<f64> = self.drafts.iter().map(is_unchanged).collect();
        PersonFigures {
            median_secs: quantile::median(&mut self.secs),
            draft_unchanged: mean(&unchanged),
            draft_distance: mean(&self.drafts),
            agreement: mean_estimate(&self.shared),
        }
    }
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

/// Frames of the clips of answers with a range, by their hash. Where no mask has a range, the frames do not matter.
fn frames_of(store: &Store, labels: &[Label]) -> Result<BTreeMap<String, i64>, Error> {
    let ranged: BTreeSet<String> = labels
        .iter()
        .filter(|label| {
            let masks = label.revision.answer.fields().masks;
            masks.iter().any(|mask| mask.range.is_some())
        })
        .map(|label| label.source.clone())
        .collect();
    let motions = store.motions(ranged.into_iter().collect())?;
    Ok(motions
        .into_iter()
        .map(|motion| (motion.hash, motion.frames))
        .collect())
}

fn said(label: &Label, drafts: &BTreeMap<i64, String>, frames: &BTreeMap<String, i64>) -> Said {
    let revision = &label.revision;
    let verdict = revision.answer.verdict();
    let masks = revision.answer.fields().masks.iter();
    let sets: Vec<JointSet> = masks.map(|mask| mask.mask().hard()).collect();
    Said {
        author: revision.author,
        secs: revision.secs,
        at: revision.at,
        blind: label.blind,
        state: revision.state,
        drafts: draft_distances(&revision.answer, drafts),
        verdict: Verdict::ALL
            .iter()
            .position(|known| Some(*known) == verdict),
        covers: RELEASE_PARTS.map(|part| {
            let hard = part.mask().hard();
            sets.iter().any(|set| hard.difference(*set).is_empty())
        }),
        cells: revision
            .answer
            .cells(frames.get(&label.source).copied().unwrap_or(1)),
    }
}

/// Figures kept between visits: answers are read once, and the figures computed anew when answers have changed and the
/// last computation is old enough.
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
        // The lock may have been waited for: whoever held it has just computed them.
        let last = lock(&self.last).clone();
        let figures = match last {
            Some((_, figures)) if !changed => figures,
            _ => Arc::new(gathered.figures()),
        };
        *lock(&self.last) = Some((now, Arc::clone(&figures)));
        Ok(figures)
    }
}
