//! From motions to numbers: latents of every motion, and the metrics of single motions.

use datasets_spec::{JointSet, Motion, Progress};
use kinematics::KeypointFrame;
use rayon::prelude::*;

use super::test_set::{Side, TestSet};
use crate::Error;
use crate::evaluators::Evaluators;
use crate::linalg::Matrix;
use crate::metric::foot_score::MIN_FRAMES;
use crate::metric::motion_quality::Windows;
use crate::metric::retrieval::unit_rows;
use crate::metric::{self, Latents, Measure, Metric, MotionSample, motion_quality};
use crate::names::{IDENTITY, REAL_DATA};
use crate::protocol::Protocol;

/// Motions decoded and encoded together: a full batch of the encoder, and little memory.
const MOTIONS_PER_CALL: usize = 256;

/// A test set as numbers.
pub(crate) struct Measured<'a> {
    pub(crate) sources: Take,
    /// The real data, the identity editor and all systems.
    pub(crate) systems: Vec<System<'a>>,
    /// The targets of other captures, for the items that have one.
    pub(super) floor: Option<Take>,
}

/// The takes of one system.
pub(crate) struct System<'a> {
    pub(crate) name: &'a str,
    pub(crate) takes: Vec<Take>,
}

impl System<'_> {
    /// The system on some of the items.
    pub(crate) fn select(&self, indices: &[usize]) -> Self {
        Self {
            name: self.name,
            takes: self.takes.iter().map(|take| take.select(indices)).collect(),
        }
    }
}

/// One motion for each item, as numbers.
#[derive(Clone)]
pub(crate) struct Take {
    pub(crate) latents: Latents,
    /// Values of the metrics of single motions; NaN where a motion has none.
    pub(super) of_items: Vec<(&'static Metric, Vec<f64>)>,
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
}

/// Encodes and measures the originals and all systems.
pub(crate) fn measured<'a>(
    test_set: &TestSet<'a>,
    evaluators: Evaluators<'_>,
    protocol: &Protocol,
    progress: &dyn Progress,
) -> Result<Measured<'a>, Error> {
    let measuring = Measuring {
        evaluators,
        protocol,
        progress,
        windows: test_set.windows(),
    };
    progress.begin("encode", Some(test_set.num_motions() as u64));
    let targets: Vec<Side<'_>> = test_set.sides(Side::Target);
    let sources: Vec<Side<'_>> = test_set.sides(Side::Source);
    let cut = protocol.truncate_to_target;
    let measured_sources = measuring.take(&sources, &targets, false)?;
    let mut systems = vec![
        System {
            name: REAL_DATA,
            takes: vec![measuring.take(&targets, &targets, false)?],
        },
        System {
            name: IDENTITY,
            takes: vec![if cut {
                measuring.take(&sources, &targets, true)?
            } else {
                measured_sources.clone()
            }],
        },
    ];
    for (&name, takes) in &test_set.systems {
        let takes = takes
            .iter()
            .map(|rows| {
                let rows: Vec<Side<'_>> = rows.iter().map(|row| Side::Edit(row)).collect();
                measuring.take(&rows, &targets, cut)
            })
            .collect::<Result<Vec<_>, Error>>()?;
        systems.push(System { name, takes });
    }
    let floor = match test_set.recaptured() {
        indices if indices.is_empty() => None,
        indices => {
            let side = |side: fn(_) -> Side<'a>| -> Vec<Side<'a>> {
                indices.iter().map(|&i| side(test_set.items[i])).collect()
            };
            Some(measuring.take(&side(Side::OtherTake), &side(Side::Target), cut)?)
        }
    };
    progress.finish(&format!(
        "{} items, {} rows",
        test_set.items.len(),
        systems.len()
    ));
    Ok(Measured {
        sources: measured_sources,
        systems,
        floor,
    })
}

struct Measuring<'a> {
    evaluators: Evaluators<'a>,
    protocol: &'a Protocol,
    progress: &'a dyn Progress,
    /// Windows whose seams are measured in motions that record none: those of the first system.
    windows: Option<Windows>,
}

impl Measuring<'_> {
    /// Measures one motion for each item; `cut` crops it to the length of its target first. Motions
    /// are decoded a batch at a time, so memory does not grow with the number of systems.
    fn take(&self, rows: &[Side<'_>], targets: &[Side<'_>], cut: bool) -> Result<Take, Error> {
        let metrics: Vec<_> = metric::ALL
            .iter()
            .filter_map(|metric| match metric.measure {
                Measure::Motion(value) => Some((*metric, value)),
                Measure::Set(_) | Measure::Takes(_) | Measure::Rank(..) => None,
            })
            .collect();
        let mut latents = Vec::with_capacity(rows.len());
        let mut of_items: Vec<(&Metric, Vec<f64>)> = metrics
            .iter()
            .map(|(metric, _)| (*metric, Vec::with_capacity(rows.len())))
            .collect();
        for (rows, targets) in rows
            .chunks(MOTIONS_PER_CALL)
            .zip(targets.chunks(MOTIONS_PER_CALL))
        {
            let skeleton = self.evaluators.skeleton;
            let decoded = rows
                .par_iter()
                .zip(targets)
                .map(|(row, asked)| {
                    let (motion, target) = decoded(*row, *asked, cut)?;
                    let points = |motion| skeleton.motion_keypoints(motion).points;
                    let (keypoints, target) = (points(&motion), points(&target));
                    Ok(Decoded {
                        motion,
                        keypoints,
                        target,
                        edited: asked.edited_joints()?,
                    })
                })
                .collect::<Result<Vec<_>, Error>>()?;
            // The networks stay on this thread: they need not be shareable.
            let motions: Vec<&Motion> = decoded.iter().map(|decoded| &decoded.motion).collect();
            latents.extend(self.encode(rows, &motions, latents.first().map(Vec::len))?);
            let composed = self.classify(rows, &motions)?;
            let (protocol, first_windows) = (self.protocol, self.windows);
            let values: Vec<Vec<f64>> = (0..rows.len())
                .into_par_iter()
                .map(|index| {
                    let Decoded {
                        motion,
                        keypoints,
                        target,
                        edited,
                    } = &decoded[index];
                    let windows = rows[index].windows().or(first_windows);
                    let seams = windows.map_or_else(Vec::new, |windows| {
                        motion_quality::seams(motion.len(), motion.fps(), windows)
                    });
                    let sample = MotionSample {
                        motion,
                        keypoints,
                        target,
                        edited: *edited,
                        seams: &seams,
                        edit: rows[index].edit(),
                        composed: composed.as_ref().map(|shares| shares[index]),
                        protocol,
                    };
                    let values = metrics.iter().map(|(_, value)| value(&sample));
                    values.map(|value| value.unwrap_or(f64::NAN)).collect()
                })
                .collect();
            for values in values {
                for ((_, of_metric), value) in of_items.iter_mut().zip(values) {
                    of_metric.push(value);
                }
            }
            self.progress.advance(rows.len() as u64);
        }
        let raw = Matrix::from_rows(&latents);
        let unit = unit_rows(&raw)?;
        Ok(Take {
            latents: Latents { raw, unit },
            of_items,
        })
    }

    /// Share of each motion's windows classified as composed, where there is a classifier.
    fn classify(&self, rows: &[Side<'_>], motions: &[&Motion]) -> Result<Option<Vec<f64>>, Error> {
        let Some(classifier) = self.evaluators.classifier else {
            return Ok(None);
        };
        let shares = classifier.composed(motions);
        shares.map(Some).map_err(|source| Error::Encoder {
            system: rows[0].system().to_owned(),
            source,
        })
    }

    /// Encodes motions and checks that the latents are points with a direction.
    fn encode(
        &self,
        rows: &[Side<'_>],
        motions: &[&Motion],
        width: Option<usize>,
    ) -> Result<Vec<Vec<f64>>, Error> {
        let system = || rows[0].system().to_owned();
        let encoder = self.evaluators.encoder;
        let latents = encoder.encode(motions).map_err(|source| Error::Encoder {
            system: system(),
            source,
        })?;
        if latents.len() != motions.len() {
            return Err(Error::LatentCount {
                system: system(),
                found: latents.len(),
                expected: motions.len(),
            });
        }
        let width = width.unwrap_or_else(|| latents[0].len());
        for (row, latent) in rows.iter().zip(&latents) {
            let problem = if latent.len() != width {
                "has another width than the others"
            } else if !latent.iter().all(|value| value.is_finite()) {
                "is not finite"
            } else if latent.iter().all(|&value| value == 0.0) {
                "is zero, so it has no direction to compare"
            } else {
                continue;
            };
            return Err(Error::Latent {
                system: row.system().to_owned(),
                id: row.id().to_owned(),
                problem,
            });
        }
        Ok(latents)
    }
}

/// A motion with its keypoints, those of its target, and the joints that its item asks to change.
struct Decoded {
    motion: Motion,
    keypoints: Vec<KeypointFrame>,
    target: Vec<KeypointFrame>,
    edited: JointSet,
}

/// A motion and its target, at one rate and long enough to be measured.
fn decoded(row: Side<'_>, target: Side<'_>, cut: bool) -> Result<(Motion, Motion), Error> {
    let mut motion = row.motion()?;
    let target = target.motion()?;
    let (system, id) = (row.system(), row.id());
    if motion.fps() != target.fps() {
        return Err(Error::FrameRate {
            system: system.to_owned(),
            id: id.to_owned(),
            found: motion.fps().get(),
            expected: target.fps().get(),
        });
    }
    if cut && motion.len() > target.len() {
        motion = motion
            .crop(0..target.len())
            .map_err(|source| row.not_a_motion(source.into()))?;
    }
    if motion.len() < MIN_FRAMES {
        return Err(Error::TooShort {
            system: system.to_owned(),
            id: id.to_owned(),
            frames: motion.len(),
            needed: MIN_FRAMES,
        });
    }
    Ok((motion, target))
}
