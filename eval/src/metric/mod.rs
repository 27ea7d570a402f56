//! The metrics, and the list of all of them. Each is a function of latents, ranks or positions.
//!
//! To add a metric, declare a [`Metric`] in a file of this folder and list it in [`ALL`]. Columns, directions, formats
//! and the tables of `--further` are derived from the declaration.

pub mod composed;
pub mod cross_retrieval;
mod definition;
pub mod diversity;
pub mod fid;
pub mod fit_error;
pub mod foot_score;
pub mod gliding;
pub mod interval;
pub mod motion_quality;
pub mod multimodality;
pub mod position_error;
pub mod retrieval;

pub use definition::{
    Better, Column, Counterpart, Draws, Latents, Measure, Metric, MotionMeasure, MotionSample,
    Part, RankSummary, SeamAcceleration, SetMeasure, SetSample, TakesMeasure, TakesSample, Target,
};

/// Centimetres in a metre.
pub(crate) const CM_PER_M: f64 = 100.0;

/// Version of the metrics. It is raised when a metric gives other values for the same motions, so that stored scores
/// are computed again. Stored scores are also computed again if the names of [`ALL`] change.
pub const METRICS_VERSION: u32 = 5;

/// All metrics: the columns of the paper's Table 1, the other columns of the main table, further ones, and motion
/// quality.
pub static ALL: &[&Metric] = &[
    &fid::FID,
    &diversity::DIVERSITY,
    &foot_score::FOOT_SCORE,
    &retrieval::E2S_RECALL_1,
    &retrieval::E2S_RECALL_2,
    &retrieval::E2S_RECALL_3,
    &retrieval::E2S_AVERAGE_RANK,
    &retrieval::E2T_RECALL_1,
    &retrieval::E2T_RECALL_2,
    &retrieval::E2T_RECALL_3,
    &retrieval::E2T_AVERAGE_RANK,
    &motion_quality::FOOT_SLIDE,
    &motion_quality::TARGET_FOOT_SLIDE,
    &position_error::ERROR_INSIDE,
    &position_error::ERROR_OUTSIDE,
    &fid::FID_RAW,
    &retrieval::E2S_MEDIAN_RANK,
    &retrieval::E2T_MEDIAN_RANK,
    &multimodality::MULTIMODALITY,
    &position_error::POSITION_ERROR,
    &fit_error::FIT_ERROR,
    &fit_error::BONE_DRIFT,
    &composed::COMPOSED,
    &motion_quality::SEAM_ACCELERATION,
    &motion_quality::INSIDE_ACCELERATION,
    &motion_quality::JERK,
    &gliding::GLIDING,
    &gliding::STAYING,
    &motion_quality::ROTATION_STEP,
];

/// The metrics of one table.
pub fn of_part(part: Part) -> Vec<&'static Metric> {
    let all = ALL.iter().copied();
    all.filter(|metric| metric.part == part).collect()
}

/// The metrics of the main table: retrieval of the target, foot slide of the edit and of the target, and the errors
/// inside and outside the mask.
pub fn main_columns() -> Vec<&'static Metric> {
    [vec![&retrieval::E2T_RECALL_1], of_part(Part::Main)].concat()
}

/// Metrics that support claims: two of them must agree that one system is better than another.
pub static CLAIMS: [&Metric; 4] = [
    &retrieval::E2T_RECALL_1,
    &motion_quality::FOOT_SLIDE,
    &position_error::ERROR_INSIDE,
    &position_error::ERROR_OUTSIDE,
];

/// The metric with this name in the table of scores.
pub fn from_name(name: &str) -> Option<&'static Metric> {
    ALL.iter().copied().find(|metric| metric.name == name)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn every_metric_is_in_one_table_under_a_name_of_its_own() {
        let names: BTreeSet<&str> = ALL.iter().map(|metric| metric.name).collect();
        assert_eq!(names.len(), ALL.len());
        for metric in ALL {
            assert_eq!(from_name(metric.name), Some(*metric));
            assert!(!metric.about.is_empty(), "{metric}");
        }
        assert_eq!(from_name("FVD"), None);
        let parts = [Part::Paper, Part::Main, Part::Further, Part::Quality].map(of_part);
        assert_eq!(parts.concat(), ALL);
    }
}
