//! Seeded draws: subsets, orders and crops.

use std::ops::{Range, RangeInclusive};

use datasets_spec::Seed;

/// Rounds of the Feistel network below; four make it pseudorandom (Luby and Rackoff 1988).
const FEISTEL_ROUNDS: u64 = 4;

/// Indices of a seeded fraction of a list, in order: the items with the smallest draws. A smaller fraction of the same
/// list is a subset of a larger one, and a new item displaces at most one other.
pub(super) fn subset(share: f64, seed: Seed, purpose: &str, ids: &[&str]) -> Vec<usize> {
    let num_kept = ((share * ids.len() as f64).ceil() as usize).min(ids.len());
    if num_kept == ids.len() {
        return (0..ids.len()).collect();
    }
    let mut ranked: Vec<(u64, usize)> = ids
        .iter()
        .enumerate()
        .map(|(index, id)| (seed.draw_u64(&[purpose, id]), index))
        .collect();
    ranked.sort_unstable();
    let mut kept: Vec<usize> = ranked[..num_kept].iter().map(|&(_, index)| index).collect();
    kept.sort_unstable();
    kept
}

/// A pseudorandom permutation of `0..len`, computed per index and not stored, so that training resumes at
/// any item of any epoch.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shuffle {
    len: u64,
    half_bits: u32,
    key: u64,
}

impl Shuffle {
    /// The permutation of `0..len` with this key.
    pub(super) fn new(len: u64, key: u64) -> Self {
        let bits = u64::BITS - len.saturating_sub(1).leading_zeros();
        Self {
            len,
            half_bits: bits.div_ceil(2).max(1),
            key,
        }
    }

    /// The item at an index of the permutation.
    ///
    /// # Panics
    /// If the index is not below `len`.
    pub(super) fn at(&self, place: u64) -> u64 {
        assert!(place < self.len, "item {place} of {}", self.len);
        // The network permutes the numbers below a power of four. Repeating it from a number below `len` leads back
        // below `len`, on average in at most about four steps.
        let mut item = self.permuted(place);
        while item >= self.len {
            item = self.permuted(item);
        }
        item
    }

    fn permuted(&self, item: u64) -> u64 {
        let mask = (1 << self.half_bits) - 1;
        let (mut left, mut right) = (item >> self.half_bits, item & mask);
        for round in 0..FEISTEL_ROUNDS {
            (left, right) = (right, left ^ (mixed(right ^ self.key, round) & mask));
        }
        left << self.half_bits | right
    }
}

/// The finaliser of SplitMix64 (Steele, Lea and Flood 2014), with its increment as round constant.
fn mixed(value: u64, round: u64) -> u64 {
    let z = value.wrapping_add((round + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// The crops of two motions that are blended: the whole shorter motion, and an equally long part of the longer one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Crop {
    pub(super) source_start: usize,
    pub(super) target_start: usize,
    pub(super) num_frames: usize,
}

impl Crop {
    /// All of two motions of equal length.
    pub(super) fn whole(num_frames: usize) -> Self {
        Self {
            source_start: 0,
            target_start: 0,
            num_frames,
        }
    }

    /// Crops the longer motion to the length of the shorter. `place` chooses the first frame that is kept, from the
    /// given range. If the target is cropped, it keeps the frames `held`, or as many of them as the source has.
    pub(super) fn around(
        source_frames: usize,
        target_frames: usize,
        held: &Range<usize>,
        mut place: impl FnMut(RangeInclusive<usize>) -> usize,
    ) -> Self {
        let num_frames = source_frames.min(target_frames);
        let (source_start, target_start) = if source_frames > target_frames {
            (place(0..=source_frames - num_frames), 0)
        } else if num_frames < held.len() {
            (0, place(held.start..=held.end - num_frames))
        } else {
            let last = held.start.min(target_frames - num_frames);
            (0, place(held.end.saturating_sub(num_frames)..=last))
        };
        Self {
            source_start,
            target_start,
            num_frames,
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rand::RngExt;

    use super::*;

    proptest! {
        #[test]
        fn a_shuffle_visits_every_item_once(len in 1..600u64, key in any::<u64>()) {
            let shuffle = Shuffle::new(len, key);
            let mut seen: Vec<u64> = (0..len).map(|place| shuffle.at(place)).collect();
            seen.sort_unstable();
            prop_assert!(seen.into_iter().eq(0..len));
        }

        #[test]
        fn a_crop_lies_in_both_motions_and_keeps_what_is_held(
            a in 1..300usize, b in 1..300usize, seed in any::<u64>(), bounds in any::<[prop::sample::Index; 2]>(),
        ) {
            let [first, last] = bounds.map(|at| at.index(b));
            let held = first.min(last)..first.max(last) + 1;
            let mut rng = Seed(seed).rng(&["crop"]);
            let crop = Crop::around(a, b, &held, |allowed| rng.random_range(allowed));
            prop_assert_eq!(crop.num_frames, a.min(b));
            prop_assert!(crop.source_start + crop.num_frames <= a);
            let taken = crop.target_start..crop.target_start + crop.num_frames;
            prop_assert!(taken.end <= b);
            let shared = taken.start.max(held.start)..taken.end.min(held.end);
            prop_assert_eq!(shared.len(), held.len().min(crop.num_frames));
        }
    }

    #[test]
    fn different_keys_shuffle_differently() {
        let order = |key| {
            let shuffle = Shuffle::new(100, key);
            let places = (0..100).map(|place| shuffle.at(place));
            places.collect::<Vec<u64>>()
        };
        assert_ne!(order(1), order(2));
        assert_ne!(order(1), (0..100).collect::<Vec<u64>>());
    }

    #[test]
    fn a_smaller_share_is_a_subset_of_a_larger_one() {
        let ids: Vec<String> = (0..200).map(|i| format!("clip{i}")).collect();
        let ids: Vec<&str> = ids.iter().map(String::as_str).collect();
        let kept = |share| subset(share, Seed(1), "base", &ids);
        assert_eq!(kept(0.01).len(), 2);
        assert_eq!(kept(1.0).len(), 200);
        assert!(kept(0.1).iter().all(|i| kept(0.2).contains(i)));
        assert_ne!(kept(0.1), subset(0.1, Seed(2), "base", &ids));
    }
}
