//! Metrics on arrays.

use std::collections::BTreeMap;

use datasets_spec::Seed;
use eval::linalg::Matrix;
use eval::metric;
use eval::metric::foot_score::Feet;
use eval::metric::retrieval::{Retrieval, gallery_ranks, unit_rows};
use eval::protocol::{Floor, Gallery, Protocol};
use glam::DVec3;
use kinematics::skeleton::NUM_KEYPOINTS;
use numpy::{AllowTypeChange, PyArrayLike2, PyArrayLike3, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::error::Failure;
use crate::motion::{fps_of, points};
use crate::work;

type Latents<'py> = PyArrayLike2<'py, f64, AllowTypeChange>;
type Points<'py> = PyArrayLike3<'py, f64, AllowTypeChange>;

fn matrix(latents: &Latents<'_>) -> Matrix {
    let [rows, columns] = [latents.shape()[0], latents.shape()[1]];
    Matrix::new(rows, columns, latents.as_array().iter().copied().collect())
}

/// Fréchet distance of two sets of latents `[N, D]` and `[M, D]`.
#[pyfunction]
pub(crate) fn fid(py: Python<'_>, real: Latents<'_>, generated: Latents<'_>) -> PyResult<f64> {
    let (real, generated) = (matrix(&real), matrix(&generated));
    work::quick(py, || Ok(metric::fid::fid(&real, &generated)?))
}

/// Mean distance of random pairs of latents `[N, D]`.
#[pyfunction]
#[pyo3(signature = (latents, num_pairs = 300, seed = 0))]
pub(crate) fn diversity(
    py: Python<'_>,
    latents: Latents<'_>,
    num_pairs: usize,
    seed: u64,
) -> PyResult<f64> {
    let latents = matrix(&latents);
    work::quick(py, || {
        let mut rng = Seed(seed).rng(&["diversity"]);
        Ok(metric::diversity::diversity(&latents, num_pairs, &mut rng)?)
    })
}

/// Mean distance of random pairs of the `R` takes of a question, over `N` questions: latents `[N, R, D]`.
#[pyfunction]
#[pyo3(signature = (latents, num_pairs = 10, seed = 0))]
pub(crate) fn multimodality(
    py: Python<'_>,
    latents: Points<'_>,
    num_pairs: usize,
    seed: u64,
) -> PyResult<f64> {
    let &[conditions, takes, width] = latents.shape() else {
        return Err(Failure::new("expected latents [N, R, D]").into());
    };
    let values: Vec<f64> = latents.as_array().iter().copied().collect();
    work::quick(py, || {
        let mut rng = Seed(seed).rng(&["multimodality"]);
        let [first, second] = metric::multimodality::pairs(takes, num_pairs, &mut rng)?;
        let conditions: Vec<Matrix> = (0..conditions)
            .map(|at| {
                let numbers = values[at * takes * width..][..takes * width].to_vec();
                Matrix::new(takes, width, numbers)
            })
            .collect();
        Ok(metric::multimodality::multimodality_of_pairs(
            &conditions,
            &first,
            &second,
        )?)
    })
}

/// Retrieval of paired latents `[N, D]` by cosine. A gallery holds `gallery_size` of them (`None`: all); values are
/// means over `repeats` draws of the galleries.
#[pyfunction]
#[pyo3(signature = (queries, gallery, gallery_size = Some(32), repeats = 10, seed = 0))]
pub(crate) fn retrieval(
    py: Python<'_>,
    queries: Latents<'_>,
    gallery: Latents<'_>,
    gallery_size: Option<usize>,
    repeats: usize,
    seed: u64,
) -> PyResult<BTreeMap<&'static str, f64>> {
    let (queries, gallery) = (matrix(&queries), matrix(&gallery));
    let found = work::quick(py, || {
        let protocol = Protocol {
            gallery: gallery_size.map_or(Gallery::Full, Gallery::Batches),
            repeats,
            seed: Seed(seed),
            ..Protocol::default()
        };
        protocol.check()?;
        let (queries, gallery) = (unit_rows(&queries)?, unit_rows(&gallery)?);
        let distinct = (0..protocol.distinct_galleries(queries.num_rows()))
            .map(|repeat| {
                let galleries = protocol.galleries(queries.num_rows(), repeat);
                let ranks = gallery_ranks(&queries, &gallery, &galleries)?;
                Ok(Retrieval::of_ranks(&ranks.concat()))
            })
            .collect::<Result<Vec<_>, Failure>>()?;
        let of_repeat = |repeat: usize| distinct[repeat % distinct.len()];
        Ok(Retrieval::mean(
            &(0..repeats).map(of_repeat).collect::<Vec<_>>(),
        ))
    })?;
    let [r1, r2, r3] = found.recall;
    Ok(BTreeMap::from([
        ("R@1", r1),
        ("R@2", r2),
        ("R@3", r3),
        ("MedR", found.median_rank),
        ("AvgR", found.average_rank),
    ]))
}

/// Foot score of keypoints `[L, 28, 3]` or `[L, 22, 3]`, y up, in metres; `None` for fewer than three frames. The floor
/// is the lowest foot unless a height is given.
#[pyfunction]
#[pyo3(signature = (keypoints, fps, floor = None))]
pub(crate) fn foot_score(
    keypoints: Points<'_>,
    fps: f64,
    floor: Option<f64>,
) -> PyResult<Option<f64>> {
    let shape = keypoints.shape();
    if shape[1] < 12 || shape[2] != 3 {
        return Err(Failure::new(format!(
            "expected keypoints [L, 22 or 28, 3], got {shape:?}"
        ))
        .into());
    }
    let array = keypoints.as_array();
    let point = |frame: usize, joint: usize| {
        DVec3::new(
            array[[frame, joint, 0]],
            array[[frame, joint, 1]],
            array[[frame, joint, 2]],
        )
    };
    // Left ankle and foot, right ankle and foot.
    let feet: Vec<Feet> = (0..shape[0])
        .map(|frame| [7, 10, 8, 11].map(|joint| point(frame, joint)))
        .collect();
    let floor = floor.map_or(Floor::Lowest, Floor::At);
    Ok(metric::foot_score::foot_score(&feet, fps_of(fps)?, floor))
}

/// Mean distance of two motions' keypoints `[L, 28, 3]` in metres, over the frames that both have.
#[pyfunction]
pub(crate) fn position_error(found: Points<'_>, expected: Points<'_>) -> PyResult<f64> {
    let found = points::<NUM_KEYPOINTS>("found", &found)?;
    let expected = points::<NUM_KEYPOINTS>("expected", &expected)?;
    if found.is_empty() || expected.is_empty() {
        return Err(Failure::new("a motion without frames has no position error").into());
    }
    Ok(metric::position_error::mean_position_error(
        &found,
        &expected,
        NUM_KEYPOINTS,
    ))
}

/// Mean jerk of keypoints `[L, 28, 3]` in m/s³; `None` for fewer than four frames.
#[pyfunction]
pub(crate) fn jerk(keypoints: Points<'_>, fps: f64) -> PyResult<Option<f64>> {
    let points = points("keypoints", &keypoints)?;
    Ok(metric::motion_quality::jerk(&points, fps_of(fps)?))
}

/// Mean horizontal speed in m/s of the lowest foot, of keypoints `[L, 28, 3]`; `None` for fewer than two frames.
#[pyfunction]
pub(crate) fn foot_slide(keypoints: Points<'_>, fps: f64) -> PyResult<Option<f64>> {
    let points = points("keypoints", &keypoints)?;
    Ok(metric::motion_quality::foot_slide(&points, fps_of(fps)?))
}
