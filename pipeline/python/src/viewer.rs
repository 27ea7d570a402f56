//! Motions in the viewer of reports.

use datasets_spec::{JointSet, Resample};
use eval::draw::strip::Row;
use eval::report::{self, Strip};
use pyo3::prelude::*;

use crate::error::Failure;
use crate::motion::Motion;
use crate::work;

/// An HTML page that shows motions side by side at the frame rate of the first, under their labels. `joints` are marked
/// in all of them.
#[pyfunction]
pub(crate) fn viewer_page(
    py: Python<'_>,
    motions: Vec<PyRef<'_, Motion>>,
    labels: Vec<String>,
    title: String,
    joints: Vec<String>,
) -> PyResult<String> {
    let copied = |motion: &PyRef<'_, Motion>| Motion::of(motion.inner.clone(), &motion.skeleton);
    let motions: Vec<Motion> = motions.iter().map(copied).collect();
    work::quick(py, || {
        let marked = JointSet::try_from(joints)?;
        let first = motions
            .first()
            .ok_or_else(|| Failure::new("there is no motion to show"))?;
        let fps = first.inner.fps();
        let row = |(motion, label): (&Motion, String)| -> Result<Row, Failure> {
            let inner = Resample::Exact.apply(&motion.inner, fps)?;
            let mut row = Row::new(label, &inner, &motion.skeleton);
            row.highlighted = marked;
            Ok(row)
        };
        let rows = motions.iter().zip(labels).map(row);
        Ok(report::viewer_page(&Strip {
            caption: title,
            note: String::new(),
            rows: rows.collect::<Result<_, _>>()?,
        }))
    })
}
