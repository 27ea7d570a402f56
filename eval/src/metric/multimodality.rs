//! Multimodality: how much the motions generated for one condition differ from each other.

use datasets_spec::Rng;

use super::definition::{Better, Measure, Metric, Part, TakesSample, check_count, check_finite};
use super::diversity::diversity_of_pairs;
use crate::Error;
use crate::linalg::Matrix;
use crate::protocol::draw_without_replacement;

const METRIC: &str = "Multimodality";

/// Mean distance between latents of the same item, generated with different seeds.
pub static MULTIMODALITY: Metric = Metric {
    name: METRIC,
    about: "mean distance of the raw latents of ten pairs of different takes of an item, over up to 100 random items",
    part: Part::Further,
    better: |_| Better::Higher,
    decimals: 2,
    measure: Measure::Takes(of_sample),
};

/// Number of conditions in the T2M evaluation.
pub const T2M_CONDITIONS: usize = 100;
/// Number of pairs drawn for each condition in the T2M evaluation.
pub const T2M_PAIRS: usize = 10;

/// Values of at most [`T2M_CONDITIONS`] items drawn at random; empty if the system made too few takes for [`T2M_PAIRS`]
/// pairs.
fn of_sample(sample: &TakesSample<'_>) -> Result<Vec<(usize, f64)>, Error> {
    let num_takes = sample.takes.len();
    if num_takes <= T2M_PAIRS {
        return Ok(Vec::new());
    }
    let mut rng = sample.protocol.rng("multimodality", sample.repeat);
    let num_items = sample.takes[0].raw.num_rows();
    let count = num_items.min(T2M_CONDITIONS);
    let items = draw_without_replacement(num_items, count, &mut rng);
    let [first, second] = pairs(num_takes, T2M_PAIRS, &mut rng)?;
    items
        .into_iter()
        .map(|item| {
            let rows: Vec<&[f64]> = sample.takes.iter().map(|take| take.raw.row(item)).collect();
            let latents = [Matrix::from_rows(&rows)];
            Ok((item, multimodality_of_pairs(&latents, &first, &second)?))
        })
        .collect()
}

/// Pairs of different positions below `num_repeats`, as two lists. Each list has no duplicates, and the lists differ at
/// every index.
///
/// # Errors
/// `num_repeats` is not greater than the number of pairs.
///
/// # Source
/// T2M evaluation: 30 repeats, 10 pairs, both lists drawn without replacement. The T2M code may pair a motion with
/// itself, which adds a distance of 0; this function does not.
pub fn pairs(
    num_repeats: usize,
    num_pairs: usize,
    rng: &mut Rng,
) -> Result<[Vec<usize>; 2], Error> {
    check_count(METRIC, num_repeats, num_pairs + 1)?;
    // Pairs are neighbours in a random circular order, so that no take is paired with itself and
    // every other take is an equally likely partner.
    let round = draw_without_replacement(num_repeats, num_repeats, rng);
    let second = (1..=num_pairs).map(|place| round[place % num_repeats]);
    Ok([round[..num_pairs].to_vec(), second.collect()])
}

/// The mean distance between the latents at paired positions of each condition.
///
/// # Errors
/// There is no condition or no pair, the lists differ in size, or a latent is not finite.
///
/// # Panics
/// If a position does not exist.
pub fn multimodality_of_pairs(
    conditions: &[Matrix],
    first: &[usize],
    second: &[usize],
) -> Result<f64, Error> {
    check_count(METRIC, conditions.len(), 1)?;
    let mut total = 0.0;
    for latents in conditions {
        check_finite(METRIC, latents)?;
        total += diversity_of_pairs(latents, first, second)?;
    }
    Ok(total / conditions.len() as f64)
}

#[cfg(test)]
mod tests {
    use datasets_spec::Seed;

    use super::*;
    use crate::golden::Golden;

    #[test]
    fn golden_multimodality_agrees_with_the_reference() {
        let golden = Golden::read("metrics_t2m");
        let (shape, numbers) = golden.tensor("in.mm.features");
        let [num_conditions, num_repeats, width] = shape[..] else {
            panic!("in.mm.features is not three-dimensional");
        };
        let conditions: Vec<Matrix> = numbers
            .chunks_exact(num_repeats * width)
            .map(|block| Matrix::new(num_repeats, width, block.to_vec()))
            .collect();
        assert_eq!(conditions.len(), num_conditions);
        let [first, second] = ["in.mm.first", "in.mm.second"].map(|name| golden.indices(name));
        let value = multimodality_of_pairs(&conditions, &first, &second).expect("valid");
        let expected = golden.scalar("out.mm.value");
        golden.check_scalar("multimodality", value, expected, 0.0, 1e-9);
    }

    #[test]
    fn a_motion_is_never_compared_with_itself() {
        for seed in 0..50 {
            let [first, second] =
                pairs(11, T2M_PAIRS, &mut Seed(seed).rng(&["pairs"])).expect("enough");
            for list in [&first, &second] {
                let mut seen = list.clone();
                seen.sort_unstable();
                seen.dedup();
                assert_eq!(seen.len(), T2M_PAIRS);
            }
            assert!(first.iter().zip(&second).all(|(a, b)| a != b));
        }
        // All takes are at distance √2 from each other, so pairing a take with itself would lower the mean.
        let takes = Matrix::diagonal(&[1.0; 12]);
        let [first, second] = pairs(12, T2M_PAIRS, &mut Seed(3).rng(&["mm"])).expect("enough");
        let value = multimodality_of_pairs(&[takes], &first, &second).expect("valid");
        assert!((value - 2f64.sqrt()).abs() < 1e-12, "{value}");
    }

    #[test]
    fn conditions_that_always_give_the_same_motion_have_none() {
        let conditions = [1.0, 5.0].map(|value| Matrix::from_rows(&[[value]; 4]));
        let value = multimodality_of_pairs(&conditions, &[0, 1, 2], &[1, 2, 3]);
        assert_eq!(value.expect("valid"), 0.0);
        assert!(pairs(4, 4, &mut Seed(3).rng(&["mm"])).is_err());
        assert!(multimodality_of_pairs(&[], &[0], &[1]).is_err());
        let broken = [Matrix::from_rows(&[[1.0], [f64::NAN]])];
        let error = multimodality_of_pairs(&broken, &[0], &[1]).expect_err("refused");
        assert_eq!(error.to_string(), "Multimodality: row 1 is not finite");
        let spread = [Matrix::from_rows(&[[0.0], [2.0]])];
        let value = multimodality_of_pairs(&spread, &[0], &[1]);
        assert_eq!(value.expect("valid"), 2.0);
    }
}
