//! Finding the body in a skeleton without known names, from the topology of its bones.

use glam::DVec3;
use kinematics::skeleton::NUM_BODY_JOINTS;

use super::rig::{Bone, Placed};

/// Limit on the children of a bone. The hips and chest of a body have three to six; every pair of them is tried.
const MAX_CHILDREN: usize = 16;
/// Minimum number of bones of a leg (hip, knee, ankle) and of an arm (shoulder, elbow, wrist).
const MIN_LEG: usize = 3;
const MIN_ARM: usize = 3;
/// Largest ratio of the lengths of the left and the right limb of one body.
const MAX_ASYMMETRY: f64 = 1.2;

/// A hip lies farther from the pelvis than this share of its leg.
const HELPER: f64 = 0.02;

/// A run of bones without branches, ending in a branching bone or a leaf.
type Chain = Vec<usize>;

/// The bone of each body joint, `[22]`; `None` if the skeleton does not look like a body.
///
/// The pelvis has two chains of equal length, the legs, and another child that leads to a bone with two more such
/// chains, the arms. The head is the highest of that bone's other chains. The toes point to the front, which determines
/// left and right.
pub(super) fn guess(
    bones: &[Bone<'_>],
    rest: &[Placed],
) -> Option<[Option<usize>; NUM_BODY_JOINTS]> {
    let mut children: Vec<Vec<usize>> = vec![Vec::new(); bones.len()];
    for (index, bone) in bones.iter().enumerate() {
        if let Some(parent) = bone.parent {
            children[parent].push(index);
        }
    }
    let tree = Tree { children, rest };
    (0..bones.len()).find_map(|pelvis| tree.body_at(pelvis))
}

struct Tree<'a> {
    children: Vec<Vec<usize>>,
    rest: &'a [Placed],
}

impl Tree<'_> {
    fn position(&self, bone: usize) -> DVec3 {
        self.rest[bone].position
    }

    /// The bones from this one down to the first that branches or ends.
    fn chain(&self, start: usize) -> Chain {
        let mut chain = vec![start];
        let mut last = start;
        while let [only] = self.children[last][..] {
            chain.push(only);
            last = only;
        }
        chain
    }

    fn length(&self, chain: &[usize]) -> f64 {
        chain
            .windows(2)
            .map(|pair| self.position(pair[0]).distance(self.position(pair[1])))
            .sum()
    }

    /// The two longest equal chains of at least `least` bones among the children of a bone.
    fn symmetric_pair(&self, bone: usize, least: usize) -> Option<[Chain; 2]> {
        let children = &self.children[bone];
        if children.len() > MAX_CHILDREN {
            return None;
        }
        let chains: Vec<Chain> = children
            .iter()
            .map(|&child| self.chain(child))
            .filter(|chain| chain.len() >= least)
            .collect();
        let mut best: Option<(f64, [Chain; 2])> = None;
        for (index, a) in chains.iter().enumerate() {
            for b in &chains[index + 1..] {
                let (long, short) = (self.length(&a[..least]), self.length(&b[..least]));
                let (long, short) = (long.max(short), long.min(short));
                let equal = a.len() == b.len() && short > 0.0 && long / short < MAX_ASYMMETRY;
                if equal && best.as_ref().is_none_or(|(length, _)| short > *length) {
                    best = Some((short, [a.clone(), b.clone()]));
                }
            }
        }
        best.map(|(_, pair)| pair)
    }

    fn body_at(&self, pelvis: usize) -> Option<[Option<usize>; NUM_BODY_JOINTS]> {
        let mut legs = self.symmetric_pair(pelvis, MIN_LEG)?;
        // Some rigs have an extra bone above each hip, at the place of the pelvis.
        let is_helper = |leg: &Chain| {
            let way = self.position(leg[0]).distance(self.position(pelvis));
            leg.len() > MIN_LEG && way < HELPER * self.length(leg)
        };
        while legs.iter().all(is_helper) {
            for leg in &mut legs {
                leg.remove(0);
            }
        }
        let middle = |pair: &[Chain; 2], at: usize| {
            self.position(pair[0][at])
                .midpoint(self.position(pair[1][at]))
        };
        let up = (middle(&legs, 0) - middle(&legs, 2)).try_normalize()?;
        let (spine, arms, top) = self.children[pelvis]
            .iter()
            .filter(|child| {
                legs.iter()
                    .all(|leg| !self.chain(**child).contains(&leg[0]))
            })
            .find_map(|&child| self.trunk(child, up))?;
        // Without toes, front and back, and so left and right, are ambiguous.
        let toes = |leg: &Chain| Some(self.position(*leg.get(3)?) - self.position(leg[2]));
        let front = toes(&legs[0])? + toes(&legs[1])?;
        let left = up.cross(front).try_normalize()?;
        let from_left = |[a, b]: [Chain; 2]| {
            let across = self.position(a[1]) - self.position(b[1]);
            match across.dot(left) > 0.0 {
                true => [a, b],
                false => [b, a],
            }
        };

        let mut body = [None; NUM_BODY_JOINTS];
        body[0] = Some(pelvis);
        for (leg, joints) in from_left(legs).iter().zip([[1, 4, 7, 10], [2, 5, 8, 11]]) {
            for (joint, &bone) in joints.into_iter().zip(leg) {
                body[joint] = Some(bone);
            }
        }
        for (arm, joints) in from_left(arms)
            .iter()
            .zip([[13, 16, 18, 20], [14, 17, 19, 21]])
        {
            // An arm of the minimum length has no collar.
            let first = usize::from(arm.len() == MIN_ARM);
            for (&joint, &bone) in joints[first..].iter().zip(arm) {
                body[joint] = Some(bone);
            }
        }
        for (joint, bone) in spine_joints(&spine) {
            body[joint] = Some(bone);
        }
        match top[..] {
            [head] => body[15] = Some(head),
            [neck, head, ..] => (body[12], body[15]) = (Some(neck), Some(head)),
            [] => {}
        }
        Some(body)
    }

    /// Spine, arms, neck and head below a child of the pelvis.
    fn trunk(&self, start: usize, up: DVec3) -> Option<(Chain, [Chain; 2], Chain)> {
        let spine = self.chain(start);
        let chest = *spine.last()?;
        let arms = self.symmetric_pair(chest, MIN_ARM)?;
        let height = |chain: &Chain| {
            let end = chain.last().copied().unwrap_or(chest);
            (self.position(end) - self.position(chest)).dot(up)
        };
        let top = self.children[chest]
            .iter()
            .filter(|child| arms.iter().all(|arm| arm[0] != **child))
            .map(|&child| self.chain(child))
            .filter(|chain| height(chain) > 0.0)
            .max_by(|a, b| height(a).total_cmp(&height(b)))?;
        Some((spine, arms, top))
    }
}

/// Maps the bones of a spine, lowest first, to joints: the highest is the chest.
pub(super) fn spine_joints(spine: &[usize]) -> Vec<(usize, usize)> {
    match *spine {
        [] => Vec::new(),
        [chest] => vec![(9, chest)],
        [lower, chest] => vec![(3, lower), (9, chest)],
        [lower, .., chest] => vec![(3, lower), (6, spine[spine.len() / 2]), (9, chest)],
    }
}
