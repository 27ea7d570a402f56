//! Editing whole test items: from composed triplets to rows of the `edits` table.

use datasets_spec::canonical::KeypointFrame;
use datasets_spec::fit::{FitOptions, fit_motion_from};
use datasets_spec::record::EditRow;
use datasets_spec::resample::double_rate;
use datasets_spec::skeleton::{KEYPOINT_JOINTS, KEYPOINT_PARENTS, NUM_KEYPOINTS};
use datasets_spec::{Fps, Motion, Resample, Skeleton};
use pipeline::compose::Triplet;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::sample::{EditItem, EditSettings, EditTimes, Editor, TimedInstruction};
use crate::{Error, Session};

/// An item with the target made of another capture, where there is one.
#[derive(Clone, Copy, Debug)]
pub struct TestItem<'a> {
    /// The item.
    pub triplet: &'a Triplet,
    /// Its other target.
    pub other_take: Option<&'a Motion>,
}

/// Edits the original of every item and returns its rows: the original (`source`), the ground truth
/// (`target`), the ground truth of another capture where there is one (`other take`), and what the
/// editor made of the original (`system`). All are at 20 fps and as long as the edit, whole
/// windows of the original, as far as they reach. Beside them comes where the time went.
///
/// # Errors
/// An original is shorter than a window, or a generated motion is not finite.
///
/// # Source
/// Paper App. B.2 (windows) and B.3 (fit).
pub fn edit_items(
    editor: &Editor,
    system: &str,
    items: &[TestItem<'_>],
    skeleton: &Skeleton,
    settings: &EditSettings,
    session: &Session<'_>,
) -> Result<(Vec<EditRow>, EditTimes), Error> {
    let record = &editor.record().config;
    let prepared: Vec<EditItem> = items
        .iter()
        .map(|TestItem { triplet: item, .. }| {
            EditItem::new(
                &item.id,
                &item.original,
                &item.instruction,
                skeleton,
                record,
            )
        })
        .collect::<Result<_, _>>()?;
    let mut times = EditTimes::default();
    let edited = editor.edit_batch(&prepared, skeleton, settings, session, &mut times)?;
    let begun = session.secs();
    session.progress.begin("fit", Some(items.len() as u64));
    let rows: Vec<Vec<EditRow>> = items
        .par_iter()
        .zip(prepared.par_iter().zip(&edited))
        .map(|(item, (prepared, frames))| {
            let made = fit_edited(editor, prepared, frames, skeleton, settings.prior)?;
            let rows = item_rows(editor, system, item, made, settings);
            session.progress.advance(1);
            rows
        })
        .collect::<Result<_, _>>()?;
    times.fit_secs += session.secs() - begun;
    session
        .progress
        .finish(&format!("{} edited motions fitted", items.len()));
    Ok((rows.into_iter().flatten().collect(), times))
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
        let parent = |slot: usize| usize::try_from(KEYPOINT_PARENTS[slot]).unwrap_or(0);
        let lengths: Vec<f64> = bones
            .clone()
            .map(|slot| skeleton.offset(KEYPOINT_JOINTS[slot]).length())
            .collect();
        let drift: f64 = frames
            .iter()
            .flat_map(|frame| {
                bones.clone().zip(&lengths).map(|(slot, length)| {
                    (frame[slot].distance(frame[parent(slot)]) - length).abs()
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
    let frames = double_rate(frames);
    let twists = editor.twists(item, &frames, skeleton);
    let fitted = fit_motion_from(skeleton, &frames, &twists, Fps::STORE, &options)
        .map_err(motion_error(&item.id))?;
    let misfit = Misfit::of(&frames, &fitted.error_m, skeleton);
    Ok((fitted.motion, misfit))
}

fn motion_error(id: &str) -> impl Fn(datasets_spec::Error) -> Error {
    move |source| Error::Motion {
        id: id.to_owned(),
        source,
    }
}

fn item_rows(
    editor: &Editor,
    system: &str,
    item: &TestItem<'_>,
    (made, misfit): (Motion, Misfit),
    settings: &EditSettings,
) -> Result<Vec<EditRow>, Error> {
    let TestItem {
        triplet: item,
        other_take,
    } = item;
    let side = |motion: &Motion| {
        Resample::Exact
            .apply(motion, Fps::STORE)
            .and_then(|motion| motion.crop(0..made.len().min(motion.len())))
            .map_err(motion_error(&item.id))
    };
    let row =
        |system: &str, checkpoint_hash: &str, motion: &Motion, misfit: Option<Misfit>| EditRow {
            id: item.id.clone(),
            split: item.split,
            system: system.to_owned(),
            checkpoint_hash: checkpoint_hash.to_owned(),
            source_id: item.source_id.to_string(),
            target_id: item.target_id.to_string(),
            instruction: item.instruction.clone(),
            kind: item.kind.to_owned(),
            seed: settings.seed.0,
            fps: motion.fps().get() as f32,
            n_frames: i32::try_from(motion.len()).unwrap_or(i32::MAX),
            transl: motion.transl().to_vec(),
            global_orient: motion.global_orient().to_vec(),
            body_pose: motion.body_pose().to_vec(),
            fit_error_m: misfit.map(|misfit| misfit.fit_error_m),
            bone_drift_m: misfit.map(|misfit| misfit.bone_drift_m),
        };
    let mut rows = vec![
        row(EditRow::SOURCE, "", &side(&item.original)?, None),
        row(EditRow::TARGET, "", &side(&item.edited)?, None),
    ];
    if let Some(other) = other_take {
        rows.push(row(EditRow::OTHER_TAKE, "", &side(other)?, None));
    }
    rows.push(row(system, editor.hash(), &made, Some(misfit)));
    Ok(rows)
}
