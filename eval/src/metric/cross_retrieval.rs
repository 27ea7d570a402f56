//! How well motions match their texts in a shared space: R-precision and matching score.

use super::definition::{check_finite, check_size, distance};
use super::retrieval::{Retrieval, ranks_among_equivalents};
use crate::Error;
use crate::linalg::Matrix;

const METRIC: &str = "R-precision";

/// Ranks considered.
pub const TOP: usize = 3;

/// The agreement of texts with their motions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Matching {
    /// Share of texts whose motion is among the nearest 1, 2 and 3 of its batch.
    pub r_precision: [f64; TOP],
    /// Mean Euclidean distance between a text and its motion.
    pub matching_score: f64,
}

/// Measures how often a text finds its motion among the motions of its batch.
///
/// Rows are cut into batches of `batch_size` in the order given and the remainder is dropped. A
/// motion at exactly the distance of the right one counts as farther if it comes later.
///
/// # Shapes
/// `texts` and `motions` are `[N, D]`, row i of one belonging to row i of the other.
///
/// # Errors
/// The sets differ in size, hold less than one batch, or hold a number that is not finite.
///
/// # Source
/// T2M evaluation, batches of 32.
pub fn matching(texts: &Matrix, motions: &Matrix, batch_size: usize) -> Result<Matching, Error> {
    check_size(
        METRIC,
        "number of motions",
        motions.num_rows(),
        texts.num_rows(),
    )?;
    check_size(METRIC, "latent width", motions.num_cols(), texts.num_cols())?;
    check_finite(METRIC, texts)?;
    check_finite(METRIC, motions)?;
    if batch_size == 0 || texts.num_rows() < batch_size {
        return Err(Error::TooFewRows {
            metric: METRIC,
            needed: batch_size.max(1),
            found: texts.num_rows(),
        });
    }
    let num_used = texts.num_rows() / batch_size * batch_size;
    let mut hits = [0usize; TOP];
    let mut total = 0.0;
    for query in 0..num_used {
        let first = query / batch_size * batch_size;
        let text = texts.row(query);
        let own = distance(text, motions.row(query));
        total += own;
        let rank = (first..first + batch_size)
            .filter(|&other| {
                let theirs = distance(text, motions.row(other));
                theirs < own || (theirs == own && other < query)
            })
            .count();
        for (top, hits) in hits.iter_mut().enumerate() {
            *hits += usize::from(rank <= top);
        }
    }
    Ok(Matching {
        r_precision: hits.map(|hits| hits as f64 / num_used as f64),
        matching_score: total / num_used as f64,
    })
}

/// How well texts find their motions, and motions their texts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CrossRetrieval {
    /// Texts are the queries, motions the gallery.
    pub text_to_motion: Retrieval,
    /// Motions are the queries, texts the gallery.
    pub motion_to_text: Retrieval,
}

/// Ranks motions by texts and texts by motions within galleries, by cosine. Where `same_text` holds
/// for two items, either motion is a correct answer to either text.
///
/// # Shapes
/// `texts` and `motions` are `[N, D]` of unit length; `galleries` lists positions.
///
/// # Errors
/// There is no gallery or an empty one, or a number is not finite.
///
/// # Source
/// TMR's protocols: "all" and, with equal texts, "threshold" at the strictest threshold.
pub fn cross_retrieval(
    texts: &Matrix,
    motions: &Matrix,
    galleries: &[Vec<usize>],
    same_text: impl Fn(usize, usize) -> bool,
) -> Result<CrossRetrieval, Error> {
    if galleries.is_empty() || galleries.iter().any(Vec::is_empty) {
        return Err(Error::TooFewRows {
            metric: METRIC,
            needed: 1,
            found: 0,
        });
    }
    let mut found: [Vec<Retrieval>; 2] = [Vec::new(), Vec::new()];
    for indices in galleries {
        let similarity = texts
            .select_rows(indices)
            .times_transposed(&motions.select_rows(indices));
        let same = |query: usize, other: usize| same_text(indices[query], indices[other]);
        for (found, similarity) in found
            .iter_mut()
            .zip([&similarity, &similarity.transposed()])
        {
            let ranks = ranks_among_equivalents(similarity, same)?;
            found.push(Retrieval::of_ranks(&ranks));
        }
    }
    let [text_to_motion, motion_to_text] = found.map(|parts| Retrieval::mean(&parts));
    Ok(CrossRetrieval {
        text_to_motion,
        motion_to_text,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::golden::Golden;

    #[test]
    fn texts_and_motions_find_each_other_and_equal_texts_share_their_motions() {
        let texts = Matrix::from_rows(&[[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]]);
        let motions = Matrix::from_rows(&[[0.8, 0.6], [1.0, 0.0], [0.0, 1.0]]);
        let galleries = [vec![0, 1, 2]];
        let exact = cross_retrieval(&texts, &motions, &galleries, |a, b| a == b).expect("valid");
        // The first text is nearest to the motion of the second, in the same words.
        assert_eq!(exact.text_to_motion.recall[0], 200.0 / 3.0);
        assert_eq!(exact.text_to_motion.average_rank, 4.0 / 3.0);
        // The two equal texts tie for the first motion.
        assert_eq!(exact.motion_to_text.recall[0], 100.0);
        assert_eq!(exact.motion_to_text.average_rank, 4.0 / 3.0);
        let same = |a: usize, b: usize| a == b || a.max(b) == 1;
        let shared = cross_retrieval(&texts, &motions, &galleries, same).expect("valid");
        assert_eq!(shared.text_to_motion.recall[0], 100.0);
        assert!(cross_retrieval(&texts, &motions, &[], same).is_err());
    }

    #[test]
    fn golden_r_precision_agrees_with_the_reference() {
        let golden = Golden::read("metrics_t2m");
        let texts = golden.matrix("in.rp.text");
        let motions = golden.matrix("in.rp.motion");
        let (shape, _) = golden.tensor("out.rp.distances");
        let batch_size = shape[1];
        let value = matching(&texts, &motions, batch_size).expect("valid");
        let expected = golden.numbers("out.rp.value");
        for (found, expected) in value.r_precision.iter().zip(expected) {
            golden.check_scalar("R-precision", *found, expected, 0.0, 1e-12);
        }
        golden.check_scalar(
            "matching score",
            value.matching_score,
            golden.scalar("out.rp.matching_score"),
            0.0,
            1e-9,
        );
        let counts = golden.matrix("out.rp.top3_counts");
        let sums = golden.numbers("out.rp.matching_sum");
        for (batch, &sum) in sums.iter().enumerate() {
            let rows: Vec<usize> = (batch * batch_size..(batch + 1) * batch_size).collect();
            let part = matching(
                &texts.select_rows(&rows),
                &motions.select_rows(&rows),
                batch_size,
            )
            .expect("valid");
            let found = part.r_precision.map(|share| share * batch_size as f64);
            for (found, expected) in found.iter().zip(counts.row(batch)) {
                assert_eq!(found.round(), *expected);
            }
            golden.check_scalar(
                "matching sum",
                part.matching_score * batch_size as f64,
                sum,
                0.0,
                1e-9,
            );
        }
    }

    #[test]
    fn a_swapped_pair_is_found_second() {
        let texts = Matrix::from_rows(&[[0.0], [1.0], [10.0], [99.0]]);
        let motions = Matrix::from_rows(&[[1.0], [0.0], [10.0], [0.0]]);
        let value = matching(&texts, &motions, 3).expect("valid");
        assert_eq!(value.r_precision, [1.0 / 3.0, 1.0, 1.0]);
        assert_eq!(value.matching_score, 2.0 / 3.0);
        assert!(matching(&texts, &motions, 5).is_err());
        assert!(matching(&texts, &motions, 0).is_err());
    }
}
