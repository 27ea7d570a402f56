//! Editing test items: from rows of table `items` to rows of table `edits`.

use datasets_spec::canonical::KeypointFrame;
use datasets_spec::fit::{FitOptions, fit_motion_from};
use datasets_spec::record::{EditRow, ItemRow};
use datasets_spec::resample::double_rate;
use datasets_spec::skeleton::{Joint, KEYPOINT_JOINTS, NUM_BODY_JOINTS, NUM_KEYPOINTS};
use datasets_spec::{Fps, Motion, Skeleton};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::sample::{EditItem, EditSettings, EditTimes, Editor, TimedInstruction, keypoint_parent};
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

/// Edits the source of every item. The rows are at 20 fps and as long as the edits.
/// Beside them comes where the time went. With one window at a time the fits take turns too, so that
/// the times are those of a single window.
///
/// # Errors
/// A source is shorter than a window, or a generated motion is not finite.
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
            let made = fit_edited(editor, prepared, frames, skeleton, settings.prior)?;
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
    /// The motion, at 20 fps, over whole windows.
    pub motion: Motion,
    /// How far the generated points are from a body.
    pub misfit: Misfit,
    /// Where the time went.
    pub times: EditTimes,
}

/// Edits one motion, of any rate, by instructions for parts of it or for the whole.
///
/// # Errors
/// The motion is shorter than a window, an instruction fits no window, or the generated motion is
/// not finite.
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
    let item = EditItem::timed(id, motion, instructions, skeleton, record)?;
    let items = [item];
    let edited = editor.edit_batch(&items, skeleton, settings, session, &mut times)?;
    let begun = session.secs();
    let (motion, misfit) = fit_edited(editor, &items[0], &edited[0], skeleton, settings.prior)?;
    times.fit_secs += session.secs() - begun;
    Ok(Edited {
        motion,
        misfit,
        times,
    })
}

/// SMPL-X parameters of a generated motion at 20 fps, and by how much they miss it.
fn fit_edited(
    editor: &Editor,
    item: &EditItem,
    frames: &[KeypointFrame],
    skeleton: &Skeleton,
    prior: f64,
) -> Result<(Motion, Misfit), Error> {
    let options = FitOptions {
        smoothness: prior,
        ..FitOptions::default()
    };
    let mut frames = double_rate(frames);
    if editor.record().config.train.keypoints < NUM_KEYPOINTS {
        complete(&mut frames, item, skeleton)?;
    }
    let twists = editor.twists(item, &frames, skeleton);
    let fitted = fit_motion_from(skeleton, &frames, &twists, Fps::STORE, &options)
        .map_err(motion_error(&item.id))?;
    let misfit = Misfit::of(&frames, &fitted.error_m, skeleton);
    Ok((fitted.motion, misfit))
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

fn motion_error(id: &str) -> impl Fn(datasets_spec::Error) -> Error {
    move |source| Error::Motion {
        id: id.to_owned(),
        source,
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
