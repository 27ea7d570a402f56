//! The tree of keypoints.

use crate::skeleton::{NUM_BODY_JOINTS, NUM_KEYPOINTS, parent_of};

/// Maximum number of keypoint children of a joint: pelvis and spine3 have three.
pub(super) const MAX_CHILDREN: usize = 3;
/// Joints on the longest chain, pelvis and wrist included.
pub(super) const MAX_CHAIN: usize = 8;

pub(super) struct Tree {
    pub(super) num_children: [usize; NUM_BODY_JOINTS],
    /// Keypoint children of each joint, as slots.
    pub(super) children: [[usize; MAX_CHILDREN]; NUM_BODY_JOINTS],
    /// Depth of each joint; 0 for the pelvis.
    pub(super) depth: [usize; NUM_BODY_JOINTS],
    /// The joints from the pelvis to each joint, inclusive.
    pub(super) chain: [[usize; MAX_CHAIN]; NUM_BODY_JOINTS],
}

pub(super) const TREE: Tree = Tree::new();

impl Tree {
    pub(super) const fn new() -> Self {
        let mut tree = Self {
            num_children: [0; NUM_BODY_JOINTS],
            children: [[0; MAX_CHILDREN]; NUM_BODY_JOINTS],
            depth: [0; NUM_BODY_JOINTS],
            chain: [[0; MAX_CHAIN]; NUM_BODY_JOINTS],
        };
        let mut slot = 1;
        while slot < NUM_KEYPOINTS {
            let parent = parent_of(slot);
            tree.children[parent][tree.num_children[parent]] = slot;
            tree.num_children[parent] += 1;
            if slot < NUM_BODY_JOINTS {
                tree.chain[slot] = tree.chain[parent];
                tree.depth[slot] = tree.depth[parent] + 1;
                tree.chain[slot][tree.depth[slot]] = slot;
            }
            slot += 1;
        }
        tree
    }

    pub(super) fn children(&self, joint: usize) -> &[usize] {
        &self.children[joint][..self.num_children[joint]]
    }
}
