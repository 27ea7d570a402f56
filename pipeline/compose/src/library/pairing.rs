//! Drawing of subjects, partners and donors.

use std::collections::BTreeSet;
use std::ops::{Range, RangeInclusive};

use datasets_spec::sides::mirrored;
use datasets_spec::{BlendMask, BodyPart, Rng, Seed};
use rand::RngExt;

use super::{Clip, Edit, Library};
use crate::config::EditKind;
use crate::draw::{Crop, subset};
use crate::sinc::whole_parts;
use crate::{ComposeConfig, Error, ItemTask};

/// The annotation or pair that an item is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Subject {
    Annotation(usize),
    Pair(usize),
}

/// The clips, crops and draws that an edit is composed of.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pairing {
    pub(crate) subject: Subject,
    /// Index of the clip from the base: the source of a semantic edit, or the donor of a pair; `None` for
    /// a pair without a donor.
    pub(crate) partner: Option<usize>,
    /// Half of the body that a blended pair is edited in.
    pub(crate) half: Option<BodyPart>,
    pub(crate) alpha: f64,
    /// Position of the chosen wording among all wordings of the instruction, in [0, 1).
    pub(crate) wording: f64,
    /// Common frames of the partner and the annotated motion, or of the two motions of a pair.
    pub(crate) crop: Crop,
    /// Common frames of the donor and of `crop` (whole-clip triplets only).
    pub(crate) donor: Crop,
}

impl Library {
    /// The clips partners are drawn from.
    pub(crate) fn base(
        &self,
        config: &ComposeConfig,
        seed: Seed,
        span: usize,
    ) -> Result<Vec<usize>, Error> {
        let is_of_base = |clip: &Clip| clip.in_base && config.base.takes(&clip.source);
        if !self.clips.is_empty() && !self.clips.iter().any(is_of_base) {
            let found: BTreeSet<&str> = self.clips.iter().map(|clip| &*clip.source).collect();
            return Err(Error::Refused(format!(
                "split {} has no motion of the sources that base.sources names ({}); it has motions of {}: correct the \
                 setting or ingest such motions",
                self.split,
                config.base.sources.join(", "),
                Vec::from_iter(found).join(", ")
            )));
        }
        let candidates: Vec<usize> = (0..self.clips.len())
            .filter(|&clip| is_of_base(&self.clips[clip]))
            .filter(|&clip| self.clips[clip].len() >= span)
            .collect();
        let ids: Vec<&str> = candidates
            .iter()
            .map(|&clip| self.clips[clip].id.as_str())
            .collect();
        let kept = subset(config.mcm_ratio, seed, "motion base", &ids);
        Ok(kept.into_iter().map(|place| candidates[place]).collect())
    }

    /// The annotations and pairs in use: those at least as long as a window.
    pub(crate) fn subjects(&self, config: &ComposeConfig, seed: Seed, span: usize) -> Vec<Subject> {
        let candidates: Vec<Subject> = self
            .all_subjects()
            .filter(|subject| config.kinds.contains(&self.edit(*subject).kind))
            .filter(|subject| self.frames_of(*subject) >= span)
            .collect();
        let ids: Vec<&str> = candidates
            .iter()
            .map(|subject| self.edit(*subject).id.as_str())
            .collect();
        subset(config.annotated_ratio, seed, "annotated set", &ids)
            .into_iter()
            .map(|place| candidates[place])
            .collect()
    }

    /// Number of masks and pairs of the wanted kinds that are shorter than a window, and are not used.
    pub(crate) fn num_short(&self, config: &ComposeConfig, span: usize) -> usize {
        self.all_subjects()
            .filter(|subject| config.kinds.contains(&self.edit(*subject).kind))
            .filter(|subject| self.frames_of(*subject) < span)
            .count()
    }

    pub(crate) fn edit(&self, subject: Subject) -> &Edit {
        match subject {
            Subject::Annotation(annotation) => &self.annotations[annotation],
            Subject::Pair(pair) => &self.pairs[pair],
        }
    }

    /// The clips before and after the edit, aligned in time. For an annotation, both are the annotated clip.
    pub(crate) fn clips_of(&self, subject: Subject) -> [usize; 2] {
        let Edit { source, target, .. } = self.edit(subject);
        [*source, *target]
    }

    pub(crate) fn len_of(&self, clip: usize) -> usize {
        self.clips[clip].len()
    }

    /// Frames that windows can be taken from.
    pub(crate) fn frames_of(&self, subject: Subject) -> usize {
        let held = self.edit(subject).frames.len();
        let clips = self.clips_of(subject).into_iter();
        clips.fold(held, |least, clip| least.min(self.clips[clip].len()))
    }

    /// The frames of a semantic edit's crop that the instruction is about.
    pub(crate) fn edited_of(&self, pairing: &Pairing) -> Range<usize> {
        let (held, crop) = (&self.edit(pairing.subject).frames, pairing.crop);
        let in_crop = |frame: usize| frame.saturating_sub(crop.target_start).min(crop.num_frames);
        in_crop(held.start)..in_crop(held.end)
    }

    /// The mask of a blend. `half` is the half of a pair that the donor gives; annotations have none.
    pub(crate) fn mask_of(
        &self,
        subject: Subject,
        half: Option<BodyPart>,
        config: &ComposeConfig,
    ) -> BlendMask {
        let mask = half.map_or(self.edit(subject).mask, BodyPart::mask);
        match config.fixed_pairs {
            true => whole_parts(mask),
            false => mask,
        }
    }

    /// Every text that describes an edit of the library: with and without a donor, and of every kind and length, because
    /// pairs of MotionFix are test questions even if they are shorter than a window.
    pub fn instructions(&self, config: &ComposeConfig) -> BTreeSet<String> {
        let mut texts = BTreeSet::new();
        for subject in self.all_subjects() {
            let halves = self.edit(subject).halves.iter().copied().map(Some);
            for half in halves.chain([None]) {
                texts.extend(self.wordings(subject, half, config));
            }
        }
        if config.mirrored_ratio > 0.0 {
            let images: Vec<String> = texts.iter().map(|text| mirrored(text)).collect();
            texts.extend(images);
        }
        texts
    }

    pub(crate) fn wordings(
        &self,
        subject: Subject,
        half: Option<BodyPart>,
        config: &ComposeConfig,
    ) -> Vec<String> {
        let text = &self.edit(subject).instruction;
        config.phrases.wordings(text, half)
    }

    /// Whether two clips may be blended: not a clip with itself, its mirror image or another crop of the
    /// same source.
    pub(crate) fn may_pair(&self, source: usize, target: usize) -> bool {
        self.clips[source].origin != self.clips[target].origin
    }

    pub(crate) fn may_meet(&self, clip: usize, subject: Subject) -> bool {
        let [source, target] = self.clips_of(subject);
        self.may_pair(clip, source) && self.may_pair(clip, target)
    }

    /// Whether any clip of the base can be a partner.
    pub(crate) fn has_partner(&self, base: &[usize], subject: Subject) -> bool {
        base.iter().any(|&clip| self.may_meet(clip, subject))
    }

    /// Whether any triplet of a subject is blended with a partner.
    pub(crate) fn takes_partner(&self, subject: Subject, config: &ComposeConfig) -> bool {
        self.undonored_ratio(subject, config) < 1.0
    }

    /// Draws a partner from the base and everything else of an edit. Only a subject that takes no partner may have none.
    pub(crate) fn draw_pairing(
        &self,
        base: &[usize],
        subject: Subject,
        config: &ComposeConfig,
        rng: &mut Rng,
    ) -> Pairing {
        let draw = || loop {
            let partner = base[rng.random_range(0..base.len())];
            if self.may_meet(partner, subject) {
                break partner;
            }
        };
        let partner = self.has_partner(base, subject).then(draw);
        self.paired(partner, subject, config, rng)
    }

    /// Draws everything but the partner.
    pub(crate) fn paired(
        &self,
        partner: Option<usize>,
        subject: Subject,
        config: &ComposeConfig,
        rng: &mut Rng,
    ) -> Pairing {
        let frames_of = |clip: usize| self.len_of(clip);
        let place = |allowed: RangeInclusive<usize>, rng: &mut Rng| match config.fixed_pairs {
            // The middle, as in SINC.
            true => (allowed.start() + allowed.end()) / 2,
            false => rng.random_range(allowed),
        };
        let crop_of = |first: usize, second: usize, held: &Range<usize>, rng: &mut Rng| {
            Crop::around(first, second, held, |allowed| place(allowed, rng))
        };
        let Edit {
            source,
            target,
            frames,
            halves,
            ..
        } = self.edit(subject);
        let target_frames = frames_of(*target);
        match subject {
            Subject::Annotation(_) => {
                let source = partner.expect("a semantic edit has a source");
                let crop = crop_of(frames_of(source), target_frames, frames, rng);
                Pairing {
                    subject,
                    partner,
                    half: None,
                    alpha: config.alpha.draw(rng),
                    wording: rng.random(),
                    donor: Crop::whole(crop.num_frames),
                    crop,
                }
            }
            Subject::Pair(_) => {
                let mut crop = crop_of(frames_of(*source), target_frames, frames, rng);
                let plain = rng.random::<f64>() < self.undonored_ratio(subject, config);
                let half = halves[rng.random_range(0..halves.len())];
                // A whole-clip triplet lasts as long as the shortest of the three.
                let whole = 0..crop.num_frames;
                let mut donor = partner.map_or(Crop::whole(crop.num_frames), |partner| {
                    crop_of(frames_of(partner), crop.num_frames, &whole, rng)
                });
                if plain {
                    donor = Crop::whole(crop.num_frames);
                } else if config.fixed_pairs {
                    crop.source_start += donor.target_start;
                    crop.target_start += donor.target_start;
                    crop.num_frames = donor.num_frames;
                    donor.target_start = 0;
                }
                Pairing {
                    subject,
                    partner: partner.filter(|_| !plain),
                    half: (!plain).then_some(half),
                    alpha: config.alpha.draw(rng),
                    wording: rng.random(),
                    crop,
                    donor,
                }
            }
        }
    }

    /// All annotations and pairs, usable or not.
    pub(crate) fn all_subjects(&self) -> impl Iterator<Item = Subject> + use<> {
        let annotations = (0..self.annotations.len()).map(Subject::Annotation);
        annotations.chain((0..self.pairs.len()).map(Subject::Pair))
    }

    /// Whether a subject is a test question as captured, without composition.
    pub(crate) fn is_asked_as_is(&self, subject: Subject) -> bool {
        self.task_of(subject) == ItemTask::MotionFix
    }

    /// Probability that a subject is used without a partner.
    pub(crate) fn undonored_ratio(&self, subject: Subject, config: &ComposeConfig) -> f64 {
        match subject {
            Subject::Annotation(_) => 0.0,
            Subject::Pair(pair) => config.undonored_ratio_of(self.pairs[pair].is_motionfix),
        }
    }

    pub(crate) fn task_of(&self, subject: Subject) -> ItemTask {
        let edit = self.edit(subject);
        match edit.kind {
            _ if edit.is_motionfix => ItemTask::MotionFix,
            EditKind::Semantic => ItemTask::Semantic,
            EditKind::Style => ItemTask::Style,
            EditKind::FineGrained => ItemTask::FineGrained,
        }
    }

    /// The clips before and after an edit, as stored in the dataset.
    pub(crate) fn captured_of(&self, subject: Subject) -> [usize; 2] {
        let Edit {
            captured, target, ..
        } = self.edit(subject);
        [*captured, *target]
    }

    /// The best partners in the base: clips of another action that are as long as `preferred` or the
    /// target, else clips of another action, else any. Empty if there is none.
    pub(crate) fn partners(
        &self,
        base: &[usize],
        subject: Subject,
        preferred: usize,
    ) -> Vec<usize> {
        let target = &self.clips[self.edit(subject).target];
        let mut other = base.to_vec();
        other.retain(|&clip| self.may_meet(clip, subject));
        let same_action = |clip: &Clip| clip.action.is_some() && clip.action == target.action;
        let mut other_action = other.clone();
        other_action.retain(|&clip| !same_action(&self.clips[clip]));
        let needed = preferred.min(self.frames_of(subject));
        let mut long = other_action.clone();
        long.retain(|&clip| self.clips[clip].len() >= needed);
        let mut found = [long, other_action, other].into_iter();
        let found = found.find(|partners| !partners.is_empty());
        found.unwrap_or_default()
    }

    /// The error about a subject that no clip of the base can be blended with.
    pub(crate) fn no_partner(&self, subject: Subject) -> Error {
        Error::Refused(format!(
            "motion {} has no partner: no other clip drawn from its split is long enough; add motions, raise mcm_ratio \
             or widen base.sources",
            self.clips[self.edit(subject).target].id
        ))
    }

    /// The instruction of the dataset, with the part added by the first template.
    pub(crate) fn first_wording(&self, pairing: &Pairing, config: &ComposeConfig) -> String {
        let wordings = self.wordings(pairing.subject, pairing.half, config);
        wordings.into_iter().next().unwrap_or_default()
    }
}
