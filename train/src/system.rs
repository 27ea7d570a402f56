//! The interface of editing systems, which turn an item into an edited motion. Commands use systems only through
//! [`EditSystem`].

mod remarks;

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt::Display;
use std::ops::Range;
use std::path::{Path, PathBuf};

use compose::{keep_outside, leaves_frames};
use datasets_spec::manifest::plan_hash;
use datasets_spec::record::{EditRow, ItemRow};
use datasets_spec::table::Row;
use datasets_spec::{Dataset, Fps, JointSet, Motion, Seed};
use serde::{Deserialize, Serialize};
use work::{check_room, commit_edits};

use crate::checkpoint::Slot;
use crate::config::{ensure, finite, not_negative};
use crate::error::motion_error;
use crate::sample::{EditTimes, FitMethod, TimedInstruction, check_ranges};
use crate::text::source::TextEncoderSource;
use crate::{Error, Session};

pub use self::remarks::Remarks;

/// An editing system, ready to edit motions on one skeleton.
pub trait EditSystem: Send {
    /// Name, weights and settings, as recorded in rows of edits.
    fn identity(&self) -> &SystemIdentity;

    /// Frame rate of the motions that the system generates.
    fn fps(&self) -> Fps;

    /// Weight of the text guidance.
    fn guidance(&self) -> f64;

    /// Warnings about requested edits, given the motions (number of frames and frame rate) and the instructions.
    fn remarks(&self, motions: &[(usize, Fps)], texts: &[&str]) -> Remarks;

    /// Prepares the system for the given instructions. Must be called before [`EditSystem::edit`].
    ///
    /// # Errors
    /// The text encoder is missing or cannot encode a text.
    fn prepare(&mut self, texts: &[String], session: &Session<'_>) -> Result<(), Error>;

    /// Edits motions. Returns one motion per request, with its deviation from the generated points, and the times of
    /// the stages. A motion has the length of its original or the requested one. It depends on the seed and its
    /// request, not on the other requests.
    ///
    /// # Errors
    /// A request is malformed, a generated motion is not finite, or the session is stopped.
    fn edit(
        &self,
        requests: &[EditRequest<'_>],
        seed: Seed,
        session: &Session<'_>,
    ) -> Result<(Vec<(Motion, Misfit)>, EditTimes), Error>;
}

/// A motion to edit.
#[derive(Clone, Debug)]
pub struct EditRequest<'a> {
    /// Id of the request. Together with the seed it determines the noise.
    pub id: &'a str,
    /// The motion, at any frame rate.
    pub motion: &'a Motion,
    /// Instructions for frames of the motion.
    pub instructions: &'a [TimedInstruction],
    /// Frame rate of the edit.
    pub fps: Fps,
    /// Joints that the edit should change; empty if not known. Systems that use only the instruction ignore them.
    pub joints: JointSet,
    /// Requested number of frames of the edit, if known. Systems that generate windows one after another keep the
    /// length of the motion.
    pub frames: Option<usize>,
}

/// Deviation of generated points from a body with constant bone lengths.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Misfit {
    /// Mean distance in metres between the points and the fitted body.
    pub fit_error_m: f32,
    /// Mean difference in metres between the points' bone lengths and the body's.
    pub bone_drift_m: f32,
}

/// Identity of a system in rows of edits: name, weights and settings.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SystemIdentity {
    /// Name of the system in tables.
    pub name: String,
    /// Hash of the weights: BLAKE3, hexadecimal.
    pub checkpoint_hash: String,
    /// Settings of the system as a JSON object; rows of edits also store its hash.
    pub settings: String,
}

impl SystemIdentity {
    /// Name and weights, by which a folder of edits knows its system.
    pub(crate) fn made_by(&self) -> [&str; 2] {
        [&self.name, &self.checkpoint_hash]
    }

    /// Hash of the settings: BLAKE3, hexadecimal; empty if they are not known.
    pub fn settings_hash(&self) -> String {
        if self.settings.is_empty() {
            return String::new();
        }
        blake3::hash(self.settings.as_bytes()).to_hex().to_string()
    }

    /// Makes the row of an edit.
    pub fn row(&self, item: &ItemRow, motion: &Motion, misfit: Misfit, seed: Seed) -> EditRow {
        EditRow {
            system: self.name.clone(),
            checkpoint_hash: self.checkpoint_hash.clone(),
            settings_hash: self.settings_hash(),
            settings: self.settings.clone(),
            seed: seed.0,
            fit_error_m: Some(misfit.fit_error_m),
            bone_drift_m: Some(misfit.bone_drift_m),
            ..EditRow::answering(item, motion)
        }
    }
}

/// Name of a system, followed by the settings that differ from those usual for its preset, such as `MotionReFit tiny
/// (guidance 3)`. So two systems with different settings never share a name. `settings` gives one text for each setting
/// ([`changed`]), or none if it is as usual.
pub(crate) fn named_with(
    name: String,
    slot: Slot,
    settings: impl IntoIterator<Item = Option<String>>,
) -> String {
    let checkpoint = (slot != Slot::Best).then(|| format!("checkpoint {}", slot.name()));
    let changed: Vec<String> = [checkpoint].into_iter().chain(settings).flatten().collect();
    match changed.as_slice() {
        [] => name,
        _ => format!("{name} ({})", changed.join(", ")),
    }
}

/// A setting and its value, if that is not the usual one.
pub(crate) fn changed<T: PartialEq + Display>(what: &str, used: T, usual: T) -> Option<String> {
    (used != usual).then(|| format!("{what} {used}"))
}

/// Folders and files from which a system is loaded.
#[derive(Clone, Debug)]
pub struct SystemSource {
    /// Run folder of the editing model.
    pub run: PathBuf,
    /// Checkpoint of the run.
    pub slot: Slot,
    /// Run folder of the coordinator.
    pub coordinator: Option<PathBuf>,
    /// Run folder of the pose network that provides the bone twists.
    pub poses: Option<PathBuf>,
    /// Source of the frozen text encoder, if the model uses one.
    pub text_encoder: TextEncoderSource,
}

impl SystemSource {
    /// The best checkpoint of a run, without coordinator and pose network.
    pub fn best(run: &Path, text_encoder: TextEncoderSource) -> Self {
        Self {
            run: run.to_owned(),
            slot: Slot::Best,
            coordinator: None,
            poses: None,
            text_encoder,
        }
    }

    /// The inputs that differ from the best checkpoint alone, by their options of `stance edit`.
    pub(crate) fn given(&self) -> impl Iterator<Item = (&'static str, EditInput)> {
        use EditInput::{Checkpoint, Coordinator, Poses};
        given([
            ("--checkpoint", Checkpoint, self.slot != Slot::Best),
            ("--coordinator", Coordinator, self.coordinator.is_some()),
            ("--poses", Poses, self.poses.is_some()),
        ])
    }
}

/// An input of an edit that not every model uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EditInput {
    /// Checkpoint of the run.
    Checkpoint,
    /// Number of windows generated at a time.
    Batch,
    /// Weight of the text guidance.
    Guidance,
    /// Factor of the noise.
    Temperature,
    /// Coordinator and its guidance.
    Coordinator,
    /// Pose network.
    Poses,
    /// Fit of SMPL-X parameters.
    Fit,
    /// Weight of the guidance by the source.
    SourceGuidance,
    /// Number of diffusion steps.
    Steps,
    /// Start from the source instead of noise.
    FromSource,
    /// Diffusion step at which MDM-BP starts, and number of its last steps that keep no body part.
    Inpainting,
}

fn given<const N: usize>(
    inputs: [(&'static str, EditInput, bool); N],
) -> impl Iterator<Item = (&'static str, EditInput)> {
    let given = inputs.into_iter().filter(|(.., is_given)| *is_given);
    given.map(|(name, input, _)| (name, input))
}

/// Section `[edit]` of a plan: settings with which items are edited.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EditConfig {
    /// Name of the system in tables; by default it is made from the settings.
    pub name: Option<String>,
    /// Number of edits of each item, each with its own sampling seed.
    pub takes: u64,
    /// Guidance weight of the text; `None` for that of the system's settings.
    pub guidance: Option<f64>,
    /// Guidance weight of the source, for systems that have one; `None` for that of the system's settings.
    pub source_guidance: Option<f64>,
    /// Number of diffusion steps, for systems that can use fewer than in training; `None` for that of the system's
    /// settings.
    pub steps: Option<usize>,
    /// Whether an edit starts from the source instead of noise, for systems that can do both.
    pub from_source: bool,
    /// Factor of the noise; `None` for that of the system's settings.
    pub temperature: Option<f64>,
    /// Maximum number of windows generated at a time.
    pub max_batch: usize,
    /// Method of fitting SMPL-X parameters.
    pub fit: FitMethod,
    /// Weight in m^2/rad^2 that draws the rotations of the exact fit towards their initial values; `None` for 0.01 with
    /// a pose network and 0 without.
    pub prior: Option<f64>,
    /// Strength of the coordinator's guidance; `None` for that of the editor's settings.
    pub coordinator_strength: Option<f64>,
    /// Number of last steps that the coordinator guides; `None` for that of the editor's settings.
    pub coordinator_steps: Option<usize>,
    /// Diffusion step whose noise MDM-BP adds to the source at the start; `None` for the noisiest step.
    pub start: Option<usize>,
    /// Number of last diffusion steps in which MDM-BP keeps no body part; `None` for 20 of 1,000.
    pub release: Option<usize>,
}

impl Default for EditConfig {
    fn default() -> Self {
        Self {
            name: None,
            takes: 1,
            guidance: None,
            source_guidance: None,
            steps: None,
            from_source: false,
            temperature: None,
            max_batch: 64,
            fit: FitMethod::Exact,
            prior: None,
            coordinator_strength: None,
            coordinator_steps: None,
            start: None,
            release: None,
        }
    }
}

impl EditConfig {
    /// Refuses settings with which no motion can be made, and a prior that the fit would ignore.
    ///
    /// # Errors
    /// A number is not finite; the temperature or the prior is negative; or the fit makes no use of the prior.
    pub fn check(&self) -> Result<(), Error> {
        for (field, value) in [
            ("guidance", self.guidance),
            ("source_guidance", self.source_guidance),
            ("coordinator_strength", self.coordinator_strength),
        ] {
            value.map_or(Ok(()), |value| finite(field, value))?;
        }
        for (field, value) in [("temperature", self.temperature), ("prior", self.prior)] {
            value.map_or(Ok(()), |value| not_negative(field, value))?;
        }
        let is_used = self.prior.is_none() || self.fit == FitMethod::Exact;
        ensure(is_used, "prior", "the paper's fit has none")
    }

    /// The inputs that differ from the default, by their options of `stance edit`.
    pub fn given(&self) -> impl Iterator<Item = (&'static str, EditInput)> {
        use EditInput::{
            Batch, Coordinator, Fit, FromSource, Guidance, Inpainting, SourceGuidance, Steps,
            Temperature,
        };
        let usual = Self::default();
        // Listed one by one, so that a new setting cannot be forgotten. Every system has a name and takes.
        let Self {
            name: _,
            takes: _,
            guidance,
            source_guidance: source,
            steps,
            from_source,
            temperature,
            max_batch,
            fit,
            prior,
            coordinator_strength: strength,
            coordinator_steps: guided,
            start,
            release,
        } = self;
        given([
            ("--guidance", Guidance, guidance.is_some()),
            ("--source-guidance", SourceGuidance, source.is_some()),
            ("--diffusion-steps (edit.steps)", Steps, steps.is_some()),
            ("--from-source", FromSource, *from_source),
            ("--temperature", Temperature, temperature.is_some()),
            ("--max-batch", Batch, *max_batch != usual.max_batch),
            ("--fit", Fit, *fit != usual.fit),
            ("--prior", Fit, prior.is_some()),
            ("--coordinator-strength", Coordinator, strength.is_some()),
            ("--coordinator-steps", Coordinator, guided.is_some()),
            ("--start", Inpainting, start.is_some()),
            ("--release", Inpainting, release.is_some()),
        ])
    }
}

/// Generates the results of requests in batches of requests with equal keys, so that no result depends on padding.
/// `generate` gets the places of a batch's requests, and returns their results. The batches are counted in `times`.
pub(crate) fn in_groups<K: Ord, T>(
    keys: Vec<K>,
    max_batch: usize,
    times: &mut EditTimes,
    session: &Session<'_>,
    mut generate: impl FnMut(&[usize]) -> Result<Vec<T>, Error>,
) -> Result<Vec<T>, Error> {
    let (begun, count) = (session.secs(), keys.len());
    session.progress.begin("edit", Some(count as u64));
    let mut groups: BTreeMap<K, Vec<usize>> = BTreeMap::new();
    for (place, key) in keys.into_iter().enumerate() {
        groups.entry(key).or_default().push(place);
    }
    let mut made = Vec::with_capacity(count);
    for places in groups.values() {
        for batch in places.chunks(max_batch.max(1)) {
            session.go_on("editing")?;
            made.extend(batch.iter().copied().zip(generate(batch)?));
            times.num_windows += batch.len();
            times.num_batches += 1;
            session.progress.advance(batch.len() as u64);
        }
    }
    made.sort_by_key(|(place, _)| *place);
    times.diffusion_secs = session.secs() - begun;
    session.progress.finish(&format!("{count} motions edited"));
    Ok(made.into_iter().map(|(_, result)| result).collect())
}

/// One instruction for all frames of a motion.
pub fn whole(text: &str, motion: &Motion) -> TimedInstruction {
    TimedInstruction {
        frames: 0..motion.len(),
        text: text.to_owned(),
    }
}

/// Edits the source of every item. The rows have the frame rate of the sources. They have the sources' length too,
/// unless the system generates edits as long as the targets.
///
/// # Errors
/// As [`EditSystem::edit`].
pub fn edit_items(
    system: &dyn EditSystem,
    items: &[ItemRow],
    seed: Seed,
    session: &Session<'_>,
) -> Result<(Vec<EditRow>, EditTimes), Error> {
    let sources: Vec<(Motion, [TimedInstruction; 1])> = items
        .iter()
        .map(|item| {
            let source = item.source().map_err(motion_error(&item.id))?;
            let instruction = TimedInstruction {
                frames: item.edited_frames()?,
                text: item.instruction.clone(),
            };
            Ok((source, [instruction]))
        })
        .collect::<Result<_, Error>>()?;
    let requests: Vec<EditRequest<'_>> = items
        .iter()
        .zip(&sources)
        .map(|(item, (motion, instructions))| {
            Ok(EditRequest {
                id: &item.id,
                motion,
                instructions,
                fps: motion.fps(),
                joints: item.edited_joints()?,
                frames: usize::try_from(item.target_frames)
                    .ok()
                    .filter(|&frames| frames > 0),
            })
        })
        .collect::<Result<_, Error>>()?;
    let (edited, times) = system.edit(&requests, seed, session)?;
    let rows = items
        .iter()
        .zip(&requests)
        .zip(&edited)
        .map(|((item, request), (motion, misfit))| {
            let motion = kept_outside(request, motion)?;
            Ok(system.identity().row(item, &motion, *misfit, seed))
        })
        .collect::<Result<_, Error>>()?;
    Ok((rows, times))
}

fn ranges_of(instructions: &[TimedInstruction]) -> Vec<Range<usize>> {
    let asked = instructions.iter();
    asked.map(|asked| asked.frames.clone()).collect()
}

/// The generated motion, with the original's frames outside all instructions.
fn kept_outside<'a>(request: &EditRequest<'_>, made: &'a Motion) -> Result<Cow<'a, Motion>, Error> {
    let ranges = ranges_of(request.instructions);
    if !leaves_frames(request.motion.len(), &ranges) {
        return Ok(Cow::Borrowed(made));
    }
    let kept = keep_outside(request.motion, made, &ranges);
    kept.map(Cow::Owned).map_err(motion_error(request.id))
}

/// Result of editing one motion.
#[derive(Clone, Debug, PartialEq)]
pub struct Edited {
    /// The motion, as long in time as the original. If some frames are kept, it has the frame rate of the original;
    /// otherwise 20 fps, or the model's rate if that is higher.
    pub motion: Motion,
    /// Deviation of the motion from the generated points.
    pub misfit: Misfit,
    /// Times of the stages.
    pub times: EditTimes,
}

/// Edits a motion of any frame rate with instructions for parts of it or for the whole. Frames without an instruction
/// are bit-identical to the original. At each end of an edited range, 0.4 s (or a third of the range, if that is
/// shorter) are blended with the original, and the range ends at the position and heading of the original.
///
/// # Errors
/// The motion has no frame, a range is empty or ends after the motion, earlier instructions cover all frames of an
/// instruction, the generated motion is not finite, or the fit needs a pose network that the editor lacks.
pub fn edit_motion(
    system: &dyn EditSystem,
    id: &str,
    motion: &Motion,
    instructions: &[TimedInstruction],
    seed: Seed,
    session: &Session<'_>,
) -> Result<Edited, Error> {
    check_ranges(motion, instructions).map_err(|problem| Error::item(id, problem))?;
    let ranges = ranges_of(instructions);
    let fps = if leaves_frames(motion.len(), &ranges) {
        motion.fps()
    } else if system.fps() > Fps::STORE {
        system.fps()
    } else {
        Fps::STORE
    };
    let request = EditRequest {
        id,
        motion,
        instructions,
        fps,
        joints: JointSet::EMPTY,
        frames: None,
    };
    let (mut edited, times) = system.edit(std::slice::from_ref(&request), seed, session)?;
    let (made, misfit) = edited
        .pop()
        .expect("a system returns a motion for each request");
    Ok(Edited {
        motion: kept_outside(&request, &made)?.into_owned(),
        misfit,
        times,
    })
}

/// Edits a motion several times in sequence: each edit is the original of the next. Layers after the first apply to all
/// frames, because an edit may have another frame rate than its original.
///
/// # Errors
/// As [`edit_motion`], or there is no layer.
pub fn edit_layers(
    system: &dyn EditSystem,
    id: &str,
    motion: &Motion,
    layers: &[Vec<TimedInstruction>],
    seed: Seed,
    session: &Session<'_>,
) -> Result<Edited, Error> {
    let mut times = EditTimes::default();
    let mut edited: Option<Edited> = None;
    for (number, layer) in layers.iter().enumerate() {
        let made = match &edited {
            // The first layer draws the same noise as a single edit.
            None => edit_motion(system, id, motion, layer, seed, session)?,
            Some(Edited { motion, .. }) => {
                let layer: Vec<TimedInstruction> = layer
                    .iter()
                    .map(|asked| whole(&asked.text, motion))
                    .collect();
                let id = format!("{id} layer {number}");
                edit_motion(system, &id, motion, &layer, seed, session)?
            }
        };
        times += made.times;
        edited = Some(made);
    }
    match edited {
        Some(edited) => Ok(Edited { times, ..edited }),
        None => Err(Error::item(id, "has no instruction")),
    }
}

/// Result of [`answer_items`].
#[derive(Debug)]
pub struct Answers {
    /// The dataset with items and edits.
    pub dataset: Dataset,
    /// Times of the stages; `None` if the edits existed already.
    pub times: Option<EditTimes>,
    /// Warnings about the edits.
    pub remarks: Remarks,
    /// Number of edits that the folder held and that an older version keeps: they were made in another way.
    pub replaced: u64,
}

/// Warnings about edits of the items.
///
/// # Errors
/// An item has an invalid frame rate.
pub fn remarks_of(system: &dyn EditSystem, items: &[ItemRow]) -> Result<Remarks, Error> {
    let motions = items
        .iter()
        .map(|item| {
            let frames = usize::try_from(item.source_frames).unwrap_or(0);
            Ok((frames, Fps::new(f64::from(item.fps))?))
        })
        .collect::<Result<Vec<_>, datasets_spec::Error>>()?;
    let texts: Vec<&str> = items.iter().map(|item| item.instruction.as_str()).collect();
    Ok(system.remarks(&motions, &texts))
}

/// Hash of everything that determines the edits of items.
pub(crate) fn edits_plan(
    items: &[ItemRow],
    identity: &SystemIdentity,
    seed: Seed,
    takes: u64,
) -> String {
    // The table of edits repeats the items, with columns that their ids do not cover.
    let columns = |row: &'_ ItemRow| {
        let (origin, novelty) = (row.origin.clone(), row.novelty.clone());
        (
            row.id.clone(),
            origin,
            novelty,
            row.seed,
            row.recipe_hash.clone(),
        )
    };
    let items: Vec<_> = items.iter().map(columns).collect();
    let inputs = (
        items,
        &identity.checkpoint_hash,
        &identity.name,
        &identity.settings,
        seed,
        takes,
    );
    // The number is raised when the content of the table changes.
    plan_hash("edits-6", &inputs)
}

/// Edits the items of a folder and commits items and edits as a separate dataset. Take `n` of `takes` is sampled with
/// `seed + n`. A table made by the same plan is kept.
///
/// # Errors
/// As [`EditSystem::edit`], or a folder cannot be read or written.
pub fn answer_items(
    system: &mut dyn EditSystem,
    items: &Dataset,
    out: &Path,
    takes: u64,
    seed: Seed,
    holder: &str,
    session: &Session<'_>,
) -> Result<Answers, Error> {
    let rows = items.items()?;
    let remarks = remarks_of(system, &rows)?;
    let plan = edits_plan(&rows, system.identity(), seed, takes);
    let mut replaced = 0;
    if let Some(held) = Dataset::held_in(out)? {
        if held.manifest().plan(EditRow::TABLE) == plan {
            return Ok(Answers {
                dataset: Dataset::open(out)?,
                times: None,
                remarks,
                replaced: 0,
            });
        }
        check_room(&held, &rows, Some(system.identity().made_by()))?;
        replaced = held.manifest().rows(EditRow::TABLE, None);
    }
    let texts: Vec<String> = rows.iter().map(|item| item.instruction.clone()).collect();
    system.prepare(&texts, session)?;
    let mut times = EditTimes::default();
    let mut edits = Vec::new();
    for take in 0..takes.max(1) {
        let seed = Seed(seed.0.wrapping_add(take));
        let (made, spent) = edit_items(system, &rows, seed, session)?;
        edits.extend(made);
        times += spent;
    }
    let dataset = commit_edits(out, &rows, &edits, &items.skeleton()?, &plan, holder)?;
    Ok(Answers {
        dataset,
        times: Some(times),
        remarks,
        replaced,
    })
}

#[cfg(test)]
mod tests;
