//! The skeleton of a skin: its joints, the nodes above them, and the bind pose.

use std::collections::{BTreeMap, BTreeSet};

use glam::{DMat3, DMat4, DQuat, DVec3};
use gltf::json;
use gltf::json::accessor::Type;

use super::document::{Document, accessor_error, limit};
use super::nodes::{Local, Tree, World};
use crate::retarget::{Placed, with_ancestors};
use clip::{Rejected, rejected};

/// Limit on bones: joints of the skin and the nodes above them.
const MAX_BONES: usize = 4096;

/// The skins of each body that an animation moves, or of one body if it moves none. The first skin of a body is the one
/// with the most joints among those that the animation moves, and the first body that of the largest such skin. Skins
/// whose joints are ancestors or descendants of each other belong to one body, such as gloves and trousers.
pub(super) fn moved_bodies<'a>(
    document: &'a Document,
    tree: &Tree,
    animation: &json::Animation,
) -> Vec<Vec<&'a json::Skin>> {
    let moved: BTreeSet<usize> = animation
        .channels
        .iter()
        .map(|channel| channel.target.node.value())
        .collect();
    let joints = |skin: &json::Skin| -> BTreeSet<usize> {
        skin.joints.iter().map(json::Index::value).collect()
    };
    let is_moved = |skin: &json::Skin| !joints(skin).is_disjoint(&moved);
    let above = |node: usize| {
        let parent = |node: &usize| tree.parents.get(*node).copied().flatten();
        std::iter::successors(Some(node), parent)
    };
    let is_of_body = |skin: &json::Skin, body: &[&json::Skin]| {
        let (own, others) = (
            joints(skin),
            body.iter()
                .flat_map(|skin| joints(skin))
                .collect::<BTreeSet<_>>(),
        );
        let lies_below = |below: &BTreeSet<usize>, top: &BTreeSet<usize>| {
            let mut nodes = below.iter().flat_map(|node| above(*node));
            nodes.any(|node| top.contains(&node))
        };
        lies_below(&own, &others) || lies_below(&others, &own)
    };
    let mut left: Vec<&json::Skin> = document.root.skins.iter().collect();
    let mut bodies: Vec<Vec<&json::Skin>> = Vec::new();
    loop {
        let skins = left.iter().enumerate().rev();
        let main = skins.max_by_key(|(_, skin)| (is_moved(skin), skin.joints.len()));
        let main = main.filter(|(_, skin)| is_moved(skin) || bodies.is_empty());
        let Some((at, _)) = main else {
            return bodies;
        };
        let mut body = vec![left.remove(at)];
        while let Some(at) = left.iter().position(|skin| is_of_body(skin, &body)) {
            body.push(left.remove(at));
        }
        bodies.push(body);
    }
}

/// The joints of skins and the nodes above them.
pub(super) struct Skeleton {
    pub(super) names: Vec<String>,
    pub(super) parents: Vec<Option<usize>>,
    pub(super) locals: Vec<Local>,
    pub(super) bone_of_node: BTreeMap<usize, usize>,
    /// Bind pose of the joints, in the axes of the mesh; `None` if the skin has none.
    pub(super) bind: Option<Vec<Placed>>,
}

impl Skeleton {
    pub(super) fn read(
        document: &Document,
        tree: &Tree,
        skins: &[&json::Skin],
    ) -> Result<Self, Rejected> {
        let nodes = &document.root.nodes;
        let joints = skins.iter().flat_map(|skin| &skin.joints);
        let joints = joints.map(json::Index::value);
        if let Some(joint) = joints.clone().find(|joint| *joint >= nodes.len()) {
            return Err(rejected!(
                "E-GLTF-NODES",
                "the skin has joint {joint} of {} nodes",
                nodes.len()
            ));
        }
        let wanted = with_ancestors(&tree.parents, joints);
        let order = tree.order.iter().copied().filter(|&node| wanted[node]);
        let order: Vec<usize> = order.collect();
        if order.len() > MAX_BONES {
            return Err(limit("bones", order.len(), MAX_BONES));
        }
        let bone_of_node: BTreeMap<usize, usize> = order.iter().copied().zip(0..).collect();
        let locals: Vec<Local> = order.iter().map(|&node| Local::of(&nodes[node])).collect();
        if let Some(bone) = locals.iter().position(|local| !local.is_finite()) {
            return Err(rejected!(
                "E-NOT-FINITE",
                "node {} is not at a finite place",
                order[bone]
            ));
        }
        if let Some(bone) = locals.iter().position(Local::mirrors) {
            return Err(rejected!(
                "E-GLTF-SKELETON",
                "the scale of node {} is negative, which mirrors the body: apply the scale in the program that wrote the \
                 file",
                order[bone]
            ));
        }
        let nodes = order.iter().map(|&node| &nodes[node]);
        let names = nodes.map(|node| node.name.clone().unwrap_or_default());
        let parents = order.iter().map(|&node| tree.parents[node]);
        let parents = parents.map(|parent| bone_of_node.get(&parent?).copied());
        let mut skeleton = Self {
            names: names.collect(),
            parents: parents.collect(),
            locals,
            bone_of_node,
            bind: None,
        };
        for skin in skins.iter().rev() {
            if let Some(matrices) = &skin.inverse_bind_matrices {
                let matrices: Vec<[f64; 16]> = document.elements(matrices.value(), Type::Mat4)?;
                let placed = skeleton.bind.take().unwrap_or_else(|| skeleton.standing());
                skeleton.bind = Some(skeleton.bind_pose(skin, &matrices, placed)?);
            }
        }
        Ok(skeleton)
    }

    /// Places the joints of a skin in its bind pose.
    fn bind_pose(
        &self,
        skin: &json::Skin,
        inverse: &[[f64; 16]],
        mut placed: Vec<Placed>,
    ) -> Result<Vec<Placed>, Rejected> {
        if inverse.len() < skin.joints.len() {
            return Err(accessor_error(format!(
                "found {} inverse bind matrices, expected {} as the skin has joints",
                inverse.len(),
                skin.joints.len()
            )));
        }
        for (joint, matrix) in skin.joints.iter().zip(inverse) {
            let matrix = DMat4::from_cols_array(matrix).inverse();
            let Some(&bone) = self.bone_of_node.get(&joint.value()) else {
                continue;
            };
            // With a singular matrix the joint keeps the transform of its node.
            if matrix.is_finite() {
                placed[bone] = Placed {
                    position: matrix.w_axis.truncate(),
                    rotation: orientation(matrix),
                };
            }
        }
        Ok(placed)
    }

    /// The bones in the rest pose of the nodes.
    pub(super) fn standing(&self) -> Vec<Placed> {
        let mut worlds: Vec<World> = Vec::with_capacity(self.locals.len());
        for (local, parent) in self.locals.iter().zip(&self.parents) {
            let above = parent.map_or(World::ORIGIN, |parent| worlds[parent]);
            worlds.push(above.child(local));
        }
        worlds.into_iter().map(|world| world.placed).collect()
    }
}

/// The rotation of a matrix that may also scale.
fn orientation(matrix: DMat4) -> DQuat {
    let x = matrix.x_axis.truncate().normalize_or(DVec3::X);
    let y = matrix.y_axis.truncate();
    let y = (y - x * x.dot(y))
        .try_normalize()
        .unwrap_or_else(|| x.any_orthonormal_vector());
    DQuat::from_mat3(&DMat3::from_cols(x, y, x.cross(y)))
}
