//! CLIP as encoder of instructions.

use std::path::{Path, PathBuf};

use burn::tensor::Device;
use remote_store::hub::{Hub, HubCache};

use super::FrozenText;
use super::files::{WEIGHTS, file_in, first, read_weights};
use super::tokens::ClipTokenizer;
use crate::Error;
use crate::config::BertVectors;
use crate::model::clip::{ClipConfig, ClipText};
use crate::model::weights::to_safetensors;
use crate::transfer::read;

const TOKENIZERS: [&str; 3] = [
    "tokenizer.json",
    "bpe_simple_vocab_16e6.txt.gz",
    "merges.txt",
];

/// A published CLIP model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClipModel {
    /// ViT-B/32, used by MotionReFit and MDM; its text vectors have width 512.
    VitB32,
    /// ViT-L/14, used by TMED and MLD; its text vectors have width 768.
    VitL14,
}

impl ClipModel {
    /// Hugging Face repo of the model.
    pub fn repo(self) -> &'static str {
        match self {
            Self::VitB32 => "openai/clip-vit-base-patch32",
            Self::VitL14 => "openai/clip-vit-large-patch14",
        }
    }

    /// The sizes of the model's text tower.
    pub fn config(self) -> ClipConfig {
        match self {
            Self::VitB32 => ClipConfig::vit_b_32(),
            Self::VitL14 => ClipConfig::vit_l_14(),
        }
    }
}

/// The files of a CLIP model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ClipFiles {
    /// Weights: safetensors or a file of `torch.save`, possibly with the vision tower.
    pub weights: PathBuf,
    /// Tokenizer file for [`ClipTokenizer::read`].
    pub tokenizer: PathBuf,
}

impl ClipFiles {
    /// Finds the files in a folder by their usual names.
    ///
    /// # Errors
    /// A file is missing.
    pub fn in_folder(folder: &Path) -> Result<Self, Error> {
        Self::find(folder, file_in(folder))
    }

    /// Finds the files in the cache of Hugging Face's tools. Nothing is downloaded.
    ///
    /// # Errors
    /// A file is missing.
    pub fn in_cache(model: ClipModel, cache: &HubCache) -> Result<Self, Error> {
        Self::find(&cache.folder(model.repo()), |name| {
            cache.find(model.repo(), name)
        })
    }

    fn find(folder: &Path, find: impl Fn(&str) -> Option<PathBuf>) -> Result<Self, Error> {
        Ok(Self {
            weights: first("weights", &WEIGHTS, folder, &find)?,
            tokenizer: first("tokenizer", &TOKENIZERS, folder, &find)?,
        })
    }

    /// Downloads missing files into the cache, as [`HubCache::fetch`] does.
    ///
    /// # Errors
    /// A download fails, or the server lacks a file.
    pub fn fetch(
        model: ClipModel,
        cache: &HubCache,
        hub: &Hub,
        progress: &mut dyn FnMut(u64, Option<u64>),
    ) -> Result<Self, Error> {
        let mut first = |what: &str, names: &[&str]| {
            for name in names {
                if let Some(path) = cache.fetch(hub, model.repo(), name, progress)? {
                    return Ok(path);
                }
            }
            let (repo, names) = (model.repo(), names.join(", "));
            Err(Error::Refused(format!(
                "{repo} on the server has no {what}, looked for {names}"
            )))
        };
        Ok(Self {
            weights: first("weights", &WEIGHTS)?,
            // Only `tokenizer.json` is fetched. The lists of merges, which are equivalent, are for folders without it.
            tokenizer: first("tokenizer", &TOKENIZERS[..1])?,
        })
    }
}

/// CLIP's text tower with its tokenizer.
#[derive(Debug)]
pub struct ClipEncoder {
    network: ClipText,
    tokenizer: ClipTokenizer,
    identity: String,
}

impl ClipEncoder {
    /// Loads a model onto a device; [`ClipModel::config`] has the sizes of the published models.
    ///
    /// # Errors
    /// A file cannot be read, differs from its checksum, or has other sizes.
    pub fn load(config: &ClipConfig, files: &ClipFiles, device: &Device) -> Result<Self, Error> {
        let path = &files.weights;
        let bytes = read_weights(path, &["text_model.", "text_projection."])?;
        let network = ClipText::from_safetensors(config, &bytes, "", path, device)?;
        drop(bytes);
        let tokenizer = ClipTokenizer::read(&files.tokenizer)?;
        if tokenizer.num_tokens() != config.num_tokens {
            let (found, expected) = (tokenizer.num_tokens(), config.num_tokens);
            let detail = format!("it has {found} tokens, expected {expected}");
            return Err(Error::tokenizer(&files.tokenizer, detail));
        }
        Self::new(network, tokenizer)
    }

    /// Joins a network with a tokenizer for its vocabulary.
    ///
    /// # Errors
    /// The weights cannot be hashed.
    pub fn new(network: ClipText, tokenizer: ClipTokenizer) -> Result<Self, Error> {
        let mut hasher = blake3::Hasher::new();
        // Hash the serialised network, because equal weights then have equal bytes, whatever their file format.
        hasher.update_rayon(&to_safetensors(&network, Path::new("weights of CLIP"))?);
        tokenizer.hash_into(&mut hasher)?;
        Ok(Self {
            identity: hasher.finalize().to_hex().to_string(),
            network,
            tokenizer,
        })
    }
}

/// Pooled vectors are projected and not normalised; states are the last hidden states.
///
/// # Source
/// `encode_text` of OpenAI's CLIP, in single precision, and `last_hidden_state` of `CLIPTextModel`, without padding,
/// which causal attention does not need.
impl FrozenText for ClipEncoder {
    fn hash(&self) -> &str {
        &self.identity
    }

    fn width(&self, vectors: BertVectors) -> usize {
        match vectors {
            BertVectors::Pooled => self.network.width(),
            BertVectors::States => self.network.token_width(),
        }
    }

    fn encode(&self, texts: &[&str], vectors: BertVectors) -> Result<Vec<Vec<f32>>, Error> {
        if texts.is_empty() {
            return Ok(Vec::new());
        }
        let tokens = self.tokenizer.encode_batch(texts, self.network.context())?;
        let width = self.width(vectors);
        Ok(match vectors {
            BertVectors::Pooled => read(self.network.forward(&tokens))
                .chunks_exact(width)
                .map(<[f32]>::to_vec)
                .collect(),
            BertVectors::States => read(self.network.hidden(&tokens))
                .chunks_exact(tokens.width * width)
                .zip(self.network.lengths(&tokens))
                .map(|(row, length)| row[..length * width].to_vec())
                .collect(),
        })
    }
}
