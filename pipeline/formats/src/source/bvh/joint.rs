//! Joints of a hierarchy and their channels.

use glam::DVec3;

/// Meaning of one column of the motion for its joint, with its axis: 0 for x, 1 for y, 2 for z.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// A coordinate in the parent's frame, in the file's unit. It replaces that coordinate of the
    /// offset.
    Position(usize),
    /// A rotation about an axis, in degrees. Rotations apply in the order of their columns: the
    /// first is the outermost.
    Rotation(usize),
}

/// A joint of the hierarchy.
#[derive(Clone, Debug, PartialEq)]
pub struct BvhJoint {
    /// Name as written.
    pub name: String,
    /// Index of the parent; none for the root. A parent precedes its children.
    pub parent: Option<usize>,
    /// Position in the parent's frame in the file's unit, unless a channel replaces it.
    pub offset: DVec3,
    /// The joint's columns, in order.
    pub channels: Vec<Channel>,
    /// Index of the joint's first column.
    pub first_channel: usize,
    /// End of the joint's bone (`End Site`), if stated.
    pub end_site: Option<DVec3>,
}
