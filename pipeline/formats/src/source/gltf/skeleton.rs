//! The skeleton of a skin: its joints, the nodes above them, and the bind pose.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

use glam::{DMat3, DMat4, DQuat, DVec3};
use gltf::json;
use gltf::json::accessor::Type;

use super::document::{Document, NO_BODY, accessor_error, limit};
use super::nodes::{Local, Tree, World};
use crate::retarget::{Placed, with_ancestors};
use clip::{Rejected, rejected};

/// Limit on bones: joints of the skin and the nodes above them.
const MAX_BONES: usize = 4096;

/// The skins of a file, sorted into bodies: skins whose joints are ancestors or descendants of each other belong to one
/// body, such as gloves and trousers.
pub(super) struct Skins<'a> {
    skins: &'a [json::Skin],
    nodes: &'a [json::Node],
    tree: &'a Tree,
    /// The skins that have a node as a joint, by node.
    of_joint: BTreeMap<usize, Vec<usize>>,
    /// The body of each skin, as the number of one of its skins.
    bodies: Vec<usize>,
}

/// The nodes and skins that a search for bodies has seen. One for all bodies keeps the search linear: a node that was
/// seen for an earlier body leads to no further skin.
#[derive(Default)]
struct Seen {
    above: BTreeSet<usize>,
    below: BTreeSet<usize>,
    skins: BTreeSet<usize>,
}

impl<'a> Skins<'a> {
    pub(super) fn of(document: &'a Document<'_>, tree: &'a Tree) -> Self {
        let (skins, nodes) = (&document.root.skins, &document.root.nodes);
        let mut of_joint: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for (number, skin) in skins.iter().enumerate() {
            for joint in &skin.joints {
                of_joint.entry(joint.value()).or_default().push(number);
            }
        }
        let mut sorted = Self {
            skins,
            nodes,
            tree,
            of_joint,
            bodies: (0..skins.len()).collect(),
        };
        let mut seen = Seen::default();
        for first in 0..skins.len() {
            if !seen.skins.contains(&first) {
                for skin in sorted.search(first, &mut seen) {
                    sorted.bodies[skin] = first;
                }
            }
        }
        sorted
    }

    /// The first skin of each body that an animation moves, or of one body if it moves none. The first skin of a body is
    /// the one with the most joints among those that the animation moves, and the first body that of the largest such
    /// skin.
    pub(super) fn moved_by(&self, animation: &json::Animation) -> Vec<usize> {
        let channels = animation.channels.iter();
        let nodes: BTreeSet<usize> = channels
            .map(|channel| channel.target.node.value())
            .collect();
        let skins = nodes.iter().filter_map(|node| self.of_joint.get(node));
        let moved: BTreeSet<usize> = skins.flatten().copied().collect();
        let num_joints = |skin: &usize| self.skins[*skin].joints.len();
        if moved.is_empty() {
            let largest = (0..self.skins.len()).rev().max_by_key(num_joints);
            return Vec::from_iter(largest);
        }
        let mut mains = Vec::from_iter(moved);
        mains.sort_by_key(|skin| Reverse(num_joints(skin)));
        let mut bodies = BTreeSet::new();
        mains.retain(|skin| bodies.insert(self.bodies[*skin]));
        mains
    }

    /// The skins of a body, `main` first.
    pub(super) fn of_body(&self, main: usize) -> Vec<&'a json::Skin> {
        let body = self.search(main, &mut Seen::default()).into_iter();
        body.map(|skin| &self.skins[skin]).collect()
    }

    /// The skins of a body. `main` comes first; the next is always the first skin of the file that is connected to one
    /// found before.
    fn search(&self, main: usize, seen: &mut Seen) -> Vec<usize> {
        let mut body = Vec::new();
        let mut next = BTreeSet::from([main]);
        seen.skins.insert(main);
        while let Some(skin) = next.pop_first() {
            body.push(skin);
            for joint in &self.skins[skin].joints {
                let skins = self.unseen_nodes(joint.value(), seen).into_iter();
                let skins = skins.filter_map(|node| self.of_joint.get(&node));
                next.extend(skins.flatten().filter(|skin| seen.skins.insert(**skin)));
            }
        }
        body
    }

    /// The node itself, its ancestors and its descendants, as far as the search has not seen them.
    fn unseen_nodes(&self, node: usize, seen: &mut Seen) -> Vec<usize> {
        let parent = |node: &usize| self.tree.parents.get(*node).copied().flatten();
        let mut nodes: Vec<usize> = std::iter::successors(Some(node), parent)
            .take_while(|node| seen.above.insert(*node))
            .collect();
        let mut below = vec![node];
        while let Some(node) = below.pop() {
            if seen.below.insert(node) {
                nodes.push(node);
                let children = self.nodes.get(node).and_then(|node| node.children.as_ref());
                below.extend(children.into_iter().flatten().map(json::Index::value));
            }
        }
        nodes
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
                NO_BODY,
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
