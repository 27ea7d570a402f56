//! Motions that are equal or nearly so, apart from their position and heading.

use datasets_spec::{Motion, Skeleton};
use glam::{DMat3, DQuat, DVec3};
use kinematics::rotation::yaw;

/// Maximum mean distance of body joints, in metres, between nearly equal motions. Conversion to another format and back
/// moves joints by less; two takes of one person differ by more.
pub const TOLERANCE_M: f64 = 0.005;

const JOINTS: usize = 22;

const FRAMES: usize = 8;

/// The body joints of a motion in eight frames, relative to its first position on the ground and its first heading.
#[derive(Clone, Debug, PartialEq)]
pub struct Sketch {
    num_frames: usize,
    /// `[8, 22]`, in metres.
    points: Vec<[f32; 3]>,
}

impl Sketch {
    /// Sketches a motion.
    pub fn of(motion: &Motion, skeleton: &Skeleton) -> Self {
        let last = motion.len().saturating_sub(1);
        let frames = (0..FRAMES).map(|index| index * last / (FRAMES - 1));
        let points: Vec<[DVec3; JOINTS]> = frames
            .flat_map(|frame| skeleton.points_of_frames(motion, frame..frame + 1))
            .collect();
        let first = motion.pose(0);
        let heading = yaw(DMat3::from_quat(first.rotations[0]));
        let turn = DQuat::from_rotation_y(-heading);
        let start = points.first().map_or(DVec3::ZERO, |points| points[0]);
        let ground = DVec3::new(start.x, 0.0, start.z);
        let points: Vec<[f32; 3]> = points
            .iter()
            .flatten()
            .map(|point| (turn * (*point - ground)).as_vec3().to_array())
            .collect();
        Self {
            num_frames: motion.len(),
            points,
        }
    }

    /// Mean of all points, in metres. The centres of two motions are no further apart than their points on average.
    pub fn centre(&self) -> [f32; 3] {
        let count = self.points.len().max(1) as f64;
        [0, 1, 2].map(|axis| {
            let sum: f64 = self.points.iter().map(|point| f64::from(point[axis])).sum();
            (sum / count) as f32
        })
    }

    /// Mean distance of the joints, in metres; `None` for motions whose lengths differ by more than a frame.
    pub fn distance(&self, other: &Self) -> Option<f64> {
        if self.num_frames.abs_diff(other.num_frames) > 1 {
            return None;
        }
        let pairs = self.points.iter().zip(&other.points);
        let sum: f64 = pairs
            .map(|(a, b)| {
                let difference = [0, 1, 2].map(|axis| f64::from(a[axis] - b[axis]));
                DVec3::from_array(difference).length()
            })
            .sum();
        Some(sum / self.points.len().max(1) as f64)
    }
}

/// Pairs of nearly equal motions of different groups: their indices in `sketches`, and their distance in metres.
pub fn near_pairs<G: PartialEq>(sketches: &[(G, Sketch)]) -> Vec<(usize, usize, f64)> {
    // The mean of all coordinates differs by no more than the mean distance of points.
    let means = sketches
        .iter()
        .map(|(_, sketch)| sketch.centre().iter().sum::<f32>() / 3.0);
    let mut order: Vec<(usize, f32)> = means.enumerate().collect();
    order.sort_by(|a, b| a.1.total_cmp(&b.1));
    let mut found = Vec::new();
    for (place, &(a, first)) in order.iter().enumerate() {
        for &(b, second) in &order[place + 1..] {
            if f64::from(second - first) > TOLERANCE_M {
                break;
            }
            if sketches[a].0 == sketches[b].0 {
                continue;
            }
            let distance = sketches[a].1.distance(&sketches[b].1);
            if let Some(distance) = distance.filter(|distance| *distance <= TOLERANCE_M) {
                found.push((a.min(b), a.max(b), distance));
            }
        }
    }
    found.sort_by_key(|&(a, b, _)| (a, b));
    found
}

#[cfg(test)]
mod tests {
    use datasets_spec::{Fps, Pose};

    use super::*;

    fn walk(speed: f64, turn: f64, place: DVec3, frames: usize) -> Sketch {
        let poses: Vec<Pose> = (0..frames)
            .map(|frame| {
                let time = frame as f64 / 20.0;
                let mut pose = Pose::REST;
                let swing = DQuat::from_rotation_x(0.5 * (4.0 * time).sin());
                pose.rotations[1] = swing;
                pose.rotations[2] = swing.inverse();
                let turn = DQuat::from_rotation_y(turn);
                pose.rotations[0] = turn;
                pose.transl = place + turn * DVec3::new(0.0, 1.0, speed * time);
                pose
            })
            .collect();
        let motion = Motion::from_poses(Fps::STORE, &poses).expect("valid");
        Sketch::of(&motion, &Skeleton::smplx_neutral())
    }

    #[test]
    fn place_and_heading_do_not_matter_and_speed_does() {
        let sketch = walk(1.0, 0.0, DVec3::ZERO, 60);
        let moved = walk(1.0, 2.0, DVec3::new(3.0, 0.0, -1.0), 60);
        let longer = walk(1.0, 0.0, DVec3::ZERO, 80);
        let faster = walk(1.1, 0.0, DVec3::ZERO, 60);
        let close = walk(1.001, 0.0, DVec3::ZERO, 60);
        assert!(sketch.distance(&moved).expect("equal lengths") < 1e-5);
        assert_eq!(sketch.distance(&longer), None);
        // On average, half of the extra distance that 0.1 m/s makes in 59 frames.
        let expected = 0.1 * 59.0 / 20.0 / 2.0;
        assert!((sketch.distance(&faster).expect("equal lengths") - expected).abs() < 0.01);
        let all = [sketch, moved, longer, faster, close].map(Some);
        let groups = [0, 1, 1, 1, 0];
        let all: Vec<(i32, Sketch)> = groups.into_iter().zip(all.into_iter().flatten()).collect();
        let pairs: Vec<(usize, usize)> = near_pairs(&all).iter().map(|&(a, b, _)| (a, b)).collect();
        assert_eq!(pairs, [(0, 1), (1, 4)]);
    }
}
