//! Whole-clip triplets: recorded items of a stream.

use std::ops::Range;

use datasets_spec::record::TripletRow;
use datasets_spec::{BlendMask, Fps, JointSet, Motion, MotionId, Seed, Split};

use super::library::{Pairing, Subject};
use super::{Alignment, ComposeConfig, Error, Library, Stream, blend_motion};
use crate::during::{keep_outside, leaves_frames};

/// An original motion, an instruction, and the edited motion it leads to. Both motions have the same length and rate.
/// Outside the mask their local rotations are equal, except in a pair without a donor, which has no mask.
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
    /// The donor under both motions of a pair; empty for semantic edits and pairs without a donor.
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
        let id = self.triplet_id(epoch, item);
        self.composed(id, epoch, self.pairing(epoch, item))
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
        let drawn = self.clip_pairing(epoch, number);
        let kind = self.library.edit(drawn.0.subject).kind.as_str();
        let id = format!("{}-{kind}-clip-{epoch}-{number}", self.library.split());
        self.composed(id, epoch, drawn)
    }

    fn composed(
        &self,
        id: String,
        epoch: u64,
        (pairing, instruction): (Pairing, &str),
    ) -> Result<Triplet, Error> {
        let place = Place {
            id,
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
        let unknown = || {
            Error::Refused(format!(
                "{id:?} is no triplet of this stream, whose ids read {}-KIND-EPOCH-ITEM with ITEM below {}",
                self.library.split(),
                self.epoch_len()
            ))
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
        // A pair without a donor is not blended.
        if triplet.mask.is_empty() {
            return Ok(triplet.edited.clone());
        }
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
            return Err(Error::Refused(
                "mirrored_ratio mirrors training windows, not whole clips (recorded triplets, items, TMED); leave it \
                 out of their settings"
                    .to_owned(),
            ));
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
        let target = self.edit(pairing.subject).target;
        let (edited_frames, alignment) = match pairing.subject {
            Subject::Annotation(_) => (self.edited_of(pairing), Alignment::None),
            Subject::Pair(_) => (0..donor.num_frames, config.alignment),
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
        Ok(Triplet {
            id: place.id,
            split: self.split(),
            kind: self.edit(pairing.subject).kind.as_str(),
            instruction: place.instruction,
            source_id,
            target_id: id_of(target),
            donor_ids: donors,
            source_start: starts.0,
            target_start: starts.1,
            donor_start: donor.source_start,
            alignment: alignment.as_str(),
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

    /// First edited frame and one past the last, as in the tables; both `None` if all frames may change.
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

    use datasets_spec::record::{MaskRow, MotionRow, PairRow};
    use proptest::prelude::*;

    use super::*;
    use crate::{EditKind, fixture};

    const CLIPS: usize = 9;

    fn stream(change: impl FnOnce(&mut ComposeConfig)) -> Stream {
        let library = fixture::library(Split::Train, CLIPS);
        fixture::stream(library, fixture::config(change), 5).expect("a stream")
    }

    fn id(text: &str) -> MotionId {
        MotionId::parse(text).expect("valid")
    }

    /// The error that the rows of a library cause.
    fn refused(library: Result<Library, Error>) -> String {
        library.expect_err("broken").to_string()
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
            let stream = stream(|config| config.fixed_pairs = fixed_pairs);
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
            let config = fixture::config(|config| {
                config.kinds = vec![EditKind::Style];
                config.fixed_pairs = fixed_pairs;
            });
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
        let library = |change: fn(&mut PairRow)| {
            let mut pair = fixture::pair_row("style", Split::Train, 1, 2);
            change(&mut pair);
            Library::new(Split::Train, &motions, &[], &[pair])
        };
        assert!(library(|_| ()).is_ok());
        type Change = fn(&mut PairRow);
        let changes: [(Change, &str); 4] = [
            (|pair| pair.split = Split::Test, "is of split test"),
            (|pair| pair.target_id = id("clip-of-test"), "is not in the"),
            (|pair| pair.style = None, "has no text"),
            (|pair| pair.kind = "regen".to_owned(), "of kind \"regen\""),
        ];
        for (change, expected) in changes {
            let error = refused(library(change));
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn ids_of_other_streams_are_refused() {
        let stream = stream(|_| ());
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
            let error = stream.explain(id).expect_err(id).to_string();
            let expected = format!("{id:?} is no triplet of this stream");
            assert!(error.starts_with(&expected), "{error}");
        }
    }

    /// The stream of one annotated clip of 135 frames whose mask holds for frames 50 to 90.
    fn ranged(fixed_pairs: bool) -> (Stream, Motion) {
        let (motions, mut masks) = fixture::rows(Split::Train, CLIPS);
        masks.retain(|mask| mask.motion_id.as_str() == "clip8");
        (masks[0].start, masks[0].end) = (Some(50), Some(90));
        let target = motions[8].motion().expect("valid");
        let library = fixture::library_of(Split::Train, &motions, &masks, &[]);
        let config = fixture::config(|config| config.fixed_pairs = fixed_pairs);
        let stream = fixture::stream(library, config, 5);
        (stream.expect("a stream"), target)
    }

    #[test]
    fn a_mask_with_a_range_edits_the_frames_of_its_range_alone() {
        for fixed_pairs in [false, true] {
            let (stream, target) = ranged(fixed_pairs);
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
                let (edit, original) = (&triplet.edited, &triplet.original);
                for frame in (0..frames).filter(|frame| !edited.contains(frame)) {
                    assert_eq!(edit.transl()[frame], original.transl()[frame]);
                    assert_eq!(edit.global_orient()[frame], original.global_orient()[frame]);
                    assert_eq!(edit.body_pose()[frame], original.body_pose()[frame]);
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
        assert_eq!(MaskRow::SHORTEST as usize, fixture::SPAN);
        for fixed_pairs in [false, true] {
            let (stream, _) = ranged(fixed_pairs);
            // 40 frames hold one window of 31.
            assert_eq!(stream.epoch_len(), 1);
            let mut batch = crate::WindowBatch::default();
            for epoch in 0..20 {
                stream.fill(epoch, 0, 1, &mut batch).expect("in memory");
                // The window starts at one of the first ten frames of the range.
                let progress = batch.progress[0];
                assert!((0.0..0.25).contains(&progress), "{progress}");
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
                Error::Row { source, .. } => source.to_string(),
                other => panic!("{other}"),
            })
        };
        assert_eq!(with(Some(0), Some(31)), Ok(()));
        // One that is shorter than a window is counted where windows are drawn.
        assert_eq!(with(Some(0), Some(30)), Ok(()));
        assert_eq!(with(Some(104), Some(135)), Ok(()));
        for (start, end, reason) in [
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
        let stream = stream(|_| ());
        for item in 0..stream.epoch_len() {
            let triplet = stream.triplet(0, item).expect("in memory");
            let (before, after) = (&triplet.original, &triplet.edited);
            assert_eq!((before.len(), before.fps()), (after.len(), after.fps()));
            let outside = |joint: &usize| {
                !triplet.mask.hard().contains(*joint) && !triplet.mask.soft().contains(*joint)
            };
            for joint in (0..22).filter(outside) {
                for frame in 0..before.len() {
                    let [a, b] = [before, after].map(|motion| motion.axis_angle(frame, joint));
                    assert_eq!(a, b);
                }
            }
        }
    }

    #[test]
    fn a_row_gives_the_motions_back() {
        let triplet = stream(|_| ()).triplet(0, 0).expect("in memory");
        let row = triplet.to_row();
        assert_eq!(row.original().expect("valid"), triplet.original);
        assert_eq!(row.edited().expect("valid"), triplet.edited);
        assert_eq!(f64::from(row.alpha), triplet.alpha);
    }

    #[test]
    fn no_row_of_another_split_gets_in() {
        let (motions, masks) = fixture::rows(Split::Train, 4);
        let (test_motions, test_masks) = fixture::rows(Split::Test, 4);
        let names = |library: Result<Library, Error>, table: &str, expected: &str| {
            let error = refused(library);
            assert!(error.contains(table) && error.contains(expected), "{error}");
        };
        let foreign = Library::new(Split::Test, &motions, &[], &[]);
        names(foreign, "motions row", "the library of split test;");
        let foreign = Library::new(Split::Train, &motions, &test_masks, &[]);
        names(foreign, "masks row", "the library of split train;");
        let mixed = [motions.clone(), test_motions.clone()].concat();
        assert!(Library::new(Split::Train, &mixed, &masks, &[]).is_err());
        let library = Library::new(Split::Test, &test_motions, &test_masks, &[]);
        let fitted = library.expect("one split");
        let fitted = fitted.fit_normalizer(&ComposeConfig::default());
        let error = fitted.expect_err("not train").to_string();
        assert!(error.ends_with("the library holds split test"), "{error}");
    }

    #[test]
    fn broken_rows_are_named() {
        let (motions, masks) = fixture::rows(Split::Train, 2);
        type Change = fn(&mut MotionRow, &mut MaskRow);
        let changes: [(Change, &str); 8] = [
            (|row, _| row.skeleton = "male".to_owned(), "drives skeleton"),
            (|row, _| row.fps = 30.0, "stored at 30 fps"),
            (|row, _| row.id = id("clip0"), "appears twice"),
            (|row, _| row.transl[3][1] = f32::NAN, "clip1 is not usable"),
            (|_, mask| mask.motion_id = id("other"), "to motion other"),
            (|_, mask| mask.text = " ".to_owned(), "has no text"),
            (|_, mask| mask.hard_joints = vec!["tail".into()], "mask \""),
            (
                |_, mask| {
                    mask.hard_joints.clear();
                    mask.soft_joints.clear();
                },
                "names no joint",
            ),
        ];
        for (change, expected) in changes {
            let (mut motions, mut masks) = (motions.clone(), masks.clone());
            change(&mut motions[1], &mut masks[0]);
            let library = Library::new(Split::Train, &motions, &masks, &[]);
            let error = refused(library);
            assert!(error.contains(expected), "{error}");
        }
    }
}
