//! Token vocabulary of the learned text encoder.

use std::collections::BTreeSet;

use datasets_spec::Seed;
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::checkpoint::Start;
use crate::config::{WordsConfig, ensure, positive};

/// Id of the padding token, which fills rows up to the length of the longest.
pub const PADDING: i32 = 0;

/// The words of the training instructions. Unknown words are hashed into a few buckets, so that a word always gets the
/// same token.
///
/// Token ids: 0 for padding, then the words in alphabetical order, then the buckets.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Vocabulary {
    words: Vec<String>,
    num_buckets: usize,
    max_words: usize,
}

/// Token ids of several texts, `[B, T]` row-major, padded with [`PADDING`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TokenBatch {
    /// Token ids.
    pub ids: Vec<i32>,
    /// Number of tokens in a row, at least one.
    pub width: usize,
}

impl TokenBatch {
    /// Texts as rows, padded to the longest text.
    pub(crate) fn of<T: AsRef<[i32]>>(texts: &[T]) -> Self {
        let (ids, longest) = padded_rows(texts.iter().map(T::as_ref), PADDING);
        Self {
            ids,
            width: longest.max(1),
        }
    }

    /// Number of tokens in each row that are not padding, `[B]`.
    pub fn lengths(&self) -> impl Iterator<Item = usize> {
        let rows = self.ids.chunks_exact(self.width);
        rows.map(|row| row.iter().filter(|&&id| id != PADDING).count())
    }
}

/// Rows of different lengths as one row-major array, each padded to the longest, and the length of the longest.
pub(crate) fn padded_rows<'a, T: Copy + 'a>(
    rows: impl Iterator<Item = &'a [T]> + Clone,
    padding: T,
) -> (Vec<T>, usize) {
    let longest = rows.clone().map(<[T]>::len).max().unwrap_or(0);
    let mut values = Vec::with_capacity(rows.clone().count() * longest);
    for row in rows {
        let end = values.len() + longest;
        values.extend_from_slice(row);
        values.resize(end, padding);
    }
    (values, longest)
}

impl Vocabulary {
    /// Collects the words of `texts`. Encoding truncates texts after `max_words` words.
    ///
    /// # Errors
    /// `num_buckets` or `max_words` is 0.
    pub fn build<'a>(
        texts: impl IntoIterator<Item = &'a str>,
        num_buckets: usize,
        max_words: usize,
    ) -> Result<Self, Error> {
        positive("text.num_buckets", num_buckets as u64)?;
        positive("text.max_words", max_words as u64)?;
        let words: BTreeSet<String> = texts.into_iter().flat_map(words_of).collect();
        Ok(Self {
            words: words.into_iter().collect(),
            num_buckets,
            max_words,
        })
    }

    /// Refuses settings of another vocabulary than this one, which a new run takes over with the weights that it begins
    /// with. A run that has begun keeps the settings that it recorded.
    pub(crate) fn check_kept(
        &self,
        field: &'static str,
        words: &WordsConfig,
        start: Start<'_>,
    ) -> Result<(), Error> {
        let (buckets, most) = (self.num_buckets, self.max_words);
        let is_kept = (words.num_buckets, words.max_words) == (buckets, most);
        let problem = format!(
            "the run keeps the vocabulary of the weights that it begins with; set num_buckets = {buckets} and \
             max_words = {most} as there"
        );
        ensure(is_kept || start.has_begun(), field, problem)
    }

    /// Number of tokens: padding, words and buckets.
    pub fn num_tokens(&self) -> usize {
        1 + self.words.len() + self.num_buckets
    }

    /// The token ids of a text. A text without words gives one padding token.
    pub fn encode(&self, text: &str) -> Vec<i32> {
        let mut ids: Vec<i32> = words_of(text)
            .take(self.max_words)
            .map(|word| self.token(&word) as i32)
            .collect();
        if ids.is_empty() {
            ids.push(PADDING);
        }
        ids
    }

    /// The token ids of several texts, padded to the longest.
    pub fn encode_batch<'a>(&self, texts: impl IntoIterator<Item = &'a str>) -> TokenBatch {
        let rows: Vec<Vec<i32>> = texts.into_iter().map(|text| self.encode(text)).collect();
        TokenBatch::of(&rows)
    }

    /// Unknown words among the first `max_words` of a text, without duplicates, in order.
    pub fn unknown_words(&self, text: &str) -> Vec<String> {
        let mut unknown: Vec<String> = Vec::new();
        for word in words_of(text).take(self.max_words) {
            if self.words.binary_search(&word).is_err() && !unknown.contains(&word) {
                unknown.push(word);
            }
        }
        unknown
    }

    /// Whether a text has more than `max_words` words: the others are not read.
    pub fn cuts(&self, text: &str) -> bool {
        words_of(text).nth(self.max_words).is_some()
    }

    fn token(&self, word: &str) -> usize {
        let place = self
            .words
            .binary_search_by(|known| known.as_str().cmp(word));
        1 + place.unwrap_or_else(|_| {
            let bucket = Seed(0).draw_u64(&["unknown word", word]) % self.num_buckets as u64;
            self.words.len() + bucket as usize
        })
    }
}

/// The words of a text in lower case. All characters except letters, digits and apostrophes separate words.
pub fn words_of(text: &str) -> impl Iterator<Item = String> + '_ {
    text.split(|c: char| !(c.is_alphanumeric() || c == '\''))
        .map(|word| word.trim_matches('\'').to_lowercase())
        .filter(|word| !word.is_empty())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn unknown_words_are_named_once_in_their_order() {
        let known = Vocabulary::build(["wave the left arm"], 2, 6).expect("valid");
        assert_eq!(
            known.unknown_words("Levitate, wave; levitate sideways, the Arm flies"),
            ["levitate", "sideways"],
            "the text is read up to its sixth word"
        );
        assert!(known.unknown_words("the arm").is_empty());
        let [six, seven] = [
            "Wave the left arm, the arm",
            "Wave the left arm, the arm, slowly",
        ];
        assert_eq!([six, seven].map(|text| known.cuts(text)), [false, true]);
    }

    fn small() -> Vocabulary {
        Vocabulary::build(["Raise the LEFT arm.", "walk, slowly"], 4, 6).expect("valid")
    }

    #[test]
    fn case_and_punctuation_do_not_matter_and_order_does() {
        let vocabulary = small();
        let check = |text: &str, ids: &[i32]| assert_eq!(vocabulary.encode(text), ids, "{text}");
        // The ids are alphabetical: arm 1, left 2, raise 3, slowly 4, the 5, walk 6.
        check("raise the left arm", &[3, 5, 2, 1]);
        check("  Raise -- THE left, arm!", &[3, 5, 2, 1]);
        check("left the arm raise", &[2, 5, 1, 3]);
        check("walk the arm", &[6, 5, 1]);
        // Unknown words share the buckets after the words.
        let ids = vocabulary.encode("jump jump");
        assert_eq!(ids[0], ids[1]);
        assert!(ids[0] as usize >= 7 && (ids[0] as usize) < vocabulary.num_tokens());
    }

    #[test]
    fn rows_are_padded_to_the_longest() {
        let batch = small().encode_batch(["walk", "raise the arm", ""]);
        assert_eq!(batch.width, 3);
        assert_eq!(batch.ids, [6, 0, 0, 3, 5, 1, 0, 0, 0]);
    }

    proptest! {
        #[test]
        fn every_text_gives_valid_tokens(text in "\\PC{0,80}") {
            let vocabulary = small();
            let ids = vocabulary.encode(&text);
            prop_assert!(!ids.is_empty() && ids.len() <= 6);
            prop_assert!(ids.iter().all(|&id| (id as usize) < vocabulary.num_tokens()));
        }
    }
}
