//! Evaluation protocol: galleries, repeats, and the draws that vary between repeats.

use datasets_spec::{Rng, Seed};
use kinematics::skeleton::{NUM_BODY_JOINTS, NUM_KEYPOINTS};
use rand::RngExt;
use serde::{Deserialize, Serialize};

use crate::Error;

/// Gallery size in the paper's main tables.
pub const PAPER_GALLERY: usize = 32;

/// Pairs drawn for Diversity in the T2M evaluation.
pub const T2M_DIVERSITY_PAIRS: usize = 300;

/// Suffix of the number of pairs in a protocol's name.
const PAIRS: &str = " diversity pairs";

/// Suffix of a protocol's name for intervals over test sets.
const FROM_TARGETS: &str = " draws of the targets";

/// Number of bootstrap resamples for the interval of a mean or a median over items.
pub(crate) const RESAMPLES: usize = 1000;

/// Number of bootstrap resamples for the intervals of FID and Diversity, which are recomputed on each.
pub(crate) const SET_RESAMPLES: usize = 100;

/// Number of bootstrap resamples for the interval of a difference in FID; each decomposes up to three large matrices.
pub(crate) const PAIR_RESAMPLES: usize = 200;

/// Maximum number of repeats; the values of all are kept in memory.
const MAX_REPEATS: usize = 10_000;

/// Size of a retrieval gallery.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Gallery {
    /// All items of the test set.
    Full,
    /// Random batches of this many items; the items left over are not ranked. A test set smaller
    /// than one batch is one gallery.
    Batches(usize),
}

/// Latents that the Fréchet distance compares.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FidSample {
    /// Each repeat splits the items into two random halves. The real data's value compares the targets of both halves;
    /// a system's value compares the targets of the first half with the system's motions of the second. All systems of
    /// a repeat share the halves, so the value of the real data is what a perfect system reaches, including the bias of
    /// finite samples.
    Halves,
    /// All targets are compared with all motions of a system. The real data have distance 0, and values are not
    /// comparable between test sets of different size.
    All,
}

/// Queries of a retrieval: the edited motions or the real ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Queries {
    /// Originals or targets are the queries, and edited motions form the gallery, as in the code of the MotionFix
    /// evaluation.
    Real,
    /// Edited motions are the queries, as the words "Edited-to-Source" say.
    Edited,
}

/// Variation that the 95 % interval of a value covers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Spread {
    /// Bootstrap over the targets: how the value would vary over other test sets. Items that share
    /// a target are drawn together.
    Targets,
    /// Spread over the repeats, as published: how galleries, pairs and takes of the same items
    /// change the value. A value that is the same in all repeats has no interval.
    Repeats,
}

/// Height of the floor for the foot score.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Floor {
    /// At the height of the lowest foot joint of the clip. The floor of an SMPL-X clip need not be at height 0, and the
    /// score penalises any distance from it.
    #[default]
    Lowest,
    /// The given height in metres for every clip; DIMOS uses 0.
    At(f64),
}

/// Keypoints that the position error compares.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Keypoints {
    /// All 28 keypoints of the model: joints of the body, eyes and fingers.
    All,
    /// The 22 joints of the body.
    ///
    /// # Source
    /// Paper, App. C.6: MotionFix is compared on 22 joints.
    Body,
}

impl Keypoints {
    /// Number of compared keypoints, which are the first ones.
    pub fn count(self) -> usize {
        match self {
            Self::All => NUM_KEYPOINTS,
            Self::Body => NUM_BODY_JOINTS,
        }
    }
}

/// A random part of the test set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Limit {
    /// Number of items that are kept.
    pub items: usize,
    /// Seed of the draw.
    pub seed: Seed,
}

/// How scores are measured. Two runs on the same items are comparable if their protocols and encoders are equal.
///
/// Four things vary between repeats: the galleries, the pairs of Diversity, the halves of the Fréchet distance and, for
/// a system with several takes of each item, the scored take. Draws do not depend on the system, so all systems are
/// scored on the same draws.
///
/// # Source
/// Paper, Sec. 6.1: galleries of 32 sampled at random, ten evaluations, 95 % intervals. New
/// galleries for every evaluation are our reading.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Protocol {
    /// Size of a retrieval gallery.
    pub gallery: Gallery,
    /// Number of repeats.
    pub repeats: usize,
    /// Number of pairs drawn for Diversity, and the minimum number of items for this metric.
    pub diversity_pairs: usize,
    /// Latents that the Fréchet distance compares.
    pub fid_sample: FidSample,
    /// Height of the floor for the foot score.
    pub floor: Floor,
    /// Queries of a retrieval.
    pub queries: Queries,
    /// Whether edited motions are truncated to the length of their target before encoding, as in the MotionFix
    /// evaluation.
    pub truncate_to_target: bool,
    /// Variation that the 95 % interval of a value covers.
    pub interval: Spread,
    /// Keypoints that the position error compares.
    pub keypoints: Keypoints,
    /// The random part of the items that is scored; `None` scores all.
    ///
    /// # Source
    /// The code of SimMotionEdit, OmniME and CIME scores a random half of the MotionFix test set: 506 of 1,013 pairs.
    pub limit: Option<Limit>,
    /// Seed of all draws.
    pub seed: Seed,
}

/// Number of repeats behind a row of the paper.
const PAPER_REPEATS: usize = 10;

impl Default for Protocol {
    fn default() -> Self {
        Self {
            gallery: Gallery::Batches(PAPER_GALLERY),
            repeats: PAPER_REPEATS,
            diversity_pairs: T2M_DIVERSITY_PAIRS,
            fid_sample: FidSample::Halves,
            floor: Floor::Lowest,
            queries: Queries::Real,
            truncate_to_target: false,
            interval: Spread::Targets,
            keypoints: Keypoints::All,
            limit: None,
            seed: Seed(0),
        }
    }
}

impl Protocol {
    /// Refuses settings with which nothing is measured, and more repeats than memory may hold.
    ///
    /// # Errors
    /// There are no repeats or more than 10,000, no Diversity pairs, a limit of no items, or galleries of fewer than two
    /// items; or the height of the floor is not finite.
    pub fn check(&self) -> Result<(), Error> {
        let at_least = |field: &str, needed: usize, found: usize| match found < needed {
            true => Err(Error::Invalid(format!(
                "protocol: {field} must be at least {needed}, got {found}"
            ))),
            false => Ok(()),
        };
        at_least("repeats", 1, self.repeats)?;
        if self.repeats > MAX_REPEATS {
            return Err(Error::Invalid(format!(
                "protocol: repeats must be at most {MAX_REPEATS}, got {}",
                self.repeats
            )));
        }
        at_least("diversity_pairs", 1, self.diversity_pairs)?;
        if let Some(limit) = self.limit {
            at_least("limit.items", 1, limit.items)?;
        }
        if let Floor::At(height) = self.floor
            && !height.is_finite()
        {
            return Err(Error::Invalid(format!(
                "protocol: floor must be a finite height in metres, got {height}"
            )));
        }
        match self.gallery {
            Gallery::Full => Ok(()),
            Gallery::Batches(size) => at_least("gallery", 2, size),
        }
    }

    /// The protocol in words, as applied to `num_items` items: a table then states the actual gallery sizes.
    pub fn name(&self, num_items: usize) -> String {
        let pairs = format!(", {}{PAIRS}", self.diversity_pairs);
        self.in_words(
            num_items,
            &pairs,
            &format!("{SET_RESAMPLES} for FID and Diversity"),
        )
    }

    /// The protocol of a comparison of two systems in words; Diversity is not compared.
    pub(crate) fn name_of_comparison(&self, num_items: usize) -> String {
        self.in_words(num_items, "", &format!("{PAIR_RESAMPLES} for FID"))
    }

    /// The protocol in words. `pairs` states the number of pairs of Diversity, with a comma before it, and `of_sets` the
    /// number of resamples of FID and Diversity.
    fn in_words(&self, num_items: usize, pairs: &str, of_sets: &str) -> String {
        let gallery = self.gallery_name(num_items);
        let fid = match self.fid_sample {
            FidSample::Halves => format!("FID between halves of {}", num_items / 2),
            FidSample::All => format!("FID on all {num_items}"),
        };
        let floor = match self.floor {
            Floor::Lowest => "floor at the lowest foot".to_owned(),
            Floor::At(height) => format!("floor at {height} m"),
        };
        let queries = match self.queries {
            Queries::Real => "real queries",
            Queries::Edited => "edited queries",
        };
        let length = if self.truncate_to_target {
            ", cut to the target's length"
        } else {
            ""
        };
        let keypoints = match self.keypoints {
            Keypoints::All => "",
            Keypoints::Body => ", position error of 22 joints",
        };
        let limit = self
            .limit
            .map_or_else(String::new, |Limit { items, seed }| {
                format!(", a random {items} of the items (seed {})", seed.0)
            });
        let interval = match self.interval {
            Spread::Targets => {
                format!("95 % intervals from {RESAMPLES}{FROM_TARGETS} ({of_sets})")
            }
            Spread::Repeats => "95 % intervals over the repeats".to_owned(),
        };
        format!(
            "{gallery}, {queries}{pairs}, {fid}, {floor}{length}{keypoints}{limit}, seed {}, \
             {interval}",
            self.seed.0
        )
    }

    /// Number of Diversity pairs, parsed from a protocol's name ([`Protocol::name`]).
    pub(crate) fn diversity_pairs_of(name: &str) -> Option<usize> {
        let count = name.split(", ").find_map(|part| part.strip_suffix(PAIRS))?;
        count.parse().ok()
    }

    /// Whether a protocol's name ([`Protocol::name`]) says that its intervals are over test sets.
    pub(crate) fn is_drawn_from_targets(name: &str) -> bool {
        name.contains(FROM_TARGETS)
    }

    /// The galleries in words.
    pub fn gallery_name(&self, num_items: usize) -> String {
        match self.gallery {
            Gallery::Full => format!("one gallery of all {num_items}"),
            Gallery::Batches(size) if num_items < size => {
                format!("one gallery of all {num_items} (fewer than {size})")
            }
            Gallery::Batches(size) => {
                let (count, left) = (num_items / size, num_items % size);
                let galleries = if count == 1 { "gallery" } else { "galleries" };
                let rest = if left == 0 {
                    String::new()
                } else {
                    format!(" ({left} of {num_items} items left over in each repeat)")
                };
                format!("{count} {galleries} of {size}{rest}")
            }
        }
    }

    /// Number of items in a gallery, and in all galleries of a repeat together.
    pub fn gallery_sizes(&self, num_items: usize) -> (usize, usize) {
        let size = self.batch(num_items).unwrap_or(num_items);
        (size, num_items / size.max(1) * size)
    }

    /// Number of items in a batch; `None` if one gallery holds all items.
    fn batch(&self, num_items: usize) -> Option<usize> {
        match self.gallery {
            Gallery::Batches(size) if num_items >= size => Some(size),
            Gallery::Full | Gallery::Batches(_) => None,
        }
    }

    /// Positions of the scored items among `num_items` items sorted by id.
    ///
    /// # Errors
    /// There are fewer items than the limit asks for.
    pub fn scored_items(&self, num_items: usize) -> Result<Vec<usize>, Error> {
        let Some(limit) = self.limit else {
            return Ok((0..num_items).collect());
        };
        if num_items < limit.items {
            return Err(Error::Invalid(format!(
                "{} items are to be scored, and there are {num_items}; ask for fewer or leave the limit out",
                limit.items
            )));
        }
        let mut rng = limit.seed.rng(&["eval", "limit"]);
        let mut kept = draw_without_replacement(num_items, limit.items, &mut rng);
        kept.sort_unstable();
        Ok(kept)
    }

    /// The galleries of a repeat, as positions of items.
    pub fn galleries(&self, num_items: usize, repeat: usize) -> Vec<Vec<usize>> {
        let Some(size) = self.batch(num_items) else {
            return vec![(0..num_items).collect()];
        };
        let mut rng = self.rng("gallery", repeat);
        let order = draw_without_replacement(num_items, num_items, &mut rng);
        order.chunks_exact(size).map(<[usize]>::to_vec).collect()
    }

    /// Number of repeats with different galleries: one if a gallery holds all items.
    pub fn distinct_galleries(&self, num_items: usize) -> usize {
        match self.batch(num_items) {
            Some(size) if num_items > size => self.repeats,
            _ => 1,
        }
    }

    /// Number of items on each side of a Fréchet distance.
    pub fn fid_size(&self, num_items: usize) -> usize {
        match self.fid_sample {
            FidSample::Halves => num_items / 2,
            FidSample::All => num_items,
        }
    }

    /// Items whose targets, and items whose scored motions, enter the Fréchet distance of a repeat.
    pub fn fid_items(&self, num_items: usize, repeat: usize) -> [Vec<usize>; 2] {
        match self.fid_sample {
            FidSample::Halves => {
                let order =
                    draw_without_replacement(num_items, num_items, &mut self.rng("fid", repeat));
                let half = self.fid_size(num_items);
                [order[..half].to_vec(), order[half..2 * half].to_vec()]
            }
            FidSample::All => [(0..num_items).collect(), (0..num_items).collect()],
        }
    }

    /// The random generator for one purpose, such as `diversity`, in one repeat or resample.
    pub(crate) fn rng(&self, what: &str, repeat: usize) -> Rng {
        self.seed.rng(&["eval", what, &repeat.to_string()])
    }
}

/// Draws distinct positions below `size` in random order.
///
/// # Panics
/// If `count` exceeds `size`.
pub(crate) fn draw_without_replacement(size: usize, count: usize, rng: &mut Rng) -> Vec<usize> {
    assert!(
        count <= size,
        "cannot draw {count} of {size} without replacement"
    );
    let mut indices: Vec<usize> = (0..size).collect();
    for drawn in 0..count {
        let other = rng.random_range(drawn..size);
        indices.swap(drawn, other);
    }
    indices.truncate(count);
    indices
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A protocol that scores a random part of the items.
    fn limited(items: usize, seed: u64) -> Protocol {
        let seed = Seed(seed);
        Protocol {
            limit: Some(Limit { items, seed }),
            ..Protocol::default()
        }
    }

    #[test]
    fn the_name_says_what_applies_to_the_set_at_hand() {
        let protocol = Protocol::default();
        assert_eq!(
            protocol.name(1013),
            "31 galleries of 32 (21 of 1013 items left over in each repeat), real queries, 300 \
             diversity pairs, FID between halves of 506, floor at the lowest foot, seed 0, 95 % \
             intervals from 1000 draws of the targets (100 for FID and Diversity)"
        );
        assert_eq!(
            protocol.name_of_comparison(64),
            "2 galleries of 32, real queries, FID between halves of 32, floor at the lowest foot, \
             seed 0, 95 % intervals from 1000 draws of the targets (200 for FID)"
        );
        let few = protocol.name(20);
        assert!(few.starts_with("one gallery of all 20 (fewer than 32)"));
        assert!(few.contains(", 300 diversity pairs"));
        for diversity_pairs in [1, 300] {
            let name = Protocol {
                diversity_pairs,
                ..protocol
            }
            .name(20);
            assert_eq!(Protocol::diversity_pairs_of(&name), Some(diversity_pairs));
        }
        assert_eq!(Protocol::diversity_pairs_of("another protocol"), None);
        let full = Protocol {
            gallery: Gallery::Full,
            fid_sample: FidSample::All,
            truncate_to_target: true,
            floor: Floor::At(0.0),
            queries: Queries::Edited,
            interval: Spread::Repeats,
            keypoints: Keypoints::Body,
            ..limited(5, 42)
        };
        assert!(Protocol::is_drawn_from_targets(&few));
        assert!(!Protocol::is_drawn_from_targets(&full.name(5)));
        assert_eq!(
            full.name(5),
            "one gallery of all 5, edited queries, 300 diversity pairs, FID on all 5, \
             floor at 0 m, cut to the target's length, position error of 22 joints, \
             a random 5 of the items (seed 42), seed 0, 95 % intervals over the repeats"
        );
        assert!(protocol.name(64).starts_with("2 galleries of 32, "));
        assert!(protocol.name(32).starts_with("1 gallery of 32, "));
        assert_eq!(protocol.gallery_sizes(1013), (32, 992));
        assert_eq!(full.gallery_sizes(1013), (1013, 1013));
        assert_eq!(protocol.gallery_sizes(20), (20, 20));
    }

    #[test]
    fn protocols_that_measure_nothing_are_refused() {
        let default = Protocol::default();
        assert!(default.check().is_ok());
        let most = Protocol {
            repeats: MAX_REPEATS,
            ..default
        };
        assert!(most.check().is_ok());
        for broken in [
            Protocol {
                repeats: 0,
                ..default
            },
            Protocol {
                repeats: MAX_REPEATS + 1,
                ..default
            },
            Protocol {
                diversity_pairs: 0,
                ..default
            },
            Protocol {
                gallery: Gallery::Batches(1),
                ..default
            },
            Protocol {
                floor: Floor::At(f64::NAN),
                ..default
            },
            limited(0, 0),
        ] {
            assert!(broken.check().is_err(), "{broken:?}");
        }
    }

    #[test]
    fn a_protocol_survives_json_and_refuses_unknown_settings() {
        let protocol = Protocol::default();
        let text = serde_json::to_string(&protocol).expect("serialisable");
        for text in [text.as_str(), "{}"] {
            let read: Protocol = serde_json::from_str(text).expect("readable");
            assert_eq!(read, protocol);
        }
        assert!(serde_json::from_str::<Protocol>(r#"{"repeat": 3}"#).is_err());
    }

    #[test]
    fn a_random_half_is_the_same_for_everyone_who_names_its_seed() {
        let half = |seed| limited(506, seed);
        let kept = half(42).scored_items(1013).expect("enough");
        assert_eq!(kept.len(), 506);
        assert!(kept.is_sorted() && kept.last().is_some_and(|last| *last < 1013));
        assert_eq!(half(42).scored_items(1013).expect("enough"), kept);
        assert_ne!(half(43).scored_items(1013).expect("enough"), kept);
        assert_eq!(half(42).gallery_sizes(506), (32, 480));
        assert_eq!(Protocol::default().scored_items(3).expect("all"), [0, 1, 2]);
        let error = half(42).scored_items(505).expect_err("too few").to_string();
        assert!(error.contains("506") && error.contains("505"), "{error}");
    }

    proptest! {
        #[test]
        fn galleries_and_halves_never_repeat_an_item(
            num_items in 0usize..200,
            repeat in 0usize..10,
            seed in any::<u64>(),
        ) {
            let protocol = Protocol { seed: Seed(seed), ..Protocol::default() };
            let galleries = protocol.galleries(num_items, repeat);
            let expected = if num_items < 32 { 1 } else { num_items / 32 };
            prop_assert_eq!(galleries.len(), expected);
            let mut seen = galleries.concat();
            let count = seen.len();
            seen.sort_unstable();
            seen.dedup();
            prop_assert_eq!(seen.len(), count);
            prop_assert!(seen.last().is_none_or(|last| *last < num_items));
            let is_one = protocol.distinct_galleries(num_items) == 1;
            prop_assert_eq!(is_one, galleries[0].len() == num_items);
            let [real, compared] = protocol.fid_items(num_items, repeat);
            prop_assert_eq!(real.len(), compared.len());
            prop_assert!(real.iter().all(|item| !compared.contains(item)));
            prop_assert_eq!(protocol.galleries(num_items, repeat), galleries);
        }
    }
}
