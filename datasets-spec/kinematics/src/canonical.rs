//! Canonical segments: cutting a motion into windows that start at the origin facing +z, and
//! stitching generated windows back into one motion.

use glam::{DMat3, DQuat, DVec3};

use crate::pose::{KeypointFrame, Pose};
use crate::rotation;
use crate::skeleton::Skeleton;

/// Frames of a window, the fixed ones included (paper Sec. 5.1; released configuration).
pub const WINDOW_FRAMES: usize = 16;
/// Leading frames of a window that are given, not generated.
pub const FIXED_FRAMES: usize = 2;
/// Frames a window adds to the motion.
pub const WINDOW_ADVANCE: usize = WINDOW_FRAMES - FIXED_FRAMES;

/// A rotation about the vertical and a shift on the ground that place a canonical segment in the world. The height does
/// not change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundTransform {
    /// Rotation about +y in radians.
    pub yaw_rad: f64,
    /// Shift along x in metres, after the rotation.
    pub x: f64,
    /// Shift along z in metres, after the rotation.
    pub z: f64,
}

impl GroundTransform {
    /// Leaves everything in place.
    pub const IDENTITY: GroundTransform = GroundTransform {
        yaw_rad: 0.0,
        x: 0.0,
        z: 0.0,
    };

    /// Rotates by `yaw_rad`, then shifts by the x and z of `shift`.
    fn new(yaw_rad: f64, shift: DVec3) -> Self {
        Self {
            yaw_rad,
            x: shift.x,
            z: shift.z,
        }
    }

    /// Maps a point.
    pub fn apply(&self, point: DVec3) -> DVec3 {
        self.mapping()(point)
    }

    /// [`GroundTransform::apply`] for many points, with the turn computed once.
    pub fn mapping(&self) -> impl Fn(DVec3) -> DVec3 + use<> {
        let turn = DQuat::from_rotation_y(self.yaw_rad);
        let shift = DVec3::new(self.x, 0.0, self.z);
        move |point| turn * point + shift
    }

    /// The transform that undoes this one.
    pub fn inverse(&self) -> Self {
        let shift = DQuat::from_rotation_y(-self.yaw_rad) * DVec3::new(self.x, 0.0, self.z);
        Self::new(-self.yaw_rad, -shift)
    }
}

/// Point of the first frame that canonicalisation moves above the origin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Anchor {
    /// The pelvis (paper App. B.2; preset `paper`).
    Pelvis,
    /// The translation parameter, which leaves the pelvis at its rest x and z (released code;
    /// preset `official`).
    Translation,
}

impl Anchor {
    /// Horizontal position of the pelvis in the first frame of a canonical segment; `y` is 0.
    pub fn pelvis(self, skeleton: &Skeleton) -> DVec3 {
        match self {
            Self::Pelvis => DVec3::ZERO,
            Self::Translation => skeleton.rest(0).with_y(0.0),
        }
    }
}

/// The ground transform from a canonical segment to its motion; `first` is the frame of the motion with which the
/// segment begins. It is exact for both anchors, unlike [`world_from_segment`].
pub fn motion_from_segment(first: &Pose, anchor: Anchor, skeleton: &Skeleton) -> GroundTransform {
    let yaw_rad = rotation::yaw(DMat3::from_quat(first.rotations[0]));
    let pelvis = first.transl + skeleton.rest(0);
    placed(yaw_rad, pelvis, anchor.pelvis(skeleton))
}

/// The ground transform with this yaw that carries `from` to the horizontal position of `onto`.
fn placed(yaw_rad: f64, onto: DVec3, from: DVec3) -> GroundTransform {
    GroundTransform::new(yaw_rad, onto - DQuat::from_rotation_y(yaw_rad) * from)
}

/// The ground transform from a canonical segment to its motion by the released rule, which displaces the segment with
/// [`Anchor::Translation`]. `first` is as in [`motion_from_segment`].
pub fn world_from_segment(first: &Pose, anchor: Anchor, skeleton: &Skeleton) -> GroundTransform {
    let origin = match anchor {
        Anchor::Pelvis => first.transl + skeleton.rest(0),
        Anchor::Translation => first.transl,
    };
    GroundTransform::new(rotation::yaw(DMat3::from_quat(first.rotations[0])), origin)
}

/// Moves a segment so that its first frame stands at the origin facing +z; heights stay. Returns the
/// [`world_from_segment`] of the first frame, or `None` for an empty segment.
///
/// # Source
/// Paper App. B.2 ([`Anchor::Pelvis`]); the released preprocessing ([`Anchor::Translation`]).
pub fn canonicalise(
    segment: &mut [Pose],
    anchor: Anchor,
    skeleton: &Skeleton,
) -> Option<GroundTransform> {
    let placement = world_from_segment(segment.first()?, anchor, skeleton);
    let turn = DQuat::from_rotation_y(-placement.yaw_rad);
    let shift = DVec3::new(placement.x, 0.0, placement.z);
    // The body rotates about its pelvis, at `transl + rest(0)`, so a turn of the whole body must act on that point. The
    // released code lets it act on `transl`.
    let pivot = match anchor {
        Anchor::Pelvis => skeleton.rest(0),
        Anchor::Translation => DVec3::ZERO,
    };
    for pose in segment {
        pose.transl = turn * (pose.transl + pivot - shift) - pivot;
        pose.rotations[0] = turn * pose.rotations[0];
    }
    Some(placement)
}

/// First frames of the whole windows in a motion, `advance` frames apart (at least 1). Empty if the motion is shorter
/// than a window.
pub fn window_starts(num_frames: usize, window: usize, advance: usize) -> Vec<usize> {
    if num_frames < window {
        return Vec::new();
    }
    (0..=num_frames - window).step_by(advance.max(1)).collect()
}

/// The rotation and shift that best carry the triangle `from` onto `onto` in the least-squares
/// sense: `onto_i = R from_i + t`. Reflections are never returned.
///
/// # Source
/// Horn 1987: the rotation is the eigenvector of the largest eigenvalue of a symmetric 4x4 matrix
/// built from the cross-covariance, which gives the same answer as Kabsch's SVD and needs no
/// special case for a mirrored triangle.
pub fn kabsch(from: &[DVec3; 3], onto: &[DVec3; 3]) -> (DMat3, DVec3) {
    kabsch_near(from, onto, DMat3::IDENTITY, 0.0)
}

/// As [`kabsch`], but regularised towards the rotation `near`: the least squares also carry the three unit vectors onto
/// their images under `near`, with `weight` in m^2. This keeps the orientation of small triangles of noisy points.
pub fn kabsch_near(
    from: &[DVec3; 3],
    onto: &[DVec3; 3],
    near: DMat3,
    weight: f64,
) -> (DMat3, DVec3) {
    let from_centre = (from[0] + from[1] + from[2]) / 3.0;
    let onto_centre = (onto[0] + onto[1] + onto[2]) / 3.0;
    let mut s = [[0.0f64; 3]; 3];
    for (a, b) in from.iter().zip(onto) {
        let (a, b) = ((*a - from_centre).to_array(), (*b - onto_centre).to_array());
        for (row, a) in s.iter_mut().zip(a) {
            for (cell, b) in row.iter_mut().zip(b) {
                *cell += a * b;
            }
        }
    }
    for (row, near) in s.iter_mut().zip([near.x_axis, near.y_axis, near.z_axis]) {
        for (cell, near) in row.iter_mut().zip(near.to_array()) {
            *cell += weight * near;
        }
    }
    let [[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]] = s;
    let q = largest_eigenvector([
        [xx + yy + zz, yz - zy, zx - xz, xy - yx],
        [yz - zy, xx - yy - zz, xy + yx, zx + xz],
        [zx - xz, xy + yx, yy - xx - zz, yz + zy],
        [xy - yx, zx + xz, yz + zy, zz - xx - yy],
    ]);
    let rotation = DMat3::from_quat(DQuat::from_xyzw(q[1], q[2], q[3], q[0]).normalize());
    (rotation, onto_centre - rotation * from_centre)
}

/// The unit eigenvector of the largest eigenvalue of a symmetric matrix, by cyclic Jacobi
/// rotations, which converge quadratically: a 4x4 matrix needs five or six sweeps.
fn largest_eigenvector(mut a: [[f64; 4]; 4]) -> [f64; 4] {
    let mut v = [[0.0f64; 4]; 4];
    for (i, row) in v.iter_mut().enumerate() {
        row[i] = 1.0;
    }
    let scale: f64 = a.iter().flatten().map(|x| x * x).sum();
    for _sweep in 0..30 {
        let off: f64 = (0..4)
            .flat_map(|i| (i + 1..4).map(move |j| (i, j)))
            .map(|(i, j)| a[i][j] * a[i][j])
            .sum();
        if off <= 1e-34 * scale {
            break;
        }
        for p in 0..4 {
            for q in p + 1..4 {
                if a[p][q] == 0.0 {
                    continue;
                }
                let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
                let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
                let t = if theta == 0.0 { 1.0 } else { t };
                let c = 1.0 / (t * t + 1.0).sqrt();
                let s = t * c;
                for row in &mut a {
                    (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
                }
                let (above, below) = a.split_at_mut(q);
                for (x, y) in above[p].iter_mut().zip(&mut below[0]) {
                    (*x, *y) = (c * *x - s * *y, s * *x + c * *y);
                }
                for row in &mut v {
                    (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
                }
            }
        }
    }
    let best = (0..4).fold(0, |best, i| if a[i][i] > a[best][best] { i } else { best });
    [v[0][best], v[1][best], v[2][best], v[3][best]]
}

/// Position and heading of a body, from its pelvis and hips: the rotation about the vertical and the ground position
/// that carry the rest triangle onto the three points.
///
/// # Source
/// Released inference code (`algorithms` section 8, step 4): Kabsch alignment of the rest triangle; only the heading
/// and the ground position are kept. The triangle must come from the skeleton in use: the triangle of another body
/// biases the heading in every window.
pub fn ground_transform_of(points: &[DVec3; 3], rest_triangle: &[DVec3; 3]) -> GroundTransform {
    let (rotation, shift) = kabsch(rest_triangle, points);
    GroundTransform::new(rotation::yaw(rotation), shift)
}

/// Joins generated windows into one motion, and gives the coordinates of the next window.
///
/// Each window but the first repeats the last two frames of the motion so far. These copies are dropped, and the
/// second-to-last frame of the motion places the window.
///
/// # Source
/// Paper App. B.2; released inference code (`algorithms` section 8).
#[derive(Clone, Debug)]
pub struct Stitcher {
    rest_triangle: [DVec3; 3],
    /// Position of the pelvis in a window's first frame.
    pelvis: DVec3,
    world_from_window: GroundTransform,
    frames: Vec<KeypointFrame>,
}

impl Stitcher {
    /// An empty motion; its first window is placed by `world_from_window`.
    pub fn new(rest_triangle: [DVec3; 3], world_from_window: GroundTransform) -> Self {
        Self {
            rest_triangle,
            pelvis: DVec3::ZERO,
            world_from_window,
            frames: Vec::new(),
        }
    }

    /// Sets where the pelvis is in the first frame of a window, in the window's coordinates ([`Anchor::pelvis`]). The
    /// default is the origin, which the released code uses in all windows but the first. With [`Anchor::Translation`]
    /// its network was trained on another position.
    #[must_use]
    pub fn anchored(mut self, pelvis: DVec3) -> Self {
        self.pelvis = pelvis;
        self
    }

    /// Keeps the first `num_frames` frames, so that the next window begins two frames before their end, and returns the
    /// frames after them. If fewer than two frames are kept, the next window has no fixed frames.
    pub fn rewind(&mut self, num_frames: usize) -> Vec<KeypointFrame> {
        if num_frames >= self.frames.len() {
            return Vec::new();
        }
        let removed = self.frames.split_off(num_frames);
        self.place_next();
        removed
    }

    /// Appends a window given in its own canonical coordinates, `[W, 28]`.
    pub fn push(&mut self, window: &[KeypointFrame]) {
        self.push_over(window, &[]);
    }

    /// Appends a window. Its first new frames are blended with `former`, the frames that [`Stitcher::rewind`] returned,
    /// `[F, 28]` in world coordinates. In frame `i` of `F`, counted from 1, the window has weight `i / (F + 1)`.
    pub fn push_over(&mut self, window: &[KeypointFrame], former: &[KeypointFrame]) {
        let new = if self.frames.is_empty() {
            window
        } else {
            window.get(FIXED_FRAMES..).unwrap_or(&[])
        };
        let former_frames = former.len();
        let place = self.world_from_window.mapping();
        for (index, frame) in new.iter().enumerate() {
            let mut placed = frame.map(&place);
            if let Some(former) = former.get(index) {
                let share = (index + 1) as f64 / (former_frames + 1) as f64;
                for (point, before) in placed.iter_mut().zip(former) {
                    *point = before.lerp(*point, share);
                }
            }
            self.frames.push(placed);
        }
        self.place_next();
    }

    /// Places the next window by the second-to-last frame.
    fn place_next(&mut self) {
        if let Some(anchor) = self.frames.len().checked_sub(FIXED_FRAMES) {
            let frame = &self.frames[anchor];
            let GroundTransform { yaw_rad, x, z } =
                ground_transform_of(&[frame[0], frame[1], frame[2]], &self.rest_triangle);
            self.world_from_window = placed(yaw_rad, DVec3::new(x, 0.0, z), self.pelvis);
        }
    }

    /// The last two frames in the coordinates of the next window: its fixed frames. `None` if there are fewer than two.
    pub fn next_fixed(&self) -> Option<[KeypointFrame; FIXED_FRAMES]> {
        let window_from_world = self.world_from_window.inverse().mapping();
        let last = self.frames.last_chunk::<FIXED_FRAMES>()?;
        Some(last.map(|frame| frame.map(&window_from_world)))
    }

    /// The motion so far, `[T, 28]`.
    pub fn frames(&self) -> &[KeypointFrame] {
        &self.frames
    }

    /// The whole motion.
    pub fn into_frames(self) -> Vec<KeypointFrame> {
        self.frames
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::fit::tests::vector;
    use crate::rotation::from_axis_angle;

    proptest! {
        #[test]
        fn placing_a_canonical_segment_gives_the_motion_back(
            roots in prop::collection::vec((vector(3.0), vector(2.0)), 1..8),
            official in any::<bool>(),
        ) {
            let skeleton = Skeleton::smplx_neutral();
            let anchor = if official { Anchor::Translation } else { Anchor::Pelvis };
            let motion: Vec<Pose> = roots
                .into_iter()
                .map(|(transl, root)| {
                    let mut pose = Pose { transl, ..Pose::REST };
                    pose.rotations[0] = from_axis_angle(root);
                    pose
                })
                .collect();
            let mut segment = motion.clone();
            let placement = canonicalise(&mut segment, anchor, &skeleton).expect("not empty");
            let first = world_from_segment(&segment[0], anchor, &skeleton);
            prop_assert!(first.yaw_rad.abs() < 1e-9 && first.x.abs() < 1e-12 && first.z.abs() < 1e-12);
            // The placement is exact for the pelvis anchor. The released code rotates `transl` but not the rest
            // position of the pelvis, which displaces the body by up to twice the distance of the pelvis from the axis.
            let slack = if official { 2.0 * skeleton.rest(0).with_y(0.0).length() } else { 1e-9 };
            let exact = motion_from_segment(&motion[0], anchor, &skeleton);
            for (world, canonical) in motion.iter().zip(&segment) {
                let world = skeleton.keypoints(world);
                for (a, b) in world.iter().zip(skeleton.keypoints(canonical)) {
                    prop_assert!((*a - exact.apply(b)).length() <= 1e-9);
                    prop_assert!((*a - placement.apply(b)).length() <= slack + 1e-9);
                }
            }
        }

        #[test]
        fn kabsch_recovers_a_known_placement(turn in vector(3.0), shift in vector(5.0)) {
            let triangle = Skeleton::smplx_neutral().rest_triangle();
            let q = from_axis_angle(turn);
            let moved = triangle.map(|p| q * p + shift);
            let (rotation, t) = kabsch(&triangle, &moved);
            prop_assert!(rotation.abs_diff_eq(DMat3::from_quat(q), 1e-9));
            prop_assert!((t - shift).length() < 1e-9);
        }

        #[test]
        fn ground_transforms_invert(yaw_rad in -7.0..7.0f64, shift in vector(5.0), p in vector(3.0)) {
            let transform = GroundTransform { yaw_rad, x: shift.x, z: shift.z };
            prop_assert!((transform.inverse().apply(transform.apply(p)) - p).length() < 1e-12);
        }
    }

    #[test]
    fn windows_advance_by_what_they_add() {
        let starts = |frames| window_starts(frames, WINDOW_FRAMES, WINDOW_ADVANCE);
        assert_eq!(starts(44), [0, 14, 28]);
        assert_eq!(starts(43), [0, 14]);
        assert!(starts(15).is_empty());
    }
}
