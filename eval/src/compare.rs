//! Whether one system is better than another: paired differences with intervals.

use std::collections::BTreeMap;

use datasets_spec::Progress;
use datasets_spec::record::{EditRow, ItemRow};
use rand::RngExt;
use rayon::prelude::*;
use serde::Serialize;

use crate::Error;
use crate::format::grid::Grid;
use crate::linalg::Matrix;
use crate::metric::fid::{Gaussian, MIN_ROWS, Reference};
use crate::metric::retrieval::{self, RECALL_AT, gallery_ranks};
use crate::metric::{Better, Metric};
use crate::protocol::{Protocol, Queries};
use crate::score::{Instruments, Measured, System, Take, TestSet, measured};
use crate::similarity::Pairing;

/// Resamples behind an interval of a mean.
pub const RESAMPLES: usize = 1000;

/// Resamples behind an interval of a Fréchet distance, each of which decomposes three covariances.
const FID_RESAMPLES: usize = 200;

/// Share of the resamples left out on either side of an interval.
const TAIL: f64 = 0.025;

/// The difference of two systems in one metric, on the same items.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Name of the metric.
    pub metric: &'static str,
    /// Value of the first system.
    pub a: f64,
    /// Value of the second.
    pub b: f64,
    /// Second less first.
    pub difference: f64,
    /// Ends of the 95 % interval of the difference.
    pub interval: [f64; 2],
    /// Which system the interval favours; none where it holds 0, or where closeness to real data
    /// decides, which a difference does not tell.
    pub better: Option<&'static str>,
}

/// Two systems on the items of one task.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// The task.
    pub task: String,
    /// Items.
    pub n: usize,
    /// The two systems.
    pub systems: [String; 2],
    /// The protocol in words.
    pub protocol: String,
    /// Hash of the encoder, hexadecimal.
    pub encoder_hash: String,
    /// The metrics.
    pub differences: Vec<Difference>,
}

/// Compares two systems item by item.
///
/// Items are drawn with replacement, the same for both systems, and the interval is that of the
/// 2.5 and 97.5 % quantiles of the difference (Efron 1979). Where the protocol repeats a gallery,
/// an item's rank is its mean over the repeats that ranked it. The Fréchet distance is between all
/// real motions and all of a system's.
///
/// # Errors
/// As [`crate::score::score`]; or one of the systems is not among the rows.
pub fn compare(
    items: &[ItemRow],
    edits: &[EditRow],
    names: [&str; 2],
    instruments: Instruments<'_>,
    protocol: &Protocol,
    progress: &dyn Progress,
) -> Result<Vec<Comparison>, Error> {
    protocol.check()?;
    let test_set = TestSet::new(items, edits)?;
    if let Some(missing) = names
        .into_iter()
        .find(|name| !test_set.systems.contains_key(name))
    {
        return Err(Error::UnknownSystem {
            system: missing.to_owned(),
            known: test_set
                .systems
                .keys()
                .copied()
                .collect::<Vec<_>>()
                .join(", "),
        });
    }
    let Measured {
        sources, systems, ..
    } = measured(&test_set, instruments, protocol, progress)?;
    let find = |name: &str| systems.iter().find(|system| system.name == name);
    let tasks = test_set.tasks();
    progress.begin("compare", Some(tasks.len() as u64));
    let comparisons = tasks
        .into_iter()
        .map(|(task, indices)| {
            let sources = sources.select(&indices);
            let targets = systems[0].takes[0].select(&indices);
            let sides = names.map(|name| {
                find(name)
                    .expect("its name was found above")
                    .select(&indices)
            });
            let differences = differences(task, &sources, &targets, &sides, protocol)?;
            progress.advance(1);
            Ok(Comparison {
                task: task.to_owned(),
                n: indices.len(),
                systems: names.map(str::to_owned),
                protocol: protocol.name(indices.len()),
                encoder_hash: instruments.encoder.hash(),
                differences,
            })
        })
        .collect::<Result<Vec<_>, Error>>()?;
    progress.finish(&format!("{} tasks", comparisons.len()));
    Ok(comparisons)
}

fn differences(
    task: &str,
    sources: &Take,
    targets: &Take,
    sides: &[System<'_>; 2],
    protocol: &Protocol,
) -> Result<Vec<Difference>, Error> {
    let [a, b] = [&sides[0], &sides[1]].map(|side| item_values(sources, targets, side, protocol));
    let (a, b) = (a?, b?);
    let num_items = targets.raw.num_rows();
    let mut found = Vec::new();
    if num_items >= MIN_ROWS {
        let takes = sides.each_ref().map(|side| &side.takes[0].unit);
        found.push(fid_difference(task, &targets.unit, takes, protocol)?);
    }
    for metric in Metric::ALL {
        let (Some(a), Some(b)) = (a.get(&metric), b.get(&metric)) else {
            continue;
        };
        // An item that no gallery ranked says nothing.
        let pairs: Vec<(f64, f64)> = a
            .iter()
            .zip(b)
            .filter(|(a, b)| a.is_finite() && b.is_finite())
            .map(|(a, b)| (*a, *b))
            .collect();
        if pairs.is_empty() {
            continue;
        }
        let share = 1.0 / pairs.len() as f64;
        let values = [
            pairs.iter().map(|(a, _)| a).sum::<f64>() * share,
            pairs.iter().map(|(_, b)| b).sum::<f64>() * share,
        ];
        let mut resampled: Vec<f64> = (0..RESAMPLES)
            .into_par_iter()
            .map(|resample| {
                let mut rng = protocol.bootstrap_rng(resample);
                let sum: f64 = (0..pairs.len())
                    .map(|_| {
                        let (a, b) = pairs[rng.random_range(0..pairs.len())];
                        b - a
                    })
                    .sum();
                sum * share
            })
            .collect();
        found.push(difference(metric, task, values, &mut resampled));
    }
    Ok(found)
}

/// Values of each item: means over its takes, and over the repeats that ranked it.
fn item_values(
    sources: &Take,
    targets: &Take,
    system: &System<'_>,
    protocol: &Protocol,
) -> Result<BTreeMap<Metric, Vec<f64>>, Error> {
    let num_items = targets.raw.num_rows();
    let num_takes = system.takes.len();
    let mut values: BTreeMap<Metric, Vec<f64>> = BTreeMap::new();
    for (metric, _) in &system.takes[0].of_items {
        let of_takes = system
            .takes
            .iter()
            .filter_map(|take| take.of_items.iter().find(|(other, _)| other == metric));
        let mut sum = vec![0.0; num_items];
        for (_, of_items) in of_takes {
            for (sum, value) in sum.iter_mut().zip(of_items) {
                *sum += value / num_takes as f64;
            }
        }
        values.insert(*metric, sum);
    }
    for (real, average, recall) in [
        (
            sources,
            Metric::SourceAverageRank,
            Metric::SourceRecall as fn(u8) -> Metric,
        ),
        (targets, Metric::TargetAverageRank, Metric::TargetRecall),
    ] {
        let mut counts = vec![0.0; num_items];
        let mut ranks = vec![0.0; num_items];
        let mut hits = [(); RECALL_AT.len()].map(|()| vec![0.0; num_items]);
        let asked: Vec<Pairing<'_>> = system
            .takes
            .iter()
            .map(|take| match protocol.queries {
                Queries::Real => retrieval::compare(&real.compared, &take.compared),
                Queries::Edited => retrieval::compare(&take.compared, &real.compared),
            })
            .collect::<Result<_, _>>()?;
        for repeat in 0..protocol.repeats {
            let galleries = protocol.galleries(num_items, repeat);
            let found = gallery_ranks(&asked[repeat % num_takes], &galleries)?;
            for (indices, found) in galleries.iter().zip(found) {
                for (&item, rank) in indices.iter().zip(found) {
                    counts[item] += 1.0;
                    ranks[item] += rank + 1.0;
                    for (hits, k) in hits.iter_mut().zip(RECALL_AT) {
                        hits[item] += if rank < k as f64 { 100.0 } else { 0.0 };
                    }
                }
            }
        }
        // 0 / 0 marks items that were never ranked.
        let per_repeat = |sums: Vec<f64>| -> Vec<f64> {
            sums.iter().zip(&counts).map(|(sum, n)| sum / n).collect()
        };
        values.insert(average, per_repeat(ranks));
        for (hits, k) in hits.into_iter().zip(RECALL_AT) {
            values.insert(recall(k as u8), per_repeat(hits));
        }
    }
    Ok(values)
}

fn fid_difference(
    task: &str,
    real: &Matrix,
    sides: [&Matrix; 2],
    protocol: &Protocol,
) -> Result<Difference, Error> {
    let both = |indices: Option<&[usize]>| -> Result<[f64; 2], Error> {
        let picked = |matrix: &Matrix| match indices {
            Some(indices) => matrix.select_rows(indices),
            None => matrix.clone(),
        };
        let reference = Reference::new(Gaussian::of_latents(&picked(real))?);
        let distance = |side: &Matrix| reference.distance(&Gaussian::of_latents(&picked(side))?);
        Ok([distance(sides[0])?, distance(sides[1])?])
    };
    let values = both(None)?;
    let num_items = real.num_rows();
    let mut resampled = (0..FID_RESAMPLES)
        .into_par_iter()
        .map(|resample| {
            let mut rng = protocol.bootstrap_rng(resample);
            let indices: Vec<usize> = (0..num_items)
                .map(|_| rng.random_range(0..num_items))
                .collect();
            both(Some(&indices)).map(|[a, b]| b - a)
        })
        .collect::<Result<Vec<f64>, Error>>()?;
    Ok(difference(Metric::FidUnit, task, values, &mut resampled))
}

fn difference(metric: Metric, task: &str, [a, b]: [f64; 2], resampled: &mut [f64]) -> Difference {
    resampled.sort_by(f64::total_cmp);
    let last = resampled.len() - 1;
    let at = |share: f64| resampled[(share * last as f64).round() as usize];
    let interval = [at(TAIL), at(1.0 - TAIL)];
    let rises = interval[0] > 0.0;
    let falls = interval[1] < 0.0;
    let better = match metric.better(task) {
        Better::Higher if rises => Some("B"),
        Better::Higher if falls => Some("A"),
        Better::Lower if rises => Some("A"),
        Better::Lower if falls => Some("B"),
        Better::Higher | Better::Lower | Better::NearReal => None,
    };
    Difference {
        metric: metric.name(),
        a,
        b,
        difference: b - a,
        interval,
        better,
    }
}

impl Comparison {
    /// The comparison as a table.
    pub fn grid(&self) -> Grid {
        let [a, b] = &self.systems;
        Grid {
            title: format!(
                "{}: A = {a}, B = {b}; {} items, 95 % bootstrap intervals of B - A; {}; encoder {}",
                self.task,
                self.n,
                self.protocol,
                crate::table::short_hash(&self.encoder_hash),
            ),
            head: ["Metric", "A", "B", "B - A", "from", "to", "better"]
                .map(str::to_owned)
                .to_vec(),
            rows: self
                .differences
                .iter()
                .map(|row| {
                    let digits = Metric::from_name(row.metric).map_or(3, Metric::decimals);
                    let number = |value: f64| format!("{value:.digits$}");
                    vec![
                        row.metric.to_owned(),
                        number(row.a),
                        number(row.b),
                        format!("{:+.digits$}", row.difference),
                        number(row.interval[0]),
                        number(row.interval[1]),
                        row.better.unwrap_or("–").to_owned(),
                    ]
                })
                .collect(),
        }
    }
}
