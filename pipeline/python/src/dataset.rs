//! Datasets and their items.

use std::path::PathBuf;
use std::sync::Arc;

use datasets_spec::record::{ItemRow, MotionRow};
use datasets_spec::table::{Row, ShardReader, read_rows};
use datasets_spec::{Dataset as Inner, Skeleton, Split};
use pipeline::open::stored_clip;
use pyo3::prelude::*;

use crate::error::Failure;
use crate::motion::Motion;
use crate::work;

/// A dataset opened for reading.
#[pyclass(frozen, module = "stance", subclass, name = "Dataset")]
#[derive(Debug)]
pub(crate) struct Dataset {
    pub(crate) inner: Inner,
    skeleton: Arc<Skeleton>,
}

/// Parses the name of a split; without a name, all splits are meant.
pub(crate) fn split_of(split: Option<&str>) -> Result<Option<Split>, Failure> {
    Ok(split.map(str::parse).transpose()?)
}

#[pymethods]
impl Dataset {
    #[new]
    #[pyo3(signature = (path, *, verify = true))]
    fn new(py: Python<'_>, path: PathBuf, verify: bool) -> PyResult<Self> {
        work::quick(py, || {
            let inner = match verify {
                true => Inner::open(&path)?,
                false => Inner::open_unverified(&path)?,
            };
            let skeleton = Arc::new(inner.skeleton()?);
            Ok(Self { inner, skeleton })
        })
    }

    /// Folder of the dataset.
    #[getter]
    fn path(&self) -> PathBuf {
        self.inner.root().to_owned()
    }

    /// The manifest as JSON.
    fn _manifest(&self) -> PyResult<String> {
        Ok(serde_json::to_string(self.inner.manifest()).map_err(Failure::from)?)
    }

    /// Hash of all that the dataset holds, hexadecimal.
    #[getter]
    fn root_hash(&self) -> &str {
        &self.inner.manifest().root_hash
    }

    /// Parquet files of a table.
    #[pyo3(signature = (table, split = None))]
    fn files(&self, table: &str, split: Option<&str>) -> PyResult<Vec<PathBuf>> {
        let files = self.inner.files(table, split_of(split)?);
        Ok(files.into_iter().map(|(path, _)| path).collect())
    }

    /// Number of rows of a table.
    #[pyo3(signature = (table, split = None))]
    fn num_rows(&self, table: &str, split: Option<&str>) -> PyResult<u64> {
        Ok(self.inner.manifest().rows(table, split_of(split)?))
    }

    /// Ids of the clips, in the order of the files.
    #[pyo3(signature = (split = None))]
    fn ids(&self, py: Python<'_>, split: Option<&str>) -> PyResult<Vec<String>> {
        let split = split_of(split)?;
        work::quick(py, || {
            let mut ids = Vec::new();
            for (path, _) in self.inner.files(MotionRow::TABLE, split) {
                ids.extend(ShardReader::open(&path)?.column::<MotionRow, String>("id")?);
            }
            Ok(ids)
        })
    }

    /// The motion of a clip. Only the pages of that clip are read.
    fn motion(&self, py: Python<'_>, id: &str) -> PyResult<Motion> {
        let inner = work::quick(py, || Ok(stored_clip(&self.inner, id)?.motion()?))?;
        Ok(Motion::of(inner, &self.skeleton))
    }

    /// All clips of a Parquet file of this dataset.
    fn _motions_of(&self, py: Python<'_>, file: PathBuf) -> PyResult<Vec<(String, Motion)>> {
        work::quick(py, || {
            let rows: Vec<MotionRow> = read_rows(&file)?;
            rows.into_iter()
                .map(|row| {
                    let motion = Motion::of(row.motion()?, &self.skeleton);
                    Ok((row.id.to_string(), motion))
                })
                .collect()
        })
    }

    /// The test questions of a folder of items.
    fn items(&self, py: Python<'_>) -> PyResult<Vec<Item>> {
        work::quick(py, || {
            let rows = self.inner.items()?;
            let item = |row| Item {
                row,
                skeleton: Arc::clone(&self.skeleton),
            };
            Ok(rows.into_iter().map(item).collect())
        })
    }
}

/// A test question: a motion, an instruction, and the motion that should result.
#[pyclass(frozen, module = "stance")]
#[derive(Clone, Debug)]
pub(crate) struct Item {
    pub(crate) row: ItemRow,
    skeleton: Arc<Skeleton>,
}

#[pymethods]
impl Item {
    #[getter]
    fn id(&self) -> &str {
        &self.row.id
    }

    #[getter]
    fn task(&self) -> &str {
        &self.row.task
    }

    #[getter]
    fn instruction(&self) -> &str {
        &self.row.instruction
    }

    #[getter]
    fn parts(&self) -> Vec<String> {
        self.row.parts.clone()
    }

    /// Names of the joints that are edited; empty if unknown.
    #[getter]
    fn joints(&self) -> Vec<String> {
        let row = &self.row;
        row.hard_joints
            .iter()
            .chain(&row.soft_joints)
            .cloned()
            .collect()
    }

    #[getter]
    fn source_id(&self) -> String {
        self.row.source_id.to_string()
    }

    #[getter]
    fn target_id(&self) -> String {
        self.row.target_id.to_string()
    }

    /// The motion to edit.
    #[getter]
    fn source(&self) -> PyResult<Motion> {
        let inner = self.row.source().map_err(Failure::from)?;
        Ok(Motion::of(inner, &self.skeleton))
    }

    /// The target motion; `None` if the question has no target.
    #[getter]
    fn target(&self) -> PyResult<Option<Motion>> {
        if self.row.target_frames == 0 {
            return Ok(None);
        }
        let inner = self.row.target().map_err(Failure::from)?;
        Ok(Some(Motion::of(inner, &self.skeleton)))
    }

    fn __repr__(&self) -> String {
        format!("Item({:.8}, {:?})", self.row.id, self.row.instruction)
    }
}
