//! Windows made one after another and joined.

use datasets_spec::{Rng, Skeleton};
use kinematics::KeypointFrame;
use kinematics::canonical::{FIXED_FRAMES, Stitcher};
use kinematics::normalise::{FRAME_WIDTH, NormalizedFrame, Normalizer};

use super::item::{EditItem, EditWindow};
use super::settings::EditSettings;
use crate::fit::EditorRecord;
use crate::{Error, Session};

/// Frames over which a window that is kept as it was finds back from the edit before it.
const RETURN_FRAMES: usize = 6;

/// A window to be made.
#[derive(Debug)]
pub struct WindowRequest<'a> {
    /// Place of its item among those that are edited.
    pub item: usize,
    /// The window.
    pub window: &'a EditWindow,
    /// Its normalised first frames; none if the model generates them as well.
    pub fixed: Option<[NormalizedFrame; FIXED_FRAMES]>,
    /// Generator of its noise.
    pub rng: Rng,
}

/// What makes windows.
pub trait WindowModel {
    /// Makes a window for each request, `[B, W, 84]` normalised. The first window of a motion and
    /// later ones are never asked for together.
    ///
    /// # Errors
    /// A window cannot be made.
    fn generate(&mut self, requests: &mut [WindowRequest<'_>]) -> Result<Vec<f32>, Error>;
}

/// Edits motions window by window: asks for the windows, keeps those without an instruction, and joins
/// them. Each result holds the keypoints of one item in metres at the model's rate.
///
/// # Errors
/// An item has no window or one of another length, the session is stopped, or `model` fails.
pub fn edit_windows(
    model: &mut dyn WindowModel,
    record: &EditorRecord,
    items: &[EditItem],
    skeleton: &Skeleton,
    settings: &EditSettings,
    session: &Session<'_>,
) -> Result<Vec<Vec<KeypointFrame>>, Error> {
    let window_frames = record.train.window;
    for item in items {
        let problem = if item.windows.is_empty() {
            "has no window".to_owned()
        } else if item
            .windows
            .iter()
            .any(|window| window.original.len() != window_frames)
        {
            format!("has windows of another length than the model's {window_frames} frames")
        } else {
            continue;
        };
        return Err(Error::Item {
            id: item.id.clone(),
            problem,
        });
    }
    let normalizer = &record.normalizer;
    let pelvis = record.compose.config.anchor.pelvis(skeleton);
    let mut stitchers: Vec<Stitcher> = items
        .iter()
        .map(|item| Stitcher::new(skeleton.rest_triangle(), item.placement).anchored(pelvis))
        .collect();
    let num_windows = items.iter().map(|item| item.windows.len()).sum::<usize>();
    let progress = session.progress;
    progress.begin("edit", Some(num_windows as u64));
    let longest = items.iter().map(|item| item.windows.len()).max();
    let overlap = record.train.diffusion.overlap;
    // What a window is blended with.
    let mut former: Vec<Vec<KeypointFrame>> = vec![Vec::new(); items.len()];
    for window_index in 0..longest.unwrap_or(0) {
        // Longer motions go on while shorter ones are done.
        let mut active = Vec::new();
        for (index, item) in items.iter().enumerate() {
            let Some(window) = item.windows.get(window_index) else {
                continue;
            };
            if window_index > 0 {
                former[index] = stitchers[index].rewind(window.start + FIXED_FRAMES);
                former[index].truncate(overlap);
            }
            if window.instruction.is_some() {
                active.push(index);
            } else {
                keep(&mut stitchers[index], window, normalizer);
                progress.advance(1);
            }
        }
        for chunk in active.chunks(settings.max_batch.max(1)) {
            if session.is_stopped() {
                return Err(Error::Stopped { what: "editing" });
            }
            let mut requests: Vec<WindowRequest<'_>> = chunk
                .iter()
                .map(|&index| {
                    let item = &items[index];
                    let window = &item.windows[window_index];
                    let is_generated = record.train.diffusion.generated_starts > 0.0;
                    let fixed = match stitchers[index].next_fixed() {
                        Some(frames) => Some(frames.map(|frame| normalizer.normalize(&frame))),
                        None if is_generated => None,
                        None => Some([window.original[0], window.original[1]]),
                    };
                    let place = window_index.to_string();
                    WindowRequest {
                        item: index,
                        window,
                        fixed,
                        rng: settings.seed.rng(&["edit", &item.id, &place]),
                    }
                })
                .collect();
            let generated = model.generate(&mut requests)?;
            let numbers = window_frames * FRAME_WIDTH;
            for (request, frames) in requests.iter().zip(generated.chunks_exact(numbers)) {
                let frames: Vec<KeypointFrame> = frames
                    .chunks_exact(FRAME_WIDTH)
                    .take(request.window.used)
                    .map(|frame| normalizer.denormalize(&NormalizedFrame::from_model_units(frame)))
                    .collect();
                stitchers[request.item].push_over(&frames, &former[request.item]);
            }
            progress.advance(chunk.len() as u64);
        }
    }
    progress.finish(&format!("{} motions, {num_windows} windows", items.len()));
    Ok(stitchers.into_iter().map(Stitcher::into_frames).collect())
}

/// Adds a window as it was. After an edit its frames stand where the edit left the body, and the pose
/// finds back to the original within a few frames.
fn keep(stitcher: &mut Stitcher, window: &EditWindow, normalizer: &Normalizer) {
    let mut frames: Vec<KeypointFrame> = window.original[..window.used]
        .iter()
        .map(|frame| normalizer.denormalize(frame))
        .collect();
    if let Some(fixed) = stitcher.next_fixed() {
        let last = FIXED_FRAMES - 1;
        let away: Vec<_> = fixed[last]
            .iter()
            .zip(&frames[last])
            .map(|(now, was)| *now - *was)
            .collect();
        for (step, frame) in frames[FIXED_FRAMES..].iter_mut().enumerate() {
            let left = 1.0 - (step + 1) as f64 / RETURN_FRAMES as f64;
            for (point, away) in frame.iter_mut().zip(&away) {
                *point += *away * left.max(0.0);
            }
        }
    }
    stitcher.push(&frames);
}
