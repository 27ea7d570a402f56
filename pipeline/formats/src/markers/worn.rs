//! The markers of a capture that have a placement on the body.

use glam::DVec3;

use super::label::Subject;
use super::set::MarkerSet;
use crate::source::Up;
use clip::Markers;

/// Minimum number and share of the markers seen in a frame whose pose is solved.
pub(super) const MIN_SEEN: usize = 6;
const MIN_SEEN_SHARE: f64 = 0.5;

/// The markers with a known placement.
#[derive(Default)]
pub(super) struct LabelledMarkers {
    /// Column of each marker in the capture.
    pub(super) columns: Vec<usize>,
    pub joints: Vec<usize>,
    pub(super) offsets: Vec<DVec3>,
}

impl LabelledMarkers {
    pub(super) fn of(subject: &Subject, set: &MarkerSet) -> Self {
        let mut worn = Self::default();
        let mut names: Vec<&str> = Vec::new();
        for (column, name) in subject.columns.iter().zip(&subject.bare) {
            // Of repeated labels, the first is used.
            if names.contains(&name.as_str()) {
                continue;
            }
            if let Some(place) = set.placement(name) {
                worn.columns.push(*column);
                worn.joints.push(place.joint.index());
                worn.offsets.push(place.offset);
                names.push(name);
            }
        }
        worn
    }

    /// Joints of the markers that are seen in any frame.
    pub(super) fn seen_joints(&self, frames: &Frames) -> Vec<usize> {
        let seen = |marker: usize| frames.points.iter().any(|points| points[marker].is_some());
        let markers = (0..self.joints.len()).filter(|marker| seen(*marker));
        markers.map(|marker| self.joints[marker]).collect()
    }
}

/// Positions of the labelled markers, frame by frame; `None` where a marker was not seen.
pub(super) struct Frames {
    pub(super) points: Vec<Vec<Option<DVec3>>>,
}

impl Frames {
    pub(super) fn of(markers: &Markers, worn: &LabelledMarkers) -> Self {
        let count = markers.labels.len().max(1);
        let seen = |position: [f32; 3], residual: f32| {
            (residual >= 0.0).then(|| DVec3::from_array(position.map(f64::from)))
        };
        let frames = markers.positions.chunks_exact(count);
        let frames = frames.zip(markers.residuals.chunks_exact(count));
        let points = frames.map(|(positions, residuals)| {
            let places = worn.columns.iter();
            places
                .map(|&at| seen(positions[at], residuals[at]))
                .collect()
        });
        Self {
            points: points.collect(),
        }
    }

    pub(super) fn len(&self) -> usize {
        self.points.len()
    }

    pub(super) fn usable(&self, frame: usize) -> bool {
        let points = &self.points[frame];
        let seen = points.iter().flatten().count();
        seen >= MIN_SEEN && seen as f64 >= MIN_SEEN_SHARE * points.len() as f64
    }

    /// The up axis of the file, the one nearest to the mean direction from lower to upper markers, and whether the person
    /// stands along it most of the time. `None` if there is no such direction.
    pub(super) fn up(&self, worn: &LabelledMarkers) -> Option<(Up, bool)> {
        /// Length of the mean direction along the axis above which the person stands.
        const CLEAR: f64 = 0.7;
        // Usual height of a joint: heads, chests and hips are above knees and feet. Arms do not count.
        let level = |joint: usize| match joint {
            7 | 8 | 10 | 11 => -1.0,
            4 | 5 => -0.4,
            0..=2 => 0.3,
            3 | 6 | 9 | 12..=15 => 1.0,
            _ => 0.0,
        };
        let (mut sum, mut num_seen) = (DVec3::ZERO, 0_usize);
        for points in &self.points {
            let seen: Vec<(f64, DVec3)> = points
                .iter()
                .zip(&worn.joints)
                .filter_map(|(point, joint)| Some((level(*joint), (*point)?)))
                .collect();
            let count = seen.len().max(1) as f64;
            let middle = seen.iter().map(|(level, _)| level).sum::<f64>() / count;
            let direction: DVec3 = seen
                .iter()
                .map(|(level, point)| *point * (level - middle))
                .sum();
            let direction = direction.normalize_or_zero();
            num_seen += usize::from(direction != DVec3::ZERO);
            sum += direction;
        }
        let along = sum.abs().max_element() / num_seen.max(1) as f64;
        (along > 0.0 && along.is_finite()).then(|| (Up::nearest(sum), along > CLEAR))
    }
}
