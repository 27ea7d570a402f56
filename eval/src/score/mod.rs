//! Scores edited motions: computes rows of the table of scores.

mod measure;
mod resample;
mod test_set;
#[cfg(test)]
mod tests;
mod trainings;
mod values;

use datasets_spec::Progress;
use datasets_spec::record::ScoreRow;
use rayon::prelude::*;

use crate::Error;
use crate::answered::Answered;
use crate::compare::{Comparison, Pairing};
use crate::evaluators::{Evaluators, MotionEncoder};
use crate::judge::TOLD_APART;
use crate::metric::diversity::noise_of_resample;
use crate::metric::interval::{Interval, MIN_TARGETS, mean_of_known};
use crate::metric::retrieval::E2T_RECALL_1;
use crate::metric::{self, CLAIMS, Draws, Measure, Metric, RankSummary};
use crate::names::{GIVEN, IDENTITY, NOISE_FLOOR, RECAPTURED};
use crate::protocol::{Protocol, SET_RESAMPLES, Spread};
use crate::table::Items;

use measure::Measured;
use values::{Galleries, Ranks, of_items};

pub(crate) use measure::{System, measured};
pub(crate) use resample::{Resamples, drawn};
pub(crate) use test_set::TestSet;
pub use trainings::over_trainings;
pub(crate) use values::OfItems;

/// Scores every system that edited a test set.
///
/// The edits may hold any number of systems, each with a motion for every item. A system may hold several takes of
/// every item, such as samples from different seeds; repeat r then scores take r modulo their number.
///
/// Also compares every system with the identity editor and with the next worse system in E2T R@1: for each task, the
/// paired differences in the metrics that support claims ([`CLAIMS`]).
///
/// The result has one row for each task, system and metric: first [`REAL_DATA`](crate::names::REAL_DATA) and
/// [`IDENTITY`], then the systems by name. With items of more than one task there is also
/// [`ALL_TASKS`](crate::names::ALL_TASKS), which comes first. Items with a target from another capture also form the
/// task [`RECAPTURED`], in which [`NOISE_FLOOR`] follows the identity editor. If there are items of several novelties,
/// each novelty forms a task ([`NOVELTIES`](crate::names::NOVELTIES)). A metric that needs more items than a task has
/// is left out, and so are bootstrap intervals over fewer targets than [`MIN_TARGETS`]. The last row of the identity
/// editor is not a metric: [`TOLD_APART`] shows whether the encoder distinguishes targets from sources.
///
/// # Errors
/// There is no item, or one without a target; a system lacks items, has unknown ones or uneven takes, has a reserved
/// name, or holds a motion that cannot be measured; the protocol measures nothing; the encoder fails or returns invalid
/// latents.
///
/// # Source
/// Table 1 of the paper for the metrics. FID is computed on latents of unit length and Diversity on raw ones; this
/// combination explains the published magnitudes.
pub fn score(
    answered: &Answered,
    evaluators: Evaluators<'_>,
    protocol: &Protocol,
    progress: &dyn Progress,
) -> Result<(Vec<ScoreRow>, Vec<Comparison>), Error> {
    protocol.check()?;
    let test_set = TestSet::new(answered, protocol)?;
    let measured = measured(&test_set, evaluators, protocol, progress)?;
    let encoder = evaluators.encoder;
    let tasks = test_set.tasks();
    progress.begin("score", Some((tasks.len() * protocol.repeats) as u64));
    let (mut scores, mut comparisons) = (Vec::new(), Vec::new());
    for (task, indices) in tasks {
        let of_task = OfTask::new(task, &indices, &test_set, &measured, protocol)?;
        scores.extend(of_task.scores(&encoder.hash(), progress)?);
        comparisons.extend(of_task.claims(encoder));
    }
    progress.finish(&format!("{} scores", scores.len()));
    Ok((scores, comparisons))
}

/// The systems, restricted to the items of one task.
pub(crate) struct OfTask<'a> {
    pub(crate) task: &'a str,
    /// The real data, the identity editor, the noise floor if there is one, and the systems sorted by name.
    pub(crate) systems: Vec<System<'a>>,
    /// Ranks of each system.
    ranks: Vec<Ranks>,
    /// Values of each item, for each system.
    of_items: Vec<OfItems>,
    pub(crate) resamples: Resamples,
    pub(crate) counts: Items,
    latent_width: usize,
    classifier: Option<String>,
    pub(crate) protocol: &'a Protocol,
}

impl<'a> OfTask<'a> {
    pub(crate) fn new(
        task: &'a str,
        indices: &[usize],
        test_set: &TestSet<'a>,
        measured: &Measured<'a>,
        protocol: &'a Protocol,
    ) -> Result<Self, Error> {
        let sources = measured.sources.select(indices);
        let mut systems: Vec<System<'_>> = measured
            .systems
            .iter()
            .map(|system| system.select(indices))
            .collect();
        if task == RECAPTURED {
            let floor = System {
                name: NOISE_FLOOR,
                takes: measured.floor.iter().cloned().collect(),
            };
            systems.insert(2, floor);
        }
        let targets = &systems[0].takes[0];
        let galleries = Galleries::draw(indices.len(), protocol);
        let (ranks, of_items): (Vec<Ranks>, Vec<OfItems>) = systems
            .par_iter()
            .map(|system| {
                let ranks = Ranks::of_system(&sources, targets, system, &galleries, protocol)?;
                let of_items = of_items(system, &ranks, &galleries, protocol)?;
                Ok((ranks, of_items))
            })
            .collect::<Result<Vec<_>, Error>>()?
            .into_iter()
            .unzip();
        Ok(Self {
            task,
            systems,
            ranks,
            of_items,
            resamples: Resamples::new(test_set.targets(indices), protocol),
            counts: test_set.counts(indices),
            latent_width: sources.latents.raw.num_cols(),
            classifier: measured.classifier.clone(),
            protocol,
        })
    }

    /// A protocol in words, with the coordinator that classified the motions, if one did.
    pub(crate) fn named(&self, protocol: String) -> String {
        match &self.classifier {
            Some(hash) => format!("{protocol}; coordinator {hash:.12}"),
            None => protocol,
        }
    }

    /// One row for each system and metric.
    fn scores(&self, encoder_hash: &str, progress: &dyn Progress) -> Result<Vec<ScoreRow>, Error> {
        let Self {
            systems, protocol, ..
        } = self;
        let advance = || progress.advance(1);
        let repeats = values::of_repeats(systems, &self.ranks, protocol, advance)?;
        let told_apart = told_apart([&self.of_items[0], &self.of_items[1]], &self.resamples);
        let resampled = match protocol.interval {
            Spread::Repeats => None,
            Spread::Targets => Some(self.resampled()?),
        };
        let mut scores = Vec::new();
        for (position, system) in systems.iter().enumerate() {
            let row = |metric, interval| self.row(system, metric, interval, encoder_hash);
            for &metric in metric::ALL {
                let found: Option<Vec<f64>> = repeats
                    .iter()
                    .map(|systems| systems[position].get(metric).copied())
                    .collect();
                let Some(found) = found else {
                    continue;
                };
                let over_repeats = Interval::of(&found);
                let interval = match &resampled {
                    None => over_repeats,
                    Some(_) if self.targets_of(position, metric) < MIN_TARGETS => Interval {
                        ci95: None,
                        ..over_repeats
                    },
                    Some(resampled) => {
                        let resampled = resampled[position].get(metric);
                        let resampled = resampled.map_or(&[][..], Vec::as_slice);
                        let num_items = self.counts.count as usize;
                        let (repeats, share) = match metric.measure {
                            Measure::Set(_, Draws::Halves) => (&found[..], 1.0),
                            Measure::Set(_, Draws::Pairs) => {
                                (&found[..], noise_of_resample(num_items, protocol))
                            }
                            Measure::Motion(_) | Measure::Takes(_) | Measure::Rank(..) => {
                                (&[][..], 0.0)
                            }
                        };
                        Interval::of_resamples(over_repeats.mean, resampled, repeats, share)
                    }
                };
                scores.push(row(metric.name, interval));
            }
            if system.name == IDENTITY {
                scores.push(row(TOLD_APART, told_apart));
            }
        }
        Ok(scores)
    }

    /// Number of targets of the items for which a system has a value of a metric; all targets for metrics of sets.
    fn targets_of(&self, position: usize, metric: &'static Metric) -> u32 {
        self.of_items[position]
            .get(metric)
            .map_or(self.counts.targets, |values| {
                self.resamples.num_targets(values) as u32
            })
    }

    /// Values of the metrics on the bootstrap resamples, for each system.
    fn resampled(&self) -> Result<Vec<OfItems>, Error> {
        let resamples = &self.resamples;
        let of_system = |of_items: &OfItems| -> OfItems {
            let values = of_items.iter().map(|(metric, of_items)| {
                let values = match metric.measure {
                    Measure::Rank(_, RankSummary::Median) => resamples.medians(of_items),
                    _ => resamples.means(of_items),
                };
                (*metric, values)
            });
            values.collect()
        };
        let mut found: Vec<OfItems> = self.of_items.par_iter().map(of_system).collect();
        let of_sets = resamples
            .weights(SET_RESAMPLES)
            .enumerate()
            .collect::<Vec<_>>()
            .into_par_iter()
            .map(|(resample, weights)| {
                values::of_resample(&self.systems, &weights, resample, self.protocol)
            })
            .collect::<Result<Vec<_>, Error>>()?;
        for resample in of_sets {
            for (system, values) in found.iter_mut().zip(resample) {
                for (metric, value) in values {
                    system.entry(metric).or_default().push(value);
                }
            }
        }
        Ok(found)
    }

    fn row(
        &self,
        system: &System<'_>,
        metric: &str,
        Interval { mean, ci95 }: Interval,
        encoder_hash: &str,
    ) -> ScoreRow {
        let (counts, protocol) = (&self.counts, self.protocol);
        let num_items = counts.count as usize;
        let (gallery, ranked) = protocol.gallery_sizes(num_items);
        ScoreRow {
            system: system.name.to_owned(),
            task: self.task.to_owned(),
            metric: metric.to_owned(),
            protocol: self.named(protocol.name(num_items)),
            encoder_hash: encoder_hash.to_owned(),
            n: counts.count,
            repeats: protocol.repeats as u32,
            mean,
            ci95,
            takes: system.takes.len() as u32,
            targets: counts.targets,
            sources: counts.sources,
            instructions: counts.instructions,
            gallery: gallery as u32,
            ranked: ranked as u32,
            fid_items: protocol.fid_size(num_items) as u32,
            latent_width: self.latent_width as u32,
            novelty: counts.novelty.clone(),
            items_digest: counts.digest.clone(),
        }
    }

    /// Two systems, given by their positions.
    pub(crate) fn pairing(&self, pair: [usize; 2]) -> Pairing<'_> {
        Pairing {
            task: self.task,
            real: &self.of_items[0],
            sides: pair.map(|place| &self.of_items[place]),
            resamples: &self.resamples,
        }
    }

    /// Why an encoder ranks no systems of the task, if it does not.
    pub(crate) fn unranked(&self, encoder: &dyn MotionEncoder) -> Option<String> {
        unranked(encoder, self.pairing([0, 1]).sides, &self.resamples)
    }

    /// Paired differences in the metrics of [`CLAIMS`](crate::metric::CLAIMS): each system against the identity editor
    /// and against the next worse system in E2T R@1.
    fn claims(&self, encoder: &dyn MotionEncoder) -> Vec<Comparison> {
        let recall = |place: usize| -> f64 {
            let of_system = self.of_items[place].get(&E2T_RECALL_1);
            let known = of_system.into_iter().flatten();
            known.filter(|value| value.is_finite()).sum()
        };
        let mut ranked: Vec<usize> = (0..self.systems.len())
            .filter(|&place| !GIVEN.contains(&self.systems[place].name))
            .collect();
        ranked.sort_by(|&a, &b| recall(b).total_cmp(&recall(a)));
        let against_identity = ranked.iter().map(|&place| [1, place]);
        let neighbours = ranked.windows(2).map(|pair| [pair[1], pair[0]]);
        let unranked = self.unranked(encoder);
        // The protocol of the scores, whose table the claims follow.
        let protocol = self.named(self.protocol.name(self.counts.count as usize));
        let of_pair = |pair: [usize; 2]| {
            let claims = self.pairing(pair).differences(&CLAIMS);
            let (protocol, unranked) = (protocol.clone(), unranked.clone());
            Comparison::new(self, pair, protocol, encoder, unranked, claims)
        };
        against_identity.chain(neighbours).map(of_pair).collect()
    }
}

/// Why an encoder ranks no systems on some items; `None` if it can. `of_items` are the values of the real data and of
/// the identity editor. It continues a sentence.
fn unranked(
    encoder: &dyn MotionEncoder,
    of_items: [&OfItems; 2],
    resamples: &Resamples,
) -> Option<String> {
    if let Some(weakness) = encoder.weakness() {
        return Some(format!("the encoder is too weak to judge: {weakness}"));
    }
    let told = told_apart(of_items, resamples);
    let half = told.ci95.unwrap_or(0.0);
    // With fewer targets no difference has an interval, so nothing is called better anyway.
    let recalls = of_items[0].get(&E2T_RECALL_1);
    let is_known =
        recalls.is_some_and(|values| resamples.num_targets(values) >= MIN_TARGETS as usize);
    (is_known && told.mean - half <= 0.0).then(|| {
        format!(
            "the targets cannot be told from their sources: in {} the real data is {:.1}±{half:.1} % above the identity editor",
            E2T_RECALL_1.name, told.mean
        )
    })
}

/// The difference between the real data and the identity editor in E2T R@1, on the same items.
fn told_apart(of_items: [&OfItems; 2], resamples: &Resamples) -> Interval {
    let [real, identity] = of_items.map(|values| {
        let of_system = values.get(&E2T_RECALL_1);
        of_system.map_or(&[][..], Vec::as_slice)
    });
    let differences: Vec<f64> = real.iter().zip(identity).map(|(a, b)| a - b).collect();
    let mean = mean_of_known(&differences).unwrap_or(0.0);
    Interval::of_resamples(mean, &resamples.means(&differences), &[], 0.0)
}
