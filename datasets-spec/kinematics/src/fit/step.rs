//! Levenberg-Marquardt steps: residuals, the normal equations, and their solution.

use glam::{DMat3, DVec3};

use super::body::{Body, Fitter, Step};
use super::tree::{MAX_CHAIN, TREE};
use crate::pose::KeypointFrame;
use crate::rotation::to_axis_angle;
use crate::skeleton::{NUM_BODY_JOINTS, NUM_KEYPOINTS, parent_of};

/// Positions and residuals of a body.
pub(super) struct Evaluation {
    /// Each point relative to its parent, in world axes; unused for the pelvis.
    pub(super) bones: [DVec3; NUM_KEYPOINTS],
    pub(super) points: KeypointFrame,
    /// Weighted residuals, summed over the subtree of each point.
    pub(super) pulls: [DVec3; NUM_KEYPOINTS],
    /// Rotation vectors from the prior to the body; zero if there is no prior.
    pub(super) drift: [DVec3; NUM_BODY_JOINTS],
    pub(super) cost: f64,
}

impl Fitter<'_> {
    pub(super) fn evaluate(
        &self,
        body: &Body,
        target: &KeypointFrame,
        prior: Option<&Body>,
        held: f64,
    ) -> Evaluation {
        let mut bones = [DVec3::ZERO; NUM_KEYPOINTS];
        let mut points = [body.pelvis; NUM_KEYPOINTS];
        let mut pulls = [DVec3::ZERO; NUM_KEYPOINTS];
        let mut cost = 0.0;
        for slot in 0..NUM_KEYPOINTS {
            if slot > 0 {
                let parent = parent_of(slot);
                bones[slot] = body.global[parent] * self.offsets[slot];
                points[slot] = points[parent] + bones[slot];
            }
            let residual = target[slot] - points[slot];
            pulls[slot] = residual * self.options.weights[slot];
            cost += residual.dot(pulls[slot]);
        }
        for slot in (1..NUM_KEYPOINTS).rev() {
            let pull = pulls[slot];
            pulls[parent_of(slot)] += pull;
        }
        let mut drift = [DVec3::ZERO; NUM_BODY_JOINTS];
        if let Some(prior) = prior {
            for (drift, (now, before)) in
                drift.iter_mut().zip(body.global.iter().zip(&prior.global))
            {
                *drift = to_axis_angle(*now * before.inverse());
                cost += held * drift.length_squared();
            }
        }
        Evaluation {
            bones,
            points,
            pulls,
            drift,
            cost,
        }
    }

    /// Solves `(J^T W J + (held + damping) I) x = J^T W r` by eliminating the joints from the
    /// leaves to the root.
    ///
    /// A rotation vector `w` at joint `a` moves every point beyond its child `c` by `w x v`, where `v` is
    /// the bone to `c`. So the coupling of `j` with an ancestor `a`, whose bone towards `j` is `v`, is
    /// `(V . v) I - v V^T`, where `V` sums the bones of `j`, weighted by their subtrees.
    ///
    /// With `curved`, the diagonal blocks include the second derivative that Gauss-Newton leaves out: the pulls along
    /// the bones. It is large for targets off the skeleton, where convergence is linear without it.
    pub(super) fn step(&self, now: &Evaluation, damping: f64, curved: bool, held: f64) -> Step {
        let ridge = DMat3::from_diagonal(DVec3::splat(damping + held));
        let mut diagonal = [ridge; NUM_BODY_JOINTS];
        let mut coupling = [[DMat3::ZERO; MAX_CHAIN]; NUM_BODY_JOINTS];
        let mut gradient = [DVec3::ZERO; NUM_BODY_JOINTS];
        for joint in 0..NUM_BODY_JOINTS {
            let mut weighted = DVec3::ZERO;
            for &child in TREE.children(joint) {
                let (bone, weight) = (now.bones[child], self.subtree_weights[child]);
                let pull = match (curved, TREE.num_children[joint]) {
                    (false, _) => DVec3::ZERO,
                    // For an only child, the pull across its bone is left out: it vanishes at the minimum, and
                    // elsewhere it would move the free twist.
                    (true, 1) => now.pulls[child].project_onto(bone),
                    (true, _) => now.pulls[child],
                };
                let square = bone.length_squared() * weight + bone.dot(pull);
                let mixed = (outer(bone, pull) + outer(pull, bone)) * 0.5;
                diagonal[joint] +=
                    DMat3::from_diagonal(DVec3::splat(square)) - outer(bone, bone) * weight - mixed;
                gradient[joint] += bone.cross(now.pulls[child]);
                weighted += bone * weight;
            }
            gradient[joint] -= now.drift[joint] * held;
            // Slot 0 couples to the translation, slot d + 1 to the ancestor at depth d.
            coupling[joint][0] = cross_matrix(weighted);
            let chain = &TREE.chain[joint];
            for depth in 0..TREE.depth[joint] {
                let bone = now.bones[chain[depth + 1]];
                coupling[joint][depth + 1] =
                    DMat3::from_diagonal(DVec3::splat(weighted.dot(bone))) - outer(bone, weighted);
            }
        }
        let mut shift_diagonal =
            DMat3::from_diagonal(DVec3::splat(self.subtree_weights[0] + damping));
        let mut shift_gradient = now.pulls[0];

        let mut gain = [[DMat3::ZERO; MAX_CHAIN]; NUM_BODY_JOINTS];
        for joint in (0..NUM_BODY_JOINTS).rev() {
            let inverse = diagonal[joint].inverse();
            gradient[joint] = inverse * gradient[joint];
            let num_coupled = TREE.depth[joint] + 1;
            for slot in 0..num_coupled {
                gain[joint][slot] = inverse * coupling[joint][slot];
            }
            for row in 0..num_coupled {
                let transposed = coupling[joint][row].transpose();
                let diagonal_change = transposed * gain[joint][row];
                let gradient_change = transposed * gradient[joint];
                if row == 0 {
                    shift_diagonal -= diagonal_change;
                    shift_gradient -= gradient_change;
                    continue;
                }
                let ancestor = TREE.chain[joint][row - 1];
                diagonal[ancestor] -= diagonal_change;
                gradient[ancestor] -= gradient_change;
                for slot in 0..row {
                    coupling[ancestor][slot] -= transposed * gain[joint][slot];
                }
            }
        }
        let shift = shift_diagonal.inverse() * shift_gradient;
        let mut turns = gradient;
        for joint in 0..NUM_BODY_JOINTS {
            let mut turn = turns[joint] - gain[joint][0] * shift;
            for depth in 0..TREE.depth[joint] {
                turn -= gain[joint][depth + 1] * turns[TREE.chain[joint][depth]];
            }
            turns[joint] = turn;
        }
        Step { shift, turns }
    }
}

/// The matrix `a b^T`.
fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

/// The matrix of `u -> v x u`.
fn cross_matrix(v: DVec3) -> DMat3 {
    DMat3::from_cols(
        DVec3::new(0.0, v.z, -v.y),
        DVec3::new(-v.z, 0.0, v.x),
        DVec3::new(v.y, -v.x, 0.0),
    )
}
