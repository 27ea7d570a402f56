//! The bones of a BVH file, placed frame by frame.

use std::ops::Range;

use datasets_spec::Fps;
use glam::{DQuat, DVec3};

use super::file::BvhFile;
use super::hierarchy::{BvhJoint, Channel};
use super::soma;
use crate::retarget::{Bone, Placed, Rest, Rig};

impl Rig for BvhFile {
    fn skeleton_code(&self) -> &'static str {
        "E-BVH-SKELETON"
    }

    fn bones(&self) -> Vec<Bone<'_>> {
        self.joints
            .iter()
            .map(|joint| Bone {
                name: &joint.name,
                parent: joint.parent,
                tip: joint.end_site,
            })
            .collect()
    }

    fn fps(&self) -> Fps {
        self.fps
    }

    fn frames(&self) -> Range<usize> {
        usize::from(self.starts_with_zero_pose())..self.num_frames
    }

    /// The zero pose, in which every rotation is zero and a joint with position channels is at their mean; then, for a
    /// rig of SOMA, its T-pose.
    fn rests(&self) -> Vec<Rest> {
        let mut bones: Vec<Placed> = Vec::with_capacity(self.joints.len());
        for joint in &self.joints {
            let position = match joint.parent {
                Some(parent) => bones[parent].position + self.mean_offset(joint),
                None => DVec3::ZERO,
            };
            bones.push(Placed {
                position,
                rotation: DQuat::IDENTITY,
            });
        }
        let t_pose = soma::t_pose(&self.joints).map(|bones| Rest::new("T-pose of SOMA", bones));
        let zero = Rest::new("zero pose", bones);
        std::iter::once(zero).chain(t_pose).collect()
    }

    fn follow(&self, needed: &[bool], visit: &mut dyn FnMut(usize, &[Placed])) {
        let num_joints = self.joints.len();
        let frames = self.frames();
        let mut placed = vec![Placed::ORIGIN; num_joints * BLOCK.min(frames.len())];
        let mut local = LocalBlock::default();
        for start in frames.clone().step_by(BLOCK) {
            let block = start..frames.end.min(start + BLOCK);
            let rows = &self.values[block.start * self.num_channels..block.end * self.num_channels];
            // Joints in the outer loop: the channels of a joint are looked up once per block.
            for (index, joint) in self.joints.iter().enumerate() {
                if !needed[index] {
                    continue;
                }
                local.read(joint, rows, self.num_channels, block.len());
                for (slot, of_frame) in placed
                    .chunks_exact_mut(num_joints)
                    .take(block.len())
                    .enumerate()
                {
                    let (position, rotation) = (local.positions[slot], local.rotations[slot]);
                    of_frame[index] = match joint.parent {
                        Some(parent) => {
                            let above = of_frame[parent];
                            Placed {
                                position: above.position + above.rotation * position,
                                rotation: above.rotation * rotation,
                            }
                        }
                        None => Placed { position, rotation },
                    };
                }
            }
            for (frame, of_frame) in block.zip(placed.chunks_exact(num_joints)) {
                visit(frame, of_frame);
            }
        }
    }
}

impl BvhFile {
    /// Whether the first frame is a zero pose put before the motion, as in conversions of the CMU
    /// data: nearly all of its rotations are exactly zero, and many of the next frame are not.
    fn starts_with_zero_pose(&self) -> bool {
        const NEARLY_ALL: f64 = 0.8;
        const MANY: f64 = 0.25;
        if self.num_frames < 3 {
            return false;
        }
        let share_of_zeros = |frame: usize| {
            let values = self.frame(frame);
            let (mut zeros, mut rotations) = (0usize, 0usize);
            for joint in &self.joints {
                for (channel, value) in joint.channels.iter().zip(&values[joint.first_channel..]) {
                    if matches!(channel, Channel::Rotation(_)) {
                        rotations += 1;
                        zeros += usize::from(*value == 0.0);
                    }
                }
            }
            zeros as f64 / rotations.max(1) as f64
        };
        let zeros = share_of_zeros(0);
        zeros >= NEARLY_ALL && zeros - share_of_zeros(1) >= MANY
    }

    /// A joint's position in its parent's frame; the mean over the motion if it has position channels.
    fn mean_offset(&self, joint: &BvhJoint) -> DVec3 {
        let mut offset = joint.offset;
        let frames = self.frames();
        for (column, channel) in (joint.first_channel..).zip(&joint.channels) {
            if let Channel::Position(axis) = *channel {
                let column = self.values[column..].iter().step_by(self.num_channels);
                let sum: f64 = column.skip(frames.start).sum();
                offset[axis] = sum / frames.len() as f64;
            }
        }
        offset
    }
}

/// Frames processed together: few enough for all joints of a body to fit the L2 cache, many enough
/// to amortise the lookups per joint.
pub(super) const BLOCK: usize = 32;

/// A joint's transforms in its parent's frame, for a block of frames.
#[derive(Default)]
pub(super) struct LocalBlock {
    pub(super) positions: [DVec3; BLOCK],
    pub(super) rotations: [DQuat; BLOCK],
}

impl LocalBlock {
    /// Reads the columns of a joint from rows of `num_channels` values.
    pub(super) fn read(
        &mut self,
        joint: &BvhJoint,
        rows: &[f64],
        num_channels: usize,
        num_rows: usize,
    ) {
        self.positions[..num_rows].fill(joint.offset);
        self.rotations[..num_rows].fill(DQuat::IDENTITY);
        for (at, channel) in (joint.first_channel..).zip(&joint.channels) {
            let mut column = [0.0; BLOCK];
            for (value, row) in column.iter_mut().zip(rows.chunks_exact(num_channels)) {
                *value = row[at];
            }
            match *channel {
                Channel::Position(axis) => {
                    for (position, value) in self.positions.iter_mut().zip(column) {
                        position[axis] = value;
                    }
                }
                Channel::Rotation(axis) => {
                    let (sin, cos) = half_angle_sin_cos(&column);
                    for (slot, rotation) in self.rotations[..num_rows].iter_mut().enumerate() {
                        *rotation = rotated(*rotation, axis, sin[slot], cos[slot]);
                    }
                }
            }
        }
    }
}

/// `q` times the rotation about an axis with the given sine and cosine of half its angle. It takes
/// half the multiplications of a general product.
fn rotated(q: DQuat, axis: usize, s: f64, c: f64) -> DQuat {
    let DQuat { x, y, z, w } = q;
    match axis {
        0 => DQuat::from_xyzw(x * c + w * s, y * c + z * s, z * c - y * s, w * c - x * s),
        1 => DQuat::from_xyzw(x * c - z * s, y * c + w * s, z * c + x * s, w * c - y * s),
        _ => DQuat::from_xyzw(x * c + y * s, y * c - x * s, z * c + w * s, w * c - z * s),
    }
}

/// Sines and cosines of the halves of angles in degrees.
///
/// Whole quarter turns are subtracted in degrees, where the remainder is exact. Sine and cosine of
/// the remainder, at most 45 degrees, are Taylor polynomials whose first omitted term is below
/// 1e-16. The loop has no branches, so that the compiler vectorises it.
pub(super) fn half_angle_sin_cos(degrees: &[f64; BLOCK]) -> ([f64; BLOCK], [f64; BLOCK]) {
    /// Angle in degrees up to which the number of quarter turns is exact, with a wide margin.
    const LARGEST: f64 = 1e9;
    /// Adding and subtracting 1.5 * 2^52 rounds to an integer; the lowest bits of the sum are those of the integer.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    const QUARTER: f64 = 90.0;
    const SIN: [f64; 7] = [
        -1.0 / 6.0,
        1.0 / 120.0,
        -1.0 / 5_040.0,
        1.0 / 362_880.0,
        -1.0 / 39_916_800.0,
        1.0 / 6_227_020_800.0,
        -1.0 / 1_307_674_368_000.0,
    ];
    const COS: [f64; 8] = [
        -0.5,
        1.0 / 24.0,
        -1.0 / 720.0,
        1.0 / 40_320.0,
        -1.0 / 3_628_800.0,
        1.0 / 479_001_600.0,
        -1.0 / 87_178_291_200.0,
        1.0 / 20_922_789_888_000.0,
    ];
    let (mut sines, mut cosines) = ([0.0; BLOCK], [0.0; BLOCK]);
    if degrees.iter().any(|angle| angle.abs() > LARGEST) {
        for (slot, angle) in degrees.iter().enumerate() {
            (sines[slot], cosines[slot]) = (0.5 * angle.to_radians()).sin_cos();
        }
        return (sines, cosines);
    }
    for slot in 0..BLOCK {
        let half = 0.5 * degrees[slot];
        let rounded = half * (1.0 / QUARTER) + ROUND;
        let quarters = rounded - ROUND;
        let r = (half - QUARTER * quarters).to_radians();
        let r2 = r * r;
        let sin = r + r * r2 * SIN.iter().rev().fold(0.0, |sum, term| sum * r2 + term);
        let cos = 1.0 + r2 * COS.iter().rev().fold(0.0, |sum, term| sum * r2 + term);
        // A quarter turn swaps sine and cosine, a half turn changes the signs.
        let turns = rounded.to_bits();
        let swap = (turns & 1).wrapping_neg();
        let (sin_bits, cos_bits) = (sin.to_bits(), cos.to_bits());
        let exchanged = (sin_bits ^ cos_bits) & swap;
        sines[slot] = f64::from_bits((sin_bits ^ exchanged) ^ ((turns & 2) << 62));
        cosines[slot] =
            f64::from_bits((cos_bits ^ exchanged) ^ ((turns.wrapping_add(1) & 2) << 62));
    }
    (sines, cosines)
}
