//! An array of 322 columns as a motion.

use datasets_spec::Skeleton;
use features::released_fps;
use glam::{DQuat, DVec3};
use kinematics::motion::BODY_POSE_WIDTH;
use kinematics::rotation::from_axis_angle;
use pickle::npy;

use crate::source::head::refuse_pointer;
use crate::source::humanml3d::check_length;
use crate::source::smpl::{Parameters, rotations_note};
use clip::{Rejected, RotationSource, SourceClip, rejected};

/// Columns of a frame: root 3, body 63, hands 90, jaw 3, expression 50, shape of the face 100, translation 3, betas 10.
pub(super) const WIDTH: usize = 322;
/// Number of columns of root and body, and the first column of the translation.
const POSE_WIDTH: usize = 3 + BODY_POSE_WIDTH;
const TRANSLATION_AT: usize = 309;
/// Frames per second of all motions: [`released_fps`] as a constant.
pub(super) const FPS: f64 = 30.0;

/// Reads an array as a motion of the given body. Hands, face and body shape are not used.
///
/// # Shapes
/// `[T, 322]`, rotation vectors in radians, metres, y up.
///
/// # Errors
/// Those of [`npy`], `E-LFS-POINTER`, `E-MOTIONX-SHAPE`, `E-NOT-FINITE` or `E-TOO-SHORT`.
pub fn read_array(bytes: &[u8], skeleton: &Skeleton) -> Result<SourceClip, Rejected> {
    refuse_pointer(bytes)?;
    let header = npy::Header::parse("array", bytes)?;
    let array = npy::read_numbers("array", bytes)?;
    let [num_frames, WIDTH] = array.shape[..] else {
        return Err(rejected!(
            "E-MOTIONX-SHAPE",
            "found an array of shape {:?}, expected [frames, {WIDTH}]",
            array.shape
        ));
    };
    check_length(num_frames)?;
    let used = |column: usize| {
        column < POSE_WIDTH || (TRANSLATION_AT..TRANSLATION_AT + 3).contains(&column)
    };
    let bad = |(at, value): &(usize, &f64)| used(at % WIDTH) && !(**value as f32).is_finite();
    if let Some((at, value)) = array.values.iter().enumerate().find(bad) {
        let (frame, column) = (at / WIDTH, at % WIDTH);
        let rejected = rejected!(
            "E-NOT-FINITE",
            "found {value} in frame {frame}, column {column}, expected finite numbers"
        );
        return Err(match header.place_of(at) {
            Some(place) => rejected.at(place),
            None => rejected,
        });
    }
    let (rows, _) = array.values.as_chunks::<WIDTH>();
    let parameters = Parameters::of_poses(
        rows.iter().map(|row| part(row, 0)),
        rows.iter().map(|row| part(row, TRANSLATION_AT)).collect(),
    )?;
    let motion = parameters.turned(DQuat::IDENTITY, released_fps(), skeleton)?;
    let mut clip = SourceClip::new(motion, RotationSource::Native);
    clip.notes = vec![
        format!(
            "SMPL-X parameters of Motion-X, {WIDTH} columns at {FPS} fps; hands, face and body \
                 shape are not used"
        ),
        rotations_note(skeleton),
    ];
    let up: DVec3 = rows
        .iter()
        .map(|row| from_axis_angle(DVec3::from_array([row[0], row[1], row[2]])) * DVec3::Y)
        .sum();
    if up.y < 0.0 {
        clip.notes.push(
            "the body is upside down on average, as in some clips of game_motion of the release"
                .to_owned(),
        );
    }
    Ok(clip)
}

fn part<const D: usize>(row: &[f64; WIDTH], start: usize) -> [f32; D] {
    std::array::from_fn(|column| row[start + column] as f32)
}
