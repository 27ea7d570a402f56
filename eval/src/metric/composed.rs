//! Share of a motion's windows that a classifier finds composed of several motions.

use super::definition::{Better, Measure, Metric, Part};

/// Share of windows that the coordinator's classifier finds composed, in percent.
///
/// # Source
/// Paper, Sec. 5.2 and App. B.4 for the classifier; its use as a metric is ours.
pub static COMPOSED: Metric = Metric {
    name: "Composed (%)",
    about: "share of windows that a coordinator classifies as composed",
    part: Part::Further,
    better: |_| Better::NearReal,
    decimals: 2,
    measure: Measure::Motion(|sample| Some(100.0 * sample.composed?)),
};
