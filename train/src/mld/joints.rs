//! Differentiable joint positions of HumanML3D features.

use burn::tensor::{Device, Tensor};
use datasets_spec::record::HUMANML3D_WIDTH;
use kinematics::skeleton::NUM_BODY_JOINTS;

use crate::transfer::send;

/// The joint positions of features, like those of [`features::humanml3d::recover_joints`].
///
/// # Shapes
/// `[B, T, 263]`, not normalised, give `[B, T, 66]`.
pub fn recovered_joints(features: Tensor<3>) -> Tensor<3> {
    let [batch, frames, width] = features.dims();
    assert_eq!(width, HUMANML3D_WIDTH, "features of HumanML3D");
    let device = features.device();
    let column = |index: usize| features.clone().narrow(2, index, 1);
    // A frame's heading is the sum of the earlier yaw velocities, which are half angles.
    let earlier = sums(frames, |from, to| from < to, &device).expand([batch, frames, frames]);
    let angle = earlier.matmul(column(0)).mul_scalar(2.0);
    let (cosine, sine) = (angle.clone().cos(), angle.sin());
    let turned = |x: Tensor<3>, z: Tensor<3>| {
        let (cosine, sine) = (cosine.clone(), sine.clone());
        (
            x.clone() * cosine.clone() - z.clone() * sine.clone(),
            z * cosine + x * sine,
        )
    };
    // The root moves by the previous frame's velocity, rotated to the heading of its own frame.
    let before = sums(frames, |from, to| from + 1 == to, &device).expand([batch, frames, frames]);
    let (x, z) = turned(before.clone().matmul(column(1)), before.matmul(column(2)));
    let until = sums(frames, |from, to| from <= to, &device).expand([batch, frames, frames]);
    let (root_x, root_z) = (until.clone().matmul(x), until.matmul(z));

    let mut joints = vec![root_x.clone(), column(3), root_z.clone()];
    let others = NUM_BODY_JOINTS - 1;
    let positions = features
        .clone()
        .narrow(2, 4, 3 * others)
        .reshape([batch, frames, others, 3]);
    let axis = |axis: usize| positions.clone().narrow(3, axis, 1).squeeze_dim::<3>(3);
    let (x, z) = turned(axis(0), axis(2));
    let placed = Tensor::stack::<4>(vec![x + root_x, axis(1), z + root_z], 3);
    joints.push(placed.reshape([batch, frames, 3 * others]));
    Tensor::cat(joints, 2)
}

/// A matrix that sums, for each frame `to`, the frames `from` that `is_added` selects, `[1, T, T]`.
fn sums(frames: usize, is_added: impl Fn(usize, usize) -> bool, device: &Device) -> Tensor<3> {
    let values: Vec<f32> = (0..frames)
        .flat_map(|to| (0..frames).map(move |from| (from, to)))
        .map(|(from, to)| f32::from(u8::from(is_added(from, to))))
        .collect();
    send(values, [1, frames, frames], device)
}

#[cfg(test)]
mod tests {
    use features::humanml3d::{Features, recover_joints};

    use super::*;
    use crate::transfer::read;

    #[test]
    fn joints_are_those_of_the_recipe() {
        let features: Vec<Features> = (0..40)
            .map(|frame| {
                std::array::from_fn(|column| {
                    let place = (frame * 7 + column * 3) as f32;
                    // Root velocities are small.
                    0.3 * (place * 0.37).sin() * if column < 3 { 0.1 } else { 1.0 }
                })
            })
            .collect();
        let shape = [2, 20, HUMANML3D_WIDTH];
        let sent = send(features.as_flattened().to_vec(), shape, &Device::flex());
        let found = read(recovered_joints(sent));
        let expected = [&features[..20], &features[20..]].map(recover_joints);
        let expected = expected.iter().flatten().flatten();
        for (found, expected) in found.chunks_exact(3).zip(expected) {
            for (found, expected) in found.iter().zip(expected.to_array()) {
                assert!(
                    (f64::from(*found) - expected).abs() < 1e-5,
                    "{found} {expected}"
                );
            }
        }
    }
}
