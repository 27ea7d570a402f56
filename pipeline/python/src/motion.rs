//! Motions as arrays, with their features, joints and blends.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use clip::Outcome;
use compose::{SlerpRule, blend_motion};
use datasets_spec::record::HUMANML3D_WIDTH;
use datasets_spec::{BlendMask, BodyPart, Fps, Motion as Inner, Pose, Resample, Skeleton};
use features::{
    humanml3d, hy_motion, motion_of_features, motion_of_joints, representation_272, smpl_body,
};
use formats::source::{ReadOptions, amass};
use glam::DVec3;
use kinematics::motion::BODY_POSE_WIDTH;
use kinematics::skeleton::{NUM_BODY_JOINTS, NUM_KEYPOINTS};
use numpy::{
    AllowTypeChange, IntoPyArray, PyArray2, PyArray3, PyArrayLike2, PyArrayMethods,
    PyUntypedArrayMethods,
};
use pipeline::open::clip_of_file;
use pyo3::prelude::*;
use train::tmed::features::{self as motionfix, NUM_FEATURES};

use crate::error::Failure;
use crate::work;

/// A motion of `L` frames as SMPL-X parameters, y up, in metres and radians, and the skeleton it drives.
#[pyclass(frozen, module = "stance")]
#[derive(Clone, Debug)]
pub(crate) struct Motion {
    pub(crate) inner: Inner,
    pub(crate) skeleton: Arc<Skeleton>,
}

impl Motion {
    pub(crate) fn of(inner: Inner, skeleton: &Arc<Skeleton>) -> Self {
        Self {
            inner,
            skeleton: Arc::clone(skeleton),
        }
    }

    /// The first `K` keypoints in metres, `[L, K, 3]`.
    fn points<'py, const K: usize>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let len = self.inner.len();
        let values: Vec<f32> = work::quick(py, || {
            let frames = self.skeleton.points_of_frames::<K>(&self.inner, 0..len);
            let points = frames.iter().flatten();
            let numbers = points.flat_map(|point| point.as_vec3().to_array());
            Ok(numbers.collect())
        })?;
        values.into_pyarray(py).reshape([len, K, 3])
    }
}

/// Makes an array `[N, width]` of flattened rows, without a copy.
pub(crate) fn rows<'py, T: numpy::Element>(
    py: Python<'py>,
    values: Vec<T>,
    width: usize,
) -> PyResult<Bound<'py, PyArray2<T>>> {
    let len = values.len().checked_div(width).unwrap_or(0);
    values.into_pyarray(py).reshape([len, width])
}

/// Converts an array `[L, D]` of any number type and layout to rows of `f32`.
pub(crate) fn frames<const D: usize>(
    name: &str,
    array: &PyArrayLike2<'_, f32, AllowTypeChange>,
) -> Result<Vec<[f32; D]>, Failure> {
    let width = array.shape()[1];
    if width != D {
        return Err(Failure::new(format!(
            "{name}: expected an array [L, {D}], got one of {width} columns"
        )));
    }
    let values: Vec<f32> = array.as_array().iter().copied().collect();
    Ok(values.as_chunks::<D>().0.to_vec())
}

fn copied<'py, const D: usize>(
    py: Python<'py>,
    frames: &[[f32; D]],
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    rows(py, frames.as_flattened().to_vec(), D)
}

pub(crate) fn fps_of(fps: f64) -> Result<Fps, Failure> {
    Ok(Fps::new(fps)?)
}

/// Rate of MotionFix's features in 1/s.
const MOTIONFIX_FPS: f64 = 30.0;

/// A kind of features.
#[derive(Clone, Copy, Debug)]
enum Recipe {
    HumanMl3d,
    MotionFix,
    Representation272,
    HyMotion,
}

impl Recipe {
    fn named(name: &str) -> Result<Self, Failure> {
        match name {
            "humanml3d" => Ok(Self::HumanMl3d),
            "motionfix" => Ok(Self::MotionFix),
            "272" => Ok(Self::Representation272),
            "hy-motion" => Ok(Self::HyMotion),
            _ => Err(Failure::new(format!(
                "unknown features {name:?}; there are humanml3d (263 numbers, 20 fps), motionfix (207), 272 and \
                 hy-motion (201), all at 30 fps"
            ))),
        }
    }

    /// Numbers of a frame.
    fn width(self) -> usize {
        match self {
            Self::HumanMl3d => HUMANML3D_WIDTH,
            Self::MotionFix => NUM_FEATURES,
            Self::Representation272 => representation_272::WIDTH,
            Self::HyMotion => hy_motion::WIDTH,
        }
    }

    /// Computes the features of a motion, flattened.
    fn of(self, motion: &Inner, skeleton: &Skeleton) -> Result<Vec<f32>, Failure> {
        Ok(match self {
            Self::HumanMl3d => {
                let motion = Resample::Exact.apply(motion, fps_of(humanml3d::FPS)?)?;
                let joints = humanml3d::joints_of_motion(&motion, &smpl_body(skeleton));
                humanml3d::features_of_joints(&joints)?.into_flattened()
            }
            Self::MotionFix => {
                let fps = fps_of(MOTIONFIX_FPS)?;
                let frames = motionfix::features_of_motion(motion, fps, usize::MAX, skeleton)?;
                frames.into_flattened()
            }
            Self::Representation272 => {
                representation_272::features_of_motion(motion, skeleton)?.into_flattened()
            }
            Self::HyMotion => hy_motion::features_of_motion(motion, skeleton)?.into_flattened(),
        })
    }

    /// Decodes flattened features. MotionFix's features are changes that begin at the pose `first`.
    fn motion(self, values: &[f32], first: &Pose, skeleton: &Skeleton) -> Result<Inner, Failure> {
        Ok(match self {
            Self::HumanMl3d => {
                let fps = fps_of(humanml3d::FPS)?;
                motion_of_features(values.as_chunks().0, fps, skeleton)?.0
            }
            Self::MotionFix => {
                let poses = motionfix::poses_from(values.as_chunks().0, first);
                Inner::from_poses(fps_of(MOTIONFIX_FPS)?, &poses)?
            }
            Self::Representation272 => {
                representation_272::motion_of_features(values.as_chunks().0, skeleton)?.0
            }
            Self::HyMotion => hy_motion::motion_of_features(values.as_chunks().0)?,
        })
    }
}

#[pymethods]
impl Motion {
    #[new]
    fn new(
        transl: PyArrayLike2<'_, f32, AllowTypeChange>,
        global_orient: PyArrayLike2<'_, f32, AllowTypeChange>,
        body_pose: PyArrayLike2<'_, f32, AllowTypeChange>,
        fps: f64,
    ) -> PyResult<Self> {
        let make = || {
            Ok::<_, Failure>(Inner::new(
                fps_of(fps)?,
                frames("transl", &transl)?,
                frames("global_orient", &global_orient)?,
                frames::<BODY_POSE_WIDTH>("body_pose", &body_pose)?,
            )?)
        };
        Ok(Self::of(make()?, &Arc::new(Skeleton::smplx_neutral())))
    }

    /// Reads a motion file of any format that `stance ingest` knows; `file.glb#Walking` names one of several.
    #[staticmethod]
    fn read(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let skeleton = Arc::new(Skeleton::smplx_neutral());
        let inner = work::quick(py, || Ok(clip_of_file(&path, &skeleton)?.motion))?;
        Ok(Self::of(inner, &skeleton))
    }

    /// Reads an AMASS archive.
    #[staticmethod]
    fn from_amass_bytes(py: Python<'_>, bytes: &[u8]) -> PyResult<Self> {
        let inner = work::quick(py, || {
            match amass::read(Path::new("motion.npz"), bytes, &ReadOptions::default())? {
                Outcome::Clip(clip) => Ok(clip.motion),
                Outcome::Skipped { reason } => Err(Failure::new(reason)),
                Outcome::Rejected(rejected) => Err(rejected.into()),
            }
        })?;
        Ok(Self::of(inner, &Arc::new(Skeleton::smplx_neutral())))
    }

    /// The motion as an AMASS archive with the keys of the SMPL-X release, at its own rate.
    fn to_amass_bytes(&self, py: Python<'_>) -> PyResult<Vec<u8>> {
        work::quick(py, || {
            Ok(formats::write::amass::encode_smplx(
                &self.inner,
                &self.skeleton,
            )?)
        })
    }

    /// The motion as the arrays of an AMASS archive, z up, with the keys of the SMPL-X release.
    fn to_amass(this: Bound<'_, Self>) -> PyResult<Bound<'_, PyAny>> {
        let module = this.py().import("stance._motion")?;
        module.call_method1("to_amass", (this,))
    }

    /// The motion of the arrays of an AMASS archive, put on the floor.
    #[staticmethod]
    fn from_amass<'py>(py: Python<'py>, arrays: Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let module = py.import("stance._motion")?;
        module.call_method1("from_amass", (arrays,))
    }

    /// Decodes features. Those of MotionFix begin at the first pose of `first`, or at the rest pose.
    #[staticmethod]
    #[pyo3(signature = (features, recipe, first = None))]
    fn from_features(
        py: Python<'_>,
        features: PyArrayLike2<'_, f32, AllowTypeChange>,
        recipe: &str,
        first: Option<&Self>,
    ) -> PyResult<Self> {
        let recipe = Recipe::named(recipe)?;
        let skeleton = first.map_or_else(
            || Arc::new(Skeleton::smplx_neutral()),
            |motion| Arc::clone(&motion.skeleton),
        );
        let (found, expected) = (features.shape()[1], recipe.width());
        if found != expected {
            return Err(Failure::new(format!(
                "expected features [L, {expected}], got {found} columns"
            ))
            .into());
        }
        let values: Vec<f32> = features.as_array().iter().copied().collect();
        let first = first.map_or(Pose::REST, |motion| motion.inner.pose(0));
        let inner = work::quick(py, || recipe.motion(&values, &first, &skeleton))?;
        Ok(Self::of(inner, &skeleton))
    }

    /// Fits the body to positions of its 22 joints `[L, 22, 3]`; also returns the mean distance left, in metres.
    #[staticmethod]
    fn from_joints(
        py: Python<'_>,
        joints: numpy::PyArrayLike3<'_, f64, AllowTypeChange>,
        fps: f64,
    ) -> PyResult<(Self, f32)> {
        let frames: Vec<[DVec3; NUM_BODY_JOINTS]> = points("joints", &joints)?;
        let skeleton = Arc::new(Skeleton::smplx_neutral());
        let (inner, error) = work::quick(py, || {
            Ok(motion_of_joints(&frames, fps_of(fps)?, &skeleton)?)
        })?;
        Ok((Self::of(inner, &skeleton), error))
    }

    fn __len__(&self) -> usize {
        self.inner.len()
    }

    fn __repr__(&self) -> String {
        let (frames, fps) = (self.inner.len(), self.inner.fps().get());
        format!(
            "Motion({frames} frames at {fps} fps, {:.2} s)",
            self.inner.duration_secs()
        )
    }

    /// The clip in the viewer of reports, for a notebook.
    fn _repr_html_(this: Bound<'_, Self>) -> PyResult<Bound<'_, PyAny>> {
        shown(this.into_any(), "show")
    }

    fn __eq__(&self, other: &Self) -> bool {
        self.inner == other.inner && self.skeleton == other.skeleton
    }

    #[getter]
    fn fps(&self) -> f64 {
        self.inner.fps().get()
    }

    /// Length in seconds.
    #[getter]
    fn duration(&self) -> f64 {
        self.inner.duration_secs()
    }

    /// BLAKE3 of rate and numbers, as in column `content_hash`.
    #[getter]
    fn content_hash(&self) -> String {
        self.inner.content_hash()
    }

    #[getter]
    fn transl<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        copied(py, self.inner.transl())
    }

    #[getter]
    fn global_orient<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        copied(py, self.inner.global_orient())
    }

    #[getter]
    fn body_pose<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        copied(py, self.inner.body_pose())
    }

    /// Positions of the 28 keypoints in metres, `[L, 28, 3]`.
    fn keypoints<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        self.points::<NUM_KEYPOINTS>(py)
    }

    /// Positions of the 22 body joints in metres, `[L, 22, 3]`.
    fn joints<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        self.points::<NUM_BODY_JOINTS>(py)
    }

    /// Features of a recipe, at the recipe's rate.
    fn features<'py>(&self, py: Python<'py>, recipe: &str) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let recipe = Recipe::named(recipe)?;
        let values = work::quick(py, || recipe.of(&self.inner, &self.skeleton))?;
        rows(py, values, recipe.width())
    }

    /// The motion at another rate.
    fn resample(&self, py: Python<'_>, fps: f64) -> PyResult<Self> {
        let inner = work::quick(py, || Ok(Resample::Exact.apply(&self.inner, fps_of(fps)?)?))?;
        Ok(Self::of(inner, &self.skeleton))
    }

    /// Frames `start..end`.
    fn crop(&self, start: usize, end: usize) -> PyResult<Self> {
        let inner = self.inner.crop(start..end).map_err(Failure::from)?;
        Ok(Self::of(inner, &self.skeleton))
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Arguments<'py>)> {
        let skeleton = serde_json::to_string(&*self.skeleton).map_err(Failure::from)?;
        let restore = py.import("stance._motion")?.getattr("_restored")?;
        Ok((
            restore,
            (
                self.transl(py)?,
                self.global_orient(py)?,
                self.body_pose(py)?,
                self.fps(),
                skeleton,
            ),
        ))
    }

    #[staticmethod]
    fn _restored(
        transl: PyArrayLike2<'_, f32, AllowTypeChange>,
        global_orient: PyArrayLike2<'_, f32, AllowTypeChange>,
        body_pose: PyArrayLike2<'_, f32, AllowTypeChange>,
        fps: f64,
        skeleton: &str,
    ) -> PyResult<Self> {
        let made = Self::new(transl, global_orient, body_pose, fps)?;
        let skeleton: Skeleton = serde_json::from_str(skeleton).map_err(Failure::from)?;
        Ok(Self::of(made.inner, &Arc::new(skeleton)))
    }
}

type Arguments<'py> = (
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray2<f32>>,
    f64,
    String,
);

/// The HTML in which a function of `stance._show` shows a thing.
pub(crate) fn shown<'py>(thing: Bound<'py, PyAny>, by: &str) -> PyResult<Bound<'py, PyAny>> {
    let module = thing.py().import("stance._show")?;
    module
        .call_method1(by, (thing,))?
        .call_method0("_repr_html_")
}

/// Converts an array `[L, K, 3]` to points.
pub(crate) fn points<const K: usize>(
    name: &str,
    array: &numpy::PyArrayLike3<'_, f64, AllowTypeChange>,
) -> Result<Vec<[DVec3; K]>, Failure> {
    let shape = array.shape();
    if shape[1..] != [K, 3] {
        return Err(Failure::new(format!(
            "{name}: expected an array [L, {K}, 3], got {shape:?}"
        )));
    }
    let values: Vec<f64> = array.as_array().iter().copied().collect();
    let points = values.as_chunks::<3>().0.as_chunks::<K>().0.iter();
    Ok(points.map(|frame| frame.map(DVec3::from_array)).collect())
}

/// Blends two motions of equal length and rate: hard joints from `target`, soft ones interpolated, the rest from
/// `source`. The mask is `parts`, or the joints `hard` and `soft`.
#[pyfunction]
#[pyo3(signature = (source, target, *, parts = None, hard = None, soft = None, alpha = 0.5, official = false))]
#[expect(clippy::too_many_arguments, reason = "they are keywords in Python")]
pub(crate) fn blend(
    py: Python<'_>,
    source: &Motion,
    target: &Motion,
    parts: Option<Vec<String>>,
    hard: Option<Vec<String>>,
    soft: Option<Vec<String>>,
    alpha: f64,
    official: bool,
) -> PyResult<Motion> {
    let inner = work::quick(py, || {
        let mask = match (&parts, &hard, &soft) {
            (Some(parts), None, None) => {
                let parts: Vec<BodyPart> = parts
                    .iter()
                    .map(|part| Ok(part.to_uppercase().replace([' ', '-'], "_").parse()?))
                    .collect::<Result<_, Failure>>()?;
                BlendMask::of_parts(&parts)
            }
            (None, hard, soft) if hard.is_some() || soft.is_some() => BlendMask::of_names(
                hard.as_deref().unwrap_or_default(),
                soft.as_deref().unwrap_or_default(),
            )?,
            _ => {
                return Err(Failure::new(
                    "name the mask: parts=[…] such as LEFT_ARM, or hard=[…] and soft=[…] by joint names",
                ));
            }
        };
        let rule = match official {
            true => SlerpRule::Official,
            false => SlerpRule::Exact,
        };
        if !(0.0..=1.0).contains(&alpha) {
            return Err(Failure::new(format!(
                "alpha must be from 0 to 1, got {alpha}"
            )));
        }
        Ok(blend_motion(
            &source.inner,
            &target.inner,
            mask,
            alpha,
            rule,
        )?)
    })?;
    Ok(Motion::of(inner, &source.skeleton))
}
