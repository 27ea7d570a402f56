//! Where a frozen text encoder is found, and the vectors of instructions.

use std::path::{Path, PathBuf};

use burn::tensor::Device;

use super::clip::{ClipEncoder, ClipFiles, ClipModel};
use super::hub::HubCache;
use super::table::EmbeddingTable;
use crate::config::TextEncoder;
use crate::{Error, Session};

/// Table of the instructions a run was trained with, in its folder.
pub(crate) const EMBEDDINGS: &str = "embeddings.safetensors";

/// A text encoder that is not trained.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrozenEncoder {
    /// CLIP, which this program runs.
    Clip(ClipModel),
    /// Another one, whose vectors are in a table.
    Table,
}

impl TextEncoder {
    /// The frozen encoder that is asked for, if one is; `clip` is the CLIP that the model uses.
    pub(crate) fn frozen(self, clip: ClipModel) -> Option<FrozenEncoder> {
        match self {
            Self::Learned => None,
            Self::Clip => Some(FrozenEncoder::Clip(clip)),
            Self::Table => Some(FrozenEncoder::Table),
        }
    }
}

/// Where a frozen text encoder is found.
#[derive(Clone, Debug, Default)]
pub struct TextEncoderSource {
    /// Given by the user: the folder of CLIP, or a table of vectors.
    pub given: Option<PathBuf>,
    /// Cache of the Hugging Face hub, searched otherwise.
    pub cache: Option<HubCache>,
}

/// Encodes texts, and tells how many of how many are done.
type Compute<'a> =
    fn(&ClipEncoder, Vec<&'a str>, &mut dyn FnMut(usize, usize)) -> Result<EmbeddingTable, Error>;

impl TextEncoderSource {
    /// Loads a CLIP.
    ///
    /// # Errors
    /// No place is known, a file is missing, damaged or of another CLIP.
    pub fn load(&self, model: ClipModel, device: &Device) -> Result<ClipEncoder, Error> {
        let files = match (&self.given, &self.cache) {
            (Some(folder), _) => ClipFiles::in_folder(folder)?,
            (None, Some(cache)) => {
                ClipFiles::in_cache(model, cache).map_err(|source| Error::NoTextEncoder {
                    source: Box::new(source),
                })?
            }
            (None, None) => return Err(Error::NoHubCache),
        };
        ClipEncoder::load(&model.config(), &files, device)
    }

    /// Vectors of texts. Those of CLIP are in the run folder, or computed; those of another encoder are in the table that the
    /// user names, or in the run folder.
    ///
    /// # Errors
    /// As [`Self::load`], a text cannot be encoded, or the table lacks one or contradicts that of the run folder.
    pub(crate) fn embeddings(
        &self,
        run: &Path,
        texts: &[String],
        encoder: FrozenEncoder,
        session: &Session<'_>,
    ) -> Result<EmbeddingTable, Error> {
        match encoder {
            FrozenEncoder::Clip(model) => {
                self.computed(run, texts, model, EmbeddingTable::compute, session)
            }
            FrozenEncoder::Table => self.given_table(run, texts),
        }
    }

    fn given_table(&self, run: &Path, texts: &[String]) -> Result<EmbeddingTable, Error> {
        let path = run.join(EMBEDDINGS);
        let own = path
            .exists()
            .then(|| EmbeddingTable::load(&path))
            .transpose()?;
        // A folder is that of CLIP, for other models of the same command.
        let given = self.given.as_ref().filter(|given| !given.is_dir());
        let table = given.map(|path| EmbeddingTable::load(path)).transpose()?;
        let texts = texts.iter().map(String::as_str);
        let (Some(given), Some(table)) = (given, table) else {
            let own = own.ok_or(Error::NoTextTable)?;
            own.check_texts(texts)?;
            return Ok(own);
        };
        if let Some(text) = own.and_then(|own| own.contradiction(&table)) {
            return Err(Error::OtherVectors {
                path: given.clone(),
                text,
            });
        }
        table.check_texts(texts)?;
        Ok(table)
    }

    /// The last hidden states of the tokens of texts in CLIP ViT-L/14: those of the run folder if it holds
    /// all of them, else computed.
    ///
    /// # Errors
    /// As [`Self::load`], or a text cannot be encoded.
    pub(crate) fn token_embeddings(
        &self,
        run: &Path,
        texts: &[String],
        session: &Session<'_>,
    ) -> Result<EmbeddingTable, Error> {
        let compute = EmbeddingTable::compute_tokens;
        self.computed(run, texts, ClipModel::VitL14, compute, session)
    }

    fn computed<'a>(
        &self,
        run: &Path,
        texts: &'a [String],
        model: ClipModel,
        compute: Compute<'a>,
        session: &Session<'_>,
    ) -> Result<EmbeddingTable, Error> {
        let path = run.join(EMBEDDINGS);
        if path.exists() {
            let table = EmbeddingTable::load(&path)?;
            if table.check_texts(texts.iter().map(String::as_str)).is_ok() {
                return Ok(table);
            }
        }
        let encoder = self.load(model, session.device)?;
        let progress = session.progress;
        progress.begin("texts", Some(texts.len() as u64));
        let mut reported = 0;
        let texts: Vec<&str> = texts.iter().map(String::as_str).collect();
        let table = compute(&encoder, texts, &mut |done, _| {
            progress.advance((done - reported) as u64);
            reported = done;
        })?;
        progress.finish(&format!("{} texts encoded by CLIP", table.texts().len()));
        Ok(table)
    }
}
