//! The capture plan: which source motions are to be performed in which styles.

use serde::{Deserialize, Serialize};

/// `PUT captures`: the whole plan, in place of the one before.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct CapturePlan {
    /// Its cells, each motion with each style once.
    pub cells: Vec<PlannedCapture>,
}

/// A cell of the plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct PlannedCapture {
    /// Id of the source motion; the project need not know it yet.
    pub motion: String,
    /// Name of the style.
    pub style: String,
    /// Takes that are wanted, 1 to 1,000.
    pub takes: u32,
}

/// `GET captures`, and the answer to `PUT captures`: the plan with what has arrived of it. A take is a style pair of
/// the motion in the style.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct Captures {
    /// The cells in the order of the plan.
    pub cells: Vec<CaptureCell>,
    /// Style pairs of no planned cell, without rejected ones.
    pub unplanned: u32,
}

/// A cell of the plan with what has arrived.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(deny_unknown_fields)]
pub struct CaptureCell {
    /// Id of the source motion.
    pub motion: String,
    /// Name of the style.
    pub style: String,
    /// Takes that are wanted.
    pub takes: u32,
    /// Takes that arrived and are not rejected.
    pub arrived: u32,
    /// Takes that were judged unusable or dropped.
    pub rejected: u32,
    /// Takes that are still to capture.
    pub missing: u32,
    /// Whether the project has a motion of this id.
    pub known: bool,
}
