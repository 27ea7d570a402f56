//! The nodes of a scene: their tree, and their transforms.

use glam::{DMat3, DMat4, DQuat, DVec3, DVec4};
use gltf::json;

use crate::retarget::Placed;
use clip::Rejected;

/// Parents and order of the nodes.
pub(super) struct Tree {
    pub(super) parents: Vec<Option<usize>>,
    /// All nodes, parents first.
    pub(super) order: Vec<usize>,
}

impl Tree {
    pub(super) fn of(nodes: &[json::Node]) -> Result<Self, Rejected> {
        let broken = |reason: String| Rejected::read("E-GLTF-NODES", reason);
        let count = nodes.len();
        let mut parents = vec![None; count];
        let children = |node: usize| {
            nodes[node]
                .children
                .iter()
                .flatten()
                .map(json::Index::value)
        };
        for node in 0..count {
            for child in children(node) {
                let parent: &mut Option<usize> = parents.get_mut(child).ok_or_else(|| {
                    broken(format!("node {node} has child {child} of {count} nodes"))
                })?;
                if let Some(other) = parent.replace(node) {
                    let reason = format!("node {child} hangs from {other} and {node}");
                    return Err(broken(reason));
                }
            }
        }
        let mut order: Vec<usize> = (0..count).filter(|&n| parents[n].is_none()).collect();
        let mut at = 0;
        while let Some(&node) = order.get(at) {
            order.extend(children(node));
            at += 1;
        }
        // A node that no root leads to is part of a cycle.
        if order.len() < count {
            let lost = count - order.len();
            let reason = format!("{lost} of {count} nodes hang from themselves in a circle");
            return Err(broken(reason));
        }
        Ok(Self { parents, order })
    }
}

/// Translation, rotation and scale of a node relative to its parent.
#[derive(Clone, Copy)]
pub(super) struct Local {
    pub(super) translation: DVec3,
    pub(super) rotation: DQuat,
    pub(super) scale: DVec3,
}

impl Local {
    pub(super) fn of(node: &json::Node) -> Self {
        if let Some(matrix) = node.matrix {
            let matrix = DMat4::from_cols_array(&matrix.map(f64::from));
            let (scale, rotation, translation) = matrix.to_scale_rotation_translation();
            return Self {
                translation,
                rotation,
                scale,
            };
        }
        let vector = |v: [f32; 3]| DVec3::from_array(v.map(f64::from));
        let [x, y, z, w] = node.rotation.unwrap_or_default().0.map(f64::from);
        Self {
            translation: node.translation.map_or(DVec3::ZERO, vector),
            rotation: unit(DVec4::new(x, y, z, w)),
            scale: node.scale.map_or(DVec3::ONE, vector),
        }
    }

    /// Whether the scale turns left into right.
    pub(super) fn mirrors(&self) -> bool {
        self.scale.element_product() < 0.0
    }

    pub(super) fn is_finite(&self) -> bool {
        self.translation.is_finite() && self.rotation.is_finite() && self.scale.is_finite()
    }
}

/// The half turn of a scale that is negative along two axes; the identity of one that is positive along all.
fn half_turn(scale: DVec3) -> DQuat {
    match scale.to_array().map(|along| along < 0.0) {
        [false, true, true] => DQuat::from_xyzw(1.0, 0.0, 0.0, 0.0),
        [true, false, true] => DQuat::from_xyzw(0.0, 1.0, 0.0, 0.0),
        [true, true, false] => DQuat::from_xyzw(0.0, 0.0, 1.0, 0.0),
        _ => DQuat::IDENTITY,
    }
}

/// The rotation of a quaternion of any length; the identity for one of length zero.
pub(super) fn unit(quaternion: DVec4) -> DQuat {
    quaternion
        .try_normalize()
        .map_or(DQuat::IDENTITY, DQuat::from_vec4)
}

/// World transform of a node: `linear` includes the scale of the node and its ancestors, `placed` does not.
#[derive(Clone, Copy)]
pub(super) struct World {
    linear: DMat3,
    pub(super) placed: Placed,
}

impl World {
    pub(super) const ORIGIN: World = World {
        linear: DMat3::IDENTITY,
        placed: Placed::ORIGIN,
    };

    pub(super) fn child(&self, local: &Local) -> Self {
        let linear = DMat3::from_quat(local.rotation) * DMat3::from_diagonal(local.scale);
        Self {
            linear: self.linear * linear,
            placed: Placed {
                position: self.placed.position + self.linear * local.translation,
                rotation: self.placed.rotation * local.rotation * half_turn(local.scale),
            },
        }
    }
}
