//! The stream of training windows.

use std::collections::BTreeSet;
use std::sync::Arc;

use datasets_spec::record::WindowRow;
use datasets_spec::{BlendMask, BodyPart, Rng, Seed};
use kinematics::normalise::{FRAME_WIDTH, Normalizer};
use rand::RngExt;
use rayon::prelude::*;

use super::draw::{Crop, Shuffle, subset};
use super::library::{Clip, Pair};
use super::sinc::whole_parts;
use super::window::{BlendPlan, Composer, Frame, Thinned};
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
    /// Where each window starts in the motion its instruction speaks of, as a share of its length
    /// from 0 to 1, `[B]`.
    pub progress: Vec<f32>,
    /// What turns the originals into the edited motions, `[B]`.
    pub instructions: Vec<String>,
}

impl WindowBatch {
    /// Makes room for `num_items` items of windows of `window_len` numbers.
    pub fn resize(&mut self, num_items: usize, window_len: usize) {
        self.original.resize(num_items * window_len, 0.0);
        self.edited.resize(num_items * window_len, 0.0);
        self.progress.resize(num_items, 0.0);
        self.instructions.resize(num_items, String::new());
    }
}

/// Composes edits of the motions of one split, item by item.
///
/// An epoch visits every window of every annotated motion and of every pair once, in a shuffled
/// order. For a semantic edit an item draws its window's first frame within its share of the
/// annotated motion, a partner and a stretch of it from the motion base, and the weight of the soft
/// joints. For a pair it draws the half of the body that is edited and a donor, which is blended
/// under both motions alike.
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
    /// The clips in use at the model's rate, by clip index.
    pub(super) thinned: Vec<Option<Thinned>>,
    /// Indices of the clips partners are drawn from.
    pub(super) base: Vec<usize>,
    targets: Vec<Target>,
    /// Items before each target.
    first_items: Vec<u64>,
    num_items: u64,
    pub(super) span: usize,
    advance: usize,
}

/// What an item is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Subject {
    /// Index of an annotation.
    Annotation(usize),
    /// Index of a pair.
    Pair(usize),
}

/// An annotation or pair in use.
#[derive(Clone, Debug)]
struct Target {
    subject: Subject,
    /// Frames its windows are taken from.
    num_frames: usize,
    /// The ways it can be blended: one for an annotation, one for each half of a pair.
    sides: Vec<Side>,
    /// Wordings of the instruction of a pair that is shown as it is.
    plain: Vec<String>,
    /// The pairing that holds for good, without MotionCutMix.
    fixed: Option<Pairing>,
}

/// What is edited, and what it is called.
#[derive(Clone, Debug)]
struct Side {
    plan: BlendPlan,
    wordings: Vec<String>,
}

/// What an edit is composed of.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pairing {
    pub(super) subject: Subject,
    /// Index of the clip from the base: the source of a semantic edit, the donor of a pair; none for
    /// a pair that is shown as it is.
    pub(super) partner: Option<usize>,
    /// Half of the body that a blended pair is edited in.
    pub(super) half: Option<BodyPart>,
    pub(super) alpha: f64,
    /// Which of the wordings of the instruction is used, as a share of their number.
    pub(super) wording: f64,
    /// Where the partner and the annotated motion meet, or the two motions of a pair.
    pub(super) crop: Crop,
    /// Overlap of the donor with the pair's common frames (whole-clip triplets only).
    pub(super) donor: Crop,
}

impl Stream {
    /// Prepares a stream over a library.
    ///
    /// # Errors
    /// A setting is out of range, the stored rate is no multiple of the model's, no annotated
    /// motion or pair is as long as a window, or one has no partner.
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
        let library = library.aligned(config.alignment);
        let stride = config.stride(library.fps())?;
        let (span, advance) = (config.span(stride), config.advance(stride));
        let base = library.base(&config, seed, span)?;

        let mut targets = Vec::new();
        let mut first_items = Vec::new();
        let mut num_items = 0;
        for subject in library.subjects(&config, seed, span) {
            if !base.iter().any(|&clip| library.may_meet(clip, subject)) {
                return Err(Error::NoPartner {
                    motion: library.clips[library.target_of(subject)].id.clone(),
                });
            }
            let fixed = config.fixed_pairs.then(|| {
                let mut rng = seed.rng(&["fixed pair", library.subject_id(subject)]);
                library.draw_pairing(&base, subject, &config, &mut rng)
            });
            let num_frames =
                fixed.map_or_else(|| library.frames_of(subject), |fixed| fixed.crop.num_frames);
            first_items.push(num_items);
            num_items += ((num_frames - span) / advance + 1) as u64;
            targets.push(Target::new(&library, &config, subject, num_frames, fixed));
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
            for clip in library.clips_of(target.subject) {
                used[clip] = true;
            }
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

    pub(super) fn subjects_in_use(&self) -> impl Iterator<Item = Subject> + '_ {
        self.targets.iter().map(|target| target.subject)
    }

    /// Numbers of a window.
    pub fn window_len(&self) -> usize {
        self.config.window * FRAME_WIDTH
    }

    /// Every instruction an item can have, each once, sorted.
    pub fn instructions(&self) -> Vec<String> {
        let mut all: Vec<String> = self
            .targets
            .iter()
            .flat_map(|target| {
                let sides = target.sides.iter().flat_map(|side| &side.wordings);
                sides.chain(&target.plain).cloned()
            })
            .collect();
        all.sort_unstable();
        all.dedup();
        all
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
        /// Items a thread takes at a time.
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
            .for_each(|(chunk, (((original, edited), progress), instructions))| {
                let windows = original
                    .chunks_exact_mut(window)
                    .zip(edited.chunks_exact_mut(window));
                let said = progress.iter_mut().zip(instructions);
                for (place, ((original, edited), (progress, instruction))) in
                    windows.zip(said).enumerate()
                {
                    let place = first_item + (chunk * AT_ONCE + place) as u64;
                    let drawn = self.draw_window(order.at(place), epoch_seed);
                    self.compose(&drawn, original, edited);
                    *progress = drawn.progress as f32;
                    instruction.clear();
                    instruction.push_str(drawn.instruction);
                }
            });
    }

    /// Composes windows of the stream, epoch after epoch, as the rows they are recorded as. `take`
    /// gets each row, the batch it is of and its place there.
    pub fn for_each_recorded(
        &self,
        windows: std::ops::Range<u64>,
        mut take: impl FnMut(WindowRow, &WindowBatch, usize),
    ) {
        /// Windows composed at a time.
        const AT_ONCE: u64 = 4096;
        let window = self.window_len();
        let mut batch = WindowBatch::default();
        let mut done = windows.start;
        while done < windows.end {
            let (epoch, first) = (done / self.num_items, done % self.num_items);
            let len = AT_ONCE.min(windows.end - done).min(self.num_items - first);
            self.fill(epoch, first, len as usize, &mut batch);
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
    }

    fn compose(&self, drawn: &DrawnWindow<'_>, original: &mut [f32], edited: &mut [f32]) {
        let [before, after] = drawn.windows;
        match (drawn.under, drawn.plan) {
            (Some(under), Some(plan)) => {
                let alpha = drawn.alpha as f32;
                match before {
                    None => self.composer.original(under, original),
                    Some(before) => self.composer.blended(under, before, plan, alpha, original),
                }
                let after = after.expect("an edit has a motion after it");
                self.composer.blended(under, after, plan, alpha, edited);
            }
            _ => {
                let [before, after] = drawn
                    .windows
                    .map(|w| w.expect("a plain pair is two motions"));
                self.composer.original(before, original);
                self.composer.original(after, edited);
            }
        }
    }

    /// The pairing behind an item of an epoch: what [`Stream::fill`] takes a window of.
    pub(super) fn pairing(&self, epoch: u64, place: u64) -> Pairing {
        let item = self.order(epoch).at(place);
        let mut rng = item_rng(self.epoch_seed(epoch), item);
        self.draw_pairing(self.target_of(item).0, &mut rng)
    }

    /// The kind of edit an item of an epoch is.
    pub(super) fn kind(&self, epoch: u64, place: u64) -> EditKind {
        let item = self.order(epoch).at(place);
        self.library.kind_of(self.target_of(item).0.subject)
    }

    fn order(&self, epoch: u64) -> Shuffle {
        let key = self.seed.draw_u64(&["epoch order", &epoch.to_string()]);
        Shuffle::new(self.num_items, key)
    }

    pub(super) fn epoch_seed(&self, epoch: u64) -> Seed {
        self.seed.derive(&["compose", &epoch.to_string()])
    }

    pub(super) fn window_of(&self, clip: usize, start: usize) -> &[Frame] {
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
                .draw_pairing(&self.base, target.subject, &self.config, rng)
        })
    }

    fn draw_window(&self, item: u64, epoch_seed: Seed) -> DrawnWindow<'_> {
        let mut rng = item_rng(epoch_seed, item);
        let (target, window) = self.target_of(item);
        let pairing = self.draw_pairing(target, &mut rng);
        let earliest = window * self.advance;
        let latest = (earliest + self.advance - 1).min(target.num_frames - self.span);
        let start = rng.random_range(earliest..=latest);
        let library = &self.library;
        let partner_at = |rng: &mut Rng, clip: usize, fixed: usize| {
            // A fixed pair is one pair of clips in step, so their windows start together.
            let at = if target.fixed.is_some() {
                fixed + start
            } else {
                rng.random_range(0..=library.clips[clip].motion.len() - self.span)
            };
            self.window_of(clip, at)
        };
        let crop = pairing.crop;
        let (windows, under, shown) = match target.subject {
            Subject::Annotation(annotation) => {
                let clip = library.annotations[annotation].clip;
                let source = pairing.partner.expect("a semantic edit has a source");
                let under = partner_at(&mut rng, source, crop.source_start);
                let at = match target.fixed {
                    Some(_) => crop.target_start + start,
                    None => start,
                };
                (
                    [None, Some(self.window_of(clip, at))],
                    Some(under),
                    (at, clip),
                )
            }
            Subject::Pair(pair) => {
                let Pair { source, target, .. } = library.pairs[pair];
                let at = crop.target_start + start;
                let under = pairing
                    .partner
                    .map(|donor| partner_at(&mut rng, donor, pairing.donor.source_start));
                let before = self.window_of(source, crop.source_start + start);
                (
                    [Some(before), Some(self.window_of(target, at))],
                    under,
                    (at, target),
                )
            }
        };
        let (side, wordings) = target.side_of(&pairing);
        let wording = (pairing.wording * wordings.len() as f64) as usize;
        DrawnWindow {
            windows,
            under,
            plan: side.map(|side| &side.plan),
            alpha: pairing.alpha,
            progress: shown.0 as f64 / self.library.clips[shown.1].motion.len() as f64,
            instruction: &wordings[wording.min(wordings.len() - 1)],
        }
    }

    /// The wording of a pairing.
    pub(super) fn instruction_of(&self, epoch: u64, place: u64, pairing: &Pairing) -> &str {
        let item = self.order(epoch).at(place);
        let (_, wordings) = self.target_of(item).0.side_of(pairing);
        let wording = (pairing.wording * wordings.len() as f64) as usize;
        &wordings[wording.min(wordings.len() - 1)]
    }
}

/// The draws of an item: the same whichever batch it is in.
pub(super) fn item_rng(epoch_seed: Seed, item: u64) -> Rng {
    epoch_seed.rng_of(item)
}

struct DrawnWindow<'a> {
    /// Windows of the motions before and after the edit; before a semantic edit there is the
    /// partner alone.
    windows: [Option<&'a [Frame]>; 2],
    /// The window they are blended into.
    under: Option<&'a [Frame]>,
    plan: Option<&'a BlendPlan>,
    alpha: f64,
    progress: f64,
    instruction: &'a str,
}

impl Target {
    fn new(
        library: &Library,
        config: &ComposeConfig,
        subject: Subject,
        num_frames: usize,
        fixed: Option<Pairing>,
    ) -> Self {
        let side = |part: Option<BodyPart>| Side {
            plan: BlendPlan::new(library.mask_of(subject, part, config), config.slerp),
            wordings: library.wordings(subject, part, config),
        };
        let (sides, plain) = match subject {
            Subject::Annotation(_) => (vec![side(None)], Vec::new()),
            Subject::Pair(pair) => {
                let halves = library.pairs[pair].halves.iter();
                let sides = halves.map(|half| side(Some(*half))).collect();
                let plain = match config.plain_pairs > 0.0 {
                    true => library.wordings(subject, None, config),
                    false => Vec::new(),
                };
                (sides, plain)
            }
        };
        Self {
            subject,
            num_frames,
            sides,
            plain,
            fixed,
        }
    }

    /// The side a pairing is edited on, and the wordings of its instruction.
    fn side_of(&self, pairing: &Pairing) -> (Option<&Side>, &[String]) {
        let side = match (self.subject, pairing.half) {
            (Subject::Annotation(_), _) => &self.sides[0],
            (Subject::Pair(_), None) => return (None, &self.plain),
            (Subject::Pair(_), Some(half)) => {
                // The lower half comes first where there are both.
                let upper_of_two = self.sides.len() == 2 && half == BodyPart::UpperBody;
                &self.sides[usize::from(upper_of_two)]
            }
        };
        (Some(side), &side.wordings)
    }
}

impl Library {
    /// The clips partners are drawn from.
    ///
    /// # Errors
    /// The base is limited to kinds of source that no motion is of.
    pub(super) fn base(
        &self,
        config: &ComposeConfig,
        seed: Seed,
        span: usize,
    ) -> Result<Vec<usize>, Error> {
        let is_of_base = |clip: &Clip| clip.in_base && config.base.takes(&clip.source);
        if !self.clips.is_empty() && !self.clips.iter().any(is_of_base) {
            let found: BTreeSet<&String> = self.clips.iter().map(|clip| &clip.source).collect();
            return Err(Error::BaseSources {
                split: self.split(),
                wanted: config.base.sources.clone(),
                found: found.into_iter().cloned().collect(),
            });
        }
        let candidates: Vec<usize> = (0..self.clips.len())
            .filter(|&clip| is_of_base(&self.clips[clip]))
            .filter(|&clip| self.clips[clip].motion.len() >= span)
            .collect();
        let ids: Vec<&str> = candidates
            .iter()
            .map(|&clip| self.clips[clip].id.as_str())
            .collect();
        let kept = subset(config.mcm_ratio, seed, "motion base", &ids);
        Ok(kept.into_iter().map(|place| candidates[place]).collect())
    }

    /// The annotations and pairs in use, those that are as long as a window.
    pub(super) fn subjects(&self, config: &ComposeConfig, seed: Seed, span: usize) -> Vec<Subject> {
        let annotations = (0..self.annotations.len()).map(Subject::Annotation);
        let pairs = (0..self.pairs.len()).map(Subject::Pair);
        let candidates: Vec<Subject> = annotations
            .chain(pairs)
            .filter(|subject| config.kinds.contains(&self.kind_of(*subject)))
            .filter(|subject| self.frames_of(*subject) >= span)
            .collect();
        let ids: Vec<&str> = candidates
            .iter()
            .map(|subject| self.subject_id(*subject))
            .collect();
        subset(config.annotated_ratio, seed, "annotated set", &ids)
            .into_iter()
            .map(|place| candidates[place])
            .collect()
    }

    pub(super) fn subject_id(&self, subject: Subject) -> &str {
        match subject {
            Subject::Annotation(annotation) => &self.annotations[annotation].id,
            Subject::Pair(pair) => &self.pairs[pair].id,
        }
    }

    pub(super) fn kind_of(&self, subject: Subject) -> EditKind {
        match subject {
            Subject::Annotation(_) => EditKind::Semantic,
            Subject::Pair(pair) => self.pairs[pair].kind,
        }
    }

    /// The motion after the edit.
    pub(super) fn target_of(&self, subject: Subject) -> usize {
        match subject {
            Subject::Annotation(annotation) => self.annotations[annotation].clip,
            Subject::Pair(pair) => self.pairs[pair].target,
        }
    }

    /// The annotated motion, or both motions of a pair.
    pub(super) fn clips_of(&self, subject: Subject) -> Vec<usize> {
        match subject {
            Subject::Annotation(annotation) => vec![self.annotations[annotation].clip],
            Subject::Pair(pair) => vec![self.pairs[pair].source, self.pairs[pair].target],
        }
    }

    /// Frames that windows can be taken from.
    pub(super) fn frames_of(&self, subject: Subject) -> usize {
        let clips = self.clips_of(subject).into_iter();
        clips
            .map(|clip| self.clips[clip].motion.len())
            .min()
            .unwrap_or(0)
    }

    /// What of the partner is replaced.
    pub(super) fn mask_of(
        &self,
        subject: Subject,
        half: Option<BodyPart>,
        config: &ComposeConfig,
    ) -> BlendMask {
        let mask = match (subject, half) {
            (Subject::Annotation(annotation), _) => self.annotations[annotation].mask,
            (Subject::Pair(_), Some(half)) => half.mask(),
            (Subject::Pair(_), None) => BlendMask::EMPTY,
        };
        if config.fixed_pairs {
            whole_parts(mask)
        } else {
            mask
        }
    }

    /// All wordings of an instruction.
    pub(super) fn wordings(
        &self,
        subject: Subject,
        half: Option<BodyPart>,
        config: &ComposeConfig,
    ) -> Vec<String> {
        let text = match subject {
            Subject::Annotation(annotation) => &self.annotations[annotation].instruction,
            Subject::Pair(pair) => &self.pairs[pair].instruction,
        };
        config.phrases.wordings(text, half)
    }

    /// Whether a clip may be blended with a target: not with itself, its mirror image or another
    /// crop of the same source.
    pub(super) fn may_pair(&self, source: usize, target: usize) -> bool {
        self.clips[source].origin != self.clips[target].origin
    }

    /// Whether a clip may be the partner of an edit.
    pub(super) fn may_meet(&self, clip: usize, subject: Subject) -> bool {
        match subject {
            Subject::Annotation(annotation) => {
                self.may_pair(clip, self.annotations[annotation].clip)
            }
            Subject::Pair(pair) => {
                let Pair { source, target, .. } = self.pairs[pair];
                self.may_pair(clip, source) && self.may_pair(clip, target)
            }
        }
    }

    /// Draws a partner from the base and everything else of an edit. At least one clip of the base
    /// must be a possible partner.
    fn draw_pairing(
        &self,
        base: &[usize],
        subject: Subject,
        config: &ComposeConfig,
        rng: &mut Rng,
    ) -> Pairing {
        let partner = loop {
            let partner = base[rng.random_range(0..base.len())];
            if self.may_meet(partner, subject) {
                break partner;
            }
        };
        self.paired(partner, subject, config, rng)
    }

    /// Draws everything but the partner.
    pub(super) fn paired(
        &self,
        partner: usize,
        subject: Subject,
        config: &ComposeConfig,
        rng: &mut Rng,
    ) -> Pairing {
        let frames_of = |clip: usize| self.clips[clip].motion.len();
        let mut draw_crop = |first: usize, second: usize| match config.fixed_pairs {
            true => Crop::centred(first, second),
            false => Crop::draw(first, second, rng),
        };
        match subject {
            Subject::Annotation(annotation) => {
                let target = self.annotations[annotation].clip;
                let crop = draw_crop(frames_of(partner), frames_of(target));
                Pairing {
                    subject,
                    partner: Some(partner),
                    half: None,
                    alpha: config.alpha.draw(rng),
                    wording: rng.random(),
                    donor: Crop::whole(crop.num_frames),
                    crop,
                }
            }
            Subject::Pair(pair) => {
                let Pair {
                    source,
                    target,
                    ref halves,
                    ..
                } = self.pairs[pair];
                let mut crop = draw_crop(frames_of(source), frames_of(target));
                let plain = rng.random::<f64>() < config.plain_pairs;
                let half = halves[rng.random_range(0..halves.len())];
                // A whole-clip triplet lasts as long as the shortest of the three.
                let mut donor = match config.fixed_pairs {
                    true => Crop::centred(frames_of(partner), crop.num_frames),
                    false => Crop::draw(frames_of(partner), crop.num_frames, rng),
                };
                let alpha = config.alpha.draw(rng);
                let wording = rng.random();
                if plain {
                    return Pairing {
                        subject,
                        partner: None,
                        half: None,
                        alpha,
                        wording,
                        donor: Crop::whole(crop.num_frames),
                        crop,
                    };
                }
                if config.fixed_pairs {
                    crop.source_start += donor.target_start;
                    crop.target_start += donor.target_start;
                    crop.num_frames = donor.num_frames;
                    donor.target_start = 0;
                }
                Pairing {
                    subject,
                    partner: Some(partner),
                    half: Some(half),
                    alpha,
                    wording,
                    crop,
                    donor,
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use datasets_spec::{BodyPart, Split};
    use kinematics::canonical::WINDOW_FRAMES;
    use kinematics::normalise::NormalizedFrame;

    use super::*;
    use crate::compose::{BaseFilter, fixture};

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
        let library = Library::new(Split::Train, &motions, &masks, &[], &skeleton).expect("valid");
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
                let first = NormalizedFrame::from_model_units(&window[..FRAME_WIDTH]);
                let first = normalizer.denormalize(&first);
                let placed = kinematics::canonical::ground_transform_of(
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
                    let mut pairs: Vec<(Subject, Option<usize>, u64)> = (0..stream.epoch_len())
                        .map(|item| {
                            let pairing = stream.pairing(epoch, item);
                            (pairing.subject, pairing.partner, pairing.alpha.to_bits())
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
        let library = Library::new(Split::Train, &motions, &masks, &[], &skeleton).expect("valid");
        let stream = stream_of(library, ComposeConfig::default(), 1).expect("a stream");
        for epoch in 0..50 {
            for item in 0..stream.epoch_len() {
                let pairing = stream.pairing(epoch, item);
                let partner = pairing.partner.expect("a semantic edit");
                assert!(stream.library.may_meet(partner, pairing.subject));
            }
        }
        let alone = &motions[..1];
        let library =
            Library::new(Split::Train, alone, &masks[..1], &[], &skeleton).expect("valid");
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
        let mut partners: Vec<Option<usize>> = (0..40)
            .flat_map(|epoch| (0..stream.epoch_len()).map(move |item| (epoch, item)))
            .map(|(epoch, item)| stream.pairing(epoch, item).partner)
            .collect();
        partners.sort_unstable();
        partners.dedup();
        assert_eq!(partners.len(), 3, "0.3 of {CLIPS} clips, rounded up");
    }

    #[test]
    fn the_base_can_be_limited_to_kinds_of_source() {
        let (mut motions, masks) = fixture::rows(Split::Train, CLIPS);
        for (number, row) in motions.iter_mut().enumerate() {
            row.source = ["humanml3d", "bvh", "amass"][number % 3].to_owned();
        }
        let skeleton = datasets_spec::Skeleton::smplx_neutral();
        let stream = |sources: &[&str], mcm_ratio| {
            let library =
                Library::new(Split::Train, &motions, &masks, &[], &skeleton).expect("valid");
            let config = ComposeConfig {
                base: BaseFilter {
                    sources: sources.iter().map(|&name| name.to_owned()).collect(),
                },
                mcm_ratio,
                ..ComposeConfig::default()
            };
            stream_of(library, config, 5)
        };
        let limited = stream(&["humanml3d", "nothing"], 1.0).expect("three clips");
        for epoch in 0..10 {
            for item in 0..limited.epoch_len() {
                let partner = limited.pairing(epoch, item).partner.expect("semantic");
                assert_eq!(limited.library.clips[partner].source, "humanml3d");
            }
        }
        assert_eq!(
            limited.epoch_len(),
            stream(&[], 1.0).expect("all clips").epoch_len(),
            "targets are of any source"
        );
        assert!(matches!(
            stream(&["nothing"], 1.0),
            Err(Error::BaseSources { found, .. }) if found == ["amass", "bvh", "humanml3d"]
        ));
    }

    fn pair_stream(config: ComposeConfig, same_motion: bool) -> Stream {
        let (motions, masks) = fixture::rows(Split::Train, CLIPS);
        let target = if same_motion { 5 } else { 6 };
        let pairs = [("style", 5, target), ("fine-grained", 7, 8)]
            .map(|(kind, source, target)| fixture::pair_row(kind, Split::Train, source, target));
        let skeleton = datasets_spec::Skeleton::smplx_neutral();
        let library = Library::new(Split::Train, &motions, &masks, &pairs, &skeleton);
        stream_of(library.expect("valid"), config, 5).expect("a stream")
    }

    #[test]
    fn one_donor_is_under_both_windows_of_a_pair() {
        // The pair is a motion and itself: whatever is drawn, both windows must be the same.
        let stream = pair_stream(
            ComposeConfig {
                kinds: vec![EditKind::Style],
                ..ComposeConfig::default()
            },
            true,
        );
        for epoch_number in 0..20 {
            let batch = epoch(&stream, epoch_number);
            assert_eq!(batch.original, batch.edited);
            for instruction in &batch.instructions {
                let parts = ["using their upper body.", "using their lower body."];
                let ends = |part: &&str| instruction.ends_with(*part);
                assert!(parts.iter().any(ends), "{instruction}");
            }
        }
    }

    #[test]
    fn kinds_and_plain_pairs_can_be_chosen() {
        let kinds_of = |kinds: Vec<EditKind>| {
            let config = ComposeConfig {
                kinds,
                ..ComposeConfig::default()
            };
            let stream = pair_stream(config, false);
            let mut found: Vec<EditKind> = (0..stream.epoch_len())
                .map(|item| stream.kind(0, item))
                .collect();
            found.sort_unstable();
            found.dedup();
            found
        };
        assert_eq!(kinds_of(EditKind::ALL.to_vec()), EditKind::ALL);
        assert_eq!(
            kinds_of(vec![EditKind::FineGrained]),
            [EditKind::FineGrained]
        );
        for plain_pairs in [0.0, 0.5, 1.0] {
            let config = ComposeConfig {
                kinds: vec![EditKind::Style, EditKind::FineGrained],
                plain_pairs,
                ..ComposeConfig::default()
            };
            let stream = pair_stream(config, false);
            let items = (0..60).flat_map(|epoch| (0..stream.epoch_len()).map(move |i| (epoch, i)));
            let (mut plain, mut count) = (0, 0);
            for (epoch, item) in items {
                let pairing = stream.pairing(epoch, item);
                assert_eq!(pairing.partner.is_none(), pairing.half.is_none());
                plain += u32::from(pairing.partner.is_none());
                count += 1;
            }
            // Some 200 fair coins: six standard deviations.
            let share = f64::from(plain) / f64::from(count);
            assert!(
                (share - plain_pairs).abs() <= 0.25,
                "{share} of {plain_pairs}"
            );
            assert!(plain_pairs == 0.5 || share == plain_pairs);
        }
    }

    #[test]
    fn paraphrases_are_drawn_and_templates_filled_in() {
        let mut config = ComposeConfig {
            kinds: vec![EditKind::Style],
            ..ComposeConfig::default()
        };
        let said = "Replace a person with an old look";
        config
            .phrases
            .paraphrases
            .insert(said.to_owned(), vec!["Walk like a grandparent.".to_owned()]);
        config
            .phrases
            .of_parts
            .push("With their {part}: {instruction}!".to_owned());
        let stream = pair_stream(config, false);
        let expected = stream.instructions();
        // Two texts, two templates, two halves.
        assert_eq!(expected.len(), 8, "{expected:?}");
        assert!(expected.contains(&"With their upper body: Walk like a grandparent!".to_owned()));
        let mut found: Vec<String> = (0..60)
            .flat_map(|number| epoch(&stream, number).instructions)
            .collect();
        found.sort_unstable();
        found.dedup();
        assert_eq!(found, expected);
    }

    #[test]
    fn a_warped_pair_lasts_as_long_as_its_target() {
        let stream = |alignment| {
            let config = ComposeConfig {
                kinds: vec![EditKind::FineGrained],
                alignment,
                ..ComposeConfig::default()
            };
            pair_stream(config, false)
        };
        use crate::compose::Alignment::{None, TimeWarp};
        let frames = |stream: &Stream| stream.library.frames_of(Subject::Pair(0));
        let clips = |stream: &Stream| [7, 8].map(|clip| stream.library.clips[clip].motion.len());
        let (plain, warped) = (stream(None), stream(TimeWarp));
        let pair = plain
            .library
            .pairs
            .iter()
            .position(|p| p.kind == EditKind::FineGrained);
        let warped_frames = warped
            .library
            .frames_of(Subject::Pair(pair.expect("a pair")));
        assert_eq!(warped_frames, clips(&warped)[1]);
        assert!(frames(&plain) <= warped_frames);
        // A warped motion is nobody's partner.
        assert!(warped.base.iter().all(|&clip| clip < CLIPS));
        assert_ne!(epoch(&plain, 0), epoch(&warped, 0));
    }

    #[test]
    fn fixed_pairs_take_whole_parts_from_the_middle() {
        let config = ComposeConfig {
            fixed_pairs: true,
            ..ComposeConfig::default()
        };
        let stream = pair_stream(config, false);
        for item in 0..stream.epoch_len() {
            let triplet = stream.triplet(0, item);
            assert!(triplet.mask.soft().is_empty());
            let frames = |id: &datasets_spec::MotionId| {
                let clips = &stream.library.clips;
                let clip = clips.iter().find(|clip| clip.id == *id).expect("a clip");
                clip.motion.len()
            };
            if triplet.kind == "semantic" {
                let rest = frames(&triplet.source_id) - triplet.original.len();
                assert_eq!(triplet.source_start, rest / 2);
            }
        }
    }

    #[test]
    fn a_split_without_long_masks_is_refused() {
        let skeleton = datasets_spec::Skeleton::smplx_neutral();
        let (motions, _) = fixture::rows(Split::Train, 3);
        let short = fixture::wandering("short", fixture::SPAN - 1);
        let row = fixture::motion_row("short", Split::Train, &short);
        let rows = [motions, vec![row]].concat();
        let mask = fixture::mask_row("short", Split::Train, BodyPart::LeftArm);
        let library = Library::new(Split::Train, &rows, &[mask], &[], &skeleton).expect("valid");
        assert!(matches!(
            stream_of(library, ComposeConfig::default(), 1),
            Err(Error::NoItem {
                frames: fixture::SPAN,
                ..
            })
        ));
    }
}
