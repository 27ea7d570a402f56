//! Whole-clip triplets: recorded items of a stream.

use std::ops::Range;

use datasets_spec::record::TripletRow;
use datasets_spec::{BlendMask, Fps, JointSet, Motion, MotionId, Seed, Split};

use super::library::{Pairing, Subject};
use super::{Alignment, ComposeConfig, Error, Library, Stream, blend_motion};
use crate::during::{keep_outside, leaves_frames};

/// An original motion, an instruction, and the edited motion it leads to. Both motions have the
/// same length and rate; outside the mask their local rotations are the same to the last bit.
#[derive(Clone, Debug, PartialEq)]
pub struct Triplet {
    /// Id in the stream.
    pub id: String,
    /// Split of all motions of the triplet.
    pub split: Split,
    /// Kind of the edit: [`super::EditKind`].
    pub kind: &'static str,
    /// The instruction of the edit.
    pub instruction: String,
    /// The motion the original was cut from.
    pub source_id: MotionId,
    /// The motion that the edit is taken from.
    pub target_id: MotionId,
    /// Motions blended under both sides; none for semantic edits.
    pub donor_ids: Vec<MotionId>,
    /// First stored frame that is used of the source.
    pub source_start: usize,
    /// First stored frame that is used of the target.
    pub target_start: usize,
    /// First stored frame of the donor; 0 without a donor.
    pub donor_start: usize,
    /// Time alignment of the motions of a pair; with `time-warp`, the source's start counts frames of the warped
    /// motion.
    pub alignment: &'static str,
    /// Joints that the edit takes from the target.
    pub mask: BlendMask,
    /// Frames of both motions that the edit may change; all others equal the original's.
    pub edited_frames: Range<usize>,
    /// Weight of the target on soft joints.
    pub alpha: f64,
    /// Seed of the stream.
    pub seed: Seed,
    /// Epoch of the stream.
    pub epoch: u64,
    /// [`ComposeConfig::recipe_hash`] of the settings it was composed with.
    pub recipe_hash: String,
    /// The motion before the edit.
    pub original: Motion,
    /// The motion after the edit.
    pub edited: Motion,
}

impl Stream {
    /// Composes the whole-clip triplet of an item: the partner, the mask and the alpha that
    /// [`Stream::fill`] uses for the same item, on all frames the clips share.
    ///
    /// # Errors
    /// The motions cannot be read.
    ///
    /// # Panics
    /// If the item is not in the epoch.
    pub fn triplet(&self, epoch: u64, item: u64) -> Result<Triplet, Error> {
        let pairing = self.pairing(epoch, item);
        let place = Place {
            id: self.triplet_id(epoch, item),
            seed: self.seed,
            epoch,
            recipe_hash: self.recipe_hash.clone(),
            instruction: self.instruction_of(epoch, item, &pairing).to_owned(),
        };
        self.library.compose(place, &pairing, &self.config)
    }

    /// Composes the whole-clip triplet of one of the [`Stream::num_clips`] annotated motions and pairs in use, with the
    /// partner, the mask and the alpha of an epoch. It differs from every [`Stream::triplet`], of which a motion has
    /// one per window.
    ///
    /// # Errors
    /// The motions cannot be read.
    ///
    /// # Panics
    /// If the number is not below [`Stream::num_clips`].
    pub fn clip(&self, epoch: u64, number: u64) -> Result<Triplet, Error> {
        let (pairing, instruction) = self.clip_pairing(epoch, number);
        let kind = self.library.kind_of(pairing.subject).as_str();
        let place = Place {
            id: format!("{}-{kind}-clip-{epoch}-{number}", self.library.split()),
            seed: self.seed,
            epoch,
            recipe_hash: self.recipe_hash.clone(),
            instruction: instruction.to_owned(),
        };
        self.library.compose(place, &pairing, &self.config)
    }

    /// Composes a recorded triplet again, bit for bit, from its id alone.
    ///
    /// # Errors
    /// The id is not one of this stream's, or the motions cannot be read.
    pub fn explain(&self, id: &str) -> Result<Triplet, Error> {
        let unknown = || Error::TripletId {
            id: id.to_owned(),
            expected: format!(
                "{}-KIND-EPOCH-ITEM with ITEM below {}",
                self.library.split(),
                self.epoch_len()
            ),
        };
        let mut parts = id.split('-').rev();
        let mut number = || parts.next()?.parse::<u64>().ok();
        let (item, epoch) = number().zip(number()).ok_or_else(unknown)?;
        // Comparing with the canonical id refuses other splits, other kinds and leading zeros.
        if item >= self.epoch_len() || self.triplet_id(epoch, item) != id {
            return Err(unknown());
        }
        self.triplet(epoch, item)
    }

    /// The crop of the target from which a triplet of this stream takes its edit.
    ///
    /// # Errors
    /// The motions cannot be read.
    ///
    /// # Panics
    /// If the triplet is another stream's.
    pub fn taken(&self, triplet: &Triplet) -> Result<Motion, Error> {
        self.stretch(&triplet.target_id, triplet.target_start, triplet)
    }

    /// The edited motion without soft joints.
    ///
    /// # Errors
    /// The motions cannot be read.
    ///
    /// # Panics
    /// If the triplet is another stream's.
    pub fn with_hard_mask(&self, triplet: &Triplet) -> Result<Motion, Error> {
        let under = match triplet.donor_ids.first() {
            Some(donor) => self.stretch(donor, triplet.donor_start, triplet)?,
            None => triplet.original.clone(),
        };
        let mask = BlendMask::new(triplet.mask.hard(), JointSet::EMPTY).expect("nothing is soft");
        let taken = self.taken(triplet)?;
        let blended = blend_motion(&under, &taken, mask, 0.0, self.config.slerp)?;
        within(&under, blended, &triplet.edited_frames)
    }

    fn stretch(&self, id: &MotionId, start: usize, triplet: &Triplet) -> Result<Motion, Error> {
        let clip = self.library.captured(id);
        clip.crop(start..start + triplet.original.len())
    }

    fn triplet_id(&self, epoch: u64, item: u64) -> String {
        let kind = self.kind(epoch, item).as_str();
        format!("{}-{kind}-{epoch}-{item}", self.library.split())
    }
}

/// Edits only some frames: the others equal the original, and [`keep_outside`] joins both.
pub(super) fn within(
    original: &Motion,
    edited: Motion,
    frames: &Range<usize>,
) -> Result<Motion, Error> {
    let frames = std::slice::from_ref(frames);
    match leaves_frames(original.len(), frames) {
        true => Ok(keep_outside(original, &edited, frames)?),
        false => Ok(edited),
    }
}

/// Identity of a triplet: id, seed, epoch, recipe and instruction.
pub(super) struct Place {
    pub(super) id: String,
    pub(super) seed: Seed,
    pub(super) epoch: u64,
    pub(super) recipe_hash: String,
    pub(super) instruction: String,
}

impl Library {
    pub(super) fn compose(
        &self,
        place: Place,
        pairing: &Pairing,
        config: &ComposeConfig,
    ) -> Result<Triplet, Error> {
        if config.mirrored_ratio > 0.0 {
            return Err(Error::MirroredClip);
        }
        let cut = |clip: usize, start: usize, len: usize| self.clip(clip).crop(start..start + len);
        let mask = match pairing.partner {
            Some(_) => self.mask_of(pairing.subject, pairing.half, config),
            None => BlendMask::EMPTY,
        };
        let blend = |under: &Motion, over: &Motion| {
            blend_motion(under, over, mask, pairing.alpha, config.slerp)
        };
        let (crop, donor) = (pairing.crop, pairing.donor);
        let id_of = |clip: usize| self.clip(clip).id.clone();
        let target = self.target_of(pairing.subject);
        let edited_frames = match pairing.subject {
            Subject::Annotation(_) => self.edited_of(pairing),
            Subject::Pair(_) => 0..donor.num_frames,
        };
        let (source_id, starts, original, edited, donors) = match (pairing.subject, pairing.partner)
        {
            (Subject::Annotation(_), partner) => {
                let source = partner.expect("a semantic edit has a source");
                let original = cut(source, crop.source_start, crop.num_frames)?;
                let taken = cut(target, crop.target_start, crop.num_frames)?;
                let edited = within(&original, blend(&original, &taken)?, &edited_frames)?;
                let starts = (crop.source_start, crop.target_start);
                (id_of(source), starts, original, edited, Vec::new())
            }
            (Subject::Pair(_), partner) => {
                let source = self.clips_of(pairing.subject)[0];
                let shift = donor.target_start;
                let starts = (crop.source_start + shift, crop.target_start + shift);
                let before = cut(source, starts.0, donor.num_frames)?;
                let after = cut(target, starts.1, donor.num_frames)?;
                let source_id = id_of(self.captured_of(pairing.subject)[0]);
                match partner {
                    None => (source_id, starts, before, after, Vec::new()),
                    Some(clip) => {
                        let under = cut(clip, donor.source_start, donor.num_frames)?;
                        let (original, edited) = (blend(&under, &before)?, blend(&under, &after)?);
                        (source_id, starts, original, edited, vec![id_of(clip)])
                    }
                }
            }
        };
        let is_pair = matches!(pairing.subject, Subject::Pair(_));
        Ok(Triplet {
            id: place.id,
            split: self.split(),
            kind: self.kind_of(pairing.subject).as_str(),
            instruction: place.instruction,
            source_id,
            target_id: id_of(target),
            donor_ids: donors,
            source_start: starts.0,
            target_start: starts.1,
            donor_start: donor.source_start,
            alignment: if is_pair {
                config.alignment.as_str()
            } else {
                Alignment::None.as_str()
            },
            mask,
            edited_frames,
            alpha: pairing.alpha,
            seed: place.seed,
            epoch: place.epoch,
            recipe_hash: place.recipe_hash,
            original,
            edited,
        })
    }
}

impl Triplet {
    /// The rate of both motions.
    pub fn fps(&self) -> Fps {
        self.original.fps()
    }

    /// First edited frame and one past the last, as in the tables; none if all frames may change.
    ///
    /// # Panics
    /// As [`Triplet::to_row`].
    pub(super) fn edit_bounds(&self) -> [Option<i32>; 2] {
        let Range { start, end } = self.edited_frames;
        let is_part = (start, end) != (0, self.original.len());
        let bound = |frame: usize| i32::try_from(frame).expect("fewer than 2 billion frames");
        [start, end].map(|frame| is_part.then(|| bound(frame)))
    }

    /// The row of table `triplets`.
    ///
    /// # Panics
    /// If the motions have more frames than the table can count, 2 billion.
    pub fn to_row(&self) -> TripletRow {
        let frames = |count: usize| i32::try_from(count).expect("fewer than 2 billion frames");
        let [edit_start, edit_end] = self.edit_bounds();
        TripletRow {
            id: self.id.clone(),
            split: self.split,
            kind: self.kind.to_owned(),
            instruction: self.instruction.clone(),
            source_id: self.source_id.clone(),
            target_id: self.target_id.clone(),
            donor_ids: self.donor_ids.iter().map(MotionId::to_string).collect(),
            source_start: frames(self.source_start),
            target_start: frames(self.target_start),
            donor_start: frames(self.donor_start),
            alignment: self.alignment.to_owned(),
            hard_joints: self.mask.hard().names(),
            soft_joints: self.mask.soft().names(),
            edit_start,
            edit_end,
            alpha: self.alpha as f32,
            seed: self.seed.0,
            epoch: self.epoch,
            recipe_hash: self.recipe_hash.clone(),
            fps: self.fps().get() as f32,
            n_frames: frames(self.original.len()),
            original_transl: self.original.transl().to_vec(),
            original_global_orient: self.original.global_orient().to_vec(),
            original_body_pose: self.original.body_pose().to_vec(),
            edited_transl: self.edited.transl().to_vec(),
            edited_global_orient: self.edited.global_orient().to_vec(),
            edited_body_pose: self.edited.body_pose().to_vec(),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use proptest::prelude::*;

    use super::*;
    use crate::{EditKind, fixture};

    const CLIPS: usize = 9;

    fn stream(config: ComposeConfig) -> Stream {
        let library = fixture::library(Split::Train, CLIPS);
        fixture::stream(library, config, 5).expect("a stream")
    }

    #[test]
    fn a_triplet_is_explained_bit_for_bit_by_another_stream() {
        for fixed_pairs in [false, true] {
            let config = ComposeConfig {
                fixed_pairs,
                ..ComposeConfig::default()
            };
            let (recorded, later) = (stream(config.clone()), stream(config));
            for item in 0..recorded.epoch_len() {
                let triplet = recorded.triplet(2, item).expect("in memory");
                assert_eq!(later.explain(&triplet.id).expect("its own id"), triplet);
                assert_eq!(
                    later.explain(&triplet.id).expect("its own id").to_row(),
                    triplet.to_row()
                );
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn a_triplet_of_any_seed_is_explained(
            seed in any::<u64>(), epoch in any::<u32>(), at in any::<prop::sample::Index>(),
            alignment in prop::sample::select(vec![Alignment::None, Alignment::TimeWarp]),
            fixed_pairs in any::<bool>(), undonored_ratio in 0.0..1.0f64,
        ) {
            let (motions, masks) = fixture::rows(Split::Train, CLIPS);
            let pairs = [fixture::pair_row("style", Split::Train, 5, 6)];
            let library = Arc::new(fixture::library_of(Split::Train, &motions, &masks, &pairs));
            let config = ComposeConfig {
                alignment,
                fixed_pairs,
                undonored_ratio: Some(undonored_ratio),
                ..ComposeConfig::default()
            };
            let normalizer = library.fit_normalizer(&config).expect("long enough");
            let stream = || {
                let library = Arc::clone(&library);
                Stream::new(library, config.clone(), Seed(seed), &normalizer).expect("a stream")
            };
            let recorded = stream();
            let item = at.index(recorded.epoch_len() as usize) as u64;
            let triplet = recorded.triplet(epoch.into(), item).expect("in memory");
            let explained = stream().explain(&triplet.id).expect("its own id");
            prop_assert_eq!(explained.to_row(), triplet.to_row());
            prop_assert_eq!(explained, triplet);
        }
    }

    #[test]
    fn clips_meet_other_partners_in_every_epoch_unless_pairs_are_fixed() {
        for fixed_pairs in [false, true] {
            let config = ComposeConfig {
                fixed_pairs,
                ..ComposeConfig::default()
            };
            let stream = stream(config);
            let mut told = 0;
            for number in 0..stream.num_clips() {
                let clip = |epoch| stream.clip(epoch, number).expect("in memory");
                let [first, second] = [0, 1].map(clip);
                assert_eq!(first.target_id, second.target_id);
                assert_eq!(clip(0), first);
                assert_eq!(first.original.len(), first.edited.len());
                told += usize::from(first.original != second.original);
            }
            assert_eq!(told > 0, !fixed_pairs);
        }
    }

    #[test]
    fn a_pair_keeps_its_donor_on_both_sides_bit_for_bit() {
        let (motions, masks) = fixture::rows(Split::Train, CLIPS);
        let pairs = [fixture::pair_row("style", Split::Train, 5, 6)];
        let library = Arc::new(fixture::library_of(Split::Train, &motions, &masks, &pairs));
        for fixed_pairs in [false, true] {
            let config = ComposeConfig {
                kinds: vec![EditKind::Style],
                fixed_pairs,
                ..ComposeConfig::default()
            };
            let stream = fixture::stream(Arc::clone(&library), config, 8).expect("a stream");
            let motion_of = |id: &MotionId| {
                let row = motions.iter().find(|row| row.id == *id).expect("a clip");
                row.motion().expect("valid")
            };
            for (epoch, item) in (0..10).flat_map(|e| (0..stream.epoch_len()).map(move |i| (e, i)))
            {
                let triplet = stream.triplet(epoch, item).expect("in memory");
                assert_eq!(stream.explain(&triplet.id).expect("its own id"), triplet);
                let frames = triplet.original.len();
                let cut = |id: &MotionId, start: usize| {
                    motion_of(id).crop(start..start + frames).expect("inside")
                };
                let donor = cut(&triplet.donor_ids[0], triplet.donor_start);
                let source = cut(&triplet.source_id, triplet.source_start);
                let target = cut(&triplet.target_id, triplet.target_start);
                let mask = triplet.mask;
                for frame in 0..frames {
                    for (side, own) in [(&triplet.original, &source), (&triplet.edited, &target)] {
                        for joint in 0..22 {
                            let found = side.axis_angle(frame, joint);
                            if mask.hard().contains(joint) {
                                assert_eq!(found, own.axis_angle(frame, joint));
                            } else if !mask.soft().contains(joint) {
                                assert_eq!(found, donor.axis_angle(frame, joint));
                            }
                        }
                        let root = if mask.moves_root() { own } else { &donor };
                        assert_eq!(side.transl()[frame], root.transl()[frame]);
                    }
                }
            }
        }
    }

    #[test]
    fn pairs_with_motions_of_other_splits_are_refused() {
        let (motions, _) = fixture::rows(Split::Train, CLIPS);
        let train = fixture::pair_row("style", Split::Train, 1, 2);
        let library = |split, pair: &datasets_spec::record::PairRow| {
            Library::new(split, &motions, &[], std::slice::from_ref(pair))
        };
        assert!(library(Split::Train, &train).is_ok());
        let test = fixture::pair_row("style", Split::Test, 1, 2);
        assert!(matches!(
            library(Split::Train, &test),
            Err(Error::OtherSplit { .. })
        ));
        let mut foreign = train.clone();
        foreign.target_id = MotionId::parse("clip-of-test").expect("valid");
        assert!(matches!(
            library(Split::Train, &foreign),
            Err(Error::UnknownMotion { .. })
        ));
        let mut unsaid = train.clone();
        unsaid.style = None;
        assert!(matches!(
            library(Split::Train, &unsaid),
            Err(Error::EmptyText { .. })
        ));
        let mut odd = train;
        odd.kind = "regen".to_owned();
        assert!(matches!(
            library(Split::Train, &odd),
            Err(Error::PairKind { .. })
        ));
    }

    #[test]
    fn ids_of_other_streams_are_refused() {
        let stream = stream(ComposeConfig::default());
        for id in [
            "",
            "train",
            "train-semantic-0",
            "train-semantic-0-99999",
            "train-semantic-00-1",
            "test-semantic-0-1",
            "train-style-0-1",
            "train-semantic-0-x",
        ] {
            assert!(
                matches!(stream.explain(id), Err(Error::TripletId { .. })),
                "{id:?}"
            );
        }
    }

    /// The stream of one annotated clip of 135 frames whose mask holds for frames 50 to 90.
    fn ranged(config: ComposeConfig) -> (Stream, Motion) {
        let (motions, mut masks) = fixture::rows(Split::Train, CLIPS);
        let mask = masks
            .iter_mut()
            .find(|mask| mask.motion_id.as_str() == "clip8");
        let mask = mask.expect("every second clip has one");
        (mask.start, mask.end) = (Some(50), Some(90));
        let masks = [mask.clone()];
        let target = motions[8].motion().expect("valid");
        let library = fixture::library_of(Split::Train, &motions, &masks, &[]);
        let stream = fixture::stream(library, config, 5);
        (stream.expect("a stream"), target)
    }

    #[test]
    fn a_mask_with_a_range_edits_the_frames_of_its_range_alone() {
        for fixed_pairs in [false, true] {
            let (stream, target) = ranged(ComposeConfig {
                fixed_pairs,
                ..ComposeConfig::default()
            });
            let mut lengths = std::collections::BTreeSet::new();
            for epoch in 0..40 {
                let triplet = stream.clip(epoch, 0).expect("in memory");
                let (frames, start) = (triplet.original.len(), triplet.target_start);
                lengths.insert(frames);
                let edited = triplet.edited_frames.clone();
                // If the partner is shorter than the range, all its frames are edited.
                assert_eq!(edited.len(), frames.min(40));
                assert!(start + edited.start >= 50 && start + edited.end <= 90);
                let row = triplet.to_row();
                let bounds = (row.edit_start, row.edit_end);
                let is_part = frames > edited.len();
                assert_eq!(bounds.0.is_some() && bounds.1.is_some(), is_part);
                let taken = target.crop(start..start + frames).expect("inside");
                let pose = |motion: &Motion, frame: usize| {
                    let joints = 0..22;
                    joints
                        .map(|joint| motion.axis_angle(frame, joint))
                        .collect::<Vec<_>>()
                };
                for frame in (0..frames).filter(|frame| !edited.contains(frame)) {
                    assert_eq!(pose(&triplet.edited, frame), pose(&triplet.original, frame));
                    let transl = [&triplet.edited, &triplet.original].map(|m| m.transl()[frame]);
                    assert_eq!(transl[0], transl[1]);
                }
                // The middle of the range is the target's.
                let middle = edited.start + edited.len() / 2;
                for joint in triplet.mask.hard().iter().map(|joint| joint.index()) {
                    let [found, wanted] = [&triplet.edited, &taken].map(|motion| {
                        kinematics::rotation::from_axis_angle(
                            glam::Vec3::from_array(motion.axis_angle(middle, joint)).as_dvec3(),
                        )
                    });
                    let apart = kinematics::rotation::angle_between(found, wanted);
                    assert!(joint == 0 || apart < 1e-5, "joint {joint}: {apart}");
                }
            }
            assert!(fixed_pairs || lengths.iter().any(|frames| *frames > 40));
        }
    }

    #[test]
    fn windows_of_a_mask_with_a_range_lie_in_it() {
        // The shortest range is as long as a window.
        assert_eq!(
            datasets_spec::record::MaskRow::SHORTEST as usize,
            fixture::SPAN
        );
        for fixed_pairs in [false, true] {
            let (stream, _) = ranged(ComposeConfig {
                fixed_pairs,
                ..ComposeConfig::default()
            });
            // 40 frames hold one window of 31.
            assert_eq!(stream.epoch_len(), 1);
            let mut batch = crate::WindowBatch::default();
            for epoch in 0..20 {
                stream.fill(epoch, 0, 1, &mut batch).expect("in memory");
                // The window starts at one of the first ten frames of the range.
                assert!(
                    (0.0..0.25).contains(&batch.progress[0]),
                    "{}",
                    batch.progress[0]
                );
            }
        }
    }

    #[test]
    fn ranges_that_are_none_are_refused_by_name() {
        let (motions, masks) = fixture::rows(Split::Train, CLIPS);
        let with = |start, end| {
            let mut mask = masks[4].clone();
            (mask.start, mask.end) = (start, end);
            let library = Library::new(Split::Train, &motions, &[mask], &[]);
            library.map(|_| ()).map_err(|error| match error {
                Error::Mask { source, .. } => source.to_string(),
                other => panic!("{other}"),
            })
        };
        assert_eq!(with(Some(0), Some(31)), Ok(()));
        assert_eq!(with(Some(104), Some(135)), Ok(()));
        for (start, end, reason) in [
            (Some(0), Some(30), "spans 31"),
            (Some(0), Some(136), "135 frames"),
            (Some(-1), None, "-1 to ?"),
            (Some(-1), Some(40), "-1 to 40"),
            (Some(60), Some(20), "60 to 20"),
            (Some(60), None, "60 to ?"),
            (None, Some(60), "? to 60"),
        ] {
            let refused = with(start, end).expect_err("no range");
            assert!(refused.contains(reason), "{refused}");
        }
    }

    #[test]
    fn the_two_sides_differ_in_the_mask_alone() {
        let stream = stream(ComposeConfig::default());
        for item in 0..stream.epoch_len() {
            let triplet = stream.triplet(0, item).expect("in memory");
            let (before, after) = (&triplet.original, &triplet.edited);
            assert_eq!((before.len(), before.fps()), (after.len(), after.fps()));
            for joint in 0..22 {
                if !triplet.mask.hard().contains(joint) && !triplet.mask.soft().contains(joint) {
                    for frame in 0..before.len() {
                        assert_eq!(
                            before.axis_angle(frame, joint),
                            after.axis_angle(frame, joint)
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn a_row_gives_the_motions_back() {
        let triplet = stream(ComposeConfig::default()).triplet(0, 0);
        let triplet = triplet.expect("in memory");
        let row = triplet.to_row();
        assert_eq!(row.original().expect("valid"), triplet.original);
        assert_eq!(row.edited().expect("valid"), triplet.edited);
        assert_eq!(f64::from(row.alpha), triplet.alpha);
    }

    #[test]
    fn no_row_of_another_split_gets_in() {
        let (motions, masks) = fixture::rows(Split::Train, 4);
        let (test_motions, test_masks) = fixture::rows(Split::Test, 4);
        assert!(matches!(
            Library::new(Split::Test, &motions, &[], &[]),
            Err(Error::OtherSplit {
                table: "motions",
                expected: Split::Test,
                ..
            })
        ));
        assert!(matches!(
            Library::new(Split::Train, &motions, &test_masks, &[]),
            Err(Error::OtherSplit { table: "masks", .. })
        ));
        let mixed = [motions.clone(), test_motions.clone()].concat();
        assert!(Library::new(Split::Train, &mixed, &masks, &[]).is_err());
        let library = Library::new(Split::Test, &test_motions, &test_masks, &[]);
        assert!(matches!(
            library
                .expect("one split")
                .fit_normalizer(&ComposeConfig::default()),
            Err(Error::NotTrain(Split::Test))
        ));
    }

    #[test]
    fn broken_rows_are_named() {
        let (motions, masks) = fixture::rows(Split::Train, 2);
        let with_motion = |change: &dyn Fn(&mut datasets_spec::record::MotionRow)| {
            let mut motions = motions.clone();
            change(&mut motions[1]);
            Library::new(Split::Train, &motions, &masks, &[]).expect_err("broken")
        };
        let with_mask = |change: &dyn Fn(&mut datasets_spec::record::MaskRow)| {
            let mut masks = masks.clone();
            change(&mut masks[0]);
            Library::new(Split::Train, &motions, &masks, &[]).expect_err("broken")
        };
        let id = |text: &str| MotionId::parse(text).expect("valid");
        assert!(matches!(
            with_motion(&|row| row.skeleton = "male".to_owned()),
            Error::OtherSkeleton { .. }
        ));
        assert!(matches!(
            with_motion(&|row| row.fps = 30.0),
            Error::OtherRate { .. }
        ));
        assert!(matches!(
            with_motion(&|row| row.id = id("clip0")),
            Error::Duplicate { .. }
        ));
        assert!(matches!(
            with_motion(&|row| row.transl[3][1] = f32::NAN),
            Error::Motion { motion, .. } if motion == id("clip1")
        ));
        assert!(matches!(
            with_mask(&|row| row.motion_id = id("other")),
            Error::UnknownMotion { .. }
        ));
        assert!(matches!(
            with_mask(&|row| row.text = " ".to_owned()),
            Error::EmptyText { .. }
        ));
        assert!(matches!(
            with_mask(&|row| row.hard_joints = vec!["tail".to_owned()]),
            Error::Mask { .. }
        ));
        assert!(matches!(
            with_mask(&|row| {
                row.hard_joints.clear();
                row.soft_joints.clear();
            }),
            Error::EmptyMask(_)
        ));
    }
}
