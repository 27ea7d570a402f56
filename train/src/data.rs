//! Training windows for the network: drawing, adding noise, prefetching.

use std::ops::Range;
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::Scope;

pub use compose::WindowBatch;
use compose::{Stream, WindowLoader};
use datasets_spec::{Rng, Seed};
use kinematics::canonical::FIXED_FRAMES;
use kinematics::normalise::FRAME_WIDTH;
use rand::RngExt;
use rand_distr::StandardNormal;
use rayon::prelude::*;

use crate::Error;
use crate::config::narrowed;
pub use crate::model::text::TextBatch;
use crate::noise_shape::NoiseShape;
use crate::text::table::EmbeddingTable;
use crate::vocabulary::{Vocabulary, padded_rows};

/// Maximum number of finished batches that wait for the trainer.
const PREFETCHED_BATCHES: usize = 2;

/// A stream of training windows with random access: item `i` of an epoch is always the same. Items are edits, or the
/// coordinator's training segments.
pub trait WindowSource<B = WindowBatch>: Sync {
    /// Number of items in an epoch.
    fn epoch_len(&self) -> u64;

    /// Number of values in a window: its frames times 84.
    fn window_len(&self) -> usize;

    /// Checks that windows can be drawn.
    ///
    /// # Errors
    /// There are too few motions to compose a window from.
    fn check(&self) -> Result<(), Error> {
        Ok(())
    }

    /// Replaces the contents of `batch` by `num_items` items of an epoch, starting at `first_item`.
    ///
    /// # Errors
    /// The items cannot be composed.
    fn fill(
        &self,
        epoch: u64,
        first_item: u64,
        num_items: usize,
        batch: &mut B,
    ) -> Result<(), Error>;
}

/// Reads items that are numbered across epochs. `read` gets an epoch, the first item within it, and a number of items.
pub(crate) fn across_epochs(
    epoch_len: u64,
    items: Range<u64>,
    mut read: impl FnMut(u64, u64, usize) -> Result<(), Error>,
) -> Result<(), Error> {
    let mut at = items.start;
    while at < items.end {
        let (epoch, first_item) = (at / epoch_len, at % epoch_len);
        let num_items = (items.end - at).min(epoch_len - first_item);
        read(epoch, first_item, num_items as usize)?;
        at += num_items;
    }
    Ok(())
}

impl WindowSource for Stream {
    fn epoch_len(&self) -> u64 {
        Stream::epoch_len(self)
    }

    fn window_len(&self) -> usize {
        Stream::window_len(self)
    }

    fn fill(
        &self,
        epoch: u64,
        first_item: u64,
        num_items: usize,
        batch: &mut WindowBatch,
    ) -> Result<(), Error> {
        Ok(Stream::fill(self, epoch, first_item, num_items, batch)?)
    }
}

impl WindowSource for WindowLoader {
    fn epoch_len(&self) -> u64 {
        WindowLoader::epoch_len(self)
    }

    fn window_len(&self) -> usize {
        WindowLoader::window_len(self)
    }

    fn fill(
        &self,
        epoch: u64,
        first_item: u64,
        num_items: usize,
        batch: &mut WindowBatch,
    ) -> Result<(), Error> {
        Ok(WindowLoader::fill(
            self, epoch, first_item, num_items, batch,
        )?)
    }
}

/// How instructions are encoded for a network.
#[derive(Clone, Copy, Debug)]
pub enum Texts<'a> {
    /// Word numbers from a vocabulary.
    Words(&'a Vocabulary),
    /// The vectors of a frozen encoder.
    Vectors(&'a EmbeddingTable),
}

impl Texts<'_> {
    /// Encodes texts as the input of a network.
    ///
    /// # Errors
    /// A text has no vector.
    pub fn batch<'a>(&self, texts: impl Iterator<Item = &'a str>) -> Result<TextBatch, Error> {
        let table = match self {
            Self::Words(vocabulary) => {
                return Ok(TextBatch::Words(vocabulary.encode_batch(texts)));
            }
            Self::Vectors(table) => table,
        };
        let vector = |text| table.get(text).ok_or_else(|| Error::not_embedded(&[text]));
        let vectors: Vec<&[f32]> = texts.map(vector).collect::<Result<_, _>>()?;
        let tokens = vectors.iter().map(|vector| vector.len() / table.width());
        Ok(TextBatch::Vectors {
            lengths: tokens.collect(),
            values: padded_rows(vectors.iter().copied(), 0.0).0,
        })
    }
}

/// `B` windows of `W` frames, with all random draws of a training step.
#[derive(Clone, Debug, PartialEq)]
pub struct NoisyBatch {
    /// Normalised original windows, `[B, W, D]`; `D` is 84, or 66 for the body joints alone.
    pub original: Vec<f32>,
    /// Normalised edited windows, `[B, W, D]`.
    pub edited: Vec<f32>,
    /// Standard normal or shaped noise, `[B, W, D]`; zero on fixed frames that are shown without noise.
    pub noise: Vec<f32>,
    /// Diffusion step of each window, `[B]`.
    pub timesteps: Vec<usize>,
    /// Start of each window in its edited motion, as a fraction of the motion's length, `[B]`.
    pub progress: Vec<f32>,
    /// Instructions.
    pub texts: TextBatch,
    /// 1 if the instruction is shown to the network, 0 if it is dropped, `[B]`.
    pub text_kept: Vec<f32>,
    /// Whether each window is shown as the first of its motion, without fixed frames, `[B]`.
    pub is_start: Vec<bool>,
}

impl NoisyBatch {
    /// Number of windows.
    #[expect(clippy::len_without_is_empty, reason = "a batch is never empty")]
    pub fn len(&self) -> usize {
        self.timesteps.len()
    }

    /// Number of frames in a window, given the number of values per frame.
    pub fn window(&self, frame_width: usize) -> usize {
        self.original.len() / (self.len().max(1) * frame_width)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Timesteps {
    /// Uniformly at random, independently for each window.
    Random,
    /// Spread evenly over the schedule, among this number of consecutive windows. This makes validations of different
    /// runs comparable.
    Spread(usize),
}

impl Timesteps {
    pub(crate) fn of(self, item: u64, num_steps: usize, rng: &mut Rng) -> usize {
        match self {
            Self::Random => rng.random_range(0..num_steps),
            Self::Spread(total) => spread_timestep(item as usize % total, total, num_steps),
        }
    }
}

/// The diffusion step of item `place` among `total` items, whose steps are spread evenly over the schedule.
pub(crate) fn spread_timestep(place: usize, total: usize, num_steps: usize) -> usize {
    (2 * place + 1) * num_steps / (2 * total)
}

/// Samples noisy batches from a source of windows. The draws for an item depend only on the seed and the item's index
/// in the run.
#[derive(Clone, Copy)]
pub(crate) struct WindowSampler<'a> {
    pub(crate) source: &'a dyn WindowSource,
    pub(crate) keypoints: usize,
    pub(crate) texts: Texts<'a>,
    pub(crate) seed: Seed,
    pub(crate) num_timesteps: usize,
    pub(crate) timesteps: Timesteps,
    pub(crate) text_dropout: f64,
    pub(crate) generated_starts: f64,
    pub(crate) fixed_noise: f64,
    /// Covariance of the noise; none for white noise.
    pub(crate) shape: Option<&'a NoiseShape>,
}

impl WindowSampler<'_> {
    /// The windows `first..first + num_windows` of the run; the numbering continues across epochs.
    pub(crate) fn draw(&self, first: u64, num_windows: usize) -> Result<NoisyBatch, Error> {
        let windows = self.windows(first, num_windows)?;
        let window_len = self.source.window_len() / FRAME_WIDTH * 3 * self.keypoints;
        let mut noise = vec![0.0f32; num_windows * window_len];
        let drawn: Vec<(usize, f32, bool)> = noise
            .par_chunks_mut(window_len)
            .enumerate()
            .map(|(index, noise)| {
                let item = first + index as u64;
                let mut rng = self.seed.rng(&["window", &item.to_string()]);
                let timestep = self.timesteps.of(item, self.num_timesteps, &mut rng);
                let is_dropped = rng.random_bool(self.text_dropout);
                let text_kept = if is_dropped { 0.0 } else { 1.0 };
                // If `generated_starts` is 0, no number is drawn, so that earlier runs stay reproducible.
                let is_start =
                    self.generated_starts > 0.0 && rng.random_bool(self.generated_starts);
                let first = if is_start || self.fixed_noise > 0.0 {
                    0
                } else {
                    FIXED_FRAMES * 3 * self.keypoints
                };
                for value in &mut noise[first..] {
                    *value = rng.sample(StandardNormal);
                }
                if let Some(shape) = self.shape {
                    shape.apply(noise, self.keypoints, is_start);
                }
                (timestep, text_kept, is_start)
            })
            .collect();
        Ok(NoisyBatch {
            texts: self
                .texts
                .batch(windows.instructions.iter().map(String::as_str))?,
            original: narrowed(windows.original, self.keypoints),
            edited: narrowed(windows.edited, self.keypoints),
            noise,
            timesteps: drawn.iter().map(|(timestep, ..)| *timestep).collect(),
            progress: windows.progress,
            text_kept: drawn.iter().map(|(_, kept, _)| *kept).collect(),
            is_start: drawn.iter().map(|(.., is_start)| *is_start).collect(),
        })
    }

    pub(crate) fn windows(&self, first: u64, num_windows: usize) -> Result<WindowBatch, Error> {
        let epoch_len = self.source.epoch_len();
        if epoch_len == 0 {
            return Err(Error::empty("source of training windows"));
        }
        let mut whole = WindowBatch::default();
        let mut part = WindowBatch::default();
        let items = first..first + num_windows as u64;
        across_epochs(epoch_len, items, |epoch, first_item, num_items| {
            self.source.fill(epoch, first_item, num_items, &mut part)?;
            let window_len = self.source.window_len();
            check_shape(&part, epoch, first_item, num_items, window_len)?;
            whole.original.append(&mut part.original);
            whole.edited.append(&mut part.edited);
            whole.progress.append(&mut part.progress);
            whole.instructions.append(&mut part.instructions);
            Ok(())
        })?;
        Ok(whole)
    }
}

fn check_shape(
    batch: &WindowBatch,
    epoch: u64,
    first_item: u64,
    num_items: usize,
    window_len: usize,
) -> Result<(), Error> {
    for (field, got, expected) in [
        ("original", batch.original.len(), num_items * window_len),
        ("edited", batch.edited.len(), num_items * window_len),
        ("progress", batch.progress.len(), num_items),
        ("instructions", batch.instructions.len(), num_items),
    ] {
        if got != expected {
            return Err(Error::Refused(format!(
                "training windows {first_item}.. of epoch {epoch}: {field} holds {got} values, expected {expected}"
            )));
        }
    }
    Ok(())
}

/// Makes the value of each step on a separate thread, a few steps ahead of the receiver. The thread ends after the last
/// value, on a failure, or when the receiver is dropped.
pub(crate) fn prefetch<'scope, T: Send + 'scope>(
    scope: &'scope Scope<'scope, '_>,
    steps: Range<u64>,
    mut make: impl FnMut(u64) -> Result<T, Error> + Send + 'scope,
) -> Receiver<Result<T, Error>> {
    let (sender, receiver) = sync_channel(PREFETCHED_BATCHES);
    scope.spawn(move || {
        for step in steps {
            let made = make(step);
            let failed = made.is_err();
            if sender.send(made).is_err() || failed {
                break;
            }
        }
    });
    receiver
}

#[cfg(test)]
mod tests {
    use super::*;

    const WINDOW_NUMBERS: usize = 16 * FRAME_WIDTH;

    /// Windows that hold their own epoch and item number.
    struct Counting(u64);

    impl WindowSource for Counting {
        fn epoch_len(&self) -> u64 {
            self.0
        }

        fn window_len(&self) -> usize {
            WINDOW_NUMBERS
        }

        fn fill(
            &self,
            epoch: u64,
            first_item: u64,
            num_items: usize,
            batch: &mut WindowBatch,
        ) -> Result<(), Error> {
            *batch = WindowBatch::default();
            for item in first_item..first_item + num_items as u64 {
                assert!(item < self.0, "item beyond the epoch");
                let value = (100 * epoch + item) as f32;
                batch.original.extend([value; WINDOW_NUMBERS]);
                batch.edited.extend([-value; WINDOW_NUMBERS]);
                batch.progress.push(0.5);
                batch.instructions.push("wave".to_owned());
            }
            Ok(())
        }
    }

    fn sampler<'a>(source: &'a Counting, vocabulary: &'a Vocabulary) -> WindowSampler<'a> {
        WindowSampler {
            source,
            keypoints: 28,
            texts: Texts::Words(vocabulary),
            seed: Seed(1),
            num_timesteps: 10,
            timesteps: Timesteps::Random,
            text_dropout: 0.0,
            generated_starts: 0.0,
            fixed_noise: 0.0,
            shape: None,
        }
    }

    fn check(first: u64, num_windows: usize, expected: &[f32]) {
        let vocabulary = Vocabulary::build(["wave"], 1, 4).expect("valid");
        let sampler = WindowSampler {
            text_dropout: 0.5,
            generated_starts: 0.25,
            ..sampler(&Counting(3), &vocabulary)
        };
        let batch = sampler.draw(first, num_windows).expect("drawn");
        let firsts = batch.original.iter().step_by(WINDOW_NUMBERS).copied();
        assert_eq!(firsts.collect::<Vec<_>>(), expected);
        let skipped = first as usize;
        let whole = sampler.draw(0, skipped + num_windows).expect("drawn");
        assert_eq!(batch.noise, whole.noise[skipped * WINDOW_NUMBERS..]);
        assert_eq!(batch.timesteps, whole.timesteps[skipped..]);
        assert_eq!(batch.text_kept, whole.text_kept[skipped..]);
        assert_eq!(batch.is_start, whole.is_start[skipped..]);
    }

    #[test]
    fn batches_run_across_epochs_and_can_start_anywhere() {
        check(0, 2, &[0.0, 1.0]);
        check(2, 5, &[2.0, 100.0, 101.0, 102.0, 200.0]);
    }

    #[test]
    fn noise_is_zero_on_the_fixed_frames_and_standard_elsewhere() {
        let vocabulary = Vocabulary::build(["wave"], 1, 4).expect("valid");
        let sampler = WindowSampler {
            seed: Seed(2),
            timesteps: Timesteps::Spread(64),
            ..sampler(&Counting(64), &vocabulary)
        };
        let batch = sampler.draw(0, 64).expect("drawn");
        let mut square = 0.0f64;
        for window in batch.noise.chunks_exact(WINDOW_NUMBERS) {
            let (fixed, free) = window.split_at(FIXED_FRAMES * FRAME_WIDTH);
            assert!(fixed.iter().all(|&value| value == 0.0));
            square += free.iter().map(|&v| f64::from(v).powi(2)).sum::<f64>();
        }
        let count = (64 * (16 - FIXED_FRAMES) * FRAME_WIDTH) as f64;
        // The tolerance is four standard deviations of the mean square of this many normal numbers.
        assert!((square / count - 1.0).abs() < 4.0 * (2.0 / count).sqrt());
        assert_eq!(batch.timesteps.first(), Some(&0));
        assert_eq!(batch.timesteps.last(), Some(&9));
        assert!(batch.text_kept.iter().all(|&kept| kept == 1.0));
    }

    #[test]
    fn prefetching_keeps_the_order_and_passes_errors_on() {
        std::thread::scope(|scope| {
            let received = prefetch(scope, 3..9, Ok).into_iter();
            let received: Vec<u64> = received.map(|value| value.expect("made")).collect();
            assert_eq!(received, [3, 4, 5, 6, 7, 8]);
            let failing = prefetch(scope, 0..9, |step| {
                if step == 1 {
                    return Err(Error::Stopped { what: "a test" });
                }
                Ok(step)
            });
            assert_eq!(failing.into_iter().filter(Result::is_err).count(), 1);
        });
    }
}
