//! Encoders and scores.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Arc;

use burn::tensor::Device;
use datasets_spec::Motion as Inner;
use datasets_spec::record::EditRow;
use eval::answers::{Answered, Scores};
use eval::evaluators::{Evaluators, MotionEncoder};
use eval::format::text;
use eval::judge::weakness;
use eval::protocol::Protocol;
use eval::rows::ItemFacts;
use eval::table::Table;
use eval::{EncoderError, metric};
use numpy::PyArray2;
use pyo3::prelude::*;
use serde_json::Value;
use train::checkpoint::{Slot, check_skeleton};
use train::config::overlay;
use train::tmr::TmrEncoder;

use crate::error::Failure;
use crate::motion::{Motion, rows};
use crate::work;

/// An encoder of texts and motions, trained by `stance train tmr`.
#[pyclass(frozen, module = "stance")]
pub(crate) struct Encoder {
    inner: Arc<TmrEncoder>,
}

#[pymethods]
impl Encoder {
    #[new]
    fn new(py: Python<'_>, run: PathBuf) -> PyResult<Self> {
        work::quick(py, || {
            let inner = TmrEncoder::load(&run, Slot::Best, &Device::flex())?;
            Ok(Self {
                inner: Arc::new(inner),
            })
        })
    }

    /// Hash of the weights, hexadecimal.
    #[getter]
    fn hash(&self) -> &str {
        self.inner.hash()
    }

    /// Latents of motions, `[N, D]`.
    fn encode<'py>(
        &self,
        py: Python<'py>,
        motions: Vec<PyRef<'py, Motion>>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let motions: Vec<Inner> = motions.iter().map(|motion| motion.inner.clone()).collect();
        let latents = work::long(py, false, |_| {
            let motions: Vec<&Inner> = motions.iter().collect();
            Ok(self.inner.encode(&motions)?)
        })?;
        matrix(py, &latents)
    }

    /// Latents of texts, `[N, D]`.
    fn encode_texts<'py>(
        &self,
        py: Python<'py>,
        texts: Vec<String>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let latents = work::long(py, false, |_| {
            let texts: Vec<&str> = texts.iter().map(String::as_str).collect();
            Ok(self.inner.encode_texts(&texts)?)
        })?;
        matrix(py, &latents)
    }

    fn __repr__(&self) -> String {
        format!("Encoder({})", self.inner.description())
    }
}

fn matrix<'py>(py: Python<'py>, latents: &[Vec<f32>]) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let width = latents.first().map_or(0, Vec::len);
    rows(py, latents.concat(), width)
}

struct Adapter<'a> {
    encoder: &'a TmrEncoder,
    weakness: Option<String>,
}

impl MotionEncoder for Adapter<'_> {
    fn encode(&self, motions: &[&Inner]) -> Result<Vec<Vec<f64>>, EncoderError> {
        let latents = self.encoder.encode(motions)?;
        let wide = |latent: Vec<f32>| latent.into_iter().map(f64::from).collect();
        Ok(latents.into_iter().map(wide).collect())
    }

    fn hash(&self) -> String {
        self.encoder.hash().to_owned()
    }

    fn recipe(&self) -> String {
        self.encoder.description()
    }

    fn weakness(&self) -> Option<String> {
        self.weakness.clone()
    }
}

/// One take of one answer: the id of the item, the seed of the take, and the motion.
type Answer<'py> = (String, u64, PyRef<'py, Motion>);

/// An [`Answer`] that does not need Python's lock.
type Take = (String, u64, Inner);

/// Scores the systems in `folders` of edits and those in `systems`, given as name and motions. `protocol` is JSON.
/// Returns the scores as JSON, and the tables as text.
#[pyfunction]
pub(crate) fn evaluate(
    py: Python<'_>,
    items: PathBuf,
    folders: Vec<PathBuf>,
    systems: Vec<(String, Vec<Answer<'_>>)>,
    encoder: PathBuf,
    protocol: &str,
) -> PyResult<(String, String)> {
    let own: Value = serde_json::from_str(protocol).map_err(Failure::from)?;
    let protocol: Protocol = overlay(&Protocol::default(), &own).map_err(Failure::from)?;
    let systems: Vec<(String, Vec<Take>)> = systems
        .into_iter()
        .map(|(name, answers)| {
            let motion = |(id, seed, motion): Answer<'_>| (id, seed, motion.inner.clone());
            (name, answers.into_iter().map(motion).collect())
        })
        .collect();
    work::long(py, true, |progress| {
        let folders: Vec<PathBuf> = std::iter::once(items).chain(folders).collect();
        let mut answered = Answered::read_for_table(&folders)?;
        let asked = answered.items.facts().iter();
        let asked: HashMap<&str, &ItemFacts> = asked.map(|item| (item.id.as_str(), item)).collect();
        for (system, answers) in systems {
            let mut edits = answered.edits.facts().iter();
            if edits.any(|edit| edit.system == system) {
                return Err(Failure::new(format!(
                    "two systems have the name {system:?}"
                )));
            }
            for (id, seed, motion) in answers {
                let item = asked
                    .get(id.as_str())
                    .ok_or_else(|| Failure::new(format!("{system}: there is no item {id:?}")))?;
                answered.edits.extend([EditRow {
                    system: system.clone(),
                    seed,
                    ..item.answer(&motion)
                }]);
            }
        }
        check_skeleton(&encoder, "the encoder", &answered.skeleton)?;
        let loaded = TmrEncoder::load(&encoder, Slot::Best, &Device::flex())?;
        let adapter = Adapter {
            encoder: &loaded,
            weakness: weakness(&encoder, loaded.hash())?,
        };
        let evaluators = Evaluators {
            encoder: &adapter,
            classifier: None,
            skeleton: &answered.skeleton,
        };
        let scores = Scores::of(&answered, evaluators, &protocol, progress)?;
        let tables = Table::from_scores(&scores.rows, &scores.judges, metric::ALL);
        Ok((serde_json::to_string(&scores.rows)?, text::render(&tables)))
    })
}
