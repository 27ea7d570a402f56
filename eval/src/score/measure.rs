//! Measures motions: the latents of every motion, and the metrics of single motions. Motions are read in chunks and
//! dropped after they are measured.

use std::borrow::Cow;
use std::ops::Range;

use datasets_spec::record::{EditRow, ItemRow};
use datasets_spec::{Fps, JointSet, Motion, Progress, Skeleton};
use rayon::prelude::*;

use super::test_set::{TestSet, windows_of};
use crate::Error;
use crate::answered::ITEMS_AT_ONCE;
use crate::evaluators::Evaluators;
use crate::linalg::Matrix;
use crate::metric::foot_score::MIN_FRAMES;
use crate::metric::gliding::{swing, way};
use crate::metric::motion_quality::{self, Windows};
use crate::metric::position_error::{distances, from_start, held};
use crate::metric::retrieval::unit_rows;
use crate::metric::{self, Latents, Measure, Metric, MotionMeasure, MotionSample, Target};
use crate::names::{IDENTITY, REAL_DATA};
use crate::protocol::Protocol;
use crate::rows::EditFacts;

/// Measurements of a test set.
pub(crate) struct Measured<'a> {
    pub(crate) sources: Take,
    /// The real data, the identity editor and all systems.
    pub(crate) systems: Vec<System<'a>>,
    /// Measurements of the targets from other captures, for the items that have one.
    pub(super) floor: Option<Take>,
    /// Hash of the classifier, if there is one.
    pub(super) classifier: Option<String>,
}

/// The takes of one system.
pub(crate) struct System<'a> {
    pub(crate) name: &'a str,
    pub(crate) takes: Vec<Take>,
}

impl System<'_> {
    /// The system restricted to some items.
    pub(crate) fn select(&self, indices: &[usize]) -> Self {
        Self {
            name: self.name,
            takes: self.takes.iter().map(|take| take.select(indices)).collect(),
        }
    }

    /// The take that is scored in a repeat.
    pub(super) fn take(&self, repeat: usize) -> &Take {
        &self.takes[repeat % self.takes.len()]
    }
}

/// Measurements of one motion for each item.
#[derive(Clone)]
pub(crate) struct Take {
    pub(crate) latents: Latents,
    /// Values of the metrics of single motions; NaN if a motion has none.
    of_items: Vec<(&'static Metric, Vec<f64>)>,
}

impl Take {
    pub(crate) fn select(&self, indices: &[usize]) -> Self {
        let of_items = self.of_items.iter().map(|(metric, values)| {
            let picked = indices.iter().map(|&index| values[index]).collect();
            (*metric, picked)
        });
        Self {
            latents: self.latents.select(indices),
            of_items: of_items.collect(),
        }
    }

    /// Values of a metric of single motions.
    pub(super) fn values(&self, of: &Metric) -> &[f64] {
        let found = self.of_items.iter().find(|(metric, _)| *metric == of);
        found.map_or(&[][..], |(_, values)| values.as_slice())
    }
}

/// Encodes and measures the originals and all systems. Each item is read once, and the reference data of its motions is
/// computed once for all systems.
pub(crate) fn measured<'a>(
    test_set: &TestSet<'a>,
    evaluators: Evaluators<'_>,
    protocol: &Protocol,
    progress: &dyn Progress,
) -> Result<Measured<'a>, Error> {
    let measuring = Measuring::new(test_set, evaluators, protocol, progress);
    progress.begin("encode", Some(test_set.num_motions() as u64));
    let cut = protocol.truncate_to_target;
    let [mut sources, mut targets, mut cut_sources, mut others] =
        [(); 4].map(|()| measuring.begin());
    let takes_of = |takes: &Vec<Vec<usize>>| takes.iter().map(|_| measuring.begin()).collect();
    let mut systems: Vec<Vec<Gathered>> = test_set.systems.values().map(takes_of).collect();
    let mut recaptured: Vec<Asked<'_>> = Vec::new();
    let all: Vec<usize> = (0..test_set.items.len()).collect();
    for indices in all.chunks(ITEMS_AT_ONCE) {
        let asked = measuring.asked(test_set, indices)?;
        let given_sources = || given("source", &asked, |asked| &asked.source);
        measuring.add(given_sources(), false, &mut sources)?;
        let given_targets = given("target", &asked, |asked| &asked.target);
        measuring.add(given_targets, false, &mut targets)?;
        if cut {
            measuring.add(given_sources(), true, &mut cut_sources)?;
        }
        for (takes, gathered) in test_set.systems.values().zip(&mut systems) {
            for (take, gathered) in takes.iter().zip(gathered) {
                let edits = edits(test_set, take, indices, &asked)?;
                measuring.add(edits, cut, gathered)?;
            }
        }
        recaptured.extend(asked.into_iter().filter(|asked| asked.other.is_some()));
        while recaptured.len() >= ITEMS_AT_ONCE {
            let asked: Vec<Asked<'_>> = recaptured.drain(..ITEMS_AT_ONCE).collect();
            measuring.add(other_takes(&asked), cut, &mut others)?;
        }
    }
    if !recaptured.is_empty() {
        measuring.add(other_takes(&recaptured), cut, &mut others)?;
    }
    let sources = measuring.take(sources)?;
    let identity = match cut {
        true => measuring.take(cut_sources)?,
        false => sources.clone(),
    };
    let targets = measuring.take(targets)?;
    let reference = [(REAL_DATA, vec![targets]), (IDENTITY, vec![identity])];
    let mut found = Vec::from(reference.map(|(name, takes)| System { name, takes }));
    for (&name, takes) in test_set.systems.keys().zip(systems) {
        let takes = takes.into_iter().map(|take| measuring.take(take));
        let takes = takes.collect::<Result<Vec<_>, Error>>()?;
        found.push(System { name, takes });
    }
    let floor = match others.width {
        Some(_) => Some(measuring.take(others)?),
        None => None,
    };
    progress.finish(&format!("{} items, {} rows", all.len(), found.len()));
    Ok(Measured {
        sources,
        systems: found,
        floor,
        classifier: evaluators.classifier.map(|classifier| classifier.hash()),
    })
}

/// An item with its motions, and the reference data that all of them are compared with.
struct Asked<'a> {
    id: &'a str,
    source: Motion,
    target: Motion,
    /// The target made of another capture.
    other: Option<Motion>,
    /// Joints that the item asks to change.
    edited: JointSet,
    /// Frames of the source that the item asks to change.
    frames: Range<usize>,
    of_target: Target,
}

impl<'a> Asked<'a> {
    fn new(id: &'a str, row: &ItemRow, skeleton: &Skeleton) -> Result<Self, datasets_spec::Error> {
        let target = row.target()?;
        let points = skeleton.motion_keypoints(&target).points;
        Ok(Self {
            id,
            source: row.source()?,
            other: row.other_take()?,
            edited: row.edited_joints()?,
            frames: row.edited_frames()?,
            of_target: Target {
                from_start: from_start(&points),
                foot_slide: motion_quality::foot_slide(&points, target.fps()),
                way_m: way(&points),
                swing_m: swing(&points),
            },
            target,
        })
    }
}

/// A motion that is measured.
struct Subject<'a> {
    /// Name of the system in errors.
    system: &'a str,
    asked: &'a Asked<'a>,
    motion: Cow<'a, Motion>,
    /// The edit; `None` if the motion is a source or target.
    edit: Option<&'a EditFacts>,
}

/// One motion of each item, such as all sources.
fn given<'a>(
    system: &'a str,
    asked: &'a [Asked<'a>],
    motion: impl Fn(&'a Asked<'a>) -> &'a Motion,
) -> Vec<Subject<'a>> {
    let subject = |asked: &'a Asked<'a>| Subject {
        system,
        asked,
        motion: Cow::Borrowed(motion(asked)),
        edit: None,
    };
    asked.iter().map(subject).collect()
}

/// The targets made from other captures.
fn other_takes<'a>(asked: &'a [Asked<'a>]) -> Vec<Subject<'a>> {
    given("other take", asked, |asked| {
        asked.other.as_ref().unwrap_or(&asked.target)
    })
}

/// Reads the edits of one take for the items at positions `indices`.
fn edits<'a>(
    test_set: &TestSet<'a>,
    take: &[usize],
    indices: &[usize],
    asked: &'a [Asked<'a>],
) -> Result<Vec<Subject<'a>>, Error> {
    let edits = &test_set.answered.edits;
    let positions: Vec<usize> = indices.iter().map(|&index| take[index]).collect();
    let rows = edits.rows(&positions)?;
    let motions: Vec<_> = rows.par_iter().map(EditRow::motion).collect();
    let facts = positions.iter().map(|&position| &edits.facts()[position]);
    facts
        .zip(motions)
        .zip(asked)
        .map(|((edit, motion), asked)| {
            let motion = motion.map_err(|source| not_a_motion(&edit.system, asked.id, source))?;
            Ok(Subject {
                system: &edit.system,
                asked,
                motion: Cow::Owned(motion),
                edit: Some(edit),
            })
        })
        .collect()
}

fn not_a_motion(system: &str, id: &str, source: datasets_spec::Error) -> Error {
    Error::Motion(system.to_owned(), id.to_owned(), Box::new(source))
}

impl Subject<'_> {
    /// Checks that the motion has the frame rate of its target and enough frames. If `cut` is set, the motion is first
    /// truncated to the target's length.
    fn checked(mut self, cut: bool) -> Result<Self, Error> {
        let (system, id) = (self.system, self.asked.id);
        let target = &self.asked.target;
        let refused =
            |problem: String| Error::Invalid(format!("system {system:?}, item {id:?}: {problem}"));
        let [found, expected] = [self.motion.fps(), target.fps()].map(Fps::get);
        if found != expected {
            return Err(refused(format!(
                "{found} fps, but its target runs at {expected} fps; resample before scoring"
            )));
        }
        if cut && self.motion.len() > target.len() {
            let cropped = self.motion.crop(0..target.len());
            let cropped = cropped.map_err(|source| not_a_motion(system, id, source.into()))?;
            self.motion = Cow::Owned(cropped);
        }
        if self.motion.len() < MIN_FRAMES {
            return Err(refused(format!(
                "{} frames are too few for the foot score, which needs {MIN_FRAMES}",
                self.motion.len()
            )));
        }
        Ok(self)
    }
}

/// A partially measured take.
struct Gathered {
    /// Latents, concatenated.
    latents: Vec<f64>,
    /// Width of the latents, once the first one is known.
    width: Option<usize>,
    /// Values by metric.
    of_items: Vec<Vec<f64>>,
}

/// Shared inputs of the metrics of single motions.
struct OfMotions<'a> {
    skeleton: &'a Skeleton,
    protocol: &'a Protocol,
    /// Windows used to find the seams of motions that record none, such as real data: those of the systems that record
    /// windows; `None` if these differ.
    windows: Option<Windows>,
    metrics: Vec<(&'static Metric, MotionMeasure)>,
}

impl OfMotions<'_> {
    /// The value of each metric; NaN if the motion has none.
    fn values(&self, subject: &Subject<'_>, composed: Option<f64>) -> Vec<f64> {
        let (asked, motion, edit) = (subject.asked, &subject.motion, subject.edit);
        let fps = motion.fps();
        let keypoints = self.skeleton.motion_keypoints(motion).points;
        let found = from_start(&keypoints);
        // An edit has the length of its source; the frames that a shorter one lacks are scored as its last pose.
        let found = match edit {
            Some(_) => held(found, asked.source.len()),
            None => found,
        };
        let distances = distances(&found, &asked.of_target.from_start);
        let windows = edit.and_then(windows_of).or(self.windows);
        let seams = windows.map_or_else(Vec::new, |windows| {
            motion_quality::seams(motion.len(), asked.frames.clone(), fps, windows)
        });
        let sample = MotionSample {
            motion,
            keypoints: &keypoints,
            target: &asked.of_target,
            distances: &distances,
            acceleration: motion_quality::seam_acceleration(&keypoints, fps, &seams),
            edited: asked.edited,
            edit,
            composed,
            protocol: self.protocol,
        };
        let values = self.metrics.iter().map(|(_, value)| value(&sample));
        values.map(|value| value.unwrap_or(f64::NAN)).collect()
    }
}

struct Measuring<'a> {
    evaluators: Evaluators<'a>,
    progress: &'a dyn Progress,
    of_motions: OfMotions<'a>,
}

impl<'a> Measuring<'a> {
    fn new(
        test_set: &TestSet<'_>,
        evaluators: Evaluators<'a>,
        protocol: &'a Protocol,
        progress: &'a dyn Progress,
    ) -> Self {
        let metrics = metric::ALL
            .iter()
            .filter_map(|metric| match metric.measure {
                Measure::Motion(value) => Some((*metric, value)),
                Measure::Set(..) | Measure::Takes(_) | Measure::Rank(..) => None,
            });
        Self {
            evaluators,
            progress,
            of_motions: OfMotions {
                skeleton: evaluators.skeleton,
                protocol,
                windows: test_set.windows(),
                metrics: metrics.collect(),
            },
        }
    }

    /// An empty take.
    fn begin(&self) -> Gathered {
        Gathered {
            latents: Vec::new(),
            width: None,
            of_items: vec![Vec::new(); self.of_motions.metrics.len()],
        }
    }

    /// Reads items, checks each against its id, and measures its target.
    fn asked<'i>(
        &self,
        test_set: &TestSet<'i>,
        indices: &[usize],
    ) -> Result<Vec<Asked<'i>>, Error> {
        let positions: Vec<usize> = indices.iter().map(|&index| test_set.items[index]).collect();
        let rows = test_set.answered.items_at(&positions)?;
        let skeleton = self.of_motions.skeleton;
        rows.into_par_iter()
            .zip(indices)
            .map(|(row, &index)| {
                let id = test_set.item(index).id.as_str();
                let asked = Asked::new(id, &row, skeleton);
                asked.map_err(|source| Error::Item(id.to_owned(), Box::new(source)))
            })
            .collect()
    }

    /// Measures one motion of each item. If `cut` is set, motions are first truncated to the length of their targets.
    fn add(&self, subjects: Vec<Subject<'_>>, cut: bool, into: &mut Gathered) -> Result<(), Error> {
        let subjects = subjects.into_iter().map(|subject| subject.checked(cut));
        let subjects = subjects.collect::<Result<Vec<_>, Error>>()?;
        // The networks are called on this thread only, so they need not be `Sync`.
        let motions: Vec<&Motion> = subjects.iter().map(|subject| &*subject.motion).collect();
        let latents = self.encode(&subjects, &motions, into.width)?;
        let composed = self.classify(&subjects, &motions)?;
        let of_motions = &self.of_motions;
        let values: Vec<Vec<f64>> = subjects
            .par_iter()
            .enumerate()
            .map(|(index, subject)| {
                let composed = composed.as_ref().and_then(|shares| shares[index]);
                of_motions.values(subject, composed)
            })
            .collect();
        into.width = latents.first().map(Vec::len);
        into.latents.extend(latents.into_iter().flatten());
        for values in values {
            for (of_metric, value) in into.of_items.iter_mut().zip(values) {
                of_metric.push(value);
            }
        }
        self.progress.advance(subjects.len() as u64);
        Ok(())
    }

    /// Builds the take after all its motions are measured.
    fn take(&self, gathered: Gathered) -> Result<Take, Error> {
        let width = gathered.width.unwrap_or(1);
        let raw = Matrix::new(gathered.latents.len() / width, width, gathered.latents);
        let unit = unit_rows(&raw)?;
        let metrics = self.of_motions.metrics.iter().map(|(metric, _)| *metric);
        Ok(Take {
            latents: Latents { raw, unit },
            of_items: metrics.zip(gathered.of_items).collect(),
        })
    }

    /// Share of each motion's windows classified as composed, if it has any; `None` without a classifier.
    fn classify(
        &self,
        subjects: &[Subject<'_>],
        motions: &[&Motion],
    ) -> Result<Option<Vec<Option<f64>>>, Error> {
        let Some(classifier) = self.evaluators.classifier else {
            return Ok(None);
        };
        let shares = classifier.composed(motions).map(Some);
        shares.map_err(|source| Error::Encoder(subjects[0].system.to_owned(), source))
    }

    /// Encodes motions and checks that the latents are finite and have a nonzero length.
    fn encode(
        &self,
        subjects: &[Subject<'_>],
        motions: &[&Motion],
        width: Option<usize>,
    ) -> Result<Vec<Vec<f64>>, Error> {
        let system = subjects[0].system;
        let encoder = self.evaluators.encoder;
        let latents = encoder.encode(motions);
        let latents = latents.map_err(|source| Error::Encoder(system.to_owned(), source))?;
        if latents.len() != motions.len() {
            return Err(Error::Invalid(format!(
                "the encoder returned {} latents for {} motions of system {system:?}",
                latents.len(),
                motions.len()
            )));
        }
        let width = width.unwrap_or_else(|| latents[0].len());
        for (subject, latent) in subjects.iter().zip(&latents) {
            let problem = if latent.len() != width {
                "has another width than the others"
            } else if !latent.iter().all(|value| value.is_finite()) {
                "is not finite"
            } else if latent.iter().all(|&value| value == 0.0) {
                "is zero, so it has no direction to compare"
            } else {
                continue;
            };
            return Err(Error::Invalid(format!(
                "system {:?}, item {:?}: the latent {problem}",
                subject.system, subject.asked.id
            )));
        }
        Ok(latents)
    }
}
