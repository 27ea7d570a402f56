//! Whole-clip triplets: recorded items of a stream, and the fixed items systems are evaluated on.

use datasets_spec::record::TripletRow;
use datasets_spec::{BlendMask, Fps, Motion, MotionId, Seed, Split};
use rand::RngExt;

use super::library::Clip;
use super::stream::Pairing;
use super::{ComposeConfig, Error, Library, Stream, blend_motion};

/// Kind of the edits composed here.
const SEMANTIC: &str = "semantic";

/// Windows an evaluation item should cover: the paper edits clips of several segments, and the
/// released demo uses at least three.
const PREFERRED_WINDOWS: usize = 3;

/// An original motion, an instruction, and the edited motion it leads to. Both motions have the
/// same length and rate; outside the mask their local rotations are the same to the last bit.
#[derive(Clone, Debug, PartialEq)]
pub struct Triplet {
    /// Its place in the stream, or in the list of evaluation items.
    pub id: String,
    /// The split of all motions in it.
    pub split: Split,
    /// What the edit changes: `semantic`.
    pub kind: &'static str,
    /// What turns the original into the edited motion.
    pub instruction: String,
    /// The motion the original was cut from.
    pub source_id: MotionId,
    /// The motion the edit takes from.
    pub target_id: MotionId,
    /// Motions blended under both sides; none for semantic edits.
    pub donor_ids: Vec<MotionId>,
    /// First stored frame taken of the source.
    pub source_start: usize,
    /// First stored frame taken of the target.
    pub target_start: usize,
    /// What the edit takes.
    pub mask: BlendMask,
    /// Weight of the target on soft joints.
    pub alpha: f64,
    /// Seed of the stream.
    pub seed: Seed,
    /// Epoch of the stream; 0 for evaluation items.
    pub epoch: u64,
    /// [`ComposeConfig::recipe_hash`] of the settings it was composed with.
    pub recipe_hash: String,
    /// The motion before the edit.
    pub original: Motion,
    /// The motion after it.
    pub edited: Motion,
}

impl Stream {
    /// Composes the whole-clip triplet of an item: the partner, the mask and the alpha that
    /// [`Stream::fill`] uses for the same item, on all frames the two clips share.
    ///
    /// # Panics
    /// If the item is not in the epoch.
    pub fn triplet(&self, epoch: u64, item: u64) -> Triplet {
        let place = Place {
            id: self.triplet_id(epoch, item),
            seed: self.seed,
            epoch,
            recipe_hash: self.recipe_hash.clone(),
        };
        self.library.compose(place, &self.pairing(epoch, item))
    }

    /// Composes a recorded triplet again, bit for bit, from its id alone.
    ///
    /// # Errors
    /// The id is not one of this stream's.
    pub fn explain(&self, id: &str) -> Result<Triplet, Error> {
        let unknown = || Error::TripletId {
            id: id.to_owned(),
            expected: format!(
                "{}-{SEMANTIC}-EPOCH-ITEM with ITEM below {}",
                self.library.split(),
                self.epoch_len()
            ),
        };
        let mut parts = id.split('-').rev();
        let mut number = || parts.next()?.parse::<u64>().ok();
        let (item, epoch) = number().zip(number()).ok_or_else(unknown)?;
        // Writing the numbers again refuses other splits, other kinds and leading zeros.
        if item >= self.epoch_len() || self.triplet_id(epoch, item) != id {
            return Err(unknown());
        }
        Ok(self.triplet(epoch, item))
    }

    fn triplet_id(&self, epoch: u64, item: u64) -> String {
        format!("{}-{SEMANTIC}-{epoch}-{item}", self.library.split())
    }
}

/// Composes a list of items to evaluate systems on, the same for the same arguments.
///
/// Every usable annotation is a target before any is used again, in an order drawn from the seed.
/// Partners are clips of other actions, where actions are known, and long enough for three windows,
/// where such clips exist.
///
/// # Errors
/// A setting is out of range, no annotated motion is as long as a window, or one has no partner.
pub fn edit_items(
    library: &Library,
    config: &ComposeConfig,
    seed: Seed,
    count: usize,
) -> Result<Vec<Triplet>, Error> {
    config.check()?;
    let stride = config.stride(library.fps())?;
    let span = config.span(stride);
    let frames_of = |clip: usize| library.clips[clip].motion.len();
    let base: Vec<usize> = (0..library.clips.len())
        .filter(|&c| frames_of(c) >= span)
        .collect();
    let mut targets: Vec<(u64, usize)> = library
        .annotations
        .iter()
        .enumerate()
        .filter(|(_, annotation)| frames_of(annotation.clip) >= span)
        .map(|(index, annotation)| (seed.draw_u64(&["evaluation order", &annotation.id]), index))
        .collect();
    targets.sort_unstable();
    if targets.is_empty() {
        return Err(Error::NoItem {
            split: library.split(),
            frames: span,
        });
    }
    let recipe_hash = config.recipe_hash();
    let preferred = span + (PREFERRED_WINDOWS - 1) * config.advance(stride);
    (0..count)
        .map(|item| {
            let annotation = targets[item % targets.len()].1;
            let round = (item / targets.len()).to_string();
            let id = &library.annotations[annotation].id;
            let mut rng = seed.rng(&["evaluation item", id, &round]);
            let partners = library.partners(&base, annotation, preferred)?;
            let source = partners[rng.random_range(0..partners.len())];
            let place = Place {
                id: format!("{}-{SEMANTIC}-{item:05}", library.split()),
                seed,
                epoch: 0,
                recipe_hash: recipe_hash.clone(),
            };
            let pairing = library.paired(source, annotation, config, &mut rng);
            Ok(library.compose(place, &pairing))
        })
        .collect()
}

/// What a triplet is called and where it comes from.
struct Place {
    id: String,
    seed: Seed,
    epoch: u64,
    recipe_hash: String,
}

impl Library {
    /// The clips of the base that suit an annotation best: of another action and as long as
    /// `preferred` or the target, else of another action, else any other.
    fn partners(
        &self,
        base: &[usize],
        annotation: usize,
        preferred: usize,
    ) -> Result<Vec<usize>, Error> {
        let target = self.annotations[annotation].clip;
        let target_clip = &self.clips[target];
        let other: Vec<usize> = base
            .iter()
            .copied()
            .filter(|&clip| self.may_pair(clip, target))
            .collect();
        let same_action = |clip: &Clip| clip.action.is_some() && clip.action == target_clip.action;
        let other_action: Vec<usize> = other
            .iter()
            .copied()
            .filter(|&clip| !same_action(&self.clips[clip]))
            .collect();
        let needed = preferred.min(target_clip.motion.len());
        let long: Vec<usize> = other_action
            .iter()
            .copied()
            .filter(|&clip| self.clips[clip].motion.len() >= needed)
            .collect();
        [long, other_action, other]
            .into_iter()
            .find(|partners| !partners.is_empty())
            .ok_or_else(|| Error::NoPartner {
                motion: target_clip.id.clone(),
            })
    }

    fn compose(&self, place: Place, pairing: &Pairing) -> Triplet {
        let annotation = &self.annotations[pairing.annotation];
        let (source, target) = (&self.clips[pairing.source], &self.clips[annotation.clip]);
        let crop = pairing.crop;
        let cut = |clip: &Clip, start: usize| {
            clip.motion
                .crop(start..start + crop.num_frames)
                .expect("a crop is drawn inside both motions")
        };
        let original = cut(source, crop.source_start);
        let taken = cut(target, crop.target_start);
        let edited = blend_motion(&original, &taken, annotation.mask, pairing.alpha)
            .expect("crops of one library have one length and rate");
        Triplet {
            id: place.id,
            split: self.split(),
            kind: SEMANTIC,
            instruction: annotation.instruction.clone(),
            source_id: source.id.clone(),
            target_id: target.id.clone(),
            donor_ids: Vec::new(),
            source_start: crop.source_start,
            target_start: crop.target_start,
            mask: annotation.mask,
            alpha: pairing.alpha,
            seed: place.seed,
            epoch: place.epoch,
            recipe_hash: place.recipe_hash,
            original,
            edited,
        }
    }
}

impl Triplet {
    /// The rate of both motions.
    pub fn fps(&self) -> Fps {
        self.original.fps()
    }

    /// The row of table `triplets`.
    ///
    /// # Panics
    /// If the motions have more frames than the table can count, 2 billion.
    pub fn to_row(&self) -> TripletRow {
        let frames = |count: usize| i32::try_from(count).expect("fewer than 2 billion frames");
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
            hard_joints: self.mask.hard().names(),
            soft_joints: self.mask.soft().names(),
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

    use datasets_spec::Skeleton;

    use super::*;
    use crate::compose::fixture;

    const CLIPS: usize = 9;

    fn stream(config: ComposeConfig) -> Stream {
        let library = fixture::library(Split::Train, CLIPS);
        let normalizer = library.fit_normalizer(&config).expect("long enough");
        Stream::new(Arc::new(library), config, Seed(5), &normalizer).expect("a stream")
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
                let triplet = recorded.triplet(2, item);
                assert_eq!(later.explain(&triplet.id).expect("its own id"), triplet);
                assert_eq!(
                    later.explain(&triplet.id).expect("its own id").to_row(),
                    triplet.to_row()
                );
            }
        }
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

    #[test]
    fn the_two_sides_differ_in_the_mask_alone() {
        let stream = stream(ComposeConfig::default());
        for item in 0..stream.epoch_len() {
            let triplet = stream.triplet(0, item);
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
        let row = triplet.to_row();
        assert_eq!(row.original().expect("valid"), triplet.original);
        assert_eq!(row.edited().expect("valid"), triplet.edited);
        assert_eq!(f64::from(row.alpha), triplet.alpha);
    }

    #[test]
    fn evaluation_items_cover_the_annotations_before_repeating() {
        let library = fixture::library(Split::Test, CLIPS);
        let config = ComposeConfig::default();
        let items = edit_items(&library, &config, Seed(3), 13).expect("enough clips");
        assert_eq!(
            items,
            edit_items(&library, &config, Seed(3), 13).expect("enough clips")
        );
        let num_masks = library.num_masks();
        let mut targets: Vec<&MotionId> = items.iter().map(|item| &item.target_id).collect();
        targets[..num_masks].sort_unstable();
        targets[..num_masks]
            .windows(2)
            .for_each(|pair| assert_ne!(pair[0], pair[1]));
        for item in &items {
            assert_eq!(item.split, Split::Test);
            assert_ne!(item.source_id, item.target_id);
            // Annotated clips wave, the others kick.
            let source = library.clips.iter().find(|clip| clip.id == item.source_id);
            assert_eq!(
                source.expect("of the library").action.as_deref(),
                Some("kick")
            );
        }
        let ids: std::collections::BTreeSet<&str> =
            items.iter().map(|item| item.id.as_str()).collect();
        assert_eq!(ids.len(), items.len());
    }

    #[test]
    fn no_row_of_another_split_gets_in() {
        let skeleton = Skeleton::smplx_neutral();
        let (motions, masks) = fixture::rows(Split::Train, 4);
        let (test_motions, test_masks) = fixture::rows(Split::Test, 4);
        assert!(matches!(
            Library::new(Split::Test, &motions, &[], &skeleton),
            Err(Error::OtherSplit {
                table: "motions",
                expected: Split::Test,
                ..
            })
        ));
        assert!(matches!(
            Library::new(Split::Train, &motions, &test_masks, &skeleton),
            Err(Error::OtherSplit { table: "masks", .. })
        ));
        let mixed = [motions.clone(), test_motions.clone()].concat();
        assert!(Library::new(Split::Train, &mixed, &masks, &skeleton).is_err());
        let library = Library::new(Split::Test, &test_motions, &test_masks, &skeleton);
        assert!(matches!(
            library
                .expect("one split")
                .fit_normalizer(&ComposeConfig::default()),
            Err(Error::NotTrain { split: Split::Test })
        ));
    }

    #[test]
    fn broken_rows_are_named() {
        let skeleton = Skeleton::smplx_neutral();
        let (motions, masks) = fixture::rows(Split::Train, 2);
        let with_motion = |change: &dyn Fn(&mut datasets_spec::record::MotionRow)| {
            let mut motions = motions.clone();
            change(&mut motions[1]);
            Library::new(Split::Train, &motions, &masks, &skeleton).expect_err("broken")
        };
        let with_mask = |change: &dyn Fn(&mut datasets_spec::record::MaskRow)| {
            let mut masks = masks.clone();
            change(&mut masks[0]);
            Library::new(Split::Train, &motions, &masks, &skeleton).expect_err("broken")
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
            Error::EmptyMask { .. }
        ));
    }
}
