//! Retrieval of motions by text and of texts by motion.

use super::retrieval::{Retrieval, check_galleries, ranks_among_equivalents};
use crate::Error;
use crate::linalg::Matrix;

/// A value for each direction of retrieval.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BothWays<T> {
    /// Texts are the queries, motions the gallery.
    pub text_to_motion: T,
    /// Motions are the queries, texts the gallery.
    pub motion_to_text: T,
}

/// Recalls and ranks of both directions.
pub type CrossRetrieval = BothWays<Retrieval>;

/// Ranks of the true answers in each gallery, counted from zero.
pub type CrossRanks = BothWays<Vec<Vec<f64>>>;

impl CrossRanks {
    /// Recalls and ranks, averaged over the galleries.
    ///
    /// # Panics
    /// If there is no gallery.
    pub fn retrieval(&self) -> CrossRetrieval {
        BothWays {
            text_to_motion: Retrieval::of_galleries(&self.text_to_motion),
            motion_to_text: Retrieval::of_galleries(&self.motion_to_text),
        }
    }
}

/// Ranks motions by texts and texts by motions within galleries, by cosine. If `same_text` holds for two items, the
/// motion of one is also a correct answer to the text of the other.
///
/// # Shapes
/// `texts` and `motions` are `[N, D]` of unit length; `galleries` lists positions.
///
/// # Errors
/// There is no gallery or an empty one, or a number is not finite.
///
/// # Source
/// TMR's protocols: "all" and, with equal texts, "threshold" at the strictest threshold.
pub fn cross_ranks(
    texts: &Matrix,
    motions: &Matrix,
    galleries: &[Vec<usize>],
    same_text: impl Fn(usize, usize) -> bool,
) -> Result<CrossRanks, Error> {
    check_galleries("text-to-motion retrieval", galleries)?;
    let mut found = CrossRanks::default();
    for indices in galleries {
        let similarity = texts
            .select_rows(indices)
            .times_transposed(&motions.select_rows(indices));
        let same = |query: usize, other: usize| same_text(indices[query], indices[other]);
        let ranks = |similarity: &Matrix| ranks_among_equivalents(similarity, same);
        found.text_to_motion.push(ranks(&similarity)?);
        found.motion_to_text.push(ranks(&similarity.transposed())?);
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::golden::Golden;
    use crate::metric::definition::distance;

    #[test]
    fn texts_and_motions_find_each_other_and_equal_texts_share_their_motions() {
        let texts = Matrix::from_rows(&[[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]]);
        let motions = Matrix::from_rows(&[[0.8, 0.6], [1.0, 0.0], [0.0, 1.0]]);
        let galleries = [vec![0, 1, 2]];
        let ranked = |same: fn(usize, usize) -> bool| {
            let ranks = cross_ranks(&texts, &motions, &galleries, same);
            ranks.expect("valid").retrieval()
        };
        let exact = ranked(|a, b| a == b);
        // The first text is nearest to the motion of the second item, which has the same text.
        assert_eq!(exact.text_to_motion.recall[0], 200.0 / 3.0);
        assert_eq!(exact.text_to_motion.average_rank, 4.0 / 3.0);
        // The two equal texts tie for the first motion.
        assert_eq!(exact.motion_to_text.recall[0], 100.0);
        assert_eq!(exact.motion_to_text.average_rank, 4.0 / 3.0);
        let shared = ranked(|a, b| a == b || a.max(b) == 1);
        assert_eq!(shared.text_to_motion.recall[0], 100.0);
        assert!(cross_ranks(&texts, &motions, &[], |a, b| a == b).is_err());
    }

    /// R-precision of the T2M evaluation: the shares of texts whose motion is among the nearest 1, 2 and 3 of a batch.
    /// These are the recalls of [`Retrieval`] with Euclidean distance.
    #[test]
    fn golden_r_precision_agrees_with_the_reference() {
        let golden = Golden::read("metrics_t2m");
        let texts = golden.matrix("in.rp.text");
        let motions = golden.matrix("in.rp.motion");
        let (shape, _) = golden.tensor("out.rp.distances");
        let batch_size = shape[1];
        let counts = golden.matrix("out.rp.top3_counts");
        let mut parts = Vec::new();
        for batch in 0..texts.num_rows() / batch_size {
            let rows: Vec<usize> = (batch * batch_size..(batch + 1) * batch_size).collect();
            let mut nearness = Matrix::zeros(batch_size, batch_size);
            for (row, &text) in rows.iter().enumerate() {
                for (column, &motion) in rows.iter().enumerate() {
                    nearness.row_mut(row)[column] = -distance(texts.row(text), motions.row(motion));
                }
            }
            let ranks = ranks_among_equivalents(&nearness, |_, _| false).expect("square");
            let part = Retrieval::of_ranks(&ranks);
            for (recall, expected) in part.recall.iter().zip(counts.row(batch)) {
                assert_eq!((recall / 100.0 * batch_size as f64).round(), *expected);
            }
            parts.push(part);
        }
        let recall = Retrieval::mean(&parts).recall;
        for (recall, expected) in recall.iter().zip(golden.numbers("out.rp.value")) {
            golden.check_scalar("R-precision", recall / 100.0, expected, 0.0, 1e-12);
        }
    }
}
