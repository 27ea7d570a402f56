//! `MotionCutMix`: the stream of composed edits.

use std::path::PathBuf;
use std::sync::Arc;

use compose::{ComposeConfig, Stream, WindowBatch};
use datasets_spec::{Dataset, Seed, Skeleton, Split};
use kinematics::normalise::{FRAME_WIDTH, Normalizer};
use numpy::{IntoPyArray, PyArray1, PyArray3, PyArrayMethods};
use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;
use serde_json::Value;
use train::config::overlay;

use crate::error::Failure;
use crate::motion::{Motion, shown};
use crate::work;

/// A stream of windows over one split, prepared once and shared by forked workers.
#[pyclass(frozen, module = "stance._native")]
#[derive(Debug)]
pub(crate) struct Mix {
    stream: Stream,
    normalizer: Normalizer,
    skeleton: Arc<Skeleton>,
}

type Batch<'py> = (
    Bound<'py, PyArray3<f32>>,
    Bound<'py, PyArray3<f32>>,
    Bound<'py, PyArray1<f32>>,
    Vec<String>,
);

#[pymethods]
impl Mix {
    /// `config` and `normalizer` are JSON; without a normaliser one is fitted to the training split.
    #[new]
    fn new(
        py: Python<'_>,
        path: PathBuf,
        config: &str,
        seed: u64,
        split: &str,
        normalizer: Option<&str>,
    ) -> PyResult<Self> {
        let own: Value = serde_json::from_str(config).map_err(Failure::from)?;
        let config: ComposeConfig =
            overlay(&ComposeConfig::default(), &own).map_err(Failure::from)?;
        let normalizer: Option<Normalizer> = normalizer
            .map(serde_json::from_str)
            .transpose()
            .map_err(Failure::from)?;
        let split: Split = split.parse().map_err(Failure::from)?;
        work::long(py, false, |_| {
            let dataset = Dataset::open(&path)?;
            let skeleton = Arc::new(dataset.skeleton()?);
            let (stream, normalizer) = match (split, normalizer) {
                (Split::Train, normalizer) => {
                    compose::train_stream(&dataset, &config, Seed(seed), normalizer)?
                }
                (split, normalizer) => {
                    let normalizer = match normalizer {
                        Some(normalizer) => normalizer,
                        None => {
                            compose::library(&dataset, Split::Train)?.fit_normalizer(&config)?
                        }
                    };
                    let library = compose::library(&dataset, split)?;
                    let stream = Stream::new(library, config, Seed(seed), &normalizer)?;
                    (stream, normalizer)
                }
            };
            Ok(Self {
                stream,
                normalizer,
                skeleton,
            })
        })
    }

    /// Number of windows of an epoch.
    #[getter]
    fn epoch_len(&self) -> u64 {
        self.stream.epoch_len()
    }

    /// Frames of a window, and numbers of a frame.
    #[getter]
    fn window_shape(&self) -> (usize, usize) {
        (self.stream.config().window, FRAME_WIDTH)
    }

    /// Frames a second of a window.
    #[getter]
    fn fps(&self) -> f64 {
        self.stream.config().fps.get()
    }

    /// The settings as JSON.
    #[getter]
    fn config(&self) -> PyResult<String> {
        Ok(serde_json::to_string(self.stream.config()).map_err(Failure::from)?)
    }

    /// Hash of settings and rules: together with dataset and seed, it determines every window.
    #[getter]
    fn recipe_hash(&self) -> String {
        self.stream.config().recipe_hash()
    }

    /// The normaliser as JSON.
    #[getter]
    fn normalizer(&self) -> PyResult<String> {
        Ok(serde_json::to_string(&self.normalizer).map_err(Failure::from)?)
    }

    /// Every instruction that a window can have, sorted.
    fn instructions(&self) -> Vec<String> {
        self.stream.instructions()
    }

    /// Windows `first..first + count` of the endless stream, epoch after epoch: originals and edits `[B, W, 84]` in
    /// model units, progress `[B]`, instructions.
    fn windows<'py>(&self, py: Python<'py>, first: u64, count: usize) -> PyResult<Batch<'py>> {
        let epoch_len = self.stream.epoch_len();
        let batch = work::quick(py, || {
            let mut all = WindowBatch::default();
            let mut part = WindowBatch::default();
            let mut done = 0;
            while done < count {
                let place = first + done as u64;
                let (epoch, item) = (place / epoch_len, place % epoch_len);
                let len = (count - done).min((epoch_len - item) as usize);
                if len == count {
                    self.stream.fill(epoch, item, len, &mut all)?;
                } else {
                    self.stream.fill(epoch, item, len, &mut part)?;
                    all.original.extend_from_slice(&part.original);
                    all.edited.extend_from_slice(&part.edited);
                    all.progress.extend_from_slice(&part.progress);
                    all.instructions.append(&mut part.instructions);
                }
                done += len;
            }
            Ok(all)
        })?;
        let shape = [count, self.stream.config().window, FRAME_WIDTH];
        Ok((
            batch.original.into_pyarray(py).reshape(shape)?,
            batch.edited.into_pyarray(py).reshape(shape)?,
            batch.progress.into_pyarray(py),
            batch.instructions,
        ))
    }

    /// The whole-clip triplet of an item of an epoch.
    fn triplet(&self, py: Python<'_>, epoch: u64, item: u64) -> PyResult<Triplet> {
        let len = self.stream.epoch_len();
        if item >= len {
            return Err(PyIndexError::new_err(format!(
                "item {item} of an epoch of {len}"
            )));
        }
        let composed = work::quick(py, || Ok(self.stream.triplet(epoch, item)?))?;
        Ok(Triplet {
            original: Motion::of(composed.original, &self.skeleton),
            edited: Motion::of(composed.edited, &self.skeleton),
            id: composed.id,
            kind: composed.kind.to_owned(),
            instruction: composed.instruction,
            source_id: composed.source_id.to_string(),
            target_id: composed.target_id.to_string(),
            hard_joints: composed.mask.hard().names(),
            soft_joints: composed.mask.soft().names(),
            alpha: composed.alpha,
        })
    }

    /// Sets the number of threads of this process. Workers of a loader use 1.
    #[staticmethod]
    fn set_num_threads(count: usize) -> PyResult<()> {
        Ok(work::set_num_threads(count)?)
    }
}

/// An original motion, an instruction, and the edited motion.
#[pyclass(frozen, get_all, module = "stance")]
#[derive(Debug)]
pub(crate) struct Triplet {
    id: String,
    kind: String,
    instruction: String,
    source_id: String,
    target_id: String,
    hard_joints: Vec<String>,
    soft_joints: Vec<String>,
    alpha: f64,
    original: Motion,
    edited: Motion,
}

#[pymethods]
impl Triplet {
    fn __repr__(&self) -> String {
        format!("Triplet({:.8}, {:?})", self.id, self.instruction)
    }

    /// Both motions in the viewer of reports, for a notebook.
    fn _repr_html_(this: Bound<'_, Self>) -> PyResult<Bound<'_, PyAny>> {
        shown(this.into_any(), "show_triplet")
    }
}
