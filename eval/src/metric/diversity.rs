//! Diversity: how much the motions of a set differ from each other.

use datasets_spec::Rng;

use super::definition::{
    Better, Draws, Measure, Metric, Part, SetSample, check_count, check_finite, check_size,
    distance,
};
use crate::Error;
use crate::linalg::Matrix;
use crate::protocol::{Protocol, draw_without_replacement};

const METRIC: &str = "Diversity";

/// Mean distance between latents paired at random. It is reported only if there are at least as many items as pairs.
pub static DIVERSITY: Metric = Metric {
    name: METRIC,
    about: "mean distance of 300 random pairs of raw latents, as the encoder gives them",
    part: Part::Paper,
    better: |_| Better::NearReal,
    decimals: 2,
    measure: Measure::Set(of_sample, Draws::Pairs),
};

/// Pairs of a bootstrap resample, as a multiple of its items: so many that their choice hardly changes the mean. With the
/// pairs of one repeat, the interval would mostly show that choice.
const RESAMPLED_PAIRS: usize = 20;

/// Variance that the choice of pairs adds to a bootstrap resample of this many items, as a share of what it adds to a
/// repeat.
pub(crate) fn noise_of_resample(num_items: usize, protocol: &Protocol) -> f64 {
    let num_pairs = protocol.diversity_pairs.min(num_items);
    num_pairs as f64 / (RESAMPLED_PAIRS * num_items.max(1)) as f64
}

/// Smallest set from which two different motions can be drawn.
pub const MIN_ROWS: usize = 2;

fn of_sample(sample: &SetSample<'_>) -> Result<Option<Vec<f64>>, Error> {
    // A bootstrap resample may hold fewer items than the set.
    let (num_items, num_drawn) = (sample.sets[0].raw.num_rows(), sample.items.len());
    let num_pairs = sample.protocol.diversity_pairs;
    if num_items < num_pairs || num_drawn < MIN_ROWS {
        return Ok(None);
    }
    let mut rng = sample.protocol.rng("diversity", sample.draw);
    let (rounds, num_pairs) = match sample.resampled {
        true => (RESAMPLED_PAIRS, num_drawn),
        false => (1, num_pairs),
    };
    let (mut first, mut second) = (Vec::new(), Vec::new());
    for _ in 0..rounds {
        let drawn = draw_pairs(num_drawn, num_pairs, &mut rng);
        for (all, drawn) in [&mut first, &mut second].into_iter().zip(drawn) {
            all.extend(drawn.into_iter().map(|place| sample.items[place]));
        }
    }
    // The latents were checked to be finite when they were encoded.
    let values = sample.sets.iter();
    let values = values.map(|latents| mean_distance(&latents.raw, &first, &second));
    Ok(Some(values.collect()))
}

/// Two lists of positions, each drawn without replacement.
fn draw_pairs(num_rows: usize, num_pairs: usize, rng: &mut Rng) -> [Vec<usize>; 2] {
    let num_pairs = num_pairs.min(num_rows);
    [(); 2].map(|()| draw_without_replacement(num_rows, num_pairs, rng))
}

/// The mean distance between latents paired at random: two lists of positions are drawn, each
/// without replacement, so a latent may be paired with itself.
///
/// At most `num_pairs` pairs are drawn; a smaller set uses each latent once in each list.
///
/// # Shapes
/// `latents` is `[N, D]`.
///
/// # Errors
/// There are fewer than [`MIN_ROWS`] latents, or one is not finite.
///
/// # Source
/// T2M evaluation with 300 pairs. Its code requires more than 300 rows; the paper also reports the metric for smaller
/// sets, without saying how.
pub fn diversity(latents: &Matrix, num_pairs: usize, rng: &mut Rng) -> Result<f64, Error> {
    check_count(METRIC, latents.num_rows(), MIN_ROWS)?;
    let [first, second] = draw_pairs(latents.num_rows(), num_pairs, rng);
    diversity_of_pairs(latents, &first, &second)
}

/// The mean distance between the latents at paired positions.
///
/// # Errors
/// The lists are empty or differ in length, or a latent is not finite.
///
/// # Panics
/// If a position does not exist.
pub fn diversity_of_pairs(
    latents: &Matrix,
    first: &[usize],
    second: &[usize],
) -> Result<f64, Error> {
    check_size(METRIC, "second index list", second.len(), first.len())?;
    check_count(METRIC, first.len(), 1)?;
    check_finite(METRIC, latents)?;
    Ok(mean_distance(latents, first, second))
}

/// The mean distance between the latents at paired positions.
fn mean_distance(latents: &Matrix, first: &[usize], second: &[usize]) -> f64 {
    let total: f64 = first
        .iter()
        .zip(second)
        .map(|(&a, &b)| distance(latents.row(a), latents.row(b)))
        .sum();
    total / first.len() as f64
}

#[cfg(test)]
mod tests {
    use datasets_spec::Seed;
    use rand::RngExt;

    use super::*;
    use crate::golden::Golden;
    use crate::metric::Latents;
    use crate::metric::interval::Interval;
    use crate::protocol::{SET_RESAMPLES, T2M_DIVERSITY_PAIRS};
    use crate::score::{Resamples, drawn};

    #[test]
    fn golden_diversity_agrees_with_the_reference() {
        let golden = Golden::read("metrics_t2m");
        let [first, second] = ["in.div.first", "in.div.second"].map(|name| golden.indices(name));
        let features = golden.matrix("in.div.features");
        let value = diversity_of_pairs(&features, &first, &second).expect("valid");
        let expected = golden.scalar("out.div.value");
        golden.check_scalar("diversity", value, expected, 0.0, 1e-9);
    }

    #[test]
    fn two_points_are_met_on_both_sides() {
        let latents = Matrix::from_rows(&[[0.0, 0.0], [3.0, 4.0]]);
        let value = diversity_of_pairs(&latents, &[0, 1], &[1, 1]).expect("valid");
        assert_eq!(value, 2.5);
        // Each list contains both points, so either all pairs or none are of equal points.
        let drawn =
            diversity(&latents, T2M_DIVERSITY_PAIRS, &mut Seed(1).rng(&["two"])).expect("valid");
        assert!(drawn == 0.0 || drawn == 5.0, "{drawn}");
    }

    #[test]
    fn the_interval_is_as_wide_as_the_values_of_other_sets_vary() {
        // Sets of 400 latents whose numbers are nearly normal.
        let set = |number: u64| -> Latents {
            let mut rng = Seed(number).rng(&["set"]);
            let mut normal = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
            let rows = (0..400).map(|_| [normal(), 2.0 * normal()]);
            let raw = Matrix::from_rows(&rows.collect::<Vec<_>>());
            Latents {
                unit: raw.clone(),
                raw,
            }
        };
        let all = |latents: &Latents| {
            let rows = 0..latents.raw.num_rows();
            let pairs = rows.clone().flat_map(|a| rows.clone().map(move |b| (a, b)));
            let (first, second): (Vec<usize>, Vec<usize>) = pairs.filter(|(a, b)| a < b).unzip();
            mean_distance(&latents.raw, &first, &second)
        };
        let others: Vec<f64> = (1..101).map(|number| all(&set(number))).collect();
        let count = others.len() as f64;
        let mean = others.iter().sum::<f64>() / count;
        let variance = others
            .iter()
            .map(|value| (value - mean).powi(2))
            .sum::<f64>()
            / count;

        let (latents, protocol) = (set(0), Protocol::default());
        let items: Vec<usize> = (0..400).collect();
        let names: Vec<String> = items.iter().map(usize::to_string).collect();
        let resamples = Resamples::new(names.iter().map(String::as_str), &protocol);
        let value = |items: &[usize], draw: usize, resampled: bool| {
            let sample = SetSample {
                sets: &[&latents],
                items,
                fid_items: [&[], &[]],
                draw,
                resampled,
                protocol: &protocol,
            };
            of_sample(&sample).expect("valid").expect("enough items")[0]
        };
        let weights = resamples.weights(SET_RESAMPLES).enumerate();
        let resampled = weights.map(|(draw, weights)| value(&drawn(&items, &weights), draw, true));
        let resampled: Vec<f64> = resampled.collect();
        let repeats: Vec<f64> = (0..10).map(|draw| value(&items, draw, false)).collect();
        let share = noise_of_resample(items.len(), &protocol);
        let interval = Interval::of_resamples(mean, &resampled, &repeats, share);
        // The mean of ten repeats varies by their pairs as well.
        let kept = Interval::of(&repeats).ci95.expect("varies");
        let expected = (1.96 * variance.sqrt()).hypot(kept);
        // The standard deviations of 100 sets and of 100 resamples each have an error of 7 %.
        let found = interval.ci95.expect("varies");
        assert!((found / expected - 1.0).abs() < 0.3, "{found} {expected}");
    }

    #[test]
    fn sets_without_a_pair_are_refused() {
        let mut rng = Seed(1).rng(&["none"]);
        let one = Matrix::from_rows(&[[1.0]]);
        assert!(diversity(&one, 300, &mut rng).is_err());
        assert!(diversity_of_pairs(&one, &[], &[]).is_err());
        assert!(diversity_of_pairs(&one, &[0], &[]).is_err());
    }
}
