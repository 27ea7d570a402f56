//! The stream of training windows.

mod target;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use datasets_spec::record::WindowRow;
use datasets_spec::sides::mirrored;
use datasets_spec::{Rng, Seed};
use kinematics::FrameParts;
use kinematics::normalise::{FRAME_WIDTH, Normalizer};
use rand::RngExt;
use rayon::prelude::*;

use target::{Target, Targets};

use super::draw::Shuffle;
use super::library::{FrameRoom, Pairing, Subject};
use super::window::{BlendPlan, Composer, Frame, Origin, PARTS_OF_ORIGINAL, both_parts};
use super::{ComposeConfig, EditKind, Error, Library};

/// Training windows, item after item. The buffers are reused from call to call.
///
/// # Shapes
/// `B` items of `W` frames at the model's rate, `[B, W, 84]` in model units.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WindowBatch {
    /// Windows of the original motions, `[B, W, 84]`.
    pub original: Vec<f32>,
    /// Windows of the edited motions, `[B, W, 84]`.
    pub edited: Vec<f32>,
    /// Start of each window in the motion that its instruction describes, as a fraction of its length,
    /// `[B]`.
    pub progress: Vec<f32>,
    /// Instructions of the edits, `[B]`.
    pub instructions: Vec<String>,
}

impl WindowBatch {
    /// Resizes the buffers to `num_items` items of windows of `window_len` numbers.
    pub fn resize(&mut self, num_items: usize, window_len: usize) {
        self.original.resize(num_items * window_len, 0.0);
        self.edited.resize(num_items * window_len, 0.0);
        self.progress.resize(num_items, 0.0);
        self.instructions.resize(num_items, String::new());
    }
}

/// A window of a clip: its first stored frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct WindowPlace {
    pub(super) clip: usize,
    pub(super) start: usize,
}

/// Buffer for a window, reused for the next one.
#[derive(Debug, Default)]
pub(super) struct Room {
    stored: FrameRoom,
    frames: Vec<Frame>,
}

/// Composes edits of the motions of one split, item by item.
///
/// An epoch visits every window of every annotated motion and of every pair once, in a shuffled order. For a semantic
/// edit, an item draws its window's first frame within its part of the annotated motion, a partner from the motion base
/// and a crop of it, and the weight of the soft joints. For a pair, it draws the half of the body to edit, and a donor
/// that gets this half once from each of the two motions.
///
/// # Source
/// Paper Sec. 4.3.
#[derive(Clone, Debug)]
pub struct Stream {
    pub(super) library: Arc<Library>,
    pub(super) config: ComposeConfig,
    pub(super) seed: Seed,
    pub(super) recipe_hash: String,
    pub(super) composer: Composer,
    /// Stored frames per frame of a window.
    stride: usize,
    /// Indices of the clips partners are drawn from.
    pub(super) base: Vec<usize>,
    targets: Vec<Target>,
    /// Index of the first item of each target.
    first_items: Vec<u64>,
    num_items: u64,
    num_short: usize,
    pub(super) span: usize,
    advance: usize,
}

impl Stream {
    /// Prepares a stream over a library.
    ///
    /// # Errors
    /// A setting is out of range, the stored rate is no multiple of the model's, no annotated
    /// motion or pair is as long as a window, one has no partner, or the motions cannot be read.
    ///
    /// # Panics
    /// If the normaliser's range is empty or not finite.
    pub fn new(
        library: Arc<Library>,
        config: ComposeConfig,
        seed: Seed,
        normalizer: &Normalizer,
    ) -> Result<Self, Error> {
        config.check()?;
        assert!(
            (0..3).all(|axis| {
                let range = normalizer.max[axis] - normalizer.min[axis];
                range.is_finite() && range > 0.0
            }),
            "the normaliser has an empty range: {normalizer:?}"
        );
        let library = library.aligned(config.alignment)?;
        let stride = config.stride(library.fps())?;
        let (span, advance) = (config.span(stride), config.advance(stride));
        let base = library.base(&config, seed, span)?;

        let mut targets = Vec::new();
        let mut made = Targets::new(&library, &config);
        let mut first_items = Vec::new();
        let mut num_items = 0;
        for subject in library.subjects(&config, seed, span) {
            if library.takes_partner(subject, &config) && !library.has_partner(&base, subject) {
                return Err(library.no_partner(subject));
            }
            let fixed = config.fixed_pairs.then(|| {
                let mut rng = seed.rng(&["fixed pair", &library.edit(subject).id]);
                library.draw_pairing(&base, subject, &config, &mut rng)
            });
            let num_frames = match &fixed {
                None => library.frames_of(subject),
                Some(fixed) => library.edited_of(fixed).len(),
            };
            first_items.push(num_items);
            num_items += ((num_frames - span) / advance + 1) as u64;
            targets.push(made.target(subject, num_frames, fixed));
        }
        if targets.is_empty() {
            return Err(Error::NoItem {
                split: library.split(),
                frames: span,
            });
        }

        Ok(Self {
            num_short: library.num_short(&config, span),
            composer: Composer::new(library.skeleton(), config.anchor, normalizer),
            recipe_hash: config.recipe_hash(),
            library,
            config,
            seed,
            stride,
            base,
            targets,
            first_items,
            num_items,
            span,
            advance,
        })
    }

    /// The motions, masks and pairs the stream composes.
    pub fn library(&self) -> &Arc<Library> {
        &self.library
    }

    /// The settings.
    pub fn config(&self) -> &ComposeConfig {
        &self.config
    }

    /// Items of an epoch: the windows of all annotated motions and pairs in use.
    pub fn epoch_len(&self) -> u64 {
        self.num_items
    }

    /// Annotated motions and pairs in use: the [`Stream::clip`]s of an epoch.
    pub fn num_clips(&self) -> u64 {
        self.targets.len() as u64
    }

    /// Number of annotated motions and pairs that are shorter than a window, and are not used.
    pub fn num_short(&self) -> usize {
        self.num_short
    }

    pub(super) fn subjects_in_use(&self) -> impl Iterator<Item = Subject> + '_ {
        self.targets.iter().map(|target| target.subject)
    }

    /// Number of values per window.
    pub fn window_len(&self) -> usize {
        self.config.window * FRAME_WIDTH
    }

    /// Every instruction that an item can have, sorted and without duplicates.
    pub fn instructions(&self) -> Vec<String> {
        let mut all: Vec<String> = self
            .targets
            .iter()
            .flat_map(|target| {
                let sides = target.sides.iter().flat_map(|side| &*side.wordings);
                sides.chain(&*target.plain).cloned()
            })
            .collect();
        if self.config.mirrored_ratio > 0.0 {
            let images: Vec<String> = all.iter().map(|text| mirrored(text)).collect();
            all.extend(images);
        }
        all.sort_unstable();
        all.dedup();
        all
    }

    /// Composes the items `first_item..first_item + num_items` of an epoch. The bytes are the same
    /// on any number of threads.
    ///
    /// Original and edited windows are each canonicalised by their own first frame. So the model sees every
    /// original window as a canonical segment, and the fixed frames it is given are in the canonical frame of
    /// the edited window.
    ///
    /// # Errors
    /// The motions cannot be read.
    ///
    /// # Panics
    /// If the items are not all in the epoch.
    pub fn fill(
        &self,
        epoch: u64,
        first_item: u64,
        num_items: usize,
        batch: &mut WindowBatch,
    ) -> Result<(), Error> {
        /// Items per parallel job.
        const AT_ONCE: usize = 16;
        let end = first_item.saturating_add(num_items as u64);
        assert!(
            end <= self.num_items,
            "items {first_item}..{end} of an epoch of {}",
            self.num_items
        );
        let window = self.window_len();
        batch.resize(num_items, window);
        let order = self.order(epoch);
        let epoch_seed = self.epoch_seed(epoch);
        batch
            .original
            .par_chunks_mut(AT_ONCE * window)
            .zip(batch.edited.par_chunks_mut(AT_ONCE * window))
            .zip(batch.progress.par_chunks_mut(AT_ONCE))
            .zip(batch.instructions.par_chunks_mut(AT_ONCE))
            .enumerate()
            .try_for_each_init(<[Room; 3]>::default, |rooms, (chunk, windows)| {
                let (((original, edited), progress), instructions) = windows;
                let windows = original
                    .chunks_exact_mut(window)
                    .zip(edited.chunks_exact_mut(window));
                let said = progress.iter_mut().zip(instructions);
                for (place, ((original, edited), (progress, instruction))) in
                    windows.zip(said).enumerate()
                {
                    let place = first_item + (chunk * AT_ONCE + place) as u64;
                    let drawn = self.draw_window(order.at(place), epoch_seed);
                    self.compose(&drawn, rooms, original, edited)?;
                    *progress = drawn.progress as f32;
                    instruction.clear();
                    if drawn.is_mirrored {
                        self.composer.mirror(original);
                        self.composer.mirror(edited);
                        instruction.push_str(&mirrored(drawn.instruction));
                    } else {
                        instruction.push_str(drawn.instruction);
                    }
                }
                Ok(())
            })
    }

    /// Composes windows of the stream, epoch after epoch, as rows for recording. `take` gets each row,
    /// its batch and its index in the batch.
    ///
    /// # Errors
    /// The motions cannot be read.
    pub fn for_each_recorded(
        &self,
        windows: std::ops::Range<u64>,
        mut take: impl FnMut(WindowRow, &WindowBatch, usize),
    ) -> Result<(), Error> {
        const AT_ONCE: u64 = 4096;
        let window = self.window_len();
        let mut batch = WindowBatch::default();
        let mut done = windows.start;
        while done < windows.end {
            let (epoch, first) = (done / self.num_items, done % self.num_items);
            let len = AT_ONCE.min(windows.end - done).min(self.num_items - first);
            self.fill(epoch, first, len as usize, &mut batch)?;
            for at in 0..len as usize {
                let frames = |numbers: &[f32]| {
                    let window = &numbers[at * window..][..window];
                    window.as_chunks::<FRAME_WIDTH>().0.to_vec()
                };
                let row = WindowRow {
                    split: self.library.split(),
                    epoch,
                    item: first + at as u64,
                    progress: batch.progress[at],
                    instruction: batch.instructions[at].clone(),
                    original: frames(&batch.original),
                    edited: frames(&batch.edited),
                };
                take(row, &batch, at);
            }
            done += len;
        }
        Ok(())
    }

    fn compose(
        &self,
        drawn: &DrawnWindow<'_>,
        rooms: &mut [Room; 3],
        original: &mut [f32],
        edited: &mut [f32],
    ) -> Result<(), Error> {
        let [first, second, third] = rooms;
        let [edited_parts, mut under_parts] = match drawn.plan {
            None => [PARTS_OF_ORIGINAL; 2],
            Some(plan) => [Origin::Target, Origin::Source].map(|of| plan.parts_of(of)),
        };
        if drawn.before.is_none() {
            // A semantic edit has the partner's window as its original.
            under_parts = both_parts(under_parts, PARTS_OF_ORIGINAL);
        }
        let read = |at: Option<WindowPlace>, parts, room| {
            at.map(|at| self.window_of(at, parts, room)).transpose()
        };
        let before = read(drawn.before, edited_parts, first)?;
        let after = self.window_of(drawn.after, edited_parts, second)?;
        let under = read(drawn.under, under_parts, third)?;
        match (under, drawn.plan) {
            (Some(under), Some(plan)) => {
                let alpha = drawn.alpha as f32;
                match before {
                    None => self.composer.original(under, original),
                    Some(before) => self.composer.blended(under, before, plan, alpha, original),
                }
                self.composer.blended(under, after, plan, alpha, edited);
            }
            _ => {
                let before = before.expect("a plain pair is two motions");
                self.composer.original(before, original);
                self.composer.original(after, edited);
            }
        }
        Ok(())
    }

    /// The pairing and the instruction of an item of an epoch; [`Stream::fill`] takes a window of it.
    pub(super) fn pairing(&self, epoch: u64, place: u64) -> (Pairing, &str) {
        let item = self.order(epoch).at(place);
        let (target, _) = self.target_of(item);
        let pairing = self.draw_pairing(target, &mut self.epoch_seed(epoch).rng_of(item));
        (pairing, target.wording(&pairing))
    }

    pub(super) fn kind(&self, epoch: u64, place: u64) -> EditKind {
        let item = self.order(epoch).at(place);
        self.library.edit(self.target_of(item).0.subject).kind
    }

    pub(super) fn clip_pairing(&self, epoch: u64, number: u64) -> (Pairing, &str) {
        let target = &self.targets[number as usize];
        let seed = self.epoch_seed(epoch).derive(&["clip"]);
        let pairing = self.draw_pairing(target, &mut seed.rng_of(number));
        (pairing, target.wording(&pairing))
    }

    fn order(&self, epoch: u64) -> Shuffle {
        let key = self.seed.draw_u64(&["epoch order", &epoch.to_string()]);
        Shuffle::new(self.num_items, key)
    }

    pub(super) fn epoch_seed(&self, epoch: u64) -> Seed {
        self.seed.derive(&["compose", &epoch.to_string()])
    }

    /// Reads the frames of a window into `room`; only `parts` of them are computed.
    pub(super) fn window_of<'a>(
        &self,
        at: WindowPlace,
        parts: FrameParts,
        room: &'a mut Room,
    ) -> Result<&'a [Frame], Error> {
        let clip = self.library.clip(at.clip);
        clip.thinned(at.start, self.config.window, self.stride, &mut room.stored)?;
        let rows = &room.stored.frames;
        Frame::prepare(rows, parts, self.library.skeleton(), &mut room.frames);
        Ok(&room.frames)
    }

    fn target_of(&self, item: u64) -> (&Target, usize) {
        let place = self.first_items.partition_point(|&first| first <= item) - 1;
        (
            &self.targets[place],
            (item - self.first_items[place]) as usize,
        )
    }

    fn draw_pairing(&self, target: &Target, rng: &mut Rng) -> Pairing {
        target.fixed.as_deref().copied().unwrap_or_else(|| {
            self.library
                .draw_pairing(&self.base, target.subject, &self.config, rng)
        })
    }

    fn draw_window(&self, item: u64, epoch_seed: Seed) -> DrawnWindow<'_> {
        let mut rng = epoch_seed.rng_of(item);
        let (target, window) = self.target_of(item);
        let pairing = self.draw_pairing(target, &mut rng);
        let earliest = window * self.advance;
        let latest = (earliest + self.advance - 1).min(target.num_frames - self.span);
        let start = rng.random_range(earliest..=latest);
        let library = &self.library;
        let partner_at = |rng: &mut Rng, clip: usize, fixed: usize| {
            // The clips of a fixed pair are aligned: their windows start together.
            let at = if target.fixed.is_some() {
                fixed + start
            } else {
                rng.random_range(0..=library.len_of(clip) - self.span)
            };
            WindowPlace { clip, start: at }
        };
        let (crop, held) = (pairing.crop, &library.edit(target.subject).frames);
        // Windows of a mask lie within the mask's range.
        let first = library.edited_of(&pairing).start;
        let (before, after, under) = match target.subject {
            Subject::Annotation(_) => {
                let clip = library.edit(target.subject).target;
                let source = pairing.partner.expect("a semantic edit has a source");
                let under = partner_at(&mut rng, source, crop.source_start + first);
                let start = match target.fixed {
                    Some(_) => crop.target_start + first + start,
                    None => held.start + start,
                };
                (None, WindowPlace { clip, start }, Some(under))
            }
            Subject::Pair(_) => {
                let [source, target] = library.clips_of(target.subject);
                let under = pairing
                    .partner
                    .map(|donor| partner_at(&mut rng, donor, pairing.donor.source_start));
                let at = |clip, first: usize| WindowPlace {
                    clip,
                    start: first + start,
                };
                let before = at(source, crop.source_start);
                (Some(before), at(target, crop.target_start), under)
            }
        };
        DrawnWindow {
            before,
            after,
            under,
            plan: target.side_of(&pairing).0.map(|side| &*side.plan),
            alpha: pairing.alpha,
            progress: (after.start - held.start) as f64 / held.len() as f64,
            instruction: target.wording(&pairing),
            is_mirrored: self.draws_mirrored(&mut rng),
        }
    }

    /// Whether a window is mirrored. This is the last draw of a window, and it is skipped if no window is mirrored, so
    /// that all other draws do not depend on the setting.
    pub(super) fn draws_mirrored(&self, rng: &mut Rng) -> bool {
        self.config.mirrored_ratio > 0.0 && rng.random_bool(self.config.mirrored_ratio)
    }
}

struct DrawnWindow<'a> {
    /// Window before the edit; `None` for a semantic edit, whose original is the window of the partner.
    before: Option<WindowPlace>,
    /// Window after the edit.
    after: WindowPlace,
    /// The partner's window, which takes joints of the others.
    under: Option<WindowPlace>,
    plan: Option<&'a BlendPlan>,
    alpha: f64,
    progress: f64,
    instruction: &'a str,
    is_mirrored: bool,
}
