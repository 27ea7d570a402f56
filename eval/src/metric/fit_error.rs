//! Fit errors of generated keypoints, as recorded with an edit.

use super::CM_PER_M;
use super::definition::{Better, Measure, Metric, Part};

pub(crate) static FIT_ERROR: Metric = Metric {
    name: "Fit error (cm)",
    about: "mean distance of generated keypoints from the body fitted to them",
    part: Part::Further,
    better: |_| Better::Lower,
    decimals: 2,
    measure: Measure::Motion(|sample| Some(CM_PER_M * f64::from(sample.edit?.fit_error_m?))),
};

pub(crate) static BONE_DRIFT: Metric = Metric {
    name: "Bone drift (cm)",
    about: "mean difference between the lengths of generated bones and of the fitted body's bones",
    part: Part::Further,
    better: |_| Better::Lower,
    decimals: 2,
    measure: Measure::Motion(|sample| Some(CM_PER_M * f64::from(sample.edit?.bone_drift_m?))),
};
