//! CLIP's tokenizer.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

use flate2::read::GzDecoder;
use serde_json::{Value, json};
use tokenizers::Tokenizer;

use crate::Error;
use crate::vocabulary::TokenBatch;

/// Names of the start and end tokens in files of Hugging Face and open_clip.
const START_NAMES: [&str; 2] = ["<|startoftext|>", "<start_of_text>"];
const END_NAMES: [&str; 2] = ["<|endoftext|>", "<end_of_text>"];
const WORD_END: &str = "</w>";
/// Number of merges in CLIP's vocabulary of 49,408, which also has 512 byte tokens, start and end. OpenAI's list of
/// merges is longer.
const NUM_MERGES: usize = 49_152 - 256 - 2;
/// Regular expression that splits a text into words, which are encoded one by one.
const WORDS: &str = r"'s|'t|'re|'ve|'m|'ll|'d|[\p{L}]+|[\p{N}]|[^\s\p{L}\p{N}]+";
const MAX_MERGES_LEN: u64 = 64 << 20;
const GZIP_MAGIC: &[u8] = &[0x1f, 0x8b];
/// Text on which equal tokenizers must agree, besides having the same vocabulary: upper case, contractions, digits,
/// punctuation, white space, and non-ASCII letters.
pub(super) const PROBE: &str = "Raise  it's 2nd\tArm, café 90°-ÉÅ &amp; \u{1f600}!";

/// The byte-pair encoding of CLIP.
#[derive(Clone, Debug)]
pub struct ClipTokenizer {
    tokenizer: Tokenizer,
    start: i32,
    end: i32,
}

impl ClipTokenizer {
    /// Reads a `tokenizer.json`, or a list of merges: OpenAI's `bpe_simple_vocab_16e6.txt.gz` or a
    /// `merges.txt`.
    ///
    /// # Errors
    /// The file cannot be read, or has another format.
    pub fn read(path: &Path) -> Result<Self, Error> {
        Self::parse(&remote_store::hub::read_checked(path)?, path)
    }

    /// Like [`ClipTokenizer::read`], from a file's content; `path` names the file in errors.
    ///
    /// # Errors
    /// As [`ClipTokenizer::read`].
    pub fn parse(content: &[u8], path: &Path) -> Result<Self, Error> {
        let failed = |detail: String| Error::tokenizer(path, detail);
        let merges = if content.starts_with(GZIP_MAGIC) {
            let mut text = String::new();
            GzDecoder::new(content)
                .take(MAX_MERGES_LEN)
                .read_to_string(&mut text)
                .map_err(|error| failed(format!("it cannot be unpacked ({error})")))?;
            Some(text)
        } else if content.trim_ascii_start().starts_with(b"{") {
            None
        } else {
            let text = String::from_utf8(content.to_vec())
                .map_err(|_| failed("it is neither JSON nor a list of merges".to_owned()))?;
            Some(text)
        };
        let document = merges.map(|text| document_of_merges(&text));
        let document = document.transpose().map_err(failed)?;
        let tokenizer = Tokenizer::from_bytes(document.as_deref().unwrap_or(content));
        let mut tokenizer = tokenizer.map_err(|error| failed(error.to_string()))?;
        // Truncation and padding are done here, in the same way for every file.
        tokenizer
            .with_truncation(None)
            .map_err(|error| failed(error.to_string()))?;
        tokenizer.with_padding(None);
        // Special tokens in a text are encoded as plain text.
        tokenizer.set_encode_special_tokens(true);
        let special = |names: &[&str; 2]| {
            names
                .iter()
                .find_map(|name| tokenizer.token_to_id(name))
                .and_then(|id| i32::try_from(id).ok())
                .ok_or_else(|| failed(format!("it has no token {}", names[0])))
        };
        Ok(Self {
            start: special(&START_NAMES)?,
            end: special(&END_NAMES)?,
            tokenizer,
        })
    }

    /// Number of tokens in the vocabulary, including start and end.
    pub fn num_tokens(&self) -> usize {
        self.tokenizer.get_vocab_size(true)
    }

    /// The start token, the tokens of a text and the end token, truncated to `context` tokens; the end token is always
    /// kept.
    ///
    /// # Errors
    /// The file's tokenizer fails on the text.
    pub fn encode(&self, text: &str, context: usize) -> Result<Vec<i32>, Error> {
        let clean = unescape(&unescape(text));
        let encoding = self.tokenizer.encode_fast(clean.trim(), false);
        let encoding = encoding.map_err(|error| Error::tokens(text, error))?;
        let room = context.saturating_sub(2);
        let words = encoding.get_ids().iter().take(room).map(|&id| id as i32);
        Ok([self.start]
            .into_iter()
            .chain(words)
            .chain([self.end])
            .collect())
    }

    /// The tokens of several texts, truncated to `context` tokens and padded with zeros to the longest text, as
    /// OpenAI's code pads.
    ///
    /// # Shapes
    /// `B` texts give `[B, T]`.
    ///
    /// # Errors
    /// As [`ClipTokenizer::encode`].
    pub fn encode_batch(&self, texts: &[&str], context: usize) -> Result<TokenBatch, Error> {
        let rows: Vec<Vec<i32>> = texts
            .iter()
            .map(|text| self.encode(text, context))
            .collect::<Result<_, _>>()?;
        Ok(TokenBatch::of(&rows))
    }

    /// Hashes everything that determines tokenisation. The same vocabulary has the same hash as JSON and as a list of
    /// merges.
    pub(crate) fn hash_into(&self, hasher: &mut blake3::Hasher) -> Result<(), Error> {
        // Special tokens are hashed by id, because their names differ between files.
        let special = [self.start, self.end].map(i64::from);
        for (id, token) in vocabulary_of(&self.tokenizer) {
            if !special.contains(&i64::from(id)) {
                hasher.update(&id.to_le_bytes());
                hasher.update(token.as_bytes());
                hasher.update(&[0]);
            }
        }
        for id in self.encode(PROBE, usize::MAX)? {
            hasher.update(&id.to_le_bytes());
        }
        Ok(())
    }
}

/// The tokens of a vocabulary by their ids.
pub(super) fn vocabulary_of(tokenizer: &Tokenizer) -> BTreeMap<u32, String> {
    let vocabulary = tokenizer.get_vocab(false).into_iter();
    vocabulary.map(|(token, id)| (id, token)).collect()
}

/// An entry of `added_tokens` in a `tokenizer.json`.
pub(super) fn special_token(name: &str, id: usize) -> Value {
    json!({
        "id": id, "content": name, "special": true, "normalized": false,
        "single_word": false, "lstrip": false, "rstrip": false,
    })
}

/// Converts a list of merges to the bytes of a `tokenizer.json`.
///
/// # Source
/// `simple_tokenizer.py` of OpenAI's CLIP: the vocabulary consists of 256 bytes, the same bytes as ends of words, the
/// merges, start and end; texts are converted to lower case with single spaces. The JSON is that of
/// `openai/clip-vit-base-patch32`.
fn document_of_merges(text: &str) -> Result<Vec<u8>, String> {
    let merges: Vec<(&str, &str)> = text
        .lines()
        // The first line is a version comment.
        .skip(1)
        .filter(|line| !line.is_empty())
        .take(NUM_MERGES)
        .map(|line| {
            line.split_once(' ')
                .ok_or_else(|| format!("{line:?} is no pair of tokens"))
        })
        .collect::<Result<_, _>>()?;
    if merges.is_empty() {
        return Err("it holds no pairs of tokens".to_owned());
    }
    let bytes = byte_letters();
    let tokens = bytes
        .iter()
        .map(char::to_string)
        .chain(bytes.iter().map(|byte| format!("{byte}{WORD_END}")))
        .chain(
            merges
                .iter()
                .map(|(first, second)| format!("{first}{second}")),
        )
        .chain([START_NAMES[0], END_NAMES[0]].map(str::to_owned));
    let vocabulary: BTreeMap<String, usize> = tokens.enumerate().map(|(id, t)| (t, id)).collect();
    let special = [START_NAMES[0], END_NAMES[0]].map(|name| special_token(name, vocabulary[name]));
    let document = json!({
        "version": "1.0",
        "added_tokens": special,
        "normalizer": {"type": "Sequence", "normalizers": [
            {"type": "NFC"},
            {"type": "Replace", "pattern": {"Regex": r"\s+"}, "content": " "},
            {"type": "Lowercase"},
        ]},
        "pre_tokenizer": {"type": "Sequence", "pretokenizers": [
            {"type": "Split", "pattern": {"Regex": WORDS}, "behavior": "Removed", "invert": true},
            {
                "type": "ByteLevel", "add_prefix_space": false, "trim_offsets": true,
                "use_regex": false,
            },
        ]},
        "model": {
            "type": "BPE", "dropout": null, "unk_token": END_NAMES[0],
            "continuing_subword_prefix": "", "end_of_word_suffix": WORD_END, "fuse_unk": false,
            "vocab": vocabulary, "merges": merges,
        },
    });
    serde_json::to_vec(&document).map_err(|error| error.to_string())
}

/// The character of each byte, in vocabulary order: printable Latin-1 characters map to themselves and
/// come first; the other bytes map to characters from 256 on.
///
/// # Source
/// `bytes_to_unicode` of OpenAI's CLIP.
fn byte_letters() -> Vec<char> {
    let visible = |byte: &u8| matches!(byte, b'!'..=b'~' | 0xa1..=0xac | 0xae..=0xff);
    let own = (0..=u8::MAX).filter(visible).map(char::from);
    let num_others = (0..=u8::MAX).filter(|byte| !visible(byte)).count() as u32;
    own.chain((256..256 + num_others).filter_map(char::from_u32))
        .collect()
}

/// Replaces HTML character references: numeric ones, and the few names that occur in captions. All other text stays
/// unchanged.
fn unescape(text: &str) -> String {
    /// Maximum length of a reference, as in `&#x10ffff;`.
    const MAX_LEN: usize = 10;
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(at) = rest.find('&') {
        out.push_str(&rest[..at]);
        rest = &rest[at..];
        let reference = rest
            .find(';')
            .filter(|&end| end < MAX_LEN)
            .and_then(|end| Some((end, letter_of(&rest[1..end])?)));
        match reference {
            Some((end, letter)) => {
                out.push(letter);
                rest = &rest[end + 1..];
            }
            None => {
                out.push('&');
                rest = &rest[1..];
            }
        }
    }
    out.push_str(rest);
    out
}

fn letter_of(name: &str) -> Option<char> {
    Some(match name {
        "amp" => '&',
        "lt" => '<',
        "gt" => '>',
        "quot" => '"',
        "apos" => '\'',
        "nbsp" => '\u{a0}',
        _ => {
            let number = name.strip_prefix('#')?;
            let code = match number.strip_prefix(['x', 'X']) {
                Some(digits) => u32::from_str_radix(digits, 16),
                None => number.parse(),
            };
            char::from_u32(code.ok()?)?
        }
    })
}

#[cfg(test)]
pub(crate) mod tests {
    use std::io::Write;

    use flate2::Compression;
    use flate2::write::GzEncoder;
    use proptest::prelude::*;

    use super::*;

    /// A list with six merges.
    pub(crate) const MERGES: &str = "#version: 0.2\na r\nar m</w>\nl e\nle f\nlef t</w>\nu p</w>\n";

    fn small() -> ClipTokenizer {
        ClipTokenizer::parse(MERGES.as_bytes(), Path::new("merges.txt")).expect("valid")
    }

    #[test]
    fn merges_are_applied_to_words_in_lower_case() {
        let tokenizer = small();
        let encode = |text, context| tokenizer.encode(text, context).expect("encoded");
        // The vocabulary has 512 bytes, then the merges in order, then start and end.
        let (arm, left, up, start, end) = (513, 516, 517, 518, 519);
        assert_eq!(tokenizer.num_tokens(), 520);
        let upper = encode(" LEFT  arm\nup ", 77);
        assert_eq!(upper, [start, left, arm, up, end]);
        // A single letter is its byte as the end of a word: 256 plus the byte's position in the vocabulary.
        let a = 256 + i32::from(b'a' - b'!');
        assert_eq!(encode("a", 77), [start, a, end]);
        assert_eq!(encode("", 77), [start, end]);
        // The end token is kept if the text is truncated.
        assert_eq!(encode("arm arm arm arm", 4), [start, arm, arm, end]);
        // Special tokens cannot be spelt out.
        let ids = encode("<|endoftext|> up", 77);
        assert_eq!(ids.iter().filter(|&&id| id == end).count(), 1);
        let batch = tokenizer.encode_batch(&["up", "left arm"], 77);
        let batch = batch.expect("encoded");
        assert_eq!(batch.width, 4);
        assert_eq!(batch.ids, [start, up, end, 0, start, left, arm, end]);
    }

    #[test]
    fn the_form_of_the_file_does_not_matter() {
        let path = Path::new("vocabulary");
        let mut packed = GzEncoder::new(Vec::new(), Compression::fast());
        packed.write_all(MERGES.as_bytes()).expect("in memory");
        let packed = packed.finish().expect("in memory");
        let json = document_of_merges(MERGES).expect("valid");
        let hash = |tokenizer: &ClipTokenizer| {
            let mut hasher = blake3::Hasher::new();
            tokenizer.hash_into(&mut hasher).expect("hashed");
            hasher.finalize()
        };
        for content in [packed.as_slice(), &json] {
            let tokenizer = ClipTokenizer::parse(content, path).expect("valid");
            assert_eq!(hash(&tokenizer), hash(&small()));
        }
        let other = MERGES.replace("u p</w>", "u n</w>");
        let other = ClipTokenizer::parse(other.as_bytes(), path).expect("valid");
        assert_ne!(hash(&other), hash(&small()));
        let cut = &packed[..20];
        for broken in [cut, b"{\"model\": 1}", b"", b"#version\nab\n", &[0xff; 9]] {
            let error = ClipTokenizer::parse(broken, path).expect_err("broken");
            assert!(error.to_string().contains("is no tokenizer"), "{error}");
        }
    }

    #[test]
    fn references_of_html_become_letters() {
        assert_eq!(unescape("a &amp; b &lt;i&gt;"), "a & b <i>");
        assert_eq!(unescape("&#233;&#xE9;&quot;&apos;"), "éé\"'");
        for same in [
            "a & b",
            "&;",
            "&unknown;",
            "&#xd800;",
            "&",
            "&#99999999;",
            "&é;",
        ] {
            assert_eq!(unescape(same), same);
        }
    }

    proptest! {
        #[test]
        fn every_text_gives_a_row_that_starts_and_ends(text in "\\PC{0,80}") {
            let ids = small().encode(&text, 20).expect("encoded");
            prop_assert!(ids.len() <= 20);
            prop_assert_eq!(ids[0], 518);
            prop_assert_eq!(ids.iter().position(|&id| id == 519), Some(ids.len() - 1));
        }
    }
}
