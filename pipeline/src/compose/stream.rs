//! The stream of training windows.

use std::sync::Arc;

use datasets_spec::normalise::{FRAME_WIDTH, Normalizer};
use datasets_spec::{Rng, Seed};
use rand::RngExt;
use rayon::prelude::*;

use super::draw::{Crop, Shuffle, subset};
use super::window::{BlendPlan, Composer, Frame, Thinned};
use super::{ComposeConfig, Error, Library};

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
    /// Where each window starts in the motion its instruction speaks of, as a share of its length
    /// from 0 to 1, `[B]`.
    pub progress: Vec<f32>,
    /// What turns the originals into the edited motions, `[B]`.
    pub instructions: Vec<String>,
}

/// Composes edits of the motions of one split, item by item.
///
/// An epoch visits every window of every annotated motion once, in a shuffled order. Each item draws
/// its window's first frame within its share of the annotated motion, a partner and a stretch of it
/// from the motion base, and the weight of the soft joints.
///
/// # Source
/// Paper Sec. 4.3.
#[derive(Clone, Debug)]
pub struct Stream {
    pub(super) library: Arc<Library>,
    pub(super) config: ComposeConfig,
    pub(super) seed: Seed,
    pub(super) recipe_hash: String,
    composer: Composer,
    /// The clips in use at the model's rate, by clip index.
    thinned: Vec<Option<Thinned>>,
    /// Indices of the clips partners are drawn from.
    base: Vec<usize>,
    targets: Vec<Target>,
    /// Items before each target.
    first_items: Vec<u64>,
    num_items: u64,
    span: usize,
    advance: usize,
}

/// An annotation in use.
#[derive(Clone, Debug)]
struct Target {
    annotation: usize,
    plan: BlendPlan,
    /// The pairing that holds for good, without MotionCutMix.
    fixed: Option<Pairing>,
}

/// What an edit is composed of.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pairing {
    /// Index of the source clip.
    pub(super) source: usize,
    /// Index of the annotation that the edit takes from.
    pub(super) annotation: usize,
    pub(super) alpha: f64,
    /// The stretch of both clips that a whole-clip triplet shows.
    pub(super) crop: Crop,
}

impl Stream {
    /// Prepares a stream over a library.
    ///
    /// # Errors
    /// A setting is out of range, the stored rate is no multiple of the model's, no annotated
    /// motion is as long as a window, or one has no partner.
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
        let stride = config.stride(library.fps())?;
        let (span, advance) = (config.span(stride), config.advance(stride));
        let long_enough = |clip: usize| library.clips[clip].motion.len() >= span;

        let candidates: Vec<usize> = (0..library.clips.len())
            .filter(|&c| long_enough(c))
            .collect();
        let ids: Vec<&str> = candidates
            .iter()
            .map(|&clip| library.clips[clip].id.as_str())
            .collect();
        let base: Vec<usize> = subset(config.mcm_ratio, seed, "motion base", &ids)
            .into_iter()
            .map(|place| candidates[place])
            .collect();

        let candidates: Vec<usize> = (0..library.annotations.len())
            .filter(|&annotation| long_enough(library.annotations[annotation].clip))
            .collect();
        let ids: Vec<&str> = candidates
            .iter()
            .map(|&annotation| library.annotations[annotation].id.as_str())
            .collect();
        let mut targets = Vec::new();
        let mut first_items = Vec::new();
        let mut num_items = 0;
        for place in subset(config.annotated_ratio, seed, "annotated set", &ids) {
            let annotation = candidates[place];
            let target = &library.annotations[annotation];
            if !base.iter().any(|&clip| library.may_pair(clip, target.clip)) {
                return Err(Error::NoPartner {
                    motion: library.clips[target.clip].id.clone(),
                });
            }
            let fixed = config.fixed_pairs.then(|| {
                let mut rng = seed.rng(&["fixed pair", &target.id]);
                library.draw_pairing(&base, annotation, &config, &mut rng)
            });
            let num_frames = fixed.map_or(library.clips[target.clip].motion.len(), |f| {
                f.crop.num_frames
            });
            first_items.push(num_items);
            num_items += ((num_frames - span) / advance + 1) as u64;
            targets.push(Target {
                annotation,
                plan: BlendPlan::new(target.mask),
                fixed,
            });
        }
        if targets.is_empty() {
            return Err(Error::NoItem {
                split: library.split(),
                frames: span,
            });
        }

        let mut used = vec![false; library.clips.len()];
        for &clip in &base {
            used[clip] = true;
        }
        for target in &targets {
            used[library.annotations[target.annotation].clip] = true;
        }
        let thinned = used
            .into_par_iter()
            .enumerate()
            .map(|(clip, used)| {
                used.then(|| Thinned::new(&library.clips[clip].motion, stride, library.skeleton()))
            })
            .collect();
        Ok(Self {
            composer: Composer::new(library.skeleton(), config.anchor, normalizer),
            recipe_hash: config.recipe_hash(),
            library,
            config,
            seed,
            thinned,
            base,
            targets,
            first_items,
            num_items,
            span,
            advance,
        })
    }

    /// The motions and masks the stream composes.
    pub fn library(&self) -> &Arc<Library> {
        &self.library
    }

    /// Items of an epoch: the windows of all annotated motions in use.
    pub fn epoch_len(&self) -> u64 {
        self.num_items
    }

    /// Composes the items `first_item..first_item + num_items` of an epoch. The bytes are the same
    /// on any number of threads.
    ///
    /// Originals and edited motions are canonical each by their own first frame: the model sees every
    /// original window as a canonical segment, and its fixed frames live in the canonical frame of
    /// the edited window.
    ///
    /// # Panics
    /// If the items are not all in the epoch.
    pub fn fill(&self, epoch: u64, first_item: u64, num_items: usize, batch: &mut WindowBatch) {
        let end = first_item.saturating_add(num_items as u64);
        assert!(
            end <= self.num_items,
            "items {first_item}..{end} of an epoch of {}",
            self.num_items
        );
        let window = self.config.window * FRAME_WIDTH;
        batch.original.resize(num_items * window, 0.0);
        batch.edited.resize(num_items * window, 0.0);
        batch.progress.resize(num_items, 0.0);
        batch.instructions.resize(num_items, String::new());
        let order = self.order(epoch);
        let epoch_seed = self.epoch_seed(epoch);
        batch
            .original
            .par_chunks_mut(window)
            .zip(batch.edited.par_chunks_mut(window))
            .zip(&mut batch.progress)
            .zip(&mut batch.instructions)
            .enumerate()
            .for_each(|(place, (((original, edited), progress), instruction))| {
                let place = first_item + place as u64;
                let item = order.at(place);
                let mut rng = epoch_seed.rng(&[&item.to_string()]);
                let drawn = self.draw_window(item, &mut rng);
                let annotation = &self.library.annotations[drawn.target.annotation];
                let source = self.window_of(drawn.source, drawn.source_start);
                let target = self.window_of(annotation.clip, drawn.target_start);
                let plan = &drawn.target.plan;
                self.composer.original(source, original);
                self.composer
                    .blended(source, target, plan, drawn.alpha as f32, edited);
                *progress = drawn.progress as f32;
                instruction.clone_from(&annotation.instruction);
            });
    }

    /// The pairing behind an item of an epoch: what [`Stream::fill`] takes a window of.
    pub(super) fn pairing(&self, epoch: u64, place: u64) -> Pairing {
        let item = self.order(epoch).at(place);
        let mut rng = self.epoch_seed(epoch).rng(&[&item.to_string()]);
        self.draw_pairing(self.target_of(item).0, &mut rng)
    }

    fn order(&self, epoch: u64) -> Shuffle {
        let key = self.seed.draw_u64(&["epoch order", &epoch.to_string()]);
        Shuffle::new(self.num_items, key)
    }

    fn epoch_seed(&self, epoch: u64) -> Seed {
        self.seed.derive(&["compose", &epoch.to_string()])
    }

    fn window_of(&self, clip: usize, start: usize) -> &[Frame] {
        self.thinned[clip]
            .as_ref()
            .expect("every clip that can be drawn is thinned out")
            .window(start, self.config.window)
    }

    /// The target of an item and which of its windows the item is.
    fn target_of(&self, item: u64) -> (&Target, usize) {
        let place = self.first_items.partition_point(|&first| first <= item) - 1;
        (
            &self.targets[place],
            (item - self.first_items[place]) as usize,
        )
    }

    fn draw_pairing(&self, target: &Target, rng: &mut Rng) -> Pairing {
        target.fixed.unwrap_or_else(|| {
            self.library
                .draw_pairing(&self.base, target.annotation, &self.config, rng)
        })
    }

    fn draw_window(&self, item: u64, rng: &mut Rng) -> DrawnWindow<'_> {
        let (target, window) = self.target_of(item);
        let Pairing {
            source,
            annotation,
            alpha,
            crop,
        } = self.draw_pairing(target, rng);
        let clip = self.library.annotations[annotation].clip;
        let frames_of = |clip: usize| self.library.clips[clip].motion.len();
        let num_frames = if target.fixed.is_some() {
            crop.num_frames
        } else {
            frames_of(clip)
        };
        let earliest = window * self.advance;
        let latest = (earliest + self.advance - 1).min(num_frames - self.span);
        let start = rng.random_range(earliest..=latest);
        let (source_start, target_start) = if target.fixed.is_some() {
            // A fixed pair is one pair of clips in step, so both windows start together.
            (crop.source_start + start, crop.target_start + start)
        } else {
            (rng.random_range(0..=frames_of(source) - self.span), start)
        };
        DrawnWindow {
            target,
            source,
            source_start,
            target_start,
            alpha,
            progress: start as f64 / num_frames as f64,
        }
    }
}

struct DrawnWindow<'a> {
    target: &'a Target,
    source: usize,
    source_start: usize,
    target_start: usize,
    alpha: f64,
    progress: f64,
}

impl Library {
    /// Whether a clip may be blended with a target: not with itself, its mirror image or another
    /// crop of the same source.
    pub(super) fn may_pair(&self, source: usize, target: usize) -> bool {
        self.clips[source].origin != self.clips[target].origin
    }

    /// Draws a partner from the base, a crop and an alpha. At least one clip of the base must be a
    /// possible partner.
    fn draw_pairing(
        &self,
        base: &[usize],
        annotation: usize,
        config: &ComposeConfig,
        rng: &mut Rng,
    ) -> Pairing {
        let target = self.annotations[annotation].clip;
        let source = loop {
            let source = base[rng.random_range(0..base.len())];
            if self.may_pair(source, target) {
                break source;
            }
        };
        self.paired(source, annotation, config, rng)
    }

    /// Draws a crop and an alpha for a chosen partner.
    pub(super) fn paired(
        &self,
        source: usize,
        annotation: usize,
        config: &ComposeConfig,
        rng: &mut Rng,
    ) -> Pairing {
        let target = self.annotations[annotation].clip;
        let frames_of = |clip: usize| self.clips[clip].motion.len();
        Pairing {
            source,
            annotation,
            alpha: config.alpha.draw(rng),
            crop: Crop::draw(frames_of(source), frames_of(target), rng),
        }
    }
}

#[cfg(test)]
mod tests {
    use datasets_spec::canonical::WINDOW_FRAMES;
    use datasets_spec::{BodyPart, Split};

    use super::*;
    use crate::compose::fixture;

    const CLIPS: usize = 9;

    fn stream_of(library: Library, config: ComposeConfig, seed: u64) -> Result<Stream, Error> {
        let normalizer = library.fit_normalizer(&config).expect("long enough");
        Stream::new(Arc::new(library), config, Seed(seed), &normalizer)
    }

    fn stream(config: ComposeConfig) -> Stream {
        stream_of(fixture::library(Split::Train, CLIPS), config, 5).expect("a stream")
    }

    fn epoch(stream: &Stream, epoch: u64) -> WindowBatch {
        let mut batch = WindowBatch::default();
        stream.fill(epoch, 0, stream.epoch_len() as usize, &mut batch);
        batch
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bytes() {
        let stream = stream(ComposeConfig::default());
        let batches = [1, 2, 7].map(|threads| {
            rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .expect("a pool")
                .install(|| epoch(&stream, 3))
        });
        assert!(batches[0].original.iter().all(|v| v.is_finite()));
        assert!(batches[1..].iter().all(|batch| *batch == batches[0]));
    }

    #[test]
    fn an_epoch_in_pieces_is_the_same_epoch_and_the_next_one_differs() {
        let stream = stream(ComposeConfig::default());
        let whole = epoch(&stream, 0);
        let mut piece = WindowBatch::default();
        stream.fill(0, 3, 4, &mut piece);
        let window = WINDOW_FRAMES * FRAME_WIDTH;
        assert_eq!(piece.edited, whole.edited[3 * window..7 * window]);
        assert_eq!(piece.instructions, whole.instructions[3..7]);
        assert_ne!(epoch(&stream, 1).original, whole.original);
    }

    #[test]
    fn the_order_of_the_rows_does_not_matter() {
        let (mut motions, mut masks) = fixture::rows(Split::Train, CLIPS);
        motions.reverse();
        masks.reverse();
        let skeleton = datasets_spec::Skeleton::smplx_neutral();
        let library = Library::new(Split::Train, &motions, &masks, &skeleton).expect("valid");
        let reversed = stream_of(library, ComposeConfig::default(), 5).expect("a stream");
        assert_eq!(
            epoch(&reversed, 0),
            epoch(&stream(ComposeConfig::default()), 0)
        );
    }

    #[test]
    fn an_epoch_visits_every_window_of_every_annotated_motion() {
        let stream = stream(ComposeConfig::default());
        // Lengths 31, 57, 83, 109, 135 in advances of 28: 1, 1, 2, 3 and 4 windows.
        assert_eq!(stream.epoch_len(), 11);
        let progress = epoch(&stream, 0).progress;
        assert!(progress.iter().all(|p| (0.0..1.0).contains(p)));
        assert!(progress.iter().any(|p| *p > 0.5));
    }

    #[test]
    fn both_windows_stand_at_the_origin_and_face_forward() {
        let config = ComposeConfig::default();
        let library = fixture::library(Split::Train, CLIPS);
        let skeleton = library.skeleton().clone();
        let normalizer = library.fit_normalizer(&config).expect("long enough");
        let stream = stream_of(library, config, 5).expect("a stream");
        let batch = epoch(&stream, 0);
        let triangle = skeleton.rest_triangle();
        for windows in [&batch.original, &batch.edited] {
            for window in windows.chunks_exact(WINDOW_FRAMES * FRAME_WIDTH) {
                let first = normalizer.denormalize(&window[..FRAME_WIDTH]);
                let placed = datasets_spec::canonical::ground_transform_of(
                    &[first[0], first[1], first[2]],
                    &triangle,
                );
                // Rounding to f32 of positions of up to 10 m, and of the triangle's 12 cm.
                assert!(first[0].x.abs() < 1e-5 && first[0].z.abs() < 1e-5);
                assert!(placed.yaw_rad.abs() < 1e-3, "{placed:?}");
            }
        }
    }

    #[test]
    fn most_of_the_training_data_lies_in_the_range() {
        let batch = epoch(&stream(ComposeConfig::default()), 0);
        let inside = batch.original.iter().filter(|v| v.abs() <= 1.0).count();
        // The range keeps 95 % of the coordinates of each axis; these windows are drawn, not the
        // ones it was fitted on.
        assert!(inside as f64 > 0.9 * batch.original.len() as f64);
    }

    #[test]
    fn fixed_pairs_keep_their_partner_and_new_ones_change() {
        let partners = |fixed_pairs| {
            let stream = stream(ComposeConfig {
                fixed_pairs,
                ..ComposeConfig::default()
            });
            (0..6)
                .map(|epoch| {
                    let mut pairs: Vec<(usize, usize, u64)> = (0..stream.epoch_len())
                        .map(|item| {
                            let pairing = stream.pairing(epoch, item);
                            (pairing.annotation, pairing.source, pairing.alpha.to_bits())
                        })
                        .collect();
                    pairs.sort_unstable();
                    pairs
                })
                .collect::<Vec<_>>()
        };
        let fixed = partners(true);
        assert!(fixed.windows(2).all(|pair| pair[0] == pair[1]));
        let drawn = partners(false);
        assert!(drawn.windows(2).any(|pair| pair[0] != pair[1]));
    }

    #[test]
    fn a_motion_never_meets_its_own_mirror_image() {
        let (mut motions, masks) = fixture::rows(Split::Train, 4);
        let mut mirrored = motions[0].clone();
        mirrored.id = datasets_spec::MotionId::parse("clip0~m").expect("valid");
        motions.push(mirrored);
        let skeleton = datasets_spec::Skeleton::smplx_neutral();
        let library = Library::new(Split::Train, &motions, &masks, &skeleton).expect("valid");
        let stream = stream_of(library, ComposeConfig::default(), 1).expect("a stream");
        for epoch in 0..50 {
            for item in 0..stream.epoch_len() {
                let pairing = stream.pairing(epoch, item);
                let target = stream.library.annotations[pairing.annotation].clip;
                assert!(stream.library.may_pair(pairing.source, target));
            }
        }
        let alone = &motions[..1];
        let library = Library::new(Split::Train, alone, &masks[..1], &skeleton).expect("valid");
        assert!(matches!(
            stream_of(library, ComposeConfig::default(), 1),
            Err(Error::NoPartner { motion }) if motion.as_str() == "clip0"
        ));
    }

    #[test]
    fn the_ratio_limits_the_partners() {
        let config = ComposeConfig {
            mcm_ratio: 0.3,
            ..ComposeConfig::default()
        };
        let stream = stream(config);
        let mut partners: Vec<usize> = (0..40)
            .flat_map(|epoch| (0..stream.epoch_len()).map(move |item| (epoch, item)))
            .map(|(epoch, item)| stream.pairing(epoch, item).source)
            .collect();
        partners.sort_unstable();
        partners.dedup();
        assert_eq!(partners.len(), 3, "0.3 of {CLIPS} clips, rounded up");
    }

    #[test]
    fn a_split_without_long_masks_is_refused() {
        let skeleton = datasets_spec::Skeleton::smplx_neutral();
        let (motions, _) = fixture::rows(Split::Train, 3);
        let short = fixture::wandering("short", fixture::SPAN - 1);
        let row = fixture::motion_row("short", Split::Train, &short);
        let rows = [motions, vec![row]].concat();
        let mask = fixture::mask_row("short", Split::Train, BodyPart::LeftArm);
        let library = Library::new(Split::Train, &rows, &[mask], &skeleton).expect("valid");
        assert!(matches!(
            stream_of(library, ComposeConfig::default(), 1),
            Err(Error::NoItem {
                frames: fixture::SPAN,
                ..
            })
        ));
    }
}
