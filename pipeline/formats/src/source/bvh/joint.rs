//! Joints of a hierarchy and their channels.

use glam::DVec3;

/// An axis of the file's coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// First.
    X,
    /// Second.
    Y,
    /// Third.
    Z,
}

/// Meaning of one column of the motion for its joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// A coordinate in the parent's frame, in the file's unit. It replaces that coordinate of the
    /// offset.
    Position(Axis),
    /// A rotation about an axis, in degrees. Rotations apply in the order of their columns: the
    /// first is the outermost.
    Rotation(Axis),
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
