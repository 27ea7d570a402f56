//! Where the left and the front of a captured person are.

use datasets_spec::Skeleton;
use glam::DVec3;

use crate::markers::worn::{Frames, LabelledMarkers};

/// Mean of the markers of a frame that are seen and kept.
pub(super) fn mean(points: &[Option<DVec3>], keep: impl Fn(usize) -> bool) -> Option<DVec3> {
    let seen: Vec<DVec3> = (0..points.len())
        .filter(|marker| keep(*marker))
        .filter_map(|marker| points[marker])
        .collect();
    (!seen.is_empty()).then(|| seen.iter().sum::<DVec3>() / seen.len() as f64)
}

/// The horizontal direction from the right of the person to the left.
pub(super) fn across(
    worn: &LabelledMarkers,
    skeleton: &Skeleton,
    points: &[Option<DVec3>],
) -> Option<DVec3> {
    // Distance of a marker to the left of the middle in the rest pose, in metres; 0 for those of the arms, which are left out.
    let side = |marker: usize| match worn.joints[marker] {
        16..=21 => 0.0,
        joint => (skeleton.rest(joint) + worn.offsets[marker]).x,
    };
    let left = mean(points, |marker| side(marker) > 0.03)?;
    let right = mean(points, |marker| side(marker) < -0.03)?;
    (left - right).with_y(0.0).try_normalize()
}

/// Whether the markers at the front of pelvis, head and feet lie behind the other markers of the same part.
pub(super) fn front_is_behind(
    worn: &LabelledMarkers,
    skeleton: &Skeleton,
    frames: &Frames,
    usable: &[usize],
) -> bool {
    const PARTS: [&[usize]; 4] = [&[0], &[15], &[7, 10], &[8, 11]];
    let mut ahead = 0.0;
    for &frame in usable {
        let points = &frames.points[frame];
        let Some(across) = across(worn, skeleton, points) else {
            continue;
        };
        let front = across.cross(DVec3::Y);
        for part in PARTS {
            // How far in front each marker is: on the body of the set, and in the capture.
            let seen: Vec<(f64, f64)> = (0..points.len())
                .filter(|marker| part.contains(&worn.joints[*marker]))
                .filter_map(|marker| {
                    let placed = skeleton.rest(worn.joints[marker]) + worn.offsets[marker];
                    Some((placed.z, points[marker]?.dot(front)))
                })
                .collect();
            let sum: f64 = seen.iter().map(|(placed, _)| placed).sum();
            let middle = sum / seen.len().max(1) as f64;
            let along = seen.iter().map(|(placed, found)| (placed - middle) * found);
            ahead += along.sum::<f64>();
        }
    }
    ahead < 0.0
}
