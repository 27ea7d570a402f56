//! A motion cut into windows, and its frames at the edit's frame rate.

use std::ops::Range;
use std::sync::Arc;

use datasets_spec::{Fps, Motion, Pose, Resample, Skeleton};
use kinematics::KeypointFrame;
use kinematics::canonical::{FIXED_FRAMES, GroundTransform, canonicalise, motion_from_segment};
use kinematics::normalise::NormalizedFrame;
use kinematics::resample::{grid, interpolate, interpolate_all};
use serde::{Deserialize, Serialize};

use super::settings::FitMethod;
use crate::Error;
use crate::error::motion_error;
use crate::fit::EditorRecord;

/// An instruction for a range of frames of a motion.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TimedInstruction {
    /// The frames, at the motion's frame rate.
    pub frames: Range<usize>,
    /// Instruction of the range.
    pub text: String,
}

impl std::str::FromStr for TimedInstruction {
    type Err = String;

    /// Reads `FIRST:END TEXT`.
    fn from_str(asked: &str) -> Result<Self, String> {
        let parse = || {
            let (range, text) = asked.split_once(' ')?;
            let (first, end) = range.split_once(':')?;
            let frames = first.parse().ok()?..end.parse().ok()?;
            let text = text.trim().to_owned();
            (!text.is_empty()).then_some(Self { frames, text })
        };
        parse().ok_or_else(|| {
            format!("{asked:?} is not FIRST:END TEXT, such as \"0:40 The person is waving.\"")
        })
    }
}

/// A motion to edit, cut into windows at the model's rate.
#[derive(Clone, Debug, PartialEq)]
pub struct EditItem {
    /// Id of the item. Together with the seed it determines the noise.
    pub id: String,
    /// The windows, sorted by their first frames.
    pub windows: Vec<EditWindow>,
    /// Position and heading of the first window in the world.
    pub placement: GroundTransform,
    /// The original at the edit's frame rate; the edit has the same length. Bone twists, which keypoints do not
    /// determine, are taken from it.
    pub original: Vec<Pose>,
    /// Frame rate of the edit.
    pub fps: Fps,
}

/// A window to edit.
#[derive(Clone, Debug, PartialEq)]
pub struct EditWindow {
    /// The `W` canonical, normalised frames of the original.
    pub original: Vec<NormalizedFrame>,
    /// Instruction; without one, the window is kept unchanged.
    pub instruction: Option<Arc<str>>,
    /// Position of the window within the range of its instruction, in [0, 1].
    pub progress: f32,
    /// First frame of the window, at the model's rate. The window overwrites earlier output from its third frame on,
    /// except for frames that it is blended with.
    pub start: usize,
    /// Number of leading frames that are used, including the fixed ones; less than `W` only if the instruction or the
    /// motion ends within the window.
    pub used: usize,
}

/// A range of frames at the model's rate with the same instruction, or none.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Span {
    frames: Range<usize>,
    instruction: Option<usize>,
}

impl EditItem {
    /// Cuts a motion into windows, each with the instruction of its frames. A frame belongs to the first instruction
    /// that covers it; frames without one are kept unchanged. `fps` is the frame rate of the edit.
    ///
    /// The windows of an instruction generate its range from the first to the last frame. If a window would extend
    /// beyond the end of the motion, it begins earlier and replaces frames of the previous window. If the range does
    /// not reach back that far, or the motion is shorter than a window, the window is filled with copies of the last
    /// pose, and these frames are cut off afterwards.
    ///
    /// # Errors
    /// The motion has no frame, a range is empty or ends after the motion, or earlier instructions cover all frames of
    /// an instruction.
    ///
    /// # Source
    /// Paper, App. B.2, and App. E.1 (time-variant editing); the assignment of instructions to windows is not
    /// published. Windows advance by the frames that each adds; the released demo advances by 31 raw frames, which
    /// drifts relative to the generated motion (`algorithms` section 8).
    pub fn timed(
        id: impl Into<String>,
        motion: &Motion,
        instructions: &[TimedInstruction],
        fps: Fps,
        skeleton: &Skeleton,
        editor: &EditorRecord,
    ) -> Result<Self, Error> {
        let id = id.into();
        let refused = |problem: String| Error::item(id.clone(), problem);
        check_ranges(motion, instructions).map_err(&refused)?;
        let (model_fps, anchor) = (editor.compose.config.fps, editor.compose.config.anchor);
        let original = Resample::Exact
            .apply(motion, fps)
            .map_err(motion_error(&id))?
            .poses();
        let mut poses = covering(motion, model_fps);
        let num_frames = poses.len();
        let Some(&last_pose) = poses.last() else {
            return Err(refused("has no frame".to_owned()));
        };
        let to_model = model_fps.get() / motion.fps().get();
        let spans = spans(num_frames, motion.len(), to_model, instructions);
        check_heard(&spans, instructions, model_fps).map_err(&refused)?;
        let overlap = editor.train.diffusion.overlap;
        let places: Vec<Place> = spans
            .iter()
            .flat_map(|span| {
                // Unchanged windows do not overlap earlier output.
                let overlap = span.instruction.map_or(0, |_| overlap);
                places(span, num_frames, editor.train.window, overlap)
            })
            .collect();
        let needed = places.iter().map(|place| place.start + editor.train.window);
        poses.resize(needed.max().unwrap_or(0).max(num_frames), last_pose);
        let texts: Vec<Arc<str>> = instructions
            .iter()
            .map(|asked| asked.text.as_str().into())
            .collect();
        let windows = places
            .into_iter()
            .map(|place| {
                let progress = place.instruction.map_or(0.0, |index| {
                    let Range { start: begin, end } = instructions[index].frames;
                    let length = (end - begin) as f64 * to_model;
                    ((place.start as f64 - begin as f64 * to_model) / length).clamp(0.0, 1.0)
                });
                let segment = poses[place.start..place.start + editor.train.window].to_vec();
                EditWindow {
                    original: model_units(segment, skeleton, editor),
                    instruction: place.instruction.map(|index| Arc::clone(&texts[index])),
                    progress: progress as f32,
                    start: place.start,
                    used: place.used,
                }
            })
            .collect();
        Ok(Self {
            windows,
            placement: motion_from_segment(&poses[0], anchor, skeleton),
            original,
            fps,
            id,
        })
    }

    /// Resamples keypoints from the model's rate to that of the edit, and to the length of the original. The published
    /// fit interpolates each coordinate linearly. The exact fit uses a Catmull-Rom spline, because with linear
    /// interpolation the velocity jumps at every model frame.
    ///
    /// # Panics
    /// If the frames do not cover the original.
    pub fn at_own_rate(
        &self,
        frames: &[KeypointFrame],
        model_fps: Fps,
        fit: FitMethod,
    ) -> Vec<KeypointFrame> {
        let step = model_fps.get() / self.fps.get();
        (0..self.original.len())
            .map(|frame| {
                let at = frame as f64 * step;
                // The tolerance covers rounding in the quotient of rates.
                let before = (at + 1e-6).floor() as usize;
                let share = (at - before as f64).max(0.0);
                if share < 1e-6 {
                    return frames[before];
                }
                match fit {
                    FitMethod::Paper => std::array::from_fn(|slot| {
                        frames[before][slot].lerp(frames[before + 1][slot], share)
                    }),
                    FitMethod::Exact => catmull_rom(frames, before, share),
                }
            })
            .collect()
    }
}

/// Checks that all ranges lie in a motion.
///
/// # Errors
/// Describes the first wrong range.
pub(crate) fn check_ranges(
    motion: &Motion,
    instructions: &[TimedInstruction],
) -> Result<(), String> {
    for asked in instructions {
        let Range { start, end } = asked.frames;
        if start >= end || end > motion.len() {
            return Err(format!(
                "has {} frames, which the range {start}:{end} of {:?} does not fit",
                motion.len(),
                asked.text
            ));
        }
    }
    Ok(())
}

/// Checks that every instruction applies to at least one frame.
///
/// # Errors
/// Names the first instruction without frames.
fn check_heard(
    spans: &[Span],
    instructions: &[TimedInstruction],
    model_fps: Fps,
) -> Result<(), String> {
    for (index, asked) in instructions.iter().enumerate() {
        if spans.iter().all(|span| span.instruction != Some(index)) {
            let Range { start, end } = asked.frames;
            return Err(format!(
                "has no frame of its own for {start}:{end} {:?}: at {model_fps} all of them \
                 belong to instructions before it; widen the range",
                asked.text
            ));
        }
    }
    Ok(())
}

fn model_units(
    mut segment: Vec<Pose>,
    skeleton: &Skeleton,
    editor: &EditorRecord,
) -> Vec<NormalizedFrame> {
    canonicalise(&mut segment, editor.compose.config.anchor, skeleton);
    segment
        .iter()
        .map(|pose| editor.normalizer.normalize(&skeleton.keypoints(pose)))
        .collect()
}

/// A Catmull-Rom spline through frames, between `before` and the next frame. Beyond the ends, it continues the parabola
/// through the three frames at that end.
fn catmull_rom(frames: &[KeypointFrame], before: usize, share: f64) -> KeypointFrame {
    let after = before + 1;
    let (b, c) = (&frames[before], &frames[after]);
    if frames.len() == 2 {
        return std::array::from_fn(|slot| b[slot].lerp(c[slot], share));
    }
    let beyond = |end: &KeypointFrame, next: &KeypointFrame, third: &KeypointFrame| {
        std::array::from_fn(|slot| 3.0 * (end[slot] - next[slot]) + third[slot])
    };
    let a = match before.checked_sub(1) {
        Some(first) => frames[first],
        None => beyond(b, c, &frames[after + 1]),
    };
    let d = match frames.get(after + 1) {
        Some(last) => *last,
        None => beyond(c, b, &a),
    };
    let (t, t2, t3) = (share, share * share, share * share * share);
    let weights = [
        0.5 * (-t3 + 2.0 * t2 - t),
        0.5 * (3.0 * t3 - 5.0 * t2 + 2.0),
        0.5 * (-3.0 * t3 + 4.0 * t2 + t),
        0.5 * (t3 - t2),
    ];
    std::array::from_fn(|slot| {
        a[slot] * weights[0] + b[slot] * weights[1] + c[slot] * weights[2] + d[slot] * weights[3]
    })
}

/// Number of frames at the model's rate that cover a motion.
pub fn model_frames(num_frames: usize, fps: Fps, editor: &EditorRecord) -> usize {
    let to_model = editor.compose.config.fps.get() / fps.get();
    match num_frames.checked_sub(1) {
        Some(last) => (last as f64 * to_model - 1e-6).ceil() as usize + 1,
        None => 0,
    }
}

/// Resamples the poses of a motion to another rate, over its whole length. If the last frame lies between two resampled
/// frames, the second one is extrapolated, from the pose at the same distance before the end.
pub(crate) fn covering(motion: &Motion, fps: Fps) -> Vec<Pose> {
    let poses = motion.poses();
    let Some(last) = poses.len().checked_sub(1) else {
        return poses;
    };
    let mut out = interpolate_all(&poses, &grid(poses.len(), motion.fps(), fps));
    let step = motion.fps().get() / fps.get();
    let missing = out.len() as f64 * step - last as f64;
    if missing < step * (1.0 - 1e-6) && missing > 0.0 {
        let mirrored = last as f64 - missing;
        let pose = if mirrored < 0.0 {
            poses[last]
        } else {
            let place = (mirrored.floor() as usize, mirrored.fract());
            let before = interpolate_all(&poses, &[place])[0];
            interpolate(&before, &poses[last], 2.0)
        };
        out.push(pose);
    }
    out
}

/// The spans of a motion that has `num_frames` frames at the model's rate, and `length` frames at its own.
fn spans(
    num_frames: usize,
    length: usize,
    to_model: f64,
    instructions: &[TimedInstruction],
) -> Vec<Span> {
    let owner = |frame: usize| {
        // Frames after the end have the instruction of the last frame.
        let at = (frame as f64 / to_model).min((length - 1) as f64) + 1e-6;
        instructions
            .iter()
            .position(|asked| (asked.frames.start as f64) <= at && at < asked.frames.end as f64)
    };
    let mut spans: Vec<Span> = Vec::new();
    for frame in 0..num_frames {
        let instruction = owner(frame);
        match spans.last_mut() {
            Some(span) if span.instruction == instruction => span.frames.end = frame + 1,
            // Generated frames need two fixed frames before them, so an instruction that starts at the second frame is
            // extended to the first.
            Some(span) if span.frames.end < FIXED_FRAMES => {
                span.frames.end = frame + 1;
                span.instruction = instruction;
            }
            _ => spans.push(Span {
                frames: frame..frame + 1,
                instruction,
            }),
        }
    }
    spans
}

/// Position of a window in its motion at the model's rate, and its instruction.
#[derive(Clone, Copy)]
struct Place {
    start: usize,
    used: usize,
    instruction: Option<usize>,
}

/// The windows that generate the frames of a span, for a motion of `num_frames` frames. Each window except the first
/// generates the last `overlap` frames before it again.
fn places(span: &Span, num_frames: usize, window: usize, overlap: usize) -> Vec<Place> {
    let frames = &span.frames;
    let mut places = Vec::new();
    let mut next = frames.start;
    while next < frames.end {
        let natural = next.saturating_sub(FIXED_FRAMES);
        let latest = num_frames.saturating_sub(window);
        let is_free = latest + FIXED_FRAMES >= frames.start;
        let start = if natural > latest && is_free {
            latest
        } else {
            natural
        };
        let used = (frames.end - start).min(window);
        places.push(Place {
            start,
            used,
            instruction: span.instruction,
        });
        let end = start + used;
        if end == frames.end {
            break;
        }
        next = end - overlap;
    }
    places
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use kinematics::skeleton::NUM_KEYPOINTS;
    use proptest::prelude::*;

    use super::*;

    fn cubic(coefficients: [DVec3; 4], t: f64) -> DVec3 {
        let [a, b, c, d] = coefficients;
        a + t * (b + t * (c + t * d))
    }

    fn vector() -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(-1.0..1.0).prop_map(DVec3::from_array)
    }

    proptest! {
        #[test]
        fn the_spline_follows_parabolas_and_passes_through_its_frames(
            coefficients in prop::array::uniform3(vector()),
            num_frames in 3usize..7,
            place in 0.0..1.0f64,
        ) {
            let [a, b, c] = coefficients;
            let parabola = |t| [cubic([a, b, c, DVec3::ZERO], t); NUM_KEYPOINTS];
            let frames: Vec<KeypointFrame> = (0..num_frames).map(|at| parabola(at as f64)).collect();
            let at = place * (num_frames - 1) as f64;
            let before = (at.floor() as usize).min(num_frames - 2);
            // A Catmull-Rom spline reproduces parabolas, and ours continues as a parabola beyond the ends. Numbers
            // reach 50 and are rounded a dozen times.
            let found = catmull_rom(&frames, before, at - before as f64);
            prop_assert!(found[3].distance(parabola(at)[3]) < 1e-12, "{at}");
            for (share, frame) in [(0.0, before), (1.0, before + 1)] {
                let found = catmull_rom(&frames, before, share);
                prop_assert!(found[0].distance(frames[frame][0]) < 1e-12, "{frame}");
            }
        }

        #[test]
        fn the_speed_of_the_spline_does_not_jump_at_a_frame(
            points in prop::collection::vec(vector(), 4..7),
            place in 0.0..1.0f64,
        ) {
            const STEP: f64 = 1e-6;
            let frames: Vec<KeypointFrame> = points.iter().map(|point| [*point; NUM_KEYPOINTS]).collect();
            let frame = 1 + (place * (frames.len() - 2) as f64) as usize;
            let middle = frames[frame][0];
            let before = middle - catmull_rom(&frames, frame - 1, 1.0 - STEP)[0];
            let after = catmull_rom(&frames, frame, STEP)[0] - middle;
            // For coordinates in [-1, 1], second derivatives are at most 40.
            prop_assert!((after - before).length() / STEP < 40.0 * 2.0 * STEP);
        }
    }

    #[test]
    fn two_frames_are_joined_by_a_line() {
        let frames = [[DVec3::ZERO; NUM_KEYPOINTS], [DVec3::ONE; NUM_KEYPOINTS]];
        assert_eq!(catmull_rom(&frames, 0, 0.25)[27], DVec3::splat(0.25));
    }
}
