//! Errors of training and editing.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use datasets_spec::Code;

/// An error that names the item concerned.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The request cannot be carried out; the message states why.
    #[error("{0}")]
    Refused(String),
    /// A setting is outside the range the model is defined for.
    #[error("setting {field} is not usable: {problem}")]
    Config {
        /// Name of the setting.
        field: &'static str,
        /// What is wrong with it.
        problem: String,
    },
    /// A file of the hub cannot be fetched, or is damaged.
    #[error(transparent)]
    Hub(#[from] remote_store::hub::Error),
    /// Training items cannot be composed from the motions.
    #[error(transparent)]
    Compose(#[from] compose::Error),
    /// A dataset cannot be opened, read or written.
    #[error(transparent)]
    Spec(#[from] datasets_spec::Error),
    /// A job in pieces cannot continue, or its output folder cannot be used.
    #[error(transparent)]
    Work(#[from] work::Error),
    /// A condition on clips cannot be parsed, or no clip meets it.
    #[error(transparent)]
    Tables(#[from] tables::Error),
    /// The validation split cannot be composed.
    #[error("the validation split cannot be composed; ingest more clips")]
    Validation {
        /// The cause.
        source: compose::Error,
    },
    /// The user's settings do not match those of the model.
    #[error("the settings cannot be used")]
    Settings {
        /// The setting.
        source: crate::config::SettingError,
    },
    /// The text encoder of a model is not in the cache.
    #[error(
        "the model uses CLIP; fetch it with `stance model fetch`, or give its folder with \
         --text-encoder"
    )]
    NoTextEncoder {
        /// The cause.
        source: Box<Error>,
    },
    /// No folder for downloads is known.
    #[error("neither HF_HOME nor HOME is set; set one to say where downloads are kept")]
    NoHubCache,
    /// A run folder holds a run with other settings.
    #[error("{} holds a run whose {field} differs; {remedy}", path.display())]
    OtherRun {
        /// The run folder.
        path: PathBuf,
        /// First field of the recorded configuration that differs.
        field: String,
        /// What to do next.
        remedy: &'static str,
    },
    /// Weights do not fit the network.
    #[error("weights {} do not fit the network: {detail}", path.display())]
    Weights {
        /// The file.
        path: PathBuf,
        /// Error of the loader.
        detail: String,
    },
    /// The work was stopped from outside before it was done.
    #[error("{what} was stopped before it was done")]
    Stopped {
        /// Name of the stopped work.
        what: &'static str,
    },
    /// A loss became NaN or infinite.
    #[error(
        "the {what} loss is not finite after {step} steps; {}",
        match kept {
            0 => "nothing was kept: train into another folder with a lower optimizer.learning_rate \
                  or a shorter optimizer.max_gradient_norm, and look for numbers in the data that \
                  are not finite".to_owned(),
            kept => format!(
                "the checkpoint of step {kept} is kept: continue it with --extend and a lower \
                 learning rate, or with optimizer.max_gradient_norm"
            ),
        }
    )]
    Diverged {
        /// Name of the loss.
        what: &'static str,
        /// Number of steps made before this loss, as log lines and checkpoints count them.
        step: u64,
        /// Step of the newest checkpoint; 0 if there is none.
        kept: u64,
    },
    /// A motion violates a rule of the data format.
    #[error("motion {id:?} cannot be used")]
    Motion {
        /// Id of the motion.
        id: String,
        /// The cause.
        source: datasets_spec::Error,
    },
    /// A JSON document of a run folder is malformed.
    #[error("cannot read {} as JSON", path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: serde_json::Error,
    },
}

impl Error {
    /// The code of the error, if it has one, and the item concerned.
    pub fn code(&self) -> Option<Code> {
        match self {
            Self::Spec(error) => error.code(),
            Self::Work(error) => error.code(),
            Self::Compose(error) => error.code(),
            Self::Hub(error) => error.code(),
            _ => None,
        }
    }

    /// Returns a function that adds to an I/O error what was tried on which file.
    pub(crate) fn io(
        action: &'static str,
        path: impl Into<PathBuf>,
    ) -> impl FnOnce(std::io::Error) -> Self {
        let wrap = datasets_spec::Error::io(action, path);
        move |error| wrap(error).into()
    }

    /// A folder is not a run of the expected kind.
    pub(crate) fn not_a_run(path: &Path, kind: &str, reason: impl Display) -> Self {
        Self::Refused(format!("{} is not a {kind} run: {reason}", path.display()))
    }

    /// A checkpoint's file or folder differs from what its manifest records.
    pub(crate) fn corrupt(path: &Path, detail: impl Display) -> Self {
        Self::Refused(format!(
            "checkpoint {} is corrupt ({detail}); restore it or train again",
            path.display()
        ))
    }

    pub(crate) fn empty(what: &str) -> Self {
        Self::Refused(format!("the {what} is empty; give at least one item"))
    }

    /// Returns an error if there are no items.
    pub(crate) fn if_empty<T>(items: &[T], what: &str) -> Result<(), Self> {
        match items.is_empty() {
            true => Err(Self::empty(what)),
            false => Ok(()),
        }
    }

    pub(crate) fn config(field: &'static str, problem: impl Into<String>) -> Self {
        Self::Config {
            field,
            problem: problem.into(),
        }
    }

    pub(crate) fn item(id: impl Into<String>, problem: impl Display) -> Self {
        Self::Refused(format!("item {:?} {problem}", id.into()))
    }

    /// Two models cannot be used together.
    pub(crate) fn misfit(what: &str, problem: impl Display) -> Self {
        Self::Refused(format!("{what} does not fit the editor: {problem}"))
    }

    /// A table of embeddings lacks texts.
    pub(crate) fn not_embedded(texts: &[&str]) -> Self {
        /// Number of texts that the message names.
        const NAMED: usize = 3;
        let named: Vec<String> = texts
            .iter()
            .take(NAMED)
            .map(|text| format!("{text:?}"))
            .collect();
        Self::Refused(format!(
            "the table of text embeddings lacks {} texts, such as {}; make it again from all instructions \
             (`stance model texts` lists those of a dataset)",
            texts.len(),
            named.join(", ")
        ))
    }

    pub(crate) fn encoder(problem: impl Display) -> Self {
        Self::Refused(format!("the encoder {problem}"))
    }

    pub(crate) fn tokens(text: &str, detail: impl Display) -> Self {
        Self::Refused(format!(
            "text {text:?} cannot be cut into tokens ({detail})"
        ))
    }

    pub(crate) fn tokenizer(path: &Path, detail: impl Display) -> Self {
        Self::Refused(format!(
            "{} is no tokenizer of the text encoder ({detail}); give its tokenizer.json, or of CLIP \
             bpe_simple_vocab_16e6.txt.gz, or of BERT vocab.txt",
            path.display()
        ))
    }

    pub(crate) fn text_model(path: &Path, detail: impl Display) -> Self {
        Self::Refused(format!(
            "{} is of a text encoder that this program does not run ({detail}); it runs BERT, MiniLM and DistilBERT",
            path.display()
        ))
    }

    pub(crate) fn weights(path: &Path, detail: impl Display) -> Self {
        Self::Weights {
            path: path.to_owned(),
            detail: detail.to_string(),
        }
    }
}

/// Returns a function that adds a motion's id to an error.
pub(crate) fn motion_error<E: Into<datasets_spec::Error>>(id: &str) -> impl Fn(E) -> Error + Copy {
    move |source| Error::Motion {
        id: id.to_owned(),
        source: source.into(),
    }
}

/// Returns a function that adds a document's path to a JSON error.
pub(crate) fn json_error(path: &Path) -> impl Fn(serde_json::Error) -> Error + Copy {
    move |source| Error::Json {
        path: path.to_owned(),
        source,
    }
}
