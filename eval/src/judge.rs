//! Decides whether an encoder may rank systems, from a report of its retrieval on held-out clips.
//!
//! An encoder may not rank if it has no report, or if the lower bound of its R@3 on held-out real motion is below
//! [`CHANCE_FACTOR`] times chance. A set of items may not be ranked if the encoder cannot distinguish its targets from
//! its sources: the lower bound of the paired difference in E2T R@1 between real data and the identity editor is not
//! above 0, or there are fewer than [`MIN_TARGETS`] targets.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use datasets_spec::quantile::quantile;
use datasets_spec::record::ScoreRow;
use datasets_spec::{Seed, Split};
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::evaluators::MotionEncoder;
use crate::linalg::Matrix;
use crate::metric::cross_retrieval::{CrossRanks, cross_ranks};
use crate::metric::interval::{MIN_TARGETS, mean_of_known};
use crate::metric::retrieval::{E2T_RECALL_1, RECALL_AT, unit_rows};
use crate::names::IDENTITY;
use crate::protocol::Protocol;
use crate::score::Resamples;

/// Name of the report's file in the run folder of an encoder.
pub const REPORT: &str = "report.json";
/// The lower bound of an encoder's R@3 must be at least this many times chance.
pub const CHANCE_FACTOR: f64 = 3.0;
/// Name of the score that the second check uses: R@1 of the real data minus that of the identity editor, in percent.
pub const TOLD_APART: &str = "Real E2T R@1 above identity";
/// Share of the bootstrap draws below a lower bound.
const TAIL: f64 = 0.025;
/// Version of the report.
const FORMAT: u32 = 1;

/// How well the texts and motions of an encoder retrieve each other on clips that its training did not learn from. The
/// checkpoint of an encoder of one's own was chosen by the loss on the same clips.
///
/// The first caption of each clip is its text. Any clip with the query's text counts as a hit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JudgeReport {
    /// Version of the report.
    pub format: u32,
    /// Hash of the encoder's weights, hexadecimal.
    pub encoder_hash: String,
    /// Root hash of the dataset.
    pub dataset_hash: String,
    /// The condition that chose the clips; `None` if the split is whole.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub condition: Option<String>,
    /// Split of the clips.
    pub split: String,
    /// Seed of galleries and bootstrap draws.
    pub seed: u64,
    /// Number of clips.
    pub clips: usize,
    /// Number of distinct texts; the bootstrap draws them.
    pub texts: usize,
    /// Number of clips in a gallery; fewer than 32 if the split has fewer.
    pub gallery: usize,
    /// Number of random divisions of all clips into galleries.
    pub repeats: usize,
    /// Texts are the queries, motions the gallery.
    pub text_to_motion: Recalls<Bounded>,
    /// Motions are the queries, texts the gallery.
    pub motion_to_text: Recalls<Bounded>,
    /// Recall of a random order, given how many clips of each gallery share a text.
    pub chance: Recalls<f64>,
}

/// Recall in percent.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recalls<T> {
    /// Share of queries whose first result is a hit.
    pub r1: T,
    /// Share of queries with a hit among the first three results.
    pub r3: T,
}

/// A share with the lower end of its 95 % bootstrap interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bounded {
    /// The share in percent.
    pub mean: f64,
    /// 2.5 % quantile over bootstrap draws of the texts.
    pub lower: f64,
}

impl JudgeReport {
    /// Measures the encoder of this hash with the default galleries and repeats, on clips of a dataset, given by its
    /// root hash, and a split. `seed` is that of galleries and bootstrap draws.
    ///
    /// # Shapes
    /// `texts` `[N]`; the latents of texts and of motions `[N, D]`.
    ///
    /// # Errors
    /// There is no clip, or a latent is not finite or has no direction.
    pub fn measure(
        texts: &[&str],
        text_latents: &[Vec<f64>],
        motion_latents: &[Vec<f64>],
        encoder_hash: &str,
        dataset_hash: &str,
        split: Split,
        seed: Seed,
    ) -> Result<Self, Error> {
        let protocol = Protocol {
            seed,
            ..Protocol::default()
        };
        let repeats = encoder_retrieval(texts, text_latents, motion_latents, &protocol)?;
        let resamples = Resamples::new(texts.iter().copied(), &protocol);
        let recalls = |of: Direction| recalls(texts.len(), &repeats, of, &resamples);
        let [r1, _, r3] = chance(texts, &repeats);
        Ok(Self {
            format: FORMAT,
            encoder_hash: encoder_hash.to_owned(),
            dataset_hash: dataset_hash.to_owned(),
            condition: None,
            split: split.as_str().to_owned(),
            seed: seed.0,
            clips: texts.len(),
            texts: texts.iter().collect::<BTreeSet<_>>().len(),
            gallery: protocol.gallery_sizes(texts.len()).0,
            repeats: protocol.repeats,
            text_to_motion: recalls(|ranks| &ranks.text_to_motion),
            motion_to_text: recalls(|ranks| &ranks.motion_to_text),
            chance: Recalls { r1, r3 },
        })
    }

    /// Reason why an encoder with this report cannot rank systems; `None` if it can.
    pub fn weakness(&self) -> Option<String> {
        let [texts, motions] = [&self.text_to_motion, &self.motion_to_text];
        let lower = texts.r3.lower.min(motions.r3.lower);
        // With few captions, three times chance may exceed 100 %; halfway from chance to 100 % suffices.
        let chance = self.chance.r3;
        let needed = (CHANCE_FACTOR * chance).min((100.0 + chance) / 2.0);
        // A comparison with NaN is false.
        let is_fit = lower >= needed;
        (!is_fit).then(|| {
            format!(
                "its R@3 on held-out motion is above {lower:.1} % by the lower bound, and {needed:.1} % are needed where chance \
                 reaches {chance:.1} % ({} clips of {} with {} captions, galleries of {})",
                self.clips, self.split, self.texts, self.gallery
            )
        })
    }

    /// The report as sentences, one per line.
    pub fn lines(&self) -> Vec<String> {
        let few = match Protocol::default().gallery_sizes(usize::MAX).0 {
            size if self.gallery < size => {
                format!(", fewer than {size}: the split has no more clips")
            }
            _ => String::new(),
        };
        let side = |name: &str, recalls: &Recalls<Bounded>| {
            let of = |found: Bounded, chance: f64| {
                format!(
                    "{:.1} % (at least {:.1}, chance {chance:.1})",
                    found.mean, found.lower
                )
            };
            format!(
                "{name}: R@1 {}, R@3 {}",
                of(recalls.r1, self.chance.r1),
                of(recalls.r3, self.chance.r3)
            )
        };
        let chosen = self.condition.iter();
        let chosen: String = chosen.map(|words| format!(" where {words}")).collect();
        vec![
            format!(
                "retrieval on {} clips of {} with {} different texts, galleries of {}{few}, {} repeats, seed {}, dataset {:.12}{chosen}",
                self.clips,
                self.split,
                self.texts,
                self.gallery,
                self.repeats,
                self.seed,
                self.dataset_hash
            ),
            side("text to motion", &self.text_to_motion),
            side("motion to text", &self.motion_to_text),
            match self.weakness() {
                None => "the encoder ranks systems".to_owned(),
                Some(reason) => format!("the encoder ranks nothing: {reason}"),
            },
        ]
    }
}

/// Galleries of a repeat, as positions, and the ranks in them.
pub type RankedGalleries = (Vec<Vec<usize>>, CrossRanks);

/// How well an encoder's texts and motions retrieve each other: for each repeat its galleries, as positions, and the
/// ranks in them. Motions with equal texts may stand for each other.
///
/// # Shapes
/// `texts` `[N]`; the latents of texts and of motions `[N, D]`.
///
/// # Errors
/// A latent is not finite or has no direction.
pub fn encoder_retrieval(
    texts: &[&str],
    text_latents: &[Vec<f64>],
    motion_latents: &[Vec<f64>],
    protocol: &Protocol,
) -> Result<Vec<RankedGalleries>, Error> {
    let unit = |latents: &[Vec<f64>]| unit_rows(&Matrix::from_rows(latents));
    let (texts_at, motions_at) = (unit(text_latents)?, unit(motion_latents)?);
    let distinct = (0..protocol.distinct_galleries(texts.len()))
        .map(|repeat| {
            let galleries = protocol.galleries(texts.len(), repeat);
            let same_text = |a: usize, b: usize| texts[a] == texts[b];
            let ranks = cross_ranks(&texts_at, &motions_at, &galleries, same_text)?;
            Ok((galleries, ranks))
        })
        .collect::<Result<Vec<RankedGalleries>, Error>>()?;
    let of_repeat = |repeat: usize| distinct[repeat % distinct.len()].clone();
    Ok((0..protocol.repeats).map(of_repeat).collect())
}

/// The ranks of one direction in the galleries of a repeat.
type Direction = fn(&CrossRanks) -> &Vec<Vec<f64>>;

/// The recalls of one direction. Each query counts with its mean over the repeats that ranked it.
fn recalls(
    num_queries: usize,
    repeats: &[RankedGalleries],
    direction: Direction,
    resamples: &Resamples,
) -> Recalls<Bounded> {
    let [r1, r3] = [RECALL_AT[0], RECALL_AT[2]].map(|k| {
        let mut of_query = vec![(0.0, 0.0); num_queries];
        for (galleries, ranks) in repeats {
            for (indices, ranks) in galleries.iter().zip(direction(ranks)) {
                for (&query, &rank) in indices.iter().zip(ranks) {
                    of_query[query].0 += f64::from(rank < k as f64);
                    of_query[query].1 += 1.0;
                }
            }
        }
        let values = percent(&of_query);
        Bounded {
            mean: mean_of_known(&values).unwrap_or(f64::NAN),
            lower: quantile(&mut resamples.means(&values), TAIL).unwrap_or(f64::NAN),
        }
    });
    Recalls { r1, r3 }
}

/// The mean of each query in percent, from the sum and the number of its values; NaN if no gallery contained it.
fn percent(of_query: &[(f64, f64)]) -> Vec<f64> {
    let means = of_query.iter().map(|(sum, count)| 100.0 * sum / count);
    means.collect()
}

/// Recalls at [`RECALL_AT`] of a random order of the same galleries, in percent: the mean over the texts. Motions with
/// equal texts stand for each other, so it rises with every text that clips share.
pub fn chance(texts: &[&str], repeats: &[RankedGalleries]) -> [f64; RECALL_AT.len()] {
    RECALL_AT.map(|k| {
        let mut of_query = vec![(0.0, 0.0); texts.len()];
        for indices in repeats.iter().flat_map(|(galleries, _)| galleries) {
            for &query in indices {
                let is_hit = |other: &&usize| texts[**other] == texts[query];
                let hits = indices.iter().filter(is_hit).count();
                of_query[query].0 += of_random_order(indices.len(), hits, k);
                of_query[query].1 += 1.0;
            }
        }
        mean_of_known(&percent(&of_query)).unwrap_or(f64::NAN)
    })
}

/// Probability that a random order of a gallery has at least one of the hits among the first `k`.
fn of_random_order(gallery: usize, hits: usize, k: usize) -> f64 {
    let misses = gallery - hits;
    let none =
        (0..k).map(|place| misses.saturating_sub(place) as f64 / (gallery - place).max(1) as f64);
    1.0 - none.product::<f64>()
}

/// Reason why the encoder of a run folder, with the given hash of its weights, cannot rank systems; `None` if its
/// report shows that it can.
///
/// # Errors
/// The report cannot be read.
pub fn weakness(run: &Path, encoder_hash: &str) -> Result<Option<String>, Error> {
    let path = run.join(REPORT);
    let failed = |source| Error::Report(path.clone(), source);
    let text = match std::fs::read(&path) {
        Ok(text) => text,
        Err(source) if source.kind() == std::io::ErrorKind::NotFound => {
            return Ok(Some(format!(
                "{} holds no {REPORT}, the report of its own retrieval, which `stance train tmr` writes; the same command \
                 again adds it to a finished run",
                run.display()
            )));
        }
        Err(source) => return Err(failed(source)),
    };
    let report: JudgeReport =
        serde_json::from_slice(&text).map_err(|source| failed(source.into()))?;
    if report.encoder_hash != encoder_hash {
        return Ok(Some(format!(
            "{} is of other weights ({:.12}); run the same `stance train tmr` again",
            path.display(),
            report.encoder_hash
        )));
    }
    Ok(report.weakness())
}

/// Facts about an encoder, for tables.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Judge {
    /// How the encoder was trained, in one line.
    pub recipe: String,
    /// Why the encoder cannot rank systems; `None` if it can.
    pub weakness: Option<String>,
}

/// Encoders by their hashes.
pub type Judges = BTreeMap<String, Judge>;

impl Judge {
    /// Collects the facts that an encoder states about itself.
    pub fn of(encoder: &dyn MotionEncoder) -> Self {
        Self {
            recipe: encoder.recipe(),
            weakness: encoder.weakness(),
        }
    }
}

/// Task, protocol, encoder and items of a score. Scores for which they are equal belong to one table.
pub(crate) type TableOf<'a> = (&'a str, &'a str, &'a str, &'a str);

pub(crate) fn table_of(row: &ScoreRow) -> TableOf<'_> {
    (
        &row.task,
        &row.protocol,
        &row.encoder_hash,
        &row.items_digest,
    )
}

/// Why a table cannot rank systems, as a sentence; `None` if it can. The table holds the scores with the task,
/// protocol, encoder and items of `first`.
pub(crate) fn unranked<'a>(
    first: &ScoreRow,
    rows: impl IntoIterator<Item = &'a ScoreRow>,
    judges: &Judges,
) -> Option<String> {
    let weakness = judges
        .get(&first.encoder_hash)
        .and_then(|judge| judge.weakness.as_ref());
    if let Some(weakness) = weakness {
        return Some(format!(
            "This table ranks nothing. The encoder {:.12} is too weak to judge: {weakness}.",
            first.encoder_hash
        ));
    }
    let is_of = |row: &&ScoreRow| {
        row.system == IDENTITY && row.metric == TOLD_APART && table_of(row) == table_of(first)
    };
    let told = rows.into_iter().find(is_of)?;
    // Scores of version 0.1 do not say how many targets they have.
    if (1..MIN_TARGETS).contains(&told.targets) {
        return Some(format!(
            "This table ranks nothing. It has {} targets, and {MIN_TARGETS} are needed to know whether the encoder tells targets \
             from sources.",
            told.targets
        ));
    }
    let lower = told.mean - told.ci95.unwrap_or(0.0);
    (lower <= 0.0).then(|| {
        format!(
            "This table ranks nothing. Its targets cannot be told from its sources: in {} the real data is {:.1}±{:.1} % above the \
             identity editor, and the lower bound must be above 0.",
            E2T_RECALL_1.name,
            told.mean,
            told.ci95.unwrap_or(0.0)
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_encoder_must_be_far_from_chance_and_can_be_where_chance_is_high() {
        let ranks = |lower: f64, chance: f64| {
            let bounded = Bounded { mean: lower, lower };
            let recalls = Recalls {
                r1: bounded,
                r3: bounded,
            };
            let report = JudgeReport {
                format: FORMAT,
                encoder_hash: String::new(),
                dataset_hash: String::new(),
                condition: None,
                split: "val".to_owned(),
                seed: 0,
                clips: 32,
                texts: 8,
                gallery: 32,
                repeats: 1,
                text_to_motion: recalls,
                motion_to_text: recalls,
                chance: Recalls {
                    r1: chance / 3.0,
                    r3: chance,
                },
            };
            report.weakness().is_none()
        };
        assert!(ranks(30.0, 10.0) && !ranks(29.9, 10.0));
        // Three times a chance of 40 % is above 100 %, so half of the way from chance to 100 % is enough.
        assert!(ranks(70.0, 40.0) && !ranks(69.9, 40.0) && !ranks(40.0, 40.0));
    }
}
