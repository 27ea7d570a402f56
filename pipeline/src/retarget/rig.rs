//! What retargeting needs to know of a source, whatever its format.

use std::ops::Range;

use datasets_spec::Fps;
use glam::{DQuat, DVec3};

/// A bone of a source skeleton.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bone<'a> {
    /// Name as written; empty if the file gives none.
    pub name: &'a str,
    /// Index of the parent, which precedes its children; none for a root.
    pub parent: Option<usize>,
    /// Where the bone ends in its own frame, if the file says so.
    pub tip: Option<DVec3>,
}

/// Where a bone is in the file's world, in the file's unit and axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed {
    /// Origin of the bone.
    pub position: DVec3,
    /// Orientation of the bone's frame.
    pub rotation: DQuat,
}

impl Placed {
    /// At the origin, unturned.
    pub const ORIGIN: Placed = Placed {
        position: DVec3::ZERO,
        rotation: DQuat::IDENTITY,
    };
}

/// A pose in which the source may show a person standing.
#[derive(Clone, Debug, PartialEq)]
pub struct Rest {
    /// What the pose is called in the file's format.
    pub name: &'static str,
    /// Every bone, `[B]`. The axes need not be those of the motion.
    pub bones: Vec<Placed>,
}

/// A skeleton and its motion as a file has them: own names, unit, axes and joint frames.
pub trait Rig {
    /// Code of the rejection of a skeleton that is no body.
    fn skeleton_code(&self) -> &'static str;

    /// The bones, parents first.
    fn bones(&self) -> Vec<Bone<'_>>;

    /// The frame rate.
    fn fps(&self) -> Fps;

    /// The frames that are motion.
    fn frames(&self) -> Range<usize>;

    /// The axis that the format says is up; none if files differ.
    fn up(&self) -> Option<DVec3> {
        None
    }

    /// Poses that may show a person standing, the most trustworthy first. At least one.
    fn rests(&self) -> Vec<Rest>;

    /// Visits the frames in order with the bones of each, `[B]`. Only those that `needed` says are
    /// computed; with a bone its ancestors must be needed.
    fn follow(&self, needed: &[bool], visit: &mut dyn FnMut(usize, &[Placed]));
}
