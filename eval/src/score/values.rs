//! Values of the metrics: per repeat, per bootstrap resample, and per item.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::measure::{System, Take};
use super::resample::drawn;
use crate::Error;
use crate::metric::interval::mean;
use crate::metric::retrieval::{Retrieval, gallery_ranks};
use crate::metric::{
    self, Counterpart, Draws, Latents, Measure, Metric, RankSummary, SetMeasure, SetSample,
    TakesMeasure, TakesSample,
};
use crate::protocol::{FidSample, Protocol, Queries};

/// Values of each item by metric.
pub(crate) type OfItems = BTreeMap<&'static Metric, Vec<f64>>;

/// Galleries of each repeat, as positions of items. If one gallery holds all items, it is stored for the first repeat
/// only.
pub(crate) struct Galleries(Vec<Vec<Vec<usize>>>);

impl Galleries {
    pub(crate) fn draw(num_items: usize, protocol: &Protocol) -> Self {
        let repeats = 0..protocol.distinct_galleries(num_items);
        let draw = |repeat| protocol.galleries(num_items, repeat);
        Self(repeats.map(draw).collect())
    }

    fn of(&self, repeat: usize) -> &[Vec<usize>] {
        &self.0[repeat % self.0.len()]
    }
}

/// A system's ranks in the galleries of each repeat, with the sources and with the targets. Repeats with the same take
/// and galleries share ranks, which are computed once.
pub(crate) struct Ranks(Vec<[Ranked; 2]>);

/// Ranks in the galleries of one repeat.
struct Ranked {
    /// Ranks in each gallery, counted from zero.
    ranks: Vec<Vec<f64>>,
    /// The mean over the galleries.
    retrieval: Retrieval,
}

impl Ranks {
    /// Ranks the counterparts of a system's motions.
    pub(crate) fn of_system(
        sources: &Take,
        targets: &Take,
        system: &System<'_>,
        galleries: &Galleries,
        protocol: &Protocol,
    ) -> Result<Self, Error> {
        let distinct = match galleries.0.len() {
            1 => protocol.repeats.min(system.takes.len()),
            _ => protocol.repeats,
        };
        let ranked = |repeat: usize| -> Result<[Ranked; 2], Error> {
            let edited = &system.take(repeat).latents.unit;
            let galleries = galleries.of(repeat);
            let by = |real: &Take| -> Result<Ranked, Error> {
                let real = &real.latents.unit;
                let ranks = match protocol.queries {
                    Queries::Real => gallery_ranks(real, edited, galleries)?,
                    Queries::Edited => gallery_ranks(edited, real, galleries)?,
                };
                let retrieval = Retrieval::of_galleries(&ranks);
                Ok(Ranked { ranks, retrieval })
            };
            Ok([by(sources)?, by(targets)?])
        };
        let ranks = (0..distinct).into_par_iter().map(ranked);
        Ok(Self(ranks.collect::<Result<_, Error>>()?))
    }

    fn of(&self, repeat: usize, counterpart: Counterpart) -> &Ranked {
        let [by_sources, by_targets] = &self.0[repeat % self.0.len()];
        match counterpart {
            Counterpart::Source => by_sources,
            Counterpart::Target => by_targets,
        }
    }
}

/// Values by metric.
type Values = BTreeMap<&'static Metric, f64>;

/// Values of all systems of a task, indexed by repeat and then by system; the first system is the real data. `advance`
/// is called after each repeat.
pub(super) fn of_repeats(
    systems: &[System<'_>],
    ranks: &[Ranks],
    protocol: &Protocol,
    advance: impl Fn() + Sync,
) -> Result<Vec<Vec<Values>>, Error> {
    let of_sets = of_sets_by_repeat(systems, protocol)?;
    (0..protocol.repeats)
        .into_par_iter()
        .map(|repeat| {
            let mut found = Vec::with_capacity(systems.len());
            for (place, (system, ranks)) in systems.iter().zip(ranks).enumerate() {
                let mut values = of_repeat(system, ranks, protocol, repeat)?;
                let of_sets = of_sets.iter();
                values.extend(of_sets.map(|(metric, values)| (*metric, values[repeat][place])));
                found.push(values);
            }
            advance();
            Ok(found)
        })
        .collect()
}

/// Values of a system in one repeat, without the metrics of whole sets.
fn of_repeat(
    system: &System<'_>,
    ranks: &Ranks,
    protocol: &Protocol,
    repeat: usize,
) -> Result<Values, Error> {
    let mut values = Values::new();
    for &metric in metric::ALL {
        let value = match metric.measure {
            Measure::Motion(_) => {
                let of_items = system.take(repeat).values(metric).iter().copied();
                mean(of_items.filter(|value| !value.is_nan()))
            }
            Measure::Takes(value) => {
                let of_items = of_takes(system, value, protocol, repeat)?;
                mean(of_items.into_iter().map(|(_, value)| value))
            }
            Measure::Rank(counterpart, summary) => {
                Some(ranks.of(repeat, counterpart).retrieval.value(summary))
            }
            Measure::Set(..) => None,
        };
        values.extend(value.map(|value| (metric, value)));
    }
    Ok(values)
}

/// Values of the metrics of whole sets: for each metric, indexed by repeat and then by system.
fn of_sets_by_repeat(
    systems: &[System<'_>],
    protocol: &Protocol,
) -> Result<BTreeMap<&'static Metric, Vec<Vec<f64>>>, Error> {
    let num_items = systems[0].takes[0].latents.raw.num_rows();
    let items: Vec<usize> = (0..num_items).collect();
    let most_takes = systems.iter().map(|system| system.takes.len()).max();
    let mut found = BTreeMap::new();
    for &metric in metric::ALL {
        let Measure::Set(of_sample, draws) = metric.measure else {
            continue;
        };
        let is_drawn_anew = match draws {
            Draws::Halves => protocol.fid_sample == FidSample::Halves,
            Draws::Pairs => true,
        };
        // Without random draws, repeats with the same takes have equal values.
        let distinct = match is_drawn_anew {
            true => protocol.repeats,
            false => protocol.repeats.min(most_takes.unwrap_or(1)),
        };
        let values = (0..distinct)
            .into_par_iter()
            .map(|repeat| {
                let [real, compared] = protocol.fid_items(num_items, repeat);
                let drawn = (&items[..], [&real[..], &compared]);
                of_sets(of_sample, systems, drawn, (repeat, false), protocol)
            })
            .collect::<Result<Vec<Option<Vec<f64>>>, Error>>()?;
        let values: Option<Vec<Vec<f64>>> = values.into_iter().collect();
        let Some(values) = values else {
            continue;
        };
        let of_repeat = |repeat: usize| -> Vec<f64> {
            let same = |system: &System<'_>| match is_drawn_anew {
                true => repeat,
                false => repeat % system.takes.len(),
            };
            let of_systems = systems.iter().enumerate();
            of_systems
                .map(|(place, system)| values[same(system)][place])
                .collect()
        };
        found.insert(metric, (0..protocol.repeats).map(of_repeat).collect());
    }
    Ok(found)
}

/// Values of the metrics of whole sets on one bootstrap resample, for each system. Halves and takes are those of the
/// repeat whose number is `resample` modulo the number of repeats.
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
    let mut found = vec![Vec::new(); systems.len()];
    for &metric in metric::ALL {
        let Measure::Set(of_sample, _) = metric.measure else {
            continue;
        };
        let drawn = (&items[..], [&real[..], &compared]);
        let values = of_sets(of_sample, systems, drawn, (resample, true), protocol)?;
        for (found, value) in found.iter_mut().zip(values.into_iter().flatten()) {
            found.push((metric, value));
        }
    }
    Ok(found)
}

/// Values of a metric of whole sets, for each system. `drawn` holds the items, and the items on each side of a Fréchet
/// distance. `draw` holds the number of the repeat or resample, and whether it is a resample.
fn of_sets(
    of_sample: SetMeasure,
    systems: &[System<'_>],
    (items, fid_items): (&[usize], [&[usize]; 2]),
    (draw, resampled): (usize, bool),
    protocol: &Protocol,
) -> Result<Option<Vec<f64>>, Error> {
    let repeat = draw % protocol.repeats;
    let sets: Vec<&Latents> = systems
        .iter()
        .map(|system| &system.take(repeat).latents)
        .collect();
    of_sample(&SetSample {
        sets: &sets,
        items,
        fid_items,
        draw,
        resampled,
        protocol,
    })
}

/// Values of each item, in order: means over the repeats, each of which scores one take and ranks some of the items.
/// NaN if no repeat has a value. For the median rank, the item values are ranks.
pub(crate) fn of_items(
    system: &System<'_>,
    ranks: &Ranks,
    galleries: &Galleries,
    protocol: &Protocol,
) -> Result<OfItems, Error> {
    let num_items = system.takes[0].latents.raw.num_rows();
    let mut found = OfItems::new();
    for &metric in metric::ALL {
        let mut sums = vec![(0.0, 0.0); num_items];
        let mut add = |item: usize, value: f64| {
            sums[item].0 += value;
            sums[item].1 += 1.0;
        };
        for repeat in 0..protocol.repeats {
            match metric.measure {
                Measure::Motion(_) => {
                    let values = system.take(repeat).values(metric).iter().enumerate();
                    for (item, &value) in values.filter(|(_, value)| !value.is_nan()) {
                        add(item, value);
                    }
                }
                Measure::Takes(value) => {
                    for (item, value) in of_takes(system, value, protocol, repeat)? {
                        add(item, value);
                    }
                }
                Measure::Rank(counterpart, summary) => {
                    let ranks = &ranks.of(repeat, counterpart).ranks;
                    for (indices, ranks) in galleries.of(repeat).iter().zip(ranks) {
                        for (&item, &rank) in indices.iter().zip(ranks) {
                            add(item, of_rank(rank, summary));
                        }
                    }
                }
                Measure::Set(..) => {}
            }
        }
        if sums.iter().any(|(_, count)| *count > 0.0) {
            // 0 / 0 gives NaN, which marks items without a value.
            let means = sums.into_iter().map(|(sum, count)| sum / count);
            found.insert(metric, means.collect());
        }
    }
    Ok(found)
}

/// Contribution of one rank, counted from zero, to a summary.
fn of_rank(rank: f64, summary: RankSummary) -> f64 {
    match summary {
        RankSummary::Recall(k) if rank < k as f64 => 100.0,
        RankSummary::Recall(_) => 0.0,
        RankSummary::Average | RankSummary::Median => rank + 1.0,
    }
}

/// Values of items computed from all takes of a system.
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
