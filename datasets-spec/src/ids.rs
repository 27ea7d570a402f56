//! Motion ids, splits and seeded random generators.

use rand::SeedableRng;
use serde::{Deserialize, Serialize};

use crate::Error;

/// The random generator of the project. Its stream is documented and stable, so recorded seeds stay
/// meaningful.
pub type Rng = rand_pcg::Pcg64;

/// The stable name of a motion: the path of its source relative to the ingested root, without extension, followed by
/// `#key` for one of several motions of a file, `@start-end` (source frames) for a crop and `~m` for a mirrored copy;
/// or a HumanML3D id (`012314`, mirrored `M012314`).
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct MotionId(String);

impl MotionId {
    /// Longest accepted id in bytes.
    pub const MAX_BYTES: usize = 512;

    /// Parses an id.
    ///
    /// # Errors
    /// The text is empty, too long, starts or ends with a space, or holds control characters.
    pub fn parse(text: &str) -> Result<Self, Error> {
        let reason = if text.is_empty() {
            "it is empty"
        } else if text.len() > Self::MAX_BYTES {
            "it is longer than 512 bytes"
        } else if text.chars().any(char::is_control) {
            "it holds a control character"
        } else if text.trim() != text {
            "it starts or ends with a space"
        } else {
            return Ok(Self(text.to_owned()));
        };
        Err(Error::Refused(format!(
            "motion id {text:?} is not usable: {reason}"
        )))
    }

    /// The id as text.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// The id of the clip that this one was mirrored or cropped from, or of the file it shares with others. It
    /// determines the split, so that no copy leaks into another split.
    pub fn source_clip(&self) -> &str {
        let whole = self.0.split(['@', '#']).next().unwrap_or(&self.0);
        let whole = whole.strip_suffix("~m").unwrap_or(whole);
        match whole.strip_prefix('M') {
            Some(digits) if digits.len() == 6 && digits.bytes().all(|b| b.is_ascii_digit()) => {
                digits
            }
            _ => whole,
        }
    }
}

impl TryFrom<String> for MotionId {
    type Error = Error;

    fn try_from(value: String) -> Result<Self, Error> {
        Self::parse(&value)
    }
}

impl From<MotionId> for String {
    fn from(id: MotionId) -> String {
        id.0
    }
}

impl std::fmt::Display for MotionId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

kinematics::named! {
    /// Part of a dataset that a motion belongs to. Tables list the parts in this order.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
    #[serde(rename_all = "lowercase")]
    pub enum Split, named by as_str {
        /// Models, normalisation, masks and embeddings are fitted to it.
        Train = "train",
        /// Checkpoints are chosen by it.
        Val = "val",
        /// It is used once, for the result table.
        Test = "test",
    }
}

impl Split {
    /// The split of a source clip by the paper's proportions 80/5/15 (Sec. 6.1). It depends only on the clip
    /// and the seed, so clips keep their split when a dataset grows.
    pub fn assign(source_clip: &str, seed: Seed) -> Self {
        match seed.draw_u64(&["split", source_clip]) % 100 {
            0..80 => Self::Train,
            80..85 => Self::Val,
            _ => Self::Test,
        }
    }
}

impl std::str::FromStr for Split {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        Self::of_name(text).ok_or_else(|| {
            Error::Refused(format!("split must be train, val or test, got {text:?}"))
        })
    }
}

/// The seed of a run. Every random generator is derived from the seed and the names of its draw, so that the order of
/// threads has no influence.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Seed(pub u64);

impl Seed {
    /// An independent generator for the draw named by `parts`, for example
    /// `["compose", epoch, item id]`.
    pub fn rng(self, parts: &[&str]) -> Rng {
        Rng::from_seed(self.digest(parts))
    }

    /// A generator for the item with this number. It takes a few nanoseconds, much less than [`Seed::rng`]: its state
    /// is the output of SplitMix64 (Steele, Lea and Flood 2014), started from seed and number.
    pub fn rng_of(self, number: u64) -> Rng {
        let mut at = self.0 ^ number.wrapping_mul(0xd134_2543_de82_ef95);
        let mut bytes = <Rng as SeedableRng>::Seed::default();
        for chunk in bytes.chunks_mut(8) {
            at = at.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let z = (at ^ (at >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            let word = (z ^ (z >> 31)).to_le_bytes();
            chunk.copy_from_slice(&word[..chunk.len()]);
        }
        Rng::from_seed(bytes)
    }

    /// A random number for the draw named by `parts`.
    pub fn draw_u64(self, parts: &[&str]) -> u64 {
        let digest = self.digest(parts);
        let (words, _) = digest.as_chunks();
        u64::from_le_bytes(words[0])
    }

    /// A derived seed for a sub-task, independent of other uses.
    pub fn derive(self, parts: &[&str]) -> Seed {
        Seed(self.draw_u64(parts))
    }

    fn digest(self, parts: &[&str]) -> [u8; 32] {
        let mut hasher = blake3::Hasher::new();
        hasher.update(&self.0.to_le_bytes());
        for part in parts {
            // The length keeps ["ab", "c"] apart from ["a", "bc"].
            hasher.update(&(part.len() as u64).to_le_bytes());
            hasher.update(part.as_bytes());
        }
        *hasher.finalize().as_bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mirrored_or_cropped_clip_shares_the_split_of_its_source() {
        for (id, clip) in [
            ("012314", "012314"),
            ("M012314", "012314"),
            ("CMU/01/01_01_poses@0-120", "CMU/01/01_01_poses"),
            ("walk~m", "walk"),
            ("Mwalk", "Mwalk"),
        ] {
            assert_eq!(MotionId::parse(id).expect("valid").source_clip(), clip);
        }
    }

    #[test]
    fn splits_follow_the_published_proportions() {
        let mut counts = [0usize; 3];
        for index in 0..20_000 {
            counts[Split::assign(&format!("clip{index}"), Seed(1)) as usize] += 1;
        }
        // Four standard deviations of a binomial count of 20,000.
        for (count, share) in counts.into_iter().zip([0.80, 0.05, 0.15]) {
            let variance: f64 = 20_000.0 * share * (1.0 - share);
            assert!((count as f64 - 20_000.0 * share).abs() < 4.0 * variance.sqrt());
        }
    }

    #[test]
    fn numbered_generators_repeat_and_differ() {
        use rand::RngExt;
        let draws: Vec<u64> = (0..1000).map(|n| Seed(3).rng_of(n).random()).collect();
        assert_eq!(draws[7], Seed(3).rng_of(7).random::<u64>());
        let mut distinct = draws.clone();
        distinct.sort_unstable();
        distinct.dedup();
        assert_eq!(distinct.len(), draws.len());
        assert_ne!(draws[0], Seed(4).rng_of(0).random::<u64>());
        // Bits are unbiased: the bound is 8 standard deviations of 64,000 fair bits.
        let ones: u32 = draws.iter().map(|draw| draw.count_ones()).sum();
        assert!((f64::from(ones) - 32_000.0).abs() < 8.0 * 126.5);
    }

    #[test]
    fn seeds_separate_names_and_repeat() {
        let seed = Seed(7);
        assert_eq!(seed.draw_u64(&["a", "b"]), seed.draw_u64(&["a", "b"]));
        assert_ne!(seed.draw_u64(&["ab", "c"]), seed.draw_u64(&["a", "bc"]));
        assert_ne!(seed.draw_u64(&["a"]), Seed(8).draw_u64(&["a"]));
    }

    #[test]
    fn ids_that_could_not_be_a_file_name_are_refused() {
        for bad in ["", " a", "a\n", &"x".repeat(513)] {
            assert!(MotionId::parse(bad).is_err(), "{bad:?}");
        }
    }
}
