//! Whether a motion finds its counterpart among others.

use rayon::prelude::*;

use super::{check_finite, check_size};
use crate::Error;
use crate::linalg::{Matrix, dot};
use crate::similarity::{Pairing, Place, Rows};

const METRIC: &str = "retrieval";

/// Cut-offs k of the recall that is reported.
pub const RECALL_AT: [usize; 3] = [1, 2, 3];

/// Galleries in the paper's main tables.
pub const PAPER_GALLERY: usize = 32;

/// Largest gallery whose similarities are taken one by one; packing a larger one pays.
const SMALL_GALLERY: usize = 64;

/// What a set of ranks amounts to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Retrieval {
    /// Share of queries that find their counterpart among the first 1, 2 and 3, in percent.
    pub recall: [f64; RECALL_AT.len()],
    /// Median rank, the best being 1.
    pub median_rank: f64,
    /// Mean rank, the best being 1.
    pub average_rank: f64,
}

impl Retrieval {
    /// Summarises ranks that count from zero.
    ///
    /// # Panics
    /// If there are none.
    pub fn of_ranks(ranks: &[f64]) -> Self {
        Self {
            recall: RECALL_AT.map(|k| recall_at(ranks, k)),
            median_rank: median_rank(ranks),
            average_rank: average_rank(ranks),
        }
    }

    /// The mean over galleries of equal standing.
    ///
    /// # Panics
    /// If there are none.
    pub fn mean(parts: &[Self]) -> Self {
        assert!(!parts.is_empty(), "a mean over no galleries");
        let mean = |value: &dyn Fn(&Self) -> f64| {
            parts.iter().map(value).sum::<f64>() / parts.len() as f64
        };
        Self {
            recall: std::array::from_fn(|k| mean(&|part| part.recall[k])),
            median_rank: mean(&|part| part.median_rank),
            average_rank: mean(&|part| part.average_rank),
        }
    }
}

/// The share of ranks below k in percent. A two-way tie for the first place has rank 0.5 and counts
/// for k = 1; a three-way tie has rank 1 and does not.
///
/// # Panics
/// If there are no ranks.
pub fn recall_at(ranks: &[f64], k: usize) -> f64 {
    assert!(!ranks.is_empty(), "recall of no ranks");
    let hits = ranks.iter().filter(|&&rank| rank < k as f64).count();
    100.0 * hits as f64 / ranks.len() as f64
}

/// The median rank, counted from one; between the two middle ranks where their number is even.
///
/// # Panics
/// If there are no ranks.
pub fn median_rank(ranks: &[f64]) -> f64 {
    assert!(!ranks.is_empty(), "median of no ranks");
    let mut sorted = ranks.to_vec();
    sorted.sort_by(f64::total_cmp);
    let middle = sorted.len() / 2;
    let median = if sorted.len() % 2 == 1 {
        sorted[middle]
    } else {
        f64::midpoint(sorted[middle - 1], sorted[middle])
    };
    median + 1.0
}

/// The mean rank, counted from one.
///
/// # Panics
/// If there are no ranks.
pub fn average_rank(ranks: &[f64]) -> f64 {
    assert!(!ranks.is_empty(), "mean of no ranks");
    ranks.iter().sum::<f64>() / ranks.len() as f64 + 1.0
}

/// The rank of one entry of a row of similarities, counted from zero: the mean position of all
/// entries exactly as similar.
///
/// # Panics
/// If `truth` does not exist.
pub fn tied_rank(similarities: &[f64], truth: usize) -> f64 {
    let own = similarities[truth];
    let (nearer, equal) = similarities
        .iter()
        .fold((0, 0), |counts, &other| count(counts, other, own));
    mean_position(nearer, equal)
}

fn count((nearer, equal): (usize, usize), other: f64, own: f64) -> (usize, usize) {
    (
        nearer + usize::from(other > own),
        equal + usize::from(other == own),
    )
}

fn mean_position(nearer: usize, equal: usize) -> f64 {
    // `equal` includes the entry itself, unless its similarity overflowed.
    nearer as f64 + equal.saturating_sub(1) as f64 / 2.0
}

/// The rank of the diagonal in each row of a similarity matrix.
///
/// # Errors
/// The matrix is not square or not finite.
pub fn ranks_of_similarity(similarity: &Matrix) -> Result<Vec<f64>, Error> {
    ranks_among_equivalents(similarity, |query, other| query == other)
}

/// As [`ranks_of_similarity`], but any entry that counts as equivalent to the diagonal will do: the
/// best rank among them is taken.
///
/// # Errors
/// The matrix is not square or not finite.
///
/// # Source
/// TMR's "threshold" protocol: texts closer than a threshold describe the same motion.
pub fn ranks_among_equivalents(
    similarity: &Matrix,
    equivalent: impl Fn(usize, usize) -> bool,
) -> Result<Vec<f64>, Error> {
    check_size(
        METRIC,
        "gallery size",
        similarity.num_cols(),
        similarity.num_rows(),
    )?;
    check_finite(METRIC, similarity)?;
    Ok(similarity
        .rows()
        .enumerate()
        .map(|(query, row)| {
            (0..row.len())
                .filter(|&other| other == query || equivalent(query, other))
                .map(|other| tied_rank(row, other))
                .fold(f64::INFINITY, f64::min)
        })
        .collect())
}

/// Scales latents to unit length, which makes dot products cosines.
///
/// # Errors
/// A latent is zero or not finite.
pub fn unit_rows(latents: &Matrix) -> Result<Matrix, Error> {
    check_finite(METRIC, latents)?;
    let mut unit = latents.clone();
    for index in 0..unit.num_rows() {
        let row = unit.row_mut(index);
        // Dividing by the largest entry first keeps the squares from overflowing or vanishing.
        let largest = row.iter().fold(0.0, |m: f64, value| m.max(value.abs()));
        if largest == 0.0 {
            return Err(Error::NoDirection {
                metric: METRIC,
                row: index,
            });
        }
        for value in row.iter_mut() {
            *value /= largest;
        }
        let length = dot(row, row).sqrt();
        for value in row.iter_mut() {
            *value /= length;
        }
    }
    Ok(unit)
}

/// The rank of gallery row i for query row i by dot product in single precision, counted from zero.
/// Memory does not grow with the product of the sizes.
///
/// Equal gallery rows are exact ties, wherever they stand.
///
/// # Shapes
/// Both are `[N, D]`; pass rows of unit length to rank by cosine.
///
/// # Errors
/// The sizes differ.
pub fn ranks(queries: &Rows, gallery: &Rows) -> Result<Vec<f64>, Error> {
    Ok(ranks_of_places(&compare(queries, gallery)?.places()))
}

/// Queries and a gallery whose ranks are to be taken, in one gallery or in many.
///
/// # Errors
/// The sizes differ.
pub fn compare<'a>(queries: &'a Rows, gallery: &'a Rows) -> Result<Pairing<'a>, Error> {
    check_size(
        METRIC,
        "gallery size",
        gallery.num_rows(),
        queries.num_rows(),
    )?;
    check_size(METRIC, "latent width", gallery.width(), queries.width())?;
    Ok(Pairing::new(queries, gallery))
}

fn ranks_of_places(places: &[Place]) -> Vec<f64> {
    places
        .iter()
        .map(|place| mean_position(place.nearer as usize, place.equal as usize))
        .collect()
}

/// Ranks within each gallery and averages the results over the galleries.
///
/// # Shapes
/// Rows of unit length are compared by cosine; `galleries` lists positions.
///
/// # Errors
/// There is no gallery or an empty one.
///
/// # Panics
/// If a position does not exist.
///
/// # Source
/// MotionFix evaluation: the original or target motions are the queries, the generated ones the
/// gallery. The paper's "Edited-to-Source" reads the other way round.
pub fn retrieval(pairing: &Pairing<'_>, galleries: &[Vec<usize>]) -> Result<Retrieval, Error> {
    let parts: Vec<Retrieval> = gallery_ranks(pairing, galleries)?
        .iter()
        .map(|ranks| Retrieval::of_ranks(ranks))
        .collect();
    Ok(Retrieval::mean(&parts))
}

/// The ranks of [`ranks`] within each gallery, in its order.
pub(crate) fn gallery_ranks(
    pairing: &Pairing<'_>,
    galleries: &[Vec<usize>],
) -> Result<Vec<Vec<f64>>, Error> {
    if galleries.is_empty() || galleries.iter().any(Vec::is_empty) {
        return Err(Error::TooFewRows {
            metric: METRIC,
            needed: 1,
            found: 0,
        });
    }
    Ok(galleries
        .par_iter()
        .enumerate()
        .map_init(Vec::new, |room, (at, indices)| {
            let places = if indices.len() <= SMALL_GALLERY {
                let next = galleries.get(at + 1).map_or(&[][..], Vec::as_slice);
                pairing.places_within(indices, next, room)
            } else {
                pairing.select(indices).places()
            };
            ranks_of_places(&places)
        })
        .collect())
}

#[cfg(test)]
mod tests {
    use datasets_spec::Seed;
    use proptest::prelude::*;
    use rand::RngExt;

    use super::*;
    use crate::golden::Golden;

    /// Cut-offs of the recall in the recorded metrics, which end with median and mean rank.
    const GOLDEN_RECALL_AT: [usize; 5] = [1, 2, 3, 5, 10];
    /// Galleries of the recorded batches.
    const GOLDEN_GALLERY: usize = 32;

    fn rows(latents: &Matrix) -> Rows {
        Rows::new(latents).expect("finite")
    }

    fn golden_metrics(ranks: &[f64]) -> Vec<f64> {
        let mut metrics: Vec<f64> = GOLDEN_RECALL_AT
            .iter()
            .map(|&k| recall_at(ranks, k))
            .collect();
        metrics.extend([median_rank(ranks), average_rank(ranks)]);
        metrics
    }

    /// Whether a value rounds to a recorded one of two decimals. Half a unit, and a little for the
    /// order of summation.
    fn check_rounded(found: f64, recorded: f64) {
        assert!(
            (found - recorded).abs() <= 0.005 + 1e-9,
            "{found} {recorded}"
        );
    }

    #[test]
    fn golden_retrieval_agrees_with_the_reference() {
        let golden = Golden::read("metrics_retrieval");
        let order = golden.indices("in.shuffle");
        for side in ["s_t", "t_t"] {
            let similarity = golden.matrix(&format!("in.sim_{side}"));
            let ranks = ranks_of_similarity(&similarity).expect("square");
            assert_eq!(ranks, golden.numbers(&format!("out.full.{side}.rank0")));
            let recorded = golden.numbers(&format!("out.full.{side}.metrics"));
            for (found, recorded) in golden_metrics(&ranks).into_iter().zip(recorded) {
                check_rounded(found, recorded);
            }

            let batch_ranks = golden.matrix(&format!("out.batch32.{side}.rank0"));
            let per_batch = golden.matrix(&format!("out.batch32.{side}.per_batch"));
            let mut sums = vec![0.0; per_batch.num_cols()];
            for (batch, indices) in order.chunks_exact(GOLDEN_GALLERY).enumerate() {
                let mut part = Matrix::zeros(GOLDEN_GALLERY, GOLDEN_GALLERY);
                for (row, &query) in indices.iter().enumerate() {
                    for (col, &other) in indices.iter().enumerate() {
                        part.row_mut(row)[col] = similarity.row(query)[other];
                    }
                }
                let ranks = ranks_of_similarity(&part).expect("square");
                assert_eq!(ranks, batch_ranks.row(batch));
                for (metric, found) in golden_metrics(&ranks).into_iter().enumerate() {
                    let expected = per_batch.row(batch)[metric];
                    golden.check_scalar("batch metric", found, expected, 0.0, 1e-12);
                    sums[metric] += found;
                }
            }
            let recorded = golden.numbers(&format!("out.batch32.{side}.metrics"));
            for (sum, recorded) in sums.into_iter().zip(recorded) {
                check_rounded(sum / per_batch.num_rows() as f64, recorded);
            }
        }
    }

    #[test]
    fn golden_similarities_follow_from_the_latents() {
        let golden = Golden::read("metrics_retrieval");
        let generated = unit_rows(&golden.matrix("in.generated")).expect("directions");
        for (side, latents) in [("s_t", "in.source"), ("t_t", "in.target")] {
            let queries = unit_rows(&golden.matrix(latents)).expect("directions");
            let similarity = queries.times_transposed(&generated);
            let recorded = golden.matrix(&format!("in.sim_{side}"));
            for (row, recorded) in similarity.rows().zip(recorded.rows()) {
                for (found, recorded) in row.iter().zip(recorded) {
                    golden.check_scalar(side, *found, *recorded, 0.0, 1e-6);
                }
            }
        }
    }

    #[test]
    fn golden_threshold_protocol_agrees_with_the_reference() {
        /// The recorded threshold, on the scale (1 + cosine) / 2.
        const THRESHOLD: f64 = 0.95;
        let golden = Golden::read("metrics_retrieval");
        let similarity = golden.matrix("in.thr.sim");
        let texts = golden.matrix("in.thr.emb").gram();
        let recorded = golden.matrix("out.thr.metrics");
        let same = |a: usize, b: usize| texts.row(a)[b] >= 2.0 * THRESHOLD - 1.0;
        for (side, similarity) in [similarity.clone(), similarity.transposed()]
            .iter()
            .enumerate()
        {
            let ranks = ranks_among_equivalents(similarity, same).expect("square");
            for (found, &recorded) in golden_metrics(&ranks).into_iter().zip(recorded.row(side)) {
                check_rounded(found, recorded);
            }
        }
    }

    #[test]
    fn ties_take_their_mean_position() {
        assert_eq!(tied_rank(&[0.9, 0.5, 0.1], 0), 0.0);
        assert_eq!(tied_rank(&[0.9, 0.9, 0.1], 1), 0.5);
        assert_eq!(tied_rank(&[0.9, 0.9, 0.9], 2), 1.0);
        assert_eq!(tied_rank(&[0.9, 0.1, 0.5, 0.1], 3), 2.5);
        let similarity = Matrix::from_rows(&[[0.9, 0.9, 0.1], [0.2, 0.1, 0.8], [0.3, 0.3, 0.3]]);
        let ranks = ranks_of_similarity(&similarity).expect("square");
        assert_eq!(ranks, [0.5, 2.0, 1.0]);
        let result = Retrieval::of_ranks(&ranks);
        assert_eq!(result.recall, [100.0 / 3.0, 200.0 / 3.0, 100.0]);
        assert_eq!(result.median_rank, 2.0);
        assert_eq!(result.average_rank, 3.5 / 3.0 + 1.0);
    }

    #[test]
    fn equal_motions_tie_exactly_and_share_the_first_place() {
        let latents = Matrix::from_rows(&[
            [0.1, 0.7, -0.3, 0.2, 0.9],
            [0.1, 0.7, -0.3, 0.2, 0.9],
            [-0.5, 0.2, 0.4, 0.1, 0.3],
        ]);
        let unit = rows(&unit_rows(&latents).expect("directions"));
        assert_eq!(ranks(&unit, &unit).expect("same size"), [0.5, 0.5, 0.0]);
    }

    #[test]
    fn galleries_are_ranked_apart_and_averaged() {
        let queries = rows(&Matrix::from_rows(&[
            [1.0, 0.0],
            [0.0, 1.0],
            [1.0, 0.0],
            [0.0, 1.0],
        ]));
        let gallery = rows(&Matrix::from_rows(&[
            [1.0, 0.0],
            [0.0, 1.0],
            [0.0, 1.0],
            [1.0, 0.0],
        ]));
        let pairing = compare(&queries, &gallery).expect("same size");
        let result = retrieval(&pairing, &[vec![0, 1], vec![2, 3]]).expect("valid");
        assert_eq!(result.recall, [50.0, 100.0, 100.0]);
        assert_eq!(result.average_rank, 1.5);
        assert!(retrieval(&pairing, &[]).is_err());
        assert!(retrieval(&pairing, &[vec![]]).is_err());
    }

    #[test]
    fn latents_without_direction_are_refused() {
        let zero = Matrix::zeros(2, 3);
        assert!(matches!(
            unit_rows(&zero),
            Err(Error::NoDirection { row: 0, .. })
        ));
        let tiny = Matrix::from_rows(&[[3e-200, 4e-200]]);
        let unit = unit_rows(&tiny).expect("a direction");
        assert!((unit.row(0)[0] - 0.6).abs() < 1e-15);
        let nan = Matrix::from_rows(&[[f64::NAN]]);
        assert!(matches!(unit_rows(&nan), Err(Error::NotFinite { .. })));
        assert!(ranks(&rows(&zero), &rows(&Matrix::zeros(3, 3))).is_err());
        for bad in [f64::NAN, f64::INFINITY, 1e300] {
            let found = Rows::new(&Matrix::from_rows(&[[0.0, 0.0], [1.0, bad]]));
            assert!(matches!(found, Err(Error::NotFinite { row: 1, .. })));
        }
    }

    proptest! {
        #[test]
        fn ranks_agree_with_the_stored_matrix_and_follow_a_permutation(
            seed in any::<u64>(),
            size in 1usize..80,
            width in 1usize..9,
        ) {
            let mut rng = Seed(seed).rng(&["retrieval"]);
            // A coarse grid of values, so that ties are common.
            let mut draw = || {
                let data = (0..size * width)
                    .map(|_| f64::from(rng.random_range(-2i32..3)))
                    .collect();
                Matrix::new(size, width, data)
            };
            let (queries, gallery) = (draw(), draw());
            let found = ranks(&rows(&queries), &rows(&gallery)).expect("same size");
            let stored = ranks_of_similarity(&queries.times_transposed(&gallery)).expect("square");
            prop_assert_eq!(&found, &stored);

            let order: Vec<usize> = (0..size).map(|index| (index + seed as usize % size) % size).collect();
            let moved = ranks(&rows(&queries).select(&order), &rows(&gallery).select(&order))
                .expect("same size");
            let expected: Vec<f64> = order.iter().map(|&index| found[index]).collect();
            prop_assert_eq!(moved, expected);
        }
    }
}
