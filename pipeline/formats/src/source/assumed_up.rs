//! Clips of files that state no up axis, and whose format is taken to have one.

use clip::check::FLAG_UP_DOUBTFUL;
use clip::{Rejected, SourceClip};
use datasets_spec::{Motion, Skeleton};
use features::floor;
use glam::DVec3;

use super::options::ReadOptions;
use super::smpl::turn_world;
use super::up::Up;
use crate::retarget::up_of_source;

/// Turns a clip, which was read as if `assumed` were up, to the up axis that the user names. Without a named axis, flags a
/// clip whose person stands along another one.
///
/// # Errors
/// `E-NOT-FINITE` if the turned motion is not finite.
pub(super) fn settle(
    clip: &mut SourceClip,
    assumed: Up,
    options: &ReadOptions,
) -> Result<(), Rejected> {
    let skeleton = &options.skeleton;
    match options.up {
        Some(up) if up != assumed => {
            let turn = up.turn() * assumed.turn().inverse();
            let mut poses = clip.motion.poses();
            for pose in &mut poses {
                turn_world(pose, turn, skeleton);
            }
            let fps = clip.motion.fps();
            floor::put_on_floor(&mut poses, fps, skeleton);
            clip.motion = Motion::from_poses(fps, &poses)
                .map_err(|error| Rejected::read("E-NOT-FINITE", error.to_string()))?;
            // Published features hold for the axis that was assumed.
            clip.features = None;
            clip.notes.push(format!("{up} is up in the file"));
        }
        Some(_) => {}
        None => {
            let (up, _) = up_of_source(mean_up(&clip.motion, skeleton));
            if up != Up::Y {
                clip.flags |= FLAG_UP_DOUBTFUL;
                clip.notes.push(format!(
                    "{assumed} was taken for the up axis, as the format has it, although the person does not stand along \
                     it; --up names another axis"
                ));
            }
        }
    }
    Ok(())
}

/// The direction from the hips to the head, averaged over frames spread over the motion.
fn mean_up(motion: &Motion, skeleton: &Skeleton) -> DVec3 {
    const FRAMES: usize = 64;
    let step = motion.len().div_ceil(FRAMES).max(1);
    let frames = (0..motion.len()).step_by(step);
    let count = frames.len().max(1) as f64;
    let sum: DVec3 = frames
        .map(|frame| {
            let points = skeleton.keypoints(&motion.pose(frame));
            (points[15] - points[1].midpoint(points[2])).normalize_or_zero()
        })
        .sum();
    sum / count
}

#[cfg(test)]
mod tests {
    use clip::RotationSource;
    use datasets_spec::Fps;
    use glam::DQuat;
    use testkit::walk;

    use super::*;

    /// A walk whose world is turned by this rotation.
    fn turned(turn: DQuat) -> SourceClip {
        let skeleton = Skeleton::smplx_neutral();
        let mut poses = walk(30);
        for pose in &mut poses {
            turn_world(pose, turn, &skeleton);
        }
        let motion = Motion::from_poses(Fps::STORE, &poses).expect("valid");
        SourceClip::new(motion, RotationSource::Native)
    }

    #[test]
    fn an_assumed_axis_is_doubted_where_nobody_stands_along_it_and_replaced_by_a_named_one() {
        let read = |clip: &SourceClip, up| {
            let mut clip = clip.clone();
            let options = ReadOptions {
                up,
                ..ReadOptions::default()
            };
            settle(&mut clip, Up::Y, &options).expect("finite");
            clip
        };
        let standing = turned(DQuat::IDENTITY);
        assert_eq!(read(&standing, None), standing);
        // In a file with z up that is read with y up, the person lies.
        let lying = turned(Up::Z.turn().inverse());
        assert_eq!(read(&lying, None).flags, FLAG_UP_DOUBTFUL);
        assert_eq!(read(&lying, Some(Up::Y)), lying);
        let named = read(&lying, Some(Up::Z));
        assert_eq!(named.flags, 0);
        let rise = mean_up(&named.motion, &Skeleton::smplx_neutral());
        assert!(rise.y > 0.9, "{rise}");
    }
}
