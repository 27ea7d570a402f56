//! The edit that a page opens with, chosen by a rule.

use std::collections::BTreeMap;

use datasets_spec::record::{EditRow, ItemRow};
use datasets_spec::{Skeleton, quantile};
use kinematics::KeypointFrame;
use kinematics::skeleton::NUM_KEYPOINTS;
use rayon::prelude::*;

use crate::Error;
use crate::answers::Answered;
use crate::metric::position_error::mean_position_error;

/// An edit and how it was chosen.
#[derive(Clone, Copy, Debug)]
pub struct BestEdit<'a> {
    /// The item.
    pub item: &'a ItemRow,
    /// Its edit.
    pub edit: &'a EditRow,
    /// How far it got; `None` where no item has a target at the edit's frame rate, so that none could be
    /// measured, and the item is the first by its id. An edit that is not closer to its target than its source
    /// ([`Gain::is_better`]) is not to be called the best.
    pub gain: Option<Gain>,
}

/// How far the best edit got, and how far the others did. Errors are mean distances to the target's 28
/// keypoints over the frames that both motions have, with every pelvis moved over one point of the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gain {
    /// Error of the source in metres.
    pub source_m: f64,
    /// Error of the edit in metres.
    pub edit_m: f64,
    /// Median over the items of how much smaller the error of the edit is, in metres; negative where most
    /// edits are farther from their targets than the sources are.
    pub median_m: f64,
    /// Items that were measured.
    pub num_items: usize,
}

impl Gain {
    /// Whether the edit is closer to its target than its source is.
    pub fn is_better(&self) -> bool {
        self.edit_m < self.source_m
    }
}

/// The edit that takes most off the distance from its source to its target, among the edits of the system
/// listed first; of equal ones that of the first item by id. Of several takes of an item, the one with the
/// lowest seed counts. `None` without edits.
///
/// Distances are measured as by a camera that follows the pelvis, which is how a page shows the motions: a
/// body that is off by a constant way over the ground looks right there.
///
/// # Errors
/// A row does not hold a motion.
pub fn best_edit(answered: &Answered) -> Result<Option<BestEdit<'_>>, Error> {
    let candidates = first_takes(answered);
    let errors = all_errors(&candidates, &answered.skeleton)?;
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
    let chosen = candidates.get(best.map_or(0, |(index, _)| index));
    Ok(chosen.map(|&(item, edit)| BestEdit { item, edit, gain }))
}

/// How many metres closer each edit is to its target than its source is, as [`best_edit`] compares them: of every item that the
/// system listed first has edited and that can be measured, by id.
///
/// # Errors
/// A row does not hold a motion.
pub fn gains(answered: &Answered) -> Result<Vec<(&ItemRow, f64)>, Error> {
    let candidates = first_takes(answered);
    let errors = all_errors(&candidates, &answered.skeleton)?;
    let measured = std::iter::zip(candidates, errors);
    Ok(measured
        .filter_map(|((item, _), errors)| errors.map(|[source, edit]| (item, source - edit)))
        .collect())
}

fn all_errors(
    candidates: &[(&ItemRow, &EditRow)],
    skeleton: &Skeleton,
) -> Result<Vec<Option<[f64; 2]>>, Error> {
    candidates
        .par_iter()
        .map(|(item, edit)| errors(item, edit, skeleton))
        .collect()
}

/// The items that the system listed first has edited, by id, with their takes of the lowest seed.
fn first_takes(answered: &Answered) -> Vec<(&ItemRow, &EditRow)> {
    let Some(first) = answered.edits.first() else {
        return Vec::new();
    };
    let mut takes: BTreeMap<&str, &EditRow> = BTreeMap::new();
    for row in &answered.edits {
        if row.system == first.system {
            let take = takes.entry(&row.id).or_insert(row);
            if row.seed < take.seed {
                *take = row;
            }
        }
    }
    let items: BTreeMap<&str, &ItemRow> = answered
        .items
        .iter()
        .map(|item| (item.id.as_str(), item))
        .collect();
    takes
        .into_iter()
        .filter_map(|(id, row)| Some((*items.get(id)?, row)))
        .collect()
}

/// Distances in metres of the source and of the edit from the target; `None` without a target of the same
/// frame rate.
fn errors(item: &ItemRow, edit: &EditRow, skeleton: &Skeleton) -> Result<Option<[f64; 2]>, Error> {
    if item.target_frames == 0 {
        return Ok(None);
    }
    let [source, edit, target] = [item.source()?, edit.motion()?, item.target()?];
    if edit.fps() != target.fps() {
        return Ok(None);
    }
    let target = followed(&skeleton.motion_keypoints(&target).points);
    Ok(Some([source, edit].map(|motion| {
        let points = followed(&skeleton.motion_keypoints(&motion).points);
        mean_position_error(&points, &target, NUM_KEYPOINTS)
    })))
}

/// Keypoints `[L, 28]` with the pelvis of every frame over the origin, at its height.
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
    use datasets_spec::{Fps, Motion, MotionId, Pose, Split};
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

    /// An item from the ground to `target` metres above it.
    fn item(id: &str, target: Option<f64>) -> ItemRow {
        let mut item = ItemRow::blank(
            &MotionId::parse("somewhere/walk").expect("an id"),
            Split::Test,
        );
        let target = target.map(|height| lifted(height, 0.0));
        item.set_motions(&lifted(0.0, 0.0), target.as_ref(), None);
        item.id = id.to_owned();
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
        Answered {
            items: items.to_vec(),
            edits,
            skeleton: Skeleton::smplx_neutral(),
        }
    }

    /// Three items out of order, whose targets lie 1, 2 and 4 m above their sources.
    fn items() -> [ItemRow; 3] {
        [("c", 4.0), ("a", 1.0), ("b", 2.0)].map(|(id, target)| item(id, Some(target)))
    }

    #[test]
    fn the_best_edit_takes_most_off_the_distance_to_the_target() {
        let items = items();
        // The errors fall from 4 to 3 m, from 1 to 0 and from 2 to 0.5.
        let edits = |drift| {
            [1.0, 1.0, 1.5]
                .iter()
                .zip(&items)
                .map(|(height, item)| edit(item, "one", 0, &lifted(*height, drift)))
                .collect::<Vec<_>>()
        };
        for drift in [0.0, 0.5] {
            let mut edits = edits(drift);
            // A perfect edit of another system is not in question, and neither is a later take.
            edits.push(edit(&items[0], "other", 0, &lifted(4.0, 0.0)));
            edits.push(edit(&items[0], "one", 1, &lifted(4.0, 0.0)));
            let answered = answered(&items, edits);
            let best = best_edit(&answered).expect("motions").expect("edits");
            assert_eq!((best.item.id.as_str(), best.edit.seed), ("b", 0));
            let words = best.in_words();
            assert!(words.starts_with("The best case"), "{words}");
            let gain = best.gain.expect("targets");
            assert_eq!(gain.num_items, 3);
            // Stored in single precision.
            let near = |found: f64, expected: f64| (found - expected).abs() < 1e-5;
            assert!(
                near(gain.source_m, 2.0) && near(gain.edit_m, 0.5),
                "{gain:?}"
            );
            assert!(near(gain.median_m, 1.0), "{gain:?}");
        }
    }

    #[test]
    fn of_equal_edits_the_first_item_by_id_is_chosen() {
        let items = items();
        let still = |item| edit(item, "one", 0, &lifted(0.0, 0.0));
        let answered = answered(&items, items.iter().map(still).collect());
        let best = best_edit(&answered).expect("motions").expect("edits");
        assert_eq!(best.item.id, "a");
        assert_eq!(best.gain.expect("targets").median_m, 0.0);
        let words = best.in_words();
        assert!(words.starts_with("No best case"), "{words}");
    }

    #[test]
    fn without_targets_nothing_is_measured_and_without_edits_nothing_is_chosen() {
        let items = [item("b", None), item("a", None)];
        let edits = items
            .iter()
            .map(|item| edit(item, "one", 0, &lifted(1.0, 0.0)));
        let with_edits = answered(&items, edits.collect());
        let best = best_edit(&with_edits).expect("motions").expect("edits");
        assert_eq!((best.item.id.as_str(), best.gain), ("a", None));
        let without = answered(&items, Vec::new());
        assert!(best_edit(&without).expect("no motions").is_none());
    }
}
