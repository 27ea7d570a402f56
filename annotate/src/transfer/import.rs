//! Import of tasks from the motions, masks and pairs of a dataset, and of labels from an exported dataset.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use datasets_spec::record::{ExportedLabels, MaskRow, PairRow, range_of};
use datasets_spec::{BlendMask, Dataset, MotionId};
use serde::Serialize;
use tables::Condition;

use super::clips::{Clip, candidates, clips};
use super::keys::{PAIR_SOURCE, mask_key, pair_key, task};
use crate::Error;
use crate::answer::{Fields, check_draft, completion};
use crate::groups::grouped;
use crate::mask::entered;
use crate::store::{Credit, Imported, Millis, MotionRecord, NewSuggestion, NewTask, Store};
use crate::wire::{
    Answer, BUNDLE, Code, EditType, MaskAnswer, SuggestionSource, TaskKind, Verdict,
};

/// Prefix of column `source` for pairs of `stance variants`.
const VARIANT_SOURCE: &str = "variants-";
/// Fact of the manifest of a dataset that `stance variants` made.
const VARIANTS_FACT: &str = "variants";
/// Maximum number of conflicts, and of tasks about other clips, that an import lists by name.
const LISTED_CONFLICTS: usize = 50;

/// Name of a note of the store: an SQL condition that selects the clips for which tasks are created. Without the note,
/// tasks are created for all clips.
pub const CHOSEN: &str = "clips of tasks";

/// Result of an import.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Taken {
    /// Counts by name.
    pub counts: BTreeMap<String, i64>,
    /// Messages about omitted items.
    pub messages: Vec<String>,
}

impl Taken {
    pub(super) fn count(&mut self, what: &str, count: i64) {
        *self.counts.entry(what.to_owned()).or_default() += count;
    }

    /// Counts items to report, if there are any, and adds a message.
    pub(super) fn report(&mut self, what: &str, count: usize, message: impl FnOnce() -> String) {
        if count > 0 {
            self.count(what, count as i64);
            self.messages.push(message());
        }
    }

    /// Adds the counts and conflicts of an import of answers. Conflicts about other clips are also counted apart.
    pub(super) fn take(&mut self, mut done: Imported) {
        done.conflicts.append(&mut done.earlier);
        self.count("new_tasks", done.new);
        self.count("filled_tasks", done.filled);
        self.count("known_tasks", done.known);
        let conflicts = done.conflicts.len() + done.others.len();
        self.count("conflicts", conflicts as i64);
        self.report_others(
            &done.others,
            "the import",
            "what it says of them is left out: import it into another project (`stance annotate DATASET --store \
             FILE`), of a dataset with these pairs",
        );
        let conflicts = done.conflicts.iter().take(LISTED_CONFLICTS);
        self.messages.extend(conflicts.map(|key| {
            format!(
                "task {key:?} has another answer, or somebody is at work on it; the imported answer is left out"
            )
        }));
        let more = done.conflicts.len().saturating_sub(LISTED_CONFLICTS);
        if more > 0 {
            self.messages
                .push(format!("{more} more conflicts are not listed"));
        }
    }

    /// Counts and names the tasks that are about other clips than what `import` has under their keys. `rest` says what
    /// became of that, and what to do.
    fn report_others(&mut self, keys: &[String], import: &str, rest: &str) {
        self.report("tasks_of_other_clips", keys.len(), || {
            let (count, first) = (keys.len(), &keys[..keys.len().min(LISTED_CONFLICTS)]);
            let more = match count - first.len() {
                0 => String::new(),
                more => format!(" and {more} more"),
            };
            format!(
                "{count} tasks of this project are about other clips than {import} has under their keys, as happens \
                 when `stance pairs` runs with another seed; the tasks stay as they are, and {rest}. The keys: \
                 {}{more}",
                first.join(", ")
            )
        });
    }
}

/// Why labels of a motion are refused whose content in the dataset is not the exported one.
pub(super) fn other_content(hash: &str, exported: &str) -> String {
    format!(
        "its content is {hash} in this dataset and {exported} in the export; import them into the dataset that was \
         exported, or ingest the export"
    )
}

/// All motions of a store by their ids.
pub(super) fn known_motions(store: &Store) -> Result<BTreeMap<String, MotionRecord>, Error> {
    let motions = store.all_motions()?.into_iter();
    Ok(motions.map(|motion| (motion.id.clone(), motion)).collect())
}

/// Creates the tasks of a dataset: a mask task for each clip that is neither a mirrored copy nor a variant of another
/// (`stance variants`), a pair task for each fine-grained pair (in bundles of eight), and a style task for each style
/// pair. Masks of the pipeline become suggestions; masks by people and pairs written by this program become accepted
/// answers. Clips of one action are paired as candidates.
///
/// Existing tasks stay unchanged, unless nobody has worked on them: then an accepted answer fills them, or replaces a
/// label that was imported from the dataset. A pair whose id is that of a task about other clips gets no task and no
/// answer, and is reported. Known motions get the id, split,
/// captions, style and action of the dataset, and their tasks the split. If the store has a note [`CHOSEN`] with a
/// condition, new tasks are created only for clips that meet it, and for pairs of such clips.
///
/// # Errors
/// The dataset cannot be read, the condition cannot be evaluated, or the store fails.
pub fn from_dataset(
    store: &Store,
    root: &Path,
    actor: Option<i64>,
    now: Millis,
    progress: &mut dyn FnMut(i64, i64),
) -> Result<Taken, Error> {
    let whole = Dataset::open(root)?;
    let dataset = chosen(store, &whole)?;
    let mut taken = Taken::default();
    let all = clips(&whole)?;
    let known = store.all_motions()?;
    let clips = without_copies(&all, &known, &mut taken);
    let by_id: BTreeMap<&str, &Clip> = clips
        .iter()
        .map(|clip| (clip.record.id.as_str(), *clip))
        .collect();
    compare_with_known(store, &known, &all, &clips, actor, now, &mut taken)?;
    store.put_motions(clips.iter().map(|clip| clip.record.clone()).collect())?;
    taken.count("motions", clips.len() as i64);

    let chosen: Vec<&Clip> = clips
        .iter()
        .copied()
        .filter(|clip| MotionId::parse(&clip.record.id).is_ok_and(|id| dataset.has_clip(&id)))
        .collect();
    taken.count("clips_not_chosen", (clips.len() - chosen.len()) as i64);
    let mut tasks = mask_tasks(&whole, &dataset, &chosen, &mut taken)?;
    let pairs: Vec<PairRow> = dataset.read(None)?;
    tasks.extend(tasks_of_pairs(store, pairs.iter(), &by_id, &mut taken)?);
    let rejected = whole.manifest().rejected_pairs()?;
    let of_table = pairs.iter().map(|pair| (&pair.source_id, &pair.target_id));
    let of_people = rejected
        .values()
        .flatten()
        .map(|[source, target]| (source, target));
    let judged = of_table.chain(of_people);
    let judged = judged
        .map(|(source, target)| (source.as_str(), target.as_str()))
        .collect();
    let takes = candidates(store, &chosen, &judged)?;
    let count: usize = takes.values().map(Vec::len).sum();
    taken.count("candidates", count as i64);
    // Pairs that were made for an instruction come before candidates.
    for (name, list) in takes {
        tasks.extend(bundled(store, &name, list)?);
    }
    for task in tasks.iter_mut().filter(|task| task.accepted.is_some()) {
        let none = || Credit {
            author: None,
            merged: false,
            accepted_by: None,
            of_dataset: true,
        };
        task.credit.get_or_insert_with(none).of_dataset = true;
    }
    let total = tasks.len() as i64;
    let (mut seen, mut others, mut conflicts) = (0, Vec::new(), Vec::new());
    for chunk in tasks.chunks(2000) {
        let done = store.import(actor, chunk.to_vec(), now)?;
        taken.count("new_tasks", done.new);
        taken.count("filled_tasks", done.filled);
        // The dataset may contain an earlier export of this store, whose answers are known.
        taken.count("known_tasks", done.known + done.earlier.len() as i64);
        others.extend(done.others);
        conflicts.extend(done.conflicts);
        seen += chunk.len() as i64;
        progress(seen, total);
    }
    taken.report("conflicts", conflicts.len(), || {
        format!(
            "{} tasks have labels in the dataset that people accepted outside this project, for example {}; the project \
             keeps its own answers, and its exports leave such masks as they are",
            conflicts.len(),
            conflicts[0]
        )
    });
    taken.report_others(
        &others,
        "the dataset",
        "the pairs of the dataset get no task and no answer here: judge them in another project (`stance annotate \
         DATASET --store FILE`)",
    );
    Ok(taken)
}

/// The dataset, restricted to the clips that the note [`CHOSEN`] selects.
fn chosen(store: &Store, dataset: &Dataset) -> Result<Dataset, Error> {
    let Some(text) = store.note(CHOSEN)? else {
        return Ok(dataset.clone());
    };
    let chosen = text
        .parse::<Condition>()
        .and_then(|condition| condition.of(dataset));
    let what = || dataset.root().display().to_string();
    chosen.map_err(|error| Error::import(what(), error.to_string()))
}

/// The clips without those that repeat the motion of another: of a known clip, or of an earlier one.
fn without_copies<'a>(
    clips: &'a [Clip],
    known: &[MotionRecord],
    taken: &mut Taken,
) -> Vec<&'a Clip> {
    let known = known.iter().map(|motion| (&motion.hash, &motion.id));
    let known: BTreeSet<(&String, &String)> = known.collect();
    let names = |clip: &'a Clip| (&clip.record.hash, &clip.record.id);
    let (old, new): (Vec<&Clip>, Vec<&Clip>) =
        clips.iter().partition(|&clip| known.contains(&names(clip)));
    let mut by_hash: BTreeMap<&String, &String> = BTreeMap::new();
    for (hash, id) in old.into_iter().chain(new).map(names) {
        by_hash.entry(hash).or_insert(id);
    }
    let is_first = |clip: &&'a Clip| by_hash.get(&clip.record.hash) == Some(&&clip.record.id);
    let (clips, copies): (Vec<&Clip>, Vec<&Clip>) = clips.iter().partition(is_first);
    taken.report("copies", copies.len(), || {
        format!(
            "{} clips repeat the motion of another clip and get no task, for example {}",
            copies.len(),
            copies[0].record.id
        )
    });
    clips
}

/// Masks by the id of their motion.
fn by_motion(masks: Vec<MaskRow>) -> BTreeMap<String, Vec<MaskRow>> {
    let masks = masks.into_iter();
    grouped(masks.map(|mask| (mask.motion_id.to_string(), mask)))
}

/// Mask tasks of the chosen clips, except mirrored copies and variants. The pairs of the whole dataset tell which clips
/// are variants. A variant with masks by people gets a task, too.
fn mask_tasks(
    whole: &Dataset,
    dataset: &Dataset,
    chosen: &[&Clip],
    taken: &mut Taken,
) -> Result<Vec<NewTask>, Error> {
    let masks = by_motion(dataset.read(None)?);
    let all_pairs: Vec<PairRow> = whole.read(None)?;
    let of_variants = all_pairs
        .iter()
        .filter(|pair| pair.source.starts_with(VARIANT_SOURCE));
    let variants: BTreeSet<&str> = of_variants
        .flat_map(|pair| [pair.source_id.as_str(), pair.target_id.as_str()])
        .collect();
    // A judged pair has another source, and an unusable pair is removed, so the manifest is checked too.
    let are_variants = dataset.manifest().facts.contains_key(VARIANTS_FACT);
    let mut tasks = Vec::new();
    for clip in chosen.iter().filter(|clip| !clip.mirrored) {
        let id = clip.record.id.as_str();
        let rows = masks.get(id).map_or(&[][..], Vec::as_slice);
        let new = mask_task(&clip.record, rows, taken)?;
        if new.accepted.is_none() && (are_variants || variants.contains(id)) {
            taken.count("variants", 1);
        } else {
            tasks.push(new);
        }
    }
    Ok(tasks)
}

/// Tasks of pairs whose motions exist: one for each style pair, and bundles of fine-grained pairs by their hint.
fn tasks_of_pairs<'a>(
    store: &Store,
    pairs: impl Iterator<Item = &'a PairRow>,
    by_id: &BTreeMap<&str, &Clip>,
    taken: &mut Taken,
) -> Result<Vec<NewTask>, Error> {
    let (mut missing, mut unknown_types) = (0, 0);
    let (mut fine, mut tasks) = (BTreeMap::<String, Vec<NewTask>>::new(), Vec::new());
    for pair in pairs {
        let (Some(source), Some(target)) = (
            by_id.get(pair.source_id.as_str()),
            by_id.get(pair.target_id.as_str()),
        ) else {
            missing += 1;
            continue;
        };
        let kind = match pair.kind.as_str() {
            "fine-grained" => TaskKind::Pair,
            "style" => TaskKind::Style,
            _ => {
                taken.count("semantic_pairs", 1);
                continue;
            }
        };
        let mut new = task(pair_key(pair), kind, &source.record);
        new.target = Some(target.record.hash.clone());
        new.style.clone_from(&pair.style);
        new.edit_type = pair.edit_type.as_deref().and_then(EditType::parse);
        unknown_types += usize::from(pair.edit_type.is_some() && new.edit_type.is_none());
        if pair.source == PAIR_SOURCE {
            let said = Fields {
                verdict: Some(Verdict::Keep),
                parts: &pair.parts,
                edit_type: new.edit_type,
                style: pair.style.as_deref(),
                text: &pair.instruction,
                ..Fields::default()
            };
            new.accepted = Some(said.answer(kind));
            new.credit = credit("", false, pair.accepted_by.as_deref());
        } else if !pair.instruction.trim().is_empty() {
            new.hint = Some(pair.instruction.clone());
        }
        match kind {
            TaskKind::Pair => fine
                .entry(new.hint.clone().unwrap_or_default())
                .or_default()
                .push(new),
            TaskKind::Style | TaskKind::MaskText => tasks.push(new),
        }
    }
    taken.report("pairs_without_motion", missing, || {
        format!("{missing} pairs name a missing or repeated motion and get no task")
    });
    taken.report("unknown_edit_types", unknown_types, || {
        let known: Vec<&str> = EditType::ALL.iter().map(|kind| kind.as_str()).collect();
        format!(
            "{unknown_types} pairs have an edit type that is not one of {}; they are taken without it",
            known.join(", ")
        )
    });
    for (name, list) in fine {
        tasks.extend(bundled(store, &name, list)?);
    }
    Ok(tasks)
}

/// Imports the masks and pairs of an exported dataset (`stance export --to stance`) into the tasks of the same motions.
/// Labels made by people become accepted answers of tasks that nobody has worked on; masks by people whose task has
/// another answer are left out and reported, and so are pairs whose task is about other clips, and labels of motions
/// that this dataset lacks.
///
/// # Errors
/// A motion has another content in the dataset than in the export, the dataset cannot be read, or the store fails.
pub fn from_labels(
    store: &Store,
    root: &Path,
    labels: &ExportedLabels,
    actor: Option<i64>,
    now: Millis,
) -> Result<Taken, Error> {
    let mut taken = Taken::default();
    let clips = clips(&Dataset::open(root)?)?;
    let mut by_id: BTreeMap<&str, &Clip> = BTreeMap::new();
    let mut by_hash: BTreeSet<&str> = BTreeSet::new();
    for clip in &clips {
        let (id, hash) = (clip.record.id.as_str(), clip.record.hash.as_str());
        let exported = labels.motions.get(id);
        if let Some(exported) = exported.filter(|hashes| !hashes.contains(hash)) {
            let exported: Vec<&str> = exported.iter().map(String::as_str).collect();
            let what = format!("the labels of motion {id:?}");
            let problem = other_content(hash, &exported.join(" or "));
            return Err(Error::import(what, problem));
        }
        if by_hash.insert(hash) {
            by_id.insert(id, clip);
        }
    }
    let mut tasks = Vec::new();
    for (id, rows) in &by_motion(labels.masks.clone()) {
        match by_id.get(id.as_str()) {
            Some(clip) => {
                let new = mask_task(&clip.record, rows, &mut taken)?;
                // As in the tasks of a dataset, skip mirrored copies: they add nothing to their originals.
                if new.accepted.is_some() || !clip.mirrored {
                    tasks.push(new);
                }
            }
            None => taken.report("masks_without_motion", rows.len(), || {
                format!(
                    "motion {id:?} is missing or repeated in this dataset; its {} masks are left out",
                    rows.len()
                )
            }),
        }
    }
    let split = |id: &MotionId| by_id.get(id.as_str()).map(|clip| &clip.record.split);
    let is_across = |pair: &&PairRow| {
        let sides = split(&pair.source_id).zip(split(&pair.target_id));
        sides.is_some_and(|(source, target)| source != target)
    };
    let (across, pairs): (Vec<&PairRow>, Vec<&PairRow>) = labels.pairs.iter().partition(is_across);
    taken.report("pairs_across_splits", across.len(), || {
        format!(
            "{} pairs have their motions in two splits of this dataset and are left out, such as {:?}",
            across.len(),
            across[0].id
        )
    });
    tasks.extend(tasks_of_pairs(
        store,
        pairs.into_iter(),
        &by_id,
        &mut taken,
    )?);
    taken.take(store.import(actor, tasks, now)?);
    Ok(taken)
}

/// Updates the content of clips that were ingested again under the same id, and reports how many known clips have other
/// labels now, or are not in the dataset. `known` are the clips of the store, `all` those of the dataset, and `clips`
/// those of the dataset without copies.
fn compare_with_known(
    store: &Store,
    known: &[MotionRecord],
    all: &[Clip],
    clips: &[&Clip],
    actor: Option<i64>,
    now: Millis,
    taken: &mut Taken,
) -> Result<(), Error> {
    let hashes = known
        .iter()
        .map(|motion| (motion.id.as_str(), &motion.hash));
    let hashes: BTreeMap<&str, &String> = hashes.collect();
    let motions = clips.iter().map(|clip| &clip.record);
    let (changed, same): (Vec<&MotionRecord>, Vec<&MotionRecord>) = motions.partition(|motion| {
        let known = hashes.get(motion.id.as_str());
        known.is_some_and(|hash| **hash != motion.hash)
    });
    note_corrected(known, &same, taken);
    let replaced: BTreeSet<&str> = changed.iter().map(|motion| motion.id.as_str()).collect();
    if !changed.is_empty() {
        taken.count("changed_motions", changed.len() as i64);
        let changed = changed.into_iter().cloned();
        let tasks = store.replace_motions(actor, changed.collect(), now)?;
        taken.count("changed_tasks", tasks);
        let asked = store.changed_tasks()?.len();
        if asked > 0 {
            taken.messages.push(format!(
                "{asked} tasks have answers about clips that were ingested anew, with other content; `stance annotate \
                 DATASET changed` lists them and takes the decision"
            ));
        }
    }
    // A clip that now repeats another one has lost its content too.
    let contents: BTreeSet<&str> = all.iter().map(|clip| clip.record.hash.as_str()).collect();
    let is_gone = |motion: &&MotionRecord| {
        !contents.contains(motion.hash.as_str()) && !replaced.contains(motion.id.as_str())
    };
    let gone: Vec<&MotionRecord> = known.iter().filter(is_gone).collect();
    taken.report("clips_gone", gone.len(), || {
        format!(
            "{} clips of the project are not in this dataset, for example {}; their tasks and answers stay, and nobody \
             is given these tasks until the clips are back",
            gone.len(),
            gone[0].id
        )
    });
    let gone = gone.iter().map(|motion| motion.hash.clone());
    store.note_gone(actor, gone.collect(), now)
}

/// Counts the clips whose content is as before, but whose id, split, captions, style or action are corrected.
fn note_corrected(known: &[MotionRecord], clips: &[&MotionRecord], taken: &mut Taken) {
    let by_hash = known.iter().map(|motion| (motion.hash.as_str(), motion));
    let by_hash: BTreeMap<&str, &MotionRecord> = by_hash.collect();
    let is_other = |clip: &&&MotionRecord| {
        by_hash.get(clip.hash.as_str()).is_some_and(|known| {
            known.id != clip.id
                || known.split != clip.split
                || known.captions != clip.captions
                || known.style != clip.style
                || known.action != clip.action
        })
    };
    let corrected: Vec<&&MotionRecord> = clips.iter().filter(is_other).collect();
    taken.report("corrected_clips", corrected.len(), || {
        format!(
            "{} clips have another id, split, caption, style or action than at the last import, for example {}; the \
             project shows them as they are in the dataset now",
            corrected.len(),
            corrected[0].id
        )
    });
}

fn mask_task(motion: &MotionRecord, rows: &[MaskRow], taken: &mut Taken) -> Result<NewTask, Error> {
    let mut new = task(mask_key(&motion.id), TaskKind::MaskText, motion);
    let (people, drafts): (Vec<&MaskRow>, Vec<&MaskRow>) =
        rows.iter().partition(|row| row.text_origin == "human");
    if !people.is_empty() {
        let len = usize::try_from(motion.frames).unwrap_or(0);
        let masks = people.iter().map(|row| {
            let joints = (&row.hard_joints[..], &row.soft_joints[..]);
            let range = (row.start, row.end);
            let mask = entered_mask(&row.parts, joints, range, completion(&row.text));
            row.frames(len).and(mask).map_err(|error| {
                let problem = format!("mask {:?} of {}: {error}", row.id, motion.id);
                Error::refused(Code::Invalid, problem)
            })
        });
        let answer = Answer::MaskText {
            masks: masks.collect::<Result<_, _>>()?,
            count_reason: None,
            note: String::new(),
        };
        match check_draft(&answer, TaskKind::MaskText) {
            Ok(()) => {
                new.accepted = Some(answer);
                new.credit = credit(&people[0].author, false, people[0].accepted_by.as_deref());
            }
            Err(problem) => {
                taken.count("labels_refused", 1);
                taken.messages.push(format!(
                    "the masks of {} stay in the dataset and are not shown here: {problem}",
                    motion.id
                ));
            }
        }
    }
    // Suggestions have only parts and a text, so report the ranges.
    let ranged = drafts.iter().filter(|row| row.start.is_some()).count();
    if ranged > 0 {
        taken.count("drafts_of_a_range", ranged as i64);
    }
    let suggestions = drafts.into_iter().map(|row| NewSuggestion {
        source: SuggestionSource::Import,
        parts: row.parts.clone(),
        text: row.text.clone(),
        model: row.author.clone(),
        prompt_hash: String::new(),
        params: String::new(),
        tokens: None,
        response_hash: String::new(),
    });
    new.suggestions = suggestions.collect();
    Ok(new)
}

/// Builds the mask of a table row from its parts, its hard and soft joints, the ends of its range, and its text.
///
/// # Errors
/// A joint is unknown or both hard and soft, or the ends are no range.
pub(super) fn entered_mask(
    parts: &[String],
    (hard, soft): (&[String], &[String]),
    (start, end): (Option<i32>, Option<i32>),
    text: &str,
) -> Result<MaskAnswer, datasets_spec::Error> {
    let (soft, joints) = entered(parts, BlendMask::of_names(hard, soft)?);
    range_of(start, end)?;
    Ok(MaskAnswer {
        soft,
        joints,
        range: start.zip(end).map(|(start, end)| [start, end]),
        ..MaskAnswer::of_parts(parts.to_vec(), text.to_owned())
    })
}

/// Who wrote an imported answer, if the file says so. Names that are not pseudonyms of this program are not carried
/// into exports.
pub(super) fn credit(author: &str, merged: bool, accepted_by: Option<&str>) -> Option<Credit> {
    let is_pseudonym = author.strip_prefix('a').is_some_and(|rest| {
        let (number, store) = rest.split_once('-').unwrap_or((rest, "0"));
        number.len() >= 3
            && number.bytes().all(|byte| byte.is_ascii_digit())
            && store.bytes().all(|byte| byte.is_ascii_hexdigit())
    });
    let is_known = |basis: &&str| matches!(*basis, "review" | "own") || basis.starts_with("rule:");
    let accepted_by = accepted_by.filter(is_known);
    (is_pseudonym || merged || accepted_by.is_some()).then(|| Credit {
        author: is_pseudonym.then(|| author.to_owned()),
        merged,
        accepted_by: accepted_by.map(str::to_owned),
        of_dataset: false,
    })
}

/// Puts the pairs that the project lacks into bundles of eight of the same split. A bundle is named after its first pair,
/// so those of a later import are other ones.
fn bundled(store: &Store, name: &str, mut tasks: Vec<NewTask>) -> Result<Vec<NewTask>, Error> {
    tasks.sort_by(|a, b| (&a.split, &a.key).cmp(&(&b.split, &b.key)));
    let known = store.known_keys(tasks.iter().map(|task| task.key.clone()).collect())?;
    let mut places: BTreeMap<String, (usize, String)> = BTreeMap::new();
    for task in tasks.iter_mut().filter(|task| !known.contains(&task.key)) {
        let (place, first) = places.entry(task.split.clone()).or_default();
        if place.is_multiple_of(BUNDLE) {
            first.clone_from(&task.key);
        }
        task.bundle = Some(format!("{name}|{}|{first}", task.split));
        task.bundle_index = (*place % BUNDLE) as i64;
        *place += 1;
    }
    Ok(tasks)
}
