//! Generates windows one after another and joins them.

use datasets_spec::{Rng, Skeleton};
use kinematics::KeypointFrame;
use kinematics::canonical::{FIXED_FRAMES, Stitcher};
use kinematics::normalise::{FRAME_WIDTH, NormalizedFrame, Normalizer};

use super::item::{EditItem, EditWindow};
use super::settings::EditSettings;
use crate::fit::EditorRecord;
use crate::{Error, Session};

/// Number of frames over which an unchanged window is blended from the end of the previous edit to the original.
const RETURN_FRAMES: usize = 6;

/// A request to generate a window.
#[derive(Debug)]
pub struct WindowRequest<'a> {
    /// Index of the window's item among the edited items.
    pub item: usize,
    /// The window.
    pub window: &'a EditWindow,
    /// Normalised first frames; none if the model generates them as well.
    pub fixed: Option<[NormalizedFrame; FIXED_FRAMES]>,
    /// Generator of the window's noise.
    pub rng: Rng,
}

/// Makes a window for each request, `[B, W, 84]` normalised. A request for a motion's first window never shares a call
/// with requests for later windows.
pub type Generate<'a> = dyn FnMut(&mut [WindowRequest<'_>]) -> Result<Vec<f32>, Error> + 'a;

/// Edits motions window by window: requests windows from `generate`, keeps those without an instruction, and joins all.
/// Each result holds the keypoints of one item in metres at the model's rate.
///
/// # Errors
/// An item has no window or a window of another length, the session is stopped, or `generate` fails.
pub fn edit_windows(
    generate: &mut Generate<'_>,
    record: &EditorRecord,
    items: &[EditItem],
    skeleton: &Skeleton,
    settings: &EditSettings,
    session: &Session<'_>,
) -> Result<Vec<Vec<KeypointFrame>>, Error> {
    check_windows(items, record.train.window)?;
    let pelvis = record.compose.config.anchor.pelvis(skeleton);
    let mut joining = Joining {
        record,
        items,
        settings,
        stitchers: items
            .iter()
            .map(|item| Stitcher::new(skeleton.rest_triangle(), item.placement).anchored(pelvis))
            .collect(),
        former: vec![Vec::new(); items.len()],
    };
    let num_windows = items.iter().map(|item| item.windows.len()).sum::<usize>();
    let progress = session.progress;
    progress.begin("edit", Some(num_windows as u64));
    let longest = items.iter().map(|item| item.windows.len()).max();
    for window_index in 0..longest.unwrap_or(0) {
        let active = joining.advance(window_index, session);
        for chunk in active.chunks(settings.max_batch.max(1)) {
            session.go_on("editing")?;
            let mut requests: Vec<WindowRequest<'_>> = chunk
                .iter()
                .map(|&item| joining.request(item, window_index))
                .collect();
            let generated = generate(&mut requests)?;
            joining.push(&requests, &generated);
            progress.advance(chunk.len() as u64);
        }
    }
    progress.finish(&format!("{} motions, {num_windows} windows", items.len()));
    Ok(joining.into_frames())
}

fn check_windows(items: &[EditItem], window_frames: usize) -> Result<(), Error> {
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
        return Err(Error::item(item.id.clone(), problem));
    }
    Ok(())
}

struct Joining<'a> {
    record: &'a EditorRecord,
    items: &'a [EditItem],
    settings: &'a EditSettings,
    stitchers: Vec<Stitcher>,
    /// Frames of each motion that are blended into its next window.
    former: Vec<Vec<KeypointFrame>>,
}

impl<'a> Joining<'a> {
    /// Advances every motion by one window: adds unchanged windows, and returns the items whose windows must be
    /// generated. Longer motions continue when shorter ones are finished.
    fn advance(&mut self, window_index: usize, session: &Session<'_>) -> Vec<usize> {
        let mut active = Vec::new();
        for (index, item) in self.items.iter().enumerate() {
            let Some(window) = item.windows.get(window_index) else {
                continue;
            };
            let stitcher = &mut self.stitchers[index];
            if window_index > 0 {
                let former = &mut self.former[index];
                *former = stitcher.rewind(window.start + FIXED_FRAMES);
                former.truncate(self.record.train.diffusion.overlap);
            }
            if window.instruction.is_some() {
                active.push(index);
            } else {
                keep(stitcher, window, &self.record.normalizer);
                session.progress.advance(1);
            }
        }
        active
    }

    fn request(&self, item: usize, window_index: usize) -> WindowRequest<'a> {
        let EditItem { id, windows, .. } = &self.items[item];
        let window = &windows[window_index];
        let normalizer = &self.record.normalizer;
        let is_generated = self.record.train.diffusion.generated_starts > 0.0;
        let fixed = match self.stitchers[item].next_fixed() {
            Some(frames) => Some(frames.map(|frame| normalizer.normalize(&frame))),
            None if is_generated => None,
            None => Some([window.original[0], window.original[1]]),
        };
        let place = window_index.to_string();
        WindowRequest {
            item,
            window,
            fixed,
            rng: self.settings.seed.rng(&["edit", id, &place]),
        }
    }

    fn push(&mut self, requests: &[WindowRequest<'_>], generated: &[f32]) {
        let EditorRecord {
            train, normalizer, ..
        } = self.record;
        let windows = generated.chunks_exact(train.window * FRAME_WIDTH);
        for (request, frames) in requests.iter().zip(windows) {
            let frames: Vec<KeypointFrame> = frames
                .chunks_exact(FRAME_WIDTH)
                .take(request.window.used)
                .map(|frame| normalizer.denormalize(&NormalizedFrame::from_model_units(frame)))
                .collect();
            self.stitchers[request.item].push_over(&frames, &self.former[request.item]);
        }
    }

    fn into_frames(self) -> Vec<Vec<KeypointFrame>> {
        let stitchers = self.stitchers.into_iter();
        stitchers.map(Stitcher::into_frames).collect()
    }
}

/// Adds an unchanged window. After an edit, its frames are moved to where the edit ended, and the pose is blended to
/// the original within a few frames.
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
