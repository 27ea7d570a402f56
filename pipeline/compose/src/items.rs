//! Test questions: the fixed items that systems are evaluated on.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::ops::Range;
use std::str::FromStr;
use std::sync::Arc;

use datasets_spec::record::ItemRow;
use datasets_spec::{BlendMask, Motion, MotionId, Rng, Seed, Split};
use rand::RngExt;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::library::{Clip, Subject};
use super::novelty::{Novelty, Shown};
use super::triplet::{Place, Triplet};
use super::{ComposeConfig, Error, ItemTask, Library, blend_motion};

/// Preferred length of an item in windows: the paper edits clips of several segments, and the
/// released demo uses at least three.
const PREFERRED_WINDOWS: usize = 3;
/// Attempts at a new item of a mask or pair before it is skipped.
const MAX_REPEATS: usize = 16;
/// Items that are tried together, on all threads.
const TRIED_AT_ONCE: usize = 256;
/// Digits of the digest of a set.
const DIGEST_DIGITS: usize = 32;

/// How many items are drawn. In text: a number, or `all`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "CountText", into = "CountText")]
pub enum ItemCount {
    /// One item per mask and pair.
    All,
    /// This number of items. Every mask and pair is used once before any is used again.
    Exactly(usize),
}

impl FromStr for ItemCount {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "all" => Ok(Self::All),
            _ => text
                .parse()
                .ok()
                .filter(|count| *count > 0)
                .map(Self::Exactly)
                .ok_or_else(|| format!("{text:?} is neither a positive number nor `all`")),
        }
    }
}

impl fmt::Display for ItemCount {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::All => f.write_str("all"),
            Self::Exactly(count) => count.fmt(f),
        }
    }
}

/// A count in configuration files.
#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum CountText {
    Number(usize),
    Word(String),
}

impl TryFrom<CountText> for ItemCount {
    type Error = String;

    fn try_from(text: CountText) -> Result<Self, String> {
        match text {
            CountText::Number(count) => count.to_string().parse(),
            CountText::Word(word) => word.parse(),
        }
    }
}

impl From<ItemCount> for CountText {
    fn from(count: ItemCount) -> Self {
        match count {
            ItemCount::All => Self::Word("all".to_owned()),
            ItemCount::Exactly(count) => Self::Number(count),
        }
    }
}

/// Selection of items.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ItemConfig {
    /// Number of items.
    pub count: ItemCount,
    /// Tasks of the items; if empty, all tasks with data.
    pub tasks: Vec<ItemTask>,
    /// Novelties of the items, in equal parts; if empty, items of any novelty are drawn in random order.
    pub novelty: Vec<Novelty>,
    /// Number of drawn items to keep: the first ones of each novelty, in equal parts. Not set: all.
    pub part: Option<usize>,
    /// Expected digest of the sorted ids of all drawn items ([`digest_of_ids`]), as of a published set.
    pub digest: Option<String>,
    /// Composition settings; `mcm_ratio` and `annotated_ratio` are ignored.
    pub compose: ComposeConfig,
}

impl Default for ItemCount {
    fn default() -> Self {
        Self::Exactly(128)
    }
}

/// Draws the items that systems are evaluated on. Equal arguments give equal items.
///
/// Every usable mask and pair is a target before any is used again, in an order drawn from the seed. Partners are clips
/// of other actions, where actions are known, and long enough for three windows, if such clips exist. Pairs of
/// MotionFix are used without a donor, each once. All items differ in content: if nothing new can be drawn, fewer items
/// are returned than requested. `shown` holds the contents of the training split, which determine the novelty of items.
///
/// # Errors
/// A setting is out of range, no mask or pair of the tasks can be used, one has no partner, no item is of a requested
/// novelty, or the motions cannot be read.
pub fn draw_items<'a>(
    library: &Arc<Library>,
    config: &ItemConfig,
    shown: &'a Shown,
    seed: Seed,
) -> Result<DrawnItems<'a>, Error> {
    let compose = ComposeConfig {
        mcm_ratio: 1.0,
        annotated_ratio: 1.0,
        ..config.compose.clone()
    };
    compose.check()?;
    let library = Arc::clone(library).aligned(compose.alignment)?;
    let stride = compose.stride(library.fps())?;
    let span = compose.span(stride);
    let (subjects, num_short) = subjects_of(&library, config, span, seed)?;
    let drawer = Drawer {
        base: library.base(&compose, seed, span)?,
        library,
        preferred: span + (PREFERRED_WINDOWS - 1) * compose.advance(stride),
        recipe_hash: compose.recipe_hash(),
        config: compose,
        shown,
        span,
        seed,
    };
    let count = match config.count {
        ItemCount::All => subjects.len(),
        ItemCount::Exactly(count) => count,
    };
    let questions = drawer.draw(&subjects, Quota::of(&config.novelty, count))?;
    if questions.is_empty() {
        return Err(none_drawn(drawer.library.split(), config));
    }
    let found = digest_of_ids(questions.iter().map(|question| question.id.as_str()));
    let num_drawn = questions.len();
    if let Some(expected) = &config.digest
        && *expected != found
    {
        return Err(Error::Refused(format!(
            "{num_drawn} items were drawn whose ids come to {found}, and those of the set come to {expected}: the \
             dataset is not that of the set, or another version of the program made one of them"
        )));
    }
    let of_novelty = config.novelty.iter().map(|&novelty| {
        let is_of = |question: &&Question| question.novelty == Some(novelty);
        (novelty, questions.iter().filter(is_of).count())
    });
    let of_novelty = of_novelty.collect();
    let questions = match config.part {
        Some(part) => Quota::of(&config.novelty, part).first(questions),
        None => questions,
    };
    Ok(DrawnItems {
        drawer,
        questions,
        num_drawn,
        of_novelty,
        num_short,
    })
}

fn none_drawn(split: Split, config: &ItemConfig) -> Error {
    let novelties: Vec<&str> = config
        .novelty
        .iter()
        .map(|novelty| novelty.as_str())
        .collect();
    let tasks: Vec<&str> = config.tasks.iter().map(|task| task.as_str()).collect();
    let of_task = match tasks.is_empty() {
        true => String::new(),
        false => format!("of task {} and ", tasks.join(", ")),
    };
    Error::Refused(format!(
        "split {split} gives no item {of_task}of novelty {}; ask for others",
        novelties.join(", ")
    ))
}

/// The usable masks and pairs of the requested tasks, each with its draw, by which they are ordered, and the number of
/// those that are shorter than a window.
fn subjects_of(
    library: &Library,
    config: &ItemConfig,
    span: usize,
    seed: Seed,
) -> Result<(Vec<(u64, Subject)>, usize), Error> {
    let split = library.split();
    let is_wanted = |task: ItemTask| config.tasks.is_empty() || config.tasks.contains(&task);
    let mut wanted = library
        .all_subjects()
        .filter(|subject| is_wanted(library.task_of(*subject)))
        .peekable();
    if wanted.peek().is_none() {
        let tasks = ItemTask::ALL.into_iter().filter(|task| is_wanted(*task));
        let tasks = tasks.map(|task| format!("{task} ({})", task.made_by()));
        let tasks = tasks.collect::<Vec<_>>().join(", ");
        return Err(Error::Refused(format!(
            "split {split} has no mask or pair for items of task {tasks}"
        )));
    }
    let (usable, short): (Vec<Subject>, Vec<Subject>) = wanted
        .filter(|subject| {
            library.is_asked_as_is(*subject)
                || config.compose.kinds.contains(&library.edit(*subject).kind)
        })
        .partition(|subject| {
            library.is_asked_as_is(*subject) || library.frames_of(*subject) >= span
        });
    let mut subjects: Vec<(u64, Subject)> = usable
        .into_iter()
        .map(|subject| {
            let id = &library.edit(subject).id;
            (seed.draw_u64(&["evaluation order", id]), subject)
        })
        .collect();
    if subjects.is_empty() {
        let frames = span;
        return Err(Error::NoItem { split, frames });
    }
    subjects.sort_unstable_by_key(|(order, _)| *order);
    Ok((subjects, short.len()))
}

/// Drawn items without their motions, which are made when rows are asked for.
pub struct DrawnItems<'a> {
    drawer: Drawer<'a>,
    questions: Vec<Question>,
    /// Number of items that were drawn, of which [`ItemConfig::part`] are kept.
    pub num_drawn: usize,
    /// Number of drawn items of each requested novelty.
    pub of_novelty: BTreeMap<Novelty, usize>,
    /// Number of masks and pairs of the wanted tasks and kinds that are shorter than a window, and are no question.
    pub num_short: usize,
}

impl DrawnItems<'_> {
    /// Number of items.
    pub fn len(&self) -> usize {
        self.questions.len()
    }

    /// Whether there is no item.
    pub fn is_empty(&self) -> bool {
        self.questions.is_empty()
    }

    /// Some of the items, with their motions. Equal ranges give equal rows.
    ///
    /// # Errors
    /// The motions cannot be read.
    ///
    /// # Panics
    /// If the range ends after the last item.
    pub fn rows(&self, range: Range<usize>) -> Result<Vec<ItemRow>, Error> {
        let questions = self.questions[range].par_iter();
        let row = |question: &Question| {
            let draws = question.draws.clone();
            self.drawer.row(question.subject, question.novelty, draws)
        };
        questions.map(row).collect()
    }
}

/// An item without its motions, and the draws that make them.
struct Question {
    subject: Subject,
    draws: Draws,
    novelty: Option<Novelty>,
    id: String,
}

/// Identity of a set of items: BLAKE3 of their sorted ids, each with a line end, as 32 hexadecimal digits.
pub fn digest_of_ids<'a>(ids: impl Iterator<Item = &'a str>) -> String {
    let mut ids: Vec<&str> = ids.collect();
    ids.sort_unstable();
    let mut hasher = blake3::Hasher::new();
    for id in ids {
        hasher.update(id.as_bytes());
        hasher.update(b"\n");
    }
    let mut digest = hasher.finalize().to_hex().to_string();
    digest.truncate(DIGEST_DIGITS);
    digest
}

struct Quota {
    /// Items still to draw, of any novelty.
    left: usize,
    /// Items still to draw of each requested novelty; `None` if any novelty is allowed.
    of_each: Option<BTreeMap<Novelty, usize>>,
}

impl Quota {
    /// Divides `count` items into equal parts; the remainder goes to the first novelties.
    fn of(novelty: &[Novelty], count: usize) -> Self {
        let asked: BTreeSet<Novelty> = novelty.iter().copied().collect();
        let (each, over) = match asked.len() {
            0 => (0, 0),
            values => (count / values, count % values),
        };
        let values = asked.iter().enumerate();
        let of_each = values.map(|(place, value)| (*value, each + usize::from(place < over)));
        Self {
            left: count,
            of_each: (!asked.is_empty()).then(|| of_each.collect()),
        }
    }

    fn is_wanted(&self, novelty: Option<Novelty>) -> bool {
        let of_value = |of_each: &BTreeMap<Novelty, usize>| {
            novelty.is_some_and(|novelty| of_each.get(&novelty).is_some_and(|left| *left > 0))
        };
        self.left > 0 && self.of_each.as_ref().is_none_or(of_value)
    }

    fn take(&mut self, novelty: Option<Novelty>) {
        self.left -= 1;
        let of_each = self.of_each.as_mut();
        if let Some(left) = of_each
            .zip(novelty)
            .and_then(|(all, novelty)| all.get_mut(&novelty))
        {
            *left -= 1;
        }
    }

    /// Keeps the first items within the quota.
    fn first(mut self, mut questions: Vec<Question>) -> Vec<Question> {
        questions.retain(|question| {
            let is_wanted = self.is_wanted(question.novelty);
            if is_wanted {
                self.take(question.novelty);
            }
            is_wanted
        });
        questions
    }
}

enum Attempt {
    Drawn(Question),
    /// A question whose novelty has no quota left.
    Unwanted,
    /// The subject has no further questions.
    Exhausted,
}

/// The partner of an item, and the state of its other draws.
#[derive(Clone)]
struct Draws {
    /// Names the draws of the item.
    id: String,
    /// Index of the clip that a mask edits, or that a pair is blended with; `None` for a pair that takes none.
    partner: Option<usize>,
    /// Generator of the other draws.
    rng: Rng,
}

struct Drawer<'a> {
    library: Arc<Library>,
    config: ComposeConfig,
    /// Contents of the training split.
    shown: &'a Shown,
    /// Indices of the clips partners are drawn from.
    base: Vec<usize>,
    /// Stored frames of a window.
    span: usize,
    /// Stored frames a partner should have.
    preferred: usize,
    recipe_hash: String,
    seed: Seed,
}

impl Drawer<'_> {
    /// Draws from the subjects in rounds until all items are drawn, or a round gives no new item.
    fn draw(&self, subjects: &[(u64, Subject)], mut wanted: Quota) -> Result<Vec<Question>, Error> {
        let mut questions = Vec::new();
        let mut seen = BTreeSet::new();
        for round in 0.. {
            let before = questions.len();
            let mut left = subjects;
            while !left.is_empty() {
                if wanted.left == 0 {
                    return Ok(questions);
                }
                let (now, after) = left.split_at(left.len().min(wanted.left).min(TRIED_AT_ONCE));
                left = after;
                // A question that is unwanted before this block stays so, because quotas only shrink.
                let first =
                    |&(_, subject): &(u64, Subject)| self.attempt(subject, round, 0, &wanted);
                let firsts: Vec<_> = now.par_iter().map(first).collect();
                for (&(_, subject), mut found) in now.iter().zip(firsts) {
                    if wanted.left == 0 {
                        break;
                    }
                    for next in 1..=MAX_REPEATS {
                        match found? {
                            Attempt::Drawn(question)
                                if wanted.is_wanted(question.novelty)
                                    && seen.insert(question.id.clone()) =>
                            {
                                wanted.take(question.novelty);
                                questions.push(question);
                                break;
                            }
                            Attempt::Exhausted => break,
                            Attempt::Drawn(_) | Attempt::Unwanted => {}
                        }
                        if next == MAX_REPEATS {
                            break;
                        }
                        found = self.attempt(subject, round, next, &wanted);
                    }
                }
            }
            if questions.len() == before {
                break;
            }
        }
        Ok(questions)
    }

    fn attempt(
        &self,
        subject: Subject,
        round: usize,
        attempt: usize,
        wanted: &Quota,
    ) -> Result<Attempt, Error> {
        let library = &self.library;
        if library.is_asked_as_is(subject) && (round > 0 || attempt > 0) {
            return Ok(Attempt::Exhausted);
        }
        let draws = self.draws(subject, round, attempt)?;
        let novelty = self.novelty(subject, draws.partner);
        if !wanted.is_wanted(novelty) {
            return Ok(Attempt::Unwanted);
        }
        let id = self.row(subject, novelty, draws.clone())?.id;
        Ok(Attempt::Drawn(Question {
            subject,
            draws,
            novelty,
            id,
        }))
    }

    /// Novelty of an item of this subject. The partner of a mask is the source of the item; that of a pair does not matter.
    fn novelty(&self, subject: Subject, partner: Option<usize>) -> Option<Novelty> {
        let library = &self.library;
        let [before, after] = library
            .captured_of(subject)
            .map(|clip| &library.clip(clip).id);
        let (source, pair) = match subject {
            Subject::Annotation(_) => {
                let source = partner.expect("a semantic edit has a source");
                (&library.clip(source).id, None)
            }
            Subject::Pair(_) => (before, Some(library.edit(subject).kind)),
        };
        let text = &library.edit(subject).instruction;
        self.shown.novelty([source, after], text, pair)
    }

    /// Draws the partner of an item.
    fn draws(&self, subject: Subject, round: usize, attempt: usize) -> Result<Draws, Error> {
        let library = &self.library;
        let round = round.to_string();
        let attempt = (attempt > 0).then(|| attempt.to_string());
        let mut parts = vec!["evaluation item", &library.edit(subject).id, &round];
        parts.extend(attempt.as_deref());
        let mut rng = self.seed.rng(&parts);
        let partners = match library.is_asked_as_is(subject) {
            true => None,
            false => Some(library.partners(&self.base, subject, self.preferred)),
        };
        let partner = match partners {
            Some(partners) if !partners.is_empty() => {
                Some(partners[rng.random_range(0..partners.len())])
            }
            Some(_) if library.takes_partner(subject, &self.config) => {
                return Err(library.no_partner(subject));
            }
            _ => None,
        };
        Ok(Draws {
            id: parts.join("/"),
            partner,
            rng,
        })
    }

    /// Makes the motions of an item.
    fn row(
        &self,
        subject: Subject,
        novelty: Option<Novelty>,
        draws: Draws,
    ) -> Result<ItemRow, Error> {
        let mut row = match self.library.is_asked_as_is(subject) {
            true => self.as_is(subject)?,
            false => self.composed(subject, draws)?,
        };
        row.novelty = novelty.map(|novelty| novelty.as_str().to_owned());
        row.id = row.content_id();
        Ok(row)
    }

    fn composed(&self, subject: Subject, mut draws: Draws) -> Result<ItemRow, Error> {
        let (library, config) = (&self.library, &self.config);
        let pairing = library.paired(draws.partner, subject, config, &mut draws.rng);
        let triplet = library.compose(
            Place {
                id: draws.id,
                seed: self.seed,
                epoch: 0,
                recipe_hash: self.recipe_hash.clone(),
                instruction: library.first_wording(&pairing, config),
            },
            &pairing,
            config,
        )?;
        let other = self.other_take(&triplet)?;
        let parts = match pairing.half {
            Some(half) => vec![half.name().to_owned()],
            None => library.edit(subject).parts.to_vec(),
        };
        let mut row = ItemRow {
            parts,
            ..self.blank(subject, &triplet.instruction)
        };
        row.source_id = triplet.source_id.clone();
        row.target_id = triplet.target_id.clone();
        row.donor_ids = triplet.donor_ids.iter().map(MotionId::to_string).collect();
        row.hard_joints = triplet.mask.hard().names();
        row.soft_joints = triplet.mask.soft().names();
        [row.edit_start, row.edit_end] = triplet.edit_bounds();
        row.alpha = triplet.alpha as f32;
        row.recipe_hash.clone_from(&self.recipe_hash);
        row.set_motions(&triplet.original, Some(&triplet.edited), other.as_ref());
        Ok(row)
    }

    /// The item of a pair without a donor.
    fn as_is(&self, subject: Subject) -> Result<ItemRow, Error> {
        let library = &self.library;
        let [source, target] = library.captured_of(subject).map(|clip| library.clip(clip));
        let mut row = ItemRow {
            parts: library.edit(subject).parts.to_vec(),
            ..self.blank(subject, &library.edit(subject).instruction)
        };
        row.source_id = source.id.clone();
        row.target_id = target.id.clone();
        row.set_motions(&source.motion()?, Some(&target.motion()?), None);
        Ok(row)
    }

    fn blank(&self, subject: Subject, instruction: &str) -> ItemRow {
        let library = &self.library;
        let target = &library.clip(library.edit(subject).target).id;
        let made_of = match subject {
            Subject::Annotation(_) => "mask",
            Subject::Pair(_) => "pair",
        };
        ItemRow {
            task: library.task_of(subject).as_str().to_owned(),
            instruction: instruction.to_owned(),
            origin: format!("{made_of} {}", library.edit(subject).id),
            seed: self.seed.0,
            ..ItemRow::blank(target, library.split())
        }
    }

    /// The edited motion of an item, made with another capture of the same action in the same style, whose captions name
    /// the same sides and turns, by the same performer if there is one: an upper bound for editors. `None` without such
    /// a capture at least as long as a window or the item, and for an edit of a part of the clip.
    fn other_take(&self, item: &Triplet) -> Result<Option<Motion>, Error> {
        let library = &self.library;
        // The frames of a mask show another moment in another take.
        if item.edited_frames != (0..item.original.len()) {
            return Ok(None);
        }
        let target = library.captured(&item.target_id);
        let mut takes: Vec<&Clip> = library
            .other_takes(target)
            .filter(|clip| clip.id != item.source_id)
            .filter(|clip| clip.len() >= self.span.min(item.original.len()))
            .filter(|clip| self.shown.have_equal_sides([&clip.id, &target.id]))
            .collect();
        let is_own = |clip: &&Clip| self.shown.have_one_performer([&clip.id, &target.id]);
        if takes.iter().any(is_own) {
            takes.retain(is_own);
        }
        let Some(longest) = takes.iter().map(|clip| clip.len()).max() else {
            return Ok(None);
        };
        // Draw one of the takes that cover most of the edit.
        let frames = longest.min(item.original.len());
        let takes: Vec<&Clip> = takes
            .into_iter()
            .filter(|clip| clip.len() >= frames)
            .collect();
        let mut rng = self.seed.rng(&["other take", &item.id]);
        let take = takes[rng.random_range(0..takes.len())];
        let start = item.target_start.min(take.len() - frames);
        let over = take.crop(start..start + frames)?;
        if item.mask == BlendMask::EMPTY {
            return Ok(Some(over));
        }
        let under = match item.donor_ids.first() {
            Some(donor) => {
                let donor = library.captured(donor);
                donor.crop(item.donor_start..item.donor_start + frames)?
            }
            None => {
                let original = item.original.crop(0..frames);
                original.expect("as long as the take or longer")
            }
        };
        Ok(Some(blend_motion(
            &under,
            &over,
            item.mask,
            item.alpha,
            self.config.slerp,
        )?))
    }
}

#[cfg(test)]
mod tests;
