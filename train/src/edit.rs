//! Editing test items: from rows of table `items` to rows of table `edits`.

use std::borrow::Cow;
use std::collections::BTreeSet;

use burn::tensor::Device;
use datasets_spec::record::{EditRow, ItemRow};
use datasets_spec::{Fps, Motion, Skeleton};
use kinematics::KeypointFrame;
use kinematics::fit::{AdamFit, FitOptions, fit_motion_from};
use kinematics::skeleton::{Joint, KEYPOINT_JOINTS, NUM_BODY_JOINTS, NUM_KEYPOINTS};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::fit::EditorRecord;
use crate::j2s::{J2sPreset, PoseNet, Refinement, solve};
use crate::sample::{
    EditItem, EditSettings, EditTimes, Editor, FitMethod, TimedInstruction, keypoint_parent,
    model_frames,
};
use crate::{Error, Session};

/// Which system answers, and how: what tells its rows from those of others.
#[derive(Clone, Debug)]
pub struct SystemIdentity {
    /// Name in tables.
    pub name: String,
    /// What the system edits with, as a JSON object; its hash stands beside it in every row.
    pub settings: String,
}

impl SystemIdentity {
    /// What identifies the settings: BLAKE3, hexadecimal.
    pub fn settings_hash(&self) -> String {
        blake3::hash(self.settings.as_bytes()).to_hex().to_string()
    }
}

/// Warnings about edits: short clips and unknown words.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Remarks {
    /// Motions shorter than a window: they are edited with their last pose held, which is cut off
    /// again.
    pub num_short: usize,
    /// Words of the instructions that the editor has never seen.
    pub unknown_words: BTreeSet<String>,
}

impl Remarks {
    /// Looks at motions, as numbers of frames and rates, and at what is asked of them.
    pub fn of<'a>(
        editor: &EditorRecord,
        motions: impl IntoIterator<Item = (usize, Fps)>,
        texts: impl IntoIterator<Item = &'a str>,
    ) -> Self {
        let is_short = |(frames, fps): &(usize, Fps)| {
            model_frames(*frames, *fps, editor) < editor.train.window
        };
        Self {
            num_short: motions.into_iter().filter(is_short).count(),
            unknown_words: texts
                .into_iter()
                .flat_map(|text| editor.text.unknown_words(text))
                .collect(),
        }
    }
}

/// Edits the source of every item. The rows have the rate and the length of the sources. Beside them
/// comes where the time went. With one window at a time the fits take turns too, so that the times are those
/// of a single window.
///
/// # Errors
/// A source has no frame, a generated motion is not finite, or the fit asks for a pose network that
/// the editor has not.
///
/// # Source
/// Paper App. B.2 (windows) and B.3 (fit).
pub fn edit_items(
    editor: &Editor,
    system: &SystemIdentity,
    items: &[ItemRow],
    skeleton: &Skeleton,
    settings: &EditSettings,
    session: &Session<'_>,
) -> Result<(Vec<EditRow>, EditTimes), Error> {
    let fit = Fit::of(editor, settings)?;
    let record = &editor.record().config;
    let prepared: Vec<EditItem> = items
        .iter()
        .map(|item| {
            let source = item.source().map_err(motion_error(&item.id))?;
            EditItem::new(&item.id, &source, &item.instruction, skeleton, record)
        })
        .collect::<Result<_, _>>()?;
    let mut times = EditTimes::default();
    let edited = editor.edit_batch(&prepared, skeleton, settings, session, &mut times)?;
    let begun = session.secs();
    session.progress.begin("fit", Some(items.len() as u64));
    let in_turn = if settings.max_batch == 1 {
        items.len()
    } else {
        1
    };
    let rows: Vec<EditRow> = items
        .par_iter()
        .with_min_len(in_turn.max(1))
        .zip(prepared.par_iter().zip(&edited))
        .map(|(item, (prepared, frames))| {
            let made = fit.motion(prepared, frames, record.compose.config.fps, skeleton)?;
            session.progress.advance(1);
            Ok(edit_row(editor, system, item, &made, settings))
        })
        .collect::<Result<_, Error>>()?;
    times.fit_secs += session.secs() - begun;
    session
        .progress
        .finish(&format!("{} edited motions fitted", items.len()));
    Ok((rows, times))
}

/// How far generated points are from any body: they know no bones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Misfit {
    /// Mean distance in metres between the points and the fitted body.
    pub fit_error_m: f32,
    /// Mean distance in metres of the bones from their lengths in the body.
    pub bone_drift_m: f32,
}

impl Misfit {
    fn of(frames: &[KeypointFrame], error_m: &[f64], skeleton: &Skeleton) -> Self {
        let bones = 1..NUM_KEYPOINTS;
        let lengths: Vec<f64> = bones
            .clone()
            .map(|slot| skeleton.offset(KEYPOINT_JOINTS[slot]).length())
            .collect();
        let drift: f64 = frames
            .iter()
            .flat_map(|frame| {
                bones.clone().zip(&lengths).map(|(slot, length)| {
                    (frame[slot].distance(frame[keypoint_parent(slot)]) - length).abs()
                })
            })
            .sum();
        Self {
            fit_error_m: (error_m.iter().sum::<f64>() / error_m.len() as f64) as f32,
            bone_drift_m: (drift / (frames.len() * lengths.len()) as f64) as f32,
        }
    }
}

/// An edited motion.
#[derive(Clone, Debug, PartialEq)]
pub struct Edited {
    /// The motion, as long as the original, at 20 fps, or at the model's rate where that is higher.
    pub motion: Motion,
    /// How far the generated points are from a body.
    pub misfit: Misfit,
    /// Where the time went.
    pub times: EditTimes,
}

/// Edits one motion, of any rate, by instructions for parts of it or for the whole.
///
/// # Errors
/// The motion has no frame, an instruction has no frame of its own, the generated motion is not
/// finite, or the fit asks for a pose network that the editor has not.
pub fn edit_motion(
    editor: &Editor,
    id: &str,
    motion: &Motion,
    instructions: &[TimedInstruction],
    skeleton: &Skeleton,
    settings: &EditSettings,
    session: &Session<'_>,
) -> Result<Edited, Error> {
    let mut times = EditTimes::default();
    let record = &editor.record().config;
    let fit = Fit::of(editor, settings)?;
    let model_fps = record.compose.config.fps;
    let fps = if model_fps > Fps::STORE {
        model_fps
    } else {
        Fps::STORE
    };
    let item = EditItem::timed(id, motion, instructions, fps, skeleton, record)?;
    let items = [item];
    let edited = editor.edit_batch(&items, skeleton, settings, session, &mut times)?;
    let begun = session.secs();
    let (motion, misfit) = fit.motion(&items[0], &edited[0], model_fps, skeleton)?;
    times.fit_secs += session.secs() - begun;
    Ok(Edited {
        motion,
        misfit,
        times,
    })
}

/// Firmness in 1/rad^2 by which the exact fit holds generated points, as far as they are off the body,
/// to the frame before: motions are expected to differ by a fifth of a radian in a frame.
const CONTINUITY: f64 = 25.0;

/// How SMPL-X parameters are found for generated keypoints.
#[derive(Clone, Copy)]
pub struct Fit<'a> {
    /// The method.
    pub method: FitMethod,
    /// Weight in m^2/rad^2 by which the exact fit holds rotations to those it starts from.
    pub prior: f64,
    /// A network that guesses poses, and where it computes.
    pub poses: Option<(&'a PoseNet, &'a Device)>,
    /// Keypoints that were generated: all, or those of the body joints alone.
    pub keypoints: usize,
}

impl<'a> Fit<'a> {
    /// The fit of an editor.
    ///
    /// # Errors
    /// It asks for a pose network that the editor has not.
    fn of(editor: &'a Editor, settings: &EditSettings) -> Result<Self, Error> {
        if settings.fit == FitMethod::Paper && editor.poses().is_none() {
            return Err(Error::Misfit {
                what: "the published fit",
                problem:
                    "it starts from a pose network; train one (stance train j2s) and give its \
                          run with --poses"
                        .to_owned(),
            });
        }
        Ok(Self {
            method: settings.fit,
            prior: settings.prior,
            poses: editor.poses().map(|net| (net, editor.device())),
            keypoints: editor.record().config.train.keypoints,
        })
    }

    /// SMPL-X parameters of keypoints at the model's rate, at the rate and of the length of the item,
    /// and how far they are from the points.
    ///
    /// # Errors
    /// The points are not finite.
    pub fn motion(
        &self,
        item: &EditItem,
        frames: &[KeypointFrame],
        model_fps: Fps,
        skeleton: &Skeleton,
    ) -> Result<(Motion, Misfit), Error> {
        let mut frames = item.at_own_rate(frames, model_fps);
        if self.keypoints < NUM_KEYPOINTS {
            complete(&mut frames, item, skeleton)?;
        }
        let failed = motion_error(&item.id);
        if let (FitMethod::Paper, Some((net, device))) = (self.method, self.poses) {
            let fit = match net.preset() {
                J2sPreset::Paper => AdamFit::paper(),
                J2sPreset::Official => AdamFit::official(),
            };
            let poses = solve(net, &Refinement::Adam(fit), &frames, skeleton, device);
            let motion = Motion::from_poses(item.fps, &poses).map_err(failed)?;
            let errors: Vec<f64> = skeleton
                .points_of_poses::<NUM_KEYPOINTS>(&poses)
                .iter()
                .zip(&frames)
                .map(|(found, wanted)| {
                    let pairs = found.iter().zip(wanted);
                    pairs.map(|(a, b)| a.distance(*b)).sum::<f64>() / NUM_KEYPOINTS as f64
                })
                .collect();
            return Ok((motion, Misfit::of(&frames, &errors, skeleton)));
        }
        let options = FitOptions {
            smoothness: self.prior,
            continuity: CONTINUITY,
            ..FitOptions::default()
        };
        let twists = match self.poses {
            Some((net, device)) => Cow::Owned(net.poses(&frames, skeleton, device)),
            None => Cow::Borrowed(item.original.as_slice()),
        };
        let fitted =
            fit_motion_from(skeleton, &frames, &twists, item.fps, &options).map_err(failed)?;
        let misfit = Misfit::of(&frames, &fitted.error_m, skeleton);
        Ok((fitted.motion, misfit))
    }
}

/// Puts eyes and knuckles, which an editor of the body joints alone does not make, where the head and the
/// hands carry them when these are turned against neck and forearms as in the original.
fn complete(
    frames: &mut [KeypointFrame],
    item: &EditItem,
    skeleton: &Skeleton,
) -> Result<(), Error> {
    const CARRIERS: [Joint; 3] = [Joint::Head, Joint::LeftWrist, Joint::RightWrist];
    let options = FitOptions::body_joints();
    let fitted = fit_motion_from(skeleton, frames, &item.original, Fps::STORE, &options)
        .map_err(motion_error(&item.id))?;
    let poses = fitted.motion.poses();
    for ((frame, mut pose), original) in frames.iter_mut().zip(poses).zip(&item.original) {
        for joint in CARRIERS {
            pose.rotations[joint.index()] = original.rotations[joint.index()];
        }
        let points = skeleton.keypoints(&pose);
        for slot in NUM_BODY_JOINTS..NUM_KEYPOINTS {
            let parent = keypoint_parent(slot);
            frame[slot] = frame[parent] + (points[slot] - points[parent]);
        }
    }
    Ok(())
}

fn motion_error<E: Into<datasets_spec::Error>>(id: &str) -> impl Fn(E) -> Error {
    move |source| Error::Motion {
        id: id.to_owned(),
        source: source.into(),
    }
}

fn edit_row(
    editor: &Editor,
    system: &SystemIdentity,
    item: &ItemRow,
    (motion, misfit): &(Motion, Misfit),
    settings: &EditSettings,
) -> EditRow {
    EditRow {
        id: item.id.clone(),
        split: item.split,
        system: system.name.clone(),
        checkpoint_hash: editor.hash().to_owned(),
        settings_hash: system.settings_hash(),
        settings: system.settings.clone(),
        source_id: item.source_id.to_string(),
        target_id: item.target_id.to_string(),
        instruction: item.instruction.clone(),
        kind: item.task.clone(),
        seed: settings.seed.0,
        fps: motion.fps().get() as f32,
        n_frames: i32::try_from(motion.len()).unwrap_or(i32::MAX),
        transl: motion.transl().to_vec(),
        global_orient: motion.global_orient().to_vec(),
        body_pose: motion.body_pose().to_vec(),
        fit_error_m: Some(misfit.fit_error_m),
        bone_drift_m: Some(misfit.bone_drift_m),
    }
}
