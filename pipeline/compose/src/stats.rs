//! Statistics of a stream and of its triplets.

use std::collections::BTreeMap;

use datasets_spec::{Motion, Skeleton, Split};
use kinematics::skeleton::NUM_BODY_JOINTS;
use rayon::prelude::*;
use serde::Serialize;

use super::{Error, Stream, Triplet};

/// Bins of the histogram of weights.
const ALPHA_BINS: usize = 10;

/// Statistics of a stream's settings.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StreamStats {
    /// Split of all motions.
    pub split: Split,
    /// Motions that partners are drawn from.
    pub base: usize,
    /// Masks and pairs in use, by kind of edit.
    pub annotated: BTreeMap<&'static str, usize>,
    /// Masks and pairs that are shorter than a window, and are not used.
    pub too_short: usize,
    /// Windows of an epoch.
    pub windows: u64,
    /// Different pairs of an original and an edited motion, before crops and weights are drawn: for
    /// semantic edits masks times partners, for pairs halves of the body times donors. The paper
    /// counts N_L x N_S.
    pub distinct_pairs: BTreeMap<&'static str, u64>,
    /// Different wordings of instructions.
    pub instructions: usize,
}

/// Statistics of triplets of a stream.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TripletStats {
    /// Number of triplets.
    pub triplets: usize,
    /// Triplets by kind of edit and hard joints of the mask.
    pub masks: BTreeMap<String, usize>,
    /// Triplets by instruction, the most frequent first.
    pub instructions: Vec<(String, usize)>,
    /// Triplets by weight of the target on soft joints, in ten bins from 0 to 1.
    pub alphas: [usize; ALPHA_BINS],
    /// Mean speed of the body joints in m/s, before and after the edit.
    pub mean_speed: [f64; 2],
    /// Mean over the motions of the highest joint speed in m/s, before and after the edit.
    pub max_speed: [f64; 2],
}

impl Stream {
    /// Statistics of the settings.
    pub fn stats(&self) -> StreamStats {
        let mut annotated: BTreeMap<&'static str, usize> = BTreeMap::new();
        let mut distinct_pairs: BTreeMap<&'static str, u64> = BTreeMap::new();
        for subject in self.subjects_in_use() {
            let kind = self.library.edit(subject).kind.as_str();
            let partners = self
                .base
                .iter()
                .filter(|&&clip| self.library.may_meet(clip, subject))
                .count() as u64;
            let ways = self.library.edit(subject).halves.len().max(1) as u64;
            // A pair that never gets a donor, or always the same one, counts as one pair.
            let is_captured = self.library.undonored_ratio(subject, &self.config) >= 1.0;
            let is_one = is_captured || self.config.fixed_pairs;
            let count = if is_one { 1 } else { partners * ways };
            *annotated.entry(kind).or_default() += 1;
            *distinct_pairs.entry(kind).or_default() += count;
        }
        StreamStats {
            split: self.library.split(),
            base: self.base.len(),
            annotated,
            too_short: self.num_short(),
            windows: self.epoch_len(),
            distinct_pairs,
            instructions: self.instructions().len(),
        }
    }

    /// The first whole-clip triplets of the stream, epoch after epoch.
    ///
    /// # Errors
    /// The motions cannot be read.
    pub fn first_triplets(&self, count: u64) -> Result<Vec<Triplet>, Error> {
        (0..count)
            .into_par_iter()
            .map(|number| self.triplet(number / self.epoch_len(), number % self.epoch_len()))
            .collect()
    }

    /// Up to `count` triplets for a picture: first one of every kind and mask, those with soft joints before others,
    /// then a second one of each, and so on.
    ///
    /// # Errors
    /// The motions cannot be read.
    pub fn sample_for_sheet(&self, count: usize) -> Result<Vec<Triplet>, Error> {
        const LOOKED_AT: u64 = 512;
        let mut seen = BTreeMap::new();
        let mut rest = Vec::new();
        for triplet in self.first_triplets(LOOKED_AT.min(2 * self.epoch_len()))? {
            let mask = (triplet.kind, triplet.mask.hard().names());
            // A mask is shown again only after all others; soft masks come first.
            let number = seen.entry(mask).or_insert(0);
            let is_soft = !triplet.mask.soft().is_empty();
            rest.push(((*number, !is_soft), triplet));
            *number += 1;
        }
        rest.sort_by_key(|(rank, _)| *rank);
        Ok(rest
            .into_iter()
            .take(count)
            .map(|(_, triplet)| triplet)
            .collect())
    }
}

/// Computes the statistics of triplets.
pub fn triplet_stats(triplets: &[Triplet], skeleton: &Skeleton) -> TripletStats {
    let mut masks = BTreeMap::new();
    let mut instructions: BTreeMap<&str, usize> = BTreeMap::new();
    let mut alphas = [0; ALPHA_BINS];
    for triplet in triplets {
        let part = match triplet.mask.is_empty() {
            true => "plain pair".to_owned(),
            false => triplet.mask.hard().names().join(" "),
        };
        *masks
            .entry(format!("{}: {part}", triplet.kind))
            .or_default() += 1;
        *instructions.entry(&triplet.instruction).or_default() += 1;
        let bin = (triplet.alpha * ALPHA_BINS as f64) as usize;
        alphas[bin.min(ALPHA_BINS - 1)] += 1;
    }
    let mut instructions: Vec<(String, usize)> = instructions
        .into_iter()
        .map(|(text, count)| (text.to_owned(), count))
        .collect();
    instructions.sort_by(|a, b| b.1.cmp(&a.1).then_with(|| a.0.cmp(&b.0)));
    let speeds: Vec<[(f64, f64); 2]> = triplets
        .par_iter()
        .map(|triplet| [&triplet.original, &triplet.edited].map(|motion| speed(motion, skeleton)))
        .collect();
    let mean = |side: usize, of: fn(&(f64, f64)) -> f64| {
        speeds.iter().map(|both| of(&both[side])).sum::<f64>() / speeds.len().max(1) as f64
    };
    TripletStats {
        triplets: triplets.len(),
        masks,
        instructions,
        alphas,
        mean_speed: [0, 1].map(|side| mean(side, |speed| speed.0)),
        max_speed: [0, 1].map(|side| mean(side, |speed| speed.1)),
    }
}

/// Mean and highest speed of the body joints in m/s.
fn speed(motion: &Motion, skeleton: &Skeleton) -> (f64, f64) {
    let joints = skeleton.points_of_frames::<NUM_BODY_JOINTS>(motion, 0..motion.len());
    let (mut sum, mut highest) = (0.0, 0.0f64);
    for pair in joints.windows(2) {
        for (before, after) in pair[0].iter().zip(&pair[1]) {
            let speed = before.distance(*after) * motion.fps().get();
            sum += speed;
            highest = highest.max(speed);
        }
    }
    let count = joints.len().saturating_sub(1).max(1) * NUM_BODY_JOINTS;
    (sum / count as f64, highest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ComposeConfig, fixture};

    fn stream(config: ComposeConfig) -> Stream {
        let (motions, masks) = fixture::rows(Split::Train, 9);
        let pairs = [fixture::pair_row("style", Split::Train, 5, 6)];
        let library = fixture::library_of(Split::Train, &motions, &masks, &pairs);
        fixture::stream(library, config, 5).expect("a stream")
    }

    #[test]
    fn pairs_are_masks_times_partners() {
        let stats = stream(ComposeConfig::default()).stats();
        assert_eq!((stats.base, stats.annotated["semantic"]), (9, 5));
        // Five masks meet eight others each; a pair meets seven in two halves.
        assert_eq!(stats.distinct_pairs["semantic"], 40);
        assert_eq!(stats.distinct_pairs["style"], 14);
        assert_eq!(stats.distinct_pairs.values().sum::<u64>(), 54);
        let fixed = fixture::config(|config| config.fixed_pairs = true);
        assert_eq!(stream(fixed).stats().distinct_pairs["semantic"], 5);
    }

    #[test]
    fn every_triplet_is_counted_once() {
        let stream = stream(ComposeConfig::default());
        let triplets = stream.first_triplets(40).expect("in memory");
        let stats = triplet_stats(&triplets, &Skeleton::smplx_neutral());
        assert_eq!(stats.alphas.iter().sum::<usize>(), 40);
        assert_eq!(stats.masks.values().sum::<usize>(), 40);
        let instructions = stats.instructions.iter().map(|entry| entry.1);
        assert_eq!(instructions.sum::<usize>(), 40);
        assert!(stats.instructions.is_sorted_by(|a, b| a.1 >= b.1));
        let mut speeds = stats.mean_speed.iter().zip(stats.max_speed);
        assert!(speeds.all(|(mean, max)| *mean < max));
        let sheet = stream.sample_for_sheet(5).expect("in memory");
        assert_eq!(sheet.len(), 5);
        assert!(sheet.iter().any(|triplet| !triplet.mask.soft().is_empty()));
    }
}
