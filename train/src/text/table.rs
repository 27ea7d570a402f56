//! Tables of text embeddings, computed once and stored.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::Path;

use datasets_spec::store::replace_file;
use safetensors::SafeTensors;
use serde::{Deserialize, Serialize};

use super::FrozenText;
use crate::Error;
use crate::config::BertVectors;
use crate::model::torch::StoredTensor;

const BATCH_LEN: usize = 64;
const FORMAT: u32 = 1;
/// The only key of the file's metadata, because the order of several keys would vary.
const METADATA_KEY: &str = "stance";
const VECTORS: &str = "embeddings";
const TEXTS: &str = "texts";
const LENGTHS: &str = "lengths";

/// Text embeddings: one vector for each text, or one for each token of a text.
///
/// # Shapes
/// `[N, d]`, with texts in alphabetical order; N is the number of texts, or of the tokens of all texts.
#[derive(Clone, Debug, PartialEq)]
pub struct EmbeddingTable {
    encoder: String,
    texts: Vec<String>,
    /// Index after the last row of each text.
    ends: Vec<usize>,
    width: usize,
    values: Vec<f32>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Metadata {
    format: u32,
    encoder: String,
    blake3: String,
}

impl EmbeddingTable {
    /// Encodes texts, without duplicates: their pooled vectors, or the vectors of all tokens. `progress` receives the
    /// number of finished texts and the total.
    ///
    /// # Errors
    /// A text cannot be encoded.
    pub fn compute<'a>(
        encoder: &dyn FrozenText,
        vectors: BertVectors,
        texts: impl IntoIterator<Item = &'a str>,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<Self, Error> {
        let texts: Vec<&str> = BTreeSet::from_iter(texts).into_iter().collect();
        let width = encoder.width(vectors);
        let mut rows = vec![Vec::new(); texts.len()];
        // Batches contain texts of similar length, because the longest row determines the cost of all.
        let mut order: Vec<usize> = (0..texts.len()).collect();
        order.sort_by_key(|&index| texts[index].len());
        let mut done = 0;
        for places in order.chunks(BATCH_LEN) {
            let batch: Vec<&str> = places.iter().map(|&place| texts[place]).collect();
            for (&place, encoded) in places.iter().zip(encoder.encode(&batch, vectors)?) {
                rows[place] = encoded;
            }
            done += places.len();
            progress(done, texts.len());
        }
        let lengths = rows.iter().map(|row| row.len() / width);
        Ok(Self {
            encoder: encoder.identity(vectors),
            texts: texts.into_iter().map(str::to_owned).collect(),
            ends: ends_of(lengths),
            width,
            values: rows.concat(),
        })
    }

    /// Scales every vector so that its elements have this root mean square. The name of the encoder records the
    /// scaling, so that scaled and unscaled tables are distinguished.
    pub(crate) fn scaled_to(mut self, rms: f64) -> Self {
        let length = rms * (self.width as f64).sqrt();
        for row in self.values.chunks_exact_mut(self.width.max(1)) {
            let squares: f64 = row.iter().map(|value| f64::from(*value).powi(2)).sum();
            if squares > 0.0 {
                let factor = length / squares.sqrt();
                for value in row {
                    *value = (f64::from(*value) * factor) as f32;
                }
            }
        }
        self.encoder = format!("rms{rms}-{}", self.encoder);
        self
    }

    /// A table of vectors computed by another program, in the order of `texts`.
    ///
    /// # Shapes
    /// `values` `[N, d]` for `N` texts.
    ///
    /// # Errors
    /// There are no texts, a text is listed twice, the number of values does not match the number of texts, or a number
    /// is not finite.
    pub fn of_vectors(encoder: &str, texts: &[String], values: &[f32]) -> Result<Self, Error> {
        let problem = |problem: String| {
            Error::Refused(format!(
                "no table can be made: {problem}; give one row for each text of `stance model texts`"
            ))
        };
        let (numbers, count) = (values.len(), texts.len());
        let width = numbers / count.max(1);
        if width == 0 || width * count != numbers {
            let detail = format!("{numbers} numbers are no row for each of {count} texts");
            return Err(problem(detail));
        }
        let rows: BTreeMap<&String, &[f32]> = texts.iter().zip(values.chunks(width)).collect();
        if rows.len() != count {
            let detail = format!("only {} of {count} texts are different", rows.len());
            return Err(problem(detail));
        }
        let is_broken = |(_, row): &(&&String, &&[f32])| row.iter().any(|value| !value.is_finite());
        if let Some((text, _)) = rows.iter().find(is_broken) {
            return Err(problem(format!("the vector of {text:?} is not finite")));
        }
        Ok(Self {
            encoder: encoder.to_owned(),
            ends: (1..=texts.len()).collect(),
            width,
            values: rows.values().flat_map(|row| row.iter().copied()).collect(),
            texts: rows.into_keys().cloned().collect(),
        })
    }

    /// The first text whose vectors differ between two tables.
    pub(crate) fn contradiction(&self, other: &Self) -> Option<String> {
        let differs = |text: &&String| {
            let theirs = other.get(text);
            theirs.is_some() && theirs != self.get(text)
        };
        self.texts.iter().find(differs).cloned()
    }

    /// Digest of the texts, and their vectors, that another table lacks; none if it lacks none.
    pub(crate) fn digest_without(&self, other: Option<&Self>) -> Option<String> {
        let is_new = |text: &&String| other.is_none_or(|other| other.get(text).is_none());
        let new: Vec<&String> = self.texts.iter().filter(is_new).collect();
        let digest_of = |new: &[&String]| {
            let mut hasher = blake3::Hasher::new();
            for text in new {
                let vectors = self.get(text).unwrap_or_default();
                for length in [text.len(), vectors.len()] {
                    hasher.update(&(length as u64).to_le_bytes());
                }
                hasher.update(text.as_bytes());
                for value in vectors {
                    hasher.update(&value.to_le_bytes());
                }
            }
            hasher.finalize().to_hex().to_string()
        };
        (!new.is_empty()).then(|| digest_of(&new))
    }

    /// Identity of the encoder that made the table.
    pub fn encoder(&self) -> &str {
        &self.encoder
    }

    /// The texts in alphabetical order.
    pub fn texts(&self) -> &[String] {
        &self.texts
    }

    /// Width of a vector.
    pub fn width(&self) -> usize {
        self.width
    }

    /// The vector of a text, or the vectors of its tokens. The text must match exactly.
    ///
    /// # Shapes
    /// `[d]`, or `[T, d]` for `T` tokens.
    pub fn get(&self, text: &str) -> Option<&[f32]> {
        let row = self
            .texts
            .binary_search_by(|known| known.as_str().cmp(text))
            .ok()?;
        let first = row.checked_sub(1).map_or(0, |before| self.ends[before]);
        Some(&self.values[first * self.width..self.ends[row] * self.width])
    }

    /// Checks that the table contains every text, as a run does before it starts.
    ///
    /// # Errors
    /// Texts are missing; the error names the first ones.
    pub fn check_texts<'a>(&self, texts: impl IntoIterator<Item = &'a str>) -> Result<(), Error> {
        let missing: BTreeSet<&str> = texts
            .into_iter()
            .filter(|text| self.get(text).is_none())
            .collect();
        if missing.is_empty() {
            return Ok(());
        }
        let missing: Vec<&str> = missing.into_iter().collect();
        Err(Error::not_embedded(&missing))
    }

    /// BLAKE3 of the texts and vectors, as the file records it.
    pub fn hash(&self) -> String {
        self.content_hash(&self.texts_document())
    }

    fn content_hash(&self, texts: &[u8]) -> String {
        let mut hasher = blake3::Hasher::new();
        hasher.update(&(texts.len() as u64).to_le_bytes());
        hasher.update(texts);
        hasher.update(&(self.width as u64).to_le_bytes());
        if let Some(lengths) = self.lengths_document() {
            hasher.update(&lengths);
        }
        for value in &self.values {
            hasher.update(&value.to_le_bytes());
        }
        hasher.finalize().to_hex().to_string()
    }

    fn texts_document(&self) -> Vec<u8> {
        serde_json::to_vec(&self.texts).expect("a list of texts serialises")
    }

    /// Number of tokens in each text as a JSON list; none if every text has one vector.
    fn lengths_document(&self) -> Option<Vec<u8>> {
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        let lengths: Vec<usize> = self.ends.iter().zip(starts).map(|(e, s)| e - s).collect();
        lengths
            .iter()
            .any(|&length| length != 1)
            .then(|| serde_json::to_vec(&lengths).expect("a list of numbers serialises"))
    }

    /// Writes the table as one safetensors file: the vectors as `embeddings`, the bytes of a JSON list of the texts as
    /// `texts`, and for token vectors the numbers of tokens as `lengths`. Equal tables give equal bytes.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), Error> {
        let texts = self.texts_document();
        let metadata = Metadata {
            format: FORMAT,
            encoder: self.encoder.clone(),
            blake3: self.content_hash(&texts),
        };
        let metadata = serde_json::to_string(&metadata).expect("plain text and numbers serialise");
        let metadata = HashMap::from([(METADATA_KEY.to_owned(), metadata)]);
        let rows = self.ends.last().copied().unwrap_or(0);
        let mut tensors = BTreeMap::from([
            (
                VECTORS,
                StoredTensor::f32(vec![rows, self.width], &self.values),
            ),
            (TEXTS, StoredTensor::bytes(texts)),
        ]);
        if let Some(lengths) = self.lengths_document() {
            tensors.insert(LENGTHS, StoredTensor::bytes(lengths));
        }
        let bytes = safetensors::serialize(&tensors, Some(metadata))
            .map_err(|error| malformed(path, error))?;
        replace_file(path, &bytes).map_err(Error::io("write", path))
    }

    /// Reads a table and checks its content against the recorded hash.
    ///
    /// # Errors
    /// The file cannot be read, is of another kind or version, or is damaged.
    pub fn load(path: &Path) -> Result<Self, Error> {
        let bytes = std::fs::read(path).map_err(Error::io("read", path))?;
        let (_, header) =
            SafeTensors::read_metadata(&bytes).map_err(|error| malformed(path, error))?;
        let metadata = header
            .metadata()
            .as_ref()
            .and_then(|metadata| metadata.get(METADATA_KEY))
            .ok_or_else(|| malformed(path, "it does not say what it is"))?;
        let metadata: Metadata =
            serde_json::from_str(metadata).map_err(|error| malformed(path, error))?;
        if metadata.format != FORMAT {
            let problem = format!("it has version {}, expected {FORMAT}", metadata.format);
            return Err(malformed(path, problem));
        }
        let file = SafeTensors::deserialize(&bytes).map_err(|error| malformed(path, error))?;
        let tensor = |name| file.tensor(name).map_err(|error| malformed(path, error));
        let (vectors, texts) = (tensor(VECTORS)?, tensor(TEXTS)?);
        let (numbers, _) = vectors.data().as_chunks::<4>();
        let texts: Vec<String> =
            serde_json::from_slice(texts.data()).map_err(|error| malformed(path, error))?;
        let lengths: Vec<usize> = match file.tensor(LENGTHS) {
            Ok(lengths) => {
                serde_json::from_slice(lengths.data()).map_err(|error| malformed(path, error))?
            }
            Err(_) => vec![1; texts.len()],
        };
        let table = Self {
            encoder: metadata.encoder,
            ends: ends_of(lengths),
            texts,
            width: vectors.shape().last().copied().unwrap_or_default(),
            values: numbers
                .iter()
                .map(|item| f32::from_le_bytes(*item))
                .collect(),
        };
        let found = table.hash();
        if found != metadata.blake3 {
            let problem = format!("BLAKE3 {found}, recorded {}", metadata.blake3);
            return Err(malformed(path, problem));
        }
        // The hash only shows that the file is as it was written; lookups rely on these properties.
        let sorted = table.texts.is_sorted_by(|a, b| a < b);
        let rows = table.ends.last().copied().unwrap_or(0);
        let belong = table.ends.len() == table.texts.len();
        if !sorted || !belong || vectors.shape() != [rows, table.width] {
            return Err(malformed(path, "its rows and texts do not belong together"));
        }
        Ok(table)
    }
}

fn ends_of(lengths: impl IntoIterator<Item = usize>) -> Vec<usize> {
    let lengths = lengths.into_iter();
    lengths
        .scan(0, |end, length| {
            *end += length;
            Some(*end)
        })
        .collect()
}

fn malformed(path: &Path, detail: impl std::fmt::Display) -> Error {
    Error::Refused(format!(
        "{} is no table of text embeddings ({detail}); make it again",
        path.display()
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_of_a_user_go_to_their_texts() {
        let texts = ["wave", "bow"].map(str::to_owned);
        let table =
            EmbeddingTable::of_vectors("mine", &texts, &[1.0, 2.0, 3.0, 4.0]).expect("rows");
        assert_eq!(table.texts(), ["bow", "wave"]);
        assert_eq!((table.encoder(), table.width()), ("mine", 2));
        assert_eq!(table.get("wave"), Some(&[1.0, 2.0][..]));
        assert_eq!(table.get("bow"), Some(&[3.0, 4.0][..]));
    }

    #[test]
    fn what_is_no_row_for_each_text_is_refused() {
        let refused = |texts: &[&str], values: &[f32], what: &str| {
            let texts: Vec<String> = texts.iter().map(|&text| text.to_owned()).collect();
            let error = EmbeddingTable::of_vectors("mine", &texts, values).expect_err("no table");
            assert!(error.to_string().contains(what), "{error}");
        };
        refused(&[], &[], "0 numbers are no row for each of 0 texts");
        refused(&["wave"], &[], "0 numbers are no row for each of 1 texts");
        let two = ["wave", "bow"];
        refused(&two, &[1.0; 3], "3 numbers are no row for each of 2 texts");
        let twice = ["wave"; 2];
        refused(&twice, &[1.0; 4], "only 1 of 2 texts are different");
        let broken = "the vector of \"bow\" is not finite";
        refused(&two, &[1.0, f32::NAN], broken);
    }

    #[test]
    fn tables_contradict_each_other_about_a_text_that_both_hold() {
        let table = |texts: [&str; 2], values: &[f32]| {
            EmbeddingTable::of_vectors("mine", &texts.map(str::to_owned), values).expect("rows")
        };
        let own = table(["wave", "bow"], &[1.0, 2.0]);
        assert_eq!(own.contradiction(&table(["bow", "run"], &[2.0, 5.0])), None);
        let other = table(["bow", "run"], &[3.0, 5.0]);
        assert_eq!(own.contradiction(&other).as_deref(), Some("bow"));
    }
}
