//! The recipe on blocks of frames. Each coordinate has an array over the frames of a block, so that loops vectorise.
//!
//! Positions are computed in `f64`, rotations in `f32`: they depend on bone directions alone, which `f32`
//! holds to 1e-7, and the features are stored in `f32`.

use datasets_spec::record::HUMANML3D_WIDTH;
use glam::{DVec2, DVec3};
use kinematics::simd::blocks::Vectors;
use kinematics::simd::lanes::{self, Kernel, LANES};
use kinematics::skeleton::{NUM_BODY_JOINTS, parent_of};

use super::headings::{Angles, Headings};
use super::recipe::{
    CONTACT_THRESHOLD, FEET, FeatureError, Features, Joints, LEFT_HIP, LEFT_SHOULDER, RELATIVE_TO,
    REST_AXES, RIGHT_HIP, RIGHT_SHOULDER, SHORTEST_BONE_M,
};

/// A rotation matrix in every frame of a block, by column.
type Turns = [Vectors<f32>; 3];
/// The joints of a block.
type Block = [Vectors<f64>; NUM_BODY_JOINTS];
/// The joints of a block and of the frame after it.
type Run = [[[f64; LANES + 1]; 3]; NUM_BODY_JOINTS];
/// The features of a block, by column.
type Columns = [[f32; LANES]; HUMANML3D_WIDTH];

/// The joints of a clip, in blocks. The last block is padded with the last frame.
pub(super) struct Clip {
    blocks: Vec<Block>,
    frames: usize,
}

/// Placement of a clip: an offset, then a rotation about the vertical.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placement {
    origin: DVec3,
    /// Sine and cosine of the turn.
    turn: DVec2,
}

impl Placement {
    /// Moves `origin` to zero and rotates a direction on the ground to +z; a zero vector counts as +z.
    pub(super) fn new(origin: DVec3, forward: DVec3) -> Self {
        let forward = DVec2::new(forward.x, forward.z).normalize_or(DVec2::Y);
        Self {
            origin,
            turn: DVec2::new(-forward.x, forward.y),
        }
    }

    #[inline(always)]
    fn apply(&self, point: DVec3) -> DVec3 {
        let moved = point - self.origin;
        let [x, z] = self.turned([moved.x, moved.z]);
        DVec3::new(x, moved.y, z)
    }

    /// Rotates a direction on the ground.
    #[inline(always)]
    pub(super) fn turned(&self, [x, z]: [f64; 2]) -> [f64; 2] {
        see(self.turn.y, self.turn.x, x, z)
    }
}

impl Clip {
    /// Takes the joints of at least one frame.
    pub(super) fn gather(joints: &[Joints]) -> Self {
        let mut blocks = vec![[[[0.0; LANES]; 3]; NUM_BODY_JOINTS]; joints.len().div_ceil(LANES)];
        for (block, frames) in blocks.iter_mut().zip(joints.chunks(LANES)) {
            let last = frames.len() - 1;
            for lane in 0..LANES {
                for (vectors, joint) in block.iter_mut().zip(&frames[lane.min(last)]) {
                    vectors[0][lane] = joint.x;
                    vectors[1][lane] = joint.y;
                    vectors[2][lane] = joint.z;
                }
            }
        }
        Self {
            blocks,
            frames: joints.len(),
        }
    }

    /// The joints of a frame.
    pub(super) fn frame(&self, frame: usize) -> Joints {
        let (block, lane) = (&self.blocks[frame / LANES], frame % LANES);
        std::array::from_fn(|joint| DVec3::from_array(block[joint].map(|axis| axis[lane])))
    }

    /// Gives every bone a length and keeps its direction; the root's position is multiplied by
    /// `scale`.
    ///
    /// # Errors
    /// A bone has no direction.
    pub(super) fn unify(
        &mut self,
        bones: &[f64; NUM_BODY_JOINTS],
        scale: f64,
    ) -> Result<(), FeatureError> {
        for (index, block) in self.blocks.iter_mut().enumerate() {
            let source = *block;
            let sound = lanes::dispatch(LayBones {
                source: &source,
                bones,
                scale,
                block,
            });
            check(&sound, &source, index * LANES)?;
        }
        Ok(())
    }

    /// The lowest height of any joint.
    pub(super) fn lowest(&self) -> f64 {
        let mut lowest = [f64::INFINITY; LANES];
        for vectors in self.blocks.iter().flatten() {
            for (low, &height) in lowest.iter_mut().zip(&vectors[1]) {
                // A single instruction, unlike `f64::min`, which handles NaN.
                *low = if height < *low { height } else { *low };
            }
        }
        lowest.into_iter().fold(f64::INFINITY, f64::min)
    }

    /// The forward vector on the ground, x and z, of every frame. As in the published inverse kinematics, the hips are
    /// swapped and the shoulders are not.
    pub(super) fn forwards(&self) -> Vec<[f64; 2]> {
        let mut forwards = Vec::with_capacity(self.blocks.len() * LANES);
        for block in &self.blocks {
            let mut forward = [[0.0; 2]; LANES];
            let [left_hip, right_hip, left_shoulder, right_shoulder] =
                [LEFT_HIP, RIGHT_HIP, LEFT_SHOULDER, RIGHT_SHOULDER].map(|joint| &block[joint]);
            for lane in 0..LANES {
                let across: [f64; 3] = std::array::from_fn(|axis| {
                    left_hip[axis][lane] - right_hip[axis][lane] + right_shoulder[axis][lane]
                        - left_shoulder[axis][lane]
                });
                let length = square(across).sqrt();
                let inverse = if length > 0.0 { 1.0 / length } else { 0.0 };
                forward[lane] = [across[2] * inverse, -across[0] * inverse];
            }
            forwards.extend_from_slice(&forward);
        }
        forwards.truncate(self.frames);
        forwards
    }

    /// The joints of the placed clip.
    pub(super) fn placed(&self, placement: Placement) -> Vec<Joints> {
        (0..self.frames)
            .map(|frame| self.frame(frame).map(|joint| placement.apply(joint)))
            .collect()
    }

    /// The features of the placed clip, one frame fewer than the clip.
    pub(super) fn features(&self, placement: Placement, headings: &Headings) -> Vec<Features> {
        let mut rows = vec![[0.0; HUMANML3D_WIDTH]; self.frames - 1];
        lanes::dispatch(WriteFeatures {
            clip: self,
            placement,
            headings,
            rows: &mut rows,
        });
        rows
    }

    /// Places a block of the clip and the frame after it.
    #[inline(always)]
    fn place(&self, index: usize, placement: Placement, run: &mut Run) {
        let block = &self.blocks[index];
        let after = self.blocks.get(index + 1);
        for (joint, run) in run.iter_mut().enumerate() {
            place_joint(&block[joint], placement, run);
            let last = [0, 1, 2].map(|axis| match after {
                Some(after) => after[joint][axis][0],
                None => block[joint][axis][LANES - 1],
            });
            let placed = placement.apply(DVec3::from_array(last)).to_array();
            for (axis, value) in placed.into_iter().enumerate() {
                run[axis][LANES] = value;
            }
        }
    }
}

/// Sets the bones of a block to their lengths and keeps their directions. Returns a mask for each frame: all bits are
/// set if every bone has a direction.
struct LayBones<'a> {
    source: &'a Block,
    bones: &'a [f64; NUM_BODY_JOINTS],
    scale: f64,
    block: &'a mut Block,
}

impl Kernel for LayBones<'_> {
    type Output = [u64; LANES];

    #[inline(always)]
    fn run(self) -> [u64; LANES] {
        let mut sound = [u64::MAX; LANES];
        scale_by(&mut self.block[0], self.scale);
        for joint in 1..NUM_BODY_JOINTS {
            let parent = parent_of(joint);
            let (above, below) = self.block.split_at_mut(joint);
            lay_bone(
                [&self.source[parent], &self.source[joint]],
                self.bones[joint],
                &above[parent],
                &mut below[0],
                &mut sound,
            );
        }
        sound
    }
}

/// Writes the features of a clip, a row for each frame.
struct WriteFeatures<'a> {
    clip: &'a Clip,
    placement: Placement,
    headings: &'a Headings,
    rows: &'a mut [Features],
}

impl Kernel for WriteFeatures<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let mut columns = [[0.0; LANES]; HUMANML3D_WIDTH];
        let mut run = [[[0.0; LANES + 1]; 3]; NUM_BODY_JOINTS];
        let mut turns = [[[[0.0; LANES]; 3]; 3]; NUM_BODY_JOINTS];
        for (index, rows) in self.rows.chunks_mut(LANES).enumerate() {
            self.clip.place(index, self.placement, &mut run);
            let angles = self.headings.block(index);
            write_root(&run, angles, &mut columns);
            self.headings.write_yaw_velocity(index, &mut columns[0]);
            write_positions(&run, angles, &mut columns);
            turn_root(angles, &mut turns[0]);
            write_rotations(&run, &mut turns, &mut columns);
            write_velocities(&run, angles, &mut columns);
            write_contacts(&run, &mut columns);
            for (lane, row) in rows.iter_mut().enumerate() {
                for (value, column) in row.iter_mut().zip(&columns) {
                    *value = column[lane];
                }
            }
        }
    }
}

#[inline(always)]
fn place_joint(joint: &Vectors<f64>, placement: Placement, run: &mut [[f64; LANES + 1]; 3]) {
    let DVec3 { x, y, z } = placement.origin;
    for lane in 0..LANES {
        let (from_x, from_z) = (joint[0][lane] - x, joint[2][lane] - z);
        let [to_x, to_z] = placement.turned([from_x, from_z]);
        run[0][lane] = to_x;
        run[1][lane] = joint[1][lane] - y;
        run[2][lane] = to_z;
    }
}

#[inline(always)]
fn square([x, y, z]: [f64; 3]) -> f64 {
    x * x + y * y + z * z
}

/// All bits set if a bone of this squared length has a direction.
#[inline(always)]
fn is_sound(squared: f64) -> u64 {
    // False for NaN too. The upper bound is there because directions are computed in f32.
    let sound = squared > SHORTEST_BONE_M * SHORTEST_BONE_M && squared < f64::from(f32::MAX);
    if sound { u64::MAX } else { 0 }
}

/// Returns an error that names the first frame of a block with an unsound bone, and the joint at its end; the root if
/// the root has no finite position.
fn check(sound: &[u64; LANES], block: &Block, start: usize) -> Result<(), FeatureError> {
    let Some(lane) = sound.iter().position(|&sound| sound == 0) else {
        return Ok(());
    };
    let at = |joint: usize| block[joint].map(|axis| axis[lane]);
    let is_root_lost = at(0).iter().any(|value| !value.is_finite());
    let joint = (1..NUM_BODY_JOINTS)
        .filter(|_| !is_root_lost)
        .find(|&joint| {
            let (child, parent) = (at(joint), at(parent_of(joint)));
            is_sound(square([0, 1, 2].map(|axis| child[axis] - parent[axis]))) == 0
        });
    Err(FeatureError::NoDirection {
        joint: joint.unwrap_or(0),
        frame: start + lane,
    })
}

#[inline(always)]
fn scale_by(vectors: &mut Vectors<f64>, factor: f64) {
    for value in vectors.iter_mut().flatten() {
        *value *= factor;
    }
}

/// Places a joint at the given length along the bone from its parent.
#[inline(always)]
fn lay_bone(
    [from, to]: [&Vectors<f64>; 2],
    length: f64,
    parent: &Vectors<f64>,
    joint: &mut Vectors<f64>,
    sound: &mut [u64; LANES],
) {
    for lane in 0..LANES {
        let bone = [0, 1, 2].map(|axis| to[axis][lane] - from[axis][lane]);
        let squared = square(bone);
        let factor = length / squared.sqrt();
        sound[lane] &= is_sound(squared);
        for axis in 0..3 {
            joint[axis][lane] = parent[axis][lane] + bone[axis] * factor;
        }
    }
}

/// Rotates a ground vector into the frame of a heading.
#[inline(always)]
fn see(cosine: f64, sine: f64, x: f64, z: f64) -> [f64; 2] {
    [cosine * x + sine * z, cosine * z - sine * x]
}

/// The root's step in the frame of the next heading, and its height.
#[inline(always)]
fn write_root(run: &Run, (cosines, sines): Angles<'_>, columns: &mut Columns) {
    let [x, y, z] = &run[0];
    for lane in 0..LANES {
        let next = lane + 1;
        let [step_x, step_z] = see(
            cosines[next],
            sines[next],
            x[next] - x[lane],
            z[next] - z[lane],
        );
        columns[1][lane] = step_x as f32;
        columns[2][lane] = step_z as f32;
        columns[3][lane] = y[lane] as f32;
    }
}

#[inline(always)]
fn write_positions(run: &Run, (cosines, sines): Angles<'_>, columns: &mut Columns) {
    let (root, joints) = run.split_at(1);
    let (columns, _) = columns[4..67].as_chunks_mut::<3>();
    for (column, joint) in columns.iter_mut().zip(joints) {
        for lane in 0..LANES {
            let [x, z] = see(
                cosines[lane],
                sines[lane],
                joint[0][lane] - root[0][0][lane],
                joint[2][lane] - root[0][2][lane],
            );
            column[0][lane] = x as f32;
            column[1][lane] = joint[1][lane] as f32;
            column[2][lane] = z as f32;
        }
    }
}

#[inline(always)]
fn write_velocities(run: &Run, (cosines, sines): Angles<'_>, columns: &mut Columns) {
    let (columns, _) = columns[193..259].as_chunks_mut::<3>();
    for (column, joint) in columns.iter_mut().zip(run) {
        for lane in 0..LANES {
            let step = [0, 1, 2].map(|axis| joint[axis][lane + 1] - joint[axis][lane]);
            let [x, z] = see(cosines[lane], sines[lane], step[0], step[2]);
            column[0][lane] = x as f32;
            column[1][lane] = step[1] as f32;
            column[2][lane] = z as f32;
        }
    }
}

#[inline(always)]
fn write_contacts(run: &Run, columns: &mut Columns) {
    for (column, joint) in columns[259..].iter_mut().zip(FEET) {
        for lane in 0..LANES {
            let step = [0, 1, 2].map(|axis| run[joint][axis][lane + 1] - run[joint][axis][lane]);
            column[lane] = if square(step) < CONTACT_THRESHOLD {
                1.0
            } else {
                0.0
            };
        }
    }
}

/// The root's rotation is the heading.
#[inline(always)]
fn turn_root((cosines, sines): Angles<'_>, root: &mut Turns) {
    for lane in 0..LANES {
        let (cosine, sine) = (cosines[lane] as f32, sines[lane] as f32);
        root[0][0][lane] = cosine;
        root[0][2][lane] = -sine;
        root[1][1][lane] = 1.0;
        root[2][0][lane] = sine;
        root[2][2][lane] = cosine;
    }
}

/// Writes the first two columns of each joint's rotation relative to the joint before it in its chain. `turns[0]` holds
/// the root's rotation. A joint's rotation takes the rest axis of the bone that ends in it to the bone's direction.
#[inline(always)]
fn write_rotations(run: &Run, turns: &mut [Turns; NUM_BODY_JOINTS], columns: &mut Columns) {
    let (columns, _) = columns[67..193].as_chunks_mut::<6>();
    for joint in 1..NUM_BODY_JOINTS {
        let rest = REST_AXES[joint];
        let sign = (rest.x + rest.y + rest.z) as f32;
        let bone = bone_directions(&run[parent_of(joint)], &run[joint]);
        let (above, below) = turns.split_at_mut(joint);
        match rest.abs().max_position() {
            0 => turn_from_axis::<0>(sign, &bone, &mut below[0]),
            1 => turn_from_axis::<1>(sign, &bone, &mut below[0]),
            _ => turn_from_axis::<2>(sign, &bone, &mut below[0]),
        }
        let before = &above[RELATIVE_TO[joint]];
        let (first, second) = columns[joint - 1].split_at_mut(3);
        see_column(before, &below[0][0], first);
        see_column(before, &below[0][1], second);
    }
}

#[inline(always)]
fn bone_directions(parent: &[[f64; LANES + 1]; 3], child: &[[f64; LANES + 1]; 3]) -> Vectors<f32> {
    let mut directions = [[0.0; LANES]; 3];
    for lane in 0..LANES {
        let bone = [0, 1, 2].map(|axis| (child[axis][lane] - parent[axis][lane]) as f32);
        let length = (bone[0] * bone[0] + bone[1] * bone[1] + bone[2] * bone[2]).sqrt();
        let inverse = 1.0 / length;
        for axis in 0..3 {
            directions[axis][lane] = bone[axis] * inverse;
        }
    }
    directions
}

/// The shortest rotations that take an axis, or its opposite if `sign` is -1, to directions.
///
/// For the axis `a`, the direction `d` and `h = 1 / (1 + a . d)`, the column of another axis `e` is
/// `e - (a + d) h (d . e)`. For obtuse angles `h` is computed from the component `v` of `d` perpendicular
/// to `a`, as `(1 - a . d) / |v|^2`, which avoids cancellation.
#[inline(always)]
fn turn_from_axis<const AXIS: usize>(sign: f32, directions: &Vectors<f32>, turns: &mut Turns) {
    /// Minimum distance of a direction from the opposite of the axis, so that the half turn has a defined
    /// axis.
    const NUDGE: f32 = 1e-12;
    let (second, third) = ((AXIS + 1) % 3, (AXIS + 2) % 3);
    for lane in 0..LANES {
        let along = sign * directions[AXIS][lane];
        let (u, w) = (directions[second][lane], directions[third][lane]);
        let across = u * u + w * w;
        let against = along < 0.0;
        let opposite = against & (across < NUDGE * NUDGE);
        let u = if opposite { NUDGE } else { u };
        let across = if opposite { NUDGE * NUDGE } else { across };
        let numerator = if against { 1.0 - along } else { 1.0 };
        let denominator = if against { across } else { 1.0 + along };
        let h = numerator / denominator;
        turns[AXIS][AXIS][lane] = along;
        turns[AXIS][second][lane] = sign * u;
        turns[AXIS][third][lane] = sign * w;
        turns[second][AXIS][lane] = -sign * u;
        turns[second][second][lane] = 1.0 - u * h * u;
        turns[second][third][lane] = -(u * h * w);
        turns[third][AXIS][lane] = -sign * w;
        turns[third][second][lane] = -(u * h * w);
        turns[third][third][lane] = 1.0 - w * h * w;
    }
}

/// Expresses vectors in the local frames of rotations: transposes times vectors.
#[inline(always)]
fn see_column(turns: &Turns, vectors: &Vectors<f32>, seen: &mut [[f32; LANES]]) {
    for (seen, axis) in seen.iter_mut().zip(turns) {
        for lane in 0..LANES {
            seen[lane] = axis[0][lane] * vectors[0][lane]
                + axis[1][lane] * vectors[1][lane]
                + axis[2][lane] * vectors[2][lane];
        }
    }
}
