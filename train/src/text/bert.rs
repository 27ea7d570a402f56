//! BERT and related models as encoders of instructions, from a folder in the format of Hugging Face or
//! sentence-transformers.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use burn::tensor::Device;
use remote_store::hub::read_checked;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use tokenizers::{Tokenizer, TruncationParams};

use super::FrozenText;
use super::bert_net::{BertConfig, BertText};
use super::files::{WEIGHTS, file_in, first, read_weights};
use super::tokens::{PROBE, special_token, vocabulary_of};
use crate::Error;
use crate::config::BertVectors;
use crate::error::json_error;
use crate::model::weights::to_safetensors;
use crate::transfer::read;
use crate::vocabulary::TokenBatch;

const CONFIG: [&str; 1] = ["config.json"];
const TOKENIZERS: [&str; 2] = ["tokenizer.json", "vocab.txt"];
/// Files with settings of the tokenizer, of the maximum length, and of the modules after the network. All are optional.
const TOKENIZER_CONFIG: &str = "tokenizer_config.json";
const SENTENCE_CONFIG: &str = "sentence_bert_config.json";
const MODULES: &str = "modules.json";
/// Names of the model's description and licence, which are copied too.
const PAPERS: [&str; 3] = ["README.md", "LICENSE", "LICENSE.txt"];
/// Smallest limit on a text's tokens: start, one token, end.
const LEAST_TOKENS: usize = 3;
/// PyTorch's lower bound for a norm that is used as a divisor.
const MIN_LENGTH: f64 = 1e-12;

/// The files of a BERT model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BertFiles {
    folder: PathBuf,
    config: PathBuf,
    weights: PathBuf,
    tokenizer: PathBuf,
}

impl BertFiles {
    /// Finds the files in a folder: `config.json`, `model.safetensors` or `pytorch_model.bin`, and `tokenizer.json` or
    /// `vocab.txt`.
    ///
    /// # Errors
    /// A file is missing.
    pub fn in_folder(folder: &Path) -> Result<Self, Error> {
        let find = file_in(folder);
        Ok(Self {
            folder: folder.to_owned(),
            config: first("config", &CONFIG, folder, &find)?,
            weights: first("weights", &WEIGHTS, folder, &find)?,
            tokenizer: first("tokenizer", &TOKENIZERS, folder, &find)?,
        })
    }

    /// Names of all files of the encoder, relative to its folder, with `/` as separator. `has` tells whether a file
    /// exists, and `read` reads one.
    pub(super) fn names(
        has: impl Fn(&str) -> bool,
        read: impl FnOnce(&str) -> Result<Vec<u8>, Error>,
    ) -> Result<Vec<String>, Error> {
        let one_of = |names: &[&'static str]| names.iter().copied().find(|name| has(name));
        let mut names: Vec<String> = [&CONFIG[..], &WEIGHTS, &TOKENIZERS]
            .into_iter()
            .filter_map(one_of)
            .chain([TOKENIZER_CONFIG, SENTENCE_CONFIG, MODULES])
            .chain(PAPERS)
            .map(str::to_owned)
            .collect();
        if has(MODULES) {
            let modules: Vec<SentenceModule> = parse(&read(MODULES)?, Path::new(MODULES))?;
            let folders = modules.iter().filter(|module| module.has_plain_folder());
            names.extend(folders.map(|module| format!("{}/{}", module.path, CONFIG[0])));
        }
        names.retain(|name| has(name));
        Ok(names)
    }

    /// BLAKE3 of the encoder's files without its description and licence, in hexadecimal.
    ///
    /// # Errors
    /// A file cannot be read.
    pub fn hash(&self) -> Result<String, Error> {
        let path = |name: &str| self.folder.join(name);
        let names = Self::names(
            |name| path(name).is_file() && !PAPERS.contains(&name),
            |name| Ok(read_checked(&path(name))?),
        )?;
        let mut hasher = blake3::Hasher::new();
        for name in names {
            hasher.update(blake3::hash(&read_checked(&path(&name))?).as_bytes());
            hasher.update(name.as_bytes());
        }
        Ok(hasher.finalize().to_hex().to_string())
    }

    fn optional<T: DeserializeOwned>(&self, name: &str) -> Result<Option<T>, Error> {
        let path = self.folder.join(name);
        if !path.is_file() {
            return Ok(None);
        }
        parse(&read_checked(&path)?, &path).map(Some)
    }
}

fn parse<T: DeserializeOwned>(document: &[u8], path: &Path) -> Result<T, Error> {
    serde_json::from_slice(document).map_err(json_error(path))
}

#[derive(Deserialize)]
struct SentenceModule {
    path: String,
    #[serde(rename = "type")]
    kind: String,
}

impl SentenceModule {
    /// Whether the module's folder lies directly within the model's folder.
    fn has_plain_folder(&self) -> bool {
        let path = self.path.as_str();
        !(path.is_empty() || path.starts_with('.') || path.contains(['/', '\\', ':']))
    }
}

#[derive(Default, Deserialize)]
struct TokenizerConfig {
    /// True by default.
    do_lower_case: Option<bool>,
    strip_accents: Option<bool>,
    /// True by default.
    tokenize_chinese_chars: Option<bool>,
    /// Some tokenizers record 10^30 for no limit.
    model_max_length: Option<f64>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct SentenceConfig {
    max_seq_length: Option<usize>,
    do_lower_case: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Pooling {
    All,
    First,
}

#[derive(Debug)]
struct Rules {
    /// Maximum number of tokens in a row, including start and end; longer texts are truncated.
    max_tokens: usize,
    /// Whether texts are converted to lower case before tokenisation; the tokenizer may convert them too.
    lowers: bool,
    pooling: Pooling,
    normalizes: bool,
}

impl Rules {
    /// # Source
    /// The modules `Transformer`, `Pooling` and `Normalize` of sentence-transformers. Without `modules.json` the vector
    /// of a text is the mean over its tokens, as in the library.
    fn read(files: &BertFiles, config: &BertConfig, limit: Option<f64>) -> Result<Self, Error> {
        let sentence: SentenceConfig = files.optional(SENTENCE_CONFIG)?.unwrap_or_default();
        let limit = limit.filter(|limit| *limit < config.context as f64);
        let limit = limit.map_or(config.context, |limit| limit as usize);
        let mut rules = Self {
            max_tokens: sentence.max_seq_length.unwrap_or(limit).min(config.context),
            lowers: sentence.do_lower_case,
            pooling: Pooling::All,
            normalizes: false,
        };
        if rules.max_tokens < LEAST_TOKENS {
            let detail = format!("texts of {} tokens hold no word", rules.max_tokens);
            return Err(Error::text_model(
                &files.folder.join(SENTENCE_CONFIG),
                detail,
            ));
        }
        let modules: Vec<SentenceModule> = files.optional(MODULES)?.unwrap_or_default();
        for module in modules {
            match module.kind.rsplit('.').next().unwrap_or_default() {
                "Transformer" => {}
                "Pooling" if module.has_plain_folder() => {
                    let name = format!("{}/{}", module.path, CONFIG[0]);
                    let modes: Option<BTreeMap<String, Value>> = files.optional(&name)?;
                    rules.pooling = pooling(&modes.unwrap_or_default(), &files.folder.join(name))?;
                }
                "Normalize" => rules.normalizes = true,
                _ => {
                    let detail = format!("module {} is not known", module.kind);
                    return Err(Error::text_model(&files.folder.join(MODULES), detail));
                }
            }
        }
        Ok(rules)
    }

    /// Pools the token states of a text to one vector.
    ///
    /// # Shapes
    /// `states` `[T, d]`, the result `[d]`.
    fn pool(&self, states: &[f32], width: usize) -> Vec<f32> {
        let states = match self.pooling {
            Pooling::All => states,
            Pooling::First => &states[..width],
        };
        let count = (states.len() / width) as f64;
        let mut mean = vec![0.0f64; width];
        for state in states.chunks_exact(width) {
            for (sum, value) in mean.iter_mut().zip(state) {
                *sum += f64::from(*value) / count;
            }
        }
        let length = if self.normalizes {
            let squares: f64 = mean.iter().map(|value| value * value).sum();
            squares.sqrt().max(MIN_LENGTH)
        } else {
            1.0
        };
        mean.iter().map(|value| (value / length) as f32).collect()
    }
}

/// The pooling that a pooling module's configuration selects.
fn pooling(modes: &BTreeMap<String, Value>, path: &Path) -> Result<Pooling, Error> {
    let asked: Vec<&str> = modes
        .iter()
        .filter(|(_, value)| **value == Value::Bool(true))
        .filter_map(|(name, _)| name.strip_prefix("pooling_mode_"))
        .collect();
    match asked[..] {
        ["mean_tokens"] => Ok(Pooling::All),
        ["cls_token"] => Ok(Pooling::First),
        _ => {
            let detail = format!("it pools by {asked:?}; mean_tokens and cls_token are known");
            Err(Error::text_model(path, detail))
        }
    }
}

/// BERT or DistilBERT with its tokenizer.
#[derive(Debug)]
pub struct BertEncoder {
    network: BertText,
    config: BertConfig,
    tokenizer: Tokenizer,
    rules: Rules,
    identity: String,
}

impl BertEncoder {
    /// Loads an encoder onto a device. Sizes, tokenizer and pooling are read from its files.
    ///
    /// # Errors
    /// A file cannot be read or differs from its checksum, the network is of an unsupported kind, a tensor is missing
    /// or of another shape, or the tokenizer's vocabulary is larger than the network's.
    pub fn load(files: &BertFiles, device: &Device) -> Result<Self, Error> {
        let config = BertConfig::parse(&read_checked(&files.config)?, &files.config)?;
        let bytes = read_weights(&files.weights, &[])?;
        let network = BertText::from_safetensors(&config, &bytes, &files.weights, device)?;
        drop(bytes);
        let settings: TokenizerConfig = files.optional(TOKENIZER_CONFIG)?.unwrap_or_default();
        let rules = Rules::read(files, &config, settings.model_max_length)?;
        let tokenizer = read_tokenizer(&files.tokenizer, &settings, rules.max_tokens)?;
        let last = tokenizer.get_vocab(true).into_values().max();
        if last.is_some_and(|last| last as usize >= config.num_tokens) {
            let (last, known) = (last.unwrap_or_default(), config.num_tokens);
            let detail = format!("it has tokens up to number {last}, the network knows {known}");
            return Err(Error::tokenizer(&files.tokenizer, detail));
        }
        let mut encoder = Self {
            network,
            config,
            tokenizer,
            rules,
            identity: String::new(),
        };
        encoder.identity = encoder.hashed()?;
        Ok(encoder)
    }

    /// Hash of everything that determines the vectors, independent of file formats.
    fn hashed(&self) -> Result<String, Error> {
        let mut hasher = blake3::Hasher::new();
        hasher.update_rayon(&to_safetensors(
            &self.network,
            Path::new("weights of BERT"),
        )?);
        for (id, token) in vocabulary_of(&self.tokenizer) {
            hasher.update(&id.to_le_bytes());
            hasher.update(token.as_bytes());
            hasher.update(&[0]);
        }
        for id in self.tokens(PROBE)? {
            hasher.update(&id.to_le_bytes());
        }
        let rules = json!([
            self.config.num_heads,
            format!("{:?}", self.config.activation),
            self.config.norm_epsilon,
            self.rules.max_tokens,
            self.rules.lowers,
            format!("{:?}", self.rules.pooling),
            self.rules.normalizes,
        ]);
        hasher.update(rules.to_string().as_bytes());
        Ok(hasher.finalize().to_hex().to_string())
    }

    fn tokens(&self, text: &str) -> Result<Vec<i32>, Error> {
        let lowered = self.rules.lowers.then(|| text.to_lowercase());
        let encoding = self
            .tokenizer
            .encode_fast(lowered.as_deref().unwrap_or(text).trim(), true)
            .map_err(|error| Error::tokens(text, error))?;
        let tokens: Vec<i32> = encoding.get_ids().iter().map(|&id| id as i32).collect();
        if tokens.is_empty() {
            return Err(Error::tokens(
                text,
                "the tokenizer adds no start and no end to it",
            ));
        }
        Ok(tokens)
    }
}

/// Longer texts are truncated, as in sentence-transformers: to `max_seq_length` of `sentence_bert_config.json` or
/// `model_max_length` of `tokenizer_config.json`, at most the number of the network's positions.
///
/// # Source
/// Pooled vectors are those of `SentenceTransformer.encode`, states are `last_hidden_state` of the network.
impl FrozenText for BertEncoder {
    fn hash(&self) -> &str {
        &self.identity
    }

    fn width(&self, _vectors: BertVectors) -> usize {
        self.config.width
    }

    fn encode(&self, texts: &[&str], vectors: BertVectors) -> Result<Vec<Vec<f32>>, Error> {
        if texts.is_empty() {
            return Ok(Vec::new());
        }
        let rows: Vec<Vec<i32>> = texts
            .iter()
            .map(|text| self.tokens(text))
            .collect::<Result<_, _>>()?;
        let lengths: Vec<usize> = rows.iter().map(Vec::len).collect();
        let tokens = TokenBatch::of(&rows);
        let width = self.config.width;
        let values = read(self.network.hidden(&self.config, &tokens, &lengths));
        let rows = values.chunks_exact(tokens.width * width).zip(&lengths);
        Ok(rows
            .map(|(row, &length)| {
                let states = &row[..length * width];
                match vectors {
                    BertVectors::Pooled => self.rules.pool(states, width),
                    BertVectors::States => states.to_vec(),
                }
            })
            .collect())
    }
}

/// Reads a `tokenizer.json` or a `vocab.txt`; texts are truncated to `max_tokens` tokens.
fn read_tokenizer(
    path: &Path,
    settings: &TokenizerConfig,
    max_tokens: usize,
) -> Result<Tokenizer, Error> {
    let mut content = read_checked(path)?;
    if path.extension().is_some_and(|ending| ending == "txt") {
        let text = String::from_utf8(content).map_err(|error| Error::tokenizer(path, error))?;
        let document = document_of_vocabulary(&text, settings);
        content = document.map_err(|detail| Error::tokenizer(path, detail))?;
    }
    let tokenizer = Tokenizer::from_bytes(content.as_slice());
    let mut tokenizer = tokenizer.map_err(|error| Error::tokenizer(path, error))?;
    // The file's padding and truncation are for training; here rows are padded to the longest text.
    let truncation = TruncationParams {
        max_length: max_tokens,
        ..TruncationParams::default()
    };
    tokenizer
        .with_truncation(Some(truncation))
        .map_err(|error| Error::tokenizer(path, error))?;
    tokenizer.with_padding(None);
    Ok(tokenizer)
}

/// Converts a list of word pieces to the bytes of a `tokenizer.json`.
///
/// # Source
/// `BertTokenizer` of Hugging Face: a token's number is its line.
fn document_of_vocabulary(text: &str, settings: &TokenizerConfig) -> Result<Vec<u8>, String> {
    let vocabulary: BTreeMap<&str, usize> = text
        .lines()
        .enumerate()
        .map(|(id, token)| (token, id))
        .collect();
    let id = |token: &str| {
        let id = vocabulary.get(token).copied();
        id.ok_or_else(|| format!("it has no token {token}"))
    };
    let (unknown, start, end) = (id("[UNK]")?, id("[CLS]")?, id("[SEP]")?);
    let special = [("[UNK]", unknown), ("[CLS]", start), ("[SEP]", end)];
    let document = json!({
        "version": "1.0",
        "added_tokens": special.map(|(name, id)| special_token(name, id)),
        "normalizer": {
            "type": "BertNormalizer", "clean_text": true,
            "handle_chinese_chars": settings.tokenize_chinese_chars.unwrap_or(true),
            "strip_accents": settings.strip_accents,
            "lowercase": settings.do_lower_case.unwrap_or(true),
        },
        "pre_tokenizer": {"type": "BertPreTokenizer"},
        "post_processor": {
            "type": "BertProcessing", "sep": ["[SEP]", end], "cls": ["[CLS]", start],
        },
        "model": {
            "type": "WordPiece", "unk_token": "[UNK]", "continuing_subword_prefix": "##",
            "max_input_chars_per_word": 100, "vocab": vocabulary,
        },
    });
    serde_json::to_vec(&document).map_err(|error| error.to_string())
}
