//! Editing whole test items: from composed triplets to rows of the `edits` table.

use datasets_spec::canonical::KeypointFrame;
use datasets_spec::fit::{FitOptions, fit_motion};
use datasets_spec::record::EditRow;
use datasets_spec::resample::double_rate;
use datasets_spec::{Fps, Motion, Resample, Skeleton};
use pipeline::compose::Triplet;
use rayon::prelude::*;

use crate::sample::{EditItem, EditSettings, EditTimes, Editor, TimedInstruction};
use crate::{Error, Session};

/// Weight in m^2/rad^2 that calms unobservable twists of a body fitted to generated points: well
/// below the square of the centimetre by which such points miss any body.
const GENERATED_SMOOTHNESS: f64 = 1e-4;

/// Edits the original of every item and returns three rows an item: the original (`source`), the
/// ground truth (`target`) and what the editor made of the original (`system`). All three are at
/// 20 fps and equally long: whole windows of the original, as far as they reach. Beside them comes
/// where the time went.
///
/// # Errors
/// An original is shorter than a window, or a generated motion is not finite.
///
/// # Source
/// Paper App. B.2 (windows) and B.3 (fit).
pub fn edit_items(
    editor: &Editor,
    system: &str,
    items: &[Triplet],
    skeleton: &Skeleton,
    settings: &EditSettings,
    session: &Session<'_>,
) -> Result<(Vec<EditRow>, EditTimes), Error> {
    let record = &editor.record().config;
    let prepared: Vec<EditItem> = items
        .iter()
        .map(|item| {
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
    let rows: Vec<[EditRow; 3]> = items
        .par_iter()
        .zip(&edited)
        .map(|(item, frames)| {
            let rows = item_rows(editor, system, item, frames, skeleton, settings);
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

/// An edited motion.
#[derive(Clone, Debug, PartialEq)]
pub struct Edited {
    /// The motion, at 20 fps, over whole windows.
    pub motion: Motion,
    /// Mean distance in metres between the generated points and the fitted body.
    pub fit_error_m: f32,
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
    let edited = editor.edit_batch(&[item], skeleton, settings, session, &mut times)?;
    let begun = session.secs();
    let (motion, fit_error_m) = fit_edited(id, &edited[0], skeleton)?;
    times.fit_secs += session.secs() - begun;
    Ok(Edited {
        motion,
        fit_error_m,
        times,
    })
}

fn fit_edited(
    id: &str,
    frames: &[KeypointFrame],
    skeleton: &Skeleton,
) -> Result<(Motion, f32), Error> {
    let options = FitOptions {
        smoothness: GENERATED_SMOOTHNESS,
        ..FitOptions::default()
    };
    let fitted = fit_motion(skeleton, &double_rate(frames), Fps::STORE, &options)
        .map_err(motion_error(id))?;
    let error_m = fitted.error_m.iter().sum::<f64>() / fitted.error_m.len() as f64;
    Ok((fitted.motion, error_m as f32))
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
    item: &Triplet,
    frames: &[KeypointFrame],
    skeleton: &Skeleton,
    settings: &EditSettings,
) -> Result<[EditRow; 3], Error> {
    let (made, error_m) = fit_edited(&item.id, frames, skeleton)?;
    let side = |motion: &Motion| {
        Resample::Exact
            .apply(motion, Fps::STORE)
            .and_then(|motion| motion.crop(0..made.len().min(motion.len())))
            .map_err(motion_error(&item.id))
    };
    let row = |system: &str, checkpoint_hash: &str, motion: &Motion, fit_error_m| EditRow {
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
        fit_error_m,
    };
    Ok([
        row(EditRow::SOURCE, "", &side(&item.original)?, None),
        row(EditRow::TARGET, "", &side(&item.edited)?, None),
        row(system, editor.hash(), &made, Some(error_m)),
    ])
}
