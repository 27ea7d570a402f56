//! Converts keypoints to bones and back. Bones are the position of the pelvis, and a vector from each parent to its
//! child.

use burn::tensor::{Device, Tensor};
use kinematics::skeleton::parent_of;

use crate::model::position::Tables;

/// Number of coordinates of the pelvis, which come first in a frame of keypoints and in a frame of bones.
pub(crate) const ROOT_NUMBERS: usize = 3;

/// Coordinate `number` of the bones of a frame of keypoints: the keypoint minus its parent; the pelvis is unchanged.
pub(crate) fn bone_number(frame: &[f32], number: usize) -> f32 {
    if number < ROOT_NUMBERS {
        frame[number]
    } else {
        frame[number] - frame[parent_number(number)]
    }
}

/// Index of the parent keypoint's coordinate on the same axis.
pub(crate) fn parent_number(number: usize) -> usize {
    3 * parent_of(number / 3) + number % 3
}

/// The linear maps from the keypoints of a frame to its bones, and back.
///
/// # Shapes
/// Both `[3 keypoints, 3 keypoints]`, to be multiplied by frames as row vectors ([`mapped`]).
pub(crate) fn bones(keypoints: usize, device: &Device) -> [Tensor<2>; 2] {
    static TO_BONES: Tables = Tables::new(to_bones);
    static TO_POINTS: Tables = Tables::new(to_points);
    let width = 3 * keypoints;
    let numbers: Vec<usize> = (0..width).collect();
    [&TO_BONES, &TO_POINTS].map(|map| map.rows(&numbers, width, device))
}

/// Applies a linear map to all frames, as one matrix product.
///
/// # Shapes
/// `[B, W, D]` and `[D, D]` give `[B, W, D]`.
pub(crate) fn mapped(frames: Tensor<3>, map: Tensor<2>) -> Tensor<3> {
    let [batch, window, width] = frames.dims();
    let rows = frames.reshape([batch * window, width]);
    rows.matmul(map).reshape([batch, window, width])
}

/// Rows of the matrix that maps the keypoint coordinates of a frame to bone vectors.
fn to_bones(numbers: &[usize], width: usize) -> Vec<f32> {
    map_rows(numbers, width, |from, to| {
        if from == to {
            1.0
        } else if to > 0 && from == parent_of(to) {
            -1.0
        } else {
            0.0
        }
    })
}

/// Rows of the matrix that maps the bone vectors of a frame to keypoint coordinates.
fn to_points(numbers: &[usize], width: usize) -> Vec<f32> {
    map_rows(numbers, width, |from, to| {
        let mut ancestor = to;
        while ancestor != from && ancestor > 0 {
            ancestor = parent_of(ancestor);
        }
        if ancestor == from { 1.0 } else { 0.0 }
    })
}

/// Rows of a linear map of frames that is the same for x, y and z: each keypoint `to` becomes the sum over all
/// keypoints `from` of `weight(from, to)` times their position. A row number of at least `width` gives a row of zeros.
fn map_rows(numbers: &[usize], width: usize, weight: impl Fn(usize, usize) -> f32) -> Vec<f32> {
    let cell = |from: usize, to: usize| {
        if from < width && from % 3 == to % 3 {
            weight(from / 3, to / 3)
        } else {
            0.0
        }
    };
    numbers
        .iter()
        .flat_map(|&from| (0..width).map(move |to| cell(from, to)))
        .collect()
}

#[cfg(test)]
mod tests {
    use kinematics::skeleton::{Joint, NUM_BODY_JOINTS, NUM_KEYPOINTS};

    use super::*;
    use crate::sample::noise::normal;
    use crate::transfer::{read, send};

    #[test]
    fn a_frame_that_is_taken_to_bones_and_back_is_as_it_was() {
        let mut rng = datasets_spec::Seed(6).rng(&["bones"]);
        for device in [Device::flex(), Device::flex().autodiff()] {
            for keypoints in [NUM_BODY_JOINTS, NUM_KEYPOINTS] {
                let width = 3 * keypoints;
                let frame = normal(&mut rng, width);
                let points = send(frame.clone(), [1, 1, width], &device);
                let [to_bones, to_points] = bones(keypoints, &device);
                let bones = mapped(points, to_bones);
                let wrist = 3 * Joint::LeftWrist.index();
                let elbow = 3 * Joint::LeftElbow.index();
                assert_eq!(
                    read(bones.clone())[wrist + 1],
                    frame[wrist + 1] - frame[elbow + 1]
                );
                assert_eq!(
                    bone_number(&frame, wrist + 1),
                    frame[wrist + 1] - frame[elbow + 1]
                );
                for (back, was) in read(mapped(bones, to_points)).iter().zip(&frame) {
                    // The tolerance is the rounding error of sums of a dozen numbers of size one.
                    assert!((back - was).abs() < 1e-5, "{back} {was}");
                }
            }
        }
    }
}
