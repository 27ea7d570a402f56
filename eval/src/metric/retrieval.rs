//! Retrieval: the rank of a motion's counterpart in a gallery.

use datasets_spec::quantile;
use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use rayon::prelude::*;

use super::definition::Counterpart::{self, Source, Target};
use super::definition::RankSummary::{self, Average, Median, Recall};
use super::definition::{
    Better, Measure, Metric, Part, check_count, check_finite, check_size, not_finite,
};
use crate::Error;
use crate::linalg::Matrix;

const METRIC: &str = "retrieval";

/// Cut-offs k at which recall is reported.
pub const RECALL_AT: [usize; 3] = [1, 2, 3];

/// Number of queries compared with the gallery at once: at 10,000 gallery rows their similarities take 10 MB.
const QUERIES_PER_BLOCK: usize = 256;

pub(crate) static E2S_RECALL_1: Metric = ranked("E2S R@1", Source, Recall(1));
pub(crate) static E2S_RECALL_2: Metric = ranked("E2S R@2", Source, Recall(2));
pub(crate) static E2S_RECALL_3: Metric = ranked("E2S R@3", Source, Recall(3));
pub(crate) static E2T_RECALL_1: Metric = ranked("E2T R@1", Target, Recall(1));
pub(crate) static E2T_RECALL_2: Metric = ranked("E2T R@2", Target, Recall(2));
pub(crate) static E2T_RECALL_3: Metric = ranked("E2T R@3", Target, Recall(3));

pub(crate) static E2S_AVERAGE_RANK: Metric = ranked("E2S AvgR", Source, Average);
pub(crate) static E2T_AVERAGE_RANK: Metric = ranked("E2T AvgR", Target, Average);
pub(crate) static E2S_MEDIAN_RANK: Metric = ranked("E2S MedR", Source, Median);
pub(crate) static E2T_MEDIAN_RANK: Metric = ranked("E2T MedR", Target, Median);

/// A metric computed from ranks. The paper's tables do not print the median rank.
const fn ranked(name: &'static str, counterpart: Counterpart, summary: RankSummary) -> Metric {
    Metric {
        name,
        about: match (counterpart, summary) {
            (Source, Recall(_)) => {
                "edits found by their originals: share among the first k, in percent"
            }
            (Source, Average) => "edits found by their originals: mean rank, from 1",
            (Source, Median) => "edits found by their originals: median rank, from 1",
            (Target, Recall(_)) => {
                "edits found by their targets: share among the first k, in percent"
            }
            (Target, Average) => "edits found by their targets: mean rank, from 1",
            (Target, Median) => "edits found by their targets: median rank, from 1",
        },
        part: match summary {
            Recall(_) | Average => Part::Paper,
            Median => Part::Further,
        },
        better: match (counterpart, summary) {
            (Source, Recall(_)) => |task| where_preserving(task, Better::Higher),
            (Source, Average | Median) => |task| where_preserving(task, Better::Lower),
            (Target, Recall(_)) => |_| Better::Higher,
            (Target, Average | Median) => |_| Better::Lower,
        },
        decimals: 2,
        measure: Measure::Rank(counterpart, summary),
    }
}

/// Tasks whose edits keep most of their original.
const PRESERVING: [&str; 2] = ["fine-grained", "motionfix"];

/// Which ranks or recalls of the source are good for a task; `good` is the answer for tasks of [`PRESERVING`].
///
/// # Source
/// In Table 1 (body parts, style), a good E2S recall is close to that of the real data: a higher one means that too
/// little was edited. In Table A1 (fine-grained) and Table 2, higher is better.
fn where_preserving(task: &str, good: Better) -> Better {
    match PRESERVING.contains(&task) {
        true => good,
        false => Better::NearReal,
    }
}

/// Summary of a set of ranks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Retrieval {
    /// Share of queries whose counterpart is among the first 1, 2 and 3, in percent.
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

    /// The unweighted mean over galleries of ranks that count from zero.
    ///
    /// # Panics
    /// If there are none.
    pub fn of_galleries(galleries: &[Vec<f64>]) -> Self {
        let parts = galleries.iter().map(|ranks| Self::of_ranks(ranks));
        Self::mean(&parts.collect::<Vec<_>>())
    }

    /// The unweighted mean of several summaries.
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

    /// The value of a summary.
    ///
    /// # Panics
    /// If a recall's cut-off is not in [`RECALL_AT`].
    pub fn value(&self, summary: RankSummary) -> f64 {
        match summary {
            Recall(k) => self.recall[k - RECALL_AT[0]],
            Average => self.average_rank,
            Median => self.median_rank,
        }
    }
}

/// The share of ranks below k in percent; ranks count from zero. A two-way tie for the first place has rank 0.5 and
/// counts for k = 1; a three-way tie has rank 1 and does not.
fn recall_at(ranks: &[f64], k: usize) -> f64 {
    assert!(!ranks.is_empty(), "recall of no ranks");
    let hits = ranks.iter().filter(|&&rank| rank < k as f64).count();
    100.0 * hits as f64 / ranks.len() as f64
}

/// The median rank, counted from one; for an even number of ranks, the mean of the two middle ones.
fn median_rank(ranks: &[f64]) -> f64 {
    quantile::median(&mut ranks.to_vec()).expect("median of no ranks") + 1.0
}

/// The mean rank, counted from one.
fn average_rank(ranks: &[f64]) -> f64 {
    assert!(!ranks.is_empty(), "mean of no ranks");
    ranks.iter().sum::<f64>() / ranks.len() as f64 + 1.0
}

/// The rank of one entry of a row of similarities, counted from zero. Tied entries share their mean position.
fn tied_rank<T: PartialOrd + Copy>(similarities: &[T], truth: usize) -> f64 {
    let own = similarities[truth];
    let (mut nearer, mut equal) = (0u32, 0u32);
    for &other in similarities {
        nearer += u32::from(other > own);
        equal += u32::from(other == own);
    }
    // `equal` includes the entry itself.
    f64::from(nearer) + (f64::from(equal) - 1.0) / 2.0
}

/// The rank of each row's diagonal entry in a similarity matrix, or the best rank among the entries equivalent to it.
///
/// # Errors
/// The matrix is not square or not finite.
///
/// # Source
/// TMR's "threshold" protocol: texts closer than a threshold describe the same motion.
pub(super) fn ranks_among_equivalents(
    similarity: &Matrix,
    equivalent: impl Fn(usize, usize) -> bool,
) -> Result<Vec<f64>, Error> {
    let [queries, gallery] = [similarity.num_rows(), similarity.num_cols()];
    check_size(METRIC, "gallery size", gallery, queries)?;
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

/// Scales latents to unit length, so that dot products are cosines.
///
/// # Errors
/// A latent is zero or not finite.
pub fn unit_rows(latents: &Matrix) -> Result<Matrix, Error> {
    check_finite(METRIC, latents)?;
    let mut unit = latents.clone();
    for index in 0..unit.num_rows() {
        let row = unit.row_mut(index);
        // Dividing by the largest entry first keeps the squares from overflowing or underflowing.
        let largest = row.iter().fold(0.0, |m: f64, value| m.max(value.abs()));
        if largest == 0.0 {
            return Err(Error::Invalid(format!(
                "{METRIC}: row {index} is zero and has no direction"
            )));
        }
        for value in row.iter_mut() {
            *value /= largest;
        }
        let length = row.iter().map(|value| *value * *value).sum::<f64>().sqrt();
        for value in row.iter_mut() {
            *value /= length;
        }
    }
    Ok(unit)
}

/// For each i of `indices`, the rank of gallery row i among the gallery rows at `indices`, by their dot products with
/// query row i in single precision. Ranks count from zero. Queries are processed in blocks to bound memory.
///
/// Equal gallery rows are exact ties at any position.
///
/// # Shapes
/// Both are `[N, D]`; pass rows of unit length to rank by cosine.
///
/// # Errors
/// The sizes differ, or a number is not finite in single precision.
///
/// # Panics
/// If a position does not exist.
pub fn ranks(queries: &Matrix, gallery: &Matrix, indices: &[usize]) -> Result<Vec<f64>, Error> {
    let [num_rows, width] = [queries.num_rows(), queries.num_cols()];
    check_size(METRIC, "gallery size", gallery.num_rows(), num_rows)?;
    check_size(METRIC, "latent width", gallery.num_cols(), width)?;
    let size = indices.len();
    if size == 0 || width == 0 {
        return Ok(vec![size.saturating_sub(1) as f64 / 2.0; size]);
    }
    let (queries, gallery) = (single(queries, indices)?, single(gallery, indices)?);
    let gallery = MatRef::from_row_major_slice(&gallery, size, width);
    let blocks: Vec<Vec<f64>> = queries
        .par_chunks(QUERIES_PER_BLOCK * width)
        .enumerate()
        .map(|(block, queries)| {
            let rows = queries.len() / width;
            let mut similarity = vec![0.0f32; rows * size];
            matmul(
                MatMut::from_row_major_slice_mut(&mut similarity, rows, size),
                Accum::Replace,
                MatRef::from_row_major_slice(queries, rows, width),
                gallery.transpose(),
                1.0,
                Par::Seq,
            );
            let rows = similarity.chunks_exact(size).enumerate();
            rows.map(|(row, similarity)| tied_rank(similarity, block * QUERIES_PER_BLOCK + row))
                .collect()
        })
        .collect();
    Ok(blocks.concat())
}

/// Converts some rows to single precision, concatenated.
fn single(rows: &Matrix, indices: &[usize]) -> Result<Vec<f32>, Error> {
    let mut values = Vec::with_capacity(indices.len() * rows.num_cols());
    for &row in indices {
        values.extend(rows.row(row).iter().map(|&value| value as f32));
    }
    match values.iter().position(|value| !value.is_finite()) {
        Some(at) => Err(not_finite(METRIC, indices[at / rows.num_cols()])),
        None => Ok(values),
    }
}

/// Refuses a metric without galleries, or with an empty gallery.
pub(super) fn check_galleries(metric: &str, galleries: &[Vec<usize>]) -> Result<(), Error> {
    let least = galleries.iter().map(Vec::len).min();
    check_count(metric, least.unwrap_or(0), 1)
}

/// The [`ranks`] within each gallery.
///
/// # Errors
/// There is no gallery or an empty one, the sizes differ, or a number is not finite.
///
/// # Panics
/// If a position does not exist.
///
/// # Source
/// MotionFix evaluation: original or target motions are the queries, generated ones the gallery.
/// The paper's "Edited-to-Source" reads the other way round.
pub fn gallery_ranks(
    queries: &Matrix,
    gallery: &Matrix,
    galleries: &[Vec<usize>],
) -> Result<Vec<Vec<f64>>, Error> {
    check_galleries(METRIC, galleries)?;
    galleries
        .par_iter()
        .map(|indices| ranks(queries, gallery, indices))
        .collect()
}

#[cfg(test)]
mod tests {
    use datasets_spec::Seed;
    use proptest::prelude::*;
    use rand::RngExt;

    use super::*;
    use crate::golden::Golden;

    /// Cut-offs of the recall in the recorded metrics; the median and mean rank follow them.
    const GOLDEN_RECALL_AT: [usize; 5] = [1, 2, 3, 5, 10];

    fn ranks_of_similarity(similarity: &Matrix) -> Result<Vec<f64>, Error> {
        ranks_among_equivalents(similarity, |_, _| false)
    }

    /// Ranks in one gallery that contains all rows.
    fn full_ranks(queries: &Matrix, gallery: &Matrix) -> Result<Vec<f64>, Error> {
        let all: Vec<usize> = (0..queries.num_rows()).collect();
        ranks(queries, gallery, &all)
    }

    fn golden_metrics(ranks: &[f64]) -> Vec<f64> {
        let recalls = GOLDEN_RECALL_AT.iter().map(|&k| recall_at(ranks, k));
        let of_ranks = [median_rank(ranks), average_rank(ranks)];
        recalls.chain(of_ranks).collect()
    }

    /// Checks that values round to recorded numbers of two decimals. The tolerance is half a unit, plus a little for
    /// the order of summation.
    fn check_rounded(found: &[f64], recorded: &[f64]) {
        for (found, recorded) in found.iter().zip(recorded) {
            let is_near = (found - recorded).abs() <= 0.005 + 1e-9;
            assert!(is_near, "{found} {recorded}");
        }
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
            check_rounded(&golden_metrics(&ranks), &recorded);

            let of_batches = |what| golden.name("out.batch", &format!(".{side}.{what}"));
            let batch_ranks = golden.matrix(of_batches("rank0"));
            let per_batch = golden.matrix(of_batches("per_batch"));
            let gallery = batch_ranks.num_cols();
            let mut sums = [0.0; GOLDEN_RECALL_AT.len() + 2];
            for (batch, indices) in order.chunks_exact(gallery).enumerate() {
                let mut part = Matrix::zeros(gallery, gallery);
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
            let recorded = golden.numbers(of_batches("metrics"));
            let means = sums.map(|sum: f64| sum / per_batch.num_rows() as f64);
            check_rounded(&means, &recorded);
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
        let sides = [similarity.clone(), similarity.transposed()];
        for (side, similarity) in sides.iter().enumerate() {
            let ranks = ranks_among_equivalents(similarity, same).expect("square");
            check_rounded(&golden_metrics(&ranks), recorded.row(side));
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

    /// A product that sums its last rows and columns in another order would break ties.
    #[test]
    fn copies_tie_at_every_place_of_a_block() {
        for (size, width) in [(33, 17), (100, 256), (261, 37), (515, 512)] {
            let mut rng = Seed(7).rng(&["ties", &size.to_string()]);
            let values = (0..size * width).map(|_| rng.random_range(-1.0..1.0));
            let different = Matrix::new(size, width, values.collect());
            // Every vector occurs three times.
            let places: Vec<usize> = (0..3 * size).map(|place| place * 7 % size).collect();
            let copies = unit_rows(&different.select_rows(&places)).expect("directions");
            let ranks = full_ranks(&copies, &copies).expect("same size");
            assert_eq!(ranks, vec![1.0; 3 * size], "{size} {width}");
        }
    }

    #[test]
    fn galleries_are_ranked_apart_and_averaged() {
        let queries = Matrix::from_rows(&[[1.0, 0.0], [0.0, 1.0], [1.0, 0.0], [0.0, 1.0]]);
        let gallery = Matrix::from_rows(&[[1.0, 0.0], [0.0, 1.0], [0.0, 1.0], [1.0, 0.0]]);
        let ranked = |galleries: &[Vec<usize>]| gallery_ranks(&queries, &gallery, galleries);
        let ranks = ranked(&[vec![0, 1], vec![2, 3]]).expect("valid");
        let result = Retrieval::of_galleries(&ranks);
        assert_eq!(result.recall, [50.0, 100.0, 100.0]);
        assert_eq!(result.average_rank, 1.5);
        assert!(ranked(&[]).is_err());
        assert!(ranked(&[vec![]]).is_err());
    }

    #[test]
    fn latents_without_direction_are_refused() {
        let zero = Matrix::zeros(2, 3);
        let refusal = |found: Result<_, Error>| found.expect_err("refused").to_string();
        assert_eq!(
            refusal(unit_rows(&zero)),
            "retrieval: row 0 is zero and has no direction"
        );
        let tiny = Matrix::from_rows(&[[3e-200, 4e-200]]);
        let unit = unit_rows(&tiny).expect("a direction");
        assert!((unit.row(0)[0] - 0.6).abs() < 1e-15);
        let nan = Matrix::from_rows(&[[f64::NAN]]);
        assert_eq!(refusal(unit_rows(&nan)), "retrieval: row 0 is not finite");
        assert!(full_ranks(&zero, &Matrix::zeros(3, 3)).is_err());
        for bad in [f64::NAN, f64::INFINITY, 1e300] {
            let rows = Matrix::from_rows(&[[0.0, 0.0], [1.0, bad]]);
            let found = full_ranks(&rows, &rows);
            let error = found.expect_err("refused").to_string();
            assert_eq!(error, "retrieval: row 1 is not finite");
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
            // A coarse grid of values makes ties common.
            let mut draw = || {
                let data = (0..size * width)
                    .map(|_| f64::from(rng.random_range(-2i32..3)))
                    .collect();
                Matrix::new(size, width, data)
            };
            let (queries, gallery) = (draw(), draw());
            let found = full_ranks(&queries, &gallery).expect("same size");
            let stored = ranks_of_similarity(&queries.times_transposed(&gallery)).expect("square");
            prop_assert_eq!(&found, &stored);

            let order: Vec<usize> = (0..size).map(|index| (index + seed as usize % size) % size).collect();
            let moved = ranks(&queries, &gallery, &order).expect("same size");
            let expected: Vec<f64> = order.iter().map(|&index| found[index]).collect();
            prop_assert_eq!(moved, expected);
        }
    }
}
