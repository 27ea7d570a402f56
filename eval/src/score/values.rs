//! Values of the metrics: of one repeat, of one bootstrap resample, and of each item.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::measure::{System, Take};
use super::resample::drawn;
use crate::Error;
use crate::metric::retrieval::{Retrieval, gallery_ranks};
use crate::metric::{
    self, Counterpart, Latents, Measure, Metric, RankSummary, SetSample, TakesMeasure, TakesSample,
};
use crate::protocol::{Protocol, Queries};

/// Ranks of a system's counterparts in the galleries of one repeat, counted from zero.
pub(crate) struct Ranks {
    galleries: Vec<Vec<usize>>,
    of_sources: Vec<Vec<f64>>,
    of_targets: Vec<Vec<f64>>,
}

impl Ranks {
    /// The ranks of a system in every repeat.
    pub(crate) fn of_system(
        sources: &Take,
        targets: &Take,
        system: &System<'_>,
        protocol: &Protocol,
    ) -> Result<Vec<Self>, Error> {
        (0..protocol.repeats)
            .into_par_iter()
            .map(|repeat| {
                let edited = &system.takes[repeat % system.takes.len()].latents.unit;
                let galleries = protocol.galleries(edited.num_rows(), repeat);
                let ranks = |real: &Take| match protocol.queries {
                    Queries::Real => gallery_ranks(&real.latents.unit, edited, &galleries),
                    Queries::Edited => gallery_ranks(edited, &real.latents.unit, &galleries),
                };
                let (of_sources, of_targets) = (ranks(sources)?, ranks(targets)?);
                Ok(Self {
                    galleries,
                    of_sources,
                    of_targets,
                })
            })
            .collect()
    }

    /// The ranks in each gallery.
    fn of(&self, counterpart: Counterpart) -> &[Vec<f64>] {
        match counterpart {
            Counterpart::Source => &self.of_sources,
            Counterpart::Target => &self.of_targets,
        }
    }

    /// The mean over the galleries.
    fn retrieval(&self, counterpart: Counterpart) -> Retrieval {
        let parts: Vec<Retrieval> = self
            .of(counterpart)
            .iter()
            .map(|ranks| Retrieval::of_ranks(ranks))
            .collect();
        Retrieval::mean(&parts)
    }
}

/// The values of all systems of a task in one repeat; the first system is the real data.
pub(super) fn of_repeat(
    systems: &[System<'_>],
    ranks: &[Vec<Ranks>],
    protocol: &Protocol,
    repeat: usize,
) -> Result<Vec<BTreeMap<&'static Metric, f64>>, Error> {
    let num_items = systems[0].takes[0].latents.raw.num_rows();
    let items: Vec<usize> = (0..num_items).collect();
    let [real, compared] = protocol.fid_items(num_items, repeat);
    let of_sets = of_sets(systems, &items, [&real, &compared], repeat, false, protocol)?;
    let mut found = Vec::new();
    for ((system, ranks), of_sets) in systems.iter().zip(ranks).zip(of_sets) {
        let mut values = BTreeMap::from_iter(of_sets);
        let take = &system.takes[repeat % system.takes.len()];
        for (metric, of_items) in &take.of_items {
            let known = of_items.iter().copied().filter(|value| !value.is_nan());
            values.extend(mean(known).map(|mean| (*metric, mean)));
        }
        let of_sources = ranks[repeat].retrieval(Counterpart::Source);
        let of_targets = ranks[repeat].retrieval(Counterpart::Target);
        for &metric in metric::ALL {
            match metric.measure {
                Measure::Takes(value) => {
                    let of_items = of_takes(system, value, protocol, repeat)?;
                    let mean = mean(of_items.into_iter().map(|(_, value)| value));
                    values.extend(mean.map(|mean| (metric, mean)));
                }
                Measure::Rank(Counterpart::Source, summary) => {
                    values.insert(metric, of_sources.value(summary));
                }
                Measure::Rank(Counterpart::Target, summary) => {
                    values.insert(metric, of_targets.value(summary));
                }
                Measure::Motion(_) | Measure::Set(_) => {}
            }
        }
        found.push(values);
    }
    Ok(found)
}

/// The values of the metrics of whole sets on one bootstrap resample, for each system. Galleries,
/// halves and takes are those of the repeat of the same number.
pub(super) fn of_resample(
    systems: &[System<'_>],
    weights: &[u32],
    resample: usize,
    protocol: &Protocol,
) -> Result<Vec<Vec<(&'static Metric, f64)>>, Error> {
    let all: Vec<usize> = (0..weights.len()).collect();
    let items = drawn(&all, weights);
    let [real, compared] = protocol
        .fid_items(weights.len(), resample % protocol.repeats)
        .map(|items| drawn(&items, weights));
    of_sets(
        systems,
        &items,
        [&real, &compared],
        resample,
        true,
        protocol,
    )
}

/// The values of the metrics of whole sets, for each system.
fn of_sets(
    systems: &[System<'_>],
    items: &[usize],
    fid_items: [&[usize]; 2],
    draw: usize,
    resampled: bool,
    protocol: &Protocol,
) -> Result<Vec<Vec<(&'static Metric, f64)>>, Error> {
    let repeat = draw % protocol.repeats;
    let sets: Vec<&Latents> = systems
        .iter()
        .map(|system| &system.takes[repeat % system.takes.len()].latents)
        .collect();
    let sample = SetSample {
        sets: &sets,
        items,
        fid_items,
        draw,
        resampled,
        protocol,
    };
    let mut found = vec![Vec::new(); systems.len()];
    for &metric in metric::ALL {
        let Measure::Set(of_sample) = metric.measure else {
            continue;
        };
        let values = of_sample(&sample)?;
        for (found, value) in found.iter_mut().zip(values.into_iter().flatten()) {
            found.push((metric, value));
        }
    }
    Ok(found)
}

/// Values of each item, in the order of the items: means over the repeats, each of which scores one
/// take and ranks some of the items. NaN where no repeat has a value. For a median rank they are the
/// ranks it is the median of.
pub(crate) fn of_items(
    system: &System<'_>,
    ranks: &[Ranks],
    protocol: &Protocol,
) -> Result<BTreeMap<&'static Metric, Vec<f64>>, Error> {
    let num_items = system.takes[0].latents.raw.num_rows();
    let mut sums: BTreeMap<&Metric, Vec<(f64, f64)>> = BTreeMap::new();
    let mut add = |metric: &'static Metric, item: usize, value: f64| {
        let of_metric = sums
            .entry(metric)
            .or_insert_with(|| vec![(0.0, 0.0); num_items]);
        of_metric[item].0 += value;
        of_metric[item].1 += 1.0;
    };
    for (repeat, ranks) in ranks.iter().enumerate() {
        let take = &system.takes[repeat % system.takes.len()];
        for (metric, of_items) in &take.of_items {
            for (item, value) in of_items.iter().enumerate().filter(|(_, v)| !v.is_nan()) {
                add(metric, item, *value);
            }
        }
        for &metric in metric::ALL {
            match metric.measure {
                Measure::Takes(value) => {
                    for (item, value) in of_takes(system, value, protocol, repeat)? {
                        add(metric, item, value);
                    }
                }
                Measure::Rank(counterpart, summary) => {
                    for (indices, ranks) in ranks.galleries.iter().zip(ranks.of(counterpart)) {
                        for (&item, &rank) in indices.iter().zip(ranks) {
                            add(metric, item, of_rank(rank, summary));
                        }
                    }
                }
                Measure::Motion(_) | Measure::Set(_) => {}
            }
        }
    }
    let means = |(metric, sums): (_, Vec<(f64, f64)>)| {
        // 0 / 0 marks items without a value.
        let means = sums.into_iter().map(|(sum, count)| sum / count);
        (metric, means.collect())
    };
    Ok(sums.into_iter().map(means).collect())
}

/// What one rank, counted from zero, contributes to a summary.
fn of_rank(rank: f64, summary: RankSummary) -> f64 {
    match summary {
        RankSummary::Recall(k) if rank < k as f64 => 100.0,
        RankSummary::Recall(_) => 0.0,
        RankSummary::Average | RankSummary::Median => rank + 1.0,
    }
}

/// Values of items that come from all takes of a system.
fn of_takes(
    system: &System<'_>,
    value: TakesMeasure,
    protocol: &Protocol,
    repeat: usize,
) -> Result<Vec<(usize, f64)>, Error> {
    let takes: Vec<&Latents> = system.takes.iter().map(|take| &take.latents).collect();
    value(&TakesSample {
        takes: &takes,
        repeat,
        protocol,
    })
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    (count > 0.0).then(|| sum / count)
}
