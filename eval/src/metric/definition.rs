//! Definition of a metric: name, direction, format and computation.

use std::fmt;

use datasets_spec::{JointSet, Motion};
use kinematics::KeypointFrame;
use kinematics::skeleton::NUM_KEYPOINTS;

use crate::Error;
use crate::linalg::Matrix;
use crate::protocol::Protocol;
use crate::rows::EditFacts;

/// A column of the result tables. Two metrics are the same if their names are.
#[derive(Debug)]
pub struct Metric {
    /// Name in the table of scores, with the unit if it has one.
    pub name: &'static str,
    /// Description of the metric in the help of `stance eval`.
    pub about: &'static str,
    /// Table that shows the metric.
    pub part: Part,
    /// Returns which values are good for a task.
    pub better: fn(&str) -> Better,
    /// Digits after the point that tables print.
    pub decimals: usize,
    /// How the metric is computed.
    pub measure: Measure,
}

/// Result tables; each metric belongs to one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The columns of the paper's Table 1.
    Paper,
    /// Columns of the main table except its retrieval ([`super::main_columns`]).
    Main,
    /// Columns that the paper does not print.
    Further,
    /// Motion quality, independent of content.
    Quality,
}

/// Which values of a metric are good.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Better {
    /// Small values are good.
    Lower,
    /// Large values are good.
    Higher,
    /// Values near that of the real data are good.
    NearReal,
}

impl Better {
    /// The arrow that the paper's tables print.
    pub fn arrow(self) -> char {
        match self {
            Self::Lower => '↓',
            Self::Higher => '↑',
            Self::NearReal => '→',
        }
    }
}

/// A column of a result table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Column {
    /// The metric.
    pub metric: &'static Metric,
    /// Which values are good for the table's task.
    pub better: Better,
}

impl Column {
    pub(crate) fn of(metric: &'static Metric, task: &str) -> Self {
        let better = (metric.better)(task);
        Self { metric, better }
    }

    /// The metric with its arrow, such as `FID ↓`.
    pub fn label(&self) -> String {
        format!("{} {}", self.metric, self.better.arrow())
    }

    /// The first word of the label if several columns share it, and the rest of the label. The four columns of E2S form
    /// a family, and those of E2T.
    pub(crate) fn heading(&self) -> (&'static str, String) {
        let label = self.label();
        ["E2S", "E2T"]
            .into_iter()
            .find_map(|family| Some((family, label.strip_prefix(family)?.trim_start().to_owned())))
            .unwrap_or_else(|| ("", label.clone()))
    }
}

/// Computes the value of one motion.
pub type MotionMeasure = fn(&MotionSample<'_>) -> Option<f64>;

/// Computes one value for each set.
pub type SetMeasure = fn(&SetSample<'_>) -> Result<Option<Vec<f64>>, Error>;

/// Computes pairs of an item and its value from several takes of each item.
pub type TakesMeasure = fn(&TakesSample<'_>) -> Result<Vec<(usize, f64)>, Error>;

/// Computation of a metric; the variant shows the inputs that it needs.
#[derive(Clone, Copy, Debug)]
pub enum Measure {
    /// From each motion alone; `None` if the motion has no value. Tables show the mean over the items with a value.
    Motion(MotionMeasure),
    /// From the latents of whole sets: one value for each set, computed again on each bootstrap resample; `None` if
    /// there are too few items. [`Draws`] names the random draw of each repeat.
    Set(SetMeasure, Draws),
    /// From several takes of each item: pairs of an item and its value. Tables show their mean.
    Takes(TakesMeasure),
    /// From the rank of each edit's counterpart ([`Counterpart`]) in a gallery.
    Rank(Counterpart, RankSummary),
}

/// Random draws of a metric of whole sets; each repeat draws anew.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Draws {
    /// The two halves of the items that a Fréchet distance compares, if the protocol compares halves.
    Halves,
    /// Pairs of items.
    Pairs,
}

/// The counterpart that a retrieval of an edit looks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Counterpart {
    /// The original of the edit.
    Source,
    /// The target of the edit.
    Target,
}

/// Summary of the ranks of all queries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RankSummary {
    /// Share of queries whose counterpart is among the first k, in percent.
    Recall(usize),
    /// Mean rank, the best being 1.
    Average,
    /// Median rank, the best being 1.
    Median,
}

/// A motion to measure, and facts about it.
#[derive(Clone, Copy)]
pub struct MotionSample<'a> {
    /// The motion.
    pub motion: &'a Motion,
    /// Keypoints of the motion in metres, y up.
    pub keypoints: &'a [KeypointFrame],
    /// The target of its item.
    pub target: &'a Target,
    /// Distance of each keypoint from the target's in metres, in the frames that both motions have. Both motions are
    /// placed by their first frames.
    pub distances: &'a [[f64; NUM_KEYPOINTS]],
    /// Mean acceleration of its keypoints.
    pub acceleration: SeamAcceleration,
    /// Joints that the item asks to change; empty if the item does not state them.
    pub edited: JointSet,
    /// Columns of the edit besides its motion; `None` for sources and targets.
    pub edit: Option<&'a EditFacts>,
    /// Share of windows that the classifier finds composed; `None` without a classifier.
    pub composed: Option<f64>,
    /// The protocol.
    pub protocol: &'a Protocol,
}

/// Properties of the target of an item that metrics use, measured once for all motions of the item.
#[derive(Clone, Debug)]
pub struct Target {
    /// Keypoints relative to the first frame, `[L, 28]` in metres.
    pub from_start: Vec<KeypointFrame>,
    /// Mean speed over the ground of the lowest foot in m/s.
    pub foot_slide: Option<f64>,
    /// Largest horizontal distance of the pelvis from its start, in metres.
    pub way_m: f64,
    /// Extent of the ankle's movement over the ground relative to the pelvis, in metres; the larger of the two ankles'.
    pub swing_m: f64,
}

/// Mean acceleration of the keypoints in m/s^2, at seams (frames in which one generated window ends and the next
/// begins) and elsewhere. A mean over no frames is `None`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SeamAcceleration {
    /// Mean over the frames of all seams.
    pub at_seams: Option<f64>,
    /// Mean over all other frames.
    pub inside: Option<f64>,
}

/// Latents of one motion for each item, `[N, D]`.
#[derive(Clone, Debug)]
pub struct Latents {
    /// The encoder's output.
    pub raw: Matrix,
    /// The output scaled to unit length.
    pub unit: Matrix,
}

impl Latents {
    /// The latents of some items, in the given order.
    ///
    /// # Panics
    /// If an index does not exist.
    pub fn select(&self, items: &[usize]) -> Self {
        Self {
            raw: self.raw.select_rows(items),
            unit: self.unit.select_rows(items),
        }
    }
}

/// Sets of latents of the same items, and the items drawn in one repeat or resample.
#[derive(Clone, Copy)]
pub struct SetSample<'a> {
    /// One set per system; the first is the real data.
    pub sets: &'a [&'a Latents],
    /// Drawn items; a bootstrap resample repeats some.
    pub items: &'a [usize],
    /// Items whose targets, and items whose scored motions, enter the Fréchet distance.
    pub fid_items: [&'a [usize]; 2],
    /// Index of the repeat or resample, from which random draws are seeded.
    pub draw: usize,
    /// Whether the items are a bootstrap resample.
    pub resampled: bool,
    /// The protocol.
    pub protocol: &'a Protocol,
}

/// All takes of one system, for one repeat.
#[derive(Clone, Copy)]
pub struct TakesSample<'a> {
    /// Latents of each take.
    pub takes: &'a [&'a Latents],
    /// Index of the repeat.
    pub repeat: usize,
    /// The protocol.
    pub protocol: &'a Protocol,
}

impl PartialEq for Metric {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

impl Eq for Metric {}

impl PartialOrd for Metric {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Metric {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.name.cmp(other.name)
    }
}

impl fmt::Display for Metric {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

/// Refuses rows that contain NaN or infinity, which would spread through a metric unnoticed.
pub(super) fn check_finite(metric: &str, rows: &Matrix) -> Result<(), Error> {
    let mut rows = rows.rows();
    match rows.position(|row| row.iter().any(|value| !value.is_finite())) {
        Some(row) => Err(not_finite(metric, row)),
        None => Ok(()),
    }
}

pub(super) fn not_finite(metric: &str, row: usize) -> Error {
    Error::Invalid(format!("{metric}: row {row} is not finite"))
}

/// Refuses fewer rows than the metric needs.
pub(super) fn check_count(metric: &str, found: usize, needed: usize) -> Result<(), Error> {
    match found < needed {
        true => Err(Error::Invalid(format!(
            "{metric} needs at least {needed} rows, got {found}"
        ))),
        false => Ok(()),
    }
}

/// Refuses two sizes that differ.
pub(super) fn check_size(
    metric: &str,
    what: &str,
    found: usize,
    expected: usize,
) -> Result<(), Error> {
    match found == expected {
        true => Ok(()),
        false => Err(Error::Invalid(format!(
            "{metric}: {what} is {found}, expected {expected}"
        ))),
    }
}

/// The Euclidean distance of two latents.
pub(super) fn distance(a: &[f64], b: &[f64]) -> f64 {
    squared_distance(a, b).sqrt()
}

pub(super) fn squared_distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
}
