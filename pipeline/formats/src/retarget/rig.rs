//! The format-independent interface of a source for retargeting.

use std::ops::Range;

use datasets_spec::Fps;
use glam::{DQuat, DVec3};

use crate::source::Unit;
use crate::source::Up;

/// A bone of a source skeleton.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bone<'a> {
    /// Name as written; empty if the file gives none.
    pub name: &'a str,
    /// Index of the parent, which precedes its children; `None` for a root.
    pub parent: Option<usize>,
    /// End of the bone in the bone's frame, if the file states it.
    pub tip: Option<DVec3>,
}

/// Marks `bones` and all their ancestors. `parents` holds the parent of every bone.
pub(crate) fn with_ancestors(
    parents: &[Option<usize>],
    bones: impl IntoIterator<Item = usize>,
) -> Vec<bool> {
    let mut marked = vec![false; parents.len()];
    for bone in bones {
        let mut at = Some(bone);
        while let Some(bone) = at.filter(|&bone| !marked[bone]) {
            marked[bone] = true;
            at = parents[bone];
        }
    }
    marked
}

/// World transform of a bone in the file's unit and axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed {
    /// Origin of the bone.
    pub position: DVec3,
    /// Orientation of the bone's frame.
    pub rotation: DQuat,
}

impl Placed {
    /// The identity.
    pub const ORIGIN: Placed = Placed {
        position: DVec3::ZERO,
        rotation: DQuat::IDENTITY,
    };
}

/// A pose that may be a standing person.
#[derive(Clone, Debug, PartialEq)]
pub struct Rest {
    /// Name of the pose in the file's format.
    pub name: &'static str,
    /// World transform of every bone, `[B]`. Its axes may differ from those of the motion.
    pub bones: Vec<Placed>,
}

impl Rest {
    pub(crate) fn new(name: &'static str, bones: Vec<Placed>) -> Self {
        Self { name, bones }
    }
}

/// A skeleton and its motion with the file's names, unit, axes and joint frames.
pub trait Rig {
    /// Rejection code for a skeleton that is not a body.
    fn skeleton_code(&self) -> &'static str;

    /// The bones, parents first.
    fn bones(&self) -> Vec<Bone<'_>>;

    /// The frame rate.
    fn fps(&self) -> Fps;

    /// The frames that are motion; a leading zero pose is left out.
    fn frames(&self) -> Range<usize>;

    /// The up axis that the format specifies; `None` if it varies among files.
    fn up(&self) -> Option<Up> {
        None
    }

    /// The unit that the file states; `None` if its format has none, or files do not keep to it.
    fn unit(&self) -> Option<Unit> {
        None
    }

    /// Poses that may be a standing person, the most reliable first. At least one.
    fn rests(&self) -> Vec<Rest>;

    /// Visits the frames in order with the bones of each, `[B]`. Only bones marked in `needed` are computed;
    /// their ancestors must be marked too.
    fn follow(&self, needed: &[bool], visit: &mut dyn FnMut(usize, &[Placed]));
}
