//! How different the motions generated for one condition are from each other.

use datasets_spec::Rng;

use super::diversity::diversity_of_pairs;
use super::{check_finite, check_size, draw_without_replacement};
use crate::Error;
use crate::linalg::Matrix;

const METRIC: &str = "Multimodality";

/// Motions generated for each condition in the T2M evaluation.
pub const T2M_REPEATS: usize = 30;
/// Conditions compared in the T2M evaluation.
pub const T2M_CONDITIONS: usize = 100;
/// Pairs drawn for each condition in the T2M evaluation.
pub const T2M_PAIRS: usize = 10;

/// Pairs of different positions below `num_repeats`: two lists, each without repetition, that never
/// hold the same position in the same place.
///
/// # Errors
/// There are not more repeats than pairs.
///
/// # Source
/// T2M evaluation: 30 repeats, 10 pairs, both lists drawn without replacement. There a motion may
/// meet itself, which is at no distance and says nothing of how motions differ.
pub fn pairs(
    num_repeats: usize,
    num_pairs: usize,
    rng: &mut Rng,
) -> Result<[Vec<usize>; 2], Error> {
    if num_repeats <= num_pairs {
        return Err(Error::TooFewRows {
            metric: METRIC,
            needed: num_pairs + 1,
            found: num_repeats,
        });
    }
    // Pairs are neighbours in a random circular order, so that no take is paired with itself and
    // every other take is an equally likely partner.
    let round = draw_without_replacement(num_repeats, num_repeats, rng);
    let second = (1..=num_pairs).map(|place| round[place % num_repeats]);
    Ok([round[..num_pairs].to_vec(), second.collect()])
}

/// The mean distance between motions of the same condition, over all conditions and pairs. The
/// same positions are drawn for every condition.
///
/// # Shapes
/// `conditions` holds one `[R, D]` matrix of latents for each condition.
///
/// # Errors
/// There is no condition, the conditions differ in size, there are not more repeats than pairs, or
/// a latent is not finite.
///
/// # Source
/// T2M evaluation, but for [`pairs`]. The paper names the metric and prints it in no table.
pub fn multimodality(conditions: &[Matrix], num_pairs: usize, rng: &mut Rng) -> Result<f64, Error> {
    let num_repeats = conditions.first().map_or(0, Matrix::num_rows);
    let [first, second] = pairs(num_repeats, num_pairs, rng)?;
    multimodality_of_pairs(conditions, &first, &second)
}

/// The mean distance between the latents at paired positions of each condition.
///
/// # Errors
/// There is no condition or no pair, the conditions or lists differ in size, or a latent is not
/// finite.
///
/// # Panics
/// If a position does not exist.
pub fn multimodality_of_pairs(
    conditions: &[Matrix],
    first: &[usize],
    second: &[usize],
) -> Result<f64, Error> {
    let Some(example) = conditions.first() else {
        return Err(Error::TooFewRows {
            metric: METRIC,
            needed: 1,
            found: 0,
        });
    };
    let mut total = 0.0;
    for latents in conditions {
        check_size(
            METRIC,
            "number of repeats",
            latents.num_rows(),
            example.num_rows(),
        )?;
        check_size(
            METRIC,
            "latent width",
            latents.num_cols(),
            example.num_cols(),
        )?;
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
        let value = multimodality_of_pairs(
            &conditions,
            &golden.indices("in.mm.first"),
            &golden.indices("in.mm.second"),
        )
        .expect("valid");
        golden.check_scalar(
            "multimodality",
            value,
            golden.scalar("out.mm.value"),
            0.0,
            1e-9,
        );
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
        // Takes at distance 1 from each other: a pair of equals would lower the mean.
        let takes = Matrix::identity(12);
        let value = multimodality(&[takes], T2M_PAIRS, &mut Seed(3).rng(&["mm"])).expect("valid");
        assert!((value - 2f64.sqrt()).abs() < 1e-12, "{value}");
    }

    #[test]
    fn conditions_that_always_give_the_same_motion_have_none() {
        let conditions = [
            Matrix::from_rows(&[[1.0]; 4]),
            Matrix::from_rows(&[[5.0]; 4]),
        ];
        let mut rng = Seed(3).rng(&["mm"]);
        assert_eq!(multimodality(&conditions, 3, &mut rng).expect("valid"), 0.0);
        assert!(multimodality(&conditions, 4, &mut rng).is_err());
        assert!(multimodality(&[], 1, &mut rng).is_err());
        let spread = [Matrix::from_rows(&[[0.0], [2.0]])];
        assert_eq!(
            multimodality_of_pairs(&spread, &[0], &[1]).expect("valid"),
            2.0
        );
    }
}
