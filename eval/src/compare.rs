//! Paired differences between two systems, with intervals that tell whether one is better.

use datasets_spec::Progress;
use datasets_spec::quantile::quantile;
use rayon::prelude::*;
use serde::Serialize;

use crate::Error;
use crate::answered::Answered;
use crate::evaluators::{Evaluators, MotionEncoder};
use crate::format::ABSENT;
use crate::format::csv::line;
use crate::format::grid::Grid;
use crate::linalg::Matrix;
use crate::metric::fid::{self, FID, MIN_ROWS};
use crate::metric::interval::{Interval, MIN_TARGETS, mean};
use crate::metric::{self, Better, CLAIMS, Measure, Metric, RankSummary};
use crate::protocol::{FidSample, PAIR_RESAMPLES, Protocol, Spread};
use crate::score::{OfItems, OfTask, Resamples, System, TestSet, drawn, measured};
use crate::table::notes::{shortage_of_fid, shortage_of_targets};

/// Header of [`Comparison::csv`]. The columns of the table of scores have the same names there (`format::csv`).
const CSV_HEAD: &str = "task,system_a,system_b,metric,protocol,encoder_hash,n,targets,items_digest,\
                        a,b,difference,from,to,better";

/// Share of the resamples outside the interval at each end.
const TAIL: f64 = 0.025;

/// The difference of two systems in one metric, on the same items.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Name of the metric.
    pub metric: String,
    /// Value of the first system.
    pub a: f64,
    /// Value of the second system.
    pub b: f64,
    /// Value of the second system minus that of the first.
    pub difference: f64,
    /// Number of items for which both systems have a value, and the difference is measured.
    pub items: usize,
    /// Ends of the 95 % interval of the difference; `None` if the items with a value have fewer than
    /// [`MIN_TARGETS`] targets.
    pub interval: Option<[f64; 2]>,
    /// The better system, `A` or `B`. `None` if there is no interval or it contains 0, if the encoder cannot rank
    /// systems, and for metrics whose good values are those near real data.
    pub better: Option<&'static str>,
    /// Digits after the point that tables print.
    #[serde(skip)]
    decimals: usize,
    /// The metric of [`CLAIMS`] that this row measures, if any.
    #[serde(skip)]
    claim: Option<&'static Metric>,
}

/// Two systems on the items of one task.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// The task.
    pub task: String,
    /// Number of items.
    pub n: usize,
    /// Number of distinct targets; the bootstrap draws them.
    pub targets: u32,
    /// Digest of the ids of the items.
    pub items_digest: String,
    /// The two systems.
    pub systems: [String; 2],
    /// The protocol in words.
    pub protocol: String,
    /// Hash of the encoder, hexadecimal.
    pub encoder_hash: String,
    /// Reason why no system is called better; `None` if the encoder can rank systems.
    pub unranked: Option<String>,
    /// One difference per metric.
    pub differences: Vec<Difference>,
    /// Sentences that say what is left out because there are too few items or targets.
    pub notes: Vec<String>,
}

/// Compares two systems item by item.
///
/// The bootstrap draws targets with replacement, together with all items that share them, and uses the same draws for
/// both systems. The interval spans the 2.5 to 97.5 % quantiles of the difference (Efron 1979); that of the Fréchet
/// distance is 1.96 standard deviations about the difference. An item's rank is its mean over the repeats that ranked
/// it. The Fréchet distance always compares all real motions with all motions of a system, whatever the protocol says;
/// its name states this.
///
/// # Errors
/// As [`crate::score::score`]; or the edits lack one of the systems.
pub fn compare(
    answered: &Answered,
    names: [&str; 2],
    evaluators: Evaluators<'_>,
    protocol: &Protocol,
    progress: &dyn Progress,
) -> Result<Vec<Comparison>, Error> {
    protocol.check()?;
    let test_set = TestSet::new(answered, protocol)?;
    let is_missing = |name: &&str| !test_set.systems.contains_key(name);
    if let Some(missing) = names.into_iter().find(is_missing) {
        let known: Vec<&str> = test_set.systems.keys().copied().collect();
        return Err(Error::Invalid(format!(
            "there is no system {missing:?} among the edits; there are: {}",
            known.join(", ")
        )));
    }
    let measured = measured(&test_set, evaluators, protocol, progress)?;
    let tasks = test_set.tasks();
    progress.begin("compare", Some(tasks.len() as u64));
    let mut comparisons = Vec::with_capacity(tasks.len());
    for (task, indices) in tasks {
        let of_task = OfTask::new(task, &indices, &test_set, &measured, protocol)?;
        comparisons.push(compared(&of_task, names, evaluators.encoder)?);
        progress.advance(1);
    }
    progress.finish(&format!("{} tasks", comparisons.len()));
    Ok(comparisons)
}

/// Compares two systems on the items of a task: in FID of whole sets, where there are enough items, and in the metrics
/// of items.
fn compared(
    of_task: &OfTask<'_>,
    names: [&str; 2],
    encoder: &dyn MotionEncoder,
) -> Result<Comparison, Error> {
    let systems = &of_task.systems;
    let place = |name: &str| systems.iter().position(|system| system.name == name);
    let pair = names.map(|name| place(name).expect("the test set has its edits"));
    let real = &systems[0].takes[0].latents;
    let [num_items, width] = [real.raw.num_rows(), real.raw.num_cols()];
    let mut differences = Vec::new();
    if num_items >= fid::min_items(width) {
        let sides = pair.map(|place| &systems[place]);
        let (task, resamples) = (of_task.task, &of_task.resamples);
        differences.extend(fid_difference(task, &real.unit, sides, resamples)?);
    }
    differences.extend(of_task.pairing(pair).differences(metric::ALL));
    let protocol = whole_sets(of_task.protocol).name_of_comparison(num_items);
    let protocol = of_task.named(protocol);
    let unranked = of_task.unranked(encoder);
    let mut comparison = Comparison::new(of_task, pair, protocol, encoder, unranked, differences);
    if let Some(note) = shortage_of_fid(FID_NAME, num_items, width) {
        comparison.notes.insert(0, note);
    }
    Ok(comparison)
}

/// Protocol of a comparison. FID uses whole sets, because a resample of a half is too small.
fn whole_sets(protocol: &Protocol) -> Protocol {
    Protocol {
        fid_sample: FidSample::All,
        interval: Spread::Targets,
        ..*protocol
    }
}

/// Two systems on the same items.
pub(crate) struct Pairing<'a> {
    pub(crate) task: &'a str,
    pub(crate) real: &'a OfItems,
    pub(crate) sides: [&'a OfItems; 2],
    pub(crate) resamples: &'a Resamples,
}

impl Pairing<'_> {
    /// Differences in the metrics for which both systems have values. A metric of [`CLAIMS`] whose good values are
    /// those near real data gets a second row: the distance from the value of the item's target.
    pub(crate) fn differences(&self, metrics: &[&'static Metric]) -> Vec<Difference> {
        let mut found = Vec::new();
        for &metric in metrics {
            if matches!(metric.measure, Measure::Rank(_, RankSummary::Median)) {
                continue;
            }
            let [Some(a), Some(b)] = self.sides.map(|side| side.get(metric)) else {
                continue;
            };
            let better = (metric.better)(self.task);
            let is_claim = CLAIMS.contains(&metric);
            let claim = Some(metric).filter(|_| is_claim && better != Better::NearReal);
            found.extend(self.difference(metric.name, (metric, better), [a, b], claim));
            if let (true, Better::NearReal, Some(real)) = (is_claim, better, self.real.get(metric))
            {
                let distances = [a, b].map(|side| -> Vec<f64> {
                    let values = side.iter().zip(real);
                    values.map(|(value, real)| (value - real).abs()).collect()
                });
                let name = format!("{metric} from the target's");
                let sides = distances.each_ref();
                let kind = (metric, Better::Lower);
                found.extend(self.difference(&name, kind, sides, Some(metric)));
            }
        }
        found
    }

    /// The mean difference over the items, second system minus first; `None` if no item has both values.
    fn difference(
        &self,
        name: &str,
        (metric, better): (&'static Metric, Better),
        [a, b]: [&Vec<f64>; 2],
        claim: Option<&'static Metric>,
    ) -> Option<Difference> {
        // Items outside of all galleries have NaN as value.
        let differences: Vec<f64> = a.iter().zip(b).map(|(a, b)| b - a).collect();
        let mean_of = |values: &[f64]| {
            let known = values.iter().zip(&differences);
            let known = known.filter(|(_, difference)| difference.is_finite());
            mean(known.map(|(value, _)| *value)).unwrap_or(f64::NAN)
        };
        let values = [mean_of(a), mean_of(b)];
        let mut resampled = self.resamples.means(&differences);
        if resampled.is_empty() || values.iter().any(|value| !value.is_finite()) {
            return None;
        }
        let targets = self.resamples.num_targets(&differences);
        let interval = interval(&mut resampled, targets);
        Some(Difference {
            items: differences.iter().filter(|value| value.is_finite()).count(),
            claim,
            ..Difference::new(name, metric, better, values, interval)
        })
    }
}

/// Name of the Fréchet distance in comparisons, which differs from the FID of the tables.
const FID_NAME: &str = "FID of whole sets";

/// The difference in FID, each a mean over the takes of a system; `None` if no resample has at least [`MIN_ROWS`] rows.
fn fid_difference(
    task: &str,
    real: &Matrix,
    sides: [&System<'_>; 2],
    resamples: &Resamples,
) -> Result<Option<Difference>, Error> {
    let both = |indices: &[usize]| -> Result<[f64; 2], Error> {
        let takes = sides.iter().flat_map(|side| &side.takes);
        let takes = takes.map(|take| take.latents.unit.select_rows(indices));
        let found = fid::distances(&real.select_rows(indices), takes)?;
        let (a, b) = found.split_at(sides[0].takes.len());
        Ok([a, b].map(|takes| takes.iter().sum::<f64>() / takes.len() as f64))
    };
    let all: Vec<usize> = (0..real.num_rows()).collect();
    let values = both(&all)?;
    let draws: Vec<Vec<usize>> = resamples
        .weights(PAIR_RESAMPLES)
        .map(|weights| drawn(&all, &weights))
        .filter(|drawn| drawn.len() >= MIN_ROWS)
        .collect();
    let resampled = draws
        .par_iter()
        .map(|drawn| both(drawn).map(|[a, b]| b - a))
        .collect::<Result<Vec<f64>, Error>>()?;
    Ok((!resampled.is_empty()).then(|| {
        let difference = values[1] - values[0];
        let targets = resamples.num_targets(&vec![0.0; real.num_rows()]);
        let interval = interval_about(difference, &resampled, targets);
        Difference {
            items: real.num_rows(),
            ..Difference::new(FID_NAME, &FID, (FID.better)(task), values, interval)
        }
    }))
}

/// Ends of an interval from resampled differences; `None` if there are too few targets.
fn interval(resampled: &mut [f64], targets: usize) -> Option<[f64; 2]> {
    (targets >= MIN_TARGETS as usize).then(|| {
        [TAIL, 1.0 - TAIL]
            .map(|share| quantile(resampled, share).expect("resamples of a known difference"))
    })
}

/// Ends of an interval about a difference in FID; `None` if there are too few targets. Drawing with replacement inflates
/// FID, for each system by another amount, so the quantiles need not enclose the difference.
fn interval_about(difference: f64, resampled: &[f64], targets: usize) -> Option<[f64; 2]> {
    let half = Interval::of_resamples(difference, resampled, &[], 0.0).ci95;
    let half = half.unwrap_or(0.0);
    (targets >= MIN_TARGETS as usize).then_some([difference - half, difference + half])
}

impl Difference {
    fn new(
        name: &str,
        metric: &Metric,
        better: Better,
        [a, b]: [f64; 2],
        interval: Option<[f64; 2]>,
    ) -> Self {
        // The quantiles of few, uneven values may lie on the other side of 0 than the difference.
        let rises = b > a && interval.is_some_and(|[low, _]| low > 0.0);
        let falls = b < a && interval.is_some_and(|[_, high]| high < 0.0);
        let better = match better {
            Better::Higher if rises => Some("B"),
            Better::Higher if falls => Some("A"),
            Better::Lower if rises => Some("A"),
            Better::Lower if falls => Some("B"),
            Better::Higher | Better::Lower | Better::NearReal => None,
        };
        Self {
            metric: name.to_owned(),
            a,
            b,
            difference: b - a,
            interval,
            better,
            items: 0,
            decimals: metric.decimals,
            claim: None,
        }
    }

    /// Difference and interval as tables print them, such as `+3.10 [+1.20, +5.00]`.
    fn text(&self) -> String {
        let digits = self.decimals;
        let difference = self.difference;
        match self.interval {
            Some([low, high]) => {
                format!("{difference:+.digits$} [{low:+.digits$}, {high:+.digits$}]")
            }
            None => format!("{difference:+.digits$}"),
        }
    }
}

impl Comparison {
    /// A comparison of two systems of a task, given by their positions. `protocol` is in words. `unranked` is the reason
    /// why the encoder cannot rank systems of the task; with one, no system is called better.
    pub(crate) fn new(
        of_task: &OfTask<'_>,
        pair: [usize; 2],
        protocol: String,
        encoder: &dyn MotionEncoder,
        unranked: Option<String>,
        mut differences: Vec<Difference>,
    ) -> Self {
        let counts = &of_task.counts;
        if unranked.is_some() {
            for difference in &mut differences {
                difference.better = None;
            }
        }
        Self {
            task: of_task.task.to_owned(),
            n: counts.count as usize,
            targets: counts.targets,
            items_digest: counts.digest.clone(),
            systems: pair.map(|place| of_task.systems[place].name.to_owned()),
            protocol,
            encoder_hash: encoder.hash(),
            unranked,
            differences,
            notes: shortage_of_targets(counts.targets).into_iter().collect(),
        }
    }

    /// A sentence that names the metrics of [`CLAIMS`] by which the second system is better or worse than the first,
    /// and those that show nothing; `None` if the encoder cannot rank systems or no such metric was measured.
    ///
    /// A claim needs two metrics, because a system can improve any one at the cost of the others. If two say better and
    /// two say worse, nothing is claimed.
    pub fn claim(&self) -> Option<String> {
        if self.unranked.is_some() {
            return None;
        }
        let of = |better: Option<&str>| -> Vec<String> {
            let rows = self.differences.iter();
            let rows = rows.filter_map(|row| Some((row.claim?, row)));
            rows.filter(|(_, row)| row.better == better)
                .map(|(metric, row)| format!("{} {}", spoken(metric), row.text()))
                .collect()
        };
        let (better, worse, nothing) = (of(Some("B")), of(Some("A")), of(None));
        let says = |metrics: &[String], what: &str| match metrics {
            [] => None,
            [one] => Some(format!("{one} alone says that it is {what}")),
            _ => Some(format!("{} agree that it is {what}", listed(metrics))),
        };
        let silent = match &nothing[..] {
            [] => None,
            [one] => Some(format!("{one} shows nothing")),
            _ => Some(format!("{} show nothing", listed(&nothing))),
        };
        let found = [says(&better, "better"), says(&worse, "worse"), silent];
        let mut found: Vec<String> = found.into_iter().flatten().collect();
        if found.is_empty() {
            return None;
        }
        if better.len().min(worse.len()) > 1 {
            found.push("the measures contradict each other, so nothing is claimed".to_owned());
        } else if better.len().max(worse.len()) < 2 {
            found.push("no two agree, so nothing is claimed".to_owned());
        }
        let [a, b] = &self.systems;
        Some(format!("{b} against {a}: {}.", found.join("; ")))
    }

    /// Comparisons as one table of comma-separated values, one line per metric of each task. Numbers keep all their
    /// digits.
    pub fn csv(comparisons: &[Self]) -> String {
        let rows = comparisons.iter().flat_map(|comparison| {
            let [a, b] = &comparison.systems;
            comparison.differences.iter().map(move |row| {
                let end = |at: usize| {
                    row.interval
                        .map_or_else(String::new, |ends| ends[at].to_string())
                };
                line(&[
                    comparison.task.clone(),
                    a.clone(),
                    b.clone(),
                    row.metric.clone(),
                    comparison.protocol.clone(),
                    comparison.encoder_hash.clone(),
                    row.items.to_string(),
                    comparison.targets.to_string(),
                    comparison.items_digest.clone(),
                    row.a.to_string(),
                    row.b.to_string(),
                    row.difference.to_string(),
                    end(0),
                    end(1),
                    row.better.unwrap_or_default().to_owned(),
                ])
            })
        });
        format!("{CSV_HEAD}\n{}", rows.collect::<String>())
    }

    /// The comparison as a table.
    pub fn grid(&self) -> Grid {
        let [a, b] = &self.systems;
        let mut title = String::new();
        if let Some(reason) = &self.unranked {
            title += &format!("No system is called better: {reason}.\n");
        }
        let (task, n, targets, ids) = (&self.task, self.n, self.targets, &self.items_digest);
        let (protocol, encoder) = (&self.protocol, &self.encoder_hash);
        title += &format!(
            "{task}: A = {a}, B = {b}, intervals of B - A; {n} items of {targets} targets (ids {ids}); {protocol}; \
             encoder {encoder:.12}"
        );
        Grid {
            title,
            head: ["Metric", "A", "B", "B - A", "from", "to", "better"]
                .map(str::to_owned)
                .to_vec(),
            rows: self
                .differences
                .iter()
                .map(|row| {
                    let digits = row.decimals;
                    let number = |value: f64| format!("{value:.digits$}");
                    let end = |at: usize| {
                        row.interval
                            .map_or_else(|| ABSENT.to_owned(), |ends| number(ends[at]))
                    };
                    let metric = match row.items == self.n {
                        true => row.metric.clone(),
                        false => format!("{}, {} items", row.metric, row.items),
                    };
                    vec![
                        metric,
                        number(row.a),
                        number(row.b),
                        format!("{:+.digits$}", row.difference),
                        end(0),
                        end(1),
                        row.better.unwrap_or(ABSENT).to_owned(),
                    ]
                })
                .collect(),
        }
    }
}

/// The name of a metric without its unit, for use in a sentence.
fn spoken(metric: &Metric) -> String {
    let name = metric.name.split(" (").next().unwrap_or(metric.name);
    match name.strip_prefix("E2T ") {
        Some(recall) => recall.to_owned(),
        None => name.to_lowercase(),
    }
}

/// Joins words as a list with "and".
fn listed(words: &[String]) -> String {
    match words {
        [] => String::new(),
        [one] => one.clone(),
        [first @ .., last] => format!("{} and {last}", first.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metric::motion_quality::FOOT_SLIDE;
    use crate::metric::position_error::{ERROR_INSIDE, ERROR_OUTSIDE};
    use crate::metric::retrieval::E2T_RECALL_1;
    use crate::protocol::Protocol;

    /// Compares two systems on `num_items` items, each with its own target. `values` are those of the first system, the
    /// second system and the target.
    fn compared(num_items: usize, values: &[(&'static Metric, [f64; 3])]) -> Comparison {
        let of = |side: usize| -> OfItems {
            let of_metric = |(metric, values): &(&'static Metric, [f64; 3])| {
                (*metric, vec![values[side]; num_items])
            };
            values.iter().map(of_metric).collect()
        };
        let targets: Vec<String> = (0..num_items).map(|item| item.to_string()).collect();
        let targets = targets.iter().map(String::as_str);
        let (a, b, real) = (of(0), of(1), of(2));
        Comparison {
            task: "semantic".to_owned(),
            n: num_items,
            targets: num_items as u32,
            items_digest: String::new(),
            systems: ["Identity", "ours"].map(str::to_owned),
            protocol: String::new(),
            encoder_hash: String::new(),
            unranked: None,
            differences: Pairing {
                task: "semantic",
                real: &real,
                sides: [&a, &b],
                resamples: &Resamples::new(targets, &Protocol::default()),
            }
            .differences(&CLAIMS),
            notes: Vec::new(),
        }
    }

    const ALL_FOUR: [(&Metric, [f64; 3]); 4] = [
        (&E2T_RECALL_1, [40.0, 64.0, 100.0]),
        // Both foot slides differ from the target's by the same amount, in opposite directions.
        (&FOOT_SLIDE, [0.0, 0.2, 0.1]),
        (&ERROR_INSIDE, [10.0, 8.0, 0.0]),
        (&ERROR_OUTSIDE, [0.0, 1.0, 0.0]),
    ];

    #[test]
    fn a_claim_names_what_agrees_and_what_shows_nothing() {
        let claim = |count: usize, values: &[(&'static Metric, [f64; 3])]| {
            compared(count, values).claim().expect("measured")
        };
        assert_eq!(
            claim(10, &ALL_FOUR),
            "ours against Identity: R@1 +24.00 [+24.00, +24.00] and error inside the mask -2.00 [-2.00, -2.00] agree \
             that it is better; error outside the mask +1.00 [+1.00, +1.00] alone says that it is worse; foot slide \
             +0.000 [+0.000, +0.000] shows nothing."
        );
        assert_eq!(
            claim(10, &ALL_FOUR[..2]),
            "ours against Identity: R@1 +24.00 [+24.00, +24.00] alone says that it is better; foot slide +0.000 \
             [+0.000, +0.000] shows nothing; no two agree, so nothing is claimed."
        );
        let split = [
            (&E2T_RECALL_1, [40.0, 64.0, 100.0]),
            (&FOOT_SLIDE, [0.0, 0.1, 0.1]),
            (&ERROR_INSIDE, [8.0, 10.0, 0.0]),
            (&ERROR_OUTSIDE, [0.0, 1.0, 0.0]),
        ];
        assert_eq!(
            claim(10, &split),
            "ours against Identity: R@1 +24.00 [+24.00, +24.00] and foot slide -0.100 \
             [-0.100, -0.100] agree that it is better; error inside the mask +2.00 [+2.00, +2.00] and \
             error outside the mask +1.00 [+1.00, +1.00] agree that it is worse; the measures \
             contradict each other, so nothing is claimed."
        );
        // Nine targets are too few for an interval, and so for a claim.
        assert_eq!(
            claim(9, &ALL_FOUR[..1]),
            "ours against Identity: R@1 +24.00 shows nothing; no two agree, so nothing is claimed."
        );
        let mut weak = compared(10, &ALL_FOUR);
        weak.unranked = Some("it guesses".to_owned());
        assert_eq!(weak.claim(), None);
        assert_eq!(compared(10, &[]).claim(), None);
    }

    #[test]
    fn no_system_is_better_against_the_sign_of_the_difference() {
        let better = |values: [f64; 2], interval: [f64; 2]| {
            Difference::new(FID_NAME, &FID, Better::Lower, values, Some(interval)).better
        };
        assert_eq!(better([2.0, 1.0], [-1.5, -0.5]), Some("B"));
        assert_eq!(better([2.0, 1.0], [0.5, 1.5]), None);
        assert_eq!(better([1.0, 2.0], [-1.5, -0.5]), None);
        // The interval has the spread of the resamples, and lies about the difference even if all of them are larger.
        assert_eq!(interval_about(-1.0, &[1.0, 3.0], 10), Some([-2.96, 0.96]));
        assert_eq!(interval_about(-1.0, &[1.0, 3.0], 9), None);
    }

    #[test]
    fn a_slide_is_better_the_nearer_it_is_to_the_targets() {
        for (values, better) in [
            ([0.0, 0.1, 0.1], Some("B")),
            ([0.1, 0.0, 0.1], Some("A")),
            ([0.5, 0.2, 0.1], Some("B")),
            ([0.0, 0.2, 0.1], None),
        ] {
            let found = compared(10, &[(&FOOT_SLIDE, values)]);
            let [plain, distance] = &found.differences[..] else {
                panic!("{found:?}");
            };
            let found = (plain.better, distance.better);
            assert_eq!(found, (None, better), "{values:?}");
            assert_eq!(distance.metric, "Foot slide (m/s) from the target's");
            assert!((distance.a - (values[0] - values[2]).abs()).abs() < 1e-12);
        }
    }

    #[test]
    fn every_line_of_csv_names_its_task_systems_items_protocol_and_encoder() {
        let comparison = |task: &str, count: usize| Comparison {
            task: task.to_owned(),
            items_digest: "a1b2".to_owned(),
            protocol: "galleries of 32, seed 0".to_owned(),
            encoder_hash: "0123".to_owned(),
            ..compared(count, &ALL_FOUR[..1])
        };
        let both = [comparison("semantic", 10), comparison("style", 9)];
        let named = "Identity,ours,E2T R@1,\"galleries of 32, seed 0\",0123";
        let expected = format!(
            "task,system_a,system_b,metric,protocol,encoder_hash,n,targets,items_digest,a,b,difference,from,to,better\n\
             semantic,{named},10,10,a1b2,40,64,24,24,24,B\nstyle,{named},9,9,a1b2,40,64,24,,,\n"
        );
        assert_eq!(Comparison::csv(&both), expected);
    }

    #[test]
    fn too_few_targets_have_no_interval() {
        for (count, is_known) in [(9, false), (10, true)] {
            let found = compared(count, &ALL_FOUR);
            let mut rows = found.differences.iter();
            assert!(rows.all(|row| row.interval.is_some() == is_known));
            let from = &found.grid().rows[0][4];
            assert_eq!(from, if is_known { "24.00" } else { "–" });
        }
    }
}
