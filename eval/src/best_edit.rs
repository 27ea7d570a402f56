//! Chooses the edit that a page shows first.

use std::collections::BTreeMap;

use datasets_spec::record::{EditRow, ItemRow};
use datasets_spec::{Motion, Skeleton, quantile};
use kinematics::KeypointFrame;
use kinematics::skeleton::NUM_KEYPOINTS;
use rayon::prelude::*;

use crate::Error;
use crate::answered::{Answered, ITEMS_AT_ONCE};
use crate::metric::position_error::{held, mean_position_error};
use crate::rows::EditFacts;

/// An edit and how it was chosen.
#[derive(Clone, Debug)]
pub struct BestEdit {
    /// The item.
    pub item: ItemRow,
    /// The item's edit.
    pub edit: EditRow,
    /// How much closer to the target the edit is than the source. `None` if no item has a target at the edit's frame
    /// rate; then the item with the first id is shown. A page must not call the edit the best if it is not closer to
    /// its target than its source is ([`Gain::is_better`]).
    pub gain: Option<Gain>,
}

/// Errors of the best edit and of its source against the target, and the median gain of all edits. An error is the mean
/// distance to the target's 28 keypoints over the frames that both motions have, with every pelvis moved over the same
/// point of the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gain {
    /// Error of the source in metres.
    pub source_m: f64,
    /// Error of the edit in metres.
    pub edit_m: f64,
    /// Median over the items of the error's reduction, in metres; negative if most edits are farther from their targets
    /// than the sources are.
    pub median_m: f64,
    /// Number of measured items.
    pub num_items: usize,
}

impl Gain {
    /// Whether the edit is closer to its target than its source is.
    pub fn is_better(&self) -> bool {
        self.edit_m < self.source_m
    }
}

/// The edit that reduces the distance from source to target most, among the edits of the system listed first. Ties go
/// to the first item by id. If an item has several takes, the one with the lowest seed counts. `None` without edits.
///
/// Distances ignore the pelvis's position over the ground, because a page shows the motions with a camera that follows
/// the pelvis.
///
/// # Errors
/// A file cannot be read, an item was changed after it was drawn, or a row does not hold a motion.
pub fn best_edit(answered: &Answered) -> Result<Option<BestEdit>, Error> {
    let candidates = first_takes(answered);
    let errors = all_errors(answered, &candidates)?;
    let mut gains = Vec::new();
    let mut best: Option<(usize, [f64; 2])> = None;
    let gain_of = |[source, edit]: [f64; 2]| source - edit;
    for (index, errors) in errors.into_iter().enumerate() {
        let Some(errors) = errors else { continue };
        gains.push(gain_of(errors));
        if best.is_none_or(|(_, best)| gain_of(errors) > gain_of(best)) {
            best = Some((index, errors));
        }
    }
    let gain = best.map(|(_, [source_m, edit_m])| Gain {
        source_m,
        edit_m,
        median_m: quantile::median(&mut gains).expect("the best is among them"),
        num_items: gains.len(),
    });
    let Some(&[item, edit]) = candidates.get(best.map_or(0, |(index, _)| index)) else {
        return Ok(None);
    };
    let items = answered.items_at(&[item])?.into_iter();
    let edits = answered.edits.rows(&[edit])?.into_iter();
    let chosen = items.zip(edits).next();
    Ok(chosen.map(|(item, edit)| BestEdit { item, edit, gain }))
}

/// How many metres closer each edit is to its target than its source is, as [`best_edit`] compares them: one value for
/// each measurable item that the system listed first has edited, sorted by id. Items are given by their positions.
///
/// # Errors
/// As [`best_edit`].
pub fn gains(answered: &Answered) -> Result<Vec<(usize, f64)>, Error> {
    let candidates = first_takes(answered);
    let errors = all_errors(answered, &candidates)?;
    let measured = std::iter::zip(candidates, errors);
    Ok(measured
        .filter_map(|([item, _], errors)| errors.map(|[source, edit]| (item, source - edit)))
        .collect())
}

/// The [`errors`] of each candidate; motions are read in chunks.
fn all_errors(
    answered: &Answered,
    candidates: &[[usize; 2]],
) -> Result<Vec<Option<[f64; 2]>>, Error> {
    let mut all = Vec::with_capacity(candidates.len());
    for candidates in candidates.chunks(ITEMS_AT_ONCE) {
        let [items, edits] =
            [0, 1].map(|side| -> Vec<usize> { candidates.iter().map(|pair| pair[side]).collect() });
        let items = answered.items_at(&items)?;
        let edits = answered.edits.rows(&edits)?;
        let errors = items
            .into_par_iter()
            .zip(edits)
            .map(|(item, edit)| errors(&item, &edit.motion()?, &answered.skeleton))
            .collect::<Result<Vec<_>, Error>>()?;
        all.extend(errors);
    }
    Ok(all)
}

/// Positions of the items that the system listed first has edited, sorted by id, each with the position of its take
/// with the lowest seed.
fn first_takes(answered: &Answered) -> Vec<[usize; 2]> {
    let edits = answered.edits.facts();
    let Some(first) = edits.first() else {
        return Vec::new();
    };
    let mut takes: BTreeMap<&str, (usize, &EditFacts)> = BTreeMap::new();
    for (position, row) in edits.iter().enumerate() {
        if row.system == first.system {
            let take = takes.entry(&row.id).or_insert((position, row));
            if row.seed < take.1.seed {
                *take = (position, row);
            }
        }
    }
    let items = answered.items.facts().iter().enumerate();
    let items: BTreeMap<&str, usize> = items.map(|(at, item)| (item.id.as_str(), at)).collect();
    takes
        .into_iter()
        .filter_map(|(id, (edit, _))| Some([*items.get(id)?, edit]))
        .collect()
}

/// Distances in metres of the source and of the edit from the target; `None` without a target of the same
/// frame rate.
fn errors(item: &ItemRow, edit: &Motion, skeleton: &Skeleton) -> Result<Option<[f64; 2]>, Error> {
    if item.target_frames == 0 {
        return Ok(None);
    }
    let (source, target) = (item.source()?, item.target()?);
    if edit.fps() != target.fps() {
        return Ok(None);
    }
    let target = followed(&skeleton.motion_keypoints(&target).points);
    Ok(Some([&source, edit].map(|motion| {
        let points = held(
            followed(&skeleton.motion_keypoints(motion).points),
            source.len(),
        );
        mean_position_error(&points, &target, NUM_KEYPOINTS)
    })))
}

/// Keypoints `[L, 28]` with every frame moved so that the pelvis is over the origin; its height is kept.
fn followed(points: &[KeypointFrame]) -> Vec<KeypointFrame> {
    let over_origin = |frame: &KeypointFrame| {
        let mut pelvis = frame[0];
        pelvis.y = 0.0;
        frame.map(|point| point - pelvis)
    };
    points.iter().map(over_origin).collect()
}

#[cfg(test)]
mod tests {
    use datasets_spec::{Fps, MotionId, Pose, Split};
    use glam::DVec3;

    use super::*;

    /// A body that stands `height` metres above its rest pose, and drifts by `drift` metres a frame.
    fn lifted(height: f64, drift: f64) -> Motion {
        let pose = |frame: i32| Pose {
            transl: DVec3::new(drift * f64::from(frame), height, 0.0),
            ..Pose::REST
        };
        let poses: Vec<Pose> = (0..4).map(pose).collect();
        Motion::from_poses(Fps::STORE, &poses).expect("valid")
    }

    /// An item whose source stands on the ground and whose target is `target` metres above it.
    fn item(name: &str, target: Option<f64>) -> ItemRow {
        let id = MotionId::parse("somewhere/walk").expect("an id");
        let mut item = ItemRow::blank(&id, Split::Test);
        let target = target.map(|height| lifted(height, 0.0));
        item.set_motions(&lifted(0.0, 0.0), target.as_ref(), None);
        item.instruction = name.to_owned();
        item.id = item.content_id();
        item
    }

    fn edit(item: &ItemRow, system: &str, seed: u64, motion: &Motion) -> EditRow {
        EditRow {
            system: system.to_owned(),
            seed,
            ..EditRow::answering(item, motion)
        }
    }

    fn answered(items: &[ItemRow], edits: Vec<EditRow>) -> Answered {
        Answered::of_rows(items.to_vec(), edits, Skeleton::smplx_neutral())
    }

    /// Three items whose targets lie 1, 2 and 4 m above their sources. The item listed first does not have the first
    /// id.
    fn items() -> [ItemRow; 3] {
        let mut items =
            [("c", 4.0), ("a", 1.0), ("b", 2.0)].map(|(name, target)| item(name, Some(target)));
        if first_id(&items) == items[0].id {
            items.reverse();
        }
        items
    }

    fn first_id(items: &[ItemRow]) -> String {
        let ids = items.iter().map(|item| item.id.clone());
        ids.min().expect("items")
    }

    #[test]
    fn the_best_edit_takes_most_off_the_distance_to_the_target() {
        let items = items();
        // The errors fall from 4 to 3 m, from 1 to 0 and from 2 to 0.5.
        let edits = |drift| {
            let edited = |item: &ItemRow| {
                let height = if item.instruction == "b" { 1.5 } else { 1.0 };
                edit(item, "one", 0, &lifted(height, drift))
            };
            items.iter().map(edited).collect::<Vec<_>>()
        };
        for drift in [0.0, 0.5] {
            let mut edits = edits(drift);
            // Edits of another system and takes with higher seeds do not count, even perfect ones.
            let highest = items.iter().find(|item| item.instruction == "c");
            for (system, seed) in [("other", 0), ("one", 1)] {
                let highest = highest.expect("one of the items");
                edits.push(edit(highest, system, seed, &lifted(4.0, 0.0)));
            }
            let answered = answered(&items, edits);
            let best = best_edit(&answered).expect("motions").expect("edits");
            assert_eq!((best.item.instruction.as_str(), best.edit.seed), ("b", 0));
            let words = best.in_words();
            assert!(words.starts_with("The best case"), "{words}");
            let gain = best.gain.expect("targets");
            assert_eq!(gain.num_items, 3);
            // Motions are stored in single precision.
            let lengths = [gain.source_m, gain.edit_m, gain.median_m];
            for (found, expected) in lengths.iter().zip([2.0, 0.5, 1.0]) {
                assert!((found - expected).abs() < 1e-5, "{gain:?}");
            }
        }
    }

    #[test]
    fn of_equal_edits_the_first_item_by_id_is_chosen() {
        let items = items();
        let still = |item| edit(item, "one", 0, &lifted(0.0, 0.0));
        let answered = answered(&items, items.iter().map(still).collect());
        let best = best_edit(&answered).expect("motions").expect("edits");
        assert_eq!(best.item.id, first_id(&items));
        assert_eq!(best.gain.expect("targets").median_m, 0.0);
        let words = best.in_words();
        assert!(words.starts_with("No best case"), "{words}");
    }

    #[test]
    fn without_targets_nothing_is_measured_and_without_edits_nothing_is_chosen() {
        let items = [item("b", None), item("a", None)];
        let edited = |item| edit(item, "one", 0, &lifted(1.0, 0.0));
        let with_edits = answered(&items, items.iter().map(edited).collect());
        let best = best_edit(&with_edits).expect("motions").expect("edits");
        assert_eq!((best.item.id, best.gain), (first_id(&items), None));
        let without = answered(&items, Vec::new());
        assert!(best_edit(&without).expect("no motions").is_none());
    }
}
