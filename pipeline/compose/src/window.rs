//! The composer's inner loop: from two runs of frames to two windows of model units.
//!
//! A frame is kept as its 28 keypoints and 22 local rotations, ready to use. Points that a blend does
//! not touch are copied from their motion. Only the others need forward kinematics, which processes 16 frames
//! at once with one array per component, in loops that the compiler vectorises. They compute in `f32`:
//! over a chain of eight joints the error is a micrometre, a thousandth of the model's resolution.

use std::f32::consts::FRAC_PI_2;

use datasets_spec::BlendMask;
use glam::{DMat3, Quat};
use kinematics::canonical::Anchor;
use kinematics::motion::StoredFrame;
use kinematics::normalise::{FRAME_WIDTH, Normalizer};
use kinematics::rotation;
use kinematics::simd::blocks::{Quaternions, Vectors, lane as lane_of, set};
use kinematics::simd::lanes::{self, Kernel, LANES};
use kinematics::skeleton::{
    KEYPOINT_JOINTS, MIRRORED_KEYPOINTS, NUM_BODY_JOINTS, NUM_KEYPOINTS, Skeleton, parent_of,
};
use kinematics::{FrameParts, FrameSink};

use super::SlerpRule;

const QUAT: usize = 4;
/// Padding before and after the points of a frame, so that every number has neighbours two indices away
/// ([`Placement`]).
const MARGIN: usize = 2;
type PaddedPoints = [f32; FRAME_WIDTH + 2 * MARGIN];

type Points = Vectors<f32>;
type Quats = Quaternions<f32>;

/// A frame: world positions `[28, 3]` in metres and local rotations `[22]` as x, y, z, w.
#[derive(Clone, Debug)]
pub(super) struct Frame {
    points: PaddedPoints,
    rotations: [[f32; QUAT]; NUM_BODY_JOINTS],
}

impl Frame {
    const EMPTY: Self = Self {
        points: [0.0; FRAME_WIDTH + 2 * MARGIN],
        rotations: [[0.0; QUAT]; NUM_BODY_JOINTS],
    };

    /// Computes the requested parts of stored frames. Other parts of `frames` keep their values.
    pub(super) fn prepare(
        rows: &[StoredFrame],
        parts: FrameParts,
        skeleton: &Skeleton,
        frames: &mut Vec<Self>,
    ) {
        frames.resize(rows.len(), Self::EMPTY);
        skeleton.place_rows(rows, parts, frames);
    }
}

impl FrameSink for Frame {
    #[inline(always)]
    fn set_rotation(&mut self, joint: usize, quaternion: [f32; QUAT]) {
        self.rotations[joint] = quaternion;
    }

    #[inline(always)]
    fn set_point(&mut self, slot: usize, point: [f32; 3]) {
        self.points[place(slot)..place(slot) + 3].copy_from_slice(&point);
    }
}

/// Index of a point's first number among the padded points.
#[inline(always)]
fn place(slot: usize) -> usize {
    MARGIN + 3 * slot
}

/// A joint's rotation in up to 16 frames; the last frame fills the rest.
#[inline(always)]
fn rotations(frames: &[Frame], joint: usize) -> Quats {
    let mut out = [[0.0; LANES]; QUAT];
    for lane in 0..LANES {
        let frame = &frames[lane.min(frames.len() - 1)];
        set(&mut out, lane, frame.rotations[joint]);
    }
    out
}

/// A point in up to 16 frames; the last frame fills the rest.
#[inline(always)]
fn points(frames: &[Frame], slot: usize) -> Points {
    let mut out = [[0.0; LANES]; 3];
    for lane in 0..LANES {
        let point = &frames[lane.min(frames.len() - 1)].points[place(slot)..place(slot) + 3];
        for axis in 0..3 {
            out[axis][lane] = point[axis];
        }
    }
    out
}

/// Origin of a blended joint's rotation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Origin {
    Source,
    Target,
    Both,
}

/// Points to compute for a blend with a mask. A point keeps its position in the motion that owns the root if the
/// rotations of all its ancestors come from that motion; the other points need forward kinematics.
#[derive(Clone, Debug)]
pub(super) struct BlendPlan {
    origins: [Origin; NUM_BODY_JOINTS],
    /// The motion that owns root position and orientation.
    owner: Origin,
    /// Joints whose global rotation is needed, parents first.
    joints: Vec<usize>,
    /// Points that are computed, parents first.
    points: Vec<usize>,
    /// Points of the owner that are parents of computed points.
    anchors: Vec<usize>,
    slerp: SlerpRule,
}

impl BlendPlan {
    pub(super) fn new(mask: BlendMask, slerp: SlerpRule) -> Self {
        let origins: [Origin; NUM_BODY_JOINTS] = std::array::from_fn(|joint| {
            if mask.hard().contains(joint) {
                Origin::Target
            } else if mask.soft().contains(joint) {
                Origin::Both
            } else {
                Origin::Source
            }
        });
        let owner = if mask.moves_root() {
            Origin::Target
        } else {
            Origin::Source
        };
        let mut kept = origins.map(|origin| origin == owner);
        for joint in 1..NUM_BODY_JOINTS {
            kept[joint] &= kept[parent_of(joint)];
        }
        let points: Vec<usize> = (1..NUM_KEYPOINTS)
            .filter(|&slot| !kept[parent_of(slot)])
            .collect();
        let mut anchors: Vec<usize> = points
            .iter()
            .map(|&slot| parent_of(slot))
            .filter(|parent| !points.contains(parent))
            .collect();
        anchors.dedup();
        let mut needed = [false; NUM_BODY_JOINTS];
        for &slot in &points {
            let mut joint = parent_of(slot);
            while !needed[joint] {
                needed[joint] = true;
                joint = parent_of(joint);
            }
        }
        Self {
            origins,
            owner,
            joints: (0..NUM_BODY_JOINTS).filter(|&j| needed[j]).collect(),
            points,
            anchors,
            slerp,
        }
    }

    /// The parts of a frame that the blend reads of the source or the target.
    pub(super) fn parts_of(&self, motion: Origin) -> FrameParts {
        let mut rotations = [false; NUM_BODY_JOINTS];
        // The window is placed by the root of its first frame.
        for &joint in self.joints.iter().chain(&[0]) {
            rotations[joint] = [motion, Origin::Both].contains(&self.origins[joint]);
        }
        rotations[0] |= self.owner == motion;
        FrameParts {
            rotations,
            points: self.owner == motion,
        }
    }

    /// The rotations of a soft joint.
    #[inline(always)]
    fn mixed(&self, from: &Quats, to: &Quats, alpha: f32) -> Quats {
        match self.slerp {
            SlerpRule::Exact => slerp(from, to, alpha),
            SlerpRule::Official => official(from, to, alpha),
        }
    }
}

/// The parts of a frame that [`Composer::original`] reads.
pub(super) const PARTS_OF_ORIGINAL: FrameParts = {
    let mut rotations = [false; NUM_BODY_JOINTS];
    rotations[0] = true;
    FrameParts {
        rotations,
        points: true,
    }
};

/// The parts that `a`, `b` or both name.
pub(super) fn both_parts(a: FrameParts, b: FrameParts) -> FrameParts {
    FrameParts {
        rotations: std::array::from_fn(|joint| a.rotations[joint] || b.rotations[joint]),
        points: a.points || b.points,
    }
}

/// Turns frames into windows of model units.
#[derive(Clone, Debug)]
pub(super) struct Composer {
    /// Rest position of each point relative to its parent.
    offsets: [[f32; 3]; NUM_KEYPOINTS],
    /// Position of the first pelvis relative to the anchor, x and z, in metres.
    pelvis_at: [f64; 2],
    /// Model units per metre and value at 0 m, per axis.
    scale: [f64; 3],
    bias: [f64; 3],
}

impl Composer {
    pub(super) fn new(skeleton: &Skeleton, anchor: Anchor, normalizer: &Normalizer) -> Self {
        let scale = std::array::from_fn::<f64, 3, _>(|axis| {
            2.0 / (normalizer.max[axis] - normalizer.min[axis])
        });
        Self {
            offsets: KEYPOINT_JOINTS.map(|joint| skeleton.offset(joint).as_vec3().to_array()),
            pelvis_at: match anchor {
                Anchor::Pelvis => [0.0, 0.0],
                Anchor::Translation => [skeleton.rest(0).x, skeleton.rest(0).z],
            },
            scale,
            bias: std::array::from_fn(|axis| -1.0 - normalizer.min[axis] * scale[axis]),
        }
    }

    /// Writes the canonical, normalised keypoints of frames, `[W, 84]`.
    pub(super) fn original(&self, frames: &[Frame], out: &mut [f32]) {
        lanes::dispatch(Compose {
            composer: self,
            source: frames,
            blend: None,
            out,
        });
    }

    /// Writes the canonical, normalised keypoints of a blend, `[W, 84]`. The window is canonicalised by
    /// its own first frame, whichever motion owns the root.
    pub(super) fn blended(
        &self,
        source: &[Frame],
        target: &[Frame],
        plan: &BlendPlan,
        alpha: f32,
        out: &mut [f32],
    ) {
        lanes::dispatch(Compose {
            composer: self,
            source,
            blend: Some((target, plan, alpha)),
            out,
        });
    }

    /// Mirrors a window in place, `[W, 84]`: left and right exchange their points.
    ///
    /// The rest joints of a body are not quite symmetric, so that bones of the mirrored window are up to a few
    /// millimetres longer or shorter than those of the body.
    pub(super) fn mirror(&self, window: &mut [f32]) {
        // The bias is the model's number for 0 m.
        let middle = (2.0 * self.bias[0]) as f32;
        for frame in window.as_chunks_mut::<FRAME_WIDTH>().0 {
            for number in (0..FRAME_WIDTH).step_by(3) {
                frame[number] = middle - frame[number];
            }
            for (slot, other) in MIRRORED_KEYPOINTS.into_iter().enumerate() {
                if slot < other {
                    for axis in 0..3 {
                        frame.swap(3 * slot + axis, 3 * other + axis);
                    }
                }
            }
        }
    }

    #[inline(always)]
    fn write_original(&self, frames: &[Frame], out: &mut [f32]) {
        let first = &frames[0];
        let placement = self.placement(&first.points, first.rotations[0]);
        for (frame, out) in frames.iter().zip(out.as_chunks_mut::<FRAME_WIDTH>().0) {
            placement.apply(&frame.points, out);
        }
    }

    #[inline(always)]
    fn write_blended(
        &self,
        source: &[Frame],
        target: &[Frame],
        plan: &BlendPlan,
        alpha: f32,
        out: &mut [f32],
    ) {
        let owner = match plan.owner {
            Origin::Target => target,
            Origin::Source | Origin::Both => source,
        };
        let root = match plan.origins[0] {
            Origin::Both => plan
                .mixed(&rotations(source, 0), &rotations(target, 0), alpha)
                .map(|component| component[0]),
            Origin::Source | Origin::Target => owner[0].rotations[0],
        };
        let placement = self.placement(&owner[0].points, root);
        let blocks = source
            .chunks(LANES)
            .zip(target.chunks(LANES))
            .zip(owner.chunks(LANES));
        for (((source, target), owner), out) in blocks.zip(out.chunks_mut(LANES * FRAME_WIDTH)) {
            let moved = self.moved_points(source, target, owner, plan, alpha);
            let frames = out.as_chunks_mut::<FRAME_WIDTH>().0;
            for (lane, (owner, out)) in owner.iter().zip(frames).enumerate() {
                let mut frame = owner.points;
                for &slot in &plan.points {
                    for axis in 0..3 {
                        frame[place(slot) + axis] = moved[slot][axis][lane];
                    }
                }
                placement.apply(&frame, out);
            }
        }
    }

    /// Forward kinematics of up to 16 frames for the points of the plan.
    #[inline(always)]
    fn moved_points(
        &self,
        source: &[Frame],
        target: &[Frame],
        owner: &[Frame],
        plan: &BlendPlan,
        alpha: f32,
    ) -> [Points; NUM_KEYPOINTS] {
        let mut moved = [[[0.0; LANES]; 3]; NUM_KEYPOINTS];
        let mut global = [[[0.0; LANES]; QUAT]; NUM_BODY_JOINTS];
        for &slot in &plan.anchors {
            moved[slot] = points(owner, slot);
        }
        for &joint in &plan.joints {
            let local = match plan.origins[joint] {
                Origin::Source => rotations(source, joint),
                Origin::Target => rotations(target, joint),
                Origin::Both => {
                    plan.mixed(&rotations(source, joint), &rotations(target, joint), alpha)
                }
            };
            global[joint] = if joint == 0 {
                local
            } else {
                product(&global[parent_of(joint)], &local)
            };
        }
        for &slot in &plan.points {
            let parent = parent_of(slot);
            moved[slot] = attached(&moved[parent], &global[parent], self.offsets[slot]);
        }
        moved
    }

    /// The placement of a window by the points and the root rotation of its first frame.
    #[inline(always)]
    fn placement(&self, points: &PaddedPoints, root: [f32; QUAT]) -> Placement {
        let root = Quat::from_array(root).as_dquat().normalize();
        let yaw = rotation::yaw(DMat3::from_quat(root));
        let (sine, cosine) = yaw.sin_cos();
        let (x, z) = (f64::from(points[place(0)]), f64::from(points[place(0) + 2]));
        let shift = [
            self.pelvis_at[0] - (cosine * x - sine * z),
            0.0,
            self.pelvis_at[1] - (sine * x + cosine * z),
        ];
        let own = [cosine, 1.0, cosine];
        let other = [-sine, 0.0, sine];
        let mut placement = Placement {
            own: [0.0; FRAME_WIDTH],
            ahead: [0.0; FRAME_WIDTH],
            behind: [0.0; FRAME_WIDTH],
            bias: [0.0; FRAME_WIDTH],
        };
        for i in 0..FRAME_WIDTH {
            let axis = i % 3;
            placement.own[i] = (own[axis] * self.scale[axis]) as f32;
            placement.bias[i] = (shift[axis] * self.scale[axis] + self.bias[axis]) as f32;
            let other = (other[axis] * self.scale[axis]) as f32;
            match axis {
                0 => placement.ahead[i] = other,
                2 => placement.behind[i] = other,
                _ => {}
            }
        }
        placement
    }
}

/// A window to write: from plain frames, or from a blend with other frames.
struct Compose<'a> {
    composer: &'a Composer,
    source: &'a [Frame],
    blend: Option<(&'a [Frame], &'a BlendPlan, f32)>,
    out: &'a mut [f32],
}

impl Kernel for Compose<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        match self.blend {
            None => self.composer.write_original(self.source, self.out),
            Some((target, plan, alpha)) => {
                let composer = self.composer;
                composer.write_blended(self.source, target, plan, alpha, self.out);
            }
        }
    }
}

/// Rotates, shifts and scales the points of a frame. The rotation mixes a point's x and z, which are two
/// numbers apart: over the 84 numbers of a frame, this is three products with shifted numbers.
struct Placement {
    own: [f32; FRAME_WIDTH],
    ahead: [f32; FRAME_WIDTH],
    behind: [f32; FRAME_WIDTH],
    bias: [f32; FRAME_WIDTH],
}

impl Placement {
    #[inline(always)]
    fn apply(&self, points: &PaddedPoints, out: &mut [f32; FRAME_WIDTH]) {
        for i in 0..FRAME_WIDTH {
            out[i] = self.own[i] * points[i + MARGIN]
                + self.ahead[i] * points[i + 2 * MARGIN]
                + self.behind[i] * points[i]
                + self.bias[i];
        }
    }
}

#[inline(always)]
fn product(a: &Quats, b: &Quats) -> Quats {
    let ([ax, ay, az, aw], [bx, by, bz, bw]) = (a, b);
    let mut out = [[0.0; LANES]; QUAT];
    for i in 0..LANES {
        out[0][i] = aw[i] * bx[i] + ax[i] * bw[i] + ay[i] * bz[i] - az[i] * by[i];
        out[1][i] = aw[i] * by[i] - ax[i] * bz[i] + ay[i] * bw[i] + az[i] * bx[i];
        out[2][i] = aw[i] * bz[i] + ax[i] * by[i] - ay[i] * bx[i] + az[i] * bw[i];
        out[3][i] = aw[i] * bw[i] - ax[i] * bx[i] - ay[i] * by[i] - az[i] * bz[i];
    }
    out
}

/// Points at a fixed offset from rotating joints: `p + q v q*`, written as
/// `p + v + 2 w (u x v) + 2 u x (u x v)` with `q = (u, w)`.
#[inline(always)]
fn attached(points: &Points, rotations: &Quats, [vx, vy, vz]: [f32; 3]) -> Points {
    let [qx, qy, qz, qw] = rotations;
    let mut out = *points;
    for i in 0..LANES {
        let (x, y, z, w) = (qx[i], qy[i], qz[i], qw[i]);
        let (tx, ty, tz) = (
            2.0 * (y * vz - z * vy),
            2.0 * (z * vx - x * vz),
            2.0 * (x * vy - y * vx),
        );
        out[0][i] += vx + w * tx + (y * tz - z * ty);
        out[1][i] += vy + w * ty + (z * tx - x * tz);
        out[2][i] += vz + w * tz + (x * ty - y * tx);
    }
    out
}

/// Spherical interpolation along the shorter arc.
#[inline(always)]
fn slerp(from: &Quats, to: &Quats, alpha: f32) -> Quats {
    let mut out = [[0.0; LANES]; QUAT];
    for i in 0..LANES {
        let dot = from[0][i] * to[0][i]
            + from[1][i] * to[1][i]
            + from[2][i] * to[2][i]
            + from[3][i] * to[3][i];
        let sign = if dot < 0.0 { -1.0 } else { 1.0 };
        let square = arc_cosine_squared(dot.abs().min(1.0));
        // sin(a t) / sin(t) = a sinc(a t) / sinc(t), which has no pole at t = 0.
        let whole = 1.0 / sinc_of_square(square);
        let beta = 1.0 - alpha;
        let from_weight = beta * sinc_of_square(beta * beta * square) * whole;
        let to_weight = alpha * sinc_of_square(alpha * alpha * square) * whole * sign;
        for component in 0..QUAT {
            out[component][i] = from[component][i] * from_weight + to[component][i] * to_weight;
        }
    }
    out
}

/// [`rotation::slerp_official`] in every lane, then normalised; the release leaves that to the conversion to
/// axis-angle.
#[inline(never)]
fn official(from: &Quats, to: &Quats, alpha: f32) -> Quats {
    let mut out = [[0.0; LANES]; QUAT];
    for lane in 0..LANES {
        let at = |planes: &Quats| Quat::from_array(lane_of(planes, lane));
        let mixed = rotation::slerp_official(at(from), at(to), alpha).normalize();
        set(&mut out, lane, mixed.to_array());
    }
    out
}

/// The square of the arc cosine on [0, 1], smooth at 1 unlike the arc cosine itself, to 4e-7.
///
/// # Source
/// Abramowitz and Stegun 4.4.46: `acos(x) = sqrt(1 - x) P(x)`.
#[inline(always)]
fn arc_cosine_squared(x: f32) -> f32 {
    const P: [f32; 8] = [
        FRAC_PI_2,
        -0.214_598_8,
        0.088_978_99,
        -0.050_174_305,
        0.030_891_88,
        -0.017_088_126,
        0.006_670_09,
        -0.001_262_491_1,
    ];
    let p = P.iter().rev().fold(0.0, |sum, c| sum * x + c);
    (1.0 - x) * p * p
}

/// `sin(t) / t` for `t` up to a right angle, given `t` squared: the series up to `t^10`, whose next
/// term is 4e-8 there.
#[inline(always)]
fn sinc_of_square(square: f32) -> f32 {
    const S: [f32; 6] = [
        1.0,
        -1.0 / 6.0,
        1.0 / 120.0,
        -1.0 / 5_040.0,
        1.0 / 362_880.0,
        -1.0 / 39_916_800.0,
    ];
    S.iter().rev().fold(0.0, |sum, c| sum * square + c)
}

#[cfg(test)]
mod tests;
