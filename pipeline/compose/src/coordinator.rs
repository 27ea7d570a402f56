//! Training data of the body-part coordinator: natural segments and composed ones.

use datasets_spec::BodyPart;
use rand::RngExt;
use rayon::prelude::*;

use super::stream::{Room, WindowPlace};
use super::window::{BlendPlan, Origin, PARTS_OF_ORIGINAL};
use super::{Error, Stream};

/// Windows and whether they were composed. The buffers are reused from call to call.
///
/// # Shapes
/// `B` windows of `W` frames at the model's rate, `[B, W, 84]` in model units.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CoordinatorBatch {
    /// The windows, `[B, W, 84]`.
    pub windows: Vec<f32>,
    /// 1 for a composed window, 0 for a natural one, `[B]`.
    pub composed: Vec<f32>,
}

impl Stream {
    /// Whether segments for the coordinator can be drawn.
    ///
    /// # Errors
    /// The base is empty, or holds only one motion and its copies.
    pub fn check_coordinator(&self) -> Result<(), Error> {
        let first = self.base.first();
        let has_other = |first: &usize| {
            let mut clips = self.base.iter();
            clips.any(|&clip| self.library.may_pair(clip, *first))
        };
        if first.is_some_and(has_other) {
            return Ok(());
        }
        let only = match first {
            Some(&clip) => {
                let clip = self.library.clip(clip).id.source_clip();
                format!("only {clip} and its copies")
            }
            None => "no clip".to_owned(),
        };
        Err(Error::Refused(format!(
            "the coordinator learns from segments of two different clips, and the motion base of split {} has {only} \
             long enough; add motions, raise mcm_ratio or widen base.sources",
            self.library.split()
        )))
    }

    /// Draws windows for the coordinator: an even item is an unmodified segment of the motion base, an odd one blends a
    /// body part of one segment into a segment of a different source clip. All draws derive from seed, epoch and item.
    ///
    /// # Errors
    /// The motions cannot be read.
    ///
    /// # Panics
    /// If [`Stream::check_coordinator`] fails.
    ///
    /// # Source
    /// Paper, Sec. 5.2 and App. B.4: half of the data are unmodified segments, half composed from different ones.
    pub fn fill_coordinator(
        &self,
        epoch: u64,
        first_item: u64,
        num_items: usize,
        batch: &mut CoordinatorBatch,
    ) -> Result<(), Error> {
        let window = self.window_len();
        batch.windows.resize(num_items * window, 0.0);
        batch.composed.resize(num_items, 0.0);
        assert!(
            self.check_coordinator().is_ok(),
            "a segment can only be composed from two motions"
        );
        let seed = self.epoch_seed(epoch).derive(&["coordinator"]);
        let plans: Vec<BlendPlan> = BodyPart::ALL
            .map(|part| BlendPlan::new(part.mask(), self.config.slerp))
            .to_vec();
        batch
            .windows
            .par_chunks_mut(window)
            .zip(&mut batch.composed)
            .enumerate()
            .try_for_each_init(<[Room; 2]>::default, |rooms, (place, (out, composed))| {
                let [room, other_room] = rooms;
                let item = first_item + place as u64;
                let mut rng = seed.rng_of(item);
                let mut draw = |other_than: Option<usize>| loop {
                    let clip = self.base[rng.random_range(0..self.base.len())];
                    if other_than.is_none_or(|other| self.library.may_pair(clip, other)) {
                        let last = self.library.len_of(clip) - self.span;
                        let start = rng.random_range(0..=last);
                        break WindowPlace { clip, start };
                    }
                };
                let at = draw(None);
                *composed = (item % 2) as f32;
                if item.is_multiple_of(2) {
                    let segment = self.window_of(at, PARTS_OF_ORIGINAL, room)?;
                    self.composer.original(segment, out);
                } else {
                    let other = draw(Some(at.clip));
                    let plan = &plans[rng.random_range(0..plans.len())];
                    let alpha = self.config.alpha.draw(&mut rng) as f32;
                    let segment = self.window_of(at, plan.parts_of(Origin::Source), room)?;
                    let taken = self.window_of(other, plan.parts_of(Origin::Target), other_room)?;
                    self.composer.blended(segment, taken, plan, alpha, out);
                }
                if self.draws_mirrored(&mut rng) {
                    self.composer.mirror(out);
                }
                Ok(())
            })
    }
}

#[cfg(test)]
mod tests {
    use datasets_spec::Split;

    use super::*;
    use crate::{ComposeConfig, fixture};

    fn batch(threads: usize, first: u64, count: usize) -> CoordinatorBatch {
        let config = ComposeConfig::default();
        let library = fixture::library(Split::Train, 9);
        let stream = fixture::stream(library, config, 5).expect("a stream");
        let mut batch = CoordinatorBatch::default();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        let fill = || stream.fill_coordinator(2, first, count, &mut batch);
        pool.expect("a pool").install(fill).expect("in memory");
        batch
    }

    #[test]
    fn half_are_natural_and_threads_and_batches_do_not_matter() {
        let whole = batch(1, 0, 40);
        assert_eq!(whole, batch(3, 0, 40));
        assert_eq!(whole.composed.iter().sum::<f32>(), 20.0);
        let part = batch(2, 10, 6);
        let window = whole.windows.len() / 40;
        assert_eq!(part.windows, whole.windows[10 * window..16 * window]);
        assert_eq!(part.composed, whole.composed[10..16]);
        assert!(whole.windows.iter().all(|value| value.is_finite()));
    }
}
