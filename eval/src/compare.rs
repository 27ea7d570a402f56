//! Whether one system is better than another: paired differences with intervals.

use datasets_spec::Progress;
use datasets_spec::quantile::quantile;
use datasets_spec::record::{EditRow, ItemRow};
use rayon::prelude::*;
use serde::Serialize;

use crate::Error;
use crate::evaluators::Evaluators;
use crate::format::grid::Grid;
use crate::linalg::Matrix;
use crate::metric::fid::{self, FID, MIN_ROWS};
use crate::metric::{self, Better, Measure, Metric, RankSummary};
use crate::protocol::{FidSample, Protocol, Spread};
use crate::score::{Measured, Ranks, Resamples, System, Take, TestSet, drawn, measured, of_items};
use crate::table::Items;

/// Resamples behind an interval of a Fréchet distance, each of which decomposes three covariances.
const FID_RESAMPLES: usize = 200;

/// Share of the resamples beyond either end of an interval.
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
    /// Which system is better, `A` or `B`; none where the interval contains 0, and for metrics whose
    /// good values are those near real data.
    pub better: Option<&'static str>,
}

/// Two systems on the items of one task.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// The task.
    pub task: String,
    /// Items.
    pub n: usize,
    /// Distinct motions their targets were made of, which the bootstrap draws.
    pub targets: u32,
    /// What tells one set of items from another.
    pub items_digest: String,
    /// The two systems.
    pub systems: [String; 2],
    /// The protocol in words.
    pub protocol: String,
    /// Hash of the encoder, hexadecimal.
    pub encoder_hash: String,
    /// Why no system is called better; none if the encoder ranks.
    pub unranked: Option<String>,
    /// The metrics.
    pub differences: Vec<Difference>,
}

/// Compares two systems item by item.
///
/// Targets are drawn with replacement, with all items that share them and the same draws for both
/// systems; the interval reaches from the 2.5 to the 97.5 % quantile of the difference (Efron 1979).
/// An item's rank is its mean over the repeats that ranked it. The Fréchet distance is between all
/// real motions and all motions of a system, whatever the protocol says, and is named so.
///
/// # Errors
/// As [`crate::score::score`]; or the edits lack one of the systems.
pub fn compare(
    items: &[ItemRow],
    edits: &[EditRow],
    names: [&str; 2],
    evaluators: Evaluators<'_>,
    protocol: &Protocol,
    progress: &dyn Progress,
) -> Result<Vec<Comparison>, Error> {
    protocol.check()?;
    let test_set = TestSet::new(items, edits, protocol)?;
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
    } = measured(&test_set, evaluators, protocol, progress)?;
    let weakness = evaluators.encoder.weakness();
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
            let resamples = Resamples::new(test_set.targets(&indices), protocol);
            let mut differences =
                differences(task, &sources, &targets, &sides, &resamples, protocol)?;
            if weakness.is_some() {
                for difference in &mut differences {
                    difference.better = None;
                }
            }
            let Items {
                targets, digest, ..
            } = test_set.counts(&indices);
            progress.advance(1);
            Ok(Comparison {
                task: task.to_owned(),
                n: indices.len(),
                targets,
                items_digest: digest,
                systems: names.map(str::to_owned),
                protocol: whole_sets(protocol).name(indices.len()),
                encoder_hash: evaluators.encoder.hash(),
                unranked: weakness.clone(),
                differences,
            })
        })
        .collect::<Result<Vec<_>, Error>>()?;
    progress.finish(&format!("{} tasks", comparisons.len()));
    Ok(comparisons)
}

/// The protocol of a comparison: FID of whole sets, since a resample of a half is too small.
fn whole_sets(protocol: &Protocol) -> Protocol {
    Protocol {
        fid_sample: FidSample::All,
        interval: Spread::Targets,
        ..*protocol
    }
}

fn differences(
    task: &str,
    sources: &Take,
    targets: &Take,
    sides: &[System<'_>; 2],
    resamples: &Resamples,
    protocol: &Protocol,
) -> Result<Vec<Difference>, Error> {
    let values = |side: &System<'_>| {
        let ranks = Ranks::of_system(sources, targets, side, protocol)?;
        of_items(side, &ranks, protocol)
    };
    let (a, b) = (values(&sides[0])?, values(&sides[1])?);
    let mut found = Vec::new();
    if targets.latents.raw.num_rows() >= MIN_ROWS {
        let takes = sides.each_ref().map(|side| &side.takes[0].latents.unit);
        let real = &targets.latents.unit;
        found.extend(fid_difference(task, real, takes, resamples)?);
    }
    for &metric in metric::ALL {
        if matches!(metric.measure, Measure::Rank(_, RankSummary::Median)) {
            continue;
        }
        let (Some(a), Some(b)) = (a.get(metric), b.get(metric)) else {
            continue;
        };
        // An item that no gallery ranked has no value.
        let differences: Vec<f64> = a.iter().zip(b).map(|(a, b)| b - a).collect();
        let mean = |values: &[f64]| {
            let known = values.iter().zip(&differences);
            let known = known.filter(|(_, difference)| difference.is_finite());
            let (sum, count) = known.fold((0.0, 0.0), |(sum, count), (value, _)| {
                (sum + value, count + 1.0)
            });
            sum / count
        };
        let values = [mean(a), mean(b)];
        let mut resampled = resamples.means(&differences);
        if resampled.is_empty() || values.iter().any(|value| !value.is_finite()) {
            continue;
        }
        found.push(difference(
            metric.name,
            metric,
            task,
            values,
            &mut resampled,
        ));
    }
    Ok(found)
}

/// Name of the Fréchet distance here, which is not the FID of the tables.
const FID_NAME: &str = "FID of whole sets";

/// The difference in FID; none where every resample draws a single row.
fn fid_difference(
    task: &str,
    real: &Matrix,
    sides: [&Matrix; 2],
    resamples: &Resamples,
) -> Result<Option<Difference>, Error> {
    let both = |indices: &[usize]| -> Result<[f64; 2], Error> {
        let sides = sides.into_iter().map(|side| side.select_rows(indices));
        let found = fid::distances(&real.select_rows(indices), sides)?;
        Ok([found[0], found[1]])
    };
    let all: Vec<usize> = (0..real.num_rows()).collect();
    let values = both(&all)?;
    let draws: Vec<Vec<usize>> = resamples
        .weights(FID_RESAMPLES)
        .map(|weights| drawn(&all, &weights))
        .filter(|drawn| drawn.len() >= MIN_ROWS)
        .collect();
    let mut resampled = draws
        .par_iter()
        .map(|drawn| both(drawn).map(|[a, b]| b - a))
        .collect::<Result<Vec<f64>, Error>>()?;
    Ok((!resampled.is_empty()).then(|| difference(FID_NAME, &FID, task, values, &mut resampled)))
}

fn difference(
    name: &'static str,
    metric: &Metric,
    task: &str,
    [a, b]: [f64; 2],
    resampled: &mut [f64],
) -> Difference {
    let interval = [TAIL, 1.0 - TAIL]
        .map(|share| quantile(resampled, share).expect("resamples of a known difference"));
    let rises = interval[0] > 0.0;
    let falls = interval[1] < 0.0;
    let better = match (metric.better)(task) {
        Better::Higher if rises => Some("B"),
        Better::Higher if falls => Some("A"),
        Better::Lower if rises => Some("A"),
        Better::Lower if falls => Some("B"),
        Better::Higher | Better::Lower | Better::NearReal => None,
    };
    Difference {
        metric: name,
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
            title: self
                .unranked
                .iter()
                .map(|reason| {
                    format!(
                        "No system is called better: the encoder is too weak to judge: {reason}.\n"
                    )
                })
                .collect::<String>()
                + &format!(
                    "{}: A = {a}, B = {b}, intervals of B - A; {} items of {} targets (ids {}); {}; encoder {}",
                    self.task,
                    self.n,
                    self.targets,
                    self.items_digest,
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
                    let digits = metric::from_name(row.metric).map_or(3, |metric| metric.decimals);
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
